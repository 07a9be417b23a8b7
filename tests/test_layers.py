import ast
import graphlib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted(path for top in ("diffrender", "fit", "experiments", "tests") for path in (ROOT / top).rglob("*.py"))

# From the bottom up; a module may import its own layer and those below. A folder's name stands for its modules.
LAYERS = [
    {"numerics", "parameters", "colour", "sampling", "spherical_harmonics"},
    {"rays", "surfaces", "images"},
    {"effect"},
    {"atmosphere", "clouds", "shading", "indirect", "antialiasing", "geometry", "weather"},
    {"catalogue"},
    {"scene"},
    {"diffrender"},  # __init__.py, which re-exports
    {"fit"},
    {"experiments"},
]
EFFECT_FOLDERS = LAYERS[3]
BETWEEN_EFFECT_FOLDERS = {("clouds", "atmosphere"), ("indirect", "shading"), ("indirect", "geometry")}

PACKAGES = {
    "diffrender": {"torch", "kornia", "jaxtyping", "safetensors"},  # the last for its own packaged tables
    "fit": {
        "torch",
        "jaxtyping",
        "numpy",
        "scipy",
        "nlopt",
        "OpenEXR",
        "OpenImageIO",
        "skimage",
        "safetensors",
        "pvlib",
        "distributed",  # where --scheduler asks for it
    }
    | {"pandas", "joblib", "jinja2", "typer", "click", "rich"},  # pandas comes with pvlib, click with typer
}
VAGUE = {"util", "utils", "helper", "helpers", "common", "misc", "manager", "base", "core", "v2", "new"}


def module_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_of(path): path for path in FILES}


def imports_of(path):
    """Full names of all that a file imports, wherever in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else node.module for name in whole}
    return found


def layer(module):
    """Height of one of our own modules, None for others: diffrender.rays -> 1, diffrender -> 6, fit.sky -> 7."""
    top, *inner = module.split(".")
    if top not in {"diffrender", "fit", "experiments"}:
        return None
    name = inner[0] if top == "diffrender" and inner else top
    return next((height for height, names in enumerate(LAYERS) if name in names), None)


IMPORTS = {module: imports_of(path) for module, path in MODULES.items() if not module.startswith("tests")}
OWN = {module: {name for name in names if layer(name) is not None} for module, names in IMPORTS.items()}


def folder(module):
    return module.split(".")[1] if module.startswith("diffrender.") else None


def test_every_module_has_a_layer():
    assert [module for module in IMPORTS if layer(module) is None] == []


def test_lower_layers_do_not_import_upper_ones():
    # This holds diffrender off fit and experiments, and fit off experiments.
    wrong = [(module, name) for module, names in OWN.items() for name in names if layer(name) > layer(module)]
    assert wrong == []


def test_effect_folders_do_not_import_each_other():
    pairs = {(folder(module), folder(name)) for module, names in OWN.items() for name in names}
    between = {(a, b) for a, b in pairs if a != b and {a, b} <= EFFECT_FOLDERS}
    assert between <= BETWEEN_EFFECT_FOLDERS


def test_imports_have_no_cycle():
    graphlib.TopologicalSorter({module: names - {module} for module, names in OWN.items()}).prepare()


def test_our_imports_name_modules_that_exist():
    wrong = [(module, name) for module, names in OWN.items() for name in names if name not in MODULES]
    assert wrong == []


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_imports_only_what_it_may(package):
    foreign = {
        name.split(".")[0]
        for module, names in IMPORTS.items()
        if module.split(".")[0] == package
        for name in names - OWN[module]
    }
    assert foreign - sys.stdlib_module_names <= PACKAGES[package]


def test_kornia_is_imported_by_images_alone():
    users = {module for module, names in IMPORTS.items() if any(name.split(".")[0] == "kornia" for name in names)}
    assert {module for module in users if module.startswith("diffrender")} <= {"diffrender.images"}


def test_functions_import_nothing_but_in_commands_and_the_slow_file():
    lazy = {
        module
        for module in IMPORTS
        for node in ast.walk(ast.parse(MODULES[module].read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef)
        for inner in ast.walk(node)
        if isinstance(inner, ast.Import | ast.ImportFrom)
    }
    assert {module for module in lazy if not module.endswith("_command")} <= {"fit.__main__", "fit.sun"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_file_has_at_most_400_lines(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 400


def test_no_file_or_folder_has_a_vague_name():
    words = {
        word: path
        for path in FILES
        for part in path.relative_to(ROOT).with_suffix("").parts
        for word in part.split("_")
    }
    assert {word: str(path) for word, path in words.items() if word in VAGUE} == {}
