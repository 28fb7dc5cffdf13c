"""Following a state of a stage along a path of tilts and heights, or of readings, as for a manipulator."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy

from spm_pin.errors import ArgumentError
from spm_pin.kinematics.forward_displacement import forward_displacement
from spm_pin.kinematics.readings import read_readings
from spm_pin.kinematics.stage_displacement import inverse, normals_of_request, read_heights
from spm_pin.kinematics.stage_rates import determinants
from spm_pin.kinematics.tracking import EventKind, FollowedPath, Watch, followed
from spm_pin.machine.configuration import Configuration
from spm_pin.machine.solutions import SolutionSet
from spm_pin.machine.stage import Stage
from spm_pin.support.arguments import broadcastable, check_instance

_KINDS = (
    (EventKind.FORWARD_SINGULARITY, "the actuators do not hold the platform"),
    (EventKind.INVERSE_SINGULARITY, "the modes T and F meet"),
)


def follow(
    stage: Stage,
    readings: npt.ArrayLike | None = None,
    start: Configuration | str | None = None,
    *,
    height: npt.ArrayLike | None = None,
    tilt: npt.ArrayLike | None = None,
    azimuth: npt.ArrayLike | None = None,
    roll: npt.ArrayLike | None = None,
    pitch: npt.ArrayLike | None = None,
    normal: npt.ArrayLike | None = None,
    samples: int = 200,
) -> FollowedPath:
    """Follow one state of a stage along a path of readings, or of heights and tilts.

    Parameters
    ----------
    stage : Stage
        The stage. If it has limits, crossing one is an event.
    readings : array_like, shape (n, 3), optional
        Readings of the encoders at points of the path [m], for RRS legs [rad], on a line in between.
    start : Configuration or str, optional
        The state at the first point: the one nearest to it, or a label. By default the physical one.
    height, tilt, azimuth, roll, pitch, normal
        As for `inverse`, of shape (n,) together, instead of readings. Between two points the height and the components
        of the normal are interpolated on a line, and the normal is then made one of unit length.
    samples : int
        Smallest number of steps of the path.

    Returns
    -------
    FollowedPath
        The events are singularities, limits, changes of labels and the end of the state; see `spm_pin.follow`. Modes
        of readings have labels in stages with nominal RPS legs; otherwise that of the first point is kept.

    Examples
    --------
    >>> import numpy as np, spm_pin as spm
    >>> balancer = spm.Stage(0.08, 0.09, spm.RRS(crank=0.05, rod=0.11), limits=(-0.6, 1.2))
    >>> spm.follow(balancer, height=0.12, tilt=np.radians([0, 30]), azimuth=0.0)
    <FollowedPath: complete, 214 states of T; leg limit at 0.8901>
    """
    check_instance(stage, Stage, "stage")
    if (readings is None) == (height is None):
        expected = "readings of a path, or its heights with tilts"
        raise ArgumentError("readings", expected, "neither" if readings is None else "both")
    if readings is not None:
        points = read_readings(stage, readings)
    else:
        assert height is not None
        heights, normals = read_heights(stage, height), normals_of_request(tilt, azimuth, roll, pitch, normal)
        heights = np.broadcast_to(heights, broadcastable("height", heights.shape, "the tilts", normals.shape[:-1]))
        points = np.concatenate([np.broadcast_to(normals, (*heights.shape, 3)), heights[..., None]], axis=-1)
    if points.ndim != 2 or len(points) < 2:
        raise ArgumentError("readings" if height is None else "height", "two points or more, (n,)", points.shape[:-1])
    knots = np.linspace(0.0, 1.0, len(points))
    point = scipy.interpolate.make_interp_spline(knots, points, k=1)

    def solve(parameter: float) -> SolutionSet:
        here = point(parameter)
        if height is None:
            return forward_displacement(stage, here)
        return inverse(stage, here[3], normal=here[:3] / np.linalg.norm(here[:3]))

    # Only nominal stages with RPS legs have labels for the modes of readings.
    has_labels = height is not None or (stage.is_nominal and stage.legs.are_rps)
    watch = Watch(stage.ball_side, determinants, _KINDS, has_labels)
    return followed(watch, solve, knots, start, samples, has_legs=height is None)
