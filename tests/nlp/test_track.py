from __future__ import annotations

import importlib

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import spm_pin as spm
from spm_pin import nlp

GEOMETRY = spm.Geometry.paper()
POSITION, XYX = np.array([0.6889, 0.4963, 2.253]), np.array([-11.08, 32.97, -12.88])
SEED = spm.inverse_displacement(GEOMETRY, spm.pose(POSITION, xyx=np.deg2rad(XYX))).physical()
FREE = spm.LegLimits(0.0, np.inf)


def path(count: int) -> RigidTransform:
    s = np.linspace(0.0, 1.0, count)[:, None]
    return spm.pose(POSITION + s * [-0.04, 0.025, 0.05], xyx=np.deg2rad(XYX + s * [0.4, -2.0, 0.4]))


def ball_angles(states: spm.Configuration) -> np.ndarray:
    normal = states.middle_pose.as_matrix()[..., None, :3, 2]
    return np.arccos((states.leg_vectors * normal).sum(axis=-1) / states.leg_lengths)


def inclinations(states: spm.Configuration) -> np.ndarray:
    radial = GEOMETRY.radial_directions
    lower, upper = states.leg_vectors[..., :3, :], -states.leg_vectors[..., 3:, :]
    seen_from_m = upper @ states.rotation
    low = np.arctan2((lower * radial).sum(axis=-1), lower[..., 2])
    high = np.arctan2((seen_from_m * radial).sum(axis=-1), -seen_from_m[..., 2])
    return np.concatenate([low, high], axis=-1)


def test_without_limits_it_is_the_branch_of_the_closed_form() -> None:
    poses = path(15)
    closed = spm.inverse_displacement(GEOMETRY, poses)["TT+"]
    assert closed.exists.all()
    found = nlp.track(poses, SEED, limits=FREE)
    assert set(found.outcomes) == {"Held"}
    assert not found.limited.any()
    assert not found.crossed.any()
    np.testing.assert_array_equal(found.shift, 0.0)
    np.testing.assert_array_equal(found.turn, 0.0)
    np.testing.assert_allclose(found.configurations.middle_joints, closed.middle_joints, rtol=0, atol=1e-11)


def test_leg_limits_make_the_pose_give_way_and_no_more_than_needed() -> None:
    poses = path(12)
    closed = spm.inverse_displacement(GEOMETRY, poses)["TT+"]
    limits = spm.LegLimits(1.0, 1.65)
    inside = limits.margin(closed.leg_lengths) >= 0.0
    assert 0 < np.count_nonzero(inside) < 12
    found = nlp.track(poses, SEED, limits=limits)
    assert found.solved.all()
    np.testing.assert_array_equal(found.limited, ~inside)
    assert found.configurations.closure_residual.max() < 1e-13
    margin = limits.margin(found.configurations.leg_lengths)
    assert margin.min() > -1e-9
    # Where the pose gives way, a leg is at its limit: otherwise it could be nearer.
    assert margin[~inside].max() < 1e-6
    position = np.linalg.norm(found.configurations.translation - poses.translation, axis=-1)
    np.testing.assert_allclose(position, np.linalg.norm(found.shift, axis=-1), atol=1e-15)
    moved = (found.configurations.pose.rotation * poses.rotation.inv()).magnitude()
    np.testing.assert_allclose(moved, found.turn, atol=1e-7)


def test_the_compromise_is_optimal() -> None:
    """No small motion of the platform that respects the limits to first order lowers the objective."""
    limits = spm.LegLimits(1.0, 1.65)
    poses = path(12)
    found = nlp.track(poses, SEED, limits=limits)
    k = int(np.flatnonzero(found.limited)[-1])
    state, d = found.configurations[k], GEOMETRY.middle_side
    away = (state.pose.rotation * poses[k].rotation.inv()).as_rotvec()
    gradient = np.concatenate([found.shift[k] / d**2, away])
    rates = spm.inverse_jacobian(state)
    margins = np.concatenate([state.leg_lengths - limits.minimum, limits.maximum - state.leg_lengths])
    normals = np.concatenate([rates, -rates])[margins < 1e-6]
    multipliers, *_ = np.linalg.lstsq(normals.T, gradient, rcond=None)
    assert (multipliers > 0.0).all()
    assert np.linalg.norm(normals.T @ multipliers - gradient) < 0.1 * np.linalg.norm(gradient)


@pytest.mark.parametrize(
    ("ranges", "angles", "least", "greatest"),
    [
        (nlp.JointRanges(ball=np.deg2rad(60.0)), ball_angles, -np.inf, np.deg2rad(60.0)),
        (nlp.JointRanges(inclination=np.deg2rad((-15.0, 15.0))), inclinations, -np.deg2rad(15.0), np.deg2rad(15.0)),
    ],
)
def test_ranges_of_the_passive_joints(ranges: nlp.JointRanges, angles: object, least: float, greatest: float) -> None:
    assert callable(angles)
    free = nlp.track(path(6), SEED, limits=FREE)
    assert angles(free.configurations).max() > greatest or angles(free.configurations).min() < least
    found = nlp.track(path(6), SEED, limits=FREE, ranges=ranges)
    assert found.solved.all()
    assert found.limited.any()
    assert angles(found.configurations).max() <= greatest + 1e-8
    assert angles(found.configurations).min() >= least - 1e-8


def test_limits_of_the_geometry_are_the_default() -> None:
    tight = spm.Geometry(GEOMETRY.base_radius, GEOMETRY.platform_radius, GEOMETRY.middle_side, spm.LegLimits(1.0, 1.65))
    seed = spm.Configuration(tight, SEED.pose, SEED.middle_joints)
    by_default, given = nlp.track(path(4), seed), nlp.track(path(4), seed, limits=tight.limits)
    np.testing.assert_array_equal(by_default.configurations.middle_joints, given.configurations.middle_joints)


def test_the_other_side_of_a_singularity_is_said() -> None:
    other = spm.inverse_displacement(GEOMETRY, path(2)[0])["TT-"]
    far = spm.pose(POSITION + np.array([-0.1, 0.1, 0.15]), xyx=np.deg2rad(XYX + np.array([3.0, -5.0, 2.0])))
    assert not spm.inverse_displacement(GEOMETRY, far)["TT+"].exists
    step = RigidTransform.from_matrix(np.stack([path(2)[0].as_matrix(), far.as_matrix()]))
    found = nlp.track(step, other, limits=FREE)
    assert not found.crossed[0]
    assert found.limited[1] or found.crossed[1]


def test_limits_that_nothing_meets_fail_and_say_how() -> None:
    found = nlp.track(path(3), SEED, limits=spm.LegLimits(0.01, 0.1), options={"ipopt.max_iter": 30})
    assert not found.solved.any()
    assert len(found.outcomes) == 3
    assert not {"Held", "Solve_Succeeded"} & set(found.outcomes)
    assert np.isnan(found.shift).all()
    assert not found.limited.any()


def test_an_interrupt_keeps_the_path_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    module = importlib.import_module("spm_pin.nlp.track")
    poses, newton = path(5), module.newton

    def interrupted(*arguments: object) -> object:
        if (np.asarray(arguments[2])[:3, 3] == poses[2].translation).all():
            raise KeyboardInterrupt
        return newton(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "newton", interrupted)
    with pytest.raises(nlp.Interrupted) as caught:
        nlp.track(poses, SEED, limits=FREE)
    partial = caught.value.partial
    np.testing.assert_array_equal(partial.solved, [True, True, False, False, False])
    assert partial.outcomes == ("Held", "Held")


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: nlp.track(path(2)[0], SEED), "path: expected poses of shape"),
        (lambda: nlp.track(path(2), spm.inverse_displacement(GEOMETRY, path(2))["FT+"]), "seed"),
        (lambda: nlp.track(path(2), "TT+"), "seed: expected a single Configuration"),  # type: ignore[arg-type]
        (lambda: nlp.JointRanges(ball=40.0), "Degrees"),
        (lambda: nlp.JointRanges(inclination=(0.5, 0.1)), "minimum < maximum"),
    ],
)
def test_bad_arguments_are_clear(call: object, words: str) -> None:
    assert callable(call)
    with pytest.raises(spm.ArgumentError, match=words):
        call()
