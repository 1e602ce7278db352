"""Node values relative to the white, in camera RGB → reflectance factors."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.photo_white import Scale
from raden_torch.capture.photo.colour import ColourCorrection, ColourFile, read_colour
from raden_torch.capture.photo.result_file import read_result
from raden_torch.images.raw_image import RawColour
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.measurement.readings import RGB, XYZ

_STEP = 1e-3


@dataclass(frozen=True, eq=False)
class NodeColour:
    """The map from what is relative to the white, channel by channel, to reflectance factors.

    With a colour correction M, R = R_w · M(u w) / M(w), where w is the white's colour under the
    mean lamp: differences between lamps are gone, and the white comes out as its own factor.
    Without one, u is taken as linear RGB that the white is neutral in.

    Attributes:
        correction: None for camera RGB.
        white_rgb: `[3]` the white under the mean lamp.
        white: `[3]` its reflectance factor, in `channels`.
        left_out_delta_e: mean ΔE2000 of the correction over left-out patches.
        channels: X, Y, Z or R, G, B.
    """

    correction: ColourCorrection | None
    white_rgb: Floats
    white: Floats
    left_out_delta_e: float
    channels: tuple[str, ...]

    @classmethod
    def of(cls, path: Path | None, scale: Scale, own: RawColour | None = None) -> NodeColour:
        """From a colour file; without one, from what raw files say of their colours.

        Raises:
            InputError: not such a file.
        """
        if path is None and own is not None:
            to_xyz = np.linalg.inv(xyz_to_rgb_matrix()) @ own.to_srgb
            correction = ColourCorrection("least squares", to_xyz)
            return cls(correction, scale.mean_rgb, scale.xyz, 0.0, XYZ)
        if path is None:
            rgb = scale.xyz @ xyz_to_rgb_matrix().T
            return cls(None, scale.mean_rgb, rgb, 0.0, RGB)
        correction = read_colour(path)
        said = read_result(path, "colour", ColourFile).left_out_delta_e_2000
        mean = said[correction.method].mean if correction.method in said else 0.0
        return cls(correction, scale.mean_rgb, scale.xyz, mean, XYZ)

    def factors(self, relative: Floats) -> Floats:
        """`[M, 3]` relative to the white → reflectance factors; NaN stays."""
        if self.correction is None:
            return np.asarray(relative * self.white)
        rgb = np.nan_to_num(relative) * self.white_rgb
        if self.correction.method != "least squares":
            rgb = np.maximum(rgb, 0)  # roots
        xyz = self.correction.to_xyz(rgb).astype(np.float64)
        white = self.correction.to_xyz(self.white_rgb[None]).astype(np.float64)
        return np.where(
            np.isnan(relative).any(axis=1, keepdims=True), np.nan, self.white * xyz / white
        )

    def slopes(self, relative: Floats) -> Floats:
        """`[M, 3, 3]`: the change of each factor with each channel."""
        step = np.maximum(_STEP * abs(relative), 1e-6)
        columns = [
            (
                self.factors(relative + step * np.eye(3)[c])
                - self.factors(relative - step * np.eye(3)[c])
            )
            / (2 * step[:, c : c + 1])
            for c in range(3)
        ]
        return np.stack(columns, axis=2)
