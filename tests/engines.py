"""The robot, or a stage, in Pinocchio, MuJoCo, Drake and yourdfpy, each of which reads a file of it by itself."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from spm_pin.description import URDF_PATH
from spm_pin.description.robot import read_robot
from spm_pin.description.source_files import read_closures
from spm_pin.machine import Machine

Array = npt.NDArray[np.float64]
Values = Mapping[str, float]
Forces = Callable[[float, Array, Array], Array]

SHIPPED = Path(URDF_PATH)
JOINTS = [joint.name for joint in read_robot().moving]
"""The moving joints of the shipped robot in the order of a chain; engines of another take its own."""


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


class Moving(Engine, Protocol):
    """An engine that has the terms of M a + h = Sᵀ f + Jᵀ λ and J a + d = 0, in the order of a chain's joints."""

    def terms(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        """Return M, h, J and d."""


def accelerations(engine: Moving, legs: Array, q: Array, v: Array, f: Array) -> Array:
    """Solve the engine's own equations with hard constraints."""
    mass, bias, jacobian, drift = engine.terms(q, v)
    n, m = len(q), len(drift)
    matrix = np.block([[mass, jacobian.T], [jacobian, np.zeros((m, m))]])
    force = -bias
    force[legs] += f
    return np.linalg.solve(matrix, np.concatenate([force, -drift]))[:n]


class Pinocchio:
    def __init__(self, path: Path, machine: Machine | None = None) -> None:
        import pinocchio as pin

        self.pin = pin
        if path.suffix == ".xml":
            self.model, points, frames = pin.buildModelAndConstraintsFromMJCF(str(path))
            self.constraints = [*points, *frames]
        else:
            # Pinocchio reads no closures from a URDF.
            self.model = pin.buildModelFromUrdf(str(path))
            self.constraints = []
            for closure in read_closures(machine):
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
            q[self.model.joints[self.model.getJointId(joint)].idx_q] = value
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
    """A URDF gets the loops that it does not name, made for time steps of `step`.

    Its collisions and joint limits are off: they are not what is compared.
    """

    def __init__(
        self,
        path: Path = SHIPPED,
        joints: Sequence[str] = JOINTS,
        *,
        step: float = 1e-3,
        integrator: str = "mjINT_EULER",
        machine: Machine | None = None,
    ) -> None:
        import mujoco

        self.mujoco = mujoco
        spec = mujoco.MjSpec.from_file(str(path))
        closures = read_closures(machine)
        if path.suffix == ".urdf":
            connect, body = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtObj.mjOBJ_BODY
            for closure in closures:
                equality = spec.add_equality(type=connect, objtype=body, name1=closure.frame_a, name2=closure.frame_b)
                equality.data = np.zeros_like(equality.data)
                # As stiff as MuJoCo lets it be: time constant of two steps, critically damped, largest impedance.
                equality.solref = [2.0 * step, 1.0]
                equality.solimp = [0.9999, 0.9999, 1e-3, 0.5, 2.0]
            spec.option.timestep, spec.option.integrator = step, getattr(mujoco.mjtIntegrator, integrator)
            spec.option.tolerance, spec.option.iterations = 0.0, 50
            spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.order = np.array([int(self.model.joint(name).qposadr[0]) for name in joints])
        assert [int(self.model.joint(name).dofadr[0]) for name in joints] == list(self.order)
        self.pairs = [[self.model.body(frame).id for frame in (c.frame_a, c.frame_b)] for c in closures]

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

    def _mass_matrix(self) -> Array:
        full = np.zeros((self.model.nv, self.model.nv))
        self.mujoco.mj_fullM(self.model, self.data, full)
        return full

    def mass_matrix(self, values: Values) -> Array:
        self.set(values)
        return self._mass_matrix()

    def terms(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        model, data, k = self.model, self.data, self.order
        data.qpos[k], data.qvel[k] = q, v
        self.mujoco.mj_forward(model, data)
        rows, rates = np.zeros((2, len(self.pairs), 2, 3, model.nv))
        for pair, at, rate in zip(self.pairs, rows, rates, strict=True):
            for end, body in enumerate(pair):
                self.mujoco.mj_jac(model, data, at[end], None, data.xpos[body], body)
                self.mujoco.mj_jacDot(model, data, rate[end], None, data.xpos[body], body)
        jacobian, change = ((each[:, 1] - each[:, 0]).reshape(-1, model.nv) for each in (rows, rates))
        return self._mass_matrix()[np.ix_(k, k)], data.qfrc_bias[k].copy(), jacobian[:, k], change @ data.qvel

    def run(self, q: Array, v: Array, forces: Forces, until: float, legs: Array) -> Array:
        """MuJoCo's own steps from q and v; returns the q they end at."""
        data, k = self.data, self.order
        self.mujoco.mj_resetData(self.model, data)
        data.qpos[k], data.qvel[k] = q, v
        for _ in range(round(until / self.model.opt.timestep)):
            data.qfrc_applied[k[legs]] = forces(data.time, data.qpos[k], data.qvel[k])
            self.mujoco.mj_step(self.model, data)
        return np.array(data.qpos[k])


class Drake:
    def __init__(self, path: Path = SHIPPED, joints: Sequence[str] = JOINTS) -> None:
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
        self.order = np.array([self.joints.index(name) for name in joints])
        assert [joint.velocity_start() for joint in self.moving] == list(range(len(joints)))

    @property
    def joints(self) -> list[str]:
        return [joint.name() for joint in self.moving]

    def set(self, values: Values) -> Array:
        q = np.array([values.get(name, 0.0) for name in self.joints])
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

    def terms(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        from pydrake.multibody.tree import JacobianWrtVariable

        plant, context, world, k = self.plant, self.context, self.plant.world_frame(), self.order
        both = np.empty((2, len(q)))
        both[:, k] = q, v
        plant.SetPositionsAndVelocities(context, both.ravel())
        bias = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        rows, drift = [], []
        for c in read_closures():
            frames = (plant.GetFrameByName(name) for name in (c.frame_a, c.frame_b))
            calls = [(context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world) for frame in frames]
            a, b = (plant.CalcJacobianTranslationalVelocity(*arguments) for arguments in calls)
            rows.append(b - a)
            a, b = (plant.CalcBiasTranslationalAcceleration(*arguments).ravel() for arguments in calls)
            drift.append(b - a)
        return plant.CalcMassMatrix(context)[np.ix_(k, k)], bias[k], np.concatenate(rows)[:, k], np.concatenate(drift)


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


ENGINES: dict[str, Callable[[Path], Engine]] = {"pinocchio": Pinocchio, "mujoco": Mujoco, "drake": Drake}
