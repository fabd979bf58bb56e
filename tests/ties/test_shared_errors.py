"""Navigation errors that images share: their covariance is that of dense least squares with the joint prior."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.drone_strip import ABOVE, SENSOR
from support.surveyed_strip import COUNT, shots

from jaxgeo import Exposure, Pose, Shot
from jaxgeo.adjust import ImagePoints
from jaxgeo.rotations import R_from_heading_pitch_roll, heading_pitch_roll_from_R
from jaxgeo.studies.gu2017.scene import moved
from jaxgeo.ties import Correction, Views, correct
from jaxgeo.uncertainty import PerFlight, TimeCorrelated, sources

DURATION = 20.0  # s: correlation time of the attitude
PIXEL = 0.2  # px
POSITION, OFFSET, ATTITUDE, BORESIGHT = 0.3, 2.0, np.deg2rad(0.2), np.deg2rad(0.5)
FADING = TimeCorrelated(DURATION, strength=0.9)
ERRORS = (
    sources.Position(np.full(3, POSITION)),
    sources.Position(np.full(3, OFFSET), sharing=PerFlight()),
    sources.Attitude(np.full(3, ATTITUDE), sharing=FADING),
    sources.Boresight(np.full(3, BORESIGHT)),
)


def views_of(given: list[Shot], flight: object = None) -> Views:
    names = [f"image {k}" for k in range(len(given))]
    return Views.of(names, [Exposure(SENSOR, one) for one in given], [ERRORS] * len(given), flight)


def joint(views: Views) -> np.ndarray:
    """Covariance (6n, 6n) of the poses by moving each shot by each error."""
    steps = []
    for shot, centre, R in zip(shots(), views.centre, views.R_frame_from_camera, strict=True):
        columns = []
        for k, step in enumerate(np.diag([0.1] * 3 + [1e-4] * 3)):
            there = views_of([moved(shot, step[:3], step[3:])] * 2)
            place = np.asarray(views.frame.from_ecef(np.asarray(there.frame.to_ecef(there.centre[0]))))
            turned = np.asarray(views.frame.R_ecef_from_local).T @ np.asarray(there.frame.R_ecef_from_local)
            turn = Rotation.from_matrix(R.T @ turned @ there.R_frame_from_camera[0]).as_rotvec()
            columns.append(np.concatenate([place - centre, turn]) / step[k])
        steps.append(np.stack(columns, axis=1))
    # A boresight turns the camera about the axes of the body, whose orientation by the camera's is that of the mount.
    R_camera_from_body = np.asarray(SENSOR.mount.R_body_from_base @ SENSOR.mount.R_head_from_camera).T
    total = np.zeros((COUNT, 6, COUNT, 6))
    for i in range(COUNT):
        for j in range(COUNT):
            by_position, by_attitude = steps[i][:, :3] @ steps[j][:, :3].T, steps[i][:, 3:] @ steps[j][:, 3:].T
            fading = 1.0 if i == j else 0.9 * np.exp(-2.0 * abs(i - j) / DURATION)
            total[i, :, j] = (POSITION**2 * (i == j) + OFFSET**2) * by_position + ATTITUDE**2 * fading * by_attitude
            total[i, 3:, j, 3:] += BORESIGHT**2 * R_camera_from_body @ R_camera_from_body.T
    return total.reshape(6 * COUNT, 6 * COUNT)


def measured(views: Views) -> ImagePoints:
    """Exact pixels of a lattice of ground points in all images that see them."""
    rng = np.random.default_rng(1)
    middle = views.centre.mean(axis=0)
    ground = np.stack(np.meshgrid(np.linspace(-60, 60, 7), np.linspace(-130, 130, 15)), axis=-1).reshape(-1, 2)
    ground = np.column_stack([middle[:2] + ground, middle[2] - ABOVE + rng.uniform(-15.0, 15.0, len(ground))])
    rows = []
    for image in range(COUNT):
        uv = pixels(views.centre[image], views.R_frame_from_camera[image], ground)
        inside = np.all((uv > 0.0) & (uv < [255.0, 191.0]), axis=1)
        rows += [(f"image {image}", f"tie {k}", uv[k]) for k in np.flatnonzero(inside)]
    names = [point for _, point, _ in rows]
    rows = [row for row in rows if names.count(row[1]) > 1]
    image, point, uv = zip(*rows, strict=True)
    return ImagePoints(list(image), list(point), np.array(uv), PIXEL)


def pixels(centre: np.ndarray, R: np.ndarray, ground: np.ndarray) -> np.ndarray:
    there = (ground - centre) @ R
    camera = SENSOR.camera
    return np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * there[:, :2] / there[:, 2:]  # pyright: ignore


def dense(found: Correction, prior: np.ndarray) -> np.ndarray:
    """Covariance of the poses by least squares of the measurements with the prior of all poses together."""
    images, observed = found.adjustment.images, found.adjustment.block.observations
    points = found.adjustment.points
    number = {name: k for k, name in enumerate(points.name.tolist())}
    normal = np.zeros((6 * COUNT + 3 * len(number),) * 2)
    normal[: 6 * COUNT, : 6 * COUNT] = np.linalg.inv(prior)
    for name, point, sigma in zip(observed.image.tolist(), observed.point.tolist(), observed.sigma, strict=True):
        image, k = found.names.index(name), number[point]
        centre, R, place = images.centre[image], images.R_frame_from_camera[image], points.place[k]
        columns = []
        for step in np.eye(9) * 1e-5:
            ahead, behind = (
                pixels(
                    centre + sign * step[:3],
                    R @ Rotation.from_rotvec(sign * step[3:6]).as_matrix(),
                    (place + sign * step[6:])[None],
                )[0]
                for sign in (1.0, -1.0)
            )
            columns.append((ahead - behind) / 2e-5)
        J = np.stack(columns, axis=1) / sigma[:, None]
        at = np.r_[6 * image : 6 * image + 6, 6 * COUNT + 3 * k : 6 * COUNT + 3 * k + 3]
        normal[np.ix_(at, at)] += J.T @ J
    return np.linalg.inv(normal)[: 6 * COUNT, : 6 * COUNT]


@pytest.mark.costly
def test_shared_errors_are_unknowns_with_the_joint_prior() -> None:
    views = views_of(shots())
    prior = joint(views)
    for image in range(COUNT - 1):
        at = np.s_[6 * image : 6 * image + 12]
        scale = np.sqrt(np.diagonal(prior[at, at]))
        assert np.allclose(
            views.covariance_of_pair(image, image + 1) / np.outer(scale, scale),
            prior[at, at] / np.outer(scale, scale),
            atol=1e-4,
        )
    found = correct(views, measured(views))
    expected = dense(found, prior)
    scale = np.sqrt(np.diagonal(expected))
    obtained = found.adjustment.covariance[: 6 * COUNT, : 6 * COUNT]
    assert np.allclose(obtained / np.outer(scale, scale), expected / np.outer(scale, scale), atol=2e-3)
    shift = np.sqrt(OFFSET**2 + POSITION**2 / COUNT)
    assert np.allclose(found.sigma_of_mean, shift, rtol=1e-6)
    assert all(found.adjustment.common[f"position 2: {axis}"][1] > 0.99 for axis in ("north", "east", "down"))


def test_flights_share_their_own_errors() -> None:
    views = views_of(shots(), flight=[0, 0, 0, 1, 1])
    between = views.covariance_of_pair(2, 3)[:6, 6:]
    within = views.covariance_of_pair(3, 4)[:6, 6:]
    assert np.allclose(between, 0.0)
    assert np.trace(within[:3, :3]) == pytest.approx(3.0 * OFFSET**2, rel=1e-6)
    assert np.allclose(views.covariance_of_pair(0, 1)[:6, :6], views_of(shots()).covariance[0])


def test_flights_are_whole_numbers_of_each_image() -> None:
    with pytest.raises(ValueError, match="flight must be one whole number"):
        views_of(shots(), flight=[0, 1])


def drawn(seed: int) -> np.ndarray:
    """Errors (n, 6) of position (north, east, down) and attitude (heading, pitch, roll) of each shot."""
    rng = np.random.default_rng(seed)
    apart = np.abs(np.subtract.outer(2.0 * np.arange(COUNT), 2.0 * np.arange(COUNT)))
    correlation = np.where(apart == 0.0, 1.0, 0.9 * np.exp(-apart / DURATION))
    position = POSITION * rng.normal(size=(COUNT, 3)) + OFFSET * rng.normal(size=3)
    return np.hstack([position, ATTITUDE * np.linalg.cholesky(correlation) @ rng.normal(size=(COUNT, 3))])


def erring(shot: Shot, errors: np.ndarray, boresight: np.ndarray) -> Shot:
    """A shot with errors of position and attitude, whose body is turned by a boresight."""
    off = moved(shot, errors[:3], errors[3:])
    pose = off.pose
    R = R_from_heading_pitch_roll(*map(jnp.asarray, (pose.heading, pose.pitch, pose.roll)))
    turned = heading_pitch_roll_from_R(R @ Rotation.from_rotvec(boresight).as_matrix())
    return Shot(Pose(pose.position, *turned), off.gimbal_readings, shot.time)


def errors_of(true: Views, given: Views, centre: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Errors (n, 6) of orientations in the frame of `given`."""
    place = np.asarray(given.frame.from_ecef(np.asarray(true.frame.to_ecef(true.centre))))
    turn = np.asarray(given.frame.R_ecef_from_local).T @ np.asarray(true.frame.R_ecef_from_local)
    turned = np.swapaxes(turn @ true.R_frame_from_camera, 1, 2) @ R
    return np.concatenate([centre - place, Rotation.from_matrix(turned).as_rotvec()], axis=1)


def apart(true: Views, errors: np.ndarray) -> float:
    """RMS distance in m between the places of the point midway below neighbouring images, on ground that is shifted
    with all positions: a common shift upwards alone sets places apart."""
    errors = errors - np.append(errors[:, :3].mean(axis=0), np.zeros(3))
    shifts = []
    for k in range(COUNT - 1):
        ground = 0.5 * (true.centre[k] + true.centre[k + 1]) - np.array([0.0, 0.0, ABOVE])
        both = []
        for image in (k, k + 1):
            R = true.R_frame_from_camera[image]
            ray = ground - true.centre[image]
            turned = R @ (Rotation.from_rotvec(errors[image, 3:]).as_matrix() @ (R.T @ ray))
            both.append(
                true.centre[image, :2] + errors[image, :2] + turned[:2] * (ray[2] - errors[image, 2]) / turned[2]
            )
        shifts.append(both[0] - both[1])
    return float(np.sqrt(np.mean(np.sum(np.square(shifts), axis=1))))


@pytest.mark.costly
def test_errors_of_a_sequence_are_as_predicted() -> None:
    """Over several draws: squared errors by their covariance are chi-square, neighbours agree five times better than by
    the navigation, positions are no worse than their priors, and a shift of all positions stays to the last
    millimetre."""
    true, seeds = views_of(shots()), 6
    seen = measured(true)
    squares, before, after, over_prior = 0.0, [], [], []
    for seed in range(seeds):
        boresight = BORESIGHT * np.random.default_rng([seed, 1]).normal(size=3)
        given = views_of([erring(shot, one, boresight) for shot, one in zip(shots(), drawn(seed), strict=True)])
        uv = seen.uv + PIXEL * np.random.default_rng(seed).normal(size=seen.uv.shape)
        found = correct(given, ImagePoints(seen.image, seen.point, uv, seen.sigma))
        errors = errors_of(true, given, found.adjustment.images.centre, found.adjustment.images.R_frame_from_camera)
        covariance = found.adjustment.covariance[: 6 * COUNT, : 6 * COUNT]
        squares += errors.ravel() @ np.linalg.solve(covariance, errors.ravel())
        before.append(apart(true, errors_of(true, given, given.centre, given.R_frame_from_camera)))
        after.append(apart(true, errors))
        over_prior.append(np.sqrt(np.mean(errors[:, :3] ** 2)) / np.hypot(POSITION, OFFSET))
        sigma = np.sqrt(np.diagonal(covariance)).reshape(COUNT, 6)
        assert np.all(sigma <= 1.0001 * np.sqrt(np.diagonal(given.covariance, axis1=1, axis2=2)))
    freedom = 6 * COUNT * seeds
    assert abs(squares - freedom) < 3.0 * np.sqrt(2.0 * freedom)
    assert np.linalg.norm(after) < np.linalg.norm(before) / 5.0
    assert np.sqrt(np.mean(np.square(over_prior))) < 1.3  # of 18 numbers
    assert "shift of all positions" in found.words()
    assert "position 2: north" in found.words()


@pytest.mark.costly
def test_a_shift_of_all_positions_stays() -> None:
    views = views_of(shots())
    shift = np.array([5.0, -3.0, 2.0])
    seen = measured(views)
    found = [
        correct(views_of([erring(shot, np.append(one, [0.0] * 3), np.zeros(3)) for shot in shots()]), seen)
        for one in (np.zeros(3), shift)
    ]
    places = [np.asarray(one.views.frame.to_ecef(one.adjustment.images.centre)) for one in found]
    moved_by = (places[1] - places[0]) @ np.asarray(found[0].views.frame.R_ecef_from_local)
    assert np.allclose(moved_by, shift[[1, 0, 2]] * [1.0, 1.0, -1.0], atol=1e-3)  # north, east, down to east, north, up
