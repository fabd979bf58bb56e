"""Lens distortion: laws of every lens; OpenCV's formula, its inverse on the branch of the centre, and its fold."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from support.derivatives import derivatives_at_zero
from support.lenses import distort, in_field, undistort

from jaxgeo.sensor import Bauer, BrownConrady, BrownPhysical, Ebner, Fisheye, NoDistortion
from jaxgeo.status import Status


def spread(count: int, size: float) -> np.ndarray:
    return size * np.random.default_rng(1).normal(size=count)


# Each with the largest radius (tangent of the angle off the axis) at which it is to be inverted.
DISTORTIONS = {
    "none": (NoDistortion(), 2.0),
    "barrel, close to its fold": (BrownConrady(k1=-0.35), 0.95),
    "pincushion": (BrownConrady(k1=0.25, k2=0.1), 1.2),
    "barrel turning to pincushion": (BrownConrady(k1=-0.35, k2=0.18, k3=-0.01), 1.0),
    "tangential": (BrownConrady(k1=-0.1, p1=0.01, p2=-0.02), 0.8),
    "rational": (BrownConrady(0.9, 0.4, 1e-3, -2e-3, 0.05, 1.2, 0.7, 0.2), 1.5),
    "wide lens, rational": (BrownConrady(k1=2.0, k2=0.8, k3=0.02, k4=2.4, k5=1.5, k6=0.16), 2.0),
    "fisheye": (Fisheye(k1=-0.03, k2=0.01, k3=-0.002, k4=1e-4), 2.0),
    "fisheye, close to its fold": (Fisheye(k1=-0.3), 1.5),
    "Bauer": (Bauer(np.array([0.02, -0.003, 0.004]), 0.5, 0.8), 0.6),
    "Bauer, close to its fold": (Bauer(np.array([-0.2, 0.01, 0.02]), 0.5), 0.5),
    "Ebner": (Ebner(spread(12, 0.003), 0.48), 0.6),
    "Ebner, long lens": (Ebner(spread(12, 0.01), 0.02), 0.025),
    "Brown's physical parameters": (BrownPhysical(spread(21, 0.003), 0.48), 0.6),
    "Brown's, wild": (BrownPhysical(spread(21, 0.01), 1.2), 1.5),
}
ROWS = pytest.mark.parametrize("name", DISTORTIONS)
IDENTITY_AT_THE_CENTRE = [
    name for name, (lens, _) in DISTORTIONS.items() if isinstance(lens, NoDistortion | BrownConrady | Fisheye)
]


def disc(radius: float, count: int = 400) -> np.ndarray:
    rng = np.random.default_rng(5)
    angle, r = rng.uniform(0, 2 * np.pi, count), radius * np.sqrt(rng.uniform(0, 1, count))
    return np.stack([r * np.cos(angle), r * np.sin(angle)], axis=1)


def opencv_distortion(points: np.ndarray, coefficients: tuple[float, ...]) -> np.ndarray:
    """The formula as OpenCV documents it for projectPoints, (k1, k2, p1, p2, k3, k4, k5, k6)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients
    x, y = points[:, 0], points[:, 1]
    r = np.hypot(x, y)
    radial = (1 + k1 * r**2 + k2 * r**4 + k3 * r**6) / (1 + k4 * r**2 + k5 * r**4 + k6 * r**6)
    xx = x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2)
    yy = y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([xx, yy], axis=1)


def test_it_is_opencvs_formula_in_opencvs_order():
    coefficients = (-0.31, 0.12, 1.3e-3, -2.1e-3, 0.04, 0.21, -0.05, 0.013)
    points = disc(0.8)
    np.testing.assert_allclose(
        distort(BrownConrady(*coefficients), points), opencv_distortion(points, coefficients), rtol=0, atol=1e-15
    )


@pytest.mark.costly
@ROWS
def test_inverse_and_formula_undo_each_other(name):
    distortion, radius = DISTORTIONS[name]
    ideal = disc(radius)
    assert np.all(in_field(distortion, ideal))
    back, status = undistort(distortion, distort(distortion, ideal))
    assert np.all(status == Status.hit)
    np.testing.assert_allclose(distort(distortion, back), distort(distortion, ideal), rtol=0, atol=5e-15)
    np.testing.assert_allclose(back, ideal, rtol=0, atol=2e-13)  # near a fold the inverse magnifies the last bit


def test_beyond_the_fold_of_a_barrel_is_outside_the_field():
    """k1 = -1/3: r - r^3 / 3 turns at r = 1, where it is 2/3."""
    lens = BrownConrady(k1=-1.0 / 3.0)
    radii = np.array([0.5, 0.999, 1.001, 1.7, 3.0, 1e3, 1e9])
    points = radii[:, None] * np.array([0.6, -0.8])
    assert np.array_equal(in_field(lens, points), radii < 1.0)
    reached = np.array([0.2, 0.666, 0.667, 0.9, 5.0, 1e3, 1e9])
    back, status = undistort(lens, reached[:, None] * np.array([0.6, -0.8]))
    assert np.array_equal(status == Status.hit, reached < 2.0 / 3.0)
    assert np.all(np.asarray(status)[2:] == Status.outside_distortion_field)
    assert np.all(np.hypot(*back.T) < 1.0)


def test_a_fisheye_is_opencvs_formula_of_the_angle():
    """theta_d = theta (1 + k1 theta2 + ...), as cv::fisheye documents it, to 89.9 deg; and its fold at 60.4 deg."""
    k1, k2, k3, k4 = coefficients = (-0.03, 0.01, -0.002, 1e-4)
    theta, turn = np.radians([0.0, 1e-6, 0.3, 0.5, 30.0, 80.0, 89.9]), np.radians(25.0)
    radial = theta * (1.0 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
    way = np.array([np.cos(turn), np.sin(turn)])
    ideal = np.tan(theta)[:, None] * way
    np.testing.assert_allclose(distort(Fisheye(*coefficients), ideal), radial[:, None] * way, rtol=0, atol=1e-15)
    back, status = undistort(Fisheye(*coefficients), radial[:, None] * way)
    assert np.all(status == Status.hit)
    np.testing.assert_allclose(np.arctan(np.hypot(*np.asarray(back).T)), theta, rtol=0, atol=2e-15)
    fold = 1.0 / np.sqrt(0.9)  # of t - 0.3 t^3
    for angle in (fold - 0.02, fold + 0.02):
        assert in_field(Fisheye(k1=-0.3), np.tan(angle) * way[None])[0] == (angle < fold)
    _, status = undistort(Fisheye(k1=-0.3), np.array([0.99, 1.01])[:, None] * (fold - 0.3 * fold**3) * way)
    assert status.tolist() == [Status.hit, Status.outside_distortion_field]


def test_a_second_branch_far_out_is_not_in_the_field():
    """Barrel that folds back and out again: far points have a positive determinant, but a fold lies before them."""
    lens = BrownConrady(k1=-0.8, k2=0.2)
    outward = np.geomspace(0.1, 1e4, 200)[:, None] * np.array([[1.0, 0.0]])
    r = outward[:, 0]
    folds = np.sqrt(np.roots([5 * 0.2, -3 * 0.8, 1.0]).min())
    assert np.array_equal(in_field(lens, outward), r < folds)
    far = distort(lens, outward[r > 2.5])
    back, status = undistort(lens, far)
    assert np.all((status == Status.outside_distortion_field) | (np.hypot(*back.T) < folds))


def test_a_pole_of_the_rational_model_ends_the_field():
    lens = BrownConrady(k4=-1.0)  # x / (1 - r2): infinite at r = 1, turned inside out beyond
    radii = np.array([0.3, 0.9, 1.1, 2.0, 50.0])
    points = radii[:, None] * np.array([0.0, 1.0])
    assert np.array_equal(in_field(lens, points), radii < 1.0)
    back, status = undistort(lens, distort(lens, points[:2]))
    np.testing.assert_allclose(back, points[:2], rtol=0, atol=1e-14)
    assert np.all(status == Status.hit)


def test_no_point_in_the_field_of_a_random_lens_is_lost():
    """Lenses with folds and poles of every kind; points too close to a pole for the last bit are left out."""
    rng = np.random.default_rng(9)
    coefficients = rng.normal(size=(4000, 8)) * [0.5, 0.3, 0.02, 0.02, 0.1, 0.4, 0.3, 0.1]
    coefficients *= rng.choice([0.3, 1.0], size=(4000, 1))

    @jax.jit
    @jax.vmap
    def there_and_back(coefficients, ideal):
        lens = BrownConrady(*coefficients)
        J = lens.jacobian(ideal)
        determinant = J[0, 0] * J[1, 1] - J[0, 1] * J[1, 0]
        sound = lens.in_field(ideal) & (determinant > 0.01) & (determinant < 1e6)
        return sound, *lens.undistort(lens.distort(ideal))

    ideal = disc(1.5, 4000)
    sound, back, status = map(np.asarray, there_and_back(coefficients, ideal))
    assert sound.sum() > 2500
    assert np.all(status[sound] == Status.hit)
    np.testing.assert_allclose(back[sound], ideal[sound], rtol=0, atol=1e-12)


@pytest.mark.costly
@ROWS
def test_what_is_not_finite_is_said_to_be_so(name):
    distortion, _ = DISTORTIONS[name]
    points = np.array([[np.nan, 0.0], [0.0, np.inf]])
    back, status = undistort(distortion, points)
    assert np.all(status == Status.invalid_input)
    assert not np.any(in_field(distortion, points))
    assert np.all(back == 0.0)


slope_at_the_centre = jax.jit(lambda lens: jax.jacfwd(lens.distort)(jnp.zeros(2)))


@pytest.mark.parametrize("name", IDENTITY_AT_THE_CENTRE)
def test_the_field_starts_as_the_identity(name):
    distortion, _ = DISTORTIONS[name]
    jacobian = slope_at_the_centre(jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), distortion))
    np.testing.assert_allclose(jacobian, np.eye(2), rtol=0, atol=1e-15)


def test_the_written_out_jacobian_is_the_derivative_of_the_formula():
    lens, points = DISTORTIONS["rational"][0], disc(1.5)
    automatic = jax.jit(jax.vmap(jax.jacfwd(lens.distort)))(points)
    np.testing.assert_allclose(jax.jit(jax.vmap(lens.jacobian))(points), automatic, rtol=0, atol=1e-14)


@functools.partial(jax.jit, static_argnames="inverse")
def derivatives(lens, point, inverse):
    """Derivatives in all numbers of lens and point, each in units of its own size."""
    flat, unravel = ravel_pytree((lens, point))
    unit = jnp.where(jnp.abs(flat) > 0.0, jnp.abs(flat), 0.01)

    def f(x):
        lens, point = unravel(flat + unit * x)
        return lens.undistort(point)[0] if inverse else lens.distort(point)

    return derivatives_at_zero(f, flat.size, 3e-4)


@pytest.mark.costly
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow) if isinstance(lens, Ebner | BrownPhysical) else name
        for name, (lens, _) in DISTORTIONS.items()
    ],
)
@pytest.mark.parametrize("inverse", [False, True], ids=["distort", "undistort"])
def test_derivatives_equal_differences_and_forward_equals_reverse(name, inverse):
    lens, radius = DISTORTIONS[name]
    lens = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), lens)
    point = 0.6 * radius * jnp.array([0.8, -0.5])
    point = distort(lens, point[None])[0] if inverse else point
    first, reverse, second, first_diff, second_diff = derivatives(lens, point, inverse)
    np.testing.assert_allclose(first, reverse, rtol=0, atol=1e-12 * np.abs(first).max())
    np.testing.assert_allclose(first, first_diff, rtol=0, atol=1e-9 * np.abs(first).max())
    np.testing.assert_allclose(second, second_diff, rtol=0, atol=1e-8 * np.abs(second).max() + 1e-12)
