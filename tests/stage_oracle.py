"""Number of real assembly modes of a 3RPS stage, proved in exact arithmetic (python-flint) by another method.

Neither the package's quaternions nor its harmonics: the unknowns are t_k = tan(θ_k / 2) of the legs' angles in their
vertical planes, the equations the three sides of the triangle. The azimuths being a third of a turn apart, their
coefficients are rational in E, d² and the leg lengths, so floats are taken as exact. t_2 and t_3 are eliminated by
resultants; the roots of the polynomial of degree 16 in t_1 are isolated as disjoint balls, real ones known as real.

A solution is real where its t_1 is, unless two share t_1. So they do, in pairs, where r_1 = r_3 and t_1 = t_3: there
t_2 is a root of a quadratic, whose discriminant at t_1 then counts.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

from flint import Ordering, arb, ctx, fmpz_mpoly, fmpz_mpoly_ctx, fmpz_poly

_CONTEXT = fmpz_mpoly_ctx.get(("t1", "t2", "t3"), Ordering.lex)


def certified_modes(lengths: Sequence[float], pivot_radius: float, d: float) -> int | None:
    """Count the distinct real assembly modes of a stage; None where a mode is double, or t_1 is shared otherwise."""
    sides = equations(lengths, pivot_radius, d)
    real = 0
    for factor, multiplicity in eliminant(sides).factor_squarefree()[1]:
        if multiplicity > 1 and not (multiplicity == 2 and lengths[0] == lengths[2]):
            return None
        ctx.prec = 256
        roots = [root.real for root, _ in factor.complex_roots() if root.imag == 0]
        if multiplicity == 1:
            real += len(roots)
            continue
        for root in roots:
            between_1_and_3 = _at(sides[2], root, t3=root)
            discriminant = _at(_discriminant(sides[0]), root)
            if not between_1_and_3.contains(0) or discriminant.contains(0):
                return None
            real += 2 * bool(discriminant > 0)
    return real


def equations(lengths: Sequence[float], pivot_radius: float, d: float) -> list[fmpz_mpoly]:
    """Return the sides 12, 23 and 13 as polynomials of degree two in each of their t, over the integers."""
    exact = [Fraction(float(x)) for x in (*lengths, pivot_radius, d)]
    unit = max(x.denominator for x in exact)  # powers of two
    *legs, pivot, side = (int(x * unit) for x in exact)
    t = _CONTEXT.gens()

    def between(i: int, j: int) -> fmpz_mpoly:
        # Radii E + r cos θ, heights r sin θ, each times 1 + t².
        (r1, z1, n1), (r2, z2, n2) = (
            (pivot * (1 + t[k] ** 2) + legs[k] * (1 - t[k] ** 2), 2 * legs[k] * t[k], 1 + t[k] ** 2) for k in (i, j)
        )
        across = (r1 * n2) ** 2 + (r2 * n1) ** 2 + r1 * r2 * n1 * n2
        quotient, rest = divmod(across + (z1 * n2 - z2 * n1) ** 2 - side**2 * (n1 * n2) ** 2, n1 * n2)
        assert rest == 0
        return quotient

    return [between(0, 1), between(1, 2), between(0, 2)]


def eliminant(sides: list[fmpz_mpoly]) -> fmpz_poly:
    """Return the polynomial in t_1, of degree 16."""
    last = sides[0].resultant(sides[1], "t2").resultant(sides[2], "t3")
    polynomial = fmpz_poly(_coefficients(last, 0))
    assert polynomial.degree() <= 16
    return polynomial


def _coefficients(polynomial: fmpz_mpoly, variable: int) -> list[Any]:
    coefficients = [0] * (polynomial.degrees()[variable] + 1)
    for exponents, coefficient in polynomial.terms():
        assert all(power == 0 for k, power in enumerate(exponents) if k != variable)
        coefficients[exponents[variable]] = coefficient
    return coefficients


def _discriminant(side: fmpz_mpoly) -> fmpz_mpoly:
    """Return the discriminant in t_2 of side 12, a polynomial in t_1."""
    zero, plus, minus = (side.subs({"t2": value}) for value in (0, 1, -1))
    linear, square = plus - minus, plus + minus - 2 * zero  # twice those of the quadratic
    return linear**2 - 8 * square * zero


def _at(polynomial: fmpz_mpoly, t1: arb, t3: arb | int = 0) -> arb:
    total = arb(0)
    for exponents, coefficient in polynomial.terms():
        assert exponents[1] == 0
        total += arb(coefficient) * t1 ** exponents[0] * arb(t3) ** exponents[2]
    return total
