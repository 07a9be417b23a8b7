"""A photo of fog, with what is known beside it: distances, the same view without fog, the sky behind."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from diffrender.atmosphere import sky
from diffrender.atmosphere.height_fog import HeightFog
from diffrender.parameters import specifications
from diffrender.rays import Rays, pixel_centres
from diffrender.scene import Scene, sky_view, skylight
from fit import asked, distance, sky_mask, sun
from fit import photo as photos
from fit.exr import bands
from fit.fog_objective import FogObjective, FogPixels
from fit.input_error import InputError
from fit.photo import Photo
from fit.pixels import usable
from fit.search_space import SearchSpace

LEAST_PIXELS = 100
LOWEST_EYE, HIGHEST_EYE = -1e4, 1e5  # altitudes of cameras [m]
SMOOTHED = 2  # pixels to each side of one, whose mean tells how bright the photo is there
FLOOR = 1e-2  # of the median radiance, which differences are relative to at least
BAND_TOP = float(np.sin(np.radians(20.0)))  # of the sky that is looked at where no distances are known


@dataclass(frozen=True)
class Options(asked.Options):
    """What may be asked of a fog fit beside what may be asked of every fit.

    Attributes:
        distance: OpenEXR file, or `distance.LEVEL`; None takes the photo's own channel Z, if it has one.
        distance_kind: "euclidean", along rays, or "depth", along the camera's axis.
        clear: the same view without fog; None where it is not known.
        eye_height: of the camera above the altitude 0 that base heights count from [m].
    """

    distance: Path | None = None
    distance_kind: str = "euclidean"
    clear: Path | None = None
    eye_height: float = 2.0

    def __post_init__(self) -> None:
        """Refuse an altitude that no camera has.

        Raises:
            InputError: when it is out of range, or a name is both held and searched.
        """
        super().__post_init__()
        if not LOWEST_EYE <= self.eye_height <= HIGHEST_EYE:
            raise InputError(
                f"--eye-height {self.eye_height:g}; give metres above the fog's altitude 0, from {LOWEST_EYE:,.0f} to "
                f"{HIGHEST_EYE:,.0f}"
            )


@dataclass(frozen=True, eq=False)
class FoggyPhoto:
    """What a fog fit knows of a photo.

    Attributes:
        distance: from the eye [m], infinite for the sky; None where it is not known.
        clear: radiance without fog; None where it is not known.
        used: pixels that the fit may look at.
        eye_height: altitude of the camera [m].
        home: scene whose sky, if it has one, stands behind the fog.
    """

    photo: Photo
    distance: Float[np.ndarray, "height width"] | None
    clear: Float[np.ndarray, "height width 3"] | None
    used: Bool[np.ndarray, "height width"]
    eye_height: float
    home: Scene
    notes: tuple[str, ...]

    @property
    def known(self) -> Bool[np.ndarray, "height width"]:
        """Pixels that can be drawn: all that are used and, where distances are known, all that have one."""
        return self.used if self.distance is None else ~np.isnan(self.distance)

    def objective(self, space: SearchSpace, count: int, seed: int) -> FogObjective:
        """Objective over a sample of pixels."""
        return FogObjective(space, *self.sample(count, seed), self._greatest_lights)

    def sample(self, count: int, seed: int) -> tuple[FogPixels, Float[Tensor, "n 3"]]:
        """Pixels drawn from as many stretches of the used ones, row by row, and what differences are relative to."""
        line, column = np.nonzero(self.used)
        stretches = np.linspace(0.0, len(line), min(count, len(line)), endpoint=False)
        drawn = np.random.default_rng(seed).random(len(stretches)) * (len(line) / len(stretches))
        chosen = np.minimum((stretches + drawn).astype(int), len(line) - 1)
        line, column = line[chosen], column[chosen]
        return self.at(line, column), self._smoothed(line, column)

    @cached_property
    def _greatest_lights(self) -> Float[Tensor, "2 3"] | None:
        """Of sun and sky, what the fog's tints can make of those of a known sky, with room for its own error."""
        if self.home.sky is None:
            return None
        fog, given = self.home.height_fog, self.home.exposure.exposure * self.home.sun.irradiance
        assert fog is not None  # a fog fit's scene has one
        tint = 0.5 * specifications(HeightFog)["sun_tint"].bounds[1]
        return tint * fog.albedo * torch.stack([given, skylight(self.home)])

    def at(self, line: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]) -> FogPixels:
        """What is known of some pixels."""
        place = torch.from_numpy(column + 0.5), torch.from_numpy(line + 0.5)
        direction = self.photo.camera.direction(*place)
        length = torch.full(line.shape, torch.inf, dtype=torch.float64)
        if self.distance is not None:
            length = torch.from_numpy(self.distance[line, column]).double()
        origin = torch.tensor([0.0, 0.0, self.eye_height], dtype=torch.float64).expand(line.size, 3)
        return FogPixels(
            rays=Rays(origin, direction, length),
            radiance=torch.from_numpy(self.photo.radiance[line, column]).double(),
            clear=None if self.clear is None else torch.from_numpy(self.clear[line, column]).double(),
            behind=self._behind(direction, length.isinf()),
        )

    def _behind(self, direction: Float[Tensor, "n 3"], is_sky: Bool[Tensor, " n"]) -> Float[Tensor, "n 3"]:
        """Radiance of the sky behind the fog up to a factor, even if no sky is known; 0 for surfaces."""
        if self.home.sky is None:
            return is_sky[:, None].double().expand(-1, 3)
        seen = sky.TabledView(sky_view(self.home, direction), self._sky_tables)
        return sky.render_tables(self.home.sky, seen) * is_sky[:, None]

    @cached_property
    def _sky_tables(self) -> sky.SkyTables:
        """Tables of the sky at home, which every band of pixels looks up."""
        assert self.home.sky is not None  # asked for only where there is one
        return sky.prepare(self.home.sky, sky_view(self.home, torch.zeros(1, 3, dtype=torch.float64))).tables

    def _smoothed(self, line: Int[np.ndarray, " n"], column: Int[np.ndarray, " n"]) -> Float[Tensor, "n 3"]:
        """Mean radiance of the used pixels round some, with a floor: what differences are relative to."""
        away = np.arange(-SMOOTHED, SMOOTHED + 1)
        height, width = self.used.shape
        lines = np.clip(line[:, None, None] + away[:, None], 0, height - 1)
        columns = np.clip(column[:, None, None] + away, 0, width - 1)
        weight = self.used[lines, columns][..., None].astype(np.float64)
        around = np.where(weight > 0.0, self.photo.radiance[lines, columns].astype(np.float64), 0.0)
        mean = torch.from_numpy(around.sum((1, 2)) / weight.sum((1, 2)))
        median = mean.median(0).values
        if not (median > 0.0).all():
            raise InputError(f"{self.photo.path} is black where it is used; give an exposed photo or another --mask")
        return mean + FLOOR * median


def seen(photo: Photo, options: Options, home: Scene) -> FoggyPhoto:
    """A photo with its distances, what is known of it without fog, and which pixels are used.

    Raises:
        InputError: when a file beside the photo cannot be used, or too few pixels can.
    """
    far = distance.of(photo, options.distance, options.distance_kind, options.eye_height)
    clear = None if options.clear is None else _clear(photo, options.clear)
    mask = np.ones((photo.camera.height, photo.camera.width), bool)
    notes = []
    if options.distance == distance.LEVEL:
        notes.append("distances are those of level ground at altitude 0: whatever rises from it is nearer")
    if options.mask is not None:
        painted = sky_mask.read(options.mask, photo)
        mask, notes = painted.used, [painted.how]
    if far is None:
        mask = mask & _horizon_band(photo)
        if options.mask is None:
            mask = mask & sky_mask.find(photo, sun.find(photo)).used
        notes.append("no distances: only the lowest 20 degrees of the sky are used; give --distance for more")
    else:
        mask = mask & ~np.isnan(far)
    if clear is not None:
        mask = mask & np.isfinite(clear).all(-1)
        notes.append("the picture without fog is given")
    used = usable(photo, mask)
    count = int(used.sum())
    if count < LEAST_PIXELS:
        raise InputError(f"only {count} usable pixels are left, of at least {LEAST_PIXELS}; give another --mask")
    return FoggyPhoto(photo, far, clear, used, options.eye_height, home, tuple(notes))


def _clear(photo: Photo, path: Path) -> Float[np.ndarray, "height width 3"]:
    clear: Float[np.ndarray, "height width 3"] = np.asarray(photos.read_picture(path).radiance)
    if clear.shape != photo.radiance.shape:
        size = f"{photo.camera.width} x {photo.camera.height}"
        raise InputError(f"{path} is {clear.shape[1]} x {clear.shape[0]}, but the photo is {size}; give the same view")
    return clear


def _horizon_band(photo: Photo) -> Bool[np.ndarray, "height width"]:
    """Pixels from the horizon up to 20 degrees."""
    band = np.zeros((photo.camera.height, photo.camera.width), bool)
    for rows in bands(photo.camera.height):
        up = photo.camera.direction(*pixel_centres(photo.camera, rows, torch.zeros(())))[..., 2].numpy()
        band[rows] = (up > 0.0) & (up < BAND_TOP)
    return band
