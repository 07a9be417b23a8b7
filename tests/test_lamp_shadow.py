import math
from dataclasses import replace

import pytest
import torch

from diffrender.shading import lamp_shadow
from diffrender.shading.lamp_shadow import MARGIN, Shadows, Squares, from_octahedron, on_octahedron

ANY_WAY = torch.nn.functional.normalize(
    torch.randn(2000, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64), dim=-1
)
# Along the axis, to the side, and behind, where the square's edges meet; of radius 0.5, so far away:
BALLS = 2.0 * torch.nn.functional.normalize(
    torch.tensor([[0.1, 0.2, 1.0], [1.0, 0.1, 0.0], [0.3, 0.1, -1.0], [0.0, 0.0, -1.0]]).double(), dim=-1
)


def number(value):
    return torch.tensor(value, dtype=torch.float64)


def shadows(size, cos_outer, way, softness=0.25):
    """Map of one lamp in its own frame, by the way that directions are free."""
    of, span = torch.tensor([size]), lamp_shadow.span(number([cos_outer]), torch.tensor([size]))
    atlas = -way(lamp_shadow.texel_directions(size, span[0]))
    return Shadows(Squares(torch.zeros(1, 2, dtype=torch.long), of, span), atlas, number(softness))


def share(given, place, normal):
    return lamp_shadow.share(given, place[:, None], normal[:, None])[:, 0]


def to_balls(direction):
    along = direction @ BALLS.T
    inside = 0.25 - (BALLS.square().sum(-1) - along.square())
    return torch.where((inside > 0.0) & (along > 0.0), along - inside.clamp(min=0.0).sqrt(), 50.0).amin(-1)


def to_room(direction):
    """Way to the walls of a room in which the lamp is near one side."""
    low, high = number([-0.5, -3.0, -2.0]), number([6.0, 4.0, 2.5])
    return (torch.where(direction < 0.0, low, high) / direction).amin(-1)


def test_the_octahedron_is_unfolded_and_folded_again():
    place = 2.0 * torch.rand(500, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64) - 1.0
    torch.testing.assert_close(on_octahedron(from_octahedron(place)), place)
    torch.testing.assert_close(from_octahedron(on_octahedron(3.0 * ANY_WAY)), ANY_WAY)


def test_margins_go_on_without_a_gap():
    edge = torch.linspace(-1.0, 1.0, 101).double()
    for sign in (-1.0, 1.0):
        at, beyond = (torch.stack([torch.full_like(edge, sign * out), edge], -1) for out in (1.0 - 1e-6, 1.0 + 1e-6))
        for turned in (lambda place: place, lambda place: place.flip(-1)):
            apart = from_octahedron(turned(at)) - from_octahedron(turned(beyond))
            assert apart.norm(dim=-1).max() < 1e-5


@pytest.mark.parametrize("half", [0.2, 0.8, 1.5])
def test_a_spots_square_holds_its_cone_and_little_more(half):
    size = torch.tensor([32])
    span = lamp_shadow.span(number([math.cos(half)]), size)
    turn = torch.linspace(0.0, 2.0 * math.pi, 400).double()
    rim = torch.stack([math.sin(half) * turn.cos(), math.sin(half) * turn.sin(), math.cos(half) + 0.0 * turn], -1)
    reached = float((on_octahedron(rim) / span).abs().max())
    assert reached == pytest.approx(1.0 - 2 * MARGIN / 32)


def test_balls_shade_what_lies_behind_them_in_all_directions():
    given = shadows(256, -2.0, to_balls)
    place = 4.0 * ANY_WAY
    found = share(given, place, -ANY_WAY)
    cosine = (ANY_WAY @ BALLS.T / 2.0).clamp(-1.0, 1.0)
    beside = (torch.acos(cosine) - math.asin(0.25)).amin(-1)  # angle from the nearest edge of a shadow
    edge = 3.0 * 3.0 * 2.0 / 256
    assert (found[beside < -edge] < 1e-3).all()
    assert (found[beside > edge] > 1.0 - 1e-3).all()
    assert (beside < -edge).sum() > 20
    # In front of the balls all is lit.
    assert (share(given, 1.0 * ANY_WAY, -ANY_WAY) > 1.0 - 1e-3).all()


@pytest.mark.parametrize(("size", "cos_outer"), [(64, -2.0), (256, -2.0), (64, 0.3)])
def test_walls_do_not_shade_themselves(size, cos_outer):
    inside = ANY_WAY[ANY_WAY[:, 2] > cos_outer]
    way = to_room(inside)
    place = inside * way[:, None]
    bounds = torch.stack([number([-0.5, -3.0, -2.0]), number([6.0, 4.0, 2.5])])
    apart = (place[:, None] - bounds).abs().flatten(1)
    normal = torch.cat([torch.eye(3), -torch.eye(3)]).double()[apart.argmin(-1)]
    # Near corners of the room a place's texels are of another wall.
    is_plain = apart.sort(-1).values[:, 1] > 0.5
    found = share(shadows(size, cos_outer, to_room), place, normal)[is_plain]
    assert found.min() > 0.8
    assert found.mean() > 0.98


def test_other_lamps_squares_do_not_reach_over():
    given = shadows(32, -2.0, to_balls)
    whole = torch.full((96, 96), -1e-3, dtype=torch.float64)
    whole[32:64, 32:64] = given.atlas
    moved = replace(given, squares=replace(given.squares, corner=torch.tensor([[32, 32]])), atlas=whole)
    place = 4.0 * ANY_WAY
    assert torch.equal(share(moved, place, -ANY_WAY), share(given, place, -ANY_WAY))


def test_gradients_match_differences():
    given = shadows(64, -2.0, to_balls, softness=3.0)
    place = 4.0 * ANY_WAY
    place = place[(share(given, place, -ANY_WAY) - 0.5).abs() < 0.4][:8]
    assert len(place) == 8
    normal = -place / 4.0

    def draw(place, atlas, softness):
        return share(replace(given, atlas=atlas, softness=softness), place, normal)

    leaves = [leaf.clone().requires_grad_() for leaf in (place, given.atlas, given.softness)]
    assert torch.autograd.gradcheck(draw, leaves, check_forward_ad=True, check_batched_grad=True, fast_mode=True)
    slopes = torch.autograd.grad(draw(*leaves).sum(), leaves)
    assert all((slope != 0.0).any() for slope in slopes)


def test_a_place_in_the_lamp_is_lit_and_its_gradient_finite():
    given = shadows(32, -2.0, to_balls)
    place = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    found = share(given, place, ANY_WAY[:1])
    found.sum().backward()
    assert float(found.detach()) == pytest.approx(1.0)
    assert place.grad.isfinite().all()
