"""Files are written whole or not at all."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

import spm_pin as spm
from spm_pin.support.files import write_files

BUILT = spm.Manipulator.paper().perturbed(1)

FULL = """
import resource, signal
import spm_pin as spm
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1024, 1024))
try:
    spm.Manipulator.paper().perturbed(2).to_yaml("machine.yaml")
except spm.errors.GeometryError as error:
    print(error.argument, error.received, error.cause, sep=";")
"""
"""A device that is full after 1,024 bytes."""


def test_a_full_device_leaves_the_machine_that_was_there(tmp_path: Path) -> None:
    BUILT.to_yaml(tmp_path / "machine.yaml")
    done = subprocess.run([sys.executable, "-c", FULL], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == "path;machine.yaml;File too large\n"
    assert spm.Manipulator.from_yaml(tmp_path / "machine.yaml") == BUILT
    assert list(tmp_path.iterdir()) == [tmp_path / "machine.yaml"]


def test_of_several_files_all_are_written_or_none(tmp_path: Path) -> None:
    (tmp_path / "old").write_text("old")
    (tmp_path / "folder").mkdir()
    with pytest.raises(spm.errors.ArgumentError) as caught:
        write_files({tmp_path / "old": "new", tmp_path / "a" / "b" / "c": b"c", tmp_path / "folder": "no file"}, "out")
    assert (caught.value.argument, caught.value.received) == ("out", tmp_path / "folder")
    assert {path.name for path in tmp_path.rglob("*")} == {"folder", "old"}
    assert (tmp_path / "old").read_text() == "old"


def test_links_and_permissions_stay(tmp_path: Path) -> None:
    place, link = tmp_path / "place", tmp_path / "link"
    place.write_text("old")
    place.chmod(0o640)
    link.symlink_to("place")
    write_files({link: "new"})
    assert link.is_symlink()
    assert place.read_text() == "new"
    assert place.stat().st_mode & 0o777 == 0o640
    write_files({tmp_path / "other": "x"})
    umask = os.umask(0)
    os.umask(umask)
    assert (tmp_path / "other").stat().st_mode & 0o777 == 0o666 & ~umask


def test_a_pipe_is_written_to(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    received: list[str] = []
    reader = threading.Thread(target=lambda: received.append(pipe.read_text()))
    reader.start()
    write_files({pipe: "°"})
    reader.join()
    assert received == ["°"]
    assert pipe.is_fifo()
