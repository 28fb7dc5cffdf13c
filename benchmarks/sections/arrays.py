"""The forward displacement and its gradient in JAX: formulas compiled by JAX, and kernels called back from it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import spm_pin as spm
from benchmarks.poses import MACHINE
from benchmarks.report import Facts, Section, count, seconds, spread_of_seconds, table, times
from benchmarks.sections.preparation import Progress
from benchmarks.timing import Pace, TimedCall, duration, time_in_turns

KERNEL, JAX, CALLBACK = "kernels, NumPy", "spm.arrays in JAX", "pure_callback"


def measure(pace: Pace, progress: Progress, facts: Facts) -> Section:
    """Time positions and gradients of random readings, in batches from 1 to 10⁶."""
    section = Section("Forward displacement in JAX")
    try:
        import jax
    except ImportError as error:
        section.add(f"*missing: {error}*")
        return section
    jax.config.update("jax_enable_x64", True)
    section.add(
        f"The platform's position for random readings, and the gradient of a sum over it, on {jax.default_backend()} "
        "with all threads that JAX takes, the kernels on one. `pure_callback` runs the kernels from within JAX and J_f "
        "for the gradient. For another device: `JAX_PLATFORMS=cuda python benchmarks/run.py --only arrays`."
    )
    compiled = {
        name: {"position": jax.jit(function), "gradient": jax.jit(jax.grad(lambda x, f=function: f(x).sum()))}
        for name, function in ((JAX, _position), (CALLBACK, _callback(jax)))
    }
    sizes = (1, 100, 10_000) if pace.quick else (1, 100, 10_000, 1_000_000)
    largest = np.random.default_rng(0).uniform(1.15, 1.45, (sizes[-1], 6))

    def timed(name: str, result: str, readings: np.ndarray) -> TimedCall:
        if name == KERNEL:
            return TimedCall(name, partial(_by_kernels, readings, gradient=result == "gradient"), len(readings))
        function, on_device = compiled[name][result], jax.numpy.asarray(readings)
        return TimedCall(name, lambda: jax.block_until_ready(function(on_device)), len(readings))

    first = []
    for name, functions in compiled.items():
        progress(f"compiling {name}")
        first.append([name, *(seconds(duration(timed(name, result, largest[:1]).call)) for result in functions)])
    section.add(table(["first call, compiled", "position", "gradient"], first))
    rows = []
    for size, result in itertools.product(sizes, ("position", "gradient")):
        calls = [timed(name, result, largest[:size]) for name in (KERNEL, JAX, CALLBACK)]
        # A call of 10⁶ takes long beside what disturbs it.
        timings = time_in_turns(calls, pace if size < 1_000_000 else replace(pace, rounds=3), progress)
        for name, timing in timings.items():
            ratio = ["1", ""] if name == KERNEL else times(timing.over(timings[KERNEL]))
            rows.append([result, name, count(size), *spread_of_seconds(timing.spread), *ratio])
    section.add(table(["", "", "a call", "per state", "quartiles", f"× {KERNEL}", "quartiles"], rows, left=2))
    return section


def _position(readings: Any) -> Any:
    return spm.arrays.forward_physical(MACHINE, readings).translation


def _by_kernels(readings: np.ndarray, *, gradient: bool) -> np.ndarray:
    states = spm.forward_physical(MACHINE, readings)
    if not gradient:
        return states.translation
    # The first three rows of J_f⁻¹ are the platform's velocity for unit rates.
    return np.linalg.inv(spm.inverse_jacobian(states))[..., :3, :].sum(axis=-2)


def _callback(jax: Any) -> Any:
    """Return the position by the kernels as a function in JAX, with its derivative by J_f."""

    def called(function: Any, readings: Any, *shape: int) -> Any:
        result = jax.ShapeDtypeStruct((*readings.shape[:-1], *shape), readings.dtype)
        return jax.pure_callback(function, result, readings, vmap_method="broadcast_all")

    @jax.custom_jvp
    def position(readings: Any) -> Any:
        return called(lambda x: spm.forward_physical(MACHINE, np.asarray(x)).translation, readings, 3)

    def velocities(readings: Any) -> np.ndarray:
        return np.linalg.inv(spm.inverse_jacobian(spm.forward_physical(MACHINE, np.asarray(readings))))[..., :3, :]

    @position.defjvp
    def rates(primals: Any, tangents: Any) -> Any:
        (readings,), (change,) = primals, tangents
        by_readings = called(velocities, readings, 3, 6)
        return position(readings), jax.numpy.einsum("...ij,...j->...i", by_readings, change)

    return position
