"""Results are shown as one line."""

from __future__ import annotations

import numpy as np

import spm_pin as spm

GEOMETRY = spm.Geometry.paper()
STATE = spm.forward_physical(GEOMETRY, [1.25, 1.15, 1.40, 1.30, 1.20, 1.40])
HOME = spm.forward_physical(GEOMETRY, [1.3] * 6)
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))


def test_singularities_are_shown_by_kind_and_distance() -> None:
    assert repr(spm.singularities(STATE)).startswith(
        "<Singularities: regular; smallest singular values of J_b, J_c, K: "
    )
    assert repr(spm.singularities(HOME)).startswith("<Singularities: inverse; ")
    branches = spm.inverse_displacement(GEOMETRY, POSE)
    assert repr(spm.singularities(branches["FT+"])).startswith("<Singularities: does not exist; ")
    assert repr(spm.singularities(branches.configurations)).startswith(
        "<Singularities: (8,) states, 6 exist, all regular; "
    )
    pair = spm.forward_physical(GEOMETRY, [[1.3] * 6, STATE.leg_lengths])
    assert repr(spm.singularities(pair)).startswith("<Singularities: (2,) states, 2 exist, 1 inverse; ")
    assert "(0,) states, 0 exist" in repr(spm.singularities(pair[:0]))


def test_a_followed_path_is_shown_by_its_events() -> None:
    goal = spm.forward_physical(GEOMETRY, [1.24, 1.16, 1.40, 1.30, 1.20, 1.41])
    path = spm.follow(GEOMETRY, np.stack([STATE.leg_lengths, goal.leg_lengths]), start=STATE, samples=10)
    assert repr(path) == f"<FollowedPath: complete, {len(path.parameters)} states of T1+/T1+; no events>"
    beyond = spm.follow(
        GEOMETRY, np.stack([STATE.leg_lengths, [0.5, 1.15, 1.4, 1.3, 1.2, 3.0]]), start=STATE, samples=10
    )
    assert not beyond.complete
    assert repr(beyond).startswith(f"<FollowedPath: ends at {beyond.parameters[-1]:.4g}, ")
    assert f"leg limit at {beyond.events[0].parameter:.4g}" in repr(beyond)
    assert len(repr(beyond)) < 250
