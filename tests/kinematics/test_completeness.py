"""No branch is missed and none is spurious, against the quadratics in another form and with more digits.

Real or not is decided here by the forms in P and Q with the azimuths of R = Rz(γ1) Ry(θ) Rz(γ2), in extended
precision. Neither the package's coordinates u, v nor its quaternions occur, and where these digits do not decide
either, ball arithmetic does.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import pytest
from oracle import certified_count
from problems import GEOMETRIES, in_leg_space, random_branches
from scipy.spatial.transform import Rotation

import spm_pin as spm
from spm_pin.formulas.branches import families, pose_frame
from spm_pin.formulas.operations import bind

PAPER = spm.Geometry.paper()
DIGITS = 64.0 * float(np.finfo(np.longdouble).eps)


def discriminants(pose: np.ndarray, r: float) -> np.ndarray:
    """Discriminants C² - 4 A B of the forms A P² + B Q² + C PQ, shape (N, 4); NaN where it might be rounding."""
    x1, x2, x3, x0 = Rotation.from_matrix(pose[:, :3, :3]).as_quat().T.astype(np.longdouble)
    position = pose[:, :3, 3].astype(np.longdouble)
    norm = np.sqrt(x0 * x0 + x1 * x1 + x2 * x2 + x3 * x3)
    c, sine = np.hypot(x0, x3) / norm, np.hypot(x1, x2) / norm
    # γ1 = s + t, γ2 = s - t, counted from leg 2.
    s, t = np.arctan2(x3, x0), np.arctan2(-x2, -x1)
    gamma_1, gamma_2 = s + t, s - t
    # The common normal points along W S.
    along = s + np.arctan2(x2, x1)
    h = np.cos(along) * position[:, 0] + np.sin(along) * position[:, 1]
    k1 = r * (c * c * np.sin(3 * gamma_1) + np.sin(s - 3 * t))
    k2 = r * (c * c * np.sin(3 * gamma_2) + np.sin(s + 3 * t))
    even, odd = 4 * c * r * np.sin(2 * s) * np.cos(3 * t), 4 * c * r * np.sin(2 * s) * np.sin(3 * t)
    equal, mixed = 2 * h * c * np.cos(s), 2 * h * c * np.sin(s)
    a = np.stack([k1 - h, k1 - h, -k1 - h, -k1 - h], axis=-1)
    b = np.stack([k2 - h, -k2 - h, k2 - h, -k2 - h], axis=-1)
    pq = np.stack([equal - even, -mixed - odd, mixed - odd, equal + even], axis=-1)
    found, largest = pq * pq - 4 * a * b, np.abs(np.stack([a, b, pq])).max(axis=0)
    # Of these digits; and close to a fold of those of the pose, with which P² + Q² - 2 κ PQ comes near a square.
    square = np.stack([sine**2 + (x / norm) ** 2 for x in (x3, x0, x0, x3)], axis=-1)
    rounding = DIGITS * largest * (r + np.abs(h))[:, None] + 1e-12 * square * largest**2
    return np.where(np.abs(found) > rounding, found, np.nan).astype(np.float64)


def level(rng: np.random.Generator, count: int) -> np.ndarray:
    """Platforms tilted by 1e-6 to 0.1, turned as little or by a finite angle, as far aside as can be reached so."""
    azimuth, aside = rng.uniform(-np.pi, np.pi, (2, count))
    tilt = 10.0 ** rng.uniform(-6.0, -1.0, count)
    little = rng.uniform(size=count) < 0.5
    turn = rng.uniform(-1.0, 1.0, count) * np.where(little, tilt, 0.5)
    axis = np.stack([np.cos(azimuth), np.sin(azimuth), 0.0 * azimuth], axis=-1)
    rotation = Rotation.from_rotvec(tilt[:, None] * axis) * Rotation.from_euler("z", turn[:, None])
    off = rng.uniform(size=count) * PAPER.middle_radius * np.where(little, tilt, 1.0)
    position = np.stack([off * np.cos(aside), off * np.sin(aside), 0.0 * off + 2.2], axis=-1)
    return spm.pose(position, rotation=rotation).as_matrix()


def folds(rng: np.random.Generator, count: int) -> np.ndarray:
    """Poses shifted along the common normal to 1e-11 to 1e-2 m of where two branches of some family meet."""
    pose = random_branches(PAPER, "TT", count, seed=int(rng.integers(1 << 31))).pose
    rows = np.moveaxis(pose.rotation.as_matrix(), 0, -1)
    # Arrays stand for numbers.
    run: Any = functools.partial(bind, where=np.where, both=np.logical_and)
    frame = run(pose_frame)(tuple(map(tuple, rows)), tuple(pose.translation.T), PAPER.middle_radius)
    forms = np.array([form[:3] for form in run(families)(frame, PAPER.middle_radius)])
    uu, uv, vv = forms[rng.integers(4, size=count), :, np.arange(count)].T
    spread = np.hypot((uu - vv) / 2, uv) * rng.choice([-1.0, 1.0], count)
    beyond = 10.0 ** rng.uniform(-11.0, -2.0, count) * rng.choice([-1.0, 1.0], count)
    shift = ((uu + vv) / 2 + spread + beyond)[:, None]
    normal = np.stack([*frame.normal[:2], np.zeros(count)], axis=-1)
    return spm.pose(pose.translation + shift * normal, rotation=pose.rotation).as_matrix()


def assert_complete(pose: np.ndarray, geometry: spm.Geometry) -> tuple[int, int]:
    """Compare every family of every pose; return how many poses were certified, and how many have no branch."""
    solutions = spm.inverse_displacement(geometry, pose)
    assert not (solutions.status == spm.Status.DEGENERATE).any()
    reference = discriminants(pose, geometry.middle_radius)
    doubtful = np.isnan(reference)
    real = solutions.exists.reshape(-1, 4, 2)
    np.testing.assert_array_equal(real[..., 0], real[..., 1])
    np.testing.assert_array_equal(real[..., 0][~doubtful], (reference > 0.0)[~doubtful])
    rest = np.flatnonzero(doubtful.any(axis=-1))
    quaternion = Rotation.from_matrix(pose[rest, :3, :3]).as_quat()
    certified = [
        certified_count(q, o, geometry.middle_side) for q, o in zip(quaternion, pose[rest, :3, 3], strict=True)
    ]
    np.testing.assert_array_equal(solutions.count[rest], certified)
    size = np.abs(solutions.middle_joints[solutions.exists]).max(axis=(-1, -2), initial=geometry.middle_side)
    assert (solutions.residual[solutions.exists] <= 64 * np.finfo(float).eps * size).all()
    return len(rest), int(np.count_nonzero(solutions.count == 0))


def everything(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    position = rng.normal(size=(count // 4, 3)) * [0.4, 0.4, 2.0]
    anywhere = spm.pose(position, rotation=Rotation.random(count // 4, rng=rng)).as_matrix()
    reached = in_leg_space(PAPER, count // 4, seed=seed).pose.as_matrix()
    tally = [
        assert_complete(pose, PAPER) for pose in (anywhere, reached, level(rng, count // 8), folds(rng, count // 8))
    ]
    for k, geometry in enumerate(GEOMETRIES.values()):
        for family in spm.mechanism.FAMILIES:
            pose = random_branches(geometry, family, count // 64, seed=seed + k).pose.as_matrix()
            tally.append(assert_complete(pose, geometry))
    certified, empty = np.sum(tally, axis=0)
    assert 0 < certified < count // 20, "most are decided without"
    assert empty > count // 10


def test_ten_thousand_poses() -> None:
    everything(10_000, seed=1)


@pytest.mark.slow
def test_two_hundred_thousand_poses() -> None:
    for seed in range(2):
        everything(100_000, seed=100 + seed)
