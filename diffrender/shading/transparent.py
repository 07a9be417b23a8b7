"""Transparent things: panes, bottles, dust and smoke, drawn forward over the deferred picture [1].

A frame is composed in this order:

    1. opaque surfaces write the basic material into the G-buffer, and are lit from it once a pixel;
    2. special materials add forward what the basic one has not, each over its own pixels: skin, eyes, car paint;
    3. hair, which has left only depth and normal in the G-buffer, is shaded forward wholly;
    4. transparent layers go over all of that from far to near, those before the depth that it left.

A layer sends S and lets pass T of what is behind it, each channel for itself, so that glass may have a colour:
picture = S + T picture, the farthest first: Porter and Duff's "over" [2] with alpha 1 - T in each channel. What S and T
are stands in `glass_pane`. Light that is mirrored from one pane to another is left out; of panes that reflect R1 and R2
it is R1 R2 of what is seen through both, 0.6 % of clear ones. Fog between layers is not drawn.

The ladder: tinted by straight panes that mirror nothing, whose order does not matter; layers over each other as they
come; weighted by depth instead of ordered [3], whose T is exact and whose S is a mean of all layers'. That is exact for
one layer. It fails where a layer is nearly opaque or far brighter than its alpha, as glints on clear glass are, whose
share in the mean is their alpha's; it hardly tells which of two near layers is in front; and how much it does depends
on their distance in metres. Moments of depth [4] would have to be kept for every channel of tinted glass, and take more
than sorting so few layers.

Gradient: exact by glass, light and background; none through the order of layers, nor through whether one is before what
is opaque. The picture jumps where two layers pass each other, and where a pane is seen along its edge, from what lights
one side of it to what lights the other. Of layers of equal depth the earlier one is the nearer.

[1] M. Miyamoto, R. Driancourt, "Rendering Techniques of Final Fantasy XV", SIGGRAPH 2016, slide "Shading".
[2] T. Porter, T. Duff, "Compositing Digital Images", SIGGRAPH 1984.
[3] M. McGuire, L. Bavoil, "Weighted Blended Order-Independent Transparency", JCGT 2(2), 2013, equations 6 and 7.
[4] C. Münstermann et al., "Moment-Based Order-Independent Transparency", I3D 2018.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from diffrender.effect import Effect, Rung
from diffrender.shading.glass_pane import Pane, panes
from diffrender.shading.transparent_reference import reference
from diffrender.shading.transparent_view import TINTED_THICKNESS, Transparent, TransparentView, example_inputs


def render(glass: Transparent, view: TransparentView) -> Float[Tensor, "*batch 3"]:
    """Radiance towards the eye [W/(m² sr)] of all layers over their background."""
    return forward(glass, view, view.background)


def forward(glass: Transparent, view: TransparentView, lit: Float[Tensor, "*#batch 3"]) -> Float[Tensor, "*batch 3"]:
    """The same over another picture."""
    found = panes(glass, view)
    near_first = torch.argsort(view.depth, dim=-1, stable=True).expand(found.sent.shape[:-1])[..., None]
    return _over(Pane(*(torch.take_along_dim(one, near_first, -2) for one in (found.sent, found.passed))), lit)


def render_unsorted(glass: Transparent, view: TransparentView) -> Float[Tensor, "*batch 3"]:
    """The same as if the first layers were the nearest, whatever their depth."""
    return _over(panes(glass, view), view.background)


def render_weighted(glass: Transparent, view: TransparentView) -> Float[Tensor, "*batch 3"]:
    """The same without order: the mean of what layers send, weighted by alpha and depth [3].

    Gradient: 0 where no layer takes any light.
    """
    found = panes(glass, view)
    alpha = 1.0 - found.passed
    weight = alpha * _depth_weight(view)[..., None]
    total = (alpha * weight).sum(-2)
    is_clear = total == 0.0
    mean = (found.sent * weight).sum(-2) / torch.where(is_clear, torch.ones_like(total), total)
    passed = _product(found.passed)
    return mean * (1.0 - passed) + passed * view.background


def render_tinted(glass: Transparent, view: TransparentView) -> Float[Tensor, "*batch 3"]:
    """The background through panes as if all faced the eye, nothing mirrored and dust black."""
    is_seen = (view.depth < view.background_depth[..., None])[..., None]
    straight = torch.exp(torch.log(glass.tint) * (glass.thickness / TINTED_THICKNESS)[..., None])
    passed = straight * (1.0 - glass.dust * view.dust)[..., None]
    return _product(torch.where(is_seen, passed, torch.ones_like(passed))) * view.background


def skip(glass: Transparent, view: TransparentView) -> Float[Tensor, "*batch 3"]:
    """The background."""
    return view.background + torch.zeros_like(view.depth[..., :1]) + 0.0 * glass.index.sum()


def _over(found: Pane, lit: Tensor) -> Tensor:
    """Layers, the nearest first, over a picture."""
    picture = lit
    for sent, passed in zip(reversed(found.sent.unbind(-2)), reversed(found.passed.unbind(-2)), strict=True):
        picture = sent + passed * picture
    return picture


def _product(passed: Tensor) -> Tensor:
    """Share that all layers let through; not by prod(), whose gradient looks at values where one is 0."""
    total = torch.ones_like(passed[..., 0, :])
    for one in passed.unbind(-2):
        total = total * one
    return total


def _depth_weight(view: TransparentView) -> Tensor:
    """By equation 7 of [3], for depths from 0.1 to 500 m."""
    is_seen = view.depth < view.background_depth[..., None]
    depth = torch.where(is_seen, view.depth, torch.ones_like(view.depth))
    near, far = (depth / 5.0).square(), (depth / 200.0).square()
    return (10.0 / (1e-5 + near + far * far * far)).clamp(1e-2, 3e3)


def largest_change(glass: Transparent, view: TransparentView) -> Float[Tensor, ""]:
    """Bound on abs(render - skip) over all pixels: what all layers send undimmed, or what they take if that is more."""
    found = panes(glass, view)
    taken = (1.0 - _product(found.passed)) * view.background
    return torch.maximum(found.sent.sum(-2), taken).amax()


EFFECT = Effect(
    parameters=Transparent,
    prefix="TRANSPARENT",
    rungs={
        "skip": Rung(skip),
        "tinted": Rung(render_tinted),
        "unsorted": Rung(render_unsorted),
        "weighted": Rung(render_weighted),
        "sorted": Rung(render),
    },
    reference=reference,
    # A rough pane at a grazing angle, whose facets' Fresnel is not Schlick's.
    tolerance=4e-3,
    largest_change=largest_change,
    example_inputs=example_inputs,
)
