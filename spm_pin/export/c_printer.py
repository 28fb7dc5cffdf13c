"""Functions of CasADi as C, one assignment for each of their instructions."""

from __future__ import annotations

import math
from textwrap import fill

import casadi as ca

_EXPRESSIONS = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SQRT: "sqrt({0})",
    ca.OP_SIN: "sin({0})",
    ca.OP_COS: "cos({0})",
    ca.OP_ATAN2: "atan2({0}, {1})",
    ca.OP_FABS: "fabs({0})",
    ca.OP_COPYSIGN: "copysign({0}, {1})",
    ca.OP_FMAX: "larger({0}, {1})",
    ca.OP_FMIN: "smaller({0}, {1})",
    ca.OP_LT: "{0} < {1}",
    ca.OP_LE: "{0} <= {1}",
    ca.OP_EQ: "{0} == {1}",
    ca.OP_NE: "{0} != {1}",
    ca.OP_NOT: "{0} == 0.0",
    ca.OP_AND: "{0} != 0.0 && {1} != 0.0",
    ca.OP_OR: "{0} != 0.0 || {1} != 0.0",
    ca.OP_IF_ELSE_ZERO: "{0} != 0.0 ? {1} : 0.0",
}
"""Instructions that formulas need; `larger` and `smaller` are functions of the template."""


def c_function(function: ca.Function) -> str:
    """Return a function of dense arrays in C; it may write results before the last argument is read."""
    lines, variables, is_read = [], set(), False
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        inputs, outputs = function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            lines.append(f"    res[{outputs[0]}][{outputs[1]}] = a{inputs[0]};")
            continue
        if operation == ca.OP_INPUT:
            expression, is_read = f"arg[{inputs[0]}][{inputs[1]}]", True
        elif operation == ca.OP_CONST:
            expression = number(function.instruction_constant(k))
        else:
            expression = _EXPRESSIONS[operation].format(*(f"a{i}" for i in inputs))
        lines.append(f"    a{outputs[0]} = {expression};")
        variables.add(outputs[0])
    declared = fill(", ".join(f"a{i}" for i in sorted(variables)), 110, subsequent_indent=" " * 12)
    head = [
        f"static void {function.name()}(const double *const *arg, double *const *res)",
        "{",
        f"    double {declared};",
    ]
    return "\n".join([*head, *([] if is_read else ["    (void)arg;"]), *lines, "}", ""])


def number(x: float) -> str:
    """Return a number of double precision in C."""
    if math.isfinite(x):
        return repr(float(x))
    return "NAN" if math.isnan(x) else ("INFINITY" if x > 0.0 else "-INFINITY")
