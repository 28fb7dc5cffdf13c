"""Sketches for a stage's servos, and set-points over a line: for the host, with bytes lost, doubled and wrong."""

from __future__ import annotations

import binascii
import ctypes
import os
import runpy
import shutil
import subprocess
import threading
import tty
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from balancers import STAGES
from export.c_library import compile_c, compilers
from export.stage_library import STATUS, STRICT

import spm_pin as spm
from spm_pin.export import write_stage_c

CONTROLLERS = Path(__file__).parents[2] / "examples/controllers"
STAND_INS = Path(__file__).parent / "stand_ins"
PINS = {"servo": [9, 10, 11], "esp32": [4, 13, 14]}
BALANCER = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-1.2, 1.4))
HOME = spm.forward_physical(BALANCER, [0.1] * 3)
RATE, ACCELERATION, PATIENCE, PERIOD = 4.0, 40.0, 0.25, 0.01
REPEATED, SILENT = 16, 17
PULSES = 637.0  # of a radian, in the sketches

streamer = runpy.run_path(str(CONTROLLERS / "stream_set_points.py"))


def compiled(stage: spm.Stage, folder: Path) -> ctypes.CDLL:
    write_stage_c(stage, folder)
    include = ("-I", folder, "-I", CONTROLLERS / "follow_set_points")
    source = Path(__file__).parent / "set_points_run.c"
    compile_c(compilers()[0], *STRICT, "-O2", "-fPIC", "-shared", *include, source, "-lm", "-o", folder / "board.so")
    library = ctypes.CDLL(str(folder / "board.so"))
    library.begin.argtypes = [ctypes.c_float] * 3 + [ctypes.c_void_p]
    return library


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    return compiled(BALANCER, tmp_path_factory.mktemp("board"))


def run(
    board: ctypes.CDLL,
    ticks: list[bytes],
    rate: float = RATE,
    start: npt.ArrayLike | None = None,
    times: npt.ArrayLike = PERIOD,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the readings of each tick, the status, and the answers (n, 5)."""
    begin = None if start is None else np.array(start, np.float32)
    at = None if begin is None else begin.ctypes.data_as(ctypes.c_void_p)
    assert board.begin(rate, ACCELERATION, PATIENCE, at) == STATUS["OK"]
    steps = np.array(np.broadcast_to(times, len(ticks)), np.float32)
    received, counts = b"".join(ticks), np.array([len(x) for x in ticks], np.int32)
    readings, status = np.empty((len(ticks), 3), np.float32), np.empty(len(ticks), np.int32)
    answers = np.empty((len(received) // 16 + 1, 5), np.uint8)
    pointers = [x.ctypes.data_as(ctypes.c_void_p) for x in (readings, status, answers)]
    count = board.run(
        ctypes.c_long(len(ticks)), received, *(x.ctypes.data_as(ctypes.c_void_p) for x in (counts, steps)), *pointers
    )
    return readings.astype(float), status, answers[:count]


def check_motion(
    readings: np.ndarray, rate: float = RATE, start: npt.ArrayLike = HOME.readings, times: npt.ArrayLike = PERIOD
) -> None:
    """Check that no actuator is faster than its limits, or beyond those of its readings and where it began."""
    first = np.asarray(start, np.float32).astype(float)
    steps = np.broadcast_to(times, len(readings))[:, None]
    speeds = np.diff(readings, axis=0, prepend=[first]) / steps
    rounding = 4.0 * np.finfo(np.float32).eps / steps
    assert (np.abs(speeds) <= rate + rounding).all()
    earlier = np.concatenate([rounding[:1], rounding[:-1]])
    changes = np.diff(speeds, axis=0, prepend=[np.zeros(3)])
    assert (np.abs(changes) <= ACCELERATION * steps + rounding + earlier).all()
    assert (readings >= np.minimum(first, np.float32(-1.2))).all()
    assert (readings <= np.maximum(first, np.float32(1.4))).all()


def set_point(number: int, tilt: float, azimuth: float, height: float) -> bytes:
    return streamer["frame"](number, np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), height)


def test_a_set_point_is_reached_within_the_limits_in_a_straight_line(board: ctypes.CDLL) -> None:
    height = float(HOME.height)
    ticks = [set_point(k, 0.25, 0.5, height) for k in range(1, 120)]
    readings, status, answers = run(board, ticks)
    check_motion(readings)
    expected = spm.inverse_physical(BALANCER, height, tilt=0.25, azimuth=0.5).readings
    np.testing.assert_allclose(readings[-1], expected, rtol=0.0, atol=2e-5)  # six digits are sent
    assert set(status) == {STATUS["OK"]}
    assert answers[:, 2].tolist() == [STATUS["OK"]] * 119
    assert [binascii.crc_hqx(bytes(a[:3]), 0xFFFF) for a in answers] == [int(a[3]) + 256 * int(a[4]) for a in answers]
    way, end = readings - HOME.readings, expected - HOME.readings
    assert np.abs(np.cross(way, end / np.linalg.norm(end))).max() < 5e-4
    # No slower than a motion at the largest acceleration and rate needs.
    assert (np.abs(way - end).max(axis=-1) < 1e-4).argmax() < 100.0 * (
        np.abs(end).max() / RATE + RATE / ACCELERATION
    ) + 4


def test_set_points_out_of_reach_are_refused_and_leave_the_target(board: ctypes.CDLL) -> None:
    height = float(HOME.height)
    bad = [set_point(2, 1.2, 0.0, height), set_point(3, 0.0, 0.0, 3.0), set_point(4, 0.0, 0.0, -3.0)]
    bad += [streamer["frame"](5, 1.0, 1.0, height), streamer["frame"](6, 2147.0, -2147.0, 2147.0)]
    readings, _, answers = run(board, [set_point(1, 0.1, 0.0, height), *bad, *[b""] * 15])
    check_motion(readings)
    assert STATUS["OK"] not in answers[1:, 2]
    expected = spm.inverse_physical(BALANCER, height, tilt=0.1, azimuth=0.0).readings
    np.testing.assert_allclose(readings[-1], expected, rtol=0.0, atol=2e-5)


def test_a_silent_line_stops_the_actuators_and_a_new_frame_starts_them(board: ctypes.CDLL) -> None:
    height = float(HOME.height)
    goal = set_point(1, 0.3, 2.0, height)
    readings, status, _ = run(board, [goal, *[b""] * 60, set_point(200, 0.3, 2.0, height), *[b""] * 20], rate=0.5)
    check_motion(readings, rate=0.5)
    # Stopped on the way; the sender may begin again at any number.
    assert status[20] == STATUS["OK"]
    assert status[40] == SILENT
    assert (readings[40:60] == readings[40]).all()
    end = spm.inverse_physical(BALANCER, height, tilt=0.3, azimuth=2.0).readings
    assert np.abs(readings[40] - end).max() > 0.05
    assert np.abs(readings[80] - end).max() < np.abs(readings[40] - end).max() - 0.02


def test_a_frame_that_comes_twice_or_late_is_no_set_point(board: ctypes.CDLL) -> None:
    height = float(HOME.height)
    frames = [set_point(k, 0.02 * k, 0.0, height) for k in range(6)]
    _, _, answers = run(board, [frames[1] + frames[1], frames[3] + frames[2], frames[5], frames[3]])
    assert answers[:, 1].tolist() == [1, 1, 3, 2, 5, 3]
    assert answers[:, 2].tolist() == [0, REPEATED, 0, REPEATED, 0, REPEATED]
    # One that comes again and again does not keep the watchdog quiet.
    _, status, _ = run(board, [frames[1]] * 40)
    assert status[-1] == SILENT


def test_a_way_through_a_singularity_is_answered_with_the_next_frame(tmp_path: Path) -> None:
    """Both set-points have states, and the straight way of the readings between them leads where there is none."""
    board, stage = compiled(STAGES["PRS radial"], tmp_path), STAGES["PRS radial"]
    tilts, azimuths, heights = np.radians([24.2, 14.0]), np.radians([-36.1, -6.0]), [0.34, 0.22]
    first, second = spm.inverse_physical(stage, heights, tilt=tilts, azimuth=azimuths).readings
    way = first + np.linspace(0.0, 1.0, 101)[:, None] * (second - first)
    assert spm.forward_physical(stage, way).exists.mean() < 0.8
    points = list(zip(tilts, azimuths, heights, strict=True))
    ticks = [set_point(k, *points[k > 200]) for k in range(1, 301)]
    readings, _, answers = run(board, ticks, rate=1.0)
    np.testing.assert_allclose(readings[199], first, rtol=0.0, atol=2e-5)
    assert (answers[:201, 2] == STATUS["OK"]).all()
    assert answers[-50:, 2].tolist() == [STATUS["UNSAFE"]] * 50
    assert (readings[-50:] == readings[-1]).all()
    assert np.abs(readings[-1] - second).max() > 0.01


def test_bytes_lost_doubled_and_wrong_never_move_an_actuator_faster(board: ctypes.CDLL) -> None:
    rng, height, number, ticks, whole = np.random.default_rng(0), float(HOME.height), 0, [], 0
    for tick in range(20_000):
        bytes_now = b""
        if rng.random() < 0.5 and tick // 500 % 7 != 3:
            number += 1
            heights = [height, rng.uniform(0.0, 0.3), -1.0, 1000.0]
            frame = bytearray(set_point(number, rng.uniform(0.0, 0.9), rng.uniform(-np.pi, np.pi), rng.choice(heights)))
            fault, place = rng.integers(12), rng.integers(16)
            if fault == 0:
                frame[place] ^= 1 << rng.integers(8)
            elif fault == 1:
                del frame[place]
            elif fault == 2:
                frame[place:place] = frame[place : place + 1]
            elif fault == 3:
                frame = bytearray(rng.bytes(rng.integers(40)))
            elif fault == 4:
                frame = 2 * frame
            whole += fault > 3 or (fault == 2 and place in (0, 15))
            bytes_now = bytes(frame)
        ticks.append(bytes_now)
    readings, status, answers = run(board, ticks)
    check_motion(readings)
    assert {STATUS["OK"], STATUS["UNREACHABLE"], STATUS["BEYOND_LIMITS"], SILENT} <= set(status)
    # After a frame that is spoiled the next is found again.
    taken = np.count_nonzero(answers[:, 2] != REPEATED)
    assert 0.8 * whole < taken < 1.01 * whole
    assert np.abs(np.diff(readings, axis=0)).max() > 0.9 * RATE * PERIOD


def test_commands_reach_the_limits_of_readings_without_a_jolt(board: ctypes.CDLL) -> None:
    """Fast ways from limit to limit, at which no actuator is cut off while it moves."""
    rng, ticks = np.random.default_rng(3), []
    low, high = map(float, spm.forward_physical(BALANCER, [[-1.2] * 3, [1.4] * 3]).height)
    heights = low + 1e-6, high - 1e-6  # what is sent is rounded
    for number in range(1, 400):
        ticks += [set_point(number, 0.0, 0.0, heights[number % 2]), *[b""] * int(rng.integers(5, 24))]
    readings, _, answers = run(board, ticks, rate=10.0)
    check_motion(readings, rate=10.0)
    assert (answers[:, 2] == STATUS["OK"]).all()
    assert readings.min() < -1.2 + 2e-4
    assert readings.max() > 1.4 - 2e-4


def test_commands_keep_their_limits_under_a_clock_that_jitters(board: ctypes.CDLL) -> None:
    rng = np.random.default_rng(0)
    times = (PERIOD * 10.0 ** rng.uniform(-1.5, 0.7, 20_000)).astype(np.float32).astype(float)
    ticks = [
        set_point(k // 9 + 1, rng.uniform(0.0, 0.5), rng.uniform(-np.pi, np.pi), rng.uniform(0.06, 0.14))
        if k % 9 == 0
        else b""
        for k in range(len(times))
    ]
    readings, _, answers = run(board, ticks, rate=10.0, times=times)
    check_motion(readings, rate=10.0, times=times)
    assert np.count_nonzero(answers[:, 2] == STATUS["OK"]) > 500
    assert np.abs(np.diff(readings, axis=0)).max() > 0.05


def test_a_machine_that_begins_beyond_its_limits_goes_back_at_its_rate(board: ctypes.CDLL) -> None:
    start, height = [-1.35, -1.3, -1.25], float(HOME.height)
    ticks = [b""] * 5 + [set_point(k, 0.1, 0.0, height) for k in range(1, 100)]
    readings, _, _ = run(board, ticks, start=start)
    check_motion(readings, start=start)
    assert (readings[:5] == np.float32(start)).all()
    expected = spm.inverse_physical(BALANCER, height, tilt=0.1, azimuth=0.0).readings
    np.testing.assert_allclose(readings[-1], expected, rtol=0.0, atol=2e-5)


def sketch(name: str, folder: Path, board: str) -> Path:
    """Compile a sketch for the host, and the library that a board has for servos."""
    compiler = shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler: neither g++ nor clang++")
    write_stage_c(BALANCER, folder)
    flags = ("-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Wdouble-promotion", "-Werror", "-O1")
    flags += ("-DARDUINO_ARCH_ESP32",) * (board == "esp32")
    folders = (folder, STAND_INS / "arduino", STAND_INS / board, CONTROLLERS / name)
    include = (*(x for path in folders for x in ("-I", path)), "-include", "Arduino.h")
    source = folder / f"{name}.cpp"
    source.write_text((CONTROLLERS / name / f"{name}.ino").read_text(encoding="utf-8"), "utf-8")
    inputs = (source, STAND_INS / "arduino/board.cpp")
    compile_c(compiler, *flags, *include, *inputs, "-lm", "-o", folder / name)
    return folder / name


def pulses(output: str, board: str) -> np.ndarray:
    """Return time [ms] and the three pulses of each step."""
    rows = np.array([line.split() for line in output.splitlines()], dtype=int).reshape(-1, 3, 3)
    assert (rows[:, :, 1] == PINS[board]).all()
    return np.column_stack([rows[:, 0, 0], rows[:, :, 2]])


def test_the_sketch_tilts_a_plate_in_a_circle(tmp_path: Path) -> None:
    program = sketch("tilt_in_a_circle", tmp_path, "esp32")
    done = subprocess.run([program, "4000"], stdin=subprocess.DEVNULL, capture_output=True, text=True, check=True)
    rows = pulses(done.stdout, "esp32")
    azimuth = 2.0 * np.pi * rows[:, 0] / 4000.0
    expected = spm.inverse_physical(
        BALANCER, float(HOME.height), tilt=0.1745, azimuth=(azimuth + np.pi) % (2 * np.pi) - np.pi
    )
    assert len(rows) > 150
    np.testing.assert_allclose(rows[:, 1:], 1500.0 + PULSES * expected.readings, rtol=0.0, atol=0.51)


def test_the_streamer_and_the_sketch_over_a_line_that_loses_doubles_and_spoils_bytes(tmp_path: Path) -> None:
    program, rng = sketch("follow_set_points", tmp_path, "servo"), np.random.default_rng(5)
    (host, near), (far, distant) = os.openpty(), os.openpty()
    for line in (host, far):
        tty.setraw(line)

    def carry(source: int, target: int, faults: float) -> None:
        while True:
            try:
                data = os.read(source, 64)
            except OSError:
                return  # the other ends are closed
            for byte in data:
                fault = rng.random()
                if fault < faults:
                    continue
                byte ^= 0x20 if fault < 2.0 * faults else 0
                os.write(target, bytes([byte, byte] if fault > 1.0 - faults else [byte]))

    with subprocess.Popen([program, "1500", os.ttyname(distant)], stdout=subprocess.PIPE, text=True) as process:
        lines = [threading.Thread(target=carry, args=x, daemon=True) for x in ((host, far, 0.004), (far, host, 0.0))]
        for line in lines:
            line.start()
        points = streamer["circle"](0.2, float(HOME.height), 1.5, 50.0, 1.0)
        counts = streamer["stream"](os.ttyname(near), points, 50.0)
        output, _ = process.communicate(timeout=300)
    for end in (near, distant):
        os.close(end)
    for line in lines:
        line.join()
    for end in (host, far):
        os.close(end)
    assert counts.total() == 75
    assert counts["ok"] > 40
    assert set(counts) <= {"ok", "unanswered", "repeated"}
    rows = pulses(output, "servo")
    moved = np.diff(rows[:, 1:], axis=0)
    assert 5.0 < np.abs(moved).max() <= PULSES * RATE * PERIOD + 1.0
    # The watchdog stops it where the line is silent.
    assert (moved[-20:] == 0).all()


def test_a_port_that_vanishes_ends_the_stream() -> None:
    host, board = os.openpty()

    def vanish() -> None:
        os.read(host, 16)
        os.close(host)

    threading.Thread(target=vanish).start()
    with pytest.raises(OSError, match="Input/output error"):
        streamer["stream"](os.ttyname(board), streamer["circle"](0.2, 0.1, 60.0, 50.0), 50.0)
    os.close(board)
