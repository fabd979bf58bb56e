"""Vertical systems whose heights count downwards: depths stay depths by PROJ, by a number and by a geoid grid."""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
import pyproj
import pytest
from pyproj.crs import CompoundCRS
from support.rasters import DEGREE, hills, write

from jaxgeo.io import VerticalDatumError, open_dem, read_dem, read_gcp_list, read_orientations, write_orientations
from jaxgeo.io._map_crs import map_crs
from jaxgeo.io._proj import DATA
from jaxgeo.io.errors import TableError
from jaxgeo.io.vertical import FILE, height_shift

DEPTHS = (5715, 6357, 5861, 5831, 9288)
HEIGHTS = hills((6, 7))  # all positive: taken for heights they would be mountains
GRID = DATA / "us_nga_egm96_15.tif"


def vertical_crs(direction: str, name: str = "a vertical system", unit: str = 'LENGTHUNIT["metre",1]') -> pyproj.CRS:
    kind = "depth (D)" if direction == "down" else "gravity-related height (H)"
    return pyproj.CRS.from_wkt(
        f'VERTCRS["{name}",VDATUM["EGM96 geoid",ID["EPSG",5171]],CS[vertical,1],AXIS["{kind}",{direction}],{unit}]'
    )


def posts(path: pathlib.Path, **options: Any) -> np.ndarray:
    return np.asarray(read_dem(path, **options).posts)


def undulations(shape: tuple[int, int]) -> np.ndarray:
    lon = 5.0 + (np.arange(shape[1]) + 0.5) * DEGREE
    lat = 45.0 - (np.arange(shape[0]) + 0.5) * DEGREE
    egm96 = pyproj.Transformer.from_crs("EPSG:4326+5773", "EPSG:4979", always_xy=True, allow_ballpark=False)
    lon, lat = np.meshgrid(lon, lat)
    return np.asarray(egm96.transform(lon, lat, np.zeros(shape))[2])


@pytest.mark.parametrize("code", DEPTHS)
def test_depths_of_a_file_keep_their_sign(tmp_path: pathlib.Path, code: int) -> None:
    path = write(tmp_path / "dem.tif", HEIGHTS, crs=f"EPSG:4326+{code}")
    np.testing.assert_allclose(posts(path, vertical_datum=47.5), 47.5 - HEIGHTS, rtol=0, atol=1e-9)
    by_grid = posts(path, vertical_datum=str(GRID))
    np.testing.assert_allclose(by_grid, undulations(HEIGHTS.shape) - HEIGHTS, rtol=0, atol=1e-6)
    with pytest.raises(VerticalDatumError, match=r"the file says .*, the caller says"):
        read_dem(path, vertical_datum="ellipsoid")


@pytest.mark.parametrize("code", DEPTHS)
def test_a_depth_system_by_itself_shifts_depths(code: int) -> None:
    lon, lat, depth = (np.array([x]) for x in (5.0, 45.0, 321.0))
    for datum in (47.5, GRID):
        shift = height_shift(datum, pyproj.CRS(code))
        height = shift.to_ellipsoid(lon, lat, depth)
        assert 40.0 < float(height[0]) + 321.0 < 60.0
        np.testing.assert_allclose(shift.from_ellipsoid(lon, lat, height), depth, rtol=0, atol=1e-9)


@pytest.mark.parametrize("unit", [1.0, 0.3048])
def test_by_proj_by_a_number_and_by_a_grid_depths_are_the_same(tmp_path: pathlib.Path, unit: float) -> None:
    """A depth system on EGM96, which PROJ itself can bring to the ellipsoid with the packaged grid."""
    said = 'LENGTHUNIT["metre",1]' if unit == 1.0 else 'LENGTHUNIT["foot",0.3048]'
    crs = CompoundCRS("depths", components=["EPSG:4326", vertical_crs("down", unit=said)])
    proj = pyproj.Transformer.from_crs(crs, "EPSG:4979", always_xy=True, allow_ballpark=False)
    lon, lat = 5.0 + (np.arange(7) + 0.5) * DEGREE, 45.0 - (np.arange(6) + 0.5) * DEGREE
    expected = np.asarray(proj.transform(*np.meshgrid(lon, lat), HEIGHTS)[2])
    np.testing.assert_allclose(expected, undulations(HEIGHTS.shape) - HEIGHTS * unit, rtol=0, atol=1e-6)
    vertical = crs.sub_crs_list[1]
    area = lon.min(), lat.min(), lon.max(), lat.max()
    for datum in (None, GRID):
        shift = height_shift(datum, vertical, area)
        found = shift.to_ellipsoid(*np.meshgrid(lon, lat), HEIGHTS * unit)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-6)
    by_number = height_shift(50.0, vertical).to_ellipsoid(*np.meshgrid(lon, lat), HEIGHTS * unit)
    np.testing.assert_allclose(by_number, 50.0 - HEIGHTS * unit, rtol=0, atol=1e-9)
    assert FILE in height_shift(None, vertical, area).name


def test_depths_deeper_than_any_geoid_are_read_by_proj(tmp_path: pathlib.Path) -> None:
    crs = CompoundCRS("depths", components=["EPSG:4326", vertical_crs("down")])
    path = write(tmp_path / "dem.tif", HEIGHTS + 3000.0, crs=crs.to_wkt(), profile="BASELINE")
    found = posts(path)
    np.testing.assert_allclose(found, undulations(HEIGHTS.shape) - HEIGHTS - 3000.0, rtol=0, atol=1e-6)


@pytest.mark.parametrize("direction, sign", [("up", 1.0), ("down", -1.0)])
def test_a_system_without_a_name_keeps_its_direction_and_its_unit(
    tmp_path: pathlib.Path, direction: str, sign: float
) -> None:
    foot = vertical_crs(direction, "unknown", 'LENGTHUNIT["foot",0.3048]')
    crs = CompoundCRS("unknown", components=["EPSG:4326", foot])
    path = write(tmp_path / "dem.tif", HEIGHTS, crs=crs.to_wkt(), profile="BASELINE")
    with pytest.raises(VerticalDatumError, match="does not state the vertical datum of its heights"):
        read_dem(path)
    np.testing.assert_allclose(posts(path, vertical_datum=47.5), sign * 0.3048 * HEIGHTS + 47.5, rtol=0, atol=1e-9)
    expected = sign * 0.3048 * HEIGHTS + undulations(HEIGHTS.shape)
    np.testing.assert_allclose(posts(path, vertical_datum=GRID), expected, rtol=0, atol=1e-6)
    if direction == "down":
        with pytest.raises(VerticalDatumError, match="it holds depths, which count downwards, and 'EGM96 height'"):
            read_dem(path, vertical_datum=5773)


def test_an_opened_file_has_the_same_depths_and_bounds(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", HEIGHTS, crs="EPSG:4326+5715")
    files = open_dem(path, vertical_datum=47.5)
    whole = read_dem(path, vertical_datum=47.5)
    assert (files.floor, files.ceiling) == pytest.approx((float(whole.floor), float(whole.ceiling)), abs=1e-9)


REFUSALS = [
    ("EPSG:5715", True, r"would take these depths for heights.*name the depth system.*change their sign"),
    ("EPSG:5861", True, r"would take these depths for heights"),
    ("EPSG:6358", True, r"would take these depths for heights"),
    ("EPSG:5703", True, r"Pass a constant undulation in m or the path of a geoid grid as vertical_datum="),
    ("EPSG:6360", True, r"geoid grid as vertical_datum=\.\.\., and where .* \(US survey foot\), height_unit="),
    ("EPSG:5715", False, r"Pass a constant undulation in m or the path of a geoid grid as vertical_datum="),
]


@pytest.mark.costly
@pytest.mark.parametrize("datum, by_caller, message", REFUSALS)
def test_the_refusal_recommends_nothing_that_loses_sign_or_unit(datum: str, by_caller: bool, message: str) -> None:
    stated = None if by_caller else pyproj.CRS(datum)
    with pytest.raises(VerticalDatumError, match="(?s)" + message) as refused:
        height_shift(datum if by_caller else None, stated)
    assert ("Pass a constant" in str(refused.value)) != ("depths for heights" in str(refused.value))


def test_what_the_refusal_recommends_for_depths_works(tmp_path: pathlib.Path) -> None:
    import rasterio

    path = write(tmp_path / "dem.tif", HEIGHTS)
    with pytest.raises(VerticalDatumError, match="let the CRS of the file name the depth system"):
        read_dem(path, vertical_datum=5715)
    with rasterio.open(path, "r+") as data:  # gdal_edit -a_srs EPSG:4326+5715
        data.crs = "EPSG:4326+5715"
    np.testing.assert_allclose(posts(path, vertical_datum=47.5), 47.5 - HEIGHTS, rtol=0, atol=1e-9)


def test_a_caller_may_not_turn_depths_into_heights(tmp_path: pathlib.Path) -> None:
    path = write(tmp_path / "dem.tif", HEIGHTS, crs="EPSG:4326+5715")
    with pytest.raises(VerticalDatumError, match=r"'MSL depth', the caller says 'MSL height'"):
        read_dem(path, vertical_datum=5714)


@pytest.mark.parametrize("crs, up", [("EPSG:32651", 1.0), ("EPSG:32651+5715", -1.0), ("EPSG:32651+8053", -1200 / 3937)])
def test_control_points_count_as_their_projection_does(tmp_path: pathlib.Path, crs: str, up: float) -> None:
    path = tmp_path / "gcp_list.txt"
    path.write_text(f"{crs}\n400000 2700000 120.5 10 20 a.jpg p1\n")
    control = read_gcp_list(path, height_datum=20.0)
    np.testing.assert_allclose(control.position.height, [up * 120.5 + 20.0], rtol=0, atol=1e-9)


def test_orientations_in_a_map_of_depths_are_read_and_written_alike(tmp_path: pathlib.Path) -> None:
    path, crs = tmp_path / "block.csv", "EPSG:32631+5715"
    path.write_text("image,x_m,y_m,z_m,omega_deg,phi_deg,kappa_deg\na.jpg,500000,4900000,-800,0.1,0.2,3\n")
    found = read_orientations(path, height_datum=48.0, crs=crs)
    np.testing.assert_allclose(found.pose.position.height, [848.0], rtol=0, atol=1e-9)
    write_orientations(tmp_path / "again.csv", found, height_datum=48.0, crs=crs)
    again = read_orientations(tmp_path / "again.csv", height_datum=48.0, crs=crs)
    np.testing.assert_allclose(again.pose.position.height, [848.0], rtol=0, atol=1e-4)
    with pytest.raises(TableError, match=r"is in US survey foot, but the columns are in metres"):
        read_orientations(path, height_datum=48.0, crs="EPSG:32631+8053")


def test_heights_of_results_are_depths_in_a_depth_system() -> None:
    chart = map_crs("fixes.csv", "EPSG:4326", vertical_crs("down"), None)
    lon, lat, height = (np.array([x]) for x in (5.0, 45.0, 300.0))
    by_proj = pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4326+5773", always_xy=True, allow_ballpark=False)
    np.testing.assert_allclose(
        chart.points("fixes.csv", lon, lat, height)[:, 2], -by_proj.transform(lon, lat, height)[2], rtol=0, atol=1e-6
    )
