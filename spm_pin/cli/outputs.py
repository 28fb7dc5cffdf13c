"""Files that subcommands write, and the extras they need: checked before the work, written after it."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

import typer

from spm_pin.cli.console import note, to_json
from spm_pin.errors import ArgumentError, MissingExtraError
from spm_pin.mechanism.arguments import writing

__all__ = ["check_output", "name_options", "require_extra", "write_json", "write_model", "write_text"]

EXTRAS = {
    "cluster": ("zarr", "xarray", "dask", "distributed", "filelock", "google_crc32c"),
    "motion": ("toppra",),
    "plots": ("matplotlib", "trimesh"),
    "viewer": ("viser", "trimesh"),
    "workspace": ("trimesh", "skimage"),
}
"""Packages that each optional extra brings."""

P = ParamSpec("P")
R = TypeVar("R")


def require_extra(extra: str) -> None:
    """Raise `MissingExtraError` if a package of an extra is not installed; nothing is imported."""
    for package in EXTRAS[extra]:
        if find_spec(package) is None:
            raise MissingExtraError(extra, package)


def check_output(path: Path | None, option: str = "--out", endings: Sequence[str] = (), cause: str = "") -> None:
    """Raise `ArgumentError` if a file cannot be written later: its ending, its folder, its permissions.

    None, where the option was not used, is not checked. Without `endings` any is allowed; `cause` is added to the
    message about them.
    """
    if path is None:
        return
    if endings and path.suffix.lower() not in endings:
        raise ArgumentError(option, f"a file name ending in {', '.join(endings)}", path.name, cause)
    reason = ""
    if path.is_dir():
        reason = "It is a directory"
    elif not path.parent.is_dir():
        reason = f"There is no directory {path.parent}"
    elif not os.access(path if path.exists() else path.parent, os.W_OK):
        reason = f"No permission to write {path if path.exists() else f'in {path.parent}'}"
    if reason:
        raise ArgumentError(option, "a file that can be written", path, reason)


def write_text(text: str, path: Path | None, option: str = "--out") -> None:
    """Write a text file and say so on stderr; without a path, print the text; raises `ArgumentError` if it cannot."""
    if path is None:
        typer.echo(text, nl=False)
        return
    with writing(path, option):
        path.write_text(text, encoding="utf-8")
    note(f"wrote {path}")


def write_model(text: str, path: Path | None) -> None:
    """Write a model as `write_text` does, and the meshes into a folder beside its file; raises as `copy_meshes`."""
    from spm_pin.description.paths import copy_meshes

    if path is not None:
        copy_meshes(path.parent)
    write_text(text, path)
    if path is not None and path.suffix == ".urdf":
        note(f'in Pinocchio: pinocchio.buildModelsFromUrdf("{path}", package_dirs="{path.parent}"), for the meshes')


def write_json(content: Any, path: Path | None, option: str = "--json") -> None:
    """Write a JSON file; without a path, print the JSON."""
    write_text(to_json(content) + "\n", path, option)


def name_options(**options: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Decorate a command so that its errors name the options typed, not the arguments of the functions it calls.

    An argument with the name of a parameter that was given is that option. `options` are the others, such as
    ``"--out"``, by the argument's name. Errors in a file, which name the file, get the option before.
    """

    def decorate(command: Callable[P, R]) -> Callable[P, R]:
        @functools.wraps(command)
        def run(*args: P.args, **kwargs: P.kwargs) -> R:
            try:
                return command(*args, **kwargs)
            except ArgumentError as error:
                argument, bracket, index = error.argument.partition("[")
                option = options.get(argument)
                if option is None and kwargs.get(argument) is not None:
                    option = f"--{argument.replace('_', '-')}"
                for name, value in kwargs.items():
                    if isinstance(value, Path) and error.argument.partition(":")[0] == str(value):
                        option, bracket, index = f"--{name}: {error.argument}", "", ""
                if option is None:
                    raise
                raise type(error)(option + bracket + index, error.expected, error.received, error.cause) from error

        return run

    return decorate
