"""The drawings of docs/conventions.md: `python docs/pictures/angles.py` writes three SVG files.

All vectors are made by `vectors_from_angles`, so that a sign that changes there shows here. The
frame of the drawings has x to the right, y into the page and z up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.figure import Figure

import raden_torch as rt

HERE = Path(__file__).parent
INCIDENCE, RECEIVING, TILT = 50.0, 30.0, 30.0
LAMP, EYE, NORMAL, PLANE = "#b35900", "#0060a0", "#1a1a1a", "#777777"
INTO_THE_PAGE = np.array([0.34, 0.30])
"""Where y goes on the paper, in the oblique drawings."""

Vectors = dict[str, np.ndarray]


def drawn_vectors(incidence: float, receiving: float, tilt: float) -> Vectors:
    """N, L, V and what the conventions derive of them, with the plane of L and V as the paper."""
    angles = [torch.tensor(x, dtype=torch.float64).deg2rad() for x in (incidence, receiving, tilt)]
    n, l, v = (  # noqa: E741
        m.flatten().numpy() for m in rt.vectors_from_angles(*(a.view(1, 1, 1) for a in angles))
    )
    p = np.cross(l, v) / np.linalg.norm(np.cross(l, v))
    up = (n - (n @ p) * p) / np.linalg.norm(n - (n @ p) * p)
    turned = np.stack([np.cross(p, up), p, up])  # rows: to the right, into the page, up
    half = (l + v) / np.linalg.norm(l + v)
    across = (v - l) / np.linalg.norm(v - l)
    named = {"N": n, "L": l, "V": v, "N′": up, "p": p, "h": half, "e": across}
    return {name: turned @ vector for name, vector in named.items()}


def on_paper(vector: np.ndarray) -> np.ndarray:
    return vector[..., [0, 2]] + vector[..., 1:2] * INTO_THE_PAGE


def arrow(ax: Any, to: np.ndarray, colour: str, name: str, *, away: float = 1.1) -> None:
    end = on_paper(to)
    ax.annotate("", end, (0, 0), arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.8})
    ax.text(*(away * end), name, color=colour, ha="center", va="center", fontsize=14)


def arc(
    ax: Any, start: np.ndarray, end: np.ndarray, radius: float, name: str, at: int = 30
) -> None:
    """From one unit vector to another, with its name beside it."""
    share = np.linspace(0, 1, 60)[:, None]
    between = np.arccos(np.clip(start @ end, -1, 1))
    path = (np.sin((1 - share) * between) * start + np.sin(share * between) * end) / np.sin(between)
    ax.plot(*on_paper(radius * path).T, color=NORMAL, lw=1)
    ax.text(*on_paper((radius + 0.09) * path[at]), name, ha="center", va="center", fontsize=13)


def sheet(width: float, height: float) -> tuple[Any, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    ax = figure.subplots()
    ax.set_aspect("equal")
    ax.set_axis_off()
    return figure, ax


def surface(ax: Any, normal: np.ndarray, radius: float = 0.85) -> None:
    """A disc across the normal."""
    one = np.cross(normal, [0.0, 1.0, 0.0])
    one /= np.linalg.norm(one)
    two = np.cross(normal, one)
    turn = np.linspace(0, 2 * np.pi, 120)[:, None]
    rim = on_paper(radius * (np.cos(turn) * one + np.sin(turn) * two))
    ax.fill(*rim.T, color="#e9e2d2", ec="#b0a890", zorder=-2)
    ax.text(*(rim[np.argmin(rim[:, 1])] + [0.0, -0.09]), "surface", ha="center", color="#8a8168")


def measuring_plane(ax: Any, low: float = -0.12) -> None:
    corners = np.array([[-1.05, 0, low], [1.05, 0, low], [1.05, 0, 1.2], [-1.05, 0, 1.2]])
    ax.fill(*on_paper(corners).T, color="#dfe9f2", alpha=0.6, ec="#9fb3c6", zorder=-1)
    ax.text(*on_paper(np.array([1.0, 0, 1.12])), "plane of L and V", ha="right", color=PLANE)


def draw_plane() -> Any:
    """Incidence and receiving, in the plane of L and V."""
    v = drawn_vectors(INCIDENCE, RECEIVING, 0.0)
    figure, ax = sheet(5.2, 3.6)
    ax.plot([-1, 1], [0, 0], color="#b0a890", lw=3, zorder=-1)
    arrow(ax, v["L"], LAMP, "L")
    arrow(ax, v["V"], EYE, "V")
    arrow(ax, v["N′"], NORMAL, "N′")
    arc(ax, v["L"], v["N′"], 0.42, "a")
    arc(ax, v["N′"], v["V"], 0.5, "r")
    ax.plot(0.82, 0.86, marker="o", ms=13, mfc="white", mec=PLANE)
    ax.plot(0.82, 0.86, marker="x", ms=7, color=PLANE)
    ax.text(0.92, 0.86, "p, into\nthe page", color=PLANE, va="center", fontsize=10)
    drawn = f"a = {INCIDENCE:.0f}°, r = +{RECEIVING:.0f}°"
    ax.text(-0.98, -0.14, f"{drawn}: V on the other side of N′ than L")
    ax.text(-0.98, -0.27, "r < 0: V on the side of L;  r = a: the mirror direction")
    ax.set(xlim=(-1.1, 1.25), ylim=(-0.32, 1.18))
    return figure


def draw_tilt() -> Any:
    """The tilt: N out of the plane of L and V."""
    v = drawn_vectors(INCIDENCE, RECEIVING, TILT)
    figure, ax = sheet(5.2, 3.7)
    measuring_plane(ax)
    surface(ax, v["N"])
    arrow(ax, v["L"], LAMP, "L")
    arrow(ax, v["V"], EYE, "V")
    arrow(ax, v["N′"], PLANE, "N′")
    arrow(ax, v["N"], NORMAL, "N", away=1.12)
    arrow(ax, 0.9 * v["p"], PLANE, "p", away=1.25)
    ax.plot(*on_paper(np.stack([v["N"], v["N′"] * (v["N"] @ v["N′"])])).T, ":", color=NORMAL)
    arc(ax, v["N′"], v["N"], 0.72, "t")
    ax.set(xlim=(-1.15, 1.2), ylim=(-0.38, 1.3))
    return figure


def draw_half_vector() -> Any:
    """The frame of the runtime form: h, e and p, and N's parts along them."""
    v = drawn_vectors(65.0, 35.0, 42.0)
    figure, ax = sheet(5.2, 4.0)
    measuring_plane(ax, low=-0.45)
    arrow(ax, v["L"], LAMP, "L")
    arrow(ax, v["V"], EYE, "V")
    for name in ("h", "e", "p"):
        arrow(ax, 0.95 * v[name], PLANE, name, away=1.12)
    arrow(ax, v["N"], NORMAL, "N", away=1.12)
    x, y, z = (v["N"] @ v[name] * v[name] for name in "hep")
    for corner in ((0 * x, x), (x, x + y), (x + y, x + y + z)):
        ax.plot(*on_paper(np.stack(corner)).T, color="#a00040", lw=1.4, ls=(0, (4, 2)))
    for middle, name, dx, dy in (
        (x / 2, "x", -0.07, 0.0),
        (x + y / 2, "y", -0.02, 0.08),
        (x + y + z / 2, "z", -0.05, 0.06),
    ):
        right, up = on_paper(middle)
        ax.text(right + dx, up + dy, name, color="#a00040", fontsize=12)
    arc(ax, v["L"], v["h"], 0.36, "α")
    arc(ax, v["h"], v["V"], 0.3, "α", at=50)
    ax.set(xlim=(-1.15, 1.25), ylim=(-0.5, 1.3))
    return figure


DRAWINGS = {
    "angles_plane.svg": draw_plane,
    "angles_tilt.svg": draw_tilt,
    "half_vector.svg": draw_half_vector,
}


def main(folder: Path = HERE) -> None:
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "raden_torch"}):
        for name, draw in DRAWINGS.items():
            draw().savefig(folder / name, metadata={"Date": None}, facecolor="white")


if __name__ == "__main__":
    main()
