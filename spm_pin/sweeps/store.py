"""The results of a sweep on disk: a Zarr v3 group in which every chunk is either complete or missing.

Each chunk of each variable ends with its CRC32C, by Zarr's own codec. Beside the variables is the array `sweep/done`: 1
for every chunk that is complete, written after the chunk's bytes have reached the disk. A chunk with this mark whose
files are there and read without an error needs no work, and any other is computed again.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import socket
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, SpmError
from spm_pin.support.files import file_path
from spm_pin.sweeps.domains import FORMAT, SweepPlan, definition_differences
from spm_pin.sweeps.metrics import STATUS

_LOCK = "sweep/lock"
_DONE = "sweep/done"
_SHOWN = 4
"""Maximum number of differences between a store and a sweep in a message."""
_CHUNK = r"c(\.\d+)*"
_UNREADABLE = (SpmError, LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError)
"""Exceptions raised while damaged contents of a store are read."""


class SweepError(SpmError):
    """A sweep stopped, for the `reason` given; `done` of `total` chunks are complete and kept in `store`."""

    def __init__(self, store: str, reason: str, done: int, total: int) -> None:
        self.store, self.reason, self.done, self.total = store, reason, done, total
        super().__init__(
            f"{reason}. {done} of {total} chunks are complete in {store} and stay so; "
            "the same sweep, started again, does the others"
        )


class StoreError(SpmError):
    """A store at `path` that cannot be read or written; `reason` says what failed, and on which host."""

    def __init__(self, path: str | Path, reason: str) -> None:
        self.path, self.reason = str(path), reason
        super().__init__(f"{path}: {reason}")


class StoreLockedError(StoreError):
    """Another process is using the store."""


@contextlib.contextmanager
def as_store_error(path: Path, reading: str = "") -> Iterator[None]:
    """Turn an `OSError` into a `StoreError`; if `reading` names a part of the store, also errors of its contents."""
    try:
        yield
    except StoreError:
        raise
    except OSError as error:
        where = f" at {error.filename}" if error.filename and str(error.filename) != str(path) else ""
        reason = f"{(error.strerror or str(error)).lower()}{where}, on host {socket.gethostname()}"
        raise StoreError(path, reason) from error
    except _UNREADABLE as error:
        if not reading:
            raise
        text = " ".join(str(error).split())[:200]
        reason = f"its {reading} cannot be read ({type(error).__name__}: {text}). Sweep into another folder"
        raise StoreError(path, reason) from error


class Store:
    """The store of one plan; anything else at its path is an `ArgumentError`, a damaged store a `StoreError`."""

    def __init__(self, path: Path, plan: SweepPlan) -> None:
        import zarr

        self.path = path
        self.plan = plan
        lines = definition_differences(json.loads(read_plan(path).text), json.loads(plan.text))
        if lines:
            expected = "a new folder, or one with a store of this very sweep"
            more = [f"{len(lines) - _SHOWN} more differences"] if len(lines) > _SHOWN else []
            raise ArgumentError("store", expected, f"{path}, where {'; '.join([*lines[:_SHOWN], *more])}")
        self._names = tuple(metric.name for metric in plan.variables)
        with as_store_error(path, "metadata"):
            group = zarr.open_group(path, mode="r+", zarr_format=3)
            # A chunk of fill values alone is also written to a file: a missing file is always an accident.
            self._arrays: dict[str, Any] = {
                name: group[name].with_config({"write_empty_chunks": True})  # type: ignore[union-attr]
                for name in (*self._names, _DONE)
            }

    @classmethod
    def create(cls, path: Path, plan: SweepPlan) -> Store:
        """Open the store; if it does not exist or is an empty folder, create it atomically with the folders above it.

        Raises an error for an existing store and a metric without a version: its values may be of another function.
        """
        is_new = False
        with as_store_error(path):
            if not path.exists() or (path.is_dir() and not any(path.iterdir())):
                if not path.parent.exists():
                    path.parent.mkdir(parents=True, exist_ok=True)
                # A process that is killed leaves this hidden folder behind: a later one cannot identify its owner.
                with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
                    draft = Path(folder, "store")
                    _create(draft, plan)
                    for place, _, files in os.walk(draft):
                        _synchronise(*(Path(place, name) for name in (*files, ".")))
                    try:
                        draft.rename(path)
                        is_new = True
                    except OSError:
                        # Another process may have made a store in the meantime; it is compared with this sweep below.
                        if not (path / "zarr.json").exists():
                            raise
                _synchronise(path.parent)
        store = cls(path, plan)
        unversioned = [m.name for m in plan.metrics if m.version is None and not m.is_of_package]
        if unversioned and not is_new:
            expected = "metrics of your own that state a version, to continue a store"
            cause = "It may hold the values of another function: state version=..., and sweep into another folder"
            raise ArgumentError("metrics", expected, f"{', '.join(unversioned)} without one, and {path}", cause)
        return store

    def is_complete(self, index: tuple[int, ...]) -> bool:
        """Return whether the chunk at `index` has been written and is undamaged."""
        with as_store_error(self.path):
            try:
                region = self.plan.domain.region(index, self.plan.chunk)
                # Zarr reads a chunk without a file as one of fill values, and checks the sums of the others.
                return bool(self._arrays[_DONE][index] == 1) and all(
                    self._file(name, index).exists() and self._arrays[name][region] is not None for name in self._names
                )
            except (FileNotFoundError, ValueError, RuntimeError):
                return False

    def write(self, index: tuple[int, ...], values: dict[str, npt.NDArray[Any]]) -> None:
        """Write the chunk at `index`, then mark it as complete."""
        region = self.plan.domain.region(index, self.plan.chunk)
        with as_store_error(self.path):
            # A partly rewritten chunk, after a failure, must not count as complete.
            self._file(_DONE, index).unlink(missing_ok=True)
            for name in self._names:
                self._arrays[name][region] = values[name]
            for name in self._names:
                _synchronise(self._file(name, index), self.path / name)
            self._arrays[_DONE][index] = 1
            _synchronise(self._file(_DONE, index), self.path / _DONE)

    def _file(self, name: str, index: tuple[int, ...]) -> Path:
        return self.path / name / f"c.{'.'.join(map(str, index))}"


def store_path(store: str | os.PathLike[str]) -> Path:
    """Return the absolute path of a store, links followed: workers may run in another folder."""
    path = file_path(store, "store")
    with as_store_error(path):
        return path.resolve()


def read_plan(path: Path) -> SweepPlan:
    """Return the plan of the sweep at `path`; `ArgumentError` without a store, `StoreError` for a damaged one."""
    with as_store_error(path, "definition"):
        file = path / "zarr.json"
        stored = json.loads(file.read_bytes())["attributes"].get("spm_pin_sweep") if file.exists() else None
        if stored is not None:
            definition = json.loads(stored)
            if definition["format"] != FORMAT:
                raise StoreError(path, f"a store of format {definition['format']}; this version reads format {FORMAT}")
            plan = SweepPlan.from_definition(definition)
            lines = definition_differences(definition, json.loads(plan.text))
            if lines:
                raise ValueError(lines[0])
            shape = tuple(json.loads((path / STATUS.name / "zarr.json").read_bytes())["shape"])
            if shape != plan.domain.shape:
                raise ValueError(f"it has points of shape {plan.domain.shape}, and the store's arrays {shape}")
            return plan
        received = "which holds none" if path.exists() else "which does not exist"
    raise ArgumentError("store", "the folder of a sweep", f"{path}, {received}")


def completed_count(path: Path) -> int:
    """Return the number of chunks that are marked as complete, without reading them."""
    with as_store_error(path):
        return sum(re.fullmatch(_CHUNK, entry.name) is not None for entry in os.scandir(path / _DONE))


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of a store, a file in it, which the system releases in any case when the process ends."""
    from filelock import FileLock, Timeout

    file = path / _LOCK
    lock = FileLock(file, fallback_to_soft=False)
    with as_store_error(path):
        try:
            lock.acquire(blocking=False)
        except Timeout:
            holder = file.read_text(encoding="utf-8", errors="replace") or "another process"
            reason = f"{holder} is using this store. Wait for it, or stop it; completed chunks are kept"
            raise StoreLockedError(path, reason) from None
        except OSError as error:
            # A file system without locks; two processes would write the same bytes, each file as a whole.
            if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS):
                raise
        file.write_text(f"process {os.getpid()} on {socket.gethostname()}", encoding="utf-8")
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            file.write_text("", encoding="utf-8")
        lock.release()


def _synchronise(*paths: Path) -> None:
    """Wait until files, or the names in folders, are on the disk."""
    for path in paths:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _create(path: Path, plan: SweepPlan) -> None:
    """Write the metadata and the coordinates that are the same for all points of a row."""
    import zarr
    from zarr.codecs import Crc32cCodec, ZstdCodec

    axes = plan.domain.axes
    apart = " ".join(axis.name for axis in axes if axis.count < 2)
    attributes = {
        "title": f"3RPS-3SPR manipulator: {', '.join(metric.name for metric in plan.metrics)}",
        "source": f"spm_pin {plan.version}",
        "spm_pin_sweep": plan.text,
    }
    group = zarr.create_group(path, zarr_format=3, attributes=attributes | ({"coordinates": apart} if apart else {}))
    for axis in axes:
        if axis.count:
            data, names = (np.asarray(axis.start), ()) if axis.is_fixed else (axis.values, (axis.name,))
            meaning: dict[str, Any] = {"units": plan.unit(axis), "long_name": axis.description}
            group.create_array(axis.name, data=data, dimension_names=names, attributes=meaning)
    layout: dict[str, Any] = {
        "chunk_key_encoding": {"name": "default", "separator": "."},
        "dimension_names": plan.domain.dims,
    }
    for metric in plan.variables:
        group.create_array(
            metric.name,
            shape=plan.domain.shape,
            chunks=plan.chunk,
            dtype=metric.dtype,
            fill_value=metric.not_computed,
            compressors=[ZstdCodec(level=3), Crc32cCodec()],
            attributes=metric.attributes(),
            **layout,
        )
    group.create_array(
        _DONE,
        shape=plan.chunks,
        chunks=(1,) * len(plan.chunks),
        dtype="int8",
        fill_value=0,
        compressors=[Crc32cCodec()],
        attributes={"long_name": "1 where all variables of the chunk are complete"},
        **layout,
    )
    (path / _LOCK).touch()
    with warnings.catch_warnings():
        # Zarr 3 warns that other readers may ignore it, which is what they should do; xarray warns where it is missing.
        warnings.simplefilter("ignore", category=UserWarning)
        zarr.consolidate_metadata(path)
