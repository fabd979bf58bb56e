"""Forward intersection of a point from two or more images."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Int

from jaxgeo._compile import quick_filter_jit
from jaxgeo._numerics import all_finite, finite_or
from jaxgeo._record import Record
from jaxgeo._typing import (
    Matrix3,
    Matrix3Field,
    Numbers,
    Scalar,
    ScalarField,
    StatusCode,
    StatusField,
    Vector3,
    Vector3Field,
)
from jaxgeo.adjust._least_squares import check_least_squares
from jaxgeo.adjust._measurements import Measured, checked_measurements
from jaxgeo.adjust._solution import Root, WeightedImages, least_squares_point, ranges_of, spread_of
from jaxgeo.adjust.rays import (
    Flags,
    Image,
    Rays,
    Residuals,
    Stacked,
    largest_angle,
    moved_by_errors,
    nearest_point,
    residuals_of,
    shared_covariance,
    whitening,
)
from jaxgeo.earth import WGS84, Atmosphere, Geodetic, R_ecef_from_enu
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.sensor.sensor import made_safe
from jaxgeo.status import Status, first_failure, seen_beside, status_where
from jaxgeo.uncertainty.metrics import circular_error, linear_error, spherical_error

CLOSE_ENOUGH = 1e-6  # m, and relative to the standard deviation: longest last step
WEAK = 0.1  # of the shortest slant range: standard deviation above which the depth is undetermined
NEARLY_PARALLEL = 0.02  # rad: rays that intersect behind the camera within this angle count as weak, not as wrong


# # Under `jit` an invalid covariance, such as that of a failed point, gives NaN instead of an exception.
_circular_error, _linear_error, _spherical_error = map(jax.jit, (circular_error, linear_error, spherical_error))


class Intersection(Record):
    """A point intersected from several images, with its covariance and status.

    `position` and `p_ecef` (m) are the same point; `cov_enu` (3, 3) is its covariance in m2 along east, north, up
    there, from the given errors, not scaled by the residuals. `residuals` (rays, 2) are the projected less the measured
    pixels, px; `chi_square` is their squared sum under the given errors, with `degrees_of_freedom`; `angle` in rad is
    the largest between any two rays; `slant_ranges` (rays,) in m from each perspective centre; `used` (rays,) flags the
    rays used. `status` is an int8 `Status`. Failed points and unused rays have NaN; the angle remains where there are
    rays. Under `vmap` all have a leading axis of points.
    """

    position: Geodetic
    p_ecef: Vector3Field
    cov_enu: Matrix3Field
    residuals: Numbers
    chi_square: ScalarField
    angle: ScalarField
    slant_ranges: Numbers
    used: Bool[Array, "..."]
    status: StatusField

    @property
    def ok(self) -> Bool[Array, "..."]:
        """Whether there is a point."""
        return jnp.asarray(self.status) == Status.hit

    @property
    def rays(self) -> Int[Array, "..."]:
        """Number of rays used."""
        return jnp.sum(self.used, axis=-1)

    @property
    def degrees_of_freedom(self) -> Int[Array, "..."]:
        """Redundancy: 2 rays - 3."""
        return jnp.maximum(2 * self.rays - 3, 0)

    @property
    def sigma0(self) -> Numbers:
        """Ratio of the residuals to their expected size: 1 if the given errors are correct."""
        return jnp.sqrt(jnp.asarray(self.chi_square) / jnp.maximum(self.degrees_of_freedom, 1))

    @property
    def cov_ecef(self) -> Numbers:
        """Covariance in ECEF, m2, (..., 3, 3)."""
        cov, lat, lon = (jnp.asarray(x) for x in (self.cov_enu, self.position.lat, self.position.lon))

        def rotate_to_ecef(cov: Matrix3, lat: Scalar, lon: Scalar) -> Matrix3:
            R = R_ecef_from_enu(Geodetic(lat=lat, lon=lon, height=jnp.zeros_like(lat)))
            return R @ cov @ R.T

        several = jax.vmap(rotate_to_ecef)(cov.reshape(-1, 3, 3), lat.reshape(-1), lon.reshape(-1))
        return several.reshape(cov.shape)

    @property
    def ce90(self) -> Numbers:
        """CE90: radius in m of the horizontal circle about the point that contains the true one with 90 %."""
        return self.circular_error(0.9)

    @property
    def le90(self) -> Numbers:
        """LE90: height in m above and below the point that contains the true one with 90 %."""
        return self.linear_error(0.9)

    def circular_error(self, probability: ArrayLike) -> Numbers:
        """Radius in m of the horizontal circle about the point that contains the true one with a probability."""
        return _circular_error(jnp.asarray(self.cov_enu)[..., :2, :2], probability)

    def linear_error(self, probability: ArrayLike) -> Numbers:
        """Height in m above and below the point that contains the true one with a probability."""
        return _linear_error(jnp.asarray(self.cov_enu)[..., 2, 2], probability)

    def spherical_error(self, probability: ArrayLike) -> Numbers:
        """Radius in m of the sphere about the point that contains the true one with a probability."""
        return _spherical_error(jnp.asarray(self.cov_enu), probability)


def forward_intersection(
    sensor: Sensor | Any,
    shots: Shot | Any,
    uvs: Any,
    *,
    sigma: Any = None,
    errors: Any = None,
    use: Any = None,
    atmosphere: Atmosphere | None = None,
    shot_of: Any = None,
    flight_of: Any = None,
    solver: Any = None,
) -> Intersection:
    """Intersect the rays of pixels in several shots in one point, with its covariance.

    `shots` is a `Shot` with a leading axis (rays,), or a list of shots; `uvs` (rays, 2) the measured (column, row) in
    px; `sensor` one for all, or a list, or a batch with a leading axis (rays,) on every number. `use` (rays,) flags the
    rays to use (default all), so that points with different numbers of rays can be padded to one shape, with arbitrary
    values, and go through one `jax.vmap`. With an `atmosphere` the lines of sight are refracted as in `jaxgeo.project`.

    One or both of these define the error model, and so the weights:

    * `sigma`: standard deviation of the measured pixels in px (a number, (rays,), or (rays, 2)), all independent. Least
      squares with these weights, with error-free cameras and shots.
    * `errors`: an `ErrorModel`, or a tuple of sources. Generalised least squares with the covariance of all residuals,
      in which errors shared between images are correlated (a boresight `PerFlight`, an attitude `PerImage`): the best
      linear unbiased estimate. Include a `PixelMeasurement`. Terrain errors are ignored.
    * both: weights from `sigma` alone, as in most programs; the covariance of that estimate under `errors`.

    `shot_of` and `flight_of` (rays,) number the shot and the flight of each ray (default: all different; all one), as
    for `jaxgeo.uncertainty.joint_covariance`: two simultaneously exposed cameras have the same shot. Independently
    calibrated cameras need different flights. Times are those of the shots.

    The equations are the collinearity equations with residuals in pixels, solved by Gauss-Newton from the point nearest
    to all rays. Xue, Zhang, Wang, Yu and Cao (2019), Eq 2, write them linear in the coordinates, l1 X + l2 Y + l3 Z -
    lx = 0. Their residuals are pixels times depth, so that far images get more weight than near ones; and lx is l1 Xs +
    l2 Ys + l3 Zs with the perspective centre, not the pixel as stated there. Correlations are evaluated at the
    equal-weight solution. Position, covariance and all else are differentiable, to second order, forward and reverse,
    by the implicit function theorem, in shots, sensor, pixels, air and sigmas.

    `solver` is an optimistix least-squares solver, from the same start, with the same derivatives. The default is
    `STEPS` Gauss-Newton steps: the first call of six rays with `sigma` takes 3.3 s of processor time compiled alike, by
    optimistix 3.8 (`GaussNewton`) to 5.2 s (`Dogleg`), and 2000 points in one `vmap` 22 ms, by `GaussNewton` 16 to
    18 ms and by `LevenbergMarquardt` 164 ms (single runs on two busy cores; `benchmarks/solvers.py` repeats them).
    Single calls are compiled with fewer optimisations, in 2.0 s.

    The status is `too_few_rays` for fewer than two used rays; `weak_intersection` for a standard deviation above a
    tenth of the shortest slant range; `behind_camera`, `outside_distortion_field`, `invalid_input` (NaN in a used ray),
    `not_converged`, also where a solver ends off the minimum. No ray is rejected automatically. A scanning camera in
    motion needs shots at the times of its pixels.

    Raises `RuntimeError` with 64-bit floats off; `TypeError` for float32 and arguments of the wrong kind; `ValueError`
    for shapes that do not fit, fewer than two rays, a latitude beyond a pole, a sigma that is not positive, neither
    sigma nor errors, and as `jaxgeo.uncertainty.propagate` does for errors.

    >>> from jaxgeo import adjust
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.nadir())
    >>> shots = [jaxgeo.Shot(jaxgeo.Pose.from_degrees(lat=47.0, lon=lon, height=1600.0)) for lon in (11.0, 11.004)]
    >>> point = jaxgeo.Geodetic.from_degrees(lat=47.001, lon=11.002, height=610.0)
    >>> pixels = np.stack([jaxgeo.project(sensor, shot, point).uv for shot in shots])
    >>> found = adjust.forward_intersection(sensor, shots, pixels, sigma=0.5)
    >>> print(f"{found.position.height:.3f} m, LE90 {found.linear_error(0.9):.2f} m")
    610.000 m, LE90 1.01 m
    """
    check_least_squares(solver)
    measured = checked_measurements(sensor, shots, uvs, sigma, errors, use, atmosphere, shot_of, flight_of)
    return _intersect(measured, solver)


@quick_filter_jit
def _intersect(measured: Measured, solver: Any) -> Intersection:
    images, directions, rays, status = _lines(measured)
    used, air = images.used, finite_or(measured.air, 1.0)
    p_ecef, meet = nearest_point(*jax.lax.stop_gradient((images.sight.centre, directions)), used)
    weighted, errors = WeightedImages(images, _pixel_weights(measured.sigma, used), air), None
    p_ecef, step = least_squares_point(weighted, p_ecef, solver)
    if measured.errors is not None:
        errors = _errors_at(measured, rays, p_ecef, air)
    if errors is not None and measured.sigma is None:
        weighted = WeightedImages(images, errors[0], air)
        p_ecef, step = least_squares_point(weighted, p_ecef, solver)
    residuals, statuses = residuals_of(images, p_ecef, air)
    cov, chi_square = spread_of(weighted, errors, p_ecef, residuals)

    ranges, angle = ranges_of(images, p_ecef), largest_angle(directions, used)
    deviation = jnp.sqrt(jnp.maximum(jnp.trace(cov), 0.0))
    is_far = ~(deviation <= WEAK * jnp.min(jnp.where(used, ranges, jnp.inf)))
    unseen = _first(statuses, used)
    is_weak = ~meet | is_far & ((unseen == Status.hit) | (angle < NEARLY_PARALLEL))
    is_done = step <= CLOSE_ENOUGH * (1.0 + deviation)
    status = first_failure(status, status_where(is_weak, Status.weak_intersection, Status.hit.code), unseen)
    status = first_failure(status, status_where(is_done, Status.hit, Status.not_converged.code))

    ok, position = status == Status.hit, WGS84.to_geodetic(p_ecef)
    R = R_ecef_from_enu(position)
    numbers = (position, p_ecef, R.T @ cov @ R, residuals, chi_square)
    position, p_ecef, cov_enu, residuals, chi_square = jax.tree.map(lambda x: jnp.where(ok, x, jnp.nan), numbers)
    residuals = jnp.where(used[:, None], residuals, jnp.nan)
    ranges = jnp.where(ok & used, ranges, jnp.nan)
    angle = jnp.where(jnp.sum(used) >= 2, angle, jnp.nan)
    return Intersection(position, p_ecef, cov_enu, residuals, chi_square, angle, ranges, measured.use, status)


def _lines(measured: Measured) -> tuple[Image, Rays, tuple[Sensor, Shot, Residuals, Flags], StatusCode]:
    """(images; directions in ECEF; sensors, shots, pixels and flags of valid used rays; first failure of the used
    rays).

    Invalid rays are replaced by the first valid one, so that all numbers and derivatives are finite.
    """
    valid, sensors, shots, uvs = jax.vmap(made_safe)(measured.sensors, measured.shots, measured.uvs)
    sound = measured.use & valid
    stands_in = jnp.argmax(sound)

    def filled(numbers: Array) -> Array:
        return jax.vmap(lambda number, own: jnp.where(own, number, numbers[stands_in]))(numbers, sound)

    sensors, shots, uvs = jax.tree.map(filled, (sensors, shots, uvs))
    sights = jax.vmap(Sensor.sight)(sensors, shots)
    _, directions, statuses = jax.vmap(Sensor.ray_from)(sensors, sights, uvs, sound)
    statuses = seen_beside(statuses, directions)
    has_ray = sound & (statuses == Status.hit)
    directions = jnp.where(has_ray[:, None], directions, jnp.array([[1.0, 0.0, 0.0]]))
    fit = all_finite((measured.air, measured.errors)) & jnp.all(~sound | _is_sigma(measured.sigma, sound))
    is_valid = fit & jnp.all(valid | ~measured.use)
    status = first_failure(
        status_where(is_valid, Status.hit, Status.invalid_input.code),
        status_where(jnp.sum(measured.use) < 2, Status.too_few_rays, Status.hit.code),
        _first(statuses, sound),
    )
    return Image(sensors.camera, sights, uvs, has_ray), directions, (sensors, shots, uvs, has_ray), status


def _is_sigma(sigma: Residuals | None, sound: Flags) -> Flags:
    return sound if sigma is None else jnp.all(jnp.isfinite(sigma) & (sigma > 0.0), axis=1)


def _first(statuses: Any, used: Flags) -> StatusCode:
    """The first status of the used rays that is not `hit`."""
    failed = used & (statuses != Status.hit)
    return jnp.where(jnp.any(failed), statuses[jnp.argmax(failed)], Status.hit.code)


def _pixel_weights(sigma: Residuals | None, used: Flags) -> Root:
    """Root of the pixel weights: one over their standard deviations, or 1; zero for unused rays."""
    root = jnp.ones((used.shape[0], 2))
    if sigma is not None:
        is_number = _is_sigma(sigma, used)[:, None]
        root = jnp.where(is_number, 1.0 / jnp.where(is_number, sigma, 1.0), 0.0)
    return jnp.where(used[:, None], root, 0.0).reshape(-1)


def _errors_at(measured: Measured, rays: Any, p_ecef: Vector3, air: Atmosphere | None) -> tuple[Root, Stacked]:
    """(root of the inverse error covariance of a point's residuals; that covariance, px2)."""
    assert measured.errors is not None
    model = finite_or(measured.errors, 1.0)
    occasions = measured.occasions._replace(time=rays[1].time)
    cov = shared_covariance(model, moved_by_errors(model, rays, p_ecef, air), occasions)
    return whitening(cov), cov
