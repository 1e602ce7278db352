"""The one error that a user's input can cause."""

from __future__ import annotations


class InputError(ValueError):
    """Something given to the library is wrong.

    The message is one line: what is wrong, where (file, row, column; tensor, shape) and what would
    be right. The command line prints it and exits with 2.
    """


def check_type(name: str, value: object, kinds: type | tuple[type, ...], hint: str = "") -> None:
    """Refuse an argument of another type.

    Args:
        hint: what to call for the right one.

    Raises:
        InputError: `value` is of none of the kinds.
    """
    kinds = kinds if isinstance(kinds, tuple) else (kinds,)
    if not isinstance(value, kinds):
        wanted = " or ".join(kind.__name__ for kind in kinds)
        raise InputError(
            f"{name}: expected {wanted}, got {type(value).__name__}" + (f"; {hint}" if hint else "")
        )


def why(error: OSError) -> str:
    """What stands in a file's place, after "expected …, got"."""
    if isinstance(error, IsADirectoryError):
        return "a folder"
    return f"an error: {error.strerror}"
