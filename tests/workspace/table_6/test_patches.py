"""Table 6 as data: every cell is read or refused, and its rows close to a sphere."""

from __future__ import annotations

from collections import Counter

import pytest

import spm_pin as spm
from spm_pin.paper import published
from spm_pin.paper.published import Range
from spm_pin.workspace.table_6.patches import ERRATA, Setting, SubWorkspace, orientations, sub_workspaces

ROWS = sub_workspaces()
CYCLE = (1, 2, 0, 4, 5, 3)  # leg 1 takes the settings of leg 2, and so on
MIRROR = (2, 1, 0, 5, 4, 3)


def relabelled(rows: tuple[SubWorkspace, ...], order: tuple[int, ...]) -> set[tuple[Setting, ...]]:
    return {tuple(row.settings[leg] for leg in order) for row in rows}


def test_every_row_has_four_legs_at_limits_and_two_that_vary() -> None:
    assert len(ROWS) == len({row.settings for row in ROWS}) == 24
    assert all(row.settings.count(Setting.VARIES) == 2 for row in ROWS)
    assert Counter(row.family for row in ROWS) == {"St": 3, "Sc": 9, "Sm": 9, "Sl": 3}


def test_the_surface_that_the_text_describes() -> None:
    # Step 1: r_b3 = r_bmax and all r_c = r_cmax; steps 2 and 3: r_b1 and r_b2 vary.
    high, varies = Setting.MAXIMUM, Setting.VARIES
    assert ROWS[0].name == "St1"
    assert ROWS[0].settings == (varies, varies, high, high, high, high)
    steps = ROWS[0].lattice(5)
    assert steps.shape == (6, 6, 6)
    assert steps[2, 4].tolist() == [2, 4, 5, 5, 5, 5]


def test_the_rows_close_to_a_sphere() -> None:
    corners = {corner for row in ROWS for corner in row.corners}
    edges = Counter(frozenset(side) for row in ROWS for side in row.sides)
    assert (len(corners), len(edges), len(ROWS)) == (26, 48, 24)
    assert len(corners) - len(edges) + len(ROWS) == 2
    assert set(edges.values()) == {2}


def test_oriented_rows_run_along_each_edge_both_ways() -> None:
    senses = Counter()
    for row, sign in zip(ROWS, orientations(ROWS), strict=True):
        senses.update(row.sides if sign > 0 else [(end, start) for start, end in row.sides])
    assert set(senses.values()) == {1}
    assert all((end, start) in senses for start, end in senses)


@pytest.mark.parametrize("order", [CYCLE, MIRROR])
def test_the_table_is_symmetric_in_the_legs(order: tuple[int, ...]) -> None:
    assert relabelled(ROWS, order) == relabelled(ROWS, tuple(range(6)))


def test_only_the_misprints_named_are_misprints() -> None:
    """All other cells name their own column's stage, and the erroneous ones stand in the table as printed."""
    found = {}
    for name, cells in published.TABLE_6:
        for leg, cell in zip(spm.mechanism.LEGS, cells, strict=True):
            limits = {f"{leg[2]}min", f"{leg[2]}max"}
            if not {limit for limit in cell if limit} <= limits:
                found[name, leg] = cell
    assert found == ERRATA


def test_other_corrections_of_a_misprint_open_the_surface() -> None:
    other = {Setting.MINIMUM: Setting.MAXIMUM, Setting.MAXIMUM: Setting.MINIMUM, Setting.VARIES: Setting.MINIMUM}
    for name, leg in ERRATA:
        (k,) = [k for k, row in enumerate(ROWS) if row.name == name]
        settings = list(ROWS[k].settings)
        settings[spm.mechanism.LEGS.index(leg)] = other[settings[spm.mechanism.LEGS.index(leg)]]
        if settings.count(Setting.VARIES) == 2:
            with pytest.raises(spm.ArgumentError, match="two at every edge"):
                orientations([*ROWS[:k], SubWorkspace(name, tuple(settings)), *ROWS[k + 1 :]])


@pytest.mark.parametrize(
    ("cell", "says"),
    [
        (Range("cmax"), "bmin, bmax or bmin~bmax for r_b2 of St1, got cmax"),
        (Range("bmax", "bmin"), "got bmax~bmin"),
        (Range("mmax"), "misprint that ERRATA does not name"),
        (Range("bmin"), "two varying legs in every row, got 1 in St1"),
    ],
)
def test_cells_that_cannot_be_parsed(monkeypatch: pytest.MonkeyPatch, cell: Range, says: str) -> None:
    name, cells = published.TABLE_6[0]
    row = (name, (cells[0], cell, *cells[2:]))
    monkeypatch.setattr(published, "TABLE_6", (row, *published.TABLE_6[1:]))
    with pytest.raises(spm.ArgumentError, match=says):
        sub_workspaces()


def test_rows_that_do_not_close() -> None:
    with pytest.raises(spm.ArgumentError, match="shared by one or by several"):
        orientations(ROWS[:-1])
    with pytest.raises(spm.ArgumentError, match="shared by one or by several"):
        orientations([*ROWS, ROWS[0]])


def cube(settings: str) -> list[SubWorkspace]:
    """The six faces of a cube in leg space: * for the three legs that span it, 0 or 1 for those at limits."""
    of = {"0": Setting.MINIMUM, "1": Setting.MAXIMUM, "*": Setting.VARIES}
    spanning = [k for k, letter in enumerate(settings) if letter == "*"]
    faces = [settings[:k] + end + settings[k + 1 :] for k in spanning for end in "01"]
    return [SubWorkspace(f"Q{k}", tuple(of[letter] for letter in face)) for k, face in enumerate(faces)]


def test_a_cube_closes_and_two_of_them_are_refused() -> None:
    assert len(orientations(cube("***000"))) == 6
    with pytest.raises(spm.ArgumentError, match="a separate piece"):
        orientations([*cube("***000"), *cube("111***")])
