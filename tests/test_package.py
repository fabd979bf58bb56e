"""What the package says of itself holds: versions of Python, dependencies, extras, what is installed."""

from __future__ import annotations

import ast
import importlib.metadata
import pathlib
import re
import subprocess
import sys
import tomllib
from typing import Any

import pytest

import jaxgeo

# Modules by the name of what brings them, where that is another.
BRINGS = {
    "opencv-python-headless": ("cv2",),
    "pillow": ("PIL",),
    "pyyaml": ("yaml",),
    "jinja2": ("jinja2", "markupsafe"),
    "pystac-client": ("pystac_client",),
}
FOR_TESTS = {"pytest-xdist"}  # a plugin; nothing imports it
REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)(\[(?P<extras>[\w,]+)\])?(?P<bound>>=[\w.]+)?(?P<rest>.*)")


ROOT = pathlib.Path(__file__).resolve().parents[1]
STANDARD = sys.stdlib_module_names


@pytest.fixture(scope="module")
def pyproject() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def parsed(requirement: str) -> re.Match[str]:
    found = REQUIREMENT.fullmatch(requirement)
    assert found, requirement
    return found


def brought(requirements: list[str]) -> set[str]:
    """Modules that those bring, jaxgeo's own extras apart."""
    names = {parsed(one)["name"] for one in requirements} - {"jaxgeo"} - FOR_TESTS
    return {module for name in names for module in BRINGS.get(name, (name,))}


OF_PACKAGE = (
    "cluster",
    "features",
    "plot",
    "report",
    "gis",
    "logs",
    "orthority",
    "stac",
    "video",
    "xarray",
    "yolo",
)  # which the package imports


def imported(tree: ast.AST) -> set[str]:
    """Modules from elsewhere that are imported anywhere in it."""
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and not node.level:
            names.add(node.module or "")
    return {name.split(".")[0] for name in names} - STANDARD


def imported_in(folder: str) -> set[str]:
    files = (ROOT / folder).rglob("*.py")
    return set().union(*(imported(ast.parse(path.read_text(encoding="utf-8"))) for path in files))


@pytest.mark.costly
def test_every_dependency_is_imported_and_every_import_is_one(pyproject: dict[str, Any]) -> None:
    project = pyproject["project"]
    extras = project["optional-dependencies"]
    ours = {"jaxgeo", "jaxgeo_native"}  # the latter is built from native/, where it is wanted
    base = brought(project["dependencies"])
    of_extras = {name: brought(extras[name]) for name in OF_PACKAGE}
    assert imported_in("jaxgeo") - ours == base.union(*of_extras.values())


@pytest.mark.costly
def test_tests_import_what_their_extra_brings(pyproject: dict[str, Any]) -> None:
    """And what `pytest.importorskip` asks for, where it is there."""
    project = pyproject["project"]
    extras = project["optional-dependencies"]
    brings = brought(project["dependencies"] + [one for name in extras for one in extras[name]])
    ours = {path.stem for folder in ("tests", "benchmarks", "docs", "tools") for path in (ROOT / folder).rglob("*.py")}
    assert imported_in("tests") - brings - ours - {"tests", "support", "jaxgeo", "_pytest"} == set()


def test_bounds_are_from_below(pyproject: dict[str, Any]) -> None:
    """A newer version is not shut out before it has broken anything."""
    project = pyproject["project"]
    extras = project["optional-dependencies"]
    for requirement in project["dependencies"] + [one for name in ("test", "plot", "gis") for one in extras[name]]:
        found = parsed(requirement)
        assert found["name"] == "jaxgeo" or (found["bound"] and not found["rest"]), requirement


def test_pythons_are_the_same_everywhere(pyproject: dict[str, Any]) -> None:
    """Of classifiers, the linter, the type checker and the matrix of the continuous integration."""
    project = pyproject["project"]
    said = [one.rpartition(" :: ")[2] for one in project["classifiers"] if re.search(r":: 3\.\d+$", one)]
    oldest = said[0]
    assert project["requires-python"] == f">={oldest}"
    assert pyproject["tool"]["ruff"]["target-version"] == "py" + oldest.replace(".", "")
    assert pyproject["tool"]["pyright"]["pythonVersion"] == oldest
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    tried = re.search(r"python: \[(.*)\]", workflow)
    assert tried
    assert re.findall(r"3\.\d+", tried[1]) == said


def test_the_package_tells_its_version(pyproject: dict[str, Any]) -> None:
    assert jaxgeo.__version__ == importlib.metadata.version("jaxgeo")
    assert "__version__" in dir(jaxgeo)


def test_the_version_has_one_place(pyproject: dict[str, Any]) -> None:
    version = pyproject["project"]["version"]
    assert importlib.metadata.version("jaxgeo") == version
    native = tomllib.loads((ROOT / "native" / "pyproject.toml").read_text(encoding="utf-8"))
    assert native["project"]["version"] == version
    for path in (ROOT / "jaxgeo").rglob("*.py"):
        assert not re.search(r"^__version__\s*=", path.read_text(encoding="utf-8"), re.MULTILINE), path


def test_the_citation_is_of_this_version(pyproject: dict[str, Any]) -> None:
    cited = dict(re.findall(r"^([\w-]+): (.+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE))
    project = pyproject["project"]
    assert [cited[name] for name in ("title", "version", "license")] == [
        project[name] for name in ("name", "version", "license")
    ]
    assert f"## [{project['version']}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_the_container_has_extras_and_files_that_exist(pyproject: dict[str, Any]) -> None:
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    (extras,) = re.findall(r"\.whl\)\[([\w,]+)\]", text)
    assert set(extras.split(",")) <= set(pyproject["project"]["optional-dependencies"])
    copied = [name for line in re.findall(r"^COPY (.+) /source", text, re.MULTILINE) for name in line.split()]
    assert all((ROOT / name).exists() for name in copied)


def test_every_licence_and_datum_is_described() -> None:
    data = ROOT / "jaxgeo" / "data"
    told = (data / "LICENSES.md").read_text(encoding="utf-8")
    for path in data.iterdir():
        assert path.name in told or path.name in ("LICENSES.md", "demo_scene.toml"), path.name  # ours


def test_scripts_of_the_integration_are_sound_and_called() -> None:
    """Every script parses, and both .ci/run (but for the slow tests) and the workflow run each of them."""
    scripts = [path for path in (ROOT / ".ci").iterdir() if path.suffix == "" and path.name != "__pycache__"]
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8")
    whole = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for path in scripts:
        subprocess.run(["bash", "-n", path], check=True)
        if path.name in ("run", "lib"):
            continue
        assert re.search(rf"\b{path.name}\b", workflow), f"ci.yml does not run .ci/{path.name}"
        assert path.name == "slow" or re.search(rf"\.ci/{path.name}\b", whole), f".ci/run does not run .ci/{path.name}"


def test_oldest_versions_are_the_bounds(pyproject: dict[str, Any]) -> None:
    """The constraints of the oldest set name every dependency of the package and of its extras."""
    code = [sys.executable, ROOT / ".ci" / "oldest.py", ROOT / "pyproject.toml"]
    lines = subprocess.run(code, capture_output=True, text=True, check=True).stdout.split()
    bounds = {parsed(one)["name"]: parsed(one)["bound"] for one in pyproject["project"]["dependencies"]}
    assert {f"{name}=={bound.removeprefix('>=')}" for name, bound in bounds.items()} <= set(lines)
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", line) for line in lines)
