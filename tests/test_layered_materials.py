from dataclasses import replace

import pytest
import torch

from diffrender import surfaces
from diffrender.colour import srgb_decode, srgb_encode
from diffrender.shading import brdf
from diffrender.shading.layered_materials import Part, drawn, written
from diffrender.surfaces import Surface, packed, unpacked
from experiments.ball import ball, studio

FLOAT = torch.float64
BALL = ball(40, 40)
LIGHTS = studio()


def basic(roughness, metallic, base=(0.7, 0.35, 0.12)):
    like = BALL.normal[:, 0]
    colour = like.new_tensor(base).expand_as(BALL.normal).clone()
    return Surface(BALL.normal, colour, torch.full_like(like, roughness), torch.full_like(like, metallic))


def on_table(surface):
    """The ball's surface in its picture, before grey ground that faces the eye."""
    eye = BALL.to_eye[0]
    grey = torch.full((*BALL.shown.shape,), 0.5, dtype=FLOAT)
    ground = Surface(eye.expand(*grey.shape, 3), grey[..., None].expand(*grey.shape, 3), grey, 0.0 * grey)
    return ground, Part(BALL.shown, surface, lambda _, lit: lit)


def moved_by_quantisation(surface):
    """First-order bound on what half steps of a G-buffer's fields move of a picture."""

    def lit(normal, base, roughness, metallic):
        return brdf.lit(Surface(normal, base, roughness, metallic), BALL.to_eye, LIGHTS)

    at = tuple(vars(surface).values())
    still = tuple(torch.zeros_like(one) for one in at)
    across = torch.linalg.cross(surface.normal, BALL.to_eye + surface.normal.roll(1, -1))
    across = across / across.norm(dim=-1, keepdim=True)
    encoded = srgb_encode(surface.base)
    moves = [
        (0, across * surfaces.NORMAL_ERROR),
        (0, torch.linalg.cross(surface.normal, across) * surfaces.NORMAL_ERROR),
        *((1, (srgb_decode(encoded + 0.5 / 255.0) - surface.base) * torch.eye(3, dtype=FLOAT)[c]) for c in range(3)),
        (2, torch.full_like(surface.roughness, 0.5 / 255.0)),
        (3, torch.full_like(surface.metallic, 0.5 / 255.0)),
    ]
    return sum(torch.func.jvp(lit, at, (*still[:field], move, *still[field + 1 :]))[1].abs() for field, move in moves)


@pytest.mark.parametrize("metallic", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("roughness", [0.25, 0.5, 1.0])
def test_deferred_is_forward_but_for_the_stated_quantisation(roughness, metallic):
    surface = basic(roughness, metallic)
    ground, part = on_table(surface)
    deferred = drawn(written(ground, [part]), BALL.to_eye[0].expand(*BALL.shown.shape, 3), LIGHTS, [part])
    forward = brdf.lit(surface, BALL.to_eye, LIGHTS)
    apart, allowed = (deferred[BALL.shown] - forward).abs(), moved_by_quantisation(surface)
    assert apart.max() > 0.0
    assert (apart <= allowed + 1e-4 * forward.max()).all()


def test_forward_passes_draw_in_their_order_over_what_is_kept_of_their_pixels():
    surface = basic(0.3, 0.0)
    ground, part = on_table(surface)
    seen = {}

    def doubled(kept, lit):
        seen["kept"], seen["lit"] = kept, lit
        return 2.0 * lit

    left = (slice(None), slice(0, 20))
    parts = [replace(part, forward=doubled), Part(left, None, lambda _, lit: lit + 1.0)]
    to_eye = BALL.to_eye[0].expand(*BALL.shown.shape, 3)
    buffer = written(ground, parts)
    plain = drawn(buffer, to_eye, LIGHTS, [])
    picture = drawn(buffer, to_eye, LIGHTS, parts)
    expected = torch.where(BALL.shown[..., None], 2.0 * plain, plain)
    expected[left] += 1.0
    torch.testing.assert_close(picture, expected, rtol=0.0, atol=0.0)
    torch.testing.assert_close(seen["lit"], plain[BALL.shown], rtol=0.0, atol=0.0)
    again = unpacked(packed(surface), FLOAT)
    for name, value in vars(seen["kept"]).items():
        assert torch.equal(value, getattr(again, name))


def test_a_frame_has_the_gradient_of_its_lights():
    ground, part = on_table(basic(0.5, 0.3))
    buffer, to_eye = written(ground, [part]), BALL.to_eye[0].expand(*BALL.shown.shape, 3)
    parts = [replace(part, forward=lambda _, lit: lit.square())]

    def mean(irradiance):
        return drawn(buffer, to_eye, replace(LIGHTS, irradiance=irradiance), parts).mean()

    point = LIGHTS.irradiance.clone().requires_grad_()
    assert torch.autograd.gradcheck(mean, point)
