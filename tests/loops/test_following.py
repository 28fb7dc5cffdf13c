"""Forward and inverse of closed chains: judged by small steps, SciPy's least_squares and closed forms."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from error_fields import with_fields
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import least_squares

from spm_pin.errors import ArgumentError, ClosureError
from spm_pin.loops import following
from spm_pin.loops.closed_chain import ClosedChain
from spm_pin.loops.closures import Anchor, JointEquality
from spm_pin.loops.continuation import run
from spm_pin.loops.kernel import Kernel
from spm_pin.loops.state_kinematics import StateKinematics
from spm_pin.loops.tree_kernel import aim, linearised, moved
from spm_pin.support.compiling import ENVIRONMENT
from tests.loops.robots import ROBOTS, ankle, at, closure, delta, five_bar, four_bar, hinge, pose_of, stewart


@pytest.fixture(scope="module", params=ROBOTS)
def chain(request: pytest.FixtureRequest) -> ClosedChain:
    robot: Callable[[], ClosedChain] = ROBOTS[request.param]
    return robot()


def far_targets(chain: ClosedChain, number: int, share: float) -> Any:
    """Return values of the actuated joints up to a share of each joint's unit away."""
    random = np.random.default_rng(7)
    change = random.uniform(-share, share, (number, len(chain.actuated)))
    return chain.q0[chain.actuated_in_q] + change * chain.rows.units[chain.actuated_in_v]


def by_small_steps(chain: ClosedChain, values: Any, steps: int = 200) -> tuple[Any, float]:
    """Return q at the end of a way by small steps of least squares, or where it ends, and the share of the way."""
    tree = chain._follower(None, ()).tree
    aim(tree, chain.q0, values)
    q, none = chain.q0, np.zeros(len(tree.columns))
    for share in np.linspace(0.0, 1.0, steps + 1)[1:].tolist():
        q = moved(tree, q, share, none)
        for _ in range(6):
            c, jacobian, _ = linearised(tree, q, share)
            change = np.asarray(-np.linalg.lstsq(jacobian, c, rcond=None)[0], dtype=np.float64)
            if np.abs(change).max() > 0.2:
                return q, share
            q = moved(tree, q, share, change)
        if np.abs(change).max() > 1e-9:
            return q, share
    return q, 1.0


def test_far_targets_are_reached_in_the_mode_or_not_at_all(chain: ClosedChain) -> None:
    targets, reached = far_targets(chain, 3, 1.0), 0
    for values in targets:
        judged, share = by_small_steps(chain, values)
        if share < 1.0:
            with pytest.raises(ClosureError):
                chain.forward(values, chain.q0)
            continue
        reached += 1
        q = chain.forward(values, chain.q0)
        assert_allclose(pin.difference(chain.model, judged, q), 0.0, atol=1e-8)
        assert np.abs(chain.state(q).gap() / chain.rows.row_units).max() < 1e-14
    assert reached > 0


def test_compiled_and_interpreted_agree(chain: ClosedChain) -> None:
    targets = far_targets(chain, following.FEW + 1, 0.2)
    starts = np.broadcast_to(chain.q0, (len(targets), chain.model.nq))
    chain.compile()
    batch = chain.forward(targets, starts)
    few, interpreted = slice(10), np.empty_like(batch[:10])
    reached, status, *_ = run.interpreted(
        chain._follower(None, ()).tree, np.array(starts[few]), targets[few], False, interpreted
    )
    assert (reached, status) == (10, 0)
    assert_allclose(batch[few], interpreted, atol=1e-13)
    assert_array_equal(batch[..., chain.actuated_in_q], targets)


def test_scipy_finds_the_same(chain: ClosedChain) -> None:
    values = far_targets(chain, 1, 0.05)[0]
    kinematics, driven = StateKinematics(chain), chain.actuated_in_v
    start = chain.q0.copy()
    start[chain.actuated_in_q] = values
    free = np.setdiff1d(np.arange(chain.model.nv), [*driven, *chain.indices_in_v(*chain.held)])

    def errors(x: Any) -> Any:
        v = np.zeros(chain.model.nv)
        v[free] = x
        kinematics.evaluate(pin.integrate(chain.model, start, v))
        return kinematics.residual / kinematics.row_units

    solution = least_squares(errors, np.zeros(len(free)), xtol=1e-15, ftol=1e-15, gtol=1e-15, method="lm")
    v = np.zeros(chain.model.nv)
    v[free] = solution.x
    expected = pin.integrate(chain.model, start, v)
    assert_allclose(pin.difference(chain.model, expected, chain.forward(values, chain.q0)), 0.0, atol=1e-7)


def test_path_goes_on_from_each_member_to_the_next() -> None:
    chain = four_bar()
    turn = chain.q0[0] + np.linspace(0.0, 2.0 * np.pi, 200)[:, None]
    path = chain.forward(turn, chain.q0)
    # The crank turns fully: coupler and rocker come back.
    assert_allclose(path[-1, 1:] - path[0, 1:], [-2.0 * np.pi, 0.0], atol=1e-12)
    assert_allclose(path[0], chain.q0, atol=1e-13)
    # Distances of the joints, of plain machine.
    tip = 0.1 * np.array([np.cos(path[:, 0]), np.sin(path[:, 0])])
    tip += 0.35 * np.array([np.cos(path[:, 0] + path[:, 1]), np.sin(path[:, 0] + path[:, 1])])
    other = np.array([0.3 + 0.25 * np.cos(path[:, 2]), 0.25 * np.sin(path[:, 2])])
    assert_allclose(tip, other, atol=1e-14)


def test_path_ends_before_a_fold() -> None:
    # Ground and coupler are shorter than the rest allows: the crank of a double rocker has ends.
    chain = four_bar(lengths=(0.3, 0.25, 0.15, 0.3))
    cosine = (0.3**2 + 0.25**2 - (0.15 + 0.3) ** 2) / (2 * 0.3 * 0.25)
    end = float(np.arccos(cosine))
    near = chain.forward([end - 1e-6], chain.q0)
    assert near[0] == end - 1e-6
    with pytest.raises(ClosureError, check=with_fields(loop="tip")) as caught:
        chain.forward([end + 1e-3], chain.q0)
    assert "No further" in caught.value.cause


@pytest.mark.parametrize("runner", ["interpreted", "compiled"])
def test_whole_turn_of_a_motor_is_a_long_way(runner: str) -> None:
    # At the end of a whole turn all loops are closed with the other joints where they were.
    turning, arms = four_bar(), delta()
    if runner == "compiled":
        turning.compile()
    for turns in (1.0, -1.0, 2.0):
        for more in (0.0, 1e-9):
            q = turning.forward(turning.q0[:1] + 2.0 * np.pi * turns + more, turning.q0)
            assert_allclose(q - turning.q0, [2.0 * np.pi * turns, -2.0 * np.pi * turns, 0.0], atol=4.0 * more + 1e-12)
        values = arms.q0[arms.actuated_in_q] + [2.0 * np.pi * turns, 0.0, 0.0]
        with pytest.raises(ClosureError, match="No further"):
            arms.forward(values, arms.q0)


def on_random_base(chain: ClosedChain, random: np.random.Generator, distance: float) -> Any:
    """Return joint values with the free base up to a distance away on each axis, turned about z and hardly tilted."""
    q, angle = chain.q0.copy(), random.uniform(-np.pi, np.pi)
    q[:3] = random.uniform(-distance, distance, 3)
    q[3:7] = *random.uniform(-0.2, 0.2, 2), np.sin(0.5 * angle), np.cos(0.5 * angle)
    return pin.normalize(chain.model, q)


def test_free_base_stays() -> None:
    chain, random = ankle(base=True), np.random.default_rng(3)
    values = far_targets(chain, 1, 0.2)[0]
    expected = ankle().forward(values, ankle().q0)
    pose = pose_of(chain.model, chain.forward(values, chain.q0), "foot")
    base = pin.XYZQUATToSE3(chain.q0[:7])
    for _ in range(20):
        q0 = on_random_base(chain, random, 100.0)
        q = chain.forward(values, q0)
        assert_array_equal(q[:7], q0[:7])
        assert_allclose(q[7:], expected, atol=1e-12)
        q = chain.inverse("foot", pin.XYZQUATToSE3(q0[:7]) * base.inverse() * pose, q0, (3, 4))
        assert_array_equal(q[:7], q0[:7])
        assert_allclose(q[7:], expected, atol=1e-11)


@pytest.mark.parametrize("change", [0.0, 1e-13, 1e-9])
@pytest.mark.parametrize("runner", ["interpreted", "compiled"])
def test_targets_that_stay_or_hardly_change(change: float, runner: str) -> None:
    # A controller at rest: all corrections are rounding errors, which are larger far from the origin.
    chain, random = ankle(base=True), np.random.default_rng(4)
    if runner == "compiled":
        chain.compile()
    values = far_targets(chain, 1, 0.2)[0] + np.linspace(0.0, change, 20)[:, None]
    for _ in range(10):
        near = chain.forward(values[0], on_random_base(chain, random, 100.0))
        q = chain.forward(values, near)
        assert_allclose(q[:, chain.actuated_in_q], values, atol=1e-15)
        assert_allclose(q, np.broadcast_to(near, q.shape), atol=1e-13 + 4.0 * change)
        poses = [pose_of(chain.model, each, "foot").homogeneous for each in q]
        again = chain.inverse("foot", poses, near, (3, 4))
        assert_allclose(again, q, atol=1e-11)


@pytest.mark.parametrize("runner", ["interpreted", "compiled"])
def test_machine_of_a_millimetre_ten_metres_from_the_origin(runner: str) -> None:
    """Its loops close to 1e-11 of their lengths only: the rest is rounding, which no step of Newton's makes smaller."""
    large, random = five_bar(), np.random.default_rng(5)
    model = large.model.copy()
    for k in range(1, model.njoints):
        model.jointPlacements[k].translation *= 1e-3
        if not model.parents[k]:
            model.jointPlacements[k].translation += [6.0, -7.0, 4.0]
    loop = closure("point", "left_rod", at(0.3e-3), "right_rod", at(0.3e-3))
    chain = ClosedChain(model, [loop], ["left", "right"], q0=large.q0)
    if runner == "compiled":
        chain.compile()
    q, start = chain.close(), large.q0[large.actuated_in_q]
    for change in 10.0 ** random.uniform(-16, -2, 40):
        values = start + change * random.uniform(-1.0, 1.0, 2)
        for _ in range(3):
            q = chain.forward(values, q)
            assert_allclose(q, large.forward(values, large.q0), atol=1e-10)


def test_inverse_of_a_platform_is_that_of_forward() -> None:
    chain = stewart()
    goal = chain.forward(far_targets(chain, 1, 0.1)[0], chain.q0)
    pose = pose_of(chain.model, goal, "platform")
    for rows in ((0, 1, 2), (2, 3, 4)):
        with pytest.raises(ArgumentError, check=with_fields(argument="rows")):
            chain.inverse("platform", pose, chain.q0, rows)
    q = chain.inverse("platform", pose, chain.q0)
    assert_allclose(pin.difference(chain.model, goal, q), 0.0, atol=1e-12)
    many = chain.inverse("platform", np.broadcast_to(pose.homogeneous, (100, 4, 4)), chain.q0)
    assert_allclose(many, np.broadcast_to(q, many.shape), atol=1e-12)


@pytest.mark.parametrize("is_kept", [True, False])
def test_path_of_many_steps_goes_on_compiled_if_that_is_kept(is_kept: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    chain, kernel, calls = four_bar(), following.run, []
    targets = chain.q0[:1] + 2.0 * np.pi * np.array([[0.5], [1.0]])
    expected = chain.forward(targets, chain.q0)

    def call(*arguments: Any) -> Any:
        calls.append(arguments)
        return kernel.call(*arguments)

    unloaded = SimpleNamespace(is_loaded=False, is_kept=lambda: is_kept, interpreted=kernel.interpreted, call=call)
    monkeypatch.setattr(following, "run", unloaded)
    monkeypatch.setattr(following.Follower, "interpreted_steps", 4)
    monkeypatch.setattr(following.Follower, "is_cache_read", False)
    assert_allclose(chain.forward(targets, chain.q0), expected, atol=1e-12)
    assert len(calls) == is_kept
    assert 0 < following.Follower.interpreted_steps < following.MANY or is_kept
    # Nothing is interpreted a third time.
    monkeypatch.setattr(following.Follower, "interpreted_steps", 1)
    assert_allclose(chain.forward(targets, chain.q0), expected, atol=1e-12)
    assert len(calls) == is_kept + 1
    # The environment forces either.
    monkeypatch.setenv(ENVIRONMENT, "interpreted")
    assert_allclose(chain.forward(targets, chain.q0), expected, atol=1e-12)
    assert len(calls) == is_kept + 1
    monkeypatch.setattr(following.Follower, "interpreted_steps", following.FEW)
    monkeypatch.setenv(ENVIRONMENT, "compiled")
    assert_allclose(chain.forward(targets, chain.q0), expected, atol=1e-12)
    assert len(calls) == is_kept + 2


def test_kernel_is_kept_once_it_is_compiled() -> None:
    four_bar().compile()
    assert following.run.is_kept()
    assert not Kernel(lambda: None, __file__).is_kept()


def test_inverse_of_rows_reaches_those_rows() -> None:
    chain = ankle()
    turn = pin.rpy.rpyToMatrix(0.1, -0.2, 0.3)
    q = chain.inverse("foot", pin.SE3(turn, np.zeros(3)), chain.q0, rows=(3, 4))
    foot = pose_of(chain.model, q, "foot").rotation
    # Its z axis is the target's, and its spin is another.
    assert_allclose(foot[:, 2], turn[:, 2], atol=1e-13)
    assert np.abs(foot - turn).max() > 0.1
    many = chain.inverse("foot", np.tile(pin.SE3(turn, np.zeros(3)).homogeneous, (following.FEW + 1, 1, 1)), q, (3, 4))
    assert_allclose(many, np.broadcast_to(q, many.shape), atol=1e-13)


def test_joint_equality_is_kept() -> None:
    chain = five_bar()
    gear = JointEquality("right", "left", (0.3, -1.0), zero=float(chain.q0[2]) - 0.3, driver_zero=float(chain.q0[0]))
    geared = ClosedChain(chain.model, chain.closures, ["left"], equalities=[gear], q0=chain.q0)
    q = geared.forward([chain.q0[0] + 0.2], chain.q0)
    assert_allclose(q[2], chain.q0[2] - 0.2, atol=1e-14)
    assert_allclose(q, chain.forward(q[[0, 2]], chain.q0), atol=1e-13)


def test_held_joints_stay() -> None:
    chain = five_bar()
    held = ClosedChain(chain.model, chain.closures, ["left"], held=["right"], q0=chain.q0)
    q = held.forward([chain.q0[0] + 0.2], chain.q0)
    assert q[2] == chain.q0[2]
    assert_allclose(q, chain.forward([chain.q0[0] + 0.2, chain.q0[2]], chain.q0), atol=1e-13)


def test_too_few_and_too_many_actuators_are_refused() -> None:
    chain = five_bar()
    few = ClosedChain(chain.model, chain.closures, ["left"], q0=chain.q0)
    with pytest.raises(ArgumentError, check=with_fields(argument="actuated")) as caught:
        few.forward([chain.q0[0] + 0.1], chain.q0)
    assert "right" in caught.value.cause
    many = ClosedChain(chain.model, chain.closures, ["left", "right", "left_rod"], q0=chain.q0)
    with pytest.raises(ArgumentError, check=with_fields(argument="actuated")):
        many.forward(chain.q0[[0, 2, 1]] + [0.1, 0.0, 0.0], chain.q0)
    model = chain.model.copy()
    hinge(model, "right", "tail", at(0.1))
    free = ClosedChain(model, chain.closures, ["left", "right"], q0=np.append(chain.q0, 0.0)[[0, 1, 2, 3, 4]])
    with pytest.raises(ArgumentError) as caught:
        free.forward(chain.q0[[0, 2]], free.q0)
    assert "tail" in caught.value.received


def test_open_start_is_refused() -> None:
    chain = four_bar()
    with pytest.raises(ClosureError, check=with_fields(loop="tip")) as caught:
        chain.forward([chain.q0[0]], chain.q0 + np.array([0.0, 0.1, 0.0]))
    assert caught.value.residual == pytest.approx(0.35 * 2.0 * np.sin(0.05), rel=1e-6)


@pytest.mark.parametrize(("unit", "slides"), [("m", True), ("rad", False)])
def test_open_joint_equality_is_measured_in_its_own_unit(unit: str, slides: bool) -> None:
    model = pin.Model()
    hinge(model, "universe", "wheel", at())
    hinge(model, "universe", "rack", at(), slides=slides)
    chain = ClosedChain(model, (), ["wheel"], equalities=[JointEquality("rack", "wheel", (0.0, 2.0), name="mesh")])
    for call, *arguments in (chain.forward, [0.0], [0.1, 0.1]), (chain.mobility, [0.1, 0.1]):
        with pytest.raises(ClosureError, check=with_fields(residual=pytest.approx(0.1), unit=unit, loop="mesh")):
            call(*arguments)


def test_rows_that_depend_on_each_other_but_for_rounding_are_named() -> None:
    """A planar loop of three equations, one link tilted by 1e-9 about itself: the tip leaves the plane as it turns."""
    flat, model = four_bar("point"), pin.Model()
    angle = flat.q0[2]
    hinge(model, "universe", "crank", at())
    hinge(model, "crank", "coupler", at(0.1))
    hinge(model, "universe", "rocker", at(0.3, turned=(1e-9 * np.cos(angle), 1e-9 * np.sin(angle), 0.0)))
    chain = ClosedChain(model, flat.closures, ["crank"], q0=flat.q0)
    q = chain.close()
    with pytest.raises(ClosureError) as caught:
        chain.forward(q[:1] + 1.0, q)
    assert "contradict" in caught.value.cause
    assert "tip" in caught.value.cause


def test_singular_start_is_said() -> None:
    # A parallelogram folded flat: coupler and rocker may part or not.
    model = pin.Model()
    hinge(model, "universe", "crank", at())
    hinge(model, "crank", "coupler", at(0.1))
    hinge(model, "universe", "rocker", at(0.3))
    flat = ClosedChain(model, [closure("planar", "coupler", at(0.3), "rocker", at(0.1), "tip")], ["crank"])
    with pytest.raises(ClosureError) as caught:
        flat.forward([0.1], flat.q0)
    assert "coupler" in caught.value.cause
    assert caught.value.iterations == 0
    q = flat.forward([1.0], flat.close([0.5, -0.5, 0.5]))
    assert_allclose(q, [1.0, -1.0, 1.0], atol=1e-14)


def test_copies_and_threads_answer_alike() -> None:
    chain = five_bar()
    targets = far_targets(chain, 400, 0.3)
    starts = np.broadcast_to(chain.q0, (len(targets), chain.model.nq))
    expected = chain.forward(targets, starts)
    copy = pickle.loads(pickle.dumps(chain))
    assert_array_equal(copy.forward(targets, starts), expected)
    with ThreadPoolExecutor(4) as pool:
        results = list(pool.map(lambda k: chain.forward(targets[k::4], starts[k::4]), range(4)))
    for k, result in enumerate(results):
        assert_array_equal(result, expected[k::4])
    follower = chain._follower(None, ())
    with ThreadPoolExecutor(1) as pool:
        own, other = follower.tree.fields, pool.submit(lambda: follower.tree.fields).result()
    for name in ("driven_rates", "pose_turn", "pose_share", "drivers"):
        assert own[name] is not other[name]


def test_empty_batches_have_empty_results() -> None:
    chain = five_bar()
    assert chain.forward(np.zeros((0, 2)), chain.q0).shape == (0, 4)
    assert chain.forward(np.zeros((3, 0, 2)), np.zeros((3, 0, 4))).shape == (3, 0, 4)
    chain.compile()
    assert chain.forward(np.zeros((0, 2)), chain.q0).shape == (0, 4)
    passive = ClosedChain(chain.model, chain.closures, [], held=["left", "right"], q0=chain.q0)
    assert_allclose(passive.forward(np.zeros((2, 0)), chain.q0), [chain.q0] * 2, atol=1e-14)


def test_model_is_a_copy() -> None:
    chain = five_bar()
    model = chain.model.copy()
    other = ClosedChain(model, chain.closures, chain.actuated, q0=chain.q0)
    model.addFrame(pin.Frame("late", 1, at(1.0), pin.FrameType.OP_FRAME))
    model.jointPlacements[1] = at(5.0)
    assert not other.model.existFrame("late")
    assert_array_equal(other.forward(chain.q0[[0, 2]], chain.q0), chain.forward(chain.q0[[0, 2]], chain.q0))


def test_wrong_arguments_are_named() -> None:
    chain, pose = five_bar(), pin.SE3.Identity()
    for argument, call, *wrong in (
        *(("values", chain.forward, values, chain.q0) for values in ([0.1], [np.nan, 0.1], ["a", "b"])),
        ("values", chain.forward, np.zeros((3, 2)), np.zeros((2, 4))),
        *(("rows", chain.inverse, "tip", pose, chain.q0, rows) for rows in ((0, 6), 3, None, "x", (True, False))),
        ("frame", chain.inverse, None, pose, chain.q0, (0, 1)),
    ):
        with pytest.raises(ArgumentError, check=with_fields(argument=argument)):
            call(*wrong)
    with pytest.raises(ArgumentError, check=with_fields(argument="frame")) as caught:
        chain.inverse("tap", pose, chain.q0)
    assert "tip" in caught.value.cause
    with pytest.raises(ArgumentError, check=with_fields(argument="closures", index="0")):
        ClosedChain(chain.model, [3], ["left"])  # type: ignore[list-item]
    for closures, equalities in ((3, ()), ((), 3), ((), "a")):
        with pytest.raises(ArgumentError, check=with_fields(argument="equalities" if equalities else "closures")):
            ClosedChain(chain.model, closures, ["left"], equalities=equalities)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, check=with_fields(argument="actuated")) as caught:
        ClosedChain(chain.model, chain.closures, ["lift"])
    assert "left" in caught.value.cause


def test_a_branch_of_a_polynomial_ends_at_its_fold() -> None:
    """Beyond two folds, b = -0.18 and -0.49, the same polynomial has another branch with the target's value."""
    coefficients = (0.0, 0.0272756, 0.110832, 0.141713, 0.0444818)
    model = pin.Model()
    for name in "ab":
        hinge(model, "universe", name, at())
    chain = ClosedChain(model, (), ("a",), equalities=(JointEquality("a", "b", coefficients),))
    polynomial = np.polynomial.Polynomial(coefficients)
    fold = polynomial(max(polynomial.deriv().roots()))
    for compiled in (False, True):
        if compiled:
            chain.compile()
        q = chain.forward([0.99 * fold], near=[0.0, 0.0])
        assert polynomial(q[1]) == pytest.approx(0.99 * fold, abs=1e-14)
        assert -0.19 < q[1] < 0.0
        for target in (1.01 * fold, -0.0272694):
            with pytest.raises(ClosureError):
                chain.forward([target], near=[0.0, 0.0])


def test_numbers_that_describe_no_pose_and_no_polynomial_are_refused() -> None:
    chain, scaled = ankle(), np.eye(4)
    scaled[3] = 1.0, 2.0, 3.0, 4.0
    with pytest.raises(ArgumentError, check=with_fields(argument="pose")):
        chain.inverse("foot", scaled, chain.q0)
    for wrong in ((np.nan, 1.0), 2.0, ("a",)):
        with pytest.raises(ArgumentError, check=with_fields(argument="coefficients")):
            JointEquality(*chain.actuated[:2], wrong)  # type: ignore[arg-type]
    # Pinocchio multiplies an SE3 by a matrix column by column, as points.
    for placement in (np.eye(4), pin.SE3(np.eye(3), np.full(3, np.nan)), pin.SE3(2.0 * np.eye(3), np.zeros(3))):
        with pytest.raises(ArgumentError, check=with_fields(argument="placement")):
            Anchor("foot", placement)
