"""How wet rain keeps a place: what falls on it, roofs and boxes that keep it dry, and time to soak and to dry.

Characters and vehicles move under roofs; designers place boxes there, inside which nothing stays wet [1]. Neither turns
dry at once: wetness follows what it tends to exponentially, w' = w e^(-dt / tau), so that it is the same however the
time is split into frames.

Gradient: exact; as of soaking where a surface is as wet as it tends to be. 0 of a place that lies wholly inside or
outside of a box.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, "Rain: Problems".
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.numerics import opacity, smooth_rise
from diffrender.parameters import record


@record
class DryBoxes:
    """Boxes along the axes in which it does not rain: the middle, half of the size, and inside it the border [m].

    Over the border it gets dry by and by; a border of 0 is a step.
    """

    middle: Float[Tensor, "boxes 3"]
    half_size: Float[Tensor, "boxes 3"]
    border: Float[Tensor, " boxes"]


def open_to_rain(boxes: DryBoxes, position: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch"]:
    """Share of the rain that boxes let fall on a place: 0 well inside of any, 1 outside of all.

    >>> boxes = DryBoxes(torch.zeros(1, 3), torch.ones(1, 3), torch.tensor([0.5]))
    >>> open_to_rain(boxes, torch.tensor([[0.0, 0.0, 0.0], [0.75, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    tensor([0.0000, 0.5000, 1.0000])
    """
    within = boxes.half_size - (position[..., None, :] - boxes.middle).abs()
    inside = smooth_rise(within, boxes.border[:, None]).prod(-1)
    return (1.0 - inside).prod(-1)


def followed(
    held: Float[Tensor, "*#batch"],
    towards: Float[Tensor, "*batch"],
    elapsed: Float[Tensor, "*#batch"],
    times: tuple[Float[Tensor, "*#batch"], Float[Tensor, "*#batch"]],
) -> Float[Tensor, "*batch"]:
    """Share of water that a place holds after a time [s], from what it held and tends to, by times to soak and to dry.

    >>> followed(torch.tensor(1.0), torch.tensor(0.0), torch.tensor(60.0), (torch.tensor(5.0), torch.tensor(60.0)))
    tensor(0.3679)
    """
    soak, dry = times
    missing = towards - held
    return held + missing * opacity(elapsed / torch.where(missing < 0.0, dry, soak))
