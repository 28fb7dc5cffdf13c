"""Sweeps in one process: values, names, resumption, refusals, and disks that fail."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import shutil
import tracemalloc
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
import zarr
from error_fields import with_fields
from stores import MACHINE, METRICS, contents, records, small, times

import spm_pin as spm
from spm_pin.sweeps import (
    Metric,
    Points,
    StoreError,
    StoreLockedError,
    SweepError,
    leg_grid,
    leg_sample,
    pose_grid,
    pose_sample,
    resume_sweep,
    run_sweep,
    sweep_status,
)
from spm_pin.sweeps.domains import SweepPlan
from spm_pin.sweeps.store import locked

payload = spm.sweeps.METRICS["payload"]


@pytest.fixture
def store(undisturbed: Path, tmp_path: Path) -> Path:
    """A copy of a complete store."""
    return Path(shutil.copytree(undisturbed, tmp_path / "map.zarr"))


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, ...]]:
    """The chunks that are computed during a test."""
    done: list[tuple[int, ...]] = []
    evaluate = SweepPlan.evaluate

    def counted(self: SweepPlan, index: tuple[int, ...]) -> dict[str, Any]:
        done.append(index)
        return evaluate(self, index)

    monkeypatch.setattr(SweepPlan, "evaluate", counted)
    return done


# What comes out


def test_values_are_those_of_direct_calls(undisturbed: Path) -> None:
    found = xarray.open_zarr(undisturbed).load()
    x, y, z, beta = np.meshgrid(found.x, found.y, found.z, found.beta, indexing="ij")
    angles = np.stack([np.full_like(beta, 0.01), beta, np.full_like(beta, 0.1)], axis=-1)
    solutions = spm.inverse_displacement(MACHINE, spm.pose(np.stack([x, y, z], axis=-1), xyx=angles))
    np.testing.assert_array_equal(found.status, solutions.status)
    np.testing.assert_array_equal(found.branches, solutions.count)
    machine = solutions.within().physical()
    np.testing.assert_array_equal(found.reachable, machine.exists)
    assert 0.1 < float(found.reachable.mean()) < 0.9
    reached = machine[machine.exists]
    scaled = spm.inverse_jacobian(reached) / np.repeat([1.0, MACHINE.platform_radius], 3)
    np.testing.assert_allclose(found.conditioning.values[machine.exists], 1 / np.linalg.cond(scaled), rtol=1e-8)
    assert found.conditioning.isnull().values[~machine.exists].all()


def test_results_have_names_units_and_meanings(undisturbed: Path) -> None:
    found = xarray.open_zarr(undisturbed)
    assert dict(found.sizes) == {"x": 7, "y": 6, "z": 5, "beta": 3}
    assert set(found.coords) == {"x", "y", "z", "alpha", "beta", "lambda_"}
    assert set(found.data_vars) == {*METRICS, "status"}
    for name, unit in {"x": "m", "alpha": "rad", "beta": "rad", "conditioning": "1", "payload": "N"}.items():
        assert found[name].attrs["units"] == unit
    assert all(variable.attrs["long_name"] for variable in found.variables.values())
    np.testing.assert_array_equal(found.x, np.linspace(0.37, 0.44, 7))
    assert (float(found.alpha), float(found.lambda_)) == (0.01, 0.1)
    assert found.reachable.attrs["flag_values"] == [-128, 0, 1]
    assert found.reachable.attrs["flag_meanings"] == "not_computed no yes"
    assert found.status.attrs["flag_meanings"] == "not_computed ok unreachable degenerate unsolved"
    assert found.payload.attrs["push"] == 1.0
    assert found.attrs["source"] == f"spm_pin {spm.__version__}"
    definition = json.loads(found.attrs["spm_pin_sweep"])
    assert definition["geometry"]["middle_side"] == MACHINE.middle_side
    assert {str(found[name].dtype) for name in ("reachable", "status", "branches")} == {"int8"}
    assert zarr.open_group(undisturbed, mode="r").metadata.zarr_format == 3


def test_values_not_computed_differ_from_absent_ones(undisturbed: Path, store: Path) -> None:
    records(store)[0].unlink()
    for name in (*METRICS, "status"):
        (store / name / "c.0.0.0.0").unlink()
    found, whole = xarray.open_zarr(store).load(), xarray.open_zarr(undisturbed).load()
    missing = found.status == -128
    assert int(missing.sum()) == 90
    assert (found.reachable.values[missing] == -128).all()
    assert (found.branches.values[missing] == -128).all()
    assert found.conditioning.isnull().values[missing].all()
    xarray.testing.assert_identical(found.where(~missing), whole.where(~missing))
    assert sweep_status(store).done == 6


def test_a_sample_of_leg_lengths_keeps_its_points(tmp_path: Path) -> None:
    domain = leg_sample(700, (1.1, 1.5), [1.2, (1.1, 1.5), 1.3], seed=4)
    found = run_sweep(MACHINE, domain, ["o_x", "o_y", "o_z", "branches"], tmp_path / "a", workers=1, chunk=256).load()
    assert dict(found.sizes) == {"sample": 700}
    legs = np.stack([np.broadcast_to(found[leg], 700) for leg in spm.machine.LEGS], axis=-1)
    state = spm.forward_physical(MACHINE, legs)
    np.testing.assert_array_equal(np.stack([found[f"o_{k}"] for k in "xyz"], axis=-1), state.translation)
    assert found.r_b1.attrs["units"] == "m"
    assert set(found.coords) == set(spm.machine.LEGS)
    poses = run_sweep(
        MACHINE, pose_sample(50, (-1, 1), 0, 2, xyx=[0.1, (0.2, 0.5), 0]), ["branches"], tmp_path / "b", workers=1
    )
    assert {"x", "beta"} <= set(poses.coords)


# Going on


def test_nothing_is_computed_twice(store: Path, undisturbed: Path, computed: list[tuple[int, ...]]) -> None:
    small(store)
    resume_sweep(store, workers=1)
    # The order of metrics makes no other sweep, nor does a metric in place of its name.
    small(store, metrics=[payload(push=1.0), *reversed(METRICS[:3])])
    assert computed == []
    assert contents(store) == contents(undisturbed)


PLACE = "c.3.0.0.0"


def flip_bit(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 4
    path.write_bytes(content)


CHUNK_DAMAGES: dict[str, Callable[[Path], object]] = {
    "a bit": lambda store: flip_bit(store / "conditioning" / PLACE),
    "length": lambda store: (store / "status" / PLACE).write_bytes((store / "status" / PLACE).read_bytes()[:-1]),
    "no data": lambda store: (store / "reachable" / PLACE).unlink(),
    "no mark": lambda store: (store / "sweep/done" / PLACE).unlink(),
    "another mark": lambda store: (store / "sweep/done" / PLACE).write_bytes(b"\0" * 32),
    "empty mark": lambda store: (store / "sweep/done" / PLACE).write_bytes(b""),
}


@pytest.mark.parametrize("damage", CHUNK_DAMAGES)
def test_damaged_chunks_are_computed_again(
    damage: str, store: Path, undisturbed: Path, computed: list[tuple[int, ...]]
) -> None:
    CHUNK_DAMAGES[damage](store)
    assert contents(store) != contents(undisturbed)
    small(store)
    assert computed == [(3, 0, 0, 0)]
    assert contents(store) == contents(undisturbed)


def test_drafts_of_files_of_killed_processes_do_no_harm(store: Path, undisturbed: Path) -> None:
    for name in ("status/c.0.0.0", "sweep/done/c.0.0", "payload/zarr"):
        (store / f"{name}.{32 * 'a'}.partial").write_bytes(b"half")
    (store / "sweep" / "lock").write_text('{"pid": 1')
    small(store)
    xarray.testing.assert_identical(xarray.open_zarr(store), xarray.open_zarr(undisturbed))
    assert contents(store) == contents(undisturbed)


def test_nothing_that_a_sweep_did_not_make_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "map.zarr"
    for folder in ("map.zarr.new", ".map.zarr.abc", "map.zarr.draft"):
        (tmp_path / folder / "results").mkdir(parents=True)
        (tmp_path / folder / "thesis.tex").write_text("mine")
    for file in ("map.zarr.lock", "map.zarr.partial"):
        (tmp_path / file).write_text("mine")
    small(path)
    for file in ("notes.partial", "status/c.partial", "status/draft.partial", "sweep/done/lock", "data.csv"):
        (path / file).write_text("mine")
    (path / "mine.partial").mkdir()
    before = contents(tmp_path)
    small(path)
    resume_sweep(path, workers=1)
    assert contents(tmp_path) == before
    assert (path / "mine.partial").is_dir()


def test_an_error_in_a_metric_leaves_what_was_done(tmp_path: Path) -> None:
    def fragile(points: Points) -> np.ndarray:
        x = points.coordinates[:, 0]
        if x.max() > 0.41:
            raise ZeroDivisionError("x")
        return x

    with pytest.raises(ZeroDivisionError) as error:
        small(tmp_path / "map.zarr", metrics=[Metric("fragile", "m", "", fragile)])
    assert error.value.__notes__ == ["while evaluating the metric 'fragile'"]
    assert sweep_status(tmp_path / "map.zarr").done == 4
    with pytest.raises(spm.ArgumentError, match="of your own"):
        resume_sweep(tmp_path / "map.zarr", workers=1)


def test_the_note_of_an_interrupt_says_what_is_complete(tmp_path: Path, undisturbed: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        if done > 200:
            raise KeyboardInterrupt

    path = tmp_path / "map.zarr"
    with pytest.raises(KeyboardInterrupt) as error:
        small(path, progress=interrupt)
    assert "3 of 7 chunks are complete" in error.value.__notes__[0]
    resume_sweep(path, workers=1)
    assert contents(path) == contents(undisturbed)


def test_a_sweep_of_a_machine_as_built_is_resumed_from_its_store(tmp_path: Path) -> None:
    path, built = tmp_path / "map.zarr", MACHINE.perturbed(1, length=1e-3)
    small(path, machine=built)
    whole = contents(path)
    for record in records(path)[3:]:
        record.unlink()
    resume_sweep(path, workers=1)
    assert contents(path) == whole
    assert (xarray.open_zarr(path).reachable == 1).any()


# What is refused

WIDER = pose_grid((0.37, 0.44, 8), (-0.16, -0.12, 6), (2.45, 2.55, 5), xyx=[0.01, (0.3, 0.34, 3), 0.1])
OTHERS: dict[str, dict[str, Any]] = {
    "geometry.base_radius is 0.69": {"machine": dataclasses.replace(MACHINE, base_radius=0.7)},
    'geometry.legs is null in the store and {"r_b1": {"axis": [0.49': {"machine": MACHINE.perturbed(1)},
    "geometry.leg_limits[1] is 1.5": {"machine": dataclasses.replace(MACHINE, limits=spm.LegLimits(1.1, 1.45))},
    "domain.axes[0].count is 7 in the store and 8 in this sweep": {"domain": WIDER},
    'domain.space is "pose" in the store and "legs"': {"domain": leg_grid((1.1, 1.5, 3), 1.2)},
    'metrics is ["branches", ': {"metrics": METRICS[:3]},
    "metrics[2].parameters.push is 1.0": {"metrics": [*METRICS[:3], payload(push=5.0)]},
    'metrics[2].dtype is "float64"': {"metrics": [*METRICS[:3], dataclasses.replace(payload, dtype="float32")]},
    "chunk[0] is 1 in the store and": {"chunk": 300},
}


@pytest.mark.parametrize("difference", OTHERS)
def test_store_of_another_sweep_is_refused_and_not_changed(difference: str, store: Path, undisturbed: Path) -> None:
    with pytest.raises(spm.ArgumentError, check=with_fields(argument="store")) as error:
        small(store, **OTHERS[difference])
    assert difference in str(error.value.received)
    assert contents(store) == contents(undisturbed)


def test_a_store_of_another_version_is_refused(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spm, "__version__", "9.9")
    with pytest.raises(spm.ArgumentError, match=r'spm_pin is "0\..*" in the store and "9.9" in this sweep'):
        small(store)
    with pytest.raises(spm.ArgumentError, match=r"of spm_pin 9.9, got .* made by 0\."):
        resume_sweep(store)


@pytest.mark.parametrize("kind", ["file", "folder", "other results"])
def test_other_files_are_refused_and_not_changed(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "map.zarr"
    if kind == "file":
        path.write_text("mine")
    elif kind == "folder":
        path.mkdir()
        (path / "thesis.tex").write_text("mine")
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            xarray.Dataset({"a": ("x", [1.0])}).to_zarr(path, zarr_format=3)
    before = contents(tmp_path)
    for act in (small, resume_sweep, sweep_status):
        with pytest.raises(spm.ArgumentError, match="folder of a sweep"):
            act(path)
    assert contents(tmp_path) == before


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"workers": None, "scheduler": 3}, "scheduler"),
        ({"metrics": [["reachable"]]}, "a Metric, or names among"),
        ({"metrics": [Metric("x", "m", "", lambda points: points.coordinates[:, 0])]}, "coordinates"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_written(
    changes: dict[str, Any], says: str, tmp_path: Path
) -> None:
    with pytest.raises(spm.ArgumentError, match=says):
        small(tmp_path / "map.zarr", **changes)
    assert list(tmp_path.iterdir()) == []


def change_definition(store: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    """Replace the definition in a store's metadata by a changed one."""
    content = json.loads((store / "zarr.json").read_text())
    definition = json.loads(content["attributes"]["spm_pin_sweep"])
    changed = change(definition)
    text = changed if isinstance(changed, str) else json.dumps(definition)
    content["attributes"]["spm_pin_sweep"] = text
    (store / "zarr.json").write_text(json.dumps(content))


def spoil_an_array(store: Path) -> None:
    (store / "status" / "zarr.json").write_text("{}")
    content = json.loads((store / "zarr.json").read_text())
    del content["consolidated_metadata"]
    (store / "zarr.json").write_text(json.dumps(content))


DEFINITIONS: dict[str, Callable[[dict[str, Any]], Any]] = {
    "cut": lambda definition: json.dumps(definition)[:-20],
    "number": lambda definition: "3",
    "no domain": lambda definition: definition.pop("domain"),
    "short chunk": lambda definition: definition.update(chunk=["1"]),
    "metric": lambda definition: definition.update(metrics=[{"unit": "m"}]),
    "axis": lambda definition: definition["domain"]["axes"][0].pop("count"),
    "count": lambda definition: definition["domain"]["axes"][0].update(count=10**12),
    "points": lambda definition: definition["domain"]["axes"][0].update(count=3),
    "sample": lambda definition: definition["domain"].update(sample={"count": 10**12, "seed": 0}),
    "format": lambda definition: definition.update(format=99),
    "legs without numbers": lambda definition: definition["geometry"].update(legs=dict.fromkeys(spm.machine.LEGS)),
    "another key": lambda definition: definition.update(points=630),
}
TEXTS = ("", "[]", '{"attributes": 3}', "[" * 100_000)
DAMAGES: dict[str, Callable[[Path], object]] = {
    "array": spoil_an_array,
    **{name: lambda store, change=change: change_definition(store, change) for name, change in DEFINITIONS.items()},
    **{text[:20]: lambda store, text=text: (store / "zarr.json").write_text(text) for text in TEXTS},
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_metadata_are_a_store_error(damage: str, store: Path) -> None:
    DAMAGES[damage](store)
    before = contents(store)
    for act in (small, resume_sweep) if damage == "array" else (small, resume_sweep, sweep_status):
        with pytest.raises(StoreError, match=r"cannot be read|format 99"):
            act(store)
    assert contents(store) == before


def test_a_pickle_in_a_store_is_not_read(store: Path, tmp_path: Path) -> None:
    ran = tmp_path / "ran"
    for place in (store / "zarr.json", store / "status" / "zarr.json"):
        content = json.loads(place.read_text())
        array = content["consolidated_metadata"]["metadata"]["status"] if place.parent == store else content
        array["codecs"] = [{"name": "numcodecs.pickle", "configuration": {}}]
        place.write_text(json.dumps(content))
    (store / "status" / PLACE).write_bytes(b"cposix\nsystem\n(S'touch " + str(ran).encode() + b"'\ntR.")
    for act in (small, resume_sweep):
        with pytest.raises(StoreError, match="metadata cannot be read"):
            act(store)
    assert not ran.exists()


# One process at a time


def test_two_processes_on_one_store_are_refused_by_whatever_path(store: Path, tmp_path: Path) -> None:
    alias = tmp_path / "alias"
    alias.symlink_to(store)
    for path in (store, alias):
        with locked(store), pytest.raises(StoreLockedError, match=f"process {os.getpid()} on ") as error:
            small(path)
    assert error.value.path in (str(store), str(alias))
    assert sweep_status(alias).complete
    small(store)


# Disks that fail


@pytest.mark.parametrize("where", ["status", "sweep/done"])
def test_a_full_disk_leaves_what_was_done(
    where: str, tmp_path: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # One for the metadata of the array.
    room = [4]
    replace = Path.replace

    def full(self: Path, target: Path) -> Path:
        if Path(target).parent.name == Path(where).name:
            if room[0] == 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(target))
            room[0] -= 1
        return replace(self, target)

    path = tmp_path / "map.zarr"
    monkeypatch.setattr(Path, "replace", full)
    with pytest.raises(SweepError, match=r"no space left on device at .*3 of 7 chunks are complete") as error:
        small(path)
    assert (error.value.done, error.value.total) == (3, 7)
    monkeypatch.undo()
    kept = times(path)
    assert len(kept) == 3
    resume_sweep(path, workers=1)
    assert contents(path) == contents(undisturbed)
    assert kept.items() <= times(path).items()


def test_a_store_is_made_in_an_empty_folder_and_folders_above_it_but_a_file_is_none(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="not a directory"):
        small(tmp_path / "file" / "map.zarr")
    (tmp_path / "empty").mkdir()
    for path in (tmp_path / "empty", tmp_path / "a" / "b" / "map.zarr"):
        small(path)
        assert sweep_status(path).complete


def test_memory_does_not_grow_with_the_number_of_points(tmp_path: Path) -> None:
    def peak(chunks: int) -> int:
        domain = leg_sample(4096 * chunks, (1.1, 1.5), 1.3)
        tracemalloc.start()
        try:
            run_sweep(MACHINE, domain, ["o_x", "conditioning"], tmp_path / str(chunks), chunk=4096, workers=1).close()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(1)
    few, many = peak(2), peak(8)
    # Six more chunks of results and coordinates would be 1.6 MB.
    assert many - few < 400_000
