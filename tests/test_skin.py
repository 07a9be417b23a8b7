import math
from dataclasses import replace

import pytest
import torch

from diffrender.numerics import gauss_legendre
from diffrender.parameters import defaults
from diffrender.rays import from_angles
from diffrender.shading import brdf, diffusion, skin, skin_reference
from diffrender.shading.brdf import Geometry
from diffrender.shading.skin_passes import Targets, deferred, forward
from diffrender.shading.skin_view import Skin, SkinView, example_inputs
from diffrender.surfaces import EvenSky, Lights

FLOAT = torch.float64
PIXEL = 5e-4
BLURS = {"few taps": lambda *given: skin.blurred(*given, 16), "separable": skin.blurred_separably, "disc": skin.blurred}


def tensor(*numbers):
    return torch.tensor(numbers, dtype=FLOAT)


def made(**changed):
    return replace(defaults(Skin, FLOAT), **{name: torch.as_tensor(v, dtype=FLOAT) for name, v in changed.items()})


def flat(rows, columns, slope=0.0, sky=(1.0, 1.0, 1.0)):
    """A plane that leans back along its rows by a slope, seen from straight above under a sky alone."""
    y, x = torch.meshgrid(*(torch.arange(count, dtype=FLOAT) for count in (rows, columns)), indexing="ij")
    position = PIXEL * torch.stack([x, -y, slope * x], -1)
    up = tensor(-slope, 0.0, 1.0).expand_as(position) / math.hypot(1.0, slope)
    lights = Lights(
        torch.zeros(0, 3, dtype=FLOAT), torch.zeros(0, 3, dtype=FLOAT), EvenSky(tensor(*sky), tensor(0, 0, 0))
    )
    return SkinView(
        position=position,
        normal=up,
        to_eye=tensor(0.0, 0.0, 1.0).expand_as(position),
        texture=torch.ones_like(position),
        mask=torch.ones_like(x),
        unshadowed=torch.zeros(rows, columns, 0, dtype=FLOAT),
        lights=lights,
    )


def widths(of):
    return diffusion.width(of.colour, of.mean_free_path)


# The profile


def test_the_profile_holds_all_light_and_the_disc_stands_for_equal_shares_of_it():
    radius = diffusion.disc(64).norm(dim=-1)
    place, weight = gauss_legendre(60)
    for count in (5, 30, 63):
        distance = 0.5 * radius[count] * (1.0 + place)
        # Of R(r) 2 pi r, in widths.
        share = 0.25 * (torch.exp(-distance) + torch.exp(-distance / 3.0))
        within = (0.5 * radius[count] * weight * share).sum()
        assert float(within) == pytest.approx((count + 0.5) / 64, abs=1e-9)


def test_the_line_stands_for_equal_shares_of_the_profile_summed_across():
    steps = torch.linspace(0.0, 60.0, 200_001, dtype=FLOAT)[1:] - 1.5e-4
    # exp(-r) / r summed along a line is twice Bessel's K0 of the distance from it.
    bessel = torch.special.scaled_modified_bessel_k0
    falling = (bessel(steps) * torch.exp(-steps) + bessel(steps / 3.0) * torch.exp(-steps / 3.0)) / (4.0 * math.pi)
    within = 2.0 * torch.cumsum(falling, 0) * 3e-4
    for count, place in enumerate(diffusion.line(13)[7:], 1):
        assert float(within[int(place / 3e-4)]) == pytest.approx(2.0 * count / 13.0, abs=1e-3)


def test_what_reflects_more_scatters_farther():
    assert (diffusion.width(torch.linspace(0.0, 0.9, 50, dtype=FLOAT), tensor(1.0)[0]).diff() > 0.0).all()


def test_reach_is_the_ratio_of_the_profile_and_falls_off_without_underflow():
    def profile(r):
        return (math.exp(-r) + math.exp(-r / 3.0)) / r

    found = diffusion.reach(tensor(2.0, 0.3, 1e5), tensor(0.5, 0.3, 40.0))
    expected = tensor(profile(2.0) / profile(0.5), 1.0, 0.0)
    torch.testing.assert_close(found, expected)


def test_a_leant_pixel_is_measured_on_its_surface():
    across, down = tensor(2.0, 0.0, 1.0), tensor(0.3, 1.0, 0.0)
    shape, area = diffusion.inverse_root(across, down)
    steps = torch.stack([across, down])
    torch.testing.assert_close(shape @ (steps @ steps.T) @ shape, torch.eye(2, dtype=FLOAT))
    torch.testing.assert_close(area, torch.linalg.cross(across, down).norm())


# Energy


@pytest.mark.parametrize("blur", BLURS)
def test_even_light_stays_as_it_is_also_beside_borders_holes_and_steps(blur):
    view, even = example_inputs(FLOAT), torch.full((2, 7, 8, 3), 0.7, dtype=FLOAT)
    found = BLURS[blur](made(mean_free_path=(5e-3, 1e-3, 1e-5)), view, even)
    seen = view.mask > 0.0
    torch.testing.assert_close(found[seen], even[seen])


@pytest.mark.parametrize(("blur", "within"), [("few taps", 0.1), ("separable", 0.1), ("disc", 0.02)])
def test_a_lit_spot_keeps_its_light_while_it_spreads(blur, within):
    view, spot = flat(33, 33), torch.zeros(33, 33, 3, dtype=FLOAT)
    spot[14:19, 14:19] = 1.0
    found = BLURS[blur](made(), view, spot)
    torch.testing.assert_close(found.sum((0, 1)), spot.sum((0, 1)), rtol=within, atol=0.0)
    assert (found.amax((0, 1)) <= tensor(0.7, 0.95, 1.0)).all()


@pytest.mark.parametrize("rung", list(skin.EFFECT.rungs))
@pytest.mark.parametrize("roughness", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("specular", [0.0, 0.1])
def test_no_white_skin_sends_more_than_it_gets(rung, roughness, specular):
    seen = example_inputs(FLOAT)
    even = replace(
        seen.lights, irradiance=torch.zeros(3, 3, dtype=FLOAT), sky=EvenSky(tensor(1, 1, 1), tensor(0, 0, 0))
    )
    white = made(colour=(1.0, 1.0, 1.0), roughness=roughness, specular=specular)
    sent = skin.EFFECT.rungs[rung](white, replace(seen, texture=torch.ones_like(seen.texture), lights=even))
    assert sent.max() <= 1.0
    assert sent.max() > 0.85


def test_light_and_eye_may_be_exchanged_between_places_of_a_textured_plane():
    # Light that enters at one freckle and leaves at another, and back, under the same angles: one share for both.
    view = flat(9, 9)
    view = replace(view, texture=torch.linspace(0.1, 1.0, 81, dtype=FLOAT).reshape(9, 9, 1).expand(9, 9, 3))
    of, sent = made(), []
    for start, end in (((3, 4), (5, 4)), ((5, 4), (3, 4))):
        light = torch.zeros(9, 9, 3, dtype=FLOAT)
        light[start] = view.texture[start].sqrt()
        diffuse = skin.blurred(of, replace(view, mask=torch.ones_like(view.mask)), light, 1024)
        sent.append(forward(of, view, Targets(diffuse, torch.zeros_like(diffuse)))[end])
    torch.testing.assert_close(sent[0], sent[1], rtol=0.05, atol=1e-6)


# Where light goes


@pytest.mark.parametrize("blur", BLURS)
def test_no_light_crosses_other_materials_borders_or_steps_of_depth(blur):
    view, half = flat(8, 12), torch.zeros(8, 12, 3, dtype=FLOAT)
    half[:, 6:] = 1.0
    bled = BLURS[blur](made(), view, half)[:, :6]
    assert bled.max() > 0.1
    masked = replace(view, mask=torch.where(half[..., 0] > 0.0, 0.0, 1.0))
    assert BLURS[blur](made(), masked, half).abs().max() == 0.0
    deeper = view.position + tensor(0.0, 0.0, -0.05) * half
    assert BLURS[blur](made(), replace(view, position=deeper), half)[:, :6].max() < 0.01 * bled.max()


def test_an_edge_of_shadow_is_widest_in_red():
    view, half = flat(8, 24), torch.zeros(8, 24, 3, dtype=FLOAT)
    half[:, 12:] = 1.0
    dark = skin.blurred(made(), view, half)[4, 10]
    assert dark[0] > 1.5 * dark[1] > 2.25 * dark[2] > 0.0


def test_a_leant_surface_is_blurred_by_its_own_length():
    # Twice as long as it looks: as a level one of skin that scatters half as far.
    stripes = (torch.arange(24) % 8 < 4).double()[None, :, None].expand(20, 24, 3)
    halved = made(mean_free_path=0.5 * defaults(Skin, FLOAT).mean_free_path)
    leant = skin.blurred(made(), flat(20, 24, slope=math.sqrt(3.0)), stripes, 512)
    level = skin.blurred(halved, flat(20, 24), stripes, 512)
    torch.testing.assert_close(leant[10], level[10], rtol=0.0, atol=0.02)
    assert (leant - stripes).abs().max() > 0.1


def test_straight_edges_along_rows_are_blurred_by_two_passes_as_by_the_disc():
    view, half = flat(30, 40), torch.zeros(30, 40, 3, dtype=FLOAT)
    half[:, 20:] = 1.0
    two, many = skin.blurred_separably(made(), view, half), skin.blurred(made(), view, half, 1024)
    torch.testing.assert_close(two[10:20, 10:30], many[10:20, 10:30], rtol=0.0, atol=0.03)


def test_many_taps_reach_the_reference_on_a_plane():
    seen = example_inputs(FLOAT)
    plane = replace(seen, **{n: v[:1] for n, v in vars(seen).items() if n != "lights"})
    truth = skin_reference.reference(made(), plane)
    error = (skin.render_disc(made(), plane, 1024) - truth).abs().max() / truth.max()
    assert error < 5e-3


# Delicate points


@pytest.mark.parametrize("blur", BLURS)
def test_a_path_far_below_a_pixel_leaves_the_light_as_it_is_with_a_finite_slope(blur):
    seen = example_inputs(FLOAT)
    light = deferred(made(), seen).diffuse

    def spread(path):
        return BLURS[blur](made(mean_free_path=path.expand(3)), seen, light)

    is_skin = seen.mask > 0.0
    short, shorter = ((spread(tensor(path)[0]) - light)[is_skin].abs().max() for path in (1e-6, 1e-7))
    assert shorter < 0.2 * short < 1e-3
    _, slope = torch.func.jvp(spread, (tensor(1e-9)[0],), (tensor(1.0)[0],))
    assert slope.isfinite().all()
    # A pixel's light at most changes to its neighbours' within a pixel.
    assert slope.abs().max() < 10.0 * light.max() / PIXEL


def test_a_path_far_above_the_picture_is_finite():
    seen = example_inputs(FLOAT)
    path = tensor(1e3, 1e3, 1e3).requires_grad_()
    drawn = skin.render(replace(made(), mean_free_path=path), seen)
    assert drawn.isfinite().all()
    assert torch.autograd.grad(drawn.sum(), path)[0].isfinite().all()


def test_without_a_blur_it_is_the_basic_material_of_its_index():
    seen = example_inputs(FLOAT)
    lit = replace(seen, unshadowed=torch.ones_like(seen.unshadowed))
    of = made()
    base = brdf.Material(of.colour * seen.texture, of.specular.expand(3), of.roughness)
    expected = brdf.reflected_sky(base, Geometry(seen.normal, seen.to_eye, seen.normal), seen.lights.sky)
    for to_light, irradiance in zip(seen.lights.to_light, seen.lights.irradiance, strict=True):
        geometry = Geometry(seen.normal, seen.to_eye, to_light.expand_as(seen.normal))
        expected = expected + irradiance * brdf.reflected(base, geometry)
    torch.testing.assert_close(skin.skip(of, lit), expected * seen.mask[..., None])


def test_targets_of_half_precision_are_enough():
    seen, of = example_inputs(FLOAT), made()
    targets = deferred(of, seen)
    kept = Targets(*(one.half().double() for one in (targets.diffuse, targets.specular)))
    drawn = [forward(of, seen, replace(one, diffuse=skin.blurred(of, seen, one.diffuse))) for one in (targets, kept)]
    assert (drawn[1] - drawn[0]).abs().max() < 1e-3 * drawn[0].max()


def test_a_mirror_of_wet_skin_is_not_blurred():
    seen = flat(9, 9)
    to_light = from_angles(*tensor(60.0, 30.0).deg2rad()[:, None])
    lights = Lights(to_light, tensor(2.0, 2.0, 2.0)[None], EvenSky(tensor(0, 0, 0), tensor(0, 0, 0)))
    shadow = (torch.arange(9) > 4).double()[None, :, None].expand(9, 9, 1)
    view = replace(seen, lights=lights, unshadowed=shadow)
    black = made(colour=(0.0, 0.0, 0.0))
    torch.testing.assert_close(skin.render(black, view), skin.skip(black, view))
    assert skin.render(black, view)[:, :5].max() == 0.0
