"""Eyes by slow and plain means: the ray into the eye is traced by angles, and tears are summed over facets.

The ground that is found is lit as the basic material, which is not under test, by one light at a time, each with what
crosses the tears of it; so is the sky, part by part. That the iris is lit as a bowl is the model, not under test.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.sampling import fibonacci
from diffrender.shading import brdf
from diffrender.shading.brdf import Geometry
from diffrender.shading.clear_coat_reference import crossed, facets, mirrored
from diffrender.shading.eye_ball import LEAST_DESCENT, PUPIL_EDGE, RIM_LEFT, TEARS, Eye, EyeView
from diffrender.shading.microfacet import LEAST_COSINE

_DIRECTIONS = 1500  # of the sky


def reference(eye: Eye, view: EyeView) -> Float[Tensor, "*batch 3"]:
    """Radiance of an eye towards the one who sees it [W/(m² sr)]."""
    frame, seen_from = _frame(view)
    base, normal = _ground(eye, view)
    one = torch.ones_like(normal[..., 0])
    matt = brdf.material(base, one, 0 * one)
    weight, mirror = facets(TEARS, eye.wet_roughness, seen_from)
    total = (weight[..., None] * _sky(view, torch.einsum("...ji,...klj->...kli", frame, mirror))).sum((-3, -2))
    parts = fibonacci(_DIRECTIONS, normal.dtype)
    below = 0 * base
    for part in torch.split(parts, 100):
        towards = part.expand(*normal.shape[:-1], len(part), 3)
        geometry = Geometry(normal[..., None, :], view.to_eye[..., None, :], towards)
        share = brdf.reflected(_repeated(matt), geometry) * _entered(eye, frame, towards)[..., None]
        below = below + (share * _sky(view, part)).sum(-2) * (4 * math.pi / _DIRECTIONS)
    for to_light, irradiance in zip(view.lights.to_light, view.lights.irradiance, strict=True):
        towards = to_light.expand_as(normal)
        light = torch.einsum("...ij,...j", frame, towards)
        shine = mirrored(TEARS, eye.wet_roughness, seen_from, light) * light[..., 2].clip(0, 1)
        ground = brdf.reflected(matt, Geometry(normal, view.to_eye, towards))
        entered = _entered(eye, frame, towards[..., None, :])
        total, below = total + irradiance * shine[..., None], below + irradiance * ground * entered
    return total + crossed(TEARS, eye.wet_roughness, seen_from)[..., None] * below


def _repeated(matt: brdf.Material) -> brdf.Material:
    return brdf.Material(matt.diffuse[..., None, :], matt.straight[..., None, :], matt.roughness[..., None])


def _frame(view: EyeView) -> tuple[Tensor, Tensor]:
    """Rotation from the world to the wet surface's own axes, and the direction to the eye there."""
    helper = torch.eye(3, dtype=view.normal.dtype)[view.normal.abs().argmin(-1)]
    first = torch.linalg.cross(view.normal, helper)
    first = first / first.norm(dim=-1, keepdim=True)
    frame = torch.stack([first, torch.linalg.cross(view.normal, first), view.normal], -2)
    local = torch.einsum("...ij,...j", frame, view.to_eye)
    return frame, torch.cat([local[..., :2], local[..., 2:].clip(LEAST_COSINE, 1)], -1)


def _sky(view: EyeView, direction: Tensor) -> Tensor:
    return view.lights.sky.mean + view.lights.sky.gradient * direction[..., 2:]


def _entered(eye: Eye, frame: Tensor, towards: Tensor) -> Tensor:
    """What crosses the tears from directions, by a table over the cosine's root; from below as at the horizon."""
    root = torch.linspace(0, 1, 129, dtype=towards.dtype)
    table = crossed(TEARS, eye.wet_roughness, torch.stack([torch.sqrt(1 - root**4), 0 * root, root**2], -1))
    cosine = torch.einsum("...j,...kj->...k", frame[..., 2, :], towards).clip(LEAST_COSINE, 1)
    place = torch.sqrt(cosine) * 128
    lower = place.long().clip(max=127)
    return table[lower] + (place - lower) * (table[lower + 1] - table[lower])


def _ground(eye: Eye, view: EyeView) -> tuple[Tensor, Tensor]:
    """Base colour and normal of what is seen, the ray turned by the angle that Snell's law says."""
    gaze, normal = view.gaze, view.normal
    sideways = view.to_eye - (view.to_eye * normal).sum(-1, keepdim=True) * normal
    angle = torch.atan2(sideways.norm(dim=-1), (view.to_eye * normal).sum(-1))
    turned = torch.asin(torch.sin(angle) / eye.refraction)[..., None]
    ray = -(torch.cos(turned) * normal + torch.sin(turned) * sideways / sideways.norm(dim=-1, keepdim=True))
    left = torch.linalg.cross(gaze, view.up)
    # Coordinates along up, left and gaze, the last from the iris' plane.
    axes = torch.stack([view.up, left, gaze], -2)
    depth = torch.cos(torch.asin(eye.iris_radius)) - eye.iris_depth
    start = torch.einsum("...ij,...j", axes, view.place)
    step = torch.einsum("...ij,...j", axes, ray)
    steps = (start[..., 2] - depth) / (-step[..., 2]).clip(min=LEAST_DESCENT)
    met = start[..., :2] + steps[..., None] * step[..., :2]
    far = met.norm(dim=-1)
    iris = eye.iris_colour * (_picture(eye, view, met, far) * _shade(eye, far))[..., None]
    outer = (start[..., :2].norm(dim=-1) - eye.iris_radius + eye.limbus_width / 2) / eye.limbus_width
    share = torch.where(start[..., 2] > 0, 1 - _rise(outer), 0 * outer)[..., None]
    slope = eye.iris_bowl * met / torch.maximum(far, eye.iris_radius)[..., None]
    bowl = torch.nn.functional.normalize(torch.cat([-slope, torch.ones_like(far)[..., None]], -1), dim=-1)
    bowl = torch.einsum("...ji,...j", axes, bowl)
    ball = torch.nn.functional.normalize(view.place, dim=-1)
    mixed = torch.nn.functional.normalize(bowl * share + ball * (1 - share), dim=-1)
    return iris * share + eye.sclera_colour * (1 - share), mixed


def _rise(x: Tensor) -> Tensor:
    x = x.clip(0, 1)
    return 3 * x**2 - 2 * x**3


def _shade(eye: Eye, far: Tensor) -> Tensor:
    rim = _rise((far - eye.iris_radius + eye.limbus_width) / eye.limbus_width)
    return (1 - rim + rim * RIM_LEFT) * _rise((far - eye.pupil_radius + PUPIL_EDGE / 2) / PUPIL_EDGE)


def _picture(eye: Eye, view: EyeView, met: Tensor, far: Tensor) -> Tensor:
    """Brightness of the iris' picture: the sum of all its entries, each with the weight of a tent."""
    rings, turns = view.iris.shape
    row = (far / eye.iris_radius * (rings - 1)).clip(max=rings - 1)
    column = (torch.atan2(met[..., 1], met[..., 0]) / (2 * math.pi) + 1) % 1 * (turns - 1)
    of_row, of_column = (
        (1 - (place[..., None] - torch.arange(count)).abs()).clip(min=0)
        for place, count in ((row, rings), (column, turns))
    )
    return torch.einsum("...r,rt,...t->...", of_row, view.iris, of_column)
