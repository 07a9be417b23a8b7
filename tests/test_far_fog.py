import itertools
import math
from dataclasses import replace

import pytest
import torch

from diffrender.atmosphere import far_fog
from diffrender.atmosphere.far_fog import FarFog, FarFogView
from diffrender.parameters import defaults, names
from diffrender.rays import Rays
from diffrender.scene import weather_names
from fit import keyframes

FLOAT = torch.float64
# Of the talk's weather file, at midnight and at noon; None is a cell that it leaves empty.
TALK = {
    "VOLLIGHT_FARFOG_THICKNESS": (2000.0, 0.5),
    "VOLLIGHT_FARFOG_ZNEAR": (200.0, None),
    "VOLLIGHT_FARFOG_ZFAR": (8000.0, None),
    "VOLLIGHT_FARFOG_HEIGHT_DECAY": (0.3, None),
    "VOLLIGHT_FARFOG_DISTANCE_DECAY": (0.02, None),
    "VOLLIGHT_FARFOG_DEPTH_DECAY": (0.3, None),
    "VOLLIGHT_FARFOG_EXTINCTION": (0.001, 5.0),
    "VOLLIGHT_FARFOG_TINT_R": (0.5, 0.23),
    "VOLLIGHT_FARFOG_TINT_G": (0.5, 0.5),
    "VOLLIGHT_FARFOG_TINT_B": (0.5, 0.82),
    "VOLLIGHT_FARFOG_STANDARD_HEIGHT": (0.0, None),
    "VOLLIGHT_FARFOG_BOTTOM_HEIGHT": (-100.0, None),
    "VOLLIGHT_FARFOG_PLAYER_RELATIVE": (0.0, None),
}
EVEN = {"height_decay": 0.0, "depth_decay": 0.0, "distance_decay": 0.0}


def number(value):
    return torch.tensor(float(value), dtype=FLOAT)


def fog_of(**changed):
    return replace(defaults(FarFog, FLOAT), **{name: number(value) for name, value in changed.items()})


def view(altitude, up, length, player=0.0):
    altitude, up, length = (torch.as_tensor(value, dtype=FLOAT) for value in (altitude, up, length))
    nothing = torch.zeros_like(altitude + up + length)
    direction = torch.stack([torch.sqrt(1.0 - up * up) + nothing, nothing, up + nothing], -1)
    rays = Rays(torch.stack([nothing, nothing, altitude + nothing], -1), direction, length)
    return FarFogView(rays, torch.full((3,), 0.3, dtype=FLOAT), torch.full((3,), 0.8, dtype=FLOAT), number(player))


def depth(fog, seen):
    return far_fog.optical_depth(fog, seen)


# What the numbers mean


def test_the_names_are_the_talks_letter_for_letter():
    assert list(names(FarFog, far_fog.EFFECT.prefix)) == list(TALK)
    assert TALK.keys() <= weather_names().keys()


@pytest.mark.parametrize("column", [0, 1])
def test_the_talks_own_columns_hide_the_horizon_and_show_the_zenith(column):
    cells = {name: values[0] if values[column] is None else values[column] for name, values in TALK.items()}
    fog = keyframes.scene(cells, FLOAT).far_fog
    hidden = -torch.expm1(-depth(fog, view(2.0, [0.0, 1.0], [math.inf, math.inf])))
    assert 0.6 < hidden[0] < 0.95
    assert hidden[1] < 0.1


def test_defaults_are_the_talks_midnight():
    written = keyframes.scene({name: values[0] for name, values in TALK.items()}, FLOAT).far_fog
    for name, value in vars(defaults(FarFog, FLOAT)).items():
        torch.testing.assert_close(getattr(written, name), value, rtol=1e-15, atol=0.0)


@pytest.mark.parametrize("zfar", [201.0, 8e3, 9e4])
def test_a_level_ray_gathers_thickness_times_extinction_from_znear_to_zfar(zfar):
    fog = fog_of(zfar=zfar, thickness=700.0, extinction=2e-3, **EVEN)
    middle = 200.0 + 0.5 * (zfar - 200.0)
    found = depth(fog, view(0.0, 0.0, [0.0, 200.0, middle, zfar, math.inf]))
    torch.testing.assert_close(found, 1.4 * torch.tensor([0.0, 0.0, 0.5, 1.0, 1.0], dtype=FLOAT))


def test_decays_are_e_folds_of_density():
    thin = {"znear": 0.0, "zfar": 1.0} | EVEN
    at = fog_of(**thin | {"height_decay": 0.01, "depth_decay": 0.02, "bottom_height": -80.0})
    found = depth(at, view([0.0, 100.0, -50.0, -80.0, -900.0], 0.0, 1.0)) / 2.0
    folds = torch.tensor([0.0, 1.0, 1.0, 1.6, 1.6], dtype=FLOAT)
    torch.testing.assert_close(found, torch.exp(-folds), rtol=1e-12, atol=0.0)
    by_distance = fog_of(**EVEN | {"distance_decay": 1.0 / 7800.0})
    torch.testing.assert_close(depth(by_distance, view(0.0, 0.0, math.inf)), number(2.0 * -math.expm1(-1.0)))


CHANGES = [
    {},
    {"znear": 0.0, "zfar": 500.0, "height_decay": 0.02, "depth_decay": 0.0},
    {"standard_height": 300.0, "bottom_height": 250.0, "depth_decay": 0.05, "distance_decay": 0.0},
    {"standard_height": -50.0, "bottom_height": 400.0},  # no height between
    {"standard_height": 20.0, "player_relative": 0.7, "height_decay": 0.001},
]


@pytest.mark.parametrize("changed", CHANGES)
def test_closed_form_is_the_march_through_all_heights(changed):
    altitude, up, length = zip(
        *itertools.product((-400.0, -60.0, 30.0, 700.0), (-0.3, -0.01, 0.0, 0.02, 0.8), (300.0, 2.5e3, 9e3)),
        strict=True,
    )
    fog, seen = fog_of(**changed), view(altitude, up, length, player=110.0)
    torch.testing.assert_close(far_fog.render(fog, seen), far_fog.march(fog, seen, 8000), rtol=1e-6, atol=0.0)


def test_the_march_has_converged():
    fog, seen = fog_of(), far_fog.example_inputs(FLOAT)
    coarse, fine, finest = (far_fog.march(fog, seen, steps) for steps in (1000, 2000, 8000))
    assert (fine - finest).abs().max() < 0.5 * (coarse - finest).abs().max() < 1e-7


def test_fog_that_follows_the_player_moves_with_player_and_eye():
    fog, rays = fog_of(player_relative=1.0), ([-0.02, 0.0, 0.01], 4e3)
    low, high = view(30.0, *rays, player=0.0), view(530.0, *rays, player=500.0)
    torch.testing.assert_close(depth(fog, low), depth(fog, high), rtol=1e-12, atol=0.0)
    assert (depth(fog_of(), high) < 0.5 * depth(fog_of(), low)).all()


def test_the_ramp_is_the_closed_form_where_height_does_not_count():
    level = fog_of(height_decay=0.0, depth_decay=0.0)
    seen = far_fog.example_inputs(FLOAT)
    torch.testing.assert_close(far_fog.render_ramp(level, seen), far_fog.render(level, seen), rtol=1e-14, atol=0.0)


def test_opaque_fog_is_the_tinted_light():
    thick, seen = fog_of(extinction=100.0), view(0.0, 0.0, 5e3)
    assert torch.equal(far_fog.render(thick, seen), thick.tint * seen.light)


# Delicate points


def test_fog_without_thickness_leaves_the_background_and_grows_in_proportion():
    seen = view([30.0, -30.0], [0.0, 0.1], [900.0, 7e3])
    assert torch.equal(far_fog.render(fog_of(thickness=0.0), seen), seen.background.expand(2, 3))
    found = torch.func.jacfwd(lambda thickness: depth(replace(fog_of(), thickness=thickness), seen))(number(0.0))
    torch.testing.assert_close(found, depth(fog_of(), seen) / 2000.0)


@pytest.mark.parametrize("rung", ["ramp", "closed form"])
def test_what_is_nearer_than_znear_has_no_fog_and_no_gradient(rung):
    seen, fog = view(30.0, [0.0, -0.01, 0.3], [0.0, 1e-6, 199.0]), fog_of()
    draw = far_fog.EFFECT.rungs[rung]
    assert torch.equal(draw(fog, seen), seen.background.expand(3, 3))
    slopes = torch.func.jacrev(lambda moved: draw(moved, seen))(fog)
    assert all(torch.equal(slope, torch.zeros_like(slope)) for slope in vars(slopes).values())


@pytest.mark.parametrize("rung", ["ramp", "closed form"])
@pytest.mark.parametrize("zfar", [700.0, 300.0])
def test_where_znear_reaches_zfar_a_curtain_hangs_at_znear(rung, zfar):
    curtain, draw = fog_of(znear=700.0, zfar=zfar), far_fog.EFFECT.rungs[rung]
    seen = view(0.0, 0.0, [699.99, 700.0, 5e3])
    clear, *behind = draw(curtain, seen)
    passed = math.exp(-2.0)
    assert torch.equal(clear, seen.background)
    for one in behind:
        torch.testing.assert_close(one, seen.background * passed + 0.5 * seen.light * (1.0 - passed))
    slopes = vars(torch.func.jacrev(lambda moved: draw(moved, seen).sum())(curtain))
    assert all(slope.isfinite().all() for slope in slopes.values())
    assert (slopes["znear"], slopes["zfar"]) == (0.0, 0.0)
    assert slopes["thickness"] != 0.0


def test_the_curtain_is_the_limit_of_a_narrow_span():
    seen = view([0.0, 80.0, -40.0], [0.1, 0.0, -0.2], [710.0, 5e3, math.inf])
    narrow, curtain = fog_of(znear=700.0, zfar=700.0 + 1e-7), fog_of(znear=700.0, zfar=700.0)
    torch.testing.assert_close(depth(narrow, seen), depth(curtain, seen), rtol=1e-8, atol=0.0)


@pytest.mark.parametrize("up", [1e-7, 1e-12, 0.0, -1e-12, -1e-7])
@pytest.mark.parametrize(("altitude", "growth"), [(50.0, 0.003), (-50.0, -0.003)])
def test_slope_of_depth_by_the_climb_of_a_level_ray_is_exact(up, altitude, growth):
    fog = fog_of(distance_decay=0.0)
    found = torch.func.jacfwd(lambda climb: depth(fog, view(altitude, climb, 3200.0)))(number(up))
    # Mean of the distance from 200 to 3200 m, times 3000 of 7800 m.
    wanted = -2.0 * growth * math.exp(-abs(growth * altitude)) * 1700.0 * 3000.0 / 7800.0
    torch.testing.assert_close(found, number(wanted), rtol=1e-3, atol=0.0)


@pytest.mark.parametrize("up", [0.02, -0.02])
@pytest.mark.parametrize("name", ["standard_height", "bottom_height", "height_decay", "depth_decay", "znear"])
def test_slopes_of_a_ray_through_the_heights_match_differences(name, up):
    fog, seen = fog_of(), view(-130.0 if up > 0.0 else 40.0, up, 7.5e3)

    def moved(value):
        return depth(replace(fog, **{name: value}), seen)

    value = getattr(fog, name)
    step = 1e-4 * value.abs().clamp(min=1.0 if value == 0.0 else 0.0)
    wanted = (moved(value + step) - moved(value - step)) / (2.0 * step)
    torch.testing.assert_close(torch.func.jacfwd(moved)(value), wanted, rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize("altitude", [0.0, -100.0])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_rays_along_the_standard_and_the_bottom_height_have_finite_gradients(altitude, dtype):
    seen, fog = view(altitude, [0.0, 1e-9, -1e-9], [0.0, 5e3, math.inf]), fog_of()
    single = {name: part.to(dtype) for name, part in vars(seen).items() if name != "rays"}
    rays = Rays(*(part.to(dtype) for part in vars(seen.rays).values()))
    given = FarFog(**{name: value.to(dtype) for name, value in vars(fog).items()}), FarFogView(rays, **single)
    slopes = torch.func.jacrev(far_fog.optical_depth, argnums=(0, 1))(*given)
    assert all(slope.isfinite().all() for slope in vars(slopes[0]).values())
    assert slopes[1].rays.direction.isfinite().all()
    along = depth(fog, view(altitude, 0.0, 5e3))
    torch.testing.assert_close(depth(fog, view(altitude + 1e-9, 0.0, 5e3)), along, rtol=1e-9, atol=0.0)
