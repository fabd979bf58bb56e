"""The clock of a stream of navigation records: exact where the integral is known, whatever the records' rate."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from jaxgeo.coverage import ExposureClock
from jaxgeo.coverage.clock import AT_ONCE

FIELD = math.radians(0.88)
MARK = 0.85 * 2.0 * math.tan(0.5 * FIELD)
CLOCK = ExposureClock.of(overlap=0.15, field_of_view=FIELD)


def run(times, speed, slant_range) -> np.ndarray:
    """All times that come of records of two functions of time."""
    clock, found = CLOCK, []
    for time in times:
        clock, due, count = clock.record(time=time, speed=speed(time), slant_range=slant_range(time))
        assert np.all(np.isinf(due[int(count) :]))
        found += np.asarray(due)[: int(count)].tolist()
    return np.array(found)


def test_steady_flight_has_the_period_of_the_formula():
    """Table 4 of Li et al. (2020): 620.09 km/h, 8143 m above ground, 16.047 deg of depression."""
    speed, reach = 620.09 / 3.6, 8143.0 / math.sin(math.radians(16.047))
    found = run(np.linspace(100.0, 120.0, 41), lambda t: speed, lambda t: reach)
    np.testing.assert_allclose(np.diff(found), 2.233, rtol=0, atol=5e-4)
    assert found[0] == 100.0
    np.testing.assert_allclose(np.diff(found), MARK * reach / speed, rtol=1e-12)


@pytest.mark.parametrize("every", [0.05, 1.0, 4.0])
def test_the_time_is_located_not_the_next_record(every):
    """Speed and range that are straight lines in time: any rate of records finds the same times."""
    speed, reach = (lambda t: 170.0 + 4.0 * t), (lambda t: 12000.0 - 90.0 * t)
    found = run(np.arange(0.0, 20.0 + 1e-9, every), speed, reach)
    for k, time in enumerate(found):
        integral, _ = quad(lambda t: speed(t) / reach(t), 0.0, time, epsabs=1e-13)
        assert integral == pytest.approx(k * MARK, abs=1e-11)
    assert len(found) > 20


def test_several_images_may_fall_due_at_once_and_too_many_are_an_error():
    clock, _, _ = CLOCK.record(time=0.0, speed=200.0, slant_range=10_000.0)
    period = MARK * 50.0
    _, due, count = clock.record(time=3.5 * period, speed=200.0, slant_range=10_000.0)
    assert int(count) == 3
    np.testing.assert_allclose(due[:3], period * np.array([1.0, 2.0, 3.0]), rtol=1e-12)
    with pytest.raises(ValueError, match=rf"40 images fell due between .*more than {AT_ONCE}"):
        clock.record(time=40.5 * period, speed=200.0, slant_range=10_000.0)


@pytest.mark.costly
def test_a_scan_counts_as_a_loop_does_and_is_differentiable():
    times = jnp.linspace(0.0, 10.0, 41)

    def last(speed):
        def step(clock, time):
            clock, due, _ = clock.record(time=time, speed=speed + 2.0 * time, slant_range=11_000.0)
            return clock, due

        due = jax.lax.scan(step, CLOCK, times)[1]
        return jnp.max(jnp.where(jnp.isfinite(due), due, 0.0))

    slope = jax.jit(jax.grad(last))(170.0)
    assert slope == pytest.approx(float(last(170.5) - last(169.5)), rel=1e-4)
    found = run(np.asarray(times), lambda t: 170.0 + 2.0 * t, lambda t: 11_000.0)
    assert float(last(170.0)) == pytest.approx(found[-1], abs=1e-12)


def test_what_is_expected_is_what_comes_if_nothing_changes():
    clock, _, _ = CLOCK.record(time=5.0, speed=200.0, slant_range=10_000.0)
    clock, _, _ = clock.record(time=5.1, speed=200.0, slant_range=10_000.0)
    assert float(clock.expected()) == pytest.approx(5.0 + MARK * 50.0, abs=1e-12)


MISTAKES = {
    "backwards": (
        {"time": 4.0, "speed": 200.0, "slant_range": 1e4},
        r"time runs backwards: a record at 4 s after .* 5 s",
    ),
    "twice": ({"time": 5.0, "speed": 200.0, "slant_range": 1e4}, "time runs backwards"),
    "standing": ({"time": 6.0, "speed": 0.0, "slant_range": 1e4}, "speed must be above 0 m/s"),
    "no range": ({"time": 6.0, "speed": 200.0, "slant_range": -1.0}, "slant_range must be above 0 m"),
    "no time": ({"time": math.nan, "speed": 200.0, "slant_range": 1e4}, "time must be finite"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_told_in_words(name):
    record, words = MISTAKES[name]
    clock, _, _ = CLOCK.record(time=5.0, speed=200.0, slant_range=1e4)
    with pytest.raises(ValueError, match=words):
        clock.record(**record)


@pytest.mark.parametrize(
    "overlap, field, words", [(1.0, FIELD, r"\[0, 1\)"), (-0.1, FIELD, r"\[0, 1\)"), (0.1, 0.0, "pi")]
)
def test_a_clock_without_sense_is_refused(overlap, field, words):
    with pytest.raises(ValueError, match=words):
        ExposureClock.of(overlap=overlap, field_of_view=field)
