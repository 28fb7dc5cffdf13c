"""The results of a sweep on disk: a Zarr v3 group in which every chunk is either complete or not there.

Beside the variables is a group `sweep` with the array `checksum`: for every chunk the SHA-256 of the sweep's definition
and of the chunk's bytes in all variables. It is the record that the chunk is complete. It appears, at once and as a
whole, after the chunk's bytes have reached the disk; so a chunk with a record that fits needs no work, and any other is
computed again.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import socket
import uuid
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, MissingExtraError, SpmError
from spm_pin.sweeps.metric import Index
from spm_pin.sweeps.plan import Plan, differences

if TYPE_CHECKING:
    import zarr

__all__ = ["Store", "StoreError", "as_store_error", "completed", "stored_definition"]

_RECORDS = "sweep/checksum"
_PARTIAL = ".partial"


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

    def __reduce__(self) -> tuple[type[StoreError], tuple[str, str]]:
        return type(self), (self.path, self.reason)


class Store:
    """The store of one plan.

    Parameters
    ----------
    path : Path
        Its folder, on a file system that everybody who works on it sees.
    plan : Plan
        What it holds.

    Raises
    ------
    ArgumentError
        If there is something else at `path`, or a store of another plan.
    StoreError
        If it cannot be read.
    """

    def __init__(self, path: Path, plan: Plan) -> None:
        import zarr

        self.path = path
        self.plan = plan
        lines = differences(stored_definition(path), plan.definition())
        if lines:
            raise ArgumentError(
                "store", "a new folder, or one with a store of this very sweep", f"{path}, where {'; '.join(lines)}"
            )
        with as_store_error(path):
            try:
                group = zarr.open_group(path, mode="r+", zarr_format=3)
                self._arrays: dict[str, zarr.Array[Any]] = {name: _array(group, name) for name in self._names}
            except (KeyError, TypeError, ValueError) as error:
                raise StoreError(str(path), f"its metadata are damaged ({error}). Sweep into another folder") from error

    @classmethod
    def create(cls, path: Path, plan: Plan) -> Store:
        """Open the store, or make it, which takes effect at once and as a whole.

        Raises
        ------
        ArgumentError, StoreError
            As for the class, or if it cannot be written.
        """
        with as_store_error(path):
            if not _is_new(path):
                return cls(path, plan)
            draft = path.with_name(f"{path.name}.new")
            shutil.rmtree(draft, ignore_errors=True)
            _create(draft, plan)
            for folder, _, files in os.walk(draft):
                for file in files:
                    _synchronise(Path(folder, file))
                _synchronise(Path(folder))
            draft.rename(path)
            _synchronise(path.parent)
        return cls(path, plan)

    @property
    def _names(self) -> tuple[str, ...]:
        return (*(axis.name for axis in self.plan.sampled), *(index.name for index in self.plan.variables))

    def is_complete(self, index: tuple[int, ...]) -> bool:
        """Tell whether the chunk at `index` has been written, and is still what it was."""
        with as_store_error(self.path):
            try:
                return self._record(index).read_bytes() == self._checksum(index)
            except FileNotFoundError:
                return False

    def write(self, index: tuple[int, ...], values: dict[str, npt.NDArray[Any]]) -> None:
        """Write the chunk at `index`, then its record.

        Raises
        ------
        StoreError
            If that fails, as on a full disk. The chunk then has no record, or the one it had.
        """
        with as_store_error(self.path):
            for name, array in self._arrays.items():
                array[self.plan.region(index)] = values[name]
            for name in self._names:
                _synchronise(self._chunk(name, index))
                _synchronise(self.path / name)
            record = self._record(index)
            draft = record.with_name(f"{uuid.uuid4().hex}{_PARTIAL}")
            draft.write_bytes(self._checksum(index))
            _synchronise(draft)
            draft.replace(record)
            _synchronise(record.parent)

    def tidy(self) -> None:
        """Remove what processes that were killed have left behind."""
        with as_store_error(self.path):
            for name in (*self._names, _RECORDS):
                for entry in os.scandir(self.path / name):
                    if entry.name.endswith(_PARTIAL):
                        Path(entry.path).unlink(missing_ok=True)

    def _chunk(self, name: str, index: tuple[int, ...]) -> Path:
        return self.path / name / f"c.{'.'.join(map(str, index))}"

    def _record(self, index: tuple[int, ...]) -> Path:
        return self._chunk(_RECORDS, (*index, 0))

    def _checksum(self, index: tuple[int, ...]) -> bytes:
        total = hashlib.sha256(self.plan.digest)
        total.update(repr(index).encode())
        for name in self._names:
            content = self._chunk(name, index).read_bytes()
            total.update(f"{name} {len(content)} ".encode())
            total.update(content)
        return total.digest()


def stored_definition(path: Path) -> dict[str, Any]:
    """Return the definition of the sweep whose store is at `path`.

    Raises
    ------
    ArgumentError
        If there is no such store.
    StoreError
        If it cannot be read.
    """
    expected = "the folder of a sweep"
    try:
        with as_store_error(path):
            content = json.loads((path / "zarr.json").read_text(encoding="utf-8"))
        definition = json.loads(content["attributes"]["definition"])
    except (KeyError, TypeError, ValueError, StoreError) as error:
        if isinstance(error, StoreError) and not isinstance(error.__cause__, FileNotFoundError | NotADirectoryError):
            raise
        received = f"{path}, which holds none" if path.exists() else f"{path}, which does not exist"
        raise ArgumentError("store", expected, received) from None
    if not isinstance(definition, dict):
        raise ArgumentError("store", expected, f"{path}, which holds something else")
    return definition


def completed(path: Path) -> int:
    """Return the number of chunks with a record, without reading them."""
    with as_store_error(path):
        return sum(entry.name.startswith("c.") for entry in os.scandir(path / _RECORDS))


def _is_new(path: Path) -> bool:
    return not path.exists() or (path.is_dir() and not any(path.iterdir()))


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    import zarr

    array = group[name]
    if not isinstance(array, zarr.Array):
        raise TypeError(f"{name} is no array")
    # A chunk of nothing but fill values is a file like the others: a missing one is always an accident.
    return array.with_config({"write_empty_chunks": True})


def _create(path: Path, plan: Plan) -> None:
    """Write the metadata and the coordinates."""
    try:
        import zarr
        from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec
    except ImportError as missing:
        raise MissingExtraError("cluster", missing.name or "zarr") from missing

    domain = plan.domain
    fixed = [axis for axis in domain.axes if axis.fixed]
    apart = [axis.name for axis in (*fixed, *plan.sampled)]
    group = zarr.create_group(
        path,
        zarr_format=3,
        attributes={
            "title": f"3RPS-3SPR manipulator: {', '.join(index.name for index in plan.indices)}",
            "source": f"spm_pin {plan.version}",
            "definition": plan.text,
            **({"coordinates": " ".join(apart)} if apart else {}),
        },
    )
    keys: dict[str, Any] = {"name": "default", "separator": "."}

    def array(name: str, dtype: str, fill: float, attributes: dict[str, Any]) -> None:
        group.create_array(
            name,
            shape=domain.shape,
            chunks=plan.chunk,
            dtype=dtype,
            fill_value=fill,
            serializer=BytesCodec(endian="little") if np.dtype(dtype).itemsize > 1 else BytesCodec(endian=None),
            compressors=[ZstdCodec(level=3), Crc32cCodec()],
            dimension_names=domain.dims,
            chunk_key_encoding=keys,
            attributes=attributes,
        )

    for axis in domain.axes:
        if axis in plan.sampled:
            array(axis.name, "float64", np.nan, dict(axis.attributes))
        else:
            values = np.asarray(axis.start) if axis.fixed else axis.values
            names = () if axis.fixed else (axis.name,)
            group.create_array(axis.name, data=values, dimension_names=names, attributes=dict(axis.attributes))
    for one in plan.variables:
        array(one.name, one.dtype, one.not_computed, _attributes(one))
    said = "SHA-256 of the definition and of the chunk's bytes in all variables; 0 if it is not complete"
    records = group.create_group("sweep")
    records.create_array(
        "checksum",
        shape=(*plan.chunks, 32),
        chunks=(*(1 for _ in plan.chunks), 32),
        dtype="uint8",
        fill_value=0,
        compressors=None,
        dimension_names=(*domain.dims, "byte"),
        chunk_key_encoding=keys,
        attributes={"long_name": said},
    )
    with warnings.catch_warnings():
        # Zarr 3 warns that other readers may ignore it, which is what they should do; xarray warns where it is missing.
        warnings.simplefilter("ignore", category=UserWarning)
        zarr.consolidate_metadata(path)


def _attributes(index: Index) -> dict[str, Any]:
    kind = np.dtype(index.dtype).kind
    attributes: dict[str, Any] = {"long_name": index.description, "units": index.unit}
    if kind == "i":
        attributes["not_computed"] = index.not_computed
    if index.flags:
        flags = {"not_computed": index.not_computed, **index.flags} if kind == "i" else dict(index.flags)
        attributes["flag_values"] = list(flags.values())
        attributes["flag_meanings"] = " ".join(flags)
    attributes |= {name: value for name, value in index.parameters.items() if value is not None}
    return attributes


def _synchronise(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def as_store_error(path: Path) -> Iterator[None]:
    """Turn an `OSError` into a `StoreError` that says where it happened."""
    try:
        yield
    except OSError as error:
        where = f" at {error.filename}" if error.filename and str(error.filename) != str(path) else ""
        reason = f"{(error.strerror or str(error)).lower()}{where}, on host {socket.gethostname()}"
        raise StoreError(str(path), reason) from error
