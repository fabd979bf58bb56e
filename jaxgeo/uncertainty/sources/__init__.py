"""Error sources: one class each, with its covariance and the perturbation of an observation."""

from jaxgeo.uncertainty.sources.air import Refraction
from jaxgeo.uncertainty.sources.base import AbstractSource
from jaxgeo.uncertainty.sources.correlated import Correlated
from jaxgeo.uncertainty.sources.gimbal import GimbalAngles, GimbalMounting
from jaxgeo.uncertainty.sources.ground import Geoid, TerrainField, TerrainHeight
from jaxgeo.uncertainty.sources.height_raster import TerrainHeightRaster
from jaxgeo.uncertainty.sources.image import Distortion, InteriorOrientation, PixelMeasurement
from jaxgeo.uncertainty.sources.platform import (
    Attitude,
    Boresight,
    CameraMounting,
    LeverArm,
    Position,
    TimeTag,
    Velocity,
)

__all__ = [
    "AbstractSource",
    "Attitude",
    "Boresight",
    "CameraMounting",
    "Correlated",
    "Distortion",
    "Geoid",
    "GimbalAngles",
    "GimbalMounting",
    "InteriorOrientation",
    "LeverArm",
    "PixelMeasurement",
    "Position",
    "Refraction",
    "TerrainField",
    "TerrainHeight",
    "TerrainHeightRaster",
    "TimeTag",
    "Velocity",
]
