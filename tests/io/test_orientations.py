"""Orientations of a block: exact places, the grid's own north, other programs' tables, and what is refused in words.

Held against: PROJ's positions, convergence and scale; the orientations of a block of IGN, France, whose tie points fit;
tables that OpenDroneMap wrote of the block Miaoli; and for other programs see `test_program_tables`.
"""

from __future__ import annotations

import functools
import pathlib
import re
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo import WGS84, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.earth import Geodetic, R_ecef_from_ned
from jaxgeo.io import (
    Orientations,
    TableError,
    VerticalDatumError,
    read_acquisition,
    read_orientations,
    undulation,
    write_orientations,
)
from jaxgeo.io.acquisitions._position_tables import read_positions
from jaxgeo.sensor import Deflection
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_NADIR

LAMBERT = """image,x_m,y_m,z_m,omega_deg,phi_deg,kappa_deg,camera
a,833143.850,6298117.693,1769.986,-0.1995,-0.0165,0.3062,eagle
b,233138.437,6795608.250,1765.763,10.5,-31.25,179.9,eagle
c,1033137.134,6195355.703,1766.170,-100.0,20.0,-90.0,falcon
"""
EARTH = """image,lat_deg,lon_deg,height_m,heading_deg,pitch_deg,roll_deg
a,43.7,4.6,1800.0,350.0,30.0,-1.5
b,43.8,4.7,1810.0,-10.0,-5.0,2.0
"""
R_IMAGE_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])


@pytest.fixture
def table(tmp_path: pathlib.Path):
    """Writes a table and returns its path."""

    def write(content: str) -> pathlib.Path:
        path = tmp_path / "block.csv"
        path.write_text(content, encoding="utf-8", newline="")
        return path

    return write


def attitudes(pose: Pose) -> np.ndarray:
    """R_ned_from_camera of a batch, for a camera in `Mount.nadir()`."""
    R_ned_from_body = jax.jit(jax.vmap(lambda one: one.R_ned_from_body))(pose)
    return np.asarray(R_ned_from_body) @ R_HEAD_FROM_CAMERA_NADIR


def R_ned_from_map(crs: str, x: float, y: float) -> np.ndarray:
    """Directions in north-east-down to the points 1 m east and 1 m north in a map, by PROJ and ECEF, and up."""
    to_lonlat = pyproj.Transformer.from_crs(crs, 4326, always_xy=True)

    def ecef(x: float, y: float) -> np.ndarray:
        lon, lat = to_lonlat.transform(x, y)
        return np.asarray(WGS84.to_ecef(Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)))

    lon, lat = to_lonlat.transform(x, y)
    R = np.asarray(R_ecef_from_ned(Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)))
    steps = [R.T @ (ecef(x + dx, y + dy) - ecef(x - dx, y - dy)) for dx, dy in ((1.0, 0.0), (0.0, 1.0))]
    return np.stack([*(step / np.linalg.norm(step) for step in steps), [0.0, 0.0, -1.0]], axis=1)


@pytest.mark.parametrize(
    "crs, rows",
    [
        ("EPSG:2154", LAMBERT),
        ("EPSG:32651", "image,x_m,y_m,z_m,omega_deg,phi_deg,kappa_deg\na,292710,2731048,186.4,28.8,0.94,1.78\n"),
        ("EPSG:32733", "image,x_m,y_m,z_m,omega_deg,phi_deg,kappa_deg\na,292710,6731048,186.4,28.8,0.94,1.78\n"),
        ("EPSG:2053", "image,x_m,y_m,z_m,omega_deg,phi_deg,kappa_deg\na,-60000,3000000,900.0,2.0,1.0,70.0\n"),
        ("EPSG:3413", "image,x_m,y_m,z_m,omega_deg,phi_deg,kappa_deg\na,-200000,-1000000,900.0,2.0,1.0,70.0\n"),
    ],
    ids=["lambert", "utm", "utm south", "gauss", "polar"],
)  # fmt: skip
def test_angles_in_a_map_are_turned_by_its_north_at_each_image(table, crs: str, rows: str) -> None:
    found = read_orientations(table(rows), height_datum="ellipsoid", crs=crs)
    R = attitudes(found.pose)
    for i, row in enumerate(rows.splitlines()[1:]):
        name, *cells = row.split(",")
        x, y, z, *angles = map(float, cells[:6])
        lon, lat = pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(x, y)
        assert found.names[i] == name
        assert np.rad2deg(found.pose.position.lat[i]) == pytest.approx(lat, abs=1e-12)  # deg
        assert np.rad2deg(found.pose.position.lon[i]) == pytest.approx(lon, abs=1e-12)
        assert found.pose.position.height[i] == z
        R_map_from_image = Rotation.from_euler("XYZ", angles, degrees=True).as_matrix()
        expected = R_ned_from_map(crs, x, y) @ R_map_from_image @ R_IMAGE_FROM_CAMERA
        np.testing.assert_allclose(R[i], expected, atol=2e-8)  # of 1 nm over 2 m, and in some maps of y not square to x


def test_the_north_of_a_conformal_map_is_that_of_proj(table) -> None:
    rows = LAMBERT.replace("-0.1995,-0.0165,0.3062", "0,0,0").replace("10.5,-31.25,179.9", "0,0,0")
    found = read_orientations(table(rows), height_datum="ellipsoid", crs="EPSG:2154").of([0, 1])
    lat, lon = (np.rad2deg(x) for x in (found.pose.position.lat, found.pose.position.lon))
    expected = pyproj.Proj("EPSG:2154").get_factors(lon, lat).meridian_convergence
    np.testing.assert_allclose(np.rad2deg(found.pose.heading), expected, atol=1e-8, rtol=0)  # deg
    assert found.pose.heading[0] > 0.0  # east of the central meridian grid north lies to the right of true north
    np.testing.assert_allclose([found.pose.pitch, found.pose.roll], 0.0, atol=1e-12)


def test_the_angles_of_ign_are_those_of_photogrammetry() -> None:
    angles = np.random.default_rng(1).uniform(-1.5, 1.5, (20, 3))
    theirs = Rotation.from_euler("x", np.pi) * Rotation.from_euler("xyz", -angles)
    ours = Rotation.from_euler("XYZ", angles).as_matrix() @ R_IMAGE_FROM_CAMERA
    np.testing.assert_allclose(theirs.as_matrix(), np.swapaxes(ours, 1, 2), atol=1e-14)


def test_on_the_earth(table) -> None:
    found = read_orientations(table(EARTH), height_datum="ellipsoid")
    assert len(found) == 2
    assert (found.camera, found.sigma, found.time) == (None, None, None)
    np.testing.assert_allclose(np.rad2deg(found.pose.heading), [350.0, -10.0], atol=1e-12, rtol=0)
    np.testing.assert_allclose(np.rad2deg(found.pose.position.lon), [4.6, 4.7], atol=1e-12, rtol=0)
    np.testing.assert_allclose(np.rad2deg([found.pose.pitch, found.pose.roll]), [[30.0, -5.0], [-1.5, 2.0]], atol=1e-12)


def test_heights_are_made_ellipsoidal(table) -> None:
    geoid = undulation(np.array([43.7, 43.8]), np.array([4.6, 4.7]))
    on_earth = read_orientations(table(EARTH), height_datum="EPSG:5773")
    np.testing.assert_allclose(on_earth.pose.position.height, np.array([1800.0, 1810.0]) + geoid, atol=1e-3)  # m
    in_map = read_orientations(table(LAMBERT), height_datum=47.0, crs=2154)
    np.testing.assert_allclose(in_map.pose.position.height, np.array([1769.986, 1765.763, 1766.17]) + 47.0, atol=1e-9)


def test_heights_stretched_with_the_map_are_restored(table) -> None:
    path = table(LAMBERT)
    plain = read_orientations(path, height_datum=0.0, crs=2154).pose.position
    ground = np.array([3.0, 20.0, 100.0])
    true = read_orientations(path, height_datum=0.0, crs=2154, linear_alteration_above=ground).pose.position.height
    lon, lat = np.rad2deg(plain.lon), np.rad2deg(plain.lat)
    scale = pyproj.Proj(2154).get_factors(lon, lat).meridional_scale
    assert np.all(np.abs(scale - 1.0) > 1e-4)
    np.testing.assert_allclose(true + (scale - 1.0) * (true - ground), plain.height, atol=1e-9)  # m


SIGMA = np.array([[0.01, 0.02, 0.03, 1e-4, 2e-4, 3e-4], [0.1, 0.2, 0.3, 1e-3, 2e-3, 3e-3]])


@pytest.mark.costly
@pytest.mark.parametrize("crs", [None, "EPSG:2154", "EPSG:32631"])
@pytest.mark.parametrize("datum", ["ellipsoid", "EPSG:5773"])
def test_what_is_written_reads_back(table, tmp_path: pathlib.Path, crs: str | None, datum: str) -> None:
    pose = read_orientations(table(EARTH), height_datum="ellipsoid").pose
    block = Orientations(np.array(["a,1.tif", "b"]), pose, np.array(["x", "y z"]), SIGMA, np.array([0.5, 1e9]))
    write_orientations(tmp_path / "out.csv", block, crs=crs, height_datum=datum)
    back = read_orientations(tmp_path / "out.csv", height_datum=datum, crs=crs)
    for name in ("names", "camera", "time"):
        np.testing.assert_array_equal(getattr(back, name), getattr(block, name))
    assert back.sigma is not None
    np.testing.assert_allclose(back.sigma, SIGMA, rtol=1e-8)
    there, here = (np.asarray(jax.jit(jax.vmap(WGS84.to_ecef))(one.pose.position)) for one in (back, block))
    np.testing.assert_allclose(there, here, atol=1e-4, rtol=0)  # m
    np.testing.assert_allclose(attitudes(back.pose), attitudes(block.pose), atol=3e-10)  # 1e-8 deg and a little


@pytest.mark.parametrize("datum", ["ellipsoid", "EPSG:5773", -31.5])
def test_a_table_states_the_datum_of_its_heights(table, tmp_path: pathlib.Path, datum: str | float) -> None:
    """Then it need not be given; another one is refused, of orientations as of positions."""
    pose = read_orientations(table(EARTH), height_datum="ellipsoid").pose
    path = tmp_path / "out.csv"
    write_orientations(path, Orientations(np.array(["a", "b"]), pose), height_datum=datum)
    back = read_acquisition(path)
    np.testing.assert_allclose(back.shots.pose.position.height, pose.position.height, atol=1e-4, rtol=0)
    assert back.assumed[0].endswith(", by the table.")
    position = read_positions(path, height_datum=None, crs=None).position
    np.testing.assert_array_equal(position.height, back.shots.pose.position.height)
    for read in (read_acquisition, read_orientations, functools.partial(read_positions, crs=None)):
        with pytest.raises(TableError, match=r"its column height_datum says that .*, but height_datum=12\.5; leave"):
            read(path, height_datum=12.5)


@pytest.mark.parametrize(
    "cells, message",
    [
        (("ellipsoid", "EPSG:5773"), "states both EPSG:5773 and ellipsoid"),
        (("/vsicurl/http://a.b/egm96.tif",) * 2, "states '/vsicurl/http://a.b/egm96.tif', not ellipsoid, EPSG:CODE"),
    ],
)
def test_a_datum_that_a_table_cannot_state_is_refused(table, cells: tuple[str, str], message: str) -> None:
    head, *rows = EARTH.strip().splitlines()
    lines = [f"{head},height_datum", *(f"{row},{cell}" for row, cell in zip(rows, cells, strict=True))]
    with pytest.raises(TableError, match=re.escape(message)):
        read_orientations(table("\n".join(lines)), height_datum=None)


def test_an_attitude_against_the_plumb_line_is_written_about_the_normal(table, tmp_path: pathlib.Path) -> None:
    pose = read_orientations(table(EARTH), height_datum="ellipsoid").pose
    bent = Pose(pose.position, pose.heading, pose.pitch, pose.roll, Deflection(np.full(2, 5e-5), np.full(2, -3e-5)))
    write_orientations(tmp_path / "out.csv", Orientations(np.array(["a", "b"]), bent))
    back = read_orientations(tmp_path / "out.csv", height_datum="ellipsoid")
    np.testing.assert_allclose(attitudes(back.pose), attitudes(bent), atol=3e-10)


ODM_OPK = """'filename' 'x' 'y' 'z' 'omega' 'phi' 'kappa' 'camera'
'DJI 18' 292746.19 2731093.469 186.56 -2.728 -30.083 -93.729 'dji fc6310r 5472 3648'
'DJI 36'  292742.252 2731078.974 186.663 -30.071 1.882 175.984 'dji fc6310r 5472 3648'
"""
ODM_RPY = """filename latitude longitude altitude roll pitch yaw camera other
18.tif 24.68027804 120.9517016 186.57 0.0 30.0 92.9 "dji fc6310r 5472 3648" ignored
36.tif 24.68014678 120.95166508 186.65 0.0 30.0 -175.8 "dji fc6310r 5472 3648" ignored
"""


def test_the_tables_of_opendronemap(table) -> None:
    in_map = read_orientations(table(ODM_OPK), height_datum="ellipsoid", crs="EPSG:32651")
    assert in_map.names.tolist() == ["DJI 18", "DJI 36"]
    assert in_map.camera is not None
    assert set(in_map.camera.tolist()) == {"dji fc6310r 5472 3648"}
    on_earth = read_orientations(table(ODM_RPY), height_datum="ellipsoid")
    assert on_earth.names.tolist() == ["18.tif", "36.tif"]
    # What the drone reported of itself is near what was adjusted: one convention.
    for name, bound in (("heading", 1.1), ("pitch", 0.3), ("roll", 1.1)):  # deg
        difference = np.rad2deg(getattr(in_map.pose, name) - getattr(on_earth.pose, name))
        assert np.all(np.abs(difference) < bound)
    for name in ("lat", "lon"):
        difference = getattr(in_map.pose.position, name) - getattr(on_earth.pose.position, name)
        assert np.all(np.abs(difference * 6.4e6) < 3.0)  # m
    np.testing.assert_allclose(in_map.pose.position.height, on_earth.pose.position.height, atol=0.05)


def test_the_table_of_ign(table) -> None:
    _, *rows = LAMBERT.replace(",", "   ").splitlines()
    path = table("\r\n".join(["NOM\tX\tY\tZ\tO\tP\tK\tCAMERA", *rows, ""]))
    found = read_orientations(path, height_datum="ellipsoid", crs="EPSG:2154")
    same = read_orientations(table(LAMBERT), height_datum="ellipsoid", crs="EPSG:2154")
    for one, other in zip(jax.tree.leaves(found.pose), jax.tree.leaves(same.pose), strict=True):
        np.testing.assert_array_equal(one, other)
    assert found.camera is not None
    assert found.camera.tolist() == ["eagle", "eagle", "falcon"]


HEADER = LAMBERT.splitlines()[0]
SIX = "sigma_north_m,sigma_east_m,sigma_down_m,sigma_heading_deg,sigma_pitch_deg,sigma_roll_deg"
ONE = f"image,x,y,z,o,p,k,{SIX}\na,833143,6298117,9,0,0,0,1,0,1,1,1,1\n"
MAP: dict[str, Any] = {"crs": "EPSG:2154"}
REFUSED = {
    "no crs": (LAMBERT, {}, ["x_m is projected, and the file states no CRS: pass that of its map, such as crs="]),
    "crs too much": (EARTH, MAP, [r"no column x_m \(or x, x/east\)", "lat_deg is on the Earth: leave crs= out"]),
    "missing": (LAMBERT.replace("kappa_deg", "kapa"), MAP, [r"no column kappa_deg \(or kappa, k\); found image, x_m"]),
    "no image": (EARTH.replace("image", "photo"), {}, [r"no column image \(or filename, nom\)"]),
    "twice": (LAMBERT.replace("\nc,", "\na,"), MAP, ["rows 2 and 4: image a is there twice"]),
    "nameless": (LAMBERT.replace("\nb,", "\n ,"), MAP, ["row 3, column image: the name is empty"]),
    "word": (LAMBERT.replace("179.9", "north"), MAP, ["row 3, column kappa_deg: 'north' is not a number"]),
    "nan": (EARTH.replace("30.0", "nan"), {}, [r"row 2, column pitch_deg: unknown \(nan\)"]),
    "range": (EARTH.replace("43.8", "143.8"), {}, [r"row 3, column lat_deg: 143.8 is outside \[-90, 90\] deg"]),
    "two columns": ("image,filename\na,a\n", {}, ["image and filename both mean"]),
    "cells": (EARTH.replace("-1.5", "-1,5"), {}, ["row 2: 8 cells, but the header has 7"]),
    "words": (ODM_RPY.replace('"', ""), {}, ["row 2: 12 words, but the header has 9; names with white"]),
    "no rows": (HEADER, MAP, ["no rows below the header"]),
    "no rows of words": (HEADER.replace(",", " "), MAP, ["no rows below the header"]),
    "some sigmas": (ONE.replace(SIX, "sigma_east_m").replace("1,0,1,1,1,1", "1"), MAP,
                    ["no column sigma_north_m, sigma_down_m", "all six, or none"]),
    "zero sigma": (ONE, MAP, ["column sigma_east_m: 0 is outside"]),
    "unknown crs": (LAMBERT, {"crs": "EPSG:1"}, ["crs = 'EPSG:1' is unknown to PROJ"]),
    "no degrees": (LAMBERT, {"crs": "EPSG:4326"}, ["are no longitude and latitude in deg, but crs is 'WGS 84'"]),
    "feet": (LAMBERT, {"crs": "EPSG:2263"}, ["in US survey foot, but the columns are in metres"]),
    "mirrored": (LAMBERT, {"crs": "EPSG:5513"}, ["row 2, column x_m", "mirrored"]),
    "outside": (LAMBERT.replace("833143.850", "83314385"), {"crs": "EPSG:32631"}, ["row 2, column x_m.*has no place"]),
    "alteration": (EARTH, {"linear_alteration_above": 3.0}, ["linear_alteration_above= is of heights in a map"]),
    "no datum": (LAMBERT, {"crs": "+proj=utm +zone=31 +ellps=intl"}, ["PROJ knows no transf", r"\+datum=WGS84"]),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_wrong_tables(table, case: str) -> None:
    content, options, words = REFUSED[case]
    path = table(content)
    for word in words:
        with pytest.raises(TableError, match=f"block.csv.*{word}"):
            read_orientations(path, height_datum="ellipsoid", **options)


def test_what_the_caller_gives_wrong(table, tmp_path: pathlib.Path) -> None:
    with pytest.raises(FileNotFoundError, match="there is no such table of orientations"):
        read_orientations(tmp_path / "nowhere.csv", height_datum="ellipsoid")
    for path, options in ((table(EARTH), {}), (tmp_path / "block.csv", {})):
        with pytest.raises(VerticalDatumError, match=r"block\.csv: height_datum='EPSG:0' is unknown"):
            read_orientations(path, height_datum="EPSG:0", **options)
    with pytest.raises(VerticalDatumError, match="the caller says"):
        read_orientations(table(LAMBERT), height_datum="EPSG:5773", crs="EPSG:2154+5720")
    with pytest.raises(VerticalDatumError, match=r"does not state the vertical datum of its heights.*height_datum="):
        read_orientations(table(EARTH))
    block = read_orientations(table(EARTH), height_datum="ellipsoid")
    with pytest.raises(ValueError, match="image a is there 2 times"):
        Orientations(np.array(["a", "a"]), block.pose)
    with pytest.raises(ValueError, match=r"sigma must have the shape \(2, 6\) for 2 images; got \(2, 3\)"):
        Orientations(block.names, block.pose, sigma=np.ones((2, 3)))
    with pytest.raises(ValueError, match=r"pose must hold an entry for each of 1 images; got shape \(2,\)"):
        Orientations(block.names[:1], block.pose)
    lost = Orientations(block.names, Pose(block.pose.position, np.array([0.0, np.nan])))
    with pytest.raises(ValueError, match="the pose of image b is not finite"):
        write_orientations(tmp_path / "out.csv", lost)
    assert not (tmp_path / "out.csv").exists()


def test_a_real_table_of_opendronemap(jaxgeo_test_data: pathlib.Path) -> None:
    folder = jaxgeo_test_data / "odm_miaoli"
    in_map = read_orientations(folder / "odm_xyz_opk.csv", height_datum="ellipsoid", crs="EPSG:32651")
    on_earth = read_orientations(folder / "odm_lla_rpy.csv", height_datum="ellipsoid")
    assert len(in_map) == len(on_earth) == 4
    rows = [on_earth.names.tolist().index(f"{name}.tif") for name in in_map.names]
    found, told = attitudes(in_map.pose), attitudes(on_earth.of(rows).pose)
    turn = Rotation.from_matrix(np.swapaxes(told, 1, 2) @ found).magnitude()
    assert np.all(np.rad2deg(turn) < 1.8)  # what a drone knows of its gimbal


@pytest.mark.slow
def test_a_real_block_of_ign_fits_its_ties(jaxgeo_test_data: pathlib.Path) -> None:
    """To 0.2 pixels in ECEF, with the convergence of the grid and without the linear alteration."""
    folder = jaxgeo_test_data / "ign_block"
    geoid = jaxgeo_test_data / "geoid" / "fr_ign_RAF20.tif"
    ground = {name: [float(x) for x in xyz] for name, *xyz in _words(folder / "all_liaisons2_world.mes")}
    ties = [tie for tie in _words(folder / "all_liaisons2.mes") if tie[0] in ground]
    uv = np.array([[float(x) for x in tie[2:4]] for tie in ties])
    x, y, height = np.array([ground[tie[0]] for tie in ties]).T
    lon, lat = pyproj.Transformer.from_crs(2154, 4326, always_xy=True).transform(x, y)
    points = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    camera = FrameCamera.from_pixels(focal_px=30975.0, width=26460, height=17004, principal_px=(13210.0, 8502.0))
    sensor = Sensor(camera, Gimbal.fixed(), Mount.nadir())
    project = jax.jit(jax.vmap(lambda pose, point: sensor.project_ecef(Shot(pose), WGS84.to_ecef(point))[0]))
    for above, largest in ((3.0, 0.21), (None, 2.4)):  # m of ground, rms in pixels
        block = read_orientations(
            folder / "23FD1305_alt_2.OPK", height_datum=str(geoid), crs="EPSG:2154", linear_alteration_above=above
        )
        row = {name: i for i, name in enumerate(block.names)}
        rows = np.array([row[tie[1]] for tie in ties])
        found = project(jax.tree.map(lambda x, rows=rows: x[rows], block.pose), points)
        rms = np.sqrt(np.mean((np.asarray(found) - uv) ** 2, axis=0))
        assert np.all(rms < largest)
        assert above is not None or np.all(rms > 1.0)


def _words(path: pathlib.Path) -> list[list[str]]:
    return [line.split() for line in path.read_text().splitlines() if line.strip()]


def test_angles_in_gon(table) -> None:
    rows = "image,x,y,z,{}\na,292710,2731048,186.4,{}\n"
    in_deg = read_orientations(
        table(rows.format("omega,phi,kappa", "28.8,0.9,-179.1")), height_datum="ellipsoid", crs=32651
    )
    for header in ("omega_gon,phi_gon,kappa_gon", "Omega[gon],Phi[gon],Kappa[gon]"):
        in_gon = read_orientations(table(rows.format(header, "32.0,1.0,-199.0")), height_datum="ellipsoid", crs=32651)
        np.testing.assert_allclose(attitudes(in_gon.pose), attitudes(in_deg.pose), atol=1e-14)
    for header, cells, words in (
        ("omega_gon,phi,kappa", "1,2,3", "columns omega_gon and phi are there; give all three angles in one unit"),
        ("omega_gon,phi_gon", "1,2", "no column kappa_gon"),
        ("omega_gon,phi_gon,kappa_gon", "1,2,500", r"column kappa_gon: 500 is outside \[-400, 400\] gon"),
    ):
        with pytest.raises(TableError, match=words):
            read_orientations(table(rows.format(header, cells)), height_datum="ellipsoid", crs=32651)


@pytest.mark.parametrize("unit, factor", [("rad", np.pi / 180.0), ("gon", 1.0 / 0.9)])
@pytest.mark.parametrize(
    "names, crs", [("omega,phi,kappa", 32651), ("yaw,pitch,roll", 32651), ("yaw,pitch,roll", None)]
)
def test_angles_in_other_units(table, unit: str, factor: float, names: str, crs: int | None) -> None:
    """By the names of the columns, for all angles alike, and recognised by them."""
    places = "image,x,y,z" if crs else "image,lat,lon,height"
    at = "a,292710,2731048,186.4" if crs else "a,24.68,120.95,186.4"
    degrees = [28.8, 0.9, -179.1]
    how: dict[str, Any] = {"height_datum": "ellipsoid"} | ({"crs": crs} if crs else {})
    of_deg = read_orientations(table(f"{places},{names}\n{at},{','.join(map(str, degrees))}\n"), **how)
    cells = ",".join(repr(factor * one) for one in degrees)
    for form in ("{}_" + unit, "{}[" + unit + "]", "{} (" + unit + ")"):
        header = ",".join(form.format(name) for name in names.split(","))
        path = table(f"{places},{header}\n{at},{cells}\n")
        np.testing.assert_allclose(attitudes(read_orientations(path, **how).pose), attitudes(of_deg.pose), atol=1e-14)
        found = read_acquisition(path, **how)
        assert not any("not read" in one for one in found.assumed)
    header = f"{names},{names.split(',')[0]}_{unit}"
    with pytest.raises(TableError, match=f"{names.split(',')[0]} are there; give all three angles in one unit"):
        read_orientations(table(f"{places},{header}\n{at},1,2,3,4\n"), **how)


def strips(kappas: np.ndarray, tilt: float) -> str:
    """Images of a block: kappas, and omega and phi drawn with a standard deviation."""
    small = np.random.default_rng(7).normal(0.0, tilt, (len(kappas), 2))
    rows = (
        f"{k},{292710 + 50 * k},2731048,186.4,{omega:.6f},{phi:.6f},{kappa:.6f}"
        for k, ((omega, phi), kappa) in enumerate(zip(small, kappas, strict=True))
    )
    return "image,x,y,z,omega,phi,kappa\n" + "\n".join(rows) + "\n"


TO_AND_FRO = np.repeat([0.05, -3.1, 0.02, 3.08], 3)  # rad
NORTH_AND_SOUTH = np.tile([1.55, -1.6], 6)  # rad
ALL_ROUND = np.linspace(-3.0, 3.0, 12)  # rad
ONE_WAY = np.array([-2.9, 1.3, 0.4, 2.2, -1.1, 0.7, -0.3, 3.0, -2.0, 1.7, 0.1, -0.8])  # deg, of a drone in wind


@pytest.mark.parametrize(
    "kappas, tilt, doubtful",
    [
        (TO_AND_FRO, 0.03, True),
        (NORTH_AND_SOUTH, 0.03, True),
        (ALL_ROUND, 0.03, True),
        (np.rad2deg(TO_AND_FRO), 1.5, False),
        (ONE_WAY, 1.5, False),
        (np.full(12, 0.4), 1.5, False),
        (TO_AND_FRO[::3], 0.03, True),
        (TO_AND_FRO[:3:2], 0.03, False),  # too few to tell
        (np.repeat([1.5708, -1.5708], 3), 0.03, True),
        (np.full(3, 1.5708), 0.03, True),
        (np.linspace(-0.02, 0.03, 10), 0.003, True),  # one strip to the north
        (np.linspace(-0.02, 0.03, 10), 0.0, False),  # planned images, level to the last digit
        (TO_AND_FRO[::3], 1.5, False),  # tilted by degrees
        (np.linspace(-3.0, 3.0, 8), 1.5, False),  # deg, of a strip to the north
        (np.linspace(-3.0, 3.0, 8), 0.03, False),  # deg, with a camera held level
    ],
)
def test_radians_taken_for_degrees_are_doubtful(table, kappas: np.ndarray, tilt: float, doubtful: bool) -> None:
    content = strips(kappas, tilt)
    found = read_acquisition(table(content), height_datum="ellipsoid", crs=32651)
    doubts = [one for one in found.assumed if one.startswith("Check: ")]
    if doubtful:
        assert "as those in radians are, and are taken in deg" in doubts[0]
        named = table(content.replace("omega,phi,kappa", "omega_rad,phi_rad,kappa_rad"))
        again = read_acquisition(named, height_datum="ellipsoid", crs=32651)
        assert not any(one.startswith("Check: ") for one in again.assumed)
        assert "name the columns omega_rad, phi_rad, kappa_rad" in doubts[0]
    else:
        assert doubts == []


def test_headings_in_radians_are_doubtful_too(table) -> None:
    rows = [f"{k},24.68,{120.95 + 1e-3 * k},186.4,{TO_AND_FRO[k] % (2 * np.pi):.5f},0.01,-0.02" for k in range(12)]
    path = table("image,lat,lon,height,yaw,pitch,roll\n" + "\n".join(rows) + "\n")
    found = read_acquisition(path, height_datum="ellipsoid")
    assert any("name the columns heading_rad, pitch_rad, roll_rad" in one for one in found.assumed)
