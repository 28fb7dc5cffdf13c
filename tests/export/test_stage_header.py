"""The exported header of a stage: compared with the package over the reach of stages, and on a Cortex-M4F."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from balancers import MACHINES, STAGES, requests, stage_and_height
from cli.running import run
from error_fields import with_fields
from export.c_library import compile_c, compilers
from export.stage_library import STATUS, STRICT, StageLibrary

import spm_pin as spm
from spm_pin.errors import ArgumentError, UnreachableError
from spm_pin.export import stage_c_sources, write_stage_c

TOLERANCE = {np.float64: 1e-12, np.float32: 1e-5}
MOST_AMPLIFIED = {np.float64: 2e3, np.float32: 200.0}
LEAST_SLOPE = {np.float64: 1e-3, np.float32: 0.1}
TYPES = pytest.mark.parametrize("dtype", [np.float64, np.float32])
MACHINE = pytest.mark.parametrize("machine", MACHINES)
CORTEX = ("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-O2")
BOARD = Path(__file__).parent / "stand_ins/cortex_m4"
_USE = """
#include "stage.h"
int use(const stage_real *x, stage_state *s);
int use(const stage_real *x, stage_state *s)
{
    return stage_tilt(&stage_machine, x[0], x[1], x[2], s) + stage_forward(&stage_machine, x, s, s);
}
"""
_BOTH = """
#include "math_stage.h"
#include "right_stage.h"
int main(void)
{
    math_state l;
    right_state r;
    return math_tilt(&math_machine, 0, 0, math_machine.home_height, &l)
            + right_tilt(&right_machine, 0, 0, right_machine.home_height, &r);
}
"""
BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-1.2, 1.4))


@pytest.fixture(scope="module")
def libraries(tmp_path_factory: pytest.TempPathFactory) -> dict[type, StageLibrary]:
    return {dtype: StageLibrary.build(tmp_path_factory.mktemp("stage"), dtype) for dtype in TOLERANCE}


def rounded(array: np.ndarray, dtype: type) -> np.ndarray:
    """Return numbers that the type has."""
    return array.astype(dtype).astype(np.float64)


def rows_of(states: spm.Configuration) -> np.ndarray:
    parts = states.rotation.reshape(*states.shape, 9), states.translation, states.readings
    return np.concatenate(parts, axis=-1)


def errors(stage: spm.Stage, rows: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Return the largest error of each state, of places over the stage's size, of readings over that or a radian."""
    unit = 1.0 if stage.unit == "rad" else stage.size
    scale = np.repeat([1.0, stage.size, unit], [9, 3, 3])
    return (np.abs(rows - expected) / scale).max(axis=-1)


def least_slopes(states: spm.Configuration) -> np.ndarray:
    legs = states.machine.legs
    return np.nan_to_num(legs.slopes(states.places, states.readings) * legs.slope_signs / legs.largest_slopes).min(
        axis=-1
    )


@TYPES
@MACHINE
def test_the_inverse_is_that_of_python_over_the_reach_and_says_where_it_ends(
    libraries, machine: str, dtype: type
) -> None:
    stage, height = stage_and_height(machine)
    library = libraries[dtype].of(stage)
    normals, heights = requests(height, 5_000)
    heights = height + 3.0 * (heights - height)
    rows, status = library.inverse(normals, heights)
    normals, heights = rounded(normals, dtype), rounded(heights, dtype)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    expected = spm.inverse_physical(stage, heights, normal=normals)
    ok = status == STATUS["OK"]
    assert ok.sum() > 700
    assert expected.exists[ok].all()
    assert errors(stage, rows[ok], rows_of(expected)[ok]).max() < TOLERANCE[dtype]
    # Nothing is written elsewhere.
    assert (rows[~ok] == 7.0).all()
    # What the package has and the header refuses is near a singularity; there digits are lost.
    refused = expected.exists & ~ok
    assert (status[refused] == STATUS["SINGULAR"]).all()
    states = expected[np.flatnonzero(refused)]
    near_leg = least_slopes(states) < 1.05 * LEAST_SLOPE[dtype]
    assert (near_leg | (amplification(states) > 0.9 * MOST_AMPLIFIED[dtype])).all()
    assert set(status[~expected.exists]) <= {STATUS["UNREACHABLE"], STATUS["SINGULAR"]}


def amplification(states: spm.Configuration) -> np.ndarray:
    """Return how far balls move by errors of their places, by finite differences of all three distances.

    Columns are the derivatives of half the squared sides by turns of the rods about the ends of their circles' axes.
    """
    legs, balls = states.machine.legs, states.balls
    centres, radii = legs.circles(states.readings)
    arms = np.cross(legs.axes, balls - centres)
    step, columns = 1e-6, []
    for leg in range(3):
        moved = [balls + sign * step * arms * (np.arange(3) == leg)[:, None] for sign in (1.0, -1.0)]
        squares = [0.5 * ((b - np.roll(b, -1, axis=-2)) ** 2).sum(axis=-1) for b in moved]
        columns.append((squares[0] - squares[1]) / (2.0 * step))
    inverse = np.linalg.inv(np.stack(columns, axis=-1))
    sides = np.linalg.norm(legs.balls - np.roll(legs.balls, -1, axis=0), axis=-1)
    places = np.abs(states.places).sum(axis=-1)
    return np.abs(inverse).sum(axis=-1).max(axis=-1) * (radii * (sides + places)).max(axis=-1)


@TYPES
@MACHINE
def test_forward_comes_back_from_near_and_from_far(libraries, machine: str, dtype: type) -> None:
    stage, height = stage_and_height(machine)
    library = libraries[dtype].of(stage)
    rows, status = library.inverse(*requests(height, 2_000))
    rows = rows[status == STATUS["OK"]]
    near = np.roll(rows, 1, axis=0)
    small = near + 0.02 * (rows - near)
    for readings, share in ((rows[:, 12:], 0.95), (small[:, 12:], 0.99)):
        states, status = library.forward(readings, near)
        ok = status == STATUS["OK"]
        assert ok.mean() > share
        assert set(status[~ok]) <= {STATUS["UNSAFE"], STATUS["SINGULAR"]}
        expected = spm.forward_physical(stage, rounded(readings[ok], dtype))
        assert expected.exists.all()
        assert errors(stage, states[ok], rows_of(expected)).max() < TOLERANCE[dtype]
    # The result may take the place of the state that it began from.
    assert library.forward(rows[:1, 12:], rows[:1])[1].tolist() == [STATUS["OK"]]


@TYPES
def test_a_tilt_and_its_azimuth_are_those_of_python(libraries, dtype: type) -> None:
    rng = np.random.default_rng(4)
    tilt, azimuth = rng.uniform(0.0, 0.3, 500), rng.uniform(-np.pi, np.pi, 500)
    rows, status = libraries[dtype].of(BALANCER).tilt(tilt, azimuth, np.full(500, 0.11))
    ok = status == STATUS["OK"]
    tilt, azimuth = rounded(tilt, dtype), rounded(azimuth, dtype)
    expected = spm.inverse_physical(BALANCER, 0.11, tilt=tilt, azimuth=azimuth)
    assert ok.sum() > 300
    assert errors(BALANCER, rows[ok], rows_of(expected)[ok]).max() < TOLERANCE[dtype]


@TYPES
@pytest.mark.parametrize("machine", ["RPS", "RRS as built"])
def test_normals_of_any_length_give_the_state_of_the_unit_normal(libraries, machine: str, dtype: type) -> None:
    stage, height = stage_and_height(machine)
    library = libraries[dtype].of(stage)
    normals, heights = requests(height, 300)
    info = np.finfo(dtype)
    for length in (1e-3, 1e-4, 1e-6, 1e-8, 1e-20, 1e3 * info.tiny, 1e20, 0.5 * float(info.max)):
        asked = (length * normals).astype(dtype)
        rows, status = library.inverse(asked, heights)
        units = asked / np.float64(length)
        units /= np.linalg.norm(units, axis=-1, keepdims=True)
        expected = spm.inverse_physical(stage, rounded(heights, dtype), normal=units)
        ok = status == STATUS["OK"]
        assert ok.sum() > 150
        assert errors(stage, rows[ok], rows_of(expected)[ok]).max() < TOLERANCE[dtype]


@TYPES
def test_limits_are_those_of_the_package(libraries, dtype: type) -> None:
    library = libraries[dtype].of(BALANCER)
    normals, heights = requests(0.11, 20_000)
    _, status = library.inverse(normals, heights)
    expected = spm.inverse_physical(BALANCER, heights, normal=normals)
    # Where no reading is within float's rounding of a limit.
    low, high = np.array(BALANCER.limits.minimum), np.array(BALANCER.limits.maximum)
    margin = np.minimum(expected.readings - low, high - expected.readings).min(axis=-1)
    clear = expected.exists & (np.abs(margin) > 1e-4) & (least_slopes(expected) > 0.11) & (status != STATUS["SINGULAR"])
    assert (status[clear] == np.where(margin[clear] > 0.0, STATUS["OK"], STATUS["BEYOND_LIMITS"])).all()
    assert min((status == s).sum() for s in (STATUS["OK"], STATUS["BEYOND_LIMITS"])) > 200
    # Limits are not asked of readings that are measured.
    beyond = expected[np.flatnonzero(clear & (margin < 0.0) & (margin > -0.05))[:50]]
    rows, _ = library.tilt(*np.tile([0.0, 0.0, 0.11], (len(beyond.readings), 1)).T)
    assert (library.forward(beyond.readings, rows)[1] == STATUS["OK"]).all()


@TYPES
def test_states_exactly_at_a_limit_are_within_it(libraries, dtype: type) -> None:
    """Level states with all cranks at a limit of their own."""
    for limit in (-0.8, 0.9):
        stage = spm.Stage(0.08, 0.09, BALANCER.kind, limits=sorted((limit, 0.05)))
        state = spm.forward_physical(stage, [limit] * 3)
        library = libraries[dtype].of(stage)
        assert library.inverse(state.normal[None], [state.height])[1].tolist() == [STATUS["OK"]]


def test_the_first_leg_beyond_its_limits_is_that_of_python(libraries) -> None:
    """At both ends, beside them by less and by more than rounding, without limits, and where a reading is no number."""
    library, rng = libraries[np.float64], np.random.default_rng(1)
    for limits in ((-1.2, 1.4), (-np.inf, 0.05), (-0.3, np.inf), None):
        stage = spm.Stage(0.08, 0.09, BALANCER.kind, limits=limits)
        shares = 1.0 + np.array([0.0, 9e-9, -9e-9, 1.1e-8, -1.1e-8, 1e-3, -1e-3])
        readings = rng.choice(np.append(np.outer([-1.2, 1.4, -0.3, 0.05], shares), 0.0), (5_000, 3))
        excess = np.zeros((5_000, 3)) if stage.limits is None else stage.limits.excess(readings)
        expected = np.where((excess != 0.0).any(axis=-1), (excess != 0.0).argmax(axis=-1) + 1, 0)
        np.testing.assert_array_equal(library.of(stage).beyond_limits(readings), expected)
        assert limits is None or (np.bincount(expected) > 100).all()
    assert library.of(BALANCER).beyond_limits(np.array([[0.0, np.nan, 0.0]])).tolist() == [2]


def test_the_way_through_a_singularity_is_refused(libraries) -> None:
    stage = STAGES["RPS"]
    library = libraries[np.float64].of(stage)
    home, status = library.tilt(*np.array([[0.0], [0.0], [1.1]]))
    assert status.tolist() == [STATUS["OK"]]
    # To negative lengths all three legs go through zero; beyond 0.3 m no triangle holds.
    for readings in ([-1.0, -1.0, -1.0], [0.3, 2.5, 0.3]):
        assert library.forward(np.array([readings]), home)[1].tolist() == [STATUS["UNSAFE"]]


@pytest.mark.parametrize(
    ("machine", "dtype"),
    [("RPS as built", np.float32), ("PRS as built", np.float64), ("RRS as built", np.float32)],
)
def test_no_number_that_is_none_leaves_with_an_ok(libraries, machine: str, dtype: type) -> None:
    """Arguments of any bits, and good ones with one number in them replaced."""
    stage, height = stage_and_height(machine)
    library, rng, count = libraries[dtype].of(stage), np.random.default_rng(2), 2_000
    whole = {np.float32: np.uint32, np.float64: np.uint64}[dtype]
    info = np.finfo(dtype)
    special = [np.nan, np.inf, -np.inf, 0.0, -0.0, info.max, -info.max, info.tiny, 1e-20, -1e-20, 1e10, 1e18, -1e18]
    normals, heights = requests(height, count)
    good, _ = library.inverse(*requests(1.001 * height, count))
    good = good[good[:, 0] != 7.0]
    good = good[rng.integers(len(good), size=count)]

    def spoiled(array: np.ndarray) -> np.ndarray:
        bits = rng.integers(np.iinfo(whole).max, size=array.shape, dtype=whole).view(dtype)
        one = array.astype(dtype)
        one[np.arange(count), rng.integers(array.shape[1], size=count)] = rng.choice(np.array(special, dtype), count)
        return np.where((np.arange(count) % 4 == 0)[:, None], bits, one)

    asked = spoiled(np.column_stack([normals, heights]))
    results = [library.inverse(asked[:, :3], asked[:, 3])]
    readings = good[rng.permutation(count), 12:]
    results += [library.forward(spoiled(readings), good), library.forward(readings, spoiled(good))]
    for rows, status in results:
        assert np.isfinite(rows).all()
        assert (rows[status != STATUS["OK"]] == 7.0).all()
        assert set(status) <= set(STATUS.values())
        rotation = rows[status == STATUS["OK"], :9].reshape(-1, 3, 3)
        gap = rotation @ np.swapaxes(rotation, -1, -2) - np.eye(3)
        assert np.abs(gap).max(initial=0.0) < 100.0 * TOLERANCE[dtype]


def test_errors_are_statuses(libraries) -> None:
    library = libraries[np.float64].of(BALANCER)
    home, _ = library.tilt(*np.array([[0.0], [0.0], [0.11]]))
    assert library.inverse(np.zeros((1, 3)), [0.11])[1].tolist() == [STATUS["BAD_INPUT"]]
    assert library.inverse(np.array([[0.0, 0.0, -1.0]]), [0.11])[1].tolist() == [STATUS["UNREACHABLE"]]
    assert library.inverse(np.array([[0.0, 0.0, 5.0]]), [0.11])[1].tolist() == [STATUS["OK"]]  # of any length
    assert library.inverse(np.array([[0.0, 0.0, 1.0]]), [0.3])[1].tolist() == [STATUS["UNREACHABLE"]]
    torn = home.copy()
    torn[0, 9] += 1e-3
    assert library.forward(home[:, 12:], torn)[1].tolist() == [STATUS["BAD_INPUT"]]
    for turns in (-1e9, -2.0, 2.0):  # more than one is taken for degrees
        assert library.forward(home[:, 12:] + 2.0 * np.pi * turns, home)[1].tolist() == [STATUS["BAD_INPUT"]]
    assert library.forward(home[:, 12:] - 2.0 * np.pi, home)[1].tolist() != [STATUS["BAD_INPUT"]]
    for tilt, azimuth in ((2.0 * np.pi, 0.0), (-20.0, 0.0), (np.nan, 0.0), (0.1, 90.0), (0.1, -7.0), (0.1, np.nan)):
        assert library.tilt([tilt], [azimuth], [0.11])[1].tolist() == [STATUS["BAD_INPUT"]]
    assert library.tilt([0.1], [2.0 * np.pi], [0.11])[1].tolist() == [STATUS["OK"]]


def test_the_test_program_agrees_with_each_compiler_without_a_warning(tmp_path: Path) -> None:
    write_stage_c(stage_and_height("RRS as built")[0], tmp_path)
    for compiler in compilers():
        for kind in ([], ["-DSTAGE_DOUBLE"]):
            compile_c(compiler, *STRICT, *kind, "-O2", tmp_path / "stage_test.c", "-lm", "-o", tmp_path / "program")
            done = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=False)
            assert re.fullmatch(r"270 numbers and statuses compared, 0 wrong \(.*\)\n", done.stdout)
            assert done.returncode == 0
    # The test program can fail.
    source = (tmp_path / "stage_test.c").read_text(encoding="utf-8")
    table = source[source.index("cases[CASES][9]") :]
    number = re.findall(r"STAGE_R\(([-\d.e]+)\)", table)[3]
    (tmp_path / "stage_test.c").write_text(source.replace(number, repr(1.001 * float(number))), encoding="utf-8")
    compile_c(compilers()[0], "-std=c99", tmp_path / "stage_test.c", "-lm", "-o", tmp_path / "program")
    assert subprocess.run([tmp_path / "program"], capture_output=True, check=False).returncode == 1


def arm(*arguments: object) -> None:
    """Compile for a Cortex-M4F; skips where its compiler is not installed."""
    compiler = shutil.which("arm-none-eabi-gcc")
    if compiler is None:
        pytest.skip("needs the system packages gcc-arm-none-eabi and libnewlib-arm-none-eabi")
    compile_c(compiler, *CORTEX, *arguments)


def test_on_a_cortex_m4_it_is_small_and_needs_nothing_but_math(tmp_path: Path) -> None:
    write_stage_c(BALANCER, tmp_path)
    (tmp_path / "use.c").write_text(_USE, encoding="utf-8")
    arm(*STRICT, "-ffreestanding", "-c", tmp_path / "use.c", "-o", tmp_path / "use.o")
    sizes = subprocess.run(["arm-none-eabi-size", tmp_path / "use.o"], capture_output=True, text=True, check=True)
    code, data, bss = map(int, sizes.stdout.splitlines()[1].split()[:3])
    assert (data, bss) == (0, 0)
    assert code < 6_000
    names = subprocess.run(["arm-none-eabi-nm", "-u", tmp_path / "use.o"], capture_output=True, text=True, check=True)
    needed = {name for name in re.findall(r"U (\w+)", names.stdout) if not name.startswith("__aeabi_")}
    assert needed <= {"sqrtf", "sinf", "cosf", "atan2f", "fabsf", "memcpy"}


def test_on_an_emulated_cortex_m4_the_known_answers_agree_and_calls_are_short(tmp_path: Path) -> None:
    if shutil.which("qemu-system-arm") is None:
        pytest.skip("needs the system package qemu-system-arm")
    write_stage_c(BALANCER, tmp_path)
    memory = ("-Wl,--section-start=.vectors=0", "-Wl,-Ttext=0x1000", "-Wl,-Tdata=0x20000000", "-Wl,-ereset")
    link = ("--specs=rdimon.specs", "-nostartfiles", *memory, "-lm")

    def output(program: Path) -> str:
        image = tmp_path / "program.elf"
        arm("-std=gnu99", "-I", tmp_path, BOARD / "start.c", program, *link, "-o", image)
        command = "qemu-system-arm -M mps2-an386 -display none -monitor none -serial none -semihosting -icount shift=0"
        done = subprocess.run(
            [*command.split(), "-kernel", image], capture_output=True, text=True, check=False, timeout=300
        )
        assert done.returncode == 0
        return done.stdout + done.stderr

    assert "270 numbers and statuses compared, 0 wrong" in output(tmp_path / "stage_test.c")
    inverse, forward, longest, *stacks = map(int, output(BOARD / "measure.c").split())
    assert inverse < forward <= longest
    assert longest < 15_000
    assert max(stacks) < 1_500


def test_a_prefix_renames_all_of_it(tmp_path: Path) -> None:
    for prefix, stage in (("math_", STAGES["RPS"]), ("right_", STAGES["RRS"])):
        write_stage_c(stage, tmp_path, prefix=prefix)
    names = [path.name for path in sorted(tmp_path.iterdir())]
    assert names == ["math_stage.h", "math_stage_test.c", "right_stage.h", "right_stage_test.c"]
    header = (tmp_path / "math_stage.h").read_text(encoding="utf-8")
    assert "#ifndef MATH_STAGE_H\n" in header
    assert not re.search(r"\b(stage|STAGE)_", header)
    (tmp_path / "both.c").write_text(_BOTH, encoding="utf-8")
    # The folder is searched for <math.h> before those of the system.
    compile_c(compilers()[0], *STRICT, "-I", tmp_path, tmp_path / "both.c", "-lm", "-o", tmp_path / "both")
    assert subprocess.run([tmp_path / "both"], check=False).returncode == 0
    compile_c(compilers()[0], *STRICT, tmp_path / "math_stage_test.c", "-lm", "-o", tmp_path / "program")
    subprocess.run([tmp_path / "program"], capture_output=True, check=True)
    with pytest.raises(ArgumentError, check=with_fields(argument="prefix")):
        stage_c_sources(BALANCER, prefix="3_")


def test_the_home_is_in_the_middle_of_the_limits_and_a_stage_without_one_is_refused() -> None:
    for stage, readings in (
        (BALANCER, [0.1] * 3),
        (STAGES["PRS"], [0.0] * 3),
        (spm.Stage(0.3, 0.2, limits=(0.4, 0.6)), [0.5] * 3),
    ):
        height = float(re.search(r"STAGE_\w+, 1, STAGE_R\((.*?)\),", stage_c_sources(stage)["stage.h"])[1])
        level = spm.inverse_physical(stage, height, tilt=0.0, azimuth=0.0)
        np.testing.assert_allclose(level.readings, readings, rtol=0.0, atol=1e-12)
    with pytest.raises(UnreachableError, check=with_fields(argument="stage")):
        stage_c_sources(spm.Stage(0.08, 0.09, BALANCER.kind, limits=(3.0, 3.1)))


def test_the_command_writes_it(tmp_path: Path) -> None:
    BALANCER.to_yaml(tmp_path / "stage.yaml")
    done = run("export", "c-stage", "--stage", tmp_path / "stage.yaml", "--out", tmp_path / "board")
    assert done.returncode == 0, done.message
    written = {path.name: path.read_text(encoding="utf-8") for path in (tmp_path / "board").iterdir()}
    assert written == stage_c_sources(BALANCER)
    for arguments, option in (
        (["export", "c-stage", "--out", tmp_path / "board"], "--machine"),
        (["export", "c", "--stage", tmp_path / "stage.yaml", "--out", tmp_path / "board"], "--machine"),
        (["export", "c-stage", "--stage", tmp_path / "stage.yaml"], "--out"),
    ):
        done = run(*arguments)
        assert done.returncode == 2
        assert option in done.message
