"""Errors of fixes at surveyed points, with the joint covariance that an error model states for them."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Numbers
from jaxgeo.earth import Geodetic
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.observation import Observation
from jaxgeo.sensor import Shot
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractSearch, AbstractTerrain, ConstantHeight
from jaxgeo.uncertainty.check_points import CheckPoints
from jaxgeo.uncertainty.host_arrays import on_host, take
from jaxgeo.uncertainty.linear import FACET, propagate_linear
from jaxgeo.uncertainty.many_exposures import Batch, check_batch, inputs_of
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import Occasion
from jaxgeo.uncertainty.sources import PixelMeasurement
from jaxgeo.uncertainty.sources.base import AbstractSource

RANK = 1e-12  # of the largest eigenvalue of a covariance: smaller ones are rounding
LEAST = 64  # entries that a joint covariance is padded to, or twice as many, and so on


class Seen(NamedTuple):
    """Fixes of pixels (n, ...), their errors in m in east, north, up at each, and derivatives by the error sources.

    `normal_enu` is that of the ground, `direction_enu` that of the line of sight. `model` is evaluated at each fix.
    """

    status: Any
    error_enu: Any
    jacobian: Any
    slant_range: Any
    direction_enu: Any
    normal_enu: Any
    model: ErrorModel


class Part(NamedTuple):
    """What one error source, or one axis of it, adds to the joint covariance of the errors.

    `covariance` (3 n, 3 n) in m2, `correlation` (n, n) between pixels, `effects` (3 n, axes) the errors that one sigma
    of each axis makes if all pixels share it; `source` is its index in the model, `axis` None for all.
    """

    label: str
    source: int
    axis: int | None
    covariance: np.ndarray
    correlation: np.ndarray
    effects: np.ndarray

    def root(self) -> np.ndarray:
        """B (3 n, columns) with B B' = `covariance`: a column for each axis and each independent realisation."""
        if not self.effects.shape[1]:
            values, vectors = np.linalg.eigh(self.covariance)
            kept = values > RANK * values[-1]
            return vectors[:, kept] * np.sqrt(values[kept])
        values, vectors = np.linalg.eigh(self.correlation)
        kept = values > RANK * values[-1]
        shares = np.repeat(vectors[:, kept] * np.sqrt(values[kept]), 3, axis=0)
        return (self.effects[:, :, None] * shares[:, None, :]).reshape(len(shares), -1)


class CheckErrors(NamedTuple):
    """Errors of the fixes at check points that have one.

    `index` are their rows in `points`; `seen` holds all rows. `noise` (3 n, 3 n) in m2 is the covariance of the survey
    and of the measured pixels, where these are stated with the points.
    """

    points: CheckPoints
    model: ErrorModel
    seen: Seen
    index: np.ndarray
    noise: np.ndarray

    @property
    def error(self) -> np.ndarray:
        """Errors (3 n) in m: east, north and up of the first pixel, then of the second."""
        return self.seen.error_enu[self.index].reshape(-1)

    def parts(self, each_axis: bool = False) -> list[Part]:
        """The parts of the joint covariance by source, or by axis for sources with independent axes."""
        found: list[Part] = []
        shared = self._correlations()
        for number, (source, place) in enumerate(self.model.parts()):
            evaluated = jax.tree.map(lambda x: np.asarray(x)[self.index], self.seen.model.sources[number])
            jacobian = self.seen.jacobian[self.index][:, :, place]
            if type(source).cross_covariance is not AbstractSource.cross_covariance:
                joint = self._by_pairs(evaluated, jacobian)
                effects = np.zeros((3 * len(self.index), 0))
                found.append(Part(source.label, number, None, joint, shared[number], effects))
                continue
            effects = _effects(evaluated, jacobian)
            split = each_axis and source.correlation is None and len(source.axes) > 1
            for axis in range(len(source.axes)) if split else (None,):
                label = source.label if axis is None else f"{source.label} {source.axes[axis]}"
                some = effects if axis is None else effects[:, [axis]]
                joint = (some @ some.T) * np.kron(shared[number], np.ones((3, 3)))
                found.append(Part(label, number, axis, joint, shared[number], some))
        return found

    def covariance(self) -> np.ndarray:
        """Joint covariance (3 n, 3 n) of the errors in m2, with survey and pixels."""
        return self.noise + sum(part.covariance for part in self.parts())

    def _occasions(self, size: int) -> Occasion:
        _, image, flight = self.points.numbers
        columns = (np.arange(len(self.points)), image, flight, self.points.times)
        number, image, flight, time = (np.resize(np.asarray(x, np.float64)[self.index], size) for x in columns)
        return Occasion(number, image, flight, time)

    def _correlations(self) -> list[np.ndarray]:
        """Correlation (n, n) of each source between the pixels."""
        count = len(self.index)
        size = padded_size(count)
        sharings = tuple(take(source.sharing, 0) for source in self.seen.model.sources)
        return [np.asarray(one)[:count, :count] for one in _correlated(sharings, self._occasions(size))]

    def _by_pairs(self, evaluated: Any, jacobian: np.ndarray) -> np.ndarray:
        """Joint covariance of a source that computes its own covariance between two observations."""
        count = len(self.index)
        size = padded_size(count)
        source, filled = jax.tree.map(lambda x: np.resize(x, (size, *x.shape[1:])), (evaluated, jacobian))
        blocks = np.asarray(_pairs(source, filled, self._occasions(size)))[:count, :count]
        return blocks.transpose(0, 2, 1, 3).reshape(3 * count, 3 * count)


def errors_at(points: CheckPoints, terrain: AbstractTerrain, errors: Any, search: AbstractSearch) -> CheckErrors:
    """Errors of the fixes of check points over a terrain, and their derivatives by an error model.

    Raises `ValueError` if the measuring error of the pixels is stated twice or not at all, as `propagate`, and if no
    point has a fix.
    """
    if not isinstance(points, CheckPoints):
        raise TypeError(f"points must be jaxgeo CheckPoints; got {type(points).__name__}.")
    observation = points.observation
    model, extended = _models(points, errors, terrain, search)
    exposure = observation.exposure
    given = (exposure.sensor, exposure.motion, observation.uv, terrain, extended, exposure.time, exposure.atmosphere)
    batch, count = check_batch(given, _axes(observation, terrain, extended), search)
    if count != len(points):
        raise ValueError(f"observation must have {len(points)} exposures, one for each pixel; got {count}.")
    seen = _seen(batch, count, points.position, search)
    index = np.flatnonzero(np.asarray(seen.status) == Status.hit)
    if not len(index):
        worst = Status(int(seen.status[0]))
        raise ValueError(f"no check point has a fix, e.g. {points.points[0]}: {worst.name}: {worst.message}")
    noise = _noise(points, seen, index)
    seen = seen._replace(jacobian=seen.jacobian[:, :, : model.size])
    return CheckErrors(points, model, seen, index, noise)


def padded_size(count: int) -> int:
    """The next of 64, 128, 256, ... from a count on."""
    return max(LEAST, 1 << (count - 1).bit_length())


def _models(
    points: CheckPoints, errors: Any, terrain: AbstractTerrain, search: AbstractSearch
) -> tuple[ErrorModel, ErrorModel]:
    """(the error model, the same with unit errors of the pixel as the last source)."""
    sources = errors.sources if isinstance(errors, ErrorModel) else errors
    sources = (sources,) if isinstance(sources, AbstractSource) else sources
    if isinstance(sources, tuple | list):
        stated = any(isinstance(source, PixelMeasurement) for source in sources)
        if stated and points.sigma_px is not None:
            raise ValueError(
                "the measuring error of the pixels is stated twice: by sigma_px of the points and by a "
                "PixelMeasurement of the error model; leave one out."
            )
        if not stated and points.sigma_px is None:
            raise ValueError(
                "the measuring error of the pixels is not stated: give sigma_px with the points, or a "
                "PixelMeasurement source with the error model."
            )
    exposure = points.observation.exposure
    first = take(exposure.motion, 0) if isinstance(exposure.motion, Shot) else exposure.motion
    sensor = take(exposure.sensor, 0) if _has_batch(exposure.sensor.mount.lever_body, 1) else exposure.sensor
    time = None if exposure.time is None else float(np.asarray(exposure.time).reshape(-1)[0])
    ground = take(terrain, 0) if _is_batch_of_levels(terrain) else terrain
    air = exposure.atmosphere
    pixel = np.asarray(points.observation.uv)[0]
    inputs = ModelInputs.of(sensor, first, pixel, ground, time=time, search=search, atmosphere=air, of_many=True)
    of_one = sources
    if isinstance(sources, tuple | list) and sources and all(isinstance(one, AbstractSource) for one in sources):
        of_one = tuple(take(one, 0) if _has_batch(one.sigma, 1) else one for one in sources)
    model = checked_model(of_one, inputs)
    whole = ErrorModel(tuple(sources))
    for source in whole.sources:
        sigma = np.asarray(source.sigma, np.float64)
        if not np.all(np.isfinite(sigma) & (sigma >= 0.0)):
            raise ValueError(f"{source.label}: sigma must not be negative, and finite; got {float(sigma.min())!r}.")
    unit = PixelMeasurement.from_pixels(column=1.0, row=1.0)
    if any(_has_batch(source.sigma, 1) for source in whole.sources):
        count = len(points)
        each = lambda tree: jax.tree.map(lambda x: np.broadcast_to(np.asarray(x), (count, *np.shape(x))), tree)  # noqa: E731
        whole = ErrorModel(tuple(s if _has_batch(s.sigma, 1) else each(s) for s in whole.sources))
        unit = each(unit)
    return model, ErrorModel((*whole.sources, unit))


def _axes(observation: Observation, terrain: AbstractTerrain, errors: ErrorModel) -> tuple[int | None, ...]:
    """Which of sensor, shot, pixel, terrain and errors have an axis of pixels, by their shapes."""
    exposure = observation.exposure
    return (
        0 if _has_batch(exposure.sensor.mount.lever_body, 1) else None,
        0 if isinstance(exposure.motion, Shot) and np.ndim(exposure.motion.pose.position.lat) else None,
        0,
        0 if _is_batch_of_levels(terrain) else None,
        0 if _has_batch(errors.sources[0].sigma, 1) else None,
    )


def _has_batch(leaf: Any, axes: int) -> bool:
    return np.ndim(leaf) > axes


def _is_batch_of_levels(terrain: AbstractTerrain) -> bool:
    return isinstance(terrain, ConstantHeight) and np.ndim(terrain.height) > 0


def _seen(batch: Batch, count: int, position: Geodetic, search: AbstractSearch) -> Seen:
    """Fixes of pixels, their errors at the surveyed positions, and derivatives, by the programs of `propagate`."""
    truth = _ecef_of(position, count)
    rows = []
    for number in range(count):
        inputs, model = inputs_of(batch.at(number))
        nominal = inputs.nominal_fix(search)
        found = propagate_linear(inputs, nominal, model, FACET)
        fix, frame = nominal.fix, np.asarray(nominal.R_ecef_from_enu)
        jacobian, error = np.asarray(found.jacobian), frame.T @ (np.asarray(nominal.p_ecef) - truth[number])
        status = Status(int(np.asarray(fix.status)))
        if status is Status.hit and not (np.isfinite(jacobian).all() and np.isfinite(error).all()):
            status = Status.not_converged
        if status is not Status.hit:
            error = np.full(3, np.nan)
        normal = np.cross(jacobian[:, -1], jacobian[:, -2])  # by columns and rows: both lie in the ground
        normal = normal * np.sign(normal[2]) / np.linalg.norm(normal)
        look = np.asarray(fix.slant_range), np.asarray(nominal.direction_enu)
        rows.append(Seen(np.asarray(int(status)), error, jacobian, *look, normal, on_host(found.model)))
    return jax.tree.map(lambda *leaves: np.stack(leaves), *rows)


def _ecef_of(position: Geodetic, count: int) -> np.ndarray:
    """Positions (n,) in ECEF m."""
    size = padded_size(count)
    return np.asarray(_to_ecef(jax.tree.map(lambda x: np.resize(np.asarray(x, np.float64), size), position)))[:count]


@batch_filter_jit
def _to_ecef(position: Geodetic) -> Numbers:
    return jax.vmap(WGS84.to_ecef)(position)


@batch_filter_jit
def _correlated(sharings: tuple[Any, ...], occasions: Occasion) -> list[Numbers]:
    """Correlation (n, n) of each sharing between n occasions."""

    def pair(here: Occasion, there: Occasion) -> list[Numbers]:
        return [jnp.asarray(one.correlation(here, there)) for one in sharings]

    return jax.vmap(lambda here: jax.vmap(lambda there: pair(here, there))(occasions))(occasions)


@batch_filter_jit
def _pairs(source: Any, jacobian: Numbers, occasions: Occasion) -> Numbers:
    """Covariance (n, n, 3, 3) between the fixes of n observations by one source."""

    def row(here: Any) -> Numbers:
        one, by_error, when = here

        def pair(other: Any, by_other: Numbers, then: Occasion) -> Numbers:
            return by_error @ one.cross_covariance(other, (when, then)) @ by_other.T

        return jax.vmap(pair)(source, jacobian, occasions)

    return jax.lax.map(row, (source, jacobian, occasions))


def _effects(source: Any, jacobian: np.ndarray) -> np.ndarray:
    """Errors (3 n, axes) that the axes make at one sigma, uncorrelated within a source."""
    effects = jacobian * np.asarray(source.sigma)[:, None, :]
    if source.correlation is not None:
        values, vectors = np.linalg.eigh(np.asarray(source.correlation))
        effects = effects @ (vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])
    return effects.reshape(-1, effects.shape[-1])


def _noise(points: CheckPoints, seen: Seen, index: np.ndarray) -> np.ndarray:
    """Joint covariance of the survey, common to all pixels of a point, and of the measured pixels."""
    count = len(index)
    same = (points.numbers[0][index][:, None] == points.numbers[0][index][None, :]).astype(float)
    sigma = points.sigma_enu[index]
    blocks = np.einsum("ij,ia,ja,ab->iajb", same, sigma, sigma, np.eye(3))
    if points.sigma_px is not None:
        by_pixel = np.asarray(seen.jacobian)[index][:, :, -2:] * points.sigma_px[index][:, None, :]
        blocks[np.arange(count), :, np.arange(count), :] += by_pixel @ by_pixel.transpose(0, 2, 1)
    return blocks.reshape(3 * count, 3 * count)
