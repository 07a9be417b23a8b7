import math
from dataclasses import replace

import pytest
import torch

from diffrender.parameters import defaults, names, specifications
from diffrender.rays import Perspective, pixel_centres
from diffrender.scene import weather_names
from diffrender.weather import rain, rain_tiles
from diffrender.weather.rain_drops import Drops, Moment, Rain, alive, enough, falls, living, place, shifted, thrown
from diffrender.weather.rain_landing import NEVER, Obstacles, height_under, heights_from_above, landing_age, level_share
from diffrender.weather.rain_splashes import SPLASH
from diffrender.weather.rain_streaks import DARKEST, Streaks
from diffrender.weather.rain_tiles import Screen, unhidden

FLOAT = torch.float64
# Of the talk's weather file.
TALK = {
    "RAIN_PARTICLE_EMIT_RATE": 0.0,
    "RAIN_DEPTH_MAP_RADIUS": 100.0,
    "RAIN_EMIT_RADIUS": 30.0,
    "RAIN_EMIT_HEIGHT": 50.0,
    "RAIN_EMIT_SPEED": 40.0,
    "RAIN_EMIT_SPEEDRANDOM": 10.0,
    "RAIN_EMIT_SPREAD": 0.003,
    "RAIN_LIFE_SPAN": 3.0,
    "RAIN_GRAVITY": 10.0,
}
ROOF = 4.0  # height of the roof, a square of 10 m round (12, 0)


def vector(*numbers):
    return torch.tensor(numbers, dtype=FLOAT)


def rain_of(**changed):
    return replace(defaults(Rain, FLOAT), **{name: vector(value)[0] for name, value in changed.items()})


def moment_of(**changed):
    eye = vector(0.0, 0.0, 1.7)
    nothing = torch.zeros(3, dtype=FLOAT)
    moment = Moment(eye, nothing, eye, vector(7.3)[0], vector(0.02)[0], nothing)
    return replace(moment, **changed)


def some(count, seed=0):
    return thrown(count, torch.Generator().manual_seed(seed), FLOAT)


def roofed(place):
    return ROOF * ((place - vector(12.0, 0.0)).abs() <= 5.0).all(-1)


def obstacles(surface=roofed, size=400, **changed):
    centre = torch.zeros(2, dtype=FLOAT)
    heights = heights_from_above(surface, centre, vector(100.0)[0], size).to(FLOAT)
    nobody = torch.zeros(0, 3, dtype=FLOAT)
    return replace(Obstacles(heights, centre, nobody, nobody, torch.zeros(0, dtype=FLOAT)), **changed)


def screen(width=48, height=32, field=1.2, distance=math.inf):
    direction = Perspective(width, height, field).direction(
        *pixel_centres(Perspective(width, height, field), slice(None), torch.zeros((), dtype=FLOAT))
    )
    return Screen(direction, torch.full((height, width), distance, dtype=FLOAT), vector(field / width)[0])


def view_of(drops, moment, **changed):
    seen = screen()
    dark = torch.zeros(*seen.distance.shape, 3, dtype=FLOAT)
    view = rain.RainView(
        drops, obstacles(), moment, vector(0.02)[0], vector(50.0)[0], seen, dark, torch.ones(1, 1, 3, dtype=FLOAT)
    )
    return replace(view, **changed)


# What the numbers mean


def test_the_names_are_the_talks_letter_for_letter_and_its_values_are_allowed():
    assert list(names(Rain, rain.EFFECT.prefix)) == list(TALK)
    known = weather_names()
    for name, value in TALK.items():
        low, high = known[name].file_bounds
        assert low <= value <= high
        assert known[name].default == value or name == "RAIN_PARTICLE_EMIT_RATE"


def test_as_many_live_as_the_rate_sends_in_a_life():
    for rate in (0.0, 3.0, 700.0):
        some_rain = rain_of(particle_emit_rate=rate)
        drops = some(int(enough(some_rain)))
        in_square = float(alive(some_rain)) / (math.pi / 4.0)
        assert float(living(some_rain, drops).sum()) == pytest.approx(in_square, rel=1e-3, abs=1e-9)


def test_drops_are_spread_evenly_over_the_disc():
    drops = some(20000)
    fall = falls(rain_of(), drops, moment_of(wind=vector(6.0, -3.0, 0.0)))
    far = torch.linalg.vector_norm(place(fall, fall.age)[:, :2], dim=-1)
    inside = [float((far < radius).double().mean()) for radius in (10.0, 20.0, 30.0)]
    assert inside == pytest.approx([math.pi / 4.0 * (radius / 30.0) ** 2 for radius in (10.0, 20.0, 30.0)], rel=0.05)


def test_the_number_alive_has_the_gradient_of_rate_times_life():
    rate = torch.tensor(200.0, dtype=FLOAT, requires_grad=True)
    some_rain = replace(rain_of(), particle_emit_rate=rate)
    living(some_rain, some(2000)).sum().backward()
    assert float(rate.grad) == pytest.approx(3.0 / (math.pi / 4.0), rel=1e-2)


@pytest.mark.parametrize("rung", rain.EFFECT.rungs)
def test_without_drops_nothing_is_drawn(rung):
    view = view_of(some(500), moment_of())
    drawn = rain.EFFECT.rungs[rung](rain_of(particle_emit_rate=0.0), view)
    assert torch.equal(drawn, view.background)


def test_a_drop_falls_as_gravity_says():
    still = rain_of(emit_spread=0.0, emit_speedrandom=0.0)
    fall = falls(still, some(50), moment_of())
    low, high = (place(fall, fall.age + step)[:, 2] for step in (0.0, 0.1))
    torch.testing.assert_close(low - high, 0.1 * (40.0 + 10.0 * (fall.age + 0.05)))


# Camera


def test_drops_stand_still_in_the_world_while_the_camera_moves():
    drops, step = some(500), vector(0.4, -0.3, 0.0)
    before, after = (falls(rain_of(), drops, moment_of(eye=vector(0.0, 0.0, 1.7) + share * step)) for share in (0, 1))
    apart = place(after, after.age) + step - place(before, before.age)
    stays = torch.linalg.vector_norm(place(before, before.age)[:, :2], dim=-1) < 29.0
    torch.testing.assert_close(apart[stays], torch.zeros_like(apart[stays]), atol=1e-9, rtol=0.0)


def test_a_picture_is_the_same_after_a_warp():
    drops, move = some(4000), vector(173.0, -41.0, 12.0)
    eye = vector(0.0, 0.0, 1.7)
    ground = obstacles()
    bodies = {"body": vector(6.0, 0.0, 1.0)[None], "body_velocity": torch.zeros(1, 3, dtype=FLOAT)}
    ground = replace(ground, **bodies, body_radius=vector(0.5))
    moved = replace(ground, heights=ground.heights + move[2], centre=ground.centre + move[:2], body=ground.body + move)
    emitter = shifted(eye, move, vector(5.0)[0])
    view = view_of(drops, moment_of(eye=eye, emitter=eye), obstacles=ground)
    warped = replace(view, moment=moment_of(eye=eye + move, emitter=emitter), obstacles=moved)
    before, after = (rain.render(rain_of(), one) for one in (view, warped))
    assert float(before.max()) > 0.05
    torch.testing.assert_close(after, before, atol=1e-9, rtol=0.0)
    left_behind = replace(warped, moment=moment_of(eye=eye + move, emitter=eye))
    assert float((rain.render(rain_of(), left_behind) - before).abs().max()) > 0.05


def test_a_streak_is_as_long_as_the_way_relative_to_the_eye():
    moment = moment_of(velocity=vector(3.0, 0.0, -2.0), wind=vector(0.0, 5.0, 0.0))
    view = view_of(some(300), moment)
    fall = falls(rain_of(emit_spread=0.0), view.drops, moment)
    drawn = rain.falling(fall, view, torch.full_like(fall.age, NEVER))
    down = fall.velocity[:, 2] - 10.0 * (fall.age - 0.01)
    wanted = 0.02 * torch.stack([torch.full_like(down, -3.0), torch.full_like(down, 5.0), down + 2.0], -1)
    whole = fall.age > 0.02
    torch.testing.assert_close(drawn.way[whole], wanted[whole])


# Landing


def test_drops_land_on_flat_ground_when_they_have_fallen_as_far():
    fall = falls(rain_of(), some(200), moment_of())
    speed = -fall.velocity[:, 2]
    wanted = (torch.sqrt(speed**2 + 2.0 * 10.0 * (50.0 + 1.7)) - speed) / 10.0
    flat = obstacles(lambda place: 0.0 * place[..., 0])
    torch.testing.assert_close(landing_age(rain_of(), fall, flat, vector(0.0, 0.0, 1.7)), wanted)


@pytest.mark.parametrize("wind", [0.0, 30.0, -30.0])
def test_no_path_goes_through_a_roof(wind):
    moment = moment_of(wind=vector(wind, 0.0, 0.0))
    some_rain, ground = rain_of(), obstacles()
    fall = falls(some_rain, some(6000), moment)
    landed = landing_age(some_rain, fall, ground, moment.eye)
    over = []
    for share in torch.linspace(0.8, 1.0, 60, dtype=FLOAT):
        there = place(fall, share * landed)
        over.append(there[:, 2] - height_under(some_rain, ground, moment.eye, there))
    assert float(torch.stack(over).min()) > -0.02
    there = place(fall, landed)
    at_height = there[:, 2] + 1.7
    is_under = ((there[:, :2] - vector(12.0, 0.0)).abs() < 4.0).all(-1)
    assert int(is_under.sum()) > 20
    assert float((at_height[is_under] - ROOF).abs().max()) < 0.02
    # Its lee is as dry as the wind is strong; no drop comes faster than 60 m/s.
    to_lee = (there[:, 0] - 12.0) * math.copysign(1.0, wind)
    lee = (to_lee > 5.5) & (to_lee < 4.7 + ROOF * abs(wind) / 60.0) & (there[:, 1].abs() < 4.0)
    assert int((lee & (at_height < 0.1)).sum()) == 0


def test_drops_land_on_a_moving_sphere_where_it_was_then():
    centre, velocity = vector(8.0, 1.0, 4.0), vector(-4.0, 2.0, 0.5)
    ground = obstacles(body=centre[None], body_velocity=velocity[None], body_radius=vector(2.0))
    moment = moment_of(wind=vector(3.0, 0.0, 0.0))
    fall = falls(rain_of(), some(20000), moment)
    landed = landing_age(rain_of(), fall, ground, moment.eye)
    without = landing_age(rain_of(), fall, obstacles(), moment.eye)
    hit = landed < without - 1e-9
    assert int(hit.sum()) > 50
    then = centre - moment.eye - velocity * (fall.age - landed)[:, None]
    far = torch.linalg.vector_norm(place(fall, landed) - then, dim=-1)[hit]
    torch.testing.assert_close(far, torch.full_like(far, 2.0), atol=2e-3, rtol=0.0)


def test_heights_are_found_where_they_were_measured():
    def slope(place):
        return 0.3 * place[..., 0] - 0.1 * place[..., 1]

    there = vector(3.0, -7.0, 0.0)[None]
    eye = vector(1.0, 2.0, 1.7)
    found = height_under(rain_of(), obstacles(slope), eye, there)
    assert float(found) == pytest.approx(0.3 * 4.0 + 0.1 * 5.0 - 1.7)


def test_the_age_of_landing_has_the_gradient_of_its_path():
    moment = moment_of(wind=vector(9.0, 2.0, 0.0))
    drops, ground = some(40), obstacles(lambda place: torch.sin(0.2 * place[..., 0]), size=100)

    def landed(speed, gravity, heights):
        some_rain = replace(rain_of(), emit_speed=speed, gravity=gravity)
        fall = falls(some_rain, drops, moment)
        return landing_age(some_rain, fall, replace(ground, heights=heights), moment.eye)

    given = vector(40.0)[0].requires_grad_(), vector(10.0)[0].requires_grad_(), ground.heights.requires_grad_()
    assert torch.autograd.gradcheck(landed, given, fast_mode=True, rtol=1e-3)


@pytest.mark.parametrize("dtype", [torch.float32, FLOAT])
def test_level_ground_that_rises_is_met_sooner(dtype):
    ground = torch.zeros(20, 20, dtype=dtype, requires_grad=True)
    nobody, centre = torch.zeros(0, 3, dtype=dtype), torch.zeros(2, dtype=dtype)
    level = Obstacles(ground, centre, nobody, nobody, nobody[:, 0])
    eye = torch.tensor([0.0, 0.0, 1.7], dtype=dtype)
    nothing = torch.zeros(3, dtype=dtype)
    time = torch.tensor(7.3, dtype=dtype)
    some_rain = defaults(Rain, dtype)
    fall = falls(some_rain, thrown(50, torch.Generator(), dtype), Moment(eye, nothing, eye, time, 0.01 * time, nothing))
    landed = landing_age(some_rain, fall, level, eye)
    (slope,) = torch.autograd.grad(landed.sum(), ground)
    sinks = 10.0 * landed - fall.velocity[:, 2]
    torch.testing.assert_close(slope.sum(), -(1.0 / sinks).sum())


@pytest.mark.parametrize("still", [{"emit_speed": 0.0, "emit_speedrandom": 0.0, "gravity": 0.0}])
def test_drops_that_hang_never_land(still):
    hanging = rain_of(**still)
    fall = falls(hanging, some(20), moment_of())
    landed = landing_age(hanging, fall, obstacles(), vector(0.0, 0.0, 1.7))
    assert torch.equal(landed, torch.full_like(landed, NEVER))


# Splashes


def test_splashes_begin_where_drops_land_and_last_their_time():
    moment = moment_of(exposure=vector(0.0)[0])
    view = view_of(some(3000), moment)
    fall = falls(rain_of(), view.drops, moment)
    landed = landing_age(rain_of(), fall, view.obstacles, moment.eye)
    drawn = rain.splashing(rain_of(), fall, view, landed)
    there, weight = drawn.start.unflatten(0, (3000, -1)), drawn.weight.unflatten(0, (3000, -1))
    since = fall.age - landed
    is_level = level_share(rain_of(), view.obstacles, moment.eye, place(fall, landed)) > 0.0
    is_there = (since > 0.0) & (since <= SPLASH) & (fall.weight > 0.0) & is_level
    assert torch.equal(weight > 0.0, is_there[:, None].expand_as(weight))
    off = torch.linalg.vector_norm(there.mean(1) - place(fall, landed), dim=-1)[is_there]
    assert float(off.max()) < 0.1
    assert int(is_there.sum()) > 100


def test_nothing_splashes_in_the_air_beside_a_roof():
    moment = moment_of(wind=vector(30.0, 0.0, 0.0), exposure=vector(0.0)[0])
    view = view_of(some(20000), moment)
    fall = falls(rain_of(), view.drops, moment)
    landed = landing_age(rain_of(), fall, view.obstacles, moment.eye)
    drawn = rain.splashing(rain_of(), fall, view, landed)
    height = place(fall, landed)[:, 2] + 1.7
    between = (height > 0.3) & (height < ROOF - 0.3)
    assert int(between.sum()) > 20
    assert float(drawn.weight.unflatten(0, (20000, -1))[between].max()) == 0.0


def test_a_streak_ends_where_its_drop_lands_and_its_splash_begins_there():
    drops = some(1)
    still = rain_of(emit_spread=0.0)
    fall = falls(still, drops, moment_of())
    ages = torch.linspace(-0.05, 0.05, 11, dtype=FLOAT)
    for age in ages:
        view = view_of(drops, moment_of())
        landed = fall.age - age
        falling, splash = rain.falling(fall, view, landed), rain.splashing(still, fall, view, landed)
        shares = falling.weight[0], splash.weight[0]
        wanted = (0.02 - float(age.clamp(0.0, 0.02))) / 0.02
        torch.testing.assert_close(torch.stack(shares), vector(wanted, 1.0 - wanted) * fall.weight[0])


# What a pixel sees


@pytest.mark.parametrize("way", [(0.0, 0.0, 0.0), (0.0, 0.1, -0.6), (1.5, 0.0, -0.1)])
@pytest.mark.parametrize("radius", [0.002, 0.05, 0.4])
def test_a_drop_hides_its_solid_angle_however_it_moves(way, radius):
    start = vector(6.0, 0.2, 0.3) - vector(*way) / 2.0
    streak = Streaks(start[None], vector(*way)[None], vector(radius), vector(1.0), vector(1.0)[0])
    seen = screen(160, 120, 0.9)
    x, y = pixel_centres(Perspective(160, 120, 0.9), slice(None), torch.zeros((), dtype=FLOAT))
    hidden = 1.0 - unhidden(streak, seen)
    total = (hidden * Perspective(160, 120, 0.9).solid_angle(x, y)).sum() / DARKEST
    depth = start + torch.linspace(0.0, 1.0, 1001, dtype=FLOAT)[:, None] * vector(*way)
    wanted = (math.pi * radius**2 / depth.square().sum(-1)).mean()
    assert float(total) == pytest.approx(float(wanted), rel=0.05)  # a pixel's filter is sampled once a pixel
    assert 0.0 <= float(hidden.min()) <= float(hidden.max()) <= DARKEST + 1e-12


def test_many_drops_in_one_hide_the_same_one_after_the_other():
    streak = Streaks(vector(5.0, 0.0, 0.0)[None], vector(0.0, 0.0, 1.0)[None], vector(0.1), vector(1.0), vector(1.0)[0])
    one, three = (unhidden(replace(streak, number=vector(number)[0]), screen()) for number in (1.0, 3.0))
    torch.testing.assert_close(three, one**3)


def test_what_is_behind_the_scene_or_the_eye_is_not_seen():
    for start, distance in ((8.0, 5.0), (-8.0, math.inf), (0.1, math.inf)):
        streak = Streaks(
            vector(start, 0.0, 0.0)[None], vector(0.0, 0.0, 0.5)[None], vector(0.2), vector(1.0), vector(1.0)[0]
        )
        assert torch.equal(unhidden(streak, screen(distance=distance)), torch.ones(32, 48, dtype=FLOAT))


def scattered(count):
    """Rain of a heavy storm near the eye."""
    throw = torch.Generator().manual_seed(0)
    there = 30.0 * torch.rand(count, 3, generator=throw, dtype=FLOAT) - 15.0
    way = vector(0.3, 0.1, -0.8) + 0.1 * torch.rand(count, 3, generator=throw, dtype=FLOAT)
    one = torch.ones(count, dtype=FLOAT)
    return Streaks(there, way, 0.004 * one, one, vector(300.0)[0])


def test_tiles_draw_what_all_streaks_draw():
    streaks, seen = scattered(700), screen()
    whole = unhidden(streaks, seen, nearest=700)
    assert float(whole.min()) < 0.9
    torch.testing.assert_close(unhidden(streaks, seen, nearest=80), whole, atol=2e-3, rtol=0.0)


def test_streaks_out_of_the_picture_are_left_out_first(monkeypatch):
    streaks, seen = scattered(1000), screen()
    whole = unhidden(streaks, seen)
    monkeypatch.setattr(rain_tiles, "MOST", 250)
    torch.testing.assert_close(unhidden(streaks, seen), whole, atol=1e-3, rtol=0.0)


def test_a_picture_drawn_in_more_pieces_is_the_same(monkeypatch):
    streaks, seen = scattered(300), screen(50, 21)
    whole = unhidden(streaks, seen)
    monkeypatch.setattr(rain_tiles, "AT_ONCE", 1)
    torch.testing.assert_close(unhidden(streaks, seen), whole, rtol=1e-12, atol=0.0)


def test_a_panorama_shows_drops_all_round():
    around = torch.linspace(0.0, 2.0 * math.pi, 48, dtype=FLOAT)
    direction = torch.stack([torch.cos(around), torch.sin(around), 0.0 * around], -1)[None]
    seen = Screen(direction, torch.full((1, 48), math.inf, dtype=FLOAT), vector(2.0 * math.pi / 48)[0])
    there = 4.0 * direction[0, ::4]
    one = torch.ones(len(there), dtype=FLOAT)
    hidden = 1.0 - unhidden(Streaks(there, 0.0 * there, 0.3 * one, one, vector(1.0)[0]), seen)
    assert float(hidden[0, ::4].min()) > 0.05


def test_dice_are_of_the_generator_alone():
    first, again, other = some(9), some(9), some(9, seed=1)
    assert torch.equal(first.chance, again.chance)
    assert not torch.equal(first.chance, other.chance)
    assert isinstance(first, Drops)
    assert specifications(Rain)["life_span"].bounds[0] > 0.0
