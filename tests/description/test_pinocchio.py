"""Use of the description with Pinocchio: named states, collisions, and mounting it on an arm."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from description.kinematic_tree import named_states
from problems import in_leg_space

import spm_pin as spm
from spm_pin.description import urdf_text
from spm_pin.description.source_files import SRDF, URDF, description_file, read_closures
from spm_pin.description.tree import joint_values

pin = pytest.importorskip("pinocchio")


@pytest.fixture
def model() -> Any:
    return pin.buildModelFromUrdf(str(description_file(URDF)))


def closure_gap(model: Any, q: Any, prefix: str = "") -> float:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    gaps = []
    for closure in read_closures(prefix=prefix):
        ids = [model.getFrameId(frame) for frame in (closure.frame_a, closure.frame_b)]
        assert all(i < model.nframes for i in ids)
        gaps.append(np.linalg.norm(data.oMf[ids[0]].translation - data.oMf[ids[1]].translation))
    assert len(gaps) == 4
    return float(max(gaps))


def test_reference_configurations(model: Any) -> None:
    pin.loadReferenceConfigurations(model, str(description_file(SRDF)), False)
    states = named_states(description_file(SRDF).read_text(encoding="utf-8"))
    assert {entry.key() for entry in model.referenceConfigurations} == set(states)
    for name, values in states.items():
        q = model.referenceConfigurations[name]
        for joint, value in values.items():
            assert q[model.joints[model.getJointId(joint)].idx_q] == value
        assert closure_gap(model, q) < 1e-12
    assert (model.referenceConfigurations["home"] == pin.neutral(model)).all()


def test_no_collision_where_a_machine_can_be(model: Any) -> None:
    pytest.importorskip("coal")
    shapes = pin.buildGeomFromUrdf(model, str(description_file(URDF)), pin.GeometryType.COLLISION)
    shapes.addAllCollisionPairs()
    all_pairs = len(shapes.collisionPairs)
    pin.removeCollisionPairs(model, shapes, str(description_file(SRDF)))
    assert 0 < len(shapes.collisionPairs) < all_pairs
    data, results = model.createData(), shapes.createData()

    def collides(values: dict[str, float]) -> bool:
        q = pin.neutral(model)
        for joint, value in values.items():
            q[model.joints[model.getJointId(joint)].idx_q] = value
        return bool(pin.computeCollisions(model, data, shapes, results, q, True))

    states = named_states(description_file(SRDF).read_text(encoding="utf-8"))
    assert not collides(states["home"])
    assert not collides(states["reference"])
    # Both stages turned half round: the legs cross.
    assert collides(states["solution_7"])
    for configuration in in_leg_space(spm.Geometry.paper(), 50, seed=5).configuration:
        assert not collides(joint_values(configuration))


def test_two_robots_need_prefixes() -> None:
    bare = pin.buildModelFromXML(urdf_text())
    with pytest.raises(ValueError, match="conflicting frame names"):
        pin.appendModel(bare, bare, 0, pin.SE3.Identity())
    left, right = (pin.buildModelFromXML(urdf_text(prefix=prefix)) for prefix in ("left_", "right_"))
    both = pin.appendModel(left, right, 0, pin.SE3(np.eye(3), np.array([3.0, 0.0, 0.0])))
    for prefix in ("left_", "right_"):
        assert closure_gap(both, pin.neutral(both), prefix) < 1e-12
