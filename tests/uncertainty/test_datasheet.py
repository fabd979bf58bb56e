"""Words of data sheets: the sigma of each reading, and refusals of words that have several."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import scipy.stats

from jaxgeo.uncertainty import datasheet, metrics, sources
from jaxgeo.uncertainty.datasheet import circular_error, linear_error, plus_minus, rms, spherical_error
from jaxgeo.uncertainty.distributions import Laplace, Uniform


@pytest.mark.parametrize(
    "kind, theirs",
    [
        ("uniform", scipy.stats.uniform(-0.1, 0.2)),
        ("triangular", scipy.stats.triang(0.5, -0.1, 0.2)),
        ("arcsine", scipy.stats.arcsine(-0.1, 0.2)),
    ],
)
def test_limits_are_those_of_the_distribution(kind: str, theirs: Any) -> None:
    found = plus_minus(0.1, kind=kind)
    assert found.distribution is not None
    assert found.sigma == pytest.approx(theirs.std(), rel=1e-12)
    assert found.sigma * float(found.distribution.quantile(1.0)) == pytest.approx(0.1, rel=1e-12)
    assert found.sigma * float(found.distribution.quantile(0.3)) == pytest.approx(theirs.ppf(0.3), rel=1e-12)


def test_normal_accuracies_hold_with_their_coverage() -> None:
    assert plus_minus(0.1, kind="normal", sigmas=2) == (0.05, None)
    found = plus_minus(0.1, kind="normal", coverage=0.95)
    assert found.distribution is None
    assert found.sigma == pytest.approx(0.1 / 1.959963985, rel=1e-9)


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.95])
def test_radii_contain_their_probability(probability: float) -> None:
    """With the sigma of each axis the exact radii of the metrics come out again."""
    across = circular_error(1.5, probability=probability).sigma
    assert float(metrics.circular_error(across**2 * np.eye(2), probability)) == pytest.approx(1.5, rel=1e-8)
    up = linear_error(3.0, probability=probability).sigma
    assert up * scipy.stats.norm.ppf(0.5 + 0.5 * probability) == pytest.approx(3.0, rel=1e-12)
    ball = spherical_error(2.0, probability=probability).sigma
    assert float(metrics.spherical_error(ball**2 * np.eye(3), probability)) == pytest.approx(2.0, rel=1e-8)


def test_root_mean_squares_are_of_so_many_axes() -> None:
    assert rms(3.0, axes=1).sigma == 3.0
    assert rms(3.0, axes=2).sigma == pytest.approx(3.0 / math.sqrt(2.0))
    assert rms(3.0, axes=2, times=2).sigma == pytest.approx(1.5 / math.sqrt(2.0))  # 2DRMS
    assert rms(3.0, axes=3).sigma == pytest.approx(3.0 / math.sqrt(3.0))


@pytest.mark.parametrize(
    "words, readings",
    [
        (lambda: plus_minus(0.1), ('kind="uniform": sigma 0.05774', "sigmas=2: sigma 0.05", "=0.95: sigma 0.051")),
        (lambda: plus_minus(0.1, kind="normal"), ("say which", "sigmas=3: sigma 0.03333")),
        (lambda: plus_minus(0.1, kind="normal", sigmas=2, coverage=0.95), ("say which",)),
        (lambda: circular_error(1.5), ("0.5 (CEP): sigma 1.274", "0.9 (90 %): sigma 0.699")),
        (lambda: linear_error(1.5), ("0.9 (90 %): sigma 0.9119",)),
        (lambda: spherical_error(1.5), ("0.5 (SEP): sigma 0.9752",)),
        (lambda: rms(2.0), ("axes=1: sigma 2 of each axis; axes=2: sigma 1.414",)),
    ],
)  # fmt: skip
def test_ambiguous_words_are_refused_with_their_readings(words: Any, readings: tuple[str, ...]) -> None:
    with pytest.raises(ValueError, match=r"say which|can be that of") as refused:
        words()
    for reading in readings:
        assert reading in str(refused.value)


@pytest.mark.parametrize(
    "words, message",
    [
        (lambda: plus_minus(-0.1, kind="uniform"), "half_width must be a finite number of at least 0; got -0.1"),
        (lambda: plus_minus(math.inf, kind="uniform"), "half_width must be a finite number"),
        (lambda: plus_minus(0.1, kind="gaussian"), "kind must be uniform, triangular, arcsine or normal"),
        (lambda: plus_minus(0.1, kind="uniform", sigmas=2), "has limits: sigmas and coverage go with"),
        (lambda: plus_minus(0.1, kind="normal", sigmas=0), "sigmas must be positive"),
        (lambda: plus_minus(0.1, kind="normal", coverage=95), "coverage must lie between 0 and 1"),
        (lambda: plus_minus(0.1, kind="normal", coverage=1e-17), "coverage must lie between 0 and 1"),
        (lambda: plus_minus(0.1, kind="normal", sigmas=1e-300), "sigmas must be positive"),
        (lambda: circular_error(1.5, probability=50), "probability must lie between 0 and 1"),
        (lambda: circular_error(-1.5, probability=0.5), "radius must be a finite number of at least 0"),
        (lambda: rms(1.0, axes=4), "axes must be 1, 2 or 3"),
        (lambda: rms(1.0, axes=2, times=0), "times must be positive"),
    ],
)
def test_bad_numbers_are_refused(words: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        words()
    with pytest.raises(TypeError, match="must be a number, without a unit"):
        plus_minus("0.1 deg", kind="uniform")


def test_sources_take_what_data_sheets_state() -> None:
    encoder = plus_minus(0.1, kind="uniform")
    gimbal = sources.GimbalAngles.from_degrees(outer=encoder, inner=0.02)
    np.testing.assert_allclose(np.rad2deg(np.asarray(gimbal.sigma)), [0.1 / math.sqrt(3.0), 0.02], rtol=1e-12)
    assert isinstance(gimbal.shapes[0], Uniform)
    assert gimbal.shapes[1] is None
    across = circular_error(1.5, probability=0.5)
    place = sources.Position.from_ned(north=across, east=across, down=linear_error(3.0, probability=0.9))
    assert place.is_normal
    np.testing.assert_allclose(place.sigma, [1.2739827, 1.2739827, 1.8238705], rtol=1e-7)
    with pytest.raises(ValueError, match="distribution is stated twice"):
        sources.GimbalAngles.from_degrees(outer=encoder, inner=encoder, distribution=Laplace())
    assert datasheet.Stated(1.0).distribution is None
