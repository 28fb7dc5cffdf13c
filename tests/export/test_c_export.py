"""The exported C: compiled without a warning, and compared with the package for machines of all kinds."""

from __future__ import annotations

import ctypes
import re
import shutil
import subprocess
from dataclasses import replace
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np
import pytest
from cli.running import run
from error_fields import with_fields
from export.c_library import STRICT, CLibrary, as_states, compile_c, compilers, run_cmake
from export.c_poses import hard_poses, held_states, possible_lengths, spread_poses
from kinds_of_legs import machine_of_kinds, states
from problems import MANIPULATORS, as_built, at_end_stops
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.errors import ArgumentError
from spm_pin.export.c_export import STATE_FUNCTIONS, STATUSES
from spm_pin.machine.joint_angles import joint_names, value_names

PAPER = MANIPULATORS["paper"]
EPS = np.finfo(float).eps
STATUS = {name: value for name, (value, _) in STATUSES.items()}
SANITIZED = ("-O1", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")
PAGE = Path(__file__).parents[2] / "docs/howto/controller.md"
WRENCH = np.array([30.0, -20.0, -500.0, 4.0, -6.0, 8.0])


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> CLibrary:
    return CLibrary.build(PAPER, tmp_path_factory.mktemp("c"), "-O1")


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the paper's machine."""
    folder = tmp_path_factory.mktemp("exported")
    spm.export.write_c(PAPER, folder)
    return folder


@pytest.fixture(scope="module")
def compiled(exported: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The object file of the functions; beside it, of gcc, the stack of each and the graph of their calls."""
    compiler, target = compilers()[0], tmp_path_factory.mktemp("compiled") / "object.o"
    lists = ["-fcallgraph-info=su"] if Path(compiler).name == "gcc" else []
    compile_c(compiler, "-std=c99", "-O2", *lists, "-c", exported / "spm_kinematics.c", "-o", target)
    return target


def random_readings(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(1.1, 1.5, (count, 6))


def random_steps(count: int, seed: int, length: float, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return shifts [m] and turns [rad] (count, 3), of all sizes up to these."""
    rng = np.random.default_rng(seed)
    both = rng.normal(size=(2, count, 3))
    both *= rng.random((2, count, 1)) / np.linalg.norm(both, axis=-1, keepdims=True)
    return both[0] * length, both[1] * angle


@pytest.mark.parametrize("size", [0.0, 1e-3])
def test_states_at_end_stops_keep_their_branch_as_in_the_package(library: CLibrary, size: float) -> None:
    machine = PAPER if size == 0.0 else as_built(PAPER, size, 11)
    states = at_end_stops(machine, 300)
    expected, (found, status) = (
        spm.inverse_physical(machine, states.pose),
        library.of(machine).inverse(states.rotation, states.translation),
    )
    assert (status == 0).mean() > 0.99
    solved = status == 0
    assert machine.limits.contains(found[solved, 21:]).all()
    np.testing.assert_allclose(found[solved, 21:], expected.readings[solved], rtol=0, atol=1e-9)


def test_the_first_leg_beyond_its_limits_is_that_of_the_package(library: CLibrary) -> None:
    """At both ends, and beside them by less and by more than rounding."""
    rng = np.random.default_rng(2)
    shares = 1.0 + np.array([0.0, 9e-9, -9e-9, 1.1e-8, -1.1e-8, 1e-3, -1e-3])
    for limits in (spm.LegLimits(1.1, 1.5), spm.LegLimits([1.1, 1.1, 1.1, 1.2, 1.1, 1.1], np.inf)):
        machine = replace(PAPER, limits=limits)
        readings = rng.choice(np.outer([1.1, 1.2, 1.5], shares).ravel(), (10_000, 6))
        readings[::7] = np.clip(readings[::7], 1.2, 1.49)
        excess = limits.excess(readings)
        expected = np.where((excess != 0.0).any(axis=-1), (excess != 0.0).argmax(axis=-1) + 1, 0)
        np.testing.assert_array_equal(library.of(machine).beyond_limits(readings), expected)
        assert (np.bincount(expected) > 100).all()
    assert library.of(PAPER).beyond_limits(np.array([[1.2, np.nan, 1.2, 1.2, 1.2, 1.2]])).tolist() == [2]


@pytest.mark.parametrize(
    ("lower", "upper"),
    [("RPS", "RPS"), ("RRS", "PRS"), pytest.param("PRS", "RRS", marks=pytest.mark.slow)],
)
def test_legs_of_any_kind_are_computed_as_by_the_package(
    library: CLibrary, lower: str, upper: str, tmp_path: Path
) -> None:
    """One build for the nominal machine and for calibrated ones."""
    nominal, has_cylinders = machine_of_kinds(lower, upper), lower == upper == "RPS"
    compiled = library if has_cylinders else CLibrary.build(nominal, tmp_path, "-O1")
    for size in (0.0, 1e-5, 5e-3):
        machine = nominal.perturbed(5, length=size, angle=size) if size else nominal
        own, state = compiled.of(machine), states(machine, 250)
        known, largest = as_states(state), machine.legs.largest_slopes
        rates = spm.inverse_jacobian(state)
        size = np.abs(largest[:, None] * rates).max(axis=(-1, -2))
        away = size < 1e3
        bound = 1e-12 + 256.0 * EPS * size**2
        for found, status in (
            own.forward(state.readings),
            own.forward(state.readings, known),
            own.inverse(state.rotation, state.translation, known),
        ):
            assert (status[away] == 0).all()
            assert (np.abs(found - known).max(axis=-1) <= bound)[away].all()
        expected, (found, status) = (
            spm.inverse_physical(machine, state.pose),
            own.inverse(state.rotation, state.translation),
        )
        np.testing.assert_array_equal(status[away] == 0, expected.exists[away])
        same = away & (status == 0)
        assert (np.abs(found[:, 21:] - expected.readings).max(axis=-1) <= bound)[same].mean() > 0.99
        matrices, status = own.of_states("inverse_jacobian", known)
        assert (status == 0).all()
        error = np.abs(largest[:, None] * (matrices.reshape(-1, 6, 6) - rates)).max(axis=(-1, -2))
        assert (error <= 1e-12 + 1e3 * EPS * size**2)[away].all()
        wrench = np.tile(WRENCH, (len(known), 1))
        forces, status = own.of_states("leg_forces", known, wrench)
        assert (status == 0).all()
        np.testing.assert_allclose(forces, spm.leg_forces(state, wrench), rtol=0, atol=1e-10 * np.abs(forces).max())
        values = spm.machine.joint_angles(state, (0,)).values
        order = [value_names(machine).index(name) for name in joint_names(machine)]
        found, status = own.of_states("joint_values", known)
        assert (status == 0).all()
        np.testing.assert_allclose(found, values[:, order], rtol=0, atol=1e-12)
        # Ways to other states, which turn cranks by up to half a radian; and balls out of reach.
        moved, arrived = own.forward(np.roll(state.readings, 1, axis=0), known)
        followed = spm.forward_physical(machine, np.roll(state.readings, 1, axis=0), state)
        both = followed.exists & (arrived == 0)
        assert both.mean() > 0.8
        assert ((arrived == 0) == followed.exists).mean() > 0.99
        assert (np.abs(moved[:, :21] - as_states(followed)[:, :21]).max(axis=-1) <= 1e-9)[both].all()
        up = state.translation + np.array([0.0, 0.0, 9.0])
        for found, status in (own.inverse(state.rotation, up), own.inverse(state.rotation, up, known)):
            assert lower == "RPS" or not (status == 0).any()  # slides lead outwards, and cranks have an end
            np.testing.assert_array_equal(np.isnan(found).all(axis=-1), status != 0)
    if has_cylinders:
        return
    # Cranks where they were, two turns later: they are taken for degrees.
    wound = state.readings + 4.0 * np.pi * (np.array(machine.legs.units) == "rad")
    for further in ((), (known,)):
        assert (own.forward(wound, *further)[1] == STATUS["OUT_OF_RANGE"]).all()
    # A crank and a rod that just do not reach, of a state that is passed in, and numbers that are none.
    place = 75  # of the first number that is fixed in a leg
    for number, name in (
        (1e-3, "UNREACHABLE"),
        (0.0, "BAD_GEOMETRY"),
        (np.nan, "BAD_GEOMETRY"),
        (-1.0, "BAD_GEOMETRY"),
    ):
        numbers = own.machine.copy()
        numbers[place] = number
        found, status = CLibrary(own.library, numbers).of_states("leg_forces", known, wrench)
        assert (status == STATUS[name]).all(), name
        assert np.isnan(found).all()


def test_the_file_of_a_machine_names_the_kinds_of_its_legs() -> None:
    text = spm.export.c_sources(machine_of_kinds("RRS", "PRS"))["spm_machine.txt"]
    assert "lower_rrs 1.1 0.9 -1.0 1.1 0.9 -1.0 1.1 0.9 -1.0\n" in text


@pytest.mark.parametrize("name", MANIPULATORS)
def test_all_branches_of_a_drawn_machine_are_those_of_the_package(library: CLibrary, name: str) -> None:
    machine = MANIPULATORS[name]
    rotation, position = spread_poses(machine, 5000, 1)
    found, status = library.of(machine).all_branches(rotation, position)
    branches = spm.inverse_displacement(machine, spm.pose(position, rotation=rotation))
    clear = (np.abs(branches.discriminants) > 1e-9).all(axis=-1)
    assert clear.mean() > 0.99
    np.testing.assert_array_equal(status[clear], branches.status[clear])
    np.testing.assert_array_equal(found["real"][clear] == 1, branches.exists[clear])
    error = np.abs(found["readings"] - branches.leg_lengths)[clear]
    size = np.abs(branches.leg_lengths[clear]).max(axis=-1, where=branches.exists[clear][..., None], initial=1e-3)
    near = np.sqrt(np.abs(branches.discriminants[clear]).min(axis=-1))
    assert (np.nanmax(error, axis=(-1, -2), initial=0.0) <= 1e3 * EPS * size.max(axis=-1) / near**2).all()
    np.testing.assert_array_equal(np.isnan(error).all(axis=-1), ~branches.exists[clear])


def test_hard_poses_have_a_status_and_no_infinite_number(library: CLibrary) -> None:
    rotation, position = hard_poses(PAPER, 6000, 2)
    found, status = library.all_branches(rotation, position)
    assert {int(s) for s in status} == {0, 1, 2}
    assert not np.isinf(found["readings"]).any()
    assert (library.of(as_built(PAPER, 1e-6)).all_branches(rotation, position)[1] == STATUS["BAD_GEOMETRY"]).all()
    for machine in (PAPER, as_built(PAPER, 1e-3)):
        states, status = library.of(machine).inverse(rotation, position)
        assert set(status.tolist()) <= {0, 1, 2}
        np.testing.assert_array_equal(np.isfinite(states).all(axis=-1), status == 0)


@pytest.fixture(scope="module")
def follower(exported: Path, tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The follower by fine steps, compiled together with the formulas of the exported source."""
    source, library = Path(__file__).with_name("fine_steps.c"), tmp_path_factory.mktemp("fine") / "library.so"
    compile_c(compilers()[0], "-std=c99", "-O1", "-fPIC", "-shared", "-I", exported, source, "-lm", "-o", library)
    return ctypes.CDLL(str(library))


@pytest.mark.parametrize("as_drawn", [True, False])
def test_a_way_from_a_state_ends_where_a_thousand_times_finer_steps_end(
    library: CLibrary, follower: ctypes.CDLL, as_drawn: bool
) -> None:
    machine = PAPER if as_drawn else as_built(PAPER, 3e-3)
    jumps, reached = compare_with_fine_steps(library, follower, machine, 40, 7)
    assert jumps == 0
    assert reached >= 50


def test_fine_steps_that_jump_are_seen(library: CLibrary, follower: ctypes.CDLL) -> None:
    """Two steps over a way of half a metre and one radian leave the branch now and then."""
    jumps, reached = compare_with_fine_steps(library, follower, PAPER, 300, 7, 2, length=0.5, angle=1.0)
    assert 0 < jumps < reached


def compare_with_fine_steps(
    library: CLibrary,
    follower: ctypes.CDLL,
    machine: spm.Manipulator,
    count: int,
    seed: int,
    parts: int = 1000,
    length: float = 0.02,
    angle: float = np.deg2rad(2.0),
) -> tuple[int, int]:
    """Move `count` states by up to 2 cm and 2° both ways; return how many ended elsewhere, and how many arrived."""
    own, state = library.of(machine), spm.forward_physical(machine, random_readings(count, seed))
    start = as_states(state)
    shift, turn = random_steps(count, seed + 1, length, angle)
    change = np.random.default_rng(seed + 2).uniform(-length, length, (count, 6))
    rotation = (Rotation.from_rotvec(turn) * Rotation.from_matrix(state.rotation)).as_matrix()
    jumps = arrived = 0
    for name, way, (ends, status) in (
        ("follow_pose", (shift, turn), own.inverse(rotation, state.translation + shift, start)),
        ("follow_readings", (change,), own.forward(start[:, 21:] + change, start)),
    ):
        which, finer = np.flatnonzero(status == 0), np.empty((count, 27))
        arrays = (own.machine, start, *way, finer)
        pointers = [np.ascontiguousarray(x).ctypes.data_as(ctypes.c_void_p) for x in arrays]
        getattr(follower, name)(ctypes.c_long(count), ctypes.c_int(parts), *pointers)
        gaps = np.abs(finer - ends)[which].max(axis=-1)
        jumps += int((~(gaps <= 1e-7)).sum())
        arrived += len(which)
    return jumps, arrived


def test_a_way_into_a_fold_is_refused(library: CLibrary) -> None:
    """Poses beyond the end of the physical branches, from states within."""
    state = held_states(PAPER, 800, 3)
    shift, _ = random_steps(len(state.exists), 4, 0.2, 0.0)
    target = state.translation + shift
    states, status = library.inverse(state.rotation, target, as_states(state))
    gone = ~spm.inverse_displacement(PAPER, spm.pose(target, rotation=state.rotation)).exists[:, :2].any(axis=-1)
    assert gone.sum() > 50
    assert (status[gone] == STATUS["SINGULAR"]).all()
    assert np.isnan(states[gone]).all()
    # Readings that go through a forward singularity, or that no stage has.
    readings = np.tile([0.3, 2.5, 0.3, 1.3, 1.3, 1.3], (len(status), 1))
    assert (library.forward(readings, as_states(state))[1] == STATUS["SINGULAR"]).all()
    assert library.forward(readings[:1])[1].tolist() == [STATUS["UNREACHABLE"]]


@pytest.mark.parametrize("name", MANIPULATORS)
def test_legs_of_all_kinds_are_solved_where_the_package_solves_them(library: CLibrary, name: str) -> None:
    machine = MANIPULATORS[name]
    wild = possible_lengths(machine, 2000, 3, 1.0)
    expected = spm.forward_physical(machine, wild)
    states, status = library.of(machine).forward(wild)
    assert not ((status == 0) & ~expected.exists).any()
    assert (status == 0).sum() >= 0.995 * expected.exists.sum() > 300
    found = status == 0
    scale = np.linalg.norm(spm.kinematics.platform_jacobian(expected[np.flatnonzero(found)]), axis=(-1, -2))
    error = np.abs(states[found, :21] - as_states(expected)[found, :21]).max(axis=-1)
    assert (error <= 64.0 * EPS * scale * (1.0 + sum(machine.dimensions))).all()


def test_singular_states_are_refused(library: CLibrary) -> None:
    home = as_states(spm.forward_physical(PAPER, [[1.3] * 6]))  # level: an inverse singularity
    assert library.of_states("inverse_jacobian", home)[1].tolist() == [STATUS["SINGULAR"]]
    assert library.of_states("leg_forces", home, np.ones((1, 6)))[1].tolist() == [0]
    # The middle platform in the base's plane: three lower legs in one plane.
    pose = spm.pose([[0, 0, 0.8]], xyx=[[0.3, 0.1, 0.0]])
    flat = spm.Configuration(PAPER, pose, PAPER.middle_radius * PAPER.radial_directions[None])
    found, status = library.of_states("leg_forces", as_states(flat), np.ones((1, 6)))
    assert status.tolist() == [STATUS["SINGULAR"]]
    assert np.isnan(found).all()
    with pytest.raises(spm.SingularConfigurationError):
        spm.leg_forces(flat[0], np.ones(6))


def test_errors_are_statuses_and_results_are_nan(library: CLibrary) -> None:
    state = held_states(PAPER, 1, 1)
    rotation, position, states = state.rotation, state.translation, as_states(state)
    readings = np.full((1, 6), 1.3)
    torn = states.copy()
    torn[0, 12] += 1e-3
    huge = states.copy()
    huge[0, 13] = 1e308
    cases = [
        (library.inverse(rotation, position * np.nan), "NOT_FINITE"),
        (library.inverse(rotation * np.nan, position), "NOT_FINITE"),
        (library.inverse(rotation * [1, 1, -1], position), "NOT_A_ROTATION"),
        (library.inverse(rotation + 1e-5 * np.eye(3), position), "NOT_A_ROTATION"),
        (library.inverse(0.0 * rotation, position), "NOT_A_ROTATION"),
        *((library.inverse(rotation, [[0.0, 0.0, z]]), "OUT_OF_RANGE") for z in (1e7, 1e16, 1e160, 1e308)),
        (library.inverse(rotation, position, torn), "BAD_NEAR"),
        (library.inverse(rotation, position, huge), "OUT_OF_RANGE"),
        (library.inverse(rotation, position, states * np.nan), "NOT_FINITE"),
        *((library.forward(readings * [1, 1, x, 1, 1, 1]), "OUT_OF_RANGE") for x in (0.0, -1.0, 1e6, 1e300)),
        (library.forward(readings * [1, 1, np.nan, 1, 1, 1]), "NOT_FINITE"),
        (library.forward(readings, torn), "BAD_NEAR"),
        *((library.of_states(f.name, huge, *_rows(f)), "OUT_OF_RANGE") for f in STATE_FUNCTIONS),
        *((library.of_states(f.name, states * np.nan, *_rows(f)), "NOT_FINITE") for f in STATE_FUNCTIONS),
        (library.of_states("leg_forces", states, np.full((1, 6), np.inf)), "NOT_FINITE"),
        (library.of_states("leg_forces", states, np.full((1, 6), 1.7e308)), "OUT_OF_RANGE"),
    ]
    for number, ((result, status), name) in enumerate(cases):
        assert status.tolist() == [STATUS[name]], number
        assert np.isnan(result).all(), number
    found, status = library.all_branches(rotation, [[0.0, 0.0, 1e160]])
    assert status.tolist() == [STATUS["OUT_OF_RANGE"]]
    assert all(np.isnan(found[x]).all() for x in ("joints", "readings", "discriminants"))


def _rows(function: object) -> list[np.ndarray]:
    return [np.asarray(x)[None] for x in function.arguments.values()]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *((67, value) for value in (np.nan, -0.1, np.inf)),
        *((73, value) for value in (np.nan, -0.1)),  # an upper limit may be infinite
        *((place, value) for place in (0, 2) for value in (0.0, -1.0, np.inf, np.nan, 1e10)),
        *((place, value) for place in (3, 25, 40, 57) for value in (np.nan, 1e10)),
    ],
)
def test_numbers_that_are_no_machine_are_refused(library: CLibrary, field: int, value: float) -> None:
    state, machine = held_states(PAPER, 3, 1), library.machine.copy()
    machine[field] = value
    own, states = CLibrary(library.library, machine), as_states(state)
    for result, status in (
        own.inverse(state.rotation, state.translation),
        own.forward(states[:, 21:]),
        *(own.of_states(f.name, states, *(np.repeat(x, 3, axis=0) for x in _rows(f))) for f in STATE_FUNCTIONS),
    ):
        assert (status == STATUS["BAD_GEOMETRY"]).all()
        assert np.isnan(result).all()
    assert (own.all_branches(state.rotation, state.translation)[1] == STATUS["BAD_GEOMETRY"]).all()


def test_a_rotation_with_rounding_of_single_precision_is_repaired_as_by_the_package(library: CLibrary) -> None:
    state = held_states(PAPER, 500, 11)
    rounded = state.rotation.astype(np.float32).astype(np.float64)
    states, status = library.inverse(rounded, state.translation)
    expected = spm.inverse_physical(PAPER, spm.pose(state.translation, rotation=rounded))
    np.testing.assert_array_equal(status == 0, expected.exists)
    away = expected.exists & (np.abs(spm.determinants(state)[..., 2]) > 0.1)
    np.testing.assert_allclose(states[away, 21:], expected.leg_lengths[away], rtol=0, atol=1e-13)


@pytest.mark.parametrize(("machine", "which"), [(PAPER, 0), (as_built(PAPER, 1e-3), -1)])
def test_the_test_program_builds_without_a_warning_and_finds_all_right(
    machine: spm.Manipulator, which: int, tmp_path: Path
) -> None:
    spm.export.write_c(machine, tmp_path, prefix="left_")
    compile_c(compilers()[which], *STRICT, "-O0", *sorted(tmp_path.glob("*.c")), "-lm", "-o", tmp_path / "program")
    done = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "12 poses compared, 0 wrong" in done.stdout


def test_fast_mathematics_is_refused(exported: Path) -> None:
    command = [compilers()[0], "-ffast-math", "-fsyntax-only", exported / "spm_kinematics.c"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "-ffast-math breaks the checks" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.0, 1e-3])
def test_sanitizers_find_nothing_in_hard_poses(size: float, tmp_path: Path) -> None:
    """All functions of a sanitized library, in a process that has the sanitizers' runtime loaded."""
    machine = PAPER if size == 0.0 else as_built(PAPER, size)
    spm.export.write_c(machine, tmp_path)
    rotation, position = hard_poses(PAPER, 3000, 3)
    position[:3], rotation[3:6] = np.inf, [[[np.nan]], [[1e200]], [[2.0]]]
    held = spm.forward_physical(machine, random_readings(500, 3))
    rotation, position = np.concatenate([rotation, held.rotation]), np.concatenate([position, held.translation])
    np.concatenate([rotation.reshape(-1, 9), position], axis=-1).tofile(tmp_path / "numbers")
    (tmp_path / "driver.c").write_text(_DRIVER, encoding="utf-8")
    inputs = tmp_path / "driver.c", tmp_path / "spm_kinematics.c"
    compile_c(compilers()[-1], "-std=c99", *SANITIZED, *inputs, "-lm", "-o", tmp_path / "program")
    command = [tmp_path / "program", tmp_path / "numbers"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    solved, on, back = map(int, done.stdout.split())
    assert solved >= 500
    assert min(on, back) >= 450


_DRIVER = """
#include "spm_kinematics.h"
#include <stdio.h>
int main(int count, char **names)
{
    FILE *in = fopen(names[count - 1], "rb");
    double row[12], out[36];
    const double wrench[6] = {3.0, -2.0, -50.0, 4.0, -6.0, 8.0}, payload[4] = {1.0, 0.1, 0.2, 0.3};
    spm_branches branches;
    spm_state state;
    int i, solved = 0, on = 0, back = 0;
    while (in && fread(row, sizeof row, 1, in) == 1) {
        (void)spm_all_branches(&spm_machine, row, row + 9, &branches);
        solved += spm_inverse(&spm_machine, row, row + 9, 0, &state) == SPM_OK;
        (void)spm_inverse_jacobian(&spm_machine, &state, out);
        (void)spm_leg_forces(&spm_machine, &state, wrench, out);
        (void)spm_leg_rates(&spm_machine, &state, wrench, out);
        (void)spm_gravity(&spm_machine, &state, spm_bodies, payload, wrench, out);
        (void)spm_joint_values(&spm_machine, &state, out);
        for (i = 0; i < 6; ++i) out[i] = state.readings[i] * (i % 2 ? 1.002 : 0.998);
        on += spm_forward(&spm_machine, out, &state, &state) == SPM_OK;
        back += spm_inverse(&spm_machine, row, row + 9, &state, &state) == SPM_OK;
        (void)spm_forward(&spm_machine, out, 0, &state);
    }
    printf("%d %d %d", solved, on, back);
    return 0;
}
"""


def test_no_function_needs_more_than_eight_kilobytes_of_stack(compiled: Path) -> None:
    """Along every chain of calls, as gcc lists them; the mathematics library is not in the list."""
    if not compiled.with_suffix(".ci").exists():
        pytest.skip("no gcc, which lists the stack of functions")
    graph = compiled.with_suffix(".ci").read_text(encoding="utf-8")
    nodes = re.findall(
        r'^node: \{ title: "([^"]+)" label: "[^"]*\\n(\d+) bytes \(([a-z,]+)\)', graph, flags=re.MULTILINE
    )
    assert {kind for *_, kind in nodes} <= {"static", "dynamic,bounded"}
    own = {name: int(size) for name, size, _ in nodes}
    calls: dict[str, set[str]] = {name: set() for name in own}
    edges = re.findall(r'^edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', graph, flags=re.MULTILINE)
    for caller, callee in edges:
        calls[caller] |= {callee} & own.keys()
    # A recursion would be a cycle.
    total: dict[str, int] = {}
    for name in TopologicalSorter(calls).static_order():
        total[name] = own[name] + max((total[callee] for callee in calls[name]), default=0)
    functions = {name: total[name] for name in total if name.startswith("spm_")}
    assert len(functions) == 5 + len(STATE_FUNCTIONS)
    assert 1000 < max(functions.values()) <= 8192, functions


@pytest.mark.filterwarnings("ignore:.*another unit")
@pytest.mark.parametrize("sizes", [(1e-9, 1e9, 1.0), (1.0, 1.001e3, 1.0), (1.0, 1.0, 0.999e-3)])
def test_dimensions_too_far_apart_are_refused(sizes: tuple[float, float, float], tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, check=with_fields(argument="machine")):
        spm.export.write_c(spm.Manipulator(*sizes), tmp_path / "c")
    assert not (tmp_path / "c").exists()


def test_the_test_program_finds_a_wrong_answer(exported: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(exported, tmp_path / "c")
    source, test = folder / "spm_kinematics.c", folder / "spm_kinematics_test.c"
    text = source.read_text(encoding="utf-8")
    wrong = text.replace("0.6928203230275509", "0.6928203240275509")  # E, off by 1e-9 m
    assert wrong != text
    source.write_text(wrong, encoding="utf-8")
    compile_c(compilers()[0], "-O0", source, test, "-lm", "-o", tmp_path / "program")
    done = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "wrong: all branches of case 0" in done.stdout


def test_nothing_is_allocated_and_only_mathematics_is_called(compiled: Path) -> None:
    tool = shutil.which("nm")
    if tool is None:
        pytest.skip("no nm, of the binutils that come with a compiler")
    listed = subprocess.run([tool, compiled], capture_output=True, text=True, check=True).stdout
    symbols = [line.split()[-2:] for line in listed.splitlines()]
    called = {name for kind, name in symbols if kind == "U"} - {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
    assert called <= {"atan2", "sin", "cos", "sincos", "sqrt", "memcpy", "memmove", "memset"}
    assert not [name for kind, name in symbols if kind in "BbDdC" and name != "spm_branch_names"], "variables"


def test_the_command_writes_the_files_of_any_machine(tmp_path: Path) -> None:
    as_built(PAPER, 1e-3).to_yaml(tmp_path / "machine.yaml")
    done = run("export", "c", "--out", tmp_path / "c", "--prefix", "arm_", "--machine", tmp_path / "machine.yaml")
    assert done.returncode == 0, done.message
    names = {f"arm_{name}" for name in ("kinematics.h", "kinematics.c", "kinematics_test.c", "machine.txt")}
    names |= {"CMakeLists.txt", "arm_read_machine.h"}
    assert {path.name for path in (tmp_path / "c").iterdir()} == names
    header = (tmp_path / "c" / "arm_kinematics.h").read_text(encoding="utf-8")
    assert f"Generated by spm_pin {spm.__version__} for Manipulator(base_radius=0.69282," in header
    assert "@" not in header
    assert run("export", "c", "--out", tmp_path / "c").returncode == 0


def test_a_directory_is_left_as_it_was_where_not_all_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "spm_kinematics_test.c").mkdir()
    with pytest.raises(ArgumentError, check=with_fields(argument="directory")):
        spm.export.write_c(PAPER, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["spm_kinematics_test.c"]


@pytest.mark.documents
def test_the_page_has_the_tables_and_a_call_that_compiles(exported: Path, tmp_path: Path) -> None:
    page = PAGE.read_text(encoding="utf-8")
    for function in STATE_FUNCTIONS:
        assert f"| `spm_{function.name}` | {function.meaning} |" in page
    for name, (_, meaning) in STATUSES.items():
        assert f"| `SPM_{name}` | {meaning} |" in page
    (block,) = re.findall(r"^```c\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    include, body = block.split("\n", 1)
    stubs = "static void stop(const char *why) { (void)why; }\nstatic void command(const double *q) { (void)q; }\n"
    head = "void call(const double *rotation, const double *position);\nvoid call(const double *rotation, "
    text = f"{include}\n{stubs}{head}const double *position)\n{{{body}}}\n"
    (tmp_path / "call.c").write_text(text, encoding="utf-8")
    compile_c(compilers()[0], *STRICT, "-fsyntax-only", "-I", exported, tmp_path / "call.c")


@pytest.mark.documents
def test_the_test_program_prints_what_the_how_to_shows(exported: Path, tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no cc")
    shutil.copytree(exported, tmp_path / "spm_c")
    command, shown = re.search(
        r"^\$ (cc .*\n)(.*compared.*\n)", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE
    ).groups()
    done = subprocess.run(["sh", "-ec", command], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == shown


@pytest.mark.slow
def test_it_builds_with_cmake(tmp_path: Path) -> None:
    spm.export.write_c(PAPER, tmp_path)
    run_cmake(["-S", tmp_path, "-B", tmp_path / "build"], ["--build", tmp_path / "build"])
    assert subprocess.run([tmp_path / "build" / "spm_kinematics_test"], check=False).returncode == 0


def test_a_structure_is_as_large_as_its_numbers(library: CLibrary) -> None:
    """The bindings count on it."""
    names = (ctypes.c_char_p * 8).in_dll(library.library, "spm_branch_names")
    assert [name.decode() for name in names] == list(spm.machine.BRANCHES)
    machine = np.ctypeslib.as_array((ctypes.c_double * 75).in_dll(library.library, "spm_machine"))
    np.testing.assert_array_equal(machine, library.machine)
