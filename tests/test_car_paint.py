import math
from dataclasses import replace

import pytest
import torch

from diffrender.parameters import defaults
from diffrender.rays import from_angles
from diffrender.shading import car_paint, clear_coat, flakes
from diffrender.shading.brdf import Geometry
from diffrender.shading.microfacet import fresnel_exact
from diffrender.shading.painted_surface import CarPaint, CarPaintView, example_inputs
from diffrender.surfaces import EvenSky, Lights, packed, unpacked
from experiments import car_paint_scene

FLOAT = torch.float64
UP = torch.tensor([0.0, 0.0, 1.0], dtype=FLOAT)
NO_SKY = EvenSky(torch.zeros(3, dtype=FLOAT), torch.zeros(3, dtype=FLOAT))
WHITE_SKY = EvenSky(torch.ones(3, dtype=FLOAT), torch.zeros(3, dtype=FLOAT))
NO_LIGHTS = Lights(torch.zeros(0, 3, dtype=FLOAT), torch.zeros(0, 3, dtype=FLOAT), WHITE_SKY)
FACTORS = {"flake_spread": (0.08, 0.2, 0.5), "coat_roughness": (0.0, 0.3, 1.0), "flake_amount": (0.0, 0.5, 1.0)}


def number(value):
    return torch.tensor(value, dtype=FLOAT)


def paint(**changed):
    given = defaults(CarPaint, FLOAT)
    found = {name: torch.as_tensor(value, dtype=FLOAT) for name, value in changed.items()}
    return replace(given, **{name: value.expand_as(getattr(given, name)) for name, value in found.items()})


def white(**changed):
    return paint(**{"base": 1.0, "flake_colour": 1.0, "coat_depth": 0.0} | changed)


def level(to_eye, lights, footprint=1.0):
    """Level paint, seen from so far away that its flakes are even."""
    count = to_eye.shape[:-1]
    place = torch.arange(math.prod(count), dtype=FLOAT).reshape(count)
    along = torch.tensor([1.0, 0.0, 0.0], dtype=FLOAT)
    return CarPaintView(
        UP.expand_as(to_eye), to_eye, along.expand_as(to_eye), torch.stack([0.0137 * place, 0.0291 * place], -1),
        number(footprint).expand(count), lights,
    )  # fmt: skip


def at(*degrees):
    return from_angles(torch.tensor(degrees, dtype=FLOAT).deg2rad(), torch.zeros(len(degrees), dtype=FLOAT))


def one_light(to_light):
    return Lights(to_light[None], torch.ones(1, 3, dtype=FLOAT), NO_SKY)


# Energy


@pytest.mark.parametrize("roughness", FACTORS["coat_roughness"])
def test_white_paint_sends_no_more_of_an_even_sky_than_it_gets(roughness):
    eye = at(-1.0, 0.0, 0.5, 3.0, 10.0, 30.0, 60.0, 90.0)
    most = 0.0
    for spread in FACTORS["flake_spread"]:
        for amount in FACTORS["flake_amount"]:
            given = white(flake_spread=spread, flake_amount=amount, coat_roughness=roughness)
            sent = car_paint.render(given, level(eye, NO_LIGHTS))
            most = max(most, float(sent.max()))
            assert sent.min() > 0.15
    assert most <= 1.0
    bare = car_paint.render(white(flake_amount=0.0, coat_roughness=roughness), level(at(90.0), NO_LIGHTS))
    assert 0.84 < bare.min() < 0.92  # as the module's docstring has it


def eyes(heights=60, turns=80):
    """Directions of the upper half, all of them with the same cosine times solid angle."""
    square, turn = ((torch.arange(count, dtype=FLOAT) + 0.5) / count for count in (heights, turns))
    return from_angles(*torch.meshgrid(torch.asin(square.sqrt()), 2.0 * math.pi * turn, indexing="ij")).reshape(-1, 3)


@pytest.mark.parametrize("elevation", [4.0, 25.0, 80.0])
def test_what_is_sent_of_one_light_is_what_an_even_sky_sends_to_its_place(elevation):
    light = at(elevation)[0]
    for spread in (0.15, 0.5):
        given = white(flake_spread=spread, coat_roughness=0.6)
        sent = car_paint.render_smooth(given, level(eyes(), one_light(light))).mean(0) * math.pi / light[2]
        there = car_paint.render_smooth(given, level(light[None], NO_LIGHTS))[0]
        assert sent.max() <= 1.0
        # The base coat's shine is dimmed by the mean that crosses to its ground.
        torch.testing.assert_close(sent, there, rtol=0.0, atol=1.5e-2)


def test_light_and_eye_may_be_exchanged():
    one, other = at(20.0)[0], from_angles(number(0.9), number(2.0))
    given = paint(flake_amount=0.7)
    for footprint in (1e-4, 1e-2):
        there, back = (
            car_paint.render(given, level(eye[None], one_light(light), footprint)) / light[2]
            for eye, light in ((one, other), (other, one))
        )
        torch.testing.assert_close(there, back, rtol=1e-9, atol=0.0)


# The clear coat


def test_directions_are_bent_by_snells_law_in_their_own_plane():
    outside = from_angles(torch.linspace(0.0, 1.57, 20, dtype=FLOAT), torch.linspace(0.0, 5.0, 20, dtype=FLOAT))
    inside = clear_coat.refracted(1.5, UP, outside)
    torch.testing.assert_close(1.5 * inside[:, :2], outside[:, :2], rtol=1e-12, atol=1e-15)
    torch.testing.assert_close(torch.linalg.vector_norm(inside, dim=-1), torch.ones(20, dtype=FLOAT))
    assert inside[:, 2].min() > 0.745


def test_a_smooth_coat_mirrors_and_lets_through_what_fresnel_says():
    cosine = torch.linspace(0.1, 1.0, 30, dtype=FLOAT)
    exact = fresnel_exact(1.5, cosine)
    torch.testing.assert_close(1.0 - clear_coat.crossed(1.5, number(0.0), cosine), exact, rtol=0.0, atol=1e-3)
    sky = EvenSky(torch.full((3,), 0.5, dtype=FLOAT), torch.full((3,), 0.5, dtype=FLOAT))
    eye = at(*torch.asin(cosine).rad2deg().tolist())
    seen = clear_coat.mirrored_sky(1.5, number(0.0), Geometry(UP.expand_as(eye), eye, eye), sky)[:, 0]
    torch.testing.assert_close(seen, exact * 0.5 * (1.0 + cosine), rtol=0.0, atol=6e-4)


def test_a_deep_coat_leaves_its_surface_alone_and_colours_what_is_below():
    seen = level(at(50.0), Lights(at(60.0), torch.ones(1, 3, dtype=FLOAT), WHITE_SKY))
    deep = car_paint.render(paint(coat_depth=[0.0, 1.0, 1e3]), seen)[0]
    clear = car_paint.render(paint(coat_depth=0.0), seen)[0]
    surface = car_paint.coat(paint(), seen)[0]
    assert deep[0] == clear[0]
    assert surface[1] < deep[1] < clear[1]
    torch.testing.assert_close(deep[2], surface[2], rtol=1e-12, atol=0.0)


# Flakes


def of_places(count, footprint, spread=0.2):
    place = 1000.0 * max(footprint, 1.0) * torch.rand(count, 2, dtype=FLOAT, generator=torch.Generator().manual_seed(0))
    slope = torch.tensor([0.05, -0.1], dtype=FLOAT).expand(count, 2)
    found = flakes.counted(slope, number(spread), place, number(footprint).expand(count))
    return found / flakes.even(slope, number(spread))


@pytest.mark.parametrize("flakes_wide", [0.0, 1.0, 4.0, 64.0])
def test_counted_flakes_have_the_mean_of_even_ones_and_the_deviation_of_their_number(flakes_wide):
    found = of_places(400_000, flakes_wide)
    single = of_places(400_000, 1.0).std()
    assert found.min() >= 0.0
    assert abs(found.mean() - 1.0) < 4.0 * found.std() / math.sqrt(len(found))
    assert found.std() == pytest.approx(float(single) / max(flakes_wide, 1.0), rel=0.03)


@pytest.mark.parametrize("flakes_wide", [1.0, 2.0, 8.0])
def test_no_glint_pops_where_cells_grow(flakes_wide):
    before, after = (of_places(1000, flakes_wide * (1.0 + side * 1e-9)) for side in (-1.0, 1.0))
    torch.testing.assert_close(before, after, rtol=1e-6, atol=1e-6)


def test_flakes_slopes_are_gaussian_and_of_every_cell_their_own():
    cells = torch.stack(torch.meshgrid(torch.arange(-200, 200), torch.arange(-200, 200), indexing="ij"), -1)
    slope = flakes.drawn(number(0.2), cells, torch.zeros(400, 400, dtype=FLOAT)).reshape(-1, 2)
    assert len(slope.unique(dim=0)) > 0.999 * len(slope)
    square = 0.5 * (0.2**2 - flakes.WAVY**2)
    torch.testing.assert_close(slope.T.cov(), square * torch.eye(2, dtype=FLOAT), rtol=0.0, atol=0.02 * square)
    neighbours = slope.reshape(400, 400, 2)
    correlation = (neighbours[1:] * neighbours[:-1]).mean() / square
    assert abs(correlation) < 0.01


def test_a_pixel_that_moves_within_its_cell_sees_the_same_glints():
    place = torch.tensor([[100.2, 50.3]], dtype=FLOAT)
    moved = place + torch.tensor([[0.3, 0.3]], dtype=FLOAT)
    slope, width = torch.zeros(1, 2, dtype=FLOAT), torch.ones(1, dtype=FLOAT)
    assert flakes.counted(slope, number(0.2), place, width) == flakes.counted(slope, number(0.2), moved, width)


# Passes and delicate points


def test_the_g_buffer_costs_less_than_a_hundredth_of_the_picture():
    seen = car_paint_scene.picture_view(48, 32)
    kept = unpacked(packed(car_paint.deferred(paint(), seen)), FLOAT)
    lit = car_paint.brdf.lit(kept, seen.to_eye, seen.lights)
    drawn, whole = car_paint.forward(paint(), seen, lit), car_paint.render(paint(), seen)
    assert 0.0 < ((drawn - whole).abs() / whole).max() < 1e-2


@pytest.mark.parametrize("dtype", [torch.float32, FLOAT])
@pytest.mark.parametrize("roughness", [0.0, 1.0])
def test_grazing_mirrored_and_set_lights_have_finite_values_and_gradients(roughness, dtype):
    eye = at(90.0, 45.0, 1e-3, 0.0, -1e-3, -45.0)
    towards = torch.cat([at(90.0, 1e-3, 0.0, -1e-3, -60.0), at(45.0) * torch.tensor([-1.0, 1.0, 1.0])])
    seen = level(eye, Lights(towards, torch.ones(6, 3, dtype=FLOAT), WHITE_SKY), 2e-3)
    leaves = [one.to(dtype).requires_grad_() for one in (eye, towards, *vars(paint(coat_roughness=roughness)).values())]
    fields = {name: value.to(dtype) for name, value in vars(seen).items() if isinstance(value, torch.Tensor)}
    sky = EvenSky(*(one.to(dtype) for one in vars(WHITE_SKY).values()))
    lights = Lights(leaves[1], torch.ones(6, 3, dtype=dtype), sky)
    drawn = car_paint.render(CarPaint(*leaves[2:]), CarPaintView(**fields | {"to_eye": leaves[0], "lights": lights}))
    assert drawn.isfinite().all()
    assert all(slope.isfinite().all() for slope in torch.autograd.grad(drawn.sum(), leaves))


def test_a_light_below_the_surface_changes_nothing():
    seen = example_inputs(FLOAT)
    dark = replace(seen, lights=replace(seen.lights, irradiance=0.0 * seen.lights.irradiance))
    below = replace(seen, lights=replace(seen.lights, to_light=-seen.normal[:2]))
    assert torch.equal(car_paint.render(paint(), below), car_paint.render(paint(), dark))
