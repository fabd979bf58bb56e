"""The Gauss-Krueger series of Li et al. (2020), in powers of the longitude difference."""

from __future__ import annotations

from dataclasses import KW_ONLY

import equinox as eqx
import jax.numpy as jnp

from jaxgeo._checks import as_float64
from jaxgeo._record import Record
from jaxgeo._typing import Scalar, ScalarField, ScalarLike
from jaxgeo.earth.ellipsoid import WGS84, Ellipsoid

# Factors of e^2j, e^(2j + 2), ..., e^12 in the coefficients A1, B1, ..., G1 of B, sin 2B, sin 4B, ..., sin 12B.
_ARC = (
    (1, 3 / 4, 45 / 64, 175 / 256, 11025 / 16384, 43659 / 65536, 693693 / 1048576),
    (3 / 8, 15 / 32, 525 / 1024, 2205 / 4096, 72765 / 131072, 297297 / 524288),
    (15 / 256, 105 / 1024, 2205 / 16384, 10395 / 65536, 1486485 / 8388608),
    (35 / 3072, 105 / 4096, 10395 / 262144, 55055 / 1048576),
    (315 / 131072, 3465 / 524288, 99099 / 8388608),
    (693 / 1310720, 9009 / 5242880),
    (1001 / 8388608,),
)


class GaussKruegerSeries(Record):
    """Gauss-Krueger map with the central meridian `lon0` in rad, by series in the longitude difference; scale 1.

    Li et al. (2020), "Effect and compensation of overlap influenced by flight parameter of oblique aerial camera",
    Eqs 10-12, with its misprints corrected (see `meridian_arc`) and powers of tan B multiplied out, so that the pole is
    regular. Largest error over all latitudes, against PROJ: 1.1e-6 m at 1.5 degrees from the meridian, 1e-4 m at 3
    degrees, 0.4 m at 10 degrees. The paper gives no inverse. `TransverseMercator.gauss_krueger` is exact.
    """

    _: KW_ONLY
    lon0: ScalarField
    false_easting: ScalarField = 500_000.0
    ellipsoid: Ellipsoid = eqx.field(static=True, default=WGS84)

    def forward(self, lat: ScalarLike, lon: ScalarLike) -> tuple[Scalar, Scalar]:
        """(easting, northing) in m of a latitude and longitude in rad; the paper's y and x."""
        lat, lon, series = as_float64((lat, lon, self), "(lat, lon, series)")
        dlon = lon - series.lon0
        dlon = dlon - 2.0 * jnp.pi * jnp.round(dlon / (2.0 * jnp.pi))
        s, c = jnp.sin(lat), jnp.cos(lat)
        s2, c2, l2 = s**2, c**2, dlon**2
        eta2 = self.ellipsoid.e2 / (1.0 - self.ellipsoid.e2) * c2
        N = self.ellipsoid.prime_vertical_radius(lat)
        north_4 = (5.0 + 9.0 * eta2 + 4.0 * eta2**2) * c2 - s2
        north_6 = 61.0 * c2**2 - 58.0 * s2 * c2 + s2**2
        east_3 = (1.0 + eta2) * c2 - s2
        east_5 = (5.0 + 14.0 * eta2) * c2**2 - (18.0 + 58.0 * eta2) * s2 * c2 + s2**2
        northing = meridian_arc(lat, self.ellipsoid) + N * s * c * l2 * (
            1 / 2 + north_4 * l2 / 24 + north_6 * l2**2 / 720
        )
        easting = N * c * dlon * (1.0 + east_3 * l2 / 6 + east_5 * l2**2 / 120)
        return series.false_easting + easting, northing


def meridian_arc(lat: ScalarLike, ellipsoid: Ellipsoid = WGS84) -> Scalar:
    """Length in m of the meridian from the equator to a latitude in rad, by a series to e^12.

    Li et al. (2020), Eqs 11-12. The second term of Eq 11 is printed as -A1 sin 2B (it is -B1 sin 2B), and the last
    term of A1 in Eq 12 as 6936933/1048576 (it is 693693/1048576; the print is 5 micrometres off at the pole).
    """
    lat = as_float64(lat, "lat")
    e2 = ellipsoid.e2
    A, *others = [sum(c * e2 ** (j + k) for k, c in enumerate(row)) for j, row in enumerate(_ARC)]
    waves = sum((-1.0) ** j * c * jnp.sin(2.0 * j * lat) for j, c in enumerate(others, start=1))
    return ellipsoid.a * (1.0 - e2) * (A * lat + waves)
