"""Methods with one fault each, for tests of the report."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

import spm_pin as spm
from spm_pin.crosscheck import ClosedForm
from spm_pin.nlp import branch_search as inverse
from spm_pin.nlp import loop_equations


@contextmanager
def flipped_sign() -> Iterator[None]:
    """Change one sign in one of CasADi's loop equations: b_2 + c_2 where it says b_2 - c_2."""
    true = loop_equations.equations

    def flipped(geometry: spm.Geometry, b: ca.SX, rotation: ca.SX, translation: ca.SX) -> ca.SX:
        rows = ca.vertsplit(true(geometry, b, rotation, translation))
        axis, vector = loop_equations.legs(geometry, b, rotation, translation)[4]
        rows[4] = ca.dot(axis, 2.0 * b[3:6] - vector)
        return ca.vertcat(*rows)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop_equations, "equations", flipped)
        inverse.loop_equations_of.cache_clear()
        yield
    inverse.loop_equations_of.cache_clear()


@dataclass
class Forgetful(ClosedForm):
    """Loses one branch of every third pose."""

    name: str = "forgetful"

    def inverse(self, pose: RigidTransform) -> spm.SolutionSet:
        solutions = spm.inverse_displacement(self.geometry, pose)
        keep = solutions.exists.copy()
        for n in range(0, len(keep), 3):
            keep[n, np.flatnonzero(keep[n])[:1]] = False
        return solutions.where(keep)


@dataclass
class Inaccurate(ClosedForm):
    """Right to eight digits where sixteen are stated."""

    name: str = "inaccurate"

    def inverse_jacobian(self, configuration: spm.Configuration) -> np.ndarray:
        return spm.inverse_jacobian(configuration) * (1.0 + 1e-8)
