"""Pictures of wrench polytopes, at the platform and in the viewer, and of fronts of designs."""

from __future__ import annotations

from unittest.mock import MagicMock

import numpy as np
import pytest

import spm_pin as spm
from spm_pin.capability import wrench_polytope
from spm_pin.design import DesignProblem, Designs, Front
from spm_pin.display import draw_capability, front_figure
from spm_pin.display.rendering import camera_axes
from spm_pin.mechanism.notebook import VIEW

PAPER = spm.Geometry.paper()
STATE = spm.forward_physical(PAPER, [1.20, 1.20, 1.40, 1.25, 1.20, 1.40])


def test_the_section_is_drawn_at_o_in_its_scale() -> None:
    section = wrench_polytope(STATE, 1000.0).section("linear")
    ax = draw_capability(STATE, section, scale=5e-4, dpi=100.0)
    robot, shape = ax.images
    points = (STATE.translation + 5e-4 * section.vertices) @ camera_axes(VIEW)[:2].T
    (left, right, bottom, top), pixel = shape.get_extent(), 0.02
    np.testing.assert_allclose([left, bottom], points.min(axis=0), atol=pixel)
    np.testing.assert_allclose([right, top], points.max(axis=0), atol=pixel)
    assert ax.get_ylim()[1] > top
    assert ax.get_ylim()[0] < robot.get_extent()[2]
    with pytest.raises(spm.ArgumentError, match="section"):
        draw_capability(STATE, section.vertices)  # type: ignore[arg-type]


def test_the_viewer_shows_what_legs_of_equal_strength_hold() -> None:
    pytest.importorskip("viser")
    from spm_pin.display.viewer.robot_scene import RobotScene

    robot = RobotScene(scene := MagicMock(), PAPER, MagicMock())
    robot._show_held_forces(STATE)
    assert not [call for call in scene.add_mesh_simple.call_args_list if call.args[0] == "/forces"]
    robot.layers["forces"] = True
    robot._show_held_forces(STATE)
    name, points, faces = scene.add_mesh_simple.call_args.args
    assert name == "/forces"
    forces = (np.asarray(points, float) - STATE.translation) / robot.size
    held = wrench_polytope(STATE, 1.0)
    assert held.contains(np.pad(0.9999 * forces, ((0, 0), (0, 3)))).all()
    assert not held.contains(np.pad(1.001 * forces, ((0, 0), (0, 3)))).any()
    assert faces.max() == len(points) - 1
    # Gone where the layer is switched off, and where the legs do not hold the platform.
    robot.layers["forces"] = False
    robot._show_held_forces(STATE)
    scene.remove_by_name.assert_called_once_with("/forces")


def test_a_front_shows_its_machines_and_the_one_that_it_began_with() -> None:
    columns = {"volume": np.array([1.0, 2.0, 3.0]), "footprint": np.array([1.0, 1.5, 2.5])}
    three = Designs((PAPER,) * 3, columns)
    one = Designs((PAPER,), {name: column[:1] + 0.4 for name, column in columns.items()})
    problem = DesignProblem(PAPER, {"stroke": (0.1, 0.3)}, {"volume": "max", "footprint": "min"})
    (ax,) = front_figure(Front(problem, three, three, one)).axes
    evaluated, front, start = ax.collections
    np.testing.assert_array_equal(evaluated.get_offsets(), np.stack([*columns.values()], axis=-1))
    np.testing.assert_array_equal(front.get_offsets(), evaluated.get_offsets())
    np.testing.assert_array_equal(start.get_offsets(), [[1.4, 1.4]])
    assert ax.get_xlabel() == "volume [m³\u00a0rad³], max"
    assert ax.get_ylabel() == "footprint [m²], min"
