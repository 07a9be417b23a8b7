"""Which parameters a photo can speak about: what it leaves open goes to its default, and others take its place."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from diffrender.scene import Scene, places
from fit.gauss_newton import QuadraticModel
from fit.minimum import AT_BOUND, Minimum, Point
from fit.objective import SkyObjective
from fit.search_space import SearchSpace, put, value
from fit.uncertainty import WIDEST, reasons, unexplained

# Without a cloud layer there is nothing that these could change.
OF_OVERCAST = "SKY_OVERCAST"
NO_LAYER = "no cloud layer in the photo"
# Patches of sky, as if independent, for the rule of thumb by which parameters give way to others. Which do is a matter
# of how good the picture gets; error bars are made with more care afterwards.
PATCHES = 60
DAMPING = 1e-3  # of a promise: steps across the whole box are seldom kept


def pinned_scene(space: SearchSpace, point: Point, names: Sequence[str], home: Scene) -> Scene:
    """Scene at a point, some of its parameters put back to where they are at home."""
    known = places()
    scene = space.scene(torch.from_numpy(point))
    for name in names:
        scene = put(scene, known[name], value(home, known[name]))
    return scene


def left_open(objective: SkyObjective, minimum: Minimum) -> dict[str, str]:
    """Reason of each searched name that may give way to others; empty for those that the photo speaks of."""
    residuals, slopes = (found.numpy() for found in minimum.derivatives(objective))
    count = objective.sample.log_radiance.numel()
    why = reasons(slopes[:count], minimum.point, AT_BOUND)
    while kept := unexplained(why):
        curvature = slopes[:, kept].T @ slopes[:, kept]
        error = np.sqrt(np.linalg.inv(curvature).diagonal() * float(residuals @ residuals) / PATCHES)
        if error.max() <= WIDEST:
            break
        why[kept[int(error.argmax())]] = "not determined by the photo"
    return dict(zip(objective.space.free, why, strict=True))


def undetermined(why: Mapping[str, str], overcast: float | None) -> dict[str, str]:
    """Names that a photo says nothing of, with the reason; those of a cloud layer that it does not show among them."""
    lost = {name: reason for name, reason in why.items() if reason and not reason.startswith("at its")}
    if overcast == 0.0:
        lost |= {name: NO_LAYER for name in why if name.startswith(OF_OVERCAST)}
    return lost


def widened(objective: SkyObjective, pool: Sequence[str], count: int) -> SearchSpace:
    """Space with the names of the pool added that promise the lowest loss, up to a count of names.

    Each promise is the lowest point of the Gauss-Newton model within the bounds; names are taken one after the other.
    """
    space = objective.space
    candidates = [name for name in pool if name not in space.free]
    if float(value(space.start, places()[OF_OVERCAST])) == 0.0:
        candidates = [name for name in candidates if not name.startswith(OF_OVERCAST)]
    whole = SearchSpace(space.start, (*space.free, *candidates))
    point = whole.point(whole.start)
    residuals, slopes = SkyObjective(whole, objective.sample, objective.geometry).jacobian(torch.from_numpy(point))
    chosen = list(range(len(space.free)))

    def promise(index: int) -> float:
        with_it = [*chosen, index]
        model = QuadraticModel(point[with_it], residuals, slopes[:, with_it])
        return model.decrease(model.lowest(DAMPING))

    while len(chosen) < min(count, len(whole.free)):
        rest = [index for index in range(len(whole.free)) if index not in chosen]
        chosen.append(max(rest, key=promise))
    return SearchSpace(space.start, tuple(whole.free[index] for index in chosen))


def begin(space: SearchSpace) -> Point:
    """Start of a search: off the faces of the cube, where a share of 0 hides the slopes of what depends on it."""
    start: Point = np.clip(space.point(space.start), 0.01, 0.99)
    return start
