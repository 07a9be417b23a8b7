import dataclasses
import math
from typing import Any

import pytest
import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.parameters import (
    Specification,
    defaults,
    from_cube,
    names,
    parameter,
    record,
    specifications,
    to_cube,
)

LINEAR = Specification(1.0, (-2.0, 3.0), "m", "a length")
LOG = Specification(1.0, (1e-12, 1e12), "1", "a ratio", "log")
DTYPES = [torch.float32, torch.float64]


@record
class Haze:
    amount: Float[Tensor, "*batch"] = parameter(0.5, bounds=(0.0, 1.0), unit="1", about="opacity")
    tilt: Float[Tensor, "*batch"] = parameter(
        0.25, bounds=(-1.0, 2.0), unit="rad", about="slope", in_files=("degrees", -180.0 / math.pi)
    )
    tint: Float[Tensor, "*batch 3"] = parameter((0.1, 0.2, 0.3), bounds=(0.05, 5.0), unit="1", about="hue", scale="log")


def haze(dtype: torch.dtype = torch.float64) -> Haze:
    return defaults(Haze, dtype)


@pytest.mark.parametrize("known", [LINEAR, LOG])
@pytest.mark.parametrize("dtype", DTYPES)
def test_the_ends_of_the_unit_are_exactly_the_bounds(known: Specification, dtype: torch.dtype) -> None:
    ends = torch.tensor([0.0, 1.0], dtype=dtype)
    assert torch.equal(known.from_unit(ends), torch.tensor(known.bounds, dtype=dtype))
    torch.testing.assert_close(known.to_unit(known.from_unit(ends)), ends, rtol=1e-6, atol=0.0)


@pytest.mark.parametrize("known", [LINEAR, LOG])
@pytest.mark.parametrize("dtype", DTYPES)
def test_the_box_is_never_left(known: Specification, dtype: torch.dtype) -> None:
    tiny = torch.finfo(dtype).tiny
    unit = torch.cat([torch.linspace(0.0, 1.0, 1001, dtype=dtype), torch.tensor([tiny, 1.0 - torch.finfo(dtype).eps])])
    low, high = torch.tensor(known.bounds, dtype=dtype)
    assert bool(((known.from_unit(unit.to(dtype)) >= low) & (known.from_unit(unit.to(dtype)) <= high)).all())


@pytest.mark.parametrize("known", [LINEAR, LOG])
@pytest.mark.parametrize(("dtype", "rounding"), [(torch.float32, 1e-6), (torch.float64, 1e-14)])
def test_unit_and_value_are_inverse(known: Specification, dtype: torch.dtype, rounding: float) -> None:
    unit = torch.linspace(0.0, 1.0, 101, dtype=dtype)
    torch.testing.assert_close(known.to_unit(known.from_unit(unit)), unit, rtol=0.0, atol=rounding)


def test_halfway_lies_the_mean_of_the_scale() -> None:
    half = torch.tensor(0.5, dtype=torch.float64)
    assert float(LINEAR.from_unit(half)) == 0.5
    assert float(LOG.from_unit(half)) == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_gradients_of_unit_and_value_are_the_finite_differences(scale: Any) -> None:
    unit = torch.tensor([0.05, 0.4999, 0.5, 0.5001, 0.7], dtype=torch.float64, requires_grad=True)
    small = Specification(1.0, (0.1, 10.0), "1", "a ratio", scale)
    assert torch.autograd.gradcheck(small.from_unit, unit, check_forward_ad=True, check_batched_grad=True)
    value = small.from_unit(unit).detach().requires_grad_()
    assert torch.autograd.gradcheck(small.to_unit, value, check_forward_ad=True, check_batched_grad=True)


@pytest.mark.parametrize("known", [LINEAR, LOG])
def test_gradients_at_the_bounds_are_those_of_the_inside(known: Specification) -> None:
    unit = torch.tensor([0.0, 1.0], dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(known.from_unit(unit).sum(), unit)
    low, high = known.bounds
    scales = [math.log(high / low) * bound for bound in known.bounds] if known.scale == "log" else [high - low] * 2
    assert slope.tolist() == pytest.approx(scales, rel=1e-14)


@pytest.mark.parametrize(
    ("default", "bounds", "scale"),
    [
        (2.0, (0.0, 1.0), "linear"),
        (-0.1, (0.0, 1.0), "linear"),
        (math.nan, (0.0, 1.0), "linear"),
        ((0.5, 0.5, 1.5), (0.0, 1.0), "linear"),
        (1.0, (1.0, 1.0), "linear"),
        (0.5, (1.0, 0.0), "linear"),
        (0.5, (math.nan, 1.0), "linear"),
        (0.5, (0.0, 1.0), "log"),
        (0.5, (-1.0, 1.0), "log"),
    ],
)
def test_a_declaration_that_no_fit_could_use_is_refused(default: Any, bounds: tuple[float, float], scale: Any) -> None:
    with pytest.raises(ValueError, match="bounds"):
        Specification(default, bounds, "1", "nothing", scale)


def test_defaults_may_lie_on_the_bounds() -> None:
    assert Specification((0.0, 0.5, 1.0), (0.0, 1.0), "1", "ends").default == (0.0, 0.5, 1.0)


def test_files_have_the_unit_and_factor_of_their_own_where_there_is_one() -> None:
    known = specifications(Haze)
    assert (known["amount"].file_unit, known["amount"].file_factor) == ("1", 1.0)
    assert known["amount"].file_bounds == known["amount"].bounds
    assert known["tilt"].file_unit == "degrees"


def test_bounds_in_files_rise_although_the_factor_turns_them() -> None:
    assert specifications(Haze)["tilt"].file_bounds == pytest.approx((-360.0 / math.pi, 180.0 / math.pi), rel=1e-15)


def test_specifications_stand_in_the_order_of_declaration() -> None:
    assert list(specifications(Haze)) == ["amount", "tilt", "tint"]


def test_names_have_the_prefix_and_the_channel() -> None:
    assert names(Haze, "HAZE") == {
        "HAZE_AMOUNT": ("amount", None),
        "HAZE_TILT": ("tilt", None),
        "HAZE_TINT_R": ("tint", 0),
        "HAZE_TINT_G": ("tint", 1),
        "HAZE_TINT_B": ("tint", 2),
    }


def test_names_without_a_prefix_are_the_fields() -> None:
    assert list(names(Haze, "")) == ["AMOUNT", "TILT", "TINT_R", "TINT_G", "TINT_B"]


@pytest.mark.parametrize("dtype", DTYPES)
def test_defaults_are_those_declared_in_the_dtype_asked_for(dtype: torch.dtype) -> None:
    found = defaults(Haze, dtype)
    assert torch.equal(found.amount, torch.tensor(0.5, dtype=dtype))
    assert torch.equal(found.tint, torch.tensor([0.1, 0.2, 0.3], dtype=dtype))
    assert found.tint.dtype == dtype


def test_a_record_needs_every_field() -> None:
    with pytest.raises(TypeError, match="tint"):
        Haze(amount=torch.tensor(0.5), tilt=torch.tensor(0.0))


def test_a_record_does_not_change() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        haze().amount = torch.tensor(0.7)  # type: ignore[misc]


def test_a_record_equals_itself_only() -> None:
    one = haze()
    assert one == one
    assert one != haze()
    assert len({one, haze()}) == 2


def test_tree_maps_see_through_records() -> None:
    doubled = pytree.tree_map(lambda tensor: 2.0 * tensor, haze())
    assert isinstance(doubled, Haze)
    assert torch.equal(doubled.tint, 2.0 * haze().tint)


def test_tree_maps_may_put_anything_into_a_record() -> None:
    leaves, shape = pytree.tree_flatten(haze())
    rebuilt = pytree.tree_unflatten([None, 3, "x"], shape)
    assert (len(leaves), rebuilt.amount, rebuilt.tilt, rebuilt.tint) == (3, None, 3, "x")


def brightness(whole: Haze) -> Tensor:
    return whole.amount * torch.exp(whole.tilt) * whole.tint.sum(-1)


def test_torch_func_differentiates_by_a_record() -> None:
    slope = torch.func.grad(brightness)(haze())
    assert isinstance(slope, Haze)
    assert float(slope.amount) == pytest.approx(0.6 * math.exp(0.25), rel=1e-14)
    assert slope.tint.tolist() == pytest.approx([0.5 * math.exp(0.25)] * 3, rel=1e-14)


def test_vmap_of_jvp_through_a_record_agrees_with_reverse_mode() -> None:
    slope = torch.func.grad(brightness)(haze())
    directions = Haze(*(torch.stack([tensor, -tensor]) for tensor in pytree.tree_leaves(haze())))
    along = torch.func.vmap(lambda way: torch.func.jvp(brightness, (haze(),), (way,))[1])(directions)
    expected = sum((a * b).sum() for a, b in zip(pytree.tree_leaves(slope), pytree.tree_leaves(haze()), strict=True))
    torch.testing.assert_close(along, torch.stack([expected, -expected]), rtol=1e-14, atol=0.0)


def test_a_record_comes_back_from_the_cube() -> None:
    back = from_cube(Haze, to_cube(haze()))
    torch.testing.assert_close(dataclasses.asdict(back), dataclasses.asdict(haze()), rtol=1e-14, atol=0.0)


def test_a_place_in_the_cube_moves_the_scalar_of_that_name() -> None:
    middle = to_cube(haze())
    for place, (name, channel) in enumerate(names(Haze, "").values()):
        moved = from_cube(Haze, middle.index_fill(0, torch.tensor(place), 1.0))
        changed = {n: getattr(moved, n) != getattr(from_cube(Haze, middle), n) for n in specifications(Haze)}
        assert [n for n, differs in changed.items() if bool(differs.any())] == [name]
        assert channel is None or changed[name].tolist() == [one == channel for one in range(3)]


def test_a_point_of_another_length_is_no_record() -> None:
    with pytest.raises(RuntimeError, match="split"):
        from_cube(Haze, torch.zeros(4))
