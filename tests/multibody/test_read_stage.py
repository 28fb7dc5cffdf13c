"""Tripods of files as stages: against MuJoCo's own places, and against the stages that files were written from."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from balancers import MACHINES, existing_states, stage_and_height
from error_fields import with_fields
from multibody.tripods import Tripod
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.description import extended_urdf_text, mjcf_text, sdf_text, urdf_text
from spm_pin.errors import ArgumentError, DescriptionError

pin = pytest.importorskip("pinocchio")
mujoco = pytest.importorskip("mujoco")

from spm_pin.loops import ClosedChain  # noqa: E402
from spm_pin.multibody import MeasuredStage, read_stage  # noqa: E402

SOMEWHERE = RigidTransform.from_components([0.4, -1.0, 2.0], Rotation.from_euler("xyz", [2.5, 0.4, -1.0]))
CLOCKWISE, ELSEWHERE = (100.0, -20.0, 220.0), (200.0, 320.0, 80.0)
PRS_LEG = {"rod": 0.4, "direction": np.pi / 2.0, "sign": -1.0}
RRS_LEG = {"crank": 0.05, "rod": 0.11, "sign": -1.0}
TRIPODS = {
    "RPS": Tripod("RPS", 0.7, 0.46, 1.1, seed=1),
    "RPS that shorten": Tripod(
        "RPS", 0.7, 0.46, 1.1, {}, CLOCKWISE, "ball", SOMEWHERE, 2, (0.1, -0.2, 0.3), (-1.0, 1.0, -1.0), (-0.3, 0.2)
    ),
    "PRS": Tripod(
        "PRS", 0.35, 0.2, 0.5, PRS_LEG, ELSEWHERE, "weld", SOMEWHERE, 3, (0.1, 0.1, 0.1), (1.0,) * 3, (-0.1, 0.3)
    ),
    "PRS of other zeros": Tripod("PRS", 0.35, 0.2, 0.5, PRS_LEG, CLOCKWISE, "connect", SOMEWHERE, 4, (0.1, 0.0, -0.2)),
    "PRS downwards": Tripod("PRS", 0.35, 0.2, 0.5, PRS_LEG, CLOCKWISE, "ball", senses=(-1.0, 1.0, -1.0), seed=5),
    "PRS hanging": Tripod("PRS", 0.35, 0.2, -0.5, PRS_LEG | {"sign": 1.0}, ELSEWHERE, "connect", SOMEWHERE, 6),
    "PRS inwards": Tripod("PRS", 0.5, 0.2, 0.6, PRS_LEG | {"direction": 0.75 * np.pi}, ELSEWHERE, "weld", SOMEWHERE, 7),
    "PRS radial": Tripod("PRS", 0.3, 0.2, 0.3, PRS_LEG | {"direction": 0.0, "sign": 1.0}, CLOCKWISE, "ball", seed=8),
    "RRS": Tripod("RRS", 0.08, 0.09, 0.12, RRS_LEG, ELSEWHERE, "connect", SOMEWHERE, 9, (0.3, 0.3, 0.3)),
    "RRS inwards": Tripod(
        "RRS",
        0.08,
        0.09,
        0.12,
        RRS_LEG | {"sign": 1.0},
        CLOCKWISE,
        "weld",
        SOMEWHERE,
        10,
        (3.0, -2.0, 0.5),
        (1.0, -1.0, 1.0),
        (-0.6, 0.5),
    ),
    "RRS at odd angles": Tripod("RRS", 0.08, 0.09, 0.12, RRS_LEG, (40.0, 150.0, 275.0), "ball", SOMEWHERE, 11),
}
"""In every kind: all ways to close the loops, legs in other orders, zeros and senses; z of the hanging one is down."""


@cache
def read(name: str) -> tuple[ClosedChain, MeasuredStage]:
    chain = ClosedChain.from_mjcf(TRIPODS[name].text())
    return chain, read_stage(chain)


def qpos_of(chain: ClosedChain, model: Any, q: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return MuJoCo's values of the joints, by their names or those of their bodies."""
    qpos = model.qpos0.copy()
    for name in chain.joint_names:
        values, at = q[chain.indices_in_q(name)], None
        for number in range(model.njnt):
            own = model.joint(number).name or f"{model.body(model.jnt_bodyid[number]).name}_joint1"
            at = int(model.jnt_qposadr[number]) if own == name else at
        if values.size > 1:
            values[-4:] = np.roll(values[-4:], 1)
        qpos[at : at + values.size] = values
    return qpos


@pytest.mark.parametrize("name", TRIPODS)
def test_the_plate_is_where_mujoco_has_it(name: str) -> None:
    chain, found = read(name)
    tripod, near = TRIPODS[name], chain.close()
    model = mujoco.MjModel.from_xml_string(tripod.text())
    data = mujoco.MjData(model)
    height = float((found.base.inv() * placed(model, model.qpos0, found)).translation[2])
    states = existing_states(found.stage, height, 6)
    assert len(states) > 2
    path = chain.forward(found.values(states.readings), near=near)
    for k, q in enumerate(path):
        data.qpos = qpos_of(chain, model, q)
        mujoco.mj_forward(model, data)
        equality = data.efc_type[: data.nefc] == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        assert np.abs(data.efc_pos[: data.nefc][equality]).max() < 1e-12
        state = spm.forward_physical(found.stage, found.readings(q[chain.actuated_in_q]))
        seen = found.base.inv() * placed(model, data.qpos, found)
        np.testing.assert_allclose(seen.as_matrix(), state.pose.as_matrix(), rtol=0, atol=1e-9)
        np.testing.assert_allclose(seen.as_matrix(), states.pose[k].as_matrix(), rtol=0, atol=1e-9)


def placed(model: Any, qpos: npt.NDArray[np.float64], found: MeasuredStage) -> RigidTransform:
    """Return the platform's frame {n} in the world, as MuJoCo has it."""
    data = mujoco.MjData(model)
    data.qpos = qpos
    mujoco.mj_kinematics(model, data)
    body = data.body(found.platform)
    plate = RigidTransform.from_components(body.xpos, Rotation.from_matrix(body.xmat.reshape(3, 3)))
    return plate * found.platform_pose


@pytest.mark.parametrize("name", TRIPODS)
def test_dimensions_are_those_that_the_file_was_written_with(name: str) -> None:
    chain, found = read(name)
    tripod, stage = TRIPODS[name], found.stage
    assert stage.is_nominal == (np.ptp(np.diff(np.sort(tripod.azimuths))) < 1e-9)
    base_radius = tripod.base_radius
    if tripod.kind == "PRS":  # from the knee, back along the slide to where joint values are zero
        slid = np.dot(tripod.senses, tripod.zeros) / 3.0
        base_radius += tripod.knee()[0] - slid * np.cos(tripod.numbers["direction"])
    np.testing.assert_allclose(stage.dimensions, [base_radius, tripod.platform_radius], rtol=1e-9)
    assert stage.kind.has_equal_legs
    assert found.platform == "plate"
    assert found.joints == chain.actuated == ("a_motor", "b_motor", "c_motor")
    assert found.legs[0] == 0
    for number in ("rod", "crank"):
        if number in tripod.numbers:
            np.testing.assert_allclose(getattr(stage.kind, number), tripod.numbers[number], rtol=1e-9)
    if tripod.kind == "RRS":
        assert stage.kind.sign == tripod.numbers["sign"]
    if tripod.limits is None:
        assert stage.limits is None
    else:
        ends = [found.readings(np.array(tripod.zeros) + end) for end in tripod.limits]
        np.testing.assert_allclose(stage.reading_limits, np.sort(ends, axis=0), atol=1e-12)
    readings = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    np.testing.assert_allclose(found.readings(found.values(readings)), readings, atol=1e-15)


def test_readings_of_cranks_and_cylinders_in_the_home() -> None:
    """By the law of cosines, and Pythagoras."""
    for name in ("RPS", "RPS that shorten", "RRS", "RRS inwards"):
        tripod = TRIPODS[name]
        readings = read(name)[1].readings(tripod.zeros)
        x, z = tripod.knee()
        expected = np.hypot(0.46 - 0.7, 1.1) if tripod.kind == "RPS" else np.arctan2(z, x)
        np.testing.assert_allclose(readings, expected, atol=1e-12)


def test_equal_zeros_and_a_common_sense_are_kept_for_carriages() -> None:
    for name in ("PRS", "PRS inwards", "PRS radial"):
        values = np.array([0.1, 0.2, -0.1])
        np.testing.assert_allclose(np.sort(read(name)[1].readings(values)), np.sort(values), atol=1e-15)


@pytest.mark.parametrize("name", MACHINES)
@pytest.mark.parametrize("form", ["mjcf", "urdf", "sdf"])
def test_files_written_for_a_stage_are_read_back(name: str, form: str) -> None:
    stage, height = stage_and_height(name)
    own = spm.ClosedChain.from_urdf(machine=stage)
    states = existing_states(stage, height, 6)
    q = own.joint_values(states)
    if form == "mjcf":
        chain = ClosedChain.from_mjcf(mjcf_text(stage))
    elif form == "urdf":
        chain = ClosedChain.from_urdf(urdf_text(stage), extended_urdf_text(stage))
    else:
        chain = ClosedChain.from_sdf(sdf_text(stage), actuated=[own.joint_names[k] for k in own.leg_indices])
    found = read_stage(chain)
    assert found.stage.is_nominal == stage.is_nominal
    if stage.is_nominal:
        np.testing.assert_allclose(found.stage.dimensions, stage.dimensions, rtol=1e-12)
    values = q[:, own.joint_indices(*found.joints)]
    back = spm.forward_physical(found.stage, found.readings(values))
    model, data = own.model, own.model.createData()
    for k, pose in enumerate(found.base * back.pose * found.platform_pose.inv()):
        pin.framesForwardKinematics(model, data, q[k])
        expected = data.oMf[model.getFrameId(found.platform)].homogeneous
        np.testing.assert_allclose(pose.as_matrix(), expected, rtol=0, atol=1e-9)


def test_a_base_that_is_given_keeps_its_axes() -> None:
    """The file's axes at the base: azimuths of the legs, tilts and shifts refer to them."""
    azimuths = np.radians([0.0, 120.0, 240.0])
    expected = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), azimuths=azimuths)
    tripod = Tripod("RRS", 0.08, 0.09, 0.12, RRS_LEG, (240.0, 0.0, 120.0), base=SOMEWHERE)
    found = read_stage(ClosedChain.from_mjcf(tripod.text()), base=SOMEWHERE)
    assert not found.stage.is_nominal
    np.testing.assert_array_equal(found.legs, [1, 2, 0])
    np.testing.assert_allclose(found.stage.parameters, expected.parameters, atol=1e-12)
    np.testing.assert_allclose(found.base.as_matrix(), SOMEWHERE.as_matrix(), atol=1e-15)
    upside_down = SOMEWHERE * RigidTransform.from_rotation(Rotation.from_euler("x", np.pi))
    for wrong in (upside_down, RigidTransform.from_matrix([np.eye(4)] * 2), "base"):
        with pytest.raises(ArgumentError):
            read_stage(ClosedChain.from_mjcf(tripod.text()), base=wrong)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "change", "expected"),
    [
        ("RPS", "four legs", "three legs"),
        ("RPS", "floating", "three legs"),
        ("RPS", "skew slide", "perpendicular"),
        ("RPS", "bent slide", "straight away"),
        ("RRS", "skew knee", "parallel axes"),
        ("RRS", "upright", "parallel to z"),
        ("RRS", "driven knees", "an actuator of"),
        ("PRS", "motors missing", "an actuator of"),
        ("RRS", "coupled", "independently"),
    ],
)
def test_what_is_no_such_tripod_is_refused(name: str, change: str, expected: str) -> None:
    chain = ClosedChain.from_mjcf(TRIPODS[name].text(change))
    with pytest.raises(DescriptionError, check=with_fields(argument="chain")) as error:
        read_stage(chain)
    assert expected in error.value.expected


@pytest.mark.parametrize("file", ["delta", "stewart", "five_bar", "tricept", "ankle", "two_3rps", "two_3spr"])
def test_other_robots_are_refused(file: str) -> None:
    folder = Path(__file__).parents[2] / "examples/robots"
    with pytest.raises(DescriptionError):
        read_stage(ClosedChain.from_mjcf(folder / f"{file}.xml"))


def test_a_home_with_stretched_legs_shows_no_working_mode() -> None:
    stretched = Tripod("RRS", 0.08, 0.09, float(np.sqrt(0.159999999**2 - 0.01**2)), RRS_LEG)
    with pytest.raises(DescriptionError) as error:
        read_stage(ClosedChain.from_mjcf(stretched.text()))
    assert "working modes" in error.value.expected


def test_rounded_numbers_are_read_with_a_tolerance() -> None:
    text = TRIPODS["RPS"].text("skew slide")
    found = read_stage(ClosedChain.from_mjcf(text), tolerance=0.02)
    assert found.stage.is_nominal
