"""Reading the project's measurement CSV, here where the other formats (some need torch) are not."""

from __future__ import annotations

import os
from pathlib import Path

from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, native_csv
from raden_torch.measurement.text_file import head_text, read_head


def load_csv(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """A measurement in the project's own format.

    Raises:
        InputError: it is missing, another format, or wrong in itself.
    """
    path = Path(path)
    if not native_csv.recognises(head_text(read_head(path, "a measurement CSV"))):
        raise InputError(
            f"{path}: not the project's CSV; load it with raden_torch.load_measurement and save it"
        )
    return native_csv.read(path)
