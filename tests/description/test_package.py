"""The description as other programs find it: constants of its paths, and a ROS package."""

from __future__ import annotations

import ast
import re
import runpy
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
from description.kinematic_tree import named_states

import spm_pin as spm
from spm_pin import description
from spm_pin.description import urdf_text

PACKAGE = Path(description.PACKAGE_PATH)
LAUNCH = PACKAGE / "launch" / "display.launch.py"


def test_package_xml() -> None:
    root = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert (root.tag, root.get("format")) == ("package", "3")
    assert root.findtext("name") == "spm_description"
    assert root.findtext("version") == spm.__version__
    assert root.findtext("license") == "BSD-2-Clause"
    licence = Path(__file__).parents[2] / "LICENSE"
    assert (PACKAGE / "LICENSE").read_text(encoding="utf-8") == licence.read_text(encoding="utf-8")
    assert root.findtext("export/build_type") == "ament_cmake"
    maintainers = root.findall("maintainer")
    assert maintainers
    assert all(re.fullmatch(r"\S+@\S+\.\w+", str(maintainer.get("email"))) for maintainer in maintainers)
    # The launch file needs what it imports and starts.
    imported = {
        (node.module if isinstance(node, ast.ImportFrom) else node.names[0].name) or ""
        for node in ast.walk(ast.parse(LAUNCH.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    needed = {module.partition(".")[0] for module in imported} - sys.stdlib_module_names
    depends = {depend.text for depend in root.findall("exec_depend")}
    started = {node.package for gui in ("true", "false") for node in launched(gui=gui)}
    assert depends == needed | started


def test_everything_is_installed() -> None:
    text = (PACKAGE / "CMakeLists.txt").read_text(encoding="utf-8")
    project = re.search(r"project\((\w+)", text)
    assert project[1] == "spm_description"
    installed = re.findall(r"(?:FILES|DIRECTORY) ([^)]*?)DESTINATION", text)
    assert len(installed) == 2
    listed = set(" ".join(installed).split())
    # The marker of the package and its own files are installed by ament.
    of_ament = {"CMakeLists.txt", "package.xml", "resource", "__pycache__"}
    assert listed == {path.name for path in PACKAGE.iterdir()} - of_ament


def launched(**given: str) -> list[Any]:
    """The nodes of the launch file, run against stand-ins for the packages of ROS."""

    def module(name: str, **content: object) -> ModuleType:
        made = ModuleType(name)
        vars(made).update(content)
        return made

    def configuration(key: str) -> SimpleNamespace:
        return SimpleNamespace(perform=lambda context: context[key])

    def argument(name: str, default_value: str, description: str) -> SimpleNamespace:
        return SimpleNamespace(name=name, default=default_value, description=description)

    stand_ins = {
        "launch": module("launch", LaunchDescription=lambda entities: entities),
        "launch.actions": module("actions", DeclareLaunchArgument=argument, OpaqueFunction=SimpleNamespace),
        "launch.substitutions": module("substitutions", LaunchConfiguration=configuration),
        "launch_ros": module("launch_ros"),
        "launch_ros.actions": module("actions", Node=SimpleNamespace),
    }
    with pytest.MonkeyPatch.context() as patch:
        for name, stand_in in stand_ins.items():
            patch.setitem(sys.modules, name, stand_in)
        entities = runpy.run_path(str(LAUNCH))["generate_launch_description"]()
    *arguments, opaque = entities
    context = {argument.name: argument.default for argument in arguments}
    assert given.keys() <= context.keys()
    nodes: list[Any] = opaque.function(context | given)
    return nodes


@pytest.mark.parametrize(("prefix", "state"), [("", "home"), ("left_", "solution_7")])
def test_launch(prefix: str, state: str) -> None:
    publisher, joints, rviz = launched(prefix=prefix, state=state)
    assert publisher.package == "robot_state_publisher"
    text = publisher.parameters[0]["robot_description"]
    same = (
        ElementTree.canonicalize(each, strip_text=True)
        for each in (text, urdf_text(prefix=prefix, meshes="package://spm_description/meshes", root=True))
    )
    assert len(set(same)) == 1
    assert joints.package == "joint_state_publisher"
    zeros = joints.parameters[0]["zeros"]
    expected = named_states((PACKAGE / "spm.srdf").read_text(encoding="utf-8"))[state]
    assert zeros == {prefix + joint: value for joint, value in expected.items()}
    assert rviz.arguments == ["-d", str(PACKAGE / "rviz" / "spm.rviz"), "-f", f"{prefix}base"]


def test_launch_without_rviz_and_with_sliders() -> None:
    assert [node.package for node in launched(rviz="false")] == ["robot_state_publisher", "joint_state_publisher"]
    assert launched(gui="true")[1].executable == "joint_state_publisher_gui"
    with pytest.raises(ValueError, match="state: expected one of home, reference"):
        launched(state="folded")
