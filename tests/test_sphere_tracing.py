"""Balls and boxes, of which paper knows every hit, normal, derivative and shadow."""

import math

import pytest
import torch

from diffrender.geometry.sphere_tracing import (
    arrived,
    gradient,
    meet,
    nearest_pass,
    openness,
    soft_shadow,
    within_ball,
)
from diffrender.rays import Rays

STEPS = 48


def number(value):
    return torch.tensor(value, dtype=torch.float64)


def ball(radius):
    return lambda place: torch.linalg.vector_norm(place, dim=-1) - radius


def cautious_ball(place):
    """A lower bound as loose as those of fractals."""
    return 0.5 * (torch.linalg.vector_norm(place, dim=-1) - 1.0)


def traced(distance, rays, radius=2.0):
    span = within_ball(rays, number(radius))
    return meet(distance, distance, rays, arrived(distance, rays, span, number(radius), STEPS))


def beside_a_ball(offsets):
    """Rays along x that pass the origin at some offsets."""
    origin = torch.stack([torch.full_like(offsets, -3.0), offsets, torch.zeros_like(offsets)], -1)
    direction = number([1.0, 0.0, 0.0]).expand_as(origin)
    return Rays(origin, direction, torch.full_like(offsets, torch.inf))


@pytest.mark.parametrize("distance", [ball(1.0), cautious_ball], ids=["exact", "cautious"])
def test_rays_meet_a_ball_where_paper_says(distance):
    offsets = number([0.0, 0.5, -0.9, 0.99, 1.001, 1.5, 2.5])
    hit = traced(distance, beside_a_ball(offsets))
    assert hit.is_hit.tolist() == [True] * 4 + [False] * 3
    truth = 3.0 - torch.sqrt(1.0 - offsets[:4] ** 2)
    torch.testing.assert_close(hit.length[:4], truth, atol=1e-9, rtol=0.0)
    torch.testing.assert_close(gradient(ball(1.0), hit.position)[:4], hit.position[:4], atol=1e-9, rtol=0.0)


def test_steps_too_long_are_taken_back():
    # A thin plate beside the ray's way, which a relaxed step from far away would jump over.
    def plate(place):
        return torch.maximum(place[..., 0].abs() - 1e-3, (place[..., 1].abs() - 4.0))

    hit = traced(plate, beside_a_ball(number([0.0, 0.3, 1.0])))
    torch.testing.assert_close(hit.length, number([3.0 - 1e-3] * 3), atol=1e-9, rtol=0.0)


def test_an_eye_inside_and_a_ray_that_is_short_meet_nothing():
    inside = Rays(number([[0.1, 0.0, 0.0]]), number([[1.0, 0.0, 0.0]]), number([torch.inf]))
    short = Rays(number([[-3.0, 0.0, 0.0]]), number([[1.0, 0.0, 0.0]]), number([1.5]))
    assert not traced(ball(1.0), inside).is_hit
    assert not traced(ball(1.0), short).is_hit


@pytest.mark.parametrize("offset", [0.0, 0.5, 0.95])
def test_the_hit_has_the_derivatives_of_the_implicit_function(offset):
    def way(radius, aside):
        rays = beside_a_ball(aside)
        span = within_ball(Rays(rays.origin.detach(), rays.direction, rays.length), number(2.0))
        still = ball(radius.detach())
        fixed = Rays(rays.origin.detach(), rays.direction, rays.length)
        return meet(ball(radius), still, rays, arrived(still, fixed, span, number(2.0), STEPS)).length

    at = number(1.0), number([offset])
    half = math.sqrt(1.0 - offset * offset)
    truth = number([[-1.0 / half], [offset / half]])
    backward = torch.stack([slope.reshape(1) for slope in torch.autograd.functional.jacobian(way, at)])
    torch.testing.assert_close(backward, truth, atol=1e-6, rtol=1e-8)
    forward = [
        torch.func.jvp(way, at, tangent)[1] for tangent in ((number(1.0), number([0.0])), (number(0.0), number([1.0])))
    ]
    torch.testing.assert_close(torch.stack(forward), truth, atol=1e-6, rtol=1e-8)


@pytest.mark.parametrize("height", [1.02, 1.05, 1.2])
def test_shadows_are_as_soft_as_the_nearest_pass_says(height):
    # Least of (|x + t d| - 1) / t over a fine grid of t, from a place behind the ball.
    rays = Rays(number([[-3.0, height, 0.0]]), number([[1.0, 0.0, 0.0]]), number([torch.inf]))
    span = within_ball(rays, number(4.0))
    begin = torch.full_like(span.near, 0.01)
    passing = nearest_pass(ball(1.0), rays, type(span)(begin, span.far), 48)
    along = torch.linspace(0.01, 6.0, 600_001, dtype=torch.float64)
    share = (torch.hypot(along - 3.0, number(height)) - 1.0) / along
    assert float(passing) == pytest.approx(float(along[share.argmin()]), abs=2e-5)
    rise = float(share.min()) / 0.1
    truth = min(rise, 1.0) ** 2 * (3.0 - 2.0 * min(rise, 1.0))
    assert float(soft_shadow(ball(1.0), rays, passing, number(0.1))) == pytest.approx(truth, abs=1e-8)


def test_a_blocked_light_is_dark_and_a_free_one_bright():
    rays = beside_a_ball(number([0.0, 1.9]))
    span = within_ball(rays, number(4.0))
    passing = nearest_pass(ball(1.0), rays, type(span)(torch.full_like(span.near, 0.01), span.far), 48)
    assert soft_shadow(ball(1.0), rays, passing, number(0.1)).tolist() == [pytest.approx(0.0, abs=1e-6), 1.0]


def test_a_plane_sees_the_whole_sky_and_a_corner_less():
    place, up = number([[0.0, 0.0, 0.0]]), number([[0.0, 0.0, 1.0]])

    def plane(at):
        return at[..., 2]

    def corner(at):
        return torch.minimum(at[..., 2], at[..., 0] + 0.1)

    assert openness(plane, place, up, number(1.0)) == pytest.approx(1.0)
    assert 0.1 < openness(corner, place, up, number(1.0)) < 0.8
    # Whatever the scale of the distance.
    assert openness(lambda at: 0.5 * corner(at), place, 0.5 * up, number(1.0)) == pytest.approx(
        float(openness(corner, place, up, number(1.0)))
    )
