"""The formulas of docs/theory/uniqueness.md by another way: `python docs/site/uniqueness_check.py`, a few seconds.

It shares no code and no library with `uniqueness_proof.py`, and begins from the distances between the corners of a
rotated platform and the hips. Both sides of each formula are computed at random points, in the integers modulo a prime
of 27 digits and with power series for derivatives: two different rational functions of a degree below 1000 agree at
such a point with a probability below 10⁻²³. The inequality between polynomials is tried at random numbers.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator, Sequence
from fractions import Fraction

PRIME = 2**89 - 21
"""A multiple of 12 less one: 3 is a square, and square roots are powers."""
POINTS, TRIALS = 5, 20_000

Result = tuple[str, bool]


class Series:
    """A power series up to the square of its variable, modulo the prime."""

    def __init__(self, value: int, slope: int = 0, square: int = 0) -> None:
        self.terms = value % PRIME, slope % PRIME, square % PRIME

    def __add__(self, other: Series | int) -> Series:
        return Series(*(a + b for a, b in zip(self.terms, _series(other).terms, strict=True)))

    def __mul__(self, other: Series | int) -> Series:
        (a, b, c), (d, e, f) = self.terms, _series(other).terms
        return Series(a * d, a * e + b * d, a * f + b * e + c * d)

    def __sub__(self, other: Series | int) -> Series:
        return self + -1 * _series(other)

    __radd__, __rmul__ = __add__, __mul__

    def root(self, value: int) -> Series:
        """Return the square root whose value this is."""
        slope = over(2 * value, self.terms[1])
        return Series(value, slope, over(2 * value, self.terms[2] - slope * slope))


def _series(number: Series | int) -> Series:
    return number if isinstance(number, Series) else Series(number)


def over(denominator: int, numerator: int = 1) -> int:
    """Return a quotient modulo the prime."""
    return numerator * pow(denominator, -1, PRIME) % PRIME


def square_root(number: int) -> int | None:
    """Return a square root modulo the prime, None if the number is not a square."""
    root = pow(number, (PRIME + 1) // 4, PRIME)
    return root if equal(root * root, number) else None


def equal(first: int, second: int) -> bool:
    """Return whether two numbers are the same modulo the prime."""
    return (first - second) % PRIME == 0


ROOT_3 = square_root(3) or 0
AZIMUTHS = ((over(2, ROOT_3), over(-2)), (0, 1), (over(-2, ROOT_3), over(-2)))
"""Cosine and sine of -30°, 90° and 210°."""

Vector = list[Series]


def dot(a: Sequence[Series], b: Sequence[Series]) -> Series:
    """Return the scalar product of two vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def difference(a: Sequence[Series | int], b: Sequence[Series | int]) -> Vector:
    """Return the difference of two vectors."""
    return [_series(x) - y for x, y in zip(a, b, strict=True)]


def cross(a: Sequence[int], b: Sequence[int]) -> list[int]:
    """Return the vector product of two vectors."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


class Place:
    """A random tilt of the platform, p and ψ, whose x0 and √p are numbers of the field; units of r."""

    def __init__(self, rng: random.Random) -> None:
        (self.sin_half, self.x0), (self.sin, self.cos) = _on_the_circle(rng), _on_the_circle(rng)
        self.p = self.sin_half**2 % PRIME
        self.sin_3 = self.sin * (4 * self.cos**2 - 1) % PRIME
        self.cos_3 = self.cos * (4 * self.cos**2 - 3) % PRIME

    def corners(self, height: int, step: Sequence[int] = (0, 0, 0)) -> list[Vector]:
        """Return the corners with the centre at a height, along a line of x1, x2 and ζ."""
        x1, x2 = Series(self.sin_half * self.cos, step[0]), Series(self.sin_half * self.sin, step[1])
        x0 = (Series(1) - (x1 * x1 + x2 * x2)).root(self.x0)
        found = []
        for u, v in AZIMUTHS:
            # 2 (x·p) x + (2 x0² - 1) p + 2 x0 x × p, and the shift that keeps the corners in the planes of the legs.
            along, across = 2 * (u * x1 + v * x2), 2 * x0 * x0 - 1
            first = along * x1 + u * across - 2 * x1 * x2
            second = along * x2 + v * across + (x2 * x2 - x1 * x1)
            found.append([first, second, 2 * x0 * (v * x1 - u * x2) + Series(height, step[2])])
        return found

    def squares(self, height: int, epsilon: int, step: Sequence[int] = (0, 0, 0)) -> list[Series]:
        """Return the squared lengths of the legs from hips at a radius."""
        legs = [
            difference(corner, (epsilon * u, epsilon * v, 0))
            for corner, (u, v) in zip(self.corners(height, step), AZIMUTHS, strict=True)
        ]
        return [dot(leg, leg) for leg in legs]

    def determinant(self, height: int, epsilon: int) -> int:
        """Return D from the factors (b_i - b_j)·w_i, w_i normal to the leg and to the axis of its hip."""
        corners = self.corners(height)
        m = {}
        for i, (u, v) in enumerate(AZIMUTHS):
            outwards = u * corners[i][0] + v * corners[i][1] - epsilon
            normal = [-u * corners[i][2], -v * corners[i][2], outwards]
            for j in range(3):
                m[i, j] = dot(difference(corners[j], corners[i]), normal).terms[0]
        return (m[0, 1] * m[1, 2] * m[2, 0] + m[1, 0] * m[2, 1] * m[0, 2]) % PRIME

    def off_plane(self, height: int) -> list[int]:
        """Return the distances of the corners from the planes of their legs."""
        return [(v * x - u * y).terms[0] for (x, y, _), (u, v) in zip(self.corners(height), AZIMUTHS, strict=True)]


def _on_the_circle(rng: random.Random) -> tuple[int, int]:
    t = rng.randrange(PRIME)
    return over(1 + t * t, 2 * t), over(1 + t * t, 1 - t * t)


def of_a_state(rng: random.Random) -> Iterator[Result]:
    """Yield whether the formulas for lengths and for D hold at a random state."""
    place, eta, kappa = Place(rng), rng.randrange(PRIME), rng.randrange(PRIME)
    p, rest, big_c, big_s = place.p, 1 - place.p, place.cos_3, place.sin_3
    epsilon, height = over(2, kappa + 1), over(2 * place.x0, eta * place.sin_half)
    yield "the planes of the legs", not any(place.off_plane(height))

    level = over(4 * rest, p * eta**2) + (kappa + 1) * p + p**2
    x, y = p * (eta + (2 * p + kappa) * big_c), p * kappa * big_s
    # λ = (x + i y) e^{-iψ}
    real, imag = x * place.cos + y * place.sin, y * place.cos - x * place.sin
    squares = place.squares(height, epsilon)
    expected = [level + (1 - epsilon) ** 2 + 2 * (real * v + imag * u) for u, v in AZIMUTHS]
    yield "(1), (2), (3)", all(equal(a.terms[0], b) for a, b in zip(squares, expected, strict=True))

    n = over(2 * rest, eta) + over(eta, 2 * rest * (kappa + 1 + 2 * p))
    w = eta + 2 * (p - kappa) * big_c
    h = (eta + (4 * p + kappa) * big_c - n) * w - 2 * kappa * (3 * p + kappa) * big_s**2
    value = place.determinant(height, epsilon)
    yield "(4)", equal(value, over(8, 27 * p * rest * height * h))
    gradients = [[place.squares(height, epsilon, axis)[leg].terms[1] for axis in AXES] for leg in range(3)]
    jacobian = sum(a * b for a, b in zip(gradients[0], cross(gradients[1], gradients[2]), strict=True))
    yield "lengths and D", equal(jacobian * 3 * ROOT_3 * rest, 64 * value)

    eta = 2 * kappa * place.cos - 2 * p * big_c
    height, g = over(2 * place.x0, eta * place.sin_half), 4 * place.cos**2 - 1
    square = (1 + g * p) * (g * p - kappa - 2) ** 2
    flat = over(4 * place.x0, -27 * p * place.sin_half * kappa * place.cos * place.sin**2 * square)
    yield "(8)", equal(place.determinant(height, epsilon), flat)


AXES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def of_a_fold(rng: random.Random) -> Iterator[Result]:
    """Yield whether the second derivative of the mean square along a fibre is that of (11), at a random fold."""
    while True:
        place, eta = Place(rng), rng.randrange(PRIME)
        height = over(2 * place.x0, eta * place.sin_half)
        # D as a function of E/r, of degree two, from three values; its root.
        zero, one, two, three = (place.determinant(height, radius) for radius in range(4))
        square = over(2, zero - 2 * one + two)
        linear = one - zero - square
        root = square_root(linear**2 - 4 * square * zero)
        if root is not None:
            break
    yield "D is quadratic in E", equal(three - 3 * two + 3 * one - zero, 0)
    epsilon = over(2 * square, root - linear)
    yield "a fold", place.determinant(height, epsilon) == 0

    gradients = [[place.squares(height, epsilon, axis)[leg].terms[1] for axis in AXES] for leg in range(3)]
    first, second = ([a - b for a, b in zip(gradients[i], gradients[i + 1], strict=True)] for i in (0, 1))
    tangent = [part % PRIME for part in cross(first, second)]
    mean = [over(3, sum(parts)) for parts in zip(*gradients, strict=True)]
    # The gradient of the mean is a combination of the two others here, which are constant on the fibre.
    area = first[0] * second[1] - first[1] * second[0]
    one = over(area, mean[0] * second[1] - mean[1] * second[0])
    two = over(area, first[0] * mean[1] - first[1] * mean[0])
    bends = [2 * value.terms[2] for value in place.squares(height, epsilon, tangent)]
    bend = over(3, sum(bends)) - one * (bends[0] - bends[1]) - two * (bends[1] - bends[2])

    p, rest, kappa = place.p, 1 - place.p, 2 * epsilon - 1
    e = 4 * place.cos**2 - 3
    f, k = over(2 * place.cos, 2 * kappa * place.cos - eta - 2 * p * place.cos_3), -kappa
    a, q = e + 3, f + k * (1 - e)
    slope = over(p, 2 * place.sin_half * (place.cos * tangent[0] + place.sin * tangent[1]))
    expected = over(2 * rest * a * q**3, p * f * first_polynomial(e, f, k) * second_polynomial(p, e, f, k))
    yield "(11), the second derivative", equal(bend, expected * slope**2)
    terms = cubic(p, e, f, k)
    yield "(11), the cubic", equal(sum(term * rest ** (3 - i) for i, term in enumerate(terms)), 0)


def first_polynomial(e: int, f: int, k: int) -> int:
    """Return A."""
    return (e + 3) * (f * f + 3 * f * k + 3 * k * k) - 3 * k * k


def second_polynomial(p: int, e: int, f: int, k: int) -> int:
    """Return B."""
    x = (e + 2) * p
    return (e + 3) * (f * f + 2 * (1 - e) * f * k) + (1 - e) * (k - x) * ((2 * e + 7) * k + 3 * x)


def cubic(p: int, e: int, f: int, k: int) -> list[int]:
    """Return the coefficients of q h(x), the highest first."""
    v, q = f + k + p * e, f + k * (1 - e)
    fold = (3 * p - k) * k * (1 - e) * (e + 2) ** 2 * v
    return [4 * q, 4 * (3 * p - k) * q, -((e + 3) * v * (v - (4 * p - k) * e) * q + fold), (e + 3) * v * v * p * q]


def quartic(e: int, f: int, k: int) -> list[int]:
    """Return the coefficients of Γ in P, the highest first."""
    y = (e + 3) * f * (f + 2 * k) - (1 - e) * k * k
    z = (e + 3) ** 2 * e * f**3 + 3 * (e + 3) * (e * e + 3 * e - 2) * f * f * k
    z -= (1 - e) * k * k * (3 * (e + 3) * (e + 4) * f + (1 - e) * (e + 2) * k)
    b = 1 - e
    return [27 * b**2 * (e + 2) ** 4, 0, 18 * b * (e + 2) ** 2 * y, 8 * z, -y * y]


def cubic_discriminant(a: int, b: int, c: int, d: int) -> int:
    """Return the discriminant of a cubic with these coefficients."""
    return b * b * c * c - 4 * a * c**3 - 4 * b**3 * d - 27 * a * a * d * d + 18 * a * b * c * d


def quartic_discriminant(a: int, b: int, c: int, d: int, e: int) -> int:
    """Return the discriminant of a quartic by its two invariants."""
    i, j = 12 * a * e - 3 * b * d + c * c, 72 * a * c * e + 9 * b * c * d - 27 * a * d * d - 27 * e * b * b - 2 * c**3
    return over(27, 4 * i**3 - j * j)


def of_the_polynomials(rng: random.Random) -> Iterator[Result]:
    """Yield whether (12) to (15) hold at a random point."""
    p, e, f, k = (rng.randrange(PRIME) for _ in range(4))
    a, b, g, v, q = e + 3, 1 - e, e + 2, f + k + p * e, f + k * (1 - e)
    product = first_polynomial(e, f, k)
    terms = quartic(e, f, k)
    value = sum(term * p ** (4 - i) for i, term in enumerate(terms))
    yield "(12)", equal(cubic_discriminant(*cubic(p, e, f, k)), -16 * f * q * v**2 * product * value)
    weight = -1289945088 * b**4 * g**8 * a**4
    yield "(13)", equal(quartic_discriminant(*terms), weight * f**2 * q**6 * product**2)
    g0 = 4 * a * (2 * a * f**3 + 3 * a * (2 - e) * f**2 * k + 3 * b * (e * e + 6 * e + 10) * f * k * k)
    g0 += 12 * a * a * b * g * k**3
    g1 = 12 * a * b * g**2 * k * (3 * f + 3 * k + e * k)
    yield "(15)", equal(second_polynomial(over(g1, g0), e, f, k) * g1**2, -192 * a**3 * b * g**2 * f * q**3 * product)
    # (14) at both roots of B.
    at_zero, at_one, at_minus_one = (second_polynomial(value, e, f, k) for value in (0, 1, -1))
    square, linear = over(2, at_one + at_minus_one) - at_zero, over(2, at_one - at_minus_one)
    root = square_root(linear**2 - 4 * square * at_zero)
    if root is not None:
        for sign in (1, -1):
            p = over(2 * square, sign * root - linear)
            value = sum(term * p ** (4 - i) for i, term in enumerate(terms))
            yield "(14)", equal(value, (f + k + p * e) * (g0 - g1 * p))


def of_the_inequality(rng: random.Random) -> Iterator[Result]:
    """Yield whether Γ > 0 at a random point with f, k, v > 0, -2 < e < 1 and B <= 0, beside B = 0 half of the times."""
    e = Fraction(rng.randrange(1, 3 << 20), 1 << 20) - 2
    f, k = (Fraction(round(2.0 ** rng.uniform(0, 40))) for _ in range(2))
    if rng.random() < 0.5:
        p = rng.choice((-1, 1)) * Fraction(round(2.0 ** rng.uniform(0, 42)))
    else:
        edge = (e + 3) * (f * f + 2 * (1 - e) * f * k) / (1 - e)
        # B = 0 is 3 X² + (2 e + 4) k X = edge + (2 e + 7) k², X = (e + 2) P.
        half, most = float((e + 2) * k), float(edge + (2 * e + 7) * k * k)
        x = (-half + rng.choice((-1, 1)) * (half * half + 3.0 * most) ** 0.5) / 3.0
        p = Fraction(x * (1.0 + 2.0 ** rng.uniform(-40, 1))) / (e + 2)
    if f + k + p * e > 0 and second_polynomial(p, e, f, k) <= 0:
        yield "Γ > 0 where B <= 0", sum(term * p ** (4 - i) for i, term in enumerate(quartic(e, f, k))) > 0


def results(points: int = POINTS, trials: int = TRIALS, seed: int = 0) -> dict[str, tuple[int, int]]:
    """Return how often each formula was tried, and how often it failed."""
    rng = random.Random(seed)
    found: dict[str, tuple[int, int]] = {}
    for check, times in (
        (of_a_state, points),
        (of_a_fold, points),
        (of_the_polynomials, points),
        (of_the_inequality, trials),
    ):
        for _ in range(times):
            for name, holds in check(rng):
                tried, failed = found.get(name, (0, 0))
                found[name] = tried + 1, failed + (not holds)
    return found


def main() -> int:
    """Print how often each formula was tried and failed; 0 if none failed."""
    found = results()
    for name, (tried, failed) in found.items():
        print(f"{'holds' if not failed else 'FAILS'}  {name}: {tried} points, {failed} failures")
    return 1 if any(failed for _, failed in found.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
