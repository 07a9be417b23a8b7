"""What a sharpening fit makes small: the difference that is seen between an anti-aliased picture and the truth.

The difference is of what the screen is sent, so that equal numbers look about equally bad. Pictures are drawn by the
effect itself, two frames of a scene. By sharpening, its response and the subpixel blend the derivatives are exact.
FXAA's thresholds and the tolerance of history move the picture in jumps, one for each pixel that becomes an edge or
whose history is used, or no longer; what stands for their derivatives are differences over a twentieth of their bounds,
the slope of many such jumps.
"""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jvp, vmap

from diffrender.antialiasing import edge_taa, history
from diffrender.antialiasing.edge_taa import HARD, Decisions
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.images import Frames
from fit.sampled_photo import Views, inner
from fit.search_space import SearchSpace

JUMPING = ("AA_EDGE_THRESHOLD", "AA_EDGE_THRESHOLD_MINIMUM", "AA_HISTORY_TOLERANCE")
STRIDE = 0.025  # of the unit cube to each side, over which jumps make a slope

UNSMOOTHED = Decisions(lambda _, picture: picture, history.accept)  # two frames without FXAA


@dataclass(frozen=True)
class SharpeningObjective:
    """Residuals over some views, in reverse and forward mode."""

    space: SearchSpace
    views: Views

    def residuals(self, point: Float[Tensor, " n"]) -> Float[Tensor, " m"]:
        """Differences from the truth; half their square sum, the loss, is half the mean square error."""
        scene = self.space.scene(point)
        assert scene.antialiasing is not None  # a search space of anti-aliasing has it
        difference = (inner(drawn(scene.antialiasing, self.views)) - inner(self.views.truth)).flatten()
        residuals: Tensor = difference / difference.numel() ** 0.5
        return residuals

    def jacobian(self, point: Float[Tensor, " n"]) -> tuple[Float[Tensor, " m"], Float[Tensor, "m n"]]:
        """Residuals and their derivatives by each coordinate; by those that jump, over a stride."""
        residuals = self.residuals(point)
        slopes = residuals.new_zeros(residuals.numel(), point.numel())
        axes = torch.eye(point.numel()).to(point)
        smooth = [index for index, name in enumerate(self.space.free) if name not in JUMPING]
        if smooth:
            slopes[:, smooth] = vmap(lambda axis: jvp(self.residuals, (point,), (axis,))[1])(axes[smooth]).T
        for index in set(range(point.numel())) - set(smooth):
            ends = [(point + way * STRIDE * axes[index]).clamp(0.0, 1.0) for way in (-1, 1)]
            before, after = (self.residuals(end) for end in ends)
            slopes[:, index] = (after - before) / (ends[1] - ends[0])[index]
        return residuals, slopes


def drawn(settings: AntiAliasing, views: Views, decisions: Decisions = HARD) -> Float[Tensor, "views height width 3"]:
    """Pictures of the second frame of views."""
    motion = views.motion[:, None].expand(*views.frames.shape[:-1], 2)
    return edge_taa.render(settings, Frames(views.frames, motion, None), decisions)[..., -1, :, :, :]
