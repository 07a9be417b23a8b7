"""The report of a fit: one self-contained HTML page of pictures, parameters with error bars, and how the fit went."""

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, UInt8

from diffrender.colour import preview
from diffrender.parameters import Specification
from diffrender.scene import weather_names
from fit import png
from fit.page import template
from fit.solution import Fitted, Solution

EXPOSURES = {-2: "2 stops darker", 0: "metered", 2: "2 stops brighter"}
METERED = 0.25  # where the median of the used pixels goes, of 1: skies look as bright as we remember them
REACHES = (0.25, 0.5, 1.0, 2.0, 4.0)  # ends of the residual map's scale [stops]
# Red-blue scale of five colours, safe for colour-blind readers: C. Brewer, M. Harrower, colorbrewer2.org.
DIVERGING = ((33, 102, 172), (146, 197, 222), (247, 247, 247), (244, 165, 130), (178, 24, 43))
NOT_USED = (214, 64, 134)  # tint of what the mask takes away: a hue that neither skies nor landscapes have
SHOWN_LOSSES = 1000  # more points than columns on a screen only make the page larger

Picture = Float[np.ndarray, "height width 3"]


@dataclass(frozen=True)
class Pictures:
    """What the report shows, in linear Rec. 709, already small enough for a page."""

    photo: Picture
    fitted: Picture  # NaN where the model draws nothing
    mask: Bool[np.ndarray, "height width"]  # True where the fit used the photo


def page(solution: Solution, pictures: Pictures) -> str:
    """HTML of the report: needs no other file and no network, and shows whatever text the photo's file held as text."""
    mask = _mask(pictures)
    seen = {
        "size": pictures.mask.shape,
        "fit_has_gaps": bool(np.isnan(pictures.fitted).any()),
        "shots": _shots(pictures),
        "residual": _residual(pictures),
        "mask": mask,
    }
    return _rendered(solution, {"gallery": None, "seen": seen, "used": mask["used"]})


def gallery_page(solution: Solution, crops: Sequence[Mapping[str, UInt8[np.ndarray, "height width 3"]]]) -> str:
    """HTML of the report of a fit that compares methods: crops of the picture by each of them, side by side."""
    gallery = [{method: _data_uri(crop) for method, crop in row.items()} for row in crops]
    share = f"{100.0 * solution.used.mean():.0f} %"
    return _rendered(solution, {"gallery": gallery, "seen": {"shots": []}, "used": share})


def _rendered(solution: Solution, pictures: Mapping[str, Any]) -> str:
    rows = [_row(name, fitted, weather_names()[name]) for name, fitted in solution.parameters.items()]
    return template("report.html").render(
        solution=solution,
        error=_error_in_words(solution.error),
        number=number,
        camera_kind=type(solution.camera).__name__.lower(),
        **pictures,
        determined=[row for row in rows if row.is_determined],
        held=[row for row in rows if not row.is_determined],
        matrix=_matrix(solution),
        strongest=_strongest(solution),
        convergence=_convergence(solution.minimum.history),
    )


# Numbers


def number(value: float, digits: int = 3) -> str:
    """A number with at most so many digits behind its first, as it is printed in a book.

    >>> number(-0.02500), number(8000.0), number(1e-12), number(2.5e7)
    ('−0.025', '8000', '10⁻¹²', '2.5 × 10⁷')
    """
    if not math.isfinite(value):
        return "not finite"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    if value == 0.0 or -4 <= int(exponent) < 6:
        return _trimmed(f"{value:.{max(digits - 1 - int(exponent), 0)}f}").replace("-", "−")
    return f"{_trimmed(mantissa)} × {_power(int(exponent))}".replace("-", "−").removeprefix("1 × ")


def measured(value: float, standard_error: float) -> str:
    """A value and its standard error, which has two digits; the value ends where they do.

    >>> measured(0.763158, 0.01234), measured(3.21e-6, 4e-8), measured(12345.0, 1200.0)
    ('0.763 ± 0.012', '(3.210 ± 0.040) × 10⁻⁶', '12300 ± 1200')
    """
    if not (math.isfinite(value) and math.isfinite(standard_error) and standard_error > 0.0):
        return number(value, 4)
    exponent = math.floor(math.log10(max(abs(value), standard_error)))
    shift = 0 if -4 <= exponent < 6 else exponent
    decimals = 1 + shift - int(f"{standard_error:.1e}".split("e")[1])
    if decimals - shift + exponent > 9:
        return f"{number(value, 10)} ± {number(standard_error, 2)}"
    value, standard_error = (round(x / 10.0**shift, decimals) + 0.0 for x in (value, standard_error))
    text = f"{value:.{max(decimals, 0)}f} ± {standard_error:.{max(decimals, 0)}f}".replace("-", "−")
    return f"({text}) × {_power(shift)}" if shift else text


def _trimmed(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text


def _power(exponent: int) -> str:
    return "10" + str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _error_in_words(error: float) -> str:
    # Errors of logarithms: near 0 they are relative errors, far from it only the factor means something.
    relative = math.sqrt(error)
    return f"{100.0 * relative:.2g} %" if relative < 0.5 else f"a factor of {number(math.exp(relative), 2)}"


# Pictures


def _shots(pictures: Pictures) -> list[dict[str, object]]:
    exposure = _exposure(pictures)
    return [
        {
            "label": label,
            "stops": stops,
            "photo": _data_uri(_tone_mapped(pictures.photo, exposure * 2.0**stops)),
            "fitted": _data_uri(_tone_mapped(pictures.fitted, exposure * 2.0**stops)),
        }
        for stops, label in EXPOSURES.items()
    ]


def _exposure(pictures: Pictures) -> float:
    used = pictures.photo[pictures.mask]
    lit = used[np.isfinite(used) & (used > 0.0)]
    return METERED / float(np.median(lit)) if lit.size else 1.0


def _tone_mapped(picture: Picture, exposure: float) -> UInt8[np.ndarray, "height width channels"]:
    # A fourth channel makes transparent what has no colour.
    missing = np.isnan(picture).any(-1, keepdims=True)
    shown = preview(torch.tensor(np.where(missing, 0.0, picture)), torch.tensor(exposure)).numpy()
    colour = np.rint(255.0 * shown).astype(np.uint8)
    return np.concatenate([colour, np.where(missing, 0, 255).astype(np.uint8)], -1) if missing.any() else colour


def _data_uri(pixels: UInt8[np.ndarray, "height width channels"]) -> str:
    return "data:image/png;base64," + base64.b64encode(png.encoded(pixels)).decode()


def _residual(pictures: Pictures) -> dict[str, object]:
    used = pictures.mask & np.isfinite(pictures.photo).all(-1) & np.isfinite(pictures.fitted).all(-1)
    # Keeps the logarithm of black finite, a thousandth of the middle as in the error of the fit.
    dark = 1e-3 * METERED / _exposure(pictures)
    photo, fitted = (np.maximum(p[used], 0.0) + dark for p in (pictures.photo, pictures.fitted))
    stops = np.log2(fitted / photo).mean(-1)
    middle, most = np.quantile(np.abs(stops), [0.5, 0.98]) if stops.size else (0.0, 0.0)
    reach = next((r for r in REACHES if r >= most), REACHES[-1])
    # Grey stays darker than the middle of the scale, so that "not used" is not read as "equal".
    grey = _tone_mapped(np.nan_to_num(pictures.photo), _exposure(pictures)).mean(-1, keepdims=True)
    colour = np.repeat(90.0 + 0.275 * grey, 3, -1)
    scale = np.linspace(-reach, reach, len(DIVERGING))
    colour[used] = np.stack([np.interp(stops, scale, channel) for channel in np.transpose(DIVERGING)], -1)
    return {
        "uri": _data_uri(np.rint(colour).astype(np.uint8)),
        "middle": number(float(middle), 2),
        "reach": number(reach),
        "colours": DIVERGING,
    }


def _mask(pictures: Pictures) -> dict[str, object]:
    # Every second pixel: it stands in half a column, and the photo at its full size is in the page already.
    photo, mask = pictures.photo[::2, ::2], pictures.mask[::2, ::2]
    colour = _tone_mapped(np.nan_to_num(photo), _exposure(pictures)).astype(np.float64)
    colour[~mask] = 0.4 * colour[~mask] + 0.6 * np.array(NOT_USED)
    return {
        "uri": _data_uri(np.rint(colour).astype(np.uint8)),
        "used": f"{100.0 * pictures.mask.mean():.0f} %",
        "colour": NOT_USED,
    }


# Parameters


@dataclass(frozen=True)
class _Row:
    name: str
    about: str
    text: str
    unit: str
    low: str
    high: str
    scale: str
    place: float  # of the value between the bounds, 0 to 1
    reach: tuple[float, float] | None  # of one standard error to each side, 0 to 1
    is_determined: bool
    why: str


def _row(name: str, fitted: Fitted, specification: Specification) -> _Row:
    low, high = fitted.bounds
    value, error = fitted.value, fitted.standard_error
    ends = [value] if error is None else [value - error, value, value + error]
    places = [_place(end, fitted.bounds, specification.scale) for end in ends]
    return _Row(
        name=name,
        about=specification.about,
        text=number(value, 4) if error is None else measured(value, error),
        unit="" if fitted.unit == "1" else fitted.unit.replace("^2", "²"),
        low=number(low),
        high=number(high),
        scale=specification.scale,
        place=places[len(places) // 2],
        reach=None if error is None else (places[0], places[-1]),
        is_determined=fitted.determined,
        why=fitted.why,
    )


def _place(value: float, bounds: tuple[float, float], scale: str) -> float:
    low, high = bounds
    inside = min(max(value, low), high)
    if scale == "log":
        return math.log(inside / low) / math.log(high / low)
    return (inside - low) / (high - low)


# Correlations


def _matrix(solution: Solution) -> list[tuple[str, list[dict[str, object]]]]:
    def cell(correlation: float, row: int, column: int) -> dict[str, object]:
        return {
            "text": _correlation(correlation),
            "tint": "--warm" if correlation > 0.0 else "--cold",
            "strength": 0.0 if row == column or math.isnan(correlation) else round(abs(correlation), 2),
        }

    return [
        (name, [cell(float(value), row, column) for column, value in enumerate(solution.correlation[row])])
        for row, name in enumerate(solution.correlated)
    ]


def _strongest(solution: Solution) -> list[tuple[str, str, str]]:
    # What a reader should know before trusting either of two parameters.
    rows, columns = np.triu_indices(len(solution.correlated), 1)
    strength = np.abs(solution.correlation[rows, columns])
    order = [k for k in np.argsort(-strength, kind="stable") if strength[k] >= 0.9][:5]
    names = solution.correlated
    return [
        (names[i], names[j], _correlation(float(solution.correlation[i, j])))
        for i, j in zip(rows[order], columns[order], strict=True)
    ]


def _correlation(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:+.2f}".replace("-", "−")


# Convergence


def _convergence(history: Sequence[float]) -> dict[str, object] | None:
    seen = [(i, math.log10(loss)) for i, loss in enumerate(history, 1) if math.isfinite(loss) and loss > 0.0]
    if not seen:
        return None
    lowest = np.minimum.accumulate([math.inf, *(loss for _, loss in seen)]).tolist()
    low, high = lowest[-1], max(loss for _, loss in seen)
    margin = 0.02 + 0.06 * (high - low)
    low, high = low - margin, high + margin

    def place(evaluation: int, loss: float) -> tuple[float, float]:
        return (evaluation - 0.5) / len(history), (high - loss) / (high - low)

    def places(losses: Sequence[tuple[int, float]]) -> list[tuple[float, float]]:
        every = math.ceil(len(losses) / SHOWN_LOSSES)
        return [place(i, loss) for i, loss in losses[::-every][::-1]]  # counted from the end, which must be there

    return {
        "dots": places(seen),
        "best": places([entry for entry, before in zip(seen, lowest, strict=False) if entry[1] < before]),
        "losses": [(place(1, loss)[1], number(10.0**loss)) for loss in _ticks(low, high)],
        "evaluations": [(place(i, low)[0], str(i)) for i in sorted({1, (1 + len(history)) // 2, len(history)})],
        "not_shown": len(history) - len(seen),
        "first": number(10.0 ** seen[0][1]),
        "last": number(10.0 ** lowest[-1]),
    }


def _ticks(low: float, high: float) -> list[float]:
    # In log10: decades, or as many of their parts as it takes to have three.
    decades = range(math.floor(low), math.ceil(high))
    for parts in ((1,), (1, 2, 5), range(1, 10)):
        ticks = [decade + math.log10(part) for decade in decades for part in parts]
        ticks = [tick for tick in ticks if low <= tick <= high]
        if len(ticks) >= 3:
            return ticks[:: math.ceil(len(ticks) / 7)]
    return [low + share * (high - low) for share in (0.1, 0.5, 0.9)]
