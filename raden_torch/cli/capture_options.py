"""Options that the steps of `raden capture` share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Group, Parameter

from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.capture.photo.development import Development

LightsFile = Annotated[Path, Parameter(help="lights file that `raden capture lights` wrote")]
Picture = Annotated[
    Path | None,
    Parameter(help="image of what was found, for checking; by default beside the result, as .png"),
]
Coded = Annotated[
    Literal["auto", "srgb", "linear"],
    Parameter(
        help="what stored values mean; auto: whole numbers are sRGB, floats and raw are linear"
    ),
]


@Parameter(name="*", group=Group("How photographs are read", sort_key=9))
@dataclass(frozen=True)
class DevelopmentOptions:
    """Files of a camera, and how they become linear light."""

    coded: Coded = "auto"
    pattern: str | None = None
    """Bayer pattern of a raw mosaic: RGGB, BGGR, GRBG, GBRG"""
    white_level: float | None = None
    """stored value at which the sensor saturates, as 4095"""
    exposure_s: tuple[float, ...] = ()
    """exposure time in seconds, for each file or each of a stack; by default from EXIF"""
    dark: tuple[Path, ...] = ()
    """frame with the lens covered; may be repeated"""
    dark_exposure_s: tuple[float, ...] = ()
    """exposure time in seconds of each dark frame; by default from EXIF"""
    flat: Path | None = None
    """flat field: photograph of an evenly lit white sheet"""
    response_file: Path | None = None
    """tone curve of the camera's 8-bit files, as `raden capture handheld` found it; before
    --coded"""

    @property
    def files(self) -> tuple[Path | None, ...]:
        """What is read beside the photographs."""
        return self.flat, self.response_file, *self.dark

    def development(self, *, response: bool = False) -> Development:
        """For the library; `response`: recover the response from the photographs."""
        from raden_torch.capture.photo.development import Development
        from raden_torch.capture.photo.handheld.response_fit import read_response

        if response and self.response_file is not None:
            raise InputError("--response and --response-file are two tone curves; give one")
        known = None if self.response_file is None else read_response(self.response_file)
        return Development(
            coded=self.coded if known is None else known,
            pattern=self.pattern,
            white_level=self.white_level,
            exposures_s=self.exposure_s,
            darks=self.dark,
            dark_exposures_s=self.dark_exposure_s,
            flat=self.flat,
            response=response,
        )
