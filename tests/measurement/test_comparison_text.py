"""What a comparison says in words, against its figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from raden_torch.measurement import BrdfMeasurement, Metadata
from raden_torch.measurement.compare import compare
from raden_torch.measurement.systematic_errors import SystematicErrors


def plane(std: float | None, scale_std: float = 0.0, **metadata) -> BrdfMeasurement:
    axes = np.meshgrid(np.arange(0, 71, 10.0), *[np.arange(-70, 71, 10.0)] * 2, indexing="ij")
    angles = np.stack([axis.ravel() for axis in axes], axis=1)
    values = (50 + 0.2 * angles.sum(axis=1))[:, None] * np.ones(3)
    return BrdfMeasurement(
        *angles.T,
        values=values,
        std=None if std is None else std * values,
        metadata=Metadata(systematic=SystematicErrors(scale_std=scale_std), **metadata),
    )


def shifted(m: BrdfMeasurement, relative: float, seed: int = 0) -> BrdfMeasurement:
    """Every reading off by as much, by chance one way or the other."""
    sign = np.random.default_rng(seed).choice([-1.0, 1.0], m.values.shape)
    return replace(m, values=m.values * (1 + relative * sign))


def verdict(first: BrdfMeasurement, second: BrdfMeasurement) -> str:
    return str(compare(first, second)).splitlines()[-1]


@pytest.mark.parametrize(
    ("relative", "said"),
    [
        (
            0.0,
            "verdict: they agree within their stated uncertainties (p 1); they differ by 0",
        ),
        (0.0141, "verdict: they agree within their stated uncertainties (p "),
        (0.0155, "verdict: they agree within 1.10 times their stated uncertainties"),
        (0.03, "verdict: they disagree: the differences are 2.12 times as large as stated"),
    ],
)
def test_verdicts(relative: float, said: str) -> None:
    """Both state 1 %, so 1.41 % of the difference."""
    m = plane(0.01)
    assert verdict(m, shifted(m, relative)).startswith(said)


def test_a_scale_alone() -> None:
    m = plane(0.01)
    brighter = replace(m, values=1.016 * m.values)
    text = str(compare(m, brighter))
    assert "one common factor: second / first = 1.0159 (std" in text
    assert "the scales share their reference, or state no uncertainty" in text
    assert "verdict: they disagree in scale: one factor is" in text
    stated = [replace(one, metadata=plane(0.01, 0.01).metadata) for one in (m, brighter)]
    text = str(compare(*stated))
    assert "stated std of the scales' ratio 1.41 %: 1.1 standard deviations from 1" in text
    assert "verdict: they agree" in text


def test_the_table_is_in_the_figures() -> None:
    m = plane(0.01, sample="one")
    c = compare(m, shifted(m, 0.02))
    rows = [line.split() for line in str(c).splitlines()]
    for region in c.regions:
        (row,) = [row for row in rows if row and row[0] == region.name]
        assert int(row[1]) == region.count
        assert row[2:4] == [f"{100 * region.difference:.2f}", "%"]
        assert row[4:6] == [f"{100 * region.bias:+.2f}", "%"]
        assert row[6:8] == [f"{100 * region.stated:.2f}", "%"]
        assert float(row[8]) == pytest.approx(region.chi2.per_dof, rel=5e-3)
    assert {row[0] for row in rows if row} >= {"all", "region", "first:", "second:"}


def test_what_is_told_of_each() -> None:
    first = plane(None, sample="one", simulated=True)
    second = plane(None).select(np.arange(100, len(first)))
    text = str(compare(first, second))
    assert (
        "first:  one (simulated); states no standard deviation; 100 readings not compared\n"
        "second: an unnamed sample; states no standard deviation\n"
    ) in text
    assert text.endswith("verdict: none; neither states a standard deviation")
    assert "at the same geometries" in text


def test_of_many_bands_the_worst_three() -> None:
    names = tuple(f"{nm}nm" for nm in range(400, 701, 50))
    m = plane(0.01)
    m = replace(
        m, values=m.values[:, :1] * np.ones(7), std=m.std[:, :1] * np.ones(7), channels=names
    )
    off = np.zeros(7)
    off[[1, 4, 6]] = 0.03, 0.02, 0.04
    text = str(compare(m, replace(m, values=m.values * (1 + off))))
    line = next(line for line in text.splitlines() if line.startswith("chi2/dof by channel"))
    assert line.startswith("chi2/dof by channel (worst three): 700nm ")
    named = [part.split()[0] for part in line.split(": ")[1].split("; ")]
    assert named == ["700nm", "450nm", "600nm"]
