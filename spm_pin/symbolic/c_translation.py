"""Translation of the kernels' scalar Python into C99, function by function.

What a kernel is written in is a small part of Python: numbers, tuples, arrays of known shape, loops and branches. Types
are inferred from the arguments of a call as Numba does it, so that one Python function may become several in C. Tuples
become structures that are passed by value, arrays pointers, and a tile is `TILE` = 1 problem wide. Every operation is
kept, and its order, hence the bits of the results where the compiler contracts no products and sums.
"""

from __future__ import annotations

import ast
import inspect
import textwrap
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from spm_pin.symbolic.c_expressions import ExpressionTranslator
from spm_pin.symbolic.c_types import Array, Tuple, Type, Value, bare, converted, declaration, joined, literal, mangled

_TABLES = {"f": "double", "i": "int", "c": "complex_number"}


def python_function(function: Any) -> Callable[..., Any]:
    """Return the Python function behind a kernel or an inlined formula."""
    found: Callable[..., Any] = getattr(function, "py_func", function)
    return found


def source_tree(function: Callable[..., Any]) -> ast.FunctionDef:
    """Return the definition of a function, without its decorators and its docstring."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    assert isinstance(tree, ast.FunctionDef)
    tree.decorator_list = []
    if ast.get_docstring(tree) is not None:
        tree.body = tree.body[1:]
    return tree


class Program:
    """Functions in C, each after those that it calls; `constants` replace global names of the kernels, such as TILE."""

    def __init__(self, constants: dict[str, int]) -> None:
        self.constants = constants
        self.structures: dict[str, str] = {}
        self.tables: dict[int, tuple[Value, str, object]] = {}
        self._functions: dict[tuple[object, tuple[Type, ...]], tuple[str, Type | None]] = {}
        self._names: set[str] = set()
        self._definitions: list[str] = []

    @property
    def text(self) -> str:
        """The program: structures, tables, functions."""
        functions = "\n\n".join(self._definitions)
        # Of some tuples every use was one of known items.
        tables = [_wrapped(text) for value, text, _ in self.tables.values() if value.code in functions]
        return "\n".join([*self.structures.values(), "", *tables, "", functions, ""])

    def add(self, function: Any, arguments: tuple[Type, ...]) -> tuple[str, Type | None]:
        """Translate a function for arguments of some types, unless it has been; return its name and type in C."""
        python = python_function(function)
        key = python, arguments
        if key not in self._functions:
            name = self.fresh(f"{python.__module__.rsplit('.', 1)[-1]}_{python.__name__.strip('_')}")
            text, result = FunctionTranslator(self, python, arguments).translate(name)
            self._definitions.append(text)
            self._functions[key] = name, result
        return self._functions[key]

    def fresh(self, name: str) -> str:
        """Return a name that is not used yet."""
        found, k = name, 1
        while found in self._names:
            k += 1
            found = f"{name}_{k}"
        self._names.add(found)
        return found

    def use(self, kind: Type) -> None:
        """Declare the structure of a tuple, if there is none yet."""
        if not isinstance(kind, Tuple) or mangled(kind) in self.structures:
            return
        for item in kind.items:
            self.use(item)
        if kind.homogeneous:
            body = declaration(kind.items[0], f"v[{len(kind.items)}]") + ";"
        else:
            body = " ".join(f"{declaration(item, f'f{i}')};" for i, item in enumerate(kind.items))
        self.structures[mangled(kind)] = f"typedef struct {{ {body} }} {mangled(kind)};"

    def table(self, name: str, constant: Any) -> Value:
        """Return a global array, or a tuple of several numbers, as a constant table."""
        if id(constant) not in self.tables:
            label = self.fresh(name.strip("_").lower() + "_table")
            if isinstance(constant, np.ndarray):
                item = _TABLES[constant.dtype.kind]
                numbers = ", ".join(literal(x).code for x in constant.ravel().tolist())
                value = Value(label, Array(item, constant.shape, const=True))
                text = f"static const {item} {label}[{constant.size}] = {{{numbers}}};"
            else:
                made = literal(constant)
                self.use(made.type)
                value = Value(label, made.type, items=made.items)
                text = f"static const {mangled(made.type)} {label} = {_braced(made)};"
            self.tables[id(constant)] = value, text, constant
        return self.tables[id(constant)][0]


def _braced(value: Value) -> str:
    if not isinstance(value.type, Tuple) or value.items is None:
        return value.code
    inner = ", ".join(_braced(item) for item in value.items)
    return f"{{{{{inner}}}}}" if value.type.homogeneous else f"{{{inner}}}"


def _wrapped(line: str) -> str:
    """Break a line that is too long."""
    indent = " " * (len(line) - len(line.lstrip()) + 8)
    return textwrap.fill(line, 118, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


class FunctionTranslator(ExpressionTranslator):
    """One function for arguments of some types."""

    def __init__(self, program: Program, python: Callable[..., Any], arguments: tuple[Type, ...]) -> None:
        super().__init__(program, python.__globals__)
        self._python = python
        self._tree = source_tree(python)
        names = [argument.arg for argument in self._tree.args.args]
        self._arguments = dict(zip(names, arguments, strict=True))
        self._result: Type | None = None
        nodes = (node for node in ast.walk(self._tree) if isinstance(node, ast.Name))
        self._stores = Counter(node.id for node in nodes if isinstance(node.ctx, ast.Store))

    def translate(self, name: str) -> tuple[str, Type | None]:
        """Return the definition, and the type of the result."""
        self.variables = dict(self._arguments)
        while True:
            known = dict(self.variables), self._result
            self.lines, self.indent, self.count, self.read = [], 1, 0, set()
            self._block(self._tree.body)
            if (self.variables, self._result) == known:
                break
        for kind in (*self.variables.values(), *(() if self._result is None else (self._result,))):
            self.program.use(kind)
        parameters = [declaration(self.variables[n], self.identifier(n)) for n in self._arguments]
        local = [(n, k) for n, k in self.variables.items() if n not in self._arguments]
        groups: dict[Type, list[str]] = {}
        for n, kind in local:
            groups.setdefault(kind, []).append(self.identifier(n))
        head = [f"    {declaration(kind, *names)};" for kind, names in groups.items()]
        head += [f"    (void){self.identifier(n)};" for n in self.variables if n not in self.read]
        summary = (inspect.getdoc(self._python) or "").split("\n\n")[0]
        comment = " ".join(f"{self._python.__module__}.{self._python.__name__}: {summary}".split()).rstrip(": ")
        lines = textwrap.wrap(comment, 110)
        result = declaration(self._result, "").strip() if self._result is not None else "void"
        text = ["/* " + "\n   ".join(lines) + " */", f"static {result} {name}({', '.join(parameters)})", "{"]
        return "\n".join([*text, *map(_wrapped, head), *map(_wrapped, self.lines), "}"]), self._result

    def inline(self, function: Any) -> Value:
        """Translate a function without arguments in place: what makes arrays has to live in its caller."""
        outer = self.globals, self.prefix
        python = python_function(function)
        self.count += 1
        self.globals, self.prefix = python.__globals__, f"own{self.count}_"
        *body, last = source_tree(python).body
        self._block(body)
        assert isinstance(last, ast.Return)
        assert last.value is not None
        found = self.value(last.value)
        self.globals, self.prefix = outer
        return found

    def _block(self, body: list[ast.stmt]) -> None:
        for statement in body:
            try:
                getattr(self, f"_{type(statement).__name__.lower()}")(statement)
            except (AttributeError, TypeError, KeyError) as error:
                where = f"{self._python.__module__}.{self._python.__name__}"
                raise NotImplementedError(f"{where}: {ast.unparse(statement)}: {error!r}") from error

    def _inner(self, body: list[ast.stmt]) -> None:
        self.indent += 1
        self._block(body)
        self.indent -= 1

    def _expr(self, statement: ast.Expr) -> None:
        self.emit(f"{self.value(statement.value).code};")

    def _pass(self, statement: ast.Pass) -> None:
        del statement

    def _return(self, statement: ast.Return) -> None:
        if statement.value is None:
            self.emit("return;")
            return
        value = self.value(statement.value)
        self._result = value.type if self._result is None else joined(self._result, value.type)
        self.program.use(self._result)
        self.emit(f"return {bare(converted(value, self._result))};")

    def _continue(self, statement: ast.Continue) -> None:
        del statement
        self.emit("continue;")

    def _break(self, statement: ast.Break) -> None:
        del statement
        self.emit("break;")

    def _if(self, statement: ast.If) -> None:
        test = self.value(statement.test)
        if test.known is not None:
            self._block(statement.body if test.known else statement.orelse)
            return
        self.emit(f"if ({bare(test.code)}) {{")
        self._inner(statement.body)
        if statement.orelse:
            self.emit("} else {")
            self._inner(statement.orelse)
        self.emit("}")

    def _while(self, statement: ast.While) -> None:
        before = len(self.lines)
        test = self.value(statement.test)
        if len(self.lines) != before:
            raise TypeError("a condition that needs statements of its own")
        self.emit(f"while ({bare(test.code)}) {{")
        self._inner(statement.body)
        self.emit("}")

    def _for(self, statement: ast.For) -> None:
        assert isinstance(statement.iter, ast.Call)
        bounds = [self.value(argument) for argument in statement.iter.args]
        start = bounds[0] if len(bounds) > 1 else literal(0)
        step = bounds[2].known if len(bounds) > 2 else 1
        stop = bounds[0] if len(bounds) == 1 else bounds[1]
        # The body may change what the bound was computed from.
        end = stop if stop.known is not None else self.temporary(stop)
        assert isinstance(statement.target, ast.Name)
        name = statement.target.id
        if name == "_":
            self.count += 1
            name = f"turn{self.count}"
        self.assign_type(name, "int")
        self.read.add(self.prefix + name)
        i, compare = self.identifier(name), "<" if step > 0 else ">"
        self.emit(f"for ({i} = {start.code}; {i} {compare} {end.code}; {i} += {step}) {{")
        self._inner(statement.body)
        self.emit("}")

    def _augassign(self, statement: ast.AugAssign) -> None:
        load = ast.parse(ast.unparse(statement.target), mode="eval").body
        self._store(statement.target, self.value(ast.BinOp(load, statement.op, statement.value)))

    def _annassign(self, statement: ast.AnnAssign) -> None:
        assert statement.value is not None
        self._store(statement.target, self.value(statement.value))

    def _assign(self, statement: ast.Assign) -> None:
        value = self.value(statement.value)
        for target in statement.targets:
            self._store(target, value)

    def _store(self, target: ast.expr, value: Value) -> None:
        if isinstance(target, ast.Tuple):
            kind = value.type
            assert isinstance(kind, Tuple)
            if value.items is None:
                value = self.temporary(value)
                items = [self.item(value, i) for i in range(len(kind.items))]
            else:
                # All are computed before any is stored.
                items = [v if v.known is not None else self.temporary(v) for v in value.items]
            for part, item in zip(target.elts, items, strict=True):
                self._store(part, item)
        elif isinstance(target, ast.Name):
            if target.id != "_":
                self.assign_type(target.id, value.type)
                if isinstance(value.known, int) and self._stores[target.id] == 1 and not self.prefix:
                    self.fixed[target.id] = value.known
                kind = self.variables[self.prefix + target.id]
                self.emit(f"{self.identifier(target.id)} = {bare(self.text(value, kind))};")
        else:
            assert isinstance(target, ast.Subscript)
            place = self.value(target)
            if isinstance(place.type, Array):
                self.fill(place, value)
            else:
                self.emit(f"{place.code} = {bare(converted(value, place.type))};")
