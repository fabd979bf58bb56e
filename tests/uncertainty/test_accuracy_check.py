"""One answer for one fix: the share of samples within it, its budget, and the same number wherever it is printed."""

from __future__ import annotations

import dataclasses
import json
import pathlib
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats

import jaxgeo
from jaxgeo import Sampling, demo
from jaxgeo.io.dem import DATA
from jaxgeo.io.scene import read_scene
from jaxgeo.uncertainty import AccuracyCheck, Method, budget, check_accuracy, compare, propagate, sample
from jaxgeo.uncertainty._figures import figure as shown
from jaxgeo.uncertainty.intervals import share_of
from jaxgeo.uncertainty.method_selection import Diagnostics, explain_method
from tests.support import looks
from tests.support.clouds import cloud

LOOK = (looks.level_sensor(), looks.level_shot(), looks.LEVEL_UV, looks.LEVEL, looks.level_errors())
COUNT = 4096


@pytest.fixture(scope="module")
def checked() -> AccuracyCheck:
    return check_accuracy(*LOOK, sampling=Sampling(count=COUNT))


@pytest.mark.parametrize("inside", [0, 1, 37, 90, 100])
@pytest.mark.parametrize("confidence", [0.5, 0.95])
def test_a_share_has_the_interval_of_clopper_and_pearson(inside: int, confidence: float) -> None:
    expected = scipy.stats.binomtest(inside, 100).proportion_ci(confidence, method="exact")
    found = share_of(np.arange(inside), 100, confidence)
    np.testing.assert_allclose(found, (inside / 100.0, *expected), rtol=1e-9, atol=1e-12)  # it solves, to 1e-12


@pytest.mark.costly
def test_the_share_within_a_quantile_is_its_probability(checked: AccuracyCheck) -> None:
    for figure in ("CE", "LE", "SE"):
        for probability in (0.1, 0.5, 0.9):
            radius = checked.sampled.quantile(figure, probability).value
            share = checked.sampled.share_within(figure, radius)
            assert abs(share.value - probability) <= 1.0 / COUNT
            assert share.low < probability < share.high


@pytest.mark.costly
def test_samples_hold_what_the_accuracy_says(checked: AccuracyCheck) -> None:
    """Over level ground the error is nearly normal: the share is binomial."""
    within = checked.within
    inside = round(within.value * COUNT)
    assert scipy.stats.binomtest(inside, COUNT, 0.9).pvalue > 1e-4
    assert f"{100.0 * within.value:.1f} % of 4 096 samples lie within this CE90" in str(checked)
    assert (checked.jumped, checked.sampled.failed) == (0.0, 0.0)
    assert str(checked).startswith(str(checked.accuracy))


@pytest.mark.costly
def test_a_share_of_sobol_points_is_the_mean_over_their_scrambles(checked: AccuracyCheck) -> None:
    radius = float(checked.accuracy.circular)
    drawn = dataclasses.replace(checked.sampled, scrambles=16)
    share = drawn.share_within("CE", radius)
    each = np.mean((drawn.radii["CE"] <= radius).reshape(-1, 16), axis=0)
    interval = scipy.stats.t.interval(0.95, 15, loc=each.mean(), scale=scipy.stats.sem(each))
    np.testing.assert_allclose(share, (each.mean(), *interval), rtol=1e-12)


def test_samples_without_a_fix_are_within_no_radius() -> None:
    drawn = cloud(np.ones((60, 2)), lost=40)
    assert drawn.share_within("CE", np.inf).value == 0.6


def test_large_figures_and_whole_shares_are_in_full() -> None:
    assert [shown(x, 2) for x in (100.0, 99.7, 12345.0, 0.00123, -3.0)] == ["100", "100", "12000", "0.0012", "-3"]
    assert [shown(x, 3, "+") for x in (1000.4, 0.0, np.nan, np.inf)] == ["+1000", "+0", "+nan", "+inf"]
    nowhere = Diagnostics._make([1.0] * 6 + [0.0, 1.0, 0.0, 1.0, 1.0, 0.0])
    assert explain_method(nowhere, Method.samples).startswith("100 % of the perturbed lines of sight meet no known")


@pytest.mark.costly
def test_samples_that_the_accuracy_is_of_are_said_to_be_those(checked: AccuracyCheck) -> None:
    assert "these samples" not in checked.words
    own = AccuracyCheck(dataclasses.replace(checked.accuracy, sampled=checked.sampled), checked.sampled)
    assert own.words.endswith("%), which is of these samples.")


def test_digits_that_are_no_whole_number_are_refused() -> None:
    for digits in (0, 7, True):
        with pytest.raises(ValueError, match="whole number from 1 to 6"):
            compare(*LOOK, digits=digits)


@pytest.mark.costly
def test_a_share_that_cannot_be_told_is_refused(checked: AccuracyCheck) -> None:
    with pytest.raises(ValueError, match="CX was not asked for"):
        checked.sampled.share_within("CX", 1.0)
    for radius in (-1.0, float("nan")):
        with pytest.raises(ValueError, match="radius must be a length in m, 0 or more"):
            checked.sampled.share_within("CE", radius)
    with pytest.raises(ValueError, match="without summary"):
        checked.sampled.summarised().share_within("CE", 1.0)
    with pytest.raises(ValueError, match="keep=True"):
        AccuracyCheck(checked.accuracy, checked.sampled.summarised())
    with pytest.raises(ValueError, match="one fix"):
        AccuracyCheck(dataclasses.replace(checked.accuracy, profile=None), checked.sampled)
    with pytest.raises(TypeError):
        AccuracyCheck(checked.sampled, checked.sampled)  # pyright: ignore


@pytest.mark.costly
def test_the_budget_of_an_accuracy_ends_at_its_number(checked: AccuracyCheck) -> None:
    """Every circular error is scaled like the whole; shares of the variance stay."""
    accuracy = checked.accuracy
    stated = dataclasses.replace(accuracy, circular=1.1 * accuracy.circular)
    plain, scaled = budget(propagate(*LOOK)), budget(stated)
    assert scaled.circular_error == float(stated.circular)
    times = scaled.circular_error / plain.circular_error
    assert times == pytest.approx(1.1, rel=1e-6)
    for one, other in zip(plain.sources, scaled.sources, strict=True):
        np.testing.assert_allclose(other.variance, one.variance, rtol=1e-9)
        assert other.without == pytest.approx(times * one.without, rel=1e-9)
        for a, b in zip(one.sigmas, other.sigmas, strict=True):
            np.testing.assert_allclose((b.without, b.slope), (times * a.without, times * a.slope), rtol=1e-9)
    assert f"CE90 {float(stated.circular):.3f} m" in str(scaled)


@pytest.mark.costly
def test_a_budget_where_linear_propagation_is_not_valid_gives_shares_only(checked: AccuracyCheck) -> None:
    sampled = dataclasses.replace(checked.accuracy, method=jnp.asarray(Method.samples.value))
    found = budget(sampled)
    assert found.circular_error == float(sampled.circular)
    assert found.note is not None
    assert "not valid at this fix" in found.note
    assert found.note in str(found)
    assert "nan" not in str(found)
    for source in found.sources:
        assert np.isnan([source.without, *(line.slope for line in source.sigmas)]).all()
    whole = np.sum(list(found.shares().values()), axis=0)
    np.testing.assert_allclose(whole, found.total, rtol=1e-12)


@pytest.mark.costly
def test_a_budget_of_another_probability_or_of_many_fixes_is_refused(checked: AccuracyCheck) -> None:
    assert budget(checked.accuracy, 0.9) == budget(checked.accuracy)
    with pytest.raises(ValueError, match=r"of probability 0.9; for 0.5, pass it to jaxgeo\.accuracy"):
        budget(checked.accuracy, 0.5)
    with pytest.raises(ValueError, match="of one pixel"):
        budget(dataclasses.replace(checked.accuracy, propagation=None))


@pytest.mark.slow
def test_samples_on_other_ground_are_those_of_the_comparison() -> None:
    scene = read_scene(demo.scene_file())
    look = (scene.sensor, scene.shot, (2256.0, 1343.0), jaxgeo.io.example_dem(), scene.errors)
    one = AccuracyCheck(jaxgeo.accuracy(*look, sampling=Sampling(count=COUNT)), sample(*look, count=COUNT, keep=True))
    other = compare(*look, sampling=Sampling(count=COUNT))
    np.testing.assert_array_equal(one.beyond_gap, other.beyond_gap)
    assert one.jumped == other.jumped
    # Samples that the accuracy itself is of are not asked again.
    again = check_accuracy(*look, sampling=Sampling(count=COUNT))
    assert int(again.accuracy.method) == Method.samples
    assert again.sampled.ranges == ((COUNT, 2 * COUNT),)
    assert again.within.value == pytest.approx(0.9, abs=0.03)  # five standard deviations of both


@pytest.mark.slow
def test_everything_prints_the_same_number_for_the_fix_of_the_demonstration(tmp_path: pathlib.Path) -> None:
    """The demonstration, its budget, one and many fixes, `jaxgeo locate` and the report."""
    from support.command_runner import CliRunner

    from jaxgeo.cli import app
    from jaxgeo.plot import budget_bars, error_cloud

    made = demo.make_demo()
    errors, uv = made.errors, made.uv[made.errors.number]
    number = float(errors.accuracy.circular)
    scene = read_scene(demo.scene_file())
    many = jaxgeo.accuracy(scene.sensor, scene.shot, made.uv[:4] * 0.0 + uv, made.dem, scene.errors)
    np.testing.assert_allclose(many.circular, number, rtol=1e-6)
    assert errors.budget.circular_error == number

    def run(*arguments: Any) -> str:
        result = CliRunner().invoke(app, [str(one) for one in arguments])
        assert result.exit_code == 0, result.output
        return result.stdout

    pixel = ["--scene", demo.scene_file(), "--dem", DATA / "jacksboro.tif", "--pixel", f"{uv[0]:g},{uv[1]:g}", "--json"]
    (located,) = json.loads(run("locate", *pixel))["fixes"]
    page = tmp_path / "page.html"
    told = json.loads(run("report", *pixel, "-o", page))
    assert located["ce90_m"] == pytest.approx(number, rel=1e-4)
    assert told["fixes"][0]["ce90_m"] == located["ce90_m"]
    assert told["details"][0]["budget"]["circular_error_m"] == pytest.approx(number, rel=1e-4)
    words = f"CE90 {number:.1f} m"
    for text in (
        f"CE90 {float(many.circular[0]):.1f} m",
        error_cloud(errors.checked).get_legend().get_texts()[1].get_text(),
        budget_bars(errors.budget).get_title(loc="right"),
    ):
        assert words in text
