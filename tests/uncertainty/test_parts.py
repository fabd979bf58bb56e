"""Samples drawn in parts, merged, and kept as counts in bins: the same as those drawn at once."""

from __future__ import annotations

import dataclasses
import itertools
import math
import pickle
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxgeo
from jaxgeo import ConstantHeight, Status, _accelerator
from jaxgeo.uncertainty import (
    ErrorModel,
    Random,
    Sampled,
    Sampling,
    Sobol,
    batched_rays,
    histogram,
    sample,
    sources,
)
from jaxgeo.uncertainty.chunks import BLOCK
from jaxgeo.uncertainty.histogram import BINS, Counter, RadiusHistogram, bins_of, lower_bound
from jaxgeo.uncertainty.intervals import interval_of_scrambles, quantile_interval
from jaxgeo.uncertainty.origin import Origin, digest_of
from jaxgeo.uncertainty.processes import check_timeout
from jaxgeo.uncertainty.sampled_record import merged
from jaxgeo.uncertainty.sampling import check_numbers
from tests.support import looks
from tests.uncertainty.test_sampled import CAMERA, GROUND, KEY, MODEL, SCENE, SENSOR, shot

PROBABILITIES = (0.01, 0.5, 0.9, 0.997)
COUNT = 6 * BLOCK  # more than one call draws


@pytest.fixture(scope="module")
def whole() -> Sampled:
    return sample(*SCENE, key=KEY, count=COUNT, keep=True)


def part(first: int, end: int, *scene, **options) -> Sampled:
    return sample(*(scene or SCENE), **{"key": KEY, "keep": True, **options}, first=first, count=end - first)


def assert_same_samples(found: Sampled, expected: Sampled) -> None:
    """Counts, statuses, samples, radii and quantiles to the bit; moments up to rounding of sums."""
    assert (found.count, found.found, found.statuses) == (expected.count, expected.found, expected.statuses)
    np.testing.assert_array_equal(found.errors_enu, expected.errors_enu)
    np.testing.assert_array_equal(found.codes, expected.codes)
    assert found.figures == expected.figures
    for figure in expected.figures:
        np.testing.assert_array_equal(found.radii[figure], expected.radii[figure])
        for probability in PROBABILITIES:
            assert found.quantile(figure, probability) == expected.quantile(figure, probability)
    np.testing.assert_allclose(found.mean_enu, expected.mean_enu, rtol=0, atol=1e-11)
    scale = np.abs(expected.cov_enu).max()
    np.testing.assert_allclose(found.cov_enu, expected.cov_enu, rtol=0, atol=1e-12 * scale)


@pytest.mark.slow
def test_samples_of_an_accelerator_are_those_of_a_cpu(whole, monkeypatch) -> None:
    """Compiled for a CPU: blocks of another size, and radii counted without going to the host."""
    monkeypatch.setattr(_accelerator, "on_accelerator", lambda *_: True)
    monkeypatch.setattr(batched_rays, "BLOCK_ACCELERATOR", 2048)
    found = part(0, COUNT)
    np.testing.assert_array_equal(found.codes, whole.codes)
    np.testing.assert_allclose(found.errors_enu, whole.errors_enu, rtol=0, atol=1e-6)  # m
    counted = [part(first, end, keep=False, summary=True) for first, end in ((0, 5000), (5000, COUNT))]
    summary = counted[0].merge(counted[1])
    assert (summary.count, summary.statuses) == (found.count, found.statuses)
    for figure in found.figures:
        expected = RadiusHistogram.of(found.radii[figure])
        np.testing.assert_array_equal(summary.histograms[figure].bins, expected.bins)
        np.testing.assert_array_equal(summary.histograms[figure].counts, expected.counts)


@pytest.mark.costly
@pytest.mark.parametrize("cuts", [(1,), (BLOCK, 2 * BLOCK), (7, 3391, 3393, 17_001, COUNT - 1)])
def test_parts_are_the_whole_to_the_bit(whole, cuts: tuple[int, ...]) -> None:
    parts = [part(first, end) for first, end in itertools.pairwise((0, *cuts, COUNT))]
    assert_same_samples(parts[0].merge(*parts[1:]), whole)


@pytest.mark.costly
@pytest.mark.parametrize("chunk", [1, pytest.param(9000, marks=pytest.mark.slow)])
def test_parts_are_the_whole_to_the_bit_whatever_the_chunk(whole, chunk: int) -> None:
    assert_same_samples(part(0, 5000, chunk=chunk).merge(part(5000, COUNT, chunk=chunk)), whole)


@pytest.mark.slow
@pytest.mark.parametrize("draws", [Random(), Sobol(), Sobol(scrambles=17)])
@pytest.mark.parametrize("over_terrain", [False, True])
def test_parts_are_the_whole_for_every_kind_of_draws(draws, over_terrain: bool) -> None:
    """Also where some samples have no fix, and every line of sight its own ground."""
    model = ErrorModel((*looks.few_sources().sources, sources.Position.from_ned(north=60.0, east=60.0, down=9.0)))
    scene = (looks.sensor(), looks.shot(), looks.UV, looks.dem(), model) if over_terrain else SCENE
    cut, end = 201, 7997
    expected = part(0, end, *scene, draws=draws)
    assert_same_samples(part(0, cut, *scene, draws=draws).merge(part(cut, end, *scene, draws=draws)), expected)
    assert_same_samples(part(0, cut, *scene, draws=draws).merge(part(cut, end, *scene, draws=draws, chunk=1)), expected)
    if over_terrain:
        assert 0 < expected.found < expected.count


@pytest.mark.slow
def test_many_samples_are_those_of_few() -> None:
    """Those beyond a count that selects other programs, which are compiled by another emitter."""
    terrain = (looks.sensor(), looks.shot(), looks.UV, looks.dem(), looks.few_sources())
    for scene in (SCENE, terrain):
        many = part(0, 70_000, *scene)
        few = [part(first, end, *scene) for first, end in itertools.pairwise((0, 20_000, 50_000, 70_000))]
        assert_same_samples(few[0].merge(*few[1:]), many)


@pytest.mark.costly
def test_the_order_and_grouping_of_merges_change_nothing(whole) -> None:
    a, b, c = (part(first, end) for first, end in itertools.pairwise((0, 400, 9000, COUNT)))
    every = [a.merge(b, c), c.merge(a, b), a.merge(b).merge(c), a.merge(b.merge(c)), c.merge(a).merge(b)]
    for one in every:
        assert_same_samples(one, whole)
        assert one.ranges == ((0, COUNT),)
        np.testing.assert_array_equal(one.mean_enu, every[0].mean_enu)
        np.testing.assert_array_equal(one.cov_enu, every[0].cov_enu)
    assert a.merge() is a


@pytest.mark.costly
def test_parts_may_leave_gaps_and_come_from_other_processes(whole) -> None:
    first, last = (pickle.loads(pickle.dumps(part(*ends))) for ends in ((100, 300), (1000, 1200)))
    both = last.merge(first)
    assert both.ranges == ((100, 300), (1000, 1200))
    numbers = np.r_[100:300, 1000:1200]
    np.testing.assert_array_equal(both.numbers, numbers)
    np.testing.assert_array_equal(both.errors_enu, whole.errors_enu[numbers])
    np.testing.assert_array_equal(jaxgeo.io.samples_dataset(both)["sample"], numbers)


@pytest.mark.costly
def test_samples_that_fail_are_counted_in_every_part() -> None:
    """Parts whose statuses differ: one has none that fails."""
    horizon = -math.degrees(math.acos(6.37e6 / (6.37e6 + 3000.0)))
    scene = (SENSOR, shot(horizon - 0.19), *SCENE[2:])
    expected = part(0, 3000, *scene)
    lost = int(np.flatnonzero(expected.codes)[0])
    before, after = part(0, lost, *scene), part(lost, 3000, *scene)
    assert set(before.statuses) == {Status.hit}
    assert Status.rises_away in after.statuses
    assert_same_samples(after.merge(before), expected)
    summarised = before.summarised().merge(after)
    assert summarised.circular_error(0.9999).value == math.inf
    assert summarised.circular_error(0.9).conditional == pytest.approx(expected.circular_error(0.9).conditional, 1e-4)


OTHER_MODEL = ErrorModel((sources.Attitude.from_degrees(heading=0.1, pitch=0.1, roll=0.1001),))
CROPPED = dataclasses.replace(CAMERA, height=600)


@pytest.mark.costly
@pytest.mark.parametrize(
    "scene, options, message",
    [
        (SCENE, {"key": jax.random.key(12)}, "part 1 is no part of the same sampling as part 0: key differ"),
        ((*SCENE[:4], OTHER_MODEL), {}, "errors differ"),
        ((SENSOR, shot(-31.0), *SCENE[2:]), {}, "shot differ"),
        ((*SCENE[:2], (400.0, 301.0), GROUND, MODEL), {}, "uv differ"),
        ((*SCENE[:3], ConstantHeight(1.0), MODEL), {}, "terrain differ"),
        (SCENE, {"about_mean": True}, "centre_enu differ"),
        (SCENE, {"figures": ("CE", "SE")}, "part 1 has other figures"),
        (SCENE, {"confidence": 0.9}, "part 1 has other confidence"),
        (SCENE, {"first": 99}, "sample 99 is in two parts"),
        (SCENE, {"first": 50}, "samples 50 to 99 are in two parts"),
        (SCENE, {"first": 0}, "samples 0 to 99 are in two parts"),
    ],
)
def test_parts_that_do_not_belong_together(scene, options: dict, message: str) -> None:
    ours = sample(*SCENE, key=KEY, count=100)
    theirs = sample(*scene, **{"key": KEY, "first": 100, "count": 100, **options})
    with pytest.raises(ValueError, match=message):
        ours.merge(theirs)


def test_a_camera_of_another_size_is_another_sensor() -> None:
    ours, theirs = (
        Origin(sensor=jaxgeo.Sensor(camera, SENSOR.gimbal, SENSOR.mount), key=KEY) for camera in (CAMERA, CROPPED)
    )
    assert ours.differences(theirs) == ["sensor"]


@pytest.mark.costly
@pytest.mark.parametrize("other", [None, 3, []])
def test_merging_anything_else(whole, other) -> None:
    with pytest.raises(TypeError, match=r"merge takes Sampled parts, as merge\(second, third\); got"):
        merged(whole, [other])


def test_samples_made_by_hand_are_not_merged(whole) -> None:
    with pytest.raises(ValueError, match="part 1 cannot be merged: it does not come from sample"):
        whole.merge(dataclasses.replace(whole, origin=None))


@pytest.mark.parametrize(
    "options, message",
    [
        ({"first": -1}, "first must be the number of a sample, a whole number from 0 on; got -1"),
        (
            {"first": 2**32 - 10, "count": 11, "draws": Random()},
            "a key has 4294967296 samples; got first 4294967286 and count 11",
        ),
        ({"count": 0, "first": 100}, "count must be a whole number of samples"),
        ({"keep": True, "summary": True}, "keep returns every sample, and summary none"),
        ({"timeout": 0.0}, "timeout must be a positive number of seconds"),
        ({"timeout": math.inf}, "timeout must be a positive number of seconds"),
    ],
)
def test_parts_that_make_no_sense(options: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sample(*SCENE, **{"key": KEY, **options})


@pytest.mark.parametrize("first", [1.0, "1", None, math.nan])
def test_a_first_that_is_no_whole_number(first) -> None:
    with pytest.raises(ValueError, match="first must be the number of a sample, a whole number from 0 on; got"):
        check_numbers(first, Sampling(count=10, draws=Random()))


def test_a_timeout_that_is_no_number() -> None:
    with pytest.raises(ValueError, match="timeout must be a positive number of seconds, such as 300; got '5'"):
        check_timeout("5")


@pytest.mark.costly
def test_the_last_samples_of_a_key() -> None:
    last = part(2**32 - 10, 2**32)
    np.testing.assert_array_equal(last.merge(part(2**32 - 30, 2**32 - 10)).errors_enu[-10:], last.errors_enu)
    assert len(np.unique(last.errors_enu[:, 0])) == 10


@pytest.mark.costly
def test_about_the_mean_of_a_part(whole) -> None:
    about = part(500, 900, about_mean=True)
    np.testing.assert_allclose(about.mean_enu, whole.errors_enu[500:900].mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(about.errors_enu.mean(axis=0), 0.0, atol=1e-9)


@pytest.mark.costly
def test_a_part_that_stops_when_it_is_sure_enough(whole) -> None:
    sure = part(1000, 200_000, half_width=0.03, chunk=1)
    assert sure.ranges[0][0] == 1000
    assert BLOCK - 1000 <= sure.count < 60_000
    np.testing.assert_array_equal(sure.errors_enu[:2000], whole.errors_enu[1000:3000])
    assert sure.merge(part(0, 1000)).count == sure.count + 1000


# ---- summaries


@pytest.mark.parametrize("figure", ["CE", "LE", "SE"])
def test_a_summary_is_off_by_less_than_its_bound(figure: str) -> None:
    whole = part(0, COUNT, keep=False, draws=Random())
    summary = part(0, COUNT, keep=False, draws=Random(), summary=True)
    assert summary.radii == {}
    assert (summary.count, summary.found, summary.statuses) == (whole.count, whole.found, whole.statuses)
    np.testing.assert_array_equal(summary.cov_enu, whole.cov_enu)
    for probability in PROBABILITIES:
        ours, exact = (one.quantile(figure, probability) for one in (summary, whole))
        assert abs(ours.value - exact.value) < 2.0**-14 * max(exact.value, 1.0)
        assert ours.low <= exact.low < ours.low + 2.0**-14 * max(exact.low, 1.0)
        assert ours.high - 2.0**-14 * max(exact.high, 1.0) < exact.high <= ours.high
        assert ours.conditional == ours.value


def test_merged_summaries_are_the_summary_of_all_to_the_bit(whole) -> None:
    parts = [part(first, end, keep=False, summary=True) for first, end in itertools.pairwise((0, 999, 9000, COUNT))]
    together, direct = parts[2].merge(parts[0], parts[1]), whole.summarised()
    for figure in ("CE", "LE", "SE"):
        for probability in PROBABILITIES:
            assert together.quantile(figure, probability) == direct.quantile(figure, probability)
    mixed = parts[0].merge(part(999, COUNT))
    assert mixed.radii == {}
    assert mixed.errors_enu is None
    assert mixed.circular_error(0.9) == direct.circular_error(0.9)
    assert pickle.loads(pickle.dumps(together)).circular_error(0.9) == direct.circular_error(0.9)
    assert len(pickle.dumps(together)) < 40 * COUNT


@pytest.mark.costly
def test_a_summary_stops_when_it_is_sure_enough() -> None:
    sure = part(0, 200_000, half_width=0.03, keep=False, summary=True, chunk=1)
    quantile = sure.circular_error(0.9)
    assert sure.count < 60_000
    assert 0.5 * (quantile.high - quantile.low) <= 0.03 * quantile.value


@pytest.mark.slow
@pytest.mark.parametrize("groups", [1, 16])
def test_radii_are_counted_alike_whether_they_wait_or_not(monkeypatch: pytest.MonkeyPatch, groups: int) -> None:
    radii = np.random.default_rng(groups).rayleigh(10.0, 1000)
    expected = np.bincount(bins_of(radii) + np.arange(1000) % groups * BINS, minlength=groups * BINS)
    for few in (0, 300, 10_000):  # each part is counted at once, after some, at the end
        monkeypatch.setattr(histogram, "FEW", few)
        counter = Counter(groups)
        for first in range(0, 1000, 125):
            counter.add(radii[first : first + 125], first)
            found = counter.histogram()
            assert found.counts.sum() == first + 125
        np.testing.assert_array_equal(found.bins, np.flatnonzero(expected))
        np.testing.assert_array_equal(found.counts, expected[found.bins])


def test_a_summary_of_sobol_points() -> None:
    exact, summary = (part(0, 16 * 256, draws=Sobol(), keep=False, summary=summary) for summary in (False, True))
    for probability in (0.5, 0.9):
        ours, true = summary.circular_error(probability), exact.circular_error(probability)
        np.testing.assert_allclose(ours[:3], true[:3], rtol=2.0**-14)


def test_bins_are_as_wide_as_said_and_cover_all_radii() -> None:
    rng = np.random.default_rng(1)
    radii = np.r_[10.0 ** rng.uniform(-9, 8.4, 10_000), 0.0, np.inf, 2.0**-14, np.nextafter(2.0**-14, 0)]
    bins = bins_of(radii)
    low, high = (np.array([lower_bound(int(one)) for one in numbers]) for numbers in (bins, bins + 1))
    assert np.all((low <= radii) & ((radii < high) | np.isinf(radii)))
    wide = np.isfinite(radii) & (radii >= 2.0**-14)
    assert np.all(high[wide] - low[wide] <= 2.0**-14 * radii[wide])
    assert np.all((low[radii < 2.0**-14] == 0.0) & (high[radii < 2.0**-14] == 2.0**-14))
    assert bins[10_001] == BINS - 1
    assert np.all(np.diff(bins_of(np.sort(radii))) >= 0)


@pytest.mark.costly
@pytest.mark.parametrize("groups", [1, 16])
@pytest.mark.parametrize("lost", [0, 7, 300])
def test_quantiles_of_a_histogram(groups: int, lost: int) -> None:
    """Against the radii themselves: of few and of many orders of magnitude, with ties, and with failures."""
    rng = np.random.default_rng(groups + lost)
    for radii in (rng.rayleigh(30.0, 1600), 10.0 ** rng.uniform(-3, 6, 1600), np.repeat(rng.rayleigh(2.0, 16), 100)):
        radii[rng.permutation(1600)[:lost]] = np.inf
        counter = Counter(groups)
        for start in range(0, 1600, 400):
            counter.add(radii[start : start + 400], start)
        histogram = counter.histogram()
        again = RadiusHistogram.of(radii[:800], groups).merge([RadiusHistogram.of(radii[800:], groups)])
        np.testing.assert_array_equal(again.bins, histogram.bins)
        np.testing.assert_array_equal(again.counts, histogram.counts)
        for probability in (0.1, 0.5, 0.9):
            found = histogram.interval(probability, 0.95)
            if groups == 1:
                exact = quantile_interval(radii, probability)
            else:
                exact = interval_of_scrambles(radii, probability, scrambles=groups)
            np.testing.assert_allclose(found.estimate, exact.estimate, rtol=2.0**-14, atol=2.0**-14)
            known = radii[np.isfinite(radii)]
            np.testing.assert_allclose(
                histogram.quantile_of_found(probability), quantile_interval(known, probability).estimate, rtol=2.0**-14
            )
    assert math.isnan(RadiusHistogram.of(np.full(32, np.inf), groups).quantile_of_found(0.5))


# ---- identity


def hills(position):
    return 600.0 + 40.0 * jnp.sin(2e4 * position.lat)


def other_hills(position):
    return 600.0 + 41.0 * jnp.sin(2e4 * position.lat)


def test_identity_tells_values_types_and_structure_apart() -> None:
    dem = looks.dem()
    posts = np.array(dem.posts)
    posts[3, 4] = np.nextafter(posts[3, 4], np.inf)
    raised = 1.0
    different = [
        dem,
        dataclasses.replace(dem, posts=jnp.asarray(posts)),
        dataclasses.replace(dem, posts=dem.posts.astype(jnp.float32)),
        hills,
        other_hills,
        lambda position: hills(position) + raised,
        jnp.zeros((2, 3)),
        jnp.zeros((3, 2)),
        np.zeros((2, 3), np.int64),
        jax.random.key(0),
        jax.random.key(1),
        (1, 2.0),
        (1, (2.0,)),
        [1, 2.0],
        1,
        1.0,
        True,
        "1",
        None,
        Status.hit,
        Sobol(),
        Sobol(scrambles=8),
        {"a": 1},
        {"b": 1},
        FrozenError,
    ]
    digests = [digest_of(value) for value in different]
    assert len(set(digests)) == len(digests)
    assert digests == [digest_of(value) for value in different]
    assert digest_of(np.zeros((2, 3))) == digest_of(jnp.zeros((2, 3)))


FrozenError = dataclasses.FrozenInstanceError


def test_what_cannot_be_compared_is_refused() -> None:
    with pytest.raises(TypeError, match=r"a builtins\.generator cannot be compared with that of another run"):
        digest_of({"lock": (value for value in ())})


@pytest.mark.slow
def test_identity_is_the_same_in_every_process() -> None:
    program = (
        "import jax; jax.config.update('jax_enable_x64', True)\n"
        "from jaxgeo._digest import digest_of\n"
        "from tests.support import looks\n"
        "from tests.uncertainty.test_sampled import KEY\n"
        "print(digest_of((looks.sensor(), looks.shot(), looks.dem(), looks.all_sources(), looks.steps, KEY)))\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    ours = digest_of((looks.sensor(), looks.shot(), looks.dem(), looks.all_sources(), looks.steps, KEY))
    assert done.stdout.split()[-1] == ours
