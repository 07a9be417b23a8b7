import itertools

import pytest
import torch

from diffrender.geometry import shadow_atlas
from diffrender.geometry.shadow_atlas import Square

ATLAS, LEAST = 256, 8


def draw_sizes(seed, count, most):
    draw = torch.Generator().manual_seed(seed)
    return [2 ** int(power) for power in torch.randint(3, most + 1, (count,), generator=draw)]


def is_free(squares):
    """Whether no two squares share a texel and all lie inside."""
    taken = torch.zeros(ATLAS, ATLAS, dtype=torch.int)
    for one in squares:
        assert one.x + one.size <= ATLAS
        assert one.y + one.size <= ATLAS
        taken[one.y : one.y + one.size, one.x : one.x + one.size] += 1
    return taken.max() <= 1


@pytest.mark.parametrize("seed", range(20))
def test_squares_of_random_sizes_do_not_overlap(seed):
    sizes = draw_sizes(seed, 5 + 10 * seed, 7)
    squares = shadow_atlas.packed(sizes, ATLAS, LEAST)
    assert is_free(squares)
    assert all(one.size in (0, *(2**power for power in range(3, 8))) for one in squares)
    assert all(one.size <= size for one, size in zip(squares, sizes, strict=True))
    if sum(size * size for size in sizes) <= ATLAS**2:
        assert [one.size for one in squares] == sizes


def test_what_fits_by_its_area_fits_to_the_last_texel():
    sizes = [8] * 4 + [64] * 3 + [16] * 3 + [128] * 3 + [32] * 3
    assert sum(size * size for size in sizes) == ATLAS**2
    squares = shadow_atlas.packed(sizes, ATLAS, LEAST)
    assert [one.size for one in squares] == sizes
    assert is_free(squares)


def test_the_most_important_keeps_its_size():
    squares = shadow_atlas.packed([128] * 9, ATLAS, LEAST)
    assert [one.size for one in squares[:2]] == [128, 128]
    assert all(before.size >= after.size for before, after in itertools.pairwise(squares))
    assert squares[-1].size > 0
    assert is_free(squares)


def test_the_least_important_are_left_out_where_all_are_smallest():
    squares = shadow_atlas.packed([8] * (32 * 32 + 5), ATLAS, LEAST)
    assert sum(one.size > 0 for one in squares) == 32 * 32
    assert squares[-1] == Square(0, 0, 0)
    assert is_free(squares)


def test_squares_stay_where_they_are_while_sizes_do():
    sizes = [64, 32, 32, 8]
    assert shadow_atlas.packed(sizes, ATLAS, LEAST)[:3] == shadow_atlas.packed([64, 32, 32, 16], ATLAS, LEAST)[:3]


@pytest.mark.parametrize("size", [-8, 3, 512])
def test_other_sizes_are_refused(size):
    with pytest.raises(ValueError, match=f"has size {size}"):
        shadow_atlas.packed([8, size], ATLAS, LEAST)


def test_a_size_between_two_does_not_flicker():
    wanted = [90.0, 91.0, 90.0, 91.0, 127.0, 129.0, 150.0, 129.0, 70.0, 60.0]
    size, found = 0, []
    for one in wanted:
        size = shadow_atlas.map_size(one, size, LEAST, ATLAS)
        found.append(size)
    assert found == [64, 64, 64, 64, 64, 128, 128, 128, 128, 64]


def test_a_map_is_as_large_as_its_light_on_the_screen():
    near, far = (shadow_atlas.wanted_size(2.0, depth, 0.5, 1080) for depth in (8.0, 16.0))
    assert near == pytest.approx(540.0)
    assert far == pytest.approx(270.0)
    assert shadow_atlas.wanted_size(2.0, 1.0, 0.5, 1080) == shadow_atlas.wanted_size(2.0, 2.0, 0.5, 1080) == 1080.0
