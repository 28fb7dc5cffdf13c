"""The ROS 2 package of a stage, compiled and run against stand-ins for ROS."""

from __future__ import annotations

import ctypes
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from balancers import HEIGHTS, MACHINES, STAGES, requests, stage_and_height
from cli.running import run
from export.c_library import STRICT, compile_c, compilers
from export.test_controllers import STAND_INS, parameters_of, run_cpp, run_scripts
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.description import joint_values
from spm_pin.export import ros_package, write_ros
from spm_pin.export.c_texts import machine_text
from spm_pin.export.ros_export import _stage_sources, start_readings
from spm_pin.machine.joint_angles import joint_names

NAMES = {f"spm_{name}": f"spm_stage_{name}" for name in ("geometry", "state", "forward")}
NAMES |= {"spm_robot": "spm_stage", "SPM_OK": "SPM_STAGE_OK"}
SERVOS = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.5, 1.2))
TURNED = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), azimuths=np.deg2rad([-20.0, 95.0, 205.0]))


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], ctypes.CDLL]:
    """A function that returns the C of a kind of legs, compiled for a nominal stage."""

    @cache
    def of_kind(kind: str) -> ctypes.CDLL:
        folder = tmp_path_factory.mktemp(kind)
        for name, text in _stage_sources(STAGES[kind], "spm_stage_")[0].items():
            (folder / name).write_text(text, encoding="utf-8")
        source, output = folder / "spm_stage_kinematics.c", folder / "kinematics.so"
        compile_c(compilers()[0], *STRICT, "-O1", "-fPIC", "-shared", source, "-lm", "-o", output)
        return ctypes.CDLL(str(output))

    return of_kind


@pytest.mark.parametrize("name", [*MACHINES, "RRS, other azimuths"])
def test_the_c_solves_poses_and_readings_and_gives_all_joints(name: str, library: Callable[[str], ctypes.CDLL]) -> None:
    stage, height = stage_and_height(name) if name in MACHINES else (TURNED, HEIGHTS["RRS"])
    c, machine = library(stage.kind.name), np.concatenate([*_stage_sources(stage, "spm_stage_")[1].values()])

    def call(function: str, *arrays: np.ndarray | None) -> int:
        pointers = [None if x is None else x.ctypes.data_as(ctypes.c_void_p) for x in (machine, *arrays)]
        return int(getattr(c, f"spm_stage_{function}")(*pointers))

    normals, heights = requests(height, 12)
    expected = spm.inverse_physical(stage, heights, normal=normals)
    expected = expected[expected.exists]
    assert len(expected) >= 6
    spin = Rotation.from_rotvec([0.0, 0.0, 0.7]).as_matrix()
    for state in expected:
        solved, again, values = np.empty(24), np.empty(24), np.empty(9)
        # Neither the torsion nor the place beside the axis of a pose counts.
        place = np.array([7.0, -7.0, state.height])
        assert call("inverse", np.ascontiguousarray(state.rotation @ spin), place, None, solved) == 0
        numbers = np.concatenate([state.rotation.ravel(), state.translation, state.readings, state.balls.ravel()])
        np.testing.assert_allclose(solved, numbers, rtol=0, atol=1e-11)
        for near in (None, solved):
            assert call("forward", np.array(state.readings), near, again) == 0
            np.testing.assert_allclose(again, numbers, rtol=0, atol=1e-11)
        assert call("joint_values", solved, values) == 0
        named = joint_values(state)
        np.testing.assert_allclose(values, [named[joint] for joint in joint_names(stage)], rtol=0, atol=1e-11)
        assert call("beyond_limits", np.array(state.readings)) == 0
    assert call("inverse", np.eye(3), np.array([0.0, 0.0, np.nan]), None, solved) < 0


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package of a calibrated stage of servos, with the sources of the nominal one, and its file beside it."""
    folder = tmp_path_factory.mktemp("ros")
    SERVOS.perturbed(3, length=3e-4, angle=1e-3).to_yaml(folder / "machine.yaml")
    done = run("stage", "export", "ros", "--machine", folder / "machine.yaml", "--out", folder / "spm_stage")
    assert done.returncode == 0, done.message
    for name, text in _stage_sources(SERVOS, "spm_stage_")[0].items():
        (folder / "spm_stage/src" / name).write_text(text, encoding="utf-8")
    return folder / "spm_stage"


def test_the_controller_follows_heights_and_normals_and_refuses_bad_ones(package: Path, tmp_path: Path) -> None:
    stage = spm.Stage.from_yaml(package.parent / "machine.yaml")
    lines = [
        f"{name} {' '.join(map(str, x)) if isinstance(x, list) else x}\n" for name, x in parameters_of(package).items()
    ]
    (tmp_path / "parameters.txt").write_text("".join(lines), encoding="utf-8")
    start, near = start_readings(stage)
    state = spm.forward_physical(stage, start + 0.2 * (near.readings - start))
    turned = state.pose.rotation * Rotation.from_rotvec([0.0, 0.0, 0.4])
    np.savetxt(tmp_path / "pose.txt", [[*start, 3.0, -3.0, state.height, *turned.as_quat(), *state.readings]])
    files = tmp_path / "parameters.txt", tmp_path / "pose.txt"
    run_cpp(package, STAND_INS / "ros2_control/drive.cpp", tmp_path, *files, "unreachable", names=NAMES)


def test_bad_set_points_never_break_a_limit(package: Path, tmp_path: Path) -> None:
    stage, parameters = spm.Stage.from_yaml(package.parent / "machine.yaml"), parameters_of(package)
    fields = {name[8:]: np.array(x) for name, x in parameters.items() if name.startswith("machine.")}
    fields["start"] = np.array(start_readings(stage)[0])
    (tmp_path / "machine.txt").write_text(machine_text("", fields), encoding="utf-8")
    program = Path(__file__).parent / "follow_set_points.cpp"
    printed = run_cpp(package, program, tmp_path, 100_000, tmp_path / "machine.txt", names=NAMES)
    found = {name: float(value) for name, value in re.findall(r"(\w+) ([\d.]+)", printed)}
    assert found["wrong"] == found["off"] == 0
    assert found["taken"] > 1000
    assert found["refused"] > 250
    assert found["rests"] > 5000
    assert found["moved"] > 20_000


def test_the_node_publishes_all_nine_joints_of_three(package: Path, tmp_path: Path) -> None:
    library = tmp_path / "libspm_stage_kinematics.so"
    compile_c(compilers()[0], "-O1", "-fPIC", "-shared", package / "src/spm_stage_kinematics.c", "-lm", "-o", library)
    parameters, stage = parameters_of(package), spm.Stage.from_yaml(package.parent / "machine.yaml")
    node, _, (*_, opaque) = run_scripts(package, library, parameters)
    complete = node.create_subscription.call_args.args[2]
    readings, rates = np.array([0.2, 0.4, 0.3]), np.array([0.1, -0.2, 0.05])
    positions = (readings - parameters["zeros"]).tolist()
    header = SimpleNamespace(stamp=SimpleNamespace(sec=7, nanosec=0))
    names = parameters["joints"]
    complete(SimpleNamespace(header=header, name=names, position=positions, velocity=rates.tolist()))
    sent = node.publisher.publish.call_args.args[0]
    state, step = spm.forward_physical(stage, readings), 1e-4
    assert dict(zip(sent.name, sent.position, strict=True)) == pytest.approx(joint_values(state), rel=0, abs=1e-11)
    after, before = (joint_values(spm.forward_physical(stage, readings + x * rates)) for x in (step, -step))
    differences = {joint: (after[joint] - before[joint]) / (2.0 * step) for joint in after}
    assert dict(zip(sent.name, sent.velocity, strict=True)) == pytest.approx(differences, rel=0, abs=1e-6)
    complete(SimpleNamespace(header=header, name=names, position=[np.nan] * 3, velocity=[]))
    assert node.publisher.publish.call_count == 1
    assert {each.package for each in opaque.function({"control": "true", "rviz": "true"})} > {"spm_stage"}


def test_packages_of_a_robot_and_of_stages_share_no_name_in_one_install(package: Path) -> None:
    installed = re.findall(r"add_library\((\w+) SHARED", (package / "CMakeLists.txt").read_text(encoding="utf-8"))
    assert installed == ["spm_stage_kinematics", "spm_stage"]
    assert '"spm_stage/SpmController"' in (package / "spm_controller.xml").read_text(encoding="utf-8")
    header = (package / "src/spm_stage_kinematics.h").read_text(encoding="utf-8")
    assert set(re.findall(r"^(?:int |const char \*)(\w+)\(", header, re.MULTILINE)) == {
        f"spm_stage_{name}" for name in ("status_name", "inverse", "forward", "beyond_limits", "joint_values")
    }
    left = ros_package(SERVOS, prefix="Left_")
    assert "<name>left_spm_stage</name>" in left["package.xml"]
    assert "left_spm_stage_inverse(" in left["src/left_spm_stage_kinematics.h"]
    assert "frame_id: Left_base" in left["config/spm_controller.yaml"]


def test_what_is_no_machine_or_no_name_is_refused(tmp_path: Path) -> None:
    with pytest.raises(spm.ArgumentError) as refused:
        ros_package("stage")
    assert refused.value.argument == "machine"
    with pytest.raises(spm.ArgumentError) as refused:
        write_ros(SERVOS, tmp_path / "My Stage")
    assert refused.value.argument == "directory"
    assert not list(tmp_path.iterdir())
