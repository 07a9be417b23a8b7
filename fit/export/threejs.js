// A weather of `fit export --to threejs`: its sky, sun and fog for three.js, in one module.
//
//   import * as weather from './weather.js';
//   weather.enableFog(scene);                       // before any material is compiled; nothing where there is no fog
//   scene.add(weather.createSky(), weather.createSun());
//   scene.environment = weather.createEnvironment(renderer);
//
// Axes are three.js': y up, the middle of the fitted picture at -z; metres. Radiance is exposed as in the picture:
// leave renderer.toneMappingExposure at 1. Cameras stand in the weather's altitude 0 at y = 0.
// Sky and fog are the formulas of `fit render` and `fit fog` themselves. `builtIn` holds what three.js' own Sky and
// FogExp2 come nearest with; how near stands in export.txt.

import * as THREE from 'three';

export const weather = null;

export const builtIn = weather.built_in;

const number = (value) => (Number.isInteger(value) ? value.toFixed(1) : String(value));
const vector = (values) => `vec3(${values.map(number).join(', ')})`;

const SKY = /* glsl */ `
	const float PI_HALF = 1.5707963267948966;
	const vec3 TO_SUN = ${vector(weather.to_sun)};
	const vec3 IRRADIANCE = ${vector(weather.irradiance)};
	const float HORIZON = ${number(weather.sky.horizon)};
	const float ROW_SCALE = ${number(weather.sky.row_scale)};
	const vec3 COARSE_SHARE = ${vector(weather.sky.coarse_share)};
	const vec3 CLOUD = ${vector(weather.sky.cloud)};
	const float OVERCAST = ${number(weather.sky.overcast)};
	const vec2 OVERCAST_LEAN = vec2(${weather.sky.overcast_lean.map(number).join(', ')});
	const float SUN_CHORD = ${number(weather.sun.chord)};
	const vec3 SUN_RADIANCE = ${vector(weather.sun.radiance)};
	const vec3 LIMB = ${vector(weather.sun.limb_exponents)};
	uniform sampler2D tables;

	vec3 entry(int row, int column, int part) {
		return texelFetch(tables, ivec2(3 * column + part, row), 0).rgb;
	}

	vec3 lookUp(vec2 place, int part) {
		ivec2 size = ivec2(${weather.sky.columns}, ${weather.sky.rows});
		place = clamp(place, vec2(0.0), vec2(size - 1));
		ivec2 cell = clamp(ivec2(floor(place)), ivec2(0), size - 2);
		vec2 share = place - vec2(cell);
		vec3 upper = mix(entry(cell.y, cell.x, part), entry(cell.y, cell.x + 1, part), share.x);
		vec3 lower = mix(entry(cell.y + 1, cell.x, part), entry(cell.y + 1, cell.x + 1, part), share.x);
		return mix(upper, lower, share.y);
	}

	float cornetteShanks(float chordSquare, float g) {
		float cosine = 1.0 - 0.5 * chordSquare;
		float base = (1.0 - g) * (1.0 - g) + g * chordSquare;
		return 0.11936620731892151 * (1.0 - g * g) / (2.0 + g * g) * (1.0 + cosine * cosine) / (base * sqrt(base));
	}

	// Radiance of the sky from a direction in the weather's axes: x ahead, y left, z up.
	vec3 skyRadiance(vec3 direction) {
		float level = length(direction.xy);
		float elevation = atan(direction.z, level);
		float above = max((elevation - HORIZON) / (PI_HALF - HORIZON), -0.02);
		float row = log(1.0 + above / ROW_SCALE) / log(1.0 + 1.0 / ROW_SCALE) * ${number(weather.sky.rows - 1)};
		float apart = level * length(TO_SUN.xy);
		float cosAzimuth = apart > 1e-6 ? dot(direction.xy, TO_SUN.xy) / apart : 0.0;
		vec2 place = vec2((0.5 + 0.5 * cosAzimuth) * ${number(weather.sky.columns - 1)}, row);
		vec3 chord = direction - TO_SUN;
		float chordSquare = dot(chord, chord);
		float cosine = 1.0 - 0.5 * chordSquare;
		float air = 0.05968310365946075 * (1.0 + cosine * cosine);
		vec3 haze = mix(
			vec3(cornetteShanks(chordSquare, ${number(weather.sky.haziness)})),
			vec3(cornetteShanks(chordSquare, ${number(weather.sky.coarse_haziness)})),
			COARSE_SHARE
		);
		vec3 clear = lookUp(place, 0) * air + lookUp(place, 1) * haze + lookUp(place, 2);
		float lean = sqrt(1.0 + dot(OVERCAST_LEAN, OVERCAST_LEAN)) - 1.0;
		float odds = exp(dot(OVERCAST_LEAN, direction.xy) - lean);
		float share = OVERCAST * odds / (1.0 - OVERCAST + OVERCAST * odds);
		vec3 clouded = CLOUD * (1.0 + 2.0 * direction.z) / 3.0;
		return elevation >= HORIZON ? mix(clear, clouded, share) * IRRADIANCE : vec3(0.0);
	}

	// Radiance of the sun's disc, to be added: darker and redder towards its limb.
	vec3 sunRadiance(vec3 direction) {
		vec3 chord = direction - TO_SUN;
		float inside = 1.0 - dot(chord, chord) / (SUN_CHORD * SUN_CHORD);
		vec3 profile = (1.0 + 0.5 * LIMB) * pow(vec3(max(inside, 1e-9)), 0.5 * LIMB);
		return inside > 0.0 && direction.z >= 0.0 ? SUN_RADIANCE * profile : vec3(0.0);
	}
`;

const NO_FOG = /* glsl */ `
	vec3 weatherFog(vec3 radiance, vec3 direction, float eye, float distance) { return radiance; }
`;

const FOG = weather.fog === null ? NO_FOG : /* glsl */ `
	const vec3 FOG_TO_SUN = ${vector(weather.to_sun)};
	const vec3 FOG_EXTINCTION = ${vector(weather.fog.extinction)};
	const float FOG_SCALE_HEIGHT = ${number(weather.fog.scale_height)};
	const float FOG_BASE_HEIGHT = ${number(weather.fog.base_height)};
	const vec3 FOG_SUN = ${vector(weather.fog.sun)};
	const vec3 FOG_SKY = ${vector(weather.fog.sky)};
	const vec3 FOG_RAYLEIGH_SHARE = ${vector(weather.fog.rayleigh_share)};
	const float FOG_ASYMMETRY = ${number(weather.fog.asymmetry)};
	const float FOG_AIR_MASS = ${number(weather.fog.air_mass)};
	const float FOG_OPAQUE = 1e4;

	vec3 fogTanhRatio(vec3 half_) {
		vec3 near = clamp(half_, -0.125, 0.125);
		vec3 square = near * near;
		return 1.0 + square * (-1.0 / 3.0 + square * (2.0 / 15.0 - square * (17.0 / 315.0)));
	}

	// Integral of exp(-(start + rate x)) for x from 0 to a length, where end = start + rate length.
	vec3 fogDecayed(vec3 start, vec3 end, vec3 length_, float rate) {
		vec3 fromStart = exp(-start), fromEnd = exp(-end);
		vec3 half_ = 0.5 * length_ * rate;
		vec3 near = 0.5 * length_ * fogTanhRatio(half_) * (fromStart + fromEnd);
		vec3 far = (fromStart - fromEnd) / (abs(rate) < 1e-11 ? 1.0 : rate);
		return mix(far, near, vec3(lessThan(abs(half_), vec3(0.125))));
	}

	vec3 fogOpacity(vec3 depth) {
		vec3 passed = exp(-depth), half_ = 0.5 * depth;
		return mix(1.0 - passed, half_ * (1.0 + passed) * fogTanhRatio(half_), vec3(lessThan(half_, vec3(0.125))));
	}

	// Radiance behind and within the fog, for a ray in the weather's axes from an eye at an altitude.
	vec3 weatherFog(vec3 radiance, vec3 direction, float eye, float distance_) {
		float start = max((eye - FOG_BASE_HEIGHT) / FOG_SCALE_HEIGHT, -82.0);
		float climb = direction.z / FOG_SCALE_HEIGHT * distance_;
		float end = max(start + climb, -86.0);
		float mean = fogDecayed(vec3(start), vec3(end), vec3(1.0), climb).x;
		vec3 depth = min(FOG_EXTINCTION * distance_ * mean, FOG_OPAQUE);
		vec3 towardsSun = FOG_EXTINCTION * FOG_SCALE_HEIGHT * FOG_AIR_MASS;
		vec3 atEye = min(towardsSun * exp(-start), FOG_OPAQUE);
		vec3 atEnd = depth + min(towardsSun * exp(-end), FOG_OPAQUE);
		vec3 sunlit = fogDecayed(atEye, atEnd, depth, 1.0 - direction.z * FOG_AIR_MASS);
		vec3 chord = direction - FOG_TO_SUN;
		float chordSquare = dot(chord, chord), cosine = 1.0 - 0.5 * chordSquare;
		float molecules = 0.05968310365946075 * (1.0 + cosine * cosine);
		float base = (1.0 - FOG_ASYMMETRY) * (1.0 - FOG_ASYMMETRY) + FOG_ASYMMETRY * chordSquare;
		float droplets = 0.07957747154594767 * (1.0 - FOG_ASYMMETRY * FOG_ASYMMETRY) / (base * sqrt(base));
		vec3 phase = mix(vec3(droplets), vec3(molecules), FOG_RAYLEIGH_SHARE);
		return radiance * exp(-depth) + FOG_SUN * phase * sunlit + FOG_SKY * fogOpacity(depth);
	}
`;

function tablesTexture() {
	const bytes = Uint8Array.from(atob(weather.sky.tables), (letter) => letter.charCodeAt(0));
	const texture = new THREE.DataTexture(
		new Float32Array(bytes.buffer), 3 * weather.sky.columns, weather.sky.rows, THREE.RGBAFormat, THREE.FloatType
	);
	texture.needsUpdate = true;
	return texture;
}

// A dome round the camera: the sky, the sun's disc unless it is left out, and the fog before them. Black below the
// horizon, where the ground is yours.
export function createSky({ disc = true } = {}) {
	const material = new THREE.ShaderMaterial({
		name: 'WeatherSky',
		uniforms: { tables: { value: tablesTexture() } },
		side: THREE.BackSide,
		depthWrite: false,
		vertexShader: /* glsl */ `
			varying vec3 vRay;
			void main() {
				vRay = position;
				vec4 seen = projectionMatrix * vec4(mat3(viewMatrix) * position, 1.0);
				gl_Position = seen.xyww;
			}`,
		fragmentShader: /* glsl */ `
			precision highp float;
			varying vec3 vRay;
			${SKY}
			${FOG}
			void main() {
				vec3 ray = normalize(vRay);
				vec3 direction = vec3(-ray.z, -ray.x, ray.y);
				vec3 radiance = skyRadiance(direction)${disc ? ' + sunRadiance(direction)' : ''};
				gl_FragColor = vec4(weatherFog(radiance, direction, cameraPosition.y, 1e9), 1.0);
				#include <tonemapping_fragment>
				#include <colorspace_fragment>
			}`,
	});
	const dome = new THREE.Mesh(new THREE.BoxGeometry(2, 2, 2), material);
	dome.name = 'WeatherSky';
	dome.frustumCulled = false;
	dome.renderOrder = -1;
	return dome;
}

// The sun as a light, as strong as it is behind air and clouds; the fog dims it no further.
export function createSun() {
	const strongest = Math.max(...weather.sunlight, 1e-30);
	const colour = new THREE.Color().setRGB(...weather.sunlight.map((one) => one / strongest), THREE.LinearSRGBColorSpace);
	const light = new THREE.DirectionalLight(colour, strongest);
	const [x, y, z] = weather.to_sun;
	light.position.set(-y, z, -x);
	return light;
}

// The sky as light from all around, for scene.environment; without the disc, which the light above is.
export function createEnvironment(renderer) {
	const scene = new THREE.Scene();
	scene.add(createSky({ disc: false }));
	const generator = new THREE.PMREMGenerator(renderer);
	const found = generator.fromScene(scene).texture;
	generator.dispose();
	return found;
}

// Draw the weather's fog over every built-in material. Replaces three.js' own fog formula in its shader chunks, so
// call it before materials are compiled; before tone mapping, where three.js' own comes after it.
export function enableFog(scene) {
	if (weather.fog === null) return;
	const chunks = THREE.ShaderChunk;
	chunks.fog_pars_vertex = '#ifdef USE_FOG\n varying vec3 vWeatherRay;\n#endif';
	chunks.fog_vertex = '#ifdef USE_FOG\n vWeatherRay = transpose( mat3( viewMatrix ) ) * mvPosition.xyz;\n#endif';
	chunks.fog_pars_fragment = `#ifdef USE_FOG\n varying vec3 vWeatherRay;\n${FOG}\n#endif`;
	chunks.fog_fragment = '';
	chunks.opaque_fragment += `
#ifdef USE_FOG
	float weatherDistance = length( vWeatherRay );
	vec3 weatherRay = vWeatherRay / weatherDistance;
	gl_FragColor.rgb = weatherFog(
		gl_FragColor.rgb, vec3( -weatherRay.z, -weatherRay.x, weatherRay.y ), cameraPosition.y, weatherDistance
	);
#endif`;
	scene.fog = new THREE.FogExp2(0xffffff, builtIn.fog.density);
}
