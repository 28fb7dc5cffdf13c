"""Forward displacement: every assembly mode of six leg lengths, and the one a real machine is in.

The upper stage seen from {m} is a 3RPS stage like the lower one, so the two are solved independently, see
`spm_pin.closed_form.stage`, and every solution of one goes with every solution of the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.assembly import composed, joined
from spm_pin.closed_form.continuation import continued
from spm_pin.closed_form.stage import MODES, PLACES, StageModes, solve_stage
from spm_pin.errors import ArgumentError
from spm_pin.mechanism.arguments import FloatArray, first_offender, real_array
from spm_pin.mechanism.branches import in_home_aspect
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import LEGS, Geometry
from spm_pin.mechanism.solutions import Degeneracy, SolutionSet, Status

__all__ = ["ASSEMBLY_MODES", "STAGE_MODES", "forward_displacement", "forward_physical"]

BoolArray = npt.NDArray[np.bool_]

STAGE_MODES = tuple(f"{mode}{place + 1}{sheet}" for mode in MODES for place in range(PLACES) for sheet in "+-")
"""Canonical order of the sixteen assembly modes of a stage: T1+, T1-, T2+ … F4-."""
ASSEMBLY_MODES = tuple(f"{lower}/{upper}" for lower in STAGE_MODES for upper in STAGE_MODES)
"""Canonical order of the 256 assembly modes of the manipulator: the lower stage's, then the upper stage's."""

_RADIAL = np.array([[np.sqrt(0.75), -0.5, 0.0], [0.0, 1.0, 0.0], [-np.sqrt(0.75), -0.5, 0.0]])
_VERTICAL = np.array([0.0, 0.0, 1.0])
_LARGEST = 1e5
"""Lengths, relative to the machine, beyond which eleven of sixteen digits are lost."""
_CHUNK = 1024
"""Problems solved at a time, so that intermediate results stay in the cache."""


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

    The paper left this problem to CAD.

    Examples
    --------
    >>> import spm_pin as spm
    >>> modes = spm.forward_displacement(spm.Geometry.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> int(modes.count), modes["T1+/T1+"].translation.round(4)
    (144, array([0.6889, 0.4963, 2.253 ]))
    """
    lengths = _read(geometry, leg_lengths)
    shape, n = lengths.shape[:-1], len(ASSEMBLY_MODES)
    lengths = lengths.reshape(-1, 6)
    count = len(lengths)
    rotation, translation = np.full((count, n, 3, 3), np.nan), np.full((count, n, 3), np.nan)
    joints = np.full((count, n, 3, 3), np.nan)
    dimension = np.zeros((count, 4), dtype=np.int8)
    for first in range(0, count, _CHUNK):
        part = slice(first, first + _CHUNK)
        lower, upper = _stages(geometry, lengths[part], MODES)
        below, above = _Sheets.of(lower, (1.0, -1.0)), _Sheets.of(upper, (-1.0, 1.0))
        problem, i, j = np.nonzero(below.exists[:, :, None] & above.exists[:, None, :])
        place = first + problem, i * len(STAGE_MODES) + j
        rotation[place], translation[place], joints[place] = composed(
            geometry,
            (below.quaternion[problem, i], below.height[problem, i]),
            (above.quaternion[problem, j], above.height[problem, j]),
        )
        dimension[part] = _dimensions(lower, upper)
    modes = Configuration.from_arrays(
        geometry,
        rotation.reshape(*shape, n, 3, 3),
        translation.reshape(*shape, n, 3),
        joints.reshape(*shape, n, 3, 3),
    )
    status = np.where(modes.exists.any(axis=-1), Status.OK, Status.UNREACHABLE)
    dimension = dimension.reshape(*shape, 4)
    largest = np.asarray(dimension.max(axis=-1))
    return SolutionSet(
        modes,
        ASSEMBLY_MODES,
        np.where(largest > 0, Status.DEGENERATE, status),
        degeneracy=Degeneracy(largest, dimension > 0, np.zeros((*shape, 3), dtype=bool)),
    )


def forward_physical(
    geometry: Geometry, leg_lengths: npt.ArrayLike, seed: Configuration | None = None
) -> Configuration:
    """Find the configuration that a real machine with these leg lengths is in.

    Parameters
    ----------
    geometry : Geometry
        The manipulator. Its leg limits are not applied.
    leg_lengths : array_like, shape (..., 6)
        r_b1, r_b2, r_b3, r_c1, r_c2, r_c3 [m].
    seed : Configuration, optional
        Where the machine was. Its leading axes broadcast with those of `leg_lengths`.

    Returns
    -------
    Configuration
        Of shape (...). Without a seed the configuration in the aspect of the symmetric home: both stages without
        torsion, on the sheet +, and reached from equal legs without a forward singularity. With a seed the end of the
        path on which its leg lengths change to the given ones in a straight line, whatever its mode. `.exists` is
        False, and everything NaN, where there is no such configuration, or where that path meets a forward
        singularity.

    Raises
    ------
    ArgumentError
        If a length is not a positive number or too large for the machine to be resolved beside it, or `seed` does
        not exist, does not close, belongs to another geometry or has another shape.

    Notes
    -----
    Without a seed nothing is iterated from a guess: all solutions of mode T are found, and the one in the home aspect
    is taken. It is T1+/T1+ unless E or C is less than a twentieth of d. With a seed each step is so short that
    Newton's method provably stays on the path, see `spm_pin.closed_form.continuation`; so the seed may be far.

    Examples
    --------
    >>> import spm_pin as spm
    >>> state = spm.forward_physical(spm.Geometry.paper(), [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    >>> state.pose.rotation.as_euler("XYX", degrees=True).round(4)
    array([-11.0818,  32.9691, -12.8831])
    """
    lengths = _read(geometry, leg_lengths)
    if seed is not None:
        return continued(geometry, lengths, seed)
    shape = lengths.shape[:-1]
    lengths = lengths.reshape(-1, 6)
    quaternion = np.full((2, len(lengths), 4), np.nan)
    height = np.full((2, len(lengths)), np.nan)
    for first in range(0, len(lengths), _CHUNK):
        part = slice(first, first + _CHUNK)
        for k, stage in enumerate(_stages(geometry, lengths[part], ("T",))):
            hips = (geometry.base_radius, geometry.platform_radius)[k] / geometry.middle_radius
            home = _in_home_aspect(stage, hips)[:, 0]
            # There is one at most; where there is none, any place will do.
            chosen = np.arange(len(home)), home.argmax(axis=-1)
            exists = np.asarray(home.any(axis=-1))
            quaternion[k, part] = np.where(exists[:, None], stage.quaternion[:, 0][chosen], np.nan)
            height[k, part] = stage.centre[:, 0, :, 2][chosen]
    # The upper stage hangs below its hips.
    upper = quaternion[1] * [-1.0, -1.0, 1.0, 1.0], -height[1]
    return joined(geometry, (quaternion[0], height[0]), upper, shape)


def _read(geometry: Geometry, leg_lengths: npt.ArrayLike) -> FloatArray:
    meaning = f"{', '.join(LEGS)} in metres"
    lengths = real_array(leg_lengths, "leg_lengths", (6,), meaning)
    if (lengths <= 0.0).any():
        index = first_offender(lengths <= 0.0)
        where = f" for {LEGS[index[-1]]}" + (f" at index {index[:-1]}" if index[:-1] else "")
        cause = "Strokes of the actuators instead of distances between joint centres?"
        raise ArgumentError("leg_lengths", f"positive lengths {meaning}", f"{lengths[index]:g}{where}", cause)
    size = geometry.base_radius + geometry.platform_radius + geometry.middle_side
    if (lengths > _LARGEST * size).any():
        index = first_offender(lengths > _LARGEST * size)
        expected = f"lengths in metres up to {_LARGEST:.0e} times the machine's own {size:.3g} m"
        raise ArgumentError("leg_lengths", expected, f"{lengths[index]:g}", "Lengths in another unit?")
    return lengths


def _stages(geometry: Geometry, lengths: FloatArray, modes: tuple[str, ...]) -> tuple[StageModes, StageModes]:
    count, r = len(lengths), geometry.middle_radius
    hips = np.repeat([geometry.base_radius / r, geometry.platform_radius / r], count)
    both = solve_stage(np.concatenate([lengths[:, :3], lengths[:, 3:]]) / r, hips, modes)
    return both.part(slice(count)), both.part(slice(count, None))


@dataclass(frozen=True)
class _Sheets:
    """The sixteen assembly modes of N stages in the order of `STAGE_MODES`."""

    quaternion: FloatArray  # (N, 16, 4)
    height: FloatArray  # (N, 16)
    exists: BoolArray  # (N, 16)

    @classmethod
    def of(cls, stage: StageModes, signs: tuple[float, float]) -> _Sheets:
        """Unfold the sheets + and -, which are above the hips where `signs` is positive and below elsewhere."""
        # Mirrored at the plane of the hips, a rotation keeps its part about the normal.
        mirror = np.array([[sign, sign, 1.0, 1.0] for sign in signs])
        quaternion = stage.quaternion[..., None, :] * mirror
        height = stage.centre[..., 2, None] * np.array(signs)
        exists = np.stack([stage.exists, stage.exists & ~stage.flat], axis=-1)
        count = len(stage.exists)
        return cls(
            quaternion.reshape(count, len(STAGE_MODES), 4),
            height.reshape(count, len(STAGE_MODES)),
            exists.reshape(count, len(STAGE_MODES)),
        )


def _in_home_aspect(stage: StageModes, hip_radius: FloatArray | float) -> BoolArray:
    """Tell which solutions are reached from equal legs without a forward singularity, shape (N, modes, 4).

    With c_ij = (b_i - b_j)·w_i, w_i normal to leg i and to its revolute axis, det J_b is c12 c23 c31 + c21 c32 c13
    up to a positive factor, and all six are positive at equal legs. Where the sum is positive, none, one, three or
    four of them are negative, never two: its sign alone does not tell the aspect, but together with this it does.
    """
    b = stage.radii[..., None] * _RADIAL + stage.heights[..., None] * _VERTICAL
    w = stage.heights[..., None] * _RADIAL - (stage.radii[..., None] - hip_radius) * _VERTICAL
    return in_home_aspect(b, w)


def _dimensions(lower: StageModes, upper: StageModes) -> npt.NDArray[np.int8]:
    """Return the dimension of the continuous families in TT, TF, FT, FF, shape (N, 4)."""
    a, b = lower.continuous, upper.continuous
    present = [continuous | np.asarray(stage.exists.any(axis=-1)) for continuous, stage in ((a, lower), (b, upper))]
    both = present[0][:, :, None] & present[1][:, None, :]
    return ((a[:, :, None].astype(np.int8) + b[:, None, :]) * both).reshape(-1, 4).astype(np.int8)
