"""Better positions for images: OpenDroneMap's geo.txt and shots.geojson, DJI's marks, tables.

Held against: OpenDroneMap's documentation of the "image geolocation file" and `opendm/geo.py`, `opendm/shots.py`; DJI's
manuals of the Zenmuse P1 and Matrice 4 ("image log file") and the Phantom 4 RTK white paper for the marks, with a line
that such a drone wrote (MARK_P1); the epoch of GPS and 18 leap seconds for their times.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import pathlib
from typing import Any

import numpy as np
import pyproj
import pytest
from support.command_runner import CliRunner
from support.drone_image_files import CAMERA, packet, write_image

from jaxgeo.cli import app
from jaxgeo.io import TableError, UnstatedDatum, read_acquisition, read_acquisitions, undulation, with_positions

DJI = {
    "drone-dji:AbsoluteAltitude": "+153.9",
    "drone-dji:RelativeAltitude": "+99.9",
    "drone-dji:GpsLatitude": "+36.3001",
    "drone-dji:GpsLongitude": "-84.2001",
    "drone-dji:GimbalYawDegree": "-97.40",
    "drone-dji:GimbalPitchDegree": "-35.50",
    "drone-dji:GimbalRollDegree": "+0.00",
    "drone-dji:CalibratedFocalLength": "3666.67",
}
MARK = "{}\t362830.112\t[2312]\t   12,N\t   -3,E\t  190,V\t{},Lat\t{},Lon\t900.000,Ellh\t0.0101, 0.0102, 0.0203\t{},Q"
# A line as it stands in a public test of a reader of such files.
MARK_P1 = (
    "1\t400373.488877\t[2264]\t-40,N\t0,E\t86,V\t44.42824637,Lat\t1.26196331,Lon\t359.494,Ellh\t"
    "0.028, 0.031, 0.055\t16,Q"
)
GEO = "EPSG:4326\nDJI_0001.JPG -84.2000 36.3000 900.0 30 -60 0 0.02 0.03\n"


@pytest.fixture
def folder(tmp_path: pathlib.Path) -> pathlib.Path:
    """A folder of two images without errors of position."""
    images = tmp_path / "images"
    images.mkdir()
    for number in (1, 2):
        write_image(images / f"DJI_000{number}.JPG", packet(DJI), make="DJI")
    return images


def written(folder: pathlib.Path, name: str, text: str) -> pathlib.Path:
    path = folder.parent / name
    path.write_text(text, encoding="utf-8")
    return path


def read(folder: pathlib.Path, path: pathlib.Path, **how: Any) -> Any:
    return read_acquisition(folder, positions=path, **how)


def place(found: Any) -> np.ndarray:
    """Latitudes, longitudes in deg and heights in m, (n, 3)."""
    at = found.shots.pose.position
    return np.stack([np.rad2deg(at.lat), np.rad2deg(at.lon), at.height], axis=-1)


def shots_of(*rows: tuple[str, float, float, float]) -> str:
    return json.dumps({
        "type": "FeatureCollection",
        "features": [
            {"type": "Feature", "properties": {"filename": name, "translation": [0, 0, 0], "rotation": [0, 0, 0]},
             "geometry": {"type": "Point", "coordinates": list(lonlat)}}
            for name, *lonlat in rows
        ],
    })  # fmt: skip


LAYOUTS = {  # of the position 36.3, -84.2, 900 m: text, options, whether it has errors
    "geo.txt": (GEO + "DJI_0002.JPG -84.2001 36.3001 900.1 31 -60 0 0.02 0.03\n", {"height_datum": "ellipsoid"}, True),
    "geo.txt in a map": (
        "+proj=utm +zone=16 +datum=WGS84 +units=m\nDJI_0001.JPG {} {} 900.0\n# a note\nDJI_0002.JPG {} {} 900.1\n",
        {"height_datum": "ellipsoid"}, False,
    ),
    "Timestamp.MRK": (MARK.format(1, 36.3, -84.2, 50) + "\n" + MARK.format(2, 36.3001, -84.2001, 50) + "\n", {}, True),
    "shots.geojson": (shots_of(("DJI_0001.JPG", -84.2, 36.3, 900.0), ("DJI_0002.JPG", -84.2001, 36.3001, 900.1)),
                      {"height_datum": "ellipsoid"}, False),
    "table": ("image;lat;lon;alt\nDJI_0001;36,3;-84,2;900,0\nDJI_0002;36,3001;-84,2001;900,1\n",
              {"height_datum": "ellipsoid"}, False),
    "table with errors": (
        "Label\tlatitude\tlongitude\theight_m\tsigma_north_m\tsigma_east_m\tsigma_down_m\n"
        "dji_0001.jpg\t36.3\t-84.2\t900.0\t0.02\t0.02\t0.03\ndji_0002.jpg\t36.3001\t-84.2001\t900.1\t0.02\t0.02\t0.03\n",
        {"height_datum": "ellipsoid"}, True,
    ),
}  # fmt: skip
UTM = pyproj.Transformer.from_crs(4326, 32616, always_xy=True)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_positions_take_the_place_of_those_in_the_images(folder: pathlib.Path, layout: str) -> None:
    text, how, has_errors = LAYOUTS[layout]
    if "map" in layout:
        text = text.format(*UTM.transform(-84.2, 36.3), *UTM.transform(-84.2001, 36.3001))
    found = read(folder, written(folder, "positions.txt", text), **how)
    assert found.names.tolist() == ["DJI_0001.JPG", "DJI_0002.JPG"]
    np.testing.assert_allclose(place(found)[:, :2], [[36.3, -84.2], [36.3001, -84.2001]], atol=1e-9)
    np.testing.assert_allclose(place(found)[:, 2], [900.0, 900.0 if "MRK" in layout else 900.1], atol=1e-9)
    assert "2 of 2 images" in found.facts["positions"]
    own = read_acquisition(folder, height_datum="ellipsoid")
    np.testing.assert_array_equal(found.shots.gimbal_readings, own.shots.gimbal_readings)
    sigma = [np.asarray(one.sigma)[0].tolist() for one in found.sources if type(one).__name__ == "Position"]
    expected = [0.0101, 0.0102, 0.0203] if "MRK" in layout else [0.02, 0.02, 0.03]
    assert sigma == ([expected] if has_errors else [])


def test_images_that_a_file_does_not_have_are_left_out_and_named(folder: pathlib.Path) -> None:
    text = GEO + "DJI_0009.JPG -84.2001 36.3001 900.1\n"
    path = written(folder, "geo.txt", text.replace(" 30 -60 0 0.02 0.03", ""))
    found = read(folder, path, height_datum="ellipsoid")
    assert found.names.tolist() == ["DJI_0001.JPG"]
    assert any("1 of 2 images are not in geo.txt and are left out: DJI_0002.JPG" in one for one in found.assumed)
    assert any("1 rows of geo.txt are of no image here" in one for one in found.assumed)


def test_heights_are_above_the_datum_of_the_file_of_positions(folder: pathlib.Path) -> None:
    path = written(folder, "geo.txt", GEO)
    geoid = float(undulation(36.3, -84.2))
    assert place(read(folder, path, height_datum="EPSG:5773"))[0, 2] == pytest.approx(900.0 + geoid, abs=1e-3)  # m
    with pytest.raises(UnstatedDatum, match=r"geo\.txt: the vertical datum of its heights.*height_datum="):
        read(folder, path)


def test_without_heights_those_of_the_images_stay(folder: pathlib.Path) -> None:
    path = written(folder, "geo.txt", "EPSG:4326\nDJI_0001.JPG -84.2 36.3\nDJI_0002.JPG -84.2 36.3\n")
    found = read(folder, path, height_datum="ellipsoid")
    assert place(found)[:, 2].tolist() == [153.9, 153.9]
    found = read(folder, path, takeoff_height=10.0)
    np.testing.assert_allclose(place(found)[:, 2], 109.9)
    assert any("has no heights: those of the images stay" in one for one in found.assumed)


def test_a_mark_of_a_real_flight() -> None:
    from jaxgeo.io.acquisitions._position_tables import MARK as PATTERN

    found = PATTERN.fullmatch(MARK_P1)
    assert found is not None
    assert found.groups() == (
        "1", "400373.488877", "2264", "-40", "0", "86", "44.42824637", "1.26196331", "359.494", "0.028", "0.031",
        "0.055", "16",
    )  # fmt: skip


def test_times_of_marks_are_utc(tmp_path: pathlib.Path) -> None:
    from jaxgeo.io.acquisitions._position_tables import read_positions

    path = tmp_path / "Timestamp.MRK"
    path.write_text(MARK_P1)
    table = read_positions(path, height_datum=None, crs=None)
    assert table.time is not None
    epoch = datetime.datetime(1980, 1, 6, tzinfo=datetime.UTC)
    utc = epoch + datetime.timedelta(weeks=2264, seconds=400373.488877 - 18.0)
    assert table.time[0] == pytest.approx(utc.timestamp(), abs=1e-5)  # s


def test_marks_without_a_solution_are_no_positions(folder: pathlib.Path) -> None:
    text = MARK.format(1, 36.3, -84.2, 0) + "\n" + MARK.format(2, 36.3, -84.2, 16) + "\n"
    found = read(folder, written(folder, "Timestamp.MRK", text))
    assert found.names.tolist() == ["DJI_0002.JPG"]
    assert any("1 marks have no position and are left out: 1." in one for one in found.assumed)
    with pytest.raises(TableError, match="no mark has a position"):
        read(folder, written(folder, "Timestamp.MRK", MARK.format(1, 0.0, 0.0, 16)))


REFUSED = {
    "other names": (GEO.replace("0001", "0007"), {}, "it has none of the images: they are DJI_0001.JPG, DJI_0002.JPG"),
    "swapped": (GEO.replace("-84.2000 36.3000", "36.3000 -84.2000"), {}, "km from that in the image"),
    "feet": (GEO.replace("900.0", "2952.7"), {}, r"DJI_0001.JPG lies 2\d+ m above the altitude .*; .* in m\?"),
    "zero": (GEO.replace("-84.2000 36.3000", "0.0 0.0"), {}, "latitude and longitude are zero"),
    "no number": (GEO.replace("900.0", "high"), {}, "column z_m: 'high' is not a number"),
    "unknown height": (GEO.replace("900.0", "-9999"), {}, "column z_m: unknown"),
    "twice": (GEO + GEO.splitlines()[1], {}, "image DJI_0001.JPG is there twice"),
    "some heights": (GEO + "DJI_0002.JPG -84.2 36.3\n", {}, "some rows have a height and some do not"),
    "crs": (GEO, {"crs": "EPSG:32616"}, "its first line says that it is in 'EPSG:4326'; leave crs= out"),
    "unknown crs": (GEO.replace("4326", "1"), {}, "crs = 'EPSG:1' is unknown to PROJ"),
    "map": ("image x y z\nDJI_0001.JPG 751000 4020000 900\n", {}, 'x is projected.*crs="EPSG:32616"'),
    "no names": ("lat lon alt\n36.3 -84.2 900\n", {}, "no column image"),
    "mark": (MARK.format(1, 36.3, -84.2, 50) + "\n2 cut", {"height_datum": None}, "row 2: not a mark of a photo"),
    "datum of marks": (MARK.format(1, 36.3, -84.2, 50), {"height_datum": 30.0}, r"above the ellipsoid \(Ellh\)"),
    "place of a shot": (shots_of(("DJI_0001.JPG", -84.2, 36.3, 900.0)).replace(", 900.0", ""), {}, "coordinates must"),
    "take-off": (GEO, {"height_datum": None, "takeoff_height": 3.0}, "leave takeoff_height= out"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_files_that_do_not_fit_are_refused_in_a_line(folder: pathlib.Path, case: str) -> None:
    text, how, words = REFUSED[case]
    path = written(folder, "positions.txt", text)
    with pytest.raises(TableError, match=words) as refusal:
        read(folder, path, **({"height_datum": "ellipsoid"} | how))
    assert "\n" not in str(refusal.value)


def test_heights_that_are_far_from_those_in_the_images_are_doubtful(folder: pathlib.Path) -> None:
    own = float(read_acquisition(folder, height_datum="ellipsoid").shots.pose.position.height[0])
    for above, is_far in ((150.0, False), (-250.0, True)):
        text = GEO.replace("900.0", f"{own + above}")
        found = read(folder, written(folder, "positions.txt", text), height_datum="ellipsoid")
        told = [one for one in found.assumed if one.startswith("Check")]
        assert len(told) == is_far
        assert all("lies 250 m below the altitude in the image" in one for one in told)


def test_marks_of_another_flight_are_told_by_their_times(folder: pathlib.Path) -> None:
    found = read_acquisition(folder, height_datum="ellipsoid")
    shots = dataclasses.replace(found.shots, time=np.array([1e9, 1e9 + 2.0]))
    late = MARK.format(1, 36.3, -84.2, 50) + "\n" + MARK.format(2, 36.3, -84.2, 50).replace("362830", "362930") + "\n"
    with pytest.raises(TableError, match="they are not of one flight"):
        with_positions(dataclasses.replace(found, shots=shots), written(folder, "Timestamp.MRK", late))


MARKED = datetime.datetime(1980, 1, 6) + datetime.timedelta(weeks=2312, seconds=362830.0)  # of MARK, to the second


def flown(path: pathlib.Path, seconds: float | None) -> pathlib.Path:
    """An image taken so many s after the mark by a clock of its own, 2 h before GPS; without a time for None."""
    path.parent.mkdir(exist_ok=True)
    when = None if seconds is None else MARKED + datetime.timedelta(seconds=seconds - 7200.0)
    exif = CAMERA if when is None else CAMERA | {0x9003: when.strftime("%Y:%m:%d %H:%M:%S")}
    return write_image(path, packet(DJI), make="DJI", exif=exif)


def marks(folder: pathlib.Path, count: int = 3) -> pathlib.Path:
    """Marks of photos 1, 2, ... that were taken 2 s apart."""
    lines = [MARK.format(k + 1, 36.3, -84.2, 50).replace("362830", f"{362830 + 2 * k}") for k in range(count)]
    return written(folder, "Timestamp.MRK", "\n".join(lines) + "\n")


FLIGHTS = {  # times of the images 1, 2, 3 in s after the first mark, and whether they are of its flight
    "of the flight": ((0.0, 2.0, 4.0), True),
    "rounded to seconds": ((0.0, 3.0, 4.0), True),
    "one without a time": ((None, 2.0, 4.0), True),
    "one time only": ((None, 500.0, None), True),
    "none with a time": ((None, None, None), True),
    "of another flight": ((0.0, 62.0, 124.0), False),
    "the last of another": ((0.0, 2.0, 604.0), False),
    "one without a time, of another": ((0.0, None, 604.0), False),
}


@pytest.mark.parametrize("case", FLIGHTS)
@pytest.mark.parametrize("is_list", [True, False], ids=["files", "folder"])
def test_clocks_of_images_read_one_by_one_belong_to_one_flight(
    tmp_path: pathlib.Path, case: str, is_list: bool
) -> None:
    times, is_one_flight = FLIGHTS[case]
    folder = tmp_path / "images"
    files = [flown(folder / f"DJI_{k:04d}.JPG", seconds) for k, seconds in enumerate(times, 1)]
    paths = files if is_list else folder
    if is_one_flight:
        found = read_acquisitions(paths, positions=marks(folder))
        assert (sum(map(len, found.parts)), found.unread) == (3, ())
    else:
        with pytest.raises(TableError, match=r"differ by -?\d+ to -?\d+ s, so they are not of one flight"):
            read_acquisitions(paths, positions=marks(folder))


def test_two_images_of_one_number_are_of_two_flights(tmp_path: pathlib.Path) -> None:
    files = [flown(tmp_path / name / "DJI_0001.JPG", 0.0) for name in ("100MEDIA", "101MEDIA")]
    with pytest.raises(TableError, match="two images have the number of one photo; join one flight at a time"):
        read_acquisitions(files, positions=marks(tmp_path / "100MEDIA"))
    assert len(read_acquisitions(files[:1], positions=marks(tmp_path / "100MEDIA"))) == 1


def test_images_joined_by_name_may_be_of_many_flights(tmp_path: pathlib.Path) -> None:
    files = [flown(tmp_path / "images" / f"DJI_000{k}.JPG", 9e4 * k) for k in (1, 2)]
    path = written(files[0].parent, "geo.txt", GEO + GEO.splitlines()[1].replace("0001", "0002") + "\n")
    found = read_acquisitions(files, positions=path, height_datum="ellipsoid")
    assert (len(found), found.unread) == (2, ())


def test_another_file_among_the_images_has_no_part_in_the_check(tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "images"
    files = [flown(folder / f"DJI_{k:04d}.JPG", 2.0 * k) for k in (1, 2)]
    (folder / "DJI_0003.JPG").write_bytes(files[0].read_bytes()[:700])
    found = read_acquisitions(folder, positions=marks(folder))
    assert [one.name for one in found.unread] == ["DJI_0003.JPG"]
    assert sum(map(len, found.parts)) == 2


def test_images_without_numbers_are_joined_by_time(folder: pathlib.Path) -> None:
    utc = 315_964_800.0 + 604_800.0 * 2312 + 362830.112 - 18.0
    found = dataclasses.replace(
        read_acquisition(folder, height_datum="ellipsoid"), names=np.array(["a.jpg", "b.jpg"]), time_is_utc=True
    )
    found = dataclasses.replace(found, shots=dataclasses.replace(found.shots, time=np.array([utc + 500.0, utc + 0.3])))
    path = written(folder, "Timestamp.MRK", MARK.format(1, 36.3, -84.2, 50))
    assert with_positions(found, path).names.tolist() == ["b.jpg"]
    with pytest.raises(TableError, match="no numbers of four digits in its names, and no times in UTC"):
        with_positions(dataclasses.replace(found, time_is_utc=False), path)


def run(*arguments: object):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_positions_on_the_command_line(folder: pathlib.Path) -> None:
    path = written(folder, "geo.txt", GEO)
    result = run("inspect", folder, "--positions", path, "--camera-datum", "ellipsoid", "--json")
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert [one["name"] for one in told["unread"]] == ["DJI_0002.JPG"]
    assert "it has no position of DJI_0002.JPG, but of DJI_0001.JPG" in told["unread"][0]["reason"]
    assert not any("of no image here" in one for one in told["assumed"])
    assert [row["lat_deg"] for row in told["exposures"]] == [pytest.approx(36.3)]
    assert told["errors"]["position: down, m"] == 0.03
    alone = run("inspect", path)
    assert alone.exit_code == 2
    words = " ".join(alone.output.split())
    assert "--positions" in words
    refused = run("inspect", folder, "--source-crs", "EPSG:32616", "--camera-datum", "ellipsoid")
    assert refused.exit_code == 2
    assert "--positions" in " ".join(refused.output.split())
