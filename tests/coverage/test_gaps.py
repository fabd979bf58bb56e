"""Strips flown in noise: the plan itself, what compensation does, and gaps by samples and by derivatives."""

from __future__ import annotations

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from jaxgeo import ConstantHeight, Pose, Shot, Status
from jaxgeo.coverage import (
    Compensation,
    FlightNoise,
    Strip,
    fly,
    linear_gaps,
    linear_is_valid,
    required_overlap,
)
from jaxgeo.coverage.flight import SPECS, flown, normals_of, specs_of
from jaxgeo.coverage.gaps import orthant
from jaxgeo.io import example_dem
from jaxgeo.sensor.conventions import li_2020_sensor

SENSOR = li_2020_sensor(
    focal_length=1.0,
    pixel_pitch=2 * math.tan(math.radians(0.44)) / 1536,
    along_flight=1536,
    across_flight=1536,
    mirror=False,
)
SHOT = Shot(
    Pose.from_degrees(lat=36.35, lon=-84.12, height=5500.0, heading=150.0),
    SENSOR.gimbal.readings_from_degrees(outer=65.0, inner=0.0),
)
PLAN = {"overlap": 0.15, "speed": 170.0, "images": 6, "along": "rows", "stations": 3}
NOISE = FlightNoise.from_degrees(
    heading=0.15, pitch=0.15, roll=0.1, height=20.0, across=20.0, speed=3.0, gimbal=0.02, timing=0.01, lasting=20.0
)
QUIET = FlightNoise.from_degrees()
NOTHING, HELD = Compensation(), Compensation(attitude=True)
TIMED, ON_GROUND = Compensation(attitude=True, timing=True), Compensation(attitude=True, timing=True, ground=True)
KEY = jax.random.key(3)


@functools.cache
def strip() -> Strip:
    """The strip over level ground that most flights follow."""
    return Strip.planned(SENSOR, SHOT, ConstantHeight(300.0), **PLAN)


@pytest.fixture(scope="module")
def flights():
    """A thousand flights with nothing done about the noise."""
    return fly(strip(), NOISE, key=KEY, flights=1024)


@pytest.fixture(scope="module")
def linear():
    """The same by derivatives."""
    return linear_gaps(strip(), NOISE)


@pytest.mark.slow
@pytest.mark.parametrize("compensation", [NOTHING, TIMED], ids=lambda c: c.words)
def test_without_noise_the_plan_is_flown(compensation):
    flights = fly(strip(), QUIET, key=KEY, flights=2, compensation=compensation)
    assert np.all(np.asarray(flights.status) == Status.hit)
    # The formula's length is that of a range over a curved Earth, the measured one that on the map.
    np.testing.assert_allclose(flights.near, 0.15, rtol=0, atol=2e-3)
    assert np.ptp(np.asarray(flights.near)) < 1e-5  # every pair is like the first


@pytest.mark.slow
@pytest.mark.parametrize("compensation", [NOTHING, TIMED], ids=lambda c: c.words)
def test_without_noise_steps_are_as_planned(compensation):
    overlap = eqx.filter_jit(flown)(strip(), QUIET, jnp.ones(normals_of(strip())), compensation)
    np.testing.assert_allclose(overlap.step, strip().step, rtol=1.5e-3)  # the ground goes by slower than the aircraft


@pytest.mark.slow
def test_flights_hang_on_key_and_number_alone(flights):
    fewer = fly(strip(), NOISE, key=KEY, flights=7)
    np.testing.assert_allclose(fewer.near, flights.near[:7], rtol=0, atol=1e-11)
    with pytest.raises(ValueError, match="at least 2; got 1"):
        fly(strip(), NOISE, key=KEY, flights=1)


@pytest.mark.slow
def test_the_spread_of_overlaps_is_that_of_the_derivatives(flights, linear):
    spread = np.sqrt(np.diagonal(np.asarray(linear.cov.sum(axis=0))))[:5]
    np.testing.assert_allclose(np.asarray(flights.near).std(axis=0), spread, rtol=0.06)
    np.testing.assert_allclose(np.asarray(flights.near).mean(axis=0), linear.margins[:5], rtol=0, atol=0.008)


@pytest.mark.costly
def test_neighbouring_attitudes_go_together():
    """The correlation of a process from image to image is exp(-period / lasting)."""
    only = FlightNoise.from_degrees(heading=0.01, lasting=2.0)
    normals = jax.vmap(lambda k: jax.random.normal(jax.random.fold_in(KEY, k), (normals_of(strip()),)))(jnp.arange(512))
    from jaxgeo.coverage.flight import _drawn

    heading = np.asarray(jax.vmap(lambda n: _drawn(strip(), only, n)[0][0])(normals))
    np.testing.assert_allclose(heading.std(axis=0), math.radians(0.01), rtol=0.12)
    kept = np.corrcoef(heading[:, 1], heading[:, 2])[0, 1]
    assert kept == pytest.approx(math.exp(-float(strip().period) / 2.0), abs=0.08)


@pytest.mark.slow
def test_gaps_by_samples_and_by_derivatives_agree_where_the_terrain_is_trusted(flights, linear):
    assert np.all(linear_is_valid(strip(), NOISE))
    chance, (low, high) = flights.gap_probability(0.99)
    assert low <= linear.gap_probability <= high
    assert 0.02 < chance < 0.3  # or there would be little to agree about
    slopes = linear.gap_derivatives()
    for name, (value, error) in flights.gap_derivatives().items():
        assert abs(value - slopes[name]) < 4.0 * error


@pytest.mark.slow
def test_derivatives_of_the_linear_probability_equal_differences(linear):
    slopes, step = linear.gap_derivatives(), 1e-3
    for name in ("heading", "speed", "gimbal"):
        sigma = float(getattr(NOISE, name))
        around = []
        for factor in (1.0 + step, 1.0 - step):
            scales = jnp.ones(len(SPECS)).at[SPECS.index(name)].set(factor)
            around.append(1.0 - float(orthant(linear.margins, jnp.tensordot(scales**2, linear.cov, 1))))
        assert slopes[name] * sigma == pytest.approx((around[0] - around[1]) / (2.0 * step), rel=1e-4, abs=1e-9)


@pytest.mark.slow
def test_derivatives_of_samples_equal_differences_with_the_same_numbers():
    """Score against flying again with a little more noise, on both sides; ten thousand flights."""
    noise = FlightNoise.from_degrees(heading=0.15, pitch=0.15, gimbal=0.02, lasting=20.0)
    found = fly(strip(), noise, key=KEY, flights=8192)
    value, error = found.gap_derivatives()["heading"]
    more, less = (
        fly(strip(), FlightNoise.from_degrees(heading=h, pitch=0.15, gimbal=0.02, lasting=20.0), key=KEY, flights=8192)
        for h in (0.165, 0.135)
    )
    bad = [np.asarray(one.gap_of_strip, float) for one in (more, less)]
    differences = (bad[0] - bad[1]) / math.radians(0.03)
    tolerance = 3.5 * math.hypot(error, differences.std() / math.sqrt(8192))
    assert abs(differences.mean() - value) < tolerance
    assert tolerance < 0.5 * value  # a bound that could fail


@pytest.mark.slow
def test_compensation_does_what_it_says(flights):
    held = fly(strip(), NOISE, key=KEY, flights=512, compensation=HELD)
    timed = fly(strip(), NOISE, key=KEY, flights=512, compensation=TIMED)
    spread = [float(np.asarray(one.near).std()) for one in (flights, held, timed)]
    assert spread[1] < 0.7 * spread[0]
    assert spread[2] < 0.95 * spread[1]
    only_attitude = FlightNoise.from_degrees(heading=0.3, pitch=0.3, roll=0.3)
    kept = fly(strip(), only_attitude, key=KEY, flights=64, compensation=HELD)
    # The line of sight is held; the image still turns about it, and by that its edges.
    assert float(np.abs(np.asarray(kept.near) - 0.15).max()) < 0.02


@pytest.mark.slow
def test_timing_by_the_ground_follows_mountains():
    over_mountains = Pose.from_degrees(lat=36.40, lon=-84.12, height=5500.0, heading=150.0)
    shot = Shot(over_mountains, SENSOR.gimbal.readings_from_degrees(outer=72.0, inner=0.0))
    strip = Strip.planned(SENSOR, shot, example_dem(), **(PLAN | {"images": 40}))
    quiet = jnp.zeros(normals_of(strip))
    fixed, followed = (np.asarray(eqx.filter_jit(flown)(strip, QUIET, quiet, c).near) for c in (HELD, ON_GROUND))
    print(np.abs(fixed - 0.15).max(), np.abs(followed - 0.15).max())
    off = [float(np.sqrt(np.mean((one - 0.15) ** 2))) for one in (fixed, followed)]
    assert off[1] < 0.5 * off[0]


@pytest.mark.slow
def test_a_wider_margin_makes_strips_free_of_gaps():
    planned = required_overlap(strip(), NOISE, free=0.99)
    assert 0.15 < planned < 0.5
    assert 1.0 - linear_gaps(strip().with_overlap(planned), NOISE).gap_probability == pytest.approx(0.99, abs=1e-3)
    sampled = fly(strip().with_overlap(planned), NOISE, key=jax.random.key(8), flights=4096)
    low, high = sampled.gap_probability(0.999)[1]
    assert low <= 0.01 <= high + 0.004  # what is left of the second order


@pytest.mark.slow
def test_the_margin_by_samples_is_that_by_derivatives():
    linear = required_overlap(strip(), NOISE, free=0.95)
    assert required_overlap(strip(), NOISE, free=0.95, key=KEY, flights=2048) == pytest.approx(linear, abs=0.015)


@pytest.mark.costly
@pytest.mark.parametrize("size, correlation", [(1, 0.0), (3, 0.5), (6, 0.9), (10, -0.05)])
def test_the_orthant_is_that_of_scipy(size, correlation):
    rng = np.random.default_rng(size)
    scale = rng.uniform(0.5, 2.0, size)
    cov = (correlation + (1.0 - correlation) * np.eye(size)) * np.outer(scale, scale)
    mean = rng.uniform(0.2, 2.0, size)
    exact = stats.multivariate_normal(np.zeros(size), cov, seed=0).cdf(mean)
    assert float(orthant(jnp.asarray(mean), jnp.asarray(cov))) == pytest.approx(exact, abs=2e-4)


def test_margins_that_go_in_lockstep_are_one():
    cov = 0.04 * np.ones((4, 4))
    chance = float(orthant(jnp.full(4, 0.1), jnp.asarray(cov)))
    assert chance == pytest.approx(stats.norm.cdf(0.5), abs=1e-4)


@pytest.mark.costly
def test_each_number_has_its_spec():
    assert len(specs_of(strip())) == normals_of(strip())
    assert np.bincount(specs_of(strip())).tolist() == [6, 6, 6, 6, 6, 6, 12, 6]


MISTAKES = {
    "one image": (lambda: Strip.planned(SENSOR, SHOT, ConstantHeight(300.0), **(PLAN | {"images": 1})), "at least two"),
    "overlap of one": (
        lambda: Strip.planned(SENSOR, SHOT, ConstantHeight(300.0), **(PLAN | {"overlap": 1.0})),
        r"overlap must lie in \[0, 1\)",
    ),
    "standing still": (
        lambda: Strip.planned(SENSOR, SHOT, ConstantHeight(300.0), **(PLAN | {"speed": 0.0})),
        "speed must be above 0 m/s",
    ),
    "looking up": (
        lambda: Strip.planned(SENSOR, Shot(SHOT.pose, jnp.array([1.8, 0.0])), ConstantHeight(300.0), **PLAN),
        "near end of the first image sees no ground",
    ),
    "negative noise": (lambda: FlightNoise.from_degrees(heading=-0.1), r"heading must lie in \[0"),
    "no lasting": (lambda: FlightNoise.from_degrees(lasting=0.0), "lasting must be above 0 s"),
    "a sure thing": (lambda: required_overlap(strip(), NOISE, free=1.0), r"free must lie in \(0, 1\)"),
}


@pytest.mark.costly
@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_told_in_words(name):
    mistake, words = MISTAKES[name]
    with pytest.raises(ValueError, match=words):
        mistake()


@pytest.mark.slow
def test_images_that_miss_each_other_sideways_are_gaps_to_both_ways():
    """Roll that changes from image to image by as much as the field of view is wide."""
    noise = FlightNoise.from_degrees(roll=0.3, lasting=1e-3)
    sampled = fly(strip(), noise, key=KEY, flights=2048)
    assert np.any(np.asarray(sampled.status) == Status.images_apart)
    chance, (low, high) = sampled.gap_probability(0.999)
    linear = linear_gaps(strip(), noise).gap_probability
    assert chance > 0.05
    assert low - 0.04 <= linear <= high + 0.04  # a frame farther out is a larger one: the second order


@pytest.mark.costly
def test_a_quantile_needs_flights_to_rest_on():
    with pytest.raises(ValueError, match="512 flights say too little"):
        required_overlap(strip(), NOISE, free=0.9999, key=KEY, flights=512)
