import math
from dataclasses import replace

import pytest
import torch
from synthetic_sky import HAZY_MORNING

from diffrender.atmosphere.celestial import to_sun
from diffrender.catalogue import EFFECTS
from diffrender.rays import Equirectangular, pixel_centres
from diffrender.scene import finest, prune, render, skylight, sunlight
from fit import keyframes

CAMERA = Equirectangular(24, 6, lowest=0.0)
ALL_ROUND = CAMERA.direction(*pixel_centres(CAMERA, slice(None), torch.zeros(()))).flatten(0, 1)


def scene_of(**changes):
    return keyframes.scene({**HAZY_MORNING, **changes})


SCENE = scene_of()


def with_sun(scene):
    """Directions all round, none of which meets the disc, and one into its middle."""
    return torch.cat([ALL_ROUND, to_sun(scene.sun)[None]])


def rungs(pruned):
    return {choice.effect: choice.rung for choice in pruned.choices}


# render


def test_a_picture_is_the_sum_of_its_lights():
    whole, *parts = (
        render(SCENE, with_sun(SCENE), {name: finest()[name] for name in names})
        for names in (["sky", "sun disc"], ["sky"], ["sun disc"])
    )
    assert all(bool(part.any()) for part in parts)
    assert torch.equal(whole, parts[0] + parts[1])


def test_without_renderers_or_sky_it_is_dark():
    assert not render(SCENE, with_sun(SCENE), {}).any()
    assert not render(replace(SCENE, sky=None), ALL_ROUND, finest()).any()


def test_exposure_scales_the_whole_picture():
    one, four = (render(scene_of(EXPOSURE=value), with_sun(SCENE), finest()) for value in (0.5, 2.0))
    torch.testing.assert_close(four, 4.0 * one, rtol=1e-5, atol=0.0)


# prune

SCENES = {
    "morning": SCENE,
    "sunset": scene_of(SUN_ELEVATION=-0.1),
    "twilight": scene_of(SUN_ELEVATION=-6.0),
    "overcast": scene_of(SKY_OVERCAST=1.0),
    "no sky": replace(SCENE, sky=None),
}


@pytest.mark.parametrize("tolerance", [0.0, 1e-4, 0.01, 0.1, 10.0, 1e6])
@pytest.mark.parametrize("name", SCENES)
def test_a_pruned_picture_stays_within_the_tolerance(name, tolerance):
    scene, direction = SCENES[name], with_sun(SCENES[name])
    pruned = prune(scene, direction, tolerance)
    whole = render(scene, direction, finest())
    change = (render(scene, direction, pruned.renderers) - whole).abs().max()
    told = sum(choice.change for choice in pruned.choices)
    rounding = torch.finfo(whole.dtype).eps * whole.abs().max() if told > 0.0 else 0.0  # a sky added to the sun's disc
    assert float(change) <= told + float(rounding)
    assert told <= tolerance


def test_what_is_drawn_is_what_the_choices_say():
    pruned = prune(SCENE, with_sun(SCENE), 0.01)
    assert pruned.renderers == {e: EFFECTS[e].rungs[rung] for e, rung in rungs(pruned).items() if rung != "skip"}


def test_without_tolerance_only_what_changes_nothing_is_left_out():
    last = {name: list(EFFECTS[name].rungs)[-1] for name in ("sky", "sun disc")}
    assert rungs(prune(SCENE, with_sun(SCENE), 0.0)) == last
    assert rungs(prune(SCENE, ALL_ROUND, 0.0)) == last | {"sun disc": "skip"}
    assert set(rungs(prune(scene_of(SUN_ELEVATION=-40.0), ALL_ROUND, 0.0)).values()) == {"skip"}


def test_an_effect_costs_less_the_more_is_tolerated():
    ladder = list(EFFECTS["sky"].rungs)
    places = [ladder.index(rungs(prune(SCENE, ALL_ROUND, t))["sky"]) for t in (0.0, 1e-4, 1e-3, 0.01, 0.1, 1.0, 10.0)]
    assert places == sorted(places, reverse=True)
    assert (places[0], places[-1]) == (len(ladder) - 1, 0)


def test_a_sky_that_is_not_drawn_still_dims_the_sun():
    pruned = prune(SCENE, with_sun(SCENE), 10.0)
    assert (rungs(pruned)["sky"], pruned.renderers.keys()) == ("skip", {"sun disc"})
    seen, unseen = (render(one, with_sun(one), pruned.renderers)[-1] for one in (SCENE, replace(SCENE, sky=None)))
    assert (seen < 0.9 * unseen).all()


def test_a_choice_tells_its_reason():
    by_name = {choice.effect: choice for choice in prune(SCENE, ALL_ROUND, 0.01).choices}
    assert by_name["sun disc"].reason == "changes no pixel by more than 0 by its bound, 0.01 allowed"
    assert "as measured, 0.01 allowed" in by_name["sky"].reason
    (kept,) = (choice for choice in prune(SCENE, ALL_ROUND, 0.0).choices if choice.rung != "skip")
    assert kept.reason == "every cheaper rung changes a pixel by more than 0"


@pytest.mark.parametrize("tolerance", [-1e-9, math.nan])
def test_a_tolerance_that_is_none_is_refused(tolerance):
    with pytest.raises(ValueError, match=r"tolerance is .*; give the largest allowed change"):
        prune(SCENE, ALL_ROUND, tolerance)


# sunlight


def test_without_air_all_sunlight_arrives():
    assert torch.equal(sunlight(replace(SCENE, sky=None)), torch.ones(3))


@pytest.mark.parametrize("changes", [{"SUN_ELEVATION": -3.0}, {"SKY_OVERCAST": 1.0}])
def test_behind_the_earth_or_clouds_there_is_no_sunlight(changes):
    assert not sunlight(scene_of(**changes)).any()


def test_no_more_sunlight_arrives_than_was_sent():
    share = sunlight(SCENE)
    assert ((share > 0.0) & (share < 1.0)).all()


def test_haze_and_a_low_sun_take_sunlight_away():
    assert (sunlight(scene_of(SKY_MIE_SCALE=20.0)) < sunlight(SCENE)).all()
    assert (sunlight(scene_of(SUN_ELEVATION=5.0)) < sunlight(SCENE)).all()


def test_a_low_sun_is_red():
    red, green, blue = sunlight(scene_of(SUN_ELEVATION=2.0)).tolist()
    assert red > green > blue


def test_what_is_left_of_a_setting_sun_is_dimmed_by_the_air_towards_that_part():
    half, whole = (sunlight(scene_of(SUN_ELEVATION=degrees)) for degrees in (-0.045, 0.5))
    assert half[0] > 0.15 * whole[0]


def test_air_takes_blue_light_as_rayleigh_s_law_says():
    # Of clean air alone, at the zenith, the optical depths go as the inverse fourth power of the wavelength.
    air_alone = {"SKY_MIE_SCALE": 0.01, "SKY_COARSE_SCALE": 0.001, "SKY_OZONE": 0.0, "SKY_RAYLEIGH_SCALE": 1.0}
    clean = scene_of(SUN_ELEVATION=90.0, **air_alone)
    depth = -torch.log(sunlight(clean))
    assert 0.03 < float(depth[0]) < float(depth[1]) < float(depth[2]) < 0.35
    assert float(depth[2] / depth[0]) == pytest.approx((680.0 / 440.0) ** 4, rel=0.1)


# skylight


def test_skylight_is_the_mean_over_the_hemisphere():
    wide = Equirectangular(128, 32, lowest=0.0)
    direction = wide.direction(*pixel_centres(wide, slice(0, 32), torch.zeros(())))
    weight = wide.solid_angle(*pixel_centres(wide, slice(0, 32), torch.zeros(())))[..., None]
    drawn = render(SCENE, direction, {"sky": EFFECTS["sky"].rungs["tables"]})
    torch.testing.assert_close(skylight(SCENE), (drawn * weight).sum((0, 1)) / weight.sum(), rtol=1e-2, atol=0.0)


def test_skylight_without_a_sky_is_the_exposure():
    assert torch.equal(skylight(replace(SCENE, sky=None)), SCENE.exposure.exposure * torch.ones(3))
