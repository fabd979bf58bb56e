"""Likeness of neighbours' residuals: what chance makes, and what a bend or a seam makes."""

from __future__ import annotations

import numpy as np
import pytest

from jaxgeo.register.residual_correlation import FEWEST, morans_i_zscore


@pytest.mark.parametrize("count", [20, 50, 150])
def test_independent_residuals_are_as_alike_as_the_law_has_it(count: int) -> None:
    rng = np.random.default_rng(count)
    found = np.array([morans_i_zscore(rng.normal(size=(count, 2)), rng.uniform(size=(count, 2))) for _ in range(400)])
    assert abs(found.mean()) < 4.0 / np.sqrt(len(found))
    assert 0.85 < found.std() < 1.15
    assert np.mean(found > 2.5) < 0.03


def test_what_bends_is_alike() -> None:
    rng = np.random.default_rng(0)
    places = rng.uniform(-1.0, 1.0, size=(50, 2))
    bent = places * np.sum(places**2, axis=1)[:, None]
    torn = np.where(places > 0.0, 1.0, -1.0)
    for wrong in (bent / bent.std(), torn):
        assert morans_i_zscore(wrong + 0.5 * rng.normal(size=(50, 2)), places) > 5.0
        shuffled = [morans_i_zscore(wrong[rng.permutation(50)], places) for _ in range(100)]
        assert np.mean(np.array(shuffled) > 2.5) < 0.05


def test_units_places_and_the_mean_do_not_matter() -> None:
    rng = np.random.default_rng(1)
    residuals, places = 0.3 * rng.normal(size=(40, 2)), rng.uniform(size=(40, 2))
    told = morans_i_zscore(residuals, places)
    assert morans_i_zscore(residuals + 0.1, 1000.0 * places + 7.0) == pytest.approx(told, abs=1e-9)
    assert morans_i_zscore(residuals[::-1], places[::-1]) == pytest.approx(told, abs=1e-9)


def test_few_tell_nothing() -> None:
    assert np.isnan(morans_i_zscore(np.ones((FEWEST - 1, 2)), np.zeros((FEWEST - 1, 2))))
    assert np.isfinite(morans_i_zscore(np.ones((FEWEST, 2)), np.zeros((FEWEST, 2))))
