"""Every peer of the benchmarks gives the right answer; their speed is not tested."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial.transform import RigidTransform

import spm_pin as spm

sys.path.append(str(Path(__file__).parents[1]))

from benchmarks.peers import arms, exported, peers_by_task
from benchmarks.peers.certified import real_coordinates
from benchmarks.peers.compiled import compiler_version
from benchmarks.peers.lines import coordinates
from benchmarks.peers.operations import count_operations
from benchmarks.peers.package import kernel, lengths_only
from benchmarks.peers.peer import Peer, Prepared, Unavailable, required
from benchmarks.poses import KINDS, MACHINE, as_built, leg_space, mixture
from benchmarks.report import Facts
from benchmarks.sections.completeness import tally
from benchmarks.sections.preparation import prepare_peers
from benchmarks.sections.states import _BALANCER, balls_by_scipy
from benchmarks.sections.velocity import states
from benchmarks.targets import TARGETS, check
from benchmarks.timing import Pace, Spread, TimedCall, Timing, time_in_turns

pytestmark = pytest.mark.documents

ROOT = Path(__file__).parents[1]
# Poses whose branches are well apart: searches find all of them, and the octic keeps half its digits.
POSES = leg_space(4)
SIDE = MACHINE.middle_side

needs_compiler = pytest.mark.skipif(compiler_version() == "none", reason="no C compiler")


def needs(peer: Peer) -> object:
    compiled = peer.name.startswith("C loop") or peer.name.endswith("compiled")
    return pytest.param(peer, id=peer.name, marks=needs_compiler if compiled else ())


def answer(prepared: Prepared) -> npt.NDArray[np.float64] | list[npt.NDArray[np.float64]]:
    return prepared.read(prepared.call())


def rounded(poses: RigidTransform, peer_name: str) -> tuple[RigidTransform, int]:
    """Return the poses for gp3p many times each, moved by about a rounding, and how often; others once.

    gp3p loses half of its digits, or a root, at up to a fifth of all roundings of a pose. What it finds at most of them
    is what is tested: one answer alone depends on how its compiler orders sums, and on where memory begins.
    """
    if not peer_name.startswith("poselib"):
        return poses, 1
    copies, rng = 15, np.random.default_rng(1)
    matrices = np.repeat(poses.as_matrix(), copies, axis=0)
    matrices[:, :3, 3] *= 1.0 + np.finfo(float).eps * rng.integers(-1, 2, (len(matrices), 3))
    return RigidTransform.from_matrix(matrices), copies


def median_coordinates(
    machine: spm.Manipulator, poses: RigidTransform, found: list[npt.NDArray[np.float64]], copies: int
) -> list[npt.NDArray[np.float64]]:
    along = coordinates(machine, poses, found)
    return [np.median(along[k : k + copies], axis=0) for k in range(0, len(along), copies)]


def certified() -> list[npt.NDArray[np.float64]]:
    poses = zip(POSES.rotation.as_quat(), POSES.translation, strict=True)
    found = [real_coordinates(quaternion, position, SIDE) for quaternion, position in poses]
    return [roots for roots in found if roots is not None]


@needs_compiler
def test_every_call_of_the_exported_functions_is_timed_and_finds_an_answer() -> None:
    seconds, failed = exported.call_times(spm.inverse_physical(MACHINE, POSES), 1e-4, 100)
    assert failed == [0] * len(exported.CALLS)
    assert seconds.shape == (len(exported.CALLS), 100)
    assert (seconds >= 0.0).all()
    assert (seconds[1:].sum(axis=-1) > 0.0).all()


@pytest.mark.parametrize("peer", [needs(peer) for peer in peers_by_task.INVERSE])
def test_every_peer_finds_the_certified_branches_which_close(peer: Peer) -> None:
    poses, copies = rounded(POSES if peer.items > 1 else POSES[:1], peer.name)
    found = list(answer(peer.prepare((MACHINE, poses))))
    # What the double roots of the octic leave of its digits.
    tolerance = 1e-3 if "roots" in peer.name or "companion" in peer.name else 1e-8
    truth = certified()
    assert len(truth) == len(POSES)
    for k, along in enumerate(median_coordinates(MACHINE, poses, found, copies)):
        np.testing.assert_allclose(along, truth[k], atol=tolerance * SIDE, rtol=0.0)
    residuals = []
    for joints in found[:copies]:
        whole = joints[~np.isnan(joints).any(axis=(-1, -2))]
        assert len(whole) or "roots" in peer.name or peer.name in ("companion matrices", "python-flint")
        residuals.append(spm.Configuration(MACHINE, POSES[0], whole).closure_residual.max(initial=0.0))
    assert np.median(residuals) < 1e-7 * SIDE


@pytest.mark.parametrize("size", [1e-4, 1e-3])
def test_peers_find_the_branches_of_a_machine_as_built(size: float) -> None:
    machine = as_built(size)
    ours = spm.inverse_displacement(machine, POSES)
    all_branches, physical_branch, gp3p = peers_by_task.AS_BUILT
    branches, physical = (answer(package.prepare((machine, POSES))) for package in (all_branches, physical_branch))
    poses, copies = rounded(POSES, gp3p.name)
    found = median_coordinates(machine, poses, list(answer(gp3p.prepare((machine, poses)))), copies)
    # Our own search for all roots, of six separate planes, and the peer's, of three lines.
    for mine, theirs in zip(coordinates(machine, POSES, branches), found, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-8 * SIDE, rtol=0.0)
    assert [len(joints) for joints in branches] == ours.count.tolist()
    for joints, state in zip(physical, ours.physical(), strict=True):
        np.testing.assert_allclose(joints[0], state.middle_joints, atol=1e-12)


@needs_compiler
@pytest.mark.parametrize("kind", KINDS)
def test_the_c_loop_agrees_with_the_package(kind: str) -> None:
    from benchmarks.peers.c_loop import answered

    poses = mixture(kind, 200, seed=3)
    arrays = answered((MACHINE, poses)).call()
    ours = spm.inverse_displacement(MACHINE, poses)
    np.testing.assert_array_equal(arrays.status, ours.status)
    np.testing.assert_array_equal(np.isnan(arrays.joints), np.isnan(ours.middle_joints))
    # Near a fold and near the level, rounding of the pose is magnified by its inverse, or its root.
    tolerance = 1e-9 if kind in KINDS[:2] else 1e-5
    np.testing.assert_allclose(arrays.joints, ours.middle_joints, atol=tolerance * SIDE, rtol=0.0)
    real = ours.exists
    derived = spm.Configuration(MACHINE, poses[np.nonzero(real)[0]], arrays.joints[real])
    np.testing.assert_allclose(arrays.lengths[real], derived.leg_lengths, rtol=1e-13)
    assert (derived.closure_residual <= 1e-12).all()


def test_kernel_alone_equals_the_public_function() -> None:
    ours = spm.inverse_displacement(MACHINE, POSES)
    for k, found in enumerate(answer(kernel((MACHINE, POSES)))):
        np.testing.assert_array_equal(found, ours.middle_joints[k][ours.exists[k]])
    np.testing.assert_array_equal(answer(lengths_only((MACHINE, POSES))), ours.leg_lengths)


@pytest.mark.parametrize("arm", arms.ARMS)
def test_branches_of_serial_arms_have_the_given_pose(arm: str) -> None:
    angles = np.random.default_rng(0).uniform(-np.pi, np.pi, (5, 6))
    poses = arms.poses_of(arm, angles)
    for k, found in enumerate(answer(arms.solve((arm, poses)))):
        np.testing.assert_allclose(arms.poses_of(arm, found), np.broadcast_to(poses[k], (len(found), 4, 4)), atol=1e-9)
        turned = np.abs((found - angles[k] + np.pi) % (2 * np.pi) - np.pi).max(axis=-1)
        assert turned.min() < 1e-8


@pytest.mark.parametrize("peer", peers_by_task.JACOBIAN, ids=lambda peer: peer.name)
def test_every_jacobian_equals_that_of_the_9_by_9(peer: Peer) -> None:
    from spm_pin.crosscheck.paper.jacobian import J_f

    configuration = states(6)
    assert configuration.exists.all()
    np.testing.assert_allclose(answer(peer.prepare(configuration)), J_f(configuration), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("peer", peers_by_task.FORCES, ids=lambda peer: peer.name)
def test_power_of_leg_forces_equals_that_of_the_wrench(peer: Peer) -> None:
    configuration = states(6)
    wrenches = np.random.default_rng(1).uniform(-1.0, 1.0, (6, 6))
    forces = answer(peer.prepare((configuration, wrenches)))
    # Along any rates of the legs: f · rates + w · twist = 0.
    twists = spm.kinematics.platform_jacobian(configuration)
    np.testing.assert_allclose(forces, -np.einsum("nij,ni->nj", twists, wrenches), rtol=1e-8, atol=1e-8)


def test_plain_pinocchio_has_the_dynamics_of_the_chain() -> None:
    from benchmarks.peers.one_state import PlainPinocchio

    chain = spm.ClosedChain.from_urdf()
    plain = PlainPinocchio(chain)
    for q in chain.joint_values(spm.inverse_physical(MACHINE, POSES)):
        v = chain.state(q).joint_velocities([0.1, -0.2, 0.1, 0.2, 0.1, -0.1])
        a = chain.state(q, v).joint_accelerations([1.0, 0.5, -0.5, 0.2, 0.3, 0.1])
        forces = chain.state(q, v).inverse_dynamics(a)
        np.testing.assert_allclose(plain.inverse(q, v, a), forces, rtol=1e-9)
        np.testing.assert_allclose(plain.forward(q, v, forces), a, atol=1e-8)


def test_a_control_tick_lets_the_platform_move_on_evenly() -> None:
    from benchmarks.sections.jobs import tick, walk

    chain = spm.ClosedChain.from_urdf()
    lengths = walk(2)
    rates = (lengths[1] - lengths[0]) / 1e-3
    forces = tick(chain)(lengths[0], rates)
    q = chain.forward_kinematics(lengths[0])
    v = chain.state(q).joint_rates(rates)
    a = chain.state(q, v).forward_dynamics(forces)
    np.testing.assert_allclose(a, chain.state(q, v).joint_accelerations(np.zeros(6)), atol=1e-7)


def test_ticks_end_in_the_same_numbers() -> None:
    from benchmarks.peers import exported
    from benchmarks.sections.controller import ticks_by_chain, ticks_by_package
    from benchmarks.sections.jobs import walk

    readings, wrench = walk(5), np.array([30.0, -20.0, -500.0, 4.0, -6.0, 8.0])
    chain, start = spm.ClosedChain.from_urdf(), spm.forward_physical(MACHINE, readings[:1])
    calls = [ticks_by_package(readings, wrench), ticks_by_chain(chain, readings, wrench)]
    calls += [exported.ticks(start, readings, wrench)] if compiler_version() != "none" else []
    last = spm.forward_physical(MACHINE, readings[-1])
    for call in calls:
        jacobian, forces = call()
        np.testing.assert_allclose(jacobian, spm.inverse_jacobian(last), rtol=0, atol=1e-9)
        np.testing.assert_allclose(forces, spm.leg_forces(last, wrench), rtol=0, atol=1e-6)


def test_metrics_by_numpy_are_those_of_sweeps() -> None:
    pytest.importorskip("xarray")
    from benchmarks.sections.jobs import METRICS, box, metrics_by_numpy

    drawn = np.random.default_rng(0).uniform(*np.transpose(box()), (500, 6))
    poses = spm.pose(drawn[:, :3], xyx=drawn[:, 3:])
    points = spm.sweeps.Points(MACHINE, "pose", drawn)
    found = metrics_by_numpy(poses)
    assert found[0].any()
    for name, values in zip(METRICS, found, strict=True):
        np.testing.assert_allclose(values, spm.sweeps.METRICS[name].evaluate(points), rtol=1e-9, err_msg=name)


def test_singular_values_by_numpy_are_those_of_the_package() -> None:
    from benchmarks.sections.states import by_numpy

    configuration = states(6)
    forward, inverse = by_numpy(configuration)
    smallest = np.concatenate([forward[..., -1], inverse[..., -1]], axis=-1)
    np.testing.assert_allclose(spm.singularities(configuration).sigma, smallest, atol=1e-14)


LENGTHS = np.random.default_rng(1).uniform(1.1, 1.5, (3, 6))


@pytest.mark.parametrize("peer", peers_by_task.PHYSICAL, ids=lambda peer: peer.name)
def test_every_forward_solution_has_the_leg_lengths_and_is_the_physical_one(peer: Peer) -> None:
    joints = answer(peer.prepare((MACHINE, LENGTHS)))
    lower = np.linalg.norm(joints - MACHINE.base_joints, axis=-1)
    np.testing.assert_allclose(lower, LENGTHS[:, :3], rtol=1e-9)
    sides = np.linalg.norm(joints - np.roll(joints, 1, axis=-2), axis=-1)
    np.testing.assert_allclose(sides, SIDE, rtol=1e-9)
    np.testing.assert_allclose(joints, spm.forward_physical(MACHINE, LENGTHS).middle_joints, atol=1e-8)


@pytest.mark.parametrize("peer", peers_by_task.MODES, ids=lambda peer: peer.name)
def test_the_number_of_assembly_modes(peer: Peer) -> None:
    from stage_oracle import certified_modes

    lengths = LENGTHS[: 1 if peer.items < 10 else 3]
    truth = [
        (certified_modes(legs[:3], MACHINE.base_radius, SIDE) or 0)
        * (certified_modes(legs[3:], MACHINE.platform_radius, SIDE) or 0)
        for legs in lengths
    ]
    found = answer(peer.prepare((MACHINE, lengths)))
    if peer.name == "SciPy multi-start":  # it may miss some, and never finds more
        assert all(0 < number <= most for number, most in zip(found, truth, strict=True))
    else:
        np.testing.assert_array_equal(found, truth)


@pytest.mark.skipif(compiler_version("c++") == "none", reason="no C++ compiler")
def test_operations_are_counted() -> None:
    counted, same = (count_operations(MACHINE, POSES[k : k + 1]) for k in (0, 0))
    assert counted == same
    # A branch takes seven, for six lengths and a norm; a family and a pose a few more.
    branches = int(spm.inverse_displacement(MACHINE, POSES[0]).count)
    assert 7 * branches < counted.square_roots < 12 * branches + 20
    assert 0 < counted.divisions < counted.square_roots
    assert counted.additions < counted.multiplications < 200 * branches


def test_a_missing_peer_is_listed_with_its_reason() -> None:
    def absent(problem: object) -> Prepared:
        required("no_such_module", "no-such-package")
        raise AssertionError

    def broken(problem: object) -> Prepared:
        raise TypeError("its signature has changed")

    peers = [Peer("absent", "", absent, 1), Peer("broken", "", broken, 1)]
    peers = prepare_peers(peers, lambda n: n, Pace(1, 0.0), str)
    assert not peers.timed_calls
    assert "no-such-package is not installed" in peers.missing["absent"]
    assert "its signature has changed" in peers.missing["broken"]
    with pytest.raises(TypeError):
        prepare_peers([Peer(peers_by_task.OURS, "", broken, 1)], lambda n: n, Pace(1, 0.0), str)
    with pytest.raises(Unavailable):
        absent(None)


def test_calls_are_timed_in_turns() -> None:
    order: list[str] = []
    pair = [TimedCall(name, lambda name=name: order.append(name), 2) for name in "ab"]
    timings = time_in_turns(pair, Pace(4, 0.0), str)
    # Once to warm up, then each round begun by another one.
    assert "".join(order)[:2] == "ab"
    assert "".join(order)[-8:] == "abbaabba"
    assert all(timing.seconds.shape == (4,) and (timing.seconds > 0.0).all() for timing in timings.values())


def test_ratios_are_taken_within_rounds() -> None:
    slow, fast = Timing(np.array([2.0, 20.0, 6.0])), Timing(np.array([1.0, 10.0, 3.0]))
    assert slow.over(fast) == Spread(2.0, 2.0, 2.0)
    assert slow.spread == Spread(6.0, 4.0, 13.0)


def test_branches_are_matched_one_to_one() -> None:
    truth = [np.array([0.0, 1e-6, 0.5]), np.array([])]
    assert tally(truth, [truth[0], truth[1]], 1.0).found == 3
    merged = tally(truth, [np.array([5e-7, 0.5]), np.array([0.1])], 1.0)
    assert (merged.certified, merged.found, merged.spurious) == (3, 2, 1)
    assert tally(truth, [np.array([0.2]), np.array([])], 1.0).spurious == 1


def test_targets_say_what_was_missed_and_what_was_not_measured() -> None:
    facts = Facts({"inverse/gp3p bare": Spread(30.0, 29.0, 31.0), "inverse/C loop": Spread(3.0, 2.0, 4.0)})
    text = check(facts).markdown
    lines = {line.split(" | ")[0]: line for line in text.splitlines()}
    assert "| met |" in lines["| inverse displacement: poselib.gp3p, bare / spm_pin"]
    assert "**missed**" in lines["| inverse displacement: spm_pin / C loop"]
    assert "not measured" in lines["| J_f: NumPy 9 × 9 / spm_pin"]
    assert len(text.splitlines()) == 4 + len(TARGETS)


@pytest.mark.parametrize("kind", KINDS)
def test_poses_are_of_their_kind(kind: str) -> None:
    poses = mixture(kind, 9, seed=5)
    assert poses.shape == (9,)
    found = spm.inverse_displacement(MACHINE, poses)
    tilt = np.arccos(np.clip(poses.as_matrix()[:, 2, 2], -1.0, 1.0))
    if kind == "nearly level":
        assert (tilt < 0.011).all()
    else:
        assert (tilt > 0.001).all()
        assert (np.abs(found.discriminants).min(axis=-1) < 1e-5).all() == (kind == "near a fold")
    with pytest.raises(ValueError, match="kind"):
        mixture("no such kind", 1)


def test_script_runs_one_part_and_writes_only_the_given_file(tmp_path: Path) -> None:
    results = ROOT / "benchmarks" / "results.md"
    before = results.read_bytes() if results.exists() else None
    out = tmp_path / "out.md"
    command = [sys.executable, str(ROOT / "benchmarks" / "run.py"), "--quick", "--only", "velocity", "--out", str(out)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    text = out.read_text(encoding="utf-8")
    assert text in done.stdout
    for peer in (*peers_by_task.JACOBIAN, *peers_by_task.FORCES):
        assert f"| {peer.name} | {peer.computes} |" in text
    assert "missing" not in text
    assert (results.read_bytes() if results.exists() else None) == before


def test_pycapacity_is_given_the_same_polytopes() -> None:
    pytest.importorskip("pycapacity")
    from benchmarks.sections import capability

    states = spm.forward_physical(MACHINE, np.random.default_rng(0).uniform(1.15, 1.45, (3, 6)))
    held = spm.capability.wrench_polytope(states, capability.LIMIT)
    jacobians, inverses = spm.inverse_jacobian(states), spm.kinematics.platform_jacobian(states)
    balls = [capability.facets_by_pycapacity(jacobian) for jacobian in jacobians]
    np.testing.assert_allclose(held.ball(), balls, rtol=1e-9)
    for vertices, inverse in zip(held.vertices, inverses, strict=True):
        found = capability.vertices_by_pycapacity(inverse).T
        np.testing.assert_allclose(found.max(axis=0), vertices.max(axis=0), rtol=1e-9)


def test_scipy_finds_the_balls_of_the_balancer() -> None:
    states = spm.inverse_physical(_BALANCER, np.linspace(0.11, 0.13, 5), tilt=0.2, azimuth=0.3)
    np.testing.assert_allclose(balls_by_scipy(states.readings), states.balls, atol=1e-10)


def test_forward_solutions_and_dynamics_of_any_closed_chain_are_those_of_scipy_and_pinocchio() -> None:
    pytest.importorskip("mujoco")
    from benchmarks.sections import loops

    for name in loops.NAMES:
        chain = loops.robot(name)
        home = chain.close()
        rates = np.linspace(-0.1, 0.1, len(chain.actuated))
        solve, accelerations = loops.by_scipy(chain, home), loops.by_pinocchio(chain)
        for values in loops.targets_near(chain, home, 2):
            q = chain.forward(values, home)
            np.testing.assert_allclose(solve(values), q, rtol=0.0, atol=1e-9, err_msg=name)
            state = chain.state(q, chain.state(q).joint_rates(rates))
            ours, theirs = state.forward_dynamics(10.0 * rates), accelerations(q, state.v, 10.0 * rates)
            assert np.abs(ours - theirs).max() <= 1e-9 * np.abs(theirs).max(), name


def test_mink_finds_the_same_forward_solutions() -> None:
    pytest.importorskip("mink")
    mujoco = pytest.importorskip("mujoco")
    from benchmarks.sections import loops

    for name in loops.NAMES:
        chain = loops.robot(name)
        home, engine = chain.close(), mujoco.MjModel.from_xml_path(str(loops.FOLDER / f"{name}.xml"))
        solve, hinges = loops.by_mink(name, chain), [n for n in chain.joint_names if len(chain.indices_in_q(n)) == 1]
        places = [engine.joint(joint).qposadr[0] for joint in hinges]
        for values in loops.targets_near(chain, home, 2):
            expected = chain.forward(values, home)[chain.indices_in_q(*hinges)]
            np.testing.assert_allclose(solve(values)[places], expected, rtol=0.0, atol=1e-7, err_msg=name)
