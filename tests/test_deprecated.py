"""Old names of one release: each warns, and is the object of its new name."""

from __future__ import annotations

import importlib
import subprocess
import sys

import pytest

from jaxgeo._renamed import full_name

PACKAGES = ("jaxgeo", *(f"jaxgeo.{name}" for name in ("adjust", "coverage", "register", "sensor", "uncertainty")))
CASES = [
    (package, old, new) for package in PACKAGES for old, new in importlib.import_module(package).DEPRECATED.items()
]


@pytest.mark.parametrize("package, old, new", CASES)
def test_an_old_name_warns_and_is_the_new_one(package: str, old: str, new: str) -> None:
    module = importlib.import_module(package)
    full = full_name(package, new)
    with pytest.warns(DeprecationWarning, match=rf"{package}\.{old} is now {full}; .* version 0\.3"):
        found = getattr(module, old)
    home, _, name = full.rpartition(".")
    assert found is getattr(importlib.import_module(home), name)
    assert name in importlib.import_module(home).__all__
    assert old not in module.__all__


@pytest.mark.costly
def test_the_warning_points_to_the_line_that_uses_the_old_name() -> None:
    code = "from jaxgeo import coverage\ncoverage.point\n"  # a process of its own: here checks of types lie in between
    told = subprocess.run(
        [sys.executable, "-W", "always", "-c", code], capture_output=True, text=True, check=True
    ).stderr
    assert "<string>:2: DeprecationWarning: jaxgeo.coverage.point is now jaxgeo.coverage.point_gimbal" in told


def test_a_name_that_never_was_is_refused() -> None:
    from jaxgeo import uncertainty

    with pytest.raises(AttributeError, match="has no attribute 'EachSortie'"):
        _ = uncertainty.EachSortie


def test_a_renamed_argument_warns_and_is_passed_on() -> None:
    from jaxgeo._renamed import renamed_argument

    @renamed_argument("told", "callback")
    def function(x: int, *, callback: str | None = None) -> tuple[int, str | None]:
        return x, callback

    with pytest.warns(DeprecationWarning, match=r"function\(told=\) is now callback=; .* version 0\.3"):
        assert function(1, told="a") == (1, "a")
    assert function(1, callback="b") == (1, "b")


def test_shifts_seen_is_visible() -> None:
    from jaxgeo.register.prediction import Shifts

    shifts = Shifts(*range(8))
    with pytest.warns(DeprecationWarning, match="Shifts.visible"):
        assert shifts.seen == shifts.visible == 5


@pytest.mark.costly
def test_a_method_that_is_now_a_function_warns_and_calls_it() -> None:
    import numpy as np

    import jaxgeo
    from jaxgeo.sensor import point_shot

    camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
    pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=3000.0)
    target = jaxgeo.Geodetic.from_degrees(lat=47.001, lon=11.001, height=600.0)
    with pytest.warns(DeprecationWarning, match=r"jaxgeo\.Sensor\.looking_at is now jaxgeo\.sensor\.point_shot"):
        old = sensor.looking_at(pose, target, time=3.0)
    new = point_shot(sensor, pose, target, time=3.0)
    np.testing.assert_array_equal(old.gimbal_readings, new.gimbal_readings)
    assert float(old.time) == 3.0


def test_old_names_of_a_solver_and_its_log() -> None:
    from jaxgeo.adjust import Iteration, Solver

    with pytest.warns(DeprecationWarning, match=r"^Solver\(most=\) is now max_iterations="):
        solver = Solver(most=7)
    assert solver == Solver(max_iterations=7)
    with pytest.warns(DeprecationWarning, match=r"Solver\.max_iterations"):
        assert solver.most == 7
    with pytest.warns(DeprecationWarning, match=r"Iteration\.predicted_decrease"):
        assert Iteration(1, 2.0, 3.0, 4.0, 5.0, True).promised == 3.0
