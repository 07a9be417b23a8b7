import json
import struct
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from safetensors.torch import save as save_tensors
from scipy.optimize import nnls

from diffrender.atmosphere import sky, sun_axis, two_tables
from diffrender.atmosphere.sky import Sky, SkyView
from diffrender.parameters import defaults
from diffrender.rays import from_angles
from fit import exr, photo_tables, stored_sky, table_fits, tables
from fit.input_error import InputError

pytest_plugins = ["command_fixtures"]

CLEAR = defaults(Sky, torch.float64)
SMALL = sky.Size(rows=6, columns=3, steps=6, heights=3, suns=4, steps_around=3)


def generator():
    return torch.Generator().manual_seed(0)


def test_factors_that_made_a_sky_are_found_again():
    functions = torch.rand(4, 30, 3, 2, dtype=torch.float64, generator=generator()) + 0.1
    truth = torch.rand(4, 3, 2, dtype=torch.float64, generator=generator())
    found = two_tables.least_positive(functions, (functions * truth[:, None]).sum(-1))
    torch.testing.assert_close(found, truth, rtol=1e-9, atol=1e-12)


def test_factors_are_the_nearest_that_are_not_negative():
    functions = torch.rand(20, 6, 3, 2, dtype=torch.float64, generator=generator()) + 0.1
    wanted = torch.rand(20, 6, 3, dtype=torch.float64, generator=generator())
    found = two_tables.least_positive(functions, wanted)
    assert (found == 0.0).any(0).any(0).all()  # either function is left out somewhere
    for row in range(20):
        for channel in range(3):
            best, _ = nnls(functions[row, :, channel].numpy(), wanted[row, :, channel].numpy())
            np.testing.assert_allclose(found[row, channel], best, rtol=1e-6, atol=1e-9)


def test_packaged_tables_are_those_that_the_command_makes():
    chosen = [12, 30, 50]
    elevations = sun_axis.elevations(torch.arange(sun_axis.CELLS, dtype=torch.float64), sun_axis.CELLS)[chosen]
    made = table_fits.from_march(CLEAR, elevations).tables
    for name, table in vars(two_tables.packaged()).items():
        # Rounded to float32, and the least squares of the zenith's nearly equal functions with it.
        torch.testing.assert_close(table[chosen].double(), getattr(made, name), rtol=1e-4, atol=1e-9)


# From photos


def seen_sky(brightness, haziness, sun=0.5):
    """Sample of a sky drawn from the packaged tables, with haze of another brightness and haziness."""
    turn = torch.rand(2, 600, dtype=torch.float64, generator=generator())
    direction = from_angles(0.05 + 1.4 * turn[0], 6.28 * turn[1])
    to_sun = from_angles(*torch.tensor([sun, 0.0], dtype=torch.float64))
    view = SkyView(direction, to_sun, torch.ones(3, dtype=torch.float64), torch.tensor(2.0, dtype=torch.float64))
    prepared = sky.prepare_two_tables(CLEAR, view)
    bright = replace(prepared, tables=replace(prepared.tables, haze=brightness * prepared.tables.haze))
    of = replace(CLEAR, haziness=torch.tensor(haziness, dtype=torch.float64))
    return photo_tables.SkySample("seen", view, sky.render_two_tables(of, bright))


def test_haze_of_a_photo_is_found():
    found = photo_tables.from_photos([seen_sky(brightness=2.0, haziness=0.7)])
    assert found.haziness == 0.7
    assert found.errors["seen"] < 0.02
    known = two_tables.packaged()
    near, rows = round(float(sun_axis.place(torch.tensor(0.5), sun_axis.CELLS))), slice(12, 19)  # round the sun
    for name, factor in (("air", 1.0), ("haze", 2.0)):
        was, now = (getattr(tables, name)[near, rows].sum() for tables in (known, found.tables))
        assert (now / was).item() == pytest.approx(factor, rel=0.05)


def test_no_entry_of_tables_from_photos_is_negative():
    found = photo_tables.from_photos([seen_sky(brightness=0.0, haziness=0.7)])
    assert all((table >= 0.0).all() for table in vars(found.tables).values())


def test_a_sky_as_packaged_leaves_the_tables_as_they_are():
    found = photo_tables.from_photos([seen_sky(brightness=1.0, haziness=0.76)])
    for name, table in vars(two_tables.packaged()).items():
        torch.testing.assert_close(getattr(found.tables, name).float(), table, rtol=1e-5, atol=1e-12)


# In files


def small_two(count=3, rows=4):
    return two_tables.TwoTables(torch.ones(count, rows, 3), torch.zeros(count, rows, 3), torch.ones(count, 3))


def contents(**changes):
    return {name: table.clone() for name, table in vars(small_two()).items()} | changes


def with_header(header):
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text


BAD = {
    "empty": (b"", "no safetensors"),
    "text": (b"this is no table\n", "no safetensors"),
    "huge header": (struct.pack("<Q", 2**63) + b"{}", "no safetensors"),
    "no JSON": (struct.pack("<Q", 2) + b"[[", "no safetensors"),
    "offsets beyond the end": (
        with_header({"air": {"dtype": "F32", "shape": [2, 2, 3], "data_offsets": [0, 48]}}),
        "no safetensors",
    ),
    "cut off": (save_tensors(contents())[:-4], "no safetensors"),
    "nothing": (save_tensors({}), "holds nothing"),
    "other names": (save_tensors({"weight\n\x1b[31m": torch.ones(3)}), "holds weight"),
    "one more": (save_tensors(contents(more=torch.ones(3))), "more"),
    "double": (save_tensors(contents(cloud=torch.ones(3, 3).double())), "not F32"),
    "flat": (save_tensors(contents(cloud=torch.ones(9))), "cloud as F32 [9]"),
    "unlike": (save_tensors(contents(cloud=torch.ones(4, 3))), "alike in all tables"),
    "one cell": (save_tensors(vars(small_two(1))), "2 to 1024 cells"),
    "no channel": (save_tensors(contents(cloud=torch.ones(3, 0))), "2 to 1024 cells"),
    "NaN": (save_tensors(contents(cloud=torch.full((3, 3), torch.nan))), "entries of cloud"),
    "infinite": (save_tensors(contents(air=torch.full((3, 4, 3), torch.inf))), "entries of air"),
    "negative": (save_tensors(contents(haze=torch.full((3, 4, 3), -1e-9))), "entries of haze"),
}


@pytest.mark.parametrize(("content", "said"), BAD.values(), ids=BAD)
def test_files_that_hold_no_tables_are_refused(tmp_path, content, said):
    (tmp_path / "bad.safetensors").write_bytes(content)
    with pytest.raises(InputError) as refused:
        tables.load(tmp_path / "bad.safetensors")
    assert said in str(refused.value)
    assert "fit tables" in str(refused.value)


def test_missing_files_and_folders_are_refused(tmp_path):
    for path in (tmp_path, tmp_path / "missing.safetensors"):
        with pytest.raises(InputError, match="is no file"):
            tables.load(path)


def test_bytes_changed_anywhere_are_refused_or_give_whole_tables(tmp_path):
    whole, path = save_tensors(vars(small_two())), tmp_path / "changed.safetensors"
    random = np.random.default_rng(0)
    for _ in range(300):
        changed = bytearray(whole)
        for place in random.integers(0, len(whole), 3):
            changed[place] = random.integers(0, 256)
        path.write_bytes(bytes(changed))
        try:
            found = tables.load(path)
        except InputError:
            continue
        assert all(torch.isfinite(table).all() for table in vars(found).values())


def test_tables_come_back_as_they_were_written(tmp_path):
    for whole in (small_two(), stored_sky.stored(CLEAR, torch.tensor([-1.0, 0.3]).double(), SMALL)):
        tables.save(tmp_path / "whole.safetensors", whole, "a test")
        found = tables.load(tmp_path / "whole.safetensors")
        assert type(found) is type(whole)
        for field in fields(whole):
            assert torch.equal(getattr(found, field.name), getattr(whole, field.name).float())


# On the command line


@pytest.fixture
def few_suns(monkeypatch):
    monkeypatch.setattr(sun_axis, "CELLS", 4)


@pytest.fixture(scope="module")
def files(folder):
    """A folder that also holds tables of either form."""
    tables.save(folder / "two.safetensors", two_tables.packaged(), "a test")
    for name, haze in (("clear", 0.5), ("foggy", 10.0)):
        of = replace(CLEAR, mie_scale=torch.tensor(haze, dtype=torch.float64))
        elevations = sun_axis.elevations(torch.arange(6, dtype=torch.float64), 6)
        tables.save(folder / f"{name}.safetensors", stored_sky.stored(of, elevations, SMALL), "a test")
    (folder / "broken.safetensors").write_bytes(b"no tables")
    return folder


@pytest.fixture
def inside(files, monkeypatch):
    """The same folder, as the one the command runs in."""
    monkeypatch.chdir(files)


def drawn(run, folder, tmp_path, *words):
    """Mean of each channel of the picture that a render with these words writes."""
    out = tmp_path / "out.exr"
    words = (*words, "--sun", "30,0", "--size", "64x32", "--out", out)
    assert run("render", folder / "day.csv", *words) == (0, "", "")
    return exr.read(out).radiance.astype(np.float64).mean((0, 1))


def test_a_picture_is_drawn_from_tables_of_either_form_and_between_weathers(run, files, tmp_path):
    two, clear, foggy = (files / f"{name}.safetensors" for name in ("two", "clear", "foggy"))
    assert (drawn(run, files, tmp_path, "--tables", two) > 0.0).all()
    first, half, second = (
        drawn(run, files, tmp_path, "--tables", clear, "--tables", foggy, "--blend", share) for share in (0, 0.5, 1)
    )
    alone = drawn(run, files, tmp_path, "--tables", foggy)
    np.testing.assert_allclose(second, alone, rtol=1e-4)
    assert ((first < half) == (half < second)).all()
    assert not np.allclose(first, second, rtol=0.1)


BAD_RENDER = {
    "no tables in it": (("--tables", "broken.safetensors"), "no safetensors file"),
    "missing": (("--tables", "missing.safetensors"), "is no file"),
    "two without --blend": (("--tables", "clear.safetensors", "--tables", "foggy.safetensors"), "given 2 times"),
    "--blend of one": (("--tables", "clear.safetensors", "--blend", "0.5"), "given 1 times"),
    "--blend of none": (("--blend", "0.5"), "given 0 times"),
    "--blend too large": (("--tables", "clear.safetensors", "--blend", "2"), "--blend"),
    "unlike": (("--tables", "clear.safetensors", "--tables", "two.safetensors", "--blend", "0"), "not of one form"),
}


@pytest.mark.usefixtures("inside")
@pytest.mark.parametrize(("words", "said"), BAD_RENDER.values(), ids=BAD_RENDER)
def test_bad_tables_are_one_line_and_leave_nothing(run, tmp_path, words, said):
    status, out, err = run("render", "day.csv", *words, "--sun", "30,0", "--out", tmp_path / "out.exr")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert not any(tmp_path.iterdir())


BAD_TABLES = {
    "--form": (("--form", "three"), "allowed are two-tables and in-scatter"),
    "masks of nothing": (("--mask-folder", "."), "without photos"),
    "photos and --weather": (("sky.exr", "--weather", "day.csv"), "need no --weather"),
    "in-scatter of photos": (("sky.exr", "--form", "in-scatter"), "--form two-tables"),
    "no photo": (("text.exr",), "neither OpenEXR nor Radiance"),
    "no mask": (("sky.exr", "--mask-folder", "."), "sky.png"),
    "no weather": (("--weather", "broken.csv"), "broken.csv"),
    "weather without sky": (("--weather", "no_sky.csv"), "holds no sky"),
}


@pytest.mark.usefixtures("inside")
@pytest.mark.parametrize(("words", "said"), BAD_TABLES.values(), ids=BAD_TABLES)
def test_bad_input_of_tables_is_one_line_and_leaves_nothing(run, tmp_path, words, said):
    status, out, err = run("tables", *words, "--out", tmp_path / "out.safetensors")
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert not any(tmp_path.iterdir())


@pytest.mark.usefixtures("few_suns")
@pytest.mark.parametrize("form", stored_sky.FORMS)
def test_tables_of_a_weather_are_made_and_told(run, files, tmp_path, form):
    out = tmp_path / "made.safetensors"
    status, told, err = run("tables", "--form", form, "--weather", files / "day.csv", "--out", out)
    assert (status, err) == (0, "")
    assert f"written to {out}" in told
    assert next(iter(vars(tables.load(out)).values())).shape[0] == 4


@pytest.mark.slow
def test_tables_of_photos_are_made_and_told(run, files, tmp_path):
    status, told, err = run("tables", files / "sky.exr", "--out", tmp_path / "made.safetensors")
    assert (status, err) == (0, "")
    assert "SKY_HAZINESS" in told
    assert "sky.exr" in told
    assert isinstance(tables.load(tmp_path / "made.safetensors"), two_tables.TwoTables)
