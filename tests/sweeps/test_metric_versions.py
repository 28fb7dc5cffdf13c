"""Versions of metrics: the values of one function are never taken for those of another."""

from __future__ import annotations

import dataclasses
import pickle
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pytest
import stores
from error_fields import with_fields

import spm_pin as spm
from spm_pin.sweeps import METRICS, Metric, Points, metric

FACTORS = {"factor": 1.0}


def from_a_global(points: Points) -> Any:
    return FACTORS["factor"] * points.coordinates[:, 0]


@pytest.mark.parametrize(
    ("own", "others"), [(None, {None: "metrics", 1: "store"}), (1, dict.fromkeys((2, "1", None, ""), "store"))]
)
def test_values_of_another_function_are_never_returned(
    own: int | None, others: dict[Any, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing tells two functions apart: only a stated version may continue a store, complete or not."""
    store = tmp_path / "map.zarr"

    def swept(version: int | str | None) -> Any:
        return stores.small(store, metrics=[Metric("mine", "m", "", from_a_global, version=version)]).mine.values

    first = swept(own)
    monkeypatch.setitem(FACTORS, "factor", 3.0)
    for is_complete in (True, False):
        if not is_complete:
            stores.records(store)[2].unlink()
        before = stores.contents(store)
        for version, argument in others.items():
            with pytest.raises(spm.ArgumentError, check=with_fields(argument=argument)):
                swept(version)
        assert stores.contents(store) == before
    if own:
        monkeypatch.setitem(FACTORS, "factor", 1.0)
        np.testing.assert_array_equal(swept(own), first)
        assert len(stores.records(store)) == 7


def test_a_changed_copy_of_a_package_metric_is_a_metric_of_ones_own(tmp_path: Path) -> None:
    payload = METRICS["payload"]
    assert payload.is_of_package
    assert payload(push=2.0).is_of_package
    for changes in ({"function": from_a_global}, {"dtype": "float32"}, {"name": "other"}):
        assert not dataclasses.replace(payload, **changes).is_of_package  # type: ignore[arg-type]
    store = tmp_path / "map.zarr"
    stores.small(store, metrics=[payload])
    with pytest.raises(spm.ArgumentError, match="is_of_package is true in the store and false in this sweep"):
        stores.small(store, metrics=[dataclasses.replace(payload, function=from_a_global)])


def test_metrics_keep_their_identity_on_the_way_to_workers() -> None:
    mine = Metric("mine", "m", "", from_a_global, parameters={"a": 1}, version=3)
    for made in (METRICS["conditioning"](length=0.3), METRICS["o_x"], mine):
        for again in (pickle.loads(pickle.dumps(made)), cloudpickle.loads(cloudpickle.dumps(made))):
            assert again.definition() == made.definition()
            assert again == made


@metric("m", "x of the point, shifted and scaled", version=1)
def shifted(points: Points, *, shift: float = 1.0, names: Any = ("a", "b")) -> Any:
    return points.coordinates[:, 0] + shift


def test_a_decorated_function_is_a_metric_with_parameters(tmp_path: Path) -> None:
    assert (shifted.name, shifted.unit, shifted.version) == ("shifted", "m", 1)
    assert dict(shifted.parameters) == {"shift": 1.0, "names": ["a", "b"]}
    other = shifted(shift=3.0)
    assert (other.parameters["shift"], other.version) == (3.0, 1)
    results = stores.small(tmp_path / "map.zarr", metrics=[other])
    np.testing.assert_array_equal(results.shifted, np.broadcast_to(results.x + 3.0, results.shifted.T.shape).T)
    assert results.shifted.attrs["shift"] == 3.0
    with pytest.raises(spm.ArgumentError, match=r"parameters.shift is 3.0 in the store and 1.0 in this sweep"):
        stores.small(tmp_path / "map.zarr", metrics=[shifted])
