# mypy: allow-untyped-calls
"""Extensions of Numba for kernels: `PlainArrays` as an argument, functions that they call, and an announcement."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

import numba
from numba.core import event, types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import (
    NativeValue,
    infer_getattr,
    lower_getattr_generic,
    models,
    overload,
    register_model,
    typeof_impl,
    unbox,
)
from numba.np.arrayobj import populate_array

from spm_pin.loops.plain_arrays import PlainArrays


def register(function: Callable[..., Any], implementation: Callable[..., Any], options: dict[str, Any]) -> None:
    """Let kernels call a function, for which an implementation is compiled."""
    # Without wrappers for C, which nothing calls, compiling takes a tenth less.
    every: Any = {"error_model": "numpy", "no_cfunc_wrapper": True, **options}
    overload(function, jit_options=every, strict=False)(lambda *_: implementation)


class Announcement(event.Listener):
    """Log that Numba begins to compile, not that it loads what is kept."""

    def __init__(self) -> None:
        self._announced = False

    def on_start(self, event: Any) -> None:
        """Log once."""
        if not self._announced:
            message = "spm_pin: compiling the loops of closed chains for this machine, once (about half a minute)"
            logging.getLogger("spm_pin").warning(message)
        self._announced = True

    def on_end(self, event: Any) -> None:
        """Do nothing."""


class _PlainType(types.Type):
    def __init__(self, fields: dict[str, Any]) -> None:
        self.fields = {name: (3 * k, numba.typeof(value)) for k, (name, value) in enumerate(fields.items())}
        super().__init__(f"PlainArrays({self.fields})")


register_model(_PlainType)(models.OpaqueModel)


@typeof_impl.register(PlainArrays)
def _type_of(value, _):  # type: ignore[no-untyped-def]
    return _PlainType(value.fields)


@unbox(_PlainType)
def _unbox(_, value, c):  # type: ignore[no-untyped-def]
    number = c.pyapi.object_getattr_string(value, "address")
    pointer = c.pyapi.long_as_voidptr(number)
    c.pyapi.decref(number)
    return NativeValue(pointer)


@infer_getattr
class _Fields(AttributeTemplate):
    key = _PlainType

    def generic_resolve(self, kind, name):  # type: ignore[no-untyped-def, override]
        """Return the type of a field."""
        return kind.fields[name][1]


@lower_getattr_generic(_PlainType)
def _load(context, builder, kind, tree, name):  # type: ignore[no-untyped-def]
    (place, field), integer = kind.fields[name], context.get_value_type(types.intp)
    table = builder.bitcast(tree, integer.as_pointer())

    def number(k):  # type: ignore[no-untyped-def]
        result = builder.load(builder.gep(table, [integer(place + k)]))
        # The table never changes, so that a loop may keep what is read before it.
        result.set_metadata("invariant.load", builder.module.add_metadata([]))
        return result

    if not isinstance(field, types.Array):
        return number(0)
    array, item = context.make_array(field)(context, builder), field.dtype.bitwidth // 8
    shape = [number(1 + k) for k in range(field.ndim)]
    strides = [integer(item)] if field.ndim == 1 else [builder.mul(shape[1], integer(item)), integer(item)]
    data = builder.inttoptr(number(0), array.data.type)
    populate_array(array, data, shape, strides, integer(item), meminfo=None)
    return array._getvalue()
