from __future__ import annotations

import pickle
import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from error_fields import with_fields
from problems import at_end_stops, in_leg_space, random_branches

import spm_pin as spm
from spm_pin.errors import SelectionError
from spm_pin.machine.configuration import check_configuration
from spm_pin.machine.machine import likely_unit

PAPER = spm.Manipulator.paper()
STAGE = spm.inverse_displacement(spm.Stage(0.4, 0.3), 0.5)
POSE = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))


@pytest.fixture
def branches() -> spm.SolutionSet:
    return spm.inverse_displacement(PAPER, POSE)


@pytest.fixture(scope="module")
def batch() -> spm.SolutionSet:
    return spm.inverse_displacement(PAPER, in_leg_space(PAPER, 500, seed=1).pose)


def test_a_single_problem_is_indexed_by_its_solutions(branches: spm.SolutionSet) -> None:
    assert branches.labels == spm.machine.BRANCHES
    assert branches.status is spm.Status.OK
    assert branches.count == 6
    for k, label in enumerate(branches.labels):
        np.testing.assert_array_equal(branches[k].middle_joints, branches[label].middle_joints)
        assert branches[k].exists == branches.exists[k]
    every, backwards = list(branches), list(reversed(branches))
    assert len(every) == len(backwards) == len(branches) == 8
    for k, label in enumerate(branches.labels):
        for state in (every[k], backwards[-1 - k]):
            np.testing.assert_array_equal(state.leg_lengths, branches[label].leg_lengths)
    assert sum(bool(state.exists) for state in every) == branches.count
    with pytest.raises(SelectionError, check=with_fields(argument="index")):
        branches["TT"]
    with pytest.raises(SelectionError, check=with_fields(argument="index")):
        branches[8]


def test_a_batch_is_indexed_by_its_problems(batch: spm.SolutionSet) -> None:
    assert batch.shape == (500,)
    member = batch[7]
    assert isinstance(member, spm.SolutionSet)
    assert member.shape == ()
    np.testing.assert_array_equal(member.leg_lengths, batch.leg_lengths[7])
    np.testing.assert_array_equal(member.discriminants, np.asarray(batch.discriminants)[7])
    some = batch[10:20]
    assert some.shape == (10,)
    np.testing.assert_array_equal(some["TT-"].leg_lengths, batch.leg_lengths[10:20, 1])
    assert [some[i].count for i in range(10)] == list(batch.count[10:20])
    with pytest.raises(TypeError, match=r"solutions\[i\] is problem i"):
        iter(some)
    assert batch[np.array([3, 5])].shape == (2,)
    grid = spm.inverse_displacement(PAPER, in_leg_space(PAPER, 6, seed=1).pose.as_matrix().reshape(3, 2, 4, 4))
    assert grid.shape == (3, 2)
    assert grid[1, 0].shape == ()
    assert grid[:, 1].shape == (3,)
    assert grid[..., 1].shape == (3,)
    with pytest.raises(SelectionError, match=r"a label, or an index of the problems \(3, 2\), got tuple"):
        grid[0, 0, 0]


def test_what_selects_nothing_is_one_kind_of_error(branches: spm.SolutionSet, batch: spm.SolutionSet) -> None:
    assert issubclass(SelectionError, LookupError)
    wrong_indices = (
        1.5,
        "\0",
        "tt+",
        1j,
        10**400,
        {},
        object(),
        [[0], [0, 1]],
        (0, 0, 0),
        np.ones(9, dtype=bool),
        b"TT+",
    )
    for wrong in wrong_indices:
        for indexed in (branches, batch, branches.configurations, branches[0]):
            with pytest.raises(SelectionError, check=with_fields(argument="index")):
                indexed[wrong]


def test_within_keeps_what_respects_the_limits(batch: spm.SolutionSet) -> None:
    kept = batch.within()
    lengths = batch.leg_lengths
    with np.errstate(invalid="ignore"):
        expected = ((lengths >= 1.1) & (lengths <= 1.5)).all(axis=-1)
    np.testing.assert_array_equal(kept.exists, expected)
    assert kept.exists.any(axis=-1).all()
    assert np.isnan(kept.leg_lengths[~expected]).all()
    np.testing.assert_array_equal(kept.status, batch.status)
    # The rounded pose takes r_c3 of the paper's machine beyond 1.50 m.
    assert not spm.inverse_displacement(PAPER, POSE).within().physical().exists
    tight = batch.within(spm.LegLimits(1.2, 1.4))
    assert tight.exists.sum() < kept.exists.sum()
    unlimited = spm.inverse_displacement(replace(PAPER, limits=None), POSE)
    assert unlimited.within() is unlimited


@pytest.mark.parametrize(("machine", "count"), [(PAPER, 2_000), (PAPER.perturbed(1, length=1e-3, angle=1e-3), 200)])
def test_a_state_with_legs_at_their_end_stops_keeps_its_branch(machine: spm.Manipulator, count: int) -> None:
    """Its readings computed from its pose are beyond the stops by rounding in about half of all cases."""
    states, limits = at_end_stops(machine, count), machine.limits
    assert limits is not None
    solutions = spm.inverse_displacement(machine, states.pose)
    own = solutions.nearest(states)
    np.testing.assert_allclose(own.readings, states.readings, rtol=0, atol=1e-9)
    beyond = (own.readings < limits.minimum) | (own.readings > limits.maximum)
    assert 0.2 < beyond.any(axis=-1).mean() < 0.9
    np.testing.assert_array_equal(solutions.within().nearest(states).readings, own.readings)
    assert limits.contains(spm.inverse_physical(machine, states.pose).readings).all()
    assert limits.contains(solutions.physical().readings).all()
    assert spm.workspace.reachable(machine, states.pose).reachable.all()
    assert not limits.excess(own.readings).any()
    assert (limits.margin(own.readings) >= 0.0).all()


def test_of_two_physical_branches_the_one_at_its_end_stop_is_within_the_limits() -> None:
    readings = [1.42881598, 1.5, 1.1, 1.2050192, 1.13281504, 1.36825423]
    pose = spm.forward_physical(PAPER, readings).pose
    for found in (spm.inverse_physical(PAPER, pose), spm.inverse_displacement(PAPER, pose).physical()):
        np.testing.assert_allclose(found.readings, readings, rtol=0, atol=1e-12)


def test_nearest_finds_every_branch_again(batch: spm.SolutionSet) -> None:
    rng = np.random.default_rng(0)
    for k in range(8):
        have = batch.exists[:, k]
        state = batch[have][batch.labels[k]]
        shaken = state.middle_joints + rng.normal(size=state.middle_joints.shape) * 1e-9
        np.testing.assert_array_equal(batch[have].nearest(shaken).middle_joints, state.middle_joints)
        np.testing.assert_array_equal(batch[have].nearest(state).middle_joints, state.middle_joints)


def test_no_solution_has_no_physical_one() -> None:
    nothing = spm.inverse_displacement(PAPER, spm.pose([9, 9, 9], rotation=POSE.rotation))
    assert nothing.status is spm.Status.UNREACHABLE
    assert not nothing.physical().exists
    assert np.isnan(nothing.physical().translation).all()
    assert np.isnan(nothing.physical().rotation).all()
    assert not nothing.nearest(np.zeros((3, 3))).exists
    assert not nothing.ambiguous
    assert nothing.count == 0
    assert not any(state.exists for state in nothing)


def test_the_physical_branch_is_the_one_the_pose_was_made_from() -> None:
    problem = in_leg_space(PAPER, 4_000, seed=3)
    solutions = spm.inverse_displacement(PAPER, problem.pose)
    chosen = solutions.physical()
    assert chosen.exists.all()
    same = np.abs(chosen.middle_joints - problem.middle_joints).max(axis=(-1, -2)) < 1e-6
    assert same[~solutions.ambiguous].all()
    assert 0.005 < solutions.ambiguous.mean() < 0.015
    # Where two are left they are the two sides of an inverse singularity, and a seed decides.
    left = solutions[solutions.ambiguous]
    assert (left.is_physical.sum(axis=-1) == 2).all()
    assert left.is_physical[:, :2].all()
    seed = problem.configuration[np.flatnonzero(solutions.ambiguous)]
    seeded = left.physical(near=seed)
    np.testing.assert_allclose(seeded.middle_joints, seed.middle_joints, atol=1e-6)
    tilts = left.configurations.tilt_cosine_sum[:, :2]
    np.testing.assert_allclose(left.physical().tilt_cosine_sum, tilts.max(axis=-1))


def test_one_returns_the_only_solution_or_raises(branches: spm.SolutionSet) -> None:
    with pytest.raises(spm.NotOneSolutionError, match="got 6: TT") as caught:
        branches.one()
    assert caught.value.labels == ("TT+", "TT-", "TF+", "TF-", "FF+", "FF-")
    with pytest.raises(spm.NotOneSolutionError, match=r"got 144: (T1[^,]*, ){7}T1[^,]* and 136 more") as caught:
        spm.forward_displacement(PAPER, [1.2, 1.2, 1.4, 1.25, 1.2, 1.5]).one()
    assert len(caught.value.labels) == 144
    assert branches.where(np.array(branches.labels) == "FF+").one().exists
    with pytest.raises(spm.NotOneSolutionError, match="got none"):
        branches.where(np.zeros(8, dtype=bool)).one()
    pair = spm.inverse_displacement(PAPER, spm.pose([POSE.translation] * 2, rotation=POSE.rotation))
    mask = np.zeros((2, 8), dtype=bool)
    mask[0, 0] = True
    with pytest.raises(spm.NotOneSolutionError, match=r"got none at batch index \(1,\)"):
        pair.where(mask).one()


@pytest.mark.parametrize("modes", spm.machine.FAMILIES)
def test_branches_in_any_order_get_their_canonical_labels(modes: str) -> None:
    problem = random_branches(PAPER, modes, 300, seed=4)
    solutions = spm.inverse_displacement(PAPER, problem.pose)
    shuffled = np.random.default_rng(0).permuted(np.arange(8)[None].repeat(300, 0), axis=1)
    joints = np.take_along_axis(solutions.middle_joints, shuffled[..., None, None], axis=1)
    again = spm.SolutionSet.from_unordered(PAPER, problem.pose, joints)
    np.testing.assert_array_equal(again.middle_joints, solutions.middle_joints)
    np.testing.assert_array_equal(again.status, solutions.status)


def test_more_than_two_branches_of_a_family_give_the_status_unsolved(branches: spm.SolutionSet) -> None:
    joints = np.array(branches.middle_joints)
    joints[4] = joints[0] + 1e-4
    wrong = spm.SolutionSet.from_unordered(PAPER, POSE, joints)
    assert wrong.status is spm.Status.UNSOLVED
    assert not wrong.exists.any()
    failed = spm.SolutionSet.from_unordered(PAPER, POSE, branches.middle_joints, solved=False)
    assert failed.status is spm.Status.UNSOLVED


def test_representations_are_summaries(branches: spm.SolutionSet, batch: spm.SolutionSet) -> None:
    assert repr(branches) == "<SolutionSet: ok, 6 of 8 real: TT+, TT-, TF+, TF-, FF+, FF->"
    assert "(500,) problems (500 ok, 0 unreachable" in repr(batch)
    assert repr(branches["TT+"]).startswith("<Configuration: readings 1.1998 m, 1.2000 m")


LEVEL = spm.pose([0.0, 0.0, 2.2], rotation=np.eye(3))


def test_the_error_of_a_level_pose_says_why_and_what_to_do() -> None:
    branches = spm.inverse_displacement(PAPER, LEVEL)
    words = "level platform over the axis of the base is singular for the inverse.*forward_physical.*tilt.*nearest"
    with pytest.raises(spm.NotOneSolutionError, match=f"got none: a {words}"):
        branches.one()
    absent = branches.physical()
    assert not absent.exists
    assert re.search(f"does not exist: a {words}", repr(absent))
    with pytest.raises(spm.ArgumentError, match=f"^configuration: expected a configuration that exists, .*{words}"):
        check_configuration(absent, existing=True)


@pytest.mark.parametrize(
    ("absent", "words"),
    [
        (lambda: spm.inverse_displacement(PAPER, spm.pose([9, 9, 9], rotation=POSE.rotation)), "out of reach"),
        (lambda: spm.inverse_displacement(PAPER, spm.pose([0.7, 0.5, 2.3], rpy=[5, 3, 0])), "turned by 174° relative"),
        (lambda: spm.inverse_displacement(PAPER, spm.pose([0.7, 0.5, 2.3], rpy=[5, 3, 0])), "nearest_reachable_pose"),
        (lambda: spm.inverse_displacement(PAPER, POSE).within(), r"\.within\(limits\)"),
        (lambda: spm.forward_displacement(PAPER, [0.1, 1, 9, 1, 1, 1]), "out of reach"),
    ],
)
def test_a_state_that_does_not_exist_says_why(absent: Callable[[], spm.SolutionSet], words: str) -> None:
    assert re.search(f"does not exist: .*{words}", repr(absent().physical()))
    assert "metres" not in repr(absent()) + repr(absent().physical())


FAR = spm.pose([68.89, 49.63, 225.3], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
LONG = [120, 120, 140, 125, 120, 150]


@pytest.mark.parametrize(("typed", "unit"), [(350.0, "mm"), (1200.0, "mm"), (120.0, "cm"), (230.0, "cm"), (2.3, None)])
def test_the_unit_of_a_length_is_the_one_in_which_machines_have_it(typed: float, unit: str | None) -> None:
    """Legs and positions of the paper's machine, 2.6 m high; those of a balancer a tenth of it, a tenth."""
    assert likely_unit(PAPER, typed) == unit
    small = spm.Stage(0.08, 0.08, spm.RRS(crank=0.04, rod=0.064))
    assert likely_unit(small, 0.1 * typed) == unit


@pytest.mark.parametrize("length", [225.3, 150])
def test_what_does_not_hold_in_another_unit_hints_at_it(length: float) -> None:
    long = length == 150
    solutions = spm.forward_displacement(PAPER, LONG) if long else spm.inverse_displacement(PAPER, FAR)
    absent = spm.forward_physical(PAPER, LONG) if long else spm.inverse_physical(PAPER, FAR)
    hint = f"{length:g} m is out of proportion to this machine; is it {length:g} cm?"
    assert solutions.status is spm.Status.UNREACHABLE
    for found in (solutions, solutions.physical(), absent, pickle.loads(pickle.dumps(solutions))):
        assert hint in repr(found)
    with pytest.raises(spm.NotOneSolutionError, match=re.escape(hint)):
        solutions.one()
    with pytest.raises(spm.ArgumentError, match=re.escape(hint)):
        spm.follow(PAPER, [LONG, LONG] if long else [FAR.as_matrix()] * 2)
    chain = spm.ClosedChain.from_urdf()
    with pytest.raises(spm.ArgumentError, match=re.escape(hint)):
        chain.forward_kinematics(LONG) if long else chain.inverse_kinematics(FAR)
    with pytest.raises(spm.ArgumentError, match=re.escape(hint)):
        chain.joint_values(absent)
    if not long:
        with pytest.raises(spm.NotOneSolutionError, match=re.escape(hint)):
            spm.inverse_displacement(PAPER, np.stack([FAR.as_matrix()] * 2)).one()
        assert hint in repr(spm.inverse_displacement(PAPER.perturbed(1), FAR))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda s: s.nearest(np.zeros((2, 3, 3))), "near: expected"),
        (lambda s: s.nearest(s["FT+"]), "near: expected states that exist"),
        (lambda s: s.within(1.5), "limits: expected LegLimits, or a pair"),
        (lambda s: s.within(([0, 0.1, 0], 1)), "limits: expected limits of 6 legs, or one for all, got limits of 3"),
        (
            lambda s: STAGE.within(spm.LegLimits.stages((1.1, 1.5), (1, 2))),
            "limits: expected limits of 3 legs",
        ),
        (lambda s: spm.inverse_physical(None, POSE), "machine: expected a Manipulator or a Stage, got NoneType"),
        (lambda s: spm.forward_physical(None, [1.2] * 6), "machine: expected a Manipulator or a Stage, got NoneType"),
        (lambda s: spm.SolutionSet(s, ["a"], 0), "configurations.*: expected"),
        (lambda s: spm.SolutionSet(s.configurations, ["a"], 0), "configurations.*: expected"),
        (lambda s: spm.SolutionSet.from_unordered(PAPER, POSE, np.zeros((0, 3, 3))), "middle_joints.*: expected"),
        (lambda s: spm.SolutionSet.from_unordered(PAPER, POSE, np.zeros((1, 3, 3))), "middle_joints.*: expected"),
    ],
)
def test_wrong_arguments_are_named(branches: spm.SolutionSet, call: Callable, says: str) -> None:
    with pytest.raises(spm.ArgumentError, match=f"^{says}"):
        call(branches)


def test_physical_agrees_with_forward_displacement() -> None:
    """The mode picked among all assembly modes is the one found directly, and exists where that does."""
    legs = np.random.default_rng(5).uniform(0.8, 2.0, (300, 6))
    direct = spm.forward_physical(PAPER, legs)
    modes = spm.forward_displacement(PAPER, legs)
    mode_is_physical = modes.where(modes.configurations.is_at_home)
    np.testing.assert_array_equal(mode_is_physical.exists.sum(axis=-1), direct.exists)
    chosen = mode_is_physical.where(mode_is_physical.exists)[direct.exists].one()
    np.testing.assert_allclose(chosen.middle_joints, direct.middle_joints[direct.exists], atol=1e-9)
    assert 0.2 < direct.exists.mean() < 0.8


def test_only_what_was_used_is_named_where_no_solution_is_physical(branches: spm.SolutionSet) -> None:
    physical = branches.is_physical
    unphysical = spm.SolutionSet(branches.configurations[2:], branches.labels[2:], branches.status)
    assert unphysical.count == 4
    for found in (unphysical.physical(), unphysical.physical(near=branches["TT+"])):
        assert found.missing_reason.startswith("none of the solutions is physical")
    for found in (branches.where(~physical).physical(), branches.where(~physical).physical(near=branches["TT+"])):
        assert found.missing_reason.startswith("none of the solutions left by .within(limits) or .where(mask) is")
    nothing = branches.within(spm.LegLimits(0.1, 0.2)).physical()
    assert nothing.missing_reason.startswith(".within(limits) or .where(mask) excluded all solutions")
    np.testing.assert_array_equal(
        branches.physical(near=branches["FF+"]).readings, branches.where(physical).nearest(branches["FF+"]).readings
    )
