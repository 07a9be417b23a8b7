import math

import pytest
import torch

from diffrender.rays import from_angles
from diffrender.shading import brdf, microfacet
from diffrender.shading.brdf import Geometry, material
from diffrender.surfaces import EvenSky

FLOAT = torch.float64
UP = (0.0, 0.0, 1.0)
ROUGHNESSES = (0.0, 0.02, 0.3, 0.7, 1.0)


def tensor(*numbers, dtype=FLOAT):
    return torch.tensor(numbers, dtype=dtype)


def number(value, dtype=FLOAT):
    return torch.tensor(value, dtype=dtype)


def seen_at(*degrees):
    """Directions that much above the horizon."""
    return from_angles(tensor(*degrees).deg2rad(), torch.zeros(len(degrees), dtype=FLOAT))


def over_directions(heights=400, turns=300):
    """Directions of the upper half and their solid angles, finest at the horizon and about the azimuth of pi."""
    rise, turn = ((torch.arange(count, dtype=FLOAT) + 0.5) / count for count in (heights, turns))
    height, side = rise.square()[:, None].expand(heights, turns), 2.0 * turn - 1.0
    around = math.pi * (1.0 + side**3)
    level = torch.sqrt(1.0 - height * height)
    direction = torch.stack([level * torch.cos(around), level * torch.sin(around), height], -1)
    return direction, (2.0 * rise[:, None] / heights) * (6.0 * math.pi * side**2 / turns)


# Facets


@pytest.mark.parametrize("roughness", [0.3, 0.6, 1.0])
def test_facets_cover_the_ground_once(roughness):
    angle = ((torch.arange(4000, dtype=FLOAT) + 0.5) * (0.5 * math.pi / 4000))[:, None]
    half = torch.cat([torch.sin(angle), torch.zeros_like(angle), torch.cos(angle)], -1)
    shares = microfacet.ggx(half, tensor(*UP), microfacet.spread_squared(number(roughness)))
    total = (shares * half[:, 2] * half[:, 0]).mean() * math.pi**2
    torch.testing.assert_close(total, number(1.0), rtol=1e-4, atol=0.0)


@pytest.mark.parametrize("angle", [0.0, 1e-4, 1e-3, 0.1])
def test_a_mirrors_facets_keep_their_digits_in_float32(angle):
    half = tensor(math.sin(angle), 0.0, math.cos(angle))
    double = microfacet.ggx(half, tensor(*UP), microfacet.spread_squared(number(0.0)))
    single = microfacet.ggx(half.float(), tensor(*UP).float(), microfacet.spread_squared(number(0.0).float()))
    torch.testing.assert_close(single.double(), double, rtol=1e-5, atol=0.0)
    naive = 1.0 - half.float()[2] ** 2
    assert angle != 1e-4 or naive == 0.0  # what the cross product is for


@pytest.mark.parametrize("visible", [microfacet.visible_smith, microfacet.visible_schlick])
def test_all_of_a_mirrors_facets_are_seen(visible):
    cosine, spread = tensor(0.2, 0.7, 1.0), microfacet.spread_squared(number(0.0))
    torch.testing.assert_close(
        visible(cosine, number(0.6), spread) * 4.0 * cosine, torch.ones(3, dtype=FLOAT), rtol=2e-2, atol=0.0
    )


@pytest.mark.parametrize(("lowest", "least"), [(0.5, 0.84), (0.05, 0.18)])
def test_schlicks_function_is_darker_than_smiths_by_what_is_told(lowest, least):
    cosine = torch.linspace(lowest, 1.0, 30, dtype=FLOAT)
    spread = microfacet.spread_squared(tensor(*ROUGHNESSES))[:, None, None]
    smith, schlick = (
        one(cosine, cosine[:, None], spread) for one in (microfacet.visible_smith, microfacet.visible_schlick)
    )
    assert least < (schlick / smith).min() < 1.1 * least
    assert (schlick / smith).max() < 1.001


def test_fresnel_by_schlick_is_near_the_exact_one_of_water():
    cosine = torch.linspace(0.0, 1.0, 50, dtype=FLOAT)
    exact = microfacet.fresnel_exact(1.33, cosine)
    schlick = microfacet.fresnel_schlick(tensor(0.02, 0.02, 0.02), cosine)[:, 0]
    assert (schlick - exact).abs().max() < 0.07
    assert exact[-1] == pytest.approx(0.33**2 / 2.33**2)


# White furnace


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
def test_no_white_surface_sends_more_than_it_gets(metallic):
    cosine, roughness = (torch.linspace(0.0, 1.0, count, dtype=FLOAT) for count in (61, 41))
    white = material(torch.ones(3, dtype=FLOAT), roughness[:, None], number(metallic).expand(41, 1))
    sent = brdf.albedo(white, cosine.expand(41, 61))
    assert sent.max() <= 1.0
    assert sent.min() > 0.05
    smooth = brdf.albedo(material(torch.ones(3, dtype=FLOAT), number(0.0), number(metallic)), cosine[20:])
    assert smooth.min() > (0.95 if metallic in (0.0, 1.0) else 0.5)


@pytest.mark.parametrize("roughness", [0.4, 1.0])
@pytest.mark.parametrize("elevation", [6.0, 30.0, 90.0])
def test_tables_are_the_sum_over_directions(roughness, elevation):
    to_light, solid_angle = over_directions()
    grey = material(tensor(0.9, 0.5, 0.1), number(roughness), number(0.4))
    geometry = Geometry(tensor(*UP), seen_at(elevation)[0], to_light)
    shares = brdf.reflected(grey, geometry) * solid_angle[..., None]
    sky = EvenSky(tensor(0.5, 0.7, 0.2), tensor(0.3, -0.2, 0.4))
    radiance = sky.mean + sky.gradient * to_light[..., 2:]
    torch.testing.assert_close(brdf.albedo(grey, geometry.to_eye[2]), shares.sum((0, 1)), rtol=0.0, atol=2e-3)
    torch.testing.assert_close(
        brdf.reflected_sky(grey, geometry, sky), (shares * radiance).sum((0, 1)), rtol=0.0, atol=2e-3
    )


def test_the_sky_in_a_bent_mirror_is_that_of_the_mirrored_direction():
    normal, to_eye = seen_at(70.0)[0], seen_at(25.0)[0]
    silver = material(torch.ones(3, dtype=FLOAT), number(0.0), number(1.0))
    sky = EvenSky(tensor(0.5, 0.5, 0.5), tensor(0.5, 0.5, 0.5))
    mirrored = 2.0 * (normal @ to_eye) * normal - to_eye
    found = brdf.reflected_sky(silver, Geometry(normal, to_eye, to_eye), sky)
    torch.testing.assert_close(found, sky.mean + sky.gradient * mirrored[2], rtol=1e-3, atol=0.0)


# Delicate points


def test_light_and_eye_may_be_exchanged():
    rough = material(tensor(0.8, 0.5, 0.2), tensor(*ROUGHNESSES), number(0.3).expand(5))
    one, other = seen_at(20.0)[0], from_angles(number(0.9), number(2.0))
    there, back = (
        brdf.reflected(rough, Geometry(tensor(*UP), eye, light)) / light[2]
        for eye, light in ((one, other), (other, one))
    )
    torch.testing.assert_close(there, back, rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("dtype", [torch.float32, FLOAT])
@pytest.mark.parametrize("roughness", ROUGHNESSES)
def test_grazing_normal_and_opposite_directions_have_finite_values_and_gradients(roughness, dtype):
    degrees = (90.0, 45.0, 1e-3, 0.0, -1e-3, -45.0, -90.0)
    eye, light = (
        one.to(dtype).requires_grad_()
        for one in (
            seen_at(*degrees)[:, None].expand(7, 7, 3),
            from_angles(*torch.meshgrid(tensor(*degrees).deg2rad(), tensor(0.0, math.pi, 1.0), indexing="ij")).reshape(
                1, 21, 3
            )[:, :7],
        )
    )
    base, rough = torch.full((3,), 0.6, dtype=dtype, requires_grad=True), number(roughness, dtype).requires_grad_()
    given = material(base, rough, number(0.5, dtype))
    sky = EvenSky(number(0.5, dtype).expand(3), number(0.2, dtype).expand(3))
    geometry = Geometry(tensor(*UP, dtype=dtype), eye, light)
    drawn = brdf.reflected(given, geometry) + brdf.reflected_sky(given, geometry, sky)
    slopes = torch.autograd.grad(drawn.sum(), (eye, light, base, rough))
    assert drawn.isfinite().all()
    assert drawn.min() >= 0.0
    assert all(slope.isfinite().all() for slope in slopes)


def test_a_light_below_the_surface_lights_nothing():
    below = Geometry(tensor(*UP), seen_at(40.0)[0], seen_at(-1e-6, -30.0))
    given = material(tensor(0.5, 0.5, 0.5), number(0.4), number(0.0))
    assert torch.equal(brdf.reflected(given, below), torch.zeros(2, 3, dtype=FLOAT))
