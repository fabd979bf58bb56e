"""Cameras: pixel to ray and back, statuses, derivatives, and constructors that refuse nonsense."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from support.derivatives import derivatives_at_zero, first_derivatives_at_zero
from support.lenses import pixels, rays

from jaxgeo.sensor import BrownConrady, FrameCamera
from jaxgeo.status import Status

METRIC = {"focal_length": 0.0555, "pixel_pitch": 5.2e-6, "width": 10328, "height": 7760}
SMALL = {"focal_px": (900.0, 910.0), "width": 1280, "height": 960}
CAMERAS = {
    "metric, no distortion": FrameCamera.from_metric(**METRIC, principal_point=(0.026e-3, -0.2246e-3)),
    "long focal length": FrameCamera.from_metric(focal_length=1.9, pixel_pitch=(10e-6, 9e-6), width=7584, height=48836),
    "barrel": FrameCamera.from_pixels(focal_px=1300.0, width=1280, height=960, distortion=BrownConrady(k1=-0.35)),
    "pincushion": FrameCamera.from_pixels(**SMALL, distortion=BrownConrady(k1=0.3, k2=0.05)),
    "tangential": FrameCamera.from_pixels(
        **SMALL, principal_px=(650.0, 470.0), distortion=BrownConrady(k1=-0.2, k2=0.05, p1=4e-3, p2=-6e-3, k3=-0.01)
    ),
    "rational": FrameCamera.from_pixels(**SMALL, distortion=BrownConrady(0.9, 0.4, 1e-3, -2e-3, 0.05, 1.2, 0.7, 0.2)),
}
ROWS = pytest.mark.parametrize("name", CAMERAS)


def some_pixels(camera: FrameCamera, count: int = 300) -> np.ndarray:
    rng = np.random.default_rng(3)
    return rng.uniform([-0.499, -0.499], [camera.width - 0.501, camera.height - 0.501], (count, 2))


@ROWS
def test_project_undoes_ray(name):
    camera = CAMERAS[name]
    uv = some_pixels(camera)
    directions, status = rays(camera, uv)
    assert np.all(status == Status.hit)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0, rtol=0, atol=1e-15)
    lengths = np.geomspace(1e-3, 1e9, len(uv))[:, None]
    back, status = pixels(camera, lengths * directions)
    assert np.all(status == Status.hit)
    np.testing.assert_allclose(back, uv, rtol=0, atol=1e-9)


@ROWS
def test_ray_undoes_project(name):
    camera = CAMERAS[name]
    directions, _ = rays(camera, some_pixels(camera))
    again, _ = rays(camera, pixels(camera, 7.0 * directions)[0])
    np.testing.assert_allclose(again, directions, rtol=0, atol=1e-12)


@ROWS
def test_right_is_right_and_down_is_down(name):
    camera = CAMERAS[name]
    points = np.array([[0.0, 0.0, 5.0], [0.01, 0.0, 1.0], [0.0, 0.01, 1.0]])
    uv, status = pixels(camera, points)
    assert np.all(status == Status.hit)
    centre, right, below = uv
    np.testing.assert_array_equal(centre, camera.principal_px)
    assert right[0] > centre[0] + 1
    assert below[1] > centre[1] + 1


def test_metric_and_pixel_terms_agree():
    metric = FrameCamera.from_metric(
        focal_length=0.05, pixel_pitch=(5e-6, 4e-6), width=11, height=6, principal_point=(1e-5, -2e-6)
    )
    in_pixels = FrameCamera.from_pixels(focal_px=(1e4, 1.25e4), width=11, height=6, principal_px=(7.0, 2.0))
    np.testing.assert_allclose(metric.focal_px, in_pixels.focal_px, rtol=1e-15)
    np.testing.assert_allclose(metric.principal_px, in_pixels.principal_px, rtol=1e-15)
    ray = rays(metric, np.array([[8.0, 4.0]]))[0][0]  # one column right of, two rows below the principal point
    np.testing.assert_allclose(ray / ray[2], [5e-6 / 0.05, 8e-6 / 0.05, 1.0], rtol=1e-14)


def test_field_of_view_is_from_edge_to_edge():
    camera = FrameCamera.from_pixels(focal_px=50.0, width=100, height=60)
    across, down = camera.field_of_view()
    np.testing.assert_allclose([across, down], [np.pi / 2, 2 * np.arctan(0.6)], rtol=1e-14)


def test_a_frame_camera_exposes_everything_at_once():
    assert CAMERAS["barrel"].time_of(np.array([3.0, 4.0])) == 0.0


# What happens to a point, in a lens that folds at a radius of 1 (k1 = -1/3), 1280 x 960 pixels, focal length 900.
FOLDING = FrameCamera.from_pixels(focal_px=900.0, width=1280, height=960, distortion=BrownConrady(k1=-1.0 / 3.0))
POINTS = {
    "in the image": ([0.1, 0.1, 1.0], Status.hit),
    "to the side of the image": ([0.95, 0.0, 1.0], Status.hit),
    "below the image": ([0.0, 0.8, 1.0], Status.outside_image),
    "beyond the fold": ([1.2, 0.0, 1.0], Status.outside_distortion_field),
    "beyond the fold, which lies beside the image": ([0.1, 1.3, 1.0], Status.outside_image),
    "folded back onto the image": ([1.7, 0.0, 1.0], Status.outside_distortion_field),
    "nearly at a right angle": ([1e6, 0.0, 1.0], Status.outside_distortion_field),
    "at a right angle": ([1.0, 1.0, 0.0], Status.behind_camera),
    "behind": ([0.1, 0.1, -1.0], Status.behind_camera),
    "the centre itself": ([0.0, 0.0, 0.0], Status.behind_camera),
    "not a number": ([np.nan, 0.0, 1.0], Status.invalid_input),
    "infinitely far": ([0.0, 0.0, np.inf], Status.invalid_input),
}
PIXELS = {
    "in the image": ([700.0, 500.0], Status.hit),
    "on its corner": ([-0.5, -0.5], Status.outside_distortion_field),
    "on its edge": ([639.5, -0.5], Status.hit),
    "just outside": ([639.5, -0.6], Status.outside_image),
    "outside the image": ([639.5, 1000.0], Status.outside_image),
    "where no ray ends": ([639.5, 1500.0], Status.outside_image),
    "not a number": ([np.nan, 0.0], Status.invalid_input),
}


def test_each_point_gets_its_status_and_no_plausible_pixel():
    points = np.array([p for p, _ in POINTS.values()])
    expected = np.array([status for _, status in POINTS.values()])
    uv, status = pixels(FOLDING, points)
    assert dict(zip(POINTS, np.asarray(status), strict=True)) == dict(zip(POINTS, expected, strict=True))
    given = (expected == Status.hit) | (expected == Status.outside_image)
    given &= ~np.array(["beyond the fold" in name for name in POINTS])
    assert np.array_equal(np.all(np.isfinite(uv), axis=1), given)


def test_each_pixel_gets_its_status_and_no_plausible_ray():
    uv = np.array([p for p, _ in PIXELS.values()])
    expected = np.array([status for _, status in PIXELS.values()])
    directions, status = rays(FOLDING, uv)
    assert dict(zip(PIXELS, np.asarray(status), strict=True)) == dict(zip(PIXELS, expected, strict=True))
    given = (expected == Status.hit) | (expected == Status.outside_image)
    given &= np.array(list(PIXELS)) != "where no ray ends"
    assert np.array_equal(np.all(np.isfinite(directions), axis=1), given)


@pytest.mark.costly
def test_failed_lanes_leave_the_gradient_of_a_masked_mean_finite():
    points, uv = np.array([p for p, _ in POINTS.values()]), np.array([p for p, _ in PIXELS.values()])

    def masked_mean(camera, vectors, outward):
        values, status = jax.vmap(camera.project if outward else camera.ray)(vectors)
        return jnp.mean(jnp.where((status == Status.hit)[:, None], values, 0.0) ** 2)

    for vectors, outward in ((points, True), (uv, False)):
        gradients = jax.jit(jax.grad(masked_mean, argnums=(0, 1)), static_argnums=2)(FOLDING, vectors, outward)
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradients))
        assert any(np.any(np.asarray(leaf) != 0.0) for leaf in jax.tree.leaves(gradients))


@functools.partial(jax.jit, static_argnames=("outward", "order"))
def derivatives(camera, vector, outward, order):
    """Derivatives in the camera's constants and the pixel or point, each in units of its own size."""
    flat, unravel = ravel_pytree((camera, vector))
    unit = jnp.where(jnp.abs(flat) > 0.0, jnp.abs(flat), 0.01)

    def f(x):
        camera, vector = unravel(flat + unit * x)
        return camera.project(vector)[0] / 1000.0 if outward else camera.ray(vector)[0]

    return (first_derivatives_at_zero if order == 1 else derivatives_at_zero)(f, flat.size, 1e-3)


@ROWS
@pytest.mark.parametrize("outward", [False, True], ids=["ray", "project"])
def test_derivatives_equal_differences_and_forward_equals_reverse(name, outward):
    camera = CAMERAS[name]
    uv = jnp.array([0.83 * camera.width, 0.21 * camera.height])
    camera = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), camera)
    vector = 3.0 * rays(camera, uv[None])[0][0] if outward else uv
    first, reverse, first_diff, _ = derivatives(camera, vector, outward, 1)
    np.testing.assert_allclose(first, reverse, rtol=0, atol=1e-12 * np.abs(first).max())
    np.testing.assert_allclose(first, first_diff, rtol=0, atol=1e-8 * np.abs(first).max())


# Those of lenses are tested for every lens by itself.
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if isinstance(camera.distortion, BrownConrady) else name
        for name, camera in CAMERAS.items()
    ],
)
@pytest.mark.parametrize("outward", [False, True], ids=["ray", "project"])
def test_second_derivatives_equal_differences(name, outward):
    camera = CAMERAS[name]
    uv = jnp.array([0.83 * camera.width, 0.21 * camera.height])
    camera = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), camera)
    vector = 3.0 * rays(camera, uv[None])[0][0] if outward else uv
    found = derivatives(camera, vector, outward, 2)
    assert np.all(np.isfinite(found.second))
    largest = np.abs(found.second).max()
    np.testing.assert_allclose(found.second, found.second_differences, rtol=0, atol=1e-7 * largest)


MISTAKES = {
    "negative focal length": ({**METRIC, "focal_length": -0.05}, r"focal_length must be positive, in m; got -0\.05"),
    "zero pitch": ({**METRIC, "pixel_pitch": 0.0}, r"pixel_pitch must be positive, in m; got 0\.0: pixels of 5 um"),
    "focal length in mm": (
        {**METRIC, "focal_length": 75},
        r"focal_length must be in m, from 0 to 10; got 75: a 50 mm lens",
    ),
    "pitch in um": ({**METRIC, "pixel_pitch": 4.5}, r"pixel_pitch must be in m, from 5e-07 to 0.001; got 4\.5: pixels"),
    "focal length not finite": ({**METRIC, "focal_length": np.nan}, r"focal_length must be finite, in m; got nan"),
    "three pitches": ({**METRIC, "pixel_pitch": (1e-6, 1e-6, 1e-6)}, r"a pair \(along columns, along rows\)"),
    "not a number of columns": ({**METRIC, "width": True}, "width must be a whole number of pixels"),
    "no rows": ({**METRIC, "height": 0}, r"height must be a whole number of pixels greater than zero; got 0"),
    "principal point": ({**METRIC, "principal_point": (np.inf, 0.0)}, r"principal_point must be finite, in m"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_constructor_says_what_is_wrong(name):
    arguments, message = MISTAKES[name]
    with pytest.raises(ValueError, match=message):
        FrameCamera.from_metric(**arguments)


def test_single_precision_is_refused():
    with pytest.raises(TypeError, match="float32"):
        CAMERAS["barrel"].ray(np.zeros(2, np.float32))
    with pytest.raises(TypeError, match="float32"):
        FrameCamera.from_pixels(focal_px=np.float32(900.0), width=10, height=10)
    assert CAMERAS["barrel"].ray(np.array([3, 4]))[0].dtype == np.float64
