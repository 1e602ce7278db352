"""Write the G-buffer of a Blender scene: a multilayer EXR and its camera as JSON.

    blender --background shot.blend --python write_gbuffer.py -- shot.exr

Then

    raden render shell.safetensors --gbuffer shot.exr --preset blender --camera-file shot.json

lights it. After `pip install bpy` it works without Blender: `python write_gbuffer.py shot.blend
shot.exr`. Rendered by Cycles with one sample a pixel, from its middle, so that no normal is a
mixture of two.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import bpy


def write(output: Path) -> None:
    """Render the passes that `raden render --preset blender` reads, and the camera beside them."""
    scene = bpy.context.scene
    for layer in scene.view_layers:
        layer.use_pass_normal = layer.use_pass_position = layer.use_pass_z = True
        layer.use_pass_material_index = True  # Material properties > Settings > Pass Index
    scene.render.engine = "CYCLES"
    scene.cycles.samples = 1
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"
    scene.render.filepath = str(output.resolve())
    bpy.ops.render.render(write_still=True)

    camera, picture = scene.camera, scene.render
    lens = camera.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(),
        x=picture.resolution_x,
        y=picture.resolution_y,
        scale_x=picture.pixel_aspect_x,
        scale_y=picture.pixel_aspect_y,
    )
    pose = {
        "camera_to_world": [list(row) for row in camera.matrix_world],
        "fov_deg": math.degrees(2 * math.atan(1 / lens[0][0])),
    }
    output.with_suffix(".json").write_text(json.dumps(pose, indent=1) + "\n")


if __name__ == "__main__":
    if "--" in sys.argv:  # inside Blender, which has loaded the scene
        write(Path(sys.argv[sys.argv.index("--") + 1]))
    else:
        bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
        write(Path(sys.argv[2]))
