"""Scenes that mislead matching: a periodic texture, water, and moving shadows. No wrong pose is accepted."""

from __future__ import annotations

import functools

import pytest
import scipy
from support.drone_strip import Strip, ground, strip
from support.misleading_scenes import periodic, rows_of_trees, shadows, shown, squared_errors, water

from jaxgeo.ties import Correction, Matching, correct, find_ties

pytestmark = pytest.mark.costly

CERTAIN = 0.999


@functools.cache
def outcome(scene) -> tuple[Strip, Correction | None]:
    """The strip with images of a scene, and its correction: None if no tie points were found."""
    here = shown(strip(), scene)
    ties = find_ties(here.views, ground(1.0), here.pictures, Matching(sigma_height=2.0), points=48)
    return here, None if ties.observations is None else correct(here.views, ties)


@pytest.mark.parametrize("scene", [periodic, pytest.param(rows_of_trees, marks=pytest.mark.slow)])
def test_repeated_texture_is_not_tied(scene) -> None:
    assert outcome(scene)[1] is None


@pytest.mark.parametrize("scene", [pytest.param(water, marks=pytest.mark.slow), shadows])
def test_no_wrong_pose_is_accepted(scene) -> None:
    """Adjusted images err within the chi-square bounds of their covariances, each and together; the others are
    named."""
    here, found = outcome(scene)
    assert found is not None
    each, together = squared_errors(here, found)
    assert max(each) < scipy.stats.chi2.ppf(CERTAIN, 6)
    assert together < scipy.stats.chi2.ppf(CERTAIN, 6 * len(each))
    assert found.names == here.names[:4]
    assert found.unconnected == ["image 4"]
