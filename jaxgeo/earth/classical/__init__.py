"""Approximate Earth formulas from the literature, for comparison; the exact ones are in `jaxgeo.earth`."""

from jaxgeo.earth.classical.gauss_krueger import GaussKruegerSeries, meridian_arc
from jaxgeo.earth.classical.inflated import range_to_inflated_ellipsoid, range_to_scaled_ellipsoid
from jaxgeo.earth.classical.iterated import to_geodetic_simultaneous, to_geodetic_successive

__all__ = [
    "GaussKruegerSeries",
    "meridian_arc",
    "range_to_inflated_ellipsoid",
    "range_to_scaled_ellipsoid",
    "to_geodetic_simultaneous",
    "to_geodetic_successive",
]
