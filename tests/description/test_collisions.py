"""Colliding shapes of the MJCF: those of the URDF, those that MJX knows, or none."""

from __future__ import annotations

import warnings
from functools import cache
from typing import Any

import numpy as np
import pytest

from spm_pin.description import mjcf_text

mujoco = pytest.importorskip("mujoco")


@cache
def model(collisions: str) -> Any:
    return mujoco.MjModel.from_xml_string(mjcf_text(collisions=collisions))


def colliding(found: Any) -> np.ndarray:
    return np.flatnonzero(found.geom_contype > 0)


def test_without_collisions_no_shape_collides_and_the_masses_stay() -> None:
    none, exact = model("none"), model("exact")
    assert not len(colliding(none))
    assert len(colliding(exact)) > 20
    np.testing.assert_array_equal(none.body_mass, exact.body_mass)
    assert mjcf_text(collisions="exact") == mjcf_text()


def test_simple_shapes_are_no_cylinders_and_lie_inside_the_exact_ones() -> None:
    exact, simple = model("exact"), model("simple")
    shapes, kinds = colliding(exact), mujoco.mjtGeom
    assert (shapes == colliding(simple)).all()
    assert not (simple.geom_type[shapes] == kinds.mjGEOM_CYLINDER).any()
    cylinders = shapes[exact.geom_type[shapes] == kinds.mjGEOM_CYLINDER]
    assert len(cylinders) > 10
    for k in cylinders:
        radius, half = exact.geom_size[k, :2]
        x, y, z = simple.geom_size[k]
        if simple.geom_type[k] == kinds.mjGEOM_CAPSULE:
            assert x == radius
            assert x + y == pytest.approx(half)
        else:
            assert simple.geom_type[k] == kinds.mjGEOM_BOX
            assert np.hypot(x, y) == pytest.approx(radius)
            assert z == pytest.approx(half)
    np.testing.assert_array_equal(simple.geom_pos, exact.geom_pos)


@pytest.mark.parametrize("collisions", ["simple", "none"])
def test_mjx_takes_it(collisions: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its optional back ends
        mjx = pytest.importorskip("mujoco.mjx")
        taken = mjx.put_model(model(collisions))
    assert taken.neq == 4
