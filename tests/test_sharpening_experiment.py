import json

import numpy as np
import pytest
import torch

from experiments import sharpening
from fit import sharpening as sharpening_fit
from fit.sampled_photo import Views


def test_haloes_are_what_leaves_the_range_near_a_pixel():
    truth = torch.zeros(1, 6, 6, 3)
    truth[:, :, 3:] = 1.0
    moved = torch.zeros(1, 6, 6, 3)
    moved[:, :, 4:] = 1.0
    assert sharpening.halo(moved, truth) == 0.0
    brighter = truth.clone()
    brighter[0, 0, 5] += 0.5
    darker = 1.0 - brighter
    for picture, right in ((brighter, truth), (darker, 1.0 - truth)):
        assert sharpening.halo(picture, right) == pytest.approx(0.5 / 36.0**0.5)


def test_the_exhaustive_search_finds_the_strength_that_made_the_truth():
    frames = torch.rand(1, 2, 40, 40, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    truth = sharpening.resolved(frames, 0.125, 0.0)
    found = sharpening.exhausted(
        Views(frames, truth, truth, torch.zeros_like(truth[..., :2])), ((0.3,), (0.5,), (0.0, 2.0))
    )
    assert found > 150.0


@pytest.mark.slow
def test_sharpening_is_written_and_drawn(tmp_path, capsys, monkeypatch):
    photos = {path.stem: path for path in sharpening.PHOTOS.glob("blender_*t.exr")}
    monkeypatch.setattr(sharpening, "is_photo", lambda path: path.stem in photos)
    # As little of the search as still ends where the exhaustive one does.
    monkeypatch.setattr(sharpening_fit, "THRESHOLDS", ((0.166, 0.0833), (1.0, 1.0)))
    monkeypatch.setattr(sharpening_fit, "RESPONSES", (0.0,))
    monkeypatch.setattr(sharpening_fit, "BLENDS", (0.0,))
    monkeypatch.setattr(sharpening_fit, "STEPS", (0.2,))
    monkeypatch.setattr(sharpening_fit, "TURNS", 1)
    sharpening.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "sharpening.json").read_text())
    assert {row["photo"] for row in content["alone"]} == set(photos)
    assert all(row["gap"] < 0.02 for row in content["alone"])
    gains = {row["method"]: row["gain"] for row in content["means"]}
    assert gains["average"] == 0.0
    assert gains["fitted"] > 1.0
    assert "catmull-rom" in capsys.readouterr().out
    assert (tmp_path / "sharpening.png").stat().st_size > 1000
    assert np.isfinite([row["fitted"]["halo"] for row in content["alone"]]).all()
