"""The page on check points: what is drawn are the errors and shares of the record."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jaxgeo.plot import validation_figure
from jaxgeo.uncertainty import Validation
from jaxgeo.uncertainty.validation import Bias, Coverage, Dependence, Size, Uniformity

COUNT = 20


def made(factor: float = 1.0) -> Validation:
    """A record of 20 pixels with errors drawn at random, `factor` times those of a true model."""
    normalised = factor * np.random.default_rng(0).standard_normal((COUNT, 3))
    size = Size.of(float(np.sum(normalised**2)), 3 * COUNT)
    up = Size.of(float(np.sum(normalised[:, 2] ** 2)), COUNT)
    covered = [
        Coverage(f"{name}{100 * level:g}", level, int(level * 18), COUNT, 9.0, 0.4 * level, 0.5 + 0.5 * level, 0.3)
        for name in ("CE", "LE")
        for level in (0.5, 0.9, 0.95)
    ]
    distance = np.linspace(900.0, 1500.0, COUNT)
    names: Any = np.array([f"P{k}" for k in range(COUNT)])
    return Validation(
        points=names,
        images=names,
        status=np.zeros(COUNT, np.int8),
        error_enu=normalised,
        index=np.arange(COUNT),
        covariance_enu=np.tile(np.eye(3), (COUNT, 1, 1)),
        normalised=normalised,
        nees_each=np.sum(normalised**2, axis=1),
        size=size,
        horizontal=size,
        vertical=up,
        uniformity=Uniformity(np.histogram(np.linspace(0.01, 0.99, 60), bins=10, range=(0, 1))[0], 0.1, 0.6),
        bias=tuple(Bias(axis, 0.1, 0.2, 0.5, 0.6, 0.4, 0.7) for axis in ("east", "north", "up")),
        dependence=(
            Dependence("range", "m", distance, 0.1, 0.5),
            Dependence("look angle", "deg", np.linspace(0.0, 30.0, COUNT), 0.5, 0.01),
            Dependence("slope", "deg", np.zeros(COUNT), float("nan"), float("nan")),
        ),
        coverage=tuple(covered),
    )


def test_the_page_shows_the_record() -> None:
    found = made()
    figure = validation_figure(found)
    across, histogram, coverage, distance, angle, slope = figure.axes
    (points,) = [line for line in across.lines if line.get_marker() == "o"]
    np.testing.assert_array_equal(points.get_xydata(), found.normalised[:, :2])
    heights = [bar.get_height() for bar in histogram.patches if bar.get_width() == pytest.approx(0.1)]
    assert heights == found.uniformity.counts.tolist()
    drawn = [line.get_ydata() for line in coverage.lines if line.get_marker() == "s"]
    shares = [100.0 * one.share for one in found.coverage if one.name.startswith("LE")]
    np.testing.assert_allclose(np.asarray(drawn[0], float), shares)
    sizes = np.sqrt(np.mean(found.normalised**2, axis=1))
    for ax in (distance, angle, slope):
        (some,) = [line for line in ax.lines if line.get_marker() == "o"]
        np.testing.assert_allclose(some.get_ydata(), sizes)
    assert any("not tested" in text.get_text() for text in slope.texts)
    assert figure.get_suptitle().startswith("The errors agree with the model.")


def test_words_of_a_model_that_is_wrong() -> None:
    assert validation_figure(made(2.0)).get_suptitle().startswith("The model is too optimistic: errors are 1.8 times")
    assert "not depend on range" in str(made())
    assert "is not tested against slope" in str(made())
