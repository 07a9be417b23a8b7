import math
from dataclasses import replace

import pytest
import torch

from diffrender.parameters import defaults
from diffrender.rays import from_angles
from diffrender.shading import transparent
from diffrender.shading.glass_pane import panes
from diffrender.shading.microfacet import fresnel_polarised
from diffrender.shading.transparent_view import Transparent, TransparentView, example_inputs
from diffrender.surfaces import EvenSky, Lights

FLOAT = torch.float64
UP = torch.tensor([0.0, 0.0, 1.0], dtype=FLOAT)
NOWHERE = math.inf
CLEAR = {"tint": (1.0, 1.0, 1.0), "dust": 0.0}


def number(value):
    return torch.tensor(value, dtype=FLOAT)


def glass(**changed):
    return replace(defaults(Transparent, FLOAT), **{name: number(value) for name, value in changed.items()})


def even(radiance):
    return Lights(UP[None], torch.zeros(1, 3, dtype=FLOAT), EvenSky(radiance * torch.ones(3).to(UP), 0.0 * UP))


def view(depth, dust=0.0, angle=0.0, **changed):
    """One ray that looks down on level layers at an angle, in the dark before black."""
    depth = number(depth)[None]
    seen = TransparentView(
        depth=depth,
        normal=UP.expand(*depth.shape, 3),
        dust=number(dust).expand_as(depth),
        background=torch.zeros(1, 3, dtype=FLOAT),
        background_depth=number([NOWHERE]),
        to_eye=from_angles(number([0.5 * math.pi - angle]), number([0.3])),
        lights=even(0.0),
    )
    return replace(seen, **changed)


def white(seen):
    return replace(seen, background=torch.ones_like(seen.background), lights=even(1.0))


# One pane


def test_a_clear_pane_mirrors_and_passes_what_stokes_found():
    face = (0.5 / 2.5) ** 2
    pane = panes(glass(**CLEAR, index=1.5, roughness=0.0), white(view([2.0])))
    torch.testing.assert_close(pane.sent[0, 0], 2.0 * face / (1.0 + face) * torch.ones(3).to(UP), rtol=1e-3, atol=0.0)
    torch.testing.assert_close(
        pane.passed[0, 0], (1.0 - face) / (1.0 + face) * torch.ones(3).to(UP), rtol=1e-4, atol=0.0
    )


def test_at_brewsters_angle_only_light_across_is_mirrored():
    across, within = fresnel_polarised(number(1.5), number(1.0 / math.sqrt(1.0 + 1.5**2)))
    assert within < 1e-30
    assert float(across) == pytest.approx(((1.5**2 - 1.0) / (1.5**2 + 1.0)) ** 2)


def test_glass_that_does_not_bend_light_mirrors_nothing_and_dims_by_the_slanted_way():
    angle = 1.1
    seen = replace(white(view([2.0], angle=angle)), background=number([[0.0, 0.0, 0.0]]))
    thin = glass(index=1.0, tint=(0.2, 0.5, 1.0), thickness=0.02, dust=0.0)
    torch.testing.assert_close(transparent.render(thin, seen), torch.zeros(1, 3, dtype=FLOAT))
    passed = panes(thin, seen).passed[0, 0]
    torch.testing.assert_close(passed, number([0.2, 0.5, 1.0]) ** (2.0 / math.cos(angle)))


def test_a_thick_dark_pane_mirrors_only_by_its_nearer_face():
    dark = glass(tint=(0.01, 0.01, 0.01), thickness=0.1, roughness=0.0, index=1.5, dust=0.0)
    pane = panes(dark, white(view([2.0])))
    torch.testing.assert_close(pane.sent, torch.full_like(pane.sent, 0.04), rtol=1e-3, atol=0.0)
    assert pane.passed.max() < 1e-19


def test_panes_have_two_sides():
    seen = example_inputs(FLOAT)
    turned = replace(seen, normal=-seen.normal)
    assert torch.equal(transparent.render(glass(), turned), transparent.render(glass(), seen))


def test_dust_hides_what_is_behind_it():
    seen = white(view([2.0], dust=1.0))
    covered = glass(dust=1.0, dust_colour=(0.1, 0.2, 0.3))
    torch.testing.assert_close(transparent.render(covered, seen), number([[0.1, 0.2, 0.3]]))


# Energy


@pytest.mark.parametrize("index", [1.0, 1.52, 2.5])
def test_clear_glass_in_a_white_furnace_is_not_seen(index):
    roughness = torch.linspace(0.0, 1.0, 33, dtype=FLOAT)[:, None]
    angle = torch.linspace(0.0, 0.5 * math.pi, 12, dtype=FLOAT)
    clear = replace(glass(**CLEAR, index=index), roughness=roughness)
    for one in angle:
        drawn = transparent.render(clear, white(view([2.0, 3.0], angle=float(one))))
        assert (drawn - 1.0).abs().max() < 1e-14


def test_no_glass_sends_more_than_it_gets():
    parts = [number(part) for part in ((0.01, 0.9, 1.0), (1.0, 1.3, 2.5), (0.0, 0.3, 1.0), (0.0, 0.5, 1.0))]
    tint, index, roughness, dust = torch.cartesian_prod(*parts)[:, None].unbind(-1)
    made = Transparent(
        tint[..., None].expand(-1, 1, 3), number(0.006), index, roughness, dust, torch.ones(3, dtype=FLOAT)
    )
    for angle in torch.linspace(0.0, 1.57, 12):
        drawn = transparent.render(made, white(view([2.0], dust=1.0, angle=float(angle))))
        assert drawn.max() < 1.0 + 1e-14


@pytest.mark.parametrize(
    ("roughness", "index", "angle"),
    [(0.4, 1.5, 0.4), (0.4, 1.5, 1.3), (1.0, 2.5, 0.2), (0.7, 2.5, 1.3), (0.4, 1.1, 1.5)],
)
def test_a_light_is_mirrored_as_the_sky_is_but_for_rough_panes_that_graze(roughness, index, angle):
    share, turn = torch.meshgrid(*((torch.arange(n, dtype=FLOAT) + 0.5) / n for n in (200, 400)), indexing="ij")
    eyes = from_angles(torch.asin(share.sqrt()), 2.0 * math.pi * turn).reshape(-1, 3)  # even by the cosine
    made = glass(**CLEAR, roughness=roughness, index=index)
    seen = view([2.0], angle=angle)
    lights = Lights(seen.to_eye, torch.full((1, 3), math.pi / math.cos(angle), dtype=FLOAT), even(0.0).sky)
    of_light = panes(made, replace(seen, to_eye=eyes, lights=lights)).sent[:, 0].mean(0)
    of_sky = panes(made, white(seen))
    assert (of_light + of_sky.passed[0, 0]).max() < 1.007
    assert (of_light - of_sky.sent[0, 0]).abs().max() < (0.013 if angle < 1.5 else 0.1)


def test_glints_are_alike_when_eye_and_light_change_places():
    eye, light = from_angles(number([0.9, 0.4]), number([0.3, 2.9]))
    made = glass(roughness=0.5, dust=0.0)

    def sent(to_eye, to_light):
        lights = replace(even(0.0), to_light=to_light[None], irradiance=torch.ones(1, 3, dtype=FLOAT))
        return panes(made, replace(view([2.0]), to_eye=to_eye[None], lights=lights)).sent / to_light[2]

    torch.testing.assert_close(sent(eye, light), sent(light, eye))


# Layers


def layered(**changed):
    """Two panes of different glass and dust before a background."""
    two = replace(glass(**CLEAR), tint=number([[1.0, 0.2, 0.2], [0.2, 0.3, 1.0]]), dust=number([0.3, 0.7]))
    return two, replace(white(view([2.0, 4.0], dust=1.0, angle=0.5)), **changed)


def test_layers_lie_over_each_other_by_depth_each_of_its_own_glass():
    for depth, near in (([2.0, 4.0], 0), ([4.0, 2.0], 1)):
        two, seen = layered(depth=number([depth]))
        pane = panes(two, seen)
        behind = pane.sent[:, 1 - near] + pane.passed[:, 1 - near] * seen.background
        torch.testing.assert_close(transparent.render(two, seen), pane.sent[:, near] + pane.passed[:, near] * behind)


def test_only_the_order_of_depth_matters():
    seen, order = example_inputs(FLOAT), torch.tensor([2, 0, 3, 1])
    mixed = replace(seen, **{name: getattr(seen, name)[:, order] for name in ("depth", "normal", "dust")})
    is_even = seen.depth[:, 0] == seen.depth[:, 1]  # which of two at equal depth is first, is the nearer
    is_even &= seen.depth[:, 0].isfinite()
    drawn, of_mixed = transparent.render(glass(), seen), transparent.render(glass(), mixed)
    torch.testing.assert_close(of_mixed[~is_even], drawn[~is_even])
    assert is_even.sum() == 1
    by_weight = transparent.render_weighted(glass(), mixed)
    torch.testing.assert_close(by_weight, transparent.render_weighted(glass(), seen))
    assert (transparent.render_unsorted(glass(), mixed) - drawn).abs().max() > 0.01


def test_of_layers_at_equal_depth_the_earlier_is_the_nearer():
    two, seen = layered(depth=number([[3.0, 3.0]]))
    _, ordered = layered()
    assert torch.equal(transparent.render(two, seen), transparent.render(two, ordered))


@pytest.mark.parametrize("rung", list(transparent.EFFECT.rungs))
@pytest.mark.parametrize("depth", [[NOWHERE, NOWHERE], [5.0, 9.0]])
def test_absent_layers_and_those_at_or_behind_what_is_opaque_are_not_there(rung, depth):
    behind = NOWHERE if math.isinf(depth[0]) else 5.0
    two, seen = layered(depth=number([depth]), background_depth=number([behind]))
    assert torch.equal(transparent.EFFECT.rungs[rung](two, seen), seen.background)


def test_weights_are_exact_for_one_layer_and_hold_the_background_of_many():
    _, seen = layered()
    one = replace(seen, depth=number([[2.0, NOWHERE]]))
    torch.testing.assert_close(transparent.render_weighted(glass(), one), transparent.render(glass(), one))
    clear = glass(index=1.0, dust=0.0)
    torch.testing.assert_close(transparent.render_weighted(clear, seen), transparent.render(clear, seen))


def test_forward_goes_over_any_picture():
    seen = example_inputs(FLOAT)
    lit = 2.0 * seen.background + 0.1
    over = transparent.forward(glass(), seen, lit)
    assert torch.equal(over, transparent.render(glass(), replace(seen, background=lit)))


def test_light_between_two_clear_panes_is_less_than_a_hundredth():
    clear = glass(**CLEAR, index=1.5, roughness=0.0)
    seen = replace(view([2.0, 3.0]), background=torch.ones(1, 3, dtype=FLOAT))
    pane = panes(clear, white(seen))
    apart = transparent.render(clear, seen)
    together = apart / (1.0 - pane.sent[:, 0] * pane.sent[:, 1])  # Stokes' sum over all ways between them
    torch.testing.assert_close(together, 1.0059 * apart, rtol=1e-4, atol=0.0)


# Against the reference, and gradients


@pytest.mark.parametrize(("index", "roughness", "error"), [(1.1, 0.5, 0.025), (1.52, 0.0, 2e-4)])
def test_rough_and_smooth_panes_are_near_the_sum_over_facets(index, roughness, error):
    made, seen = glass(index=index, roughness=roughness), example_inputs(FLOAT)
    truth = transparent.reference(made, seen)
    assert error / 3.0 < (transparent.render(made, seen) - truth).abs().max() / truth.max() < error


@pytest.mark.parametrize("rung", ["unsorted", "weighted", "sorted"])
def test_gradients_by_all_but_depth_match_finite_differences(rung):
    seen = example_inputs(FLOAT)

    def draw(normal, to_eye, dust, background, to_light):
        lights = replace(seen.lights, to_light=to_light)
        given = replace(seen, normal=normal, to_eye=to_eye, dust=dust, background=background, lights=lights)
        # Straight on and straight down tables end; dark pixels have a gradient of rounding.
        return transparent.EFFECT.rungs[rung](glass(roughness=0.4), given)[2:12]

    leaves = (seen.normal, seen.to_eye, seen.dust, seen.background, seen.lights.to_light)
    leaves = tuple(leaf.clone().requires_grad_() for leaf in leaves)
    assert torch.autograd.gradcheck(draw, leaves, fast_mode=True, atol=1e-5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    "changed", [{"roughness": 0.0}, {"roughness": 1.0}, {"index": 1.0}, {"index": 2.5}, CLEAR | {"index": 1.0}]
)
@pytest.mark.parametrize("rung", ["tinted", "unsorted", "weighted", "sorted"])
def test_hard_places_have_finite_gradients(rung, changed, dtype):
    eye = from_angles(number([0.6]), number([0.3]))
    edge = torch.linalg.cross(eye, UP[None])
    normals = torch.stack([eye, edge / edge.norm(), UP[None], -eye], 1)
    seen = view([2.0, 1.0, NOWHERE, 0.5], dust=0.5, to_eye=eye, normal=normals)
    to_light = torch.cat([eye, -eye, -UP[None]])
    lights = Lights(to_light, torch.ones_like(to_light), EvenSky(0.5 * UP + 0.5, 0.2 * UP))
    made = glass(**changed)
    leaves = [one.to(dtype).requires_grad_() for one in (*vars(made).values(), normals, eye, to_light, seen.depth)]
    given = Transparent(*leaves[:6])
    sky = EvenSky(*(one.to(dtype) for one in vars(lights.sky).values()))
    placed = TransparentView(
        depth=leaves[9], normal=leaves[6], dust=seen.dust.to(dtype), background=seen.background.to(dtype),
        background_depth=seen.background_depth.to(dtype), to_eye=leaves[7],
        lights=Lights(leaves[8], lights.irradiance.to(dtype), sky),
    )  # fmt: skip
    drawn = transparent.EFFECT.rungs[rung](given, placed)
    found = torch.autograd.grad(drawn.sum(), leaves, allow_unused=True)
    assert drawn.isfinite().all()
    assert all(one is None or one.isfinite().all() for one in found)
