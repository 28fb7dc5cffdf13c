"""Extended-URDF files: read, written, and read as the format's own loader reads them; and where they are wrong."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from description.kinematic_tree import named_states
from text_files import assert_refused, written

from spm_pin.description import CLOSURES_PATH, SRDF_PATH, URDF_PATH
from spm_pin.description.closures import KINDS, Closure, read_closures
from spm_pin.description.extended_urdf import extended_urdf_text, read_extended_urdf
from spm_pin.description.load_robot import manipulator, read_robot
from spm_pin.description.tree import SLIDES
from spm_pin.errors import DescriptionError

LEG = """# a leg with every key, in both of YAML's styles
closed_loop:
  - [knee_a, knee_b]
  - [ankle_a, ankle_b]
type: ['6d', '3D']
name_mot: ['hip', 'knee']
joint_name: [ball, cardan]
joint_type:
  - SPHERICAL
  - UJOINT_ZY
"""


def test_every_key(tmp_path: Path) -> None:
    extended = read_extended_urdf(written(tmp_path / "robot.yaml", LEG))
    assert extended.closures == (
        Closure("knee_aCknee_b", "weld", "knee_a", "knee_b"),
        Closure("ankle_aCankle_b", "point", "ankle_a", "ankle_b"),
    )
    assert extended.motors == ("hip", "knee")
    assert extended.joint_types == {"ball": "SPHERICAL", "cardan": "UJOINT_ZY"}


def test_keys_that_may_be_absent(tmp_path: Path) -> None:
    extended = read_extended_urdf(written(tmp_path / "robot.yaml", "closed_loop: []\ntype: []\nname_mot: []\n"))
    assert (extended.closures, extended.motors, extended.joint_types) == ((), (), {})


@pytest.mark.parametrize("prefix", ["", "left_", "robot/"])
def test_round_trip(prefix: str, tmp_path: Path) -> None:
    robot = manipulator(prefix=prefix)
    extended = read_extended_urdf(written(tmp_path / "robot.yaml", extended_urdf_text(robot)))
    ends = [(closure.kind, closure.frame_a, closure.frame_b) for closure in read_closures(prefix=prefix)]
    assert [(closure.kind, closure.frame_a, closure.frame_b) for closure in extended.closures] == ends
    assert extended.motors == tuple(prefix + name for name in SLIDES)
    assert extended.joint_types == {}


def test_the_shipped_pair_is_the_manipulator() -> None:
    robot, shipped = read_robot(URDF_PATH, CLOSURES_PATH), manipulator()
    assert (robot.links, robot.joints, robot.transmissions) == (shipped.links, shipped.joints, shipped.transmissions)
    assert read_robot(URDF_PATH).closures != shipped.closures  # Drake's element has no names
    assert read_robot(URDF_PATH).closures[0].name == "middle_b2_leg_b2_tip"


def loaded_as_its_own_loader_does(urdf: str, extended: str) -> tuple[Any, list[Any], list[int]]:
    """Repeat, step by step, what `completeRobotLoader` of example-parallel-robots makes of the keys."""
    pin = pytest.importorskip("pinocchio")
    model = pin.buildModelFromUrdf(urdf)
    content = yaml.safe_load(Path(extended).read_text(encoding="utf-8"))
    assert content.keys() == {"closed_loop", "type", "name_mot", "joint_name", "joint_type"}
    assert content["joint_name"] == content["joint_type"] == []
    constraints = []
    for pair, kind in zip(content["closed_loop"], content["type"], strict=True):
        assert isinstance(pair, list)
        a, b = (model.frames[model.getFrameId(name)] for name in pair)
        contact = pin.ContactType.CONTACT_3D if kind in ("3d", "3D") else pin.ContactType.CONTACT_6D
        ends = (a.parentJoint, a.placement, b.parentJoint, b.placement)
        constraints.append(pin.RigidConstraintModel(contact, model, *ends, pin.ReferenceFrame.LOCAL))
    return model, constraints, [list(model.names).index(name) for name in content["name_mot"]]


def test_the_public_loader_gets_a_closed_robot() -> None:
    pin = pytest.importorskip("pinocchio")
    model, constraints, motors = loaded_as_its_own_loader_does(URDF_PATH, CLOSURES_PATH)
    assert [model.names[motor] for motor in motors] == list(SLIDES)
    assert [constraint.type for constraint in constraints] == [pin.ContactType.CONTACT_3D] * 4
    data = model.createData()
    for state in named_states(Path(SRDF_PATH).read_text(encoding="utf-8")).values():
        pin.forwardKinematics(model, data, np.array([state[name] for name in list(model.names)[1:]]))
        for c in constraints:
            ends = (data.oMi[c.joint1_id] * c.joint1_placement, data.oMi[c.joint2_id] * c.joint2_placement)
            np.testing.assert_allclose(ends[0].translation, ends[1].translation, atol=1e-12)


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("", None, "the keys closed_loop, name_mot and type, got an empty file"),
        ("- a\n", 1, "a mapping with the keys closed_loop, name_mot, type, and perhaps joint_name, joint_type"),
        (LEG.replace("name_mot", "name_motor"), 6, "the key 'name_motor'. Misspelt?"),
        (LEG.replace("type: ['6d', '3D']\n", "", 1), 2, "no key type"),
        (LEG.replace("joint_type", "type"), 8, "the key 'type' twice"),
        (LEG.replace("  - [ankle_a, ankle_b]\n", ""), 4, "as many members under type as under closed_loop, 1, got 2"),
        (LEG.replace("[knee_a, knee_b]", "knee_a"), 3, "a list under the key closed_loop, got 'knee_a'"),
        (LEG.replace("[knee_a, knee_b]", "[knee_a]"), 3, "two frames for each closed loop, got 1"),
        (LEG.replace("knee_b", "7"), 3, "a name under the key closed_loop, got '7'"),
        (LEG.replace("knee_b", "knee_a"), 3, "another frame than frame_a under the key frame_b, got 'knee_a'"),
        (
            LEG.replace("knee_b", "ankle_a").replace("knee_a", "ankle_b"),
            4,
            "two frames that no other closure holds, got ankle_a",
        ),
        (LEG.replace("'6d'", "'5d'"), 5, "a type 3d or 6d, got '5d'"),
        (LEG.replace("'6d'", "6"), 5, "a name under the key type, got '6'"),
        (LEG.replace("'knee']", "'hip']"), 6, "each motor once, got hip again"),
        (LEG.replace("['hip', 'knee']", "hip"), 6, "a list under the key name_mot, got 'hip'"),
        (LEG.replace("cardan", "ball"), 7, "each joint once, got ball again"),
        (LEG.replace("UJOINT_ZY", "UJOINT_AB"), 10, "SPHERICAL, FIXED or UJOINT_ with two axes, got 'UJOINT_AB'"),
        (LEG.replace("joint_name: [ball, cardan]\n", ""), 8, "as many members under joint_type as under joint_name, 0"),
        (LEG.replace("  - UJOINT_ZY\n", ""), 9, "as many members under joint_type as under joint_name, 2, got 1"),
        (LEG.partition("joint_type")[0], 2, "as many members under joint_type as under joint_name, 2, got 0"),
        ("closed_loop: [\n", None, "a YAML file"),
    ],
)
def test_malformed(tmp_path: Path, text: str, line: int | None, said: str) -> None:
    assert_refused(read_extended_urdf, written(tmp_path / "robot.yaml", text), line, said)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="No such file"):
        read_extended_urdf(tmp_path / "robot.yaml")
    with pytest.raises(DescriptionError, match="No such file"):
        read_robot(URDF_PATH, tmp_path / "robot.yaml")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("'leg_b2_tip'", "'leg_b9_tip'", "no link 'leg_b9_tip'. Named by the closure middle_b2Cleg_b9_tip"),
        ("'leg_b1_slide', ", "", "the motors that the URDF's transmissions drive, got a difference in leg_b1_slide"),
        ("'leg_b1_slide'", "'leg_b1_slider'", "a difference in leg_b1_slide, leg_b1_slider"),
        ("joint_name: []\njoint_type: []", "joint_name: [leg]\njoint_type: [SPHERICAL]", "got leg as SPHERICAL"),
    ],
)
def test_an_extended_urdf_that_is_not_this_robot_s(old: str, new: str, said: str, tmp_path: Path) -> None:
    text = Path(CLOSURES_PATH).read_text(encoding="utf-8")
    assert old in text
    with pytest.raises(DescriptionError) as caught:
        read_robot(URDF_PATH, written(tmp_path / "robot.yaml", text.replace(old, new)))
    assert said in str(caught.value)


def test_every_kind_has_its_type() -> None:
    assert KINDS == {"point": "3d", "weld": "6d"}
