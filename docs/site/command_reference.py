"""The reference of the command line, made from the commands themselves: their help, options, types and defaults."""

from __future__ import annotations

import enum
import re
from collections.abc import Iterator
from typing import Any, get_args

from typer.main import get_command

from spm_pin.cli.application import app


def command_reference() -> str:
    """Return the page: a section of each command, with a row for each of its options."""
    exit_codes = "[Exit codes](../howto/command_line.md#exit-codes) are those of all commands."
    lines = ["# Commands", "", "[How to use them](../howto/command_line.md), with the extras that some need."]
    lines += [exit_codes, ""]
    for name, command in _commands(get_command(app)):
        arguments = " ".join(_typed(parameter) for parameter in command.params if parameter.param_type_name != "option")
        lines += [f"## {name}", "", f"`spm-pin {name}{' ' * bool(arguments)}{arguments} [OPTIONS]`", ""]
        lines += [_text(command.help or ""), "", "| | what it is | default |", "|---|---|---|"]
        lines += [_row(parameter) for parameter in command.params if parameter.name != "help"]
        lines.append("")
    return "\n".join(lines)


def _commands(group: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the commands of a group and of the groups in it, with what is typed for them."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from _commands(command, f"{before}{name} ")
        else:
            yield f"{before}{name}", command


def _typed(parameter: Any) -> str:
    """Return what a user types for a parameter: names of an option, and its value."""
    kind = parameter.metavar if parameter.metavar is not None else _kind(parameter.type_descriptor.annotation)
    if getattr(parameter, "is_flag", False):
        kind = ""
    if parameter.param_type_name != "option":
        return str(kind)
    names = ", ".join([*parameter.opts, *parameter.secondary_opts])
    return f"{names} {kind}".strip()


def _kind(annotation: Any) -> str:
    """Return the values that an option without a name for them takes."""
    (kind, *_) = [part for part in get_args(annotation) if part is not type(None)] or [annotation]
    if isinstance(kind, str):
        return "\\|".join(get_args(annotation))
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        return "\\|".join(str(value) for value in kind)
    return {float: "X", int: "N"}.get(kind, "TEXT")


def _row(parameter: Any) -> str:
    default = parameter.default
    if parameter.required:
        shown = "required"
    elif default is None or callable(default) or default is False or default == ():
        shown = ""
    else:
        values = default if isinstance(default, tuple | list) else [default]
        shown = "`" + " ".join(str(value) for value in values) + "`"
    return f"| `{_typed(parameter)}` | {_text(parameter.help or '').replace('|', chr(92) + '|')} | {shown} |"


def _text(text: str) -> str:
    """Return a help text as Markdown: commands and options as code, units in plain brackets."""
    text = text.replace("\\[", "[")
    text = re.sub(r"(Example[^:\n]*: )([^\n]*)", r"\1`\2`", text)
    parts = re.split(r"(`[^`]*`)", text)
    parts[::2] = [re.sub(r"(?<![\w-])(--[a-z][\w-]*)", r"`\1`", part.replace("*", "\\*")) for part in parts[::2]]
    return "".join(parts).replace("[", "\\[")
