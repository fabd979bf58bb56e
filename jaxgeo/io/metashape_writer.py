"""Adjusted blocks as camera files of Agisoft Metashape (XML)."""

from __future__ import annotations

import os
import pathlib
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np

from jaxgeo._destination import destination
from jaxgeo.adjust import Adjustment
from jaxgeo.io.errors import UnwritableLens
from jaxgeo.io.reconstruction_writer import frame_on_earth, interior_of_lens
from jaxgeo.sensor import FrameCamera
from jaxgeo.sensor.distortion import BrownConrady, NoDistortion

VERSION = "1.4.0"  # of the layout: adjusted calibrations with f, cx, cy, b1; the transform of a camera in the chunk
# OpenCV's p1 and p2 are Metashape's p2 and p1.
TERMS = {"k1": "k1", "k2": "k2", "k3": "k3", "p1": "p2", "p2": "p1"}
RATIONAL = "k4", "k5", "k6"


def write_metashape_cameras(path: str | os.PathLike[str], found: Adjustment) -> None:
    """Write an adjusted block as a `cameras.xml` of Metashape, which `read_metashape_cameras` reads.

    The transform of a camera maps (right, down, forward) to east-north-up in m, the chunk's that to geocentric
    coordinates of WGS 84. Labels are the names of the images without their endings, as Metashape has them, where these
    are unique. Layout: Agisoft Metashape User Manual, "Camera models", and its exports.

    The file appears only when complete. Raises `TypeError` for a block off the Earth, `UnwritableLens` for a lens that
    frame cameras of Metashape do not have (another formula, or k4 to k6 of `BrownConrady`), `ValueError` for a path
    that cannot be written to.
    """
    frame = frame_on_earth(found)
    root = ET.Element("document", version=VERSION)
    chunk = ET.SubElement(root, "chunk", label="Chunk 1", enabled="true")
    number = {name: f"{k}" for k, name in enumerate(found.cameras)}
    sensors = ET.SubElement(chunk, "sensors", next_id=f"{len(number)}")
    for name, camera in found.cameras.items():
        _add_sensor(sensors, number[name], name, camera)
    images = found.images
    cameras = ET.SubElement(chunk, "cameras", next_id=f"{len(images)}", next_group_id="0")
    labels = _labels([str(name) for name in images.name])
    for k, (label, used) in enumerate(zip(labels, images.camera.tolist(), strict=True)):
        one = ET.SubElement(cameras, "camera", id=f"{k}", sensor_id=number[used], label=label, enabled="true")
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = images.R_frame_from_camera[k], images.centre[k]
        ET.SubElement(one, "transform").text = _text(matrix)
    transform = ET.SubElement(chunk, "transform")
    ET.SubElement(transform, "rotation").text = _text(frame.R_ecef_from_local)
    ET.SubElement(transform, "translation").text = _text(frame.to_ecef(np.zeros(3)))
    ET.SubElement(transform, "scale").text = "1"
    ET.indent(root)
    with destination("camera file", pathlib.Path(path)) as stream:
        stream.write(f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n')


def _add_sensor(sensors: ET.Element, number: str, name: str, camera: FrameCamera) -> None:
    sensor = ET.SubElement(sensors, "sensor", id=number, label=name, type="frame")
    size = {"width": f"{camera.width}", "height": f"{camera.height}"}
    ET.SubElement(sensor, "resolution", size)
    calibration = ET.SubElement(sensor, "calibration", {"type": "frame", "class": "adjusted"})
    ET.SubElement(calibration, "resolution", size)
    for key, value in _terms(name, camera).items():
        ET.SubElement(calibration, key).text = _text(value)


def _terms(name: str, camera: FrameCamera) -> dict[str, float]:
    """Terms of a calibration: pixels count from the corner of the first, and cx and cy from the middle of the image.

    Raises `UnwritableLens` for another lens.
    """
    focal, principal = interior_of_lens(camera)
    cx, cy = principal - 0.5 * (np.array([camera.width, camera.height]) - 1.0)
    terms = {"f": focal[1], "cx": cx, "cy": cy, "b1": focal[0] - focal[1]}
    lens = camera.distortion
    if isinstance(lens, NoDistortion):
        return terms
    if not isinstance(lens, BrownConrady):
        raise UnwritableLens(f"camera {name}: frame cameras of Metashape have no lens {type(lens).__name__}.")
    if any(float(getattr(lens, key)) for key in RATIONAL):
        raise UnwritableLens(f"camera {name}: Metashape has no lens with {', '.join(RATIONAL)} in the denominator.")
    return terms | {theirs: float(getattr(lens, ours)) for ours, theirs in TERMS.items()}


def _labels(names: list[str]) -> list[str]:
    """Names without endings, or as they are if these are not unique."""
    stems = [pathlib.PurePath(name).stem for name in names]
    return stems if len(set(stems)) == len(stems) else names


def _text(values: Any) -> str:
    return " ".join(repr(float(x)) for x in np.ravel(np.asarray(values, np.float64)))
