"""The machine on the front page, solved in the reader's browser by the exported C, compiled to WebAssembly.

`python docs/site/live_page.py FILE` writes it as a page of its own, docs/live.html.

All of it stands in the page itself, so that it works from a disk as well, and nothing is fetched. It draws the solids
of the description, placed as `spm_pin.description.visuals.part_placements` places them.
"""

from __future__ import annotations

import base64
import json
import shutil
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

import spm_pin as spm
from spm_pin.description.visuals import bodies, read_obj, section_size, visual_parts
from spm_pin.display.rendering import AXIS_COLOURS, TRIAD

SITE = Path(__file__).parent
MACHINE = spm.Manipulator.paper()
BODIES = bodies(MACHINE)
FLAGS = "--target=wasm32 -std=c99 -O2 -ffp-contract=off -fno-math-errno -ffreestanding -nostdlib -mbulk-memory"
LINKED = "--no-entry --allow-undefined --strip-all --initial-memory=131072 --export=__heap_base"
EXPORTED = ("spm_machine", "spm_all_branches", "spm_inverse", "spm_forward")
VERTEX = np.dtype([("position", "<i2", 3), ("normal", "i1", 3), ("region", "u1")])


PAGE = """<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>
:root {{ color-scheme: light dark; }}
body {{
  font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 0 auto; padding: 1rem;
  --color-background-primary: #fff;
  --color-background-secondary: #f8f9fb; --color-background-border: #d5dae0; --color-foreground-primary: #16191d;
  --color-foreground-secondary: #4b535c; --color-foreground-muted: #59626b; --color-brand-primary: #00588f;
  --font-stack--monospace: ui-monospace, monospace;
}}
@media (prefers-color-scheme: dark) {{
  body {{
    --color-background-primary: #131416; --color-background-secondary: #1a1c1e; --color-background-border: #3a4148;
    --color-foreground-primary: #e6e8ea; --color-foreground-secondary: #b4bbc2; --color-foreground-muted: #a2a9b0;
    --color-brand-primary: #56b4e9; --color-brand-content: #56b4e9; --color-background-hover: #24282c;
    --color-code-background: #1a1c1e; --color-code-foreground: #e6e8ea;
  }}
}}
body {{ background: var(--color-background-primary); color: var(--color-foreground-primary); }}
h1 {{ font-size: 1.4rem; margin: 0 0 0.5rem; }}
.live:not([hidden]) ~ .needs {{ display: none; }}
</style>
<body>
<h1>{heading}</h1>
{machine}
<p class="needs">Nothing is shown here: the machine needs a browser with JavaScript, {needs}.</p>
<p>A page of <b>spm_pin</b>, closed-chain kinematics of this machine. All of it is in this file.</p>
</body>
</html>
"""
"""A page around a machine, in the colours that the site's theme gives it."""
WORDS = {
    "title": "3RPS-3SPR: all branches, live",
    "heading": "The 3RPS-3SPR manipulator: one pose, all its branches",
    "needs": "WebAssembly and WebGL 2",
}


def main(file: Path) -> None:
    """Write the machine as a page of its own."""
    write_page(file, WORDS, webassembly(), fragment)


def write_page(file: Path, words: dict[str, str], module: bytes | None, fragment: Callable[[bytes], str]) -> None:
    """Write a page around the HTML that a WebAssembly module is made part of."""
    if module is None:
        sys.exit("Needs clang with the target wasm32, and wasm-ld")
    file.write_text(PAGE.format(machine=fragment(module), **words), encoding="utf-8")
    print(f"{file}: {file.stat().st_size // 1024} kB")


def with_machine(page: str) -> str:
    """Return the front page with the machine before its picture, which shows where scripts are off.

    Where no compiler for WebAssembly is installed, the picture alone remains, and a line says so.
    """
    if (module := webassembly()) is None:
        print("The front page shows a picture only: needs clang with the target wasm32, and wasm-ld", file=sys.stderr)
        return page
    return page.replace("\n![", f"\n```{{raw}} html\n{fragment(module)}\n```\n\n![", 1)


def fragment(module: bytes) -> str:
    """Return the HTML of the machine, all that it needs within."""
    meshes, ranges = _meshes()
    data = {
        "module": packed(module),
        "meshes": packed(meshes),
        "parts": _parts(ranges),
        "bodies": BODIES,
        "axes": np.vstack([MACHINE.revolute_axes, MACHINE.revolute_axes]).tolist(),
        "hips": np.vstack([MACHINE.base_joints, MACHINE.platform_joints]).tolist(),
        "size": section_size(MACHINE),
        "triad": TRIAD * section_size(MACHINE),
        "limits": [MACHINE.limits.minimum, MACHINE.limits.maximum] if MACHINE.limits else None,
    }
    return assembled(SITE / "live", data)


def assembled(folder: Path, data: dict[str, object]) -> str:
    """Return the HTML of a folder with its style, its script and the data for it within."""
    texts = {path.suffix[1:]: path.read_text(encoding="utf-8") for path in folder.iterdir()}
    parts = {"CSS": texts["css"], "JS": texts["js"], "DATA": json.dumps(data, separators=(",", ":"))}
    page = texts["html"]
    for name, text in parts.items():
        page = page.replace(f"@{name}@", text.strip())
    return page


def webassembly() -> bytes | None:
    """Return the exported C of the paper's machine as a WebAssembly module, None where it cannot be compiled."""
    with TemporaryDirectory() as folder:
        spm.export.write_c(MACHINE, folder)
        return compiled(Path(folder, "spm_kinematics.c"), EXPORTED)


def compiled(source: Path, exported: tuple[str, ...]) -> bytes | None:
    """Return a C file, whose headers are beside it, as a WebAssembly module; None where it cannot be compiled."""
    compiler = shutil.which("clang")
    if compiler is None or shutil.which("wasm-ld") is None:
        return None
    targets = subprocess.run([compiler, "--print-targets"], capture_output=True, text=True, check=True).stdout
    if "wasm32" not in targets:
        return None
    options = [*LINKED.split(), *(f"--export={name}" for name in exported)]
    output = source.with_suffix(".wasm")
    command = [compiler, *FLAGS.split(), f"-I{SITE / 'live'}", *(f"-Wl,{option}" for option in options)]
    subprocess.run([*command, str(source), "-o", str(output)], check=True)
    return output.read_bytes()


def packed(data: bytes) -> str:
    """Return bytes as text of a page."""
    return base64.b64encode(zlib.compress(data, 9)).decode()


def _meshes() -> tuple[bytes, dict[str, tuple[float, int, int]]]:
    """Return vertices and triangles of all meshes, and of each its scale, first index and number of indices."""
    vertices: list[bytes] = []
    faces: list[npt.NDArray[np.uint16]] = []
    ranges = {}
    count = first = 0
    for name in sorted({part.mesh for part in visual_parts(MACHINE)}):
        points, normals, corners = _corners(name)
        pairs, triangles = np.unique(corners, axis=0, return_inverse=True)
        triangles = triangles.reshape(-1, 3)
        # Triangles that share corners and their normals are one smooth region; between regions an edge is drawn.
        sides = triangles[:, [0, 1, 1, 2]].reshape(-1, 2).T
        scale = float(np.abs(points).max())
        rows = np.empty(len(pairs), VERTEX)
        rows["position"] = np.round(32767.0 / scale * points[pairs[:, 0]])
        rows["normal"] = np.round(127.0 * normals[pairs[:, 1]])
        rows["region"] = connected_components(coo_array((np.ones(sides.shape[1]), sides), shape=(len(pairs),) * 2))[1]
        vertices.append(rows.tobytes())
        faces.append((triangles + count).astype(np.uint16).ravel())
        ranges[name] = scale, first, triangles.size
        count, first = count + len(pairs), first + triangles.size
    indices = np.concatenate(faces).astype("<u2").tobytes()
    return np.uint32([count]).astype("<u4").tobytes() + b"".join(vertices) + indices, ranges


def _parts(ranges: dict[str, tuple[float, int, int]]) -> list[list[object]]:
    """Return of each solid its body, mesh, range of indices, colour and 3 x 4 matrix from the mesh to the body."""
    parts: list[list[object]] = []

    def add(body: str, mesh: str, colour: tuple[float, float, float], matrix: npt.NDArray[np.float64]) -> None:
        scale, first, count = ranges[mesh]
        numbers = (matrix * [scale, scale, scale, 1.0]).T.ravel().round(5) + 0.0  # -0.0 becomes 0.0
        parts.append([BODIES.index(body), mesh, first, count, *(round(float(x), 5) for x in (*colour, *numbers))])

    for part in visual_parts(MACHINE):
        points, _ = mesh(part.mesh)
        found = np.linalg.lstsq(np.column_stack([points, np.ones(len(points))]), part.vertices, rcond=None)
        add(part.body, part.mesh, part.colour, found[0].T)
    length = TRIAD * section_size(MACHINE)
    for body in ("base", "terminal_platform"):
        for k, colour in enumerate(AXIS_COLOURS.values()):
            turned = np.roll(np.eye(3), k + 1, axis=0) * length * np.array([0.04, 0.04, 1.0])
            add(body, "tube", colour, np.column_stack([turned, np.zeros(3)]))
    return parts


def mesh(name: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
    """Return the vertices (n, 3) of a mesh of the description and its triangles (m, 3)."""
    return read_obj(_file(name))


def _corners(name: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.int64]]:
    """Return the vertices and the normals of a mesh, and which of each a corner of a triangle has (3 m, 2)."""
    lines = [line.split() for line in _file(name).read_text(encoding="utf-8").splitlines()]
    normals = np.array([line[1:] for line in lines if line[:1] == ["vn"]], float)
    corners = [word.split("//") for line in lines if line[:1] == ["f"] for word in line[1:]]
    return mesh(name)[0], normals, np.array(corners, int) - 1


def _file(mesh: str) -> Path:
    return SITE.parents[1] / f"urdf/meshes/{mesh}.obj"


if __name__ == "__main__":
    main(Path(sys.argv[1]))
