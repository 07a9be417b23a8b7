"""What froxel fog is drawn from: a camera's frames, what they show without fog, and the lights, noise and wind."""

from dataclasses import replace
from typing import Any

from jaxtyping import Float
from torch import Tensor
from torch.utils import _pytree as pytree

from diffrender.atmosphere.froxel_grid import Eye, Grid
from diffrender.atmosphere.froxel_lights import Lights
from diffrender.parameters import record


@record
class FroxelView:
    """A sequence of frames, in the order of time; also one of them, without the axis of time.

    A batch is of layers that are seen through one grid, such as what is opaque and what is transparent before it.
    """

    grid: Grid
    eye: Eye
    background: Float[Tensor, "*batch height width 3"]  # radiance [W/(m² sr)]
    distance: Float[Tensor, "*batch height width"]  # from the eye, not along its view; infinite for the sky [m]
    lights: Lights
    noise: Float[Tensor, "depth rows columns"] | None  # from -1 to 1, repeating without a seam; by x, y and z
    displacement: Float[Tensor, "*frames 3"]  # by which wind has carried the noise, as `weather.wind` gives it [m]

    def in_order(self) -> "list[FroxelView]":
        """The frames one by one."""
        layers = zip(self.background.unbind(-4), self.distance.unbind(-3), strict=True)
        return [
            replace(
                self,
                eye=_at(self.eye, number),
                background=background,
                distance=distance,
                lights=_at(self.lights, number),
                displacement=self.displacement[number],
            )
            for number, (background, distance) in enumerate(layers)
        ]


def _at(sequence: Any, number: int) -> Any:
    """One entry of the axis of time of all tensors of a record."""
    return pytree.tree_map_only(Tensor, lambda tensor: tensor[number], sequence)
