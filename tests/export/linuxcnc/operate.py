#!/usr/bin/python3
"""The operator of LinuxCNC in a test, in the place of its window: does `steps.json`, and writes `results.json`.

Runs in the Python of the system, which has LinuxCNC's module.
"""

import json
import math
import time
from pathlib import Path

import linuxcnc

command, status, errors = linuxcnc.command(), linuxcnc.stat(), linuxcnc.error_channel()


def settle(condition=lambda: status.inpos, seconds=120.0):
    """Wait until the last command is done and a condition holds."""
    end = time.monotonic() + seconds
    command.wait_complete(seconds)
    time.sleep(0.05)  # until the status is that of the command
    status.poll()
    while not condition() and time.monotonic() < end:
        time.sleep(0.01)
        status.poll()


def rest(seconds=120.0):
    """Wait until all joints stand where they are commanded to: one that is turned off on its way brakes first."""
    end, last = time.monotonic() + seconds, (math.inf,) * len(status.joint_position)
    while time.monotonic() < end:
        time.sleep(0.05)
        status.poll()
        commanded, actual = status.joint_position, status.joint_actual_position
        if all(max(abs(a - c), abs(a - b)) < 1e-9 for a, b, c in zip(actual, last, commanded, strict=True)):
            return
        last = actual


def report():
    """Return where the machine is at rest, and the errors since the last report."""
    rest()
    texts = []
    while error := errors.poll():
        texts.append(error[1])
    status.poll()
    is_on = status.task_state == linuxcnc.STATE_ON
    joints = status.joint_position[: status.joints]
    return {"joints": joints, "axes": status.position[:6], "errors": texts, "is_on": is_on}


def turn_on(*order):
    """Turn the machine on, and home it where it is not: all joints at once, or one after another."""
    command.state(linuxcnc.STATE_ESTOP_RESET)
    settle(lambda: status.task_state != linuxcnc.STATE_ESTOP)
    command.state(linuxcnc.STATE_ON)
    settle(lambda: status.task_state == linuxcnc.STATE_ON)
    if not all(status.homed[: status.joints]):
        command.mode(linuxcnc.MODE_MANUAL)
        settle()
        for joint in order or [-1]:
            command.home(joint)
            settle(lambda joint=joint: all(status.homed[: status.joints]) if joint < 0 else status.homed[joint])


def interrupt(line, how):
    """Begin a move, and break it off half a second later; then the machine is on, and still."""
    command.mode(linuxcnc.MODE_MDI)
    settle()
    command.mdi(line)
    time.sleep(0.5)
    if how == "abort":
        command.abort()
    else:
        command.state(linuxcnc.STATE_ESTOP)
        settle(lambda: status.task_state != linuxcnc.STATE_ON)
        time.sleep(0.5)
        turn_on()
    settle()


def run(kind, *arguments):
    """Do one step."""
    if kind == "on":
        turn_on(*arguments)
    elif kind == "interrupt":
        interrupt(*arguments)
    elif kind == "override":
        command.feedrate(*arguments)
    elif kind == "mdi":
        command.mode(linuxcnc.MODE_MDI)
        settle()
        command.mdi(*arguments)
        settle(lambda: status.inpos or status.task_state != linuxcnc.STATE_ON)
    elif kind == "program":  # its text
        Path("program.ngc").write_text(*arguments)
        command.mode(linuxcnc.MODE_AUTO)
        settle()
        command.program_open(str(Path("program.ngc").resolve()))
        command.auto(linuxcnc.AUTO_RUN, 0)
        settle(lambda: status.interp_state == linuxcnc.INTERP_IDLE and status.inpos)
    else:  # "joint" or "axis", its number, rate and distance
        command.mode(linuxcnc.MODE_MANUAL)
        settle()
        command.teleop_enable(kind == "axis")
        settle(lambda: status.motion_mode == (linuxcnc.TRAJ_MODE_TELEOP if kind == "axis" else linuxcnc.TRAJ_MODE_FREE))
        command.jog(linuxcnc.JOG_INCREMENT, kind == "joint", *arguments)
        time.sleep(arguments[2] / abs(arguments[1]))
        settle(lambda: status.inpos or status.task_state != linuxcnc.STATE_ON)
    return report()


results = []
for step in json.loads(Path("steps.json").read_text()):
    results.append(run(*step))
    Path("results.json").write_text(json.dumps(results))
