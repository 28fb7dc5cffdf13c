"""Build the documentation as a static site: `python docs/site/build.py [FOLDER]`. Needs "spm-pin[docs]".

Pages in docs/ link to source files as one does on disk; on the site such a link leads to the module's entry in the
reference, so that the same text reads well in either. The reference, the examples and the paper's tables are made
here, by the code they describe. Nothing is fetched, and a warning is an error.
"""

from __future__ import annotations

import ast
import importlib
import posixpath
import re
import shutil
import sys
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from sphinx.cmd.build import build_main

import spm_pin
from spm_pin.reproduction.tables_1_to_4 import reproduce

ROOT = Path(__file__).parents[2]
ROOMS = {
    "mechanism": "what the robot is: dimensions, poses, configurations, sets of solutions",
    "paper": "the paper line by line: its tables, resultant, Jacobians and statics",
    "closed_form": "inverse and forward displacement in closed form; rates, forces, singularities, paths",
    "description": "the URDF and its closures: read, checked, written in other formats",
    "multibody": "the same robot in Pinocchio, its loops closed by constraints",
    "nlp": "the loop equations in CasADi, solved by certified multi-start",
    "workspace": "what the terminal platform reaches: shell, reachable set, sweeps",
    "crosscheck": "witnesses compared, and the paper reproduced",
    "display": "pictures and the viewer",
    "errors": "what is raised, and what it carries",
}
"""The rooms of the house that the reference describes."""


def main(folder: Path) -> int:
    """Build the site into `folder`; return Sphinx's exit code."""
    with TemporaryDirectory() as name:
        sources = Path(name)
        for page, text in pages().items():
            (sources / page).parent.mkdir(parents=True, exist_ok=True)
            (sources / page).write_text(text, encoding="utf-8")
        shutil.copytree(ROOT / "docs/images", sources / "images")
        settings = str(ROOT / "docs/site")
        return build_main(["-q", "-W", "--keep-going", "-E", "-b", "html", "-c", settings, name, str(folder)])


def pages() -> dict[str, str]:
    """Return every page of the site, by its path in the site's sources."""
    docs = ROOT / "docs"
    origins = {path.relative_to(docs).as_posix(): path for path in sorted(docs.rglob("*.md"))}
    origins["index.md"] = origins.pop("README.md")
    origins |= {"changelog.md": ROOT / "CHANGELOG.md", "examples.md": ROOT / "examples/README.md"}
    origins |= {"results.md": ROOT / "benchmarks/results.md", "results_sweep.md": ROOT / "benchmarks/sweep.md"}
    found = {page: _turned(page, origin, origins) for page, origin in origins.items()}
    found["examples.md"] += _scripts()
    found["index.md"] += _contents(found)
    found["paper.md"] = _paper()
    found["reference/index.md"] = _public_names()
    for room in ROOMS:
        found[f"reference/{room}.md"] = _room(room)
    return found


def _turned(page: str, origin: Path, origins: dict[str, Path]) -> str:
    """Return a page with the links that leave docs/ turned to where the site shows their target."""
    places = {path: name for name, path in origins.items()}

    def turned(match: re.Match[str]) -> str:
        text, target, anchor = match["text"], match["target"], match["anchor"] or ""
        if "://" in target or not target:
            return match[0]
        path = (origin.parent / target).resolve()
        parts = path.relative_to(ROOT).with_suffix("").parts
        if path in places:
            shown = places[path]
        elif parts[0] == "examples":
            shown, anchor = "examples.md", f"#{parts[-1]}"
        elif parts[0] == "spm_pin" and parts[-1] != "__init__" and path.suffix == ".py":
            return f"[{text}](#{'.'.join(parts)})"
        elif parts[0] == "spm_pin" and len(parts) > 1 and parts[1] in ROOMS:
            shown = f"reference/{parts[1]}.md"
        elif parts[:2] == ("docs", "images"):
            shown = "images/" + "/".join(path.relative_to(ROOT / "docs/images").parts)
        else:
            return text  # a file of the tree that the site does not show
        return f"[{text}]({posixpath.relpath(shown, posixpath.dirname(page) or '.')}{anchor})"

    pattern = r"\[(?P<text>[^\[\]]*)\]\((?P<target>[^)#\s]*)(?P<anchor>#[^)\s]*)?\)"
    return re.sub(pattern, turned, origin.read_text(encoding="utf-8"))


def _contents(found: dict[str, str]) -> str:
    """Return the tables of contents: what stands first, and then whatever else a folder holds."""
    kinematics = ("inverse_displacement", "forward_displacement", "rates_forces_singularities")
    theory = (*kinematics, "workspace", "reachable_set", "dynamics")
    chapters = {
        "Theory": _ordered(found, "theory", theory),
        "The paper": ["findings", "paper"],
        "How to": _ordered(found, "howto", ("load_elsewhere", "crosscheck", "batches", "paths", "optimal_control")),
        "More": [
            "examples",
            "reference/index",
            "benchmarks",
            "results",
            "results_sweep",
            "design",
            "changelog",
        ],
    }
    lines = ["", "```{toctree}", ":hidden:", "", "mechanism", "```"]
    for caption, entries in chapters.items():
        lines += ["", "```{toctree}", ":hidden:", f":caption: {caption}", "", *entries, "```"]
    return "\n".join(lines) + "\n"


def _ordered(found: dict[str, str], folder: str, first: tuple[str, ...]) -> list[str]:
    names = [PurePosixPath(page).stem for page in found if page.startswith(f"{folder}/")]
    return [f"{folder}/{name}" for name in [*(n for n in first if n in names), *sorted(set(names) - set(first))]]


def _room(room: str) -> str:
    lines = [f"# {room}", "", f"{ROOMS[room][0].upper()}{ROOMS[room][1:]}.", ""]
    for module in _modules(room):
        short = module.removeprefix(f"spm_pin.{room}").removeprefix(".")
        lines += ["", f"## {short or room}", "", f"```{{eval-rst}}\n.. automodule:: {module}\n```"]
    return "\n".join(lines) + "\n"


def _modules(room: str) -> list[str]:
    """Return the modules of a room that publish something."""
    folder = ROOT / "spm_pin" / room
    files = sorted(folder.rglob("[!_]*.py")) if folder.is_dir() else [folder.with_suffix(".py")]
    return [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files if _publishes(path)]


def _publishes(path: Path) -> bool:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return any(isinstance(one, ast.Assign) and ast.unparse(one.targets[0]) == "__all__" for one in tree.body)


def _public_names() -> str:
    """Return the index: every name of `spm_pin`, where it is described, and its first sentence."""
    homes = _homes()
    rows = []
    for name in sorted(spm_pin.__all__, key=str.casefold):
        value = getattr(spm_pin, name)
        first = "" if type(value).__name__ in ("tuple", "dict", "str") else (value.__doc__ or "").partition("\n\n")[0]
        target = "nlp.md" if name == "nlp" else f"#{homes[name]}.{name}"
        rows.append(f"| [`{name}`]({target}) | {' '.join(first.split())} |")
    rooms = [f"- [{room}]({room}.md): {what}" for room, what in ROOMS.items()]
    contents = ["```{toctree}", ":hidden:", "", *ROOMS, "```"]
    head = [
        "# Reference",
        "",
        "`import spm_pin as spm`, and these are its names.",
        "",
        "| name | what it is |",
        "|---|---|",
    ]
    return "\n".join([*head, *rows, "", "All else is reached through its room:", "", *rooms, "", *contents]) + "\n"


def _homes() -> dict[str, str]:
    """Return the module that defines each public name."""
    homes = {}
    for room in ROOMS:
        for module in _modules(room):
            for name in importlib.import_module(module).__all__:
                homes.setdefault(name, module)
    return homes


def _scripts() -> str:
    """Return the examples themselves, each under its name."""
    scripts = {path.stem: path.read_text(encoding="utf-8").strip() for path in sorted((ROOT / "examples").glob("*.py"))}
    return "".join(f"\n## {name}\n\n```python\n{text}\n```\n" for name, text in scripts.items())


def _paper() -> str:
    """Return the paper's tables beside their recomputation."""
    found = reproduce()
    agreeing = sum(cell.verdict == "same" for cell in found.cells)
    lines = [
        "# Table by table",
        "",
        "Computed when this page was built, by the code that `spm-pin reproduce` runs. Lengths in cm, rates in cm/s, "
        f"forces in kN, as printed. {agreeing} of {len(found.cells)} cells agree in every printed digit; "
        "[findings](findings.md) explains the others.",
    ]
    for table in sorted({cell.table for cell in found.cells}):
        lines += ["", f"## {f'Table {table}' if table else 'The pose of the example'}", ""]
        lines += ["| | solution | printed | recomputed | verdict |", "|---|---|---:|---:|---|"]
        for cell in found.table(table):
            value = cell.recomputed
            number = f"{value.real:.5f}" + (f" {value.imag:+.5f}i" if abs(value.imag) > 1e-9 else "")
            verdict = f"**{cell.verdict}**: {cell.note}" if cell.note else str(cell.verdict)
            lines.append(f"| {cell.row} | {cell.column} | {cell.published or 'nothing'} | {number} | {verdict} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "build/site").resolve()))
