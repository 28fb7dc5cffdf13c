"""Closed-chain kinematics of the 3RPS-3SPR serial-parallel manipulator.

The names of everyday use are here. All else is in public modules: `spm_pin.mechanism` (dimensions, states, sets of
states), `spm_pin.closed_form` (branches, assembly modes, singularities, paths), `spm_pin.workspace`, `spm_pin.sweeps`,
`spm_pin.nlp`, `spm_pin.crosscheck` and `spm_pin.errors`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from spm_pin import closed_form, errors, mechanism
from spm_pin.closed_form import (
    determinants,
    follow,
    forward_displacement,
    forward_physical,
    inverse_displacement,
    inverse_jacobian,
    leg_forces,
    leg_rates,
    set_threads,
    singularities,
    threads,
)
from spm_pin.errors import (
    ArgumentError,
    ClosureError,
    GeometryError,
    NotOneSolutionError,
    PoseError,
    SingularConfigurationError,
    SpmError,
)
from spm_pin.mechanism import Configuration, Geometry, LegLimits, SolutionSet, Status, pose

if TYPE_CHECKING:
    from spm_pin import crosscheck, nlp, sweeps, workspace
    from spm_pin.multibody.chain import ClosedChain
    from spm_pin.multibody.platform_path import PlatformPath

__version__ = "0.2.0"

__all__ = [
    "ArgumentError",
    "ClosedChain",
    "ClosureError",
    "Configuration",
    "Geometry",
    "GeometryError",
    "LegLimits",
    "NotOneSolutionError",
    "PlatformPath",
    "PoseError",
    "SingularConfigurationError",
    "SolutionSet",
    "SpmError",
    "Status",
    "closed_form",
    "crosscheck",
    "determinants",
    "errors",
    "follow",
    "forward_displacement",
    "forward_physical",
    "inverse_displacement",
    "inverse_jacobian",
    "leg_forces",
    "leg_rates",
    "mechanism",
    "nlp",
    "pose",
    "set_threads",
    "singularities",
    "sweeps",
    "threads",
    "workspace",
]

# Imported when first asked for: Pinocchio, CasADi and the stores of sweeps take longer to load than all the rest.
_MODULES = {"crosscheck", "nlp", "sweeps", "workspace"}
_CLASSES = {"ClosedChain": "spm_pin.multibody.chain", "PlatformPath": "spm_pin.multibody.platform_path"}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"spm_pin.{name}")
    if name in _CLASSES:
        return getattr(import_module(_CLASSES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
