"""The part of an image over known ground: of level ground that ends at known places, and at the limits 0 and 1."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jaxgeo import ConstantHeight, Dem, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.coverage import covered_part, footprint
from jaxgeo.coverage._covered import CELLS
from jaxgeo.terrain import TangentGrid

SENSOR = Sensor(FrameCamera.from_pixels(focal_px=1000.0, width=900, height=600), Gimbal.fixed(), Mount.nadir())
HEIGHT = 1000.0
SIDE = 4000.0  # m, of the elevation model
CASES = [(0.0, 0.0), (17.0, 3.0), (0.0, -8.0), (-4.0, 12.0)]


def shot(heading: float = 0.0, *, pitch: float = 0.0, roll: float = 0.0) -> Shot:
    return Shot(Pose.from_degrees(lat=47.0, lon=11.0, height=HEIGHT, heading=heading, pitch=pitch, roll=roll))


def ground(west: float, east: float, *, side: float = SIDE) -> Dem:
    """Level ground between two distances east of the camera, `side` m along north."""
    lat, lon = 47.0, 11.0 + math.degrees(0.5 * (west + east) / (6_388_000.0 * math.cos(math.radians(47.0))))
    posts = 41
    spacing = side / (posts - 1), (east - west) / (posts - 1)
    grid = TangentGrid.centred(
        Geodetic.from_degrees(lat=lat, lon=lon, height=0.0), spacing=spacing, shape=(posts, posts)
    )
    return Dem.from_array(np.zeros((posts, posts)), grid)


@pytest.mark.parametrize("pitch, roll", CASES)
def test_whole_ground_is_the_area_of_the_footprint(pitch: float, roll: float) -> None:
    look = shot(pitch=pitch, roll=roll)
    part = covered_part(SENSOR, look, ConstantHeight(0.0))
    assert part.share == 1.0
    assert part.area == pytest.approx(footprint(SENSOR, look, ConstantHeight(0.0)).area, rel=2e-3)


@pytest.mark.parametrize("east", [-430.0, -200.0, 0.0, 123.0, 440.0])
@pytest.mark.parametrize("heading", [0.0, 90.0])
def test_ground_that_ends_is_counted_to_its_edge(east: float, heading: float) -> None:
    """Level ground that ends `east` m east of a camera above it, whose image is 900 m by 600 m there; the edge is
    parallel to cells, so the part is right to half a cell."""
    across = 900.0 if heading == 0.0 else 600.0
    part = covered_part(SENSOR, shot(heading), ground(-SIDE + east, east))
    share = min(max((east + 0.5 * across) / across, 0.0), 1.0)
    half = 0.51 / CELLS * 900.0 / across
    assert part.share == pytest.approx(share, abs=half)
    assert part.area == pytest.approx(share * 900.0 * 600.0, abs=half * 900.0 * 600.0)


def test_ground_within_the_image_is_all_counted() -> None:
    """The outline sees no ground at all."""
    part = covered_part(SENSOR, shot(30.0), ground(-100.0, 100.0, side=200.0), cells=200)
    assert not footprint(SENSOR, shot(30.0), ground(-100.0, 100.0, side=200.0)).found.any()
    assert part.area == pytest.approx(200.0**2, rel=0.02)
    assert part.share == pytest.approx(200.0**2 / (900.0 * 600.0), rel=0.02)


def test_no_ground_is_nothing_and_no_cells_are_refused() -> None:
    assert covered_part(SENSOR, shot(), ground(2000.0, 2400.0, side=400.0)) == (0.0, 0.0)
    with pytest.raises(ValueError, match="at least 1; got 0"):
        covered_part(SENSOR, shot(), ConstantHeight(0.0), cells=0)
