"""Geolocation of aerial images on real terrain, with the accuracy of every fix, in JAX.

Docstring examples assume that `jaxgeo` and `numpy as np` are imported and that 64-bit floats are on:

>>> jaxgeo.enable_x64()
>>> camera = jaxgeo.FrameCamera.from_metric(focal_length=0.075, pixel_pitch=5.5e-6, width=2400, height=4800)
>>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.two_axis(), jaxgeo.Mount.nadir())
>>> pose = jaxgeo.Pose.from_degrees(lat=36.3, lon=-84.1, height=5469.0, heading=160.0)
>>> shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(outer=72.0, inner=0.0))
>>> fix = jaxgeo.locate(sensor, shot, (1200, 2400), jaxgeo.ConstantHeight(300.0))
>>> print(f"{fix.slant_range / 1000:.2f} km away: {jaxgeo.Status(int(fix.status)).name}")
16.79 km away: hit
"""

from __future__ import annotations

from jaxgeo import _command

if _command.is_command():  # signals are handled before JAX is imported
    _command.collect_later()
    _command.end_on_interruption()
    from jaxgeo import _interruption

    _interruption.heed()

# isort: split
import importlib
from typing import TYPE_CHECKING, Any

from jaxgeo import uncertainty
from jaxgeo._checks import enable_x64
from jaxgeo._compile import compiler_options
from jaxgeo._locate import at_range, intersect, locate, project
from jaxgeo._program_cache import keep_programs
from jaxgeo._renamed import renamed
from jaxgeo._sweep import Axis, sweep
from jaxgeo.batches import in_batches
from jaxgeo.earth import WGS84, Atmosphere, Ellipsoid, Geodetic
from jaxgeo.earth.ray import Ray
from jaxgeo.fix import Fix, Projection
from jaxgeo.observation import Exposure, Observation
from jaxgeo.sensor import (
    BrownConrady,
    Deflection,
    FrameCamera,
    Gimbal,
    Mount,
    Pose,
    PushbroomCamera,
    RollingShutterCamera,
    Sensor,
    Shot,
    Trajectory,
    WhiskbroomCamera,
)
from jaxgeo.status import Status
from jaxgeo.terrain import ConstantHeight, Dem, FirstHit
from jaxgeo.uncertainty import (
    ErrorModel,
    Sampling,
    accuracy,
    circular_error,
    compare,
    linear_error,
    propagate,
    sample,
    spherical_error,
)

if TYPE_CHECKING:
    from jaxgeo import adjust, cluster, coverage, io, ortho, plot, register, ties
    from jaxgeo.terrain import Bisection

    __version__: str

__all__ = [
    "WGS84",
    "Atmosphere",
    "Axis",
    "Bisection",
    "BrownConrady",
    "ConstantHeight",
    "Deflection",
    "Dem",
    "Ellipsoid",
    "ErrorModel",
    "Exposure",
    "FirstHit",
    "Fix",
    "FrameCamera",
    "Geodetic",
    "Gimbal",
    "Mount",
    "Observation",
    "Pose",
    "Projection",
    "PushbroomCamera",
    "Ray",
    "RollingShutterCamera",
    "Sampling",
    "Sensor",
    "Shot",
    "Status",
    "Trajectory",
    "WhiskbroomCamera",
    "accuracy",
    "adjust",
    "at_range",
    "circular_error",
    "cluster",
    "compare",
    "compiler_options",
    "coverage",
    "enable_x64",
    "in_batches",
    "intersect",
    "io",
    "keep_programs",
    "linear_error",
    "locate",
    "ortho",
    "plot",
    "project",
    "propagate",
    "register",
    "sample",
    "spherical_error",
    "sweep",
    "ties",
    "uncertainty",
]

DEPRECATED = {"SweepCamera": "WhiskbroomCamera"}
_renamed = renamed(__name__, DEPRECATED)
_ON_DEMAND = (
    "adjust",
    "cluster",
    "coverage",
    "io",
    "ortho",
    "plot",
    "register",
    "ties",
)  # lazy: rasterio, pyproj, matplotlib


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    if name in _ON_DEMAND:
        return importlib.import_module(f"{__name__}.{name}")
    if name == "Bisection":  # with the searches of the literature, loaded when first used
        return importlib.import_module("jaxgeo.terrain").Bisection
    return _renamed(name)


def _version() -> str:
    from importlib import metadata

    try:
        return metadata.version(__name__)
    except metadata.PackageNotFoundError:
        raise AttributeError(
            "jaxgeo is not installed, so it has no version; pip install it, or -e its folder."
        ) from None


def __dir__() -> list[str]:
    return sorted({*globals(), *_ON_DEMAND, "Bisection", "__version__"})
