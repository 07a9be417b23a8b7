import json

import pytest

from experiments import wind, wind_scene


@pytest.mark.slow
def test_wind_is_measured_and_drawn(tmp_path, capsys):
    wind.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "wind.json").read_text())
    for kind, rounding in (("float32", 1e-5), ("float64", 1e-13)):
        lengths = content["largest_relative_change_of_length"][kind]
        assert list(lengths) == ["stems", "banner", "hair"]
        assert max(lengths.values()) < rounding
    leans = [row["degrees"] for row in content["mean_lean"]]
    assert leans[0] == 0.0
    assert leans == sorted(set(leans))
    assert 80.0 < leans[-1] < 90.0
    coarse, fine = (row["metres"] for row in content["displacement_beside_integral"])
    assert fine < coarse < 0.02
    assert (tmp_path / "wind.png").stat().st_size > 1000
    assert "mean lean in degrees" in capsys.readouterr().out


def test_the_gust_passes_the_shown_meadow_from_left_to_right():
    land = wind_scene.meadow(2000, near=6.0, far=14.0)
    is_seen = land.root[:, 0].abs() < 5.0
    middles = []
    for seconds in wind.MEADOW_TIMES:
        pressed = (wind_scene.blown(land, wind_scene.meadow_wind(), seconds) - land.grown).norm(dim=-1)[is_seen]
        middles.append(float((pressed * land.root[is_seen, 0]).sum() / pressed.sum()))
    assert middles == sorted(middles)
    assert middles[0] < -1.0
    assert middles[-1] > 1.0


def test_banner_and_hair_stream_with_the_wind():
    for hung in (wind_scene.banner(3, 6), wind_scene.hair(4, 6)):
        chains = wind_scene.swung(hung, wind_scene.close_wind(), 1.2, 30)
        first, last = (chain.joint[:, -1].mean(0) for chain in (chains[0], chains[-1]))
        assert float(last[0] - first[0]) > 0.1
        assert float(last[2] - first[2]) > 0.05
