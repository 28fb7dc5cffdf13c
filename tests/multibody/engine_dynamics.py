"""The mechanism in MuJoCo and in Drake: masses and Jacobians of the engines, and time steps of MuJoCo.

Both read the same URDF as Pinocchio does. Collisions and joint limits are off: they are not what is compared.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from multibody.chains import Array

from spm_pin.description import urdf_text
from spm_pin.description.source_files import URDF, description_file
from spm_pin.description.tree import SLIDES

Forces = Callable[[float, Array, Array], Array]


class Engine(Protocol):
    """Terms of M a + h = Sᵀ f + Jᵀ λ and J a + d = 0, in the order of a chain's joints."""

    def terms(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]: ...


def accelerations(engine: Engine, legs: Array, q: Array, v: Array, f: Array) -> Array:
    """Solve the engine's own equations with hard constraints."""
    mass, bias, jacobian, drift = engine.terms(q, v)
    n, m = len(q), len(drift)
    matrix = np.block([[mass, jacobian.T], [jacobian, np.zeros((m, m))]])
    force = -bias
    force[legs] += f
    return np.linalg.solve(matrix, np.concatenate([force, -drift]))[:n]


def rk4(rate: Callable[[float, Array], Array], state: Array, until: float, steps: int) -> Array:
    """The classical method, as in any textbook; nothing brings the state back onto the closures."""
    h = until / steps
    for k in range(steps):
        t = k * h
        k1 = rate(t, state)
        k2 = rate(t + h / 2, state + h / 2 * k1)
        k3 = rate(t + h / 2, state + h / 2 * k2)
        k4 = rate(t + h, state + h * k3)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return state


class Mujoco:
    def __init__(
        self,
        robot: Any,
        step: float = 1e-3,
        integrator: str = "mjINT_EULER",
        locked: bool = False,
        urdf: Path | None = None,
    ) -> None:
        import mujoco

        self.mj = mujoco
        spec = mujoco.MjSpec.from_file(str(urdf or description_file(URDF)))
        for closure in robot.closures:
            equality = spec.add_equality()
            equality.type, equality.objtype = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtObj.mjOBJ_BODY
            equality.name, equality.name1, equality.name2 = closure.name, closure.frame_a, closure.frame_b
            equality.data = np.zeros_like(equality.data)
            self._stiffen(equality, step)
        for name in SLIDES if locked else ():
            equality = spec.add_equality()
            equality.type, equality.objtype = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtObj.mjOBJ_JOINT
            equality.name, equality.name1 = f"lock_{name}", name
            equality.data = np.zeros_like(equality.data)
            self._stiffen(equality, step)
        self.model = spec.compile()
        self.model.opt.timestep = step
        self.model.opt.integrator = getattr(mujoco.mjtIntegrator, integrator)
        self.model.opt.tolerance, self.model.opt.iterations = 0.0, 50
        for flag in ("mjDSBL_CONTACT", "mjDSBL_LIMIT"):
            self.model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, flag))
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(name) for name in robot.joint_names]
        self.order = np.array([int(joint.qposadr[0]) for joint in joints])
        assert [int(joint.dofadr[0]) for joint in joints] == list(self.order)
        self.pairs = [(self.model.body(c.frame_a).id, self.model.body(c.frame_b).id) for c in robot.closures]

    @staticmethod
    def _stiffen(equality: Any, step: float) -> None:
        # As stiff as MuJoCo lets a constraint be: time constant of two steps, critically damped, largest impedance.
        equality.solref = [2.0 * step, 1.0]
        equality.solimp = [0.9999, 0.9999, 1e-3, 0.5, 2.0]

    def set(self, q: Array, v: Array) -> None:
        self.data.qpos[self.order], self.data.qvel[self.order] = q, v

    def hold(self, slides: Array) -> None:
        """Lock the slides, made with `locked`, at these values."""
        for k, value in enumerate(slides):
            self.model.eq_data[len(self.pairs) + k, 0] = value

    def terms(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        mj, model, data = self.mj, self.model, self.data
        self.set(q, v)
        mj.mj_forward(model, data)
        mass = np.zeros((model.nv, model.nv))
        mj.mj_fullM(model, data, mass)
        rows, drift = [], []
        for a, b in self.pairs:
            jacobians, rates = [], []
            for body in (a, b):
                found, changing = np.zeros((3, model.nv)), np.zeros((3, model.nv))
                mj.mj_jac(model, data, found, None, data.xpos[body], body)
                mj.mj_jacDot(model, data, changing, None, data.xpos[body], body)
                jacobians.append(found)
                rates.append(changing)
            rows.append(jacobians[1] - jacobians[0])
            drift.append((rates[1] - rates[0]) @ data.qvel)
        k = self.order
        return mass[np.ix_(k, k)], data.qfrc_bias[k].copy(), np.concatenate(rows)[:, k], np.concatenate(drift)

    def run(self, q: Array, v: Array, forces: Forces, until: float, legs: Sequence[int]) -> Array:
        """MuJoCo's own steps from q and v; returns the q they end at."""
        self.mj.mj_resetData(self.model, self.data)
        self.set(q, v)
        where = self.order[legs]
        for _ in range(round(until / self.model.opt.timestep)):
            now = self.data.qpos[self.order].copy(), self.data.qvel[self.order].copy()
            self.data.qfrc_applied[where] = forces(self.data.time, *now)
            self.mj.mj_step(self.model, self.data)
        return np.array(self.data.qpos[self.order])


class Drake:
    def __init__(self, robot: Any, urdf: Path | None = None) -> None:
        from pydrake.multibody.parsing import Parser
        from pydrake.multibody.plant import MultibodyPlant

        text = urdf.read_text(encoding="utf-8") if urdf else urdf_text()
        # A continuous plant has no constraints.
        start, end = text.index("<drake:ball_constraint>"), text.rindex("</drake:ball_constraint>")
        text = text[:start] + text[end + len("</drake:ball_constraint>") :]
        self.plant = MultibodyPlant(0.0)
        with tempfile.TemporaryDirectory() as folder:  # in a text without a file, Drake takes no paths of meshes
            path = Path(folder) / "spm.urdf"
            path.write_text(text, encoding="utf-8")
            Parser(self.plant).AddModels(str(path))
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName("base"))
        for name in robot.joint_names:
            joint = self.plant.GetJointByName(name)
            joint.set_position_limits([-np.inf], [np.inf])
        self.plant.Finalize()
        self.context = self.plant.CreateDefaultContext()
        joints = [self.plant.GetJointByName(name) for name in robot.joint_names]
        self.order = np.array([joint.position_start() for joint in joints])
        assert [joint.velocity_start() for joint in joints] == list(self.order)
        self.pairs = [tuple(self.plant.GetFrameByName(name) for name in (c.frame_a, c.frame_b)) for c in robot.closures]

    def set(self, q: Array, v: Array) -> None:
        both = np.empty((2, len(q)))
        both[:, self.order] = q, v
        self.plant.SetPositions(self.context, both[0])
        self.plant.SetVelocities(self.context, both[1])

    def terms(self, q: Array, v: Array) -> tuple[Array, Array, Array, Array]:
        from pydrake.multibody.tree import JacobianWrtVariable

        plant, context, world = self.plant, self.context, self.plant.world_frame()
        self.set(q, v)
        bias = plant.CalcBiasTerm(context) - plant.CalcGravityGeneralizedForces(context)
        rows, drift = [], []
        for pair in self.pairs:
            calls = [(context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world) for frame in pair]
            jacobians = [plant.CalcJacobianTranslationalVelocity(*arguments) for arguments in calls]
            accelerations = [plant.CalcBiasTranslationalAcceleration(*arguments).ravel() for arguments in calls]
            rows.append(jacobians[1] - jacobians[0])
            drift.append(accelerations[1] - accelerations[0])
        k = self.order
        return plant.CalcMassMatrix(context)[np.ix_(k, k)], bias[k], np.concatenate(rows)[:, k], np.concatenate(drift)
