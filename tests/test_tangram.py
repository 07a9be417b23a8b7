import pytest
import torch

from diffrender.antialiasing import tangram
from diffrender.images import places

SIZES = [(32, 18), (64, 36), (16, 10), (6, 4), (4, 4), (8, 4), (2, 2), (2, 1)]  # width and height; from 1:1 to 2:1
PARITIES = [0, 1]


def numbered(width, height):
    """Lit corners that are all different and none 0."""
    return torch.arange(1.0, width * height // 2 + 1).reshape(height, width // 2, 1)


def lit(width, height, parity):
    """Column and row of each lit corner, row by row, by their definition."""
    found = [(i, j) for j in range(height) for i in range(width) if (i + j) % 2 == parity]
    return torch.tensor(found, dtype=torch.float64).reshape(height, width // 2, 2)


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize(
    ("width", "height"),
    [*SIZES, (192, 108), *(pytest.param(w, h, marks=pytest.mark.slow) for w, h in [(1920, 1080), (3840, 2160)])],
)
def test_packing_loses_nothing_and_pads_with_0(width, height, parity):
    corners = numbered(width, height)
    texture = tangram.pack(corners, parity=parity)
    assert texture.shape == (height, height, 1)
    assert torch.equal(tangram.unpack(texture, width=width, parity=parity), corners)
    assert int((texture != 0.0).sum()) == corners.numel()


def test_padding_is_an_eighth_of_the_samples_at_16_to_9():
    texture = tangram.pack(numbered(192, 108), parity=0)
    assert texture.numel() / (192 * 108 / 2) == 1.125


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize(("width", "height"), [(32, 18), (31, 18), (9, 5), (7, 7), (2, 1), (641, 361)])
def test_all_corners_of_any_size_come_back(width, height, parity):
    grid = torch.arange(1.0, (width + 1) * (height + 1) + 1).reshape(height + 1, width + 1, 1)
    row, column = torch.meshgrid(torch.arange(height + 1), torch.arange(width + 1), indexing="ij")
    only_lit = torch.where(((row + column) % 2 == parity)[..., None], grid, torch.zeros_like(grid))
    texture = tangram.pack_all(grid, parity=parity)
    assert texture.shape == (height + 1, height + 1, 1)
    assert torch.equal(tangram.unpack_all(texture, columns=width + 1, parity=parity), only_lit)


@pytest.mark.parametrize("parity", PARITIES)
def test_the_derivative_is_a_permutation(parity):
    corners = numbered(32, 18).requires_grad_()
    texture = tangram.pack(corners, parity=parity)
    marks = torch.arange(1.0, texture.numel() + 1).reshape(texture.shape)
    (gradient,) = torch.autograd.grad((texture * marks).sum(), corners)
    assert torch.equal(tangram.unpack(marks, width=32, parity=parity), gradient)
    round_trip = tangram.unpack(tangram.pack(corners, parity=parity), width=32, parity=parity)
    (back,) = torch.autograd.grad(round_trip.sum(), corners)
    assert torch.equal(back, torch.ones_like(corners))


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize(("width", "height"), SIZES[:4])  # smaller ones wrap onto neighbours
def test_neighbours_in_the_texture_are_diagonal_on_screen(width, height, parity):
    place = lit(width, height, parity)
    texture = tangram.pack(place + 1.0, parity=parity)  # 0 is padding
    for axis, step in ((0, [1.0, 1.0]), (1, [1.0, -1.0])):
        beyond = texture.roll(-1, axis)
        apart = (beyond - texture)[(texture[..., 0] > 0) & (beyond[..., 0] > 0)]
        across_a_border = (apart.abs() > 1.5).any(-1)  # of the picture: content of its other end
        assert torch.equal(apart[~across_a_border], torch.tensor(step).double().expand_as(apart[~across_a_border]))
        assert int(across_a_border.sum()) <= width + height


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_pixel_is_the_mean_of_its_two_lit_corners(width, height, parity):
    generator = torch.Generator().manual_seed(0)
    corners = torch.rand(height, width // 2, 3, generator=generator, dtype=torch.float64)
    whole = torch.zeros(height, width, 3, dtype=torch.float64)
    i, j = lit(width, height, parity).long().unbind(-1)
    whole[j, i] = corners
    mean = (whole[:-1, :-1] + whole[:-1, 1:] + whole[1:, :-1] + whole[1:, 1:]) / 2.0
    centres = places(width, height, torch.zeros(2, dtype=torch.float64))
    drawn = tangram.sample(tangram.pack(corners, parity=parity), centres, width=width, parity=parity)
    torch.testing.assert_close(drawn[:-1, :-1], mean, rtol=1e-14, atol=0.0)


@pytest.mark.parametrize("parity", PARITIES)
def test_a_ramp_is_exact_but_for_the_last_column_and_row_which_repeat(parity):
    corners = (lit(32, 18, parity) * torch.tensor([3.0, 5.0])).sum(-1, keepdim=True)
    centres = places(32, 18, torch.zeros(2, dtype=torch.float64))
    wanted = (centres * torch.tensor([3.0, 5.0])).sum(-1)
    drawn = tangram.sample(tangram.pack(corners, parity=parity), centres, width=32, parity=parity)[..., 0]
    assert torch.equal(drawn[:-1, :-1], wanted[:-1, :-1])
    assert torch.equal(drawn[:, -1], drawn[:, -2])
    assert torch.equal(drawn[-1], drawn[-2])


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize("size", [(32, 18), (16, 10), (4, 4), (6, 4), (2, 1)])
def test_three_quads_cover_each_sample_once(size, parity):
    width, height = size
    if (width, parity) == (2 * height, 1):
        width, height = 14, 8
    corners = numbered(width, height)
    vertices, shown = tangram.quads(width, height, parity=parity)
    middle = places(height, height, torch.zeros(2))
    blitted, covered = torch.zeros(height, height), torch.zeros(height, height)
    for origin, right, _, down in vertices:
        across = torch.linalg.solve(torch.stack([right - origin, down - origin], -1), (middle - origin)[..., None])
        inside = ((across > 0.0) & (across < 1.0)).all(-2)[..., 0]
        entry = (across[..., 0] * shown[2]).floor().long()[inside]
        blitted[inside] = corners[entry[:, 1], entry[:, 0], 0]
        covered += inside
    texture = tangram.pack(corners, parity=parity)[..., 0]
    assert torch.equal(covered, (texture != 0.0).float())
    assert torch.equal(blitted, texture)


@pytest.mark.parametrize("parity", PARITIES)
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_filled_padding_repeats_the_ends_of_each_row(width, height, parity):
    place = lit(width, height, parity)
    texture = tangram.pack(place + 1.0, parity=parity)
    whole = tangram.filled(texture, width=width, parity=parity)
    is_sample = texture[..., 0] > 0.0
    assert torch.equal(whole[is_sample], texture[is_sample])
    column = whole[~is_sample][..., 0] - 1.0
    assert bool(((column <= 1.0) | (column >= width - 2.0)).all())


@pytest.mark.parametrize(
    ("shape", "parity", "told"),
    [((18, 15, 3), 2, "parity is 2"), ((4, 1, 3), 0, "2 x 4"), ((4, 5, 3), 0, "10 x 4")],
)
def test_what_does_not_fit_is_refused(shape, parity, told):
    with pytest.raises(ValueError, match=told):
        tangram.pack(torch.zeros(shape), parity=parity)
    with pytest.raises(ValueError, match=told):
        tangram.unpack(torch.zeros(shape[0], shape[0], 3), width=2 * shape[1], parity=parity)


def test_odd_widths_and_corners_that_would_meet_are_refused():
    with pytest.raises(ValueError, match="must be even"):
        tangram.unpack(torch.zeros(18, 18, 1), width=19, parity=0)
    with pytest.raises(ValueError, match="fourth quad"):
        tangram.quads(8, 4, parity=1)
    with pytest.raises(ValueError, match="at most 36"):
        tangram.pack_all(torch.zeros(18, 37, 1), parity=0)
    with pytest.raises(ValueError, match="at most 36"):
        tangram.unpack_all(torch.zeros(18, 18, 1), columns=37, parity=0)
