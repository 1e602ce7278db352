"""A grid that may be a chart → moved until its patches are even, and turned by its colours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.chart import COLUMNS, CORNERS, ROWS, Chart, patch_centres, sampled
from raden_torch.capture.photo.chart_reference import reference_xyz
from raden_torch.images.colour_space import srgb_curve

_WIDE = 0.78
"""Share of the patches' pitch that should be even."""
_NO_CHART, _CLEARLY = 0.45, 0.75
"""Colours that deviate more than the first from the chart's after the best linear map, or not less
than the second times those of any other orientation, are no chart's. (Right ones leave 0.03 to
0.15, and 0.41 in a photograph with a steep tone curve; turned the wrong way they leave 0.55.)"""


def refined(picture: NDArray[np.uint8], grid: Floats) -> Floats:
    """The grid moved until each patch is as even as it gets."""
    import cv2
    from scipy.optimize import minimize

    inner = (np.arange(7) / 6 - 0.5) * _WIDE
    inside = patch_centres()[:, None] + np.stack(np.meshgrid(inner, inner), -1).reshape(1, -1, 2)
    start = Chart(grid, False, 0.0).corners
    pitch = Chart(grid, False, 0.0).patch_px
    if not 1 < pitch < 1e4:
        return grid
    # a step of the search should see a whole edge
    soft = cv2.GaussianBlur(picture, (0, 0), max(0.06 * pitch, 0.3))

    def moved(offsets: Floats) -> Floats:
        corners = (start + 0.15 * pitch * offsets.reshape(4, 2)).astype(np.float32)
        return np.asarray(cv2.getPerspectiveTransform(CORNERS, corners), np.float64)

    def unevenness(offsets: Floats) -> float:
        points = Chart(moved(offsets), False, 0.0).pixels(inside)
        values = sampled(soft, points).astype(np.float32)
        centre = np.median(values, axis=1, keepdims=True)
        return float(np.abs(values - centre).mean()) + 0.05 * float((offsets**2).mean())

    found = minimize(
        unevenness, np.zeros(8), method="Powell", options={"maxiter": 6, "xtol": 0.02, "ftol": 1e-3}
    )
    return moved(found.x) if found.fun < unevenness(np.zeros(8)) else grid


def oriented(picture: NDArray[np.uint8], grid: Floats) -> Chart | None:
    """The chart, turned and mirrored so that its colours are those of a ColorChecker."""
    points = Chart(grid, False, 0.0).pixels(patch_centres())
    around = np.array([[0, 0], [1, 0], [0, 1], [-1, 0], [0, -1]])
    spots = sampled(picture, points[:, None] + around).astype(np.float64)
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
    columns, rows = (patch_centres() / [COLUMNS, ROWS] - 0.5).T
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
