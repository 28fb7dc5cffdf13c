"""The errors of `spm_pin`, one family, each carrying the data that explains it.

Every error is an `SpmError`. Those caused by a bad argument are also a `ValueError`, so code that knows
nothing of this package still catches them. "No real branch" is no error: it is a `Status`.
"""

from __future__ import annotations

from typing import Any

__all__ = [
    "ArgumentError",
    "GeometryError",
    "NotOneSolutionError",
    "PoseError",
    "SpmError",
]


class SpmError(Exception):
    """Base of all errors raised on purpose by this package."""


class ArgumentError(SpmError, ValueError):
    """An argument that cannot be what the function needs.

    Attributes
    ----------
    argument : str
        Name of the argument, as in the signature.
    expected : str
        What would have been accepted.
    received : Any
        What came: the value, or the part of it that is wrong.
    """

    def __init__(self, argument: str, expected: str, received: Any, cause: str = "") -> None:
        self.argument = argument
        self.expected = expected
        self.received = received
        self.cause = cause
        message = f"{argument}: expected {expected}, got {received}"
        super().__init__(f"{message}. {cause}" if cause else message)

    def __reduce__(self) -> tuple[type[ArgumentError], tuple[str, str, Any, str]]:
        # Worker processes send errors home pickled; the default would replay the message as `argument`.
        return type(self), (self.argument, self.expected, self.received, self.cause)


class GeometryError(ArgumentError):
    """Dimensions or limits that describe no manipulator."""


class PoseError(ArgumentError):
    """A pose that is not a rigid transform of finite numbers."""


class NotOneSolutionError(SpmError):
    """`SolutionSet.one` found no solution, or several.

    Attributes
    ----------
    labels : tuple of str
        The solutions found at the first offending pose; empty where there is none.
    index : tuple of int
        Batch index of that pose; empty for a single pose.
    """

    def __init__(self, labels: tuple[str, ...], index: tuple[int, ...]) -> None:
        self.labels = labels
        self.index = index
        where = f" at batch index {index}" if index else ""
        if labels:
            message = (
                f"expected exactly one solution, got {len(labels)}{where}: {', '.join(labels)}. "
                "Narrow them down with .within(limits), or choose with .nearest(seed) or .physical()"
            )
        else:
            message = (
                f"expected exactly one solution, got none{where}. See .status: the pose is out of reach "
                "or degenerate, or .within(limits) excluded every branch"
            )
        super().__init__(message)

    def __reduce__(self) -> tuple[type[NotOneSolutionError], tuple[tuple[str, ...], tuple[int, ...]]]:
        return type(self), (self.labels, self.index)
