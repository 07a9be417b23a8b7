from dataclasses import replace

import pytest
import torch

from diffrender.weather.bones import Bones, Chain, acceleration, at_rest, drag_of, step

FLOAT = torch.float64
ROOT = torch.tensor([1.0, -2.0, 1.5], dtype=FLOAT)


def hair(joints=6, dtype=FLOAT, **changed):
    """A strand of 30 cm that hangs in a slight curve."""
    length = torch.linspace(0.0, 0.3, joints, dtype=FLOAT)
    rest = torch.stack([0.1 * length * length, torch.zeros_like(length), -length], -1)
    numbers = {"drag": 0.8, "stiffness": 60.0, "damping": 2.0} | changed
    return Bones(rest.to(dtype), *(torch.full((joints,), value, dtype=dtype) for value in numbers.values()))


def lengths(joint):
    return (joint[..., 1:, :] - joint[..., :-1, :]).norm(dim=-1)


def blown(bones, wind, steps, seconds=1.0 / 60.0):
    wind = torch.as_tensor(wind, dtype=bones.rest.dtype).expand(bones.rest.shape)
    chain = at_rest(bones, ROOT.to(bones.rest.dtype))
    for _ in range(steps):
        chain = step(bones, chain, ROOT.to(bones.rest.dtype), wind, seconds)
    return chain


def test_drag_is_the_square_across_and_nothing_along():
    along = torch.tensor([0.6, 0.0, 0.8], dtype=FLOAT)
    across = torch.tensor([-0.8, 0.0, 0.6], dtype=FLOAT)
    drag = drag_of(torch.tensor(1e-4, dtype=FLOAT), torch.tensor(1e-5, dtype=FLOAT))
    found = acceleration(drag, 3.0 * across + 5.0 * along, along)
    torch.testing.assert_close(found, 9.0 * drag * across)
    torch.testing.assert_close(drag, torch.tensor(0.5 * 1.2 * 1.1 * 10.0, dtype=FLOAT))


def test_at_rest_without_wind_nothing_moves():
    bones = hair()
    still = blown(bones, [0.0, 0.0, 0.0], 100)
    torch.testing.assert_close(still.joint, ROOT + bones.rest, rtol=0.0, atol=1e-14)
    torch.testing.assert_close(still.velocity, torch.zeros_like(bones.rest), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(("dtype", "rounding"), [(torch.float32, 1e-6), (FLOAT, 1e-14)])
@pytest.mark.parametrize(("speed", "seconds"), [(4.0, 1.0 / 60.0), (300.0, 0.5)])
def test_bones_keep_their_lengths_in_every_wind_and_step(dtype, rounding, speed, seconds):
    bones = hair(dtype=dtype, stiffness=1.0, damping=0.0)
    chain = blown(bones, [speed, 0.3 * speed, 0.0], 40, seconds)
    assert chain.velocity.isfinite().all()
    torch.testing.assert_close(lengths(chain.joint), lengths(bones.rest), rtol=0.0, atol=2.0 * rounding)
    torch.testing.assert_close(chain.joint[0], ROOT.to(dtype))


def test_a_steady_wind_ends_in_a_lean_that_grows_with_the_wind():
    settled = [blown(hair(4), [speed, 0.0, 0.0], 300) for speed in (2.0, 6.0)]
    weak, strong = (float(one.joint[-1, 0] - ROOT[0]) for one in settled)
    assert 0.02 < weak < strong < 0.3
    wind = torch.tensor([[6.0, 0.0, 0.0]], dtype=FLOAT)
    later = step(hair(4), settled[1], ROOT, wind, 1.0 / 60.0)
    torch.testing.assert_close(later.joint, settled[1].joint, rtol=0.0, atol=1e-4)


def test_a_root_that_moves_leaves_the_tip_behind_for_a_while():
    bones, moved = hair(4), ROOT + torch.tensor([0.05, 0.0, 0.0], dtype=FLOAT)
    calm = torch.zeros(1, 3, dtype=FLOAT)
    first = chain = step(bones, at_rest(bones, ROOT), moved, calm, 1.0 / 60.0)
    assert float(first.joint[-1, 0] - ROOT[0] - bones.rest[-1, 0]) < 0.01
    for _ in range(400):
        chain = step(bones, chain, moved, calm, 1.0 / 60.0)
    torch.testing.assert_close(chain.joint, moved + bones.rest, rtol=0.0, atol=1e-4)


def test_chains_of_a_batch_are_each_alone():
    bones = hair()
    winds = torch.tensor([[[3.0, 0.0, 0.0]], [[0.0, -7.0, 1.0]]], dtype=FLOAT)
    roots = torch.stack([ROOT, ROOT + 1.0])
    both = step(bones, at_rest(bones, roots), roots, winds, 0.02)
    for one, root, wind in zip(both.joint, roots, winds, strict=True):
        torch.testing.assert_close(one, step(bones, at_rest(bones, root), root, wind, 0.02).joint)


def test_a_joint_that_falls_onto_the_one_before_has_finite_gradients():
    bones = replace(hair(3), stiffness=torch.zeros(3, dtype=FLOAT), drag=torch.zeros(3, dtype=FLOAT))
    joint = (ROOT + bones.rest).clone()
    joint[1] = joint[0]
    joint.requires_grad_()
    after = step(bones, Chain(joint, torch.zeros_like(joint)), ROOT, torch.zeros(1, 3, dtype=FLOAT), 0.02).joint
    torch.testing.assert_close(lengths(after), lengths(bones.rest))
    assert torch.autograd.grad(after.sum(), joint)[0].isfinite().all()


def test_gradients_match_finite_differences():
    bones, start = hair(4), blown(hair(4), [2.0, 1.0, 0.0], 5)

    def move(*given):
        rest, drag, stiffness, damping, joint, velocity, root, wind = given
        after = step(Bones(rest, drag, stiffness, damping), Chain(joint, velocity), root, wind, 0.02)
        return after.joint, after.velocity

    wind = torch.tensor([[3.0, -1.0, 0.5]], dtype=FLOAT)
    given = [*vars(bones).values(), *vars(start).values(), ROOT, wind]
    leaves = [one.clone().requires_grad_() for one in given]
    assert torch.autograd.gradcheck(move, leaves, check_forward_ad=True, check_batched_grad=True)
