"""JAX with double precision, for one test, and compiled without optimisation, which takes longer than it saves here."""

from __future__ import annotations

import os
from collections.abc import Iterator

os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")  # before JAX is imported

import jax
import pytest


@pytest.fixture
def double_precision() -> Iterator[None]:
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", before)
