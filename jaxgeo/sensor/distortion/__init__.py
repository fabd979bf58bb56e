"""Lens distortion: from ideal to distorted image coordinates and back.

Both are the tangents of the ray's angles, (right, down) over forward, without a unit: a pixel is focal length times the
distorted coordinates plus the principal point.
"""

from jaxgeo.sensor.distortion.base import AbstractDistortion, NoDistortion
from jaxgeo.sensor.distortion.bauer import Bauer
from jaxgeo.sensor.distortion.brown_conrady import BrownConrady
from jaxgeo.sensor.distortion.brown_physical import BrownPhysical
from jaxgeo.sensor.distortion.correction import AbstractCorrection
from jaxgeo.sensor.distortion.ebner import Ebner

__all__ = [
    "AbstractCorrection",
    "AbstractDistortion",
    "Bauer",
    "BrownConrady",
    "BrownPhysical",
    "Ebner",
    "NoDistortion",
]
