"""Certificates that leg limits hold no forward singularity, so that six readings mean one configuration.

For one machine the result has its least determinants and a counterexample; for many machines only which are free of
forward singularities, with all their symmetric stages at once. Derivation: `docs/theory/proofs.md`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.errors import ArgumentError, GeometryError, SpmError, raised_as
from spm_pin.kinematics.forward_displacement import forward_physical
from spm_pin.kinematics.path_following import existing_share
from spm_pin.kinematics.singularity_analysis import determinants
from spm_pin.machine.configuration import Configuration, check_configuration
from spm_pin.machine.legs import LegLimits
from spm_pin.machine.machine import Machine, check_machine
from spm_pin.machine.manipulator import Manipulator
from spm_pin.machine.stage import Stage
from spm_pin.proofs.stage_proof import (
    DEEPEST,
    Boxes,
    Int64Array,
    StageProof,
    StageRegion,
    are_in_boxes,
    configuration_at,
    edges,
    examine,
    first_boxes,
    halves,
    joined,
    prove_stage,
    region_coordinates,
    rounded_down,
)
from spm_pin.support.arguments import BoolArray, FloatArray, real_array, real_number, whole_number

_ROUNDING = 1e-15
"""Rounding of a parameter of a machine, in metres per metre of its size, and in radians."""
_SAME = 1e-6
"""Distance of balls, in middle sides, below which configurations next to a fold are the same."""
_LINES = 1_000
"""Lines of readings along which a forward singularity is looked for."""
_FIRST_LEVEL = 3
"""Level of division that symmetric stages begin with."""
_SLOPE = 1.7320508075689
"""A little more than √3, so that rounding leaves no box out."""
_FLAT = 1e-10
"""Least Z² of a level state over its legs' length squared: above this it exists, and is accurate enough for
`joined`."""


@dataclass(frozen=True)
class Certificate:
    """Result of a proof about the configurations that are joined to the home within leg limits."""

    machine: Manipulator | Stage
    """The nominal machine."""
    limits: LegLimits
    """Limits of the readings."""
    stages: tuple[StageProof, ...]
    """Subdivision of each stage: for a manipulator of the lower and of the upper one."""
    witness: Configuration | None
    """A forward singular configuration within the limits, where one was found; None otherwise. It lies in a box that is
    joined to the home through other boxes of the nominal machine alone, without errors, so it may still not be joined
    to the home itself."""
    errors: tuple[float, float] = (0.0, 0.0)
    """The `length_error` [m] and `angle_error` [rad] of the machines it is proved for, see `certify`."""

    @property
    def holds(self) -> bool:
        """True if it is proved that no configuration joined to the home within the limits is singular.

        Singular means forward singular, or in a singularity of a leg itself, beyond which its working mode changes.
        """
        return all(proof.bound > 0.0 for proof in self.stages)

    @property
    def verdict(self) -> str:
        """The result in a word or two: "proved"; "not proved", if there is a `witness`; or "undecided"."""
        return "proved" if self.holds else "undecided" if self.witness is None else "not proved"

    @property
    def bounds(self) -> tuple[float, ...]:
        """Proved lower bounds of |det J| / d³ of each stage, J_b and J_c, over these configurations; 0 where undecided.

        d is the side of the triangle of balls.
        """
        return tuple(proof.bound / self.machine.ball_side**3 for proof in self.stages)

    @property
    def undecided(self) -> tuple[FloatArray, ...]:
        """Boxes of (x, y, Z) of each stage that were not decided, shapes (N, 3, 2).

        (x, y) is the vector part of the quaternion (x0, x, y, 0) of the platform on the balls against the base (of an
        upper stage the terminal platform, seen upside down), Z [m] the distance of its centre from the plane of the
        legs' bases.
        """
        return tuple(proof.undecided for proof in self.stages)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the stages' matrices."""
        return ("J",) if len(self.stages) == 1 else ("J_b", "J_c")

    def concerns(self, machine: Machine) -> bool:
        """Return whether a machine, its limits aside, is one of those that the certificate is about."""
        errors = _deviation(check_machine(machine), self.machine)
        most = _widened(self.machine, self.errors)
        return errors[0] <= most[0] and errors[1] <= most[1]

    def covers(self, configuration: Configuration) -> BoolArray:
        """Return which configurations (...) are proved to be the only one of their readings, shape (...).

        They respect the limits, and their stages lie in boxes of the proof. Nothing is covered if it does not hold.
        """
        check_configuration(configuration)
        if not self.concerns(configuration.machine):
            raise ArgumentError("configuration", "a state of the certificate's machine", "a state of another machine")
        inside = self.limits.contains(configuration.readings)
        if not self.holds:
            return np.zeros_like(inside)
        states = region_coordinates(configuration)
        for k, proof in enumerate(self.stages):
            inside = inside & are_in_boxes(states[..., k, :], proof.proved)
        return np.asarray(inside)

    def explain(self) -> str:
        """Return the statement proved, or the counterexample or doubt that is left, in a few lines."""
        low, high = self.limits.minimum, self.limits.maximum
        ranges = dict.fromkeys(
            f"{self._reading(min(low[k : k + 3]), k, 'g')} to {self._reading(max(high[k : k + 3]), k, 'g')}"
            for k in range(0, len(low), 3)
        )
        lines = [f"Readings from {' and '.join(ranges)}, {sum(proof.boxes for proof in self.stages):,} boxes."]
        if any(self.errors):
            errors = f"{1e3 * self.errors[0]:.3g} mm and {1e3 * self.errors[1]:.3g} mrad"
            lines.append(f"For all machines whose dimensions, offsets and axes are within {errors} of the nominal.")
        if self.holds:
            pairs = zip(self.names, self.bounds, strict=True)
            least = " and ".join(f"|det {name}| >= {rounded_down(bound)} d³" for name, bound in pairs)
            legs = "" if self.machine.legs.are_rps else ", nor is a leg singular itself"
            lines += [
                f"Proved: no configuration joined to the home within these limits is forward singular{legs},",
                f"{least}.",
                "So readings within them have exactly one such configuration, and straight lines of readings are",
                "free of forward singularities. Assembly modes that are not joined to the home are not part of this.",
            ]
        elif self.witness is not None:
            lines += [
                "Not proved: a configuration of the nominal machine within the limits is forward singular, with",
                f"({self._readings(self.witness)}), in a box that a chain of touching boxes joins to that of the home.",
                *self._whose(),
            ]
        elif any(proof.singular is not None for proof in self.stages):
            lines += [
                "Undecided, for errors this large: boxes that they leave undecided lead to a singular configuration,",
                "where none was found for the nominal machine alone. Smaller errors help, and narrower limits.",
            ]
        else:
            smaller = ", or smaller errors" if any(self.errors) else ""
            lines.append("Undecided: no singular configuration was found, and none was excluded. More boxes may help,")
            lines.append(f"and narrower limits{smaller}.")
        for name, boxes in zip(self.names, self.undecided, strict=True):
            if len(boxes):
                half_sine = float(np.sqrt((boxes[:, :2] ** 2).max(axis=2).sum(axis=1).max()))
                tilt = np.degrees(2.0 * np.arcsin(min(half_sine, 1.0)))
                lines.append(f"Undecided: {len(boxes):,} boxes of {name}, tilted by up to {tilt:.0f}°.")
        return "\n".join(lines)

    def _reading(self, reading: float, leg: int, form: str = ".6f") -> str:
        """Return a reading with its unit, an angle in degrees."""
        is_angle = self.machine.legs.units[leg] == "rad"
        return f"{np.degrees(reading):{form}}°" if is_angle else f"{reading:{form}} m"

    def _readings(self, state: Configuration) -> str:
        return ", ".join(self._reading(reading, leg) for leg, reading in enumerate(state.readings))

    def _whose(self) -> list[str]:
        """Return a text on the behaviour at the readings of the singular configuration, and on remedies."""
        assert self.witness is not None
        physical = forward_physical(self.machine, self.witness.readings)
        apart = np.abs(physical.balls - self.witness.balls).max() / self.machine.ball_side
        if apart > _SAME:
            least = np.abs(determinants(physical)[:-1]).min() / self.machine.ball_side**3
            whose = f"As assembled it is in another one with these readings, a regular one: |det J| is {least:.2g} d³."
        else:
            whose = "The machine as assembled is there singular, or ends in it."
        smaller = ", and so do smaller errors" if any(self.errors) else ""
        return [whose, f"Narrower limits help: largest_certified_limits finds the widest{smaller}."]

    def __repr__(self) -> str:
        return f"<Certificate: {self.verdict}>"


def certify(
    machine: Manipulator | Stage,
    limits: LegLimits | Sequence[float] | None = None,
    *,
    boxes: int = 300_000,
    length_error: float = 0.0,
    angle_error: float = 0.0,
) -> Certificate:
    """Prove that leg limits exclude forward singularities, and singularities of legs.

    The region that is joined, within the limits, to the physical configuration at their middle is proved free of them,
    by interval branch and bound over all orientations without torsion and all heights, stage by stage. It follows that
    readings within the limits have exactly one configuration there, and that no straight line of readings meets a
    singularity; see `docs/theory/proofs.md`.

    Parameters
    ----------
    machine : Manipulator or Stage
        For a calibrated machine the proof is for all machines that are as near to the nominal one, apart from the
        choice of the frame {n} of the balls.
    limits : LegLimits, optional
        Finite limits of the readings, `LegLimits` or a pair; by default those of the machine.
    boxes : int
        Maximum number of boxes in each stage.
    length_error : float
        Prove it for every machine of which no coordinate of a pivot or a ball, no rod or crank, and no offset of a
        reading differs by more than this from that of `machine` [m]. Its dimensions are among these, with the same
        error.
    angle_error : float
        Bound of the rotation of each axis about either perpendicular direction, and of the errors of the directions of
        slides and of the offsets of angles [rad].

    Returns
    -------
    Certificate
        If it does not hold, it contains a singular configuration, if one was found, and the undecided boxes.
    """
    check_machine(machine)
    nominal = machine.nominal
    allowed = nominal.limits if limits is None else machine.check_limits(limits)
    whole_number(boxes, "boxes", least=1)
    most = 0.25 * min(nominal.dimensions)
    expected = f"metres from 0 to {most:g}, a quarter of the smallest dimension"
    real_number(length_error, "length_error", expected, least=0.0, most=most)
    real_number(angle_error, "angle_error", "radians from 0 to 0.2", least=0.0, most=0.2, cause="Given in degrees?")
    length, angle = _deviation(machine, nominal)
    errors = length_error + length, angle_error + angle
    if errors[0] > most or errors[1] > 0.2:
        received = f"one that differs by {length:g} m and {angle:g} rad, to which the errors are added"
        raise ArgumentError("machine", f"a machine within {most:g} m and 0.2 rad of the nominal one", received)
    if allowed is None or not allowed.are_finite:
        received = "none" if allowed is None else f"{allowed!r}"
        raise GeometryError("limits", "finite limits of every reading", received)
    middle = forward_physical(nominal, allowed.ends.mean(axis=0))
    if not middle.exists:
        raise GeometryError(
            "limits", "limits whose middle readings can be assembled", "limits whose middle cannot be assembled"
        )
    starts = region_coordinates(middle)
    regions = stage_regions(nominal, allowed, errors)
    proofs = [prove_stage(region, start, most=boxes) for region, start in zip(regions, starts, strict=True)]
    witness, found = None, proofs
    if any(errors) and any(proof.singular is not None for proof in proofs):
        # Boxes that the errors leave undecided may lead to states that the nominal machine does not reach.
        alone = stage_regions(nominal, allowed, (0.0, 0.0))
        found = [prove_stage(region, start, most=boxes) for region, start in zip(alone, starts, strict=True)]
    if any(proof.singular is not None for proof in found):
        pairs = zip(starts, found, strict=True)
        states = [start if proof.singular is None else proof.singular for start, proof in pairs]
        witness = configuration_at(nominal, np.stack(states))
    return Certificate(nominal, allowed, tuple(proofs), witness, errors)


def largest_certified_limits(
    machine: Manipulator | Stage,
    centre: npt.ArrayLike | None = None,
    *,
    tolerance: float = 0.01,
    boxes: int = 300_000,
    length_error: float = 0.0,
    angle_error: float = 0.0,
) -> Certificate:
    """Find the widest leg limits around given readings that are proved free of forward singularities.

    All readings may differ from their centre by the same amount, and must have one unit. Limits cannot be certified if
    a line from the centre meets a forward singularity within them; a width just within the nearest of many such
    singularities is tried first, then the width is bisected.

    Parameters
    ----------
    machine : Manipulator or Stage
        Its dimensions.
    centre : array_like, shape (6,); for a stage (3,), or (), optional
        Readings in the middle [m] ([rad] for RRS legs); by default the middle of the machine's limits.
    tolerance : float
        Largest difference from the widest half-width that can be certified, relative to it.
    boxes : int
        Maximum number of boxes in each stage, for each limits tried.
    length_error, angle_error : float
        Prove it for all machines within these errors [m, rad], see `certify`.

    Returns
    -------
    Certificate
        It holds; its `limits` are the answer.
    """
    legs = check_machine(machine).legs
    count = len(legs.names)
    if len(set(legs.units)) > 1:
        cause = "All readings may differ from their centre by the same amount"
        raise GeometryError("machine", "a machine whose readings have one unit", "metres and radians", cause)
    real_number(tolerance, "tolerance", "a relative width between 1e-6 and 1", least=1e-6, below=1.0)
    if centre is None:
        if machine.limits is None or not machine.limits.are_finite:
            raise ArgumentError("centre", "readings, as the machine has no finite limits", "None")
        centre = machine.limits.ends.mean(axis=0)
    readings = real_array(centre, "centre", (), f"readings in {legs.unit_text()}")
    if readings.shape not in ((), (count,)):
        raise ArgumentError("centre", f"one reading or {count}", f"shape {readings.shape}")
    readings = np.broadcast_to(readings, count)
    with raised_as(ArgumentError, "centre"):
        assembled = forward_physical(machine, readings).exists
    if not assembled:
        received = f"{readings.max():g} {legs.units[0]} at the largest"
        raise ArgumentError("centre", "readings with which the machine can be assembled", received)
    # No length falls to zero, no rod is passed on its slide, and no crank turns farther than round.
    reach = np.pi if legs.units[0] == "rad" else float(legs.circles(readings)[1].min())
    rng = np.random.default_rng(0)
    directions = np.concatenate([list(product((-1.0, 1.0), repeat=count)), rng.uniform(-1.0, 1.0, (_LINES, count))])
    directions /= np.abs(directions).max(axis=-1, keepdims=True)
    ends = readings + 0.999 * reach * directions
    shares = existing_share(partial(forward_physical, machine), readings, ends)
    best, narrow, wide = None, 0.0, 0.999 * reach * float(shares.min())
    half = (1.0 - 0.9 * tolerance) * wide
    while wide - narrow > tolerance * wide:
        limits = LegLimits(tuple(readings - half), tuple(readings + half))
        certificate = certify(machine, limits, boxes=boxes, length_error=length_error, angle_error=angle_error)
        if certificate.holds:
            best, narrow = certificate, half
        else:
            wide = half
        half = 0.5 * (narrow + wide)
        if best is None and wide < 1e-6 * reach:
            raise ArgumentError("centre", "readings away from forward singularities", readings)
    assert best is not None
    return best


def stage_regions(machine: Machine, limits: LegLimits, errors: tuple[float, float] = (0.0, 0.0)) -> list[StageRegion]:
    """Return the regions of the stages to be searched, lower first, for all machines within errors [m, rad]."""
    ends = limits.admitted.reshape(2, -1, 3).swapaxes(0, 1)
    widened = _widened(machine, errors)
    return [
        StageRegion(radius, machine.ball_side, low, high, kind, *widened, up=kind.up)
        for (radius, _), (low, high), kind in zip(machine.stage_radii, ends, machine.legs.kinds, strict=True)
    ]


def _widened(machine: Machine, errors: tuple[float, float]) -> tuple[float, float]:
    """Return errors enlarged by rounding, so that a machine on their edge is within them; zeros stay zeros."""
    length, angle = errors
    return (length + _ROUNDING * sum(machine.dimensions), angle + _ROUNDING) if any(errors) else errors


def _deviation(machine: Machine, nominal: Machine) -> tuple[float, float]:
    """Return the largest errors of a machine's lengths [m] and angles [rad] against a nominal one.

    Infinite if the legs are of other kinds, or if one platform hangs and the other does not. The frame {n} is where the
    balls are nearest to the nominal ones, if that is better.
    """
    if machine.is_nominal and machine.dimensions == nominal.dimensions and machine.legs.kinds == nominal.legs.kinds:
        return 0.0, 0.0
    if (
        machine.parameter_names != nominal.parameter_names
        or (machine.legs.slope_signs != nominal.legs.slope_signs).any()
        or [kind.up for kind in machine.legs.kinds] != [kind.up for kind in nominal.legs.kinds]
    ):
        return np.inf, np.inf
    balls, drawn = machine.legs.balls, nominal.nominal.legs.balls
    turn, _ = Rotation.align_vectors(drawn - drawn.mean(axis=0), balls - balls.mean(axis=0))
    moved = turn.apply(balls - balls.mean(axis=0)) + drawn.mean(axis=0)
    offs = min(np.abs(points - drawn).max() for points in (balls, moved))
    # Directions of the axes are counted from the nominal ones, which are the same for all dimensions.
    errors = np.abs(machine.parameters - nominal.nominal.parameters)
    are_angles = np.array(machine.parameter_units) == "rad"
    are_balls = np.array([".ball" in name for name in machine.parameter_names])
    return float(max(offs, errors[~are_angles & ~are_balls].max())), float(errors[are_angles].max())


def free_of_singularities(machines: Sequence[Manipulator | Stage], boxes: int) -> BoolArray:
    """Return a mask (N,) of the machines that are proved free of forward singularities within their limits.

    At most `boxes` are looked at for a stage. Where its legs have equal limits, the stage is the same after a turn by
    120° about its axis, and in a mirror, which exchanges legs; a sixth of its states, 0 <= y <= √3 x, stands for all: a
    path in the others, mirrored wherever it leaves the sixth, stays within it. Other machines are given to `certify`.
    """
    regions = [stage_regions(machine, machine.limits) for machine in machines if machine.limits is not None]
    symmetric = [
        machine.is_nominal
        and machine.legs.are_rps
        and all(np.ptp(ends) == 0.0 for region in own for ends in (region.minimum, region.maximum))
        for machine, own in zip(machines, regions, strict=True)
    ]
    free = np.zeros(len(machines), dtype=np.bool_)
    owner = np.array([k for k, own in enumerate(regions) if symmetric[k] for _ in own], dtype=np.intp)
    if len(owner):
        free[symmetric] = True
        are_free = _stages_free([region for k in np.unique(owner) for region in regions[k]], boxes)
        free[owner[~are_free]] = False
    for index, (machine, equal) in enumerate(zip(machines, symmetric, strict=True)):
        if not equal:
            with contextlib.suppress(SpmError):
                free[index] = certify(machine, boxes=boxes).holds
    return free


def _stages_free(stages: Sequence[StageRegion], most: int) -> BoolArray:
    """Return which stages (S,) have no singular state joined to the level one with the lengths in the middle."""
    every = StageRegion(
        np.array([stage.leg_base_radius for stage in stages]),
        np.array([stage.side for stage in stages]),
        np.stack([stage.minimum for stage in stages], axis=-1),
        np.stack([stage.maximum for stage in stages], axis=-1),
    )
    scale, length = edges(every), 0.5 * (every.minimum[0] + every.maximum[0])
    square = length**2 - (every.side / np.sqrt(3.0) - every.leg_base_radius) ** 2
    start = np.stack(
        [0.0 * square, 0.0 * square, np.sqrt(np.where(square > _FLAT * length**2, square, np.nan))], axis=-1
    )
    boxes = np.tile(first_boxes(_FIRST_LEVEL), len(stages))
    boxes["stage"] = np.repeat(np.arange(len(stages)), len(boxes) // len(stages))
    seen, free = np.full(len(stages), 8**_FIRST_LEVEL), np.zeros(len(stages), dtype=np.bool_)
    kept = boxes[:0]
    while len(boxes):
        boxes = boxes[_in_sixth(boxes)]
        stage = boxes["stage"]
        kept = np.concatenate([kept, examine(_each(every, stage), scale[stage], boxes)])
        kept = kept[joined(scale[kept["stage"]], kept, start[kept["stage"]])]
        stage, undecided = kept["stage"], ~(kept["bound"] > 0.0)
        count = np.bincount(stage[undecided], minlength=len(stages))
        free |= (count == 0) & (np.bincount(stage, minlength=len(stages)) > 0)
        seen += 8 * count
        going_on = (count > 0) & (seen <= most)
        going_on[stage[undecided & (kept["level"] == DEEPEST)]] = False
        boxes = halves(kept[undecided & going_on[stage]])
        kept = kept[~undecided & going_on[stage]]
    return free


def _each(every: StageRegion, stage: Int64Array) -> StageRegion:
    """Return the regions of boxes, of the stages (N,)."""
    radius, side = (np.asarray(numbers)[stage] for numbers in (every.leg_base_radius, every.side))
    return StageRegion(radius, side, every.minimum[:, stage], every.maximum[:, stage])


def _in_sixth(boxes: Boxes) -> BoolArray:
    """Return which boxes may have a point with 0 <= y <= √3 x."""
    size, (x, y, _) = np.ldexp(1.0, 1 - boxes["level"]), boxes["position"].T
    most_x, most_y = (x + 1) * size - 1.0, (y + 1) * size - 1.0
    return np.asarray((most_y >= 0.0) & (most_x >= 0.0) & (most_y - size <= _SLOPE * most_x))
