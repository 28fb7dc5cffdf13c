"""What the terminal platform can reach: the paper's shell, the reachable set itself, and sweeps over both."""
