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
