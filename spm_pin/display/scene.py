"""The manipulator as a scene: named, coloured solids in {B}, made from a configuration and nothing else.

Sizes across (radii, thicknesses) follow from the geometry alone, so that pictures of different poses of one
machine compare; sizes along (legs, plates) are where the joints are.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial import Delaunay

from spm_pin.errors import ArgumentError, MissingExtraError
from spm_pin.mechanism.arguments import FloatArray
from spm_pin.mechanism.configuration import Configuration
from spm_pin.mechanism.geometry import LEGS

if TYPE_CHECKING:
    import trimesh

__all__ = ["COLOURS", "TRIAD", "Colour", "Scene", "Solid", "plots_extra", "scene"]

Colour = tuple[float, float, float]
"""Red, green and blue in sRGB, from 0 to 1."""


def _rgb(code: str) -> Colour:
    red, green, blue = bytes.fromhex(code)
    return red / 255.0, green / 255.0, blue / 255.0


# Hues of Okabe and Ito, https://jfly.uni-koeln.de/color/, which stay apart in every kind of colour blindness.
COLOURS: dict[str, Colour] = {
    "lower leg": _rgb("0072B2"),
    "lower rod": _rgb("8CC4E6"),
    "upper leg": _rgb("E69F00"),
    "upper rod": _rgb("FFE3A3"),
    "base": _rgb("979EA6"),
    "middle platform": _rgb("DDE0E3"),
    "terminal platform": _rgb("B9BFC6"),
    "joint": _rgb("454B52"),
    "x axis": _rgb("D55E00"),
    "y axis": _rgb("009E73"),
    "z axis": _rgb("5A3FB0"),
}

TRIAD = 0.5
"""Length of a frame's arrows over `Scene.size`."""


@dataclass(frozen=True)
class Solid:
    """One primitive body of a scene.

    Attributes
    ----------
    name : str
        What it is: ``"r_b1 barrel"``, ``"b_2 ball"``, ``"middle platform"``; unique in its scene.
    kind : {"plate", "leg", "joint", "frame"}
        A frame's arrows are drawn in place like the rest, but are no part of the machine.
    colour : tuple of three floats
        sRGB, from 0 to 1.
    mesh : trimesh.Trimesh
        Closed surface in {B} [m].
    """

    name: str
    kind: Literal["plate", "leg", "joint", "frame"]
    colour: Colour
    mesh: trimesh.Trimesh


@dataclass(frozen=True)
class Scene:
    """The solids of one configuration; ``scene["r_b1 rod"]`` finds one by its name.

    Attributes
    ----------
    solids : tuple of Solid
        All of them.
    size : float
        The length that all cross-sections are in proportion to [m].
    """

    solids: tuple[Solid, ...]
    size: float

    def __getitem__(self, name: str) -> Solid:
        for solid in self.solids:
            if solid.name == name:
                return solid
        raise KeyError(f"{name!r}; the solids are {', '.join(solid.name for solid in self.solids)}")


@contextmanager
def plots_extra() -> Iterator[None]:
    """Turn the absence of matplotlib or trimesh into an error that says how to install them.

    Raises
    ------
    MissingExtraError
        If an import inside the block fails for want of either.
    """
    try:
        yield
    except ModuleNotFoundError as missing:
        package = (missing.name or "").partition(".")[0]
        if package not in ("matplotlib", "trimesh"):
            raise
        raise MissingExtraError("plots", package) from missing


def scene(configuration: Configuration, *, frames: bool = True) -> Scene:
    """Build the solids of a configuration.

    Plates for base, middle and terminal platform; at every a_i and c_i a transverse pin along the revolute
    axis; at every b_i a ball in a housing; and for every leg a barrel, from the axis of its revolute joint,
    and a rod to the ball's centre.

    Parameters
    ----------
    configuration : Configuration
        A single configuration, shape (), that exists.
    frames : bool
        Add triads of arrows for {B} and {m}: ``"{B} x"`` and so on.

    Returns
    -------
    Scene
        Meshes in {B} [m].

    Raises
    ------
    ArgumentError
        If the configuration is a batch, does not exist, has a leg of no length, or its three middle joints
        lie on one line.
    MissingExtraError
        If trimesh is not installed.
    """
    _check(configuration)
    with plots_extra():
        import_module("trimesh")

    geometry = configuration.geometry
    radii = (geometry.base_radius, geometry.middle_radius, geometry.platform_radius)
    size = min(sum(radii) / 3.0, 1.5 * min(radii))
    base = (np.eye(3), np.zeros(3))
    middle = configuration.middle_pose.as_matrix()
    terminal = (configuration.rotation, configuration.translation)
    solids = [
        _plate("base", geometry.base_radius - 0.5 * size, 0.22 * size, 0.14 * size, base),
        _plate("middle platform", geometry.middle_radius, 0.15 * size, 0.07 * size, (middle[:3, :3], middle[:3, 3])),
        _plate("terminal platform", geometry.platform_radius - 0.42 * size, 0.17 * size, 0.12 * size, terminal),
    ]
    for i in range(3):
        a, b, c = (p[i] for p in (geometry.base_joints, configuration.middle_joints, configuration.platform_joints))
        radial = geometry.radial_directions[i]
        solids += _revolute(f"a_{i + 1}", "base", a, geometry.revolute_axes[i], radial, 1.15 * size)
        solids += _revolute(
            f"c_{i + 1}", "terminal platform", c, configuration.platform_axes[i], terminal[0] @ radial, 0.95 * size
        )
        solids += _ball(f"b_{i + 1}", b, middle[:3, 2], size)
        lower, upper = LEGS[i], LEGS[i + 3]
        axes = geometry.revolute_axes[i], configuration.platform_axes[i]
        solids += _leg(lower, "lower", a, axes[0], b, _barrel_length(configuration, lower), size)
        solids += _leg(upper, "upper", c, axes[1], b, _barrel_length(configuration, upper), size)
    if frames:
        solids += _triad("{B}", base, size) + _triad("{m}", terminal, size)
    return Scene(tuple(solids), size)


def _check(configuration: Configuration) -> None:
    if not isinstance(configuration, Configuration):
        cause = "A SolutionSet? Choose one of its solutions, for instance .physical()"
        raise ArgumentError("configuration", "a Configuration", type(configuration).__name__, cause)
    if configuration.shape:
        cause = "Choose one by its index: configuration[0]"
        raise ArgumentError("configuration", "a single configuration", f"a batch of shape {configuration.shape}", cause)
    if not configuration.exists:
        cause = "The pose has no such real branch: see .status and .exists of the SolutionSet"
        raise ArgumentError("configuration", "a configuration that exists", "NaN", cause)
    if not (configuration.leg_lengths > 0.0).all():
        raise ArgumentError("configuration", "legs of positive length", configuration.leg_lengths)
    if not np.isfinite(configuration.middle_pose.as_matrix()).all():
        raise ArgumentError("configuration", "middle joints that span a plane", configuration.middle_joints.tolist())


def _barrel_length(configuration: Configuration, leg: str) -> float:
    """Return the length of a leg's barrel [m]: the same in every pose, as far as the leg's length admits."""
    index = LEGS.index(leg)
    limits = configuration.geometry.limits
    shortest = limits.minimum[index] if limits is not None else 0.0
    length = float(configuration.leg_lengths[index])
    return min(0.6 * shortest or 0.5 * length, 0.8 * length)


def _cylinder(start: FloatArray, end: FloatArray, radius: float) -> trimesh.Trimesh:
    import trimesh

    cylinder: trimesh.Trimesh = trimesh.creation.cylinder(radius, segment=np.stack([start, end]), sections=48)
    return cylinder


def _cone(start: FloatArray, end: FloatArray, radius: float) -> trimesh.Trimesh:
    import trimesh

    axis = end - start
    height = float(np.linalg.norm(axis))
    cone = trimesh.creation.cone(radius, height, sections=48)
    cone.apply_transform(_placed(_basis(axis / height), start))
    return cone


def _prism(
    outline: FloatArray, thickness: float, placement: FloatArray, hubs: FloatArray | None = None
) -> trimesh.Trimesh:
    """Return a plate in the local x-y plane, half its thickness on either side.

    `outline` (n, 2) [m] is convex and runs counter-clockwise. Points `hubs` (k, 2) inside it keep the triangles of
    the faces from being slivers.
    """
    import trimesh

    points = outline if hubs is None else np.vstack([outline, hubs])
    n, total = len(outline), len(points)
    cap = Delaunay(points).simplices
    here = np.arange(n)
    there = np.roll(here, -1)
    walls = np.stack([here, here + total, there, there, here + total, there + total], axis=-1).reshape(-1, 3)
    half = np.full((total, 1), thickness / 2.0)
    vertices = np.vstack([np.hstack([points, half]), np.hstack([points, -half])])
    mesh = trimesh.Trimesh(vertices, np.vstack([cap, cap[:, ::-1] + total, walls]), process=False)
    return mesh.apply_transform(placement)


def _placed(rotation: FloatArray, origin: FloatArray) -> FloatArray:
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, origin
    return transform


def _basis(z: FloatArray, x: FloatArray | None = None) -> FloatArray:
    """Return a rotation whose third column is the unit vector `z`, its first near `x` where that matters."""
    x = np.eye(3)[np.abs(z).argmin()] if x is None else x
    y = np.cross(z, x)
    y = y / np.linalg.norm(y)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def _arc(centre: npt.ArrayLike, radius: float, start: float, end: float) -> FloatArray:
    angles = np.linspace(start, end, 9)
    return np.asarray(centre, dtype=np.float64) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)


Placement = tuple[FloatArray, FloatArray]


def _plate(name: str, reach: float, corner: float, thickness: float, placement: Placement) -> Solid:
    """Return a triangle of rounded corners, their centres at the radius `reach` towards legs 1, 2 and 3."""
    azimuths = np.deg2rad([-30.0, 90.0, 210.0])
    hubs = reach * np.stack([np.cos(azimuths), np.sin(azimuths)], axis=-1)
    arcs = [_arc(hub, corner, t - math.pi / 3, t + math.pi / 3) for hub, t in zip(hubs, azimuths, strict=True)]
    return Solid(name, "plate", COLOURS[name], _prism(np.vstack(arcs), thickness, _placed(*placement), hubs))


def _revolute(
    name: str, plate: str, centre: FloatArray, axis: FloatArray, radial: FloatArray, size: float
) -> list[Solid]:
    """Return a pin along the revolute axis, in two cheeks that stand out from the plate's corner."""
    pin = 0.21 * size * axis
    length, height = 0.33 * size, 0.095 * size
    outline = np.vstack(
        [
            _arc((length / 2, 0.0), height, -math.pi / 2, math.pi / 2),
            [[-length / 2, height], [-length / 2, -height]],
        ]
    )
    cheek = _basis(axis, radial)
    solids = [Solid(f"{name} pin", "joint", COLOURS["joint"], _cylinder(centre - pin, centre + pin, 0.055 * size))]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        origin = centre - length / 2 * cheek[:, 0] + sign * 0.14 * size * axis
        mesh = _prism(outline, 0.06 * size, _placed(cheek, origin))
        solids.append(Solid(f"{name} {side} cheek", "plate", COLOURS[plate], mesh))
    return solids


def _ball(name: str, centre: FloatArray, normal: FloatArray, size: float) -> list[Solid]:
    """Return the compound ball joint: one ball for both legs, in a housing on the middle platform's corner."""
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.135 * size)
    ball.apply_translation(centre)
    half = 0.065 * size * normal
    housing = _cylinder(centre - half, centre + half, 0.185 * size)
    return [
        Solid(f"{name} ball", "joint", COLOURS["joint"], ball),
        Solid(f"{name} housing", "plate", COLOURS["middle platform"], housing),
    ]


def _leg(
    name: str, stage: str, hip: FloatArray, axis: FloatArray, ball: FloatArray, barrel: float, size: float
) -> list[Solid]:
    """Return a leg's barrel, with an eye around the revolute axis, and its rod, which ends in the ball."""
    end = hip + barrel * (ball - hip) / np.linalg.norm(ball - hip)
    eye = 0.1 * size * axis
    colour = COLOURS[f"{stage} leg"]
    return [
        Solid(f"{name} eye", "leg", colour, _cylinder(hip - eye, hip + eye, 0.1 * size)),
        Solid(f"{name} barrel", "leg", colour, _cylinder(hip, end, 0.082 * size)),
        Solid(f"{name} rod", "leg", COLOURS[f"{stage} rod"], _cylinder(end, ball, 0.047 * size)),
    ]


def _triad(frame: str, placement: Placement, size: float) -> list[Solid]:
    rotation, origin = placement
    length = TRIAD * size
    solids = []
    for letter, direction in zip("xyz", rotation.T, strict=True):
        neck = origin + 0.72 * length * direction
        shaft = _cylinder(origin, neck, 0.02 * size)
        head = _cone(neck, origin + length * direction, 0.055 * size)
        solids.append(Solid(f"{frame} {letter}", "frame", COLOURS[f"{letter} axis"], shaft + head))
    return solids
