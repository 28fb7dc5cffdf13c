"""Indices against their definitions, by routes that share no code with them."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from problems import PAPER_TILTS, singular_state
from scipy.optimize import linprog

import spm_pin as spm
from spm_pin.mechanism.branches import BRANCHES
from spm_pin.sweeps.domains import Space
from spm_pin.sweeps.metric import Index
from spm_pin.sweeps.metrics import (
    INDICES,
    conditioning,
    from_definition,
    isotropy,
    payload,
    payload_down,
    resolve,
    stiffness,
)
from spm_pin.sweeps.points import Points

GEOMETRY = spm.Geometry.paper()


def legs(count: int, seed: int = 0, low: float = 1.1, high: float = 1.5) -> np.ndarray:
    return np.random.default_rng(seed).uniform(low, high, (count, 6))


def mixed_poses(count: int) -> np.ndarray:
    """Poses, some within the leg limits, some beyond, some that nothing reaches."""
    states = spm.forward_physical(GEOMETRY, legs(2 * count, low=1.0, high=1.6))
    states = states[states.exists][:count]
    angles = states.pose.rotation.as_euler("XYX")
    poses = np.concatenate([states.translation, angles], axis=-1)
    poses[::5, :3] += [0.9, -0.7, 0.0]
    return poses


@pytest.fixture(params=["pose", "legs"])
def points(request: pytest.FixtureRequest) -> Points:
    space: Space = request.param
    return Points(GEOMETRY, space, mixed_poses(120) if space == "pose" else legs(60, low=1.0, high=1.6))


@pytest.mark.parametrize("name", INDICES)
def test_every_index_has_a_value_where_it_says(points: Points, name: str) -> None:
    index = INDICES[name]
    values = index(points)
    assert values.shape == (len(points),)
    assert values.dtype == index.dtype
    assert 0 < np.count_nonzero(points.reachable) < len(points)
    if values.dtype.kind == "f" and name != "leg_margin":
        np.testing.assert_array_equal(np.isfinite(values), points.reachable)
    assert not (values == index.not_computed).any()


def test_counts_are_those_of_direct_calls() -> None:
    poses = mixed_poses(120)
    points = Points(GEOMETRY, "pose", poses)
    direct = spm.inverse_displacement(GEOMETRY, spm.pose(poses[:, :3], xyx=poses[:, 3:]))
    np.testing.assert_array_equal(INDICES["branches"](points), direct.count)
    np.testing.assert_array_equal(INDICES["branches_within"](points), direct.within().count)
    machine = direct.within().physical()
    np.testing.assert_array_equal(INDICES["reachable"](points), machine.exists)
    np.testing.assert_array_equal(points.machine.middle_joints, machine.middle_joints)
    for axis, values in zip("xyz", machine.translation.T, strict=True):
        np.testing.assert_array_equal(INDICES[f"o_{axis}"](points), values)


def test_the_branch_is_the_machines(points: Points) -> None:
    numbers = INDICES["branch"](points)
    flags = INDICES["branch"].flags
    assert {flags[label] for label in BRANCHES} == set(range(8))
    np.testing.assert_array_equal(numbers == flags["none"], ~points.reachable)
    there = np.flatnonzero(points.reachable)
    np.testing.assert_allclose(
        points.solutions.leg_lengths[there, numbers[there]], points.machine.leg_lengths[there], atol=1e-9
    )


def test_leg_lengths_and_the_pose_they_make_have_the_same_indices() -> None:
    lengths = legs(40)
    by_legs = Points(GEOMETRY, "legs", lengths)
    state = spm.forward_physical(GEOMETRY, lengths)
    poses = np.concatenate([state.translation, state.pose.rotation.as_euler("XYX")], axis=-1)
    by_pose = Points(GEOMETRY, "pose", poses)
    # The few poses that two machines can be in are left out.
    same = ~by_pose.solutions.within().ambiguous
    assert same.sum() > 30
    for index in INDICES.values():
        np.testing.assert_allclose(index(by_legs)[same], index(by_pose)[same], rtol=1e-6, atol=1e-8, err_msg=index.name)


def test_assembly_modes_are_counted_as_the_solver_does() -> None:
    lengths = legs(70)
    expected = spm.forward_displacement(GEOMETRY, lengths).count
    np.testing.assert_array_equal(INDICES["assembly_modes"](Points(GEOMETRY, "legs", lengths)), expected)


def homogeneous(states: spm.Configuration, length: float) -> np.ndarray:
    """J_f of (v, Lω), from the inverse Jacobian."""
    return spm.inverse_jacobian(states) / np.repeat([1.0, length], 3)


@pytest.mark.parametrize("length", [None, 0.8])
def test_conditioning_and_isotropy_are_those_of_the_inverse_jacobian(length: float | None) -> None:
    points = Points(GEOMETRY, "legs", legs(50))
    matrices = homogeneous(points.machine, GEOMETRY.platform_radius if length is None else length)
    np.testing.assert_allclose(conditioning(length)(points), 1.0 / np.linalg.cond(matrices), rtol=1e-8)
    eigenvalues = 1.0 / np.linalg.eigvalsh(matrices.swapaxes(-1, -2) @ matrices)
    expected = np.exp(np.log(eigenvalues).mean(axis=-1)) / eigenvalues.mean(axis=-1)
    np.testing.assert_allclose(isotropy(length)(points), expected, rtol=1e-6)


def test_conditioning_is_that_of_pinocchio() -> None:
    chain = spm.ClosedChain.from_urdf()
    points = Points(GEOMETRY, "legs", legs(5))
    for k, value in enumerate(conditioning(0.5)(points)):
        matrix = chain.inverse_jacobian(chain.joint_values(points.machine[k])) / np.repeat([1.0, 0.5], 3)
        assert 1.0 / np.linalg.cond(matrix) == pytest.approx(value, rel=1e-7)


def test_conditioning_does_not_depend_on_the_size_of_the_machine() -> None:
    small = spm.Geometry(GEOMETRY.base_radius / 50, GEOMETRY.platform_radius / 50, GEOMETRY.middle_side / 50)
    lengths = legs(20)
    for name in ("conditioning", "isotropy", "forward_distance", "inverse_distance", "det_structure", "payload"):
        large = INDICES[name](Points(GEOMETRY, "legs", lengths))
        np.testing.assert_allclose(INDICES[name](Points(small, "legs", lengths / 50)), large, rtol=1e-9, err_msg=name)


def test_payload_is_the_most_that_leg_forces_allow_in_any_direction() -> None:
    points = Points(GEOMETRY, "legs", legs(8))
    value = payload(900.0, 400.0)(points)
    directions = np.random.default_rng(1).normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    wrenches = np.concatenate([directions, np.zeros_like(directions)], axis=-1)
    for k in range(len(points)):
        forces = spm.leg_forces(points.machine[k], wrenches)
        held = 1.0 / np.maximum(forces / 900.0, -forces / 400.0).max(axis=-1)
        assert value[k] <= held.min() * (1 + 1e-9)
        assert value[k] == pytest.approx(held.min(), rel=5e-3)


def test_payload_downwards_is_a_linear_programme() -> None:
    points = Points(GEOMETRY, "legs", legs(8, seed=3))
    value = payload_down(900.0, 400.0)(points)
    for k in range(len(points)):
        # Largest f with -400 <= f a <= 900 for the leg forces a under one newton along -Z.
        unit = spm.leg_forces(points.machine[k], [0, 0, -1, 0, 0, 0])
        bounds = np.concatenate([np.full(6, 900.0), np.full(6, 400.0)])
        found = linprog([-1.0], A_ub=np.concatenate([unit, -unit])[:, None], b_ub=bounds, bounds=(0, None))
        assert value[k] == pytest.approx(found.x[0], rel=1e-9)
    assert (payload(400.0)(points) <= value).all()


def test_stiffness_is_that_of_springs_in_the_legs() -> None:
    points = Points(GEOMETRY, "legs", legs(8))
    jacobians = spm.inverse_jacobian(points.machine)
    compliance = np.linalg.inv(2e7 * jacobians.swapaxes(-1, -2) @ jacobians)[:, :3, :3]
    expected = 1.0 / np.linalg.eigvalsh(compliance)[:, -1]
    np.testing.assert_allclose(stiffness(2e7)(points), expected, rtol=1e-7)


def test_the_margin_is_signed() -> None:
    points = Points(GEOMETRY, "pose", mixed_poses(120))
    margin = INDICES["leg_margin"](points)
    np.testing.assert_array_equal(margin >= 0, points.reachable)
    assert (margin < 0).any()
    inside = points.reachable & ~points.solutions.within().ambiguous
    expected = GEOMETRY.limits.margin(points.machine.leg_lengths)  # type: ignore[union-attr]
    np.testing.assert_array_equal(margin[inside], expected[inside])
    free = dataclasses.replace(GEOMETRY, limits=None)
    with pytest.raises(spm.ArgumentError, match="leg limits") as error:
        INDICES["leg_margin"](Points(free, "pose", points.coordinates))
    assert error.value.__notes__ == ["while evaluating the index 'leg_margin'"]
    # Without limits everything with a physical branch is reachable.
    assert Points(free, "pose", points.coordinates).reachable.sum() > points.reachable.sum()


def test_distances_and_determinants_are_those_of_singularities(points: Points) -> None:
    known = spm.singularities(points.machine)
    expected = {"forward_distance": known.sigma[:, :2].min(axis=-1), "inverse_distance": known.sigma[:, 2]}
    expected |= {f"det_{name}": known.index[:, k] for k, name in enumerate(("lower", "upper", "structure"))}
    for name, values in expected.items():
        np.testing.assert_allclose(INDICES[name](points), values, rtol=1e-12, err_msg=name)


@pytest.mark.parametrize("which", PAPER_TILTS)
def test_singular_states_among_regular_ones_do_not_stop_a_sweep(which: int) -> None:
    singular = singular_state(which, *PAPER_TILTS[which])
    regular = spm.forward_physical(GEOMETRY, legs(3))
    points = Points(GEOMETRY, "legs", legs(4))
    joined = [
        np.concatenate([getattr(regular, name), getattr(singular, name)[None]])
        for name in ("rotation", "translation", "middle_joints")
    ]
    vars(points)["machine"] = spm.Configuration.from_arrays(GEOMETRY, *joined)
    alone = Points(GEOMETRY, "legs", legs(3))
    for index in (conditioning(), isotropy(), payload(), payload_down(), stiffness()):
        values = index(points)
        assert np.isfinite(values).all()
        if which == 0:
            assert values[3] == 0.0
        elif index.name in ("conditioning", "isotropy"):
            assert values[3] < 1e-4
        else:
            # At an inverse singularity, det K = 0, forces stay finite.
            assert values[3] > 1e-3
        np.testing.assert_allclose(values[:3], index(alone), rtol=1e-9)


def test_points_of_which_none_is_reached() -> None:
    far = np.tile([5.0, 0, 2, 0.1, 0.5, -0.1], (3, 1))
    for index in INDICES.values():
        values = index(Points(GEOMETRY, "pose", far))
        assert values.shape == (3,)
        assert np.isnan(values).all() or (values == index.flags.get("none", 0)).all()


def test_the_page_names_every_index() -> None:
    page = (Path(__file__).parents[2] / "docs" / "howto" / "sweep.md").read_text(encoding="utf-8")
    assert [name for name in INDICES if f"`{name}`" not in page] == []


# An index of one's own


def r_b1(points: Points) -> np.ndarray:
    return points.machine.leg_lengths[:, 0]


def test_an_index_of_ones_own() -> None:
    index = Index("r_b1", "m", "length of leg r_b1", r_b1)
    points = Points(GEOMETRY, "legs", legs(4))
    np.testing.assert_allclose(index(points), points.coordinates[:, 0], rtol=1e-12)
    assert resolve([index, "reachable"]) == (index, INDICES["reachable"])


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"evaluate": lambda points: 1.0}, r"shape \(4,\), got shape \(\)"),
        ({"evaluate": lambda points: points.coordinates}, r"got shape \(4, 6\)"),
        ({"evaluate": lambda points: points.coordinates[:, 0], "dtype": "int8"}, "type float64"),
        ({"evaluate": lambda points: np.full(len(points), 300), "dtype": "int8"}, "from 300 to 300"),
        ({"evaluate": lambda points: np.full(len(points), -128), "dtype": "int8"}, "from -128"),
        ({"evaluate": lambda points: np.array(["a"] * len(points))}, "type <U1"),
        ({"evaluate": lambda points: np.full(len(points), 1j)}, "complex"),
    ],
)
def test_what_an_index_returns_is_checked(changes: dict[str, object], says: str) -> None:
    index = dataclasses.replace(Index("mine", "1", "mine", r_b1), **changes)  # type: ignore[arg-type]
    with pytest.raises(spm.ArgumentError, match=says):
        index(Points(GEOMETRY, "legs", legs(4)))


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Index("a b", "1", "", r_b1), "name"),
        (lambda: Index("", "1", "", r_b1), "name"),
        (lambda: Index("a", "1", "", 3), "evaluate"),  # type: ignore[arg-type]
        (lambda: Index("a", "1", "", r_b1, "uint8"), "signed integer"),
        (lambda: Index("a", "1", "", r_b1, "nonsense"), "signed integer"),
        (lambda: payload(0.0), "push"),
        (lambda: payload(1.0, -1.0), "pull"),
        (lambda: conditioning(np.nan), "length"),
        (lambda: stiffness(np.inf), "leg"),
        (lambda: resolve([]), "none"),
        (lambda: resolve(["payload", payload(5.0)]), "different names"),
        (lambda: resolve(["nonsense"]), "nonsense"),
        (lambda: resolve([1]), "expected an Index"),  # type: ignore[list-item]
    ],
)
def test_bad_indices_are_refused(make: object, says: str) -> None:
    assert callable(make)
    with pytest.raises(spm.ArgumentError, match=says):
        make()


def test_names_alone_make_indices() -> None:
    assert resolve("reachable") == (INDICES["reachable"],)


@pytest.mark.parametrize("index", [*INDICES.values(), payload(900.0, 400.0), conditioning(0.3), stiffness(1e7)])
def test_a_definition_makes_an_index_again(index: Index) -> None:
    again = from_definition(index.definition())
    points = Points(GEOMETRY, "legs", legs(3))
    np.testing.assert_array_equal(again(points), index(points))
    assert again.description == index.description


def test_a_definition_tells_functions_apart() -> None:
    def defined(function: object) -> str:
        assert callable(function)
        return str(Index("mine", "1", "", function).definition()["function"])

    def with_bound(value: float, also: float = 2.0) -> object:
        return lambda points, also=also: points.coordinates[:, 0] * value + also

    class Callable:
        def __call__(self, points: Points) -> np.ndarray:
            return points.coordinates[:, 0]

    functions = [
        r_b1,
        lambda points: points.coordinates[:, 0],
        lambda points: points.coordinates[:, 1],
        lambda points: points.coordinates[:, 0] in {"a", "b"},
        lambda points: [2.0 * x for x in points.coordinates[:, 0]],
        partial(np.multiply, 2.0),
        partial(np.multiply, 3.0),
        np.sum,
        with_bound(1.0),
        with_bound(2.0),
        with_bound(1.0, 3.0),
        Callable(),
    ]
    told = [defined(function) for function in functions]
    assert len(set(told)) == len(told)
    assert defined(lambda points: points.coordinates[:, 0]) == told[1]
    assert defined(Callable()) == told[-1]
    mine = dataclasses.replace(INDICES["payload"], evaluate=r_b1)
    with pytest.raises(spm.ArgumentError, match="your own"):
        from_definition(mine.definition())
