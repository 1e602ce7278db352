"""The drawings of docs/conventions.md show what `raden_angles` measures."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch

import raden_torch as rt

PICTURES = Path(__file__).parents[2] / "docs/pictures"


@pytest.fixture(scope="module")
def angles() -> ModuleType:
    pytest.importorskip("matplotlib", reason="Matplotlib, of the extra `plots`, is not installed")
    spec = importlib.util.spec_from_file_location("angles", PICTURES / "angles.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("deg", [(50.0, 30.0, 0.0), (50.0, 30.0, 30.0), (65.0, 35.0, 42.0)])
def test_the_vectors_on_paper_have_the_angles(
    angles: ModuleType, deg: tuple[float, float, float]
) -> None:
    v = angles.drawn_vectors(*deg)
    n, light, view = (torch.from_numpy(v[name]).view(3, 1, 1) for name in "NLV")
    found = [float(x.rad2deg()) for x in rt.raden_angles(n, light, view)]
    np.testing.assert_allclose(found, deg, atol=1e-9)
    np.testing.assert_allclose(v["p"], [0, 1, 0], atol=1e-12)  # into the page
    np.testing.assert_allclose(v["N′"], [0, 0, 1], atol=1e-12)
    assert abs(v["L"][1]) < 1e-12
    assert v["L"][0] < 0 < v["V"][0]


def test_the_files_are_what_the_script_draws(angles: ModuleType, tmp_path: Path) -> None:
    """By what is written in them: coordinates change with Matplotlib's version."""
    angles.main(tmp_path)
    label = re.compile(r"<text[^>]*>([^<]+)</text>|<tspan[^>]*>([^<]+)</tspan>")
    for name in angles.DRAWINGS:
        kept, fresh = (
            sorted(label.findall((folder / name).read_text("utf-8")))
            for folder in (PICTURES, tmp_path)
        )
        assert len(kept) > 4
        assert fresh == kept
