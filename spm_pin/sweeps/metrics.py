"""Indices: one number per point of a sweep, each with its unit and its meaning.

A new one is an `Index` with a function of `Points`; it need not be registered:

    r_b1 = Index("r_b1", "m", "length of leg r_b1", lambda points: points.machine.leg_lengths[:, 0])

Indices of the machine's state speak of the configuration that a real machine is in within its leg limits, and are NaN
where there is none. Those of the Jacobian make it homogeneous: with a characteristic length L the twist is (v, Lω), so
that singular values compare speeds with speeds. By default L is the platform's radius C: then Lω is the speed that a
rotation about o gives to the joints c_i.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy.typing as npt

from spm_pin.errors import ArgumentError
from spm_pin.mechanism import BRANCHES
from spm_pin.mechanism.arguments import real_array
from spm_pin.sweeps import measures
from spm_pin.sweeps.metric import Index

__all__ = ["INDICES", "conditioning", "isotropy", "payload", "payload_down", "resolve", "stiffness"]


def conditioning(length: float | None = None) -> Index:
    """Return the inverse condition number of the homogeneous Jacobian: 0 at a singularity, 1 at an isotropic state.

    Parameters
    ----------
    length : float, optional
        Characteristic length L [m]; the platform's radius C if not given.

    Notes
    -----
    The local conditioning index of C. Gosselin, J. Angeles, "A global performance index for the kinematic optimization
    of robotic manipulators", Journal of Mechanical Design 113 (1991), of a Jacobian made homogeneous as above.
    """
    length, told = _characteristic(length)
    return Index(
        "conditioning",
        "1",
        f"inverse condition number of the Jacobian of (v, L omega), L = {told}; {_ABSENT}",
        partial(measures.conditioning, length=length),
        parameters={"length": length},
    )


def isotropy(length: float | None = None) -> Index:
    """Return the geometric over the arithmetic mean of the eigenvalues of G Gᵀ, G homogeneous: from 0 to 1.

    Parameters
    ----------
    length : float, optional
        As for `conditioning`.

    Notes
    -----
    The measure of J.-O. Kim, P. K. Khosla, "Dexterity measures for design and control of manipulators", IROS 1991, of
    G, which maps leg rates to the twist (v, Lω).
    """
    length, told = _characteristic(length)
    return Index(
        "isotropy",
        "1",
        f"geometric over arithmetic mean of the eigenvalues of G G^T of (v, L omega), L = {told}; {_ABSENT}",
        partial(measures.isotropy, length=length),
        parameters={"length": length},
    )


def payload(push: float = 1.0, pull: float | None = None) -> Index:
    """Return the force that the machine holds at o whatever its direction, without a moment.

    Parameters
    ----------
    push, pull : float
        Largest force of a leg when it pushes and when it pulls [N]; `pull` is `push` if not given. By default the
        index is the payload per newton of leg force.

    Notes
    -----
    A leg of force a · u under the unit force u bears at most ``|a|``, in either sense: the payload is the least
    quotient of a leg's limit and its ``|a|``, without a search over directions.
    """
    return _payload("payload", "in every direction", measures.payload, push, pull)


def payload_down(push: float = 1.0, pull: float | None = None) -> Index:
    """Return the force along -Z of {B} that the machine holds at o, without a moment: a weight.

    Parameters
    ----------
    push, pull : float
        As for `payload`.
    """
    return _payload("payload_down", "along -Z", measures.payload_down, push, pull)


def stiffness(leg: float = 1.0) -> Index:
    """Return the translational stiffness at o in the direction in which it is least.

    Parameters
    ----------
    leg : float
        Stiffness of each actuator [N/m]; everything else is rigid. By default the index is the stiffness per that of a
        leg.

    Notes
    -----
    A force f moves o by ``G_v G_vᵀ f / leg``, G_v the upper three rows of G, while the platform turns as it likes.
    """
    leg = _positive(leg, "leg", "N/m")
    return Index(
        "stiffness",
        "N m-1",
        f"least translational stiffness at o with legs of {leg:g} N/m; {_ABSENT}",
        partial(measures.stiffness, leg=leg),
        parameters={"leg": leg},
    )


def resolve(indices: Iterable[str | Index]) -> tuple[Index, ...]:
    """Return indices given by name or as they are.

    Raises
    ------
    ArgumentError
        If there is none, a name is unknown, or two have one name.
    """
    given = [indices] if isinstance(indices, str | Index) else list(indices)
    unknown = [one for one in given if not isinstance(one, Index) and one not in INDICES]
    if unknown:
        raise ArgumentError("indices", f"an Index, or names among {', '.join(INDICES)}", repr(unknown[0]))
    resolved = tuple(one if isinstance(one, Index) else INDICES[one] for one in given)
    names = [index.name for index in resolved]
    if not names or len(set(names)) < len(names):
        raise ArgumentError("indices", "one or more indices of different names", ", ".join(names) or "none")
    return resolved


def from_definition(content: Mapping[str, Any]) -> Index:
    """Make an index again from its `definition`.

    Raises
    ------
    ArgumentError
        If it is not one of `INDICES` with other parameters.
    """
    name, parameters = content["name"], content["parameters"]
    if name in INDICES:
        maker = _MAKERS.get(name)
        index = replace(maker(**parameters) if maker else INDICES[name], dtype=content["dtype"])
        if index.definition() == content:
            return index
    cause = "An index of your own has to be given again, to `sweep`, with all the rest."
    raise ArgumentError("indices", f"indices among {', '.join(INDICES)}", name, cause)


def _payload(
    name: str, direction: str, measure: Callable[..., npt.ArrayLike], push: float, pull: float | None
) -> Index:
    push = _positive(push, "push", "N")
    pull = push if pull is None else _positive(pull, "pull", "N")
    return Index(
        name,
        "N",
        f"largest force at o held {direction} with leg forces from {-pull:g} to {push:g} N; {_ABSENT}",
        partial(measure, push=push, pull=pull),
        parameters={"push": push, "pull": pull},
    )


def _characteristic(length: float | None) -> tuple[float | None, str]:
    if length is None:
        return None, "platform radius"
    length = _positive(length, "length", "m")
    return length, f"{length:g} m"


def _positive(value: float, argument: str, unit: str) -> float:
    number = real_array(value, argument, (), f"a number of {unit}")
    if number.shape != () or not number > 0.0:
        raise ArgumentError(argument, f"a positive number of {unit}", value)
    return float(number)


_ABSENT = "NaN where not reachable"
_STAGES = {"lower": "J_b, lower stage, forward", "upper": "J_c, upper stage, forward", "structure": "K, inverse"}

_MAKERS: Mapping[str, Callable[..., Index]] = {
    "conditioning": conditioning,
    "isotropy": isotropy,
    "payload": payload,
    "payload_down": payload_down,
    "stiffness": stiffness,
}

_ALL = (
    Index(
        "reachable",
        "1",
        "whether a real machine can be here within its leg limits",
        measures.reachable,
        "int8",
        {"no": 0, "yes": 1},
    ),
    Index("branches", "1", "number of real branches, leg limits aside", measures.branches, "int8"),
    Index("branches_within", "1", "number of real branches within the leg limits", measures.branches_within, "int8"),
    Index(
        "branch",
        "1",
        "branch that a real machine is in within its leg limits",
        measures.branch,
        "int8",
        {"none": -1} | {label: k for k, label in enumerate(BRANCHES)},
    ),
    Index(
        "assembly_modes",
        "1",
        "number of assembly modes that the machine's leg lengths allow; 0 where not reachable",
        measures.assembly_modes,
        "int16",
    ),
    *(
        Index(
            f"o_{axis}",
            "m",
            f"{axis.upper()} of o in the base frame; {_ABSENT}",
            partial(measures.position, coordinate=k),
        )
        for k, axis in enumerate("xyz")
    ),
    Index(
        "leg_margin",
        "m",
        "how far the worst leg is inside its limits, negative outside; NaN where no machine can be at all",
        measures.leg_margin,
    ),
    conditioning(),
    isotropy(),
    Index(
        "forward_distance",
        "1",
        f"least singular value of J_b and J_c: distance to a forward singularity; {_ABSENT}",
        partial(measures.distance, first=0, last=1),
    ),
    Index(
        "inverse_distance",
        "1",
        f"least singular value of K: distance to an inverse singularity; {_ABSENT}",
        partial(measures.distance, first=2, last=2),
    ),
    *(
        Index(f"det_{name}", "1", f"determinant of {of}, over d^3; {_ABSENT}", partial(measures.determinant, which=k))
        for k, (name, of) in enumerate(_STAGES.items())
    ),
    payload(),
    payload_down(),
    stiffness(),
)

INDICES: Mapping[str, Index] = MappingProxyType({index.name: index for index in _ALL})
"""The indices that a sweep knows by name; those with parameters are functions of this module as well."""
