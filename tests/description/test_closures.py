"""The closures, and the Extended-URDF file of them as the format's own loader reads it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from description.kinematic_tree import named_states

from spm_pin.description import CLOSURES_PATH, SLIDES, SRDF_PATH, URDF_PATH, Closure, read_closures


@pytest.mark.parametrize("prefix", ["", "p_"])
def test_the_four_balls(prefix: str) -> None:
    pairs = [("middle_b2", "leg_b2_tip"), ("middle_b3", "leg_b3_tip")]
    pairs += [("middle_b2_upper", "leg_c2_tip"), ("middle_b3_upper", "leg_c3_tip")]
    names = ("b2", "b3", "c2", "c3")
    assert read_closures(prefix=prefix) == tuple(
        Closure(f"{prefix}closure_{name}", prefix + a, prefix + b) for name, (a, b) in zip(names, pairs, strict=True)
    )


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
