from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest

import spm_pin as spm
from spm_pin import nlp
from spm_pin.crosscheck.joint_data import joint_data
from spm_pin.description.closures import read_closures
from spm_pin.description.paths import URDF, description_file
from spm_pin.multibody.chain import ClosedChain

PLATFORM = "terminal_platform"
CLOSURES = [(closure.frame_a, closure.frame_b) for closure in read_closures()]
FRAMES = [PLATFORM, *dict.fromkeys(name for pair in CLOSURES for name in pair)]


@pytest.fixture(scope="module")
def model() -> pin.Model:
    return pin.buildModelFromUrdf(str(description_file(URDF)))


def test_forward_kinematics_equals_pinocchio(model: pin.Model) -> None:
    joints = joint_data(model, FRAMES)
    kinematics = nlp.forward_kinematics(joints)
    data = model.createData()
    rng = np.random.default_rng(0)
    for _ in range(50):
        q = rng.uniform(-3.0, 3.0, model.nq)
        pin.framesForwardKinematics(model, data, q)
        expected = [data.oMi[i] for i in range(1, model.njoints)]
        expected += [data.oMf[model.getFrameId(name)] for name in FRAMES]
        found = [np.asarray(part) for part in kinematics(q)]
        for k, placement in enumerate(expected):
            np.testing.assert_allclose(found[2 * k], placement.rotation, rtol=0, atol=1e-14)
            # Slides reach 3 m: the rounding of a position is that of a few metres.
            np.testing.assert_allclose(found[2 * k + 1].ravel(), placement.translation, rtol=0, atol=1e-14)


def test_closure_of_the_paper_s_branches(model: pin.Model) -> None:
    geometry = spm.Geometry.paper()
    pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    chain = ClosedChain.from_urdf()
    closure = nlp.joint_space_closure(joint_data(model, FRAMES), CLOSURES, PLATFORM, length=geometry.middle_side)
    assert closure.size_out("jacobian") == (18, 18)
    for state in spm.inverse_displacement(geometry, pose):
        q = chain.joint_values(state)
        residual = np.asarray(closure(q, state.rotation, state.translation)[0])
        assert np.abs(residual).max() < 1e-14
        start, close = q + 1e-4, q + 1e-4
        for _ in range(6):
            value, jacobian = (np.asarray(part) for part in closure(close, state.rotation, state.translation))
            close = close - np.linalg.solve(jacobian, value).ravel()
        assert np.abs(start - q).max() > 0.0
        np.testing.assert_allclose(close, q, rtol=0, atol=1e-10)


def test_closure_jacobian_by_finite_differences(model: pin.Model) -> None:
    closure = nlp.joint_space_closure(joint_data(model, FRAMES), CLOSURES, PLATFORM)
    rng = np.random.default_rng(2)
    q = rng.uniform(-0.5, 0.5, 18)
    pose = np.eye(3), np.array([0.1, 0.2, 2.0])
    jacobian = np.asarray(closure(q, *pose)[1])
    step = 1e-6
    for k in range(18):
        up, down = q.copy(), q.copy()
        up[k] += step
        down[k] -= step
        slope = (np.asarray(closure(up, *pose)[0]) - np.asarray(closure(down, *pose)[0])).ravel() / (2 * step)
        np.testing.assert_allclose(jacobian[:, k], slope, rtol=0, atol=1e-8)


def test_it_is_symbolic() -> None:
    turn = nlp.Joint("turn", None, np.eye(3), np.zeros(3), "revolute", (0.0, 0.0, 1.0))
    tip = nlp.Joint("tip", "turn", np.eye(3), (1.0, 0.0, 0.0), "fixed")
    kinematics = nlp.forward_kinematics([turn, tip], ["tip"])
    q = ca.SX.sym("q")
    _, position = kinematics(q)
    speed = ca.Function("speed", [q], [ca.norm_2(ca.jacobian(position, q))])
    assert float(speed(0.7)) == pytest.approx(1.0, abs=1e-15)


JOINT = nlp.Joint("a", None, np.eye(3), np.zeros(3), "prismatic")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: nlp.Joint("a", None, np.eye(3), np.zeros(3), "spherical"), "kind: expected one of revolute"),
        (lambda: nlp.Joint("a", None, np.eye(3), np.zeros(3), "revolute", (0, 0, 2)), "axis: expected a unit vector"),
        (lambda: nlp.Joint("a", None, np.eye(4), np.zeros(3), "fixed"), "rotation"),
        (lambda: nlp.forward_kinematics([JOINT, JOINT]), "a twice"),
        (lambda: nlp.forward_kinematics([JOINT], ["b"]), "frames: expected names of the tree"),
        (
            lambda: nlp.forward_kinematics([nlp.Joint("b", "a", np.eye(3), np.zeros(3), "fixed"), JOINT]),
            "A parent comes before its children",
        ),
        (lambda: nlp.joint_space_closure([JOINT], [("a", "z")], "a"), "closures"),
    ],
)
def test_bad_trees_are_refused(make: object, words: str) -> None:
    assert callable(make)
    with pytest.raises(spm.ArgumentError, match=words):
        make()


def test_unknown_joints_and_frames_of_a_model_are_refused(model: pin.Model) -> None:
    with pytest.raises(spm.ArgumentError, match="frames of the model"):
        joint_data(model, ["nowhere"])
    floating = pin.buildModelFromUrdf(str(description_file(URDF)), pin.JointModelFreeFlyer())
    with pytest.raises(spm.ArgumentError, match="revolute and prismatic"):
        joint_data(floating)
