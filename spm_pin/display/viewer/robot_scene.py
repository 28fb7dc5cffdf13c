"""A state of either machine in a viser scene: branches as ghosts, the load, the requested pose, the workspace."""

from __future__ import annotations

from collections.abc import Callable, Coroutine, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from spm_pin.capability import wrench_polytope
from spm_pin.crosscheck.paper_shell import workspace_shell
from spm_pin.description.visuals import part_placements, platforms, section_size, visual_parts
from spm_pin.display.rendering import view_axes
from spm_pin.display.viewer.model import SessionState, sampled_states
from spm_pin.display.viewer.stage_model import StageState
from spm_pin.errors import SpmError
from spm_pin.machine import BRANCHES, Configuration, Manipulator, Stage
from spm_pin.support.arguments import FloatArray

WARN, LOAD = (200, 16, 46), (122, 79, 181)
"""Limits and warnings have a red of their own, darker than all colours of the robot, and loads a violet: the load on
the platform and the leg forces that balance it."""
VIEWS = {"Home": (15.0, 25.0), "Front": (0.0, 4.0), "Side": (90.0, 4.0), "Top": (0.0, 89.0)}
"""Azimuth and elevation of the viewer in {B} [degrees]; the first is that of the pictures."""
FIELD_OF_VIEW = np.deg2rad(28.0)
"""Vertical viewing angle [rad]: narrow, because the pictures are parallel projections."""
_BORDER = 0.06
"""Empty border at every edge of a picture, relative to its height."""

OnClick = Callable[[str], Coroutine[Any, Any, None]]
Colour = tuple[int, ...]

_SOLID = {"side": "double", "cast_shadow": False, "receive_shadow": False}
_NOT_TURNED = np.array([1.0, 0.0, 0.0, 0.0], np.float32)
_GHOST_OPACITY = 0.16
_PATH, _TRAIL, _WORKSPACE, _FORCES = (204, 121, 167), (140, 70, 110), (86, 180, 233), (0, 158, 115)
_TRAIL_POINTS = 300
_TRAIL_STEP = 2e-3  # of the base radius
_SHELL_RESOLUTION = 14  # coarse enough to be sent to a page


def solid_placements(configuration: Configuration) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the placements of the solids of `visual_parts` in configurations (...).

    The positions of their origins in {B} [m], shape (..., n, 3), their quaternions, scalar first, shape (..., n, 4),
    and the scales along their axes, shape (..., n, 3).
    """
    matrices = part_placements(configuration)
    scales = np.linalg.norm(matrices[..., :3, :3], axis=-2)
    quaternions = Rotation.from_matrix(matrices[..., :3, :3] / scales[..., None, :]).as_quat(scalar_first=True)
    return matrices[..., :3, 3], quaternions, scales


@lru_cache(maxsize=4)
def _shell(machine: Manipulator) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    shell = workspace_shell(machine, resolution=_SHELL_RESOLUTION)
    return np.asarray(shell.vertices, np.float32), np.asarray(shell.faces, np.uint32)


def _linear(colour: Colour) -> Colour:
    """Return a colour for many instances at once, which viser reads as linear intensities instead of sRGB."""
    return tuple(round(255.0 * (channel / 255.0) ** 2.2) for channel in colour)


class RobotScene:
    """The nodes of one session in a client's viser scene; `on_click` is called with the label of a clicked ghost."""

    def __init__(self, scene: Any, machine: Manipulator | Stage, on_click: OnClick) -> None:
        self.scene = scene
        self.machine = machine
        self._legs = machine.legs.names
        # What `show` shows besides the robot.
        self.layers = {"ghosts": False, "names": True, "trail": True, "forces": False}
        self._parts, self.size, platform = visual_parts(machine), section_size(machine), platforms(machine)[-1]
        self._colours = [tuple(round(255.0 * channel) for channel in part.colour) for part in self._parts]
        scene.configure_default_lights(cast_shadow=False)
        radius = 1.6 * machine.base_radius
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
        self._robot = [self._mesh(f"/robot/{k}", k) for k in range(len(self._parts))]
        # Base and terminal platform coincide with the robot's; tubes are enough for the legs.
        self._ghosts = {
            k: self._ghost(k, on_click) for k, part in enumerate(self._parts) if part.mesh in ("tube", "middle_plate")
        }
        # The terminal platform in the requested pose.
        self._wanted = scene.add_frame("/wanted", show_axes=False, visible=False)
        for k, part in enumerate(self._parts):
            if part.body == platform:
                self._mesh(f"/wanted/{k}", k, color=WARN, opacity=0.45)
        self._gap = self._lines("/wanted_gap", WARN)
        self._trail = self._lines("/trail", _TRAIL)
        self._trail_points: list[FloatArray] = []
        self._has_forces = False
        self._names = [self._label(f"/names/{leg}", leg) for leg in self._legs]
        self._branches = {label: self._label(f"/branches/{label}", label) for label in BRANCHES}
        thicknesses = {"force": 0.05, "moment": 0.03, "legs": 0.05}
        self._arrows = {name: self._arrow(name, thickness) for name, thickness in thicknesses.items()}

    def _mesh(self, name: str, index: int, **options: Any) -> Any:
        options = {"color": self._colours[index], **_SOLID, **options}
        part = self._parts[index]
        return self.scene.add_mesh_simple(name, np.float32(part.vertices), np.uint32(part.faces), **options)

    def _ghost(self, index: int, on_click: OnClick) -> Any:
        """Return the node of one solid of all ghosts, an instance for each branch."""
        count, part = len(BRANCHES), self._parts[index]
        handle = self.scene.add_batched_meshes_simple(
            f"/ghosts/{index}",
            np.float32(part.vertices),
            np.uint32(part.faces),
            batched_wxyzs=np.tile(_NOT_TURNED, (count, 1)),
            batched_positions=np.zeros((count, 3), np.float32),
            batched_scales=np.zeros((count, 3), np.float32),
            batched_colors=_linear(self._colours[index]),
            opacity=_GHOST_OPACITY,
            lod="off",
            visible=False,
            **_SOLID,
        )

        async def clicked(event: Any) -> None:
            if event.instance_index is not None:
                await on_click(BRANCHES[event.instance_index])

        handle.on_click(clicked)
        return handle

    def _lines(self, name: str, colour: Colour) -> Any:
        return self.scene.add_line_segments(
            name, np.zeros((1, 2, 3), np.float32), colors=colour, thickness=0.03 * self.size, visible=False
        )

    def _label(self, name: str, text: str) -> Any:
        return self.scene.add_label(name, text, anchor="center-center", font_screen_scale=0.85, visible=False)

    def _arrow(self, name: str, thickness: float) -> Any:
        return self.scene.add_arrows(
            f"/load/{name}",
            np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 0.01]]]),
            _linear(LOAD),
            shaft_radius=thickness * self.size,
            head_radius=2.1 * thickness * self.size,
            head_length=3.5 * thickness * self.size,
            visible=False,
        )

    def show(self, state: SessionState | StageState) -> None:
        """Show a state without its forces; only changes are sent to viser."""
        beyond = {f"leg_{leg[2:]}" for leg, excess in zip(self._legs, state.shown.limit_excess, strict=True) if excess}
        nodes = zip(self._robot, self._parts, self._colours, *solid_placements(state.shown), strict=True)
        for handle, part, colour, position, quaternion, scale in nodes:
            handle.position, handle.wxyz, handle.scale = position, quaternion, tuple(scale.tolist())
            handle.color = WARN if part.body.rpartition("_")[0] in beyond else colour
        for handle, place in zip(self._names, _beside_legs(state.shown, 0.42 * self.size), strict=True):
            handle.position, handle.visible = place, self.layers["names"]
        if state.distance > 0.0:
            self._wanted.position = state.target.translation
            self._wanted.wxyz = state.target.rotation.as_quat(scalar_first=True)
            self._gap.points = _segments([state.shown.translation, state.target.translation])
        self._wanted.visible = self._gap.visible = state.distance > 0.0
        if isinstance(state, SessionState):
            self._show_ghosts(state)
        self._show_trail(state.shown.translation)

    def _show_ghosts(self, state: SessionState) -> None:
        others = [label in state.labels and label != state.label for label in BRANCHES]
        shown = self.layers["ghosts"] and any(others)
        if shown:
            # A missing branch has size zero, so that the number of instances never changes.
            scales, positions = np.zeros((2, len(BRANCHES), len(self._parts), 3), np.float32)
            quaternions = np.tile(_NOT_TURNED, (len(BRANCHES), len(self._parts), 1))
            positions[others], quaternions[others], scales[others] = solid_placements(
                state.solutions.configurations[np.flatnonzero(others)]
            )
            for k, handle in self._ghosts.items():
                handle.batched_positions, handle.batched_wxyzs = positions[:, k], quaternions[:, k]
                handle.batched_scales = scales[:, k]
        for handle in self._ghosts.values():
            handle.visible = shown
        places: list[FloatArray] = []
        for label, other in zip(BRANCHES, others, strict=True):
            handle = self._branches[label]
            named = shown and (other or label == state.label)
            if named:
                places.append(_free_place(state.solutions[label].middle_joints, places))
                handle.position, handle.text = places[-1], f"{label} ◀" if label == state.label else label
            handle.visible = named

    def show_forces(self, state: SessionState | StageState) -> None:
        """Show the load, the leg forces that balance it, and the forces that legs of equal strength can hold."""
        o, wrench = state.shown.translation, state.wrench
        length = 1.1 * self.size
        force, moment = wrench[:3], wrench[3:]
        self._point("force", [_onto(o, force, length)] if force.any() else [])
        axis = _onto(o, moment, length)
        # A moment has two heads.
        self._point("moment", [axis, np.stack([o, o + 0.82 * (axis[1] - o)])] if moment.any() else [])
        forces = np.zeros(len(self._legs)) if state.forces is None else state.forces
        shares = forces / max(float(np.abs(forces).max()), 1e-300)
        middles = _beside_legs(state.shown, 0.2 * self.size)
        half = 0.45 * state.shown.leg_vectors * np.abs(shares)[:, None]
        # Away from the actuator's middle if it pushes, towards it if it pulls; at both ends.
        outward = np.stack([[middles, middles + half], [middles, middles - half]]).transpose(2, 0, 1, 3)
        outward[shares < 0.0] = outward[shares < 0.0][:, :, ::-1]
        self._point("legs", outward[np.abs(shares) > 0.02].reshape(-1, 2, 3))
        if isinstance(state, SessionState):
            self._show_held_forces(state.shown)

    def _point(self, name: str, arrows: Sequence[FloatArray] | FloatArray) -> None:
        handle = self._arrows[name]
        if len(arrows):
            handle.points = np.array(arrows, dtype=np.float32)
        handle.visible = len(arrows) > 0

    def _show_trail(self, o: FloatArray) -> None:
        points = self._trail_points
        step = float(np.linalg.norm(o - points[-1])) if points else np.inf
        if step > self.size:
            points.clear()  # the robot was moved elsewhere
        if step > _TRAIL_STEP * self.machine.base_radius:
            points.append(np.array(o))
            del points[:-_TRAIL_POINTS]
            if len(points) > 1 and self.layers["trail"]:
                self._trail.points = _segments(points)
        self._trail.visible = self.layers["trail"] and len(points) > 1

    def _show_held_forces(self, state: Configuration) -> None:
        """Show the forces at o allowed by equal limits of leg forces: the robot's size stands for one limit."""
        shown = self.layers["forces"]
        if not shown and not self._has_forces:
            return
        try:
            section = wrench_polytope(state, 1.0).section("linear") if shown else None
        except SpmError:  # at a singularity, or if the state is missing
            section = None
        self._has_forces = section is not None
        if section is None:
            self.scene.remove_by_name("/forces")
            return
        points = np.float32(state.translation + self.size * section.vertices)
        options = {"opacity": 0.45, "flat_shading": True, **_SOLID}
        self.scene.add_mesh_simple("/forces", points, np.uint32(section.faces), color=_FORCES, **options)

    def clear_trail(self) -> None:
        """Begin a new trail of o."""
        self._trail_points.clear()

    def show_workspace(self, layer: str, shown: bool) -> None:
        """Add or remove the "shell" of the paper, or the "points" that o reaches."""
        name = f"/{layer}"
        if not shown:
            self.scene.remove_by_name(name)
        elif layer == "points":
            points = np.asarray(sampled_states(self.machine).translation, np.float32)
            self.scene.add_point_cloud(name, points, colors=_WORKSPACE, point_size=0.008, point_shape="circle")
        else:
            options = {"opacity": 0.25, "side": "double", "cast_shadow": False}
            self.scene.add_mesh_simple(name, *_shell(self.machine), color=_WORKSPACE, **options)

    def show_path(self, points: FloatArray) -> None:
        """Draw a path of o (n, 3) [m]."""
        if len(points) > 1:
            self.scene.add_line_segments("/path", _segments(points), colors=_PATH, thickness=0.03 * self.size)


def _segments(points: Sequence[FloatArray] | FloatArray) -> npt.NDArray[np.float32]:
    return np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)


def _free_place(joints: FloatArray, others: list[FloatArray]) -> FloatArray:
    """Return the position of a branch's name at the rim of its middle platform that is farthest from the others."""
    rim = np.concatenate([joints, (joints + np.roll(joints, 1, axis=0)) / 2.0])
    places = rim + 0.25 * (rim - joints.mean(axis=0))
    gaps = [np.linalg.norm(places - other, axis=-1) for other in others]
    return np.asarray(places[int(np.min(gaps, axis=0).argmax()) if gaps else 0])


def _beside_legs(state: Configuration, distance: float) -> FloatArray:
    """Return points (legs, 3) beside the middles of the legs, away from the axis of their stage."""
    ends = np.array([np.zeros(3), state.middle_pose.translation, state.translation])
    centres = (0.5 * (ends[:-1] + ends[1:])).repeat(3, axis=0)[: len(state.balls)]
    middles = 0.5 * (state.leg_bases + state.balls)
    return np.asarray(middles + distance * _unit(middles - centres))


def _unit(vectors: FloatArray) -> FloatArray:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12))


def _onto(point: FloatArray, vector: FloatArray, length: float) -> FloatArray:
    """Return the ends of an arrow of a length from a point along a vector."""
    return np.stack([point, point + length * _unit(vector)])


def robot_points(configuration: Configuration, margin: float) -> FloatArray:
    """Return corners (n, 3) of boxes of half a side `margin` around the joints and o [m]; a picture shows them all."""
    state = configuration
    joints = [state.leg_bases, state.circle_centres, state.balls, state.translation[None]]
    corners = margin * (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1.0)
    return np.asarray((np.concatenate(joints)[:, None] + corners).reshape(-1, 3))


def fit_camera(
    points: FloatArray, view: tuple[float, float], aspect: float, covered: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the position of a camera and the point that it looks at [m], for points (n, 3) to fill its picture.

    `view` is the azimuth and elevation of the viewer [degrees], `aspect` width over height of the whole picture. From
    below a part `covered` of it is hidden; `_BORDER` stays empty at every edge.
    """
    axes = view_axes(*np.deg2rad(view))
    half = np.tan(0.5 * FIELD_OF_VIEW)
    # Tangents of the viewing angles at the edges of the free part.
    high = half * np.array([aspect - 2.0 * _BORDER, 1.0 - 2.0 * _BORDER])
    low = np.array([-high[0], half * (2.0 * covered - 1.0 + 2.0 * _BORDER)])
    local = points @ axes.T
    centre, distance = local.mean(axis=0), 4.0 * float(np.ptp(local, axis=0).max())
    for _ in range(30):
        offset = local - centre
        tangents = offset[:, :2] / (distance - offset[:, 2:])
        least, most = tangents.min(axis=0), tangents.max(axis=0)
        centre[:2] += 0.5 * (least + most - low - high) * distance
        distance *= float(((most - least) / (high - low)).max())
    return (centre + np.array([0.0, 0.0, distance])) @ axes, centre @ axes
