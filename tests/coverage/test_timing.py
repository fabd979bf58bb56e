"""When images are due: periods, the velocity-height integral and the ground itself, over a plain and over mountains."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo import ConstantHeight, Dem, Geodetic, Pose, Status, Trajectory
from jaxgeo.coverage import FixedPeriod, GroundShared, Plan, VelocityHeight, geometry, plan
from jaxgeo.coverage.timing import Course
from jaxgeo.io import example_dem
from jaxgeo.sensor.conventions import li_2020_sensor
from jaxgeo.terrain import TangentGrid

PIXELS, FIELD = 1536, math.radians(0.88)
SENSOR = li_2020_sensor(
    focal_length=1.0,
    pixel_pitch=2.0 * math.tan(0.5 * FIELD) / PIXELS,
    along_flight=PIXELS,
    across_flight=PIXELS,
    mirror=False,
)
PLAIN = ConstantHeight(jnp.asarray(300.0))
HEIGHT, SPEED, OUTER, LAT, HEADING = 5500.0, 170.0, 65.0, 36.40, math.radians(150.0)
WISHED = 0.15
STATIONS = 5


def flight(
    duration: float = 12.0, *, speed: float = SPEED, swing: float = 0.05, knots: int | None = None
) -> Trajectory:
    """Straight on, with swings of speed and height; knots every half second, or so many."""
    times = np.linspace(0.0, duration, int(2 * duration) + 1 if knots is None else knots)
    speeds = speed * (1.0 + swing * np.sin(2.0 * np.pi * times / 23.0))
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * np.diff(times))])
    pose = Pose.from_degrees(
        lat=LAT + way * math.cos(HEADING) / 110_940.0,
        lon=-84.20 + way * math.sin(HEADING) / (111_320.0 * math.cos(math.radians(LAT))),
        height=HEIGHT * (1.0 + swing * np.sin(2.0 * np.pi * times / 31.0 + 1.0)),
        heading=np.full(times.shape, math.degrees(HEADING)),
    )
    return Trajectory.from_knots(times, pose, np.tile(np.radians([OUTER, 0.0]), (len(times), 1)))


FLIGHT = flight()


def planned(timing: Any, terrain: Any = PLAIN, trajectory: Trajectory = FLIGHT, **options: Any) -> Plan:
    return plan(SENSOR, trajectory, terrain, timing, **{"along": "rows", "stations": STATIONS} | options)


@pytest.mark.slow
def test_a_fixed_period_is_kept() -> None:
    found = planned(FixedPeriod(0.9))
    np.testing.assert_allclose(found.times, 0.9 * np.arange(14), rtol=0, atol=1e-12)
    assert found.overlaps.near.shape == (13,)
    assert np.all(np.asarray(found.overlaps.status) == Status.hit)
    assert np.ptp(np.asarray(found.overlaps.near)) > 0.03, "speed and height swing, and the period does not follow"
    course = Course(SENSOR, FLIGHT, PLAIN, None, "rows")
    assert len(FixedPeriod(0.75).times(course, 0.0, 100)) == 17, "the last image is that at the very end"
    np.testing.assert_allclose(FixedPeriod(0.9).times(course, 1.0, 3), [1.0, 1.9, 2.8], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_progress_counts_up_to_the_length_of_the_flight() -> None:
    """After each image that is searched for; of a fixed period nothing is."""
    told: list[tuple[float, float]] = []
    found = planned(GroundShared(WISHED), progress=lambda *numbers: told.append(numbers))
    done, totals = np.array(told).T
    assert np.all(np.diff(done) > 0.0)
    np.testing.assert_allclose(done, np.asarray(found.times)[1:] - found.times[0], rtol=0, atol=1e-9)
    assert set(totals) == {12.0}
    told.clear()
    planned(FixedPeriod(0.9), progress=lambda *numbers: told.append(numbers))
    assert not told


@pytest.mark.slow
def test_the_period_of_eq_29_in_steady_flight() -> None:
    """Over level ground and at one speed and height, the formula gives the overlap that is wished."""
    period = geometry.period_of_overlap(
        overlap=WISHED,
        speed=SPEED,
        height_above_ground=HEIGHT - 300.0,
        off_nadir=math.radians(OUTER) - 0.5 * FIELD,
        field_of_view=FIELD,
    )
    found = planned(FixedPeriod(period), trajectory=flight(swing=0.0))
    np.testing.assert_allclose(found.overlaps.near, WISHED, rtol=0, atol=0.01)  # of the Earth's curvature


@pytest.mark.slow
@pytest.mark.parametrize("height", [None, 300.0], ids=["ground that is seen", "ground of a height"])
def test_velocity_over_height_keeps_the_overlap_over_a_plain(height: float | None) -> None:
    """Under changes of speed and height by 5 %, within half a point of the wish."""
    found = planned(VelocityHeight(WISHED, None if height is None else jnp.asarray(height)))
    near = np.asarray(found.overlaps.near)
    print("velocity-height", near.mean(), near.min(), near.max())
    np.testing.assert_allclose(near, WISHED, rtol=0, atol=0.005)
    assert np.ptp(np.diff(found.times)) > 0.02


@pytest.mark.slow
def test_the_shared_ground_is_exact_over_a_plain() -> None:
    found = planned(GroundShared(jnp.asarray(WISHED), stations=STATIONS))
    np.testing.assert_allclose(found.overlaps.near, WISHED, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.overlaps.least, WISHED, rtol=0, atol=1e-6)
    times = np.asarray(found.times)
    assert times[-1] <= float(FLIGHT.end)
    assert times[-1] + 1.5 * np.diff(times).max() > float(FLIGHT.end), "it goes on to the end of the flight"


@pytest.mark.slow
def test_over_mountains() -> None:
    """Where a fixed period of the same mean misses by points, the shared ground keeps to the wish."""
    where = {"terrain": example_dem(), "trajectory": flight(36.0)}
    by_ground = planned(GroundShared(WISHED, stations=STATIONS), **where)
    least = planned(GroundShared(WISHED, "least", stations=STATIONS), **where)
    by_height = planned(VelocityHeight(WISHED), **where)
    fixed = planned(FixedPeriod(float(np.mean(np.diff(by_ground.times)))), **where)
    for name, one in (("ground", by_ground), ("least", least), ("velocity-height", by_height), ("fixed", fixed)):
        near = np.asarray(one.overlaps.near)
        print(name, len(one.times), near.mean().round(4), near.min().round(4), near.max().round(4))
        assert np.all(np.asarray(one.overlaps.status) == Status.hit)
    np.testing.assert_allclose(by_ground.overlaps.near, WISHED, rtol=0, atol=0.01)
    np.testing.assert_allclose(least.overlaps.least, WISHED, rtol=0, atol=0.01)
    assert np.abs(np.asarray(by_height.overlaps.near) - WISHED).max() < 0.03
    assert np.abs(np.asarray(fixed.overlaps.near) - WISHED).max() > 0.04


@pytest.mark.slow
def test_the_axis_along_the_flight_is_found() -> None:
    given, found = planned(FixedPeriod(0.9)), planned(FixedPeriod(0.9), along=None)
    np.testing.assert_array_equal(found.overlaps.near, given.overlaps.near)


CRAWLS = flight(speed=1.0)
LOOKS_UP = FLIGHT.with_readings(np.radians([89.9, 0.0]))


@pytest.mark.costly
@pytest.mark.parametrize(
    "timing, options, words",
    [
        (FixedPeriod(20.0), {}, "the navigation is too short"),
        (VelocityHeight(0.0), {"trajectory": CRAWLS}, "the navigation is too short"),
        (
            GroundShared(jnp.asarray(0.0), stations=STATIONS),
            {"trajectory": CRAWLS},
            "the navigation is too short",
        ),
        (FixedPeriod(0.9), {"start": -1.0}, "start must lie on the trajectory, 0 to 12 s; got -1 s"),
        (FixedPeriod(0.9), {"start": 13.0}, "start must lie on the trajectory"),
        (FixedPeriod(0.9), {"start": math.nan}, "start"),
        (FixedPeriod(0.0), {}, "period must be above 0 s"),
        (FixedPeriod(-1.0), {}, "period must be above 0 s; got -1.0"),
        (VelocityHeight(1.0), {}, r"overlap must lie in \[0, 1\).*got 1.0"),
        (VelocityHeight(-0.1), {}, r"overlap must lie in \[0, 1\).*got -0.1"),
        (GroundShared(1.2), {}, r"overlap must lie in \[0, 1\).*got 1.2"),
        (VelocityHeight(WISHED), {"trajectory": LOOKS_UP}, "sees no ground at 0 s"),
    ],
)
def test_refusals(timing: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        planned(timing, **options)


@pytest.mark.parametrize("times", [[0.0, 1.0, 0.5], [0.0, 1.0, 1.0]], ids=["backwards", "still"])
def test_time_does_not_run_backwards(times: list[float]) -> None:
    pose = Pose.from_degrees(lat=np.full(3, LAT), lon=np.full(3, -84.2), height=np.full(3, HEIGHT), heading=np.zeros(3))
    with pytest.raises(ValueError, match="times must increase, but knot 2"):
        Trajectory.from_knots(times, pose, np.zeros((3, 2)))


# Of as many pixels, and flown with as many knots but five times as fast, so that nothing is compiled anew.
WIDE = li_2020_sensor(
    focal_length=1.0, pixel_pitch=1.0 / PIXELS, along_flight=PIXELS, across_flight=PIXELS, mirror=False
)


@pytest.mark.costly
@pytest.mark.parametrize("outer, inner", [(40.0, 0.0), (0.0, 30.0), pytest.param(1.0, 0.0, marks=pytest.mark.slow)])
def test_wide_frames_are_timed_by_their_length_at_the_near_end(outer: float, inner: float) -> None:
    """Beside the middle of an image its angle of view is not that of the middle; nor does looking ahead leave it so."""
    steady = flight(speed=5.0 * SPEED, swing=0.0).with_readings(jnp.deg2rad(jnp.array([outer, inner])))
    found = plan(WIDE, steady, PLAIN, VelocityHeight(0.6), along="rows", stations=STATIONS)
    np.testing.assert_allclose(found.overlaps.near, 0.6, rtol=0, atol=2e-3)


def with_a_rest() -> Trajectory:
    """Ten seconds ahead, braking at their end, ten at rest, ten ahead."""
    times = np.linspace(0.0, 30.0, 61)
    speed = SPEED * np.clip(0.5 * (np.abs(times - 15.0) - 5.0), 0.0, 1.0)
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(times))])
    pose = Pose.from_degrees(lat=LAT + way / 110_940.0, lon=np.full(61, -84.2), height=np.full(61, HEIGHT))
    return Trajectory.from_knots(times, pose, np.tile(np.radians([OUTER, 0.0]), (61, 1)))


@pytest.mark.parametrize("timing", [VelocityHeight(WISHED), GroundShared(WISHED, stations=STATIONS)])
@pytest.mark.slow
def test_who_stands_still_takes_no_images_and_goes_on(timing: Any) -> None:
    found = planned(timing, trajectory=with_a_rest())
    times = np.asarray(found.times)
    assert not np.any((times > 10.1) & (times < 19.9))
    assert np.sum(times > 20.0) >= 7
    np.testing.assert_allclose(found.overlaps.near, WISHED, rtol=0, atol=0.02)


@pytest.mark.slow
def test_over_unseen_ground_images_follow_as_level_ground_would_have_it() -> None:
    """The far end looks into a void for a while: no burst of images, and none is left out."""
    void = np.zeros((81, 81), bool)
    void[30:50, 38:] = True
    grid = TangentGrid.centred(
        Geodetic.from_degrees(lat=LAT + 0.008, lon=-84.2 + 0.13, height=0.0), spacing=(60.0, 200.0), shape=void.shape
    )
    terrain = Dem.from_array(np.full(void.shape, 300.0), grid, void=void)
    times = np.linspace(0.0, 16.0, 33)
    pose = Pose.from_degrees(lat=LAT + SPEED * times / 110_940.0, lon=np.full(33, -84.2), height=np.full(33, HEIGHT))
    north = Trajectory.from_knots(times, pose, np.tile(np.radians([OUTER, 0.0]), (33, 1)))
    level = planned(VelocityHeight(WISHED, 300.0), trajectory=north)
    found = planned(GroundShared(WISHED, stations=STATIONS), terrain, north)
    unseen = np.asarray(found.overlaps.status) != Status.hit
    assert unseen.any()
    assert not unseen.all()
    assert abs(len(found.times) - len(level.times)) <= 2
    assert np.diff(found.times).min() > 0.7 * np.diff(level.times).min()


@pytest.mark.parametrize(
    "timing, options, words",
    [
        (FixedPeriod(1.0), {"most": 1}, "most must be at least 2 images; got 1"),
        (FixedPeriod(1.0), {"stations": 1}, "stations must be at least 2"),
        pytest.param(VelocityHeight(WISHED), {"start": 12.0}, "the navigation is too short", marks=pytest.mark.slow),
    ],
)
def test_more_refusals(timing: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        planned(timing, **options)


EARLY = [
    (FixedPeriod(20.0), {}, "the navigation is too short"),
    (FixedPeriod(0.0), {}, "period must be above 0 s"),
    (VelocityHeight(0.0), {"trajectory": flight(speed=1.0)}, "the navigation is too short"),
    (VelocityHeight(WISHED), {"start": 12.0}, "the navigation is too short"),
    (VelocityHeight(1.0), {}, r"overlap must lie in \[0, 1\)"),
    (VelocityHeight(WISHED), {"trajectory": LOOKS_UP}, "sees no ground at 0 s"),
    (
        GroundShared(0.15, stations=STATIONS),
        {"trajectory": flight(0.5, knots=25)},
        "later than 0.5 s, the time of the last whole image",
    ),
    (GroundShared(0.0, stations=STATIONS), {"trajectory": flight(speed=1.0)}, "the navigation is too short"),
    (GroundShared(0.15, stations=1), {}, "stations must be at least 2"),
    (GroundShared(1.2), {}, r"overlap must lie in \[0, 1\)"),
]


@pytest.mark.costly
@pytest.mark.parametrize("along", ["rows", None])
@pytest.mark.parametrize("timing, options, words", EARLY)
def test_what_cannot_work_is_refused_before_anything_is_searched(
    monkeypatch: pytest.MonkeyPatch, timing: Any, options: dict[str, Any], words: str, along: Any
) -> None:
    if along is None and words == "sees no ground at 0 s":
        pytest.skip("without the axis along the flight nobody knows which end is near")
    for name in ("_axis_at", "_rates", "_first_due", "overlaps_at"):
        monkeypatch.setattr(f"jaxgeo.coverage.timing.{name}", lambda *_, name=name: pytest.fail(f"{name} compiled"))
    with pytest.raises(ValueError, match=words):
        planned(timing, **{"along": along} | options)


@pytest.mark.costly
def test_a_flight_that_may_do_is_not_refused_early(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half as long again as needed on level ground; all that comes after is left out."""

    class GoesOn(Exception):
        """Not a refusal."""

    def search(*_: Any) -> Any:
        raise GoesOn

    monkeypatch.setattr("jaxgeo.coverage.timing._rates", search)
    with pytest.raises(GoesOn):
        planned(GroundShared(WISHED, stations=STATIONS))
