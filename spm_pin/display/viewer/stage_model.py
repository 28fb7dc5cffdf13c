"""The state of a session of a stage alone: its platform is dragged in tilt and height, and all else follows."""

from __future__ import annotations

import math
import shlex
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from spm_pin.display.viewer.model import Measure, Model, ShownState, excess_warnings
from spm_pin.display.writing import fixed
from spm_pin.kinematics import inverse_physical, singularities
from spm_pin.kinematics.stage_displacement import normals_of_request
from spm_pin.machine import Configuration, Stage
from spm_pin.support.arguments import FloatArray
from spm_pin.workspace import height_range, nearest_reachable_pose, reach

_NEAR = 0.1
"""A singularity is near if its smallest singular value, or the relative slope of a leg, is below this."""
_DIRECTIONS = 24
"""Number of directions of the largest tilt."""
_ROLL, _TILT = "height, roll, pitch", "height, tilt, azimuth"
"""Conventions of the coordinates of the pose: names of properties of a state."""


class StageState(ShownState):
    """A state of a stage alone."""

    label: ClassVar[str] = ""
    labels: ClassVar[tuple[str, ...]] = ()
    notes: ClassVar[tuple[str, ...]] = ()
    is_physical: ClassVar[bool] = True
    title: ClassVar[str] = "Mode T"

    @cached_property
    def measures(self) -> list[Measure]:
        """Distances of the platform's singularities, and of the nearest leg singularity."""
        found = singularities(self.shown)
        sigmas = {"forward": found.forward, "inverse": found.inverse, "leg's own": found.leg.min()}
        rows = [(name, float(sigma)) for name, sigma in sigmas.items()]
        return [Measure(name, sigma < _NEAR, min(sigma, 1.0), "", sigma, None) for name, sigma in rows]

    @cached_property
    def warnings(self) -> list[str]:
        """Warnings to the user, the most important first."""
        near = [f"Singularity ahead ({measure.name})." for measure in self.measures if measure.is_near]
        return [*self.remarks, *near, *excess_warnings(self.shown, self.forces)]

    def pose_text(self, convention: str) -> str:
        """Return tilt and height, and the parasitic motion."""
        height, *angles = _coordinates(self.shown, convention)
        names = zip(convention.split(", ")[1:], angles, strict=True)
        shift = ", ".join(fixed(1e3 * x, 1) for x in self.shown.shift)
        wanted = ", ".join(f"{name} {fixed(angle, 1)}°" for name, angle in names)
        torsion = fixed(math.degrees(self.shown.torsion), 2)
        return f"height {fixed(height, 1)} mm, {wanted}; shift ({shift}) mm, torsion {torsion}°"


class StageModel(Model):
    """A stage's state and its transitions, from a physical configuration."""

    state: StageState
    kind = StageState
    conventions: ClassVar[dict[str, tuple[str, ...]]] = {
        _ROLL: ("height [mm]", "roll [°]", "pitch [°]"),
        _TILT: ("height [mm]", "tilt [°]", "azimuth [°]"),
    }
    hint = "Roll and pitch of the normal alone, torsion aside, or the direction in which the platform is lowest"
    values_name = "Readings"

    def __init__(self, start: Configuration, file: Path | None = None) -> None:
        super().__init__(file)
        self._stage = start.machine
        self.state = StageState(start.pose, start, 0.0, np.zeros(6))

    def drag(self, target: RigidTransform) -> Any:
        """Move to the normal and the height of a pose, or to the nearest reachable ones."""
        stage, normal, height = self._stage, target.rotation.as_matrix()[:, 2], float(target.translation[2])
        wanted = inverse_physical(stage, height, normal=normal)
        held = self.hold_limits and not self.state.shown.limit_excess.any()
        if wanted.exists and not (held and wanted.limit_excess.any()):
            return self._show(wanted.pose, wanted)
        free = stage if held else Stage(stage.base_radius, stage.platform_radius, stage.legs)
        shown = nearest_reachable_pose(free, height, normal=normal).configuration
        shown = Configuration(stage, shown.pose) if shown.exists else self.state.shown
        rotation, _ = Rotation.align_vectors(normal, shown.normal)
        pose = RigidTransform.from_components([*shown.shift, height], rotation * shown.pose.rotation)
        distance = float(np.linalg.norm(Configuration(stage, pose).balls - shown.balls)) / math.sqrt(3.0)
        why = wanted.missing_reason or "beyond the leg limits"
        away = f"{fixed(1e3 * distance, 1)} mm away" if distance > 1e-4 else "less than 0.1 mm away"
        remarks = [f"Out of reach: {why}. Shown: the nearest reachable tilt, {away}."]
        return self._show(pose, shown, distance=distance, remarks=remarks)

    def coordinates(self, pose: RigidTransform, convention: str) -> FloatArray:
        """Return the values of the pose's sliders."""
        return _coordinates(Configuration(self._stage, pose), convention)

    def pose_of(self, coordinates: FloatArray, convention: str) -> RigidTransform:
        """Return a pose with the normal and the height of such values."""
        angles = dict(zip(convention.split(", ")[1:], np.radians(coordinates[1:]), strict=True))
        turn, _ = Rotation.align_vectors(normals_of_request(**angles), [0.0, 0.0, 1.0])
        return RigidTransform.from_components([0.0, 0.0, 1e-3 * coordinates[0]], turn)

    def pose_ranges(self, convention: str) -> FloatArray:
        """Return the ends (3, 2) of the pose's sliders: heights of the level platform near its own, and tilts there."""
        shown, size = self.state.shown, self._stage.size
        heights = np.clip(height_range(self._stage), shown.height - size, shown.height + size)
        tilts = reach(self._stage, shown.height, directions=_DIRECTIONS).tilts
        largest = np.degrees(np.nanmax(tilts, initial=float(shown.tilt)))
        ends = [(-largest, largest)] * 2 if convention == _ROLL else [(0.0, largest), (-180.0, 180.0)]
        return np.array([1e3 * heights, *ends])

    def command(self, digits: int | None = None) -> str:
        """Return the command line for the state shown, with a file for a stage that dimensions do not describe."""
        stage, (height, roll, pitch) = self._stage, _coordinates(self.state.shown, _ROLL).tolist()
        typed = f"--stage {'FILE' if self.file is None else shlex.quote(str(self.file))}"
        ends = np.empty((2, 0)) if stage.limits is None else stage.limits.ends
        if self.file is None and stage.is_nominal and (ends == ends[:, :1]).all():
            lengths = {"base": stage.base_radius, "platform": stage.platform_radius, **stage.kind.as_data()}
            del lengths["kind"]
            if "direction" in lengths:
                lengths["slide"] = math.degrees(lengths.pop("direction"))
            typed = " ".join(f"--{name} {x!r}" for name, x in lengths.items())
            for least, most in (ends if stage.unit == "m" else np.degrees(ends)).T[:1].tolist():
                typed += f" --limits {least!r} {most!r}"
        return f"spm-pin stage inverse {typed} --height {1e-3 * height!r} --roll {roll!r} --pitch {pitch!r}"

    def values(self) -> FloatArray:
        """Return the readings of the state shown [m], for RRS legs [rad]."""
        return np.asarray(self.state.shown.readings)

    def data(self) -> dict[str, Any]:
        """Return the state shown as data for JSON, in metres, radians and newtons."""
        names = "tilt", "azimuth", "roll", "pitch", "height", "shift", "torsion", "balls"
        singular = {measure.name: measure.sigma for measure in self.state.measures}
        return super().data() | {name: getattr(self.state.shown, name) for name in names} | {"singularity": singular}


def _coordinates(state: Configuration, convention: str) -> FloatArray:
    """Return the height [mm] and the two angles [degrees] of a state that the convention names."""
    angles = [np.degrees(getattr(state, name)) for name in convention.split(", ")[1:]]
    return np.array([1e3 * state.height, *angles]) + 0.0
