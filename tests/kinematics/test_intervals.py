"""Interval arithmetic against exact rational numbers."""

from __future__ import annotations

import operator
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spm_pin.kinematics.intervals import Interval

NUMBERS = st.floats(-1e3, 1e3, allow_nan=False).filter(lambda x: x == 0.0 or abs(x) > 1e-30)


@st.composite
def intervals_with_a_member(draw: st.DrawFn) -> tuple[Interval, Fraction]:
    """Return an interval, and an exact number in it."""
    low, high = sorted((draw(NUMBERS), draw(NUMBERS)))
    share = Fraction(draw(st.integers(0, 1 << 20)), 1 << 20)
    return Interval(np.array(low), np.array(high)), Fraction(low) + share * (Fraction(high) - Fraction(low))


def contains(interval: Interval, exact: Fraction) -> bool:
    return Fraction(float(interval.low)) <= exact <= Fraction(float(interval.high))


@st.composite
def expressions(draw: st.DrawFn, depth: int = 4) -> tuple[Interval, Fraction]:
    """Return a random expression, evaluated in intervals and exactly."""
    if depth == 0 or draw(st.booleans()):
        return draw(intervals_with_a_member())
    operation = draw(st.sampled_from((operator.add, operator.sub, operator.mul, "square", "negative")))
    interval, exact = draw(expressions(depth - 1))
    if operation == "square":
        return interval.square(), exact * exact
    if operation == "negative":
        return -interval, -exact
    other, other_exact = draw(expressions(depth - 1))
    return operation(interval, other), operation(exact, other_exact)


@given(expressions())
def test_an_expression_contains_its_exact_value(pair: tuple[Interval, Fraction]) -> None:
    assert contains(*pair)


@given(intervals_with_a_member(), NUMBERS)
def test_numbers_on_either_side(pair: tuple[Interval, Fraction], number: float) -> None:
    interval, exact = pair
    for operation in (operator.add, operator.sub, operator.mul):
        assert contains(operation(interval, number), operation(exact, Fraction(number)))
        assert contains(operation(number, interval), operation(Fraction(number), exact))


@given(intervals_with_a_member())
def test_roots_and_reciprocals(pair: tuple[Interval, Fraction]) -> None:
    interval, exact = pair
    root = interval.root()
    if exact >= 0:
        assert Fraction(float(root.low)) ** 2 <= exact <= Fraction(float(root.high)) ** 2
    reciprocal = interval.reciprocal()
    if interval.low <= 0.0 <= interval.high:
        assert np.isnan(reciprocal.low)
    else:
        assert contains(reciprocal, 1 / exact)


@pytest.mark.parametrize(("low", "high", "missed"), [(1.0, 2.0, True), (0.0, 0.5, False), (-1.0, 0.0, False)])
def test_disjoint_intervals_do_not_agree(low: float, high: float, missed: bool) -> None:
    assert bool(Interval(np.array(low), np.array(high)).misses(Interval(np.array(-1.0), np.array(0.5)))) is missed
