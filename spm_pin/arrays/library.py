"""Arrays of any library that follows the Array API standard, as numbers that the formulas run on; machines of them."""

from __future__ import annotations

import functools
import importlib
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from spm_pin.errors import ArgumentError, MissingExtraError
from spm_pin.formulas import leg_constants, leg_planes
from spm_pin.formulas.leg_constants import AXES
from spm_pin.formulas.operations import bind, mapped, vector_of
from spm_pin.formulas.planar_legs import MOST_TURNED
from spm_pin.formulas.stage_numbers import StageNumbers, stage_numbers
from spm_pin.machine import Configuration, LegKind, Machine, Manipulator, Stage
from spm_pin.machine.joint_angles import joint_names
from spm_pin.machine.leg_kinds import BOUNDS
from spm_pin.machine.machine import ALONE
from spm_pin.support.arguments import LARGEST, LARGEST_RATIO, SMALLEST, check_shapes, type_and_value

try:
    import array_api_compat as compat
except ImportError as error:
    raise MissingExtraError("arrays", "array_api_compat") from error

Array = Any
"""An array of any library that follows the standard."""
_TRAILING = {"rotation": (3, 3), "translation": (3,), "middle_joints": (3, 3), "wrench": (6,)}
_TRAILING |= {"normal": (3,)}
"""The last axes of arrays by their names."""
quietly = np.errstate(all="ignore")
"""Decorates functions in which numbers of what does not exist are no reason for NumPy's warnings."""
_RPS = Manipulator(1.0, 1.0, 1.0)
"""A machine of RPS legs: what dimensions and parameters that are given without a `Manipulator` describe."""


class Library:
    """A library of arrays with one type of floats: runs formulas on tuples of arrays, entry by entry."""

    def __init__(self, namespace: Any, dtype: Any) -> None:
        self.xp, self.dtype = namespace, dtype
        self.eps = float(namespace.finfo(dtype).eps)
        self.is_jax = compat.is_jax_namespace(namespace)
        self.has_derivatives = self.is_jax or compat.is_torch_namespace(namespace)
        self.least, self.normal = self.eps**2.5, float(namespace.finfo(dtype).smallest_normal)
        self._bound: dict[Any, Callable[..., Any]] = {}

    def run(self, formula: Callable[..., Any], *arguments: Any) -> Any:
        """Run a formula of `spm_pin.formulas` on numbers, arrays, and tuples of them."""
        if formula not in self._bound:
            operations = {"sqrt": self.sqrt, "where": self.where, "arctan2": self.arctan2, "magnitude": abs}
            self._bound[formula] = bind(formula, cos=self.cos, sin=self.sin, **operations)
        return self._bound[formula](*arguments)

    def formulas(self, kind: LegKind) -> Any:
        """Return the formulas of a kind of legs, as arguments of other formulas."""
        return kind.bound(lambda formula: functools.partial(self.run, formula))

    def sqrt(self, x: Any) -> Any:
        """Return the square root, of zero and less a tiny number: derivatives stay finite."""
        if type(x) is float:
            return math.sqrt(x) if x >= 0.0 else math.nan
        return self.xp.sqrt(self.xp.where(x > self.least, x, self.least))

    def cos(self, x: Any) -> Any:
        """Return the cosine."""
        return math.cos(x) if type(x) is float else self.xp.cos(x)

    def sin(self, x: Any) -> Any:
        """Return the sine."""
        return math.sin(x) if type(x) is float else self.xp.sin(x)

    def arctan2(self, y: Any, x: Any) -> Any:
        """Return the angle of a vector; zero for a zero vector, where derivatives are finite too."""
        if type(x) is float and type(y) is float:
            return math.atan2(y, x)
        return self.xp.atan2(y, self.xp.where(x * x + y * y > self.normal, x, 1.0))

    def where(self, condition: Any, yes: Any, no: Any) -> Any:
        """Select entry by entry."""
        if isinstance(condition, bool):
            return yes if condition else no
        if type(yes) is float and type(no) is float:
            yes = self.xp.full_like(condition, yes, dtype=self.dtype)
        return self.xp.where(condition, yes, no)

    def select(self, condition: Array, yes: Any, no: Any) -> Any:
        """Select between nested tuples of equal structure, entry by entry."""
        return mapped(functools.partial(self.where, condition), yes, no)

    def zeros(self, *numbers: Any) -> Array:
        """Return zeros of the shape that numbers have together, through which no derivative goes."""
        return self.xp.zeros_like(sum(numbers))

    def together(self, trees: Sequence[Any], zero: Array) -> Any:
        """Return nested tuples of equal structure as one, along a first axis.

        So a formula runs once for all branches: compilers take long for many lines, not for large arrays.
        """
        return mapped(lambda *parts: self.xp.stack([x + zero for x in parts]), *trees)

    def repeated(self, step: Callable[[Any], Any], state: Any, times: int) -> Any:
        """Apply a step to nested tuples of arrays several times."""
        if self.is_jax:
            return importlib.import_module("jax.lax").fori_loop(0, times, lambda _, x: step(x), state)
        for _ in range(times):
            state = step(state)
        return state

    def constant(self, tree: Any) -> Any:
        """Return nested tuples through which no derivative goes."""
        if not self.has_derivatives:
            return tree
        stop = importlib.import_module("jax.lax").stop_gradient if self.is_jax else operator.methodcaller("detach")
        return mapped(lambda x: stop(x) if hasattr(x, "dtype") else x, tree)

    def checked(self, numbers: Any, most: Any, instead: Any) -> tuple[Any, Any]:
        """Return nested tuples of arrays, `instead` where one is NaN or larger than `most`, and where none is."""
        sizes: list[Any] = []
        mapped(lambda x: sizes.append(self.xp.abs(x) <= most), numbers)
        valid = functools.reduce(operator.and_, sizes)
        return mapped(lambda x, y: self.where(valid, x, y), numbers, instead), valid

    def stacked(self, entries: Sequence[Any], zero: Array) -> Array:
        """Return nested sequences of numbers or arrays as one array whose last axes count them."""
        parts = [self.stacked(x, zero) if isinstance(x, tuple | list) else x + zero for x in entries]
        return self.xp.stack(parts, axis=zero.ndim - parts[0].ndim - 1)


_library = functools.cache(Library)


def library_of(*, legs: int = 6, **arguments: Array | Machine) -> Library:
    """Return the library of arguments, arrays of floats of one library whose shapes fit their names.

    A machine has so many `legs`, and is no array.
    """
    machine: Any = arguments.get("machine")
    is_pair = isinstance(machine, tuple) and len(machine) > 0
    if legs == 6 and isinstance(machine[0] if is_pair else machine, Stage):
        cause = "A stage is taken without other parameters, by forward_physical" if is_pair else ALONE
        raise ArgumentError("machine", "a Manipulator", "a Stage", cause)
    given = ((name, x[1] if name == "machine" and isinstance(x, tuple) else x) for name, x in arguments.items())
    machines = Manipulator if legs == 6 else Stage
    arrays: dict[str, Array] = {name: x for name, x in given if not isinstance(x, machines)}
    for name, x in arrays.items():
        if not compat.is_array_api_obj(x):
            expected = "an array of a library that follows the Array API standard"
            cause = "Make it one, as by jax.numpy.asarray or numpy.asarray with the dtype float"
            raise ArgumentError(name, expected, type_and_value(x), cause)
    spaces = {name: compat.array_namespace(x) for name, x in arrays.items()}
    kinds = {name: space.__name__.removeprefix("array_api_compat.") for name, space in spaces.items()}
    if len(set(kinds.values())) > 1:
        received = ", ".join(f"{name} is {kind}" for name, kind in kinds.items())
        cause = f"Convert them, as by {max(kinds.values(), key='numpy'.__ne__)}.asarray"
        raise ArgumentError(", ".join(arrays), "arrays of one library", received, cause)
    namespace = next(iter(spaces.values()))
    for name, x in arrays.items():
        if not namespace.isdtype(x.dtype, "real floating") or namespace.finfo(x.dtype).bits not in (32, 64):
            raise ArgumentError(name, "an array of floating-point numbers of 32 or 64 bits", f"dtype {x.dtype}")
    check_shapes({name: tuple(x.shape) for name, x in arrays.items()}, _TRAILING | {"readings": (legs,)})
    return _library(namespace, namespace.result_type(*arrays.values()))


class MachineOnArrays(NamedTuple):
    """Dimensions and stages, one or two; floats, or arrays of any shape of batch."""

    radii: tuple[Any, ...]  # of the plates: E and C
    r: Any  # of the nominal middle platform
    stages: tuple[StageNumbers, ...]
    weights: Any  # see `leg_planes.upper_balls`; None for one stage
    kinds: tuple[LegKind, ...]  # of each stage
    joint_names: tuple[str, ...]  # of the URDF
    limits: tuple[tuple[float, ...], tuple[float, ...]]
    is_nominal: bool
    valid: Any  # where its numbers are those of a machine, see `Manipulator`

    @property
    def farthest(self) -> Any:
        """The largest length that is solved beside the machine's own [m]."""
        return LARGEST_RATIO * (sum(self.radii) + 3.0**0.5 * self.r)

    def upper_balls(self, library: Library, b: Any) -> Any:
        """Return the upper legs' balls from the lower ones'."""
        return b if self.is_nominal else library.run(leg_planes.upper_balls, b, self.weights)

    def of_stages(self, library: Library, formula: Callable[..., Any], *arguments: Sequence[Any]) -> list[Any]:
        """Return the values of a formula of `spm_pin.formulas.stage_numbers` for each stage and its own arguments."""
        stages = zip(self.stages, self.kinds, *arguments, strict=True)
        return [library.run(formula, *own, stage, library.formulas(kind)) for stage, kind, *own in stages]

    def checked_readings(self, library: Library, readings: Array) -> tuple[list[Any], list[Any], Any]:
        """Return readings of each stage, and those without offsets, and where none was replaced.

        Others are in place of numbers that no leg can have.
        """
        shown, own, valid = [], [], True
        for k, (stage, kind) in enumerate(zip(self.stages, self.kinds, strict=True)):
            most = MOST_TURNED if kind.unit == "rad" else self.farthest
            checked = [library.checked(readings[..., 3 * k + i], most, self.r) for i in range(3)]
            shown.append(tuple(x for x, _ in checked))
            own.append(tuple(x - offset for x, offset in zip(shown[k], stage.offsets, strict=True)))
            valid = functools.reduce(operator.and_, (is_valid for _, is_valid in checked), valid)
        return shown, own, valid


def read_machine(library: Library, machine: Any) -> MachineOnArrays:
    """Return a machine from a `Manipulator` or a `Stage`, dimensions (..., 3) E, C, d, or the parameters of its legs.

    Parameters are an array (..., 54) for RPS legs, or a pair of a machine and its parameters (..., n).
    """
    if isinstance(machine, Manipulator | Stage):
        return _machine_of(machine)
    if isinstance(machine, tuple):
        return _machine_of_parameters(library, *machine)
    size = machine.shape[-1] if machine.ndim else 0
    if size == 3:
        dimensions = mapped(lambda x: library.where(x >= SMALLEST, x, math.nan), vector_of(machine))
        (base, platform, side), valid = library.checked(dimensions, LARGEST, (1.0, 1.0, 1.0))
        r = side / 3.0**0.5
        corners = library.run(leg_constants.drawn_triangle, r)
        pivots = [x for radius in (base, platform) for x in library.run(leg_constants.drawn_triangle, radius)]
        legs = (*AXES, *AXES), tuple(pivots), (*corners, *corners), (0.0,) * 6
        return _completed(library, (base, platform), r, legs, _RPS, None, True, valid)
    if size != 54:
        expected = "a Manipulator, dimensions (..., 3) E, C, d, or the parameters (..., 54) of RPS legs"
        cause = "Of other legs, or with leg limits, pass a pair of a Manipulator and of its parameters"
        raise ArgumentError("machine", expected, f"shape {tuple(machine.shape)}", cause)
    return _machine_of_parameters(library, _RPS, machine)


def _machine_of_parameters(library: Library, machine: Manipulator, parameters: Array) -> MachineOnArrays:
    """Return a machine with the kinds, working modes and leg limits of a machine and these parameters (..., n)."""
    count, drawing = len(machine.parameters), machine.nominal
    if parameters.ndim == 0 or parameters.shape[-1] != count:
        expected = f"the parameters (..., {count}) of its legs beside a machine"
        raise ArgumentError("machine", expected, f"shape {tuple(parameters.shape)}")
    numbers = tuple(tuple(parameters[..., 9 * i + k] for k in range(9)) for i in range(6))
    drawn = tuple(map(tuple, drawing.parameters[:54].reshape(6, 9).tolist()))
    rows, valid = library.checked(numbers, LARGEST, drawn)
    fixed, place = [], 54
    for kind in machine.legs.kinds:
        for row in kind.numbers.tolist():
            own = list(row)
            for k, name in enumerate(kind.identified):
                low, high = BOUNDS[name]
                x = parameters[..., place]
                is_valid = (x >= low) & (x <= high)
                own[k], place, valid = library.where(is_valid, x, row[k]), place + 1, valid & is_valid
            fixed.append(tuple(own))
    axes = [library.run(leg_constants.turned_axis, AXES[i % 3], *rows[i][:2]) for i in range(6)]
    points, balls = tuple(row[2:5] for row in rows), tuple(row[5:8] for row in rows)
    radii: Any = machine.base_radius, machine.platform_radius
    r: Any = machine.middle_radius
    if machine is _RPS:
        # The drawing beside parameters alone has the means of their radii.
        halves = points[:3], points[3:], balls[:3], balls[3:]
        *radii, first, second = (library.run(leg_constants.mean_radius, x) for x in halves)
        r = 0.5 * (first + second)
    legs = tuple(axes), points, balls, tuple(row[8] for row in rows)
    return _completed(library, tuple(radii), r, legs, machine, tuple(fixed), False, valid)


def _completed(
    library: Library,
    radii: Any,
    r: Any,
    legs: Any,
    drawing: Manipulator | Stage,
    numbers: Any,
    is_nominal: bool,
    valid: Any,
) -> MachineOnArrays:
    """Return the machine of axes, pivots, balls and offsets of its legs, with the kinds and limits of a drawing's.

    `numbers` None are the drawing's.
    """
    kinds, limits = drawing.legs.kinds, drawing.limits or drawing.legs.free_limits
    if numbers is None:
        numbers = [tuple(row) for kind in kinds for row in kind.numbers.tolist()]
    stages, ends = [], (limits.minimum, limits.maximum)
    for k, kind in enumerate(kinds):
        *vectors, offsets, low, high, own = (tuple(x[3 * k : 3 * k + 3]) for x in (*legs, *ends, numbers))
        side = 1.0 - 2.0 * k
        stages.append(library.run(stage_numbers, tuple(vectors), offsets, (low, high), own, side, kind.up))
    weights = library.run(leg_planes.upper_ball_weights, *(x.balls for x in stages)) if len(stages) == 2 else None
    return MachineOnArrays(radii, r, tuple(stages), weights, kinds, joint_names(drawing), ends, is_nominal, valid)


@functools.lru_cache(maxsize=32)
def _machine_of(machine: Manipulator | Stage) -> MachineOnArrays:
    *vectors, offsets = (x.tolist() for x in machine.legs.arrays)
    legs = *(tuple(map(tuple, x)) for x in vectors), tuple(offsets)
    (*radii,), ((_, r), *_) = (radius for radius, _ in machine.stage_radii), machine.stage_radii
    return _completed(library_of(numbers=np.zeros(1)), tuple(radii), r, legs, machine, None, machine.is_nominal, True)


def state_arrays(state: Any, name: str, legs: int = 6) -> dict[str, Any]:
    """Return the arrays of a state of a machine with so many legs by their names in messages; none of None."""
    if state is None:
        return {}
    fields = "rotation", "translation", "middle_joints"
    if not all(hasattr(state, field) for field in (*fields, "exists")):
        raise ArgumentError(name, "a State or a state of the machine", type_and_value(state))
    own = len(state.machine.legs.names) if isinstance(state, Configuration) else state.readings.shape[-1]
    if own != legs:
        raise ArgumentError(name, f"a state of a machine with {legs} legs", f"one with {own}")
    return {f"{name}.{field}": getattr(state, field) for field in fields}
