"""Machines identified from synthetic measurements, and mistakes in measurements named."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from calibration.measured import PAPER, elsewhere, measure, plan, position_errors
from error_fields import with_fields
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

import spm_pin as spm
from spm_pin import calibration
from spm_pin.calibration import MeasurementError, identify
from spm_pin.machine import PARAMETERS
from spm_pin.support.motion_table import table_text


@pytest.mark.parametrize("positions_only", [False, True])
def test_the_platform_is_placed_to_micrometres_afterwards(positions_only: bool) -> None:
    before, after = [], []
    for seed in range(2):
        machine = PAPER.perturbed(seed)
        poses, readings = measure(machine, seed)
        found = identify(PAPER, poses[:, :3, 3] if positions_only else poses, readings)
        before.append(position_errors(PAPER, machine))
        after.append(position_errors(found.machine, machine))
        assert not found.outliers.any()
        assert len(found.deviations) == (45 if positions_only else 48)
        assert len(found.unidentifiable) == (9 if positions_only else 6)
        # As predicted from the covariance, all over the workspace.
        variance = np.trace(found.accuracy(elsewhere())[:, :3, :3], axis1=-2, axis2=-1)
        assert 0.4 < np.sqrt((after[-1] ** 2).mean() / variance.mean()) < 2.0
    assert 5e-4 < np.sqrt((np.array(before) ** 2).mean()) < 1.3e-3
    assert np.array(after).max() < 5e-5


def test_parameters_not_asked_for_keep_their_values() -> None:
    nominal = PAPER.parameters
    wanted = np.array([name.split(".")[1] == "offset" or "pivot_z" in name for name in PARAMETERS])
    errors = np.where(wanted, 2e-4 * np.random.default_rng(3).standard_normal(54), 0.0)
    machine = PAPER.from_parameters(nominal + errors)
    found = identify(PAPER, *measure(machine, 1), parameters=["offset", "pivot_z"])
    changed = found.machine.parameters - nominal
    np.testing.assert_array_equal(changed[~wanted], 0.0)
    deviations = np.sqrt(np.diagonal(found.covariance))
    assert (deviations[~wanted] == 0.0).all()
    assert (np.abs(changed - errors)[wanted] < 5.0 * deviations[wanted]).all()
    assert len(found.deviations) == 12
    # A machine known before is the start, and what is not asked for stays as it was.
    again = identify(machine, *measure(machine, 2), parameters="r_b1")
    same = np.array([not name.startswith("r_b1") for name in PARAMETERS])
    np.testing.assert_allclose(again.machine.parameters[same], machine.parameters[same], atol=1e-15)


@pytest.mark.slow
def test_weights_are_those_of_the_noise() -> None:
    machine = PAPER.perturbed(2)
    poses, readings = measure(machine, 3)
    pair = identify(PAPER, poses, readings, pose_noise=(1e-5, 1e-5), reading_noise=1e-6)
    pose = np.broadcast_to(1e-10 * np.eye(6), (40, 6, 6))
    full = identify(PAPER, poses, readings, pose_noise=pose, reading_noise=1e-12 * np.eye(6))
    assert position_errors(full.machine, pair.machine).max() < 1e-9
    twice = identify(PAPER, poses, readings, pose_noise=(2e-5, 2e-5), reading_noise=2e-6)
    np.testing.assert_allclose(twice.deviations, 2.0 * pair.deviations, rtol=1e-3)
    np.testing.assert_allclose(twice.misfit, 0.5 * pair.misfit, rtol=1e-2)


@pytest.mark.slow
def test_the_covariance_covers_the_errors_as_often_as_it_says() -> None:
    """60 machines and noises: errors of predicted positions, in units of their covariance, are distributed as χ²."""
    squares, inside = [], []
    states = elsewhere()[:5]
    for seed in range(60):
        machine = PAPER.perturbed(seed)
        found = identify(PAPER, *measure(machine, 1000 + seed))
        legs = states.leg_lengths
        true, predicted = (spm.forward_physical(m, legs) for m in (machine, found.machine))
        gap = predicted.translation - true.translation
        covariance = found.accuracy(predicted)[:, :3, :3]
        squares.append((gap[0] * np.linalg.solve(covariance[0], gap[0])).sum())
        deviation = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        inside.append(np.abs(gap) < 1.96 * deviation)
    # Binomial with correlated entries of a repetition: four standard deviations of 60 independent ones.
    assert abs(np.mean(inside) - 0.95) < 4.0 * np.sqrt(0.95 * 0.05 / 60)
    assert kstest(squares, chi2(3).cdf).pvalue > 1e-3


Change = Callable[[Any, Any], tuple[Any, Any]]


def with_reading(row: int, leg: int, change: Callable[[float], float]) -> Change:
    """Return a change of measurements that alters one reading."""

    def changed(poses: Any, readings: Any) -> tuple[Any, Any]:
        wrong = readings.copy()
        wrong[row, leg] = change(wrong[row, leg])
        return poses, wrong

    return changed


def altered(poses: Any, rotation: Any = None, position: Any = None) -> Any:
    """Return poses (N, 4, 4) with other rotations or positions, functions of their own ones."""
    wrong = poses.copy()
    if rotation is not None:
        wrong[:, :3, :3] = rotation(poses[:, :3, :3])
    if position is not None:
        wrong[:, :3, 3] = position(poses[:, :3, 3])
    return wrong


def scalar_first(rotation: Any) -> Any:
    return Rotation.from_quat(Rotation.from_matrix(rotation).as_quat()[:, [3, 0, 1, 2]]).as_matrix()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda poses, readings: (poses, 100.0 * readings), r"readings: expected lengths in metres.*cm\?"),
        (lambda p, r: (altered(p, position=lambda o: 1000.0 * o), r), r"poses: expected lengths in metres.*mm\?"),
        (lambda p, r: (p, r[:, [0, 4, 2, 3, 1, 5]]), r"readings.*r_b2 holds r_c2, r_c2 holds r_b2.*instead of"),
        (
            lambda p, r: (altered(p, rotation=lambda turn: np.swapaxes(turn, -1, -2)), r),
            "poses: expected rotations from {m} to {B}.*Transposed they agree to",
        ),
        (
            lambda p, r: (altered(p, scalar_first), r),
            "poses.*quaternions whose scalar is first. Scalar last they agree to",
        ),
        (lambda p, r: (altered(p, position=lambda o: o * [1, -1, 1]), r), "poses.*other axes. As x, -y, z they agree"),
        (lambda p, r: (p[:, :3, 3] * [1, 1, 1000], r), r"poses: expected lengths in metres.*for z.*mm\?"),
        (lambda p, r: (p, np.roll(r, 1, axis=0)), "poses.*order of the readings, got readings shifted by 1 rows"),
        (with_reading(5, 3, lambda _: 0.13), r"readings.*row 5 with.*0\.13.*mistyped"),
        (with_reading(5, 3, lambda _: np.nan), r"readings: expected finite.*index \(5, 3\)"),
        (lambda poses, readings: (poses[:7], readings[:7]), "poses: expected at least 8 measurements for 48.*got 7"),
        (lambda p, r: (p[:14, :3, 3], r[:14]), "poses: expected at least 15 measurements for 45.*got 14"),
        (
            lambda p, r: (np.repeat(p[:1], 30, 0), np.repeat(r[:1], 30, 0)),
            "poses that determine 48.*30 poses.*choose_poses",
        ),
        (lambda poses, readings: (poses, readings[:5]), "readings: expected one row.*shape"),
        (lambda poses, readings: (poses[0], readings[0]), "readings: expected one row"),
        (lambda poses, readings: (np.zeros((4, 4)), readings), "pose"),
        (lambda poses, readings: (poses, -readings), "readings.*exceed the offsets.*row 0"),
    ],
)
def test_wrong_measurements_are_named_and_not_fitted(change: Callable[..., Any], message: str) -> None:
    with pytest.raises(spm.ArgumentError, match=message):
        identify(PAPER, *change(*measure(PAPER.perturbed(4), 5)))


@pytest.mark.parametrize(
    ("shift", "loss"),
    [(0.01, "linear"), (-0.02, "soft_l1"), pytest.param(0.02, "cauchy", marks=pytest.mark.slow)],
)
def test_encoders_that_all_begin_elsewhere_are_identified(shift: float, loss: str) -> None:
    """A thousand times the noise: a robust loss alone ends far from the machine, with good rows for outliers."""
    machine = PAPER.perturbed(1)
    poses, readings = measure(machine, 0, noise=0.0)
    found = identify(PAPER, poses, readings + shift, loss=loss)
    assert (found.status, found.outliers.any()) == ("fits", False)
    legs = elsewhere().leg_lengths
    places = [spm.forward_physical(m, lengths) for m, lengths in ((machine, legs), (found.machine, legs + shift))]
    np.testing.assert_allclose(places[0].translation, places[1].translation, atol=1e-9)


@pytest.mark.parametrize(
    ("change", "row", "loss"),
    [
        (with_reading(17, 2, lambda length: length + 1e-3), 17, "linear"),
        (with_reading(5, 2, lambda length: length + 0.3), 5, "soft_l1"),
        (with_reading(5, 0, lambda length: length - 0.3), 5, "linear"),
        pytest.param(with_reading(39, 3, lambda length: length + 0.3), 39, "cauchy", marks=pytest.mark.slow),
        pytest.param(
            lambda p, r: with_reading(5, 2, lambda x: x + 0.3)(p, r + 0.01), 5, "linear", marks=pytest.mark.slow
        ),
    ],
)
def test_a_wrong_row_alone_is_named(change: Callable[..., Any], row: int, loss: str) -> None:
    machine = PAPER.perturbed(4)
    poses, readings = change(*measure(machine, 5))
    found = identify(PAPER, poses, readings, loss=loss)
    assert np.flatnonzero(found.outliers).tolist() == [row]
    assert found.misfit[row] > 10.0
    assert found.chi_square < 2.0
    if loss == "linear":
        assert found.status == "outliers"
        for use in (lambda: found.machine, lambda: found.accuracy(plan())):
            with pytest.raises(MeasurementError, match=rf"outlier in row {row}\. Look at this row, leave it out"):
                use()
    legs, shift = elsewhere().leg_lengths, float(np.median(readings - measure(machine, 5)[1]))
    places = [spm.forward_physical(m, lengths) for m, lengths in ((machine, legs), (found.fitted, legs + shift))]
    assert np.linalg.norm(places[0].translation - places[1].translation, axis=-1).max() < 5e-5


@pytest.mark.parametrize(("error", "status"), [(3e-3, "misfit"), (0.1, "not converged")])
def test_too_few_rows_to_find_the_wrong_one_are_no_fit(error: float, status: str) -> None:
    poses, readings = measure(PAPER.perturbed(1), 0, states=plan()[:9])
    readings[5, 2] += error
    found = identify(PAPER, poses, readings)
    assert found.status == status
    assert found.reason.startswith("too few rows to find the wrong ones: without row")


def test_measurements_that_fit_no_machine_are_not_used() -> None:
    """Beyond a reduced χ² of 9; noise two and a half times the given is still within."""
    machine = PAPER.perturbed(1)
    within = identify(PAPER, *measure(machine, 0, noise=2.5))
    assert within.status == "fits"
    assert 4.0 < within.chi_square < 9.0
    poses, readings = measure(machine, 0)
    mixed = np.random.default_rng(0).permutation(40)
    for data, options, cause in (
        ((poses, readings), {"parameters": "offset"}, "errors that are not among the parameters"),
        (measure(machine, 0, noise=5.0), {}, "Larger noise than given"),
        ((poses[mixed], readings), {}, "poses and readings of different rows"),
    ):
        found = identify(PAPER, *data, **options)  # type: ignore[arg-type]
        assert found.status in ("misfit", "not converged")
        assert not found.chi_square < 9.0
        with pytest.raises(MeasurementError, match=f"times what the noise explains.*{cause}"):
            _ = found.machine


@pytest.mark.parametrize(
    ("factors", "size", "cause"),
    [
        ((1.05, 1.0, 1.0), 1e-4, "E is 692.7 mm instead of 727.5 mm"),
        ((1.0, 0.95, 1.0), 3e-3, "C is .* mm instead of 329.1 mm.*of the pivot of r_c"),
        ((1.0, 1.0, 1.05), 1e-3, "d is .* mm instead of 840 mm.*of the ball of r_"),
        pytest.param((1.0, 0.9, 1.0), 1e-2, "C is .* instead of 311.8 mm", marks=pytest.mark.slow),
        pytest.param((1.1, 1.1, 1.1), 1e-4, "[ECd] is .* mm instead of", marks=pytest.mark.slow),
    ],
)
def test_another_nominal_machine_is_fitted_and_refused(
    factors: tuple[float, float, float], size: float, cause: str
) -> None:
    machine = PAPER.perturbed(1, length=size * PAPER.middle_side, angle=size)
    found = identify(spm.Manipulator(*(np.array(PAPER.dimensions) * factors)), *measure(machine, 0))
    assert (found.status, found.chi_square < 2.0) == ("another nominal", True)
    assert position_errors(found.fitted, machine).max() < 5e-5
    with pytest.raises(MeasurementError, match=f"near the nominal one.*{cause}.*Another nominal machine"):
        _ = found.machine


@pytest.mark.parametrize(
    "seed", [2, pytest.param(10, marks=pytest.mark.slow), pytest.param(15, marks=pytest.mark.slow)]
)
def test_errors_of_one_percent_are_taken_for_manufacture(seed: int) -> None:
    machine = PAPER.perturbed(seed, length=0.01 * PAPER.middle_side, angle=0.01)
    assert position_errors(identify(PAPER, *measure(machine, seed)).machine, machine).max() < 5e-5


def test_few_candidates_are_chosen_from_as_by_trying_all() -> None:
    legs = np.random.default_rng(8).uniform(1.1, 1.5, (6, 6))
    states = spm.forward_physical(PAPER, legs)
    chosen = calibration.choose_poses(PAPER, 3, candidates=states, parameters="offset")

    def value(part: spm.Configuration) -> float:
        found = identify(PAPER, part.pose, part.leg_lengths, parameters="offset")
        return float(np.log(found.deviations).sum())

    best = min(value(states[list(part)]) for part in combinations(range(6), 3))
    assert value(chosen) <= best + 0.2
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="count")):
        calibration.choose_poses(PAPER, 5)
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="machine")):
        calibration.choose_poses(spm.Manipulator(0.7, 0.3, 0.8), 40)


HEADING = "x,y,z,qx,qy,qz,qw,r_b1,r_b2,r_b3,r_c1,r_c2,r_c3"
ROW = "0.1,0.2,2.2,0,0,0,1,1.2,1.3,1.4,1.2,1.3,1.4"


def test_a_file_of_measurements_is_read_in_any_order_of_columns(tmp_path: Path) -> None:
    poses, readings = measure(PAPER, 1)
    rotation = spm.machine.as_rigid_transform(poses).rotation
    values = np.concatenate([poses[:, :3, 3], rotation.as_quat(), readings], axis=1)
    columns = dict(sorted(zip(HEADING.split(","), values.T, strict=True)))
    file = tmp_path / "measured.csv"
    file.write_text("\ufeff" + table_text(columns).replace(",", ", ") + "\n", encoding="utf-8")
    found, lengths = calibration.read_measurements(file)
    np.testing.assert_array_equal(lengths, readings)
    np.testing.assert_allclose(found.as_matrix(), poses, atol=1e-15)
    file.write_text(table_text({name: x for name, x in columns.items() if name[0] != "q"}), encoding="utf-8")
    positions, lengths = calibration.read_measurements(file)
    np.testing.assert_array_equal(positions, poses[:, :3, 3])
    np.testing.assert_array_equal(lengths, readings)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a heading that names the columns"),
        (HEADING, "then rows of numbers, got 1 lines"),
        (f"{HEADING}\n{ROW}\n{ROW},9", r"csv:3: expected 13 values, .* got 14"),
        (f"{HEADING}\n{ROW}\n\n{ROW.replace('1.3', 'nan', 1)}", r"column r_b2 in .*csv:4: expected a finite number"),
        (f"{HEADING}\n{ROW.replace('2.2', '', 1)}", r"column z in .*csv:2.*got nothing"),
        (f"{HEADING}\n{ROW.replace('2.2', 'high', 1)}", r"column z in .*got 'high'"),
        (f"{HEADING}\n{ROW.replace('2.2', '2_2', 1)}", r"column z in .*got '2_2'"),
        (f"{HEADING}\n{ROW.replace('2.2', chr(34) + '2,2' + chr(34), 1)}", r"column z.*decimal comma"),
        (f"{HEADING}\n{ROW.replace('0,0,0,1', '0,0,0,2', 1)}", r"qx to qw in .*csv:2.*length 1, got length 2"),
        (f"{HEADING.replace('r_c3', 'r_c4')}\n{ROW}", r"csv:1: expected .*, got a heading without r_c3"),
        (f"{HEADING.replace('qw', 'w')}\n{ROW}", r"csv:1: expected .*, got a heading without qw"),
        (f"# {HEADING}\n{ROW}\n{ROW}", r"csv:2: .*The heading is a comment: remove its #"),
        (f"{HEADING.replace(',', ';')}\n{ROW.replace(',', ';')}", r"csv:1: .*Semicolons instead of commas\?"),
        (f"{HEADING}\n{ROW.replace('.', ',').replace('0,1', '0,1', 1)}", r"csv:2: expected 13 values"),
        (f"{HEADING},x\n{ROW},1", r"csv:1: expected a heading .*repeated x"),
    ],
)
def test_a_malformed_file_is_refused_with_line_and_column(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "measured.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(MeasurementError, match=message):
        calibration.read_measurements(file)
    with pytest.raises(MeasurementError, match="No such file"):
        calibration.read_measurements(tmp_path / "other.csv")


def test_named_columns_of_a_table_are_taken_by_their_names() -> None:
    pandas = pytest.importorskip("pandas")
    machine = PAPER.perturbed(1)
    poses, readings = measure(machine, 0)
    table = pandas.DataFrame(readings, columns=spm.machine.LEGS).assign(
        z=poses[:, 2, 3], y=poses[:, 1, 3], x=poses[:, 0, 3]
    )
    shuffled = table[sorted(table.columns, reverse=True)]
    np.testing.assert_array_equal(
        spm.forward_physical(PAPER, shuffled).readings, spm.forward_physical(PAPER, readings).readings
    )
    found = identify(PAPER, shuffled[["z", "x", "y"]], shuffled)
    assert position_errors(found.machine, machine).max() < 1e-4
    # Without names it is by place, and other names are refused.
    plain = pandas.DataFrame(readings)
    assert spm.forward_physical(PAPER, plain).shape == (40,)
    with pytest.raises(spm.ArgumentError, match=r"columns r_b1, r_b2.*got a table with l1, l2.*rename them"):
        spm.forward_physical(PAPER, plain.set_axis(["l1", "l2", "l3", "l4", "l5", "l6"], axis=1))
