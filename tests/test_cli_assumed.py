"""Assumptions on the terminal: grouped, complete, and first those that make the accuracy."""

from __future__ import annotations

import json
import pathlib
import re

import jax
import numpy as np
import pytest
from support.command_files import prepare
from support.command_runner import CliRunner

from jaxgeo.cli import app
from jaxgeo.cli._assumed import NAMED, print_assumed, told_shares
from jaxgeo.cli._far_crs import note_far_crs
from jaxgeo.earth import Geodetic
from jaxgeo.io import accuracy_of_observations, locate_observations, read_observations
from jaxgeo.io.located import horizontal_variances
from jaxgeo.terrain import ConstantHeight
from jaxgeo.uncertainty import accuracy, budget, propagate, sources

GROUND = ["--ground", "300", "--camera-datum", "ellipsoid"]
SIGMAS = {
    "--position-sigma": "0.02",
    "--gimbal-sigma": "0.1",
    "--focal-sigma": "5px",
    "--principal-sigma": "5px",
    "--dem-sigma": "1",
}
GROUPED = [
    ("Yaw is taken to be from true north.", "Yaw is taken to be from true north."),
    ("Position sigma: 3, 3, 5 m (N, E, D; default). (--position-sigma)", "position 3, 3, 5 m (N, E, D; default)"),
    ("DEM height sigma: 5 m (default). (--dem-sigma)", "DEM height 5 m (default) (--dem-sigma)"),
    ("reference position sigma: 2 m, one cell (--reference-sigma)", "reference position 2 m, one cell"),
    ("2 of 5 state no position accuracy; position sigma there: 3 m. (--position-sigma)", "2 of 5 state no position"),
]


@pytest.fixture(scope="module")
def image(tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("images")
    prepare(folder, "DJI_0042.JPG")
    return folder / "DJI_0042.JPG"


def locate(*arguments: str | pathlib.Path):
    result = CliRunner().invoke(app, ["locate", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result


def test_assumptions_are_two_notes_that_keep_every_fact(capsys: pytest.CaptureFixture[str]) -> None:
    print_assumed(["Check: The roll has another sign.", *(sentence for sentence, _ in GROUPED)])
    *lines, last = capsys.readouterr().err.splitlines()
    assert last == "jaxgeo: check: The roll has another sign."
    assert len(lines) == 2
    assert all(line.startswith("jaxgeo: assumed: ") for line in lines)
    for sentence, words in GROUPED:
        (line,) = [line for line in lines if words in line]
        assert sentence.rpartition("(")[2] in line, "its option"


def test_items_without_an_option_have_no_full_stop(capsys: pytest.CaptureFixture[str]) -> None:
    print_assumed(["Position sigma: 3 m (default).", "Gimbal angle sigma: 1 deg (yaw; default)."])
    (line,) = capsys.readouterr().err.splitlines()
    assert line.endswith("assumed: Standard deviations: position 3 m (default); gimbal angle 1 deg (yaw; default).")


@pytest.mark.costly
def test_the_shares_of_assumed_sigmas_are_those_of_the_budget(image: pathlib.Path) -> None:
    told = json.loads(locate(image, *GROUND, "--pixel", "10,20", "--json").stdout)
    observed = read_observations([image], [(10.0, 20.0)], height_datum="ellipsoid")
    look, errors = observed.add_sources(sources.TerrainHeight.from_metres(10.0)).at(0)
    of_fix = budget(
        accuracy(look.exposure.sensor, look.exposure.motion, look.uv, ConstantHeight(300.0), errors)  # pyright: ignore
    )
    by_label = {one.label: one.variance.horizontal / of_fix.total.horizontal for one in of_fix.sources}
    shares = told["assumed_variance_shares"]
    assert list(shares.values()) == sorted(shares.values(), reverse=True)
    assert set(shares) == set(SIGMAS)
    assert sum(shares.values()) == pytest.approx(1.0)
    for option, label in [
        ("--position-sigma", "position"),
        ("--gimbal-sigma", "gimbal angles"),
        ("--dem-sigma", "terrain height"),
    ]:
        assert shares[option] == pytest.approx(by_label[label], rel=1e-6)


@pytest.mark.costly
@pytest.mark.parametrize("pixels", [1, 3])
def test_the_variances_are_those_of_the_propagation_and_compile_nothing(image: pathlib.Path, pixels: int) -> None:
    several = [(10.0, 20.0), (2000.0, 1500.0), (100.0, 2900.0)][:pixels]
    observed = read_observations([image] * pixels, several, height_datum="ellipsoid")
    observed, ground = observed.add_sources(sources.TerrainHeight.from_metres(10.0)), ConstantHeight(300.0)
    fixes = locate_observations(observed, ground)
    assert accuracy_of_observations(observed, ground, fixes) is not None
    compiled: list[str] = []

    def note(event: str, duration_secs: float, **kwargs: str | int) -> None:
        if event.endswith("backend_compile_duration"):
            compiled.append(event)

    jax.monitoring.register_event_duration_secs_listener(note)
    for row in range(pixels):
        found, variances = horizontal_variances(observed, ground, fixes, row)
        assert not compiled
        look, errors = observed.at(row)
        alone = propagate(look.exposure.sensor, look.exposure.motion, look.uv, ground, errors)  # pyright: ignore
        compiled.clear()
        assert len(variances) == sum(len(one.axes) for one in found) == alone.model.size
        J, cov = np.asarray(alone.jacobian)[:2], np.asarray(alone.cov_error)
        np.testing.assert_allclose(variances, np.diag(cov) * (J**2).sum(axis=0), rtol=1e-6)
        assert variances.sum() == pytest.approx(float(np.trace(alone.cov_enu[:2, :2])))


@pytest.mark.costly
def test_the_sentence_names_options_which_end_it(image: pathlib.Path) -> None:
    """Of one pixel and of several; with all standard deviations given there is nothing to say."""
    for pixels in ([], ["--pixel", "10,10", "--pixel", "2000,1500"]):
        told = locate(image, *GROUND, *pixels).stderr
        (line,) = [line for line in told.splitlines() if "comes mostly from assumed" in line]
        assert ("median" in line) == bool(pixels)
        named = [option for option in NAMED if f"({option})" in line]
        assert named
        assert told.index("comes mostly") < told.index(" hit: "), "before the result"
    given = [word for option, value in SIGMAS.items() for word in (option, value)]
    assert "comes mostly" not in locate(image, *GROUND, *given).stderr


def test_small_shares_are_not_worth_a_sentence() -> None:
    assert told_shares({}, 0.9) is None
    assert told_shares({"--dem-sigma": 0.3}, 0.9) is None
    said = told_shares({"--dem-sigma": 0.55, "--position-sigma": 0.05}, 0.5)
    assert said is not None
    assert "CE50" in said
    assert "--dem-sigma" in said
    assert "--position-sigma" not in said


@pytest.mark.costly
def test_a_scene_without_errors_has_the_usual_ones(tmp_path: pathlib.Path) -> None:
    """3 m of position and 0.1 deg of pitch and roll 1000 m above level ground, whose height moves nothing there."""
    scene = tmp_path / "scene.toml"
    scene.write_text(
        "[camera]\nwidth = 101\nheight = 101\nfocal_px = 100.0\n[pose]\nlat_deg = 36.0\nlon_deg = -84.0\n"
        'height_m = 1000.0\nheight_datum = "ellipsoid"\nheading_deg = 0.0\npitch_deg = 0.0\nroll_deg = 0.0\n'
    )
    words = ["--scene", scene, "--ground", "0", "--accuracy", "--json"]
    told = json.loads(locate(*words).stdout)
    sigma = np.hypot(3.0, 1000.0 * np.deg2rad(0.1))
    assert told["fixes"][0]["ce90_m"] == pytest.approx(sigma * np.sqrt(-2.0 * np.log(0.1)), rel=1e-3)
    assert [option for one in told["assumed"] for option in NAMED if f"({option})" in one] == [
        "--position-sigma",
        "--attitude-sigma",
        "--dem-sigma",
    ]
    zeros = [word for option in ("--position-sigma", "--attitude-sigma", "--dem-sigma") for word in (option, "0")]
    result = CliRunner().invoke(app, ["locate", *map(str, words), *zeros])
    assert "all standard deviations are zero; give one of" in result.stderr


@pytest.mark.costly
def test_a_report_says_it_above_the_result(image: pathlib.Path, tmp_path: pathlib.Path) -> None:
    output = tmp_path / "report.html"
    result = CliRunner().invoke(app, ["report", str(image), *GROUND, "-o", str(output)])
    assert result.exit_code == 0, result.output
    page = output.read_text()
    assert "comes mostly from assumed" in result.stderr
    assert page.index('class="notice">CE90 comes mostly') < page.index('class="headline place"')


@pytest.mark.parametrize(
    "lat, lon, crs, words",
    [
        (
            24.5,
            120.8,
            "EPSG:32616",
            "149 deg from the area of use of --crs EPSG:32616; the usual CRS",
        ),
        (
            -36.0,
            -84.1,
            "EPSG:32616",
            "the usual CRS here is EPSG:32716.",
        ),
        (-17.0, -179.5, "EPSG:32760", ""),  # in the next zone, across the date line
        (-17.0, 100.0, "EPSG:3460", "the usual CRS here is EPSG:32747."),  # Fiji, whose area crosses the date line
        (-17.0, -179.5, "EPSG:3460", ""),
        (24.5, 120.8, "EPSG:4326", ""),
        (24.5, 120.8, "nonsense", ""),
    ],
)
def test_a_crs_of_another_part_of_the_earth_is_doubtful(
    lat: float, lon: float, crs: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    lats, lons = np.deg2rad([[np.nan, lat], [np.nan, lon]])
    note_far_crs(crs, Geodetic(lat=lats, lon=lons, height=np.zeros(2)))
    said = capsys.readouterr().err
    assert words in said.replace("\n", " ")
    assert bool(said) == bool(words)


@pytest.mark.costly
@pytest.mark.parametrize("command", ["locate", "footprint"])
def test_the_utm_zone_that_is_named_is_not_doubtful(command: str, image: pathlib.Path, tmp_path: pathlib.Path) -> None:
    more = ["--no-accuracy"] if command == "locate" else []
    line = [command, str(image), *GROUND, *more, "-o", str(tmp_path / "out.geojson"), "--crs"]
    told = CliRunner().invoke(app, [*line, "EPSG:32651"]).stderr
    (zone,) = re.findall(r"the usual CRS here is (EPSG:[0-9]+)", told)
    assert "usual CRS here" not in CliRunner().invoke(app, [*line, zone]).stderr


OTHER = "inspect DJI_0042.JPG --camera-datum ellipsoid --json"
SAID = [
    "footprint DJI_0042.JPG --camera-datum ellipsoid --ground 300 --crs EPSG:32633 -o out.geojson",
    "point DJI_0042.JPG --takeoff-height 300 --target 36.3155,-84.104,340 --target-datum ellipsoid",
    "footprint images --takeoff-height 0 --ground 0",
    "rectify image.tif --scene scene.toml --dem dem.tif --crs EPSG:32618 --resolution 60 -o out.tif",
    "rectify DJI_0042.JPG --takeoff-height dem --dem dem.tif --resolution 5 -o out.tif",
    "register image.tif --reference ortho.tif --scene scene.toml --dem dem.tif --position-sigma 20 "
    "--attitude-sigma 0.3 -o out",
]


@pytest.mark.costly
@pytest.mark.parametrize("line", SAID)
def test_json_has_every_sentence_that_is_printed(
    line: str, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of images and scenes, those of files, of defaults, and of what contradicts itself; of one run only."""
    monkeypatch.chdir(tmp_path)
    prepare(tmp_path, line)
    prepare(tmp_path, OTHER)
    before = CliRunner().invoke(app, OTHER.split())
    result = CliRunner().invoke(app, [*line.split(), "--json"])
    assert result.exit_code in (0, 1), result.output
    assumed = json.loads(result.stdout)["assumed"]
    assert len(assumed) == len(set(assumed))
    kinds = ("jaxgeo: assumed: ", "jaxgeo: check: ")
    printed = [one.split(": ", 2)[2] for one in result.stderr.splitlines() if one.startswith(kinds)]
    if "-o out.geojson" in line or "32618" in line:
        assert any("from the area of use of --crs" in one for one in printed), "a check"
    for one in printed:
        if not one.startswith("Standard deviations: "):
            left = one
            for sentence in sorted(assumed, key=len, reverse=True):
                left = left.replace(sentence.removeprefix("Check: ").removesuffix("."), "")
            assert not re.search(r"\w", left), left
    if "register" in line:
        assert json.loads((tmp_path / "out" / "report.json").read_text())["assumed"] == assumed
    assert CliRunner().invoke(app, OTHER.split()).stdout == before.stdout, "nothing is left of the run before"
