import math
from dataclasses import fields, replace

import pytest
import torch
from torch.utils import _pytree as pytree

from diffrender.atmosphere import scattering, sky, sky_reference
from diffrender.atmosphere.sky import EFFECT, Sky, SkyView
from diffrender.colour import luminance
from diffrender.numerics import gauss_legendre
from diffrender.parameters import defaults
from diffrender.rays import from_angles

CLEAR = defaults(Sky, torch.float64)
OVERCAST = replace(CLEAR, overcast=torch.tensor(1.0, dtype=torch.float64))
IRRADIANCE = torch.tensor([1.474, 1.8504, 1.91198], dtype=torch.float64)
DRAWING = [name for name in EFFECT.rungs if name != "skip"]
# Elevation of the sun in degrees, altitude of the eye.
PLACES = [(90.0, 0.0), (90.0, 10e3), (1.0, 2.0), (0.0, 0.0), (0.0, 1e3), (-0.1, 2.0), (-6.0, 10e3), (-12.0, 0.0)]


def double(value):
    return torch.as_tensor(value, dtype=torch.float64)


def towards(elevation, azimuth=0.0):
    """Directions at angles in degrees."""
    return from_angles(*torch.broadcast_tensors(*(torch.deg2rad(double(angle)) for angle in (elevation, azimuth))))


def view(sun, direction, eye_altitude=2.0):
    """View under a sun at an elevation in degrees over +x."""
    to_sun = double([0.0, 0.0, 1.0]) if sun == 90.0 else towards(sun)
    return SkyView(direction, to_sun, IRRADIANCE, double(eye_altitude))


def draw(seen, parameters=CLEAR, rung="march"):
    return EFFECT.rungs[rung](parameters, seen)


def changed(**values):
    return replace(CLEAR, **{name: double(value) for name, value in values.items()})


def grid():
    """Directions from the horizon to the zenith, all round."""
    elevation = double([0.05, 0.5, 2.0, 5.0, 15.0, 40.0, 90.0])[:, None]
    return towards(elevation, torch.arange(0.0, 181.0, 30.0, dtype=torch.float64))


def on_the_ground(parameters, sun, eye_altitude=2.0):
    """Light of the whole sky on level ground [W/m^2]."""
    place, weight = gauss_legendre(24)
    elevation = math.pi / 2.0 * (0.5 + 0.5 * place) ** 2  # dense at the horizon
    solid = math.pi / 2.0 * (0.5 + 0.5 * place) * weight * torch.cos(elevation) * torch.sin(elevation)
    azimuth = math.pi * (torch.arange(24, dtype=torch.float64) + 0.5) / 24
    directions = from_angles(*torch.meshgrid(elevation, azimuth, indexing="ij"))
    radiance = draw(view(sun, directions, eye_altitude), parameters)
    return (radiance.mean(1) * (2.0 * math.pi * solid)[:, None]).sum(0)


@pytest.mark.parametrize("rung", DRAWING)
def test_sky_is_the_same_on_either_side_of_the_sun(rung):
    angle = torch.arange(5.0, 180.0, 25.0, dtype=torch.float64)
    left, right = (draw(view(20.0, towards(10.0, side * angle)), rung=rung) for side in (1.0, -1.0))
    torch.testing.assert_close(left, right, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("rung", DRAWING)
def test_sky_turns_with_its_sun(rung):
    turned = replace(view(5.0, towards(10.0, 70.0 + 40.0)), to_sun=towards(5.0, 40.0))
    torch.testing.assert_close(draw(turned, rung=rung), draw(view(5.0, towards(10.0, 70.0)), rung=rung))


@pytest.mark.parametrize("rung", DRAWING)
def test_radiance_is_proportional_to_the_suns_irradiance(rung):
    seen = view(5.0, grid())
    twice = replace(seen, irradiance=2.0 * seen.irradiance)
    torch.testing.assert_close(draw(twice, rung=rung), 2.0 * draw(seen, rung=rung), rtol=1e-12, atol=0.0)


def test_hazier_skies_glow_nearer_to_the_sun():
    seen = view(30.0, towards(double([30.5, 33.0, 60.0])))
    glow = torch.stack([draw(seen, changed(haziness=haziness)) for haziness in (0.5, 0.8, 0.95)])
    assert (glow[:, 0].diff(dim=0) > 0.0).all()
    ratio = glow[:, 0] / glow[:, 1]
    assert (ratio.diff(dim=0) > 0.0).all()
    assert (glow[2, 2] < glow[0, 2]).all()


def test_large_particles_whiten_the_glow_and_ozone_blues_the_twilight():
    beside_sun, zenith = view(30.0, towards(33.0)), view(-5.0, towards(90.0))

    def redness(seen, **values):
        drawn = draw(seen, changed(**values))
        return drawn[0] / drawn[2]

    assert redness(beside_sun, coarse_scale=10.0) > 1.2 * redness(beside_sun)
    # Hulburt 1953: without ozone the zenith after sunset would be grey-yellow.
    assert redness(zenith, ozone=0.0) > 1.3 * redness(zenith)


def test_day_is_blue_above_and_pale_below_and_sunset_is_red_towards_the_sun():
    above, below = draw(view(45.0, towards(double([80.0, 2.0]), 120.0)))
    assert above[2] > 2.0 * above[0]
    assert 1.0 < below[2] / below[0] < above[2] / above[0]
    low, high = draw(view(-1.0, towards(double([1.0, 45.0]))))
    assert low[0] > 3.0 * low[2]
    assert high[0] < high[2]


def test_bright_ground_brightens_the_sky():
    seen = view(40.0, grid())
    assert (draw(seen, changed(ground_albedo=1.0)) > draw(seen, changed(ground_albedo=0.0))).all()


# Janiczek and DeYoung 1987, "Computer programs for sun and moon illuminance" (U.S. Naval Observatory, circular 171):
# elevation of the sun in degrees -> illuminance of level ground by sun and cloudless sky [lx].
MEASURED = {60: 1.03e5, 45: 7.78e4, 20: 2.74e4, 5: 4.54e3, 0: 759.0, -3: 79.1, -6: 3.41, -9: 0.116, -12: 8.06e-3}


@pytest.mark.parametrize("elevation", MEASURED)
def test_day_and_twilight_are_as_bright_as_measured(elevation):
    ground, cos_sun = double(0.0), towards(elevation)[2]
    column = scattering.column(ground, scattering.to_visible_sun(ground, cos_sun))
    through = scattering.transmittance(sky.medium(CLEAR), column) * scattering.sunlit(ground, cos_sun)
    light = on_the_ground(CLEAR, elevation) + IRRADIANCE * through * torch.relu(cos_sun)
    found = 128e3 * luminance(light) / luminance(IRRADIANCE)
    # The clearest of airs is brighter than the mean at a low sun; over the seven decades below, within 2.5.
    assert 0.95 < found / MEASURED[elevation] < (1.1 if elevation >= 45 else 2.5)


def test_twilight_fades_without_a_step_from_day_to_twelve_degrees_below():
    directions = towards(double([90.0, 10.0, 2.0]), double([0.0, 0.0, 60.0]))
    fading = torch.stack([luminance(draw(view(e, directions))) for e in torch.arange(6.0, -12.1, -1.0).tolist()])
    assert fading.isfinite().all()
    assert (fading > 0.0).all()
    falls = (fading[1:] / fading[:-1]).log()
    assert (falls[4:] < 0.0).all()  # from a sun at 2 degrees on; above, the air beside it is still brightening
    assert (falls > -1.5).all()


def test_earths_shadow_rises_opposite_a_set_sun():
    # With the sun 4 degrees down, air that is low opposite it lies in the shadow; the light comes from above that.
    low, high = draw(view(-4.0, towards(double([0.5, 12.0]), 180.0)), rung="march single")
    assert (low[:2] < 0.2 * high[:2]).all()
    before = draw(view(4.0, towards(double([0.5, 12.0]), 180.0)), rung="march single")
    assert (before[0, :2] > before[1, :2]).all()


@pytest.mark.parametrize("rung", DRAWING)
def test_night_is_black(rung):
    drawn = draw(view(-40.0, grid()), rung=rung)
    assert torch.equal(drawn, torch.zeros_like(drawn))


@pytest.mark.parametrize("rung", DRAWING)
def test_without_overcast_its_layer_leaves_no_trace(rung):
    white = changed(overcast=0.0, overcast_transmittance=[4.0, 4.0, 4.0], overcast_ahead=3.0, overcast_left=-2.0)
    seen = view(20.0, grid())
    assert torch.equal(draw(seen, white, rung), draw(seen, rung=rung))


@pytest.mark.parametrize("lean", [0.0, 4.0])
@pytest.mark.parametrize("rung", DRAWING)
def test_all_overcast_sky_is_moon_and_spencers_alone(rung, lean):
    whole = replace(OVERCAST, overcast_ahead=double(lean), overcast_left=double(-lean))
    drawn = draw(view(50.0, grid()), whole, rung)
    gradation = (1.0 + 2.0 * grid()[..., 2:]) / 3.0
    torch.testing.assert_close(drawn, drawn[-1, 0] * gradation, rtol=1e-9, atol=0.0)
    ratio = draw(view(50.0, towards(0.0)), whole, rung) / draw(view(50.0, towards(90.0)), whole, rung)
    torch.testing.assert_close(ratio, double([1.0 / 3.0] * 3), rtol=1e-9, atol=0.0)


def test_ground_below_an_overcast_sky_gets_what_the_layer_lets_through():
    half, whole = (replace(OVERCAST, overcast_transmittance=double([share] * 3)) for share in (0.5, 1.0))
    torch.testing.assert_close(2.0 * on_the_ground(half, 50.0, 0.0), on_the_ground(whole, 50.0, 0.0))
    top = double(2e3)
    air, cos_sun = sky.medium(CLEAR), towards(50.0)[2]
    direct = scattering.transmittance(air, scattering.column(top, cos_sun)) * cos_sun
    mean = sky_reference.mean_radiance(air, top[None], cos_sun[None])[0, 0]
    wanted = IRRADIANCE * (direct + math.pi * mean)
    torch.testing.assert_close(on_the_ground(whole, 50.0, 0.0), wanted, rtol=5e-3, atol=0.0)


def test_overcast_share_leans_to_its_side_and_stays_a_share():
    ahead, behind, left = towards(0.0, double([0.0, 180.0, 90.0]))
    leaning = changed(overcast=0.5, overcast_ahead=4.0)
    shares = torch.stack([sky.overcast_share(leaning, direction) for direction in (ahead, left, behind)])
    assert (shares.diff() < 0.0).all()
    assert ((shares > 0.0) & (shares < 1.0)).all()
    for extreme in (0.0, 1.0):
        share = sky.overcast_share(replace(leaning, overcast=double(extreme)), grid())
        assert torch.equal(share, torch.full_like(share, extreme))


# Elevation of the sun -> error of the tables against the march: root of the mean square, and largest, over all
# directions and channels. Linear in azimuth between eight columns: too coarse for the edge of the earth's shadow.
TABLES = {60: (0.005, 0.02), 10: (0.005, 0.02), 1: (0.01, 0.03), -3: (0.04, 0.3)}


@pytest.mark.parametrize("elevation", TABLES)
def test_tables_follow_the_march(elevation):
    seen = view(elevation, grid())
    error = (draw(seen, rung="tables") / draw(seen) - 1.0).abs()
    mean, largest = TABLES[elevation]
    assert error.square().mean().sqrt() < mean
    assert error.max() < largest


@pytest.mark.parametrize("elevation", [45.0, 5.0])
def test_coarser_tables_of_a_search_are_close_to_those_of_a_picture(elevation):
    seen = view(elevation, grid())
    size = sky.Size(rows=20, columns=4, steps=14, heights=6, suns=12, steps_around=6)
    coarse = sky.render_tables(CLEAR, sky.TabledView(seen, sky.tables(CLEAR, sky.geometry(seen, size))))
    error = coarse / draw(seen) - 1.0
    assert error.square().mean().sqrt() < 0.015


# Elevation of the sun -> largest error of the march against quadrature, over that of the brightest direction; and of
# each direction by itself. The table of mean radiance is the cause of nearly all of it.
MARCH = {60.0: (0.01, 0.015), 1.0: (0.01, 0.05), -3.0: (0.01, 0.05), -9.0: (0.02, 0.4)}


@pytest.mark.slow
@pytest.mark.parametrize("elevation", MARCH)
def test_march_reaches_quadrature_by_day_and_in_twilight(elevation):
    partly = changed(overcast=0.2, overcast_ahead=1.0)
    seen = view(elevation, grid())
    truth = sky.quadrature(partly, seen)
    error = (draw(seen, partly) - truth).abs()
    over_brightest, by_itself = MARCH[elevation]
    assert (error.amax((0, 1)) / truth.amax((0, 1))).max() < over_brightest
    assert (error / truth).max() < by_itself


@pytest.fixture(scope="module")
def usual():
    return sky.quadrature(CLEAR, EFFECT.example_inputs(torch.float64))


@pytest.mark.slow
@pytest.mark.parametrize("part", [field.name for field in fields(sky_reference.Fineness)])
def test_quadrature_does_not_move_with_twice_as_many_nodes(part, usual):
    twice = replace(sky_reference.USUAL, **{part: 2 * getattr(sky_reference.USUAL, part)})
    finer = sky.quadrature(CLEAR, EFFECT.example_inputs(torch.float64), twice)
    lit = finer > 0.0
    torch.testing.assert_close(usual[lit], finer[lit], rtol=1e-3, atol=0.0)
    # A fifth of what the last rung is allowed.
    assert (usual - finer).abs().max() < 0.2 * EFFECT.tolerance * finer.max()


@pytest.mark.parametrize("eye_altitude", [0.0, 2.0, 1e3, 10e3])
@pytest.mark.parametrize("rung", DRAWING)
def test_sky_ends_at_the_grounds_edge_seen_from_any_altitude(rung, eye_altitude):
    dip = math.degrees(math.acos(scattering.PLANET_RADIUS / (scattering.PLANET_RADIUS + eye_altitude)))
    over, under = (towards(-dip + side, double([10.0, 100.0, 190.0])) for side in (1e-3, -1e-3))
    assert (draw(view(10.0, over, eye_altitude), rung=rung) > 1e-3).all()
    black = draw(view(10.0, under, eye_altitude), rung=rung)
    assert torch.equal(black, torch.zeros_like(black))


def test_sky_darkens_and_its_horizon_sinks_as_the_eye_climbs():
    zenith = torch.stack([draw(view(40.0, towards(90.0), altitude)) for altitude in (0.0, 2.0, 1e3, 10e3, 50e3)])
    assert (zenith.diff(dim=0) < 0.0).all()
    assert (zenith[-1] < 0.05 * zenith[0]).all()


def test_clear_days_medium_is_hillaires_but_for_the_haze_by_colour():
    plain = sky.medium(changed(mie_colour_exponent=0.0, coarse_scale=1e-3, mie_scale=1.0 - 1e-3))
    torch.testing.assert_close(plain.rayleigh, double(scattering.RAYLEIGH))
    torch.testing.assert_close(plain.haze, double([scattering.HAZE] * 3))
    torch.testing.assert_close(plain.ozone, double(scattering.OZONE))
    angstrom = sky.medium(changed(mie_colour_exponent=2.0, coarse_scale=1e-3, rayleigh_colour_exponent=6.0))
    red, green, blue = (angstrom.haze - 1e-3 * scattering.HAZE).unbind()
    assert (blue / red).item() == pytest.approx((680 / 440) ** 2)
    assert green.item() == pytest.approx(scattering.HAZE)
    wider = angstrom.rayleigh / double(scattering.RAYLEIGH)
    assert (wider[2] / wider[0]).item() == pytest.approx((680 / 440) ** 2)


@pytest.mark.parametrize(("sun", "eye_altitude"), PLACES)
@pytest.mark.parametrize("rung", EFFECT.rungs)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_in_all_that_a_sky_depends_on(dtype, rung, eye_altitude, sun):
    # The zenith, where azimuths meet, the sun itself, opposite it, level, and below the ground's edge.
    directions = towards(double([60.0, 5.0, 0.0, 0.0, -0.001, -5.0]), double([20.0, 3.0, 0.0, 180.0, 90.0, 10.0]))
    to_sun = view(sun, directions).to_sun
    directions = torch.cat([double([[0.0, 0.0, 1.0]]), to_sun[None], -to_sun[None], directions])
    given = changed(overcast=0.3, overcast_ahead=1.0), view(sun, directions, eye_altitude)
    given = pytree.tree_map(lambda tensor: tensor.to(dtype, copy=True).requires_grad_(), given)
    leaves = pytree.tree_leaves(given)
    drawn = EFFECT.rungs[rung](*given)
    slopes = torch.autograd.grad(drawn.sum() + 0.0 * sum(leaf.sum() for leaf in leaves), leaves)
    assert drawn.isfinite().all()
    assert (drawn >= 0.0).all()
    assert all(slope.isfinite().all() for slope in slopes)


@pytest.mark.parametrize("sun", [90.0, 60.0, 1.0])
def test_gradient_by_the_suns_direction_in_float32_follows_float64(sun):
    found = []
    for dtype in (torch.float32, torch.float64):
        seen = pytree.tree_map(lambda tensor, dtype=dtype: tensor.float().to(dtype), view(sun, grid()))
        towards_sun = seen.to_sun.clone().requires_grad_()
        drawn = draw(replace(seen, to_sun=towards_sun), pytree.tree_map(lambda t, dtype=dtype: t.to(dtype), CLEAR))
        found.append(torch.autograd.grad(drawn.sum(), towards_sun)[0].double())
    assert (found[0] - found[1]).norm() < 1e-3 * found[1].norm()


@pytest.mark.slow
@pytest.mark.parametrize("rung", DRAWING)
@pytest.mark.parametrize("sun", [80.0, 3.0, -4.0])
def test_gradient_by_the_suns_place_matches_finite_differences(rung, sun):
    directions = towards(double([70.0, 20.0, 12.0]), double([10.0, 100.0, 170.0]))

    def brightness(elevation):
        seen = replace(view(0.0, directions), to_sun=from_angles(elevation, torch.zeros_like(elevation)))
        return draw(seen, rung=rung).log().sum()

    place, step = torch.deg2rad(double(sun)), 1e-7
    difference = (brightness(place + step) - brightness(place - step)) / (2.0 * step)
    backward = torch.func.grad(brightness)(place)
    _, forward = torch.func.jvp(brightness, (place,), (torch.ones_like(place),))
    for slope in (backward, forward):
        torch.testing.assert_close(slope, difference, atol=1e-4, rtol=1e-3)


@pytest.mark.parametrize("rung", DRAWING)
@pytest.mark.parametrize("sun", [60.0, 1.0, -3.0, -9.0])
def test_sky_in_float32_follows_float64_from_noon_to_night(rung, sun):
    given = CLEAR, view(sun, grid())
    single = EFFECT.rungs[rung](*pytree.tree_map(torch.Tensor.float, given))
    torch.testing.assert_close(single.double(), EFFECT.rungs[rung](*given), rtol=5e-3, atol=1e-9)


@pytest.mark.parametrize("sun", [60.0, 5.0, -6.0, -40.0])
@pytest.mark.parametrize(
    "parameters", [CLEAR, changed(haziness=0.99, mie_scale=100.0), changed(overcast=0.5), OVERCAST]
)
def test_no_direction_is_brighter_than_the_bound_on_the_change(parameters, sun):
    seen = view(sun, torch.cat([grid().flatten(0, 1), towards(sun)[None]]))
    assert (draw(seen, parameters) <= EFFECT.largest_change(parameters, seen)).all()


def test_at_night_the_sky_is_known_to_change_nothing():
    assert EFFECT.largest_change(CLEAR, view(-40.0, grid())) == 0.0
