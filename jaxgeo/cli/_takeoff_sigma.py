"""Standard deviation of the height of a take-off on the elevation model."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgeo.cli._errors import DEM_SIGMA, Sigmas, sigmas_in
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.uncertainty.sources import AbstractSource, Position
from jaxgeo.uncertainty.sources.height_raster import OF_TERRAIN, TerrainHeightRaster, sigma_at

FORM = "one number in m, or NORTH,EAST,DOWN"


class FirstExposure(NamedTuple):
    """The earliest exposure: name, latitude and longitude in deg, error sources, and whether those of the position are
    default ones."""

    name: str
    lat: float
    lon: float
    sources: Sequence[AbstractSource]
    is_usual: bool


class TakeoffSigma(NamedTuple):
    """Standard deviations in m of the height of a take-off on a DEM: of the DEM there, and by the position on its
    slope."""

    of_model: float
    by_slope: float

    @property
    def total(self) -> float:
        """Root of the sum of squares, m."""
        return math.hypot(*self)

    @property
    def words(self) -> str:
        return (
            f"Its sigma is {self.total:.2f} m: {self.of_model:.3g} m of the elevation model, {self.by_slope:.2f} m of "
            f"the position on the slope there."
        )


def takeoff_sigma(terrain: Any, first: FirstExposure, sigmas: Sigmas) -> TakeoffSigma:
    """Standard deviations of the height of `terrain` under the first exposure, as typed or stated, else default ones.

    The second is that of the height of a plane with the terrain's slope under errors of the position s_n, s_e:
    sqrt((dh/dn s_n)^2 + (dh/de s_e)^2). Errors of the DEM at the take-off and at fixes are taken for independent: as
    far as they are common they move camera and ground together, and CE90 is smaller than said. Raises `UserError`.
    """
    place = Geodetic.from_degrees(lat=first.lat, lon=first.lon, height=0.0)
    north, east, _ = position_sigma(first, sigmas)
    normal = np.asarray(terrain.normal_at(place))
    per_east, per_north = -normal[0] / normal[2], -normal[1] / normal[2]
    of_model = sigmas.dem if sigmas.dem is not None else _of_model(first.sources, terrain, place)
    return TakeoffSigma(of_model, math.hypot(per_north * north, per_east * east))


def position_sigma(first: FirstExposure, sigmas: Sigmas) -> tuple[float, float, float]:
    """Standard deviations of the position north, east, down in m; along other axes the largest for each."""
    if sigmas.position is not None:
        north, east, down = sigmas_in("--position-sigma", sigmas.position, 3, FORM, zero=True)
        return north, east, down
    own = next((one for one in first.sources if isinstance(one, Position)), None)
    if own is None:
        return 0.0, 0.0, 0.0
    north, east, down = np.asarray(own.sigma, float).tolist()
    return (north, east, down) if own.frame == "ned" else (max(north, east, down),) * 3


def doubt_of(sigma: TakeoffSigma, first: FirstExposure, sigmas: Sigmas) -> str | None:
    """A sentence if a stated standard deviation of the camera's height is below that of the take-off in it."""
    from jaxgeo.io.acquisitions.sentences import DOUBT

    north, east, down = position_sigma(first, sigmas)
    if (first.is_usual and sigmas.position is None) or not north + east + down or down >= sigma.total:
        return None
    better = math.ceil(10.0 * math.hypot(down, sigma.total)) / 10.0
    return (
        f"{DOUBT}The stated sigma of the camera's height, {down:g} m, is below that of the take-off, which it has to "
        f"contain. Give --position-sigma {north:g},{east:g},{better:g}"
    )


def _of_model(sources: Sequence[AbstractSource], terrain: Any, place: Geodetic) -> float:
    """Standard deviation in m of a DEM's height at a place: as a scene states it, else the default."""
    own = next((one for one in sources if isinstance(one, OF_TERRAIN)), None)
    if own is None:
        return DEM_SIGMA
    found = float(np.sqrt(np.sum(np.square(np.asarray(own.sigma)))))
    if isinstance(own, TerrainHeightRaster):
        ground = Geodetic(lat=place.lat, lon=place.lon, height=terrain.height_at(place))
        found *= float(sigma_at(jnp.asarray(own.posts), own.grid, WGS84.to_ecef(ground)))
    return found if math.isfinite(found) else DEM_SIGMA
