"""The kinematics as CasADi functions, for optimisation and optimal control, with derivatives of any order.

Common arguments: `machine` is the machine that is built in, nominal or calibrated, with legs of any kind. None is the
paper's machine. `"symbolic"` is a nominal one with RPS legs whose `dimensions` (3,) = E, C, d [m] are one more input.
With `parameters`, the legs' parameters, see `spm_pin.Manipulator.parameters`, are one more input, and `machine` is
nominal. Readings are in metres, for RRS legs in radians; so are rates, and forces are then torques [N m].

Functions of a state have the inputs `joints` (3, 3), rows b_i in {B} [m], `rotation` (3, 3) from {m} to {B} and
`position` (3,) of o in {B} [m], and further inputs stated there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal

import casadi as ca
import numpy as np

from spm_pin.casadi.symbolic_machine import (
    MachineInCasadi,
    NominalBranches,
    StateInCasadi,
    all_of,
    columns,
    in_casadi,
    in_plane,
    parts,
    point_in,
    rows,
    stages_of,
)
from spm_pin.description.masses import Masses
from spm_pin.description.robot import read_robot
from spm_pin.errors import ArgumentError
from spm_pin.formulas import ball_motions, circles, leg_constants, leg_planes, stage_poses, vectors, wrenches
from spm_pin.formulas import branches as formulas
from spm_pin.formulas import joint_values as values
from spm_pin.formulas.stage_numbers import readings_of_balls
from spm_pin.machine import BRANCHES, Manipulator, Stage
from spm_pin.machine.manipulator import check_manipulator, check_rps
from spm_pin.support.arguments import FloatArray, as_bool, check_instance, choice

Dimensions = Manipulator | Literal["symbolic"] | None

_LEG_NAMES = ("b1", "b2", "b3", "c1", "c2", "c3")
_NEWTON_STEPS = 14
_LONGEST_STEP = 0.3
"""Largest step of Newton's method, in units of d."""


def inverse_physical(machine: Dimensions = None, *, parameters: bool = False) -> ca.Function:
    """Make the inverse displacement in the physical branch.

    Returns
    -------
    casadi.Function
        Inputs: `rotation` and `position`. Outputs: `readings` (6,) of the encoders; `joints`; `discriminant` (1,),
        dimensionless, not negative where the branches TT of the nominal machine are real; and `exists` (1,), 1 if the
        physical branch exists, otherwise 0.

    Notes
    -----
    The leg limits of `machine` decide between two physical branches, as in `spm_pin.inverse_physical`. If none is
    physical the other outputs are continued smoothly: they are those of the branch with less tilted stages. A negative
    `discriminant`, and the missing length of a rod, are replaced by zero, so that readings are those of a machine that
    does not close, and derivatives are finite: constrain `discriminant` to be positive. For a level platform outputs
    are arbitrary and finite, and `exists` is 0. Outputs of a nominal machine are never NaN for finite inputs. A
    calibrated one is solved by Newton's method from the nominal branches TT, then by `casadi.rootfinder`, which CasADi
    differentiates implicitly.

    `exists` is also 0 for an invalid pose, with an entry of RᵀR - I above 1e-6, and for dimensions not within 1e-9
    to 1e9 m. A rotation is not repaired: below that bound its error is also one of the other outputs.
    """
    symbolic, rotation, position = MachineInCasadi(machine, parameters), *_pose()
    if not symbolic.is_nominal:
        return _calibrated_inverse(symbolic, rotation, position)
    drawn = NominalBranches(symbolic, rotation, position)
    joints = [drawn.branch("TT", sign) for sign in (1.0, -1.0)]
    states = [StateInCasadi(symbolic, b, rotation, position) for b in joints]
    (plus, plus_tilts), (minus, minus_tilts) = (preference(symbolic, state) for state in states)
    other = in_casadi(formulas.is_other_preferred)(plus, plus_tilts, minus, minus_tilts)
    outputs = {
        "readings": ca.if_else(other, states[1].readings, states[0].readings),
        "joints": ca.if_else(other, joints[1], joints[0]),
        "discriminant": drawn.discriminant("TT"),
        "exists": all_of([plus + minus > 0.0, drawn.is_real("TT"), symbolic.takes(rotation, position)]),
    }
    return symbolic.function("inverse_physical", [rotation, position], outputs)


def inverse_branch(branch: str, machine: Dimensions = None) -> ca.Function:
    """Make the inverse displacement of a nominal machine in one branch.

    Parameters
    ----------
    branch : str
        One of `spm_pin.machine.BRANCHES`.

    Returns
    -------
    casadi.Function
        As `inverse_physical`; `discriminant` is that of the branch's family, and `exists` 1 where the branch is real
        and all balls are in reach.

    Raises
    ------
    ArgumentError
        If there is no such branch, or `machine` is a calibrated machine.
    """
    choice(branch, "branch", BRANCHES)
    symbolic, rotation, position = MachineInCasadi(machine), *_pose()
    if not symbolic.is_nominal:
        cause = "The eight roots of a calibrated machine have no closed form; inverse_physical takes it"
        raise ArgumentError("machine", "a nominal machine", "a calibrated machine", cause)
    drawn, family = NominalBranches(symbolic, rotation, position), branch[:2]
    joints = drawn.branch(family, 1.0 if branch[2] == "+" else -1.0)
    state = StateInCasadi(symbolic, joints, rotation, position)
    outputs = {
        "readings": state.readings,
        "joints": joints,
        "discriminant": drawn.discriminant(family),
        "exists": all_of([drawn.is_real(family), state.reach >= 0.0, symbolic.takes(rotation, position)]),
    }
    return symbolic.function("inverse_branch", [rotation, position], outputs)


def forward_physical(
    machine: Dimensions | Stage = None, *, parameters: bool = False, near: bool = False
) -> ca.Function:
    """Make the forward displacement, an implicit function with exact derivatives.

    Parameters
    ----------
    machine : Manipulator, Stage, "symbolic" or None
        As for the other functions, or a stage.
    near : bool
        Whether Newton's method begins from a state, given as three more inputs `near_joints` (3, 3), `near_rotation`
        and `near_position`, for a stage the last two, and not from the level one; the result may then be in another
        aspect.

    Returns
    -------
    casadi.Function
        Input: `readings` (6,), for a stage (3,). Outputs: `rotation`, `position`, `joints`; `residual` (1,), the
        largest error of the stages' equations in units of d, below 1e-12 at a solution; and `exists` (1,), 1 where
        that is so, all stages are in the aspect of the symmetric home, and all legs in their working mode. Where it is
        0 the others are where 14 steps of Newton's method and `casadi.rootfinder` ended.

    Notes
    -----
    Without `near` a state to which Newton's method from the level stages does not lead does not exist here; see
    `spm_pin.arrays.forward_physical` for how many these are.
    """
    symbolic = MachineInCasadi(machine, parameters, of=(Manipulator, Stage))
    count = len(symbolic.stages)
    readings, unknowns = ca.SX.sym("readings", 3 * count), ca.SX.sym("unknowns", 3 * count)
    stages, inputs = [symbolic.circles(k, readings) for k in range(count)], [readings]
    starts = [level_balls(symbolic, k, stage) for k, stage in enumerate(stages)]
    if as_bool(near, "near"):
        pose = ca.SX.sym("near_rotation", 3, 3), ca.SX.sym("near_position", 3)
        if count == 1:
            starts = [rows([pose[0] @ ball + pose[1] for ball in symbolic.balls])]
        else:
            inputs.append(ca.SX.sym("near_joints", 3, 3))
            starts = list(map(rows, StateInCasadi(symbolic, inputs[1], *pose).own_balls()))
        inputs += pose
    halves = ca.vertsplit(unknowns, 3)
    balls, errors, stepped, angles = zip(*map(_stage_problem, stages, starts, halves), strict=True)
    rotation, position, joints = placed(symbolic, *balls)
    own = ca.vertsplit(readings - symbolic.offsets)
    # Half the squares of the distances, over d.
    error = ca.vertcat(*errors) / symbolic.side
    residual = ca.mmax(ca.fabs(error)) / symbolic.side
    exists = [symbolic.valid, residual < 1e-12, *(slope > 0.0 for slope in symbolic.slopes_at(balls, own))]
    for stage, b, numbers in zip(stages, balls, symbolic.stages, strict=True):
        is_home = in_casadi(circles.is_home_state)(b, stage.centres, stage.axes, numbers.up)
        exists += [is_home, *(radius > 0.0 for radius in stage.radii)]
    exists += symbolic.are_readings(own)
    outputs = {"rotation": rotation, "position": position, "joints": joints}
    outputs |= {"residual": residual, "exists": all_of(exists)}
    problem = unknowns, error, outputs, ca.vertcat(*stepped)
    return implicit("forward_physical", [*inputs, *symbolic.inputs], problem, [ca.vertcat(*angles)])


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
    machine = MachineInCasadi(check_instance(stage, Stage, "stage"), of=(Stage,))
    (own,), (kind,), normal, height = machine.stages, machine.formulas, ca.SX.sym("normal", 3), ca.SX.sym("height")
    constants = in_casadi(stage_poses.stage_constants)(own.axes, own.pivots, own.balls)
    least_rise, formula = stage_poses.LEAST_RISE, in_casadi(stage_poses.pose_of_tilt)
    rotation, position, balls, exists = formula(parts(normal), least_rise, height, constants)
    readings, reaches = in_casadi(readings_of_balls)(balls, own, kind)
    outputs = {
        "readings": ca.vertcat(*readings) + machine.offsets,
        "rotation": ca.vertcat(*(ca.horzcat(*row) for row in rotation)),
        "position": ca.vertcat(*position),
        "exists": all_of([exists, *(reach >= 0.0 for reach in reaches)]),
    }
    return machine.function("stage_inverse", [normal, height], outputs)


def inverse_jacobian(machine: Dimensions = None, *, parameters: bool = False) -> ca.Function:
    """Make J_f, of a state: `jacobian` (6, 6), which maps the platform's twist (v, ω) at o in {B} to the leg rates.

    It grows without bound towards an inverse singularity, or a leg's own, and is not a number at one.
    """
    return _of_state("inverse_jacobian", MachineInCasadi(machine, parameters), {}, jacobian_of)


def leg_rates(machine: Dimensions = None, *, parameters: bool = False) -> ca.Function:
    """Make the leg rates `rates` (6,) of a state for a `twist` (6,), (v, ω) at o in {B}."""
    return _of_state("leg_rates", MachineInCasadi(machine, parameters), {"twist": 6}, rates_of)


def leg_forces(machine: Dimensions = None, *, parameters: bool = False) -> ca.Function:
    """Make the leg forces `forces` (6,) that hold a `wrench` on the platform in a state; positive increases readings.

    `wrench` (6,) is the force [N] and moment [N m] at o in {B}, applied from outside. The forces grow without bound
    towards a forward singularity.
    """
    return _of_state("leg_forces", MachineInCasadi(machine, parameters), {"wrench": 6}, forces_of)


def gravity(machine: Dimensions = None, *, parameters: bool = False) -> ca.Function:
    """Make the leg forces `forces` (6,) [N] that hold the weight of the machine and of a payload at rest in a state.

    Further inputs: `bodies` (32,), see `bodies`; `payload` (4,), a mass [kg] and its centre in {m} [m]; `acceleration`
    (3,), of gravity in {B} [m/s²].
    """
    symbolic, arguments = MachineInCasadi(machine, parameters), {"bodies": 32, "payload": 4, "acceleration": 3}
    if isinstance(machine, Manipulator):
        check_rps(machine, "weights of the legs")
    return _of_state("gravity", symbolic, arguments, gravity_of)


def bodies(machine: Manipulator | None = None, masses: Masses | None = None) -> FloatArray:
    """Return masses as `gravity` takes them: those given, or the assumed ones of the description.

    Returns
    -------
    ndarray, shape (32,)
        Mass [kg] and first moments [kg m] of the middle platform in {n}, with all balls, and of the terminal platform
        in {m}; then for each leg the mass m and the product m s [kg m] of its cylinder, with s from the pivot to its
        centre, and of its rod, with s from the ball to its centre.
    """
    symbolic = Manipulator.paper() if machine is None else check_manipulator(machine)
    check_rps(symbolic, "weights of the bodies in CasADi and C")
    robot = read_robot(symbolic, masses=masses)
    moments: dict[str, Any] = {}
    bodies_of_carriers = {robot.carrier(name)[0]: name for name in ("middle_platform", "terminal_platform")}
    for name, link in robot.links.items():
        carrier, pose = robot.carrier(name)
        body = bodies_of_carriers.get(carrier, carrier)
        centre = np.linalg.solve(robot.carrier(body)[1], pose @ [*link.inertial.xyz, 1.0])[:3]
        if name.startswith("ball_"):
            # Its centre is that of a ball, which the middle platform carries.
            body, centre = "middle_platform", symbolic.legs.balls[_LEG_NAMES.index(name[5:7])]
        moments[body] = moments.get(body, 0.0) + link.mass * np.array([1.0, *centre])
    rows = [moments["middle_platform"], moments["terminal_platform"]]
    for leg in _LEG_NAMES:
        cylinder, rod = moments[f"leg_{leg}_cylinder"], moments[f"leg_{leg}_rod"]
        aside = float(np.abs([*cylinder[1:3], *rod[1:3]]).max())
        if aside > 1e-9 * (cylinder[0] + rod[0]):
            expected = f"bodies of leg {leg} with their common centres on its axis, as in the formula of `gravity`"
            raise ArgumentError("masses", expected, f"a first moment of {aside:.3g} kg m beside it")
        rows.append([cylinder[0], cylinder[3], rod[0], -rod[3]])
    return np.concatenate(rows)


def closure_residual(machine: Dimensions = None, *, parameters: bool = False) -> ca.Function:
    """Make the nine closure equations of a state, `residual` (9,) [m].

    Distances of the balls from the planes of their lower legs, then of their upper legs; then, for the sides 12, 23,
    31, the error (|b_i - b_j|² - s²)/2s of a side s, smooth everywhere.
    """
    return _of_state("closure_residual", MachineInCasadi(machine, parameters), {}, residual_of)


def joint_values(machine: Dimensions = None, *, parameters: bool = False) -> ca.Function:
    """Make the values of the description's eighteen joints in a state.

    `values` (18,) are in the order of `spm_pin.description.JOINTS`: angles [rad], slides [m].
    """
    return _of_state("joint_values", MachineInCasadi(machine, parameters), {}, values_of)


def _of_state(
    name: str, machine: MachineInCasadi, arguments: dict[str, int], compute: Callable[..., Any]
) -> ca.Function:
    """Make a function of a state, `joints`, `rotation` and `position`, and of further arguments."""
    joints, further = ca.SX.sym("joints", 3, 3), [ca.SX.sym(*argument) for argument in arguments.items()]
    pose = _pose()
    return machine.function(name, [joints, *pose, *further], compute(StateInCasadi(machine, joints, *pose), *further))


def jacobian_of(state: StateInCasadi) -> dict[str, Any]:
    """Return J_f of a state."""
    (b, c), axes = stages_of(state.balls), stages_of(state.axes)
    lower, upper = stages_of(state.directions)
    if state.machine.is_nominal:
        rows = in_casadi(wrenches.drawn_inverse_jacobian)(b, lower, upper, *axes, parts(state.position))
    else:
        rows = in_casadi(wrenches.inverse_jacobian)(b, c, lower, upper, *axes, parts(state.position))
    along = [ca.horzcat(*force, *moment) for stage in rows for force, moment in stage]
    return {"jacobian": ca.vertcat(*(x / slope for x, slope in zip(along, state.slopes, strict=True)))}


def rates_of(state: StateInCasadi, twist: Any) -> dict[str, Any]:
    """Return the leg rates of a twist in a state."""
    return {"rates": jacobian_of(state)["jacobian"] @ twist}


def forces_of(state: StateInCasadi, wrench: Any) -> dict[str, Any]:
    """Return the leg forces that hold a wrench in a state."""
    return {"forces": _forces(state, wrench, wrench)}


def _forces(state: StateInCasadi, *wrenches_of_stages: Any) -> Any:
    """Return the forces of the lower legs that hold one wrench at o, and of the upper legs that hold another."""
    forces: list[Any] = []
    vectors = map(stages_of, (state.balls, state.directions, state.axes))
    for b, f, axes, wrench in zip(*vectors, wrenches_of_stages, strict=True):
        twists = in_casadi(wrenches.stage_twists)(b, f, axes, parts(state.position))
        forces += in_casadi(wrenches.stage_forces)(twists, (parts(wrench[:3]), parts(wrench[3:])))
    return ca.vertcat(*(x * slope for x, slope in zip(forces, state.slopes, strict=True)))


def gravity_of(state: StateInCasadi, bodies: Any, payload: Any, acceleration: Any) -> dict[str, Any]:
    """Return the leg forces that hold all weights in a state."""
    o = state.position
    turn, origin = frame_of(rows(state.joints), state.machine.stages[0].balls)

    def wrench(mass: Any, moments: Any) -> Any:
        return ca.vertcat(mass * acceleration, ca.cross(moments - mass * o, acceleration))

    middle = turn @ bodies[1:4] + bodies[0] * origin
    mass = bodies[4] + payload[0]
    upper = wrench(mass, state.rotation @ (bodies[5:8] + payload[0] * payload[1:]) + mass * o)
    lower = upper + wrench(bodies[0], middle)
    for leg in range(6):
        cylinder, cylinder_moment, rod, rod_moment = ca.vertsplit(bodies[8 + 4 * leg : 12 + 4 * leg])
        pivot, ball = state.bases[leg], state.balls[leg]
        along = state.directions[leg] if leg < 3 else -state.directions[leg]
        across = acceleration - ca.dot(along, acceleration) * along
        swing = (cylinder_moment - rod_moment) / state.lengths[leg] * across
        # A leg turns about the end that stays; what its other end feels of the weights is a force there.
        if leg < 3:
            force = rod * acceleration + swing
            lower += ca.vertcat(force, ca.cross(ball - o, force))
        else:
            force = cylinder * acceleration - swing
            upper += ca.vertcat(force, ca.cross(pivot - o, force))
            moments = cylinder * pivot + cylinder_moment * along + rod * ball - rod_moment * along
            lower += wrench(cylinder + rod, moments)
    return {"forces": _forces(state, lower, upper)}


def values_of(state: StateInCasadi) -> dict[str, Any]:
    """Return the values of the eighteen joints in a state."""
    machine, turned = state.machine, state.rotation.T
    triangle, own = map(in_casadi(values.triangle_axes), (rows(state.joints), machine.stages[0].balls))
    seen = [parts(turned @ ca.vertcat(*x)) for x in triangle]
    by_joint: dict[str, Any] = {}
    frames = [frame for stage in (0, 1) for frame in machine.leg_frames(stage, own)]
    for k, (name, leg) in enumerate(zip(_LEG_NAMES, frames, strict=True)):
        kind, up = machine.kinds[k // 3], 1.0 - 2.0 * (k // 3)
        ball = state.balls[k] if k < 3 else turned @ (state.balls[k] - state.position)
        of_leg = in_casadi(values.leg_values)(parts(ball), leg, machine.formulas[k // 3])
        by_joint[f"leg_{name}_{kind.passive}"] = ca.atan2(*of_leg.passive)
        by_joint[f"leg_{name}_{kind.actuated}"] = of_leg.actuated
        if k % 3 == 0:
            angles = in_casadi(values.ball_angles)(of_leg, leg, triangle if k < 3 else seen, up)
            by_joint |= {f"ball_{name}_{x}": ca.atan2(*angle) for x, angle in zip("xyz", angles, strict=True)}
    return {"values": ca.vertcat(*(by_joint[name] for name in machine.joint_names))}


def residual_of(state: StateInCasadi) -> dict[str, Any]:
    """Return the closure equations of a state."""
    legs = zip(state.balls, [0.0] * 3 + [state.position] * 3, state.axes, state.machine.heights(), strict=True)
    distances = [ca.dot(ball - origin, axis) - height for ball, origin, axis, height in legs]
    return {"residual": ca.vertcat(*distances, *_side_errors(state.machine, state.joints))}


def _pose() -> tuple[Any, Any]:
    return ca.SX.sym("rotation", 3, 3), ca.SX.sym("position", 3)


def _side_errors(machine: MachineInCasadi, balls: Sequence[Any]) -> list[Any]:
    """Return (|b_i - b_j|² - s²)/2s [m] of the sides s of the lower balls."""
    squares = in_casadi(circles.squared_sides)([parts(b) for b in balls])
    return [(square - s * s) / (2.0 * s) for square, s in zip(squares, machine.sides(), strict=True)]


def closure_equations(machine: MachineInCasadi, coordinates: Any, rotation: Any, position: Any) -> Any:
    """Return the errors (6,) [m] of the lower balls' sides, and of the upper balls' distances from their planes."""
    balls = lower_balls(machine, coordinates)
    upper = zip(machine.axes[3:], machine.heights()[3:], machine.all_balls(balls)[3:], strict=True)
    planes = [ca.dot(rotation @ axis, ball - position) - height for axis, height, ball in upper]
    return ca.vertcat(*_side_errors(machine, balls), *planes)


def lower_balls(machine: MachineInCasadi, coordinates: Any) -> list[Any]:
    """Return the b_i with these coordinates (6,) in the planes of the lower legs."""
    return list(map(point_in, ca.vertsplit(coordinates, 2), machine.stages[0].planes))


def quadrics(machine: MachineInCasadi, quaternion: Any, rotation: Any, position: Any) -> tuple[list[Any], Any]:
    """Return the forms (4, 4) of `leg_planes.quadric`, norm 1, and the lower balls of a root in their planes (6,)."""
    normals = ca.horzcat(*machine.axes[:3], *(rotation @ x for x in machine.axes[3:]))
    heights = machine.heights()
    heights = ca.vertcat(*heights[:3], *(h + ca.dot(normals[:, 3 + i], position) for i, h in enumerate(heights[3:])))
    stages = [
        leg_planes.StagePlanes(
            (parts(normals[:, i]), parts(normals[:, i + 1]), parts(normals[:, i + 2])),
            parts(heights[i : i + 3]),
            (parts(machine.balls[i]), parts(machine.balls[i + 1]), parts(machine.balls[i + 2])),
        )
        for i in (0, 3)
    ]
    forms, weights = [], ca.nullspace(normals)
    for k in range(3):
        w = weights[:, k]
        xx, yy, zz, ww, xy, xz, yz, xw, yw, zw = in_casadi(leg_planes.quadric)(parts(w[:3]), parts(w[3:]), *stages)
        form = ca.blockcat([[xx, xy, xz, xw], [xy, yy, yz, yw], [xz, yz, zz, zw], [xw, yw, zw, ww]])
        forms.append(form / ca.norm_fro(form))
    turn = ca.vertcat(*(ca.horzcat(*row) for row in in_casadi(vectors.rotation_of)(*ca.vertsplit(quaternion))))
    turned = [turn @ ball for ball in machine.balls]
    gaps = heights - ca.vertcat(*(ca.dot(normals[:, i], turned[i]) for i in range(6)))
    shift = ca.solve(normals @ normals.T, normals @ gaps)
    coordinates = [in_plane(turned[i] + shift, plane) for i, plane in enumerate(machine.stages[0].planes)]
    return forms, ca.vertcat(*coordinates)


def level_balls(machine: MachineInCasadi, stage: int, of_readings: circles.Circles) -> Any:
    """Return the balls of the lower stage, 0, or of the upper, 1, at the level start, see `circles.level_balls`."""
    own = machine.stages[stage]
    return in_casadi(circles.level_balls)(of_readings, own.balls, own.up)


def placed(machine: MachineInCasadi, *balls: Any) -> tuple[Any, Any, Any]:
    """Return R, o and the b_i (3, 3) of the stages, with balls in {B} and in {m} as formulas take them."""
    frames = [frame_of(b, stage.balls) for b, stage in zip(balls, machine.stages, strict=True)]
    rotation, origin = frames[0]
    if len(frames) == 2:
        turn_m, origin_m = frames[1]
        rotation = rotation @ turn_m.T
        origin = origin - rotation @ origin_m
    return rotation, origin, ca.horzcat(*columns(balls[0])).T


def frame_of(b: Any, own: Any) -> tuple[Any, Any]:
    """Return rotation and position of the frame in which the balls at b are `own`, both as formulas take them."""
    axes = map(in_casadi(values.triangle_axes), (b, own))
    rotation, position = in_casadi(ball_motions.frame_of_triangle)(*axes, b, own)
    return ca.vertcat(*(ca.horzcat(*row) for row in rotation)), ca.vertcat(*position)


def nominal_starts(machine: MachineInCasadi, drawn: NominalBranches) -> list[Any]:
    """Return the starts of Newton's method: TT+ and TT- of the nominal machine, and both with larger discriminants.

    Close to a nominal fold the branches of a calibrated machine are elsewhere, or real where nominal ones are not.
    """
    joints = [drawn.branch("TT", sign, least) for least in (0.0, 1e-3, 1e-1) for sign in (1.0, -1.0)]
    return [ca.vertcat(*map(in_plane, ca.horzsplit(b.T), machine.stages[0].planes)) for b in joints]


def preference(machine: MachineInCasadi, state: StateInCasadi) -> tuple[Any, Any]:
    """Return 0 where a state is not physical, 1 where it is, 2 where within leg limits too; and how straight it is."""
    is_physical, tilts = state.is_physical()
    return is_physical * (1.0 + all_of(within_limits(machine, state.readings))), tilts


def within_limits(machine: MachineInCasadi, readings: Any) -> list[Any]:
    """Return which of six readings are within the limits of their legs, rounding apart."""
    inside = []
    for reading, *limits in zip(*map(ca.vertsplit, (readings, machine.minimum, machine.maximum)), strict=True):
        low, high = in_casadi(leg_constants.admitted_readings)(*limits)
        inside.append(ca.logic_and(reading >= low, reading <= high))
    return inside


def _calibrated_inverse(machine: MachineInCasadi, rotation: Any, position: Any) -> ca.Function:
    """Make `inverse_physical` of a calibrated machine, by Newton's method from the nominal branches TT."""
    drawn, unknowns = NominalBranches(machine, rotation, position), ca.SX.sym("unknowns", 6)
    starts = nominal_starts(machine, drawn)
    error = closure_equations(machine, unknowns, rotation, position)
    joints = ca.horzcat(*lower_balls(machine, unknowns)).T
    state = StateInCasadi(machine, joints, rotation, position)
    (rank, tilts), size = preference(machine, state), machine.side + ca.norm_1(position)
    closed = ca.mmax(ca.fabs(error)) <= 1e-13 * size
    outputs = {"readings": state.readings, "joints": joints, "discriminant": drawn.discriminant("TT")}
    outputs["exists"] = all_of([rank > 0.0, closed, machine.takes(rotation, position)])
    step = -ca.solve(ca.jacobian(error, unknowns), error)
    step = step / ca.fmax(1.0, ca.norm_inf(step) / (_LONGEST_STEP * machine.side))
    problem = unknowns, error, outputs, unknowns + step
    known = [rotation, position, *machine.inputs]
    return implicit("inverse_physical", known, problem, starts, (rank * closed, tilts))


def _stage_problem(own: circles.Circles, start: Any, unknowns: Any) -> tuple[Any, ...]:
    """Return balls of a stage, errors of half their squared distances, and the unknowns after a step.

    Unknown are the angles (3,) of the legs; the last of all is those of the balls to start from.
    """
    first, second = in_casadi(circles.turn_origins)(own)
    turned = in_casadi(vectors.multiples)(parts(ca.cos(unknowns)), first)
    e = in_casadi(vectors.combinations)(turned, parts(ca.sin(unknowns)), second)
    balls = in_casadi(circles.balls_at)(own, e)
    step = in_casadi(circles.limited)(in_casadi(circles.newton_step)(own, e))
    begin = in_casadi(circles.directions_to)(own, start)
    angles = map(ca.atan2, in_casadi(vectors.dots)(second, begin), in_casadi(vectors.dots)(first, begin))
    return balls, ca.vertcat(*in_casadi(circles.errors)(own, balls)), unknowns - ca.vertcat(*step), ca.vertcat(*angles)


def implicit(
    name: str,
    known: list[Any],
    problem: tuple[Any, Any, dict[str, Any], Any],
    starts: list[Any],
    preference: tuple[Any, Any] | None = None,
) -> ca.Function:
    """Make a function of the solution of equations.

    `problem` has the unknowns, the equations, the results, and the unknowns after a step of Newton's method, which goes
    `_NEWTON_STEPS` steps from each start; the end of the largest rank is taken, of several the straightest.
    `casadi.rootfinder`, through which CasADi differentiates implicitly, goes on from there.
    """
    unknowns, error, outputs, stepped = problem
    names = [x[0].name().rsplit("_", 1)[0] for x in known]
    symbols = [ca.MX.sym(name, *x.shape) for name, x in zip(names, known, strict=True)]
    newton = ca.Function("newton", [unknowns, *known], [stepped])
    ends = ca.Function("starts", known, starts).call(symbols)
    for _ in range(_NEWTON_STEPS):
        ends = [newton(end, *symbols) for end in ends]
    best = ends[0]
    if preference is not None:
        rated = ca.Function("rated", [unknowns, *known], list(preference))
        rank, tilts = rated.call([best, *symbols])
        for end in ends[1:]:
            other_rank, other_tilts = rated.call([end, *symbols])
            other = in_casadi(formulas.is_other_preferred)(rank, tilts, other_rank, other_tilts)
            best, rank = ca.if_else(other, end, best), ca.if_else(other, other_rank, rank)
            tilts = ca.if_else(other, other_tilts, tilts)
    equations = ca.Function("equations", [unknowns, *known], [error])
    options = {"error_on_fail": False, "abstol": 1e-15, "max_iter": 4}
    solved = ca.rootfinder("root", "fast_newton", equations, options)(best, *symbols)
    results = ca.Function("results", [unknowns, *known], list(outputs.values())).call([solved, *symbols])
    return ca.Function(name, symbols, results, names, list(outputs))
