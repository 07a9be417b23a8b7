"""Pictures of what wind moves: a meadow before a sky, plants from the side, a banner and a head of hair."""

import math
from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.patches import Ellipse, Polygon, Wedge
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from torch import Tensor

from diffrender.weather import bending, drawn_curve, wind
from diffrender.weather.bones import Chain
from diffrender.weather.wind import Wave
from experiments import wind_scene
from experiments.wind_scene import Meadow

EYE = 2.3  # height above the meadow [m]
HALF_WIDTH, TOP, BOTTOM = 0.62, 0.075, -0.245  # of the meadow's picture from its horizon, at a distance of 1
HAZY = 90.0  # distance at which the meadow has lost most of its colour [m]
SUN = np.array([-0.45, -0.6, 0.66])  # unit direction
ROOT, TIP, SHEEN, HAZE = np.array([[0.05, 0.13, 0.04], [0.33, 0.46, 0.13], [0.93, 0.94, 0.66], [0.62, 0.72, 0.66]])
HORIZON, ZENITH = np.array([[0.93, 0.94, 0.90], [0.45, 0.63, 0.82]])
SPACING = 1.02  # of plants, in their length
POPPY = np.array([0.85, 0.14, 0.08])
RED, GOLD = np.array([[0.62, 0.07, 0.10], [0.95, 0.74, 0.26]])
DARK_HAIR, LIT_HAIR = np.array([[0.16, 0.07, 0.03], [0.96, 0.70, 0.38]])

Numbers = NDArray[np.float64]


def draw_meadow(axes: Axes, land: Meadow, waves: Sequence[Wave], seconds: float) -> None:
    """Draw the meadow at a time, far blades first, lighter where they lie: there they show their sides to the sky."""
    axes.imshow(
        np.linspace(HORIZON, ZENITH, 64)[:, None, :],
        extent=(-HALF_WIDTH, HALF_WIDTH, 0.0, TOP),
        origin="lower",
        aspect="auto",
    )
    axes.imshow(_ground_colours(), extent=(-HALF_WIDTH, HALF_WIDTH, BOTTOM, 0.0), origin="lower", aspect="auto")
    lean = wind_scene.blown(land, waves, seconds)
    edges = wind_scene.ribbons(land, lean, pieces=6)
    order = torch.argsort(land.root[:, 1], descending=True)
    quads = torch.cat([edges[:, :-1], edges[:, 1:].flip(-2)], -2)[order]
    axes.add_collection(
        PolyCollection(
            list(_seen(quads).reshape(-1, 4, 2)), facecolors=_grass_colours(edges[order]).reshape(-1, 3), linewidths=0.0
        )
    )
    flowers = order[order % 37 == 0]
    heads = edges[flowers, -1].mean(-2)
    right, up = _seen(heads).T
    axes.scatter(right, up, s=1500.0 / heads[:, 1].numpy() ** 2, color=POPPY, linewidths=0.0, zorder=3)
    axes.set(xlim=(-HALF_WIDTH, HALF_WIDTH), ylim=(BOTTOM, TOP), aspect="equal")
    axes.set_axis_off()


def draw_arrows(axes: Axes, waves: Sequence[Wave], distance: float, seconds: float) -> None:
    """Draw the wind over the meadow at a distance, as arrows in the sky."""
    across = torch.linspace(-0.94, 0.94, 24, dtype=torch.float64) * HALF_WIDTH * distance
    place = torch.stack([across, torch.full_like(across, distance), torch.zeros_like(across)], -1)
    speed = wind.velocity(waves, place, across.new_tensor(seconds))[:, 0]
    axes.quiver(
        across / distance,
        torch.full_like(across, 0.55 * TOP),
        speed,
        torch.zeros_like(speed),
        scale=220.0,
        width=0.0022,
        color="0.25",
        zorder=4,
    )


def draw_curve(axes: Axes, gust: Wave, distance: float, seconds: float) -> None:
    """Draw a wave over the land with its keyframes, and the stretch of it that the picture shows at a distance."""
    half = HALF_WIDTH * distance
    across = torch.linspace(-1.6 * half, 1.6 * half, 400, dtype=torch.float64)
    ahead = float(gust.towards[1]) * distance

    def phase(place: Tensor) -> Tensor:
        return seconds / gust.period - (place * gust.towards[0] + ahead) / gust.wavelength

    axes.axvspan(-half, half, color="#cfdcae", linewidth=0.0)
    axes.plot(across, gust.strength * drawn_curve.value(gust.curve, phase(across)), color="#355f8d")
    turns = torch.arange(-3.0, 4.0, dtype=torch.float64)[:, None] + gust.curve.places
    keyframes = ((seconds / gust.period - turns) * gust.wavelength - ahead) / gust.towards[0]
    values = gust.strength * gust.curve.values.expand_as(keyframes)
    axes.plot(keyframes.ravel(), values.ravel(), "o", color="#c44e32", markersize=4.0)
    axes.set(xlim=(float(across[0]), float(across[-1])), ylim=(0.0, 1.15 * float(gust.strength)), ylabel="m/s")
    axes.set_title(f"t = {seconds:g} s", loc="left", fontsize="small")
    axes.spines[["top", "right"]].set_visible(False)


def _ground_colours() -> Numbers:
    """Colours of the soil between blades, from the picture's lower edge to the horizon."""
    distance = -EYE / np.linspace(BOTTOM, -1e-6, 64)
    far = (1.0 - np.exp(-distance / HAZY))[:, None, None]
    soil = 0.7 * ROOT + 0.3 * TIP
    found: Numbers = soil + (HAZE - soil) * far
    return found


def _seen(place: Float[Tensor, "*batch 3"]) -> Numbers:
    """Places in the meadow's picture, which is upright."""
    found: Numbers = torch.stack([place[..., 0], place[..., 2] - EYE], -1).div(place[..., 1, None]).numpy()
    return found


def _grass_colours(edges: Float[Tensor, "blades heights 2 3"]) -> Numbers:
    """Colours of the pieces of blades."""
    middle = edges.mean(-2)
    piece = torch.nn.functional.normalize(middle[:, 1:] - middle[:, :-1], dim=-1)
    lies = (1.0 - piece[..., 2].clamp(min=0.0)).numpy()[..., None]
    height = np.linspace(0.0, 1.0, lies.shape[1])[None, :, None]
    tint = np.random.default_rng(2).uniform(0.75, 1.2, (len(lies), 1, 1))
    green = (ROOT + (TIP - ROOT) * height) * tint
    lit = green + (SHEEN - green) * np.clip(1.5 * lies * np.sqrt(height), 0.0, 1.0)
    far = (1.0 - np.exp(-edges[:, 0, 0, 1].numpy() / HAZY))[:, None, None]
    found: Numbers = np.clip(lit + (HAZE - lit) * far, 0.0, 1.0)
    return found


def draw_plants(axes: Axes, speeds: Sequence[float], flexibility: float, length: float) -> None:
    """Draw one plant in rising winds beside itself upright, with marks at quarters of its stem and its tip's path."""
    stem = _stem(length)
    arcs = torch.stack([torch.linspace(0.0, bending.FARTHEST_LEAN, 60), torch.zeros(60)], -1).double()
    path = bending.bent(stem[-1].expand(60, 3), arcs, torch.tensor(length))[:, [0, 2]].numpy()
    for number, speed in enumerate(speeds):
        foot = np.array([SPACING * length * number, 0.0])
        lean = bending.lean(torch.tensor([speed, 0.0, 0.0]).double(), torch.tensor(flexibility))
        bent = bending.bent(stem, lean, torch.tensor(length))[:, [0, 2]].numpy() + foot
        axes.plot(*(path + foot).T, ":", color="0.6", linewidth=0.9)
        axes.plot([foot[0], foot[0]], [0.0, length], color="0.85", linewidth=1.5)
        leaves = bending.bent(_leaves(length), lean, torch.tensor(length))[..., [0, 2]].numpy() + foot
        axes.add_collection(
            PolyCollection(list(leaves), facecolors="#7fa650", edgecolors="#4c6b2c", linewidths=0.4, zorder=2)
        )
        axes.plot(*bent.T, color="#3d5a26", linewidth=2.0, zorder=3)
        axes.plot(*bent[:: (len(bent) - 1) // 4].T, "o", color="#c44e32", markersize=3.2, zorder=4)
    axes.axhline(0.0, color="#6b5a3e", linewidth=1.5)
    axes.set(xlim=(-0.4 * length, SPACING * length * len(speeds)), ylim=(-0.04, 1.06 * length), aspect="equal")
    axes.set(xticks=[SPACING * length * number for number in range(len(speeds))], yticks=[])
    axes.set_xticklabels([f"{speed:g} m/s" for speed in speeds])
    axes.tick_params(length=0.0)
    axes.spines[:].set_visible(False)
    axes.set_title(f"flexibility {flexibility:g} rad s²/m²", loc="left", fontsize="small")


def _stem(length: float) -> Float[Tensor, "41 3"]:
    height = torch.linspace(0.0, length, 41, dtype=torch.float64)
    return torch.stack([torch.zeros_like(height), torch.zeros_like(height), height], -1)


def _leaves(length: float) -> Float[Tensor, "leaves outline 3"]:
    """Outlines of leaves in the plane of the picture, left and right in turn, smaller towards the tip."""
    along = np.linspace(0.0, 1.0, 14)
    wide = 0.16 * np.sqrt(along) * (1.0 - along)
    outline = np.concatenate([np.stack([along, wide], -1), np.stack([along, -wide], -1)[::-1]])
    found = []
    for number in range(9):
        share = 0.16 + 0.1 * number
        side = 1.0 if number % 2 else -1.0
        size = length * 0.26 * (1.15 - share)
        rise = 0.7
        turned = outline @ np.array([[side * math.cos(rise), math.sin(rise)], [-side * math.sin(rise), math.cos(rise)]])
        leaf = np.zeros((len(turned), 3))
        leaf[:, [0, 2]] = size * turned + np.array([0.0, share * length])
        found.append(torch.from_numpy(leaf))
    return torch.stack(found)


def draw_banner(axes: Axes, chain: Chain) -> None:
    """Draw the cloth between chains, far pieces first, with a border and a disc."""
    cloth = _finer(chain.joint, along=5, across=5)
    right, up, away = _banner_axes()
    corners = np.stack([cloth[:-1, :-1], cloth[1:, :-1], cloth[1:, 1:], cloth[:-1, 1:]], -2)
    normal = np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 3, :] - corners[..., 0, :])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True) + 1e-12
    light = 0.35 + 0.75 * np.abs(normal @ SUN)
    colours = np.clip(_emblem(*light.shape) * light[..., None], 0.0, 1.0).reshape(-1, 3)
    far = np.argsort(-(corners.mean(-2) @ away).ravel())
    flat = np.stack([corners @ right, corners @ up], -1).reshape(-1, 4, 2)
    pole = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.75]])
    bar = np.array([[0.0, -0.68, 2.6], [0.0, 0.68, 2.6]])
    for rod in (pole, bar):
        axes.plot(rod @ right, rod @ up, color="#4a3620", linewidth=3.0, solid_capstyle="round", zorder=1)
    axes.add_collection(
        PolyCollection(list(flat[far]), facecolors=colours[far], edgecolors=colours[far], linewidths=0.7, zorder=2)
    )
    axes.set(xlim=(-0.75, 1.3), ylim=(0.75, 2.85), aspect="equal")
    axes.set_axis_off()


def _banner_axes() -> tuple[Numbers, Numbers, Numbers]:
    """Right, up and away of a look from the windward side and a little from below."""
    azimuth, rise = math.radians(38.0), 0.12
    away = np.array([math.cos(azimuth) * math.cos(rise), math.sin(azimuth) * math.cos(rise), math.sin(rise)])
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    return right, np.cross(right, away), away


def _emblem(across: int, down: int) -> Numbers:
    wide, high = np.meshgrid(np.linspace(-0.6, 0.6, across), np.linspace(0.0, 1.7, down), indexing="ij")
    is_border = (np.abs(wide) > 0.52) | (high > 1.62)
    radius = np.hypot(wide, high - 0.75)
    is_disc = (radius < 0.34) & ((radius > 0.26) | (radius < 0.16))
    found: Numbers = np.where((is_border | is_disc)[..., None], GOLD, RED)
    return found


def _finer(joint: Float[Tensor, "chains joints 3"], along: int, across: int) -> Numbers:
    """Joints and places between them, on splines along chains and across them."""
    found = joint.numpy()
    for axis, times in enumerate((across, along)):
        count = found.shape[axis]
        fine = np.linspace(0.0, count - 1.0, (count - 1) * times + 1)
        found = CubicSpline(np.arange(count), found, axis)(fine)
    return found


def draw_hair(axes: Axes, chain: Chain) -> None:
    """Draw a head from its left with its hair, lit where strands lie across the light."""
    axes.add_patch(Polygon(_face(), facecolor="#d9a988", edgecolor="none", zorder=1))
    axes.add_patch(Wedge((0.0, 0.0), 0.1, -50.0, 125.0, facecolor=DARK_HAIR, zorder=1))
    axes.add_patch(
        Ellipse((0.005, -0.02), 0.024, 0.042, angle=-12.0, facecolor="#cf9b79", edgecolor="#a5714f", zorder=3)
    )
    order = torch.argsort(chain.joint[:, 0, 1], descending=True)
    place = _finer(chain.joint[order], along=3, across=1)
    along = np.diff(place, axis=1)
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    half = SUN + np.array([0.0, -1.0, 0.0])
    half /= np.linalg.norm(half)
    gloss = (1.0 - (along @ half) ** 2)[..., None] ** 6
    tint = np.random.default_rng(1).uniform(0.7, 1.15, (len(place), 1, 1))
    colours = np.clip((DARK_HAIR + (LIT_HAIR - DARK_HAIR) * (0.25 + 0.7 * gloss)) * tint, 0.0, 1.0)
    flat = place[..., [0, 2]]
    pieces = np.stack([flat[:, :-1], flat[:, 1:]], -2).reshape(-1, 2, 2)
    axes.add_collection(
        LineCollection(list(pieces), colors=colours.reshape(-1, 3), linewidths=0.8, capstyle="round", zorder=2)
    )
    axes.set(xlim=(-0.2, 0.5), ylim=(-0.42, 0.2), aspect="equal")
    axes.set_axis_off()


def _face() -> Numbers:
    """Outline of a face that looks to the left, and of the neck."""
    return np.array(
        [
            (0.0, 0.098), (-0.05, 0.088), (-0.082, 0.065), (-0.098, 0.03), (-0.1, 0.0), (-0.101, -0.012),
            (-0.112, -0.035), (-0.127, -0.055), (-0.122, -0.064), (-0.108, -0.066), (-0.112, -0.08), (-0.107, -0.087),
            (-0.111, -0.097), (-0.104, -0.106), (-0.105, -0.123), (-0.092, -0.136), (-0.06, -0.128), (-0.03, -0.115),
            (-0.028, -0.2), (-0.06, -0.235), (-0.12, -0.27), (-0.14, -0.42), (0.16, -0.42), (0.13, -0.26),
            (0.05, -0.22), (0.045, -0.12), (0.09, -0.05), (0.095, 0.02), (0.06, 0.08),
        ]
    )  # fmt: skip
