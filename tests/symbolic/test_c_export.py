"""The exported C: compiled without a warning, and compared with the kernels it was translated from."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np
import pytest
from cli.running import run
from problems import GEOMETRIES, conditioning
from symbolic.c_library import DRIVER, STRICT, CLibrary, as_states, compile_c, compilers
from symbolic.c_poses import hard_poses, held_states, possible_lengths, spread_poses

import spm_pin as spm
from spm_pin.errors import ArgumentError
from spm_pin.kinematics.kernels import continuation_kernel

EXACT = "-ffp-contract=off"
SANITIZED = ("-O1", "-fsanitize=undefined,address", "-fno-sanitize-recover=all")
CONTRACTED = ("-O3", "-march=native", "-ffp-contract=fast")
FLAGS = {"default": ("-O2",), "exact": ("-O0", EXACT), "contracted": CONTRACTED, "sanitized": SANITIZED}
NOT_PHYSICAL, SINGULAR, NOT_FINITE, NOT_A_ROTATION, BAD_LENGTH, BAD_GEOMETRY, BAD_SEED = 4, 5, -1, -2, -3, -4, -5


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> CLibrary:
    return CLibrary.build(GEOMETRIES["paper"], tmp_path_factory.mktemp("c"), "-O2", EXACT)


def of_geometry(library: CLibrary, name: str) -> CLibrary:
    """The same library, given other dimensions."""
    return CLibrary(library.library, GEOMETRIES[name])


def compare_inverse(library: CLibrary, rotation: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Compare all branches and the physical one to the bit; return which poses have the latter."""
    geometry, pose = library.geometry, spm.pose(position, rotation=rotation)
    branches = spm.inverse_displacement(geometry, pose)
    joints, lengths, discriminants, status = library.inverse(rotation, position)
    np.testing.assert_array_equal(status, branches.status)
    np.testing.assert_array_equal(joints, branches.middle_joints)
    np.testing.assert_array_equal(lengths, branches.leg_lengths)
    np.testing.assert_array_equal(discriminants, branches.discriminants)
    states, status = library.inverse_physical(rotation, position)
    physical = spm.inverse_physical(geometry, pose)
    np.testing.assert_array_equal(states, as_states(physical))
    there = branches.status == spm.Status.OK
    expected = np.where(physical.exists, 0, np.where(there, NOT_PHYSICAL, branches.status))
    np.testing.assert_array_equal(status, expected)
    return np.asarray(physical.exists)


@pytest.mark.parametrize("name", GEOMETRIES)
def test_inverse_displacement_is_that_of_the_kernels_to_the_bit(library: CLibrary, name: str) -> None:
    physical = compare_inverse(of_geometry(library, name), *spread_poses(GEOMETRIES[name], 20000, 1))
    assert physical.sum() > 50
    compare_inverse(of_geometry(library, name), *hard_poses(GEOMETRIES[name], 20000, 2))


def test_hard_poses_have_every_status(library: CLibrary) -> None:
    _, _, _, status = library.inverse(*hard_poses(library.geometry, 20000, 2))
    assert {int(s) for s in status} == {0, 1, 2}
    assert min(np.count_nonzero(status == s) for s in range(3)) > 1000


@pytest.mark.slow
@pytest.mark.parametrize("name", GEOMETRIES)
def test_half_a_million_poses_are_solved_as_by_the_kernels(library: CLibrary, name: str) -> None:
    """Half a million poses of each geometry by default; SPM_PIN_ROUNDS=10 makes it ten million in all."""
    for seed in range(int(os.environ.get("SPM_PIN_ROUNDS", "2"))):
        compare_inverse(of_geometry(library, name), *spread_poses(GEOMETRIES[name], 200000, 100 + 10 * seed))
        compare_inverse(of_geometry(library, name), *hard_poses(GEOMETRIES[name], 50000, 200 + 10 * seed))


def test_contraction_changes_lengths_by_no_more_than_rounding_of_the_pose(tmp_path: Path) -> None:
    contracted = CLibrary.build(GEOMETRIES["paper"], tmp_path, *CONTRACTED)
    state = held_states(contracted.geometry, 5000, 5)
    states, status = contracted.inverse_physical(state.rotation, state.translation)
    expected = spm.inverse_physical(contracted.geometry, state.pose).leg_lengths
    assert (status == 0).all()
    error = np.abs(states[:, 21:] - expected)
    assert (error <= np.finfo(float).eps * conditioning(state)[:, None]).all()
    assert np.median(error / np.spacing(expected)) <= 4.0


@pytest.mark.parametrize("name", GEOMETRIES)
def test_forward_displacement_is_that_of_the_kernels(library: CLibrary, name: str) -> None:
    functions, geometry = of_geometry(library, name), GEOMETRIES[name]
    size = geometry.base_radius + geometry.platform_radius + geometry.middle_side
    anywhere = size * np.random.default_rng(3).uniform(0.02, 2.0, (3000, 6))
    lengths = np.concatenate([possible_lengths(geometry, 3000, 3, 1.0), anywhere])
    lengths[:50] = lengths[:50, :1]
    states, status = functions.forward(lengths)
    expected = spm.forward_physical(geometry, lengths)
    np.testing.assert_array_equal(status, np.where(expected.exists, 0, 1))
    assert 500 < np.count_nonzero(status == 0) < len(lengths)
    np.testing.assert_array_equal(states[:, :21], as_states(expected)[:, :21])
    # Lengths are differences of points, summed in another order.
    np.testing.assert_allclose(states[:, 21:], expected.leg_lengths, rtol=0, atol=4.0 * np.finfo(float).eps * size)


def test_forward_displacement_from_a_seed_follows_the_path_of_the_package(library: CLibrary) -> None:
    geometry = library.geometry
    rng = np.random.default_rng(4)
    seeds = spm.mechanism.Configuration.from_arrays(
        geometry,
        *(
            np.concatenate([getattr(part, field) for part in (held_states(geometry, 300, 6), other)])
            for other in [spm.inverse_displacement(geometry, held_states(geometry, 300, 7).pose)["FF+"]]
            for field in ("rotation", "translation", "middle_joints")
        ),
    )
    seeds = seeds[seeds.exists]
    lengths = seeds.leg_lengths + rng.uniform(-0.15, 0.15, (len(seeds.exists), 6))
    expected = spm.forward_physical(geometry, lengths, near=seeds)
    states, status = library.forward(lengths, as_states(seeds))
    np.testing.assert_array_equal(status, np.where(expected.exists, 0, SINGULAR))
    assert {int(s) for s in status} == {0, SINGULAR}
    found = status == 0
    np.testing.assert_allclose(states[found, :21], as_states(expected)[found, :21], rtol=0, atol=1e-12)


def test_too_many_steps_from_a_seed_are_taken_for_a_singularity(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bound, far above what any path was found to take, is lowered in both languages."""
    geometry = GEOMETRIES["paper"]
    _, source, *_ = spm.symbolic.write_c(geometry, tmp_path)
    text = source.read_text(encoding="utf-8")
    assert text.count("steps > 250000") == 1
    source.write_text(text.replace("steps > 250000", "steps > 3"), encoding="utf-8")
    own = CLibrary.load(geometry, tmp_path, EXACT)
    seeds = held_states(geometry, 200, 6)
    near, far = seeds.leg_lengths + 1e-4, seeds.leg_lengths + 0.1
    assert (own.forward(near, as_states(seeds))[1] == 0).all()
    states, status = own.forward(far, as_states(seeds))
    assert (status == SINGULAR).all()
    assert np.isnan(states).all()
    monkeypatch.setattr(continuation_kernel, "_MOST_STEPS", 3)
    followed, r = continuation_kernel._followed.py_func, geometry.middle_radius
    seed, half_turned = np.empty((1, 4)), np.empty(1, dtype=bool)
    continuation_kernel.stage_states(seeds.middle_joints[:1], r, seed, half_turned)
    start, work, inverse = tuple(seeds.leg_lengths[0, :3] / r), np.empty((4, 8)), np.empty((4, 4))
    for change, arrives in ((1e-4, True), (0.1, False)):
        found = followed(start, (change / r,) * 3, geometry.base_radius / r, tuple(seed[0]), work, inverse)
        assert found[1] == arrives


@pytest.mark.parametrize("name", GEOMETRIES)
def test_jacobians_and_forces_are_those_of_the_kernels_to_the_bit(library: CLibrary, name: str) -> None:
    functions = of_geometry(library, name)
    state = held_states(functions.geometry, 2000, 8)
    matrices, status = functions.inverse_jacobian(as_states(state))
    assert (status == 0).all()
    np.testing.assert_array_equal(matrices, spm.inverse_jacobian(state))
    wrench = np.random.default_rng(9).normal(size=(len(state.exists), 6))
    forces, status = functions.leg_forces(as_states(state), wrench)
    assert (status == 0).all()
    np.testing.assert_array_equal(forces, spm.leg_forces(state, wrench))


def test_singular_states_are_refused(library: CLibrary) -> None:
    geometry = library.geometry
    home = spm.forward_physical(geometry, [[1.3] * 6])  # level: an inverse singularity
    assert library.inverse_jacobian(as_states(home))[1].tolist() == [SINGULAR]
    assert library.leg_forces(as_states(home), np.ones((1, 6)))[1].tolist() == [0]
    r, e = geometry.middle_radius, geometry.base_radius
    # The middle platform in the base's plane: three lower legs in one plane.
    flat = spm.Configuration(
        geometry, spm.pose([[0, 0, 0.8]], xyx=[[0.3, 0.1, 0.0]]), r * geometry.radial_directions[None]
    )
    assert r != e
    found, status = library.leg_forces(as_states(flat), np.ones((1, 6)))
    assert status.tolist() == [SINGULAR]
    assert np.isnan(found).all()
    with pytest.raises(spm.SingularConfigurationError):
        spm.leg_forces(flat, np.ones(6))


def test_errors_are_statuses_and_results_are_nan(library: CLibrary) -> None:
    rotation, position = (x[:1] for x in spread_poses(library.geometry, 10, 1))
    unknown, mirror, sheared = position * np.nan, rotation * [1, 1, -1], rotation + 1e-5 * np.eye(3)
    for bad in ((rotation, unknown), (rotation * np.inf, position)):
        assert library.inverse(*bad)[3].tolist() == [NOT_FINITE]
    for bad in ((mirror, position), (sheared, position), (0.0 * rotation, position)):
        joints, lengths, discriminants, status = library.inverse(*bad)
        assert status.tolist() == [NOT_A_ROTATION]
        assert all(np.isnan(x).all() for x in (joints, lengths, discriminants))
        states, status = library.inverse_physical(*bad)
        assert status.tolist() == [NOT_A_ROTATION]
        assert np.isnan(states).all()
    lengths = np.full((4, 6), 1.3)
    lengths[0, 2], lengths[1, 5], lengths[2, 0], lengths[3, 1] = 0.0, -1.0, np.nan, 1e6
    states, status = library.forward(lengths)
    assert status.tolist() == [BAD_LENGTH, BAD_LENGTH, NOT_FINITE, BAD_LENGTH]
    assert np.isnan(states).all()
    state = as_states(held_states(library.geometry, 1, 1))
    torn = state.copy()
    torn[0, 12] += 1e-3
    assert library.forward(lengths[:1] * 0 + 1.3, torn)[1].tolist() == [BAD_SEED]
    assert library.forward(lengths[:1] * 0 + 1.3, state * np.nan)[1].tolist() == [NOT_FINITE]
    assert library.leg_forces(state, np.full((1, 6), np.inf))[1].tolist() == [NOT_FINITE]


@pytest.mark.parametrize(
    ("low", "high"), [(np.nan, 2.0), (0.5, np.nan), (2.0, 1.0), (1.0, 1.0), (-0.1, 1.0), (np.inf, np.inf)]
)
def test_dimensions_whose_leg_limits_are_no_interval_are_refused(library: CLibrary, low: float, high: float) -> None:
    pose = spread_poses(library.geometry, 10, 1)
    state = as_states(held_states(library.geometry, 10, 1))
    minimum, maximum = np.zeros(6), np.full(6, np.inf)
    minimum[4], maximum[4] = low, high
    machine = np.array([*library.geometry.dimensions, *minimum, *maximum])
    own = CLibrary(library.library, library.geometry, machine)
    for call in (
        lambda: own.inverse(*pose),
        lambda: own.inverse_physical(*pose),
        lambda: own.forward(state[:, 21:]),
        lambda: own.inverse_jacobian(state),
        lambda: own.leg_forces(state, np.ones((len(state), 6))),
    ):
        *results, status = call()
        assert (status == BAD_GEOMETRY).all()
        assert all(np.isnan(x).all() for x in results)


def test_a_rotation_with_rounding_of_single_precision_is_repaired_as_by_the_package(library: CLibrary) -> None:
    state = held_states(library.geometry, 500, 11)
    rounded = state.rotation.astype(np.float32).astype(np.float64)
    states, status = library.inverse_physical(rounded, state.translation)
    expected = spm.inverse_physical(library.geometry, spm.pose(state.translation, rotation=rounded))
    np.testing.assert_array_equal(status == 0, expected.exists)
    assert expected.exists.mean() > 0.9
    away = expected.exists & (np.abs(spm.determinants(state)[..., 2]) > 0.1)
    np.testing.assert_allclose(states[away, 21:], expected.leg_lengths[away], rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("name", "flags"),
    [
        pytest.param(name, flags, id=f"{label}, {name}", marks=pytest.mark.slow if shift else ())
        for shift in range(2)
        for (label, flags), name in zip(FLAGS.items(), np.roll(list(GEOMETRIES), shift).tolist(), strict=True)
    ],
)
def test_the_test_program_builds_without_a_warning_and_finds_all_right(
    name: str, flags: tuple[str, ...], tmp_path: Path
) -> None:
    spm.symbolic.write_c(GEOMETRIES[name], tmp_path, prefix="left_")
    for compiler in compilers():
        compile_c(compiler, *STRICT, *flags, *sorted(tmp_path.glob("*.c")), "-lm", "-o", tmp_path / "program")
        done = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout
        assert "12 poses compared, 0 wrong" in done.stdout


@pytest.mark.parametrize("name", ["paper", pytest.param("wide base", marks=pytest.mark.slow)])
def test_sanitizers_find_nothing_in_ten_thousand_poses(name: str, tmp_path: Path) -> None:
    """All functions, for hard poses, poses anywhere, lengths anywhere and arguments that are none."""
    geometry = GEOMETRIES[name]
    parts = [hard_poses(geometry, 6000, 3), spread_poses(geometry, 6000, 4)]
    rotation, position = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    branches = spm.inverse_displacement(geometry, spm.pose(position, rotation=rotation))
    size, rng = geometry.base_radius + geometry.platform_radius + geometry.middle_side, np.random.default_rng(5)
    lengths = size * rng.uniform(0.02, 2.0, (len(position), 6))
    lengths[::2] = possible_lengths(geometry, len(lengths[::2]), 6, 1.0)
    rotation[-3:], position[-5:-3], lengths[-2:] = [[[np.nan]], [[1e200]], [[2.0]]], np.inf, [[np.nan], [-1.0]]
    numbers = np.concatenate([rotation.reshape(-1, 9), position, lengths], axis=-1)
    numbers.tofile(tmp_path / "numbers")
    spm.symbolic.write_c(geometry, tmp_path)
    (tmp_path / "driver.c").write_text(DRIVER, encoding="utf-8")
    sources = tmp_path / "driver.c", tmp_path / "spm_kinematics.c"
    for compiler in compilers():
        compile_c(compiler, *STRICT, *SANITIZED, *sources, "-lm", "-o", tmp_path / "program")
        command = [tmp_path / "program", tmp_path / "numbers", tmp_path / "status"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        status = np.fromfile(tmp_path / "status", np.int32).reshape(-1, 6)
        assert len(status) > 10_000
        np.testing.assert_array_equal(status[:-5, 0], branches.status[:-5])
        assert set(status[-5:, 0]) == {NOT_FINITE, NOT_A_ROTATION}
        assert set(status[-2:, 2]) == {NOT_FINITE, BAD_LENGTH}
        # Forward, from a seed, J_f and forces: found and not.
        assert all((status[:, k] == 0).sum() > 100 and (status[:, k] != 0).sum() > 100 for k in range(2, 6))


def test_no_function_needs_more_than_eight_kilobytes_of_stack(tmp_path: Path) -> None:
    """Along every chain of calls, as gcc lists them; the mathematics library is not in the list."""
    compiler = shutil.which("gcc")
    if compiler is None:
        pytest.skip("no gcc, which lists the stack of functions")
    _, source, *_ = spm.symbolic.write_c(GEOMETRIES["paper"], tmp_path)
    compile_c(compiler, "-std=c99", "-O2", "-fcallgraph-info=su", "-c", source, "-o", tmp_path / "object.o")
    graph = (tmp_path / "object.ci").read_text(encoding="utf-8")
    nodes = re.findall(
        r'^node: \{ title: "([^"]+)" label: "[^"]*\\n(\d+) bytes \(([a-z,]+)\)', graph, flags=re.MULTILINE
    )
    assert {kind for *_, kind in nodes} <= {"static", "dynamic,bounded"}
    own = {name: int(size) for name, size, _ in nodes}
    calls: dict[str, set[str]] = {name: set() for name in own}
    for caller, callee in re.findall(
        r'^edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', graph, flags=re.MULTILINE
    ):
        calls[caller] |= {callee} & own.keys()
    # A recursion would be a cycle.
    total: dict[str, int] = {}
    for name in TopologicalSorter(calls).static_order():
        total[name] = own[name] + max((total[callee] for callee in calls[name]), default=0)
    functions = {name: total[name] for name in total if name.startswith("spm_")}
    assert len(functions) == 6
    assert 2000 < max(functions.values()) <= 8192, functions


@pytest.mark.parametrize("sizes", [(1e-9, 1e9, 1.0), (1.0, 1.001e3, 1.0), (1.0, 1.0, 0.999e-3)])
def test_dimensions_too_far_apart_are_refused(sizes: tuple[float, float, float], tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="geometry: expected dimensions within a factor of 1000"):
        spm.symbolic.write_c(spm.Geometry(*sizes), tmp_path / "c")
    assert not (tmp_path / "c").exists()


@pytest.mark.parametrize("sizes", [(1e3, 1.0, 1.0), (1.0, 1e3, 1.0), (1.0, 1.0, 1e3), (1.0, 1e-3, 1e-3)])
def test_the_test_program_finds_all_right_with_dimensions_a_thousandfold_apart(
    sizes: tuple[float, float, float], tmp_path: Path
) -> None:
    spm.symbolic.write_c(spm.Geometry(*sizes), tmp_path)
    compile_c(compilers()[0], "-O0", *tmp_path.glob("*.c"), "-lm", "-o", tmp_path / "program")
    done = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


def test_the_test_program_finds_a_wrong_answer(tmp_path: Path) -> None:
    header, source, test, _ = spm.symbolic.write_c(GEOMETRIES["paper"], tmp_path)
    text = source.read_text(encoding="utf-8")
    assert "    0.6928203230275509," in text
    source.write_text(text.replace("    0.6928203230275509,", "    0.6928203230276,"), encoding="utf-8")
    compile_c(compilers()[0], source, test, "-lm", "-o", tmp_path / "program")
    assert header.exists()
    done = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, "1e-13 m is within the tolerance"
    source.write_text(text.replace("    0.6928203230275509,", "    0.6928203240275509,"), encoding="utf-8")
    compile_c(compilers()[0], source, test, "-lm", "-o", tmp_path / "program")
    done = subprocess.run([tmp_path / "program"], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "wrong: TT+ of case 0" in done.stdout


def test_nothing_is_allocated_and_only_mathematics_is_called(tmp_path: Path) -> None:
    _, source, *_ = spm.symbolic.write_c(GEOMETRIES["paper"], tmp_path)
    compile_c(compilers()[0], "-O2", "-c", source, "-o", tmp_path / "object.o")
    tool = shutil.which("nm")
    if tool is None:
        pytest.skip("no nm, of the binutils that come with a compiler")
    listed = subprocess.run([tool, "-u", tmp_path / "object.o"], capture_output=True, text=True, check=True).stdout
    called = {line.split()[-1] for line in listed.splitlines()} - {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
    assert called <= {"atan2", "fmod", "hypot", "pow", "rint", "sqrt", "fmax", "memcpy", "memmove", "memset"}


def test_the_command_writes_the_four_files(tmp_path: Path) -> None:
    done = run("export", "c", "--out", tmp_path / "c", "--prefix", "arm_")
    assert done.returncode == 0, done.message
    names = {"arm_kinematics.h", "arm_kinematics.c", "arm_kinematics_test.c", "CMakeLists.txt"}
    assert {path.name for path in (tmp_path / "c").iterdir()} == names
    header = (tmp_path / "c" / "arm_kinematics.h").read_text(encoding="utf-8")
    assert f"Generated by spm_pin {spm.__version__} for Geometry(base_radius=0.69282," in header
    assert "@" not in header
    assert run("export", "--format", "c", "--out", tmp_path / "c").returncode == 0


def test_bad_arguments_are_clear_errors_and_nothing_is_written(tmp_path: Path) -> None:
    as_built = tmp_path / "as_built.yaml"
    GEOMETRIES["paper"].to_yaml(as_built)
    out, file = tmp_path / "c", tmp_path / "file"
    file.write_text("mine", encoding="utf-8")
    for arguments, words in (
        (["--out", out, "--prefix", "1st"], "--prefix: expected letters, digits and underscores"),
        (["--out", out, "--prefix", ""], "--prefix: expected letters, digits and underscores"),
        (["--out", ""], "got an empty name"),
        (["--out", out, "--prefix", "a-b"], "--prefix: expected letters, digits and underscores"),
        (["--out", out, "--geometry", as_built], "a machine as built"),
        (["--out", out, "--geometry", tmp_path / "none.yaml"], "expected a readable YAML file"),
        (["--out", out / "deep" / "er"], "--out: expected a directory that can be written"),
        (["--out", file], "--out: expected a directory that can be written"),
        (["--out", out, "--urdf", "x.urdf"], "--urdf: expected to be left out with --format c"),
        ([], "--out: expected the directory to write into"),
    ):
        done = run("export", "c", *arguments)
        assert done.returncode == 2
        assert words in done.message
        assert not out.exists()
    assert file.read_text(encoding="utf-8") == "mine"
    with pytest.raises(ArgumentError, match=r"directory: .*got an empty name"):
        spm.symbolic.write_c(GEOMETRIES["paper"], "")
    with pytest.raises(ArgumentError, match="geometry: expected a Geometry, got a machine as built"):
        spm.symbolic.c_sources(GEOMETRIES["paper"].perturbed(1))


def test_a_directory_is_left_as_it_was_where_not_all_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "spm_kinematics_test.c").mkdir()
    with pytest.raises(ArgumentError, match="directory: expected a directory that can be written"):
        spm.symbolic.write_c(GEOMETRIES["paper"], tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["spm_kinematics_test.c"]


def test_the_call_in_the_how_to_compiles(tmp_path: Path) -> None:
    spm.symbolic.write_c(GEOMETRIES["paper"], tmp_path)
    page = (Path(__file__).parents[2] / "docs/howto/controller.md").read_text(encoding="utf-8")
    (block,) = re.findall(r"^```c\n(.*?)^```", page, flags=re.MULTILINE | re.DOTALL)
    include, body = block.split("\n", 1)
    stubs = "static void stop(const char *why) { (void)why; }\nstatic void command(const double *q) { (void)q; }\n"
    head = "void call(const double *rotation, const double *position);\nvoid call(const double *rotation, "
    text = f"{include}\n{stubs}{head}const double *position)\n{{{body}}}\n"
    (tmp_path / "call.c").write_text(text, encoding="utf-8")
    compile_c(compilers()[0], *STRICT, "-fsyntax-only", tmp_path / "call.c")


def test_the_test_program_prints_what_the_how_to_shows(tmp_path: Path) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no cc")
    spm.symbolic.write_c(GEOMETRIES["paper"], tmp_path / "spm_c")
    page = (Path(__file__).parents[2] / "docs/howto/controller.md").read_text(encoding="utf-8")
    command, shown = re.search(r"^\$ (cc .*\n)(.*compared.*\n)", page, flags=re.MULTILINE).groups()
    done = subprocess.run(["sh", "-ec", command], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == shown


def test_it_builds_with_cmake(tmp_path: Path) -> None:
    tool = shutil.which("cmake")
    if tool is None:
        pytest.skip("no cmake")
    spm.symbolic.write_c(GEOMETRIES["paper"], tmp_path)
    for step in (["-S", tmp_path, "-B", tmp_path / "build"], ["--build", tmp_path / "build"]):
        done = subprocess.run([tool, *step], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
    assert subprocess.run([tmp_path / "build" / "spm_kinematics_test"], check=False).returncode == 0
