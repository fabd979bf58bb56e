"""Forward-model inputs over a small terrain with every kind of error, shared so that they are compiled once."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo import (
    Atmosphere,
    BrownConrady,
    ConstantHeight,
    FrameCamera,
    Gimbal,
    Mount,
    Pose,
    Sensor,
    Shot,
    Trajectory,
)
from jaxgeo.sensor import boresight_from_degrees
from jaxgeo.uncertainty import ErrorModel, PerImage, TimeCorrelated, sources
from tests.support.scenes import rough, small_dem

UV = (700.0, 420.0)
VELOCITY = (55.0, -20.0, 1.5)
BODY_RATES = (0.02, -0.03, 0.05)
GIMBAL_RATES = (0.04, -0.02)


def sensor() -> Sensor:
    """A frame camera with some distortion on a two-axis gimbal, with boresight and lever arms."""
    lens = BrownConrady(k1=-0.05, k2=0.01, p1=1e-4, p2=-2e-4)
    camera = FrameCamera.from_pixels(focal_px=9000.0, width=1600, height=1200, distortion=lens)
    mount = Mount.nadir(
        R_body_from_base=boresight_from_degrees(heading=0.4, pitch=-0.3, roll=0.2),
        lever_body=np.array([0.8, -0.2, 0.4]),
        lever_head=np.array([0.05, 0.0, 0.1]),
    )
    return Sensor(camera, Gimbal.two_axis(), mount)


def pose() -> Pose:
    """A pose west of the terrain of `tests.support.scenes`, 1.2 km above it, heading north and slightly tilted."""
    return Pose.from_degrees(lat=47.0, lon=10.986, height=1300.0, heading=3.0, pitch=1.5, roll=-1.0)


def shot() -> Shot:
    """A shot looking down to the right, at the centre of the terrain."""
    return Shot(pose(), jnp.deg2rad(jnp.array([40.0, 2.0])))


def trajectory() -> Trajectory:
    """The shot as a trajectory."""
    return Trajectory.steady(shot(), velocity_ned=VELOCITY, body_rates=BODY_RATES, gimbal_rates=GIMBAL_RATES)


def dem():
    """Rough ground of 17 x 17 posts."""
    return small_dem(rough(seed=5))


AIR = Atmosphere()


def all_sources() -> ErrorModel:
    """An error model with one source of each class."""
    return ErrorModel(
        (
            sources.Attitude.from_degrees(heading=0.05, pitch=0.02, roll=0.03),
            sources.Position.from_ned(north=1.0, east=1.5, down=2.0),
            sources.Position.from_covariance(
                np.array([[4.0, 1.0, 0.5], [1.0, 3.0, -0.4], [0.5, -0.4, 2.0]]), frame="ecef"
            ),
            sources.Velocity.from_ned(north=0.1, east=0.1, down=0.2, latency=0.5),
            sources.TimeTag.from_seconds(0.01, velocity_ned=VELOCITY, body_rates=BODY_RATES, gimbal_rates=GIMBAL_RATES),
            sources.GimbalAngles.from_degrees(outer=0.02, inner=0.03),
            sources.GimbalMounting.from_degrees(outer=0.01, inner=0.02),
            sources.Boresight.from_degrees(heading=0.03, pitch=0.01, roll=0.02),
            sources.CameraMounting.from_degrees(forward=0.01, right=0.02, down=0.03),
            sources.LeverArm.from_metres(forward=0.1, right=0.2, down=0.3),
            sources.PixelMeasurement.from_pixels(column=0.7, row=1.1),
            sources.InteriorOrientation.from_pixels(focal=4.0, principal_column=1.0, principal_row=2.0),
            sources.Distortion.from_coefficients(k1=1e-3, p2=1e-4),
            sources.TerrainHeight.from_metres(3.0),
            sources.Geoid.from_metres(0.5, platform=True),
            sources.TerrainField.of_variograms(gaussian=[(1.0, 150.0)], spherical=[(2.0, 400.0)], nodes=9),
            sources.Refraction.from_kelvin_and_pascal(temperature=10.0, pressure=500.0),
            sources.Correlated.of(
                sources.Attitude.from_degrees(heading=0.01, pitch=0.01, roll=0.01),
                sources.Position.from_ned(north=0.5, east=0.5, down=0.5),
                correlation=np.eye(6) + 0.3 * (np.ones((6, 6)) - np.eye(6)),
                sharing=TimeCorrelated(60.0),
            ),
        )
    )


def few_sources() -> ErrorModel:
    """The error sources of a simple study."""
    return ErrorModel(
        (
            sources.Attitude.from_degrees(heading=0.05, pitch=0.02, roll=0.03),
            sources.Position.from_ned(north=1.0, east=1.5, down=2.0),
            sources.TerrainHeight.from_metres(3.0),
            sources.PixelMeasurement.from_pixels(column=0.7, row=1.1),
        )
    )


def steps(model: ErrorModel) -> jax.Array:
    """Steps for central differences along every axis of the error vector, by its unit."""
    sizes = {"rad": 1e-6, "m": 1e-3, "m/s": 1e-3, "s": 1e-5, "px": 1e-3, "1": 1e-5, "K and Pa": 1e-1}
    parts = [part for source in model.sources for part in getattr(source, "parts", (source,))]
    return jnp.concatenate([jnp.full(len(part.axes), sizes[part.unit]) for part in parts])


# Level ground with a block of correlated sources, for budgets and their use.
LEVEL_UV, LEVEL = (1200.0, 1600.0), ConstantHeight(100.0)


def level_sensor() -> Sensor:
    """A plain camera on a two-axis gimbal."""
    camera = FrameCamera.from_pixels(focal_px=10_000.0, width=2400, height=3200)
    return Sensor(camera, Gimbal.two_axis(), Mount.nadir())


def level_shot(outer: float = 60.0) -> Shot:
    """A shot from 3 km above the level ground, `outer` deg off nadir."""
    pose = Pose.from_degrees(lat=47.0, lon=11.0, height=3100.0, heading=160.0, pitch=3.0)
    return Shot(pose, level_sensor().gimbal.readings_from_degrees(outer=outer, inner=5.0))


def level_errors(scale: float = 1.0) -> ErrorModel:
    """Independent angles and height, and a correlated block of position and pixel, `scale` times as large."""
    place = sources.Position.from_ned(north=scale, east=2.0 * scale, down=3.0 * scale)
    pixel = sources.PixelMeasurement.from_pixels(column=4.0 * scale, row=2.0 * scale)
    correlation = 0.6 * jnp.eye(5) + 0.4
    return ErrorModel(
        (
            sources.Attitude.from_degrees(heading=0.05 * scale, pitch=0.02 * scale, roll=0.03 * scale),
            sources.GimbalAngles.from_degrees(outer=0.02 * scale, inner=0.01 * scale),
            sources.Correlated.of(place, pixel, correlation=correlation, sharing=PerImage()),
            sources.TerrainHeight.from_metres(5.0 * scale),
        )
    )


def stacked(*items: Any) -> Any:
    """Records of one class as one, with a leading axis; NumPy does it, so that nothing is compiled."""
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(leaf, np.float64) for leaf in leaves]), *items)
