"""Images one after another: against the adjustment of all at once, and against drawn truth."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from support.registered_strip import ERRORS, TERRAIN, Drawn, drawn, errors_of, registered, shots, views_of

from jaxgeo import Exposure, Shot
from jaxgeo.register import Registration
from jaxgeo.ties import Correction, FrameEstimate, MapControl, RecursiveCorrection, correct
from jaxgeo.uncertainty import PerFlight, TimeCorrelated, sources
from tests.test_records import without_jax

pytestmark = pytest.mark.costly

COUNT, LONGEST, SEEDS = 9, 5, 10  # problems of the shape of those of `test_map_control`
MORE = 12  # images of a longer strip


def points_of(of: Drawn, row: int):
    return of.seen.of(of.seen.image == of.seen.image.dtype.type(of.given.name[row]))


def run(
    of: Drawn, window: int = LONGEST, found: dict[int, Registration] | None = None, excess: float = 0.0
) -> tuple[RecursiveCorrection, list[FrameEstimate]]:
    """The filter after all images, and the last estimates of those that left its window."""
    filtered, left = RecursiveCorrection(window, excess=excess), []
    for row, name in enumerate(of.given.name):
        how = {} if found is None or row not in found else {"registration": found[row], "terrain": TERRAIN}
        filtered.add(str(name), of.given.exposure[row], ERRORS, points_of(of, row), **how)
        left += [] if filtered.final is None else [filtered.final]
    return filtered, left


def error_of(of: Drawn, one: FrameEstimate) -> np.ndarray:
    return errors_of(of, [one.name], one.centre[None], one.R_frame_from_camera[None], one.frame)[0]


def off_batch(batch: Correction, one: FrameEstimate) -> tuple[np.ndarray, np.ndarray]:
    """(Difference (6,) of an estimate from that of all at once in standard deviations, ratio of these)."""
    row = batch.names.index(one.name)
    frame, images = batch.views.frame, batch.adjustment.images
    place = np.asarray(frame.from_ecef(np.asarray(one.frame.to_ecef(one.centre))))
    turn = np.asarray(frame.R_ecef_from_local).T @ np.asarray(one.frame.R_ecef_from_local) @ one.R_frame_from_camera
    off = [place - images.centre[row], Rotation.from_matrix(images.R_frame_from_camera[row].T @ turn).as_rotvec()]
    sigma = np.sqrt(np.diagonal(batch.adjustment.covariance_of_images[row]))
    return np.concatenate(off) / sigma, one.sigma / sigma


def are_alike(one: np.ndarray, other: np.ndarray, tolerance: float) -> bool:
    """Whether covariances are equal to a share of the standard deviations."""
    scale = np.sqrt(np.diagonal(other))
    return bool(np.max(np.abs(one - other) / np.outer(scale, scale)) < tolerance)


@pytest.mark.parametrize("rows", [(), (2, 7)], ids=["without a map", "registered now and then"])
def test_one_after_another_is_all_at_once(rows: tuple[int, ...]) -> None:
    """Where no point is measured over more images than the window holds."""
    of = drawn(0, COUNT, LONGEST)
    found = {row: registered(of, row) for row in rows}
    control = (
        MapControl.of(of.given, {str(of.given.name[row]): one for row, one in found.items()}, TERRAIN) if rows else None
    )
    batch = correct(of.given, of.seen, map_control=control)
    assert batch.left_out == 0
    filtered, _ = run(of, LONGEST, found, batch.excess)
    for one in filtered.estimates:
        off, ratio = off_batch(batch, one)
        assert np.max(np.abs(off)) < 0.02
        assert np.allclose(ratio, 1.0, atol=3e-3)
    for name, (value, left) in filtered.common.items():
        assert np.allclose((value, left), batch.adjustment.common[name], atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("window", [LONGEST, 3])
def test_errors_are_as_predicted(window: int) -> None:
    """Squared errors by their covariance are chi-square, with tracks that the window holds and with longer ones: of all
    images of the last window together, and of each image as it leaves."""
    of_window, of_left = 0.0, []
    for seed in range(SEEDS):
        of = drawn(seed, MORE, LONGEST)
        filtered, left = run(of, window, {row: registered(of, row) for row in (2, 8)})
        assert not any(one.refused for one in [*left, *filtered.estimates])
        errors = np.concatenate([error_of(of, one) for one in filtered.estimates])
        of_window += errors @ np.linalg.solve(filtered.covariance, errors)
        for one in left:
            off = error_of(of, one)
            of_left.append(off @ np.linalg.solve(one.covariance, off))
            assert np.all(one.sigma <= 1.0001 * np.sqrt(np.diagonal(one.prior)))
    freedom = 6 * window * SEEDS
    assert abs(of_window - freedom) < 3.0 * np.sqrt(2.0 * freedom)
    assert 0.6 * 6.0 < np.mean(of_left) < 1.4 * 6.0  # those of one sequence are alike: about 30 independent numbers


def test_a_registration_carries_on_and_fades() -> None:
    """The position gains from a registered image and loses it again with the images after it; with no map the common
    offset keeps its prior."""
    of = drawn(1, COUNT, LONGEST)
    loose = (
        sources.Position.from_ned(north=20.0, east=20.0, down=20.0, sharing=TimeCorrelated(60.0)),
        sources.Attitude.from_degrees(heading=1.0, pitch=1.0, roll=1.0),
    )
    filtered, sizes = RecursiveCorrection(LONGEST), []
    of = replace(of, shift=np.zeros(2))
    for row, one in enumerate(of.true.exposure):
        how = {"registration": registered(of, row), "terrain": TERRAIN} if row == 4 else {}
        found = filtered.add(str(of.true.name[row]), one, loose, points_of(of, row), **how)
        sizes.append(float(np.linalg.norm(found.sigma[:3])))
    assert sizes[4] < 0.3 * sizes[3]
    assert np.all(np.diff(sizes[5:]) > 0.0)
    assert sizes[-1] < sizes[3]
    plain, _ = run(of, LONGEST)
    assert all(plain.common[f"position 2: {axis}"][1] > 0.98 for axis in ("north", "east", "down"))


def test_memory_is_bounded() -> None:
    of = drawn(0, 3 * MORE, LONGEST)
    filtered, sizes = RecursiveCorrection(4), []
    for row, name in enumerate(of.given.name):
        filtered.add(str(name), of.given.exposure[row], ERRORS, points_of(of, row))
        window = filtered._solved.window
        sizes.append((len(window.prior.g), len(window.points), sum(len(one.seen) for one in window.frames)))
    later = np.array(sizes[6:])
    assert np.all(later[:, 0] == later[0, 0])
    assert later[-10:].max(axis=0)[1] <= 1.5 * later[:10].max(axis=0)[1]
    assert later[-10:].max(axis=0)[2] <= 1.5 * later[:10].max(axis=0)[2]


def test_it_goes_on_in_another_process() -> None:
    of = drawn(0, 8, LONGEST)
    whole, _ = run(of)
    part, _ = run(replace(of, given=views_of([one.motion for one in of.given.exposure[:5]])))  # pyright: ignore
    part = pickle.loads(without_jax(part))
    for row in range(5, 8):
        part.add(str(of.given.name[row]), of.given.exposure[row], ERRORS, points_of(of, row))
    assert [one.name for one in part.estimates] == [one.name for one in whole.estimates]
    assert np.array_equal(part.covariance, whole.covariance)


def test_wrong_matches_are_left_out() -> None:
    of = drawn(2, COUNT, LONGEST)
    rng = np.random.default_rng(4)
    wrong = rng.random(len(of.seen)) < 0.25
    uv = np.where(wrong[:, None], rng.uniform([0.0, 0.0], [255.0, 191.0], (len(wrong), 2)), of.seen.uv)
    spoilt = replace(of, seen=replace(of.seen, uv=uv))
    filtered, left = run(spoilt)
    clean, _ = run(of)
    assert sum(one.left_out for one in [*left, *filtered.estimates]) > 0.7 * np.count_nonzero(wrong)
    for one, other in zip(filtered.estimates, clean.estimates, strict=True):
        errors = error_of(of, one)
        assert errors @ np.linalg.solve(one.covariance, errors) < 6 + 4.0 * np.sqrt(12.0)
        assert np.all(one.sigma > 0.97 * other.sigma)


def test_wrong_registrations_are_refused() -> None:
    of = drawn(3, COUNT, LONGEST)
    wrong, good = registered(of, 7, blunder=(6.0, 0.0)), registered(of, 1)
    filtered, left = run(of, LONGEST, {1: good, 7: wrong})
    clean, _ = run(of, LONGEST, {1: good})
    said = {one.name: one.refused for one in [*left, *filtered.estimates] if one.refused}
    assert list(said) == ["image 07"]
    assert "contradicts" in said["image 07"]
    assert are_alike(filtered.covariance, clean.covariance, 1e-3)
    # Two in one window: nothing tells which one is wrong.
    both, left = run(of, LONGEST, {5: registered(of, 5), 7: wrong})
    said = {one.name for one in [*left, *both.estimates] if one.refused}
    assert {"image 05", "image 07"} >= said
    assert "image 07" in said
    far, _ = run(of, LONGEST, {8: registered(of, 8, blunder=(60.0, 0.0))})
    assert next(one for one in far.estimates if one.name == "image 08").refused


def test_a_registration_may_come_later() -> None:
    of = drawn(0, 6, LONGEST)
    found = registered(of, 3)
    at_once, _ = run(of, LONGEST, {3: found})
    later, _ = run(of, LONGEST)
    estimate = later.register("image 03", found, TERRAIN)
    assert estimate.registered
    assert are_alike(later.covariance, at_once.covariance, 1e-2)
    with pytest.raises(ValueError, match="has a registration already"):
        later.register("image 03", found, TERRAIN)
    with pytest.raises(ValueError, match="'image 00' is not in the window"):
        later.register("image 00", found, TERRAIN)


def test_images_without_ties_follow_the_navigation() -> None:
    """One image; images that share nothing; and images of one time."""
    of = drawn(0, 4)
    filtered = RecursiveCorrection(2)
    first = filtered.add("image 00", of.given.exposure[0], ERRORS)
    assert not first.connected
    assert are_alike(first.covariance, first.prior, 1e-5)
    second = filtered.add("image 01", of.given.exposure[1], ERRORS, points_of(of, 1))
    assert not second.connected
    assert second.ties == second.left_out == 0
    assert are_alike(second.covariance, second.prior, 1e-5)
    twin = filtered.add("twin", of.given.exposure[1], ERRORS)
    assert are_alike(twin.covariance, twin.prior, 1e-5)
    for k in range(20):  # unconnected images of one time leave the window one by one
        twin = filtered.add(f"twin {k}", of.given.exposure[1], ERRORS)
    assert are_alike(twin.covariance, twin.prior, 1e-4)


def test_what_cannot_be_added_changes_nothing() -> None:
    of = drawn(0, 3)
    filtered = RecursiveCorrection(2)
    exposures = of.given.exposure
    filtered.add("a", exposures[1], ERRORS)
    before = filtered.covariance
    later = Exposure(exposures[0].sensor, replace(shots(1)[0], time=2.0))
    others = [
        (ValueError, "in the window already", ("a", exposures[2], ERRORS)),
        (ValueError, "2 s before 'a'", ("b", exposures[0], ERRORS)),
        (ValueError, "other error sources", ("b", exposures[2], ERRORS[:3])),
        (ValueError, "no error of position", ("b", exposures[2], ERRORS[2:])),
        (ValueError, "measured in other images: image 00", ("b", exposures[2], ERRORS, points_of(of, 0))),
    ]
    for kind, words, arguments in others:
        with pytest.raises(kind, match=words):
            filtered.add(*arguments)
    with pytest.raises(ValueError, match="needs the terrain"):
        filtered.add("image 02", exposures[2], ERRORS, registration=registered(of, 2))
    assert filtered.count == 1
    assert np.array_equal(filtered.covariance, before)
    filtered.add("b", later, ERRORS)
    assert filtered.count == 2


def test_processes_without_a_recursion_are_refused() -> None:
    shot = shots(1)[0]
    slow = sources.Position(np.full(3, 1.0), sharing=TimeCorrelated(10.0, beta=1.0))
    attitude = sources.Attitude(np.full(3, 1e-3))
    views = views_of([shot])
    with pytest.raises(ValueError, match="beta = 1 is no first-order Gauss-Markov"):
        RecursiveCorrection().add("a", views.exposure[0], (slow, attitude))
    for window in (1, 0, -3):
        with pytest.raises(ValueError, match="window must be a whole number"):
            RecursiveCorrection(window)
    with pytest.raises(ValueError, match="excess must not be negative"):
        RecursiveCorrection(excess=-1.0)


def test_asymptotic_correlation_is_a_constant() -> None:
    """alpha and strength of `TimeCorrelated`: the joint covariance of unconnected images is that of its correlation."""
    kind = TimeCorrelated(5.0, alpha=0.3, strength=0.8)
    errors = (sources.Position(np.full(3, 2.0), sharing=kind), sources.Attitude(np.full(3, 1e-3), sharing=PerFlight()))
    filtered = RecursiveCorrection(3)
    for k, shot in enumerate(shots(4)):
        filtered.add(
            f"{k}", Exposure(views_of([shot]).exposure[0].sensor, Shot(shot.pose, np.zeros(0), 2.0 * k)), errors
        )
    C = filtered.covariance.reshape(3, 6, 3, 6)
    for lag in (1, 2):
        expected = 4.0 * 0.8 * (0.3 + 0.7 * np.exp(-2.0 * lag / 5.0))
        assert np.allclose(np.diagonal(C[0, :3, lag, :3]), expected, rtol=1e-3)
    assert np.allclose(np.diagonal(C[0, :3, 0, :3]), 4.0, rtol=1e-6)
