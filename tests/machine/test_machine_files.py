"""Geometries read from YAML files, and invalid files."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from text_files import written

import spm_pin as spm

GOOD = """\
base_side: 1.20
middle_side: 0.80
platform_side: 0.60
leg_limits: [1.10, 1.50]
"""


SIDES = "base_side: 1\nplatform_side: 1\nmiddle_side: 1\n"
LEG_BY_LEG = "".join(f"  {leg}: [{1 + k / 10}, {2 + k / 10}]\n" for k, leg in enumerate(spm.machine.LEGS))
Q = 3**0.5


@pytest.mark.parametrize(
    ("text", "machine"),
    [
        ("base_radius: 0.5\nplatform_side: 0.3\nmiddle_side: 0.4\n", spm.Manipulator(0.5, 0.3 / Q, 0.4)),
        ("\ufeff" + GOOD, spm.Manipulator.paper()),  # the byte order mark of editors on Windows
        (
            f"{SIDES}leg_limits:\n{LEG_BY_LEG}",
            spm.Manipulator(1 / Q, 1 / Q, 1, spm.LegLimits([1, 1.1, 1.2, 1.3, 1.4, 1.5], [2, 2.1, 2.2, 2.3, 2.4, 2.5])),
        ),
        (f"{SIDES}leg_limits: [0, .inf]\n", spm.Manipulator(1 / Q, 1 / Q, 1, spm.LegLimits(0.0, float("inf")))),
        *(
            (
                f"base_radius: 0.1\nmiddle_side: 0.1\nplatform_radius: {number}\n",
                spm.Manipulator(0.1, float(number), 0.1),
            )
            for number in ("1e-3", "1.0e+0", "+.5", "3.", "2")
        ),
    ],
)
def test_a_file_gives_its_geometry(tmp_path: Path, text: str, machine: spm.Manipulator) -> None:
    assert spm.Manipulator.from_yaml(written(tmp_path / "robot.yaml", text)) == machine


def test_rods_that_differ_from_leg_to_leg_are_those_of_a_machine_as_built(tmp_path: Path) -> None:
    text = GOOD.replace("leg_limits: [1.10, 1.50]", "upper_legs: {kind: PRS, rod: [1, 1.001, 1]}")
    machine = spm.Manipulator.from_yaml(written(tmp_path / "robot.yaml", text))
    assert not machine.is_nominal
    assert machine.legs.kinds == (spm.RPS(), spm.PRS(rod=(1.0, 1.001, 1.0)))
    assert machine == spm.Manipulator(1.2 / Q, 0.6 / Q, 0.8, legs=machine.legs.kinds)


def test_a_file_in_centimetres_gives_a_warning(tmp_path: Path) -> None:
    path = written(tmp_path / "robot.yaml", "base_side: 120\nmiddle_side: 80\nplatform_side: 60\n")
    with pytest.warns(UserWarning, match=r"middle_side is 80 m\. .* another unit\?"):
        assert spm.Manipulator.from_yaml(path).middle_side == 80.0


BOMB = "".join(
    f"{name}: &{name} [{', '.join(['*' + last] * 9)}]\n" for last, name in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base_side: 1\nmiddle_side: 1", "platform_side and platform_radius"),
        ("base_side: 1\nbase_radius: 1\nplatform_side: 1\nmiddle_side: 1", "base_side and base_radius"),
        ("base_side: 1\nplatform_side: 1", "middle_side"),
        (SIDES + "colour: red", "colour"),
        (SIDES + "leg_limits: 1", "a list"),
        (f"{SIDES}leg_limits: {{lower: [1, 2], upper: [1, 2]}}", "r_b1"),
        (SIDES + "leg_limits: [a, b]", "a list of 2 numbers"),
        ("", "an empty file"),
        (GOOD.replace("1.20", "0"), r"^base_side in .*robot\.yaml: expected a positive length"),
        (GOOD.replace("0.80", "8e12"), r"^middle_side in .*robot\.yaml: .* Is it in another unit\?"),
        (GOOD.replace("[1.10, 1.50]", "[1.5, 1.1]"), r"^leg_limits in .*robot\.yaml: .* exchanged\?"),
        (GOOD + "middle_side: 0.9\n", "(?s)the key 'middle_side' twice.*line 5"),
        (GOOD.replace("[1.10, 1.50]", "{r_b1: [1, 2], r_b1: [1, 2]}"), "(?s)the key 'r_b1' twice.*line 4"),
        (f"a: &a lol\n{BOMB}leg_limits: *i\n", "an alias within an anchored node"),
        ("[" * 10_000, "a YAML file"),
        ("# " + "x" * 2_000_000, "at most 1048576 characters"),
        ('base_side: "\\UFFFFFFFF"', "a YAML file"),
        ("base_side: 1.2\x00", "a YAML file"),
        ("%YAML 99999.1\n---\n" + GOOD, "a YAML file"),
        (GOOD.replace("1.20", "!!float x"), "^base_side in .* positive length"),
        (GOOD.replace("1.20", "!!python/object/apply:os.system [ls]"), "positive length"),
        (GOOD.replace("1.20", "010"), "positive length"),
        (GOOD + "0: 1\n0.0: 2\n", "(?s)the key 0.0 twice.*line 6"),
        (GOOD.replace("1.20", "1:99"), "positive length"),
        (GOOD.replace("1.20", "1e400"), "positive length"),
        (GOOD.replace("1.20", ".nan"), "positive length"),
        (GOOD.replace("1.20", "'1.2'"), "positive length"),
        (GOOD.replace("middle_side", "d"), r"got the key 'd'\. d is middle_side"),
        ("? [a, b]\n: 1\n" + GOOD, "unhashable key"),
        ("<<: {middle_side: 1}\n" + GOOD, "the key '<<'"),
        (GOOD + "---\n" + GOOD, "a YAML file"),
        ("null", "a mapping"),
    ],
)
def test_a_malformed_file_gives_a_short_geometry_error(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(spm.GeometryError, match=words) as caught:
        spm.Manipulator.from_yaml(written(tmp_path / "robot.yaml", text))
    assert len(str(caught.value)) < 1500


def test_no_file_and_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    with pytest.raises(spm.GeometryError, match="No such file"):
        spm.Manipulator.from_yaml(path)
    path.write_bytes(b"base_side: \xff\xfe")
    with pytest.raises(spm.GeometryError, match="text in UTF-8"):
        spm.Manipulator.from_yaml(path)


WORDS = ["- ", "? ", "&a ", "*a", "!!", "---\n", "...\n", "<<: ", "0x", ".inf", "1e999", "\n", "\ufeff"]
FRAGMENTS = st.sampled_from(WORDS) | st.sampled_from(":[]{}!%|>'\"\\#@`.e~\t") | st.text(max_size=3)
EDIT = st.tuples(st.integers(0, len(GOOD)), st.integers(0, 6), FRAGMENTS)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(EDIT, min_size=1, max_size=4))
@pytest.mark.filterwarnings("ignore:.*another unit")
def test_a_mutated_file_gives_a_geometry_or_a_geometry_error(tmp_path: Path, edits: list[tuple[int, int, str]]) -> None:
    text = GOOD
    for at, removed, inserted in edits:
        text = text[:at] + inserted + text[at + removed :]
    path = tmp_path / "robot.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with contextlib.suppress(spm.GeometryError):
        assert spm.Manipulator.from_yaml(path).middle_side > 0.0


@pytest.mark.filterwarnings("ignore:.*another unit")
@pytest.mark.parametrize("limits", [None, spm.LegLimits([1.0, 1.1, 1.2, 0.9, 0.8, 0.7], [1.5, np.inf, 2, 2, 2, 2])])
def test_a_file_there_and_back_keeps_every_bit(tmp_path: Path, limits: spm.LegLimits | None) -> None:
    nominal = spm.Manipulator(0.7, 1e-7, 0.8, limits)
    built = nominal.perturbed(2, length=1e-9, angle=1e-3)
    file = tmp_path / "machine.yaml"
    built.to_yaml(file)
    assert spm.Manipulator.from_yaml(file) == built
    assert "r_b1:" in file.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("offset: 0.0", "offset: zero", "offset"),
        ("offset: 0.0", "ofset: 0.0", "ofset"),
        (
            "axis: [0.5, 0.8660254037844386, 0.0]",
            "axis: [0.5, 0.866]",
            "axis of r_b1 of legs in .* 3 numbers.* 2 members",
        ),
        ("axis: [0.5, 0.8660254037844386, 0.0]", "axis: [0.5, 0.5, 0.0]", "axes of legs in .*yaml"),
        ("r_b1:", "r_b9:", "r_b9"),
    ],
)
def test_errors_of_a_file_name_the_key(tmp_path: Path, old: str, new: str, message: str) -> None:
    file = tmp_path / "machine.yaml"
    legs = spm.Manipulator(0.7, 0.4, 0.8).legs
    spm.Manipulator(0.7, 0.4, 0.8, legs=replace(legs, offsets=[0, 0, 0, 0, 0, 1e-3])).to_yaml(file)
    text = file.read_text(encoding="utf-8")
    assert old in text, text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(spm.GeometryError, match=message):
        spm.Manipulator.from_yaml(file)
