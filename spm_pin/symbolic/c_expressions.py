"""Translation of the expressions of scalar Python into C99."""

from __future__ import annotations

import ast
import builtins
import math
from math import prod
from typing import Any, Protocol

import numpy as np

from spm_pin.symbolic.c_types import Array, Tuple, Type, Value, bare, converted, declaration, joined, literal, structure

_ARITHMETIC = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.BitAnd: "&", ast.BitOr: "|"}
_COMPLEX = {
    ast.Add: "complex_sum",
    ast.Sub: "complex_difference",
    ast.Mult: "complex_product",
    ast.Div: "complex_ratio",
}
_INTEGER = {ast.FloorDiv: "/", ast.Mod: "%"}
_COMPARISONS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_FUNCTIONS: dict[Any, tuple[str, str]] = {
    math.sqrt: ("sqrt", "double"),
    np.sqrt: ("sqrt", "double"),
    math.hypot: ("hypot", "double"),
    math.atan2: ("atan2", "double"),
    np.rint: ("rint", "double"),
    math.isnan: ("isnan", "int"),
    math.isfinite: ("isfinite", "int"),
}
_CASTS: dict[Any, str] = {np.uint8: "int", bool: "int", float: "double", int: "int"}
_KEYWORDS = frozenset(("auto", "const", "double", "enum", "long", "register", "short", "signed", "static", "struct"))


def _evaluated(node: ast.expr) -> Any:
    """Return the value of an expression of constants."""
    return eval(compile(ast.fix_missing_locations(ast.Expression(node)), "", "eval"))


class Declarations(Protocol):
    """The declarations of a C program, made when an expression needs them; see `c_translation.Program`."""

    constants: dict[str, int]

    def add(self, function: Any, arguments: tuple[Type, ...]) -> tuple[str, Type | None]:
        """Declare a function for arguments of these types; return its name and the type of its result."""

    def use(self, kind: Type) -> None:
        """Declare the structure of a type, if it has one."""

    def table(self, name: str, constant: Any) -> Value:
        """Declare a table of constants; return it as a value."""


class ExpressionTranslator:
    """The expressions of one function, and the statements so far, to which those that they need are added.

    `fixed` has the values of integers that are assigned once, and known beforehand, such as lengths of arrays, `read`
    the variables that are used. Variables of a function translated in place begin with `prefix`.
    """

    def __init__(self, program: Declarations, names: dict[str, Any]) -> None:
        self.program = program
        self.globals = names
        self.prefix = ""
        self.variables: dict[str, Type] = {}
        self.fixed: dict[str, int] = {}
        self.read: set[str] = set()
        self.lines: list[str] = []
        self.indent, self.count = 1, 0

    def emit(self, text: str) -> None:
        """Add a statement."""
        self.lines.append("    " * self.indent + text)

    def inline(self, function: Any) -> Value:
        """Translate a call without arguments."""
        raise NotImplementedError

    def identifier(self, name: str) -> str:
        """Return the name of a variable in C."""
        variable = self.prefix + name
        return f"{variable}_" if variable in _KEYWORDS else variable

    def assign_type(self, name: str, kind: Type) -> None:
        """Note that a variable holds values of a type."""
        variable = self.prefix + name
        known = self.variables.get(variable)
        self.variables[variable] = kind if known is None else joined(known, kind)

    def temporary(self, value: Value) -> Value:
        """Store a value under a name of its own."""
        self.count += 1
        self.program.use(value.type)
        name = f"t_{self.count}"
        self.emit(f"{declaration(value.type, name)} = {bare(self.text(value, value.type))};")
        return Value(name, value.type)

    def text(self, value: Value, kind: Type) -> str:
        """Return the text of a value as one of a type."""
        self.program.use(kind)
        return converted(value, kind)

    def item(self, value: Value, i: int) -> Value:
        """Return an item of a tuple."""
        kind = value.type
        assert isinstance(kind, Tuple)
        if value.items is not None:
            return value.items[i]
        if not value.code.replace("_", "").replace(".", "").replace("[", "").replace("]", "").isalnum():
            value = self.temporary(value)
        member = f"v[{i}]" if kind.homogeneous else f"f{i}"
        return Value(f"{value.code}.{member}", kind.items[i])

    def fill(self, place: Value, value: Value) -> None:
        """Set all numbers of an array."""
        assert isinstance(place.type, Array)
        self.count += 1
        size, i = prod(place.type.shape), f"at_{self.count}"
        self.emit(f"{{ int {i}; for ({i} = 0; {i} < {size}; ++{i}) {{ {place.code}[{i}] = {value.code}; }} }}")

    def value(self, node: ast.expr) -> Value:
        """Translate an expression."""
        found: Value = getattr(self, f"_{type(node).__name__.lower()}")(node)
        return found

    def _constant(self, node: ast.Constant) -> Value:
        return literal(node.value)

    def _name(self, node: ast.Name) -> Value:
        variable = self.prefix + node.id
        if variable in self.fixed:
            return literal(self.fixed[variable])
        if variable in self.variables:
            self.read.add(variable)
            return Value(self.identifier(node.id), self.variables[variable])
        found = self._object(node)
        return self.program.table(node.id, found) if isinstance(found, np.ndarray | tuple) else literal(found)

    def _object(self, node: ast.expr) -> Any:
        """Return the object that a global name, or an attribute of a module, stands for."""
        if isinstance(node, ast.Attribute):
            return getattr(self._object(node.value), node.attr)
        assert isinstance(node, ast.Name)
        if node.id in self.program.constants:
            return self.program.constants[node.id]
        return self.globals[node.id] if node.id in self.globals else getattr(builtins, node.id)

    def _attribute(self, node: ast.Attribute) -> Value:
        if isinstance(node.value, ast.Name) and node.value.id in ("np", "math"):
            return literal(self._object(node))
        value = self.value(node.value)
        if node.attr == "shape":
            assert isinstance(value.type, Array)
            return literal(value.type.shape)
        if value.type == "complex_number":
            return Value(f"({value.code}).{'re' if node.attr == 'real' else 'im'}", "double")
        return value if node.attr == "real" else literal(0.0)

    def _tuple(self, node: ast.Tuple) -> Value:
        items = tuple(map(self.value, node.elts))
        kind = Tuple(tuple(item.type for item in items))
        self.program.use(kind)
        return Value(structure(kind, [self.text(v, v.type) for v in items]), kind, items=items)

    def _subscript(self, node: ast.Subscript) -> Value:
        value = self.value(node.value)
        indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if isinstance(kind := value.type, Tuple):
            index = self.value(node.slice)
            if index.known is not None:
                return self.item(value, index.known)
            if value.items is not None and value.known is None and not value.code.endswith("_table"):
                value = self.temporary(value)
            assert kind.homogeneous
            return Value(f"{value.code}.v[{index.code}]", kind.items[0])
        assert isinstance(kind, Array)
        shape = kind.shape
        terms: list[str] = []
        for axis, part in enumerate(indices):
            if isinstance(part, ast.Slice):
                stop = None if part.upper is None else self.value(part.upper).known
                if part.lower is not None or (part.upper is not None and stop is None) or len(terms):
                    raise TypeError("a slice that does not begin at the first number")
                shape = (shape[0] if stop is None else stop, *shape[1:])
                continue
            if len(terms) < axis:
                raise TypeError("an index after a slice")
            stride, index = prod(shape[axis + 1 :]), self.value(part)
            scaled = f"{index.code} * {stride}" if stride != 1 else index.code
            terms.append(scaled if index.known is None else str(index.known * stride or ""))
        where = " + ".join(filter(None, terms))
        if len(terms) == len(shape):
            number = "int" if "char" in kind.item else kind.item
            return Value(f"{value.code}[{where or 0}]", number)
        rest = Array(kind.item, shape[len(terms) :], kind.const)
        return Value(f"({value.code} + {where})" if where else value.code, rest)

    def _unaryop(self, node: ast.UnaryOp) -> Value:
        value = self.value(node.operand)
        if isinstance(node.op, ast.Not):
            return Value(f"(!{value.code})", "int", None if value.known is None else int(not value.known))
        assert isinstance(node.op, ast.USub)
        if value.known is not None:
            return literal(-value.known)
        if value.type == "complex_number":
            return Value(f"complex_of(-({value.code}).re, -({value.code}).im)", "complex_number")
        return Value(f"(-{value.code})", value.type)

    def _binop(self, node: ast.BinOp) -> Value:
        left, right = self.value(node.left), self.value(node.right)
        kind, op = joined(left.type, right.type), type(node.op)
        if left.type == right.type == "int" and None not in (left.known, right.known):
            return literal(_evaluated(ast.BinOp(ast.Constant(left.known), node.op, ast.Constant(right.known))))
        if kind == "complex_number":
            return Value(f"{_COMPLEX[op]}({converted(left, kind)}, {converted(right, kind)})", kind)
        if op is ast.Pow:
            return self._power(left, right)
        if kind == "int" and op in _INTEGER:
            return Value(f"({left.code} {_INTEGER[op]} {right.code})", kind)  # neither is negative
        if op is ast.Mod:
            return Value(f"number_modulo({left.code}, {right.code})", "double")
        if op is ast.Div and kind == "int":
            return Value(f"((double){left.code} / {right.code})", "double")
        return Value(f"({left.code} {_ARITHMETIC[op]} {right.code})", kind)

    def _power(self, base: Value, exponent: Value) -> Value:
        if base.known == 2 and base.type == exponent.type == "int":
            return Value(f"(1 << {exponent.code})", "int")
        if exponent.known == 2 and exponent.type == "int":
            return Value(f"number_square({bare(base.code)})", "double")
        return Value(f"pow({base.code}, {exponent.code})", "double")

    def _boolop(self, node: ast.BoolOp) -> Value:
        sign = " && " if isinstance(node.op, ast.And) else " || "
        return Value(f"({sign.join(self.value(part).code for part in node.values)})", "int")

    def _compare(self, node: ast.Compare) -> Value:
        values = [self.value(part) for part in (node.left, *node.comparators)]
        pairs = zip(values, values[1:], node.ops, strict=False)
        parts = [self._compared(left, right, _COMPARISONS[type(op)]) for left, right, op in pairs]
        known = [value.known for value in values]
        if len(parts) == 1 and None not in known and all(value.type == "int" for value in values):
            return literal(_evaluated(ast.Compare(ast.Constant(known[0]), node.ops, [ast.Constant(known[1])])))
        return Value(parts[0] if len(parts) == 1 else f"({' && '.join(parts)})", "int")

    def _compared(self, left: Value, right: Value, op: str) -> str:
        if isinstance(left.type, Tuple) and isinstance(right.type, Tuple):
            # The first items that differ decide.
            pairs = [(self.item(left, i).code, self.item(right, i).code) for i in range(len(left.type.items))]
            *first, (a, b) = pairs
            return f"({''.join(f'{x} != {y} ? {x} {op} {y} : ' for x, y in first)}{a} {op} {b})"
        if "complex_number" in (left.type, right.type):
            return f"complex_differ({converted(left, 'complex_number')}, {converted(right, 'complex_number')})"
        return f"({left.code} {op} {right.code})"

    def _ifexp(self, node: ast.IfExp) -> Value:
        test = self.value(node.test)
        if test.known is not None:
            return self.value(node.body if test.known else node.orelse)
        yes, no = self.value(node.body), self.value(node.orelse)
        kind = joined(yes.type, no.type)
        return Value(f"({test.code} ? {self.text(yes, kind)} : {self.text(no, kind)})", kind)

    def _call(self, node: ast.Call) -> Value:
        if isinstance(node.func, ast.Attribute) and node.func.attr == "conjugate":
            value = self.temporary(self.value(node.func.value))
            return Value(f"complex_of({value.code}.re, -{value.code}.im)", "complex_number")
        function = self._object(node.func)
        if function in (np.empty, np.ones):
            return self._array(node, function is np.ones)
        read = set(self.read)
        arguments = [self.value(argument) for argument in node.args]
        if function is len:
            self.read = read  # a length is known beforehand
        if function in _FUNCTIONS:
            name, kind = _FUNCTIONS[function]
            return Value(f"{name}({', '.join(bare(value.code) for value in arguments)})", kind)
        if function in _CASTS:
            return Value(f"({_CASTS[function]})({arguments[0].code})", _CASTS[function])
        if getattr(function, "__module__", "") == "builtins":
            return self._builtin(function.__name__, arguments)
        if not arguments:
            return self.inline(function)
        name, result = self.program.add(function, tuple(value.type for value in arguments))
        given = ", ".join(bare(self.text(value, value.type)) for value in arguments)
        return Value(f"{name}({given})", "int" if result is None else result)

    def _array(self, node: ast.Call, ones: bool) -> Value:
        shape = self.value(node.args[0])
        lengths = tuple(item.known for item in shape.items) if shape.items else (shape.known,)
        item = "complex_number" if len(node.args) > 1 else "double"
        self.count += 1
        made = Value(f"array_{self.count}", Array(item, lengths))
        zeros = "{{0.0, 0.0}}" if item == "complex_number" else "{0.0}"
        self.emit(f"{item} {made.code}[{prod(lengths)}] = {zeros};")
        if ones:
            self.fill(made, literal(1.0))
        return made

    def _builtin(self, name: str, values: list[Value]) -> Value:
        first, *others = values
        match name:
            case "len":
                assert isinstance(first.type, Array | Tuple)
                return literal(first.type.shape[0] if isinstance(first.type, Array) else len(first.type.items))
            case "abs" if first.type == "complex_number":
                whole = self.temporary(first)
                return Value(f"hypot({whole.code}.re, {whole.code}.im)", "double")
            case "abs":
                return Value(f"fabs({first.code})", "double")
            case "complex":
                return Value(f"complex_of({first.code}, {others[0].code})", "complex_number")
            case "divmod":
                items = tuple(Value(f"({first.code} {op} {others[0].code})", "int") for op in "/%")
                return Value("", Tuple(("int", "int")), items=items)
            case "max" | "min":
                return self._extreme(name, tuple(values))
        raise TypeError(f"the function {name}")

    def _extreme(self, name: str, values: tuple[Value, ...]) -> Value:
        if len(values) == 1:
            assert isinstance(values[0].type, Tuple)
            whole = values[0] if values[0].items is not None else self.temporary(values[0])
            values = tuple(self.item(whole, i) for i in range(len(values[0].type.items)))
        kind, found = "number", "double"
        if all(value.type == "int" for value in values):
            if all(value.known is not None for value in values):
                return literal(getattr(builtins, name)(value.known for value in values))
            kind, found = "index", "int"
        code = values[0].code
        for value in values[1:]:
            code = f"{kind}_{name}imum({code}, {value.code})"
        return Value(code, found)
