"""Pictures of the manipulator in PNG or SVG, and the viewer, from one scene of named solids."""
