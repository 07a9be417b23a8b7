import math
import subprocess
import sys
from dataclasses import replace

import pytest
import torch

from diffrender.atmosphere import height_fog, height_fog_reference
from diffrender.atmosphere.height_fog import FogView, HeightFog
from diffrender.parameters import defaults
from diffrender.rays import Rays, from_angles

FLOAT = torch.float64


def number(value):
    return torch.tensor(float(value), dtype=FLOAT)


def fog_of(**changed):
    return replace(defaults(HeightFog, FLOAT), **{name: number(value) for name, value in changed.items()})


def towards(up):
    up = torch.as_tensor(up, dtype=FLOAT)
    return torch.stack([torch.sqrt(1.0 - up * up), torch.zeros_like(up), up], -1)


def ray(altitude, up, length):
    altitude = torch.as_tensor(altitude, dtype=FLOAT)
    origin = torch.stack([torch.zeros_like(altitude), torch.zeros_like(altitude), altitude], -1)
    return Rays(origin, towards(up), torch.as_tensor(length, dtype=FLOAT))


def share(fog, rays, to_sun):
    return height_fog.sun_share(fog, rays, height_fog.flat_air_mass(to_sun))[..., 0]


def depth(fog, rays):
    return height_fog.optical_depth(fog, rays)[..., 0]


def view(rays, background=0.0, sun=1.0, sky=0.0, elevation=0.5):
    flat = torch.ones(3, dtype=FLOAT)
    return FogView(rays, background * flat, from_angles(number(elevation), number(0.3)), sun * flat, sky * flat)


# Extinction, scale height, altitude of the eye, climb of the ray, length, climb towards the sun; depth and share, which
# were computed apart from this code.
KNOWN = [
    (1e-3, 120, 10, 0.2, 500, 0.5, 0.312116856, 0.228238873),
    (1e-3, 120, 10, -0.02, 400, 0.05, 0.380562235, 0.0324256346),
    (5e-4, 800, 2, 0.7, 3000, 0.7, 0.528710993, 0.298998983),
    (2e-3, 50, 300, -0.5, 590, 0.3, 0.180471733, 0.143129635),
]


@pytest.mark.parametrize("known", KNOWN)
def test_depth_and_sunlight_are_the_known_ones(known):
    extinction, scale_height, altitude, up, length, sun, known_depth, known_share = known
    fog, seen = fog_of(extinction=extinction, scale_height=scale_height), ray(altitude, up, length)
    torch.testing.assert_close(depth(fog, seen), number(known_depth), rtol=3e-9, atol=0.0)
    torch.testing.assert_close(share(fog, seen, towards(sun)), number(known_share), rtol=3e-9, atol=0.0)


def test_render_is_that_of_quadrature_whatever_the_sun():
    seen = height_fog.example_inputs(FLOAT)
    wrong = {}
    for scale_height in (20.0, 2000.0):
        for elevation in (-1.0, 0.0, 0.3, 40.0):
            lit = replace(seen, to_sun=from_angles(number(math.radians(elevation)), number(0.1)))
            fog = fog_of(scale_height=scale_height, extinction=0.1 / scale_height)
            truth = height_fog.quadrature(fog, lit)
            error = (height_fog.render(fog, lit) - truth).abs().max() / truth.max()
            if error > 2e-4:
                wrong[scale_height, elevation] = error
    assert wrong == {}


def test_quadrature_has_converged():
    seen, fog = height_fog.example_inputs(FLOAT), fog_of()
    medium = height_fog_reference.Fog(height_fog.extinction(fog), fog.scale_height, fog.base_height)
    usual, finer = (height_fog_reference.light(medium, seen.rays, seen.to_sun, panels) for panels in (128, 256))
    torch.testing.assert_close(usual.sun_share, finer.sun_share, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(usual.transmittance, finer.transmittance, rtol=1e-12, atol=1e-14)


CHAPMAN = [(60, 1.99258), (80, 5.55052), (85, 10.14003), (88, 18.66611), (90, 35.38532), (91, 55.02434), (93, 195.924)]


@pytest.mark.parametrize(("zenith_degrees", "known"), CHAPMAN)
def test_air_mass_is_chapmans_at_a_radius_of_796_scale_heights(zenith_degrees, known):
    fog = fog_of(scale_height=(6_360e3 + 8e3) / 796.4)
    mass = height_fog.air_mass(fog, ray(8e3, 0.0, 1.0), towards(math.cos(math.radians(zenith_degrees))))
    torch.testing.assert_close(mass, number(known), rtol=5e-3, atol=0.0)  # a parabola for the height


def test_round_and_flat_earth_agree_for_a_high_sun():
    seen = replace(height_fog.example_inputs(FLOAT), to_sun=from_angles(number(1.0), number(0.0)))
    torch.testing.assert_close(
        height_fog.render(fog_of(), seen), height_fog.render_flat(fog_of(), seen), rtol=1e-4, atol=0.0
    )


@pytest.mark.parametrize("up", [0.3, 1e-9, 0.0, -1e-9, -0.05])
def test_a_ray_is_the_sum_of_its_parts(up):
    fog, to_sun = fog_of(), towards(0.2)
    whole, first, rest = ray(30.0, up, 500.0), ray(30.0, up, 200.0), ray(30.0 + 200.0 * up, up, 300.0)
    torch.testing.assert_close(depth(fog, whole), depth(fog, first) + depth(fog, rest), rtol=1e-14, atol=0.0)
    together = share(fog, first, to_sun) + torch.exp(-depth(fog, first)) * share(fog, rest, to_sun)
    torch.testing.assert_close(share(fog, whole, to_sun), together, rtol=1e-13, atol=0.0)


def test_even_fog_is_the_limit_of_a_large_scale_height():
    fog, rays = fog_of(scale_height=1e12, extinction=2e-3), ray(0.0, 0.3, 700.0)
    torch.testing.assert_close(depth(fog, rays), number(1.4), rtol=1e-9, atol=0.0)
    # Lit from straight above by nothing that fog so high has not dimmed: an air mass of 0 stands for a sun within.
    within = height_fog.sun_share(fog, rays, number(0.0))[0]
    torch.testing.assert_close(within, 1.0 - torch.exp(number(-1.4)), rtol=1e-9, atol=0.0)


def test_a_ray_to_space_crosses_its_air_mass():
    fog = fog_of(extinction=2e-3, scale_height=100.0)
    torch.testing.assert_close(depth(fog, ray(100.0, 0.25, math.inf)), number(0.8 / math.e), rtol=1e-14, atol=0.0)


def test_sunlight_lies_between_that_of_the_fog_at_the_two_ends():
    up = torch.linspace(-1.0, 1.0, 41, dtype=FLOAT)
    fog, rays, to_sun = fog_of(), ray(torch.full_like(up, 80.0), up, torch.full_like(up, 75.0)), towards(0.3)
    mean = share(fog, rays, to_sun) / (1.0 - torch.exp(-depth(fog, rays)))
    ends = torch.stack([80.0 + 0.0 * up, 80.0 + 75.0 * up])
    dimmed = torch.exp(-fog.extinction * fog.scale_height / 0.3 * torch.exp(-ends / fog.scale_height))
    assert ((mean >= dimmed.amin(0) * (1.0 - 1e-14)) & (mean <= dimmed.amax(0) * (1.0 + 1e-14))).all()


def test_no_fog_leaves_the_background():
    seen = replace(height_fog.example_inputs(FLOAT))
    drawn = height_fog.render(fog_of(extinction=0.0), seen)
    assert torch.equal(drawn, seen.background)


def test_thin_fog_adds_light_in_proportion_to_its_extinction():
    seen = view(ray(30.0, 0.1, 300.0), sky=0.3)
    thin, thinner = (height_fog.render(fog_of(extinction=e), seen) for e in (2e-12, 1e-12))
    torch.testing.assert_close(thin, 2.0 * thinner, rtol=1e-8, atol=0.0)
    assert (thinner > 0.0).all()


def test_white_fog_under_an_even_sky_of_the_backgrounds_radiance_cannot_be_seen():
    fog = replace(fog_of(extinction=5e-3), albedo=torch.ones(3, dtype=FLOAT))
    seen = view(ray(torch.tensor([5.0, 30.0]).double(), [0.0, -0.02], [900.0, 1e3]), background=0.7, sun=0.0, sky=0.7)
    torch.testing.assert_close(height_fog.render(fog, seen), seen.background.expand(2, 3), rtol=1e-14, atol=0.0)


def test_base_height_is_an_extinction_of_another_altitude():
    seen = height_fog.example_inputs(FLOAT)
    raised = fog_of(base_height=120.0, scale_height=120.0, extinction=1e-3)
    denser = fog_of(base_height=0.0, scale_height=120.0, extinction=1e-3 * math.e)
    torch.testing.assert_close(height_fog.render(raised, seen), height_fog.render(denser, seen))


def test_extinction_is_the_mean_of_the_channels_whatever_the_tint():
    tinted = replace(fog_of(extinction=2e-3), extinction_tint=torch.tensor([1.0, 2.0, 9.0], dtype=FLOAT))
    torch.testing.assert_close(height_fog.extinction(tinted), torch.tensor([0.5e-3, 1e-3, 4.5e-3], dtype=FLOAT))


def test_tints_multiply_the_light_of_the_sun_and_of_the_sky():
    seen, plain = replace(height_fog.example_inputs(FLOAT), background=torch.zeros(3, dtype=FLOAT)), fog_of()
    tint = torch.tensor([0.0, 1.0, 3.0], dtype=FLOAT)
    tinted = replace(plain, sun_tint=tint, ambient_tint=tint)
    torch.testing.assert_close(height_fog.render(tinted, seen), tint * height_fog.render(plain, seen))


def test_phase_functions_of_all_directions_sum_to_one():
    polar = torch.linspace(-1.0, 1.0, 20_001, dtype=FLOAT)
    middle = (polar[1:] + polar[:-1]) / 2.0
    rays = ray(torch.zeros_like(middle), middle, torch.ones_like(middle))
    seen = replace(view(rays), to_sun=towards(1.0))  # round the zenith
    total = height_fog.phase(fog_of(asymmetry=0.6), seen).mean(0) * 4.0 * math.pi
    torch.testing.assert_close(total, torch.ones(3, dtype=FLOAT), rtol=1e-6, atol=0.0)


def test_grey_fog_is_the_closed_form_to_the_bit_and_a_tint_is_left_out():
    seen = height_fog.example_inputs(FLOAT)
    grey = fog_of()
    assert torch.equal(height_fog.render_grey(grey, seen), height_fog.render(grey, seen))
    tinted = replace(grey, extinction_tint=torch.tensor([0.5, 1.0, 1.5], dtype=FLOAT))
    assert torch.equal(height_fog.render_grey(tinted, seen), height_fog.render_grey(grey, seen))
    assert not torch.equal(height_fog.render(tinted, seen), height_fog.render(grey, seen))


def test_the_alpha_blend_is_the_closed_form_where_no_sunlight_is_dimmed():
    above = ray(1500.0, [0.1, 0.0, 0.9], [1e3, 1e4, 30.0])
    seen = view(above, background=0.2, sky=0.4, elevation=1.2)
    thin = fog_of(extinction=1e-2)
    torch.testing.assert_close(
        height_fog.render_blend(thin, seen), height_fog.render_flat(thin, seen), rtol=1e-5, atol=0.0
    )


# Gradients where branches meet


def slope_by_climb(quantity, up):
    return torch.func.jacfwd(quantity)(number(up))


@pytest.mark.parametrize("up", [1e-7, 1e-12, 0.0, -1e-12, -1e-7])
def test_slope_of_depth_by_the_climb_of_a_level_ray_is_exact(up):
    fog, length = fog_of(), 400.0
    found = slope_by_climb(lambda climb: depth(fog, ray(30.0, climb, length)), up)
    wanted = -fog.extinction * math.exp(-30.0 / 120.0) * length**2 / (2.0 * fog.scale_height)
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=0.0)


@pytest.mark.parametrize("off", [1e-7, 1e-12, 0.0, -1e-12, -1e-7])
def test_slope_of_sunlight_by_the_climb_of_a_ray_as_steep_as_the_sun_is_exact(off):
    fog, sun = fog_of(), number(0.4)

    def lit(climb):
        return share(fog, ray(30.0, climb, 600.0), towards(sun))

    # By a central difference wide enough to see both sides.
    wide = 1e-4
    wanted = (lit(sun + wide) - lit(sun - wide)) / (2.0 * wide)
    torch.testing.assert_close(slope_by_climb(lit, sun + off), wanted, rtol=1e-5, atol=0.0)


@pytest.mark.parametrize("elevation", [1e-9, 0.0, -1e-9])
def test_slope_of_air_mass_is_smooth_through_the_horizon(elevation):
    def mass(climb):
        return height_fog.air_mass(fog_of(), ray(30.0, 0.0, 1.0), towards(climb))

    wide = 1e-5
    wanted = (mass(number(wide)) - mass(number(-wide))) / (2.0 * wide)
    torch.testing.assert_close(slope_by_climb(mass, elevation), wanted, rtol=1e-3, atol=0.0)


def test_fog_that_hides_everything_has_no_gradient_but_that_of_its_colour():
    thick = {"extinction": number(1.0), "scale_height": number(1.0), "base_height": number(5000.0)}
    seen = view(ray(30.0, [0.2, -0.3, 0.0], [math.inf, 90.0, 1e7]), background=0.5, sky=0.3)
    slopes = torch.func.jacrev(lambda moved: height_fog.render(replace(fog_of(), **moved), seen))(thick)
    assert all(torch.equal(slope, torch.zeros_like(slope)) for slope in slopes.values())


@pytest.mark.parametrize("rung", ["flat earth", "round earth"])
def test_float32_stays_finite_80_scale_heights_up_and_down_and_over_ten_thousand_kilometres(rung):
    heights, climbs = torch.linspace(-80.0, 80.0, 9), torch.tensor([-1.0, -1e-3, -1e-9, 0.0, 1e-9, 1e-3, 1.0])
    lengths = torch.tensor([0.0, 1e-2, 1e3, 1e7, math.inf])
    height, up, length = (axis.flatten() for axis in torch.meshgrid(heights, climbs, lengths, indexing="ij"))
    fog = defaults(HeightFog, torch.float32)
    rays = ray(height.double() * 120.0, up.double(), length.double())
    seen = view(rays, background=0.5, sky=0.3, elevation=0.01)
    seen = FogView(
        Rays(*(part.float() for part in vars(rays).values())),
        **{name: part.float() for name, part in vars(seen).items() if name != "rays"},
    )
    names = ("extinction", "scale_height", "base_height", "asymmetry")

    def draw(moved):
        return height_fog.EFFECT.rungs[rung](replace(fog, **dict(zip(names, moved, strict=True))), seen)

    values = tuple(getattr(fog, name) for name in names)
    assert draw(values).isfinite().all()
    assert all(slope.isfinite().all() for slope in torch.func.jacfwd(draw)(values))


# In a process of its own, because torch.compile does not look into records whose types the tests check.
COMPILED = """
import torch
from diffrender.atmosphere import height_fog
from diffrender.atmosphere.height_fog import HeightFog
from diffrender.parameters import defaults

seen, plain = height_fog.example_inputs(torch.float32), vars(defaults(HeightFog, torch.float32))

def share(extinction):
    fog = HeightFog(**(plain | {"extinction": extinction}))
    return height_fog.sun_share(fog, seen.rays, height_fog.air_mass(fog, seen.rays, seen.to_sun))

def value_and_slope(function):
    leaf = torch.tensor(1e-7, requires_grad=True)
    drawn = function(leaf)
    return drawn.detach(), torch.autograd.grad(drawn.sum(), leaf)[0]

compiled = value_and_slope(torch.compile(share, fullgraph=True))
torch.testing.assert_close(compiled, value_and_slope(share), rtol=1e-5, atol=0.0)
"""


@pytest.mark.slow
def test_compiled_value_and_gradient_are_the_eager_ones_in_the_thinnest_fog():
    ended = subprocess.run([sys.executable, "-c", COMPILED], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
