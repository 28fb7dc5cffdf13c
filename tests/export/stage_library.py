"""The exported header of a stage compiled into a shared library, and called for batches."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from export.c_library import compile_c, compilers

import spm_pin as spm
from spm_pin.export import write_stage_c
from spm_pin.export.stage_export import stage_numbers
from spm_pin.machine.leg_kinds import KINDS

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wdouble-promotion", "-Wconversion", "-Wshadow", "-Werror")
STATE = 9 + 3 + 3
STATUS = {"OK": 0, "UNREACHABLE": 1, "BEYOND_LIMITS": 2, "SINGULAR": 3, "UNSAFE": 4, "BAD_INPUT": -1}
_BATCHES = """
#include "stage.h"
void inverse_all(const stage_geometry *g, long n, const stage_real *asked, stage_state *states, int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = stage_inverse(g, asked + 4 * k, asked[4 * k + 3], states + k);
}
void beyond_all(const stage_geometry *g, long n, const stage_real *readings, stage_state *unused, int *status)
{
    long k;
    (void)unused;
    for (k = 0; k < n; ++k) status[k] = stage_beyond_limits(g, readings + 3 * k);
}
void tilt_all(const stage_geometry *g, long n, const stage_real *asked, stage_state *states, int *status)
{
    long k;
    for (k = 0; k < n; ++k)
        status[k] = stage_tilt(g, asked[3 * k], asked[3 * k + 1], asked[3 * k + 2], states + k);
}
void forward_all(const stage_geometry *g, long n, const stage_real *readings, const stage_state *near,
        stage_state *states, int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = stage_forward(g, readings + 3 * k, near + k, states + k);
}
"""


@dataclass(frozen=True)
class StageLibrary:
    """The functions of the header for numbers of a type, for a stage."""

    library: ctypes.CDLL
    dtype: type
    machine: bytes = b""

    @classmethod
    def build(cls, folder: Path, dtype: type) -> StageLibrary:
        """Export, compile and load."""
        write_stage_c(spm.Stage(1.0, 1.0), folder)
        (folder / "batches.c").write_text(_BATCHES, encoding="utf-8")
        output = folder / f"{dtype.__name__}.so"
        kind = ["-DSTAGE_DOUBLE"] if dtype is np.float64 else []
        compile_c(compilers()[0], *STRICT, *kind, "-O2", "-fPIC", "-shared", folder / "batches.c", "-lm", "-o", output)
        return cls(ctypes.CDLL(str(output)), dtype)

    def of(self, stage: spm.Stage) -> StageLibrary:
        """Return the same library, given another stage."""
        kind = np.int32(list(KINDS).index(stage.kind.name)).tobytes().ljust(np.dtype(self.dtype).itemsize, b"\0")
        return StageLibrary(self.library, self.dtype, kind + stage_numbers(stage).astype(self.dtype).tobytes())

    def _call(self, name: str, *arrays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        given = [np.ascontiguousarray(x, self.dtype) for x in arrays]
        states, status = np.full((len(given[0]), STATE), 7.0, self.dtype), np.empty(len(given[0]), np.int32)
        pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (*given, states, status)]
        getattr(self.library, f"{name}_all")(self.machine, ctypes.c_long(len(states)), *pointers)
        return states, status

    def inverse(self, normals: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states (n, 15), 7 where nothing was written, and their status."""
        return self._call("inverse", np.column_stack([normals, heights]))

    def beyond_limits(self, readings: np.ndarray) -> np.ndarray:
        """Return what `stage_beyond_limits` does (n,)."""
        return self._call("beyond", readings)[1]

    def tilt(self, tilts: np.ndarray, azimuths: np.ndarray, heights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._call("tilt", np.column_stack([tilts, azimuths, heights]))

    def forward(self, readings: np.ndarray, near: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return self._call("forward", readings, near)
