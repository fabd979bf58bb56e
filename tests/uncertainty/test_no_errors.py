"""An error model whose standard deviations are all zero: exact zeros, or a refusal, but no rounding."""

from __future__ import annotations

import jax
import numpy as np
import pytest

import jaxgeo
from jaxgeo.uncertainty import ErrorModel, Method, Sampling, accuracy, budget, compare, sample, sobol_indices, sources
from tests.support import looks
from tests.uncertainty.test_sampled import KEY, SCENE

NONE = ErrorModel((sources.Attitude.from_degrees(heading=0.0, pitch=0.0, roll=0.0),))
LOOK = (*SCENE[:4], NONE)


@pytest.mark.costly
def test_samples_are_zero() -> None:
    found = sample(*LOOK, key=KEY, count=500, keep=True)
    assert found.circular_error(0.9)[:3] == (0.0, 0.0, 0.0)
    assert not np.any(found.errors_enu)
    assert not np.any(found.cov_enu)
    assert found.share_within("CE", 0.0).value == 1.0
    summary = found.summarised()
    assert summary.circular_error(0.5).value < 2.0**-14
    with pytest.raises(ValueError, match="a point has no region"):
        found.region(0.9)
    with pytest.raises(ValueError, match="a point has no region"):
        found.probability_map()


@pytest.mark.costly
def test_accuracy_is_zero_by_linear_propagation() -> None:
    scene = (looks.level_sensor(), looks.level_shot(), looks.LEVEL_UV, looks.LEVEL)
    none = looks.level_errors(0.0)  # programs of other tests
    one = accuracy(*scene, none)
    assert (float(one.circular), float(one.linear), float(one.spherical)) == (0.0, 0.0, 0.0)
    assert int(one.method) == Method.facet
    assert str(one).endswith("No error moves the fix: it is as exact as its input.")
    assert budget(one).circular_error == 0.0


@pytest.mark.slow
def test_accuracy_is_zero_under_jit() -> None:
    traced = jax.jit(lambda model: accuracy(*SCENE[:4], model, sampling=None).circular)(NONE)
    assert float(traced) == 0.0


def test_nothing_to_compare_or_to_divide() -> None:
    with pytest.raises(ValueError, match="compare: all standard deviations"):
        compare(*LOOK, sampling=Sampling(count=100))
    with pytest.raises(ValueError, match="sobol_indices: all standard deviations"):
        sobol_indices(*LOOK)


def test_looks_cannot_be_weighed() -> None:
    shots = [SCENE[1], SCENE[1]]
    several = jaxgeo.uncertainty.Looks(SCENE[0], shots, [SCENE[2]] * 2)
    with pytest.raises(ValueError, match="track: all standard deviations"):
        jaxgeo.uncertainty.track(several, SCENE[3], NONE)
