"""Pictures of the manipulator in PNG or SVG, and the viewer, from one scene of named solids.

Functions that draw raise `MissingExtraError` without the extra `plots`, those of the viewer without `viewer`. Figures
that they make are unknown to pyplot.
"""
