"""A `measured` file read back: is it whole, and does Mitsuba read what we do?"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.exchange.tensor_fields import read_fields
from raden_torch.errors import InputError
from raden_torch.export.measured.fields import Measured
from raden_torch.export.measured.warp import Warp
from raden_torch.packages import require

LIMIT = 2e-3
"""The largest difference allowed, over the peak: the readers compute in single precision."""

_PAIRS = 1000
_MEAN_LIMIT = 1e-3


@dataclass(frozen=True)
class MeasuredCheck:
    """How Mitsuba reads a file.

    Attributes:
        variant: of Mitsuba.
        pairs: how many pairs of directions were compared.
        mean: Σ|difference| over Σ|f_r cos θi|.
        largest: the largest difference of f_r cos θi over the largest f_r cos θi.
    """

    variant: str
    pairs: int
    mean: float
    largest: float

    def __str__(self) -> str:
        return (
            f"Mitsuba's measured ({self.variant}): same reflection, {self.pairs} pairs of "
            f"directions, off by {self.mean:.1e} of it and at most {self.largest:.1e} of its peak"
        )


def verify_measured(path: str | os.PathLike[str]) -> MeasuredCheck:
    """Compare what Mitsuba's `measured` reads in a file with what the format's definition says.

    Raises:
        InputError: no such file, cut, damaged, or of several azimuths; Mitsuba is not installed,
            cannot read it, or has another reflection.
    """
    path = Path(path)
    measured, nm = read_measured(path)
    require("checks of measured files", "simulate")
    import mitsuba as mi

    variant = "scalar_rgb" if nm is None else "scalar_spectral"
    mi.set_variant(variant)
    try:
        bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    except RuntimeError as error:
        line = str(error).strip().splitlines()[-1]
        raise InputError(f"{path}: Mitsuba cannot read it: {line}") from None
    light, view = _pairs(_PAIRS)
    bands = np.arange(3) if nm is None else np.linspace(0, len(nm) - 1, 4).astype(int)
    wanted = measured.f_r(light, view)[:, bands] * light[:, 2:]
    got = _in_mitsuba(mi, bsdf, light, view, None if nm is None else nm[bands])
    off, peak = np.abs(got - wanted), np.abs(wanted).max()
    mean = float(off.sum() / max(np.abs(wanted).sum(), 1e-300))
    check = MeasuredCheck(variant, len(light), mean, float(off.max() / max(peak, 1e-300)))
    if not (check.mean <= _MEAN_LIMIT and check.largest <= LIMIT):
        raise InputError(
            f"{path}: expected Mitsuba within {LIMIT:g} of the peak, got {check.largest:.2g}"
        )
    return check


def read_measured(path: str | os.PathLike[str]) -> tuple[Measured, Floats | None]:
    """The reflection in a file of one azimuth, and its wavelengths in nm, None of RGB.

    Raises:
        InputError: no such file, cut, in the other byte order, damaged, or of several azimuths.
    """
    path = Path(path)
    arrays = read_fields(path)
    try:
        return _measured_in(arrays), _wavelengths(arrays)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _measured_in(arrays: Mapping[str, NDArray[Any]]) -> Measured:
    values = "spectra" if "wavelengths" in arrays else "rgb"
    shape = _field(arrays, values, 5).shape
    _, viewers, bands, side, _ = shape
    if len(_field(arrays, "phi_i", 1)) != 1:
        raise InputError("phi_i: expected one, of an isotropic sample, got several")
    if _field(arrays, "jacobian", 1).tolist() != [1]:
        raise InputError("jacobian: expected 1, as pbrt-v4 takes it, got another")
    theta = _field(arrays, "theta_i", 1)
    vndf = _field(arrays, "vndf", 4)
    luminance = _field(arrays, "luminance", 4)
    for name, got, wanted in (
        (values, shape, (1, viewers, 3 if values == "rgb" else bands, side, side)),
        ("theta_i", theta.shape, (viewers,)),
        ("vndf", vndf.shape, (1, viewers, *vndf.shape[2:])),
        ("luminance", luminance.shape, (1, viewers, side, side)),
    ):
        if got != wanted:
            raise InputError(f"{name}: expected shape {list(wanted)}, got {list(got)}")
    if not (np.diff(theta) > 0).all() or (vndf < 0).any() or (vndf.sum((2, 3)) <= 0).any():
        raise InputError("theta_i, vndf: expected rising angles, and densities above 0")
    ndf, sigma = _field(arrays, "ndf", 2), _field(arrays, "sigma", 2)
    warp = Warp.of(theta, vndf[0])
    return Measured(theta, ndf, sigma, warp, luminance[0], _field(arrays, values, 5)[0])


def _field(arrays: Mapping[str, NDArray[Any]], name: str, sides: int) -> Floats:
    """A field in double precision, of so many dimensions and finite."""
    found = arrays.get(name)
    if found is None or found.ndim != sides:
        got = "none" if found is None else f"one of {found.ndim}"
        raise InputError(f"{name}: expected a field of {sides} dimensions, got {got}")
    least = 1 if name in ("phi_i", "jacobian") else 2
    if min(found.shape[1 if sides > 2 else 0 :]) < least:
        raise InputError(f"{name}: expected {least} or more along each axis, got fewer")
    if not np.isfinite(found).all():
        raise InputError(f"{name}: expected finite values, got some that are not")
    return found.astype(np.float64)


def _wavelengths(arrays: Mapping[str, NDArray[Any]]) -> Floats | None:
    if "wavelengths" not in arrays:
        return None
    nm = _field(arrays, "wavelengths", 1)
    if len(nm) != arrays["spectra"].shape[2] or not (np.diff(nm) > 0).all():
        raise InputError("wavelengths: expected one that rises for each band of spectra")
    return nm


def _pairs(count: int) -> tuple[Floats, Floats]:
    random = np.random.default_rng(4)
    z = random.random((2, count))
    turn, sine = 2 * np.pi * random.random((2, count)), np.sqrt(1 - z**2)
    light, view = np.stack([sine * np.cos(turn), sine * np.sin(turn), z], -1)
    return light, view


def _in_mitsuba(mi: Any, bsdf: Any, light: Floats, view: Floats, nm: Floats | None) -> Floats:
    """f_r cos θi `[N, C]` in a scalar variant."""
    si, context, found = mi.SurfaceInteraction3f(), mi.BSDFContext(), []
    if nm is not None:
        si.wavelengths = nm.tolist()
    for to_light, to_view in zip(light.tolist(), view.tolist(), strict=True):
        si.wi = to_view
        found.append([*bsdf.eval(context, si, to_light)])
    return np.array(found)
