"""The exported C compiled into a shared library, and called for batches of poses, of readings and of states."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import spm_pin as spm
from spm_pin.export.c_export import STATE_FUNCTIONS, machine_fields, state_functions

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror")
STATE = 9 + 3 + 9 + 6
_BATCHES = """
#include "spm_kinematics.h"
void inverse_all(const spm_geometry *g, long n, const double *r, const double *o, const spm_state *near,
        spm_state *states, int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = spm_inverse(g, r + 9 * k, o + 3 * k, near ? near + k : 0, states + k);
}
void forward_all(const spm_geometry *g, long n, const double *readings, const spm_state *near, spm_state *states,
        int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = spm_forward(g, readings + 6 * k, near ? near + k : 0, states + k);
}
void beyond_all(const spm_geometry *g, long n, const double *readings, int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = spm_beyond_limits(g, readings + 6 * k);
}
void branches_all(const spm_geometry *g, long n, const double *r, const double *o, spm_branches *out, int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = spm_all_branches(g, r + 9 * k, o + 3 * k, out + k);
}
"""
BRANCHES = np.dtype(
    [("joints", "f8", (8, 3, 3)), ("readings", "f8", (8, 6)), ("discriminants", "f8", 4), ("real", "i4", 8)]
)


def _batch_of(name: str, sizes: list[int], count: int) -> str:
    """Return a loop over a function of the table."""
    parameters = "".join(f"const double *x{i}, " for i in range(len(sizes)))
    arguments = "".join(f"x{i} + {size} * k, " for i, size in enumerate(sizes))
    return f"""
void {name}_all(const spm_geometry *g, long n, const spm_state *states, {parameters}double *out, int *status)
{{
    long k;
    for (k = 0; k < n; ++k) status[k] = spm_{name}(g, states + k, {arguments}out + {count} * k);
}}
"""


def compilers() -> list[str]:
    """Return gcc and clang, those that there are; the test skips where there is none."""
    found = [path for name in ("gcc", "clang") if (path := shutil.which(name))]
    if not found:
        pytest.skip("no C compiler: neither gcc nor clang")
    return found


def compile_c(compiler: str, *arguments: object) -> None:
    done = subprocess.run([compiler, *map(str, arguments)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def run_cmake(*steps: list[object]) -> None:
    """Configure, build or install, each with the options given; skips where there is no CMake."""
    tool = shutil.which("cmake")
    if tool is None:
        pytest.skip("no cmake")
    for step in steps:
        done = subprocess.run([tool, *map(str, step)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def geometry_numbers(machine: spm.Manipulator) -> np.ndarray:
    """Return the numbers of an `spm_geometry`."""
    return np.concatenate(list(machine_fields(machine).values()))


@dataclass(frozen=True)
class CLibrary:
    """The functions of a compiled library, over batches of one axis, for a machine."""

    library: ctypes.CDLL
    machine: np.ndarray

    @classmethod
    def build(cls, machine: spm.Manipulator, folder: Path, *flags: str) -> CLibrary:
        """Export, compile and load; `flags` such as ``-O1``."""
        spm.export.write_c(machine, folder)
        loops = [_batch_of(f.name, [len(x) for x in f.arguments.values()], f.count) for f in state_functions(machine)]
        (folder / "batches.c").write_text(_BATCHES + "".join(loops), encoding="utf-8")
        library = folder / "library.so"
        inputs = folder / "batches.c", folder / "spm_kinematics.c"
        compile_c(compilers()[0], *STRICT, *flags, "-fPIC", "-shared", *inputs, "-lm", "-o", library)
        return cls(ctypes.CDLL(str(library)), geometry_numbers(machine))

    def of(self, machine: spm.Manipulator) -> CLibrary:
        """Return the same library, given another machine."""
        return CLibrary(self.library, geometry_numbers(machine))

    def _call(self, name: str, count: int, *arrays: np.ndarray | None) -> np.ndarray:
        status = np.empty(count, np.int32)
        arrays = tuple(None if x is None else np.ascontiguousarray(x) for x in arrays)
        pointers = [None if x is None else x.ctypes.data_as(ctypes.c_void_p) for x in (*arrays, status)]
        getattr(self.library, name)(self.machine.ctypes.data_as(ctypes.c_void_p), ctypes.c_long(count), *pointers)
        return status

    def inverse(self, rotation: np.ndarray, position: np.ndarray, near: np.ndarray | None = None) -> tuple:
        """Return states (n, 27) and their status."""
        states = np.empty((len(position), STATE))
        return states, self._call("inverse_all", len(position), rotation, position, near, states)

    def forward(self, readings: np.ndarray, near: np.ndarray | None = None) -> tuple:
        """Return states (n, 27) and their status."""
        states = np.empty((len(readings), STATE))
        return states, self._call("forward_all", len(readings), readings, near, states)

    def beyond_limits(self, readings: np.ndarray) -> np.ndarray:
        """Return what `spm_beyond_limits` does (n,)."""
        return self._call("beyond_all", len(readings), readings)

    def all_branches(self, rotation: np.ndarray, position: np.ndarray) -> tuple:
        """Return records of `BRANCHES` and their status."""
        found = np.empty(len(position), BRANCHES)
        return found, self._call("branches_all", len(position), rotation, position, found)

    def of_states(self, name: str, states: np.ndarray, *arguments: np.ndarray) -> tuple:
        """Return what a function of the table computes (n, count), and its status."""
        (count,) = (f.count for f in STATE_FUNCTIONS if f.name == name)
        result = np.empty((len(states), count))
        return result, self._call(f"{name}_all", len(states), states, *arguments, result)


def as_states(configuration: spm.Configuration) -> np.ndarray:
    """Return states of shape (n,) as rows (n, 27) in the order of the C structure."""
    parts = configuration.rotation, configuration.translation, configuration.middle_joints, configuration.readings
    return np.ascontiguousarray(np.concatenate([x.reshape(len(x), -1) for x in parts], axis=-1))
