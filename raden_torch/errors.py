"""The one error that a user's input can cause."""

from __future__ import annotations


class InputError(ValueError):
    """Something given to the library is wrong.

    The message is one line: what is wrong, where (file, row, column; tensor, shape) and what would
    be right. The command line prints it and exits with 2.
    """
