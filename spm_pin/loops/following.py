"""Forward and inverse problems of a chain: choice of the unknown joints, continuation to targets, and errors."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from spm_pin.errors import ArgumentError, ClosureError
from spm_pin.loops.assembly import assemble
from spm_pin.loops.constraint_rows import ConstraintRows
from spm_pin.loops.continuation import CLOSED, OPEN_START, SINGULAR_START, UNFINISHED, run
from spm_pin.loops.loop_state import at_index
from spm_pin.loops.state_kinematics import StateKinematics
from spm_pin.loops.tree_kernel import UNLIMITED, aim, linearised, moved, residual, tree_of
from spm_pin.support.arguments import BoolArray, FloatArray
from spm_pin.support.compiling import forced

FEW, MANY = 200, 4000
"""Numbers of steps of paths in a process that are interpreted, in one to eight milliseconds each, before the kernel is
loaded, which takes half a second, and before it is compiled, once, in about 20 s."""
BASE_AT_ORIGIN = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
"""Position and quaternion of a free joint."""
DEPENDENT = 1e-7
"""Singular values of a Jacobian below this, relative to the largest, are zero when an error is explained."""


class Follower:
    """Paths of one chain to values of its actuated joints, or to poses of a frame."""

    interpreted_steps, is_cache_read = FEW, False
    """Number of steps, for all chains in this process, that may still be interpreted, and whether Numba's cache, which
    determines it, has been looked into."""

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
        self._driven = (chain.actuated_in_q, chain.actuated_in_v) if frame is None else (np.zeros(0, np.intp),) * 2
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

    @property
    def tree(self) -> Any:
        """The problem as arrays, those of this thread, since a path writes in them."""
        try:
            return self._local.tree
        except AttributeError:
            self._local.tree = tree_of(self.rows, self.columns, *self._driven)
            return self._local.tree

    def run(self, starts: FloatArray, targets: FloatArray, is_path: bool, batch: tuple[int, ...]) -> FloatArray:
        """Return q (n, nq) of n targets: from the start (nq,) along all, or each from its own (n, nq).

        `batch` is the shape of the n targets for errors.
        """
        results = np.empty((len(targets), starts.shape[-1]))
        if not len(targets):
            return results
        starts = np.array(starts, order="C", ndmin=2)
        if has_bases := len(self._bases) > 0:
            bases = starts[:, self._bases]
            if self.frame is None:
                # Loops do not depend on where free bases are; far from the origin they would be rounded more.
                starts[:, self._bases] = self._at_origin
        aims = np.array(targets, order="C").reshape(len(targets), self._width)
        tree, status = self.tree, UNFINISHED
        while status == UNFINISHED and (allowed := _interpreted_steps(len(targets))):
            tree.steps_left[0] = allowed
            k, status, done, steps = run.interpreted(tree, starts, aims, is_path, results)
            Follower.interpreted_steps -= allowed - int(tree.steps_left[0])
            tree.steps_left[0] = UNLIMITED
        if status == UNFINISHED:
            k, status, done, steps = run.call(tree, starts, aims, is_path, results)
        if status:
            index = tuple(int(i) for i in np.unravel_index(k, batch))
            raise at_index(self.explained(results[k], status, done, steps, targets[k]), index)
        if has_bases:
            results[:, self._bases] = bases
        return results

    def compile(self) -> None:
        """Compile the kernel, or load it."""
        nothing = np.zeros((0, self._width)), True, np.zeros((0, self.chain.model.nq))
        run.call(self.tree, np.array(self.chain.q0, ndmin=2), *nothing)

    def explained(
        self, q: FloatArray, status: int, done: float, steps: int, target: FloatArray
    ) -> ArgumentError | ClosureError:
        """Return the error that says why a path ends at q, after a share `done` of the way to the target."""
        chain, tree, rows = self.chain, self.tree, self.rows
        aim(tree, q, target.ravel())
        errors = residual(tree, q, 0.0)
        if status == OPEN_START:
            gap, unit, loop = rows.widest(errors * rows.row_units)
            return ClosureError(gap, 0, "The loops are open at near: close(near) closes them", loop, unit)
        jacobian = linearised(tree, q, 0.0)[1]
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
        if np.abs(errors).max(initial=0.0) > 0.5 * CLOSED:
            loop = rows.widest(errors * rows.row_units)[2]
            cause += f": equations of {loop!r} depend on each other, and begin to contradict each other there, as with"
            cause += " rounded dimensions. Fewer equations, as of a 'planar' closure, leave no such limit"
        else:
            forward = "a forward singularity, or the end of this assembly mode"
            cause += f": {forward if self.frame is None else 'an inverse singularity, or out of reach'}"
            cause += f". Not determined there: {listed}" if listed else ""
        # How open the loops, or how far the pose, would be with the target from here.
        there = residual(tree, moved(tree, q, 1.0, np.zeros(len(self.columns))), 1.0)
        gap, unit, loop = rows.widest(there * rows.row_units)
        return ClosureError(gap, steps, cause, loop, unit)

    def _freedoms(self, q: FloatArray) -> int:
        """Return the degrees of freedom of the movable joints: the fewest at closed q and at configurations near it."""
        kinematics, random, model = StateKinematics(self.chain), np.random.default_rng(0), self.chain.model
        kinematics.evaluate(q)
        rank = _rank(kinematics.scaled_jacobian[:, self._movable])
        for _ in range(3):
            away = np.zeros(model.nv)
            away[self._movable] = random.uniform(-0.1, 0.1, len(self._movable)) * self.rows.units[self._movable]
            with contextlib.suppress(ClosureError):
                kinematics.evaluate(assemble(kinematics, pin.integrate(model, q, away), self._movable))
                rank = max(rank, _rank(kinematics.scaled_jacobian[:, self._movable]))
        return len(self._movable) - rank


def _interpreted_steps(targets: int) -> int:
    """Return how many steps to so many targets may be interpreted; 0 if the kernel is loaded or compiled instead."""
    if run.is_loaded:
        return 0
    if way := forced():
        return UNLIMITED if way == "interpreted" else 0
    if targets > Follower.interpreted_steps and not Follower.is_cache_read:
        Follower.is_cache_read = True
        Follower.interpreted_steps += 0 if run.is_kept() else MANY
    return Follower.interpreted_steps if targets <= Follower.interpreted_steps else 0


def _rank(jacobian: FloatArray) -> int:
    values = np.linalg.svd(jacobian, compute_uv=False)
    return int((values > DEPENDENT * max(values.max(initial=0.0), 1e-300)).sum())
