"""Reading closures, and errors that name the line."""

from __future__ import annotations

from pathlib import Path

import pytest
from text_files import assert_refused, written

from spm_pin.description.closures import Closure, read_closures
from spm_pin.errors import DescriptionError

GOOD = """# a comment
closures:
  - {name: one, kind: point, frame_a: left, frame_b: right}
  - name: two
    kind: point
    frame_a: up
    frame_b: down
"""


def test_the_four_balls() -> None:
    assert read_closures() == (
        Closure("closure_b2", "point", "middle_b2", "leg_b2_tip"),
        Closure("closure_b3", "point", "middle_b3", "leg_b3_tip"),
        Closure("closure_c2", "point", "middle_b2", "leg_c2_tip"),
        Closure("closure_c3", "point", "middle_b3", "leg_c3_tip"),
    )


def test_reading_another_file(tmp_path: Path) -> None:
    path = written(tmp_path / "closures.yaml", GOOD)
    one, two = read_closures(str(path), prefix="p_")
    assert one == Closure("p_one", "point", "p_left", "p_right")
    assert two == Closure("p_two", "point", "p_up", "p_down")


@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("", None, "the key closures, got an empty file"),
        ("- a\n- b\n", 1, "a mapping with the keys closures, got a sequence"),
        ("clousures: []\n", 1, "got the key 'clousures'. Misspelt?"),
        ("closures: 3\n", 1, "a list under the key closures, got '3'"),
        (GOOD.replace("kind: point, ", "", 1), 3, "no key kind"),
        (GOOD.replace("frame_a: up", "frame_c: up"), 6, "the key 'frame_c'"),
        (GOOD.replace("frame_a: up", "kind: point"), 6, "the key 'kind' twice"),
        (GOOD.replace("frame_a: up", "frame_a: 7"), 6, "a name under the key frame_a, got '7'"),
        (GOOD.replace("frame_a: up", "frame_a: [up]"), 6, "a name under the key frame_a, got a sequence"),
        (GOOD.replace("frame_a: up", "frame_a:"), 6, "a name under the key frame_a"),
        (GOOD.replace("frame_a: up", "frame_a: ''"), 4, "a name under the key frame_a"),
        (GOOD.replace("kind: point\n", "kind: glue\n"), 4, "one of point, weld under the key kind, got 'glue'"),
        (GOOD.replace("frame_a: up", "frame_a: right").replace("down", "left"), 4, "right and left, as in one"),
        ("closures: [{[a]: b}]\n", 1, "the key a sequence"),
        (GOOD.replace("frame_b: down", "frame_b: up"), 4, "another frame than frame_a under the key frame_b"),
        (GOOD.replace("name: two", "name: one"), 4, "a name of its own under the key name, got 'one'"),
        ("closures: [\n", None, "a YAML file"),
    ],
)
def test_malformed_files(tmp_path: Path, text: str, line: int | None, said: str) -> None:
    assert_refused(read_closures, written(tmp_path / "closures.yaml", text), line, said)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(DescriptionError, match="No such file"):
        read_closures(tmp_path / "none.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(DescriptionError, match="a YAML file"):
        read_closures(tmp_path / "binary.yaml")


def test_closures_validate_themselves() -> None:
    with pytest.raises(DescriptionError, match="kind"):
        Closure("a", "glue", "b", "c")
    with pytest.raises(DescriptionError, match="frame_b"):
        Closure("a", "point", "b", "b")
    with pytest.raises(DescriptionError, match="name"):
        Closure("", "point", "b", "c")
