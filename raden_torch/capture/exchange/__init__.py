"""Files of other programs: `load_measurement` reads every format, detected by content.

A format is one module, with its reader and, where it is written, its writer; `conversion.py` above
makes of a measurement or a model what a writer asks for.
"""

from __future__ import annotations

import os
from pathlib import Path

from raden_torch.capture.exchange import (
    astm_e1392,
    fred,
    lighttools,
    lighttools_bsdf,
    merl,
    radiance_xml,
    rt300s,
    speos,
    speos_bsdf,
    tensor_file,
    zemax_bsdf,
)
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, native_csv
from raden_torch.measurement.text_file import head_in_words, head_text, read_head

_TEXT_FORMATS = (
    native_csv,
    lighttools_bsdf,
    zemax_bsdf,
    fred,
    lighttools,
    speos_bsdf,
    speos,
    astm_e1392,
    radiance_xml,
)
_BINARY_FORMATS = (rt300s, tensor_file, merl)


def recognises(head: bytes) -> bool:
    """Whether a file that begins with these bytes is of a format that `load_measurement` reads."""
    text = head_text(head)
    return any(fmt.recognises(head) for fmt in _BINARY_FORMATS) or any(
        fmt.recognises(text) for fmt in _TEXT_FORMATS
    )


def load_measurement(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a measurement file; its format is found from its content, not from its name.

    The file may be packed (gzip), and text in UTF-8, UTF-16, Shift-JIS or Windows-1252.

    Formats (each module says what its format holds and what it cannot hold):

    - the project's CSV (`raden_torch.measurement.native_csv`),
    - the `.xls` workbook of a J&C RT-300S goniometer (`rt300s`) and its exports for LightTools
      (`lighttools`) and SPEOS (`speos`),
    - Zemax's tabular BSDF (`zemax_bsdf`), FRED's tabulated BSDF (`fred`), LightTools'
      (`lighttools_bsdf`) and SPEOS' (`speos_bsdf`),
    - the text form of ASTM E1392 (`astm_e1392`),
    - MERL's table of an isotropic BRDF (`merl`),
    - WINDOW's and Radiance's XML (`radiance_xml`),
    - the tensor file of Mitsuba's and pbrt's measured BSDF (`tensor_file`).

    Raises:
        InputError: the file is missing, empty, of no known format, or wrong in itself; the message
            names the file, the line and column, and what would be right.

    Examples:
        >>> import raden_torch as rt
        >>> rt.simulate_specimen("akoya", step_deg=35).save("shell.csv")
        >>> rt.load_measurement("shell.csv")
        BrdfMeasurement(simulated 'akoya', 75 readings, 75 valid, channels X, Y, Z)
    """
    path = Path(path)
    head = read_head(path, "a measurement file")
    if not head.strip():
        raise InputError(f"{path}: expected a measurement file, got an empty one")
    text = head_text(head)
    for binary in _BINARY_FORMATS:
        if binary.recognises(head):
            return binary.read(path)
    for fmt in _TEXT_FORMATS:
        if fmt.recognises(text):
            return fmt.read(path)
    raise InputError(
        f"{path}: expected a measurement, as a CSV with the columns "
        f"incidence_deg,receiving_deg,tilt_deg,X,Y,Z, got {head_in_words(head)}"
    )
