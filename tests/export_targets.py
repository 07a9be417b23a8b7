"""Stand-ins for engines: an `unreal` module of documented names, and a `three` module that keeps what it is given."""

import math
from types import ModuleType, SimpleNamespace

from fit.export.engine_names import UNREAL


class Thing:
    """An object of the editor that takes the documented properties of its class and no others."""

    def __init__(self, owner):
        self.known = UNREAL[owner]
        self.values = {}

    def set_editor_property(self, name, value):
        if name not in self.known:
            raise AttributeError(f"no property {name}")
        self.values[name] = value


def unreal():
    """Module `unreal`, whose `spawned` are the actors by their label."""
    module = ModuleType("unreal")
    module.spawned = {}

    class Actor:
        def __init__(self, component, place):
            self.component, self.place, self.turn = Thing(component), place, None

        def set_actor_label(self, label):
            module.spawned[label] = self

        def get_component_by_class(self, kind):
            assert kind.__name__ == self.component_name
            return self.component

        def set_actor_rotation(self, turn, teleport):
            assert teleport is False
            self.turn = turn

    def spawn_actor_from_class(kind, place, _turn):
        made = Actor(kind.__name__ + "Component", place)
        made.component_name = kind.__name__ + "Component"
        return made

    for name in ("SkyAtmosphere", "DirectionalLight", "ExponentialHeightFog"):
        setattr(module, name, type(name, (), {}))
        setattr(module, name + "Component", type(name + "Component", (), {}))
    module.EditorActorSubsystem = object()
    module.get_editor_subsystem = lambda _: SimpleNamespace(spawn_actor_from_class=spawn_actor_from_class)
    module.SkyAtmosphereTransformMode = SimpleNamespace(PLANET_TOP_AT_ABSOLUTE_WORLD_ORIGIN="top")
    module.TentDistribution = lambda: Thing("TentDistribution")
    module.Color = lambda r, g, b, a: (r, g, b, a)
    module.LinearColor = lambda r, g, b, a: (r, g, b, a)
    module.Vector = lambda x, y, z: (x, y, z)
    module.Rotator = lambda roll=0.0, pitch=0.0, yaw=0.0: (roll, pitch, yaw)
    return module


def unreal_transmittance(fog, height, eye, distance, climb):
    """Transmittance by the engine's fog shader: centimetres, powers of 2, density that halves with height."""
    density = fog["fog_density"] / 1000.0
    falloff = fog["fog_height_falloff"] / 1000.0
    at_eye = density * 2.0 ** (-falloff * (100.0 * eye - height))
    power = falloff * 100.0 * climb
    line = (1.0 - 2.0**-power) / power if abs(power) > 1e-6 else math.log(2.0) - 0.5 * math.log(2.0) ** 2 * power
    return 2.0 ** (-at_eye * line * 100.0 * distance)


# What weather.js asks of three.js when it is read and when it makes its sky; shaders are kept as text.
THREE = """
const held = (name) => class { constructor(...given) { Object.assign(this, { name, given }); } };
export const RGBAFormat = 0, FloatType = 0, BackSide = 0, LinearSRGBColorSpace = '';
export const DataTexture = held('texture'), Mesh = held('mesh'), BoxGeometry = held('box'), Scene = held('scene');
export const ShaderMaterial = class { constructor(given) { Object.assign(this, given); } };
export const FogExp2 = held('fog');
export const ShaderChunk = { opaque_fragment: '' };
"""

# Draws the exported formulas by WebGL alone: one pixel for each ray, given as direction and length.
PAGE = """<!doctype html><html><body><pre id="out"></pre>
<script type="importmap">{"imports": {"three": "./build/three.module.js"}}</script>
<script type="module">
import * as three from 'three';
import * as weather from './weather.js';
const given = GIVEN, count = given.rays.length;
const gl = document.createElement('canvas').getContext('webgl2');
gl.getExtension('EXT_color_buffer_float');
const texture = (unit, width, height, values) => {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, values);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST); // linear floats are an extension
};
const sky = weather.createSky({ disc: true }).given[1];
weather.enableFog({});
const tables = sky.uniforms.tables.value.given;
texture(0, tables[1], tables[2], tables[0]);
texture(1, count, 1, new Float32Array(given.rays.flat()));
const formulas = sky.fragmentShader.slice(0, sky.fragmentShader.indexOf('void main'));
const program = gl.createProgram();
const attach = (kind, text) => {
  const shader = gl.createShader(kind);
  gl.shaderSource(shader, '#version 300 es\\nprecision highp float;\\nprecision highp sampler2D;\\n' + text);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  gl.attachShader(program, shader);
};
const corner = 'vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1)';
attach(gl.VERTEX_SHADER, `void main() { gl_Position = ${corner}; }`);
attach(gl.FRAGMENT_SHADER, formulas.replace('varying vec3 vRay;', '') + `
uniform sampler2D rays; out vec4 found;
void main() {
  vec4 ray = texelFetch(rays, ivec2(gl_FragCoord.xy), 0);
  vec3 radiance = skyRadiance(ray.xyz) + sunRadiance(ray.xyz);
  found = vec4(weatherFog(radiance, ray.xyz, ${given.eye}, ray.w), 1.0);
}`);
gl.linkProgram(program);
gl.useProgram(program);
gl.uniform1i(gl.getUniformLocation(program, 'tables'), 0);
gl.uniform1i(gl.getUniformLocation(program, 'rays'), 1);
gl.activeTexture(gl.TEXTURE2);
const target = gl.createTexture();
gl.bindTexture(gl.TEXTURE_2D, target);
gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, count, 1);
gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
gl.viewport(0, 0, count, 1);
gl.drawArrays(gl.TRIANGLES, 0, 3);
const pixels = new Float32Array(4 * count);
gl.readPixels(0, 0, count, 1, gl.RGBA, gl.FLOAT, pixels);
document.getElementById('out').textContent = JSON.stringify({ found: Array.from(pixels) });
</script></body></html>
"""
