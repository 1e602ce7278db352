"""Camera RGB → CIE XYZ, from the patches of a colour chart."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from raden_torch.arrays import Floats
from raden_torch.capture.photo.chart import Chart, Patches
from raden_torch.capture.photo.chart_reference import NEUTRAL, PATCH_NAMES
from raden_torch.capture.photo.result_file import read_result, write_result
from raden_torch.errors import InputError
from raden_torch.schema import Finite, NotNegative

Method = Literal["least squares", "root-polynomial 2", "root-polynomial 3"]
METHODS: Mapping[Method, int] = {"least squares": 1, "root-polynomial 2": 2, "root-polynomial 3": 3}
"""By name, the degree: 3, 6 and 13 terms a channel. All keep hue and chroma when the exposure
changes, which ordinary polynomials do not."""
Corner = tuple[Finite, Finite]
_FEWEST = 18
_EXPONENT = 0.12
KIND = "colour"


@dataclass(frozen=True, eq=False)
class ColourCorrection:
    """The map from a camera's linear RGB to XYZ under the light of the photograph, as D65.

    Attributes:
        method: a name of `METHODS`.
        matrix: `[3, terms]`.
    """

    method: Method
    matrix: Floats

    def to_xyz(self, rgb: NDArray[Any]) -> NDArray[np.float32]:
        """`[…, 3]` linear camera RGB → XYZ; the perfect diffuser beside the chart has Y = 1."""
        import colour.characterisation as ccm

        flat = np.asarray(rgb, np.float64).reshape(-1, 3)
        out = np.empty(flat.shape, np.float32)
        for i in range(0, len(flat), 1 << 20):  # the terms take much more memory than the pixels
            part = flat[i : i + (1 << 20)]
            out[i : i + (1 << 20)] = ccm.apply_matrix_colour_correction_Finlayson2015(
                part, self.matrix, degree=METHODS[self.method], root_polynomial_expansion=True
            )
        return out.reshape(np.shape(rgb))

    def to_linear_srgb(self, rgb: NDArray[Any]) -> NDArray[np.float32]:
        """`[…, 3]` linear camera RGB → linear RGB with sRGB primaries, unclipped."""
        from raden_torch.measurement.colour_conversion import xyz_to_rgb_matrix

        return (self.to_xyz(rgb) @ xyz_to_rgb_matrix().T).astype(np.float32)


@dataclass(frozen=True, eq=False)
class ColourReport:
    """How well a correction does, in ΔE2000 under D65.

    Attributes:
        left_out: `{method: (mean, worst)}`, each patch predicted by a fit to the others: what the
            method was chosen by, and what to expect of other colours.
        mean, worst: of the chosen method on the patches it was fitted to.
        patches: `[24]` of the chosen method, each left out; NaN where a patch was not usable.
        neutral_exponent: of signal against reflectance over the neutral patches; 1 is linear.
        notes: what the person should know.
    """

    left_out: Mapping[Method, tuple[float, float]]
    mean: float
    worst: float
    patches: Floats
    neutral_exponent: float
    notes: tuple[str, ...]

    def __str__(self) -> str:
        rows = [
            f"  {name}: mean {mean:.2f}, worst {worst:.2f}"
            for name, (mean, worst) in self.left_out.items()
        ]
        worst = PATCH_NAMES[int(np.nanargmax(self.patches))]
        return "\n".join(
            [
                "ΔE2000, each patch left out in turn:",
                *rows,
                f"chosen, on all patches: mean {self.mean:.2f}, worst {self.worst:.2f} "
                f"(left out, the worst is {worst})",
                f"neutral patches: signal ~ reflectance^{self.neutral_exponent:.2f}",
                *(f"note: {note}" for note in self.notes),
            ]
        )


class LeftOut(Struct):
    """Errors of one method in a colour file."""

    mean: NotNegative
    worst: NotNegative


class ColourFile(Struct):
    """What is read of a colour file; later steps can do without what has a default."""

    method: Method
    matrix: tuple[tuple[Finite, ...], tuple[Finite, ...], tuple[Finite, ...]]
    chart: str = ""
    chart_corners_px: tuple[Corner, Corner, Corner, Corner] | None = None
    left_out_delta_e_2000: dict[str, LeftOut] = {}


def fit_colour(
    patches: Patches, reference_xyz: NDArray[Any], name: str
) -> tuple[ColourCorrection, ColourReport]:
    """Fit every method to a chart's patches and take the one that predicts left-out patches best.

    Least squares, and the root-polynomials of Finlayson, Mackiewicz and Hurlbert, Color Correction
    Using Root-Polynomial Regression (2015), through colour-science.

    Args:
        patches: as `read_patches` measured them.
        reference_xyz: `[24, 3]`, the perfect diffuser's Y being 1.
        name: of the photograph, for messages.

    Raises:
        InputError: too few patches that are neither saturated nor black.
    """
    reference = np.asarray(reference_xyz, np.float64)
    lit = (patches.rgb > 0).all(axis=1)
    use = np.flatnonzero(patches.usable & lit)
    if len(use) < _FEWEST:
        clipped = [PATCH_NAMES[i] for i in np.flatnonzero(~patches.usable)]
        wrong = f"saturated: {', '.join(clipped)}" if clipped else "the rest has no signal"
        raise InputError(
            f"{name}: expected at least {_FEWEST} usable patches, got {len(use)} of 24 ({wrong}); "
            "expose so that the white patch stays below the white level"
        )
    rgb, xyz = patches.rgb[use], reference[use]
    left_out = {method: _left_out(method, rgb, xyz) for method in METHODS}
    scores = {m: (float(e.mean()), float(e.max())) for m, e in left_out.items()}
    method = min(scores, key=lambda m: scores[m][0])
    correction = _fitted(method, rgb, xyz)
    fitted = _delta_e(correction.to_xyz(rgb), xyz)
    each = np.full(len(PATCH_NAMES), np.nan)
    each[use] = left_out[method]
    exponent = _neutral_exponent(patches, reference)
    report = ColourReport(
        scores, float(fitted.mean()), float(fitted.max()), each, exponent, _notes(patches, exponent)
    )
    return correction, report


def write_colour(
    path: str | os.PathLike[str],
    correction: ColourCorrection,
    report: ColourReport,
    chart: Chart,
    *,
    edition: str,
    made_from: Collection[str | os.PathLike[str]],
) -> None:
    """Write a correction and its report for the next step (`read_colour`) and for a person."""
    write_result(
        path,
        KIND,
        {
            "method": correction.method,
            "matrix": correction.matrix,
            "maps": "linear camera RGB to CIE 1931 2 deg XYZ, D65, perfect diffuser Y = 1",
            "chart": f"ColorChecker Classic, edition {edition}",
            "chart_corners_px": np.round(chart.corners, 2),
            "chart_mirrored": chart.mirrored,
            "chart_rotation_deg": round(chart.rotation_deg, 2),
            "mean_delta_e_2000": round(report.mean, 4),
            "worst_delta_e_2000": round(report.worst, 4),
            "left_out_delta_e_2000": {
                name: {"mean": round(mean, 4), "worst": round(worst, 4)}
                for name, (mean, worst) in report.left_out.items()
            },
            "patches_left_out_delta_e_2000": {
                name: None if np.isnan(value) else round(float(value), 3)
                for name, value in zip(PATCH_NAMES, report.patches, strict=True)
            },
            "neutral_exponent": None
            if np.isnan(report.neutral_exponent)
            else round(report.neutral_exponent, 4),
            "notes": list(report.notes),
        },
        made_from=made_from,
    )


def read_colour(path: str | os.PathLike[str]) -> ColourCorrection:
    """Read what `raden capture colour` wrote.

    Raises:
        InputError: not such a file, or damaged.
    """
    found = read_result(path, KIND, ColourFile)
    terms = {1: 3, 2: 6, 3: 13}[METHODS[found.method]]
    for c, row in enumerate(found.matrix):
        if len(row) != terms:
            raise InputError(
                f"{path}: matrix[{c}]: expected {terms} numbers for {found.method}, got {len(row)}"
            )
    return ColourCorrection(found.method, np.array(found.matrix))


def _fitted(method: Method, rgb: Floats, xyz: Floats) -> ColourCorrection:
    import colour.characterisation as ccm

    matrix = ccm.matrix_colour_correction_Finlayson2015(
        rgb, xyz, degree=METHODS[method], root_polynomial_expansion=True
    )
    return ColourCorrection(method, np.asarray(matrix, np.float64))


def _left_out(method: Method, rgb: Floats, xyz: Floats) -> Floats:
    predicted = np.empty_like(xyz)
    for i in range(len(xyz)):
        others = np.arange(len(xyz)) != i
        predicted[i] = _fitted(method, rgb[others], xyz[others]).to_xyz(rgb[i])
    return _delta_e(predicted, xyz)


def _delta_e(xyz: NDArray[Any], reference: Floats) -> Floats:
    import colour

    white = colour.CCS_ILLUMINANTS["CIE 1931 2 Degree Standard Observer"]["D65"]
    a, b = (
        colour.XYZ_to_Lab(np.clip(np.asarray(v, np.float64), 0, None), white)
        for v in (xyz, reference)
    )
    return np.asarray(colour.delta_E(a, b, method="CIE 2000"), np.float64)


def _neutral_exponent(patches: Patches, reference: Floats) -> float:
    grey = [i for i in NEUTRAL if patches.usable[i] and (patches.rgb[i] > 0).all()]
    if len(grey) < 3:
        return float("nan")
    signal = np.log(patches.rgb[grey].mean(axis=1))
    return float(np.polyfit(np.log(reference[grey, 1]), signal, 1)[0])


def _notes(patches: Patches, exponent: float) -> tuple[str, ...]:
    notes = []
    if abs(exponent - 1) > _EXPONENT:
        notes.append(
            f"the neutral patches follow reflectance^{exponent:.2f}, not 1: the photograph is not "
            "linear (a camera's tone curve, a wrong `coded`, or stray light on the chart); "
            "use a raw file, or recover the response from an exposure stack"
        )
    clipped = [PATCH_NAMES[i] for i in np.flatnonzero(~patches.usable)]
    if clipped:
        notes.append(f"left out, since saturated: {', '.join(clipped)}")
    return tuple(notes)
