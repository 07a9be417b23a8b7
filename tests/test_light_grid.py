import math

import pytest
import torch

from diffrender.geometry import light_grid
from diffrender.geometry.light_grid import Depths, Spheres
from diffrender.rays import Perspective, pixel_centres

CAMERA = Perspective(100, 60, math.radians(75.0), math.radians(20.0))
TILE = 16
EYE = torch.tensor([1.0, -2.0, 3.0], dtype=torch.float64)


def uniform(*shape, seed=0):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def number(value):
    return torch.tensor(value, dtype=torch.float64)


def lights(count):
    """Middles all round the camera, and radii."""
    middle = (uniform(count, 3) - torch.tensor([0.5, 0.5, 0.2]).double()) * torch.tensor([30.0, 20.0, 40.0]).double()
    return Spheres(middle, 0.2 + 4.0 * uniform(count, seed=1) ** 3)


def scene():
    """Depths of pixels that change a lot from one to the next, and their places in view space, tile by tile."""
    x, y = pixel_centres(CAMERA, slice(None), number(0.0))
    depth = 1.0 + 25.0 * uniform(60, 100, seed=2) ** 2
    side = 2.0 * math.tan(CAMERA.field_of_view / 2) / CAMERA.width
    place = torch.stack([(x - 50.0) * side * depth, (30.0 - y) * side * depth, depth], -1)
    return light_grid.to_tiles(depth, TILE), light_grid.to_tiles(place, TILE)


def planes():
    return light_grid.side_planes(CAMERA, TILE, number(0.0)).flatten(0, 1)


def test_view_space_is_where_the_camera_sees_things():
    x, y = number([12.5, 50.0, 99.0]), number([3.5, 30.0, 59.0])
    seen = light_grid.in_view(CAMERA, EYE, EYE + 7.0 * CAMERA.direction(x, y))
    side = 2.0 * math.tan(CAMERA.field_of_view / 2) / CAMERA.width
    torch.testing.assert_close(seen[:, 0] / seen[:, 2], (x - 50.0) * side)
    torch.testing.assert_close(seen[:, 1] / seen[:, 2], (30.0 - y) * side)
    torch.testing.assert_close(seen.norm(dim=-1), number([7.0] * 3))


def test_a_place_is_inside_the_planes_of_the_tile_that_shows_it_alone():
    x, y = 100.0 * uniform(500), 60.0 * uniform(500, seed=1)
    seen = light_grid.in_view(CAMERA, EYE, EYE + 5.0 * CAMERA.direction(x, y))
    inside = ((planes() @ seen.T) >= 0.0).all(1)
    own = (y // TILE) * math.ceil(100 / TILE) + x // TILE
    assert (inside.sum(0) == 1).all()
    assert (inside.long().argmax(0) == own).all()


def test_the_blogs_tiles_change_their_bias_by_one():
    # 600 × 600 pixels in tiles of 10: scale 30; the left planes of tiles 0 and 1 have biases 30 and 29.
    normals = light_grid.side_planes(Perspective(600, 600, math.radians(90.0)), 10, number(0.0))
    assert normals.shape == (60, 60, 4, 3)
    left = normals[0, :2, 0]
    torch.testing.assert_close(left[:, 2] / left[:, 0], number([30.0 / 30.0, 29.0 / 30.0]))
    torch.testing.assert_close(normals.norm(dim=-1), torch.ones(60, 60, 4).double())


def test_lists_hold_every_light_that_reaches_a_pixel_and_few_others():
    depth, place = scene()
    found = lights(300)
    listed = light_grid.lists(planes(), light_grid.depth_bounds(depth), found)
    kept = torch.zeros(len(listed), 301, dtype=torch.bool).scatter(1, listed % 301, value=True)[:, :300]
    reached = ((place[:, :, None] - found.middle).norm(dim=-1) < found.radius).any(1)
    assert reached.any(1).all()
    assert (kept | ~reached).all()
    assert kept.sum() < 3 * reached.sum()
    assert kept.sum() < 0.3 * kept.numel()


def test_lists_are_sorted_by_depth_and_end_in_minus_one():
    depth, _ = scene()
    found = lights(300)
    listed = light_grid.lists(planes(), light_grid.depth_bounds(depth), found)
    assert (listed[:, 1:][listed[:, :-1] < 0] == -1).all()
    both = (listed[:, 1:] >= 0) & (listed[:, :-1] >= 0)
    ahead = found.middle[listed, 2]
    assert (ahead[:, 1:] >= ahead[:, :-1])[both].all()
    assert all(len(set(row[row >= 0].tolist())) == int((row >= 0).sum()) for row in listed)


@pytest.mark.parametrize(
    ("middle", "reached"),
    [
        ((0.0, 0.0, 5.0), True),
        ((0.0, 0.0, 11.0), True),  # its border is nearer than the farthest pixel
        ((0.0, 0.0, 11.3), False),
        ((0.0, 0.0, 0.9), True),
        ((0.0, 0.0, 0.7), False),
        ((6.0, 0.0, 5.0), True),  # over the right side, a plane of 45 degrees, by less than its radius
        ((6.9, 0.0, 5.0), False),
        ((0.0, 6.0, 5.0), True),
        ((0.0, -6.9, 5.0), False),
        ((0.0, 0.0, -5.0), False),
    ],
)
def test_a_sphere_reaches_a_tile_up_to_its_radius(middle, reached):
    whole = light_grid.side_planes(Perspective(8, 8, math.radians(90.0)), 8, number(0.0)).flatten(0, 1)
    spheres = Spheres(number([middle]), number([1.2]))
    found = light_grid.reaches(whole, Depths(number([2.0]), number([10.0])), spheres)
    assert found.tolist() == [[reached]]
    nothing = light_grid.reaches(whole, Depths(number([2.0]), number([10.0])), Spheres(number([middle]), number([0.0])))
    assert nothing.tolist() == [[False]]


def test_cells_hold_every_light_of_a_slice_between_first_and_last():
    depth, place = scene()
    found, span = lights(300), Depths(number(0.5), number(30.0))
    listed = light_grid.lists(planes(), light_grid.depth_bounds(depth), found)
    cells = light_grid.cells(listed, found, span)
    own = light_grid.slice_of(depth, span)
    first, last = (torch.take_along_dim(end, own, 1)[..., None] for end in (cells.first, cells.last))
    position = torch.arange(listed.shape[1])
    within = (first <= position) & (position <= last)
    way = (place[:, :, None] - found.middle[listed.clamp(min=0)][:, None]).norm(dim=-1)
    reached = (way < found.radius[listed.clamp(min=0)][:, None]) & (listed >= 0)[:, None]
    assert (within | ~reached).all()
    assert within.sum() < 0.7 * (listed >= 0).sum() * depth.shape[1]
    assert cells.first.shape == (28, 32)


def test_slices_are_of_equal_ratio_and_their_ends_hold_what_is_outside():
    span = Depths(number(0.1), number(1000.0))
    edges = 0.1 * 10.0 ** (4.0 * torch.arange(33, dtype=torch.float64) / 32.0)
    middles = (edges[1:] * edges[:-1]).sqrt()
    assert light_grid.slice_of(middles, span).tolist() == list(range(32))
    assert light_grid.slice_of(number([-3.0, 0.0, 0.05, 2000.0]), span).tolist() == [0, 0, 0, 31]


def test_a_grid_without_lights_is_empty():
    depth, _ = scene()
    none = Spheres(torch.zeros(0, 3).double(), torch.zeros(0).double())
    listed = light_grid.lists(planes(), light_grid.depth_bounds(depth), none)
    cells = light_grid.cells(listed, none, Depths(number(1.0), number(30.0)))
    assert listed.shape == (28, 0)
    assert (cells.last < cells.first).all()


@pytest.mark.parametrize("tile", [1, 7, 16, 200])
def test_a_picture_comes_back_from_its_tiles(tile):
    picture = uniform(60, 100, 3)
    tiles = light_grid.to_tiles(picture, tile)
    assert tiles.shape == (math.ceil(60 / tile) * math.ceil(100 / tile), tile * tile, 3)
    assert torch.equal(light_grid.from_tiles(tiles, 60, 100, tile), picture)
