"""Small numerical tools: values, and derivatives where the plain formulas give NaN."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo._numerics import (
    all_finite,
    covariance_root,
    finite_or,
    implicit_root,
    larger,
    newton_or_half,
    safe_angle,
    safe_norm,
    safe_sqrt,
    smaller,
    tree_where,
    within,
)


@pytest.mark.parametrize("x, value, slope", [(4.0, 2.0, 0.25), (0.0, 0.0, 0.0), (-1.0, 0.0, 0.0)])
def test_safe_sqrt(x, value, slope):
    assert float(safe_sqrt(jnp.asarray(x))) == value
    assert float(jax.grad(safe_sqrt)(jnp.asarray(x))) == slope
    assert np.isfinite(float(jax.grad(jax.grad(safe_sqrt))(jnp.asarray(x))))


def test_safe_norm():
    v = jnp.array([3.0, 0.0, -4.0])
    assert float(safe_norm(v)) == 5.0
    np.testing.assert_allclose(jax.grad(safe_norm)(v), v / 5.0, rtol=0, atol=1e-16)
    np.testing.assert_array_equal(jax.grad(safe_norm)(jnp.zeros(3)), np.zeros(3))
    assert np.all(np.isfinite(jax.hessian(safe_norm)(jnp.zeros(3))))


@pytest.mark.parametrize("angle", [1e-12, 1e-6, 0.5, np.pi / 2, 3.0, np.pi - 1e-9])
def test_safe_angle_is_exact_for_small_and_large_angles(angle):
    a, b = jnp.array([2.0, 0.0, 0.0]), 3.0 * jnp.array([np.cos(angle), 0.0, np.sin(angle)])
    assert float(safe_angle(a, b)) == pytest.approx(angle, rel=1e-15, abs=2e-16)


def test_safe_angle_has_finite_gradients_between_parallel_vectors():
    a = jnp.array([1.0, 0.0, 0.0])
    for b in (a, -a):
        assert np.all(np.isfinite(jax.grad(safe_angle)(a, b)))


@pytest.mark.parametrize("order", ["forward", "reverse", "mixed"])
def test_implicit_derivatives_to_second_order(order):
    """x^3 = a: the root keeps its value to the bit, its derivatives are a^(-2/3)/3 and -2 a^(-5/3)/9."""

    def cube_root(a):
        return implicit_root(lambda x, a: x**3 - a, jnp.cbrt(jax.lax.stop_gradient(a)), a)

    derivative = {"forward": jax.jacfwd, "reverse": jax.jacrev, "mixed": jax.grad}[order]
    second = {"forward": jax.jacfwd, "reverse": jax.jacrev, "mixed": jax.jacfwd}[order](derivative(cube_root))
    a = jnp.asarray(5.0)
    assert float(cube_root(a)) == float(jnp.cbrt(a))
    assert float(derivative(cube_root)(a)) == pytest.approx(5.0 ** (-2 / 3) / 3, rel=1e-14)
    assert float(second(a)) == pytest.approx(-2 / 9 * 5.0 ** (-5 / 3), rel=1e-13)


def test_implicit_derivative_at_a_double_root_stays_finite():
    gradient = jax.grad(lambda a: implicit_root(lambda x, a: x**2 - a, jnp.asarray(0.0), a))(jnp.asarray(0.0))
    assert np.isfinite(float(gradient))


def test_all_finite_looks_at_floats_only():
    assert bool(all_finite({"a": jnp.ones(3), "b": jnp.arange(2), "c": "text"}))
    assert not bool(all_finite({"a": jnp.array([1.0, np.nan])}))
    assert not bool(all_finite([jnp.ones(2), jnp.asarray(np.inf)]))
    assert bool(all_finite({}))


def test_finite_or_replaces_and_keeps_gradients_clean():
    tree = {"x": jnp.array([1.0, np.nan, -np.inf]), "n": jnp.arange(2)}
    found = finite_or(tree, 7.0)
    np.testing.assert_array_equal(found["x"], [1.0, 7.0, 7.0])
    np.testing.assert_array_equal(found["n"], [0, 1])
    gradient = jax.grad(lambda x: jnp.sum(jnp.sqrt(finite_or(x, 1.0))))(tree["x"])
    np.testing.assert_allclose(gradient, [0.5, 0.0, 0.0])


def test_tree_where_chooses_leaf_by_leaf():
    a, b = {"x": jnp.ones(2), "y": jnp.asarray(1)}, {"x": jnp.zeros(2), "y": jnp.asarray(0)}
    found = jax.vmap(lambda c: tree_where(c, a, b))(jnp.array([True, False]))
    np.testing.assert_array_equal(found["x"], [[1, 1], [0, 0]])
    np.testing.assert_array_equal(found["y"], [1, 0])


@pytest.mark.parametrize("value", [1e-15, 0.0, -1e-15])
@pytest.mark.parametrize("low, high", [(1.0, 9.0), (3.0, 9.0), (1.0, 3.0), (3.0, 3.0)])
def test_a_root_met_again_is_kept_whatever_sign_rounding_gives_it(value, low, high):
    """Even if it was an end of the bracket under the other sign: the middle of the bracket is far away."""
    _, _, following = newton_or_half(*(jnp.asarray(x) for x in (low, high, 3.0, value, -2.0)), slack=1e-9)
    assert float(following) == pytest.approx(3.0, rel=0, abs=1e-14)


@pytest.mark.parametrize(
    "value, slope, expected", [(4.0, -2.0, 5.0), (4.0, -0.5, 6.0), (4.0, 2.0, 6.0), (-4.0, 0.0, 2.0)]
)
def test_a_step_out_of_the_bracket_is_replaced_by_halving(value, slope, expected):
    assert float(newton_or_half(*(jnp.asarray(x) for x in (1.0, 9.0, 3.0, value, slope)), slack=1e-9)[2]) == expected


@pytest.mark.parametrize(
    "ours, theirs", [(larger, jnp.maximum), (smaller, jnp.minimum), (lambda x, y: within(x, y, 1.0), jnp.clip)]
)
def test_limits_are_those_of_numpy_and_keep_what_is_unknown(ours, theirs):
    x, y = jnp.array([-2.0, 0.5, np.nan, 0.3, 2.0]), jnp.array([0.0, 0.0, 0.0, np.nan, 0.0])
    expected = theirs(x, y, 1.0) if theirs is jnp.clip else theirs(x, y)
    np.testing.assert_array_equal(ours(x, y), expected)
    apart = lambda x: (ours(x + 1e-6, 0.0) - ours(x - 1e-6, 0.0)) / 2e-6  # noqa: E731
    for one in (-2.0, 0.5, 2.0):
        assert float(jax.grad(ours)(one, 0.0)) == pytest.approx(float(apart(one)), abs=1e-9)


@pytest.mark.parametrize("signs", [(1, 1, 1, 1, 1), (-1, -1, -1, -1, -1), (1, -1, -1, 1, -1)])
def test_covariance_root_does_not_depend_on_the_signs_of_principal_axes(signs, monkeypatch):
    """Those of an even field of heights are mirrored in themselves, so no component of an axis tells its sign."""
    place = np.arange(5.0)
    covariance = 4.0 * np.exp(-(((place[:, None] - place[None, :]) / 2.0) ** 2))
    values, axes = np.linalg.eigh(covariance)
    assert np.allclose(np.abs(axes), np.abs(axes[::-1]), atol=1e-9)
    monkeypatch.setattr(jnp.linalg, "eigh", lambda _: (jnp.asarray(values), jnp.asarray(axes * np.array(signs))))
    root = np.asarray(covariance_root(jnp.asarray(covariance)))
    np.testing.assert_allclose(root @ root.T, covariance, atol=1e-12)
    assert np.all(np.diff(np.sum(root**2, axis=0)) <= 0.0)
    monkeypatch.undo()
    np.testing.assert_allclose(root, covariance_root(jnp.asarray(covariance)), atol=1e-12)
