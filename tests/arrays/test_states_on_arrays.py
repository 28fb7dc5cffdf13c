"""Joint values, Jacobians, forces and singular values on arrays: finite, with finite gradients, everywhere."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from arrays.array_problems import BUILT, LEVEL, NOWHERE, PAPER

from spm_pin import arrays
from spm_pin.description import JOINTS

FUNCTIONS: dict[str, Any] = {
    "joint_values": arrays.joint_values,
    "inverse_jacobian": arrays.inverse_jacobian,
    "leg_forces": lambda machine, state: arrays.leg_forces(machine, state, state.readings),
    "singularity_distance": arrays.singularity_distance,
}
MANIPULATORS = {
    "drawn": PAPER,
    "as built": BUILT,
    "dimensions": np.array(PAPER.dimensions),
    "parameters": BUILT.parameters,
    "drawn parameters": PAPER.parameters,
}


def absent_and_level(machine: Any) -> list[arrays.State]:
    """Return states of readings and of poses; some do not exist, and two stand level."""
    readings = np.array([*NOWHERE, [2.1, 1.6, 0.416, 1.57, 0.8, 0.57], *LEVEL, [1.25, 1.15, 1.40, 1.30, 1.20, 1.40]])
    forward = arrays.forward_physical(machine, readings)
    assert forward.exists.tolist() == [False] * 4 + [True] * 3
    rotation = np.concatenate([forward.rotation[-3:], np.broadcast_to(np.eye(3), (4, 3, 3))])
    translation = np.concatenate(
        [forward.translation[-3:], [[3.0, 2.0, 9.0], [0.0, 0.0, 0.0], [1.0, 0.0, 2.0], [0.0, 0.0, 1.0]]]
    )
    inverse = arrays.inverse_physical(machine, rotation, translation)
    assert inverse.exists[2]
    assert not inverse.exists.all()
    return [forward, inverse]


@pytest.mark.parametrize("kind", MANIPULATORS)
def test_all_is_finite_where_nothing_exists_and_at_level_states(kind: str) -> None:
    assert arrays.JOINTS == JOINTS
    for state in absent_and_level(MANIPULATORS[kind]):
        for function in FUNCTIONS.values():
            assert np.isfinite(function(MANIPULATORS[kind], state)).all()


QUICK = [("parameters", "singularity_distance")]
SLOW = [
    ("dimensions", "leg_forces"),
    ("dimensions", "inverse_jacobian"),
    ("parameters", "inverse_jacobian"),
    ("parameters", "leg_forces"),
    ("parameters", "joint_values"),
]


@pytest.mark.parametrize(("kind", "name"), [*QUICK, *(pytest.param(*x, marks=pytest.mark.slow) for x in SLOW)])
@pytest.mark.usefixtures("double_precision")
def test_what_does_not_exist_leaves_a_masked_gradient_finite(kind: str, name: str) -> None:
    machine = MANIPULATORS[kind]
    *fields, exists = map(jnp.concatenate, zip(*absent_and_level(machine), strict=True))

    def cost(fields: Any, machine: Any) -> Any:
        values = FUNCTIONS[name](machine, arrays.State(*fields, exists))
        return jnp.where(exists, values.reshape(len(values), -1).sum(axis=-1), 0.0).sum()

    slopes = jax.grad(cost, argnums=(0, 1))(tuple(fields), jnp.asarray(machine))
    assert all(jnp.isfinite(x).all() for x in jax.tree.leaves(slopes))
