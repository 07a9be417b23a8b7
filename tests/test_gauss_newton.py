import itertools

import numpy as np
import pytest
import torch
from solver_problems import bowl

from fit.gauss_newton import QuadraticModel


@pytest.mark.parametrize("seed", range(5))
def test_quadratic_model_is_lowest_where_every_choice_of_faces_says(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    jacobian = torch.randn(20, 4, generator=generator, dtype=torch.float64)
    residuals = torch.randn(20, generator=generator, dtype=torch.float64)
    model = QuadraticModel(np.full(4, 0.5), residuals, jacobian)
    lowest = model.lowest(damping=0.0)
    # Every coordinate at its lower bound, at its upper one, or free: 81 linear systems.
    best = 0.0
    for faces in itertools.product((-0.5, 0.5, None), repeat=4):
        free = [axis for axis, face in enumerate(faces) if face is None]
        step = np.array([0.0 if face is None else face for face in faces])
        pull = model.gradient + model.curvature @ step
        step[free] = -np.linalg.solve(model.curvature[np.ix_(free, free)], pull[free])
        if abs(step).max() <= 0.5:
            best = max(best, model.decrease(model.point + step))
    assert model.decrease(lowest) == pytest.approx(best, rel=1e-9)
    assert ((lowest >= 0.0) & (lowest <= 1.0)).all()


def test_strong_damping_turns_a_step_down_the_gradient() -> None:
    jacobian = torch.tensor([[3.0, 1.0], [0.0, 2.0], [1.0, 1.0]], dtype=torch.float64)
    model = QuadraticModel(np.array([0.5, 0.5]), torch.tensor([0.3, -0.2, 0.1], dtype=torch.float64), jacobian)
    step = model.lowest(damping=1e6) - model.point
    cosine = -step @ model.gradient / (np.linalg.norm(step) * np.linalg.norm(model.gradient))
    assert cosine == pytest.approx(1.0, abs=1e-6)


def test_linear_residuals_keep_the_models_promise() -> None:
    problem = bowl(0.3, 1.2)
    model = QuadraticModel(problem.start, *problem.jacobian(torch.tensor(problem.start)))
    lowest = model.lowest(damping=0.0)
    assert lowest == pytest.approx([0.3, 1.0])
    assert model.loss - problem.loss(lowest) == pytest.approx(model.decrease(lowest))


def test_turned_axes_make_the_same_model() -> None:
    generator = torch.Generator().manual_seed(1)
    jacobian = torch.randn(50, 3, generator=generator, dtype=torch.float64)
    residuals = torch.randn(50, generator=generator, dtype=torch.float64)
    model = QuadraticModel(np.full(3, 0.5), residuals, jacobian)
    turned = model.turned_jacobian
    along = np.array([float(residuals.norm()), 0.0, 0.0, 0.0])
    assert turned.T @ along == pytest.approx(model.gradient)
    assert turned.T @ turned == pytest.approx(model.curvature)


def test_turned_axes_exist_where_residuals_vanish() -> None:
    jacobian = torch.tensor([[3.0, 1.0], [0.0, 2.0], [1.0, 1.0]], dtype=torch.float64)
    model = QuadraticModel(np.array([0.5, 0.5]), torch.zeros(3, dtype=torch.float64), jacobian)
    assert model.turned_jacobian.T @ model.turned_jacobian == pytest.approx(model.curvature)
