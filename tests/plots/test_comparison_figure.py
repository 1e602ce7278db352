"""Two measurements against each other: what is drawn is their difference over its deviation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.compare import compare
from raden_torch.plots import draw_comparison


@pytest.fixture(scope="module")
def pair() -> tuple[BrdfMeasurement, BrdfMeasurement]:
    """The second brighter by two standard deviations of the difference at positive tilts."""
    axes = np.meshgrid(np.arange(0, 71, 10.0), *[np.arange(-70, 71, 10.0)] * 2, indexing="ij")
    a, r, t = (axis.ravel() for axis in axes)
    values = (20 + 80 * np.exp(-(((r - a) ** 2 + t**2) / 300)))[:, None] * np.ones(3)
    first = BrdfMeasurement(a, r, t, values, std=0.03 * values, metadata=Metadata("first"))
    more = np.where(first.tilt_deg > 0, 2 * np.sqrt(2) * 0.03, 0.0)
    second = replace(first, values=first.values * (1 + more[:, None]), metadata=Metadata("second"))
    return first, replace(second, std=first.std)


@pytest.fixture(scope="module")
def figure(pair: tuple[BrdfMeasurement, BrdfMeasurement]) -> Figure:
    return draw_comparison(*pair)


def panel(figure: Figure, title: str) -> Any:
    (found,) = [ax for ax in figure.axes if ax.get_title(loc="left").startswith(title)]
    return found


@pytest.mark.parametrize("incidence", [0, 30, 60])
def test_maps_are_the_deviations_where_they_were_read(
    figure: Figure, pair: tuple[BrdfMeasurement, BrdfMeasurement], incidence: int
) -> None:
    ax = panel(figure, f"incidence {incidence}°")
    (points,) = ax.collections
    first = pair[0]
    rows = first.incidence_deg == incidence
    np.testing.assert_array_equal(points.get_offsets(), first.angles_deg[rows, 1:])
    expected = np.where(first.tilt_deg[rows] > 0, 2.0, 0.0)
    np.testing.assert_allclose(points.get_array(), expected, atol=1e-9)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("receiving (deg)", "tilt (deg)")


def test_the_colours_are_one_scale_with_its_unit(figure: Figure) -> None:
    (bar,) = [ax for ax in figure.axes if "(second − first) / std in Y" in ax.get_ylabel()]
    assert bar.get_ylim() == (-4, 4)
    assert panel(figure, "incidence 0°").collections[0].norm.vcenter == 0


def test_a_slab_without_readings_says_so(figure: Figure, pair) -> None:
    ax = panel(figure, "incidence 15°")
    assert [text.get_text() for text in ax.texts] == ["not compared there"]
    assert not ax.collections


def test_the_distribution_is_a_density_by_region(figure: Figure, pair) -> None:
    ax = panel(figure, "grey: as stated")
    c = compare(*pair)
    middles = np.arange(-4.9, 5.0, 0.2)
    masks = {name: mask for name, mask in c.region_masks.items() if name != "all"}
    drawn = {line.get_label(): line.get_data() for line in ax.lines}
    assert set(drawn) == {f"{name} ({mask.sum()})" for name, mask in masks.items()}
    for name, mask in masks.items():
        x, y = drawn[f"{name} ({mask.sum()})"]
        np.testing.assert_allclose(x, middles, atol=1e-12)
        assert y.sum() * 0.2 == pytest.approx(1.0)
        share = np.mean(c.deviations[mask] > 1)  # the brighter half: all of it in the bin of 2
        assert y[(middles > 1.7) & (middles < 2.3)].sum() * 0.2 == pytest.approx(share)
    stated = ax.collections[0].get_paths()[0].vertices[:, 1].max()
    assert stated == pytest.approx(1 / np.sqrt(2 * np.pi), rel=0.01)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("(second − first) / std", "density")


def test_the_head_names_both_and_the_verdict(figure: Figure, pair) -> None:
    head = figure.get_suptitle()
    assert head.startswith("second  against  first\n")
    assert head.splitlines()[1] == str(compare(*pair)).splitlines()[-1]
    simulated = replace(pair[0], metadata=Metadata("first", simulated=True))
    assert "simulated: first" in draw_comparison(simulated, pair[1]).get_suptitle()
