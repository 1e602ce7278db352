"""Reading the project's measurement CSV, here where the other formats (some need torch) are not."""

from __future__ import annotations

import os
from pathlib import Path

from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, native_csv

_HEAD_BYTES = 65_536


def load_csv(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """A measurement in the project's own format.

    Raises:
        InputError: it is missing, another format, or wrong in itself.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; a measurement CSV was wanted") from None
    if not native_csv.recognises(head):
        raise InputError(
            f"{path}: not the project's CSV; load it with raden_torch.load_measurement and save it"
        )
    return native_csv.read(path)
