"""Shading in RGB against shading by wavelength, and metamerism: a simulated shell on a lit sphere.

Truth is the simulation itself at each pixel, integrated by colour-science (ASTM E308). Every colour
is seen by an eye that is adapted to the lamp (Bradford); ΔE2000, exposed so that the truth's 99.5 %
quantile of Y under D65 is white. Printed for each illuminant, median and 95 % over the pixels:

- spectral: the spectral model against the truth;
- rgb x lamp: the RGB model, lit by a lamp of the illuminant's RGB, against the truth;
- x lamp, white lamp: the truth's own RGB under D65, lit by a lamp of the illuminant's RGB, and left
  as it is, against the truth: the error of shading in RGB alone, without a model's;
- integrals: the truth's spectra, integrated as `Illuminant` does it, against ASTM E308;
- metamer: the shell beside a pigment that has, in every geometry, the same colour under D65: the
  smoothest spectrum of these X, Y, Z (least squares of its second differences).

With --feather it prints "x lamp", "white lamp" and "metamer" of measured spectra instead: a duck's
iridescent wing at angles 5 degrees apart (`shared/data/iridescence/teal.rda`, of pavo).

With --out it draws the sphere under each of them, the shell above, the pigment below.
"""

from __future__ import annotations

import argparse
import gzip
import re
import struct
import time
from pathlib import Path

import colour
import numpy as np
import torch
from torch import Tensor

import raden_torch as rt
from raden_torch import geometry
from raden_torch.arrays import Floats
from raden_torch.brdf.files.display import Display
from raden_torch.brdf.fitting.spectral_fit import fit_spectral
from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.brdf.shading.sphere_gbuffer import average_samples, sphere
from raden_torch.colorimetry import XYZ_TO_SRGB
from raden_torch.measurement.illuminants import Illuminant

ILLUMINANTS = ("D65", "A", "FL11", "LED-B3")
LIGHT = (1.0, 1.0, 2.0)
BOX_DEG = 70.0
OBSERVER = "CIE 1931 2 Degree Standard Observer"
D65 = colour.xy_to_XYZ(colour.CCS_ILLUMINANTS[OBSERVER]["D65"])


def truth(name: str, size: int) -> tuple[Floats, np.ndarray]:
    """`[P, bands]` spectral radiance of the pixels in the measured box, and which these are."""
    gbuffer = sphere(size, samples=1)
    normal = gbuffer.normal.double()
    light = torch.tensor(LIGHT).view(1, 3, 1, 1).expand_as(normal).double()
    angles = torch.cat(geometry.raden_angles(normal, light, gbuffer.view_map(normal)), 1)
    degrees = torch.rad2deg(angles)[0].reshape(3, -1).T.numpy()
    cosine = geometry.dot(normal, geometry.normalised(light)).flatten().numpy()
    on = (gbuffer.mask > 0).flatten().numpy()
    seen = on & (cosine > 0) & (abs(degrees) <= BOX_DEG).all(axis=1)
    bands = rt.simulate_specimen(name, geometries_deg=degrees[seen], spectral=True)
    return bands.values / 100 * cosine[seen, None], seen


def xyz_by_colour(spectra: Floats, nm: Floats, illuminant: str) -> Floats:
    """`[P, 3]`, Y of the white diffuser 1, by ASTM E308."""
    table = colour.MultiSpectralDistributions(spectra.T, nm)
    cmfs, light = colour.MSDS_CMFS[OBSERVER], colour.SDS_ILLUMINANTS[illuminant]
    return np.asarray(colour.msds_to_XYZ(table, cmfs, light)) / 100


def white_of(nm: Floats, illuminant: str) -> Floats:
    return xyz_by_colour(np.ones((1, len(nm))), nm, illuminant)[0]


def lab(xyz: Floats, white: Floats, exposure: float) -> Floats:
    adapted = colour.chromatic_adaptation(xyz, white, D65, method="Von Kries", transform="Bradford")
    return np.asarray(colour.XYZ_to_Lab(np.maximum(adapted / exposure, 0)))


def apart(first: Floats, second: Floats) -> str:
    difference = colour.delta_E(first, second, method="CIE 2000")
    return f"{np.median(difference):.2f} / {np.quantile(difference, 0.95):.2f}"


def smoothest(nm: Floats) -> Floats:
    """`[N, N]`: spectra `[…, N]` @ it are the smoothest of the same X, Y, Z under D65."""
    weights = Illuminant.of("D65").xyz_weights(nm)
    count = len(weights)
    second = np.diff(np.eye(count), 2, axis=0)
    system = np.block([[second.T @ second, weights], [weights.T, np.zeros((3, 3))]])
    return np.asarray(weights @ np.linalg.solve(system, np.eye(count + 3)[:, count:])[:count].T)


def metamer(model: SpectralBrdf) -> SpectralBrdf:
    """The pigment: linear in X, Y, Z, so it is a table, too."""
    of_bands = torch.from_numpy(smoothest(model.wavelengths_nm))
    values = (model.values.double() @ of_bands).float()
    return SpectralBrdf(values, model.layout, model.wavelengths_nm, model.provenance)


@torch.no_grad()
def pixels(material: object, size: int, seen: np.ndarray) -> Floats:
    image = rt.shade(material, sphere(size, samples=1), rt.DirectionalLight(LIGHT))
    return np.asarray(image[0].double().reshape(3, -1).T.numpy())[seen]


@torch.no_grad()
def picture(models: list[SpectralBrdf], size: int) -> Tensor:
    """`[1, 3, rows · size, columns · size]`, scene-linear."""
    ball, lamp = sphere(size), rt.DirectionalLight(LIGHT)
    rows = [
        torch.cat([average_samples(rt.shade(m.under(x), ball, lamp), 2) for x in ILLUMINANTS], -1)
        for m in models
    ]
    return torch.cat(rows, -2)


def feather(path: Path) -> None:
    """Spectra of the file: R's vectors of 401 numbers, 300…700 nm, one for each of 12 angles."""
    data = gzip.decompress(path.read_bytes())
    head = struct.pack(">ii", 14, 401)
    at = [m.end() for m in re.finditer(re.escape(head), data)]
    nm = np.arange(380.0, 701.0)
    spectra = [np.frombuffer(data, ">f8", 401, start)[80:] for start in at]
    every = np.array(spectra, np.float64) / 100
    exposure = float(xyz_by_colour(every, nm, "D65")[:, 1].max())
    print(
        f"{path.name}: {len(every)} spectra, {nm[0]:g}…{nm[-1]:g} nm: x lamp | white lamp | metamer"
    )
    for name in ILLUMINANTS:
        white, own = white_of(nm, name), xyz_by_colour(every, nm, "D65") @ XYZ_TO_SRGB.T
        wanted = lab(xyz_by_colour(every, nm, name), white, exposure)
        lit = own * (XYZ_TO_SRGB @ white) @ np.linalg.inv(XYZ_TO_SRGB).T
        plain = own @ np.linalg.inv(XYZ_TO_SRGB).T
        pigment = lab(xyz_by_colour(every @ smoothest(nm), nm, name), white, exposure)
        parts = (lab(lit, white, exposure), lab(plain, D65, exposure), pigment)
        print(f"{name}: {' | '.join(apart(x, wanted) for x in parts)}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shell", default="yakogai")
    parser.add_argument("--step", type=float, default=5.0, help="of the measurement, degrees")
    parser.add_argument("--size", type=int, default=96, help="of the sphere, pixels")
    parser.add_argument("--out", type=Path, help="the picture to write")
    parser.add_argument("--feather", type=Path, help="teal.rda")
    options = parser.parse_args()
    if options.feather:
        feather(options.feather)
        return
    torch.set_num_threads(1)
    bands = rt.simulate_specimen(options.shell, step_deg=options.step, spectral=True)
    rt.fit(rt.simulate_specimen(options.shell, step_deg=35), interpolation="trilinear")  # warm
    start = time.process_time()
    found = fit_spectral(bands)
    took = time.process_time() - start
    start = time.process_time()
    rt.fit(bands)
    in_rgb = time.process_time() - start
    print(f"{found.model!r}: {took:.0f} s of processor time; in RGB {in_rgb:.0f} s", flush=True)
    nm = found.model.wavelengths_nm
    spectra, seen = truth(options.shell, options.size)
    pigment = metamer(found.model)
    exposure = float(np.quantile(xyz_by_colour(spectra, nm, "D65")[:, 1], 0.995))
    srgb = pixels(found.in_rgb.model, options.size, seen)
    columns = "spectral | rgb x lamp | x lamp | white lamp | integrals | metamer"
    print(f"{options.shell}, {seen.sum()} pixels: {columns}")
    print(f"pigment below 0: {float((pigment.values < 0).float().mean()):.1%} of its table")
    for name in ILLUMINANTS:
        white = white_of(nm, name)
        wanted = lab(xyz_by_colour(spectra, nm, name), white, exposure)
        to_xyz = np.linalg.inv(XYZ_TO_SRGB).T
        lamp = XYZ_TO_SRGB @ white
        ours, other = (
            lab(pixels(m.under(name), options.size, seen) @ to_xyz, D65, exposure)
            for m in (found.model, pigment)
        )
        lit = lab(srgb * lamp @ to_xyz, white, exposure)
        own = xyz_by_colour(spectra, nm, "D65") @ XYZ_TO_SRGB.T
        exact, plain = lab(own * lamp @ to_xyz, white, exposure), lab(own @ to_xyz, D65, exposure)
        summed = lab(spectra @ Illuminant.of(name).rgb_weights(nm) @ to_xyz, D65, exposure)
        parts = (apart(x, wanted) for x in (ours, lit, exact, plain, summed))
        print(f"{name}: {' | '.join(parts)} | {apart(ours, other)}", flush=True)
    if options.out:
        caption = f"simulated specimen: {options.shell}; {', '.join(ILLUMINANTS)}"
        Display().write(picture([found.model, pigment], 256), options.out, caption)


if __name__ == "__main__":
    main()
