"""Several fixes: what they share cancels between targets, and keeps looks from helping each other."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, Pose, Shot
from jaxgeo.uncertainty import (
    ErrorModel,
    PerFlight,
    PerImage,
    Propagation,
    TimeCorrelated,
    joint_covariance,
    propagate,
    sources,
)
from jaxgeo.uncertainty.sharing import AbstractSharing, Occasion, PerMeasurement, Systematic

GROUND = ConstantHeight(0.0)
CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=10_000.0, width=2001, height=2001)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.forward())
TARGET = jaxgeo.Geodetic.from_degrees(lat=45.0, lon=7.0, height=0.0)
MIDDLE = (1000.0, 1000.0)
ANGLE = math.radians(0.03)


def shot_from(azimuth_deg: float, *, distance: float = 20_000.0, height: float = 5000.0) -> Shot:
    """From so far to one side of the target, looking at it."""
    east, north = distance * math.sin(math.radians(azimuth_deg)), distance * math.cos(math.radians(azimuth_deg))
    lat = 45.0 + math.degrees(north / 6.367e6)
    lon = 7.0 + math.degrees(east / (6.389e6 * math.cos(math.radians(45.0))))
    camera = jaxgeo.Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    return Shot(Pose.looking_at(position=camera, point=TARGET))


def looked(
    shot: Shot,
    uv: tuple[float, float] = MIDDLE,
    *,
    attitude: Any = 0.0,
    mounting: Any = 0.0,
    position: float = 0.0,
    pixel: float = 0.0,
    height: float = 0.0,
) -> Propagation:
    """Linear propagation of errors in rad, m and px. What is not given is exact: all models share their programs."""
    model = ErrorModel(
        (
            sources.Attitude(np.full(3, attitude)),
            sources.CameraMounting(np.full(3, mounting)),
            sources.Position(np.full(3, position)),
            sources.PixelMeasurement(np.full(2, pixel)),
            sources.TerrainHeight(np.full(1, height)),
        )
    )
    return propagate(SENSOR, shot, uv, GROUND, model)


def sharing_as(fixes: list[Propagation], **sharings: AbstractSharing) -> list[Propagation]:
    """The fixes with other sharings, by the first word of a source's name, which changes nothing in each of them."""
    return [
        dataclasses.replace(
            fix,
            model=ErrorModel(
                tuple(
                    dataclasses.replace(source, sharing=sharings.get(source.label.split()[0], source.sharing))
                    for source in fix.model.sources
                )
            ),
        )
        for fix in fixes
    ]


@pytest.mark.costly
def test_two_targets_in_one_frame_are_far_better_known_against_each_other() -> None:
    pixels = (MIDDLE, (1060.0, 1000.0))
    fixes = [looked(shot_from(90.0), uv, attitude=ANGLE, position=5.0, pixel=0.5) for uv in pixels]
    vector, cov = joint_covariance(fixes, shots=[0, 0]).baseline(0, 1)
    alone = math.sqrt(float(jnp.trace(fixes[0].cov_enu)))
    apart = math.sqrt(float(jnp.trace(cov)))
    assert 100.0 < float(jnp.linalg.norm(vector)) < 200.0
    assert alone > 30.0
    assert apart < 10.0
    _, independent = joint_covariance(fixes).baseline(0, 1)  # as if they came from two shots
    assert float(jnp.trace(independent)) == pytest.approx(2.0 * alone**2, rel=0.05)


def orthogonal_fixes(sharing: AbstractSharing):
    """Two looks at one target at right angles, with errors of 24.4 m along and 6 m across the look."""
    heading, elevation = 6.0 / 19_998.97, 24.4 / 85_604.0  # m over m per rad, as the first test of this holds
    attitude, mounting = np.array([heading, 0.0, 0.0]), np.array([0.0, elevation, 0.0])
    fixes = [looked(shot_from(azimuth), attitude=attitude, mounting=mounting) for azimuth in (0.0, 90.0)]
    return sharing_as(fixes, camera=sharing)


def axes_of(cov) -> np.ndarray:
    return np.sqrt(np.linalg.eigvalsh(np.asarray(cov)[:2, :2]))


@pytest.mark.costly
def test_fusing_two_orthogonal_looks() -> None:
    fixes = orthogonal_fixes(PerImage())
    np.testing.assert_allclose(axes_of(fixes[0].cov_enu), [6.0, 24.4], atol=0.15)
    along = [np.asarray(fix.cov_enu)[:2, :2] for fix in fixes]
    expected = np.linalg.inv(sum(np.linalg.inv(cov) for cov in along))
    _, fused = joint_covariance(fixes).fused()
    np.testing.assert_allclose(axes_of(fused), np.sqrt(np.linalg.eigvalsh(expected)), rtol=1e-3)
    np.testing.assert_allclose(axes_of(fused), 5.83, atol=0.05)


@pytest.mark.costly
@pytest.mark.parametrize("duration, least, most", [(1e-3, 0.0, 0.01), (20.0, 0.1, 0.9), (1e9, 0.99, 1.0)])
def test_what_is_common_in_time_goes_from_nothing_to_all(duration: float, least: float, most: float) -> None:
    """Between looks that share nothing and looks that share their boresight, by how long it keeps."""
    spread = {}
    for name, sharing in {"none": PerImage(), "all": PerFlight(), "some": TimeCorrelated(duration)}.items():
        _, cov = joint_covariance(orthogonal_fixes(sharing), times=[0.0, 10.0]).baseline(0, 1)
        spread[name] = float(jnp.trace(cov))
    share = (spread["some"] - spread["none"]) / (spread["all"] - spread["none"])
    assert least <= share <= most


@pytest.mark.costly
def test_a_common_boresight_keeps_looks_from_helping_each_other() -> None:
    """From one side: independent errors average out, common ones stay, and what fades in time lies between."""

    def fused(sharing: AbstractSharing) -> float:
        fixes = sharing_as([looked(shot_from(30.0), attitude=ANGLE, position=2.0)] * 2, attitude=sharing)
        return float(jnp.trace(joint_covariance(fixes, times=[0.0, 10.0]).fused()[1]))

    apart, some, common = (fused(sharing) for sharing in (PerImage(), TimeCorrelated(10.0), PerFlight()))
    single = float(jnp.trace(looked(shot_from(30.0), attitude=ANGLE).cov_enu))
    assert apart == pytest.approx(0.5 * single, rel=0.1)
    assert common > single  # all of the attitude's, and half of the position's
    assert some == pytest.approx(apart + math.exp(-1.0) * (common - apart), rel=0.05)


@pytest.mark.costly
def test_a_common_boresight_shows_in_orthogonal_looks() -> None:
    """What moves one fix north and the other east shows in their difference: the two fuse better than independent ones,
    to 6 / sqrt(2) m, since north and east then err alike."""
    _, cov = joint_covariance(orthogonal_fixes(PerFlight())).fused()
    np.testing.assert_allclose(np.sqrt(np.diagonal(np.asarray(cov))[:2]), 6.0 / math.sqrt(2.0), atol=0.1)


@pytest.mark.costly
def test_joint_covariance_is_one() -> None:
    fixes = [looked(shot_from(azimuth), attitude=ANGLE, height=3.0) for azimuth in (0.0, 40.0)]
    fixes = sharing_as(fixes, attitude=PerFlight())
    joint = joint_covariance(fixes)
    np.testing.assert_allclose(joint.cov_ecef, joint.cov_ecef.T, atol=1e-9)
    np.testing.assert_allclose(joint.cov_ecef[:3, :3], fixes[0].cov_ecef, atol=1e-9)
    assert np.linalg.eigvalsh(np.asarray(joint.cov_ecef))[0] > -1e-9


@pytest.mark.parametrize(
    "sharing, here, there, expected",
    [
        (PerMeasurement(), (0, 0, 0, 0.0), (1, 0, 0, 0.0), 0.0),
        (PerImage(), (0, 0, 0, 0.0), (1, 0, 0, 0.0), 1.0),
        (PerImage(), (0, 0, 0, 0.0), (1, 1, 0, 0.0), 0.0),
        (PerFlight(), (0, 0, 0, 0.0), (1, 1, 0, 9.0), 1.0),
        (PerFlight(), (0, 0, 0, 0.0), (1, 1, 1, 9.0), 0.0),
        (Systematic(), (0, 0, 0, 0.0), (1, 1, 1, 9.0), 1.0),
        (TimeCorrelated(10.0), (0, 0, 0, 0.0), (1, 1, 0, 10.0), math.exp(-1.0)),
        (TimeCorrelated(10.0, 0.2, 3.0, 0.8), (0, 0, 0, 0.0), (1, 1, 0, 1e9), 0.8 * 0.2),
        (TimeCorrelated(10.0, 0.2, 3.0, 0.8), (0, 0, 0, 5.0), (1, 1, 0, 5.0), 0.8),
        (TimeCorrelated(10.0, 0.2, 3.0, 0.8), (0, 0, 0, 5.0), (1, 0, 0, 5.0), 1.0),
    ],
)
def test_sharing(sharing: AbstractSharing, here: tuple, there: tuple, expected: float) -> None:
    assert float(sharing.correlation(Occasion(*here), Occasion(*there))) == pytest.approx(expected, abs=1e-12)


@pytest.mark.costly
def test_models_that_differ_are_refused() -> None:
    fix = looked(shot_from(0.0), attitude=ANGLE)
    other = dataclasses.replace(fix, model=ErrorModel(fix.model.sources[:3]))
    with pytest.raises(ValueError, match="other error sources"):
        joint_covariance([fix, other])
    with pytest.raises(ValueError, match="an entry for each of the 2 observations"):
        joint_covariance([fix, fix], shots=[0])
    with pytest.raises(ValueError, match="at least one"):
        joint_covariance([])
