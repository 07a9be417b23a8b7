import math
from dataclasses import replace

import pytest
import torch

from diffrender.atmosphere import froxel_lights, scattering
from diffrender.atmosphere.froxel_lights import LocalLights, Shadow, Sunlight
from diffrender.atmosphere.froxel_shadow import light_box, percentage_closer
from diffrender.rays import from_angles
from diffrender.spherical_harmonics import basis

FLOAT = torch.float64
G = torch.tensor(0.6, dtype=FLOAT)
EAST = torch.tensor([1.0, 0.0, 0.0], dtype=FLOAT)


def lamp(**changed):
    numbers = {
        "position": [[4.0, 0.0, 0.0]], "intensity": [[8.0, 4.0, 2.0]], "size": [1e-3], "reach": [1e6],
        "ahead": [[0.0, 0.0, -1.0]], "cos_edge": [-2.0], "cos_full": [-1.0], "share": [1.0],
    }  # fmt: skip
    return LocalLights(**{name: torch.tensor(value, dtype=FLOAT) for name, value in (numbers | changed).items()})


def phase(cosine):
    return scattering.henyey_greenstein(torch.tensor(2.0 - 2.0 * cosine, dtype=FLOAT), G)


def test_a_point_light_falls_off_by_the_square_and_is_brightest_towards_it():
    position = torch.tensor([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [12.0, 0.0, 0.0]], dtype=FLOAT)
    found = froxel_lights.of_local(lamp(), G, position, EAST)[:, 0]
    wanted = torch.stack([phase(1.0) * 8.0 / 16.0, phase(1.0) * 8.0 / 4.0, phase(-1.0) * 8.0 / 64.0])
    torch.testing.assert_close(found, wanted, rtol=1e-5, atol=0.0)


def test_a_light_ends_at_its_reach_without_a_kink():
    ending = lamp(reach=[3.0])

    def light(distance):
        return froxel_lights.of_local(ending, G, torch.stack([4.0 - distance, distance * 0, distance * 0]), EAST)[0]

    distance = torch.tensor([2.999, 3.0, 9.0], dtype=FLOAT)
    assert torch.func.vmap(light)(distance)[1:].tolist() == [0.0, 0.0]
    assert float(torch.func.vmap(torch.func.grad(light))(distance)[0].abs()) < 1e-2


def test_a_spot_shines_in_its_cone_alone():
    spot = lamp(cos_edge=[0.8], cos_full=[0.9])
    below, edge, beside = (torch.tensor([4.0 + x, 0.0, -2.0], dtype=FLOAT) for x in (0.1, 1.2, 3.0))
    inside, half, outside = (froxel_lights.of_local(spot, G, at, EAST)[0] for at in (below, edge, beside))
    point = [froxel_lights.of_local(lamp(), G, at, EAST)[0] for at in (below, edge)]
    assert float(inside / point[0]) == pytest.approx(1.0)
    assert 0.0 < float(half / point[1]) < 1.0
    assert float(outside) == 0.0


def test_each_light_counts_by_its_own_share():
    pair = {name: torch.cat([value, value]) for name, value in vars(lamp()).items()}
    both = LocalLights(**pair | {"share": torch.tensor([1.0, 0.25], dtype=FLOAT)})
    alone, together = (froxel_lights.of_local(one, G, torch.zeros(3, dtype=FLOAT), EAST) for one in (lamp(), both))
    torch.testing.assert_close(together, 1.25 * alone)


def test_the_midst_of_a_lamp_is_finite_with_its_gradient():
    inside = lamp(size=[0.5])
    at = inside.position[0].clone().requires_grad_()
    found = froxel_lights.of_local(inside, G, at, EAST)
    torch.testing.assert_close(
        found,
        scattering.henyey_greenstein(torch.tensor(2.0).double(), G) * 32.0 * torch.tensor([1.0, 0.5, 0.25]).double(),
    )
    assert torch.autograd.grad(found.sum(), at)[0].isfinite().all()


def sphere(count):
    height = (torch.arange(count, dtype=FLOAT) + 0.5) * (2.0 / count) - 1.0
    turn = torch.arange(2 * count, dtype=FLOAT) * (math.pi / count)
    return from_angles(*torch.meshgrid(torch.asin(height), turn, indexing="ij")).reshape(-1, 3)


@pytest.mark.parametrize("coefficients", [1, 4, 9])
@pytest.mark.parametrize("asymmetry", [0.0, 0.5, -0.3])
def test_probe_light_is_the_integral_of_light_from_all_around(coefficients, asymmetry):
    probe = torch.rand(coefficients, 3, generator=torch.Generator().manual_seed(0), dtype=FLOAT)
    view, around = from_angles(*torch.tensor([0.4, 1.1], dtype=FLOAT)), sphere(100)
    mean = torch.tensor(asymmetry, dtype=FLOAT)
    sent = scattering.henyey_greenstein(((around - view) ** 2).sum(-1), mean)
    wanted = (sent[:, None] * (basis(around)[:, :coefficients] @ probe)).mean(0) * 4.0 * math.pi
    torch.testing.assert_close(froxel_lights.of_probe(probe, mean, view), wanted, rtol=1e-3, atol=1e-4)


# Shadow


def test_a_light_box_lies_along_the_sun_and_its_middle_is_the_centre():
    for to_sun in (from_angles(*torch.tensor([0.3, 2.0], dtype=FLOAT)), torch.tensor([0.0, 0.0, 1.0], dtype=FLOAT)):
        centre = torch.tensor([3.0, 4.0, 5.0], dtype=FLOAT)
        box = light_box(to_sun, centre, 10.0, 20.0)
        at = torch.stack([centre, centre + 20.0 * to_sun, centre - 10.0 * to_sun])
        wanted = torch.tensor([[0.5, 0.5, 0.5], [0.0, 0.5, 0.5], [0.75, 0.5, 0.5]], dtype=FLOAT)
        torch.testing.assert_close(at @ box[:, :3].mT + box[:, 3], wanted)
        scale = 20.0 * box[1:, :3]
        torch.testing.assert_close(scale @ scale.mT, torch.eye(2, dtype=FLOAT))


def test_what_is_deeper_than_the_occluder_is_dark_and_its_edge_is_blurred():
    depth = torch.full((8, 8), 0.5, dtype=FLOAT)
    depth[:, 4:] = 2.0
    lit = percentage_closer(depth, 4, 1)
    assert torch.equal(lit[:2], torch.ones(2, 8, 8, dtype=FLOAT))
    assert lit[3, 2].tolist() == pytest.approx([0.0, 0.0, 0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0, 1.0, 1.0])


def test_sunlight_is_dimmed_by_what_is_seen_of_the_sun():
    to_sun = from_angles(*torch.tensor([0.9, 0.2], dtype=FLOAT))
    sun = Sunlight(to_sun, torch.tensor([3.0, 2.0, 1.0], dtype=FLOAT), None)
    box = light_box(to_sun, torch.zeros(3, dtype=FLOAT), 10.0, 10.0)
    half = replace(sun, shadow=Shadow(torch.full((2, 4, 4), 0.5, dtype=FLOAT), box))
    at = torch.randn(5, 3, generator=torch.Generator().manual_seed(1), dtype=FLOAT)
    plain, dimmed = (froxel_lights.of_sun(one, G, at, EAST) for one in (sun, half))
    torch.testing.assert_close(dimmed, 0.5 * plain)
    torch.testing.assert_close(plain[0], phase(float(to_sun[0])) * sun.irradiance)
