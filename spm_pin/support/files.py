"""Names of files as arguments, YAML that is read and files that are written, with errors that name the argument."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import secrets
import shutil
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import yaml

from spm_pin.errors import ArgumentError
from spm_pin.support.arguments import type_and_value


def file_path(
    value: Any, argument: str = "path", *, suffixes: Collection[str] = (), expected: str = "the name of a file"
) -> Path:
    """Read the name of a file without accessing it; `suffixes` are the accepted endings, lower case with their dot."""
    try:
        text = os.fspath(value)
        fits = isinstance(text, str) and bool(text) and b"\0" not in os.fsencode(text)
    except Exception as failed:  # whatever __fspath__ of a foreign object raises
        raise ArgumentError(argument, expected, type_and_value(value), str(failed)) from failed
    if not fits:
        raise ArgumentError(argument, expected, repr(value), "Is it empty, or does it contain a zero byte?")
    path = Path(text)
    if suffixes and path.suffix.lower() not in suffixes:
        raise ArgumentError(argument, f"a file name ending in {', '.join(suffixes)}", path)
    return path


def write_files(contents: Mapping[Path, str | bytes], argument: str = "path") -> None:
    """Write files, texts in UTF-8, and make their folders: all of them or none.

    Each file is written beside its place and moved there when all are complete, so a full disk or an interrupt leaves
    the existing files. Devices and pipes are written to directly. An error names the argument and the file.
    """
    drafts: dict[Path, Path] = {}
    made: list[Path] = []
    path = Path()
    try:
        for path, content in contents.items():
            data = content.encode() if isinstance(content, str) else content
            if path.exists() and not path.is_file():
                path.write_bytes(data)
                continue
            place = Path(os.path.realpath(path))  # a link is kept, and its target replaced
            if place.exists() and not os.access(place, os.W_OK):
                raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
            made += reversed([folder for folder in place.parents if not folder.exists()])
            place.parent.mkdir(parents=True, exist_ok=True)
            drafts[place] = draft = place.with_name(f".spm_pin_{secrets.token_hex(8)}")
            draft.write_bytes(data)
            if place.exists():
                shutil.copymode(place, draft)
        for path, draft in drafts.items():
            draft.replace(path)
        made.clear()
    except OSError as failed:
        raise ArgumentError(argument, "a file that can be written", path, str(failed.strerror)) from failed
    finally:
        for draft in drafts.values():
            draft.unlink(missing_ok=True)
        for folder in reversed(made):
            with contextlib.suppress(OSError):
                folder.rmdir()


_NUMBER = re.compile(r"[-+]?((0|[1-9]\d*)(\.\d*)?|\.\d+)([eE][-+]?\d+)?|[-+]?\.(inf|Inf|INF)", re.ASCII)
_LARGEST_FILE = 1 << 20
"""Largest number of characters of a file that is read."""


class _Loader(yaml.BaseLoader):
    """Reads mappings, lists, decimal numbers and texts. Tags have no effect, and a key may not occur twice."""

    anchored = 0
    """Number of nodes with an anchor around the one being read."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        # Aliases within anchored nodes multiply: a few of them can expand to billions of members.
        event = self.peek_event()  # type: ignore[no-untyped-call]
        is_alias = isinstance(event, yaml.AliasEvent)
        if is_alias and self.anchored:
            raise yaml.MarkedYAMLError(problem="an alias within an anchored node", problem_mark=event.start_mark)
        is_anchored = not is_alias and event.anchor is not None
        self.anchored += is_anchored
        node = super().compose_node(parent, index)
        self.anchored -= is_anchored
        return node

    def construct_scalar(self, node: yaml.ScalarNode) -> Any:
        text = super().construct_scalar(node)
        if node.style is None and text in ("", "~", "null"):
            return None
        is_number = node.style is None and _NUMBER.fullmatch(text)
        return float(text.lower().replace(".inf", "inf")) if is_number else text

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys: set[Any] = set()
        for entry, _ in node.value:
            key = self.construct_object(entry, deep=True)
            if isinstance(entry, yaml.ScalarNode) and key in keys:
                raise yaml.MarkedYAMLError(problem=f"the key {key!r} twice", problem_mark=entry.start_mark)
            keys |= {key} if isinstance(entry, yaml.ScalarNode) else set()
        return super().construct_mapping(node, deep)


def read_yaml(path: str | Path) -> Any:
    """Read a YAML file; numbers become floats, the rest texts, lists and mappings."""
    file = file_path(path)
    try:
        with file.open("rb") as opened:
            text = opened.read(_LARGEST_FILE + 1)
        if len(text) > _LARGEST_FILE:
            raise ArgumentError(
                "", f"a YAML file of at most {_LARGEST_FILE} characters", "a longer file", file=str(file)
            )
        return yaml.load(text.decode("utf-8"), _Loader)  # this loader constructs no objects
    except OSError as failed:
        raise ArgumentError("", "a readable YAML file", str(failed.strerror), file=str(file)) from failed
    except UnicodeDecodeError as failed:
        raise ArgumentError("", "a YAML file, text in UTF-8", str(failed), file=str(file)) from failed
    except ArgumentError:
        raise
    except Exception as failed:  # YAMLError; malformed escapes, tags and nesting raise other types too
        raise ArgumentError("", "a YAML file", str(failed) or type(failed).__name__, file=str(file)) from failed
