"""The metrics of this package: one decorated function each, which `METRICS` collects by name.

Metrics of a state describe the physical configuration within the leg limits, and are NaN where there is none. Those of
the Jacobian make it homogeneous: with a characteristic length L the twist is (v, Lω), so that singular values compare
speeds with speeds. By default L is the platform's radius C: then Lω is the speed that a rotation about o gives to the
joints c_i. Parameters are positive numbers.
"""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.kinematics import forward_displacement
from spm_pin.mechanism import BRANCHES, Status
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.sweeps.metric import Metric, metric
from spm_pin.sweeps.points import Points

Values = npt.NDArray[Any]

_ABSENT = "NaN where not reachable"
_MODES_AT_A_TIME = 64
"""Problems of forward displacement solved together: each takes 43 kB."""


@metric("1", "status of the displacement problem of the point", dtype="int8", flags={str(s): int(s) for s in Status})
def status(points: Points) -> Values:
    """Return the status; it is in every store, where it distinguishes "not computed" from "no value here"."""
    return points.status


@metric("1", "whether there is a physical configuration within the leg limits", dtype="int8", flags={"no": 0, "yes": 1})
def reachable(points: Points) -> Values:
    """Return 1 where there is a physical configuration within the leg limits, else 0."""
    return points.reachable


@metric("1", "number of real branches, leg limits aside", dtype="int8")
def branches(points: Points) -> Values:
    """Return the number of configurations that hold the pose."""
    return np.asarray(np.count_nonzero(~np.isnan(points.branch_lengths[..., 0]), axis=-1))


@metric("1", "number of real branches within the leg limits", dtype="int8")
def branches_within(points: Points) -> Values:
    """Return the number of configurations within the leg limits that hold the pose."""
    return np.asarray(np.count_nonzero(points.branches_within, axis=-1))


@metric(
    "1",
    "physical branch within the leg limits",
    dtype="int8",
    flags={"none": -1} | {label: k for k, label in enumerate(BRANCHES)},
)
def branch(points: Points) -> Values:
    """Return the branch of `Points.physical`, -1 where there is none."""
    # Where the state was found from leg lengths it is one of the branches up to rounding.
    gaps = np.abs(points.solutions.middle_joints - points.physical.middle_joints[:, None]).max(axis=(-1, -2))
    gaps = np.where(np.isnan(gaps), np.inf, gaps)
    return np.where(np.isfinite(gaps.min(axis=-1)), gaps.argmin(axis=-1), -1)


@metric(
    "1",
    "number of assembly modes that the leg lengths of the physical configuration allow; 0 where not reachable",
    dtype="int16",
)
def assembly_modes(points: Points) -> Values:
    """Return the number of poses that the leg lengths of `Points.physical` allow."""
    lengths = points.reached.leg_lengths
    parts = range(0, max(1, len(lengths)), _MODES_AT_A_TIME)
    counts = [forward_displacement(points.geometry, lengths[k : k + _MODES_AT_A_TIME]).count for k in parts]
    return points.spread(np.concatenate(counts), absent=0.0).astype(np.int16)


@metric("m", f"X of o in the base frame; {_ABSENT}")
def o_x(points: Points) -> Values:
    """Return the first coordinate of o."""
    return points.physical.translation[:, 0]


@metric("m", f"Y of o in the base frame; {_ABSENT}")
def o_y(points: Points) -> Values:
    """Return the second coordinate of o."""
    return points.physical.translation[:, 1]


@metric("m", f"Z of o in the base frame; {_ABSENT}")
def o_z(points: Points) -> Values:
    """Return the third coordinate of o."""
    return points.physical.translation[:, 2]


@metric(
    "m",
    "how far the worst leg is inside its limits, negative outside; "
    "NaN where no physical configuration exists, leg limits aside",
)
def leg_margin(points: Points) -> Values:
    """Return the margin of the worst leg; of the physical branches of a pose the one with the largest margin counts.

    Raises
    ------
    ArgumentError
        If the geometry has no leg limits.
    """
    if points.geometry.limits is None:
        raise ArgumentError("geometry", "one with leg limits, of which a margin can be left", "none")
    if points.space == "legs":
        return np.where(points.assembled.exists, points.limits.margin(points.coordinates), np.nan)
    margins = points.limits.margin(points.solutions.readings)
    best = np.where(points.solutions.is_physical, margins, -np.inf).max(axis=-1)
    return np.where(np.isinf(best), np.nan, best)


@metric("1", f"inverse condition number of the Jacobian of (v, L omega), L = length or the platform radius; {_ABSENT}")
def conditioning(points: Points, *, length: float | None = None) -> Values:
    """Return the inverse condition number: 0 at a singularity, 1 at an isotropic state.

    The local conditioning index of C. Gosselin, J. Angeles, "A global performance index for the kinematic optimization
    of robotic manipulators", Journal of Mechanical Design 113 (1991), of the homogeneous Jacobian.
    """
    values = points.singular_values(length)
    return points.spread(_zero_if_singular(values[:, -1] / values[:, 0]))


@metric(
    "1",
    "geometric over arithmetic mean of the eigenvalues of G G^T of (v, L omega), L = length or the platform radius; "
    + _ABSENT,
)
def isotropy(points: Points, *, length: float | None = None) -> Values:
    """Return geometric over arithmetic mean of the squared singular values: from 0 to 1.

    The measure of J.-O. Kim, P. K. Khosla, "Dexterity measures for design and control of manipulators", IROS 1991, of
    G, which maps leg rates to the twist (v, Lω).
    """
    values = points.singular_values(length)
    squares = (values / values[:, :1]) ** 2
    return points.spread(_zero_if_singular(squares.prod(axis=-1) ** (1.0 / 6.0) / squares.mean(axis=-1)))


@metric("1", f"least singular value of J_b and J_c: distance to a forward singularity; {_ABSENT}")
def forward_distance(points: Points) -> Values:
    """Return the smaller of the least singular values of J_b and J_c."""
    return points.spread(points.sigma[:, :2].min(axis=-1))


@metric("1", f"least singular value of K: distance to an inverse singularity; {_ABSENT}")
def inverse_distance(points: Points) -> Values:
    """Return the least singular value of K."""
    return points.spread(points.sigma[:, 2])


@metric("1", f"determinant of J_b, lower stage, forward, over d^3; {_ABSENT}")
def det_lower(points: Points) -> Values:
    """Return det J_b over d³."""
    return points.spread(points.determinants[:, 0])


@metric("1", f"determinant of J_c, upper stage, forward, over d^3; {_ABSENT}")
def det_upper(points: Points) -> Values:
    """Return det J_c over d³."""
    return points.spread(points.determinants[:, 1])


@metric("1", f"determinant of K, inverse, over d^3; {_ABSENT}")
def det_structure(points: Points) -> Values:
    """Return det K over d³."""
    return points.spread(points.determinants[:, 2])


@metric("N", f"largest force at o held in every direction with leg forces of at most push and pull; {_ABSENT}")
def payload(points: Points, *, push: float = 1.0, pull: float | None = None) -> Values:
    """Return the force that the machine holds at o whatever its direction, without a moment.

    `push` and `pull` are the largest forces of a leg [N]; `pull` is `push` if not given. By default the metric is the
    payload per newton of leg force. A leg of force a · u under the unit force u bears at most ``|a|``, in either sense:
    the payload is the least quotient of a leg's limit and its ``|a|``, without a search over directions.
    """
    # f = -Gᵀ w: a unit force u takes -G_v[:, i] · u of leg i, at most |G_v[:, i]| in either sense.
    largest = np.linalg.norm(points.platform_jacobians[:, :3], axis=-2).max(axis=-1)
    return points.spread(_zero_if_singular(min(push, push if pull is None else pull) / largest))


@metric("N", f"largest force at o held along -Z with leg forces of at most push and pull; {_ABSENT}")
def payload_down(points: Points, *, push: float = 1.0, pull: float | None = None) -> Values:
    """Return the force along -Z of {B} that the machine holds at o, without a moment: a weight. See `payload`."""
    forces = points.platform_jacobians[:, 2]
    share = np.maximum(forces / push, -forces / (push if pull is None else pull)).max(axis=-1)
    return points.spread(_zero_if_singular(1.0 / share))


@metric("N m-1", f"least translational stiffness at o, for a stiffness of each leg; {_ABSENT}")
def stiffness(points: Points, *, leg: float = 1.0) -> Values:
    """Return the translational stiffness at o in the direction in which it is least.

    `leg` is the stiffness of each actuator [N/m]; everything else is rigid. A force f moves o by ``G_v G_vᵀ f / leg``,
    G_v the upper three rows of G, while the platform turns as it likes.
    """
    return _least_stiffness(points, points.platform_jacobians[:, :3], leg)


@metric("N m rad-1", f"least rotational stiffness, for a stiffness of each leg; {_ABSENT}")
def rotational_stiffness(points: Points, *, leg: float = 1.0) -> Values:
    """Return the stiffness against a moment about the axis for which it is least, while o moves as it likes.

    `leg` [N/m] and the rest as for `stiffness`, with the lower three rows of G.
    """
    return _least_stiffness(points, points.platform_jacobians[:, 3:], leg)


def _least_stiffness(points: Points, rows: FloatArray, leg: float) -> Values:
    """Return leg over the largest eigenvalue of rows · rowsᵀ, NaN where a state does not exist."""
    compliance = np.linalg.eigvalsh(np.nan_to_num(rows @ rows.swapaxes(-1, -2)))[:, -1]
    return points.spread(_zero_if_singular(leg / np.where(np.isnan(rows[:, 0, 0]), np.nan, compliance)))


def _zero_if_singular(values: FloatArray) -> FloatArray:
    """Return `values` with 0 for NaN, which stands for a forward singularity."""
    return np.where(np.isnan(values), 0.0, values)


METRICS: Mapping[str, Metric] = MappingProxyType(
    {name: value for name, value in list(globals().items()) if isinstance(value, Metric) and value is not status}
)
"""The metrics of the package by name; with other parameters, ``METRICS["payload"](push=900.0)``."""


def resolve_metrics(metrics: str | Metric | Iterable[str | Metric]) -> tuple[Metric, ...]:
    """Return metrics, each given by its name or as it is."""
    single = isinstance(metrics, str | Metric) or not isinstance(metrics, Iterable)
    resolved: list[Metric] = []
    for wanted in [metrics] if single else metrics:  # type: ignore[union-attr]
        found = METRICS.get(wanted) if isinstance(wanted, str) else wanted
        if not isinstance(found, Metric):
            raise ArgumentError("metrics", f"a Metric, or names among {', '.join(METRICS)}", repr(wanted))
        resolved.append(found)
    names = [metric.name for metric in resolved]
    if not names or len(set(names)) < len(names):
        raise ArgumentError("metrics", "one or more metrics of different names", ", ".join(names) or "none")
    return tuple(resolved)


def unavailable(points: Points, **parameters: Any) -> Values:
    """Stand for the function of a metric whose definition alone is known."""
    raise ArgumentError("metrics", f"metrics among {', '.join(METRICS)}", "one whose function is not known")


def metric_from_definition(content: Mapping[str, Any]) -> Metric:
    """Make a metric from its `definition`; the function is `unavailable` where it is none of `METRICS`."""
    name, dtype, parameters = content["name"], content["dtype"], content["parameters"]
    with contextlib.suppress(KeyError, ArgumentError):
        known = dataclasses.replace(METRICS[name](**parameters), dtype=dtype)
        if known.definition() == content:
            return known
    return Metric(name, content["unit"], "", unavailable, dtype, {}, parameters, content["function"])
