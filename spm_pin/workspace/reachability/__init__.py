"""The reachable set itself: which poses and positions, its boundary, its sizes."""
