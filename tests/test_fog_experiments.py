import itertools
import json
import math

import numpy as np
import OpenEXR
import pytest

from experiments import fog_accuracy, fog_scale_heights, fog_scenes, fog_time

EXTINCTION, SCALE_HEIGHT, EYE, UP, LENGTH, SUN = 4e-3, 40.0, 25.0, 0.05, 200.0, 0.4
SAMPLES = (40, 120)
PIXELS = (16, 64)
BOX = (-1.0, 480.0)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """A folder with one scene, all of whose pixels have the same ray, drawn sample by sample as a renderer would."""
    folder = tmp_path_factory.mktemp("scenes")
    scene = folder / "even"
    scene.mkdir()
    direction = np.broadcast_to([math.sqrt(1.0 - UP * UP), 0.0, UP], (*PIXELS, 3)).astype(np.float32)
    light = 3.0 * 0.9 / (4.0 * math.pi)  # of a sun of 3, an albedo of 0.9 and an even phase function
    drawn = light * simulated(np.random.default_rng(1), math.prod(PIXELS), SAMPLES[1]).reshape(PIXELS)
    write(scene / "fog_medium_only_black.exr", {"RGB": np.repeat(drawn[..., None], 3, -1)})
    write(scene / "rays.exr", {"RGB": direction})
    write(scene / "distance.exr", {"Z": np.full(PIXELS, LENGTH)})
    told = {
        "name": "even",
        "sigma0": [EXTINCTION] * 3,
        "albedo": [0.9] * 3,
        "scale_height": SCALE_HEIGHT,
        "z0": 0.0,
        "phase": {"rayleigh_weight": 0.0, "g": 0.0},
        "eye": [0.0, 0.0, EYE],
        "direction_towards_sun": [0.0, math.sqrt(1.0 - SUN * SUN), SUN],
        "sun_irradiance": [3.0] * 3,
        "fog_box": dict(zip(("bottom", "top"), BOX, strict=True)),
        "images": {
            "fog_medium_only_black": {"samples_per_pixel": list(SAMPLES), "noise": {"mean_relative_foggy": 0.1}}
        },
    }
    (scene / "scene.json").write_text(json.dumps(told))
    return folder


def write(path, channels):
    OpenEXR.File({}, {name: np.ascontiguousarray(v, np.float32) for name, v in channels.items()}).write(str(path))


def density(altitude):
    return EXTINCTION * np.exp(-altitude / SCALE_HEIGHT)


def simulated(random, pixels, samples):
    """Sunlight per light of each pixel: a point on its ray by trial and error, the sun's transmittance likewise."""
    count = pixels * samples
    travelled, found = np.zeros(count), np.zeros(count, dtype=bool)
    moving = np.ones(count, dtype=bool)
    while moving.any():  # against the densest fog on the way
        travelled[moving] += random.exponential(1.0 / density(EYE), moving.sum())
        moving &= travelled < LENGTH
        hit = moving & (random.random(count) < density(EYE + UP * travelled) / density(EYE))
        found |= hit
        moving &= ~hit
    weight = found.astype(float)
    start = EYE + UP * travelled
    borders = [BOX[0], *(cut * SCALE_HEIGHT for cut in (1.0, 2.2, 4.0, 7.0)), BOX[1]]
    for bottom, top in itertools.pairwise(borders):
        altitude = np.clip(start, bottom, top)
        rising = found & (altitude < top)
        while rising.any():
            altitude[rising] += SUN * random.exponential(1.0 / density(bottom), rising.sum())
            rising &= altitude < top
            weight[rising] *= 1.0 - density(altitude[rising]) / density(bottom)
    return weight.reshape(pixels, samples).mean(1)


def test_scattered_sunlight_and_its_noise_are_those_of_a_simulation(scenes):
    for found in fog_scenes.compare(scenes / "even"):
        assert found.ratio == pytest.approx(1.0, abs=4.0 * found.ratio_error + 1e-3)  # the earth is round in one rung
        assert found.chi_square == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / math.prod(PIXELS)))
        assert found.ratio_error < 0.01


def test_a_prediction_of_each_scene_is_written_and_printed(scenes, tmp_path, capsys):
    fog_scenes.main(["--scenes", str(scenes), "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "fog_scenes.json").read_text())["records"]
    assert [row["rung"] for row in rows] == ["flat earth", "round earth"]
    assert "even" in capsys.readouterr().out


@pytest.mark.slow
def test_float32_follows_float64_as_far_as_promised():
    rows = fog_accuracy.rows(1_000, seed=0)
    near = [row for row in rows if row["scale_heights"] == 10.0]
    assert all(row["not_finite"] == 0 for row in rows)
    assert len(near) == 7
    for row in near:
        limit = 1e-4 if "gradient" in row["quantity"] else 1e-5
        assert row["largest"] <= limit, row
        assert row["p99"] <= 2e-6 or "optical depth" not in row["quantity"], row


def test_one_scale_height_costs_nothing_where_both_species_have_it():
    found = fog_scale_heights.errors(fog_scale_heights.air(10.0, 8_000.0, 1e4, 30.0), points=500)
    assert all(found[name] < 1e-5 for name in found if "height" in name)
    different = fog_scale_heights.errors(fog_scale_heights.air(10.0, 100.0, 1e4, 30.0), points=500)
    assert all(different[name] > 0.01 for name in different if "height" in name)


@pytest.mark.slow
def test_costs_of_one_scale_height_are_written_and_drawn(tmp_path, capsys):
    fog_scale_heights.main(["--size", "small", "--out", str(tmp_path)])
    assert (tmp_path / "fog_scale_heights.png").stat().st_size > 10_000
    rows = json.loads((tmp_path / "fog_scale_heights.json").read_text())["records"]
    assert len(capsys.readouterr().out.splitlines()) == len(rows) + 1


@pytest.mark.slow
def test_times_are_ratios_within_one_run(tmp_path, capsys):
    fog_time.main(["--size", "small", "--rounds", "1", "--threads", "1", "--out", str(tmp_path)])
    found = json.loads((tmp_path / "fog_time.json").read_text())
    errors = [row["largest_error"] for row in found["march"]]
    assert errors == sorted(errors, reverse=True)  # a march nears the closed form
    assert all(row["ratio"]["median"] > 0.0 for row in found["march"] + found["copy"])
    assert "panorama" in capsys.readouterr().out
