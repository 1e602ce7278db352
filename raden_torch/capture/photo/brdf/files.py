"""What `raden capture brdf` writes: the measurement, its report, its coverage map."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from raden_torch.capture.photo.checking_picture import picture_path
from raden_torch.errors import InputError
from raden_torch.files import check_writable

if TYPE_CHECKING:
    from raden_torch.capture.photo.capture_brdf import CapturedBrdf

PathLike = str | os.PathLike[str]


def check_outputs(output: Path, picture: PathLike | None) -> Path:
    """The picture's path; raises InputError where something could not be written."""
    if output.suffix.lower() != ".csv":
        raise InputError(f"{output}: measurements are .csv files; name one")
    check_writable(output)
    return picture_path(picture, output)


def write_captured(found: CapturedBrdf, output: Path, picture: Path) -> str:
    found.measurement.save(output)
    return f"wrote {output}"
