"""Poses: made with `pose`, read with `as_rigid_transform` from whatever the caller's library calls one."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.errors import PoseError
from spm_pin.mechanism.arguments import FloatArray, first_offender, real_array

__all__ = ["HasRotationTranslation", "PoseLike", "as_rigid_transform", "pose"]

ORTHONORMALITY_TOLERANCE = 1e-6
"""Largest entry of RᵀR - I taken for rounding, as of single precision, and repaired; more is an error."""
EXACT = 1e-15
"""Up to this the matrix is as good as double precision has it, and kept to the last bit."""


@runtime_checkable
class HasRotationTranslation(Protocol):
    """Anything with a rotation (3, 3) and a translation (3,), such as `pinocchio.SE3`."""

    @property
    def rotation(self) -> Any:
        """From {m} to {B}, shape (3, 3)."""

    @property
    def translation(self) -> Any:
        """Of o in {B} [m], shape (3,)."""


PoseLike = RigidTransform | npt.ArrayLike | HasRotationTranslation


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
    rotation : Rotation or array_like, shape (..., 3, 3), optional
        Rotation from {m} to {B}, instead of `xyx`. One of the two is required: the identity is no default,
        because at R = I the manipulator is singular or cannot be assembled.

    Returns
    -------
    RigidTransform
        With the broadcast of both leading shapes.

    Raises
    ------
    PoseError
        If neither or both rotations are given, a shape is wrong, a number is not finite, or a matrix is
        no rotation.

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
        matrices = _euler(angles)
    elif isinstance(rotation, Rotation):
        matrices = _finite(rotation.as_matrix(), "rotation")
    else:
        matrices = _rotations(rotation, "rotation")  # type: ignore[arg-type]
    return _assemble(matrices, position, "translation")


def as_rigid_transform(value: PoseLike, argument: str = "pose") -> RigidTransform:
    """Read a pose, or a batch of poses.

    Parameters
    ----------
    value : RigidTransform, array_like of shape (..., 4, 4), or object with `.rotation` and `.translation`
        `pinocchio.SE3` is of the last kind; no such library is imported here.
    argument : str
        Name of the argument in the caller's signature, for errors.

    Raises
    ------
    PoseError
        If `value` is none of these, or is not a rigid transform of finite numbers.
    """
    if isinstance(value, RigidTransform):
        matrix = value.as_matrix()
    elif isinstance(value, HasRotationTranslation):
        rotation, translation = value.rotation, value.translation
        if isinstance(rotation, Rotation):
            rotation = rotation.as_matrix()
        rotation = _rotations(rotation, f"{argument}.rotation")
        name = f"{argument}.translation"
        position = real_array(translation, name, (3,), "a position in metres", error=PoseError)
        return _assemble(rotation, position, name)
    elif isinstance(value, Rotation):
        cause = "A rotation alone is no pose: spm.pose(translation, rotation=...)"
        raise PoseError(argument, "a rigid transform", "a Rotation", cause)
    else:
        matrix = real_array(value, argument, (4, 4), "a homogeneous transform", error=PoseError)
    last = np.abs(matrix[..., 3, :] - [0.0, 0.0, 0.0, 1.0]).max(axis=-1, initial=0.0)
    if (last > 0.0).any():
        index = first_offender(last > 0.0)
        offender = matrix[index]
        cause = "Transposed matrix?" if (offender[:, 3] == [0, 0, 0, 1]).all() else ""
        where = f" at index {index}" if index else ""
        raise PoseError(argument, "the last row [0, 0, 0, 1]", f"{offender[3]}{where}", cause)
    position = matrix[..., :3, 3]
    if not np.isfinite(position).all():
        real_array(position, argument, (3,), "the translation in metres", error=PoseError)
    return _assemble(_rotations(matrix[..., :3, :3], argument), position, argument)


def _euler(angles: FloatArray) -> FloatArray:
    # scipy reads shape (3,) as one rotation and (..., 3) as a batch, empty ones included.
    return np.asarray(Rotation.from_euler("XYX", angles).as_matrix())


def _gram_error(matrices: FloatArray) -> FloatArray:
    return np.asarray(np.swapaxes(matrices, -1, -2) @ matrices - np.eye(3))


def _finite(matrices: FloatArray, argument: str) -> FloatArray:
    return real_array(matrices, argument, (3, 3), "a rotation matrix", error=PoseError)


def _rotations(value: npt.ArrayLike, argument: str) -> FloatArray:
    matrices = _finite(np.asarray(value), argument)
    error = np.abs(_gram_error(matrices)).max(axis=(-1, -2), initial=0.0)
    wrong = error > ORTHONORMALITY_TOLERANCE
    if wrong.any():
        index = first_offender(wrong)
        received = f"RᵀR - I with an entry of {error[index]:.1e}" + (f" at index {index}" if index else "")
        raise PoseError(argument, "a rotation matrix", received, "Scaled, sheared, or rounded to few digits?")
    mirrored = np.linalg.det(matrices) < 0.0
    if mirrored.any():
        index = first_offender(mirrored)
        received = "determinant -1" + (f" at index {index}" if index else "")
        raise PoseError(argument, "a rotation matrix", received, "A reflection: a left-handed frame?")
    return matrices


def _assemble(matrices: FloatArray, position: FloatArray, argument: str) -> RigidTransform:
    try:
        shape = np.broadcast_shapes(matrices.shape[:-2], position.shape[:-1])
    except ValueError:
        expected = f"leading axes that broadcast with those of the rotation, {matrices.shape[:-2]}"
        raise PoseError(argument, expected, position.shape[:-1]) from None
    transform = np.zeros((*shape, 4, 4))
    transform[..., :3, :3] = matrices
    transform[..., :3, 3] = position
    transform[..., 3, 3] = 1.0
    rounded = np.abs(_gram_error(transform[..., :3, :3])).max(axis=(-1, -2), initial=0.0) > EXACT
    if rounded.any():
        # Member by member: what one pose is must not depend on its neighbours.
        repaired = RigidTransform.from_matrix(transform).as_matrix()
        transform = np.where(rounded[..., None, None], repaired, transform)
    return RigidTransform(transform, normalize=False, copy=False)
