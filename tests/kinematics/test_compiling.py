"""Compiled kernels: vector instructions, IEEE arithmetic, and a cache whose failures have no effect."""

from __future__ import annotations

import multiprocessing
import os
import pkgutil
import platform
import re
import shutil
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba.core.errors import TypingError

import spm_pin as spm
from spm_pin.kinematics import kernels
from spm_pin.kinematics.kernels.ball_circles import circle_centres
from spm_pin.kinematics.kernels.branch_kernels import all_branches
from spm_pin.kinematics.kernels.compilation import Kernel, expecting, is_worth_compiling
from spm_pin.kinematics.kernels.one_stage import poses_of_stages
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.support.compiling import ENVIRONMENT

PAPER = spm.Manipulator.paper()


def all_kernels() -> list[Kernel]:
    modules = [import_module(x.name) for x in pkgutil.iter_modules(kernels.__path__, f"{kernels.__name__}.")]
    return list({x.py_func: x for module in modules for x in vars(module).values() if type(x) is Kernel}.values())


# Square roots of several numbers at once, and products and sums contracted into one instruction.
PACKED, CONTRACTED = {
    "x86_64": (r"\bv?sqrtpd\b", r"\bvfn?m(add|sub)"),
    "AMD64": (r"\bv?sqrtpd\b", r"\bvfn?m(add|sub)"),
    "aarch64": (r"\bfsqrt\s+v\d+\.2d", r"\bfn?m(add|sub|la|ls)\b"),
    "arm64": (r"\bfsqrt[.\s].*2d", r"\bfn?m(add|sub|la|ls)\b"),
}[platform.machine()]


@pytest.mark.parametrize("kernel", [poses_of_stages, pytest.param(all_branches, marks=pytest.mark.slow)])
def test_several_problems_share_a_vector_register(kernel: Kernel) -> None:
    compiled: Any = kernel.dispatcher(cache=False)
    assembly = "".join(compiled.inspect_asm().values())
    assert re.search(PACKED, assembly)
    assert not re.search(CONTRACTED, assembly)


# --- The interpreter ----------------------------------------------------------------------------------------------


def use_machine(machine: spm.Manipulator, readings: Any) -> None:
    """Call what has a kernel."""
    state = spm.forward_physical(machine, readings)
    spm.forward_physical(machine, readings + 1e-3, near=state)
    spm.forward_displacement(machine, readings)
    branches = spm.inverse_displacement(machine, state.pose)
    spm.inverse_physical(machine, state.pose)
    spm.kinematics.complex_middle_joints(machine, state.pose)
    for function in (spm.inverse_jacobian, spm.kinematics.platform_jacobian, spm.determinants, spm.singularities):
        function(branches.configurations)
    spm.leg_forces(state, np.arange(6.0))


def use_stage(stage: spm.Stage) -> None:
    """Call what has a kernel of its own for a stage."""
    height = spm.workspace.home_height(stage)
    states = spm.inverse_physical(stage, height, tilt=[0.0, 0.02, 0.05], azimuth=0.3)
    assert states.exists.all()
    spm.forward_displacement(stage, states.readings[2])
    spm.forward_physical(stage, states.readings)


def test_every_kernel_computes_the_same_bits_in_the_interpreter(monkeypatch: pytest.MonkeyPatch) -> None:
    called = set()

    def run_both(self: Kernel, *args: Any) -> Any:
        copies = [x.copy() if isinstance(x, np.ndarray) else np.float64(x) if type(x) is float else x for x in args]
        result = self.compile()(*args)
        # A large batch says nothing more, and takes long.
        if len(args[-1] if isinstance(args[-1], np.ndarray) else args[0]) <= 50:
            called.add(self.py_func)
            with np.errstate(all="ignore"):
                assert self.py_func(*copies) == result
            arrays = [pair for pair in zip(copies, args, strict=True) if isinstance(pair[0], np.ndarray)]
            for interpreted, compiled in arrays:
                np.testing.assert_array_equal(interpreted, compiled, err_msg=self.py_func.__name__)
        return result

    monkeypatch.setattr(Kernel, "__call__", run_both)
    readings = np.random.default_rng(0).uniform(1.1, 1.5, (3, 6))
    for machine in (PAPER, PAPER.perturbed(0, length=1e-3, angle=1e-3)):
        use_machine(machine, readings)
    for kind in (spm.RPS(), spm.PRS(rod=0.5), spm.RRS(crank=0.2, rod=0.4)):
        drawn = spm.Stage(0.6, 0.5, legs=kind)
        use_stage(drawn.perturbed(0) if kind.unit == "rad" else drawn)
    spm.kinematics.singular_values(np.sqrt(np.arange(36.0).reshape(6, 6)))
    spm.workspace.reachable_position(PAPER, [[0.5, 0.2, 2.1]])
    spm.workspace.nearest_reachable_pose(PAPER, spm.pose([0.5, 0.2, 2.1], xyx=[0.0, 0.2, 0.0]))
    assert called == {kernel.py_func for kernel in all_kernels()}


def test_little_work_is_interpreted_and_much_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(ENVIRONMENT, raising=False)
    # Milliseconds, a large batch, many calls of a fast kernel and of a slow one, a single call that takes long.
    work = (1, 1e-3), (10_000, 10.0), (1_000, 0.05), (1_000, 0.2), (40, 1.0), (60, 1.2), (1, 2.0)
    expected = [False, True, False, True, False, True, True]
    assert [is_worth_compiling(*x) for x in work] == expected
    with expecting(1_000_000):
        assert is_worth_compiling(1, 1e-3)
    with expecting(10):
        assert not is_worth_compiling(1, 1e-3)
    for forced in ("compiled", "interpreted"):
        monkeypatch.setenv(ENVIRONMENT, forced)
        assert {is_worth_compiling(*x) for x in work} == {forced == "compiled"}
    monkeypatch.setenv(ENVIRONMENT, "compile")
    with pytest.raises(spm.ArgumentError) as error:
        is_worth_compiling(1, 0.0)
    assert error.value.argument == ENVIRONMENT


FIRST = """
import sys, warnings, numpy as np, spm_pin as spm
warnings.simplefilter("error")
paper = spm.Manipulator.paper()
for machine in (paper, paper.perturbed(0)):
    state = spm.forward_physical(machine, [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    spm.forward_displacement(machine, state.readings)
    spm.inverse_displacement(machine, state.pose)
    spm.leg_forces(state, np.ones(6)), spm.inverse_jacobian(state), spm.singularities(state)
stage = spm.Stage(0.5, 0.3)
spm.forward_displacement(stage, spm.inverse_physical(stage, 0.6, tilt=0.1, azimuth=0.0).readings)
print("numba" in sys.modules)
"""


def test_first_answers_need_no_compiler_and_give_no_warnings() -> None:
    kept = {key: value for key, value in os.environ.items() if key != ENVIRONMENT}
    done = subprocess.run([sys.executable, "-c", FIRST], check=True, env=kept, text=True, capture_output=True)
    assert (done.stdout, done.stderr) == ("False\n", "")


def test_threads_that_call_a_kernel_for_the_first_time_get_the_same_bits() -> None:
    kernel = Kernel(circle_centres.py_func, circle_centres._signature, 1e-3)
    x, pivots, planes = np.random.default_rng(0).normal(size=(200, 3)), np.eye(3), np.ones((2, 3, 3))
    expected = np.empty((200, 3, 3))
    circle_centres.py_func(x, x, pivots, planes, expected)
    barrier = threading.Barrier(8)

    def solve(number: int) -> Any:
        results = np.empty((200, 3, 3))
        barrier.wait()
        # Half of them begin with few members, in the interpreter.
        first = 200 if number % 2 else 3
        kernel(x[:first], x[:first], pivots, planes, results[:first])
        kernel(x, x, pivots, planes, results)
        return results

    with ThreadPoolExecutor(8) as pool:
        for results in pool.map(solve, range(8)):
            np.testing.assert_array_equal(results, expected)
    assert kernel._compiled is not None


def test_a_defect_of_a_kernel_is_no_fault_of_the_cache(caplog: pytest.LogCaptureFixture) -> None:
    def defective(x: Any) -> None:
        x.nothing()

    with pytest.raises(TypingError):
        Kernel(defective, "void(f8[:])", 1e-3).compile()
    assert not [record for record in caplog.records if "cache" in record.message]


# --- The cache ----------------------------------------------------------------------------------------------------

SOLVE = """
import numpy as np
from spm_pin.kinematics.kernels.ball_circles import circle_centres
numbers = np.arange(27.0).reshape(3, 3, 3) ** 2
points = np.empty((1, 3, 3))
circle_centres(numbers[0, :1], numbers[0, 1:2], numbers[0], numbers[1:], points)
print(points.tolist())
"""
NUMBERS = np.arange(27.0).reshape(3, 3, 3) ** 2
ANSWER = [(NUMBERS[0] + NUMBERS[0, 0, :, None] * NUMBERS[1] + NUMBERS[0, 1, :, None] * NUMBERS[2]).tolist()]
"""By a kernel that is quickly compiled, and by NumPy."""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Copy the package to where a test may do to it what it likes."""
    source = Path(spm.__file__).parent
    shutil.copytree(source, tmp_path / "site" / "spm_pin", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "site"


def start(package: Path, program: str = SOLVE, **environment: object) -> subprocess.Popen[str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA", "XDG"))}
    kept |= {"PYTHONPATH": str(package), "PYTHONDONTWRITEBYTECODE": "1", ENVIRONMENT: "compiled"}
    kept |= {key: str(value) for key, value in environment.items()}
    command = [sys.executable, "-c", program]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, env=kept, cwd=package, text=True, stdout=pipe, stderr=pipe)


def has_compiled(process: subprocess.Popen[str]) -> bool:
    """Return, after a right answer, whether the process said that it compiled the kernel."""
    out, err = process.communicate()
    assert process.returncode == 0, err
    assert out.strip() == str(ANSWER)
    assert err == "" or re.fullmatch(
        r"(spm_pin: Numba's cache .*\n)*spm_pin: compiling .*compile_kernels\(\).*\n(.*\n)*", err
    )
    return bool(err)


INTERRUPTED = """
import _thread, numpy as np
from numba.core import event
from spm_pin.kinematics.kernels.ball_circles import circle_centres
class Interrupting(event.Listener):
    def on_start(self, event): _thread.interrupt_main()
    def on_end(self, event): pass
numbers = np.arange(27.0).reshape(3, 3, 3) ** 2
points = np.empty((1, 3, 3))
try:
    with event.install_listener("numba:compile", Interrupting()):
        circle_centres(numbers[0, :1], numbers[0, 1:2], numbers[0], numbers[1:], points)
except KeyboardInterrupt:
    assert circle_centres._compiled is None
else:
    raise AssertionError("not interrupted")
"""


def test_a_kernel_is_compiled_once_for_all_processes_until_a_formula_changes(package: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    # What is interrupted is compiled by the next call.
    assert has_compiled(start(package, program=INTERRUPTED + SOLVE, NUMBA_CACHE_DIR=cache))
    assert not has_compiled(start(package, NUMBA_CACHE_DIR=cache))
    # A damaged cache is as good as none, for two processes at once.
    for file in cache.rglob("*.nb?"):
        file.write_bytes(file.read_bytes()[:100])
    first, second = start(package, NUMBA_CACHE_DIR=cache), start(package, NUMBA_CACHE_DIR=cache)
    assert has_compiled(first) | has_compiled(second)
    # The kernel's own file stays as it is, but not a formula that it calls.
    formulas = package / "spm_pin" / "formulas" / "vectors.py"
    text, formula = formulas.read_text(), "return combined(a[0], x[0], b[0]), "
    assert formula in text
    formulas.write_text(text.replace(formula, "return combined(a[0], 2.0 * x[0], b[0]), "))
    out, _ = start(package, NUMBA_CACHE_DIR=cache).communicate()
    first, *others = ANSWER[0]
    changed = (2.0 * np.array(first) - NUMBERS[0, 0]).tolist()
    assert out.strip() == str([[changed, *others]])


def test_child_processes_compute_the_same() -> None:
    state = spm.Configuration(spm.Manipulator(0.7, 0.35, 0.8), np.eye(4), np.arange(9.0).reshape(3, 3) ** 2)
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(determinants, (state,)).tolist() == determinants(state).tolist()


FORKED = """
import os, threading
from numba.core import event
from spm_pin.kinematics.kernels.ball_circles import circle_centres
from spm_pin.kinematics.kernels.one_stage import working_modes
begun = threading.Event()
class Listener(event.Listener):
    def on_start(self, event): begun.set()
    def on_end(self, event): pass
with event.install_listener("numba:compile", Listener()):
    thread = threading.Thread(target=circle_centres.compile)
    thread.start()
    begun.wait()
    if child := os.fork():
        thread.join()
        assert os.waitpid(child, 0)[1] == 0
    else:
        working_modes.compile()
        os._exit(0)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_child_forked_while_a_thread_compiles_can_compile(package: Path, tmp_path: Path) -> None:
    process = start(package, program=FORKED, NUMBA_CACHE_DIR=tmp_path / "cache")
    try:
        _, err = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == 0, err


def test_a_read_only_installation_uses_the_users_cache(package: Path, tmp_path: Path) -> None:
    blocked(package)
    assert has_compiled(start(package, HOME=tmp_path / "home"))
    assert list((tmp_path / "home").rglob("*circle_centres*.nbc"))


def test_without_a_place_for_a_cache_a_process_compiles(package: Path, tmp_path: Path) -> None:
    blocked(package)
    (tmp_path / "file").touch()
    assert has_compiled(start(package, HOME=tmp_path / "file", NUMBA_CACHE_DIR=tmp_path / "file" / "cache"))


def test_all_kernels_can_be_compiled_in_advance() -> None:
    spm.kinematics.compile_kernels()
    compiled = all_kernels()
    assert {"all_branches", "modes_of_stages", "calibrated_branches"} <= {x.py_func.__name__ for x in compiled}
    assert all(kernel._compiled is not None for kernel in compiled)


def blocked(package: Path) -> None:
    """Let no cache be made beside the sources, not even by root."""
    (package / "spm_pin" / "kinematics" / "kernels" / "__pycache__").touch()
