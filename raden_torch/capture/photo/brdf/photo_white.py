"""The white reference in the picture: what camera signal stands for which reflectance factor?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.brdf.lighting import Lamp
from raden_torch.capture.photo.brdf.photo_angles import angles_deg
from raden_torch.capture.photo.brdf.photo_series import Frame
from raden_torch.capture.photo.brdf.rays import Rays
from raden_torch.capture.photo.brdf.sample_shapes import Plane
from raden_torch.capture.photo.brdf.white_sight import WhiteSight
from raden_torch.errors import InputError

_FACING = 0.25
"""cos θi below which a lamp does not light the white well."""
_FEWEST_PX = 32
_CLIPPED = 0.1
_HALVINGS = 5
"""Of the white into parts, 32 in all."""
_NEIGHBOURS = 1.5
"""Parts nearer than so many of their sizes may be wrong alike."""
_UNEVEN = 0.15
_DIM = 1e-4


@dataclass(frozen=True, eq=False)
class WhiteFactor:
    """How much the white reflects.

    Attributes:
        xyz: `[3]` its XYZ reflectance factor in every geometry, where there is no file.
        file: a measurement of it, which is looked up at the white's own geometry.
        relative_std: standard uncertainty (k = 1) of either, from its certificate.
        name: of the reference: measurements that name the same share its error.
    """

    xyz: Floats
    file: Path | None = None
    relative_std: float = 0.0
    name: str = ""

    def at(self, angles: NDArray[np.floating[Any]]) -> Floats:
        """`[3]` at incidence, receiving and tilt in degrees."""
        if self.file is None:
            return self.xyz
        from raden_torch.capture.spectrometer.ports import Position
        from raden_torch.capture.spectrometer.white_file import xyz_at

        return xyz_at(self.file, Position(*(float(angle) for angle in angles)))


@dataclass(frozen=True, eq=False)
class WhitePlace:
    """The white in one photograph: `[P]` columns and rows of its pixels, its plane, and whether
    that is the board's."""

    x_px: NDArray[np.intp]
    y_px: NDArray[np.intp]
    plane: Plane
    on_board: bool = False


@dataclass(frozen=True, eq=False)
class WhiteReading:
    """The white under one lamp.

    Attributes:
        rgb: `[3]` its signal for θi = 0, at the irradiance of the sample's middle.
        std: `[3]` of `rgb`, relative: from how the signal varies over the white.
        xyz: `[3]` its reflectance factor at this lamp.
        parts: `[32, 3]` the signal of its parts over `rgb`, less 1.
        place: `[32, 2]` where these are, in sizes of a part.
        lean: `[2]` the share by which its irradiance grows as the lamp leans by a degree along each
            of its two directions.
        sight: a pixel of each part, by which its irradiance under another lamp is known.
    """

    rgb: Floats
    std: Floats
    xyz: Floats
    parts: Floats
    place: Floats
    lean: Floats
    sight: WhiteSight

    @property
    def unevenness(self) -> float:
        """Relative standard deviation over its parts."""
        return float(np.median(np.std(self.parts, axis=0, ddof=1)))


def read_white(
    frame: Frame, place: WhitePlace, rays: Rays, lamp: Lamp, middle: Floats, factor: WhiteFactor
) -> WhiteReading | None:
    """The white in one photograph; None where its lamp does not light it well, or it is clipped.

    A pixel's signal is divided by cos θi (d_middle/d)². The median over the pixels of each part is
    taken, so that dust does not matter, and the mean over the parts, which stains scatter less than
    a median over the whole white.
    """
    usable = frame.usable[place.y_px, place.x_px]
    surface = place.plane.seen(rays)
    light, falloff = lamp.at(surface.point, middle)
    cosine = (light * surface.normal).sum(1)
    good = usable & (cosine > _FACING)
    if good.sum() < _FEWEST_PX or usable.mean() < 1 - _CLIPPED or good.mean() < 0.5:
        return None
    signal = frame.radiance[place.y_px[good], place.x_px[good]].astype(np.float64)
    level = signal / (cosine[good] * falloff[good])[:, None]
    x, y = place.x_px[good], place.y_px[good]
    groups = _halved(x, y)
    blocks = np.array([np.median(level[part], axis=0) for part in groups])
    rgb = blocks.mean(axis=0)
    if not (rgb > _DIM * max(float(np.median(frame.radiance.max())), 1e-12)).all():
        return None
    # noise averages out in the parts, shading and stains do not
    parts = blocks / rgb - 1
    size = np.sqrt(len(x) / len(groups))
    middles = np.array([[x[part].mean(), y[part].mean()] for part in groups])
    where = middles / size
    std = _std_of_mean(parts, where)
    at = np.median(angles_deg(surface.normal[good], light[good], -rays.direction[good]), axis=0)
    amid = [
        np.flatnonzero(good)[part[np.hypot(x[part] - u, y[part] - v).argmin()]]
        for part, (u, v) in zip(groups, middles, strict=True)
    ]
    sight = WhiteSight(Rays(rays.start[amid], rays.direction[amid]), place.plane, place.on_board)
    lean = sight.lean(lamp, middle)
    return WhiteReading(rgb, std, factor.at(at), parts, where, lean, sight)


def _halved(x: NDArray[np.intp], y: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Indices of pixels in 32 compact parts of equally many: each is halved across its length."""
    groups = [np.arange(len(x))]
    for _ in range(_HALVINGS):
        sorted_ = [
            g[np.argsort((x if np.ptp(x[g]) >= np.ptp(y[g]) else y)[g], kind="stable")]
            for g in groups
        ]
        groups = [half for g in sorted_ for half in np.array_split(g, 2)]
    return groups


def _std_of_mean(parts: Floats, place: Floats) -> Floats:
    """`[3]` of the mean of parts `[n, 3]`, of which neighbours are wrong alike.

    Products of neighbours' deviations count as those of each part with itself (Conley 1999, with
    equal weights); the deviations are from the mean, which took its share of them.
    """
    off = parts - parts.mean(axis=0)
    count = len(off)
    near = np.linalg.norm(place[:, None] - place, axis=-1) <= _NEIGHBOURS
    together = np.einsum("ij,ic,jc->c", near, off, off) / max(count**2 - near.sum(), 1)
    alone = (off**2).sum(axis=0) / (count * (count - 1))
    return np.asarray(np.sqrt(np.maximum(together, alone)))


@dataclass(frozen=True, eq=False)
class Scale:
    """From camera signal to reflectance, for every shot.

    Attributes:
        rgb: `[K, 3]` the white's signal for θi = 0 under each shot's lamp.
        std: `[K, 3]` of it, relative: each shot's own.
        common_std: `[3]` of it, relative: what all shots share, as stains on the white are.
        lean: `[K, 2]` by how much it grows as the lamp leans, a degree along each of its two
            directions.
        xyz: `[3]` the white's reflectance factor that it stands for.
        measured: `[K]` the white was read in that shot; else its lamp's intensity was taken.
        notes: what a person should know.
        sights: of each shot, by which the light on its white is known; None where it was not read.
    """

    rgb: Floats
    std: Floats
    common_std: Floats
    lean: Floats
    xyz: Floats
    measured: NDArray[np.bool_]
    notes: tuple[str, ...]
    sights: tuple[WhiteSight | None, ...]

    @property
    def mean_rgb(self) -> Floats:
        """`[3]` the white under the mean lamp, brightest channel 1."""
        mean = self.rgb.mean(axis=0)
        return np.asarray(mean / mean.max())


def scale_of(
    readings: Sequence[WhiteReading | None], lamps: Sequence[Lamp], names: Sequence[str]
) -> Scale:
    """Each shot's scale: from the white in it, else from its lamp's relative intensity.

    Raises:
        InputError: no shot shows the white well lit, or its factors differ between the lamps.
    """
    measured = np.array([reading is not None for reading in readings])
    there = [reading for reading in readings if reading is not None]
    if not there:
        raise InputError(
            f"{names[0]} … {names[-1]}: the white reference was not found: dark, over-exposed or "
            "lit at a grazing angle in every photograph; check where it is, and expose so that it "
            "stays below the white level"
        )
    xyz = np.mean([reading.xyz for reading in there], axis=0)
    expected = np.array([lamp.rgb for lamp in lamps])
    ratios = np.array(
        [r.rgb / r.xyz * xyz / e for r, e in zip(readings, expected, strict=True) if r is not None]
    )
    usual = np.median(ratios, axis=0)
    # how well the intensities predict the white where both are known
    doubt = 1.4826 * np.median(abs(ratios / usual - 1), axis=0) if len(ratios) > 2 else 0.05
    rgb, std = expected * usual, np.broadcast_to(doubt, expected.shape).copy()
    lean = np.zeros((len(readings), 2))
    parts = np.array([reading.parts for reading in there])
    common = parts.mean(axis=0)
    place = np.mean([reading.place for reading in there], axis=0)
    own = np.array([_std_of_mean(each - common, place) for each in parts])
    if len(there) > 1:  # the mean took its share of each shot's own
        own *= np.sqrt(len(there) / (len(there) - 1))
    row = iter(range(len(there)))
    for k, reading in enumerate(readings):
        if reading is not None:
            rgb[k], std[k] = reading.rgb / reading.xyz * xyz, own[next(row)]
            lean[k] = reading.lean
    shared = _std_of_mean(common, place)
    notes = []
    without = [name for name, there_ in zip(names, measured, strict=True) if not there_]
    if without:
        notes.append(
            f"the white was not read in {_listed(without)}: lit at a grazing angle, dark or "
            "clipped; the lamps' relative intensities were taken"
        )
    uneven = [
        name
        for name, r in zip(names, readings, strict=True)
        if r is not None and r.unevenness > _UNEVEN
    ]
    if uneven:
        notes.append(
            f"the white is uneven in {_listed(uneven)}: a shadow on it, or another normal or "
            "distance than was given?"
        )
    sights = tuple(None if reading is None else reading.sight for reading in readings)
    return Scale(rgb, std, shared, lean, xyz, measured, tuple(notes), sights)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
