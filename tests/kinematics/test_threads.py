"""Batches divided among threads: equal results, only where requested, without lasting effects."""

from __future__ import annotations

import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import dask
import numpy as np
import pytest
from problems import as_built, in_leg_space

import spm_pin as spm
from spm_pin.kinematics.batches import parallel_for, set_threads, threads
from spm_pin.kinematics.inverse_displacement import branch_lengths
from spm_pin.kinematics.singularity_analysis import determinants

PAPER = spm.Geometry.paper()


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


@pytest.mark.parametrize("count", [0, -1, 1.5, True, "2"])
def test_text_that_is_no_number_is_refused(count: object) -> None:
    with pytest.raises(spm.ArgumentError, match="positive number of threads"):
        set_threads(count)  # type: ignore[arg-type]
    with pytest.raises(spm.ArgumentError, match="positive number of threads"), threads(count):  # type: ignore[arg-type]
        pass


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
    pose, built = in_leg_space(PAPER, 40_001, seed=1).pose, as_built(PAPER, 1e-3, seed=4)
    answers = []
    for count in (1, 2, 3):
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
            answers.append([*found, determinants(states), forward.middle_joints, modes.translation, roots])
    for other in answers[1:]:
        for expected, answer in zip(answers[0], other, strict=True):
            np.testing.assert_array_equal(expected, answer)
    np.testing.assert_array_equal(answers[0][1], answers[0][4])


FORK = """
import os, numpy as np, spm_pin as spm
from spm_pin.kinematics.inverse_displacement import branch_lengths
from spm_pin.kinematics.batches import set_threads
set_threads(2)
pose = np.repeat(spm.pose([0.6889, 0.4963, 2.253], xyx=[-0.19, 0.57, -0.22]).as_matrix()[None], 40000, axis=0)
before = branch_lengths(spm.Geometry.paper(), pose)[0]
child = os.fork()
after = branch_lengths(spm.Geometry.paper(), pose)[0]
same = np.array_equal(before, after, equal_nan=True)
if not child:
    os._exit(0 if same else 1)
assert same and os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
"""


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="this system cannot fork")
def test_a_forked_child_goes_on() -> None:
    subprocess.run([sys.executable, "-c", FORK], check=True, timeout=120)
