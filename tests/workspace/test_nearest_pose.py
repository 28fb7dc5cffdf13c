"""The reachable pose nearest to one out of reach: against random poses, and against its own definition."""

from __future__ import annotations

import numpy as np
import pytest
from error_fields import with_fields
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.workspace import nearest_reachable_pose, pose_distance
from spm_pin.workspace.state_set import states_within

PAPER = spm.Manipulator.paper()
BUILT = PAPER.perturbed(3, length=5e-3, angle=5e-3)
FREE = spm.Manipulator(PAPER.base_radius, PAPER.platform_radius, PAPER.middle_side)
START = spm.forward_physical(PAPER, [1.2, 1.2, 1.4, 1.25, 1.2, 1.5])
TARGET = spm.pose([1.5, 0.4, 2.2], xyx=np.deg2rad([20.0, 30.0, -15.0]))


def moved(pose, shift, turn):
    return spm.pose(pose.translation + np.array(shift), rotation=Rotation.from_rotvec(turn) * pose.rotation)


def random_targets(count, seed=3):
    rng = np.random.default_rng(seed)
    return [moved(START.pose, rng.normal(0.0, 0.3, 3), rng.normal(0.0, 0.3, 3)) for _ in range(count)]


@pytest.mark.parametrize("family", spm.machine.FAMILIES)
def test_without_limits_the_branch_is_real_and_nothing_found_at_random_is_nearer(family):
    rng = np.random.default_rng(spm.machine.FAMILIES.index(family))
    place = 2 * spm.machine.FAMILIES.index(family)
    tried = 0
    while tried < 2:
        target = spm.pose(rng.normal([0.0, 0.0, 2.2], [0.9, 0.9, 0.3]), xyx=rng.normal(0.0, 0.6, 3))
        if spm.inverse_displacement(FREE, target).exists[place]:
            continue
        tried += 1
        found = nearest_reachable_pose(FREE, target, branch=f"{family}+")
        nearest = found.configuration.pose
        assert spm.inverse_displacement(FREE, nearest).exists[place]
        assert found.distance == pytest.approx(pose_distance(FREE, nearest, target))
        # Poses around the result and around the target, of every size of step.
        for centre in (nearest, target):
            size = np.geomspace(1e-4, 1.0, 1500)[:, None] * found.distance
            shifts, turns = rng.normal(0.0, 1.0, (2, 1500, 3)) * size
            rotation = Rotation.from_rotvec(turns / FREE.platform_radius) * centre.rotation
            poses = spm.pose(centre.translation + shifts, rotation=rotation)
            real = spm.inverse_displacement(FREE, poses).exists[:, place]
            assert pose_distance(FREE, poses[real], target).min(initial=np.inf) > found.distance - 1e-4


@pytest.mark.parametrize("limits", [None, spm.LegLimits(0.0, np.inf)], ids=["limited", "unlimited"])
def test_a_reachable_pose_is_its_own_nearest(limits):
    assert nearest_reachable_pose(PAPER, START.pose, limits).distance < 1e-8


def test_reachable_poses_of_a_tiny_platform_are_returned_as_they_are() -> None:
    """A search ends some 1e-6 of the machine beside them."""
    legs = spm.RPS(), spm.RRS(crank=1.7, rod=2.3, sign=1)
    limits = spm.LegLimits.stages((2.1, 2.9), (2.0, 2.8))
    machine = spm.Manipulator(0.6, 0.03, 1.5, limits, legs=legs)
    poses = spm.workspace.sample_reachable(machine, 6, rng=1).pose
    found = nearest_reachable_pose(machine, poses)
    np.testing.assert_array_equal(found.distance, 0.0)
    beside = moved(poses[0], [3.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    both = nearest_reachable_pose(
        machine, spm.pose(np.stack([p.translation for p in (poses[0], beside)]), rotation=poses[0].rotation)
    )
    np.testing.assert_array_equal(both.distance > 0.0, [False, True])
    np.testing.assert_array_equal(both.configuration.limit_excess, 0.0)


def test_a_batch_has_the_results_of_its_members():
    targets = spm.pose(
        [target.translation for target in random_targets(4)],
        rotation=Rotation.from_matrix([target.rotation.as_matrix() for target in random_targets(4)]),
    )
    batch = nearest_reachable_pose(PAPER, targets)
    assert batch.configuration.shape == batch.distance.shape == (4,)
    for k in range(4):
        single = nearest_reachable_pose(PAPER, targets[k])
        assert single.distance == batch.distance[k]
        np.testing.assert_array_equal(single.configuration.middle_joints, batch.configuration.middle_joints[k])


def test_distance_is_that_of_the_platform_joints():
    first, second = START.pose, random_targets(1)[0]
    c = PAPER.platform_joints
    expected = np.sqrt(((first.apply(c) - second.apply(c)) ** 2).sum(axis=-1).mean())
    assert pose_distance(PAPER, first, second) == pytest.approx(expected, rel=1e-14)
    assert pose_distance(PAPER, first, first) == 0.0


@pytest.mark.parametrize(
    ("arguments", "argument"),
    [
        ({"limits": spm.LegLimits(0.0, np.inf), "branch": "TX+"}, "branch"),
        ({"branch": "TT+"}, "branch"),
        ({"near": spm.forward_physical(PAPER, [1.0] * 6)}, "near"),
        ({"near": spm.forward_physical(spm.Manipulator(0.5, 0.5, 0.5), [1.2] * 6)}, "near"),
        ({"limits": spm.LegLimits(1100, 1500)}, "limits"),
    ],
)
def test_wrong_arguments_are_named(arguments, argument):
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        nearest_reachable_pose(**{"machine": PAPER, "pose": START.pose, **arguments})


@pytest.mark.parametrize(("machine", "limits"), [(PAPER, (0.6, 2.0)), (BUILT, (1.1, 1.5))], ids=["wide", "as built"])
def test_a_drag_stays_within_the_limits_and_comes_never_farther(
    machine: spm.Manipulator, limits: tuple[float, float]
) -> None:
    rng, box = np.random.default_rng(6), spm.LegLimits(*limits)
    here = spm.forward_physical(machine, [1.3] * 6)
    place, turn = here.translation.copy(), here.pose.rotation
    for _ in range(60):
        place = place + rng.normal(0.0, 0.04, 3)
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.03, 3)) * turn
        target = spm.pose(place, rotation=turn)
        before = pose_distance(machine, here.pose, target)
        nearest = nearest_reachable_pose(machine, target, box, near=here)
        here = nearest.configuration
        assert nearest.distance <= before + 1e-8
        assert nearest.distance == pytest.approx(pose_distance(machine, here.pose, target), abs=1e-12)
        assert box.margin(here.readings) >= -1e-12
        assert here.closure_residual < 1e-13
        assert here.is_at_home


def test_without_limits_the_nearest_pose_has_the_branch() -> None:
    limits = spm.LegLimits(0.0, np.inf)
    drawn, built = (nearest_reachable_pose(machine, TARGET, limits, branch="TT+") for machine in (PAPER, BUILT))
    assert built.configuration.closure_residual < 1e-13
    assert built.distance == pytest.approx(drawn.distance, abs=0.03)


@pytest.mark.parametrize(
    ("place", "turn", "most"),
    [
        # The states nearest to the target lead to one that is 0.49 m away.
        ([-0.7413837786575485, -0.7539752247540946, 0.7062825095402535], [1.1113993, 1.9798418, 0.0225931], 0.3323),
        # To ten thousandths the best of SLSQP from 60 random states; twelve starts and the two best ends lead to 0.524,
        # 0.459, 0.460 and 0.287 m.
        ([-0.593, -0.158, 1.119], [0.294, -0.62, 3.065], 0.4444),
        ([-0.349, 1.006, 0.989], [0.38, 1.331, -0.455], 0.4494),
        ([-0.201, 0.302, 0.483], [-0.529, 0.078, -0.445], 0.3301),
        ([0.112, -0.281, 0.763], [2.002, -2.149, 0.351], 0.2526),
    ],
)
def test_within_wide_limits_a_search_does_not_stop_in_a_bad_minimum(
    place: list[float], turn: list[float], most: float
) -> None:
    target, limits = spm.pose(place, rotation=Rotation.from_rotvec(turn)), spm.LegLimits(0.6, 2.0)
    nearest = nearest_reachable_pose(PAPER, target, limits)
    assert pose_distance(PAPER, nearest.configuration.pose, target) < most
    assert limits.contains(nearest.configuration.readings)
    assert spm.inverse_physical(PAPER, nearest.configuration.pose, near=nearest.configuration).exists


def test_one_pose_needs_no_large_sample() -> None:
    limits = spm.LegLimits(1.1, 1.49)
    nearest = nearest_reachable_pose(PAPER, spm.pose([0.3, 0.1, 3.0], xyx=[0.1, 0.3, -0.1]), limits)
    assert nearest.configuration.exists
    assert {"sample", "tree", "_covers"}.isdisjoint(vars(states_within(PAPER, limits)))
