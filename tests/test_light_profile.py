import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from diffrender.shading import light_profile
from diffrender.shading.light_profile import Profile
from fit import ies
from fit.input_error import InputError

HEAD = "IESNA:LM-63-2002\n[TEST] by formula\n[MANUFAC] no\n[MORE] body\nTILT=NONE\n"


def lamp(intensity, vertical, horizontal, **changes):
    """Text of a file of a lamp whose intensity is a function of both angles [degrees]."""
    told = {"head": HEAD, "lumens": 1000, "multiplier": 1, "type": 1, "ballast": 1} | changes
    down, turn = np.deg2rad(vertical), np.deg2rad(horizontal)
    rows = [" ".join(f"{intensity(down, one)[row]:.9g}" for row in range(len(down))) for one in turn]
    numbers = [
        f"1 {told['lumens']} {told['multiplier']} {len(vertical)} {len(horizontal)} {told['type']} 2 0 0 0",
        f"{told['ballast']} 1 20",
        " ".join(map(str, vertical)),
        " ".join(map(str, horizontal)),
    ]
    return told["head"] + "\r\n".join(numbers + rows) + "\n"


def read(tmp_path, text):
    path = tmp_path / "lamp.ies"
    path.write_bytes(text.encode("latin-1"))
    return ies.read(path)


def constant(down, turn):
    return np.ones_like(down) + 0.0 * turn


def cosine(down, turn):
    return np.cos(down).clip(0.0) + 0.0 * turn


def beam(down, turn):
    return 800.0 * np.cos(down).clip(0.0) ** 8 + 0.0 * turn


def batwing(down, turn):  # alike in quadrants
    return 100.0 * np.sin(down) ** 2 * (1.0 + np.cos(2.0 * turn))


def one_sided(down, turn):  # alike to both sides of the plane of 0 and 180 degrees
    return 50.0 * (1.0 + np.sin(down) * np.cos(turn))


def turned(down, turn):  # alike to no sides
    return 50.0 * (1.0 + 0.5 * np.sin(down) * (np.cos(turn) + np.sin(turn)))


WHOLE, LOWER = list(range(0, 181, 5)), [0, 2.5, *range(5, 91, 5)]
# What is bilinear between its angles has the flux of the formula but for their steps.
FLUXES = {
    "even, round": (constant, WHOLE, [0], 4.0 * math.pi),
    "even, lower half": (constant, [0, 45, 90], [0], 2.0 * math.pi),
    "even, upper half": (constant, [90, 100, 180], [0], 2.0 * math.pi),
    "cosine, round": (cosine, LOWER, [0], math.pi),
    "beam, round": (beam, list(range(0, 91, 2)), [0], 800.0 * 2.0 * math.pi / 9.0),
    "batwing, quadrant": (batwing, WHOLE, list(range(0, 91, 10)), 100.0 * 8.0 * math.pi / 3.0),
    "to one side, bilateral": (one_sided, WHOLE, list(range(0, 181, 15)), 50.0 * 4.0 * math.pi),
    "turned, whole circle": (turned, WHOLE, list(range(0, 361, 15)), 50.0 * 4.0 * math.pi),
}


@pytest.mark.parametrize("name", FLUXES)
def test_flux_of_a_file_is_that_of_its_formula(name, tmp_path):
    intensity, vertical, horizontal, lumens = FLUXES[name]
    found = read(tmp_path, lamp(intensity, vertical, horizontal, lumens=lumens))
    assert float(light_profile.flux(found.profile)) == pytest.approx(lumens, rel=5e-3)
    assert found.lumens == pytest.approx(lumens)


@pytest.mark.parametrize("name", FLUXES)
def test_profile_follows_the_formula_all_round(name, tmp_path):
    intensity, vertical, horizontal, _ = FLUXES[name]
    profile = read(tmp_path, lamp(intensity, vertical, horizontal)).profile
    draw = torch.Generator().manual_seed(0)
    along = torch.nn.functional.normalize(torch.randn(500, 3, generator=draw, dtype=torch.float64), dim=-1)
    down, turn = torch.acos(along[:, 2]), torch.atan2(along[:, 1], along[:, 0])
    wanted = torch.from_numpy(intensity(down.numpy(), turn.numpy()))
    is_measured = (down >= math.radians(vertical[0])) & (down <= math.radians(vertical[-1]))
    found = light_profile.intensity_towards(profile, along)
    assert ((found - wanted)[is_measured].abs() / wanted.max()).max() < 0.02  # chords of arcs of 15 degrees
    assert (found[~is_measured] == 0.0).all()


def test_flux_is_the_integral_of_what_is_looked_up():
    draw = torch.Generator().manual_seed(0)
    vertical = torch.tensor([0.0, 0.3, 0.35, 1.2, 1.9]).double()
    horizontal = torch.tensor([0.0, 1.0, 1.5, 4.0, 2.0 * math.pi]).double()
    profile = Profile(vertical, horizontal, torch.rand(5, 5, generator=draw, dtype=torch.float64))
    count = 1200
    down, turn = ((torch.arange(count, dtype=torch.float64) + 0.5) * (end / count) for end in (math.pi, 2.0 * math.pi))
    down, turn = torch.meshgrid(down, turn, indexing="ij")
    along = torch.stack([down.sin() * turn.cos(), down.sin() * turn.sin(), down.cos()], -1)
    summed = (light_profile.intensity_towards(profile, along) * down.sin()).sum() * 2.0 * (math.pi / count) ** 2
    torch.testing.assert_close(light_profile.flux(profile), summed, rtol=2e-3, atol=0.0)


def test_even_steps_are_the_same_lamp_where_they_meet_its_angles(tmp_path):
    profile = read(tmp_path, lamp(batwing, LOWER, list(range(0, 91, 10)))).profile
    table = light_profile.even([profile], 73, 37)
    draw = torch.Generator().manual_seed(0)
    along = torch.randn(300, 3, generator=draw, dtype=torch.float64)
    which = torch.zeros(300, dtype=torch.long)
    wanted = light_profile.intensity_towards(profile, along)
    torch.testing.assert_close(light_profile.intensity_of(table, which, along), wanted)
    assert (light_profile.intensity_of(table, which - 1, along) == 1.0).all()


def test_gradient_of_the_direction_is_that_of_the_cell_and_finite_on_the_axis(tmp_path):
    profile = read(tmp_path, lamp(turned, WHOLE, list(range(0, 361, 15)))).profile
    table = light_profile.even([profile], 37, 25)
    draw = torch.Generator().manual_seed(0)
    along = torch.randn(6, 3, generator=draw, dtype=torch.float64).requires_grad_()

    def look_up(one):
        return light_profile.intensity_of(table, torch.zeros(6, dtype=torch.long), one)

    assert torch.autograd.gradcheck(look_up, along, check_forward_ad=True)
    axis = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], dtype=torch.float64, requires_grad=True)
    light_profile.intensity_towards(profile, axis).sum().backward()
    assert axis.grad.isfinite().all()


def test_multiplier_and_ballast_scale_the_intensity(tmp_path):
    plain = read(tmp_path, lamp(cosine, LOWER, [0])).profile
    scaled = read(tmp_path, lamp(cosine, LOWER, [0], multiplier=2.5, ballast=0.8, lumens=-1))
    torch.testing.assert_close(scaled.profile.intensity, 2.0 * plain.intensity)
    assert scaled.lumens is None
    assert scaled.keywords == {"TEST": "by formula", "MANUFAC": "no body"}


@pytest.mark.parametrize(
    "head",
    [
        "TILT=NONE\n",
        "IESNA91\nTILT=NONE\n",
        "IESNA:LM-63-1995\n[TEST] é\n TILT = NONE\n",
        "IES:LM-63-2019\nTILT=NONE\n",
    ],
)
def test_all_years_are_read(head, tmp_path):
    text = lamp(cosine, LOWER, [0], head=head)
    assert float(light_profile.flux(read(tmp_path, text).profile)) == pytest.approx(math.pi, rel=5e-3)


@pytest.mark.parametrize(
    ("first", "factor"),
    [
        ("", 0.5),
        ("IESNA:LM-63-1986\n", 0.5),
        ("IESNA91\n", 0.5),
        ("IESNA:LM-63-1995\n", 1.0),
        ("IESNA:LM-63-2002\n", 1.0),
        ("\xef\xbb\xbfIES:LM-63-2019\n", 1.0),
    ],
)
def test_the_second_factor_counts_until_1991(first, factor, tmp_path):
    text = lamp(constant, WHOLE, [0], head=f"{first}TILT=NONE\n").replace("\n1 1 20", "\n1 0.5 20")
    found = float(light_profile.flux(read(tmp_path, text).profile))
    assert found == pytest.approx(4.0 * math.pi * factor, rel=1e-3)


def test_texts_of_dos_and_windows_are_read(tmp_path):
    text = lamp(cosine, LOWER, [0], head="[MANUFAC] Lamps\x85 and more\nTILT=NONE\n").replace("\r\n", "\n")
    plain = read(tmp_path, text)
    for ended in ("\r\n", "\r"):
        found = read(tmp_path, text.replace("\n", ended) + "\x1a")
        assert torch.equal(found.profile.intensity, plain.profile.intensity)
        assert found.keywords == plain.keywords == {"MANUFAC": "Lamps\x85 and more"}


@pytest.mark.parametrize("angles", [list(range(90, 271, 15)), [90, 130, 170, 190, 270], [90, 270]])
def test_half_a_lamp_from_90_to_270_is_mirrored_at_the_plane_of_90(angles, tmp_path):
    def aside(down, turn):  # the same for turn and 180 - turn; linear in the triangle wave between 90 and 270
        return 1.0 + 0.0 * down + 1.0 - abs((np.rad2deg(turn) - 90.0 + 180.0) % 360.0 - 180.0) / 180.0

    found = read(tmp_path, lamp(aside, WHOLE, angles))
    assert found.symmetry == "alike to both sides of the plane of 90 degrees"
    turn = torch.linspace(0.0, 2.0 * math.pi, 73, dtype=torch.float64)
    along = torch.stack([turn.cos(), turn.sin(), torch.zeros_like(turn)], -1)
    wanted = torch.from_numpy(aside(np.zeros(73), turn.numpy()))
    torch.testing.assert_close(light_profile.intensity_towards(found.profile, along), wanted, atol=1e-8, rtol=0.0)
    assert (found.profile.horizontal[0], found.profile.horizontal[-1]) == (0.0, pytest.approx(2.0 * math.pi))
    assert (found.profile.horizontal.diff() > 0.0).all()


GOOD = lamp(cosine, [0, 45, 90], [0, 90])
REFUSED = {
    "no TILT line": (GOOD.replace("TILT=NONE", "TILD=NONE"), "no line that begins with TILT="),
    "tilted": (GOOD.replace("TILT=NONE", "TILT=INCLUDE"), "TILT=INCLUDE; allowed is TILT=NONE"),
    "newer": (GOOD.replace("2002", "2119"), "is of IESNA:LM-63-2119"),
    "newer than 2019": (GOOD.replace("IESNA:LM-63-2002", "IES:LM-63-2025"), "is of IES:LM-63-2025"),
    "another kind of file": ("# weather 1\nTIME_OF_DAY,12\n", "a weather file must not be named .ies"),
    "too bright": (lamp(cosine, [0, 90], [0], multiplier="1e300"), "a peak of 1e+300 candela; allowed are 1e+12"),
    "infinite": (lamp(beam, [0, 90], [0], multiplier="1e308"), "a peak of inf candela"),
    "nothing times infinity": (
        lamp(lambda down, turn: 0.0 * constant(down, turn), [0, 90], [0], multiplier="1e308", ballast="1e308"),
        "a peak of nan candela",
    ),
    "fewer than no lamps": (GOOD.replace("\n1 1000 ", "\n-2 1000 "), "-2 lamps of 1000 lumens"),
    "infinite lumens": (GOOD.replace("\n1 1000 ", "\n1e200 1e200 "), "1e+200 lamps of 1e+200 lumens"),
    "type B": (lamp(cosine, [0, 90], [0], type=2), "type B; allowed is type C"),
    "cut short": (GOOD.rsplit(None, 1)[0], "3 × 2 angles need 24"),
    "too long": (GOOD + " 1", "has 25 numbers"),
    "empty": ("", "no line that begins with"),
    "head only": (HEAD + "1 2 3", "has 3 numbers"),
    "a word": (GOOD + " candela", "'candela' in line"),
    "parted thousands": (GOOD.replace("1 1000 1 ", "1 1_000 1 "), "'1_000' in line 6"),
    "not a number": (GOOD.replace(" 20", " nan"), "'nan' in line 7"),
    "falling angles": (lamp(cosine, [0, 50, 45, 90], [0]), "do not rise"),
    "starts within": (lamp(cosine, [10, 45, 90], [0]), "vertical angles from 10 to 90"),
    "other symmetry": (lamp(cosine, [0, 45, 90], [0, 45]), "horizontal angles from 0 to 45"),
    "half an angle": (GOOD.replace(" 3 2 1 2", " 3.5 2 1 2"), "3.5 vertical angles"),
    "far too many": (GOOD.replace(" 3 2 1 2", " 3e9 2 1 2"), "3e+09 vertical angles"),
    "negative": (lamp(lambda down, turn: -constant(down, turn), [0, 90], [0]), "intensity of -1 candela"),
    "no ballast": (lamp(cosine, [0, 90], [0], ballast=0), "ballast factor of 0"),
    "no second factor": (GOOD.replace(HEAD, "TILT=NONE\n").replace("\n1 1 20", "\n1 0 20"), "a factor of 0"),
    "neither half": (lamp(cosine, [0, 90], [90, 180]), "horizontal angles from 90 to 180"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_other_files_are_refused_in_one_line(name, tmp_path):
    text, told = REFUSED[name]
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_and_a_huge_file_are_refused(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="cannot be read"):
        ies.read(tmp_path / "none.ies")
    monkeypatch.setattr(ies, "LARGEST_BYTES", 10)
    with pytest.raises(InputError, match="more than the allowed 10 bytes"):
        read(tmp_path, GOOD)


def test_profiles_keep_their_number_of_lamps(tmp_path):
    profile = read(tmp_path, GOOD).profile
    both = light_profile.even([profile, replace(profile, intensity=3.0 * profile.intensity)], 19, 5)
    along = torch.tensor([[0.1, 0.2, 0.9]], dtype=torch.float64).expand(2, 3)
    one, three = light_profile.intensity_of(both, torch.tensor([0, 1]), along)
    torch.testing.assert_close(three, 3.0 * one)
