"""Charts of the experiments' JSON files; each is written beside its file."""

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

MUST = 0.45  # largest geometric mean of the errors over those of the better peer
COVERED = {"within_one": (0.63, 0.73), "within_two": (0.92, 0.97)}  # shares of intervals that are to hold the truth
FEWEST = 30  # intervals below which a share says nothing
MUST_BE_FASTER = 4.0  # least ratio of a peer's solve time to ours
EFFECTS_ABREAST = 4  # panels in a row
TOGETHER = 0.12  # share of a panel's side
COLUMNS = 3  # of rows of stability
ALLOWED = "allowed for 99.9 %"
MUST_BE_NEAR = 1.2  # largest error of a fit without help over that of one with mask and sun

Picture = NDArray[np.float64]
Mask = NDArray[np.bool_]


def fit_accuracy(path: Path) -> None:
    """Errors over those of the better peer, beside the floor of smooth skies."""
    content = json.loads(path.read_text(encoding="utf-8"))
    rows = sorted(content["records"], key=lambda row: float(row["ratio"]))
    places = range(len(rows))
    figure = Figure(figsize=(9.0, 1.5 + 0.4 * len(rows)), layout="constrained")
    axes = figure.subplots()
    axes.barh([place - 0.2 for place in places], [row["ratio"] for row in rows], height=0.4, label="fitted sky")
    axes.barh(
        [place + 0.2 for place in places],
        [row["floor_ratio"] for row in rows],
        height=0.4,
        label="free harmonics of order 4",
        color="0.7",
    )
    axes.axvline(1.0, color="black", linewidth=1.0, label="better peer")
    axes.axvline(content["geometric_means"]["ratio"], linestyle="--", label="geometric mean")
    axes.axvline(MUST, color="red", linestyle=":", label="largest mean allowed")
    axes.set(
        yticks=list(places),
        yticklabels=[row["photo"] for row in rows],
        xscale="log",
        xlabel="error E3 of log radiance over that of the better peer",
    )
    axes.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=5, fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=120)


def peer_time(path: Path) -> None:
    """How many times longer the peer's solve takes, with quartiles."""
    content = json.loads(path.read_text(encoding="utf-8"))
    rows = content["peer"]
    places = list(range(len(rows)))
    ratios = [row["ratio"] for row in rows]
    figure = Figure(figsize=(9.0, 1.5 + 0.4 * len(rows)), layout="constrained")
    axes = figure.subplots()
    middle = [ratio["median"] for ratio in ratios]
    whiskers = [
        [ratio["median"] - ratio["lower"] for ratio in ratios],
        [ratio["upper"] - ratio["median"] for ratio in ratios],
    ]
    axes.barh(places, middle, xerr=whiskers, capsize=3.0)
    axes.axvline(MUST_BE_FASTER, color="red", linestyle=":", label="least allowed")
    axes.set(
        yticks=places,
        yticklabels=[row["photo"] for row in rows],
        xlabel="solve time of Mitsuba 3's sunsky with L-BFGS-B over ours",
    )
    axes.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=5, fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=120)


def coverage(path: Path) -> None:
    """Shares of intervals that hold the truth, by parameter and by photo of the noise, with twice their own errors."""
    content = json.loads(path.read_text(encoding="utf-8"))
    rows = [row for row in (*content["records"], *content["noise"]) if row["determined"] >= FEWEST]
    places = list(range(len(rows)))
    figure = Figure(figsize=(9.0, 1.5 + 0.3 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for (share, (low, high)), colour, label in zip(COVERED.items(), ("C0", "C1"), ("68 %", "95 %"), strict=True):
        found = [row[share] for row in rows]
        spread = [2.0 * math.sqrt(row[share] * (1.0 - row[share]) / row["determined"]) for row in rows]
        axes.axvspan(low, high, color=colour, alpha=0.15, linewidth=0.0)
        axes.errorbar(found, places, xerr=spread, fmt="o", color=colour, capsize=3.0, label=f"interval of {label}")
    parameters = sum(row["determined"] >= FEWEST for row in content["records"])
    axes.axhline(parameters - 0.5, color="0.7", linewidth=0.8)
    axes.set(
        yticks=places,
        yticklabels=[f"{row['name']} ({row['determined']})" for row in rows],
        xlim=(0.4, 1.02),
        xlabel="share of intervals that hold the truth; shaded: what is asked",
    )
    axes.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=2, fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=120)


def error_versus_time(path: Path) -> None:
    """Error over time, both as powers of ten: a panel for each effect, a place for each rung."""
    effects = json.loads(path.read_text(encoding="utf-8"))["effects"]
    lines = math.ceil(len(effects) / EFFECTS_ABREAST)
    figure = Figure(figsize=(5.0 * EFFECTS_ABREAST, 1.0 + 3.4 * lines), layout="constrained")
    panels = list(figure.subplots(lines, EFFECTS_ABREAST, squeeze=False).flat)
    for axes, (effect, found) in zip(panels, effects.items(), strict=False):
        _error_panel(axes, effect, found["records"])
    for axes in panels[len(effects) :]:
        axes.set_visible(False)
    sizes = sorted({tuple(found["size"]["timed"]) for found in effects.values()})
    figure.supxlabel(f"ms for a picture of {' or '.join(f'{w} × {h}' for w, h in sizes)} on one thread")
    figure.supylabel("error in float32 against the reference")
    labelled = {label: line for axes in panels for line, label in zip(*axes.get_legend_handles_labels(), strict=True)}
    figure.legend(labelled.values(), labelled.keys(), loc="outside upper center", ncols=3, fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=100)


def _error_panel(axes: Axes, effect: str, rows: Sequence[dict[str, Any]]) -> None:
    drawing = [1e3 * row["times"]["render"]["median"] for row in rows]
    whole = [1e3 * row["times"]["prepare"]["median"] + time for row, time in zip(rows, drawing, strict=True)]
    largest = [row["on_examples"]["largest"] for row in rows]
    axes.plot(whole, largest, "o-", label="largest on examples; time with what is prepared")
    axes.plot(drawing, largest, "|", color="tab:blue", label="without what is prepared once")
    axes.hlines(largest, drawing, whole, color="tab:blue", linewidth=0.8)
    if all(row["on_picture"] for row in rows):
        axes.plot(
            whole, [row["on_picture"]["median"] for row in rows], ".:", color="tab:orange", label="median on a picture"
        )
    axes.set(title=effect, xscale="log", yscale="log")
    axes.margins(x=0.15, y=0.15)
    axes.grid(alpha=0.3)
    _name_rungs(axes, [row["rung"] for row in rows], list(zip(whole, largest, strict=True)))


def _name_rungs(axes: Axes, rungs: Sequence[str], points: Sequence[tuple[float, float]]) -> None:
    """Write names beside their points, towards the middle; those of points that lie together in one line each."""
    axes.autoscale_view()
    places = (axes.transScale + axes.transLimits).transform(points)
    named: list[tuple[NDArray[np.float64], list[str]]] = []
    for rung, place in zip(rungs, places, strict=True):
        together = next((names for first, names in named if np.abs(first - place).max() < TOGETHER), None)
        if together is None:
            named.append((place, [rung]))
        else:
            together.append(rung)
    for (x, y), names in named:
        axes.annotate(
            "\n".join(names), (x, y), xycoords="axes fraction", textcoords="offset points", fontsize="small",
            xytext=(6 if x < 0.5 else -6, 0), ha="left" if x < 0.5 else "right", va="bottom" if y < 0.5 else "top",
        )  # fmt: skip


def stability(path: Path) -> None:
    """How far float32 is from float64: median, 99.9 % and largest of each kind of number of each rung."""
    effects = json.loads(path.read_text(encoding="utf-8"))["effects"]
    rungs = [rung for found in effects.values() for rung in found["records"]]
    rows = [(f"{rung['effect']}: {rung['rung']}, {one['of']}", one) for rung in rungs for one in rung["followed"]]
    rows = [(label, one) for label, one in rows if one["count"]]
    high = math.ceil(len(rows) / COLUMNS)
    figure = Figure(figsize=(7.0 * COLUMNS, 1.5 + 0.2 * high), layout="constrained")
    for column, axes in enumerate(figure.subplots(1, COLUMNS, sharex=True, squeeze=False)[0]):
        _stability_column(axes, rows[column * high : (column + 1) * high])
        axes.axvline(max(found["allowed"] for found in effects.values()), color="red", linestyle=":", label=ALLOWED)
        axes.set_ylim(high - 0.5, -0.5)
    figure.supxlabel("relative error of float32 against float64")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=5, fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=100)


def _stability_column(axes: Axes, rows: Sequence[tuple[str, dict[str, Any]]]) -> None:
    for name, marker in (("median", "|"), ("most", "o"), ("largest", "x")):
        # What is exactly right stands at the left border.
        errors = [max(one[name], 1e-9) for _, one in rows]
        axes.plot(errors, range(len(rows)), marker, label={"most": "99.9 % are nearer"}.get(name, name))
    axes.axvline(2.0**-24, color="0.7", label="rounding of float32")
    axes.set(xscale="log")
    axes.set_yticks(range(len(rows)), [label for label, _ in rows], fontsize="small")
    axes.grid(axis="y", alpha=0.2)


def pruning(path: Path) -> None:
    """Time of whole and pruned scenes, in that of code written for each by hand."""
    content = json.loads(path.read_text(encoding="utf-8"))
    rows = content["records"]
    places = list(range(len(rows)))
    figure = Figure(figsize=(9.0, 1.5 + 0.4 * len(rows)), layout="constrained")
    axes = figure.subplots()
    ratios = [row["to_minimum"] for row in rows]
    whole = [ratio["median"] * row["to_whole"]["median"] for ratio, row in zip(ratios, rows, strict=True)]
    whiskers = [[abs(ratio[side] - ratio["median"]) for ratio in ratios] for side in ("lower", "upper")]
    axes.plot(whole, places, "s", color="0.6", label="whole scene")
    axes.errorbar([ratio["median"] for ratio in ratios], places, xerr=whiskers, fmt="o", capsize=3.0, label="pruned")
    axes.axvline(content["dearest"], color="red", linestyle=":", label="allowed for the pruned one")
    axes.set(
        yticks=places,
        yticklabels=[row["scene"] for row in rows],
        xscale="log",
        xlabel="time over that of the minimum written by hand",
    )
    axes.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=5, fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=120)


def automatic_mask(path: Path) -> None:
    """Errors of fits without help over those with mask and sun, beside the overlap of the masks."""
    rows = json.loads(path.read_text(encoding="utf-8"))["records"]
    places = range(len(rows))
    figure = Figure(figsize=(9.0, 1.5 + 0.3 * len(rows)), layout="constrained")
    errors, overlap = figure.subplots(1, 2, sharey=True)
    errors.barh(places, [row["ratio"] for row in rows])
    errors.axvline(MUST_BE_NEAR, color="red", linestyle=":", label="largest allowed")
    errors.set(
        yticks=list(places),
        yticklabels=[row["photo"] for row in rows],
        xlabel="E3 without help / with mask and sun",
    )
    errors.legend(fontsize="small")
    overlap.barh(places, [row["fair_iou"] for row in rows])
    overlap.set(xlim=(0.0, 1.0), xlabel="intersection of masks / union")
    errors.invert_yaxis()
    figure.savefig(path.with_suffix(".png"), dpi=120)


def masks(shown: Mapping[str, tuple[Picture, Mask, Mask]], path: Path) -> None:
    """Sheet of the upper halves of photos with given and found masks over them, beside an experiment's JSON."""
    lines = math.ceil(len(shown) / 2)
    figure = Figure(figsize=(12.0, 0.4 + 1.9 * lines), layout="constrained")
    axes = figure.subplots(lines, 2, squeeze=False)
    for place in axes.flat:
        place.set_axis_off()
    for place, (name, (photo, given, found)) in zip(axes.flat, shown.items(), strict=False):
        tint = np.zeros_like(photo)
        tint[given & found], tint[found & ~given], tint[given & ~found] = (0, 1, 0), (1, 0, 1), (1, 0.5, 0)
        share = np.where(given | found, 0.35, 0.0)[..., None]
        upper = slice(0, len(photo) // 2 + len(photo) // 20)
        place.imshow(((1.0 - share) * photo + share * tint)[upper])
        place.set_title(name, fontsize="small")
    figure.suptitle("green: in both masks; magenta: found only; orange: given only", fontsize="small")
    figure.savefig(path.with_name("automatic_masks.png"), dpi=80)
    figure.savefig(path.with_suffix(".png"), dpi=120)


def fog_scale_heights(path: Path) -> None:
    """Error of scattered light against the haze's scale height, for rays of 10 km, by amount of haze and way."""
    content = json.loads(path.read_text(encoding="utf-8"))
    rows = [row for row in content["records"] if row["length"] == 1e4]
    suns = sorted({row["sun_degrees"] for row in rows})
    hazes = sorted({row["haze"] for row in rows})
    ways = [name for name in rows[0] if name.endswith(", light")]
    figure = Figure(figsize=(3.2 * len(hazes), 3.0 * len(suns)), layout="constrained")
    panels = figure.subplots(len(suns), len(hazes), sharex=True, sharey=True, squeeze=False)
    for panel, (sun, haze) in zip(panels.flat, [(s, h) for s in suns for h in hazes], strict=True):
        drawn = [row for row in rows if row["sun_degrees"] == sun and row["haze"] == haze]
        for way in ways:
            heights = [row["scale_height"] for row in drawn]
            panel.plot(heights, [max(row[way], 1e-6) for row in drawn], marker="o", label=way.removesuffix(", light"))
        panel.set(xscale="log", yscale="log", title=f"haze × {haze:g}, sun at {sun:g} degrees")
    figure.supxlabel("scale height of the haze [m]; the air's is 8000 m")
    figure.supylabel("largest error of scattered light, of the brightest")
    figure.legend(*panels.flat[0].get_legend_handles_labels(), loc="outside upper center", ncols=4, fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=120)


def fog_fits(path: Path) -> None:
    """Intervals of 95 % of every fit of a fog, over what is true: a panel for each number and way of fitting."""
    fits = json.loads(path.read_text(encoding="utf-8"))["fits"]
    names = list(dict.fromkeys(one["name"] for one in fits))
    ways = list(dict.fromkeys((one["picture"], one["with_clear"]) for one in fits))
    figure = Figure(figsize=(3.6 * len(ways), 3.2 * len(names)), layout="constrained")
    panels = figure.subplots(len(names), len(ways), squeeze=False)
    for panel, (name, way) in zip(panels.flat, [(name, way) for name in names for way in ways], strict=True):
        drawn = [one for one in fits if (one["name"], one["picture"], one["with_clear"]) == (name, *way)]
        scenes = list(dict.fromkeys(one["scene"] for one in drawn))
        for index, scene in enumerate(scenes):
            same = [one for one in drawn if one["scene"] == scene]
            places = index + (np.arange(len(same)) + 1.0) / (len(same) + 1.0) - 0.5
            spread = [100.0 * 1.96 * (one["standard_error"] or math.nan) for one in same]
            panel.errorbar(places, [100.0 * one["error"] for one in same], yerr=spread, fmt=".", linewidth=0.8)
        panel.axhline(0.0, color="black", linewidth=0.8)
        panel.set_xticks(range(len(scenes)), scenes)
        panel.set(title=f"{way[0]}, {'with' if way[1] else 'without'} clear", ylabel=f"error of {name} [%]")
    figure.savefig(path.with_suffix(".png"), dpi=120)


def day_panoramas(path: Path) -> None:
    """Curves of a day with their intervals, each photo's own estimate, and what clean panoramas give."""
    content = json.loads(path.read_text(encoding="utf-8"))
    names = [row["name"] for row in content["records"]]
    figure = Figure(figsize=(10.0, 2.4 * max(len(names), 1)), layout="constrained")
    for axes, name in zip(figure.subplots(max(len(names), 1), squeeze=False)[:, 0], names, strict=False):
        curve = content["curves"][name]
        axes.fill_between(curve["hours"], curve["low"], curve["high"], alpha=0.25, label="curve ± standard error")
        axes.plot(curve["hours"], curve["values"])
        axes.plot(curve["keyframes"]["hours"], curve["keyframes"]["values"], "o", mfc="none", label="keyframes")
        for hour, value, weight in content["estimates"][name]:
            axes.plot(hour, value, ".", color="black", alpha=max(weight, 0.2))
        axes.plot(*np.transpose(content["truth"][name]), "x", color="red", label="clean panoramas")
        axes.set(ylabel=name, yscale="log" if name.endswith("SCALE") else "linear")
        axes.tick_params(labelsize="small")
        axes.yaxis.label.set_size("small")
    figure.axes[0].legend(ncols=3, fontsize="small")
    figure.axes[-1].set_xlabel("hour")
    figure.savefig(path.with_suffix(".png"), dpi=100)


def far_fog_conversion(path: Path) -> None:
    """Opacity against distance of far fogs, and dashed of the height fogs fitted to them: a panel for each."""
    content = json.loads(path.read_text(encoding="utf-8"))
    errors = {row["fog"]: row["root_mean_square"] for row in content["far_as_height"]}
    figure = Figure(figsize=(12.0, 1.0 + 2.3 * math.ceil(len(errors) / 4)), layout="constrained")
    panels = figure.subplots(math.ceil(len(errors) / 4), 4, sharex=True, sharey=True, squeeze=False)
    for panel, fog in itertools.zip_longest(panels.flat, errors):
        panel.set_visible(fog is not None)
        for colour, row in enumerate(one for one in content["opacities"] if one["fog"] == fog):
            label = f"{row['elevation_degrees']:g} degrees up"
            panel.plot(row["distance"], row["far"], color=f"C{colour}", label=label)
            panel.plot(row["distance"], row["height"], "--", color=f"C{colour}")
        panel.set(xscale="log", title=f"{fog}: rms {errors.get(fog, 0.0):.3f}")
    figure.supxlabel("distance [m]; dashed: height fog")
    figure.supylabel("opacity of far fog")
    figure.legend(*panels.flat[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=100)
