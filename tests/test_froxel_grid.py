import math

import pytest
import torch

from diffrender.atmosphere import froxel_grid
from diffrender.atmosphere.froxel_grid import Grid, depth_at, eye_at, slice_at
from diffrender.rays import Perspective, pixel_centres

FLOAT = torch.float64
GRID = Grid(columns=6, rows=4, slices=8, near=0.5, far=40.0)


def number(value):
    return torch.tensor(float(value), dtype=FLOAT)


def eye(elevation=0.2, azimuth=0.7):
    spread = torch.tensor([0.9, 0.6], dtype=FLOAT)
    return eye_at(torch.tensor([3.0, -2.0, 5.0], dtype=FLOAT), number(elevation), number(azimuth), spread)


def test_the_default_is_the_talks():
    assert Grid() == Grid(160, 90, 64, 0.5, 100.0)
    assert Grid().halved() == Grid(80, 45, 32, 0.5, 100.0)
    assert Grid(1, 1, 1).halved() == Grid(1, 1, 1)


def test_slices_reach_from_the_eye_to_the_end_and_grow_evenly():
    cuts = froxel_grid.cuts(GRID, number(0))
    assert (float(cuts[0]), float(cuts[-1])) == pytest.approx((0.0, 40.0), rel=1e-14)
    torch.testing.assert_close(cuts[2:] / cuts[1:-1], torch.full((7,), 80.0 ** (1.0 / 8.0), dtype=FLOAT))
    places = torch.linspace(0.0, 8.0, 33, dtype=FLOAT)
    torch.testing.assert_close(slice_at(GRID, depth_at(GRID, places)), places)


def test_directions_are_those_of_a_perspective_camera():
    camera = Perspective(6, 4, 2.0 * math.atan(0.9), pitch=0.2)
    wanted = camera.direction(*pixel_centres(camera, slice(None), number(0)))
    found, stretch = froxel_grid.directions(eye(azimuth=0.0), 4, 6)
    torch.testing.assert_close(found, wanted)
    torch.testing.assert_close(stretch, 1.0 / (found @ eye(azimuth=0.0).axes[0]))


@pytest.mark.parametrize("shift", [0.0, -0.4, 0.37])
def test_froxels_lie_in_their_own_places(shift):
    found = froxel_grid.place_of(GRID, eye(), froxel_grid.froxels(GRID, eye(), shift).from_eye)
    slices, rows, columns = (torch.arange(n, dtype=FLOAT) + 0.5 for n in (8, 4, 6))
    wanted = torch.stack(torch.meshgrid(slices + shift, rows, columns, indexing="ij"), -1)
    torch.testing.assert_close(found, wanted)


def test_what_is_behind_the_camera_is_nowhere():
    behind = -eye().axes[0] * torch.tensor([[0.0], [3.0]], dtype=FLOAT)
    assert torch.equal(froxel_grid.place_of(GRID, eye(), behind), -torch.ones(2, 3, dtype=FLOAT))


def seen(grid, medium, distance):
    found = froxel_grid.froxels(grid, eye(), 0.0)
    summed = froxel_grid.integrated(grid, found.stretch, medium.expand(grid.slices, grid.rows, grid.columns, 4))
    return froxel_grid.seen_through(grid, eye(), summed, distance)


@pytest.mark.parametrize("slices", [1, 2, 13, 64])
@pytest.mark.parametrize("extinction", [0.0, 1e-9, 0.05, 30.0])
def test_even_fog_is_exact_at_every_distance_for_any_slices(slices, extinction):
    grid = Grid(6, 4, slices, near=0.5, far=40.0)
    _, stretch = froxel_grid.directions(eye(), 4, 6)  # a pixel for each column: no error across
    length = torch.tensor([0.0, 0.1, 0.6, 7.0, 33.0, 60.0, math.inf], dtype=FLOAT)[:, None, None].expand(7, 4, 6)
    light, passed = seen(grid, torch.tensor([3.0, 2.0, 1.0, extinction], dtype=FLOAT), length)
    depth = extinction * torch.minimum(length, 40.0 * stretch)
    torch.testing.assert_close(passed, torch.exp(-depth), rtol=1e-9, atol=1e-12)
    wanted = -torch.expm1(-depth) / extinction if extinction else torch.minimum(length, 40.0 * stretch)
    torch.testing.assert_close(
        light, wanted[..., None] * torch.tensor([3.0, 2.0, 1.0], dtype=FLOAT), rtol=1e-9, atol=1e-12
    )


def test_light_never_exceeds_that_of_endless_fog():
    generator = torch.Generator().manual_seed(0)
    extinction = 10.0 ** (4.0 * torch.rand(8, 4, 6, 1, generator=generator, dtype=FLOAT) - 2.0)
    medium = torch.cat([extinction * torch.tensor([0.3, 0.6, 0.9], dtype=FLOAT), extinction], -1)
    length = 50.0 * torch.rand(9, 11, generator=generator, dtype=FLOAT)
    light, passed = seen(GRID, medium, length)
    # Even light: what is seen of it is the opacity, but for what lies between columns.
    bound = (1.0 - passed)[..., None] * torch.tensor([0.3, 0.6, 0.9], dtype=FLOAT)
    assert (light <= bound + 1e-12).all()


def test_one_froxel_is_a_grid_too():
    light, passed = seen(Grid(1, 1, 1), torch.ones(4, dtype=FLOAT), torch.full((2, 2), 1.0, dtype=FLOAT))
    assert light.isfinite().all()
    assert (passed < 1.0).all()
