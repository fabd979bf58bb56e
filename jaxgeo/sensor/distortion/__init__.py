"""Lens distortion: ideal to distorted image coordinates and back.

Both are tangents of ray angles, (right, down) over forward, unitless: a pixel is the focal length times the distorted
coordinates plus the principal point.
"""

from jaxgeo.sensor.distortion.base import AbstractDistortion, NoDistortion
from jaxgeo.sensor.distortion.bauer import Bauer
from jaxgeo.sensor.distortion.brown_conrady import BrownConrady
from jaxgeo.sensor.distortion.brown_physical import BrownPhysical
from jaxgeo.sensor.distortion.correction import AbstractCorrection
from jaxgeo.sensor.distortion.ebner import Ebner
from jaxgeo.sensor.distortion.fisheye import Fisheye

__all__ = [
    "AbstractCorrection",
    "AbstractDistortion",
    "Bauer",
    "BrownConrady",
    "BrownPhysical",
    "Ebner",
    "Fisheye",
    "NoDistortion",
]
