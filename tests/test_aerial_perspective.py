import math
from dataclasses import replace

import pytest
import torch

from diffrender.atmosphere import aerial_perspective, scattering, sky, sky_reference
from diffrender.atmosphere.aerial_perspective import EFFECT, SPLINES, AerialPerspective, TabledView
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.numerics import b_splines
from diffrender.parameters import defaults
from diffrender.rays import from_angles

FLOAT = torch.float64
DRAWING = [rung for rung in EFFECT.rungs if rung != "skip"]


def numbers(*values):
    return torch.tensor(values, dtype=FLOAT)


def perspective_of(**changed):
    return replace(
        defaults(AerialPerspective, FLOAT), **{n: torch.as_tensor(v, dtype=FLOAT) for n, v in changed.items()}
    )


def view(length, elevation=0.0, azimuth=40.0, sun=20.0, background=0.0):
    """Rays of many lengths, or elevations or azimuths in degrees, from an eye at 2 m."""
    length, elevation, azimuth = torch.broadcast_tensors(
        *(torch.as_tensor(v, dtype=FLOAT) for v in (length, elevation, azimuth))
    )
    towards = SkyView(
        from_angles(elevation.deg2rad(), azimuth.deg2rad()),
        from_angles(*torch.deg2rad(numbers(sun, 0.0))),
        torch.ones(3, dtype=FLOAT),
        torch.tensor(2.0, dtype=FLOAT),
    )
    air = sky.medium(defaults(Sky, FLOAT))
    return aerial_perspective.through(air, towards, length, torch.full((3,), background, dtype=FLOAT))


def elsewhere(seen, haze=1.0, eye=2.0):
    """The same in other air, or from another height."""
    air = sky.medium(replace(defaults(Sky, FLOAT), mie_scale=torch.tensor(haze, dtype=FLOAT)))
    higher = replace(seen.view, eye_altitude=torch.tensor(eye, dtype=FLOAT))
    return aerial_perspective.through(air, higher, seen.length, seen.background)


def draw(rung, seen, **changed):
    return EFFECT.rungs[rung](perspective_of(**changed), seen)


@pytest.mark.parametrize("rung", DRAWING)
def test_at_no_distance_the_object_is_seen_as_it_is(rung):
    seen = view([0.0, 0.0], [0.0, 30.0], background=0.4)
    assert torch.equal(draw(rung, seen), seen.background.expand(2, 3))


def test_behind_all_air_is_the_sky():
    seen = view(math.inf, [0.2, 3.0, 40.0], [10.0, 100.0, 180.0])
    plain = defaults(Sky, FLOAT)
    same_haze = replace(plain, coarse_haziness=plain.haziness)
    wanted = sky.EFFECT.rungs["march"](same_haze, seen.view)
    torch.testing.assert_close(draw("march", seen), wanted, rtol=5e-3, atol=0.0)  # fewer steps than the sky's


@pytest.mark.parametrize("sun", [60.0, 5.0])
def test_the_background_of_two_tables_is_the_horizon_of_the_skys_two_tables(sun):
    seen = view(math.inf, 0.0, [0.0, 60.0, 120.0, 180.0], sun=sun)
    plain = defaults(Sky, FLOAT)
    same_haze = replace(plain, coarse_haziness=plain.haziness)
    wanted = sky.EFFECT.rungs["two tables"](same_haze, seen.view)  # with large particles when they were made
    torch.testing.assert_close(draw("two tables", seen), wanted, rtol=0.03, atol=0.0)


@pytest.mark.parametrize("sun", [60.0, 10.0])
def test_behind_all_air_tables_are_the_horizon_of_the_sky(sun):
    seen = view(math.inf, 0.0, [0.0, 60.0, 120.0, 180.0], sun=sun)
    wanted = draw("march", seen)
    # Of all azimuths the mean; with two functions for all orders of scattering, the best that they can do.
    torch.testing.assert_close(draw("three tables", seen), wanted, rtol=0.06, atol=0.0)
    torch.testing.assert_close(draw("two tables", seen), wanted, rtol=0.25, atol=0.0)


@pytest.mark.parametrize(
    ("rung", "sun", "haze", "allowed"),
    [
        ("two tables", 60.0, 1.0, 0.06),
        ("two tables", 20.0, 10.0, 0.16),
        ("three tables", 60.0, 1.0, 0.01),
        ("three tables", 20.0, 10.0, 0.02),
        ("three tables", 5.0, 1.0, 0.03),
    ],
)
def test_tables_follow_the_march_of_level_rays(rung, sun, haze, allowed):
    length, azimuth = torch.logspace(2.0, 5.0, 13, dtype=FLOAT)[:, None], numbers(20.0, 90.0, 160.0)
    seen = elsewhere(view(length, 0.0, azimuth, sun=sun), haze=haze)
    error = draw(rung, seen) / draw("march", seen) - 1.0
    assert error.square().mean().sqrt() < allowed


@pytest.mark.parametrize(("eye", "elevation", "length"), [(2.0, 10.0, 2e4), (2.0, 3.0, 5e4), (2e3, -5.0, 2e4)])
def test_rays_that_leave_the_horizontal_are_level_ones_through_other_air(eye, elevation, length):
    seen = elsewhere(view(length, elevation, [20.0, 90.0, 160.0], background=0.3), eye=eye)
    flat, slanted, wanted = (draw(rung, seen) for rung in ("two tables", "three tables", "march"))
    error = (slanted - wanted).abs().max() / wanted.max()
    assert error < 0.05
    assert error <= 0.7 * (flat - wanted).abs().max() / wanted.max()


def test_light_of_a_part_of_a_ray_is_that_of_the_whole_less_what_passes_of_the_rest():
    # Upwards, where the sun stands as high over the far end as over the eye.
    whole = view([math.inf, 3e3], 90.0)
    (of_whole, of_part), (_, passed) = sky_reference.in_scatter(whole.air, whole.view, whole.length)
    beyond = replace(whole.view, eye_altitude=torch.tensor(3002.0, dtype=FLOAT))
    (of_rest, _), _ = sky_reference.in_scatter(whole.air, beyond, whole.length)
    torch.testing.assert_close(of_part[:2], (of_whole - passed * of_rest)[:2], rtol=1e-5, atol=0.0)


def test_distances_count_by_their_scale():
    for rung in DRAWING:
        near, far = view([1e3, 4e4], background=0.3), view([2e3, 8e4], background=0.3)
        assert torch.equal(draw(rung, near, distance_scale=2.0), draw(rung, far))


@pytest.mark.parametrize("rung", DRAWING)
def test_the_distance_grows_pale_and_blue(rung):
    drawn = draw(rung, view(torch.logspace(1.0, 5.0, 9, dtype=FLOAT), 0.0, 90.0))
    assert (drawn.diff(dim=0) > 0.0).all()
    assert (drawn[:5, 2] > 1.5 * drawn[:5, 0]).all()
    dark = draw(rung, view([3e4], background=5.0))[0]
    assert dark[0] > dark[1] > dark[2]  # of a bright object blue is lost first


@pytest.mark.parametrize("rung", DRAWING)
def test_the_tint_colours_the_middle_ground_and_leaves_the_horizon(rung):
    seen, tint = view([100.0, 1e4, math.inf], 0.0, 90.0), [0.5, 1.0, 2.0]
    plain, tinted = draw(rung, seen), draw(rung, seen, tint=tint)
    torch.testing.assert_close(tinted[:2], plain[:2] * numbers(*tint))
    torch.testing.assert_close(tinted[2], plain[2])


def test_haziness_gathers_light_under_the_sun_and_leaves_the_tables():
    seen = view([2e4, 2e4], 0.0, [0.0, 180.0], sun=10.0)
    for rung in DRAWING:
        towards, away = draw(rung, seen, haziness=0.85) / draw(rung, seen, haziness=0.4)
        assert (towards > 1.2).all()
        assert (away < 1.0).all()
    one, other = (aerial_perspective.prepare(perspective_of(haziness=g), seen).tables for g in (0.1, 0.9))
    assert torch.equal(one.haze, other.haze)


@pytest.mark.parametrize("rung", DRAWING)
def test_at_no_distance_light_grows_by_what_the_air_at_the_eye_scatters(rung):
    seen = view(0.0, 0.0, 90.0, sun=40.0, background=0.2)
    slope = torch.func.jacfwd(lambda length: draw(rung, replace(seen, length=length)))(seen.length)
    (far, near) = (draw(rung, replace(seen, length=torch.tensor(d, dtype=FLOAT))) for d in (2.0, 1.0))
    torch.testing.assert_close(slope, far - near, rtol=2e-3, atol=1e-9)
    dense = scattering.density(seen.view.eye_altitude)
    lit = sky_reference.sunlight(seen.air, numbers(2.0), numbers(math.sin(math.radians(40.0))))[0]
    phase = torch.stack([f[0] for f in aerial_perspective.phases(perspective_of(), seen.view)])
    once = (phase[:, None] * dense[:2, None] * torch.stack([seen.air.rayleigh, seen.air.haze_scattering])).sum(0) * lit
    added = slope + 0.2 * (dense @ seen.air.extinction())
    assert (added > once).all()  # and what is scattered more than once
    assert (added < 2.2 * once).all()


def test_splines_that_light_follows_are_found_again():
    wanted = numbers(0.0, 0.2, 0.35, 0.6, 0.5, 0.9, 1.1)[:, None].expand(SPLINES, 3)
    place = torch.cat([aerial_perspective.places(), numbers(1.0)])
    torch.testing.assert_close(aerial_perspective.splined(b_splines(place, SPLINES) @ wanted), wanted)


def test_a_picture_of_stored_tables_is_that_of_fresh_ones():
    seen = view([3e3, 6e4], [0.0, 1.0], background=0.1)
    stored = aerial_perspective.prepare(perspective_of(), view(1.0)).tables
    drawn = aerial_perspective.render_tables(perspective_of(), TabledView(seen, stored))
    assert torch.equal(drawn, draw("three tables", seen))
