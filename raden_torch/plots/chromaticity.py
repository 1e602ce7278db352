"""The iridescence path: how the colour of the mirror direction travels with the incidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle

from raden_torch.arrays import Floats
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix
from raden_torch.plots.cuts import SLAB_DEG, Cut, NotMeasuredError, in_words
from raden_torch.plots.plot_style import (
    FAINT,
    INK,
    SMALL,
    brightest,
    finish,
    or_say_missing,
    true_colour,
)
from raden_torch.plots.view import View, view_of

_MARK_EVERY_DEG = 10.0
_LEAST_SPAN = 0.03  # in u′ and v′: a path that stays in one place is not blown up further
# of the axes' width: between two labelled points, from point to label, from label to anything
_LABEL_GAP, _LABEL_REACH, _LABEL_ROOM = 0.05, 0.055, 0.03
_AROUND = np.stack([f(np.arange(16) * np.pi / 8) for f in (np.cos, np.sin)], axis=1)
_SIDEWAYS = np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.0]])
_WIDE = 1.5  # width over height of the axes: a square for the paths, and the inset beside it
_LOCUS_NM = (390.0, 700.0)
_STYLES = (("0.55", "o"), ("0.1", "D"))  # line and marker of the path at tilt 0 and at the peak


@dataclass(frozen=True)
class MirrorPath:
    """The colours at receiving = incidence and one tilt.

    Attributes:
        name: the tilt in words.
        incidence_deg: `[K]`, ascending.
        rgb: `[K, 3]` linear RGB.
        uv: `[K, 2]` CIE 1976 u′v′; NaN where the luminance is not positive.
        joined: the points may be joined by a line.
    """

    name: str
    incidence_deg: Floats
    rgb: Floats
    uv: Floats
    joined: bool


def plot_path(
    ax: Axes,
    source: BrdfMeasurement | RadenBrdf | View,
    *,
    incidence_deg: float = 20.0,
) -> None:
    """The colours along the mirror direction r = a, in the CIE 1976 u′v′ diagram.

    Two paths: at the tilt nearest to 0, and at the tilt where the mirror direction is brightest.
    An inset shows where in the whole diagram the axes lie.

    Args:
        ax: ordinary axes; the right third is kept for the inset and the legend.
        incidence_deg: the incidence in degrees at which the brightest tilt is looked for.
    """
    view, title = view_of(source), "Iridescence path, mirror direction r = a"
    paths = or_say_missing(ax, title, lambda: mirror_paths(view, incidence_deg))
    if paths is None:
        return
    _landmarks(ax)
    for path, (colour, marker) in zip(paths, _STYLES, strict=False):
        _draw_path(ax, path, colour, marker, is_model=view.is_model)
    finish(ax, title, "u′ (CIE 1976)", "v′ (CIE 1976)")
    (left, bottom), span = _zoom(paths)
    ax.set_xlim(left, left + _WIDE * span)
    ax.set_ylim(bottom, bottom + span)
    ax.set_aspect("equal")
    ax.locator_params(nbins=6)
    _label(ax, paths, span, is_model=view.is_model)
    legend = ax.legend(fontsize=SMALL, loc="upper right", bbox_to_anchor=(1.0, 0.5))
    legend.get_frame().set(edgecolor="none", facecolor="white", alpha=0.9)
    _overview(ax, paths)


def mirror_paths(view: View, incidence_deg: float) -> list[MirrorPath]:
    """The path at the tilt nearest to 0 and, if it is another, at the brightest tilt.

    Raises:
        NotMeasuredError: no colour, or no reading with a positive luminance.
    """
    if view.colourless:
        raise NotMeasuredError(view.colourless)
    cut = view.samples.mirror()
    uv, luminance = uv_of_rgb(cut.values)
    visible = ~np.isnan(uv).any(axis=-1)
    if not visible.any():
        raise NotMeasuredError("needs a positive luminance at receiving = incidence")
    tilt, incidence = cut.deg["tilt"], cut.deg["incidence"]
    away = abs(incidence - incidence_deg)
    near = visible & (away <= away[visible].min() + (0 if cut.joined else SLAB_DEG))
    peak = tilt[near][np.argmax(luminance[near])]
    flat = tilt[visible][np.argmin(abs(tilt[visible]))]
    paths = [_path_at(cut, uv, flat, "")]
    if abs(peak - flat) > (0 if cut.joined else SLAB_DEG):
        paths.append(_path_at(cut, uv, peak, " (brightest)"))
    return paths


def uv_of_rgb(rgb: Floats) -> tuple[Floats, Floats]:
    """CIE 1976 u′v′ `[..., 2]` and luminance Y `[...]` of linear RGB `[..., 3]` (D65, 2°).

    u′ = 4X / (X + 15Y + 3Z), v′ = 9Y / (X + 15Y + 3Z): CIE 15:2004, 8.2.1.1. NaN where Y or the
    denominator is not positive, as noise around black makes them.
    """
    xyz = rgb @ np.linalg.inv(xyz_to_rgb_matrix()).T
    y, below = xyz[..., 1], xyz @ np.array([1.0, 15.0, 3.0])
    below = np.where((below > 0) & (y > 0), below, np.nan)
    return np.stack([4 * xyz[..., 0] / below, 9 * y / below], axis=-1), y


def _path_at(cut: Cut, uv: Floats, tilt_deg: float, remark: str) -> MirrorPath:
    use = abs(cut.deg["tilt"] - tilt_deg) <= (1e-6 if cut.joined else SLAB_DEG)
    incidence = cut.deg["incidence"][use]
    order = np.argsort(incidence, kind="stable")
    name = in_words({"tilt": float(tilt_deg)}, about=not cut.joined) + remark
    return MirrorPath(name, incidence[order], cut.values[use][order], uv[use][order], cut.joined)


def _marked(path: MirrorPath, *, is_model: bool) -> list[int]:
    """Every reading; of a model's fine line, the points at whole tens of degrees."""
    there = np.flatnonzero(~np.isnan(path.uv).any(axis=1))
    if not is_model:
        return there.tolist()
    tens = np.arange(0, 91, _MARK_EVERY_DEG)
    away = abs(path.incidence_deg[there, None] - tens)
    return sorted({int(there[i]) for i in away.argmin(axis=0)[away.min(axis=0) <= 0.5]})


def _draw_path(ax: Axes, path: MirrorPath, colour: str, marker: str, *, is_model: bool) -> None:
    if path.joined:
        ax.plot(*path.uv.T, color=colour, linewidth=1.2, zorder=3)
    marked = _marked(path, is_model=is_model)
    rgb, (u, v) = path.rgb[marked], path.uv[marked].T
    ax.scatter(
        u,
        v,
        c=true_colour(rgb, np.array([brightest(row) for row in rgb])),
        s=42,
        marker=marker,
        edgecolors=colour,
        linewidths=1.1,
        zorder=4,
        label=path.name,
    )


def _label(ax: Axes, paths: list[MirrorPath], span: float, *, is_model: bool) -> None:
    """Write the incidence beside as many points as have room: the ends first, then tens."""
    drawn = np.concatenate([path.uv for path in paths])
    obstacles = [drawn[~np.isnan(drawn).any(axis=1)], uv_of_rgb(np.ones((1, 3)))[0]]
    labelled: list[Floats] = []
    for path in paths:
        marked = _marked(path, is_model=is_model)
        tens = [i for i in marked if path.incidence_deg[i] % _MARK_EVERY_DEG == 0]
        for i in (marked[0], marked[-1], *tens, *marked):
            point = path.uv[i]
            if any(np.hypot(*(point - other)) < _LABEL_GAP * span for other in labelled):
                continue
            places = point + _LABEL_REACH * span * _AROUND
            away = np.concatenate(obstacles)[None] - places[:, None]
            room = np.hypot(*np.moveaxis(away, -1, 0)).min(axis=1)
            if room.max() < _LABEL_ROOM * span:
                continue
            place = places[np.argmax(room)]
            labelled.append(point)
            obstacles.append(place[None] + _LABEL_ROOM * span * _SIDEWAYS)
            text = f"{round(float(path.incidence_deg[i]), 1):g}°"
            x, y = place
            ax.text(x, y, text, ha="center", va="center", fontsize=SMALL, color=INK, clip_on=True)


def _landmarks(ax: Axes, mark: float = 9.0) -> None:
    """The spectral locus with the purple line, the sRGB triangle and its white."""
    locus = _locus_uv()
    ax.plot(*np.vstack([locus, locus[:1]]).T, color=FAINT, linewidth=1.2, label="spectral locus")
    primaries = uv_of_rgb(np.eye(3))[0]
    triangle = np.vstack([primaries, primaries[:1]])
    ax.plot(*triangle.T, color="#7a5195", linewidth=1.0, label="sRGB gamut")
    white = uv_of_rgb(np.ones(3))[0]
    ax.plot(*white, "+", color=INK, markersize=mark, linestyle="none", label="white (D65)")


def _locus_uv() -> Floats:
    import colour

    functions = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    low, high = _LOCUS_NM
    bands = (functions.wavelengths >= low) & (functions.wavelengths <= high)
    return np.asarray(colour.xy_to_Luv_uv(colour.XYZ_to_xy(functions.values[bands])), np.float64)


def _zoom(paths: list[MirrorPath]) -> tuple[Floats, float]:
    """Lower left corner and width of the square that holds the paths and the white point."""
    points = np.concatenate([*(path.uv for path in paths), uv_of_rgb(np.ones((1, 3)))[0]])
    points = np.clip(points, (0.0, 0.0), (0.63, 0.6))  # noise around black may lie far outside
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    span = max(1.3 * float(np.max(high - low)), _LEAST_SPAN)
    return (low + high - span) / 2, span


def _overview(ax: Axes, paths: list[MirrorPath]) -> None:
    """The whole diagram, with a frame around what the axes show."""
    inset = ax.inset_axes((0.72, 0.54, 0.28, 0.28 * _WIDE))
    _landmarks(inset, mark=5.0)
    for path, (colour, _) in zip(paths, _STYLES, strict=False):
        style = {"linewidth": 1.0} if path.joined else {"linestyle": "none", "marker": ",", "ms": 1}
        inset.plot(*path.uv.T, color=colour, **style)
    (left, right), (bottom, top) = ax.get_xlim(), ax.get_ylim()
    frame = Rectangle((left, bottom), right - left, top - bottom, fill=False, color=INK)
    frame.set_linewidth(0.9)
    inset.add_patch(frame)
    inset.set_xlim(-0.02, 0.65)
    inset.set_ylim(-0.02, 0.65)
    inset.set_aspect("equal")
    inset.set_xticks([0, 0.2, 0.4, 0.6])
    inset.set_yticks([0, 0.2, 0.4, 0.6])
    inset.tick_params(labelsize=SMALL - 1.5, length=2)
