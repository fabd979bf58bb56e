"""Agisoft Metashape camera exports (XML): block transforms and calibrations, as exposures."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo._text_numbers import whole_in
from jaxgeo.io._rotations import rotation_near
from jaxgeo.io.acquisitions._world_frames import check_on_earth, pose_of_ecef
from jaxgeo.io.acquisitions._xml import numbers_of, root_of
from jaxgeo.io.acquisitions.blocks import NO_ERRORS, NO_TIMES, check_one_size, rows_of, sensor_of, shots_of
from jaxgeo.io.acquisitions.record import Acquisition
from jaxgeo.io.datum_names import is_ellipsoid
from jaxgeo.io.errors import TableError
from jaxgeo.io.given_camera import AS_READ
from jaxgeo.sensor import BrownConrady, FrameCamera

MOST_PIXELS = 10_000_000  # largest image side and focal length
FORM = "camera file of Metashape"
WGS84_TAKEN = "The geocentric coordinates of the chunk are taken to be of WGS 84."
NO_TRANSFORM = "there is no transform to the Earth: georeference the chunk in Metashape and export again"
UNREAD = ("b2", "k4", "p3", "p4")  # unsupported terms: skew and higher distortion terms
IDENTITY = (np.eye(3), np.zeros(3), 1.0)


def read_metashape_cameras(
    path: str | os.PathLike[str], *, height_datum: str | float | None = None, camera: str | None = None
) -> Acquisition:
    """Read the aligned cameras of a Metashape `cameras.xml`, each with its calibration, by their labels.

    A camera's transform maps (right, down, forward) to the chunk; the component's and the chunk's map that to
    geocentric coordinates of WGS 84, so heights are above the ellipsoid. The principal point is (cx, cy) pixels
    from the image centre; p1 and p2 are OpenCV's p2 and p1.

    - `height_datum`: only "ellipsoid" is accepted: geocentric coordinates have no other heights.
    - `camera`: selects the images of the sensor with that label; images of one record have one size.

    Raises `TableError` for a chunk without a transform to the Earth, sensors that are not frame cameras, unsupported
    lens terms (b2, k4, p3, p4), no aligned camera, sensors of several sizes; `FileNotFoundError`;
    `RuntimeError` with 64-bit floats off.
    """
    require_x64()
    if not (height_datum is None or is_ellipsoid(height_datum)):
        raise TableError(f"{path}: geocentric coordinates are heights above the ellipsoid; leave height_datum= out.")
    chunk = _chunk(path)
    sensors = {one.get("id", ""): one for one in chunk.iter("sensor")}
    aligned = [one for one in chunk.iter("camera") if one.find("transform") is not None]
    if not aligned:
        raise TableError(f"{path}: no camera is aligned (has a transform).")
    whole = _similarity(path, chunk)
    components = {one.get("id", ""): _similarity(path, one) for one in chunk.iter("component")}
    labels = [one.get("label", one.get("id", "")) for one in aligned]
    taken_by = np.array([_label(path, sensors, one) for one in aligned])
    rows = rows_of(path, taken_by, camera)
    used = {str(taken_by[row]): sensors[aligned[row].get("sensor_id", "")] for row in rows}
    cameras = {name: _camera(path, name, sensor) for name, sensor in used.items()}
    check_one_size(path, cameras, taken_by[rows])
    poses = []
    for row in rows:
        R, centre = _transform(path, aligned[row])
        for R_up, shift, scale in (components.get(aligned[row].get("component_id", ""), IDENTITY), whole):
            R, centre = R_up @ R, shift + scale * (R_up @ centre)
        poses.append((R, centre))
    R_ecef_from_camera, centres = map(np.array, zip(*poses, strict=True))
    check_on_earth(path, centres, NO_TRANSFORM)
    unaligned = sum(one.find("transform") is None for one in chunk.iter("camera"))
    notes = [f"{unaligned} cameras are not aligned and are left out."] if unaligned else []
    return Acquisition(
        path=os.fspath(path),
        form=FORM,
        names=np.array([labels[row] for row in rows]),
        sensor=sensor_of(cameras, taken_by[rows]),
        shots=shots_of(pose_of_ecef(centres, R_ecef_from_camera)),
        assumed=(WGS84_TAKEN, NO_ERRORS, AS_READ, NO_TIMES, *notes),
        facts={"images": f"{len(rows)} of {len(aligned) + unaligned}", "cameras": ", ".join(cameras)},
    )


def _chunk(path: str | os.PathLike[str]) -> ET.Element:
    root = root_of(path, FORM)
    chunk = root if root.tag == "chunk" else root.find("chunk")
    if chunk is None:
        raise TableError(f"{path}: there is no <chunk>, so it is no {FORM}.")
    return chunk


def _similarity(path: Any, element: ET.Element) -> tuple[np.ndarray, np.ndarray, float]:
    """(rotation, translation, scale) of the <transform> in a chunk or component; identity if missing."""
    where, transform = f"{path}, transform of {element.tag} {element.get('label', '')}", element.find("transform")
    if transform is None or len(transform) == 0:
        return IDENTITY
    parts = {name: transform.find(name) for name in ("rotation", "translation", "scale")}
    R = np.eye(3) if parts["rotation"] is None else numbers_of(where, parts["rotation"], 9).reshape(3, 3)
    shift = np.zeros(3) if parts["translation"] is None else numbers_of(where, parts["translation"], 3)
    scale = 1.0 if parts["scale"] is None else float(numbers_of(where, parts["scale"], 1)[0])
    if scale <= 0.0:
        raise TableError(f"{where}: the scale {scale:g} is not above zero.")
    return rotation_near(where, R), shift, scale


def _transform(path: Any, camera: ET.Element) -> tuple[np.ndarray, np.ndarray]:
    """(rotation of right, down, forward; centre) of a camera in its component."""
    where = f"{path}, camera {camera.get('label', '')}"
    matrix = numbers_of(where, camera.find("transform"), 16).reshape(4, 4)
    return rotation_near(where, matrix[:3, :3]), matrix[:3, 3]


def _label(path: Any, sensors: dict[str, ET.Element], camera: ET.Element) -> str:
    sensor = sensors.get(camera.get("sensor_id", ""))
    if sensor is None:
        raise TableError(f"{path}, camera {camera.get('label', '')}: there is no sensor {camera.get('sensor_id')!r}.")
    return sensor.get("label") or f"sensor {sensor.get('id')}"


def _camera(path: Any, name: str, sensor: ET.Element) -> FrameCamera:
    where = f"{path}, sensor {name}"
    kinds = {sensor.get("type", "frame")} | {one.get("type", "frame") for one in sensor.findall("calibration")}
    if kinds != {"frame"}:
        raise TableError(f"{where}: it is of type {', '.join(sorted(kinds))}; only frame cameras are read.")
    adjusted = sensor.find("calibration[@class='adjusted']")
    calibration = adjusted if adjusted is not None else sensor.find("calibration")
    if calibration is None:
        raise TableError(f"{where}: there is no calibration.")
    size = calibration.find("resolution")
    size = sensor.find("resolution") if size is None else size
    sides = {} if size is None else size.attrib
    width, height = (whole_in(sides.get(key, "")) or 0 for key in ("width", "height"))
    if not (0 < width <= MOST_PIXELS and 0 < height <= MOST_PIXELS):
        raise TableError(f"{where}: there is no resolution of whole numbers above zero, width and height.")
    written = [one for one in calibration if one.text and one.text.strip()]
    terms = {one.tag.lower(): float(numbers_of(f"{where}, {one.tag}", one, 1)[0]) for one in written}
    turned = [key for key in UNREAD if terms.get(key, 0.0) != 0.0]
    if turned:
        raise TableError(f"{where}: {turned[0]} is not zero; it is not read. Optimise the cameras without it.")
    if "f" not in terms:
        raise TableError(f"{where}: there is no focal length f in its calibration, as of versions from 1.3 on.")
    focal = terms["f"] + terms.get("b1", 0.0), terms["f"]
    if not 0.0 < min(focal) <= max(focal) < MOST_PIXELS:
        raise TableError(f"{where}: its focal length f is {terms['f']:g} pixels, with b1 {focal[0]:g}; it is none.")
    lens = BrownConrady(
        k1=terms.get("k1", 0.0), k2=terms.get("k2", 0.0), k3=terms.get("k3", 0.0),
        p1=terms.get("p2", 0.0), p2=terms.get("p1", 0.0),
    )  # fmt: skip
    is_perfect = not any(terms.get(key, 0.0) for key in ("k1", "k2", "k3", "p1", "p2"))
    return FrameCamera.from_pixels(
        focal_px=focal,
        width=width,
        height=height,
        principal_px=((width - 1.0) / 2.0 + terms.get("cx", 0.0), (height - 1.0) / 2.0 + terms.get("cy", 0.0)),
        distortion=None if is_perfect else lens,
    )
