"""Real frames find back to their orientation from an orthophoto; what another orthophoto shows is refused."""

from __future__ import annotations

import pathlib

import equinox as eqx
import numpy as np
import pytest
from support.ngi import Flight
from support.registrations import errors, tie_errors, trial

from jaxgeo.register.outcome import Outcome
from jaxgeo.register.registration import register_image
from jaxgeo.studies.gu2017.scene import disturbed

pytestmark = pytest.mark.slow

CELL = 5.0  # m, of the orthophotos


@pytest.fixture(scope="module")
def flight(jaxgeo_test_data: pathlib.Path) -> Flight:
    return Flight.of(jaxgeo_test_data)


@pytest.mark.parametrize("position, attitude_deg, count", [(50.0, 0.5, 2), (10.0, 0.05, 2), (100.0, 1.0, 2)])
def test_disturbed_frames_find_back(flight: Flight, position: float, attitude_deg: float, count: int) -> None:
    """To less than a cell of the reference in the middle, and within the standard deviations foretold."""
    rng = np.random.default_rng(7)
    for number in range(count):
        one = trial(flight, ("05_0182", "05_0184")[number % 2], rng, position, attitude_deg)
        print(one.registration, one.off, one.off_sigmas, one.pose_sigmas)
        assert one.registration.accepted
        assert one.off[0] < CELL
        assert np.all(one.off_sigmas < 3.0)
        assert np.all(np.abs(one.pose_sigmas) < 3.0)


def test_another_area_is_refused(flight: Flight) -> None:
    """The neighbouring orthophoto, moved to where the frame should be."""
    own, other = flight.reference(1), flight.reference(2)
    rows, cols = (min(a, b) for a, b in zip(own.shape, other.shape, strict=True))
    shown = other.window(0, 0, (rows, cols))
    moved = eqx.tree_at(lambda o: o.grid, shown, own.grid)
    shot = disturbed(flight.shots["05_0182"], np.random.default_rng(1), metres=50.0, degrees=0.5)
    image = flight.image("05_0182")
    found = register_image(flight.sensor, shot, image, moved, flight.terrain, errors(50.0, 0.5), tie_errors())
    assert found.outcome in (Outcome.no_agreement, Outcome.few_agree)
    assert found.update is None
    assert found.shot.pose.heading == shot.pose.heading
