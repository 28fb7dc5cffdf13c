"""Plant faults in the package, one at a time, and count how many of them the tests catch.

    python scripts/planted_faults.py map     # once, an hour: which tests run which lines, and how long they take
    python scripts/planted_faults.py run     # with a few tests each; interrupted, it goes on where it was
    python scripts/planted_faults.py run --survivors    # those again that survived, with all their tests
    python scripts/planted_faults.py list    # what survived

A fault is a changed sign, index, constant or comparison, two arguments in the wrong order or a copy not made. The
same seed plants the same faults, an equal number in each group of files. Everything happens in copies of the tree and
without compiling: interpreted kernels give the same bits. A fault is caught if a test fails of those that run its block
of statements, at first up to 40 quick ones, and then of all that run anything in its file. Numbers below 1e-4 are left
alone: they are tolerances, whose double is no fault. Tests that fail or take long without a compiler do not count, so a
survivor may still be caught by `make test`: `run --survivors --compiled` plants it again with one.

mutmut and cosmic-ray run all tests of a module for each of all faults, which takes days here; mutmut moreover puts a
wrapper around each function, which Numba does not compile.
"""

from __future__ import annotations

import argparse
import ast
import collections
import concurrent.futures
import contextlib
import json
import multiprocessing
import os
import random
import shutil
import signal
import sys
from collections.abc import Iterator
from importlib import import_module
from importlib.util import cache_from_source
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]
GROUPS = {
    "formulas": ["formulas/*.py"],
    "kernels": ["kinematics/kernels/*.py"],
    "loops": ["loops/*.py"],
    "machine": ["machine/*.py"],
    "readers": ["loops/read_*.py", "loops/xml_input.py", "calibration/measurements.py", "support/motion_table.py"],
    "exporters": ["export/*.py", "loops/write_chain.py", "description/*.py", "casadi/*.py"],
}
SWAPS = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
    ast.Lt: ("<", ">"), ast.Gt: (">", "<"), ast.LtE: ("<=", ">="), ast.GtE: (">=", "<="), ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="), ast.Is: ("is", "is not"), ast.IsNot: ("is not", "is"), ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"), ast.And: ("and", "or"), ast.Or: ("or", "and"),
}  # fmt: skip
SYMMETRIC = {"dot", "both", "either", "min", "max", "minimum", "maximum", "isinstance", "add", "hypot", "equal", "zip"}
SELECTION = ["-m", "not slow and not documents", "-q", "-p", "no:cacheprovider", "-p", "planted_faults"]
SELECTION += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]  # of what is imported before the fork
IMPORTED = (
    "numpy",
    "scipy.optimize",
    "scipy.spatial",
    "numba",
    "casadi",
    "pinocchio",
    "hypothesis",
    "mpmath",
    "mujoco",
)
"""Packages that take long to import and are imported once."""
LIMIT = "PLANTED_FAULTS_LIMIT"
"""Environment variable with the time [s] of the processor that a test may take."""


# What runs inside pytest, which loads this file as a plugin


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Iterator[None]:
    """Let a test fail that takes too long: a fault may make a loop endless."""
    signal.signal(signal.SIGPROF, lambda *_: pytest.fail("takes too long"))
    signal.setitimer(signal.ITIMER_PROF, float(os.environ[LIMIT]))
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Write down which blocks ran since the last report, in the copy where they are marked."""
    ran = getattr(sys.modules.get("blocks_that_ran"), "ran", None)
    if ran is not None and (worker := os.environ.get("PYTEST_XDIST_WORKER")):
        row = [report.nodeid, report.when, report.duration, report.outcome == "passed", sorted(ran)]
        ran.clear()
        with Path(f"../ran-{worker}.jsonl").open("a") as file:
            file.write(json.dumps(row) + "\n")


# Faults


def faults_of(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the faults that can be planted in a file: place, text there and text to put instead."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def begin(node: ast.AST) -> int:
        return starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]

    def end(node: ast.AST) -> int:
        return starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]

    def text(node: ast.AST) -> str:
        return source[begin(node) : end(node)].decode()

    def fault(kind: str, first: int, last: int, new: str) -> dict[str, Any]:
        line = source.count(b"\n", 0, first) + 1
        old, file = source[first:last].decode(), str(path.relative_to(ROOT))
        return {"file": file, "line": line, "kind": kind, "at": first, "old": old, "new": new}

    def between(kind: str, left: ast.AST, right: ast.AST, operator: ast.AST) -> Iterator[dict[str, Any]]:
        old, new = SWAPS.get(type(operator), ("", ""))
        gap = source[end(left) : begin(right)].decode()
        if old and gap.count(old) == 1 and not isinstance(left, ast.Constant | ast.JoinedStr):
            yield fault(kind, end(left), begin(right), gap.replace(old, new))

    def visit(node: ast.AST, parent: ast.AST | None) -> Iterator[dict[str, Any]]:
        match node:
            case ast.Raise() | ast.JoinedStr() | ast.Assert() | ast.Import() | ast.ImportFrom() | ast.arguments():
                return
            case ast.FunctionDef():  # neither decorators nor annotations
                for child in node.body:
                    yield from visit(child, node)
                return
            case ast.AnnAssign():
                if node.value:
                    yield from visit(node.value, node)
                return
            case ast.BinOp():
                kind = "sign" if isinstance(node.op, ast.Add | ast.Sub) else "operator"
                yield from between(kind, node.left, node.right, node.op)
            case ast.UnaryOp(op=ast.USub() | ast.Not()) if not isinstance(parent, ast.Subscript):
                yield fault("sign", begin(node), end(node), f"({text(node.operand)})")
            case ast.Compare():
                yield from between("comparison", node.left, node.comparators[0], node.ops[0])
            case ast.BoolOp():
                yield from between("comparison", node.values[0], node.values[1], node.op)
            case ast.Constant(value=bool()):
                yield fault("constant", begin(node), end(node), str(not node.value))
            case ast.Constant(value=int() | float()) if node.value == 0 or abs(node.value) > 1e-4:
                kind, number = "constant", node.value
                if isinstance(parent, ast.Subscript | ast.Slice):
                    kind, new = "index", {0: 1, 1: 2, 2: 0}.get(number, number - 1)
                else:
                    new = number + 1 if isinstance(number, int) or number == 0 else 1.1 * number
                yield fault(kind, begin(node), end(node), str(new))
            case ast.Call(func=ast.Attribute(attr="copy"), args=[]):
                yield fault("copy", begin(node), end(node), f"({text(node.func.value)})")
            case ast.Call(func=ast.Attribute(attr="array", value=ast.Name(id="np")), args=[_]):
                yield fault("copy", end(node.func) - len("array"), end(node.func), "asarray")
            case ast.Call(args=[first, second, *_]) if not isinstance(first, ast.Starred):
                name = text(node.func).rpartition(".")[2]
                if text(first) != text(second) and not isinstance(second, ast.Starred) and name not in SYMMETRIC:
                    middle = source[end(first) : begin(second)].decode()
                    yield fault("argument", begin(first), end(second), text(second) + middle + text(first))
        for child in ast.iter_child_nodes(node):
            yield from visit(child, node)

    yield from visit(ast.parse(source), None)


def sample(number: int, seed: int) -> list[dict[str, Any]]:
    """Return an equal share of faults of each group, all groups mixed: any first part of them is a sample too."""
    chosen: list[dict[str, Any]] = []
    taken: set[Path] = set()
    for group in reversed(GROUPS):  # readers and writers before the folders that they lie in
        files = {path for pattern in GROUPS[group] for path in (ROOT / "spm_pin").glob(pattern)} - taken
        taken |= files
        possible = [fault | {"group": group} for path in sorted(files) for fault in faults_of(path)]
        chosen += random.Random(f"{seed} {group}").sample(possible, number // len(GROUPS))
    random.Random(seed).shuffle(chosen)
    return chosen


# Tests


def run_pytest(tree: Path, *arguments: str, limit: float, seconds: float | None = None) -> int:
    """Run pytest in a copy of the tree and return its exit code, negative if it takes longer than so many seconds."""
    process = multiprocessing.get_context("fork").Process(target=_pytest_in, args=(tree, limit, *arguments))
    process.start()
    process.join(seconds)
    if process.is_alive():
        os.killpg(process.pid, signal.SIGKILL)  # compilers and servers that the tests have started, too
        process.join()
    return process.exitcode or 0


def _pytest_in(tree: Path, limit: float, *arguments: str) -> None:
    """Run pytest in this process, forked with the packages imported that most tests need."""
    os.setsid()
    os.chdir(tree)
    with (tree / "pytest.log").open("w") as log:
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    os.environ |= {"PYTHONPATH": f"{tree}:{tree / 'scripts'}", LIMIT: str(limit), "COLUMNS": "300"}
    sys.path[:0] = [str(tree), str(tree / "scripts")]
    code = pytest.main([*SELECTION, *arguments])
    sys.stdout.flush()
    os._exit(code)


def copy_tree(to: Path) -> Path:
    """Return a new copy of the working tree."""
    shutil.rmtree(to, ignore_errors=True)
    ignored = shutil.ignore_patterns(".git", ".venv", "build", "dist", ".*_cache", "__pycache__", ".hypothesis")
    return Path(shutil.copytree(ROOT, to, ignore=ignored, symlinks=True))


def mark_blocks(path: Path, first: int) -> list[tuple[int, int]]:
    """Let each block of statements in a file's functions note that it runs, and return their first and last lines."""
    tree = ast.parse(path.read_bytes())
    blocks: list[tuple[int, int]] = []
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    for node in dict.fromkeys(node for function in functions for node in ast.walk(function)):
        for block in (getattr(node, field, None) for field in ("body", "orelse", "finalbody")):
            if isinstance(block, list) and block and not isinstance(node, ast.ClassDef):
                blocks.append((block[0].lineno, block[-1].end_lineno))
                has_docstring = node in functions and ast.get_docstring(node, clean=False) is not None
                block.insert(int(has_docstring), ast.parse(f"_ran({first + len(blocks) - 1})").body[0])
    at = next((i + 1 for i, node in enumerate(tree.body) if getattr(node, "module", "") == "__future__"), 0)
    tree.body.insert(at, ast.parse("from blocks_that_ran import add as _ran").body[0])
    path.write_text(ast.unparse(tree))
    return blocks


def make_map(folder: Path, workers: int, tests: list[str]) -> None:
    """Run the tests once and keep which blocks they run, and how long they take."""
    for path in folder.glob("ran-*.jsonl") if not tests else ():
        path.unlink()
    tree = copy_tree(folder / "tree")
    (tree / "blocks_that_ran.py").write_text("ran = set()\nadd = ran.add\n")
    blocks: list[tuple[str, int, int]] = []
    for path in sorted((tree / "spm_pin").rglob("*.py")):
        blocks += [(str(path.relative_to(tree)), *lines) for lines in mark_blocks(path, len(blocks))]
    (folder / "blocks.json").write_text(json.dumps(blocks))
    run_pytest(tree, "-n", str(workers), "--dist", "worksteal", *tests, limit=4)


class Map:
    """The tests that ran each block, the quickest first."""

    def __init__(self, folder: Path) -> None:
        self.blocks = json.loads((folder / "blocks.json").read_text())
        self.seconds: dict[str, float] = collections.defaultdict(float)
        of_block: dict[int, set[str]] = collections.defaultdict(set)
        of_file: dict[str, list[str]] = collections.defaultdict(list)
        shared: list[tuple[str, list[int]]] = []
        for path in folder.glob("ran-*.jsonl"):
            for test, when, seconds, passed, ran in map(json.loads, path.open()):
                self.seconds[test] += seconds if passed else float("inf")
                if when == "setup":  # what a fixture of a file runs is put down to the first of the tests that share it
                    of_file[test.partition("::")[0]].append(test)
                    shared.append((test, ran))
                for block in ran:
                    of_block[block].add(test)
        for test, ran in shared:
            for block in ran:
                of_block[block].update(of_file[test.partition("::")[0]])
        self.of_block = of_block

    def tests(self, fault: dict[str, Any]) -> tuple[list[str], list[str]]:
        """Return some tests that run the block of a fault, the quickest of different functions, and all others."""
        own = {i: block for i, block in enumerate(self.blocks) if block[0] == fault["file"]}
        around = [i for i, (_, first, last) in own.items() if first <= fault["line"] <= last]
        block = min(around, key=lambda i: own[i][2] - own[i][1], default=-1)
        direct = self._sorted(self.of_block[block])
        counts: collections.Counter[str] = collections.Counter()
        few = []
        for test in direct:
            counts[test.partition("[")[0]] += 1
            if counts[test.partition("[")[0]] <= 3 and len(few) < 40:
                few.append(test)
        others = self._sorted(set().union(*(self.of_block[i] for i in own)))
        return few, [test for test in dict.fromkeys([*direct, *others]) if test not in few]

    def _sorted(self, tests: set[str]) -> list[str]:
        return sorted((t for t in tests if self.seconds[t] < 60), key=lambda t: (self.seconds[t], t))


def is_caught(fault: dict[str, Any], tree: Path, tests: list[str], seconds: float) -> str:
    """Plant a fault in a copy of the tree and return the test that fails, or ''."""
    path = tree / fault["file"]
    source = path.read_bytes()
    at, old = fault["at"], fault["old"].encode()
    if source[at : at + len(old)] != old:
        raise RuntimeError(f"the tree has changed: {describe(fault)}")
    cached = Path(cache_from_source(str(path)))
    (tree / "tests.txt").write_text("".join(f"{test}\n" for test in tests))
    try:
        path.write_bytes(source[:at] + fault["new"].encode() + source[at + len(old) :])
        cached.unlink(missing_ok=True)
        code = run_pytest(tree, "-x", "@tests.txt", limit=30, seconds=seconds)
    finally:
        path.write_bytes(source)
        cached.unlink(missing_ok=True)
    log = (tree / "pytest.log").read_text()
    failed = [line for line in log.splitlines() if line.startswith(("FAILED", "ERROR", "ImportError while"))]
    if code > 0 and (not failed or "ERROR: not found" in log):
        raise RuntimeError(f"no test of the map has been run: {log[-500:]}")
    return failed[0] if code > 0 else ""  # out of time is not caught: an endless loop ends by the limit of its test


def run(faults: list[dict[str, Any]], options: argparse.Namespace) -> None:
    """Plant faults and append each result to the file of results."""
    tests_of = Map(options.folder)
    trees = [copy_tree(options.folder / f"tree{i}") for i in range(options.workers)]
    for package in IMPORTED:
        with contextlib.suppress(ImportError):
            import_module(package)

    def plant(fault: dict[str, Any]) -> None:
        few, others = tests_of.tests(fault)
        tests = few + others if options.survivors else few or others[:100]
        if not tests:
            print(f"no test runs {fault['file']}:{fault['line']}", flush=True)
            return
        tree = trees.pop()
        try:
            fault = fault | {"caught": is_caught(fault, tree, tests, options.seconds)}
        finally:
            trees.append(tree)
        print(describe(fault), flush=True)
        with (options.folder / "results.jsonl").open("a") as output:
            output.write(json.dumps(fault) + "\n")

    with concurrent.futures.ThreadPoolExecutor(options.workers) as pool:
        list(pool.map(plant, faults))


def main() -> None:
    """Run one step of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=["map", "run", "list"])
    parser.add_argument("tests", nargs="*", help="folders and files to map besides; none: all anew")
    parser.add_argument("--number", type=int, default=240, help="faults, an equal share in each group")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=300, help="the longest time for one fault")
    parser.add_argument("--folder", type=Path, default=ROOT / "build/faults", help="where copies and results are kept")
    parser.add_argument("--compiled", action="store_true", help="with compiled kernels: for the last survivors")
    parser.add_argument("--survivors", action="store_true", help="plant those again, with all tests of their files")
    options = parser.parse_args()
    options.folder = options.folder.resolve()
    options.folder.mkdir(parents=True, exist_ok=True)
    if not options.compiled:
        os.environ |= {"SPM_PIN_THREADS": "1", "SPM_PIN_KERNELS": "interpreted", "NUMBA_DISABLE_JIT": "1"}
    if options.step == "map":
        return make_map(options.folder, options.workers, options.tests)
    results = options.folder / "results.jsonl"
    known = {key(fault): fault for fault in map(json.loads, results.open() if results.exists() else ())}
    faults = sample(options.number, options.seed)
    if options.step == "run":
        survivors = [fault for fault in faults if not known.get(key(fault), {"caught": True})["caught"]]
        return run(survivors if options.survivors else [f for f in faults if key(f) not in known], options)
    ran = [known[key(fault)] for fault in faults if key(fault) in known]
    for fault in ran:
        if not fault["caught"]:
            print(describe(fault))
    print(f"{sum(bool(fault['caught']) for fault in ran)} of {len(ran)} faults are caught")
    return None


def key(fault: dict[str, Any]) -> tuple[Any, ...]:
    """Return what tells a fault from all others."""
    return fault["file"], fault["at"], fault["new"]


def describe(fault: dict[str, Any]) -> str:
    """Return a line about a fault."""
    place = f"{fault['file']}:{fault['line']}: {fault['kind']} {fault['old']!r} -> {fault['new']!r}"
    return f"{place}  {fault.get('caught') or 'SURVIVES'}"


if __name__ == "__main__":
    main()
