"""`import jaxgeo` is light, changes nothing, and offers the public names."""

from __future__ import annotations

import importlib
import inspect
import json
import pkgutil
import subprocess
import sys

import pytest

HEAVY = ["rasterio", "pyproj", "pyogrio", "shapely", "matplotlib", "optimistix", "lineax", "typer", "pydantic", "rich"]


FILES = ["rasterio", "pyproj", "pyogrio", "pydantic", "jaxgeo.io.acquisitions", "jaxgeo.io.scene"]

IMPORTED = """
import json, sys, jax
before = dict(jax.config.values)
import jaxgeo
told = {"modules": sorted(sys.modules), "settings are the same": before == dict(jax.config.values)}
jaxgeo.io.read_dem
told["rasterio on demand"] = "rasterio" in sys.modules
jaxgeo.plot.hillshade
print(json.dumps(told))
"""


@pytest.fixture(scope="module")
def imported() -> dict:
    """What a fresh process tells after its import of jaxgeo."""
    done = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_import_loads_nothing_heavy(imported: dict) -> None:
    assert "jaxgeo" in imported["modules"]
    assert [name for name in HEAVY if name in imported["modules"]] == []


def test_the_command_line_reads_no_library_of_files_before_a_command_does() -> None:
    found = "import json, sys, jaxgeo.cli; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", found], capture_output=True, text=True, check=True)
    modules = json.loads(done.stdout)
    assert "jaxgeo.cli.locate" in modules
    assert [name for name in FILES if name in modules] == []


def test_import_leaves_jax_settings_alone(imported: dict) -> None:
    assert imported["settings are the same"]


def test_submodules_come_on_demand(imported: dict) -> None:
    assert imported["rasterio on demand"]


@pytest.mark.parametrize("name", ["atlantis", "intersects"])
def test_unknown_names_are_refused(name: str) -> None:
    import jaxgeo

    with pytest.raises(AttributeError, match=name):
        getattr(jaxgeo, name)


def test_public_names_exist() -> None:
    import jaxgeo

    names = """enable_x64 Ray intersect locate project at_range Geodetic Dem ConstantHeight FirstHit Bisection Fix
        Projection Status Sensor Shot Pose Gimbal Mount FrameCamera BrownConrady WGS84 Ellipsoid""".split()
    assert set(names) <= set(jaxgeo.__all__)
    for name in jaxgeo.__all__:
        assert getattr(jaxgeo, name) is not None


def test_no_public_name_hides_a_module() -> None:
    import jaxgeo

    packages = ["jaxgeo", *(one.name for one in pkgutil.walk_packages(jaxgeo.__path__, "jaxgeo.") if one.ispkg)]
    packages = [name for name in packages if not name.startswith("jaxgeo.studies")]  # programs, no interface
    assert len(packages) > 10
    hidden = []
    for name in packages:
        package = importlib.import_module(name)
        modules = [one.name for one in pkgutil.iter_modules(package.__path__)]
        public = [module for module in modules if not module.startswith("_")]
        hidden += [f"{name}.{one}" for one in public if not inspect.ismodule(getattr(package, one, inspect))]
    assert not hidden, f"functions or classes with the name of their module: {hidden}"
