"""All assembly modes of machines as built: none missed, none extra, with labels as of the drawn machine."""

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


def test_small_errors_keep_the_labels_of_the_nominal_machine() -> None:
    lengths = np.random.default_rng(4).uniform(1.1, 1.5, (20, 6))
    built = as_built(PAPER, 1e-7)
    drawn, modes = (
        spm.forward_displacement(PAPER, lengths),
        spm.forward_displacement(built, lengths + built.legs.offsets),
    )
    np.testing.assert_array_equal(modes.exists, drawn.exists)
    real = drawn.exists
    np.testing.assert_allclose(modes.middle_joints[real], drawn.middle_joints[real], atol=1e-3)


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


@pytest.mark.parametrize("size", [1e-3, 0.03])
def test_labels_say_mode_and_sheet_and_count_by_falling_radius(size: float) -> None:
    """With large errors too, where the modes are not those of the nominal machine."""
    machine = PAPER.perturbed(3, length=size, angle=size)
    lengths = np.array([1.096, 1.508, 1.483, 1.182, 1.532, 1.082])
    modes = spm.forward_displacement(machine, lengths + machine.legs.offsets)
    assert modes.count >= 32
    radii: tuple[dict[str, float], dict[str, float]] = {}, {}
    for label in np.array(modes.labels)[modes.exists]:
        state = modes[str(label)]
        lower, upper = state.middle_joints, (state.balls[3:] - state.translation) @ state.rotation
        for k, (name, balls, up) in enumerate(zip(label.split("/"), (lower, upper), (1.0, -1.0), strict=True)):
            radius = (balls * PAPER.radial_directions).sum() / 3.0
            assert (name[0] == "T") == (radius > 0.0)
            assert (name[-1] == "+") == (up * balls[:, 2].mean() > 0.0)
            radii[k][name] = radius
    for of_stage in radii:
        for mode, sheet in ("T+", "T-", "F+", "F-"):
            own = [of_stage[name] for name in sorted(of_stage) if name[0] == mode and name[-1] == sheet]
            assert own == sorted(own, reverse=True)
