"""Correct results for the tables of the folder `field`."""

from __future__ import annotations

import pathlib
import tempfile
from typing import Any

import numpy as np
import pyproj
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo.io import TableError, read_acquisition
from support.drone_image_files import packet, write_image
from tests.support.field import FieldFile

UTM = "EPSG:32616"
PLACE = (36.3, -84.2, 900.0)
IMAGE = {
    "drone-dji:AbsoluteAltitude": "+153.9",
    "drone-dji:GpsLatitude": "+36.3001",
    "drone-dji:GpsLongitude": "-84.2001",
    "drone-dji:GimbalYawDegree": "+30.0",
    "drone-dji:GimbalPitchDegree": "-60.0",
    "drone-dji:GimbalRollDegree": "+0.0",
    "drone-dji:CalibratedFocalLength": "3666.67",
}


def _place(found: Any, row: int = 0) -> list[float]:
    at = found.shots.pose.position
    return [float(np.rad2deg(at.lat[row])), float(np.rad2deg(at.lon[row])), float(at.height[row])]


def _angles(found: Any, row: int = 0) -> list[float]:
    pose = found.shots.pose
    return [float(np.rad2deg(np.asarray(one)[row])) for one in (pose.heading, pose.pitch, pose.roll)]


def _R_from_image(found: Any, convergence: float = 0.0) -> np.ndarray:
    """The first image's axes (right, up, out of the scene) in the axes of a map turned by `convergence` deg."""
    heading, pitch, roll = _angles(found)
    R_ned_from_body = Rotation.from_euler("ZYX", [heading - convergence, pitch, roll], degrees=True).as_matrix()
    R_enu_from_ned = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    R_body_from_camera = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # Mount.nadir()
    return R_enu_from_ned @ R_ned_from_body @ R_body_from_camera @ np.diag([1.0, -1.0, -1.0])


def _earth(path: pathlib.Path) -> None:
    """A geographic table, with any separator: 36.3 N, 84.2 W, 900 m; 30, 20, 0 deg."""
    found = read_acquisition(path, height_datum="ellipsoid")
    np.testing.assert_allclose(_place(found), PLACE, atol=1e-9)
    np.testing.assert_allclose(_angles(found), [30.0, 20.0, 0.0], atol=1e-9)
    assert found.names.tolist() == ["DJI 0001.JPG" if path.name == "tabs.csv" else "DJI_0001.JPG"]


def _in_map(found: Any) -> float:
    """Checks the first image's position in UTM zone 16; returns the grid convergence there in deg, by PROJ."""
    lon, lat = pyproj.Transformer.from_crs(UTM, 4326, always_xy=True).transform(751000.12, 4020000.34)
    np.testing.assert_allclose(_place(found), [lat, lon, 900.5], atol=1e-9)
    return float(pyproj.Proj(UTM).get_factors(lon, lat).meridian_convergence)


def _opk(path: pathlib.Path) -> None:
    """Omega 0.5, phi -1.2, kappa 89.3 deg in the map: R_map_from_image = Rx Ry Rz."""
    with pytest.raises(TableError, match='such as crs="EPSG:32616"'):
        read_acquisition(path, height_datum="ellipsoid")
    found = read_acquisition(path, height_datum="ellipsoid", crs=UTM)
    convergence = _in_map(found)
    expected = Rotation.from_euler("XYZ", [0.5, -1.2, 89.3], degrees=True).as_matrix()
    np.testing.assert_allclose(_R_from_image(found, convergence), expected, atol=2e-9)
    assert len(found) == 2


def _ypr(path: pathlib.Path) -> None:
    """Heading 30 from grid north, pitch 20, roll 0: from Metashape, which names its map, and RealityCapture."""
    crs = None if path.name == "metashape_ref.csv" else UTM
    found = read_acquisition(path, height_datum="ellipsoid", crs=crs)
    np.testing.assert_allclose(_angles(found), [30.0 + _in_map(found), 20.0, 0.0], atol=1e-6)
    assert any("from the map's grid north" in one for one in found.assumed)
    assert found.sensor is None


def _micmac(path: pathlib.Path) -> None:
    with pytest.raises(TableError, match='crs="EPSG:4326"'):
        read_acquisition(path, height_datum="ellipsoid")
    found = read_acquisition(path, height_datum="ellipsoid", crs="EPSG:4326")
    np.testing.assert_allclose(_place(found), PLACE, atol=1e-9)
    expected = Rotation.from_euler("XYZ", [-60.0, 0.0, 30.0], degrees=True).as_matrix()
    np.testing.assert_allclose(_R_from_image(found), expected, atol=1e-12)
    assert any("MicMac" in one for one in found.assumed)


def _cameras_xml(path: pathlib.Path) -> None:
    with pytest.raises(TableError, match=r"no transform to the Earth.*georeference the chunk in Metashape"):
        read_acquisition(path)


def _positions(path: pathlib.Path) -> None:
    """Joined to images by name or number: the images' own positions, 14 m off, are replaced."""
    with tempfile.TemporaryDirectory() as folder:
        for number in (1, 5):
            write_image(pathlib.Path(folder) / f"DJI_000{number}.JPG", packet(IMAGE), make="DJI")
        how: dict[str, Any] = {} if path.suffix == ".MRK" else {"height_datum": "ellipsoid"}
        found = read_acquisition(folder, positions=path, **how)
    np.testing.assert_allclose(_place(found), PLACE, atol=1e-9)
    assert found.names.tolist() == ["DJI_0001.JPG"]
    assert any("1 of 2 images are not in" in one and "DJI_0005.JPG" in one for one in found.assumed)
    expected = {".MRK": [0.0101, 0.0102, 0.0203], ".txt": [0.02, 0.02, 0.03]}.get(path.suffix)
    sigma = [np.asarray(one.sigma)[0].tolist() for one in found.sources if type(one).__name__ == "Position"]
    assert sigma == ([] if expected is None else [expected])


def _subtitles(path: pathlib.Path) -> None:
    found = read_acquisition(path, height_datum="ellipsoid")
    np.testing.assert_allclose(_place(found), PLACE, atol=1e-9)
    np.testing.assert_allclose(_angles(found), [30.0, 30.0, 0.0], atol=1e-9)  # of a camera in Mount.nadir()
    assert read_acquisition(path, takeoff_height=500.0).shots.pose.position.height[0] == 800.0


def _airdata(path: pathlib.Path) -> None:
    found = read_acquisition(path, height_datum="ellipsoid")
    np.testing.assert_allclose(_place(found), [36.3, -84.2, 2952.8 * 0.3048], atol=1e-9)
    np.testing.assert_allclose(_angles(found, 1), [30.2, 30.0, 0.0], atol=1e-9)
    assert found.facts["photos"] == "1 (0)"


ROWS: tuple[FieldFile, ...] = (
    *(
        FieldFile(f"tab/{name}", situation, _earth)
        for name, situation in (
            ("semi.csv", "semicolons between columns"),
            ("german.csv", "semicolons, decimal commas, German headings in the code page of Windows"),
            ("comma.csv", "semicolons, decimal commas"),
            ("comment.csv", "a comment above the header"),
            ("tabs.csv", "tabs between columns, a name with a blank"),
        )
    ),
    FieldFile("tab/pix4d_external.txt", "Pix4D's external camera parameters", _opk),
    FieldFile("tab/pix4d_ren.txt", "the same with the image's column renamed", _opk),
    FieldFile("tab/metashape_opk.txt", "Metashape's omega, phi, kappa: header in a comment, tabs below", _opk),
    FieldFile("tab/metashape_ref.csv", "Metashape's reference, its map in a comment by name", _ypr),
    FieldFile("tab/realitycapture.csv", "RealityCapture's internal and external parameters", _ypr),
    FieldFile("tab/micmac.txt", "MicMac's #F= line, latitude before longitude", _micmac),
    FieldFile("tab/cameras.xml", "Metashape's cameras of a chunk that is not georeferenced", _cameras_xml),
    FieldFile("tab/geo.txt", "OpenDroneMap's image geolocation file", _positions),
    FieldFile("tab/Timestamp.MRK", "DJI's marks of RTK photos", _positions),
    FieldFile("tab/shots.geojson", "OpenDroneMap's report of shots", _positions),
    FieldFile("tab/DJI_0001.SRT", "telemetry of a drone's video", _subtitles),
    FieldFile("tab/airdata.csv", "a flight log of AirData in feet", _airdata),
)
