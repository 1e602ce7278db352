"""The runtime form as a function in a shading language, with its table as a 3-D texture.

One template gives GLSL ES 3.00 (WebGL 2) and WGSL (WebGPU). The formulas are those of
`brdf/model/runtime_table.py`; the trilinear read is the texture unit's.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from raden_torch import __version__
from raden_torch.brdf.model.model import Provenance, RadenBrdf
from raden_torch.errors import InputError
from raden_torch.export.forms import RuntimeForm, runtime_form
from raden_torch.export.table_file import texels_of, write_table
from raden_torch.files import check_outputs, written_beside

LANGUAGES = {".glsl": "GLSL ES 3.00 (WebGL 2)", ".wgsl": "WGSL (WebGPU)"}
# FLOAT, VEC3 and BOOL declare a constant; CHOOSE(a, b, c) is b where c is true, else a. Nothing
# branches. N·(L × d) = (N × L)·d.
_FUNCTION = """\
FLOAT n_l = dot(n, l);
FLOAT n_v = dot(n, v);
FLOAT middle = n_l + n_v;
VEC3 d = v - l;
VEC3 m = cross(n, l);
FLOAT square = dot(d, d);
// L and V may agree to the last bit: then the plane of L and N is taken
BOOL apart = square > {parallel};
FLOAT delta = CHOOSE(1.0, sqrt(square), apart);
FLOAT y = CHOOSE(length(m), dot(n, d) - 0.25 * middle * dot(d, l + v), apart);
FLOAT z = CHOOSE(0.0, dot(m, d), apart);
FLOAT half_angle = CHOOSE(0.0, delta / (2.0 + sqrt(max(4.0 - square, 1e-12))), apart);
FLOAT lower = max(min(n_l, n_v), 0.0);
FLOAT across = y / max(abs(y) + {c} * delta * lower, 1e-30);
FLOAT along = z / max(abs(z) + {k} * delta * max(middle, 0.0), 1e-30);
VEC3 texel = vec3(along, across, half_angle) * vec3({scale})
    + vec3({offset});
VEC3 f = FETCH;
BOOL above = n_l > 0.0 && n_v > 0.0;
return CHOOSE3(vec3(0.0), f, above);
"""

_HEAD = """\
// {title}
// Written by raden_torch {version}. {language}.
//
// vec3 raden_brdf(vec3 n, vec3 l, vec3 v): f_r in 1/sr of the surface, linear RGB with sRGB
// primaries, not clipped (iridescent colours may be negative), without the cosine: the radiance is
//     raden_brdf(n, l, v) * irradiance * max(dot(n, l), 0.0)
// n, l, v: unit vectors in one frame, away from the surface: the normal, to the light, to the
// viewer. 0 where light or viewer is below the horizon; finite for every finite vector.
//
// raden_table: the table in {table} as a 3-D texture of {shape} texels, RGBA in half precision
// (little-endian, x fastest), linear filtering, clamped to the edge, one level.
{binding}//
// {source}
"""

_BINDING = {
    ".glsl": "",
    ".wgsl": "// Its format is rgba16float. Groups and bindings may be changed.\n",
}


@dataclass(frozen=True)
class ShaderReport:
    """What was written.

    Attributes:
        language, files: the text, the table and its description.
        texels: of the table, along x, y and z.
        table_bytes: of the table.
        half_precision: the largest change that half precision makes to a node, over the peak.
    """

    language: str
    files: tuple[Path, ...]
    texels: tuple[int, int, int]
    table_bytes: int
    half_precision: float

    def __str__(self) -> str:
        x, y, z = self.texels
        return (
            f"{self.language}: {x} x {y} x {z} texels, {self.table_bytes} bytes; half precision "
            f"changes a node by at most {self.half_precision:.1e} of the peak"
        )


def export_shader(model: RadenBrdf, path: str | os.PathLike[str]) -> ShaderReport:
    """Write a model as a function for real-time graphics.

    Beside `shell.glsl` or `shell.wgsl`, the text, go `shell.bin`, the table in half precision, and
    `shell.json`, which says how it is laid out.

    Args:
        model: on the CPU.
        path: ends in .glsl or .wgsl.

    Raises:
        InputError: another suffix; a model that is not finite in half precision, or whose table is
            too large for a texture; a file cannot be written.

    Examples:
        >>> import raden_torch as rt
        >>> from raden_torch.export.shading_language import export_shader
        >>> model = rt.fit(rt.simulate_specimen("akoya", step_deg=35)).model
        >>> report = export_shader(model, "shell.glsl")
        >>> [file.name for file in report.files], report.half_precision < 5e-4
        (['shell.glsl', 'shell.bin', 'shell.json'], True)
    """
    form = runtime_form(model)
    text, table, about = (Path(path).with_suffix(s) for s in (Path(path).suffix, ".bin", ".json"))
    check_outputs(text, table, about)
    if text.suffix not in LANGUAGES:
        raise InputError(f"{text}: suffix: expected {' or '.join(LANGUAGES)}, got {text.suffix!r}")
    source = shader_source(form, model.provenance, text.suffix, table.name)
    size, change = write_table(form, model.provenance, table, about)
    with written_beside(text) as temporary:
        temporary.write_bytes(source.encode())
    files = (text, table, about)
    return ShaderReport(LANGUAGES[text.suffix], files, texels_of(form), size, change)


def shader_source(form: RuntimeForm, source: Provenance, suffix: str, table: str) -> str:
    """The text of the function in the language of a suffix.

    Args:
        form: the runtime form; its constants go into the text.
        suffix: of `LANGUAGES`.
        table: the name of the table's file, for the comment.
    """
    texels = texels_of(form)
    # nodes are the texels' centres: v, w in −1…1 and u in 0…1
    scale = [(n - 1) / n / (1 if axis == 2 else 2) for axis, n in enumerate(texels)]
    offset = [0.5 / n if axis == 2 else 0.5 for axis, n in enumerate(texels)]
    body = _FUNCTION.format(
        parallel=_number((4 * float(np.finfo(np.float32).eps)) ** 2),
        c=_number(form.warp[0]),
        k=_number(form.warp[1] / 2),
        scale=", ".join(map(_number, scale)),
        offset=", ".join(map(_number, offset)),
    )
    kind = "SIMULATED sample" if source.simulated else "sample"
    readings = source.measurement_sha256 and f"readings {source.measurement_sha256}"
    origin = (f"{kind}: {source.sample or 'unnamed'}", source.instrument, readings)
    head = _HEAD.format(
        title=f"Reflection of mother-of-pearl: {one_line(source.sample) or 'an unnamed sample'}",
        version=__version__,
        language=LANGUAGES[suffix],
        table=one_line(table),
        shape=" x ".join(map(str, texels)),
        binding=_BINDING[suffix],
        source="\n// ".join(one_line(part) for part in origin if part),
    )
    return head + (_wgsl(body) if suffix == ".wgsl" else _glsl(body))


def _glsl(body: str) -> str:
    for name, kind in (("FLOAT", "highp float"), ("VEC3", "highp vec3"), ("BOOL", "bool")):
        body = re.sub(rf"^{name} ", f"{kind} ", body, flags=re.M)
    body = body.replace("FETCH", "textureLod(raden_table, texel, 0.0).rgb")
    body = re.sub(r"CHOOSE3\((.*), above\)", r"mix(\1, bvec3(above))", body).replace(
        "CHOOSE", "mix"
    )
    return (
        "precision highp float;\nuniform highp sampler3D raden_table;\n\n"
        f"vec3 raden_brdf(vec3 n, vec3 l, vec3 v) {{\n{_indented(body)}}}\n"
    )


def _wgsl(body: str) -> str:
    body = re.sub(r"^(FLOAT|VEC3|BOOL) ", "let ", body, flags=re.M)
    body = body.replace("FETCH", "textureSampleLevel(raden_table, raden_sampler, texel, 0.0).rgb")
    body = re.sub(r"CHOOSE3?\(", "select(", body).replace("vec3(", "vec3f(")
    return (
        "@group(0) @binding(0) var raden_table: texture_3d<f32>;\n"
        "@group(0) @binding(1) var raden_sampler: sampler;\n\n"
        f"fn raden_brdf(n: vec3f, l: vec3f, v: vec3f) -> vec3f {{\n{_indented(body)}}}\n"
    )


def _indented(body: str) -> str:
    return "".join(f"    {line}\n" for line in body.splitlines())


def _number(x: float) -> str:
    """As both languages take it, to single precision."""
    text = f"{x:.9g}"
    return text if "." in text or "e" in text else text + ".0"


def one_line(text: str) -> str:
    """Text that cannot leave a comment of one line."""
    return " ".join(str(text).split())
