"""Write the meshes of the description, `urdf/meshes/*.obj`: `python scripts/generate_meshes.py`, in a checkout.

Each mesh is one part in lengths without unit. The xacro sources scale it: a plate by the radius of its platform and
by the machine's size s in thickness, a tube by its radius and its length, all others by s. So one set of meshes serves
machines of all dimensions. A test checks that the files kept there are what this script writes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial import ConvexHull

SECTIONS = 32  # of a circle
SMOOTH = np.cos(np.radians(40.0))  # faces that meet at a smaller angle are shaded as one surface

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices (n, 3) and triangles (m, 3) of one or several closed surfaces, seen counter-clockwise from outside."""


def merged(*meshes: Mesh) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.vstack([vertices for vertices, _ in meshes]), np.vstack(faces)


def moved(mesh: Mesh, offset: Sequence[float]) -> Mesh:
    """Return a mesh moved by an offset (3,)."""
    return mesh[0] + np.asarray(offset), mesh[1]


def about_x(mesh: Mesh) -> Mesh:
    """Return a mesh turned so that its z axis becomes x."""
    return mesh[0][:, [2, 0, 1]], mesh[1]


def loft(loops: Sequence[np.ndarray], *, closed: bool = False, tips: tuple[float, float] = (0.0, 0.0)) -> Mesh:
    """Return the surface through loops (n, 3) of as many points, counter-clockwise and upwards outside.

    The first and the last loop are joined if `closed`; otherwise each is filled from its centre, raised by `tips`.
    """
    n, count = len(loops[0]), len(loops)
    here = np.arange(n)
    there = np.roll(here, -1)
    strips = []
    for k in range(count if closed else count - 1):
        low, high = k * n, (k + 1) % count * n
        strips += [np.stack([low + here, low + there, high + there], axis=-1)]
        strips += [np.stack([low + here, high + there, high + here], axis=-1)]
    vertices = np.vstack(loops)
    if not closed:
        centres = [
            loop.mean(axis=0) + np.array([0.0, 0.0, tip]) for loop, tip in zip((loops[0], loops[-1]), tips, strict=True)
        ]
        vertices = np.vstack([vertices, *centres])
        last = (count - 1) * n
        strips += [np.stack([there, here, np.full(n, len(vertices) - 2)], axis=-1)]
        strips += [np.stack([last + here, last + there, np.full(n, len(vertices) - 1)], axis=-1)]
    return vertices, np.vstack(strips)


def circle(radius: float, z: float, sections: int = SECTIONS) -> np.ndarray:
    """Return a circle about the z axis."""
    angles = np.linspace(0.0, 2.0 * np.pi, sections, endpoint=False)
    return np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(sections, z)], axis=-1)


def turned(profile: Sequence[tuple[float, float]], *, ring: bool = False, sections: int = SECTIONS) -> Mesh:
    """Return the solid of revolution about z of a profile of radii and heights, upwards outside; a ring is closed."""
    return loft([circle(radius, z, sections) for radius, z in profile], closed=ring)


def extruded(outline: np.ndarray, low: float, high: float) -> Mesh:
    """Return the prism along z over an outline (n, 2) that is seen whole from its centre."""
    loops = [np.column_stack([outline, np.full(len(outline), z)]) for z in (low, high)]
    return loft(loops)


def plate(outline: np.ndarray, window: np.ndarray, low: float, high: float) -> Mesh:
    """Return a plate with a window of as many points as its outline, (n, 2), its edges chamfered."""
    bevel = 0.14 * (high - low)
    levels = [(0.985, low), (1.0, low + bevel), (1.0, high - bevel), (0.985, high)]
    outer = [np.column_stack([outline * factor, np.full(len(outline), z)]) for factor, z in levels]
    inner = [np.column_stack([window, np.full(len(window), z)]) for z in (high, low)]
    return loft(outer + inner, closed=True)


def lobes(reach: float, corner: float, waist: float) -> np.ndarray:
    """Return a triangle's outline (n, 2) with round corners about the radius `reach` towards the three legs.

    Its sides are arcs whose nearest point is at the radius `waist`; they leave the corners without a kink.
    """
    # The arc's centre is opposite to a corner, at the radius x, its radius x - waist, and it touches the corner:
    # |centre - corner's centre| = x - waist + corner.
    a = corner - waist
    x = (reach**2 - a**2) / (2.0 * a + reach)
    # Half the angle of a corner's arc: the direction in which the side's centre is seen from the corner's.
    side = np.arctan2(x * np.sin(np.pi / 3.0), x * np.cos(np.pi / 3.0) - reach)
    points = []
    for azimuth in np.deg2rad([-30.0, 90.0, 210.0]):
        around = azimuth + np.linspace(-side, side, 19)
        centre = reach * np.array([np.cos(azimuth), np.sin(azimuth)])
        points.append(centre + corner * np.stack([np.cos(around), np.sin(around)], axis=-1))
        middle = azimuth + np.pi / 3.0
        half = side - np.pi / 3.0
        around = middle + np.pi + np.linspace(half, -half, 13)[1:-1]
        centre = x * np.array([np.cos(middle), np.sin(middle)])
        points.append(centre + (x - waist) * np.stack([np.cos(around), np.sin(around)], axis=-1))
    return np.vstack(points)


def window(outline: np.ndarray, radius: float) -> np.ndarray:
    """Return the points of a circle in the directions of an outline's points."""
    return radius * outline / np.linalg.norm(outline, axis=-1, keepdims=True)


def cheek(foot: float, height: float, radius: float) -> np.ndarray:
    """Return the outline (n, 2) of a clevis's cheek: round about the origin, on a foot `height` below it."""
    arc = circle(radius, 0.0, 48)[:, :2]
    corners = np.array([[-foot, -height], [foot, -height]])
    points = np.vstack([arc, corners])
    return points[ConvexHull(points).vertices]


def clevis() -> Mesh:
    """Return the bearing of a revolute joint about x: a foot and two cheeks with a boss, to the height -0.12."""
    side = about_x(extruded(cheek(0.13, 0.12, 0.092), -0.03, 0.03))
    boss = about_x(turned([(0.066, -0.02), (0.066, 0.012), (0.058, 0.02)], sections=24))
    foot = np.array([[-0.235, -0.15], [0.235, -0.15], [0.235, 0.15], [-0.235, 0.15]])
    foot = np.vstack([0.9 * foot * [1.0, 1.0 / 0.9], 0.9 * foot * [1.0 / 0.9, 1.0]])
    foot = foot[ConvexHull(foot).vertices]
    parts = [extruded(foot, -0.12, -0.088)]
    for sign in (-1.0, 1.0):
        turn = boss if sign > 0.0 else (boss[0] * [-1.0, 1.0, 1.0], boss[1][:, ::-1])
        parts += [moved(side, [sign * 0.17, 0.0, 0.0]), moved(turn, [sign * 0.22, 0.0, 0.0])]
    return merged(*parts)


def pin() -> Mesh:
    """Return the pin of a revolute joint about x, a hexagonal head on either side."""
    shaft = turned([(0.044, -0.25), (0.044, 0.25)], sections=24)
    heads = [turned([(0.048, z - 0.018), (0.048, z + 0.018)], sections=6) for z in (-0.256, 0.256)]
    return about_x(merged(shaft, *heads))


def box(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Mesh:
    """Return the box between these coordinates."""
    return extruded(np.array([[x[0], y[0]], [x[1], y[0]], [x[1], y[1]], [x[0], y[1]]]), *z)


def servo() -> Mesh:
    """Return the motor beside the cheeks of a clevis, its shaft along x."""
    case, flange = box((0.24, 0.52), (-0.15, 0.15), (-0.12, 0.2)), box((0.3, 0.34), (-0.22, 0.22), (-0.12, 0.2))
    return merged(case, flange, about_x(turned([(0.1, 0.18), (0.1, 0.24)], sections=24)))


def carriage() -> Mesh:
    """Return the block that runs on a rail, with two cheeks for the knee about x."""
    cheeks = [box(ends, (-0.09, 0.05), (-0.1, 0.1)) for ends in ((-0.16, -0.095), (0.095, 0.16))]
    return merged(box((-0.17, 0.17), (0.05, 0.18), (-0.2, 0.2)), *cheeks)


def meshes() -> dict[str, Mesh]:
    """Return the meshes by the names of their files."""
    base = lobes(0.96, 0.25, 0.44)
    middle = lobes(1.0, 0.185, 0.42)
    terminal = lobes(0.93, 0.21, 0.44)
    ring = [(0.30, 0.0), (0.30, 1.35), (0.27, 1.5), (0.20, 1.5), (0.20, 0.0)]
    sphere = [circle(1.25 * np.sin(t), -1.25 * np.cos(t), 24) for t in np.linspace(0.0, np.pi, 15)[1:-1]]
    tip = 1.25 * (1.0 - np.cos(np.pi / 14.0))
    return {
        "base_plate": plate(base, window(base, 0.30), -1.0, 0.0),
        "middle_plate": plate(middle, window(middle, 0.26), -0.35, 0.35),
        "terminal_plate": merged(plate(terminal, window(terminal, 0.25), 0.0, 1.0), turned(ring, ring=True)),
        "clevis": clevis(),
        "pin": pin(),
        "servo": servo(),
        "carriage": carriage(),
        # From z = 0 to 1, behind the carriage.
        "rail": merged(box((-0.08, 0.08), (0.1, 0.2), (0.0, 1.0)), box((-0.14, 0.14), (0.2, 0.25), (0.0, 1.0))),
        # Of a leg: z runs from the hip to the ball.
        "eye": merged(
            about_x(turned([(0.09, -0.13), (0.1, -0.12), (0.1, 0.12), (0.09, 0.13)])),
            turned([(0.085, 0.06), (0.112, 0.12), (0.112, 0.2), (0.098, 0.225)]),
        ),
        "tube": turned([(1.0, 0.0), (1.0, 1.0)]),
        "gland": turned(
            [
                *[(0.096, -0.16), (0.106, -0.145), (0.106, -0.03), (0.098, -0.015)],
                *[(0.075, 0.0), (0.075, 0.045), (0.068, 0.055)],
            ]
        ),
        "rod_end": turned([(0.058, -0.3), (0.072, -0.285), (0.072, -0.19), (0.045, -0.15), (0.045, -0.05)]),
        "ball": loft(sphere, tips=(-tip, tip)),
        "socket": turned(
            [
                *[(0.18, -0.07), (0.19, -0.06), (0.19, 0.06), (0.18, 0.07)],
                *[(0.1, 0.07), (0.09, 0.06), (0.09, -0.06), (0.1, -0.07)],
            ],
            ring=True,
        ),
    }


def corner_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Return the unit normals (m, 3, 3) at the corners of the triangles, smooth where no edge is sharp."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    areas = np.cross(b - a, c - a)
    units = areas / np.linalg.norm(areas, axis=-1, keepdims=True)
    around: dict[int, list[int]] = {}
    for k, face in enumerate(faces.tolist()):
        for vertex in face:
            around.setdefault(vertex, []).append(k)
    normals = np.empty((len(faces), 3, 3))
    for k, face in enumerate(faces.tolist()):
        for corner, vertex in enumerate(face):
            near = [j for j in around[vertex] if units[j] @ units[k] > SMOOTH]
            normals[k, corner] = areas[near].sum(axis=0)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def obj_text(name: str, mesh: Mesh) -> str:
    """Return a mesh as an OBJ file."""
    vertices, faces = mesh
    normals = np.round(corner_normals(vertices, faces), 3).reshape(-1, 3) + 0.0
    normals, indices = np.unique(normals, axis=0, return_inverse=True)
    indices = indices.reshape(faces.shape)
    lines = [f"# Written by generate_meshes.py, which is the place for changes.\no {name}"]
    lines += ["v {:.5g} {:.5g} {:.5g}".format(*(np.round(vertex, 5) + 0.0)) for vertex in vertices]
    lines += ["vn {:.3g} {:.3g} {:.3g}".format(*normal) for normal in normals]
    corners = np.stack([faces, indices], axis=-1) + 1
    lines += ["f " + " ".join(f"{vertex}//{normal}" for vertex, normal in face) for face in corners]
    return "\n".join(lines) + "\n"


def generate() -> dict[str, str]:
    """Return the content of each mesh file."""
    return {f"meshes/{name}.obj": obj_text(name, mesh) for name, mesh in meshes().items()}


if __name__ == "__main__":
    folder = Path(__file__).resolve().parents[1] / "urdf"
    (folder / "meshes").mkdir(exist_ok=True)
    for file, content in generate().items():
        (folder / file).write_text(content, encoding="utf-8", newline="\n")
