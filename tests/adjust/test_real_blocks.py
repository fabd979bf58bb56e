"""Real blocks: five frames held against a dense adjustment in NumPy, a problem of BAL, and a flight of IGN."""

from __future__ import annotations

import pathlib
from typing import NamedTuple

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation
from support import blocks

from jaxgeo.adjust import Adjustment, Fixed, Images, InnerConstraints, Solver, Unknowns, adjust, blunders

pytestmark = pytest.mark.slow

SIGMA_POSITION, SIGMA_ATTITUDE = 1.0, np.deg2rad(0.05)  # m, rad: of the navigation that is made up


class Oracle(NamedTuple):
    """An adjustment by Gauss and Newton with the angles themselves as unknowns, in full matrices.

    `images` (n, 6) are centres in m and omega, phi, kappa in rad, `points` (m, 3) places in m; `sigmas` are those of
    unit weight, in the order of both.
    """

    images: np.ndarray
    points: np.ndarray
    sigmas: np.ndarray
    sigma0: float
    redundancy: int
    residuals: np.ndarray


def gauss_newton(real: blocks.RealBlock, names: list[str], start: Images, places: np.ndarray) -> Oracle:
    """The Strasbourg block from some orientations and places of its points, by textbook formulas."""
    angles = Rotation.from_matrix(start.R_frame_from_camera @ np.diag([1.0, -1.0, -1.0])).as_euler("XYZ")
    images, points = np.concatenate([start.centre, angles], axis=1), places.copy()
    n = len(images)
    for _ in range(12):
        _, r, A = _equations(real, names, start, images, points)
        scale = 1.0 / np.linalg.norm(A, axis=0)
        step = -scale * np.linalg.lstsq(A * scale, r, rcond=None)[0]
        images += step[: 6 * n].reshape(n, 6)
        points += step[6 * n :].reshape(-1, 3)
        if np.linalg.norm(step / scale) < 1e-6:  # in standard deviations, of all together
            break
    pixels, r, A = _equations(real, names, start, images, points)
    scale = 1.0 / np.linalg.norm(A, axis=0)
    inverse = np.linalg.inv((A * scale).T @ (A * scale))
    redundancy = A.shape[0] - A.shape[1]
    sigmas = scale * np.sqrt(np.diag(inverse))
    return Oracle(images, points, sigmas, float(np.sqrt(r @ r / redundancy)), redundancy, pixels)


def _equations(
    real: blocks.RealBlock, names: list[str], start: Images, images: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(residuals in px, all residuals over their sigmas, their derivatives by all unknowns)."""
    seen, control, camera = real.block.observations, real.block.control, real.block.cameras["camera"]
    assert control is not None
    f, (px, py) = float(np.asarray(camera.focal_px)[0]), np.asarray(camera.principal_px)
    image_of = {name: i for i, name in enumerate(start.name.tolist())}
    point_of = {name: i for i, name in enumerate(names)}
    i = np.array([image_of[name] for name in seen.image.tolist()])
    j = np.array([point_of[name] for name in seen.point.tolist()])
    known = np.array([point_of[name] for name in control.name.tolist()])
    n, k = len(images), len(i)
    matrix, by_angle = _rotation(images[:, 3:])
    offset = points[j] - images[i, :3]
    d = np.einsum("kji,kj->ki", matrix[i], offset)
    x, y = px - f * d[:, 0] / d[:, 2], py + f * d[:, 1] / d[:, 2]
    pixels = np.stack([x, y], axis=1) - seen.uv
    of_x = np.stack([-f / d[:, 2], np.zeros(k), f * d[:, 0] / d[:, 2] ** 2], axis=1)
    of_y = np.stack([np.zeros(k), f / d[:, 2], -f * d[:, 1] / d[:, 2] ** 2], axis=1)
    by_d = np.stack([of_x, of_y], axis=1) / seen.sigma[:, :, None]
    by_point = np.einsum("kab,kcb->kac", by_d, matrix[i])
    by_angles = np.einsum("kab,kqcb,kc->kaq", by_d, by_angle[i], offset)
    A = np.zeros((2 * k + 3 * len(known), 6 * n + 3 * len(points)))
    rows, axes = np.arange(2 * k).reshape(k, 2, 1), np.arange(3)
    A[rows, 6 * i[:, None, None] + axes] = -by_point
    A[rows, 6 * i[:, None, None] + 3 + axes] = by_angles
    A[rows, 6 * n + 3 * j[:, None, None] + axes] = by_point
    A[np.arange(2 * k, len(A)), (6 * n + 3 * known[:, None] + axes).ravel()] = 1.0 / control.sigma.ravel()
    off = (points[known] - control.place) / control.sigma
    return pixels, np.concatenate([(pixels / seen.sigma).ravel(), off.ravel()]), A


def _rotation(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rx(omega) Ry(phi) Rz(kappa) (n, 3, 3), and its derivatives (n, 3, 3, 3) by each of the angles."""
    parts, slopes = [], []
    for axis, angle in enumerate(angles.T):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        R, D = np.zeros((len(angles), 3, 3)), np.zeros((len(angles), 3, 3))
        R[:, axis, axis] = 1.0
        R[:, a, a] = R[:, b, b] = np.cos(angle)
        R[:, b, a], R[:, a, b] = np.sin(angle), -np.sin(angle)
        D[:, a, a] = D[:, b, b] = -np.sin(angle)
        D[:, b, a], D[:, a, b] = np.cos(angle), -np.cos(angle)
        parts.append(R)
        slopes.append(D)
    X, Y, Z = parts
    by = [slopes[0] @ Y @ Z, X @ slopes[1] @ Z, X @ Y @ slopes[2]]
    return X @ Y @ Z, np.stack(by, axis=1)


@pytest.fixture(scope="module")
def strasbourg(jaxgeo_test_data: pathlib.Path) -> tuple[blocks.RealBlock, Adjustment, Oracle]:
    """The block, its adjustment, and the dense one."""
    real = blocks.strasbourg(jaxgeo_test_data)
    found = adjust(real.block, real.unknowns)
    names = found.points.name.tolist()
    rng = np.random.default_rng(0)
    places = found.points.place + rng.normal(0.0, 0.5, (len(names), 3))
    return real, found, gauss_newton(real, names, real.block.images, places)


def test_strasbourg_is_what_a_dense_adjustment_finds(
    strasbourg: tuple[blocks.RealBlock, Adjustment, Oracle],
) -> None:
    _, found, oracle = strasbourg
    assert found.converged
    assert (found.redundancy, found.observations, found.unknown_count) == (oracle.redundancy, 2434, 1173)
    assert found.redundancy == 1261
    assert found.sigma0 == pytest.approx(oracle.sigma0, abs=1e-9)
    assert found.sigma0 == pytest.approx(1.178598, abs=1e-6)
    np.testing.assert_allclose(found.residuals, oracle.residuals, rtol=0.0, atol=1e-5)  # px
    np.testing.assert_allclose(found.images.centre, oracle.images[:, :3], rtol=0.0, atol=1e-5)  # m
    turn = np.angle(np.exp(1j * (found.omega_phi_kappa - oracle.images[:, 3:])))
    np.testing.assert_allclose(turn, 0.0, rtol=0.0, atol=1e-9)  # rad
    np.testing.assert_allclose(found.points.place, oracle.points, rtol=0.0, atol=1e-5)  # m


def test_strasbourgs_standard_deviations_are_those_of_a_dense_inverse(
    strasbourg: tuple[blocks.RealBlock, Adjustment, Oracle],
) -> None:
    """To six digits, angles too: the oracle has them as unknowns, here they follow from a turn about camera axes."""
    _, found, oracle = strasbourg
    n = len(found.images)
    of_images, of_points = oracle.sigmas[: 6 * n].reshape(n, 6), oracle.sigmas[6 * n :].reshape(-1, 3)
    np.testing.assert_allclose(found.sigma_of_images, of_images, rtol=1e-6)
    np.testing.assert_allclose(found.points.sigma, of_points, rtol=1e-6)


def test_strasbourgs_check_points_lie_where_they_were_measured(
    strasbourg: tuple[blocks.RealBlock, Adjustment, Oracle],
) -> None:
    real, found, _ = strasbourg
    assert real.checks is not None
    off = found.differences(real.checks)
    # 6 cm of ground in a pixel, 1.9 km above: half a pixel along the ground, and four times that in height.
    assert np.all(np.abs(off[:, :2]) < 0.35)  # m
    assert np.all(np.abs(off[:, 2]) < 0.5)  # m


def test_a_problem_of_bal_comes_down_to_its_known_cost(jaxgeo_test_data: pathlib.Path) -> None:
    real = blocks.large(jaxgeo_test_data)
    found = adjust(real.block, real.unknowns, datum=InnerConstraints(), solver=Solver(relative=1e-9), screen=None)
    assert found.log[0].cost == pytest.approx(4.185660e6, abs=0.5)
    assert found.cost == pytest.approx(1.803390e4, abs=0.01)
    assert found.converged
    assert (len(found.images), len(found.places), len(found.block.observations)) == (16, 22106, 83718)
    assert found.redundancy == 2 * 83718 - 9 * 16 - 3 * 22106 + 7
    assert np.all(found.points.sigma > 0.0)
    assert len(found.parameters) == 3 * 16


@pytest.fixture(scope="module")
def flown(jaxgeo_test_data: pathlib.Path) -> blocks.Aerial:
    """The block of IGN."""
    return blocks.aerial(jaxgeo_test_data)


@pytest.fixture(scope="module")
def adjusted(flown: blocks.Aerial) -> tuple[Adjustment, Adjustment]:
    """From orientations that are disturbed, and from those given, both held by a navigation that is as good."""
    disturbed = flown.with_navigation(SIGMA_POSITION, SIGMA_ATTITUDE, seed=1)
    return adjust(disturbed), adjust(flown.held(SIGMA_POSITION, SIGMA_ATTITUDE))


def off_given(found: Adjustment, given: Images) -> np.ndarray:
    """Adjusted less given (n, 6): centres in m, turns about camera axes in rad."""
    turn = np.swapaxes(given.R_frame_from_camera, 1, 2) @ found.images.R_frame_from_camera
    return np.concatenate([found.images.centre - given.centre, Rotation.from_matrix(turn).as_rotvec()], axis=1)


def test_the_ties_of_a_flight_fit_to_a_fifth_of_a_pixel(
    flown: blocks.Aerial, adjusted: tuple[Adjustment, Adjustment]
) -> None:
    found, _ = adjusted
    assert len(flown.read) == 14491
    assert len(np.unique(flown.read.point)) == 3089
    assert len(flown.seen) == 14491 - 84  # those of points that one image sees
    assert len(found.images) == 68
    assert found.converged
    assert np.sqrt(np.mean(flown.off() ** 2)) < 0.21  # px, before anything is adjusted
    assert np.sqrt(np.mean(found.residuals**2)) == pytest.approx(0.149, abs=0.005)  # px
    assert np.sqrt(np.mean(np.square(np.asarray(found.navigation_residuals)))) == pytest.approx(1.0, abs=0.2)
    assert 0 < len(blunders(found)) < 0.02 * len(flown.seen)


def test_disturbed_orientations_return_to_those_given(
    flown: blocks.Aerial, adjusted: tuple[Adjustment, Adjustment]
) -> None:
    """The whole of the block goes where the made-up errors of the navigation take it, and its form comes back.

    The ties' errors are not white: the camera leaves a pattern of 0.1 px in all images. So the well held directions
    differ from the given orientations, which other ties made, by three of the standard deviations of white errors.
    """
    found, undisturbed = adjusted
    assert found.screened == ()  # poor orientations make no measurement wrong
    disturbance = off_given_images(found, flown)
    d = off_given(found, flown.given)
    assert np.all(np.sqrt(np.mean(d**2, axis=0)) < 0.6 * np.sqrt(np.mean(disturbance**2, axis=0)))
    cov = found.sigma0**2 * found.covariance
    sigma = np.sqrt(np.diagonal(cov))
    assert np.all(np.sqrt(np.mean((d / sigma.reshape(d.shape)) ** 2, axis=0)) < 2.2)
    values, vectors = np.linalg.eigh(cov / np.outer(sigma, sigma))
    parts = (vectors.T @ (d.ravel() / sigma)) ** 2 / values
    count = len(parts) // 8
    assert scipy.stats.chi2.sf(parts[-count:].sum(), count) > 1e-3  # what the navigation alone holds
    assert parts.sum() < 10.0 * len(parts)
    # What the disturbance alone changed: Q W e, of which the squared length over Q has the mean trace(W Q).
    change = off_given(found, undisturbed.images).ravel()
    weight = np.tile(np.repeat([SIGMA_POSITION**-2.0, SIGMA_ATTITUDE**-2.0], 3), len(d))
    spread = weight * found.covariance
    expected, width = np.trace(spread), np.sqrt(2.0 * np.sum(spread * spread.T))
    assert change @ np.linalg.solve(found.covariance, change) == pytest.approx(expected, abs=4.0 * width)


def test_over_many_disturbances_orientations_lie_within_their_standard_deviations(flown: blocks.Aerial) -> None:
    off = []
    for seed in range(12):
        found = adjust(flown.with_navigation(SIGMA_POSITION, SIGMA_ATTITUDE, seed))
        sigma = found.sigma0 * np.sqrt(np.diagonal(found.covariance_of_images, axis1=1, axis2=2))
        off.append(np.abs(off_given(found, flown.given)) / sigma)
    assert np.sqrt(np.mean(np.square(off))) < 1.4
    assert np.mean(np.array(off) < 2.0) > 0.85
    assert np.mean(np.array(off) < 3.0) > 0.97


def off_given_images(found: Adjustment, flown: blocks.Aerial) -> np.ndarray:
    """Where the adjustment started, less the given orientations."""
    start = found.block.images
    turn = np.swapaxes(flown.given.R_frame_from_camera, 1, 2) @ start.R_frame_from_camera
    return np.concatenate([start.centre - flown.given.centre, Rotation.from_matrix(turn).as_rotvec()], axis=1)


def test_given_orientations_intersect_in_the_given_points(flown: blocks.Aerial) -> None:
    block = flown.held(SIGMA_POSITION, SIGMA_ATTITUDE)
    found = adjust(block, Unknowns(images=Fixed()))
    off = found.differences(flown.ground)
    np.testing.assert_array_less(np.sqrt(np.mean(off**2, axis=0)), [0.01, 0.01, 0.03])  # m, 5.5 cm in a pixel
    assert np.sqrt(np.mean(found.residuals**2)) < 0.17  # px


def test_what_the_map_does_to_a_flight_shows(flown: blocks.Aerial, jaxgeo_test_data: pathlib.Path) -> None:
    left_in = blocks.aerial(jaxgeo_test_data, ground_altitude=None)
    assert np.sqrt(np.mean(left_in.off() ** 2)) == pytest.approx(1.9, abs=0.3)  # px: the linear alteration
    turned = blocks.without_convergence(jaxgeo_test_data, flown)
    assert np.sqrt(np.mean(turned.off() ** 2)) > 100.0  # px: a degree of convergence


def test_a_flight_is_two_free_networks(flown: blocks.Aerial) -> None:
    """Its ties lie in two places, 18 km apart, and hold nothing between them."""
    parts = flown.parts()
    assert [len(part.given) for part in parts] == [36, 24]
    for part in parts:
        found = adjust(part.free_network(), datum=InnerConstraints())
        assert found.redundancy == 2 * len(part.seen) - 6 * len(part.given) - 3 * len(found.places) + 7
        assert np.sqrt(np.mean(found.residuals**2)) == pytest.approx(0.149, abs=0.02)  # px
        off = found.differences(part.ground.of(found.points.name))
        np.testing.assert_allclose(off.mean(axis=0), 0.0, atol=1e-6)  # m: the points stay where they were, as a whole
        assert np.all(np.sqrt(np.mean(off**2, axis=0)) < [0.2, 0.2, 0.4])  # m
