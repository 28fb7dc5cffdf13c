"""Closed-chain kinematics of the 3RPS-3SPR serial-parallel manipulator and of its stages.

A `Stage`, three planar legs under a platform, is a machine of its own; a `Manipulator` is two. Functions take either.
The names of everyday use are here. All else is in public modules: `spm_pin.machine` (dimensions, states, sets of
states), `spm_pin.kinematics` (branches, assembly modes, singularities, paths), `spm_pin.workspace`, `spm_pin.sweeps`,
`spm_pin.capability`, `spm_pin.calibration`, `spm_pin.proofs`, `spm_pin.casadi`, `spm_pin.arrays` (JAX and others),
`spm_pin.multibody` (the robot in Pinocchio), `spm_pin.motion`, `spm_pin.design`, `spm_pin.crosscheck` (methods
compared, the paper line by line, the search by CasADi), `spm_pin.description` (URDF, MJCF, SDFormat),
`spm_pin.export` (C, ROS 2, LinuxCNC), `spm_pin.display` (pictures, viewer) and `spm_pin.errors`. Any other robot with
closed loops is a chain of `spm_pin.loops`.
"""

import warnings
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from spm_pin import arrays as arrays
    from spm_pin import calibration as calibration
    from spm_pin import capability as capability
    from spm_pin import casadi as casadi
    from spm_pin import crosscheck as crosscheck
    from spm_pin import description as description
    from spm_pin import design as design
    from spm_pin import display as display
    from spm_pin import errors as errors
    from spm_pin import export as export
    from spm_pin import kinematics as kinematics
    from spm_pin import loops as loops
    from spm_pin import machine as machine
    from spm_pin import motion as motion
    from spm_pin import multibody as multibody
    from spm_pin import proofs as proofs
    from spm_pin import sweeps as sweeps
    from spm_pin import workspace as workspace
    from spm_pin.errors import (
        ArgumentError,
        ClosureError,
        GeometryError,
        NotOneSolutionError,
        PoseError,
        SingularConfigurationError,
        SpmError,
    )
    from spm_pin.kinematics import (
        determinants,
        follow,
        forward_displacement,
        forward_physical,
        inverse_displacement,
        inverse_jacobian,
        inverse_physical,
        leg_forces,
        leg_rates,
        set_threads,
        singularities,
        stiffness,
        threads,
    )
    from spm_pin.machine import (
        PRS,
        RPS,
        RRS,
        Configuration,
        LegLimits,
        Manipulator,
        SolutionSet,
        Stage,
        Status,
        pose,
    )
    from spm_pin.motion import plan
    from spm_pin.motion.time_optimal import time_optimal
    from spm_pin.multibody import ClosedChain, PlatformPath
    from spm_pin.proofs import Certificate, certify, largest_certified_limits

__version__ = "0.3.0"

__all__ = ["ArgumentError", "ClosureError", "GeometryError", "NotOneSolutionError", "PoseError"]
__all__ += ["SingularConfigurationError", "SpmError"]
__all__ += ["Configuration", "Manipulator", "LegLimits", "SolutionSet", "Status", "pose"]
__all__ += ["PRS", "RPS", "RRS", "Stage"]
__all__ += ["forward_displacement", "forward_physical", "inverse_displacement", "inverse_physical"]
__all__ += ["determinants", "inverse_jacobian", "leg_forces", "leg_rates", "singularities", "stiffness"]
__all__ += ["Certificate", "ClosedChain", "PlatformPath", "certify", "follow", "largest_certified_limits"]
__all__ += ["plan", "set_threads", "threads", "time_optimal"]

# All are imported on first use: the start-up of the command line stays short, and Ctrl-C ends it.
_MODULES = {"calibration", "casadi", "crosscheck", "errors", "export", "kinematics", "machine", "motion", "multibody"}
_MODULES |= {"arrays", "capability", "description", "design", "display", "loops", "proofs", "sweeps"}
_MODULES |= {"workspace"}
_HOMES = ("errors", "machine", "kinematics", "proofs", "multibody", "motion")


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"spm_pin.{name}")
    if name == "Geometry":
        warnings.warn(
            "spm_pin.Geometry is now spm_pin.Manipulator, and arguments called geometry are now machine",
            DeprecationWarning,
            stacklevel=2,
        )
        name = "Manipulator"
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    homes = (import_module(f"spm_pin.{home}") for home in _HOMES)
    value = next(getattr(home, name) for home in homes if hasattr(home, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, *_MODULES, "__version__"})
