from dataclasses import replace

import pytest
import torch

from diffrender import images
from diffrender.antialiasing import fxaa
from diffrender.antialiasing.edges import PRESETS, Search, Surroundings, edge_strengths, encoded_luma
from diffrender.antialiasing.settings import AntiAliasing
from diffrender.parameters import defaults

DEFAULTS = defaults(AntiAliasing, torch.float64)
GENERATOR = torch.Generator().manual_seed(5)
NOISE = torch.rand(24, 24, 3, generator=GENERATOR, dtype=torch.float64)
CENTRED = torch.zeros(2, dtype=torch.float64)
RENDERERS = [pytest.param(rung.render, id=name) for name, rung in fxaa.EFFECT.rungs.items() if name != "skip"]


def with_(**values):
    return replace(DEFAULTS, **{name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()})


def reader(luma):
    """What gives the brightness at a row and column, bilinear between pixels, clamped at the borders."""
    height, width = luma.shape

    def at(y, x):
        top, left = int(y // 1), int(x // 1)
        rows, columns = (
            [min(max(first + more, 0), size - 1) for more in (0, 1)] for first, size in ((top, height), (left, width))
        )
        upper, lower = (torch.lerp(luma[r, columns[0]], luma[r, columns[1]], x - left) for r in rows)
        return float(torch.lerp(upper, lower, y - top))

    return at


def shader(luma, picture, steps, settings):
    """FXAA 3.11 pixel by pixel, after the shader's text, with our thousandth at ties: no code of what is tested."""
    height, width = luma.shape
    threshold, minimum, subpixel = settings
    at = reader(luma)

    def pixel(y, x):
        m, n, s, w, e = at(y, x), at(y - 1, x), at(y + 1, x), at(y, x - 1), at(y, x + 1)
        brightest = max(m, n, s, w, e)
        contrast = brightest - min(m, n, s, w, e)
        if contrast < max(minimum, brightest * threshold):
            return picture[y, x]
        nw, ne, sw, se = at(y - 1, x - 1), at(y - 1, x + 1), at(y + 1, x - 1), at(y + 1, x + 1)
        horizontal = abs(nw + sw - 2 * w) + 2 * abs(n + s - 2 * m) + abs(ne + se - 2 * e)
        vertical = abs(nw + ne - 2 * n) + 2 * abs(w + e - 2 * m) + abs(sw + se - 2 * s)
        share = min(abs((2 * (n + s + e + w) + nw + ne + sw + se) / 12 - m) / contrast, 1.0)
        share = (share * share * (3 - 2 * share)) ** 2 * subpixel
        is_horizontal = horizontal >= 0.999 * vertical
        first, second = (n, s) if is_horizontal else (w, e)
        sign = -1 if abs(first - m) >= abs(second - m) else 1
        pair = first if sign < 0 else second
        mean, end = (m + pair) / 2, 0.999 * abs(pair - m) / 4
        found = []
        for way in (-1, 1):
            distance, leaving = steps[0], 0.0
            for longer in steps[1:]:
                along = way * distance
                tap = at(y + sign / 2, x + along) if is_horizontal else at(y + along, x + sign / 2)
                leaving = tap - mean
                if abs(leaving) >= end:
                    break
                distance += longer
            found.append((distance, leaving))
        (before, end_before), (after, end_after) = found
        leaving = end_before if before < after else end_after
        if (leaving < 0) != (m - mean < 0):
            share = max(share, 0.5 - min(before, after) / (before + after))
        y_pair, x_pair = (y + sign, x) if is_horizontal else (y, x + sign)
        beyond = picture[min(max(y_pair, 0), height - 1), min(max(x_pair, 0), width - 1)]
        return picture[y, x] + share * (beyond - picture[y, x])

    return torch.stack([torch.stack([pixel(y, x) for x in range(width)]) for y in range(height)])


def slanted(place):
    """White above, black below an edge that falls by one pixel in 16."""
    x, y = place.unbind(-1)
    return (y > 8.3 + x / 16.0).to(place)[..., None].expand(*place.shape[:-1], 3)


@pytest.mark.parametrize("quality", [10, 12, 23, 39])
@pytest.mark.parametrize("scene", ["noise", "edge"])
def test_it_is_the_shader(quality, scene):
    picture = NOISE[:14, :14] if scene == "noise" else slanted(images.places(14, 14, CENTRED)) * NOISE[0, 0]
    given = (DEFAULTS.edge_threshold, DEFAULTS.edge_threshold_minimum, DEFAULTS.subpixel)
    wanted = shader(encoded_luma(picture), picture, PRESETS[quality], [float(value) for value in given])
    found = fxaa.preset(DEFAULTS, picture, quality=quality)
    assert int(((found - wanted).abs() > 1e-12).sum()) == 0
    assert not torch.equal(found, picture)


@pytest.mark.parametrize("render", RENDERERS)
def test_an_even_picture_stays(render):
    even = NOISE[0, 0].expand(9, 11, 3)
    assert torch.equal(render(with_(edge_threshold=0.0, edge_threshold_minimum=0.0), even), even)


@pytest.mark.parametrize("quality", [10, 12, 39])
def test_what_is_below_the_threshold_stays_and_what_is_above_does_not(quality):
    faint = 0.5 + 0.08 * NOISE
    assert torch.equal(fxaa.preset(with_(edge_threshold_minimum=0.09), faint, quality=quality), faint)
    bold = fxaa.preset(with_(edge_threshold_minimum=0.03, edge_threshold=0.03), faint, quality=quality)
    assert float((bold - faint).abs().max()) > 0.01


@pytest.mark.parametrize("slope", [(1.0, 0.0), (0.0, 1.0), (2.0, 3.0), (1.0, -1.0)])
def test_ramps_stay_away_from_borders(slope):
    place = images.places(48, 48, CENTRED)
    ramp = (0.5 + (place - 24.0) @ (0.004 * place.new_tensor(slope)))[..., None].expand(48, 48, 3)
    drawn = fxaa.preset(with_(edge_threshold=0.0, edge_threshold_minimum=0.0), ramp, quality=12)
    torch.testing.assert_close(drawn[10:-10, 10:-10], ramp[10:-10, 10:-10], rtol=1e-12, atol=0.0)


def untied(picture):
    """Pixels whose edge runs in one direction more strongly than in the other."""
    horizontal, vertical = edge_strengths(Surroundings.of(encoded_luma(picture), Search()))
    return (horizontal - vertical).abs() > 0.02


@pytest.mark.parametrize(
    ("turned", "back"),
    [
        pytest.param(lambda p: p.transpose(0, 1), lambda p: p.transpose(0, 1), id="transposed"),
        pytest.param(lambda p: p.rot90(), lambda p: p.rot90(-1), id="turned"),
        pytest.param(lambda p: p.flip(1), lambda p: p.flip(1), id="mirrored"),
    ],
)
def test_it_commutes_with_turning_but_for_ties(turned, back):
    clear = untied(NOISE)
    moved = back(fxaa.render(DEFAULTS, turned(NOISE)))
    torch.testing.assert_close(moved[clear], fxaa.render(DEFAULTS, NOISE)[clear])
    assert 0.8 < float(clear.double().mean()) < 1.0


def test_a_longer_search_comes_nearer_to_the_truth_of_a_slanted_edge():
    aliased = slanted(images.places(96, 24, CENTRED))
    truth = images.supersampled(slanted, 96, 24, 16, CENTRED)

    def error(picture):
        return float((picture - truth)[2:-2, 20:-20].square().mean().sqrt())

    errors = [error(fxaa.preset(with_(subpixel=0.0), aliased, quality=quality)) for quality in (39, 12, 10)]
    assert errors == sorted(errors)
    assert errors[0] < 0.12 * error(aliased)
    # The blend of lone pixels rounds the ends of steps off too far.
    blended = [error(fxaa.render(with_(subpixel=value), aliased)) for value in (0.0, 0.75, 1.0)]
    assert blended == sorted(blended)


def test_soft_decisions_become_hard_ones():
    search, luma, clear = Search(PRESETS[12]), encoded_luma(NOISE), untied(NOISE)
    hard = fxaa.filtered(DEFAULTS, NOISE, luma, search)
    apart = [
        (fxaa.softly_filtered(DEFAULTS, NOISE, luma, search, softness=softness) - hard)[clear].abs().mean().item()
        for softness in (1e-1, 1e-2, 1e-3, 1e-5)
    ]
    assert apart == sorted(apart, reverse=True)
    assert apart[-1] < 1e-3 * apart[0]


def test_gradients_of_a_picture_match_finite_differences():
    picture = NOISE[:8, :8].clone().requires_grad_()
    for render in (fxaa.render, fxaa.soft):
        assert torch.autograd.gradcheck(
            lambda picture, render=render: render(DEFAULTS, picture), picture, check_forward_ad=True, fast_mode=True
        )


def test_thresholds_have_a_gradient_in_the_soft_version_alone():
    settings = with_()
    settings.edge_threshold.requires_grad_()
    (soft,) = torch.autograd.grad(fxaa.soft(settings, NOISE).square().sum(), settings.edge_threshold)
    assert float(soft) != 0.0
    assert not fxaa.render(settings, NOISE).requires_grad  # depends on it by decisions alone


def awkward():
    """Black, a lamp of 400 000 on black, a checker of one pixel, noise over ten decades."""
    black, lamp = torch.zeros(10, 12, 3), torch.zeros(10, 12, 3)
    lamp[5, 6] = 4e5
    checker = ((torch.arange(10)[:, None] + torch.arange(12)) % 2).float()[..., None].expand(10, 12, 3)
    return torch.stack([black, lamp, checker, 10.0 ** (10.0 * torch.rand(10, 12, 3, generator=GENERATOR) - 5.0)])


@pytest.mark.parametrize("render", RENDERERS)
def test_awkward_pictures_have_finite_values_and_gradients(render):
    settings = defaults(AntiAliasing, torch.float32)
    settings.subpixel.requires_grad_()
    picture = awkward().requires_grad_()
    drawn = render(settings, picture)
    found = torch.autograd.grad(drawn.sum(), [picture, settings.subpixel])
    assert all(bool(tensor.isfinite().all()) for tensor in (drawn, *found))
    assert float(drawn.detach().min()) >= 0.0
