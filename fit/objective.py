"""What a sky fit makes small: the difference of log radiance between photo and model, its gains solved in closed form."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import jvp, vmap

from diffrender.atmosphere import sky
from diffrender.scene import Scene, sky_view
from fit.search_space import SearchSpace

# Differences of log radiance beyond this count less than their square: a cloud's edge or a leaf that the mask let pass.
ROBUST_WIDTH = 1.0
# How much one whole range of a parameter away from its default weighs against the photo: nothing where the photo speaks.
PRIOR_WEIGHT = 1e-3


@dataclass(frozen=True)
class Sample:
    """Pixels of a photo that a fit looks at, each standing for the same solid angle."""

    direction: Float[Tensor, "n 3"]
    log_radiance: Float[Tensor, "n 3"]  # of the photo, its floor added
    floor: float  # radiance added to photo and model before the logarithm


@dataclass(frozen=True)
class SkyObjective:
    """Residuals over a sample of pixels, in reverse and forward mode."""

    space: SearchSpace
    sample: Sample
    geometry: Callable[[Scene], sky.Geometry]  # rays of the tables; the same ones again where sun and eye stay

    def residuals(self, point: Float[Tensor, " n"]) -> Float[Tensor, " m"]:
        """Robust differences of log radiance, then the distance from the defaults; half their square sum is the loss."""
        difference = self.difference(point)
        width = ROBUST_WIDTH
        robust = difference * torch.sqrt(2.0 / (1.0 + torch.sqrt(1.0 + (difference / width).square())))
        return torch.cat([robust.flatten() / difference.numel() ** 0.5, PRIOR_WEIGHT * (point - self._default(point))])

    def jacobian(self, point: Float[Tensor, " n"]) -> tuple[Float[Tensor, " m"], Float[Tensor, "m n"]]:
        """Residuals and their derivatives by each coordinate, in forward mode."""

        def along(tangent: Tensor) -> tuple[Tensor, Tensor]:
            value, slope = jvp(self.residuals, (point,), (tangent,))
            return value, slope

        values, slopes = vmap(along)(torch.eye(point.numel(), dtype=point.dtype))
        return values[0], slopes.T

    def difference(self, point: Float[Tensor, " n"]) -> Float[Tensor, "n 3"]:
        """Log radiance of the model less that of the photo, each channel's mean taken away: its log gain."""
        model = self.radiance(point)
        # The floor belongs to the photo's scale; its gain need not be exact, so no derivative passes through it.
        plain = self.sample.log_radiance - torch.log(model.detach())
        floor = self.sample.floor * torch.exp(-plain.mean(-2))
        difference = torch.log(model + floor) - self.sample.log_radiance
        return difference - difference.mean(-2)

    def radiance(self, point: Float[Tensor, " n"]) -> Float[Tensor, "n 3"]:
        """Model's radiance under a sun of irradiance 1."""
        scene = self.space.scene(point)
        assert scene.sky is not None  # a search space of the sky has one
        view = sky_view(scene, self.sample.direction)
        return sky.render_tables(scene.sky, sky.TabledView(view, sky.tables(scene.sky, self.geometry(scene))))

    def _default(self, point: Tensor) -> Tensor:
        return torch.from_numpy(self.space.point(self.space.start)).to(point)
