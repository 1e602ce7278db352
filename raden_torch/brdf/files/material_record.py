"""Materials as JSON values and tensors: what a file of a palette or of a coat holds of them.

A material is kept as what it is made of, not as its runtime table, which is baked anew when it is
first used (decision 31). Models are kept once, however many members show them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, TypeVar, cast

import numpy as np
from torch import Tensor

from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.coat import Coated
from raden_torch.brdf.materials.metal import Foil, Powder
from raden_torch.brdf.materials.runtime import RuntimeBrdf
from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.materials.urushi import Lambertian
from raden_torch.brdf.model.model import Provenance, RadenBrdf
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError

Record = dict[str, Any]
T = TypeVar("T")


@dataclass
class _Model:
    """Which of the models in the file."""

    model: int


@dataclass
class _Anisotropic:
    models: list[int]
    azimuth_deg: list[float]
    period_deg: float


@dataclass
class _Coat:
    base: Record
    index: float
    absorption: tuple[float, float, float]
    thickness: float
    roughness: float
    base_in: str


@dataclass
class _Powder:
    flakes: Record
    ground: Record
    density: float


class Records:
    """What is put into a file.

    Attributes:
        models: every `RadenBrdf` and every `RuntimeBrdf`, each once.
    """

    def __init__(self) -> None:
        self.models: list[RadenBrdf | RuntimeBrdf] = []

    def of(self, material: Reflection, where: str) -> Record:
        """A material as plain JSON values.

        Args:
            where: for messages.

        Raises:
            InputError: a material that a file cannot hold.
        """
        if isinstance(material, (RadenBrdf, RuntimeBrdf)):
            known = [place for place, model in enumerate(self.models) if model is material]
            if not known:
                self.models.append(material)
            return {"kind": "model", "model": known[0] if known else len(self.models) - 1}
        if isinstance(material, AnisotropicBrdf):
            return {
                "kind": "AnisotropicBrdf",
                "models": [self.of(model, where)["model"] for model in material],
                "azimuth_deg": list(material.azimuth_deg),
                "period_deg": material.period_deg,
            }
        if isinstance(material, (Lambertian, Foil)):
            return {"kind": type(material).__name__, **asdict(material)}
        if isinstance(material, Powder) and isinstance(material.density, Tensor):
            raise InputError(
                f"{where}: density: expected one number, got a map: it belongs to a picture; save "
                "the flakes and the ground"
            )
        if isinstance(material, (Coated, Powder)):
            own = {f.name: getattr(material, f.name) for f in fields(material)}
            for part in ("base", "flakes", "ground"):
                if part in own:
                    own[part] = self.of(own[part], f"{where}: {part}")
            return {"kind": type(material).__name__, **own}
        raise InputError(
            f"{where}: expected a RadenBrdf, AnisotropicBrdf, Coated, Lambertian, Foil or Powder, "
            f"which a file can hold, got {type(material).__name__}"
        )


def material_of(record: Any, models: Mapping[int, Reflection], where: str) -> Reflection:
    """A material again.

    Args:
        models: those in the file, by their numbers.

    Raises:
        InputError: no such kind, or what it is made of does not fit.
    """
    if not isinstance(record, dict) or record.get("kind") not in _KINDS:
        got = record.get("kind") if isinstance(record, dict) else record
        raise InputError(f"{where}: kind: expected one of {', '.join(_KINDS)}, got {got!r:.60}")
    try:
        return _KINDS[record["kind"]](
            {k: v for k, v in record.items() if k != "kind"}, models, where
        )
    except InputError as error:
        known = str(error).startswith(where)
        raise InputError(str(error) if known else f"{where}: {error}") from None


def _model(record: Record, models: Mapping[int, Reflection], where: str) -> Reflection:
    number = _checked(record, _Model, where).model
    if number not in models:
        raise InputError(f"{where}: model: expected 0…{len(models) - 1}, got {number}")
    return models[number]


def _anisotropic(record: Record, models: Mapping[int, Reflection], where: str) -> Reflection:
    said = _checked(record, _Anisotropic, where)
    members = [_model({"model": number}, models, where) for number in said.models]
    return AnisotropicBrdf(
        cast(list[RadenBrdf], members), said.azimuth_deg, period_deg=said.period_deg
    )


def _coat(record: Record, models: Mapping[int, Reflection], where: str) -> Reflection:
    said = vars(_checked(record, _Coat, where))
    return Coated(**{**said, "base": material_of(said["base"], models, f"{where}: base")})


def _powder(record: Record, models: Mapping[int, Reflection], where: str) -> Reflection:
    said = _checked(record, _Powder, where)
    flakes = material_of(said.flakes, models, f"{where}: flakes")
    return Powder(flakes, material_of(said.ground, models, f"{where}: ground"), said.density)


_KINDS: dict[str, Callable[[Record, Mapping[int, Reflection], str], Reflection]] = {
    "model": _model,
    "AnisotropicBrdf": _anisotropic,
    "Lambertian": lambda record, _, where: _checked(record, Lambertian, where),
    "Foil": lambda record, _, where: _checked(record, Foil, where),
    "Coated": _coat,
    "Powder": _powder,
}


def runtime_record(model: RuntimeBrdf) -> Record:
    """A table without a fit form, but for its values."""
    known = {} if model.provenance is None else {"provenance": asdict(model.provenance)}
    return {"runtime": asdict(model.layout), **known}


def runtime_of(about: Record, tensors: Mapping[str, Tensor], where: str) -> RuntimeBrdf:
    """It again.

    Raises:
        InputError: values that are not of this layout.
        KeyError: there are none.
    """
    layout, values = _checked(about["runtime"], RuntimeLayout, where), tensors["values"]
    if list(values.shape) != [*layout.shape, 3]:
        raise InputError(
            f"{where}: values: expected shape {[*layout.shape, 3]}, got {list(values.shape)}"
        )
    known = about.get("provenance")
    source = None if known is None else _checked(known, Provenance, f"{where}: provenance")
    return RuntimeBrdf(values, layout, source)


@dataclass
class _Spectral:
    wavelengths_nm: tuple[float, ...]
    runtime: RuntimeLayout
    provenance: Provenance


def spectral_record(model: SpectralBrdf) -> Record:
    """A spectral model, but for its values."""
    nm = tuple(model.wavelengths_nm.tolist())
    return asdict(_Spectral(nm, model.layout, model.provenance))


def spectral_of(about: Record, tensors: Mapping[str, Tensor], where: str) -> SpectralBrdf:
    """It again.

    Raises:
        InputError: values that are not of this layout and these bands.
        KeyError: there are none.
    """
    said = _checked(about, _Spectral, where)
    wavelengths = np.array(said.wavelengths_nm)
    return SpectralBrdf(tensors["values"], said.runtime, wavelengths, said.provenance)


def _checked(record: Record, kind: type[T], where: str) -> T:
    from raden_torch.schema import checked  # with a library that only reading files needs

    return checked(record, kind, where)
