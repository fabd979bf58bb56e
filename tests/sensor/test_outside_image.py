"""A pixel or point outside the image says so, also where the camera's lens has no ray so far out."""

from __future__ import annotations

import importlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.lenses import pixels, rays

import jaxgeo
from jaxgeo import BrownConrady, ConstantHeight, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot, Status
from jaxgeo.sensor import Ebner, RollingShutterCamera

WIDTH, HEIGHT = 4000, 3000
FOLDS = BrownConrady(k1=-0.2)  # at a radius of 1.29, whose image of 0.86 lies beyond the corners
LENSES = {
    "barrel": FOLDS,
    "none": None,
    "correction": Ebner.for_image(focal_px=3700.0, width=WIDTH, height=HEIGHT),
}
BESIDE = np.array([[-1.0, 20.0], [4000.0, 1499.5], [1e4, 1e4], [2e4, 1499.5], [1999.5, -1e5], [1e7, 0.0]])


def camera(lens: str) -> FrameCamera:
    return FrameCamera.from_pixels(focal_px=3700.0, width=WIDTH, height=HEIGHT, distortion=LENSES[lens])


def sensor(lens: str) -> Sensor:
    return Sensor(camera(lens), Gimbal.three_axis(), Mount.forward())


def shot(one: Sensor) -> Shot:
    readings = one.gimbal.readings_from_degrees(yaw=0.0, pitch=-90.0, roll=0.0)
    return Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=720.0), readings)


@pytest.mark.costly
@pytest.mark.parametrize("lens", LENSES)
def test_a_pixel_outside_the_image_is_outside_it_whatever_the_lens(lens: str) -> None:
    one = camera(lens)
    directions, status = rays(one, jnp.asarray(BESIDE))
    assert np.all(np.asarray(status) == Status.outside_image)
    assert np.isfinite(directions[:2]).all(), "near the image the lens still has a ray"
    shutter = RollingShutterCamera.from_readout(one, readout_time=0.01)
    assert np.all(np.asarray(rays(shutter, jnp.asarray(BESIDE))[1]) == Status.outside_image)


@pytest.mark.costly
def test_locate_and_its_batch_say_it() -> None:
    one = sensor("barrel")
    ground = ConstantHeight(600.0)
    many = jax.jit(jax.vmap(lambda uv: jaxgeo.locate(one, shot(one), uv, ground)))(jnp.asarray(BESIDE))
    assert np.all(np.asarray(many.status) == Status.outside_image)
    assert np.isnan(many.slant_range).all()


def test_with_throw_the_size_is_told_and_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    one = sensor("barrel")
    monkeypatch.setattr(importlib.import_module("jaxgeo._locate"), "_locate", lambda *_: pytest.fail("compiled"))
    with pytest.raises(ValueError, match=r"outside_image: .*\(20000, 1499\.5\) .* image of 4000 columns x 3000 rows"):
        jaxgeo.locate(one, shot(one), BESIDE[3], ConstantHeight(600.0), throw=True)


@pytest.mark.costly
@pytest.mark.parametrize("lens", LENSES)
def test_a_point_far_beside_the_view_is_outside_the_image(lens: str) -> None:
    """From 120 m above, at up to 89 deg off the axis; with the barrel lens most of them lie beyond its fold."""
    one, away = sensor(lens), np.array([0.002, 0.004, 0.02, 0.09])
    points = Geodetic.from_degrees(lat=np.full(4, 47.0), lon=11.0 + away, height=np.full(4, 600.0))
    found = jax.jit(jax.vmap(lambda point: jaxgeo.project(one, shot(one), point)))(points)
    assert np.all(np.asarray(found.status) == Status.outside_image)
    if lens == "none":
        assert np.isfinite(found.uv).all()
    if lens == "barrel":
        assert np.isfinite(found.uv).all(axis=1).tolist() == [True, False, False, False]


def test_batches_of_points_have_the_statuses_of_single_ones() -> None:
    one = camera("barrel")
    x, y = (part.ravel() for part in np.meshgrid(np.linspace(-5.0, 5.0, 20), np.linspace(-5.0, 5.0, 20)))
    z = np.ones_like(x)
    single, statuses = pixels(one, np.stack([x, y, z], axis=1))
    u, v, status = jax.jit(type(one).project_many)(one, jnp.asarray(x), jnp.asarray(y), jnp.asarray(z))
    np.testing.assert_array_equal(status, statuses)
    np.testing.assert_allclose(np.stack([u, v], axis=1), single, rtol=0, atol=1e-9)
    assert set(np.asarray(status).tolist()) == {Status.hit, Status.outside_image}


def test_a_fold_within_the_image_is_still_told_as_the_lens() -> None:
    strong = FrameCamera.from_pixels(focal_px=3700.0, width=WIDTH, height=HEIGHT, distortion=BrownConrady(k1=-1.5))
    _, status = rays(strong, jnp.zeros((1, 2)))
    assert int(status[0]) == Status.outside_distortion_field
    _, status = pixels(strong, np.array([[1.0, 0.7, 1.0]]))
    assert int(status[0]) == Status.outside_distortion_field
