"""Stages identified from poses, or from what an IMU and a ruler show; and what of a pose these see."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from balancers import HEIGHTS, MACHINES, STAGES, existing_states, stage_and_height
from calibration.measured import PAPER, elsewhere
from error_fields import with_fields
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin import calibration
from spm_pin.calibration import Inclinations, MeasurementError, error_jacobian, identify
from spm_pin.calibration.error_model import gauge_directions, parameter_scale
from spm_pin.calibration.frames import FRAME_PARAMETERS, Frames
from spm_pin.calibration.observables import OBSERVABLES, Observable

SEEN = OBSERVABLES | {
    "tilts": Observable(("turn_x", "turn_y"), is_levelled=True),
    "heights": Observable(("z",), is_levelled=True),
}
FRAMES = Frames(
    RigidTransform.from_components([3, 1, 0.5], Rotation.from_rotvec([0.1, 0.4, 2.0])).as_matrix(),
    RigidTransform.from_components([0.1, 0.05, 0.2], Rotation.from_rotvec([1, 2, 3])).as_matrix(),
)
LIMITED = {
    "RPS": spm.Stage(0.7, 0.46, limits=(0.95, 1.25)),
    "PRS": spm.Stage(0.35, 0.2, spm.PRS(rod=0.4), limits=(-0.05, 0.12)),
    "RRS": spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.5, 1.1)),
    "RRS turned": spm.Stage(
        0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.5, 1.1), azimuths=np.radians([0, 120, 240])
    ),
}
KINDS = pytest.mark.parametrize("kind", ["RPS", "PRS", "RRS"])
SERVOS, SCREWS = (
    spm.Stage(0.30, 0.25, spm.RRS(crank=0.15, rod=0.35), limits=(0.1, 0.9)),
    spm.Stage(0.22, 0.25, spm.PRS(rod=0.30, direction=1.4), limits=(0.00, 0.12)),
)
ROBOTS = {"robot": PAPER, "robot of servos and screws": spm.Manipulator.of_stages(SERVOS, SCREWS)}


def imu_and_ruler(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Roll, pitch and height of poses (N, 4, 4): the first two of the angles roll, pitch, yaw about fixed axes."""
    roll, pitch, _ = Rotation.from_matrix(poses[:, :3, :3]).as_euler("xyz").T
    return roll, pitch, poses[:, 2, 3]


def true_and_plan(kind: str, count: int = 60) -> tuple[spm.Stage, spm.Stage, np.ndarray, np.ndarray]:
    """A nominal stage, one with errors, and readings and poses of both of its states."""
    nominal = LIMITED[kind]
    true = nominal.perturbed(4, length=1e-3 * nominal.platform_radius, angle=1e-3)
    rng = np.random.default_rng(2)
    states = spm.forward_physical(true, rng.uniform(*nominal.limits.ends, (count, 3)))
    states = states[states.exists]
    assert len(states) > 0.8 * count
    return nominal, true, states.readings, states.pose.as_matrix()


def machine_and_states(name: str, count: int) -> tuple[Any, Any]:
    if name in MACHINES:
        stage, height = stage_and_height(name)
        return stage, existing_states(stage, height, count)
    robot = ROBOTS[name].perturbed(3, length=2e-3, angle=1e-2)
    states = spm.forward_physical(robot, np.random.default_rng(1).uniform(*ROBOTS[name].limits.ends, (count, 6)))
    return robot, states[states.exists]


@pytest.mark.parametrize("machine", [*MACHINES, *ROBOTS])
def test_errors_of_all_parameters_move_the_platform_as_its_displacement_says(machine: str) -> None:
    stage, states = machine_and_states(machine, 12)
    if machine in MACHINES:
        states = states[spm.singularities(states).forward > 0.1]
    assert len(states) > 5
    jacobian = error_jacobian(states)
    assert jacobian.shape == (len(states), 6, len(stage.parameter_names))
    side = np.repeat([stage.ball_side, 1.0], 3)
    for k, unit in enumerate(1e-6 * parameter_scale(stage)):
        step = np.where(np.arange(jacobian.shape[-1]) == k, unit, 0.0)
        first, last = (
            spm.forward_physical(other, states.readings, near=_state_of(other, states))
            for other in (stage.from_parameters(stage.parameters + s * step) for s in (1, -1))
        )
        turn = Rotation.from_matrix(first.rotation @ last.rotation.mT).as_rotvec()
        moved = np.concatenate([first.translation - last.translation, turn], axis=-1) / side
        exact = 2.0 * unit * jacobian[..., k] / side
        np.testing.assert_allclose(moved, exact, atol=1e-7 * np.abs(exact).max() + 1e-14)


def _state_of(stage: Any, near: Any) -> Any:
    """States of another stage with the tilts and heights of `near`, in the same mode; none of a robot."""
    if isinstance(stage, spm.Manipulator):
        return None
    solutions = spm.inverse_displacement(stage, near.height, normal=near.normal)
    return solutions.configurations[:, 0]


@pytest.mark.parametrize("frames", [False, True])
@pytest.mark.parametrize("machine", [*MACHINES, *ROBOTS])
def test_what_no_measurement_shows_is_known(machine: str, frames: bool) -> None:
    """The null space of the derivative is spanned by the gauge directions, no more, whatever is measured."""
    is_robot = machine in ROBOTS
    stage, states = machine_and_states(machine, 90 if is_robot else 60)
    seen_from, own = FRAMES if frames else Frames.as_defined(), len(stage.parameters)
    scale = np.concatenate([parameter_scale(stage), np.tile(np.repeat([stage.ball_side, 1.0], 3), 2)])
    poses = seen_from.seen(states)
    slides = 3 * sum(kind.name == "PRS" for kind in stage.legs.kinds)
    scales = sum(kind.unit == "rad" for kind in stage.legs.kinds)
    # Turns and shifts of {B} that an IMU or a ruler does not see, and of {n} if it is not held.
    hidden = {"poses": 0, "positions": 3, "inclinations": 3, "tilts": 7 + scales, "heights": 6}
    for name, observable in SEEN.items():
        matrix = observable.slopes(poses, poses, seen_from.jacobian(states)) * scale
        matrix[:, : observable.lengths] /= stage.ball_side
        used = np.concatenate([np.full(own, True), observable.frames & frames])
        matrix = matrix.reshape(-1, len(scale))[:, used]
        values = np.zeros(matrix.shape[1])
        found = np.linalg.svd(matrix, compute_uv=False)
        values[: len(found)] = found
        count = (12 + (name == "tilts") * scales if frames else hidden[name]) + slides
        # {n}; and if only tilts are seen, by how much the upper balls are beside the lower ones.
        count += (6 + 3 * (name == "tilts")) * is_robot
        assert values[-count - 1] > 1e-7 * values[0], name
        assert values[len(values) - count :].max(initial=0.0) < 1e-13 * values[0], name
        if frames:
            directions = gauge_directions(stage, seen_from.base, seen_from.target, has_lengths=observable.lengths > 0)
            shown = (directions / scale[:, None])[used]
            assert np.linalg.matrix_rank(shown, tol=1e-9) == count
            np.testing.assert_allclose(matrix @ shown, 0.0, atol=1e-13 * values[0])


@pytest.mark.parametrize("name", SEEN)
def test_components_and_frames_have_the_derivatives_that_differences_have(name: str) -> None:
    observable, states = SEEN[name], existing_states(STAGES["RRS"].perturbed(1), HEIGHTS["RRS"], 5)
    slopes = observable.slopes(FRAMES.seen(states), FRAMES.seen(states[::-1]), FRAMES.jacobian(states))
    measured = FRAMES.seen(states[::-1]) if observable.is_levelled else FRAMES.seen(states)
    for k, _ in enumerate(FRAME_PARAMETERS):
        step = 1e-6 * np.eye(12)[k]
        ends = [observable.errors(FRAMES.changed(s * step).seen(states), measured) for s in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / 2e-6, slopes[..., k - 12], atol=1e-8)


@pytest.mark.parametrize(
    ("kind", "measured"),
    [
        *((kind, seen) for kind in ("RPS", "PRS", "RRS turned") for seen in ("inclinations", "tilts")),
        *(("RRS", seen) for seen in ("poses", "positions", "with gaps", "heights")),
    ],
)
def test_a_stage_is_identified_from_what_is_measured(kind: str, measured: str) -> None:
    nominal, true, readings, poses = true_and_plan(kind)
    roll, pitch, height = imu_and_ruler(poses)
    given: Any = poses[:, :3, 3] if measured == "positions" else poses
    if measured == "with gaps":
        roll[::4], pitch[::4], height[1::3] = np.nan, np.nan, np.nan
        seen = np.isfinite(roll) | np.isfinite(height)
        roll, pitch, height, readings = roll[seen], pitch[seen], height[seen], readings[seen]
    if measured in ("inclinations", "with gaps"):
        given = Inclinations(roll, pitch, height)
    elif measured in ("tilts", "heights"):
        given = Inclinations(roll, pitch) if measured == "tilts" else Inclinations(height=height)
    found = identify(nominal, given, readings, pose_noise=(1e-7, 1e-7), reading_noise=1e-9)
    assert found.status == "fits", found.reason
    slides = 3 * (kind == "PRS")
    hidden = {"poses": 0, "positions": 3, "tilts": 7 + kind.startswith("RRS"), "heights": 6}.get(measured, 3) + slides
    assert len(found.unidentifiable) == hidden
    assert len(found.unidentifiable) + len(found.deviations) == len(nominal.parameter_names)
    other = np.random.default_rng(5).uniform(*nominal.limits.ends, (60, 3))
    before, after, exact = (spm.forward_physical(x, other) for x in (nominal, found.machine, true))
    known = exact.exists & before.exists
    errors = [np.abs(np.stack(imu_and_ruler(x.pose.as_matrix()[known])) - imu_and_ruler(exact.pose.as_matrix()[known]))
              for x in (before, after)]  # fmt: skip
    part = {"tilts": slice(2), "heights": slice(2, 3), "positions": slice(2, 3)}.get(measured, slice(3))
    assert errors[0][part].max() > 1e-4
    assert errors[1][part].max() < 1e-7
    if measured == "poses":
        np.testing.assert_allclose(after.pose.as_matrix()[known], exact.pose.as_matrix()[known], atol=1e-8)


@KINDS
def test_the_base_s_tilt_and_the_imu_s_mounting_are_estimated_with_the_stage(kind: str) -> None:
    nominal, true, readings, poses = true_and_plan(kind)
    size = nominal.platform_radius
    base = RigidTransform.from_components([0, 0, 0.3 * size], Rotation.from_rotvec([0.03, -0.02, 0.0])).as_matrix()
    mounted = Rotation.from_euler("xyz", [0.05, -0.04, 1.7])
    target = RigidTransform.from_components([0.1 * size, -0.2 * size, 0.05 * size], mounted).as_matrix()
    shown = Inclinations(*imu_and_ruler(base @ poses @ target))
    noise: Any = {"pose_noise": (1e-7, 1e-7), "reading_noise": 1e-9}
    askew = Rotation.from_euler("xyz", [0.06, -0.05, 0.0]).as_matrix()
    turned = poses.copy()
    turned[:, :3, :3] = poses[:, :3, :3] @ askew
    wrong = identify(nominal, Inclinations(*imu_and_ruler(turned)), readings, parameters="ball", **noise)
    assert wrong.status != "fits"
    assert "The IMU turned on the platform" in wrong.reason
    found = identify(nominal, shown, readings, frames=True, **noise)
    assert found.status == "fits", found.reason
    assert len(found.unidentifiable) == 12 + 3 * (kind == "PRS")
    assert found.names[-9:] == ("base.z", "base.turn_x", "base.turn_y", *FRAME_PARAMETERS[6:])
    other = np.random.default_rng(5).uniform(*nominal.limits.ends, (60, 3))
    states, exact = (spm.forward_physical(x, other) for x in (found.machine, true))
    known = exact.exists & states.exists
    predicted = found.base.as_matrix() @ states.pose.as_matrix()[known] @ found.target.as_matrix()
    np.testing.assert_allclose(
        imu_and_ruler(predicted), imu_and_ruler(base @ exact.pose.as_matrix()[known] @ target), atol=1e-7
    )


@pytest.mark.parametrize("seed", range(2))
def test_a_balancer_is_predicted_as_well_as_its_covariance_says(seed: int) -> None:
    """Servos set badly, measured by an IMU and a ruler of a hobby."""
    nominal, rng = LIMITED["RRS"], np.random.default_rng(seed)
    known = ["offset", "crank", "rod"]
    wanted = np.array([name.partition(".")[2] in known for name in nominal.parameter_names])
    errors = np.array([0.03 if unit == "rad" else 3e-4 for unit in nominal.parameter_units]) * wanted
    true = nominal.from_parameters(nominal.parameters + errors * rng.standard_normal(len(errors)))
    plan = calibration.choose_poses(
        nominal, 40, parameters=known, measured="inclinations", pose_noise=(5e-4, 2e-3), reading_noise=1e-3, rng=rng
    )
    states = spm.forward_physical(true, plan.readings)
    states = states[states.exists]
    noise = np.array([2e-3, 2e-3, 5e-4])[:, None] * rng.standard_normal((3, len(states)))
    shown = Inclinations(*(imu_and_ruler(states.pose.as_matrix()) + noise))
    readings = states.readings + 1e-3 * rng.standard_normal((len(states), 3))
    found = identify(nominal, shown, readings, parameters=known, reading_noise=1e-3)
    assert 0.4 < found.chi_square < 1.7
    difference = (found.machine.parameters - true.parameters)[wanted]
    own = found.covariance[np.ix_(wanted, wanted)]
    assert difference @ np.linalg.solve(own, difference) < 28.0  # 99.9 % of χ² with nine freedoms
    places = spm.inverse_physical(true, 0.12, tilt=0.15, azimuth=np.linspace(0.0, 6.0, 20))
    predicted = spm.forward_physical(found.machine, places.readings)
    turn = Rotation.from_matrix(predicted.rotation @ places.rotation.mT).as_rotvec()
    spread = np.sqrt(np.diagonal(found.accuracy(places), axis1=-2, axis2=-1))
    ratio = np.concatenate([turn / spread[:, 3:], (predicted.translation - places.translation) / spread[:, :3]])
    assert 0.2 < np.sqrt((ratio**2).mean()) < 2.0
    assert np.degrees(np.linalg.norm(turn[:, :2], axis=-1)).max() < 0.25


def test_rows_with_gaps_count_what_was_measured() -> None:
    """χ² and outliers are as of the measurements alone; a gap adds nothing."""
    nominal, _, readings, poses = true_and_plan("RRS", 100)
    rng = np.random.default_rng(1)
    roll, pitch, height = imu_and_ruler(poses) + np.array([1e-4, 1e-4, 1e-5])[:, None] * rng.standard_normal(
        (3, len(poses))
    )
    height[::2] = np.nan
    noise: Any = {"pose_noise": (1e-5, 1e-4), "reading_noise": 1e-8}
    found = identify(nominal, Inclinations(roll, pitch, height), readings, **noise)
    assert 0.7 < found.chi_square < 1.35
    assert not found.outliers.any()
    assert np.isnan(found.residuals[::2, 0]).all()
    assert np.isfinite(found.residuals[1::2]).all()
    count = np.isfinite(found.residuals).sum() - len(found.deviations)
    measured = np.where(np.isfinite(found.residuals), found.residuals / [1e-5, 1e-4, 1e-4], 0.0)
    assert found.chi_square == pytest.approx((measured**2).sum() / count, rel=1e-3)
    roll[6] += 0.05
    again = identify(nominal, Inclinations(roll, pitch, height), readings, **noise)
    assert again.status == "outliers"
    assert np.flatnonzero(again.outliers).tolist() == [6]


@pytest.mark.parametrize(
    ("change", "argument", "words"),
    [
        (lambda r, p, h, x: (p, r, h, x), "poses", "pitch, roll"),
        (lambda r, p, h, x: (r, -p, h, x), "poses", "roll, -pitch"),
        (lambda r, p, h, x: (r, p, h, x[:, [1, 2, 0]]), "readings", "r_1 holds r_2, r_2 holds r_3"),
        (lambda r, p, h, x: (np.roll(r, 2), np.roll(p, 2), np.roll(h, 2), x), "poses", "shifted by -2 rows"),
        (lambda r, p, h, x: (r, p, 1e3 * h, x), "poses", "mm"),
        (lambda r, p, h, x: (np.degrees(r), np.degrees(p), h, x), "roll", "degrees"),
        (lambda r, p, h, x: (r, p, h, np.degrees(x)), "readings", "degrees"),
        (lambda r, p, h, x: (r[:3], p[:3], h[:3], x[:3]), "poses", "at least 10 measurements for 30 unknowns"),
        (lambda r, p, h, x: (r, p, h, x[:, [0, 1, 2, 0, 1, 2]]), "readings", "(..., 3)"),
    ],
)
def test_mistakes_are_named(change: Any, argument: str, words: str) -> None:
    nominal, _, readings, poses = true_and_plan("RRS")
    roll, pitch, height, changed = change(*imu_and_ruler(poses), readings)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)) as raised:
        identify(nominal, Inclinations(roll, pitch, height), changed)
    assert words in str(raised.value)


@pytest.mark.parametrize(
    ("fields", "argument"),
    [
        ({}, "roll"),
        ({"roll": [0.1]}, "pitch"),
        ({"pitch": [0.1]}, "roll"),
        ({"roll": [0.1], "pitch": [0.1, 0.2]}, "pitch"),
        ({"roll": [0.1], "pitch": [np.nan]}, "pitch"),
        ({"roll": [np.nan], "pitch": [np.nan]}, "height"),
        ({"height": 0.1}, "height"),
        ({"height": [np.inf]}, "height"),
        ({"roll": [10.0], "pitch": [5.0]}, "roll"),
        ({"roll": [1.0], "pitch": [1.6]}, "pitch"),
    ],
)
def test_what_are_no_inclinations_is_refused(fields: dict[str, Any], argument: str) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
        Inclinations(**fields)


def test_another_nominal_stage_is_named() -> None:
    nominal = LIMITED["RRS"]
    other = spm.Stage(0.08, 0.095, nominal.kind, nominal.limits)
    states = spm.forward_physical(other, true_and_plan("RRS")[2])
    states = states[states.exists]
    found = identify(nominal, states.pose, states.readings, parameters=["ball", "offset"])
    assert found.status == "another nominal"
    assert "platform_radius is 95 mm instead of 90 mm" in found.reason


@KINDS
def test_tolerances_of_a_stage_are_those_of_random_ones(kind: str) -> None:
    own = {"RPS": [], "PRS": ["rod"], "RRS": ["crank", "rod"]}[kind]
    table = dict.fromkeys(("direction", "pivot", "ball", "offset", *own), 1e-4)
    found = calibration.tolerance(LIMITED[kind], table, samples=300, rng=0)
    assert found.sampled_rms == pytest.approx(found.rms, rel=0.1)
    assert found.samples.shape == (300, 60, 6)
    assert {name for name, share in found.ranking("kind") if share} == {*table}
    with pytest.raises(spm.ArgumentError, match="states of this machine"):
        calibration.tolerance(LIMITED[kind], table, elsewhere())


@pytest.mark.parametrize(("kind", "frames"), [("RPS", False), ("PRS", True), ("RRS", False)])
def test_chosen_poses_of_a_stage_determine_more_than_random_ones(kind: str, frames: bool) -> None:
    nominal, _, _, _ = true_and_plan(kind)
    options: Any = {"measured": "inclinations", "frames": frames, "rng": 3}
    chosen = calibration.choose_poses(nominal, 20, candidates=200, **options)
    random = calibration.choose_poses(nominal, 20, candidates=20, **options)
    volumes = []
    for states in (chosen, random):
        shown = Inclinations(*imu_and_ruler(states.pose.as_matrix()))
        found = identify(nominal, shown, states.readings, frames=frames, pose_noise=(1e-6, 1e-6))
        volumes.append(np.log(found.deviations).sum())
    assert volumes[0] < volumes[1] - 1.0


def test_measurements_of_a_stage_are_read_with_gaps(tmp_path: Any) -> None:
    path = tmp_path / "seen.csv"
    path.write_text("r_2,roll,height,pitch,r_1,r_3,note\n2,0.1,,0.2,1,3,5\n5,,0.5,,4,6,7\n", encoding="utf-8")
    with pytest.warns(UserWarning, match="note"):
        shown, readings = calibration.read_measurements(path)
    np.testing.assert_array_equal(readings, [[1, 2, 3], [4, 5, 6]])
    np.testing.assert_array_equal(shown.roll, [0.1, np.nan])
    np.testing.assert_array_equal(shown.pitch, [0.2, np.nan])
    np.testing.assert_array_equal(shown.height, [np.nan, 0.5])
    for text, argument, line in (
        ("roll,pitch,r_1,r_2,r_3\n0.1,x,1,2,3\n", "pitch", 2),
        ("roll,pitch,r_1,r_2,r_3\n,,1,2,3\n", "height", 0),
        ("roll,r_1,r_2,r_3\n0.1,1,2,3\n", "pitch", 0),
        ("roll,pitch,r_1,r_2,r_3\n0.1,0.2,,2,3\n", "r_1", 2),
        ("roll,pitch,r_1,r_2\n0.1,0.2,1,2\n", "", 1),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(MeasurementError) as raised:
            calibration.read_measurements(path)
        assert raised.value.argument.removeprefix("column ") == argument
        assert (raised.value.file, raised.value.line) == (str(path), line)
