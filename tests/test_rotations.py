"""Laws of rotations: composition, inverses, gimbal lock, and scipy as an outside oracle."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jaxgeo.rotations import (
    R_from_heading_pitch_roll,
    R_from_rotation_vector,
    Rx,
    Ry,
    Rz,
    heading_pitch_roll_from_R,
)

N = 200
COMPOSE = jax.jit(jax.vmap(R_from_heading_pitch_roll))
ANGLES = jax.jit(jax.vmap(heading_pitch_roll_from_R))
RODRIGUES = jax.jit(jax.vmap(R_from_rotation_vector))


@pytest.mark.parametrize("R, axis", [(Rx, 0), (Ry, 1), (Rz, 2)])
def test_elementary_rotations_are_active_and_right_handed(R, axis):
    """A quarter turn takes the next axis to the one after it; angles of one axis add."""
    x, y, z = np.roll(np.eye(3), -axis, axis=0)
    quarter = np.asarray(R(jnp.asarray(np.pi / 2)))
    np.testing.assert_allclose(quarter @ x, x, rtol=0, atol=1e-16)
    np.testing.assert_allclose(quarter @ y, z, rtol=0, atol=1e-16)
    a, b = jnp.asarray(0.3), jnp.asarray(-1.1)
    np.testing.assert_allclose(R(a) @ R(b), R(a + b), rtol=0, atol=1e-15)
    np.testing.assert_allclose(R(a).T, R(-a), rtol=0, atol=0)


def test_heading_pitch_roll_agrees_with_scipy():
    angles = np.random.default_rng(0).uniform(-3, 3, (N, 3))
    expected = Rotation.from_euler("ZYX", angles).as_matrix()
    np.testing.assert_allclose(COMPOSE(*angles.T), expected, rtol=0, atol=1e-15)


def test_heading_pitch_roll_means_what_pilots_mean():
    """Body axes in north-east-down: nose east when heading 90 degrees, nose up, right wing down."""
    right_angle, tilt = jnp.asarray(np.pi / 2), jnp.asarray(0.2)
    zero = jnp.asarray(0.0)
    np.testing.assert_allclose(R_from_heading_pitch_roll(right_angle, zero, zero)[:, 0], [0, 1, 0], rtol=0, atol=1e-16)
    assert float(R_from_heading_pitch_roll(zero, tilt, zero)[2, 0]) < 0  # the nose points up: down is negative
    assert float(R_from_heading_pitch_roll(zero, zero, tilt)[2, 1]) > 0  # the right wing points down


def test_angles_come_back():
    rng = np.random.default_rng(1)
    heading, roll = rng.uniform(-np.pi, np.pi, (2, N))
    pitch = rng.uniform(-1.57, 1.57, N)
    found = np.stack(ANGLES(COMPOSE(heading, pitch, roll)))
    scale = np.stack([np.cos(pitch), np.ones(N), np.cos(pitch)])
    np.testing.assert_allclose((found - np.stack([heading, pitch, roll])) * scale, 0, rtol=0, atol=2e-15)


@pytest.mark.parametrize("short_of_lock", [0.0, 1e-16, 1e-15, 1e-14, 1e-12, 1e-8, 1e-4])
@pytest.mark.parametrize("noise", [0.0, 2e-16])
def test_angles_rebuild_the_rotation_at_and_near_gimbal_lock(short_of_lock, noise):
    rng = np.random.default_rng(2)
    heading, roll = rng.uniform(-np.pi, np.pi, (2, N))
    pitch = rng.choice([-1, 1], N) * (np.pi / 2 - short_of_lock * rng.uniform(0, 1, N))
    R = np.asarray(COMPOSE(heading, pitch, roll)) + noise * rng.normal(size=(N, 3, 3))
    found = ANGLES(R)
    assert np.all(np.isfinite(np.stack(found)))
    np.testing.assert_allclose(COMPOSE(*found), R, rtol=0, atol=1e-14)


def test_roll_is_zero_at_lock():
    _, pitch, roll = heading_pitch_roll_from_R(R_from_heading_pitch_roll(*map(jnp.asarray, (0.4, np.pi / 2, 0.3))))
    assert (float(pitch), float(roll)) == (pytest.approx(np.pi / 2), 0.0)


def test_derivatives_at_lock_are_finite():
    R = R_from_heading_pitch_roll(*map(jnp.asarray, (0.4, np.pi / 2, 0.3)))
    for derivative in jax.tree.leaves(jax.jit(jax.jacrev(heading_pitch_roll_from_R))(R)):
        assert np.all(np.isfinite(derivative))


@pytest.mark.parametrize("length", [0.0, 1e-12, 1e-5, 0.99e-4, 1.01e-4, 0.1, 3.0, np.pi, 7.0])
def test_rotation_vector_agrees_with_scipy(length):
    axes = np.random.default_rng(3).normal(size=(N, 3))
    vectors = length * axes / np.linalg.norm(axes, axis=1, keepdims=True)
    np.testing.assert_allclose(RODRIGUES(vectors), Rotation.from_rotvec(vectors).as_matrix(), rtol=0, atol=1e-15)


def test_a_rotation_vector_along_an_axis_is_the_elementary_rotation():
    for R, axis in ((Rx, 0), (Ry, 1), (Rz, 2)):
        np.testing.assert_allclose(
            R_from_rotation_vector(0.7 * jnp.eye(3)[axis]), R(jnp.asarray(0.7)), rtol=0, atol=2e-16
        )


def test_derivatives_of_the_rotation_vector_are_smooth_at_zero():
    """At zero: the cross product, then its symmetrised square. Both sides of the switch of formulas agree."""
    first = jax.jit(jax.jacfwd(R_from_rotation_vector))
    second = jax.jit(jax.jacfwd(jax.jacfwd(R_from_rotation_vector)))
    generators = np.asarray(first(jnp.zeros(3)))
    cross = np.array(
        [[[0, 0, 0], [0, 0, -1], [0, 1, 0]], [[0, 0, 1], [0, 0, 0], [-1, 0, 0]], [[0, -1, 0], [1, 0, 0], [0, 0, 0]]]
    )
    np.testing.assert_allclose(np.moveaxis(generators, 2, 0), cross, rtol=0, atol=1e-16)
    expected = np.einsum("aij,bjk->ikab", cross, cross)
    np.testing.assert_allclose(second(jnp.zeros(3)), (expected + np.swapaxes(expected, 2, 3)) / 2, rtol=0, atol=1e-15)
    axis = jnp.array([0.6, 0.0, 0.8])
    for derivative in (first, second):
        below, above = derivative(0.9999e-4 * axis), derivative(1.0001e-4 * axis)
        np.testing.assert_allclose(below, above, rtol=0, atol=5e-8)
