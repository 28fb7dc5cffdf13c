"""The C sources of the benchmarks, compiled by the machine's compiler when first used."""

from __future__ import annotations

import ctypes
import functools
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.peers.peer import Unavailable

FLAGS = ("-O3", "-march=native")
"""Flags of the C loop, no more."""
_HERE = Path(__file__).parent


@functools.cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="spm-pin-benchmarks-")


def folder() -> Path:
    """Return a folder for what is compiled, gone when the process ends."""
    return Path(_temporary().name)


def shared_object(source: Path, flags: tuple[str, ...], compiler: str = "cc") -> Path:
    """Compile a source to a shared object that lives as long as the process, or raise `Unavailable`."""
    found = shutil.which(compiler)
    if found is None:
        raise Unavailable(f"there is no compiler {compiler} on the path")
    out = folder() / f"{source.stem}-{compiler}-{abs(hash(flags))}.so"
    if not out.exists():
        command = [found, *flags, "-shared", "-fPIC", str(source), "-o", str(out), "-lm"]
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=source.parent)
        if done.returncode != 0:
            last = (done.stderr.strip().splitlines() or ["no message"])[0]
            raise Unavailable(f"{compiler} does not compile {source.name}: {last}")
    return out


@functools.cache
def library(name: str, flags: tuple[str, ...] = FLAGS, compiler: str = "cc") -> ctypes.CDLL:
    """Load a source of this folder, compiled."""
    return ctypes.CDLL(str(shared_object(_HERE / name, flags, compiler)))


def compiler_version(compiler: str = "cc") -> str:
    """Return what the compiler calls itself."""
    found = shutil.which(compiler)
    if found is None:
        return "none"
    done = subprocess.run([found, "--version"], capture_output=True, text=True, check=False)
    return (done.stdout.splitlines() or ["unknown"])[0]


def address(array: npt.NDArray[np.generic]) -> ctypes.c_void_p:
    """Return where a contiguous array begins; the array lives as long as that pointer."""
    assert array.flags.c_contiguous
    return array.ctypes.data_as(ctypes.c_void_p)
