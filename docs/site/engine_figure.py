"""Draw one state in MuJoCo beside `spm-pin draw`: `python docs/site/engine_figure.py`, without a screen by OSMesa.

Needs `pip install ".[plots,engines]"` and Debian's libosmesa6, or a graphics card and another `MUJOCO_GL`.
"""

from __future__ import annotations

import os

os.environ.setdefault("MUJOCO_GL", "osmesa")  # read when MuJoCo is imported

import mujoco
import numpy as np
import numpy.typing as npt
from figures import save
from matplotlib.figure import Figure

import spm_pin as spm
from spm_pin.description import MJCF_PATH
from spm_pin.display import draw

AZIMUTH, ELEVATION = 40.0, 15.0
"""View of both pictures, in degrees."""


def main() -> None:
    """Draw the figure into docs/images."""
    figure = Figure(figsize=(8.5, 5.4))
    left, right = figure.add_axes((0.0, 0.0, 0.5, 0.93)), figure.add_axes((0.5, 0.0, 0.5, 0.93))
    model = mujoco.MjModel.from_xml_path(str(MJCF_PATH))
    key = model.key("reference").id
    draw(state_of_keyframe(model, key), ax=left, view=(np.deg2rad(AZIMUTH), np.deg2rad(ELEVATION)), labels=False)
    left.set_axis_off()
    right.imshow(rendering(model, key))
    right.set_axis_off()
    for ax, title in ((left, "spm-pin draw"), (right, "MuJoCo, spm.xml")):
        ax.set_title(title, fontsize=11)
    save(figure, "engines")


def state_of_keyframe(model: mujoco.MjModel, key: int) -> spm.Configuration:
    """Return the configuration of a keyframe; MuJoCo's q is that of the closed chain."""
    return spm.ClosedChain.from_urdf().state(model.key_qpos[key]).configuration()


def rendering(model: mujoco.MjModel, key: int) -> npt.NDArray[np.uint8]:
    """Return MuJoCo's picture of a keyframe, its black background white."""
    height, width = 1100, 860
    model.vis.global_.offheight, model.vis.global_.offwidth = height, width
    model.vis.global_.orthographic, model.vis.global_.fovy = 1, 2.65  # of the free camera; [m] from top to bottom
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, key)
    mujoco.mj_forward(model, data)
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.azimuth, camera.elevation = AZIMUTH + 180.0, -ELEVATION
    camera.lookat[:], camera.distance = (0.35, 0.22, 1.2), 5.0
    with mujoco.Renderer(model, height, width) as renderer:
        renderer.update_scene(data, camera)
        picture = renderer.render().copy()
    picture[(picture == 0).all(axis=-1)] = 255
    return picture


if __name__ == "__main__":
    main()
