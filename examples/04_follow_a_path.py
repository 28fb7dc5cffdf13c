"""Follow the machine along a path of leg lengths, and see what it meets.

Needs: spm-pin.
"""

import numpy as np

import spm_pin as spm

geometry = spm.Geometry.paper()
legs = np.array(
    [[1.20, 1.20, 1.40, 1.25, 1.20, 1.45], [1.45, 1.15, 1.30, 1.20, 1.50, 1.35], [1.10, 1.35, 1.60, 1.30, 1.40, 1.20]]
)
path = spm.follow(geometry, legs)

print(f"{len(path.parameters)} steps in mode {path.labels[0]}, to the end: {path.complete}")
for event in path.events:
    print(f"at {event.parameter:.9f}: {event.kind}, {event.detail}")
