"""Number of real branches of a pose, proved by ball arithmetic (python-flint), by another method than the package's.

Neither the paper's unknowns nor the package's quaternions: each ball joint is a point at arc length l_i on the
line of its two leg planes, the three distances are monic quadratics in the l_i, and l_3 and l_1 are eliminated by
resultants of monic quadratics. The octic's roots come as disjoint balls, so which of them are real is certain.
All eight solutions differ in l_2 then, so a solution is real where its l_2 is.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from flint import acb_poly, arb, arb_poly, ctx, fmpq
from scipy.spatial.transform import RigidTransform

Vector = list[Any]


def certified_count(
    quaternion: npt.NDArray[np.float64], position: npt.NDArray[np.float64], d: float, *, nudge: str = "0"
) -> int | None:
    """Count the real branches of one pose, or return None; see `certified_roots`."""
    roots = certified_roots(quaternion, position, d, nudge=nudge)
    return None if roots is None else len(roots)


def certified_counts(poses: RigidTransform, d: float, *, nudge: str = "0") -> npt.NDArray[np.int64]:
    """Count the real branches of poses (N,); one that cannot be decided tests nothing and is refused."""
    quaternions, positions = np.atleast_2d(poses.rotation.as_quat(), poses.translation)
    counts = [certified_count(q, o, d, nudge=nudge) for q, o in zip(quaternions, positions, strict=True)]
    assert None not in counts
    return np.array(counts, dtype=np.int64)


def certified_roots(
    quaternion: npt.NDArray[np.float64], position: npt.NDArray[np.float64], d: float, *, nudge: str = "0"
) -> list[arb] | None:
    """Return the real l_2 of one pose, its floats taken as exact; None where no precision separates the roots.

    The quaternion (4,), scalar last, need not have unit length: its rotation is made exactly. `nudge` is added to
    its z and w parts, to move roots away from infinity by less than any float could.
    """
    for precision in (128, 256, 512, 1024, 2048):
        ctx.prec = precision
        roots = _real_roots(octic(quaternion, position, d, nudge))
        if roots is not None:
            return roots
    return None


def _real_roots(polynomial: arb_poly) -> list[arb] | None:
    leading = polynomial[8]
    if leading.contains(0):
        return None
    mean = -polynomial[7] / (8 * leading)
    try:
        # Moved to the roots' mean, where the iteration converges; as narrow as the working precision allows, for
        # a pair just off the axis must not touch it.
        roots = acb_poly(polynomial(arb_poly([mean, 1]))).roots(tol=arb(2) ** (-ctx.prec // 2), maxprec=64 * ctx.prec)
    except ValueError:
        return None
    real = []
    for k, root in enumerate(roots):
        if root.imag.contains(0):
            # Isolated, and the mirror image of no other root: equal to its own conjugate.
            if any(root.conjugate().overlaps(other) for j, other in enumerate(roots) if j != k):
                return None
            real.append(root.real + mean)
    return real


def octic(
    quaternion: npt.NDArray[np.float64], position: npt.NDArray[np.float64], d: float, nudge: str = "0"
) -> arb_poly:
    """Return the polynomial of degree eight in l_2 whose roots are the branches."""
    x, y, z, w = (arb(float(c)) for c in quaternion)
    rotation = rotation_rows([x, y, z + arb(nudge), w + arb(nudge)])
    o = [arb(float(c)) for c in position]
    half, half_sqrt3 = arb(1) / 2, arb(3).sqrt() / 2
    axes = [[half, half_sqrt3, arb(0)], [arb(1), arb(0), arb(0)], [-half, half_sqrt3, arb(0)]]
    points, directions = [], []
    for lower in axes:
        upper = [dot(row, lower) for row in rotation]
        along = cross(lower, upper)
        squared = dot(along, along)
        # The point on both planes nearest to O; the upper plane passes through o.
        points.append([dot(upper, o) * c / squared for c in cross(along, lower)])
        directions.append([c / squared.sqrt() for c in along])
    e1, e2, e3 = directions
    side = arb(float(d)) ** 2

    def apart(i: int, j: int) -> tuple[Vector, Any]:
        difference = [a - b for a, b in zip(points[i], points[j], strict=True)]
        return difference, dot(difference, difference) - side

    (q12, k12), (q23, k23), (q13, k13) = apart(0, 1), apart(1, 2), apart(0, 2)
    t = arb_poly([0, 1])
    # x² + a x + b in l_1 from side 12; in l_3 from sides 23 and 13, the latter's a and b polynomials in l_1.
    a1, b1 = -2 * dot(e1, e2) * t + 2 * dot(e1, q12), t * t - 2 * dot(e2, q12) * t + k12
    a3, b3 = -2 * dot(e2, e3) * t - 2 * dot(e3, q23), t * t + 2 * dot(e2, q23) * t + k23
    c3 = [arb_poly([-2 * dot(e3, q13)]), arb_poly([-2 * dot(e1, e3)])]
    d3 = [arb_poly([k13]), arb_poly([2 * dot(e1, q13)]), arb_poly([1])]
    m = [c3[0] - a3, c3[1]]
    n = [d3[0] - b3, d3[1], d3[2]]
    # Resultant of two monic quadratics whose difference is m x + n: m² b - m n a + n².
    quartic = _add(_scale(_times(m, m), b3), _scale(_times(m, n), -a3), _times(n, n))
    while len(quartic) > 2:
        top = quartic.pop()
        quartic[-1] -= top * a1
        quartic[-2] -= top * b1
    r0, r1 = quartic
    return r1 * r1 * b1 - r1 * r0 * a1 + r0 * r0


def discriminants(
    rotation: npt.NDArray[np.float64], position: npt.NDArray[np.float64], d: float, bits: int = 128
) -> list[arb]:
    """Return balls around the discriminants over r² of the families TT, TF, FT, FF, for a pose in a matrix.

    With R = Rz(γ1) Ry(θ) Rz(γ2), s and t the half sum and half difference of γ1 and γ2, and azimuths counted from the
    second leg, a family is A P² + B P Q + C Q² = 0 in sines and cosines of s and t. The pose is that of the quaternion
    which the largest component of the matrix, taken as exact, defines.
    """
    ctx.prec = bits
    numbers = [arb(x) for x in quaternion_of(rotation)]
    length = sum((x * x for x in numbers), arb(0)).sqrt()
    x0, x1, x2, x3 = (x / length for x in numbers)
    c, half_sine = (x0 * x0 + x3 * x3).sqrt(), (x1 * x1 + x2 * x2).sqrt()
    # The azimuth of w from the second leg is a quarter turn less.
    (cos_s, sin_s), (cos_t, sin_t) = (x0 / c, x3 / c), (-x1 / half_sine, -x2 / half_sine)
    cos_3s, sin_3s = 4 * cos_s**3 - 3 * cos_s, 3 * sin_s - 4 * sin_s**3
    cos_3t, sin_3t = 4 * cos_t**3 - 3 * cos_t, 3 * sin_t - 4 * sin_t**3
    r = arb(float(d)) / arb(3).sqrt()
    k1 = r * (c * c * (sin_3s * cos_3t + cos_3s * sin_3t) + sin_s * cos_3t - cos_s * sin_3t)
    k2 = r * (c * c * (sin_3s * cos_3t - cos_3s * sin_3t) + sin_s * cos_3t + cos_s * sin_3t)
    x, y = arb(float(position[0])), arb(float(position[1]))
    h = -(cos_s * cos_t - sin_s * sin_t) * x - (sin_s * cos_t + cos_s * sin_t) * y
    even, odd = 8 * c * r * sin_s * cos_s * cos_3t, 8 * c * r * sin_s * cos_s * sin_3t
    forms = (
        (k1 - h, 2 * h * c * cos_s - even, k2 - h),
        (k1 - h, -2 * h * c * sin_s - odd, -k2 - h),
        (-k1 - h, 2 * h * c * sin_s - odd, k2 - h),
        (-k1 - h, 2 * h * c * cos_s + even, -k2 - h),
    )
    sizes = (4 * r * r * (1 - kappa * kappa) for kappa in (x0, x3, x3, x0))
    return [(pq * pq - 4 * pp * qq) / size for (pp, pq, qq), size in zip(forms, sizes, strict=True)]


def quaternion_of(rotation: npt.NDArray[np.float64]) -> tuple[fmpq, fmpq, fmpq, fmpq]:
    """Return x0, x1, x2, x3, of any length, from the largest component of a rotation matrix, exactly."""
    m = [[fmpq(*float(v).as_integer_ratio()) for v in row] for row in rotation]
    trace = m[0][0] + m[1][1] + m[2][2]
    across = m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]
    entries = [float(rotation[0, 0] + rotation[1, 1] + rotation[2, 2]), *(float(rotation[i, i]) for i in (2, 1, 0))]
    largest = entries.index(max(entries))
    if largest == 0:
        return 1 + trace, *across
    k = 3 - largest
    i, j = (k + 1) % 3, (k + 2) % 3
    found = [across[k], fmpq(0), fmpq(0), fmpq(0)]
    found[1 + k], found[1 + i], found[1 + j] = 1 - trace + 2 * m[k][k], m[k][i] + m[i][k], m[k][j] + m[j][k]
    return found[0], found[1], found[2], found[3]


def rotation_rows(quaternion: Vector) -> list[Vector]:
    x, y, z, w = quaternion
    n = x * x + y * y + z * z + w * w
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ]
    return [[entry / n for entry in row] for row in rows]


def dot(a: Vector, b: Vector) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _times(a: Vector, b: Vector) -> Vector:
    product = [arb_poly([0]) for _ in range(len(a) + len(b) - 1)]
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            product[i + j] += x * y
    return product


def _scale(a: Vector, factor: Any) -> Vector:
    return [x * factor for x in a]


def _add(*terms: Vector) -> Vector:
    length = max(len(term) for term in terms)
    return [sum((term[k] for term in terms if k < len(term)), arb_poly([0])) for k in range(length)]
