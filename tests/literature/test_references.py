"""References: keys have entries, entries are cited and say what was read of them, novelty is stated in one place."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.documents

ROOT = Path(__file__).parents[2]
RELATED = ROOT / "docs/related_work.md"
ENTRIES = re.split(r"\n(?=@)", (ROOT / "docs/references.bib").read_text(encoding="utf-8"))[1:]
KEYS = {entry.partition("{")[2].partition(",")[0] for entry in ENTRIES}
PAGES = [*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), *ROOT.glob("examples/*.md")]
SOURCES = [ROOT / "CITATION.cff", *ROOT.glob("spm_pin/**/*.py"), *ROOT.glob("examples/*.py")]
NOVELTY = r"(?i)\b(seems? new|beyond the paper|novel|unpublished|for the first time|unknown until)\b"
"""The agreed wording is "seems new"; the others are those that must not stand in its place."""


def test_every_entry_is_cited_in_related_work_and_says_what_was_read() -> None:
    text = RELATED.read_text(encoding="utf-8")
    assert len(KEYS) == len(ENTRIES) > 30
    assert {key for key in KEYS if f"[{key}]" not in text} == set()
    read = r"checked\s*= \{(text|abstract|beginning of the abstract|data|title|memory|only what)"
    assert [entry for entry in ENTRIES if not re.search(read, entry)] == []


def test_every_key_on_a_page_has_an_entry() -> None:
    key = r"\[([a-z]+\d{4}|[a-z]+_[a-z0-9_]+)\](?!\()"
    cited = {found for page in PAGES for found in re.findall(key, page.read_text(encoding="utf-8"))}
    assert len(cited) > 30
    assert cited - KEYS == set()


def test_novelty_is_stated_in_related_work_or_with_a_link_to_it() -> None:
    lines = [
        (path.name, line)
        for path in (*PAGES, *SOURCES)
        if path != RELATED
        for line in path.read_text(encoding="utf-8").splitlines()
    ]
    stated = [found for found in lines if re.search(NOVELTY, re.sub("of a Novel|a Novel 3RPS", "", found[1]))]
    assert stated, "the wording is not found any more"
    assert [found for found in stated if "related_work" not in found[1]] == []


def test_each_new_result_has_a_page_and_says_how_sure_it_is() -> None:
    rows = re.findall(r"^\| N(\d+) \|(.*)\|(.*)\|(.*)\|$", RELATED.read_text(encoding="utf-8"), flags=re.MULTILINE)
    assert [int(row[0]) for row in rows] == list(range(1, len(rows) + 1))
    for _, _, where, how_sure in rows:
        assert "](" in where
        assert re.search(r"derived|tested|proved|observed|computed|diagnosis", how_sure), how_sure


def test_the_contents_of_the_theory_name_every_page_once() -> None:
    theory = ROOT / "docs/theory"
    contents = (theory / "README.md").read_text(encoding="utf-8")
    named = re.findall(r"^\d+\. \[[^]]*\]\((\w+\.md)\)", contents, flags=re.MULTILINE)
    assert sorted([*named, "README.md"]) == sorted(page.name for page in theory.glob("*.md"))
