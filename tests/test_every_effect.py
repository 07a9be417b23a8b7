"""DESIGN section 4: what every effect promises, over the catalogue and its rungs; no effect has tests of its own here.

Parameters are moved in the unit cube of their record, where one step is as large for each; pictures are measured in
units of the reference's brightest value at the defaults.

Inputs are a record of tensors. A tensor whose first axis is as long as the picture's is one of elements (rays, pixels);
the others (tables, an origin for all) are shared by them. So no table of `example_inputs` may have as many rows.
"""

import functools
import sys

import pytest
import torch
from torch.utils import _pytree as pytree

from diffrender.catalogue import EFFECTS
from diffrender.parameters import defaults, from_cube, specifications, to_cube

RUNGS = [pytest.param(effect, rung, id=f"{effect}: {rung}") for effect in EFFECTS for rung in EFFECTS[effect].rungs]
SKIPPABLE = [effect for effect in EFFECTS if "skip" in EFFECTS[effect].rungs]
DTYPES = [torch.float32, torch.float64]

FLOAT32_VALUE = 1e-3  # of the picture's brightest value
FLOAT32_GRADIENT = 1e-2  # of the gradient's length: contributions of rays cancel in it
NO_GRADIENT = 1e-4  # change of the picture, in its brightest value, over the whole box: below it only rounding is left


def last(effect):
    return list(EFFECTS[effect].rungs)[-1]


@functools.cache
def inputs_of(effect, dtype):
    """Example inputs, the same numbers in every dtype: those that float32 can hold."""
    single = EFFECTS[effect].example_inputs(torch.float32)
    return pytree.tree_map_only(torch.Tensor, lambda t: t.to(dtype) if t.is_floating_point() else t, single)


@functools.cache
def reference(effect):
    values = defaults(EFFECTS[effect].parameters, torch.float64)
    return EFFECTS[effect].reference(values, inputs_of(effect, torch.float64))


@functools.cache
def brightest(effect):
    return reference(effect).abs().max().item()


def start(effect):
    """Defaults as a point of the cube; a thousandth inside, so that both sides can be stepped to."""
    return to_cube(defaults(EFFECTS[effect].parameters, torch.float64)).clamp(1e-3, 1.0 - 1e-3)


def record_at(effect, point):
    """Record of parameters at a point of the cube."""
    return from_cube(EFFECTS[effect].parameters, point)


def picture(effect, rung, point, inputs=None):
    """Picture at a point of the cube, in units of the reference."""
    seen = inputs_of(effect, point.dtype) if inputs is None else inputs
    return EFFECTS[effect].rungs[rung](record_at(effect, point), seen) / brightest(effect)


def corners(effect):
    """Name -> point: the defaults, all at their lower bounds, all at their upper, and each alone at either."""
    middle = start(effect)
    found = {"defaults": middle, "all low": torch.zeros_like(middle), "all high": torch.ones_like(middle)}
    for name in specifications(EFFECTS[effect].parameters):
        marked = {n: torch.full_like(v, n == name) for n, v in vars(record_at(effect, middle)).items()}
        mask = torch.cat([value.reshape(-1) for value in marked.values()]).bool()
        found |= {f"{name} low": middle.masked_fill(mask, 0.0), f"{name} high": middle.masked_fill(mask, 1.0)}
    return found


def weights_of(drawn):
    """Uneven weights of a sum over a picture, in which no two elements cancel by symmetry."""
    return torch.cos(torch.arange(drawn.numel(), dtype=torch.float64)).to(drawn.dtype).reshape(drawn.shape)


@functools.cache
def at_corners(effect, rung, dtype):
    """Picture at each corner, and the gradient of a weighted sum of it; all corners at once."""
    points = corners(effect)
    leaf = torch.stack(list(points.values())).to(dtype).requires_grad_()
    drawn = torch.func.vmap(functools.partial(picture, effect, rung))(leaf)
    # Times 0 for the rungs, like skip, that do not depend on their parameters.
    total = (drawn * weights_of(drawn[0])).sum() + 0.0 * leaf.sum()
    (slopes,) = torch.autograd.grad(total, leaf)
    return dict(zip(points, zip(drawn.detach(), slopes, strict=True), strict=True))


def elements(inputs, count, change):
    """Inputs with every tensor of elements changed."""
    return pytree.tree_map_only(
        torch.Tensor, lambda tensor: change(tensor) if tensor.shape[:1] == (count,) else tensor, inputs
    )


@pytest.mark.parametrize(("effect", "rung"), RUNGS)
def test_gradients_match_finite_differences(effect, rung):
    def draw(point):
        return picture(effect, rung, point)

    # Fast mode projects on random directions, so that its cost does not grow with the picture or the record.
    point = start(effect).requires_grad_()
    assert torch.autograd.gradcheck(draw, point, check_forward_ad=True, check_batched_grad=True, fast_mode=True)


@pytest.mark.parametrize(("effect", "rung"), RUNGS)
def test_jacobian_matches_finite_differences_in_every_element_and_parameter(effect, rung):
    def draw(point):
        return picture(effect, rung, point)

    def along(direction):
        return torch.func.jvp(draw, (point,), (direction,))[1]

    point, step = start(effect), 1e-6
    directions = torch.eye(len(point), dtype=point.dtype)
    jacobian = torch.func.vmap(along)(directions)  # as fits do
    above, below = (torch.func.vmap(draw)(point + sign * step * directions) for sign in (1.0, -1.0))
    differences = (above - below) / (2.0 * step)
    torch.testing.assert_close(jacobian, differences, rtol=1e-3, atol=1e-6)

    _, reverse = at_corners(effect, rung, torch.float64)["defaults"]
    forward = (jacobian * weights_of(jacobian[0])).flatten(1).sum(1)
    torch.testing.assert_close(reverse, forward, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("effect", "rung"), RUNGS)
def test_forward_mode_holds_in_float32(effect, rung):
    # From records: torch's forward mode gives numbers on their way from the cube, which have no axis, double tangents.
    point = start(effect)
    made = functools.partial(record_at, effect)
    at, towards = torch.func.jvp(made, (point,), (torch.cos(torch.arange(len(point), dtype=point.dtype)),))

    def along(dtype):
        record, direction, seen = pytree.tree_map_only(
            torch.Tensor, lambda t: t.to(dtype) if t.is_floating_point() else t, (at, towards, inputs_of(effect, dtype))
        )
        many = pytree.tree_map(lambda one: one[None], direction)

        def draw(record):
            return EFFECTS[effect].rungs[rung](record, seen) / brightest(effect)

        return torch.func.vmap(lambda one: torch.func.jvp(draw, (record,), (one,))[1])(many)

    single, double = along(torch.float32), along(torch.float64)
    torch.testing.assert_close(single.double(), double, rtol=1e-3, atol=1e-3 * float(double.abs().max()) + 1e-6)


@pytest.mark.parametrize("effect", EFFECTS)
def test_last_rung_reaches_the_reference_within_a_tolerance_that_is_not_slack(effect):
    values = defaults(EFFECTS[effect].parameters, torch.float64)
    drawn = EFFECTS[effect].rungs[last(effect)](values, inputs_of(effect, torch.float64))
    error = (drawn - reference(effect)).abs().max() / brightest(effect)
    assert EFFECTS[effect].tolerance / 3.0 <= error <= EFFECTS[effect].tolerance


@pytest.mark.parametrize(("effect", "rung"), RUNGS)
def test_float32_follows_float64_at_the_corners(effect, rung):
    single, double = (at_corners(effect, rung, dtype) for dtype in DTYPES)
    wrong = {}
    for corner, (truth, slope) in double.items():
        brightness = truth.abs().max().clamp(min=1e-30)  # float32 ends at 1e-38
        value_error = (single[corner][0].double() - truth).abs().max() / brightness
        slope_error = (single[corner][1].double() - slope).norm() / (slope.norm() + NO_GRADIENT * brightness)
        if not (value_error <= FLOAT32_VALUE and slope_error <= FLOAT32_GRADIENT):
            wrong[corner] = f"value off by {value_error:.1e}, gradient by {slope_error:.1e}"
    assert wrong == {}


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize(("effect", "rung"), RUNGS)
def test_picture_and_gradient_are_finite_at_the_corners(effect, rung, dtype):
    found = at_corners(effect, rung, dtype)
    assert [corner for corner, tensors in found.items() if not all(t.isfinite().all() for t in tensors)] == []


@pytest.mark.parametrize("effect", SKIPPABLE)
def test_largest_change_is_a_bound(effect):
    skipped, drawn = (at_corners(effect, rung, torch.float64) for rung in ("skip", last(effect)))
    wrong = {}
    for corner, point in corners(effect).items():
        change = (drawn[corner][0] - skipped[corner][0]).abs() * brightest(effect)
        bound = EFFECTS[effect].largest_change(record_at(effect, point), inputs_of(effect, torch.float64))
        if not (change <= bound * (1.0 + 1e-12)).all():
            wrong[corner] = f"changes by {change.max():.3e}, bound is {bound.max():.3e}"
    assert wrong == {}


@pytest.mark.parametrize(
    ("dtype", "device"),
    [
        (torch.float32, "cpu"),
        (torch.float64, "cpu"),
        (torch.float32, "meta"),
        pytest.param(torch.float32, "cuda", marks=pytest.mark.gpu),
    ],
)
@pytest.mark.parametrize(("effect", "rung"), RUNGS)
def test_picture_has_the_dtype_and_device_of_the_inputs(effect, rung, dtype, device):
    if device == "cuda" and not torch.cuda.is_available():
        pytest.skip("needs a CUDA device")
    # The meta device has shapes but no numbers, so it also finds decisions on values.
    given = defaults(EFFECTS[effect].parameters, dtype), inputs_of(effect, dtype)
    drawn = EFFECTS[effect].rungs[rung](*pytree.tree_map_only(torch.Tensor, lambda t: t.to(device), given))
    assert (drawn.dtype, drawn.device.type) == (dtype, device)


@pytest.mark.parametrize(("effect", "rung"), RUNGS)
def test_picture_has_the_batch_shape_of_the_inputs(effect, rung):
    whole = picture(effect, rung, start(effect))
    inputs = elements(inputs_of(effect, torch.float64), len(whole), lambda tensor: tensor[:, None])
    torch.testing.assert_close(picture(effect, rung, start(effect), inputs), whole[:, None], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("effect", "rung"), RUNGS)
def test_a_batch_equals_its_elements_one_by_one(effect, rung):
    whole = picture(effect, rung, start(effect))
    inputs = inputs_of(effect, torch.float64)
    alone = [elements(inputs, len(whole), lambda tensor, i=i: tensor[i]) for i in range(len(whole))]
    drawn = torch.stack([picture(effect, rung, start(effect), one) for one in alone])
    torch.testing.assert_close(drawn, whole, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("effect", EFFECTS)
def test_last_rung_is_the_render_of_its_module(effect):
    rung = EFFECTS[effect].rungs[last(effect)]
    assert sys.modules[rung.render.__module__].render in (rung, rung.render)


def test_a_prefix_is_of_one_record_and_a_record_of_one_prefix():
    pairs = {(effect.prefix, effect.parameters) for effect in EFFECTS.values()}
    assert len(pairs) == len({prefix for prefix, _ in pairs}) == len({kind for _, kind in pairs})
