"""The file of `measured` BSDFs, written by the tests' own code and evaluated by Mitsuba."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.capture.exchange import load_measurement
from raden_torch.capture.exchange.tensor_file import warped
from raden_torch.errors import InputError
from raden_torch.measurement.readings import FACTOR_PER_SR, RGB


def tensor_file(path: Path, fields: dict[str, np.ndarray]) -> Path:
    kinds = {"u1": 1, "f4": 10}
    head = b"tensor_file\0" + struct.pack("<BBI", 1, 0, len(fields))
    size = len(head) + sum(2 + len(n) + 11 + 8 * a.ndim for n, a in fields.items())
    body = b""
    for name, array in fields.items():
        head += struct.pack("<H", len(name)) + name.encode()
        head += struct.pack("<HBQ", array.ndim, kinds[array.dtype.str[1:]], size + len(body))
        head += struct.pack(f"<{array.ndim}Q", *array.shape)
        body += array.tobytes()
    path.write_bytes(head + body)
    return path


def smooth(random: np.random.Generator, *shape: int) -> np.ndarray:
    """Random, with one value where places are one direction: round in φ, constant at the pole."""
    table = (0.5 + random.random(shape)).astype("f4")
    table[..., -1, :] = table[..., 0, :]
    table[..., 0] = table[..., :1, 0]
    if len(shape) > 2:  # incidence from −180 is from 180
        table[-1] = table[0]
    return table


def fields(azimuths: int = 1, **more: np.ndarray) -> dict[str, np.ndarray]:
    random = np.random.default_rng(0)
    phi = np.zeros(1) if azimuths == 1 else np.linspace(-np.pi, np.pi, azimuths)
    lead = (azimuths, 4)
    sigma = smooth(random, 3, 7)
    if azimuths == 1:
        sigma[:] = sigma[0]
    return {
        "phi_i": phi.astype("f4"),
        "theta_i": np.deg2rad([5, 25, 45, 65]).astype("f4"),
        "ndf": smooth(random, 4, 9),
        "sigma": sigma,
        "vndf": smooth(random, *lead, 12, 10),
        "luminance": smooth(random, *lead, 6, 6),
        "rgb": smooth(random, *lead, 3, 6, 6),
        "jacobian": np.ones(1, "u1"),
        "description": np.frombuffer(b"a card", "u1"),
        **more,
    }


def test_density_is_sampled_as_it_is_integrated() -> None:
    """Rationale: of the density 1 + x (times 1 + 2 y) the shares below x and y are known."""
    grid = np.linspace(0, 1, 5)
    density = (1 + 2 * grid)[:, None] * (1 + grid)
    x, y = np.random.default_rng(0).random((2, 200))
    u, v = warped(density, x, y)
    np.testing.assert_allclose((u + u**2 / 2) / 1.5, x, atol=1e-12)
    np.testing.assert_allclose((v + v**2) / 2, y, atol=1e-12)


@pytest.mark.parametrize("azimuths", [1, 5])
def test_nodes_are_what_mitsuba_evaluates(tmp_path: Path, azimuths: int) -> None:
    """Rationale: Mitsuba inverts the warp that we sample; its value over the cosine is f_r."""
    mi = pytest.importorskip("mitsuba")
    before = mi.variant()
    mi.set_variant("scalar_rgb")
    path = tensor_file(tmp_path / "a.bsdf", fields(azimuths))
    m = load_measurement(path)
    assert (m.channels, m.metadata.sample) == (RGB, "a card")
    assert m.azimuths == (1 if azimuths == 1 else azimuths - 1)  # −180 is 180
    bsdf = mi.load_dict({"type": "measured", "filename": str(path)})
    angles = (torch.from_numpy(np.deg2rad(x))[None, :, None] for x in m.angles_deg.T)
    light, view = (v[..., 0].numpy() for v in rt.vectors_from_angles(*angles)[1:])
    turn = -np.arctan2(light[1], light[0])
    if m.azimuth_deg is not None:
        turn = turn + np.deg2rad(m.azimuth_deg)
    worst = 0.0
    for row in np.random.default_rng(1).choice(len(m), 60, replace=False):
        c, s = np.cos(turn[row]), np.sin(turn[row])
        wi, wo = (
            mi.Vector3f(c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])
            for v in (light[:, row], view[:, row])
        )
        if wo[2] < 0.05:
            continue
        si = mi.SurfaceInteraction3f()
        si.wi = wi
        f = np.array(bsdf.eval(mi.BSDFContext(), si, wo)) / wo[2]
        worst = max(worst, float(abs(m.values[row] / FACTOR_PER_SR / f - 1).max()))
    if before:
        mi.set_variant(before)
    assert worst < 2e-3  # Mitsuba's single precision


def test_bands_are_read(tmp_path: Path) -> None:
    given = fields(wavelengths=np.array([450, 550, 650, 700], "f4"))
    given["spectra"] = smooth(np.random.default_rng(3), 1, 4, 4, 6, 5)
    del given["rgb"]
    m = load_measurement(tensor_file(tmp_path / "a.bsdf", given))
    assert m.channels == ("450nm", "550nm", "650nm", "700nm")


def test_what_is_wrong_is_one_line(tmp_path: Path) -> None:
    good = tensor_file(tmp_path / "a.bsdf", fields()).read_bytes()
    for data, message in (
        (good[:40], "truncated in its head"),
        (good[:-9], "field 'rgb': expected 1 x 4 x 3 x 6 x 6 numbers, got a file of .* truncated"),
        (good[:12] + b"\2" + good[13:], "version 1.0, got version 2.0"),
    ):
        (tmp_path / "b.bsdf").write_bytes(data)
        with pytest.raises(InputError, match=message) as caught:
            load_measurement(tmp_path / "b.bsdf")
        assert "\n" not in str(caught.value)
    less = fields()
    del less["vndf"]
    with pytest.raises(InputError, match="got no vndf"):
        load_measurement(tensor_file(tmp_path / "c.bsdf", less))
    odd = fields(rgb=np.ones((1, 3, 3, 6, 5), "f4"))
    with pytest.raises(InputError, match="rgb: expected 1 x 4 x 3 x n x n finite"):
        load_measurement(tensor_file(tmp_path / "d.bsdf", odd))
