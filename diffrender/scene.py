"""A scene: the exposure and one optional record per effect."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from types import NoneType
from typing import Any, get_args, get_type_hints

from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.celestial import Sun, pre_exposed, to_sun
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.catalogue import EFFECTS
from diffrender.parameters import Specification, names, parameter, record, specifications


@record
class Exposure:
    """How a picture was exposed."""

    exposure: Float[Tensor, ""] = parameter(
        1.0, bounds=(1e-12, 1e12), unit="1", about="picture value of a radiance of 1", scale="log"
    )


@record
class Scene:
    """Everything that draws a picture; an effect that is None is not there."""

    exposure: Exposure
    sun: Sun
    sky: Sky | None


# Prefix of its names in weather files -> record, in drawing order.
RECORDS: dict[str, type[Any]] = {"": Exposure} | {e.prefix: e.parameters for e in EFFECTS.values()}


@dataclass(frozen=True)
class Place:
    """Where a name of weather files stands in a scene."""

    part: str  # field of Scene
    field: str  # of the part's record
    channel: int | None
    specification: Specification


@cache
def places() -> Mapping[str, Place]:
    """Every name that a weather file may hold, with where it stands and what is known of it, in drawing order."""
    found = {}
    for part, hint in get_type_hints(Scene).items():
        kind = next(one for one in get_args(hint) or (hint,) if one is not NoneType)
        prefix = next(prefix for prefix, record_type in RECORDS.items() if record_type is kind)
        known = specifications(kind)
        found.update({n: Place(part, field, c, known[field]) for n, (field, c) in names(kind, prefix).items()})
    return found


def weather_names() -> dict[str, Specification]:
    """What is known of every name that a weather file may hold, in drawing order."""
    return {
        name: specifications(kind)[field]
        for prefix, kind in RECORDS.items()
        for name, (field, _) in names(kind, prefix).items()
    }


EYE_ALTITUDE = 2.0  # of a photographer who stands on the ground [m]


def sky_view(scene: Scene, direction: Float[Tensor, "*batch 3"]) -> SkyView:
    """What the sky of a scene is drawn from: the sun's irradiance is multiplied by the exposure before, not after."""
    sun = pre_exposed(scene.sun, scene.exposure.exposure)
    return SkyView(direction, to_sun(sun), sun.irradiance, direction.new_tensor(EYE_ALTITUDE))
