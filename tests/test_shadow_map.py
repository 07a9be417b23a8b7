import math

import pytest
import torch

from diffrender.geometry import shadow_map
from diffrender.geometry.light_grid import Depths
from diffrender.geometry.shadow_map import Camera
from diffrender.rays import from_angles

SUN = from_angles(*torch.tensor([[0.6], [0.4]], dtype=torch.float64))[0]
UP = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
BALL = torch.tensor([6.0, 0.5, 3.0], dtype=torch.float64)  # of radius 1, over ground at 0


def number(value):
    return torch.tensor(value, dtype=torch.float64)


def camera(eye=(0.0, 0.0, 2.0), turn=0.0):
    forward = from_angles(number([-0.1]), number([turn]))[0]
    return Camera(number(eye), forward, number(0.8))


def ball_map(seen):
    """Heights of a ball over ground, ray by ray."""
    rays = shadow_map.texel_rays(seen, 50.0)
    to_ground = rays.origin[..., 2] / -rays.direction[..., 2]
    away = BALL - rays.origin
    along = (away * rays.direction).sum(-1)
    inside = 1.0 - (away.square().sum(-1) - along.square())
    to_ball = torch.where(inside > 0.0, along - inside.clamp(min=0.0).sqrt(), math.inf)
    return 50.0 - torch.minimum(to_ground, to_ball)


def shade(position):
    """How far from the axis of the ball's shadow places on the ground are, over its radius."""
    away = position - BALL
    return torch.linalg.cross(away, SUN.expand_as(away)).norm(dim=-1)


def ground(count=60):
    x, y = torch.meshgrid(
        torch.linspace(0.5, 8.0, count).double(), torch.linspace(-4.0, 4.0, count).double(), indexing="ij"
    )
    return torch.stack([x, y, 0.0 * x], -1)


SEEN = shadow_map.cascade(camera(), (0.5, 12.0), SUN, 512)


def test_splits_are_those_published():
    assert shadow_map.splits(1.0, 16.0, 4, 0.0) == pytest.approx((1.0, 2.0, 4.0, 8.0, 16.0))
    assert shadow_map.splits(1.0, 17.0, 4, 1.0) == pytest.approx((1.0, 5.0, 9.0, 13.0, 17.0))


@pytest.mark.parametrize("turn", [0.0, 0.7, 3.0])
@pytest.mark.parametrize("piece", [(0.1, 5.0), (5.0, 60.0), (60.0, 61.0)])
def test_a_cascade_holds_its_piece_of_the_view(piece, turn):
    eyes = camera(turn=turn)
    seen = shadow_map.cascade(eyes, piece, SUN, 256)
    right = torch.linalg.cross(eyes.forward, UP)
    right = right / right.norm()
    up = torch.linalg.cross(right, eyes.forward)
    corners = []
    for depth in piece:
        for across, rise in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            side = depth * 0.8 / math.sqrt(2.0)
            corners.append(eyes.eye + depth * eyes.forward + side * (across * right + rise * up))
    place = shadow_map.on_map(seen, torch.stack(corners))[:, :2]
    assert ((place >= 0.0) & (place <= 255.0)).all()


def test_texels_stay_where_they_are_in_the_world_while_the_camera_moves():
    place = number([3.0, -1.0, 0.5])
    at = []
    for step in range(20):
        moved = camera(eye=(0.006 * step, 0.004 * step, 2.0), turn=0.02 * step)
        seen = shadow_map.cascade(moved, (0.5, 12.0), SUN, 512)
        assert seen.texel == SEEN.texel
        at.append(shadow_map.on_map(seen, place))
    fraction = torch.stack(at)[:, :2] % 1.0
    torch.testing.assert_close(fraction, fraction[:1].expand_as(fraction), rtol=0.0, atol=1e-6)
    assert len({tuple(one.round().tolist()) for one in at}) > 5  # it did move


def test_texel_rays_are_where_places_are_on_the_map():
    rays = shadow_map.texel_rays(SEEN, 7.0)
    found = shadow_map.on_map(SEEN, rays.origin)
    count = torch.arange(512, dtype=torch.float64)
    torch.testing.assert_close(found[..., 0], count[:, None].expand(512, 512))
    torch.testing.assert_close(found[..., 1], count.expand(512, 512))
    torch.testing.assert_close(found[..., 2], torch.full((512, 512), 7.0).double())


def test_a_ball_shades_the_ground_behind_it():
    place = ground()
    seen = shadow_map.visibility(ball_map(SEEN), SEEN, place, number(0.2), number(0.02))
    away, edge = shade(place), 3.0 * float(SEEN.texel)
    assert (seen[away < 1.0 - edge] < 1e-6).all()
    assert (seen[away > 1.0 + edge] > 1.0 - 1e-3).all()
    assert (away < 1.0).sum() > 50


def test_soft_comparison_tends_to_the_share_of_texels_that_are_lit():
    heights = torch.zeros(512, 512).double()
    heights[:, 256:] = 5.0
    middle = shadow_map.texel_rays(SEEN, 1.0).origin[100, 254:259]
    found = shadow_map.visibility(heights, SEEN, middle, number(0.0), number(1e-3))
    assert found.tolist() == pytest.approx([1.0, 2.0 / 3.0, 1.0 / 3.0, 0.0, 0.0])


def test_comparison_has_the_gradient_of_its_differences():
    seen = shadow_map.cascade(camera(), (0.5, 12.0), SUN, 64)
    heights, draw = ball_map(seen), torch.Generator().manual_seed(0)
    place = ground(60)[(shade(ground(60)) - 1.0).abs() < 0.03][:6]
    place = place + 0.01 * torch.rand(place.shape, generator=draw, dtype=torch.float64)

    def compare(position, softness, raised):
        return shadow_map.visibility(heights + raised, seen, position, number(0.1), softness)

    leaves = [leaf.requires_grad_() for leaf in (place, number(0.5), number(0.0))]
    assert torch.autograd.gradcheck(compare, leaves, check_forward_ad=True, check_batched_grad=True, fast_mode=True)
    assert torch.autograd.grad(compare(*leaves).sum(), leaves[2])[0] < -0.01


def test_all_is_lit_off_the_map():
    heights = torch.full((512, 512), 1e3).double()
    far = SEEN.middle + 600.0 * SEEN.texel * SEEN.right
    assert shadow_map.visibility(heights, SEEN, far, number(0.0), number(0.1)) == 1.0


def test_cascades_give_way_to_the_next_over_their_last_tenth():
    pieces = Depths(number([0.0, 10.0, 30.0]), number([10.0, 30.0, 100.0]))
    depth = number([1.0, 9.0, 9.5, 10.0, 27.9, 29.0, 30.0, 500.0])
    shares = [torch.full_like(depth, share) for share in (0.0, 1.0, 3.0)]
    found = shadow_map.cascaded(shares, pieces, depth)
    assert found.tolist() == pytest.approx([0.0, 0.0, 0.5, 1.0, 1.0, 2.0, 3.0, 3.0])


def test_a_sun_at_the_zenith_has_a_map():
    seen = shadow_map.cascade(camera(), (0.5, 12.0), UP, 64)
    axes = torch.stack([seen.right, seen.down, seen.to_sun])
    torch.testing.assert_close(axes @ axes.T, torch.eye(3).double())
