"""Sensors: cameras, lens distortion, gimbals, mounts, poses and shots. A sensor knows no terrain."""

from jaxgeo.sensor import conventions
from jaxgeo.sensor.camera import AbstractCamera, FrameCamera
from jaxgeo.sensor.distortion import AbstractDistortion, BrownConrady, NoDistortion
from jaxgeo.sensor.gimbal import Gimbal
from jaxgeo.sensor.platform import Mount, Pose, Shot, boresight_from_degrees
from jaxgeo.sensor.sensor import Sensor

__all__ = [
    "AbstractCamera",
    "AbstractDistortion",
    "BrownConrady",
    "FrameCamera",
    "Gimbal",
    "Mount",
    "NoDistortion",
    "Pose",
    "Sensor",
    "Shot",
    "boresight_from_degrees",
    "conventions",
]
