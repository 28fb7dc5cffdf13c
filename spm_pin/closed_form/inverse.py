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

from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.closed_form.degeneracy import find_degeneracy
from spm_pin.closed_form.families import LOWER, ROOT, UPPER, FamilyForms
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import BRANCHES
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.pose import PoseLike, as_rigid_transform
from spm_pin.mechanism.solutions import Degeneracy, SolutionSet, Status

__all__ = ["complex_middle_joints", "inverse_displacement"]

ComplexArray = npt.NDArray[np.complex128]


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
    forms = FamilyForms.of(geometry, transform.rotation.as_quat().reshape(-1, 4), position)
    degeneracy = find_degeneracy(geometry, forms, rotation, position)
    discriminant = forms.discriminant
    real = (discriminant >= 0.0) & ~degeneracy.families & ~forms.vertical[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(np.where(real, discriminant, np.nan))
        joints = _middle_joints(geometry, forms, position, root)
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
    forms = FamilyForms.of(geometry, transform.rotation.as_quat().reshape(-1, 4), matrix[:, :3, 3])
    lost = find_degeneracy(geometry, forms, matrix[:, :3, :3], matrix[:, :3, 3]).families | forms.vertical[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(np.where(lost, np.nan, forms.discriminant).astype(np.complex128))
        joints = _middle_joints(geometry, forms, matrix[:, :3, 3], root)
    return np.asarray(joints.reshape(*transform.shape, 8, 3, 3))


def _middle_joints(geometry: Geometry, forms: FamilyForms, position: FloatArray, root: npt.NDArray[Any]) -> Any:
    """Return b (N, 8, 3, 3) [m] from the square roots (N, 4) of the discriminants, real or complex.

    `root` may be complex, and then so are u and v; the imaginary unit of the module's docstring is another
    one, so from here on a horizontal vector is a pair of coordinates.
    """
    uu, uv, vv = (form[:, :, None] for form in (forms.form_uu, forms.form_uv, forms.form_vv))
    root = root[:, :, None] * ROOT
    # Both pairs solve the form; the longer one is free of cancellation.
    first, second = (root - uv, uu), (vv, -uv - root)
    longer = _norm2(*first) >= _norm2(*second)
    u, v = np.where(longer, first[0], second[0]), np.where(longer, first[1], second[1])
    length = np.sqrt(u * u + v * v)
    u, v = u / length, v / length
    per_family = slice(None), slice(None), None
    sine, cosine = forms.sine[:, None, None], forms.cosine[:, None, None]
    p = sine * (v * forms.scale_v[per_family] + u * forms.scale_u[per_family])

    # w_a and conj(w_b): rotate G v -+ F u by the tilt axis and by the mode's own quarter turn.
    f, g = forms.f[per_family], forms.g[per_family]
    lower_axis = (forms.tilt_axis * np.where(UPPER > 0.0, 1.0, -1.0j))[per_family]
    upper_axis = (np.conj(forms.tilt_axis) * np.where(LOWER > 0.0, 1.0, 1.0j))[per_family]
    a1, a2 = _turn(lower_axis, g.real * v - f.real * u, g.imag * v - f.imag * u)
    b1, b2 = _turn(upper_axis, g.real * v + f.real * u, g.imag * v + f.imag * u)

    # The centre's horizontal position in {B} and in {m}; only its part along the tilt is needed: with the
    # common normal n, that direction is -i n.
    r = geometry.middle_radius
    lower_x, lower_y = -2.0 * r * a1 * a2, r * (a2 * a2 - a1 * a1)
    upper_x, upper_y = 2.0 * r * b1 * b2, r * (b2 * b2 - b1 * b1)
    normal, normal_m = forms.normal[:, None, None], forms.normal_m[:, None, None]
    x, y, z = (position[:, k, None, None] for k in range(3))
    along = normal.imag * (lower_x - x) - normal.real * (lower_y - y)
    along_m = normal_m.imag * upper_x - normal_m.real * upper_y
    height = z + ((cosine * cosine - sine * sine) * along - along_m) / (2.0 * sine * cosine)

    half_turned = (LOWER < 0.0)[:, None]
    joints = []
    for cos_phi, sin_phi, _ in geometry.radial_directions:
        radius = r * (LOWER[:, None] * p * p - 2.0 * ((a1 * a1 - a2 * a2) * sin_phi + 2.0 * a1 * a2 * cos_phi))
        lift = np.where(half_turned, a1 * cos_phi + a2 * sin_phi, a1 * sin_phi - a2 * cos_phi)
        joints.append(np.stack([radius * cos_phi, radius * sin_phi, height + 2.0 * r * p * lift], axis=-1))
    stacked = np.stack(joints, axis=-2)
    return stacked.reshape(stacked.shape[0], 8, 3, 3)


def _norm2(x: npt.NDArray[Any], y: npt.NDArray[Any]) -> FloatArray:
    return np.asarray(np.abs(x) ** 2 + np.abs(y) ** 2, dtype=np.float64)


def _turn(axis: ComplexArray, x: npt.NDArray[Any], y: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Multiply the pair (x, y), possibly complex in its own right, by the plane rotation `axis`."""
    return axis.real * x - axis.imag * y, axis.real * y + axis.imag * x
