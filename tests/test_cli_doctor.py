"""`jaxgeo doctor`: what is there, what is absent and how to get it; a fault is a line, not a traceback."""

from __future__ import annotations

import importlib.metadata
import json

import pytest
from support.command_runner import CliRunner

from jaxgeo.cli import app, doctor
from jaxgeo.cli.doctor import CHECKS, State, _guarded, _needed_by
from jaxgeo.io import errors, geoid


def found_by(name: str) -> dict[str, doctor.Finding]:
    (check,) = (one for one in CHECKS if one.__name__ == name)
    return {one.what: one for one in _guarded(check)}


def test_versions_are_those_of_the_packages() -> None:
    found = found_by("_versions")
    assert found["jaxlib"].found == importlib.metadata.version("jaxlib")
    assert {one.state for one in found.values()} == {State.ok}


def test_a_package_that_is_not_there_is_told(monkeypatch) -> None:
    monkeypatch.setattr(doctor, "PACKAGES", ("no-such-package",))
    found = found_by("_versions")["no-such-package"]
    assert found.state is State.failed
    assert found.remedy == "pip install no-such-package"


def test_64_bit_floats_and_devices() -> None:
    found = found_by("_floats_and_devices")
    assert found["64-bit floats"] == ("64-bit floats", State.ok, "float64", "")
    assert "cpu" in found["devices"].found


def test_caches(monkeypatch, tmp_path) -> None:
    monkeypatch.setenv("JAXGEO_CACHE_DIR", str(tmp_path / "programs"))
    monkeypatch.setenv("JAXGEO_DEM_CACHE", str(tmp_path / "dem"))
    found = found_by("_caches")
    assert str(tmp_path / "programs") in found["compiled programs"].found
    assert str(tmp_path / "dem") in found["elevation models"].found
    monkeypatch.setenv("JAXGEO_CACHE_DIR", "")
    assert found_by("_caches")["compiled programs"].state is State.absent


def test_a_geoid_grid_that_is_missing_is_told_with_its_command(monkeypatch) -> None:
    assert found_by("_geoids")["geoid EGM96"].state is State.ok

    def missing(*_: object) -> float:
        raise errors.VerticalDatumError("EPSG:3855: the grid file is missing")

    monkeypatch.setattr(geoid, "undulation", missing)
    monkeypatch.setattr("jaxgeo.io.undulation", missing, raising=False)
    found = found_by("_geoids")["geoid EGM2008"]
    assert found.state is State.absent
    assert found.remedy == "jaxgeo dem --geoid EPSG:3855"


def test_drivers_and_extras(monkeypatch) -> None:
    assert {one.state for one in found_by("_drivers").values()} == {State.ok}
    assert "matplotlib" in _needed_by("report")  # through the extra plot
    monkeypatch.setattr(doctor, "_is_installed", lambda name: name != "matplotlib")
    found = found_by("_extras")
    assert found["extra report"].state is State.absent
    assert found["extra report"].remedy == "pip install 'jaxgeo[report]'"
    monkeypatch.setattr(doctor, "DRIVERS", {"NoSuchDriver": "nothing"})
    assert found_by("_drivers")["GDAL NoSuchDriver"].state is State.absent


def test_a_check_that_breaks_off_is_a_finding_and_exit_code_1(monkeypatch) -> None:
    def _broken() -> None:
        raise OSError("no such device")

    monkeypatch.setattr(doctor, "CHECKS", (_broken,))
    result = CliRunner().invoke(app, ["doctor"])
    assert result.exit_code == 1
    assert "failed  broken  OSError: no such device" in result.stdout
    assert "0 ok, 0 absent, 1 failed" in result.stdout


@pytest.mark.costly
def test_the_first_fix_is_right_and_a_wrong_one_is_told(monkeypatch) -> None:
    told = json.loads(CliRunner().invoke(app, ["doctor", "--json"]).stdout)
    (fix,) = (one for one in told["findings"] if one["what"] == "first fix")
    assert fix["state"] == "ok"
    assert "s the first time" in fix["found"]
    monkeypatch.setattr(doctor, "CLOSE", -1.0)
    assert found_by("_first_fix")["first fix"].state is State.failed


def test_a_piped_report_has_no_blanks_at_the_ends_of_its_lines(monkeypatch) -> None:
    def few():
        yield doctor.Finding("a", State.ok, "1.0")
        yield doctor.Finding("a longer name", State.absent, "not installed \x1b[31m", "pip install it")

    monkeypatch.setattr(doctor, "CHECKS", (few,))
    lines = CliRunner().invoke(app, ["doctor"]).stdout.splitlines()
    assert lines == [
        "ok      a              1.0",
        "absent  a longer name  not installed \\x1b[31m",
        "                       -> pip install it",
        "1 ok, 1 absent, 0 failed",
    ]
