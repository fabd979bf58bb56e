"""Errors of measurements beyond their stated standard deviations, from residuals."""

from __future__ import annotations

import numpy as np
import pytest

from jaxgeo.ties.excess import by_median, excess_of


@pytest.mark.parametrize("true", [0.0, 0.05, 0.4])
def test_what_was_added_is_found(true: float) -> None:
    """Of 8000 residuals without unknowns."""
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.01, 0.1, (4000, 2))
    residuals = np.hypot(sigma, true) * rng.normal(size=sigma.shape)
    found = excess_of(residuals, sigma, residuals.size)
    assert found == pytest.approx(true, rel=0.05, abs=0.01)
    axis = np.argmax(np.abs(residuals / sigma), axis=1)
    largest = np.max(np.abs(residuals), axis=1)
    assert by_median(largest, np.full(len(axis), 1e-9)) == pytest.approx(np.median(largest) / 1.054, rel=1e-6)


def test_few_residuals_count_for_less() -> None:
    """1 / (m - 2) of the sum of squares is the mean of an inverse chi-square of m degrees of freedom."""
    residuals, sigma = np.full((3, 2), 0.2), np.full((3, 2), 1e-9)
    assert excess_of(residuals, sigma, 6) ** 2 == pytest.approx(6 * 0.04 / 4, rel=1e-6)
    assert excess_of(residuals, sigma, 1) ** 2 == pytest.approx(6 * 0.04, rel=1e-6)
    assert excess_of(residuals, np.ones((3, 2)), 6) == 0.0
