"""The solids of the description: coloured meshes, and their poses in a configuration.

Pictures, the viewer and, from the URDF, other engines show these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from spm_pin.description.robot import read_robot
from spm_pin.machine import Configuration, Machine
from spm_pin.machine.joint_angles import home_readings
from spm_pin.support.arguments import FloatArray
from spm_pin.support.pose import homogeneous


def platforms(machine: Machine) -> tuple[str, ...]:
    """Return the links with pivots or balls, from the base to the end link."""
    return ("base", "platform") if machine.is_stage else ("base", "middle_platform", "terminal_platform")


@dataclass(frozen=True, eq=False)
class VisualPart:
    """A closed surface of one colour, fixed to a body of a machine."""

    name: str  # its link in the URDF and its mesh: "base_a1 clevis", "leg_b1_rod tube"
    body: str  # the link it moves with, one of `bodies`
    colour: tuple[float, float, float]  # red, green and blue in sRGB, from 0 to 1
    vertices: FloatArray  # in the frame of the body [m], shape (n, 3); of an RPS leg as long as in the URDF at zero
    faces: npt.NDArray[np.int32]  # triangles, counter-clockwise seen from outside, shape (m, 3)

    @property
    def mesh(self) -> str:
        """Name of the mesh without its folder: ``"clevis"``."""
        return self.name.partition(" ")[2]


@lru_cache(maxsize=16)
def section_size(machine: Machine) -> float:
    """Return the length s to which radii and thicknesses of a machine are proportional [m]; see `inertials.yaml`."""
    sizes = [radius for radii in machine.stage_radii for radius in radii]
    for kind, home in zip(machine.legs.kinds, home_readings(machine)[::3], strict=True):
        # The shortest link; for an RPS leg the whole leg.
        sizes += [getattr(kind.nominal, name) for name in ("crank", "rod") if hasattr(kind, name)] or [home]
    return float(min(sizes))


def leg_links(machine: Machine) -> tuple[tuple[str, str], ...]:
    """Return the two links of each leg, in the order of the legs: the one after its first joint, and the rod."""
    names = enumerate(f"leg_{leg[2:]}" for leg in machine.legs.names)
    return tuple((f"{leg}_{machine.legs.kinds[k // 3].body}", f"{leg}_rod") for k, leg in names)


def bodies(machine: Machine) -> tuple[str, ...]:
    """Return the visible links that move relative to one another; all others are fixed to them."""
    return (*platforms(machine), *(link for half in zip(*leg_links(machine), strict=True) for link in half))


def _turns_at_pivot(machine: Machine) -> list[bool]:
    """Return whether the first link of each leg turns about its pivot; the frame of a carriage is at the knee."""
    return [kind.joints[0] == "hip" for kind in machine.legs.kinds for _ in range(3)]


@lru_cache(maxsize=16)
def visual_parts(machine: Machine) -> tuple[VisualPart, ...]:
    """Return the solids in the URDF of a machine, in the order of its links."""
    robot = read_robot(machine)
    home, links = robot.frames(), leg_links(machine)
    frames = dict(home)
    carriers = {robot.carrier(body)[0]: body for body in bodies(machine)}
    corners = [f"{corner}{i}" for corner in ("base_a", "terminal_c") for i in "123"]
    for (body, rod), corner, is_at_pivot in zip(links, corners, _turns_at_pivot(machine), strict=False):
        # If joints are reversed, the frames of links are at their other ends.
        for own, origin in ((body, corner if is_at_pivot else body), (rod, rod.replace("rod", "tip"))):
            frames[own] = homogeneous(home[own][:3, :3], home[origin][:3, 3])
    parts = []
    for name, link in robot.links.items():
        for shape in link.visuals:
            body = carriers[robot.carrier(name)[0]]
            vertices, faces = read_obj(Path(shape.mesh))
            pose = np.linalg.inv(frames[body]) @ home[name] @ shape.placement.matrix
            placed = (vertices * shape.size) @ pose[:3, :3].T + pose[:3, 3]
            placed.flags.writeable = False
            red, green, blue, _ = robot.materials[shape.material]
            parts.append(VisualPart(f"{name} {Path(shape.mesh).stem}", body, (red, green, blue), placed, faces))
    return tuple(parts)


@lru_cache(maxsize=32)
def read_obj(path: Path) -> tuple[FloatArray, npt.NDArray[np.int32]]:
    """Return the vertices (n, 3) and the triangles (m, 3) of an OBJ file of this description."""
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    vertices = np.array([line[1:] for line in lines if line[:1] == ["v"]], dtype=np.float64)
    faces = [[int(word.partition("/")[0]) - 1 for word in line[1:]] for line in lines if line[:1] == ["f"]]
    array = np.array(faces, dtype=np.int32)
    vertices.flags.writeable = array.flags.writeable = False
    return vertices, array


def part_placements(configuration: Configuration) -> FloatArray:
    """Return the poses of the solids of configurations (...), shape (..., n, 4, 4), in the order of `visual_parts`.

    The matrices map the vertices of a part to {B}. A state may violate the closure equations; missing ones are NaN.
    All are rigid, except for the tubes of RPS legs, barrels and rods, whose third column is longer or shorter than
    1: a rod is shown from inside its barrel to its ball for any length of the leg, and a barrel is shortened if the
    leg is too short for it.
    """
    machine = configuration.machine
    parts = visual_parts(machine)
    poses = _body_poses(configuration)
    placements = np.stack([poses[part.body] for part in parts], axis=-3)
    size, lengths = section_size(machine), np.linalg.norm(configuration.balls - configuration.leg_bases, axis=-1)
    for i, (cylinder, rod) in enumerate(leg_links(machine)):
        if not cylinder.endswith("cylinder"):
            continue
        length = lengths[..., i]
        index = {part.name: k for k, part in enumerate(parts) if part.body in (cylinder, rod)}
        barrel = np.ptp(parts[index[f"{cylinder} tube"]].vertices[:, 2])
        shown = np.minimum(barrel, np.maximum(length - 0.4 * size, 0.5 * length))
        seen = (length - 0.5 * shown) / np.ptp(parts[index[f"{rod} tube"]].vertices[:, 2])
        placements[..., index[f"{cylinder} tube"], :3, 2] *= (shown / barrel)[..., None]
        placements[..., index[f"{rod} tube"], :3, 2] *= seen[..., None]
        gland = placements[..., index[f"{cylinder} gland"], :, :]
        gland[..., :3, 3] += (shown - barrel)[..., None] * gland[..., :3, 2]
    return placements


def _body_poses(configuration: Configuration) -> dict[str, FloatArray]:
    """Return the pose (..., 4, 4) in {B} of each body: z along the link, the origin at pivot, knee or ball."""
    machine = configuration.machine
    base = np.broadcast_to(np.eye(4), (*configuration.shape, 4, 4))
    moved = homogeneous(configuration.rotation, configuration.translation)
    # The middle platform of a stage is its platform.
    poses = dict(zip(platforms(machine), (base, configuration.middle_pose.as_matrix(), moved), strict=False))
    pivots, knees, balls = configuration.leg_bases, configuration.circle_centres, configuration.balls
    rods = balls - knees
    first = rods.copy()
    for stage, kind in enumerate(machine.legs.kinds):
        legs = slice(3 * stage, 3 * stage + 3)
        if kind.body == "carriage":
            first[..., legs, :] = configuration.centre_rates[..., legs, :]
        elif kind.body == "crank":
            first[..., legs, :] = (knees - pivots)[..., legs, :]
    origins = np.where(np.array(_turns_at_pivot(machine))[:, None], pivots, knees)
    for half, (vectors, places) in enumerate(((first, origins), (rods, balls))):
        with np.errstate(invalid="ignore"):
            z = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
        y = np.cross(z, configuration.leg_axes)
        y /= np.linalg.norm(y, axis=-1, keepdims=True)
        turns = np.stack([np.cross(y, z), y, z], axis=-1)
        for i, links in enumerate(leg_links(machine)):
            poses[links[half]] = homogeneous(turns[..., i, :, :], places[..., i, :])
    return poses
