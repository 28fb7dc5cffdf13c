"""Certificates of machines of PRS and RRS legs: against machines within the errors, and mpmath."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from proofs.machines_within_errors import machine_within, readings_within

import spm_pin as spm
from spm_pin.kinematics.intervals import Interval, angle, cosine, sine
from spm_pin.machine import PRS, RPS, RRS, Stage
from spm_pin.proofs import stage_proof
from spm_pin.proofs.certificate import stage_regions
from spm_pin.proofs.stage_proof import region_coordinates

PAPER = spm.Manipulator.paper()
SERVOS = Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35), limits=(0.1, 0.9))
SCREWS = Stage(0.22, 0.25, PRS(rod=0.30, direction=1.4), limits=(0.0, 0.12))
MACHINES = {
    "RPS-RPS": PAPER,
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
MANY = [pytest.param("RPS-RPS", error, 200, marks=pytest.mark.slow) for error in (1e-4, 1e-3)]


@pytest.mark.parametrize(("name", "error", "machines"), [*((x, e, 10) for x in MACHINES for e in (0.0, 1e-4)), *MANY])
def test_all_readings_within_certified_limits_have_a_regular_state(name: str, error: float, machines: int) -> None:
    nominal, rng = MACHINES[name], np.random.default_rng(3)
    certificate = spm.certify(nominal, length_error=error, angle_error=error)
    assert certificate.holds, certificate.explain()
    if name != "RPS-RPS":
        assert "nor is a leg singular itself" in certificate.explain()
        assert any(f"{np.degrees(angle):g}°" in certificate.explain() for angle in (0.9, 2.4))
    signs = None
    for _ in range(machines if error else 1):
        machine = machine_within(nominal, 0.999 * error, 0.999 * error, rng)
        found = spm.forward_physical(machine, readings_within(nominal.limits, 150, rng))
        assert certificate.covers(found).all()
        values = spm.determinants(found)[:, :2] / nominal.middle_side**3
        signs = np.sign(values[0]) if signs is None else signs
        assert (signs * values >= certificate.bounds).all()
        assert (found.slopes * machine.legs.slope_signs > 0.0).all()


def stage_balls(state: spm.Configuration, k: int) -> tuple[np.ndarray, np.ndarray]:
    """Return radii and heights (..., 3) of the balls in the nominal planes of the legs of the lower or upper stage."""
    balls = state.balls[..., 3 * k : 3 * k + 3, :]
    if k:
        balls = (balls - state.translation[..., None, :]) @ state.rotation * [1.0, 1.0, -1.0]
    return (balls * PAPER.radial_directions).sum(axis=-1), balls[..., 2]


@pytest.mark.parametrize(
    ("name", "length", "angle"),
    [
        *(("RPS-RPS", *errors) for errors in ((1e-4, 0.0), (0.0, 1e-4), (2e-2, 5e-2))),
        *((name, error, error) for name in ("RRS-PRS", "inner knees") for error in (1e-4, 2e-2)),
    ],
)
def test_enclosures_contain_what_machines_within_errors_have(name: str, length: float, angle: float) -> None:
    nominal, rng = MACHINES[name], np.random.default_rng(5)
    regions = stage_regions(nominal, nominal.limits, (length, angle))
    used: dict[str, float] = {}

    def contained(part: str, interval: Interval, exact: np.ndarray) -> None:
        assert ((interval.low - 1e-14 <= exact) & (exact <= interval.high + 1e-14)).all(), part
        middle, half = 0.5 * (interval.high + interval.low), 0.5 * (interval.high - interval.low)
        with np.errstate(invalid="ignore"):
            used[part] = max(used.get(part, 0.0), float(np.nanmax(np.abs(exact - middle) / half)))

    for _ in range(40):
        machine = machine_within(nominal, length, angle, rng)
        found = spm.forward_physical(machine, readings_within(nominal.limits, 20, rng))
        found = found[found.exists]
        radii, determinants = np.linalg.norm(found.leg_vectors, axis=-1), np.abs(spm.determinants(found))
        turns = found.middle_pose.rotation, found.pose.rotation.inv() * found.middle_pose.rotation
        for k, region in enumerate(regions):
            part = slice(3 * k, 3 * k + 3)
            unknowns = [Interval.from_numbers(x) for x in region_coordinates(found)[:, k].T]
            values = region.evaluate(*unknowns)
            assert not values.is_beyond.any()
            own = (found.readings - machine.legs.offsets)[:, part]
            own_slopes = (found.slopes * machine.legs.slope_signs)[:, part].min(axis=-1)
            assert (values.slope <= own_slopes + 1e-14).all()
            for i in range(3):
                contained("reading", values.readings[i], own[:, i])
                contained("square", values.squares[i], radii[:, part][:, i] ** 2)
                for name, interval, exact in zip(
                    ("radius", "height"), region.corners(*unknowns), stage_balls(found, k), strict=True
                ):
                    contained(name, interval[i], exact[:, i])
            contained("determinant", values.determinant, determinants[:, k] * radii[:, part].prod(axis=-1))
            quaternion = turns[k].as_quat()
            contained("torsion", Interval.within(region.error_bounds.torsion), quaternion[:, 2] * quaternion[:, 3])
    # The bounds are not far from what some machines have: a forgotten error would exceed them.
    least = {"reading": 0.15, "square": 0.05, "radius": 0.2, "torsion": 0.3, "determinant": 0.01}
    least["height"] = 0.2 if length else 0.0
    assert all(used[part] > share for part, share in least.items()), used


def test_boxes_contain_what_their_states_have() -> None:
    nominal, rng = MACHINES["RRS-PRS"], np.random.default_rng(6)
    found = spm.forward_physical(nominal, readings_within(nominal.limits, 200, rng))
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


def test_boxes_in_which_a_leg_may_be_singular_are_not_proved_whatever_their_determinant_is() -> None:
    stage = Stage(0.30, 0.25, RRS(crank=0.15, rod=0.35))
    (region,) = stage_regions(stage, stage.check_limits((-1.0, 2.5)))
    scale, boxes = stage_proof.edges(region), stage_proof.first_boxes(1)
    for _ in range(4):
        boxes = stage_proof.examine(region, scale, stage_proof.halves(boxes))
    values = region.evaluate(*stage_proof.columns(stage_proof._ends(scale, boxes)))
    singular = values.slope <= 0.0
    assert (singular & (values.determinant.low > 0.0)).any()
    assert (boxes["bound"][singular] == 0.0).all()


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


def test_intervals_of_angles_contain_the_values_of_forty_digits() -> None:
    rng = np.random.default_rng(0)
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
