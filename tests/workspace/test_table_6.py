"""Table 6 as data: every cell is legible or a misprint named, and its rows close to a sphere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import pytest

import spm_pin as spm
from spm_pin.paper import published
from spm_pin.workspace.paper_shell import ERRATA, SENSES, LegSetting, SubWorkspace, sub_workspaces

ROWS = sub_workspaces()
CYCLE = (1, 2, 0, 4, 5, 3)  # leg 1 takes the settings of leg 2, and so on
MIRROR = (2, 1, 0, 5, 4, 3)


def relabelled(rows: tuple[SubWorkspace, ...], order: tuple[int, ...]) -> set[tuple[LegSetting, ...]]:
    return {tuple(row.settings[leg] for leg in order) for row in rows}


def outline(row: SubWorkspace) -> list[tuple[int, ...]]:
    """Return the four corners, 0 at a minimum and 1 at a maximum: first varying leg out, second out, both back."""
    square = row.increments(1)
    return [tuple(square[at].tolist()) for at in ((0, 0), (1, 0), (1, 1), (0, 1))]


def sides(row: SubWorkspace) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    ring = outline(row)
    return list(zip(ring, [*ring[1:], ring[0]], strict=True))


def shared_edges(rows: Sequence[SubWorkspace]) -> Counter[frozenset[tuple[int, ...]]]:
    return Counter(frozenset(side) for row in rows for side in sides(row))


def test_every_row_has_four_legs_at_limits_and_two_that_vary() -> None:
    assert len(ROWS) == len({row.settings for row in ROWS}) == 24
    assert all(row.settings.count(LegSetting.VARIES) == 2 for row in ROWS)
    assert Counter(row.family for row in ROWS) == {"St": 3, "Sc": 9, "Sm": 9, "Sl": 3}


def test_the_surface_that_the_text_describes() -> None:
    # Step 1: r_b3 = r_bmax and all r_c = r_cmax; steps 2 and 3: r_b1 and r_b2 vary.
    high, varies = LegSetting.MAXIMUM, LegSetting.VARIES
    assert ROWS[0].name == "St1"
    assert ROWS[0].settings == (varies, varies, high, high, high, high)
    steps = ROWS[0].increments(5)
    assert steps.shape == (6, 6, 6)
    assert steps[2, 4].tolist() == [2, 4, 5, 5, 5, 5]


def test_the_rows_close_to_a_sphere() -> None:
    corners = {corner for row in ROWS for corner in outline(row)}
    edges = shared_edges(ROWS)
    assert (len(corners), len(edges), len(ROWS)) == (26, 48, 24)
    assert len(corners) - len(edges) + len(ROWS) == 2
    assert set(edges.values()) == {2}


def test_neighbours_run_along_their_common_edge_in_opposite_senses() -> None:
    directed = Counter(side[::sense] for row, sense in zip(ROWS, SENSES, strict=True) for side in sides(row))
    assert len(directed) == 96
    assert set(directed.values()) == {1}


@pytest.mark.parametrize("order", [CYCLE, MIRROR])
def test_the_table_is_symmetric_in_the_legs(order: tuple[int, ...]) -> None:
    assert relabelled(ROWS, order) == relabelled(ROWS, tuple(range(6)))


def test_only_the_misprints_named_are_misprints() -> None:
    """All other cells name their own column's stage, and the erroneous ones stand in the table as printed."""
    found = {}
    for name, *cells in published.TABLE_6:
        for leg, cell in zip(spm.mechanism.LEGS, cells, strict=True):
            low, high = f"{leg[2]}min", f"{leg[2]}max"
            if cell.replace("~", " ").split() not in ([low], [high], [low, high]):
                found[name, leg] = cell
    assert found == ERRATA


def test_other_corrections_of_a_misprint_open_the_surface() -> None:
    other = {
        LegSetting.MINIMUM: LegSetting.MAXIMUM,
        LegSetting.MAXIMUM: LegSetting.MINIMUM,
        LegSetting.VARIES: LegSetting.MINIMUM,
    }
    for name, leg in ERRATA:
        (k,) = [k for k, row in enumerate(ROWS) if row.name == name]
        settings = list(ROWS[k].settings)
        settings[spm.mechanism.LEGS.index(leg)] = other[settings[spm.mechanism.LEGS.index(leg)]]
        if settings.count(LegSetting.VARIES) == 2:
            assert set(shared_edges([*ROWS[:k], SubWorkspace(name, tuple(settings)), *ROWS[k + 1 :]]).values()) != {2}
