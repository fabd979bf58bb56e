"""Ground control of OpenDroneMap: places by PROJ, points by their names or places, pixels by their origin.

Held against: `gcp_list.txt` as OpenDroneMap's documentation lays it out, and PROJ.
"""

from __future__ import annotations

import pathlib

import numpy as np
import pyproj
import pytest

from jaxgeo.adjust.records import ImagePoints
from jaxgeo.earth import Geodetic
from jaxgeo.io import GroundControl, TableError, VerticalDatumError, read_gcp_list, undulation

ROWS = """
292710.5 2731048.25 100.0 3044 2622.5 IMG_0525.jpg
# a remark
292710.5\t2731048.25\t100.0\t4193 1552 IMG_0585.jpg

292800 2731100 90 1606 2763 IMG_0525.jpg
292710.5 2731048.25 100.0 10 20 IMG_0690.jpg
"""
NAMED = """EPSG:32651
292710.5 2731048.25 100.0 3044 2622.5 IMG_0525.jpg north
292800 2731100 90 1606 2763 IMG_0525.jpg south extra 1
292710.5 2731048.25 100.0 4193 1552 IMG_0585.jpg
292710.5 2731048.25 100.0 10 20 IMG_0690.jpg north
"""


@pytest.fixture
def table(tmp_path: pathlib.Path):
    """Writes a file and returns its path."""

    def write(content: str) -> pathlib.Path:
        path = tmp_path / "gcp_list.txt"
        path.write_text(content, encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize(
    "projection, code",
    [
        ("EPSG:32651", 32651),
        ("WGS84 UTM 51N", 32651),
        ("wgs84 utm 51", 32651),
        ("WGS84 UTM 7S", 32707),
        ("+proj=utm +zone=51 +ellps=WGS84 +datum=WGS84 +units=m +no_defs", 32651),
        ("EPSG:3826", 3826),  # Taiwan's own
    ],
)
def test_places(table, projection: str, code: int) -> None:
    control = read_gcp_list(table(projection + ROWS), height_datum="ellipsoid")
    assert control.names.tolist() == ["unnamed-0", "unnamed-1"]
    lon, lat = pyproj.Transformer.from_crs(code, 4326, always_xy=True).transform(
        [292710.5, 292800], [2731048.25, 2731100]
    )
    np.testing.assert_allclose(np.rad2deg(control.position.lat), lat, atol=1e-12, rtol=0)
    np.testing.assert_allclose(np.rad2deg(control.position.lon), lon, atol=1e-12, rtol=0)
    np.testing.assert_array_equal(control.position.height, [100.0, 90.0])
    assert control.points.point.tolist() == ["unnamed-0", "unnamed-0", "unnamed-1", "unnamed-0"]
    assert control.points.image.tolist() == ["IMG_0525.jpg", "IMG_0585.jpg", "IMG_0525.jpg", "IMG_0690.jpg"]
    np.testing.assert_array_equal(control.points.uv[0], [3044.0, 2622.5])


@pytest.mark.parametrize("projection", ["WGS84", "EPSG:4326", "EPSG:4979"])
def test_places_in_degrees_are_longitude_first(table, projection: str) -> None:
    control = read_gcp_list(table(f"{projection}\n120.95 24.68 100 1 2 a.jpg\n"), height_datum="ellipsoid")
    assert np.rad2deg(control.position.lon[0]) == pytest.approx(120.95, abs=1e-12)
    assert np.rad2deg(control.position.lat[0]) == pytest.approx(24.68, abs=1e-12)


def test_names_and_pixels(table) -> None:
    control = read_gcp_list(table(NAMED), height_datum="ellipsoid")
    assert control.names.tolist() == ["north", "south"]
    assert len(control) == 2
    assert control.points.point.tolist() == ["north", "south", "north", "north"]
    corner = read_gcp_list(table(NAMED), height_datum="ellipsoid", pixel_origin="corner")
    np.testing.assert_array_equal(corner.points.uv, control.points.uv - 0.5)


def test_heights_are_made_ellipsoidal(table) -> None:
    control = read_gcp_list(table(NAMED), height_datum="EPSG:5773")
    lat, lon = np.rad2deg(control.position.lat), np.rad2deg(control.position.lon)
    np.testing.assert_allclose(control.position.height, np.array([100.0, 90.0]) + undulation(lat, lon), atol=1e-3)  # m
    control = read_gcp_list(table(NAMED.replace("EPSG:32651", "EPSG:32651+5773")), height_datum="EPSG:5773")
    np.testing.assert_allclose(control.position.height, np.array([100.0, 90.0]) + undulation(lat, lon), atol=1e-3)


FIRST = "292710.5 2731048.25 100.0 3044 2622.5 IMG_0525.jpg"
REFUSED = {
    "projection": (NAMED.replace("EPSG:32651", "Taiwan"), "row 1: crs = 'Taiwan' is unknown to PROJ"),
    "none": (NAMED.partition("\n")[2], f"row 1: crs = '{FIRST} north' is unknown"),
    "zone": (NAMED.replace("EPSG:32651", "WGS84 UTM 61N"), "row 1: crs = 'WGS84 UTM 61N' is unknown"),
    "no map": (NAMED.replace("EPSG:32651", "EPSG:4978"), r"row 1: crs = 'EPSG:4978' .* is no map"),
    "ballpark": (NAMED.replace("EPSG:32651", "+proj=utm +zone=51 +ellps=intl"), r"PROJ knows no transf.*\+datum=WGS84"),
    "empty": ("EPSG:32651\n# nothing\n", "expected a projection in the first line and measurements"),
    "words": (NAMED.replace(" 2763 IMG_0525.jpg south extra 1", ""), "row 3: 4 words; expected geo_x geo_y geo_z im_x"),
    "number": (NAMED.replace("3044", "left"), "row 2, column im_x: 'left' is not a number"),
    "no height": (NAMED.replace(" 90 ", " NaN "), r"row 3, column geo_z: unknown \(NaN\)"),
    "twice": (NAMED.replace("IMG_0690", "IMG_0585"), "rows 4 and 5: image IMG_0585.jpg, point north: measured twice"),
    "two names": (NAMED.replace("0690.jpg north", "0690.jpg east"), "row 5, column gcp_name: east lies where north"),
    "two places": (NAMED.replace("south extra", "north extra"), "row 3, column gcp_name: north has other coordinates"),
    "nowhere": (NAMED.replace("292800", "29280099"), "29280099 2731100 90 has no place in 'WGS 84 / UTM zone 51N'"),
}  # fmt: skip


@pytest.mark.costly
@pytest.mark.parametrize("case", REFUSED)
def test_wrong_files(table, case: str) -> None:
    content, words = REFUSED[case]
    with pytest.raises(TableError, match=f"gcp_list.txt.*{words}"):
        read_gcp_list(table(content), height_datum="ellipsoid")


def test_what_the_caller_gives_wrong(table, tmp_path: pathlib.Path) -> None:
    with pytest.raises(ValueError, match="pixel_origin must be 'centre' or 'corner'; got 'center'"):
        read_gcp_list(table(NAMED), height_datum="ellipsoid", pixel_origin="center")
    with pytest.raises(VerticalDatumError, match=r"gcp_list\.txt: height_datum='EPSG:0' is unknown"):
        read_gcp_list(table(NAMED), height_datum="EPSG:0")
    with pytest.raises(FileNotFoundError, match="there is no such file of ground control points"):
        read_gcp_list(tmp_path / "nowhere.txt", height_datum="ellipsoid")
    place = Geodetic(lat=np.zeros(1), lon=np.zeros(1), height=np.zeros(1))
    points = ImagePoints(np.array(["a"]), np.array(["p"]), np.zeros((1, 2)))
    with pytest.raises(ValueError, match="point p is measured in images, but has no position"):
        GroundControl(np.array(["q"]), place, points)
    with pytest.raises(ValueError, match=r"position must hold an entry for each of 2 points; got shape \(1,\)"):
        GroundControl(np.array(["q", "p"]), place, points)
