"""Which parameters a fit searches: a point of the unit cube is a scene, and the other way round."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.scene import Place, Scene, places
from fit.minimum import Point


@dataclass(frozen=True)
class SearchSpace:
    """Free parameters, by their names in weather files, of a scene that holds the values of all others."""

    start: Scene
    free: tuple[str, ...]

    def scene(self, point: Float[Tensor, " n"]) -> Scene:
        """Scene at a point of the unit cube; differentiable."""
        known = places()
        scene = self.start
        for name, unit in zip(self.free, point.unbind(), strict=True):
            scene = put(scene, known[name], known[name].specification.from_unit(unit))
        return scene

    def point(self, scene: Scene) -> Point:
        """Point of the unit cube where a scene stands."""
        known = places()
        return np.array([float(known[n].specification.to_unit(value(scene, known[n]))) for n in self.free])


def put(scene: Scene, place: Place, value: Tensor) -> Scene:
    """Scene with another value in one place."""
    part = getattr(scene, place.part)
    if place.channel is not None:
        channels = list(getattr(part, place.field).unbind())
        channels[place.channel] = value
        value = torch.stack(channels)
    return replace(scene, **{place.part: replace(part, **{place.field: value})})


def value(scene: Scene, place: Place) -> Tensor:
    """Value in one place of a scene, in the library's unit."""
    whole: Tensor = getattr(getattr(scene, place.part), place.field)
    return whole if place.channel is None else whole[place.channel]
