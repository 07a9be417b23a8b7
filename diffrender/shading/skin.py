"""Skin, whose diffuse light is blurred on the screen between a deferred and a forward pass [1].

The talk names the passes, two targets, the blur and the combination, and no formula. Ours are of the field: the light
that enters leaves around by Burley's normalised diffusion, which `diffusion` has, for each channel its own; and the
blur gathers it from the picture [2]. Around every pixel lies a disc of taps in the plane of its surface, each standing
for the same share of the profile. What lies off that plane, as over an edge of depth or on a curved surface, is farther
than planned and counts for less; what is no skin counts for nothing. Between pixels the picture is bilinear. The plane,
the taps of every channel and the distance off the plane are ours.

What is left of a pixel's light is divided by the sum of what counts: a picture does not know the light beyond its
border, the mask or the horizon, and takes it for that of the skin that is seen. So even light stays as it is
everywhere, and no pixel is brighter than the brightest; light is kept in the middle of large patches, but not
near borders. Thin parts, such as ears, do not shine through.

Taps are as many for every width. Much below a pixel they all fall on it, and the picture becomes the unblurred one
with a finite slope; far above the picture's size most fall beside it, and the blur is too weak.

The separable renderer blurs along rows and then along columns, each by the profile summed over lines [3].

Gradient: exact, but where a tap crosses a pixel's centre, where it is that of one side; 0 of the texture where it is
black, whose root would have none.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Tricks for special
    materials".
[2] E. Golubev, "Efficient Screen-Space Subsurface Scattering Using Burley's Normalized Diffusion in Real-Time",
    SIGGRAPH 2018 course "Advances in Real-Time Rendering in Games".
[3] J. Jimenez et al., "Separable Subsurface Scattering", Computer Graphics Forum 34(6), 2015: "pre-integrated" kernel.
"""

from dataclasses import replace
from functools import partial

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.parameters import record
from diffrender.shading import diffusion
from diffrender.shading.skin_passes import deferred, forward, leaving
from diffrender.shading.skin_reference import reference
from diffrender.shading.skin_view import Skin, SkinView, example_inputs, steps

TAPS, FEW_TAPS, LINE_TAPS = 64, 16, 13
_TOGETHER = 16  # taps at once: memory of so many pictures


@record
class Patch:
    """Light on a surface, as a blur gathers it.

    Attributes:
        weight: area of skin that a pixel shows [m²].
        light: of each channel, times the weight.
        across, down: steps on the surface from pixel to pixel [m].
        shape: turns places in its plane [m] to pixels.
        width: of the profile of each channel [m].
    """

    weight: Float[Tensor, "*batch height width"]
    light: Float[Tensor, "*batch height width 3"]
    position: Float[Tensor, "*batch height width 3"]
    across: Float[Tensor, "*batch height width 3"]
    down: Float[Tensor, "*batch height width 3"]
    shape: Float[Tensor, "*batch height width 2 2"]
    width: Float[Tensor, "3"]


def render(skin: Skin, view: SkinView) -> Float[Tensor, "*batch height width 3"]:
    """Radiance of skin towards the eye [W/(m² sr)], black where there is none."""
    return render_disc(skin, view, TAPS)


def render_disc(skin: Skin, view: SkinView, taps: int) -> Float[Tensor, "*batch height width 3"]:
    """The same with so many taps a channel."""
    targets = deferred(skin, view)
    return forward(skin, view, replace(targets, diffuse=blurred(skin, view, targets.diffuse, taps)))


def render_separable(skin: Skin, view: SkinView) -> Float[Tensor, "*batch height width 3"]:
    """The same by two blurs along the picture's axes."""
    targets = deferred(skin, view)
    return forward(skin, view, replace(targets, diffuse=blurred_separably(skin, view, targets.diffuse)))


def skip(skin: Skin, view: SkinView) -> Float[Tensor, "*batch height width 3"]:
    """Both targets as they are: all light leaves where it entered."""
    return forward(skin, view, deferred(skin, view)) + 0.0 * skin.mean_free_path


def blurred(
    skin: Skin, view: SkinView, diffuse: Float[Tensor, "*batch height width 3"], taps: int = TAPS
) -> Float[Tensor, "*batch height width 3"]:
    """Diffuse target after its light has wandered through the skin; of no meaning where there is none."""
    patch = _patch(skin, view, diffuse)
    weight, light = patch.weight[..., None], patch.light
    for places in torch.split(diffusion.disc(taps).to(diffuse)[1:], _TOGETHER):
        on_screen = (patch.shape[..., None, :, :] @ places[..., None])[..., 0]
        more_weight, more_light = _gathered(patch, on_screen, torch.linalg.vector_norm(places, dim=-1))
        weight, light = weight + more_weight, light + more_light
    return _mean(weight, light)


def blurred_separably(
    skin: Skin, view: SkinView, diffuse: Float[Tensor, "*batch height width 3"]
) -> Float[Tensor, "*batch height width 3"]:
    """The same along rows and then along columns, as if both were at right angles on the surface too."""
    places = diffusion.line(LINE_TAPS).to(diffuse)
    places = torch.cat([places[: LINE_TAPS // 2], places[LINE_TAPS // 2 + 1 :]])  # all but the middle
    for axis in range(2):
        patch = _patch(skin, view, diffuse)
        step = (patch.across, patch.down)[axis]
        length = torch.linalg.vector_norm(step, dim=-1)
        length = torch.where(length == 0.0, torch.ones_like(length), length)
        along = places / length[..., None]
        beside = torch.zeros_like(along)
        on_screen = torch.stack([(along, beside)[axis], (beside, along)[axis]], -1)
        weight, light = _gathered(patch, on_screen, places.abs())
        diffuse = _mean(patch.weight[..., None] + weight, patch.light + light)
    return diffuse


def _patch(skin: Skin, view: SkinView, diffuse: Tensor) -> Patch:
    position = view.position.expand(diffuse.shape)
    across, down = steps(position)
    shape, area = diffusion.inverse_root(across, down)
    weight = view.mask * area
    width = diffusion.width(skin.colour, skin.mean_free_path)
    return Patch(weight, diffuse * weight[..., None], position, across, down, shape, width)


def _mean(weight: Tensor, light: Tensor) -> Tensor:
    is_none = weight == 0.0
    return torch.where(is_none, torch.zeros_like(light), light / torch.where(is_none, torch.ones_like(weight), weight))


def _gathered(
    patch: Patch, places: Float[Tensor, "*batch height width taps 2"], planned: Float[Tensor, " taps"]
) -> tuple[Float[Tensor, "*batch height width 3"], Float[Tensor, "*batch height width 3"]]:
    """Weight and light that taps find, by their places in widths over metres, x and y, and planned distances."""
    column, row = (places[..., None, :] * patch.width[:, None]).unbind(-1)
    left, top = column.detach().floor(), row.detach().floor()
    pixels = torch.cat([patch.weight[..., None], patch.light, patch.position], -1)
    carried, off_plane = torch.zeros_like(column)[..., None], torch.zeros_like(column)[..., None]
    for x, beside in ((left, left + 1.0 - column), (left + 1.0, column - left)):
        for y, above in ((top, top + 1.0 - row), (top + 1.0, row - top)):
            found, is_inside = _pixels_at(pixels, x, y)
            share = torch.where(is_inside, beside * above, torch.zeros_like(above))[..., None]
            carried = carried + share * found[..., :4]
            off_plane = off_plane + share * (found[..., 4:] - _on_plane(patch, x, y))
    beyond = (off_plane / patch.width[:, None]).square().sum(-1)
    counts = diffusion.reach(torch.sqrt(planned[:, None].square() + beyond), planned[:, None])
    light = torch.diagonal(carried[..., 1:], dim1=-2, dim2=-1)
    return (counts * carried[..., 0]).sum(-2), (counts * light).sum(-2)


def _pixels_at(pixels: Tensor, x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Pixels of a picture so many columns and rows away, for each tap and channel, and whether they lie in it.

    Outside, those at its border.
    """
    height, width = pixels.shape[-3:-1]
    column = x.long() + torch.arange(width, device=x.device)[:, None, None]
    row = y.long() + torch.arange(height, device=x.device)[:, None, None, None]
    is_inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    index = row.clamp(0, height - 1) * width + column.clamp(0, width - 1)
    wanted = index.flatten(-4)[..., None]
    found = torch.gather(pixels.flatten(-3, -2), -2, wanted.expand(*wanted.shape[:-1], pixels.shape[-1]))
    return found.reshape(*index.shape, -1), is_inside


def _on_plane(patch: Patch, x: Tensor, y: Tensor) -> Tensor:
    """Position so many columns and rows away if the surface were flat [m]."""
    here, across, down = (one[..., None, None, :] for one in (patch.position, patch.across, patch.down))
    return here + across * x[..., None] + down * y[..., None]


def largest_change(skin: Skin, view: SkinView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all pixels [W/(m² sr)]: the brightest light inside less the darkest."""
    light, is_skin = deferred(skin, view).diffuse, (view.mask > 0.0)[..., None]
    every = tuple(range(light.ndim - 1))
    high = torch.where(is_skin, light, light.amin()).amax(every)
    low = torch.where(is_skin, light, light.amax()).amin(every)
    return (view.mask[..., None] * leaving(skin, view) * torch.relu(high - low)).amax()


EFFECT = Effect(
    parameters=Skin,
    prefix="SKIN",
    rungs={
        "skip": Rung(skip),
        "few taps": Rung(partial(render_disc, taps=FEW_TAPS)),
        "separable": Rung(render_separable),
        "disc": Rung(render),
    },
    reference=reference,
    # Light between taps beside the sharp edge of a shadow, and at the edge of a ball of seven pixels.
    tolerance=0.05,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
