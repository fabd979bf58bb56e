"""The Earth: ellipsoid, local frames and map projections."""

from jaxgeo.earth._horizon import Horizon, horizon, sight_range
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.earth.ellipsoid import GRS80, WGS84, Ellipsoid
from jaxgeo.earth.frames import R_ecef_from_enu, R_ecef_from_ned
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.earth.projection import TransverseMercator

__all__ = [
    "GRS80",
    "WGS84",
    "Atmosphere",
    "Ellipsoid",
    "Geodetic",
    "Horizon",
    "R_ecef_from_enu",
    "R_ecef_from_ned",
    "TransverseMercator",
    "horizon",
    "sight_range",
]
