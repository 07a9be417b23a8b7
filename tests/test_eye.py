import math
from dataclasses import replace

import pytest
import torch

from diffrender.parameters import defaults
from diffrender.shading import brdf, eye
from diffrender.shading.eye_ball import CORNEA, Eye, EyeView, example_inputs, on_cornea, surface
from diffrender.surfaces import EvenSky, Lights, packed, unpacked
from experiments import eye_scene

FLOAT = torch.float64
WHITE_SKY = EvenSky(torch.ones(3, dtype=FLOAT), torch.zeros(3, dtype=FLOAT))
NO_LIGHTS = Lights(torch.zeros(0, 3, dtype=FLOAT), torch.zeros(0, 3, dtype=FLOAT), WHITE_SKY)


def number(value):
    return torch.tensor(value, dtype=FLOAT)


def of(**changed):
    given = defaults(Eye, FLOAT)
    found = {name: torch.as_tensor(value, dtype=FLOAT) for name, value in changed.items()}
    return replace(given, **{name: value.expand_as(getattr(given, name)) for name, value in found.items()})


def along_gaze(view):
    return replace(view, to_eye=view.gaze)


# What is seen of the iris


def test_the_iris_is_seen_where_a_ray_of_snells_law_meets_its_plane():
    view, given = example_inputs(FLOAT), of(iris_depth=0.1)
    met = eye.on_iris(given, view)[:6]  # the cornea's, of rays that are not too flat
    assert (met * view.gaze[:6]).sum(-1).abs().max() < 1e-12
    plane = math.sqrt(1.0 - 0.5**2) - 0.1
    inside = torch.nn.functional.normalize(view.place[:6] - met - plane * view.gaze[:6], dim=-1)
    normal, outside = view.normal[:6], view.to_eye[:6]
    sines = [torch.linalg.vector_norm(torch.linalg.cross(normal, one), dim=-1) for one in (inside, outside)]
    torch.testing.assert_close(given.refraction * sines[0], sines[1], rtol=1e-9, atol=1e-12)
    assert (torch.linalg.cross(inside, normal) * outside).sum(-1).abs().max() < 1e-12


def test_a_cornea_magnifies_the_iris_and_does_so_by_what_lenses_do():
    # A surface of radius r over water: an object at a depth d under its top looks 1 / (1 - (n - 1) d / (n r)) as large.
    gaze = torch.tensor([0.0, 0.6, 0.8], dtype=FLOAT)
    beside = torch.nn.functional.normalize(gaze + torch.tensor([1e-4, 0.0, 0.0], dtype=FLOAT), dim=-1)
    place = on_cornea(beside[None], gaze, 0.5)
    shared = example_inputs(FLOAT)
    view = EyeView(surface(place, gaze, 0.5), gaze[None], place, gaze[None], shared.up[:1], shared.iris, shared.lights)
    given = of(iris_depth=0.08)
    top = math.sqrt(1.0 - 0.25) - math.sqrt(CORNEA**2 - 0.25) + CORNEA
    depth = top - (math.sqrt(1.0 - 0.25) - 0.08)
    index = float(given.refraction)
    larger = 1.0 / (1.0 - (index - 1.0) * depth / (index * CORNEA))
    met = torch.linalg.vector_norm(eye.on_iris(given, view))
    seen = torch.linalg.vector_norm(torch.linalg.cross(place, gaze[None]))
    torch.testing.assert_close(seen / met, number(larger), rtol=1e-6, atol=0.0)


def test_the_pupil_is_black_and_the_white_has_its_colour():
    view, given = along_gaze(example_inputs(FLOAT)), of()
    base = eye.deferred(given, view).base
    assert base[0].abs().max() == 0.0
    torch.testing.assert_close(base[11:], given.sclera_colour.expand(3, 3), rtol=1e-12, atol=0.0)


def test_a_bowl_brightens_the_side_away_from_the_light():
    drawn = eye_scene.picture_view(40, 40, (0.0, 0.0))
    to_light = torch.tensor([[-0.5, 0.8, 0.3]], dtype=FLOAT)
    light = Lights(to_light / to_light.norm(), torch.ones(1, 3, dtype=FLOAT), EvenSky(*[0.0 * WHITE_SKY.mean] * 2))
    even = replace(drawn, lights=light, iris=torch.ones(9, 65, dtype=FLOAT))
    far = torch.linalg.vector_norm(drawn.place[..., 1:], dim=-1)
    on_iris = (far > 0.25) & (far < 0.38)
    near, away = (on_iris & (side * drawn.place[..., 1] > 0.15) for side in (1.0, -1.0))

    def lit(bowl):
        given = of(iris_bowl=bowl)
        return brdf.lit(eye.deferred(given, even), even.to_eye, light)

    assert lit(0.8)[away].mean() > 1.3 * lit(0.8)[near].mean()
    assert lit(0.0)[away].mean() < 1.1 * lit(0.0)[near].mean()


# Energy and passes


@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
def test_a_white_eye_sends_no_more_of_an_even_sky_than_it_gets(roughness):
    view = eye_scene.picture_view(32, 32)
    view = replace(view, lights=NO_LIGHTS, iris=torch.ones(9, 65, dtype=FLOAT))
    white = {"iris_colour": 1.0, "sclera_colour": 1.0, "wet_roughness": roughness}
    for bowl in (0.0, 1.0):
        sent = eye.render(of(**white, iris_bowl=bowl), view)
        assert sent.max() <= 1.0
        assert sent.max() > 0.8


def test_light_from_behind_lights_nothing():
    view = example_inputs(FLOAT)
    view = replace(view, place=view.place[:9], normal=view.normal[:9], to_eye=view.to_eye[:9], gaze=view.gaze[:9],
                   up=view.up[:9])  # fmt: skip
    dark = replace(view, lights=replace(view.lights, irradiance=0.0 * view.lights.irradiance))
    behind = replace(view, lights=replace(view.lights, to_light=-view.gaze[:2]))
    torch.testing.assert_close(eye.skip(of(), behind), eye.skip(of(), dark), rtol=1e-12, atol=0.0)
    torch.testing.assert_close(eye.render(of(), behind), eye.render(of(), dark), rtol=1e-12, atol=0.0)


def test_the_g_buffer_costs_less_than_a_fiftieth_of_the_picture():
    view = eye_scene.picture_view(48, 32)
    kept = unpacked(packed(eye.deferred(of(), view)), FLOAT)
    drawn = eye.forward(of(), view, brdf.lit(kept, view.to_eye, view.lights))
    whole = eye.render(of(), view)
    assert 0.0 < (drawn - whole).abs().max() < 2e-2 * whole.mean()


@pytest.mark.parametrize("roughness", [0.0, 1.0])
def test_the_very_middle_and_the_axis_have_finite_gradients(roughness):
    gaze = torch.tensor([[0.0, 0.0, 1.0]], dtype=FLOAT)
    place = on_cornea(gaze, gaze, 0.5).requires_grad_()
    given = of(wet_roughness=roughness)
    leaves = [one.requires_grad_() for one in vars(given).values()]
    shared = example_inputs(FLOAT)
    up = torch.tensor([[1.0, 0.0, 0.0]], dtype=FLOAT)
    view = EyeView(surface(place, gaze, 0.5), gaze, place, gaze, up, shared.iris, shared.lights)
    drawn = eye.render(Eye(*leaves), view)
    assert drawn.isfinite().all()
    assert all(slope.isfinite().all() for slope in torch.autograd.grad(drawn.sum(), [place, *leaves]))
