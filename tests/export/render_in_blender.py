"""A ball of one OSL shader under a sun, by Cycles.

    python render_in_blender.py shell.osl out.exr x,y,z SIZE

Run by a Python that has Blender's `bpy`. The ball has radius 1 about 0, the camera is at (0, 0, 6);
the sun's irradiance is π, its direction x,y,z points to it.
"""

import math
import sys
from pathlib import Path

import bpy
import mathutils

shader, output, sun, size = Path(sys.argv[1]).resolve(), sys.argv[2], sys.argv[3], int(sys.argv[4])
version = f"python{sys.version_info[0]}.{sys.version_info[1]}"
sys.path.append(bpy.utils.resource_path("LOCAL") + f"/python/lib/{version}/site-packages")
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.engine = "CYCLES"
scene.cycles.device, scene.cycles.shading_system = "CPU", True
scene.cycles.samples, scene.cycles.max_bounces = 1, 0
scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
scene.render.resolution_x = scene.render.resolution_y = size

bpy.ops.mesh.primitive_uv_sphere_add(segments=256, ring_count=128)
ball = bpy.context.object
bpy.ops.object.shade_smooth()
material = bpy.data.materials.new("raden")
material.use_nodes = True
nodes = material.node_tree.nodes
nodes.clear()
script = nodes.new("ShaderNodeScript")
script.mode, script.filepath = "EXTERNAL", str(shader)

from cycles.osl import update_script_node  # noqa: E402

update_script_node(script, lambda kind, text: print(kind, text))
surface = nodes.new("ShaderNodeOutputMaterial").inputs["Surface"]
material.node_tree.links.new(script.outputs["BSDF"], surface)
ball.data.materials.append(material)

lens = bpy.data.cameras.new("camera")
lens.angle = math.radians(22)
scene.camera = bpy.data.objects.new("camera", lens)
scene.camera.location = (0, 0, 6)
lamp = bpy.data.lights.new("sun", "SUN")
lamp.energy, lamp.angle = math.pi, 0
star = bpy.data.objects.new("sun", lamp)
towards = mathutils.Vector([float(x) for x in sun.split(",")])
star.rotation_euler = towards.to_track_quat("Z", "Y").to_euler()
for thing in (scene.camera, star):
    scene.collection.objects.link(thing)
# not its normals: Cycles' pass is the mean of the closures' own
scene.view_layers[0].use_pass_position = True
scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
scene.render.image_settings.color_depth = "32"
scene.render.filepath = output
bpy.ops.render.render(write_still=True)
