"""The identities of docs/theory/uniqueness.md in exact arithmetic: `python docs/site/uniqueness_proof.py`, two seconds.

Each is a polynomial with rational coefficients that must vanish. Nothing is sampled or rounded. What follows from the
identities is argued on the page, whose symbols and numbers these are. Needs python-flint alone.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator

from flint import Ordering, fmpq, fmpq_mpoly, fmpq_mpoly_ctx

Identity = tuple[str, fmpq_mpoly]


def identities() -> Iterator[Identity]:
    """Yield the name of each identity, and the polynomial that vanishes if it holds."""
    yield from _of_the_stage()
    for sign in (1, -1):
        yield from _of_the_folds(sign)
    yield from _of_the_polynomials()


def _of_the_stage() -> Iterator[Identity]:
    """Yield what holds for every state, in n = sin ψ, c = cos ψ, root = √3, η, κ and p."""
    ring = fmpq_mpoly_ctx.get(("n", "c", "root", "eta", "kappa", "p"), Ordering.lex)
    n, c, root, eta, kappa, p = ring.gens()
    big_c, big_s, x, w, n_scaled, h_scaled = _stage(n, c, eta, kappa, p)
    circle, three = n**2 + c**2 - 1, root**2 - 3

    def reduced(polynomial: fmpq_mpoly) -> fmpq_mpoly:
        return divmod(divmod(polynomial, circle)[1], three)[1]

    # The azimuths -30°, 90°, 210° by their cosines and sines; the heights z_k in units of √p / (2 x0).
    azimuths = ((root / 2, fmpq(-1, 2)), (0 * root, fmpq(1)), (-root / 2, fmpq(-1, 2)))
    heights = [eta + 4 * (1 - p) * (sine * c - cosine * n) for cosine, sine in azimuths]
    radii = [1 - p - 2 * p * (2 * n * c * cosine + (c**2 - n**2) * sine) for cosine, sine in azimuths]
    epsilon = (kappa + 1) / 2
    m = {
        (i, j): heights[i] * (epsilon + radii[j] / 2) + heights[j] * (radii[i] - epsilon)
        for i in range(3)
        for j in range(3)
    }
    determinant = m[0, 1] * m[1, 2] * m[2, 0] + m[1, 0] * m[2, 1] * m[0, 2]
    yield "(4) D from the six factors", reduced(4 * determinant - 27 * (1 - p) * h_scaled)

    along = _along_a_fibre(n, c, eta, kappa, p)
    slope = -w * (x + 2 * p * big_c) + 2 * kappa * (3 * p + kappa) * big_s**2
    yield "(5) p X is constant with ψ", reduced(along(x, slope) + w * x + (kappa * big_s) ** 2)
    yield "(5) p S is constant with ψ", reduced(along(big_s, slope) - big_s * (x - w))
    yield "(5) the slope of η", reduced(2 * (1 - p) * eta * slope + n_scaled * w + h_scaled)
    # The level c is this over 4 (1 - p), whose logarithmic derivative is -p / (1 - p).
    level = p * eta**2 + 4 * (1 - p) * ((kappa + 1) * p + p**2)
    yield "(6) the slope of c", reduced((1 - p) * along(level, slope) + w * p * level + p * h_scaled)

    phi = eta + 2 * p * big_c - 2 * kappa * c
    yield "(7) Φ and the direction of λ", reduced(phi * n - x * n + kappa * big_s * c)
    yield "(7) Φ and W", reduced(w - phi - 8 * kappa * c * n**2)
    e = 4 * c**2 - 3
    flat = h_scaled.compose(n, c, root, eta - phi, kappa, p, ctx=ring)
    square = (1 + (e + 2) * p) * ((e + 2) * p - kappa - 2) ** 2
    yield "(8) H where Φ = 0", reduced(flat + 8 * kappa * c * n**2 * square)
    grounded = h_scaled.compose(n, c, root, 0 * eta, kappa, p, ctx=ring)
    yield "(8) H where ζ = 0", reduced(grounded + 8 * (1 - p) ** 2 * (kappa + 1 + 2 * p) * (p - kappa) * big_c)

    # Where S = 0 and U = 0: the slope of U, with that of N, is 4 p C - (N² - 4 p (3p + κ)) / η.
    number, height = n_scaled, 2 * (1 - p) * eta
    n_slope = _slope_of_n(eta, kappa, p)
    bound = number**2 - 4 * p * (3 * p + kappa) * height**2
    yield "(9) N + N'", reduced(eta * (number * height**2 + n_slope) - bound * height)
    squares = ((1 - p) * number - p * eta * height) ** 2 + p * (1 - p) * ((eta - 2 * (1 - p)) * height) ** 2
    yield "(9) a sum of squares", reduced((1 - p) ** 2 * (bound - 4 * p * eta * height**2) - squares)


def _stage(n: fmpq_mpoly, c: fmpq_mpoly, eta: fmpq_mpoly, kappa: fmpq_mpoly, p: fmpq_mpoly) -> tuple[fmpq_mpoly, ...]:
    """Return C, S, X, W, and N and H times 2 (1 - p) η."""
    big_c, big_s = 4 * c**3 - 3 * c, 3 * n - 4 * n**3
    w = eta + 2 * (p - kappa) * big_c
    height = 2 * (1 - p) * eta
    n_scaled = eta**2 + 4 * (1 - p) ** 2 * (kappa + 1 + 2 * p)
    u_scaled = height * (eta + (4 * p + kappa) * big_c) - n_scaled
    h_scaled = u_scaled * w - 2 * height * kappa * (3 * p + kappa) * big_s**2
    return big_c, big_s, eta + (2 * p + kappa) * big_c, w, n_scaled, h_scaled


def _along_a_fibre(
    n: fmpq_mpoly, c: fmpq_mpoly, eta: fmpq_mpoly, kappa: fmpq_mpoly, p: fmpq_mpoly
) -> Callable[[fmpq_mpoly, fmpq_mpoly], fmpq_mpoly]:
    """Return the derivative along a fibre times W, p' = p and ψ' = κ S / W, for a given slope W η'."""
    _, big_s, _, w, _, _ = _stage(n, c, eta, kappa, p)

    def along(polynomial: fmpq_mpoly, slope: fmpq_mpoly) -> fmpq_mpoly:
        by_azimuth = polynomial.derivative("n") * c - polynomial.derivative("c") * n
        return w * p * polynomial.derivative("p") + kappa * big_s * by_azimuth + slope * polynomial.derivative("eta")

    return along


def _slope_of_n(eta: fmpq_mpoly, kappa: fmpq_mpoly, p: fmpq_mpoly) -> fmpq_mpoly:
    """Return N' times (2 (1 - p) η)³, where p' = p and η' = -N."""
    height, number = 2 * (1 - p) * eta, eta**2 + 4 * (1 - p) ** 2 * (kappa + 1 + 2 * p)
    by_p = number.derivative("p") * height - number * height.derivative("p")
    by_eta = number.derivative("eta") * height - number * height.derivative("eta")
    return by_p * p * height - by_eta * number


def _of_the_folds(sign: int) -> Iterator[Identity]:
    """Yield (10) and (11), for κ = -σ k of the sign σ, in c = |cos ψ|, f, k and P."""
    stage = fmpq_mpoly_ctx.get(("n", "c", "eta", "kappa", "p"), Ordering.lex)
    n, c, eta, kappa, p = stage.gens()
    _, _, _, w, n_scaled, h_scaled = _stage(n, c, eta, kappa, p)
    # On H = 0 the slope of η is -N. The derivative of H_scaled, times W and 2 (1 - p) η:
    height = 2 * (1 - p) * eta
    along = _along_a_fibre(n, c, eta, kappa, p)
    slope = along(h_scaled, 0 * p) * height - w * n_scaled * h_scaled.derivative("eta")

    folds = fmpq_mpoly_ctx.get(("n", "c", "f", "k", "P"), Ordering.lex)
    sine, cosine, f, k, big_p = folds.gens()
    e = 4 * cosine**2 - 3
    x, v, q = sign - big_p, f + k + big_p * e, f + k * (1 - e)
    here = (sine, -sign * cosine, 2 * cosine * v, -sign * k, sign * big_p)

    def folded(polynomial: fmpq_mpoly) -> fmpq_mpoly:
        return divmod(polynomial.compose(*here, ctx=folds), sine**2 + cosine**2 - 1)[1]

    yield f"(10) Φ, σ = {sign}", here[2] + 2 * sign * big_p * -sign * cosine * e - 2 * k * cosine - 2 * cosine * f
    yield f"(10) W, σ = {sign}", folded(w) - 2 * cosine * q
    cubic = _cubic(x, big_p, e, f, k)
    yield f"(11) H and the cubic, σ = {sign}", 2 * cosine * cubic + sign * folded(h_scaled)
    # η H' = -f A B / (2 c q²) modulo H, and the slope above is 2 (1 - p) η H' W 2 (1 - p) η there.
    first, second, _ = _auxiliary(big_p, e, f, k)
    difference = folded(slope) * q + 8 * x**2 * cosine * v * f * first * second
    yield f"(11) the slope of H, σ = {sign}", divmod(difference, folded(h_scaled))[1]


def _cubic(x: fmpq_mpoly, p: fmpq_mpoly, e: fmpq_mpoly, f: fmpq_mpoly, k: fmpq_mpoly) -> fmpq_mpoly:
    """Return q h(x)."""
    a, b, g = e + 3, 1 - e, e + 2
    v, q = f + k + p * e, f + k * b
    linear = a * v * (v - (4 * p - k) * e) * q + (3 * p - k) * k * b * g**2 * v
    return (4 * x**3 + 4 * (3 * p - k) * x**2 + a * v**2 * p) * q - x * linear


def _auxiliary(p: fmpq_mpoly, e: fmpq_mpoly, f: fmpq_mpoly, k: fmpq_mpoly) -> tuple[fmpq_mpoly, ...]:
    """Return A, B and the quartic Γ in P."""
    a, b, g = e + 3, 1 - e, e + 2
    first = g * (f**2 + 3 * f * k + 3 * k**2) + f**2 + 3 * f * k
    second = a * f**2 + 2 * a * b * f * k + b * (k - g * p) * ((2 * a + 1) * k + 3 * g * p)
    y = a * f**2 + 2 * a * f * k - b * k**2
    z = a**2 * e * f**3 + 3 * a * (e**2 + 3 * e - 2) * f**2 * k - 3 * a * b * (e + 4) * f * k**2 - b**2 * g * k**3
    return first, second, 27 * b**2 * g**4 * p**4 + 18 * b * g**2 * y * p**2 + 8 * z * p - y**2


def _of_the_polynomials() -> Iterator[Identity]:
    """Yield (12) to (15), between polynomials in x, P, e, f and k."""
    ring = fmpq_mpoly_ctx.get(("x", "P", "e", "f", "k"), Ordering.lex)
    x, p, e, f, k = ring.gens()
    a, b, g = e + 3, 1 - e, e + 2
    v, q = f + k + p * e, f + k * b
    first, second, quartic = _auxiliary(p, e, f, k)
    yield "(12)", _cubic(x, p, e, f, k).discriminant("x") + 16 * f * q * v**2 * first * quartic
    weight = 1289945088 * b**4 * g**8 * a**4
    yield "(13)", quartic.discriminant("P") + weight * f**2 * q**6 * first**2
    g0 = 4 * a * (2 * a * f**3 + 3 * a * (2 - e) * f**2 * k + 3 * b * (e**2 + 6 * e + 10) * f * k**2)
    g0 += 12 * a**2 * b * g * k**3
    g1 = 12 * a * b * g**2 * k * (3 * f + 3 * k + e * k)
    yield "(14)", divmod(quartic - v * (g0 - g1 * p), second)[1]
    yield "(15)", second.resultant(g0 - g1 * p, "P") + 192 * a**3 * b * g**2 * f * q**3 * first


def main() -> int:
    """Print which identities hold; 0 if all do."""
    results = [(name, polynomial == 0) for name, polynomial in identities()]
    for name, holds in results:
        print(f"{'holds' if holds else 'FAILS'}  {name}")
    return 0 if all(holds for _, holds in results) else 1


if __name__ == "__main__":
    sys.exit(main())
