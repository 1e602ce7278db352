"""Does the stated standard deviation hold what repeating the photographs scatters by?"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from raden_torch.capture.photo.brdf.photo_budget import direction_slopes
from raden_torch.capture.photo.capture_brdf import capture_brdf
from raden_torch.reflectance.regions import regions


@pytest.mark.slow
@pytest.mark.parametrize(("noise", "lean_deg"), [(0.01, 0.0), (0.002, 0.5)], ids=["noise", "lamps"])
def test_repeats_scatter_by_the_stated_deviation(
    sphere: Any, noise: float, lean_deg: float
) -> None:
    """Six series with noise, or lamps that lean by half a degree at random. 50 of them are in
    docs/brdf_from_photographs.md."""
    values, deviations = [], []
    for seed in range(6):
        series = sphere.series(
            lamps=sphere.triples, radius=60.0, noise=noise, lamp_error_deg=lean_deg, seed=seed
        )
        arguments = sphere.arguments(series)
        arguments["setup"] = replace(arguments["setup"], lamp_std_deg=max(lean_deg, 1e-3))
        found = capture_brdf(**arguments, go_on=True)
        values.append(found.measurement.values)
        deviations.append(found.measurement.std)
    z = (np.array(values) - sphere.truth()) / np.array(deviations)
    for name in ("ridge", "body", "grazing"):
        where = regions(found.measurement.angles_deg)[name] & np.isfinite(z).all(axis=(0, 2))
        assert where.sum() > 50
        assert 0.5 < np.sqrt(np.mean(z[:, where] ** 2)) < 1.2, name


def test_the_terms_add_up_and_the_scale_is_not_in_them(sphere: Any) -> None:
    series = sphere.series(lamps=sphere.triples, radius=60.0)
    arguments = sphere.arguments(series)
    arguments["factor"] = replace(arguments["factor"], relative_std=0.02, name="tile 7")
    found = capture_brdf(**arguments)
    m, budget = found.measurement, found.budget
    terms = budget.terms()
    squares = sum(np.square(term) for name, term in terms.items() if name != "scale")
    np.testing.assert_allclose(np.square(m.std), squares)
    np.testing.assert_allclose(terms["scale"][m.valid], 0.02 * np.abs(m.values[m.valid]))
    assert m.metadata.systematic.scale_std == 0.02
    assert m.metadata.systematic.scale_reference == "tile 7"
    for name, term in terms.items():
        assert (term[m.valid] >= 0).all(), name
    assert (terms["colour"][m.valid] == 0).all()  # without a colour file


def test_a_lean_of_the_lamp_on_a_matt_sphere() -> None:
    """R is constant; what is divided by the wrong cosine is off by tan a a radian."""
    nodes = np.array([[45.0, 0.0, 0.0], [0.0, 30.0, 0.0], [60.0, 0.0, 30.0]])
    slopes = direction_slopes(np.full((3, 3), 50.0), np.zeros((3, 3, 3)), nodes)
    wanted = np.radians(50.0) * np.hypot(
        np.tan(np.radians([45, 0, 60])), np.tan(np.radians([0, 0, 30]))
    )
    np.testing.assert_allclose(slopes[:, 0], wanted, rtol=1e-6)
