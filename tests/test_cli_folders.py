"""Folders and many files on one command line: a row for each, one bad file does not stop the others."""

from __future__ import annotations

import csv
import io
import json
import math
import pathlib
import shutil
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest
from pyogrio import raw
from support.command_runner import CliRunner
from support.drone_image_files import FULL, packet, write_image
from support.klv_packets import local_set, usual

from jaxgeo.cli import app
from jaxgeo.io import TableError, UnstatedDatum, read_acquisitions, read_observations
from jaxgeo.io.acquisitions.sentences import merged_sentences
from jaxgeo.uncertainty import sources

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
RTK = {"drone-dji:RtkStdLat": "0.01", "drone-dji:RtkStdLon": "0.02", "drone-dji:RtkStdHgt": "0.03"}
DEWARP = {"drone-dji:DewarpData": "2020-01-01;3600,3600,1.0,-2.0,-0.1,0.02,0.0001,-0.0001,0.0"}
READ = ["--camera-datum", "ellipsoid"]
GROUND = ["--ground", "300", *READ]


def run(*arguments: str | pathlib.Path):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def image(folder: pathlib.Path, name: str, *, size: tuple[int, int] = (40, 30), **more: str) -> pathlib.Path:
    tags = DJI | {f"drone-dji:{key}": value for key, value in more.items()}
    return write_image(folder / name, packet(tags), make="DJI", size=size)


def cut(path: pathlib.Path) -> pathlib.Path:
    """An image that ends before its time."""
    path.write_bytes(path.read_bytes()[:900])
    return path


@pytest.fixture(scope="module")
def flight(tmp_path_factory) -> pathlib.Path:
    """Four images of two sizes and two lenses, one with RTK, and one that is cut short."""
    folder = tmp_path_factory.mktemp("flight")
    image(folder, "a.jpg")
    write_image(folder / "b.jpg", packet(DJI | RTK | {"drone-dji:GpsLatitude": "+36.319"}), make="DJI")
    cut(image(folder, "c.jpg"))
    image(folder, "d.jpg", size=(80, 60), GpsLatitude="+36.320")
    write_image(folder / "e.jpg", packet(DJI | DEWARP), make="DJI")
    (folder / "flight.mrk").write_text("x")
    return folder


@pytest.fixture(scope="module")
def located(flight: pathlib.Path) -> dict:
    result = run("locate", flight, *GROUND, "--no-accuracy", "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout) | {"stderr": result.stderr}


@pytest.fixture(scope="module")
def sure(tmp_path_factory) -> dict:
    """Of the structure of other tests, so that little is compiled."""
    folder = tmp_path_factory.mktemp("sure")
    image(folder, "a.jpg", size=FULL)
    write_image(folder / "b.jpg", packet(DJI | RTK | {"drone-dji:GpsLatitude": "+36.319"}), make="DJI", size=FULL)
    cut(image(folder, "c.jpg"))
    files = [folder / f"{name}.jpg" for name in "abc"]
    result = run("locate", *files, *GROUND, "--dem-sigma", "2", "--json")
    assert result.exit_code == 0, result.stderr
    return json.loads(result.stdout)


@pytest.mark.costly
def test_each_image_has_a_row_in_order_and_the_bad_one_its_reason(located: dict) -> None:
    rows = located["fixes"]
    assert [row["name"] for row in rows] == ["a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg"]
    assert [row["status"] for row in rows] == ["hit", "hit", "file_not_read", "hit", "hit"]
    bad = rows[2]
    assert "c.jpg: the file is damaged or cut short" in bad["status_text"]
    assert all(bad[name] is None for name in bad if name not in ("name", "status", "status_text", "probability"))
    assert [(row["u"], row["v"]) for row in rows if row is not bad] == [(19.5, 14.5)] * 2 + [(39.5, 29.5), (19.5, 14.5)]
    assert rows[1]["fix_lat_deg"] - rows[0]["fix_lat_deg"] == pytest.approx(0.001, abs=1e-6)
    assert rows[3]["fix_lat_deg"] - rows[0]["fix_lat_deg"] == pytest.approx(0.002, abs=1e-6)


@pytest.mark.costly
def test_each_image_is_located_as_it_is_alone(flight: pathlib.Path, located: dict) -> None:
    for row in located["fixes"]:
        if row["status"] == "hit":
            alone = json.loads(run("locate", flight / row["name"], *GROUND, "--no-accuracy", "--json").stdout)["fixes"][
                0
            ]
            numbers = {name: value for name, value in row.items() if isinstance(value, float)}
            assert numbers == pytest.approx({name: alone[name] for name in numbers}, rel=1e-6, abs=1e-8)


def test_an_image_without_rtk_does_not_take_it_from_others(flight: pathlib.Path) -> None:
    observed = read_observations([flight / f"{name}.jpg" for name in "abc"], height_datum="ellipsoid")
    for row, expected in enumerate(([3.0, 3.0, 5.0], [0.01, 0.02, 0.03])):
        (sigma,) = [one.sigma for one in observed.at(row)[1] if isinstance(one, sources.Position)]
        np.testing.assert_allclose(sigma, expected)
    assert list(observed.unread) == [2]
    (told,) = [sentence for kind, sentence in observed.assumed_errors if kind is sources.Position]
    assert "Position sigma: 3, 3, 5 m" in told
    assert told.endswith("(1 of 2 exposures)")


@pytest.mark.slow
def test_the_accuracy_of_an_image_without_rtk_is_its_own(sure: dict) -> None:
    a, b, c = sure["fixes"]
    slope = math.tan(math.radians(30.0)) * math.cos(
        math.radians(160.0)
    )  # northwards on level ground, m for 1 m of height
    more = (3.0**2 - 0.01**2) + slope**2 * (5.0**2 - 0.03**2)
    assert a["cov_nn_m2"] - b["cov_nn_m2"] == pytest.approx(more, rel=1e-4)
    assert a["ce90_m"] > b["ce90_m"] > 0.0
    assert (c["status"], c["ce90_m"], c["accuracy_method"]) == ("file_not_read", None, None)
    assert any("Position sigma: 3, 3, 5 m" in one and one.endswith("(1 of 2 exposures)") for one in sure["assumed"])


@pytest.mark.costly
def test_what_is_assumed_is_merged_sentences_with_the_number_of_files(located: dict) -> None:
    told = located["assumed"]
    assert len(told) == len(set(told))
    assert any("free of distortion" in one and one.endswith("(3 of 4 files)") for one in told)
    (resized,) = [one for one in told if "Image was resized" in one]
    assert "other numbers in some" in resized
    assert any("1 other file (.mrk) left out" in one for one in told)


def test_what_is_not_read_is_told_and_counted_on_stderr(flight: pathlib.Path, located: dict) -> None:
    lines = located["stderr"].splitlines()
    (reason,) = [line for line in lines if "not read:" in line]
    assert reason.startswith(f"jaxgeo: not read: {flight / 'c.jpg'}: the file is damaged or cut short")
    assert any(line.split()[:2] == ["1", "file_not_read:"] for line in lines)
    assert "5 pixels:" in lines


def rows_of_csv(path: pathlib.Path) -> list[dict]:
    rows = list(csv.DictReader(io.StringIO(path.read_text())))
    return [row | {"has_place": row["map_x"] != ""} for row in rows]


def rows_of_geojson(path: pathlib.Path) -> list[dict]:
    features = json.loads(path.read_text())["features"]
    return [one["properties"] | {"has_place": one["geometry"] is not None} for one in features]


def rows_of_geopackage(path: pathlib.Path) -> list[dict]:
    meta, _, shapes, fields = raw.read(path, layer="fixes")
    rows = zip(*fields, shapes, strict=True)
    return [dict(zip([*meta["fields"], "has_place"], [*row[:-1], row[-1] is not None], strict=True)) for row in rows]


def rows_of_parquet(path: pathlib.Path) -> list[dict]:
    table = pytest.importorskip("pyarrow.parquet").read_table(path)
    return [row | {"has_place": row["geometry"] is not None} for row in table.to_pylist()]


def rows_of_kml(path: pathlib.Path) -> list[dict]:
    content = path.read_bytes()
    if path.suffix == ".kmz":
        with zipfile.ZipFile(path) as archive:
            content = archive.read("doc.kml")
    kml = "{http://www.opengis.net/kml/2.2}"
    return [
        {one.get("name"): one.text for one in mark.iter(f"{kml}SimpleData")}
        | {"has_place": mark.find(f"{kml}Point") is not None}
        for mark in ElementTree.fromstring(content).iter(f"{kml}Placemark")
    ]


FORMATS = {
    ".csv": rows_of_csv,
    ".geojson": rows_of_geojson,
    ".gpkg": rows_of_geopackage,
    ".parquet": rows_of_parquet,
    ".kml": rows_of_kml,
    ".kmz": rows_of_kml,
}


@pytest.mark.parametrize("ending", FORMATS)
def test_no_row_is_lost_in_a_file_of_any_format(flight: pathlib.Path, tmp_path: pathlib.Path, ending: str) -> None:
    output = tmp_path / f"fixes{ending}"
    result = run("locate", flight, *GROUND, "--no-accuracy", "-o", output)
    assert result.exit_code == 0, result.stderr
    rows = FORMATS[ending](output)
    assert [row["name"] for row in rows] == ["a.jpg", "b.jpg", "c.jpg", "d.jpg", "e.jpg"]
    assert [row["has_place"] for row in rows] == [True, True, False, True, True]
    assert rows[2]["status"] == "file_not_read"
    assert "c.jpg: the file is damaged or cut short" in rows[2]["status_text"]


@pytest.mark.parametrize("output_format", ["csv", "geojson", "table"])
def test_no_row_is_lost_on_the_screen(flight: pathlib.Path, output_format: str) -> None:
    result = run("locate", flight, *GROUND, "--no-accuracy", "--format", output_format)
    assert result.exit_code == 0, result.stderr
    if output_format == "csv":
        rows = list(csv.DictReader(io.StringIO(result.stdout)))
    elif output_format == "geojson":
        features = json.loads(result.stdout)["features"]
        assert [one["geometry"] is None for one in features] == [False, False, True, False, False]
        rows = [one["properties"] for one in features]
    else:
        assert result.stdout.count(".jpg") == 5
        assert "file_not_read" in result.stdout
        return
    assert rows[2]["status"] == "file_not_read"
    assert "damaged or cut short" in rows[2]["status_text"]


@pytest.mark.slow
def test_files_and_folders_on_one_line(flight: pathlib.Path, tmp_path: pathlib.Path) -> None:
    """Each file once, whatever kind it is of; names that are twice become paths."""
    other = image(tmp_path, "a.jpg", GpsLatitude="+36.33")
    video = tmp_path / "video.klv"
    place = {"tag_13": 36.318, "tag_14": -84.105}
    video.write_bytes(local_set(usual(**place)) * 2)
    result = run("locate", other, video, flight / "b.jpg", flight, *GROUND, "--no-accuracy", "--json")
    assert result.exit_code == 0, result.stderr
    told = json.loads(result.stdout)
    names = [row["name"] for row in told["fixes"]]
    assert names[:4] == [str(other), "video.klv/0", "video.klv/1", "b.jpg"]
    assert names[4:] == [str(flight / "a.jpg"), "c.jpg", "d.jpg", "e.jpg"]
    assert told["inputs"]["files"] == [str(one) for one in (other, video, flight / "b.jpg", flight)]


@pytest.mark.slow
def test_pixels_and_exposures_of_many_images(flight: pathlib.Path) -> None:
    pixels = ["--pixel", "10,10", "--pixel", "70,50"]
    result = run("locate", flight, *GROUND, "--no-accuracy", "--json", *pixels, "--exposure", "d.jpg")
    rows = json.loads(result.stdout)["fixes"]
    assert [(row["name"], row["u"], row["status"]) for row in rows] == [("d.jpg", 10.0, "hit"), ("d.jpg", 70.0, "hit")]
    result = run("locate", flight, *GROUND, "--no-accuracy", "--json", *pixels)
    rows = json.loads(result.stdout)["fixes"]
    assert [row["name"] for row in rows] == [
        "a.jpg",
        "a.jpg",
        "b.jpg",
        "b.jpg",
        "c.jpg",
        "d.jpg",
        "d.jpg",
        "e.jpg",
        "e.jpg",
    ]
    assert [row["status"] == "hit" for row in rows] == [True, False, True, False, False, True, True, True, False]


def test_no_fix_and_a_file_that_is_not_read_leave_with_one(tmp_path: pathlib.Path) -> None:
    image(tmp_path, "sky.jpg", GimbalPitchDegree="+20.00")
    cut(image(tmp_path, "cut.jpg"))
    result = run("locate", tmp_path, *GROUND, "--no-accuracy")
    assert result.exit_code == 1
    assert "no pixel has a fix" in result.stderr


def test_where_no_file_can_be_read_nothing_is_written(tmp_path: pathlib.Path) -> None:
    folder, output = tmp_path / "images", tmp_path / "fixes.csv"
    folder.mkdir()
    cut(image(folder, "a.jpg"))
    one = run("locate", folder, *GROUND, "-o", output)
    assert (one.exit_code, output.exists()) == (2, False)
    assert one.stderr.startswith(f"jaxgeo: {folder / 'a.jpg'}: the file is damaged or cut short")
    cut(image(folder, "b.jpg"))
    two = run("locate", folder, *GROUND, "-o", output)
    assert (two.exit_code, output.exists()) == (2, False)
    assert f"none of 2 files can be read. {folder / 'a.jpg'}: the file is damaged" in two.stderr


def test_what_concerns_all_files_is_refused_at_once(flight: pathlib.Path, tmp_path: pathlib.Path) -> None:
    for arguments, words in (
        (["locate", flight, "--ground", "300"], "--camera-datum"),
        (["locate", flight, *GROUND, "--stream", "2"], "takes no --stream"),
        (["locate", flight, tmp_path / "nowhere.jpg", *GROUND], "there is no such file"),
        (["locate", tmp_path, *GROUND], "there are no images in this folder"),
        (["locate", flight / "a.jpg", "scene.toml", *GROUND], "is a scene file: give it alone"),
    ):
        result = run(*arguments)
        assert result.exit_code == 2, arguments
        assert words in result.stderr
        assert result.stderr.count("\n") == 1


def test_a_folder_of_folders_names_one_that_has_images(tmp_path: pathlib.Path) -> None:
    (tmp_path / "100MEDIA").mkdir()
    image(tmp_path / "100MEDIA", "a.jpg")
    result = run("inspect", tmp_path)
    assert result.exit_code == 2
    assert f"Images are in the folder {tmp_path / '100MEDIA'}" in result.stderr


def test_inspect_shows_all_cameras_and_what_is_not_read(flight: pathlib.Path, tmp_path: pathlib.Path) -> None:
    told = json.loads(run("inspect", flight, *READ, "--json", "--tags").stdout)
    assert [row["name"] for row in told["exposures"]] == ["a.jpg", "b.jpg", "d.jpg", "e.jpg"]
    assert [(one["name"], one["path"]) for one in told["unread"]] == [("c.jpg", str(flight / "c.jpg"))]
    assert "damaged or cut short" in told["unread"][0]["reason"]
    assert sorted(one["sensor"]["width"] for one in told["parts"]) == [40, 40, 40, 80]
    assert sum(one["count"] for one in told["parts"]) == 4
    assert [tags["drone-dji:GpsLatitude"] for tags in told["tags"]] == ["+36.318", "+36.319", "+36.320", "+36.318"]
    shown = run("inspect", flight, *READ)
    assert shown.exit_code == 0
    assert "1 file could not be read" in shown.stdout
    assert "not read:" in shown.stderr
    table = tmp_path / "shots.csv"
    assert run("inspect", flight, *READ, "-o", table).exit_code == 0
    rows = list(csv.DictReader(io.StringIO(table.read_text())))
    assert [row["name"] for row in rows] == ["a.jpg", "b.jpg", "d.jpg", "e.jpg"]
    assert [float(row["u"]) for row in rows] == [19.5, 19.5, 39.5, 19.5]


@pytest.mark.slow
def test_a_report_of_several_cameras(flight: pathlib.Path, tmp_path: pathlib.Path) -> None:
    pytest.importorskip("bokeh")
    output = tmp_path / "report.html"
    result = run("report", flight, *GROUND, "-o", output, "--details", "1", "--json")
    assert result.exit_code == 0, result.output
    page = output.read_text()
    assert "c.jpg: the file is damaged or cut short" in page
    assert all(f"{name}.jpg" in page for name in "abde")
    assert [row["status"] for row in json.loads(result.stdout)["fixes"]].count("hit") == 4


def test_a_fault_in_one_file_is_called_a_fault(flight: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It does not stop the others, is no "damaged file", and the exit code says so."""
    import jaxgeo.io.acquisitions.drone_images as module

    real = module.maker_of

    def broken(tags, **options):
        return {}["key"] if tags.path.endswith("d.jpg") else real(tags, **options)

    monkeypatch.setattr(module, "maker_of", broken)
    result = run("locate", flight, *GROUND, "--no-accuracy", "--json")
    assert result.exit_code == 70
    rows = json.loads(result.stdout)["fixes"]
    assert [row["status"] for row in rows] == ["hit", "hit", "file_not_read", "file_not_read", "hit"]
    assert "internal error: unexpected KeyError ('key')" in rows[3]["status_text"]
    assert f"jaxgeo inspect {flight / 'd.jpg'} --debug" in result.stderr
    alone = run("inspect", flight / "d.jpg", *READ)
    assert alone.exit_code == 70


def test_sources_differ_by_image_in_the_library(flight: pathlib.Path) -> None:
    found = read_acquisitions([flight / "a.jpg", flight / "b.jpg"], height_datum="ellipsoid")
    assert [len(part.sources) for part in found.parts] == [1, 2]  # of lenses, and of a position
    source, _ = found.parts[1].sources
    assert isinstance(source, sources.Position)
    np.testing.assert_allclose(source.sigma, [[0.01, 0.02, 0.03]])
    np.testing.assert_array_equal(np.concatenate(found.places), [0, 1])
    with pytest.raises(UnstatedDatum):
        read_acquisitions(flight)
    with pytest.raises(TableError, match="stream is no option of it"):
        read_acquisitions(flight, stream=1)


def test_images_of_one_structure_are_one_batch(tmp_path: pathlib.Path) -> None:
    for k in range(5):
        image(tmp_path, f"{k}.jpg", GpsLatitude=f"+36.31{k}")
    shutil.copy(tmp_path / "0.jpg", tmp_path / "9.jpg")
    found = read_acquisitions(tmp_path, height_datum="ellipsoid")
    (part,) = found.parts
    assert len(found) == len(part) == 6
    np.testing.assert_allclose(np.rad2deg(part.shots.pose.position.lat)[:5], 36.31 + 0.001 * np.arange(5))


def test_merged_sentences_keeps_order_and_counts() -> None:
    assert merged_sentences([["A."], ["A."]], "file") == ("A.",)
    assert merged_sentences([["A.", "B."], ["B."], []], "file") == ("A. (1 of 3 files)", "B. (2 of 3 files)")
    assert merged_sentences([["By 1."], ["By 2."]], "file") == ("By 1. (2 of 2 files, other numbers in some)",)
    assert merged_sentences([], "file") == ()


LENS = "[camera]\nwidth = {}\nheight = {}\nfocal_px = {}\n[errors]\nfocal_px = {}\nprincipal_px = {}\n"


@pytest.mark.slow
def test_errors_of_a_lens_of_a_scene_are_those_of_the_image_at_its_size(flight: pathlib.Path) -> None:
    """The same camera and the same relative errors, written for images of another size, give the same CE90."""
    found = []
    for factor in (1.0, 4.0):
        scene = flight.parent / f"lens{factor:g}.toml"
        size = [factor * value for value in (64, 48, 60.0, 0.6, 0.3)]
        scene.write_text(LENS.format(int(size[0]), int(size[1]), *size[2:]) + '[gimbal]\nkind = "fixed"\n')
        result = run("locate", flight / "b.jpg", "--scene", scene, *GROUND, "--pixel", "5,5", "--json")
        assert result.exit_code == 0, result.output
        found.append(json.loads(result.stdout)["fixes"][0]["ce90_m"])
    assert found[0] == pytest.approx(found[1], rel=1e-3)


def in_shards(count: int, *arguments: str | pathlib.Path) -> list[str]:
    """Rows of all parts of a command, one after the other, without their headers."""
    rows: list[str] = []
    for number in range(1, count + 1):
        result = run("locate", *arguments, "--format", "csv", "--no-accuracy", "--shard", f"{number}/{count}")
        assert result.exit_code == 0, result.stderr
        rows += result.stdout.splitlines()[1:]
    return rows


@pytest.mark.costly
@pytest.mark.parametrize("count", [1, 2, 3])
def test_parts_of_a_folder_are_the_whole(flight: pathlib.Path, count: int) -> None:
    """Also where one file of a part cannot be read."""
    whole = run("locate", flight, *GROUND, "--format", "csv", "--no-accuracy").stdout.splitlines()[1:]
    assert len(whole) == 5
    assert [row.split(",")[0] for row in in_shards(count, flight, *GROUND)] == [row.split(",")[0] for row in whole]
    for one, other in zip(in_shards(count, flight, *GROUND), whole, strict=True):
        numbers, expected = ([float(x) for x in row.split(",")[1:8] if x] for row in (one, other))
        np.testing.assert_allclose(numbers, expected, rtol=1e-12)


def test_names_of_parts_are_those_of_the_whole(flight: pathlib.Path, tmp_path: pathlib.Path) -> None:
    """Of images, and of files that cannot be read, whose names are twice."""
    for name in ("a.jpg", "c.jpg"):
        shutil.copy(flight / name, tmp_path / name)
    whole = read_observations([flight, tmp_path], height_datum="ellipsoid")
    parts = [read_observations([flight, tmp_path], height_datum="ellipsoid", shard=(k, 3)) for k in (1, 2, 3)]
    names = [row["name"] for part in parts for row in part.columns]
    assert names == [row["name"] for row in whole.columns]
    assert len(set(names)) == 7
    with pytest.raises(TableError, match=r"exposures= of several files and shard= do not go together"):
        read_observations([flight], height_datum="ellipsoid", shard=(1, 2), exposures=["a.jpg"])


@pytest.mark.costly
def test_pixels_of_a_scene_in_parts(tmp_path: pathlib.Path) -> None:
    from jaxgeo.demo import scene_file

    pixels = ["--pixel", "10,20", "--pixel", "-9,20", "--pixel", "11,20"]
    place = ["--scene", str(scene_file()), "--ground", "450", *pixels]
    whole = run("locate", *place, "--format", "csv", "--no-accuracy").stdout.splitlines()[1:]
    assert in_shards(3, *place[2:], "--scene", str(scene_file())) == whole


def test_parts_of_one_file_are_of_its_rows(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "flight.klv"
    path.write_bytes(b"".join(local_set(usual(tag_13=36.318 + 0.001 * k)) for k in range(7)))
    whole = read_observations(path)
    parts = [read_observations(path, shard=(number, 3)) for number in (1, 2, 3)]
    assert [len(part) for part in parts] == [2, 2, 3]
    assert [row for part in parts for row in part.columns] == whole.columns
    for name in ("lat", "lon", "height"):
        each = [np.asarray(getattr(part.batches[0].shots.pose.position, name)) for part in parts]
        np.testing.assert_array_equal(np.concatenate(each), getattr(whole.batches[0].shots.pose.position, name))


@pytest.mark.parametrize(
    "shard, words",
    [
        ("0/3", "--shard 0/3: give I/N, part I (from 1) of N, e.g. --shard 3/16."),
        ("4/3", "--shard 4/3: give I/N"),
        ("2", "--shard 2: give I/N"),
        ("a/b", "--shard a/b: give I/N"),
        ("1/6", "shard 1/6: more parts than files (5); use at most 5."),
    ],
)
def test_parts_that_there_are_not(flight: pathlib.Path, shard: str, words: str) -> None:
    result = run("locate", flight, *GROUND, "--shard", shard)
    assert result.exit_code == 2
    assert words in result.stderr.replace("\n", " ")
