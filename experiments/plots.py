"""Charts of the experiments' JSON files; each is written beside its file."""

import json
from pathlib import Path

from matplotlib.figure import Figure

MUST = 0.45  # largest geometric mean of the errors over those of the better peer
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
