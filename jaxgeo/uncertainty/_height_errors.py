"""Errors of an elevation model's heights from a better one or from check points: bias, spread by slope, variogram."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy  # submodules load lazily, when first used

from jaxgeo._checks import check_is
from jaxgeo._compile import quick_filter_jit
from jaxgeo._record import portable
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.terrain import Dem
from jaxgeo.terrain.grid import surface_point
from jaxgeo.uncertainty.sources.ground import TerrainField

COUNT, BATCH = 20_000, 4096  # heights that are compared, and those at a time
CLASSES, PAIRS = 16, 5000  # of distance, and pairs of posts in each
FEWEST, FEWEST_PAIRS = 30, 30  # errors, and pairs of a class
NORMAL = 1.4826  # standard deviation of a normal error over its median magnitude
STEEP = 80.0  # deg: steeper facets count as this steep
MODELS = (("spherical",), ("gaussian",), ("spherical", "spherical"), ("gaussian", "spherical"))


class Variogram(NamedTuple):
    """Semivariance of errors, divided by their standard deviation at the slope of each, in classes of distance.

    `distance` (n,) in m is the mean of a class, `semivariance` (n,) its robust estimate, 1 for errors that have nothing
    in common, `pairs` (n,) their number.
    """

    distance: np.ndarray
    semivariance: np.ndarray
    pairs: np.ndarray


@portable
@dataclasses.dataclass(frozen=True, eq=False)
class HeightErrors:
    """Height errors of an elevation model; `str` describes them, `field` is the source for an `ErrorModel`.

    `errors` (n,) in m are heights of the model minus those of the reference, `slope` (n,) in rad is that of the
    reference there, of check points that of the model; `missing` is the number of places where one of the two has no
    height. `bias` is the median of the errors, `nmad` their normalised median absolute deviation in m, which is the
    standard deviation if they are normal. `level` and `steep` in m are those of sigma(slope) = hypot(level, steep
    tan(slope)). `variogram` was estimated from errors divided by it; `gaussian` and `spherical` are the pairs (share of
    the variance, length in m) fitted to it, as `TerrainField` takes them.
    """

    errors: np.ndarray
    slope: np.ndarray
    missing: int
    bias: float
    nmad: float
    level: float
    steep: float
    variogram: Variogram
    gaussian: tuple[tuple[float, float], ...]
    spherical: tuple[tuple[float, float], ...]

    def sigma_at(self, slope: Any = 0.0) -> np.ndarray:
        """Standard deviation in m on ground of a slope in rad."""
        return _sigma(np.asarray(slope, np.float64), self.level, self.steep)

    def field(self, slope: float | None = None, **options: Any) -> TerrainField:
        """Source of the height errors about a fix, without the bias: on ground of a slope in rad, or the mean over all.

        `options` are those of `TerrainField.of_variograms`. Take off the bias with `dem.with_posts(dem.posts - bias)`.
        """
        sigma = float(np.sqrt(np.mean(self.sigma_at(self.slope) ** 2)) if slope is None else self.sigma_at(slope))
        scaled = [
            [(sigma * math.sqrt(share), length) for share, length in part] for part in (self.gaussian, self.spherical)
        ]
        return TerrainField.of_variograms(gaussian=scaled[0], spherical=scaled[1], **options)

    def __str__(self) -> str:
        parts = [
            f"{100.0 * share:.0f} % {kind} over {length:.3g} m"
            for kind, pairs in (("Gaussian", self.gaussian), ("spherical", self.spherical))
            for share, length in pairs
        ]
        missing = f", {self.missing} without a height" if self.missing else ""
        steep = float(self.sigma_at(math.radians(30.0)))
        return (
            f"{len(self.errors)} heights{missing}: bias {self.bias:.3g} m (median), NMAD {self.nmad:.3g} m; standard "
            f"deviation {self.level:.3g} m on level ground, {steep:.3g} m at a slope of 30°; variance "
            f"{', '.join(parts)}."
        )


def height_errors(
    dem: Dem | Any, reference: Dem | Geodetic | Any, *, count: int = COUNT, seed: int = 0
) -> HeightErrors:
    """Errors of the heights of a DEM against a better DEM, or against check points (n,).

    Against a DEM, `count` posts drawn at random with `seed` are compared, and pairs of posts in classes of distance
    from one post to half of the DEM; the differences are taken for errors of the first. The spread follows the slope,
    sigma(slope) = hypot(level, steep tan(slope)), fitted to the NMAD in ten classes of slope; the variogram is that of
    errors divided by it (Hugonnet et al. 2022, "Uncertainty analysis of digital elevation models by spatial inference
    from stable terrain"). Bias and spread are median and NMAD (Höhle and Höhle 2009, "Accuracy assessment of digital
    elevation models by means of robust statistical methods"), semivariances are robust (Dowd 1984, "The variogram and
    kriging: robust and resistant estimators"). One or two Gaussian or spherical parts are fitted to them with weights
    (Cressie 1985, "Fitting variogram models by weighted least squares"), as many as the corrected criterion of Akaike
    asks for.

    Raises `TypeError` for other records, and `ValueError` for fewer than 30 common heights, and where pairs are too few
    for a variogram.
    """
    check_is(dem, Dem, "dem", "Read one with jaxgeo.io.read_dem.")
    if not isinstance(reference, Dem | Geodetic):
        raise TypeError(f"reference must be a Dem, or check points as a Geodetic; got {type(reference).__name__}.")
    if count < FEWEST:
        raise ValueError(f"count must be {FEWEST} heights or more; got {count!r}.")
    rng = np.random.default_rng(seed)
    compared = _of_posts(dem, reference, count, rng) if isinstance(reference, Dem) else _of_points(dem, reference)
    places, errors, slope, pairs_of = compared
    known = np.isfinite(errors)
    if np.count_nonzero(known) < FEWEST:
        raise ValueError(
            f"{np.count_nonzero(known)} of {len(errors)} heights are known in both; {FEWEST} are needed. Do they cover "
            "the same ground?"
        )
    own, own_slope = errors[known], slope[known]
    bias = float(np.median(own))
    level, steep = _spread(own - bias, own_slope)
    distance, difference = pairs_of(lambda error, at: (error - bias) / _sigma(at, level, steep), places)
    variogram = _variogram(distance, difference)
    parts = _fitted(variogram)
    return HeightErrors(
        errors=own,
        slope=own_slope,
        missing=int(np.count_nonzero(~known)),
        bias=bias,
        nmad=nmad(own),
        level=level,
        steep=steep,
        variogram=variogram,
        gaussian=tuple((share, length) for kind, share, length in parts if kind == "gaussian"),
        spherical=tuple((share, length) for kind, share, length in parts if kind == "spherical"),
    )


def nmad(errors: np.ndarray) -> float:
    """Normalised median absolute deviation: the standard deviation of normal errors, whatever a few outliers are."""
    return NORMAL * float(np.median(np.abs(errors - np.median(errors))))


def _sigma(slope: np.ndarray, level: float, steep: float) -> np.ndarray:
    return np.asarray(np.hypot(level, steep * np.tan(np.minimum(slope, math.radians(STEEP)))))


# Heights that are compared.


def _of_points(dem: Dem, points: Geodetic) -> Any:
    lat, lon, height = (np.asarray(x, np.float64).reshape(-1) for x in (points.lat, points.lon, points.height))
    heights, slope = _heights(dem, lat, lon)
    errors = heights - height
    places = np.asarray(
        jax.vmap(WGS84.to_ecef)(Geodetic(lat=jnp.asarray(lat), lon=jnp.asarray(lon), height=jnp.asarray(height)))
    )

    def pairs(scaled: Any, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        known = np.flatnonzero(np.isfinite(errors))[: int(math.sqrt(2.0 * 64 * CLASSES * PAIRS))]
        value = scaled(errors[known], slope[known])
        one, other = np.triu_indices(len(known), 1)
        distance = np.linalg.norm(places[known[one]] - places[known[other]], axis=1)
        near = distance <= 0.5 * distance.max()
        return distance[near], (value[one] - value[other])[near]

    return places, errors, slope, pairs


def _of_posts(dem: Dem, reference: Dem, count: int, rng: np.random.Generator) -> Any:
    shape = np.array(np.shape(dem.posts))
    number = rng.permutation(int(np.prod(shape)))[:count]
    places = np.stack(np.divmod(number, shape[1]), axis=1)
    errors, slope = _errors_at(dem, reference, places)
    size = np.asarray(dem.grid.cell_size(), np.float64)
    edges = np.geomspace(size.max(), 0.5 * float(np.min(shape * size)), CLASSES)

    def pairs(scaled: Any, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        known = np.flatnonzero(np.isfinite(errors))
        first = places[rng.choice(known, CLASSES * PAIRS)]
        turn, length = rng.uniform(0.0, 2.0 * math.pi, len(first)), np.repeat(edges, PAIRS)
        step = np.rint(length[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1) / size).astype(int)
        second = first + step
        inside = ((second >= 0) & (second < shape) & (step != 0).any(axis=1, keepdims=True)).all(axis=1)
        first, second, step = first[inside], second[inside], step[inside]
        values = [scaled(*_errors_at(dem, reference, place)) for place in (first, second)]
        difference = values[0] - values[1]
        found = np.isfinite(difference)
        return np.linalg.norm(step * size, axis=1)[found], difference[found]

    return places, errors, slope, pairs


def _errors_at(dem: Dem, reference: Dem, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(height minus that of the reference in m, slope of the reference in rad) at posts (row, col)."""
    lat, lon = (np.concatenate(x) for x in zip(*(_latlon(dem, part) for part in _parts(places)), strict=True))
    (height, _), (other, slope) = _heights(dem, lat, lon), _heights(reference, lat, lon)
    return (height - other)[: len(places)], slope[: len(places)]


def _heights(dem: Dem, lat: np.ndarray, lon: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(height in m, slope in rad) of a DEM at latitudes and longitudes (n,), NaN where there is none."""
    parts = [_height_and_slope(dem, part) for part in _parts(np.stack([lat, lon], axis=1))]
    height, slope = (np.concatenate(x)[: len(lat)] for x in zip(*jax.device_get(parts), strict=True))
    return height, slope


def _parts(rows: np.ndarray) -> list[np.ndarray]:
    """Rows in parts of one size, the last filled with the first row."""
    more = -len(rows) % BATCH
    filled = np.concatenate([rows, np.repeat(rows[:1], more, axis=0)])
    return list(filled.astype(np.float64).reshape(-1, BATCH, rows.shape[1]))


@quick_filter_jit
def _height_and_slope(dem: Dem, latlon: Any) -> tuple[jax.Array, jax.Array]:
    def one(at: jax.Array) -> tuple[jax.Array, jax.Array]:
        position = Geodetic(lat=at[0], lon=at[1], height=jnp.zeros(()))
        return dem.height_at(position), dem.slope_at(position)

    return jax.vmap(one)(latlon)


@quick_filter_jit
def _latlon(dem: Dem, rowcol: Any) -> tuple[jax.Array, jax.Array]:
    def one(at: jax.Array) -> tuple[jax.Array, jax.Array]:
        position = WGS84.to_geodetic(surface_point(dem.grid.normal(at)))
        return jnp.asarray(position.lat), jnp.asarray(position.lon)

    return jax.vmap(one)(rowcol)


# Spread and variogram.


def _spread(errors: np.ndarray, slope: np.ndarray) -> tuple[float, float]:
    """(level, steep) of sigma(slope), fitted to the NMAD in up to ten classes of slope."""
    classes = np.array_split(np.argsort(slope, kind="stable"), min(10, len(errors) // FEWEST))
    squared = np.array([NORMAL * np.median(np.abs(errors[one])) for one in classes]) ** 2
    tangent = np.tan(np.minimum(slope, math.radians(STEEP)))
    design = np.stack([np.ones(len(classes)), [np.mean(tangent[one] ** 2) for one in classes]], axis=1)
    weight = 1.0 / np.maximum(squared, 1e-6 * squared.max() + 1e-300)
    found, _ = scipy.optimize.nnls(weight[:, None] * design, weight * squared)
    if not np.any(found > 0.0):
        raise ValueError("all errors are equal: the two hold the same heights, and there is nothing to fit.")
    level, steep = np.sqrt(found)
    return float(level), float(steep)


def _variogram(distance: np.ndarray, difference: np.ndarray) -> Variogram:
    """Robust semivariances in classes of distance: those of normal differences of their median magnitude."""
    if len(distance) < 3 * FEWEST_PAIRS:
        raise ValueError(
            f"{len(distance)} pairs of heights are too few for a variogram; {3 * FEWEST_PAIRS} are needed."
        )
    edges = np.geomspace(distance.min(), distance.max() * (1.0 + 1e-12), CLASSES + 1)
    number = np.clip(np.searchsorted(edges, distance, side="right") - 1, 0, CLASSES - 1)
    rows = [
        (distance[own].mean(), 0.5 * (NORMAL * np.median(np.abs(difference[own]))) ** 2, np.count_nonzero(own))
        for own in (number == k for k in range(CLASSES))
        if np.count_nonzero(own) >= FEWEST_PAIRS
    ]
    if len(rows) < 4:
        raise ValueError(
            f"pairs of heights fill {len(rows)} classes of distance; 4 are needed for a variogram. Give more points, "
            "some of them near each other."
        )
    return Variogram(*(np.array(column) for column in zip(*rows, strict=True)))


def _fitted(variogram: Variogram) -> list[tuple[str, float, float]]:
    """(kind, share of the variance, length in m) of the parts, of the best of the `MODELS`; shares add up to 1."""
    distance, semivariance, pairs = variogram
    fits = []
    for kinds in MODELS:
        at = np.linspace(0.3, 0.8, len(kinds)) if len(kinds) > 1 else np.array([0.5])
        lengths = np.log(distance[0]) + at * np.log(distance[-1] / distance[0])
        start = np.concatenate([np.full(len(kinds), math.log(max(np.max(semivariance), 1e-12) / len(kinds))), lengths])
        low = np.concatenate([np.full(len(kinds), -30.0), np.full(len(kinds), math.log(0.5 * distance[0]))])
        high = np.concatenate([np.full(len(kinds), 30.0), np.full(len(kinds), math.log(4.0 * distance[-1]))])

        def misfit(x: np.ndarray, kinds: tuple[str, ...] = kinds) -> np.ndarray:
            return np.sqrt(pairs / pairs.sum()) * (semivariance / _model(x, kinds, distance) - 1.0)

        found = scipy.optimize.least_squares(misfit, np.clip(start, low + 1e-6, high - 1e-6), bounds=(low, high))
        n, k = len(distance), 2 * len(kinds)
        if n - k - 2 > 0:
            corrected = n * math.log(max(2.0 * found.cost, 1e-12) / n) + 2.0 * k * n / (n - k - 1.0)
            fits.append((corrected, kinds, found.x))
    _, kinds, x = min(fits, key=lambda fit: fit[0])
    share = np.exp(x[: len(kinds)])
    return [
        (kind, float(own), float(length))
        for kind, own, length in zip(kinds, share / share.sum(), np.exp(x[len(kinds) :]), strict=True)
        if own > 1e-6 * share.sum()
    ]


def _model(x: np.ndarray, kinds: tuple[str, ...], distance: np.ndarray) -> np.ndarray:
    """Semivariances of a sum of parts."""
    total = np.full(len(distance), 1e-12)
    for kind, log_sill, log_length in zip(kinds, x[: len(kinds)], x[len(kinds) :], strict=True):
        ratio = distance / math.exp(log_length)
        near = np.minimum(ratio, 1.0)
        rise = 1.0 - np.exp(-(ratio**2)) if kind == "gaussian" else 1.5 * near - 0.5 * near**3
        total = total + math.exp(log_sill) * rise
    return total
