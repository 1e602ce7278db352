"""Shells that were found, as one picture: thumbnails with their colours and names, best first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from raden_torch.catalogue.colour_query import chroma_and_hue
from raden_torch.catalogue.lab_grid import rgb_of_lab
from raden_torch.errors import InputError
from raden_torch.packages import require

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from raden_torch.catalogue.catalogue import Catalogue
    from raden_torch.catalogue.search import Found

MOST = 400
"""Shells on one sheet."""
_INCHES = 1.5
_LETTERS = 22
_BACKGROUND, _INK, _FAINT = "black", "0.85", "0.55"


def draw_sheet(catalogue: Catalogue, found: Sequence[Found], title: str) -> Figure:
    """A tile a shell: its sphere beside a window, each exposed for itself; under it, where a colour
    was looked for, a strip of the colour that was found, brought within what a display shows.

    Raises:
        InputError: no shells, or more than `MOST`; a thumbnail is missing.
        MissingPackageError: Matplotlib is not installed.
    """
    require("contact sheets", "plots")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from raden_torch.plots.plot_style import SMALL, TEXT, families, printable

    if not 1 <= len(found) <= MOST:
        raise InputError(
            f"contact sheet: expected 1…{MOST} shells, got {len(found)}; `limit` says how many"
        )
    across = min(len(found), max(5, round((1.5 * len(found)) ** 0.5)))
    down = -(-len(found) // across)
    size = across * _INCHES, down * _INCHES * 1.8 + 0.3
    figure = Figure(figsize=size, facecolor=_BACKGROUND, layout="constrained")
    FigureCanvasAgg(figure)
    title = printable(title)
    figure.suptitle(title, fontsize=TEXT, color=_INK, fontfamily=families(title))
    axes = figure.subplots(down, across, squeeze=False).ravel()
    for ax in axes:
        ax.set_axis_off()
    for place, (ax, one) in enumerate(zip(axes, found, strict=False), 1):
        ax.imshow(_with_strip(catalogue, one), interpolation="lanczos")
        label = "\n".join(map(printable, _label(place, one)))
        ax.text(
            *(0.5, -0.04, label),
            transform=ax.transAxes,
            ha="center",
            va="top",
            fontsize=SMALL,
            color=_FAINT,
            family=families(label),
        )
    return figure


def _label(place: int, found: Found) -> list[str]:
    entry = found.entry
    name = entry.name or entry.file
    lines = [
        f"{place}  " + (name if len(name) <= _LETTERS else name[: _LETTERS - 1] + "…"),
        entry.short_id,
    ]
    if found.lab is not None:
        chroma, hue = chroma_and_hue(np.array(found.lab))
        lines.append(f"L* {found.lab[0]:.0f}  C* {chroma:.0f}  h {hue:.0f}°")
    if entry.simulated:
        lines.append("simulated specimen")
    return lines


def _with_strip(catalogue: Catalogue, found: Found) -> Any:
    """`[H, W, 3]` in 0…255."""
    from raden_torch.images.pixels import read_pixels

    path = catalogue.thumbnail(found.entry)
    if not path.is_file():
        raise InputError(f"{path}: expected the thumbnail of {found.entry.short_id}, got none")
    picture = read_pixels(path, colour=True)
    if found.lab is None:
        return picture
    strip = np.empty((len(picture) // 8, picture.shape[1], 3), picture.dtype)
    strip[:] = _shown(found.lab)
    return np.concatenate([picture, np.zeros_like(strip[:3]), strip])


def _shown(lab: tuple[float, float, float]) -> Any:
    """A colour `(3,)` in 0…255; one brighter than a display's white is shown darker."""
    import torch

    from raden_torch.brdf.files.display import Display

    rgb = rgb_of_lab(np.array(lab))
    stops = float(min(0.0, -np.log2(max(float(rgb.max()), 1e-9))))
    light = torch.from_numpy(rgb).float().view(1, 3, 1, 1)
    return Display(exposure=stops).picture(light).flatten().mul(255).round().byte().numpy()
