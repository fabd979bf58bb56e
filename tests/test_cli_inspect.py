"""`jaxgeo inspect`: each kind of file told by its content, and what its reader says of it."""

from __future__ import annotations

import csv
import json
import pathlib
import re
import shlex
from collections.abc import Callable

import numpy as np
import pytest
from support.autopilot_logs import AT, dataflash, ulog
from support.command_files import prepare
from support.command_runner import CliRunner
from support.drone_image_files import packet, write_image
from support.klv_packets import local_set, usual
from support.video_files import written_video

from jaxgeo.cli import app
from jaxgeo.cli._option_names import as_typed
from jaxgeo.demo import scene_file
from jaxgeo.io import TableError, read_acquisition
from jaxgeo.io.acquisitions.detect import form_of
from jaxgeo.io.tables import read_shots
from jaxgeo.uncertainty.sources import InteriorOrientation
from tests.io.test_colmap_models import CENTRE_ENU, ENU, R_ENU, pose_words, write_binary
from tests.io.test_flight_log_programs import litchi, reader
from tests.io.test_flight_logs import airdata, subtitles
from tests.io.test_metashape_cameras import document, placed
from tests.io.test_micmac_orientations import calibration, orientation
from tests.io.test_pix4d_cameras import project

DJI = {
    "drone-dji:AbsoluteAltitude": "+153.9",
    "drone-dji:RelativeAltitude": "+99.9",
    "drone-dji:GpsLatitude": "+24.68",
    "drone-dji:GpsLongitude": "+120.95",
    "drone-dji:GimbalYawDegree": "-97.40",
    "drone-dji:GimbalPitchDegree": "-35.50",
    "drone-dji:GimbalRollDegree": "+0.00",
    "drone-dji:RtkStdLon": "0.0097",
    "drone-dji:RtkStdLat": "0.0093",
    "drone-dji:RtkStdHgt": "0.0238",
    "drone-dji:CalibratedFocalLength": "3666.67",
}
TABLE = "image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg\na,43.7,4.6,1800.0,350.0,30.0,-1.5\n"
OPK = "'filename' 'x' 'y' 'z' 'omega' 'phi' 'kappa'\n'a' 292710.2 2731048.8 186.4 28.8 0.9 1.8\n"
PATB = (
    "             101                    751000.00000   4020000.00000       900.50000\n"
    "  0.000000000000 -1.000000000000  0.000000000000  1.000000000000  0.000000000000\n"
    "  0.000000000000  0.000000000000  0.000000000000  1.000000000000\n"
)
CAMERA = {"projection_type": "perspective", "width": 800, "height": 600, "focal": 0.9}
RECONSTRUCTION = [
    {
        "cameras": {"one": CAMERA},
        "shots": {"a": {"rotation": [2.9, 0.4, -0.2], "translation": [0.0, 5.0, 100.0], "camera": "one"}},
        "points": {},
        "reference_lla": {"latitude": 24.6801, "longitude": 120.9512, "altitude": 12.5},
    }
]
CLIMB = [0.0, 1.0, 0.1, 100.0, 0.0, 0.0, 0.0, 0.01, 0.02, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]


def of_image(path: pathlib.Path) -> None:
    write_image(path, packet(DJI), make="DJI")


def of_text(text: str) -> Callable[[pathlib.Path], object]:
    return lambda path: path.write_text(text, encoding="utf-8")


def of_bytes(content: bytes) -> Callable[[pathlib.Path], object]:
    return lambda path: path.write_bytes(content)


def of_colmap(path: pathlib.Path) -> None:
    write_binary(path.parent, "OPENCV", pose_words(R_ENU, CENTRE_ENU))


def of_micmac(path: pathlib.Path) -> None:
    path.write_text(orientation(R_ENU, CENTRE_ENU), encoding="utf-8")
    (path.parent / "AutoCal_Foc-8800_Cam-X.xml").write_text(calibration(), encoding="utf-8")


PACKETS = local_set(usual()) + local_set(usual(tag_5=200.0))
FILES = {  # name of a file: how it is made, what it is, options of its reader, those of the command
    "photo.jpg": (of_image, "drone image", {"height_datum": "ellipsoid"}),
    "photo.tif": (of_image, "drone image", {"takeoff_height": 54.0}),
    "video.bin": (of_bytes(b"noise" + PACKETS), "MISB ST 0601 telemetry", {"image_size": (640, 480)}),
    "scene.toml": (of_bytes(scene_file().read_bytes()), "scene file", {}),
    "flight.sbet": (of_bytes(np.array(CLIMB, "<f8").tobytes()), "SBET", {}),
    "eo.csv": (of_text(TABLE), "table of orientations", {"height_datum": "ellipsoid"}),
    "opk.txt": (of_text(OPK), "table of orientations", {"height_datum": "ellipsoid", "crs": "EPSG:32651"}),
    "clip.srt": (of_text(subtitles()), "subtitle file of DJI", {"height_datum": "ellipsoid"}),
    "clip.mp4": (of_bytes(written_video([(0.0, subtitles())])), "video of DJI", {"height_datum": "ellipsoid"}),
    "flight.csv": (of_text(airdata()), "flight log of AirData", {"takeoff_height": 54.0}),
    "litchi.csv": (of_text(litchi()), "flight log of Litchi", {"takeoff_height": 54.0}),
    "reader.csv": (of_text(reader()), "flight log of Flight Reader", {"height_datum": "ellipsoid"}),
    "flight.bin": (of_bytes(dataflash([AT])), "flight log of ArduPilot", {"takeoff_height": 54.0}),
    "flight.ulg": (of_bytes(ulog([[1.0, 0.0, 0.0, 0.0]])), "flight log of PX4", {"height_datum": "ellipsoid"}),
    "cameras.xml": (of_text(document(placed()[0])), "camera file of Metashape", {}),
    "Orientation-a.JPG.xml": (of_micmac, "orientation of MicMac", {"height_datum": "ellipsoid", "crs": ENU}),
    "field_calibrated_camera_parameters.txt": (
        lambda path: project(path.parent),
        "camera parameters of Pix4D",
        {"height_datum": "ellipsoid", "crs": ENU},
    ),
    "images.bin": (of_colmap, "model of COLMAP", {"height_datum": "ellipsoid", "crs": ENU}),
    "micmac.txt": (
        of_text("#F=N Y X Z K W P\na 36.3 -84.2 900.0 30 -20 0\n"),
        "table of orientations",
        {"height_datum": "ellipsoid", "crs": "EPSG:4326"},
    ),
    "block.ori": (
        of_text(PATB),
        "table of orientations",
        {"height_datum": "ellipsoid", "crs": "EPSG:32616"},
    ),
    "itera.dat": (
        of_text("ORIA 101 751000.0 4020000.0 900.5 -1.333 0.556 99.2 1\n"),
        "table of orientations",
        {"height_datum": "ellipsoid", "crs": "EPSG:32616"},
    ),
    "r.json": (of_text(json.dumps(RECONSTRUCTION)), "reconstruction of OpenSfM", {"height_datum": 19.6}),
}
OPTIONS = {"crs": "--source-crs", "height_datum": "--camera-datum"}


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, ["inspect", *(str(argument) for argument in arguments)])


def typed(how: dict[str, object]) -> list[str]:
    """Options of a reader, as they are typed."""
    words = []
    for name, value in how.items():
        text = ",".join(map(str, value)) if isinstance(value, tuple) else str(value)
        words += [OPTIONS.get(name, "--" + name.replace("_", "-")), text]
    return words


@pytest.mark.costly
@pytest.mark.parametrize("name", FILES)
def test_a_file_is_told_by_its_content_and_shown(tmp_path: pathlib.Path, name: str) -> None:
    make, form, how = FILES[name]
    path = tmp_path / name
    make(path)
    assert form_of(path).name == form
    found = read_acquisition(path, **how)
    result = run(path, *typed(how), "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.output)
    assert told["form"] == found.form
    assert told["height_datum_unstated"] is None
    assert told["assumed"] == list(map(as_typed, found.assumed))
    np.testing.assert_array_equal([row["name"] for row in told["exposures"]], found.names)
    height = [row["height_m"] for row in told["exposures"]]
    np.testing.assert_allclose(height, found.shots.pose.position.height, atol=1e-9)
    heading = np.deg2rad([row["heading_deg"] for row in told["exposures"]])
    np.testing.assert_allclose(heading, found.shots.pose.heading, atol=1e-12)
    assert (told["sensor"] is None) == (found.sensor is None)
    shown = run(path, *typed(how))
    assert shown.exit_code == 0
    for word in (found.form, *(str(name) for name in found.names), "errors: ", "assumed"):
        assert word in shown.output or (word == "assumed" and not found.assumed)


WITH_CAMERA = "focal=8.8mm,pitch=2.41um,size=5472x3648"
CAMERA_GIVEN = {  # have none
    *(
        "eo.csv",
        "opk.txt",
        "clip.srt",
        "clip.mp4",
        "flight.csv",
        "litchi.csv",
        "reader.csv",
        "micmac.txt",
        "block.ori",
        "itera.dat",
        "flight.bin",
        "flight.ulg",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_the_lens_of_every_camera_has_an_error_or_a_sentence(tmp_path: pathlib.Path, name: str) -> None:
    """So that nothing assumed of a camera moves a fix without a word."""
    make, _, how = FILES[name]
    path = tmp_path / name
    make(path)
    for more in ({}, {"camera": WITH_CAMERA}) if name in CAMERA_GIVEN else ({},):
        found = read_acquisition(path, **how, **more)
        assert (found.sensor is None) == (name == "flight.sbet" or (name in CAMERA_GIVEN and not more))
        has_errors = any(isinstance(one, InteriorOrientation) for one in found.sources)
        is_told = any("without error" in one or "no accuracies are given" in one for one in found.assumed)
        assert found.sensor is None or has_errors or is_told or (name == "scene.toml" and found.sources)


def test_heights_whose_datum_nobody_says_are_shown_with_that(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "photo.jpg"
    of_image(path)
    result = run(path)
    assert result.exit_code == 0
    words = " ".join(result.output.split())
    for word in ("153.90", "Vertical datum unknown", "--camera-datum", "--takeoff-height", "AbsoluteAltitude"):
        assert word in words
    assert "height_datum=" not in words
    refused = run(path, "--output", tmp_path / "shots.csv")
    assert refused.exit_code == 2
    assert "--camera-datum" in refused.output
    assert not (tmp_path / "shots.csv").exists()


def test_exposures_become_a_table_of_shots(tmp_path: pathlib.Path) -> None:
    path, output = tmp_path / "video.bin", tmp_path / "shots.csv"
    path.write_bytes(PACKETS)
    assert run(path, "--output", output).exit_code == 0
    found = read_acquisition(path)
    assert found.sensor is not None
    names = found.sensor.gimbal.names
    shots = read_shots(output, names, pixels=False).shots(names, "ellipsoid")
    np.testing.assert_allclose(shots.pose.position.lat, found.shots.pose.position.lat, atol=1e-11)
    np.testing.assert_allclose(shots.pose.heading, found.shots.pose.heading, atol=1e-11)
    np.testing.assert_allclose(shots.gimbal_readings, found.shots.gimbal_readings, atol=1e-11)
    with open(output, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["0", "1"]
    middle = 0.5 * (found.sensor.camera.width - 1), 0.5 * (found.sensor.camera.height - 1)
    assert {(float(row["u"]), float(row["v"])) for row in rows} == {middle}
    assert {(row["gimbal_reference"], row["height_datum"]) for row in rows} == {("body", "ellipsoid")}


@pytest.mark.parametrize(
    "command, column, stated, words",
    [
        ("locate", "gimbal_reference", "level", "its gimbal angles are relative to 'level' (column gimbal_reference)"),
        ("footprint", "gimbal_reference", "level", "its gimbal angles are relative to 'level'"),
        ("footprint", "height_datum", "msl", "its column height_datum states 'msl', not ellipsoid, EPSG:CODE"),
        (
            "footprint --camera-datum EPSG:3855",
            "height_datum",
            "ellipsoid",
            "its column height_datum says that heights are above 'ellipsoid', but --camera-datum 'EPSG:3855'; leave "
            "--camera-datum out.",
        ),
    ],
)
def test_a_table_against_something_else_than_the_scene_is_refused(
    tmp_path: pathlib.Path, command: str, column: str, stated: str, words: str
) -> None:
    """Readings against the level, taken against the body, would be kilometres off and look well."""
    header = "lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg,gimbal_outer_deg,gimbal_inner_deg,u,v"
    table = tmp_path / "shots.csv"
    table.write_text(f"{header},{column}\n36.318,-84.105,5500,160,1,-0.5,72,0,1199.5,2399.5,{stated}\n")
    dem = pathlib.Path(scene_file()).with_name("jacksboro.tif")
    line = [*command.split(), "--scene", scene_file(), "--dem", dem, "--shots", table]
    result = CliRunner().invoke(app, [str(one) for one in line])
    assert result.exit_code == 2
    assert words in result.stderr
    assert result.stderr.count("\n") == 1


def test_an_elevation_model_is_no_image(tmp_path: pathlib.Path) -> None:
    dem = pathlib.Path(scene_file()).with_name("jacksboro.tif")
    result = run(dem, "--source-crs", "EPSG:32616")
    assert result.exit_code == 2
    assert "jacksboro.tif: this raster lies in a map, so it is not as a camera took it" in result.stderr
    assert "an elevation model is given as one (--dem)." in result.stderr


def test_positions_with_latitude_and_longitude_exchanged_say_so(tmp_path: pathlib.Path) -> None:
    of_image(tmp_path / "photo.jpg")
    (tmp_path / "geo.txt").write_text("EPSG:4326\nphoto.jpg 36.318 -104.105 900\n")
    result = run(tmp_path / "photo.jpg", "--positions", tmp_path / "geo.txt", "--camera-datum", "ellipsoid")
    assert result.exit_code == 2
    assert "(36.318, -104.105) are no longitude and latitude in deg, but crs is 'WGS 84'." in result.stderr
    assert "They would be with the two exchanged: give the longitude before the latitude." in result.stderr


def test_tags_are_kept(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "photo.jpg"
    of_image(path)
    told = json.loads(run(path, "--json", "--tags", "--camera-datum", "ellipsoid").output)
    assert told["tags"][0]["drone-dji:GimbalPitchDegree"] == "-35.50"
    assert told["errors"] == {
        "position: north, m": 0.0093,
        "position: east, m": 0.0097,
        "position: down, m": 0.0238,
        "interior orientation: focal length, px": pytest.approx(0.0224 * 36.6667, rel=2e-3),
        "interior orientation: principal column, px": pytest.approx(0.2),
        "interior orientation: principal row, px": pytest.approx(0.2),
    }


@pytest.mark.parametrize(
    "content, words",
    [
        (b"", ["empty"]),
        (b"\x00\x01\x02" * 50, ["unrecognised file type", "drone image", "SBET"]),
        (b"just words\nand more\n", ["unrecognised file type"]),
        (b"[1, 2", ["unrecognised file type"]),
        (PACKETS[:40], ["packet"]),
    ],
)
def test_other_files_are_refused_in_a_line(tmp_path: pathlib.Path, content: bytes, words: list[str]) -> None:
    path = tmp_path / "file.bin"
    path.write_bytes(content)
    result = run(path)
    assert result.exit_code == 2
    for word in (str(path), *words):
        assert word in result.output.replace("\n", " ") or word in result.output.replace("\n", "")
    assert "Traceback" not in result.output


@pytest.mark.parametrize(
    "name, options, words",
    [
        (
            "photo.jpg",
            ["--image-size", "10,20"],
            ["(drone image) takes no --image-size", "it takes --camera-datum, --takeoff"],
        ),
        ("video.bin", ["--image-size", "10"], ["--image-size '10'", "WIDTH,HEIGHT"]),
        ("video.bin", ["--image-size", "10,2.5"], ["--image-size", "whole numbers"]),
        (
            "video.bin",
            ["--takeoff-height", "10"],
            ["takes no --takeoff-height", "it takes --camera-datum, --image-size"],
        ),
        ("video.bin", ["--output", "shots.xlsx"], ["--output shots.xlsx", ".csv"]),
        ("video.bin", ["--tags"], ["--tags needs --json"]),
        ("eo.csv", ["--camera-datum", "sea"], ["sea"]),
        ("missing.jpg", [], ["missing.jpg", "no such file"]),
    ],
)
def test_mistakes(tmp_path: pathlib.Path, name: str, options: list[str], words: list[str]) -> None:
    path = tmp_path / name
    if name in FILES:
        FILES[name][0](path)
    result = run(path, *options)
    assert result.exit_code == 2
    for word in words:
        assert word in result.output


def test_a_table_does_not_overwrite_what_is_read(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "eo.csv"
    path.write_text(TABLE)
    result = run(path, "--camera-datum", "ellipsoid", "--output", path)
    assert result.exit_code == 2
    assert "would be overwritten" in result.output
    assert path.read_text() == TABLE


def test_exterior_parameters_need_the_interior_ones(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "ext_param.geojson"
    path.write_text('{"type": "FeatureCollection", "features": []}')
    with pytest.raises(TableError, match="interior"):
        read_acquisition(path)


@pytest.mark.costly
def test_real_telemetry_in_one_command(jaxgeo_test_data: pathlib.Path, tmp_path: pathlib.Path) -> None:
    output = tmp_path / "shots.csv"
    result = run(jaxgeo_test_data / "telemetry_klv" / "Cheyenne.bin", "--output", output)
    assert result.exit_code == 0, result.output
    assert "407 exposures" in result.output
    with open(output, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 407
    off = np.array([[float(row[name]) for name in ("range_off_m", "axis_off_azimuth_mrad")] for row in rows])
    assert np.max(np.abs(off[:, 0])) < 1.0  # m
    assert abs(np.median(off[:, 1])) < 1.5  # mrad


def test_velocities_that_fit_in_no_frame_have_the_way_out_that_is_printed(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "flight.sbet"
    records = np.array([CLIMB] * 3)
    records[:, 0] += [0.0, 1.0, 2.0]
    records[:, 1] += [0.0, 1e-6, 2e-6]  # rad: 6 m/s
    records[:, 4] = -50.0
    records.astype("<f8").tofile(path)
    refused = run(path)
    assert refused.exit_code == 2
    words = " ".join(refused.output.split())
    assert "velocities turned from the wander frame differ by" in words
    assert "velocities=" not in words
    assert "read it without velocities: --no-velocities;" in words
    read = run(path, "--no-velocities")
    assert read.exit_code == 0, read.output
    assert "Velocities of the file are left out, as asked." in read.output


WITHOUT_FIELDS = {tag: raw for tag, raw in usual().items() if tag not in (16, 17, 21)}
WAYS_OUT = {  # a file of telemetry that is refused, and what is printed as the way out
    "wrong checksum": (local_set(usual())[:-1] + b"\x00", "--keep-damaged"),
    "no field of view": (local_set(WITHOUT_FIELDS), "--camera focal=8.8mm,pitch=2.41um"),
    "no field of view, by the sensor": (local_set(WITHOUT_FIELDS), "--camera focal=8.8mm,sensor=13.2mm"),
    "no field of view, in pixels": (local_set(WITHOUT_FIELDS), "--camera focal=3666px"),
}


@pytest.mark.parametrize("case", WAYS_OUT)
def test_the_way_out_of_refused_telemetry_works_as_it_is_printed(tmp_path: pathlib.Path, case: str) -> None:
    content, printed = WAYS_OUT[case]
    path = tmp_path / "flight.klv"
    path.write_bytes(content)
    refused = run(path)
    assert refused.exit_code == 2
    assert printed in " ".join(refused.output.split())
    read = run(path, *shlex.split(printed))
    assert read.exit_code == 0, read.output
    assert "1 exposure" in read.output


@pytest.mark.parametrize("name", ["flight.klv", "DJI_0042.JPG", "DJI_0001.SRT", "reconstruction.json", "mission.sbet"])
def test_assumptions_name_options_as_they_are_typed(tmp_path: pathlib.Path, name: str) -> None:
    """In JSON as on the screen: no keyword of Python."""
    prepare(tmp_path, name)
    told = CliRunner().invoke(app, ["inspect", str(tmp_path / name), "--json"])
    content = json.loads(told.stdout)
    sentences = [*content["assumed"], content["height_datum_unstated"] or ""]
    for one in sentences:
        assert not re.search(r"\b(image_size|height_datum|camera|crs|gimbal_deg|velocities|takeoff_height)=", one), one
    if name == "flight.klv":
        assert any("--image-size" in one for one in sentences)
