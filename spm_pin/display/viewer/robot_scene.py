"""A state in a viser scene: the robot, the other branches as ghosts, the load, the requested pose, the trail of o."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.description.visuals import VisualPart, part_placements, section_size, visual_parts
from spm_pin.display.rendering import camera_axes
from spm_pin.display.viewer.model import State
from spm_pin.mechanism import BRANCHES, LEGS, Configuration, Geometry
from spm_pin.mechanism.arguments import FloatArray

WARN, PUSH, PULL, LOAD = "#C8102E", "#0072B2", "#D55E00", "#7A4FB5"
"""After Okabe and Ito's palette, distinct with any colour vision; limits and warnings have a red of their own, darker
than all colours of the robot."""

VIEWS = {"Home": (15.0, 25.0), "Front": (0.0, 4.0), "Side": (90.0, 4.0), "Top": (0.0, 89.0)}
"""Azimuth and elevation of the viewer in {B} [degrees]; the first is that of the pictures."""

FIELD_OF_VIEW = np.deg2rad(28.0)
"""Vertical [rad]: narrow, as the pictures are parallel projections."""
_STRETCHED = ("tube", "gland")
"""Meshes of a leg with placements of their own, which depend on its length."""

OnClick = Callable[[str], Coroutine[Any, Any, None]]
Colour = tuple[int, int, int]

_GHOST_OPACITY = 0.16
_PATH, _TRAIL = (204, 121, 167), (123, 79, 181)
_TRAIL_POINTS = 300
_TRAIL_STEP = 2e-3  # of the base radius


@dataclass(frozen=True, eq=False)
class MovingMesh:
    """A mesh of one colour that moves as one."""

    name: str  # name of the first of its parts, see `VisualPart`
    leg: int | None  # index in `LEGS` of the leg that it belongs to; None for the platforms
    colour: tuple[int, int, int]  # red, green and blue in sRGB, from 0 to 255
    vertices: npt.NDArray[np.float32]  # vertices in the frame of its body [m], shape (n, 3)
    faces: npt.NDArray[np.uint32]  # triangles, shape (m, 3)
    part: int  # index of the part whose placement it has


@dataclass(frozen=True)
class Placements:
    """Placements of meshes in {B}."""

    positions: FloatArray  # origins in {B} [m], shape (..., 3)
    quaternions: FloatArray  # unit quaternions, scalar first, shape (..., 4)
    scales: FloatArray  # scales along the axes of the mesh, shape (..., 3)


class RobotMeshes:
    """The meshes of a manipulator; read-only, so any number of sessions may share them."""

    def __init__(self, geometry: Geometry) -> None:
        self.geometry = geometry
        groups: dict[tuple[str, tuple[int, int, int], str], list[tuple[int, VisualPart]]] = {}
        for k, part in enumerate(visual_parts(geometry)):
            red, green, blue = (round(255.0 * x) for x in part.colour)
            separate = part.name if part.mesh in _STRETCHED else ""
            groups.setdefault((part.body, (red, green, blue), separate), []).append((k, part))
        self.meshes = tuple(_joined(colour, body, members) for (body, colour, _), members in groups.items())
        self._parts = [mesh.part for mesh in self.meshes]

    def placements(self, configuration: Configuration) -> Placements:
        """Return positions, rotations and scales of the meshes in configurations (...): arrays of shape (..., n, k)."""
        matrices = part_placements(configuration)[..., self._parts, :, :]
        scales = np.linalg.norm(matrices[..., :3, :3], axis=-2)
        rotations = matrices[..., :3, :3] / scales[..., None, :]
        turns = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat(scalar_first=True)
        return Placements(matrices[..., :3, 3], turns.reshape(*rotations.shape[:-2], 4), scales)


def _joined(colour: tuple[int, int, int], body: str, members: list[tuple[int, VisualPart]]) -> MovingMesh:
    starts = np.cumsum([0, *(len(part.vertices) for _, part in members)])
    vertices = np.concatenate([part.vertices for _, part in members])
    faces = np.concatenate([part.faces + start for (_, part), start in zip(members, starts, strict=False)])
    leg = f"r_{body.partition('_')[2][:2]}"
    return MovingMesh(
        name=members[0][1].name.replace(" ", "_"),
        leg=LEGS.index(leg) if leg in LEGS else None,
        colour=colour,
        vertices=np.asarray(vertices, np.float32),
        faces=np.asarray(faces, np.uint32),
        part=members[0][0],
    )


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
            beyond = mesh.leg is not None and state.measures.limit_excess[mesh.leg] != 0.0
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
        forces = np.zeros(6) if state.measures.forces is None else state.measures.forces
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


def robot_points(configuration: Configuration, margin: float) -> FloatArray:
    """Return corners (n, 3) of boxes of half a side `margin` around the joints and o [m]; a picture shows them all."""
    joints = [configuration.leg_bases, configuration.middle_joints, configuration.translation[None]]
    corners = margin * (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1.0)
    return np.asarray((np.concatenate(joints)[:, None] + corners).reshape(-1, 3))


def fit_camera(
    points: FloatArray, view: tuple[float, float], aspect: float, covered: float = 0.0, border: float = 0.06
) -> tuple[FloatArray, FloatArray]:
    """Return the position of a camera and the point that it looks at [m], for points (n, 3) to fill its picture.

    `view` is the azimuth and elevation of the viewer [degrees], `aspect` width over height of the whole picture. From
    below something covers the share `covered` of it; a `border`, in shares of its height, stays empty at every edge.
    """
    azimuth, elevation = np.deg2rad(view)
    axes = camera_axes((float(azimuth), float(elevation)))
    half = np.tan(0.5 * FIELD_OF_VIEW)
    # Tangents of the viewing angles at the edges of the free part.
    high = half * np.array([aspect - 2.0 * border, 1.0 - 2.0 * border])
    low = np.array([-high[0], half * (2.0 * covered - 1.0 + 2.0 * border)])
    local = points @ axes.T
    centre, distance = local.mean(axis=0), 4.0 * float(np.ptp(local, axis=0).max())
    for _ in range(30):
        offset = local - centre
        tangents = offset[:, :2] / (distance - offset[:, 2:])
        least, most = tangents.min(axis=0), tangents.max(axis=0)
        centre[:2] += 0.5 * (least + most - low - high) * distance
        distance *= float(((most - least) / (high - low)).max())
    return (centre + np.array([0.0, 0.0, distance])) @ axes, centre @ axes
