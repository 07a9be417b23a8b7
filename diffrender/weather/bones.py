"""Bones in the wind: chains that stand for strips of cloth, strands of hair and tufts of fur.

Air drags on what moves across it, by the square of its speed relative to the bone; along a thin bone it hardly does.
A step moves joints by that, their weight, their stiffness and damping, and then puts each at its bone's length from
the one before, root first [1]: lengths never change, however long a step or strong a wind. What a joint was moved
by that is taken from the velocity of the joint before it, in part, without which chains swing as if their tips were
heavy [1].

Gradient: exact in the bones' numbers, the wind and the state; of a joint that falls onto the one before it none, there
its bone keeps the direction it has at rest.

[1] M. Müller, T. Kim, N. Chentanez, "Fast simulation of inextensible hair and fur", VRIPHYS 2012.
[2] S. Hoerner, "Fluid-dynamic drag", 1965, chapter 3.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import safe_sqrt
from diffrender.parameters import record

AIR_DENSITY = 1.2  # at the ground [kg/m³]
_CYLINDER = 1.1  # drag of a long cylinder per dynamic pressure and area, at Reynolds numbers of 10^3 to 10^5 [2]
_GIVEN_BACK = 0.5  # of a correction, to the joint before [1]; at 0.9 chains never come to rest in a steady wind


@record
class Bones:
    """Chains of joints, the first of which is held; each number may differ from joint to joint."""

    rest: Float[Tensor, "*#batch joints 3"]  # where the joints hang without wind, counted from the first [m]
    drag: Float[Tensor, "*#batch #joints"]  # acceleration per squared speed across the bone [1/m]
    stiffness: Float[Tensor, "*#batch #joints"]  # acceleration towards rest per distance from it [1/s²]
    damping: Float[Tensor, "*#batch #joints"]  # share of a joint's velocity that is lost in a second [1/s]


@record
class Chain:
    """Joints of chains and how fast they move, in the world."""

    joint: Float[Tensor, "*batch joints 3"]  # [m]
    velocity: Float[Tensor, "*batch joints 3"]  # [m/s]


def drag_of(width: Float[Tensor, "*#batch"], mass_per_length: Float[Tensor, "*#batch"]) -> Float[Tensor, "*batch"]:
    """Acceleration per squared speed across a bone [1/m], of its width [m] and its mass per length [kg/m]."""
    return 0.5 * AIR_DENSITY * _CYLINDER * width / mass_per_length


def acceleration(
    drag: Float[Tensor, "*#batch"], relative: Float[Tensor, "*batch 3"], along: Float[Tensor, "*#batch 3"]
) -> Float[Tensor, "*batch 3"]:
    """What wind does to bones [m/s²], from its velocity relative to them and their unit direction: force per mass.

    >>> acceleration(torch.tensor(0.5), torch.tensor([2.0, 0.0, 5.0]), torch.tensor([0.0, 0.0, 1.0]))
    tensor([2., 0., 0.])
    """
    across = _across(relative, along)
    return _rate(drag, across)[..., None] * across


def at_rest(bones: Bones, root: Float[Tensor, "*#batch 3"]) -> Chain:
    """Chains that hang still from a root."""
    joint = root[..., None, :] + bones.rest
    return Chain(joint, torch.zeros_like(joint))


def step(
    bones: Bones,
    chain: Chain,
    root: Float[Tensor, "*#batch 3"],
    wind: Float[Tensor, "*#batch #joints 3"],
    seconds: float,
) -> Chain:
    """The chains after a time step, their roots moved to a place, in a wind at the joints [m/s].

    Drag, stiffness and damping are taken at the step's end, so that no step is too long for them; weight is in the
    pose at rest. Without wind and with the root where it was, chains at rest stay there.
    """
    target = root[..., None, :] + bones.rest
    along = _unit(_bones_of(chain.joint), _bones_of(target))
    across = _across(wind - chain.velocity, along)
    blown = _rate(bones.drag, across)[..., None]
    stiff, damping = bones.stiffness[..., None], bones.damping[..., None]
    pushed = chain.velocity + seconds * (blown * (chain.velocity + across) + stiff * (target - chain.joint))
    velocity = pushed / (1.0 + seconds * (blown + damping) + seconds * seconds * stiff)
    free = chain.joint + seconds * velocity
    joint = _held(free, target)
    moved = (joint - chain.joint) / seconds
    given_back = torch.cat([(free - joint)[..., 1:, :], torch.zeros_like(joint[..., :1, :])], -2)
    corrected = moved + _GIVEN_BACK / seconds * given_back
    # The root's own velocity is what it was moved by.
    return Chain(joint, torch.cat([moved[..., :1, :], corrected[..., 1:, :]], -2))


def _across(relative: Tensor, along: Tensor) -> Tensor:
    return relative - (relative * along).sum(-1, keepdim=True) * along


def _rate(drag: Tensor, across: Tensor) -> Tensor:
    return drag * safe_sqrt((across * across).sum(-1))


def _bones_of(joint: Tensor) -> Tensor:
    """From each joint's predecessor to it; the root has the first bone."""
    bone = joint[..., 1:, :] - joint[..., :-1, :]
    return torch.cat([bone[..., :1, :], bone], -2)


def _unit(vector: Tensor, instead: Tensor) -> Tensor:
    """Unit vectors; of what has no length, those of others instead."""
    is_nothing = (vector * vector).sum(-1, keepdim=True) == 0.0
    taken = torch.where(is_nothing, instead, vector)
    length: Tensor = torch.linalg.vector_norm(taken, dim=-1, keepdim=True)
    return taken / length


def _held(free: Tensor, target: Tensor) -> Tensor:
    """Joints at their bones' lengths from each other, from the root on; one step for each joint."""
    bone = target[..., 1:, :] - target[..., :-1, :]
    lengths = torch.linalg.vector_norm(bone, dim=-1, keepdim=True)
    held = [target[..., 0, :] + torch.zeros_like(free[..., 0, :])]
    for number in range(bone.shape[-2]):
        ahead = _unit(free[..., number + 1, :] - held[-1], bone[..., number, :])
        held.append(held[-1] + lengths[..., number, :] * ahead)
    return torch.stack(held, -2)
