"""Views of an exported Blender script drawn by Cycles: Blender as the module `bpy`, in an environment of its own.

`python3.11 -m venv blender && blender/bin/pip install bpy==4.2.23` makes one; its interpreter is what experiments are
given.
"""

import json
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from experiments.export_views import EYE, FARTHEST, VIEWS
from fit import exr

SECONDS = 900  # that Blender may take

SCRIPT = """
import json, math, runpy, sys
import bpy, mathutils
given = json.loads(sys.argv[1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
runpy.run_path(given["script"], run_name="__main__")
render, cycles = scene.render, scene.cycles
render.threads_mode, render.threads = "FIXED", 1
cycles.device, cycles.samples, cycles.use_denoising, cycles.seed = "CPU", given["samples"], False, 1
cycles.use_adaptive_sampling = False
cycles.pixel_filter_type, cycles.filter_width = "GAUSSIAN", 0.01  # rays through the centres of pixels
cycles.max_bounces = 0
render.resolution_x = render.resolution_y = given["pixels"]
render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera = camera
camera.data.angle, camera.data.clip_start, camera.data.clip_end = math.pi / 2, 0.1, 1e6
camera.location = (0, 0, given["eye"])
if given["fog"]:
    bpy.ops.mesh.primitive_plane_add(size=2 * given["farthest"])
    material = bpy.data.materials.new("plain")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    emission, out = nodes.new("ShaderNodeEmission"), nodes.new("ShaderNodeOutputMaterial")
    emission.inputs["Color"].default_value = (*3 * [given["plain"]], 1)
    material.node_tree.links.new(emission.outputs[0], out.inputs["Surface"])
    bpy.context.object.data.materials.append(material)
for lamp in list(bpy.data.lights):
    bpy.data.lights.remove(lamp)  # nothing here is lit by it, and a setting sun's would only add noise
for name, (forward, up) in given["views"].items():
    forward, up = mathutils.Vector(forward), mathutils.Vector(up)
    turn = mathutils.Matrix((forward.cross(up), up, -forward)).transposed()
    camera.rotation_euler = turn.to_euler()
    render.filepath = given["out"] + "/" + name + ".exr"
    bpy.ops.render.render(write_still=True)
print("blender", bpy.app.version_string)
"""


def drawn(
    python: Path, folder: Path, plain: float, pixels: int, samples: int
) -> tuple[str, Mapping[str, Float[Tensor, "n n 3"]]]:
    """Blender's version, and views of the weather of an exported folder.

    Raises:
        RuntimeError: when Blender fails.
    """
    with tempfile.TemporaryDirectory() as out:
        given = {
            "script": str((folder / "weather.py").resolve()),
            "out": out,
            "eye": EYE,
            "farthest": FARTHEST,
            "plain": plain,
            "fog": "'fog': None" not in (folder / "weather.py").read_text(encoding="utf-8"),
            "pixels": pixels,
            "samples": samples,
            "views": VIEWS,
        }
        told = subprocess.run(
            [str(python), "-c", SCRIPT, json.dumps(given)], capture_output=True, text=True, check=False, timeout=SECONDS
        )
        version = [line for line in told.stdout.splitlines() if line.startswith("blender ")]
        if told.returncode != 0 or not version:
            raise RuntimeError(f"Blender fails: {told.stderr[-600:]}")
        pictures = {name: exr.read(Path(out) / f"{name}.exr").radiance for name in VIEWS}
    return version[0].split()[1], {n: torch.from_numpy(np.array(one, np.float32)) for n, one in pictures.items()}
