"""How far shadows by maps are from those that rays find: of lamps in an atlas, and of the sun in cascades.

Compared are places of a hall of balls that a light would reach, whose normals it faces: by the soft comparison that
effects use, and by a hard one with the nearest texel, lifted off the surface alike. A shadow differs where it is on the
other side of a half; the mean error is that of the share of light. The picture shows the lamps without shadows, with
those of maps, and by rays; then the sun on the wet hall, its cascades, and by rays.
"""

import argparse
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Float
from matplotlib.figure import Figure
from torch import Tensor

from diffrender.geometry import light_grid, shadow_map
from diffrender.geometry.light_grid import Depths
from diffrender.geometry.shadow_map import Camera, Cascade
from diffrender.parameters import defaults
from diffrender.rays import from_angles
from diffrender.shading import lamp_shadow, local_lights
from diffrender.shading.lamps import Group, LitView, LocalLights, in_frame
from diffrender.shading.wet_surface import Wetness
from diffrender.shading.wetness import render_still
from experiments import hall_shadows, lamp_scenes, records, wet_scenes
from experiments.lamp_scenes import Seen

PICTURE, SMALL_PICTURE, TILE = (384, 240), (48, 30), 16
LAMPS, RAISED = 12, 1.5  # and how much higher they hang than those of `lamp_scenes` [m]
ATLASES, SMALL_ATLASES = (512, 1024, 2048), (128, 512)
RESOLUTIONS, SMALL_RESOLUTIONS = (256, 512, 1024), (32, 64)
CASCADES, NEAR, FAR, EVENNESS = 4, 2.0, 66.0, 0.3
SUN = (math.radians(28.0), math.radians(118.0))  # elevation, azimuth
ABOVE = 100.0  # height from which the sun's rays begin [m]
SLOPE = 2.0  # texels of bias on a slope of 45 degrees to the sun
EXPOSURE, OUTDOORS = 5.0, 0.7
CLEAR = 5.0  # times the sun of a rainy day

Share = Callable[[Group, Tensor, Tensor], Tensor]


def lamp_hall(size: tuple[int, int], atlas: int) -> tuple[Seen, LitView]:
    """Hall of lamps that all cast shadows, where an atlas has room for them."""
    draw = torch.Generator().manual_seed(1)
    shown, lamps = lamp_scenes.seen(lamp_scenes.camera(*size), draw), lamp_scenes.lamps(LAMPS, draw)
    higher = replace(lamps, position=lamps.position + lamps.position.new_tensor((0.0, 0.0, RAISED)))
    return shown, hall_shadows.shaded(shown, higher, LAMPS, TILE, atlas)


def soft(group: Group, place: Tensor, normal: Tensor) -> Float[Tensor, "*batch lamps"]:
    """Share of lamps as effects have it."""
    assert group.shadows is not None
    return lamp_shadow.share(group.shadows, in_frame(group.lamps, place), in_frame(group.lamps, normal))


def hard(group: Group, place: Tensor, normal: Tensor) -> Float[Tensor, "*batch lamps"]:
    """The same by the texel in which a place lies."""
    assert group.shadows is not None
    lifted = lamp_shadow.lifted(group.shadows, in_frame(group.lamps, place), in_frame(group.lamps, normal))
    row, column = lamp_shadow.in_square(group.shadows.squares, lifted)
    squares = group.shadows.squares
    down, across = (torch.minimum(one.round().long().clamp(min=0), squares.size - 1) for one in (row, column))
    caught = group.shadows.atlas[squares.corner[..., 0] + down, squares.corner[..., 1] + across]
    distance: Tensor = torch.linalg.vector_norm(lifted, dim=-1)
    return (-distance > caught).double()


def of_lamps(size: tuple[int, int], atlas: int) -> dict[str, Any]:
    """Shadows of a hall's lamps against rays, of all pairs of place and lamp in whose light it would lie."""
    shown, view = lamp_hall(size, atlas)
    group = view.shadowed
    assert group is not None
    # Lamp by lamp: all pairs at once take gigabytes.
    parts = [_of_one(shown, view, hall_shadows.alone(group, number)) for number in range(len(group.lamps.reach))]
    truth = torch.cat([part["rays"] for part in parts])
    found = {name: torch.cat([part[name] for part in parts]) for name in ("soft", "hard")}
    assert group.shadows is not None
    sizes = group.shadows.squares.size
    about = {"atlas": atlas, "maps": len(sizes), "least_map": int(sizes.min()), "most_map": int(sizes.max())}
    return about | {"pairs": len(truth), "dark": 1.0 - float(truth.mean())} | _judged(found, truth)


def _of_one(shown: Seen, view: LitView, group: Group) -> dict[str, Tensor]:
    """Shares of places in a lamp's light by both comparisons and by rays."""
    places, lights = view.places, defaults(LocalLights, torch.float64)
    place, normal = places.position[..., None, :] - group.lamps.position, places.normal[..., None, :]
    is_lit = local_lights.reaching(lights, view.profiles, group.lamps, place) > 0.0
    is_lit &= (place * normal).sum(-1) < 0.0
    start = places.position + hall_shadows.OFF * places.normal
    truth = hall_shadows.is_seen(shown.balls, start[..., None, :], group.lamps.position)[is_lit].double()
    return {"soft": soft(group, place, normal)[is_lit], "hard": hard(group, place, normal)[is_lit], "rays": truth}


def _judged(found: dict[str, Tensor], truth: Tensor) -> dict[str, Any]:
    return {
        name: {
            "differs": float(((share > 0.5) != (truth > 0.5)).double().mean()),
            "mean_error": float((share - truth).abs().mean()),
        }
        for name, share in found.items()
    }


def cascades(shown: Seen, resolution: int) -> tuple[list[Cascade], list[Tensor], Depths]:
    """Cascades over the hall, their maps, and the depths between which each counts."""
    eyes, like = shown.camera, shown.position
    forward = from_angles(like.new_tensor(eyes.pitch), like.new_tensor(0.0))
    corner = math.tan(eyes.field_of_view / 2.0) * math.hypot(1.0, eyes.height / eyes.width)
    camera = Camera(like.new_tensor(lamp_scenes.EYE), forward, like.new_tensor(corner))
    ends = shadow_map.splits(NEAR, FAR, CASCADES, EVENNESS)
    pieces = list(zip((0.0, *ends[1:-1]), ends[1:], strict=True))
    seen = [shadow_map.cascade(camera, piece, to_sun(like), resolution) for piece in pieces]
    near, far = (like.new_tensor(side) for side in zip(*pieces, strict=True))
    return seen, [_heights(shown, one) for one in seen], Depths(near, far)


def _heights(shown: Seen, seen: Cascade) -> Tensor:
    rays = shadow_map.texel_rays(seen, ABOVE)
    way, _ = lamp_scenes.met(shown.balls, rays.origin, rays.direction)
    return ABOVE - way.clamp(max=hall_shadows.NOTHING)


def to_sun(like: Tensor) -> Float[Tensor, "3"]:
    """Where the sun stands."""
    return from_angles(*(like.new_tensor(angle) for angle in SUN))


def sunlit(shown: Seen, resolution: int, softness: float) -> Float[Tensor, "height width"]:
    """Share of the sun at a picture's places by cascades, whose comparisons are so soft [texels]."""
    seen, maps, pieces = cascades(shown, resolution)
    cosine = (shown.normal * to_sun(shown.position)).sum(-1).clamp(min=0.05)
    steep = torch.sqrt(1.0 - cosine * cosine) / cosine
    shares = [
        shadow_map.visibility(heights, one, shown.position, SLOPE * one.texel * (0.2 + steep), softness * one.texel)
        for one, heights in zip(seen, maps, strict=True)
    ]
    return shadow_map.cascaded(shares, pieces, lamp_scenes.depth(shown, shown.position))


def sun_seen(shown: Seen) -> Float[Tensor, "height width"]:
    """The same by rays."""
    start = shown.position + hall_shadows.OFF * shown.normal
    way, _ = lamp_scenes.met(shown.balls, start, to_sun(start).expand_as(start))
    return way.isinf().double()


def of_sun(size: tuple[int, int], resolution: int) -> dict[str, Any]:
    """Shadows of the sun against rays, of all places that face it."""
    shown = lamp_scenes.seen(lamp_scenes.camera(*size), torch.Generator().manual_seed(1))
    faces = (shown.normal * to_sun(shown.position)).sum(-1) > 0.0
    truth = sun_seen(shown)[faces]
    found = {"soft": sunlit(shown, resolution, 0.25)[faces], "sharp": sunlit(shown, resolution, 1e-6)[faces]}
    about = {"resolution": resolution, "cascades": CASCADES, "places": len(truth), "dark": 1.0 - float(truth.mean())}
    return about | _judged(found, truth)


def by_rays(shown: Seen, view: LitView) -> Tensor:
    """Light of lamps that rays find, lamp by lamp."""
    lights, group = defaults(LocalLights, torch.float64), view.shadowed
    assert group is not None
    start = view.places.position + hall_shadows.OFF * view.places.normal
    total = torch.zeros_like(start)
    for number in range(len(group.lamps.reach)):
        one = hall_shadows.some(group.lamps, torch.tensor([number]))
        light = local_lights.render(lights, replace(view, lamps=one, shadowed=None))
        total = total + light * hall_shadows.is_seen(shown.balls, start, one.position)[..., None]
    return total


def wet_hall(shown: Seen, share: Tensor) -> Tensor:
    """The hall after rain, under the sun of which each place has a share, and the sky."""
    x, y = shown.position[..., 0], shown.position[..., 1]
    is_floor = shown.normal[..., 2] > 0.999
    dips = torch.where(is_floor, 0.5 + 0.4 * torch.sin(0.9 * x + 0.4 * y) * torch.cos(0.7 * y - 0.2 * x), 1.0)
    even = wet_scenes.Weather(sun=(math.degrees(SUN[0]), math.degrees(SUN[1])))
    looks = shown.base, shown.roughness, torch.full_like(dips, 0.8), dips
    view = wet_scenes.view(even, shown.position, shown.normal, shown.to_eye, looks)
    # Where the sun's shadow enters an effect: the irradiance is that of the place.
    irradiance = CLEAR * view.irradiance * share[..., None]
    return render_still(defaults(Wetness, torch.float64), replace(view, irradiance=irradiance))


def drawn(path: Path, size: tuple[int, int], atlas: int, resolution: int) -> None:
    """Lamps, then the sun: without shadows, by maps, by rays."""
    shown, view = lamp_hall(size, atlas)
    lights, group = defaults(LocalLights, torch.float64), view.shadowed
    assert group is not None
    through = replace(view, shadowed=replace(group, shadows=None))
    of_lamp = [local_lights.render(lights, through), local_lights.render(lights, view), by_rays(shown, view)]
    panels = [EXPOSURE * light_grid.from_tiles(one, size[1], size[0], TILE) for one in of_lamp]
    shares = torch.ones_like(shown.roughness), sunlit(shown, resolution, 0.25), sun_seen(shown)
    panels += [OUTDOORS * wet_hall(shown, share) for share in shares]
    titles = [f"{len(group.lamps.reach)} lamps without shadows", f"by maps in an atlas of {atlas}²", "by rays"]
    titles += ["sun without shadows", f"by {CASCADES} cascades of {resolution}²", "by rays"]
    figure = Figure(figsize=(18.0, 7.8), layout="constrained")
    for axes, panel, title in zip(figure.subplots(2, 3).flat, panels, titles, strict=True):
        axes.imshow((1.0 - torch.exp(-panel)).clamp(0.0, 1.0).pow(1.0 / 2.2).numpy())
        axes.set_title(title)
        axes.set_axis_off()
    figure.savefig(path, dpi=80)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how often shadows differ, and write it as JSON and a picture."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    is_small = given.size == "small"
    size = SMALL_PICTURE if is_small else PICTURE
    lamps = [of_lamps(size, atlas) for atlas in (SMALL_ATLASES if is_small else ATLASES)]
    sun = [of_sun(size, resolution) for resolution in (SMALL_RESOLUTIONS if is_small else RESOLUTIONS)]
    print(table("atlas", "hard", lamps), table("resolution", "sharp", sun), sep="\n\n")
    written = given.out / "shadows.json"
    records.write(written, {"size": size, "lamps": lamps, "sun": sun})
    drawn(written.with_suffix(".png"), size, lamps[-1]["atlas"], sun[-1]["resolution"])


def table(side: str, other: str, rows: Sequence[dict[str, Any]]) -> str:
    """Text of how often shadows differ from those of rays, and by how much on average."""
    names = [(name, what) for name in ("soft", other) for what in ("differs", "mean_error")]
    lines = [[str(row[side]), *(f"{row[name][what]:.2%}" for name, what in names)] for row in rows]
    return records.table([side, *(f"{name} {what.replace('_', ' ')}" for name, what in names)], lines)


if __name__ == "__main__":
    main()
