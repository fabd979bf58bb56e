"""Simulated drone image: packaged terrain rendered from a known pose, with DJI tags that contain errors."""

from __future__ import annotations

import math
import os
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo.demo.scene import located
from jaxgeo.demo.scenery import painted
from jaxgeo.fix import Fix
from jaxgeo.io import example_dem
from jaxgeo.io.acquisitions.usual_errors import LEVEL, LEVEL_ELSE, POSITION
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.observation import Exposure
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.sensor.camera import check_size
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sources import GimbalAngles, Position

COLUMNS = 1200
FILM, DIAGONAL = 24.0, math.hypot(36.0, 24.0)  # mm, focal length and diagonal of 35 mm film: typical wide drone lens
LAT, LON, HEIGHT = 36.335, -84.2285, 592.0  # deg, deg, m above the ellipsoid: over a ridge
TAKEOFF = 472.0  # m above the ellipsoid
YAW, PITCH = 155.0, -9.0  # deg: along a valley, towards mountains
TAKEN = "2024:05:14 09:26:41"

RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
DJI = "http://www.dji.com/drone-dji/1.0/"
MAKE, MODEL, DESCRIPTION, SOFTWARE, EXIF, GPS = 0x010F, 0x0110, 0x010E, 0x0131, 0x8769, 0x8825


class DroneImage(NamedTuple):
    """Ground truth of the image at `path`: its sensor, and the true shot, which differs from the tags."""

    path: str
    sensor: Sensor
    shot: Shot

    def fixes(self, uv: Any) -> Fix:
        """True fixes (n) of pixels (n, 2), columns and rows, on `jaxgeo.io.example_dem()`."""
        return located(self.sensor, self.shot, np.asarray(uv, float).reshape(-1, 2), example_dem())


def drone_image(path: str | os.PathLike[str] = "drone.jpg", *, seed: int = 0, columns: int = COLUMNS) -> DroneImage:
    """Write a simulated 4:3 drone JPEG, and return its ground truth.

    The image is rendered from the terrain of `jaxgeo.io.example_dem()`; colours, light and haze are made up. The tags
    are those of DJI, with altitudes above mean sea level whose datum is not stated (it is EGM96, "EPSG:5773"). Their
    errors are drawn with `seed` from the sigmas that `jaxgeo.io.with_usual_errors` assumes, so a fix from the tags can
    be compared with `jaxgeo.locate` for the returned sensor and shot.
    """
    require_x64()
    sensor, shot = true_view(check_size(columns, "columns"))
    camera, dem = sensor.camera, example_dem()
    assert isinstance(camera, FrameCamera)
    shape = camera.height, camera.width
    uv = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).reshape(-1, 2).astype(float)
    fix = jax.tree.map(lambda leaf: leaf.reshape(*shape, *leaf.shape[1:]), located(sensor, shot, uv, dem))
    _write(
        os.fspath(path), painted(dem, fix, float(np.asarray(camera.focal_px)[0])), camera, tagged(sensor, shot, seed)
    )
    return DroneImage(os.fspath(path), sensor, shot)


def true_view(columns: int = COLUMNS) -> tuple[Sensor, Shot]:
    """The camera, `columns` pixels wide, and the true shot."""
    rows = columns * 3 // 4
    camera = FrameCamera.from_pixels(focal_px=FILM * math.hypot(columns, rows) / DIAGONAL, width=columns, height=rows)
    sensor = Sensor(camera, Gimbal.three_axis(), Mount.forward())
    pose = Pose.from_degrees(lat=LAT, lon=LON, height=HEIGHT, heading=YAW, pitch=-2.0, roll=1.0)
    return sensor, Shot(pose, sensor.gimbal.readings_from_degrees(yaw=YAW, pitch=PITCH, roll=0.0))


def tagged(sensor: Sensor, shot: Shot, seed: int) -> Shot:
    """The shot as in the tags: with random errors of position and camera angles."""
    rng = np.random.default_rng(seed)
    north, east, down = POSITION
    angles: dict[str, Any] = {name: LEVEL.get(name, LEVEL_ELSE) for name in sensor.gimbal.names}
    inputs = ModelInputs(Exposure(sensor, shot, 0.0))
    for source in (Position.from_ned(north=north, east=east, down=down), GimbalAngles.from_degrees(**angles)):
        error: Any = np.asarray(source.sigma) * rng.standard_normal(len(source.axes))
        inputs = eqx.filter_jit(source.moved)(inputs, error)
    assert isinstance(inputs.motion, Shot)
    turned = np.asarray(inputs.sensor.mount.R_head_from_camera) @ np.asarray(sensor.mount.R_head_from_camera).T
    R_base_from_head = sensor.gimbal.R_base_from_head(inputs.motion.gimbal_readings) @ turned
    return Shot(inputs.motion.pose, np.array(heading_pitch_roll_from_R(R_base_from_head)))


def _write(path: str, image: np.ndarray, camera: FrameCamera, shot: Shot) -> None:
    """Write a JPEG of colours (rows, columns, 3) between 0 and 1, with the tags of a shot."""
    from PIL import Image
    from PIL.TiffImagePlugin import IFDRational

    lat, lon, height = (float(x) for x in shot.pose.position.to_degrees())
    sea = height - float(ellipsoidal_heights(np.array([lon]), np.array([lat]), np.zeros(1), "EPSG:5773")[0])
    tags = Image.Exif()
    tags[DESCRIPTION] = "Rendered from terrain (SRTM, Jacksboro Fault, Tennessee); no photograph"
    tags[MAKE], tags[MODEL], tags[SOFTWARE] = "jaxgeo", "made-up drone", "jaxgeo.demo.drone_image"
    tags.get_ifd(EXIF).update({0x9003: TAKEN, 0x9011: "-04:00", 0x920A: IFDRational(67, 10), 0xA405: int(FILM)})
    tags.get_ifd(EXIF).update({0xA002: camera.width, 0xA003: camera.height})
    place = {1: "N" if lat >= 0.0 else "S", 2: _degrees(lat), 3: "E" if lon >= 0.0 else "W", 4: _degrees(lon)}
    tags.get_ifd(GPS).update(place | {5: 0, 6: IFDRational(round(1000 * sea), 1000)})
    properties = {
        "GpsLatitude": f"{lat:+.9f}",
        "GpsLongitude": f"{lon:+.9f}",
        "AbsoluteAltitude": f"{sea:+.3f}",
        "RelativeAltitude": f"{height - TAKEOFF:+.3f}",
        "CalibratedFocalLength": f"{np.asarray(camera.focal_px)[0]:.6f}",
        "CalibratedOpticalCenterX": f"{camera.width / 2:.6f}",
        "CalibratedOpticalCenterY": f"{camera.height / 2:.6f}",
    }
    pixels = np.round(255.0 * np.clip(image, 0.0, 1.0)).astype(np.uint8)
    Image.fromarray(pixels).save(path, "JPEG", quality=88, exif=tags, xmp=_packet(properties | _angles(shot)))


def _degrees(angle: float) -> tuple[Any, ...]:
    """An angle in deg as degrees, minutes and seconds of EXIF."""
    from PIL.TiffImagePlugin import IFDRational

    seconds = round(abs(angle) * 3600.0 * 10_000)
    minutes, seconds = divmod(seconds, 60 * 10_000)
    return (*(IFDRational(part) for part in divmod(minutes, 60)), IFDRational(seconds, 10_000))


def _angles(shot: Shot) -> dict[str, str]:
    """Camera and aircraft angles in deg, by DJI tag name."""
    pose = shot.pose
    angles = {"Gimbal": tuple(np.asarray(shot.gimbal_readings)), "Flight": (pose.heading, pose.pitch, pose.roll)}
    return {
        f"{what}{name}Degree": f"{_turn(math.degrees(float(angle))):+.2f}"
        for what, three in angles.items()
        for name, angle in zip(("Yaw", "Pitch", "Roll"), three, strict=True)
    }


def _packet(values: dict[str, str]) -> bytes:
    properties = " ".join(f'drone-dji:{name}="{value}"' for name, value in values.items())
    return (
        f'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="{RDF}"><rdf:Description rdf:about="" '
        f'xmlns:drone-dji="{DJI}" {properties}/></rdf:RDF></x:xmpmeta>'
    ).encode()


def _turn(angle_deg: float) -> float:
    """An angle wrapped to -180 to 180 deg."""
    return (angle_deg + 180.0) % 360.0 - 180.0
