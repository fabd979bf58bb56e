"""Several cameras on one mount: what images of one shot share, what each camera has alone, and what it brings."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.rig_flight import (
    ATTITUDE,
    ERRORS,
    LEVER,
    MOUNTING,
    OFFSET,
    POSITION,
    SENSORS,
    STEP,
    WIDE,
    Rig,
    drawn,
    errors_of,
    measured,
    sensor_of,
    sight_of,
)

from jaxgeo import Exposure, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.earth import R_ecef_from_ned
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_NADIR
from jaxgeo.ties import Correction, Views, correct
from jaxgeo.ties.rigs import of_cross, second_order
from jaxgeo.uncertainty import PerFlight, PerMeasurement, TimeCorrelated, sources

COUNT = 28  # images of 14 shots
SEEDS = 10
SIGMA = np.concatenate([[POSITION] * 3, [OFFSET] * 3, [ATTITUDE] * 3, [MOUNTING] * 3, [LEVER] * 3])


@pytest.fixture(scope="module")
def rig() -> Rig:
    return drawn(0)


@pytest.fixture(scope="module")
def views(rig: Rig) -> Views:
    return rig.views()


def derivatives(views: Views, row: int) -> np.ndarray:
    """(6, 15) of the pose of an image by the errors of `ERRORS`, by differences."""
    R = np.asarray(views.frame.R_ecef_from_local)
    columns = []
    for step in np.eye(15) * 1e-3:
        ahead, behind = ([np.asarray(x) for x in sight_of(views.exposure[row], sign * step)] for sign in (1.0, -1.0))
        move = R.T @ (ahead[0] - behind[0])
        turn = Rotation.from_matrix(behind[1].T @ ahead[1]).as_rotvec()
        columns.append(np.concatenate([move, turn]) / 2e-3)
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("both, shared", [((4, 5), 9), ((4, 6), None), ((4, 7), 6)])
def test_pairs_share_what_their_shot_their_camera_and_their_flight_share(views: Views, both, shared) -> None:
    """Two cameras of one shot: position and attitude; one camera in two shots: offset and mounting; else the offset."""
    first, second = (derivatives(views, row) for row in both)
    same = np.zeros(15)
    same[3:6] = 1.0
    if shared == 9:
        same[:9] = 1.0
    elif shared is None:
        same[9:] = 1.0
    expected = (first * SIGMA**2 * same) @ second.T
    scale = np.outer(*(np.sqrt(np.diagonal(views.covariance[row])) for row in both))
    assert np.max(np.abs(views.covariance_of_pair(*both)[:6, 6:] - expected) / scale) < 3e-5
    own = (first * SIGMA**2) @ first.T
    assert np.max(np.abs(views.covariance[both[0]] - own)[:3] / np.sqrt(np.outer(*2 * [np.diagonal(own)]))[:3]) < 1e-4


def relative(views: Views, first: int, second: int) -> np.ndarray:
    """Covariance (6, 6) of the orientation of an image in the axes of another, by their joint covariance."""
    one, other = views.R_frame_from_camera[first], views.R_frame_from_camera[second]
    away = one.T @ (views.centre[second] - views.centre[first])
    x, y, z = away
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    zero = np.zeros((3, 3))
    J = np.block([[-one.T, cross, one.T, zero], [zero, -np.eye(3), zero, one.T @ other]])
    return J @ views.covariance_of_pair(first, second) @ J.T


def of_their_own_poses(rig: Rig, views: Views) -> list[Exposure]:
    """The same cameras with orientations of their own in place of that of the aircraft, as tables have them."""
    found = []
    for row, exposure in enumerate(rig.exposures):
        place = views.frame.to_geodetic(views.centre[row])
        R_ecef_from_camera = np.asarray(views.frame.R_ecef_from_local) @ views.R_frame_from_camera[row]
        R = jnp.asarray(np.asarray(R_ecef_from_ned(place)).T @ R_ecef_from_camera @ R_HEAD_FROM_CAMERA_NADIR.T)
        pose = Pose(place, *heading_pitch_roll_from_R(R))
        sensor = Sensor(exposure.sensor.camera, Gimbal.fixed(), Mount.nadir())
        assert isinstance(exposure.motion, Shot)
        found.append(Exposure(sensor, Shot(pose, np.zeros(0), exposure.motion.time)))
    return found


@pytest.mark.parametrize("own_poses", [False, True])
@pytest.mark.parametrize(
    "attitude",
    [
        sources.Attitude(np.array([0.01, 0.002, 0.004])),
        sources.Attitude(np.array([0.01, 0.002, 0.004]), sharing=TimeCorrelated(20.0, strength=0.7)),
        sources.Attitude(np.array([0.01, 0.002, 0.004]), sharing=PerFlight()),
    ],
    ids=["each", "in time", "of the flight"],
)
def test_a_shot_moves_as_one_rigid_body(rig: Rig, views: Views, own_poses: bool, attitude) -> None:
    """Whatever pose its orientations are of, that of the aircraft or that of each camera; but for the mounting."""
    exposures = of_their_own_poses(rig, views) if own_poses else rig.exposures
    errors = [(sources.Position(np.full(3, POSITION)), attitude)] * COUNT
    shared = Views.of(rig.names, exposures, errors, shot=rig.shot)
    places = [np.asarray(one.frame.to_ecef(one.centre)) for one in (shared, views)]
    assert np.allclose(*places, atol=1e-6)
    for shot in (0, 5):
        assert np.max(np.abs(relative(shared, 2 * shot, 2 * shot + 1))) < 1e-15
    apart = Views.of(rig.names, exposures, errors)
    turned = np.sqrt(np.trace(relative(apart, 0, 1)[3:, 3:]))
    assert turned > (3e-4 if own_poses or not isinstance(attitude.sharing, PerFlight) else -1.0)


def test_errors_in_time_are_one_for_a_shot_and_fade_from_shot_to_shot(rig: Rig) -> None:
    fading = sources.Position(np.full(3, 2.0), sharing=TimeCorrelated(20.0, strength=0.7))
    errors = [(fading, sources.Attitude(np.full(3, 0.01)))] * COUNT
    given = Views.of(rig.names, rig.exposures, errors, shot=rig.shot)

    def between(first: int, second: int) -> float:
        return float(np.trace(given.covariance_of_pair(first, second)[:3, 6:9])) / 3.0

    assert between(0, 1) == pytest.approx(4.0, rel=1e-3)  # the attitude moves the levers by a little
    assert between(0, 4) == pytest.approx(4.0 * 0.7 * np.exp(-2.0 * STEP / 20.0), rel=1e-3)
    assert between(0, 5) == pytest.approx(4.0 * 0.7 * np.exp(-2.0 * STEP / 20.0), rel=1e-3)


def test_errors_of_each_measurement_stay_those_of_each_image(rig: Rig) -> None:
    own = sources.Position(np.full(3, 0.05), sharing=PerMeasurement())
    given = Views.of(rig.names, rig.exposures, [(*ERRORS[2:4], own)] * COUNT, shot=rig.shot)
    assert np.trace(given.own[0][:3, :3]) == pytest.approx(3.0 * 0.05**2, rel=0.01)


def test_mountings_are_of_the_camera_and_boresights_of_the_gimbal_head(rig: Rig) -> None:
    errors = (*ERRORS[:3], sources.Boresight(np.full(3, 0.01)), sources.CameraMounting(np.full(3, 0.01)))

    def names_of(sensors: tuple[Sensor, Sensor]) -> set[str]:
        exposures = [Exposure(sensors[k % 2], one.motion) for k, one in enumerate(rig.exposures)]
        found = Views.of(rig.names, exposures, [errors] * COUNT, shot=rig.shot)
        return {name for name in found.common if "shot" not in name}

    wide, infrared = SENSORS
    one_head = replace(infrared, mount=replace(infrared.mount, lever_body=wide.mount.lever_body))
    apart = {f"boresight: {axis}, camera {k}" for axis in ("heading", "pitch", "roll") for k in (1, 2)}
    assert apart < names_of((wide, infrared))
    together = names_of((wide, one_head))
    assert {"boresight: heading", "boresight: pitch", "boresight: roll"} < together
    assert {f"camera mounting: {axis}, camera {k}" for axis in ("forward", "right", "down") for k in (1, 2)} < together


def test_without_shots_nothing_is_of_a_camera(rig: Rig, views: Views) -> None:
    plain = rig.views(shot=None)
    assert plain.shot is None
    assert set(plain.common) == {
        *(f"position 2: {axis}" for axis in ("north", "east", "down")),
        *(f"{what}: {axis}" for what in ("camera mounting", "lever arm") for axis in ("forward", "right", "down")),
    }
    alone = rig.views(shot=np.arange(COUNT))
    for row in range(COUNT):
        assert np.allclose(alone.covariance[row], plain.covariance[row], rtol=1e-12, atol=1e-18)
    of_wide = np.flatnonzero(rig.camera == "W")
    one_camera = [
        Views.of(np.array(rig.names)[of_wide], [rig.exposures[k] for k in of_wide], [ERRORS] * len(of_wide), shot=shot)
        for shot in (None, rig.shot[of_wide])
    ]
    assert np.array_equal(one_camera[0].own, one_camera[1].own)
    assert list(one_camera[0].common) == list(one_camera[1].common)
    for name, effects in one_camera[0].common.items():
        assert np.array_equal(effects, one_camera[1].common[name])


def test_equal_cameras_are_told_apart_by_their_mounts_or_by_name(rig: Rig) -> None:
    left, right = (sensor_of(WIDE, 0.0, (0.0, side, 0.0)) for side in (-0.5, 0.5))

    def views_of(sensors: tuple[Sensor, Sensor], **how: Any) -> Views:
        exposures = [Exposure(sensors[k % 2], one.motion) for k, one in enumerate(rig.exposures)]
        return Views.of(rig.names, exposures, [ERRORS] * COUNT, **how)

    assert set(views_of((left, right), shot=rig.shot).camera) == {"1", "2"}
    assert set(views_of((left, right)).camera) == {"1"}
    with pytest.raises(ValueError, match=r"image_00_W and image_00_T are both of shot 0 and of camera 1.*camera="):
        views_of((left, left), shot=rig.shot)
    assert set(views_of((left, left), shot=rig.shot, camera=rig.camera).camera) == {"W", "T"}
    with pytest.raises(ValueError, match=r"of camera 'W', but their focal length.*differ"):
        rig.views(camera=["W"] * COUNT)
    with pytest.raises(ValueError, match="camera must be one name for each of 28 images; got 1"):
        rig.views(camera=["W"])


def swapped(rig: Rig, first: int, second: int) -> np.ndarray:
    """Shots in which two images of the second camera are exchanged."""
    shot = rig.shot.copy()
    shot[[2 * first + 1, 2 * second + 1]] = second, first
    return shot


def test_mixed_up_shots_are_refused_with_what_shows_it(rig: Rig) -> None:
    shot, still = swapped(rig, 3, 4), rig.exposures[0].motion
    assert isinstance(still, Shot)
    hovering = [
        Exposure(one.sensor, Shot(still.pose, np.zeros(0), 100.0 + STEP * k))
        for one, k in zip(rig.exposures, rig.shot.tolist(), strict=True)
    ]
    with pytest.raises(ValueError, match=r"image_04_W and image_03_T are both of shot 4.* 30\.2 m apart.* 0 m\. Are"):
        rig.views(shot=shot)
    with pytest.raises(ValueError, match=r"of shot [34], but their times are -?2 s apart, those of other.* 0 s\. Are"):
        replace(rig, exposures=hovering).views(shot=shot)
    with pytest.raises(ValueError, match="image_00_W and image_01_W are both of shot 0 and of camera 1"):
        rig.views(shot=rig.shot // 2)
    with pytest.raises(ValueError, match="image_00_W and image_00_T are both of shot 0, but of flights 0 and 1"):
        rig.views(flight=np.arange(COUNT) % 2)


@pytest.mark.parametrize("shot", [[0, 1], np.zeros((28, 1), int), np.arange(28.0), ["a"] * 28])
def test_shots_are_whole_numbers_of_each_image(rig: Rig, shot) -> None:
    with pytest.raises(ValueError, match="shot must be one whole number for each of 28 images"):
        rig.views(shot=shot)


def test_covariance_of_a_cross_product_is_that_of_draws() -> None:
    rng = np.random.default_rng(0)
    A, B = (M @ M.T for M in rng.normal(size=(2, 3, 3)))
    a, b = (rng.multivariate_normal(np.zeros(3), C, size=400_000) for C in (A, B))
    found, drawn_ = of_cross(A, B), np.cov(np.cross(a, b).T)
    assert np.max(np.abs(found - drawn_)) < 0.02 * np.max(np.abs(found))


def test_second_order_is_what_a_sum_of_rotations_lacks() -> None:
    rng = np.random.default_rng(1)
    A, B = (1e-4 * M @ M.T for M in rng.normal(size=(2, 3, 3)))
    a, b = (rng.multivariate_normal(np.zeros(3), C, size=100_000) for C in (A, B))
    lacking = (Rotation.from_rotvec(a) * Rotation.from_rotvec(b)).as_rotvec() - a - b
    mounting = np.zeros((6, 6))
    mounting[3:, 3:] = B
    found = second_order(A, mounting, np.eye(3))[3:, 3:]
    assert np.max(np.abs(found - np.cov(lacking.T))) < 0.05 * np.max(np.abs(found))


@pytest.fixture(scope="module")
def found(rig: Rig, views: Views) -> Correction:
    return correct(views, measured(rig, views, 0))


@pytest.mark.costly
def test_words_name_cameras_and_no_shots(found: Correction) -> None:
    words = found.words()
    assert "Camera 2 against camera 1, in 14 shots: turned by" in words
    assert ", shot " not in words
    assert any(", shot 3" in name for name in found.adjustment.common)
    assert "lever arm: forward, camera 2" in words  # a shift that images alone do not show


@pytest.mark.costly
def test_a_shot_joins_its_images_where_no_tie_point_does(rig: Rig, views: Views, found: Correction) -> None:
    """With no tie point between the cameras, and too few between the infrared images; to the same programs."""
    seen = found.adjustment.block.observations
    of_infrared = np.char.endswith(seen.image, "T")
    names = np.unique(seen.point[of_infrared])
    few = ~of_infrared | np.isin(seen.point, names[::4])
    few &= ~(of_infrared & np.isin(seen.point, np.unique(seen.point[~of_infrared])))
    points = seen.of(few).seen_often()
    without = correct(rig.views(shot=None), points)
    assert sorted(without.names) == sorted(name for name in rig.names if name.endswith("W"))
    joined = correct(views, points)
    infrared = [name for name in joined.names if name.endswith("T")]
    assert len(infrared) >= 10
    assert joined.unconnected == [name for name in rig.names if name not in joined.names]
    errors = errors_of(rig, joined)
    covariance = joined.adjustment.covariance_of_images
    chosen = [k for k, name in enumerate(joined.names) if name in infrared]
    squares = [errors[k] @ np.linalg.solve(covariance[k], errors[k]) for k in chosen]
    assert np.max(squares) < 35.0  # of six degrees of freedom, 5e-6
    turned = np.sqrt(np.diagonal(covariance[chosen], axis1=1, axis2=2)[:, 3:])
    navigation = np.sqrt(np.diagonal(views.covariance[0])[3:])
    assert np.all(turned < 0.75 * navigation)


def steady(rig: Rig, found: Correction) -> tuple[float, float]:
    """RMS in m and rad of the errors of the infrared images that they do not all have."""
    errors = errors_of(rig, found)
    errors[:, 3:] = np.einsum("nij,nj->ni", found.adjustment.images.R_frame_from_camera, errors[:, 3:])
    chosen = errors[[name.endswith("T") for name in found.names]]
    chosen = chosen - chosen.mean(axis=0)
    return float(np.sqrt(np.mean(chosen[:, :3] ** 2))), float(np.sqrt(np.mean(chosen[:, 3:] ** 2)))


@pytest.mark.slow
def test_errors_are_as_predicted_and_the_weak_camera_gains() -> None:
    """Over draws of all errors: squared errors of all images, of those of each camera and of the relative orientation
    by their covariances are chi-square; and images of the infrared camera, of few ties, err less than without shots."""
    squares: dict[str, float] = dict.fromkeys(("all", "T", "W", "relative"), 0.0)
    gains = []
    for seed in range(SEEDS):
        rig = drawn(seed)
        views = rig.views()
        seen = measured(rig, views, seed)
        found, apart = correct(views, seen), correct(rig.views(shot=None), seen)
        assert len(found.names) == len(apart.names) == COUNT
        errors = errors_of(rig, found)
        covariance = found.adjustment.covariance[: 6 * COUNT, : 6 * COUNT].reshape(COUNT, 6, COUNT, 6)
        for what in ("all", "T", "W"):
            own = [k for k, name in enumerate(found.names) if what in ("all", name[-1])]
            C = covariance[own][:, :, own].reshape(6 * len(own), -1)
            squares[what] += float(errors[own].ravel() @ np.linalg.solve(C, errors[own].ravel()))
        (one,) = found.relative_orientations
        R = [rig.R_frame_from_camera[k] for k in (0, 1)]
        stated = [views.R_frame_from_camera[k] for k in (0, 1)]
        true = Rotation.from_matrix(R[0].T @ R[1] @ stated[1].T @ stated[0]).as_rotvec()
        squares["relative"] += float(np.sum(((one.turned - true) / one.sigma_turned) ** 2))
        assert np.all(one.sigma_turned < 0.1 * np.sqrt(2.0) * MOUNTING)
        gains.append(np.array(steady(rig, apart)) / np.array(steady(rig, found)))
    for what, freedom in {"all": 6 * COUNT, "T": 3 * COUNT, "W": 3 * COUNT, "relative": 3}.items():
        assert abs(squares[what] - freedom * SEEDS) < 3.0 * np.sqrt(2.0 * freedom * SEEDS), what
    assert np.all(np.median(gains, axis=0) > 1.4)
