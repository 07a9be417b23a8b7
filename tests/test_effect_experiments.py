import json

import pytest
import torch

from diffrender.catalogue import EFFECTS
from diffrender.effect import Effect, Rung
from diffrender.parameters import defaults, parameter, record
from diffrender.scene import finest, render
from experiments import effect_pictures, effects, error_versus_time, hard_places, pruning, records, stability, timing


@record
class Gain:
    gain: torch.Tensor = parameter(1.0, bounds=(0.5, 2.0), unit="1", about="brightness", scale="log")
    lift: torch.Tensor = parameter(0.0, bounds=(-1.0, 1.0), unit="1", about="darkest value")


def example(dtype):
    return torch.linspace(0.1, 1.0, 5, dtype=dtype)


def effect_of(draw):
    """An effect whose last rung draws so."""

    def skip(gain, seen):
        return seen * 0.0 * gain.gain

    return Effect(
        parameters=Gain,
        prefix="GAIN",
        rungs={"skip": Rung(skip), "drawn": Rung(draw)},
        reference=plain,
        tolerance=1e-6,
        largest_change=lambda gain, seen: (gain.gain * seen + gain.lift).abs().amax(),
        example_inputs=example,
    )


def plain(gain, seen):
    return gain.gain * seen + gain.lift


# effects


def test_an_unknown_effect_is_refused_with_the_known_ones(capsys):
    with pytest.raises(SystemExit):
        effects.ask("", ["moon"])
    assert f"moon is not known here; known: {', '.join(EFFECTS)}" in capsys.readouterr().err


def test_named_effects_come_in_drawing_order():
    first, second = list(EFFECTS)[:2]
    given = effects.ask("", [second, first, "--size", "small"])
    assert (given.names, given.is_small) == ((first, second), True)


def test_corners_are_bounds_or_defaults_and_none_is_missing():
    found = effects.corners(Gain)
    assert len(found) == 3 + 2 * 2
    middle = found["defaults"]
    for name, point in found.items():
        assert ((point == 0.0) | (point == 1.0) | (point == middle)).all(), name
    assert found["GAIN low"].tolist() == [0.0, 0.5]
    assert found["LIFT high"].tolist() == [0.5, 1.0]


def test_scattered_points_are_corners_and_insides_and_the_same_each_time():
    first, second = effects.scattered(Gain, 4), effects.scattered(Gain, 4)
    assert len(first) == 8
    assert all(torch.equal(first[name], second[name]) for name in first)
    for name, point in first.items():
        at_bound = (point == 0.0) | (point == 1.0)
        assert at_bound.all() if name.startswith("corner") else not at_bound.any()


def test_inputs_are_told_of_effects_that_exist():
    assert set(effect_pictures.PICTURES) | set(hard_places.HARD) <= set(EFFECTS)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_without_a_picture_shows_its_examples_again_and_again(name, monkeypatch):
    monkeypatch.setattr(effect_pictures, "PICTURES", {})
    effect = EFFECTS[name]
    cheapest = next(rung for rung in effect.rungs if rung != "skip")
    values = defaults(effect.parameters, torch.float64)
    once, often = (
        effect.rungs[cheapest](values, seen)
        for seen in (effect.example_inputs(torch.float64), effect_pictures.picture_inputs(name, 16, 8))
    )
    assert often.numel() >= 3 * 16 * 8
    torch.testing.assert_close(often[: len(once)], once)


# records


def test_effects_that_were_not_asked_for_keep_their_records(tmp_path, monkeypatch):
    path = tmp_path / "new" / "found.json"
    for name, date in (("c", "monday"), ("a", "tuesday"), ("gone", "tuesday"), ("c", "friday")):
        monkeypatch.setattr(records, "provenance", lambda _, date=date: {"date": date})
        records.write_part(path, name, {"seen": date}, ("a", "b", "c", "gone"))
    records.write_part(path, "a", {"seen": "friday"}, ("a", "b", "c"))
    found = json.loads(path.read_text())["effects"]
    assert list(found.items()) == [(name, {"seen": "friday", "date": "friday"}) for name in ("a", "c")]
    records.write_part(path, "b", {"seen": "never"}, ("a", "b", "c"))
    assert list(json.loads(path.read_text())["effects"]) == ["a", "b", "c"]


# error_versus_time


def test_error_of_the_reference_is_none_and_of_black_is_all():
    truth = torch.tensor([0.0, 1.0, 4.0])
    assert error_versus_time.error(truth, truth) == error_versus_time.Error(0.0, 0.0)
    assert error_versus_time.error(0.0 * truth, truth) == error_versus_time.Error(1.0, 1.0)
    assert error_versus_time.error(truth + torch.tensor([0.4, 0.4, 0.4]), truth).largest == pytest.approx(0.1)


def test_a_black_reference_is_refused():
    with pytest.raises(ValueError, match="give inputs on which the effect draws"):
        error_versus_time.error(torch.ones(3), torch.zeros(3))


def test_ratios_are_to_the_cheapest_rung_that_draws(monkeypatch):
    monkeypatch.setattr(timing, "LEAST_SECONDS", 0.0)
    seconds = iter([1.0, 1.0, 2.0, 3.0, 0.5] * 2)
    monkeypatch.setattr(error_versus_time, "seconds_of", lambda _: next(seconds))
    found = error_versus_time.times(effect_of(plain), example(torch.float32), 1, {})
    assert [one.ratio.median for one in found.values()] == [2.0 / 5.0, 1.0]
    assert [one.copies.median for one in found.values()] == [2.0, 6.0]


def test_how_far_a_compiled_rung_is_from_the_eager_one_is_told(monkeypatch):
    monkeypatch.setattr(error_versus_time.shutil, "which", lambda _: "compiler")
    monkeypatch.setattr(torch, "compile", lambda rung: lambda *given: rung(*given) + 1e-3)
    made = error_versus_time.compiled_rungs(effect_of(plain), example(torch.float32))
    assert (made.renderers.keys(), made.refused) == ({"skip", "drawn"}, {})
    assert made.differences["drawn"] == pytest.approx(1e-3, rel=1e-3)


def test_without_a_compiler_nothing_is_compiled_and_that_is_told(monkeypatch):
    monkeypatch.setattr(error_versus_time.shutil, "which", lambda _: None)
    made = error_versus_time.compiled_rungs(effect_of(plain), example(torch.float32))
    assert made.renderers == {}
    assert "no compiler of" in made.refused["drawn"]


def test_what_compiles_too_long_is_refused(monkeypatch):
    def never(*_):
        while True:
            pass

    monkeypatch.setattr(error_versus_time, "LONGEST", 0.05)
    monkeypatch.setattr(error_versus_time.shutil, "which", lambda _: "compiler")
    monkeypatch.setattr(torch, "compile", lambda _: never)
    made = error_versus_time.compiled_rungs(effect_of(plain), example(torch.float32))
    assert made.refused == dict.fromkeys(("skip", "drawn"), "not compiled within 0.05 s")


@pytest.mark.slow
def test_error_versus_time_writes_every_rung_of_every_effect(tmp_path, capsys):
    error_versus_time.main(["--size", "small", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "error_versus_time.json").read_text())
    rows = [row for found in content["effects"].values() for row in found["records"]]
    told = [(row["effect"], row["rung"]) for row in rows]
    assert told == [(name, rung) for name, effect in EFFECTS.items() for rung in effect.rungs]
    for row in rows:
        assert row["on_examples"]["largest"] <= 1.0 or row["rung"] != "skip"
        if row["rung"] == list(EFFECTS[row["effect"]].rungs)[-1]:
            assert row["on_examples"]["largest"] <= 1.01 * EFFECTS[row["effect"]].tolerance
    assert {found["machine"]["threads"] for found in content["effects"].values()} == {1}
    assert (tmp_path / "error_versus_time.png").stat().st_size > 1000
    assert all(rung in capsys.readouterr().out for rung in ("march",))


# stability


def followed(draw, kind):
    found = stability.swept("gain", effect_of(draw), "drawn", stability.SMALL)
    return next(one for one in found.followed if one.of == kind), [one for one in found.beyond if one.of == kind]


@pytest.fixture(autouse=True)
def gain_among_effects(monkeypatch):
    monkeypatch.setattr(hard_places, "EFFECTS", {**EFFECTS, "gain": effect_of(plain)})


@pytest.mark.parametrize("kind", ["value", "derivative", "gradient"])
def test_a_sum_and_a_product_are_followed_to_a_few_ulps(kind):
    found, beyond = followed(plain, kind)
    assert (found.not_finite, found.within, beyond) == (0, 1.0, [])
    assert found.count > 0
    assert found.largest_ulps < 4.0


def test_what_is_lost_in_between_is_blamed_on_the_arithmetic():
    def cancelling(gain, seen):
        return (gain.gain * seen + 1e4) - 1e4 + gain.lift

    found, beyond = followed(cancelling, "value")
    assert found.within < 1.0
    assert {one.cause for one in beyond} == {stability.ARITHMETIC}


def test_what_the_inputs_do_not_determine_is_blamed_on_them():
    def waving(gain, seen):
        return torch.sin(1e4 * gain.gain * seen) + gain.lift

    found, beyond = followed(waving, "value")
    assert found.within < 1.0
    assert {one.cause for one in beyond} == {stability.INPUTS}


def test_what_is_not_finite_is_counted():
    def rooted(gain, seen):
        return torch.sqrt(seen - seen[0]) * gain.gain + gain.lift

    found, _ = followed(rooted, "gradient")
    assert found.not_finite > 0
    assert followed(rooted, "value")[0].not_finite == 0


def test_stability_writes_every_rung(tmp_path, capsys):
    stability.main(["sun disc", "--size", "small", "--out", str(tmp_path)])
    (found,) = json.loads((tmp_path / "stability.json").read_text())["effects"].values()
    assert [row["rung"] for row in found["records"]] == list(EFFECTS["sun disc"].rungs)
    assert all(one["not_finite"] == 0 for row in found["records"] for one in row["followed"])
    assert (tmp_path / "stability.png").stat().st_size > 1000
    assert "sun disc: limb darkened, value" in capsys.readouterr().out


# pruning


@pytest.mark.parametrize("name", pruning.TASKS)
def test_minimum_and_pruned_scene_are_within_the_tolerance(name):
    task = pruning.TASKS[name]
    scene, direction = task.scene(), effect_pictures.directions(task.camera(16, 8)).float()
    whole = render(scene, direction, finest())
    found = pruning.pruning(name, (16, 8), rounds=1)
    assert found.error <= found.tolerance
    assert float((task.minimum(scene, direction) - whole).abs().max()) <= found.tolerance


def test_pruning_writes_its_choices_with_reasons(tmp_path, capsys):
    pruning.main(["night", "--size", "small", "--out", str(tmp_path)])
    (row,) = json.loads((tmp_path / "pruning.json").read_text())["records"]
    assert [choice["rung"] for choice in row["choices"]] == ["skip", "skip"]
    assert row["to_whole"]["median"] > 10.0
    assert (tmp_path / "pruning.png").stat().st_size > 1000
    assert "night: sun disc by skip: changes no pixel by more than 0 by its bound" in capsys.readouterr().out


# timing


def test_any_number_of_works_take_turns():
    order = []

    def work(name):
        order.append(name)
        return float(len(order))

    found = timing.in_turn({name: lambda name=name: work(name) for name in "abc"}, rounds=2)
    assert "".join(order) == "abcabcabc"
    assert found["c"].each == (6.0, 9.0)
    assert timing.ratio(found["c"], found["a"]).each == (6.0 / 4.0, 9.0 / 7.0)


def test_short_works_are_timed_many_times():
    calls = []
    taken = timing.seconds_of(lambda: calls.append(None))
    assert len(calls) > 10
    assert taken * len(calls) >= timing.LEAST_SECONDS


def test_one_thread_is_given_back():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    with timing.one_thread():
        assert torch.get_num_threads() == 1
    after = torch.get_num_threads()
    torch.set_num_threads(before)
    assert after == 2
