"""The states of a machine within its leg limits, by the coordinates of both stages, and random ones of them.

The coordinates of a stage are (x, y, Z/r), see `spm_pin.kinematics.kernels.stage_states`: unlike leg lengths, each
within the unit circle are a state, and poses and readings are smooth functions of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal

import numpy as np
from scipy.spatial import KDTree

from spm_pin.errors import ArgumentError
from spm_pin.formulas.leg_constants import TANGENT_SIGNS
from spm_pin.formulas.stages import ANY_ASPECT, HOME_ASPECT
from spm_pin.kinematics.batches import run_kernel
from spm_pin.kinematics.forward_displacement import forward_physical, states_of_stages
from spm_pin.kinematics.inverse_displacement import inverse_displacement
from spm_pin.machine import Configuration, LegLimits, Machine, Manipulator
from spm_pin.machine.branch_of_state import FAMILIES, family, stage_coordinates
from spm_pin.machine.configuration import Condition, check_condition
from spm_pin.machine.machine import check_machine
from spm_pin.support.arguments import (
    BoolArray,
    FloatArray,
    IntArray,
    Progress,
    choice,
    generator,
    whole_number,
)
from spm_pin.support.progress import shown_progress

CENTRE = np.zeros((1, 3))
"""The platform's centre o in {m}."""
_HALF_TURN = np.array([-1.0, -1.0, 1.0])
"""Diagonal of the half turn about Z."""
_UPWARD = {1: (0.0,), 2: (1.0, -1.0)}
"""Sign of Z at home of each stage of a machine, by their number; a stage by itself may be on either side."""
_SAMPLE, _SEED = 20_000, 20_140_131
"""Number of states in `StateSet.sample`, and the seed of the samples, fixed so that results repeat."""
_TRIED, _FEW, _FEWEST = 48, 22, 6
"""Sets of readings tried for `StateSet.few`, few enough not to compile kernels for, how many states of a stage are kept
at most, and how many must exist."""
_MIN_BATCH = 4096
"""Number of stages that are worth a thread."""
_BOXES, _HALVINGS = 20_000, 50
"""Boxes of a stage's cover with which its refinement ends, and refinements at most; each halves the boxes' sides."""
_RESERVE = 1.2
"""Factor of the bound on the motion of balls in a box, since a calibrated machine has a little torsion."""
_DRAWN_TOGETHER, _LEAST_TRIED = 50_000, 1_000_000
"""Maximum number of stages drawn together, and minimum number of trials before a set counts as too small to be hit."""
_CHUNK, _MOST_CHUNKS = 20_000, 1000
"""Maximum number of reachable states drawn together, and of such draws."""


@dataclass(frozen=True)
class Stages:
    """Stages at N coordinates; NaN beyond the unit circle."""

    rotation: FloatArray  # of the middle platform, turned by half a turn in mode F, (N, 3, 3)
    centre: FloatArray  # its origin [m], (N, 3)
    readings: FloatArray  # [m, rad], (N, 3)
    determinant: FloatArray  # about 1 at home, 0 at forward singularities, (N,)
    in_aspect: BoolArray  # and all balls within reach, (N,)
    spins: FloatArray  # derivatives by the coordinates, which are last: the rotation's, as rotation vectors, (N, 3, 3)
    velocities: FloatArray  # the centre's, (N, 3, 3)


@dataclass(frozen=True, eq=False)
class StateSet:
    """The states of a machine in one family and one aspect, and a test of its limits."""

    machine: Any  # a Manipulator, or a Stage: its states have one stage, and no search takes them
    minimum: FloatArray
    """Least readings (legs,) [m], for RRS legs [rad]."""
    maximum: FloatArray
    """Largest readings (legs,), likewise."""
    family: str = "TT"
    """The modes of the stages."""
    aspects: tuple[float, ...] = (HOME_ASPECT, HOME_ASPECT)
    """Aspects of the stages: 2 is the home assembly region, 1 and -1 a sign of the determinant, 0 any state."""

    @property
    def radius(self) -> float:
        """The radius r of the triangle of balls [m], the unit of heights."""
        return float(self.machine.stage_radii[0][1])

    @property
    def _upward(self) -> tuple[float, ...]:
        """Sign of Z at home of each stage."""
        return _UPWARD[len(self.aspects)]

    @property
    def size(self) -> float:
        """E + C + d and how far legs reach [m]: lengths are small or large in proportion to it."""
        longest = float(self._longest.max())
        return float(sum(self.machine.dimensions) + (longest if np.isfinite(longest) else 0.0))

    @cached_property
    def _longest(self) -> FloatArray:
        """Largest distance of each ball from its leg's pivot (legs,) [m]; infinite without limits."""
        with np.errstate(invalid="ignore"):
            reached = [self._circle_of(ends) for ends in (self.minimum, self.maximum)]
            longest = np.maximum(*(np.linalg.norm(centre, axis=-1) + radius for centre, radius in reached))
        return np.where(np.isnan(longest), np.inf, longest)

    def _circle_of(self, readings: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the centres (legs, 3) from the pivots, and the radii of the balls' circles at readings (legs,) [m]."""
        centres, radii = self.machine.legs.circles(readings)
        return centres - self.machine.legs.pivots, radii

    @cached_property
    def _turns(self) -> FloatArray:
        """Diagonals (stages, 3) of the turns that take each stage to mode T."""
        return np.array([np.ones(3) if mode == "T" else _HALF_TURN for mode in self.family])

    @property
    def mode_turn(self) -> FloatArray:
        """Diagonal (3,) of the turn about z between both stages: a half turn if their modes differ, else none."""
        return np.asarray(self._turns.prod(axis=0))

    @cached_property
    def legs(self) -> FloatArray:
        """Constants of the legs for `kernels.stage_states`, (stages, 3, 21); axes are tangents of the platforms."""
        legs = self.machine.legs
        axes = np.tile(TANGENT_SIGNS, len(legs.kinds))[:, None] * legs.axes
        balls = legs.balls * np.repeat(self._turns, 3, axis=0)
        numbers = np.zeros((len(axes), 6))
        for stage, kind in enumerate(legs.kinds):
            rows, own = slice(3 * stage, 3 * stage + 3), kind.numbers
            numbers[rows, : own.shape[1]], numbers[rows, 4] = own, kind.number
        numbers[:, 3], numbers[:, 5] = legs.offsets, self.machine.crank_middles
        return np.concatenate([axes, legs.pivots, balls, *legs.planes, numbers], axis=-1).reshape(-1, 3, 21)

    @cached_property
    def _signed_aspects(self) -> FloatArray:
        """The aspects for `kernels.stage_states`, (stages,): that of the home is negative for a stage that hangs."""
        aspects, ups = np.array(self.aspects), self.machine.legs.ups[::3]
        return np.where(aspects == HOME_ASPECT, ups * aspects, aspects)

    def constants(self, body: FloatArray = CENTRE, margin: float = 0.0) -> tuple[object, ...]:
        """Return the constants of the searches of `state_search`, for points `body` (K, 3) of {m} [m].

        Determinants are to exceed `margin`, except for stages of `ANY_ASPECT`, and the distance of each ball from the
        singularities of its own leg is to exceed `margin` times the size. For RPS legs, which are singular only at
        length zero, the limits of the readings suffice.
        """
        legs, aspects = self.machine.legs, self._signed_aspects
        least = np.where(aspects == ANY_ASPECT, -np.inf, margin)
        rooms = np.full(0 if legs.are_rps else 6, margin * self.size)
        limits = [
            [*self.minimum, *least, *rooms],
            [*self.maximum, np.inf, np.inf, *np.full(len(rooms), np.inf)],
            [*legs.largest_slopes, self.size, self.size, *np.ones(len(rooms))],
        ]
        points = np.require(body, requirements=("C", "W"))
        return self.legs, self.radius, self.size, aspects, points, self.mode_turn, np.array(limits)

    def stages(self, stage: int, coordinates: FloatArray) -> Stages:
        """Return the lower (0) or upper (1) stage at coordinates (N, 3), seen from {B} or {m}."""
        from spm_pin.kinematics.kernels.stage_states import INSIDE, SLOPE_NUMBERS, STAGE_NUMBERS, stage_states

        constants = self.legs[stage], self.radius, self._upward[stage], float(self._signed_aspects[stage])
        results = ((STAGE_NUMBERS,), np.float64), ((SLOPE_NUMBERS, 3), np.float64), ((), np.int64)
        inputs = [np.require(coordinates, requirements=("C", "W"))]
        values, slopes, places = run_kernel(stage_states, inputs, constants, results, _MIN_BATCH)
        rotation, centre, readings, determinant, _ = np.split(values, [9, 12, 15, 16], axis=1)
        derivatives = slopes[:, :3], slopes[:, 3:6]
        return Stages(rotation.reshape(-1, 3, 3), centre, readings, determinant[:, 0], places == INSIDE, *derivatives)

    def _both(self, coordinates: FloatArray) -> tuple[Stages, Stages, FloatArray]:
        """Return both stages at coordinates (N, 2, 3), and the rotation of the platform (N, 3, 3)."""
        lower, upper = (self.stages(k, coordinates[:, k]) for k in range(2))
        return lower, upper, lower.rotation * self.mode_turn @ upper.rotation.mT

    def readings(self, coordinates: FloatArray) -> FloatArray:
        """Return the readings (N, legs) at coordinates (N, stages, 3)."""
        stages = range(len(self.aspects))
        return np.concatenate([self.stages(k, coordinates[:, k]).readings for k in stages], axis=-1)

    def coordinates(self, states: Configuration) -> FloatArray:
        """Return the coordinates (N, stages, 3) of states (N,); NaN in other families."""
        return stage_coordinates(states, self.family) / [1.0, 1.0, self.radius]

    def states(self, coordinates: FloatArray, readings: FloatArray | None = None) -> Any:
        """Return the states (N,) at coordinates (N, stages, 3), with their readings (N, 6) if these are known."""
        if len(self.aspects) == 1:
            stage = self.stages(0, coordinates[:, 0])
            return Configuration.from_arrays(self.machine, stage.rotation, stage.centre, stage.readings)
        lower, upper, rotation = self._both(coordinates)
        translation = lower.centre - (rotation @ upper.centre[..., None])[..., 0]
        balls = self.legs[0, :, 6:9] @ lower.rotation.mT + lower.centre[:, None]
        legs = self.machine.legs
        lengths = None if readings is None or not legs.are_rps else readings - legs.offsets
        return Configuration.from_arrays(self.machine, rotation, translation, balls, lengths)

    def positions(self, coordinates: FloatArray, body: FloatArray = CENTRE) -> FloatArray:
        """Return the positions of points `body` (K, 3) of the platform in {B} [m], (N, 3K)."""
        states = self.states(coordinates)
        moved = states.translation[:, None] + body @ states.rotation.mT
        return np.asarray(moved.reshape(len(coordinates), 3 * len(body)))

    def densities(self, coordinates: FloatArray) -> FloatArray:
        """Return the volume of poses per volume of `coordinates` (N, 2, 3), each pose counted once, (N,) [m³ rad³].

        For a stage that of heights and normals, [m sr], for coordinates (N, 1, 3).
        """
        if len(self.aspects) == 1:
            # Turns about the platform's own x and y move its normal, and one about the normal does not.
            stage = self.stages(0, coordinates[:, 0])
            rates = np.concatenate([stage.velocities[:, 2:], stage.rotation[..., :2].mT @ stage.spins], axis=1)
            return np.asarray(np.abs(np.linalg.det(rates)))
        densities = np.abs(np.linalg.det(self.jacobians(coordinates)))
        return np.asarray(densities / pose_multiplicity(self, self.states(coordinates)))

    def jacobians(self, coordinates: FloatArray) -> FloatArray:
        """Return the derivatives of o and of the rotation with respect to the coordinates, (N, 6, 6) [m, rad]."""
        lower, upper, rotation = self._both(coordinates)
        matrix = np.empty((len(coordinates), 6, 6))
        matrix[:, :3, :3] = lower.velocities - np.cross(lower.spins, rotation @ upper.centre[..., None], axis=1)
        matrix[:, :3, 3:] = -rotation @ (upper.velocities - np.cross(upper.spins, upper.centre[..., None], axis=1))
        matrix[:, 3:, :3], matrix[:, 3:, 3:] = lower.spins, -rotation @ upper.spins
        return matrix

    def upper_for(self, lower: FloatArray, points: FloatArray) -> FloatArray:
        """Return coordinates of upper stages (N, 3) that put o at `points` (N, 3) [m], given those of the lower stages.

        By Newton's method, from the middle platform's normal turned towards o; NaN where that does not arrive. For the
        home assembly region only.
        """
        stage = self.stages(0, lower)
        target = (stage.rotation.mT @ (points - stage.centre)[..., None])[..., 0]
        distance, across = np.linalg.norm(target, axis=-1), np.hypot(target[:, 0], target[:, 1])
        half = 0.5 * np.arctan2(across, target[:, 2])
        with np.errstate(invalid="ignore", divide="ignore"):
            axis = np.where(across > 0.0, np.stack([target[:, 1], -target[:, 0]]) / across, 0.0)
        upper = np.stack([np.sin(half) * axis[0], np.sin(half) * axis[1], -distance / self.radius], axis=-1)
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            for _ in range(24):
                stage = self.stages(1, upper)
                gap = target + (stage.rotation.mT @ stage.centre[..., None])[..., 0]
                slopes = stage.rotation.mT @ (stage.velocities - np.cross(stage.spins, stage.centre[..., None], axis=1))
                slopes[np.linalg.det(slopes) == 0.0] = np.nan
                upper = upper - np.linalg.solve(slopes, gap[..., None])[..., 0]
            error = np.abs(gap).max(axis=-1, initial=0.0)
        return np.where((error <= 1e-11 * (1.0 + distance))[:, None], upper, np.nan)

    def contains(self, stage: int, coordinates: FloatArray) -> BoolArray:
        """Return a mask of the coordinates (N, 3) of one stage that are states of the set."""
        stages = self.stages(stage, coordinates)
        within = self.admits(stages.readings, slice(3 * stage, 3 * stage + 3))
        return np.asarray(stages.in_aspect & within.all(axis=-1))

    def admits(self, readings: FloatArray, legs: slice = slice(None)) -> BoolArray:
        """Return which readings (..., n) of these legs are within their limits, without rounding."""
        with np.errstate(invalid="ignore"):
            return np.asarray((readings >= self.minimum[legs]) & (readings <= self.maximum[legs]))

    @cached_property
    def _covers(self) -> list[tuple[FloatArray, FloatArray]]:
        """The centres (n, 3) of equal boxes that cover the states of each stage, and their half sides (3,)."""
        covers, corners = [], 2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1.0
        for stage, legs in enumerate(self.legs):
            # Z is the mean height of the balls, none of which is higher than its leg reaches; pivots are nearly level.
            top = self._longest[3 * stage : 3 * stage + 3].max() + np.abs(legs[:, 5]).max()
            top = (top + np.abs(legs[:, 8]).max()) / self.radius
            upward = self._upward[stage]
            half, centres = (
                np.array([1.0, 1.0, 0.5 * top if upward else top]),
                np.array([[0.0, 0.0, 0.5 * upward * top]]),
            )
            for _ in range(_HALVINGS):
                half = 0.5 * half
                centres = self._near(stage, (centres[:, None] + half * corners).reshape(-1, 3), half)
                if not 0 < len(centres) < _BOXES:
                    break
            covers.append((centres, half))
        return covers

    def _near(self, stage: int, centres: FloatArray, half: FloatArray) -> FloatArray:
        """Return the centres of those boxes (n, 3) in which readings within the limits cannot be excluded."""
        r = self.radius
        across = np.abs(centres[:, :2])
        nearest, farthest = ((np.maximum(across + way * half[:2], 0.0) ** 2).sum(axis=-1) for way in (-1.0, 1.0))
        # Beyond the unit circle there are no states; readings are taken at a point inside.
        radius = np.hypot(across[:, 0], across[:, 1])
        inner = np.minimum(radius, 1.0 - 1e-9)
        point = centres.copy()
        point[:, :2] *= (inner / np.maximum(radius, 1e-300))[:, None]
        shift = np.hypot(half[0], half[1]) + radius - inner
        x0 = np.sqrt(1.0 - inner * inner)
        ends = [np.sqrt(1.0 - np.minimum(square, 1.0)) for square in (nearest, farthest)]
        chord = np.sqrt(shift**2 + np.maximum(ends[0] - x0, x0 - ends[1]) ** 2)
        # Quaternions q and q' turn a point at the distance r to places at most 2r |q - q'| apart.
        bound = 2.0 * r * np.minimum(chord, 1.0) + r * shift * (2.0 * inner + shift) + r * half[2]
        outside = self._outside(stage, self.stages(stage, point))
        return np.asarray(centres[(nearest < 1.0) & ~(outside > _RESERVE * bound + 1e-12)])

    def _outside(self, stage: int, stages: Stages) -> FloatArray:
        """Return a lower bound of the distance of the worst ball from the region within its leg's limits, (N,) [m].

        In a leg's plane that region ends at the circles of both limits and, except for RPS legs, where the leg is
        singular.
        """
        legs, own = slice(3 * stage, 3 * stage + 3), self.machine.legs
        arms = self.legs[stage, :, 6:9] @ stages.rotation.mT + stages.centre[:, None] - own.pivots[legs]
        places = np.stack([(arms * axes[legs]).sum(axis=-1) for axes in own.planes], axis=-1)
        rooms = own.kinds[stage].rooms(places)
        distances = [] if np.isfinite(own.kinds[stage].least_reading) else [np.abs(rooms)]
        for ends in (self.minimum, self.maximum):
            centres, radii = (values[legs] for values in self._circle_of(ends))
            distances.append(np.abs(np.linalg.norm(arms - centres, axis=-1) - radii))
        within = self.admits(stages.readings, legs) & (rooms > 0.0)
        return np.asarray(np.where(within, 0.0, np.minimum.reduce(distances)).max(axis=-1))

    def draw_stages(
        self, stage: int, count: int, rng: np.random.Generator, height: float | None = None
    ) -> tuple[FloatArray, float]:
        """Draw `count` states of a stage uniformly: coordinates (count, 3), and an estimate of the set's volume.

        Fewer, or none, where the set is empty or too small to be hit. The estimate has no bias, and a relative variance
        of at most 1/count. With a `height`, Z/r, states have it, and the estimate is that of the area of (x, y).
        """
        centres, half = self._covers[stage]
        if height is not None:
            # Boxes that touch in a plane would both be met by a height in it.
            below = height - centres[:, 2]
            centres, half = centres[(below >= -half[2]) & (below < half[2])].copy(), half * [1.0, 1.0, 0.0]
            centres[:, 2] = height
        parts, drawn, tried = [np.empty((0, 3))], 0, 0
        while drawn < count and len(centres) and tried < max(_LEAST_TRIED, 1000 * count):
            number = min(_DRAWN_TOGETHER, 8 * count + 100)
            points = centres[rng.integers(len(centres), size=number)] + half * rng.uniform(-1.0, 1.0, (number, 3))
            place = np.flatnonzero(self.contains(stage, points))[: count - drawn]
            parts.append(points[place])
            drawn += len(place)
            # Counted up to the last that is needed: that makes the estimate of the share unbiased.
            tried += int(place[-1]) + 1 if drawn == count else number
        share = (drawn - 1) / (tried - 1) if drawn == count > 1 else drawn / max(tried, 1)
        return np.concatenate(parts), share * float(len(centres) * (2.0 * half[: 3 if height is None else 2]).prod())

    def draw(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw states uniformly in the coordinates of all stages, (count, stages, 3)."""
        return np.stack([self.draw_stages(stage, count, rng)[0] for stage in range(len(self.aspects))], axis=1)

    def draw_in_readings(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Draw `count` sets of readings uniformly; return the coordinates of the states among them, (n, stages, 3).

        The legs of two stages are independent: each stage is drawn by itself.
        """
        stages = self._stages_in_readings(count, rng)
        number = min(map(len, stages))
        return np.stack([stage[:number] for stage in stages], axis=1)

    def _stages_in_readings(self, count: int, rng: np.random.Generator) -> list[FloatArray]:
        """Draw `count` sets of readings; return the coordinates (n, 3) of those of each stage that exist."""
        drawn = rng.uniform(self.minimum, self.maximum, (count, len(self.minimum)))
        if len(self.aspects) == 1:
            states = forward_physical(self.machine, drawn)
            return [self.coordinates(states[states.exists])[:, 0]]
        both, numbers = states_of_stages(self.machine, drawn)
        coordinates = self.coordinates(both)
        return [coordinates[:number, stage] for stage, number in enumerate(numbers)]

    @cached_property
    def few(self) -> list[FloatArray]:
        """Few states of each stage within the limits, (n, 3), always the same, in the home assembly region.

        Each state of the lower stage is combined with each of the upper one. Arrays are empty if the set is.
        """
        rng = np.random.default_rng(_SEED)
        stages = self._stages_in_readings(_TRIED, rng)
        if min(map(len, stages)) < _FEWEST:
            stages = [self.draw_stages(stage, _FEW, rng)[0] for stage in range(len(stages))]
        return [stage[:_FEW] for stage in stages]

    def pairs(self, few: Sequence[FloatArray], body: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the states (N, 2, 3) of all pairs of a few of each stage, and their points `body` (K, 3) [m], (N, 3K).

        `few` are coordinates (n, 3) of lower stages and (m, 3) of upper ones.
        """
        lower, upper = (self.stages(stage, coordinates) for stage, coordinates in enumerate(few))
        rotation = lower.rotation[:, None] * self.mode_turn @ upper.rotation.mT
        centre = lower.centre[:, None] - (rotation @ upper.centre[..., None])[..., 0]
        points = centre[:, :, None] + body @ rotation.mT
        first, second = np.indices(points.shape[:2]).reshape(2, -1)
        return np.stack([few[0][first], few[1][second]], axis=1), points.reshape(len(first), -1)

    @cached_property
    def sample(self) -> FloatArray:
        """States within the limits, (n, 2, 3), drawn from a fixed seed."""
        return self.draw(_SAMPLE, np.random.default_rng(_SEED))

    @cached_property
    def tree(self) -> KDTree:
        """Search tree of the positions of o at the samples."""
        return KDTree(self.positions(self.sample))


def pose_multiplicity(states: StateSet, configurations: Configuration) -> IntArray:
    """Return how many physical states within the limits have the pose of each of `configurations` (N,), (N,)."""
    branches = inverse_displacement(states.machine, configurations.pose).configurations
    within = states.admits(branches.readings).all(axis=-1)
    # A state at a limit may miss it by rounding: it counts itself at least.
    return np.asarray(np.maximum((branches.is_at_home & within).sum(axis=-1), 1), dtype=np.intp)


def given_limits(machine: Machine, limits: LegLimits | None) -> LegLimits | None:
    """Return the limits if given, otherwise those of the machine, otherwise None."""
    check_machine(machine)
    return machine.limits if limits is None else machine.check_limits(limits)


def finite_limits(machine: Machine, limits: LegLimits | None) -> LegLimits:
    """Return leg limits, or those of the machine; raises `ArgumentError` if one is missing or infinite."""
    limits = given_limits(machine, limits)
    if limits is None:
        raise ArgumentError("limits", "LegLimits(minimum, maximum)", None, "The machine has none of its own")
    for leg, ends in zip(machine.legs.names, zip(limits.minimum, limits.maximum, strict=True), strict=True):
        if not np.isfinite(ends).all():
            expected = "a finite minimum and maximum for every leg"
            raise ArgumentError("limits", expected, f"infinity for {leg}", "The reachable set is unbounded then")
    return limits


def states_within(machine: Machine, limits: LegLimits | None = None) -> StateSet:
    """Return the physical states within `limits`, or within those of `machine`; these have to be finite."""
    return _checked(machine, finite_limits(machine, limits))


@lru_cache(maxsize=8)
def _checked(machine: Machine, limits: LegLimits) -> StateSet:
    # A leg whose length is zero has no direction.
    maximum, least = np.array(limits.maximum), np.array(machine.legs.free_limits.minimum)
    minimum, stages = np.maximum(limits.minimum, least + 1e-6 * np.abs(maximum)), len(machine.stage_radii)
    states = StateSet(machine, minimum, maximum, "T" * stages, (HOME_ASPECT,) * stages)
    if not all(map(len, states.few)):
        received = f"{limits!r}, which reach no pose"
        cause = "Too short to join the platforms, too different from each other, or in another unit?"
        raise ArgumentError("limits", "leg limits within which the machine can be assembled", received, cause)
    return states


def states_around(near: Configuration, limits: LegLimits) -> tuple[StateSet, FloatArray]:
    """Return the states within limits on the side of forward singularities of `near`, and its coordinates (1, 2, 3)."""
    machine, joints = near.machine, near.middle_joints[None]
    batch = Configuration.from_arrays(machine, near.rotation[None], near.translation[None], joints)
    states = StateSet(machine, *limits.ends)
    start = states.coordinates(batch)
    stages = [states.stages(stage, start[:, stage]) for stage in range(2)]
    readings = np.concatenate([stage.readings[0] for stage in stages])
    # These are not coordinates of a state in another mode.
    if all(stage.in_aspect[0] for stage in stages) and np.abs(readings - near.readings).max() <= 1e-6 * states.radius:
        return states, start
    modes = FAMILIES[int(family(near))]
    free = StateSet(machine, states.minimum, states.maximum, modes, (1.0, 1.0))
    start = free.coordinates(batch)
    lower, upper = (float(np.sign(free.stages(stage, start[:, stage]).determinant[0])) for stage in range(2))
    return StateSet(machine, states.minimum, states.maximum, modes, (lower, upper)), start


def free_states(machine: Manipulator, modes: str) -> StateSet:
    """Return all states of a family, whatever the readings, on all sides of forward singularities."""
    return StateSet(machine, np.full(6, -np.inf), np.full(6, np.inf), modes, (ANY_ASPECT, ANY_ASPECT))


def sample_reachable(
    machine: Machine,
    count: int,
    limits: LegLimits | None = None,
    *,
    space: Literal["legs", "poses"] = "legs",
    where: Condition | None = None,
    rng: np.random.Generator | int | None = None,
    progress: Progress | None = None,
) -> Any:
    """Draw random physical states within leg limits.

    Parameters
    ----------
    machine : Manipulator or Stage
        The machine.
    limits : LegLimits, optional
        Leg limits; the machine's own if not given.
    count : int
        How many.
    space : str
        "legs": uniform in the readings that belong to a configuration. "poses": uniform in the reachable poses, with
        the volume of positions times the uniform measure of rotations; for a stage in the heights and normals.
    where : callable, optional
        Takes states (n,) and returns which of them count, (n,), such as `JointLimits`; all if not given.
    rng : Generator or int, optional
        Source of randomness, or its seed.
    progress : callable, optional
        Called with the current task, the number of states found, and `count`.

    Returns
    -------
    Configuration
        Of shape (count,).

    Notes
    -----
    For poses, coordinates c of the stages are drawn uniformly and states kept in proportion to |det ∂(o, R)/∂c| over
    the number of states with the same pose. The largest value is taken from what has been drawn; all is drawn again
    whenever a larger one comes up.
    """
    count = whole_number(count, "count")
    choice(space, "space", ("legs", "poses"))
    states, rng, report = states_within(machine, limits), generator(rng), shown_progress(progress)
    parts, largest, kept = [np.empty((0, len(states.aspects), 3))], 0.0, 0
    for _ in range(_MOST_CHUNKS):
        report("reachable states", min(kept, count), count)
        if kept >= count:
            break
        number = min(max(4 * count, 64), _CHUNK)
        if space == "legs":
            parts.append(states.draw_in_readings(number, rng))
        else:
            coordinates = states.draw(number, rng)
            density = states.densities(coordinates)
            if density.max() > largest:
                # A bound that a later sample will hardly exceed.
                parts, largest = [parts[0]], 1.2 * float(density.max())
            parts.append(coordinates[rng.uniform(size=number) * largest < density])
        if where is not None:
            parts[-1] = parts[-1][check_condition(where, states.states(parts[-1]))]
        kept = sum(len(part) for part in parts)
    else:
        name, which = ("limits", "are within") if where is None else ("where", "satisfy")
        raise ArgumentError(name, f"one that enough random states {which}", f"one that {kept} of {count} {which}")
    return states.states(np.concatenate(parts)[:count])
