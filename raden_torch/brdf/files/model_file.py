"""Models, palettes and coats on disk: one safetensors file with JSON metadata. No pickle."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from raden_torch.brdf.files.material_record import (
    Records,
    material_of,
    runtime_of,
    runtime_record,
    spectral_of,
    spectral_record,
)
from raden_torch.brdf.materials.palette import Palette
from raden_torch.brdf.materials.spectral import SpectralBrdf
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model.layout_choice import choose_layout
from raden_torch.brdf.model.model import CosineDiffuse, Provenance, RadenBrdf
from raden_torch.brdf.model.reflectance_table import Pieces, ReflectanceTable
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.brdf.model.table_errors import TableErrors
from raden_torch.errors import InputError, check_type, why
from raden_torch.files import check_output, check_seekable, written_beside
from raden_torch.measurement.text_file import head_in_words

FORMAT = "raden_torch model"
VERSION = 2
"""Of files with more than one `RadenBrdf`, which is version 1."""
SPECTRAL_VERSION = 3
"""Of spectral models; the newest."""
QUANTITY = "f_r in 1/sr, without the cosine"
COLOUR = "linear RGB, sRGB primaries, D65 white, unclipped"
IN_BANDS = "spectral bands"
_MAX_HEADER = 16_000_000
_MAX_BYTES = 2_000_000_000


@dataclass
class _About:
    """What is read of the metadata; the angles and pieces are those of a table."""

    diffuse_gain: float
    specular_gain: float
    provenance: Provenance
    first_deg: tuple[float, float, float] | None = None
    step_deg: tuple[float, float, float] | None = None
    pieces: Pieces | None = None
    runtime: RuntimeLayout | None = None
    scale_std: float = 0.0


def save_model(model: Reflection | SpectralBrdf, path: str | os.PathLike[str]) -> None:
    """Write a model, a palette, or another material; `load_model` gives back an equal one.

    Args:
        model: a `RadenBrdf`; or a `Palette`, `AnisotropicBrdf`, `Coated`, `Powder`, `Foil` or
            `Lambertian`, which are kept as what they are made of, models in them included; or a
            `SpectralBrdf`.

    Raises:
        InputError: a suffix other than .safetensors, a place that cannot be written, or a material
            that a file cannot hold.

    Examples:
        >>> import raden_torch as rt
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> rt.save_model(model, "shell.safetensors")
    """
    from safetensors.torch import save

    if not callable(getattr(model, "of_unit_vectors", None)):
        check_type("model", model, (RadenBrdf, Palette, SpectralBrdf), "fit(…).model is one")
    target = check_output(path, (".safetensors",))
    about, tensors = described(model)
    stored = {
        name: value.detach().cpu().clone(memory_format=torch.contiguous_format)
        for name, value in tensors.items()
    }
    data = _in_order(save(stored, {"format": FORMAT, "about": json.dumps(about)}))
    with written_beside(target) as temporary:
        temporary.write_bytes(data)


def described(model: Reflection | SpectralBrdf) -> tuple[dict[str, Any], dict[str, torch.Tensor]]:
    """What a file holds: its metadata and its tensors."""
    if isinstance(model, RadenBrdf):
        return describe(model), model.state_dict()
    if isinstance(model, SpectralBrdf):
        head = {"version": SPECTRAL_VERSION, "quantity": QUANTITY, "colour": IN_BANDS}
        return {**head, "spectral": spectral_record(model)}, model.state_dict()
    records = Records()
    about: dict[str, Any] = {"version": VERSION, "quantity": QUANTITY, "colour": COLOUR}
    if isinstance(model, Palette):
        about["palette"] = [
            {"name": name, "material": records.of(part, f"palette: {name}")}
            for name, part in zip(model.names, model, strict=True)
        ]
    else:
        about["material"] = records.of(model, "model")
    about["models"] = [
        describe(m) if isinstance(m, RadenBrdf) else runtime_record(m) for m in records.models
    ]
    tensors = {
        f"models.{place}.{name}": value
        for place, part in enumerate(records.models)
        for name, value in part.state_dict().items()
    }
    return about, tensors


def describe(model: RadenBrdf) -> dict[str, Any]:
    """All of a model that is not a tensor, as plain JSON values; `assemble` reads it."""
    about: dict[str, Any] = {
        "version": 1,
        "quantity": QUANTITY,
        "colour": COLOUR,
        "diffuse_gain": model.diffuse_gain,
        "specular_gain": model.specular_gain,
        "runtime": asdict(model.layout),
        "provenance": asdict(model.provenance),
    }
    if model.table is not None:
        about["first_deg"] = model.table.first_deg
        about["step_deg"] = model.table.step_deg
        about["pieces"] = model.table.pieces
    if model.errors is not None:
        about["scale_std"] = model.errors.scale_std
    return about


def _in_order(data: bytes) -> bytes:
    """The same file with its metadata in alphabetical order, which safetensors leaves to chance: a
    model is the same bytes each time it is written."""
    size = int.from_bytes(data[:8], "little")
    header = json.loads(data[8 : 8 + size])
    header["__metadata__"] = dict(sorted(header["__metadata__"].items()))
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text = text.ljust(-(-len(text) // 8) * 8)  # tensors begin at a multiple of 8
    return len(text).to_bytes(8, "little") + text + data[8 + size :]


def load_model(path: str | os.PathLike[str]) -> Any:
    """Read what `save_model` wrote, onto the CPU.

    Returns:
        The `RadenBrdf` that `raden fit` writes of one measurement, or the `SpectralBrdf` with
        --spectral; the `Palette` or the material that was saved otherwise.

    Raises:
        InputError: not a file of ours, of a newer format, truncated, in another quantity or colour
            space, or holding values that are not finite.

    Examples:
        >>> import torch
        >>> import raden_torch as rt
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> rt.save_model(model, "shell.safetensors")
        >>> loaded = rt.load_model("shell.safetensors")
        >>> torch.equal(loaded.table.values, model.table.values), loaded.provenance.sample
        (True, 'akoya')
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    path = Path(path)
    about = _read_about(path)
    try:
        tensors = load(path.read_bytes())
        read = next((of for key, of in _READERS.items() if key in about), assemble)
        model = read(about, tensors)
    except (
        *(SafetensorError, KeyError, TypeError, ValueError, OverflowError),
        *(AttributeError, RecursionError),
    ) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"{path}: expected the content of a model, got a damaged one: {reason}"
        ) from None
    for name, value in tensors.items():
        if not torch.isfinite(value).all():
            raise InputError(f"{path}: {name}: expected finite values, got some that are not")
    return model


def load_brdf(path: str | os.PathLike[str], what: str = "") -> RadenBrdf:
    """`load_model`, of a file that has to hold one `RadenBrdf`.

    Args:
        what: needs it, for the message.

    Raises:
        InputError: it holds a palette, another material or bands; whatever `load_model` raises.
    """
    model = load_rgb(path, what)
    if isinstance(model, RadenBrdf):
        return model
    kind = f"a palette of {len(model)}" if isinstance(model, Palette) else type(model).__name__
    raise InputError(
        f"{path}: {what or 'model'}: expected the model of one measurement, got {kind}"
    )


def load_rgb(path: str | os.PathLike[str], what: str = "") -> Reflection:
    """`load_model`, of a file that has to hold a material in RGB.

    Args:
        what: needs it, for the message.

    Raises:
        InputError: it holds a spectral model; whatever `load_model` raises.
    """
    model: Reflection | SpectralBrdf = load_model(path)
    if isinstance(model, SpectralBrdf):
        raise InputError(
            f"{path}: {what or 'model'}: expected a model in RGB, got a spectral one of "
            f"{len(model)} bands; `raden fit` without --spectral makes one"
        )
    return model


def _several(about: dict[str, Any], tensors: Mapping[str, torch.Tensor]) -> Reflection:
    """A palette, or a material that is no model.

    Raises:
        InputError, KeyError, TypeError, ValueError: the two do not make one.
    """
    _check_kind(about, "file")
    models: dict[int, Reflection] = {}
    for place, own in enumerate(about["models"]):
        where, prefix = f"models[{place}]", f"models.{place}."
        parts = {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
        if "diffuse_gain" not in own:
            models[place] = runtime_of(own, parts, where)
            continue
        _check_kind(own, where)
        models[place] = assemble(own, parts, where)
    if "palette" not in about:
        return material_of(about["material"], models, "material")
    names = [str(member["name"]) for member in about["palette"]]
    members = [
        material_of(member["material"], models, f"palette: {name}")
        for name, member in zip(names, about["palette"], strict=True)
    ]
    return Palette(members, names)


def _check_kind(about: Mapping[str, Any], where: str, colour: str = COLOUR) -> None:
    """Raise InputError unless it is in the quantity that models have, and in this colour space."""
    for name, wanted in (("quantity", QUANTITY), ("colour", colour)):
        if about.get(name) != wanted:
            raise InputError(f"{where}: {name}: expected {wanted}, got {about.get(name)!r:.80}")


def _read_about(path: Path) -> dict[str, Any]:
    """The metadata, read before any tensor is."""
    ours = f"{path}: expected a model of raden_torch, got another file; `raden fit` writes one"
    try:
        check_seekable(path)
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(64)
            if head[8:9] != b"{":
                raise InputError(ours.replace("another file", head_in_words(head)))
            file.seek(0)
            start = file.read(8)
            length = struct.unpack("<Q", start)[0] if len(start) == 8 else 0
            if not 2 <= length <= min(size - 8, _MAX_HEADER) or size > _MAX_BYTES:
                raise InputError(ours)
            header = json.loads(file.read(length))
    except OSError as error:
        raise InputError(f"{path}: expected a model file, got {why(error)}") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(ours) from None
    metadata = header.get("__metadata__") if isinstance(header, dict) else None
    if not isinstance(metadata, dict) or metadata.get("format") != FORMAT:
        raise InputError(ours)
    try:
        about = json.loads(metadata["about"])
        version = int(about["version"])
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError):
        raise InputError(f"{path}: expected a model's metadata, got damaged ones") from None
    if version > SPECTRAL_VERSION:
        raise InputError(
            f"{path}: model format: expected up to {SPECTRAL_VERSION}, got {version}; update "
            "raden_torch"
        )
    return dict(about)


def assemble(
    about: dict[str, Any], tensors: Mapping[str, torch.Tensor], where: str = "metadata"
) -> RadenBrdf:
    """A model from what `describe` says of it and its `state_dict`.

    Raises:
        InputError: the two do not make a model.
        KeyError, TypeError, ValueError: nor do the tensors.
    """
    from raden_torch.schema import checked

    said = checked(about, _About, where)
    diffuse = table = None
    if "diffuse.scale" in tensors:
        diffuse = CosineDiffuse(tensors["diffuse.scale"], tensors["diffuse.exponent"])
    if "table.values" in tensors:
        if said.first_deg is None or said.step_deg is None:
            raise InputError(f"{where}: expected first_deg and step_deg of the table, got none")
        table = ReflectanceTable(
            tensors["table.values"], said.first_deg, said.step_deg, said.pieces
        )
    model = RadenBrdf(
        diffuse,
        table,
        diffuse_gain=said.diffuse_gain,
        specular_gain=said.specular_gain,
        provenance=said.provenance,
    )
    model.layout = said.runtime or choose_layout(model)  # older files have none
    if "errors.own" in tensors:
        model.errors = TableErrors(tensors["errors.own"], tensors["errors.shared"], said.scale_std)
        if tuple(model.errors.own.shape[:3]) != model.layout.shape:
            raise InputError(
                f"{where}: errors: expected {list(model.layout.shape)} nodes, as the runtime table "
                f"has, got {list(model.errors.own.shape[:3])}"
            )
    return model


def _spectral(about: dict[str, Any], tensors: Mapping[str, torch.Tensor]) -> SpectralBrdf:
    """A spectral model; errors as of `_several`."""
    _check_kind(about, "file", IN_BANDS)
    return spectral_of(about["spectral"], tensors, "spectral")


_READERS = {"models": _several, "spectral": _spectral}
"""By what of the metadata only they have."""
