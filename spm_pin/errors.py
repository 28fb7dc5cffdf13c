"""The errors of `spm_pin`: one base class, and the data of each error in its fields.

Every error is an `SpmError`. Those caused by a bad argument are also a `ValueError`, so that programs need not
import this package to catch them. A pose without real branches is not an error: the result has a `Status`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any, Self

__all__ = ["ArgumentError", "ClosureError", "DescriptionError", "GeometryError", "MissingExtraError"]
__all__ += ["NotOneSolutionError", "PoseError", "SelectionError", "SingularConfigurationError", "SpmError"]
__all__ += ["UnreachableError"]

EXTRAS = {
    "arrays": ("array_api_compat",),
    "cluster": ("zarr", "xarray", "dask", "distributed", "filelock"),
    "jax": ("array_api_compat", "jax"),
    "design": ("pymoo",),
    "plots": ("matplotlib", "trimesh"),
    "viewer": ("viser", "trimesh"),
    "workspace": ("trimesh", "skimage"),
}
"""Packages of the optional extras, by the names under which they are imported."""

_LONGEST = 500
"""Largest number of characters of a received value in a message."""


class SpmError(Exception):
    """Base of all errors raised on purpose by this package."""

    def __reduce__(self) -> tuple[Any, ...]:
        # Errors of worker processes are pickled, and made anew from the attributes named after the parameters;
        # the default would pass the message instead.
        return type(self), tuple(self._fields().values()) or self.args

    def _fields(self) -> dict[str, Any]:
        code = getattr(type(self).__init__, "__code__", None)
        return {} if code is None else {name: getattr(self, name) for name in code.co_varnames[1 : code.co_argcount]}

    def replaced(self, **fields: Any) -> Self:
        """Return this error with other values of some of its fields."""
        return type(self)(**self._fields() | fields)


class ArgumentError(SpmError, ValueError):
    """An argument that a function cannot use.

    Attributes
    ----------
    argument : str
        Name of the argument, as in the signature.
    expected : str
        What is accepted.
    received : Any
        The value, or the wrong part of it; the message shows at most 500 characters of it.
    cause : str
        The likely cause, or what to do; may be empty.
    file : str
        The file, of which `argument` is then a key or a column, or empty for the whole file.
    line : int
        Line of the file; 0 if not known.
    index : str
        Key or index of the wrong entry of `argument`, as Python prints it; empty for the whole argument.

    Made with an argument such as ``via[0]``, it has the argument ``via`` and the index ``0``.
    """

    def __init__(
        self,
        argument: str,
        expected: str,
        received: Any,
        cause: str = "",
        file: str = "",
        line: int = 0,
        index: str = "",
    ) -> None:
        if argument.endswith("]"):
            argument, _, index = argument[:-1].partition("[")
        self.argument, self.expected, self.received, self.cause = argument, expected, received, cause
        self.file, self.line, self.index = file, line, index
        subject = f"{argument}[{index}]" if index else argument
        if file:
            place = f"{file}:{line}" if line else file
            subject = f"{subject} in {place}" if subject else place
        message = f"{subject}: expected {expected}, got {_brief(received)}"
        super().__init__(f"{message}. {cause}" if cause else message)


@contextlib.contextmanager
def raised_as(kind: type[ArgumentError], owner: str = "", file: str = "") -> Iterator[None]:
    """Raise an `ArgumentError` of a block or decorated function as another class.

    The argument is named as a part of `owner`, and as read from `file`.
    """
    try:
        yield
    except ArgumentError as error:
        argument = f"{error.argument} of {owner}" if owner else error.argument
        fields = error.expected, error.received, error.cause, error.file or file, error.line, error.index
        raise kind(argument, *fields) from error.__cause__


def _brief(received: Any) -> str:
    """Return `received` as text short enough for a message."""
    try:
        text = str(received)
    except Exception:  # an integer of more digits than Python prints, or a foreign object
        text = f"{type(received).__name__} that cannot be printed"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}… ({len(text)} characters)"


def sentence(text: str) -> str:
    """Return a text, such as a `missing_reason`, that begins with a capital letter."""
    return text[:1].upper() + text[1:]


class GeometryError(ArgumentError):
    """Dimensions or limits that do not describe a machine."""


class PoseError(ArgumentError):
    """A pose that is not a rigid transform of finite numbers."""


class UnreachableError(ArgumentError):
    """A state that is out of reach or beyond the limits."""


class SelectionError(ArgumentError, LookupError):
    """An index, or a label in square brackets, that selects nothing."""


class NotOneSolutionError(SpmError):
    """Raised by `SolutionSet.one` for a problem without a solution, or with several.

    Attributes
    ----------
    labels : tuple of str
        The solutions of the first such problem; empty if it has none.
    index : tuple of int
        Batch index of that problem; empty for a single one.
    cause : str
        Why there is no solution, if known.
    """

    def __init__(self, labels: tuple[str, ...], index: tuple[int, ...], cause: str = "") -> None:
        self.labels = labels
        self.index = index
        self.cause = cause
        where = f" at batch index {index}" if index else ""
        if labels:
            names = ", ".join(labels[:8]) + f" and {len(labels) - 8} more" * (len(labels) > 8)
            message = (
                f"expected exactly one solution, got {len(labels)}{where}: {names}. "
                "Narrow them down with .within(limits), or choose with .nearest(near) or .physical()"
            )
        else:
            cause = cause or "see .status: out of reach or degenerate, or .within(limits) excluded every branch"
            message = f"expected exactly one solution, got none{where}: {cause}"
        super().__init__(message)


class SingularConfigurationError(SpmError):
    """A configuration, singular to rounding, for which the requested quantity does not exist or is not unique.

    Attributes
    ----------
    kind : str
        "inverse": the platform's twist does not determine the leg rates. "forward": the mechanism can move with locked
        actuators. "constraint": the closures lose rank, as where the revolute joints of a stage do not constrain its
        platform, which is both. "leg": the actuator of a PRS or RRS leg does not move its ball.
    sigma_min : float
        Smallest singular value of the matrix concerned, dimensionless; for a leg its slope κ.
    index : tuple of int
        Batch index of the first such member; empty for a single configuration.
    cause : str
        For chains of `spm_pin.loops`: the joints that can move while the actuators stand still; otherwise empty.
    """

    def __init__(self, kind: str, sigma_min: float, index: tuple[int, ...] = (), cause: str = "") -> None:
        self.kind, self.sigma_min, self.index, self.cause = kind, sigma_min, index, cause
        meaning = {
            "inverse": "the twist of the platform does not determine the leg rates",
            "forward": "the mechanism can move with locked actuators",
            "constraint": "the equations of the closures lose rank here",
            "leg": "the actuator of a leg does not move its ball",
        }
        where = f" at batch index {index}" if index else ""
        measure = "slope κ of the leg" if kind == "leg" else "smallest singular value"
        message = f"{kind} singularity{where}: {meaning[kind]} ({measure} {sigma_min:.1e})"
        super().__init__(f"{message}. {cause}" if cause else message)


class MissingExtraError(SpmError, ImportError):
    """A package of an optional extra that is not installed: `extra` is its extra, `package` its name for `import`."""

    def __init__(self, extra: str, package: str) -> None:
        self.extra = extra
        self.package = package
        # Not published on a package index yet: the advice is for a folder of the sources.
        advice = f'pip install ".[{extra}]" in the folder of the sources'
        installed = "scikit-image" if package == "skimage" else package.replace("_", "-")
        super().__init__(f"this needs {installed} of the extra {extra}: {advice}", name=package)


def require_extra(extra: str, *packages: str) -> None:
    """Raise `MissingExtraError` if a package of an extra, or one of those named, is not installed; import nothing."""
    for package in packages or EXTRAS[extra]:
        if find_spec(package) is None:
            raise MissingExtraError(extra, package)


class DescriptionError(ArgumentError):
    """A missing or malformed description file, or a request that a format cannot express.

    For a file, `argument` is its path and line, as ``closures.yaml:5``.
    """


class ClosureError(SpmError):
    """Newton's method did not close the loops.

    Attributes
    ----------
    residual : float
        How far the loop that is most open is from closed at the end of the search, in `unit`.
    iterations : int
        Number of steps.
    loop : str
        Name of this closure or joint equality, if loops have names.
    unit : str
        "m", or "rad" if an angle is wrong.
    """

    def __init__(self, residual: float, iterations: int, cause: str = "", loop: str = "", unit: str = "m") -> None:
        self.residual = residual
        self.iterations = iterations
        self.cause = cause
        self.loop = loop
        self.unit = unit
        message = f"the closures are still {residual:.1e} {unit} open after {iterations} iterations"
        super().__init__(f"{message}. {cause}" if cause else message)
