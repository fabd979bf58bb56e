"""Intersection and resection by solvers of optimistix: the answers of ours, their derivatives, and their failures."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
import pytest
from test_intersection import (
    AIR,
    NOISE,
    P_ECEF,
    POINT,
    RAYS,
    SENSOR,
    SHOTS,
    SITES,
    UVS,
    by_pixels,
    failing,
    images_through_air,
    several,
)
from test_weak_control import alone

from jaxgeo import Status
from jaxgeo.adjust import forward_intersection, resect_image
from tests.support.simulated_block import simulated

TIGHT = {"rtol": jnp.asarray(1e-10), "atol": jnp.asarray(1e-10)}  # as arrays: other tolerances compile nothing anew
SOLVERS = {
    "Gauss-Newton": optx.GaussNewton(**TIGHT),
    "Gauss-Newton, Cholesky": optx.GaussNewton(**TIGHT, linear_solver=lx.Normal(lx.Cholesky())),
    "Levenberg-Marquardt": optx.LevenbergMarquardt(**TIGHT),
    "dogleg": optx.Dogleg(**TIGHT),
}
ROWS = [pytest.param(n, marks=() if n == "Levenberg-Marquardt" else pytest.mark.slow) for n in SOLVERS]
IMPATIENT = optx.LevenbergMarquardt(rtol=jnp.asarray(1e3), atol=jnp.asarray(1e3))  # content after one step
NOISY = np.asarray(UVS) + NOISE


@pytest.mark.costly
@pytest.mark.parametrize("with_errors", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ROWS)
def test_an_intersection_by_any_solver_is_ours(name: str, with_errors: bool) -> None:
    given = {"errors": several()} if with_errors else {"sigma": 0.5}
    ours = forward_intersection(SENSOR, SHOTS, NOISY, **given)
    found = forward_intersection(SENSOR, SHOTS, NOISY, **given, solver=SOLVERS[name])
    assert found.status == ours.status == Status.hit
    np.testing.assert_allclose(found.p_ecef, ours.p_ecef, rtol=0, atol=1e-6)  # m
    np.testing.assert_allclose(found.cov_enu, ours.cov_enu, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(found.chi_square, ours.chi_square, rtol=1e-6)


@pytest.mark.slow
def test_an_intersection_through_the_air_by_a_solver_is_ours() -> None:
    uvs = np.asarray(images_through_air(SHOTS, POINT)) + NOISE
    found, ours = (
        forward_intersection(SENSOR, SHOTS, uvs, sigma=0.5, atmosphere=AIR, solver=solver)
        for solver in (SOLVERS["Levenberg-Marquardt"], None)
    )
    assert found.ok
    np.testing.assert_allclose(found.p_ecef, ours.p_ecef, rtol=0, atol=1e-6)  # m


@pytest.mark.costly
def test_a_call_alone_is_its_lane_of_a_batch() -> None:
    uvs = jnp.asarray(NOISY)[None] + jnp.arange(float(len(SITES)))[:, None, None]
    shots = jax.tree.map(lambda x: jnp.stack([x] * len(SITES)), SHOTS)
    many = by_pixels(SENSOR, shots, uvs, jnp.ones((len(SITES), RAYS), bool), 0.5)
    for lane in range(2):
        one = forward_intersection(SENSOR, SHOTS, uvs[lane], sigma=0.5)
        np.testing.assert_allclose(one.p_ecef, many.p_ecef[lane], rtol=0, atol=1e-7)  # m
        assert one.status == many.status[lane]


@pytest.mark.slow
def test_points_that_fail_have_the_same_status_by_a_solver() -> None:
    shots, uvs, use, statuses = failing()
    one = lambda s, u, w: forward_intersection(SENSOR, s, u, use=w, sigma=0.5, solver=SOLVERS["Levenberg-Marquardt"])  # noqa: E731
    found = jax.jit(jax.vmap(one))(shots, uvs, use)
    assert [Status(int(code)) for code in found.status] == list(statuses)
    assert np.all(np.isnan(np.asarray(found.p_ecef)[~np.asarray(found.ok)]))


@pytest.mark.costly
@pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_derivatives_through_a_solver_are_those_of_differences(order: int) -> None:
    scales = jnp.array([1.0, 1e-4, 1.0])  # px, rad, m

    def point(change: Any) -> Any:
        change = change * scales
        shots = eqx.tree_at(lambda s: s.pose.heading, SHOTS, SHOTS.pose.heading.at[2].add(change[1]))
        shots = eqx.tree_at(lambda s: s.pose.position.height, shots, shots.pose.position.height.at[0].add(change[2]))
        uvs = jnp.asarray(NOISY).at[1, 0].add(change[0])
        found = forward_intersection(SENSOR, shots, uvs, sigma=0.5, solver=SOLVERS["Gauss-Newton"])
        return found.p_ecef - P_ECEF

    value = point if order == 1 else jax.jacrev(lambda change: point(change)[0])
    both = jax.jit(jax.jacfwd(lambda change: (value(change),) * 2, has_aux=True))
    exact = np.asarray(both(jnp.zeros(3))[0])
    steps = 0.5 * np.eye(3)
    differences = np.stack([(both(jnp.asarray(s))[1] - both(jnp.asarray(-s))[1]) for s in steps], axis=-1)
    assert np.abs(exact).max() > (0.01 if order == 1 else 1e-5)
    np.testing.assert_allclose(exact, differences, rtol=1e-5, atol=1e-6 if order == 1 else 1e-8)


@pytest.mark.costly
def test_a_solver_that_ends_off_the_minimum_has_not_converged() -> None:
    gross = NOISY + np.eye(RAYS, 2) * 2000.0
    assert forward_intersection(SENSOR, SHOTS, gross, sigma=0.5).ok
    found = forward_intersection(SENSOR, SHOTS, gross, sigma=0.5, solver=IMPATIENT)
    assert found.status == Status.not_converged
    for numbers in (found.p_ecef, found.cov_enu, found.residuals, found.chi_square, found.position.height):
        assert np.all(np.isnan(numbers))


@pytest.mark.parametrize("name", ROWS)
def test_a_resection_by_any_solver_is_ours(name: str) -> None:
    block, _ = alone()
    camera, uv, places = simulated().sensor.camera, block.observations.uv, block.control.place
    centre, R = resect_image(camera, uv, places)
    by_solver = resect_image(camera, uv, places, solver=SOLVERS[name])
    np.testing.assert_allclose(by_solver[0], centre, rtol=0.0, atol=1e-5)  # m: SciPy stops at 1e-8 of the distance
    np.testing.assert_allclose(by_solver[1], R, rtol=0.0, atol=1e-8)


@pytest.mark.costly
def test_a_resection_whose_solver_cannot_converge_has_no_orientation() -> None:
    block, _ = alone()
    uv = block.observations.uv + np.random.default_rng(0).normal(0.0, 2.0, block.observations.uv.shape)
    hopeless = optx.GradientDescent(1e-6, **TIGHT)  # content with steps that lead nowhere
    with pytest.raises(ValueError, match="no start converged"):
        resect_image(simulated().sensor.camera, uv, block.control.place, solver=hopeless)


@pytest.mark.parametrize("solver", ["lm", optx.LevenbergMarquardt, optx.Newton(**TIGHT), 1e-9])
def test_what_is_no_least_squares_solver_is_refused(solver: Any) -> None:
    with pytest.raises(TypeError, match="solver must be an optimistix least-squares solver"):
        forward_intersection(SENSOR, SHOTS, UVS, sigma=0.5, solver=solver)
    block, _ = alone()
    with pytest.raises(TypeError, match="solver must be an optimistix least-squares solver"):
        resect_image(simulated().sensor.camera, block.observations.uv, block.control.place, solver=solver)
