"""Plant faults in the package, one at a time, and count how many of them the normal tests catch.

    python scripts/planted_faults.py run               # plant 240 faults; interrupted, it goes on where it was
    python scripts/planted_faults.py run --again       # plant those again that survived, with more tests
    python scripts/planted_faults.py list              # show what survived, and the rate

A fault is a changed sign, index, constant or comparison, two arguments in the wrong order or a copy not made. The
same seed plants the same faults wherever their lines have not changed, an equal number in each group of files, each in
a copy of the tree. Kernels are interpreted, which gives the same bits: compiling each fault would take minutes. A fault
is caught if a test fails that passes without it; first run those test files that have caught faults in the same file.
Numbers below 1e-4 are left alone: they are tolerances, whose double is no fault.

Faults that change no result, or only how long it takes, are listed with their reasons in
`planted_faults_equivalent.txt` and not counted. When their line changes, so does their key.

mutmut and cosmic-ray run all tests of a module for each of all faults, which takes days here; mutmut moreover puts a
wrapper around each function, which Numba does not compile.
"""

from __future__ import annotations

import argparse
import ast
import collections
import concurrent.futures
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
EQUIVALENT = Path(__file__).with_name("planted_faults_equivalent.txt")
GROUPS = {  # readers and exporters before the folders that they lie in
    "exporters": ["export/*.py", "loops/write_chain.py", "description/*.py", "casadi/*.py"],
    "readers": ["loops/read_*.py", "loops/xml_input.py", "calibration/measurements.py", "support/motion_table.py"],
    "machine": ["machine/*.py"],
    "loops": ["loops/*.py"],
    "kernels": ["kinematics/kernels/*.py"],
    "formulas": ["formulas/*.py"],
}
SWAPS = {
    ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*"),
    ast.Lt: ("<", ">"), ast.Gt: (">", "<"), ast.LtE: ("<=", ">="), ast.GtE: (">=", "<="), ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="), ast.Is: ("is", "is not"), ast.IsNot: ("is not", "is"), ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"), ast.And: ("and", "or"), ast.Or: ("or", "and"),
}  # fmt: skip
TESTS = {  # folders of tests that run a folder of the package
    "calibration": "calibration cli",
    "casadi": "export arrays crosscheck motion",
    "description": "description display multibody",
    "export": "export cli",
    "formulas": "kinematics export arrays workspace proofs",
    "kinematics": "kinematics machine workspace proofs",
    "loops": "loops multibody description",
    "machine": "machine kinematics calibration proofs description display",
    "support": "machine calibration cli display",
}
SYMMETRIC = {"dot", "both", "either", "min", "max", "minimum", "maximum", "isinstance", "add", "hypot", "equal", "zip"}
PYTEST = ["-m", "pytest", "-x", "-q", "-m", "not slow and not documents", "-o", "cache_dir=.faults"]
ENVIRONMENT = {"SPM_PIN_THREADS": "1", "SPM_PIN_KERNELS": "interpreted", "NUMBA_DISABLE_JIT": "1", "COLUMNS": "300"}


def faults_of(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the faults that can be planted in a file: place, text there and text to put instead."""
    source = path.read_bytes()
    lines = source.splitlines(keepends=True)
    starts = [sum(map(len, lines[:i])) for i in range(len(lines) + 1)]
    seen: collections.Counter[str] = collections.Counter()

    def begin(node: ast.AST) -> int:
        return starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]

    def end(node: ast.AST) -> int:
        return starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]

    def text(node: ast.AST) -> str:
        return source[begin(node) : end(node)].decode()

    def fault(kind: str, first: int, last: int, new: str) -> dict[str, Any]:
        line = source.count(b"\n", 0, first) + 1
        old, file, whole = source[first:last].decode(), str(path.relative_to(ROOT)), lines[line - 1].decode()
        place = f"{file} {whole.strip()} {first - starts[line - 1] - len(whole) + len(whole.lstrip())} {new}"
        seen[place] += 1
        key = hashlib.sha1(f"{place} {seen[place]}".encode()).hexdigest()[:8]
        return {"key": key, "file": file, "line": line, "kind": kind, "at": first, "old": old, "new": new}

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
            case ast.keyword(arg="strict"):
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
            case ast.Call(
                func=ast.Attribute(attr="array", value=ast.Name(id="np")), args=[ast.Name() | ast.Subscript()]
            ):
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

    def rank(fault: dict[str, Any]) -> bytes:
        return hashlib.sha1(f"{seed} {fault['key']}".encode()).digest()

    chosen: list[dict[str, Any]] = []
    taken: set[Path] = set()
    for group, patterns in GROUPS.items():
        files = {path for pattern in patterns for path in (ROOT / "spm_pin").glob(pattern)} - taken
        taken |= files
        possible = [fault | {"group": group} for path in sorted(files) for fault in faults_of(path)]
        chosen += sorted(possible, key=rank)[: number // len(GROUPS)]
    return sorted(chosen, key=rank)


def closest_tests(fault: dict[str, Any], results: list[dict[str, Any]], number: int) -> list[str]:
    """Return first test files that have caught faults in the same file, then those with words of its name."""
    file = Path(fault["file"])
    caught = collections.Counter(f["caught"].partition("::")[0] for f in results if f["file"] == fault["file"])
    folders = TESTS[file.parts[1]].split()
    paths = [path for folder in folders for path in (ROOT / "tests" / folder).rglob("test_*.py")]

    def order(path: Path) -> tuple[int, int, int, int]:
        words, name = {word for word in file.stem.split("_") if len(word) > 2}, path.relative_to(ROOT)
        return (
            -caught[str(name)],
            -len(words & set(path.stem.split("_"))),
            folders.index(name.parts[1]),
            path.stat().st_size,
        )

    return [str(path.relative_to(ROOT)) for path in sorted(paths, key=order)[:number]]


class Tree:
    """A copy of the working tree in which faults are planted."""

    def __init__(self, folder: Path, options: argparse.Namespace) -> None:
        self.path, self.seconds, self.sound, self.unsound = folder / "tree", options.seconds, set[str](), set[str]()
        shutil.rmtree(folder, ignore_errors=True)
        ignored = shutil.ignore_patterns(".git", ".venv", "build", "dist", ".*_cache", "__pycache__", ".hypothesis")
        shutil.copytree(ROOT, self.path, ignore=ignored, symlinks=True)
        self.environment = os.environ | {"PYTHONPATH": str(self.path), "PYTHONDONTWRITEBYTECODE": "1"}
        self.environment |= {} if options.compiled else ENVIRONMENT

    def first_failure(self, tests: list[str]) -> str:
        """Return the first test that fails, or ''."""
        failed = self.path / ".faults/v/cache/lastfailed"
        failed.unlink(missing_ok=True)
        skipped = [word for test in self.unsound for word in ("--deselect", test)]
        command = [sys.executable, *PYTEST, *skipped, *tests]
        with (self.path.parent / "pytest.log").open("w") as log:
            process = subprocess.Popen(
                command, cwd=self.path, env=self.environment, stdout=log, stderr=log, start_new_session=True
            )
            try:
                code = process.wait(self.seconds)
            except subprocess.TimeoutExpired:  # not caught: an endless loop is rare, and is seen in the log
                os.killpg(process.pid, signal.SIGKILL)  # servers that the tests have started, too
                process.wait()
                return ""
        if failed.exists() and (tests := list(json.loads(failed.read_text()))):
            return tests[0]
        if code > 1 and code != 5:  # 5: no test selected
            raise RuntimeError(f"pytest did not run: see {log.name}")
        return ""

    def catcher(self, fault: dict[str, Any], tests: list[str]) -> str:
        """Plant a fault and return the test that fails and passes without it, or ''."""
        path = self.path / fault["file"]
        source, at, old = path.read_bytes(), fault["at"], fault["old"].encode()
        assert source[at : at + len(old)] == old, "the tree has changed"
        while True:
            path.write_bytes(source[:at] + fault["new"].encode() + source[at + len(old) :])
            try:
                test = self.first_failure(tests)
            finally:
                path.write_bytes(source)
            if not test or test in self.sound:
                return test
            (self.unsound if self.first_failure([test]) else self.sound).add(test)


def run(faults: list[dict[str, Any]], results: list[dict[str, Any]], options: argparse.Namespace) -> None:
    """Plant faults and append each result to the file of results."""
    trees = [Tree(options.folder / str(i), options) for i in range(options.workers)]

    def plant(fault: dict[str, Any]) -> None:
        tree = trees.pop()
        try:
            fault = fault | {"caught": tree.catcher(fault, closest_tests(fault, results, options.files))}
        finally:
            trees.append(tree)
        print(describe(fault), flush=True)
        results.append(fault)
        with (options.folder / "results.jsonl").open("a") as output:
            output.write(json.dumps(fault) + "\n")

    with concurrent.futures.ThreadPoolExecutor(options.workers) as pool:
        list(pool.map(plant, faults))


def describe(fault: dict[str, Any]) -> str:
    """Return a line about a fault."""
    change = f"{fault['file']}:{fault['line']}: {fault['old'].strip()} -> {fault['new'].strip()}"
    return f"{fault['key']} {change}  {fault['caught'] or 'SURVIVES'}"


def main() -> None:
    """Run one step of the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=["run", "list"])
    parser.add_argument("--number", type=int, default=240, help="faults, an equal share in each group")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--files", type=int, default=24, help="test files to run for a fault")
    parser.add_argument("--seconds", type=float, default=300, help="the longest time for one fault")
    parser.add_argument("--folder", type=Path, default=ROOT / "build/faults", help="where copies and results are kept")
    parser.add_argument("--again", action="store_true", help="plant those again that survived")
    parser.add_argument("--compiled", action="store_true", help="with compiled kernels: for the last survivors")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    options.folder = options.folder.resolve()
    path = options.folder / "results.jsonl"
    results = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = {fault["key"]: fault for fault in results}
    equivalent = {line.split()[0] for line in EQUIVALENT.read_text().splitlines()}
    faults = [fault for fault in sample(options.number, options.seed) if fault["key"] not in equivalent]
    survivors = [fault for fault in faults if not known.get(fault["key"], {"caught": True})["caught"]]
    if options.step == "run":
        return run(survivors if options.again else [f for f in faults if f["key"] not in known], results, options)
    for fault in survivors:
        print(describe(fault | {"caught": ""}))
    planted = sum(fault["key"] in known for fault in faults)
    print(f"{planted - len(survivors)} of {planted} faults are caught; {options.number - len(faults)} are equivalent")
    return None


if __name__ == "__main__":
    main()
