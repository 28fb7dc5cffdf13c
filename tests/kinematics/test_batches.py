"""A batch has the answers of its members, absent ones disturb no other, and it takes the memory of its answer."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from problems import as_built, in_leg_space, random_branches

import spm_pin as spm
from spm_pin.kinematics import complex_middle_joints, platform_jacobian, principal_stiffness
from spm_pin.kinematics.batches import threads
from spm_pin.kinematics.inverse_displacement import branch_lengths

PAPER = spm.Geometry.paper()
SHAPES = [(), (1,), (0,), (3, 1, 2)]
EPS = np.finfo(float).eps

BRANCHES = {
    "middle_joints": (8, 3, 3),
    "rotation": (8, 3, 3),
    "translation": (8, 3),
    "leg_lengths": (8, 6),
    "exists": (8,),
    "is_physical": (8,),
    "ambiguous": (),
    "count": (),
    "residual": (8,),
    "status": (),
    "discriminants": (4,),
    "merged": (8,),
}
MODES = {"middle_joints": (256, 3, 3), "rotation": (256, 3, 3), "translation": (256, 3), "exists": (256,), "status": ()}
SINGULARITIES = {
    "determinants": (3,),
    "scaled_determinants": (3,),
    "sigma": (3,),
    "condition": (3,),
    "rank": (3,),
    "kind": (),
    "mobility": (),
    "gained_twist": (2, 6),
    "inner_twist": (6,),
    "lost_wrench": (6,),
}
OF_A_STATE = {
    "inverse_jacobian": (lambda state, vector: spm.inverse_jacobian(state), (6, 6)),
    "platform_jacobian": (lambda state, vector: platform_jacobian(state), (6, 6)),
    "leg_rates": (spm.leg_rates, (6,)),
    "leg_forces": (spm.leg_forces, (6,)),
    "determinant_gradients": (lambda state, vector: spm.kinematics.determinant_gradients(state), (3, 6)),
    "compliance": (lambda state, vector: spm.kinematics.compliance(state, 1e7), (6, 6)),
    "error_jacobian": (lambda state, vector: spm.calibration.error_jacobian(state), (6, 54)),
    "stiffness": (lambda state, vector: spm.stiffness(state, 1e7), (6, 6)),
    "principal_stiffness": (
        lambda state, vector: principal_stiffness(spm.kinematics.compliance(state, 1e7)).translational,
        (3,),
    ),
}


def answers(machine: spm.Geometry, pose: np.ndarray, readings: np.ndarray, vector: np.ndarray) -> dict[str, tuple]:
    """Return what the functions answer, each with its shape for one member."""
    branches, state = spm.inverse_displacement(machine, pose), spm.forward_physical(machine, readings)
    found = {name: (getattr(branches, name), shape) for name, shape in BRANCHES.items()}
    found["complex_middle_joints"] = complex_middle_joints(machine, pose), (8, 3, 3)
    physical = spm.inverse_physical(machine, pose)
    found |= {"physical joints": (physical.middle_joints, (3, 3)), "physical lengths": (physical.leg_lengths, (6,))}
    found |= {"forward joints": (state.middle_joints, (3, 3)), "forward translation": (state.translation, (3,))}
    found |= {name: (call(state, vector), shape) for name, (call, shape) in OF_A_STATE.items()}
    singular = spm.singularities(state)
    found |= {name: (getattr(singular, name), shape) for name, shape in SINGULARITIES.items()}
    if machine.is_nominal:
        modes = spm.forward_displacement(machine, readings)
        found |= {f"mode {name}": (getattr(modes, name), shape) for name, shape in MODES.items()}
    lengths, status = branch_lengths(machine, pose)
    found |= {"lengths alone": (lengths, (8, 6)), "status alone": (status, ())}
    np.testing.assert_array_equal(lengths, branches.leg_lengths)
    np.testing.assert_array_equal(status, branches.status)
    return {name: pair for name, pair in found.items() if pair[0] is not None}


@pytest.mark.parametrize("machine", [PAPER, as_built(PAPER, 1e-3)], ids=["drawn", "as built"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_batch_is_its_members(shape: tuple[int, ...], machine: spm.Geometry) -> None:
    rng, count = np.random.default_rng(1), int(np.prod(shape))
    poses = random_branches(PAPER, "TF", count, seed=6).pose.as_matrix()
    # A degenerate pose, one out of reach, and readings that no mode has.
    poses[1:2] = spm.pose([0, 0, 2], rotation=np.eye(3)).as_matrix()
    poses[3:4] = spm.pose([9, 9, 2], rotation=np.diag([1.0, -1, -1])).as_matrix()
    readings, vector = rng.uniform(1.15, 1.45, (count, 6)), rng.normal(size=(*shape, 6))
    readings[1:2] = [0.3, 1.2, 3.0, 1.2, 1.2, 1.2]
    poses, readings = poses.reshape(*shape, 4, 4), readings.reshape(*shape, 6)
    together = answers(machine, poses, readings, vector)
    for name, (values, inner) in together.items():
        assert np.shape(values) == (*shape, *inner), name
    if count > 3 and machine.is_nominal:
        status = np.ravel(together["status"][0])
        assert list(status[[1, 3]]) == [spm.Status.DEGENERATE, spm.Status.UNREACHABLE]
    for index in np.ndindex(shape):
        for name, (alone, _) in answers(machine, poses[index], readings[index], vector[index]).items():
            values = np.asarray(together[name][0])[index]
            if name in OF_A_STATE or name in SINGULARITIES:
                np.testing.assert_allclose(alone, values, rtol=1e-12, atol=1e-14, err_msg=name)
            else:
                np.testing.assert_array_equal(alone, values, err_msg=name)
    exists = spm.forward_physical(machine, readings).exists
    assert count < 2 or not exists.all()
    for name in (*OF_A_STATE, "determinants", "sigma", "lost_wrench"):
        values, inner = together[name]
        finite = np.isfinite(values) if name != "lost_wrench" else np.isfinite(values) & exists[..., None]
        np.testing.assert_array_equal(finite.all(axis=tuple(range(-len(inner), 0))), exists, err_msg=name)
    assert (np.asarray(together["rank"][0])[~exists] == 0).all()
    assert (np.asarray(together["kind"][0])[~exists] == spm.kinematics.SingularityKind.REGULAR).all()
    assert np.isnan(np.asarray(together["lost_wrench"][0])[~exists]).all()


@pytest.mark.parametrize("machine", [PAPER, as_built(PAPER, 1e-3)], ids=["drawn", "as built"])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_a_batch_of_seeds_is_its_members(shape: tuple[int, ...], machine: spm.Geometry) -> None:
    lengths = np.random.default_rng(2).uniform(1.15, 1.45, (*shape, 6))
    start, target = spm.forward_physical(machine, lengths), lengths[..., ::-1]
    end = spm.forward_physical(machine, target, near=start)
    assert end.shape == shape
    for index in np.ndindex(shape):
        alone = spm.forward_physical(machine, target[index], near=start[index] if shape else start)
        np.testing.assert_allclose(alone.middle_joints, end.middle_joints[index], rtol=0, atol=1e-15)
    home = spm.forward_physical(machine, [1.3] * 6)
    assert spm.forward_physical(machine, target, near=home).shape == shape


@pytest.mark.parametrize("length", [4000, 4001, 4567])
def test_a_large_batch_is_its_parts(length: int) -> None:
    """Kernels fetch the memory of large batches ahead of writing it, beyond the end as well."""
    pose = random_branches(PAPER, "TT", length, seed=8).pose
    whole, lengths = spm.inverse_displacement(PAPER, pose), branch_lengths(PAPER, pose)[0]
    np.testing.assert_array_equal(lengths, whole.leg_lengths)
    readings = np.random.default_rng(3).uniform(1.1, 1.5, (length, 6))
    forward = spm.forward_physical(PAPER, readings)
    for first in range(0, length, 500):
        part = slice(first, min(first + 500, length))
        branches = spm.inverse_displacement(PAPER, pose[part])
        for name in ("middle_joints", "leg_lengths", "discriminants", "exists", "status", "residual"):
            np.testing.assert_array_equal(getattr(branches, name), getattr(whole, name)[part], err_msg=name)
        alone = spm.forward_physical(PAPER, readings[part])
        np.testing.assert_array_equal(alone.middle_joints, forward.middle_joints[part])


@pytest.mark.parametrize("function", [spm.leg_rates, spm.leg_forces])
def test_leading_axes_broadcast(function: object) -> None:
    states = in_leg_space(PAPER, 3, seed=41).configuration
    vectors = np.random.default_rng(5).normal(size=(4, 1, 6))
    found = function(states, vectors)  # type: ignore[operator]
    assert found.shape == (4, 3, 6)
    np.testing.assert_array_equal(found[2, 1], function(states[1], vectors[2, 0]))  # type: ignore[operator]
    with pytest.raises(spm.ArgumentError, match=r"(twist|wrench): expected leading axes that broadcast .* \(3,\)"):
        function(states, np.zeros((2, 6)))  # type: ignore[operator]


def test_one_rough_rotation_is_repaired_and_the_others_keep_their_bits() -> None:
    index = 17
    exact = random_branches(PAPER, "TT", 41, seed=6).pose.as_matrix()
    rough = exact.copy()
    rough[index, :3, :3] = rough[index, :3, :3].astype(np.float32)
    before, after = spm.inverse_displacement(PAPER, exact), spm.inverse_displacement(PAPER, rough)
    others = np.arange(41) != index
    np.testing.assert_array_equal(before.middle_joints[others], after.middle_joints[others])
    alone = spm.inverse_displacement(PAPER, rough[index])
    np.testing.assert_array_equal(alone.middle_joints, after.middle_joints[index])
    assert np.abs(after.rotation[index] @ after.rotation[index][0].T - np.eye(3)).max() < 4 * EPS
    np.testing.assert_array_equal(rough[others], exact[others])


def peak_of(call: Callable[[], object]) -> tuple[object, int]:
    call()
    tracemalloc.start()
    try:
        result = call()
        return result, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.fixture(scope="module")
def many_poses() -> np.ndarray:
    return np.tile(in_leg_space(PAPER, 5_000, seed=7).pose.as_matrix(), (10, 1, 1))


@pytest.mark.parametrize("count", [1, 2])
def test_a_batch_takes_the_memory_of_its_answer(count: int, many_poses: np.ndarray) -> None:
    pose, n = many_poses, len(many_poses)
    with threads(count):
        solutions, peak = peak_of(lambda: spm.inverse_displacement(PAPER, pose))
        assert isinstance(solutions, spm.SolutionSet)
        # b, lengths, discriminants, the pose, the status, the flags; degeneracies are zeros never touched.
        assert peak <= 1.02 * n * 8 * (72 + 48 + 4 + 16 + 4)
        (lengths, _), peak = peak_of(lambda: branch_lengths(PAPER, pose))
        assert peak <= 1.02 * n * 8 * (48 + 3)
        _, peak = peak_of(lambda: spm.forward_physical(PAPER, lengths[:, 0]))
        assert peak <= 1.05 * n * 8 * (9 + 3 + 9 + 6)
        states = solutions.configurations
        matrices, peak = peak_of(lambda: spm.inverse_jacobian(states))
        assert isinstance(matrices, np.ndarray)
        assert peak <= 1.02 * (matrices.nbytes + 8 * n)
