"""The pure Monte Carlo function: the samples of `sample`, under every transformation of JAX."""

from __future__ import annotations

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import export

import jaxgeo
from jaxgeo import ConstantHeight, Exposure, Observation, Pose, Shot, Status
from jaxgeo.uncertainty import ErrorModel, Random, Sampling, Sobol, error_samples, sample, sources
from jaxgeo.uncertainty.batched_rays import BLOCK
from tests.support import looks
from tests.uncertainty.test_sampled import KEY, MODEL, SCENE, SENSOR, shot

ROUNDING = 1e-8  # m: two programs
TERRAIN = (looks.sensor(), looks.shot(), looks.UV, looks.dem(), looks.few_sources())


NUMBERS = np.r_[np.arange(3800)[::-1], 7, 7]  # of more than one block, in any order, and more than once


@functools.partial(jax.jit, static_argnames="draws")
def errors_of(scene: Any, key: Any, indices: Any, draws: Any = Random()) -> Any:
    return error_samples(*scene, key, indices, draws=draws)


@pytest.mark.costly
@pytest.mark.parametrize(
    "scene, draws",
    [
        (SCENE, Random()),
        pytest.param(SCENE, Sobol(), marks=pytest.mark.slow),
        pytest.param(TERRAIN, Random(), marks=pytest.mark.slow),
        pytest.param(TERRAIN, Sobol(), marks=pytest.mark.slow),
    ],
)
def test_samples_of_these_numbers(scene, draws) -> None:
    expected = sample(*scene, key=KEY, count=16 * 240, keep=True, draws=draws)
    assert NUMBERS.size > BLOCK
    found = errors_of(scene, KEY, NUMBERS, draws=draws)
    np.testing.assert_allclose(found.errors_enu, expected.errors_enu[NUMBERS], rtol=0, atol=ROUNDING)
    np.testing.assert_array_equal(found.status, expected.codes[NUMBERS])


@pytest.mark.slow
def test_a_map_over_pixels_keys_and_numbers() -> None:
    pixels, keys = jnp.array([[400.0, 300.0], [100.0, 20.0]]), jax.random.split(KEY, 2)
    each = lambda uv, key, numbers: error_samples(*SCENE[:2], uv, *SCENE[3:], key, numbers)  # noqa: E731
    numbers = np.arange(6).reshape(3, 2)
    found = jax.jit(jax.vmap(jax.vmap(each, (None, None, 0)), (0, 0, None)))(pixels, keys, numbers)
    assert found.errors_enu.shape == (2, 3, 2, 3)
    for k in range(2):
        expected = sample(*SCENE[:2], pixels[k], *SCENE[3:], key=keys[k], count=6, keep=True, draws=Random()).errors_enu
        np.testing.assert_allclose(found.errors_enu[k].reshape(6, 3), expected, rtol=0, atol=ROUNDING)


@pytest.mark.costly
def test_an_observation_and_shapes_of_numbers() -> None:
    one = Observation(Exposure(*SCENE[:2]), np.array(SCENE[2]))
    f = jax.jit(error_samples)
    alone = f(one, *SCENE[3:], KEY, 5)
    none = jax.eval_shape(f, one, *SCENE[3:], KEY, np.zeros((0, 2), int))
    assert alone.errors_enu.shape == (3,)
    assert alone.status.shape == ()
    assert none.errors_enu.shape == (0, 2, 3)
    expected = sample(*SCENE, key=KEY, count=6, keep=True, draws=Random()).errors_enu[5]
    np.testing.assert_allclose(alone.errors_enu, expected, rtol=0, atol=ROUNDING)


@pytest.mark.costly
def test_without_a_nominal_fix_and_beyond_the_last_number() -> None:
    nowhere = errors_of((SENSOR, shot(20.0), *SCENE[2:]), KEY, NUMBERS, draws=Random())
    assert np.all(nowhere.status == Status.rises_away)
    assert np.all(np.isnan(nowhere.errors_enu))
    beyond = errors_of(SCENE, KEY, np.r_[-1, 2**32, 2**32 - 1, NUMBERS[3:]], draws=Random())
    np.testing.assert_array_equal(beyond.status[:3], [Status.invalid_input, Status.invalid_input, Status.hit])
    np.testing.assert_array_equal(np.isnan(beyond.errors_enu[:3, 0]), [True, True, False])


@pytest.mark.parametrize(
    "key, indices, options, error, message",
    [
        (KEY, [0.5], {}, TypeError, "indices must be the whole numbers of samples"),
        (KEY, np.array([0, -1]), {}, ValueError, "indices must be from 0 to 4294967295; got -1 to 0"),
        (KEY, np.array([2**32]), {}, ValueError, "indices must be from 0 to 4294967295"),
        (3, np.arange(2), {}, TypeError, "key must be one of jax.random.key"),
        (jax.random.key(0, impl="rbg"), np.arange(2), {}, ValueError, "key must be of the kind threefry2x32"),
    ],
)
def test_arguments_that_make_no_sense(key, indices, options: dict, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        error_samples(*SCENE, key, jnp.asarray(indices), **options)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [SCENE, TERRAIN])
def test_derivatives_with_respect_to_the_size_of_errors(scene) -> None:
    def errors(sigma: Any) -> Any:
        model = ErrorModel((sources.Position.from_ned(north=sigma, east=1.5, down=2.0),))
        return error_samples(*scene[:4], model, KEY, np.arange(8)).errors_enu

    step, f = 1e-3, jax.jit(errors)
    expected = (f(1.0 + step) - f(1.0 - step)) / (2.0 * step)
    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jax.jit(derivative(errors))(1.0), expected, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("scene", [SCENE, pytest.param(TERRAIN, marks=pytest.mark.slow)])
def test_export_with_a_symbolic_number_of_samples(scene) -> None:
    """Serialised with its records, and called with any number of samples of another scene."""
    pytest.importorskip("flatbuffers")
    (n,) = export.symbolic_shape("n")
    scene = jax.tree.map(jnp.asarray, scene)
    shapes = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), (scene, KEY))
    exported = export.export(jax.jit(errors_of))(*shapes, jax.ShapeDtypeStruct((n,), jnp.int64))
    called = export.deserialize(exported.serialize()).call
    other = jax.random.key(99)
    expected = sample(*scene, key=other, count=BLOCK + 5, keep=True, draws=Random())
    for count in (1, BLOCK + 5):
        found = called(scene, other, jnp.arange(count))
        assert isinstance(found, jaxgeo.uncertainty.ErrorSamples)
        np.testing.assert_allclose(found.errors_enu, expected.errors_enu[:count], rtol=0, atol=ROUNDING)
        np.testing.assert_array_equal(found.status, expected.codes[:count])


@pytest.mark.parametrize(
    "call",
    [
        jax.jit(lambda: sample(*SCENE).count),
        lambda: jax.jit(lambda key: sample(*SCENE, key=key).count)(KEY),
        lambda: jax.jit(lambda key: sample(*SCENE, sampling=Sampling(key=key)).count)(KEY),
        lambda: jax.vmap(lambda uv: sample(*SCENE[:2], uv, *SCENE[3:]).count)(jnp.ones((2, 2))),
        lambda: jax.vmap(lambda height: sample(*SCENE[:3], ConstantHeight(height), MODEL).count)(jnp.ones(2)),
        lambda: jax.grad(
            lambda sigma: sample(*SCENE[:4], sources.Position.from_ned(north=sigma, east=1.0, down=1.0)).failed
        )(1.0),
        lambda: jax.jit(lambda one: sample(Observation(one, np.array(SCENE[2])), *SCENE[3:]).count)(
            Exposure(SENSOR, Shot(Pose.from_degrees(lat=45.0, lon=7.0, height=3000.0, pitch=-30.0)))
        ),
    ],
)
def test_sample_inside_of_transformations_is_refused_in_words(call) -> None:
    with pytest.raises(TypeError, match=r"sample draws samples in parts .*: call it outside .*error_samples there\."):
        call()


@pytest.mark.parametrize(
    "call",
    [
        jax.jit(lambda: jaxgeo.accuracy(*SCENE).circular),
        lambda: jax.jit(lambda uv: jaxgeo.accuracy(*SCENE[:2], uv, *SCENE[3:]).circular)(jnp.ones(2)),
        lambda: jax.vmap(lambda uv: jaxgeo.accuracy(*SCENE[:2], uv, *SCENE[3:]).circular)(jnp.ones((2, 2))),
        lambda: jax.jit(lambda key: jaxgeo.accuracy(*SCENE, sampling=Sampling(key=key)).circular)(KEY),
    ],
)
def test_accuracy_by_samples_inside_of_transformations_is_refused_in_words(call) -> None:
    with pytest.raises(TypeError, match=r"which jit, vmap and derivatives do not allow\. Pass sampling=None"):
        call()
