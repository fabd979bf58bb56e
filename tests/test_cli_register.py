"""The commands of images and maps: what they write is what the functions find, and mistakes are told in words."""

from __future__ import annotations

import json
import math
import pathlib
import shutil
import sys
import warnings
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import rasterio
import typer
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import Affine
from support.command_runner import CliRunner
from support.fractal import fractal_posts

from jaxgeo import FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot, locate, project
from jaxgeo.cli import app
from jaxgeo.cli._common import report_errors
from jaxgeo.cli._register_inputs import DEM_CORRELATION, DEM_SIGMA, FILES, LEAST_BLOCK, Sigmas, errors_of, new_results
from jaxgeo.cli.rectify import print_raster
from jaxgeo.demo import scene_file
from jaxgeo.earth import WGS84, R_ecef_from_enu, R_ecef_from_ned
from jaxgeo.io import MapRaster, example_dem, read_orthoimage, write_orthoimage
from jaxgeo.io.map_raster import checked_crs
from jaxgeo.io.rectified import RectifiedFile
from jaxgeo.io.scene import read_scene
from jaxgeo.ortho.rendering import render
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.plan import SIDES
from jaxgeo.status import Status
from jaxgeo.uncertainty.sources import TerrainHeight

DEM = str(pathlib.Path(scene_file()).with_name("jacksboro.tif"))
ROWS, COLS, FOCAL, CELL, SIDE = 192, 256, 300.0, 10.0, 400  # px; m and cells of the map
LAT, LON, HEIGHT = 36.29, -84.26, 3500.0
PLACE = Geodetic.from_degrees(lat=LAT, lon=LON, height=HEIGHT)
WEST, NORTH = 744_100.0, 4_021_600.0  # of the map, in zone 16 of UTM
AWAY, TURNED = (25.0, -20.0, 12.0), (0.2, -0.15, 0.1)  # m north, east, down; deg of heading, pitch, roll
SCENE = """
[camera]
width = {width}
height = 192
focal_px = 300.0
[pose]
lat_deg = {lat:.10f}
lon_deg = {lon:.10f}   # by the navigation
height_m = {height:.4f}
height_datum = "ellipsoid"
heading_deg = {heading}
pitch_deg = {pitch}
roll_deg = {roll}
"""


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def assert_refused(result, *words: str) -> None:
    assert result.exit_code == 2, result.output
    for word in words:
        assert word in result.stderr.replace("\n", " ")
    assert result.stderr.startswith("jaxgeo: ")


def true_shot() -> Shot:
    return Shot(Pose.from_degrees(lat=LAT, lon=LON, height=HEIGHT, heading=30.0, pitch=1.0, roll=-2.0))


def true_sensor() -> Sensor:
    return Sensor(FrameCamera.from_pixels(focal_px=FOCAL, width=COLS, height=ROWS), Gimbal.fixed(), Mount.nadir())


def write_scene(path: pathlib.Path, width: int = COLS) -> pathlib.Path:
    """With the errors of a navigation in it."""
    p_ecef = WGS84.to_ecef(PLACE) + R_ecef_from_ned(PLACE) @ jnp.asarray(AWAY)
    lat, lon, height = (float(x) for x in WGS84.to_geodetic(p_ecef).to_degrees())
    heading, pitch, roll = np.array([30.0, 1.0, -2.0]) + TURNED
    place = {"lat": lat, "lon": lon, "height": height, "width": width}
    path.write_text(SCENE.format(**place, heading=heading, pitch=pitch, roll=roll))
    return path


def write_map(path: pathlib.Path, seed: int, west: float = WEST) -> pathlib.Path:
    values = fractal_posts(SIDE, spacing=CELL, relief=200.0, exponent=2.2, seed=seed).astype(np.float32)
    raster = MapRaster(checked_crs("map", "EPSG:32616"), Affine(CELL, 0.0, west, 0.0, -CELL, NORTH), (SIDE, SIDE))
    write_orthoimage(path, values, raster)
    return path


def write_image(path: pathlib.Path, values: np.ndarray, transform: Affine | None = None) -> pathlib.Path:
    """Without a CRS, and unless `transform` is given on no map."""
    bands, rows, cols = values.shape
    profile = {"driver": "GTiff", "count": bands, "height": rows, "width": cols, "dtype": values.dtype.name}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile, transform=transform) as data:
            data.write(values)
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> dict[str, pathlib.Path]:
    """A map, the image of it from a known pose, and a scene with errors; another map, and one that lies elsewhere."""
    folder = tmp_path_factory.mktemp("registration")
    found = {
        "REFERENCE": write_map(folder / "reference.tif", seed=1),
        "OTHER": write_map(folder / "other.tif", seed=2),
        "AWAY": write_map(folder / "away.tif", seed=1, west=WEST + 10_000.0),
        "SCENE": write_scene(folder / "scene.toml"),
    }
    seen = render(true_sensor(), true_shot(), read_orthoimage(found["REFERENCE"]), example_dem())
    assert seen.known.all()
    found["IMAGE"] = write_image(folder / "image.tif", np.rint(seen.values).astype(np.uint8))
    return found


def register(files: dict[str, pathlib.Path], folder: pathlib.Path, *more: str, reference: str = "REFERENCE"):
    where = ("--reference", files[reference], "--dem", DEM, "--scene", files["SCENE"], "--output", folder)
    sigmas = ("--position-sigma", "30", "--attitude-sigma", "0.3", "--dem-sigma", "1")
    return run("register", files["IMAGE"], *where, *sigmas, *more)


def names_in(folder: pathlib.Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def off_ground(fix: dict[str, float], uv: tuple[float, float]) -> float:
    """How far, on the level plane, a fix of the report lies from what the pixel really sees, m."""
    true = locate(true_sensor(), true_shot(), uv, example_dem())
    found = Geodetic.from_degrees(lat=fix["lat_deg"], lon=fix["lon_deg"], height=fix["height_m"])
    east_north = (R_ecef_from_enu(true.position).T @ (WGS84.to_ecef(found) - true.ecef))[:2]
    return float(np.hypot(*np.asarray(east_north)))


@pytest.mark.slow
def test_register(files, tmp_path: pathlib.Path) -> None:
    """The folder holds the pose that made the image, and all that says so."""
    folder = tmp_path / "a" / "folder"
    result = register(files, folder, "--pixel", "40,150", "--pixel", "127.5,95.5")
    assert result.exit_code == 0, result.output
    assert names_in(folder) == {"scene.toml", "ties.geojson", "ortho.tif", "report.json", "registration.png"}
    assert Outcome.registered.message in result.stdout
    assert "jaxgeo: assumed: Standard deviations: reference position 10 m" in result.stderr
    report = json.loads((folder / "report.json").read_text())
    assert report["registered"]
    assert report["assumed"]
    assert report["inputs"]["sigmas"]["position"] == "30"
    for one, uv in zip(report["pixels"], [(40.0, 150.0), (127.5, 95.5)], strict=True):
        assert one["after"]["ce90_m"] < 0.7 * one["before"]["ce90_m"]
        assert off_ground(one["before"], uv) > 20.0
        assert off_ground(one["after"], uv) < 5.0  # m, half a cell
    check_scene(folder, files)
    check_ties(folder, report)
    check_ortho(folder, files)


def check_scene(folder: pathlib.Path, files: dict[str, pathlib.Path]) -> None:
    """A scene file that is read again has the shot: the line of sight is that of the image."""
    scene = read_scene(folder / "scene.toml")
    assert scene.shot is not None
    assert "# by the navigation" in (folder / "scene.toml").read_text(), "comments are kept"
    seen, true = (locate(true_sensor(), shot, (100.0, 50.0), example_dem()) for shot in (scene.shot, true_shot()))
    assert float(jnp.linalg.norm(seen.ecef - true.ecef)) < 5.0  # m


def check_ties(folder: pathlib.Path, report: dict) -> None:
    """Every block has a row; those that were left out have a reason."""
    rows = [feature["properties"] for feature in json.loads((folder / "ties.geojson").read_text())["features"]]
    chosen = [row for row in rows if row["chosen"]]
    assert len(chosen) == report["ties"]["count"] == report["passes"][-1]["agreeing"]
    assert all(row["reason"] for row in rows if not row["chosen"])
    residuals = [np.hypot(row["residual_column_px"], row["residual_row_px"]) for row in chosen]
    assert np.sqrt(np.mean(np.square(residuals))) == pytest.approx(report["ties"]["residuals_rms_px"], rel=1e-6)
    check_places(folder, report)


def check_places(folder: pathlib.Path, report: dict) -> None:
    """The file's places less the map's shift, seen from the file's pose, are its pixels less its residuals."""
    scene, unknowns = read_scene(folder / "scene.toml"), {one["name"]: one["change"] for one in report["unknowns"]}
    assert scene.shot is not None
    shift = jnp.asarray([unknowns["shift: east"], unknowns["shift: north"]])
    assert jnp.linalg.norm(shift) > 0.1  # m
    off = []
    for feature in json.loads((folder / "ties.geojson").read_text())["features"]:
        lon, lat, height = feature["geometry"]["coordinates"]
        row = feature["properties"]
        if row["chosen"]:
            shown = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
            p_ecef = WGS84.to_ecef(shown) - R_ecef_from_enu(shown)[:, :2] @ shift
            uv = project(scene.sensor, scene.shot, WGS84.to_geodetic(p_ecef)).uv
            residual = np.array([row["column"], row["row"]]) - np.asarray(uv)
            off.append(residual - [row["residual_column_px"], row["residual_row_px"]])
    np.testing.assert_allclose(off, 0.0, rtol=0, atol=1e-6)  # px


def check_ortho(folder: pathlib.Path, files: dict[str, pathlib.Path]) -> None:
    """The orthoimage lies on the very cells of the map, and shows the same."""
    with rasterio.open(folder / "ortho.tif") as done, rasterio.open(files["REFERENCE"]) as reference:
        offset = np.array([done.transform.c - WEST, NORTH - done.transform.f]) / CELL
        np.testing.assert_allclose(offset, np.rint(offset), rtol=0, atol=1e-6)
        col, row = (int(x) for x in np.rint(offset))
        known = done.read_masks(1) > 0
        there = reference.read(1)[row : row + done.height, col : col + done.width]
        assert known.sum() > 0.5 * ROWS * COLS
        assert np.corrcoef(done.read(1)[known], there[known])[0, 1] > 0.95  # bilinear twice


@pytest.mark.slow
def test_another_map_is_refused(files, tmp_path: pathlib.Path, monkeypatch) -> None:
    """Without a registration there is neither scene nor orthoimage, not even of an earlier one."""
    for name in ("scene.toml", "ortho.tif"):
        (tmp_path / name).write_text("of an earlier registration")
    result = register(files, tmp_path, "--json", reference="OTHER")
    assert result.exit_code == 1, result.output
    report = json.loads(result.stdout)
    assert report["outcome"] in (Outcome.no_agreement.name, Outcome.few_agree.name)
    assert "unknowns" not in report
    assert report["pixels"][0]["after"] == {"status": None}
    assert (
        {"report.json", "registration.png"} <= names_in(tmp_path) <= {"report.json", "registration.png", "ties.geojson"}
    )


@pytest.mark.slow
def test_a_map_elsewhere_and_no_matplotlib(files, tmp_path: pathlib.Path, monkeypatch) -> None:
    for name in [name for name in sys.modules if name.startswith("jaxgeo.plot")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    result = register(files, tmp_path, reference="AWAY")
    assert result.exit_code == 1, result.output
    assert Outcome.no_overlap.message in result.stdout
    assert "pip install 'jaxgeo[plot]'" in result.stderr
    assert names_in(tmp_path) == {"report.json"}


@pytest.mark.slow
def test_rectify(files, tmp_path: pathlib.Path) -> None:
    """Onto a map of its own, with a file of statuses; every cell is counted under its status."""
    output = tmp_path / "ortho.tif"
    arguments = ("--scene", files["SCENE"], "--dem", DEM, "--output", output, "--crs", "EPSG:32616")
    result = run("rectify", files["IMAGE"], *arguments, "--resolution", "12", "--status")
    assert result.exit_code == 0, result.output
    with rasterio.open(output) as done, rasterio.open(tmp_path / "ortho_status.tif") as codes:
        assert (done.transform.a, done.crs.to_epsg(), done.dtypes) == (12.0, 32616, ("uint8",))
        assert f"{done.height} rows of {done.width} cells of 12 metre, EPSG:32616" in result.stdout
        status = codes.read(1)
    told = {line.split()[1].rstrip(":"): int(line.split()[0]) for line in result.stderr.splitlines()[1:]}
    assert told == {Status(code).name: int(np.sum(status == code)) for code in np.unique(status)}


SIGMAS = ["--position-sigma", "30", "--attitude-sigma", "0.3"]
RECTIFY = ["rectify", "IMAGE", "--scene", "SCENE", "--dem", DEM, "--output", "out.tif"]
REGISTER = ["register", "IMAGE", "--reference", "MAP", "--dem", DEM, "--scene", "SCENE", "--output", "out"]
MISTAKES = [
    ([*RECTIFY[:1], "nowhere.tif", *RECTIFY[2:]], ["nowhere.tif: no such file"]),
    ([*RECTIFY[:1], "SCENE", *RECTIFY[2:]], ["not an image that GDAL can open"]),
    ([*RECTIFY[:-1], "out.png"], ["out.png", "ends in .tif"]),
    ([*RECTIFY[:-1], "no/such/folder/out.tif"], ["there is no folder no/such/folder"]),
    ([*RECTIFY, "--like", "MAP", "--crs", "EPSG:32616"], ["--like sets the grid"]),
    ([*RECTIFY, "--bounds", "1,2,3,4"], ["--bounds 1,2,3,4", "--crs"]),
    ([*RECTIFY, "--crs", "EPSG:32616", "--bounds", "1,2,3"], ["'1,2,3'", "WEST,SOUTH,EAST,NORTH"]),
    ([*RECTIFY, "--resolution", "fine"], ["'fine'", "ACROSS,DOWN"]),
    ([*RECTIFY[:3], "WIDE", *RECTIFY[4:]], ["256 columns", "257"]),
    ([*REGISTER, *SIGMAS[:1], "much", *SIGMAS[2:]], ["--position-sigma 'much'", "NORTH,EAST,DOWN"]),
    ([*REGISTER, *SIGMAS[:1], "1,2", *SIGMAS[2:]], ["'1,2'", "one number in m"]),
    ([*REGISTER, *SIGMAS[:3], "-0.3"], ["--attitude-sigma -0.3", "zero or more"]),
    ([*REGISTER, *SIGMAS[:3], "nan"], ["--attitude-sigma 'nan'", "one number in deg"]),
    ([*REGISTER, *SIGMAS[:3], "0"], ["--attitude-sigma 0", "above zero"]),
    ([*REGISTER, *SIGMAS, "--reference-sigma", "-1"], ["--reference-sigma -1"]),
    ([*REGISTER, *SIGMAS, "--dem-correlation", "-500"], ["--dem-correlation -500", "a distance must be zero or more"]),
    ([*REGISTER, *SIGMAS, "--gimbal-sigma", "0.1"], ["--gimbal-sigma 0.1", "is fixed"]),
    ([*REGISTER, *SIGMAS, "--focal-sigma", "5"], ["--focal-sigma '5'", "5px or 0.05mm"]),
    ([*REGISTER, *SIGMAS, "--focal-sigma", "5,2,2px"], ["--focal-sigma '5,2,2'", "--principal-sigma"]),
    ([*REGISTER, *SIGMAS, "--principal-sigma", "0px"], ["--principal-sigma", "leave out"]),
    ([*REGISTER, *SIGMAS, "--focal-sigma", "0.1mm"], ["in pixels", "in px"]),
    ([*REGISTER, *SIGMAS, "--pixel", "256,10"], ["--pixel 256,10", "outside the image of 256 x 192 pixels"]),
    ([*REGISTER, *SIGMAS, "--pixel", "10"], ["--pixel '10'", "COLUMN,ROW"]),
    ([*REGISTER, *SIGMAS, "--probability", "1"], ["--probability 1", "between 0.5 and 1"]),
    ([*REGISTER, *SIGMAS, "--probability", "0.01"], ["--probability 0.01", "outside the search window"]),
    ([*REGISTER, *SIGMAS, "--block", "8"], ["--block 8", "at least 32 cells"]),
    ([*REGISTER[:3], "NOCRS", *REGISTER[4:], *SIGMAS], ["without a CRS", "gdal_edit -a_srs"]),
    ([*REGISTER[:3], "IMAGE", *REGISTER[4:], *SIGMAS], ["on no map", "no geotransform"]),
    ([*REGISTER[:3], "nowhere.tif", *REGISTER[4:], *SIGMAS], ["nowhere.tif: no such file"]),
    ([*REGISTER[:7], "WIDE", *REGISTER[8:], *SIGMAS], ["256 columns", "257"]),
    ([*REGISTER[:7], "NOPOSE", *REGISTER[8:], *SIGMAS], ["[pose] is missing"]),
    ([*RECTIFY[:1], "NANS", *RECTIFY[2:]], ["band 2 is nowhere finite", "--band 1 --band 3"]),
    (
        [*RECTIFY, "--crs", "EPSG:32616", "--bounds", f"{WEST},4021000,744700,{NORTH}", "--resolution", "1e-4"],
        ["out.tif", "a resolution of 0.0001", "6e+06 x 6e+06 cells", "coarser"],
    ),
    ([*RECTIFY[:-1], "IMAGE"], ["image.tif: this is an input"]),
    ([*RECTIFY[:-1], "link.tif"], ["link.tif: this is an input"]),
    ([*RECTIFY[:-1], "MAP", "--like", "MAP"], ["map.tif: this is an input"]),
    ([*RECTIFY[:-1], "tile.tif", "--dem", "tile.tif"], ["tile.tif: this is an input"]),
    ([*RECTIFY[:5], "tiles.vrt", "--output", "tile.tif"], ["tile.tif: this is an input"]),
    ([*RECTIFY[:5], "tile*.tif", "--output", "tile.tif"], ["tile.tif: this is an input"]),
    ([*RECTIFY, "--dem-datum", "out.tif"], ["out.tif: this is an input"]),
    (
        [*RECTIFY[:1], "x_status.tif", *RECTIFY[2:-1], "x.tif", "--status"],
        ["x_status.tif: this is an input"],
    ),
    ([*REGISTER[:-1], ".", *SIGMAS], ["scene.toml: this is an input"]),
    ([*REGISTER[:-1], "taken", *SIGMAS], ["report.json is a folder"]),
    ([*REGISTER[:-1], "IMAGE", *SIGMAS], ["this is a file"]),
    ([*REGISTER, *SIGMAS, "--reference-band", "2"], ["there is no band 2"]),
]


VRT = """
<VRTDataset rasterXSize="9" rasterYSize="9"><VRTRasterBand dataType="Float32" band="1"><SimpleSource>
<SourceFilename relativeToVRT="1">tile.tif</SourceFilename><SourceBand>1</SourceBand>
</SimpleSource></VRTRasterBand></VRTDataset>
"""


def bands_of_which_one_is_empty() -> np.ndarray:
    values = np.ones((3, ROWS, COLS), np.float32)
    values[1] = np.nan
    return values


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> dict[str, pathlib.Path]:
    """Files that are sound, and some that are not."""
    folder = tmp_path_factory.mktemp("inputs")
    on_a_map = Affine(CELL, 0.0, WEST, 0.0, -CELL, NORTH)
    found = {
        "IMAGE": write_image(folder / "image.tif", np.ones((1, ROWS, COLS), np.uint8)),
        "MAP": write_map(folder / "map.tif", seed=1),
        "NOCRS": write_image(folder / "nocrs.tif", np.ones((1, 9, 9), np.uint8), on_a_map),
        "SCENE": write_scene(folder / "scene.toml"),
        "WIDE": write_scene(folder / "wide.toml", width=COLS + 1),
        "NOPOSE": folder / "nopose.toml",
        "NANS": write_image(folder / "nans.tif", bands_of_which_one_is_empty()),
    }
    write_image(folder / "x_status.tif", np.ones((1, ROWS, COLS), np.uint8))
    (folder / "link.tif").symlink_to(found["IMAGE"])
    shutil.copy(DEM, folder / "tile.tif")
    (folder / "tiles.vrt").write_text(VRT)
    (folder / "taken" / "report.json").mkdir(parents=True)
    text = found["SCENE"].read_text()
    found["NOPOSE"].write_text(text[: text.index("[pose]")] + '[shots]\nheight_datum = "ellipsoid"\n')
    return found


@pytest.mark.costly
@pytest.mark.parametrize("arguments, words", MISTAKES, ids=[f"{k}-{one[0][0]}" for k, one in enumerate(MISTAKES)])
def test_mistakes(inputs, monkeypatch, arguments: list[str], words: list[str]) -> None:
    folder = inputs["SCENE"].parent
    monkeypatch.chdir(folder)
    before = names_in(folder)
    assert_refused(run(*(inputs.get(argument, argument) for argument in arguments)), *words)
    assert names_in(folder) == before


@pytest.mark.parametrize("dem, length", [(None, None), (3.0, None), (3.0, 80.0), (3.0, 0.0), (0.0, None)])
def test_half_of_the_variance_of_heights_is_common_to_all(dem: float | None, length: float | None) -> None:
    sigmas = Sigmas(position="30", attitude="0.3", reference=1.0, registration=0.5, dem=dem, dem_correlation=length)
    found = errors_of(sigmas, SimpleNamespace(errors=None), pathlib.Path("scene.toml"), 1.0)
    expected = DEM_SIGMA if dem is None else dem
    common = [float(source.sigma[0]) for source in found.sources if isinstance(source, TerrainHeight)]
    assert sum(one**2 for one in common) == pytest.approx(expected**2 / 2.0)
    field = found.tie_errors.terrain_field
    alone = float(found.tie_errors.terrain)
    assert found.terrain == pytest.approx(expected / math.sqrt(2.0))
    assert (field is None) == (length == 0.0 or dem == 0.0)
    if field is None:
        assert alone == pytest.approx(found.terrain)
    else:
        apart = DEM_CORRELATION if length is None else length
        both = np.asarray(field.variance_at(jnp.array([0.0, apart]))) / found.terrain**2
        assert alone == 0.0
        assert both[0] == pytest.approx(1.0)
        assert 0.01 < both[1] < 0.5
    assert ("--dem-correlation" in "; ".join(found.assumed)) == (length is None and dem != 0.0)


def test_the_least_block_is_the_smallest_that_is_used() -> None:
    assert min(SIDES) == LEAST_BLOCK


def test_cells_of_a_turned_raster_have_their_own_size(capsys) -> None:
    turned = Affine.translation(WEST, NORTH) @ Affine.rotation(20.0) @ Affine.scale(10.0, -5.0)
    raster = MapRaster(checked_crs("map", "EPSG:32616"), turned, (3, 4))
    print_raster(RectifiedFile("out.tif", raster, 12, {Status.hit: 12}), 1.0)
    assert "3 rows of 4 cells of 10 x 5 metre" in capsys.readouterr().out


@pytest.mark.parametrize(
    "error, words",
    [
        (MemoryError("Unable to allocate 7 TiB for an array"), "(Unable to allocate 7 TiB for an array)"),
        (MemoryError(), "out of memory;"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory\nallocating 9 bytes."), "Out of memory allocating 9 bytes"),
    ],
)
def test_a_lack_of_memory_is_one_line(capsys, error: Exception, words: str) -> None:
    with pytest.raises(typer.Exit) as end, report_errors(debug=False):
        raise error
    assert end.value.exit_code == 2
    told = capsys.readouterr().err
    assert words in told.replace("\n", " ")
    assert told.startswith("jaxgeo: out of memory")
    with pytest.raises(typer.Exit), report_errors(debug=True):
        raise error
    assert capsys.readouterr().err.startswith("Traceback")


def test_other_failures_are_told_as_faults_of_the_program(capsys) -> None:
    with pytest.raises(typer.Exit) as end, report_errors(debug=False):
        raise RuntimeError("mine\nand mine")
    assert end.value.exit_code == 70
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith("jaxgeo: internal error: unexpected RuntimeError (mine and mine);")
    assert "--debug" in told


def test_earlier_results_go_when_new_ones_are_there_and_not_before(tmp_path: pathlib.Path) -> None:
    for name in (*FILES[:3], "mine.txt"):
        (tmp_path / name).write_text("earlier")

    def fail() -> None:
        with new_results(tmp_path):
            (tmp_path / FILES[0]).write_text("new")
            (tmp_path / FILES[4]).write_text("new")
            raise MemoryError

    with pytest.raises(MemoryError):
        fail()
    assert names_in(tmp_path) == {*FILES[:3], "mine.txt"}
    assert {path.read_text() for path in tmp_path.iterdir()} == {"earlier"}
    with new_results(tmp_path):
        (tmp_path / FILES[0]).write_text("new")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {FILES[0]: "new", "mine.txt": "earlier"}
