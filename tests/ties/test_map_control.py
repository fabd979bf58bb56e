"""Images registered to a map among images tied to each other: against dense least squares, and against drawn truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.drone_strip import ABOVE, CAMERA, GROUND, SENSOR
from support.registered_strip import (
    ATTITUDE,
    ERRORS,
    HEIGHT,
    OFFSET,
    POSITION,
    STRENGTH,
    TERRAIN,
    TIE_ERRORS,
    WIDTH,
    Drawn,
    drawn,
    errors_of,
    pixels,
    registered,
    shots,
    views_of,
)

from jaxgeo import Atmosphere, Bisection, Exposure, Pose, Shot, locate
from jaxgeo.adjust import ImagePoints, LeastSquares, Prior, Unknowns
from jaxgeo.io import example_dem
from jaxgeo.register import Outcome, Registration, TieErrors, TiePoints, update_orientation
from jaxgeo.ties import Control, Correction, MapControl, Views, correct
from jaxgeo.ties.map_control import measured_by
from jaxgeo.ties.views import oriented
from jaxgeo.uncertainty import ErrorModel, PerFlight, TimeCorrelated, sources

pytestmark = pytest.mark.costly

COUNT, ROW, SEEDS = 9, 2, 4  # one shape of all problems, whose programs are compiled once


def control_of(of: Drawn, found: dict[int, Registration]) -> MapControl:
    return MapControl.of(of.given, {str(of.given.name[row]): one for row, one in found.items()}, TERRAIN)


def prior_of(views: Views) -> np.ndarray:
    """Joint covariance (6 n, 6 n) of the navigation."""
    n = len(views)
    total = np.zeros((n, 6, n, 6))
    for i in range(n):
        for j in range(n):
            pair = views.covariance_of_pair(i, j)
            total[i, :, j] = pair[:6, 6:] if i != j else pair[:6, :6]
    return total.reshape(6 * n, 6 * n)


def derivative(centre: np.ndarray, R: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Derivatives (2, 9) of a pixel by the pose and the point, by central differences."""
    columns = []
    for step in np.eye(9) * 1e-5:
        ends = [
            pixels(
                centre + s * step[:3], R @ Rotation.from_rotvec(s * step[3:6]).as_matrix(), (place + s * step[6:])[None]
            )
            for s in (1.0, -1.0)
        ]
        columns.append((ends[0] - ends[1])[0] / 2e-5)
    return np.stack(columns, axis=1)


def dense(found: Correction, prior: np.ndarray, ties: TiePoints, row: int) -> np.ndarray:
    """Covariance of all poses and of the shift by least squares with every tie and map point as an unknown."""
    images, observed, points = found.adjustment.images, found.adjustment.block.observations, found.adjustment.points
    number = {name: k for k, name in enumerate(points.name.tolist())}
    first = 6 * COUNT
    of_map = first + 3 * len(number)
    shift = of_map + 3 * ties.count
    normal = np.zeros((shift + 2,) * 2)
    normal[:first, :first] = np.linalg.inv(prior)
    for name, point, sigma in zip(observed.image.tolist(), observed.point.tolist(), observed.sigma, strict=True):
        image, k = found.names.index(name), number[point]
        J = derivative(images.centre[image], images.R_frame_from_camera[image], points.place[k]) / sigma[:, None]
        at = np.r_[6 * image : 6 * image + 6, first + 3 * k : first + 3 * k + 3]
        normal[np.ix_(at, at)] += J.T @ J
    ground = replace(ties.ground, height=jnp.full(ties.count, GROUND))
    places = np.asarray(found.views.frame.from_geodetic(ground))
    sigma = np.array([float(TIE_ERRORS.registration)] * 2 + [float(TIE_ERRORS.terrain)])
    for k, place in enumerate(places):
        J = derivative(images.centre[row], images.R_frame_from_camera[row], place) / float(ties.pixel_sigma)
        at = np.r_[6 * row : 6 * row + 6, of_map + 3 * k : of_map + 3 * k + 3]
        normal[np.ix_(at, at)] += J.T @ J
        # The map shows the point plus the shift; its height is that of the terrain.
        by = np.zeros((3, 5))
        by[:, :3], by[0, 3], by[1, 4] = np.diag(1.0 / sigma), 1.0 / sigma[0], 1.0 / sigma[1]
        at = np.r_[of_map + 3 * k : of_map + 3 * k + 3, shift, shift + 1]
        normal[np.ix_(at, at)] += by.T @ by
    normal[shift:, shift:] += np.eye(2) / float(TIE_ERRORS.shift) ** 2
    covariance = np.linalg.inv(normal)
    wanted = np.r_[:first, shift, shift + 1]
    return covariance[np.ix_(wanted, wanted)]


def test_covariance_is_that_of_dense_least_squares() -> None:
    of = drawn(0, COUNT, disturbed=False)  # so that the loss of the registration weighs no tie less
    registration = registered(of, ROW)
    found = correct(of.given, of.seen, map_control=control_of(of, {ROW: registration}))
    expected = dense(found, prior_of(of.given), registration.ties, ROW)
    scale = np.sqrt(np.diagonal(expected))
    columns = [name for _, name in found.adjustment.columns]
    own = np.r_[: 6 * COUNT, columns.index("map: shift east"), columns.index("map: shift north")]
    obtained = found.adjustment.covariance[np.ix_(own, own)]
    obtained[:, -2:] *= float(TIE_ERRORS.shift)
    obtained[-2:] *= float(TIE_ERRORS.shift)
    assert np.max(np.abs(obtained - expected) / np.outer(scale, scale)) < 2e-3


def test_errors_are_as_predicted() -> None:
    """Over draws with two registered images: squared errors by their covariance are chi-square, of the poses and of
    the map's shift, and positions are several times as good as without a map."""
    squares, shifts, before, after = 0.0, 0.0, [], []
    for seed in range(SEEDS):
        of = drawn(seed, COUNT)
        found = correct(of.given, of.seen, map_control=control_of(of, {ROW: registered(of, ROW), 7: registered(of, 7)}))
        assert not found.refused
        adjusted = found.adjustment
        errors = errors_of(of, found.names, adjusted.images.centre, adjusted.images.R_frame_from_camera)
        squares += errors.ravel() @ np.linalg.solve(adjusted.covariance[: 6 * COUNT, : 6 * COUNT], errors.ravel())
        of_shift = [adjusted.common[f"map: shift {axis}"] for axis in ("east", "north")]
        size = float(TIE_ERRORS.shift)
        shifts += sum(
            ((value - true / size) / left) ** 2 for (value, left), true in zip(of_shift, of.shift, strict=True)
        )
        before.append(errors_of(of, found.names, of.given.centre, of.given.R_frame_from_camera)[:, :3])
        after.append(errors[:, :3])
    freedom = 6 * COUNT * SEEDS
    assert abs(squares - freedom) < 3.0 * np.sqrt(2.0 * freedom)
    assert shifts < 2 * SEEDS + 3.0 * np.sqrt(4.0 * SEEDS)
    assert np.linalg.norm(after) < 0.6 * np.linalg.norm(before)


def test_uncertainty_grows_with_the_distance_from_the_registered_image() -> None:
    of = drawn(1, COUNT)
    loose = (
        sources.Position(np.full(3, 20.0)),
        sources.Position(np.full(3, 1e-3), sharing=PerFlight()),
        sources.Attitude(np.full(3, np.deg2rad(2.0)), sharing=TimeCorrelated(0.5, strength=STRENGTH)),
        sources.Boresight(np.full(3, 1e-6)),
    )
    given = views_of(shots(COUNT), loose)
    exact = TieErrors(registration=0.1, terrain=0.1, shift=1e-3)
    registration = registered(replace(of, given=given, shift=np.zeros(2)), 0, exact)
    control = MapControl.of(given, {"image 00": registration}, TERRAIN)
    found = correct(given, of.seen, map_control=control)
    size = np.linalg.norm(found.adjustment.sigma_of_images[:, :3], axis=1)
    assert np.all(np.diff(size[1:]) > 0.0)
    assert size[8] > 2.0 * size[1]
    navigation = np.sqrt(np.diagonal(given.covariance, axis1=1, axis2=2))
    assert np.all(found.adjustment.sigma_of_images[:, :3] < navigation[:, :3])
    free = correct(given, of.seen)
    assert np.all(size < np.linalg.norm(free.adjustment.sigma_of_images[:, :3], axis=1))


def test_without_a_map_the_common_shift_keeps_its_prior() -> None:
    of = drawn(0, COUNT)
    free = correct(of.given, of.seen)
    tied = correct(of.given, of.seen, map_control=control_of(of, {ROW: registered(of, ROW)}))
    for axis in ("north", "east", "down"):
        assert free.adjustment.common[f"position 2: {axis}"][1] > 0.98
        assert tied.adjustment.common[f"position 2: {axis}"][1] < 0.5
    assert np.all(tied.sigma_of_mean < 0.5 * free.sigma_of_mean)
    assert np.all(tied.sigma_of_mean[:2] > float(TIE_ERRORS.shift))  # the map's own shift stays
    assert "Registered to the map: image 02" in tied.words()
    assert "shift of all positions" in free.words()


def test_wrong_registrations_are_left_out() -> None:
    of = drawn(3, COUNT)
    good = {ROW: registered(of, ROW), 8: registered(of, 8)}
    wrong = registered(of, 6, blunder=(6.0, 0.0))  # well within the navigation's errors
    found = correct(of.given, of.seen, map_control=control_of(of, {**good, 6: wrong}))
    assert list(found.refused) == ["image 06"]
    assert found.map_control is not None
    assert found.map_control.names == ["image 02", "image 08"]
    expected = correct(of.given, of.seen, map_control=control_of(of, good))
    assert np.allclose(found.moved, expected.moved, atol=1e-6)
    assert "image 06" in found.words()
    # Of two that contradict each other nothing tells which one is wrong.
    both = correct(of.given, of.seen, map_control=control_of(of, {ROW: good[ROW], 6: wrong}))
    assert sorted(both.refused) == ["image 02", "image 06"]
    assert both.map_control is None
    assert np.allclose(both.moved, correct(of.given, of.seen).moved, atol=1e-9)
    # One alone is held against the navigation of all images.
    far = registered(of, ROW, blunder=(40.0, 0.0))
    assert list(correct(of.given, of.seen, map_control=control_of(of, {ROW: far})).refused) == ["image 02"]


def surveyed(of: Drawn) -> Control:
    """Three control points (5 cm, marks of 0.4 px) under images of the strip, with drawn errors."""
    places, rows = [], []
    for number, row in enumerate((1, 4, 7)):
        place = of.true.centre[row] + np.array([(-1.0) ** number * 25.0, 8.0, -ABOVE])
        for k in range(len(of.true)):
            (uv,) = pixels(of.true.centre[k], of.true.R_frame_from_camera[k], place[None])
            if np.all((uv > 0.0) & (uv < [WIDTH - 1, HEIGHT - 1])):
                rows.append((str(of.true.name[k]), f"G{number}", uv + 0.4 * of.rng.normal(size=2)))
        places.append(place + 0.05 * of.rng.normal(size=3))
    image, point, uv = zip(*rows, strict=True)
    position = of.true.frame.to_geodetic(np.array(places))
    return Control(["G0", "G1", "G2"], position, 0.05, ImagePoints(list(image), list(point), np.array(uv), 0.4))


def without(seen: ImagePoints, count: int) -> ImagePoints:
    """Ties without some of those of two rays, so that with as many control points a problem has the same shape."""
    names, rays = np.unique(seen.point, return_counts=True)
    return seen.of(~np.isin(seen.point, names[rays == 2][:count]))


def test_control_points_and_a_map_together() -> None:
    """Squared errors by their covariance are chi-square; control points show the map's shift, and which registration is
    wrong; the mean position is known better than by either alone."""
    squares, shifts = 0.0, 0.0
    for seed in range(2):
        of = drawn(seed, COUNT)
        points = surveyed(of)
        seen = without(of.seen, 3)
        on_map = control_of(of, {ROW: registered(of, ROW), 6: registered(of, 6)})
        found = correct(of.given, seen, control=points, map_control=on_map)
        assert not found.refused
        assert not found.blunders
        adjusted = found.adjustment
        errors = errors_of(of, found.names, adjusted.images.centre, adjusted.images.R_frame_from_camera)
        squares += errors.ravel() @ np.linalg.solve(adjusted.covariance[: 6 * COUNT, : 6 * COUNT], errors.ravel())
        for axis, true in zip(("east", "north"), of.shift, strict=True):
            value, left = adjusted.common[f"map: shift {axis}"]
            assert left < 0.5
            shifts += ((value - true / float(TIE_ERRORS.shift)) / left) ** 2
    for found, freedom in ((squares, 2 * 6 * COUNT), (shifts, 2 * 2)):
        assert abs(found - freedom) < 3.0 * np.sqrt(2.0 * freedom)
    both = correct(of.given, seen, control=points, map_control=on_map)
    alone = [correct(of.given, seen, control=points), correct(of.given, of.seen, map_control=on_map)]
    assert all(np.all(both.sigma_of_mean <= one.sigma_of_mean) for one in alone)
    assert "by control and map" in both.words()
    wrong = control_of(of, {ROW: registered(of, ROW, blunder=(6.0, -6.0))})
    refused = correct(of.given, seen, control=points, map_control=wrong)
    assert list(refused.refused) == ["image 02"]
    assert refused.map_control is None
    np.testing.assert_allclose(refused.adjustment.images.centre, alone[0].adjustment.images.centre, atol=1e-9)


def test_images_without_ties_do_not_carry_the_map() -> None:
    of = drawn(0, COUNT + 1)
    alone = ERRORS[0], sources.Attitude(np.full(3, ATTITUDE))
    given = Views.of(of.given.name.tolist(), of.given.exposure, [*[ERRORS] * COUNT, alone])
    of = replace(of, given=given)
    own = {f"tie {number}" for number in range(14 * COUNT)}  # those about the images that stay
    cut = of.seen.of((of.seen.image != "image 09") & np.isin(of.seen.point, list(own))).seen_often()
    found = correct(of.given, cut, map_control=control_of(of, {COUNT: registered(of, COUNT)}))
    assert "no tie points join" in found.refused["image 09"]
    assert found.unconnected == ["image 09"]


@pytest.mark.slow
def test_terrain_errors_are_common_where_they_are_stated_so() -> None:
    """A bias of the terrain stays: no map point shows it."""
    of = drawn(0, COUNT)
    registration = registered(of, ROW)
    bias = sources.TerrainHeight.from_metres(1.5)
    update = replace(registration.update, errors=ErrorModel((*ERRORS, bias)))
    biased = replace(registration, update=update)
    found, plain = (
        correct(of.given, of.seen, map_control=control_of(of, {ROW: one})).sigma_of_mean
        for one in (biased, registration)
    )
    of_navigation = OFFSET**2 + POSITION**2 / COUNT
    of_map = 1.0 / (1.0 / plain[2] ** 2 - 1.0 / of_navigation)
    assert np.isclose(1.0 / found[2] ** 2, 1.0 / of_navigation + 1.0 / (of_map + 1.5**2), rtol=0.05)


def test_correlated_heights_average_less_than_independent_ones() -> None:
    of = drawn(0, COUNT, disturbed=False)
    field = sources.TerrainField.of_variograms(gaussian=[(1.0, 300.0)])
    errors = (
        TieErrors(registration=0.1, terrain_field=field, shift=0.6),
        TieErrors(registration=0.1, terrain=1.0, shift=0.6),
    )
    sizes = []
    for one in errors:
        registration = replace(registered(of, ROW), tie_errors=one)
        sizes.append(correct(of.given, of.seen, map_control=control_of(of, {ROW: registration})).sigma_of_mean[2])
    assert sizes[0] > 2.0 * sizes[1]


def test_derivatives_by_the_lens_are_those_of_another_camera() -> None:
    of = drawn(0, COUNT)
    registration = registered(of, ROW)
    camera = CAMERA
    longer = replace(camera, focal_px=np.asarray(camera.focal_px) + 0.1)
    one, other = (measured_by(of.given.frame, lens, registration, TERRAIN, "image 02") for lens in (camera, longer))
    rows = np.hstack([one.by_pose, one.by_lens])
    there = np.hstack([other.by_pose, other.by_lens])
    # Rows are known up to a rotation, their products are not changed by it.
    change = there.T @ other.offset - rows.T @ one.offset
    expected = 0.1 * rows.T @ one.by_lens[:, 0]
    assert np.allclose(change, expected, atol=0.03 * np.max(np.abs(expected)))


@pytest.mark.slow
def test_self_calibration_takes_the_map_in() -> None:
    """A focal length that is off by 1 px: without a map it is the height of all images; with one it is found."""
    of = drawn(0, COUNT)
    camera = CAMERA
    off = replace(camera, focal_px=np.asarray(camera.focal_px) + 1.0)
    sensor = replace(SENSOR, camera=off)
    names = [str(name) for name in of.given.name]
    errors = (sources.Position(np.full(3, 0.3)), *ERRORS[2:])
    given = Views.of(names, [replace(one, sensor=sensor) for one in of.true.exposure], [errors] * COUNT)
    of = replace(of, given=given, shift=np.zeros(2))
    found = {row: registered(of, row) for row in (1, 7)}
    unknowns = Unknowns(focal=Prior(3.0))
    corrected = correct(
        given, of.seen, unknowns, map_control=MapControl.of(given, {names[k]: found[k] for k in found}, TERRAIN)
    )
    assert not corrected.refused
    free = correct(given, of.seen, unknowns)
    (focal,), (alone,) = corrected.adjustment.parameters, free.adjustment.parameters
    assert abs(focal.value - 240.0) < 3.5 * focal.sigma
    assert focal.sigma < alone.sigma


def test_control_that_cannot_be_used_is_refused() -> None:
    of = drawn(0, COUNT)
    good = registered(of, ROW)
    lost = Registration(Outcome.few_agree, SENSOR, good.shot, TERRAIN, None, TIE_ERRORS, None, ())
    other = registered(of, 5, TieErrors(registration=0.4, shift=5.0))
    with pytest.raises(ValueError, match="no registered image"):
        MapControl.of(of.given, {}, TERRAIN)
    with pytest.raises(ValueError, match="not among the views"):
        MapControl.of(of.given, {"elsewhere": good}, TERRAIN)
    with pytest.raises(ValueError, match="image 02 is not registered: few_agree"):
        control_of(of, {ROW: lost})
    with pytest.raises(ValueError, match="different standard deviations of the map's shift"):
        control_of(of, {ROW: good, 5: other})
    with pytest.raises(TypeError, match="map_control"):
        correct(of.given, of.seen, map_control={"image 02": good})  # pyright: ignore


SIDES = [[300.0, 50.0], [0.0, 400.0]]  # m: of a block, east and north


@pytest.mark.parametrize("air", [None, pytest.param(Atmosphere(), marks=pytest.mark.slow)], ids=["vacuum", "air"])
def test_observations_are_those_of_the_orientation_update(air: Atmosphere | None) -> None:
    """Over hills, oblique, also with refraction, with a common error of the terrain, and with one that is correlated
    and averaged over the blocks of the ties: the information of the map's points on the errors of position, attitude,
    terrain and map is that of the orientation update, posterior less prior."""
    terrain = example_dem()
    pose = Pose.from_degrees(lat=36.30, lon=-84.25, height=3000.0, heading=40.0, pitch=25.0, roll=-5.0)
    shot, search = Shot(pose, np.zeros(0)), Bisection()
    u, v = np.meshgrid(np.linspace(20, 235, 4), np.linspace(15, 175, 4))
    uv = np.column_stack([u.ravel(), v.ravel()])
    see = lambda one: locate(SENSOR, shot, one, terrain, search=search, atmosphere=air).position  # noqa: E731
    ground = jax.vmap(see)(jnp.asarray(uv))
    errors = (
        sources.Position.from_ned(north=5.0, east=6.0, down=7.0),
        sources.Attitude.from_degrees(heading=0.3, pitch=0.2, roll=0.4),
        sources.TerrainHeight.from_metres(2.0),
    )
    field = sources.TerrainField.of_variograms(gaussian=[(4.0, 600.0)])
    tie_errors = TieErrors(registration=1.5, terrain=3.0, shift=4.0, terrain_field=field)
    covariance, sides = (np.broadcast_to(np.array(one), (16, 2, 2)) for one in ([[0.5, 0.1], [0.1, 0.3]], SIDES))
    ties = TiePoints(uv, ground, covariance, 0.2, sides=sides)
    options: dict[str, Any] = {"atmosphere": air, "loss": LeastSquares()}
    update = update_orientation(SENSOR, shot, ties, terrain, ErrorModel(errors), tie_errors, **options)
    found = Registration(Outcome.registered, update.sensor, update.shot, update.terrain, update, tie_errors, ties, ())
    views = Views.of(["a", "b"], [Exposure(SENSOR, update.shot)] * 2, [errors] * 2)
    measured = MapControl.of(views, {"a": found}, terrain).measured["a"]
    sight = oriented(views.frame, Exposure(SENSOR, update.shot), ErrorModel(errors[:2]))
    names = "map: terrain height: height", "map: shift east", "map: shift north"
    common = np.stack([measured.by_common[name] for name in names], 1)
    rows = np.hstack([measured.by_pose @ np.asarray(sight[2]), common / np.array([2.0, 4.0, 4.0])])
    expected = np.linalg.inv(np.asarray(update.covariance)) - np.linalg.inv(np.asarray(update.prior.covariance))
    scale = np.sqrt(np.diagonal(expected))
    assert np.max(np.abs(rows.T @ rows - expected) / np.outer(scale, scale)) < 2e-3
    assert np.linalg.norm(measured.offset) < 0.05
