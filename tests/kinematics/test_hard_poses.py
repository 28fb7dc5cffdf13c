"""Singular and nearly singular poses: level platforms, folds, families, and poses out of reach."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from oracle import certified_counts
from problems import PAPER, at_discriminant, conditioning, in_leg_space, random_branches
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation

import spm_pin as spm
from spm_pin.crosscheck import nlp
from spm_pin.crosscheck.paper import resultant
from spm_pin.machine.branch_of_state import family

EPS = np.finfo(float).eps
RADIAL, AXES = PAPER.radial_directions, PAPER.revolute_axes


@pytest.mark.parametrize("tilt", [1e-2, 1e-5, 1e-8])
@pytest.mark.parametrize("twist", ["as small", "finite"])
def test_nearly_level_platforms(tilt: float, twist: str) -> None:
    rng = np.random.default_rng(1)
    # With a finite twist the complex roots go to infinity as the platform levels, and certifying takes long.
    count, r = 25 if twist == "as small" else 8, PAPER.middle_radius
    azimuth, aside = rng.uniform(-np.pi, np.pi, (2, count))
    zero = np.zeros(count)
    turn = rng.uniform(-1, 1, count) * (tilt if twist == "as small" else 0.5)
    level = Rotation.from_rotvec(tilt * np.stack([np.cos(azimuth), np.sin(azimuth), zero], axis=-1))
    # Off the axis by what such a tilt can still reach: |h| of the order of r times the angle.
    off = rng.uniform(0, 1, count) * r * (tilt if twist == "as small" else 1.0)
    position = np.stack([off * np.cos(aside), off * np.sin(aside), zero + 2.2], axis=-1)
    pose = spm.pose(position, rotation=level * Rotation.from_euler("z", turn[:, None]))
    solutions = spm.inverse_displacement(PAPER, pose)
    assert not (solutions.status == spm.Status.DEGENERATE).any()
    np.testing.assert_array_equal(solutions.count, certified_counts(pose, PAPER.middle_side))
    assert 0.2 < (solutions.count > 0).mean() <= 1.0
    found = solutions.residual[solutions.exists]
    assert (found <= 64 * EPS * np.abs(solutions.middle_joints[solutions.exists]).max(axis=(-1, -2))).all()


@pytest.mark.parametrize("tilt", [1e-2, 1e-4, 1e-6])
def test_nearly_level_platforms_keep_the_digits_that_are_there(tilt: float) -> None:
    """A known configuration a little off the symmetric home comes back to rounding over the sine of the tilt."""
    rng = np.random.default_rng(2)
    legs = 1.3 + tilt * rng.uniform(-1, 1, (500, 6))
    problem = in_leg_space(PAPER, 500, seed=0, legs=legs)
    found = spm.inverse_displacement(PAPER, problem.pose).nearest(problem.configuration)
    error = np.abs(found.middle_joints - problem.middle_joints).max(axis=(-1, -2))
    assert (error <= 32 * EPS * conditioning(problem.configuration)).all()


@pytest.mark.parametrize("index", range(4))
@pytest.mark.parametrize("distance", [1e-6, 1e-9, 1e-12])
def test_folds(index: int, distance: float) -> None:
    problem = random_branches(PAPER, spm.machine.FAMILIES[index], 15, seed=3)
    separations = []
    for n in range(15):
        for sign in (1, -1):
            pose = at_discriminant(problem.pose[n], index, sign * distance, PAPER)
            solutions = spm.inverse_displacement(PAPER, pose)
            assert solutions.count == certified_counts(pose, PAPER.middle_side)
            assert solutions.exists[2 * index] == solutions.exists[2 * index + 1] == (sign > 0)
            if sign > 0:
                gap = solutions.middle_joints[2 * index] - solutions.middle_joints[2 * index + 1]
                separations.append(np.abs(gap).max())
    # Branches part like the square root of the distance from the fold.
    assert np.median(separations) < 30 * np.sqrt(distance)
    assert np.median(separations) > 0.03 * np.sqrt(distance)


@pytest.mark.parametrize("leg", range(3))
def test_denominators_of_equation_10_at_zero(leg: int) -> None:
    """Poses where a line is vertical, which the paper's route divides by, are as good as any other."""
    rng = np.random.default_rng(6)
    turns = Rotation.from_rotvec(rng.normal(size=(80, 3)))
    # Turn the revolute axis of one leg back into the horizontal plane, about the horizontal line across it.
    axis = turns.apply(AXES[leg])
    across = np.stack([-axis[:, 1], axis[:, 0], np.zeros(80)], axis=-1)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    rotation = Rotation.from_rotvec(across * np.arcsin(axis[:, 2:])) * turns
    assert np.abs(rotation.apply(AXES[leg])[:, 2]).max() < 1e-14
    matrices = rotation.as_matrix()
    if leg == 1:  # x_n of Eq. (10b) is a matrix entry, and can be zero exactly
        angles = rng.uniform(-np.pi, np.pi, (2, 80))
        (c1, c2), (s1, s2) = np.cos(angles), np.sin(angles)
        rows = [[c1, -s1 * c2, s1 * s2], [s1, c1 * c2, -c1 * s2], [0 * c1, s2, c2]]
        matrices = np.moveaxis(np.array(rows), -1, 0)
    pose = spm.pose(rng.normal(size=(80, 3)) * [0.2, 0.2, 0.5] + [0, 0, 2.0], rotation=matrices)
    if leg == 1:
        assert (pose.as_matrix()[:, 2, 0] == 0.0).all()
        assert (resultant.inverse_displacement(PAPER, pose).status == spm.Status.UNSOLVED).all()
    solutions = spm.inverse_displacement(PAPER, pose)
    np.testing.assert_array_equal(solutions.count, certified_counts(pose, PAPER.middle_side))
    assert np.nanmax(solutions.residual) < 1e-12
    assert (solutions.count > 0).sum() > 20


def test_pure_tilts_and_half_turns() -> None:
    """At zero torsion the mixed families have no band to be real in; at a half turn the equal ones have none."""
    rng = np.random.default_rng(7)
    for _ in range(6):
        azimuth, angle = rng.uniform(-np.pi, np.pi), rng.uniform(0.1, 2.0)
        tilt = Rotation.from_rotvec(angle * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
        half_turn = Rotation.from_rotvec(np.pi * rng.normal(size=3) / 1.0).as_quat()
        half_turn[3] = 0.0
        for rotation, without in ((tilt, (1, 2)), (Rotation.from_quat(half_turn), (0, 3))):
            pose = spm.pose(rng.normal(size=3) * [0.15, 0.15, 0.2] + [0, 0, 2.2], rotation=rotation)
            solutions = spm.inverse_displacement(PAPER, pose)
            assert (solutions.discriminants[list(without)] < 0.0).all()
            # Four roots of the octic are at infinity; a nudge of 1e-20 brings them back as complex ones.
            assert solutions.count == certified_counts(pose, PAPER.middle_side, nudge="1e-20")


# --- Families of solutions ----------------------------------------------------------------------------------------


def members(pose: RigidTransform, count: int, seed: int) -> Iterator[tuple[np.ndarray, int]]:
    """Yield configurations found by least squares from random starts, each with its number of freedoms.

    The nine loop equations of CasADi in the nine coordinates of b, with nothing of the closed form. The freedoms are
    the singular values of their Jacobian that vanish to the accuracy a double root leaves.
    """
    rotation, position, closure = pose.rotation.as_matrix(), pose.translation, nlp.closure(PAPER)

    def equations(x: np.ndarray) -> np.ndarray:
        return np.asarray(closure(x, rotation, position)[0]).ravel()

    def jacobian(x: np.ndarray) -> np.ndarray:
        return np.asarray(closure(x, rotation, position)[1])

    rng = np.random.default_rng(seed)
    for _ in range(count):
        start = rng.normal(size=9) * np.tile([0.4, 0.4, 0.6], 3) + np.tile(position / 2, 3)
        found = least_squares(equations, start, jac=jacobian, xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=300)
        if np.abs(found.fun).max() < 1e-12:
            singular = np.linalg.svd(jacobian(found.x), compute_uv=False)
            yield found.x.reshape(3, 3), int(np.count_nonzero(singular < 1e-5))


def pure_tilt_on_its_band(azimuth: float, angle: float, family: int) -> RigidTransform:
    """A pure tilt whose axis distance is that of a mixed family's band, a single point: h = ± r sin²(θ/2) sin 3ψ."""
    rotation = Rotation.from_rotvec(angle * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
    normal = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    h = PAPER.middle_radius * np.sin(angle / 2) ** 2 * np.sin(3 * azimuth)
    return spm.pose(normal * h * (1 if family == 1 else -1) + [0, 0, 2.2], rotation=rotation)


FAMILIES = {
    "level on the axis": (spm.pose([0, 0, 2.2], rotation=np.eye(3)), 3, "TT FF", (0, 1, 2)),
    "half turn on the axis": (spm.pose([0, 0, 2.2], rotation=np.diag([-1, -1, 1])), 3, "TF FT", (0, 1, 2)),
    **{
        f"turned by {angle} about the axis of leg {i + 1}": (
            spm.pose([0, 0, 2.2] + 0.1 * RADIAL[i], rotation=Rotation.from_rotvec(angle * AXES[i])),
            1,
            "TT TF FT FF",
            (i,),
        )
        for i, angle in enumerate((0.5, 1e-3, 2.5))
    },
    **{
        f"half turn in the plane of leg {i + 1}": (
            spm.pose(
                [0, 0, 2.2] + 0.1 * RADIAL[i],
                rotation=Rotation.from_rotvec(np.pi * (np.cos(1.2) * RADIAL[i] + [0, 0, np.sin(1.2)])),
            ),
            1,
            "TT TF FT FF",
            (i,),
        )
        for i in (0, 1)
    },
    "pure tilt, TF": (pure_tilt_on_its_band(0.4, 0.5, 1), 1, "TF", ()),
    "pure tilt, FT": (pure_tilt_on_its_band(-1.1, 0.8, 2), 1, "FT", ()),
}


@pytest.mark.parametrize("name", FAMILIES)
def test_families_are_named_and_nothing_is_picked_from_them(name: str) -> None:
    pose, dimension, families, legs = FAMILIES[name]
    solutions = spm.inverse_displacement(PAPER, pose)
    assert solutions.status is spm.Status.DEGENERATE
    assert int(solutions.degeneracy.dimension) == dimension
    expected = np.isin(spm.machine.FAMILIES, families.split())
    np.testing.assert_array_equal(solutions.degeneracy.families, expected)
    np.testing.assert_array_equal(solutions.degeneracy.legs, np.isin(range(3), legs))
    assert not solutions.exists.reshape(4, 2)[expected].any()

    # Least squares finds members by themselves: in those families with that freedom, elsewhere isolated.
    freedoms: dict[str, list[int]] = {}
    for joints, freedom in members(pose, 20, seed=0):
        state = spm.Configuration(PAPER, pose, joints)
        of = spm.machine.FAMILIES[int(family(state))]
        freedoms.setdefault(of, []).append(freedom)
        if of not in families.split():
            np.testing.assert_allclose(solutions.nearest(state).middle_joints, joints, atol=1e-6)
    assert set(families.split()) & set(freedoms)
    for of, found in freedoms.items():
        assert np.median(found) == (dimension if of in families.split() else 0), (of, found)


@pytest.mark.parametrize(
    "pose",
    [
        spm.pose([0.1, 0, 2.2], rotation=np.eye(3)),
        spm.pose([0.0, 1e-9, 2.2], rotation=Rotation.from_euler("z", 40, degrees=True)),
        spm.pose([0.1, 0.05, 2.2], rotation=np.diag([-1.0, -1.0, 1.0])),
        spm.pose([0.3, 0.2, 2.2], rotation=np.diag([1.0, -1.0, -1.0])),
        *[
            spm.pose([0, 0, 2.2] + 0.1 * RADIAL[i] + 1e-6 * AXES[i], rotation=Rotation.from_rotvec(0.4 * AXES[i]))
            for i in range(3)
        ],
    ],
)
def test_parallel_planes_that_are_distinct_are_unreachable(pose: RigidTransform) -> None:
    solutions = spm.inverse_displacement(PAPER, pose)
    assert solutions.status is spm.Status.UNREACHABLE
    assert not solutions.exists.any()
    assert not list(members(pose, 10, seed=1))


def test_near_a_family_the_isolated_solutions_are_found() -> None:
    """A millionth of a radian and of a metre away from mirror symmetry, everything is regular again."""
    rng = np.random.default_rng(9)
    for i in range(3):
        for _ in range(8):
            nudge = 1e-6 * rng.normal(size=3)
            rotation = Rotation.from_rotvec(0.5 * AXES[i]) * Rotation.from_rotvec(nudge)
            pose = spm.pose([0, 0, 2.2] + 0.1 * RADIAL[i] + 1e-7 * rng.normal(size=3), rotation=rotation)
            solutions = spm.inverse_displacement(PAPER, pose)
            assert solutions.status in (spm.Status.OK, spm.Status.UNREACHABLE)
            assert solutions.count == certified_counts(pose, PAPER.middle_side)
            assert np.nanmax(np.append(solutions.residual, 0.0)) < 1e-13
