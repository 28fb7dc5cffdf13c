"""The exported configuration in LinuxCNC: its simulator without a screen, and the module forth and back in HAL."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from cli.running import run
from problems import GEOMETRIES, as_built

import spm_pin as spm

FILES = Path(__file__).parent / "linuxcnc"
MODULES = Path("/usr/lib/linuxcnc/modules")
PAPER = GEOMETRIES["paper"]
RATE, ACCELERATION, PERIOD = 0.1, 1.0, 1e-3  # of the exported file [m, s]

pytestmark = pytest.mark.skipif(
    shutil.which("halcompile") is None or not os.access(MODULES, os.W_OK),
    reason="no halcompile (Debian: linuxcnc-uspace-dev), or no right to install LinuxCNC's modules with it",
)
Runner = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def linuxcnc() -> Iterator[tuple[Path, Runner]]:
    """A folder with the configuration of a drawn machine, its modules installed, and what runs programs there."""
    # LinuxCNC runs once on a machine, under one name, and as another user than root, who must reach the folder.
    with tempfile.TemporaryDirectory() as name, Path(tempfile.gettempdir(), "spm_pin_linuxcnc.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        folder = Path(name)
        folder.chmod(0o777)
        environment = os.environ | {"HOME": name, "RTAPI_FIFO_PATH": f"{name}/fifo"}
        if os.getuid() == 0:
            environment["RTAPI_UID"] = "65534"

        def execute(*arguments: str, seconds: float = 300.0) -> subprocess.CompletedProcess[str]:
            return subprocess.run(
                *(arguments,), cwd=folder, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
                timeout=seconds, check=False,
            )  # fmt: skip

        done = run("export", "linuxcnc", "--out", folder)
        assert done.returncode == 0, done.message
        shutil.copy(FILES / "round_trip.c", folder)
        before = {path: path.read_bytes() for path in MODULES.glob("spmkins.so")}
        try:
            for module in ("spmkins.c", "round_trip.c"):
                built = execute("halcompile", "--install", module)
                assert built.returncode == 0, built.stderr
                assert "warning" not in built.stderr
            yield folder, execute
        finally:
            execute("halrun", "-U")
            for module in ("spmkins.so", "round_trip.so"):
                (MODULES / module).unlink(missing_ok=True)
            for path, content in before.items():
                path.write_bytes(content)


def axes(state: spm.Configuration) -> np.ndarray:
    """Return X Y Z [mm] and A B C [degrees]."""
    return np.concatenate([1e3 * state.translation, state.pose.rotation.as_euler("xyz", degrees=True)])


def move(geometry: spm.Geometry, readings: list[float]) -> list[str]:
    """Return a step in world mode to the pose of readings."""
    values = axes(spm.forward_physical(geometry, readings))
    words = " ".join(f"{name}{value:.9f}" for name, value in zip("XYZABC", values, strict=True))
    return ["mdi", f"G1 F6000 {words}"]


def test_the_simulator_homes_and_moves_a_machine_calibrated_anew(linuxcnc: tuple[Path, Runner]) -> None:
    folder, execute = linuxcnc
    machine = as_built(PAPER, 1e-3)
    # Only texts change: the module is the one that was compiled for the machine as drawn.
    for name, text in spm.symbolic.linuxcnc_configuration(machine).items():
        if not name.endswith((".c", ".h")):
            (folder / name).write_text(text, encoding="utf-8")
    steps = {
        "home": ["on"],
        "jog of a leg": ["joint", 2, 50.0, 10.0],
        "jog back": ["joint", 2, -50.0, 10.0],
        "jog of Z": ["axis", 2, 20.0, 5.0],
        "first": move(machine, [1.2, 1.3, 1.4, 1.2, 1.305, 1.405]),
        "second": move(machine, [1.205, 1.3, 1.395, 1.2, 1.3, 1.4]),
        "limit": ["mdi", "G0 Z2900"],
        "out of reach": ["mdi", "G0 X9000"],
        "level": ["mdi", "G0 X0 Y0 A0 B0 C0"],
        **{f"leg {leg}": ["joint", leg, 90.0 * sign, 85.0] for leg, sign in ((0, 1), (3, 1), (2, -1), (5, -1))},
        "nearly level": ["axis", 1, 14.0, 20.0],
        "on again": ["on"],
        "away": ["joint", 5, 50.0, 50.0],
    }
    (folder / "steps.json").write_text(json.dumps(list(steps.values())), encoding="utf-8")
    (folder / "record.hal").write_text(
        "loadrt sampler depth=65536 cfg=ffffff\naddf sampler.0 servo-thread\n"
        + "".join(f"net leg-{leg}-command => sampler.0.pin.{leg}\n" for leg in range(6))
        + "loadusr halsampler record.txt\n",
        encoding="utf-8",
    )
    shutil.copy(FILES / "operate.py", folder)
    settings = (folder / "spm.ini").read_text(encoding="utf-8")
    for old, new in (
        ("DISPLAY = axis", "DISPLAY = ./operate.py"),
        ("HALFILE = spm.hal", "HALFILE = spm.hal\nHALFILE = record.hal"),
    ):
        assert old in settings
        settings = settings.replace(old, new)
    (folder / "spm.ini").write_text(settings, encoding="utf-8")
    execute("linuxcnc", "spm.ini")
    written = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    results = dict(zip(steps, written, strict=True))
    reports = "\n".join(f"{name}: {result}" for name, result in results.items())

    home = [float(x) for x in re.findall(r"^HOME = ([\d.]+)$", settings, re.MULTILINE)]
    np.testing.assert_allclose(results["home"]["joints"], home, rtol=0, atol=1e-6)
    state = spm.forward_physical(machine, np.array(home) / 1e3)
    np.testing.assert_allclose([float(x) for x in re.search(r"HOME = (.* .*)", settings)[1].split()], axes(state))
    for name, result in results.items():
        # Of every state the pose is that of the legs, and the legs are those of the pose.
        readings = np.array(result["joints"]) / 1e3
        state = spm.forward_physical(machine, readings, near=state)
        np.testing.assert_allclose(result["axes"], axes(state), rtol=0, atol=1e-6, err_msg=reports)
        pose = spm.pose(np.array(result["axes"][:3]) / 1e3, rpy=np.deg2rad(result["axes"][3:]))
        solved = spm.inverse_physical(machine, pose, near=state).readings
        np.testing.assert_allclose(solved, readings, rtol=0, atol=1e-9, err_msg=name)
    for name in ("first", "second"):
        wanted = [float(x) for x in re.findall(r"[XYZABC]([-\d.]+)", steps[name][1])]
        np.testing.assert_allclose(results[name]["axes"], wanted, rtol=0, atol=1e-8, err_msg=reports)
    assert results["jog of a leg"]["joints"][2] - results["home"]["joints"][2] == pytest.approx(10.0)
    assert results["jog of Z"]["axes"][2] - results["jog back"]["axes"][2] == pytest.approx(5.0)

    # LinuxCNC's own errors; nothing moves.
    for name, expected in (
        ("limit", "would exceed joint 0's positive limit"),
        ("out of reach", "would exceed X's positive limit"),
        ("level", "fails kinematicsInverse"),
    ):
        assert any(expected in error for error in results[name]["errors"]), reports
        assert results[name]["is_on"]
        np.testing.assert_allclose(results[name]["joints"], results["second"]["joints"], rtol=0, atol=1e-6)
    assert any("spmkins: kinematicsInverse: singular" in error for error in results["level"]["errors"])
    # Beside a level platform the legs cannot follow: it stops, and goes on from there.
    assert any("following error" in error for error in results["nearly level"]["errors"]), reports
    assert not results["nearly level"]["is_on"]
    assert results["away"]["is_on"], reports
    quiet = [name for name in steps if name not in ("limit", "out of reach", "level", "nearly level")]
    assert not any(results[name]["errors"] for name in quiet), reports

    positions = 1e-3 * np.loadtxt(folder / "record.txt")
    assert len(positions) > 5_000
    rounding = 2e-9  # six decimals of a millimetre, in a difference
    assert np.abs(np.diff(positions, axis=0)).max() <= RATE * PERIOD + rounding
    assert np.abs(np.diff(positions, 2, axis=0)).max() <= ACCELERATION * PERIOD**2 + 2.0 * rounding


@pytest.mark.parametrize("count", [100_000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_round_trips_in_hal(linuxcnc: tuple[Path, Runner], count: int) -> None:
    folder, execute = linuxcnc
    lines = f"loadrt spmkins machine=spm_machine.txt\nloadrt round_trip count={count}\n"
    (folder / "round_trip.hal").write_text(lines, encoding="utf-8")
    done = execute("halrun", "-f", "round_trip.hal")
    found = re.search(r"refused (\d+) others (\d+) steep (\d+) poses (\S+)", done.stdout + done.stderr)
    assert done.returncode == 0, done.stderr
    assert found is not None
    refused, others, steep = (int(found[k]) for k in (1, 2, 3))
    assert float(found[4]) < 1e-9
    assert refused + others < 0.01 * count
    assert steep <= 1e-5 * count


def test_a_file_that_is_no_machine_is_refused(linuxcnc: tuple[Path, Runner]) -> None:
    folder, execute = linuxcnc
    (folder / "round_trip.hal").write_text("loadrt spmkins machine=spm.ini\n", encoding="utf-8")
    done = execute("halrun", "-f", "round_trip.hal")
    assert done.returncode != 0
    assert "spm.ini describes no machine" in done.stderr
