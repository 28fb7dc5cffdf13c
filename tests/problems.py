"""Problems with a known answer: a pose is composed from a middle platform placed in both stages.

The stages are placed with the machine of a 3RPS stage alone (Z axis in every leg plane), so no solver of the
package takes part in making a problem.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import mpmath
import numpy as np
import numpy.typing as npt
from oracle import cross
from scipy.optimize import brentq
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm

Array = npt.NDArray[np.float64]

PAPER = spm.Manipulator.paper()
EXAMPLE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
MANIPULATORS = {
    "paper": PAPER,
    "equal triangles": spm.Manipulator(0.7, 0.7, 0.7 * 3**0.5),
    "wide base": spm.Manipulator(1.5, 0.25, 0.5),
    "millimetres": spm.Manipulator(0.06, 0.04, 0.05),
}


@dataclass(frozen=True)
class Problem:
    """N poses, one branch of each, and the family it belongs to."""

    machine: spm.Manipulator
    pose: RigidTransform
    middle_joints: Array

    @property
    def configuration(self) -> spm.Configuration:
        return spm.Configuration(self.machine, self.pose, self.middle_joints)


def as_built(machine: spm.Manipulator, size: float, seed: int = 3) -> spm.Manipulator:
    """Return a machine with random errors: angles of `size` [rad], lengths of `size` times d."""
    return machine.perturbed(seed, length=size * machine.middle_side, angle=size)


def stage_quaternion(mode: str, tilt_axis: npt.ArrayLike, half_sine: npt.ArrayLike) -> Array:
    """Return the quaternion (..., 4) of a middle platform in one stage, scalar last.

    `tilt_axis` is the azimuth of w = x1 + i x2, `half_sine` its modulus.
    """
    tilt_axis, half_sine = np.broadcast_arrays(tilt_axis, half_sine)
    x1, x2 = half_sine * np.cos(tilt_axis), half_sine * np.sin(tilt_axis)
    rest = np.sqrt(1.0 - half_sine**2)
    zero = np.zeros_like(rest)
    return np.stack([x1, x2, *((zero, rest) if mode == "T" else (rest, zero))], axis=-1)


def stage_at(quaternion: Array, height: npt.ArrayLike, r: float) -> tuple[Array, Array]:
    """Place a middle platform in one stage: its quaternion (..., 4) and its centre (..., 3)."""
    x1, x2 = quaternion[..., 0], quaternion[..., 1]
    centre = [-2 * r * x1 * x2, r * (x2**2 - x1**2), np.broadcast_to(height, x1.shape)]
    return quaternion, np.stack(centre, axis=-1)


def stage(
    mode: str, tilt_axis: npt.ArrayLike, half_sine: npt.ArrayLike, height: npt.ArrayLike, r: float
) -> tuple[Array, Array]:
    """Place a middle platform in one stage by its tilt, see `stage_quaternion`, and its height."""
    return stage_at(stage_quaternion(mode, tilt_axis, half_sine), height, r)


def corners(machine: spm.Manipulator, placed: tuple[Array, Array]) -> Array:
    """Return the ball joints (..., 3, 3) of a middle platform in one stage."""
    rotation, local = Rotation.from_quat(placed[0]), machine.middle_radius * machine.radial_directions
    return np.stack([rotation.apply(point) + placed[1] for point in local], axis=-2)


def compose(machine: spm.Manipulator, lower: tuple[Array, Array], upper: tuple[Array, Array]) -> Problem:
    """Join two stages, `upper` seen from {m}, at their middle platform."""
    middle, seen_from_m = Rotation.from_quat(lower[0]), Rotation.from_quat(upper[0])
    rotation = middle * seen_from_m.inv()
    translation = lower[1] - rotation.apply(upper[1])
    return Problem(machine, spm.pose(translation, rotation=rotation), corners(machine, lower))


def without_torsion(
    machine: spm.Manipulator, lower: Sequence[npt.ArrayLike], upper: Sequence[npt.ArrayLike], family: str = "TT"
) -> spm.Configuration:
    """Return the states of two stages, each given by its tilt axis, the sine of half its tilt, and its height [m]."""
    stages = (stage(mode, *tilt, machine.middle_radius) for mode, tilt in zip(family, (lower, upper), strict=True))
    return compose(machine, *stages).configuration


def random_branches(machine: spm.Manipulator, family: str, count: int, seed: int) -> Problem:
    """Problems over all orientations of both stages: tilts up to 180 degrees, heights of both signs."""
    rng = np.random.default_rng(seed)
    placed = []
    for mode in family:
        half_sine = np.sqrt(rng.uniform(0.0, 1.0, count))
        height = rng.uniform(-3.0, 3.0, count) * machine.middle_side
        placed.append(stage(mode, rng.uniform(-np.pi, np.pi, count), half_sine, height, machine.middle_radius))
    return compose(machine, placed[0], placed[1])


def in_leg_space(machine: spm.Manipulator, count: int, seed: int, *, legs: Array | None = None) -> Problem:
    """Problems at leg lengths drawn uniformly from the limits, in the mode of the symmetric home."""
    rng = np.random.default_rng(seed)
    if legs is None:
        legs = rng.uniform(machine.limits.minimum, machine.limits.maximum, (count, 6))
    lower = _home_mode(legs[:, :3], machine.base_radius, machine)
    quaternion, position = _home_mode(legs[:, 3:], machine.platform_radius, machine)
    # The upper stage hangs below its platform: mirrored at the platform's plane.
    mirrored = quaternion * [-1.0, -1.0, 1.0, 1.0], position * [1.0, 1.0, -1.0]
    return compose(machine, lower, mirrored)


def _home_mode(lengths: Array, radius: float, machine: spm.Manipulator) -> tuple[Array, Array]:
    """Solve one stage's leg lengths (N, 3) by Newton from its level position."""
    r = machine.middle_radius
    cos_phi, sin_phi = machine.radial_directions[:, 0], machine.radial_directions[:, 1]
    unknown = np.zeros((len(lengths), 3))
    unknown[:, 2] = np.sqrt((lengths**2).mean(axis=-1) - (r - radius) ** 2)
    for _ in range(60):
        x1, x2, height = (unknown[:, k, None] for k in range(3))
        x0 = np.sqrt(1.0 - x1**2 - x2**2)
        rho = r * (x0**2 - 2 * ((x1**2 - x2**2) * sin_phi + 2 * x1 * x2 * cos_phi)) - radius
        lift = x1 * sin_phi - x2 * cos_phi
        z = height + 2 * r * x0 * lift
        error = rho**2 + z**2 - lengths**2
        d_rho = [r * (-2 * x1 - 4 * (x1 * sin_phi + x2 * cos_phi)), r * (-2 * x2 - 4 * (-x2 * sin_phi + x1 * cos_phi))]
        d_z = [2 * r * (-x1 / x0 * lift + x0 * sin_phi), 2 * r * (-x2 / x0 * lift - x0 * cos_phi)]
        columns = [2 * rho * d_rho[k] + 2 * z * d_z[k] for k in range(2)] + [2 * z]
        unknown -= np.linalg.solve(np.stack(columns, axis=-1), error[..., None])[..., 0]
        if np.abs(error).max() < 4e-15:
            break
    assert np.abs(error).max() < 1e-13
    azimuth, half_sine = np.arctan2(unknown[:, 1], unknown[:, 0]), np.hypot(unknown[:, 0], unknown[:, 1])
    return stage("T", azimuth, half_sine, unknown[:, 2], r)


def at_discriminant(pose: RigidTransform, family: int, h_beyond: float, machine: spm.Manipulator) -> RigidTransform:
    """Shift a pose along the common normal of the two Z axes until a family's fold is `h_beyond` [m] away.

    The discriminant is a quadratic in the shift, (h - λ_min)(λ_max - h), so three samples give its roots.
    Positive `h_beyond` leaves the two branches real and close together, negative ones have just vanished.
    """
    rotation = pose.rotation.as_matrix()
    normal = np.array([-rotation[1, 2], rotation[0, 2], 0.0])
    normal /= np.linalg.norm(normal)
    scale = 0.1 * machine.middle_side
    shifts = scale * np.array([-1.0, 0.0, 1.0])
    samples = [
        spm.inverse_displacement(machine, spm.pose(pose.translation + s * normal, rotation=pose.rotation))
        for s in shifts
    ]
    values = [float(s.discriminants[family]) for s in samples if s.discriminants is not None]
    fold = np.roots(np.polyfit(shifts, values, 2)).real.max()
    return spm.pose(pose.translation + (fold - h_beyond) * normal, rotation=pose.rotation)


def distance(state: spm.Configuration, other: spm.Configuration) -> Array:
    """Largest displacement [m] of a joint of the middle or of the terminal platform."""
    pairs = (state.middle_joints, other.middle_joints), (state.platform_joints, other.platform_joints)
    return np.maximum(*(np.linalg.norm(a - b, axis=-1).max(axis=-1) for a, b in pairs))


def conditioning(configuration: spm.Configuration) -> Array:
    """Displacement of b [m] per rounding of the pose: of the lines the joints are on, and of the triangle on them.

    Line i is the meet of two planes, so its position errs by that of the planes over the sine of their angle;
    the three side lengths then fix the joints along the lines through a 3 x 3 matrix of direction cosines.
    """
    along = np.cross(configuration.machine.revolute_axes, configuration.platform_axes)
    sine = np.linalg.norm(along, axis=-1)
    along = along / sine[..., None]
    b = configuration.middle_joints
    matrix = np.zeros((*configuration.shape, 3, 3))
    for row, (i, j) in enumerate(((0, 1), (1, 2), (2, 0))):
        side = (b[..., i, :] - b[..., j, :]) / configuration.machine.middle_side
        matrix[..., row, i] = (side * along[..., i, :]).sum(axis=-1)
        matrix[..., row, j] = -(side * along[..., j, :]).sum(axis=-1)
    reach = np.linalg.norm(configuration.translation, axis=-1) + np.abs(b).max(axis=(-1, -2))
    smallest = np.linalg.svd(matrix, compute_uv=False)[..., -1]
    return reach / sine.min(axis=-1) * (1.0 + 1.0 / smallest)


def wrench_matrices(state: spm.Configuration, centre: Array | None = None) -> Array:
    """J_b, J_c and K, (..., 3, 6, 6): unit forces and their moments about a point, arms in units of d.

    Without a point, about the middle platform's centre.
    """
    about = state.middle_joints.mean(axis=-2) if centre is None else centre
    arms = (state.balls - about[..., None, :]) / state.machine.middle_side
    legs = state.leg_vectors / state.leg_lengths[..., None]
    along, across = (np.concatenate([f, np.cross(arms, f)], axis=-1) for f in (legs, state.leg_axes))
    stages = [np.concatenate([along[..., s, :], across[..., s, :]], axis=-2) for s in (slice(0, 3), slice(3, 6))]
    return np.stack([*stages, across], axis=-3)


def exact_wrench_matrices(state: spm.Configuration, centre: Array, unit: float = 1.0) -> list[mpmath.matrix]:
    """The same of a drawn machine in mpmath's digits, from the numbers of the state, arms in multiples of a unit."""
    root, half = mpmath.sqrt(3), mpmath.mpf(1) / 2
    radial = [[root / 2, -half, 0], [0, 1, 0], [-root / 2, -half, 0]]
    axes = [[half, root / 2, 0], [1, 0, 0], [-half, root / 2, 0]]
    R, o, point = (mpmath.matrix(array.tolist()) for array in (state.rotation, state.translation, centre))
    E, C = mpmath.mpf(state.machine.base_radius), mpmath.mpf(state.machine.platform_radius)
    rows: list[list[list[Any]]] = [[], [], [], []]
    for i in range(3):
        b, u, axis = mpmath.matrix(state.middle_joints[i].tolist()), mpmath.matrix(radial[i]), mpmath.matrix(axes[i])
        lower, upper = b - u * E, o + R * u * C - b
        arm = (b - point) / unit
        for row, f in zip(rows, (lower / mpmath.norm(lower), axis, upper / mpmath.norm(upper), R * axis), strict=True):
            row.append([*f, *cross(arm, f)])
    lower_legs, lower_axes, upper_legs, upper_axes = rows
    return [mpmath.matrix(x) for x in (lower_legs + lower_axes, upper_legs + upper_axes, lower_axes + upper_axes)]


# Two stages without torsion on their way through a singularity: azimuths of the tilt axes, half sines of the tilts and
# heights, one of them None and searched for between the last two numbers. Keyed by the determinant that vanishes.
PAPER_TILTS = {
    0: ((0.4, 1.9), (None, 0.2), (0.3, -1.1), 0.05, 0.9),
    2: ((0.3, None), (0.2, 0.25), (1.2, -1.1), 1.5, 4.6),
}


def singular_path(
    which: int,
    azimuths: tuple[float | None, float | None],
    half_sines: tuple[float | None, float | None],
    heights: tuple[float, float],
    low: float,
    high: float,
) -> tuple[Callable[[float], spm.Configuration], float]:
    """Return states of the paper's machine over the number that is None, and where in between one is singular.

    One of det J_b, det J_c, det K, counted by `which`, vanishes there.
    """

    def at(value: float) -> spm.Configuration:
        parameters = ([value if x is None else x for x in pair] for pair in (azimuths, half_sines, heights))
        return without_torsion(PAPER, *zip(*parameters, strict=True))

    return at, float(brentq(lambda x: spm.determinants(at(x))[which], low, high, xtol=1e-15, rtol=1e-15))


def singular_state(which: int, *path: Any) -> spm.Configuration:
    """Return the singular state of a path."""
    at, root = singular_path(which, *path)
    return at(root)


def at_end_stops(machine: spm.Manipulator, count: int) -> spm.Configuration:
    """Return physical states with two legs each at ends of their limits, some of `count` random readings."""
    rng, limits = np.random.default_rng(0), machine.limits
    ends = np.array([limits.minimum, limits.maximum])
    readings = rng.uniform(*ends, (count, 6))
    stops = np.where(rng.random((count, 6)) < 0.5, *ends)
    states = spm.forward_physical(machine, np.where(rng.random((count, 6)).argsort(axis=-1) < 2, stops, readings))
    return states[states.exists]
