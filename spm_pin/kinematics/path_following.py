"""Following one solution along a path of poses or leg lengths.

`path_tracker` keeps to the solution, `path_events` finds the singularities and limits that it meets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import RigidTransform, Slerp

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_displacement, forward_physical
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.kinematics.path_events import Event, find_events
from spm_pin.kinematics.path_tracker import PathSolver, Tracker
from spm_pin.mechanism.arguments import (
    BoolArray,
    FloatArray,
    as_array,
    check_instance,
    real_array,
    type_and_value,
    whole_number,
)
from spm_pin.mechanism.branches import physical
from spm_pin.mechanism.configuration import Configuration, check_configuration, compared_points
from spm_pin.mechanism.geometry import Geometry
from spm_pin.mechanism.pose import as_rigid_transform, pose
from spm_pin.mechanism.solutions import SolutionSet

LONGEST_MOVE = 0.1
"""A joint moves at most this share of d in a step, so that no turn is missed."""

_MOST_EVENTS = 4
"""Events that the text of a path shows."""


class CertifiedLimits(Protocol):
    """The part of a `Certificate` that `follow` uses: floors below cannot import it."""

    def covers(self, configuration: Configuration) -> BoolArray:
        """Return which configurations (...) are proved to be the only one of their leg lengths, shape (...)."""


@dataclass(frozen=True, repr=False)
class FollowedPath:
    """A solution along a path."""

    parameters: FloatArray
    """Where the path was solved, from 0 to 1, or to where the solution ends, shape (n,)."""
    configurations: Configuration
    """The solution there, batch of shape (n,)."""
    labels: tuple[str, ...]
    """Label of the solution at each parameter, n of them."""
    events: tuple[Event, ...]
    """In the order of their parameters."""
    certified: BoolArray | None = None
    """Which configurations a certificate covers, if one was given, shape (n,).

    A path on straight lines between leg lengths is in the certified limits as a whole if it is so at both ends of each
    line.
    """

    def __repr__(self) -> str:
        labels = ", ".join(dict.fromkeys(self.labels))
        ends = "complete" if self.complete else f"ends at {self.parameters[-1]:.4g}"
        events = ", ".join(f"{event.kind} at {event.parameter:.4g}" for event in self.events[:_MOST_EVENTS])
        more = f", … {len(self.events)} in all" if len(self.events) > _MOST_EVENTS else ""
        inside = "" if self.certified is None else f"; {self.certified.sum()} states in certified limits"
        return (
            f"<FollowedPath: {ends}, {len(self.parameters)} states of {labels}; {events or 'no events'}{more}{inside}>"
        )

    @property
    def complete(self) -> bool:
        """True if the solution lasts to the end of the path."""
        return bool(self.parameters[-1] == 1.0)


def follow(
    geometry: Geometry,
    path: Callable[[float], Any] | RigidTransform | FloatArray | Sequence[Any],
    start: Configuration | str | None = None,
    *,
    samples: int = 200,
    certificate: CertifiedLimits | None = None,
) -> FollowedPath:
    """Follow one solution along a path of poses or of leg lengths.

    Parameters
    ----------
    geometry : Geometry
        The manipulator. Where it has leg limits, crossing one is an event.
    path : callable, RigidTransform of shape (n,), or array_like of shape (n, 4, 4) or (n, 6)
        Poses of {m} in {B}, or leg lengths [m]. A callable takes the parameter, 0 to 1. Between given poses the
        rotation is interpolated at constant angular velocity and the position, like leg lengths, on a line.
    start : Configuration or str, optional
        The solution at parameter 0: the one nearest to a configuration, or a label. By default the physical one.
    samples : int
        The path is solved in at least so many steps. Two crossings within one step of the same limit or of the
        same kind of singularity are found if the function in between has its extremum beyond zero.
    certificate : Certificate, optional
        Certified leg limits, see `spm_pin.certify`: the result then says which states are in them.

    Returns
    -------
    FollowedPath
        With its events, each at its parameter to 1e-9.

    Raises
    ------
    ArgumentError
        If the path is neither, has fewer than two points, or no solution like `start` exists at its beginning.
    PoseError
        If it contains what is no pose.
    """
    check_instance(geometry, Geometry, "geometry")
    samples = whole_number(samples, "samples", least=1, most=10**9)
    if certificate is not None and not hasattr(certificate, "covers"):
        raise ArgumentError("certificate", "a Certificate", type(certificate).__name__)
    solve, knots, legs = _solver(geometry, path)
    tracker = Tracker(solve, _start(solve(0.0), start), LONGEST_MOVE * geometry.middle_side, legs=legs)
    stops = np.unique(np.concatenate([np.linspace(0.0, 1.0, samples + 1), knots]))
    for stop in stops[1:]:
        if not tracker.advance(float(stop)):
            break
    found = tracker.configurations()
    events = find_events(geometry, tracker.parameters, found, tracker.state) + tracker.events
    covered = None if certificate is None else certificate.covers(found)
    ordered = tuple(sorted(events, key=lambda e: e.parameter))
    return FollowedPath(np.array(tracker.parameters), found, tuple(tracker.labels), ordered, covered)


def physical_mode_share(
    geometry: Geometry, start: FloatArray, ends: FloatArray, *, parts: int = 16, rounds: int = 3
) -> FloatArray:
    """Return the shares of straight lines of leg lengths to which the physical mode lasts, shape (n,).

    From lengths (6,), at which it exists, to each of `ends` (n, 6) [m]. A line is solved at the ends of `parts` parts,
    and each further of `rounds` divides the first part at whose end the mode is gone: a shorter gap may be missed.
    """
    low, high = np.zeros(len(ends)), np.ones(len(ends))
    for _ in range(rounds):
        shares = np.linspace(low, high, parts + 1)[1:]
        exists = np.asarray(forward_physical(geometry, start + shares[..., None] * (ends - start)).exists)
        count = np.where(exists.all(axis=0), parts, exists.argmin(axis=0))
        found = np.concatenate([low[None], shares])
        low, high = (np.take_along_axis(found, at[None], axis=0)[0] for at in (count, np.minimum(count + 1, parts)))
    return low


def last_on_line(start: Configuration, leg_lengths: FloatArray) -> tuple[Configuration, float]:
    """Return the last configuration found on the straight line to leg lengths (6,), and its share of the line.

    The mode is that of `start`; the share is 1 if it lasts to the end.
    """
    geometry, lengths = start.geometry, start.readings
    if not physical(start):
        path = follow(geometry, np.stack([lengths, leg_lengths]), start, samples=4)
        return path.configurations[-1], float(path.parameters[-1])
    share = float(physical_mode_share(geometry, lengths, leg_lengths[None])[0])
    return forward_physical(geometry, lengths + share * (leg_lengths - lengths)) if share else start, share


def _solver(geometry: Geometry, path: Any) -> tuple[PathSolver, FloatArray, bool]:
    """Return all solutions as a function of the parameter, the parameters of given points, and if those are legs."""
    if callable(path):
        if np.shape(_bare(path(0.0))) == (6,):
            return lambda s: forward_displacement(geometry, path(s)), np.array([0.0, 1.0]), True
        return lambda s: inverse_displacement(geometry, path(s)), np.array([0.0, 1.0]), False
    bare = as_array(_bare(path))
    points = len(bare) if bare is not None and bare.ndim else 0
    if bare is None or bare.ndim not in (2, 3) or points < 2:
        expected = "a callable, or at least two poses (n, 4, 4) or sets of leg lengths (n, 6)"
        raise ArgumentError("path", expected, type_and_value(path) if bare is None else f"shape {bare.shape}")
    knots = np.linspace(0.0, 1.0, points)
    if bare.ndim == 2:
        lengths = real_array(path, "path", (6,), "leg lengths in metres, or poses of shape (n, 4, 4)")
        return lambda s: forward_displacement(geometry, _between(s, knots, lengths)), knots, True
    poses = as_rigid_transform(path, "path")
    turn, positions = Slerp(knots, poses.rotation), poses.translation
    return lambda s: inverse_displacement(geometry, pose(_between(s, knots, positions), rotation=turn(s))), knots, False


def _between(s: float, knots: FloatArray, rows: FloatArray) -> FloatArray:
    return np.array([np.interp(s, knots, column) for column in rows.T])


def _bare(value: Any) -> Any:
    return value.as_matrix() if isinstance(value, RigidTransform) else value


def _start(solutions: SolutionSet, start: Configuration | str | None) -> int:
    """Return the place of the solution to follow."""
    if isinstance(start, str):
        if start not in solutions.labels or not solutions[start].exists:
            real = [label for label, exists in zip(solutions.labels, solutions.exists, strict=True) if exists]
            received = f"{start!r}, while real are {', '.join(real[:8]) or 'none'}{' …' * (len(real) > 8)}"
            raise ArgumentError("start", "the label of a solution that is real where the path begins", received)
        return solutions.labels.index(start)
    if start is not None:
        check_configuration(start, "start", single=True, existing=True)
    chosen = solutions.physical() if start is None else solutions.nearest(start)
    if not chosen.exists:
        cause = f"{chosen.absence}. A solution that is not physical is named by its label" if start is None else ""
        raise ArgumentError("start", "a solution that exists where the path begins", "none", cause)
    gap = np.abs(compared_points(solutions.configurations) - compared_points(chosen)).max(axis=(-1, -2))
    return int(np.where(solutions.exists, gap, np.inf).argmin())
