"""All assembly modes of machines as built: none missed, none extra, with the labels of the drawn machine."""

from __future__ import annotations

import numpy as np
import pytest
from modes_oracle import real_modes
from problems import PAPER, as_built

import spm_pin as spm


@pytest.mark.parametrize("size", [0.0, 1e-4, 1e-2])
@pytest.mark.parametrize("count", [3, pytest.param(20, marks=pytest.mark.slow)])
def test_all_modes_and_no_others(size: float, count: int) -> None:
    rng = np.random.default_rng(count)
    for _ in range(count):
        dimensions = rng.uniform(0.2, 1.5, 2) * PAPER.middle_side
        drawn = spm.Manipulator(*dimensions, PAPER.middle_side)
        machine = as_built(drawn, size, seed=int(rng.integers(1000))) if size else drawn
        reach = drawn.middle_radius + dimensions.repeat(3)
        lengths = reach * rng.uniform(0.6, 1.3) * (1.0 + 0.15 * rng.normal(size=6)).clip(0.3)
        modes = spm.forward_displacement(machine, lengths + machine.legs.offsets)
        assert modes.status is not spm.Status.UNSOLVED
        lower, upper = (
            real_modes(*(x[half] for x in (*machine.legs.arrays[:3], lengths))) for half in (slice(3), slice(3, 6))
        )
        assert modes.count == len(lower) * len(upper)
        states = modes.configurations[modes.exists]
        seen = (states.balls[:, 3:] - states.translation[:, None]) @ states.rotation
        for found, expected in ((states.balls[:, :3], lower), (seen, upper)):
            gaps = np.abs(found[:, None] - expected).max(axis=(-1, -2))
            if gaps.size:
                assert gaps.min(axis=1).max() < 1e-9
                assert gaps.min(axis=0).max() < 1e-9


@pytest.mark.parametrize(("size", "count"), [(1e-3, 1), pytest.param(1e-5, 3, marks=pytest.mark.slow)])
def test_labels_are_carried_while_the_errors_grow(size: float, count: int) -> None:
    """As in eighty small steps from the drawn machine, each from a mode to the nearest."""
    machine = as_built(PAPER, size)
    lengths = np.random.default_rng(4).uniform(1.1, 1.5, (count, 6))
    modes = spm.forward_displacement(machine, lengths + machine.legs.offsets)
    before = spm.forward_displacement(PAPER, lengths)
    points, labelled = before.middle_joints, before.exists
    drawn, built = PAPER.legs, machine.legs
    for share in np.linspace(0.0, 1.0, 81)[1:]:
        axes = drawn.axes + share * (built.axes - drawn.axes)
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        arrays = (a + share * (b - a) for a, b in zip(drawn.arrays[1:3], built.arrays[1:3], strict=True))
        legs = spm.machine.Legs(axes, *arrays, np.zeros(6))
        between = spm.forward_displacement(spm.Manipulator(*PAPER.dimensions, legs=legs), lengths)
        gaps = np.linalg.norm(between.middle_joints[:, None] - points[:, :, None], axis=-1).max(axis=-1)
        nearest = np.nan_to_num(gaps, nan=np.inf).argmin(axis=-1)
        moved = np.take_along_axis(between.middle_joints, nearest[..., None, None], axis=1)
        labelled &= np.linalg.norm(moved - points, axis=-1).max(axis=-1) < 0.05
        points = np.where(labelled[..., None, None], moved, np.nan)
    carried = modes.exists & ~modes.merged
    assert carried.mean() > 0.5
    np.testing.assert_allclose(modes.middle_joints[carried], points[carried], atol=1e-9)
    assert carried.sum() >= 0.99 * (labelled & modes.exists).sum()


def test_modes_of_a_machine_as_built_are_a_set_like_any_other() -> None:
    machine = as_built(PAPER, 1e-3)
    readings = np.random.default_rng(2).uniform(0.6, 2.0, (40, 6))
    modes, state = spm.forward_displacement(machine, readings), spm.forward_physical(machine, readings)
    assert not (modes.status == spm.Status.UNSOLVED).any()
    chosen = modes.physical()
    np.testing.assert_array_equal(chosen.exists, state.exists)
    assert 3 < state.exists.sum() < 37
    np.testing.assert_allclose(chosen.translation, state.translation, atol=1e-13)
    errors = np.abs(modes.readings - readings[:, None])[modes.exists]
    assert errors.max() < 1e-13
    assert np.nanmax(modes.residual) < 1e-14
    alone = spm.forward_displacement(machine, readings[0])
    np.testing.assert_array_equal(alone.middle_joints, modes[0].middle_joints)
    assert spm.forward_displacement(machine, [0.1] * 6).status is spm.Status.UNREACHABLE
    # Legs that are sixty times as long as the middle platform leave too few digits.
    far = spm.forward_displacement(machine, [50.0] * 6)
    assert far.status is spm.Status.UNSOLVED
    assert not far.exists.any()


def test_labels_that_are_left_over_say_mode_and_side() -> None:
    """With large errors nominal modes have met, and others have begun: neither has a label by being followed."""
    machine = PAPER.perturbed(3, length=0.03, angle=0.03)
    lengths = np.array([1.096, 1.508, 1.483, 1.182, 1.532, 1.082])
    modes = spm.forward_displacement(machine, lengths + machine.legs.offsets)
    assert modes.count == 32
    for label in np.array(modes.labels)[modes.exists]:
        state = modes[str(label)]
        lower, upper = state.middle_joints, (state.middle_joints - state.translation) @ state.rotation
        for name, balls, up in zip(label.split("/"), (lower, upper), (1.0, -1.0), strict=True):
            assert (name[0] == "T") == ((balls * PAPER.radial_directions).sum() > 0.0)
            assert (name[-1] == "+") == (up * balls[:, 2].mean() > 0.0)
