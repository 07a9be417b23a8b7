"""What a frame of froxel fog costs: over a copy of its picture's bytes, on one thread and not compiled, and in memory.

The grid is what the effect's `prepare` makes, the picture what is drawn from it; a frame with history is both, and the
reading of the froxels of the frame before. Memory is that of a process that draws frames beyond one that only makes
their inputs.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import torch

from diffrender.atmosphere import froxel_fog
from diffrender.atmosphere.froxel_fog import FroxelFog
from diffrender.atmosphere.froxel_grid import Grid
from diffrender.parameters import defaults
from experiments import fit_command, froxel_scene, records
from experiments.froxels import SMALL, everything
from experiments.timing import in_turn, one_thread, ratio, seconds_of

MEBIBYTE = 2**20
ROUNDS = 5


@one_thread()
def costs(size: tuple[int, int], grid: Grid, rounds: int) -> list[dict[str, Any]]:
    """Times of what a frame takes over that of a copy of its bytes, in turn."""
    fog, view = defaults(FroxelFog), froxel_scene.frame(*size, everything(), grid=grid)
    once = froxel_scene.still(view, 1)
    summed = froxel_fog.prepare(fog, once)
    coarse = froxel_fog.prepare_coarse(fog, once)
    state = froxel_fog.step(fog, view, None)[1]
    works: dict[str, Callable[[], object]] = {
        "copy": partial(torch.empty_like(view.background).copy_, view.background),
        "grid": partial(froxel_fog.prepare, fog, once),
        "picture": partial(froxel_fog.render_summed, fog, summed),
        "coarse grid": partial(froxel_fog.prepare_coarse, fog, once),
        "coarse picture": partial(froxel_fog.render_summed, fog, coarse),
        "frame with history": partial(froxel_fog.step, fog, view, state),
    }
    with torch.no_grad():
        found = in_turn({name: partial(seconds_of, work) for name, work in works.items()}, rounds)
    copy = found.pop("copy")
    return [{"work": name, "copies": asdict(ratio(spread, copy))} for name, spread in found.items()]


def memory(width: int, height: int) -> dict[str, float]:
    """Mebibytes that stay from frame to frame, and that drawing one takes at most, over making its inputs alone."""
    peaks = []
    for frames in (0, 2):
        told = f"--frames={frames}", f"--picture={width}x{height}"
        peaks.append(fit_command.run_well([sys.executable, "-m", "experiments.froxel_time", *told]).peak_bytes)
    grid = Grid()
    kept = 4 * 4 * grid.columns * grid.rows * grid.slices
    return {"kept_mebibytes": kept / MEBIBYTE, "at_most_mebibytes": (peaks[1] - peaks[0]) / MEBIBYTE}


@torch.no_grad()
def draw_frames(count: int, width: int, height: int) -> None:
    """Draw a few frames of a picture so large, with history."""
    view, state = froxel_scene.frame(width, height, everything()), None
    for _ in range(count):
        state = froxel_fog.step(defaults(FroxelFog), view, state)[1]


def table(content: Mapping[str, Any]) -> str:
    """Text of the results."""
    timed = [[row["work"], f"{row['copies']['median']:.3g}"] for row in content["costs"]]
    kept, most = (f"{content['memory'][name]:.0f} MiB" for name in ("kept_mebibytes", "at_most_mebibytes"))
    told = f"kept from frame to frame {kept}, at most {most} while one is drawn"
    return f"{records.table(['over a copy of the picture', 'median'], timed)}\n\n{told}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table and write it as JSON."""
    parser = argparse.ArgumentParser(description="time and memory of froxel fog")
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    parser.add_argument("--picture", help="WIDTHxHEIGHT: draw --frames frames of that size and tell nothing")
    parser.add_argument("--frames", type=int, default=1)
    given = parser.parse_args(arguments)
    if given.picture is not None:
        width, height = map(int, given.picture.split("x"))
        draw_frames(given.frames, width, height)
        return
    full = given.size == "full"
    size = (1920, 1080) if full else (16, 9)
    timed = costs(size, Grid() if full else SMALL, ROUNDS if full else 1)
    content = {"costs": timed, "memory": memory(*size), "picture": size}
    print(table(content))
    records.write(given.out / "froxel_time.json", content, threads=1)


if __name__ == "__main__":
    main()
