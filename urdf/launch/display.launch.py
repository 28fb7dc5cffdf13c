"""Show the manipulator in RViz, assembled in one of the states of the SRDF.

ros2 launch spm_description display.launch.py state:=solution_1

A publisher of trees knows of no loops: its sliders (`gui:=true`) move the joints one by one, which tears them. All
eighteen joints of six leg lengths come from the package spm_pin.
"""

from pathlib import Path
from xml.etree import ElementTree

import xacro
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

FOLDER = Path(__file__).resolve().parents[1]


def state_values(name, prefix):
    """Return the joint values of a state of the SRDF."""
    states = ElementTree.parse(FOLDER / "spm.srdf").getroot().findall("group_state")
    values = {s.get("name"): {prefix + j.get("name"): float(j.get("value")) for j in s} for s in states}
    if name not in values:
        raise ValueError(f"state: expected one of {', '.join(values)}, got {name}")
    return values[name]


def nodes(context):
    """Return the nodes for the arguments given."""
    given = {key: LaunchConfiguration(key).perform(context) for key in ("prefix", "state", "gui", "rviz")}
    prefix = given["prefix"]
    arguments = {"prefix": prefix, "meshes": "package://spm_description/meshes", "root": "true"}
    robot = xacro.process_file(str(FOLDER / "spm.urdf.xacro"), mappings=arguments).toxml()
    publisher = "joint_state_publisher_gui" if given["gui"] == "true" else "joint_state_publisher"
    started = [
        Node(
            package="robot_state_publisher",
            executable="robot_state_publisher",
            parameters=[{"robot_description": robot}],
        ),
        Node(
            package=publisher,
            executable=publisher,
            parameters=[{"zeros": state_values(given["state"], prefix)}],
        ),
    ]
    if given["rviz"] == "true":
        # The fixed frame takes the prefix, which the configuration cannot know.
        arguments = ["-d", str(FOLDER / "rviz" / "spm.rviz"), "-f", f"{prefix}base"]
        started.append(Node(package="rviz2", executable="rviz2", arguments=arguments))
    return started


def generate_launch_description():
    """Return the arguments and the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("prefix", default_value="", description="before every link and joint"),
            DeclareLaunchArgument("state", default_value="reference", description="a named state of spm.srdf"),
            DeclareLaunchArgument("gui", default_value="false", description="sliders, which tear the loops"),
            DeclareLaunchArgument("rviz", default_value="true", description="start RViz"),
            OpaqueFunction(function=nodes),
        ]
    )
