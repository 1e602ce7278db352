"""Spectral fits: integrating readings before the fit, or bands after it, is one colour."""

from __future__ import annotations

from dataclasses import replace

import colour
import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.fitting.spectral_fit import SpectralFit, fit_spectral
from raden_torch.brdf.shading.by_band import shade_bands
from raden_torch.brdf.shading.sphere_gbuffer import sphere
from raden_torch.errors import InputError
from raden_torch.measurement.readings import XYZ

LAMP = rt.DirectionalLight((1, 1, 2))
OBSERVER = "CIE 1931 2 Degree Standard Observer"


@pytest.fixture(scope="module")
def bands() -> rt.BrdfMeasurement:
    return rt.simulate_specimen("akoya", step_deg=35, spectral=True)


@pytest.fixture(scope="module")
def found(bands: rt.BrdfMeasurement) -> SpectralFit:
    return fit_spectral(bands)


def _pictures(one: object, other: object) -> tuple[torch.Tensor, torch.Tensor]:
    ball = sphere(48, samples=1)
    with torch.no_grad():
        first, second = (rt.shade(m, ball, LAMP) for m in (one, other))  # type: ignore[arg-type]
    return first, second


def _share(one: object, other: object) -> float:
    """The RMS difference of two spheres over the RMS of the second."""
    first, second = _pictures(one, other)
    return float((first - second).square().mean().sqrt() / second.square().mean().sqrt())


def test_under_d65_it_is_the_rgb_model(found: SpectralFit) -> None:
    assert _share(found.model.under("D65"), found.in_rgb.model) < 3e-3


@pytest.mark.parametrize("name", ["A", "FL11", "LED-B3"])
def test_under_another_light_it_is_the_fit_of_its_colours(
    bands: rt.BrdfMeasurement, found: SpectralFit, name: str
) -> None:
    """The readings' colours under the illuminant by colour-science, fitted in XYZ."""
    shape = colour.SpectralShape(360, 780, 1)
    every_nm = [np.interp(shape.range(), bands.wavelengths_nm, row) for row in bands.values / 100]
    cmfs = colour.MSDS_CMFS[OBSERVER].copy().align(shape)
    light = colour.SDS_ILLUMINANTS[name].copy().align(shape)
    found_by = {"method": "Integration", "shape": shape}
    xyz = np.asarray(colour.msds_to_XYZ(np.stack(every_nm), cmfs, light, **found_by))
    lit = replace(bands, values=xyz, channels=XYZ, metadata=replace(bands.metadata, white=name))
    assert _share(found.model.under(name), rt.fit(lit).model) < 8e-3
    assert _share(found.model.under(name), found.in_rgb.model) > 2e-2


def test_a_white_diffuser_is_white_in_every_band() -> None:
    deg = np.mgrid[0:71:35, -70:71:35, -70:71:35].reshape(3, -1)
    names = tuple(f"{nm}nm" for nm in range(400, 701, 20))
    white = rt.BrdfMeasurement(*deg, np.full((75, len(names)), 100.0), channels=names)
    model = fit_spectral(white).model
    assert torch.allclose(model.values, torch.tensor(1 / torch.pi), rtol=1e-5)
    up = torch.tensor([0.0, 0.0, 1.0]).view(1, 3, 1, 1)
    gbuffer, lamp = rt.GBuffer(up, view=(0, 0, 1)), rt.DirectionalLight((0, 0, 1))
    for name in ("D65", "A", "FL11", "LED-RGB1"):
        image = rt.shade(model.under(name), gbuffer, lamp).flatten().tolist()
        assert image == pytest.approx([1, 1, 1], rel=1e-5)
    assert shade_bands(model, gbuffer, lamp).flatten().tolist() == pytest.approx([1] * 16, rel=1e-5)


@pytest.mark.parametrize(
    "kind",
    [
        *("gaps", "far gaps", "one side", "one plane"),
        pytest.param("scattered", marks=pytest.mark.slow),
    ],
)
def test_what_was_not_measured_is_filled_as_in_rgb(kind: str) -> None:
    options, most = {}, 0.01
    if kind == "scattered":
        random = np.random.default_rng(1)
        at = random.uniform([0, -70, -70], 70, (220, 3))
        bands = rt.simulate_specimen("akoya", geometries_deg=at, spectral=True)
    elif kind == "one plane":
        at = np.mgrid[0:71:10, -70:71:10, 0:1].reshape(3, -1).T
        bands = rt.simulate_specimen("akoya", geometries_deg=at, spectral=True)
    else:
        step = 14.0 if kind == "far gaps" else 35.0
        bands = rt.simulate_specimen("akoya", step_deg=step, spectral=True)
    # fewer bands, for time
    keep = slice(0, None, 8)
    bands = replace(bands, values=bands.values[:, keep], channels=bands.channels[keep])
    if kind == "gaps":
        bands = bands.select(np.arange(len(bands)) % 9 > 0)
    elif kind == "far gaps":
        bands = bands.select((bands.tilt_deg < 0) | (abs(bands.receiving_deg) < 20))
    elif kind == "one side":
        bands, options = bands.select(bands.tilt_deg >= 0), {"assume": "isotropic"}
    elif kind == "one plane":
        options = {"assume": "isotropic"}
    if kind in ("one plane", "scattered"):  # few readings far apart: kriged logarithms do not add
        options, most = {**options, "interpolation": "trilinear"}, 0.08
    result = fit_spectral(bands, **options)  # type: ignore[arg-type]
    assert torch.isfinite(result.model.values).all()
    assert _share(result.model.under("D65"), result.in_rgb.model) < most


def test_what_is_refused(bands: rt.BrdfMeasurement) -> None:
    with pytest.raises(InputError, match=r"expected spectral bands .* got channels X, Y, Z"):
        fit_spectral(rt.simulate_specimen("akoya", step_deg=35))
    green = replace(bands, values=bands.values[:, 20:40], channels=bands.channels[20:40])
    with pytest.raises(InputError, match=r"expected bands that span 400…700 nm"):
        fit_spectral(green)
    few = replace(bands, values=bands.values[:, ::16], channels=bands.channels[::16])
    with pytest.raises(InputError, match="expected bands at most 40 nm apart"):
        fit_spectral(few)
    with pytest.raises(InputError, match="measurement: expected BrdfMeasurement"):
        fit_spectral("bands.csv")  # type: ignore[arg-type]
