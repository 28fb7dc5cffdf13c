"""The store that an undisturbed run of the small sweep leaves."""

from __future__ import annotations

from pathlib import Path

import pytest
import stores


@pytest.fixture(scope="session")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("undisturbed") / "map.zarr"
    stores.small(path)
    return path
