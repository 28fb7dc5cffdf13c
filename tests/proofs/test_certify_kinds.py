"""Certificates of machines of PRS and RRS legs: against machines within the errors, and mpmath."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

import spm_pin as spm
from spm_pin.kinematics.intervals import Interval, angle, cosine, sine
from spm_pin.machine import PRS, RPS, RRS, Stage
from spm_pin.proofs.certificate import stage_regions
from spm_pin.proofs.stage_proof import region_coordinates

SERVOS = Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35), limits=(0.1, 0.9))
SCREWS = Stage(0.22, 0.25, PRS(rod=0.30, direction=1.4), limits=(0.0, 0.12))
MACHINES = {
    "RRS-PRS": spm.Manipulator.of_stages(SERVOS, SCREWS),
    "PRS-RRS": spm.Manipulator.of_stages(
        Stage(0.30, 0.25, PRS(rod=0.30, direction=1.4, sign=-1), limits=(0.0, 0.12)),
        Stage(0.22, 0.25, RRS(crank=0.15, rod=0.35), limits=(0.1, 0.9)),
    ),
    "inner knees": spm.Manipulator.of_stages(
        Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35, sign=1), limits=(1.9, 2.4)),
        Stage(0.22, 0.25, RPS(), limits=(0.35, 0.42)),
    ),
}


def machine_within(nominal: spm.Manipulator, error: float, rng: np.random.Generator) -> spm.Manipulator:
    """Return a random machine; half of them are at corners of the set."""
    count = len(nominal.parameters)
    share = rng.uniform(-1.0, 1.0, count) if rng.uniform() < 0.5 else rng.choice([-1.0, 1.0], count)
    return nominal.from_parameters(nominal.parameters + error * share)


def random_readings(machine: spm.Manipulator, count: int, rng: np.random.Generator) -> np.ndarray:
    """Return readings within the limits, half of them at ends."""
    low, high = np.array([machine.limits.minimum, machine.limits.maximum])
    readings = rng.uniform(low, high, (count, 6))
    readings[: count // 2] = np.where(rng.random((count // 2, 6)) < 0.5, low, high)
    return readings


@pytest.mark.parametrize("error", [0.0, 1e-4])
@pytest.mark.parametrize("name", MACHINES)
def test_all_readings_within_certified_limits_have_a_regular_state(name: str, error: float) -> None:
    nominal, rng = MACHINES[name], np.random.default_rng(3)
    certificate = spm.certify(nominal, length_error=error, angle_error=error)
    assert certificate.holds, certificate.explain()
    assert "nor is a leg singular itself" in certificate.explain()
    assert any(f"{np.degrees(angle):g}°" in certificate.explain() for angle in (0.9, 2.4))
    signs = None
    for _ in range(10 if error else 1):
        machine = machine_within(nominal, 0.999 * error, rng)
        found = spm.forward_physical(machine, random_readings(nominal, 100, rng))
        assert certificate.covers(found).all()
        values = spm.determinants(found)[:, :2] / nominal.middle_side**3
        signs = np.sign(values[0]) if signs is None else signs
        assert (signs * values >= certificate.bounds).all()
        assert (found.slopes * machine.legs.slope_signs > 0.0).all()


@pytest.mark.parametrize("error", [1e-4, 3e-3, 2e-2])
@pytest.mark.parametrize("name", MACHINES)
def test_enclosures_contain_what_machines_within_errors_have(name: str, error: float) -> None:
    nominal, rng = MACHINES[name], np.random.default_rng(5)
    regions = stage_regions(nominal, nominal.limits, (error, error))
    used: dict[str, float] = {}

    def contained(part: str, interval: Interval, exact: np.ndarray) -> None:
        assert ((interval.low - 1e-14 <= exact) & (exact <= interval.high + 1e-14)).all(), part
        middle, half = 0.5 * (interval.high + interval.low), 0.5 * (interval.high - interval.low)
        used[part] = max(used.get(part, 0.0), float((np.abs(exact - middle) / half).max()))

    for _ in range(40):
        machine = machine_within(nominal, error, rng)
        found = spm.forward_physical(machine, random_readings(nominal, 20, rng))
        found = found[found.exists]
        radii, determinants = np.linalg.norm(found.leg_vectors, axis=-1), np.abs(spm.determinants(found))
        for k, region in enumerate(regions):
            part = slice(3 * k, 3 * k + 3)
            values = region.evaluate(*(Interval.from_numbers(x) for x in region_coordinates(found)[:, k].T))
            assert not values.is_beyond.any()
            own = (found.readings - machine.legs.offsets)[:, part]
            own_slopes = (found.slopes * machine.legs.slope_signs)[:, part].min(axis=-1)
            assert (values.slope <= own_slopes + 1e-14).all()
            for i in range(3):
                contained("reading", values.readings[i], own[:, i])
                contained("square", values.squares[i], radii[:, part][:, i] ** 2)
            contained("determinant", values.determinant, determinants[:, k] * radii[:, part].prod(axis=-1))
    # A forgotten error would exceed the bounds.
    assert used["reading"] > 0.15
    assert used["determinant"] > 0.01


def test_boxes_contain_what_their_states_have() -> None:
    nominal, rng = MACHINES["RRS-PRS"], np.random.default_rng(6)
    found = spm.forward_physical(nominal, random_readings(nominal, 200, rng))
    for k, region in enumerate(stage_regions(nominal, nominal.limits)):
        states, part = region_coordinates(found)[:, k], slice(3 * k, 3 * k + 3)
        ends = states - rng.uniform(0.0, 0.05, states.shape), states + rng.uniform(0.0, 0.05, states.shape)
        values = region.evaluate(*(Interval(low, high) for low, high in zip(*(x.T for x in ends), strict=True)))
        assert not values.is_beyond.any()
        radii = np.linalg.norm(found.leg_vectors, axis=-1)[:, part]
        exact = np.abs(spm.determinants(found))[:, k] * radii.prod(axis=-1)
        assert ((values.determinant.low <= exact) & (exact <= values.determinant.high)).all()
        for i in range(3):
            assert (values.readings[i].low <= found.readings[:, part][:, i]).all()
            assert (found.readings[:, part][:, i] <= values.readings[i].high).all()


def test_limits_up_to_a_leg_s_own_singularity_do_not_certify() -> None:
    """The rods of screws become level, and their carriages pass on: κ = 0 inside the limits."""
    stage = Stage(0.30, 0.25, PRS(rod=0.12), limits=(-0.05, 0.05))
    found = spm.certify(spm.Manipulator.of_stages(stage, SCREWS), boxes=12_000)
    assert found.stages[1].bound > 0.0
    wide = spm.certify(
        spm.Manipulator.of_stages(Stage(0.30, 0.25, PRS(rod=0.06), limits=(-0.06, 0.06)), SCREWS), boxes=12_000
    )
    assert not wide.holds
    assert wide.stages[0].bound == 0.0


def test_a_machine_is_judged_by_what_moves_it() -> None:
    """A choice of the frame {n} is no error; other legs are no errors, however small."""
    nominal = MACHINES["RRS-PRS"]
    parameters = nominal.parameters[:54].reshape(6, 9).copy()
    parameters[:, 5:8] += [0.01, -0.02, 0.005]
    moved = nominal.from_parameters(np.concatenate([parameters.ravel(), nominal.parameters[54:]]))
    found = spm.certify(moved)
    assert max(found.errors) < 1e-12
    other = spm.Manipulator.of_stages(Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35, sign=1)), SCREWS)
    assert not spm.certify(nominal).concerns(other)
    assert not spm.certify(nominal).concerns(spm.Manipulator.paper())


def test_the_widest_limits_of_servos_and_screws() -> None:
    screws = spm.Manipulator.of_stages(Stage(0.30, 0.25, PRS(rod=0.30)), Stage(0.22, 0.25, PRS(rod=0.30)))
    found = spm.largest_certified_limits(screws, 0.05, tolerance=0.3, boxes=20_000)
    assert found.holds
    assert 0.02 < found.limits.maximum[0] - 0.05 < 0.3
    with pytest.raises(spm.GeometryError, match="readings have one unit"):
        spm.largest_certified_limits(MACHINES["RRS-PRS"], 0.05)


def test_a_singular_configuration_says_whose_it_is() -> None:
    found = spm.certify(spm.Manipulator.paper(), spm.LegLimits(1.0, 1.6), boxes=30_000)
    assert found.verdict == "not proved"
    assert found.witness is not None
    text = found.explain()
    assert "a configuration of the nominal machine within the limits is forward singular" in text
    # Seen from this singular state the machine as assembled ends, or is elsewhere: of equal readings found by itself.
    physical = spm.forward_physical(found.machine, found.witness.readings)
    is_same = np.abs(physical.balls - found.witness.balls).max() < 1e-6
    assert ("a regular one: |det J| is" in text) is not is_same
    assert "Narrower limits help" in text


@pytest.mark.parametrize("seed", range(3))
def test_intervals_of_angles_contain_the_values_of_forty_digits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    centre, half = rng.uniform(-12.0, 12.0, 500), 10.0 ** rng.uniform(-16, 1, 500)
    x, shares = Interval(centre - half, centre + half), rng.uniform(size=500)
    inside = np.clip(x.low + shares * (x.high - x.low), x.low, x.high)
    y = Interval(np.roll(x.low, 1), np.roll(x.high, 1))
    other = np.roll(inside, 1)
    with mpmath.workdps(40):
        for run, exact in ((cosine, mpmath.cos), (sine, mpmath.sin)):
            found = run(x)
            for low, high, value in zip(found.low, found.high, inside, strict=True):
                assert low <= exact(mpmath.mpf(value)) <= high
        found = angle(y, x)
        for low, high, b, a in zip(found.low, found.high, other, inside, strict=True):
            assert low <= mpmath.atan2(mpmath.mpf(b), mpmath.mpf(a)) <= high
    quarter = cosine(Interval(np.array([0.1, 3.0, -0.1, 0.0]), np.array([0.2, 3.2, 0.2, 7.0])))
    np.testing.assert_allclose(quarter.low, [np.cos(0.2), -1.0, np.cos(0.2), -1.0], atol=1e-14)
    np.testing.assert_allclose(quarter.high, [np.cos(0.1), np.cos(3.0), 1.0, 1.0], atol=1e-14)
