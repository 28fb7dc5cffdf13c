"""The kernels' scalar formulas as CasADi expressions, traced from their own source.

A formula is run by the interpreter with `casadi.SX` in place of numbers. What Python would decide with a number's value
becomes an expression: a conditional expression, `&` and `|`, `max` and `min`. A tile of problems is one problem wide.

Two rules keep everything finite. A square root is taken of at least `FLOOR`, so that outside reach the root of a
negative discriminant is that of zero to all digits; and where a kernel would write NaN there is zero.
"""

from __future__ import annotations

import ast
import functools
import types
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from spm_pin.symbolic.c_translation import python_function, source_tree

FLOOR = 1e-40
"""Least radicand of a square root: its root is far below rounding, and its powers in derivatives are finite."""


def table(*shape: int) -> Any:
    """Return an array of zeros that expressions can be put into."""
    return np.zeros(shape, dtype=object)


@functools.cache
def traced(function: Any) -> Callable[..., Any]:
    """Return a formula, or a kernel, as a function of CasADi expressions."""
    python = python_function(function)
    tree = source_tree(python)
    tree.returns = None
    for argument in tree.args.args:
        argument.annotation = None
    known = python.__globals__
    used = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
    names = {name: _replaced(known[name]) for name in used & known.keys()} | _REPLACED
    module = ast.fix_missing_locations(ast.Module([_Branchless().visit(tree)], type_ignores=[]))
    exec(compile(module, f"<traced {python.__name__}>", "exec"), names)
    found: Callable[..., Any] = names[python.__name__]
    return found


def _replaced(found: Any) -> Any:
    """Return the object that a global name stands for while a formula is traced."""
    if isinstance(found, np.ndarray):
        return found.astype(object)  # plain numbers
    return traced(found) if callable(python_function(found)) and not isinstance(found, type) else found


class _Branchless(ast.NodeTransformer):
    """Write what has no value while symbols are traced as calls."""

    def visit_IfExp(self, node: ast.IfExp) -> ast.AST:
        self.generic_visit(node)
        return self._call("select", node.test, node.body, node.orelse)

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        name = {ast.BitAnd: "both", ast.BitOr: "either"}.get(type(node.op))
        return node if name is None else self._call(name, node.left, node.right)

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        load = ast.parse(ast.unparse(node.target), mode="eval").body
        return ast.Assign([node.target], self.visit(ast.BinOp(load, node.op, node.value)))

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        self.generic_visit(node)
        return self._call(node.attr, node.value) if node.attr in ("real", "imag") else node

    def _call(self, name: str, *arguments: ast.expr) -> ast.Call:
        return ast.Call(ast.Name(f"traced_{name}", ast.Load()), list(arguments), [])


def _sqrt(x: Any) -> Any:
    return ca.sqrt(ca.fmax(x, FLOOR))


def _select(test: Any, yes: Any, no: Any) -> Any:
    return ca.if_else(test, yes, no) if isinstance(test, ca.SX) else (yes if test else no)


def _same(x: Any) -> Any:
    return x


_REPLACED: dict[str, Any] = {
    "TILE": 1,
    "np": types.SimpleNamespace(
        sqrt=_sqrt,
        nan=0.0,
        inf=np.inf,
        uint8=_same,
        empty=lambda shape: table(*np.atleast_1d(shape)),
        ones=lambda shape: table(*np.atleast_1d(shape)) + 1.0,
    ),
    "math": types.SimpleNamespace(sqrt=_sqrt),
    "max": lambda *values: functools.reduce(ca.fmax, values),
    "min": lambda *values: functools.reduce(lambda a, b: min(a, b) if isinstance(a, int) else ca.fmin(a, b), values),
    "abs": ca.fabs,
    "bool": _same,
    "float": _same,
    "traced_select": _select,
    "traced_both": ca.logic_and,
    "traced_either": ca.logic_or,
    "traced_real": _same,
    "traced_imag": lambda x: 0.0 * x,
}
