"""The documentation: its Python runs, its commands print what it shows, its links have targets."""

from __future__ import annotations

import inspect
import re
import shlex
import subprocess
import sys
from pathlib import Path
from urllib.parse import unquote

import live_page
import pytest
from command_reference import command_reference
from typer.main import get_command
from typer.testing import CliRunner

import spm_pin
from spm_pin.cli.application import app

pytestmark = pytest.mark.documents

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
LANGUAGES = {"python", "console", "sh", "yaml", "xml", "json", "c", "js", ""}
"""Python and console are run here, sh sets up a machine, the others are contents of files; plain blocks, formulas."""


def blocks(page: Path) -> list[tuple[str, str]]:
    """Return the fenced blocks of a page: language and text."""
    return re.findall(r"^```(\w*)\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


def runnable(page: Path) -> bool:
    return bool({"python", "console"} & {kind for kind, _ in blocks(page)})


@pytest.mark.parametrize(
    "page",
    [
        # JAX compiles for a minute.
        pytest.param(page, marks=[pytest.mark.slow] if page.name == "learning.md" else [], id=named(page))
        for page in PAGES
        if runnable(page)
    ],
)
def test_a_page_runs_from_top_to_bottom_in_one_folder(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "page"}
    for language, text in blocks(page):
        if language == "python":
            exec(compile(text, named(page), "exec"), names)
        elif language == "console":
            for command, shown in re.findall(r"^\$ spm-pin (.*)\n((?:(?!\$ ).*\n)*)", text, flags=re.MULTILINE):
                found = CliRunner().invoke(app, shlex.split(command))
                assert found.exit_code == (5 if "of the physical branch: r_" in found.output else 0), (
                    command,
                    found.output,
                )
                if shown.strip():
                    assert lines(found.output) == lines(shown), command


def lines(text: str) -> list[str]:
    """Return the lines without the blank ones, what is rounding in one of them as ~."""
    return [re.sub(r"\de-1[4-9]", "~", line.rstrip()) for line in text.strip().splitlines() if line.strip()]


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_blocks_are_of_a_known_kind_and_links_lead_to_files(page: Path) -> None:
    for language, text in blocks(page):
        assert language in LANGUAGES, text
        assert language or "spm-pin" not in text, f"run as console: {text}"
    for target in re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8")):
        assert "://" in target or (page.parent / target).exists(), target


def dead_links(site: Path) -> list[str]:
    """Return links within a site whose file, or whose place in it, does not exist."""
    pages = {path: path.read_text(encoding="utf-8") for path in site.rglob("*.html")}
    places = {path: set(re.findall(r'\b(?:id|name)="([^"]+)"', text)) for path, text in pages.items()}
    dead = []
    for path, text in pages.items():
        for target in re.findall(r'<a [^>]*href="([^"]+)"', text):
            file, _, place = unquote(target).partition("#")
            if "://" in target or target.startswith(("mailto:", "data:")):
                continue
            to = (path.parent / file).resolve() if file else path
            if not to.exists() or (place and to in places and place not in places[to]):
                dead.append(f"{path.relative_to(site)}: {target}")
    return dead


def test_the_reference_of_the_commands_has_every_option() -> None:
    page = command_reference()
    for name, command in get_command(app).commands.items():  # type: ignore[attr-defined]
        section = page.partition(f"## {name}\n")[2].partition("\n## ")[0]
        for parameter in command.params:
            for option in parameter.opts if parameter.param_type_name == "option" else ():
                assert f"| `{option}" in section or f", {option}" in section, (name, option)
    assert "| `--rpy ROLL PITCH YAW` |" in page
    assert "\\\\[" not in page


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_names_everything_public(tmp_path: Path) -> None:
    command = [sys.executable, ROOT / "docs/site/build.py", tmp_path / "site"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    front = (tmp_path / "site/index.html").read_text(encoding="utf-8")
    assert ('id="live"' in front) == (live_page.webassembly() is not None)
    for module, _ in inspect.getmembers(spm_pin, inspect.ismodule):
        assert (tmp_path / f"site/reference/spm_pin.{module}.html").exists(), module
    assert dead_links(tmp_path / "site") == []
    for notebook in (ROOT / "examples/notebooks").glob("*.ipynb"):
        shown = (tmp_path / f"site/notebooks/{notebook.stem}.html").read_text(encoding="utf-8")
        assert 'class="output text_' in shown, notebook
        assert re.search(r'src="\.\./_images/\w+\.png"', shown), notebook
    index = (tmp_path / "site/reference/index.html").read_text(encoding="utf-8")
    links = re.findall(r'<a [^>]*href="([^"]*)"[^>]*>(?:<(?:span|code)[^>]*>)*(\w+)<', index)
    homes = {name: target for target, name in links}
    assert set(spm_pin.__all__) <= set(homes)
    for name in spm_pin.__all__:
        page, _, anchor = homes[name].partition("#")
        text = (tmp_path / "site/reference" / page).read_text(encoding="utf-8")
        assert f'id="{anchor}"' in text if anchor else name in text, name
