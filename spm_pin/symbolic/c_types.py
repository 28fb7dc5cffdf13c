"""Types and values of translated code: numbers, tuples as structures, arrays of known shape as pointers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Tuple:
    """A tuple, which C passes as a structure."""

    items: tuple[Type, ...]

    @property
    def homogeneous(self) -> bool:
        """Whether all items have one type, and are numbered by an index."""
        return len(set(self.items)) == 1


@dataclass(frozen=True)
class Array:
    """A C-contiguous array of known shape, a pointer to its first number; its numbers are read only if `const`."""

    item: str
    shape: tuple[int, ...]
    const: bool = False


Type = str | Tuple | Array
"""`int`, which stands for booleans too, `double`, `complex_number`, a tuple or an array."""

_RANK = {"int": 0, "double": 1, "complex_number": 2}


@dataclass(frozen=True)
class Value:
    """An expression: its text in C, its type, its value if it is known, its items if it is a tuple just made."""

    code: str
    type: Type
    known: Any = None
    items: tuple[Value, ...] | None = None


def mangled(kind: Type) -> str:
    """Return a short name of a type, made of letters that can be part of a C identifier."""
    if isinstance(kind, Tuple):
        if kind.homogeneous:
            return f"t{len(kind.items)}{mangled(kind.items[0])}"
        return f"t{len(kind.items)}_{'_'.join(mangled(item) for item in kind.items)}"
    if isinstance(kind, Array):
        return f"p{'c' if kind.const else ''}{kind.item.replace(' ', '_')}"
    return kind[0]


def declaration(kind: Type, *names: str) -> str:
    """Return the declaration of variables of one type."""
    if isinstance(kind, Array):
        return f"{'const ' if kind.const else ''}{kind.item} {', '.join(f'*{name}' for name in names)}"
    return f"{mangled(kind) if isinstance(kind, Tuple) else kind} {', '.join(names)}"


def joined(first: Type, second: Type) -> Type:
    """Return the type of what is of either type.

    Raises
    ------
    TypeError
        If there is none.
    """
    if first == second:
        return first
    if isinstance(first, str) and isinstance(second, str):
        return max(first, second, key=_RANK.__getitem__)
    if isinstance(first, Tuple) and isinstance(second, Tuple) and len(first.items) == len(second.items):
        return Tuple(tuple(map(joined, first.items, second.items)))
    raise TypeError(f"{first} and {second}")


def converted(value: Value, kind: Type) -> str:
    """Return the text of a value as one of another type; C itself makes integers to floats."""
    if isinstance(kind, Tuple) and value.items is not None:
        return structure(kind, [converted(v, k) for v, k in zip(value.items, kind.items, strict=True)])
    if kind == "complex_number" and value.type != "complex_number":
        return f"complex_of({value.code}, 0.0)"
    return value.code


def structure(kind: Tuple, items: Sequence[str]) -> str:
    """Return a compound literal of a tuple."""
    inner = ", ".join(items)
    return f"({mangled(kind)}){{{f'{{{inner}}}' if kind.homogeneous else inner}}}"


def literal(number: Any) -> Value:
    """Return a constant of Python."""
    if isinstance(number, bool | int):
        return Value(str(int(number)), "int", int(number))
    if isinstance(number, complex):
        return Value(f"{{{literal(number.real).code}, {literal(number.imag).code}}}", "complex_number")
    if isinstance(number, float):
        if number != number:
            return Value("NAN", "double", number)
        if abs(number) == float("inf"):
            return Value("INFINITY" if number > 0 else "-INFINITY", "double", number)
        text = repr(float(number))
        return Value(f"({text})" if number < 0.0 else text, "double", number)
    items = tuple(literal(item) for item in number)
    return Value("", Tuple(tuple(item.type for item in items)), number, items)


def bare(code: str) -> str:
    """Return an expression without a pair of parentheses around all of it."""
    depth = 0
    for k, letter in enumerate(code):
        depth += (letter == "(") - (letter == ")")
        if depth == 0:
            return code[1:-1] if k == len(code) - 1 and code[0] == "(" else code
    return code
