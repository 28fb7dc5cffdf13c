"""Cranks whose limits lead them through straight down: readings go on, in everything that computes them."""

from __future__ import annotations

import ctypes
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from export.c_library import CLibrary, compile_c, compilers
from export.stage_library import StageLibrary
from export.test_stage_boards import compiled, run, set_point

import spm_pin as spm
from spm_pin.casadi import stage_inverse
from spm_pin.description import joint_values
from spm_pin.export import linuxcnc_configuration
from spm_pin.export.stage_export import stage_machine_sources
from spm_pin.machine import RRS, LegLimits, Stage
from spm_pin.machine.joint_angles import joint_angles
from spm_pin.proofs import certify
from spm_pin.workspace.state_set import states_within

LOW, HIGH = -2.0, 0.5
SWINGING = Stage(0.05, 0.10, RRS(crank=0.04, rod=0.12), limits=(LOW, HIGH))
BUILT = SWINGING.perturbed(3, length=2e-4, angle=3e-3)
LOWERED, STRAIGHT_DOWN, RAISED = 0.065, 0.072, 0.12
"""Heights of the plate [m]: with cranks beyond straight down, and before it."""


def states_of(stage: Stage, count: int = 400) -> spm.Configuration:
    """Return states whose readings differ by little from one value anywhere within the limits."""
    rng = np.random.default_rng(8)
    about = rng.uniform(LOW + 0.1, HIGH - 0.1, (count, 1)) + rng.uniform(-0.1, 0.1, (count, 3))
    states = spm.forward_physical(stage, about)
    assert states.exists.all()
    beyond = (about < -0.5 * np.pi).all(axis=-1).mean()
    assert 0.05 < beyond < 0.5
    return states


def robot_and_states() -> tuple[spm.Manipulator, spm.Configuration]:
    """Return a robot of two such stages as built, and states of it."""
    machine = spm.Manipulator.of_stages(BUILT, SWINGING)
    about = np.random.default_rng(9).uniform(-1.8, -1.2, (60, 1)) + np.linspace(-0.1, 0.1, 6)
    states = spm.forward_physical(machine, about)
    assert states.exists.all()
    np.testing.assert_allclose(states.readings, about, rtol=0.0, atol=1e-9)
    return machine, states


@pytest.mark.parametrize("stage", [SWINGING, BUILT], ids=["nominal", "calibrated"])
def test_the_inverse_of_a_state_has_its_readings(stage: Stage) -> None:
    states = states_of(stage)
    found = spm.inverse_physical(stage, states.height, normal=states.normal)
    np.testing.assert_allclose(found.readings, states.readings, rtol=0.0, atol=1e-9)
    assert (found.limit_excess == 0.0).all()
    posed = spm.Configuration(stage, states.pose)
    np.testing.assert_allclose(posed.readings, states.readings, rtol=0.0, atol=1e-9)


def test_a_stage_is_as_high_and_as_low_as_its_limits_let_it() -> None:
    """The plate is lowest and highest where the law of cosines puts it with readings at their limits."""
    expected = [0.04 * np.sin(q) + np.sqrt(0.12**2 - (0.05 - 0.04 * np.cos(q)) ** 2) for q in (LOW, HIGH)]
    np.testing.assert_allclose(spm.workspace.height_range(SWINGING), expected, rtol=0.0, atol=1e-8)
    assert spm.workspace.home_height(SWINGING) == pytest.approx(
        0.04 * np.sin(-0.75) + np.sqrt(0.12**2 - (0.05 - 0.04 * np.cos(-0.75)) ** 2), abs=1e-12
    )
    reach = spm.workspace.reach(SWINGING, [LOWERED, STRAIGHT_DOWN], directions=8)
    assert (reach.tilts > 0.01).all()
    near = spm.workspace.nearest_reachable_pose(SWINGING, 0.055).configuration
    assert near.height == pytest.approx(expected[0], abs=1e-6)
    np.testing.assert_allclose(near.readings, LOW, rtol=0.0, atol=1e-3)


def test_a_path_through_straight_down_meets_no_limit() -> None:
    path = spm.follow(SWINGING, height=[RAISED, LOWERED])
    assert path.complete
    assert not path.events
    assert np.abs(np.diff(path.configurations.readings, axis=0)).max() < 0.05
    assert path.configurations.readings[-1].max() < -0.5 * np.pi - 0.2


def test_arrays_casadi_and_c_read_the_same(tmp_path: Path) -> None:
    states = states_of(BUILT, 200)
    on_arrays = spm.arrays.stage_inverse(BUILT, states.normal, states.height)
    np.testing.assert_allclose(on_arrays.readings, states.readings, rtol=0.0, atol=1e-9)
    symbolic = stage_inverse(BUILT).map(200)(states.normal.T, states.height[None])[0]
    np.testing.assert_allclose(symbolic.full().T, states.readings, rtol=0.0, atol=1e-9)
    for dtype, most in ((np.float64, 1e-9), (np.float32, 2e-5)):
        library = StageLibrary.build(tmp_path, dtype).of(BUILT)
        found, status = library.inverse(states.normal, states.height)
        assert (status == 0).all()
        np.testing.assert_allclose(found[:, 12:], states.readings, rtol=0.0, atol=most)


def test_the_module_of_linuxcnc_reads_so_though_limits_are_those_of_its_own(tmp_path: Path) -> None:
    sources = linuxcnc_configuration(SWINGING) | stage_machine_sources(SWINGING)
    for name in ("stage.h", "stage_machine.txt", "stage_read_machine.h"):
        (tmp_path / name).write_text(sources[name], encoding="utf-8")
    begin = sources["stagekins.c"].split("/* From the level platform. */")[1].split("\n\n")[0]
    program = f"""
#define STAGE_DOUBLE
#include "stage_read_machine.h"
#define JOINTS 3
static stage_geometry geometry;
static stage_state last;
{begin}
int readings(const char *path, const double *start, double height, double *found)
{{
    const double up[3] = {{0.0, 0.0, 1.0}};
    int i, status;
    geometry = stage_machine;
    status = stage_read_machine(path, &geometry) ? 99 : begin(start);
    status = status == STAGE_OK ? stage_inverse(&geometry, up, height, &last) : status;
    for (i = 0; i < 3; ++i) found[i] = last.readings[i];
    return status;
}}
"""
    (tmp_path / "module.c").write_text(program, encoding="utf-8")
    compile_c(compilers()[0], "-fPIC", "-shared", tmp_path / "module.c", "-lm", "-o", tmp_path / "module.so")
    library, start, found = ctypes.CDLL(str(tmp_path / "module.so")), np.full(3, -1.9), np.empty(3)
    library.readings.argtypes = [ctypes.c_char_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p]
    low, path = spm.forward_physical(SWINGING, start), str(tmp_path / "stage_machine.txt").encode()
    assert library.readings(path, start.ctypes.data, float(low.height), found.ctypes.data) == 0
    np.testing.assert_allclose(found, start, rtol=0.0, atol=1e-9)


def test_set_points_lower_the_plate_through_straight_down(tmp_path: Path) -> None:
    heights = np.linspace(STRAIGHT_DOWN, LOWERED, 71)
    ticks = [set_point(k + 1, 0.0, 0.0, height) for k, height in enumerate(heights)] + [b""] * 20
    start = spm.inverse_physical(SWINGING, STRAIGHT_DOWN).readings
    readings, status, _ = run(compiled(SWINGING, tmp_path), ticks, start=start)
    assert set(status) == {0}
    assert (np.diff(readings, axis=0) < 1e-5).all()
    reached = spm.forward_physical(SWINGING, readings[-1])
    assert reached.height == pytest.approx(LOWERED, abs=1e-5)


def test_a_robot_reads_so_in_all_that_computes_it(tmp_path: Path) -> None:
    machine, states = robot_and_states()
    posed = spm.machine.Configuration(machine, states.pose, states.middle_joints)
    np.testing.assert_allclose(posed.readings, states.readings, rtol=0.0, atol=1e-9)
    again = spm.inverse_physical(machine, states.pose, near=states)
    np.testing.assert_allclose(again.readings, states.readings, rtol=0.0, atol=1e-9)
    on_arrays = spm.arrays.inverse_physical(machine, states.rotation, states.translation)
    assert on_arrays.exists.all()
    np.testing.assert_allclose(on_arrays.readings, states.readings, rtol=0.0, atol=1e-8)
    written_again = spm.crosscheck.nlp.readings(machine)(
        states.middle_joints[0].ravel(), states.rotation[0], states.translation[0]
    )
    np.testing.assert_allclose(written_again.full()[:, 0], states.readings[0], rtol=0.0, atol=1e-9)
    library = CLibrary.build(machine, tmp_path)
    found, status = library.inverse(states.rotation, states.translation)
    assert (status == 0).all()
    np.testing.assert_allclose(found[:, 21:], states.readings, rtol=0.0, atol=1e-8)
    reachable = states_within(machine)
    np.testing.assert_allclose(reachable.readings(reachable.coordinates(states)), states.readings, rtol=0.0, atol=1e-8)
    # The actuated joints are in the order of the legs, at zero at home.
    actuated = joint_angles(states).actuated
    np.testing.assert_allclose(actuated, states.readings - machine.legs.offsets + 0.75, rtol=0.0, atol=1e-9)
    values = joint_values(states[0])
    on_arrays = spm.arrays.joint_values(machine, states[:1])[0]
    np.testing.assert_allclose(on_arrays, list(values.values()), rtol=0.0, atol=1e-9)


def test_a_box_of_readings_about_straight_down_is_certified() -> None:
    stage = replace(SWINGING, limits=LegLimits(-1.65, -1.5))
    machine = spm.Manipulator.of_stages(stage, stage)
    certificate = certify(machine)
    assert certificate.holds, certificate
