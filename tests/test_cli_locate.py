"""`jaxgeo locate FILE`: from what a camera or an aircraft wrote to fixes and how sure they are, in one command."""

from __future__ import annotations

import json
import pathlib

import jax
import numpy as np
import pyogrio
import pyproj
import pytest
from support.command_files import prepare
from support.command_runner import CliRunner
from support.drone_image_files import packet, write_image
from support.miaoli import FRAMES, UNDULATION, Village

import jaxgeo
from jaxgeo.cli import app
from jaxgeo.cli._errors import interior_errors
from jaxgeo.cli._locate_results import fixes_table
from jaxgeo.demo import scene_file
from jaxgeo.earth import WGS84
from jaxgeo.io import read_acquisition, with_usual_errors
from jaxgeo.uncertainty import accuracy, sources

DEM = str(pathlib.Path(scene_file()).with_name("jacksboro.tif"))
DJI = {
    "drone-dji:AbsoluteAltitude": "+700.0",
    "drone-dji:RelativeAltitude": "+99.9",
    "drone-dji:GpsLatitude": "+36.318",
    "drone-dji:GpsLongitude": "-84.105",
    "drone-dji:GimbalYawDegree": "+160.00",
    "drone-dji:GimbalPitchDegree": "-60.00",
    "drone-dji:GimbalRollDegree": "+0.00",
    "drone-dji:CalibratedFocalLength": "3666.67",
}
GROUND = ["--ground", "300", "--camera-datum", "ellipsoid"]


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, ["locate", *(str(argument) for argument in arguments)])


@pytest.fixture(scope="module")
def image(tmp_path_factory) -> pathlib.Path:
    path = tmp_path_factory.mktemp("images") / "DJI_0042.JPG"
    write_image(path, packet(DJI), make="DJI")
    return path


def as_json(*arguments: str | pathlib.Path) -> dict:
    result = run(*arguments, "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


def test_an_image_is_located_as_by_the_library(tmp_path: pathlib.Path) -> None:
    prepare(tmp_path, "DJI_0042.JPG")
    image = tmp_path / "DJI_0042.JPG"
    told = as_json(image, *GROUND, "--pixel", "10,20", "--dem-sigma", "2")
    (row,) = told["fixes"]
    found = with_usual_errors(read_acquisition(image, height_datum="ellipsoid"))
    sensor, shot, errors = found.exposure(0)
    sure = accuracy(
        sensor, shot, (10.0, 20.0), jaxgeo.ConstantHeight(300.0), (*errors, sources.TerrainHeight.from_metres(2.0))
    )
    assert (row["name"], row["u"], row["v"], row["status"]) == ("DJI_0042.JPG", 10.0, 20.0, "hit")
    assert row["fix_lat_deg"] == pytest.approx(float(np.rad2deg(sure.fix.position.lat)), abs=1e-9)
    assert row["fix_height_m"] == pytest.approx(300.0, abs=1e-3)
    assert row["ce90_m"] == pytest.approx(float(sure.circular), rel=1e-3)
    assert row["accuracy_method"] == sure.words
    sentences = " ".join(told["assumed"])
    assert "Position sigma: 3, 3, 5 m" in sentences
    assert "--gimbal-sigma" in sentences
    assert "--dem-sigma" not in sentences, "it was given"


@pytest.mark.costly
def test_the_table_on_the_screen_fits_and_says_the_status(tmp_path: pathlib.Path) -> None:
    prepare(tmp_path, "DJI_0042.JPG")
    result = run(tmp_path / "DJI_0042.JPG", *GROUND, "--dem-sigma", "2", "--pixel", "10,10", "--pixel=-10,10")
    assert result.exit_code == 0, result.stderr
    assert "outside_image" in result.stdout
    assert "hit" in result.stdout


@pytest.mark.costly
@pytest.mark.parametrize("sigmas", [[], ["--dem-sigma", "2"]])
def test_a_camera_below_the_ground_is_told_with_both_heights(image: pathlib.Path, sigmas: list[str]) -> None:
    """The image is 700 m above the ellipsoid."""
    result = run(image, "--camera-datum", "ellipsoid", "--ground", "845", "--dem-datum", "ellipsoid", *sigmas)
    assert result.exit_code == 1, result.output
    assert "camera is at 700.0 m, the ground at 845.0 m above the ellipsoid, 145.0 m higher." in result.stderr


@pytest.mark.slow
def test_what_is_typed_takes_the_place_of_what_is_assumed(image: pathlib.Path) -> None:
    sigmas = ["--position-sigma", "0", "--gimbal-sigma", "0.5", "--dem-sigma", "0", "--focal-sigma", "0px"]
    sigmas += ["--principal-sigma", "0px"]
    once, twice = (as_json(image, *GROUND, *sigmas[:3], size, *sigmas[4:]) for size in ("0.5", "1.0"))
    assert twice["fixes"][0]["ce90_m"] == pytest.approx(2.0 * once["fixes"][0]["ce90_m"], rel=1e-4)
    assert not any(" err by " in one or "sigma:" in one for one in once["assumed"])
    wide = as_json(image, *GROUND, *sigmas, "--probability", "0.5")["fixes"][0]
    assert wide["ce50_m"] < once["fixes"][0]["ce90_m"]


@pytest.mark.costly
def test_without_accuracy_there_is_a_fix_alone(image: pathlib.Path) -> None:
    told = as_json(image, *GROUND, "--no-accuracy")
    assert "ce90_m" not in told["fixes"][0]
    assert not any("err by" in one or "sigma:" in one for one in told["assumed"])


@pytest.mark.costly
@pytest.mark.parametrize("ending", [".csv", ".geojson", ".gpkg", ".parquet", ".kml", ".kmz"])
def test_every_format_by_the_name_of_the_file(image: pathlib.Path, tmp_path: pathlib.Path, ending: str) -> None:
    output = tmp_path / f"fixes{ending}"
    more = [] if ending.startswith(".km") else ["--crs", "EPSG:32616", "--heights", "EPSG:5773", "--mgrs"]
    result = run(image, *GROUND, "--dem-sigma", "2", "-o", output, *more)
    assert result.exit_code == 0, result.stderr
    assert output.stat().st_size > 100
    if ending == ".gpkg":
        _, _, shapes, columns = pyogrio.raw.read(output, layer="fixes")
        assert len(shapes) == 1
        assert pyproj.CRS(pyogrio.read_info(output, layer="ellipses")["crs"]).to_epsg() == 32616
        assert any(str(column[0]).startswith("16S") for column in columns)


def test_level_ground_above_a_datum(image: pathlib.Path) -> None:
    level, geoid = (
        as_json(image, "--ground", "300", "--camera-datum", "ellipsoid", *more, "--no-accuracy")["fixes"][0]
        for more in ([], ["--dem-datum", "EPSG:5773"])
    )
    assert geoid["fix_height_msl_m"] == pytest.approx(300.0, abs=1e-2)
    assert level["fix_height_m"] == pytest.approx(300.0, abs=1e-3)


@pytest.mark.costly
def test_the_air_bends_lines_of_sight(image: pathlib.Path) -> None:
    straight, bent = (
        as_json(image, *GROUND, "--no-accuracy", *more)["fixes"][0]["slant_range_m"] for more in ([], ["--refraction"])
    )
    assert 0.0 < straight - bent < 0.1


@pytest.mark.costly
def test_no_fix_at_all_is_told_with_the_reason(image: pathlib.Path) -> None:
    far = image.with_name("far.JPG")
    write_image(far, packet(DJI | {"drone-dji:GpsLatitude": "+46.0", "drone-dji:GpsLongitude": "+8.0"}), make="DJI")
    result = run(far, "--dem", DEM, "--camera-datum", "ellipsoid", "--no-accuracy")
    assert result.exit_code == 1
    assert "ray_misses_terrain" in result.stdout
    (line,) = [line for line in result.stderr.splitlines() if "no pixel has a fix" in line]
    assert "deg north" in line
    assert "km beside it" in line


ROWS = [
    {"name": f"{k}", "u": 1.0, "v": 2.0, "fix_lat_deg": 47.0, "fix_lon_deg": 11.0, "fix_height_m": 300.0}
    | {"fix_height_msl_m": 250.0, "slant_range_m": 100.0, "incidence_surface_deg": 3.0, "status": "hit"}
    for k in range(2)
]
TIMES = {
    "one day": (
        ["2024-05-10T10:20:31.500Z", "2024-05-10T10:20:32.000Z"],
        "time, UTC",
        "10:20:31.500",
        "on 2024-05-10;",
    ),
    "two days": (
        ["2024-05-10T23:59:59.500Z", "2024-05-11T00:00:00.000Z"],
        "time, UTC",
        "2024-05-10T23:59:59.500Z",
        "on 2024-05-10 to 2024-05-11;",
    ),
    "seconds": ([3.5, 4.25], "time, s", "3.500", ""),
    "one time": ([3.5, 3.5], "", "", ""),
    "none": ([None, None], "", "", ""),
}


@pytest.mark.parametrize("times, header, cell, caption", TIMES.values(), ids=list(TIMES))
def test_several_frames_have_their_times_in_the_table(times: list, header: str, cell: str, caption: str) -> None:
    key = "time_utc" if isinstance(times[0], str) else "time_s"
    table = fixes_table([row | {key: time} for row, time in zip(ROWS, times, strict=True)], None, 200)
    assert table.columns.get("time", ("", ""))[0] == header
    if header:
        spec = table.columns["time"][1]
        assert format(table.rows[0]["time"], spec) == cell
        assert caption in table.caption


WRONG = [
    (
        ["{image}", "--ground", "300"],
        ["vertical datum of its altitude is not stated", 'Give --camera-datum: "ellipsoid"'],
    ),
    (["{image}", "--camera-datum", "ellipsoid"], ["give the ground", "--dem FILE", "--ground HEIGHT"]),
    (["{image}", *GROUND, "--dem", DEM], ["--dem and --ground exclude each other"]),
    (["{image}", "--ground", "high", "--camera-datum", "ellipsoid"], ["--ground 'high'", "a height in m"]),
    (
        ["{image}", "--ground", "reported", "--camera-datum", "ellipsoid"],
        ["--ground reported", "reports no frame centre height"],
    ),
    (["{image}", *GROUND, "--exposure", "DJI_0043.JPG"], ["--exposure DJI_0043.JPG", "known: DJI_0042.JPG"]),
    (
        ["{image}", *GROUND, "--attitude-sigma", "1"],
        ["--attitude-sigma 1", "relative to the horizon", "--gimbal-sigma"],
    ),
    (["{image}", *GROUND, "--gimbal-sigma", "1,2"], ["--gimbal-sigma '1,2'", "YAW,PITCH,ROLL"]),
    (["{image}", *GROUND, "--dem-sigma", "-1"], ["--dem-sigma -1", "zero or more"]),
    (["{image}", *GROUND, "--dem-correlation", "100"], ["--dem-correlation", "level ground"]),
    (["{image}", *GROUND, "--no-accuracy", "--gimbal-sigma", "1"], ["--no-accuracy", "leave one out"]),
    (["{image}", *GROUND, "--probability", "90"], ["--probability 90", "between 0 and 1"]),
    (["{image}", *GROUND, "--scene", str(scene_file())], ["40 x 30 pixels, the camera given 2400 x 4800", "shape"]),
    (["{image}", *GROUND, "--focal-sigma", "5,2,2px"], ["--focal-sigma '5,2,2'", "--principal-sigma"]),
    (["{image}", *GROUND, "--mgrs"], ["--crs, --heights and --mgrs need --output"]),
    (["{image}", *GROUND, "--shots", "shots.csv"], ["--shots shots.csv", "--scene"]),
    (["{image}", *GROUND, "-o", "{image}"], ["--output", "unsupported file type .JPG"]),
    (["--ground", "300"], ["give a FILE", "--scene"]),
    ([str(scene_file()), "--dem", DEM, "--camera-datum", "ellipsoid"], ["--camera-datum", "leave it out"]),
    ([str(scene_file()), "--dem", DEM, "--exposure", "a"], ["--exposure", "a scene has only one"]),
    (["nowhere.JPG", *GROUND], ["nowhere.JPG", "no such file"]),
]


@pytest.mark.parametrize("arguments, words", WRONG, ids=[" ".join(words)[:40] for _, words in WRONG])
def test_mistakes_are_one_line(image: pathlib.Path, arguments: list[str], words: list[str]) -> None:
    result = run(*(argument.format(image=image) for argument in arguments))
    assert result.exit_code == 2, result.output
    (line,) = [line for line in result.stderr.splitlines() if "assumed:" not in line]
    assert line.startswith("jaxgeo: ")
    for word in words:
        assert word in line


def test_an_input_is_not_overwritten(tmp_path: pathlib.Path) -> None:
    table, scene = tmp_path / "shots.csv", scene_file()
    header = "lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,gimbal_outer_deg,gimbal_inner_deg,u,v"
    table.write_text(f"{header}\n36.318,-84.105,5500,160,1,-0.5,72,0,1199.5,2399.5\n")
    result = run("--scene", scene, "--dem", DEM, "--shots", table, "--output", table)
    assert result.exit_code == 2
    assert "this is an input" in result.stderr
    assert table.read_text().startswith("lat_deg")


@pytest.mark.slow
def test_drone_images_of_a_real_flight(jaxgeo_test_data: pathlib.Path) -> None:
    """The fix by the tags lies within what it says of itself of that by the pose which OpenSfM found, on one DSM."""
    village = Village.of(jaxgeo_test_data)
    images, dsm = village.folder / "images", village.folder / "dsm.tif"
    datum = f"{UNDULATION}"
    told = as_json(images, "--camera-datum", datum, "--dem", dsm, "--dem-datum", datum)
    assert [pathlib.Path(row["name"]).stem for row in told["fixes"]] == list(FRAMES)
    for row in told["fixes"]:
        shot = village.shots[pathlib.Path(row["name"]).stem]
        truth = jaxgeo.locate(village.sensor, shot, (row["u"], row["v"]), village.terrain)
        place = jaxgeo.Geodetic.from_degrees(lat=row["fix_lat_deg"], lon=row["fix_lon_deg"], height=row["fix_height_m"])
        off = float(np.linalg.norm(np.asarray(WGS84.to_ecef(place)) - np.asarray(truth.ecef)))
        assert off < 3.0  # m
        assert off < row["se90_m"]
        assert 1.0 < row["ce90_m"] < 8.0


@pytest.mark.slow
def test_telemetry_of_a_real_flight(jaxgeo_test_data: pathlib.Path) -> None:
    told = as_json(jaxgeo_test_data / "telemetry_klv" / "Cheyenne.bin", "--ground", "reported")
    assert len(told["fixes"]) == 407
    found = read_acquisition(jaxgeo_test_data / "telemetry_klv" / "Cheyenne.bin")
    assert found.reported is not None
    centre = np.stack([np.rad2deg(found.reported.centre.lat), np.rad2deg(found.reported.centre.lon)], axis=-1)
    fixes = np.array([[row["fix_lat_deg"], row["fix_lon_deg"]] for row in told["fixes"]])
    _, _, off = pyproj.Geod(ellps="WGS84").inv(fixes[:, 1], fixes[:, 0], centre[:, 1], centre[:, 0])
    radii = np.array([row["ce90_m"] for row in told["fixes"]])
    assert np.median(off) < 10.0  # m
    assert np.mean(off < radii) > 0.9
    ranges = np.array([row["slant_range_m"] for row in told["fixes"]])
    assert np.median(np.abs(ranges - found.reported.slant_range)) < 10.0


@pytest.mark.slow
def test_poses_alone_with_the_camera_of_a_scene(tmp_path: pathlib.Path) -> None:
    """An SBET has no camera: one of a scene takes the pictures, its gimbal held, errors by the scene."""
    record = np.zeros((3, 17))
    record[:, 0] = [10.0, 11.0, 12.0]
    record[:, 1], record[:, 2] = np.deg2rad(36.318), np.deg2rad(-84.105 + 1e-4 * np.arange(3))
    record[:, 3], record[:, 9] = 5469.0, np.deg2rad(160.0)
    path = tmp_path / "mission.sbet"
    record.astype("<f8").tofile(path)
    given = [path, "--camera-datum", "ellipsoid", "--ground", "500"]
    result = run(*given)
    assert result.exit_code == 2
    assert "there is no camera in a SBET" in result.stderr or "no camera" in result.stderr
    told = as_json(*given, "--scene", scene_file())
    assert [row["time_s"] for row in told["fixes"]] == [10.0, 11.0, 12.0]
    assert all(row["status"] == "hit" for row in told["fixes"])
    assert any("Gimbal readings are held" in one for one in told["assumed"])
    assert not any("Position" in one and ("err" in one or "sigma" in one) for one in told["assumed"]), (
        "the scene says how they err"
    )
    lon = [row["fix_lon_deg"] for row in told["fixes"]]
    assert lon == sorted(lon)


def test_usual_errors_are_told_and_stated_ones_kept(image: pathlib.Path) -> None:
    found = read_acquisition(image, height_datum="ellipsoid")
    usual = with_usual_errors(found)
    kinds = [type(source) for source in usual.sources]
    assert kinds == [sources.InteriorOrientation, sources.Position, sources.GimbalAngles]
    assert len(usual.assumed) == len(found.assumed) + 2
    again = with_usual_errors(usual)
    assert again.assumed == usual.assumed
    assert jax.tree.structure(again.sources) == jax.tree.structure(usual.sources)


@pytest.mark.parametrize("lanes", [None, 2])
def test_focal_length_and_principal_point_err_apart(lanes: int | None) -> None:
    """What is not typed stays as the file states it, for each image, or does not err."""
    where, pixels = pathlib.Path("scene.toml"), np.array([80.0, 20.0, 20.0])
    sigma = pixels if lanes is None else np.tile(pixels, (lanes, 1))
    make = sources.InteriorOrientation
    stated = make(sigma) if lanes is None else jax.vmap(make)(sigma)
    for focal, principal, given, expected in [
        ("5px", None, stated, [5.0, 20.0, 20.0]),
        (None, "2,3px", stated, [80.0, 2.0, 3.0]),
        ("0.012mm", "0.024mm", stated, [5.0, 10.0, 10.0]),
        ("5px", None, None, [5.0, 0.0, 0.0]),
        (None, "2px", None, [0.0, 2.0, 2.0]),
    ]:
        found = interior_errors(focal, principal, where, 0.0024, given)
        shape = sigma.shape if given is stated else (3,)
        np.testing.assert_allclose(found.sigma, np.broadcast_to(expected, shape), rtol=1e-12)
    assert interior_errors("0px", "0px", where, None, stated) is None
