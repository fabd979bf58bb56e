"""Boresights and lever arms, in one step and in two; and calibrations as sources of error of later fixes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import ConstantHeight, Gimbal, Sensor, propagate
from jaxgeo.adjust import (
    Adjustment,
    Block,
    Fixed,
    Free,
    Prior,
    Unknowns,
    adjust,
    calibration,
    two_step_boresight,
)
from jaxgeo.earth import WGS84
from jaxgeo.rotations import R_from_rotation_vector, rotation_vector_from_R
from jaxgeo.uncertainty import ErrorModel
from tests.support.simulated_block import Simulated, camera, simulated, small_turn, tight

pytestmark = pytest.mark.costly

ASTRAY = small_turn(0.003, -0.002, 0.006)


def astray(of: Simulated) -> Sensor:
    """The sensor with a boresight that is not yet known."""
    name = part(of.sensor)
    turned = ASTRAY @ np.asarray(getattr(of.sensor.mount, name))
    return eqx.tree_at(lambda s: getattr(s.mount, name), of.sensor, turned)


def part(sensor: Sensor) -> str:
    return "R_head_from_camera" if sensor.gimbal.reference == "level" else "R_body_from_base"


def loosened(block: Block) -> Block:
    """A block whose navigation says where to start and no more."""
    return replace(block, navigation=block.navigation.loosened(1000.0))


def two_steps(of: Simulated, **options: Any) -> Any:
    block = of.block(sensor=astray(of), control=of.control(0.02, tuple(of.points.name[::3])))
    return two_step_boresight(adjust(loosened(block)), navigation=block.navigation, **options)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fixed", "two_axis", "drone"])
def test_two_steps_find_a_boresight_from_exact_measurements(kind: str) -> None:
    truth = simulated(kind)
    found = two_steps(truth)
    np.testing.assert_allclose(R_from_rotation_vector(jnp.asarray(found.turn)), ASTRAY.T, rtol=0.0, atol=1e-8)
    name = part(truth.sensor)
    np.testing.assert_allclose(getattr(found.mount, name), getattr(truth.sensor.mount, name), rtol=0.0, atol=1e-8)
    np.testing.assert_array_equal(found.lever, truth.sensor.mount.lever_body)
    np.testing.assert_array_equal(found.covariance[3:], 0.0)
    assert found.sigma0 < 1e-4


@pytest.mark.slow
def test_two_steps_find_a_lever_arm_too() -> None:
    truth = simulated()
    off = eqx.tree_at(lambda s: s.mount.lever_body, astray(truth), np.asarray(truth.sensor.mount.lever_body) + 0.3)
    block = truth.block(sensor=off, control=truth.control(0.02, tuple(truth.points.name[::3])))
    found = two_step_boresight(adjust(loosened(block)), lever=True, navigation=block.navigation)
    np.testing.assert_allclose(found.lever, truth.sensor.mount.lever_body, rtol=0.0, atol=1e-4)  # m
    np.testing.assert_allclose(found.mount.lever_body, found.lever)
    np.testing.assert_allclose(found.mount.R_body_from_base, truth.sensor.mount.R_body_from_base, rtol=0.0, atol=1e-7)
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0.0)


@pytest.mark.slow
def test_one_step_and_two_agree() -> None:
    of = simulated().noisy(12)
    block = of.block(sensor=astray(of), control=of.control(0.02, tuple(of.points.name[::3])))
    two = two_step_boresight(adjust(loosened(block)), navigation=block.navigation)
    one = adjust(block, Unknowns(boresight=Free()))
    at = [one.columns.index(("mount camera", f"boresight {axis}")) for axis in "xyz"]
    covariance = one.covariance[np.ix_(at, at)]
    between = np.asarray(one.mounts["camera"].R_body_from_base) @ np.asarray(two.mount.R_body_from_base).T
    apart = np.asarray(rotation_vector_from_R(jnp.asarray(between)))
    assert np.all(np.abs(apart) < np.sqrt(np.diagonal(covariance)))
    # What one step gains, the navigation's share in the orientations, is little beside so much control.
    ratio = np.diagonal(two.covariance)[:3] / np.diagonal(covariance)
    assert np.all((ratio > 0.99) & (ratio < 2.0))
    off = np.asarray(rotation_vector_from_R(jnp.asarray(ASTRAY @ small_turn(*two.turn))))
    assert off @ np.linalg.solve(two.covariance[:3, :3], off) < 16.3  # chi-square of 3, 0.999


@pytest.mark.slow
def test_covariance_of_two_steps_is_that_of_many_draws() -> None:
    draws, off, sigma0 = 100, [], []
    for seed in range(draws):
        found = two_steps(simulated().noisy(500 + seed))
        off.append(np.asarray(rotation_vector_from_R(jnp.asarray(ASTRAY @ small_turn(*found.turn)))))
        sigma0.append(found.sigma0)
    whitened = np.linalg.solve(np.linalg.cholesky(found.covariance[:3, :3]), np.array(off).T)
    np.testing.assert_allclose(whitened @ whitened.T / draws, np.eye(3), atol=5.0 * np.sqrt(2.0 / draws))
    assert np.sqrt(np.mean(np.square(sigma0))) == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_two_steps_refuse_what_cannot_be() -> None:
    of = simulated()
    block = of.block()
    found = adjust(loosened(block))
    with pytest.raises(ValueError, match="there is no mount 'other'; there are camera"):
        two_step_boresight(found, "other")
    with pytest.raises(ValueError, match="no navigation to compare"):
        two_step_boresight(adjust(replace(of.block(control=of.control(0.02, tuple(of.points.name))), navigation=None)))


@pytest.mark.slow
def test_two_steps_refuse_navigation_that_says_nothing() -> None:
    of = simulated()
    block = of.block()
    silent = of.block(sigma_position=np.inf, sigma_attitude=np.inf).navigation
    with pytest.raises(ValueError, match="does not tell the boresight"):
        two_step_boresight(adjust(loosened(block)), navigation=silent)
    without = of.block(sigma_position=np.inf).navigation
    with pytest.raises(ValueError, match="does not tell the boresight and the lever arm"):
        two_step_boresight(adjust(loosened(block)), navigation=without, lever=True)


# Calibrations


KNOWN = tight(
    focal=Free(),
    principal=Prior(5.0),
    distortion={"k1": Prior(1e-3), "p1": Prior(1e-4)},
    boresight=Free(),
    lever=Prior([0.1, 0.2, 0.3]),
)
GROUND = ConstantHeight(20.0)


@pytest.fixture(scope="module", params=["fixed", pytest.param("drone", marks=pytest.mark.slow)])
def found(request: pytest.FixtureRequest) -> tuple[Simulated, Adjustment]:
    """A calibrated block on a mount of its own, and on a drone's gimbal."""
    of = simulated(request.param).noisy(21)
    return of, adjust(of.block(sensor=astray(of)), KNOWN)


def test_a_calibration_is_the_sensor_as_it_was_found(found: tuple[Simulated, Adjustment]) -> None:
    of, adjustment = found
    result = calibration(adjustment, of.sensor)
    assert result.sensor.gimbal.axes == of.sensor.gimbal.axes
    np.testing.assert_array_equal(result.sensor.camera.focal_px, adjustment.cameras["camera"].focal_px)
    name = part(of.sensor)
    np.testing.assert_array_equal(getattr(result.sensor.mount, name), getattr(adjustment.mounts["camera"], name))
    turns = ("camera mounting: forward", "camera mounting: right", "camera mounting: down")
    if of.sensor.gimbal.reference == "body":
        turns = ("boresight: heading", "boresight: pitch", "boresight: roll")
    interior = ("focal length", "principal column", "principal row")
    assert result.source.axes == (
        *(f"interior orientation: {name}" for name in interior),
        *turns,
        *(f"lever arm: {axis}" for axis in ("forward", "right", "down")),
        "distortion: k1",
        "distortion: p1",
    )


@pytest.mark.slow
def test_a_later_fix_is_as_sure_as_the_adjustment_says(found: tuple[Simulated, Adjustment]) -> None:
    """The propagation through the source against that of the adjustment's own covariance through its own parameters."""
    of, adjustment = found
    result = calibration(adjustment, of.sensor, scaled=False)
    shot, uv = jax.tree.map(lambda x: np.asarray(x)[7], of.shots), np.array([300.0, 2700.0])
    later = propagate(result.sensor, shot, uv, GROUND, (result.source,))
    names = [p.name for p in adjustment.parameters]
    at = [adjustment.columns.index((p.whose, p.name)) for p in adjustment.parameters]
    covariance = adjustment.covariance[np.ix_(at, at)]
    turned = part(of.sensor)

    def place(change: Any) -> Any:
        by = dict(zip(names, change, strict=True))
        get = lambda name: by.get(name, jnp.zeros(()))  # noqa: E731
        sensor, lens = result.sensor, result.sensor.camera.distortion
        focal = jnp.asarray(sensor.camera.focal_px) + get("focal")
        principal = jnp.asarray(sensor.camera.principal_px) + jnp.stack([get("principal column"), get("principal row")])
        bent = lens.with_coefficients(lens.coefficients() + jnp.stack([get(name) for name in lens.names]))
        R = R_from_rotation_vector(jnp.stack([get(f"boresight {axis}") for axis in "xyz"]))
        mount = eqx.tree_at(
            lambda m: (getattr(m, turned), m.lever_body),
            sensor.mount,
            (
                R @ jnp.asarray(getattr(sensor.mount, turned)),
                jnp.asarray(sensor.mount.lever_body) + jnp.stack([get(f"lever arm {axis}") for axis in "xyz"]),
            ),
        )
        lensed = eqx.tree_at(
            lambda c: (c.focal_px, c.principal_px, c.distortion), sensor.camera, (focal, principal, bent)
        )
        origin, direction, _ = Sensor(lensed, sensor.gimbal, mount).ray_ecef(shot, uv)
        p = jax.lax.stop_gradient(on_ground(origin, direction))
        up = up_at(p)
        # The ground is level there, to first order: where the line of sight meets that plane.
        return origin + direction * (up @ (p - origin)) / (up @ direction)

    J = np.asarray(jax.jacfwd(place)(jnp.zeros(len(names))))
    expected = J @ covariance @ J.T
    np.testing.assert_allclose(later.cov_ecef, expected, rtol=0.0, atol=1e-5 * np.abs(expected).max())


def on_ground(origin: Any, direction: Any) -> Any:
    """Where a ray meets the height of `GROUND`, by Newton's method."""
    distance = jnp.asarray(700.0)
    for _ in range(8):
        p = origin + distance * direction
        off = WGS84.to_geodetic(p).height - 20.0
        distance = distance - off / (up_at(p) @ direction)
    return origin + distance * direction


def up_at(p: Any) -> Any:
    position = WGS84.to_geodetic(p)
    return jnp.stack(
        [
            jnp.cos(position.lat) * jnp.cos(position.lon),
            jnp.cos(position.lat) * jnp.sin(position.lon),
            jnp.sin(position.lat),
        ]
    )


def test_scaled_is_times_sigma0(found: tuple[Simulated, Adjustment]) -> None:
    of, adjustment = found
    scaled, plain = (calibration(adjustment, of.sensor, scaled=s).source for s in (True, False))
    np.testing.assert_allclose(scaled.sigma, np.asarray(plain.sigma) * adjustment.sigma0, rtol=1e-12)
    assert isinstance(ErrorModel((scaled,)), ErrorModel)


@pytest.mark.slow
def test_a_calibration_of_nothing_has_no_source() -> None:
    of = simulated()
    result = calibration(adjust(of.block()), of.sensor)
    assert result.source is None
    np.testing.assert_array_equal(result.sensor.camera.focal_px, of.sensor.camera.focal_px)


def test_calibrations_refuse_what_error_models_do_not_know(found: tuple[Simulated, Adjustment]) -> None:
    of, adjustment = found
    with pytest.raises(ValueError, match="camera='other': say which camera; there are camera"):
        calibration(adjustment, of.sensor, camera="other")
    other = Sensor(camera(), Gimbal.fixed() if of.sensor.gimbal.reference == "level" else Gimbal.three_axis())
    with pytest.raises(ValueError, match="reports in"):
        calibration(adjustment, other)


@pytest.mark.slow
def test_calibrations_refuse_an_aspect() -> None:
    of = simulated()
    with pytest.raises(ValueError, match="adjust with aspect=Fixed"):
        calibration(adjust(of.block(), replace(KNOWN, aspect=Prior(1e-3), lever=Fixed())), of.sensor)
