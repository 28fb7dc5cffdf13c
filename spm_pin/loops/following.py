"""Forward and inverse problems of a chain: choice of the unknown joints, continuation to targets, and errors."""

from __future__ import annotations

import contextlib
import copy
import math
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from spm_pin.errors import ArgumentError, ClosureError
from spm_pin.loops.assembly import assemble
from spm_pin.loops.batched_state import at_index
from spm_pin.loops.constraint_rows import FORMS, ROTATION, ConstraintRows, LoopKinematics
from spm_pin.loops.continuation import CLOSED, OPEN_START, REGULAR, SINGULAR_START, UNFINISHED, make_follower
from spm_pin.support.arguments import BoolArray, FloatArray, IntArray

FEW = 200
"""Number of steps of paths in a process that are interpreted, in about a millisecond each. For further ones the kernel
is loaded, which takes half a second, or compiled, once, in about 20 s."""
BASE_AT_ORIGIN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
"""Position and quaternion of a free joint."""
DEPENDENT = 1e-7
"""Singular values of a Jacobian below this, relative to the largest, are zero when an error is explained."""


class Problem:
    """Problem that the interpreted functions of `continuation` solve, evaluated by Pinocchio.

    Attributes
    ----------
    columns : ndarray of int, shape (p,)
        Unknown velocities.
    driven_rates : ndarray, shape (nv,)
        Change of each driven joint along the whole path, dimensionless.
    pose : int
        The closure for a target's pose, or -1.
    first_columns, loop_columns : ndarray of int
        Where the velocities of each closure begin, and the velocities, from frame 1 to frame 2.
    pose_turn : ndarray, shape (1,)
        Angle of the target's turn along the whole path [rad].
    pose_share : ndarray, shape (1,)
        Share of the path that the current step covers.
    most_steps : int
        Number of steps after which a path is left unfinished, negative for no such limit.
    drivers : ndarray, shape (equalities,)
        Values of the drivers of joint equalities at the start of the current step.
    first_rows, position_counts, row_counts : ndarray of int, shape (closures,)
        Where the equations of each closure begin, and how many there are, of positions and in all.
    """

    def __init__(self, rows: ConstraintRows, columns: IntArray, driven: IntArray, driven_in_v: IntArray) -> None:
        self.rows, self.columns, self.driven, self.driven_in_v = rows, columns, driven, driven_in_v
        self.most_steps = -1
        self.pose = rows.pose
        self.at_frame = rows.placements[rows.pose][1] if rows.pose >= 0 else None
        closures = len(rows.closures)
        loops = rows.forms // FORMS
        self.row_counts = np.bincount(loops, minlength=closures)
        self.position_counts = np.bincount(loops[rows.forms % FORMS < ROTATION], minlength=closures)
        self.first_rows = np.cumsum(self.row_counts) - self.row_counts
        self.driven_rates, self.pose_turn = np.zeros(rows.model.nv), np.zeros(1)
        self.pose_share, self.drivers = np.zeros(1), np.zeros(len(rows.zeros))
        self.zeros, self.polynomials, self.equality_places = rows.zeros, rows.polynomials, rows.equality_places
        self.units, self.row_units, self.forms = rows.units, rows.row_units, rows.forms
        # Joints in the order from frame 1 to frame 2.
        loops_columns = [np.r_[np.flatnonzero(sign < 0.0)[::-1], np.flatnonzero(sign > 0.0)] for sign in rows.signs]
        self.first_columns = np.cumsum([0, *map(len, loops_columns)])
        self.loop_columns = np.concatenate([*loops_columns, np.zeros(0, np.intp)]).astype(np.intp)
        self.kinematics = LoopKinematics(rows)
        self._all = np.zeros(rows.model.nv)

    def aim(self, q: FloatArray, target: FloatArray) -> None:
        """Set the path from q to a target: values of the driven joints, or the matrix (4, 4) of a pose."""
        if self.pose < 0:
            self.values = q[self.driven], target
            self.driven_rates[self.driven_in_v] = (target - q[self.driven]) / self.rows.units[self.driven_in_v]
            return
        rows = self.rows
        pin.forwardKinematics(rows.model, self.kinematics.data, q)
        placement = self.kinematics.data.oMi[rows.joints[self.pose][1]] * self.at_frame
        self.start, self.end = placement, pin.SE3(target)
        self.turn = pin.log3(self.end.rotation @ placement.rotation.T)
        self.pose_turn[0] = np.linalg.norm(self.turn)

    def place(self, s: float) -> None:
        """Move the pose that is to be reached to its place at a share of the path."""
        rotation = self.end.rotation if s == 1.0 else pin.exp3(s * self.turn) @ self.start.rotation
        start, end = self.start.translation, self.end.translation
        at = end if s == 1.0 else start + s * (end - start)
        rows = self.kinematics.rows
        rows.placements[self.pose], rows.pose_axes = [pin.SE3(np.eye(3), at), self.at_frame], rotation


def residual(problem: Problem, q: FloatArray, s: float) -> FloatArray:
    """Return the equations' left sides (m,), dimensionless, at a share of the path."""
    if problem.pose >= 0:
        problem.place(s)
    return problem.kinematics.residual(q)


def linearised(problem: Problem, q: FloatArray, s: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return left sides (m,), their Jacobian (m, p), and levers and turns (closures, nv)."""
    if problem.pose >= 0:
        problem.place(s)
    found = problem.kinematics.linearised(q)
    return found.residual, found.jacobian[:, problem.columns], found.levers, problem.rows.turns


def moved(problem: Problem, q: FloatArray, s: float, x: FloatArray) -> FloatArray:
    """Return q with the unknown joints moved by x (p,), and the driven ones at their values for path parameter s.

    s runs from 0 to 1.
    """
    problem._all[problem.columns] = x * problem.rows.units[problem.columns]
    q = pin.integrate(problem.rows.model, q, problem._all)
    if problem.pose < 0:
        start, end = problem.values
        q[problem.driven] = end if s == 1.0 else start + s * (end - start)
    return np.asarray(q)


def left_inverse(jacobian: FloatArray) -> tuple[FloatArray, bool]:
    """Return (Jᵀ J)⁻¹ Jᵀ, and whether J (m, p) has full column rank."""
    rows, columns = jacobian.shape
    if not columns:
        return np.zeros((0, rows)), True
    factor, info = lapack.dpotrf(jacobian.T @ jacobian)
    diagonal = factor.diagonal().tolist()
    if info or min(diagonal) <= REGULAR * max(diagonal):
        return np.zeros((columns, rows)), False
    return np.asarray(lapack.dpotrs(factor, jacobian.T)[0]), True


begin, go_on = make_follower(residual, linearised, moved, left_inverse, np.dot)


def follow(problem: Problem, q: FloatArray) -> tuple[FloatArray, int, float, int]:
    """Return q at the end of the path, or as far as it leads, the status, the share of the path, and the steps."""
    status, jacobian, inverse = begin(problem, q)
    if status:
        return q, status, 0.0, 0
    q, _, _, _, status, done, steps = go_on(problem, q, jacobian, inverse, 0.0)
    return q, status, done, steps


def _kernel() -> Any:
    from spm_pin.loops import tree_kernel

    return tree_kernel


class Follower:
    """Paths of one chain to values of its actuated joints, or to poses of a frame."""

    interpreted_steps = FEW
    """Number of steps, for all chains in this process, that may still be interpreted."""

    def __init__(self, chain: Any, frame: str | None, chosen: Sequence[int]) -> None:
        model, self.chain = chain.model, chain
        self.rows: ConstraintRows = chain.rows
        unknown = np.ones(model.nv, dtype=bool)
        unknown[chain.indices_in_v(*chain.held)] = False
        if frame is None:
            unknown[chain.actuated_in_v] = False
        else:
            self.rows = ConstraintRows(model, chain.closures, chain.equalities, chain.q0, (frame, chosen))
            unknown &= self.rows.coupled_with_pose()
        moves, bases = chain.rows.concerns(), [np.zeros(0, np.intp)]
        for joint in list(model.joints)[1:]:
            columns = slice(joint.idx_v, joint.idx_v + joint.nv)
            # A free base that is in no loop is held.
            if joint.shortname() == "JointModelFreeFlyer" and not moves[columns].any():
                unknown[columns] = False
                bases.append(joint.idx_q + np.arange(joint.nq))
        self._bases = np.concatenate(bases)
        self._at_origin = np.tile(BASE_AT_ORIGIN, len(bases) - 1)
        self.frame = frame
        # Numbers of a target: a matrix (4, 4), or values.
        self._width = len(chain.actuated) if frame is None else 16
        self.columns = np.flatnonzero(unknown)
        # All velocities that change along the path.
        self._movable = np.union1d(self.columns, chain.actuated_in_v) if frame is None else self.columns
        if frame is None:
            self._check_determined(unknown & ~moves)
        driven = (chain.actuated_in_q, chain.actuated_in_v) if frame is None else (np.zeros(0, np.intp),) * 2
        self._problem = Problem(self.rows, self.columns, *driven)
        self._local = threading.local()

    def _check_determined(self, free: BoolArray) -> None:
        names = [self.chain.joint_of_velocity(int(k)) for k in np.flatnonzero(free)]
        if names:
            cause = "These joints are in no loop: list them in actuated or held"
            raise ArgumentError(
                "actuated",
                "joints that determine all others",
                f"undetermined joints {', '.join(dict.fromkeys(names))}",
                cause,
            )

    def problem(self) -> Problem:
        """Return the problem of this thread."""
        found = getattr(self._local, "problem", None)
        if found is None:
            found = copy.copy(self._problem)
            found.rows = copy.copy(found.rows)
            found.rows.placements = list(found.rows.placements)
            found.kinematics = LoopKinematics(found.rows)
            for name in ("driven_rates", "_all", "pose_turn", "pose_share", "drivers"):
                setattr(found, name, getattr(found, name).copy())
            self._local.problem = found
        return found

    def run(self, starts: FloatArray, targets: FloatArray, is_path: bool, batch: tuple[int, ...]) -> FloatArray:
        """Return q (n, nq) of n targets: from the start (nq,) along all, or each from its own (n, nq).

        `batch` is the shape of the n targets for errors.
        """
        results = np.empty((len(targets), starts.shape[-1]))
        if not len(targets):
            return results
        starts, k, status, done, steps = np.array(starts, order="C", ndmin=2), 0, UNFINISHED, 1.0, 0
        if has_bases := len(self._bases) > 0:
            bases = starts[:, self._bases]
            if self.frame is None:
                # Loops do not depend on where free bases are; far from the origin they would be rounded more.
                starts[:, self._bases] = self._at_origin
        if len(targets) <= Follower.interpreted_steps:
            problem, q = self.problem(), starts[0]
            for k, target in enumerate(targets):
                problem.most_steps = Follower.interpreted_steps
                problem.aim(q if is_path else starts[k], target)
                q, status, done, steps = follow(problem, q if is_path else starts[k])
                Follower.interpreted_steps -= steps
                results[k] = q
                if status:
                    break
        if status == UNFINISHED:
            kernel, aims = _kernel(), np.array(targets, order="C").reshape(len(targets), self._width)
            k, status, done, steps = kernel.run.call(self._tree(kernel), starts, aims, is_path, results)
        if status:
            index = tuple(int(i) for i in np.unravel_index(k, batch))
            raise at_index(self.explained(results[k], status, done, steps, targets[k]), index)
        if has_bases:
            results[:, self._bases] = bases
        return results

    def compile(self) -> None:
        """Compile the kernel, or load it."""
        empty, kernel = np.zeros((0, self._width)), _kernel()
        kernel.run.call(
            self._tree(kernel), np.array(self.chain.q0, ndmin=2), empty, True, np.zeros((0, self.chain.model.nq))
        )
        Follower.interpreted_steps = 0

    def _tree(self, kernel: Any) -> Any:
        """Return the problem of this thread as arrays."""
        if not hasattr(self._local, "tree"):
            self._local.tree = kernel.PlainTree(kernel.tree_of(self._problem))
        return self._local.tree

    def explained(
        self, q: FloatArray, status: int, done: float, steps: int, target: FloatArray
    ) -> ArgumentError | ClosureError:
        """Return the error that says why a path ends at q, after a share `done` of the way to the target."""
        chain, problem = self.chain, self.problem()
        problem.aim(q, target)
        if status == OPEN_START:
            gap, unit, loop = LoopKinematics(chain.rows).widest(q)
            return ClosureError(gap, 0, "The loops are open at near: close(near) closes them", loop, unit)
        jacobian = linearised(problem, q, 0.0)[1]
        freedoms = self._freedoms(q)
        argument, received = "actuated", len(chain.actuated)
        if self.frame is not None:
            argument, received = "rows", int(self.rows.count - chain.rows.count)
        names = []
        if len(self.columns):
            vectors = np.linalg.svd(jacobian)[2][_rank(jacobian) :]
            names = [chain.joint_of_velocity(int(j)) for j in self.columns[(np.abs(vectors) > 0.05).any(axis=0)]]
        listed = ", ".join(dict.fromkeys(names))
        expected = f"{freedoms}, the number of degrees of freedom"
        if status == SINGULAR_START and received < freedoms:
            return ArgumentError(argument, expected, f"{received}", f"These joints are not determined: {listed}")
        if received > freedoms:
            return ArgumentError(
                argument,
                expected,
                f"{received}",
                "The target has more values than the chain has degrees of freedom: they would contradict each other",
            )
        cause = f"No further than {math.floor(1000.0 * done) / 10.0:g} % of the way"
        if np.abs(residual(problem, q, 0.0)).max(initial=0.0) > 0.5 * CLOSED:
            loop = problem.kinematics.widest(q)[2]
            cause += f": equations of {loop!r} depend on each other, and begin to contradict each other there, as with"
            cause += " rounded dimensions. Fewer equations, as of a 'planar' closure, leave no such limit"
        else:
            forward = "a forward singularity, or the end of this assembly mode"
            cause += f": {forward if self.frame is None else 'an inverse singularity, or out of reach'}"
            cause += f". Not determined there: {listed}" if listed else ""
        # How open the loops, or how far the pose, would be with the target from here.
        there = moved(problem, q, 1.0, np.zeros(len(self.columns)))
        residual(problem, there, 1.0)
        gap, unit, loop = problem.kinematics.widest(there)
        return ClosureError(gap, steps, cause, loop, unit)

    def _freedoms(self, q: FloatArray) -> int:
        """Return the degrees of freedom of the movable joints: the fewest at closed q and at configurations near it."""
        kinematics, random, model = LoopKinematics(self.chain.rows), np.random.default_rng(0), self.chain.model
        rank = _rank(kinematics.linearised(q).jacobian[:, self._movable])
        for _ in range(3):
            away = np.zeros(model.nv)
            away[self._movable] = random.uniform(-0.1, 0.1, len(self._movable)) * self.rows.units[self._movable]
            with contextlib.suppress(ClosureError):
                near = assemble(kinematics, pin.integrate(model, q, away), self._movable)
                rank = max(rank, _rank(kinematics.linearised(near).jacobian[:, self._movable]))
        return len(self._movable) - rank


def _rank(jacobian: FloatArray) -> int:
    values = np.linalg.svd(jacobian, compute_uv=False)
    return int((values > DEPENDENT * max(values.max(initial=0.0), 1e-300)).sum())
