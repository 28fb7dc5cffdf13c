"""Properties of every subcommand: messages, outputs, tables, hints, exit codes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli.running import COMMAND, LEGS, run
from cli.running import POSE as EXAMPLE
from scipy.spatial.transform import RigidTransform, Rotation
from typer.main import get_command

import spm_pin as spm
from spm_pin.cli import outputs
from spm_pin.cli.application import EXIT_CODES, app
from spm_pin.cli.options import ARGUMENT_OPTIONS
from spm_pin.crosscheck import METHODS, ClosedForm
from spm_pin.display.writing import fixed, to_json

LOAD = ["--force", "0", "0", "-500", "--velocity", "1", "0", "0"]
COMMANDS = [command.callback.__name__ for command in app.registered_commands if command.callback]
ROOT = Path(__file__).parents[2]


@pytest.fixture
def screen(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Return a function that makes stdout a terminal of a width."""

    def terminal(width: int) -> None:
        monkeypatch.setattr(outputs.stdout, "_force_terminal", True)
        monkeypatch.setattr(outputs.stdout, "_width", width)

    return terminal


def plain(text: str) -> str:
    return re.sub(r"\x1b\[[\d;]*m", "", text)


# Messages


def test_brackets_in_any_text_are_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    text = "[viewer] [/] [bold red]x[/bold red] [link=a]b"
    outputs.print_lines([text])
    outputs.Table(text, {"a": str, text: str}, [text]).print()
    outputs.note(text)
    printed = capsys.readouterr()
    assert printed.out.count(text) == 5
    assert text in printed.err


@pytest.mark.documents
def test_every_command_has_a_row_in_the_readme() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [command for command in COMMANDS if f"\n| `spm-pin {command}` | " not in readme] == []


def test_options_named_in_errors_exist() -> None:
    groups: Any = get_command(app).commands, get_command(app).commands["stage"].commands  # type: ignore[attr-defined]
    commands = [command for group in groups for command in group.values() if not hasattr(command, "commands")]
    typed = [{option for parameter in command.params for option in parameter.opts} for command in commands]
    for names in ARGUMENT_OPTIONS.values():
        assert any(set(names.split(", ")) <= options for options in typed), names


def test_every_way_to_write_an_orientation_is_the_same_pose() -> None:
    turn = Rotation.from_euler("XYX", [-11.08, 32.97, -12.88], degrees=True)
    ways = {
        "--xyx": [-11.08, 32.97, -12.88],
        "--rpy": turn.as_euler("xyz", degrees=True),
        "--quat": turn.as_quat(),
        "--rotvec": turn.as_rotvec(degrees=True),
        "--matrix": turn.as_matrix().ravel(),
    }
    answers = []
    for option, numbers in ways.items():
        done = run(
            "inverse", *EXAMPLE[:4], option, *(repr(float(number)) for number in numbers), "--unit", "cm", "--json"
        )
        answers.append([branch["readings"] for branch in json.loads(done.stdout)["branches"]])
    assert len(answers[0]) == 6
    for answer in answers[1:]:
        np.testing.assert_allclose(answer, answers[0], atol=1e-8)


def test_branches_are_named_in_either_case() -> None:
    done = run("singularities", *EXAMPLE, "--unit", "cm", "--branch", "tt+")
    assert (done.returncode, done.stdout.count("TT+")) == (5, 1)


# Units


@pytest.mark.parametrize(
    ("command", "code", "hint"),
    [
        (["inverse", *EXAMPLE], 3, " m, on a machine of 2.64 m. In cm it would be in proportion: --unit cm"),
        (["statics", *EXAMPLE, *LOAD], 3, "--unit cm"),
        (["forward", *LEGS], 3, "--legs was read in m: 150 m, on a machine of 2.64 m"),
        (["inverse", "--translation", "0.6889", "0.4963", "2.253", *EXAMPLE[4:], "--unit", "cm"], 5, "--unit m"),
        # In proportion, yet out of reach.
        (["inverse", "--translation", "2", "2", "2", "--xyx", "10", "20", "30"], 3, ""),
        (["forward", "--legs", "1.2", "0.1", "1.2", "1.2", "1.2", "1.2"], 3, ""),
    ],
)
def test_lengths_in_the_wrong_unit_are_answered_with_the_right_one(command: list[str], code: int, hint: str) -> None:
    done = run(*command)
    assert done.returncode == code
    text = " ".join(done.output.split())
    assert hint in text
    assert ("--unit" in text) == bool(hint)


def test_a_geometry_file_in_centimetres_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("base_side: 120\nplatform_side: 60\nmiddle_side: 80\n", encoding="utf-8")
    done = run("inverse", *EXAMPLE, "--machine", path)
    assert done.returncode == 0
    assert "--machine: " in done.message
    assert "middle_side is 80 m" in done.message
    assert "Warning" not in done.stderr


def test_angles_beyond_a_full_turn_are_degrees_on_the_command_line() -> None:
    within, beyond = (
        run("inverse", *EXAMPLE[:5], str(-11.08 + turn), *EXAMPLE[6:], "--unit", "cm") for turn in (0, 360)
    )
    assert (beyond.stderr, beyond.returncode) == ("", 5)
    assert beyond.stdout.splitlines()[:8] == within.stdout.splitlines()[:8]


def test_a_level_pose_is_explained_with_a_way_on() -> None:
    level = ["--translation", "0", "0", "2.2", "--xyx"]
    done = run("inverse", *level, "0", "0", "0")
    assert done.returncode == 4
    assert "The platform is level" in done.stdout
    # A slight tilt is enough for branches, but not within the limits.
    tilted = run("inverse", *level, "0", "0.1", "0")
    assert tilted.returncode == 5
    assert "* a leg beyond the limits\nNo branch is physical" in tilted.stdout


# Numbers


@pytest.mark.parametrize(
    "arguments",
    [
        ["inverse", *EXAMPLE, "--unit", "cm"],
        ["statics", *EXAMPLE, "--unit", "mm", *LOAD],
        ["workspace", "--paper", "--resolution", "2", "--unit", "mm"],
        ["reproduce", "--cells", "--table", "4", "--table", "5"],
    ],
    ids=lambda arguments: arguments[0],
)
def test_numbers_are_never_cut(arguments: list[str], screen: Callable[[int], None]) -> None:
    piped = run(*arguments)
    screen(80)
    shown = run(*arguments)
    assert "…" not in piped.stdout + shown.stdout
    table = [line for line in piped.stdout.splitlines() if "  " in line or "─" in line]
    assert set(table) <= set(plain(shown.stdout).splitlines())
    # Options to be copied stay on one line, however long.
    assert 0 < max(len(line) for line in table if not line.startswith("  --")) <= 80


def test_a_pipe_has_no_width(monkeypatch: pytest.MonkeyPatch) -> None:
    wide = run("inverse", *EXAMPLE, "--unit", "cm").stdout
    monkeypatch.setenv("COLUMNS", "20")
    assert run("inverse", *EXAMPLE, "--unit", "cm").stdout == wide


@pytest.mark.parametrize("arguments", [["--help"], ["reproduce", "--table", "2"]])
def test_a_width_of_zero_is_an_unknown_one(arguments: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def output() -> tuple[str, str]:
        done = subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, check=False)
        return done.stdout, done.stderr

    monkeypatch.delenv("COLUMNS", raising=False)
    usual = output()
    assert any(usual)
    monkeypatch.setenv("COLUMNS", "0")
    assert output() == usual


@pytest.mark.parametrize("value", [0.0, -0.0, -1.1e-15, 4e-14])
def test_zeros_are_printed_as_zero(value: float) -> None:
    assert fixed(value, 3) == "0.000"
    assert outputs.significant(value, scale=1.0) == "0"
    assert "-" not in to_json([value if value == 0.0 else -0.0, np.array(-0.0)])
    assert fixed(-0.0006, 3) == "-0.001"
    assert outputs.significant(-4.4527e-9, scale=1.0) == "-4.4527e-09"


def test_json_has_null_for_what_is_not_finite() -> None:
    assert json.loads(to_json({"a": [np.nan, np.inf, np.array([1, np.nan])]})) == {"a": [None, None, [1, None]]}


# Outputs and extras, before the work


@pytest.mark.parametrize(
    ("arguments", "option"),
    [
        (["crosscheck", "--figure", "{}.png"], "--figure"),
        (["export", "mjcf", "--out", "{}.xml"], "--out"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_outputs_are_checked_before_the_work(
    arguments: list[str], option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ending = Path(arguments[-1]).suffix
    folder = tmp_path / f"folder{ending}"
    folder.mkdir()
    ready = tmp_path / f"ready{ending}"
    (tmp_path / "file").touch()
    for target, words in (
        (ready.parent / "file" / f"no{ending}", "file is not a directory"),
        (folder, "It is a directory"),
        (ready, "No permission to write"),
    ):
        if target is ready:
            monkeypatch.setattr("spm_pin.cli.outputs.os.access", lambda *_: False)
        done = run(*arguments[:-1], target)
        assert done.returncode == 2
        assert f"error: {option}: expected a file that can be written" in done.message
        assert words in done.message
        assert done.stdout == ""
    assert {path.name for path in tmp_path.iterdir()} == {folder.name, "file"}


@pytest.mark.parametrize(
    "arguments",
    [
        ["export", "srdf", "--out", "{}/robot.srdf"],
        ["export", "c", "--out", "{}"],
        ["sweep", "--legs", "1.2:1.3:2", "--metric", "reachable", "--workers", "1", "--out", "{}/map.zarr"],
    ],
    ids=lambda arguments: " ".join(arguments[:2]),
)
def test_folders_of_outputs_are_made(arguments: list[str], tmp_path: Path) -> None:
    done = run(*(text.format(tmp_path / "a" / "b") for text in arguments))
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "a" / "b").iterdir())


@pytest.mark.parametrize(
    ("arguments", "extra", "package"),
    [
        (["draw", "--out", "x.png"], "plots", "matplotlib"),
        (["view", "--no-open"], "viewer", "viser"),
    ],
)
def test_an_option_that_needs_a_missing_extra_is_refused_before_the_work(
    arguments: list[str], extra: str, package: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, package, None)
    done = run(*arguments)
    assert done.returncode == 2
    assert f'this needs {package} of the extra {extra}: pip install ".[{extra}]"' in done.message
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


# Tracebacks and exit codes


def test_a_defect_ends_without_a_traceback_unless_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("[a] detail")

    monkeypatch.setattr("spm_pin.cli.requests.inverse_displacement", broken)
    done = run("inverse", *EXAMPLE)
    assert done.returncode == 70
    assert "error: ZeroDivisionError: [a] detail" in done.message
    assert "Traceback" not in done.stderr
    monkeypatch.setenv("SPM_PIN_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        run("inverse", *EXAMPLE)


def test_the_version_and_all_exit_codes_are_documented() -> None:
    assert run("--version").stdout.strip() == f"spm-pin {spm.__version__}"
    codes = {0, 1, 2, 3, 4, 5, 70, 74, 130}
    assert {int(code) for code in re.findall(r"(?<!\d)(\d+) (?!more)", EXIT_CODES)} == codes
    shown = " ".join(run("--help").stdout.replace("│", " ").split())
    assert " ".join(EXIT_CODES.split()) in shown
    page = (ROOT / "docs/howto/command_line.md").read_text(encoding="utf-8")
    assert {int(code) for code in re.findall(r"^\| (\d+) \|", page, flags=re.MULTILINE)} == codes


# Outputs of any kind


def test_an_encoding_without_a_sign_gets_one_that_it_has() -> None:
    done = run("singularities", *EXAMPLE, "--unit", "cm", encoding="ascii")
    assert (done.returncode, "defect" in done.stderr) == (5, False)
    assert "d^3" in done.stdout
    assert "---" in done.stdout
    assert "?" not in done.stdout


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full")
def test_a_full_device_is_an_error_of_its_own() -> None:
    for errors in ("/dev/null", "/dev/full"):
        with Path("/dev/full").open("w") as full, Path(errors).open("w") as other:
            command = [*COMMAND, "inverse", *EXAMPLE, "--unit", "cm"]
            stderr = subprocess.PIPE if errors == "/dev/null" else other
            done = subprocess.run(command, stdout=full, stderr=stderr, text=True, check=False)
        assert done.returncode == 74
        if errors == "/dev/null":
            assert done.stderr.splitlines()[-1].startswith("error: input or output failed: [Errno 28]")
            assert "Traceback" not in done.stderr
            assert "defect" not in done.stderr


def test_a_reader_that_has_seen_enough_is_told_nothing() -> None:
    command = [*COMMAND, "reproduce", "--cells"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        errors = process.stderr.read().decode()
    assert process.returncode == 74  # and not 1, a comparison that failed
    assert "Traceback" not in errors
    assert "error" not in errors


@pytest.mark.parametrize(
    ("command", "name"),
    [
        ("reproduce --out", "tables.json"),
        ("crosscheck --poses 2 --method closed-form --method nlp --out", "report.json"),
        ("certify --limits 1.25 1.35 --boxes 100 --out", "boxes.png"),
        ("move --from 1.2 1.2 1.4 1.25 1.2 1.5 --to 1.25 1.2 1.4 1.2 1.2 1.5 --leg-force 1500 --out", "motion.csv"),
        ("workspace --paper --resolution 2 --out", "shell.stl"),
    ],
)
def test_files_are_written_even_if_the_reader_of_stdout_has_gone(
    command: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: object, **__: object) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(outputs.stdout, "print", gone)
    assert run(*command.split(), tmp_path / name).returncode == 74
    assert (tmp_path / name).stat().st_size


# Long commands


INTERRUPTED_IMPORT = """
import sys
class Interrupted:
    def find_spec(self, name, path=None, target=None):
        if name == {!r}:
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupted())
from spm_pin.cli import main
main()
"""
IN_A_CALLBACK = """
import ctypes, signal, time
from spm_pin.cli import application, main
call = ctypes.CFUNCTYPE(None)(lambda: signal.raise_signal(signal.SIGINT))
application.run = lambda interrupted: (call(), time.sleep(60), print("went on"))
main()
"""
IMPORTS = [INTERRUPTED_IMPORT.format(module) for module in ("spm_pin.cli.application", "scipy.spatial")]


@pytest.mark.parametrize("program", [*IMPORTS, IN_A_CALLBACK], ids=["own import", "import", "callback"])
def test_ctrl_c_during_an_import_or_while_a_library_calls_python_back_is_not_lost(program: str) -> None:
    command = [sys.executable, "-c", program, "inverse", *EXAMPLE]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "interrupted\n")


class Interrupting(ClosedForm):
    """The closed form, interrupted at its third batch of poses."""

    batches = 0

    def inverse(self, pose: RigidTransform) -> spm.SolutionSet:
        type(self).batches += 1
        if type(self).batches == 3:
            raise KeyboardInterrupt
        return super().inverse(pose)


def test_an_interrupted_crosscheck_reports_what_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "closed-form", Interrupting)
    monkeypatch.setattr(Interrupting, "batches", 0)
    target = tmp_path / "report.json"
    done = run("crosscheck", "--poses", "40", "--method", "closed-form", "--method", "nlp", "--out", target)
    assert done.returncode == 130
    assert done.stdout.startswith("Interrupted after 20 of 40 poses")
    content = json.loads(target.read_text(encoding="utf-8"))
    assert (len(content["poses"]), content["requested"], content["agrees"]) == (20, 40, True)
    monkeypatch.setattr(Interrupting, "batches", 2)
    done = run("crosscheck", "--poses", "40", "--method", "closed-form")
    assert (done.returncode, done.stdout) == (130, "")
    assert "Traceback" not in done.stderr


@pytest.mark.documents
def test_the_demo_begins_with_the_verdict_and_ends_with_what_to_try(tmp_path: Path) -> None:
    done = run("demo", "--poses", "10", "--out", tmp_path / "demo.png")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("The paper:   105 of the 120 cells of Tables 1 to 5 agree")
    assert f"All {len(METHODS)} methods agree." in " ".join(done.stdout.split())
    assert (tmp_path / "demo.png").read_bytes().startswith(b"\x89PNG")
    assert len(lines) <= 30
    assert [line.split()[0] for line in lines[lines.index("Try next:") + 1 :]] == ["spm-pin"] * 3
