import json
import math

import numpy as np
import pytest
from exr_files import save
from foggy_picture import CAMERA, EYE, FOG, SKYLIGHT, SUN, SUNLIGHT, TRUTH, drawn, view

from experiments import fog_fits
from fit import fog


@pytest.mark.slow
def test_fits_of_a_scene_are_judged_by_its_known_fog(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(fog, "SEARCHED", (*fog_fits.NAMES, "HEIGHT_FOG_ASYMMETRY"))
    scene = tmp_path / "scenes" / "made"
    scene.mkdir(parents=True)
    seen, clear, distance = drawn()
    rays, _ = view()
    pictures = {"clear": clear, "fog_composite": seen, "fog_multiple": seen, "fog_medium_only_black": seen}
    for name, picture in (pictures | {"rays": rays.direction.numpy()}).items():
        save(scene / f"{name}.exr", {"RGB": np.ascontiguousarray(picture, np.float32)})
    save(scene / "distance.exr", {"Z": np.minimum(distance, np.float32(1e9))})
    azimuth, elevation = np.radians([-SUN.azimuth, SUN.elevation])
    level = math.cos(elevation)
    told = {
        "name": "made",
        "fov_x_degrees": 60.0,
        "view_pitch_degrees": math.degrees(CAMERA.pitch),
        "sun_elevation_degrees": SUN.elevation,
        "sun_azimuth_from_view_degrees": -SUN.azimuth,
        "sigma0": (TRUTH["HEIGHT_FOG_EXTINCTION"] * FOG.extinction_tint).tolist(),
        "albedo": FOG.albedo.tolist(),
        "scale_height": TRUTH["HEIGHT_FOG_SCALE_HEIGHT"],
        "z0": 0.0,
        "phase": {"rayleigh_weight": 0.2, "g": TRUTH["HEIGHT_FOG_ASYMMETRY"]},
        "eye": [0.0, 0.0, EYE],
        "direction_towards_sun": [level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)],
        "sun_irradiance": SUNLIGHT,
        "sky_radiance": SKYLIGHT,
        "fog_box": {"bottom": -1.0, "top": 720.0},
        "images": {"fog_medium_only_black": {"samples_per_pixel": [500, 1000], "noise": {"mean_relative_foggy": 0.03}}},
    }
    (scene / "scene.json").write_text(json.dumps(told))
    fog_fits.main(["--scenes", str(tmp_path / "scenes"), "--draws", "1", "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "fog_fits.json").read_text())["records"]
    composite = [row for row in rows if row["picture"] == "fog_composite" and row["scene"] == "made"]
    assert [row["name"] for row in composite] == ["density", "scale height"]
    assert all(row["largest_error"] < 0.05 for row in composite)
    assert "made" in capsys.readouterr().out
    assert (tmp_path / "fog_fits.png").stat().st_size > 1000
