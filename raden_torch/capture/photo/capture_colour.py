"""Photographs of a chart → the camera's colour: what `raden capture colour` does."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.chart import Chart, Patches, draw_charts, read_patches
from raden_torch.capture.photo.chart_reference import reference_xyz
from raden_torch.capture.photo.chart_search import chart_at, find_charts
from raden_torch.capture.photo.checking_picture import captioned, picture_path
from raden_torch.capture.photo.colour import ColourCorrection, fit_colour, write_colour
from raden_torch.capture.photo.development import Development, developed
from raden_torch.capture.photo.exposures import Radiance
from raden_torch.capture.photo.photograph import Photograph, read_linear, read_stored, shown
from raden_torch.capture.photo.result_file import check_result_path
from raden_torch.errors import InputError
from raden_torch.images.mosaic import looks_like_mosaic, possible_patterns
from raden_torch.images.pixels import read_pixels, write_pixels
from raden_torch.images.raw import is_raw

PathLike = str | os.PathLike[str]


def capture_colour(
    paths: Sequence[PathLike],
    output: PathLike,
    *,
    development: Development | None = None,
    edition: str = "2014",
    corners: NDArray[Any] | None = None,
    picture: PathLike | None = None,
) -> str:
    """Find a colour chart in a photograph, or in an exposure stack of one view, and fit the map
    from the camera's RGB to XYZ.

    Args:
        corners: `[4, 2]` pixels of the chart's outer corners where it is not found by itself.
        picture: PNG of what was found; beside `output` unless given.

    Returns:
        A few lines for a person.

    Raises:
        InputError: no chart, and whatever the steps raise.
    """
    check_result_path(output)
    sheet_path = picture_path(picture, output)
    reference = reference_xyz(edition)
    how = development or Development()
    name = str(paths[0])
    photo, merged, patches, charts, how = _charted(paths, how, corners)
    correction, report = fit_colour(patches, reference, name)
    notes = [*report.notes]
    if charts[0].mirrored:
        notes.append("the chart is mirrored: the photograph is laterally reversed; turn it over")
    if len(charts) > 1:
        notes.append(f"{len(charts)} charts found; the largest is used")
    if _red_against_blue(patches, reference) < 0:
        notes.append("red and blue look exchanged: is it another Bayer pattern?")
    if how.pattern is not None:
        notes.append(f"Bayer pattern {how.pattern}")
    report = replace(report, notes=tuple(notes))
    write_colour(output, correction, report, charts[0], edition=edition, made_from=paths)
    sheet = np.concatenate(
        [
            draw_charts(shown(photo.linear), charts),
            _compared(correction, patches, reference, photo.size[1]),
        ]
    )
    caption = f"upper half: corrected, lower: the chart. {Path(name).name}"
    write_pixels(captioned(sheet, caption), sheet_path)
    lines = [_chart_line(chart) for chart in charts]
    if merged is not None and merged.linearity is not None:
        lines.append(str(merged.linearity))
    return "\n".join([*lines, str(report), f"wrote {output}", f"wrote {sheet_path}"])


def _charted(
    paths: Sequence[PathLike], how: Development, corners: NDArray[Any] | None
) -> tuple[Photograph, Radiance | None, Patches, list[Chart], Development]:
    """The photograph and its chart; a mosaic's red and blue are told apart by it."""
    if how.pattern is not None or (unknown := _untagged(paths[0])) is None:
        return *_found(paths, how, corners), how
    first, second = (replace(how, pattern=pattern) for pattern in unknown)
    try:
        found = _found(paths, first, corners)
    except InputError:  # a chart with red and blue exchanged may be none to the detector
        return *_found(paths, second, corners), second
    if _red_against_blue(found[2], reference_xyz()) > 0:
        return *found, first
    return *_found(paths, second, found[3][0].corners if corners is None else corners), second


def _found(
    paths: Sequence[PathLike], how: Development, corners: NDArray[Any] | None
) -> tuple[Photograph, Radiance | None, Patches, list[Chart]]:
    photo, merged = developed(paths, how)
    if len(paths) == 1 and photo.colour is None and photo.pattern is None:
        seen = read_stored(paths[0])  # the tone curve in it was made for looking
    else:
        seen = photo.seen
    name = str(paths[0])
    charts = find_charts(seen, name) if corners is None else [chart_at(seen, corners, name)]
    return photo, merged, read_patches(photo, charts[0]), charts


def _untagged(path: PathLike) -> tuple[str, str] | None:
    """The patterns that a mosaic without a CFA tag can have; None for anything else."""
    if Path(path).suffix.lower() in (".exr", ".hdr") or is_raw(path):
        return None
    stored = read_pixels(path, colour=False)
    if stored.ndim != 2 or not looks_like_mosaic(stored):
        return None
    try:
        read_linear(path)
    except InputError:
        return possible_patterns(stored)
    return None


def _red_against_blue(patches: Patches, reference: NDArray[Any]) -> float:
    """Correlation of red over blue in the photograph with that of the chart; −1…1."""
    from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix

    wanted = np.clip(reference @ xyz_to_rgb_matrix().T, 0.01, None)
    use = patches.usable & (patches.rgb > 0).all(axis=1)
    if use.sum() < 3:
        return 0.0
    seen, known = (np.log(rgb[use, 0] / rgb[use, 2]) for rgb in (patches.rgb, wanted))
    return float(np.corrcoef(seen, known)[0, 1])


def _compared(
    correction: ColourCorrection, patches: Patches, reference: NDArray[Any], width: int
) -> NDArray[np.uint8]:
    """The chart's patches as corrected (upper half) and as they should be (lower half)."""
    import cv2

    from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix

    found = correction.to_linear_srgb(patches.rgb)
    wanted = reference @ xyz_to_rgb_matrix().T
    both = np.clip(np.stack([found, wanted], 1), 0, 1).reshape(4, 6, 2, 3)
    small = both.transpose(0, 2, 1, 3).reshape(8, 6, 3)
    # the white patch shall stay below the brightest hundredth that `shown` clips
    coded = shown(np.concatenate([small, np.ones((1, 6, 3))]))[:-1]
    size = (width, max(8, round(width * 4 / 6 * 0.5)))
    return np.asarray(cv2.resize(coded, size, interpolation=cv2.INTER_NEAREST))


def _chart_line(chart: Chart) -> str:
    mirrored = ", mirrored" if chart.mirrored else ""
    x, y = chart.corners.mean(axis=0)
    return (
        f"chart at {x:.0f}, {y:.0f} px, turned by {chart.rotation_deg:.0f} deg{mirrored}, "
        f"patches of {chart.patch_px:.0f} px"
    )
