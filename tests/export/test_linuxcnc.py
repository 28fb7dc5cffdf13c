"""The exported configuration in LinuxCNC: its simulator without a screen, and the module forth and back in HAL."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from balancers import STAGES
from cli.running import run
from kinds_of_legs import SERVOS_AND_SCREWS as SERVOS
from problems import MANIPULATORS, as_built
from scipy.spatial.transform import Rotation

import spm_pin as spm

FILES = Path(__file__).parent / "linuxcnc"
MODULES = Path("/usr/lib/linuxcnc/modules")
PAPER = MANIPULATORS["paper"]
BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-1.2, 1.4))
PERIOD = 1e-3
ASSUMED = {"m": (0.1, 1.0), "rad": (1.0, 10.0)}
"""Rate and acceleration of readings in the exported file."""

pytestmark = pytest.mark.skipif(
    shutil.which("halcompile") is None or not os.access(MODULES, os.W_OK),
    reason="no halcompile (Debian: linuxcnc-uspace-dev), or no right to install LinuxCNC's modules with it",
)
Machine = spm.Manipulator | spm.Stage
Step = list[Any]


@dataclass(frozen=True)
class Bench:
    """A folder with a configuration, and programs of LinuxCNC run there."""

    folder: Path
    environment: dict[str, str]
    modules: dict[Machine, bytes] = field(default_factory=dict)
    """Those that were compiled."""

    def execute(self, *arguments: str, seconds: float = 500.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            arguments, cwd=self.folder, env=self.environment, stdin=subprocess.DEVNULL, capture_output=True, text=True,
            timeout=seconds, check=False,
        )  # fmt: skip

    def install(self, module: str) -> None:
        """Compile a module, and put it where LinuxCNC looks for it."""
        built = self.execute("halcompile", "--install", module)
        assert built.returncode == 0, built.stderr
        assert "warning" not in built.stderr

    def export(self, machine: Machine) -> str:
        """Export a machine by the command, and install its module; returns the beginning of its files' names."""
        name = name_of(machine)
        machine.to_yaml(self.folder / "machine.yaml")
        option = "--stage" if name == "stage" else "--machine"
        done = run("export", "linuxcnc", "--out", self.folder, option, self.folder / "machine.yaml")
        assert done.returncode == 0, done.message
        module = MODULES / f"{name}kins.so"
        if machine in self.modules:
            module.write_bytes(self.modules[machine])
        else:
            self.install(f"{name}kins.c")
            self.modules[machine] = module.read_bytes()
        return name


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    # LinuxCNC runs once on a machine, under one name, and as another user than root, who must reach the folder.
    with tempfile.TemporaryDirectory() as name, Path(tempfile.gettempdir(), "spm_pin_linuxcnc.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        Path(name).chmod(0o777)
        environment = os.environ | {"HOME": name, "RTAPI_FIFO_PATH": f"{name}/fifo"}
        if os.getuid() == 0:
            environment["RTAPI_UID"] = "65534"
        bench, modules = Bench(Path(name), environment), ("spmkins.so", "stagekins.so", "round_trip.so")
        before = {path: path.read_bytes() for path in map(MODULES.joinpath, modules) if path.exists()}
        shutil.copy(FILES / "round_trip.c", name)
        try:
            bench.install("round_trip.c")
            yield bench
        finally:
            bench.execute("halrun", "-U")
            for module in modules:
                (MODULES / module).unlink(missing_ok=True)
            for path, content in before.items():
                path.write_bytes(content)


def name_of(machine: Machine) -> str:
    return "stage" if isinstance(machine, spm.Stage) else "spm"


def axes_of(machine: Machine) -> str:
    return "ZAB" if isinstance(machine, spm.Stage) else "XYZABC"


def per_reading(machine: Machine) -> np.ndarray:
    """Return how many millimetres or degrees a unit of each reading is."""
    return np.where(np.array(machine.legs.units) == "m", 1e3, np.rad2deg(1.0))


def axes(state: Any) -> np.ndarray:
    """Return Z [mm] and A B [degrees] of a stage, X Y Z and A B C of a robot."""
    rotation, place = state.pose.rotation, 1e3 * state.translation
    if state.machine.is_stage:
        return np.concatenate([place[..., 2:], rotation.as_euler("XYZ", degrees=True)[..., :2]], axis=-1)
    return np.concatenate([place, rotation.as_euler("xyz", degrees=True)], axis=-1)


def solved(machine: Machine, values: np.ndarray, near: Any) -> np.ndarray:
    """Return the readings of values of the axes."""
    if isinstance(machine, spm.Stage):
        normal = Rotation.from_euler("XY", values[1:], degrees=True).apply([0.0, 0.0, 1.0])
        return spm.inverse_physical(machine, values[0] / 1e3, normal=normal).readings
    pose = spm.pose(values[:3] / 1e3, rpy=np.deg2rad(values[3:]))
    return spm.inverse_physical(machine, pose, near=near).readings


def in_world_mode(machine: Machine, step: Step) -> Step:
    """Return a step to the poses of readings, given with a feed, as G-code; others as they are."""
    if step[0] not in ("pose", "program"):
        return step
    kind, readings, feed = step
    lines = [
        f"G1 F{feed} " + " ".join(f"{name}{x:.9f}" for name, x in zip(axes_of(machine), values, strict=True))
        for values in axes(spm.forward_physical(machine, np.atleast_2d(readings)))
    ]
    return ["mdi", lines[0]] if kind == "pose" else ["program", "\n".join([*lines, "M2", ""])]


BUILT = {
    "robot": as_built(PAPER, 1e-3),
    "stage": BALANCER.perturbed(3, length=1e-4, angle=1e-3),
}
ROUND_A_SINGULARITY = [1.254, 1.299, 1.428, 1.263, 1.419, 1.409], [1.42, 1.227, 1.384, 1.198, 1.4, 1.421]
INTERRUPTIONS = "abort", "estop"
STEPS: dict[str, dict[str, Step]] = {
    "robot": {
        "home": ["on"],
        "jog of a leg": ["joint", 2, 50.0, 10.0],
        "jog back": ["joint", 2, -50.0, 10.0],
        "jog of Z": ["axis", 2, 20.0, 5.0],
        "first": ["pose", [1.2, 1.3, 1.4, 1.2, 1.305, 1.405], 6000],
        "second": ["pose", [1.205, 1.3, 1.395, 1.2, 1.3, 1.4], 6000],
        # The straight way from here to the second pose, which the machine never goes, meets a singularity.
        "program": ["program", [*ROUND_A_SINGULARITY, ROUND_A_SINGULARITY[0], [1.2, 1.3, 1.4, 1.2, 1.3, 1.4]], 1800],
        "limit": ["mdi", "G0 Z2900"],
        "level": ["mdi", "G0 X0 Y0 A0 B0 C0"],
    },
    "stage": {
        "home": ["on", 2, 0, 1],
        "jog of a leg": ["joint", 2, 20.0, 5.0],
        "jog back": ["joint", 2, -20.0, 5.0],
        "jog of Z": ["axis", 2, 20.0, 5.0],
        "first": ["pose", [0.3, -0.1, 0.2], 6000],
        "second": ["pose", [-0.4, 0.5, 0.6], 6000],
        "override": ["override", 2.0],
        **{how: ["interrupt", f"G1 F900 A{15 * (-1) ** k}", how] for k, how in enumerate(INTERRUPTIONS)},
        "back": ["pose", [0.1, 0.1, 0.1], 6000],
        "limit": ["pose", [1.45, 1.45, 1.45], 6000],
        "beyond the axes": ["mdi", "G0 Z500"],
        "out of reach": ["mdi", "G0 A45 B45"],
        "to a limit": ["pose", [-0.80, -0.99, -1.11], 500],
        "over a limit": ["pose", [0.54, 0.69, -0.95], 500],
        "off the limit": ["joint", 2, 30.0, 10.0],
        "up": ["pose", [0.9, 0.9, 0.9], 600],
        "nearly stretched": ["axis", 2, 25.0, 11.5],
        "on again": ["on"],
        "away": ["joint", 1, -20.0, 10.0],
    },
}
ERRORS = {
    "limit": "would exceed joint 0's positive limit",
    "beyond the axes": r"would exceed [XZ]'s positive limit",
    "level": "fails kinematicsInverse",
    "out of reach": "fails kinematicsInverse",
    "nearly stretched": "following error",
    "over a limit": "NEGATIVE soft limit",
}
"""LinuxCNC's own."""
REFUSED = "limit", "beyond the axes", "level", "out of reach"
"""Steps in which nothing moves; it stops on the way in the others."""
TURNED_OFF = ("nearly stretched",)


@pytest.mark.slow
@pytest.mark.parametrize("case", STEPS)
def test_the_simulator_homes_and_moves_a_machine_calibrated_anew(bench: Bench, case: str) -> None:
    machine, folder = BUILT[case], bench.folder
    steps = {name: in_world_mode(machine, step) for name, step in STEPS[case].items()}
    name, legs = bench.export(machine.nominal), range(len(machine.legs.units))
    # Only texts change: the module is the one that was compiled for the machine as drawn.
    for file, text in spm.export.linuxcnc_configuration(machine).items():
        if not file.endswith((".c", ".h")):
            (folder / file).write_text(text, encoding="utf-8")
    (folder / "steps.json").write_text(json.dumps(list(steps.values())), encoding="utf-8")
    (folder / "record.hal").write_text(
        f"loadrt sampler depth=65536 cfg={'f' * len(legs)}\naddf sampler.0 servo-thread\n"
        + "".join(f"net J{leg}:pos-fb => sampler.0.pin.{leg}\n" for leg in legs)
        + "loadusr halsampler record.txt\n",
        encoding="utf-8",
    )
    shutil.copy(FILES / "operate.py", folder)
    settings = (folder / f"{name}.ini").read_text(encoding="utf-8")
    for old, new in (
        ("DISPLAY = axis", "DISPLAY = ./operate.py"),
        (f"HALFILE = {name}.hal", f"HALFILE = {name}.hal\nHALFILE = record.hal"),
    ):
        assert old in settings
        settings = settings.replace(old, new)
    (folder / f"{name}.ini").write_text(settings, encoding="utf-8")
    bench.execute("linuxcnc", f"{name}.ini")
    written = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    results = dict(zip(steps, written, strict=True))
    reports = "\n".join(f"{name}: {result}" for name, result in results.items())

    scale = per_reading(machine)
    home = [float(x) for x in re.findall(r"^HOME = ([-\d.]+)$", settings, re.MULTILINE)]
    np.testing.assert_allclose(results["home"]["joints"], home, rtol=0, atol=1e-6, err_msg=reports)
    state = spm.forward_physical(machine, home / scale)
    places = ["XYZABC".index(axis) for axis in axes_of(machine)]
    pose = np.array(re.search(r"^HOME = (\S+ .*)$", settings, re.MULTILINE)[1].split(), dtype=float)
    np.testing.assert_allclose(pose[places], axes(state), rtol=0, atol=1e-6)
    for step, result in results.items():
        # Of every state the pose is that of the legs, and the legs are those of the pose.
        readings, values = np.array(result["joints"]) / scale, np.array(result["axes"])
        state = spm.forward_physical(machine, readings, state)
        np.testing.assert_allclose(values[places], axes(state), rtol=0, atol=1e-6, err_msg=reports)
        np.testing.assert_allclose(solved(machine, values[places], state), readings, rtol=0, atol=1e-9, err_msg=step)
        assert (np.delete(values, places) == 0.0).all()
    for step in ("first", "second"):
        wanted = [float(x) for x in re.findall(r"[XYZABC]([-\d.]+)", steps[step][1])]
        np.testing.assert_allclose(np.array(results[step]["axes"])[places], wanted, rtol=0, atol=1e-8, err_msg=reports)
    for step, last, kind in (("jog of a leg", "home", "joints"), ("jog of Z", "jog back", "axes")):
        assert results[step][kind][2] - results[last][kind][2] == pytest.approx(steps[step][3])

    before = None
    for step, result in results.items():
        if step in ERRORS:
            assert any(re.search(ERRORS[step], error) for error in result["errors"]), reports
            assert result["is_on"] == (step not in TURNED_OFF), reports
        else:
            assert not result["errors"], reports
            assert result["is_on"], reports
        if step in REFUSED:
            np.testing.assert_allclose(result["joints"], before, rtol=0, atol=1e-6)  # nothing moves
        before = result["joints"]
    for step in {"level", "out of reach"} & set(results):
        assert any(f"{name}kins: kinematicsInverse: " in error for error in results[step]["errors"]), reports

    # Whatever is commanded, no actuator is faster than its limits.
    positions = np.loadtxt(folder / "record.txt") / scale
    assert len(positions) > 5_000
    rounding = 1e-6 / scale  # six decimals
    rate, acceleration = np.array([ASSUMED[unit] for unit in machine.legs.units]).T
    assert (np.abs(np.diff(positions, axis=0)) <= rate * PERIOD + 2.0 * rounding).all()
    assert (np.abs(np.diff(positions, 2, axis=0)) <= acceleration * PERIOD**2 + 4.0 * rounding).all()


ROUND_TRIPS: dict[str, tuple[Machine, list[tuple[float, float]]]] = {
    "robot": (PAPER, [(1.101, 1.499)] * 6),
    "servos": (SERVOS, [(0.1, 0.9)] * 3 + [(0.0, 0.1)] * 3),
    "PRS": (STAGES["PRS"], [(-0.05, 0.05)] * 3),
    "RRS": (BALANCER, [(-0.5, 1.0)] * 3),
}
"""Machines, and ranges of their readings in which all have a state."""


@pytest.mark.parametrize(
    ("case", "count"),
    [
        ("servos", 10_000),
        ("RRS", 30_000),
        *(pytest.param(x, 300_000, marks=pytest.mark.slow) for x in ("robot", "PRS")),
    ],
)
def test_round_trips_in_hal(bench: Bench, case: str, count: int) -> None:
    machine, ranges = ROUND_TRIPS[case]
    name = bench.export(machine)
    np.savetxt(bench.folder / "ranges.txt", np.array(ranges) * per_reading(machine)[:, None])
    lines = f"loadrt {name}kins machine={name}_machine.txt\nloadrt round_trip count={count}\n"
    (bench.folder / "round_trip.hal").write_text(lines, encoding="utf-8")
    done = bench.execute("halrun", "-f", "round_trip.hal")
    found = re.search(r"refused (\d+) others (\d+) steep (\d+) poses (\S+)", done.stdout + done.stderr)
    assert done.returncode == 0, done.stderr
    assert found is not None
    refused, others, steep = (int(found[k]) for k in (1, 2, 3))
    assert float(found[4]) < 1e-9
    # The inverse displacement of a stage has no singularity there.
    assert refused + others < (0.01 * count if name == "spm" else 1)
    assert steep <= (1e-5 * count if name == "spm" else 0)


@pytest.mark.parametrize(("machine", "other"), [(SERVOS, PAPER), (BALANCER, STAGES["PRS"])])
def test_a_file_that_is_no_machine_of_these_legs_is_refused_with_the_cause(
    bench: Bench, machine: Machine, other: Machine
) -> None:
    name = bench.export(machine)
    text = (bench.folder / f"{name}_machine.txt").read_text(encoding="utf-8")
    for file, content, cause in (
        ("none.txt", None, "No such file or directory"),
        (".", None, "not a machine file of this kind and version"),
        (f"{name}.ini", None, "not a machine file of this kind and version"),
        (
            "other.txt",
            spm.export.linuxcnc_configuration(other)[f"{name}_machine.txt"],
            "not a machine file of this kind and version",
        ),
        ("version.txt", text.replace("file 1", "file 2"), "not a machine file of this kind and version"),
        ("empty.txt", "", "not a machine file of this kind and version"),
        ("cut.txt", text[: len(text) // 2], "not whole"),
        ("spoiled.txt", text.replace(".", ".x", 1), "not whole"),
        ("longer.txt", text + "1.0", "not whole"),
        ("zeros.txt", re.sub(r"[-\d]+\.[-+\de]+", "0.0", text), "numbers that are no machine"),
        ("carriage_returns.txt", text.replace("\n", "\r\n"), None),
    ):
        if content is not None:
            (bench.folder / file).write_bytes(content.encode())
        (bench.folder / "load.hal").write_text(f"loadrt {name}kins machine={file}\n", encoding="utf-8")
        done = bench.execute("halrun", "-f", "load.hal")
        assert (done.returncode == 0) == (cause is None), done.stderr
        if cause is not None:
            assert f"{name}kins: machine={file}, seen from {bench.folder}: {cause}" in done.stderr, done.stderr
