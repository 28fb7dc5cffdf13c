"""Poses: made with `pose`, read with `as_rigid_transform` from whatever the caller's library calls one."""

from __future__ import annotations

import warnings
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.errors import PoseError
from spm_pin.mechanism.arguments import (
    FloatArray,
    broadcastable,
    finite_array,
    first_offender,
    real_array,
    shaped_array,
)

ORTHONORMALITY_TOLERANCE = 1e-6
"""Largest entry of RᵀR - I taken for rounding, as of single precision, and repaired; more is an error."""
EXACT = 16.0 * float(np.finfo(np.float64).eps)
"""Up to this, the rounding of a product of rotations, the matrix is kept to the last bit."""

_LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_ROTATION = "a rotation matrix"
_POSITION = "a position in metres"


@runtime_checkable
class HasRotationTranslation(Protocol):
    """Anything with a rotation (3, 3) and a translation (3,) [m], such as `pinocchio.SE3`."""

    rotation: Any
    translation: Any


PoseLike = RigidTransform | npt.ArrayLike | HasRotationTranslation
"""Arguments accepted as a pose: a `RigidTransform`, an array (..., 4, 4), or a `pinocchio.SE3`."""


def pose(
    translation: npt.ArrayLike,
    *,
    xyx: npt.ArrayLike | None = None,
    rotation: Rotation | npt.ArrayLike | None = None,
) -> RigidTransform:
    """Make the pose of the terminal platform {m} in the base {B}.

    Parameters
    ----------
    translation : array_like, shape (..., 3)
        Position of o in {B} [m].
    xyx : array_like, shape (..., 3), optional
        The paper's Euler angles α, β, λ [rad]: about X, then the new Y, then the new X. Eq. (3).
        A warning is given for angles beyond 2π, which are often degrees.
    rotation : Rotation or array_like, shape (..., 3, 3), optional
        Rotation from {m} to {B}, instead of `xyx`. One of the two is required: the identity is no default,
        because at R = I the manipulator is singular or cannot be assembled.

    Returns
    -------
    RigidTransform
        With the broadcast of both leading shapes.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88])).translation
    array([0.6889, 0.4963, 2.253 ])
    """
    position = real_array(translation, "translation", (3,), "the position of o in {B} in metres", error=PoseError)
    if (xyx is None) == (rotation is None):
        received = "neither" if xyx is None else "both"
        raise PoseError("rotation", "either xyx=... or rotation=...", received)
    if xyx is not None:
        angles = real_array(xyx, "xyx", (3,), "X-Y-X Euler angles in radians", error=PoseError)
        largest = float(np.abs(angles).max(initial=0.0))
        if largest > 2.0 * np.pi * (1.0 + EXACT):
            cause = "Angles are in radians; numpy.deg2rad converts"
            warnings.warn(f"xyx: an angle of {largest:g} rad is beyond a full turn. {cause}", stacklevel=2)
        # scipy reads shape (3,) as one rotation and (..., 3) as a batch, empty ones included.
        matrices = np.asarray(Rotation.from_euler("XYX", angles).as_matrix())
    elif isinstance(rotation, Rotation):
        matrices = np.asarray(rotation.as_matrix())
    else:
        matrices = shaped_array(rotation, "rotation", (3, 3), _ROTATION, error=PoseError)  # type: ignore[arg-type]
    return unchecked_transform(*_broadcast(_rotations(matrices, "rotation"), position, "translation"))


def as_rigid_transform(value: PoseLike, argument: str = "pose") -> RigidTransform:
    """Read a pose or a batch of poses, which `argument` names in errors; no library of poses is imported here."""
    return unchecked_transform(*checked_pose(*unchecked_pose(value, argument), argument))


def unchecked_pose(value: PoseLike, argument: str = "pose") -> tuple[FloatArray, FloatArray]:
    """Read rotations (..., 3, 3) and positions (..., 3) [m], kinds and shapes checked; may be the caller's memory."""
    if isinstance(value, RigidTransform):
        matrix = value.as_matrix()
        return matrix[..., :3, :3], matrix[..., :3, 3]
    if isinstance(value, Rotation):
        cause = "A rotation alone is no pose: spm.pose(translation, rotation=...)"
        raise PoseError(argument, "a rigid transform", "a Rotation", cause)
    if not isinstance(value, np.ndarray) and isinstance(value, HasRotationTranslation):
        turn, place = value.rotation, value.translation
        turn = turn.as_matrix() if isinstance(turn, Rotation) else turn
        rotation = shaped_array(turn, f"{argument}.rotation", (3, 3), _ROTATION, error=PoseError)
        position = shaped_array(place, f"{argument}.translation", (3,), _POSITION, error=PoseError)
        return _broadcast(rotation, position, f"{argument}.translation")
    matrices = shaped_array(value, argument, (4, 4), "a homogeneous transform", error=PoseError)
    if not (matrices[..., 3, :] == _LAST_ROW).all():
        finite_array(matrices, argument, (4, 4), "a homogeneous transform", error=PoseError)
        index = first_offender((matrices[..., 3, :] != _LAST_ROW).any(axis=-1))
        cause = "Transposed matrix?" if (matrices[index][:, 3] == _LAST_ROW).all() else ""
        where = f" at index {index}" if index else ""
        raise PoseError(argument, "the last row [0, 0, 0, 1]", f"{matrices[index][3]}{where}", cause)
    return matrices[..., :3, :3], matrices[..., :3, 3]


def checked_pose(rotation: FloatArray, position: FloatArray, argument: str) -> tuple[FloatArray, FloatArray]:
    """Return rotations (..., 3, 3), rounding repaired, and positions (..., 3), or raise `PoseError`."""
    finite_array(position, argument, (3,), _POSITION, error=PoseError)
    return _rotations(rotation, argument), position


def _rotations(matrices: FloatArray, argument: str) -> FloatArray:
    """Return matrices (..., 3, 3), those that rounding made no rotations repaired; raise if one is far from any."""
    finite_array(matrices, argument, (3, 3), _ROTATION, error=PoseError)
    error = np.abs(np.swapaxes(matrices, -1, -2) @ matrices - np.eye(3)).max(axis=(-1, -2), initial=0.0)
    wrong = error > ORTHONORMALITY_TOLERANCE
    if wrong.any():
        index = first_offender(wrong)
        received = f"RᵀR - I with an entry of {error[index]:.1e}" + (f" at index {index}" if index else "")
        raise PoseError(argument, _ROTATION, received, "Scaled, sheared, or rounded to few digits?")
    mirrored = np.linalg.det(matrices) < 0.0
    if mirrored.any():
        index = first_offender(mirrored)
        received = "determinant -1" + (f" at index {index}" if index else "")
        raise PoseError(argument, _ROTATION, received, "A reflection: a left-handed frame?")
    rounded = error > EXACT
    if rounded.any():
        # Member by member: what one pose is must not depend on its neighbours.
        matrices = matrices.copy()
        matrices[rounded] = Rotation.from_matrix(matrices[rounded]).as_matrix()
    return matrices


def _broadcast(rotation: FloatArray, position: FloatArray, argument: str) -> tuple[FloatArray, FloatArray]:
    shape = broadcastable(argument, position.shape[:-1], "the rotation", rotation.shape[:-2], error=PoseError)
    return np.broadcast_to(rotation, (*shape, 3, 3)), np.broadcast_to(position, (*shape, 3))


def homogeneous(rotation: FloatArray, position: FloatArray) -> FloatArray:
    """Return the matrices (..., 4, 4) of rotations (..., 3, 3) and positions (..., 3)."""
    matrix = np.zeros((*position.shape[:-1], 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = position
    matrix[..., 3, 3] = 1.0
    return matrix


def unchecked_transform(rotation: FloatArray, position: FloatArray) -> RigidTransform:
    """Return the pose of arrays known to be valid, bit by bit."""
    return RigidTransform(homogeneous(rotation, position), normalize=False, copy=False)
