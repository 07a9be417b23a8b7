import base64
import hashlib
import json
import math
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import OpenImageIO
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffrender.rays import Equirectangular
from diffrender.scene import weather_names
from fit.minimum import Minimum
from fit.report import METERED, NOT_USED, Pictures, measured, number, page
from fit.solution import Fitted, Solution, SunPlace

HOSTILE = "<script>alert(1)</script>\"'&amp; {{ 7 * 7 }} \u202egpj.exr \x00\x1b[31m \udcff"
VISIBLE = "<script>alert(1)</script>\"'&amp; {{ 7 * 7 }} \\u202egpj.exr \\x00\\x1b[31m \\udcff"
WIDTH, HEIGHT = 64, 32
PHOTO, FITTED = (0.6, 0.3, 0.15), (0.15, 0.3, 0.6)


def made_up_parameters():
    """Every name of a weather file: in the middle, at either bound, with a wide, a narrow and no standard error."""
    shares, errors = (0.5, 0.0, 0.3, 0.999, 0.7, 1.0), (0.1, None, None, 0.2, 1e-9, None)
    why = ("searched", "at its lower bound", "not determined by the photo", "searched", "closed form", "given")
    parameters = {}
    for index, (name, known) in enumerate(weather_names().items()):
        share, error = shares[index % 6], errors[index % 6]
        low, high = known.file_bounds
        value = low * (high / low) ** share if known.scale == "log" else low + share * (high - low)
        error = error and error * (value if known.scale == "log" else high - low)
        parameters[name] = Fitted(value, known.file_unit, (low, high), error, error is not None, why[index % 6])
    return parameters


PARAMETERS = made_up_parameters()
CORRELATED = tuple(name for name, fitted in PARAMETERS.items() if fitted.determined)
LADDER = np.arange(len(CORRELATED))
MINIMUM = Minimum(np.zeros(3), 2.0, (9.0, 2.0), converged=True, reason="loss settled", iterations=4, evaluations=5)
SOLUTION = Solution(
    effect="sky", photo="made_up.exr", camera=Equirectangular(WIDTH, HEIGHT), notes=("Read as a whole sphere.",),
    scene=None,  # the report draws nothing
    parameters=PARAMETERS, correlated=CORRELATED, correlation=(-0.95) ** np.abs(LADDER[:, None] - LADDER),
    sun=SunPlace(-8.09, -12.3, "found in the picture", visible=False), gains=(1.02, 0.98, 0.0046),
    used=np.ones((2, 2), bool), pixels={"used": 1000, "masked": 1040, "nonfinite": 3, "negative": 5}, error=0.0163,
    left_out={"height fog": "it changes no used pixel by more than 0.1 %"}, minimum=MINIMUM, solver="least-squares",
    seed=7, seconds={"read": 0.3, "solve": 0.4}, versions={"torch": "2.13.0"},
)  # fmt: skip
# A photo of one colour, a fit of another with nothing below the horizon, the upper right quarter used.
MASK = np.zeros((HEIGHT, WIDTH), bool)
MASK[: HEIGHT // 2, WIDTH // 2 :] = True
PICTURES = Pictures(
    np.full((HEIGHT, WIDTH, 3), PHOTO, np.float32), np.full((HEIGHT, WIDTH, 3), FITTED, np.float32), MASK
)
PICTURES.fitted[HEIGHT // 2 :] = np.nan


class Read(HTMLParser):
    """Elements with their attributes, and the text that a reader sees."""

    def __init__(self, html):
        super().__init__()
        self.elements, self.pieces, self.hidden = [], [], 0
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attributes):
        self.elements.append((tag, dict(attributes)))
        self.hidden += tag in ("style", "script")
        self.pieces += [] if tag in ("strong", "bdi", "abbr") else [" "]

    def handle_endtag(self, tag):
        self.hidden -= tag in ("style", "script")

    def handle_data(self, data):
        self.pieces += [] if self.hidden else [data]

    @property
    def text(self):
        return " ".join("".join(self.pieces).split())

    def all(self, tag):
        return [attributes for name, attributes in self.elements if name == tag]

    def image(self, alt, folder):
        """Pixels of the one image whose alternative text begins so."""
        (source,) = (image["src"] for image in self.all("img") if image["alt"].startswith(alt))
        path = folder / "picture.png"
        path.write_bytes(base64.b64decode(source.removeprefix("data:image/png;base64,"), validate=True))
        return OpenImageIO.ImageBuf(str(path)).get_pixels(OpenImageIO.UINT8)


@pytest.fixture(scope="module")
def report():
    return page(SOLUTION, PICTURES)


def read_page(pictures=PICTURES, **changes):
    return Read(page(replace(SOLUTION, **changes), pictures))


def encoded(linear):
    """sRGB bytes of a linear colour, written apart from the library's."""
    return [round(255 * (12.92 * x if x <= 0.0031308 else 1.055 * min(x, 1.0) ** (1 / 2.4) - 0.055)) for x in linear]


def test_page_reaches_for_nothing_outside_itself(report):
    read = Read(report)
    addresses = [
        value for _, a in read.elements for key, value in a.items() if key in ("src", "href", "action", "data")
    ]
    assert report.startswith("<!DOCTYPE html>")
    assert addresses
    assert all(address.startswith("data:image/png;base64,") for address in addresses)
    assert not re.search(r"//|@import|url\(|srcset|<link|<iframe|<form|<base", re.sub('base64,[^"]*', "", report))


def test_policy_forbids_the_network_and_any_script_but_its_own(report):
    policy = next(m["content"] for m in Read(report).all("meta") if m.get("http-equiv") == "Content-Security-Policy")
    (script,) = re.findall("<script>(.*?)</script>", report, re.DOTALL)
    own = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert (rules["default-src"], rules["img-src"], rules["script-src"]) == ("'none'", "data:", f"'sha256-{own}'")


def test_every_picture_and_drawing_says_what_it_shows(report):
    read = Read(report)
    assert all(image["alt"] for image in read.all("img"))
    assert all(drawing["aria-label"] for drawing in read.all("svg"))
    named = {a["id"] for _, a in read.elements if "id" in a}
    assert all(section["aria-labelledby"] in named for section in read.all("section"))
    assert [slider["aria-label"] for slider in read.all("input") if slider["type"] == "range"]


def test_every_parameter_stands_with_unit_bounds_and_status(report):
    text = Read(report).text
    for name, fitted in PARAMETERS.items():
        value, error = fitted.value, fitted.standard_error
        row = re.search(rf"\b{name} .*?{fitted.why}", text)
        assert row, name
        assert all(end in row[0] for end in map(number, fitted.bounds))
        assert (number(value, 4) if error is None else measured(value, error)) in row[0]
        assert fitted.unit == "1" or fitted.unit.replace("^2", "²") in row[0]


def test_account_of_the_fit_is_complete(report):
    text = Read(report).text
    for fact in [
        "made_up.exr", "Read as a whole sphere", "height fog", "no used pixel", "8.09° below", "12.3° to the left",
        "found in the picture", "1.02", "0.0046", "1000 used", "3 nonfinite", "5 negative", "least-squares, seed 7",
        "torch 2.13.0", "solve 0.4", "E3 = 0.0163", "13 %", "converged after 4 iterations", "loss settled",
    ]:  # fmt: skip
        assert fact in text


def test_hostile_text_stays_text():
    parameters = {name: replace(fitted, why=HOSTILE) for name, fitted in PARAMETERS.items()}
    once = {"photo": HOSTILE, "solver": HOSTILE, "notes": (HOSTILE,), "sun": replace(SOLUTION.sun, how=HOSTILE)}
    named = {HOSTILE: HOSTILE}
    twice = {"left_out": named, "versions": named, "minimum": replace(MINIMUM, reason=HOSTILE)}
    html = page(replace(SOLUTION, parameters=parameters, **once, **twice), PICTURES)
    read = Read(html)
    assert len(read.all("script")) == 1
    assert read.text.count(VISIBLE) >= len(once) + 2 * len(twice) + len(parameters)
    assert {name for _, a in read.elements for name in a if name.startswith("on")} == set()
    html.encode("utf-8")
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u200b-\u200f\u202a-\u202e\u2066-\u2069]", html)


def test_fit_that_did_not_converge_says_so_before_all_else():
    text = read_page(minimum=replace(MINIMUM, converged=False)).text
    assert 0 < text.index("The fit did not converge: loss settled") < text.index("Error of radiance")
    assert "The fit converged" not in text


@pytest.mark.parametrize(("error", "words"), [(0.0, "0 %"), (0.0227, "15 %"), (1.0, "a factor of 2.7")])
def test_error_is_told_as_a_share_or_as_a_factor(error, words):
    assert words in read_page(error=error).text


def bars_of(value, bounds, standard_error, scale):
    """Horizontal places of the dot, and of the ends of the error bar, as shares of the track."""
    name = next(name for name, known in weather_names().items() if known.scale == scale)
    fitted = Fitted(value, "m", bounds, standard_error, standard_error is not None, "searched")
    read = read_page(parameters={name: fitted})
    (track,) = (line for line in read.all("line") if line["class"] == "track")
    low, high = float(track["x1"]), float(track["x2"])
    reach = [line for line in read.all("line") if line["class"] == "reach"]
    dot = next(float(c["cx"]) for c in read.all("circle") if c.get("class", "").startswith("dot"))
    ends = [float(reach[0][end]) for end in ("x1", "x2")] if reach else []
    return [(x - low) / (high - low) for x in (dot, *ends)]


def test_bar_is_drawn_on_the_scale_of_the_parameter():
    assert bars_of(1e-3, (1e-6, 1.0), None, "log") == pytest.approx([0.5], abs=1e-4)
    assert bars_of(0.25, (0.0, 1.0), 0.05, "linear") == pytest.approx([0.25, 0.20, 0.30], abs=1e-4)
    # Ends at the bounds:
    assert bars_of(0.9, (0.0, 1.0), 5.0, "linear") == pytest.approx([0.9, 0.0, 1.0], abs=1e-4)
    assert bars_of(1e-6, (1e-6, 1.0), 1e-3, "log") == pytest.approx([0.0, 0.0, 0.5], abs=1e-3)


@given(st.floats(-1e300, 1e300, allow_subnormal=False), st.integers(2, 8))
def test_number_reads_back_to_its_digits(value, digits):
    assert read_back(number(value, digits)) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - digits), abs=1e-300)


@given(st.floats(-1e12, 1e12), st.floats(1e-9, 1e9))
def test_value_is_rounded_where_its_standard_error_ends(value, error):
    text = measured(value, error)
    power = read_back(text.split(") × ")[1]) if text.startswith("(") else 1.0
    shown, spread = (read_back(part) * power for part in text.split(") × ")[0].lstrip("(").split(" ± "))
    assert spread == pytest.approx(error, rel=0.051)
    assert shown == pytest.approx(value, abs=0.051 * error, rel=1e-9)


def read_back(text):
    """Number of a printed one."""
    plain = text.translate(str.maketrans("−⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "--0123456789"))
    if text[-1].isascii():
        return float(plain)
    mantissa, _, power = plain.rpartition(" × ")
    return float(f"{mantissa or 1}e{power.removeprefix('10')}")


def test_standard_error_has_two_digits():
    assert measured(0.763158, 0.0123) == "0.763 ± 0.012"
    assert measured(0.763158, 0.0996) == "0.76 ± 0.10"
    assert measured(-0.02, 1.3) == "0.0 ± 1.3"
    assert measured(2.0, 0.0) == "2"
    assert measured(math.nan, 1.0) == number(math.inf) == "not finite"


def test_metered_exposure_puts_the_median_of_used_pixels_in_the_middle(report, tmp_path):
    gain = METERED / 0.3
    for label, stops in (("2 stops darker", -2), ("metered", 0), ("2 stops brighter", 2)):
        photo = Read(report).image(f"The photo made_up.exr, {label}", tmp_path)
        assert photo.shape == (HEIGHT, WIDTH, 3)
        assert photo[0, 0].tolist() == photo[-1, -1].tolist() == encoded([gain * 2.0**stops * x for x in PHOTO])
    fitted = Read(report).image("The fitted sky, metered", tmp_path)
    assert fitted[0, 0].tolist() == [*encoded([gain * x for x in FITTED]), 255]
    assert (fitted[HEIGHT // 2 :, :, 3] == 0).all()  # transparent where the model draws nothing


def test_pictures_come_through_png_unchanged(tmp_path):
    grain = np.random.default_rng(3).lognormal(size=(HEIGHT, WIDTH, 3)).astype(np.float32)
    pictures = Pictures(grain, grain, np.ones((HEIGHT, WIDTH), bool))
    shown = read_page(pictures).image("The photo made_up.exr, metered", tmp_path)
    expected = [encoded(pixel) for pixel in (grain.astype(float) * METERED / np.median(grain)).reshape(-1, 3)]
    assert np.abs(shown.reshape(-1, 3).astype(int) - expected).max() <= 1  # float32 may round the other way


def test_difference_is_red_where_the_fit_is_brighter_and_grey_where_not_used(tmp_path):
    for factor, strongest in ((2.0, 0), (0.5, 2)):
        read = read_page(replace(PICTURES, fitted=PICTURES.photo * np.float32(factor)))
        difference = read.image("Map of the difference", tmp_path).astype(int)
        assert np.ptp(difference[~MASK], axis=-1).max() == 0
        assert difference[0, -1].argmax() == strongest
        assert np.ptp(difference[0, -1]) > 100
        assert "−1 equal +1 stops" in read.text


def test_equal_pictures_differ_nowhere(tmp_path):
    difference = read_page(replace(PICTURES, fitted=PICTURES.photo)).image("Map", tmp_path).astype(int)
    assert np.ptp(difference[MASK], axis=-1).max() == 0
    assert difference[MASK].min() > difference[~MASK].max()


def test_mask_tints_what_was_not_used(report, tmp_path):
    shown = Read(report).image("The photo with the pixels", tmp_path).astype(int)
    colour = encoded([METERED / 0.3 * x for x in PHOTO])
    assert shown[0, -1].tolist() == colour
    assert np.abs(shown[0, 0] - NOT_USED).sum() < np.abs(np.subtract(colour, NOT_USED)).sum() / 2
    assert "25 % of the pixels were used" in Read(report).text


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf, -1.0, 3e38, 0.0])
def test_broken_pixels_of_the_photo_break_nothing(broken):
    photo = PICTURES.photo.copy()
    photo[1, [1, -1]] = broken
    photo.flags.writeable = False
    assert "</html>" in page(SOLUTION, replace(PICTURES, photo=photo))


def test_photo_without_a_used_or_lit_pixel_still_has_a_page():
    assert "</html>" in page(SOLUTION, replace(PICTURES, mask=np.zeros_like(MASK)))
    assert "</html>" in page(SOLUTION, replace(PICTURES, photo=np.zeros_like(PICTURES.photo)))


def test_matrix_names_pairs_that_stand_in_for_each_other(report):
    text = Read(report).text
    assert f"{CORRELATED[0]} and {CORRELATED[1]} can stand in for each other (correlation −0.95)" in text
    assert text.count("+1.00") == len(CORRELATED)


def test_matrix_without_strong_pairs_or_without_pairs_says_so():
    pair = ("EXPOSURE", "SUN_AZIMUTH")
    assert "no correlation reaches 0.9" in read_page(correlated=pair, correlation=np.eye(2)).text
    assert "–" in read_page(correlated=pair, correlation=np.full((2, 2), np.nan)).text
    assert "nothing to correlate" in read_page(correlated=(), correlation=np.zeros((0, 0))).text


def plot_of(history):
    """Places of the dots, the line of the best so far, and the page."""
    read = read_page(minimum=replace(MINIMUM, history=history))
    dots = [(float(c["cx"]), float(c["cy"])) for c in read.all("circle") if "class" not in c]
    (best,) = [p["d"] for p in read.all("path") if p.get("class") == "best"] or [""]
    return dots, best, read


def test_equal_ratios_of_loss_are_equal_steps_of_the_plot():
    steps = np.diff(plot_of((1000.0, 100.0, 10.0, 1.0))[0], axis=0)
    assert steps == pytest.approx(np.broadcast_to(steps[0], steps.shape), abs=0.11)
    assert (steps > 0).all()


def test_best_so_far_never_rises():
    heights = [float(y) for y in re.findall(r"[V ]([\d.]+)", plot_of((50.0, 90.0, 20.0, 30.0, 5.0))[1])]
    assert heights == sorted(set(heights))
    assert len(heights) == 3


@pytest.mark.parametrize("history", [(3.0,), (3.0, 3.0), (1e-200, 1e200), (5.0, 0.0), (1.0, 1.0 + 1e-12)])
def test_plot_stays_inside_its_frame(history):
    dots, best, _ = plot_of(history)
    assert best
    assert all(64 <= x <= 432 and 10 <= y <= 200 for x, y in dots)


def test_evaluations_without_a_loss_are_counted():
    assert "2 evaluations had no finite positive loss" in plot_of((math.inf, 4.0, math.nan, 2.0))[2].text
    assert "No evaluation gave a finite positive loss" in plot_of((math.nan,))[2].text


def test_long_history_does_not_swell_the_page():
    dots, best, _ = plot_of(tuple(1.0 + 1.0 / (i + 1) for i in range(50_000)))
    assert max(len(dots), best.count("V")) <= 1000


CHROMIUM = shutil.which("chromium")
MEASURE = """addEventListener("load", () => {
  const box = e => { const r = e.getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; };
  const shown = [...document.querySelectorAll("img")].filter(e => e.offsetParent);
  parent.postMessage(JSON.stringify({
    stage: box(document.querySelector(".stage")), images: shown.map(box), loaded: shown.map(e => e.naturalWidth),
    width: innerWidth, content: document.documentElement.scrollWidth,
  }), "*");
});"""
# A headless window lays out 500 pixels wide at least; a frame may be as narrow as a phone.
FRAME = """<body style="margin:0"><iframe src="page.html" style="border:0;width:WIDTHpx;height:1000px"></iframe>
<script>addEventListener("message", e => { document.body.dataset.seen = e.data; });</script>"""


def seen_in_chromium(html, folder, width, scheme):
    """Screenshot of a page in a frame of some width, and what a script inside it measured."""
    allowed = base64.b64encode(hashlib.sha256(MEASURE.encode()).digest()).decode()
    html = html.replace("script-src ", f"script-src 'sha256-{allowed}' ") + f"<script>{MEASURE}</script>"
    (folder / "page.html").write_text(html, "utf-8")
    (folder / "frame.html").write_text(FRAME.replace("WIDTH", str(width)), "utf-8")
    command = [
        CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--dump-dom",
        "--disable-background-networking", "--disable-component-update", "--disable-sync", "--window-size=1200,1000",
        f"--user-data-dir={folder / 'profile'}", f"--screenshot={folder / 'shot.png'}",
        f"--blink-settings=preferredColorScheme={['dark', 'light'].index(scheme)}", (folder / "frame.html").as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, check=True, capture_output=True, text=True, timeout=100)
    (frame,) = Read(done.stdout).all("body")
    shot = OpenImageIO.ImageBuf(str(folder / "shot.png")).get_pixels(OpenImageIO.UINT8)[..., :3]
    return shot, json.loads(frame["data-seen"])


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")
@pytest.mark.parametrize(("width", "scheme"), [(1180, "light"), (400, "dark")])
def test_slider_parts_photo_and_fit_in_a_browser(report, tmp_path, width, scheme):
    shot, seen = seen_in_chromium(report.replace('value="50"', 'value="25"'), tmp_path, width, scheme)
    assert seen["content"] <= seen["width"] == width
    assert seen["loaded"] == [WIDTH, WIDTH, WIDTH, WIDTH // 2]  # fit, photo, difference, mask
    left, top, wide, high = seen["stage"]
    assert wide > 0.85 * min(width, 1120) - 20
    assert wide / high == pytest.approx(WIDTH / HEIGHT, rel=0.01)
    assert seen["images"][:2] == [seen["stage"]] * 2

    def colour(across, down):
        return shot[int(top + down * high), int(left + across * wide)].tolist()

    photo, fitted = (encoded([METERED / 0.3 * x for x in colour]) for colour in (PHOTO, FITTED))
    for across in (0.05, 0.15, 0.24):
        assert colour(across, 0.3) == colour(across, 0.9) == photo
    for across in (0.26, 0.5, 0.95):
        assert colour(across, 0.3) == fitted
        assert colour(across, 0.9) not in (photo, fitted)
    assert (shot[2, 2].mean() < 60) == (scheme == "dark")
