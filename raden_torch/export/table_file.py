"""The runtime form as a texture in a file: a .bin in half precision, and the .json that says how it
is laid out and what it is. GLSL, WGSL and Mitsuba's plugin read it (decision 34)."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch

from raden_torch.brdf.files.model_file import load_rgb
from raden_torch.brdf.materials.anisotropic import AnisotropicBrdf
from raden_torch.brdf.materials.surface import Reflection
from raden_torch.brdf.model.model import Provenance
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError, why
from raden_torch.export.forms import RuntimeForm, form_of
from raden_torch.export.whole_reflection import highlight_roughness, view_albedo
from raden_torch.files import written_beside

FORMAT = "raden_torch shader table"
FORMAT_VERSION = 1
LARGEST_SIDE = 256
"""Texels along an axis of a 3-D texture that every WebGL 2 device takes."""

_TEXEL_BYTES = 8
_MOST_JSON = 1_000_000


def write_table(
    form: RuntimeForm, source: Provenance, table: Path, about: Path
) -> tuple[int, float]:
    """Write the texture and its description.

    Returns:
        The texture's bytes, and the largest change that half precision makes to a node over the
        peak.

    Raises:
        InputError: a value is not finite in half precision, a side is too long, or a file cannot be
            written.
    """
    texture, change = half_precision_texture(form)
    described = json.dumps(describe(form, source, table.name), indent=1) + "\n"
    for target, data in ((table, texture.tobytes()), (about, described.encode())):
        with written_beside(target) as temporary:
            temporary.write_bytes(data)
    return texture.nbytes, change


def half_precision_texture(form: RuntimeForm) -> tuple[np.ndarray, float]:
    """`[U, V, W, 4]` little-endian float16 with alpha 1, and the largest change over the peak.

    Raises:
        InputError: a value is not finite in half precision, or a side is too long.
    """
    shape = form.table.shape[:3]
    if max(shape) > LARGEST_SIDE:
        raise InputError(
            f"runtime table: expected at most {LARGEST_SIDE} nodes along each axis, as a texture "
            f"takes, got {list(shape)}; set model.layout to a RuntimeLayout with fewer"
        )
    single = form.table.detach().float()
    half = single.half()
    if not torch.isfinite(half).all():
        raise InputError(
            "model: expected f_r within half precision, 65504 per sr, got "
            f"{float(single.abs().max()):.4g}"
        )
    peak = float(single.abs().max())
    change = float((half.float() - single).abs().max()) / peak if peak else 0.0
    texture = np.ones((*shape, 4), "<f2")
    texture[..., :3] = half.numpy()
    return texture, change


def describe(form: RuntimeForm, source: Provenance, table: str) -> dict[str, Any]:
    """What the JSON file beside a table says: how to read it, and what it is."""
    x, y, z = texels_of(form)
    return {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "table": table,
        "width": x,
        "height": y,
        "depth": z,
        "texel": "RGBA, float16, little-endian; x fastest, then y",
        "bytes": x * y * z * _TEXEL_BYTES,
        "quantity": "f_r in 1/sr, linear RGB with sRGB primaries",
        "warp": list(form.warp),
        "directional_albedo": view_albedo(form),
        "roughness": round(highlight_roughness(form), 4),
        "source": {k: v for k, v in asdict(source).items() if k != "fit"},
    }


def texels_of(form: RuntimeForm) -> tuple[int, int, int]:
    """Along x, y and z: the nodes along w, v and u."""
    u, v, w = form.table.shape[:3]
    return w, v, u


def read_form(path: Path) -> RuntimeForm:
    """The table of a .json file of `raden export`, or of a .safetensors model file.

    Raises:
        InputError: another suffix, a damaged file, or one that no single table holds.
    """
    if path.suffix == ".json":
        about, table = described(path)
        return form_in(path, about, table)
    if path.suffix != ".safetensors":
        raise InputError(
            f"{path}: expected a table (the .json of `raden export`) or a model (.safetensors), "
            f"got {path.suffix or 'no suffix'}"
        )
    try:
        return single_table(load_rgb(path))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def single_table(model: Reflection) -> RuntimeForm:
    """The runtime form of a model or another material of the three angles.

    Raises:
        InputError: a palette, or a sample of several azimuths: no single table holds these.
    """
    if isinstance(model, AnisotropicBrdf):
        raise InputError(
            f"model: expected an isotropic sample, got one of {len(model.azimuth_deg)} azimuths"
        )
    form = form_of(model, "runtime")
    if not isinstance(form, RuntimeForm):
        raise InputError("model: expected one material, got a palette; export its members")
    return form


def described(path: Path) -> tuple[dict[str, Any], bytes]:
    """The description of a table, checked, and the table's bytes.

    Args:
        path: the .json file, or another of the same name beside it.

    Raises:
        InputError: a file is missing, another kind of file, or of another size than it says.
    """
    beside = path.with_suffix(".json")
    try:
        if beside.stat().st_size > _MOST_JSON:
            raise ValueError
        about = json.loads(beside.read_text("utf-8"))
        known = about["format"], about["format_version"]
        table = path.with_name(Path(about["table"]).name)
        size = table.stat().st_size
    except OSError as error:
        raise InputError(
            f"{error.filename}: expected a file of `raden export`, got {why(error)}"
        ) from None
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{beside}: expected the description of a shader's table") from None
    if known != (FORMAT, FORMAT_VERSION):
        raise InputError(
            f"{beside}: expected {FORMAT!r} version {FORMAT_VERSION}, got {known[0]!r} version "
            f"{known[1]!r}"
        )
    wanted = _TEXEL_BYTES * _layout(beside, about).nodes
    if size != wanted:
        raise InputError(f"{table}: expected {wanted} bytes, got {size}")
    return about, table.read_bytes()


def form_in(path: Path, about: dict[str, Any], table: bytes) -> RuntimeForm:
    """The form of what `described` gives.

    Raises:
        InputError: a value is not finite.
    """
    layout = _layout(path.with_suffix(".json"), about)
    texels = np.frombuffer(table, "<f2").astype(np.float32).reshape(*layout.shape, 4)
    if not np.isfinite(texels).all():
        raise InputError(
            f"{path.with_name(about['table'])}: expected finite values, got some that are not"
        )
    return RuntimeForm(torch.from_numpy(np.ascontiguousarray(texels[..., :3])), layout)


def _layout(beside: Path, about: dict[str, Any]) -> RuntimeLayout:
    try:
        shape = tuple(int(about[side]) for side in ("depth", "height", "width"))
        return RuntimeLayout(shape, tuple(float(c) for c in about["warp"]))  # type: ignore[arg-type]
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{beside}: expected a table's sides and warp, got {error}") from None
