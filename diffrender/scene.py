"""A scene: the camera and one optional record per effect."""

from typing import Any

from jaxtyping import Float
from torch import Tensor

from diffrender.atmosphere.celestial import Sun
from diffrender.catalogue import EFFECTS
from diffrender.parameters import Specification, names, parameter, record, specifications


@record
class Camera:
    """How a picture was exposed."""

    exposure: Float[Tensor, ""] = parameter(
        1.0, bounds=(1e-12, 1e12), unit="1", about="picture value of a radiance of 1", scale="log"
    )


# Prefix of its names in weather files -> record.
RECORDS: dict[str, type[Any]] = {"": Camera, "SUN": Sun} | {e.prefix: e.parameters for e in EFFECTS.values()}


def weather_names() -> dict[str, Specification]:
    """Every name that a weather file may hold, with what is known of it, in drawing order."""
    return {
        name: specifications(kind)[field]
        for prefix, kind in RECORDS.items()
        for name, (field, _) in names(kind, prefix).items()
    }
