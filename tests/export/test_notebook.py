"""A model at the end of a notebook's cell, run by a real kernel and shown by a real browser."""

from __future__ import annotations

import copy
import subprocess
import sys
from functools import cache
from pathlib import Path

import nbformat
import numpy as np
import pytest

import raden_torch as rt
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.export.notebook import viewer_frame
from tests.export.browser import needs_browser, opened, pixels, sphere_by_shade

CELLS = (
    'import raden_torch as rt\nmodel = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model',
    "model",
    "from raden_torch.brdf.materials.palette import Palette\nPalette([model])",
)


@pytest.fixture
def shell() -> rt.RadenBrdf:
    """Of its own, but fitted once."""
    return copy.deepcopy(fitted())


@cache
def fitted() -> rt.RadenBrdf:
    return rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model


def run(folder: Path) -> list[dict[str, str]]:
    """What each cell shows, by media type."""
    cells = [nbformat.v4.new_code_cell(text) for text in CELLS]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), folder / "model.ipynb")
    script = (
        "import nbformat, nbclient\n"
        "n = nbformat.read('model.ipynb', as_version=4)\n"
        "nbclient.NotebookClient(n, timeout=300, kernel_name='python3').execute()\n"
        "nbformat.write(n, 'run.ipynb')\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=folder, capture_output=True, text=True, timeout=400
    )
    assert done.returncode == 0, done.stderr[-2000:]
    cells = nbformat.read(folder / "run.ipynb", as_version=4).cells
    return [cell.outputs[0]["data"] if cell.outputs else {} for cell in cells]


@needs_browser
@pytest.mark.slow
def test_a_cell_that_ends_with_a_model_shows_the_viewer(shell, tmp_path):
    _, shown, palette = run(tmp_path)
    assert list(palette) == ["text/plain"]
    assert palette["text/plain"].startswith("Palette(")
    assert shown["text/plain"].startswith("RadenBrdf(")
    assert shown["text/html"].startswith("<p>akoya (simulated: computed, not measured)</p>")
    assert len(shown["text/html"]) < 3_000_000
    page = tmp_path / "output.html"
    page.write_text(f"<!doctype html><meta charset=utf-8>{shown['text/html']}")
    with opened() as browser:
        (first,) = browser.visit(page, width=900, frame=True, scale=0.3)
    assert first["label"] == "Simulated: akoya is computed, not measured."
    wanted, inside = sphere_by_shade(shell, first["width"], first["height"])
    difference = abs(pixels(first["picture"]) - wanted).max(axis=-1)[inside]
    assert wanted[inside].max() > 200
    assert np.percentile(difference, 99) <= 1


def test_a_model_without_a_viewer_is_text(shell):
    shell.layout = RuntimeLayout((8, 8, 400), (0.4, 0.4))
    assert viewer_frame(shell) is None


def test_a_name_stays_text(shell):
    shell.provenance = type(shell.provenance)(sample='"><script>alert(1)</script>')
    shown = viewer_frame(shell)
    assert shown is not None
    outside = shown[: shown.index("srcdoc=")]
    assert "<script" not in outside
    assert shown.count('"') == 10  # five attributes, each whole
