"""Wrong measurements of tie points: which are found pair by pair, and that no wrong pose is accepted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation
from support.simulated_ties import simulated, squared_errors

from jaxgeo.adjust import ImagePoints
from jaxgeo.adjust.ray_consensus import Rays
from jaxgeo.ties import Views, correct
from jaxgeo.ties.block_of_views import block_of_views
from jaxgeo.ties.consensus import agreeing, by_coplanarity
from jaxgeo.ties.epipolar import coplanarity
from jaxgeo.ties.pair_consensus import agreement

pytestmark = pytest.mark.costly

CERTAIN = 0.999


def moved(views: Views, image: int, error: np.ndarray) -> Views:
    """Views with an error of one pose: centre in m, rotation about the camera's axes in rad."""
    centre, R = views.centre.copy(), views.R_frame_from_camera.copy()
    centre[image] += error[:3]
    R[image] = R[image] @ Rotation.from_rotvec(error[3:]).as_matrix()
    return replace(views, centre=centre, R_frame_from_camera=R)


def test_coplanarity_is_of_unit_variance_and_its_derivatives_are_right() -> None:
    here = simulated(2, 0.7, "none", 0.0, 0, points=200)
    observed = here.observations
    order = np.lexsort((observed.image, observed.point))
    first, second = order[::2], order[1::2]

    def at(views: Views) -> np.ndarray:
        return coplanarity(Rays.of(block_of_views(views, observed)), first, second).off

    off = at(here.true)
    assert scipy.stats.chi2.ppf(1e-4, len(off)) < np.sum(off**2) < scipy.stats.chi2.ppf(1 - 1e-4, len(off))
    found = coplanarity(Rays.of(block_of_views(here.true, observed)), first, second).by_pose
    for column in range(12):
        step = np.where(np.arange(6) == column % 6, 1e-5, 0.0)
        by = (at(moved(here.true, column // 6, step)) - at(moved(here.true, column // 6, -step))) / 2e-5
        assert np.allclose(found[:, column], by, atol=2.0 + 5e-3 * np.max(np.abs(by)))  # that of the noise is left out


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_matches_that_agree_are_found_among_wrong_ones(share: float) -> None:
    """Distances by a drawn error of both poses, some of them anywhere within those of the navigation."""
    rng = np.random.default_rng(4)
    for _ in range(5):
        count, sigmas = 40, np.tile([1.0, 1.0, 1.0, 0.007, 0.007, 0.007], 2)
        visible = np.linalg.qr(rng.normal(size=(12, 5)))[0].T  # of the relative pose
        by_pose = rng.normal(size=(count, 5)) @ visible * 15.0 / sigmas
        off = by_pose @ (sigmas * rng.normal(size=12)) + rng.normal(size=count)
        wrong = rng.random(count) < share
        off = np.where(wrong, rng.uniform(-150.0, 150.0, count), off)
        agrees = agreement(off, by_pose, np.diag(sigmas**2), np.full(count, 10.0))
        assert agrees is not None
        assert np.mean(agrees[~wrong]) > 0.9
        assert np.sum(agrees & wrong) <= 3


def test_few_matches_and_those_far_off_agree_on_nothing() -> None:
    few, far = np.zeros(5), np.full(20, 1e4)
    for off in (few, far):
        assert agreement(off, np.ones((len(off), 12)), np.eye(12), np.full(len(off), 10.0)) is None


def test_orientations_to_start_from_make_rays_coplanar() -> None:
    here = simulated(4, 0.7, "anywhere", 0.3, 0)
    block = block_of_views(here.given, here.observations)
    kept = ~here.wrong
    started = by_coplanarity(block, here.given, kept)
    first, second = (np.array(rows) for rows in zip(*couples_of(here.observations, kept), strict=True))
    before, after = (coplanarity(Rays.of(one), first, second).off for one in (block, started))
    assert np.sqrt(np.mean(before**2)) > 5.0
    assert np.sqrt(np.mean(after**2)) < 0.25 * np.sqrt(np.mean(before**2))


def couples_of(observed: ImagePoints, kept: np.ndarray) -> list[tuple[int, int]]:
    """Rows of pairs of kept measurements of one point."""
    rows = np.flatnonzero(kept).tolist()
    return [(i, j) for i in rows for j in rows if i < j and observed.point[i] == observed.point[j]]


def test_measurements_agree_by_most_of_their_pairs() -> None:
    here = simulated(8, 0.7, "anywhere", 0.3, 8)
    kept = agreeing(block_of_views(here.given, here.observations), here.given)
    names, point = here.observations.point_numbers
    right = ~here.wrong & (np.bincount(point, weights=~here.wrong, minlength=len(names)) >= 2)[point]
    assert np.mean(kept[right]) > 0.8
    assert np.mean(kept[here.wrong]) < 0.1


@pytest.mark.parametrize(
    "count, kind, share, seeds",
    [
        (4, "anywhere", 0.3, (0, 4)),
        pytest.param(8, "anywhere", 0.3, (1, 4, 5, 8), marks=pytest.mark.slow),
        pytest.param(8, "area", 0.3, (0, 4, 8, 9), marks=pytest.mark.slow),
        pytest.param(8, "moving", 0.1, (0, 1), marks=pytest.mark.slow),
        pytest.param(8, "joined", 0.1, (0, 1), marks=pytest.mark.slow),
    ],
)
def test_no_wrong_pose_is_accepted(count: int, kind: str, share: float, seeds: tuple[int, ...]) -> None:
    """Adjusted images err within the chi-square bounds of their covariances; the others are named."""
    for seed in seeds:
        here = simulated(count, 0.7, kind, share, seed)
        found = correct(here.given, here.observations)
        each, joint = squared_errors(here, found)
        assert max(each) < scipy.stats.chi2.ppf(CERTAIN, 6)
        assert joint < scipy.stats.chi2.ppf(CERTAIN, 6 * len(each))
        assert len(each) >= count - 2
        assert sorted([*found.names, *found.unconnected]) == sorted(here.given.name.tolist())
        assert all(name in found.words() for name in found.contradicted)


@pytest.mark.parametrize("freedom, seed", [(3, 2), (5, 3)])
def test_right_measurements_that_are_less_precise_than_stated_are_kept(freedom: int, seed: int) -> None:
    """Errors of lenses and heavy tails: Student's t with 0.3 px, where 0.1 px are stated."""
    here = simulated(4, 0.6, "none", 0.0, seed)
    observed = here.observations
    more = 0.3 * np.random.default_rng(seed).standard_t(freedom, observed.uv.shape)
    found = correct(here.given, replace(observed, uv=observed.uv + more))
    assert len(found.names) == 4
    assert found.left_out < 0.3 * len(observed)
    assert not found.mostly_left_out


def test_an_image_without_right_measurements_is_named() -> None:
    here = simulated(4, 0.7, "none", 0.0, 2)
    observed, rng = here.observations, np.random.default_rng(1)
    last = observed.image == here.given.name[3]
    uv = np.where(last[:, None], rng.uniform([0.0, 0.0], [255.0, 191.0], observed.uv.shape), observed.uv)
    found = correct(here.given, ImagePoints(observed.image, observed.point, uv, observed.sigma))
    assert found.contradicted == found.unconnected == [here.given.name[3]]
    assert "too few of their measurements agree" in found.words()
    each, _ = squared_errors(here, found)
    assert max(each) < scipy.stats.chi2.ppf(CERTAIN, 6)
