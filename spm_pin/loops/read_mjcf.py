"""Robots from MJCF files, over the model that MuJoCo compiles: what is read is what MuJoCo would simulate."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.errors import DescriptionError, require_extra
from spm_pin.loops.closures import Anchor, Closure, JointEquality, RobotDescription
from spm_pin.loops.links import Joint, JointKind, Link, build_model, describe, hinges_of_points, place
from spm_pin.loops.xml_input import read_source
from spm_pin.support.arguments import FloatArray, name_sequence


def read_mjcf(source: Any, *, actuated: Sequence[str] | None = None) -> RobotDescription:
    """Return a robot of an MJCF file.

    Parameters
    ----------
    source : path, str or mujoco.MjModel
        A file, its text, or a model that MuJoCo has compiled already.
    actuated : sequence of str, optional
        Names of the actuated joints; by default those of the file's actuators, in their order.

    Notes
    -----
    Read are bodies, all joints, sites, active `connect`, `weld` and `joint` equalities, actuators, keyframes, joint
    limits, armature, damping and friction, and gravity. Two points between the same bodies, as far apart on one as
    on the other, are read as the hinge that they make. q is MuJoCo's `qpos`, `ref` included, but quaternions have
    their scalar last, as in Pinocchio. A joint without a name is called after its body, `shin_joint1`; a site with the
    name of a body `foot_site`. Not part of the model are contacts, springs, tendons' forces and gears of actuators.
    Equalities between tendons or flexes are refused.

    Raises
    ------
    DescriptionError
        A file that MuJoCo cannot compile, or one with constraints or actuators that cannot be kept.
    MissingExtraError
        MuJoCo is not installed; the extra `mjcf` brings it.
    """
    require_extra("mjcf", "mujoco")
    import mujoco

    compiled, where = source, "model"
    if not isinstance(source, mujoco.MjModel):
        text, where = read_source(source, "<", "a mujoco.MjModel, an MJCF file")
        if "<robot" in text:
            # MuJoCo reads a URDF without its loops.
            raise DescriptionError(where, "an MJCF file, whose root is <mujoco>", "<robot>", "Use from_urdf")
        try:
            # A file may include others beside it.
            of_text = where == "text"
            compiled = mujoco.MjModel.from_xml_string(text) if of_text else mujoco.MjModel.from_xml_path(where)
        except ValueError as error:
            raise DescriptionError(where, "an MJCF file that MuJoCo compiles", str(error).strip()) from None
    return _Mjcf(mujoco, compiled, where).describe(actuated)


class _Mjcf:
    """A compiled model, and names for all that has none."""

    def __init__(self, mujoco: Any, model: Any, source: str) -> None:
        self.mujoco, self.model, self.source = mujoco, model, source
        self.bodies: list[str | None] = [None]
        self.bodies += [model.body(i).name or f"body{i}" for i in range(1, model.nbody)]
        self.joints = []
        for i in range(model.njnt):
            body = int(model.jnt_bodyid[i])
            number = i - int(model.body_jntadr[body]) + 1
            self.joints.append(model.joint(i).name or f"{self.bodies[body]}_joint{number}")
        names = [model.site(i).name or f"site{i}" for i in range(model.nsite)]
        self.sites = [f"{name}_site" if name in self.bodies else name for name in names]

    def describe(self, actuated: Sequence[str] | None) -> RobotDescription:
        m = self.model
        sites = {
            name: (self.bodies[m.site_bodyid[i]], _pose(m.site_pos[i], m.site_quat[i]))
            for i, name in enumerate(self.sites)
        }
        model = build_model(m.names.split(b"\0")[0].decode(), self._links(), sites, self.source)
        weightless = m.opt.disableflags & int(self.mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        model.gravity.linear = np.zeros(3) if weightless else m.opt.gravity
        closures, equalities = self._equalities()
        keys = {m.key(i).name or f"key{i}": self._configuration(model, m.key_qpos[i]) for i in range(m.nkey)}
        rest = self._configuration(model, m.qpos0)
        names = self._actuated() if actuated is None else name_sequence(actuated, "actuated")
        return describe(model, closures, equalities, names, keys, self.source, rest)

    def _links(self) -> Iterator[Link]:
        m = self.model
        for i in range(1, m.nbody):
            address, count = int(m.body_jntadr[i]), int(m.body_jntnum[i])
            joints = tuple(self._joint(k) for k in range(address, address + count))
            inertial = _pose(m.body_ipos[i], m.body_iquat[i])
            inertia = inertial.act(pin.Inertia(float(m.body_mass[i]), np.zeros(3), np.diag(m.body_inertia[i])))
            # The value of a free joint is the pose itself.
            free = any(joint.kind == "free" for joint in joints)
            placement = pin.SE3.Identity() if free else _pose(m.body_pos[i], m.body_quat[i])
            yield Link(self.bodies[i] or "", self.bodies[m.body_parentid[i]], placement, joints, inertia)

    def _joint(self, i: int) -> Joint:
        m = self.model
        kinds: list[JointKind] = ["free", "ball", "slide", "hinge"]
        kind, axis, dof = kinds[m.jnt_type[i]], m.jnt_axis[i], int(m.jnt_dofadr[i])
        anchor = place() if kind == "free" else place(m.jnt_pos[i])
        before, after = anchor, anchor.inverse()
        if kind in ("slide", "hinge"):
            # The body is in its place in the file at the value `ref`, not at zero.
            reference = -float(m.qpos0[m.jnt_qposadr[i]])
            turned = pin.exp3(reference * axis) if kind == "hinge" else np.eye(3)
            before = anchor * place(reference * axis if kind == "slide" else np.zeros(3), turned)
        lower, upper = m.jnt_range[i] if m.jnt_limited[i] and kind in ("slide", "hinge") else (-np.inf, np.inf)
        effort = float(np.abs(m.jnt_actfrcrange[i]).max()) if m.jnt_actfrclimited[i] else np.inf
        numbers = {"lower": float(lower), "upper": float(upper), "effort": effort}
        numbers |= {"armature": float(m.dof_armature[dof]), "damping": float(m.dof_damping[dof])}
        numbers["friction"] = float(m.dof_frictionloss[dof])
        return Joint(self.joints[i], kind, (axis[0], axis[1], axis[2]), before, after, **numbers)

    def _equalities(self) -> tuple[list[Closure], list[JointEquality]]:
        kinds, m = self.mujoco.mjtEq, self.model
        closures, equalities = [], []
        for i in np.flatnonzero(m.eq_active0):
            first, second, data = int(m.eq_obj1id[i]), int(m.eq_obj2id[i]), m.eq_data[i]
            name, kind = m.equality(i).name, kinds(m.eq_type[i])
            if kind == kinds.mjEQ_JOINT:
                joint, driver = self.joints[first], None if second < 0 else self.joints[second]
                zero, driver_zero = (0.0 if k < 0 else float(m.qpos0[m.jnt_qposadr[k]]) for k in (first, second))
                coefficients = tuple(map(float, data[: 1 if driver is None else 5]))
                equalities.append(JointEquality(joint, driver, coefficients, zero, driver_zero, name))
                continue
            if kind not in (kinds.mjEQ_CONNECT, kinds.mjEQ_WELD):
                kept = "connect, weld and joint equalities"
                cause = 'With active="false" it is passed over'
                raise DescriptionError(f"{self.source}, equality {name or i}", kept, kind.name, cause)
            weld = kind == kinds.mjEQ_WELD
            if self.mujoco.mjtObj(m.eq_objtype[i]) == self.mujoco.mjtObj.mjOBJ_SITE:
                # By bodies, so that two points on the same bodies are seen as such.
                poses = [_pose(m.site_pos[k], m.site_quat[k]) for k in (first, second)]
                carriers = [self.bodies[m.site_bodyid[k]] or "universe" for k in (first, second)]
                one, other = (Anchor(body, pose) for body, pose in zip(carriers, poses, strict=True))
            else:
                frames = [self.bodies[k] or "universe" for k in (first, second)]
                places = [place(data[:3]), place(data[3:6])]
                if weld:
                    places = [_pose(data[3:6], data[6:10]), place(data[:3])]
                one, other = (Anchor(frame, at) for frame, at in zip(frames, places, strict=True))
            name = name or f"{'weld' if weld else 'connect'}{i}"
            closures.append(Closure("weld" if weld else "point", one, other, name))
        return hinges_of_points(closures), equalities

    def _actuated(self) -> Iterable[str]:
        m, kinds = self.model, self.mujoco.mjtTrn
        for i in range(len(m.actuator_trntype)):
            acts = kinds(m.actuator_trntype[i])
            if acts not in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
                name, cause = m.actuator(i).name or i, "Name the joints that move it: actuated=[...]"
                raise DescriptionError(f"{self.source}, actuator {name}", "an actuator of a joint", acts.name, cause)
            yield self.joints[m.actuator_trnid[i, 0]]

    def _configuration(self, model: Any, qpos: FloatArray) -> FloatArray:
        """Return Pinocchio's q for a `qpos`."""
        m = self.model
        q: FloatArray = pin.neutral(model)
        for i, name in enumerate(self.joints):
            joint, at = model.joints[model.getJointId(name)], int(m.jnt_qposadr[i])
            values = np.array(qpos[at : at + joint.nq])
            if joint.nq > 1:  # MuJoCo's quaternions have the scalar first, and need not be of unit length
                values[-4:] = np.roll(values[-4:], -1) / np.linalg.norm(values[-4:])
            q[joint.idx_q : joint.idx_q + joint.nq] = values
        return q


def _pose(position: FloatArray, quaternion: FloatArray) -> Any:
    """Return a `pinocchio.SE3` of a position and a quaternion with its scalar first."""
    scalar, *vector = map(float, quaternion)
    return place(position, pin.Quaternion(scalar, *vector).normalized().matrix())
