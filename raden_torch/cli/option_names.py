"""Messages of the library name its parameters; here they become the running command's options."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import typer.main

_PARAMETER = re.compile(r"`(\w+)(?:=\"?([^`\"]*)\"?)?`")


def options_of(app: typer.Typer, arguments: Sequence[str]) -> dict[str, str]:
    """Parameter → option of the subcommand that the arguments run, as assume → --assume.

    An angle's option may lack the unit that the parameter's name ends in: step_deg → --step.
    """
    command: Any = typer.main.get_command(app)
    for word in arguments:
        command = getattr(command, "commands", {}).get(word, command)
    longest = {p.name: max(p.opts, key=len) for p in command.params}
    names = {name: option for name, option in longest.items() if option.startswith("--")}
    return {f"{name}_deg": option for name, option in names.items()} | names


def with_options(message: str, options: Mapping[str, str]) -> str:
    """The message, its parameters in backticks replaced: `assume="isotropic"` → --assume isotropic.

    What is in backticks and no option of the command stays as it is.
    """

    def replaced(found: re.Match[str]) -> str:
        name, value = found.groups()
        if name not in options:
            return found[0]
        return options[name] if value is None else f"{options[name]} {value}"

    return _PARAMETER.sub(replaced, message)
