"""What a matt reference of known shape says of the lamps: how bright each is, the response.

The reference is a sphere (its normals follow from its outline) or a flat card.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from raden_torch.capture.photo.ball import Ball
from raden_torch.capture.photo.photometric_stereo import solve_normals
from raden_torch.capture.photo.reference_body import ReferenceBody, fit_body, normals_by_body
from raden_torch.errors import InputError

RIM = 0.95
"""Of a sphere's radius: beyond it an outline half a pixel off tilts the normals by degrees."""
_GRAZING = 0.3
_FEWEST = 100
_MOST_ROUNDS, _STILL = 200, 1e-5
_SAMPLE = 2500
"""Pixels that the response is fitted on."""
_ALIKE = 0.1
"""Lamps that differ by less are taken as equally bright for the response: where lamps moved, the
sphere tells their brightness no better."""
_SHADOW = 0.1
"""As in `solve_normals`."""


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """The response that fits a reference of known shape.

    Attributes:
        body: with the power that makes the photographs linear, the reference's highlight, and
            which lamps moved.
        error_deg: the median angle between true normals and those solved with the body.
        error_linear_deg: between true normals and those of a matt body and exponent 1.
    """

    body: ReferenceBody
    error_deg: float
    error_linear_deg: float

    @property
    def exponent(self) -> float:
        return self.body.exponent

    def __str__(self) -> str:
        body = self.body
        return (
            f"response exponent {body.exponent:.2f}, beside a highlight of the reference, "
            f"{body.height:.2f} of its matt part and {body.width_deg:.0f} deg wide: its normals to "
            f"{self.error_deg:.2f} deg (median; {self.error_linear_deg:.2f} matt and with 1)"
        )


def sphere_normals(ball: Ball, size: tuple[int, int], rim: float = RIM) -> tuple[Tensor, Tensor]:
    """`[1, 3, H, W]` surface normals of a sphere and `[1, 1, H, W]` bool where they hold."""
    normals, inside, _ = sphere_maps(ball, size, rim)
    return normals, inside


def sphere_maps(
    ball: Ball, size: tuple[int, int], rim: float = RIM
) -> tuple[Tensor, Tensor, Tensor]:
    """The same, and `[1, 3, H, W]` unit directions from it to the viewer, 0 beside it."""
    y, x = np.mgrid[: size[0], : size[1]]
    _, normal, view = ball.surface(x, y)
    inside = torch.from_numpy(ball.inside(size, rim) & np.isfinite(normal).all(-1))[None, None]
    normals, views = (
        torch.from_numpy(np.nan_to_num(m)).float().movedim(-1, 0)[None] for m in (normal, view)
    )
    return normals * inside, inside, views


def relative_intensities(
    images: Tensor,
    lights: Tensor,
    normal: Tensor,
    inside: Tensor,
    *,
    saturated: Tensor | None = None,
    exponent: float = 1.0,
) -> Tensor:
    """`[K]` relative intensities of mean 1 from a matt reference under the same lamps.

    Log I_k − log N·L_k is a sum of the lamp's brightness and the pixel's albedo; both are found by
    medians in turn (Tukey's median polish), over the pixels that each lamp lights well. So stains
    do not matter, nor that no pixel is lit by lamps on opposite sides, if lamps between them link
    them.

    Args:
        images: `[K, C, H, W]` linear light.
        lights: `[K, 3]` directions to the lamps, or `[K, 3, H, W]` as `Lamps.towards` gives them.
        normal: `[1, 3, H, W]` of the reference (or `[1, 3, 1, 1]`, a card).
        inside: `[1, 1, H, W]` bool.
        saturated: `[K, 1, H, W]` bool.

    Raises:
        InputError: a lamp that lights fewer than 100 pixels well, or none that other lamps light.
    """
    where = lights[:, :, None, None] if lights.ndim == 2 else lights
    length = where.norm(dim=1, keepdim=True)
    facing = (where * normal).sum(dim=1, keepdim=True)
    good = inside & (facing / length > _GRAZING)
    if saturated is not None:
        good = good & ~saturated
    grey = images.clamp(min=0).mean(dim=1, keepdim=True) ** exponent
    good, ratio = good.expand_as(grey).flatten(1), (grey / facing.clamp(min=1e-6)).flatten(1)
    good, ratio = (m[:, good.sum(dim=0) > 1] for m in (good, ratio))  # one lamp alone says nothing
    fewest = int(good.sum(dim=1).min())
    if fewest < _FEWEST:
        dark = int(good.sum(dim=1).argmin())
        raise InputError(
            f"reference: expected at least {_FEWEST} pixels lit well by lamp {dark + 1} and by "
            f"another, and not saturated, got {fewest}"
        )
    found = torch.where(good, ratio, torch.nan).nanmedian(dim=1).values
    if not bool((found > 0).all()):
        dark = int(found.nan_to_num().argmin())
        raise InputError(f"reference: photograph {dark + 1} is black; was the lamp on?")
    lamp = _median_polish(torch.where(good & (ratio > 0), ratio.log(), torch.nan)).exp()
    return lamp / lamp.mean()


def _median_polish(table: Tensor) -> Tensor:
    """`[K]` effects of the rows of `[K, P]`, where NaN is nothing known."""
    row = table.nanmedian(dim=1).values
    for _ in range(_MOST_ROUNDS):
        column = (table - row[:, None]).nanmedian(dim=0).values
        change = (table - row[:, None] - column).nanmedian(dim=1).values
        row = row + change
        if float(change.abs().max()) < _STILL:
            break
    return row


def fit_response(
    images: Tensor,
    lights: Tensor,
    normal: Tensor,
    inside: Tensor,
    *,
    view: Tensor | None = None,
    saturated: Tensor | None = None,
) -> ResponseFit:
    """The camera's exponent, found with the reference's own highlight and with lamps that moved.

    An exponent alone bends for the highlight, too. How well photographs agree with each other at
    normals that are not known is no substitute: a wrong exponent bends all of them alike (the
    shared grey sphere's agree best at 0.8, and its normals are best at 1.1).

    Args:
        images: `[K, C, H, W]` as read.
        lights: `[K, 3]` directions to the lamps.
        normal, inside: as `sphere_normals` gives them.
        view: `[1, 3, H, W]` unit vectors to the camera; far away where None.
        saturated: `[K, 1, H, W]` bool.

    Raises:
        InputError: fewer than 100 pixels, or lamps that do not light them (`relative_intensities`).
    """
    rows, columns = inside[0, 0].nonzero(as_tuple=True)
    if len(rows) < _FEWEST:
        raise InputError(f"reference: expected at least {_FEWEST} pixels, got {len(rows)}")
    step = max(1, len(rows) // _SAMPLE)
    rows, columns = rows[::step], columns[::step]

    def picked(m: Tensor) -> Tensor:
        return m[:, :, rows, columns]

    truth = picked(normal)[0]
    grey = picked(images).mean(dim=1).clamp(min=0)
    clipped = (torch.zeros_like(grey) if saturated is None else picked(saturated)[:, 0]) > 0
    away = torch.tensor([[0.0], [0.0], [1.0]]) if view is None else picked(view)[0]
    sphere = _Seen(grey, clipped, lights, truth, away.expand(3, len(rows)))
    body = sphere.body(alike=True)
    bright = relative_intensities(
        images, lights, normal, inside, saturated=saturated, exponent=body.exponent
    )
    if float((bright - 1).abs().max()) > _ALIKE:
        body = sphere.body(alike=False)
    return ResponseFit(body, sphere.error_deg(body), sphere.error_deg())


@dataclass(frozen=True, eq=False)
class _Seen:
    """P pixels of a reference: `[K, P]` grey as read and where clipped, `[K, 3]` lights, `[3, P]`
    true normals and views."""

    grey: Tensor
    clipped: Tensor
    lights: Tensor
    truth: Tensor
    view: Tensor

    @property
    def _geometry(self) -> tuple[NDArray[Any], NDArray[Any]]:
        lights = (self.lights / self.lights.norm(dim=1, keepdim=True)).double().numpy()
        return lights[:, :, None], self.view.double().numpy()

    def body(self, *, alike: bool) -> ReferenceBody:
        lights, view = self._geometry
        value, truth = self.grey.double().numpy(), self.truth.double().numpy()
        return fit_body(value, lights, truth, view, ~self.clipped.numpy(), alike=alike)

    def error_deg(self, body: ReferenceBody | None = None) -> float:
        """Median angle of normals by the body; by "robust", lamps alike and exponent 1 without."""
        exponent, clipped, intensity = 1.0, self.clipped, torch.ones(len(self.grey))
        if body is not None:
            exponent, intensity = body.exponent, torch.from_numpy(body.intensity).float()
            clipped = clipped | torch.from_numpy(body.moved)[:, None]
        matt = solve_normals(
            self.grey[:, None, None],
            self.lights,
            intensity=intensity,
            saturated=clipped[:, None, None],
            exponent=exponent,
        ).normal[0, :, 0]
        if body is None:
            return float(angle_deg(matt, self.truth).median())
        lights, view = self._geometry
        linear = (self.grey**exponent / intensity[:, None]).double().numpy()
        usable = ~clipped.numpy() & (linear > _SHADOW * np.sort(linear, axis=0)[-3])
        found = normals_by_body(body, linear, lights, view, matt.double().numpy(), usable)
        return float(angle_deg(torch.from_numpy(found), self.truth.double()).median())


def angle_deg(a: Tensor, b: Tensor) -> Tensor:
    """Degrees between vectors `[3, P]`, exact for small angles too (2 atan2 of sum, difference)."""
    a, b = (v / v.norm(dim=0).clamp(min=1e-12) for v in (a, b))
    return torch.rad2deg(2 * torch.atan2((a - b).norm(dim=0), (a + b).norm(dim=0)))
