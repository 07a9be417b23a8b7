import ast
import base64
import json
import math
import re
import shutil
import sys

import numpy as np
import pytest
import torch
from export_targets import PAGE, THREE, unreal, unreal_transmittance
from synthetic_sky import HAZY_MORNING

from diffrender.atmosphere import celestial, height_fog
from diffrender.parameters import names
from diffrender.rays import Equirectangular, Rays, from_angles
from diffrender.scene import RECORDS, sun_view, weather_names
from experiments import browser, export_views, exports
from fit import exr, keyframes, weather_file
from fit.export import exported, targets, threejs
from fit.export.analytic_sky import GODOT_DIALS, THREE_DIALS, godot_sky, three_sky
from fit.export.described import described, fogged, sky_radiance
from fit.export.engine_names import GODOT, UNITY, UNREAL, allowed
from fit.export.unreal import rotation

pytest_plugins = ["command_fixtures"]

FOG = {
    "HEIGHT_FOG_EXTINCTION": 2e-3,
    "HEIGHT_FOG_EXTINCTION_TINT_R": 0.7,
    "HEIGHT_FOG_EXTINCTION_TINT_B": 1.4,
    "HEIGHT_FOG_SCALE_HEIGHT": 60.0,
    "HEIGHT_FOG_BASE_HEIGHT": 5.0,
    "HEIGHT_FOG_RAYLEIGH_SHARE_G": 0.6,
    "HEIGHT_FOG_SUN_TINT_B": 0.5,
    "HEIGHT_FOG_AMBIENT_TINT_R": 1.5,
}
FOGGY = HAZY_MORNING | FOG | {"SKY_OVERCAST": 0.3, "SKY_OVERCAST_AHEAD": 2.0, "SKY_OVERCAST_LEFT": -1.0}
FILES = {
    "unreal": ["weather.py"],
    "unity": ["Weather.cs", "sky.exr"],
    "godot": ["physical_sky.tres", "sky.exr", "weather.tscn"],
    "blender": ["sky.exr", "weather.py"],
    "threejs": ["weather.js"],
}


@pytest.fixture(scope="module")
def foggy():
    return described(keyframes.scene(FOGGY), "foggy.csv", 7.0)


@pytest.fixture(scope="module")
def folders(foggy, tmp_path_factory):
    """Folder of each target, with a small panorama."""
    place = tmp_path_factory.mktemp("exports")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(exported, "PANORAMA", Equirectangular(64, 32))
        for target in targets.TARGETS:
            targets.write(target, foggy.scene, foggy.name, foggy.hour, place / target)
    return place


# The folder and its account


def test_every_target_writes_its_files_and_an_account(folders):
    for target, files in FILES.items():
        assert sorted(path.name for path in (folders / target).iterdir()) == sorted([*files, "export.txt"])
        account = (folders / target / "export.txt").read_text()
        assert re.findall(r"^(\w+):$", account, re.MULTILINE) == ["keeps", "approximates", "drops"]
        assert ("not verified in the engine" in account) == (target in ("unreal", "unity", "godot"))


@pytest.mark.parametrize("target", ["unreal", "unity", "godot"])
def test_files_for_engines_that_were_not_run_say_so(folders, target):
    texts = [path for path in (folders / target).iterdir() if path.suffix != ".exr"]
    assert [path.name for path in texts if "not verified in the engine" not in path.read_text()] == []


def test_the_command_writes_and_tells_the_account(run, tmp_path):
    file = tmp_path / "day.csv"
    weather_file.write(file, weather_file.of_photo(FOGGY, 7.0, {}))
    status, out, err = run("export", file, "--to", "threejs", "--hour", 7, "--sun", "1,2", "--out", tmp_path / "out")
    assert (status, err) == (0, "")
    assert out == (tmp_path / "out" / "export.txt").read_text() + f"written to {tmp_path / 'out'}\n"
    assert out.startswith("Weather of day.csv at 7 h, the sun 1 degrees above the horizon\nthree.js: ")
    assert "VOLLIGHT_FARFOG_*" not in out
    assert three_data(tmp_path / "out")["to_sun"][2] == pytest.approx(math.sin(math.radians(1.0)))
    # One name of every effect that is no sky, sun, height fog or anti-aliasing.
    drawn = {"", "SUN", "SKY", "HEIGHT_FOG", "AA"}
    first = {prefix: next(iter(names(kind, prefix))) for prefix, kind in RECORDS.items() if prefix not in drawn}
    undrawn = {name: weather_names()[name].file_bounds[1] for name in first.values()}
    weather_file.write(file, weather_file.of_photo(FOGGY | undrawn, 7.0, {}))
    assert run("export", file, "--to", "threejs", "--out", tmp_path / "out", "--quiet") == (0, "", "")
    told = (tmp_path / "out" / "export.txt").read_text()
    for prefix in first:
        assert f"  {prefix}_*, which no export draws\n" in told


@pytest.mark.parametrize(
    ("values", "target", "reason"),
    [
        (FOGGY, "maya", "--to maya is unknown; allowed are unreal, unity, godot, blender, threejs"),
        (FOG, "unreal", "holds no sky"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(run, tmp_path, values, target, reason):
    file = tmp_path / "day.csv"
    weather_file.write(file, weather_file.of_photo(values, 7.0, {}))
    status, out, err = run("export", file, "--to", target, "--out", tmp_path / "out")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert reason in err
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    "odd",
    [
        {
            "SUN_ELEVATION": -90.0,
            "HEIGHT_FOG_SCALE_HEIGHT": 1.0,
            "HEIGHT_FOG_BASE_HEIGHT": -1000.0,
            "EXPOSURE": 1e-9,
        },
        {
            "SUN_ELEVATION": 90.0,
            "HEIGHT_FOG_SCALE_HEIGHT": 1.0,
            "HEIGHT_FOG_BASE_HEIGHT": 5000.0,
            "HEIGHT_FOG_EXTINCTION": 1.0,
            "SKY_MIE_SCALE": 100.0,
            "SKY_OVERCAST": 1.0,
        },
    ],
    ids=["night above fog", "noon in thick fog"],
)
def test_odd_weather_is_exported_with_finite_numbers(odd, tmp_path, monkeypatch):
    monkeypatch.setattr(exported, "PANORAMA", Equirectangular(16, 8))
    scene = keyframes.scene(FOGGY | odd)
    for target in targets.TARGETS:
        targets.write(target, scene, 'a"""*/\\;.csv', 12.0, tmp_path / target)
        for path in (tmp_path / target).iterdir():
            if path.suffix != ".exr":
                text = path.read_text()
                assert re.findall(r"(?<![\w.])-?(?:nan|inf|NaN|Infinity)(?!\w)", text) == []
            if path.suffix == ".py":
                ast.parse(text)


# three.js


def three_data(folder):
    """What the exporter wrote into weather.js."""
    text = (folder / "weather.js").read_text()
    start = text.index("export const weather = ") + len("export const weather = ")
    return json.JSONDecoder().raw_decode(text, start)[0]


def test_tables_reach_the_module_bit_by_bit(folders, foggy):
    told = three_data(folders / "threejs")["sky"]
    texels = np.frombuffer(base64.b64decode(told["tables"]), "<f4")
    found = texels.reshape(told["rows"], told["columns"], 3, 4)
    assert np.array_equal(found[..., :3], foggy.tables.in_scatter.numpy())
    assert not found[..., 3].any()


# Directions all over, above fog's top, level and down; the last looks into the sun.
RAYS = [(80, 10, 1e9), (30, 200, 1e9), (5, -30, 1e9), (0.5, 100, 1e9), (0.0, -28, 3e3), (0.3, 60, 800), (-2, 0, 280)]
RAYS += [(-40, 150, 12), (20, -30, 5e3), (45, -60, 50), (20.0, -30.0, 1e9)]
EYE = 10.0


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="chromium is not installed")
def test_shaders_draw_what_we_draw(foggy, tmp_path):
    elevation, azimuth, length = torch.tensor(RAYS, dtype=torch.float64).unbind(-1)
    direction = from_angles(elevation.deg2rad(), azimuth.deg2rad()).float()
    rays = torch.cat([direction, length.float()[:, None]], -1)
    (tmp_path / "build").mkdir()
    (tmp_path / "examples").mkdir()
    (tmp_path / "build" / "three.module.js").write_text(THREE)
    page = PAGE.replace("GIVEN", json.dumps({"rays": rays.tolist(), "eye": f"{EYE:.1f}"}))
    module = threejs.export(foggy).texts["weather.js"]
    found = browser.result(tmp_path, {"page.html": page, "weather.js": module})["found"]
    theirs = torch.tensor(found).reshape(-1, 4)[:, :3]
    disc = celestial.render(foggy.scene.sun, sun_view(foggy.scene, direction))
    background = sky_radiance(foggy, direction) + disc * foggy.scene.exposure.exposure
    seen = Rays(torch.tensor([0.0, 0.0, EYE]), direction, length.float())
    ours = fogged(foggy, foggy.scene.height_fog, seen, background)
    assert theirs == pytest.approx(ours, rel=1e-4)


# Engines' own skies


@pytest.mark.parametrize(("formula", "dials"), [(three_sky, THREE_DIALS), (godot_sky, GODOT_DIALS)])
def test_analytic_skies_have_exact_slopes(formula, dials):
    elevation, azimuth = torch.tensor([[0.05, 0.4, 1.2], [0.0, 2.0, -1.0]], dtype=torch.float64)
    direction, to_sun = from_angles(elevation, azimuth), from_angles(*torch.tensor([0.3, 0.2], dtype=torch.float64))
    start = torch.tensor([dial.start for dial in dials], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda point: formula(point, direction, to_sun), start)


# Unreal


@pytest.fixture(scope="module")
def editor(folders):
    """What the script leaves in an editor that knows documented names only."""
    module = unreal()
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "unreal", module)
        exec(compile((folders / "unreal" / "weather.py").read_text(), "weather.py", "exec"), {"__name__": "weather"})
    return module.spawned


def test_the_script_runs_in_an_editor_of_documented_names(editor):
    assert sorted(editor) == ["Weather DirectionalLight", "Weather ExponentialHeightFog", "Weather SkyAtmosphere"]
    sky = editor["Weather SkyAtmosphere"].component.values
    assert sky["other_tent_distribution"].values["width"] == 15.0
    # Clear air, from Hillaire's table: 0.0331 per kilometre in the blue, at 0.8 of the earth's.
    assert sky["rayleigh_scattering_scale"] == pytest.approx(0.8 * 0.0331)
    assert sky["rayleigh_scattering"][2:] == (1.0, 1.0)


def test_unreal_fog_is_as_thick_as_ours(editor, foggy):
    actor, fog = editor["Weather ExponentialHeightFog"], foggy.scene.height_fog
    eye, distance = 10.0, 400.0
    for elevation in (-1.0, 0.0, 30.0):
        direction = from_angles(torch.tensor(math.radians(elevation)), torch.tensor(0.0))
        rays = Rays(torch.tensor([0.0, 0.0, eye]), direction, torch.tensor(distance))
        ours = math.exp(-float(height_fog.optical_depth(fog, rays).mean()))
        climb = distance * math.sin(math.radians(elevation))
        theirs = unreal_transmittance(actor.component.values, actor.place[2], eye, distance, climb)
        assert theirs == pytest.approx(ours, rel=1e-5)


def test_unreal_sun_shines_from_where_ours_stands(editor):
    _, pitch, yaw = editor["Weather DirectionalLight"].turn
    assert (pitch, yaw) == pytest.approx((-20.0, 30.0 - 180.0), abs=1e-4)
    assert rotation(torch.tensor([1.0, 0.0, 0.0])) == {"pitch": pytest.approx(0.0), "yaw": pytest.approx(180.0)}


# Unity and Godot


def test_unity_names_are_documented(folders):
    script = (folders / "unity" / "Weather.cs").read_text()
    components = {"environment": "VisualEnvironment", "sky": "HDRISky", "fog": "Fog"}
    set_by = re.findall(r"^ +(\w+)\.(\w+)\.Override\((.*)\);$", script, re.MULTILINE)
    names = {(components[variable], name) for variable, name, _ in set_by} - {("HDRISky", "hdriSky")}
    assert names == {(owner, name) for owner in components.values() for name in UNITY[owner]}
    assert script.count("{") == script.count("}")
    numbers = {name: float(value[:-1]) for variable, name, value in set_by if re.fullmatch(r"[-\d.e+]+f", value)}
    assert 1.0 / numbers["meanFreePath"] == pytest.approx(2e-3)
    # A thousandth of the density is left at the maximum height.
    assert math.exp(-(numbers["maximumHeight"] - 5.0) / 60.0) == pytest.approx(1e-3, rel=1e-4)


def sections(text):
    """Class and settings of each section of a file of Godot's."""
    found = []
    for line in text.splitlines():
        head = re.fullmatch(r"\[(\w+)(.*)\]", line)
        if head:
            kind = re.search(r'type="(\w+)"', head[2])
            found.append((kind[1] if kind else found[0][0] if found else "scene", {}))
        elif line and not line.startswith(";"):
            name, _, value = line.partition(" = ")
            found[-1][1][name] = value
    return [(kind, values) for kind, values in found if values]


def test_godot_names_are_documented(folders):
    scene, sky = ((folders / "godot" / name).read_text() for name in ("weather.tscn", "physical_sky.tres"))
    whole = sections(scene) + sections(sky)
    assert [kind for kind, _ in whole] == [
        *("PanoramaSkyMaterial", "Sky", "Environment", "WorldEnvironment", "DirectionalLight3D", "PhysicalSkyMaterial")
    ]
    assert [(kind, name) for kind, values in whole for name in values if name not in GODOT[kind]] == []
    assert re.findall(r'path="(.*?)"', scene) == ["sky.exr"]


def test_godot_sun_shines_from_where_ours_stands(folders, foggy):
    (text,) = re.findall(r"Transform3D\((.*)\)", (folders / "godot" / "weather.tscn").read_text())
    turn = np.array([float(one) for one in text.split(",")])[:9].reshape(3, 3)
    assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(turn) == pytest.approx(1.0, abs=1e-6)
    ahead, left, up = foggy.to_sun.tolist()
    assert turn[:, 2] == pytest.approx([-left, up, -ahead], abs=1e-6)


@pytest.mark.parametrize("names", [UNREAL, UNITY, GODOT])
def test_values_out_of_an_engines_range_are_held_and_told(names):
    for owner, properties in names.items():
        for name, known in properties.items():
            if known.high is not None:
                held, notes = allowed(names, {owner: {name: (known.low, 2.0 * known.high, known.high)}})
                assert held == {owner: {name: (known.low, known.high, known.high)}}
                assert notes[0].startswith(f"{owner}.{name} would be ")


def test_names_that_are_not_documented_are_refused():
    with pytest.raises(KeyError):
        allowed(GODOT, {"Environment": {"fog_colour": 1.0}})


# Pictures and Blender


def test_the_panorama_is_what_fit_render_draws_and_no_filter_darkens_its_horizon(folders, foggy):
    seen = exr.read(folders / "blender" / "sky.exr").radiance
    camera = Equirectangular(64, 32)
    direction = camera.direction(torch.tensor(20.5), torch.tensor(9.5))
    assert torch.from_numpy(seen[9, 20].copy()) == pytest.approx(sky_radiance(foggy, direction[None])[0], rel=1e-5)
    assert np.array_equal(seen[16], seen[15])
    assert np.array_equal(seen[17], seen[15])
    assert not seen[18:].any()


def test_blender_gets_a_box_that_holds_the_fog(folders):
    script = ast.parse((folders / "blender" / "weather.py").read_text())
    (weather,) = (
        ast.literal_eval(n.value) for n in script.body if isinstance(n, ast.Assign) and n.targets[0].id == "WEATHER"
    )
    low, high, half = weather["fog"]["box"]
    assert math.exp(-(high - 5.0) / 60.0) < 1e-5
    assert low < 0.0
    assert half * 2e-3 > 10.0


# The experiment


def test_figures_of_exports_that_were_run_meet_their_aim():
    records = json.loads((exports.records.RESULTS / "exports.json").read_text())["records"]
    ran = [row for row in records if row["target"] in ("three.js", "Blender")]
    assert len(ran) == 12
    assert max(row["mean"] for row in ran) < 0.02
    copied = [row["formula"] for row in records if row["target"] == "three.js' own Sky"]
    assert max(mean for mean, _ in copied) < 2e-3  # our copy of the formula against the shader


def test_the_experiment_without_engines_draws_ours(tmp_path, monkeypatch):
    monkeypatch.setattr(exports, "weathers", lambda: {"foggy": FOGGY, "clear": HAZY_MORNING})
    exports.main(["clear", "--pixels", "8", "--out", str(tmp_path)])
    assert json.loads((tmp_path / "exports.json").read_text())["records"] == []
    assert (tmp_path / "exports.png").stat().st_size > 1000


def test_a_target_that_draws_too_much_is_told_apart(foggy):
    mine = {"ahead": export_views.ours(foggy, "ahead", 8)}
    brighter = {"ahead": 1.1 * mine["ahead"].radiance}
    found = exports.compared("foggy", "three.js", exports.Drawn(mine, {"three.js": brighter}))
    assert (found.mean, found.largest) == (pytest.approx(0.1, rel=1e-4), pytest.approx(0.1, rel=1e-4))
    up = export_views.directions("up", 8)
    assert float(up[..., 2].min()) > 0.5
    assert up[0, 4, 0] < 0.0  # behind is on top of a view straight up
