import ast
import importlib.metadata
import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
README = (ROOT / "README.md").read_text(encoding="utf-8")

PACKAGES = {"diffrender", "fit"}
RUNTIME = [Requirement(line) for line in PROJECT["dependencies"]]
EXTRAS = {name: [Requirement(line) for line in lines] for name, lines in PROJECT["optional-dependencies"].items()}

# Dependencies that come with a later kind of effect or fit; whoever first imports one takes it off this list.
AWAITED = {"kornia"}
# What pvlib takes and gives are pandas' tables, so it brings pandas by contract.
BROUGHT = {"pandas"}
# Packages whose module has another name.
OTHERWISE_NAMED = {"flip_evaluator": "flip-evaluator", "skimage": "scikit-image"}

MEGABYTE = 1_000_000
MACHINE_PATH = re.compile(r"(?<![\w.~$}])/(?:work|root|tmp|home|Users|mnt)/\w|\b[A-Z]:\\\w")


def pins():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


def pinned():
    return dict(line.split("==") for line in pins())


def imported(*folders):
    """Distributions that the files of these folders import, wherever in them."""
    names = set()
    for path in (path for folder in folders for path in (ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module.split(".")[0])
    own = {"diffrender", "fit", "experiments"} | {path.stem for path in (ROOT / "tests").glob("*.py")}
    foreign = names - own - sys.stdlib_module_names
    return {canonicalize_name(OTHERWISE_NAMED.get(name, name)) for name in foreign}


def named(requirements):
    return {canonicalize_name(requirement.name) for requirement in requirements}


def needed(requirements):
    """Names of all that these bring along on this machine, themselves included."""
    found, waiting = set(), [(requirement, "") for requirement in requirements]
    while waiting:
        requirement, extra = waiting.pop()
        name = canonicalize_name(requirement.name)
        if name in found or (requirement.marker and not requirement.marker.evaluate({"extra": extra})):
            continue
        found.add(name)
        inner = importlib.metadata.requires(name) or []
        waiting += [(Requirement(line), wanted) for line in inner for wanted in ["", *requirement.extras]]
    return found


@pytest.fixture(scope="module")
def tracked():
    """Files that a commit of the whole tree would hold."""
    if shutil.which("git") is None or not (ROOT / ".git").exists():
        pytest.skip("this is not a git checkout: which files are tracked is not known")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return sorted(path for path in (ROOT / name for name in listed.split("\0") if name) if path.is_file())


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel's files: name -> content."""
    (path,) = WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("wheel")), versions=["standard"])
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.mark.parametrize(
    "command",
    [
        "python3 -m venv .venv && .venv/bin/pip install -c constraints.txt . && "
        ".venv/bin/fit sky experiments/photos/spruit_sunrise.exr",
        "python3 -m venv .venv && .venv/bin/pip install -c constraints.txt -e '.[test]' && "
        ".venv/bin/python -m pytest -n auto --dist loadfile",
    ],
    ids=["main job", "tests"],
)
def test_readme_sets_up_in_one_line(command):
    assert command in README.splitlines()
    assert (ROOT / "experiments/photos/spruit_sunrise.exr").is_file()


def test_python_in_the_readme_is_run_as_doctests():
    blocks = re.findall(r"^```python\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE)
    assert blocks
    # doctest reads expected output up to a blank line: without one it would take the fence for output.
    assert [block for block in blocks if not block.startswith(">>> ") or not block.endswith("\n\n")] == []


def test_ci_can_be_started_by_name():
    assert os.access(ROOT / ".ci/run", os.X_OK)


def test_constraints_are_exact_versions_of_no_particular_build():
    assert [line for line in pins() if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*==[0-9][0-9a-z.]*", line)] == []
    assert len(pinned()) == len(pins())
    assert pinned()["torch"] == "2.13.0"


def test_constraints_satisfy_the_project():
    direct = RUNTIME + [requirement for extra in EXTRAS.values() for requirement in extra]
    assert named(direct) <= pinned().keys()
    versions = {requirement: Version(pinned()[canonicalize_name(requirement.name)]) for requirement in direct}
    assert [str(requirement) for requirement, version in versions.items() if version not in requirement.specifier] == []


def test_constraints_hold_all_that_an_installation_brings():
    assert needed(RUNTIME + EXTRAS["test"]) - pinned().keys() == set()


def test_every_runtime_dependency_is_imported():
    assert named(RUNTIME) - imported("diffrender", "fit") == AWAITED


def test_every_import_of_the_packages_is_a_runtime_dependency():
    # What an extra brings is imported where its option is given.
    assert imported("diffrender", "fit") - named(RUNTIME) == BROUGHT | named(EXTRAS["cluster"])


def test_every_import_of_tests_and_experiments_is_a_dependency():
    declared = named(RUNTIME + EXTRAS["test"] + EXTRAS["experiments"] + EXTRAS["cluster"])
    assert imported("tests", "experiments") - declared <= {"packaging"}  # which comes with pytest


def test_a_wheel_holds_every_file_of_the_two_packages_and_nothing_else(wheel, tracked):
    packages = {path.relative_to(ROOT).as_posix() for path in tracked if path.relative_to(ROOT).parts[0] in PACKAGES}
    assert {name for name in wheel if ".dist-info/" not in name} == packages
    assert {"fit/report.html", "diffrender/__init__.py", "diffrender/atmosphere/two_tables.safetensors"} <= packages


def test_packaged_tables_are_small():
    tables = list((ROOT / "diffrender").rglob("*.safetensors"))
    assert [path.name for path in tables] == ["two_tables.safetensors"]
    assert sum(path.stat().st_size for path in tables) < 0.3 * MEGABYTE


def test_a_wheel_holds_licence_and_command(wheel):
    information = f"diffrender-{PROJECT['version']}.dist-info"
    licence = (ROOT / "LICENSE").read_bytes()
    assert wheel[f"{information}/licenses/LICENSE"] == licence
    assert licence.startswith(b"MIT License\n")
    assert b"fit = fit.__main__:main" in wheel[f"{information}/entry_points.txt"]


def test_the_version_is_written_once(tracked):
    version = PROJECT["version"]
    assert importlib.metadata.version("diffrender") == version
    sources = [
        path for path in tracked if path.suffix in {".py", ".html"} and path.relative_to(ROOT).parts[0] in PACKAGES
    ]
    assert [path for path in sources if version in path.read_text(encoding="utf-8")] == []


def test_no_file_is_larger_than_a_megabyte_but_photos_and_results(tracked):
    large = {path.relative_to(ROOT) for path in tracked if path.stat().st_size > MEGABYTE}
    assert {
        path for path in large if path.parts[:2] not in {("experiments", "photos"), ("experiments", "results")}
    } == set()


def test_no_file_names_a_place_on_one_machine(tracked):
    # Pictures are passed over: the header of a photo from elsewhere may name its maker's folder.
    binary = {".exr", ".hdr", ".png", ".safetensors"}
    text = {path: path.read_text(encoding="utf-8") for path in tracked if path.suffix not in binary}
    found = {str(path.relative_to(ROOT)): MACHINE_PATH.search(content) for path, content in text.items()}
    assert {name: match[0] for name, match in found.items() if match} == {}
