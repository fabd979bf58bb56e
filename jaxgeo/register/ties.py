"""Tie points between image pixels and a reference map."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Num

from jaxgeo._checks import as_array, as_float64, check_finite, check_is, check_range, concrete
from jaxgeo._record import Record
from jaxgeo._typing import PixelField, ScalarField
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu

if TYPE_CHECKING:
    CovariancesField: TypeAlias = Any
else:
    CovariancesField: TypeAlias = Num[ArrayLike, "... 2 2"]

LONGEST = 1e6  # m: side of a block on the ground
SIZES = (32, 128, 512, 2048, 4096)  # padded sizes, so that other counts need no compilation


class TiePoints(Record):
    """Tie points: pixels `uv` (n, 2) of an image, and the matching reference positions (latitude, longitude).

    `covariance` (n, 2, 2) in m2 of east, north is that of each match on the map, independent between ties;
    `pixel_sigma` in px is that of the pixels, the same along columns and rows. The height of `ground`, a `Geodetic`
    with a leading axis (n,), is ignored; the terrain height is used instead. With `rise` (n, 2), the slope to the east
    and north in m per m, the height is used: the tie lies on that plane, and only the errors of the terrain apply. Use
    it for matches of extended blocks, which move as the mean ground does, not as the facet at their centre.
    `sides` (n, 2, 2) has the two sides of each matched block on the ground as columns, to the east and north in m: the
    terrain's errors of `TieErrors.terrain_field` then are their means over the block. Without it they are those at one
    point.
    """

    uv: PixelField
    ground: Geodetic
    covariance: CovariancesField
    pixel_sigma: ScalarField = 0.0
    rise: PixelField | None = None
    sides: CovariancesField | None = None

    @property
    def count(self) -> int:
        """Number of ties."""
        return jnp.shape(self.uv)[0]

    def moved(self, shift: Any) -> TiePoints:
        """The same ties on a map with a shift to the east and north, m."""
        shift = np.asarray(shift, np.float64)
        if self.count == 0 or not np.any(shift):
            return self
        rise = np.zeros((self.count, 2)) if self.rise is None else self.rise
        lat, lon, height = _moved(self.ground, jnp.asarray(rise), jnp.asarray(shift))
        height = self.ground.height if self.rise is None else height
        return dataclasses.replace(self, ground=Geodetic(lat=lat, lon=lon, height=height))


@jax.jit
def _moved(ground: Geodetic, rise: Float[Array, "n 2"], shift: Float[Array, "2"]) -> tuple[Array, Array, Array]:
    """Latitudes, longitudes and heights of points shifted to the east and north, m, along planes."""

    def one(position: Geodetic, rise: Float[Array, "2"]) -> tuple[Array, Array, Array]:
        step = jnp.concatenate([shift, jnp.sum(rise * shift)[None]])
        there = WGS84.to_geodetic(WGS84.to_ecef(position) + R_ecef_from_enu(position) @ step)
        return jnp.asarray(there.lat), jnp.asarray(there.lon), jnp.asarray(there.height)

    return jax.vmap(one)(ground, rise)


class PaddedTies(NamedTuple):
    """Ties padded to one of the `SIZES`; entries that are not `used` repeat the last tie with zero weight."""

    uv: Float[Array, "ties 2"]
    lat: Float[Array, " ties"]
    lon: Float[Array, " ties"]
    covariance: Float[Array, "ties 2 2"]
    pixel_sigma: Float[Array, ""]
    used: Bool[Array, " ties"]
    height: Float[Array, " ties"]
    rise: Float[Array, "ties 2"] | None
    sides: Float[Array, "ties 2 2"] | None


def checked_ties(ties: Any) -> TiePoints:
    """Validated tie points in float64.

    Raises `TypeError` for anything else, `ValueError` for no ties, shapes that do not fit, numbers that are not finite,
    an invalid match covariance, and sides of a block of more than 1000 km.
    """
    check_is(ties, TiePoints, "ties")
    check_is(ties.ground, Geodetic, "ties.ground")
    place = (as_array(ties.ground.lat, "ties.ground.lat"), as_array(ties.ground.lon, "ties.ground.lon"))
    numbers: Any = (as_array(ties.uv, "ties.uv"), *place, as_array(ties.covariance, "ties.covariance"))
    uv, lat, lon, covariance = as_float64(numbers, "ties")
    count = uv.shape[0] if uv.ndim else 0
    if count == 0:
        raise ValueError("ties holds no tie point: there is nothing to update by.")
    wanted = {"uv": (count, 2), "ground.lat": (count,), "ground.lon": (count,), "covariance": (count, 2, 2)}
    for (name, shape), value in zip(wanted.items(), (uv, lat, lon, covariance), strict=True):
        if value.shape != shape:
            raise ValueError(f"ties.{name} must have the shape {shape}; got {value.shape}.")
        check_finite(value, f"ties.{name}", {"uv": "px", "covariance": "m2"}.get(name, "rad"))
    check_range(lat, "ties.ground.lat", "rad", -0.5 * np.pi, 0.5 * np.pi)
    check_range(ties.pixel_sigma, "ties.pixel_sigma", "px", 0.0, 1e6)
    _check_covariances(concrete(covariance))
    pixel_sigma = as_float64(ties.pixel_sigma, "ties.pixel_sigma")
    sides = None if ties.sides is None else _checked_sides(ties.sides, count)
    if ties.rise is None:
        level = Geodetic(lat=lat, lon=lon, height=jnp.zeros(count))
        return TiePoints(uv, level, covariance, pixel_sigma, sides=sides)
    of_plane: Any = (as_array(ties.ground.height, "ties.ground.height"), as_array(ties.rise, "ties.rise"))
    height, rise = as_float64(of_plane, "ties")
    for name, shape, value in (("ground.height", (count,), height), ("rise", (count, 2), rise)):
        if value.shape != shape:
            raise ValueError(f"ties.{name} must have the shape {shape}; got {value.shape}.")
        check_finite(value, f"ties.{name}", "m" if name == "ground.height" else "m per m")
    return TiePoints(uv, Geodetic(lat=lat, lon=lon, height=height), covariance, pixel_sigma, rise, sides)


def _checked_sides(sides: Any, count: int) -> Any:
    """Validated sides of blocks in float64."""
    sides = as_float64(as_array(sides, "ties.sides"), "ties")
    if sides.shape != (count, 2, 2):
        raise ValueError(f"ties.sides must have the shape {(count, 2, 2)}; got {sides.shape}.")
    check_range(sides, "ties.sides", "m", -LONGEST, LONGEST)
    return sides


def padded(ties: TiePoints) -> PaddedTies:
    """Validated ties padded to one of the `SIZES`. Raises `ValueError` for more than the largest."""
    count = ties.count
    if count > SIZES[-1]:
        raise ValueError(f"ties holds {count} tie points; an update takes up to {SIZES[-1]}. Thin them out.")
    size = next(size for size in SIZES if size >= count)

    def longer(values: Any) -> Array:
        pad = jnp if concrete(values) is None else np  # NumPy compiles nothing
        width = [(0, size - count)] + [(0, 0)] * (jnp.ndim(values) - 1)
        return jnp.asarray(pad.pad(values, width, mode="edge"))

    return PaddedTies(
        longer(ties.uv),
        longer(ties.ground.lat),
        longer(ties.ground.lon),
        longer(ties.covariance),
        jnp.asarray(ties.pixel_sigma),
        jnp.asarray(np.arange(size) < count),
        longer(ties.ground.height),
        None if ties.rise is None else longer(ties.rise),
        None if ties.sides is None else longer(ties.sides),
    )


def _check_covariances(covariance: np.ndarray | None) -> None:
    if covariance is None:
        return
    (a, b), (c, d) = np.moveaxis(covariance, 0, -1)
    wrong = (a < 0.0) | (d < 0.0) | (np.abs(b - c) > 1e-9 * (a + d)) | (a * d - b * c < -1e-9 * (a + d) ** 2)
    if np.any(wrong):
        tie = int(np.argmax(wrong))
        raise ValueError(
            f"ties.covariance of tie {tie} must be symmetric and positive semi-definite, in m2 of east, north; got "
            f"{covariance[tie].tolist()}."
        )
