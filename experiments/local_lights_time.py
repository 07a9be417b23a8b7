"""How long local lights take against the number of lamps: by tiles and clusters, and all lamps over that.

Times are of one thread and of pictures of float32. As many lamps reach a place on average, however many there are: with
more of them each ends nearer. Lists are made in float64, from the picture's depths.
"""

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import torch
from matplotlib.figure import Figure

from diffrender.parameters import defaults
from diffrender.shading import local_lights
from diffrender.shading.lamps import LocalLights
from experiments import lamp_scenes, records
from experiments.effects import in_dtype
from experiments.local_lights import CULLED, GROUPS, held
from experiments.timing import Spread, in_turn, one_thread, ratio, seconds_of

COUNTS, SMALL_COUNTS = (100, 300, 1_000, 3_000, 10_000), (30, 100)
SIZE, SMALL_SIZE, TILE = (64, 48), (16, 12), 8
ROUNDS = 2
LISTS = "making lists"


def times(count: int, size: tuple[int, int]) -> dict[str, Any]:
    """Times of a hall of so many lamps [s], and that of all lamps over those of lists."""
    draw = torch.Generator().manual_seed(count)
    shown, lamps = lamp_scenes.seen(lamp_scenes.camera(*size), draw), lamp_scenes.lamps(count, draw)
    view, lights = lamp_scenes.view(shown, lamps, TILE), defaults(LocalLights, torch.float32)
    single = in_dtype(view, torch.float32)
    works: dict[str, Callable[[], object]] = {
        name: partial(local_lights.in_groups, rung, lights, single, GROUPS) for name, rung in CULLED.items()
    }
    works["all lights"] = partial(local_lights.render, lights, single)
    works[LISTS] = partial(lamp_scenes.view, shown, lamps, TILE)
    taken = in_turn({name: partial(seconds_of, work) for name, work in works.items()}, ROUNDS)
    over = {name: _told(ratio(taken["all lights"], spent)) for name, spent in taken.items() if name != "all lights"}
    return {"lamps": count, "all_over": over, "seconds": {n: _told(s) for n, s in taken.items()}} | held(view)


def _told(spread: Spread) -> dict[str, Any]:
    return {name: value for name, value in asdict(spread).items() if name != "each"}


def chart(path: Path) -> None:
    """Times against the number of lamps, over that of all lights at the fewest."""
    rows = json.loads(path.read_text(encoding="utf-8"))["times"]
    counts, first = [row["lamps"] for row in rows], rows[0]["seconds"]["all lights"]["median"]
    figure = Figure(figsize=(7.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for name in ("all lights", *CULLED, LISTS):
        axes.plot(counts, [row["seconds"][name]["median"] / first for row in rows], "o-", label=name)
    axes.set(xscale="log", yscale="log", xlabel="lamps", ylabel=f"time over that of all lights at {counts[0]}")
    axes.legend()
    figure.savefig(path.with_suffix(".png"), dpi=100)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how many times longer all lamps take, and write times as JSON and as a chart."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("--out", type=Path, default=records.RESULTS, help="folder of the results")
    given = parser.parse_args(arguments)
    counts, size = (SMALL_COUNTS, SMALL_SIZE) if given.size == "small" else (COUNTS, SIZE)
    with one_thread():
        rows = [times(count, size) for count in counts]
    print(table(rows))
    written = given.out / "local_lights_time.json"
    records.write(written, {"size": size, "tile": TILE, "times": rows}, threads=1)
    chart(written)


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Text of how many times longer all lamps take than lists, and how many lamps those hold."""
    names = (*CULLED, LISTS)
    lines = [
        [str(row["lamps"]), *(f"{row['all_over'][name]['median']:.3g}" for name in names)]
        + [f"{row[kept]:.3g}" for kept in ("mean_in_tile", "mean_in_cell")]
        for row in rows
    ]
    return records.table(["lamps", *(f"all over {name}" for name in names), "in tile", "in cell"], lines)


if __name__ == "__main__":
    main()
