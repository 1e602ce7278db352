"""The steps of `raden capture`: photographs in; a result file and a picture to check it by out."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.capture.photo.board import Board, BoardView, draw_board, find_board
from raden_torch.capture.photo.camera import (
    Calibration,
    Pose,
    board_pose,
    calibrate,
    read_camera,
    write_camera,
)
from raden_torch.capture.photo.chart import (
    Chart,
    Patches,
    chart_at,
    draw_charts,
    find_charts,
    read_patches,
    reference_xyz,
)
from raden_torch.capture.photo.colour import ColourCorrection, fit_colour, write_colour
from raden_torch.capture.photo.exposures import (
    Radiance,
    flat_field,
    flatten,
    merge_exposures,
    recover_response,
    subtract_dark,
)
from raden_torch.capture.photo.mosaic import looks_like_mosaic, possible_patterns
from raden_torch.capture.photo.photograph import (
    Coding,
    Photograph,
    check_same_size,
    read_linear,
    read_stored,
    shown,
)
from raden_torch.capture.photo.result_file import check_result_path
from raden_torch.errors import InputError
from raden_torch.files import check_writable
from raden_torch.images.pixels import draw_caption, read_pixels, write_pixels

PathLike = str | os.PathLike[str]
_SHEET_PX = 640
_OVER = 0.5


@dataclass(frozen=True)
class Development:
    """How a step reads its photographs; the arguments are those of `read_linear`.

    Attributes:
        exposures_s: one for each photograph, or empty for what EXIF says.
        darks, flat: frames taken with the lens covered, and of an evenly lit white sheet.
        dark_exposures_s: one for each dark frame, or empty for what EXIF says.
        response: recover the response from the photographs, which are an exposure stack.
    """

    coded: Coding = "auto"
    pattern: str | None = None
    white_level: float | None = None
    exposures_s: tuple[float, ...] = ()
    darks: tuple[Path, ...] = ()
    dark_exposures_s: tuple[float, ...] = ()
    flat: Path | None = None
    response: bool = False


def calibrate_photographs(
    paths: Sequence[PathLike],
    board: Board,
    output: PathLike,
    *,
    camera: PathLike | None = None,
    picture: PathLike | None = None,
) -> str:
    """Find the board in photographs, calibrate the camera or take a known one, write both.

    Photographs without a board are named in a warning and left out.

    Args:
        camera: a camera file: only the board's poses are looked for then.
        picture: PNG of what was found; beside `output` unless given.

    Returns:
        A few lines for a person.

    Raises:
        InputError: too few photographs with a board, and whatever the steps raise.
    """
    check_result_path(output)
    sheet_path = _picture_path(picture, output)
    known = None if camera is None else read_camera(camera)
    views, frames = _views(paths, board, enough=3 if known is None else 1)
    calibration: Calibration | None = None
    poses: Sequence[Pose]
    if known is None:
        calibration = calibrate(views)
        known, poses = calibration.camera, calibration.poses
    else:
        poses = [board_pose(view, known) for view in views]
    frames = [
        _captioned(frame, f"{Path(view.name).name}: {pose.corners} corners, {pose.rms_px:.2f} px")
        for frame, view, pose in zip(frames, views, poses, strict=True)
    ]
    write_camera(output, known, views, poses, calibration=calibration, made_from=paths)
    write_pixels(_sheet(frames), sheet_path)
    lines = [
        f"{Path(view.name).name}: {pose.corners} corners, re-projection rms {pose.rms_px:.3f} px, "
        f"board at {np.linalg.norm(pose.translation_m):.3f} m"
        for view, pose in zip(views, poses, strict=True)
    ]
    if calibration is not None:
        focal = np.diag(known.matrix)[:2]
        lines += [
            f"camera: focal lengths {focal[0]:.1f} ± {calibration.focal_std_px[0]:.1f} and "
            f"{focal[1]:.1f} ± {calibration.focal_std_px[1]:.1f} px, "
            f"re-projection rms {calibration.rms_px:.3f} px",
            *(f"note: {note}" for note in calibration.notes),
        ]
    return "\n".join([*lines, f"wrote {output}", f"wrote {sheet_path}"])


def colour_of_photographs(
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
    sheet_path = _picture_path(picture, output)
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
    write_pixels(_captioned(sheet, caption), sheet_path)
    lines = [_chart_line(chart) for chart in charts]
    if merged is not None and merged.linearity is not None:
        lines.append(str(merged.linearity))
    return "\n".join([*lines, str(report), f"wrote {output}", f"wrote {sheet_path}"])


def developed(
    paths: Sequence[PathLike], how: Development | None = None
) -> tuple[Photograph, Radiance | None]:
    """One photograph in linear light; several as an exposure stack, merged.

    Dark frames are subtracted and the flat field divided by. A merged stack has the unit white
    levels per second; pixels saturated in every exposure are marked.

    Raises:
        InputError: whatever reading, correcting and merging raise; over-exposed all over.
    """
    how = how or Development()
    times = _times(paths, how.exposures_s, "photographs")
    if how.response:
        how = replace(how, coded=recover_response(paths, _stated(paths, times)), response=False)
    photos = [_read(path, how, t) for path, t in zip(paths, times, strict=True)]
    check_same_size(photos)
    dark_times = _times(how.darks, how.dark_exposures_s, "dark frames")
    darks = [_read(path, how, t) for path, t in zip(how.darks, dark_times, strict=True)]
    if darks:
        photos = [subtract_dark(photo, darks) for photo in photos]
    if how.flat is not None:
        flat = _read(how.flat, how, None)
        matching = [dark for dark in darks if dark.exposure_s in (None, flat.exposure_s)]
        share = flat_field(subtract_dark(flat, matching) if matching else flat)
        photos = [flatten(photo, share) for photo in photos]
    if len(photos) > 1:
        merged = merge_exposures(photos)
        return (
            replace(
                photos[0],
                linear=merged.radiance,
                saturated=~merged.valid,
                rounding=np.where(np.isfinite(merged.sigma), merged.sigma, 0),
                bits=None,
                exposure_s=None,
            ),
            merged,
        )
    if photos[0].saturated.mean() > _OVER:
        raise InputError(
            f"{photos[0].path}: over-exposed, {100 * photos[0].saturated.mean():.0f} % of it is "
            "saturated; expose less"
        )
    return photos[0], None


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
    if len(paths) == 1 and photo.pattern is None:
        seen = read_stored(paths[0])  # the tone curve in it was made for looking
    else:
        seen = shown(photo.linear)
    name = str(paths[0])
    charts = find_charts(seen, name) if corners is None else [chart_at(seen, corners, name)]
    return photo, merged, read_patches(photo, charts[0]), charts


def _untagged(path: PathLike) -> tuple[str, str] | None:
    """The patterns that a mosaic without a CFA tag can have; None for anything else."""
    if Path(path).suffix.lower() in (".exr", ".hdr"):
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


def _read(path: PathLike, how: Development, exposure_s: float | None) -> Photograph:
    return read_linear(
        path,
        coded=how.coded,
        pattern=how.pattern,
        white_level=how.white_level,
        exposure_s=exposure_s,
    )


def _times(paths: Sequence[PathLike], stated: Sequence[float], what: str) -> Sequence[float | None]:
    if stated and len(stated) != len(paths):
        raise InputError(
            f"{len(paths)} {what} and {len(stated)} exposure times; as many times as {what}, or "
            "none, were wanted"
        )
    return stated or [None] * len(paths)


def _stated(paths: Sequence[PathLike], times: Sequence[float | None]) -> list[float]:
    found = []
    for path, stated in zip(paths, times, strict=True):
        seconds = read_linear(path).exposure_s if stated is None else stated
        if seconds is None:
            raise InputError(f"{path}: no exposure time in its EXIF; state it for each photograph")
        found.append(seconds)
    return found


def _views(
    paths: Sequence[PathLike], board: Board, *, enough: int
) -> tuple[list[BoardView], list[NDArray[np.uint8]]]:
    """The boards found, and a small picture of each; what is missing is warned of."""
    views: list[BoardView] = []
    frames: list[NDArray[np.uint8]] = []
    wrong: list[str] = []
    for path in _progress(paths, "looking for the board"):
        picture = read_stored(path)
        try:
            view = find_board(picture, board, str(path))
        except InputError as error:
            wrong.append(str(error))
            continue
        if view.board.legacy is not None:
            board = view.board  # one board in all
        views.append(view)
        frames.append(_small(draw_board(picture, view)))
    if len(views) < enough:
        raise InputError(
            f"{len(views)} of {len(paths)} photographs show the board; at least {enough} were "
            f"wanted. {'; '.join(wrong[:3])}".strip()
        )
    for message in wrong:
        warnings.warn(f"left out: {message}", stacklevel=3)
    return views, frames


def _progress(paths: Sequence[PathLike], what: str) -> Iterable[PathLike]:
    from rich.console import Console
    from rich.progress import track

    return track(paths, what, console=Console(stderr=True), transient=True)


def _picture_path(picture: PathLike | None, output: PathLike) -> Path:
    path = Path(output).with_suffix(".png") if picture is None else Path(picture)
    if path.suffix.lower() not in (".png", ".jpg", ".jpeg"):
        raise InputError(f"{path}: the picture goes into a .png or .jpg file")
    return check_writable(path)


def _small(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    scale = _SHEET_PX / max(picture.shape[:2])
    if scale >= 1:
        return picture
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _captioned(picture: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    strip = np.zeros((20, picture.shape[1], 3), np.uint8)
    draw_caption(strip, text.encode("ascii", "replace").decode())
    return np.concatenate([picture, strip])


def _sheet(frames: Sequence[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Pictures side by side, in rows."""
    columns = int(np.ceil(np.sqrt(len(frames))))
    height, width = (max(frame.shape[i] for frame in frames) for i in (0, 1))
    rows = -(-len(frames) // columns)
    sheet = np.full((rows * height, columns * width, 3), 40, np.uint8)
    for i, frame in enumerate(frames):
        y, x = (i // columns) * height, (i % columns) * width
        sheet[y : y + frame.shape[0], x : x + frame.shape[1]] = frame
    return sheet


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
