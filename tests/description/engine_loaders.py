"""One interface to the engines: each loads a file of the robot itself."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from spm_pin.description.source_files import Closure, read_closures

Array = npt.NDArray[np.float64]
Values = Mapping[str, float]


class Engine(Protocol):
    """A robot in an engine."""

    @property
    def joints(self) -> list[str]:
        """Names of the moving joints in the order of the engine's q."""

    def frames(self, values: Values) -> dict[str, Array]:
        """Pose (4, 4) of every link in the world."""

    def gaps(self, values: Values) -> Array:
        """Return the gaps of the engine's closures, as read from the file, shape (4, 3) [m]."""

    def mass_matrix(self, values: Values) -> Array:
        """Joint-space inertia in the order of q."""


class Pinocchio:
    def __init__(self, path: Path, closures: Iterable[Closure] | None = None) -> None:
        import pinocchio as pin

        self.pin = pin
        if path.suffix == ".xml":
            self.model, points, frames = pin.buildModelAndConstraintsFromMJCF(str(path))
            self.constraints = [*points, *frames]
        else:
            # Pinocchio reads no closures from a URDF: those of the description, unless others are given.
            self.model = pin.buildModelFromUrdf(str(path))
            self.constraints = []
            for closure in read_closures() if closures is None else closures:
                ends = (self.model.frames[self.model.getFrameId(f)] for f in (closure.frame_a, closure.frame_b))
                placed = [part for end in ends for part in (end.parentJoint, end.placement)]
                self.constraints.append(pin.PointAnchorConstraintModel(self.model, *placed))
        self.data = self.model.createData()

    @property
    def joints(self) -> list[str]:
        return list(self.model.names)[1:]

    def q(self, values: Values) -> Array:
        q = np.zeros(self.model.nq)
        for joint, value in values.items():
            model = self.model.joints[self.model.getJointId(joint)]
            # A continuous joint of a URDF is a point on the unit circle.
            q[model.idx_q : model.idx_q + model.nq] = value if model.nq == 1 else (np.cos(value), np.sin(value))
        return q

    def frames(self, values: Values) -> dict[str, Array]:
        self.pin.framesForwardKinematics(self.model, self.data, self.q(values))
        bodies = [f for f in self.model.frames if f.type == self.pin.FrameType.BODY and f.name != "universe"]
        return {f.name: self.data.oMf[self.model.getFrameId(f.name, f.type)].homogeneous.copy() for f in bodies}

    def gaps(self, values: Values) -> Array:
        self.pin.forwardKinematics(self.model, self.data, self.q(values))
        gaps = []
        for constraint in self.constraints:
            data = constraint.createData()
            constraint.calc(self.model, self.data, data)
            gaps.append(data.oMc2.translation - data.oMc1.translation)
        return np.array(gaps)

    def mass_matrix(self, values: Values) -> Array:
        upper = np.triu(self.pin.crba(self.model, self.data, self.q(values)))
        return np.asarray(upper + np.triu(upper, 1).T)


class Mujoco:
    def __init__(self, path: Path) -> None:
        import mujoco

        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)

    @property
    def joints(self) -> list[str]:
        return [self.model.joint(i).name for i in range(self.model.njnt)]

    def set(self, values: Values) -> None:
        self.mujoco.mj_resetData(self.model, self.data)
        for joint, value in values.items():
            self.data.joint(joint).qpos[0] = value
        self.mujoco.mj_forward(self.model, self.data)

    def frames(self, values: Values) -> dict[str, Array]:
        self.set(values)
        poses = {}
        for i in range(1, self.model.nbody):
            body = self.data.body(i)
            poses[body.name] = np.eye(4)
            poses[body.name][:3, :3] = body.xmat.reshape(3, 3)
            poses[body.name][:3, 3] = body.xpos
        return poses

    def gaps(self, values: Values) -> Array:
        self.set(values)
        equality = self.data.efc_type == self.mujoco.mjtConstraint.mjCNSTR_EQUALITY
        return np.asarray(self.data.efc_pos[equality].reshape(-1, 3))

    def mass_matrix(self, values: Values) -> Array:
        self.set(values)
        full = np.zeros((self.model.nv, self.model.nv))
        self.mujoco.mj_fullM(self.model, self.data, full)
        return full


class Drake:
    def __init__(self, path: Path) -> None:
        from pydrake.multibody.inverse_kinematics import InverseKinematics
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import DiscreteContactApproximation, MultibodyPlant

        self.plant = MultibodyPlant(1e-3)
        self.plant.set_discrete_contact_approximation(DiscreteContactApproximation.kSap)  # ball constraints need SAP
        Parser(self.plant).AddModels(str(path))
        if path.suffix == ".urdf":
            self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName("base"))
        self.plant.Finalize()
        self.context = self.plant.CreateDefaultContext()
        # Drake hands its ball constraints over as the equations of an inverse-kinematics program; keep it.
        self.kinematics = InverseKinematics(self.plant, with_joint_limits=False)
        self.equations = self.kinematics.prog().GetAllConstraints()
        moving = [self.plant.get_joint(i) for i in self.plant.GetJointIndices()]
        self.moving = sorted((j for j in moving if j.num_positions()), key=lambda joint: joint.position_start())

    @property
    def joints(self) -> list[str]:
        return [joint.name() for joint in self.moving]

    def set(self, values: Values) -> Array:
        q = np.zeros(self.plant.num_positions())
        for name, value in values.items():
            q[self.plant.GetJointByName(name).position_start()] = value
        self.plant.SetPositions(self.context, q)
        return q

    def bodies(self) -> list[Any]:
        bodies = [self.plant.get_body(i) for i in self.plant.GetBodyIndices(self.plant.GetModelInstanceByName("spm"))]
        return [body for body in bodies if body.name() != "world"]

    def frames(self, values: Values) -> dict[str, Array]:
        self.set(values)
        return {body.name(): body.EvalPoseInWorld(self.context).GetAsMatrix4() for body in self.bodies()}

    def gaps(self, values: Values) -> Array:
        q = self.set(values)
        rows = [equation.evaluator() for equation in self.equations]
        assert all((row.lower_bound() == row.upper_bound()).all() for row in rows)
        return np.array([row.Eval(q) - row.lower_bound() for row in rows])

    def mass_matrix(self, values: Values) -> Array:
        self.set(values)
        return np.asarray(self.plant.CalcMassMatrixViaInverseDynamics(self.context))


class Yourdfpy:
    def __init__(self, path: Path) -> None:
        import yourdfpy

        self.robot = yourdfpy.URDF.load(io.BytesIO(path.read_bytes()), load_meshes=False)
        assert self.robot.validate()

    @property
    def joints(self) -> list[str]:
        return list(self.robot.actuated_joint_names)

    def frames(self, values: Values) -> dict[str, Array]:
        self.robot.update_cfg(dict(values))
        return {link: self.robot.get_transform(link, "base") for link in self.robot.link_map}


def worst_frame(found: Mapping[str, Array], expected: Mapping[str, Array]) -> tuple[float, str]:
    """Largest difference of two sets of poses, and the link it is in."""
    assert found.keys() == expected.keys()
    return max((float(np.abs(found[link] - expected[link]).max()), link) for link in expected)


def reordered(matrix: Array, have: list[str], want: Iterable[str]) -> Array:
    order = [have.index(name) for name in want]
    return np.asarray(matrix[np.ix_(order, order)])


ENGINES: dict[str, Callable[[Path], Engine]] = {"pinocchio": Pinocchio, "mujoco": Mujoco, "drake": Drake}
