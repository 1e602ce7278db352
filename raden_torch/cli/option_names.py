"""Fields of dataclasses as options: `step_deg` is --step, also in the library's messages."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from cyclopts import default_name_transform

if TYPE_CHECKING:
    from cyclopts import App

_UNIT = re.compile(r"_(deg|px|mm|s|ev)$")
_SUBJECT = re.compile(r"^(\w+: )?(\w+)(?=: expected)")
_PARAMETER = re.compile(r"`(\w+)(?:=\"?([^`\"]*)\"?)?`")


def option_name(field: str) -> str:
    """The option without its hyphens; the unit that ends a field's name stands in the help."""
    return default_name_transform(_UNIT.sub("", field))


def options_of(app: App, arguments: Sequence[str]) -> dict[str, str]:
    """Field → option of the subcommand that the arguments run, as assume → --assume."""
    words = [word for word in arguments if not word.startswith("-")]  # --help is a command, too
    _, apps, _ = app.parse_commands(words)
    if apps[-1].default_command is None:
        return {}
    with app.app_stack(apps):
        found = apps[-1].assemble_argument_collection(parse_docstring=False)
    return {a.field_info.name: a.name for a in found if a.name.startswith("--")}


def with_options(message: str, options: Mapping[str, str]) -> str:
    """The message, its parameters replaced by the options of the command.

    A parameter stands in backticks, as `assume="isotropic"` → --assume isotropic, or is what the
    message is about: "shape: expected …" → "--shape: expected …". What is no option of the command
    stays as it is.
    """

    def replaced(found: re.Match[str]) -> str:
        name, value = found.groups()
        if name not in options:
            return found[0]
        return options[name] if value is None else f"{options[name]} {value}"

    def subject(found: re.Match[str]) -> str:
        before, name = found.groups()
        return f"{before or ''}{options.get(name, name)}"

    return _PARAMETER.sub(replaced, _SUBJECT.sub(subject, message))
