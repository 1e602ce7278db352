"""`load_measurement`: every measurement format behind one door, found by content."""

from __future__ import annotations

import os
from pathlib import Path

from raden_torch.capture.importers import (
    astm_e1392,
    fred,
    lighttools,
    rt300s,
    speos,
    zemax_bsdf,
)
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, native_csv

_FORMATS = (native_csv, rt300s, zemax_bsdf, fred, lighttools, speos, astm_e1392)
_HEAD_BYTES = 65_536


def recognises(head: bytes) -> bool:
    """Whether a file that begins with these bytes is of a format that `load_measurement` reads."""
    return any(fmt.recognises(head) for fmt in _FORMATS)


def load_measurement(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a measurement file; its format is found from its content, not from its name.

    Formats (each module says what its format holds and what it cannot hold):

    - the project's CSV (`raden_torch.measurement.native_csv`),
    - the `.xls` workbook of a J&C RT-300S goniometer (`rt300s`) and its exports for LightTools
      (`lighttools`) and SPEOS (`speos`),
    - Zemax's tabular BSDF (`zemax_bsdf`), FRED's tabulated BSDF (`fred`),
    - the text form of ASTM E1392 (`astm_e1392`).

    Raises:
        InputError: the file is missing, empty, of no known format, or wrong in itself; the message
            names the file, the line and column, and what would be right.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; a measurement file was wanted") from None
    if not head.strip():
        raise InputError(f"{path}: it is empty; a measurement file was wanted")
    for fmt in _FORMATS:
        if fmt.recognises(head):
            return fmt.read(path)
    raise InputError(
        f"{path}: no known measurement format; a CSV with the columns "
        "incidence_deg,receiving_deg,tilt_deg,X,Y,Z is one"
    )
