"""A file → what the index keeps of it: its colours over the angles, a thumbnail, where it is from.

A measurement is fitted first; a model is taken as it is. This is the slow part of adding, and needs
no lock.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from raden_torch.catalogue.entry import Kind
from raden_torch.catalogue.lab_grid import SHAPE, lab_of_f_r, nodes_deg
from raden_torch.errors import InputError

if TYPE_CHECKING:
    from raden_torch.brdf.materials.surface import Reflection
    from raden_torch.brdf.shading.lights import Light
    from raden_torch.measurement import BrdfMeasurement

THUMBNAIL_PX = 96
_DATES = ("date", "measured", "started", "created")
"""Header entries that say when a measurement was made, the first that is there."""


@dataclass(frozen=True, eq=False)
class Indexed:
    """What was found in a file: fields of `Entry`, and

    Attributes:
        lab: `SHAPE` float16: L*, a*, b* at the nodes of `lab_grid`.
        thumbnail: a PNG.
    """

    kind: Kind
    name: str
    date: str
    instrument: str
    simulated: bool
    header: dict[str, str]
    fit: dict[str, Any]
    box_deg: tuple[tuple[float, float], ...]
    lab: NDArray[np.float16]
    thumbnail: bytes


def index_file(path: Path, assume: Literal["isotropic"] | None = None) -> Indexed:
    """Look at a measurement or a model.

    Args:
        assume: of a measurement, as for `fit`.

    Raises:
        InputError: neither of them; a palette; a measurement that cannot be fitted.
    """
    from raden_torch.info import kind_of

    kind = kind_of(path).name
    if kind == "a measurement":
        from raden_torch.capture.exchange import load_measurement

        return _of_measurement(path, load_measurement(path), assume)
    if kind != "a model":
        raise InputError(f"{path}: expected a measurement or a model, got {kind}")
    return _of_model(path)


def _of_measurement(
    path: Path, measurement: BrdfMeasurement, assume: Literal["isotropic"] | None
) -> Indexed:
    from raden_torch.brdf.fitting.by_azimuth import AzimuthFit, fit_by_azimuth
    from raden_torch.brdf.fitting.fit import fit

    try:
        result = (fit_by_azimuth if measurement.azimuths > 1 else fit)(measurement, assume=assume)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    meta = measurement.metadata
    header = dict(meta.other)
    dates = {key.lower(): text for key, text in header.items()}
    if isinstance(result, AzimuthFit):
        report = {f"azimuth {at:g}": r.as_dict() for at, r in result.report.each.items()}
    else:
        report = result.report.as_dict()
    return Indexed(
        kind="measurement",
        name=meta.sample,
        date=next((dates[key] for key in _DATES if key in dates), ""),
        instrument=meta.instrument,
        simulated=meta.simulated,
        header=header | {f"note {k}": note for k, note in enumerate(meta.notes, 1)},
        fit=report,
        box_deg=_box(result.model),
        **_seen(result.model),
    )


def _of_model(path: Path) -> Indexed:
    from raden_torch.brdf.files.model_file import load_model
    from raden_torch.brdf.materials.palette import Palette
    from raden_torch.brdf.materials.runtime import models_of
    from raden_torch.brdf.materials.spectral import SpectralBrdf

    loaded = load_model(path)
    model = loaded.under("D65") if isinstance(loaded, SpectralBrdf) else loaded
    if isinstance(model, Palette):
        raise InputError(
            f"{path}: expected the model of one shell, got a palette of {len(model)}; add its "
            "members' files"
        )
    abouts = [part.provenance for part in models_of(model)]
    names = dict.fromkeys(about.sample for about in abouts if about.sample)
    first = abouts[0] if abouts else None
    header = {"material": type(loaded).__name__}
    if first is not None and first.measurement_sha256:
        header["measurement sha256"] = first.measurement_sha256
    return Indexed(
        kind="model",
        name=", ".join(names),
        date="",
        instrument=first.instrument if first else "",
        simulated=any(about.simulated for about in abouts),
        header=header,
        fit=first.fit if first else {},
        box_deg=_box(model),
        **_seen(model),
    )


def _box(model: Any) -> tuple[tuple[float, float], ...]:
    """What was measured; empty where that is not known."""
    box = getattr(model, "measured_box_deg", ())
    return tuple((float(low), float(high)) for low, high in box)


def _seen(model: Reflection) -> dict[str, Any]:
    """Its colours and its thumbnail."""
    return {"lab": _lab(model), "thumbnail": _thumbnail(model)}


def _lab(model: Reflection) -> NDArray[np.float16]:
    """As it is shaded, the sample at azimuth 0."""
    import torch

    from raden_torch.brdf.materials.surface import Surface, reflected
    from raden_torch.geometry import vectors_from_angles

    maps = torch.from_numpy(np.deg2rad(nodes_deg()).T.copy()).view(3, 1, 1, -1, 1)
    n, light, view = vectors_from_angles(*maps)
    tangent = torch.zeros_like(n)
    tangent[:, 0] = 1.0  # p × N: docs/conventions.md
    with torch.no_grad():
        f_r = reflected(model, Surface(n, view, tangent=tangent), light)
    lab = lab_of_f_r(f_r[0, :, :, 0].T.cpu().numpy()).reshape(SHAPE)
    return cast("NDArray[np.float16]", lab.astype(np.float16))


@cache
def _window() -> Light:
    """Made once: it takes as long as the picture."""
    from raden_torch.brdf.shading.light_setups import light_setup

    return light_setup("window")


def _thumbnail(model: Reflection) -> bytes:
    """A sphere beside a window, exposed for itself, as a PNG."""
    from raden_torch.brdf.files.display import AS_IT_IS, eight_bits
    from raden_torch.brdf.materials.anisotropic import takes_tangent
    from raden_torch.images.pixels import encoded
    from raden_torch.pictures import render_shape

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a black shell has a black picture
        image = render_shape(
            model,
            "sphere",
            [_window()],
            tangent=(1.0, 0.0, 0.0) if takes_tangent(model) else None,
            size=THUMBNAIL_PX,
        )
    return encoded(eight_bits(AS_IT_IS.picture(image)[0]), ".png")
