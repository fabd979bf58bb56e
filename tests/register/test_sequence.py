"""Images one after the other against one least squares adjustment of all."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import ConstantHeight, Exposure, Geodetic, Pose, Shot, locate
from jaxgeo.adjust.losses import LeastSquares
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.register import gu2017
from jaxgeo.register.orientation_update import Update, update_orientation
from jaxgeo.register.sequence import propagate_prior
from jaxgeo.register.tie_errors import TieErrors
from jaxgeo.register.ties import TiePoints
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.uncertainty import ErrorModel, PerFlight, PerImage, PerMeasurement, Systematic, TimeCorrelated
from jaxgeo.uncertainty import sources as errors_of
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import Occasion

pytestmark = pytest.mark.slow

SENSOR, FIRST = gu2017._camera(50.0, 3_000.0, 10.0)
GROUND = ConstantHeight(jnp.asarray(500.0))
UV = jnp.stack([x.reshape(-1) for x in jnp.meshgrid(jnp.linspace(100.0, 1900.0, 4), jnp.linspace(100.0, 1900.0, 3))], 1)
TIMES = (0.0, 2.0, 5.0)
SIGMA_PX = 2.0
SHIFT = 4.0  # m, of the map
OCCASIONS = [Occasion(k, k, 0, time) for k, time in enumerate(TIMES)]


def shot(number: int) -> Shot:
    """Images from a flight to the north, 80 m apart."""
    pose = Pose.from_degrees(lat=30.0 + 8e-4 * number, lon=104.0, height=3_000.0, heading=2.0 * number)
    return Shot(pose, FIRST.gimbal_readings)


def navigation(duration: float) -> ErrorModel:
    """Position and mounting, of which the latter fades three times as slowly."""
    return ErrorModel(
        (
            errors_of.Position.from_ned(north=3.0, east=2.0, down=4.0, sharing=TimeCorrelated(duration)),
            errors_of.CameraMounting.from_degrees(
                forward=0.02, right=0.02, down=0.03, sharing=TimeCorrelated(3.0 * duration)
            ),
        )
    )


def look(number: int) -> ModelInputs:
    return ModelInputs(Exposure(SENSOR, shot(number), jnp.asarray(0.0)), UV[0], GROUND)


@jax.jit
def shown(here: ModelInputs, model: ErrorModel, error: jax.Array, shift: jax.Array) -> Geodetic:
    """Places that the map shows for the pixels of a look that errs."""
    moved = model.moved(here, error)

    def one(uv: jax.Array) -> Geodetic:
        place = locate(moved.sensor, moved.motion, uv, GROUND).position
        return WGS84.to_geodetic(WGS84.to_ecef(place) + R_ecef_from_enu(place)[:, :2] @ shift)

    return jax.vmap(one)(UV)


@jax.jit
def images(here: ModelInputs, model: ErrorModel, ground: Geodetic, x: jax.Array) -> jax.Array:
    """Pixels of places on the map by errors and shift x, one after the other."""
    moved = model.moved(here, x[:6])

    def one(lat: jax.Array, lon: jax.Array) -> jax.Array:
        on_map = Geodetic(lat=lat, lon=lon, height=jnp.asarray(500.0))
        place = WGS84.to_geodetic(WGS84.to_ecef(on_map) - R_ecef_from_enu(on_map)[:, :2] @ x[6:])
        p_ecef = WGS84.to_ecef(Geodetic(lat=place.lat, lon=place.lon, height=jnp.asarray(500.0)))
        return image_of_point(moved.sensor, moved.motion, jnp.asarray(0.0), p_ecef, None)[0]

    return jax.vmap(one)(ground.lat, ground.lon).reshape(-1)


derivatives = jax.jit(jax.jacfwd(images, argnums=3))


def flown(duration: float) -> tuple[ErrorModel, list[TiePoints]]:
    """Ties of three images with errors drawn from their joint distribution, or near it."""
    model, rng = navigation(duration), np.random.default_rng(11)
    prior = joint_prior(model)
    values, vectors = np.linalg.eigh(prior)
    x = vectors @ (np.sqrt(np.maximum(values, 0.0)) * rng.normal(size=20))
    ties = []
    for k in range(3):
        ground = shown(look(k), model, jnp.asarray(x[6 * k : 6 * k + 6]), jnp.asarray(x[18:]))
        uv = UV + jnp.asarray(rng.normal(0.0, SIGMA_PX, UV.shape))
        ties.append(TiePoints(uv, ground, jnp.zeros((12, 2, 2)), SIGMA_PX))
    return model, ties


def joint_prior(model: ErrorModel) -> np.ndarray:
    """Covariance of the errors of three images and of the shift, (20, 20)."""
    total = np.zeros((20, 20))
    for i, here in enumerate(OCCASIONS):
        for j, there in enumerate(OCCASIONS):
            for source, place in model.parts():
                rows, columns = (np.arange(place.start, place.stop) + 6 * k for k in (i, j))
                total[np.ix_(rows, columns)] = source.cross_covariance(source, (here, there))
    total[18:, 18:] = SHIFT**2 * np.eye(2)
    return total


def adjusted(model: ErrorModel, ties: list[TiePoints], count: int) -> tuple[np.ndarray, np.ndarray]:
    """(errors and shift; their covariance) by dense least squares over the first images at once."""
    prior, x = joint_prior(model), np.zeros(20)
    parts = [np.r_[6 * k : 6 * k + 6, 18:20] for k in range(count)]
    H, gain = np.zeros((24 * count, 20)), np.zeros((20, 24 * count))
    for _ in range(6):
        residuals = np.zeros(24 * count)
        for k, part in enumerate(parts):
            rows = slice(24 * k, 24 * k + 24)
            given: Any = (look(k), model, ties[k].ground, jnp.asarray(x[part]))
            H[rows, part] = derivatives(*given)
            residuals[rows] = np.asarray(ties[k].uv).reshape(-1) - np.asarray(images(*given))
        gain = np.linalg.solve(H @ prior @ H.T + SIGMA_PX**2 * np.eye(24 * count), H @ prior).T
        x = gain @ (residuals + H @ x)
    return x, prior - gain @ H @ prior


def in_turn(model: ErrorModel, ties: list[TiePoints]) -> list[Update]:
    """Updates of the images one after the other."""
    prior, found = None, []
    for k, of_image in enumerate(ties):
        options: Any = {"prior": prior, "loss": LeastSquares()}
        found.append(update_orientation(SENSOR, shot(k), of_image, GROUND, model, TieErrors(shift=SHIFT), **options))
        if k + 1 < len(ties):
            prior = propagate_prior(found[k], OCCASIONS[k], OCCASIONS[k + 1])
    return found


@pytest.mark.parametrize(
    "duration",
    [
        pytest.param(1e11, id="the same errors", marks=pytest.mark.slow),
        pytest.param(4.0, id="fading", marks=pytest.mark.slow),
        pytest.param(1e-3, id="new errors", marks=pytest.mark.slow),
    ],
)
def test_one_after_the_other_is_all_at_once(duration):
    model, ties = flown(duration)
    found = in_turn(model, ties)
    for count, result in enumerate(found, start=1):
        assert result.ok
        x, cov = adjusted(model, ties, count)
        last = np.r_[6 * count - 6 : 6 * count, 18:20]
        sigma = np.sqrt(np.diagonal(cov)[last])
        unit = np.outer(sigma, sigma)
        np.testing.assert_allclose(np.append(result.error, result.shift) / sigma, x[last] / sigma, atol=2e-3)
        np.testing.assert_allclose(result.covariance / unit, cov[np.ix_(last, last)] / unit, atol=5e-3)
    if duration > 1e6:
        assert np.trace(found[2].cov_error[:3, :3]) < 0.9 * np.trace(found[0].cov_error[:3, :3])


def test_what_each_sharing_carries_over():
    model, ties = flown(4.0)
    found = in_turn(model, ties[:1])[0]
    never, always = (PerImage(), PerMeasurement()), (PerFlight(), Systematic())
    shares = [*((one, 0.0) for one in never), *((one, 1.0) for one in always), (TimeCorrelated(4.0), np.exp(-0.5))]
    P = np.asarray(found.covariance)
    for sharing, rho in shares:
        part = errors_of.Position.from_ned(north=3.0, east=2.0, down=4.0, sharing=sharing)
        result = eqx.tree_at(lambda one: one.errors, found, ErrorModel((part, model.sources[1])))
        prior = propagate_prior(result, *OCCASIONS[:2])
        np.testing.assert_allclose(prior.mean[:3], rho * found.error[:3], atol=1e-12)
        np.testing.assert_allclose(prior.mean[6:], found.shift, atol=1e-12)
        own = np.diag([9.0, 4.0, 16.0])
        np.testing.assert_allclose(prior.covariance[:3, :3], rho**2 * P[:3, :3] + (1.0 - rho**2) * own, atol=1e-9)
        np.testing.assert_allclose(prior.covariance[:3, 6:], rho * P[:3, 6:], atol=1e-9)
        np.testing.assert_allclose(prior.covariance[6:, 6:], P[6:, 6:], atol=1e-12)
