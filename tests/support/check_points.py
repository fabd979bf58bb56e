"""Check points made up through the exact forward model: flights over hills whose true errors are drawn."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo import (
    ConstantHeight,
    Dem,
    ErrorModel,
    Exposure,
    FrameCamera,
    Geodetic,
    Gimbal,
    Mount,
    Observation,
    Pose,
    Sensor,
    Shot,
)
from jaxgeo._intersection import FIRST_HIT
from jaxgeo.earth import WGS84, R_ecef_from_enu
from jaxgeo.terrain import TangentGrid
from jaxgeo.uncertainty import CheckPoints, PerFlight, PerImage, Systematic, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs

LAT, LON = 47.0, 11.0
SIGMA_PX, SIGMA_SURVEY = 0.5, (0.03, 0.03, 0.05)
LEVEL = ConstantHeight(600.0)


def hills(posts: int = 65, spacing: float = 60.0) -> Dem:
    """Smooth hills of 100 m relief about 600 m."""
    place = spacing * (np.arange(posts) - posts // 2)
    x, y = np.meshgrid(place, place)
    height = 600.0 + 50.0 * np.sin(x / 700.0) * np.cos(y / 900.0)
    centre = Geodetic.from_degrees(lat=LAT, lon=LON, height=0.0)
    grid = TangentGrid.centred(centre, spacing=(spacing, spacing), shape=height.shape)
    return Dem.from_array(height, grid)


def sensor() -> Sensor:
    """A nadir frame camera, 8 cm of ground in a pixel from 800 m."""
    camera = FrameCamera.from_pixels(focal_px=10_000.0, width=8000, height=6000)
    return Sensor(camera, Gimbal.fixed(), Mount.nadir())


def true_errors(scale: float = 1.0) -> ErrorModel:
    """Attitude and position of each image, boresight of each flight."""
    return ErrorModel(
        (
            sources.Attitude.from_degrees(heading=0.03 * scale, pitch=0.01 * scale, roll=0.01 * scale),
            sources.Position.from_ned(north=0.15 * scale, east=0.15 * scale, down=0.25 * scale),
            sources.Boresight.from_degrees(heading=0.06 * scale, pitch=0.03 * scale, roll=0.03 * scale),
        )
    )


def block(flights: int = 3, images: int = 8, pixels: int = 3, seed: int = 0) -> tuple[Observation, Any, Any]:
    """(pixels of images of flights in several directions, image and flight of each)."""
    random = np.random.default_rng(seed)
    number = flights * images
    flight, image = np.repeat(np.arange(flights), images), np.arange(number)
    heading = 360.0 / max(flights, 1) * flight + 180.0 * (image % 2) + random.uniform(-8.0, 8.0, number)
    east, north = random.uniform(-700.0, 700.0, (2, number))
    position = Geodetic.from_degrees(
        lat=LAT + north / 111_000.0, lon=LON + east / 76_000.0, height=1400.0 + random.uniform(-60.0, 60.0, number)
    )
    pitch, roll = np.deg2rad(random.uniform(-6.0, 6.0, (2, number)))
    pose = Pose(position, np.deg2rad(heading), pitch, roll)
    shots = Shot(pose, np.zeros((number, 0)), np.asarray(image, float))
    row = np.repeat(image, pixels)
    uv = random.uniform(0.08, 0.92, (len(row), 2)) * np.array([7999.0, 5999.0])
    many = jax.tree.map(lambda x: np.asarray(x)[row], shots)
    return Observation(Exposure(sensor(), many), uv), row, flight[row]


def drawn(model: ErrorModel, image: np.ndarray, flight: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Errors (n, axes) of pixels, shared as the sources say."""
    parts = []
    for source in model.sources:
        group = {PerImage: image, PerFlight: flight, Systematic: np.zeros_like(image)}
        member = group.get(type(source.sharing), np.arange(len(image)))
        each = np.asarray(source.sigma) * random.standard_normal((int(member.max()) + 1, len(source.axes)))
        parts.append(each[member])
    return np.concatenate(parts, axis=1)


@eqx.filter_jit
def _moved(model: ErrorModel, inputs: ModelInputs, error: Any) -> ModelInputs:
    return model.moved(inputs, error)


def _true_places(observation: Observation, errors: np.ndarray, terrain: Any, model: ErrorModel) -> np.ndarray:
    """Places (n, 3) in ECEF m that pixels see whose images err, by the program that `propagate` locates with."""
    exposure = observation.exposure
    places = []
    for number, error in enumerate(errors):
        shot, uv = jax.tree.map(lambda x, k=number: np.asarray(x)[k], (exposure.motion, observation.uv))
        given = ModelInputs.of_checked(exposure.sensor, shot, jnp.asarray(0.0), jnp.asarray(uv), terrain, None)
        places.append(np.asarray(_moved(model, given, error).nominal_fix(FIRST_HIT).p_ecef))
    return np.stack(places)


def simulated(
    model: ErrorModel, seed: int, terrain: Any, made: tuple[Observation, Any, Any] | None = None, **options: Any
) -> CheckPoints:
    """Check points whose images err as `model` states, with errors of the pixels and of the survey."""
    observation, image, flight = block() if made is None else made
    random = np.random.default_rng(seed)
    pixel = sources.PixelMeasurement.from_pixels(column=SIGMA_PX, row=SIGMA_PX)
    errors = drawn(ErrorModel((*model.sources, pixel)), image, flight, random)
    unit = ErrorModel(tuple(eqx.tree_at(lambda s: s.sigma, one, jnp.ones(len(one.axes))) for one in model.sources))
    unit = ErrorModel((*unit.sources, pixel))
    p_ecef = _true_places(observation, errors, terrain, unit)
    R = np.asarray(R_ecef_from_enu(Geodetic.from_degrees(lat=LAT, lon=LON, height=0.0)))
    p_ecef = p_ecef + (np.array(SIGMA_SURVEY) * random.standard_normal((len(image), 3))) @ R.T
    position = jax.tree.map(np.asarray, _to_geodetic(p_ecef))
    given = {"sigma_enu": SIGMA_SURVEY, "sigma_px": SIGMA_PX, "images": image, "flights": flight}
    return CheckPoints(observation, position, **(given | options))


@jax.jit
def _to_geodetic(p_ecef: Any) -> Geodetic:
    return jax.vmap(WGS84.to_geodetic)(p_ecef)
