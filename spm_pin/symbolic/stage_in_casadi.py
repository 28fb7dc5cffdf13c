"""The inverse displacement of a stage alone in CasADi."""

from __future__ import annotations

import casadi as ca

from spm_pin.formulas import planar_legs, stage_poses
from spm_pin.formulas.planar_legs import LegPlane
from spm_pin.mechanism import Stage
from spm_pin.mechanism.arguments import check_instance
from spm_pin.symbolic.machine import in_casadi, parts


def stage_inverse(stage: Stage) -> ca.Function:
    """Make the inverse displacement of a stage in mode T.

    Parameters
    ----------
    stage : Stage
        The stage that is built in, drawn or as built.

    Returns
    -------
    casadi.Function
        Inputs: `normal` (3,), the platform's unit normal in {B}, and `height` (1,) of its origin [m]. Outputs:
        `readings` (3,), [m] or [rad]; `rotation` (3, 3) and `position` (3,) of the platform; and `exists` (1,), 1 where
        the platform has such a state whose balls are in reach, and 0 where not. There the others go on smoothly.
    """
    check_instance(stage, Stage, "stage")
    normal, height, legs = ca.SX.sym("normal", 3), ca.SX.sym("height"), stage.legs
    formulas = stage.kind.bound(in_casadi)
    axes, pivots, balls, outward, forward = (tuple(map(tuple, x.tolist())) for x in (*legs.arrays[:3], *legs.planes))
    constants = in_casadi(stage_poses.stage_constants)(axes, pivots, balls)
    turn = in_casadi(stage_poses.shortest_turn)(parts(normal))
    equation = in_casadi(stage_poses.torsion_equation)(turn, height, constants)
    rotation, position = in_casadi(stage_poses.pose_in_mode)(1.0, turn, height, equation, constants)
    exists, readings = in_casadi(stage_poses.discriminant)(equation) >= 0.0, []
    for leg, ball in enumerate(stage_poses.platform_balls(rotation, position, constants.balls)):
        numbers = tuple(stage.kind.numbers[leg].tolist())
        x, z = planar_legs.place_in_plane(ball, LegPlane(pivots[leg], outward[leg], forward[leg]))
        exists = ca.logic_and(exists, formulas.reach(x, z, numbers) >= 0.0)
        readings.append(formulas.reading(x, z, numbers) + float(legs.offsets[leg]))
    matrix = ca.vertcat(*(ca.horzcat(*row) for row in rotation))
    outputs = [ca.vertcat(*readings), matrix, ca.vertcat(*position), exists]
    names = ["readings", "rotation", "position", "exists"]
    return ca.Function("stage_inverse", [normal, height], outputs, ["normal", "height"], names)
