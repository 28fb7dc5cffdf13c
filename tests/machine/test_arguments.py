from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from error_fields import with_fields

import spm_pin as spm
from spm_pin.support import arguments, files

HUGE = 10**5000
"""An integer that no float holds and that Python does not print."""


class Hostile:
    """An object whose conversions raise unusual errors."""

    def __array__(self, *args: object, **keywords: object) -> np.ndarray:
        raise RuntimeError("no array")

    def __str__(self) -> str:
        raise RuntimeError("no text")


def test_numbers_of_python_and_numpy_are_read() -> None:
    for value in (2, 2.0, np.float32(2), np.int8(2), np.array(2.0)):
        number = arguments.real_number(value, "length", "a positive length", above=0.0)
        assert type(number) is float
        assert number == 2.0
    for value in (3, np.int64(3), np.uint8(3), np.array(3)):
        count = arguments.whole_number(value, "count", least=1)
        assert type(count) is int
        assert count == 3
    assert arguments.as_bool(np.True_, "check") is True
    assert arguments.choice("legs", "space", ("legs", "poses")) == "legs"
    assert files.file_path("a.csv") == Path("a.csv")


REFUSED: dict[str, tuple[Callable[[Any], object], list[Any]]] = {
    "length: expected a positive length, got": (
        lambda value: arguments.real_number(value, "length", "a positive length", above=0.0),
        [True, "2", [2.0], np.ones(1), np.inf, 0.0, HUGE, -HUGE, Hostile(), np.True_],
    ),
    "count: expected a whole number from 1 to 1000000000000, got": (
        lambda value: arguments.whole_number(value, "count", least=1),
        [True, 3.0, "3", 0, -HUGE, [3], np.ones(1, int), Hostile()],
    ),
    "check: expected True or False, got": (lambda value: arguments.as_bool(value, "check"), [0, np.ones(2, bool)]),
    "space: expected one of 'legs', 'poses', got": (
        lambda value: arguments.choice(value, "space", ("legs", "poses")),
        ["pose", None, np.ones(3), ["legs"], HUGE],
    ),
    "path: expected the name of a file, got": (files.file_path, ["", "a\0b", b"name", 3, "\ud800"]),
    "rng: expected a numpy.random.Generator, a seed": (arguments.generator, ["x", -1, HUGE, 2.0, [1, 2], Hostile()]),
    "mask: expected booleans of shape (8,), got": (
        lambda value: arguments.boolean_array(value, "mask", (8,)),
        [np.ones((2, 8)), np.ones((2, 8), bool), [1, 0], [[True], [True, False]], Hostile()],
    ),
    "q: expected real numbers of shape (..., 2), angles": (
        lambda value: arguments.real_array(value, "q", (2,), "angles"),
        ["x", None, HUGE, [[1, 2], [3]], 1j, True, Hostile(), np.ma.masked_array([1.0, 2.0], [True, False]), {}],
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_none_of_its_kind_is_refused(message: str) -> None:
    read, values = REFUSED[message]
    for value in values:
        with pytest.raises(spm.ArgumentError) as caught:
            read(value)
        assert str(caught.value).startswith(message)
        assert caught.value.argument == message.partition(":")[0]


@pytest.mark.parametrize(
    ("bounds", "inside", "outside"),
    [
        ({"least": 0.0, "below": 1.0}, [0.0, 0.5], [-1e-300, 1.0]),
        ({"above": 0.0, "most": 1.0}, [1e-300, 1.0], [0.0, 1.5]),
    ],
)
def test_the_bounds_of_a_number_are_as_named(
    bounds: dict[str, float], inside: list[float], outside: list[float]
) -> None:
    for value in inside:
        assert arguments.real_number(value, "x", "a share", **bounds) == value  # type: ignore[arg-type]
    for value in outside:
        with pytest.raises(spm.ArgumentError, match=r"^x: expected a share, got .*\. Percent\?"):
            arguments.real_number(value, "x", "a share", cause="Percent?", **bounds)  # type: ignore[arg-type]


def test_the_ending_of_a_file_name_is_checked_in_any_case() -> None:
    assert files.file_path(Path("a.CSV"), suffixes=(".csv", ".json")).name == "a.CSV"
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="path")):
        files.file_path("a.txt", suffixes=(".csv", ".json"))


def test_a_generator_is_made_of_a_seed() -> None:
    expected = np.random.default_rng(4).random(3)
    for value in (4, np.int64(4), np.random.SeedSequence(4), np.random.PCG64(4), np.random.default_rng(4)):
        np.testing.assert_array_equal(arguments.generator(value).random(3), expected)
    assert arguments.generator(None).random() != arguments.generator(None).random()


def test_numbers_too_large_for_a_float_are_not_finite() -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="q")):
        arguments.real_array(np.array([1.0, np.longdouble("1e4000")]), "q", (2,), "angles")


def test_a_message_is_short_whatever_came() -> None:
    for received in ("x" * 10**6, HUGE, Hostile()):
        error = spm.ArgumentError("path", "a file", received, "Because")
        assert str(error).startswith("path: expected a file, got ")
        assert str(error).endswith(". Because")
        assert len(str(error)) < 600


@pytest.mark.parametrize(
    "error",
    [
        spm.ArgumentError("path", "a file", "x" * 10**6, "a cause"),
        spm.GeometryError("leg_limits", "a pair", 3, "a cause", "machine.yaml", 4, "'r_b1'"),
        spm.calibration.MeasurementError("poses", "others", "these", file="measured.csv", rows=(3,)),
        spm.ClosureError(0.1, 3, "a cause"),
        spm.NotOneSolutionError(("TT+", "TT-"), (1,), "a cause"),
        spm.SingularConfigurationError("inverse", 1e-17, (2,)),
        spm.errors.MissingExtraError("plots", "matplotlib"),
        spm.sweeps.StoreError("a", "b"),
        spm.sweeps.StoreLockedError("a", "b"),
        spm.sweeps.SweepError("a", "b", 1, 2),
    ],
    ids=lambda error: type(error).__name__,
)
def test_errors_travel_between_processes_with_all_they_know(error: spm.SpmError) -> None:
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


def test_the_place_of_an_error_is_in_its_fields() -> None:
    error = spm.ArgumentError("via[3]", "a state", "none")
    assert (error.argument, error.index, str(error)) == ("via", "3", "via[3]: expected a state, got none")
    moved = error.replaced(argument="--via", file="motion.csv", line=7)
    assert str(moved) == "--via[3] in motion.csv:7: expected a state, got none"
    whole = spm.PoseError("", "a table", "none", "Empty?", file="motion.csv")
    assert str(whole) == "motion.csv: expected a table, got none. Empty?"
    assert type(whole.replaced(cause="")) is spm.PoseError


def test_the_number_of_a_leg_singularity_is_named_after_what_it_is() -> None:
    assert "slope κ of the leg 1.0e-17" in str(spm.SingularConfigurationError("leg", 1e-17))
    assert "smallest singular value 1.0e-17" in str(spm.SingularConfigurationError("forward", 1e-17))
