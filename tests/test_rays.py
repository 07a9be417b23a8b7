import math

import pytest
import torch
from torch import Tensor

from diffrender.rays import (
    CROSS_LYING,
    CROSS_STANDING,
    STRIP_LYING,
    STRIP_OPENEXR,
    STRIP_STANDING,
    Camera,
    Cubemap,
    Equirectangular,
    Perspective,
    angles,
    from_angles,
    pixel_centres,
)

LIKE = torch.zeros((), dtype=torch.float64)
LAYOUTS = {
    "lying cross": CROSS_LYING,
    "standing cross": CROSS_STANDING,
    "lying strip": STRIP_LYING,
    "standing strip": STRIP_STANDING,
    "OpenEXR": STRIP_OPENEXR,
}
CUBES = {name: Cubemap(16, layout) for name, layout in LAYOUTS.items()}
SPHERES: dict[str, Camera] = {"full": Equirectangular(64, 32), "odd": Equirectangular(50, 25), **CUBES}
PARTS: dict[str, Camera] = {
    "upper half": Equirectangular(64, 16, lowest=0.0),
    "level": Perspective(40, 30, field_of_view=math.radians(70)),
    "tilted": Perspective(30, 41, field_of_view=math.radians(50), pitch=math.radians(35)),
}
CAMERAS = SPHERES | PARTS


def each(cameras: dict[str, Camera]) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("camera", cameras.values(), ids=cameras.keys())


def random_directions(count: int) -> Tensor:
    draws = torch.randn(count, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    return draws / torch.linalg.vector_norm(draws, dim=-1, keepdim=True)


def pyramid(right: float, up: float) -> float:
    """Solid angle between the axis and a corner of a rectangle at distance 1."""
    return math.atan(right * up / math.sqrt(1.0 + right * right + up * up))


# Laws of every camera


@each(CAMERAS)
@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_a_pixels_direction_appears_at_that_pixel(camera: Camera, dtype: torch.dtype) -> None:
    x, y = pixel_centres(camera, slice(None), LIKE.to(dtype))
    seen = camera.solid_angle(x, y) > 0
    place = camera.place(camera.direction(x, y))
    assert place.dtype == dtype
    assert place[seen] == pytest.approx(torch.stack([x, y], -1)[seen], abs=1e-9 if dtype == torch.float64 else 2e-3)


@each(SPHERES)
def test_every_direction_appears_on_a_whole_sphere(camera: Camera) -> None:
    direction = random_directions(500)
    place = camera.place(direction)
    x, y = place.unbind(-1)
    assert ((x >= 0) & (x <= camera.width) & (y >= 0) & (y <= camera.height)).all()
    assert (camera.solid_angle(x, y) > 0).all()
    assert camera.direction(x, y) == pytest.approx(direction, abs=1e-9)


@each(CAMERAS)
def test_directions_are_units(camera: Camera) -> None:
    length = torch.linalg.vector_norm(camera.direction(*pixel_centres(camera, slice(None), LIKE)), dim=-1)
    assert length == pytest.approx(torch.ones_like(length), abs=1e-12)


@each(CAMERAS)
def test_a_place_of_one_direction_has_no_batch(camera: Camera) -> None:
    direction = torch.tensor([0.9, 0.1, 0.3], dtype=torch.float64)
    assert camera.place(direction).shape == (2,)
    assert camera.place(direction.expand(4, 5, 3)).shape == (4, 5, 2)


def test_a_band_of_rows_is_cut_out_of_the_picture() -> None:
    x, y = pixel_centres(Equirectangular(6, 4), slice(1, 3), torch.tensor(0.0))
    assert x.tolist() == [[0.5, 1.5, 2.5, 3.5, 4.5, 5.5]] * 2
    assert y.tolist() == [[1.5] * 6, [2.5] * 6]


def test_angles_undo_from_angles() -> None:
    elevation = torch.tensor([-1.5, -0.2, 0.0, 1.2], dtype=torch.float64)
    azimuth = torch.tensor([-3.1, 0.0, 1.0, 3.1], dtype=torch.float64)
    back = angles(from_angles(elevation, azimuth))
    assert torch.stack(back) == pytest.approx(torch.stack([elevation, azimuth]), abs=1e-12)


# Solid angles


@pytest.mark.parametrize(
    ("camera", "exact"),
    [(Equirectangular(64, 32), 4 * math.pi), (Equirectangular(64, 16, lowest=0.0), 2 * math.pi)],
    ids=["full", "upper half"],
)
def test_solid_angles_of_a_panorama_are_exact(camera: Camera, exact: float) -> None:
    assert camera.solid_angle(*pixel_centres(camera, slice(None), LIKE)).sum().item() == pytest.approx(exact, rel=1e-12)


@each(dict(CUBES))
def test_solid_angles_of_a_cube_sum_to_a_sphere(camera: Camera) -> None:
    total = camera.solid_angle(*pixel_centres(camera, slice(None), LIKE)).sum().item()
    assert total == pytest.approx(4 * math.pi, rel=0.3 / 16**2)  # the midpoint rule


@pytest.mark.parametrize("pitch", [0.0, 0.6])
def test_solid_angles_of_a_frame_sum_to_its_pyramid(pitch: float) -> None:
    camera = Perspective(60, 40, field_of_view=1.2, pitch=pitch)
    half = math.tan(0.6)
    exact = 4 * pyramid(half, half * 40 / 60)
    assert camera.solid_angle(*pixel_centres(camera, slice(None), LIKE)).sum().item() == pytest.approx(exact, rel=1e-4)


def test_a_pixels_solid_angle_is_that_of_its_own_pyramid() -> None:
    corner = Cubemap(64, STRIP_LYING).solid_angle(torch.tensor([0.5, 32.5]), torch.tensor([0.5, 32.5]))
    step = 2 / 64
    outermost = pyramid(1, 1) - 2 * pyramid(1, 1 - step) + pyramid(1 - step, 1 - step)
    assert corner.tolist() == pytest.approx([outermost, pyramid(step, step)], rel=1e-3)


@pytest.mark.parametrize("layout", [CROSS_LYING, CROSS_STANDING])
def test_empty_cells_of_a_cross_show_nothing(layout: tuple[tuple[str | None, ...], ...]) -> None:
    camera = Cubemap(4, layout)
    shown = camera.solid_angle(*pixel_centres(camera, slice(None), LIKE)) > 0
    faces = torch.tensor([[face is not None for face in line] for line in layout])
    assert torch.equal(shown, faces.repeat_interleave(4, 0).repeat_interleave(4, 1))


# Orientation: +x under the picture's centre column, +y to its left, z up


@each(PARTS | {"full": Equirectangular(64, 32)})
def test_the_centre_column_looks_along_x(camera: Camera) -> None:
    y = torch.linspace(0.5, camera.height - 0.5, 7, dtype=torch.float64)
    direction = camera.direction(torch.full_like(y, camera.width / 2), y)
    assert direction[:, 1] == pytest.approx(torch.zeros_like(y), abs=1e-12)
    assert (direction[:, 0] > 0).all()


@each(PARTS | {"full": Equirectangular(64, 32)})
def test_the_left_half_looks_towards_y_and_the_top_looks_up(camera: Camera) -> None:
    x, y = pixel_centres(camera, slice(None), LIKE)
    direction = camera.direction(x, y)
    assert torch.equal(direction[..., 1] > 0, x < camera.width / 2)
    middle = camera.width // 2
    assert (direction[:-1, middle, 2] > direction[1:, middle, 2]).all()


def test_places_of_the_axes_in_a_panorama() -> None:
    camera = Equirectangular(360, 180)
    axes = torch.tensor([[1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=torch.float64)
    expected = torch.tensor([[180, 90], [90, 90], [270, 90], [180, 0], [180, 180]], dtype=torch.float64)
    assert camera.place(axes) == pytest.approx(expected)


def test_the_upper_half_ends_at_the_horizon() -> None:
    camera = Equirectangular(360, 90, lowest=0.0)
    directions = from_angles(torch.tensor([0.01, 0.0, -0.01], dtype=torch.float64), LIKE.expand(3))
    assert torch.isnan(camera.place(directions)).any(-1).tolist() == [False, False, True]
    assert camera.place(directions)[1].tolist() == [180, 90]


def test_a_tilted_frame_is_centred_on_its_pitch() -> None:
    camera = Perspective(40, 30, field_of_view=math.radians(60), pitch=math.radians(20))
    elevation, azimuth = angles(camera.direction(torch.tensor(20.0), torch.tensor(15.0)))
    assert math.degrees(elevation.item()) == pytest.approx(20, abs=1e-4)
    assert azimuth.item() == pytest.approx(0, abs=1e-6)


def test_the_field_of_view_goes_across_the_width() -> None:
    camera = Perspective(40, 30, field_of_view=math.radians(60))
    _, azimuth = angles(camera.direction(torch.tensor([0.0, 40.0]), torch.tensor([15.0, 15.0])))
    assert torch.rad2deg(azimuth).tolist() == pytest.approx([30, -30], abs=1e-4)


def test_a_frame_shows_nothing_beside_and_behind_it() -> None:
    camera = Perspective(40, 30, field_of_view=math.radians(60))
    directions = from_angles(torch.zeros(4), torch.deg2rad(torch.tensor([29.0, 31.0, 180.0, -150.0])))
    assert torch.isnan(camera.place(directions)).any(-1).tolist() == [False, True, True, True]


# Cubes


@pytest.mark.parametrize("layout", [CROSS_LYING, CROSS_STANDING], ids=["lying", "standing"])
def test_neighbouring_faces_of_a_cross_join(layout: tuple[tuple[str | None, ...], ...]) -> None:
    camera, step = Cubemap(8, layout), 1e-6
    along = torch.linspace(0.1, 7.9, 9, dtype=torch.float64)
    shown = {(row, column) for row, line in enumerate(layout) for column, face in enumerate(line) if face}
    for row, column in shown:
        if (row, column + 1) in shown:
            border, y = torch.full_like(along, (column + 1) * 8.0), row * 8 + along
            assert camera.direction(border - step, y) == pytest.approx(camera.direction(border + step, y), abs=1e-6)
        if (row + 1, column) in shown:
            x, border = column * 8 + along, torch.full_like(along, (row + 1) * 8.0)
            assert camera.direction(x, border - step) == pytest.approx(camera.direction(x, border + step), abs=1e-6)


@pytest.mark.parametrize("layout", [CROSS_LYING, CROSS_STANDING], ids=["lying", "standing"])
def test_a_cross_has_the_front_in_its_second_row_and_column(layout: tuple[tuple[str | None, ...], ...]) -> None:
    assert Cubemap(2, layout).direction(torch.tensor(3.0), torch.tensor(3.0)).tolist() == [1, 0, 0]
    assert Cubemap(2, layout).direction(torch.tensor(1.0), torch.tensor(3.0)).tolist() == [0, 1, 0]
    assert Cubemap(2, layout).direction(torch.tensor(3.0), torch.tensor(1.0)).tolist() == [0, 0, 1]


def test_a_standing_strip_is_read_as_opengl_samples_it() -> None:
    # OpenGL 4.6, table 8.19: s and t of each face from (rx, ry, rz), which here point right, up and ahead.
    right, up, ahead = (random_directions(300) @ torch.tensor([[0, 0, 1], [-1, 0, 0], [0, 1, 0]]).to(LIKE)).unbind(-1)
    faces = [
        (right, -ahead, -up),
        (-right, ahead, -up),
        (up, right, ahead),
        (-up, right, -ahead),
        (ahead, right, -up),
        (-ahead, -right, -up),
    ]
    expected_on(Cubemap(10, STRIP_STANDING), faces)


def test_an_envmap_is_read_as_openexr_writes_it() -> None:
    # ImfEnvmap.h: x to the left, y up, z ahead; the cube seen from inside.
    left, up, ahead = (random_directions(300) @ torch.tensor([[0, 0, 1], [1, 0, 0], [0, 1, 0]]).to(LIKE)).unbind(-1)
    faces = [
        (left, ahead, -up),
        (-left, -ahead, -up),
        (up, left, -ahead),
        (-up, left, ahead),
        (ahead, -left, -up),
        (-ahead, left, -up),
    ]
    expected_on(Cubemap(10, STRIP_OPENEXR), faces)


def expected_on(camera: Cubemap, faces: list[tuple[Tensor, Tensor, Tensor]]) -> None:
    place = camera.place(random_directions(300))
    largest = torch.stack([major for major, _, _ in faces]).amax(0)
    for index, (major, across, down) in enumerate(faces):
        on_face = major == largest
        expected = torch.stack([(across / major + 1) * 5, (down / major + 1) * 5 + 10 * index], -1)
        assert place[on_face] == pytest.approx(expected[on_face], abs=1e-9)


@each(dict(CUBES))
def test_a_place_lies_in_the_cell_that_shows_it(camera: Camera) -> None:
    corners = torch.tensor([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z])
    direction = corners / torch.linalg.vector_norm(corners.float(), dim=-1, keepdim=True)
    x, y = camera.place(direction).unbind(-1)
    assert (camera.solid_angle(x, y) > 0).all()
    assert camera.direction(x, y) == pytest.approx(direction, abs=1e-5)


def test_the_far_borders_of_a_cube_belong_to_its_last_cells() -> None:
    camera = Cubemap(8, STRIP_LYING)
    direction = camera.direction(torch.tensor(48.0), torch.tensor(8.0))
    assert direction * math.sqrt(3) == pytest.approx(torch.tensor([-1.0, 1.0, -1.0]), abs=1e-6)
