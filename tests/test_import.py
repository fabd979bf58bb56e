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


def in_fresh_python(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_loads_nothing_heavy() -> None:
    loaded = json.loads(in_fresh_python("import sys, json, jaxgeo; print(json.dumps(sorted(sys.modules)))"))
    assert [name for name in HEAVY if name in loaded] == []


def test_import_leaves_jax_settings_alone() -> None:
    code = "import jax; before = dict(jax.config.values); import jaxgeo; print(before == dict(jax.config.values))"
    assert in_fresh_python(code).strip() == "True"


def test_submodules_come_on_demand() -> None:
    code = (
        "import sys, jaxgeo; jaxgeo.io.read_dem; assert 'rasterio' in sys.modules; jaxgeo.plot.hillshade; print('ok')"
    )
    assert in_fresh_python(code).strip() == "ok"


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
