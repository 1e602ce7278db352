"""The tensor file of Mitsuba's and pbrt's `measured` BSDF, `.bsdf` (RGL, EPFL).

The container is that of `tensor_fields`. Fields: `phi_i` and `theta_i` (radians), `ndf`, `sigma`,
`vndf`, `rgb` or `spectra` with `wavelengths`, `jacobian`, `description`.

Each node of `rgb` (or `spectra`) `[φ_i, θ_i, channel, y, x]` is a reading. Its place in the unit
square, mapped by sampling `vndf` of its incidence (first y by the marginal, then x), is the half
vector's (√(2θ_m/π), (φ_m + π)/2π); the light is where that mirrors the other direction to. The
value times ndf/(4 σ), where `jacobian` says so, is f_r cos θ_o in 1/sr: the reflectance factor is
100 π of it over the cosine. φ_i is kept as the sample's azimuth where there are several; of an
isotropic file φ_m is against φ_i.

**What it does not hold.** White, spread; the primaries of `rgb` (taken as linear, sRGB). Nodes
whose outgoing direction is at or below the horizon are left out, and counted.

Source: Dupuy & Jakob (2018), "An adaptive parameterization for efficient material acquisition and
rendering"; Mitsuba's src/bsdfs/measured.cpp and distr_2d.h.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.directions import measurement_of
from raden_torch.capture.exchange.scatter_grid import light_and_view
from raden_torch.capture.exchange.tensor_fields import MAGIC, fields_in
from raden_torch.errors import InputError
from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB
from raden_torch.measurement.text_file import read_content

MAX_BYTES = 500_000_000
_NEEDED = ("phi_i", "theta_i", "ndf", "sigma", "vndf")
_DIGITS = 4  # of single precision's degrees
_LEAST_COSINE = 1e-3  # of the outgoing direction: what is divided by it says nothing nearer


def recognises(head: bytes) -> bool:
    """True where the file's magic stands first."""
    return head.startswith(MAGIC)


def read(path: str | os.PathLike[str]) -> BrdfMeasurement:
    """Read a file's nodes.

    Raises:
        InputError: truncated, without a field that is needed, or with fields that do not fit.
    """
    path = Path(path)
    fields = _fields(path, read_content(path, MAX_BYTES))
    missing = [name for name in _NEEDED if name not in fields]
    name = "rgb" if "rgb" in fields else "spectra"
    needed = [name] if name == "rgb" else [name, "wavelengths"]
    missing += [n for n in needed if n not in fields]
    if missing:
        raise InputError(f"{path}: expected the fields of a measured BSDF, got no {missing[0]}")
    phi, theta = (np.ravel(fields[n]).astype(np.float64) for n in ("phi_i", "theta_i"))
    values = fields[name].astype(np.float64)
    channels = RGB if name == "rgb" else _bands(fields["wavelengths"])
    vndf = fields["vndf"].astype(np.float64)
    ndf, sigma = (fields[n].astype(np.float64) for n in ("ndf", "sigma"))
    lead = (len(phi), len(theta))
    for what, array, shape in (
        (name, values, (*lead, len(channels), -1, -1)),
        ("vndf", vndf, (*lead, -1, -1)),
        ("ndf", ndf, (-1, -1)),
        ("sigma", sigma, (-1, -1)),
    ):
        _check(path, what, array, shape)
    with_jacobian = bool(np.ravel(fields.get("jacobian", np.zeros(1)))[0])
    isotropic = len(phi) <= 2
    parts = [
        _readings(values[p, t], vndf[p, t], phi[p], theta[t], isotropic)
        for p in range(1 if isotropic else len(phi))
        for t in range(len(theta))
    ]
    theta_i, phi_i, half, cells = (np.concatenate(x, axis=-1) for x in zip(*parts, strict=True))
    if with_jacobian:
        at_half = _bilinear(ndf, half)
        at_light = _bilinear(
            sigma, np.stack([np.sqrt(2 * theta_i / np.pi), phi_i / 2 / np.pi + 0.5])
        )
        with np.errstate(divide="ignore", invalid="ignore"):
            cells = np.where(at_light > 0, cells * at_half / (4 * at_light), np.nan)
    turned = 0.0 if isotropic else phi_i  # φ_m is against φ_i, or against the sample
    return _measurement(path, fields, theta_i, phi_i, half, cells, channels, turned)


def _readings(
    values: Floats, vndf: Floats, phi: float, theta: float, isotropic: bool
) -> tuple[Floats, Floats, Floats, Floats]:
    """θ_i, φ_i `[M]`, the half vector's square `[2, M]` and values `[C, M]` of one incidence."""
    height, width = values.shape[1:]
    y, x = (
        a.ravel()
        for a in np.meshgrid(*(np.linspace(0, 1, n) for n in (height, width)), indexing="ij")
    )
    one = np.ones_like(x)
    return (
        theta * one,
        (0.0 if isotropic else phi) * one,
        warped(vndf, x, y),
        values.reshape(len(values), -1),
    )


def warped(density: Floats, x: Floats, y: Floats) -> Floats:
    """`[2, M]`: where points `[M]` of the unit square go when a bilinear density `[H, W]` over it
    is sampled: y by the marginal, then x."""
    height, width = density.shape
    rows = np.zeros_like(density)
    rows[:, 1:] = np.cumsum((density[:, 1:] + density[:, :-1]) / 2, axis=1)
    total = rows[:, -1]
    marginal = np.append(0.0, np.cumsum((total[1:] + total[:-1]) / 2))
    wanted = y * marginal[-1]
    row = np.clip(np.searchsorted(marginal, wanted, "right") - 1, 0, height - 2)
    v = _solved(wanted - marginal[row], total[row], total[row + 1])
    sums = (1 - v)[:, None] * rows[row] + v[:, None] * rows[row + 1]
    wanted = x * sums[:, -1]
    column = np.clip((sums <= wanted[:, None]).sum(axis=1) - 1, 0, width - 2)
    each = np.arange(len(x))
    between = (1 - v)[:, None] * density[row] + v[:, None] * density[row + 1]
    u = _solved(wanted - sums[each, column], between[each, column], between[each, column + 1])
    return np.stack([(column + u) / (width - 1), (row + v) / (height - 1)])


def _solved(area: Floats, first: Floats, last: Floats) -> Floats:
    """t in 0…1 with ∫₀ᵗ (first + s (last − first)) ds = area."""
    root = np.sqrt(np.maximum(first**2 - 2 * area * (first - last), 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.where(first + root > 0, 2 * area / (first + root), 0.0)
    return np.asarray(np.clip(t, 0, 1))


def _bilinear(table: Floats, square: Floats) -> Floats:
    """`[M]`: a table `[H, W]` at places (x, y) `[2, M]` of the unit square."""
    height, width = table.shape
    x, y = square[0] * (width - 1), square[1] * (height - 1)
    i, j = (np.clip(np.floor(p).astype(np.intp), 0, n - 2) for p, n in ((x, width), (y, height)))
    u, v = x - i, y - j
    low = (1 - u) * table[j, i] + u * table[j, i + 1]
    high = (1 - u) * table[j + 1, i] + u * table[j + 1, i + 1]
    return np.asarray((1 - v) * low + v * high)


def _measurement(
    path: Path,
    fields: dict[str, NDArray[Any]],
    theta_i: Floats,
    phi_i: Floats,
    half: Floats,
    cells: Floats,
    channels: tuple[str, ...],
    turned: Floats | float,
) -> BrdfMeasurement:
    theta_m = np.pi / 2 * half[0] ** 2
    phi_m = np.pi * (2 * half[1] - 1) - turned + np.pi  # the light is on the side of −x
    light, h = light_and_view(theta_i, phi_m, theta_m, about="normal")
    view = 2 * (light * h).sum(axis=0) * h - light
    kept = (view[2] > _LEAST_COSINE) & np.isfinite(cells).all(axis=0)
    if not kept.any():
        raise InputError(f"{path}: expected nodes above the horizon, got none")
    text = bytes(np.ravel(fields.get("description", np.zeros(0, np.uint8))).astype(np.uint8))
    about = " ".join(text.decode("utf-8", "replace").split())
    notes = [f"{int((~kept).sum())} nodes from at or below the horizon left out"]
    if channels == RGB:
        notes.append("R, G, B taken as linear with sRGB primaries")
    with np.errstate(over="ignore"):  # what overflows is refused as not finite
        factors = FACTOR_PER_SR * cells[:, kept].T / view[2, kept, None]
    return measurement_of(
        path,
        light[:, kept],
        view[:, kept],
        factors,
        channels,
        metadata=Metadata(about or path.stem, notes=tuple(notes)),
        azimuth_deg=np.round(np.rad2deg(phi_i[kept]), _DIGITS) % 360,
        average_repeats=True,
    )


def _bands(wavelengths: NDArray[Any]) -> tuple[str, ...]:
    return tuple(f"{float(nm):g}nm" for nm in np.ravel(wavelengths))


def _check(path: Path, name: str, array: Floats, shape: tuple[int, ...]) -> None:
    fits = array.ndim == len(shape) and all(
        n == wanted if wanted >= 0 else n >= 2 for n, wanted in zip(array.shape, shape, strict=True)
    )
    if not fits or not np.isfinite(array).all():
        wanted = " x ".join("n" if n < 0 else str(n) for n in shape)
        raise InputError(
            f"{path}: {name}: expected {wanted} finite numbers, got "
            f"{' x '.join(map(str, array.shape))}"
        )


def _fields(path: Path, data: bytes) -> dict[str, NDArray[Any]]:
    try:
        return fields_in(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
