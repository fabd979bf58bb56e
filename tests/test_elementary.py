"""Elementary functions, alone and in batches: to the last digit of NumPy's, with derivatives."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo._elementary import arctangent, arctangent_of_neighbours, logarithm, sine_and_cosine


def test_sine_and_cosine_to_the_last_digit_with_derivatives():
    angle = np.concatenate([np.linspace(-7.0, 7.0, 3001), np.arange(-9, 10) * np.pi / 4.0, [-9e4, 1e5, 1e-300]])
    sine, cosine = jax.jit(sine_and_cosine)(jnp.asarray(angle))
    np.testing.assert_allclose(sine, np.sin(angle), rtol=0.0, atol=3e-16)
    np.testing.assert_allclose(cosine, np.cos(angle), rtol=0.0, atol=3e-16)
    first, second = (
        jax.vmap(f)(jnp.asarray(angle))
        for f in (jax.grad(lambda x: sine_and_cosine(x)[0]), jax.grad(jax.grad(lambda x: sine_and_cosine(x)[1])))
    )
    np.testing.assert_allclose(first, cosine, rtol=0.0, atol=3e-16)
    np.testing.assert_allclose(second, -np.asarray(cosine), rtol=0.0, atol=3e-16)
    assert not np.any(np.isfinite(sine_and_cosine(jnp.array([np.nan, np.inf]))))


@pytest.mark.parametrize("strange", [0.0, 3e7, np.nan, -np.inf])
def test_sine_and_cosine_of_a_batch_with_one_odd_argument(strange):
    angle = np.append(np.random.default_rng(0).uniform(-9.0, 9.0, 2047), strange)
    with np.errstate(invalid="ignore"):
        expected = np.sin(angle), np.cos(angle)
    digits = 3e-16 + (0.0 if abs(strange) < 1e5 or not np.isfinite(strange) else np.spacing(strange))
    both = lambda x: jax.jvp(sine_and_cosine, (x,), (jnp.ones_like(x),))  # noqa: E731
    found, slopes = jax.jit(jax.vmap(both))(jnp.asarray(angle))
    for of_all, exact in ((found, expected), (slopes, (expected[1], -expected[0]))):
        np.testing.assert_allclose(np.asarray(of_all)[:, :-1], np.asarray(exact)[:, :-1], rtol=0.0, atol=3e-16)
        np.testing.assert_allclose(np.asarray(of_all)[:, -1], np.asarray(exact)[:, -1], rtol=0.0, atol=digits)
    by_row = jax.vmap(jax.vmap(sine_and_cosine))(jnp.asarray(angle).reshape(2, 1024))
    np.testing.assert_allclose(np.reshape(by_row, (2, -1)), expected, rtol=0.0, atol=digits)


def test_sine_and_cosine_of_several_angles_of_each_item_are_those_of_each():
    angle = np.random.default_rng(1).uniform(-9.0, 9.0, (1024, 3)) * np.array([1.0, 1e-3, 0.0])
    for some in (angle, 0.01 * angle):  # far from the first, and near it
        sine, cosine = jax.jit(jax.vmap(sine_and_cosine))(jnp.asarray(some))
        np.testing.assert_allclose(sine, np.sin(some), rtol=0.0, atol=3e-16)
        np.testing.assert_allclose(cosine, np.cos(some), rtol=0.0, atol=3e-16)
    assert [x.shape for x in jax.vmap(sine_and_cosine)(jnp.zeros((1024, 0)))] == [(1024, 0)] * 2


def test_sine_and_cosine_of_large_angles_are_as_good_as_the_angle():
    for size in (1e6, 1e8, 1e12):
        angle = np.random.default_rng(4).uniform(-size, size, 2000)
        sine, cosine = sine_and_cosine(jnp.asarray(angle))
        assert np.all(np.abs(np.asarray(sine) - np.sin(angle)) <= np.spacing(np.abs(angle)) + 3e-16)
        assert np.all(np.abs(np.asarray(cosine) - np.cos(angle)) <= np.spacing(np.abs(angle)) + 3e-16)
    assert np.all(np.isnan(sine_and_cosine(jnp.array([1e13, -3e17, 1e300]))))


@pytest.mark.parametrize("middle", [0.0, 1.2, -3.1, 80.0])
def test_sine_and_cosine_of_angles_near_each_other(middle):
    """By a few terms about the first; just too far apart for that, by the series of any."""
    for width in (1e-3, 0.0624, 0.07):
        angle = middle + np.random.default_rng(2).uniform(0.0, width, 1024)
        angle[0], angle[-1] = middle, middle + width
        sine, cosine = jax.jit(jax.vmap(sine_and_cosine))(jnp.asarray(angle))
        np.testing.assert_allclose(sine, np.sin(angle), rtol=0.0, atol=3e-16)
        np.testing.assert_allclose(cosine, np.cos(angle), rtol=0.0, atol=3e-16)


def test_logarithm_to_the_last_digit():
    x = np.concatenate(
        [
            np.random.default_rng(3).uniform(0.0, 3.0, 4000),
            2.0 ** np.arange(-900.0, 900.0),
            1.0 - 2.0 ** -np.arange(2.0, 53.0),
        ]
    )
    np.testing.assert_allclose(jax.jit(logarithm)(jnp.asarray(x)), np.log(x), rtol=3e-16, atol=0.0)
    assert logarithm(jnp.asarray(1.0)) == 0.0


@pytest.mark.parametrize("function", [arctangent, arctangent_of_neighbours])
@pytest.mark.parametrize("middle", [0.0, 1.2, 3.14, -3.1, -1.6])
@pytest.mark.parametrize("width", [1e-3, 0.0624, 0.07, 4.0])
def test_arctangent_of_directions_near_each_other_and_apart(function, middle, width):
    """Across the jump at half a turn too."""
    random = np.random.default_rng(2)
    angle = middle + random.uniform(0.0, width, 1024)
    angle[0], angle[-1] = middle, middle + width
    length = 10.0 ** random.uniform(-3.0, 7.0, 1024)
    y, x = length * np.sin(angle), length * np.cos(angle)
    value, slopes = jax.jit(jax.vmap(jax.value_and_grad(function, (0, 1))))(y, x)
    absolute = 0.0 if function is arctangent else 5e-16  # of the first angle, from which the others are
    np.testing.assert_allclose(value, np.arctan2(y, x), rtol=4e-16, atol=absolute)
    np.testing.assert_allclose(slopes, (x / length**2, -y / length**2), rtol=1e-15, atol=1e-300)


@pytest.mark.parametrize("function", [arctangent, arctangent_of_neighbours])
@pytest.mark.parametrize(
    "strange", [(0.0, 0.0), (0.0, -0.0), (-0.0, -1.0), (-0.0, 1.0), (np.nan, 1.0), (np.inf, 1.0), (1.0, -np.inf)]
)
def test_arctangent_of_a_batch_with_one_odd_argument(function, strange):
    y, x = jnp.asarray(np.append(np.ones((1023, 2)), [strange], axis=0)).T
    found, expected = jax.jit(jax.vmap(function))(y, x), np.arctan2(y, x)
    np.testing.assert_allclose(found, expected, rtol=4e-16, atol=0.0)
    np.testing.assert_array_equal(np.signbit(found), np.signbit(expected))
    np.testing.assert_allclose(jax.vmap(function, (0, None))(y, jnp.asarray(2.0)), np.arctan2(y, 2.0), rtol=4e-16)
    rows = jax.vmap(jax.vmap(function))(y.reshape(2, 512), x.reshape(2, 512))
    np.testing.assert_allclose(np.ravel(rows), expected, rtol=4e-16, atol=0.0)


@pytest.mark.parametrize("function", [arctangent, arctangent_of_neighbours])
def test_arctangent_at_the_ends_of_its_series(function):
    """Near 0, a quarter and half a turn, and where the series changes."""
    tangent = np.concatenate([0.66 + np.arange(-300, 300) * 2.0**-50, 10.0 ** -np.arange(0.0, 300.0)])
    y, x = np.concatenate([tangent, np.ones(900)]), np.concatenate([np.ones(900), tangent])
    for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
        found = jax.vmap(function)(*(jnp.asarray(sign * part) for sign, part in zip(signs, (y, x), strict=True)))
        np.testing.assert_allclose(found, np.arctan2(signs[0] * y, signs[1] * x), rtol=4e-16, atol=0.0)
