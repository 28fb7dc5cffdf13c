"""PyTorch: the kernels' values, J_f and parameters' derivatives; where PyTorch is installed."""

from __future__ import annotations

from typing import Any

import jax
import numpy as np
import pytest
import torch
from arrays.array_problems import BUILT, LEVEL, NOWHERE, PAPER, random_poses, random_readings

from spm_pin import arrays


def tensor(values: Any) -> Any:
    return torch.tensor(np.array(values, dtype=float))


def test_values_are_those_on_numpy_arrays() -> None:
    readings, poses = random_readings(500), random_poses(500)
    pose = poses.rotation.as_matrix(), poses.translation
    for machine in (PAPER, BUILT):
        found, expected = arrays.forward_physical(machine, tensor(readings)), arrays.forward_physical(machine, readings)
        check(found, expected)
        check(arrays.inverse_physical(machine, *map(tensor, pose)), arrays.inverse_physical(machine, *pose))
        for function in (arrays.joint_values, arrays.inverse_jacobian, arrays.singularity_distance):
            check([function(machine, found)[found.exists]], [function(machine, expected)[expected.exists]])
    check(arrays.inverse_displacement(PAPER, *map(tensor, pose)), arrays.inverse_displacement(PAPER, *pose))
    assert arrays.forward_physical(PAPER, tensor(readings).float()).rotation.dtype == torch.float32


def check(found: Any, expected: Any) -> None:
    for x, y in zip(found, expected, strict=True):
        assert isinstance(x, torch.Tensor)
        np.testing.assert_allclose(x.numpy(), y, rtol=1e-9, atol=1e-9)


@pytest.mark.usefixtures("double_precision")
def test_derivatives_are_those_of_jax_and_finite_everywhere() -> None:
    readings, parameters = np.concatenate([random_readings(6), NOWHERE, LEVEL]), BUILT.parameters
    derivatives = jax.jit(jax.vmap(jax.jacrev(_place(jax.numpy), argnums=(0, 1)), (None, 0)))
    expected = derivatives(jax.numpy.asarray(parameters), jax.numpy.asarray(readings))
    for k, row in enumerate(readings):
        found = torch.autograd.functional.jacobian(_place(torch), (tensor(parameters), tensor(row)))
        for x, y in zip(found, expected, strict=True):
            assert torch.isfinite(x).all()
            np.testing.assert_allclose(x.numpy(), y[k], rtol=1e-9, atol=1e-9 * max(1.0, np.abs(y[k]).max()))


def _place(library: Any) -> Any:
    def place(parameters: Any, readings: Any) -> Any:
        state = arrays.forward_physical(parameters, readings)
        return library.concatenate([state.rotation.reshape(9), state.translation])

    return place
