"""The style of the graphs: line colours, true colour, fonts that cover the sample's name."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch
from matplotlib import font_manager
from matplotlib.axes import Axes
from matplotlib.ft2font import FT2Font

from raden_torch.arrays import Floats
from raden_torch.measurement.readings import RGB
from raden_torch.plots.cuts import NotMeasuredError

if TYPE_CHECKING:
    from raden_torch.plots.view import View

_T = TypeVar("_T")

FACTOR_LABEL = "reflectance factor (perfect diffuser = 100)"
INK, FAINT, UNMEASURED = "0.15", "0.62", "0.88"
TEXT, SMALL = 9.0, 8.0
"""Font sizes in points."""

# red, green and blue that differ for colour-blind readers too (Okabe and Ito 2008), and in marker
_LINES = {"R": ("#d55e00", "s"), "G": ("#009e73", "o"), "B": ("#0072b2", "^")}
_GREY_LINE = ("0.25", "o")
_FAMILIES = (
    "DejaVu Sans",
    "Noto Sans CJK JP",
    "IPAexGothic",
    "TakaoGothic",
    "Hiragino Sans",
    "Yu Gothic",
    "MS Gothic",
    "Arial Unicode MS",
)


@dataclass(frozen=True)
class Curve:
    """One channel's place in the values, its name, colour and marker."""

    channel: int
    name: str
    colour: str
    marker: str


def curves(view: View) -> list[Curve]:
    """R, G and B, or one grey curve."""
    if view.bands == RGB:
        return [Curve(i, name, *_LINES[name]) for i, name in enumerate(RGB)]
    return [Curve(0, view.bands[0].replace("nm", " nm"), *_GREY_LINE)]


def true_colour(rgb: Floats, white: float | Floats | None = None) -> Floats:
    """Linear RGB `[..., 3]` as displayed: `[..., 4]` sRGB and opacity in 0…1.

    Args:
        white: the value that becomes full brightness, one or `[...]`; the largest of all where
            None. Negative values, outside the display's gamut, are clipped; NaN is transparent.
    """
    from raden_torch.brdf.files.display import to_display

    level = np.array(brightest(rgb) if white is None else white, np.float64, ndmin=1)
    flat = torch.from_numpy((np.nan_to_num(rgb) / level[..., None]).reshape(-1, 3))
    shown = to_display(flat.T[None, :, :, None])[0, :, :, 0].T.numpy().astype(np.float64)
    opacity = np.where(np.isnan(rgb).any(axis=-1, keepdims=True), 0.0, 1.0)
    return np.concatenate([shown.reshape(rgb.shape), opacity], axis=-1)


def brightest(rgb: Floats) -> float:
    """The largest value, or 1 where none is positive."""
    largest = float(np.nanmax(rgb, initial=0.0))
    return largest if largest > 0 else 1.0


def finish(ax: Axes, title: str, x_label: str, y_label: str) -> None:
    """Title, labels with units, and a quiet frame."""
    ax.set_title(title, fontsize=TEXT + 1, loc="left", color=INK)
    ax.set_xlabel(x_label, fontsize=TEXT)
    ax.set_ylabel(y_label, fontsize=TEXT)
    ax.tick_params(labelsize=SMALL)
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(True, color="0.92", linewidth=0.8)
    ax.set_axisbelow(True)


def cell_edges(angle: Floats) -> Floats:
    """Where the cells around the sorted angles meet, and where the first and last end."""
    x = np.sort(angle)
    middle = (x[1:] + x[:-1]) / 2
    ends = np.clip([2 * x[0] - middle[0], 2 * x[-1] - middle[-1]], -90.0, 90.0)
    return np.concatenate([ends[:1], middle, ends[1:]])


def say_missing(ax: Any, title: str, text: str) -> None:
    """An empty panel that says what it lacks."""
    ax.set_title(title, fontsize=TEXT + 1, loc="left", color=INK)
    ax.set_axis_off()
    write = ax.text2D if hasattr(ax, "text2D") else ax.text
    write(
        0.5,
        0.5,
        text,
        transform=ax.transAxes,
        ha="center",
        va="center",
        fontsize=TEXT,
        color="0.4",
        style="italic",
    )


def or_say_missing(ax: Any, title: str, take: Callable[[], _T]) -> _T | None:
    """What is taken of the samples; None, and said on the axes, where they lack it."""
    try:
        return take()
    except NotMeasuredError as why:
        say_missing(ax, title, str(why))
        return None


def printable(text: str) -> str:
    """The text with "?" for what no installed font has: Matplotlib would warn and draw a box."""
    known = set().union(*_installed().values())
    return "".join(c if ord(c) in known else "?" for c in text)


def families(text: str) -> list[str]:
    """The installed fonts that together have the text's letters."""
    fonts = _installed()
    first = next(iter(fonts))
    needed = [name for name, has in fonts.items() if any(ord(c) in has for c in text)]
    return list(dict.fromkeys([first, *needed]))


@cache
def _installed() -> dict[str, frozenset[int]]:
    """The code points of each installed family of `_FAMILIES`, in their order."""
    there = set(font_manager.fontManager.get_font_names())
    return {
        name: frozenset(FT2Font(font_manager.findfont(name)).get_charmap())
        for name in _FAMILIES
        if name in there
    }
