"""Where a ColorChecker Classic lies in a photograph, searched for or marked by hand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.chart import CORNERS, Chart, patch_centres
from raden_torch.capture.photo.chart_fit import oriented, refined
from raden_torch.errors import InputError

_SMALLEST_PX = 5.0
_WORKING_PX = 2400  # of the longer side: charts are looked for in nothing larger


def find_charts(picture: NDArray[np.uint8], name: str, *, most: int = 4) -> list[Chart]:
    """Find the charts in a picture, the largest first.

    Through OpenCV's `mcc` on the picture at several sizes and brightnesses; then each grid is moved
    until its patches are even, and turned to the one of its four orientations in which its colours
    are a chart's.

    Args:
        picture: `[H, W, 3]` RGB as a person would look at it (sRGB, 8 bits).
        name: of the photograph, for messages.
        most: charts to look for.

    Raises:
        InputError: no chart, or one that is cut by the frame, or too small.
    """
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise InputError(f"{name}: expected 8-bit RGB, got {picture.dtype} {list(picture.shape)}")
    import cv2

    scale = min(1.0, _WORKING_PX / max(picture.shape[:2]))
    if scale < 1:
        height, width = picture.shape[:2]
        size = round(width * scale), round(height * scale)
        charts = _search(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), name, most)
        grow = np.diag([width / size[0], height / size[1], 1.0])
        # pixel centres are whole numbers, so half a pixel comes and goes with the scale
        grow[:2, 2] = (np.diag(grow)[:2] - 1) / 2
        return [replace(chart, homography=grow @ chart.homography) for chart in charts]
    return _search(picture, name, most)


def _search(picture: NDArray[np.uint8], name: str, most: int) -> list[Chart]:
    cut = False
    for grids in _candidates(picture, most):
        charts: list[Chart] = []
        for grid in grids:
            chart = oriented(picture, refined(picture, grid))
            if chart is None or any(_overlap(chart, other) for other in charts):
                continue
            if not _inside(chart, picture.shape):
                cut = True
            elif chart.patch_px >= _SMALLEST_PX:
                charts.append(chart)
        if charts:
            return sorted(charts, key=lambda chart: -chart.patch_px)
    if cut:
        raise InputError(
            f"{name}: expected all 24 patches of the colour chart in the image, got a chart cut "
            "off by the frame"
        )
    raise InputError(
        f"{name}: expected a ColorChecker Classic (4 x 6 patches), whole, evenly lit, not "
        f"over-exposed, patches of {_SMALLEST_PX:.0f} pixels or more, got no colour chart; if it "
        "is in the image, give its four corners"
    )


def chart_at(picture: NDArray[np.uint8], corners: NDArray[Any], name: str) -> Chart:
    """The chart whose outer patches' corners were marked by hand.

    Args:
        corners: `[4, 2]` pixels, in order around the chart, starting anywhere.

    Raises:
        InputError: the colours within are no chart's, whichever way it is turned.
    """
    import cv2

    points = np.asarray(corners, np.float32)
    if points.shape != (4, 2) or not np.isfinite(points).all():
        raise InputError(f"{name}: corners: expected four points x,y, got {points.tolist()}")
    best: Chart | None = None
    for turn in range(4):
        grid = cv2.getPerspectiveTransform(CORNERS, np.roll(points, turn, axis=0))
        chart = oriented(picture, refined(picture, grid))
        if chart is not None and (best is None or chart.misfit < best.misfit):
            best = chart
    if best is None or not _inside(best, picture.shape):
        raise InputError(
            f"{name}: no chart's colours at the given corners; give the outer corners of the "
            "patches dark skin, bluish green, black and white"
        )
    return best


def _candidates(picture: NDArray[np.uint8], most: int) -> Iterator[list[Floats]]:
    """Grids `[3, 3]` (chart → pixels) that OpenCV proposes, one list for each way of looking."""
    import cv2

    longest = max(picture.shape[:2])
    base = min(1.0, 1600 / longest)
    for size in (1.0, 2.0, 0.5):
        for gamma in (1.0, 0.5):
            scale = base * size
            if longest * scale > 4000 or min(picture.shape[:2]) * scale < 60:
                continue
            how = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
            seen = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=how)
            if gamma != 1:  # dark photographs
                seen = np.rint(255 * (seen / 255.0) ** gamma).astype(np.uint8)
            yield _proposed(seen, picture.shape[1] / seen.shape[1], most)


def _proposed(seen: NDArray[np.uint8], scale: float, most: int) -> list[Floats]:
    import cv2

    # OpenCV 5; before it the chart's type was an argument of process()
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    detector.setUseDnnModel(False)
    try:
        if not detector.process(np.ascontiguousarray(seen[..., ::-1]), most):
            return []
    except cv2.error:
        return []
    grids = []
    for checker in detector.getListColorChecker():
        marked = np.asarray(checker.getColorCharts(), np.float64).reshape(-1, 4, 2).mean(axis=1)
        if marked.shape != (24, 2) or not np.isfinite(marked).all():
            continue
        # pixel centres are whole numbers, so half a pixel comes and goes with the scale
        grid, _ = cv2.findHomography(patch_centres(), (marked + 0.5) * scale - 0.5)
        if grid is not None and np.isfinite(grid).all():
            grids.append(np.asarray(grid, np.float64))
    return grids


def _inside(chart: Chart, shape: tuple[int, ...]) -> bool:
    squares = chart.squares()
    height, width = shape[:2]
    return bool((squares >= 0).all() and (squares <= [width - 1, height - 1]).all())


def _overlap(chart: Chart, other: Chart) -> bool:
    apart = np.linalg.norm(chart.corners.mean(axis=0) - other.corners.mean(axis=0))
    return bool(apart < 2 * max(chart.patch_px, other.patch_px))
