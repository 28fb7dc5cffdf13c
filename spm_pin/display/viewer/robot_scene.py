"""A state in a viser scene: the robot, the other branches as ghosts, the load, the requested pose, the trail of o."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from typing import Any

import numpy as np

from spm_pin.description.visuals import section_size
from spm_pin.display.viewer.robot_meshes import MovingMesh, RobotMeshes
from spm_pin.display.viewer.state import State
from spm_pin.display.viewer.state_markup import LOAD, PULL, PUSH, WARN
from spm_pin.mechanism import BRANCHES, LEGS
from spm_pin.mechanism.arguments import FloatArray

OnClick = Callable[[str], Coroutine[Any, Any, None]]
Colour = tuple[int, int, int]

_GHOST_OPACITY = 0.16
_PATH, _TRAIL = (204, 121, 167), (123, 79, 181)
_TRAIL_POINTS = 300
_TRAIL_STEP = 2e-3  # of the base radius


def _rgb(code: str) -> Colour:
    red, green, blue = bytes.fromhex(code.removeprefix("#"))
    return red, green, blue


def _linear(colour: Colour) -> Colour:
    """Return a colour for many instances at once, which viser takes for linear intensities instead of sRGB."""
    red, green, blue = (round(255.0 * (channel / 255.0) ** 2.2) for channel in colour)
    return red, green, blue


class RobotScene:
    """The nodes of one session in a viser scene, of one client or of a whole server.

    The coroutine function `on_click` is called with the label of a ghost that is clicked.
    """

    def __init__(self, scene: Any, robot: RobotMeshes, on_click: OnClick | None = None) -> None:
        self.scene = scene
        self.robot = robot
        self.layers = {"ghosts": False, "names": True, "trail": True}
        """True if the other branches, the names of the legs and the trail of o are shown."""
        geometry = robot.geometry
        self.size = section_size(geometry)
        scene.configure_default_lights(cast_shadow=False)
        radius = 1.6 * geometry.base_radius
        scene.add_grid(
            "/floor",
            width=2.0 * radius,
            height=2.0 * radius,
            cell_size=0.25 * radius,
            section_size=radius,
            cell_color=(205, 208, 212),
            section_color=(180, 184, 190),
            shadow_opacity=0.18,
            position=(0.0, 0.0, -0.3 * self.size),
        )
        self._robot = [self._mesh(f"/robot/{mesh.name}", mesh, mesh.colour) for mesh in robot.meshes]
        # Base and terminal platform are where the robot's are; of the legs their tubes are enough.
        meshes = robot.meshes
        self._in_ghosts = [
            k for k, mesh in enumerate(meshes) if mesh.name.endswith("tube") or mesh.name[:6] == "middle"
        ]
        self._ghosts = [self._ghost(meshes[k], on_click) for k in self._in_ghosts]
        self._colours = [mesh.colour for mesh in meshes]
        # The terminal platform where it should be.
        self._wanted = scene.add_frame("/wanted", show_axes=False, visible=False)
        for mesh in meshes:
            if mesh.name.startswith("terminal"):
                self._mesh(f"/wanted/{mesh.name}", mesh, _rgb(WARN), opacity=0.45)
        self._gap = self._lines("/wanted_gap", _rgb(WARN))
        self._trail = self._lines("/trail", _TRAIL)
        self._trail_points: list[FloatArray] = []
        self._names = [self._label(f"/names/{leg}", leg) for leg in LEGS]
        self._branches = {label: self._label(f"/branches/{label}", label) for label in BRANCHES}
        thicknesses = {"force": (LOAD, 0.05), "moment": (LOAD, 0.03), "push": (PUSH, 0.05), "pull": (PULL, 0.05)}
        self._arrows = {name: self._arrow(name, _rgb(code), share) for name, (code, share) in thicknesses.items()}

    def _mesh(self, name: str, mesh: MovingMesh, colour: Colour, **options: Any) -> Any:
        options |= {"side": "double", "cast_shadow": False, "receive_shadow": False}
        return self.scene.add_mesh_simple(name, mesh.vertices, mesh.faces, color=colour, **options)

    def _ghost(self, mesh: MovingMesh, on_click: OnClick | None) -> Any:
        """Return the node of one mesh of all ghosts, an instance for each branch."""
        count = len(BRANCHES)
        handle = self.scene.add_batched_meshes_simple(
            f"/ghosts/{mesh.name}",
            mesh.vertices,
            mesh.faces,
            batched_wxyzs=np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (count, 1)),
            batched_positions=np.zeros((count, 3), np.float32),
            batched_scales=np.zeros((count, 3), np.float32),
            batched_colors=_linear(mesh.colour),
            opacity=_GHOST_OPACITY,
            lod="off",
            side="double",
            visible=False,
            cast_shadow=False,
            receive_shadow=False,
        )
        if on_click is not None:

            async def clicked(event: Any) -> None:
                if event.instance_index is not None and event.instance_index < count:
                    await on_click(BRANCHES[event.instance_index])

            handle.on_click(clicked)
        return handle

    def _lines(self, name: str, colour: Colour) -> Any:
        return self.scene.add_line_segments(
            name, np.zeros((1, 2, 3), np.float32), colors=colour, thickness=0.03 * self.size, visible=False
        )

    def _label(self, name: str, text: str) -> Any:
        return self.scene.add_label(name, text, anchor="center-center", font_screen_scale=0.85, visible=False)

    def _arrow(self, name: str, colour: Colour, thickness: float) -> Any:
        return self.scene.add_arrows(
            f"/load/{name}",
            np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]]]),
            _linear(colour),
            shaft_radius=thickness * self.size,
            head_radius=2.1 * thickness * self.size,
            head_length=3.5 * thickness * self.size,
            visible=False,
        )

    def show(self, state: State) -> None:
        """Show a state: the robot, its other branches, names, the platform asked for, the load and the trail."""
        placements = self.robot.placements(state.shown)
        for k, (handle, mesh) in enumerate(zip(self._robot, self.robot.meshes, strict=True)):
            handle.position, handle.wxyz = placements.positions[k], placements.quaternions[k]
            handle.scale = tuple(float(x) for x in placements.scales[k])
            beyond = mesh.leg is not None and state.readings.beyond[mesh.leg] != 0.0
            colour = _rgb(WARN) if beyond else mesh.colour
            if colour != self._colours[k]:
                handle.color = self._colours[k] = colour
        self._show_ghosts(state)
        self._show_names(state)
        self._show_wanted(state)
        self._show_load(state)
        self._show_trail(state.shown.translation)

    def _show_ghosts(self, state: State) -> None:
        others = [label in state.labels and label != state.label for label in BRANCHES]
        shown = self.layers["ghosts"] and any(others)
        if shown:
            placements = self.robot.placements(state.solutions[np.flatnonzero(others)])
            for k, handle in zip(self._in_ghosts, self._ghosts, strict=True):
                # An absent branch has no size, so that the number of instances never changes.
                scales, places = np.zeros((2, len(BRANCHES), 3), np.float32)
                turns = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (len(BRANCHES), 1))
                scales[others] = placements.scales[:, k]
                places[others], turns[others] = placements.positions[:, k], placements.quaternions[:, k]
                handle.batched_positions, handle.batched_wxyzs, handle.batched_scales = places, turns, scales
        for handle in self._ghosts:
            assign(handle, "visible", shown)
        taken: list[FloatArray] = []
        for label, other in zip(BRANCHES, others, strict=True):
            handle = self._branches[label]
            named = shown and (other or label == state.label)
            if named:
                place = _free_place(state.solutions[label].middle_joints, taken)
                taken.append(place)
                handle.position, handle.text = place, f"{label} ◀" if label == state.label else label
            assign(handle, "visible", named)

    def _show_names(self, state: State) -> None:
        """Name each leg beside its middle, away from the axis of its stage."""
        shown = state.shown
        axis = shown.middle_pose.as_matrix()[:3, 3]
        centres = np.stack([0.5 * axis, 0.5 * (axis + shown.translation)]).repeat(3, axis=0)
        middles = 0.5 * (shown.leg_bases + shown.balls)
        outward = _unit(middles - centres)
        for k, handle in enumerate(self._names):
            if self.layers["names"]:
                handle.position = middles[k] + 0.42 * self.size * outward[k]
            assign(handle, "visible", self.layers["names"])

    def _show_wanted(self, state: State) -> None:
        apart = state.distance > 0.0
        if apart:
            self._wanted.position = state.target.translation
            self._wanted.wxyz = state.target.rotation.as_quat(scalar_first=True)
            self._gap.points = np.stack([state.shown.translation, state.target.translation])[None].astype(np.float32)
        assign(self._wanted, "visible", apart)
        assign(self._gap, "visible", apart)

    def _show_load(self, state: State) -> None:
        o, wrench = state.shown.translation, state.wrench
        length = 1.1 * self.size
        force, moment = wrench[:3], wrench[3:]
        self._point("force", [_onto(o, force, length)] if force.any() else [])
        # A moment has two heads.
        axis = _onto(o, moment, length) if moment.any() else None
        self._point("moment", [axis, np.stack([o, o + 0.82 * (axis[1] - o)])] if axis is not None else [])
        forces = np.zeros(6) if state.readings.forces is None else state.readings.forces
        shares = forces / max(float(np.abs(forces).max()), 1e-300)
        bases, balls = state.shown.leg_bases, state.shown.balls
        # Beside the leg, on its side away from the robot's axis.
        middles = (bases + balls) / 2.0
        middles = middles + 0.2 * self.size * _unit(middles - 0.5 * o)
        half = 0.45 * (balls - bases) * np.abs(shares)[:, None]
        # Away from the actuator's middle where it pushes, towards it where it pulls; at both ends.
        outward = np.stack([[middles, middles + half], [middles, middles - half]]).transpose(2, 0, 1, 3)
        self._point("push", outward[shares > 0.02].reshape(-1, 2, 3))
        self._point("pull", outward[shares < -0.02][:, :, ::-1].reshape(-1, 2, 3))

    def _point(self, name: str, arrows: Sequence[FloatArray] | FloatArray) -> None:
        handle = self._arrows[name]
        if len(arrows):
            handle.points = np.array(arrows, dtype=np.float32)
        assign(handle, "visible", len(arrows) > 0)

    def _show_trail(self, o: FloatArray) -> None:
        points = self._trail_points
        if not points or np.linalg.norm(o - points[-1]) > _TRAIL_STEP * self.robot.geometry.base_radius:
            if points and np.linalg.norm(o - points[-1]) > self.size:
                points.clear()  # the robot was put elsewhere
            points.append(np.array(o))
            del points[:-_TRAIL_POINTS]
            if len(points) > 1 and self.layers["trail"]:
                self._trail.points = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        assign(self._trail, "visible", self.layers["trail"] and len(points) > 1)

    def clear_trail(self) -> None:
        """Begin the trail of o anew."""
        self._trail_points.clear()

    def show_path(self, points: FloatArray) -> None:
        """Draw a path of o (n, 3) [m]."""
        pieces = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        if len(pieces):
            self.scene.add_line_segments("/path", pieces, colors=_PATH, thickness=0.03 * self.size)


def assign(handle: Any, name: str, value: Any) -> None:
    """Set a property of a node or a widget, with a message only where that changes something."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def _free_place(joints: FloatArray, taken: list[FloatArray]) -> FloatArray:
    """Return a place for a branch's name at the rim of its middle platform, as far as can be from the names there."""
    rim = np.concatenate([joints, (joints + np.roll(joints, 1, axis=0)) / 2.0])
    places = rim + 0.25 * (rim - joints.mean(axis=0))
    gaps = [np.linalg.norm(places - other, axis=-1) for other in taken]
    return np.asarray(places[int(np.min(gaps, axis=0).argmax()) if gaps else 0])


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def _onto(point: FloatArray, vector: FloatArray, length: float) -> FloatArray:
    """Return the ends of an arrow of a length from a point along a vector."""
    return np.stack([point, point + length * _unit(vector)])
