"""Strips side by side: side overlap against plane geometry, where it is least, neighbours, and the spacing."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jaxgeo import ConstantHeight, Dem, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.coverage import (
    SeesNoGround,
    StripOutline,
    local_projection,
    neighbouring_strips,
    side_overlap,
    split_strips,
    strip_outline,
    strip_spacing,
)
from jaxgeo.terrain import TangentGrid

FOCAL, ACROSS, DOWN = 1000.0, 1000, 600  # px
SENSOR = Sensor(FrameCamera.from_pixels(focal_px=FOCAL, width=ACROSS, height=DOWN), Gimbal.fixed(), Mount.nadir())
LAT, LON, HEIGHT = 47.0, 11.0, 1000.0
NORTH, EAST = 111_178.0, 76_056.0  # m per deg there, by the series of Helmert (1880) for WGS 84
HALF = 0.5 * ACROSS / FOCAL  # tangent of half the field across
LEVEL = ConstantHeight(0.0)


def shot(north: float, east: float, heading: float = 0.0, height: float = HEIGHT) -> Shot:
    return Shot(Pose.from_degrees(lat=LAT + north / NORTH, lon=LON + east / EAST, height=height, heading=heading))


def strip(east: float, count: int = 4, *, back: bool = False, start: float = 0.0, step: float = 250.0) -> list[Shot]:
    found = [shot(start + step * k, east, 180.0 if back else 0.0) for k in range(count)]
    return found[::-1] if back else found


MAP = local_projection(shot(0.0, 0.0))


def outline(shots: list[Shot], terrain: Any = LEVEL) -> StripOutline:
    return strip_outline(SENSOR, shots, terrain, projection=MAP)


def sloping(per_east: float, ridge: float = 0.0) -> Dem:
    """A plane that rises to the east, and with `ridge` a hill in m in the middle, 300 m broad along the strips."""
    centre = Geodetic.from_degrees(lat=LAT + 400.0 / NORTH, lon=LON, height=0.0)
    north, east = (np.linspace(-half, half, count) for half, count in ((1500.0, 301), (2000.0, 401)))
    posts = per_east * east[None, :] + ridge * np.exp(-0.5 * (north[::-1, None] / 60.0) ** 2) * np.ones((1, 401))
    return Dem.from_array(posts, TangentGrid.centred(centre, spacing=(10.0, 10.0), shape=posts.shape))


@pytest.mark.parametrize("apart", [300.0, 700.0, 1250.0])
@pytest.mark.parametrize("back", [False, True])
def test_over_level_ground_it_is_one_less_the_spacing_by_the_width(apart: float, back: bool) -> None:
    """Whichever way the second is flown; beyond the width it is negative, a gap."""
    found = side_overlap(outline(strip(0.0)), outline(strip(apart, back=back)))
    expected = 1.0 - apart / (2.0 * HALF * HEIGHT)
    assert found.spacing == pytest.approx(apart, abs=0.5)
    assert (found.least, found.mean) == pytest.approx((expected, expected), abs=1e-3)
    assert found.without_image == 0.0
    lat, lon = np.rad2deg(found.places[found.where_least])
    assert (lon - LON) * EAST == pytest.approx(0.5 * apart, abs=1.0)
    assert -0.5 * DOWN - 1.0 < (lat - LAT) * NORTH < 750.0 + 0.5 * DOWN + 1.0


@pytest.mark.parametrize("per_east", [-0.2, 0.1])
def test_over_a_slope_it_is_that_of_the_rays_in_the_plane(per_east: float) -> None:
    """Rays x0 +- t (H - s x) meet the plane s x at (x0 +- t H) / (1 +- t s)."""
    apart = 600.0
    one, other = (
        [(x + sign * HALF * HEIGHT) / (1.0 + sign * HALF * per_east) for sign in (-1, 1)] for x in (0.0, apart)
    )
    expected = (one[1] - other[0]) / max(one[1] - one[0], other[1] - other[0])
    ground = sloping(per_east)
    found = side_overlap(outline(strip(0.0), ground), outline(strip(apart), ground))
    assert found.least == pytest.approx(expected, abs=2e-3)
    assert found.mean == pytest.approx(expected, abs=2e-3)


def test_it_is_least_where_a_ridge_is_nearer_to_the_cameras() -> None:
    """On a ridge of 200 m across both strips the width is that of 800 m of height."""
    ground = sloping(0.0, ridge=200.0)
    shots = strip(0.0), strip(600.0)
    found = side_overlap(*(outline(one, ground) for one in shots))
    assert found.least == pytest.approx(1.0 - 600.0 / (2.0 * HALF * (HEIGHT - 200.0)), abs=5e-3)
    assert found.mean > found.least + 0.03
    lat, _ = np.rad2deg(found.places[found.where_least])
    assert (lat - LAT) * NORTH == pytest.approx(400.0, abs=30.0)
    norths = np.array([250.0 * k for k in range(4)])
    for image in found.images[found.where_least]:
        assert abs(norths[image] - 400.0) <= 150.0


def test_the_widest_images_of_a_line_count_and_a_gap_along_the_flight_is_told() -> None:
    one = outline([*strip(0.0, 2), *strip(0.0, 2, start=2000.0)])
    found = side_overlap(one, outline(strip(600.0, 10)))
    assert found.without_image == pytest.approx((2000.0 - 250.0 - DOWN) / (2000.0 + 250.0 + DOWN), abs=0.01)
    assert found.least == pytest.approx(0.4, abs=1e-3)


def test_strips_are_told_apart_by_their_courses() -> None:
    """Flown there and back, with and without images on the way; one image beside the last is in a turn."""
    flown = [*strip(0.0), *strip(600.0, back=True), *strip(1200.0, 3)]
    assert [own.tolist() for own in split_strips(flown)] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10]]
    same_way = [*strip(0.0), *strip(600.0), *strip(1200.0, 5)]
    assert [own.tolist() for own in split_strips(same_way)] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10, 11, 12]]
    turning = [*strip(0.0, 3), shot(900.0, 300.0), *strip(600.0, 3, back=True)]
    assert [own.tolist() for own in split_strips(turning)] == [[0, 1, 2], [4, 5, 6]]
    assert [own.tolist() for own in split_strips(strip(0.0))] == [[0, 1, 2, 3]]
    standing = [*strip(0.0, 2), shot(250.0, 0.0), shot(500.0, 0.0)]
    assert [own.tolist() for own in split_strips(standing)] == [[0, 1, 2, 3]]
    assert split_strips(strip(0.0, 1)) == []


def test_neighbours_are_the_next_across_with_a_length_in_common() -> None:
    """In any order; the strip in two pieces has both beside the next, and a strip across has none."""
    west, east = outline(strip(0.0, 10)), outline(strip(1200.0, 10, back=True))
    pieces = outline(strip(600.0, 3)), outline(strip(600.0, 3, start=1500.0))
    across = outline([shot(1000.0, -200.0 + 300.0 * k, 90.0) for k in range(3)])
    beyond = outline(strip(300.0, 3, start=9000.0))
    assert neighbouring_strips([east, west]) == neighbouring_strips([west, east]) == [(0, 1)]
    found = neighbouring_strips([west, pieces[1], east, pieces[0], across, beyond])
    assert (0, 1) in found
    assert (0, 3) in found
    assert (1, 2) in found
    assert (2, 3) in found
    assert (0, 2) in found, "between the pieces"
    assert not any(4 in pair or 5 in pair for pair in found)


@pytest.mark.parametrize("side, sign", [("right", 1.0), ("left", -1.0)])
def test_the_spacing_has_the_wanted_overlap(side: Any, sign: float) -> None:
    """Over level ground that of the formula; over a slope the overlap of strips flown at it."""
    level = strip_spacing(SENSOR, strip(0.0), LEVEL, 0.3, side=side)
    assert level.spacing == pytest.approx(0.7 * 2.0 * HALF * HEIGHT, abs=1.0)
    ground, trials = sloping(0.15, ridge=100.0), []
    found = strip_spacing(SENSOR, strip(0.0), ground, 0.4, side=side, progress=trials.append)
    assert trials == list(range(1, len(trials) + 1))
    flown = side_overlap(outline(strip(0.0), ground), outline(strip(sign * found.spacing), ground))
    assert 0.4 - 1e-3 < flown.least < 0.4 + 2e-3
    assert found.overlap.least >= 0.4
    wider = side_overlap(outline(strip(0.0), ground), outline(strip(sign * (found.spacing + 10.0)), ground))
    assert wider.least < 0.4


def test_what_has_no_side_overlap_is_refused_in_words() -> None:
    one = outline(strip(0.0))
    with pytest.raises(ValueError, match="differ by 90 deg; they must be parallel"):
        side_overlap(one, outline([shot(0.0, 300.0 * k, 90.0) for k in range(3)]))
    with pytest.raises(ValueError, match="no length in common"):
        side_overlap(one, outline(strip(0.0, start=5000.0)))
    with pytest.raises(ValueError, match="different maps"):
        side_overlap(one, strip_outline(SENSOR, strip(5000.0), LEVEL))
    with pytest.raises(ValueError, match="two or more images from different positions"):
        side_overlap(one, outline([shot(0.0, 0.0)]))
    with pytest.raises(ValueError, match="scans must be at least 2; got 1"):
        side_overlap(one, one, scans=1)
    with pytest.raises(ValueError, match="overlap must lie in"):
        strip_spacing(SENSOR, strip(0.0), LEVEL, 1.0)
    with pytest.raises(ValueError, match="got none"):
        strip_outline(SENSOR, [], LEVEL)
    with pytest.raises(ValueError, match="one for each of 4 images; got 2"):
        strip_outline([SENSOR] * 2, strip(0.0), LEVEL)
    tilted = Shot(Pose.from_degrees(lat=LAT, lon=LON + 0.001, height=HEIGHT, roll=80.0))
    with pytest.raises(SeesNoGround, match="image 2 of the strip: "):
        strip_outline(SENSOR, [*strip(0.0, 2), tilted], LEVEL)


def test_the_course_is_a_unit_vector() -> None:
    assert np.linalg.norm(outline(strip(0.0)).course) == pytest.approx(1.0)
    assert math.degrees(math.atan2(*outline(strip(0.0, back=True)).course)) == pytest.approx(180.0, abs=1e-3)
