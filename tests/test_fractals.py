"""Fractals against brute force, exact limits, and at the places where their formulas have none."""

import json

import pytest
import torch

from diffrender.geometry import fractals, fractals_reference
from diffrender.geometry.fractal_shapes import Mandelbulb, Menger, Sierpinski
from diffrender.geometry.fractals import found, render
from experiments import fractal_distances, hard_places
from experiments import fractals as experiment
from experiments.fractals import camera_rays, painted

SHAPES = [Mandelbulb(3), Menger(3), Sierpinski(4)]
IDS = ["mandelbulb", "menger", "sierpinski"]


def scattered(count, half):
    draw = torch.Generator().manual_seed(5)
    return half * (2.0 * torch.rand(count, 3, generator=draw, dtype=torch.float64) - 1.0)


@pytest.mark.parametrize("shape", SHAPES, ids=IDS)
@pytest.mark.parametrize("power", [2.0, 3.7, 8.0])
def test_the_sign_of_the_distance_is_that_of_membership(shape, power):
    fractal, place = painted(power=power), scattered(3000, 1.2)
    inside = fractals_reference.holds(shape, fractal, place)
    assert inside.sum() > 20
    assert torch.equal(shape.orbit(fractal, place).distance <= 0.0, inside)


@pytest.mark.parametrize("shape", [Menger(0), Menger(1), Menger(2), Sierpinski(0), Sierpinski(1), Sierpinski(3)])
def test_distances_never_exceed_the_way_to_the_nearest_piece(shape):
    place = scattered(1500, 1.6)
    truth = fractal_distances.distance(shape, place)
    estimate = shape.orbit(painted(), place).distance
    assert (estimate <= truth + 1e-12).all()
    assert (estimate[truth > 0.0] > 0.5 * truth[truth > 0.0]).double().mean() > 0.9


def test_the_brute_force_knows_balls_of_paper():
    # Beside a face, an edge and a corner of the first tetrahedron, and of the cube.
    place = torch.tensor([[1.0, 1.0, 2.0], [0.0, 0.0, 1.5], [-1.0, -1.0, -1.0]]).double()
    truth = torch.tensor([1.0, 0.5, 2.0 / 3.0**0.5]).double()
    torch.testing.assert_close(fractal_distances.distance(Sierpinski(0), place), truth)
    torch.testing.assert_close(
        fractal_distances.distance(Menger(0), torch.tensor([[1.5, 0.0, 0.0], [2.0, 2.0, 1.0]]).double()),
        torch.tensor([0.5, 2.0**0.5]).double(),
    )


@pytest.mark.parametrize("shape", SHAPES, ids=IDS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_distance_and_slope_are_finite_at_the_origin_on_axes_and_far_away(shape, dtype):
    places = torch.tensor(
        [
            [0, 0, 0],
            [0, 0, 1],
            [0, 0, -1],
            [0, 0, 1e-20],
            [1e-20, 0, 0.5],
            [1, 0, 0],
            [-1, 0, 0],
            [1, 1, 1],
            [0, 50, 90],
        ]
    ).to(dtype)
    fractal = type(painted())(**{name: value.to(dtype) for name, value in vars(painted(power=3.0)).items()})
    places.requires_grad_()
    orbit = shape.orbit(fractal, places)
    slope = torch.autograd.grad((orbit.distance + orbit.trap).sum(), places)[0]
    assert orbit.distance.isfinite().all()
    assert slope.isfinite().all()
    assert slope.norm(dim=-1).max() < 20.0


@pytest.mark.parametrize("power", [2.0, 8.0])
def test_a_bulb_without_steps_is_a_ball_of_two(power):
    place = torch.tensor([[3.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]]).double()
    distance = Mandelbulb(0).orbit(painted(power=power), place).distance
    radius = place.norm(dim=-1)
    torch.testing.assert_close(distance, 0.5 * radius * torch.log(radius / 2.0))


def test_bulbs_of_whole_powers_have_their_symmetries():
    place = scattered(200, 1.2)
    turned = place @ torch.tensor([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).double()  # by pi / 2 round z

    def apart(power):
        first, second = (Mandelbulb(3).orbit(painted(power=power), at).distance for at in (place, turned))
        return (first - second).abs().max()

    assert apart(9.0) < 1e-12
    assert apart(8.0) > 1e-3


@pytest.mark.parametrize("shape", SHAPES[1:], ids=IDS[1:])
def test_pictures_of_all_shapes_reach_the_reference(shape):
    rays = camera_rays(6, 30.0, 4.0)
    view = fractals.example_inputs(torch.float64)
    flat = rays.direction.flatten(0, 1)
    seen = fractals.FractalView(
        type(rays)(rays.origin, flat, rays.length), view.background[:1], view.to_light, view.irradiance, view.sky, shape
    )
    drawn, truth = render(painted(), seen), fractals.reference(painted(), seen)
    assert (drawn != view.background[0]).any(-1).sum() > 5
    # Where pieces touch, a ray or its shadow may run out of steps between them.
    assert ((drawn - truth).abs().amax(-1) < 2e-3).double().mean() >= 0.94


@pytest.mark.parametrize("shape", SHAPES, ids=IDS)
def test_hits_grow_with_the_size(shape):
    # Seen from twice as far, a fractal of twice the size is met after twice the way.
    rays = camera_rays(6, 40.0, 4.0)
    double = type(rays)(2.0 * rays.origin, rays.direction, rays.length)
    near, far = found(painted(), rays, shape, 64), found(painted(size=2.0), double, shape, 64)
    assert torch.equal(near.is_hit, far.is_hit)
    torch.testing.assert_close(far.length[far.is_hit], 2.0 * near.length[near.is_hit], rtol=1e-9, atol=0.0)


def test_fractals_are_drawn_and_judged(tmp_path, capsys):
    experiment.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "fractals.json").read_text())
    exact = [row for row in content["estimates"] if not row["shape"].startswith("Mandelbulb")]
    assert {row["shape"] for row in exact} == {"Menger", "Sierpinski"}
    assert all(row["share"] == 0.0 and row["wrong_side"] == 0.0 for row in exact)
    assert all(row["from_differences"] < 1e-3 and row["backward_from_forward"] < 1e-9 for row in content["slopes"])
    blog, weighed, even = content["directions"]
    assert abs(weighed["square_of_x"] - 1.0 / 3.0) < 0.01 < abs(blog["square_of_x"] - 1.0 / 3.0)
    assert even["count"] == experiment.SMALL.directions
    assert all((tmp_path / f"{name}.png").stat().st_size > 150 for name in ("fractals", "directions"))
    assert "from_differences" in capsys.readouterr().out


def test_hard_fractals_are_as_many_as_the_examples():
    shapes = {name: seen.rays.direction.shape for name, seen in hard_places.hard_inputs("fractal").items()}
    assert len(shapes) == 4
    assert len(set(shapes.values())) == 1
