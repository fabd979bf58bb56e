"""Fixes of many pixels, their predicted accuracy, and their actual errors."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgeo._numerics import safe_sqrt
from jaxgeo.observation import Exposure
from jaxgeo.register import Registration
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.studies.gu2017.scene import Imaged, points_seen
from jaxgeo.terrain import AbstractTerrain, ConstantHeight
from jaxgeo.uncertainty import ErrorModel, PerImage, PerMeasurement, propagate
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sources import Correlated, TerrainHeight

Tree = TypeVar("Tree")

ACROSS, DOWN = 6, 4  # pixels of the lattice
GRAZING = 3.0


class Fixes(NamedTuple):
    """Fixes of pixels: positions (n, 3) in ECEF, m, NaN without a fix, covariances (n, 2, 2) in m2 of east and
    north, and axes (n, 3, 3) of east, north, up."""

    ecef: Float[np.ndarray, "n 3"]
    cov: Float[np.ndarray, "n 2 2"]
    axes: Float[np.ndarray, "n 3 3"]

    def off(self, true: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Offsets (n, 2) of the positions to the east and north of the true ones, m."""
        return np.einsum("nji,nj->ni", self.axes, self.ecef - true)[:, :2]


class Spread(NamedTuple):
    """Horizontal errors of fixes in m: root mean square, 90th percentile, and the predicted values of both (the
    latter by circles about each ellipse). `squares` is the mean square of the errors in standard deviations, of two
    axes: 1 if those are right. Unknown values are None. `grazing` pixels are excluded: their predicted error exceeds
    `GRAZING` times the median, because they graze a ridge."""

    rms: float | None
    ce90: float | None
    sigma: float
    predicted90: float
    squares: float | None
    grazing: int


def lattice(sensor: Sensor) -> Float[np.ndarray, "n 2"]:
    """Pixels (column, row) spread evenly over a sensor's image."""
    sides = getattr(sensor.camera, "width"), getattr(sensor.camera, "height")  # noqa: B009
    places = [(np.arange(n) + 0.5) / n * side - 0.5 for n, side in zip((ACROSS, DOWN), sides, strict=True)]
    return np.stack(np.meshgrid(*places), axis=-1).reshape(-1, 2)


def fixes_of(im: Imaged, shot: Shot, covariance: Any, sensor: Sensor | None = None) -> Fixes:
    """Fixes of the lattice from a shot with the given error covariance, along the axes of the scene's errors."""
    sensor = im.sensor if sensor is None else sensor
    uv = jnp.asarray(lattice(im.sensor))
    numbers = jnp.asarray(covariance), jnp.asarray(height_sigma(im), float)
    given = alike((sensor, shot, im.terrain, im.errors, *numbers, uv))
    return Fixes(*(np.asarray(x) for x in _fixed(*given)))


def height_sigma(im: Imaged) -> float:
    """Standard deviation in m of the elevation model at one place."""
    field = im.tie_errors.terrain_field
    own = 0.0 if field is None else float(np.sum(np.asarray(field.sigma) ** 2))
    return float(np.sqrt(float(im.tie_errors.terrain) ** 2 + own))


def alike(tree: Tree) -> Tree:
    """The same values as arrays of one type, so that JAX reuses one compiled program whatever their origin."""
    return jax.tree.map(lambda x: jnp.asarray(np.asarray(x)) if eqx.is_inexact_array_like(x) else x, tree)


def direct(im: Imaged, given: Shot | None = None) -> Fixes:
    """Fixes from the navigation alone."""
    return fixes_of(im, im.given if given is None else given, im.errors.covariance())


def updated(im: Imaged, found: Registration) -> Fixes:
    """Fixes after a registration. Raises `ValueError` if it is missing."""
    if found.update is None or not isinstance(found.shot, Shot):
        raise ValueError(f"the image is not registered: {found.outcome.name}: {found.outcome.message}")
    return fixes_of(im, found.shot, found.update.cov_error, found.sensor)


def truth(im: Imaged) -> Float[np.ndarray, "n 3"] | None:
    """True ground points of the lattice pixels, ECEF, m; None if unknown."""
    if im.true is None or im.ground is None:
        return None
    return points_seen(im.sensor, im.true, im.ground, lattice(im.sensor))


def pose_error(im: Imaged, sensor: Sensor, shot: Shot) -> float:
    """Root mean square distance in px between the lattice pixels and the projections by a shot of their true ground
    points: the error of the pose alone, independent of the elevation model. NaN if the truth is unknown."""
    true = truth(im)
    if true is None:
        return float("nan")
    known, uv = np.isfinite(true[:, 0]), lattice(im.sensor)
    there = np.asarray(_imaged(*alike((sensor, shot)), jnp.asarray(np.where(known[:, None], true, true[known][0]))))
    return float(np.sqrt(np.mean(np.sum((there - uv)[known] ** 2, axis=1))))


def predicted_pose_error(im: Imaged, sensor: Sensor, shot: Shot, covariance: Any) -> float:
    """The predicted `pose_error` in px, from the covariance of the errors of a shot. NaN if the truth is unknown."""
    true = truth(im)
    if true is None:
        return float("nan")
    known = np.isfinite(true[:, 0])
    points = jnp.asarray(np.where(known[:, None], true, true[known][0]))
    variances = np.asarray(_image_variances(*alike((sensor, shot, im.errors)), jnp.asarray(covariance), points))
    return float(np.sqrt(np.mean(variances[known])))


def spread(fixes: Fixes, true: Float[np.ndarray, "n 3"] | None) -> Spread:
    """Error statistics of fixes, over the pixels that have one."""
    known = np.isfinite(fixes.cov).all(axis=(1, 2))
    if true is not None:
        known &= np.isfinite(true).all(axis=1)
    sigmas = np.sqrt(np.trace(fixes.cov, axis1=1, axis2=2))
    usual = known & (sigmas <= GRAZING * np.median(sigmas[known]))
    grazing, cov = int(np.count_nonzero(known & ~usual)), fixes.cov[usual]
    sigma, predicted = float(np.sqrt(np.mean(sigmas[usual] ** 2))), _ce90(cov)
    if true is None:
        return Spread(None, None, sigma, predicted, None, grazing)
    off = fixes.off(true)[usual]
    away = np.linalg.norm(off, axis=1)
    squares = np.einsum("ni,ni->n", off, np.linalg.solve(cov, off[:, :, None])[:, :, 0]) / 2.0
    rms = float(np.sqrt(np.mean(away**2)))
    return Spread(rms, float(np.quantile(away, 0.9)), sigma, predicted, float(np.mean(squares)), grazing)


def _ce90(cov: Float[np.ndarray, "n 2 2"]) -> float:
    """Median of the radii that contain 90 %."""
    from jaxgeo.uncertainty.metrics import circular_error

    return float(np.median(np.asarray(circular_error(jnp.asarray(cov), 0.9))))


@eqx.filter_jit
def _fixed(
    sensor: Sensor, shot: Shot, terrain: AbstractTerrain, errors: ErrorModel, cov: Any, sigma_terrain: Any, uv: Any
) -> tuple[jax.Array, jax.Array, jax.Array]:
    sigma = safe_sqrt(jnp.diagonal(cov))
    scale = jnp.where(sigma > 0.0, sigma, 1.0)
    correlation = jnp.where(jnp.eye(len(scale)) > 0.0, 1.0, cov / (scale[:, None] * scale[None, :]))
    block = Correlated(parts=errors.sources, sigma=sigma, correlation=correlation, sharing=PerImage())
    model = ErrorModel((block, TerrainHeight.from_metres(sigma_terrain, sharing=PerMeasurement())))

    def one(pixel: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        found = propagate(sensor, shot, pixel, terrain, model)
        return jnp.asarray(found.fix.ecef), found.cov_enu[:2, :2], found.nominal.R_ecef_from_enu

    return jax.vmap(one)(uv)


@eqx.filter_jit
def _imaged(sensor: Sensor, shot: Shot, points: Any) -> jax.Array:
    return jax.vmap(lambda p: image_of_point(sensor, shot, jnp.asarray(0.0), p, None)[0])(points)


@eqx.filter_jit
def _image_variances(sensor: Sensor, shot: Shot, errors: ErrorModel, cov: Any, points: Any) -> jax.Array:
    """Sum of the variances in px2 of column and row of the images of points."""
    inputs = ModelInputs(Exposure(sensor, shot, jnp.asarray(0.0)), terrain=ConstantHeight(jnp.asarray(0.0)))

    def one(point: jax.Array) -> jax.Array:
        def image(error: jax.Array) -> jax.Array:
            there = errors.moved(inputs, error).exposure
            return image_of_point(there.sensor, there.motion, jnp.asarray(0.0), point, None)[0]

        by = jax.jacfwd(image)(jnp.zeros(errors.size))
        return jnp.trace(by @ cov @ by.T)

    return jax.vmap(one)(points)
