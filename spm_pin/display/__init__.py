"""How the manipulator looks: a scene of named solids, and pictures of it in PNG or SVG."""
