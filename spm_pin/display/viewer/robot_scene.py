"""A state in a viser scene: the robot, the other branches as ghosts, the load and the pose asked for."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from spm_pin.display.viewer.robot_meshes import Part, Robot
from spm_pin.display.viewer.state import State
from spm_pin.display.viewer.state_markup import PULL, PUSH, WARN
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.branches import BRANCHES

__all__ = ["RobotScene", "rgb"]

OnClick = Callable[[str], Coroutine[Any, Any, None]]

GHOST_OPACITY = 0.2
_LOWER, _UPPER = "#0072B2", "#E69F00"
_LOAD = (0x7A, 0x4F, 0xB5)


def rgb(code: str) -> tuple[int, int, int]:
    """Return the three bytes of a colour such as ``#0072B2``."""
    red, green, blue = bytes.fromhex(code.removeprefix("#"))
    return red, green, blue


def _linear(colour: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return a colour for many instances at once, which viser takes for linear intensities instead of sRGB."""
    red, green, blue = (round(255.0 * (channel / 255.0) ** 2.2) for channel in colour)
    return red, green, blue


class RobotScene:
    """The nodes of one session in a viser scene, of one client or of a whole server.

    Parameters
    ----------
    scene : viser.SceneApi
        Where to add them.
    robot : Robot
        What to draw.
    on_click : coroutine function, optional
        Told the label of a ghost that is clicked.
    """

    def __init__(self, scene: Any, robot: Robot, on_click: OnClick | None = None) -> None:
        self.scene = scene
        self.robot = robot
        self.show_ghosts, self.show_labels = True, True
        geometry = robot.geometry
        self.size = (geometry.base_radius + geometry.platform_radius + geometry.middle_radius) / 3.0
        scene.configure_default_lights(cast_shadow=False)
        radius = 2.2 * geometry.base_radius
        scene.add_grid(
            "/floor",
            width=2.0 * radius,
            height=2.0 * radius,
            cell_size=0.25 * radius,
            section_size=radius,
            cell_color=(150, 150, 150),
            section_color=(120, 120, 120),
            position=(0.0, 0.0, -0.2 * self.size),
        )
        self._robot = [self._mesh(f"/robot/{part.name}", part, part.colour, None) for part in robot.parts]
        self._bodies = _ghost_bodies(robot)
        self._terminal = [k for k, part in enumerate(robot.parts) if part.name.startswith("terminal")]
        self._ghosts = [self._ghost(body, on_click) for _, body in self._bodies]
        self._carriers = [k for k, _ in self._bodies]
        self._labels: dict[str, Any] = {}
        self._wanted = [
            self._mesh(f"/wanted/{robot.parts[k].name}", robot.parts[k], rgb(WARN), 0.45) for k in self._terminal
        ]
        self._gap = scene.add_line_segments(
            "/wanted_gap", points=np.zeros((1, 2, 3), np.float32), colors=rgb(WARN), visible=False
        )
        self._arrows = {
            name: scene.add_arrows(
                f"/load/{name}",
                np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]]]),
                _linear(colour),
                shaft_radius=thickness * self.size,
                head_radius=2.1 * thickness * self.size,
                head_length=3.2 * thickness * self.size,
                visible=False,
            )
            for name, colour, thickness in (
                ("force", _LOAD, 0.035),
                ("moment", _LOAD, 0.022),
                ("push", rgb(PUSH), 0.08),
                ("pull", rgb(PULL), 0.08),
            )
        }

    def _mesh(self, name: str, part: Part, colour: tuple[int, int, int], opacity: float | None) -> Any:
        return self.scene.add_mesh_simple(
            name,
            part.vertices,
            part.faces,
            color=colour,
            opacity=opacity,
            flat_shading=True,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def show(self, state: State) -> None:
        """Bring everything up to date."""
        positions, quaternions = self.robot.placements(self.robot.q(state.shown))
        for handle, position, quaternion in zip(self._robot, positions, quaternions, strict=True):
            handle.position, handle.wxyz = position, quaternion
        self._show_ghosts(state)
        self._show_wanted(state, positions, quaternions)
        self._show_load(state)

    def _show_ghosts(self, state: State) -> None:
        count = len(state.solutions.labels)
        positions = np.zeros((len(self._bodies), count, 3))
        quaternions = np.tile([1.0, 0.0, 0.0, 0.0], (len(self._bodies), count, 1))
        # What is not there has no size, so that the number of instances never changes.
        sizes = np.zeros(count)
        taken: list[FloatArray] = []
        for i, label in enumerate(state.solutions.labels):
            ghost = self.show_ghosts and label in state.labels and label != state.label
            if ghost:
                placed = self.robot.placements(self.robot.q(state.solutions[label]))
                positions[:, i], quaternions[:, i] = (array[self._carriers] for array in placed)
                sizes[i] = 1.0
            named = self.show_labels and (ghost or label == state.label)
            if named:
                self._label(label, state, taken)
            if label in self._labels:
                self._labels[label].visible = named
        for handle, place, turn in zip(self._ghosts, positions, quaternions, strict=True):
            handle.batched_positions = place.astype(np.float32)
            handle.batched_wxyzs = turn.astype(np.float32)
            handle.batched_scales = sizes.astype(np.float32)

    def _ghost(self, body: Part, on_click: OnClick | None) -> Any:
        """Return the node of one body of all ghosts, an instance for each branch."""
        count = len(BRANCHES)
        handle = self.scene.add_batched_meshes_simple(
            f"/ghosts/{body.name}",
            body.vertices,
            body.faces,
            batched_wxyzs=np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1)),
            batched_positions=np.zeros((count, 3), np.float32),
            batched_scales=np.zeros(count, np.float32),
            batched_colors=_linear(body.colour),
            opacity=GHOST_OPACITY,
            lod="off",
            flat_shading=True,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )
        if on_click is not None:

            async def clicked(event: Any) -> None:
                if event.instance_index is not None:
                    await on_click(BRANCHES[event.instance_index])

            handle.on_click(clicked)
        return handle

    def _label(self, label: str, state: State, taken: list[FloatArray]) -> None:
        """Name a branch at the rim of its middle platform, where it is farthest from the names already there."""
        joints = state.solutions[label].middle_joints
        rim = np.concatenate([joints, (joints + np.roll(joints, 1, axis=0)) / 2.0])
        places = rim + 0.25 * (rim - joints.mean(axis=0))
        gaps = [np.linalg.norm(places - other, axis=-1) for other in taken]
        place = places[int(np.min(gaps, axis=0).argmax()) if gaps else 0]
        taken.append(place)
        text = f"{label} ◀" if label == state.label else label
        if label in self._labels:
            self._labels[label].position = place
            self._labels[label].text = text
        else:
            self._labels[label] = self.scene.add_label(
                f"/labels/{label}", text, position=place, anchor="center-center", font_screen_scale=0.9
            )

    def _show_wanted(self, state: State, positions: FloatArray, quaternions: FloatArray) -> None:
        apart = state.distance > 0.0
        # What the terminal platform carries, moved from where it is to where it should be.
        move = state.target * state.shown.pose.inv()
        for handle, k in zip(self._wanted, self._terminal, strict=True):
            handle.visible = apart
            if apart:
                handle.position = move.apply(positions[k])
                turn = move.rotation * Rotation.from_quat(quaternions[k], scalar_first=True)
                handle.wxyz = turn.as_quat(scalar_first=True)
        self._gap.visible = apart
        if apart:
            ends = np.stack([state.shown.translation, state.target.translation])
            self._gap.points = ends[None].astype(np.float32)

    def _show_load(self, state: State) -> None:
        o, wrench = state.shown.translation, state.wrench
        length = 1.1 * self.size
        force, moment = wrench[:3], wrench[3:]
        self._point("force", [_onto(o, force, length)] if force.any() else [])
        # A moment has two heads.
        axis = _onto(o, moment, length) if moment.any() else None
        self._point("moment", [axis, np.stack([o, o + 0.82 * (axis[1] - o)])] if axis is not None else [])
        forces = state.readings.forces
        scale = 0.0 if forces is None else float(np.abs(forces).max())
        pushes: list[Any] = []
        pulls: list[Any] = []
        if forces is not None and scale > 0.0:
            hips = np.concatenate([state.shown.geometry.base_joints, state.shown.platform_joints])
            balls = np.tile(state.shown.middle_joints, (2, 1))
            for hip, ball, share in zip(hips, balls, forces / scale, strict=True):
                middle, half = (hip + ball) / 2.0, 0.45 * (ball - hip) * abs(share)
                if abs(share) > 0.02:
                    # Away from the actuator's middle where it pushes, towards it where it pulls; at both ends.
                    ends = [(middle, middle + half), (middle, middle - half)]
                    (pushes if share > 0.0 else pulls).extend(ends if share > 0.0 else [(b, a) for a, b in ends])
        self._point("push", pushes)
        self._point("pull", pulls)

    def _point(self, name: str, arrows: list[Any]) -> None:
        handle = self._arrows[name]
        if arrows:
            handle.points = np.array(arrows, dtype=np.float32)
        handle.visible = bool(arrows)

    def show_path(self, points: FloatArray) -> None:
        """Draw a path of o (n, 3) [m]."""
        pieces = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        if len(pieces):
            self.scene.add_line_segments("/path", pieces, colors=(204, 121, 167))


def _onto(point: FloatArray, vector: FloatArray, length: float) -> FloatArray:
    """Return the ends of an arrow of a length from a point along a vector."""
    return np.stack([point, point + length * vector / np.linalg.norm(vector)])


def _ghost_bodies(robot: Robot) -> list[tuple[int, Part]]:
    """Return what differs from branch to branch, one mesh per moving body, each with a part that moves with it."""
    bodies: dict[int, list[int]] = {}
    for k, part in enumerate(robot.parts):
        if part.name.startswith(("leg_", "middle_")):
            bodies.setdefault(part.joint, []).append(k)
    found = []
    for members in bodies.values():
        parts = [robot.parts[k] for k in members]
        starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
        colour = {"leg_b": rgb(_LOWER), "leg_c": rgb(_UPPER)}.get(parts[0].name[:5], parts[0].colour)
        whole = Part(
            parts[0].name,
            parts[0].joint,
            colour,
            np.concatenate([part.vertices for part in parts]),
            np.concatenate([part.faces + np.uint32(start) for part, start in zip(parts, starts, strict=True)]),
        )
        found.append((members[0], whole))
    return found
