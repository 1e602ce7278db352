"""A viewer in one file: a page that shows a shell in WebGL 2, from disk and without a network."""

from __future__ import annotations

import base64
import copy
import html
import json
import os
from pathlib import Path
from typing import Any

from raden_torch.brdf.model.model import RadenBrdf
from raden_torch.brdf.model.runtime_table import RuntimeLayout
from raden_torch.errors import InputError, check_type
from raden_torch.export.forms import RuntimeForm, runtime_form
from raden_torch.export.shading_language import shader_source
from raden_torch.export.table_file import half_precision_texture
from raden_torch.files import check_output, written_beside

LARGEST_BYTES = 3_000_000
"""Of a page; two shells of the default size fit."""

_PARTS = Path(__file__).parent / "viewer"
_SCRIPTS = (
    "meshes.js",
    "table.js",
    "surroundings.js",
    "radiance_file.js",
    "cameras.js",
    "shading.js",
    "drawing.js",
    "point.js",
    "headset.js",
    "viewer.js",
)
_DIFFUSE_NODES = (16, 29, 41)


def export_viewer(
    model: RadenBrdf, path: str | os.PathLike[str], *, compare: RadenBrdf | None = None
) -> int:
    """Write a page that shows a model: a sphere, a plate with a motif, and meshes that are dropped.

    Args:
        model: on the CPU.
        path: the .html file to write.
        compare: a second shell, shown beside the first at a slider.

    Returns:
        The page's size in bytes, at most `LARGEST_BYTES`.

    Raises:
        InputError: another suffix, tables too large for a page or a texture, or a file that cannot
            be written.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.export.viewer_file import export_viewer
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> 10_000 < export_viewer(model, "shell.html") < 3_000_000
        True
    """
    shells = [model] if compare is None else [model, compare]
    for shell in shells:
        check_type(
            "model", shell, RadenBrdf, "load_model reads one from a file; fit(…).model is one"
        )
    target = check_output(path, (".html",))
    page = viewer_page(shells, str(target)).encode()
    with written_beside(target) as temporary:
        temporary.write_bytes(page)
    return len(page)


def viewer_page(shells: list[RadenBrdf], where: str = "viewer") -> str:
    """The page as text, of one shell or two.

    Raises:
        InputError: it is larger than `LARGEST_BYTES`, or a table is too large for a texture.
    """
    page = _page(shells)
    size = len(page.encode())
    if size > LARGEST_BYTES:
        raise InputError(
            f"{where}: expected a page of at most {LARGEST_BYTES} bytes, got {size}; set "
            "model.layout to a RuntimeLayout with fewer nodes"
        )
    return page


def _page(shells: list[RadenBrdf]) -> str:
    described: list[dict[str, Any]] = []
    functions: list[str] = []
    for place, shell in enumerate(shells):
        source = shell.provenance
        parts = {"all": runtime_form(shell), "diffuse": runtime_form(_diffuse(shell))}
        name = source.sample or "unnamed sample"
        about: dict[str, Any] = {"sample": name, "simulated": source.simulated}
        for part, form in parts.items():
            about[part] = _table(form)
            text = shader_source(form, source, ".glsl", "the page")
            function = text[text.index("uniform") :]
            for old, new in zip(("raden_brdf", "raden_table"), _names(part), strict=True):
                function = function.replace(old, f"{new}_{place}")
            functions.append(function)
        described.append(about)
    names = " and ".join(about["sample"] for about in described)
    # nothing in it may end or open an element
    data = json.dumps(described).replace("<", "\\u003c")
    script = "\n".join((_PARTS / name).read_text("utf-8") for name in _SCRIPTS)
    page = (_PARTS / "page.html").read_text("utf-8")
    for hole, text in (
        ("/*title*/", html.escape(f"Raden: {names}")),
        ("/*style*/", (_PARTS / "style.css").read_text("utf-8")),
        ("/*functions*/", "\n".join(functions)),
        ("/*script*/", script),
        ("/*shells*/", data),
    ):
        page = page.replace(hole, text, 1)
    return page


def _names(part: str) -> tuple[str, str]:
    """Of a part's function and of its texture."""
    return ("shell", "table") if part == "all" else ("diffuse", "diffuse_table")


def _diffuse(model: RadenBrdf) -> RadenBrdf:
    """The diffuse part alone, which is smooth: few nodes are enough."""
    own = copy.deepcopy(model)
    own.specular_gain = 0.0
    u, v, w = (min(n, few) for n, few in zip(own.layout.shape, _DIFFUSE_NODES, strict=True))
    own.layout = RuntimeLayout((u, v, w), own.layout.warp)
    return own


def _table(form: RuntimeForm) -> dict[str, Any]:
    texture, _ = half_precision_texture(form)
    rgb = texture[..., :3].tobytes()
    return {
        "sides": list(texture.shape[:3]),
        "warp": list(form.warp),
        "rgb": base64.b64encode(rgb).decode(),
    }
