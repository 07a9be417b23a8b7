import math
from dataclasses import replace

import pytest
import torch

from diffrender.parameters import defaults
from diffrender.shading import local_lights
from diffrender.shading.lamps import NO_PROFILE, Lists, LitView, LocalLights, Places, points, spots
from experiments import hall_shadows, lamp_scenes

RUNGS = {name: rung for name, rung in local_lights.EFFECT.rungs.items() if name != "skip"}
CULLED = ("tiles", "clusters")


def lights(**changed):
    values = {name: torch.tensor(value, dtype=torch.float64) for name, value in changed.items()}
    return replace(defaults(LocalLights, torch.float64), **values)


def hall(count, seed=0, size=(48, 32), tile=8):
    draw = torch.Generator().manual_seed(seed)
    shown = lamp_scenes.seen(lamp_scenes.camera(*size), draw)
    return lamp_scenes.view(shown, lamp_scenes.lamps(count, draw), tile)


def under(lamps, roughness=1.0, eye=(0.0, 0.0, 1.0)):
    """White ground at 0, seen from an eye, in one tile of one pixel that lists all lamps."""
    count, unit = len(lamps.reach), torch.ones(1, dtype=torch.float64)
    up, white = torch.tensor([[0.0, 0.0, 1.0]]).double(), torch.ones(1, 3).double()
    to_eye = torch.tensor([eye]).double()
    ground = Places(0.0 * up, up, to_eye, white, roughness * unit, 0.0 * unit, torch.zeros(1, dtype=torch.long))
    lists = Lists(torch.arange(count), torch.zeros(1, dtype=torch.long), torch.tensor([count - 1]), count)
    return LitView(ground, lamps, lists)


def above(height, reach=1e4, intensity=1.0):
    place = torch.tensor([[0.0, 0.0, height]]).double()
    return points(place, intensity * torch.ones(1, 3).double(), torch.tensor([reach]).double())


@pytest.mark.parametrize("rung", CULLED)
@pytest.mark.parametrize("count", [0, 1, 30, 150])
def test_culling_changes_no_picture(rung, count):
    view = hall(count, seed=count)
    whole = local_lights.render(lights(), view)
    culled = RUNGS[rung](lights(), view)
    torch.testing.assert_close(culled, whole, rtol=1e-12, atol=1e-12)
    grouped = local_lights.in_groups(RUNGS[rung], lights(), view, 5)
    torch.testing.assert_close(grouped, whole, rtol=1e-12, atol=1e-12)
    assert (whole > 0.0).any() == (count > 0)


@pytest.mark.parametrize("rung", CULLED)
def test_culling_holds_whatever_the_parameters(rung):
    view = hall(60)
    for changed in ({"reach_scale": 0.3}, {"source_radius": 1.0, "intensity_scale": 7.0}):
        culled, whole = (draw(lights(**changed), view) for draw in (RUNGS[rung], local_lights.render))
        torch.testing.assert_close(culled, whole, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("rung", RUNGS)
def test_shadows_dim_their_own_lamps_alike_in_all_rungs(rung):
    draw = torch.Generator().manual_seed(5)
    shown, lamps = lamp_scenes.seen(lamp_scenes.camera(48, 32), draw), lamp_scenes.lamps(40, draw)
    view = hall_shadows.shaded(shown, lamps, 12, 8, 128)
    assert len(view.shadowed.lamps.reach) == 12
    found = RUNGS[rung](lights(), view)
    torch.testing.assert_close(found, local_lights.reference(lights(), view), rtol=0.0, atol=2e-4 * float(found.max()))
    torch.testing.assert_close(local_lights.in_groups(RUNGS[rung], lights(), view, 5), found, rtol=1e-12, atol=1e-12)
    bright = replace(view, shadowed=replace(view.shadowed, shadows=None))
    without = RUNGS[rung](lights(), bright)
    assert (found <= without).all()
    assert (found < 0.5 * without).any()
    # As if all lamps were one group.
    torch.testing.assert_close(without, RUNGS[rung](lights(), lamp_scenes.view(shown, lamps, 8)), rtol=1e-9, atol=1e-12)


def test_culled_rungs_look_at_few_lamps():
    view = hall(400)
    most, count = view.lists.listed.shape[-1], len(view.lamps.reach)
    assert most < 0.7 * count
    assert (view.lists.listed >= 0).double().mean() * most < 0.2 * count
    assert view.lists.longest < 0.6 * most


@pytest.mark.parametrize("rung", RUNGS)
def test_steps_of_few_pairs_draw_the_same(rung, monkeypatch):
    view = hall(30)
    whole = RUNGS[rung](lights(), view)
    monkeypatch.setattr(local_lights, "PAIRS", 4000)
    torch.testing.assert_close(RUNGS[rung](lights(), view), whole, rtol=1e-12, atol=1e-12)


def test_far_lamp_lights_by_the_inverse_square():
    # Ground of which 4 % and by Schlick none more is lost on either way, straight down and straight up.
    drawn = local_lights.render(lights(), under(above(20.0, intensity=400.0)))
    facets = 0.04 * 0.25 / math.pi
    assert drawn[0].tolist() == pytest.approx([0.96 / math.pi + facets] * 3, rel=1e-4)


@pytest.mark.parametrize("height", [0.0, 1e-9, 0.05])
def test_lamp_close_to_a_surface_stays_finite(height):
    lamp = above(height)
    leaf = lamp.position.clone().requires_grad_()
    drawn = local_lights.render(lights(), under(replace(lamp, position=leaf)))
    drawn.sum().backward()
    assert drawn.isfinite().all()
    assert drawn.max() <= 1.0 / 0.05**2
    assert leaf.grad.isfinite().all()


def test_light_ends_smoothly_at_the_reach():
    def falloff(distance):
        return local_lights.falloff(lights(), torch.tensor(5.0).double(), distance * distance)

    for distance in (4.999999, 5.0, 5.000001):
        at = torch.tensor(distance, dtype=torch.float64, requires_grad=True)
        falloff(at).backward()
        assert falloff(at) < 1e-12
        assert at.grad.abs() < 1e-6
    assert falloff(torch.tensor(2.5).double()) * (2.5**2 + 0.05**2) == pytest.approx((1.0 - 0.5**4) ** 2)


def test_a_spot_is_dark_outside_its_cone_and_whole_within():
    place = torch.tensor([[math.sin(turn), 0.0, math.cos(turn)] for turn in (0.0, 0.2, 0.5, 0.9)]).double() * 2.0
    lamp = points(place, torch.ones(4, 3).double(), torch.full((4,), 100.0).double())
    down = torch.tensor([[0.0, 0.0, -1.0]]).double().expand(4, 3)
    spot = spots(lamp, down, 0.3, 0.7)

    def drawn(given, number):
        one = type(given)(**{name: value[number : number + 1] for name, value in vars(given).items()})
        return local_lights.render(lights(), under(one))[0, 0]

    shares = [float(drawn(spot, number) / drawn(lamp, number)) for number in range(4)]
    assert shares[:2] == pytest.approx([1.0, 1.0])
    assert 0.1 < shares[2] < 0.9
    assert shares[3] == 0.0


def test_a_profile_turns_with_its_lamp():
    view = hall(3)
    lamp = replace(above(2.0), profile=torch.zeros(1, dtype=torch.long))
    # The table's lamp shines sideways along `across` and not square to it.
    sideways = torch.tensor([[0.0, 1.0, 0.0]]).double()
    bright, dim = (
        replace(lamp, axis=sideways, across=torch.tensor([across]).double())
        for across in ((0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
    )
    seen = [
        float(local_lights.render(lights(), replace(under(one), profiles=view.profiles))[0, 0])
        for one in (lamp, bright, dim, replace(lamp, profile=torch.full((1,), NO_PROFILE)))
    ]
    assert [one / seen[3] for one in seen[:3]] == pytest.approx([1.2, 1.7, 0.2])


def test_gradients_of_lamps_and_surfaces_match_differences():
    view = hall(4, size=(4, 4), tile=4)
    leaves = [view.lamps.position, view.lamps.intensity, view.places.roughness, view.places.base]

    def draw(position, intensity, roughness, base):
        given = replace(
            view,
            lamps=replace(view.lamps, position=position, intensity=intensity),
            places=replace(view.places, roughness=roughness, base=base),
        )
        return local_lights.render_tiles(lights(), given)

    leaves = [leaf.clone().requires_grad_() for leaf in leaves]
    assert torch.autograd.gradcheck(draw, leaves, check_forward_ad=True, fast_mode=True)
