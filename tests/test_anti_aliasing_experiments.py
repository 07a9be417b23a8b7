import json

import pytest
import torch

from experiments import aliased_scenes, anti_aliasing, anti_aliasing_time, three_fxaa
from experiments.aliased_scenes import DRIFT, SCENES, Drifting
from fit.photo import read


@pytest.mark.parametrize("name", SCENES)
def test_motion_leads_to_where_the_scene_was(name):
    scene = Drifting(SCENES[name], 256, 144)
    motion = scene.motion(1)[0, 0, 0]
    place = 256.0 * torch.rand(50, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    torch.testing.assert_close(motion, -torch.tensor(DRIFT))
    now, then = scene.at(1)(place - motion), scene.at(0)(place)
    assert float((now - then).abs().mean()) < 1e-3  # rounding may cross an edge


def test_a_scene_looks_the_same_in_a_picture_of_another_size():
    small, large = (Drifting(aliased_scenes.shapes, *size) for size in ((32, 18), (64, 36)))
    blocks = large.supersampled(1, 4).unflatten(0, (18, 2)).unflatten(2, (32, 2)).mean((1, 3))
    torch.testing.assert_close(small.supersampled(1, 8), blocks)


def test_the_truth_has_no_error_and_all_detail():
    truth = torch.rand(3, 20, 24, 3, generator=torch.Generator().manual_seed(0))
    found = anti_aliasing.judged("scene", "truth", truth, truth)
    assert (found.error, found.flicker) == (0.0, 0.0)
    assert (found.detail, found.contrast) == pytest.approx((1.0, 1.0))
    halved = anti_aliasing.judged("scene", "half", truth / 2.0, truth)
    assert (halved.detail, halved.contrast) == pytest.approx((1.0, 0.5))


@pytest.mark.slow
def test_anti_aliasing_writes_its_figures_and_crops(tmp_path, monkeypatch):
    monkeypatch.setattr(anti_aliasing, "ROOT_OF_SAMPLES", 6)
    anti_aliasing.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "anti_aliasing.json").read_text())
    assert len(content["records"]) == len(SCENES) * len(anti_aliasing.METHODS)
    errors = {(row["scene"], row["method"]): row["error"] for row in content["records"]}
    assert all(errors[name, "4 x 4"] < errors[name, "2 x 2"] < errors[name, "none"] for name in SCENES)
    assert (tmp_path / "anti_aliasing.png").stat().st_size > 1000


@pytest.mark.slow
def test_times_are_written_as_ratios(tmp_path, monkeypatch):
    monkeypatch.setattr(anti_aliasing_time.torch, "compile", lambda work, **_: work)  # takes half a minute
    monkeypatch.setattr(anti_aliasing_time, "peak", lambda method, *_: 100 if method == "copy" else 27748)
    anti_aliasing_time.main(["--size", "small", "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "anti_aliasing_time.json").read_text())["records"]
    assert [row["method"] for row in rows] == ["fxaa", "two frames", "checkerboard"]
    assert all(row["eager"]["median"] > 1.0 for row in rows)
    assert rows[0]["eager_pictures"] == 1.0


@pytest.mark.parametrize("method", anti_aliasing_time.METHODS)
def test_one_frame_is_drawn_for_its_memory(method, monkeypatch):
    drawn = []
    monkeypatch.setitem(anti_aliasing_time.METHODS, method, lambda *size: lambda: drawn.append(size))
    anti_aliasing_time.main(["--once", method, "16", "10"])
    assert drawn == [(16, 10)]


def test_ours_with_the_constants_of_three_changes_edges_alone():
    picture = torch.full((12, 16, 3), 0.25)
    picture[4:7, 5:9] = 0.75
    ours = three_fxaa.ours(picture)
    assert float((ours - picture).abs().max()) > 0.1
    assert torch.equal(ours[:2], picture[:2].double())
    found = three_fxaa.compared("square", picture, ours)
    assert (found.apart, found.share, found.pixels) == (0.0, 0.0, 0.0)


def test_the_page_holds_the_pictures_from_the_bottom_up():
    top = torch.zeros(2, 1, 3)
    top[0] = 1.0
    assert '"pictures": ["AAAA//////8="]' in three_fxaa.browser_page([top])


@pytest.mark.slow
def test_pictures_have_eight_bits():
    assert read(three_fxaa.PHOTOS / "blender_forest.exr").camera.height >= three_fxaa.HEIGHT
    for picture in three_fxaa.pictures().values():
        levels = 255.0 * picture
        assert picture.shape == (three_fxaa.HEIGHT, three_fxaa.WIDTH, 3)
        assert float((levels - levels.round()).abs().max()) < 1e-3
