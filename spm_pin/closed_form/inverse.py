"""Inverse displacement in closed form: four quadratics, one per family, no iteration and no branch.

Write the horizontal vector (x, y) as the complex number x + iy and a unit quaternion as the pair
s = x0 + i x3, w = x1 + i x2. With q_R = (S, W) the platform's rotation, a = (p, w_a) and b = (q, w_b) the
middle platform's seen from {B} and from {m}, a = q_R b reads

    W conj(w_b) = S q - p,        conj(W) w_a = conj(q) - S conj(p).

The lower leg planes all contain the Z axis of {B}; this alone forces p to be real (mode T: p = P) or imaginary
(mode F: p = iP) and puts the middle platform's centre at the horizontal position -i r conj(w_a²). The same
holds for q, w_b, Q in {m}. With h the signed distance of the two Z axes along their common normal, closing the
chain along that normal is homogeneous of degree two in (P, Q):

    r Re(i s [W³ e_q (Q - S'P)² + conj(W)³ e_p (S'Q - P)²]) = h N,    N = P² + Q² - 2 κ PQ = |W|²,

s = S/|S| and W scaled to modulus one in the bracket, S' = S (q/Q)/(p/P) = κ + iμ, e = +1 for T and -1 for F.
In the coordinates u ~ P - Q, v ~ P + Q that make N = u² + v² the equation is a symmetric 2 x 2 form, and every
step keeps the relative accuracy of small tilts. Derivation: `docs/theory/inverse_displacement.md`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import BRANCHES
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform
from spm_pin.mechanism.solutions import Degeneracy, SolutionSet, Status

__all__ = ["complex_middle_joints", "inverse_displacement"]

ComplexArray = npt.NDArray[np.complex128]
BoolArray = npt.NDArray[np.bool_]

# Families TT, TF, FT, FF along one axis: e = +1 for mode T, -1 for mode F, of the lower and the upper stage;
# the turn S'/S; and the root, in this order, of the branches + and - (by the sign of det K, see branches.py).
_LOWER = np.array([1.0, 1.0, -1.0, -1.0])
_UPPER = np.array([1.0, -1.0, 1.0, -1.0])
_TURN = np.array([1.0, 1.0j, -1.0j, 1.0])
_ROOT = np.array([[1.0, -1.0], [-1.0, 1.0], [-1.0, 1.0], [1.0, -1.0]])

_EPS = np.finfo(np.float64).eps
_ROUNDING = 64.0 * _EPS
"""Rounding of a pose relative to its size: what is smaller is taken for zero when a family is degenerate."""


def inverse_displacement(geometry: Geometry, pose: PoseLike) -> SolutionSet:
    """Find all configurations of the manipulator that hold the platform in a pose.

    Parameters
    ----------
    geometry : Geometry
        The manipulator. Its leg limits are not applied; see `SolutionSet.within`.
    pose : RigidTransform, array_like (..., 4, 4), or object with `.rotation` and `.translation`
        Pose of {m} in {B}, translation in metres; one, or a batch of shape (...).

    Returns
    -------
    SolutionSet
        The branches TT+, TT-, TF+, TF-, FT+, FT-, FF+, FF- along the last axis, so `.middle_joints` is
        (..., 8, 3, 3) and `.leg_lengths` (..., 8, 6), NaN where a branch is not real. `.discriminants`
        (..., 4), dimensionless, are those of the families' quadratics divided by r² = d²/3: the two branches
        of a family are real where it is not negative, and meet where it is zero, at an inverse singularity.
        `.status` (...) is `Status.OK`; `UNREACHABLE` where no branch is real; or `DEGENERATE` where some
        family is continuous: it is left out, and `.degeneracy` describes it.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.

    Notes
    -----
    Hu, Lu, Yu, Zhuang obtain the same branches from a resultant of degree eight, Eqs. (5)-(20); that route is
    `spm_pin.paper.resultant`. This one has no denominator that a regular pose can make zero.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> geometry = spm.Geometry.paper()
    >>> pose = spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88]))
    >>> spm.inverse_displacement(geometry, pose)
    <SolutionSet: ok, 6 of 8 real: TT+, TT-, TF+, TF-, FF+, FF->
    """
    transform = as_rigid_transform(pose)
    shape = transform.shape
    matrix = transform.as_matrix().reshape(-1, 4, 4)
    rotation, position = matrix[:, :3, :3], matrix[:, :3, 3]
    chain = _Chain.of(geometry, transform.rotation.as_quat().reshape(-1, 4), position)
    degeneracy = _degeneracy(geometry, chain, rotation, position)
    discriminant = chain.discriminant
    real = (discriminant >= 0.0) & ~degeneracy.families & ~chain.vertical[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(np.where(real, discriminant, np.nan))
        joints = _middle_joints(geometry, chain, position, root)
    exists = real.any(axis=-1)
    status = np.where(degeneracy.dimension > 0, Status.DEGENERATE, np.where(exists, Status.OK, Status.UNREACHABLE))
    branches = Configuration.from_arrays(
        geometry,
        np.broadcast_to(rotation[:, None], (*joints.shape[:2], 3, 3)).reshape(*shape, 8, 3, 3),
        np.broadcast_to(position[:, None], (*joints.shape[:2], 3)).reshape(*shape, 8, 3),
        joints.reshape(*shape, 8, 3, 3),
    )
    return SolutionSet(
        branches,
        BRANCHES,
        status.reshape(shape),
        discriminants=(discriminant / geometry.middle_radius**2).reshape(*shape, 4),
        degeneracy=Degeneracy(
            degeneracy.dimension.reshape(shape),
            degeneracy.families.reshape(*shape, 4),
            degeneracy.legs.reshape(*shape, 3),
        ),
    )


def complex_middle_joints(geometry: Geometry, pose: PoseLike) -> ComplexArray:
    """Return all eight roots of the inverse displacement, real or complex.

    Parameters
    ----------
    geometry, pose
        As for `inverse_displacement`.

    Returns
    -------
    ndarray of complex128, shape (..., 8, 3, 3)
        Rows b_1, b_2, b_3 in {B} [m]. A family with a negative discriminant holds two conjugate solutions, as
        in the paper's Tables 1-3. NaN where a family is continuous or has no finite solution.

    Raises
    ------
    PoseError
        If `pose` is not a rigid transform of finite numbers.
    """
    transform = as_rigid_transform(pose)
    matrix = transform.as_matrix().reshape(-1, 4, 4)
    chain = _Chain.of(geometry, transform.rotation.as_quat().reshape(-1, 4), matrix[:, :3, 3])
    lost = _degeneracy(geometry, chain, matrix[:, :3, :3], matrix[:, :3, 3]).families | chain.vertical[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(np.where(lost, np.nan, chain.discriminant).astype(np.complex128))
        joints = _middle_joints(geometry, chain, matrix[:, :3, 3], root)
    return np.asarray(joints.reshape(*transform.shape, 8, 3, 3))


@dataclass(frozen=True)
class _Chain:
    """What the N poses say about the four families, arrays of shape (N,) or, per family, (N, 4)."""

    vertical: BoolArray  # the two Z axes are parallel: no common normal
    cosine: FloatArray  # c, s: half the tilt of the platform
    sine: FloatArray
    normal: ComplexArray  # the common normal n of the two Z axes, seen from {B}
    normal_m: ComplexArray  # Rᵀn, seen from {m}
    distance: FloatArray  # h
    tilt_axis: ComplexArray  # W/|W|, (N, 4)
    f: ComplexArray  # u's and v's share in the quaternions of a and b, (N, 4)
    g: ComplexArray
    scale_u: FloatArray  # (P - Q)/u and (P + Q)/v, divided by 2 sin, (N, 4)
    scale_v: FloatArray
    form_uu: FloatArray  # the quadratic form, h subtracted, (N, 4) [m]
    form_uv: FloatArray
    form_vv: FloatArray

    @property
    def discriminant(self) -> FloatArray:
        """Discriminants of the four forms [m²]."""
        return self.form_uv**2 - self.form_uu * self.form_vv

    @classmethod
    def of(cls, geometry: Geometry, quaternion: FloatArray, position: FloatArray) -> _Chain:
        """Set up the four forms for quaternions (N, 4), scalar last, and positions (N, 3) [m]."""
        x1, x2, x3, x0 = quaternion.T
        torsion, tilt = x0 + 1j * x3, x1 + 1j * x2
        cosine, sine = np.abs(torsion), np.abs(tilt)
        vertical = cosine * sine <= _ROUNDING
        with np.errstate(invalid="ignore", divide="ignore"):
            # The sign of the quaternion is free. Per family the one with κ >= 0 is taken: κ does not change
            # sign on any path along which the family stays real, so labels do not either.
            turned = torsion[:, None] * _TURN
            lift = np.where(turned.real < 0.0, -1.0, 1.0)
            turned = turned * lift
            kappa, mu = turned.real, turned.imag
            axis = (tilt / sine)[:, None] * lift
            twist = (torsion / cosine)[:, None] * lift
            # 1 - κ without cancellation, from |S'|² + |W|² = 1.
            one_minus = ((sine**2)[:, None] + mu**2) / (1.0 + kappa)
            scale_u, scale_v = np.sqrt(0.5 / (1.0 + kappa)), np.sqrt(0.5 / one_minus)
            f, g = (1.0 + turned) * scale_u, (one_minus - 1j * mu) * scale_v
            normal = (torsion / cosine) * (tilt / sine)
            normal_m = np.conj(torsion / cosine) * (tilt / sine)
            distance = normal.real * position[:, 0] + normal.imag * position[:, 1]
            cubed = axis * axis * axis
            even = _UPPER * cubed + _LOWER * np.conj(cubed)
            odd = _LOWER * np.conj(cubed) - _UPPER * cubed
            r = geometry.middle_radius
            side = 1j * r * twist
            return cls(
                vertical=vertical,
                cosine=cosine,
                sine=sine,
                normal=normal,
                normal_m=normal_m,
                distance=distance,
                tilt_axis=axis,
                f=f,
                g=g,
                scale_u=scale_u,
                scale_v=scale_v,
                form_uu=(side * even * f * f).real - distance[:, None],
                form_uv=(side * odd * f * g).real,
                form_vv=(side * even * g * g).real - distance[:, None],
            )


def _middle_joints(geometry: Geometry, chain: _Chain, position: FloatArray, root: npt.NDArray[Any]) -> Any:
    """Return b (N, 8, 3, 3) [m] from the square roots (N, 4) of the discriminants, real or complex.

    `root` may be complex, and then so are u and v; the imaginary unit of the module's docstring is another
    one, so from here on a horizontal vector is a pair of coordinates.
    """
    uu, uv, vv = (form[:, :, None] for form in (chain.form_uu, chain.form_uv, chain.form_vv))
    root = root[:, :, None] * _ROOT
    # Both pairs solve the form; the longer one is free of cancellation.
    first, second = (root - uv, uu), (vv, -uv - root)
    longer = _norm2(*first) >= _norm2(*second)
    u, v = np.where(longer, first[0], second[0]), np.where(longer, first[1], second[1])
    length = np.sqrt(u * u + v * v)
    u, v = u / length, v / length
    per_family = slice(None), slice(None), None
    sine, cosine = chain.sine[:, None, None], chain.cosine[:, None, None]
    p = sine * (v * chain.scale_v[per_family] + u * chain.scale_u[per_family])

    # w_a and conj(w_b): rotate G v -+ F u by the tilt axis and by the mode's own quarter turn.
    f, g = chain.f[per_family], chain.g[per_family]
    lower_axis = (chain.tilt_axis * np.where(_UPPER > 0.0, 1.0, -1.0j))[per_family]
    upper_axis = (np.conj(chain.tilt_axis) * np.where(_LOWER > 0.0, 1.0, 1.0j))[per_family]
    a1, a2 = _turn(lower_axis, g.real * v - f.real * u, g.imag * v - f.imag * u)
    b1, b2 = _turn(upper_axis, g.real * v + f.real * u, g.imag * v + f.imag * u)

    # The centre's horizontal position in {B} and in {m}; only its part along the tilt is needed: with the
    # common normal n, that direction is -i n.
    r = geometry.middle_radius
    lower_x, lower_y = -2.0 * r * a1 * a2, r * (a2 * a2 - a1 * a1)
    upper_x, upper_y = 2.0 * r * b1 * b2, r * (b2 * b2 - b1 * b1)
    normal, normal_m = chain.normal[:, None, None], chain.normal_m[:, None, None]
    x, y, z = (position[:, k, None, None] for k in range(3))
    along = normal.imag * (lower_x - x) - normal.real * (lower_y - y)
    along_m = normal_m.imag * upper_x - normal_m.real * upper_y
    height = z + ((cosine * cosine - sine * sine) * along - along_m) / (2.0 * sine * cosine)

    half_turned = (_LOWER < 0.0)[:, None]
    joints = []
    for cos_phi, sin_phi, _ in geometry.radial_directions:
        radius = r * (_LOWER[:, None] * p * p - 2.0 * ((a1 * a1 - a2 * a2) * sin_phi + 2.0 * a1 * a2 * cos_phi))
        lift = np.where(half_turned, a1 * cos_phi + a2 * sin_phi, a1 * sin_phi - a2 * cos_phi)
        joints.append(np.stack([radius * cos_phi, radius * sin_phi, height + 2.0 * r * p * lift], axis=-1))
    stacked = np.stack(joints, axis=-2)
    return stacked.reshape(stacked.shape[0], 8, 3, 3)


def _norm2(x: npt.NDArray[Any], y: npt.NDArray[Any]) -> FloatArray:
    return np.asarray(np.abs(x) ** 2 + np.abs(y) ** 2, dtype=np.float64)


def _turn(axis: ComplexArray, x: npt.NDArray[Any], y: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Multiply the pair (x, y), possibly complex in its own right, by the plane rotation `axis`."""
    return axis.real * x - axis.imag * y, axis.real * y + axis.imag * x


def _degeneracy(geometry: Geometry, chain: _Chain, rotation: FloatArray, position: FloatArray) -> Degeneracy:
    """Find the families that rounding cannot tell from continuous ones; arrays over the N poses.

    Where the two Z axes meet or cross, a family is continuous iff its form vanishes: (P : Q) is then free and
    the family has one dimension. Where they are parallel, see `_parallel_axes`.
    """
    r = geometry.middle_radius
    aside = np.hypot(position[:, 0], position[:, 1])
    with np.errstate(invalid="ignore", divide="ignore"):
        noise = _ROUNDING * (r + aside / (chain.cosine * chain.sine))[:, None]
        forms = np.abs(np.stack([chain.form_uu, chain.form_uv, chain.form_vv]))
        families = (forms.max(axis=0, initial=0.0) <= noise) & ~chain.vertical[:, None]
    dimension = families.any(axis=-1).astype(np.int8)
    axes = geometry.revolute_axes
    platform_axes = axes @ np.swapaxes(rotation, -1, -2)
    parallel = np.linalg.norm(np.cross(axes, platform_axes), axis=-1) <= _ROUNDING
    offset = np.abs(position @ axes.T)
    legs = parallel & (offset <= _ROUNDING * (r + aside)[:, None])
    if chain.vertical.any():
        at = chain.vertical
        families[at], dimension[at] = _parallel_axes(geometry, rotation[at], position[at])
    return Degeneracy(dimension, families, legs & (dimension > 0)[:, None])


def _parallel_axes(
    geometry: Geometry, rotation: FloatArray, position: FloatArray
) -> tuple[BoolArray, npt.NDArray[np.int8]]:
    """Return families (n, 4) and dimension (n,) where the Z axes of {B} and {m} are parallel.

    All legs' planes are vertical, so a solution can move along Z: there are none, or a continuous family.

    - Platform level, turned by 0 or a half turn: planes in pairs parallel. On the axis they coincide and the
      middle platform moves with three degrees of freedom, in equal or in opposite modes; off it, nothing.
    - Platform level, turned by another angle τ: lines vertical. The middle platform stands upside down in both
      stages, which takes |o| = 2 r |sin τ| in the horizontal.
    - Platform upside down, turned over about the horizontal axis W: y = i o / r must be on the segment from
      e_p W⁴ to e_q conj(W²); where that shrinks to a point, (P : Q) is free as well.
    """
    r = geometry.middle_radius
    aside = position[:, 0] + 1j * position[:, 1]
    tolerance = _ROUNDING * (1.0 + np.abs(aside) / r)
    level = rotation[:, 2, 2] > 0.0
    cos_turn, sin_turn = rotation[:, 0, 0], rotation[:, 1, 0]
    straight = level & (np.abs(sin_turn) <= tolerance)
    centred = np.abs(aside) <= tolerance * r
    equal_modes, mixed_modes = _LOWER == _UPPER, _LOWER != _UPPER
    modes = np.where((cos_turn > 0.0)[:, None], equal_modes, mixed_modes)
    free = (straight & centred)[:, None] & modes
    upside_down = level & ~straight & (np.abs(np.abs(aside) / r - 2.0 * np.abs(sin_turn)) <= tolerance)

    # R is diag(W², -1) on complex conjugates: R maps 1 to W², and W is defined up to a sign that does not matter.
    axis = np.sqrt(cos_turn + 1j * sin_turn)
    cubed = axis**3
    y = 1j * aside / r * np.conj(axis)
    tolerance = tolerance[:, None]
    fixed = np.where(equal_modes, _LOWER * cubed.real[:, None], _LOWER * cubed.imag[:, None])
    reach = np.where(equal_modes, np.abs(cubed.imag)[:, None], np.abs(cubed.real)[:, None])
    across = np.where(equal_modes, y.real[:, None], y.imag[:, None])
    along = np.where(equal_modes, y.imag[:, None], y.real[:, None])
    turned_over = ~level[:, None] & (np.abs(across - fixed) <= tolerance) & (np.abs(along) <= reach + tolerance)

    families = free | upside_down[:, None] | turned_over
    plane = (turned_over & (reach <= tolerance)).any(axis=-1)
    dimension = np.select([free.any(axis=-1), plane, families.any(axis=-1)], [3, 2, 1], 0)
    return families, dimension.astype(np.int8)
