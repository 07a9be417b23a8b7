"""What a sky fit makes small: differences of log radiance between photo and model, gains solved in closed form."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import vmap
from torch.utils._pytree import tree_map  # torch has no public name for it

from diffrender.atmosphere import sky
from diffrender.scene import Scene, sky_view
from fit import priors
from fit.search_space import SearchSpace

# Differences of log radiance beyond this count less than their square: leaves and cloud edges that a mask let pass.
ROBUST_WIDTH = 1.0
# Weight of one standard deviation of a parameter from its prior's centre: nothing where the photo speaks. At three
# times this weight the errors of fits to eleven photos grew by 1 %.
PRIOR_WEIGHT = 1e-3
STEP = 1e-6  # of the differences that stand for derivatives
# Names of what is applied when the tables are looked up.
AFTER_TABLES = ("SKY_HAZINESS", "SKY_COARSE_HAZINESS", "SKY_OVERCAST")


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
        """Robust differences of log radiance, then distances from the priors; half their square sum is the loss."""
        return self._residuals(point, self._tables(point))

    def jacobian(self, point: Float[Tensor, " n"]) -> tuple[Float[Tensor, " m"], Float[Tensor, "m n"]]:
        """Residuals and their derivatives by each coordinate, from differences of a millionth of the bounds.

        Parameters that do not enter the tables share them, which makes differences several times as fast as
        vmap(jvp) of the residuals; the two agree to 1e-3, the slope of the floor's own gain.
        """
        step = torch.where(point < 0.5, STEP, -STEP)
        points = torch.cat([point[None], point + torch.diag(step)])
        enters = [True, *(not name.startswith(AFTER_TABLES) for name in self.space.free)]
        made = vmap(self._tables)(points[torch.tensor(enters)])
        # Where a parameter does not enter, its tables are those of the point itself, the first.
        which = torch.tensor([sum(enters[:i]) if enter else 0 for i, enter in enumerate(enters)])
        values = vmap(self._residuals)(points, tree_map(lambda table: table[which], made))
        return values[0], ((values[1:] - values[0]) / step[:, None]).T

    def changes(self, point: Float[Tensor, " n"], held: Sequence[str]) -> Float[Tensor, "h m"]:
        """Change of the pixels' residuals when names that are not searched take the ends of their priors.

        One row for each name's centre less its deviation, as far as bounds allow, one for its centre plus that.
        """
        whole = SearchSpace(self.space.scene(point), (*self.space.free, *held))
        prior = priors.in_unit_cube(held)
        points = torch.from_numpy(whole.point(whole.start)).repeat(2 * len(held) + 1, 1)
        for index, (centre, spread) in enumerate(zip(prior.centre, prior.spread, strict=True)):
            for row, end in ((2 * index + 1, centre - spread), (2 * index + 2, centre + spread)):
                points[row, len(self.space.free) + index] = min(max(end, 0.0), 1.0)
        values = vmap(replace(self, space=whole).residuals)(points)[:, : self.sample.log_radiance.numel()]
        return values[1:] - values[0]

    def radiance(self, point: Float[Tensor, " n"]) -> Float[Tensor, "n 3"]:
        """Model's radiance under a sun of irradiance 1."""
        return self._radiance(point, self._tables(point))

    def _tables(self, point: Tensor) -> sky.SkyTables:
        scene = self.space.scene(point)
        assert scene.sky is not None  # a search space of the sky has one
        return sky.tables(scene.sky, self.geometry(scene))

    def _radiance(self, point: Tensor, tables: sky.SkyTables) -> Tensor:
        scene = self.space.scene(point)
        assert scene.sky is not None
        return sky.render_tables(scene.sky, sky.TabledView(sky_view(scene, self.sample.direction), tables))

    def _residuals(self, point: Tensor, tables: sky.SkyTables) -> Tensor:
        model = self._radiance(point, tables)
        # The floor belongs to the photo's scale; its gain need not be exact, so no derivative passes through it.
        plain = self.sample.log_radiance - torch.log(model.detach())
        floor = self.sample.floor * torch.exp(-plain.mean(-2))
        difference = torch.log(model + floor) - self.sample.log_radiance
        # The mean is each channel's log gain, in closed form.
        difference = difference - difference.mean(-2)
        robust = difference * torch.sqrt(2.0 / (1.0 + torch.sqrt(1.0 + (difference / ROBUST_WIDTH).square())))
        prior = priors.in_unit_cube(self.space.free)
        away = (point - torch.from_numpy(prior.centre).to(point)) / torch.from_numpy(prior.spread).to(point)
        return torch.cat([robust.flatten() / difference.numel() ** 0.5, PRIOR_WEIGHT * away])
