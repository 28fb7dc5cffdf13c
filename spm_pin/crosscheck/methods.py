"""Independent methods for the same problems of a manipulator or a stage; they share types and no code.

Each returns None for what it does not compute, and states the closure residual that its arithmetic may leave and how
often its route may lose a branch. Large libraries are imported when a method that needs them is made.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from spm_pin.crosscheck.paper import resultant
from spm_pin.crosscheck.paper.jacobian import CORRECT, J_f, Table5Mistakes, f_r
from spm_pin.errors import ArgumentError, GeometryError
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.rates_and_forces import inverse_jacobian, leg_forces
from spm_pin.machine import Configuration, SolutionSet
from spm_pin.machine.machine import Machine
from spm_pin.machine.manipulator import check_rps
from spm_pin.support.arguments import FloatArray

ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
"""Closure residual of a backward stable route, relative to the size of the robot: the closed form's worst
over 10⁵ poses is 45 eps, see `docs/theory/inverse_displacement.md`."""
_REFINE = 30
"""Newton steps on Eq. (13): near a double root four leave residuals a thousand times as large as rounding."""


@dataclass
class Method:
    """A method to compare; subclasses override what they compute."""

    machine: Any
    """The manipulator or the stage."""
    name: str = ""
    """Its name in the report."""
    miss_rate: float = 0.0
    """Fraction of poses at which it may miss branches."""
    share: float = 1.0
    """Fraction of the poses that it solves, less than one for slow methods."""

    def inverse(self, pose: RigidTransform) -> SolutionSet | None:
        """Return the branches of poses (N,); for a stage of their heights and normals."""
        return None

    def inverse_jacobian(self, configuration: Configuration) -> FloatArray | None:
        """Return J_f (N, 6, 6), for a stage (N, 3, 3), of states (N,) in SI; NaN where a state is singular."""
        return None

    def leg_forces(self, configuration: Configuration, wrench: FloatArray) -> FloatArray | None:
        """Return the efforts (N, 6) or (N, 3) of states (N,) that balance wrenches (N, 6); NaN where singular."""
        return None

    def assembled(self, configuration: Configuration) -> Configuration | None:
        """Return states (N,) as the method's own model assembles them from their joint values."""
        return None

    def rounding(self, configuration: Configuration) -> FloatArray:
        """Return the closure residual [m] that its arithmetic may leave at states (N,)."""
        return ROUNDING * _magnitude(configuration)


def _magnitude(configuration: Configuration) -> FloatArray:
    """Return the size of the numbers in the loop equations [m], shape (...)."""
    distance = np.linalg.norm(configuration.translation, axis=-1)
    balls = np.abs(configuration.balls[..., :3, :]).max(axis=(-1, -2))
    return np.asarray(sum(configuration.machine.dimensions) + distance + balls)


@dataclass
class ClosedForm(Method):
    """Four quadratics, or for a stage one equation, and forces through the ball joints: `spm_pin.kinematics`."""

    name: str = "closed form"

    def inverse(self, pose: RigidTransform) -> SolutionSet:
        """Solve poses (N,)."""
        if self.machine.is_stage:
            matrix = pose.as_matrix()
            return inverse_displacement(self.machine, matrix[..., 2, 3], normal=matrix[..., :3, 2])
        return inverse_displacement(self.machine, pose)

    inverse_jacobian = staticmethod(inverse_jacobian)
    leg_forces = staticmethod(leg_forces)


@dataclass
class Paper(Method):
    """The paper's octic, its 9 x 9 Jacobian and its statics: `spm_pin.crosscheck.paper`.

    Its route loses branches in floating point, at up to 4 % of all poses: see `docs/theory/inverse_displacement.md`.
    """

    name: str = "paper"
    miss_rate: float = 0.05
    mistakes: Table5Mistakes = CORRECT
    """Mistakes of the paper's Table 5 to repeat; none by default."""

    def __post_init__(self) -> None:
        is_one = self.machine.is_stage
        if is_one or not self.machine.is_nominal:
            expected = "a nominal manipulator of RPS legs, whose equations are those of the paper"
            cause = "Leave the method paper out"
            raise GeometryError("machine", expected, "a stage" if is_one else "a calibrated machine", cause)
        check_rps(self.machine, "the paper's equations")

    def inverse(self, pose: RigidTransform) -> SolutionSet:
        """Solve poses (N,)."""
        return resultant.inverse_displacement(self.machine, pose, refine=_REFINE)

    def inverse_jacobian(self, configuration: Any) -> FloatArray:
        """Return J_f (N, 6, 6)."""
        return J_f(configuration, self.mistakes)

    def leg_forces(self, configuration: Any, wrench: FloatArray) -> FloatArray:
        """Return forces (N, 6) [N]."""
        return f_r(configuration, wrench[..., :3], wrench[..., 3:], self.mistakes)

    def rounding(self, configuration: Any) -> FloatArray:
        """Return the closure residual [m], with the squared slopes of the lines in the coefficients of Eq. (13)."""
        along = np.cross(configuration.machine.revolute_axes, configuration.platform_axes)
        with np.errstate(divide="ignore"):
            slope = np.abs(along[..., 2]) / np.linalg.norm(along[..., :2], axis=-1)
        squared = 1.0 + (slope**2).max(axis=-1)
        scale = _magnitude(configuration) / configuration.machine.middle_side
        return np.asarray(ROUNDING * _magnitude(configuration) * scale * squared)


@dataclass
class _MultiStart(Method):
    """CasADi's loop equations, solved from many starts: `spm_pin.crosscheck.nlp`."""

    starts: int = 512
    """Starts at each pose."""
    solver: str = "newton"
    """One of `spm_pin.crosscheck.nlp.SOLVERS`."""

    def __post_init__(self) -> None:
        self._nlp = import_module("spm_pin.crosscheck.nlp")

    def inverse(self, pose: RigidTransform) -> SolutionSet:
        """Solve poses (N,)."""
        search = self._nlp.search(self.machine, pose, starts=self.starts, solver=self.solver)
        solutions: SolutionSet = search.solutions
        return solutions


@dataclass
class Ipopt(_MultiStart):
    """CasADi's loop equations solved by IPOPT, which takes some eighty times as long as `Nlp`; for branches alone."""

    name: str = "ipopt"
    miss_rate: float = 2e-2
    starts: int = 200
    share: float = 0.04
    solver: str = "ipopt"


@dataclass
class Nlp(_MultiStart):
    """CasADi's loop equations, solved by multi-start and differentiated implicitly: `spm_pin.crosscheck.nlp`."""

    name: str = "nlp"
    miss_rate: float = 1e-3

    def __post_init__(self) -> None:
        super().__post_init__()
        self._derivatives = self._nlp.leg_jacobian(self.machine)

    def _derivatives_at(self, configuration: Configuration) -> list[Any]:
        points = configuration.balls[..., :3, :].reshape(-1, 9), configuration.rotation, configuration.translation
        return [self._derivatives(*point) for point in zip(*points, strict=True)]

    def inverse_jacobian(self, configuration: Configuration) -> FloatArray | None:
        """Return J_f (N, 6, 6), for a stage (N, 3, 3)."""
        return np.stack([self._nlp.inverse_jacobian(each) for each in self._derivatives_at(configuration)])

    def leg_forces(self, configuration: Configuration, wrench: FloatArray) -> FloatArray | None:
        """Return efforts (N, 6), for a stage (N, 3), by virtual work; its parasitic motion is that of its balls."""
        derivatives = self._derivatives_at(configuration)
        transposed = np.stack([self._nlp.inverse_jacobian(each) for each in derivatives]).mT
        load = wrench[..., None]
        if self.machine.is_stage:
            closure_b, closure_x = (np.stack([np.asarray(each[k]) for each in derivatives]) for k in (0, 1))
            arms = configuration.balls - configuration.translation[:, None]
            turned = np.cross(np.eye(3), arms[:, :, None]).mT
            of_balls = np.concatenate([np.broadcast_to(np.eye(3), turned.shape), turned], axis=-1).reshape(-1, 9, 6)
            twists = -np.linalg.pinv(of_balls) @ np.linalg.solve(closure_b, closure_x)
            load = twists.mT @ load
        return np.asarray(-np.linalg.solve(transposed, load)[..., 0])


@dataclass
class Pinocchio(Method):
    """The spanning tree with closures in Pinocchio: `spm_pin.multibody`. It solves no inverse displacement."""

    name: str = "pinocchio"

    def __post_init__(self) -> None:
        self.chain = import_module("spm_pin.multibody.chain").ClosedChain.from_urdf(machine=self.machine)

    def inverse_jacobian(self, configuration: Configuration) -> FloatArray:
        """Return J_f (N, 6, 6), for a stage (N, 3, 3)."""
        return np.asarray(self.chain.state(self.chain.joint_values(configuration)).inverse_jacobian())

    def leg_forces(self, configuration: Configuration, wrench: FloatArray) -> FloatArray:
        """Return efforts (N, 6), for a stage (N, 3)."""
        return np.asarray(self.chain.state(self.chain.joint_values(configuration)).leg_forces(wrench))

    def assembled(self, configuration: Configuration) -> Configuration:
        """Return the configurations that the tree's frames give at the joint values of states (N,)."""
        states: Configuration = self.chain.state(self.chain.joint_values(configuration)).configuration()
        return states


METHODS: dict[str, Callable[[Any], Method]] = {
    "closed-form": ClosedForm,
    "paper": Paper,
    "pinocchio": Pinocchio,
    "nlp": Nlp,
    "ipopt": Ipopt,
}
"""Methods by their name on the command line."""


def make_methods(names: Sequence[Method | str] | None, machine: Machine) -> list[Method]:
    """Return methods: by their names in `METHODS`, as given, or all of `METHODS` that can be used.

    These are the methods whose packages can be imported and that take the machine.
    """
    if names is None:
        serving = []
        for maker in METHODS.values():
            with contextlib.suppress(ImportError, GeometryError):
                serving.append(maker(machine))
        return serving
    if isinstance(names, str):
        raise ArgumentError("methods", "a list of methods or names", repr(names), f"Write [{names!r}]")
    unknown = [name for name in names if not isinstance(name, Method) and name not in METHODS]
    if unknown:
        cause = "" if all(isinstance(name, str) for name in unknown) else "Or instances, such as ClosedForm(machine)"
        raise ArgumentError("methods", f"names among {', '.join(METHODS)}", ", ".join(map(str, unknown)), cause)
    return [METHODS[name](machine) if isinstance(name, str) else name for name in names]
