"""Models on disk: one safetensors file with JSON metadata. No pickle."""

from __future__ import annotations

import json
import os
import struct
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from raden_torch.brdf.model.layout_choice import choose_layout
from raden_torch.brdf.model.model import CosineDiffuse, Provenance, RadenBrdf
from raden_torch.brdf.model.reflectance_table import Pieces, ReflectanceTable
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError, check_type
from raden_torch.files import check_output, check_seekable, written_beside

FORMAT = "raden_torch model"
VERSION = 1
QUANTITY = "f_r in 1/sr, without the cosine"
COLOUR = "linear RGB, sRGB primaries, D65 white, unclipped"
_MAX_HEADER = 16_000_000
_MAX_BYTES = 2_000_000_000


def save_model(model: RadenBrdf, path: str | os.PathLike[str]) -> None:
    """Write a model; `load_model` gives back an equal one.

    Raises:
        InputError: a suffix other than .safetensors, or a place that cannot be written.
    """
    from safetensors.torch import save

    check_type("model", model, RadenBrdf, "fit(…).model is one")
    target = check_output(path, (".safetensors",))
    about = describe(model)
    tensors = {
        name: value.detach().cpu().contiguous() for name, value in model.state_dict().items()
    }
    data = save(tensors, {"format": FORMAT, "about": json.dumps(about)})
    with written_beside(target) as temporary:
        temporary.write_bytes(data)


def describe(model: RadenBrdf) -> dict[str, Any]:
    """All of a model that is not a tensor, as plain JSON values; `assemble` reads it."""
    about: dict[str, Any] = {
        "version": VERSION,
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
    return about


def load_model(path: str | os.PathLike[str]) -> RadenBrdf:
    """Read a model that `save_model` wrote, onto the CPU.

    Raises:
        InputError: not a file of ours, of a newer format, truncated, or holding values that are
            not finite.
    """
    from safetensors import SafetensorError
    from safetensors.torch import load

    path = Path(path)
    about = _read_about(path)
    try:
        tensors = load(path.read_bytes())
        model = assemble(about, tensors)
    except (SafetensorError, KeyError, TypeError, ValueError, OverflowError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: a raden_torch model with wrong content: {reason}") from None
    for name, value in model.named_parameters():
        if not torch.isfinite(value).all():
            raise InputError(f"{path}: {name}: expected finite values, got some that are not")
    return model


def _read_about(path: Path) -> dict[str, Any]:
    """The metadata, read before any tensor is."""
    ours = f"{path}: not a model of raden_torch; `raden fit` writes one"
    try:
        check_seekable(path)
        size = path.stat().st_size
        with path.open("rb") as file:
            start = file.read(8)
            length = struct.unpack("<Q", start)[0] if len(start) == 8 else 0
            if not 2 <= length <= min(size - 8, _MAX_HEADER) or size > _MAX_BYTES:
                raise InputError(ours)
            header = json.loads(file.read(length))
    except OSError as error:
        raise InputError(f"{path}: expected a model file, got an error: {error.strerror}") from None
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
        raise InputError(f"{path}: a raden_torch model with damaged metadata") from None
    if version > VERSION:
        raise InputError(
            f"{path}: model format: expected up to {VERSION}, got {version}; update raden_torch"
        )
    return dict(about)


def assemble(about: dict[str, Any], tensors: dict[str, torch.Tensor]) -> RadenBrdf:
    """A model from what `describe` says of it and its `state_dict`.

    Raises:
        KeyError, TypeError, ValueError: the two do not make a model.
    """
    diffuse = table = None
    if "diffuse.scale" in tensors:
        diffuse = CosineDiffuse(tensors["diffuse.scale"], tensors["diffuse.exponent"])
    if "table.values" in tensors:
        table = ReflectanceTable(
            tensors["table.values"],
            _three(about["first_deg"]),
            _three(about["step_deg"]),
            _pieces(about["pieces"]),
        )
    model = RadenBrdf(
        diffuse,
        table,
        diffuse_gain=float(about["diffuse_gain"]),
        specular_gain=float(about["specular_gain"]),
        provenance=Provenance(**about["provenance"]),
    )
    runtime = about.get("runtime")
    if runtime is None:  # a file from before there was a runtime form
        model.layout = choose_layout(model)
    else:
        u, v, w = (int(n) for n in runtime["shape"])
        c, k = (float(x) for x in runtime["warp"])
        model.layout = RuntimeLayout((u, v, w), (c, k))
    return model


def _three(values: list[float]) -> tuple[float, float, float]:
    a, r, t = (float(v) for v in values)
    return a, r, t


def _pieces(value: list[list[int]] | None) -> Pieces | None:
    if value is None:
        return None
    a, across, t = (tuple(int(n) for n in cuts) for cuts in value)
    return a, across, t
