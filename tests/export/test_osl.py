"""A model as OSL closures: the fit against known sums, the text against the fit, Cycles."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

import raden_torch as rt
from raden_torch.brdf.materials import microfacet
from raden_torch.errors import InputError
from raden_torch.export.closure_fit import LAST_DEG, LOBES, VIEWS, ClosureFit, Lobe, fit_closures
from raden_torch.export.forms import RuntimeForm, form_of
from raden_torch.export.osl_file import export_osl
from raden_torch.images.exr import read_channels

BPY = "RADEN_TORCH_BPY_PYTHON"
"""A Python with Blender's bpy, which is too large to be installed for the tests alone."""


@pytest.fixture(scope="module")
def model() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("akoya", step_deg=10)).model.requires_grad_(False)


@pytest.fixture(scope="module")
def fit(model: rt.RadenBrdf) -> ClosureFit:
    form = form_of(model, "runtime")
    assert isinstance(form, RuntimeForm)
    return fit_closures(form)


class OfFormula:
    """A reflection in place of a table."""

    def __init__(self, f) -> None:
        self.of_unit_vectors = f


def test_a_lobe_is_the_librarys_own_microfacet() -> None:
    rng = np.random.default_rng(1)
    light, view = rng.normal(size=(2, 200, 3))
    light[:, 2], view[:, 2] = abs(light[:, 2]), abs(view[:, 2])
    light, view = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (light, view))
    maps = [torch.from_numpy(v.T.copy())[None, :, None] for v in (light, view)]
    up = torch.tensor([0.0, 0, 1], dtype=torch.float64).view(1, 3, 1, 1).expand_as(maps[0])
    f = microfacet.lobe(up, *maps, 0.2, torch.ones_like)[0, 0, 0].numpy()
    np.testing.assert_allclose(Lobe(0.2).radiance(light, view), f * light[:, 2], rtol=1e-9)


def test_a_matt_white_is_one_closure() -> None:
    def white(n, l, v):  # noqa: E741
        return torch.full_like(l, 0.8 / np.pi)

    fit = fit_closures(OfFormula(white))
    matt = [lobe.alpha == 0 for lobe in fit.lobes]
    np.testing.assert_allclose(fit.weights[:, matt], 0.8, rtol=1e-9)
    assert np.abs(fit.weights[:, np.logical_not(matt)]).max() < 1e-9
    assert fit.error < 1e-9


@pytest.mark.parametrize("alphas", [(0.15,), (0.15, 0.3)])
def test_a_sum_of_its_own_lobes_is_found(alphas: tuple[float, ...]) -> None:
    """One lobe exactly; of two, the broader may be said by several."""
    colours = np.array([[0.3, 0.3, 0.3], [0.2, 0.1, 0.05], [0.0, 0.1, 0.2]])

    def sum_of(n, l, v):  # noqa: E741
        total = torch.from_numpy(colours[0] / np.pi).view(1, 3, 1, 1)
        for alpha, colour in zip(alphas, colours[1:], strict=False):
            lobe = microfacet.lobe(n, l, v, alpha, torch.ones_like)
            total = total + lobe * torch.from_numpy(colour).view(1, 3, 1, 1)
        return total

    fit = fit_closures(OfFormula(sum_of))
    if len(alphas) == 1:
        assert fit.lobes[:2] == (Lobe(0.0), Lobe(0.15))
        np.testing.assert_allclose(fit.weights[:, :2].mean(0), colours[:2], atol=1e-9)
        assert fit.error < 1e-9
    assert fit.error < 0.04


def test_a_shell_is_nearer_than_gltf_can_say(fit: ClosureFit) -> None:
    assert len(fit.lobes) == len(set(fit.lobes)) == LOBES
    assert fit.weights.shape == (VIEWS, LOBES, 3)
    assert fit.weights.min() >= 0
    assert 0.02 < fit.error < 0.15


def test_the_text_holds_the_fit(model: rt.RadenBrdf, fit: ClosureFit, tmp_path: Path) -> None:
    report = export_osl(model, tmp_path / "shell.osl")
    text = (tmp_path / "shell.osl").read_text("utf-8")
    numbers = re.search(r"weights\[\d+\] = \{([^}]*)\}", text)
    assert numbers is not None
    stored = np.array([float(x) for x in numbers[1].split(",")])
    np.testing.assert_allclose(stored, report.fit.weights.ravel(), rtol=6e-4, atol=1e-12)
    assert text.count("microfacet(") == LOBES - 1
    assert text.count("{") == text.count("}")
    assert "(simulated)" in text
    assert f"{report.fit.error:.0%}" in text
    assert str(report) in str(report.fit.error) or f"{report.fit.error:.0%}" in str(report)


def test_bad_input(model: rt.RadenBrdf, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected .*\.osl"):
        export_osl(model, tmp_path / "shell.txt")
    with pytest.raises(InputError, match="model: expected RadenBrdf"):
        export_osl("shell", tmp_path / "shell.osl")


@pytest.mark.skipif(BPY not in os.environ, reason=f"{BPY} names no Python with bpy")
@pytest.mark.parametrize("sun", [(1, 1, 2), (-1, 0.3, 1)])
def test_cycles_runs_it(model: rt.RadenBrdf, tmp_path: Path, sun: tuple[float, ...]) -> None:
    fit = export_osl(model, tmp_path / "shell.osl").fit
    script, towards = Path(__file__).with_name("render_in_blender.py"), ",".join(map(str, sun))
    words = [script, tmp_path / "shell.osl", tmp_path / "lit.exr", towards, "96"]
    subprocess.run([os.environ[BPY], *map(str, words)], check=True, timeout=300)
    held = read_channels(tmp_path / "lit.exr")
    lit, normal = (
        np.stack([held[f"ViewLayer.{name}.{c}"] for c in channels], -1).astype(float)
        for name, channels in (("Combined", "RGB"), ("Position", "XYZ"))
    )
    ball = np.linalg.norm(normal, axis=-1) > 0.5
    lit, normal = lit[ball], normal[ball] / np.linalg.norm(normal[ball], axis=-1, keepdims=True)
    view = np.array([0, 0, 6]) - normal
    view /= np.linalg.norm(view, axis=-1, keepdims=True)
    light = np.array(sun) / np.linalg.norm(sun)
    cosine = (normal * view).sum(-1)
    counted = (cosine > 0.2) & (normal @ light > 0.05)
    expected = np.zeros_like(lit)
    for k in np.flatnonzero(counted):
        across = view[k] - cosine[k] * normal[k]
        across /= np.linalg.norm(across)
        frame = np.stack([across, np.cross(normal[k], across), normal[k]])
        angle = float(np.degrees(np.arccos(min(cosine[k], 1))))
        expected[k] = np.pi * fit.radiance((frame @ light)[None], min(angle, LAST_DEG))[0]
    off = np.abs(lit - expected)[counted]
    assert off.mean() < 0.015 * expected[counted].mean()
