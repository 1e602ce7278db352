"""The MERL database's table of an isotropic BRDF, `.binary` (Matusik et al. 2003).

Three little-endian int32 (90, 90, 180), then red, green and blue, one after the other, as float64
`[θ_h, θ_d, φ_d]`. With h the half vector and d the light seen from h's own frame, the cells
are 90 steps of θ_h, 90 of θ_d to 90 degrees and 180 of φ_d to 180 degrees; a cell's index is

    i = ⌊√(90 θ_h°)⌋,  j = ⌊θ_d°⌋,  k = ⌊φ_d°⌋      (θ_h is finer near the highlight).

Values times 1.00/1500, 1.15/1500 and 1.66/1500 are f_r in 1/sr of red, green and blue (taken as
linear with sRGB primaries; the database does not name them): the reflectance factor is 100 π of
them. A negative value is a hole, as the database has them near the horizon.

**What stands for a cell** is its middle, θ_h = (i + ½)²/90, θ_d = j + ½, φ_d = k + ½, since the
readers that Matusik's code is the model of look up the cell that a geometry lies in.

**What it does not hold.** Anything but isotropic, reciprocal reflection (φ_d + 180 is φ_d: light
and viewer changed; without that both signs of a tilt are kept), geometry finer than its cells,
white, spread, sample, instrument. Half of its cells lie below the horizon.

Source: Matusik's BRDFRead.cpp, as its many ports have it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raden_torch.arrays import Bools, Floats
from raden_torch.capture.exchange.directions import measurement_of
from raden_torch.capture.exchange.polar import directions
from raden_torch.capture.exchange.scatter_grid import Nodes
from raden_torch.errors import InputError
from raden_torch.files import written_beside
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB
from raden_torch.measurement.text_file import read_content

SHAPE = (90, 90, 180)
SCALE = np.array([1.0, 1.15, 1.66]) / 1500
HOLE = -1.0
CELLS = 90 * 90 * 180

_HEADER = np.dtype("<i4")
_VALUE = np.dtype("<f8")
_BYTES = 3 * _HEADER.itemsize + 3 * CELLS * _VALUE.itemsize
_MOST = 1 << 16  # of what looks like a dimension
_LEAST = 10_000  # readings that may be of cells
_OFF = 1e-2  # of a cell: readings of its middle are rounded
_TRACE = 1e-6


def recognises(head: bytes) -> bool:
    """True where three dimensions stand first, in either byte order, of any size."""
    if len(head) < 3 * _HEADER.itemsize:
        return False
    sizes = [np.frombuffer(head[:12], order) for order in ("<i4", ">i4")]
    return any(bool(((n > 0) & (n <= _MOST)).all()) for n in sizes)


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a file; holes are readings that are not valid.

    Raises:
        InputError: other dimensions, another byte order, or a size that does not fit them; told
            before the values are read.
    """
    path = Path(path)
    data = read_content(path, _BYTES)
    sizes = np.frombuffer(data[:12], _HEADER)
    if tuple(sizes.byteswap()) == SHAPE:
        raise InputError(f"{path}: expected little-endian numbers, got big-endian ones")
    if tuple(sizes) != SHAPE:
        raise InputError(
            f"{path}: expected a MERL table of {' x '.join(map(str, SHAPE))} cells, got "
            f"{' x '.join(map(str, sizes))}"
        )
    if len(data) != _BYTES:
        raise InputError(
            f"{path}: expected {_BYTES} bytes of 3 x {CELLS} numbers, got {len(data)}: the file "
            f"is {'truncated' if len(data) < _BYTES else 'too long'}"
        )
    values = np.frombuffer(data, _VALUE, offset=12).reshape(3, CELLS).T
    if not np.isfinite(values).all():
        cell = int(np.argmin(np.isfinite(values).all(axis=1)))
        raise InputError(f"{path}: cell {cell + 1}: expected finite numbers, got {values[cell]}")
    light, view = cell_directions()
    hole: Bools = np.asarray((values < 0).any(axis=1))
    above = (light[2] > 0) & (view[2] > 0)
    factors = np.where(hole[:, None], np.nan, values * SCALE * FACTOR_PER_SR)
    notes = ["R, G, B taken as linear with sRGB primaries"]
    if (hole & above).any():
        notes.append(f"{int((hole & above).sum())} holes (negative values), not valid")
    return measurement_of(
        path,
        light,
        view,
        factors,
        RGB,
        metadata=Metadata(path.stem, notes=tuple(notes)),
        valid=~hole,
    )


def cell_directions() -> tuple[Floats, Floats]:
    """Light and view `[3, M]` of the middle of each cell, in the order of the file; N = +z."""
    theta_h = np.deg2rad((np.arange(SHAPE[0]) + 0.5) ** 2 / SHAPE[0])
    theta_d = np.deg2rad(np.arange(SHAPE[1]) + 0.5)
    phi_d = np.deg2rad(np.arange(SHAPE[2]) + 0.5)
    h, d, phi = (x.ravel() for x in np.meshgrid(theta_h, theta_d, phi_d, indexing="ij"))
    x, y, z = np.sin(d) * np.cos(phi), np.sin(d) * np.sin(phi), np.cos(d)
    along = np.stack([np.sin(h) * z, np.zeros_like(h), np.cos(h) * z])  # the part along h
    across = np.stack([np.cos(h) * x, y, -np.sin(h) * x])
    return along + across, along - across


def positions(angles_deg: Floats) -> Floats:
    """`[3, M]`: where angles `[M, 3]` lie among the cells, counted from the middle of the first."""
    light, view = directions(angles_deg)
    half = light + view
    half /= np.linalg.norm(half, axis=0)
    across = np.hypot(half[0], half[1])
    turn = np.arctan2(half[1], half[0])
    # the light, turned about z so that the half vector's azimuth is 0, then about y onto z
    x = np.cos(turn) * light[0] + np.sin(turn) * light[1]
    y = np.cos(turn) * light[1] - np.sin(turn) * light[0]
    x, z = half[2] * x - across * light[2], across * x + half[2] * light[2]
    theta_h, theta_d = np.arctan2(across, half[2]), np.arctan2(np.hypot(x, y), z)
    phi_d = np.arctan2(y, x) % np.pi
    i = np.sqrt(SHAPE[0] * np.rad2deg(theta_h))
    return np.stack([i, np.rad2deg(theta_d), np.rad2deg(phi_d)]) - 0.5


@dataclass(frozen=True)
class Cells:
    """Readings of the cells as a function of the angles: linear between the cells' middles, of
    those around that are known.

    Attributes:
        table: `[90, 90, 180, C]`; NaN in holes.
    """

    table: Floats

    @classmethod
    def of(cls, measurement: BrdfMeasurement) -> Cells | None:
        """None where the readings are not of cells."""
        known = measurement.select(measurement.valid)
        if len(known) < _LEAST:
            return None
        place = positions(known.angles_deg)
        cell = np.rint(place)
        cell[2] %= SHAPE[2]
        off = abs(place - np.rint(place)).max(axis=1)
        if (off > _OFF).any() or (cell.max(axis=1) >= SHAPE).any():
            return None
        table = np.full((*SHAPE, len(known.channels)), np.nan)
        table[tuple(cell.astype(np.intp))] = known.values
        return cls(table)

    def __call__(self, angles_deg: Floats) -> Floats:
        """`[M, 3]` → `[M, C]`; NaN where no cell around is known."""
        place = positions(angles_deg)
        highest = np.array(SHAPE)[:, None] - 1
        place[:2] = np.clip(place[:2], 0, highest[:2])
        low = np.floor(place)
        share = place - low
        total = np.zeros((len(angles_deg), self.table.shape[-1]))
        weight = np.zeros(len(angles_deg))
        for corner in np.indices((2, 2, 2)).reshape(3, -1).T:
            at = (low + corner[:, None]).astype(np.intp)
            at[:2] = np.minimum(at[:2], highest[:2])
            at[2] %= SHAPE[2]  # φ_d + 180 is φ_d
            own = np.where(corner[:, None], share, 1 - share).prod(axis=0)
            value = self.table[tuple(at)]
            there = ~np.isnan(value).any(axis=1)
            total[there] += own[there, None] * value[there]
            weight[there] += own[there]
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(weight[:, None] > _TRACE, total / weight[:, None], np.nan)


def nodes() -> Nodes:
    """The cells' geometries."""
    light, view = cell_directions()
    return Nodes.of(light, view, np.zeros(CELLS))


def write(path: Path, f_r: Floats) -> None:
    """Write a table.

    Args:
        f_r: `[M, 3]` in 1/sr, linear RGB, in the order of `nodes()`; NaN is a hole, and so is what
            lies below the horizon.
    """
    values = np.where(np.isnan(f_r).any(axis=1, keepdims=True), HOLE, f_r / SCALE)
    with written_beside(path) as temporary, temporary.open("wb") as file:
        file.write(np.array(SHAPE, _HEADER).tobytes())
        file.write(np.ascontiguousarray(values.T, _VALUE).tobytes())
