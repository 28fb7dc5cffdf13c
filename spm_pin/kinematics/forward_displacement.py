"""Forward displacement: every assembly mode of six leg lengths, and the physical one.

The upper stage seen from {m} is a 3RPS stage like the lower one, so the two are solved independently, see
`spm_pin.kinematics.kernels.stage_equations`, and every solution of one goes with every solution of the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import GeometryError
from spm_pin.kinematics.as_built_forward import as_built_forward
from spm_pin.kinematics.batches import radii, run_kernel, with_batch_shape
from spm_pin.kinematics.forward_continuation import follow_seed
from spm_pin.kinematics.forward_displacement_arguments import read_leg_lengths
from spm_pin.mechanism.arguments import BoolArray, FloatArray, check_instance
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.solution_status import Degeneracy, Status
from spm_pin.mechanism.solutions import SolutionSet
from spm_pin.mechanism.units import unit_hint

STAGE_MODES = tuple(f"{mode}{place + 1}{sheet}" for mode in "TF" for place in range(4) for sheet in "+-")
"""Canonical order of the sixteen assembly modes of a stage: T1+, T1-, T2+ … F4-."""
ASSEMBLY_MODES = tuple(f"{lower}/{upper}" for lower in STAGE_MODES for upper in STAGE_MODES)
"""Canonical order of the 256 assembly modes of the manipulator: the lower stage's, then the upper stage's."""

_NEAR = 1e-5
"""Distance from a family, of squared lengths and relative to their size, within which counts may be wrong."""
_SHORT = 1e-3
"""Length in units of r below which a leg is short."""
_MIN_BATCH_PER_THREAD, _MIN_BATCH_PER_THREAD_PHYSICAL = 1 << 8, 1 << 12


def forward_displacement(geometry: Geometry, leg_lengths: npt.ArrayLike) -> SolutionSet:
    """Find all configurations of the manipulator that its six leg lengths allow.

    Parameters
    ----------
    geometry : Geometry
        The manipulator. Its leg limits are not applied.
    leg_lengths : array_like, shape (..., 6)
        r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m], from revolute joint to ball joint centre.

    Returns
    -------
    SolutionSet
        The assembly modes of `ASSEMBLY_MODES` along the last axis, so `.rotation` is (..., 256, 3, 3), `.translation`
        (..., 256, 3) and `.middle_joints` (..., 256, 3, 3), NaN where a mode is not real. `.status` (...) is
        `Status.OK`; `UNREACHABLE` where a stage cannot be closed; or `DEGENERATE` where a stage moves with its legs
        locked: the continuous family is left out, and `.degeneracy` says in which families of modes it is.

    Raises
    ------
    ArgumentError
        If a length is not a positive number, or too large for the machine to be resolved beside it.

    Notes
    -----
    A stage's modes are named T (no torsion) or F (turned half round) and numbered by falling mean radius of the
    middle joints about the stage's own axis, hence T1 is tilted least; + is the sheet on which the middle platform
    stands above the base, or hangs below the terminal platform, - its mirror image. Two modes that are to rounding
    the same, at a forward singularity, count once. A problem takes 43 kB: give large batches in parts.

    The paper left this problem to CAD. T and F are the operation modes of the 3-RPS stage [1]_.

    References
    ----------
    .. [1] J. Schadlbauer, M. Husty, S. Caro, P. Wenger, "Self-Motions of 3-RPS Manipulators", Frontiers of Mechanical
       Engineering 8 (2013). More in docs/related_work.md.

    Examples
    --------
    >>> import spm_pin as spm
    >>> modes = spm.forward_displacement(spm.Geometry.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> int(modes.count), modes["T1+/T1+"].translation.round(4)
    (144, array([0.6889, 0.4963, 2.253 ]))
    """
    from spm_pin.kinematics.kernels.mode_kernels import all_modes

    if not check_instance(geometry, Geometry, "geometry").is_nominal:
        cause = "forward_physical finds the physical mode of a machine as built; all modes are those of its .nominal"
        raise GeometryError("geometry", "a machine as drawn", "one as built", cause)
    checked = read_leg_lengths(geometry, leg_lengths)
    shape, lengths, n = checked.shape[:-1], checked.reshape(-1, 6), len(ASSEMBLY_MODES)
    results = (
        ((n, 3, 3), np.float64),
        ((n, 3), np.float64),
        ((n, 3, 3), np.float64),
        ((4,), np.int8),
        ((), np.int8),
    )
    solved = run_kernel(all_modes, (lengths,), radii(geometry), results, _MIN_BATCH_PER_THREAD)
    _solve_ill_conditioned(geometry, lengths, solved)
    *state, families, status = with_batch_shape(solved, shape)
    largest = np.asarray(families.max(axis=-1))
    modes = Configuration.from_arrays(geometry, *state)
    if not shape and status == Status.UNREACHABLE:
        modes.absence = unit_hint(geometry, checked)
    return SolutionSet(
        modes,
        ASSEMBLY_MODES,
        np.where(largest > 0, Status.DEGENERATE, status),
        degeneracy=Degeneracy(largest, families > 0, np.zeros((*shape, 3), dtype=np.bool_)),
    )


def forward_physical(
    geometry: Geometry, leg_lengths: npt.ArrayLike, seed: Configuration | None = None
) -> Configuration:
    """Find the physical configuration with these leg lengths: the one that the machine is in.

    Parameters
    ----------
    geometry : Geometry
        The manipulator. Its leg limits are not applied.
    leg_lengths : array_like, shape (..., 6)
        r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m]; of a machine as built the readings, offsets included.
    seed : Configuration, optional
        Where the machine was. Its leading axes broadcast with those of `leg_lengths`.

    Returns
    -------
    Configuration
        Of shape (...). Without a seed the configuration in the aspect of the symmetric home: both stages without
        torsion, on the sheet +, and reached from equal legs without a forward singularity. With a seed the end of the
        path on which its leg lengths change to the given ones in a straight line, whatever its mode. `.exists` is
        False, and everything NaN, where there is no such configuration, or where that path meets a forward
        singularity or takes more than 250,000 steps of a stage.

    Raises
    ------
    ArgumentError
        If a length is not a positive number or too large for the machine to be resolved beside it, or `seed` does
        not exist, does not close, belongs to another geometry or has another shape.

    Notes
    -----
    The home's aspect holds one configuration at most, so what Newton's method finds from level stages is taken if it is
    in there; if not, all solutions of mode T are found and looked at. It is T1+/T1+ unless E or C is less than
    a twentieth of d. With a seed each step is so short that Newton's method provably stays on the path, see
    `spm_pin.kinematics.forward_continuation`; so the seed may be far. A machine as built is followed from the one of
    the nominal machine, or from the seed, in steps at whose start the theorem of Newton and Kantorovich holds; see
    `docs/theory/as_built.md`.

    Examples
    --------
    >>> import spm_pin as spm
    >>> state = spm.forward_physical(spm.Geometry.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> state.pose.rotation.as_euler("XYX", degrees=True).round(4)
    array([-11.0818,  32.9691, -12.8831])
    """
    if not geometry.is_nominal:
        return as_built_forward(geometry, leg_lengths, seed, forward_physical)
    checked = read_leg_lengths(geometry, leg_lengths)
    if seed is not None:
        return follow_seed(geometry, checked, seed)
    shape, lengths = checked.shape[:-1], checked.reshape(-1, 6)
    results = ((3, 3), np.float64), ((3,), np.float64), ((3, 3), np.float64)
    solved = run_kernel(_solve_physical, (lengths,), radii(geometry), results, _MIN_BATCH_PER_THREAD_PHYSICAL)
    found = Configuration.from_arrays(geometry, *with_batch_shape(solved, shape))
    if not shape and not found.exists:
        absence = "with these leg lengths no configuration is reached from the home without a forward singularity"
        found.absence = f"{absence}. {unit_hint(geometry, checked)}".rstrip(". ")
    return found


def _solve_ill_conditioned(geometry: Geometry, lengths: FloatArray, solved: tuple[Any, ...]) -> None:
    """Solve problems again, with more digits, of which a stage is near a continuous family or has a very short leg."""
    rotation, translation, joints, dimension, status = solved
    r, *hips = radii(geometry)
    halves = lengths[:, :3], lengths[:, 3:]
    doubtful = np.zeros(len(lengths), dtype=np.bool_)
    for half, hip in zip(halves, hips, strict=True):
        doubtful |= _is_ill_conditioned(half / r, hip / r)
    at = np.flatnonzero(doubtful & (dimension.max(axis=-1) == 0))
    if not len(at):
        return
    from spm_pin.kinematics.ill_conditioned_stages import solve_stage_with_more_digits
    from spm_pin.kinematics.kernels.mode_kernels import compose_all

    for n in at:
        lower, upper = (
            solve_stage_with_more_digits(half[n], hip, geometry.middle_side, sign)
            for half, hip, sign in zip(halves, hips, (1.0, -1.0), strict=True)
        )
        pairs = np.repeat(lower, len(STAGE_MODES), axis=0), np.tile(upper, (len(STAGE_MODES), 1))
        compose_all(*pairs, r, rotation[n], translation[n], joints[n])
        status[n] = Status.UNREACHABLE if np.isnan(joints[n]).all() else Status.OK


def _is_ill_conditioned(lengths: FloatArray, epsilon: float) -> BoolArray:
    """Return whether double precision may miscount the modes of stages (N, 3), lengths and hips ε in units of r."""
    squares = lengths**2
    scale = squares.mean(axis=-1) + (1.0 + epsilon) ** 2
    odd, even = 9.0 * epsilon**2, 3.0 - 3.0 * epsilon**2
    away = [np.abs(squares - np.roll([odd, even, even], k)).max(axis=-1) for k in range(3)]
    near = (np.minimum.reduce(away) <= _NEAR * scale) & (epsilon < 1.0 + _NEAR)
    equal = np.ptp(squares, axis=-1) <= _NEAR * scale
    near_half = equal & (abs(2.0 * epsilon - 1.0) <= _NEAR)
    return np.asarray(near | near_half | (lengths.min(axis=-1) < _SHORT))


def _solve_physical(
    lengths: FloatArray, r: float, base_radius: float, platform_radius: float, *state: FloatArray
) -> None:
    """Write R, o and the b_i of the modes in the home's aspect; all modes are solved where Newton's method fails."""
    from spm_pin.kinematics.kernels.mode_kernels import home_modes, home_modes_of_all

    sizes, (rotation, translation, joints) = (r, base_radius, platform_radius), state
    found = np.empty(len(lengths), dtype=np.bool_)
    home_modes(lengths, *sizes, rotation, translation, joints, found)
    if not found.all():
        rest = np.flatnonzero(~found)
        solved = [np.empty((len(rest), *array.shape[1:])) for array in state]
        home_modes_of_all(lengths[rest], *sizes, *solved)
        for array, part in zip(state, solved, strict=True):
            array[rest] = part
