"""Dispatch of functions that take a `Manipulator` or a `Stage`, by the type of their first argument."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, ParamSpec, Protocol, TypeVar, cast, overload

from spm_pin.errors import ArgumentError
from spm_pin.machine.machine import check_machine
from spm_pin.machine.stage import Stage

P = ParamSpec("P")
Q = ParamSpec("Q")
R = TypeVar("R", covariant=True)
T = TypeVar("T", covariant=True)


class OfEither(Protocol[P, R, Q, T]):
    """A function of a manipulator, with arguments P, or of a stage, with arguments Q."""

    @overload
    def __call__(self, *args: P.args, **kwargs: P.kwargs) -> R: ...
    @overload
    def __call__(self, *args: Q.args, **kwargs: Q.kwargs) -> T: ...


def or_of_stage(of_stage: Callable[Q, T]) -> Callable[[Callable[P, R]], OfEither[P, R, Q, T]]:
    """Return a decorator of a function of a manipulator, which calls `of_stage` if the first argument is a stage.

    Their arguments differ: a pose for a manipulator is a tilt and a height for a stage.
    """

    def decorate(of_manipulator: Callable[P, R]) -> OfEither[P, R, Q, T]:
        names = {
            True: [*inspect.signature(of_stage).parameters],
            False: [*inspect.signature(of_manipulator).parameters],
        }
        first = names[False][0]

        @functools.wraps(of_manipulator)
        def function(*args: Any, **kwargs: Any) -> Any:
            if not args and first in kwargs:
                args = (kwargs.pop(first),)
            is_stage = bool(args) and isinstance(check_machine(args[0], first), Stage)
            for name in kwargs if args else ():
                if name not in names[is_stage] and name in names[not is_stage]:
                    expected = f"no such argument for a {type(args[0]).__name__}, only {', '.join(names[is_stage])}"
                    cause = "A manipulator takes a pose, a stage takes a height and a tilt"
                    raise ArgumentError(name, expected, "a value", cause)
            chosen: Any = of_stage if is_stage else of_manipulator
            return chosen(*args, **kwargs)

        return cast("OfEither[P, R, Q, T]", function)

    return decorate
