import functools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from exr_files import save

from diffrender.parameters import defaults
from diffrender.rays import Perspective, from_angles, pixel_centres
from diffrender.shading import wetness as rain
from diffrender.shading.drying import DryBoxes
from diffrender.shading.soaked_ground import wet_albedo
from diffrender.shading.wet_surface import Wetness, WetView, example_inputs
from fit import png, weather_file, wetness
from fit.input_error import InputError
from fit.photo import Photo

pytest_plugins = ["command_fixtures"]

CAMERA = Perspective(96, 64, math.radians(30.0), math.radians(-50.0))
AMOUNT, DARKNESS = wetness.AMOUNT, wetness.DARKNESS
LIGHT = (1.1, 1.0, 0.9)  # of the wet picture, over that of the dry one
RIGHT = np.arange(96)[None, :].repeat(64, 0) >= 48  # what a mask lets stay dry


def ground() -> WetView:
    """Rough, level ground of many colours, without holes or dips, as a camera sees it."""
    direction = CAMERA.direction(*pixel_centres(CAMERA, slice(None), torch.zeros((), dtype=torch.float64)))
    colours = np.kron(np.random.default_rng(0).uniform(0.05, 0.6, (16, 24, 3)), np.ones((4, 4, 1)))
    flat = torch.ones(64, 96, dtype=torch.float64)
    given = example_inputs(torch.float64)
    return replace(
        given,
        position=direction,
        normal=torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64).expand(64, 96, 3),
        to_eye=-direction,
        base=torch.from_numpy(colours),
        roughness=0.95 * flat,
        metallic=0.0 * flat,
        height=flat,
        terrain=flat,
        open=flat,
        held=flat,
        to_light=from_angles(*torch.tensor([0.9, 1.5], dtype=torch.float64)),
        boxes=DryBoxes(*(one + away for one, away in zip(vars(given.boxes).values(), (1e6, 0.0, 0.0), strict=True))),
    )


@functools.cache
def drawn(amount, **changed):
    values = {"amount": amount, "hole_flood": 0.0, "puddle_flood": 0.0, **changed}
    made = replace(defaults(Wetness, torch.float64), **{n: torch.tensor(v).double() for n, v in values.items()})
    return rain.render(made, ground()).numpy()


def photo(name, radiance, noise=0.01, seed=0):
    noisy = radiance * np.random.default_rng(seed).lognormal(0.0, noise, radiance.shape)
    return Photo(Path(name), noisy.astype(np.float32), CAMERA, {}, (), None)


def pair(amount=0.7, noise=0.01, light=(1.0, 1.0, 1.0), seed=0, **changed):
    wet = photo("wet.exr", drawn(amount, **changed) * np.array(light), noise, 2 * seed)
    return photo("dry.exr", drawn(0.0, **changed), noise, 2 * seed + 1), wet


def painted(folder, mask):
    path = folder / "mask.png"
    path.write_bytes(png.encoded(np.where(mask, np.uint8(255), np.uint8(0))[..., None]))
    return path


@pytest.mark.parametrize("amount", [0.3, 0.9])
def test_known_wetness_is_recovered_within_its_standard_error(amount):
    solution = wetness.fit(*pair(amount))
    found = solution.parameters[AMOUNT]
    assert solution.minimum.converged
    assert found.why == "searched"
    # The reflection is not wholly alike over the picture.
    assert abs(found.value - amount) < 4.0 * found.standard_error + 0.005
    assert found.standard_error < 0.02
    assert solution.parameters[DARKNESS].why == "default"


def test_standard_errors_are_as_wide_as_the_scatter_of_pictures_that_differ_by_noise():
    solutions = [wetness.fit(*pair(0.6, noise=0.1, seed=seed)).parameters[AMOUNT] for seed in range(6)]
    scatter = np.std([one.value for one in solutions], ddof=1)
    told = np.mean([one.standard_error for one in solutions])
    assert 0.5 < told / scatter < 2.0


def test_where_the_wetness_is_given_the_darkness_is_found():
    given = wetness.Options(fixed={AMOUNT: 1.0})
    solution = wetness.fit(*pair(1.0, soaked_albedo=0.35), given)
    found = solution.parameters[DARKNESS]
    assert solution.parameters[AMOUNT].why == "given"
    assert abs(found.value - 0.35) < 4.0 * found.standard_error + 0.01


def test_both_together_are_told_to_be_one():
    solution = wetness.fit(*pair(0.5), wetness.Options(free=(DARKNESS,)))
    reasons = [solution.parameters[name].why for name in (AMOUNT, DARKNESS)]
    assert "not told apart from others by the photo" in reasons


def test_what_stayed_dry_tells_of_the_light(tmp_path):
    dry, wet = pair(0.7, light=LIGHT)
    wet.radiance[RIGHT] = (photo("", drawn(0.0), seed=9).radiance * np.array(LIGHT, np.float32))[RIGHT]
    options = wetness.Options(mask=painted(tmp_path, ~RIGHT))
    solution = wetness.fit(dry, wet, options)
    np.testing.assert_allclose(solution.gains, LIGHT, rtol=0.01)
    found = solution.parameters[AMOUNT]
    assert abs(found.value - 0.7) < 4.0 * found.standard_error + 0.005
    assert solution.used.sum() == (~RIGHT).sum()
    wrong = wetness.fit(dry, wet).parameters[AMOUNT]
    assert abs(wrong.value - 0.7) > 0.1


def test_dry_ground_is_dry_and_its_wetness_at_the_bound():
    found = wetness.fit(*pair(0.0)).parameters[AMOUNT]
    assert found.value < 0.02
    assert found.standard_error is None or found.value < 4.0 * found.standard_error


def test_ground_of_one_colour_does_not_tell_darkness_from_reflection():
    flat = np.full((64, 96, 3), 0.3)
    solution = wetness.fit(photo("dry.exr", flat, seed=1), photo("wet.exr", 0.7 * flat, seed=2))
    assert solution.parameters[AMOUNT].standard_error is None


def test_ground_that_darkens_as_optics_says_is_told_from_one_share_for_all():
    albedo = ground().base.numpy()
    wet = 3.0 * wet_albedo(torch.from_numpy(albedo)).numpy() + 0.05
    solution = wetness.fit(photo("dry.exr", 3.0 * albedo, seed=1), photo("wet.exr", wet, seed=2))
    ours, optics = solution.scores.values()
    assert optics["mean square"] < 0.5 * ours["mean square"]
    assert optics["share under water"] == pytest.approx(1.0, abs=0.1)


# Files


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rain")
    for one in pair(0.7):
        save(folder / one.path, {c: np.ascontiguousarray(one.radiance[..., i]) for i, c in enumerate("RGB")})
    painted(folder, ~RIGHT)
    (folder / "small.png").write_bytes(png.encoded(np.full((32, 48, 1), 255, np.uint8)))
    save(folder / "half.exr", {c: np.ones((32, 48), np.float32) for c in "RGB"})
    return folder


def test_the_command_writes_all_files_and_the_same_again(run, files, tmp_path):
    words = ("wetness", files / "wet.exr", "--dry", files / "dry.exr", "--fov", 30)
    status, out, err = run(*words, "--out", tmp_path / "one")
    assert (status, err) == (0, "")
    assert f"  {AMOUNT} " in out
    assert "Lekner" in out
    names = ("weather.csv", "fit.json", "report.html", "fitted.exr", "mask.png")
    assert {path.name for path in (tmp_path / "one").iterdir()} == set(names)
    kept = json.loads((tmp_path / "one" / "fit.json").read_text())
    (cell,) = weather_file.read(tmp_path / "one" / "weather.csv").values[AMOUNT]
    assert cell == kept["parameters"][AMOUNT]["value"] == pytest.approx(0.7, abs=0.02)
    assert run(*words, "--out", tmp_path / "two", "--quiet") == (0, "", "")
    for name in ("weather.csv", "fitted.exr"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


def test_the_drawn_picture_is_the_wet_one():
    dry, wet = pair(0.7, noise=0.0)
    found = wetness.solve(dry, wet, wetness.Options())
    pictures = found.draw(found.solution.scene)
    assert list(pictures) == ["wet", "dry"]
    assert np.median(np.abs(pictures["wet"] / wet.radiance - 1.0)) < 0.01


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("--dry", "half.exr"), "is 48 x 32, but"),
        (("--dry", "dry.exr", "--mask", "small.png"), "small.png"),
        (("--dry", "missing.exr"), "missing.exr"),
        (("--dry", "dry.exr", "--fix", "SKY_HAZINESS=0.5"), "give one of WETNESS_"),
        (("--dry", "dry.exr", "--fix", f"{AMOUNT}=2"), "allowed"),
        (("--dry", "dry.exr", "--fix", f"{AMOUNT}=1", "--fix", f"{DARKNESS}=0.3"), "nothing is left to search"),
        (("--dry", "dry.exr", "--solver", "magic"), "magic"),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_line(run, files, tmp_path, words, reason):
    given = [files / word if word.endswith((".exr", ".png")) else word for word in words]
    status, out, err = run("wetness", files / "wet.exr", *given, "--fov", 30, "--out", tmp_path / "out")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert reason in err
    assert not (tmp_path / "out").exists()


def test_black_pictures_are_refused():
    black = photo("dry.exr", np.zeros((64, 96, 3)))
    with pytest.raises(InputError, match="only 0 boxes of 1 pixels are usable"):
        wetness.fit(black, black)
