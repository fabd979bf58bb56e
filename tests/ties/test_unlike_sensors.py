"""Tie points between images of two sensors in turn: an unlike contrast, and detail that one of them does not see."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import scipy
from support.drone_strip import Strip, ground, strip
from support.misleading_scenes import periodic, plain, shown, squared_errors
from support.unlike_images import of, off_true_rays, two_sensors

from jaxgeo.ties import Matching, Ties, correct, find_ties

pytestmark = pytest.mark.costly


@functools.cache
def tied(measure: str, seed: int) -> tuple[Strip, Ties]:
    here = strip(seed=seed)
    here = of(here, two_sensors(here, seed), seed)
    how = Matching(sigma_height=2.0, measure=measure)
    return here, find_ties(here.views, ground(1.0), here.pictures, how, points=48)


def between_sensors(ties: Ties) -> int:
    """Number of tie points of pairs of images by unlike sensors."""
    return sum(one.tied for one in ties.pairs if (int(one.first[-1]) - int(one.second[-1])) % 2)


def test_orientations_tie_where_grey_values_do_not() -> None:
    by_grey, by_orientation = (between_sensors(tied(measure, 0)[1]) for measure in ("grey", "orientation"))
    assert by_grey == 0
    assert by_orientation > 80


@pytest.mark.parametrize("seed", [0, 1, pytest.param(2, marks=pytest.mark.slow)])
def test_matches_and_poses_err_as_predicted(seed: int) -> None:
    here, ties = tied("orientation", seed)
    assert ties.observations is not None
    off, variance = off_true_rays(here, ties.observations)
    assert len(off) > 80
    squared = off**2 / variance
    assert 0.3 < np.mean(squared) < 1.25
    assert np.mean(np.sum(squared, axis=1) > 13.8) < 0.03
    found = correct(here.views, ties)
    assert found.names == here.names[:4]
    each, together = squared_errors(here, found)
    assert max(each) < scipy.stats.chi2.ppf(0.999, 6)
    assert together < scipy.stats.chi2.ppf(0.999, 6 * len(each))


def test_one_sensor_is_tied_by_orientations_too() -> None:
    """As near to the truth as is stated, though less near than by grey values."""
    here = shown(strip(), plain)
    how = Matching(sigma_height=2.0, measure="orientation")
    ties = find_ties(here.views, ground(1.0), here.pictures, how, points=48)
    assert ties.unconnected == ["image 4"]
    assert ties.observations is not None
    off, variance = off_true_rays(here, ties.observations)
    assert 0.3 < np.mean(off**2 / variance) < 1.3


def test_a_repeated_texture_is_not_tied() -> None:
    here = shown(strip(), periodic)
    how = Matching(sigma_height=2.0, measure="orientation")
    assert find_ties(here.views, ground(1.0), here.pictures, how, points=48).observations is None


def test_another_measure_is_refused() -> None:
    with pytest.raises(ValueError, match="measure must be one of grey, orientation; got 'phase'"):
        Matching(measure="phase")
    assert Matching().threshold == 0.5
    assert Matching(measure="orientation").threshold == 0.3
    assert Matching(measure="orientation", least_score=0.6).threshold == 0.6
