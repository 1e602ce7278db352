"""MaterialX's own shader of a document, in headless Chromium."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import torch

from raden_torch.export.shading_language_check import draw_shader
from raden_torch.export.table_file import FORMAT, FORMAT_VERSION
from tests.export.browser import MODULES

_CALL = """
vec3 raden_brdf(vec3 n, vec3 l, vec3 v) {
    normalWorld = n;
    tangentWorld = abs(n.x) < 0.7 ? cross(n, vec3(1, 0, 0)) : cross(n, vec3(0, 1, 0));
    positionWorld = vec3(0);
    u_viewPosition = v;
    u_numActiveLightSources = 1;
    u_lightData[0] = LightData(1, -l, vec3(1), 1.0);
    int row = int(gl_FragCoord.y);
CALLS
    return out1.rgb / dot(n, l);
}
"""

_ATAN = """
// SwiftShader's atan(-0.0, 1.0) is pi
float mx_atan(float x) { return atan(x); }
float mx_atan(float y, float x) { return atan(y == 0.0 ? 0.0 : y, x); }
vec3 mx_atan(vec3 y, vec3 x) { return atan(mix(y, vec3(0.0), equal(y, vec3(0.0))), x); }
"""


def document(text: str):
    """The document with the standard libraries, read by MaterialX."""
    import MaterialX as mx

    library, found = mx.createDocument(), mx.createDocument()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), mx.getDefaultDataSearchPath(), library)
    found.setDataLibrary(library)
    mx.readFromXmlString(found, text)
    return found


def essl(text: str) -> str:
    """The pixel shader that MaterialX generates of it, for one directional lamp."""
    import MaterialX as mx
    from MaterialX import PyMaterialXGenGlsl as glsl
    from MaterialX import PyMaterialXGenShader as gen

    found = document(text)
    generator = glsl.EsslShaderGenerator.create()
    context = gen.GenContext(generator)
    context.registerSourceCodeSearchPath(mx.getDefaultDataSearchPath())
    options = context.getOptions()
    options.shaderInterfaceType = gen.SHADER_INTERFACE_REDUCED
    options.hwSpecularEnvironmentMethod = gen.SPECULAR_ENVIRONMENT_NONE
    options.hwMaxActiveLightSources = 1
    lamp = found.getDataLibrary().getNodeDef("ND_directional_light")
    gen.HwShaderGenerator.bindLightShader(lamp, 1, context)
    shader = generator.generate("shell", found.getNode("raden_shell"), context)
    return shader.getSourceCode(gen.PIXEL_STAGE)


def drawn(texts: list[str], folder: Path, *vectors: np.ndarray) -> np.ndarray:
    """f_r `[documents, N, 3]` by those shaders, for normals, lights and views `[N, 3]`."""
    parts = [essl(text).partition("void main()") for text in texts]
    (shared,) = {before for before, _, _ in parts}  # they differ in the values alone
    # 1.39.5 reads it without declaring it where there are no surroundings
    source = shared.replace("#version 300 es", "const bool u_refractionTwoSided = false;")
    # what a program sets becomes a variable that the call sets
    source = re.sub(r"^(?:uniform|in|out) (.*;)$", r"\1", source, flags=re.M)
    source = source.replace("#define mx_atan atan", _ATAN)
    calls = []
    for k, (_, _, body) in enumerate(parts):
        source += f"void materialx_{k}()" + body
        calls.append(f"    if (row == {k}) materialx_{k}();")
    (folder / "shell.glsl").write_text(source + _CALL.replace("CALLS", "\n".join(calls)))
    (folder / "none.bin").write_bytes(bytes(8 * 4**3))
    about = {"format": FORMAT, "format_version": FORMAT_VERSION, "table": "none.bin"}
    about |= {"width": 4, "height": 4, "depth": 4, "warp": [0.4, 0.4]}
    (folder / "shell.json").write_text(json.dumps(about))
    maps = [
        torch.from_numpy(v.T.copy()).float()[None, :, None].expand(1, 3, len(texts), len(v))
        for v in vectors
    ]
    f = draw_shader(folder / "shell.glsl", *maps, node_modules=MODULES)
    return f[0].movedim(0, -1).double().numpy()
