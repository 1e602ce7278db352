"""Where a ColorChecker Classic lies in a photograph, which way round, and what its patches hold."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.photograph import Photograph
from raden_torch.errors import InputError
from raden_torch.images.colour_space import srgb_curve

ROWS, COLUMNS = 4, 6
PATCH_NAMES = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green",
    "orange", "purplish blue", "moderate red", "purple", "yellow green", "orange yellow",
    "blue", "green", "red", "yellow", "magenta", "cyan",
    "white 9.5", "neutral 8", "neutral 6.5", "neutral 5", "neutral 3.5", "black 2",
)  # fmt: skip
NEUTRAL = range(18, 24)

_WIDE, _MEASURED = 0.78, 0.45
"""Shares of the patches' pitch: a patch takes about 0.85; 0.45 is safe to measure in."""
_NO_CHART, _CLEARLY = 0.45, 0.75
"""Colours that deviate more than the first from the chart's after the best linear map, or not less
than the second times those of any other orientation, are no chart's. (Right ones leave 0.03 to
0.15, and 0.41 in a photograph with a steep tone curve; turned the wrong way they leave 0.55.)"""
_SMALLEST_PX = 5.0
_WORKING_PX = 2400  # of the longer side: charts are looked for in nothing larger


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
        return self.pixels(np.array([[0, 0], [COLUMNS, 0], [COLUMNS, ROWS], [0, ROWS]]))

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
        return self.pixels(_centres()[:, None] + half)


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
            chart = _oriented(picture, _refined(picture, grid))
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
    square = np.array([[0, 0], [COLUMNS, 0], [COLUMNS, ROWS], [0, ROWS]], np.float32)
    best: Chart | None = None
    for turn in range(4):
        grid = cv2.getPerspectiveTransform(square, np.roll(points, turn, axis=0))
        chart = _oriented(picture, _refined(picture, grid))
        if chart is not None and (best is None or chart.misfit < best.misfit):
            best = chart
    if best is None or not _inside(best, picture.shape):
        raise InputError(
            f"{name}: no chart's colours at the given corners; give the outer corners of the "
            "patches dark skin, bluish green, black and white"
        )
    return best


def read_patches(photo: Photograph, chart: Chart) -> Patches:
    """Measure a chart's patches in linear light."""
    from scipy.stats import trim_mean

    inner = (np.arange(21) / 20 - 0.5) * _MEASURED
    points = chart.pixels(
        _centres()[:, None] + np.stack(np.meshgrid(inner, inner), -1).reshape(1, -1, 2)
    )
    values = _sampled(photo.linear, points)
    clipped = _sampled(photo.saturated.astype(np.float32)[..., None], points)[..., 0]
    return Patches(
        np.asarray(trim_mean(values, 0.1, axis=1), np.float64),
        values.std(axis=1),
        (clipped > 0).mean(axis=1) < 0.1,
        chart.pixels(_centres()),
    )


def reference_xyz(edition: str = "2014") -> Floats:
    """`[24, 3]` CIE 1931 2° XYZ of the patches under D65, the perfect diffuser's Y being 1.

    X-Rite's published values under D50, through colour-science, adapted by the Bradford transform.

    Args:
        edition: "2014" for charts made after November 2014, "2005" for older ones.

    Raises:
        InputError: another edition.
    """
    import colour

    names = {
        "2014": "ColorChecker24 - After November 2014",
        "2005": "ColorChecker24 - Before November 2014",
    }
    if edition not in names:
        raise InputError(f"chart edition: expected {' or '.join(names)}, got {edition!r}")
    reference = colour.CCS_COLOURCHECKERS[names[edition]]
    xyz = colour.xyY_to_XYZ(np.array(list(reference.data.values())))
    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    source, target = (
        colour.xy_to_XYZ(xy) for xy in (np.asarray(reference.illuminant), np.asarray(white))
    )
    adapted = colour.adaptation.chromatic_adaptation_VonKries(
        xyz, source, target, transform="Bradford"
    )
    return np.asarray(adapted, np.float64)


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


def _centres() -> Floats:
    rows, columns = np.divmod(np.arange(ROWS * COLUMNS), COLUMNS)
    return np.stack([columns + 0.5, rows + 0.5], -1)


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
        grid, _ = cv2.findHomography(_centres(), (marked + 0.5) * scale - 0.5)
        if grid is not None and np.isfinite(grid).all():
            grids.append(np.asarray(grid, np.float64))
    return grids


def _sampled(image: NDArray[Any], points: Floats) -> NDArray[Any]:
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


def _refined(picture: NDArray[np.uint8], grid: Floats) -> Floats:
    """The grid moved until each patch is as even as it gets."""
    import cv2
    from scipy.optimize import minimize

    inner = (np.arange(7) / 6 - 0.5) * _WIDE
    inside = _centres()[:, None] + np.stack(np.meshgrid(inner, inner), -1).reshape(1, -1, 2)
    square = np.array([[0, 0], [COLUMNS, 0], [COLUMNS, ROWS], [0, ROWS]], np.float32)
    start = Chart(grid, False, 0.0).corners
    pitch = Chart(grid, False, 0.0).patch_px
    if not 1 < pitch < 1e4:
        return grid
    # a step of the search should see a whole edge
    soft = cv2.GaussianBlur(picture, (0, 0), max(0.06 * pitch, 0.3))

    def moved(offsets: Floats) -> Floats:
        corners = (start + 0.15 * pitch * offsets.reshape(4, 2)).astype(np.float32)
        return np.asarray(cv2.getPerspectiveTransform(square, corners), np.float64)

    def unevenness(offsets: Floats) -> float:
        points = Chart(moved(offsets), False, 0.0).pixels(inside)
        values = _sampled(soft, points).astype(np.float32)
        centre = np.median(values, axis=1, keepdims=True)
        return float(np.abs(values - centre).mean()) + 0.05 * float((offsets**2).mean())

    found = minimize(
        unevenness, np.zeros(8), method="Powell", options={"maxiter": 6, "xtol": 0.02, "ftol": 1e-3}
    )
    return moved(found.x) if found.fun < unevenness(np.zeros(8)) else grid


def _oriented(picture: NDArray[np.uint8], grid: Floats) -> Chart | None:
    """The chart, turned and mirrored so that its colours are those of a ColorChecker."""
    points = Chart(grid, False, 0.0).pixels(_centres())
    around = np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]])
    spots = _sampled(picture, points[:, None] + around).astype(np.float64)
    rgb = srgb_curve(np.median(spots, axis=1) / 255).reshape(ROWS, COLUMNS, 3)
    wanted = reference_xyz()
    found = []
    for mirror in (False, True):
        for half_turn in (False, True):
            seen = rgb[:, ::-1] if mirror else rgb
            seen = seen[::-1, ::-1] if half_turn else seen
            turn = np.eye(3)
            if half_turn:
                turn = np.array([[-1, 0, COLUMNS], [0, -1, ROWS], [0, 0, 1]]) @ turn
            if mirror:
                turn = np.array([[-1, 0, COLUMNS], [0, 1, 0], [0, 0, 1]]) @ turn
            placed = grid @ turn
            misfit = _misfit(seen.reshape(-1, 3), wanted)
            found.append(Chart(placed / placed[2, 2], _reverses(placed), misfit))
    best, second = sorted(found, key=lambda chart: chart.misfit)[:2]
    return best if best.misfit < min(_NO_CHART, _CLEARLY * second.misfit) else None


def _misfit(rgb: Floats, xyz: Floats) -> float:
    """Relative rms that the best linear map leaves; weighted so that dark patches count."""
    weight = 1 / (xyz[:, 1:2] + 0.1)
    # a chart that is lit from one side still has its colours
    columns, rows = (_centres() / [COLUMNS, ROWS] - 0.5).T
    best = np.inf
    for lean_x in (-0.3, 0.0, 0.3):
        for lean_y in (-0.3, 0.0, 0.3):
            even = rgb / (1 + lean_x * columns + lean_y * rows)[:, None]
            matrix, *_ = np.linalg.lstsq(weight * even, weight * xyz, rcond=None)
            left = weight * (even @ matrix - xyz)
            best = min(best, float(np.sqrt((left**2).sum() / ((weight * xyz) ** 2).sum())))
    return best


def _reverses(grid: Floats) -> bool:
    """Whether going around the chart clockwise is going around it counter-clockwise in pixels."""
    x, y = Chart(grid, False, 0.0).corners.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) < 0


def _inside(chart: Chart, shape: tuple[int, ...]) -> bool:
    squares = chart.squares()
    height, width = shape[:2]
    return bool((squares >= 0).all() and (squares <= [width - 1, height - 1]).all())


def _overlap(chart: Chart, other: Chart) -> bool:
    apart = np.linalg.norm(chart.corners.mean(axis=0) - other.corners.mean(axis=0))
    return bool(apart < 2 * max(chart.patch_px, other.patch_px))
