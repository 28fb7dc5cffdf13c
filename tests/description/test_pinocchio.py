"""The description with Pinocchio: named states, closures as a public loader reads them, collisions, two robots."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from description.kinematic_tree import SLIDES, STATES
from problems import in_leg_space

import spm_pin as spm
from spm_pin.description import (
    CLOSURES_PATH,
    SRDF_PATH,
    URDF_PATH,
    joint_values,
)

pin = pytest.importorskip("pinocchio")


@pytest.fixture
def model() -> Any:
    return pin.buildModelFromUrdf(URDF_PATH)


def test_the_public_loader_gets_a_closed_robot(model: Any) -> None:
    """What `completeRobotLoader` of example-parallel-robots makes of the keys, step by step."""
    content = yaml.safe_load(Path(CLOSURES_PATH).read_text(encoding="utf-8"))
    assert content.keys() == {"closed_loop", "type", "name_mot", "joint_name", "joint_type"}
    assert content["joint_name"] == content["joint_type"] == []
    assert content["name_mot"] == list(SLIDES)
    assert content["type"] == ["3d"] * 4
    constraints = []
    for pair in content["closed_loop"]:
        assert isinstance(pair, list)
        a, b = (model.frames[model.getFrameId(name)] for name in pair)
        ends = (a.parentJoint, a.placement, b.parentJoint, b.placement)
        constraints.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *ends, pin.ReferenceFrame.LOCAL))
    data = model.createData()
    for state in STATES.values():
        pin.forwardKinematics(model, data, np.array([state[name] for name in list(model.names)[1:]]))
        for c in constraints:
            ends = (data.oMi[c.joint1_id] * c.joint1_placement, data.oMi[c.joint2_id] * c.joint2_placement)
            np.testing.assert_allclose(ends[0].translation, ends[1].translation, atol=1e-12)


def test_no_collision_where_a_machine_can_be(model: Any) -> None:
    pytest.importorskip("coal")
    shapes = pin.buildGeomFromUrdf(model, URDF_PATH, pin.GeometryType.COLLISION)
    shapes.addAllCollisionPairs()
    all_pairs = len(shapes.collisionPairs)
    pin.removeCollisionPairs(model, shapes, SRDF_PATH)
    assert 0 < len(shapes.collisionPairs) < all_pairs
    data, results = model.createData(), shapes.createData()

    def collides(values: dict[str, float]) -> bool:
        q = np.array([values[name] for name in list(model.names)[1:]])
        return bool(pin.computeCollisions(model, data, shapes, results, q, True))

    assert not collides(STATES["home"])
    assert not collides(STATES["reference"])
    # Both stages turned half round: the legs cross.
    assert collides(STATES["solution_7"])
    for configuration in in_leg_space(spm.Manipulator.paper(), 50, seed=5).configuration:
        assert not collides(joint_values(configuration))
