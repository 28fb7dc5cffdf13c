"""Plant faults in the package, one at a time, and count how many of them `make test` catches.

    python scripts/planted_faults.py map     # once: which tests run which lines, and how long they take
    python scripts/planted_faults.py run     # plants and tests; interrupted, it goes on where it was
    python scripts/planted_faults.py list    # what survived

A fault is a changed sign, index, constant or comparison, two arguments in the wrong order or a copy not made. The same
seed plants the same faults, an equal number in each group of files. Everything happens in copies of the tree and without
compiling: kernels are interpreted, which gives the same bits. A fault is caught if a test fails of those that run its
line, the quickest first, and then of those that run anything in its file. Numbers below 1e-4 are left alone: they are
tolerances, whose double is no fault. Tests which fail or take long without a compiler do not count, so a survivor may
still be caught by the whole `make test`: `run --compiled` repeats the survivors with it.

mutmut and cosmic-ray run all tests of a module for each of all faults, which takes days here, and mutmut puts a wrapper
around each function, which Numba does not compile.
"""

from __future__ import annotations

import argparse
import ast
import collections
import concurrent.futures
import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
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


_times: dict[str, float] = collections.defaultdict(float)
"""How long each test takes [s], infinite if it does not pass."""


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    _times[report.nodeid] += report.duration if report.outcome == "passed" else float("inf")


def pytest_sessionfinish(session: pytest.Session) -> None:
    if "--cov" in session.config.invocation_params.args and not hasattr(session.config, "workerinput"):
        Path("times.json").write_text(json.dumps(_times))


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


def run_pytest(tree: Path, *arguments: str, limit: float, seconds: float | None = None, compiled: bool = False) -> int:
    """Run pytest in a copy of the tree and return its exit code; 1 if it takes longer than so many seconds."""
    environment = os.environ | {"PYTHONPATH": f"{tree}:{tree / 'scripts'}", LIMIT: str(limit)}
    if not compiled:
        environment |= {"SPM_PIN_KERNELS": "interpreted", "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-m", "pytest", *SELECTION, *arguments]
    with (tree / "pytest.log").open("w") as log:
        process = subprocess.Popen(
            command, cwd=tree, env=environment, stdout=log, stderr=log, start_new_session=True, stdin=subprocess.DEVNULL
        )
        try:
            return process.wait(seconds)
        except subprocess.TimeoutExpired:
            return 1
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def copy_tree(to: Path) -> Path:
    shutil.rmtree(to, ignore_errors=True)
    ignored = shutil.ignore_patterns(".git", ".venv", "build", "dist", ".*_cache", "__pycache__", ".hypothesis")
    return Path(shutil.copytree(ROOT, to, ignore=ignored, symlinks=True))


def make_map(folder: Path, workers: int) -> None:
    """Run all tests once and keep which run which lines, and how long they take."""
    from coverage import CoverageData

    tree = copy_tree(folder / "tree")
    (tree / "coverage.ini").write_text("[run]\nsource_pkgs = spm_pin\n")
    options = ["--cov", "--cov-config=coverage.ini", "--cov-context=test", "--cov-report=", "-n", str(workers)]
    run_pytest(tree, *options, limit=8)
    times = json.loads((tree / "times.json").read_text())
    passing = {test: time for test, time in sorted(times.items(), key=lambda item: item[1]) if time < 60}
    of_file = collections.defaultdict(list)
    for test in passing:
        of_file[test.partition("::")[0]].append(test)
    data = CoverageData(str(tree / ".coverage"))
    data.read()
    lines: dict[str, dict[int, list[str]]] = {}
    for file in data.measured_files():
        of_lines = lines[str(Path(file).relative_to(tree))] = {}
        for line, contexts in data.contexts_by_lineno(file).items():
            tests: set[str] = set()
            for test, _, when in (context.rpartition("|") for context in contexts):
                # What a fixture of a file runs is put down to the first of the tests that share it.
                tests.update([test] if when == "run" else of_file[test.partition("::")[0]])
            of_lines[line] = [test for test in passing if test in tests]
    (folder / "map.json").write_text(json.dumps(lines))


def tests_of(fault: dict[str, Any], lines: dict[str, dict[str, list[str]]]) -> tuple[list[str], list[str]]:
    """Return some tests which run the line of a fault, the quickest of different functions, and all that may catch it."""
    of_file = lines.get(fault["file"], {})
    first = of_file.get(str(fault["line"]), [])
    counts: collections.Counter[str] = collections.Counter()
    few = []
    for test in first:
        name = test.partition("[")[0]
        counts[name] += 1
        if counts[name] <= 3 and len(few) < 40:
            few.append(test)
    others = dict.fromkeys(test for tests in of_file.values() for test in tests)
    return few, [test for test in dict.fromkeys([*first, *others]) if test not in few]


def is_caught(fault: dict[str, Any], tree: Path, lines: Any, seconds: float, compiled: bool) -> str:
    """Plant a fault in a copy of the tree, run its tests and return the one that fails, or ''."""
    path = tree / fault["file"]
    source = path.read_bytes()
    at, old = fault["at"], fault["old"].encode()
    assert source[at : at + len(old)] == old, fault
    cached = Path(cache_from_source(str(path)))
    try:
        path.write_bytes(source[:at] + fault["new"].encode() + source[at + len(old) :])
        cached.unlink(missing_ok=True)
        for tests in tests_of(fault, lines):
            (tree / "tests.txt").write_text("".join(f"{test}\n" for test in tests))
            if not tests or not run_pytest(tree, "-x", "@tests.txt", limit=30, seconds=seconds, compiled=compiled):
                continue
            log = (tree / "pytest.log").read_text()
            return next((line for line in log.splitlines() if line.startswith(("FAILED", "ERROR"))), "takes too long")
        return ""
    finally:
        path.write_bytes(source)
        cached.unlink(missing_ok=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=["map", "run", "list"])
    parser.add_argument("--number", type=int, default=240, help="faults, an equal share in each group")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=300, help="the longest time for one fault")
    parser.add_argument("--folder", type=Path, default=ROOT / "build/faults", help="where copies and results are kept")
    parser.add_argument("--compiled", action="store_true", help="test the survivors again, with compiled kernels")
    options = parser.parse_args()
    results = options.folder / "results.jsonl"
    if options.step == "map":
        options.folder.mkdir(parents=True, exist_ok=True)
        return make_map(options.folder, options.workers)
    known = [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
    caught = {(fault["file"], fault["at"], fault["new"]): fault["caught"] for fault in known}
    faults = sample(options.number, options.seed)
    keys = [(fault["file"], fault["at"], fault["new"]) for fault in faults]
    if options.step == "run":
        lines = json.loads((options.folder / "map.json").read_text())
        trees = [copy_tree(options.folder / f"tree{i}") for i in range(options.workers)]
        again = options.compiled
        left = [f for f, key in zip(faults, keys, strict=True) if (not caught.get(key, again) if again else key not in caught)]
        with concurrent.futures.ThreadPoolExecutor(options.workers) as pool, results.open("a") as output:

            def run(fault: dict[str, Any]) -> None:
                tree = trees.pop()
                try:
                    fault["caught"] = is_caught(fault, tree, lines, options.seconds, again)
                finally:
                    trees.append(tree)
                output.write(json.dumps(fault) + "\n")
                output.flush()
                print(describe(fault), flush=True)

            list(pool.map(run, left))
    else:
        ran = [fault | {"caught": caught[key]} for fault, key in zip(faults, keys, strict=True) if key in caught]
        for fault in ran:
            if not fault["caught"]:
                print(describe(fault))
        print(f"{sum(bool(fault['caught']) for fault in ran)} of {len(ran)} faults are caught")
    return None


def describe(fault: dict[str, Any]) -> str:
    place = f"{fault['file']}:{fault['line']}: {fault['kind']} {fault['old']!r} -> {fault['new']!r}"
    return f"{place}  {fault['caught'] or 'SURVIVES'}"


if __name__ == "__main__":
    main()
