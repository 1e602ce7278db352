"""A table of a TOML file as a command's arguments: `white_factor = 98.5` is --white-factor=98.5.

So that a table has the options of its command, no others, and the command checks their values.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from raden_torch.cli.option_names import option_name
from raden_torch.errors import InputError


def arguments_of(table: Mapping[str, Any], where: str) -> list[str]:
    """Options, in the table's order; a list repeats its option, false leaves it out.

    Args:
        where: the file and the table, for messages.

    Raises:
        InputError: a value that no option has, as a table or a date.
    """
    found = []
    for key, value in table.items():
        name = f"--{option_name(key)}"
        for each in value if isinstance(value, list) else [value]:
            if isinstance(each, bool):
                found += [name] if each else []
            elif isinstance(each, (str, int, float)):
                found.append(f"{name}={each}")
            else:
                raise InputError(
                    f"{where}: {key}: expected a text, a number, true or false, or a list of "
                    f"these, got {type(each).__name__}"
                )
    return found
