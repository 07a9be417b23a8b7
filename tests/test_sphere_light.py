import math
from dataclasses import replace

import pytest
import torch

from diffrender.numerics import gauss_legendre
from diffrender.parameters import defaults
from diffrender.rays import from_angles
from diffrender.shading import brdf, light_bending, microfacet, risen_sphere, sphere_light
from diffrender.shading.brdf import Geometry
from diffrender.shading.sphere_light_reference import summed
from diffrender.shading.sphere_surface import SphereLight, SphereView, example_inputs

FLOAT = torch.float64
UP = torch.tensor([0.0, 0.0, 1.0], dtype=FLOAT)
STEPS = {
    "karis": light_bending.no_step,
    "talk": light_bending.talk_step,
    "guarded": light_bending.guarded_step,
}


def number(value, dtype=FLOAT):
    return torch.tensor(value, dtype=dtype)


def toward(*components):
    return torch.nn.functional.normalize(number(components), dim=-1)


def seen_at(elevation, azimuth=0.0):
    return from_angles(number(math.radians(elevation)), number(math.radians(azimuth)))


def lamp(radius, radiance=1.0):
    return SphereLight(number(radius), number(radiance).expand(3))


def surface(to_light, to_eye, roughness, distance=2.0, metallic=1.0):
    """White, seen from somewhere, with the light so far away."""
    white, metal = torch.ones(3, dtype=FLOAT), number(metallic)
    return SphereView(-distance * to_light, UP, to_eye, white, number(roughness), metal, torch.zeros(3, dtype=FLOAT))


def facing_square(geometry, sine, step):
    """(N·H)² of the point that a step leads to."""
    half = light_bending.bent(geometry, sine, step) + geometry.to_eye
    return (half * geometry.normal).sum(-1).square() / half.square().sum(-1)


def scattered(count, sine):
    """Eyes and lights of all directions, the lights above the horizon as a whole."""
    draw = torch.Generator().manual_seed(1)
    eye, light = (
        torch.nn.functional.normalize(torch.randn(count, 3, generator=draw, dtype=FLOAT), dim=-1) for _ in "el"
    )
    eye[:, 2], light[:, 2] = eye[:, 2].abs(), light[:, 2].abs()
    kept = light[:, 2] > sine
    return Geometry(UP, eye[kept], light[kept])


# Bending


# Of scalar arithmetic by the published polynomial's coefficients, made apart from this code.
@pytest.mark.parametrize(
    ("eye", "light", "sine", "found"),
    [
        ((0.6, 0.1, 0.5), (-0.5, 0.3, 0.6), 0.1, (0.914245124, 0.916245065, 0.916244889)),
        ((0.9, 0.0, 0.2), (-0.8, 0.35, 0.25), 0.05, (0.662133368, 0.681434043, 0.681503744)),
        ((0.3, 0.2, 0.9), (0.1, -0.6, 0.7), 0.3, (0.967332008, 0.967336782, 0.967336782)),
    ],
)
def test_steps_lead_where_the_published_polynomial_does(eye, light, sine, found):
    geometry = Geometry(UP, toward(*eye), toward(*light))
    here = [float(facing_square(geometry, number(sine), step)) for step in STEPS.values()]
    assert here == pytest.approx(found, abs=1e-9)


@pytest.mark.parametrize("sine", [0.0047, 0.2, 0.9])
def test_the_guarded_step_never_loses_to_karis_and_its_guard_is_never_needed(sine):
    geometry = scattered(20_000, sine)
    karis, guarded = (facing_square(geometry, number(sine), STEPS[name]) for name in ("karis", "guarded"))
    assert (guarded - karis).min() > -1e-12
    seconds = []

    def noted(slopes):
        seconds.append(slopes.second)
        return light_bending.guarded_step(slopes)

    direction = light_bending.bent(geometry, number(sine), noted)
    on_edge = (direction * geometry.to_light).sum(-1) < math.sqrt(1.0 - sine * sine) + 1e-9
    assert seconds[0][on_edge].max() < -1.99 * sine
    assert on_edge.sum() > 500


def test_the_talks_step_goes_astray_where_karis_does_not():
    geometry = scattered(20_000, 0.2)
    karis, talk = (facing_square(geometry, number(0.2), STEPS[name]) for name in ("karis", "talk"))
    assert (talk < karis - 0.1).any()
    assert (talk < karis - 1e-9).double().mean() < 0.04


@pytest.mark.parametrize("step", STEPS.values(), ids=STEPS)
def test_the_point_is_a_unit_vector_on_the_sphere_or_the_mirrors_direction(step):
    geometry = scattered(2_000, 0.3)
    direction = light_bending.bent(geometry, number(0.3), step)
    torch.testing.assert_close(direction.norm(dim=-1), torch.ones(len(direction), dtype=FLOAT))
    assert (direction * geometry.to_light).sum(-1).min() > math.sqrt(1.0 - 0.09) - 1e-12


def test_value_and_slope_are_continuous_where_the_mirrors_direction_enters_the_sphere():
    edge = 40.0 + math.degrees(math.asin(0.15))
    found = {}
    for side in (-1e-6, 1e-6):
        degrees = number(edge + side).requires_grad_()
        view = surface(seen_at(40.0), from_angles(degrees.deg2rad(), number(math.pi)), 0.3)
        value = sphere_light.render(lamp(0.3), view)[0]
        found[side] = value.detach(), torch.autograd.grad(value, degrees)[0]
    (below, slope_below), (above, slope_above) = found.values()
    torch.testing.assert_close(below, above, rtol=1e-6, atol=0.0)
    torch.testing.assert_close(slope_below, slope_above, rtol=1e-4, atol=1e-6)


# Brightness


@pytest.mark.parametrize("roughness", [0.02, 0.3, 0.7])
@pytest.mark.parametrize("sine", [0.01, 0.3, 0.9])
def test_mean_of_facets_over_the_sphere_is_exact_along_the_normal(roughness, sine):
    over = sphere_light.sphere_over(lamp(sine), surface(UP, UP, roughness, distance=1.0))
    # Evenly in the height of the direction over the equator is evenly in solid angle; finest in the middle.
    place, weight = gauss_legendre(400)
    depth, scale = 1.0 - math.sqrt(1.0 - sine * sine), 4.0 * float(over.spread)
    high = math.log1p(depth / scale)
    down = scale * torch.expm1(0.5 * high * (1.0 + place))
    step = scale * torch.exp(0.5 * high * (1.0 + place)) * 0.5 * high * weight
    light = torch.stack([torch.sqrt(down * (2.0 - down)), torch.zeros_like(down), 1.0 - down], -1)
    mean = (microfacet.ggx(light + UP, UP, over.spread) * step).sum() / depth
    torch.testing.assert_close(sphere_light.mean_facets(over), mean, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("elevation", [10.0, 40.0, 90.0])
def test_a_mirror_shows_the_sphere_as_bright_as_it_is(elevation):
    view = surface(seen_at(elevation), seen_at(elevation, 180.0), 0.0)
    torch.testing.assert_close(sphere_light.render(lamp(0.3, 7.0), view), number(7.0).expand(3), rtol=1e-3, atol=0.0)


@pytest.mark.parametrize("rung", list(sphere_light.EFFECT.rungs)[1:])
def test_a_small_light_is_a_point(rung):
    view = surface(seen_at(50.0), seen_at(30.0, 150.0), 0.6, metallic=0.3)
    given = brdf.material(view.base, view.roughness, view.metallic)
    point = brdf.reflected(given, Geometry(UP, view.to_eye, seen_at(50.0))) * math.pi * (1e-3 / 2.0) ** 2
    torch.testing.assert_close(sphere_light.EFFECT.rungs[rung](lamp(1e-3), view), point, rtol=5e-3, atol=0.0)


@pytest.mark.parametrize("sine", [0.01, 0.15, 0.5])
def test_cosine_of_a_rising_sphere_is_that_of_what_is_above(sine):
    place, weight = gauss_legendre(200)
    off = 0.5 * math.asin(sine) * (1.0 + place)
    turn = (torch.arange(400, dtype=FLOAT) + 0.5) * (2.0 * math.pi / 400)
    for height in (-1.0, -0.9, -0.4, 0.0, 0.4, 0.9, 1.0, 1.5):
        rise = math.asin(height * sine)
        cosine = torch.cos(off)[:, None] * math.sin(rise) + torch.sin(off)[:, None] * math.cos(rise) * torch.cos(turn)
        summed_up = (cosine.clamp(min=0.0).mean(-1) * torch.sin(off) * weight).sum() * math.pi * math.asin(sine)
        found = float(risen_sphere.mean_cosine(number(height * sine), number(sine))) * math.pi * sine * sine
        assert found == pytest.approx(float(summed_up), rel=1e-3, abs=3e-6 * sine**3)


@pytest.mark.parametrize("dtype", [torch.float32, FLOAT])
def test_mean_cosine_of_a_small_sphere_is_that_of_a_disc_and_ends_without_a_kink(dtype):
    sine = number(1e-5, dtype)
    place = number([-1.0, -0.999, -0.5, 0.0, 0.5, 0.999, 1.0], dtype).requires_grad_()
    found = risen_sphere.mean_cosine(place * sine, sine) / sine
    p = place.detach().double()
    edge = torch.sqrt(1.0 - p * p)
    torch.testing.assert_close(
        found.double(), (p * torch.acos(-p) + edge * (2.0 + p * p) / 3.0) / math.pi, rtol=1e-5, atol=1e-6
    )
    (slope,) = torch.autograd.grad(found.sum(), place)
    share = (torch.acos(-p) + p * edge) / math.pi  # of the disc that is above
    torch.testing.assert_close(slope[1:].double(), share[1:], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("sine", [0.003, 0.6])
def test_facets_of_a_whole_sphere_are_ggx_summed_over_it(sine):
    draw = torch.Generator().manual_seed(4)
    height, eye_height, turn, roughness = torch.rand(4, 60, generator=draw, dtype=FLOAT)
    light = from_angles(torch.asin(sine + (1.0 - sine) * height), 0.0 * turn)
    eye = from_angles(torch.asin(0.02 + 0.98 * eye_height), 2.0 * math.pi * turn)
    shape = {"base": torch.ones(3, dtype=FLOAT), "roughness": roughness, "metallic": torch.ones(60, dtype=FLOAT)}
    view = SphereView(-light, UP.expand(60, 3), eye, **shape, centre=torch.zeros(3, dtype=FLOAT))

    def never_hidden(cos_eye, cos_light, spread_square):
        return torch.ones_like(cos_eye + cos_light + spread_square)

    found = sphere_light.render(lamp(sine), view, never_hidden)
    torch.testing.assert_close(found, summed(lamp(sine), view, (48, 96), never_hidden), rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("roughness", [0.05, 0.3, 0.8])
def test_a_sphere_sets_without_a_jump_and_is_gone_when_it_has(roughness):
    touching = math.degrees(math.asin(0.15))

    def at(degrees):
        return sphere_light.render(lamp(0.3), surface(seen_at(degrees), seen_at(20.0, 170.0), roughness, metallic=0.5))

    torch.testing.assert_close(at(touching - 1e-6), at(touching + 1e-6), rtol=1e-5, atol=0.0)
    nearly, gone = at(0.02 - touching), at(-1e-6 - touching)
    assert 0.0 < nearly.max() < 1e-3 * at(touching).max()
    assert not gone.any()


@pytest.mark.parametrize("rung", ["Karis' point", "guarded step", "smaller when rough"])
def test_the_older_ways_go_dark_as_the_centre_sets_and_the_last_as_all_does(rung):
    eye = seen_at(20.0, 170.0)
    half, whole = (surface(seen_at(degrees), eye, 0.4, metallic=0.0) for degrees in (0.0, -9.0))
    assert not sphere_light.EFFECT.rungs[rung](lamp(0.3), half).any()
    assert (sphere_light.render(lamp(0.3), half) > 0.0).all()
    assert not sphere_light.render(lamp(0.3), whole).any()


@pytest.mark.parametrize("eye", [8.0, 20.0])
def test_a_large_cut_sphere_is_not_stretched_over_the_horizon_on_rough_metal(eye):
    view = surface(seen_at(10.0), seen_at(eye, 175.0), 1.0, distance=1.0)
    found, truth = sphere_light.render(lamp(0.5), view), summed(lamp(0.5), view, (48, 96))
    torch.testing.assert_close(found, truth, rtol=0.3, atol=0.0)  # 2.2 with all of the stretch


# Reference


def test_the_reference_is_the_plain_sum_over_the_disc_on_a_rough_surface():
    centre, axes = seen_at(20.0), (seen_at(110.0), seen_at(0.0, 90.0))
    view = surface(centre, seen_at(35.0, 140.0), 0.7, metallic=0.5)
    sine, rings, turns = 0.5, 400, 400
    cosine = 1.0 - (1.0 - math.sqrt(1.0 - sine**2)) * (torch.arange(rings, dtype=FLOAT) + 0.5) / rings
    turn = (torch.arange(turns, dtype=FLOAT) + 0.5) * (2.0 * math.pi / turns)
    aside = torch.cos(turn)[:, None] * axes[0] + torch.sin(turn)[:, None] * axes[1]
    direction = cosine[:, None, None] * centre + torch.sqrt(1.0 - cosine**2)[:, None, None] * aside
    given = brdf.material(view.base, view.roughness, view.metallic)
    mean = brdf.reflected(given, Geometry(UP, view.to_eye, direction)).mean((0, 1))
    plain = mean * 2.0 * math.pi * (1.0 - math.sqrt(1.0 - sine**2))
    torch.testing.assert_close(summed(lamp(1.0), view), plain, rtol=1e-4, atol=0.0)


def test_the_reference_is_converged_on_the_examples():
    light, seen = defaults(SphereLight, FLOAT), example_inputs(FLOAT)
    found, finer = summed(light, seen, (48, 96)), summed(light, seen, (96, 192))
    torch.testing.assert_close(found, finer, rtol=1e-4, atol=0.0)


# Delicate points


@pytest.mark.parametrize("rung", list(sphere_light.EFFECT.rungs)[1:])
@pytest.mark.parametrize("roughness", [0.0, 0.02, 1.0])
def test_hard_places_have_finite_values_and_gradients_that_float32_follows(rung, roughness):
    heights, turns = number([90.0, 30.0, 8.63, 8.62, 1e-3, 0.0, -4.0]), (180.0, 179.0, 90.0, 0.0)
    grid = torch.meshgrid(
        heights, number([90.0, 30.0, 8.0, 1.0, 1e-3]), number(turns), number([2.0, 0.2]), indexing="ij"
    )
    light, eye, turn, distance = (axis.reshape(-1) for axis in grid)
    single = [from_angles(up.deg2rad(), around.deg2rad()).float() for up, around in ((light, 0.0 * light), (eye, turn))]
    found = []
    for dtype in (torch.float32, FLOAT):
        given = {
            "position": -distance.to(dtype)[:, None] * single[0].to(dtype),
            "normal": UP.to(dtype).expand(len(light), 3).clone(),
            "to_eye": single[1].to(dtype),
            "base": number(0.8, dtype).expand(3).clone(),
            "roughness": number(roughness, dtype),
            "metallic": number(0.5, dtype),
            "centre": torch.zeros(3, dtype=dtype),
        }
        given = {name: value.requires_grad_() for name, value in given.items()}
        drawn = sphere_light.EFFECT.rungs[rung](defaults(SphereLight, dtype), SphereView(**given))
        slopes = torch.autograd.grad(drawn.sum(), list(given.values()))
        assert all(slope.isfinite().all() for slope in slopes)
        assert drawn.min() >= 0.0
        # Eye and light nearly opposite have no direction half-way in float32.
        found.append(drawn.detach().double()[eye > 0.1])
    torch.testing.assert_close(found[0], found[1], rtol=1e-3, atol=1e-3 * float(found[1].max()))


def test_gradients_of_the_surface_match_finite_differences():
    seen = example_inputs(FLOAT)
    kept = torch.tensor([4, 5, 6, 7, 8, 9, 11, 12, 14, 17])  # not at the sphere's picture's edge or a clamp
    seen = SphereView(**{name: t[kept] if len(t) == 18 else t for name, t in vars(seen).items()})

    def draw(position, roughness, metallic, base, centre):
        changed = {"position": position, "roughness": roughness, "metallic": metallic, "base": base, "centre": centre}
        return sphere_light.render(defaults(SphereLight, FLOAT), replace(seen, **changed))

    given = [seen.position, seen.roughness * 0.9 + 0.05, seen.metallic * 0.9 + 0.05, seen.base, seen.centre]
    assert torch.autograd.gradcheck(draw, [one.clone().requires_grad_() for one in given], fast_mode=True)
