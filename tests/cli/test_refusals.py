"""Refused command lines: exit code 2, an error that names the option typed, no file written."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from cli.running import run

PLACE = "--translation 68.89 49.63 225.3"
POSE = f"{PLACE} --xyx -11.08 32.97 -12.88"
LIMITS = "--limits 110 150 --unit cm"
START, GOAL = "120 120 140 125 120 150", "140 120 120 120 150 125"
ENDS = f"--from {START} --to {GOAL} --unit cm"
EQUAL_LEGS = "--legs 1.3 1.3 1.3 1.3 1.3 1.3"
STORE = "--out map"

REFUSED = [
    # Poses and files, the same in all commands.
    ("inverse", "Missing option '--translation'"),
    ("stage reach --base 1 --platform 1 --crank 1 --rod 1 --limits 70 -35", "expected minimum < maximum, got 70 -35"),
    ("stage inverse --height high --base 1 --platform 1", "valid number, unable to parse string as a number, got high"),
    ("inverse --translation nan 0 2 --xyx 1 2 3", "error: --translation: expected finite"),
    (
        f"inverse {PLACE}",
        "error: --translation: expected a position and one orientation, of --xyx, --rpy, --quat, --rotvec, --matrix",
    ),
    (
        f"inverse {POSE} --rpy 1 2 3",
        "orientation, of --xyx, --rpy, --quat, --rotvec, --matrix, got --translation and --xyx and --rpy",
    ),
    (f"inverse {PLACE} --quat 0 0 1 1", "error: --quat: expected a quaternion of length 1"),
    (f"inverse {POSE} --machine missing.yaml", "error: --machine: missing.yaml: expected"),
    ("inverse --translation 1 2 --xyx 1 2 -3", "--translation': expected 3 numbers, X Y Z, got 1 2"),
    ("inverse --translation 1 2 3 -1 --xyx 1 2 3", "expected 3 numbers, X Y Z, got 1 2 3 -1"),
    ("nothing", "No such command"),
    # calibrate, certify, crosscheck
    ("calibrate nope.csv", "error: CSV: nope.csv: expected a readable CSV file"),
    ("certify --length-error -1", "--length-error"),
    ("certify --angle-error 1", "--angle-error"),
    (f"certify {LIMITS} --inverse --angle-error 1e-4", "--inverse"),
    ("crosscheck --method delphi", "error: --method: expected names among closed-form"),
    ("crosscheck --figure x.html", "--figure: expected a file name ending in .png"),
    ("crosscheck --seed -1", "--seed"),
    # draw
    ("draw --out x.jpg", "ending in .png, .svg, .pdf"),
    ("draw --out x.png --all --branch TT+", "error: --all cannot be used with --branch"),
    ("draw --out /dev/null/x.png --width 100", "a file that can be written"),
    ("draw --out x.png --view 900 0", "--view: expected azimuth and elevation in degrees"),
    ("draw --out x.png --width 100000", "--width: expected at most"),
    # export
    ("export", "Missing argument 'FORMAT'"),
    ("export mjcf --ros-constraints", "error: --ros-constraints cannot be used with mjcf"),
    ("export mjcf --prefix '1 2'", "--prefix: expected a name"),
    ("export c", "--out: expected the directory to write into"),
    ("export c --out c --prefix 1st", "--prefix: expected letters, digits and underscores"),
    ("export urdf --masses nope.yaml", "error: --masses: nope.yaml: expected a readable YAML file, got No such file"),
    # forward, statics, reproduce
    ("forward --legs 120 120 140 125 120 -1", "error: --legs: expected positive lengths"),
    (f"statics {POSE} --unit cm", "a wrench or a twist"),
    (f"statics {POSE} --unit cm --force 0 0 1 --branch FT+", "real branches, here TT+"),
    ("reproduce --table 7", "--table: expected numbers out of (1, 2, 3, 4, 5)"),
    # move
    ("move --leg-force 1500", "--from: expected either readings, or a pose by --from-translation"),
    (f"move --from {START} --to {START} --unit cm --leg-force 1500", "the same state"),
    (f"move {ENDS} --leg-rate 0.5", "--leg-force, --leg-acceleration: expected at least one of the two limits"),
    (f"move {ENDS} --leg-force 5", "--leg-force: expected forces that hold the machine"),
    (f"move {ENDS} --leg-force 1500 --out motion.txt", "--out: expected a file name ending in .csv"),
    (f"move {ENDS} --leg-force 1500 --limits 110,110 150", "--limits: expected a number, or six"),
    (f"move {ENDS} --leg-acceleration 1 --via 130", "--via: expected six numbers separated by commas"),
    (f"move {ENDS} --leg-acceleration 1 --hip 9 -9", "--hip: expected a minimum below the maximum"),
    (f"move {ENDS} --leg-acceleration 1 --clearance -1", "--clearance: expected a distance"),
    # sweep
    (f"sweep {STORE}", "does not exist"),
    (f"sweep {STORE} --samples 5", "ranges beside --samples"),
    (f"sweep {STORE} --metric payload", "give --out alone"),
    (f"sweep {STORE} --x 0:1:5", "--y, --z, --xyx"),
    (f"sweep {STORE} --x 1:0:5 --y 0 --z 2 --xyx 1 2 3", "--x: expected start < stop"),
    (f"sweep {STORE} --x 37:44:4 --y 0 --z 250 --xyx 1 2 6 --legs 1:2:5", "not both"),
    (f"sweep {STORE} --legs 1:2:5 --legs 1 --legs 2", "one range, two, or six"),
    (f"sweep {STORE} --legs 1:2", "(start, stop, count)"),
    (f"sweep {STORE} --x 0 --y 0 --z 2 --xyx 3:1:5 0 0", "error: --xyx: expected start < stop"),
    (f"sweep {STORE} --legs 1:2:5 --metric conditioning --length 0", "--length: expected a positive number"),
    (f"sweep {STORE} --legs 1:2:5 --metric beauty", "--metric: expected a Metric, or names among reachable"),
    (f"sweep {STORE} --legs 1:2:5 --metric payload --leg-force -1", "--leg-force: expected a positive number"),
    (f"sweep {STORE} --legs 1:2:5 --workers 2 --scheduler tcp://127.0.0.1:1", "None if a scheduler"),
    # view
    ("view --path nope.csv", "error: --path: nope.csv: expected a readable CSV file in UTF-8, got No such file"),
    ("view --path path.md", "error: --path: expected a file name ending in .csv"),
    ("view --path a.csv --unit cm", "error: --unit: expected m beside --path, whose columns are in m"),
    (f"view --path a.csv --no-demo --branch TT+ {POSE}", "error: --path cannot be used with --translation, --branch"),
    ("view --no-open --host 203.0.113.7", "host: expected an address of this machine"),
    ("view --no-open --port 70000", "port: expected a port from 0 to 65535"),
    (f"view --no-open {EQUAL_LEGS} --branch FF+", "got FF+. The solutions of TT, FF form a continuous family"),
    (f"view --no-open {EQUAL_LEGS} --translation 1 2 3 --xyx 1 2 3", "both"),
    ("view --no-open --legs 9 0.1 9 1 1 1", "can be assembled"),
    ("view --no-open --translation 0 0 2 --xyx 0 0 0", "a pose with a real branch"),
    # workspace
    ("workspace --paper --resolution 1", "--resolution: expected a whole number of increments, at least 2, got 1"),
    ("workspace --limits 1.5 1.1", "exchanged"),
    ("workspace --limits 0.05 0.1", "Too short to join"),
    ("workspace --limits 110 150", "--limits was read in m: 150 m, on a machine of 2.64 m"),
    ("workspace --out fig.jpg", "--out: expected a file name ending in .png, .svg, .pdf, .stl"),
    ("workspace --out map.zarr", "Maps over many poses are for spm-pin sweep"),
]


@pytest.mark.parametrize(("command", "words"), REFUSED)
def test_what_cannot_end_well_is_refused(
    command: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = run(*shlex.split(command))
    assert (done.returncode, done.stdout) == (2, "")
    assert words in done.message
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
