"""The two controllers of the examples, compiled against stand-ins for the headers of LinuxCNC and of ros2_control."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from symbolic.c_library import STRICT, compile_c, compilers

import spm_pin as spm

EXAMPLES = Path(__file__).parents[2] / "examples/controllers"
STAND_INS = Path(__file__).parent / "stand_ins"


def worst_error(program: Path, *arguments: Path) -> float:
    """Run a driver; return the largest difference it found."""
    done = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"exit code {done.returncode} says which check failed"
    return float(done.stdout)


def test_the_module_for_linuxcnc_comes_back_to_the_leg_lengths(tmp_path: Path) -> None:
    spm.symbolic.write_c(spm.Geometry.paper(), tmp_path)
    sources = (EXAMPLES / "spmkins.c", STAND_INS / "linuxcnc/drive.c", tmp_path / "spm_kinematics.c")
    include = ("-I", STAND_INS / "linuxcnc", "-I", tmp_path)
    for compiler in compilers():
        compile_c(compiler, *STRICT, "-O2", *include, *sources, "-lm", "-o", tmp_path / "program")
        assert worst_error(tmp_path / "program") < 1e-6  # mm
        # The calibrated machine at load time, without compiling again.
        spm.symbolic.write_c(spm.Geometry.paper().perturbed(1, length=1e-3, angle=1e-3), tmp_path / "calibrated")
        assert worst_error(tmp_path / "program", tmp_path / "calibrated/spm_machine.txt") < 1e-6


def test_the_controller_for_ros2_control_comes_back_and_keeps_its_commands_out_of_reach(tmp_path: Path) -> None:
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler: neither g++ nor clang++")
    spm.symbolic.write_c(spm.Geometry.paper(), tmp_path)
    compile_c(compilers()[0], *STRICT, "-O2", "-c", tmp_path / "spm_kinematics.c", "-o", tmp_path / "kinematics.o")
    include = ("-I", EXAMPLES, "-I", STAND_INS / "ros2_control", "-I", tmp_path)
    flags = ("-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2")
    inputs = (STAND_INS / "ros2_control/drive.cpp", tmp_path / "kinematics.o")
    compile_c(compiler, *flags, *include, *inputs, "-lm", "-o", tmp_path / "program")
    assert worst_error(tmp_path / "program") < 1e-9  # m
