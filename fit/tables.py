"""Tables of the sky in files: written, read, and drawn from.

A file is safetensors, in float32, and holds FFXV's two tables or Decima's, by the names of their records' fields.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save as save_tensors
from torch import Tensor

from diffrender.atmosphere import celestial, sky, stored_tables, two_tables
from diffrender.atmosphere.sky import TabledView
from diffrender.atmosphere.stored_tables import StoredTables
from diffrender.atmosphere.two_tables import OneSun, TwoTabledView, TwoTables
from diffrender.scene import Scene, sunlight
from fit.input_error import InputError
from fit.picture import Light, fresh, scene_sky
from fit.whole_file import write_bytes

Tables = TwoTables | StoredTables

LARGEST_BYTES = 64_000_000
MOST_CELLS = 1024  # of an axis
BRIGHTEST = 1e12  # no entry is larger, so that what is drawn stays finite
HOW_TO_GET = "make it by fit tables"
# Sizes of a field's axes that other fields share, by name; a number stands for itself.
AXES: Mapping[type[Tables], Mapping[str, tuple[str | int, ...]]] = {
    TwoTables: {"air": ("suns", "rows", 3), "haze": ("suns", "rows", 3), "cloud": ("suns", 3)},
    StoredTables: {
        "in_scatter": ("suns", "rows", "columns", 3, 3),
        "cloud": ("suns", 3),
        "sunlight": ("suns", 3),
        "skylight": ("suns", 3),
        "amount": (3, 3),
    },
}


def save(path: Path, tables: Tables, origin: str) -> None:
    """Write tables, whole or not at all, with a line on what they were made from."""
    single = {name: table.float().contiguous() for name, table in vars(tables).items()}
    write_bytes(path, save_tensors(single, {"origin": origin}))


def load(path: Path) -> Tables:
    """Tables of a file, in float32.

    Raises:
        InputError: when it cannot be read, or holds anything but whole tables of finite numbers that are not negative.
    """
    try:
        if not path.is_file():
            raise InputError(f"{path} is no file; give tables of the sky, or {HOW_TO_GET}")
        if path.stat().st_size > LARGEST_BYTES:
            raise InputError(f"{path} is larger than {LARGEST_BYTES:,} bytes, and no tables of the sky; {HOW_TO_GET}")
        with safe_open(path, framework="pt") as file:
            held = {name: file.get_slice(name) for name in file.keys()}  # noqa: SIM118 - it has no other iterator
            kind = _kind(path, held)
            _check_shapes(path, AXES[kind], {name: (one.get_dtype(), one.get_shape()) for name, one in held.items()})
            tensors = {name: file.get_tensor(name).clone() for name in held}
    except OSError as error:
        raise InputError(f"{path} cannot be opened ({error.strerror or error}); {HOW_TO_GET}") from error
    except SafetensorError as error:
        raise InputError(f"{path} is no safetensors file, or damaged ({error}); {HOW_TO_GET}") from error
    for name, tensor in tensors.items():
        least = torch.finfo(tensor.dtype).tiny if name == "amount" else 0.0
        if not bool(((tensor >= least) & (tensor <= BRIGHTEST)).all()):
            raise InputError(f"{path} has entries of {name} that are not {least:g} to {BRIGHTEST:g}; {HOW_TO_GET}")
    return kind(**tensors)


def _kind(path: Path, held: Mapping[str, object]) -> type[Tables]:
    for kind, axes in AXES.items():
        if held.keys() == axes.keys():
            return kind
    wanted = " or ".join(", ".join(axes) for axes in AXES.values())
    raise InputError(f"{path} holds {', '.join(sorted(held)[:9]) or 'nothing'}, not {wanted}; {HOW_TO_GET}")


def _check_shapes(
    path: Path, axes: Mapping[str, tuple[str | int, ...]], held: Mapping[str, tuple[str, Sequence[int]]]
) -> None:
    sizes: dict[str | int, int] = {3: 3}
    for name, (kind, shape) in held.items():
        if kind != "F32" or len(shape) != len(axes[name]):
            raise InputError(f"{path} has {name} as {kind} {list(shape)}, not F32 {list(axes[name])}; {HOW_TO_GET}")
        for axis, size in zip(axes[name], shape, strict=True):
            if sizes.setdefault(axis, size) != size or not 2 <= size <= MOST_CELLS:
                raise InputError(
                    f"{path} has {name} of {list(shape)}; needed is {list(axes[name])}, of 2 to {MOST_CELLS} cells "
                    f"and alike in all tables; {HOW_TO_GET}"
                )


def light(scene: Scene, paths: Sequence[Path], blend: float | None) -> Light:
    """Light of a scene from the tables of one file, of two blended by a share of the second, or from fresh tables.

    Raises:
        InputError: when there are more or fewer files than the blend needs, one cannot be used, or two are not alike.
    """
    if not paths and blend is None:
        return fresh(scene)
    if len(paths) != (1 if blend is None else 2):
        raise InputError(f"--tables given {len(paths)} times; give it once, or twice and --blend with it")
    tables = [load(path) for path in paths]
    return _light(scene, tables[0], tables[-1], torch.tensor(blend or 0.0))


def _light(scene: Scene, first: Tables, second: Tables, share: Tensor) -> Light:
    of, to_sun = scene_sky(scene), celestial.to_sun(scene.sun)
    alike = type(first) is type(second) and _shapes(first) == _shapes(second)
    if alike and isinstance(first, TwoTables) and isinstance(second, TwoTables):
        one, other = two_tables.at_sun(first, to_sun), two_tables.at_sun(second, to_sun)
        mixed = OneSun(**{n: stored_tables.between(table, vars(other)[n], share) for n, table in vars(one).items()})
        return Light(lambda seen: sky.render_two_tables(of, TwoTabledView(seen, mixed)), sunlight(scene))
    if alike and isinstance(first, StoredTables) and isinstance(second, StoredTables):
        day, other_day = stored_tables.at_sun(first, to_sun), stored_tables.at_sun(second, to_sun)
        found = stored_tables.blended(day, other_day, share)
        through = found.sunlight * (1.0 - sky.overcast_share(of, to_sun))
        return Light(lambda seen: sky.render_tables(of, TabledView(seen, found.sky())), through)
    raise InputError("the two files of --tables are not of one form and size; make both by the same fit tables")


def _shapes(tables: Tables) -> dict[str, torch.Size]:
    return {name: table.shape for name, table in vars(tables).items()}
