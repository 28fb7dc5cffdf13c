"""CasADi functions of any machine: values, derivatives, what they are out of reach, and their own C."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from calibrated_oracle import root_near
from error_fields import with_fields
from export.c_library import compile_c, compilers
from export.c_poses import hard_poses, held_states, possible_lengths, spread_poses
from flint import arb, arb_mat, ctx
from kinds_of_legs import PAIRS, machine_of_kinds, states
from oracle import dot
from problems import MANIPULATORS, as_built, conditioning, random_branches

import spm_pin as spm
from spm_pin.description.tree import joint_values
from spm_pin.errors import ArgumentError

PAPER = MANIPULATORS["paper"]
EPS = np.finfo(float).eps


def numbers(function: ca.Function, *arguments: np.ndarray) -> list[np.ndarray]:
    """Call a function; return its outputs as arrays."""
    return [np.asarray(x) for x in function.call([ca.DM(np.asarray(a)) for a in arguments])]


def called(function: ca.Function, *batches: np.ndarray) -> list[np.ndarray]:
    """Map a function over batches (n, ...) of row-major arrays; return its outputs with the batch first."""
    n = len(batches[0])
    columns = [np.moveaxis(x.reshape(n, *x.shape[1:], *([1] * (3 - x.ndim))), 0, 1) for x in batches]
    found = numbers(function.map(n), *(x.reshape(x.shape[0], -1) for x in columns))
    outputs = []
    for i, part in enumerate(found):
        shape = function.size_out(i)
        whole = part.reshape(shape[0], n, shape[1])
        outputs.append(np.moveaxis(whole, 1, 0).reshape(n, *(shape if shape[1] > 1 else shape[:1])))
    return outputs


def as_columns(state: spm.Configuration) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return state.middle_joints, state.rotation, state.translation


@pytest.mark.parametrize("name", MANIPULATORS)
def test_every_branch_has_the_lengths_and_joints_of_the_package(name: str) -> None:
    machine = MANIPULATORS[name]
    for index, label in enumerate(spm.machine.BRANCHES):
        problem = random_branches(machine, label[:2], 300, index)
        expected = spm.inverse_displacement(machine, problem.pose)[label]
        function = spm.casadi.inverse_branch(label, machine)
        rotation = problem.pose.rotation.as_matrix()
        lengths, joints, discriminant, exists = called(function, rotation, problem.pose.translation)
        there = expected.exists
        np.testing.assert_array_equal(exists[:, 0] == 1.0, there)
        np.testing.assert_array_equal(discriminant[:, 0] >= 0.0, there)
        tolerance = 16.0 * EPS * conditioning(expected[there])
        assert (np.abs(lengths - expected.leg_lengths)[there].max(axis=-1) <= tolerance).all()
        assert (np.abs(joints - expected.middle_joints)[there].max(axis=(-1, -2)) <= tolerance).all()


@pytest.mark.parametrize("name", MANIPULATORS)
def test_the_physical_branch_is_that_of_the_package_and_nothing_is_ever_nan(name: str) -> None:
    machine = MANIPULATORS[name]
    parts = [hard_poses(machine, 1000, 2), spread_poses(machine, 1000, 3)]
    held = held_states(machine, 500, 4)
    rotation = np.concatenate([*(part[0] for part in parts), held.rotation])
    position = np.concatenate([*(part[1] for part in parts), held.translation])
    expected = spm.inverse_physical(machine, spm.pose(position, rotation=rotation))
    function = spm.casadi.inverse_physical(machine)
    found = called(function, rotation, position)
    np.testing.assert_array_equal(found[3][:, 0] == 1.0, expected.exists)
    assert 300 < expected.exists.sum() < len(position) - 1000
    assert all(np.isfinite(part).all() for part in found)
    away = np.flatnonzero(expected.exists)
    error = np.abs(found[0] - expected.leg_lengths)[away].max(axis=-1)
    assert (error <= 16.0 * EPS * conditioning(expected[away])).all()
    # Derivatives of first and second order are finite as well, wherever the platform is.
    pose = ca.SX.sym("pose", 12)
    lengths = function(ca.reshape(pose[:9], 3, 3), pose[9:])[0]
    second = ca.hessian(ca.sum1(lengths), pose)[0]
    derivatives = ca.Function("derivatives", [pose], [ca.jacobian(lengths, pose), second])
    columns = np.concatenate([rotation.transpose(0, 2, 1).reshape(-1, 9), position], axis=-1)
    assert all(np.isfinite(part).all() for part in called(derivatives, columns))


def test_symbolic_dimensions_give_what_built_in_ones_give() -> None:
    machine = MANIPULATORS["wide base"]
    state = held_states(machine, 20, 1)[0]
    sizes, pose, parts = machine.dimensions, (state.rotation, state.translation), as_columns(state)
    for make, arguments in (
        (spm.casadi.inverse_physical, pose),
        (spm.casadi.forward_physical, (state.leg_lengths,)),
        (spm.casadi.inverse_jacobian, parts),
        (spm.casadi.leg_forces, (*parts, np.ones(6))),
        (spm.casadi.closure_residual, parts),
    ):
        symbolic = make("symbolic")
        assert symbolic.name_in()[-1] == "dimensions"
        for a, b in zip(numbers(make(machine), *arguments), numbers(symbolic, *arguments, sizes), strict=True):
            np.testing.assert_allclose(b, a, rtol=1e-12, atol=1e-14)
        # Without a machine it is the paper's machine.
        for a, b in zip(numbers(make(PAPER), *arguments), numbers(make(), *arguments), strict=True):
            np.testing.assert_array_equal(a, b)
    assert spm.casadi.inverse_physical().name_in() == ["rotation", "position"]
    assert spm.casadi.inverse_physical().name_out() == ["readings", "joints", "discriminant", "exists"]


@pytest.mark.parametrize("name", MANIPULATORS)
def test_jacobians_forces_and_residuals_are_those_of_the_package(name: str) -> None:
    machine = MANIPULATORS[name]
    state = held_states(machine, 500, 6)
    (matrices,) = called(spm.casadi.inverse_jacobian(machine), *as_columns(state))
    expected = spm.inverse_jacobian(state)
    assert (np.abs(matrices - expected).max(axis=(-1, -2)) <= 1e-12 * np.abs(expected).max(axis=(-1, -2)) ** 2).all()
    wrench = np.random.default_rng(1).normal(size=(len(expected), 6))
    (forces,) = called(spm.casadi.leg_forces(machine), *as_columns(state), wrench)
    known = spm.leg_forces(state, wrench)
    assert (np.abs(forces - known).max(axis=-1) <= 1e-11 * np.abs(known).max(axis=-1)).all()
    (residual,) = called(spm.casadi.closure_residual(machine), *as_columns(state))
    size = np.abs(state.middle_joints).max()
    assert np.abs(residual).max() <= 64 * EPS * size
    moved = state.middle_joints + np.random.default_rng(2).normal(size=state.middle_joints.shape) * 0.01 * size
    (residual,) = called(spm.casadi.closure_residual(machine), moved, state.rotation, state.translation)
    torn = spm.Configuration.from_arrays(machine, state.rotation, state.translation, moved).closure_residual
    np.testing.assert_allclose(np.abs(residual[:, :6]).max(axis=-1) <= torn * (1.0 + 1e-9), True)
    assert np.abs(residual).max() > 1e-3 * size


def rates_along(function: ca.Function, inputs: tuple[np.ndarray, ...], rates: tuple[np.ndarray, ...]) -> list:
    """Return the rates of all outputs, by CasADi's forward mode."""
    return called(function.forward(1), *inputs, *called(function, *inputs), *rates)


def twisted(state: spm.Configuration, seed: int) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Return random twists, and the rates of rotation and position that they make."""
    twist = np.random.default_rng(seed).normal(size=(len(state), 6))
    return twist, (np.cross(twist[:, 3:, None], state.rotation, axis=1), twist[:, :3])


def check_rates(found: np.ndarray, expected: np.ndarray) -> None:
    """Compare states one by one, relative to the largest number of each."""
    error, size = (np.abs(x).reshape(len(x), -1).max(axis=-1) for x in (found - expected, expected))
    assert (error <= 1e-10 * size).all()


def check_joint_rates(machine: spm.Manipulator, state: spm.Configuration, joints: np.ndarray, pose: tuple) -> None:
    """Check that the loops stay closed."""
    (opening,) = rates_along(spm.casadi.closure_residual(machine), as_columns(state), (joints, *pose))
    size = np.abs(joints).reshape(len(joints), -1).max(axis=-1)
    assert (np.abs(opening).max(axis=-1) <= 1e-12 * (1.0 + size)).all()


@pytest.mark.parametrize("name", ["paper", "wide base"])
def test_first_derivatives_at_a_thousand_states_are_velocities_of_the_closed_chain(name: str) -> None:
    machine = MANIPULATORS[name]
    state = held_states(machine, 12_000, 31)
    state = state[np.abs(spm.determinants(state)[..., 2]) > 0.005]
    state = state[np.flatnonzero(np.linalg.cond(spm.inverse_jacobian(state)) < 1000.0)[:1010]]
    forward = spm.casadi.forward_physical(machine)
    # Beside a fold fourteen steps may be too few.
    there = called(forward, state.leg_lengths)[4][:, 0] == 1.0
    assert there.sum() > 1000
    state = state[there]
    twist, pose = twisted(state, 32)
    rotation, position, joints, *_ = rates_along(forward, (state.leg_lengths,), (spm.leg_rates(state, twist),))
    check_rates(rotation, pose[0])
    check_rates(position, pose[1])
    check_joint_rates(machine, state, joints, pose)
    count = 0
    for index, label in enumerate(spm.machine.BRANCHES):
        branch = spm.inverse_displacement(machine, random_branches(machine, label[:2], 600, 40 + index).pose)[label]
        branch = branch[branch.exists]
        branch = branch[np.abs(spm.determinants(branch)[..., 2]) > 0.02]
        twist, pose = twisted(branch, 36 + index)
        lengths, joints, *_ = rates_along(spm.casadi.inverse_branch(label, machine), as_columns(branch)[1:], pose)
        check_rates(lengths, spm.leg_rates(branch, twist))
        check_joint_rates(machine, branch, joints, pose)
        count += len(branch)
    assert count > 1000


@pytest.mark.parametrize("name", MANIPULATORS)
def test_forward_displacement_is_that_of_the_package(name: str) -> None:
    machine = MANIPULATORS[name]
    lengths = possible_lengths(machine, 1000, 7, 0.8)
    expected = spm.forward_physical(machine, lengths)
    rotation, position, joints, _, exists = called(spm.casadi.forward_physical(machine), lengths)
    there = exists[:, 0] == 1.0
    assert not (there & ~expected.exists).any()
    # Beside a fold fourteen steps may be too few.
    assert there.sum() >= 0.98 * expected.exists.sum()
    assert (~expected.exists).sum() > 50
    scale = np.linalg.norm(spm.kinematics.platform_jacobian(expected[np.flatnonzero(there)]), axis=(-1, -2))
    size = np.abs(expected.middle_joints[there]).max()
    assert (np.abs(rotation - expected.rotation)[there].max(axis=(-1, -2)) <= 64 * EPS * scale * (1.0 + size)).all()
    assert (np.abs(position - expected.translation)[there].max(axis=-1) <= 64 * EPS * scale * (1.0 + size)).all()
    assert (np.abs(joints - expected.middle_joints)[there].max(axis=(-1, -2)) <= 64 * EPS * scale * (1.0 + size)).all()


def test_nothing_of_the_forward_displacement_is_nan_where_legs_cannot_be_joined() -> None:
    anywhere = sum(PAPER.dimensions) * np.random.default_rng(3).uniform(0.02, 2.0, (2000, 6))
    found = called(spm.casadi.forward_physical(PAPER), anywhere)
    assert all(np.isfinite(part).all() for part in found)
    np.testing.assert_array_equal(found[4][:, 0] == 1.0, spm.forward_physical(PAPER, anywhere).exists)


def test_the_derivative_of_the_forward_displacement_is_the_inverse_of_that_of_the_inverse() -> None:
    """To second order: the forward displacement after the inverse one is the identity."""
    forward, inverse = spm.casadi.forward_physical(PAPER), spm.casadi.inverse_physical(PAPER)
    q = ca.MX.sym("q", 6)
    rotation, position, *_ = forward(q)
    again = inverse(rotation, position)[0]
    function = ca.Function("both", [q], [ca.jacobian(again, q), ca.jacobian(ca.jacobian(again, q), q)])
    for state in held_states(PAPER, 20, 9):
        if np.abs(spm.determinants(state)[..., 2]) > 0.005:
            first, second = numbers(function, state.leg_lengths)
            np.testing.assert_allclose(first, np.eye(6), rtol=0, atol=1e-9)
            assert np.abs(second).max() < 1e-5


def exact_lengths(state: spm.Configuration, twist: list[float], step: arb) -> list[arb]:
    """Leg lengths with 160 bits, the platform moved by v t and turned by ω t, from the closure equations alone."""
    x, y, z = (step * c for c in twist[3:])
    w = arb_mat([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    before = arb_mat(state.rotation.tolist())
    # To third order; the second derivative needs no more.
    rotation = (before + w * before + w * w * before * arb(0.5)).tolist()
    position = [step * v + o for v, o in zip(twist, state.translation, strict=False)]
    joints = root_near(PAPER, rotation, position, state.middle_joints)
    lengths = []
    for leg, pivot in enumerate(PAPER.legs.pivots.tolist()):
        if leg >= 3:
            pivot = [dot(row, [arb(c) for c in pivot]) + o for row, o in zip(rotation, position, strict=True)]
        along = [b - p for b, p in zip(joints[3 * (leg % 3) :], pivot, strict=False)]
        lengths.append(dot(along, along).sqrt())
    return lengths


def worst_derivatives(count: int) -> tuple[float, float]:
    """Errors of the first two derivatives along a twist, relative to the largest and to the conditioning."""
    function = spm.casadi.inverse_physical(PAPER)
    t, rotation, position, twist = ca.SX.sym("t"), ca.SX.sym("R", 3, 3), ca.SX.sym("o", 3), ca.SX.sym("twist", 6)
    w = ca.skew(twist[3:])
    turned = (ca.SX.eye(3) + t * w + t * t / 2 * w @ w) @ rotation
    lengths = function(turned, position + t * twist[:3])[0]
    first = ca.jacobian(lengths, t)
    found = ca.substitute([first, ca.jacobian(first, t)], [t], [ca.SX(0)])
    derivatives = ca.Function("derivatives", [rotation, position, twist], found)
    states = held_states(PAPER, 4 * count, 12)
    states = states[np.flatnonzero(np.abs(spm.determinants(states)[..., 2]) > 0.005)[:count]]
    rng, worst = np.random.default_rng(13), [0.0, 0.0]
    assert len(states.exists) == count
    ctx.prec = 160
    h = arb(2) ** -40
    for state, condition in zip(states, conditioning(states), strict=True):
        along = rng.normal(size=6).tolist()
        rate, curvature = (x[:, 0] for x in numbers(derivatives, state.rotation, state.translation, along))
        behind, here, ahead = (exact_lengths(state, along, k * h) for k in (-1, 0, 1))
        slope = np.array([float((a - b) / (2 * h)) for a, b in zip(ahead, behind, strict=True)])
        bend = np.array([float((a - 2 * m + b) / h**2) for a, m, b in zip(ahead, here, behind, strict=True)])
        worst[0] = max(worst[0], np.abs(rate - slope).max() / (np.abs(slope).max() * condition))
        worst[1] = max(worst[1], np.abs(curvature - bend).max() / (np.abs(bend).max() * condition))
    return worst[0], worst[1]


@pytest.mark.parametrize("count", [20, pytest.param(300, marks=pytest.mark.slow)])
def test_derivatives_agree_with_forty_digits_from_the_closure_equations(count: int) -> None:
    first, second = worst_derivatives(count)
    assert first < 1e-13
    assert second < 1e-12


@pytest.mark.slow
def test_c_code_of_the_derivatives_compiles_and_computes_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    state = spm.forward_physical(PAPER, [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    generator = ca.CodeGenerator("generated.c")
    parts = as_columns(state)
    functions = {
        "inverse_physical": (spm.casadi.inverse_physical(), parts[1:]),
        "forward_physical": (spm.casadi.forward_physical(), (state.leg_lengths,)),
        "leg_forces": (spm.casadi.leg_forces(), (*parts, np.ones(6))),
        "inverse_jacobian": (spm.casadi.inverse_jacobian(), parts),
    }
    derivatives = {name: (f.jacobian(), arguments) for name, (f, arguments) in functions.items()}
    for function, _ in derivatives.values():
        generator.add(function)
    generator.generate()
    compile_c(compilers()[0], "-shared", "-fPIC", "-O1", "generated.c", "-lm", "-o", "generated.so")
    for name, (function, arguments) in derivatives.items():
        outputs = [np.zeros(functions[name][0].size_out(i)) for i in range(functions[name][0].n_out())]
        compiled = ca.external(function.name(), "./generated.so")
        expected, found = (numbers(f, *arguments, *outputs) for f in (function, compiled))
        for a, b in zip(expected, found, strict=True):
            np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-11)


def with_nan(numbers: np.ndarray, index: int) -> np.ndarray:
    """The numbers, one of them NaN."""
    found = np.array(numbers, dtype=float)
    found.flat[index] = np.nan
    return found


def test_nothing_exists_for_what_is_no_pose_and_no_machine() -> None:
    state = spm.forward_physical(PAPER, [1.20, 1.20, 1.40, 1.25, 1.20, 1.50])
    rotation, position, sizes = state.rotation, state.translation, np.array(PAPER.dimensions)
    wrong = [
        *((scale * rotation, position) for scale in (2.0, 1.01, 1.0 + 1e-6, 0.0, -1.0)),
        (rotation * [1, 1, -1], position),
        *((with_nan(rotation, k), position) for k in range(9)),
        *((rotation, with_nan(position, k)) for k in range(3)),
        (rotation, np.inf * position),
    ]
    bad_sizes = [np.array([-1.0, 0.3, 0.8]), 0.0 * sizes, np.inf * sizes, *(with_nan(sizes, k) for k in range(3))]
    for function in (spm.casadi.inverse_physical("symbolic"), spm.casadi.inverse_branch("TT+", "symbolic")):
        assert numbers(function, rotation, position, sizes)[3] == 1.0
        assert numbers(function, rotation * (1.0 + 1e-8), position, sizes)[3] == 1.0
        for pose in wrong:
            assert numbers(function, *pose, sizes)[3] == 0.0
        for bad in bad_sizes:
            assert numbers(function, rotation, position, bad)[3] == 0.0
    forward, lengths = spm.casadi.forward_physical("symbolic"), state.leg_lengths
    assert numbers(forward, lengths, sizes)[4] == 1.0
    for q in (-lengths, lengths * [1, 1, -1, 1, 1, 1], np.inf * lengths, *(with_nan(lengths, k) for k in range(6))):
        assert numbers(forward, q, sizes)[4] == 0.0
    for bad in (*bad_sizes, sizes * [1, 1, -1]):
        assert numbers(forward, lengths, bad)[4] == 0.0


def test_bad_arguments_are_clear_errors() -> None:
    with pytest.raises(ArgumentError, check=with_fields(argument="branch")):
        spm.casadi.inverse_branch("TX")
    with pytest.raises(ArgumentError, check=with_fields(argument="machine")):
        spm.casadi.leg_forces(3)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, check=with_fields(argument="machine")):
        spm.casadi.inverse_branch("TT+", PAPER.perturbed(1))


@pytest.mark.parametrize("size", [1e-5, 1e-3])
def test_functions_of_a_machine_as_built_are_those_of_the_package(size: float) -> None:
    """Its numbers built in, and as 54 parameters."""
    built = as_built(PAPER, size, 4)
    state = spm.forward_physical(built, np.random.default_rng(1).uniform(1.1, 1.5, (100, 6)))
    expected, wrench = spm.inverse_physical(built, state.pose), np.ones((100, 6))
    values = np.array([list(joint_values(one).values()) for one in state])
    near = as_columns(state)
    for parameters in (False, True):
        further = [np.tile(built.parameters, (100, 1))] if parameters else []
        machine = PAPER if parameters else built

        def of(name: str, *arguments: np.ndarray, machine=machine, further=further, **options: bool) -> list:
            function = getattr(spm.casadi, name)(machine, parameters=bool(further), **options)
            return called(function, *arguments, *further)

        moved = spm.forward_physical(built, state.readings + 1e-3)
        for found, known in (
            (of("forward_physical", state.readings), state),
            (of("forward_physical", moved.readings, *near, near=True), moved),
        ):
            assert found[4].all()
            for value, exact in zip(found, (known.rotation, known.translation, known.middle_joints), strict=False):
                np.testing.assert_allclose(value, exact, rtol=0, atol=1e-12)
        lengths, _, _, exists = of("inverse_physical", *near[1:])
        assert exists.all()
        error = np.abs(lengths - expected.readings).max(axis=-1)
        assert (error <= 1e-12 + 64.0 * EPS * conditioning(expected)).all()
        np.testing.assert_allclose(of("joint_values", *near)[0], values, rtol=0, atol=1e-12)
        jacobians = spm.inverse_jacobian(state)
        scale = np.abs(jacobians).max(axis=(-1, -2))
        assert (np.abs(of("inverse_jacobian", *near)[0] - jacobians).max(axis=(-1, -2)) <= 1e-13 * scale**2).all()
        np.testing.assert_allclose(of("leg_forces", *near, wrench)[0], spm.leg_forces(state, wrench), rtol=1e-9)
        np.testing.assert_allclose(of("closure_residual", *near)[0], 0.0, rtol=0, atol=1e-14)


def test_derivatives_by_the_54_parameters_are_differences() -> None:
    machine = as_built(PAPER, 1e-3, 4)
    state, parameters = spm.forward_physical(machine, [1.2, 1.2, 1.4, 1.25, 1.2, 1.5]), ca.MX.sym("p", 54)
    inverse = spm.casadi.inverse_physical(PAPER, parameters=True)
    readings = inverse(state.rotation, state.translation, parameters)[0]
    slope = ca.Function("slope", [parameters], [ca.jacobian(readings, parameters)])
    here, found = machine.parameters, np.asarray(slope(machine.parameters))
    for k, step in enumerate(1e-6 * np.eye(54)):
        ends = [spm.inverse_physical(PAPER.from_parameters(here + s), state.pose).readings for s in (step, -step)]
        np.testing.assert_allclose(found[:, k], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("built", [False, True])
@pytest.mark.parametrize(("lower", "upper"), PAIRS)
def test_legs_of_any_kind_are_those_of_the_package(lower: str, upper: str, built: bool) -> None:
    machine = machine_of_kinds(lower, upper, built=built)
    state, wrench = states(machine), np.ones(6)
    arrays, pose = as_columns(state), (state.rotation, state.translation)
    rates = spm.inverse_jacobian(state)
    for parameters in (False, True):
        further = [np.tile(machine.parameters, (len(state), 1))] if parameters else []

        def of(name: str, *arguments: np.ndarray, further=further, **options: bool) -> list:
            function = getattr(spm.casadi, name)(machine, parameters=bool(further), **options)
            return called(function, *arguments, *further)

        for found in (
            of("forward_physical", state.readings),
            of("forward_physical", state.readings, *arrays, near=True),
        ):
            assert found[4].all()
            np.testing.assert_allclose(found[1], state.translation, rtol=0, atol=1e-12)
        readings, _, _, exists = of("inverse_physical", *pose)
        expected = spm.inverse_physical(machine, state.pose)
        assert exists.all()
        # With errors of a hundredth another root may be passed over.
        assert (np.abs(readings - expected.readings).max(axis=-1) < 1e-11).mean() > (0.97 if built else 0.999)
        (found,) = of("inverse_jacobian", *arrays)
        np.testing.assert_allclose(found, rates, rtol=0, atol=1e-11 * np.abs(rates).max())
        (forces,) = of("leg_forces", *arrays, np.tile(wrench, (len(state), 1)))
        np.testing.assert_allclose(forces, spm.leg_forces(state, wrench), rtol=0, atol=1e-11 * np.abs(forces).max())
        up = state.translation + np.array([0.0, 0.0, 9.0])
        out_of_reach = of("inverse_physical", state.rotation, up)
        # Cylinders may be as long as that; slides lead outwards, and cranks have an end.
        assert lower == "RPS" or not out_of_reach[3].any()
        assert all(np.isfinite(x).all() for x in out_of_reach)


@pytest.mark.parametrize("built", [False, True])
def test_derivatives_by_the_numbers_of_servos_and_screws_are_differences(built: bool) -> None:
    machine = machine_of_kinds("RRS", "PRS", built=built)
    state, parameters = states(machine)[0], ca.MX.sym("p", 66)
    readings = spm.casadi.inverse_physical(machine, parameters=True)(state.rotation, state.translation, parameters)[0]
    slope = ca.Function("slope", [parameters], [ca.jacobian(readings, parameters)])
    here = machine.parameters
    found = np.asarray(slope(here))
    for k in range(8, 66, 2):
        step = 1e-6 * (np.arange(66) == k)
        ends = [spm.inverse_physical(machine.from_parameters(here + s), state.pose).readings for s in (step, -step)]
        np.testing.assert_allclose(found[:, k], (ends[0] - ends[1]) / 2e-6, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("size", [0.0, 3e-3])
def test_gravity_is_that_of_the_closed_chain(size: float) -> None:
    machine = PAPER if size == 0.0 else as_built(PAPER, size)
    chain, bodies = spm.ClosedChain.from_urdf(machine=machine), spm.casadi.bodies(machine)
    state = held_states(machine, 20, 5)
    arrays = as_columns(state)
    weights = (np.tile(x, (len(state.translation), 1)) for x in (bodies, [7.0, 0.1, -0.2, 0.3], [0.0, 0.0, -9.81]))
    (forces,) = called(spm.casadi.gravity(machine), *arrays, *weights)
    q, rest = chain.forward_kinematics(state.readings), np.zeros((len(forces), 18))
    payload = np.tile([0.0, 0.0, -7.0 * 9.81, 0.0, 0.0, 0.0], (len(forces), 1))
    payload[:, 3:] = np.cross(state.rotation @ [0.1, -0.2, 0.3], payload[:, :3])
    np.testing.assert_allclose(forces, chain.state(q, rest).inverse_dynamics(rest, payload), rtol=0, atol=1e-8)
