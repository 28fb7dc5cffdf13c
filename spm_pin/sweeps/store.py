"""The results of a sweep on disk: a Zarr v3 group in which every chunk is either complete or not there.

Each chunk of each variable ends with its CRC32C, by Zarr's own codec. Beside the variables is a group `sweep` with the
array `crc32c`: for every chunk the CRC32C of the sweep's definition, of the chunk's index, and of its bytes in all
variables. It is the record that the chunk is complete. It is written after the chunk's bytes have reached the disk, so
a chunk with a record that fits needs no work, and any other is computed again. Nothing is removed but the drafts, by
their names, that Zarr writes before it renames them.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import socket
import stat
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from spm_pin.errors import ArgumentError, SpmError
from spm_pin.mechanism.arguments import file_path
from spm_pin.sweeps.domains import Domain
from spm_pin.sweeps.metric import DTYPES
from spm_pin.sweeps.plan import FORMAT, Plan, definition_differences

if TYPE_CHECKING:
    import zarr

__all__ = [
    "LOCK",
    "Store",
    "StoreError",
    "as_store_error",
    "completed_count",
    "domain_and_definition",
    "plan_of_store",
    "require_file",
    "store_path",
]

LOCK = "sweep/lock"
"""The lock file of a store, relative to the store."""
_RECORDS = "sweep/crc32c"
_CODECS = {"bytes", "zstd", "crc32c"}
_DRAFT = re.compile(r"(c(\.\d+)*|zarr)\.[0-9a-f]{32}\.partial")
_KEYS: dict[str, Any] = {"name": "default", "separator": "."}
_DAMAGED = (KeyError, TypeError, ValueError, ArithmeticError, AttributeError, IndexError, RecursionError)


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
        Its folder, on a file system that all workers see.
    plan : Plan
        The sweep that it must be of.

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
        lines = definition_differences(domain_and_definition(path)[1], json.loads(plan.text))
        if lines:
            raise ArgumentError(
                "store", "a new folder, or one with a store of this very sweep", f"{path}, where {'; '.join(lines)}"
            )
        with as_store_error(path):
            try:
                group = zarr.open_group(path, mode="r+", zarr_format=3)
                self._arrays = {name: _array(group, name) for name in (*self._names, _RECORDS)}
            except (KeyError, TypeError, ValueError) as error:
                raise _damaged(path, "metadata", error) from error
        self._records = self._arrays.pop(_RECORDS)

    @classmethod
    def create(cls, path: Path, plan: Plan) -> Store:
        """Open the store; make it if there is none or an empty folder. It appears as a whole.

        Raises
        ------
        ArgumentError, StoreError
            As for the class, or if it cannot be written.
        """
        with as_store_error(path):
            if not path.exists() or (path.is_dir() and not any(path.iterdir())):
                # A process that is killed leaves this hidden folder behind: no later one can find out whose it is.
                with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
                    draft = Path(folder, "store")
                    _create(draft, plan)
                    for place, _, files in os.walk(draft):
                        for name in (*files, "."):
                            _synchronise(Path(place, name))
                    try:
                        draft.rename(path)
                    except OSError:
                        if not (path / "zarr.json").exists():
                            raise
                        # Another process has made a store in the meantime; whether it is of this sweep is seen below.
                _synchronise(path.parent)
        return cls(path, plan)

    @property
    def _names(self) -> tuple[str, ...]:
        return (*(axis.name for axis in self.plan.sampled), *(variable.name for variable in self.plan.variables))

    def is_complete(self, index: tuple[int, ...]) -> bool:
        """Return whether the chunk at `index` has been written, and is still as it was.

        Raises
        ------
        StoreError
            If something that is no file stands in the place of one.
        """
        with as_store_error(self.path):
            try:
                for name in (_RECORDS, *self._names):
                    require_file(self._file(name, index))
                return bool(self._records[index] == self._checksum(index))
            except (FileNotFoundError, ValueError, RuntimeError):
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
                _synchronise(self._file(name, index))
                _synchronise(self.path / name)
            self._records[index] = self._checksum(index)
            _synchronise(self._file(_RECORDS, index))
            _synchronise(self.path / _RECORDS)

    def remove_drafts(self) -> None:
        """Remove the files that processes which were killed had not yet renamed."""
        with as_store_error(self.path):
            for name in (*self._names, _RECORDS):
                for entry in os.scandir(self.path / name):
                    if _DRAFT.fullmatch(entry.name) and entry.is_file(follow_symlinks=False):
                        Path(entry.path).unlink(missing_ok=True)

    def _file(self, name: str, index: tuple[int, ...]) -> Path:
        return self.path / name / f"c.{'.'.join(map(str, index))}"

    def _checksum(self, index: tuple[int, ...]) -> int:
        import google_crc32c

        checksum = google_crc32c.value(f"{self.plan.text} {index}".encode())
        for name in self._names:
            content = _read(self._file(name, index))
            checksum = google_crc32c.extend(checksum, f"{name} {len(content)} ".encode())
            checksum = google_crc32c.extend(checksum, content)
        return int(checksum)


def store_path(store: str | os.PathLike[str]) -> Path:
    """Return the absolute path of a store, links followed: workers may run in another folder.

    Raises
    ------
    ArgumentError
        If it is no path.
    """
    path = file_path(store, "store")
    try:
        path = path.resolve()
    except (OSError, RuntimeError) as error:
        raise ArgumentError("store", "the path of a folder", repr(store), str(error)) from error
    if not path.name:
        raise ArgumentError("store", "the path of a folder", repr(store))
    return path


def domain_and_definition(path: Path) -> tuple[Domain, dict[str, Any]]:
    """Return the domain and the definition of the sweep whose store is at `path`, after a check of its metadata.

    Raises
    ------
    ArgumentError
        If there is no such store.
    StoreError
        If it cannot be read, is damaged, or uses a codec or a type that no sweep writes.
    """
    with as_store_error(path):
        try:
            text = _read(path / "zarr.json")
        except (FileNotFoundError, NotADirectoryError):
            received = f"{path}, which holds none" if path.exists() else f"{path}, which does not exist"
            raise ArgumentError("store", "the folder of a sweep", received) from None
        try:
            metadata = json.loads(text)
            attributes = metadata["attributes"]
            if "spm_pin_sweep" not in attributes:
                raise ArgumentError("store", "the folder of a sweep", f"{path}, which holds something else")
            _check_metadata(path, metadata)
            definition = json.loads(attributes["spm_pin_sweep"])
            domain = Domain.from_definition(definition["domain"])
            if definition["format"] != FORMAT:
                raise StoreError(str(path), f"a store of format {definition['format']}; this version has {FORMAT}")
            parts, names = definition["chunk"], [metric["name"] for metric in definition["metrics"]]
            fits = len(parts) == len(domain.shape) and all(
                type(part) is int and 1 <= part <= length for part, length in zip(parts, domain.shape, strict=True)
            )
            whole = fits and domain.definition() == definition["domain"] and isinstance(definition["spm_pin"], str)
            if not whole or not all(isinstance(name, str) for name in names):
                raise ValueError("its parts do not fit together")
        except (SpmError, *_DAMAGED) as error:
            if isinstance(error, StoreError) or (isinstance(error, ArgumentError) and error.argument == "store"):
                raise
            raise _damaged(path, "definition", error) from error
    return domain, definition


def plan_of_store(path: Path) -> Plan:
    """Return the plan of the sweep whose store is at `path`.

    Raises
    ------
    ArgumentError
        If a metric is none of this package's.
    StoreError
        If the definition is damaged.
    """
    definition = domain_and_definition(path)[1]
    try:
        return Plan.from_definition(definition)
    except (SpmError, *_DAMAGED) as error:
        if isinstance(error, ArgumentError) and error.argument == "metrics":
            raise
        raise _damaged(path, "definition", error) from error


def completed_count(path: Path) -> int:
    """Return the number of chunks with a record, without reading them."""
    with as_store_error(path):
        return sum(re.fullmatch(r"c(\.\d+)*", entry.name) is not None for entry in os.scandir(path / _RECORDS))


def _check_metadata(path: Path, metadata: dict[str, Any]) -> None:
    """Refuse what Zarr would decode by anything but the codecs of a sweep, as by pickle."""
    members = dict((metadata.get("consolidated_metadata") or {}).get("metadata", {}))
    for place in (*path.glob("*/zarr.json"), *path.glob("sweep/*/zarr.json")):
        members[str(place.parent)] = json.loads(_read(place))
    for name, member in members.items():
        if member["node_type"] == "group":
            continue
        codecs = [codec["name"] if isinstance(codec, dict) else codec for codec in member["codecs"]]
        strange = [codec for codec in codecs if codec not in _CODECS]
        if member["data_type"] not in DTYPES:
            strange.append(member["data_type"])
        strange += member.get("storage_transformers", ())
        if strange:
            reason = f"{name} is stored by {strange[0]!r}, which no sweep writes, and is not read"
            raise StoreError(str(path), reason)


def _damaged(path: Path, what: str, error: BaseException) -> StoreError:
    text = " ".join(str(error).split())[:200]
    return StoreError(
        str(path), f"its {what} cannot be read ({type(error).__name__}: {text}). Sweep into another folder"
    )


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    import zarr

    array = group[name]
    if not isinstance(array, zarr.Array):
        raise TypeError(f"{name} is no array")
    # A chunk of nothing but fill values is a file like the others: a missing one is always an accident.
    return array.with_config({"write_empty_chunks": True})


def _create(path: Path, plan: Plan) -> None:
    """Write the metadata and the coordinates."""
    import zarr
    from zarr.codecs import BytesCodec, Crc32cCodec, ZstdCodec

    domain = plan.domain
    fixed = [axis for axis in domain.axes if axis.fixed]
    apart = [axis.name for axis in (*fixed, *plan.sampled)]
    group = zarr.create_group(
        path,
        zarr_format=3,
        attributes={
            "title": f"3RPS-3SPR manipulator: {', '.join(metric.name for metric in plan.metrics)}",
            "source": f"spm_pin {plan.version}",
            "spm_pin_sweep": plan.text,
            **({"coordinates": " ".join(apart)} if apart else {}),
        },
    )

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
            chunk_key_encoding=_KEYS,
            attributes=attributes,
        )

    for axis in domain.axes:
        if axis in plan.sampled:
            array(axis.name, "float64", np.nan, dict(axis.attributes))
        else:
            values = np.asarray(axis.start) if axis.fixed else axis.values
            names = () if axis.fixed else (axis.name,)
            group.create_array(axis.name, data=values, dimension_names=names, attributes=dict(axis.attributes))
    for variable in plan.variables:
        array(variable.name, variable.dtype, variable.not_computed, variable.attributes())
    group.create_group("sweep").create_array(
        "crc32c",
        shape=plan.chunks,
        chunks=(1,) * len(plan.chunks),
        dtype="int64",
        fill_value=-1,
        compressors=[Crc32cCodec()],
        dimension_names=domain.dims,
        chunk_key_encoding=_KEYS,
        attributes={
            "long_name": "CRC32C of the definition and of the chunk's bytes in all variables; -1 if incomplete"
        },
    )
    (path / LOCK).touch()
    with warnings.catch_warnings():
        # Zarr 3 warns that other readers may ignore it, which is what they should do; xarray warns where it is missing.
        warnings.simplefilter("ignore", category=UserWarning)
        zarr.consolidate_metadata(path)


def require_file(path: Path) -> None:
    """Raise `OSError` if a path is missing, or no regular file: to open a pipe may take for ever."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "not a regular file", str(path))


def _read(path: Path) -> bytes:
    require_file(path)
    return path.read_bytes()


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
