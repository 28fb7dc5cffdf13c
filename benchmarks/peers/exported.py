"""The exported C of `spm_pin.casadi`, called pose by pose from a loop in C, and the time of each call."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import RigidTransform

from benchmarks.peers.c_loop import Arrays, real_branches
from benchmarks.peers.compiled import address, folder, shared_object
from benchmarks.peers.peer import FloatArray, Prepared
from spm_pin import Configuration, Manipulator
from spm_pin.export.c_export import STATE_FUNCTIONS, write_c

CALLS = (
    "the clock alone",
    *(f"`spm_{name}" for name in ("all_branches`", "inverse`", "inverse`, near", "forward`", "forward`, near")),
    *(f"`spm_{function.name}`" for function in STATE_FUNCTIONS),
)
"""Names of the calls that `call_times` times, in its order."""

_CASES = "".join(
    f"    case {6 + k}: return spm_{f.name}(&spm_machine, at, {''.join(f'{f.name}_{x}, ' for x in f.arguments)}out);\n"
    for k, f in enumerate(STATE_FUNCTIONS)
)
_ARGUMENTS = "".join(
    f"static const double {f.name}_{name}[] = {{{', '.join(map(repr, x.tolist()))}}};\n"
    for f in STATE_FUNCTIONS
    for name, x in f.arguments.items()
)
_LOOP = """
#define _POSIX_C_SOURCE 199309L
#include <time.h>
#include "spm_kinematics.c"
void inverse_of_all(long count, const double *poses, double *joints, double *lengths, signed char *status)
{
    long n;
    int i, j;
    for (n = 0; n < count; ++n) {
        const double *pose = poses + 16 * n;
        const double rotation[9] = {pose[0], pose[1], pose[2], pose[4], pose[5], pose[6], pose[8], pose[9], pose[10]};
        const double position[3] = {pose[3], pose[7], pose[11]};
        spm_branches found;
        status[n] = (signed char)spm_all_branches(&spm_machine, rotation, position, &found);
        for (i = 0; i < 8; ++i) {
            for (j = 0; j < 9; ++j) joints[72 * n + 9 * i + j] = found.joints[i][j];
            for (j = 0; j < 6; ++j) lengths[48 * n + 6 * i + j] = found.readings[i][j];
        }
    }
}
@ARGUMENTS@
static int called(int which, const spm_state *at, const double *moved, double *out)
{
    static spm_branches branches;
    static spm_state state;
    switch (which) {
    case 1: return spm_all_branches(&spm_machine, at->rotation, at->position, &branches);
    case 2: return spm_inverse(&spm_machine, at->rotation, at->position, 0, &state);
    case 3: return spm_inverse(&spm_machine, at->rotation, moved + 6, at, &state);
    case 4: return spm_forward(&spm_machine, at->readings, 0, &state);
    case 5: return spm_forward(&spm_machine, moved, at, &state);
@CASES@    default: return 0;
    }
}
long time_calls(int which, long calls, long count, const spm_state *states, const double *moved, double *seconds)
{
    long n, failed = 0;
    double out[36];
    struct timespec begin, end;
    for (n = 0; n < calls; ++n) {
        long k = n % count;
        clock_gettime(CLOCK_MONOTONIC, &begin);
        failed += called(which, states + k, moved + 9 * k, out) != SPM_OK;
        clock_gettime(CLOCK_MONOTONIC, &end);
        seconds[n] = (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec);
    }
    return failed;
}
long ticks(long count, const double *readings, const double *wrench, spm_state *state, double *jacobian, double *forces)
{
    long n, failed = 0;
    for (n = 0; n < count; ++n) {
        failed += spm_forward(&spm_machine, readings + 6 * n, state, state) != SPM_OK;
        failed += spm_inverse_jacobian(&spm_machine, state, jacobian) != SPM_OK;
        failed += spm_leg_forces(&spm_machine, state, wrench, forces) != SPM_OK;
    }
    return failed;
}
long completions(long count, const double *readings, spm_state *state, double *values)
{
    long n, failed = 0;
    for (n = 0; n < count; ++n) {
        failed += spm_forward(&spm_machine, readings + 6 * n, state, state) != SPM_OK;
        failed += spm_joint_values(&spm_machine, state, values + 18 * n) != SPM_OK;
    }
    return failed;
}
"""


@functools.cache
def _library(machine: Manipulator) -> ctypes.CDLL:
    place = folder() / "exported"
    write_c(machine, place)
    loop = _LOOP.replace("@ARGUMENTS@", _ARGUMENTS).replace("@CASES@", _CASES)
    (place / "loop.c").write_text(loop, encoding="utf-8")
    return ctypes.CDLL(str(shared_object(place / "loop.c", ("-std=c99", "-O2"))))


def answered(problem: tuple[Manipulator, RigidTransform]) -> Prepared:
    """Prepare the exported C with all its checks, writing into the same arrays at every call."""
    machine, poses = problem
    loaded, arrays = _library(machine), Arrays.of(poses)
    results = [address(x) for x in (arrays.poses, arrays.joints, arrays.lengths, arrays.status)]

    def call() -> Arrays:
        loaded.inverse_of_all(ctypes.c_long(len(arrays.poses)), *results)
        return arrays

    return Prepared(call, lambda found: real_branches(found.joints))


def call_times(states: Configuration, change: float, calls: int) -> tuple[FloatArray, list[int]]:
    """Return the time of every call [s], (`CALLS`, calls), on the states in turns, and how many calls found nothing.

    From a state to begin with, legs and position are changed by up to `change` [m].
    """
    loaded, rows = _library(states.machine), _rows(states)
    at = np.concatenate([states.readings, states.translation], axis=-1)
    moved = at + np.random.default_rng(0).uniform(-change, change, at.shape)
    seconds, failed = np.empty((len(CALLS), calls)), []
    for which, times in enumerate(seconds):
        count = ctypes.c_long(calls), ctypes.c_long(len(rows))
        failed.append(loaded.time_calls(which, *count, address(rows), address(moved), address(times)))
    return seconds, failed


def ticks(start: Configuration, readings: FloatArray, wrench: FloatArray) -> Callable[[], tuple[FloatArray, ...]]:
    """Return a call of all ticks along readings (n, 6), one of which begins from the state of the last one.

    It returns the last J_f (6, 6) and the last leg forces (6,). `start` is a state (1,) near the first readings.
    """
    loaded, rows, jacobian, forces = _library(start.machine), _rows(start), np.empty((6, 6)), np.empty(6)

    def call() -> tuple[FloatArray, ...]:
        state = rows.copy()
        arrays = map(address, (readings, wrench, state, jacobian, forces))
        if loaded.ticks(ctypes.c_long(len(readings)), *arrays):
            raise RuntimeError("a tick of the exported C found no state")
        return jacobian, forces

    return call


def completions(start: Configuration, readings: FloatArray) -> Callable[[], FloatArray]:
    """Return a call that computes all joints (n, 18) of readings (n, 6), each from the last; `start` as for `ticks`."""
    loaded, rows, values = _library(start.machine), _rows(start), np.empty((len(readings), 18))

    def call() -> FloatArray:
        if loaded.completions(ctypes.c_long(len(readings)), *map(address, (readings, rows.copy(), values))):
            raise RuntimeError("a completion by the exported C found no state")
        return values

    return call


def _rows(states: Configuration) -> FloatArray:
    """Return states of shape (n,) as the numbers (n, 27) of the C structure."""
    parts = states.rotation, states.translation, states.middle_joints, states.readings
    return np.concatenate([part.reshape(len(part), -1) for part in parts], axis=-1)
