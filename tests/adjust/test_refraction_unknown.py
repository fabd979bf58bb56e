"""Refraction in adjusted blocks: against rays traced through shells of air, a classical formula, and as an unknown."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy

from jaxgeo import Atmosphere, FrameCamera, Geodetic, Mount, Pose, Sensor, Shot
from jaxgeo.adjust import (
    Block,
    Cartesian,
    Free,
    GroundPoints,
    ImagePoints,
    Images,
    LocalFrame,
    Prior,
    Unknowns,
    adjust,
    without_blunders,
)
from jaxgeo.adjust.navigation import sights_of
from jaxgeo.adjust.problem import prepared
from jaxgeo.earth import WGS84
from jaxgeo.earth.refraction import traced_arc
from tests.support.simulated_block import simulated

AIR, NONE = Atmosphere(), Atmosphere(refractivity=0.0)
HEIGHT, FOCAL, WIDTH, SIDE = 8000.0, 12_000.0, 12_000, 9000  # m, px
SIGMA_UV, SIGMA_POSITION, SIGMA_ATTITUDE, SIGMA_CONTROL = 0.2, 0.1, np.deg2rad(0.005), 0.03
HELD = Unknowns(refraction=Prior(1e-9))  # the same program as an unknown one
SEEDS = 12
RADIUS = 6_380_000.0  # m, of the Earth at the block


@dataclass(frozen=True)
class High:
    """Three strips of four images at 8 km, with 60 % overlap, and where they see points through the air."""

    frame: LocalFrame
    sensor: Sensor
    shots: Shot
    centre: np.ndarray
    points: np.ndarray
    image: np.ndarray
    point: np.ndarray
    uv: np.ndarray

    def block(self, seed: int | None = None, **changes: Any) -> Block:
        """With noise of the standard deviations in pixels, navigation and control, if there is a seed."""
        rng = np.random.default_rng(seed)
        times = 0.0 if seed is None else 1.0
        shots = self.shots
        place = self.centre + times * rng.normal(0.0, SIGMA_POSITION, self.centre.shape)
        none = np.zeros(12)
        angles = times * rng.normal(0.0, SIGMA_ATTITUDE, (3, 12)) + np.stack([shots.pose.heading, none, none])
        shots = Shot(Pose(self.frame.to_geodetic(place), *angles), shots.gimbal_readings, shots.time)
        uv = self.uv + times * rng.normal(0.0, SIGMA_UV, self.uv.shape)
        seen = [f"p{k}" for k in range(0, len(self.points), 9)]
        given = self.points[::9] + times * rng.normal(0.0, SIGMA_CONTROL, (len(seen), 3))
        names = np.array([f"i{k}" for k in range(12)])
        labels = np.array([f"p{k}" for k in range(len(self.points))])
        measured = ImagePoints(names[self.image], labels[self.point], uv, SIGMA_UV)
        control = GroundPoints(seen, given, SIGMA_CONTROL)
        given = {"sigma_position": SIGMA_POSITION, "sigma_attitude": SIGMA_ATTITUDE, "control": control} | changes
        return Block.from_shots(self.sensor, names, shots, measured, frame=self.frame, **given)


def straight_pixels(sensor: Sensor, centre: np.ndarray, R: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Pixels (k, 2) of points along straight lines."""
    d = np.einsum("kji,kj->ki", R, points - centre)
    return np.asarray(sensor.camera.principal_px) + FOCAL * d[:, :2] / d[:, 2:]


@jax.jit
def _traced(height: Any, ground: Any, zenith: Any, air: Atmosphere) -> Any:
    def one(given: Any) -> Any:
        return traced_arc(air, height=given[0], ground=given[1], zenith=given[2], radius=RADIUS)

    return jax.lax.map(one, (height, ground, zenith), batch_size=8)


def bent_by_shells(frame: LocalFrame, centre: np.ndarray, points: np.ndarray, air: Atmosphere) -> np.ndarray:
    """Directions (k, 3) in which points are seen, frame axes: the angle off nadir whose traced ray meets the point."""
    c, p = np.asarray(frame.to_ecef(centre)), np.asarray(frame.to_ecef(points))
    geodetic = jax.vmap(WGS84.to_geodetic)(jnp.asarray(c)), jax.vmap(WGS84.to_geodetic)(jnp.asarray(p))
    height, ground = (np.asarray(x.height) for x in geodetic)
    lat, lon = np.asarray(geodetic[0].lat), np.asarray(geodetic[0].lon)
    up = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], axis=1)
    line = (p - c) / np.linalg.norm(p - c, axis=1, keepdims=True)
    straight = np.arccos(-np.sum(line * up, axis=1))
    goal, zenith = np.asarray(_traced(height, ground, straight, NONE)), straight
    for _ in range(3):  # the arc by the angle as without air
        slope = (height - ground) / np.cos(zenith) ** 2
        zenith = zenith - (np.asarray(_traced(height, ground, zenith, air)) - goal) / slope
    out = line + np.cos(straight)[:, None] * up
    out = out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)
    return (np.sin(zenith)[:, None] * out - np.cos(zenith)[:, None] * up) @ np.asarray(frame.R_ecef_from_local)


@cache
def high() -> High:
    """The block, its pixels by traced rays."""
    rng = np.random.default_rng(8)
    frame = LocalFrame(Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0))
    along = np.arange(4) * 2400.0 - 3600.0
    rows = [np.stack([np.full(4, -2000.0), along, np.full(4, HEIGHT)], 1)]
    rows += [np.stack([np.full(4, 2000.0), -along, np.full(4, HEIGHT + 200.0)], 1)]
    rows += [np.stack([along, np.zeros(4), np.full(4, HEIGHT - 700.0)], 1)]
    centre = np.concatenate(rows) + rng.normal(0.0, 50.0, (12, 3))
    heading = np.deg2rad(np.repeat([0.0, 180.0, 90.0], 4))
    pose = Pose(frame.to_geodetic(centre), heading, np.zeros(12), np.zeros(12))
    shots = Shot(pose, np.zeros((12, 0)), np.arange(12.0))
    camera = FrameCamera.from_pixels(focal_px=FOCAL, width=WIDTH, height=SIDE)
    sensor = Sensor(camera, mount=Mount.nadir())
    centre, R = sights_of(frame, sensor, shots)
    points = np.concatenate([rng.uniform(-6000.0, 6000.0, (90, 2)), rng.uniform(0.0, 1500.0, (90, 1))], axis=1)
    image, point = (x.ravel() for x in np.meshgrid(np.arange(12), np.arange(90), indexing="ij"))
    uv = straight_pixels(sensor, centre[image], R[image], points[point])
    inside = np.all((uv > 20.0) & (uv < np.array([WIDTH, SIDE]) - 20.0), axis=1)
    often = np.bincount(point[inside], minlength=90) >= 3
    number = np.cumsum(often) - 1
    kept = inside & often[point]
    image, point, points = image[kept], number[point[kept]], points[often]
    direction = bent_by_shells(frame, centre[image], points[point], AIR)
    uv = straight_pixels(sensor, centre[image], R[image], centre[image] + direction)
    return High(frame, sensor, shots, centre, points, image, point, uv)


@pytest.mark.costly
def test_known_refraction_is_that_of_traced_rays() -> None:
    """Exact pixels of traced rays leave residuals of a hundredth of a pixel; without air, of more than a pixel."""
    of = high()
    ready = prepared(of.block(atmosphere=AIR), Unknowns())
    effects = ready.problem.effects
    bending = np.asarray(effects.bending).T[ready.order.place]
    R = of.block().images.R_frame_from_camera[of.image]
    corrected = straight_pixels(of.sensor, of.centre[of.image], R, of.points[of.point] + bending)
    plain = straight_pixels(of.sensor, of.centre[of.image], R, of.points[of.point])
    assert np.max(np.abs(of.uv - plain)) > 0.5  # px
    assert np.max(np.abs(of.uv - corrected)) < 0.01  # px
    found = adjust(of.block(atmosphere=AIR), HELD)
    assert np.max(np.abs(found.residuals)) < 0.01
    assert np.max(np.abs(found.images.centre - of.centre)) < 0.01  # m
    assert found.refractions == {"camera": pytest.approx(1.0)}


@pytest.mark.costly
def test_bending_is_that_of_saastamoinen() -> None:
    """K tan z with K of Saastamoinen's formula for photographs in the standard atmosphere, also used by Kraus."""
    of = high()
    places = GroundPoints([f"p{k}" for k in range(len(of.points))], of.points)
    ready = prepared(replace(of.block(atmosphere=AIR), points=places), Unknowns())
    bending = np.asarray(ready.problem.effects.bending).T[ready.order.place]
    line = of.points[of.point] - of.centre[of.image]
    distance, level = np.linalg.norm(line, axis=1), np.hypot(line[:, 0], line[:, 1])
    off_nadir = np.arctan2(level, -line[:, 2])
    angle = np.linalg.norm(np.cross(line, bending), axis=1) / distance**2
    H, h = of.centre[of.image][:, 2] / 1e3, of.points[of.point][:, 2] / 1e3  # km
    power = lambda x, n: (1.0 - 0.02257 * x) ** n  # noqa: E731
    K = 2335.0 / (H - h) * (power(h, 5.256) - power(H, 5.256)) - 277.0 * power(H, 4.256)
    far = off_nadir > 0.2
    assert np.all(bending[:, 2] > 0.0)
    np.testing.assert_allclose(angle[far], (1e-6 * K * np.tan(off_nadir))[far], rtol=0.02)


@pytest.mark.slow
def test_errors_are_those_of_the_standard_deviation() -> None:
    """The factor over many blocks, and orientations, which are biased without refraction."""
    of, ratios, poses, biased = high(), [], [], []
    for seed in range(SEEDS):
        found = adjust(of.block(seed, atmosphere=AIR), Unknowns(refraction=Free()))
        (parameter,) = found.parameters
        assert (parameter.name, parameter.unit) == ("refraction", "1")
        ratios.append((parameter.value - 1.0) / parameter.sigma)
        for given, kept in ((found, poses), (adjust(of.block(seed)), biased)):
            error = given.images.centre - of.centre
            weight = np.linalg.inv(given.covariance_of_images[:, :3, :3])
            kept.append(np.einsum("ni,nij,nj->n", error, weight, error).mean() / 3.0)
    low, high_ = scipy.stats.chi2.interval(0.9999, SEEDS)
    assert low < np.sum(np.square(ratios)) < high_
    assert 0.7 < np.mean(poses) < 1.3
    assert np.mean(biased) > 1.3 * np.mean(poses)


@pytest.mark.costly
def test_the_bending_is_that_at_the_solution() -> None:
    """From a start a hundred metres off, the result is as from the truth."""
    block = high().block(atmosphere=AIR)
    images = block.images
    off = Images(images.name, images.camera, images.centre + np.array([60.0, -60.0, 100.0]), images.R_frame_from_camera)
    found, other = adjust(block, HELD), adjust(replace(block, images=off), HELD)
    np.testing.assert_allclose(other.images.centre, found.images.centre, rtol=0.0, atol=1e-4)  # m
    first = prepared(replace(block, images=off), HELD).problem.effects.bending
    last = other.prepared.problem.effects.bending
    change = np.abs(np.asarray(first - last)).max() / np.abs(np.asarray(last)).max()
    assert 1e-3 < change < 0.1
    numbers = [one.number for one in other.log]
    assert numbers == list(range(len(numbers)))


@pytest.mark.slow
def test_blunders_are_found_through_the_air() -> None:
    block = high().block(3, atmosphere=AIR)
    uv = block.observations.uv.copy()
    uv[17] += [30.0, 0.0]
    wrong = replace(block, observations=replace(block.observations, uv=uv))
    found, blunders = without_blunders(wrong, HELD, alpha=1e-5)
    assert [one.row for one in blunders] == [17]
    assert found.sigma0 == pytest.approx(1.0, abs=0.1)


def test_what_does_not_go_together_is_refused() -> None:
    block = simulated().block()
    with pytest.raises(ValueError, match=r"Unknowns\.refraction is a factor.*give Block\(atmosphere="):
        prepared(block, Unknowns(refraction=Free()))
    with pytest.raises(ValueError, match="LocalFrame"):
        replace(block, frame=Cartesian(), atmosphere=AIR)
    with pytest.raises(ValueError, match="one atmosphere"):
        block.with_block(simulated().block(atmosphere=AIR))
