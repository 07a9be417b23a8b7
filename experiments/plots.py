"""Charts of the experiments' JSON files; each is written beside its file."""

import json
import math
from pathlib import Path

from matplotlib.figure import Figure

MUST = 0.45  # largest geometric mean of the errors over those of the better peer
COVERED = {"within_one": (0.63, 0.73), "within_two": (0.92, 0.97)}  # shares of intervals that are to hold the truth
FEWEST = 30  # intervals below which a share says nothing
MUST_BE_FASTER = 4.0  # least ratio of a peer's solve time to ours


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
    """Error over time, both as powers of ten: a line for each effect, a place for each rung."""
    content = json.loads(path.read_text(encoding="utf-8"))
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    axes = figure.subplots()
    for effect in dict.fromkeys(row["effect"] for row in content["records"]):
        rows = [row for row in content["records"] if row["effect"] == effect]
        drawing = [1e3 * row["times"]["render"]["median"] for row in rows]
        whole = [1e3 * row["times"]["prepare"]["median"] + time for row, time in zip(rows, drawing, strict=True)]
        error = [row["on_examples"]["largest"] for row in rows]
        (line,) = axes.plot(whole, error, marker="o", label=f"{effect}: largest, tables and picture")
        axes.plot(drawing, error, marker="|", linestyle="", color=line.get_color())
        axes.hlines(error, drawing, whole, color=line.get_color(), linewidth=0.8)
        if all(row["on_picture"] for row in rows):
            median = [row["on_picture"]["median"] for row in rows]
            axes.plot(whole, median, marker=".", linestyle=":", color=line.get_color(), label="median on a picture")
        for row, time, height in zip(rows, whole, error, strict=True):
            axes.annotate(row["rung"], (time, height), textcoords="offset points", xytext=(5, 5), fontsize="small")
    width, height = content["size"]["timed"]
    axes.set(
        xscale="log",
        yscale="log",
        xlabel=f"ms for a picture of {width} × {height} on one thread; tick: without what is prepared once",
        ylabel="error in float32 against the reference",
    )
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=120)


def stability(path: Path) -> None:
    """How far float32 is from float64: median, 99.9 % and largest of each kind of number of each rung."""
    content = json.loads(path.read_text(encoding="utf-8"))
    rows = [(rung, one) for rung in content["records"] for one in rung["followed"]]
    places = range(len(rows))
    figure = Figure(figsize=(9.0, 1.5 + 0.25 * len(rows)), layout="constrained")
    axes = figure.subplots()
    for name, marker in (("median", "|"), ("most", "o"), ("largest", "x")):
        # What is exactly right stands at the left border.
        errors = [max(one[name], 1e-9) for _, one in rows]
        axes.plot(errors, list(places), marker, label={"most": "99.9 % are nearer"}.get(name, name))
    axes.axvline(content["allowed"], color="red", linestyle=":", label="allowed for 99.9 %")
    axes.axvline(2.0**-24, color="0.7", label="rounding of float32")
    axes.set(
        yticks=list(places),
        yticklabels=[f"{rung['effect']}: {rung['rung']}, {one['of']}" for rung, one in rows],
        xscale="log",
        xlabel="relative error of float32 against float64",
    )
    axes.invert_yaxis()
    figure.legend(loc="outside upper center", ncols=5, fontsize="small")
    figure.savefig(path.with_suffix(".png"), dpi=120)


def pruning(path: Path) -> None:
    """Time of whole and pruned scenes, in that of code written for each by hand."""
    content = json.loads(path.read_text(encoding="utf-8"))
    rows = content["records"]
    places = list(range(len(rows)))
    figure = Figure(figsize=(9.0, 1.5 + 0.5 * len(rows)), layout="constrained")
    axes = figure.subplots()
    ratios = [row["to_minimum"] for row in rows]
    whole = [ratio["median"] * row["to_whole"]["median"] for ratio, row in zip(ratios, rows, strict=True)]
    whiskers = [[abs(ratio[side] - ratio["median"]) for ratio in ratios] for side in ("lower", "upper")]
    axes.barh([place - 0.2 for place in places], whole, height=0.4, color="0.7", label="whole scene")
    axes.barh(
        [place + 0.2 for place in places],
        [ratio["median"] for ratio in ratios],
        xerr=whiskers,
        height=0.4,
        capsize=3.0,
        label="pruned",
    )
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
