"""Delay of a point: from a moment to the one at which a camera in motion would image the point as it stands then."""

from __future__ import annotations

from typing import NamedTuple

from jaxgeo._typing import Pixel, Scalar, StatusCode, Vector3
from jaxgeo.earth import Atmosphere
from jaxgeo.sensor._interpolation import Legs
from jaxgeo.sensor.sensor import Sensor, Sight


class Scene(NamedTuple):
    """Inputs of a point's delay: `time` in s is the time of the image, `p_ecef` the point in m."""

    sensor: Sensor
    legs: Legs
    time: Scalar
    p_ecef: Vector3
    air: Atmosphere | None


def delay_at(moment: Scalar, scene: Scene) -> Scalar:
    """The delay in s at a moment, in s after the image's time: zero where the point is exposed."""
    return image_at(scene, sight_at(scene, moment), moment)[1]


def sight_at(scene: Scene, moment: Scalar) -> Sight:
    """Place and orientation of the camera at a moment."""
    return scene.sensor.sight(scene.legs.station(scene.time, moment))


def image_at(scene: Scene, sight: Sight, moment: Scalar) -> tuple[Pixel, Scalar, StatusCode]:
    """(pixel, delay in s, status) of the point at a moment."""
    return scene.sensor.camera.image_at(sight.to_camera(scene.p_ecef, scene.air), moment)
