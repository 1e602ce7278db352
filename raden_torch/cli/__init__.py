"""The `raden` command: one thin function a subcommand; the work is done in the library."""

from __future__ import annotations

import sys
import warnings

from raden_torch.cli import (  # noqa: F401 - importing them adds their subcommands
    capture,
    capture_brdf,
    model,
    picture,
    scan,
    simulated_photographs,
)
from raden_torch.cli.common import app
from raden_torch.errors import InputError


def main() -> None:
    """Run the command; anything wrong with the input is one line on stderr and exit code 2."""
    warnings.showwarning = _print_warning
    try:
        app()
    except InputError as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or 'file'}: {error.strerror or error}")
    except MemoryError:
        _fail("not enough memory; use a smaller --size")


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"raden: warning: {' '.join(str(message).split())}", file=sys.stderr)


def _fail(message: str) -> None:
    print(f"raden: {' '.join(message.split())}", file=sys.stderr)
    sys.exit(2)
