"""Identity of metrics: functions that may differ in what they compute never share the values in a store."""

from __future__ import annotations

import dataclasses
import enum
import functools
import math
import operator
import subprocess
import sys
import types
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import stores
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.sweeps import METRICS, Metric, Points, metric
from spm_pin.sweeps.function_identity import function_identity
from spm_pin.sweeps.metrics import metric_from_definition, unavailable

FACTOR = 2.0
TABLE = {"a": [1.0, 2.0]}


class Scale:
    """A callable object with state."""

    def __init__(self, factor: Any) -> None:
        self.factor = factor

    def __call__(self, points: Points) -> np.ndarray:
        return points.coordinates[:, 0] * self.factor

    def method(self, points: Points) -> np.ndarray:
        return points.coordinates[:, 0] * self.factor


@dataclasses.dataclass(frozen=True)
class Settings:
    factor: float = 1.0
    table: tuple[float, ...] = ()


class Kind(enum.Enum):
    LOWER = 1
    UPPER = 2


class Slots:
    __slots__ = ("a", "b")


def closing_over(value: Any) -> Callable[[Points], Any]:
    return lambda points: points.coordinates[:, 0] * value


def with_keyword(value: Any) -> Callable[[Points], Any]:
    def function(points: Points, *, factor: Any = value) -> Any:
        return points.coordinates[:, 0] * factor

    return function


def with_global(value: Any) -> Callable[[Points], Any]:
    function = eval("lambda points: points.coordinates[:, 0] * helper(FACTOR)", {"FACTOR": value, "helper": helper})
    assert callable(function)
    return function


def with_module(value: Any) -> Callable[[Points], Any]:
    module = types.ModuleType("own_numbers")
    vars(module)["factor"] = value
    function = eval("lambda points: points.coordinates[:, 0] * own.factor", {"own": module})
    assert callable(function)
    return function


def with_submodule(value: Any) -> Callable[[Points], Any]:
    module, inner = types.ModuleType("own_package"), types.ModuleType("own_package.numbers")
    vars(module)["numbers"], vars(inner)["factor"] = inner, value
    function = eval("lambda points: points.coordinates[:, 0] * own.numbers.factor", {"own": module})
    assert callable(function)
    return function


def closing_over_module(value: Any) -> Callable[[Points], Any]:
    module = types.ModuleType("own_numbers")
    vars(module)["factor"] = value
    return closing_over(module)


def with_attribute(value: Any) -> Callable[[Points], Any]:
    def function(points: Points) -> Any:
        return points.coordinates[:, 0] * vars(function)["factor"]

    vars(function)["factor"] = value
    return function


def wrapped(value: Any) -> Callable[[Points], Any]:
    """An object that says of what it is made, as decorators do, and has state beside that."""
    made = Scale(value)
    functools.update_wrapper(made, helper)
    return made


def helper(value: Any) -> Any:
    return value


def with_helper(code: str) -> Callable[[Points], Any]:
    names = {"helper": eval(code)}
    function = eval("lambda points: helper(points.coordinates[:, 0])", names)
    assert callable(function)
    return function


def with_class(code: str) -> Any:
    names: dict[str, Any] = {"__name__": "own"}
    exec(f"class Own:\n    def __call__(self, points):\n        return {code}\n", names)
    return names["Own"]()


VALUES: dict[str, tuple[Any, Any]] = {
    "numbers": (1.0, 2.0),
    "types of numbers": (1, 1.0),
    "signs of zero": (0.0, -0.0),
    "arrays": (np.arange(3.0), np.arange(3.0) + 1e-15),
    "types of arrays": (np.zeros(2), np.zeros(2, dtype=np.float32)),
    "shapes": (np.zeros((2, 3)), np.zeros((3, 2))),
    "arrays of objects": (np.array([1, "a"], dtype=object), np.array([1, "b"], dtype=object)),
    "lists": ([1.0, 2.0], [1.0, 3.0]),
    "order of keys": ({"a": 1.0, "b": 2.0}, {"b": 2.0, "a": 1.0}),
    "nested": ({"a": [{1, 2}, ("b",)]}, {"a": [{1, 3}, ("b",)]}),
    "dataclasses": (Settings(1.0), Settings(2.0)),
    "members of enumerations": (Kind.LOWER, Kind.UPPER),
    "geometries": (stores.GEOMETRY, dataclasses.replace(stores.GEOMETRY, limits=None)),
    "rotations": (Rotation.from_rotvec([0, 0, 0.1]), Rotation.from_rotvec([0, 0, 0.2])),
    "scalars": (np.float64(1.0), np.float64(2.0)),
    "partial functions": (partial(pow, 2), partial(pow, 3)),
    "functions": (np.sin, np.cos),
    "builtins": (math.sin, math.cos),
    "methods of builtins": (int.__add__, float.__add__),
    "slots": (Slots.a, Slots.b),
    "cached functions": (functools.cache(lambda: 1), functools.cache(lambda: 2)),
}
WAYS: dict[str, Callable[[Any], Any]] = {
    "state": Scale,
    "bound method": lambda value: Scale(value).method,
    "closure": closing_over,
    "keyword default": with_keyword,
    "global": with_global,
    "partial": lambda value: partial(operator.mul, value),
    "partial keyword": lambda value: partial(helper, value=value),
    "own module": with_module,
    "module inside a package": with_submodule,
    "module in a closure": closing_over_module,
    "attribute of the function": with_attribute,
    "object that wraps a function": wrapped,
}


@pytest.mark.parametrize("values", VALUES)
@pytest.mark.parametrize("way", WAYS)
def test_functions_that_use_other_values_differ(way: str, values: str) -> None:
    first, second = VALUES[values]
    assert function_identity(WAYS[way](first)) == function_identity(WAYS[way](first))
    assert function_identity(WAYS[way](first)) != function_identity(WAYS[way](second))


@pytest.mark.parametrize("make", [with_helper, with_class], ids=["function", "class"])
def test_functions_that_call_other_code_differ(make: Callable[[str], Any]) -> None:
    first, second = ("lambda x: x + 1", "lambda x: x + 2") if make is with_helper else ("points + 1", "points + 2")
    assert function_identity(make(first)) == function_identity(make(first))
    assert function_identity(make(first)) != function_identity(make(second))


def test_functions_that_call_other_decorated_methods_differ() -> None:
    def identity(decorator: str, value: int) -> str:
        names: dict[str, Any] = {"__name__": "own", "functools": functools}
        methods = [decorator, f"def part(self=0): return {value}", "def __call__(self, points): return self.part"]
        exec("\n    ".join(["class Own:", *methods]), names)
        return function_identity(names["Own"]())

    decorators = ("", "@property", "@staticmethod", "@classmethod", "@functools.cached_property", "@functools.cache")
    identities = [identity(decorator, value) for decorator in decorators for value in (1, 2)]
    assert len(set(identities)) == len(identities)
    assert identities == [identity(decorator, value) for decorator in decorators for value in (1, 2)]


def test_functions_differ_by_their_code() -> None:
    functions: list[Any] = [
        lambda points: points.coordinates[:, 0],
        lambda points: points.coordinates[:, 1],
        lambda points: points.coordinates[:, 0] in {"a", "b"},
        lambda points: [2.0 * x for x in points.coordinates[:, 0]],
        np.sum,
        np.max,
        Scale(1.0),
        Scale(1.0).method,
    ]
    assert len({function_identity(function) for function in functions}) == len(functions)
    # Not by the line it stands on.
    assert function_identity(lambda points: points.coordinates[:, 0]) == function_identity(functions[0])


def test_a_mutable_value_is_read_when_it_is_asked_for() -> None:
    table = [1.0]
    function = closing_over(table)
    before = function_identity(function)
    table.append(2.0)
    assert function_identity(function) != before


def test_values_that_contain_themselves_are_identified() -> None:
    def looped(value: float) -> Callable[[Points], Any]:
        around: list[Any] = [value]
        around.append({"inner": around})
        return closing_over(around)

    assert function_identity(looped(1.0)) == function_identity(looped(1.0))
    assert function_identity(looped(1.0)) != function_identity(looped(2.0))


def test_identities_are_those_of_another_process() -> None:
    code = (
        "import test_metric_identity as t\n"
        "print([t.function_identity(t.WAYS[w](t.VALUES[v][0])) for w in t.WAYS for v in t.VALUES])"
    )
    paths = [str(Path(__file__).parent), str(Path(__file__).parents[1])]
    command = [sys.executable, "-c", f"import sys; sys.path[:0] = {paths}\n{code}"]
    found = {subprocess.run(command, capture_output=True, text=True, check=True).stdout for _ in range(2)}
    assert len(found) == 1


def test_metric_with_unreadable_state_needs_a_version(tmp_path: Path) -> None:
    with (tmp_path / "table").open("w") as file:
        mine = Metric("mine", "1", "", closing_over(file))
        with pytest.raises(spm.ArgumentError, match=r"TextIOWrapper.*version=") as error:
            mine.definition()
        assert error.value.argument == "metric"
        versions = [dataclasses.replace(mine, version=version).definition() for version in (1, 2, "a")]
    assert [definition["function"] for definition in versions] == [1, 2, "a"]


def test_a_ufunc_made_of_a_function_needs_a_version() -> None:
    assert function_identity(closing_over(np.sin)) != function_identity(closing_over(np.cos))
    with pytest.raises(spm.ArgumentError, match=r"a ufunc whose function cannot be read.*version="):
        function_identity(closing_over(np.frompyfunc(lambda x: 2.0 * x, 1, 1)))


def test_a_stored_metric_whose_object_has_another_state_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "map.zarr"

    def with_scale(factor: float) -> Metric:
        return Metric("mine", "m", "x scaled", Scale(factor))

    first = stores.small(path, metrics=[with_scale(1.0)]).mine.values
    before = stores.contents(path)
    with pytest.raises(spm.ArgumentError, match=r"function is .* in the store and .* in this sweep"):
        stores.small(path, metrics=[with_scale(2.0)])
    assert stores.contents(path) == before
    np.testing.assert_array_equal(stores.small(path, metrics=[with_scale(1.0)]).mine, first)


@metric("m", "x of the point, shifted and scaled")
def shifted(points: Points, *, shift: float = 1.0, names: Any = ("a", "b")) -> Any:
    return points.coordinates[:, 0] + shift


def test_a_decorated_function_is_a_metric_with_parameters(tmp_path: Path) -> None:
    assert (shifted.name, shifted.unit, dict(shifted.parameters)) == (
        "shifted",
        "m",
        {"shift": 1.0, "names": ["a", "b"]},
    )
    other = shifted(shift=3.0)
    assert other.definition()["parameters"]["shift"] == 3.0
    assert other.definition()["function"] == shifted.definition()["function"]
    found = stores.small(tmp_path / "map.zarr", metrics=[other])
    np.testing.assert_array_equal(found.shifted, np.broadcast_to(found.x + 3.0, found.shifted.T.shape).T)
    assert found.shifted.attrs["shift"] == 3.0
    with pytest.raises(spm.ArgumentError, match=r"parameters.shift is 3.0 in the store and 1.0 in this sweep"):
        stores.small(tmp_path / "map.zarr", metrics=[shifted])


def test_package_metrics_are_known_by_name() -> None:
    assert METRICS["payload"].definition()["function"] == "spm_pin.sweeps.metrics.payload.function"
    mine = dataclasses.replace(METRICS["payload"], function=helper)
    assert metric_from_definition(METRICS["payload"].definition()) == METRICS["payload"]
    assert metric_from_definition(mine.definition()).function is unavailable
