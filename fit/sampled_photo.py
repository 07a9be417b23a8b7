"""A photo as the scene of a game: sampled at the jittered places of two frames, and its mean over pixels as the truth.

The photo is exposed to Reinhard's key [1] and taken as a screen is sent it, tone-mapped and encoded, before anything is
sampled: that is where a game anti-aliases, and where its filters are linear. It is a whole number of times as fine as
the pictures drawn of it. Pictures lie half of its pixels off its corner, so that the places of samples are middles of
its pixels: a sample of footprint 0 is one of them, unchanged.

What a footprint does is what mip maps do to textures: a sample is the mean over a square that wide. Edges of geometry
have none; where textures are told apart from them, their samples are mixed.

A scene may move between the two frames: the photo by whole pixels of its own, so that samples still meet their middles,
behind a disc at rest in the middle of each tile, which covers some of it and uncovers other parts.

[1] E. Reinhard et al., "Photographic Tone Reproduction for Digital Images", SIGGRAPH 2002, equations 1 to 3.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from diffrender.antialiasing import edge_taa
from diffrender.antialiasing.display import shown_pq, shown_srgb
from diffrender.colour import luminance
from diffrender.images import sampled
from diffrender.rays import Equirectangular, pixel_centres
from fit.exr import bands
from fit.input_error import InputError
from fit.photo import Photo

KEY = 0.18  # of the geometric mean of luminance, over the screen's middle [1]
SCREENS: Mapping[str, Callable[[Tensor], Tensor]] = {"srgb": shown_srgb, "pq": shown_pq}
LEAST_FACTOR, LARGEST_FACTOR = 4, 16
STRETCHED = math.radians(60.0)  # elevation beyond which panoramas are stretched too far to show a scene
TILE, MARGIN = 40, 4  # side of a tile and the part of it at each border that is not judged [pixels]
FASTEST = 8.0  # motion from one frame to the next that still shows both frames the same scene [pixels]
DISC = 9.0  # radius [pixels]
LEAST_DETAIL = 1e-7  # mean square difference of a tile from its pixels' means that is more than rounding


@dataclass(frozen=True)
class Sampling:
    """How a photo is sampled.

    Attributes:
        factor: how many times as fine as the pictures it is; even, so that samples meet middles of its pixels.
        footprint: side of the square that a sample is the mean of [pixels], 0 to 1.
        screen: name of one of SCREENS.
        motion: of the scene from one frame to the next, to the right and down [pixels], whole pixels of the photo.
    """

    factor: int = 4
    footprint: float = 1.0
    screen: str = "srgb"
    motion: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse what cannot be sampled.

        Raises:
            InputError: when a value is out of range.
        """
        if not (LEAST_FACTOR <= self.factor <= LARGEST_FACTOR and self.factor % 2 == 0):
            raise InputError(
                f"--factor {self.factor}; give an even number from {LEAST_FACTOR} to {LARGEST_FACTOR}: by how much the "
                "photo is finer than the pictures"
            )
        if not 0.0 <= self.footprint <= 1.0:
            raise InputError(f"--footprint {self.footprint:g}; give pixels from 0 (points) to 1 (mip-mapped textures)")
        if self.screen not in SCREENS:
            raise InputError(f"--screen {self.screen} is unknown; allowed are {' and '.join(SCREENS)}")
        # Six digits of a third or a sixth of a pixel are meant to be it.
        if not all(
            abs(way) <= FASTEST and abs(way * self.factor - round(way * self.factor)) < 1e-3 for way in self.motion
        ):
            across, down = self.motion
            raise InputError(
                f"--motion {across},{down}; give pixels to the right and down, whole pixels of the photo "
                f"(multiples of 1/{self.factor}), up to {FASTEST:g}"
            )

    @property
    def is_at_rest(self) -> bool:
        """Whether both frames show the same."""
        return self.motion == (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Views:
    """Pictures to draw: their even and odd frames, sampled between the pixels, and what is true of them."""

    frames: Float[Tensor, "views 2 height width 3"]
    truth: Float[Tensor, "views height width 3"]
    centres: Float[Tensor, "views height width 3"]  # one sample in each pixel's centre, what FXAA alone is given
    motion: Float[Tensor, "views height width 2"]  # from each pixel to where its surface was one frame ago [pixels]

    def first(self, count: int) -> "Views":
        """At most a count of them."""
        return Views(self.frames[:count], self.truth[:count], self.centres[:count], self.motion[:count])


@dataclass(frozen=True, eq=False)
class Scenery:
    """A photo with what it takes to sample it.

    Attributes:
        is_texture: where samples have the footprint; elsewhere they are points.
        exposure: what its radiance is multiplied by before it is shown.
    """

    photo: Photo
    sampling: Sampling
    is_texture: Bool[np.ndarray, "height width"] | None
    exposure: float

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of a picture of all of it."""
        factor = self.sampling.factor
        return self.photo.camera.height // factor, self.photo.camera.width // factor

    def views(self, corners: Sequence[tuple[int, int]], shape: tuple[int, int], dtype: torch.dtype) -> Views:
        """Pictures of a shape whose first pixels are the given rows and columns of the picture of all of it."""
        return self._views(corners, shape, torch.zeros(1, 1, 1, dtype=dtype))

    def tiles(self, corners: Sequence[tuple[int, int]], dtype: torch.dtype) -> Views:
        """Tiles that a fit looks at; with the disc, where the scene moves."""
        if self.sampling.is_at_rest:
            return self.views(corners, (TILE, TILE), dtype)
        middles = (torch.arange(TILE * self.sampling.factor, dtype=dtype) + 0.5) / self.sampling.factor - TILE / 2
        disc = (torch.hypot(middles[:, None], middles) <= DISC).to(dtype)
        return self._views(corners, (TILE, TILE), disc[..., None])

    def _views(self, corners: Sequence[tuple[int, int]], shape: tuple[int, int], disc: Tensor) -> Views:
        """Pictures behind a disc, 1 where it is and 0 elsewhere, that shows them mirrored."""
        right, down = self.sampling.motion
        odd = self._fine(corners, shape, (0.0, 0.0), disc)
        even = odd if self.sampling.is_at_rest else self._fine(corners, shape, (right, down), disc)
        mirrored = odd[0].flip(-2)
        frames = [
            self._sampled(torch.lerp(fine, mirrored, disc), texture, offset)
            for (fine, texture), offset in zip((even, odd), edge_taa.OFFSETS, strict=True)
        ]
        now = torch.lerp(odd[0], mirrored, disc)
        centres = self._sampled(now, odd[1], (0.0, 0.0))
        behind = 1.0 - self._at(disc.expand(*now.shape[1:3], 1), (0.0, 0.0), 0.0)
        motion = (behind * behind.new_tensor([-right, -down])).expand(*centres.shape[:-1], 2)
        return Views(torch.stack(frames, 1), self._at(now, (0.0, 0.0), 1.0), centres, motion)

    def _fine(
        self, corners: Sequence[tuple[int, int]], shape: tuple[int, int], ahead: tuple[float, float], like: Tensor
    ) -> tuple[Tensor, Tensor | None]:
        """Photo so many pixels to the right and below of pictures, and which of it is textures."""
        fine = torch.stack([self.shown(corner, shape, like.dtype, ahead) for corner in corners])
        if self.is_texture is None:
            return fine, None
        share = [self.is_texture[self._window(corner, shape, ahead)] for corner in corners]
        return fine, torch.from_numpy(np.stack(share)).to(like)[..., None]

    def shown(
        self,
        corner: tuple[int, int],
        shape: tuple[int, int],
        dtype: torch.dtype,
        ahead: tuple[float, float] = (0.0, 0.0),
    ) -> Float[Tensor, "h w 3"]:
        """The photo's pixels in a picture, or so many pixels ahead, as a screen is sent them.

        What is not finite is black; beyond the photo's borders its last pixels are repeated.
        """
        radiance = torch.from_numpy(self.photo.radiance[self._window(corner, shape, ahead)].astype(np.float32)).to(
            dtype
        )
        exposed = self.exposure * torch.nan_to_num(radiance, nan=0.0, posinf=0.0, neginf=0.0)
        return SCREENS[self.sampling.screen](exposed)

    def _window(
        self, corner: tuple[int, int], shape: tuple[int, int], ahead: tuple[float, float]
    ) -> tuple[np.ndarray, ...]:
        factor = self.sampling.factor
        rows, columns = (
            np.arange(round((start + way) * factor), round((start + way + size) * factor)).clip(0, whole - 1)
            for start, size, way, whole in zip(corner, shape, ahead[::-1], self.photo.radiance.shape, strict=False)
        )
        return np.ix_(rows, columns)

    def _sampled(self, fine: Tensor, texture: Tensor | None, offset: tuple[float, float]) -> Tensor:
        wide = self._at(fine, offset, self.sampling.footprint)
        if texture is None:
            return wide
        return torch.lerp(self._at(fine, offset, 0.0), wide, self._at(texture, offset, 0.0))

    def _at(self, fine: Tensor, offset: tuple[float, float], footprint: float) -> Tensor:
        half = 0.5 / self.sampling.factor
        return sampled(fine, self.sampling.factor, (offset[0] + half, offset[1] + half), footprint)


def scenery(photo: Photo, sampling: Sampling, is_texture: Bool[np.ndarray, "height width"] | None) -> Scenery:
    """A photo, exposed so that the geometric mean of its luminance is at the key.

    Raises:
        InputError: when it is black.
    """
    total, count = 0.0, 0
    for rows in bands(len(photo.radiance)):
        seen = luminance(photo.band(rows).double())
        lit = seen[seen.isfinite() & (seen > 0.0)]
        total, count = total + float(lit.log().sum()), count + lit.numel()
    if not count:
        raise InputError(f"{photo.path} is black everywhere; give an exposed photo")
    return Scenery(photo, sampling, is_texture, KEY / math.exp(total / count))


def tiles(scene: Scenery, count: int) -> list[tuple[int, int]]:
    """Row and column of the first pixels of the tiles with most detail, at most a count of them.

    Tiles show finite pixels only, and of a panorama its middle, where it is little stretched. The parts of them that
    are judged do not overlap.

    Raises:
        InputError: when the photo is too small for one tile, or none has detail.
    """
    corners = _corners(scene)
    if not corners:
        raise InputError(
            f"{scene.photo.path} has no part of {TILE * scene.sampling.factor} x {TILE * scene.sampling.factor} whole "
            "pixels where it is not stretched; give a larger photo or a smaller --factor"
        )
    amount = {corner: detail(scene, corner) for corner in corners}
    found = sorted(corners, key=lambda corner: (-amount[corner], corner))
    chosen = [corner for corner in found[:count] if amount[corner] > LEAST_DETAIL]
    if not chosen:
        raise InputError(f"{scene.photo.path} is smooth everywhere: nothing can be sharpened; give a photo with detail")
    return chosen


def inner(picture: Float[Tensor, "*batch height width 3"]) -> Float[Tensor, "*batch h w 3"]:
    """The part of tiles that is judged."""
    return picture[..., MARGIN:-MARGIN, MARGIN:-MARGIN, :]


def pixels(scene: Scenery, corners: Sequence[tuple[int, int]]) -> Bool[np.ndarray, "height width"]:
    """Pixels of the photo in the judged parts of tiles."""
    factor = scene.sampling.factor
    used = np.zeros(scene.photo.radiance.shape[:2], bool)
    for corner in corners:
        top, left = ((first + MARGIN) * factor for first in corner)
        side = (TILE - 2 * MARGIN) * factor
        used[top : top + side, left : left + side] = True
    return used


def _corners(scene: Scenery) -> list[tuple[int, int]]:
    """First pixels of all tiles that can be used."""
    factor = scene.sampling.factor
    camera = scene.photo.camera
    first, last = 0, camera.height
    if isinstance(camera, Equirectangular):
        per_radian = camera.height / (math.pi / 2 - camera.lowest)
        first, last = (
            math.ceil(min(max((math.pi / 2 - up) * per_radian, 0.0), camera.height)) for up in (STRETCHED, -STRETCHED)
        )
    rows = _starts(math.ceil(first / factor), last // factor)
    columns = _starts(0, camera.width // factor)
    found = []
    for top in rows:
        is_whole = _is_whole(scene.photo, slice(top * factor, (top + TILE) * factor))
        found += [(top, left) for left in columns if is_whole[:, left * factor : (left + TILE) * factor].all()]
    inside = [corner for corner in found if _was_in_photo(scene, corner)]
    if found and not inside:
        across, down = scene.sampling.motion
        raise InputError(
            f"{scene.photo.path} does not show what its tiles showed a frame ago at --motion {across:g},{down:g}; give "
            "a larger photo or a smaller --motion"
        )
    return inside


def _was_in_photo(scene: Scenery, corner: tuple[int, int]) -> bool:
    """Whether the photo also has what a tile showed one frame ago."""
    firsts = [start + way for start, way in zip(corner, scene.sampling.motion[::-1], strict=True)]
    return all(0.0 <= first <= size - TILE for first, size in zip(firsts, scene.size, strict=True))


def _starts(first: int, last: int) -> list[int]:
    """Where tiles start between two ends, in whole steps of what is judged of them, as many left over on both sides."""
    step = TILE - 2 * MARGIN
    count = (last - first - 2 * MARGIN) // step
    begin = first + (last - first - 2 * MARGIN - count * step) // 2
    return [begin + step * index for index in range(count)]


def _is_whole(photo: Photo, rows: slice) -> Bool[np.ndarray, "rows width"]:
    """Pixels that show something finite; negative ones, which lossy files have, count as black."""
    band = photo.band(rows)
    shown = photo.camera.solid_angle(*pixel_centres(photo.camera, rows, band)) > 0.0
    whole: Bool[np.ndarray, "rows width"] = (shown & torch.isfinite(band).all(-1)).numpy()
    return whole


def detail(scene: Scenery, corner: tuple[int, int]) -> float:
    """Mean square of what the photo shows in a tile less its means over pixels."""
    factor = scene.sampling.factor
    fine = scene.shown(corner, (TILE, TILE), torch.float32)
    blocks = fine.reshape(TILE, factor, TILE, factor, 3)
    return float((blocks - blocks.mean((1, 3), keepdim=True)).square().mean())
