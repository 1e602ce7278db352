"""A ColorChecker Classic in a photograph: where its patches are, and what they hold."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.photograph import Photograph

ROWS, COLUMNS = 4, 6
CORNERS = np.array([[0, 0], [COLUMNS, 0], [COLUMNS, ROWS], [0, ROWS]], np.float32)
"""Of the whole chart, in its own coordinates: a patch is 1 x 1."""

_MEASURED = 0.45
"""Share of the patches' pitch that is measured: a patch takes about 0.85; 0.45 is safe."""


@dataclass(frozen=True, eq=False)
class Chart:
    """A ColorChecker Classic, 4 rows of 6 patches, found in a photograph.

    Attributes:
        homography: `[3, 3]`, chart → pixels (x right, y down). In the chart, patch (row, column)
            covers [column, column + 1] x [row, row + 1]; dark skin is (0, 0), black is (3, 5).
        mirrored: the photograph shows it as in a mirror: it, and all that is measured in it, is
            laterally reversed.
        misfit: relative rms by which its colours differ from a chart's after the best linear map.
    """

    homography: Floats
    mirrored: bool
    misfit: float

    @cached_property
    def corners(self) -> Floats:
        """`[4, 2]` pixels: the chart's upper left, upper right, lower right and lower left."""
        return self.pixels(CORNERS)

    @property
    def rotation_deg(self) -> float:
        """How far the chart is turned clockwise in the picture, −180…180."""
        edge = self.corners[1] - self.corners[0]
        edge = edge * [-1, 1] if self.mirrored else edge
        return float(np.rad2deg(np.arctan2(edge[1], edge[0])))

    @property
    def patch_px(self) -> float:
        """Width of an average patch in pixels."""
        x, y = self.corners.T
        area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
        return float(np.sqrt(area / (ROWS * COLUMNS)))

    def pixels(self, points: NDArray[Any]) -> Floats:
        """`[…, 2]` chart coordinates → pixels."""
        flat = np.asarray(points, np.float64).reshape(-1, 2)
        mapped = np.c_[flat, np.ones(len(flat))] @ self.homography.T
        return (mapped[:, :2] / mapped[:, 2:]).reshape(np.shape(points))

    def squares(self, share: float = _MEASURED) -> Floats:
        """`[24, 4, 2]` pixels: the corners of the part of each patch that is measured."""
        half = share / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        return self.pixels(patch_centres()[:, None] + half)


@dataclass(frozen=True, eq=False)
class Patches:
    """What a photograph holds in a chart's 24 patches, in the order of `PATCH_NAMES`.

    Attributes:
        rgb: `[24, 3]` linear means, the outer tenths of each patch's values left out.
        spread: `[24, 3]` standard deviations within the patch.
        usable: `[24]`, false where a tenth of a patch or more is saturated.
        centres: `[24, 2]` pixels.
    """

    rgb: Floats
    spread: Floats
    usable: NDArray[np.bool_]
    centres: Floats


def read_patches(photo: Photograph, chart: Chart) -> Patches:
    """Measure a chart's patches in linear light."""
    from scipy.stats import trim_mean

    inner = (np.arange(21) / 20 - 0.5) * _MEASURED
    points = chart.pixels(
        patch_centres()[:, None] + np.stack(np.meshgrid(inner, inner), -1).reshape(1, -1, 2)
    )
    values = sampled(photo.linear, points)
    clipped = sampled(photo.saturated.astype(np.float32)[..., None], points)[..., 0]
    return Patches(
        np.asarray(trim_mean(values, 0.1, axis=1), np.float64),
        values.std(axis=1),
        (clipped > 0).mean(axis=1) < 0.1,
        chart.pixels(patch_centres()),
    )


def draw_charts(picture: NDArray[np.uint8], charts: list[Chart]) -> NDArray[np.uint8]:
    """The picture with the charts' frames, measured squares and patch numbers."""
    import cv2

    drawn = picture.copy()
    for chart in charts:
        thick = max(1, round(chart.patch_px / 40))
        frame = np.rint(chart.corners).astype(np.int32)
        cv2.polylines(drawn, [frame], True, (255, 255, 0), thick, cv2.LINE_AA)
        for i, square in enumerate(np.rint(chart.squares()).astype(np.int32)):
            cv2.polylines(drawn, [square], True, (0, 255, 0), thick, cv2.LINE_AA)
            if chart.patch_px > 24:
                at = (int(square[:, 0].min()), int(square[:, 1].max()))
                scale = chart.patch_px / 90
                for colour, width in (((0, 0, 0), 2 * thick + 1), ((255, 255, 255), thick)):
                    cv2.putText(drawn, str(i + 1), at, 0, scale, colour, width, cv2.LINE_AA)
    return drawn


def patch_centres() -> Floats:
    """`[24, 2]` in the chart's coordinates."""
    rows, columns = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
    return np.stack([columns + 0.5, rows + 0.5], -1)


def sampled(image: NDArray[Any], points: Floats) -> NDArray[Any]:
    """`[…, C]` bilinear values at pixel positions `[…, 2]`; the edge is continued."""
    import cv2

    flat = points.reshape(1, -1, 2).astype(np.float32)
    size = 30000  # below the 32767 columns that remap takes
    parts = [
        cv2.remap(
            image,
            flat[:, i : i + size],
            None,
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        for i in range(0, flat.shape[1], size)
    ]
    return np.concatenate(parts, axis=1).reshape(*points.shape[:-1], -1)
