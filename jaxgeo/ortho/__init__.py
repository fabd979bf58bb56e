"""Orthorectification: images resampled to ground grids with occlusion, and images rendered from orthoimages."""

from jaxgeo.ortho.interpolation import AbstractInterpolation, Bilinear, Cubic, Nearest
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.ortho.rectification import Rectified, Rectifier, rectify
from jaxgeo.ortho.rendering import Rendered, render

__all__ = [
    "AbstractInterpolation",
    "Bilinear",
    "Cubic",
    "Nearest",
    "Orthoimage",
    "Rectified",
    "Rectifier",
    "Rendered",
    "rectify",
    "render",
]
