from dataclasses import replace

import pytest
import torch
from synthetic_sky import HAZY_MORNING

from diffrender import rays
from diffrender.atmosphere import sky
from diffrender.scene import sky_view
from fit import keyframes, priors
from fit.objective import PRIOR_WEIGHT, Sample, SkyObjective
from fit.search_space import SearchSpace

FREE = (
    "SKY_HAZINESS",
    "SKY_MIE_SCALE",
    "SKY_RAYLEIGH_SCALE",
    "SKY_COARSE_HAZINESS",
    "SKY_OVERCAST",
    "SKY_OVERCAST_LEFT",
)
SIZE = sky.Size(rows=12, columns=4, steps=8, heights=4, suns=8, steps_around=4)
COUNT = 60
FLOOR = 1e-7  # a hundred-thousandth of the median: derivatives by jvp take the floor's gain as constant


def made():
    """Objective whose photo is the sky of a known scene, and the point of that scene."""
    generator = torch.Generator().manual_seed(0)
    elevation, azimuth = torch.rand(2, COUNT, generator=generator, dtype=torch.float64)
    direction = rays.from_angles(0.1 + 1.4 * elevation, 6.28 * azimuth)
    truth = {**HAZY_MORNING, "SKY_OVERCAST": 0.3, "SKY_OVERCAST_LEFT": 0.5}
    ones = dict.fromkeys(("EXPOSURE", "SUN_IRRADIANCE_R", "SUN_IRRADIANCE_G", "SUN_IRRADIANCE_B"), 1.0)
    space = SearchSpace(keyframes.scene({**truth, **ones}, torch.float64), FREE)
    geometry = sky.geometry(sky_view(space.start, direction[:1]), SIZE)
    blank = Sample(direction, torch.zeros(COUNT, 3, dtype=torch.float64), FLOOR)
    objective = SkyObjective(space, blank, lambda _: geometry)
    point = torch.from_numpy(space.point(space.start))
    return seen(objective, objective.radiance(point)), point


def seen(objective, radiance, floor=FLOOR):
    return replace(objective, sample=replace(objective.sample, log_radiance=torch.log(radiance + floor), floor=floor))


OBJECTIVE, POINT = made()
RADIANCE = torch.exp(OBJECTIVE.sample.log_radiance) - FLOOR


def test_residuals_vanish_where_the_photo_is_the_model():
    assert OBJECTIVE.residuals(POINT)[: 3 * COUNT].abs().max() < 1e-9


def test_the_scale_of_a_photo_is_no_matter():
    elsewhere = POINT + 0.05
    brighter = seen(OBJECTIVE, 1000.0 * RADIANCE, 1000.0 * FLOOR)
    torch.testing.assert_close(brighter.residuals(elsewhere), OBJECTIVE.residuals(elsewhere))


def test_nor_are_the_scales_of_its_channels_where_the_floor_is_low():
    elsewhere = POINT + 0.05
    tinted = seen(OBJECTIVE, RADIANCE * torch.tensor([2.0, 1.0, 0.4]))
    torch.testing.assert_close(tinted.residuals(elsewhere), OBJECTIVE.residuals(elsewhere), atol=1e-6, rtol=0.0)


def test_jacobian_gives_the_residuals_at_the_point():
    elsewhere = POINT + 0.05
    torch.testing.assert_close(OBJECTIVE.jacobian(elsewhere)[0], OBJECTIVE.residuals(elsewhere))


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.0, 0.07, -0.07])
def test_jacobian_agrees_with_forward_mode(step):
    point = (POINT + step).clamp(0.01, 0.99)

    def along(tangent):
        return torch.func.jvp(OBJECTIVE.residuals, (point,), (tangent,))[1]

    exact = torch.func.vmap(along)(torch.eye(point.numel(), dtype=point.dtype)).T
    _, slopes = OBJECTIVE.jacobian(point)
    assert torch.linalg.norm(slopes - exact) < 1e-4 * torch.linalg.norm(exact)
    # Each column too: a wrong one could hide behind a long one.
    lengths = torch.linalg.norm(exact, dim=0)
    assert (torch.linalg.norm(slopes - exact, dim=0) < 1e-4 * lengths).all()


def test_jacobian_stays_inside_the_bounds_on_the_faces_of_the_cube():
    corner = torch.tensor([0.0, 1.0, 0.0, 1.0, 0.0, 1.0], dtype=torch.float64)
    residuals, slopes = OBJECTIVE.jacobian(corner)
    assert residuals.isfinite().all()
    assert slopes.isfinite().all()


def test_an_outlier_counts_less_than_its_square():
    def loss(factor):
        outlier = RADIANCE.clone()
        outlier[0] *= factor
        return 0.5 * float(seen(OBJECTIVE, outlier).residuals(POINT)[: 3 * COUNT].square().sum())

    # Twice the logarithm: four times the loss for small ones, about twice for large ones.
    assert loss(1.01**2) / loss(1.01) == pytest.approx(4.0, rel=0.02)
    assert loss(1e80) / loss(1e40) < 2.5


def test_without_evidence_parameters_stay_at_the_centres_of_their_priors():
    dark = replace(OBJECTIVE, space=replace(OBJECTIVE.space, free=("SKY_OZONE",)))
    prior = priors.in_unit_cube(dark.space.free)
    centre, spread = torch.from_numpy(prior.centre), torch.from_numpy(prior.spread)
    assert float(dark.residuals(centre)[-1]) == 0.0
    assert float(dark.residuals(centre + 2.0 * spread)[-1]) == pytest.approx(2.0 * PRIOR_WEIGHT)


def test_changes_are_those_of_a_search_that_goes_there():
    space = replace(OBJECTIVE.space, free=OBJECTIVE.space.free[:3])
    known = replace(OBJECTIVE, space=space)
    names = ("SKY_OZONE", "SKY_COARSE_SCALE")
    prior = priors.in_unit_cube(names)
    changes = known.changes(POINT[:3], names)
    wider = replace(known, space=replace(space, free=(*space.free, *names)))
    point = torch.from_numpy(wider.space.point(space.start))
    for row, (axis, sign) in enumerate([(0, -1), (0, 1), (1, -1), (1, 1)]):
        moved = point.clone()
        moved[3 + axis] = prior.centre[axis] + sign * prior.spread[axis]
        expected = wider.residuals(moved) - wider.residuals(point)
        torch.testing.assert_close(changes[row], expected[: 3 * COUNT])


def test_nothing_held_changes_nothing():
    assert OBJECTIVE.changes(POINT, ()).shape == (0, 3 * COUNT)
