"""Real machines that are stages, by the numbers that their makers have published, with the sources of these numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spm_pin.machine.leg_kinds import PRS, RPS, RRS
from spm_pin.machine.legs import Legs
from spm_pin.machine.stage import Stage


@dataclass(frozen=True)
class RealMachine:
    """A machine that is a stage, or two stages on one triangle of balls."""

    architecture: str
    """Its name in the literature, such as "3-RRS"."""
    stages: tuple[Stage, ...]
    """The stage; or two, which `spm_pin.Manipulator.of_stages` takes.

    The moving plate of a 3-SPR is the plate of pivots; the stage is the machine seen from there.
    """
    height: float
    """Height of the balls' centre above the plane of the pivots in the source's level position [m]."""
    source: str
    """Source of the numbers: a repository of github.com with the file and the commit that was read, or a paper."""
    assumed: str
    """Assumptions made where the source gives no number, as sentences."""

    @property
    def stage(self) -> Stage:
        """The stage, the lower one of two."""
        return self.stages[0]


def gallery() -> dict[str, RealMachine]:
    """Return ten real machines, by name: balancers, a heliostat, a driving simulator, robots, a haptic device.

    Returns
    -------
    dict
        Values are `RealMachine`, with dimensions in metres. `docs/howto/gallery.md` shows them, with what they reach
        and how far the formulas are off that their programs use.

    Examples
    --------
    >>> import spm_pin as spm
    >>> balancer = spm.stages.gallery()["Ball-Balancer-V2"]
    >>> spm.stages.inverse_physical(balancer.stage, balancer.height).readings.round(4)
    array([0.3601, 0.3601, 0.3601])
    """
    no_limits = "No limits of the servos."
    return {
        "Ball-Balancer-V2": RealMachine(
            "3-RRS",
            (Stage(0.0508, 0.079375, RRS(crank=0.04445, rod=0.0932)),),
            0.10795,
            "aaedmusa/Ball-Balancer-V2, Ball_Balancing.ino, 88cdaf2; in inches",
            no_limits,
        ),
        "3RRS-Balancing-Robot": RealMachine(
            "3-RRS",
            (
                Stage(
                    0.075, 0.09125, RRS(crank=0.05, rod=0.075), np.radians([[-40, -20, -22], [140, 160, 158]]).tolist()
                ),
            ),
            0.1,
            "reece-stronge/3RRS-Balancing-Robot, balance/pose.py, 3bf7de5",
            "Nothing; limits are those of its servos, 0 to 180°, less their offsets.",
        ),
        "Ball-Balancer": RealMachine(
            "3-RRS",
            (Stage(0.056, 0.056, RRS(crank=0.06, rod=0.10145)),),
            0.09,
            "jennagorton/Ball-Balancer, Code/InverseKinematics.cpp and ServoControl.cpp, 0e0fc1c",
            "One radius for base and plate, since the program puts balls straight above servos. " + no_limits,
        ),
        "3RRS-ball-ballancing-platform": RealMachine(
            "3-RRS",
            (Stage(0.075, 0.15, RRS(crank=0.09, rod=0.18)),),
            0.2,
            "JanMaslowski/3RRS-ball-ballancing-platform, scripts/calc.py and main.py, 0d898c2",
            "The radii as the formula uses them, not as comments call them. " + no_limits,
        ),
        "3-RPS heliostat": RealMachine(
            "3-RPS",
            (Stage(0.4, 0.25, RPS(), (1.25, 2.25)),),
            1.64,
            "ashBabu/3-RPS-parallel_robot_heliostat, src/expt/3-rps/RPS_lab_FINAL.m, ea6f773; the prototype of Shyam, "
            "Acharya and Ghosal, Solar Energy 157 (2017)",
            "Nothing; limits are those of its actuators.",
        ),
        "3-RPS-Simulator": RealMachine(
            "3-RPS",
            (Stage(0.12, 0.115),),
            0.125,
            "ErikGoto/3-RPS-Simulator, Script/Python Shared Memory/, ae254ea",
            "Legs of variable length, as the program has them; servos with arms stand in for them. No limits.",
        ),
        "3PRS robot": RealMachine(
            "3-PRS",
            (Stage(0.8, 0.2, PRS(rod=0.5, direction=math.pi), (0.0, 0.8)),),
            math.sqrt(0.5**2 - 0.2**2),
            "OveasGHolami/Optimal-Control, Parametric_Calculations.m, 639152a; Tourajizadeh and Gholami, Robotica 38",
            "Rails that reach from the rim to the centre.",
        ),
        "3PRS neck brace": RealMachine(
            "3-PRS",
            (_with_legs_across(PRS(rod=(0.158, 0.17088, 0.158), direction=0.0, sign=1), 0.055, (0.0, 0.18)),),
            0.02,
            "pranavs1911/TractionNeckBrace, limbkin3PRS.m, cb837a8",
            "Rails of 180 mm that begin under the balls.",
        ),
        "3-SPR haptic device": RealMachine(
            "3-SPR",
            (Stage(0.04156, 0.08, RPS(), (0.1, 0.295)),),
            0.24,
            "tju-wang/3-SPRMatlab, backward_kinematic3SPR_.m and space.m, a7aadf9",
            "Nothing; limits are those of its study of the workspace.",
        ),
        "3RPS-3SPR": RealMachine(
            "3-RPS and 3-SPR",
            (
                Stage(1.2 / math.sqrt(3.0), 0.8 / math.sqrt(3.0), RPS(), (1.1, 1.5)),
                Stage(0.6 / math.sqrt(3.0), 0.8 / math.sqrt(3.0), RPS(), (1.1, 1.5)),
            ),
            1.28,
            "Hu, Lu, Yu and Zhuang, The Open Mechanical Engineering Journal 6 (2012)",
            "A height in the middle of its limits.",
        ),
    }


def _with_legs_across(kind: PRS, radius: float, limits: tuple[float, float]) -> Stage:
    """Return a stage whose legs are at 0, 90 and 180°."""
    axes = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    places = radius * np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    return Stage(radius, radius, Legs(axes, places, places, np.zeros(3), (kind,)), limits)
