"""Measurements and models in words."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from raden_torch.measurement import BrdfMeasurement

if TYPE_CHECKING:
    from raden_torch.brdf.materials.spectral import SpectralBrdf
    from raden_torch.brdf.model.model import RadenBrdf

_MOST_ENTRIES = 40
"""Of a header: a scan's report has 18."""


def describe_measurement(measurement: BrdfMeasurement) -> str:
    """Sample, size, axes, channels and range, one fact a line."""
    m, meta = measurement, measurement.metadata
    kind = "simulated" if meta.simulated else "not simulated, says its header"
    lines = [
        f"measurement of {meta.sample or 'an unnamed sample'} ({kind})",
        f"instrument: {meta.instrument or 'not named'}",
        f"{len(m)} readings, {int(m.valid.sum())} valid; channels {', '.join(m.channels)}; "
        f"white {meta.white}, {meta.observer}",
    ]
    for name in ("incidence", "receiving", "tilt"):
        values = np.unique(getattr(m, f"{name}_deg"))
        step = np.diff(values)
        by = f" by {step[0]:g}" if len(step) and np.allclose(step, step[0]) else ""
        lines.append(f"{name}: {values[0]:g}…{values[-1]:g} deg{by}, {len(values)} values")
    if m.azimuth_deg is not None:
        low, high = m.azimuth_deg.min(), m.azimuth_deg.max()
        lines.append(f"sample azimuth: {low:g}…{high:g} deg, {m.azimuths} values")
    lines += _uncertainty(m)
    values = m.values[m.valid]
    negative = int((values < 0).any(axis=1).sum())
    if negative:
        lines.append(f"{negative} valid readings have a negative value (noise, kept)")
    if len(values):
        low, high = values.min(axis=0), values.max(axis=0)
        lines += [
            f"{channel}: {lo:g}…{hi:g} (perfect reflecting diffuser = 100)"
            for channel, lo, hi in list(zip(m.channels, low, high, strict=True))[:8]
        ]
    lines += [f"{name}: {text}" for name, text in meta.other[:_MOST_ENTRIES]]
    lines += [f"note: {note}" for note in meta.notes]
    return "\n".join(lines)


def _uncertainty(m: BrdfMeasurement) -> list[str]:
    """What it states of its errors."""
    lines = []
    if m.std is None:
        lines.append("no standard deviations stated")
    elif m.valid.any():
        channel = m.channels.index("Y") if "Y" in m.channels else len(m.channels) // 2
        values = np.maximum(abs(m.values[m.valid, channel]), 1e-9)
        median = 100 * float(np.median(m.std[m.valid, channel] / values))
        lines.append(f"standard deviation of {m.channels[channel]}: {median:.3g} % (median)")
    common = m.metadata.systematic
    if common.scale_std:
        of = f", of {common.scale_reference}" if common.scale_reference else ""
        lines.append(f"scale of all values: {100 * common.scale_std:.3g} % (standard{of})")
    return lines


def describe_model(model: RadenBrdf) -> str:
    """Sample, table, diffuse parameters, gains and fit, one fact a line."""
    about = model.provenance
    learnt = about.fit.get("learnt")
    kind = "simulated specimen" if about.simulated else "measured specimen"
    kind = about.instrument if learnt else kind
    lines = [f"model of {about.sample or 'an unnamed sample'} ({kind})"]
    if model.table is not None:
        shape = " x ".join(map(str, model.table.values.shape))
        lines.append(f"table: {shape}; {model.table.extra_repr()} deg")
        box = _box(model.measured_box_deg)
        continued = about.fit.get("outside") == "continued"
        beyond = "what was measured is continued" if continued else "the diffuse part stands alone"
        how = "measured or derived (isotropic)" if about.fit.get("assumption") else "measured"
        if learnt:
            share = 100 * float(learnt["seen"])
            how, beyond = f"seen ({share:.2g} % of a 5 degree grid)", "what was seen is continued"
        lines.append(f"{how}: {box} deg; beyond, {beyond}")
    if model.diffuse is not None:
        from raden_torch.brdf.fitting.fit_report import FITTED_TO

        triple = lambda values: ", ".join(f"{v:.4g}" for v in values.tolist())  # noqa: E731
        fitted_to = FITTED_TO.get(str(about.fit.get("diffuse_fit")))
        lines.append(
            f"diffuse: S = {triple(model.diffuse.scale)} 1/sr, n = "
            f"{triple(model.diffuse.exponent)}" + (f"; {fitted_to}" if fitted_to else "")
        )
    lines.append(f"gains: I_d = {model.diffuse_gain:g}, I_s = {model.specular_gain:g}")
    lines.append(f"measurement sha256: {about.measurement_sha256 or 'not known'}")
    if model.errors is not None:
        zeros, scale = len(model.errors.shared), 100 * model.errors.scale_std
        lines.append(
            f"standard deviations: own errors, zeros of {zeros} axes, a scale of {scale:.3g} %"
        )
    lines += [f"warning: {text}" for text in about.fit.get("warnings", ())]
    return "\n".join(lines)


def _box(box_deg: Iterable[Sequence[float]]) -> str:
    axes = zip(("incidence", "receiving", "tilt"), box_deg, strict=False)
    return ", ".join(f"{name} {low:g}…{high:g}" for name, (low, high) in axes)


def describe_spectral(model: SpectralBrdf) -> str:
    """Sample, bands, table and fit, one fact a line."""
    about, nm = model.provenance, model.wavelengths_nm
    kind = "simulated specimen" if about.simulated else "measured specimen"
    step = np.diff(nm)
    by = f" by {step[0]:g}" if np.allclose(step, step[0]) else ""
    lines = [
        f"spectral model of {about.sample or 'an unnamed sample'} ({kind})",
        f"{len(nm)} bands: {nm[0]:g}…{nm[-1]:g} nm{by}; `raden render --illuminant A` lights it",
        f"runtime table: {' x '.join(map(str, model.values.shape))}",
    ]
    if box := _box(about.fit.get("box_deg", ())):
        lines.append(f"measured: {box} deg; beyond, what was measured is continued")
    lines.append(f"measurement sha256: {about.measurement_sha256 or 'not known'}")
    lines += [f"warning: {text}" for text in about.fit.get("warnings", ())]
    return "\n".join(lines)


def recognises_measurement(head: bytes) -> bool:
    """One of the formats of `load_measurement`."""
    from raden_torch.capture.exchange import recognises

    return recognises(head)


def describe_measurement_file(path: Path) -> str:
    from raden_torch.capture.exchange import load_measurement

    return describe_measurement(load_measurement(path))
