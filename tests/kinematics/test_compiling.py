"""Compiled kernels: vector instructions, IEEE arithmetic, and a cache whose failures have no effect."""

from __future__ import annotations

import gc
import multiprocessing
import os
import platform
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problems import random_branches

import spm_pin as spm
from spm_pin.kinematics.kernels.branch_kernels import all_branches
from spm_pin.kinematics.kernels.compilation import Kernel
from spm_pin.kinematics.singularity_analysis import determinants

PAPER = spm.Geometry.paper()
# Square roots of several numbers at once, and products and sums contracted into one instruction.
PACKED, CONTRACTED = {
    "x86_64": (r"\bv?sqrtpd\b", r"\bvfn?m(add|sub)"),
    "AMD64": (r"\bv?sqrtpd\b", r"\bvfn?m(add|sub)"),
    "aarch64": (r"\bfsqrt\s+v\d+\.2d", r"\bfn?m(add|sub|la|ls)\b"),
    "arm64": (r"\bfsqrt[.\s].*2d", r"\bfn?m(add|sub|la|ls)\b"),
}[platform.machine()]


def test_several_problems_share_a_vector_register() -> None:
    compiled: Any = all_branches._dispatcher(cache=False)
    assembly = "".join(compiled.inspect_asm().values())
    assert re.search(PACKED, assembly)
    assert not re.search(CONTRACTED, assembly)


# --- The interpreter ----------------------------------------------------------------------------------------------

INTERPRETED = """
import warnings, sys, numpy as np, spm_pin as spm
warnings.simplefilter("ignore")
pose = np.load(sys.argv[1])
solutions = spm.inverse_displacement(spm.Geometry.paper(), pose)
state = solutions.configurations
physical = spm.forward_physical(spm.Geometry.paper(), state[:, 0].leg_lengths)
singular = spm.singularities(state[:2])
np.savez(sys.argv[2], joints=solutions.middle_joints, lengths=solutions.leg_lengths, status=solutions.status,
         discriminants=solutions.discriminants, rates=spm.inverse_jacobian(state),
         twists=spm.kinematics.platform_jacobian(state),
         forces=spm.leg_forces(state, [1, 2, 3, 4, 5, 6]), physical=physical.middle_joints,
         chosen=spm.inverse_physical(spm.Geometry.paper(), pose).middle_joints, sigma=singular.sigma,
         twist=singular.gained_twist, wrench=singular.lost_wrench)
"""


def test_the_interpreter_gets_the_same_bits(tmp_path: Path) -> None:
    pose = random_branches(PAPER, "TT", 5, seed=1).pose.as_matrix()
    np.save(tmp_path / "pose.npy", pose)
    results = []
    for disabled in "01":
        target = tmp_path / f"{disabled}.npz"
        command = [sys.executable, "-c", INTERPRETED, tmp_path / "pose.npy", target]
        subprocess.run(command, check=True, env={**os.environ, "NUMBA_DISABLE_JIT": disabled})
        results.append(np.load(target))
    compiled, interpreted = results
    for name in compiled.files:
        np.testing.assert_array_equal(compiled[name], interpreted[name], err_msg=name)


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


def start(package: Path, **environment: object) -> subprocess.Popen[str]:
    kept = {key: value for key, value in os.environ.items() if not key.startswith(("NUMBA", "XDG"))}
    kept |= {"PYTHONPATH": str(package), "PYTHONDONTWRITEBYTECODE": "1"}
    kept |= {key: str(value) for key, value in environment.items()}
    command = [sys.executable, "-c", SOLVE]
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


def test_a_kernel_is_compiled_once_for_all_processes_until_a_formula_changes(package: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    first, second = start(package, NUMBA_CACHE_DIR=cache), start(package, NUMBA_CACHE_DIR=cache)
    assert has_compiled(first) | has_compiled(second)
    assert not has_compiled(start(package, NUMBA_CACHE_DIR=cache))
    # A damaged cache is as good as none.
    for file in cache.rglob("*.nb?"):
        file.write_bytes(file.read_bytes()[:100])
    assert has_compiled(start(package, NUMBA_CACHE_DIR=cache))
    # The kernel's own file stays as it is, but not a formula that it calls.
    formulas = package / "spm_pin" / "formulas" / "vectors.py"
    text, formula = formulas.read_text(), "return combined(a[0], x[0], b[0]), "
    assert formula in text
    formulas.write_text(text.replace(formula, "return combined(a[0], 2.0 * x[0], b[0]), "))
    out, _ = start(package, NUMBA_CACHE_DIR=cache).communicate()
    first, *others = ANSWER[0]
    changed = (2.0 * np.array(first) - NUMBERS[0, 0]).tolist()
    assert out.strip() == str([[changed, *others]])


@pytest.mark.parametrize("method", [m for m in ("fork", "spawn") if m in multiprocessing.get_all_start_methods()])
def test_child_processes_compute_the_same(method: str) -> None:
    state = spm.Configuration(spm.Geometry(0.7, 0.35, 0.8), np.eye(4), np.arange(9.0).reshape(3, 3) ** 2)
    with multiprocessing.get_context(method).Pool(1) as pool:
        assert pool.apply(determinants, (state,)).tolist() == determinants(state).tolist()


def test_a_read_only_installation_uses_the_users_cache(package: Path, tmp_path: Path) -> None:
    blocked(package)
    assert has_compiled(start(package, HOME=tmp_path / "home"))
    assert not has_compiled(start(package, HOME=tmp_path / "home"))


def test_without_a_place_for_a_cache_every_process_compiles(package: Path, tmp_path: Path) -> None:
    blocked(package)
    (tmp_path / "file").touch()
    nowhere = {"HOME": tmp_path / "file", "NUMBA_CACHE_DIR": tmp_path / "file" / "cache"}
    processes = [start(package, **nowhere) for _ in range(2)]
    assert [has_compiled(process) for process in processes] == [True, True]


def test_all_kernels_can_be_compiled_in_advance() -> None:
    spm.kinematics.compile_kernels()
    gc.unfreeze()  # conftest.py
    # Tests have kernels of their own.
    found = [member for member in gc.get_objects() if type(member) is Kernel]
    kernels = [kernel for kernel in found if kernel.py_func.__module__.startswith("spm_pin.")]
    assert {"all_branches", "modes_of_stages", "as_built_branches"} <= {kernel.py_func.__name__ for kernel in kernels}
    assert all(kernel._compiled is not None for kernel in kernels)


def blocked(package: Path) -> None:
    """Let no cache be made beside the sources, not even by root."""
    (package / "spm_pin" / "kinematics" / "kernels" / "__pycache__").touch()
