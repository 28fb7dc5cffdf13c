"""The results of a sweep on disk: a Zarr v3 group in which every chunk is either complete or not there.

Each chunk of each variable ends with its CRC32C, by Zarr's own codec. Beside the variables is a group `sweep` with the
array `crc32c`: for every chunk the CRC32C of the sweep's definition, of the chunk's index, and of its bytes in all
variables. It is the record that the chunk is complete. It is written after the chunk's bytes have reached the disk, so
a chunk with a record that fits needs no work, and any other is computed again. Of a store, only Zarr's
temporary files (`*.partial`), left by killed processes, are ever removed.
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
from spm_pin.mechanism.arguments import file_path
from spm_pin.sweeps.metrics import DTYPES
from spm_pin.sweeps.sweep_plan import FORMAT, SweepPlan, definition_differences

_LOCK = "sweep/lock"
_RECORDS = "sweep/crc32c"
_WRITTEN = ("bytes", "zstd", "crc32c", *DTYPES)
"""Codecs and types of a store."""
_SHOWN = 4
"""Differences between a store and a sweep that a message spells out."""
_CHUNK = r"c(\.\d+)*"
_DRAFT = rf"({_CHUNK}|zarr)\.[0-9a-f]{{32}}\.partial"


_UNREADABLE = (SpmError, LookupError, TypeError, ValueError, ArithmeticError, AttributeError, RecursionError)
"""Exceptions raised while damaged contents of a store are read."""


class SweepError(SpmError):
    """A sweep that stopped; what it had done is kept.

    Attributes
    ----------
    store : str
        Path of the store.
    reason : str
        Why it stopped.
    done, total : int
        Chunks that are complete, and all chunks.
    """

    def __init__(self, store: str, reason: str, done: int, total: int) -> None:
        self.store = store
        self.reason = reason
        self.done = done
        self.total = total
        super().__init__(
            f"{reason}. {done} of {total} chunks are complete in {store} and stay so; "
            "the same sweep, started again, does the others"
        )


class StoreError(SpmError):
    """A store that cannot be read or written.

    Attributes
    ----------
    path : str
        The store.
    reason : str
        What failed, and on which host.
    """

    def __init__(self, path: str, reason: str) -> None:
        self.path = path
        self.reason = reason
        super().__init__(f"{path}: {reason}")


class StoreLockedError(StoreError):
    """Another process is at work on a store."""


@contextlib.contextmanager
def as_store_error(path: Path, reading: str = "") -> Iterator[None]:
    """Turn an `OSError` into a `StoreError` that says where it happened.

    Where something is read, `reading` says what; the errors that its damaged contents raise become a `StoreError` too.
    """
    try:
        yield
    except StoreError:
        raise
    except OSError as error:
        where = f" at {error.filename}" if error.filename and str(error.filename) != str(path) else ""
        reason = f"{(error.strerror or str(error)).lower()}{where}, on host {socket.gethostname()}"
        raise StoreError(str(path), reason) from error
    except _UNREADABLE as error:
        if not reading:
            raise
        text = " ".join(str(error).split())[:200]
        reason = f"its {reading} cannot be read ({type(error).__name__}: {text}). Sweep into another folder"
        raise StoreError(str(path), reason) from error


class Store:
    """The store of one plan.

    Raises `ArgumentError` if the path holds anything else, `StoreError` if what it holds is damaged.
    """

    def __init__(self, path: Path, plan: SweepPlan) -> None:
        import zarr

        self.path = path
        self.plan = plan
        lines = definition_differences(read_plan(path).definition(), plan.definition())
        if lines:
            expected = "a new folder, or one with a store of this very sweep"
            more = [f"{len(lines) - _SHOWN} more differences"] if len(lines) > _SHOWN else []
            raise ArgumentError("store", expected, f"{path}, where {'; '.join([*lines[:_SHOWN], *more])}")
        self._names = tuple(metric.name for metric in plan.variables)
        with as_store_error(path, "metadata"):
            group = zarr.open_group(path, mode="r+", zarr_format=3)
            # A chunk of nothing but fill values is a file like the others: a missing one is always an accident.
            self._arrays: dict[str, Any] = {
                name: group[name].with_config({"write_empty_chunks": True})  # type: ignore[union-attr]
                for name in (*self._names, _RECORDS)
            }

    @classmethod
    def create(cls, path: Path, plan: SweepPlan) -> Store:
        """Open the store; make it, atomically, if there is none or an empty folder.

        A store that exists is refused to a metric without a version: its values may be those of another function.
        """
        is_new = False
        with as_store_error(path):
            if not path.exists() or (path.is_dir() and not any(path.iterdir())):
                # A process that is killed leaves this hidden folder behind: no later one can find out whose it is.
                with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
                    draft = Path(folder, "store")
                    _create(draft, plan)
                    for place, _, files in os.walk(draft):
                        _synchronise(*(Path(place, name) for name in (*files, ".")))
                    try:
                        draft.rename(path)
                        is_new = True
                    except OSError:
                        if not (path / "zarr.json").exists():
                            raise
                        # Another process has made a store in the meantime; whether it is of this sweep is seen below.
                _synchronise(path.parent)
        store = cls(path, plan)
        if plan.unversioned and not is_new:
            expected = "metrics of your own that state a version, to continue a store"
            cause = "It may hold the values of another function: state version=..., and sweep into another folder"
            raise ArgumentError("metrics", expected, f"{', '.join(plan.unversioned)} without one, and {path}", cause)
        return store

    def is_complete(self, index: tuple[int, ...]) -> bool:
        """Return whether the chunk at `index` has been written, and is still as it was."""
        with as_store_error(self.path):
            try:
                return bool(self._checksum(index) == self._arrays[_RECORDS][index])
            except (FileNotFoundError, ValueError, RuntimeError):
                return False

    def write(self, index: tuple[int, ...], values: dict[str, npt.NDArray[Any]]) -> None:
        """Write the chunk at `index`, then its record. If that fails, it has no record, or the one it had."""
        region = self.plan.domain.region(index, self.plan.chunk)
        with as_store_error(self.path):
            for name in self._names:
                self._arrays[name][region] = values[name]
            for name in self._names:
                _synchronise(self._file(name, index), self.path / name)
            self._arrays[_RECORDS][index] = self._checksum(index)
            _synchronise(self._file(_RECORDS, index), self.path / _RECORDS)

    def remove_drafts(self) -> None:
        """Remove the files that processes which were killed had not yet renamed."""
        with as_store_error(self.path):
            for name in (*self._names, _RECORDS):
                for entry in os.scandir(self.path / name):
                    if re.fullmatch(_DRAFT, entry.name) and entry.is_file(follow_symlinks=False):
                        Path(entry.path).unlink(missing_ok=True)

    def _file(self, name: str, index: tuple[int, ...]) -> Path:
        return self.path / name / f"c.{'.'.join(map(str, index))}"

    def _checksum(self, index: tuple[int, ...]) -> int:
        import google_crc32c

        checksum = google_crc32c.value(f"{self.plan.text} {index}".encode())
        for name in self._names:
            content = self._file(name, index).read_bytes()
            checksum = google_crc32c.extend(checksum, f"{name} {len(content)} ".encode())
            checksum = google_crc32c.extend(checksum, content)
        return int(checksum)


def store_path(store: str | os.PathLike[str]) -> Path:
    """Return the absolute path of a store, links followed: workers may run in another folder."""
    path = file_path(store, "store")
    try:
        path = path.resolve()
    except (OSError, RuntimeError) as error:
        raise ArgumentError("store", "the path of a folder", repr(store), str(error)) from error
    return path


def read_plan(path: Path) -> SweepPlan:
    """Return the plan of the sweep whose store is at `path`, after a check of its metadata.

    Raises `ArgumentError` if there is no such store, `StoreError` if it is damaged, or not written by a sweep.
    """
    with as_store_error(path, "definition"):
        if (path / "zarr.json").exists():
            _require_files(path)
            metadata = json.loads((path / "zarr.json").read_bytes())
            stored = metadata["attributes"].get("spm_pin_sweep")
            if stored is not None:
                _check_metadata(path, metadata)
                definition = json.loads(stored)
                if definition["format"] != FORMAT:
                    raise StoreError(str(path), f"a store of format {definition['format']}; this version has {FORMAT}")
                return SweepPlan.from_definition(definition)
        received = "which holds none" if path.exists() else "which does not exist"
    raise ArgumentError("store", "the folder of a sweep", f"{path}, {received}")


def completed_count(path: Path) -> int:
    """Return the number of chunks with a record, without reading them."""
    with as_store_error(path):
        return sum(re.fullmatch(_CHUNK, entry.name) is not None for entry in os.scandir(path / _RECORDS))


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock of a store, a file in it, which the system releases however its holder ends."""
    from filelock import FileLock, Timeout

    file = path / _LOCK
    lock = FileLock(file, fallback_to_soft=False)
    with as_store_error(path):
        try:
            lock.acquire(blocking=False)
        except Timeout:
            holder = file.read_text(encoding="utf-8", errors="replace") or "another process"
            reason = f"{holder} is at work on this store. Wait for it, or end it; what it did is kept"
            raise StoreLockedError(str(path), reason) from None
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


def _require_files(folder: Path | str) -> None:
    """Raise `OSError` if there is anything but folders and regular files in a folder: opening a pipe may block."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                _require_files(entry.path)
            elif not entry.is_file() and Path(entry.path).exists():  # drafts of a sweep that runs come and go
                raise OSError(errno.EINVAL, "not a regular file", entry.path)


def _synchronise(*paths: Path) -> None:
    """Wait until files, or the names in folders, are on the disk."""
    for path in paths:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _check_metadata(path: Path, metadata: dict[str, Any]) -> None:
    """Refuse what Zarr would decode by anything but the codecs of a sweep, as by pickle."""
    members = dict((metadata.get("consolidated_metadata") or {}).get("metadata", {}))
    for place in (*path.glob("*/zarr.json"), *path.glob("sweep/*/zarr.json")):
        members[str(place.parent)] = json.loads(place.read_bytes())
    for name, member in members.items():
        if member["node_type"] == "group":
            continue
        codecs = (codec["name"] if isinstance(codec, dict) else codec for codec in member["codecs"])
        for used in (*codecs, member["data_type"], *member.get("storage_transformers", ())):
            if used not in _WRITTEN:
                raise StoreError(str(path), f"{name} is stored by {used!r}, which no sweep writes, and is not read")


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
            group.create_array(
                axis.name,
                data=np.asarray(axis.start) if axis.is_fixed else axis.values,
                dimension_names=() if axis.is_fixed else (axis.name,),
                attributes={"units": axis.unit, "long_name": axis.description},
            )
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
        _RECORDS,
        shape=plan.chunks,
        chunks=(1,) * len(plan.chunks),
        dtype="int64",
        fill_value=-1,
        compressors=[Crc32cCodec()],
        attributes={"long_name": "CRC32C of the definition and of the chunk's bytes in all variables; -1: incomplete"},
        **layout,
    )
    (path / _LOCK).touch()
    with warnings.catch_warnings():
        # Zarr 3 warns that other readers may ignore it, which is what they should do; xarray warns where it is missing.
        warnings.simplefilter("ignore", category=UserWarning)
        zarr.consolidate_metadata(path)
