"""Error sources and models: what they refuse, how they hang together, and what published tables they hold."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, Gimbal
from jaxgeo.uncertainty import ErrorModel, PerImage, TimeCorrelated, presets, propagate, sources
from jaxgeo.uncertainty.model import checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs
from tests.support import looks

LEVEL = ConstantHeight(120.0)
LOOK = ModelInputs.of(looks.sensor(), looks.shot(), looks.UV, LEVEL)
NAN = math.nan


@pytest.mark.costly
@pytest.mark.parametrize(
    "source, message",
    [
        (sources.Attitude(jnp.deg2rad(jnp.array([0.1, -0.1, 0.3]))), "of pitch must not be negative; got -0.1 deg."),
        (sources.Attitude(jnp.array([0.1, NAN, 0.3])), "must be finite"),
        (sources.Attitude(jnp.array([0.1, math.inf, 0.3])), "must be finite"),
        (sources.Attitude(jnp.array([0.1, 0.2])), "one number for each of heading, pitch, roll"),
        (sources.Attitude(jnp.ones(3), 2.0 * jnp.eye(3)), "ones on its diagonal"),
        (sources.Attitude(jnp.ones(3), 2.0 * jnp.ones((3, 3)) - jnp.eye(3)), "not positive semi-definite"),
        (sources.Attitude(jnp.ones(3), sharing=TimeCorrelated(-1.0)), "duration of TimeCorrelated"),
        (sources.Attitude(jnp.ones(3), sharing=TimeCorrelated(1.0, alpha=2.0)), "alpha of TimeCorrelated"),
        (sources.TimeTag.from_seconds(0.1), "velocity_ned"),
        (sources.Refraction.from_kelvin_and_pascal(temperature=1.0, pressure=1.0), "atmosphere"),
        (sources.GimbalAngles.from_degrees(yaw=1.0, pitch=1.0), "outer, inner"),
        (sources.Distortion.from_coefficients(k9=1.0), "no coefficient k9"),
        (sources.TerrainField.of_variograms(gaussian=[(1.0, 100.0)]), "TerrainField is one of the posts of a Dem"),
    ],
)
def test_what_makes_no_sense_is_refused(source: sources.AbstractSource, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        propagate(looks.sensor(), looks.shot(), looks.UV, LEVEL, ErrorModel((source,)))


@pytest.mark.costly
def test_a_level_gimbal_has_no_boresight_against_the_body() -> None:
    sensor = jaxgeo.Sensor(looks.sensor().camera, Gimbal.three_axis(), jaxgeo.Mount.forward())
    shot = jaxgeo.Shot(looks.pose(), jnp.array([1.5, -0.8, 0.0]))
    with pytest.raises(ValueError, match="CameraMounting"):
        propagate(sensor, shot, looks.UV, LEVEL, (sources.Boresight.from_degrees(heading=1, pitch=1, roll=1),))


@pytest.mark.parametrize(
    "errors, message",
    [
        ("attitude", "must be a jaxgeo ErrorModel or a tuple"),
        ((sources.Attitude,), r"Did you mean Attitude\(...\)"),
        ((3.0,), "no error source known here"),
    ],
)
def test_unknown_sources_are_refused(errors, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        checked_model(errors, LOOK)


def test_no_source_at_all() -> None:
    with pytest.raises(ValueError, match="no source"):
        checked_model((), LOOK)


@pytest.mark.parametrize(
    "covariance, message",
    [
        (np.array([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), "lowest eigenvalue is -1"),
        (np.array([[1.0, 0.5, 0.0], [0.2, 1.0, 0.0], [0.0, 0.0, 1.0]]), r"must be symmetric; entry \(0, 1\)"),
        (np.array([[1.0, NAN], [NAN, 1.0]]), "finite"),
        (np.ones((2, 3)), "square"),
    ],
)
def test_covariances_that_are_none(covariance: np.ndarray, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sources.Position.from_covariance(covariance)


def test_a_covariance_goes_in_and_comes_out() -> None:
    covariance = np.array([[4.0, 1.0, 0.0], [1.0, 9.0, -2.0], [0.0, -2.0, 0.0 + 4.0 / 9.0 + 1.0]])
    source = sources.Position.from_covariance(covariance, sharing=PerImage())
    np.testing.assert_allclose(source.covariance(), covariance, atol=1e-12)
    factor = ErrorModel((source,)).factor()
    np.testing.assert_allclose(factor @ factor.T, covariance, atol=1e-12)


def test_a_singular_covariance_has_a_factor() -> None:
    """Two axes that err alike: one number drives both."""
    covariance = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    factor = ErrorModel((sources.Position.from_covariance(covariance),)).factor()
    np.testing.assert_allclose(factor @ factor.T, covariance, atol=1e-12)


def test_a_block_of_sources_is_one() -> None:
    correlation = np.eye(6) + 0.4 * (np.ones((6, 6)) - np.eye(6))
    block = sources.Correlated.of(
        sources.Attitude.from_degrees(heading=0.1, pitch=0.2, roll=0.3),
        sources.Position.from_ned(north=1.0, east=2.0, down=3.0),
        correlation=correlation,
        sharing=PerImage(),
    )
    covariance = np.asarray(block.covariance())
    np.testing.assert_allclose(np.sqrt(np.diagonal(covariance))[3:], [1.0, 2.0, 3.0])
    assert covariance[0, 5] == pytest.approx(0.4 * math.radians(0.1) * 3.0)
    assert block.axes[0] == "attitude: heading"
    assert len(block.axes) == 6
    with pytest.raises(ValueError, match="no part of a block"):
        sources.Correlated.of(
            sources.TerrainField.of_variograms(gaussian=[(1.0, 9.0)]), correlation=np.eye(33), sharing=PerImage()
        )


@pytest.mark.slow
def test_a_field_over_the_ground_has_its_variograms() -> None:
    dem = looks.dem()
    look = ModelInputs.of(looks.sensor(), looks.shot(), looks.UV, dem)
    aim = look.nominal_fix(jaxgeo.FirstHit())
    field = sources.TerrainField.of_variograms(gaussian=[(2.0, 100.0)], spherical=[(1.0, 300.0)], nodes=9)
    placed = field.at(look, aim)
    covariance = np.asarray(placed.covariance())
    np.testing.assert_allclose(np.diagonal(covariance), 5.0)
    # Nodes are 25 m apart, a quarter of the shortest length.
    share = 50.0 / 300.0
    expected = 4.0 * math.exp(-(0.5**2)) + 1.0 - 1.5 * share + 0.5 * share**3
    assert covariance[4, 6] == pytest.approx(expected, rel=1e-9)
    np.testing.assert_allclose(placed.place[4], aim.p_ecef, atol=1e-9)
    rowcol, _ = dem.over(placed.place[8])
    np.testing.assert_allclose(placed.rowcol + 8.0 * placed.step, rowcol, atol=1e-4)
    factor = ErrorModel((placed,)).factor()
    np.testing.assert_allclose(factor @ factor.T, covariance, atol=1e-9)


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({}, "needs variograms"),
        ({"gaussian": [(1.0, -5.0)]}, "positive"),
        ({"gaussian": [(1.0, 5.0)], "nodes": 8}, "odd number"),
        ({"spherical": [(1.0,)]}, "needs variograms"),
    ],
)
def test_fields_that_are_none(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sources.TerrainField.of_variograms(**arguments)


def test_published_tables() -> None:
    li = presets.li_2023(terrain_height=20.0)
    degrees = np.rad2deg(np.concatenate([source.sigma for source in li.sources[:4]]))
    np.testing.assert_allclose(degrees, [0.05, 0.02, 0.02, 0.02, 0.02, 0.03, 0.01, 0.01, 0.01, 0.01])
    assert li.axes[-1] == "terrain height: height"
    assert li.size == 11
    post = presets.pos_av_310("RTX post-processed")
    np.testing.assert_allclose(np.rad2deg(post.sources[2].sigma), [0.035, 0.015, 0.015])
    np.testing.assert_allclose(post.sources[0].sigma, [0.1, 0.1, 0.2])
    assert {presets.pos_av_310(name).size for name in presets.POS_AV_310} == {9}
    with pytest.raises(ValueError, match="must be one of SPS, RTX"):
        presets.pos_av_310("GPS")


@pytest.mark.parametrize("pitch", [-90.0, -89.0, -60.0, -30.0])
def test_a_level_gimbal_errs_across_the_flight_too(pitch: float) -> None:
    """Against finite differences of yaw, roll, pitch as the arms of such a gimbal are joined; straight down too."""
    gimbal, sigma = Gimbal.three_axis(), np.deg2rad([1.0, 0.5, 0.7])
    sensor = jaxgeo.Sensor(looks.sensor().camera, gimbal, jaxgeo.Mount.forward())
    height, yaw = 100.0, 0.6
    pose = jaxgeo.Pose.from_degrees(lat=45.0, lon=7.0, height=height)
    shot = jaxgeo.Shot(pose, gimbal.readings_from_degrees(yaw=math.degrees(yaw), pitch=pitch, roll=0.0))
    model = ErrorModel((sources.GimbalAngles(jnp.asarray(sigma), gimbal_axes=gimbal.names),))
    found = propagate(sensor, shot, sensor.camera.principal_px, ConstantHeight(0.0), model)

    def place(error: np.ndarray) -> np.ndarray:
        """(east, north) in m of the optical axis on level ground."""
        turns = zip("zxy", (yaw + error[0], error[2], math.radians(pitch) + error[1]), strict=True)
        north, east, down = np.linalg.multi_dot([turn(axis, angle) for axis, angle in turns])[:, 0]
        return height * np.array([east, north]) / down

    step = 1e-5
    by_error = np.stack([(place(step * e) - place(-step * e)) / (2.0 * step) for e in np.eye(3)], axis=1)
    expected = by_error @ np.diag(sigma**2) @ by_error.T
    np.testing.assert_allclose(np.asarray(found.cov_enu)[:2, :2], expected, atol=1e-3 * np.trace(expected))


def turn(axis: str, angle: float) -> np.ndarray:
    """Rotation matrix about an axis by an angle in rad."""
    k = "xyz".index(axis)
    i, j = (k + 1) % 3, (k + 2) % 3
    R = np.eye(3)
    R[[i, j], [i, j]], R[i, j], R[j, i] = math.cos(angle), -math.sin(angle), math.sin(angle)
    return R
