"""Orientations of MicMac: rotation, centre, calibration and frame; what is not read is refused in a line.

Held against: the layout that MicMac writes (ExportAPERO, OrientationConique; as openMVG exports it) and iTowns'
reader: eConvApero_DistM2C is the rotation of (right, down, forward) to the world, distortion goes from model to image.
The pixel of a ground point is computed here in NumPy.
"""

from __future__ import annotations

import pathlib
from typing import Any

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo import FrameCamera
from jaxgeo.io import TableError, UnstatedDatum, read_acquisition, read_acquisitions
from jaxgeo.io.acquisitions.detect import form_of
from tests.io.test_colmap_models import CENTRE_ENU, ENU, GROUND_ENU, R_ENU, enu_axes

F, PP, SIZE, TERMS = 277.0, (203.5, 148.0), (400, 300), (-6.5e-7, 3.1e-12, -1.2e-17)


def calibration(lens: str | None = None) -> str:
    coefficients = "".join(f"<CoeffDist>{one!r}</CoeffDist>" for one in TERMS)
    lens = f"<ModRad><CDist>{PP[0]} {PP[1]}</CDist>{coefficients}</ModRad>" if lens is None else lens
    return (
        f'<?xml version="1.0" ?>\n<ExportAPERO><CalibrationInternConique><KnownConv>eConvApero_DistM2C</KnownConv>'
        f"<PP>{PP[0]} {PP[1]}</PP><F>{F}</F><SzIm>{SIZE[0]} {SIZE[1]}</SzIm>"
        f"<CalibDistortion>{lens}</CalibDistortion></CalibrationInternConique></ExportAPERO>"
    )


def orientation(R: np.ndarray, centre: np.ndarray) -> str:
    lines = "".join(f"<L{k + 1}>{' '.join(map(repr, row))}</L{k + 1}>" for k, row in enumerate(R.tolist()))
    return (
        f'<?xml version="1.0" ?>\n<ExportAPERO><OrientationConique><TypeProj>eProjStenope</TypeProj>'
        f"<FileInterne>Ori-Final/AutoCal_Foc-8800_Cam-X.xml</FileInterne><Externe>"
        f"<KnownConv>eConvApero_DistM2C</KnownConv><Centre>{' '.join(map(repr, centre.tolist()))}</Centre>"
        f"<ParamRotation><CodageMatr>{lines}</CodageMatr></ParamRotation></Externe>"
        f"<ConvOri><KnownConv>eConvApero_DistM2C</KnownConv></ConvOri></OrientationConique></ExportAPERO>"
    )


@pytest.fixture
def folder(tmp_path: pathlib.Path) -> pathlib.Path:
    """Two images of one camera, in east, north and up."""
    place = tmp_path / "Ori-Final"
    place.mkdir()
    (place / "AutoCal_Foc-8800_Cam-X.xml").write_text(calibration(), encoding="utf-8")
    (place / "Orientation-a.JPG.xml").write_text(orientation(R_ENU, CENTRE_ENU), encoding="utf-8")
    turned = R_ENU @ Rotation.from_euler("z", 30.0, degrees=True).as_matrix()
    (place / "Orientation-b.JPG.xml").write_text(orientation(turned, CENTRE_ENU), encoding="utf-8")
    return place


@jax.jit
def projected(sensor: Any, shot: Any, p_ecef: Any) -> Any:
    return sensor.project_ecef(shot, p_ecef)[0]


def test_a_ground_point_is_seen_where_micmac_projects_it(folder: pathlib.Path) -> None:
    found = read_acquisition(folder, crs=ENU, height_datum="ellipsoid")
    assert found.names.tolist() == ["a.JPG", "b.JPG"]
    origin, axes = enu_axes()
    for k, angle in enumerate((0.0, 30.0)):
        R = R_ENU @ Rotation.from_euler("z", angle, degrees=True).as_matrix()
        x, y, z = R.T @ (GROUND_ENU - CENTRE_ENU)
        offset = F * np.array([x, y]) / z  # pixels from the principal point, without distortion
        r2 = float(offset @ offset)
        expected = np.array(PP) + offset * (1.0 + TERMS[0] * r2 + TERMS[1] * r2**2 + TERMS[2] * r2**3) - 0.5
        sensor, shot, _ = found.exposure(k)
        np.testing.assert_allclose(projected(sensor, shot, origin + axes @ GROUND_ENU), expected, atol=1e-5)  # pixels


def test_folders_and_files_are_told_by_their_content(folder: pathlib.Path) -> None:
    one = folder / "Orientation-a.JPG.xml"
    for place in (folder, one):
        assert form_of(place).name == "orientation of MicMac"
    several = read_acquisitions([folder], crs=ENU, height_datum="ellipsoid")
    assert len(several) == 2
    assert not several.unread
    assert read_acquisition(one, crs=ENU, height_datum=0.0).names.tolist() == ["a.JPG"]


def test_a_camera_takes_the_place_of_the_calibration(folder: pathlib.Path) -> None:
    (folder / "AutoCal_Foc-8800_Cam-X.xml").unlink()
    camera = FrameCamera.from_pixels(focal_px=300.0, width=640, height=480)
    found = read_acquisition(folder, crs=ENU, height_datum=0.0, cameras=camera)
    sensor: Any = found.sensor
    np.testing.assert_allclose(sensor.camera.focal_px, [[300.0, 300.0]] * 2)


def edited(name: str, old: str, new: str) -> Any:
    def edit(folder: pathlib.Path) -> None:
        path = folder / name
        text = path.read_text(encoding="utf-8")
        assert old in text
        path.write_text(text.replace(old, new), encoding="utf-8")

    return edit


CAMERA, IMAGE = "AutoCal_Foc-8800_Cam-X.xml", "Orientation-a.JPG.xml"
REFUSED: dict[str, tuple[Any, str]] = {
    "no calibration": (lambda f: (f / CAMERA).unlink(), "its calibration AutoCal_Foc-8800_Cam-X.xml is not beside it"),
    "other lens": (edited(CAMERA, "ModRad", "ModPhgrStd"), "the distortion ModPhgrStd is not read"),
    "other centre": (edited(CAMERA, "<CDist>203.5", "<CDist>201.5"), "about CDist, which is not PP"),
    "convention": (edited(IMAGE, "eConvApero_DistM2C", "eConvAngErdas"), "its convention is 'eConvAngErdas'"),
    "angles": (edited(IMAGE, "CodageMatr", "CodageAngulaire"), "no rotation matrix"),
    "projection": (edited(IMAGE, "eProjStenope", "eProjOrthographique"), "only eProjStenope"),
    "matrix": (edited(IMAGE, "<L1>-0.34", "<L1>-0.84"), "CodageMatr: it is no rotation"),
    "centre": (edited(IMAGE, "<Centre>40.0", "<Centre>x"), "Centre: expected 3 numbers"),
    "cut": (edited(IMAGE, "</OrientationConique></ExportAPERO>", ""), "not an XML file, or cut off"),
    "size": (edited(CAMERA, "<SzIm>400", "<SzIm>400.5"), "none of a camera"),
    "entities": (edited(IMAGE, "<ExportAPERO>", "<!DOCTYPE a [<!ENTITY b 'c'>]><ExportAPERO>"), "DOCTYPE"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_read_is_refused_in_a_line(folder: pathlib.Path, case: str) -> None:
    damage, words = REFUSED[case]
    damage(folder)
    with pytest.raises(TableError, match=words) as refusal:
        read_acquisition(folder, crs=ENU, height_datum=0.0)
    assert "\n" not in str(refusal.value)


def test_a_frame_and_a_datum_are_asked_for(folder: pathlib.Path) -> None:
    with pytest.raises(TableError, match=r"state no frame.*EPSG:4978"):
        read_acquisition(folder, height_datum=0.0)
    with pytest.raises(UnstatedDatum, match="height_datum="):
        read_acquisition(folder, crs=ENU)
