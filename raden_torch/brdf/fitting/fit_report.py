"""The report of a fit: residuals, filled cells, warnings."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import torch

from raden_torch.brdf.fitting.diffuse_fit import FITS, RIDGE_DEG, DiffuseParameters
from raden_torch.brdf.fitting.hemisphere import GUESS, Shares, directional_albedo, shares
from raden_torch.brdf.fitting.interpolated_table import Choice
from raden_torch.brdf.fitting.tabulate import Tabulated
from raden_torch.brdf.model.layout_choice import BakeError, bake_errors
from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.measurement import BrdfMeasurement
from raden_torch.measurement.readings import WHITE_LEVEL
from raden_torch.reflectance.symmetry import reciprocity_error

_UNKNOWN = Shares(float("nan"), float("nan"), float("nan"))
_OUTSIDE = {
    "continued": "there what was measured continues",
    "diffuse": "there the diffuse part stands alone",
}
BY_HAND = "by hand"
FITTED_TO = {
    "floor": f"the floor of the readings over {RIDGE_DEG:g} deg off the mirror direction",
    "surface": f"the surface of the readings over {RIDGE_DEG:g} deg off the mirror direction",
    BY_HAND: "set by hand",
}
_SAMPLED = {
    "box": "in all angles to 70 deg",
    "hemisphere": "over the hemisphere",
    "highlight": "near the mirror",
}
_COARSE = 0.05
"""Of the highlight's peak: an RMS of the runtime table above this is warned of."""
_DARK = 1.5
"""A measurement with no reading above this may be in another unit."""


@dataclass(frozen=True)
class FitReport:
    """What a fit did, in numbers; `str` gives it as text.

    Attributes:
        cells: nodes of the table; the next five say where they come from.
        measured, from_equivalent, from_neighbours, from_diffuse, from_assumption: how many of the
            nodes; of scattered readings, and under an assumption, a node counts as measured where a
            reading lies within half a step.
        scattered: True where the readings do not lie on the table's nodes.
        averaged: measured nodes at incidence 0 that were replaced by the mean over equivalents.
        asymmetry: mean |difference| between equivalent geometries at incidence 0 over their mean.
        reciprocity_mean, reciprocity_worst: |f(a,r,t) − f(reciprocal)| over the pair's mean, where
            both were measured: averaged over the cells, weighted by f, and at its worst.
        reading_rms: RMS of model − reading over all valid readings, over the 99.9 % quantile of
            the readings, all in the channel mean; on a grid it is 0 but where `fit` averaged.
        diffuse_scale, diffuse_exponent: S (1/sr) and n per channel.
        diffuse_fit: what they were fitted to, a key of `diffuse_fit.FITS`; or "by hand".
        diffuse_share: the diffuse part's share of the sum of all readings.
        interpolation, interpolation_why, interpolation_losses: see `interpolated_table.Choice`.
        assumption: what was assumed of the sample, and how far readings bear it out; may be empty.
        hemisphere: which shares of all pairs of directions were measured, filled or derived within
            the table's box (of few readings: some of them guessed), and lie outside it.
        box_deg: first and last incidence, receiving and tilt that were measured, or derived.
        outside: what stands there: "continued" or "diffuse".
        albedo: directional albedo by incidence in degrees, in its highest channel.
        runtime_nodes, runtime_errors: the runtime table, and how far it is from the fit form
            (`layout_choice.bake_errors`).
        warnings: one sentence each.
    """

    cells: int
    scattered: bool
    measured: int
    from_equivalent: int
    from_neighbours: int
    from_diffuse: int
    averaged: int
    asymmetry: float
    reciprocity_mean: float
    reciprocity_worst: float
    reading_rms: float
    diffuse_scale: tuple[float, float, float]
    diffuse_exponent: tuple[float, float, float]
    diffuse_share: float
    interpolation: str
    interpolation_why: str
    interpolation_losses: dict[str, float]
    from_assumption: int = 0
    assumption: str = ""
    hemisphere: Shares = _UNKNOWN
    box_deg: tuple[tuple[float, float], ...] = ()
    outside: str = "diffuse"
    diffuse_fit: str = "floor"
    albedo: dict[float, float] = field(default_factory=dict)
    runtime_nodes: tuple[int, ...] = ()
    runtime_errors: dict[str, BakeError] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Plain JSON values; NaN becomes None."""
        return {key: _plain(value) for key, value in asdict(self).items()}

    def __str__(self) -> str:
        triple = lambda values: ", ".join(f"{v:.4g}" for v in values)  # noqa: E731
        lines = [
            f"table: {self.cells} nodes, {self.measured} measured "
            f"({_percent(self.measured / self.cells)}), {self.from_equivalent} from an "
            f"equivalent geometry, {self.from_neighbours} from measured neighbours, "
            f"{self.from_diffuse} from the diffuse part"
            + (f", {self.from_assumption} by assumption" if self.assumption else ""),
            *([f"assumed isotropic: {self.assumption}"] if self.assumption else []),
            f"incidence 0: {self.averaged} nodes averaged over their equivalents "
            f"(asymmetry {_percent(self.asymmetry)})",
            f"reciprocity: broken by {_percent(self.reciprocity_mean)} on average, "
            f"{_percent(self.reciprocity_worst)} at worst",
            f"diffuse: S = {triple(self.diffuse_scale)} 1/sr, n = {triple(self.diffuse_exponent)} "
            f"(R, G, B); {FITTED_TO[self.diffuse_fit]}; {_percent(self.diffuse_share)} of all that "
            "was measured",
            f"residual at the readings: {self.reading_rms:.2e} of the 99.9 % quantile (RMS)",
        ]
        lines += [
            f"of all pairs of directions {_percent(self.hemisphere.measured)} were measured, "
            f"{_percent(self.hemisphere.filled)} "
            + ("derived" if self.assumption else "filled")
            + f" within the table's box{self._expected()}, "
            f"{_percent(self.hemisphere.outside)} lie outside it: {_OUTSIDE[self.outside]}",
            "directional albedo: "
            + ", ".join(f"{albedo:.3g} at {angle:g}" for angle, albedo in self.albedo.items())
            + " deg of incidence",
        ]
        compared = ", ".join(f"{k} {v:.2f}" for k, v in self.interpolation_losses.items())
        lines.append(
            f"between the nodes: {self.interpolation}, {self.interpolation_why}"
            + (f" (loss: {compared})" if compared else "")
        )
        if self.runtime_nodes:
            errors = ", ".join(f"{_SAMPLED[k]} {_apart(e)}" for k, e in self.runtime_errors.items())
            lines.append(
                f"runtime table: {' x '.join(map(str, self.runtime_nodes))} nodes; RMS over the "
                f"99.9 % quantile and mean |Δ log(1+Y)| from the fit: {errors}"
            )
        return "\n".join([*lines, *(f"warning: {text}" for text in self.warnings)])

    def _expected(self) -> str:
        """Of a table from few readings: how sure it is of what it derived."""
        if np.isnan(self.hemisphere.expected_error):
            return ""
        return (
            f" (expected error {_percent(self.hemisphere.expected_error)} in the median; "
            f"{_percent(self.hemisphere.guessed)} of all are guessed: more than "
            f"{_percent(GUESS)})"
        )


def make_report(
    measurement: BrdfMeasurement,
    table: Tabulated,
    model: RadenBrdf,
    parameters: DiffuseParameters,
    chosen: Choice,
    *,
    diffuse_fit: str,
    outside: str,
) -> FitReport:
    """Compare the model with the readings and say where its table comes from."""
    with torch.no_grad():
        at = [torch.from_numpy(angle)[None, :, None] for angle in table.reading_angles]
        whole = model.fit_form(*at)[:, :, 0].numpy().T
        diffuse_only = model.diffuse(*at)[:, :, 0].numpy().T if model.diffuse else 0 * whole
    truth = table.readings
    error = (whole - truth).mean(axis=1)
    level, total = float(np.quantile(truth.mean(axis=1), 0.999)), float(truth.sum())
    read = np.where(table.measured, table.before_averaging.mean(axis=-1), np.nan)
    reciprocity = reciprocity_error(table.grid, read)
    albedo = directional_albedo(model)
    errors = bake_errors(model)
    return FitReport(
        cells=int(table.measured.size),
        scattered=table.scattered is not None,
        measured=int(table.measured.sum()),
        from_equivalent=int(table.from_equivalent.sum()),
        from_neighbours=int(table.from_neighbours.sum()),
        from_diffuse=int(table.without_neighbour.sum()),
        averaged=int(table.averaged.sum()),
        asymmetry=table.asymmetry,
        reciprocity_mean=reciprocity[0],
        reciprocity_worst=reciprocity[1],
        reading_rms=float(np.sqrt(np.mean(error**2)) / level) if level > 0 else float("nan"),
        diffuse_scale=parameters.scale,
        diffuse_exponent=parameters.exponent,
        diffuse_share=float(diffuse_only.sum() / total) if total > 0 else float("nan"),
        interpolation=chosen.scheme,
        interpolation_why=chosen.why,
        interpolation_losses=chosen.losses,
        from_assumption=int(table.assumed.sum()),
        assumption=table.assumption,
        hemisphere=shares(table),
        box_deg=tuple((float(axis[0]), float(axis[-1])) for axis in table.grid),
        outside=outside,
        diffuse_fit=diffuse_fit,
        albedo=albedo,
        runtime_nodes=model.layout.shape,
        runtime_errors=errors,
        warnings=(
            *table.warnings,
            *_exponent_warning(parameters, diffuse_fit),
            *_warnings(measurement, table),
            *_albedo_warning(albedo),
            *_runtime_warning(errors),
        ),
    )


def _exponent_warning(parameters: DiffuseParameters, diffuse_fit: str) -> tuple[str, ...]:
    if diffuse_fit == BY_HAND:
        return ()
    low, high = FITS[diffuse_fit].exponent_bounds
    at_bound = [
        f"{channel}: n = {n:g}"
        for channel, n in zip("RGB", parameters.exponent, strict=True)
        if n <= low * 1.001 or n >= high * 0.999
    ]
    if not at_bound:
        return ()
    return (
        f"the diffuse exponent stopped at a bound of {[low, high]} "
        f"({', '.join(at_bound)}): the formula does not describe this sample's diffuse part",
    )


def _warnings(measurement: BrdfMeasurement, table: Tabulated) -> tuple[str, ...]:
    found = []
    invalid = int((~measurement.valid).sum())
    if invalid:
        found.append(f"{invalid} of {len(measurement)} readings are not valid and were left out")
    largest = float(measurement.values[measurement.valid].max())
    if largest <= _DARK:
        found.append(
            f"no reading is above {largest:g}, where the perfect diffuser is {WHITE_LEVEL:g}; if "
            f"it is 1 in this file, multiply its values by {WHITE_LEVEL:g}"
        )
    negative = int((measurement.values[measurement.valid] < 0).any(axis=1).sum())
    if negative:
        found.append(f"{negative} readings have a negative value (noise); they were kept")
    if table.without_neighbour.any():
        found.append(
            f"{int(table.without_neighbour.sum())} nodes have no measured neighbour within three "
            "steps; the diffuse part alone stands there"
            + (
                ""
                if table.assumption
                else '; of an isotropic sample, `assume="isotropic"` derives more'
            )
        )
    return tuple(found)


def _albedo_warning(albedo: dict[float, float]) -> tuple[str, ...]:
    incidence, highest = max(albedo.items(), key=lambda item: item[1])
    if highest <= 1:
        return ()
    return (
        f"the directional albedo is {highest:.3g} at incidence {incidence:g} deg: more light "
        "leaves than arrives; the measurement's scale is too high, or so is what stands beside "
        "the measured angles",
    )


def _runtime_warning(errors: dict[str, BakeError]) -> tuple[str, ...]:
    worst = max(errors.values(), key=lambda error: error.rms)
    if worst.rms <= _COARSE:
        return ()
    return (
        f"the runtime table's nodes are too coarse for this sample's highlight: it is read "
        f"{_percent(worst.rms)} of its peak off (RMS)",
    )


def _apart(error: BakeError) -> str:
    return f"{error.rms:.2g}; {error.log_error:.2g}"


def _percent(share: float) -> str:
    return "not known" if np.isnan(share) else f"{100 * share:.3g} %"


def _plain(value: Any) -> Any:
    """JSON has no NaN: it becomes None."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and np.isnan(value) else value
