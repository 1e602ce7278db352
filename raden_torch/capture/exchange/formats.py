"""The formats that are written: what each can hold, and which one a file name means."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from raden_torch.capture.exchange.scatter_grid import About
from raden_torch.errors import InputError


@dataclass(frozen=True)
class Format:
    """What a file of a format has room for.

    Attributes:
        title: the format in words.
        suffixes: of its files; the first is usual.
        xyz, rgb, bands: which colours it holds; one channel it always does, but for MERL's R, G, B.
        isotropic: it knows no azimuth of the sample.
        negative: it may hold values below 0.
        names: it has room for the sample's name.
        grid: the axis of its grid of directions; "cells" of MERL's; None of a list of readings.
        lost: what no file of it holds.
    """

    title: str
    suffixes: tuple[str, ...]
    xyz: bool = False
    rgb: bool = False
    bands: bool = False
    one: bool = True
    isotropic: bool = False
    negative: bool = False
    names: bool = True
    grid: About | Literal["cells"] | None = None
    lost: tuple[str, ...] = ()


FORMATS: dict[str, Format] = {
    "csv": Format("our CSV", (".csv",), xyz=True, rgb=True, bands=True, negative=True),
    "astm": Format("ASTM E1392", (".astm", ".txt"), xyz=True, rgb=True, bands=True, negative=True),
    "merl": Format(
        "MERL", (".binary",), rgb=True, one=False, isotropic=True, names=False, grid="cells"
    ),
    "zemax": Format(
        "Zemax", (".bsdf", ".txt"), xyz=True, grid="specular", lost=("digits beyond the ninth",)
    ),
    "lighttools": Format(
        "LightTools", (".bsdf", ".txt"), xyz=True, grid="normal", lost=("digits beyond the ninth",)
    ),
    "fred": Format(
        "FRED",
        (".txt",),
        isotropic=True,
        names=False,
        lost=("the wavelength", "digits beyond the ninth"),
    ),
    "speos": Format(
        "SPEOS", (".anisotropicbsdf", ".txt"), grid="normal", lost=("digits beyond the ninth",)
    ),
}
"""By the name that `to` takes."""


def format_of(path: Path, to: str | None) -> str:
    """The name of the format that a file is to be written in: `to`, or the only one of its suffix.

    Raises:
        InputError: no such format; a suffix of none, or of several.
    """
    if to is not None:
        if to not in FORMATS:
            raise InputError(f"to: expected one of {', '.join(FORMATS)}, got {to!r}")
        return to
    suffix = path.suffix.lower()
    found = [name for name, format_ in FORMATS.items() if suffix in format_.suffixes]
    if len(found) == 1:
        return found[0]
    if found:
        raise InputError(
            f"{path}: expected `to`, one of {', '.join(found)}, since all of them have files "
            f"{suffix}, got none"
        )
    known = ", ".join(f"{name} ({format_.suffixes[0]})" for name, format_ in FORMATS.items())
    raise InputError(
        f"{path}: expected a suffix of a format or `to`, one of {known}, got {suffix or 'none'}"
    )
