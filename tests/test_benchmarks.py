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

from benchmarks.peers import arms, peers_by_task
from benchmarks.peers.certified import real_coordinates
from benchmarks.peers.compiled import compiler_version
from benchmarks.peers.lines import coordinates
from benchmarks.peers.peer import Peer, Prepared
from benchmarks.poses import KINDS, MACHINE, as_built, leg_space, mixture
from benchmarks.sections.velocity import states

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
    along, medians = coordinates(machine, poses, found), []
    for k in range(0, len(along), copies):
        counts = [len(roots) for roots in along[k : k + copies]]
        usual = max(counts, key=counts.count)
        medians.append(np.median([roots for roots in along[k : k + copies] if len(roots) == usual], axis=0))
    return medians


def certified() -> list[npt.NDArray[np.float64]]:
    poses = zip(POSES.rotation.as_quat(), POSES.translation, strict=True)
    found = [real_coordinates(quaternion, position, SIDE) for quaternion, position in poses]
    return [roots for roots in found if roots is not None]


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


def test_peers_find_the_branches_of_a_calibrated_machine() -> None:
    machine = as_built(1e-3)
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
