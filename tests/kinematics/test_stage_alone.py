"""Displacements of a stage alone, of every kind of legs, drawn and as built."""

from __future__ import annotations

import dataclasses
import pickle
import warnings
from collections.abc import Callable
from pathlib import Path

import mpmath
import numpy as np
import pytest
from balancers import MACHINES, STAGES, existing_states, requests, stage_and_height
from modes_oracle import real_modes
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.machine import Configuration, Stage

BALANCER = STAGES["RRS"]


def test_a_level_balancer_has_the_readings_of_a_triangle() -> None:
    """Pivot (0, 0), ball (9, 12) cm; crank 9 cm, rod 12 cm: the knee is at a corner of the rectangle."""
    stage = Stage(0.03, 0.12, spm.RRS(crank=0.09, rod=0.12))
    state = spm.inverse_physical(stage, 0.12)
    np.testing.assert_allclose(state.readings, 0.0, atol=1e-14)
    np.testing.assert_allclose(state.translation, [0.0, 0.0, 0.12])
    inwards = spm.inverse_physical(Stage(0.03, 0.12, spm.RRS(crank=0.09, rod=0.12, sign=1)), 0.12)
    np.testing.assert_allclose(inwards.readings, 2.0 * np.arctan2(12.0, 9.0), atol=1e-14)


def test_a_tilt_an_azimuth_and_roll_and_pitch_mean_what_scipy_means() -> None:
    state = spm.inverse_physical(BALANCER, 0.12, roll=0.1, pitch=-0.15)
    np.testing.assert_allclose(state.pose.rotation.as_euler("xyz")[:2], [0.1, -0.15], atol=1e-15)
    np.testing.assert_allclose([state.roll, state.pitch], [0.1, -0.15], atol=1e-15)
    leaning = spm.inverse_physical(BALANCER, 0.12, tilt=0.2, azimuth=np.pi / 2)
    np.testing.assert_allclose([leaning.tilt, leaning.azimuth], [0.2, np.pi / 2])
    backward = spm.inverse_physical(BALANCER, 0.12, tilt=0.2, azimuth=-2.0)
    np.testing.assert_allclose([backward.tilt, backward.azimuth], [0.2, -2.0])
    assert spm.inverse_physical(BALANCER, 0.12, pitch=-0.1).azimuth == np.pi
    lowest = leaning.balls[:, 2].argmin()
    assert lowest == 1, "leg 2 stands at 90°, where the platform is lowest"
    assert leaning.readings[1] < leaning.readings[[0, 2]].min()
    same = spm.inverse_physical(BALANCER, 0.12, normal=leaning.normal)
    np.testing.assert_allclose(same.readings, leaning.readings, atol=1e-14)


def test_a_stage_as_drawn_shifts_as_the_literature_says() -> None:
    """By r (-2 x1 x2, x2² - x1²) of the quaternion, without torsion; mode F by the opposite, turned half round."""
    normals, heights = requests(1.1, 50)
    stage = STAGES["RPS"]
    t, f = (spm.inverse_displacement(stage, heights, normal=normals)[label] for label in "TF")
    x1, x2 = t.pose.rotation.as_quat()[:, :2].T
    shift = stage.platform_radius * np.stack([-2.0 * x1 * x2, x2**2 - x1**2], axis=-1)
    np.testing.assert_allclose(t.shift, shift, atol=1e-15)
    np.testing.assert_allclose(f.shift, -shift, atol=1e-15)
    np.testing.assert_allclose(t.torsion, 0.0, atol=1e-15)
    np.testing.assert_allclose(f.torsion, np.pi, atol=1e-15)


def fifty_digits(stage: Stage, normal: np.ndarray, height: float, state: Configuration) -> np.ndarray:
    """Return the balls that Newton's method of mpmath finds: a unit quaternion, x and y from planes and normal."""

    def place(q: list[mpmath.mpf], p: np.ndarray) -> mpmath.matrix:
        w, u, p = q[0], q[1:4], [mpmath.mpf(float(x)) for x in p]
        cross = lambda a, b: [a[k - 2] * b[k - 1] - a[k - 1] * b[k - 2] for k in range(3)]  # noqa: E731
        inner = cross(u, [a + w * b for a, b in zip(cross(u, p), p, strict=True)])
        return [a + 2 * b for a, b in zip(p, inner, strict=True)]

    def errors(*x: mpmath.mpf) -> list[mpmath.mpf]:
        n, t = place(x, np.array([0.0, 0.0, 1.0])), [*x[4:], mpmath.mpf(float(height))]
        planes = [
            mpmath.fdot(axis.tolist(), [a + b - c for a, b, c in zip(place(x, ball), t, pivot.tolist(), strict=True)])
            for axis, pivot, ball in zip(*stage.legs.arrays[:3], strict=True)
        ]
        return [*planes, n[0] - normal[0], n[1] - normal[1], mpmath.fdot(x[:4], x[:4]) - 1]

    quaternion = state.pose.rotation.as_quat(scalar_first=True)
    x = list(mpmath.findroot(errors, [*quaternion, *state.shift], tol=1e-40))
    balls = [[a + b for a, b in zip(place(x, p), [*x[4:], height], strict=True)] for p in stage.legs.balls]
    return np.array(balls, dtype=float)


@pytest.mark.parametrize("machine", MACHINES)
def test_the_inverse_is_what_another_method_finds_with_fifty_digits(machine: str) -> None:
    stage, height = stage_and_height(machine)
    normals, heights = requests(height, 3, seed=5)
    solutions = spm.inverse_displacement(stage, heights, normal=normals)
    assert solutions.count.sum() >= 2
    for k, m in np.argwhere(solutions.exists):
        state = solutions.configurations[k, m]
        with mpmath.workdps(50):
            expected = fifty_digits(stage, normals[k], heights[k], state)
        np.testing.assert_allclose(state.balls, expected, rtol=0, atol=1e-15)


@pytest.mark.parametrize("count", [500, pytest.param(50_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("machine", MACHINES)
def test_readings_lead_back_to_the_pose_and_sides_are_rigid(machine: str, count: int) -> None:
    """To rounding, which grows as the distance to a singularity shrinks."""
    stage, height = stage_and_height(machine)
    states = existing_states(stage, height, count)
    near = spm.singularities(states)
    distance = np.minimum(near.forward, near.leg.min(axis=-1))
    states, distance = states[distance > 1e-3], distance[distance > 1e-3]
    assert len(states) > 0.5 * count
    sides = states.balls - np.roll(states.balls, -1, axis=-2)
    own = stage.legs.balls - np.roll(stage.legs.balls, -1, axis=-2)
    error = np.linalg.norm(sides, axis=-1) - np.linalg.norm(own, axis=-1)
    np.testing.assert_allclose(error, 0.0, atol=1e-15)
    assert states.closure_residual.max() < 1e-15
    assert states.is_at_home.all()
    again = spm.forward_physical(stage, states.readings)
    assert again.exists.all()
    error = np.abs(again.balls - states.balls).max(axis=(-1, -2)) / stage.size
    assert (error * distance).max() < 1e-14
    led = spm.forward_physical(stage, states.readings[1:100], near=states[:99])
    np.testing.assert_allclose(led.translation[led.exists], states.translation[1:100][led.exists], atol=1e-11)
    assert led.exists.mean() > 0.95


HARD: list[tuple[Stage, list[float], list[float]]] = [
    (Stage(1.0, 1.24, spm.RRS(crank=0.71, rod=0.72)), [0.5, 0.79, 2.9], []),
    (Stage(1.0, 1.46, spm.RRS(crank=0.61, rod=0.71)), [0.3, 0.57, 0.8], []),
    (Stage(1.0, 1.175, spm.PRS(rod=0.874, direction=np.pi / 2 + 0.3, sign=1)), [1.711, 0.51, -1.403], []),
    (Stage(1.0, 1.14, spm.RRS(crank=1.72, rod=1.16)), [], [2.341, 3.011, -0.557]),
]


@pytest.mark.parametrize(("stage", "pose", "readings"), HARD)
def test_states_to_which_newton_s_method_does_not_lead_are_found(
    stage: Stage, pose: list[float], readings: list[float]
) -> None:
    """From the level stage it wanders, or into another working mode, though the home's aspect has such a state."""
    if pose:
        height, tilt, azimuth = pose
        readings = spm.inverse_physical(stage, height, tilt=tilt, azimuth=azimuth).readings.tolist()
    state, modes = spm.forward_physical(stage, readings), spm.forward_displacement(stage, readings)
    assert modes.is_physical.sum() == 1
    np.testing.assert_allclose(state.balls, modes.physical().balls, atol=1e-12)
    again = spm.inverse_physical(stage, state.height, normal=state.normal)
    np.testing.assert_allclose(again.readings, readings, atol=1e-12)


@pytest.mark.parametrize("machine", MACHINES)
def test_what_the_physical_inverse_returns_is_in_the_set_of_both(machine: str) -> None:
    stage, height = stage_and_height(machine)
    normals, heights = requests(height, 200)
    both = spm.inverse_displacement(stage, heights, normal=normals)
    physical = spm.inverse_physical(stage, heights, normal=normals)
    np.testing.assert_array_equal(both.physical().readings, physical.readings)
    np.testing.assert_array_equal(both.physical().rotation, physical.rotation)
    assert not both.is_physical[:, 1].any()
    # The readings are those of the pose, by the legs' own formulas.
    exists = both.exists
    fresh = Configuration(stage, both.configurations[exists].pose)
    np.testing.assert_allclose(fresh.readings, both.readings[exists], atol=1e-13)
    np.testing.assert_allclose(fresh.torsion, both.configurations[exists].torsion, atol=1e-14)


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("count", [1, pytest.param(6, marks=pytest.mark.slow)])
def test_all_sixteen_modes_and_no_others(machine: str, count: int) -> None:
    """Held-out stages of other proportions, against an elimination with a hundred digits."""
    reference, height = stage_and_height(machine)
    rng = np.random.default_rng(17)
    for _ in range(count):
        parameters = reference.parameters * (
            1.0 + 0.1 * rng.normal(size=len(reference.parameters)) * (rng.random() < 0.5)
        )
        stage = reference.from_parameters(parameters)
        normals, heights = requests(height, 1, seed=int(rng.integers(1000)))
        state = spm.inverse_displacement(stage, heights[0], normal=normals[0])["T"]
        if not state.exists:
            continue
        modes = spm.forward_displacement(stage, state.readings)
        assert modes.status is spm.Status.OK
        centres, radii = stage.legs.circles(state.readings)
        expected = real_modes(stage.legs.axes, centres, stage.legs.balls, radii)
        # Those of the legs' working mode: a leg of another reads something else.
        places = np.stack([((expected - stage.legs.pivots) * axes).sum(axis=-1) for axes in stage.legs.planes], axis=-1)
        own = np.abs(stage.legs.readings(places, stage.crank_middles) - state.readings).max(axis=-1) < 1e-9
        assert modes.count == own.sum() > 0
        gaps = np.abs(modes.configurations.balls[modes.exists][:, None] - expected[own]).max(axis=(-1, -2))
        assert gaps.min(axis=1).max() < 1e-9 * stage.size
        assert gaps.min(axis=0).max() < 1e-9 * stage.size


@pytest.mark.parametrize("machine", MACHINES)
def test_the_robot_of_two_stages_is_one_on_the_other_turned_over(machine: str) -> None:
    """The upper platform is turned by half a turn about y onto the lower one."""
    lower, height = stage_and_height(machine)
    upper = lower.perturbed(9, length=5e-3 * lower.size, angle=5e-3)
    both_requests = zip((lower, upper), (requests(height, 30, seed) for seed in (0, 4)), strict=True)
    below, above = (spm.inverse_physical(stage, z, normal=n) for stage, (n, z) in both_requests)
    both = below.exists & above.exists
    below, above = below[both], above[both]
    half_turn = RigidTransform.from_rotation(Rotation.from_rotvec([0.0, np.pi, 0.0]))
    expected = (below.pose * half_turn * above.pose.inv() * half_turn).as_matrix()
    robot = spm.Manipulator.of_stages(lower, upper)
    state = spm.forward_physical(robot, np.concatenate([below.readings, above.readings[:, ::-1]], axis=-1))
    assert len(expected) > 10
    np.testing.assert_allclose(state.pose.as_matrix(), expected, rtol=0, atol=1e-13)


def test_the_upper_stage_keeps_its_limits() -> None:
    upper = Stage(0.5, 0.46, limits=([0.1, 0.2, 0.3], [1.1, 1.2, 1.3]))
    robot = spm.Manipulator.of_stages(STAGES["RPS"], upper)
    assert robot.limits.minimum == (0.0, 0.0, 0.0, 0.3, 0.2, 0.1)
    assert robot.limits.maximum[3:] == (1.3, 1.2, 1.1)


def test_a_locked_stage_that_moves_is_degenerate() -> None:
    stage = Stage(0.23, 0.46)
    assert spm.forward_displacement(stage, [1.0, 1.0, 1.0]).status is spm.Status.DEGENERATE
    assert spm.forward_displacement(stage, [0.1, 0.1, 0.1]).status is spm.Status.UNREACHABLE


def test_why_there_is_no_solution_is_said() -> None:
    cylinders = STAGES["RPS"]
    for solve in (
        spm.inverse_displacement,
        spm.inverse_physical,
        spm.workspace.reach,
        spm.workspace.nearest_reachable_pose,
    ):
        for stage, number, unit in ((BALANCER, 120.0, "mm"), (BALANCER, -12.0, "cm"), (cylinders, 1100.0, "mm")):
            with pytest.raises(spm.ArgumentError, match=f"heights?: .*metres.*Is it {abs(number):g} {unit}"):
                solve(stage, number)
    for solve in (spm.forward_displacement, spm.forward_physical):
        with pytest.raises(spm.ArgumentError, match=r"readings: .*metres.*Is it 120 cm\?"):
            solve(cylinders, [110.0, 120.0, 115.0])
    far = spm.inverse_displacement(BALANCER, 0.8)
    assert far.status is spm.Status.UNREACHABLE
    for height in (-0.12, -0.8):
        assert "The height is negative: below the pivots." in repr(spm.inverse_physical(BALANCER, height))
    assert "negative" not in repr(spm.forward_displacement(cylinders, [0.1, 0.1, 3.0]).physical())
    assert "out of reach of r_1" in spm.inverse_physical(BALANCER, 0.2).missing_reason
    assert "angles are in radians" in repr(spm.inverse_displacement(BALANCER, 0.12, tilt=2.0, azimuth=0.0))
    assert "tilt is 57°" in repr(spm.inverse_physical(BALANCER, 0.12, roll=1.0))
    home, apart = spm.inverse_physical(BALANCER, 0.12), [1.5, -1.5, 1.5]
    assert "from the home" in spm.forward_physical(BALANCER, apart).missing_reason
    assert "from `near` in a straight line" in spm.forward_physical(BALANCER, apart, near=home).missing_reason


STATES = spm.inverse_physical(BALANCER, [0.12, 0.8])


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: spm.inverse_displacement(BALANCER, 0.12, tilt=15.0, azimuth=0.0), r"tilt: .*got 15\. Are they in deg"),
        (lambda: spm.forward_physical(BALANCER, STATES.readings), r"got nan at index \(1, 0\)\. .* a missing solution"),
        (lambda: spm.inverse_displacement(BALANCER, 0.12, tilt=-0.1, azimuth=0.0), "For a tilt to the opposite side"),
        (lambda: spm.inverse_displacement(BALANCER, 0.12, tilt=0.1, azimuth=15.0), r"azimuth: .*Are they in degrees"),
        (lambda: spm.inverse_displacement(BALANCER, 0.12, tilt=0.1), "azimuth"),
        (lambda: spm.inverse_displacement(BALANCER, 0.12, tilt=0.1, azimuth=0.0, roll=0.1), "tilt and roll: expected "),
        (lambda: spm.forward_displacement(BALANCER, [0.1, 0.2]), "readings: .*r_1, r_2, r_3 in radians, got shape"),
        (lambda: spm.forward_displacement(BALANCER, [6.0, 5.0, 7.0]), "In degrees"),
        (lambda: spm.forward_physical(STAGES["RPS"], [1.2] * 3, near=STATES[0]), "near: "),
        (lambda: spm.inverse_physical(spm.Manipulator.paper(), height=1.2), "takes a pose, a stage takes a height"),
        (lambda: spm.inverse_physical(BALANCER, pose=np.eye(4)), "takes a pose, a stage takes a height"),
        (lambda: spm.inverse_physical(BALANCER, spm.pose([0, 0, 0.12], rotation=np.eye(3))), "height: .*, got a pose"),
        (lambda: spm.forward_physical(spm.RPS(), [1.0] * 3), "machine: expected a Manipulator or a Stage"),
        (lambda: spm.follow(BALANCER, height=[0.12] * 3, roll=[0.0, 0.1], pitch=0.0), "height"),
    ],
)
def test_wrong_arguments_are_named(call: Callable[[], object], says: str) -> None:
    with pytest.raises(spm.ArgumentError, match=says):
        call()


@pytest.mark.parametrize(
    ("make", "cause"),
    [
        (lambda: Stage(0.08, 0.3, spm.RRS(crank=0.05, rod=0.11)), "longer than 0.22 m"),
        (lambda: Stage(0.08, 0.36, spm.RRS(crank=0.05, rod=0.11)), "diameters for radii"),
        (lambda: Stage(0.35, 0.2, spm.PRS(rod=0.14)), "a rod longer than 0.15 m"),
        (lambda: Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), (-10, 10)), "In degrees"),
        (lambda: Stage(0.35, 0.2, spm.PRS(rod=0.4, direction=90)), "Is it in degrees"),
        (lambda: Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11, sign=0)), "the working mode"),
        (lambda: Stage(0.7, 0.46, limits=(1100, 1500)), "is it 1500 mm"),
        (lambda: Stage(0.7, 0.46, limits=(1.5, 1.1)), "exchanged"),
        (lambda: Stage(0.7, 0.46, spm.Manipulator.paper().legs), "Legs of six"),
    ],
)
def test_numbers_that_are_no_stage_are_refused_with_the_cause(make: object, cause: str) -> None:
    with pytest.raises(spm.GeometryError, match=cause):
        make()  # type: ignore[operator]


@pytest.mark.parametrize(
    ("make", "hint"),
    [
        (lambda: Stage(8, 9, spm.RRS(crank=5, rod=11)), "rod of RRS is 11 m. .*another unit"),
        (lambda: Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=110)), "110 m and crank of RRS 0.05"),
        (lambda: Stage(0.3, 0.002), "base_radius is 0.3 m and platform_radius 0.002 m"),
        (lambda: spm.Manipulator(6.0, 5.0, 7.0), "middle_side is 7 m. .*another unit"),
        (lambda: Stage(0.08, 0.09, spm.RRS(crank=0.11, rod=0.05)), "exchanged"),
    ],
)
def test_unusual_dimensions_are_a_machine_and_give_a_hint(make: object, hint: str) -> None:
    with pytest.warns(UserWarning, match=hint) as warned:
        machine = make()  # type: ignore[operator]
    assert len(warned) == 1
    with warnings.catch_warnings(action="error"):
        assert pickle.loads(pickle.dumps(machine)) == machine
        assert not machine.perturbed(1).is_nominal


def test_a_table_is_read_by_the_names_of_the_legs() -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"r_3": [0.6], "r_1": [0.2], "r_2": [0.4]})
    np.testing.assert_array_equal(spm.forward_physical(BALANCER, table).readings, [[0.2, 0.4, 0.6]])
    with pytest.raises(spm.ArgumentError, match=r"expected columns r_1, r_2, r_3, got a table with x, y, z"):
        spm.forward_physical(BALANCER, table.set_axis(["x", "y", "z"], axis="columns"))


@pytest.mark.parametrize("machine", ["PRS inclined", "RRS inwards as built"])
def test_a_file_holds_every_digit(machine: str, tmp_path: object) -> None:
    stage, _ = stage_and_height(machine)
    limited = Stage(stage.base_radius, stage.platform_radius, stage.legs, ([0.1, 0.0, 0.05], 0.9))
    limited.to_yaml(f"{tmp_path}/stage.yaml")
    again = Stage.from_yaml(f"{tmp_path}/stage.yaml")
    assert again == limited
    assert again.is_nominal == stage.is_nominal
    np.testing.assert_array_equal(again.parameters, stage.parameters)
    assert limited.from_parameters(limited.parameters).limits == limited.limits


def test_files_of_robots_and_of_stages_are_told_apart(tmp_path: Path) -> None:
    robot, stage = tmp_path / "robot.yaml", tmp_path / "stage.yaml"
    spm.Manipulator.paper().to_yaml(robot)
    spm.Stage(0.08, 0.09, BALANCER.kind, limits=(-0.5, 1.0)).to_yaml(stage)
    with pytest.raises(spm.GeometryError, match=r"limits is a key of a stage's file, which spm_pin\.Stage"):
        spm.Manipulator.from_yaml(stage)
    with pytest.raises(spm.GeometryError, match=r"middle_side is a key of a robot's file, which spm_pin\.Manipulator"):
        spm.Stage.from_yaml(robot)


def test_copies_and_other_dimensions_stay_drawn() -> None:
    copy = pickle.loads(pickle.dumps(BALANCER))
    assert (copy, copy.is_nominal) == (BALANCER, True)
    wider = dataclasses.replace(BALANCER, base_radius=0.085)
    np.testing.assert_allclose(np.linalg.norm(wider.legs.pivots, axis=-1), 0.085)
    state = spm.inverse_physical(BALANCER, [0.11, 0.12])
    again = pickle.loads(pickle.dumps(state))
    np.testing.assert_array_equal(again.readings, state.readings)


def test_a_platform_turned_over_has_no_answer_under_ok() -> None:
    found = spm.inverse_displacement(machine=BALANCER, height=0.1, normal=[[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    assert list(found.status) == [spm.Status.UNREACHABLE, spm.Status.OK]
    assert np.isfinite(found.rotation[1, 0]).all()


@pytest.mark.parametrize(("from_over", "exists"), [(1e-1, True), (3e-3, True), (1e-3, False), (1e-7, False)])
def test_a_pose_close_to_turned_over_is_right_or_absent(from_over: float, exists: bool) -> None:
    """Of a stage as drawn mode T is the turn about the level axis across the azimuth."""
    stage, tilt, azimuth = STAGES["RPS"], np.pi - from_over, 0.7
    turn = Rotation.from_rotvec(tilt * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0]))
    state, normal = spm.inverse_displacement(stage, 0.5, tilt=tilt, azimuth=azimuth)["T"], turn.as_matrix()[:, 2]
    assert state.exists == exists
    on_arrays = spm.arrays.stage_inverse(stage, normal, np.array(0.5))
    in_casadi = spm.casadi.stage_inverse(stage)(normal, 0.5)
    assert bool(on_arrays.exists) == bool(in_casadi[-1]) == exists
    if exists:
        for rotation in (state.rotation, on_arrays.rotation, np.array(in_casadi[1])):
            np.testing.assert_allclose(rotation, turn.as_matrix(), atol=2e-15 / from_over**2)


def test_errors_of_radial_slides_do_not_turn_a_stage_over() -> None:
    nominal = Stage(0.3, 0.2, spm.PRS(rod=0.4, direction=0.0, sign=1))
    state = spm.inverse_physical(nominal, 0.3, tilt=0.2, azimuth=0.5)
    for seed in range(10):
        built = spm.forward_physical(nominal.perturbed(seed, length=1e-4, angle=1e-4), state.readings)
        np.testing.assert_allclose(built.balls, state.balls, rtol=0, atol=5e-3)
