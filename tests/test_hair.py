import math
from dataclasses import replace

import pytest
import torch
from torch.utils import _pytree as pytree

from diffrender.numerics import gauss_legendre
from diffrender.parameters import defaults, specifications
from diffrender.rays import from_angles
from diffrender.sampling import fibonacci
from diffrender.shading import hair, hair_fibre
from diffrender.shading.hair_fibre import Round
from diffrender.shading.hair_reference import traced
from diffrender.shading.hair_view import Hair, HairView, example_inputs
from diffrender.surfaces import EvenSky, Lights, packed, unpacked
from experiments.hair_scene import picture_view

FLOAT = torch.float64
BOUNDS = {name: one.bounds for name, one in specifications(Hair).items()}
TURNS = 400
ROUGHNESSES = [(m, n) for m in (0.05, 0.3, 1.0) for n in (0.1, 0.3, 1.0)]


def number(value):
    return torch.tensor(value, dtype=FLOAT)


def strands(colour=1.0, longitudinal=0.3, azimuthal=0.3, tilt=0.035):
    return Hair(number(colour).expand(3), number(longitudinal), number(azimuthal), number(tilt))


def eyes(*elevations):
    """Eyes at elevations in degrees over the plane across the strand, which stands upright."""
    up = number(elevations).deg2rad()
    return from_angles(up, torch.full_like(up, 0.3))


def seen(to_eye, to_light, sky=(0.0, 0.0)):
    """Upright strands in full light: irradiance 1 of each direction."""
    up = torch.tensor([0.0, 0.0, 1.0], dtype=FLOAT)
    mean, gradient = (number(value).expand(3) for value in sky)
    lights = Lights(to_light, torch.ones(len(to_light), 3, dtype=FLOAT), EvenSky(mean, gradient))
    return HairView(
        up, number((1.0, 0.0, 0.0)), to_eye, number(0.0), torch.ones(len(to_light), dtype=FLOAT), number(1.0), lights
    )


def of_light(made, eye, light):
    """Radiance of strands by one light alone, at angles along them and apart round them [rad]."""
    to_eye, to_light = from_angles(eye, torch.zeros_like(eye)), from_angles(light[0], light[1])
    return hair.render(made, seen(to_eye, to_light[None]))


def over_the_sphere(made, eye_angle):
    """Integral over all lights of radiance per irradiance, by a rule that resolves every lobe."""
    middles = hair_fibre.mirror_angles(eye_angle, made.tilt)
    node, weight = gauss_legendre(400)
    angle = 0.5 * math.pi * node
    density = hair_fibre.along(angle[:, None], middles, hair_fibre.variances(made))
    whole = (density * (0.5 * math.pi * weight * torch.cos(angle))[:, None, None]).sum(0)
    turn = ((torch.arange(TURNS, dtype=FLOAT) + 0.5) * (2.0 * math.pi / TURNS))[:, None]
    found = hair_fibre.ways(torch.cos(eye_angle), hair_fibre.absorption(made))
    scale = hair_fibre.azimuthal_scale(made)
    by_turn = hair_fibre.around(found, Round(turn, number(1.0)), scale).sum(0)
    return (whole[..., None] * by_turn * (2.0 * math.pi / TURNS)).sum(-2)


@pytest.mark.parametrize(("longitudinal", "azimuthal"), [(0.05, 0.1), (0.3, 0.3), (1.0, 1.0), (1.0, 0.1)])
@pytest.mark.parametrize("tilt", [0.0, 0.17])
def test_white_strands_send_on_all_that_they_get(longitudinal, azimuthal, tilt):
    found = over_the_sphere(strands(1.0, longitudinal, azimuthal, tilt), number([0.0, 0.6, -1.3, 1.5]))
    torch.testing.assert_close(found, torch.ones_like(found), rtol=2e-5, atol=0.0)


def test_coloured_strands_send_on_less_than_white_ones_and_all_strands_no_more_than_they_get():
    angle = torch.linspace(-1.5, 1.5, 7, dtype=FLOAT)
    for longitudinal, azimuthal in ((0.1, 0.1), (0.3, 1.0), (1.0, 0.3)):
        dark, white = (over_the_sphere(strands(c, longitudinal, azimuthal), angle) for c in (0.05, 1.0))
        assert (dark < white).all()
        assert (white <= 1.0 + 2e-5).all()


@pytest.mark.parametrize(("longitudinal", "azimuthal"), ROUGHNESSES)
@pytest.mark.parametrize("tilt", BOUNDS["tilt"])
def test_under_an_even_sky_white_strands_are_as_bright_as_it_whatever_their_roughness(longitudinal, azimuthal, tilt):
    nowhere = torch.zeros(1, 3, dtype=FLOAT)
    view = seen(eyes(-90.0, -60.0, 0.0, 30.0, 89.0), nowhere, sky=(1.0, 0.0))
    view = replace(view, reaching=torch.zeros(1, dtype=FLOAT))
    drawn = hair.render(strands(1.0, longitudinal, azimuthal, tilt), view)
    torch.testing.assert_close(drawn, torch.ones_like(drawn), rtol=1e-12, atol=0.0)


def test_the_sky_is_the_sum_of_lights_from_all_directions():
    to_light = fibonacci(20_000)
    made = replace(strands(0.5, 0.5, 0.4), colour=number((0.9, 0.5, 0.2)))
    eye = eyes(-50.0, 0.0, 25.0)
    lights = seen(eye[:, None], to_light[:1])
    rising = (0.7 + 0.5 * to_light[:, 2:]) * (4.0 * math.pi / len(to_light))
    summed = torch.zeros(3, 3, dtype=FLOAT)
    angle = hair.angle(lights.tangent, eye)
    drawn = hair.strand(made, lights, angle)
    for place, one in enumerate(eye):
        along = hair_fibre.along(hair.angle(lights.tangent, to_light).along, drawn.mirror_angle[place], drawn.variance)
        ways = hair_fibre.ways(angle.cosine[place], hair_fibre.absorption(made))
        round_ = Round(hair.azimuth(replace(lights, to_eye=one), to_light), number(1.0))
        summed[place] = ((along[..., None] * hair_fibre.around(ways, round_, drawn.scale)).sum(-2) * rising).sum(0)
    shown = hair.render(made, replace(seen(eye, to_light[:1], sky=(0.7, 0.5)), reaching=torch.zeros(1, dtype=FLOAT)))
    torch.testing.assert_close(shown, summed, rtol=2e-3, atol=0.0)


@pytest.mark.parametrize(("name", "bound"), [(name, side) for name in BOUNDS for side in (0, 1)])
def test_renderer_reaches_rays_at_the_bounds(name, bound):
    view, chosen = example_inputs(FLOAT), [1, 2, 5, 8]
    count = len(view.tangent)
    view = pytree.tree_map_only(torch.Tensor, lambda one: one[chosen] if len(one) == count else one, view)
    value = number(BOUNDS[name][bound])
    made = replace(defaults(Hair, FLOAT), **{name: value.expand(3) if name == "colour" else value})
    truth = traced(made, view, rays=768)
    # The second is straight against a light, where the strand's last segments hold nearly all.
    allowed = number([2e-3, 1.2e-2, 2e-3, 2e-3])
    assert ((hair.render(made, view) - truth).abs().amax(-1) <= allowed * truth.max()).all()


def test_eye_and_light_may_be_exchanged_where_they_are_equally_steep_and_scales_lie_flat():
    made, angle = strands(0.4, tilt=0.0), number([0.2, 0.7, 1.2])
    turn = number([0.5, 2.0, 3.0])
    for side in (1.0, -1.0):
        one = torch.stack([of_light(made, a, (side * a, t)) for a, t in zip(angle, turn, strict=True)])
        other = torch.stack([of_light(made, side * a, (a, t)) for a, t in zip(angle, turn, strict=True)])
        torch.testing.assert_close(one, other, rtol=1e-12, atol=0.0)


def test_scales_move_the_white_highlight_to_the_root_and_the_coloured_to_the_tip():
    made = strands(0.5, longitudinal=0.05, tilt=0.05)
    middles = hair_fibre.mirror_angles(number([0.1]), made.tilt)[0]
    light = torch.linspace(-1.0, 1.0, 4001, dtype=FLOAT)
    found = hair_fibre.along(light, middles, hair_fibre.variances(made))
    mean = (found * light[:, None]).sum(0) / found.sum(0) + 0.1
    torch.testing.assert_close(mean[:3], number([-0.1, 0.05, 0.2]), rtol=0.0, atol=3e-3)


def test_light_behind_a_strand_comes_through_it_and_takes_its_colour():
    made = replace(strands(), colour=number((0.8, 0.4, 0.1)))
    ahead, behind = (of_light(made, number(0.0), (number(-0.06), number(turn))) for turn in (0.0, math.pi))
    assert behind[0] > ahead[0]
    assert behind[0] / behind[2] > 1.5 * ahead[0] / ahead[2]


def test_a_segment_without_width_has_the_logistic_itself_and_of_any_width_its_mean():
    apart = torch.linspace(-3.0, 3.0, 61, dtype=FLOAT)
    scale = number(0.3)
    cosh = torch.cosh(0.5 * apart / scale)
    density = 0.25 / (scale * cosh * cosh * math.tanh(0.5 * math.pi / 0.3))
    exact = hair_fibre._logistic_mean(apart, number(0.0), scale)
    torch.testing.assert_close(exact, density, rtol=1e-12, atol=1e-15)
    node, weight = gauss_legendre(40)
    fine = torch.stack([hair_fibre._logistic_mean(apart + 0.2 * x, number(0.0), scale) for x in node])
    mean = (0.5 * weight[:, None] * fine).sum(0)
    torch.testing.assert_close(hair_fibre._logistic_mean(apart, number(0.2), scale), mean, rtol=1e-5, atol=0.0)


@pytest.mark.parametrize("dtype", [torch.float32, FLOAT])
def test_gradients_of_directions_are_finite_along_strands(dtype):
    view = example_inputs(dtype)
    along = replace(view, to_eye=view.tangent.clone().requires_grad_(), shift=view.shift.clone().requires_grad_())
    for rung in hair.EFFECT.rungs.values():
        total = rung(defaults(Hair, dtype), along).sum() + 0.0 * (along.to_eye.sum() + along.shift.sum())
        assert all(one.isfinite().all() for one in torch.autograd.grad(total, (along.to_eye, along.shift)))
    lit = replace(view.lights, to_light=view.tangent[:3].clone().requires_grad_())
    total = hair.render(defaults(Hair, dtype), replace(view, lights=lit)).sum()
    assert torch.autograd.grad(total, lit.to_light)[0].isfinite().all()


def test_deferred_and_forward_draw_the_picture_but_for_what_bytes_keep_of_tangents():
    made, view = defaults(Hair, FLOAT), picture_view(96, 72)
    black = torch.zeros_like(view.tangent)
    surface = hair.deferred(made, view)
    torch.testing.assert_close(hair.forward(made, hair.seen_in_buffer(view, surface), black), hair.render(made, view))
    kept = hair.forward(made, hair.seen_in_buffer(view, unpacked(packed(surface), FLOAT)), black)
    change = (kept - hair.render(made, view)).abs()
    brightest = hair.render(made, view).max()
    assert 3e-4 * brightest <= change.max() <= 1e-3 * brightest
