"""Memory of tiles in compiled code: on the stack, and moved to results by shuffles of whole registers."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core import cgutils, types
from numba.extending import intrinsic, overload

from spm_pin.kinematics.kernels.compilation import TILE, jit_inline

F = TypeVar("F", bound=Callable[..., Any])

_LINE = 64
"""Bytes of a cache line, and of the widest registers."""
LANES = 8
"""Places of a tile that are moved at a time, and numbers of a result: the doubles of a cache line."""
# Numba's own annotations are partial.
_numba: Any = numba
_cgutils: Any = cgutils
_ir: Any = _cgutils.ir
_make_intrinsic: Any = intrinsic
_intrinsic: Callable[..., Callable[[Callable[..., Any]], Callable[..., Any]]] = _make_intrinsic
_types: Any = types


def in_caller(function: F) -> F:
    """Mark a function that is copied into its caller before that is compiled, as what calls `on_stack`'s must be."""
    compiled: F = _numba.njit(inline="always")(function)
    return compiled


def on_stack(make: F) -> F:
    """Mark a function that returns a new array of constant shape: a kernel that calls it keeps it on its stack.

    The compiler then knows that no two arrays overlap, and needs no second version of a loop for the case that they do.
    """
    if _numba.config.DISABLE_JIT:
        return make
    shape = make().shape
    array = _types.Array(_types.float64, len(shape), "C")
    strides = [8 * math.prod(shape[axis + 1 :]) for axis in range(len(shape))]

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        del signature, arguments
        from numba.np import arrayobj  # only compiling needs it

        module: Any = arrayobj
        with builder.goto_entry_block():
            memory = builder.alloca(_ir.ArrayType(_ir.DoubleType(), math.prod(shape)), name=make.__name__)
        memory.align = _LINE
        size = context.get_value_type(_types.intp)
        found = context.make_array(array)(context, builder)
        module.populate_array(
            found,
            data=builder.bitcast(memory, _ir.DoubleType().as_pointer()),
            shape=[size(length) for length in shape],
            strides=[size(stride) for stride in strides],
            itemsize=size(8),
            meminfo=None,
        )
        return found._getvalue()

    @_intrinsic(prefer_literal=False)
    def reserve(typing: Any) -> Any:
        del typing
        return array(), lower

    found: Any = reserve
    found.py_func = make
    return cast(F, found)


@_intrinsic(prefer_literal=False)
def move_block(typing: Any, tile: Any, row: Any, lane: Any, out: Any, start: Any) -> Any:
    """Move 8 rows of 8 places of a tile, transposed, to 8 numbers of each of 8 results from `start`.

    The results are C-contiguous, with as many numbers each as the tile has rows. For compiled code only.
    """
    del typing

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        tile, row, lane, out, start = arguments
        source = context.make_array(signature.args[0])(context, builder, tile)
        target = context.make_array(signature.args[3])(context, builder, out)
        size, vector = context.get_value_type(_types.intp), _ir.VectorType(_ir.DoubleType(), LANES)
        rows = builder.extract_value(source.shape, 0)

        def place(array: Any, line: Any, pitch: Any, column: Any) -> Any:
            at = builder.add(builder.mul(line, pitch), column)
            return builder.bitcast(builder.gep(array.data, [at]), vector.as_pointer())

        lines = [
            builder.load(place(source, builder.add(row, size(i)), size(TILE), lane), align=8) for i in range(LANES)
        ]
        # Exchange the blocks off the diagonal: of 4, then 2, then 1 numbers.
        for step in (4, 2, 1):
            low = [i if not i & step else i - step + LANES for i in range(LANES)]
            high = [i + step if not i & step else i + LANES for i in range(LANES)]
            masks = [_ir.Constant(_ir.VectorType(_ir.IntType(32), LANES), mask) for mask in (low, high)]
            for i in range(LANES):
                if not i & step:
                    pair = lines[i], lines[i + step]
                    lines[i], lines[i + step] = (builder.shuffle_vector(*pair, mask) for mask in masks)
        for i, line in enumerate(lines):
            builder.store(line, place(target, builder.add(start, size(i)), rows, row), align=8)
        return context.get_dummy_value()

    return _types.void(tile, row, lane, out, start), lower


@_intrinsic(prefer_literal=True)
def move_numbers(typing: Any, records: Any, k: Any, first: Any, count: Any, out: Any, n: Any) -> Any:
    """Copy `count` numbers of record k, from `first`, to result n, which has as many; for compiled code only."""
    del typing
    numbers = count.literal_value

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        source = context.make_array(signature.args[0])(context, builder, arguments[0])
        target = context.make_array(signature.args[4])(context, builder, arguments[4])
        size = context.get_value_type(_types.intp)
        width = builder.extract_value(source.shape, 1)
        begin = builder.add(builder.mul(arguments[1], width), arguments[2])
        end = builder.mul(arguments[5], size(numbers))
        kind = _ir.ArrayType(_ir.DoubleType(), numbers).as_pointer()
        loaded = builder.load(builder.bitcast(builder.gep(source.data, [begin]), kind), align=8)
        builder.store(loaded, builder.bitcast(builder.gep(target.data, [end]), kind), align=8)
        return context.get_dummy_value()

    return _types.void(records, k, first, count, out, n), lower


@_intrinsic(prefer_literal=False)
def fetch_line(typing: Any, out: Any, line: Any) -> Any:
    """Prefetch a cache line of a result, eight numbers, that will be written soon; for compiled code only.

    A hint to the processor: it changes no number, and places beyond the result do no harm.
    """
    del typing

    def lower(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        out, line = arguments
        target = context.make_array(signature.args[0])(context, builder, out)
        size, byte, kind = context.get_value_type(_types.intp), _ir.IntType(8).as_pointer(), _ir.IntType(32)
        hint = _ir.FunctionType(_ir.VoidType(), [byte, kind, kind, kind])
        place = builder.bitcast(builder.gep(target.data, [builder.mul(line, size(LANES))]), byte)
        # To be written, to the second cache, data.
        arguments = [place, kind(1), kind(2), kind(1)]
        builder.call(_cgutils.get_or_insert_function(builder.module, hint, "llvm.prefetch.p0i8"), arguments)
        return context.get_dummy_value()

    return _types.void(out, line), lower


def in_blocks(move: Callable[..., None]) -> Callable[[F], F]:
    """Mark a function (width, start, tiles..., results...) that copies the first places of tiles to results in a row.

    Compiled code calls ``move(start, tiles..., results...)`` instead where tiles are full, as most are.
    """

    def decorate(store: F) -> F:
        place_by_place = jit_inline(store)

        @overload(store, jit_options={"forceinline": True, "error_model": "numpy"})
        def compiled(width: Any, *rest: Any) -> Any:
            del width, rest

            def choose(width: Any, *rest: Any) -> None:
                if width == TILE:
                    move(*rest)
                else:
                    place_by_place(width, *rest)

            return choose

        return store

    return decorate
