"""Methods of a state for batches of q and v, as `ClosedChain` and `MountedChain` have them.

Those of both take q (..., nq) and v (..., nv) of the `model`, and forces (..., n) of its actuators. For a chain by
itself, nq and nv are 18, and the actuators are the six legs. On another robot, its own joints and actuators are among
them, see `MountedChain.actuated_indices`, and the universe takes the place of {B}. The others are of a chain by itself,
about the twist, the wrench and the legs at q (..., 18) of a closed mechanism.
"""

from __future__ import annotations

from functools import partial

import numpy.typing as npt

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.multibody.batched_states import ChainLike
from spm_pin.multibody.constrained_state import ChainState, ConstrainedState
from spm_pin.multibody.dynamics import Energy, NaturalFrequencies, PlatformDynamics
from spm_pin.multibody.regularity import SingularValues
from spm_pin.multibody.vector_arguments import GainsLike, WrenchLike, read_gains, read_stiffness


def closure_gap(self: ChainLike, q: npt.ArrayLike) -> FloatArray:
    """Return how far the closures are open: from `frame_a` to `frame_b` of each, in {B} [m], shape (..., 4, 3)."""
    return self._states.array(ConstrainedState.closure_gap, (4, 3), q)


def constraint_jacobian(self: ChainLike, q: npt.ArrayLike) -> FloatArray:
    """Return the derivative of `closure_gap` by q, shape (..., 12, nv), three rows per closure.

    Its transpose maps forces in {B} onto the closures' `frame_b`, with the opposite onto `frame_a`, to
    generalized forces. Exact at any q.
    """
    return self._states.array(ConstrainedState.constraint_jacobian, (12, self._states.constrained.model.nv), q)


def forward_dynamics(
    self: ChainLike,
    q: npt.ArrayLike,
    v: npt.ArrayLike,
    forces: npt.ArrayLike,
    wrench: WrenchLike = None,
    *,
    gains: GainsLike = None,
) -> FloatArray:
    """Return the accelerations of all joints (..., nv) [rad/s², m/s²] under actuators, gravity and wrenches.

    Parameters
    ----------
    q, v : array_like, shapes (..., nq), (..., nv)
        Joint values, and joint velocities [rad/s, m/s].
    forces : array_like, shape (..., n)
        Of the actuators [N, N m].
    wrench : array_like, shape (..., 6), or mapping of str to such, optional
        Onto the terminal platform; or several, each onto the link or frame of that name, at its origin.
    gains : pair of float, optional
        (kp, kd) [1/s², 1/s], not negative, after Baumgarte: open gaps e then obey ë + kd ė + kp e = 0, for those
        who integrate by themselves. Without, q and v must be closed, and the accelerations keep them so.

    Raises
    ------
    ArgumentError
        If an argument is malformed, v opens the loops, or a ball joint's middle angle is ±90°.
    ClosureError
        If q is open.
    SingularConfigurationError
        At a constraint singularity. Inverse and forward singularities are no obstacle.
    """
    constrained = self._states.constrained
    wrenches, stabilisation = constrained.read_wrenches(wrench), read_gains(gains)
    member = partial(ConstrainedState.forward_dynamics, gains=stabilisation)
    return self._states.array(member, (constrained.model.nv,), q, v=v, forces=forces, wrench=wrenches)


def inverse_dynamics(
    self: ChainLike, q: npt.ArrayLike, v: npt.ArrayLike, a: npt.ArrayLike, wrench: WrenchLike = None
) -> FloatArray:
    """Return the forces of the actuators (..., n) [N, N m] for a motion under gravity, inertia and wrenches.

    q, v and a (..., nv) are those of a closed mechanism, `wrench` is as in `forward_dynamics`. At rest, the weights
    of all bodies are left; `ClosedChain.leg_forces` has the wrench alone.

    Raises
    ------
    ArgumentError
        If an argument is malformed, v or a opens the loops, or a ball joint's middle angle is ±90°.
    ClosureError
        If q is open.
    SingularConfigurationError
        At a forward or a constraint singularity.
    """
    constrained = self._states.constrained
    wrenches = constrained.read_wrenches(wrench)
    shape = (constrained.actuated.size,)
    return self._states.array(ConstrainedState.inverse_dynamics, shape, q, v=v, a=a, wrench=wrenches)


def energy(self: ChainLike, q: npt.ArrayLike, v: npt.ArrayLike) -> Energy:
    """Return the kinetic and the potential energy (...) [J] of all bodies at q and v, closed or not."""
    return Energy(*self._states.over(ConstrainedState.energy, ((), ()), q, v=v))


def inverse_jacobian(self: ChainLike, q: npt.ArrayLike) -> FloatArray:
    """Return J_f (..., 6, 6), which maps the platform's twist to the leg rates; q is closed.

    Raises `SingularConfigurationError` at an inverse or a constraint singularity.
    """
    return self._states.array(ChainState.inverse_jacobian, (6, 6), q)


def joint_velocities(self: ChainLike, q: npt.ArrayLike, twist: npt.ArrayLike) -> FloatArray:
    """Return the velocities of all joints (..., 18) [rad/s, m/s] for a twist of m, in the order of `joint_names`.

    The twist is (..., 6); else as `inverse_jacobian`.
    """
    return self._states.array(ChainState.joint_velocities, (18,), q, twist=twist)


def joint_rates(self: ChainLike, q: npt.ArrayLike, leg_rates: npt.ArrayLike) -> FloatArray:
    """Return the velocities of all joints (..., 18) [rad/s, m/s] for rates of the six legs (..., 6) [m/s].

    q is closed; the other way is `joint_velocities`. Raises `SingularConfigurationError` at a forward or a
    constraint singularity.
    """
    return self._states.array(ChainState.joint_rates, (18,), q, leg_rates=leg_rates)


def leg_forces(self: ChainLike, q: npt.ArrayLike, wrench: npt.ArrayLike) -> FloatArray:
    """Return the actuator forces (..., 6) [N] that hold a wrench (..., 6) applied onto the terminal platform.

    Weights and friction are left out: `inverse_dynamics` has the weights. Raises `SingularConfigurationError` at a
    forward or a constraint singularity.
    """
    return self._states.array(ChainState.leg_forces, (6,), q, wrench=wrench)


def cut_forces(self: ChainLike, q: npt.ArrayLike, wrench: npt.ArrayLike) -> FloatArray:
    """Return the forces in the ball joints where the tree is cut, shape (..., 4, 3) [N] in {B}.

    Per closure, what the middle platform (`frame_a`) exerts onto the tip of the leg (`frame_b`); the leg exerts
    the opposite onto the middle platform. Arguments and errors are those of `leg_forces`.
    """
    return self._states.array(ChainState.cut_forces, (4, 3), q, wrench=wrench)


def singular_values(self: ChainLike, q: npt.ArrayLike) -> SingularValues:
    """Return how near q (..., 18) is to each kind of singularity, without raising `SingularConfigurationError`."""
    return SingularValues(*self._states.over(ChainState.singular_values, ((), (), ()), q))


def joint_accelerations(self: ChainLike, q: npt.ArrayLike, v: npt.ArrayLike, acceleration: npt.ArrayLike) -> FloatArray:
    """Return the accelerations of all joints (..., 18) for one of the terminal platform (..., 6).

    That is the time derivative of the twist: of the point o [m/s²], and angular [rad/s²], in {B}. q and v (..., 18)
    are those of a closed mechanism. Raises `ClosureError` if q is open, `ArgumentError` if v opens the loops, and
    `SingularConfigurationError` at an inverse or a constraint singularity.
    """
    return self._states.array(ChainState.joint_accelerations, (18,), q, v=v, acceleration=acceleration)


def platform_dynamics(self: ChainLike, q: npt.ArrayLike, v: npt.ArrayLike) -> PlatformDynamics:
    """Return the equations of motion at the terminal platform, Λ ṫ + C t + G = J_fᵀ f + w, of all bodies' masses.

    q, v and the errors are those of `joint_accelerations`.
    """
    return PlatformDynamics(*self._states.over(ChainState.platform_dynamics, ((6, 6), (6, 6), (6,), (6,)), q, v=v))


def natural_frequencies(self: ChainLike, q: npt.ArrayLike, stiffness: npt.ArrayLike) -> NaturalFrequencies:
    """Return the small vibrations of the platform with its motors held, on legs that are elastic.

    q is closed, `stiffness` (..., 6, 6) the platform's as of `spm_pin.stiffness`; all bodies' masses take part as
    if rigid. What weights add to the stiffness is left out: it is of the size of weight / leg length. Raises
    `ClosureError` if q is open, `ArgumentError` if a matrix is not symmetric and positive definite, and
    `SingularConfigurationError` at an inverse or a constraint singularity.
    """
    matrices = read_stiffness(stiffness)

    def member(state: ChainState, matrix: FloatArray) -> NaturalFrequencies:
        return state.natural_frequencies(matrix.reshape(6, 6))

    flat = matrices.reshape(*matrices.shape[:-2], 36)
    return NaturalFrequencies(*self._states.over(member, ((6,), (6, 6)), q, stiffness=flat))
