"""The displacements of a stage alone in CasADi: those of the lower stage of a robot."""

from __future__ import annotations

import casadi as ca

from spm_pin.casadi.functions import frame_of, implicit, stage_problem
from spm_pin.casadi.symbolic_machine import MachineInCasadi, all_of, columns, in_casadi, parts, rows
from spm_pin.formulas import circles, stage_poses
from spm_pin.machine import Manipulator, Stage
from spm_pin.support.arguments import as_bool, check_instance


def stage_inverse(stage: Stage) -> ca.Function:
    """Make the inverse displacement of a stage in mode T.

    Parameters
    ----------
    stage : Stage
        The stage that is built in, nominal or calibrated.

    Returns
    -------
    casadi.Function
        Inputs: `normal` (3,), the platform's normal in {B}, of any length, and `height` (1,) of its origin [m].
        Outputs: `readings` (3,), [m] or [rad]; `rotation` (3, 3) and `position` (3,) of the platform; and `exists`
        (1,), 1 where the platform has such a state whose balls are in reach, and 0 where not, as for normals that are
        zero, NaN or within 1.4 mrad of -z. There the others are finite and mean nothing.
    """
    machine, normal, height = _machine(stage), ca.SX.sym("normal", 3), ca.SX.sym("height")
    constants = in_casadi(stage_poses.stage_constants)(
        *(rows(x[:3]) for x in (machine.axes, machine.pivots, machine.balls))
    )
    up, is_normal = in_casadi(stage_poses.unit_normal)(parts(normal), stage_poses.LEAST_RISE)
    turn = in_casadi(stage_poses.shortest_turn)(up)
    equation = in_casadi(stage_poses.torsion_equation)(turn, height, constants)
    rotation, position = in_casadi(stage_poses.pose_in_mode)(1.0, turn, height, equation, constants)
    balls = in_casadi(stage_poses.platform_balls)(rotation, position, constants.balls)
    exists = [is_normal, in_casadi(stage_poses.discriminant)(equation) >= 0.0]
    exists += [machine.of_ball("reach", leg, ball) >= 0.0 for leg, ball in enumerate(columns(balls))]
    readings = ca.vertcat(*(machine.reading(leg, ball) for leg, ball in enumerate(columns(balls))))
    matrix = ca.vertcat(*(ca.horzcat(*row) for row in rotation))
    outputs = {"readings": readings + machine.offsets[:3], "rotation": matrix, "position": ca.vertcat(*position)}
    outputs["exists"] = all_of(exists)
    return ca.Function("stage_inverse", [normal, height], list(outputs.values()), ["normal", "height"], list(outputs))


def stage_forward(stage: Stage, *, near: bool = False) -> ca.Function:
    """Make the forward displacement of a stage, an implicit function with exact derivatives.

    Parameters
    ----------
    stage : Stage
        The stage that is built in, nominal or calibrated.
    near : bool
        Whether Newton's method begins from a pose, given as two more inputs `near_rotation` (3, 3) and `near_position`
        (3,), and not from the level platform.

    Returns
    -------
    casadi.Function
        Input: `readings` (3,), [m] or [rad]. Outputs: `rotation` (3, 3) and `position` (3,) of the platform; `residual`
        (1,), the largest error of the equations in units of the platform's side, below 1e-12 at a solution; and
        `exists` (1,), 1 where that is so, the state is in the aspect of the level platform, and all legs are in their
        working mode. Where it is 0 the others are where 14 steps of Newton's method and `casadi.rootfinder` ended.

    Notes
    -----
    Without `near` a state to which Newton's method from the level platform does not lead does not exist here, where
    `spm_pin.forward_physical` finds it among all modes. Of random states tilted by up to 75° that is for seven
    stages of usual proportions up to 6 in 100,000, and none below 50° but for slides that are level; for PRS and RRS
    stages of random proportions 0.3 to 6 in 100, and up to 6 in 1,000 of those below 30°. Give `near` there.
    """
    machine, readings, unknowns = _machine(stage), ca.SX.sym("readings", 3), ca.SX.sym("unknowns", 3)
    own, inputs, triangle = machine.circles(0, ca.vertcat(readings, readings)), [readings], rows(machine.balls[:3])
    start = in_casadi(circles.level_balls)(own, triangle, stage.kind.up)
    if as_bool(near, "near"):
        inputs += [ca.SX.sym("near_rotation", 3, 3), ca.SX.sym("near_position", 3)]
        start = [parts(inputs[1] @ ball + inputs[2]) for ball in machine.balls[:3]]
    balls, errors, stepped, angles = stage_problem(machine, 0, own, start, unknowns)
    error, e = errors / machine.side, in_casadi(circles.directions_to)(own, balls)
    residual = ca.mmax(ca.fabs(error)) / machine.side
    exists = [residual < 1e-12, in_casadi(circles.is_home_state)(own, e, balls, stage.kind.up)]
    exists += [radius > 0.0 for radius in own.radii]
    shown = ca.vertsplit(readings - machine.offsets[:3])
    for leg, (ball, reading) in enumerate(zip(columns(balls), shown, strict=True)):
        slope = machine.of_ball("slope", leg, ball, reading)
        exists.append(slope / machine.formulas[0].largest_slope(machine.numbers[leg]) > 0.0)
    exists += machine.are_readings(shown)
    rotation, position = frame_of(columns(balls), machine.balls[:3])
    outputs = {"rotation": rotation, "position": position, "residual": residual, "exists": all_of(exists)}
    return implicit("stage_forward", inputs, (unknowns, error, outputs, stepped), [angles])


def _machine(stage: Stage) -> MachineInCasadi:
    """Return a robot of two such stages, whose lower half is the stage."""
    check_instance(stage, Stage, "stage")
    return MachineInCasadi(Manipulator.of_stages(stage, stage))
