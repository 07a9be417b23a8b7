import json

import pytest

from experiments import materials

# Largest difference of a frame by bytes from the material's own renderer, in its brightest, of small pictures.
ALLOWED = {"car paint": 0.05, "eye": 5e-3, "skin": 1e-2, "hair": 2e-3}


def test_frames_of_all_materials_are_those_of_their_own_renderers_but_for_bytes(tmp_path, capsys):
    materials.main(["--size", "small", "--out", str(tmp_path)])
    assert "car paint" in capsys.readouterr().out
    assert (tmp_path / "materials.png").read_bytes().startswith(b"\x89PNG")
    found = {one["material"]: one for one in json.loads((tmp_path / "materials.json").read_text())["materials"]}
    assert set(found) == {*ALLOWED, "transparent"}
    assert found["transparent"]["largest"] == 0.0  # leaves no bytes
    for name, allowed in ALLOWED.items():
        assert 0.0 < found[name]["largest"] <= allowed
        assert found[name]["median"] <= 5e-3


@pytest.mark.parametrize("name", materials.MATERIALS)
def test_a_forward_pass_adds_to_what_the_deferred_one_leaves(name):
    passes = materials.MATERIALS[name](24, 20)
    assert (passes.frame - passes.deferred).abs().max() > 0.1 * passes.frame.max()
