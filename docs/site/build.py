"""Build the documentation as a static site: `python docs/site/build.py [FOLDER]`. Needs `pip install ".[docs]"`.

Pages in docs/ link to source files as one does on disk; on the site such a link leads to the module's entry in the
reference, so that the same text reads well in either. The reference, the examples, the paper's tables and those of the
literature's claims are made here, by the code they describe. Nothing is fetched, and a warning is an error.
"""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import itertools
import posixpath
import re
import shutil
import sys
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from command_reference import command_reference
from literature import with_tables
from live_page import with_machine
from sphinx.cmd.build import build_main

from spm_pin.crosscheck import reproduce
from spm_pin.kinematics import compile_kernels

ROOT = Path(__file__).parents[2]
NOTEBOOKS = ROOT / "examples/notebooks"
CHAPTERS = (
    "branches_of_a_pose",
    "calibrate_and_control",
    "workspace_and_design",
    "learning_with_gradients",
    "the_paper_reproduced",
)
"""The notebooks, in the order of reading; they run when the site is built, and stand on it with their outputs."""
PUBLIC = {
    "spm_pin": "the names of everyday use",
    "spm_pin.machine": "dimensions, poses, configurations, sets of solutions",
    "spm_pin.kinematics": "branches, assembly modes, rates, forces, singularities and paths in closed form",
    "spm_pin.workspace": "what the platform reaches",
    "spm_pin.capability": "what limits of the legs allow: polytopes of wrenches, twists, accelerations; reactions",
    "spm_pin.design": "many designs in one call, and Pareto fronts of dimensions",
    "spm_pin.calibration": "calibration: machines identified from measurements, and the effect of tolerances",
    "spm_pin.proofs": "leg limits proved free of singularities, by interval arithmetic",
    "spm_pin.sweeps": "metrics over any number of poses or leg lengths",
    "spm_pin.loops": "any robot with closed loops in Pinocchio: files, closing, mobility, dynamics",
    "spm_pin.multibody": "the robot in Pinocchio: states, dynamics, simulation, mounting on another robot",
    "spm_pin.motion": "paths from one state to another, and the fastest motion along them",
    "spm_pin.crosscheck.nlp": "the loop equations in CasADi, and the branches found from them by multi-start",
    "spm_pin.casadi": "the kinematics as CasADi functions, with derivatives of any order",
    "spm_pin.export": "the kinematics in C for controllers, as a ROS 2 package, and for LinuxCNC",
    "spm_pin.arrays": "the kinematics on arrays of JAX, NumPy and others, with derivatives",
    "spm_pin.crosscheck": "methods compared on random poses, the paper's tables recomputed, and its workspace",
    "spm_pin.description": "the robot's files, and its text in URDF, MJCF, SDFormat, SRDF and Extended-URDF",
    "spm_pin.display": "pictures, figures of results, mesh files and the viewer",
    "spm_pin.errors": "what is raised, and what it carries",
}
"""The public modules, each with a page of the reference."""

LIVE_PAGES = "live.html", "balancer.html"
"""Pages of docs/ that are finished files, and are copied."""

INTERNAL = {
    "formulas": "each formula of the mechanism once, on numbers of any kind",
    "support": "checks of arguments, files, tables, progress",
    "machine": "the types of machines, states and sets of states",
    "kinematics": "solvers and kernels",
    "description": "the robot of the URDF as data, and its writers",
    "loops": "any closed chain in Pinocchio, its readers and writers",
    "multibody": "the robot in Pinocchio, its loops closed by constraints",
    "workspace": "the reachable set",
    "calibration": "the error model, identification, the choice of poses",
    "sweeps": "domains, metrics, store and runs",
    "casadi": "the formulas in CasADi",
    "export": "C for controllers, ROS 2, LinuxCNC",
    "capability": "polytopes of wrenches, twists and accelerations, and reactions at the joints",
    "design": "many designs in one call, and Pareto fronts",
    "arrays": "formulas run on arrays of any library",
    "crosscheck": "methods, comparison, tolerances, report; the paper line by line, and the search by CasADi",
    "proofs": "leg limits without singularities, proved by interval arithmetic",
    "motion": "planning, and time-optimal motion",
    "display": "pictures and the viewer",
}
"""The folders whose modules the reference describes for those who read or change the code."""


def main(folder: Path) -> int:
    """Build the site into `folder`; return Sphinx's exit code, or 1 if a notebook leaves files behind."""
    compile_kernels()  # which notebooks would say on stderr, a warning
    with TemporaryDirectory() as name:
        sources = Path(name)
        for page, text in pages().items():
            (sources / page).parent.mkdir(parents=True, exist_ok=True)
            (sources / page).write_text(text, encoding="utf-8")
        shutil.copytree(ROOT / "docs/images", sources / "images")
        shutil.copytree(NOTEBOOKS, sources / "notebooks", ignore=shutil.ignore_patterns(".*"))
        shutil.copy(ROOT / "docs/references.bib", sources)
        settings = str(ROOT / "docs/site")
        options = ["-q", "-W", "--keep-going", "-E", "-b", "html", "-c", settings, "-d", f"{name}.doctrees"]
        try:
            code = build_main([*options, name, str(folder)])
            for page in LIVE_PAGES:
                shutil.copy(ROOT / "docs" / page, folder)
            left = {path.name for path in (sources / "notebooks").iterdir()} - {f"{name}.ipynb" for name in CHAPTERS}
            if left:
                print("Notebooks leave files behind:", *sorted(left), file=sys.stderr)
            return code or bool(left)
        finally:
            shutil.rmtree(f"{name}.doctrees", ignore_errors=True)
            shutil.rmtree(folder.parent / "jupyter_execute", ignore_errors=True)  # copies of the notebooks' pictures


def pages() -> dict[str, str]:
    """Return every page of the site, by its path in the site's sources."""
    docs = ROOT / "docs"
    origins = {path.relative_to(docs).as_posix(): path for path in sorted(docs.rglob("*.md"))}
    origins["index.md"] = origins.pop("README.md")
    origins |= {"changelog.md": ROOT / "CHANGELOG.md", "examples.md": ROOT / "examples/README.md"}
    origins |= {"results.md": ROOT / "benchmarks/results.md", "results_sweep.md": ROOT / "benchmarks/sweep.md"}
    found = {page: _turned(page, origin, origins) for page, origin in origins.items()}
    found["theory/literature_checks.md"] = with_tables(found["theory/literature_checks.md"])
    found["examples.md"] += _scripts()
    found["index.md"] = with_machine(found["index.md"]) + _contents(found)
    found["paper.md"] = _paper()
    found["reference/commands.md"] = command_reference()
    found["reference/index.md"] = _reference()
    described: set[str] = set()
    for module in PUBLIC:
        found[f"reference/{module}.md"] = _public_module(module, described)
    for folder in INTERNAL:
        found[f"reference/modules/{folder}.md"] = _folder(folder, described)
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
        elif path.suffix == ".ipynb":
            shown = f"notebooks/{path.name}"
        elif parts[0] == "examples" and path.suffix == ".py":
            shown, anchor = "examples.md", f"#{parts[-1]}"
        elif parts[0] == "spm_pin" and parts[-1] != "__init__" and path.suffix == ".py":
            return f"[{text}](#{'.'.join(parts)})"
        elif parts[0] == "spm_pin" and len(parts) > 1 and parts[1] in INTERNAL:
            shown = f"reference/modules/{parts[1]}.md"
        elif path.name in LIVE_PAGES:
            return f'<a href="{"../" * page.count("/")}{path.name}">{text}</a>'
        elif parts[:2] == ("docs", "images") or path.suffix == ".bib":
            shown = path.relative_to(ROOT / "docs").as_posix()
        else:
            return text  # a file of the tree that the site does not show
        return f"[{text}]({posixpath.relpath(shown, posixpath.dirname(page) or '.')}{anchor})"

    pattern = r"\[(?P<text>[^\[\]]*)\]\((?P<target>[^)#\s]*)(?P<anchor>#[^)\s]*)?\)"
    return re.sub(pattern, turned, origin.read_text(encoding="utf-8"))


def _contents(found: dict[str, str]) -> str:
    """Return the tables of contents: what stands first, and then whatever else a folder holds."""
    kinematics = ("inverse_displacement", "forward_displacement", "rates_forces_singularities")
    theory = ("README", *kinematics, "literature_checks", "workspace", "reachable_set", "proofs", "calibrated")
    guides = ("ball_balancer", "gallery", "batches", "paths", "motion", "workspace", "viewer", "pipelines", "loops")
    guides += ("load_elsewhere", "controller", "microcontroller", "sweep")
    chapters = {
        "How to": _ordered(found, "howto", guides),
        "Notebooks": [f"notebooks/{name}" for name in CHAPTERS],
        "Theory": _ordered(found, "theory", theory),
        "The paper, and others": ["findings", "paper", "related_work"],
        "More": [
            "examples",
            "reference/commands",
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


def _reference() -> str:
    """Return the index: every public name of each public module, and its first sentence."""
    lines = ["# Reference", "", "`import spm_pin as spm`; what is not listed here may change without notice.", ""]
    described: set[str] = set()
    for module, summary in PUBLIC.items():
        lines += [f"## {module}", "", f"{summary[0].upper()}{summary[1:]}.", "", "| name | what it is |", "|---|---|"]
        for name in sorted(_new_names(module, described), key=str.casefold):
            lines.append(f"| [`{name}`](#{module}.{name}) | {_first_sentence(module, name)} |")
        lines.append("")
    lines += ["## For readers of the code", ""]
    lines += [f"- [{folder}](modules/{folder}.md): {summary}" for folder, summary in INTERNAL.items()]
    pages = [*PUBLIC, *(f"modules/{folder}" for folder in INTERNAL)]
    return "\n".join([*lines, "", "```{toctree}", ":hidden:", "", *pages, "```"]) + "\n"


def _new_names(module: str, described: set[str]) -> list[str]:
    """Return the public names of a module that no page before it describes, and add them to `described`."""
    found = []
    for name in importlib.import_module(module).__all__:
        value = getattr(importlib.import_module(module), name)
        if not inspect.ismodule(value) and (home := _home(module, name)) not in described:
            described.add(home)
            found.append(name)
    return found


@functools.cache
def _shown_names() -> set[str]:
    """Return the names under which the public pages describe what they describe."""
    described: set[str] = set()
    return {f"{module}.{name}" for module in PUBLIC for name in _new_names(module, described)}


def _home(module: str, name: str) -> str:
    """Return where a public name is defined, as module.name."""
    value = getattr(importlib.import_module(module), name)
    if inspect.isclass(value) or inspect.isfunction(inspect.unwrap(value)):
        return f"{value.__module__}.{value.__qualname__}"
    return _constants()[id(value)]


@functools.cache
def _methods() -> set[str]:
    """Return where functions are defined that are methods of public classes, as module.name."""
    public = [
        getattr(importlib.import_module(module), name)
        for module in PUBLIC
        for name in importlib.import_module(module).__all__
    ]
    members = [value for cls in public if inspect.isclass(cls) for value in vars(cls).values()]
    return {f"{value.__module__}.{value.__qualname__}" for value in members if inspect.isfunction(value)}


@functools.cache
def _constants() -> dict[int, str]:
    """Return where each public constant is assigned, as module.name, by its identity."""
    public = {name for module in PUBLIC for name in importlib.import_module(module).__all__}
    return {
        id(vars(importlib.import_module(module))[name]): f"{module}.{name}"
        for folder in ("errors", *INTERNAL)
        for module in (f"spm_pin.{folder}", *_modules(folder))
        for name in public.intersection(_assigned(module))
    }


@functools.cache
def _assigned(module: str) -> dict[str, str]:
    """Return the names that a module assigns, each with the first sentence of the text below it."""
    tree = ast.parse(inspect.getsource(importlib.import_module(module)))
    found = {}
    for statement, following in itertools.zip_longest(tree.body, tree.body[1:]):
        targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
        is_text = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
        text = str(following.value.value).partition("\n\n")[0] if is_text else ""
        found |= {target.id: text for target in targets if isinstance(target, ast.Name)}
    return found


def _first_sentence(module: str, name: str) -> str:
    home, _, own_name = _home(module, name).rpartition(".")
    value = getattr(importlib.import_module(module), name)
    text = _assigned(home).get(own_name) or (inspect.getdoc(value) or "").partition("\n\n")[0]
    if not text:
        raise ValueError(f"{home}.{own_name} is public and has no description")
    return " ".join(text.split()).replace("|", "\\|")


def _public_module(module: str, described: set[str]) -> str:
    """Return the page of a public module, with what no page before it describes."""
    lines = [f"# {module}", ""]
    names = _new_names(module, described)
    constants = [name for name in names if id(getattr(importlib.import_module(module), name)) in _constants()]
    hidden = sorted({*importlib.import_module(module).__all__} - {*names} | {*constants})
    lines += ["```{eval-rst}", f".. automodule:: {module}", f"   :exclude-members: {', '.join(hidden)}", ""]
    for name in constants:
        text = _first_sentence(module, name)
        lines += [f".. py:data:: {module}.{name}", f"   :canonical: {_home(module, name)}", "", f"   {text}", ""]
    return "\n".join([*lines, "```"]) + "\n"


def _folder(folder: str, described: set[str]) -> str:
    """Return the page of a folder: each module, with what the public pages do not describe."""
    summary = INTERNAL[folder]
    lines = [f"# {folder}", "", f"{summary[0].upper()}{summary[1:]}.", ""]
    for module in _modules(folder):
        short = module.removeprefix(f"spm_pin.{folder}").removeprefix(".")
        homes = described | _methods()
        members = vars(importlib.import_module(module)).items()
        foreign = {name for name, value in members if callable(value) and getattr(value, "__module__", "") != module}
        known = sorted(foreign | {name for name, _ in members if f"{module}.{name}" in homes})
        lines += ["", f"## {short or folder}", "", f"```{{eval-rst}}\n.. automodule:: {module}"]
        lines += [f"   :exclude-members: {', '.join(known)}"] if known else []
        # A function named as its module has the module's name as its address: only one of the two can be indexed.
        lines += ["   :no-index:"] if module in _shown_names() else []
        lines += ["```"]
    return "\n".join(lines) + "\n"


def _modules(folder: str) -> list[str]:
    """Return the modules of a folder that publish something."""
    place = ROOT / "spm_pin" / folder
    files = sorted(place.rglob("[!_]*.py")) if place.is_dir() else [place.with_suffix(".py")]
    return [".".join(path.relative_to(ROOT).with_suffix("").parts) for path in files if _publishes(path)]


def _publishes(path: Path) -> bool:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    kinds = ast.FunctionDef, ast.ClassDef
    return any(isinstance(node, kinds) and not node.name.startswith("_") for node in tree.body)


def _scripts() -> str:
    """Return the examples themselves, each under its name."""
    scripts = {path.stem: path.read_text(encoding="utf-8").strip() for path in sorted((ROOT / "examples").glob("*.py"))}
    return "".join(f"\n## {name}\n\n```python\n{text}\n```\n" for name, text in scripts.items())


def _paper() -> str:
    """Return the paper's tables beside their recomputation."""
    found = reproduce()
    agreeing = sum(cell.verdict == "same" for cell in found.in_tables)
    lines = [
        "# Table by table",
        "",
        "Computed when this page was built, by the code that `spm-pin reproduce` runs. Lengths in cm, rates in cm/s, "
        f"forces in kN, as printed. {agreeing} of the {len(found.in_tables)} cells of the tables agree in every "
        "printed digit; [findings](findings.md) explains the others.",
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
