"""A batch has the answers of its members, takes the memory of its answer, and is divided among threads if requested."""

from __future__ import annotations

import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import dask
import numpy as np
import pytest
from error_fields import with_fields
from problems import PAPER, as_built, in_leg_space, random_branches

import spm_pin as spm
from spm_pin.kinematics import complex_middle_joints, platform_jacobian, principal_stiffness
from spm_pin.kinematics.batches import parallel_for, set_threads, threads
from spm_pin.kinematics.inverse_displacement import branch_lengths

SHAPES = [(), (0,), (3, 1, 2)]
EPS = np.finfo(float).eps

OF_BRANCHES = "middle_joints rotation translation leg_lengths exists is_physical ambiguous count residual status"
OF_BRANCHES += " discriminants merged"
OF_MODES = "middle_joints rotation translation exists status"
OF_SINGULARITIES = "determinants scaled_determinants sigma condition rank kind mobility gained_twist inner_twist"
OF_SINGULARITIES += " lost_wrench"
OF_A_STATE: dict[str, Callable[..., np.ndarray]] = {
    "inverse_jacobian": lambda state, vector: spm.inverse_jacobian(state),
    "platform_jacobian": lambda state, vector: platform_jacobian(state),
    "leg_rates": spm.leg_rates,
    "leg_forces": spm.leg_forces,
    "determinant_gradients": lambda state, vector: spm.kinematics.determinant_gradients(state),
    "compliance": lambda state, vector: spm.kinematics.compliance(state, 1e7),
    "error_jacobian": lambda state, vector: spm.calibration.error_jacobian(state),
    "stiffness": lambda state, vector: spm.stiffness(state, 1e7),
    "principal_stiffness": lambda state, vector: principal_stiffness(state, 1e7).translational,
}


def answers(machine: spm.Manipulator, pose: np.ndarray, readings: np.ndarray, vector: np.ndarray) -> dict[str, object]:
    """Return what the functions answer."""
    branches, state = spm.inverse_displacement(machine, pose), spm.forward_physical(machine, readings)
    found = {name: getattr(branches, name) for name in OF_BRANCHES.split()}
    found["complex_middle_joints"] = complex_middle_joints(machine, pose)
    physical = spm.inverse_physical(machine, pose)
    found |= {"physical joints": physical.middle_joints, "physical lengths": physical.leg_lengths}
    found |= {"forward joints": state.middle_joints, "forward translation": state.translation}
    for name, call in OF_A_STATE.items():
        if state.shape or state.exists:
            found[name] = call(state, vector)
        else:
            with pytest.raises(spm.ArgumentError, check=with_fields(argument="configuration")):
                call(state, vector)
    found |= {name: getattr(spm.singularities(state), name) for name in OF_SINGULARITIES.split()}
    if machine.is_nominal:
        modes = spm.forward_displacement(machine, readings)
        found |= {f"mode {name}": getattr(modes, name) for name in OF_MODES.split()}
    found["lengths alone"], found["status alone"] = branch_lengths(machine, pose)
    np.testing.assert_array_equal(found["lengths alone"], branches.leg_lengths)
    np.testing.assert_array_equal(found["status alone"], branches.status)
    return {name: value for name, value in found.items() if value is not None}


@pytest.mark.parametrize("machine", [PAPER, as_built(PAPER, 1e-3)], ids=["drawn", "as built"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_batch_is_its_members(shape: tuple[int, ...], machine: spm.Manipulator) -> None:
    rng, count = np.random.default_rng(1), int(np.prod(shape))
    poses = random_branches(PAPER, "TF", count, seed=6).pose.as_matrix()
    # A degenerate pose, one out of reach, and readings that no mode has.
    poses[1:2] = spm.pose([0, 0, 2], rotation=np.eye(3)).as_matrix()
    poses[3:4] = spm.pose([9, 9, 2], rotation=np.diag([1.0, -1, -1])).as_matrix()
    readings, vector = rng.uniform(1.15, 1.45, (count, 6)), rng.normal(size=(*shape, 6))
    readings[1:2] = [0.3, 1.2, 3.0, 1.2, 1.2, 1.2]
    poses, readings = poses.reshape(*shape, 4, 4), readings.reshape(*shape, 6)
    together = answers(machine, poses, readings, vector)
    lengths = np.array([1.25, 1.15, 1.40, 1.30, 1.20, 1.40])
    single = answers(machine, random_branches(PAPER, "TF", 1, seed=6).pose.as_matrix()[0], lengths, np.ones(6))
    assert {name: np.shape(x) for name, x in together.items()} == {n: shape + np.shape(x) for n, x in single.items()}
    if count > 3 and machine.is_nominal:
        status = np.ravel(together["status"])
        assert list(status[[1, 3]]) == [spm.Status.DEGENERATE, spm.Status.UNREACHABLE]
    for index in np.ndindex(shape):
        for name, alone in answers(machine, poses[index], readings[index], vector[index]).items():
            values = np.asarray(together[name])[index]
            if name in OF_A_STATE or name in OF_SINGULARITIES.split():
                np.testing.assert_allclose(alone, values, rtol=1e-12, atol=1e-14, err_msg=name)
            else:
                np.testing.assert_array_equal(alone, values, err_msg=name)
    exists = spm.forward_physical(machine, readings).exists
    assert count < 2 or not exists.all()
    for name in (*OF_A_STATE, "determinants", "sigma", "lost_wrench"):
        values = together[name]
        finite = np.isfinite(values).all(axis=tuple(range(len(shape), np.ndim(values))))
        np.testing.assert_array_equal(finite & exists if name == "lost_wrench" else finite, exists, err_msg=name)
    assert (np.asarray(together["rank"])[~exists] == 0).all()
    assert (np.asarray(together["kind"])[~exists] == spm.kinematics.SingularityKind.REGULAR).all()
    assert np.isnan(np.asarray(together["lost_wrench"])[~exists]).all()


@pytest.mark.parametrize("machine", [PAPER, as_built(PAPER, 1e-3)], ids=["drawn", "as built"])
def test_a_batch_of_seeds_is_its_members(machine: spm.Manipulator) -> None:
    lengths = np.random.default_rng(2).uniform(1.15, 1.45, (3, 1, 2, 6))
    start, target = spm.forward_physical(machine, lengths), lengths[..., ::-1]
    end = spm.forward_physical(machine, target, near=start)
    for index in np.ndindex(end.shape):
        alone = spm.forward_physical(machine, target[index], near=start[index])
        np.testing.assert_allclose(alone.middle_joints, end.middle_joints[index], rtol=0, atol=1e-15)
    home = spm.forward_physical(machine, [1.3] * 6)
    assert spm.forward_physical(machine, target, near=home).shape == end.shape == (3, 1, 2)


@pytest.mark.parametrize("length", [4000, 4567])
def test_a_large_batch_is_its_parts(length: int) -> None:
    """Kernels fetch the memory of large batches ahead of writing it, beyond the end as well."""
    pose = random_branches(PAPER, "TT", length, seed=8).pose
    whole, lengths = spm.inverse_displacement(PAPER, pose), branch_lengths(PAPER, pose)[0]
    np.testing.assert_array_equal(lengths, whole.leg_lengths)
    readings = np.random.default_rng(3).uniform(1.1, 1.5, (length, 6))
    forward = spm.forward_physical(PAPER, readings)
    for first in range(0, length, 500):
        part = slice(first, min(first + 500, length))
        branches = spm.inverse_displacement(PAPER, pose[part])
        for name in ("middle_joints", "leg_lengths", "discriminants", "exists", "status", "residual"):
            np.testing.assert_array_equal(getattr(branches, name), getattr(whole, name)[part], err_msg=name)
        alone = spm.forward_physical(PAPER, readings[part])
        np.testing.assert_array_equal(alone.middle_joints, forward.middle_joints[part])


@pytest.mark.parametrize("function", [spm.leg_rates, spm.leg_forces])
def test_leading_axes_broadcast(function: object) -> None:
    states = in_leg_space(PAPER, 3, seed=41).configuration
    vectors = np.random.default_rng(5).normal(size=(4, 1, 6))
    found = function(states, vectors)  # type: ignore[operator]
    assert found.shape == (4, 3, 6)
    np.testing.assert_array_equal(found[2, 1], function(states[1], vectors[2, 0]))  # type: ignore[operator]
    with pytest.raises(spm.ArgumentError, check=lambda error: error.argument in ("twist", "wrench")):
        function(states, np.zeros((2, 6)))  # type: ignore[operator]


def test_one_rough_rotation_is_repaired_and_the_others_keep_their_bits() -> None:
    index = 17
    exact = random_branches(PAPER, "TT", 41, seed=6).pose.as_matrix()
    rough = exact.copy()
    rough[index, :3, :3] = rough[index, :3, :3].astype(np.float32)
    before, after = spm.inverse_displacement(PAPER, exact), spm.inverse_displacement(PAPER, rough)
    others = np.arange(41) != index
    np.testing.assert_array_equal(before.middle_joints[others], after.middle_joints[others])
    alone = spm.inverse_displacement(PAPER, rough[index])
    np.testing.assert_array_equal(alone.middle_joints, after.middle_joints[index])
    assert np.abs(after.rotation[index] @ after.rotation[index][0].T - np.eye(3)).max() < 4 * EPS
    np.testing.assert_array_equal(rough[others], exact[others])


def peak_of(call: Callable[[], object]) -> tuple[object, int]:
    call()
    tracemalloc.start()
    try:
        result = call()
        return result, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("count", [1, 2])
def test_a_batch_takes_the_memory_of_its_answer(count: int) -> None:
    pose, n = np.tile(in_leg_space(PAPER, 5_000, seed=7).pose.as_matrix(), (10, 1, 1)), 50_000
    with threads(count):
        solutions, peak = peak_of(lambda: spm.inverse_displacement(PAPER, pose))
        assert isinstance(solutions, spm.SolutionSet)
        # b, lengths, discriminants, the pose, the status, the flags; degeneracies are zeros never touched.
        assert peak <= 1.02 * n * 8 * (72 + 48 + 4 + 16 + 4)
        (lengths, _), peak = peak_of(lambda: branch_lengths(PAPER, pose))
        assert peak <= 1.02 * n * 8 * (48 + 3)
        _, peak = peak_of(lambda: spm.forward_physical(PAPER, lengths[:, 0]))
        # One stage after the other: while the upper one is solved, its lengths and balls beside the answer.
        assert peak <= 1.05 * n * 8 * (9 + 3 + 9 + 6 + 3 + 9)
        states = solutions.configurations
        matrices, peak = peak_of(lambda: spm.inverse_jacobian(states))
        assert isinstance(matrices, np.ndarray)
        assert peak <= 1.02 * (matrices.nbytes + 8 * n)


# --- Threads ---------------------------------------------------------------------------------------------------------


@pytest.fixture(autouse=True)
def bare_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SPM_PIN_THREADS", raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1, 2}, raising=False)
    monkeypatch.setattr("os.cpu_count", lambda: 3)


def used(size: int = 300, min_batch: int = 100) -> int:
    """Return how many threads may be at work at once, seen from how finely a batch is cut."""
    parts: list[slice] = []
    lock = threading.Lock()

    def work(part: slice) -> None:
        with lock:
            parts.append(part)

    parallel_for(work, size, min_batch)
    covered = sorted(k for part in parts for k in range(part.start, part.stop))
    assert covered == list(range(size))
    return 1 if len(parts) == 1 else len(parts) // 4


def test_a_large_batch_is_shared_and_a_small_one_is_not() -> None:
    assert used(299, 100) == 2
    assert used(10_000, 100) == 3
    assert used(199, 100) == used(1, 100) == used(0, 100) == 1


def test_sources_of_the_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2,1")
    assert used() == 2
    monkeypatch.setenv("SPM_PIN_THREADS", "1")
    assert used() == 1
    set_threads(3)
    try:
        assert used() == 3
        with threads(2):
            assert used() == 2
            with threads(None):
                assert used() == 3
        assert used() == 3
    finally:
        set_threads(None)
    assert used() == 1
    for nonsense in ("many", "²", "-1", "0", ""):
        monkeypatch.setenv("SPM_PIN_THREADS", nonsense)
        assert used() == 2


@pytest.mark.parametrize("count", [0, 1.5, True, "2"])
def test_what_is_no_number_of_threads_is_refused(count: object) -> None:
    for use in (set_threads, lambda count: threads(count).__enter__()):
        with pytest.raises(spm.ArgumentError, check=with_fields(argument="count")):
            use(count)  # type: ignore[operator]


def test_workers_compute_by_themselves() -> None:
    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(used).result() == 1
    assert dask.compute(dask.delayed(used)(), scheduler="threads") == (1,)

    def asked_for() -> int:
        with threads(2):
            return used()

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(asked_for).result() == 2


def test_error_in_a_thread_is_raised_by_the_caller() -> None:
    def fail(part: slice) -> None:
        if part.start > 0:
            raise RuntimeError("from a thread")

    with pytest.raises(RuntimeError, match="from a thread"):
        parallel_for(fail, 1000, 10)


def test_the_answer_does_not_depend_on_the_number_of_threads() -> None:
    pose, built = in_leg_space(PAPER, 20_001, seed=1).pose, as_built(PAPER, 1e-3, seed=4)
    answers = []
    for count in (1, 3):
        with threads(count):
            solutions = spm.inverse_displacement(PAPER, pose)
            lengths, status = branch_lengths(PAPER, pose)
            states = solutions.configurations
            forward = spm.forward_physical(PAPER, lengths[:, 0])
            forces = spm.leg_forces(states, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
            modes = spm.forward_displacement(PAPER, lengths[:520, 0])
            roots = spm.kinematics.complex_middle_joints(PAPER, pose[:4001])
            found = [solutions.middle_joints, solutions.leg_lengths, solutions.discriminants, solutions.status]
            found += [lengths, status, spm.inverse_jacobian(states), spm.kinematics.platform_jacobian(states), forces]
            found += [spm.inverse_displacement(built, pose[:1500]).middle_joints]
            answers.append([*found, spm.determinants(states), forward.middle_joints, modes.translation, roots])
    for expected, answer in zip(*answers, strict=True):
        np.testing.assert_array_equal(expected, answer)
    np.testing.assert_array_equal(answers[0][1], answers[0][4])


FORK = """
import os, numpy as np, spm_pin as spm
from spm_pin.kinematics.inverse_displacement import branch_lengths
from spm_pin.kinematics.batches import set_threads
set_threads(2)
pose = np.repeat(spm.pose([0.6889, 0.4963, 2.253], xyx=[-0.19, 0.57, -0.22]).as_matrix()[None], 40000, axis=0)
before = branch_lengths(spm.Manipulator.paper(), pose)[0]
child = os.fork()
after = branch_lengths(spm.Manipulator.paper(), pose)[0]
same = np.array_equal(before, after, equal_nan=True)
if not child:
    os._exit(0 if same else 1)
assert same and os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="this system cannot fork")
def test_a_forked_child_goes_on() -> None:
    subprocess.run([sys.executable, "-c", FORK], check=True, timeout=500)
