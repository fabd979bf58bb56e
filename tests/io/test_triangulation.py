"""Orientations of PAT-B and BINGO: where they put a ground point in the image, and what is refused in a line.

Held against: the records of PAT-B as PCI Geomatics prints them, "Using Pat-B in OrthoEngine"; the records ORIA of BINGO
and their rotation, as in S. Turek, "Implementation of bundle block adjustment method for determination of exterior
orientation into GRASS GIS" (CTU in Prague, 2014), which compares with BINGO. The pixel of a ground point is computed
here with NumPy and PROJ: collinearity in the tangent plane of the camera, turned by the convergence of the map.
"""

from __future__ import annotations

import csv
import pathlib
from typing import Any

import jax
import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation
from support.command_runner import CliRunner

from jaxgeo import FrameCamera
from jaxgeo.cli import app
from jaxgeo.io import TableError, read_acquisition, read_acquisitions, read_orientations
from jaxgeo.io.acquisitions._position_tables import read_positions
from jaxgeo.io.acquisitions.detect import form_of

UTM = "EPSG:32616"
CENTRE = np.array([751_000.125, 4_020_000.5, 2_900.25])  # well off the central meridian: the grid is turned by 1.7 deg
GROUND = np.array([751_310.0, 4_019_620.0, 410.0])
OPK = {"101": (1.25, -2.5, 31.0), "DSC_0102.JPG": (-28.0, 12.0, -170.0), "oblique": (3.0, 41.0, 95.0)}  # deg
FOCAL, SIZE = 9_000.0, (11_000, 7_000)
CAMERA = FrameCamera.from_pixels(focal_px=FOCAL, width=SIZE[0], height=SIZE[1])
LENS = "focal=54mm,pitch=6um,size=11000x7000"


def patb(breaks: tuple[int, ...] = (5, 4), focal: str = "", rows: dict[str, np.ndarray] | None = None) -> str:
    """Records in the columns of PAT-B: I16, 16X, 3F16.5; 5F16.12; 4F16.12."""
    lines = []
    for name, R in (rows or {name: matrix(*angles) for name, angles in OPK.items()}).items():
        lines.append(f"{name:>16}{focal:>16}" + "".join(f"{one:16.5f}" for one in CENTRE))
        elements, start = R.ravel(), 0
        for count in breaks:
            lines.append("".join(f"{one:16.12f}" for one in elements[start : start + count]))
            start += count
    return "\n".join(lines) + "\n"


def matrix(omega: float, phi: float, kappa: float) -> np.ndarray:
    """Rx(omega) Ry(phi) Rz(kappa), of angles in deg: image axes (right, up, out of the scene) to the map's."""
    return Rotation.from_euler("XYZ", [omega, phi, kappa], degrees=True).as_matrix()


def bingo() -> str:
    """Records ORIA, with phi, omega and kappa in gon for the same rotations, among others."""
    lines = ["* BINGO  ITERA", "CORD 4711 751000.0 4020000.0 410.0 1", ""]
    for name, angles in OPK.items():
        pok = Rotation.from_matrix(matrix(*angles)).as_euler("YXZ", degrees=True) / 0.9
        lines.append(" ".join(["ORIA", name, *(f"{one:.8f}" for one in (*CENTRE, *pok)), "1"]))
    return "\n".join(lines) + "\n"


def pixel(name: str) -> np.ndarray:
    """Column and row of the ground point in an image, by collinearity."""
    to_earth = pyproj.Transformer.from_crs(UTM, 4326, always_xy=True)
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    lon, lat = to_earth.transform(*CENTRE[:2])
    camera, ground = (np.array(to_ecef.transform(*to_earth.transform(*one[:2]), one[2])) for one in (CENTRE, GROUND))
    turn = np.deg2rad(pyproj.Proj(UTM).get_factors(lon, lat).meridian_convergence)
    lam, phi = np.deg2rad([lon, lat])
    east = np.array([-np.sin(lam), np.cos(lam), 0.0])
    up = np.array([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)])
    north = np.cross(up, east)
    e, n, u = (axis @ (ground - camera) for axis in (east, north, up))
    in_map = np.array([np.cos(turn) * e - np.sin(turn) * n, np.sin(turn) * e + np.cos(turn) * n, u])
    x, y, z = matrix(*OPK[name]).T @ in_map
    return np.array([(SIZE[0] - 1) / 2 - FOCAL * x / z, (SIZE[1] - 1) / 2 + FOCAL * y / z])


@jax.jit
def projected(sensor: Any, shot: Any, p_ecef: Any) -> Any:
    return sensor.project_ecef(shot, p_ecef)[0]


LAYOUTS = {
    "PAT-B": patb(),
    "PAT-B with focal lengths": patb(focal="153000.0"),
    "PAT-B, three lines of three": patb((3, 3, 3)),
    "PAT-B with line ends of Windows": patb().replace("\n", "\r\n"),
    "BINGO": bingo(),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_ground_point_is_where_collinearity_puts_it(tmp_path: pathlib.Path, layout: str) -> None:
    path = tmp_path / "block.ori"
    path.write_text(LAYOUTS[layout], encoding="utf-8", newline="")
    assert form_of(path).name == "table of orientations"
    found = read_acquisition(path, height_datum="ellipsoid", crs=UTM, cameras=CAMERA)
    assert found.names.tolist() == list(OPK)
    to_earth = pyproj.Transformer.from_crs(UTM, 4326, always_xy=True)
    to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
    p_ecef = np.array(to_ecef.transform(*to_earth.transform(*GROUND[:2]), GROUND[2]))
    for k, name in enumerate(OPK):
        sensor, shot, _ = found.exposure(k)
        np.testing.assert_allclose(projected(sensor, shot, p_ecef), pixel(name), atol=0.02)  # pixels
    assert any("image axes (right, up and out of the scene)" in one for one in found.assumed)
    assert any("Focal lengths in the file are not read" in one for one in found.assumed) == ("focal" in layout)


@pytest.mark.costly
def test_the_ground_point_is_found_on_the_command_line(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "itera.dat"
    path.write_text(bingo(), encoding="utf-8")
    (tmp_path / "itera.prj").write_text(pyproj.CRS(UTM).to_wkt("WKT1_ESRI"), encoding="utf-8")
    u, v = pixel("101")
    output = tmp_path / "fix.csv"
    line = ["locate", path, "--camera-datum", "ellipsoid", "--ground", "410", "--pixel", f"{u},{v}"]
    missing = CliRunner().invoke(app, [str(one) for one in line])
    assert missing.exit_code == 2
    assert "a table of orientations has no camera; give --scene" in missing.stderr
    result = CliRunner().invoke(app, [str(one) for one in [*line, "--camera", LENS, "-o", output]])
    assert result.exit_code == 0, result.output
    assert "by itera.prj beside the file" in result.stderr.replace("\n", " ")
    with open(output, newline="", encoding="utf-8") as file:
        fix = next(csv.DictReader(file))
    assert fix["name"] == "101"
    x, y = pyproj.Transformer.from_crs(4326, UTM, always_xy=True).transform(
        float(fix["fix_lon_deg"]), float(fix["fix_lat_deg"])
    )
    np.testing.assert_allclose([x, y], GROUND[:2], atol=0.01)  # m


def test_the_examples_of_the_guide_are_one_image(tmp_path: pathlib.Path) -> None:
    """Both, as printed, have the pose of omega 0.35, phi -0.3, kappa 91.2 deg."""
    text = (pathlib.Path(__file__).parents[2] / "docs/howto/navigation.md").read_text(encoding="utf-8")
    blocks = [block.partition("```")[0] for block in text.split("```text\n")[1:]]
    sensors: list[np.ndarray] = []
    for block in [one for one in blocks if one.split()[0] in ("101", "ORIA")]:
        path = tmp_path / f"{len(sensors)}.ori"
        path.write_text(block, encoding="utf-8")
        found = read_acquisition(path, height_datum="ellipsoid", crs=UTM, cameras=CAMERA)
        parts: Any = found.exposure(0)
        sensor, shot, _ = parts
        sensors.append(np.asarray(sensor.R_ned_from_camera(shot)))
    assert len(sensors) == 2
    to_earth = pyproj.Transformer.from_crs(UTM, 4326, always_xy=True)
    turn = pyproj.Proj(UTM).get_factors(*to_earth.transform(*CENTRE[:2])).meridian_convergence
    map_axes = Rotation.from_euler("z", turn, degrees=True).as_matrix().T  # to east, north and up
    R_enu_from_image = map_axes @ matrix(0.35, -0.3, 91.2)
    R_ned_from_enu = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    expected = R_ned_from_enu @ R_enu_from_image @ np.diag([1.0, -1.0, -1.0])  # of right, down and forward
    for one in sensors:
        np.testing.assert_allclose(one, expected, atol=2e-7)


def test_positions_of_images_come_from_the_same_files(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "block.ori"
    path.write_text(patb(), encoding="utf-8")
    table = read_positions(path, height_datum="ellipsoid", crs=UTM)
    assert table.names is not None
    assert table.names.tolist() == list(OPK)
    np.testing.assert_allclose(table.position.height, CENTRE[2])


def test_a_damaged_file_does_not_stop_the_others(tmp_path: pathlib.Path) -> None:
    (tmp_path / "good.ori").write_text(patb(), encoding="utf-8")
    (tmp_path / "bad.ori").write_text(patb()[:-40], encoding="utf-8")
    files = [tmp_path / "good.ori", tmp_path / "bad.ori"]
    several = read_acquisitions(files, height_datum="ellipsoid", crs=UTM, cameras=CAMERA)
    assert [name for part in several.parts for name in part.names] == list(OPK)
    assert [one.name.endswith("bad.ori") for one in several.unread] == [True]


def without(line: int, word: int, records: str | None = None) -> str:
    """Records of PAT-B without a number, by its line and place in it."""
    lines = (patb() if records is None else records).splitlines()
    words = lines[line].split()
    lines[line] = "  ".join(words[:word] + words[word + 1 :])
    return "\n".join(lines) + "\n"


ONE = {"a": matrix(1.25, -2.5, 31.0)}
NUMBERED = patb(rows={"1": ONE["a"], "2": ONE["a"]})
MIRRORED = {"a": np.diag([1.0, 1.0, -1.0])}
REFUSED: dict[str, tuple[str, str]] = {
    "cut": ("\n".join(patb().splitlines()[:-1]), r"ends within the rotation matrix of image oblique \(row 7\); copy"),
    "not a number": (
        patb().replace("0.", "O.", 24).replace("O.", "0.", 20),
        "PAT-B: expected . more elements of the rotation matrix",
    ),
    "more elements": (
        "\n".join([*patb().splitlines()[:4], patb().splitlines()[1], *patb().splitlines()[4:]]),
        "row 6: PAT-B: expected 4 more elements of the rotation matrix of image DSC_0102.JPG",
    ),
    "a mirror": (patb(rows=MIRRORED), "row 1, rotation matrix of image a: it is no rotation"),
    "rounded too far": (
        patb(rows={"a": np.round(matrix(1.25, -2.5, 31.0), 2)}),
        "row 1, rotation matrix of image a: it is no rotation",
    ),
    "an element of the first image": (
        without(1, 4),
        "row 4: PAT-B: expected 1 more elements of the rotation matrix of image 101 \\(row 1\\); got 'DSC_0102.JPG 75",
    ),
    "an element of the second line": (without(2, 0), "row 4: PAT-B: expected 1 more elements of the rotation matrix"),
    "a line of elements": (
        patb().replace(patb().splitlines()[2] + "\n", "", 1),
        "row 3: PAT-B: expected 4 more elements of the rotation matrix of image 101",
    ),
    "the long line of a numbered image": (
        "\n".join(line for k, line in enumerate(NUMBERED.splitlines()) if k != 1) + "\n",
        "row 3: PAT-B: expected 5 more elements of the rotation matrix of image 1",
    ),
    "a coordinate of the first image": (without(0, 3), "row 1: PAT-B: expected an image, X, Y and Z.*; got '101 751"),
    "an element of the only image": (
        without(1, 2, patb(rows=ONE)),
        r"ends within the rotation matrix of image a \(row 1\)",
    ),
    "no position": (patb() + "  103  751000.0  4020000.0\n", "row 10: PAT-B: expected an image, X, Y and Z"),
    "twice": (patb() + patb(), r"rows 1 and 10: image 101 is there twice"),
    "oria cut": (bingo() + "ORIA 103 751000.0 4020000.0 2900.0 1.0\n", "row 7: expected ORIA, an image, X, Y, Z, phi"),
    "oria in words": (bingo() + "ORIA 103 a b c d e f g\n", "row 7: expected ORIA"),
    "oria beyond a turn": (
        bingo() + "ORIA 103 751000 4020000 2900 1 2 500\n",
        r"row 7: the angle 500 of image 103 is outside \[-400, 400\] gon",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_files_that_are_damaged_are_refused_in_a_line(tmp_path: pathlib.Path, case: str) -> None:
    content, words = REFUSED[case]
    path = tmp_path / "block.ori"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(TableError, match=words) as refused:
        read_acquisition(path, height_datum="ellipsoid", crs=UTM)
    assert "\n" not in str(refused.value)
    assert str(path) in str(refused.value)


def test_the_map_must_be_known(tmp_path: pathlib.Path) -> None:
    path = tmp_path / "block.ori"
    path.write_text(patb(), encoding="utf-8")
    with pytest.raises(TableError, match=r'pass that of its map, such as crs="EPSG:32616".*, or put its block\.prj'):
        read_orientations(path, height_datum="ellipsoid")


@pytest.mark.parametrize("separator", [" ", ",", ";", "\t"])
def test_lists_without_names_of_columns_say_what_is_missing(tmp_path: pathlib.Path, separator: str) -> None:
    path = tmp_path / "list.txt"
    rows = [["a", "751000", "4020000", "2900", "0.1", "0.2", "90"], ["b", "751100", "4020000", "2900", "1", "2", "90"]]
    path.write_text("".join(f"{separator.join(row)}\n" for row in rows), encoding="utf-8")
    with pytest.raises(TableError, match=r"no names of columns.*; write them above, such as image,x_m,y_m"):
        read_acquisition(path, crs=UTM)
