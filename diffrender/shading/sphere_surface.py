"""A light that is a sphere, the surfaces that it shines on, and example surfaces with the hard cases among them."""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.parameters import parameter, record
from diffrender.rays import from_angles


@record
class SphereLight:
    """An evenly bright sphere, such as a lamp or the sun."""

    radius: Float[Tensor, ""] = parameter(
        0.3, bounds=(1e-3, 10.0), unit="m", scale="log",
        about="of the sphere: turned up, wider and softer highlights, and more light",
    )  # fmt: skip
    radiance: Float[Tensor, "3"] = parameter(
        (30.0, 27.0, 22.0), bounds=(0.0, 1e4), unit="radiance", about="of its face: turned up, brighter, as wide"
    )


@record
class SphereView:
    """Surfaces under the light: where they are, unit vectors along their normal and to the eye, and their material."""

    position: Float[Tensor, "*#batch 3"]  # [m]
    normal: Float[Tensor, "*#batch 3"]
    to_eye: Float[Tensor, "*#batch 3"]
    base: Float[Tensor, "*#batch 3"]
    roughness: Float[Tensor, "*#batch"]
    metallic: Float[Tensor, "*#batch"]
    centre: Float[Tensor, "*#batch 3"]  # of the light [m]


# Roughness, metalness, base colour's brightness; distance of the light [m]; elevations of light and eye over the
# surface, and the eye's azimuth from the light's [degrees].
_EXAMPLES = (
    (0.0, 1.0, 0.9, 2.0, 40.0, 40.0, 180.0),  # a mirror, in the middle of the light's picture
    (0.0, 1.0, 0.9, 2.0, 40.0, 45.0, 180.0),  # within it
    (0.0, 0.0, 0.9, 2.0, 40.0, 50.0, 180.0),  # and just outside
    (0.02, 1.0, 0.7, 3.0, 50.0, 43.0, 175.0),
    (0.2, 1.0, 0.8, 2.0, 60.0, 60.0, 180.0),
    (0.2, 0.0, 0.5, 1.0, 35.0, 15.0, 160.0),
    (0.4, 1.0, 0.8, 4.0, 30.0, 20.0, 178.0),
    (0.5, 0.5, 0.6, 1.5, 80.0, 60.0, 100.0),
    (0.6, 0.0, 0.5, 0.5, 45.0, 40.0, 170.0),  # near a light that looks large
    (0.8, 1.0, 0.9, 3.0, 25.0, 70.0, 30.0),
    (1.0, 1.0, 0.9, 2.0, 90.0, 90.0, 0.0),  # straight down
    (1.0, 0.0, 0.9, 1.0, 50.0, 5.0, 90.0),
    (0.3, 1.0, 0.9, 2.0, 9.0, 6.0, 176.0),  # grazing
    (0.3, 0.0, 0.4, 2.0, 8.63, 10.0, 180.0),  # a light that touches the horizon
    (0.5, 0.0, 0.6, 1.0, 0.0, 20.0, 165.0),  # half set
    (0.7, 1.0, 0.6, 2.0, -5.0, 30.0, 180.0),  # its last edge
    (0.4, 0.0, 0.6, 2.0, -30.0, 30.0, 180.0),  # and below
    (0.1, 0.0, 0.5, 60.0, 30.0, 30.3, 180.0),  # a small light far away
)


def example_inputs(dtype: torch.dtype) -> SphereView:
    """Mirrors, metals and rough ground; straight down and grazing; a light near, far, rising and below the horizon."""
    table = torch.tensor(_EXAMPLES, dtype=torch.float64)
    roughness, metallic, bright, distance, height, seen_at, turn = table.unbind(-1)
    to_light, to_eye = (from_angles(up.deg2rad(), around.deg2rad()) for up, around in
                        ((height, torch.zeros_like(turn)), (seen_at, turn)))  # fmt: skip
    # All of it leant over, so that no normal is an axis.
    leant = torch.tensor([[0.8, 0.0, 0.6], [-0.36, 0.8, 0.48], [-0.48, -0.6, 0.64]], dtype=torch.float64)
    centre = torch.tensor([1.0, -2.0, 3.0], dtype=torch.float64)
    given = {
        "position": centre - distance[:, None] * (to_light @ leant.T),
        "normal": leant[:, 2].expand(len(table), 3),
        "to_eye": to_eye @ leant.T,
        "base": bright[:, None] * torch.tensor([1.0, 0.9, 0.75], dtype=torch.float64),
        "roughness": roughness,
        "metallic": metallic,
        "centre": centre,
    }
    return SphereView(**{name: value.to(dtype) for name, value in given.items()})
