import json
from types import SimpleNamespace

import pytest
import torch

from diffrender.atmosphere import froxel_lights
from experiments import fit_command, froxel_scene, froxel_time, froxels


@pytest.mark.slow
def test_froxels_are_judged_and_drawn(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(froxels, "FRAMES", 3)
    monkeypatch.setattr(froxels, "SHOWN", 1)
    monkeypatch.setattr(froxels, "STEPS", 200)
    monkeypatch.setattr(froxel_scene, "TEXELS", 64)
    monkeypatch.setattr(froxel_scene, "LAYERS", 16)
    froxels.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "froxels.json").read_text())
    for rows in (content["march"]["grids"], content["height_fog"]):
        coarse, fine = (row["frame"]["root_mean_square"] for row in rows)
        assert fine < coarse < 0.3
    assert (tmp_path / "froxels.png").stat().st_size > 1000
    assert "beside height fog" in capsys.readouterr().out


def test_froxels_are_timed_and_weighed(tmp_path, monkeypatch, capsys):
    peaks = iter([100 * froxel_time.MEBIBYTE, 150 * froxel_time.MEBIBYTE])  # no processes: they take seconds
    monkeypatch.setattr(fit_command, "run_well", lambda _: SimpleNamespace(peak_bytes=next(peaks)))
    monkeypatch.setattr(froxel_scene, "TEXELS", 64)
    froxel_time.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "froxel_time.json").read_text())
    assert content["memory"]["at_most_mebibytes"] == 50.0
    assert all(row["copies"]["median"] > 0.0 for row in content["costs"])
    assert "kept from frame to frame 14 MiB, at most 50 MiB" in capsys.readouterr().out


def test_frames_are_drawn_and_nothing_is_told(monkeypatch, capsys):
    monkeypatch.setattr(froxel_scene, "Grid", lambda: froxels.SMALL)
    monkeypatch.setattr(froxel_scene, "TEXELS", 64)
    froxel_time.main(["--picture", "8x4", "--frames", "1"])
    assert capsys.readouterr().out == ""


def test_the_roof_shadows_the_hall_but_below_its_holes():
    sun = froxel_scene.sun()
    assert sun.shadow is not None
    floor = torch.cartesian_prod(torch.linspace(8.0, 60.0, 60), torch.linspace(-10.0, 10.0, 40))
    on_floor = torch.cat([floor, torch.zeros(len(floor), 1)], -1)
    through = on_floor + sun.to_sun * ((froxel_scene.ROOF + froxel_scene.SHADOW_RISE) / sun.to_sun[2])
    lit, is_open = froxel_lights.visibility(sun.shadow, on_floor), froxel_scene.is_hole(through)
    assert float(lit[is_open].mean()) > 0.8
    assert float(lit[~is_open].mean()) < 0.05
