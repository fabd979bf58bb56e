"""What one image shares with the next: laws over level ground, the paper's formulas, ridges, statuses, derivatives."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import (
    ConstantHeight,
    Dem,
    Geodetic,
    Pose,
    Sensor,
    Shot,
    Status,
    Trajectory,
)
from jaxgeo._locate import locate
from jaxgeo.coverage import MovingExposure, footprint, geometry, local_projection, overlap, polygon_overlap, transform
from jaxgeo.coverage._overlap import axis_along, check_along, flight_direction
from jaxgeo.sensor.conventions import li_2020_sensor, li_2023_sweep_sensor
from jaxgeo.terrain import TangentGrid

PIXELS, FIELD = 1536, math.radians(0.88)
PITCH = 2.0 * math.tan(0.5 * FIELD) / PIXELS  # m, for a focal length of 1 m
SENSOR = li_2020_sensor(focal_length=1.0, pixel_pitch=PITCH, along_flight=PIXELS, across_flight=PIXELS, mirror=False)
GROUND = ConstantHeight(jnp.zeros(()))
HEIGHT, OUTER, LAT, LON = 8143.0, 74.0, 34.86, 111.0
NEAR = math.radians(OUTER) - 0.5 * FIELD  # off nadir
LENGTH = 2.0 * HEIGHT / math.cos(math.radians(OUTER)) * math.tan(0.5 * FIELD)
STEP = 0.85 * LENGTH
STATIONS = 9


def shot(
    north: float, *, heading: Any = 0.0, pitch: Any = 0.0, roll: Any = 0.0, outer: Any = OUTER, height: Any = HEIGHT
):
    """A shot from so many metres further north, looking to the right."""
    pose = Pose.from_degrees(
        lat=LAT + north / 110_940.0, lon=LON, height=height, heading=heading, pitch=pitch, roll=roll
    )
    return Shot(pose, SENSOR.gimbal.readings_from_degrees(outer=outer, inner=0.0))


FIRST = shot(0.0)


def shared(before: Any, after: Any, terrain: Any = GROUND, **options: Any):
    return overlap(SENSOR, before, after, terrain, **{"along": "rows", "stations": STATIONS} | options)


def seen(one: Shot, u: float, v: float) -> Geodetic:
    return locate(SENSOR, one, jnp.array([u, v]), GROUND).position


@pytest.mark.costly
@pytest.mark.parametrize("share", [0.15, 0.6, -0.2])
def test_the_overlap_of_equal_images_is_the_step_s(share: float) -> None:
    """At the middle by the step over the frame's length, at the near end as by transforming coordinates."""
    after = shot((1.0 - share) * LENGTH)
    found = shared(FIRST, after)
    assert int(found.status) == Status.hit
    middle = [seen(one, 0.5 * (PIXELS - 1), 0.5 * (PIXELS - 1)) for one in (FIRST, after)]
    projection = local_projection(FIRST)
    bearing = transform.bearing_on_map(projection, FIRST.pose.position, after.pose.position)
    step = float(transform.projected_step(projection, *middle, bearing=bearing))
    ends = [seen(FIRST, 0.5 * (PIXELS - 1), end) for end in (-0.5, PIXELS - 0.5)]
    length = float(transform.frame_length_on_map(projection, *ends))
    assert float(found.along[STATIONS // 2]) == pytest.approx(1.0 - step / length, abs=1e-3)
    assert float(found.near) < float(found.along[STATIONS // 2]) < float(found.far)
    assert float(found.least) == float(found.near)

    corners = [seen(FIRST, near_end(), end) for end in (-0.5, PIXELS - 0.5)]
    points = [seen(one, near_end(), 0.5 * (PIXELS - 1)) for one in (FIRST, after)]
    by_transform = transform.overlap_along(
        projection, *points, bearing=bearing, length=transform.frame_length_on_map(projection, *corners)
    )
    assert float(found.near) == pytest.approx(float(by_transform), abs=1e-3)
    assert float(found.step) == pytest.approx(
        float(transform.projected_step(projection, *points, bearing=bearing)), abs=0.3
    )


def near_end() -> float:
    """The column of the image's near edge."""

    def slant_range(u: float) -> float:
        return float(locate(SENSOR, FIRST, jnp.array([u, 0.5 * (PIXELS - 1)]), GROUND).slant_range)

    return min(-0.5, PIXELS - 0.5, key=slant_range)


def test_an_image_shares_all_with_itself_and_less_the_farther_it_goes() -> None:
    direction = jnp.array([0.0, 1.0])
    found = [shared(FIRST, shot(north), direction=direction) for north in (0.0, 0.3 * LENGTH, 0.6 * LENGTH)]
    for name in ("near", "far", "least", "side", "area"):
        values = [float(getattr(one, name)) for one in found]
        assert values[0] == pytest.approx(1.0, abs=1e-9)
        assert values == sorted(values, reverse=True)


def test_swapped_images() -> None:
    """Against the same direction the step changes its sign; along its own, the one shares what the other does."""
    after = shot(STEP)
    projection = local_projection(FIRST)
    direction = flight_direction(FIRST, after, projection)
    there, back = (
        shared(*pair, direction=direction, projection=projection) for pair in ((FIRST, after), (after, FIRST))
    )
    assert float(back.step) == pytest.approx(-float(there.step), abs=1e-6)
    assert float(back.near) == pytest.approx(2.0 - float(there.near), abs=2e-3), (
        "the trailing edge lies ahead by as much"
    )
    swapped = shared(after, FIRST)
    for name in ("near", "far", "side", "area"):
        assert float(getattr(swapped, name)) == pytest.approx(float(getattr(there, name)), abs=1e-4)


def test_images_that_share_nothing_across_the_flight() -> None:
    found = shared(FIRST, shot(STEP, outer=60.0))
    assert int(found.status) == Status.images_apart
    assert not bool(found.ok)
    assert float(found.side) < 0.0
    assert float(found.area) == 0.0
    assert math.isfinite(float(found.step))
    assert np.isnan([float(found.near), float(found.far), float(found.least)]).all()
    assert np.isnan(np.asarray(found.along)).all()


CHANGE = math.radians(0.2)
FORMULAS = {
    "heading": (
        {"heading": 0.2},
        geometry.overlap_change_by_heading(heading_change=CHANGE, off_nadir=NEAR, field_of_view=FIELD),
    ),
    "pitch": (
        {"pitch": 0.2},
        geometry.overlap_change_by_pitch(pitch_change=CHANGE, off_nadir=NEAR, field_of_view=FIELD),
    ),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_changes_of_attitude_agree_with_the_formulas(name: str) -> None:
    """Li et al. (2020), Eqs 18 and 19, at the near end."""
    change, expected = FORMULAS[name]
    found = float(shared(FIRST, shot(STEP, **change)).near) - float(shared(FIRST, shot(STEP)).near)
    assert found == pytest.approx(float(expected), abs=4e-4)


def test_a_roll_agrees_with_eq_22() -> None:
    """The left wing down lifts the look: the near end lies farther out, where frames are longer."""
    level = float(shared(FIRST, shot(STEP)).near)
    found = shared(FIRST, shot(STEP, roll=-0.2))
    expected = geometry.overlap_change_by_roll(off_nadir_change=CHANGE, off_nadir=NEAR, overlap=level)
    assert float(found.near) - level == pytest.approx(float(expected), abs=1e-3)
    assert float(found.side) == pytest.approx(1.0 - 0.2 / 0.88, abs=0.02)


@pytest.mark.costly
def test_the_axis_along_the_flight_is_found() -> None:
    after = shot(STEP)
    given, found = shared(FIRST, after), overlap(SENSOR, FIRST, after, GROUND, stations=STATIONS)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(given), strict=True):
        np.testing.assert_array_equal(one, other)
    direction = flight_direction(FIRST, after, local_projection(FIRST))
    across = jnp.stack([direction[1], -direction[0]])
    assert axis_along(SENSOR, FIRST, direction, GROUND, local_projection(FIRST)) == "rows"
    assert axis_along(SENSOR, FIRST, across, GROUND, local_projection(FIRST)) == "columns"


@pytest.mark.slow
def test_the_wrong_axis_gives_no_numbers() -> None:
    found = shared(FIRST, shot(STEP), along="columns")
    assert int(found.status) in (Status.invalid_input, Status.images_apart)
    assert np.isnan([float(found.near), float(found.far), float(found.least)]).all()


DERIVATIVES = {"pitch": (0.05, 1e-3), "heading": (0.02, 1e-3), "height": (8150.0, 1.0)}


@pytest.mark.slow
def test_derivatives() -> None:
    """Forward mode by the second shot's pose against central differences."""
    at, steps = np.array(list(DERIVATIVES.values())).T
    direction = jnp.array([0.0, 1.0])

    def near(x: Any) -> jax.Array:
        return shared(FIRST, shot(STEP, **dict(zip(DERIVATIVES, x, strict=True))), direction=direction).near

    for unit, step in zip(np.eye(3), steps, strict=True):
        _, exact = jax.jvp(near, (at,), (unit,))  # one program serves all
        numeric = (float(near(at + step * unit)) - float(near(at - step * unit))) / (2.0 * step)
        assert exact != 0.0
        assert float(exact) == pytest.approx(numeric, rel=1e-5)


def test_over_the_horizon() -> None:
    found = shared(FIRST, shot(STEP, outer=87.0))
    assert int(found.status) in (Status.rises_away, Status.ray_misses_terrain)
    values = [np.asarray(leaf) for leaf in jax.tree.leaves(eqx.tree_at(lambda one: one.status, found, np.nan))]
    assert all(np.isnan(value).all() for value in values)


def with_ridge(height: float, *, columns: int = 121) -> Dem:
    """Level ground under the images, and a ridge of a height in m along the flight before their near ends."""
    middle = seen(FIRST, 0.5 * (PIXELS - 1), 0.5 * (PIXELS - 1))
    centre = Geodetic(lat=middle.lat, lon=middle.lon, height=0.0)
    across = 60.0 * (np.arange(columns) - 0.5 * (columns - 1))
    posts = np.tile(height * np.exp(-0.5 * ((across + 1600.0) / 500.0) ** 2), (121, 1))
    return Dem.from_array(posts, TangentGrid.centred(centre, spacing=(60.0, 60.0), shape=posts.shape))


@pytest.mark.slow
def test_a_ridge_takes_from_the_overlap() -> None:
    """Ground that is nearer by a share of the height makes the frame shorter by as much; the step stays."""
    flat, ridge = (shared(FIRST, shot(STEP), with_ridge(height)) for height in (0.0, 300.0))
    assert int(flat.status) == int(ridge.status) == Status.hit
    met = locate(SENSOR, FIRST, jnp.array([near_end(), 0.5 * (PIXELS - 1)]), with_ridge(300.0)).position.height
    assert 150.0 < float(met) < 300.0
    assert float(ridge.near) == pytest.approx(1.0 - (1.0 - float(flat.near)) * HEIGHT / (HEIGHT - float(met)), abs=2e-3)


@pytest.mark.slow
def test_over_the_edge_of_the_terrain() -> None:
    found = shared(FIRST, shot(STEP), with_ridge(0.0, columns=21))
    assert int(found.status) in (Status.leaves_terrain, Status.ray_misses_terrain)
    assert np.isnan(float(found.near))
    assert np.isnan(float(found.area))


def sweep(duration: float) -> Sensor:
    """The same line of pixels along the flight, swept from the near end to the far end of the frame."""
    near, far = (math.radians(OUTER) + half - 0.5 * math.pi for half in (-0.5 * FIELD, 0.5 * FIELD))
    return li_2023_sweep_sensor(
        focal_length=1.0,
        pixel_pitch=PITCH,
        width=PIXELS,
        height=64,
        scan_start=near,
        scan_end=far,
        duration=duration,
    )


@pytest.mark.slow
def test_sweeps_overlap_as_frames_do() -> None:
    """Strips that are swept alike are sheared alike by the flight: they share what frames do."""
    speed = 172.0
    step, velocity = STEP / speed, np.array([speed, 0.0, 0.0])
    times = [jnp.zeros(()), jnp.asarray(step)]
    flights = [
        Trajectory.steady(shot(0.0, outer=outer), velocity_ned=velocity, before=1.0, after=2.0 * step)
        for outer in (OUTER, 90.0)
    ]
    frame = shared(*(MovingExposure(flights[0], time) for time in times))
    before, after = (MovingExposure(flights[1], time) for time in times)
    for duration in (1e-6, 1.0):
        found = overlap(sweep(duration), before, after, GROUND, along="columns", stations=STATIONS)
        assert int(found.status) == Status.hit
        for name in ("near", "far", "side", "area"):
            assert float(getattr(found, name)) == pytest.approx(float(getattr(frame, name)), abs=2e-3)
    again = overlap(sweep(1.0), before, after, GROUND, stations=STATIONS)
    assert again.step == found.step, "the axis is found, too"


@pytest.mark.parametrize(
    "call, error, words",
    [
        (lambda: shared(FIRST, FIRST), ValueError, "gives no direction of flight"),
        (lambda: shared(FIRST, shot(STEP), stations=1), ValueError, "stations must be at least 2"),
        (lambda: shared(FIRST, FIRST.pose), TypeError, "Exposure"),
    ],
)
def test_refusals(call, error, words: str) -> None:
    with pytest.raises(error, match=words):
        call()


# Of as many pixels, so that nothing new is compiled: 1500 m on a side from 2 km.
DOWN = li_2020_sensor(
    focal_length=0.02, pixel_pitch=1.5e-2 / PIXELS, along_flight=PIXELS, across_flight=PIXELS, mirror=False
)


def straight_down(north: float, roll: float, heading: float = 0.0) -> Shot:
    pose = Pose.from_degrees(lat=LAT + north / 110_940.0, lon=LON, height=2000.0, heading=heading, roll=roll)
    return Shot(pose, DOWN.gimbal.readings_from_degrees(outer=0.0, inner=0.0))


@pytest.mark.costly
@pytest.mark.parametrize("roll, heading", [(0.0, 0.0), (0.3, 0.0), (2.0, 180.0)])
def test_a_camera_that_looks_straight_down_may_roll_either_way(roll: float, heading: float) -> None:
    """Which end is the near one then changes from image to image, but not which end goes with which."""
    images = [straight_down(north, side * roll, heading) for north, side in ((0.0, 1.0), (600.0, -1.0))]
    found = overlap(DOWN, *images, GROUND, along="rows", stations=STATIONS)
    assert found.ok
    outlines = [footprint(DOWN, image, GROUND, places=4) for image in images]
    assert float(found.area) == pytest.approx(polygon_overlap(*outlines), abs=2e-4)
    assert float(found.near) == pytest.approx(0.6, abs=0.02)


@pytest.mark.costly
@pytest.mark.parametrize("heading", [0.0, 10.0, 29.0, 31.0, 45.0, 90.0, 135.0, 151.0, 180.0, 250.0])
def test_images_that_are_turned_share_the_area_of_their_outlines(heading: float) -> None:
    """And no lengths along and across a flight, unless they are nearly parallel."""
    images = straight_down(0.0, 0.0), straight_down(400.0, 0.0, heading)
    found = overlap(DOWN, *images, GROUND, along="rows", stations=STATIONS)
    outlines = [footprint(DOWN, image, GROUND, places=4) for image in images]
    assert float(found.area) == pytest.approx(polygon_overlap(*outlines), abs=2e-3)
    is_alike = min(heading % 180.0, -heading % 180.0) < 30.0
    assert int(found.status) == (Status.hit if is_alike else Status.images_turned)
    lengths = np.array([found.near, found.far, found.least, found.side, found.step], float)
    assert np.all(np.isfinite(lengths) == is_alike)


@pytest.mark.costly
def test_turned_images_far_apart_share_nothing() -> None:
    found = overlap(DOWN, straight_down(0.0, 0.0), straight_down(9000.0, 0.0, 70.0), GROUND, along="rows")
    assert (int(found.status), float(found.area)) == (Status.images_turned, 0.0)


@pytest.mark.slow
def test_the_wrong_axis_is_invalid() -> None:
    images = straight_down(0.0, 0.0), straight_down(600.0, 0.0)
    found = overlap(DOWN, *images, GROUND, along="columns", stations=STATIONS)
    assert int(found.status) == Status.invalid_input
    assert np.isnan(found.near)


def test_an_unknown_axis_is_refused() -> None:
    with pytest.raises(ValueError, match=r"along must be .*got 'cols'"):
        check_along("cols")
