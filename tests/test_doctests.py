"""The examples in docstrings run, and print what they say."""

from __future__ import annotations

import ast
import doctest
import pathlib
from collections.abc import Iterator

import numpy as np
import pytest

import jaxgeo

PACKAGE = pathlib.Path(__file__).resolve().parents[1] / "jaxgeo"
SLOW = {  # of what they compile
    "coverage/pointing.py",
    "io/acquisitions/detect.py",
    "io/acquisitions/several.py",
    "io/observation_reader.py",
    "sensor/sensor.py",
    "uncertainty/_accuracy.py",
    "uncertainty/_budget.py",
    "uncertainty/_error_samples.py",
    "uncertainty/_simulate_looks.py",
    "uncertainty/_track.py",
}
COSTLY = {"adjust/intersection.py"}
# What no reader should look for in vain: the doors through which most come.
DOORS = {
    "__init__.py": "",
    "_locate.py": "locate project at_range intersect",
    "earth/geodetic.py": "Geodetic",
    "sensor/camera.py": "FrameCamera.from_metric FrameCamera.from_pixels",
    "sensor/gimbal.py": "Gimbal Gimbal.readings_from_degrees",
    "sensor/platform.py": "Pose.from_degrees",
    "sensor/trajectory.py": "Trajectory.from_knots",
    "terrain/dem.py": "Dem.from_array",
    "io/dem.py": "read_dem example_dem",
    "io/geoid.py": "height_msl",
    "io/acquisitions/detect.py": "read_acquisition",
    "io/fix_files.py": "write_fixes",
    "observation.py": "Exposure Observation",
    "uncertainty/model.py": "ErrorModel",
    "uncertainty/linear.py": "propagate",
    "uncertainty/_accuracy.py": "accuracy",
    "uncertainty/sampling.py": "Sampling",
    "uncertainty/_budget.py": "budget",
    "uncertainty/_track.py": "track",
    "uncertainty/metrics/exact.py": "circular_error linear_error spherical_error",
    "coverage/pointing.py": "point_gimbal",
    "coverage/_footprint.py": "footprint",
    "adjust/intersection.py": "forward_intersection",
}


def docstrings(node: ast.Module | ast.ClassDef, within: str = "") -> Iterator[tuple[str, str, int]]:
    """(qualified name, docstring, its line) of a module, and of all classes and functions in it.

    From the source: what the suite's checks of types wrap is no longer known by its module.
    """
    if isinstance(node, ast.Module) and (text := ast.get_docstring(node, clean=False)):
        yield "", text, node.body[0].lineno
    for one in node.body:
        if isinstance(one, ast.FunctionDef | ast.ClassDef):
            name = f"{within}{one.name}"
            if text := ast.get_docstring(one, clean=False):
                yield name, text, one.body[0].lineno
            if isinstance(one, ast.ClassDef):
                yield from docstrings(one, f"{name}.")


def examples_of(path: str) -> list[doctest.DocTest]:
    source = (PACKAGE / path).read_text(encoding="utf-8")
    parser, names = doctest.DocTestParser(), {"jaxgeo": jaxgeo, "np": np}
    found = [
        parser.get_doctest(text, names, name, str(PACKAGE / path), line - 1)
        for name, text, line in docstrings(ast.parse(source))
    ]
    assert sum(len(test.examples) for test in found) == source.count(">>> "), "an example is in no docstring"
    return [test for test in found if test.examples]


MODULES = sorted(
    path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py") if ">>> " in path.read_text(encoding="utf-8")
)


def marked(path: str):
    marks = pytest.mark.slow if path in SLOW else pytest.mark.costly if path in COSTLY else ()
    return pytest.param(path, marks=marks)


@pytest.mark.parametrize("path", [marked(path) for path in MODULES])
def test_examples_print_what_they_say(path):
    for test in examples_of(path):
        told: list[str] = []
        failed, tried = doctest.DocTestRunner(verbose=False).run(test, out=told.append)
        assert tried > 0
        assert failed == 0, "".join(told)


@pytest.mark.parametrize("path", DOORS)
def test_the_main_doors_have_an_example(path):
    assert {test.name for test in examples_of(path)} >= ({""} if not DOORS[path] else set(DOORS[path].split()))


def test_an_example_that_is_wrong_is_told():
    test = doctest.DocTestParser().get_doctest(">>> 1 + 1\n3\n", {}, "wrong", "wrong.py", 0)
    told: list[str] = []
    assert doctest.DocTestRunner(verbose=False).run(test, out=told.append).failed == 1
    assert "Expected:\n    3" in "".join(told)
