"""Views of an exported weather.js drawn by three.js, and of three.js' own Sky, read back in float."""

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from experiments import browser
from experiments.export_views import EYE, FARTHEST, VIEWS

PAGE = """<!doctype html><html><body><pre id="out"></pre>
IMPORTS
<script type="module">
import * as THREE from 'three';
import { Sky } from 'three/addons/objects/Sky.js';
import * as weather from './weather.js';
const given = GIVEN, size = given.pixels;
const renderer = new THREE.WebGLRenderer();
renderer.setSize(size, size);
const target = new THREE.WebGLRenderTarget(size, size, { type: THREE.FloatType });
const ours = ([x, y, z]) => new THREE.Vector3(-y, z, -x);
function drawn(scene, view) {
  const camera = new THREE.PerspectiveCamera(90, 1, 0.1, 1e6);
  camera.position.set(0, given.eye, 0);
  camera.up.copy(ours(view[1]));
  camera.lookAt(ours(view[0]).add(camera.position));
  renderer.setRenderTarget(target);
  renderer.render(scene, camera);
  const found = new Float32Array(4 * size * size);
  renderer.readRenderTargetPixels(target, 0, 0, size, size, found);
  const bytes = new Uint8Array(found.buffer);
  let text = '';
  for (let at = 0; at < bytes.length; at += 8192) text += String.fromCharCode(...bytes.subarray(at, at + 8192));
  return btoa(text);
}
const views = Object.entries(given.views);
const all = (scene) => Object.fromEntries(views.map(([name, view]) => [name, drawn(scene, view)]));
const scene = new THREE.Scene();
weather.enableFog(scene);
scene.add(weather.createSky({ disc: false }), weather.createSun());
if (scene.fog) {
  const grey = new THREE.Color().setRGB(given.plain, given.plain, given.plain, THREE.LinearSRGBColorSpace);
  const plain = new THREE.PlaneGeometry(2 * given.farthest, 2 * given.farthest, 64, 64);
  const plane = new THREE.Mesh(plain, new THREE.MeshBasicMaterial({ color: grey }));
  plane.rotation.x = -Math.PI / 2;
  plane.position.set(61.7, 0, 43.1); // a vertex under the camera, at w = 0, is drawn wrongly by SwiftShader
  scene.add(plane);
}
const exported = all(scene);
const own = new THREE.Scene(), sky = new Sky(), uniforms = sky.material.uniforms;
sky.scale.setScalar(1e5);
own.add(sky);
for (const [name, value] of Object.entries(weather.builtIn.sky)) if (name in uniforms) uniforms[name].value = value;
uniforms.showSunDisc.value = 0;
uniforms.sunPosition.value.copy(ours(weather.weather.to_sun));
const built_in = all(own);
scene.environment = weather.createEnvironment(renderer);
document.getElementById('out').textContent = JSON.stringify({ version: THREE.REVISION, exported, built_in });
</script></body></html>
"""

Drawn = Mapping[str, Float[Tensor, "n n 3"]]


@dataclass(frozen=True, eq=False)
class ByThree:
    """What three.js drew: the exported module, and its own Sky with the dials that the module tells."""

    version: str
    exported: Drawn
    built_in: Drawn


def drawn(package: Path, module: str, plain: float, pixels: int) -> ByThree:
    """Views of a module's sky and fog."""
    views = {name: list(view) for name, view in VIEWS.items()}
    given = {"pixels": pixels, "eye": EYE, "farthest": FARTHEST, "plain": plain, "views": views}
    page = PAGE.replace("IMPORTS", browser.IMPORTS).replace("GIVEN", json.dumps(given))
    left = browser.result(package, {"page.html": page, "weather.js": module})
    shown = [{name: _picture(text, pixels) for name, text in left[part].items()} for part in ("exported", "built_in")]
    return ByThree(left["version"], *shown)


def _picture(text: str, pixels: int) -> Float[Tensor, "n n 3"]:
    """Picture of a read-back, whose rows go from the bottom up."""
    values = np.frombuffer(base64.b64decode(text), "<f4").reshape(pixels, pixels, 4)
    return torch.from_numpy(values[::-1, :, :3].copy())
