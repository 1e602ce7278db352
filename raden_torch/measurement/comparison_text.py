"""A comparison in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

from raden_torch.measurement.consistency import MAX_BIRGE, SIGNIFICANT

if TYPE_CHECKING:
    from raden_torch.measurement.compare import Comparison, RegionComparison

_OVERSTATED = 1.0 / MAX_BIRGE  # Birge's ratio below: the uncertainties are too large, or shared


def in_words(c: Comparison) -> str:
    """A line a fact, a line a region; differences are second − first, relative to their mean."""
    lines = [f"first:  {_name(c, 0)}", f"second: {_name(c, 1)}", _how(c), "", _HEAD]
    lines += [_row(region) for region in c.regions]
    lines += ["", *_channels(c), *_scale(c), _verdict(c)]
    return "\n".join(lines)


_HEAD = f"{'region':9}{'count':>7}{'|diff|':>9}{'bias':>9}{'stated':>9}{'chi2/dof':>10}{'p':>9}"


def _row(r: RegionComparison) -> str:
    return (
        f"{r.name:9}{r.count:7}{_percent(r.difference):>9}{_percent(r.bias, '+'):>9}"
        f"{_percent(r.stated):>9}{r.chi2.per_dof:10.3g}{_p(r.chi2.p):>9}"
    )


def _name(c: Comparison, i: int) -> str:
    simulated = " (simulated)" if c.simulated[i] else ""
    std = "" if c.std_stated[i] else "; states no standard deviation"
    alone = f"; {c.without_partner[i]} readings not compared" if c.without_partner[i] else ""
    return f"{c.names[i] or 'an unnamed sample'}{simulated}{std}{alone}"


def _how(c: Comparison) -> str:
    how = (
        "the denser one interpolated (uncertainty included, p approximate)"
        if c.interpolated
        else "at the same geometries"
    )
    return (
        f"in {c.judged}, {how}\nmedians of |second - first|, of second - first, and of the stated "
        "standard deviation of it, over the mean of both"
    )


def _channels(c: Comparison) -> list[str]:
    several = list(zip(c.channels, c.by_channel, strict=True))
    if len(several) > 3:
        several = sorted(several, key=lambda one: -one[1].per_dof)[:3]
    each = "; ".join(f"{name} {chi2.per_dof:.3g}" for name, chi2 in several)
    return [f"chi2/dof by channel{' (worst three)' if len(c.channels) > 3 else ''}: {each}"]


def _scale(c: Comparison) -> list[str]:
    scale = c.scale
    stated = (
        f"stated std of the scales' ratio {_percent(scale.stated_std)}"
        if scale.stated_std
        else "the scales share their reference, or state no uncertainty"
    )
    return [
        f"one common factor: second / first = {scale.factor:.5g} (std {scale.std:.2g}; {stated}: "
        f"{scale.deviations:.2g} standard deviations from 1)",
        f"with that factor free: chi2/dof {scale.chi2.per_dof:.3g}, p {_p(scale.chi2.p)}",
    ]


def _verdict(c: Comparison) -> str:
    if not any(c.std_stated):
        return "verdict: none; neither states a standard deviation"
    if c.p >= SIGNIFICANT:
        small = f"; they differ by {c.birge:.2g} times those" if c.birge < _OVERSTATED else ""
        return f"verdict: they agree within their stated uncertainties (p {_p(c.p)}){small}"
    if c.agrees:
        return (
            f"verdict: they agree within {c.birge:.2f} times their stated uncertainties, "
            f"which are not known better than by a factor of {MAX_BIRGE:g} (p {_p(c.p)})"
        )
    if c.birge <= MAX_BIRGE:
        return (
            f"verdict: they disagree in scale: one factor is {c.scale.deviations:.3g} standard "
            "deviations from 1; apart from it they agree"
        )
    alike = c.scale.chi2.birge <= MAX_BIRGE or c.scale.chi2.p >= SIGNIFICANT
    return f"verdict: they disagree: the differences are {c.birge:.3g} times as large as stated" + (
        "; apart from one factor they agree" if alike else ""
    )


def _percent(share: float, sign: str = "") -> str:
    return f"{100 * share:{sign}.2f} %"


def _p(p: float) -> str:
    return f"{p:.2g}" if p >= 1e-4 else "< 1e-4"
