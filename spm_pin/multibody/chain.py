"""The mechanism as a Pinocchio model whose loops are closed by constraints."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from spm_pin.description.source_files import description_directory
from spm_pin.description.tree import Closure, read_closures, srdf_text
from spm_pin.mechanism.arguments import FloatArray, IntArray, broadcastable
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.multibody import batched_methods, chain_kinematics, simulation, trajectory
from spm_pin.multibody.batched_states import BatchedStates
from spm_pin.multibody.constrained_model import ConstrainedModel
from spm_pin.multibody.constrained_state import ChainState
from spm_pin.multibody.joint_layout import JointLayout
from spm_pin.multibody.loading import read_description
from spm_pin.multibody.mounting import MountedChain, mount
from spm_pin.multibody.vector_arguments import read_vectors


class ClosedChain:
    """The spanning tree of the description in Pinocchio, and the closures that make it the mechanism; read-only.

    Made by `from_urdf`. {B} is the link `base` and Pinocchio's universe. Methods take q, joint values [rad, m] in the
    order of `joint_names`, of one state or of a batch (..., 18), and raise `ArgumentError` if it has another shape, is
    not finite, or gives a leg a negative length. Leading axes of several arguments broadcast. Pinocchio answers one
    state at a time, so that a batch takes as long as its members; `joint_values`, and `forward_kinematics` and
    `inverse_kinematics` without `near`, are vectorised closed forms. `state` computes several quantities of one q
    and v. For a chain by itself nq = nv = 18, and the n = 6 actuators are the legs.

    The geometry may be that of a machine as built: leg lengths are then its readings, offsets included, and joint
    values zero at the home of the nominal machine, where its loops are open by about its errors.

    Wrenches are (f, m) [N, N m] onto the terminal platform at o in the axes of {B}, twists (v, ω) [m/s, rad/s] of it;
    legs are in the order r_b1, r_b2, r_b3, r_c1, r_c2, r_c3, and a positive leg force pushes, to extend the leg.
    Methods that use rates or forces raise `ArgumentError` where a ball joint's middle angle is ±90°, and
    `SingularConfigurationError` at the singularities they name; see `spm_pin.multibody.regularity.SINGULAR`.

    A subclass with other constructor arguments needs its own `__reduce__`.

    Parameters
    ----------
    urdf : str
        Text of the description expanded for `geometry` and `prefix`; not checked here.
    geometry : Geometry
        Its dimensions, and the limits that set its zero.
    prefix : str
        Before the name of every link and joint.
    """

    def __init__(self, urdf: str, geometry: Geometry, prefix: str = "") -> None:
        self._urdf, self._geometry, self._prefix = urdf, geometry, prefix
        self._model = pin.buildModelFromXML(urdf)
        self._layout = JointLayout(self._model, geometry, prefix)
        constrained = ConstrainedModel(self._model, self._layout, read_closures(prefix=prefix))
        self._states = BatchedStates(constrained, ChainState)

    @classmethod
    def from_urdf(
        cls,
        path: str | Path | None = None,
        geometry: Geometry | None = None,
        *,
        prefix: str = "",
    ) -> ClosedChain:
        """Make a chain from the package's description, or from a URDF file expanded from it.

        A file at `path` has the description's tree, perhaps with other inertias, shapes and limits; the closures are
        the description's. `geometry` is by default that of the file, without a file the paper's; that of a machine as
        built, an AsBuiltGeometry, goes with a file that was written for it. `prefix` stands before the name of every
        link and joint. Raises `DescriptionError` if the file cannot be read or is another tree, its
        inertias are impossible or `prefix` cannot begin a name, and `GeometryError` if the dimensions of the file are
        not those of `geometry`.
        """
        return cls(*read_description(path, geometry, prefix), prefix)

    def __reduce__(self) -> tuple[Any, ...]:
        # Pinocchio's constraints cannot be pickled.
        return type(self), (self._urdf, self._geometry, self._prefix)

    def __repr__(self) -> str:
        named = f" {self._prefix!r}" if self._prefix else ""
        return f"<ClosedChain{named}: {self._model.nq} joints, {len(self.closures)} closures, {self._geometry}>"

    @property
    def model(self) -> Any:
        """The spanning tree, a `pinocchio.Model`; do not change it."""
        return self._model

    @property
    def closures(self) -> tuple[Closure, ...]:
        """The closures, in the order of all results per closure."""
        return self._states.constrained.closures

    @property
    def geometry(self) -> Any:
        """Dimensions and leg limits, a `Geometry`."""
        return self._geometry

    @property
    def prefix(self) -> str:
        """Before the name of every link and joint."""
        return self._prefix

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of q."""
        return self._layout.names_in_model

    @property
    def leg_indices(self) -> IntArray:
        """Indices of the legs' prismatic joints in q, shape (6,)."""
        return self._layout.legs.copy()

    def joint_indices(self, *names: str) -> IntArray:
        """Return the indices in q (n,) of joints named as in the URDF; raise `ArgumentError` for an unknown name."""
        return self._layout.indices(*(name.removeprefix(self._prefix) for name in names))

    @cached_property
    def visual_model(self) -> Any:
        """The visual shapes, a `pinocchio.GeometryModel`."""
        folder = str(description_directory())
        return pin.buildGeomFromUrdfString(self._model, self._urdf, pin.GeometryType.VISUAL, package_dirs=folder)

    @cached_property
    def collision_model(self) -> Any:
        """The collision shapes, a `pinocchio.GeometryModel`; the pairs leave out what touches by design."""
        shapes = pin.buildGeomFromUrdfString(self._model, self._urdf, pin.GeometryType.COLLISION)
        shapes.addAllCollisionPairs()
        pin.removeCollisionPairsFromXML(self._model, shapes, srdf_text({}, prefix=self._prefix))
        return shapes

    def robot_wrapper(self) -> Any:
        """Return a new `pinocchio.RobotWrapper` of the tree; it has no closures."""
        return pin.RobotWrapper(self._model, self.collision_model, self.visual_model)

    def mounted_on(self, other: Any, frame: str, placement: Any = None) -> MountedChain:
        """Return this chain carried by another robot, as an arm carries a tool, in one model with its loops closed.

        `other` is a pinocchio.Model or pinocchio.RobotWrapper whose base stays where it is, `frame` one of its frames
        such as `tool0`, `placement` the pinocchio.SE3 of {B} in it, by default the identity. Raises `ArgumentError` if
        one of them is malformed, or both robots have a link, joint or frame of the same name: `from_urdf` takes a
        prefix.
        """
        return mount(self, other, frame, placement, carried=False)

    def carrying(self, other: Any, frame: str = "terminal_platform", placement: Any = None) -> MountedChain:
        """Return this chain with another robot on it, whose universe is fixed to a frame of the chain.

        `frame` is named without prefix, `placement` is that of the other robot's universe in it; else as `mounted_on`.
        """
        return mount(self, other, f"{self._prefix}{frame}", placement, carried=True)

    def state(self, q: npt.ArrayLike, v: npt.ArrayLike | None = None) -> ChainState:
        """Return the state of joint values q (18,) and velocities v (18,), by default at rest.

        It has the chain's methods about rates, forces and dynamics, without q and v, and `joint_accelerations_of_legs`
        and `platform_acceleration` besides. They share what they compute; `state.update(q, v)` moves it on. In a
        control loop it saves reading and computing the same twice.
        """
        return ChainState(self._states.constrained).update(q, v)

    def joint_values(self, configuration: Configuration) -> FloatArray:
        """Return q (..., 18) of a configuration, in closed form and vectorised: angles in [-π, π].

        Its leg limits play no part. The tree is closed to rounding, or as far as the configuration is. Raises
        `ArgumentError` if a member does not exist or is not closed to 1e-9 of the middle platform's side, and
        `GeometryError` if the dimensions are not the chain's, those of a machine as built with all its errors.
        """
        return self._layout.joint_values(configuration)

    def configuration(self, q: npt.ArrayLike) -> Configuration:
        """Return the configuration in q (..., 18): the poses of m and of the middle platform's corners.

        If q is not closed, neither is the configuration, and its leg lengths are those between its points, not
        those of q.
        """

        def member(state: ChainState) -> tuple[FloatArray, ...]:
            return state.kinematics.configuration_arrays()

        return Configuration.from_arrays(self._geometry, *self._states.over(member, ((3, 3), (3,), (3, 3)), q))

    def leg_lengths(self, q: npt.ArrayLike) -> FloatArray:
        """Return the leg lengths [m] of the slides in q (..., 18), shape (..., 6)."""
        return self._layout.leg_lengths(self._states.constrained.checked(q))

    def with_leg_lengths(self, q: npt.ArrayLike, leg_lengths: npt.ArrayLike) -> FloatArray:
        """Return a copy of q (..., 18) with other leg lengths (..., 6) [m], all other joints as they are.

        That opens the loops; `forward_kinematics` keeps them closed.
        """
        checked = self._states.constrained.checked
        joints, lengths = checked(q), read_vectors(leg_lengths, "leg_lengths", 6)
        shape = broadcastable("leg_lengths", lengths.shape[:-1], "q", joints.shape[:-1])
        changed = np.broadcast_to(joints, (*shape, joints.shape[-1])).copy()
        changed[..., self._layout.legs] = lengths - self._layout.home
        return checked(changed)

    # Methods that are written in the files of their subjects; their `self` is the chain.
    project = chain_kinematics.project
    forward_kinematics = chain_kinematics.forward_kinematics
    inverse_kinematics = chain_kinematics.inverse_kinematics
    closure_gap = batched_methods.closure_gap
    constraint_jacobian = batched_methods.constraint_jacobian
    singular_values = batched_methods.singular_values
    inverse_jacobian = batched_methods.inverse_jacobian
    joint_velocities = batched_methods.joint_velocities
    joint_rates = batched_methods.joint_rates
    joint_accelerations = batched_methods.joint_accelerations
    leg_forces = batched_methods.leg_forces
    cut_forces = batched_methods.cut_forces
    forward_dynamics = batched_methods.forward_dynamics
    inverse_dynamics = batched_methods.inverse_dynamics
    platform_dynamics = batched_methods.platform_dynamics
    natural_frequencies = batched_methods.natural_frequencies
    energy = batched_methods.energy
    joint_trajectory = trajectory.joint_trajectory
    simulate = simulation.simulate
