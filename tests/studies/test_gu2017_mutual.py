"""Several images without a map: places of pixels, their derivatives, and the navigation's errors."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import scipy.stats
from scipy.spatial.transform import Rotation

from jaxgeo.adjust import ImagePoints
from jaxgeo.earth import WGS84
from jaxgeo.io import example_dem
from jaxgeo.studies.gu2017 import scene
from jaxgeo.studies.gu2017.mutual import NAVIGATION, _disturbed, _Flight, _images, _placed, _row, _views
from jaxgeo.ties import Correction, Views, correct

CASE = NAVIGATION[1]


@pytest.fixture(scope="module")
def flight() -> _Flight:
    """Two images, and points around the target of the first one, without tracing rays."""
    ground = example_dem()
    shots = [
        scene.looking_at(scene.target_on(ground, north), off_nadir=65.0, azimuth=20.0, above=5000.0)
        for north in (0.0, 600.0)
    ]
    target = np.asarray(WGS84.to_ecef(scene.target_on(ground)))
    points = target + np.random.default_rng(1).uniform(-300.0, 300.0, (7, 3))
    return _Flight(scene.camera(), shots, points, points[:2], points[:1])


def test_places_by_the_true_orientations_are_the_points(flight: _Flight) -> None:
    true = _views(flight, flight.shots, CASE)
    rows = np.array([0, 1, 0, 1, 0, 1, 0])
    found = _placed(true, rows, flight.ties, true.frame, true.centre, true.R_frame_from_camera)
    there = np.asarray(true.frame.from_ecef(flight.ties))
    np.testing.assert_allclose(found.place, there[:, :2], rtol=0.0, atol=1e-6)


def test_derivatives_of_places_are_finite_differences(flight: _Flight) -> None:
    true = _views(flight, flight.shots, CASE)
    given = _views(flight, _disturbed(flight.shots, CASE, np.random.default_rng(2)), CASE)
    rows = np.array([0, 1, 0, 1, 0, 1, 0])
    place = lambda centre, R: _placed(true, rows, flight.ties, given.frame, centre, R)  # noqa: E731
    by_pose = place(given.centre, given.R_frame_from_camera).by_pose
    for axis in range(6):
        step = 0.5 if axis < 3 else 1e-5
        moved = []
        for sign in (1.0, -1.0):
            change = np.zeros(6)
            change[axis] = sign * step
            R = given.R_frame_from_camera @ Rotation.from_rotvec(change[3:]).as_matrix()
            moved.append(place(given.centre + change[:3], R).place)
        found = (moved[0] - moved[1]) / (2.0 * step)
        np.testing.assert_allclose(by_pose[:, :, axis], found, rtol=0.0, atol=1e-4 * max(1.0, np.abs(found).max()))


def test_the_middle_of_the_image_sees_its_target(flight: _Flight) -> None:
    """But for the verticals of camera and target, which differ by the distance over the Earth's radius, and their
    meridians, which converge: `looking_at` takes the Earth for flat."""
    true = _views(flight, flight.shots, CASE)
    target = np.asarray(WGS84.to_ecef(scene.target_on(example_dem())))[None]
    uv, inside = _images(flight._replace(ties=target), true)
    assert inside[0, 0]
    tilt = 5000.0 * np.tan(np.deg2rad(65.0)) / 6.37e6
    turn = tilt * np.sin(np.deg2rad(20.0)) * np.tan(np.deg2rad(scene.TARGET[0])) * np.sin(np.deg2rad(65.0))
    expected = [0.5 * (scene.WIDTH - 1) - scene.FOCAL * turn, 0.5 * (scene.HEIGHT - 1) + scene.FOCAL * tilt]
    np.testing.assert_allclose(uv[0, 0], expected, rtol=0.0, atol=0.5)


def test_errors_of_the_navigation_are_as_stated(flight: _Flight) -> None:
    """Heights and headings: the variance of each, and half of it common to both images."""
    rng, found = np.random.default_rng(3), []
    for _ in range(600):
        shots = _disturbed(flight.shots, CASE, rng)
        poses = [(one.pose, true.pose) for one, true in zip(shots, flight.shots, strict=True)]
        found.append([[a.position.height - b.position.height, a.heading - b.heading] for a, b in poses])
    errors = np.array(found, float) / [CASE[0], np.deg2rad(CASE[1])]
    for axis in range(2):
        cov = np.cov(errors[:, :, axis].T)
        np.testing.assert_allclose(cov, [[1.0, 0.5], [0.5, 1.0]], rtol=0.0, atol=0.2)  # 600 draws: 0.06 in a variance


@pytest.mark.slow
def test_refused_corrections_are_counted_and_not_better(flight: _Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three of four draws are corrected, one is refused."""
    points = flight.ties[0] + np.random.default_rng(2).uniform(-800.0, 800.0, (60, 3))
    calls = []

    def corrected(given: Views, observed: ImagePoints) -> Correction:
        calls.append(len(observed))
        if len(calls) == 2:
            raise ValueError("no two images share enough tie points to be adjusted")
        return correct(given, observed)

    monkeypatch.setattr(sys.modules[_row.__module__], "correct", corrected)
    draws = [np.random.default_rng(k) for k in range(4)]
    found = _row(flight._replace(ties=points), NAVIGATION[0], draws)
    assert (found.draws, found.refused, found.better, len(calls)) == (4, 1, 3, 4)
    assert found.relative[1] < found.relative[0]
    freedom = 3 * 2  # of the three draws, one pair of neighbours each
    np.testing.assert_allclose(found.bounds[0], scipy.stats.chi2.ppf([0.0005, 0.9995], freedom) / freedom)
