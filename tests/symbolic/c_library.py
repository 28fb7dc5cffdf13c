"""The exported C compiled into a shared library, and called for batches of poses and of leg lengths."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import spm_pin as spm

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
STATE = 9 + 3 + 9 + 6
_BATCHES = """
#include "spm_kinematics.h"
void inverse_all(const spm_geometry *g, long n, const double *r, const double *o, double *joints, double *lengths,
        double *discriminants, int *status)
{
    spm_branches out;
    const double *from;
    long k;
    int i;
    for (k = 0; k < n; ++k) {
        status[k] = spm_inverse(g, r + 9 * k, o + 3 * k, &out);
        from = out.joints[0];
        for (i = 0; i < 72; ++i) joints[72 * k + i] = from[i];
        from = out.lengths[0];
        for (i = 0; i < 48; ++i) lengths[48 * k + i] = from[i];
        for (i = 0; i < 4; ++i) discriminants[4 * k + i] = out.discriminants[i];
    }
}
void physical_all(const spm_geometry *g, long n, const double *r, const double *o, spm_state *states, int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = spm_inverse_physical(g, r + 9 * k, o + 3 * k, states + k);
}
void forward_all(const spm_geometry *g, long n, const double *lengths, const spm_state *seeds, spm_state *states,
        int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = spm_forward_physical(g, lengths + 6 * k, seeds ? seeds + k : 0, states + k);
}
void jacobian_all(const spm_geometry *g, long n, const spm_state *states, double *matrices, int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = spm_inverse_jacobian(g, states + k, matrices + 36 * k);
}
void forces_all(const spm_geometry *g, long n, const spm_state *states, const double *wrench, double *forces,
        int *status)
{
    long k;
    for (k = 0; k < n; ++k) status[k] = spm_leg_forces(g, states + k, wrench + 6 * k, forces + 6 * k);
}
"""

DRIVER = """
#include "spm_kinematics.h"
#include <stdio.h>
/* Call all functions for poses and leg lengths, 18 numbers each, of a file; write six statuses each. */
int main(int count, char **names)
{
    FILE *in = fopen(names[1], "rb"), *out = fopen(names[count - 1], "wb");
    double row[18], matrix[36], forces[6], q[6];
    const double wrench[6] = {3.0, -2.0, -50.0, 4.0, -6.0, 8.0};
    spm_branches branches;
    spm_state state;
    int i, status[6];
    if (!in || !out) return 1;
    while (fread(row, sizeof row, 1, in) == 1) {
        status[0] = spm_inverse(&spm_machine, row, row + 9, &branches);
        status[1] = spm_inverse_physical(&spm_machine, row, row + 9, &state);
        status[2] = spm_forward_physical(&spm_machine, row + 12, 0, &state);
        status[4] = spm_inverse_jacobian(&spm_machine, &state, matrix);
        status[5] = spm_leg_forces(&spm_machine, &state, wrench, forces);
        for (i = 0; i < 6; ++i) q[i] = state.lengths[i] * (i % 2 ? 1.02 : 0.98);
        status[3] = spm_forward_physical(&spm_machine, q, &state, &state);
        fwrite(status, sizeof status, 1, out);
    }
    fclose(in);
    return fclose(out);
}
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


@dataclass(frozen=True)
class CLibrary:
    """The functions of a compiled library, over batches of one axis."""

    library: ctypes.CDLL
    geometry: spm.Geometry
    machine: np.ndarray | None = None
    """The numbers of an `spm_geometry`, where they are not those of `geometry`."""

    @classmethod
    def build(cls, geometry: spm.Geometry, folder: Path, *flags: str) -> CLibrary:
        """Export, compile and load; `flags` such as ``-ffp-contract=off``."""
        spm.symbolic.write_c(geometry, folder)
        return cls.load(geometry, folder, *flags)

    @classmethod
    def load(cls, geometry: spm.Geometry, folder: Path, *flags: str) -> CLibrary:
        """Compile and load what was exported into a folder."""
        (folder / "batches.c").write_text(_BATCHES, encoding="utf-8")
        library = folder / "library.so"
        inputs = folder / "batches.c", folder / "spm_kinematics.c"
        compile_c(compilers()[0], *STRICT, *flags, "-fPIC", "-shared", *inputs, "-lm", "-o", library)
        return cls(ctypes.CDLL(str(library)), geometry)

    def _call(self, name: str, count: int, *arrays: np.ndarray | None) -> np.ndarray:
        status = np.empty(count, np.int32)
        limits = self.geometry.limits
        low, high = (np.zeros(6), np.full(6, np.inf)) if limits is None else (limits.minimum, limits.maximum)
        sizes = self.geometry.base_radius, self.geometry.platform_radius, self.geometry.middle_side
        machine = np.array([*sizes, *low, *high]) if self.machine is None else self.machine
        pointers = [None if x is None else x.ctypes.data_as(ctypes.c_void_p) for x in (*arrays, status)]
        getattr(self.library, name)(machine.ctypes.data_as(ctypes.c_void_p), ctypes.c_long(count), *pointers)
        return status

    def inverse(self, rotation: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, ...]:
        n = len(position)
        joints, lengths, discriminants = np.empty((n, 8, 3, 3)), np.empty((n, 8, 6)), np.empty((n, 4))
        rotation, position = np.ascontiguousarray(rotation), np.ascontiguousarray(position)
        status = self._call("inverse_all", n, rotation, position, joints, lengths, discriminants)
        return joints, lengths, discriminants, status

    def inverse_physical(self, rotation: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return states (n, 27) and their status."""
        states = np.empty((len(position), STATE))
        rotation, position = np.ascontiguousarray(rotation), np.ascontiguousarray(position)
        return states, self._call("physical_all", len(position), rotation, position, states)

    def forward(self, lengths: np.ndarray, seeds: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        states = np.empty((len(lengths), STATE))
        return states, self._call("forward_all", len(lengths), np.ascontiguousarray(lengths), seeds, states)

    def inverse_jacobian(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        matrices = np.empty((len(states), 6, 6))
        return matrices, self._call("jacobian_all", len(states), states, matrices)

    def leg_forces(self, states: np.ndarray, wrench: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        forces = np.empty((len(states), 6))
        return forces, self._call("forces_all", len(states), states, np.ascontiguousarray(wrench), forces)


def as_states(configuration: spm.Configuration) -> np.ndarray:
    """Return states of shape (n,) as rows (n, 27) in the order of the C structure."""
    parts = configuration.rotation, configuration.translation, configuration.middle_joints, configuration.leg_lengths
    return np.ascontiguousarray(np.concatenate([x.reshape(len(x), -1) for x in parts], axis=-1))
