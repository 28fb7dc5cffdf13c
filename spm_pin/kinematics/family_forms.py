"""The four quadratics of a pose; their discriminants measure how far its families are from being real.

Notation and derivation: `spm_pin.kinematics.inverse_displacement` and `docs/theory/inverse_displacement.md`.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.kinematics.formulas.branches import families, pose_frame
from spm_pin.kinematics.formulas.operations import bind
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.geometry import Geometry


@dataclass(frozen=True)
class FamilyForms:
    """Quadratic forms of N poses for the families TT, TF, FT, FF, arrays of shape (N,) or, per family, (N, 4)."""

    cosine: FloatArray
    """c, s: half the tilt of the platform."""
    sine: FloatArray
    normal: npt.NDArray[np.complex128]
    """The common normal n of the two Z axes, seen from {B}; NaN where they are parallel."""
    form_uu: FloatArray
    """The quadratic form, h subtracted, (N, 4) [m]."""
    form_uv: FloatArray
    form_vv: FloatArray

    @property
    def discriminant(self) -> FloatArray:
        """Discriminants of the four forms, (N, 4) [m²]."""
        return self.form_uv**2 - self.form_uu * self.form_vv

    @classmethod
    def of(cls, geometry: Geometry, quaternion: FloatArray, position: FloatArray) -> FamilyForms:
        """Set up the four forms for quaternions (N, 4), scalar last, and positions (N, 3) [m]."""
        matrices = np.moveaxis(Rotation.from_quat(quaternion).as_matrix(), 0, -1)
        # Arrays stand for numbers.
        run: Any = functools.partial(bind, where=np.where, both=np.logical_and)
        frame = run(pose_frame)(tuple(map(tuple, matrices)), tuple(position.T), geometry.middle_radius)
        forms = [np.array(family[:3]) for family in run(families)(frame, geometry.middle_radius)]
        normal = np.where(frame.is_vertical, np.nan, frame.normal[0] + 1j * frame.normal[1])
        return cls(frame.cosine, frame.sine, normal, *np.transpose(forms, (1, 2, 0)))
