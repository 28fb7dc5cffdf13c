from __future__ import annotations

import os
import pickle
from pathlib import Path

import numpy as np
import pytest

import spm_pin as spm
from spm_pin.mechanism import arguments


def kind(value: object) -> str:
    """Name a parameter that has no text of its own."""
    return type(value).__name__


HUGE = 10**5000
"""An integer that no float holds and that Python does not print."""


class Hostile:
    """An object whose conversions raise unusual errors."""

    def __array__(self, *args: object, **keywords: object) -> np.ndarray:
        raise RuntimeError("no array")

    def __str__(self) -> str:
        raise RuntimeError("no text")


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2), np.int8(2), np.array(2.0)], ids=kind)
def test_a_real_number_is_read_from_python_and_numpy(value: object) -> None:
    number = arguments.real_number(value, "length", "a positive length", above=0.0)
    assert type(number) is float
    assert number == 2.0


@pytest.mark.parametrize(
    "value",
    [True, "2", None, 2j, [2.0], np.ones(1), np.nan, np.inf, 0.0, -1, HUGE, -HUGE, Hostile(), np.True_],
    ids=kind,
)
def test_what_is_no_positive_number_is_refused(value: object) -> None:
    with pytest.raises(spm.ArgumentError, match=r"^length: expected a positive length, got") as caught:
        arguments.real_number(value, "length", "a positive length", above=0.0)
    assert caught.value.argument == "length"


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


@pytest.mark.parametrize("value", [3, np.int64(3), np.uint8(3), np.array(3)], ids=kind)
def test_a_whole_number_is_read_from_python_and_numpy(value: object) -> None:
    count = arguments.whole_number(value, "count", least=1)
    assert type(count) is int
    assert count == 3


@pytest.mark.parametrize("value", [True, 3.0, "3", None, 0, -HUGE, [3], np.ones(1, int), Hostile(), np.nan], ids=kind)
def test_what_is_no_count_is_refused(value: object) -> None:
    with pytest.raises(spm.ArgumentError, match=r"^count: expected a whole number from 1 to 1000000000000, got"):
        arguments.whole_number(value, "count", least=1)


@pytest.mark.parametrize("value", [0, 1, "yes", None, np.ones(2, bool)], ids=kind)
def test_a_flag_is_true_or_false_only(value: object) -> None:
    assert arguments.as_bool(np.True_, "check") is True
    with pytest.raises(spm.ArgumentError, match=r"^check: expected True or False, got"):
        arguments.as_bool(value, "check")


@pytest.mark.parametrize("value", ["pose", None, np.ones(3), ["legs"], b"legs", HUGE], ids=kind)
def test_a_word_is_one_of_its_choices(value: object) -> None:
    assert arguments.choice("legs", "space", ("legs", "poses")) == "legs"
    with pytest.raises(spm.ArgumentError, match=r"^space: expected one of 'legs', 'poses', got"):
        arguments.choice(value, "space", ("legs", "poses"))


class BadPath(os.PathLike):  # type: ignore[type-arg]
    def __fspath__(self) -> str:
        raise RuntimeError("no path")


@pytest.mark.parametrize("value", ["", "a\0b", b"name", 3, None, np.ones(2), BadPath(), "\ud800"], ids=kind)
def test_what_is_no_file_name_is_refused(value: object) -> None:
    assert arguments.file_path("a.csv") == Path("a.csv")
    with pytest.raises(spm.ArgumentError, match=r"^path: expected the name of a file, got"):
        arguments.file_path(value)


def test_the_ending_of_a_file_name_is_checked_in_any_case() -> None:
    assert arguments.file_path(Path("a.CSV"), suffixes=(".csv", ".json")).name == "a.CSV"
    with pytest.raises(spm.ArgumentError, match=r"^path: expected a file name ending in \.csv, \.json, got 'a\.txt'"):
        arguments.file_path("a.txt", suffixes=(".csv", ".json"))


def test_a_generator_is_made_of_a_seed() -> None:
    expected = np.random.default_rng(4).random(3)
    for value in (4, np.int64(4), np.random.SeedSequence(4), np.random.PCG64(4), np.random.default_rng(4)):
        np.testing.assert_array_equal(arguments.generator(value).random(3), expected)
    assert arguments.generator(None).random() != arguments.generator(None).random()
    for value in ("x", -1, HUGE, 2.0, True, [1, 2], Hostile()):
        with pytest.raises(spm.ArgumentError, match=r"^rng: expected a numpy.random.Generator, a seed"):
            arguments.generator(value)


def test_a_mask_is_boolean_and_broadcasts_to_the_shape() -> None:
    assert arguments.boolean_array([True, False], "mask", (3, 2)).shape == (3, 2)
    for value in (np.ones((2, 8)), np.ones((2, 8), bool), [1, 0], "x", None, [[True], [True, False]], Hostile()):
        with pytest.raises(spm.ArgumentError, match=r"^mask: expected booleans of shape \(8,\), got"):
            arguments.boolean_array(value, "mask", (8,))


@pytest.mark.parametrize(
    "value",
    ["x", None, HUGE, [[1, 2], [3]], 1j, True, Hostile(), np.ma.masked_array([1.0, 2.0], [True, False]), {}, object()],
    ids=kind,
)
def test_what_is_no_array_of_numbers_is_refused(value: object) -> None:
    with pytest.raises(spm.ArgumentError, match=r"^q: expected real numbers of shape \(\.\.\., 2\), angles"):
        arguments.real_array(value, "q", (2,), "angles")  # type: ignore[arg-type]


def test_numbers_too_large_for_a_float_are_not_finite() -> None:
    with pytest.raises(spm.ArgumentError, match=r"^q: expected finite real numbers .* got inf"):
        arguments.real_array(np.array([1.0, np.longdouble("1e4000")]), "q", (2,), "angles")


def test_a_message_is_short_whatever_came() -> None:
    for received in ("x" * 10**6, HUGE, Hostile()):
        error = spm.ArgumentError("path", "a file", received, "Because")
        assert str(error).startswith("path: expected a file, got ")
        assert str(error).endswith(". Because")
        assert len(str(error)) < 600
    error = spm.ArgumentError("path", "a file", "x" * 10**6)
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
