"""Certificates that the poses around a given one hold no inverse singularity of its branch TT+ or TT-.

On the circle u = cos φ, v = sin φ the quadratic of the family TT is F(φ) = m + a cos 2φ + b sin 2φ - h, and where it is
zero

    |det K| = 9/4 d² √(1 - κ²) |P Q| |S| |W| |F'(φ)|,    P Q = ½ |W|² (v²/(1 - κ) - u²/(1 + κ)).

The sign of F' tells TT- from TT+. Boxes of the platform's turn and place and of φ are halved again and again: those
without a zero of F, or with the other sign of F', go, and those in which neither F' nor P Q is zero are proved.
Notation: `docs/theory/inverse_displacement.md`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.intervals import SQRT_3, Interval
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.mechanism.arguments import FloatArray, check_instance, real_number, whole_number
from spm_pin.mechanism.configuration import Configuration, check_configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.pose import pose as make_pose
from spm_pin.mechanism.stage_coordinates import configuration_of_stages, stage_coordinates
from spm_pin.proofs.certificate import LONGEST
from spm_pin.proofs.inverse_certificate import SAMPLES, InverseCertificate

_SLACK = 1e-12
"""Rounding of a pose's quaternion, and of a cosine."""
_SAME = 1e-6
"""Distance, over d, up to which joints are those of a branch."""
_CELLS = 64
"""Parts of the half circle of φ to begin with."""
_NARROWEST = 1e-9


def certify_poses(
    configuration: Configuration, distance: float, angle: float, *, boxes: int = 300_000
) -> InverseCertificate:
    """Prove that the branch of a configuration meets no inverse singularity at the poses around its own.

    Parameters
    ----------
    configuration : Configuration
        One state without torsion in either stage, on the branch TT+ or TT- of the pose in the middle.
    distance : float
        How far x and y of o may be from those of the pose [m]; z may be any, for det K does not depend on it.
    angle : float
        How far the rotation may be from that of the pose [rad].
    boxes : int
        Boxes to look at, at most.

    Returns
    -------
    InverseCertificate
        If it holds, the branch is real at all these poses, meets no other, and no stage is tilted by half a turn.

    Raises
    ------
    ArgumentError
        If an argument has the wrong kind, the configuration is another one, or `distance` exceeds 1000 times the sum of
        the dimensions.
    """
    check_configuration(configuration, single=True, existing=True)
    geometry = check_instance(configuration.geometry, Geometry, "configuration.geometry")
    solutions = inverse_displacement(geometry, configuration.pose)
    gaps = np.abs(solutions.middle_joints[:2] - configuration.middle_joints).max(axis=(-1, -2))
    if not (gaps <= _SAME * geometry.middle_side).any():
        raise ArgumentError("configuration", "a state without torsion in both stages", "another")
    branch = int(np.nanargmin(gaps))
    most = LONGEST * sum(geometry.dimensions)
    real_number(distance, "distance", f"metres from 0 to {most:g}", least=0.0, most=most)
    real_number(angle, "angle", "radians from 0 to pi", least=0.0, below=np.pi)
    whole_number(boxes, "boxes", least=1)
    least, witness = _search(configuration, branch, distance, angle)
    name = f"Poses within {distance:g} m and {np.degrees(angle):g}°"
    if witness is not None:
        return InverseCertificate(geometry, name, 0.0, least, np.empty((0, 6, 2)), witness, 0)
    bound, undecided, seen = _divide(configuration, branch, distance, angle, 0.5 * least, boxes)
    return InverseCertificate(geometry, name, bound, least, undecided, None, seen)


def _search(
    configuration: Configuration, branch: int, distance: float, angle: float
) -> tuple[float, Configuration | None]:
    """Return the least sampled |det K| / d³ of a branch, and a state with det K = 0 if there are poses without it."""
    geometry, rotation, position = configuration.geometry, configuration.pose.rotation, configuration.translation
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(SAMPLES, 3))
    turns *= (angle * rng.uniform(size=SAMPLES) / np.linalg.norm(turns, axis=-1))[:, None]
    places = distance * rng.uniform(-1.0, 1.0, (SAMPLES, 3)) * [1.0, 1.0, 0.0]

    def solve(turn: FloatArray, place: FloatArray) -> Any:
        turned = Rotation.from_rotvec(turn) * rotation
        return inverse_displacement(geometry, make_pose(position + place, rotation=turned))

    found = solve(turns, places)
    sizes = np.abs(determinants(found.configurations[:, branch])[:, 2])[found.exists[:, branch]]
    least = float(sizes.min(initial=np.inf)) / geometry.middle_side**3
    values = found.discriminants[:, 0]
    if not values.min() < 0.0 <= values.max():
        return least, None
    i, j = values.argmin(), values.argmax()

    def at(share: float) -> Any:
        return solve(turns[i] + share * (turns[j] - turns[i]), places[i] + share * (places[j] - places[i]))

    fold = scipy.optimize.brentq(lambda share: float(at(share).discriminants[0]), 0.0, 1.0, xtol=1e-15)
    steps = (0.0, *10.0 ** np.arange(-16.0, -6.0))
    meeting = next(solutions for solutions in (at(fold + step) for step in steps) if solutions.exists[0])
    # Halfway between the two branches det K is zero.
    return 0.0, configuration_of_stages(geometry, stage_coordinates(meeting.configurations[:2]).mean(axis=0))


def _divide(
    configuration: Configuration, branch: int, distance: float, angle: float, target: float, most: int
) -> tuple[float, FloatArray, int]:
    """Return the proved bound of |det K| / d³, the undecided boxes (N, 6, 2), and how many were looked at."""
    geometry, rotation, position = configuration.geometry, configuration.pose.rotation, configuration.translation
    furthest = np.sin(0.5 * angle) + _SLACK
    edges = np.linspace(-1e-9, np.pi + 1e-9, _CELLS + 1)
    boxes = np.empty((_CELLS, 6, 2))
    place = np.nextafter(position[:2, None] + [-distance, distance], [-np.inf, np.inf])
    boxes[:, :3], boxes[:, 3:5] = (-furthest, furthest), place
    boxes[:, 5] = np.stack([edges[:-1], edges[1:]], axis=-1)
    quaternion = [float(c) for c in rotation.as_quat() * (1.0 if rotation.as_quat()[3] >= 0.0 else -1.0)]
    weights = np.array([4.0, 4.0, 4.0, *[1.0 / geometry.middle_radius] * 2, 0.5])
    seen, bound = 0, np.inf
    while True:
        seen += len(boxes)
        near = sum((Interval(b[:, 0], b[:, 1]).square() for b in boxes[:, :3].swapaxes(0, 1)), Interval.of(0.0))
        boxes = boxes[near.low <= furthest**2]
        value, slope, determinant = _form(geometry, quaternion, boxes)
        kept = ~((value.low > 0.0) | (value.high < 0.0) | (slope.low > 0.0 if branch == 0 else slope.high < 0.0))
        least = np.nan_to_num(determinant.least()[kept])
        boxes, widths = boxes[kept], (boxes[kept, :, 1] - boxes[kept, :, 0]) * weights
        proved = (least > target) | ((least > 0.0) & (widths.max(axis=-1) <= _NARROWEST))
        bound = min(bound, float(least[proved].min(initial=np.inf)))
        boxes, widths, least = boxes[~proved], widths[~proved], least[~proved]
        if not len(boxes) or widths.max() <= _NARROWEST or seen + 2 * len(boxes) > most:
            return min(bound, float(least.min(initial=np.inf))), boxes[least <= 0.0], seen
        rows, axis = np.arange(len(boxes)), widths.argmax(axis=-1)
        middle = boxes[rows, axis].mean(axis=-1)
        lower, upper = boxes.copy(), boxes
        lower[rows, axis, 1], upper[rows, axis, 0] = middle, middle
        boxes = np.concatenate([lower, upper])


def _form(geometry: Geometry, quaternion: list[float], boxes: FloatArray) -> tuple[Interval, Interval, Interval]:
    """Return F and F' up to positive factors, and what is ±det K / d³ where F is zero; NaN where a box is too large."""
    t1, t2, t3, x, y, phi = (Interval(b[:, 0], b[:, 1]) for b in boxes.swapaxes(0, 1))
    t0 = (1.0 - (t1.square() + t2.square() + t3.square())).root()
    p1, p2, p3, p0 = (Interval(np.array(c - _SLACK), np.array(c + _SLACK)) for c in quaternion)
    kappa, mu = t0 * p0 - (t1 * p1 + t2 * p2 + t3 * p3), t0 * p3 + t3 * p0 + t1 * p2 - t2 * p1
    w, wi = t0 * p1 + t1 * p0 + t2 * p3 - t3 * p2, t0 * p2 + t2 * p0 + t3 * p1 - t1 * p3
    square = w.square() + wi.square()
    sine, rest = square.root(), square + mu.square()
    w, wi, tau = w / sine, wi / sine, mu.square() / rest
    cubed, cubed_i = w * (w.square() - 3.0 * wi.square()), wi * (3.0 * w.square() - wi.square())
    cosine_2, sine_2 = (_near(turn(2.0 * boxes[:, 5].mean(axis=-1)), phi.high - phi.low) for turn in (np.cos, np.sin))
    even, odd = cubed * mu * (3.0 + tau), cubed_i * rest.root() * (1.0 + 3.0 * tau)
    h = (kappa * w - mu * wi) * x + (kappa * wi + mu * w) * y
    value = (
        kappa * (odd * sine_2 - even * cosine_2)
        - cubed * mu * (1.0 - tau)
        - h * SQRT_3 / Interval.of(geometry.middle_side)
    )
    slope = kappa * (even * sine_2 + odd * cosine_2)
    return value, slope, slope * (kappa - cosine_2) * (square * sine / rest.root()) * (2.25 / SQRT_3)


def _near(values: FloatArray, width: FloatArray) -> Interval:
    """Return intervals around a sine or cosine of 2φ, for cells of φ of this width."""
    reach = width + _SLACK
    return Interval(np.maximum(values - reach, -1.0), np.minimum(values + reach, 1.0))
