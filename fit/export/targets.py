"""Every target of `fit export` by its name, and the folder that is written for one."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from diffrender.scene import RECORDS, Scene
from fit import picture
from fit.export import blender, godot, threejs, unity, unreal
from fit.export.described import Described, described
from fit.export.exported import Exported
from fit.input_error import InputError
from fit.path_text import path_text
from fit.whole_file import write_bytes
from fit.whole_folder import whole_folder

TARGETS: dict[str, Callable[[Described], Exported]] = {
    "unreal": unreal.export,
    "unity": unity.export,
    "godot": godot.export,
    "blender": blender.export,
    "threejs": threejs.export,
}
ACCOUNT = "export.txt"
TOLD = ("exposure", "sun", "sky", "height_fog", "antialiasing")  # parts of a scene that targets give account of


def check(target: str) -> None:
    """Refuse an unknown target.

    Raises:
        InputError: names those that there are.
    """
    if target not in TARGETS:
        raise InputError(f"--to {target} is unknown; allowed are {', '.join(TARGETS)}")


def _undrawn(scene: Scene) -> list[str]:
    """What a weather file may hold and no target is given."""
    prefixes = {kind: prefix for prefix, kind in RECORDS.items()}
    parts = [part for name, part in vars(scene).items() if part is not None and name not in TOLD]
    return [f"{prefixes[type(part)]}_*, which no export draws" for part in parts]


def write(target: str, scene: Scene, name: str, hour: float, folder: Path) -> str:
    """Write a scene with a sky for a target into a folder, all files or none, and give the account of it.

    Raises:
        InputError: when a file cannot be written.
    """
    weather = described(scene, name, hour)
    exported = TARGETS[target](weather)
    sun, side = abs(weather.elevation_degrees), "above" if weather.elevation_degrees >= 0.0 else "below"
    account = replace(exported.account, drops=[*exported.account.drops, *_undrawn(scene)])
    head = f"Weather of {path_text(Path(name))} at {hour:g} h, the sun {sun:.3g} degrees {side} the horizon"
    text = f"{head}\n{account.text()}\n"
    with whole_folder(folder, last=ACCOUNT) as aside:
        for file, content in exported.texts.items():
            write_bytes(aside / file, content.encode())
        for file, drawn in exported.pictures.items():
            picture.write(aside / file, drawn, {"weather": name, "hour": hour})
        write_bytes(aside / ACCOUNT, text.encode())
    return text
