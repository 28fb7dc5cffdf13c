"""Poses: `pose` makes one, `as_rigid_transform` reads one from the types of common libraries."""

from __future__ import annotations

import shlex
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.errors import ArgumentError, PoseError
from spm_pin.support.arguments import (
    FloatArray,
    as_array,
    broadcastable,
    finite_array,
    first_offender,
    real_array,
    shaped_array,
)

ORTHONORMALITY_TOLERANCE = 1e-6
"""Largest entry of RᵀR - I that counts as rounding, as in single precision, and is repaired; larger ones are errors."""
UNIT = "a quaternion of length 1"
_UNIT_TOLERANCE = 1e-3
"""Largest difference of a quaternion's length from 1 that counts as rounding and is normalised."""
EXACT = 16.0 * float(np.finfo(np.float64).eps)
"""Largest entry of RᵀR - I, the rounding of a product of rotations, for which the matrix is kept unchanged."""

_LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_WRITTEN_OUT = {
    6: "Is it a position and three angles? spm.pose(a[..., :3], rpy=a[..., 3:]), or xyx=..., rotvec=...",
    7: "Is it a position and a quaternion? spm.pose(a[..., :3], quat=a[..., 3:]), scalar last: x, y, z, w",
}
"""Hints for the conversion of six or seven numbers to a pose."""
_TRANSFORM = "Is it a homogeneous transform? scipy.spatial.transform.RigidTransform.from_matrix(a) makes a pose of it"
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
    rpy: npt.ArrayLike | None = None,
    quat: npt.ArrayLike | None = None,
    rotvec: npt.ArrayLike | None = None,
    matrix: npt.ArrayLike | None = None,
    rotation: Rotation | npt.ArrayLike | None = None,
) -> RigidTransform:
    """Make the pose of the terminal platform {m} in the base {B}.

    Parameters
    ----------
    translation : array_like, shape (..., 3)
        Position of o in {B} [m].
    xyx : array_like, shape (..., 3), optional
        The paper's Euler angles α, β, λ [rad]: about X, then the new Y, then the new X. Eq. (3).
    rpy : array_like, shape (..., 3), optional
        Roll, pitch, yaw [rad] about the fixed axes X, Y, Z in this order, as in URDF.
    quat : array_like, shape (..., 4), optional
        Unit quaternion, scalar last: x, y, z, w.
    rotvec : array_like, shape (..., 3), optional
        Rotation vector: the axis times the angle [rad].
    matrix : array_like, shape (..., 3, 3), optional
        Rotation matrix from {m} to {B}.
    rotation : Rotation or array_like, shape (..., 3, 3), optional
        SciPy's rotation from {m} to {B}, or its matrix.

        Exactly one orientation is required. There is no default, because at R = I the manipulator is singular or
        cannot be assembled. Angles beyond 2π, which are often degrees, give a warning.

    Returns
    -------
    RigidTransform
        Its shape is the broadcast of both leading shapes.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> spm.pose([0.6889, 0.4963, 2.253], xyx=np.deg2rad([-11.08, 32.97, -12.88])).translation
    array([0.6889, 0.4963, 2.253 ])
    """
    values = {"xyx": xyx, "rpy": rpy, "quat": quat, "rotvec": rotvec, "matrix": matrix, "rotation": rotation}
    named = [name for name, value in values.items() if value is not None]
    value: Any = None
    try:
        position = real_array(translation, "translation", (3,), "the position of o in {B} in metres")
        if len(named) != 1:
            expected = f"exactly one orientation: {', '.join(f'{name}=...' for name in values)}"
            raise ArgumentError("rotation", expected, " and ".join(named) or "none")
        (name,) = named
        value = values[name]
        matrices = np.asarray(value.as_matrix()) if isinstance(value, Rotation) else _read_orientation(value, name)
        return unchecked_transform(*_broadcast(_rotations(matrices, name), position, "translation"))
    except ArgumentError as error:
        wrong = translation if error.argument == "translation" else value
        if isinstance(wrong, HasRotationTranslation):
            cause = "It is a pose already; its parts are a.translation and a.rotation"
            raise PoseError(error.argument, error.expected, f"a {type(wrong).__name__}", cause) from None
        raise _pose_error(error, wrong, _TRANSFORM if error.argument not in _ORIENTATIONS else "") from None


def _pose_error(error: ArgumentError, value: Any, transform: str = "") -> PoseError:
    """Return an error as one about a pose, with advice for numbers that look like a pose; `transform` if 4 x 4."""
    array = as_array(value)
    shape = () if array is None else array.shape
    cause = transform if shape[-2:] == (4, 4) else _WRITTEN_OUT.get(shape[-1] if shape else 0, "")
    return PoseError(error.argument, error.expected, error.received, cause or error.cause)


_ORIENTATIONS: dict[str, tuple[int, str, Callable[[FloatArray], Rotation]]] = {
    "xyx": (3, "X-Y-X Euler angles in radians", partial(Rotation.from_euler, "XYX")),
    "rpy": (3, "roll, pitch, yaw in radians", partial(Rotation.from_euler, "xyz")),
    "rotvec": (3, "a rotation vector in radians", Rotation.from_rotvec),
    "quat": (4, "a unit quaternion x, y, z, w", Rotation.from_quat),
}
"""Orientations by the name of their argument: the number of values, their meaning, and SciPy's function for them."""


def _read_orientation(value: Any, name: str) -> FloatArray:
    """Return the matrices (..., 3, 3) of an orientation, by the name of its argument."""
    if name not in _ORIENTATIONS:
        return shaped_array(value, name, (3, 3), _ROTATION)
    size, meaning, read = _ORIENTATIONS[name]
    numbers = real_array(value, name, (size,), meaning)
    if name == "quat":
        wrong = first_wrong_quaternion(numbers)
        if wrong is not None:
            index, received, cause = wrong
            raise PoseError(name, UNIT, received + (f" at index {index}" if index else ""), cause)
    else:
        largest = float(np.abs(numbers).max(initial=0.0))
        if largest > 2.0 * np.pi * (1.0 + EXACT):
            cause = "Angles are in radians; numpy.deg2rad converts"
            warnings.warn(f"{name}: an angle of {largest:g} rad is beyond a full turn. {cause}", stacklevel=3)
    return np.asarray(read(numbers).as_matrix())


def first_wrong_quaternion(quaternions: FloatArray) -> tuple[tuple[int, ...], str, str] | None:
    """Return index, length and likely cause of the first quaternion of (..., 4) that is not `UNIT`, or None."""
    lengths = np.linalg.norm(quaternions, axis=-1)
    wrong = np.abs(lengths - 1.0) > _UNIT_TOLERANCE
    if not wrong.any():
        return None
    index = first_offender(wrong)
    # For a length far from 1 no cause is known.
    cause = "Is it rounded to few digits?" if abs(lengths[index] - 1.0) < 0.1 else ""
    return index, f"length {lengths[index]:g}", cause


def inverse_command(request: Mapping[str, npt.ArrayLike], machine_file: str | None = None) -> str:
    """Return the command that solves a request: its numbers by the options, [m] and degrees; a height for a stage."""
    numbers = "".join(f" --{name} {' '.join(repr(float(x)) for x in np.ravel(x))}" for name, x in request.items())
    robot = "" if machine_file is None else f" --machine {shlex.quote(machine_file)}"
    return f"spm-pin {'stage ' * ('height' in request)}inverse{numbers}{robot}"


def as_rigid_transform(value: PoseLike, argument: str = "pose") -> RigidTransform:
    """Read a pose or a batch of poses, called `argument` in errors; no library of poses is imported."""
    return unchecked_transform(*checked_pose(*unchecked_pose(value, argument), argument))


def unchecked_pose(value: PoseLike, argument: str = "pose") -> tuple[FloatArray, FloatArray]:
    """Read rotations (..., 3, 3) and positions (..., 3) [m] and check shapes; may return the caller's memory."""
    if isinstance(value, RigidTransform):
        matrix = value.as_matrix()
        return matrix[..., :3, :3], matrix[..., :3, 3]
    if isinstance(value, Rotation):
        cause = "A rotation alone is not a pose: spm.pose(translation, rotation=...)"
        raise PoseError(argument, "a rigid transform", "a Rotation", cause)
    try:
        if not isinstance(value, np.ndarray) and isinstance(value, HasRotationTranslation):
            turn, place = value.rotation, value.translation
            turn = turn.as_matrix() if isinstance(turn, Rotation) else turn
            rotation = shaped_array(turn, f"{argument}.rotation", (3, 3), _ROTATION)
            position = shaped_array(place, f"{argument}.translation", (3,), _POSITION)
            return _broadcast(rotation, position, f"{argument}.translation")
        matrices = shaped_array(value, argument, (4, 4), "a homogeneous transform")
        if not (matrices[..., 3, :] == _LAST_ROW).all():
            finite_array(matrices, argument, (4, 4), "a homogeneous transform")
            index = first_offender((matrices[..., 3, :] != _LAST_ROW).any(axis=-1))
            cause = "Is the matrix transposed?" if (matrices[index][:, 3] == _LAST_ROW).all() else ""
            where = f" at index {index}" if index else ""
            raise ArgumentError(argument, "the last row [0, 0, 0, 1]", f"{matrices[index][3]}{where}", cause)
    except ArgumentError as error:
        raise _pose_error(error, value) from None
    return matrices[..., :3, :3], matrices[..., :3, 3]


def checked_pose(rotation: FloatArray, position: FloatArray, argument: str) -> tuple[FloatArray, FloatArray]:
    """Return rotations (..., 3, 3), rounding repaired, and positions (..., 3); raise `PoseError` if invalid."""
    try:
        finite_array(position, argument, (3,), _POSITION)
        return _rotations(rotation, argument), position
    except ArgumentError as error:
        raise _pose_error(error, None) from None


def _rotations(matrices: FloatArray, argument: str) -> FloatArray:
    """Return matrices (..., 3, 3) with rounding errors repaired; raise an error for one that is not a rotation."""
    finite_array(matrices, argument, (3, 3), _ROTATION)
    error = np.abs(np.swapaxes(matrices, -1, -2) @ matrices - np.eye(3)).max(axis=(-1, -2), initial=0.0)
    wrong = error > ORTHONORMALITY_TOLERANCE
    if wrong.any():
        index = first_offender(wrong)
        received = f"RᵀR - I with an entry of {error[index]:.1e}" + (f" at index {index}" if index else "")
        raise ArgumentError(argument, _ROTATION, received, "Is it scaled, sheared, or rounded to few digits?")
    mirrored = np.linalg.det(matrices) < 0.0
    if mirrored.any():
        index = first_offender(mirrored)
        received = "determinant -1" + (f" at index {index}" if index else "")
        raise ArgumentError(argument, _ROTATION, received, "It is a reflection: is a frame left-handed?")
    rounded = error > EXACT
    if rounded.any():
        # Member by member: the result for one pose must not depend on the others.
        matrices = matrices.copy()
        matrices[rounded] = Rotation.from_matrix(matrices[rounded]).as_matrix()
    return matrices


def _broadcast(rotation: FloatArray, position: FloatArray, argument: str) -> tuple[FloatArray, FloatArray]:
    shape = broadcastable(argument, position.shape[:-1], "the rotation", rotation.shape[:-2])
    return np.broadcast_to(rotation, (*shape, 3, 3)), np.broadcast_to(position, (*shape, 3))


def homogeneous(rotation: FloatArray, position: FloatArray) -> FloatArray:
    """Return the matrices (..., 4, 4) of rotations (..., 3, 3) and positions (..., 3)."""
    matrix = np.zeros((*position.shape[:-1], 4, 4))
    matrix[..., :3, :3] = rotation
    matrix[..., :3, 3] = position
    matrix[..., 3, 3] = 1.0
    return matrix


def unchecked_transform(rotation: FloatArray, position: FloatArray) -> RigidTransform:
    """Return the pose of valid arrays without changing a bit."""
    return RigidTransform(homogeneous(rotation, position), normalize=False, copy=False)
