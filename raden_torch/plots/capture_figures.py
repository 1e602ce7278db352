"""Figures for checking the results of `raden capture`: lamps on a dial, normals as a sheet."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from raden_torch.capture.photo.ball import Ball
from raden_torch.capture.photo.highlight import Highlight
from raden_torch.capture.photo.lamps import Lamps
from raden_torch.capture.photo.photo_set import PhotoSet
from raden_torch.capture.photo.photometric_stereo import SurfaceNormals
from raden_torch.plots.plot_style import FAINT, INK, SMALL, TEXT, printable

_BALL, _LAMP, _BAD = "#0072b2", "#d55e00", "#a3271f"
_DPI = 110
_OF_LIGHT = "a pixel's mean light\nover all lamps"


def draw_lamps(
    photos: PhotoSet,
    balls: Sequence[Ball],
    highlights: Sequence[Sequence[Highlight]],
    lamps: Lamps,
) -> Figure:
    """The balls and the lamps' images in them; the directions to the lamps on a dial."""
    figure = _sheet(11.5, 6.2)
    grid = figure.add_gridspec(1, 2, width_ratios=(1.15, 1))
    ax = figure.add_subplot(grid[0])
    brightest = photos.images.amax(dim=0).clamp(0, 1).movedim(0, -1).numpy()
    ax.imshow(brightest ** (1 / 2.2))
    turn = np.linspace(0, 2 * np.pi, 200)
    for b, ball in enumerate(balls):
        x, y, r = ball.x_px, ball.y_px, ball.radius_px
        ax.plot(x + r * np.cos(turn), y + r * np.sin(turn), color=_BALL, linewidth=1)
        ax.plot(x, y, "+", color=_BALL)
        reach = [row[b] for row in highlights]
        ax.scatter([h.x_px for h in reach], [h.y_px for h in reach], s=14, c=_LAMP, marker="x")
        middle = np.mean([(h.x_px, h.y_px) for h in reach], axis=0)
        for k, h in enumerate(reach):
            away = np.array([h.x_px, h.y_px]) - middle  # outwards, lest the numbers lie on others
            away = away / max(float(np.hypot(*away)), 1e-6)
            ax.annotate(
                str(k + 1),
                (h.x_px, h.y_px),
                xytext=(10 * away[0], -10 * away[1]),
                textcoords="offset points",
                ha="center",
                va="center",
                fontsize=SMALL,
                color="#ffe08a",
                path_effects=[withStroke(linewidth=2.5, foreground="black")],
            )
    around = 1.15 * max(ball.radius_px for ball in balls)
    ax.set_xlim(min(b.x_px for b in balls) - around, max(b.x_px for b in balls) + around)
    ax.set_ylim(max(b.y_px for b in balls) + around, min(b.y_px for b in balls) - around)
    ax.set_title("The balls, and the lamps' images in them (brightest of all)", fontsize=TEXT + 1)
    ax.set_xlabel("x (pixels)", fontsize=SMALL)
    ax.set_ylabel("y (pixels)", fontsize=SMALL)
    ax.tick_params(labelsize=SMALL)
    _dial(figure.add_subplot(grid[1], projection="polar"), lamps)
    return figure


def draw_normals(
    found: SurfaceNormals,
    lamps: Lamps,
    photographs: Sequence[Path],
    mask: NDArray[Any],
    *,
    by_material: bool = False,
) -> Figure:
    """Normals, a lit ball that explains their colours, albedo, confidence, and each lamp's
    residual.

    Args:
        by_material: the photographs were compared with a material that is not matt: the albedo is
            a factor on it, and residuals are relative to a pixel's mean light.
    """
    figure = _sheet(11.5, 8.6)
    grid = figure.add_gridspec(2, 3, height_ratios=(2.2, 1))
    rows, columns = np.nonzero(mask > 0.5)
    window = (
        slice(max(0, rows.min() - 8), rows.max() + 9),
        slice(max(0, columns.min() - 8), columns.max() + 9),
    )
    normal = found.normal[0].detach().cpu().movedim(0, -1).numpy()
    there = (normal != 0).any(-1, keepdims=True)
    albedo = found.albedo[0].detach().cpu().movedim(0, -1).numpy()
    albedo = albedo.repeat(3, -1) if albedo.shape[2] == 1 else albedo
    top = float(np.quantile(albedo[there[..., 0]], 0.995)) if there.any() else 1.0
    confidence = found.confidence[0, 0].detach().cpu().numpy()
    panels = (
        ("normals (x red, y green, z blue)", (normal + 1) / 2 * there, None),
        (
            "factor on the material" if by_material else "albedo",
            np.clip(albedo / max(top, 1e-12), 0, 1) ** (1 / 2.2),
            None,
        ),
        ("confidence", confidence, "viridis"),
    )
    for column, (title, picture, colours) in enumerate(panels):
        ax = figure.add_subplot(grid[0, column])
        shown = ax.imshow(picture[window], cmap=colours, vmin=0, vmax=1, interpolation="nearest")
        ax.set_title(title, fontsize=TEXT + 1)
        ax.set_axis_off()
        if colours:
            figure.colorbar(shown, ax=ax, shrink=0.6).ax.tick_params(labelsize=SMALL)
        elif title.startswith("normals"):
            _key(ax)
    ax = figure.add_subplot(grid[1, :2])
    residual = 100 * found.lamp_residual.cpu().numpy()
    of = _OF_LIGHT if by_material else "the albedo"
    _residuals(ax, residual, photographs, f"residual (% of {of})")
    ax.set_title("How each photograph disagrees with the normals (median)", fontsize=TEXT + 1)
    _dial(figure.add_subplot(grid[1, 2], projection="polar"), lamps, small=True)
    return figure


def draw_inlay(
    photograph: NDArray[Any],
    material: NDArray[Any],
    tilt_deg: NDArray[Any],
    error_deg: NDArray[Any],
    *,
    names: Sequence[str],
    residual: NDArray[Any],
    photographs: Sequence[Path],
) -> Figure:
    """The mean photograph, which shell each piece is, how its layers lean, and how sure that is;
    each photograph's residual."""
    figure = _sheet(11.5, 7.2)
    grid = figure.add_gridspec(2, 4, height_ratios=(2.2, 1))
    top = max(float(np.quantile(photograph, 0.995)), 1e-12)
    shell = np.where(material > 0, 1.0, np.nan)
    of_material = colormaps["tab10"].resampled(len(names))
    panels = (
        ("mean photograph", np.clip(photograph / top, 0, 1) ** (1 / 2.2), None, (0, 1)),
        ("material", material, of_material, (-0.5, len(names) - 0.5)),
        ("layers lean by (degrees)", tilt_deg * shell, "viridis", (0, None)),
        ("standard error (degrees)", error_deg * shell, "magma", (0, None)),
    )
    for column, (title, picture, colours, (low, high)) in enumerate(panels):
        ax = figure.add_subplot(grid[0, column])
        shown = ax.imshow(picture, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
        ax.set_title(title, fontsize=TEXT + 1)
        ax.set_axis_off()
        if title == "material":
            bar = figure.colorbar(shown, ax=ax, shrink=0.6, ticks=range(len(names)))
            bar.ax.set_yticklabels([printable(n) for n in names], parse_math=False)
            bar.ax.tick_params(labelsize=SMALL)
        elif colours:
            figure.colorbar(shown, ax=ax, shrink=0.6).ax.tick_params(labelsize=SMALL)
    ax = figure.add_subplot(grid[1, :])
    _residuals(ax, 100 * residual, photographs, f"residual (% of {_OF_LIGHT})")
    ax.set_title("How each photograph disagrees with what was found (median)", fontsize=TEXT + 1)
    return figure


def _residuals(ax: Any, residual: NDArray[Any], photographs: Sequence[Path], label: str) -> None:
    """A bar a photograph, those that disagree in another colour."""
    worst = residual > 2.5 * np.nanmedian(residual)
    places = np.arange(1, len(residual) + 1)
    ax.bar(places, residual, color=np.where(worst, _BAD, _BALL))
    ax.set_xticks(places)
    names = [printable(path.stem) for path in photographs]
    ax.set_xticklabels(names, rotation=30, ha="right", fontsize=SMALL, parse_math=False)
    ax.set_ylabel(label, fontsize=SMALL)
    ax.tick_params(labelsize=SMALL)
    ax.spines[["top", "right"]].set_visible(False)


def _sheet(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=_DPI, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _dial(ax: Any, lamps: Lamps, small: bool = False) -> None:
    """Where the lamps stand, seen along the camera's axis: angle from it outwards."""
    turn, away = np.deg2rad(lamps.turn_deg), lamps.away_deg
    size = (60 if small else 130) * lamps.intensity / lamps.intensity.max()
    ax.scatter(turn, away, s=size, c=_LAMP, edgecolors="white", linewidths=0.8, zorder=3)
    if not small:
        for k, (t, a) in enumerate(zip(turn, away, strict=True)):
            ax.annotate(
                str(k + 1),
                (t, a),
                xytext=(6, 4),
                textcoords="offset points",
                fontsize=TEXT,
                color=INK,
            )
    outer = float(np.ceil(max(30.0, away.max() * 1.15) / 10) * 10)
    ax.set_rlim(0, outer)
    ax.set_rgrids(np.arange(0, outer + 1, 30 if outer > 60 else 10)[1:], fontsize=SMALL - 1)
    ax.set_rlabel_position(285)  # where lamps are rare: below the object
    ax.set_xticks(np.deg2rad([0, 90, 180, 270]))
    ax.set_xticklabels(["right", "up", "left", "down"], fontsize=SMALL)
    ax.grid(color=FAINT, linewidth=0.6)
    ax.set_title(
        "Directions to the lamps\n(degrees from the camera's axis)",
        fontsize=TEXT if small else TEXT + 1,
    )


def _key(ax: Any) -> None:
    """A small sphere in the lower left corner, in the colours of its normals."""
    x, y = np.meshgrid(np.linspace(-1, 1, 64), np.linspace(1, -1, 64))
    square = x * x + y * y
    z = np.sqrt(np.clip(1 - square, 0, 1))
    ball = np.stack([(x + 1) / 2, (y + 1) / 2, (z + 1) / 2, (square < 1).astype(float)], -1)
    inset = ax.inset_axes((0.0, 0.0, 0.18, 0.18))
    inset.imshow(ball)
    inset.set_axis_off()
