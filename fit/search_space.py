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
        parts: dict[str, dict[str, Tensor]] = {}
        for name, unit in zip(self.free, point.unbind(), strict=True):
            place = known[name]
            fields = parts.setdefault(place.part, {})
            whole = fields.get(place.field, getattr(getattr(self.start, place.part), place.field))
            fields[place.field] = _with_channel(whole, place.channel, place.specification.from_unit(unit))
        # One new record for each part: this runs at every evaluation.
        return replace(self.start, **{part: replace(getattr(self.start, part), **new) for part, new in parts.items()})

    def point(self, scene: Scene) -> Point:
        """Point of the unit cube where a scene stands."""
        known = places()
        return np.array([float(known[n].specification.to_unit(value(scene, known[n]))) for n in self.free])


def put(scene: Scene, place: Place, value: Tensor) -> Scene:
    """Scene with another value in one place."""
    part = getattr(scene, place.part)
    whole = _with_channel(getattr(part, place.field), place.channel, value)
    return replace(scene, **{place.part: replace(part, **{place.field: whole})})


def _with_channel(whole: Tensor, channel: int | None, value: Tensor) -> Tensor:
    if channel is None:
        return value
    channels = list(whole.unbind())
    channels[channel] = value
    return torch.stack(channels)


def value(scene: Scene, place: Place) -> Tensor:
    """Value in one place of a scene, in the library's unit."""
    whole: Tensor = getattr(getattr(scene, place.part), place.field)
    return whole if place.channel is None else whole[place.channel]
