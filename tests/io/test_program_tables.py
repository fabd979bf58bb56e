"""Tables of orientations as other programs export them, and what their angles mean.

Held against: Agisoft's `Metashape.Utils.ypr2mat` (its printed matrix, forum topic 12200) and its published rule that
`mat2opk` and `mat2ypr` are of one matrix; Pix4D's "How are omega, phi, kappa defined"; nerfstudio's and brush's readers
of RealityCapture's "internal/external camera parameters"; MicMac's `orilib.cpp` (`eConvAngPhotoMDegre`, the
default of OriConvert). The files `tab/` of the folder `field` are of these layouts too.
"""

from __future__ import annotations

import pathlib
from typing import Any

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo.io import TableError, read_orientations
from jaxgeo.io.acquisitions import UnstatedDatum, acquisition_of_orientations
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_NADIR

UTM = "EPSG:32616"
X, Y = 751000.12, 4020000.34
R_IMAGE_FROM_CAMERA = np.diag([1.0, -1.0, -1.0])
# What Agisoft prints for Metashape.Utils.ypr2mat(Metashape.Vector((30, 91, 0))): the image's axes (right, up, out of
# the scene) in east, north, up.
YPR2MAT_30_91_0 = [
    [0.8660254037844387, -0.008726203218641737, -0.4999238475781956],
    [-0.49999999999999994, -0.01511422733185856, -0.8658935039207541],
    [0.0, 0.9998476951563913, -0.017452406437283477],
]
# The rotation that Pix4D, Metashape and MicMac call omega, phi, kappa; and Metashape's and RealityCapture's others.
OPK = ("XYZ", [1.0, 1.0, 1.0])
YPR = ("ZXY", [-1.0, 1.0, 1.0])
ANGLES = [(30.0, 20.0, 0.0), (170.348, 85.186, -22.75), (-97.4, -54.5, 3.0), (300.0, 91.0, 178.0)]


def table(path: pathlib.Path, header: str, row: str) -> pathlib.Path:
    path.write_text(f"{header}\n{row}\n", encoding="utf-8")
    return path


def R_enu_from_image(pose: Any) -> np.ndarray:
    """The image's axes (right, up, out of the scene) in true east, north, up, in plain NumPy."""
    angles = [float(np.rad2deg(np.asarray(one)[0])) for one in (pose.heading, pose.pitch, pose.roll)]
    R_ned_from_body = Rotation.from_euler("ZYX", angles, degrees=True).as_matrix()
    R_enu_from_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return R_enu_from_ned @ R_ned_from_body @ np.asarray(R_HEAD_FROM_CAMERA_NADIR) @ R_IMAGE_FROM_CAMERA


def R_enu_from_map(crs: str = UTM, x: float = X, y: float = Y) -> np.ndarray:
    """The grid's axes in true east, north, up, by PROJ's convergence."""
    lon, lat = pyproj.Transformer.from_crs(crs, 4326, always_xy=True).transform(x, y)
    angle = -np.deg2rad(pyproj.Proj(crs).get_factors(lon, lat).meridian_convergence)
    return Rotation.from_euler("z", angle).as_matrix()


def by_rule(rule: tuple[str, list[float]], angles: Any) -> np.ndarray:
    axes, signs = rule
    return Rotation.from_euler(axes, np.array(signs) * angles, degrees=True).as_matrix()


def test_the_rule_of_metashape_is_the_matrix_that_agisoft_prints() -> None:
    np.testing.assert_allclose(by_rule(YPR, (30.0, 91.0, 0.0)), YPR2MAT_30_91_0, atol=1e-15)


LAYOUTS = {  # header, what stands before the angles, separator, rule of the angles
    "pix4d": ("imageName X Y Z Omega Phi Kappa", f"a.JPG {X} {Y} 900.5", " ", OPK),
    "metashape": (
        "# Cameras (1)\n# PhotoID, X, Y, Z, Omega, Phi, Kappa, r11, r12, r13, r21, r22, r23, r31, r32, r33",
        f"a\t{X}\t{Y}\t900.5", "\t", OPK,
    ),
    "metashape reference": (
        '#CoordinateSystem: PROJCS["WGS 84 / UTM zone 16N"]\n#Label,X/East,Y/North,Z/Altitude,Yaw,Pitch,Roll',
        f"a.JPG,{X},{Y},900.5", ",", YPR,
    ),
    "realitycapture": ("#name,x,y,alt,heading,pitch,roll", f"a.jpg,{X},{Y},900.5", ",", YPR),
    "micmac": ("#F=N X Y Z W P K", f"a.JPG {X} {Y} 900.5", " ", OPK),
}  # fmt: skip


@pytest.mark.parametrize("angles", ANGLES)
@pytest.mark.parametrize("program", LAYOUTS)
def test_angles_are_those_of_the_program_in_its_grid(tmp_path: pathlib.Path, program: str, angles: Any) -> None:
    header, row, mark, rule = LAYOUTS[program]
    row = mark.join([row, *map(str, angles), *("1 0 0 0 1 0 0 0 1".split() if program == "metashape" else [])])
    found = read_orientations(table(tmp_path / "eo.txt", header, row), height_datum="ellipsoid", crs=UTM)
    expected = R_enu_from_map() @ by_rule(rule, angles)
    np.testing.assert_allclose(R_enu_from_image(found.pose), expected, atol=2e-9)
    lon, lat = pyproj.Transformer.from_crs(UTM, 4326, always_xy=True).transform(X, Y)
    np.testing.assert_allclose(
        np.rad2deg([found.pose.position.lon[0], found.pose.position.lat[0]]), [lon, lat], atol=1e-11
    )
    assert found.pose.position.height[0] == 900.5


def test_two_exports_of_one_photo_agree(tmp_path: pathlib.Path) -> None:
    """Omega, phi, kappa and yaw, pitch, roll of one matrix, as Metashape exports it both ways."""
    for angles in ANGLES:
        opk = Rotation.from_matrix(by_rule(YPR, angles)).as_euler("XYZ", degrees=True)
        header, row, _, _ = LAYOUTS["metashape"]
        one = table(tmp_path / "opk.txt", header, "\t".join([row, *map(repr, opk.tolist()), *"100010001"]))
        header, row, _, _ = LAYOUTS["metashape reference"]
        other = table(tmp_path / "ref.csv", header, ",".join([row, *map(str, angles)]))
        by_opk = read_orientations(one, height_datum="ellipsoid", crs=UTM)
        by_ypr = read_orientations(other, height_datum="ellipsoid")  # the map is in the file
        np.testing.assert_allclose(R_enu_from_image(by_ypr.pose), R_enu_from_image(by_opk.pose), atol=2e-9)
        np.testing.assert_allclose(by_ypr.pose.position.lat, by_opk.pose.position.lat, atol=1e-15)


def test_micmac_on_the_earth_is_against_east_north_and_up(tmp_path: pathlib.Path) -> None:
    path = table(tmp_path / "ori.txt", "#F=N Y X Z K W P", "a.JPG 36.3 -84.2 900.0 30 -60 0")
    found = read_orientations(path, height_datum="ellipsoid", crs="EPSG:4326")
    np.testing.assert_allclose(np.rad2deg([found.pose.position.lat[0], found.pose.position.lon[0]]), [36.3, -84.2])
    np.testing.assert_allclose(R_enu_from_image(found.pose), by_rule(OPK, (-60.0, 0.0, 30.0)), atol=1e-12)
    assert any("as MicMac's OriConvert does" in one for one in found.assumed)
    named = table(tmp_path / "ori.txt", "#F=N Y X Z K W P\n#\n#image latitude longitude altitude yaw pitch roll",
                  "a.JPG 36.3 -84.2 900.0 30 20 1")  # fmt: skip
    found = read_orientations(named, height_datum="ellipsoid")
    np.testing.assert_allclose(np.rad2deg([found.pose.heading[0], found.pose.pitch[0]]), [30.0, 20.0], atol=1e-12)


def test_what_was_taken_for_granted_is_said(tmp_path: pathlib.Path) -> None:
    header, row, *_ = LAYOUTS["metashape reference"]
    path = table(tmp_path / "ref.csv", header, f"{row},30,20,0")
    convergence = -np.rad2deg(Rotation.from_matrix(R_enu_from_map()).as_euler("zxy")[0])
    found = acquisition_of_orientations(path, height_datum="ellipsoid")
    assert f"{convergence:.2f} deg clockwise of true north" in " ".join(found.assumed)
    assert found.facts["map"] == "WGS 84 / UTM zone 16N"
    assert found.sensor is None


def test_a_crs_with_a_vertical_part_says_what_heights_are_above(tmp_path: pathlib.Path) -> None:
    path = table(tmp_path / "eo.txt", *(LAYOUTS["pix4d"][0], LAYOUTS["pix4d"][1] + " 0 0 0"))
    with pytest.raises(UnstatedDatum, match="height_datum"):
        acquisition_of_orientations(path, crs=UTM)
    found = acquisition_of_orientations(path, crs="EPSG:32616+5773")
    same = acquisition_of_orientations(path, crs=UTM, height_datum="EPSG:5773")
    assert found.shots.pose.position.height[0] == pytest.approx(same.shots.pose.position.height[0], abs=1e-6)  # m
    assert abs(found.shots.pose.position.height[0] - 900.5) > 10.0


@pytest.mark.parametrize(
    "header, row, options, words",
    [
        ("imageName X Y Z Omega Phi Kappa", "a 751000 4020000 3 0 0 0", {}, 'X is projected.*crs="EPSG:32616"'),
        ("#F=N Y X Z K W P", "a 36.3 -84.2 900.0 30 -60 0", {}, 'X is in deg.*crs="EPSG:4326"'),
        ("#F=N Y X Z K W P", "a 36.3 -84.2 900.0 30 -60 0", {"crs": UTM}, "look like longitude and latitude in deg"),
        (LAYOUTS["metashape reference"][0], "a,751000,4020000,9,0,0,0", {"crs": "EPSG:32617"}, "the file says that"),
        ("a.JPG 751000.12 4020000.34 900.5 0.5 -1.2 89.3", "b.JPG 7 4 9 0 0 0", {}, "first row holds numbers"),
        ("#F=N Y X Z K W P", "a 0.0 0 900.0 30 -60 0", {"crs": "EPSG:4326"}, "latitude and longitude are zero"),
        ("#F=N X Y Z", "a 1000 2 3", {"crs": UTM}, r"no column omega_deg \(or omega, o\)"),
        ("image x y z omega phi", "a 1000 2 3 4 5", {"crs": UTM}, r"no column kappa_deg \(or kappa, k\)"),
        ("image x y z yaw pitch", "a 1 2 3 4 5", {"crs": UTM}, "no column roll_deg"),
    ],
)  # fmt: skip
def test_what_is_not_there_is_said(tmp_path: pathlib.Path, header: str, row: str, options: Any, words: str) -> None:
    with pytest.raises(TableError, match=words):
        read_orientations(table(tmp_path / "eo.txt", header, row), height_datum="ellipsoid", **options)
