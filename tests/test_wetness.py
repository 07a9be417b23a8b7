import itertools
import math
from dataclasses import replace

import pytest
import torch

from diffrender.parameters import defaults
from diffrender.shading import drying, ripples, trickles, wetness
from diffrender.shading.drying import DryBoxes
from diffrender.shading.soaked_ground import diffuse_reflectance, wet_albedo
from diffrender.shading.wet_surface import Wetness, example_inputs

FLOAT = torch.float64
DROPS = ripples.drops(6, torch.Generator().manual_seed(0))
WAVES = trickles.waves(12, torch.Generator().manual_seed(0))
OF_PLACES = ("position", "normal", "to_eye", "base", "roughness", "metallic", "height", "terrain", "open", "held")
DRY = {"amount": 0.0, "hole_flood": 0.0, "puddle_flood": 0.0}


def number(value):
    return torch.tensor(float(value), dtype=FLOAT)


def wet(**changed):
    return replace(defaults(Wetness, FLOAT), **{name: number(value) for name, value in changed.items()})


def view(count=1, **changed):
    """Level rough ground that has stood in the rain for long, seen from above."""
    given = example_inputs(FLOAT)
    spread = {name: getattr(given, name)[:1].expand(count, *getattr(given, name).shape[1:]) for name in OF_PLACES}
    far = DryBoxes(*(one + away for one, away in zip(vars(given.boxes).values(), (1e6, 0.0, 0.0), strict=True)))
    seen = replace(given, **spread, boxes=far, elapsed=number(1e9))
    seen = replace(seen, normal=torch.tensor([[0.0, 0.0, 1.0]], dtype=FLOAT).expand(count, 3))
    return replace(seen, **{n: v if not isinstance(v, float) else number(v).expand(count) for n, v in changed.items()})


# Lagarde's model


def test_what_is_dry_is_drawn_as_if_there_were_no_rain():
    seen = example_inputs(FLOAT)
    assert torch.equal(wetness.render(wet(**DRY), seen), wetness.skip(wet(**DRY), seen))
    assert wetness.largest_change(wet(**DRY), seen) == 0.0
    assert wetness.largest_change(wet(), seen) > 0.0


def test_soaked_porous_ground_keeps_the_given_share_of_its_colour_and_is_smoother():
    rain = wet(amount=1.0, soaked_albedo=0.3, hole_flood=0.0, puddle_flood=0.0)
    seen = view(3, roughness=torch.tensor([0.4, 0.7, 0.95], dtype=FLOAT), metallic=0.0)
    found = wetness.wet_material(rain, seen, wetness.water(rain, seen))
    kept = (found.diffuse / seen.base)[:, 0]
    torch.testing.assert_close(kept, torch.tensor([1.0, 0.65, 0.3], dtype=FLOAT))
    torch.testing.assert_close(found.roughness / seen.roughness, (1.0 + kept) / 2.0)


def test_metals_do_not_soak():
    seen = view(roughness=1.0, metallic=1.0, height=1.0, terrain=1.0)
    found = wetness.wet_material(wet(amount=1.0), seen, wetness.water(wet(amount=1.0), seen))
    assert found.roughness == 1.0


def test_flooded_ground_is_a_level_mirror_of_water():
    seen = view(terrain=0.0, normal=torch.tensor([[0.1, 0.2, 0.97]], dtype=FLOAT))
    deep = wet(puddle_flood=1.0, rain=0.0)
    found = wetness.water(deep, seen)
    torch.testing.assert_close(found.flooded, torch.ones(1, dtype=FLOAT))
    given = wetness.wet_material(deep, seen, found)
    assert float(given.roughness) == pytest.approx(0.0, abs=1e-12)
    assert float(given.straight[0, 0]) == pytest.approx(0.02)
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=FLOAT)
    torch.testing.assert_close(wetness.wet_normal(deep, seen, found), up)


def test_holes_fill_from_below_and_puddles_from_the_deepest_place():
    height = torch.linspace(0.0, 1.0, 11, dtype=FLOAT)
    holes = wetness.water(wet(hole_flood=0.4, puddle_flood=0.0), view(11, height=height, terrain=1.0)).flooded
    torch.testing.assert_close(holes, torch.minimum(number(0.4), 1.0 - height))
    puddles = wetness.water(wet(hole_flood=0.0, puddle_flood=0.5), view(11, height=1.0, terrain=height)).flooded
    torch.testing.assert_close(puddles, ((0.5 - height) / 0.4).clamp(0.0, 1.0))


def test_no_water_stands_on_walls():
    wall = view(normal=torch.tensor([[1.0, 0.0, 0.0]], dtype=FLOAT), terrain=0.0, height=0.0)
    assert wetness.water(wet(puddle_flood=1.4, hole_flood=1.0), wall).flooded == 0.0


def test_the_gradient_dies_where_a_hole_is_full():
    seen = view(height=0.5, terrain=1.0)

    def slope(level):
        return torch.func.grad(lambda one: wetness.water(replace(wet(), hole_flood=one), seen).flooded.sum())(level)

    assert (slope(number(0.49)), slope(number(0.51))) == (1.0, 0.0)


# Optics


def test_wet_albedo_is_that_of_the_paper():
    # MATH of Lekner and Dorf for water: p = 0.472.
    assert diffuse_reflectance(1.33) == pytest.approx(0.0659, abs=1e-4)
    found = wet_albedo(torch.tensor([0.1, 0.3, 0.5, 0.8], dtype=FLOAT))
    torch.testing.assert_close(found, torch.tensor([0.054, 0.181, 0.339, 0.665], dtype=FLOAT), atol=6e-4, rtol=0.0)


# Rings


def places(count, seed=1):
    return 4.0 * torch.rand(count, 2, generator=torch.Generator().manual_seed(seed), dtype=FLOAT)


def test_rings_are_continuous_in_place_and_time_and_absent_without_rain():
    there = places(4000)
    now = ripples.slope(DROPS, there, number(3.1), number(1.0))
    assert 0.005 < now.norm(dim=-1).mean() < 0.2
    for moved, later in ((1e-6, 0.0), (0.0, 1e-6)):
        then = ripples.slope(DROPS, there + moved, number(3.1 + later), number(1.0))
        assert (then - now).abs().max() < 1e-4
    assert torch.equal(ripples.slope(DROPS, there, number(3.1), number(0.0)), torch.zeros_like(there))


def test_rings_at_borders_of_cells_and_at_the_end_of_a_drops_life_do_not_jump():
    edge = torch.stack([torch.arange(200) * ripples.CELL / 4.0, 0.013 * torch.arange(200)], -1).double()
    below, above = (ripples.slope(DROPS, edge + side * 1e-9, number(2.0), number(1.0)) for side in (-1.0, 1.0))
    assert (below - above).abs().max() < 1e-6
    end = (1.0 - DROPS[0, 0, 0, 3]) / ripples.DROPS_PER_SECOND
    here = (DROPS[0, 0, 0, :2] * ripples.CELL)[None] + 0.01
    before, after = (ripples.slope(DROPS, here, end + side * 1e-9, number(1.0)) for side in (-1.0, 1.0))
    assert (before - after).abs().max() < 1e-6


def test_a_drops_centre_has_a_finite_gradient():
    centre = (DROPS[0, 0, 0, :2] * ripples.CELL).requires_grad_()
    slope = ripples.slope(DROPS, centre, number(0.0), number(1.0)).sum()
    assert torch.autograd.grad(slope, centre)[0].isfinite().all()


def test_a_seed_gives_the_same_drops_and_waves_again():
    assert torch.equal(DROPS, ripples.drops(6, torch.Generator().manual_seed(0)))
    assert torch.equal(WAVES, trickles.waves(12, torch.Generator().manual_seed(0)))
    assert not torch.equal(DROPS, ripples.drops(6, torch.Generator().manual_seed(1)))


# Rivulets


def test_rivulets_run_down_walls_at_their_waves_speed():
    one = WAVES[:1]
    normal = torch.tensor([[1.0, 0.0, 0.0]], dtype=FLOAT).expand(50, 3)
    place = torch.rand(50, 3, generator=torch.Generator().manual_seed(2), dtype=FLOAT)
    down = torch.tensor([0.0, 0.0, -1.0], dtype=FLOAT) * one[0, 2] * 2.0
    begun = trickles.rivulets(one, place, normal, number(1.0))
    later = trickles.rivulets(one, place + down, normal, number(3.0))
    torch.testing.assert_close(begun.lean, later.lean, rtol=1e-9, atol=1e-12)
    torch.testing.assert_close(begun.film, later.film, rtol=1e-9, atol=1e-12)
    assert begun.lean.abs().max() > 0.1


def test_level_ground_has_no_rivulets_and_none_leaves_a_surface():
    place = torch.rand(50, 3, generator=torch.Generator().manual_seed(2), dtype=FLOAT)
    level = torch.tensor([[0.0, 0.0, 1.0]], dtype=FLOAT).expand(50, 3)
    flat = trickles.rivulets(WAVES, place, level, number(1.0))
    assert (flat.lean.abs().max(), flat.film.abs().max()) == (0.0, 0.0)
    steep = torch.nn.functional.normalize(torch.tensor([[0.5, -0.7, 0.3]], dtype=FLOAT), dim=-1).expand(50, 3)
    found = trickles.rivulets(WAVES, place, steep, number(1.0))
    assert (found.lean * steep).sum(-1).abs().max() < 1e-12
    assert found.film.max() > 0.1


# Time


def test_things_under_a_roof_dry_exponentially_and_soak_again():
    rain = wet(drying_time=50.0, soaking_time=5.0)
    under = view(open=0.0, elapsed=number(25.0))
    _, state = wetness.step(rain, under, torch.ones(1, dtype=FLOAT))
    assert float(state) == pytest.approx(math.exp(-0.5))
    _, state = wetness.step(rain, replace(under, open=torch.ones(1, dtype=FLOAT)), state)
    assert float(state) == pytest.approx(1.0 - (1.0 - math.exp(-0.5)) * math.exp(-5.0))


def test_splitting_time_into_frames_changes_nothing():
    seen, rain = example_inputs(FLOAT), wet()
    whole_picture, whole = wetness.step(rain, replace(seen, elapsed=number(12.0)), seen.held)
    state = seen.held
    for part in (5.0, 0.5, 6.5):
        picture, state = wetness.step(rain, replace(seen, elapsed=number(part)), state)
    torch.testing.assert_close(state, whole, rtol=1e-12, atol=1e-15)
    torch.testing.assert_close(picture, whole_picture, rtol=1e-9, atol=1e-12)


def test_a_box_dries_smoothly_from_its_border_in():
    box = DryBoxes(torch.zeros(1, 3, dtype=FLOAT), torch.full((1, 3), 2.0, dtype=FLOAT), number(0.5)[None])
    x = torch.linspace(0.0, 3.0, 301, dtype=FLOAT)
    share = drying.open_to_rain(box, torch.stack([x, 0.0 * x, 0.0 * x], -1))
    assert (share[0], share[-1]) == (0.0, 1.0)
    assert (share.diff() >= 0.0).all()
    assert share.diff().max() < 0.05
    torch.testing.assert_close(share[175], number(0.5))


def test_a_car_that_enters_a_box_gets_dry_by_and_by_and_its_picture_with_it():
    box = DryBoxes(torch.zeros(1, 3, dtype=FLOAT), torch.full((1, 3), 5.0, dtype=FLOAT), number(1.0)[None])
    rain, state, brightness = wet(drying_time=10.0, amount=1.0), torch.ones(1, dtype=FLOAT), []
    for second in range(0, 30, 2):
        place = torch.tensor([[8.0 - min(second, 8), 0.0, 0.0]], dtype=FLOAT)
        picture, state = wetness.step(
            rain, view(position=place, boxes=box, elapsed=number(2.0), terrain=1.0, height=1.0), state
        )
        brightness.append(float(picture.mean()))
    assert brightness[0] == pytest.approx(brightness[1], rel=1e-3)  # still in the rain
    assert brightness[-1] > 1.2 * brightness[0]  # and dry
    assert max(abs(a - b) for a, b in itertools.pairwise(brightness)) < 0.2 * brightness[-1]
