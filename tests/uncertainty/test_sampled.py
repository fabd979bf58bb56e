"""Monte Carlo: the same samples however they are computed, failures that count, and intervals that stop it."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import jax
import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, FirstHit, Pose, Shot, Status
from jaxgeo.uncertainty import ErrorModel, Random, Sampling, Sobol, compare, propagate, sample, sources
from jaxgeo.uncertainty.chunks import BLOCK, LONG_RUN, Size, make_plan
from jaxgeo.uncertainty.model_inputs import ModelInputs
from tests.support import looks

KEY = jax.random.key(11)
CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=5000.0, width=801, height=601)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.forward())
GROUND = ConstantHeight(0.0)
MODEL = ErrorModel((sources.Attitude.from_degrees(heading=0.1, pitch=0.1, roll=0.1),))


def shot(elevation_deg: float, height: float = 3000.0) -> Shot:
    return Shot(Pose.from_degrees(lat=45.0, lon=7.0, height=height, heading=30.0, pitch=elevation_deg))


SIZE = Size.of(1000, BLOCK, tuple(jax.devices()[:1]))
SCENE = (SENSOR, shot(-30.0), (400.0, 300.0), GROUND, MODEL)


@pytest.fixture(scope="module")
def drawn():
    return sample(*SCENE, key=KEY, count=3000, chunk=1000, keep=True)


@pytest.mark.parametrize("chunk", [1000, pytest.param(1700, marks=pytest.mark.slow), 100_000])
def test_the_same_key_gives_the_same_samples_whatever_the_chunk(drawn, chunk: int) -> None:
    other = sample(*SCENE, key=KEY, count=3000, chunk=chunk, keep=True)
    np.testing.assert_array_equal(other.errors_enu, drawn.errors_enu)
    assert other.circular_error(0.9) == drawn.circular_error(0.9)


def test_a_plan_holds_the_terrain_itself_not_a_copy() -> None:
    look = ModelInputs.of(*SCENE[:4])
    plan, _ = make_plan(look, look.nominal_fix(FirstHit()), MODEL, Random(), FirstHit(), KEY, SIZE)
    assert plan.lines.inputs is look
    assert {id(x) for x in jax.tree.leaves(plan.fixes.common)} <= {id(x) for x in jax.tree.leaves(look)}


def test_another_key_gives_others(drawn) -> None:
    other = sample(*SCENE, key=jax.random.key(12), count=3000, chunk=1000, keep=True)
    assert not np.any(other.errors_enu == drawn.errors_enu)


def test_fewer_samples_are_the_first_of_more(drawn) -> None:
    fewer = sample(*SCENE, key=KEY, count=1500, chunk=1000, keep=True)
    np.testing.assert_array_equal(fewer.errors_enu, drawn.errors_enu[:1500])


def test_figures_are_those_of_the_samples(drawn) -> None:
    errors = drawn.errors_enu
    np.testing.assert_allclose(drawn.mean_enu, errors.mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(drawn.cov_enu, np.cov(errors.T), atol=1e-6)
    radii = np.sort(np.hypot(errors[:, 0], errors[:, 1]))
    quantile = drawn.circular_error(0.9)
    assert quantile.value == pytest.approx(radii[2699], abs=1e-9)
    assert quantile.low < quantile.value < quantile.high
    assert quantile.conditional == quantile.value
    assert quantile.share == 1.0
    assert drawn.linear_error(0.5).value == pytest.approx(np.sort(np.abs(errors[:, 2]))[1499], abs=1e-9)


@pytest.mark.slow
def test_errors_about_the_mean(drawn) -> None:
    about = sample(*SCENE, key=KEY, count=3000, chunk=1000, keep=True, about_mean=True)
    np.testing.assert_allclose(about.errors_enu.mean(axis=0), 0.0, atol=1e-8)
    np.testing.assert_allclose(about.mean_enu, drawn.mean_enu, atol=1e-8)
    np.testing.assert_allclose(about.cov_enu, drawn.cov_enu, atol=1e-6)


@pytest.mark.parametrize("share_lost, least, most", [(0.05, 0.02, 0.09), (0.3, 0.2, 0.4)])
def test_samples_without_a_fix_count_as_infinitely_far(share_lost: float, least: float, most: float) -> None:
    """A line of sight just below the horizon: some of those drawn pass above it."""
    horizon = -math.degrees(math.acos(6.37e6 / (6.37e6 + 3000.0)))
    sigmas = {0.05: 1.9, 0.3: 0.6}[share_lost]
    result = sample(
        SENSOR, shot(horizon - 0.1 * sigmas), (400.0, 300.0), GROUND, MODEL, key=KEY, count=3000, chunk=1000
    )
    lost = 1.0 - result.found / result.count
    assert least < lost < most
    assert result.statuses[Status.rises_away] == result.count - result.found
    high = result.circular_error(0.9)
    assert math.isinf(high.value) == (lost > 0.1)
    assert high.share == pytest.approx(1.0 - lost)
    assert math.isfinite(high.conditional)
    low = result.circular_error(0.5)
    assert math.isfinite(low.value)
    assert low.value > low.conditional


ROUGH = (looks.sensor(), looks.shot(), looks.UV, looks.dem())


@pytest.mark.costly
@pytest.mark.parametrize(
    "scene, moves_ground",
    [
        (SCENE[:4], False),
        pytest.param(ROUGH, False, marks=pytest.mark.slow),
        pytest.param(ROUGH, True, marks=pytest.mark.slow),
    ],
    ids=["level", "rough", "rough and moved"],
)
def test_a_sample_is_the_miss_of_its_error(scene: Any, moves_ground: bool) -> None:
    """Also on rough ground, where the search of the samples starts near it; each sample by itself."""
    pointing = sources.Attitude.from_degrees(heading=0.3, pitch=0.3, roll=0.3)
    ground = (sources.TerrainHeight.from_metres(4.0),) if moves_ground else ()
    model = ErrorModel((pointing, *ground))
    drawn = sample(*scene, model, key=KEY, count=96, keep=True, draws=Random())
    look = ModelInputs.of(*scene)
    aim = look.nominal_fix(FirstHit())

    @jax.jit
    def miss(look, aim, number):
        error = model.factor() @ Random().standard_normal(KEY, number, model.size)
        return model.fix_offset(look, aim, error, FirstHit())

    misses, statuses = (np.stack(x) for x in zip(*(miss(look, aim, number) for number in np.arange(96)), strict=True))
    np.testing.assert_array_equal(statuses, drawn.codes)
    found = np.asarray(statuses) == Status.hit
    assert np.mean(found) > 0.5
    np.testing.assert_allclose(drawn.errors_enu[found], np.asarray(misses)[found], atol=2e-8)


@pytest.mark.slow
@pytest.mark.parametrize("model", [MODEL, ErrorModel((sources.TerrainHeight.from_metres(4.0),))])
def test_crowds_are_told_where_to_begin_whatever_errs(model: ErrorModel) -> None:
    """Also if nothing moves the ground, or nothing but the ground moves."""
    look = ModelInputs.of(looks.sensor(), looks.shot(), looks.UV, looks.dem())
    plan, _ = make_plan(look, look.nominal_fix(FirstHit()), model, Random(), FirstHit(), KEY, SIZE)
    assert plan.fixes.search.beam.start > 0.0


@pytest.mark.slow
def test_every_sample_lost() -> None:
    """None comes down on the terrain: figures are infinite, moments unknown, and all of them are counted."""
    model = ErrorModel((sources.Position.from_ned(north=1e6, east=1e6, down=1.0),))
    scene = (looks.sensor(), looks.shot(), looks.UV, looks.dem(), model)
    result = sample(*scene, key=KEY, count=64, chunk=64)
    assert result.found == 0
    assert sum(result.statuses.values()) == 64
    assert Status.hit not in result.statuses
    quantile = result.circular_error(0.5)
    assert quantile.value == quantile.high == math.inf
    assert math.isnan(quantile.conditional)
    assert quantile.share == 0.0
    assert np.all(np.isnan(result.cov_enu))


def test_sampling_stops_when_it_is_sure_enough(drawn) -> None:
    sure = sample(*SCENE, key=KEY, count=200_000, chunk=1000, half_width=0.03)
    quantile = sure.circular_error(0.9)
    assert 1000 < sure.count < 60_000
    assert 0.5 * (quantile.high - quantile.low) <= 0.03 * quantile.value
    assert sum(sure.statuses.values()) == sure.count == len(sure.radii["CE"])


@pytest.mark.slow
def test_sobol_points_in_any_chunks() -> None:
    first, second = (
        sample(*SCENE, key=KEY, count=16 * 128, draws=Sobol(), chunk=chunk, keep=True) for chunk in (500, 100_000)
    )
    np.testing.assert_array_equal(first.errors_enu, second.errors_enu)
    assert first.circular_error(0.5).low < first.circular_error(0.5).value < first.circular_error(0.5).high


@pytest.mark.parametrize(
    "options, message",
    [
        ({"count": 0}, "count must be a whole number of samples"),
        ({"count": -5}, "count"),
        ({"chunk": 0}, "chunk"),
        ({"figures": ("CEP",)}, "figures are CE, LE, SE"),
        ({"confidence": 1.0}, "confidence"),
        ({"half_width": -0.1}, "half_width"),
        ({"half_width": 0.1, "figures": ()}, "half_width is that of the first"),
        ({"devices": []}, "devices must be some of"),
        ({"devices": "cpu"}, "devices must be some of"),
        ({"key": 3}, "key must be one of"),
    ],
)
def test_requests_that_make_no_sense(options: dict, message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        sample(*SCENE, **{"key": KEY, **options})


def test_no_fix_no_samples() -> None:
    with pytest.raises(ValueError, match="rises_away"):
        sample(SENSOR, shot(20.0), (400.0, 300.0), GROUND, MODEL, key=KEY)


@pytest.mark.slow
def test_many_samples_begin_with_the_few() -> None:
    """Up to rounding, as they have a program of their own; those of its parts are equal to the last digit."""
    scene = looks.sensor(), looks.shot(), looks.UV, looks.dem(), looks.few_sources()
    most = LONG_RUN * jax.local_device_count()
    few = sample(*scene, key=KEY, count=8000, keep=True)
    many = sample(*scene, key=KEY, count=most + 1, keep=True)
    np.testing.assert_allclose(many.errors_enu[:8000], few.errors_enu, rtol=0, atol=1e-8)  # m
    more = sample(*scene, key=KEY, first=2 * BLOCK + 5, count=most + 9, keep=True)
    np.testing.assert_array_equal(more.errors_enu[: -2 * BLOCK - 13], many.errors_enu[2 * BLOCK + 5 :])
    assert f"{LONG_RUN:,}".replace(",", " ") in sample.__doc__


@pytest.mark.slow
def test_the_same_samples_on_one_two_and_four_devices() -> None:
    """Up to rounding; each in a process of its own, since a process has its devices from the start."""
    program = (
        "import json, sys, jax\n"
        "jax.config.update('jax_enable_x64', True)\n"
        "from tests.uncertainty.test_sampled import KEY, SCENE\n"
        "from jaxgeo.uncertainty import sample\n"
        "from tests.support import looks\n"
        "terrain = looks.sensor(), looks.shot(), looks.UV, looks.dem(), looks.few_sources()\n"
        "for scene in (SCENE, terrain):\n"
        "    first = sample(*scene, key=KEY, count=8000, chunk=800, keep=True)\n"
        "    second = sample(*scene, key=KEY, first=8000, count=8000, keep=True)\n"
        "    print(json.dumps([jax.device_count(), second.merge(first).errors_enu.tolist()]))\n"
    )
    results = {}
    for devices in (1, 2, 4):
        flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count={devices}"
        done = subprocess.run(
            [sys.executable, "-c", program],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "XLA_FLAGS": flags},
        )
        level, terrain = (json.loads(line) for line in done.stdout.splitlines()[-2:])
        assert level[0] == terrain[0] == devices
        results[devices] = np.array(level[1]), np.array(terrain[1])
    for devices in (2, 4):
        for found, expected in zip(results[devices], results[1], strict=True):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)  # m


@pytest.mark.slow
def test_another_search_gives_the_same_where_the_crossing_is_one() -> None:
    """Bisection in a `lax.while_loop`, under `vmap` and derivatives, against the first hit, where nothing can hide."""
    scene = (looks.sensor(), looks.shot(), looks.UV, looks.dem(), looks.few_sources())
    first, other = (
        (propagate(*scene, search=search), sample(*scene, key=KEY, count=4000, chunk=4000, search=search, keep=True))
        for search in (jaxgeo.FirstHit(), jaxgeo.Bisection())
    )
    np.testing.assert_allclose(other[0].cov_enu, first[0].cov_enu, atol=1e-9 * np.abs(first[0].cov_enu).max())
    assert other[1].statuses == first[1].statuses
    np.testing.assert_allclose(other[1].errors_enu, first[1].errors_enu, atol=2e-8)  # m: what ECEF can tell, oblique
    assert other[1].circular_error(0.9).value == pytest.approx(first[1].circular_error(0.9).value, rel=1e-9)


@pytest.mark.slow
def test_a_comparison_with_another_search_says_the_same_where_the_crossing_is_one() -> None:
    scene = (looks.sensor(), looks.shot(), looks.UV, looks.dem(), looks.few_sources())
    first, other = (
        compare(*scene, sampling=Sampling(count=2000, key=KEY, chunk=2000), search=search)
        for search in (jaxgeo.FirstHit(), jaxgeo.Bisection())
    )
    for name, linear in first.propagations.items():
        cov = other.propagations[name].cov_enu
        np.testing.assert_allclose(cov, linear.cov_enu, atol=1e-9 * np.abs(linear.cov_enu).max(), err_msg=name)
    for row, another in zip(first.rows, other.rows, strict=True):
        assert another.values == pytest.approx(row.values, rel=1e-7), row.method  # samples and sigma points round
    for row, another in zip(first.rows[:3], other.rows[:3], strict=True):
        assert another.values == pytest.approx(row.values, rel=1e-9), row.method
    assert [q.value for q in other.quantiles] == pytest.approx([q.value for q in first.quantiles], rel=1e-9)


def compiled(caplog: pytest.LogCaptureFixture, call: Callable[[], object]) -> set[str]:
    """Names of the programs that a call compiles or reads back."""
    caplog.clear()
    with jax.log_compiles():
        call()
    found = [re.search(r"Compiling jit\((\w+)\)", record.getMessage()) for record in caplog.records]
    return {match[1] for match in found if match}


@pytest.mark.costly
def test_another_count_or_kept_samples_compile_nothing_and_another_error_only_the_lines_of_sight(
    caplog: pytest.LogCaptureFixture,
) -> None:
    draw = lambda model, count, **more: sample(*SCENE[:4], model, key=KEY, count=count, draws=Random(), **more)  # noqa: E731
    draw(MODEL, 3001)
    assert compiled(caplog, lambda: draw(MODEL, 12_004)) == set()
    assert compiled(caplog, lambda: draw(MODEL, 3001, keep=True)) == set()
    other = ErrorModel((*MODEL.sources, sources.Boresight.from_degrees(heading=0.01, pitch=0.01, roll=0.01)))
    more = compiled(caplog, lambda: draw(other, 3001))
    assert "_draw_lines" in more
    assert "_draw_chunk" not in more
