"""The conda recipe is one of the published format, and is about the same package as pyproject.toml.

Format: W. Vollprecht, "A new recipe format", CEP 13 (the YAML syntax) and CEP 14 (the allowed keys and values), conda
community, 2023; of `noarch: python` packages conda-forge's CFEP 25, "Globally pinned minimum Python" (2024).
"""

from __future__ import annotations

import pathlib
import re
import tomllib
from typing import Any

import pytest

ROOT = pathlib.Path(__file__).resolve().parents[1]
RECIPE = ROOT / "tools" / "conda" / "recipe.yaml"
# Names in conda-forge where they are others than in PyPI.
OTHER_NAMES = {"matplotlib": "matplotlib-base", "dask": "dask-core"}
OPTIONAL = ("plot", "report", "gis", "orthority", "video", "logs", "cluster", "stac", "xarray")
# Keys of CEP 14 by their section.
KEYS = {
    "": {"schema_version", "context", "package", "source", "build", "requirements", "tests", "about", "extra"},
    "package": {"name", "version"},
    "source": {"url", "sha256", "md5", "file_name", "patches", "target_directory", "path", "use_gitignore", "git"},
    "build": {"number", "string", "skip", "noarch", "script", "merge_build_and_host_envs", "always_include_files",
              "always_copy_files", "variant", "python", "prefix_detection", "post_process", "files",
              "dynamic_linking"},
    "build.python": {"entry_points", "skip_pyc_compilation", "use_python_app_entrypoint", "site_packages_path",
                     "version_independent"},
    "requirements": {"build", "host", "run", "run_constraints", "run_exports", "ignore_run_exports"},
    "tests": {"python", "script", "requirements", "files", "package_contents", "downstream"},
    "tests.python": {"imports", "pip_check", "python_version"},
    "about": {"homepage", "license", "license_family", "license_file", "license_url", "summary", "description",
              "documentation", "repository"},
}  # fmt: skip
REQUIREMENT = re.compile(r"(?P<name>[a-z0-9-]+)(?: (?P<bound>[^ ]+))?")


@pytest.fixture(scope="module")
def written() -> dict[str, Any]:
    yaml = pytest.importorskip("yaml")
    found = yaml.safe_load(RECIPE.read_text(encoding="utf-8"))
    context = found["context"]

    def filled(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: filled(one) for key, one in value.items()}
        if isinstance(value, list):
            return [filled(one) for one in value]
        if isinstance(value, str):
            return re.sub(r"\$\{\{ (\w+) \}\}", lambda name: context[name[1]], value)
        return value

    return filled(found)


@pytest.fixture(scope="module")
def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def as_conda(requirement: str) -> str:
    """A requirement of pyproject.toml by its name in conda-forge."""
    name, at_least, bound = re.split(r"(>=)", requirement)
    return f"{OTHER_NAMES.get(name.lower(), name.lower())} {at_least}{bound}"


def test_it_has_the_keys_of_the_format_and_no_others(written: dict[str, Any]) -> None:
    assert written["schema_version"] == 1
    assert set(written) <= KEYS[""]
    for section in ("package", "source", "build", "requirements", "about"):
        assert set(written[section]) <= KEYS[section], section
    assert set(written["build"]["python"]) <= KEYS["build.python"]
    for one in written["tests"]:
        assert set(one) <= KEYS["tests"]
        assert set(one.get("python", ())) <= KEYS["tests.python"]
    assert "${{" not in repr(written), "every variable is in the context"
    for part in ("host", "run", "run_constraints"):
        for one in written["requirements"][part]:
            assert REQUIREMENT.fullmatch(one), one
    assert isinstance(written["context"]["version"], str)
    assert isinstance(written["context"]["python_min"], str), "3.10 without quotation marks would be 3.1"


def test_it_is_of_this_package(written: dict[str, Any], project: dict[str, Any]) -> None:
    ours = project["project"]
    assert written["package"] == {"name": ours["name"], "version": ours["version"]}
    assert (RECIPE.parent / written["source"]["path"]).resolve() == ROOT
    assert written["about"]["license"] == ours["license"]
    assert written["about"]["summary"] == ours["description"]
    files = {path.relative_to(ROOT).as_posix() for pattern in ours["license-files"] for path in ROOT.glob(pattern)}
    assert set(written["about"]["license_file"]) == files
    scripts = [f"{name} = {place}" for name, place in ours["scripts"].items()]
    assert written["build"]["python"]["entry_points"] == scripts
    assert written["build"]["noarch"] == "python"


def test_it_needs_what_the_package_needs(written: dict[str, Any], project: dict[str, Any]) -> None:
    """Python and the libraries with the same bounds; what builds it; and the bounds of the extras as constraints."""
    ours, needs = project["project"], written["requirements"]
    at_least = ours["requires-python"]
    assert at_least == f">={written['context']['python_min']}"
    assert needs["run"] == [f"python {at_least}", *map(as_conda, ours["dependencies"])]
    assert needs["host"] == [f"python {at_least.removeprefix('>=')}.*", "pip", *project["build-system"]["requires"]]
    extras = [one for name in OPTIONAL for one in ours["optional-dependencies"][name]]
    wanted = dict.fromkeys(as_conda(one) for one in extras if not one.startswith("jaxgeo["))
    assert needs["run_constraints"] == list(wanted)
    assert not {one.split()[0] for one in wanted} & {one.split()[0] for one in needs["run"]}


def test_what_it_runs_is_there(written: dict[str, Any]) -> None:
    """Modules that it imports, and commands of its script."""
    from support.command_runner import CliRunner

    from jaxgeo.cli import app

    for one in written["tests"]:
        for module in one.get("python", {}).get("imports", ()):
            path = ROOT / module.replace(".", "/")
            assert (path / "__init__.py").exists() or path.with_suffix(".py").exists(), module
        for line in one.get("script", ()):
            program, *words = line.split()
            assert program == "jaxgeo"
            assert CliRunner().invoke(app, [*words, *([] if "--version" in words else ["--help"])]).exit_code == 0
