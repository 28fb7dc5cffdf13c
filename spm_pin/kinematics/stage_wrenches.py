"""The 6 x 6 matrices of forces through the ball joints, and where they are singular; of machines as built too.

See `spm_pin.kinematics.jacobians` for what they are. The kernels of rates and forces compute their determinants alone,
and mark the few states that may be singular; singular values decide about these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from spm_pin.errors import SingularConfigurationError
from spm_pin.mechanism.arguments import BoolArray, FloatArray, IntArray, first_offender
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry

_EPS = float(np.finfo(np.float64).eps)
SINGULAR = 64.0 * _EPS
"""A matrix is singular to rounding where its smallest singular value is at most this times its largest.

A unit vector computed from joint positions is off by a few eps, and so is an arm (b_i - p)/d. Six rows of two
such parts, of coordinates a few times d, make a matrix off by some 10 √12 eps < 64 eps in the Frobenius norm:
a smaller singular value may as well be zero.
"""


@dataclass(frozen=True)
class StageWrenches:
    """The forces of the legs as rows (f, (b_i - p) x f / d) at the middle platform's centre p, in {B}.

    Of a machine as built the b_i of a lower leg and of an upper leg are those of its own ball, p is the centre of the
    lower balls, and d the nominal side. The rows of a state that does not exist are NaN.
    """

    legs: FloatArray
    """[A_b, A_c], shape (..., 2, 3, 6): the lower stage first."""
    constraints: FloatArray
    """[K_b, K_c], shape (..., 2, 3, 6)."""
    lever: FloatArray
    """o - p [m], shape (..., 3)."""
    side: float
    """d [m]."""
    exists: BoolArray

    @classmethod
    def of(cls, configuration: Configuration, *, short_legs: bool = False) -> StageWrenches:
        """Set up the rows.

        Raises
        ------
        SingularConfigurationError
            As "forward", where a leg has no length; unless `short_legs`, whose rows are NaN then.
        """
        vectors, shape = configuration.leg_vectors, configuration.shape
        lengths = np.sqrt((vectors**2).sum(axis=-1, keepdims=True))
        short = (lengths == 0.0).any(axis=(-1, -2))
        if short.any() and not short_legs:
            raise SingularConfigurationError("forward", 0.0, first_offender(short))
        geometry, centre = configuration.geometry, configuration.middle_joints.mean(axis=-2)
        side = geometry.nominal.middle_side
        arms = (configuration.balls - centre[..., None, :]) / side

        def rows(forces: FloatArray) -> FloatArray:
            return np.concatenate([forces, np.cross(arms, forces)], axis=-1).reshape(*shape, 2, 3, 6)

        lever = configuration.translation - centre
        exists = configuration.exists
        # The axes of the lower legs do not depend on the state: one that does not exist has none of them either.
        axes = np.where(exists[..., None, None], configuration.leg_axes, np.nan)
        return cls(rows(vectors / lengths), rows(axes), lever, side, exists)

    def matrices(self, kind: str) -> FloatArray:
        """Return the matrices (..., n, 6, 6) of a kind of singularity: "forward", J_b and J_c, or "inverse", K."""
        if kind == "forward":
            return np.concatenate([self.legs, self.constraints], axis=-2)
        return self.constraints.reshape(*self.exists.shape, 1, 6, 6)


def singular_sizes(geometry: Geometry) -> tuple[float, float, float, float]:
    """Return E, C, d [m], and `SINGULAR`, as the kernels that look for singular states take them."""
    return *geometry.dimensions, SINGULAR


def refuse_singular(configuration: Configuration, suspect: npt.NDArray[np.uint8], kind: str) -> None:
    """Raise if one of the states that a kernel suspects, of (S,) in their order, is singular to rounding.

    Raises
    ------
    SingularConfigurationError
        Of this `kind`, "forward" or "inverse", or "constraint".
    """
    at = np.flatnonzero(suspect)
    if not len(at):
        return
    shape = configuration.shape
    places = np.unravel_index(at, shape) if shape else ()
    some = configuration[places] if shape else configuration
    try:
        wrenches = StageWrenches.of(some)
    except SingularConfigurationError as short:
        first = short.index[0] if short.index else 0
        raise SingularConfigurationError(short.kind, short.sigma_min, _index(places, first)) from None
    values = np.linalg.svd(wrenches.matrices(kind), compute_uv=False).reshape(len(at), -1, 6)
    smallest = np.where(values[..., -1] <= SINGULAR * values[..., 0], values[..., -1], np.inf).min(axis=-1)
    if not (smallest < np.inf).any():
        return
    first = int((smallest < np.inf).argmax())
    structure = np.linalg.svd(wrenches.constraints.reshape(len(at), 2, 3, 6)[first], compute_uv=False)
    dependent = structure[:, -1] <= SINGULAR * structure[:, 0]
    if dependent.any():
        raise SingularConfigurationError("constraint", float(structure[:, -1].min()), _index(places, first))
    raise SingularConfigurationError(kind, float(smallest[first]), _index(places, first))


@np.errstate(invalid="ignore")  # states that do not exist are NaN throughout
def regular_wrenches(configuration: Configuration, kind: str) -> StageWrenches:
    """Return the wrenches of states that are not singular in this way, "forward" or "inverse"; raise if one is."""
    wrenches = StageWrenches.of(configuration)
    matrices = wrenches.matrices(kind)
    # No singular value is less than the determinant over the fifth power of the largest.
    bound = SINGULAR * (matrices**2).sum(axis=(-1, -2)) ** 3
    suspect = (np.abs(np.linalg.det(matrices)) <= bound).any(axis=-1)
    refuse_singular(configuration, suspect.reshape(-1).astype(np.uint8), kind)
    return wrenches


@np.errstate(invalid="ignore")
def stage_inverses(configuration: Configuration) -> FloatArray:
    """Return J_b⁻¹ and J_c⁻¹ (..., 2, 6, 6), with twists (v, ω) at o in {B} [m/s, rad/s] for rows.

    Raises
    ------
    SingularConfigurationError
        At a forward or a constraint singularity.
    """
    wrenches = regular_wrenches(configuration, "forward")
    inverses = np.linalg.inv(wrenches.matrices("forward"))
    angular = inverses[..., 3:, :] / wrenches.side
    lever = wrenches.lever[..., None, None, :]
    moved = np.swapaxes(np.cross(np.swapaxes(angular, -1, -2), lever), -1, -2)
    return np.concatenate([inverses[..., :3, :] + moved, angular], axis=-2)


def _index(places: tuple[IntArray, ...], which: int) -> tuple[int, ...]:
    return tuple(int(axis[which]) for axis in places)
