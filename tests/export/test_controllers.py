"""The ROS 2 package, compiled and run against stand-ins for ROS."""

from __future__ import annotations

import re
import runpy
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pytest
import yaml
from balancers import stage_and_height
from cli.running import run
from export.c_library import STRICT, compile_c, compilers, run_cmake
from kinds_of_legs import SERVOS_AND_SCREWS as SERVOS
from problems import MANIPULATORS, as_built

import spm_pin as spm
from spm_pin.description import joint_values
from spm_pin.export.c_export import machine_fields
from spm_pin.export.c_texts import machine_text
from spm_pin.export.ros_export import start_readings, travel

PAPER = MANIPULATORS["paper"]
STAND_INS = Path(__file__).parent / "stand_ins"


def run_cpp(package: Path, source: Path, folder: Path, *arguments: object, names: dict[str, str] | None = None) -> str:
    """Compile a program around the package's sources, with other names in place of the robot's, and run it."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler: neither g++ nor clang++")
    sources, kinematics = package / "src", package.parent / "kinematics.o"
    if not kinematics.exists():
        (source_in_c,) = sources.glob("*_kinematics.c")
        compile_c(compilers()[0], *STRICT, "-O1", "-c", source_in_c, "-o", kinematics)
    include = (
        *(f"-D{name}={other}" for name, other in (names or {}).items()),
        "-I",
        sources,
        "-I",
        STAND_INS / "ros2_control",
    )
    flags = ("-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2")
    compile_c(compiler, *flags, *include, source, kinematics, "-lm", "-o", folder / "program")
    done = subprocess.run([folder / "program", *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_packages_start_servos_and_screws_in_a_state_off_the_level_within_their_limits() -> None:
    narrow = spm.Manipulator(*PAPER.dimensions, spm.LegLimits(1.28, 1.32))
    for machine in (SERVOS, replace(SERVOS, limits=None), narrow, spm.Manipulator(*PAPER.dimensions)):
        readings, goal = start_readings(machine)
        low, high = travel(machine)
        assert (low < readings).all()
        assert (readings < high).all()
        assert spm.forward_physical(machine, readings).exists
        assert abs(goal.rotation[2, 2]) < 1.0 - 1e-4
        assert machine is not SERVOS or (low == SERVOS.limits.minimum).all()


@pytest.mark.parametrize("machine", [as_built(PAPER, 1e-3), replace(SERVOS, limits=None)])
def test_the_axes_of_linuxcnc_move_the_legs_at_half_their_rate_and_its_program_is_within_reach(
    machine: spm.Manipulator,
) -> None:
    files = spm.export.linuxcnc_configuration(machine)
    values = np.array(re.search(r"^HOME = (.* .*)$", files["spm.ini"], re.MULTILINE)[1].split(), dtype=float)
    rates = [float(x) for x in re.findall(r"\[AXIS_.\][^\[]*MAX_VELOCITY = (\S+)", files["spm.ini"])]
    assert len(rates) == 6
    is_angle = np.array(machine.legs.units) == "rad"
    scale, fastest = np.where(is_angle, np.rad2deg(1.0), 1e3), np.where(is_angle, 1.0, 0.1)
    joints = np.array(re.findall(r"^HOME = (\S+)$", files["spm.ini"], re.MULTILINE), dtype=float)
    home = spm.forward_physical(machine, joints / scale)

    def state_at(values: np.ndarray, near: spm.Configuration) -> spm.Configuration:
        return spm.inverse_physical(machine, spm.pose(values[:3] / 1e3, rpy=np.deg2rad(values[3:])), near=near)

    for axis, rate in enumerate(rates):
        step = 1e-4 * np.eye(6)[axis]
        change = state_at(values + step, home).readings - state_at(values - step, home).readings
        assert (rate * np.abs(change) / 2e-4 / fastest).max() == pytest.approx(0.5, rel=1e-3)

    program = np.array(
        [re.findall(r"[XYZABC](\S+)", line) for line in re.findall("^G1 .*", files["demo.ngc"], re.MULTILINE)],
        dtype=float,
    )
    np.testing.assert_allclose(program[[0, -1]], [values, values], rtol=0, atol=1e-9)
    state = home
    for start, end in pairwise(program):
        for share in np.linspace(0.1, 1.0, 10):
            state = state_at(start + share * (end - start), state)
            assert state.exists
            assert not state.limit_excess.any()
    assert np.ptp(program, axis=0)[3:].max() > 1.0


def exported(machine: spm.Manipulator, folder: Path) -> Path:
    """Write a ROS 2 package, and the machine's file beside it."""
    machine.to_yaml(folder / "machine.yaml")
    done = run("export", "ros", "--out", folder / "spm_robot", "--machine", folder / "machine.yaml")
    assert done.returncode == 0, done.message
    return folder / "spm_robot"


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ROS 2 package of a machine as built."""
    return exported(as_built(PAPER, 1e-3), tmp_path_factory.mktemp("ros"))


@pytest.fixture(scope="module")
def servos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ROS 2 package of a machine of servos and screws as built, with the sources of the drawn one."""
    folder = tmp_path_factory.mktemp("servos")
    package = exported(as_built(SERVOS, 1e-3), folder)
    exported(SERVOS, tmp_path_factory.mktemp("drawn")).joinpath("src").rename(folder / "drawn")
    shutil.rmtree(package / "src")
    (folder / "drawn").rename(package / "src")
    return package


def parameters_of(package: Path) -> dict[str, Any]:
    """Return the parameters of the controller by their names in ROS."""
    text = (package / "config/spm_controller.yaml").read_text(encoding="utf-8")
    values = yaml.safe_load(text)["/**"]["ros__parameters"]
    return values | {f"machine.{name}": numbers for name, numbers in values.pop("machine").items()}


@pytest.mark.parametrize("machine", ["PRS inclined", "RPS as built", "RRS inwards as built"])
def test_linuxcnc_homes_a_stage_level_and_moves_it_within_its_limits_at_half_the_rates(machine: str) -> None:
    stage, _ = stage_and_height(machine)
    files = spm.export.linuxcnc_configuration(stage)
    scale, fastest = (np.rad2deg(1.0), 1.0) if stage.unit == "rad" else (1e3, 0.1)
    joints = np.array(re.findall(r"^HOME = (\S+)$", files["stage.ini"], re.MULTILINE), dtype=float) / scale
    x, y, *home, c = (float(x) for x in re.search(r"^HOME = (.* .*)$", files["stage.ini"], re.MULTILINE)[1].split())
    assert (x, y, home[1:], c) == (0.0, 0.0, [0.0, 0.0], 0.0)

    def readings(values: npt.ArrayLike) -> np.ndarray:
        height, roll, pitch = np.moveaxis(np.asarray(values) * [1e-3, *[np.pi / 180.0] * 2], -1, 0)
        return spm.inverse_physical(stage, height, roll=roll, pitch=pitch).readings

    np.testing.assert_allclose(readings(home), joints, rtol=0.0, atol=2e-11)
    program = np.array(re.findall(r"G1 Z(\S+) A(\S+) B(\S+)", files["demo.ngc"]), dtype=float)
    assert (program[[0, -1]] == home).all()
    assert np.ptp(program[:, 1:], axis=0).min() > 1.0
    assert np.isfinite(readings(program)).all()
    axes = re.findall(r"\[AXIS_.\]\nMIN_LIMIT = (\S+)\nMAX_LIMIT = (\S+)\nMAX_VELOCITY = (\S+)", files["stage.ini"])
    for step, (low, high, rate) in zip(1e-4 * np.eye(3), np.array(axes, dtype=float), strict=True):
        assert (low < program @ np.sign(step)).all()
        assert (program @ np.sign(step) < high).all()
        per_unit = np.abs(readings(home + step) - readings(home - step)).max() / 2e-4
        assert rate * per_unit == pytest.approx(0.5 * fastest, rel=1e-3)


BOTH = pytest.mark.parametrize("kind", ["package", pytest.param("servos", marks=pytest.mark.slow)])


@BOTH
def test_the_controller_for_ros2_control_follows_set_points_and_refuses_bad_ones(
    kind: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    package = request.getfixturevalue(kind)
    lines = [
        f"{name} {' '.join(map(str, x)) if isinstance(x, list) else x}\n" for name, x in parameters_of(package).items()
    ]
    (tmp_path / "parameters.txt").write_text("".join(lines), encoding="utf-8")
    machine = spm.Manipulator.from_yaml(package.parent / "machine.yaml")
    start, near = start_readings(machine)
    state = spm.forward_physical(machine, start + 0.2 * (near.readings - start))
    values = [*start, *state.translation, *state.pose.rotation.as_quat(), *state.readings]
    np.savetxt(tmp_path / "pose.txt", [values])
    files = tmp_path / "parameters.txt", tmp_path / "pose.txt"
    too_high = "beyond limits: leg_b1_" if kind == "package" else "unreachable"
    run_cpp(package, STAND_INS / "ros2_control/drive.cpp", tmp_path, *files, too_high)


@BOTH
def test_bad_set_points_never_break_a_limit(kind: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    package, ticks = request.getfixturevalue(kind), 300_000
    machine = spm.Manipulator.from_yaml(package.parent / "machine.yaml")
    numbers = machine_text("", machine_fields(machine) | {"start": np.array(start_readings(machine)[0])})
    (tmp_path / "machine.txt").write_text(numbers, encoding="utf-8")
    program = Path(__file__).parent / "follow_set_points.cpp"
    printed = run_cpp(package, program, tmp_path, ticks, tmp_path / "machine.txt")
    found = {name: float(value) for name, value in re.findall(r"(\w+) ([\d.]+)", printed)}
    assert found["wrong"] == 0  # no rate, acceleration or limit of a leg was broken, and nothing was allocated
    assert found["beyond"] < 0.15 * found["stops"]  # spoiled ones: a leg at its end stop is within its limits
    assert found["off"] == 0  # where the commands rest they are those of the last set-point taken
    assert found["taken"] > ticks / 100
    assert found["refused"] > ticks / 400
    assert found["rests"] > ticks / 20
    assert found["moved"] > ticks / 5


def test_commands_follow_the_path_of_set_points_that_come_too_fast(package: Path, tmp_path: Path) -> None:
    """Around a singularity, which the straight way of the legs from the first to the last set-point meets."""
    machine = replace(PAPER, limits=spm.LegLimits(0.75, 1.9))
    corners = np.array(
        [
            [1.56, 1.10, 1.54, 1.83, 1.23, 1.49],
            [1.67, 1.74, 1.51, 1.88, 1.27, 1.70],
            [1.82, 1.01, 1.13, 1.76, 1.28, 1.65],
        ]
    )
    start = spm.forward_physical(machine, corners[0])
    assert not spm.forward_physical(machine, corners[2], near=start).exists
    shares = np.arange(1, 1500)[:, None] / 1499.0
    ways = np.concatenate([a + shares * (b - a) for a, b in pairwise(corners)])
    states = spm.forward_physical(machine, ways)
    assert states.exists.all()
    numbers = machine_text("", machine_fields(machine) | {"start": corners[0]})
    (tmp_path / "machine.txt").write_text(numbers, encoding="utf-8")
    np.savetxt(tmp_path / "poses.txt", np.concatenate([states.translation, states.pose.rotation.as_quat()], axis=-1))
    program = Path(__file__).parent / "follow_path.cpp"
    printed = run_cpp(package, program, tmp_path, tmp_path / "machine.txt", tmp_path / "poses.txt")
    commands = np.array([line.split() for line in printed.splitlines()], dtype=float)
    np.testing.assert_allclose(commands[-1], corners[2], rtol=0.0, atol=1e-9)
    assert np.abs(np.diff(commands, axis=0)).max() <= 0.1 * 1e-3 + 1e-12
    # Corners are rounded by rate² / (2 acceleration) at most.
    path = np.concatenate([corners[:1], ways])
    assert max(np.abs(path - x).max(axis=-1).min() for x in commands[::20]) < 0.1**2 / 2.0 + 1e-9
    state = start
    for command in commands[::100]:
        state = spm.forward_physical(machine, command, near=state)
        assert state.exists
    assert np.linalg.norm(state.translation - states[-1].translation) < 0.01


def test_the_hardware_of_the_description_has_the_joints_of_the_controller(package: Path) -> None:
    robot = ElementTree.parse(package / "urdf/spm.urdf").getroot()
    (control,) = robot.findall("ros2_control")
    kinds = {joint.get("name"): joint.get("type") for joint in robot.findall("joint")}
    parameters = parameters_of(package)
    names, zeros = parameters["joints"], parameters["zeros"]
    assert [joint.get("name") for joint in control.findall("joint")] == names
    assert all(kinds[name] == "prismatic" for name in names)
    velocities = [float(robot.find(f"joint[@name='{name}']/limit").get("velocity")) for name in names]
    assert (np.array(velocities) >= parameters["max_velocity"]).all()
    assert robot.find(f"link[@name='{parameters['frame_id']}']") is not None
    # The start is the state whose slides are these.
    machine = spm.Manipulator.from_yaml(package.parent / "machine.yaml")
    slides = [float(x.text) for x in control.iter("param") if x.get("name") == "initial_value"]
    state = spm.forward_physical(machine, np.add(slides, zeros))
    expected = [joint_values(state)[name] for name in names]
    np.testing.assert_allclose(slides, expected, rtol=0, atol=1e-12)
    for mesh in robot.iter("mesh"):
        place = mesh.get("filename").removeprefix("package://spm_robot/")
        assert (package / place).is_file()
    assert (package / "LICENSE").read_text(encoding="utf-8").startswith("BSD 2-Clause License")
    if shutil.which("check_urdf"):
        subprocess.run(["check_urdf", package / "urdf/spm.urdf"], check=True, capture_output=True)


def run_scripts(package: Path, library: Path, parameters: dict[str, Any]) -> tuple[Any, ...]:
    """Return the node of the package, its class, and the arguments and nodes of the launch file, without ROS."""

    class Node:
        create_publisher, create_subscription, get_logger, get_clock = (MagicMock() for _ in range(4))

        def __init__(self, name: str, *, automatically_declare_parameters_from_overrides: bool) -> None:
            assert name == "spm_joint_states"
            assert automatically_declare_parameters_from_overrides

        def get_parameter_or(self, name: str) -> SimpleNamespace:
            return SimpleNamespace(value=parameters.get(name))

    actions = SimpleNamespace(
        DeclareLaunchArgument=lambda name, **given: SimpleNamespace(name=name, **given), OpaqueFunction=SimpleNamespace
    )
    configuration = SimpleNamespace(LaunchConfiguration=lambda key: SimpleNamespace(perform=lambda given: given[key]))
    stand_ins = {
        **{name: MagicMock() for name in ("rclpy", "rclpy.executors", "sensor_msgs")},
        "sensor_msgs.msg": SimpleNamespace(JointState=SimpleNamespace),
        "rclpy.node": SimpleNamespace(Node=Node),
        "launch": SimpleNamespace(LaunchDescription=list),
        "launch.actions": actions,
        "launch.substitutions": configuration,
        "launch_ros": MagicMock(),
        "launch_ros.actions": SimpleNamespace(Node=SimpleNamespace),
        "launch_ros.parameter_descriptions": SimpleNamespace(
            ParameterValue=lambda value, value_type: [value_type(value)]
        ),
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, content in stand_ins.items():
            patch.setitem(sys.modules, name, content)
        joint_states = runpy.run_path(str(package / "scripts/joint_states.py"))["JointStates"]
        node = joint_states(library)
        launched = runpy.run_path(str(package / "launch/robot.launch.py"))["generate_launch_description"]()
    return node, joint_states, launched


def test_the_node_publishes_the_joints_of_the_readings_and_the_launch_file_starts_it(
    package: Path, tmp_path: Path
) -> None:
    library = tmp_path / "libspm_robot_kinematics.so"
    compile_c(compilers()[0], "-O1", "-fPIC", "-shared", package / "src/spm_kinematics.c", "-lm", "-o", library)
    parameters = parameters_of(package)
    node, joint_states, (*arguments, opaque) = run_scripts(package, library, parameters)
    (topic, complete) = node.create_subscription.call_args.args[1:3]
    assert topic == "leg_states"
    machine, now = spm.Manipulator.from_yaml(package.parent / "machine.yaml"), object()
    node.get_clock().now().to_msg.return_value = now
    names, zeros = parameters["joints"], parameters["zeros"]
    readings, rates = np.array([1.2, 1.3, 1.4, 1.2, 1.3, 1.25]), np.array([0.02, -0.1, 0.05, 0.0, 0.03, -0.01])

    def message(values: np.ndarray, velocity: list[float], seconds: int = 7) -> SimpleNamespace:
        stamp = SimpleNamespace(sec=seconds, nanosec=0)
        positions = [0.1, *(values - zeros)]
        return SimpleNamespace(
            header=SimpleNamespace(stamp=stamp), name=["other", *names], position=positions, velocity=velocity
        )

    def expected(values: np.ndarray) -> dict[str, float]:
        return joint_values(spm.forward_physical(machine, values))

    for values, velocity, is_carried in (
        (readings, [], False),
        (readings + 0.01, [0.0, *rates], True),
        (readings, [np.nan] * 7, False),
    ):
        sent = message(values, velocity)
        complete(sent)
        completed = node.publisher.publish.call_args.args[0]
        assert completed.header.stamp is sent.header.stamp
        positions = dict(zip(completed.name, completed.position, strict=True))
        assert positions == pytest.approx(expected(values), rel=0, abs=1e-12)
        assert hasattr(completed, "velocity") == is_carried
        if is_carried:
            step = 1e-4 * np.array(velocity[1:])
            after, before = expected(values + step), expected(values - step)
            differences = {joint: (after[joint] - before[joint]) / 2e-4 for joint in after}
            velocities = dict(zip(completed.name, completed.velocity, strict=True))
            assert velocities == pytest.approx(differences, rel=0, abs=1e-7)
    complete(message(readings, [], seconds=0))
    assert node.publisher.publish.call_args.args[0].header.stamp is now
    complete(message(np.array([0.3, 2.5, 0.3, 1.3, 1.3, 1.3]), []))  # has no state
    complete(SimpleNamespace(name=["other"], position=[0.1], velocity=[]))
    assert node.publisher.publish.call_count == 4
    assert node.get_logger().warning.call_count == 1
    del parameters["zeros"]
    with pytest.raises(ValueError, match=r"zeros: expected 6 values, got None: is config/spm_controller\.yaml given"):
        joint_states(library)

    defaults = {argument.name: argument.default_value for argument in arguments}
    started = opaque.function(defaults)
    assert [each.executable for each in started] == [
        *("robot_state_publisher", "joint_states.py", "ros2_control_node", "spawner", "spawner", "rviz2")
    ]
    controllers, of_ours = (str(package / f"config/{name}.yaml") for name in ("controllers", "spm_controller"))
    assert started[3].arguments == ["joint_state_broadcaster", "--param-file", controllers]
    assert started[4].arguments == ["spm_controller", "--param-file", of_ours]
    assert started[1].parameters == [of_ours]
    for each in (started[0], started[2]):
        # A text that is not marked as one is read as YAML by launch_ros.
        assert each.parameters[0]["robot_description"] == [(package / "urdf/spm.urdf").read_text(encoding="utf-8")]
    elements = ElementTree.parse(package / "package.xml").getroot().iter()
    depends = {each.text for each in elements if "depend" in each.tag}
    assert {each.package for each in started} - {"spm_robot"} <= depends
    assert len(opaque.function(defaults | {"control": "false"})) == 3


def test_the_start_is_within_the_limits_and_the_pose_to_paste_is_reached_from_it() -> None:
    machine = spm.Manipulator(*PAPER.dimensions, spm.LegLimits(1.2, np.inf))
    files = spm.export.ros_package(machine)
    robot = ElementTree.fromstring(files["urdf/spm.urdf"])
    for joint in robot.iter("joint"):
        values = {x.get("name"): float(x.text) for x in joint.iter("param")}
        assert not values or values["min"] < values["initial_value"] < values.get("max", np.inf)
    launch = files["launch/robot.launch.py"]
    numbers = r"position: \[(.*?)\]", r"\{position: \{(.*?)\}", r"orientation: \{(.*?)\}"
    joints, position, orientation = (
        [float(x.split(":")[-1]) for x in re.search(pattern, launch)[1].split(",")] for pattern in numbers
    )
    parameters = yaml.safe_load(files["config/spm_controller.yaml"])["/**"]["ros__parameters"]
    start = np.add(joints, parameters["zeros"])
    np.testing.assert_allclose(start, start_readings(machine)[0], rtol=0, atol=1e-8)
    state = spm.forward_physical(machine, start)
    assert state.exists
    assert np.ptp(start) > 1e-3  # not level
    pose = spm.machine.pose(position, quat=orientation)
    reached = spm.inverse_physical(machine, pose, near=state)
    limits = machine.limits or spm.LegLimits(0.0, np.inf)
    assert limits.contains(reached.readings).all()


@pytest.mark.slow
def test_the_package_builds_with_cmake_and_stand_ins(package: Path, tmp_path: Path) -> None:
    listing = (package / "CMakeLists.txt").read_text(encoding="utf-8")
    include = STAND_INS / "ros2_control"
    for name in re.findall(r"find_package\((\w+) REQUIRED\)", listing):
        lines = f"add_library({name}::{name} INTERFACE IMPORTED)\n"
        lines += f"target_include_directories({name}::{name} INTERFACE {include})\n"
        lines += f"set({name}_TARGETS {name}::{name})\nset({name}_FOUND TRUE)\n"
        if name == "ament_cmake":
            lines = "macro(ament_package)\nendmacro()\nset(ament_cmake_FOUND TRUE)\n"
        if name == "pluginlib":
            lines += "macro(pluginlib_export_plugin_description_file)\nendmacro()\n"
        (tmp_path / f"Find{name}.cmake").write_text(lines, encoding="utf-8")
    build, install = tmp_path / "build", tmp_path / "install"
    paths = [f"-DCMAKE_MODULE_PATH={tmp_path}", f"-DCMAKE_INSTALL_PREFIX={install}"]
    run_cmake(["-S", package, "-B", build, *paths], ["--build", build], ["--install", build])
    for place in ("lib/libspm_robot_kinematics.so", "lib/libspm_robot.so", "lib/spm_robot/joint_states.py"):
        assert (install / place).is_file()
    assert (install / "share/spm_robot/launch/robot.launch.py").is_file()
