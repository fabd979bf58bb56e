"""What decides whether a block is determined is the form of its observations, not how little some weigh."""

from __future__ import annotations

import itertools
from dataclasses import replace
from functools import cache
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from jaxgeo.adjust import (
    Adjustment,
    Block,
    DeficientBlock,
    Fixed,
    Free,
    GroundPoints,
    Huber,
    ImagePoints,
    Images,
    InnerConstraints,
    Prior,
    Unknowns,
    adjust,
    reliability,
    resect_image,
)
from tests.support.dense_block import dense
from tests.support.rigorous import Rigorous, by_triangles
from tests.support.simulated_block import CONTROL, LENS, disturbed, simulated

pytestmark = pytest.mark.costly

CONTROL_SIGMAS = (1e-3, 0.1, 3.0, 100.0, 1000.0)  # m
PIXEL_SIGMAS = (0.01, 0.5, 10.0)  # px
ALL = list(itertools.product(CONTROL_SIGMAS, PIXEL_SIGMAS))
CORNERS = list(itertools.product(CONTROL_SIGMAS[::4], PIXEL_SIGMAS[::2]))
CAMERA = np.array([4000.0, 2012.0, 1490.0, LENS.k1, LENS.k2, LENS.p1, LENS.p2])
LARGEST_ERROR = 30.0  # m, of control: errors of the size of the block leave nothing to be adjusted


def measured(block: Block, sigma: float, seed: int = 1) -> Block:
    """The block with pixels of that standard deviation."""
    seen, rng = block.observations, np.random.default_rng(seed)
    uv = simulated().observations.uv if len(seen) == len(simulated().observations) else seen.uv
    return replace(
        block, observations=ImagePoints(seen.image, seen.point, uv + rng.normal(0.0, sigma, uv.shape), sigma)
    )


def on_control(sigma: float, pixels: float, names: tuple[str, ...] = CONTROL) -> Block:
    """The simulated block on control alone, with errors as large as the standard deviations say, started elsewhere."""
    of = simulated()
    true = of.control(names=names).place
    place = true + np.random.default_rng(2).normal(0.0, min(sigma, LARGEST_ERROR), true.shape)
    block = of.block(control=GroundPoints(list(names), place, sigma), sigma_position=np.inf, sigma_attitude=np.inf)
    return measured(disturbed(block), pixels)


def on_navigation(sigma: float, pixels: float, **changes: Any) -> Block:
    """The same on navigation alone, its attitudes as sure as its positions are at 500 m."""
    given = {"control": None, "sigma_position": sigma, "sigma_attitude": sigma / 500.0} | changes
    return measured(disturbed(simulated().block(**given)), pixels)


def assert_rigorous(found: Adjustment, right: Rigorous, within: float) -> None:
    sigma = np.sqrt(np.diagonal(right.images))
    np.testing.assert_allclose(
        found.covariance / np.outer(sigma, sigma), right.images / np.outer(sigma, sigma), rtol=0.0, atol=within
    )
    largest = np.abs(right.points).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(found.points.covariance / largest, right.points / largest, rtol=0.0, atol=within)
    assert right.left < 1e-3  # standard deviations: the iterations came to where the cost is least


def test_the_weakest_control_under_the_best_pixels() -> None:
    found = adjust(on_control(1000.0, 0.01))
    assert_rigorous(found, by_triangles(found, CAMERA, 1000.0), 1e-9)
    assert 300.0 < np.median(found.points.sigma) < 3000.0  # m


@pytest.mark.slow
@pytest.mark.parametrize("sigma, pixels", ALL)
def test_control_of_any_sigma_under_pixels_of_any_sigma(sigma: float, pixels: float) -> None:
    found = adjust(on_control(sigma, pixels))
    assert found.converged
    assert len(found.log) < 30
    assert_rigorous(found, by_triangles(found, CAMERA, sigma), 1e-9)


@cache
def alone() -> tuple[Block, int]:
    """One image whose points are control, and the number of them."""
    of = simulated()
    seen = of.observations.of(of.observations.image == "i07")
    whole = of.block(sigma_position=np.inf, sigma_attitude=np.inf)
    at = whole.images.name == "i07"
    given = whole.images
    images = Images(given.name[at], given.camera[at], given.centre[at], given.R_frame_from_camera[at])
    return replace(
        whole, images=images, observations=seen, navigation=None, control=of.control(names=tuple(seen.point))
    ), len(seen)


@pytest.mark.slow
@pytest.mark.parametrize("sigma, pixels", CORNERS)
def test_one_image_on_control_of_any_sigma(sigma: float, pixels: float) -> None:
    block, _ = alone()
    rng = np.random.default_rng(2)
    place = block.control.place + rng.normal(0.0, min(sigma, LARGEST_ERROR), block.control.place.shape)
    block = replace(block, control=GroundPoints(block.control.name, place, sigma))
    found = adjust(measured(disturbed(block), pixels))
    assert_rigorous(found, by_triangles(found, CAMERA, sigma), 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("sigma, pixels", CORNERS)
def test_navigation_of_any_sigma_under_pixels_of_any_sigma(sigma: float, pixels: float) -> None:
    found = adjust(on_navigation(sigma, pixels))
    N = len(found.columns)
    with np.errstate(divide="ignore"):
        right = right_by_triangles(found)
    sigmas = np.sqrt(np.diagonal(right))[:N]
    np.testing.assert_allclose(
        found.covariance / np.outer(sigmas, sigmas), right[:N, :N] / np.outer(sigmas, sigmas), rtol=0.0, atol=1e-8
    )
    assert np.all(reliability(found).redundancy >= -1e-9)


def right_by_triangles(found: Adjustment) -> np.ndarray:
    """Covariance of all unknowns by triangles of the Jacobian, which is by autodiff."""
    import scipy.linalg

    oracle = dense(found)
    J = oracle.jacobian[np.argsort(-np.linalg.norm(oracle.jacobian, axis=1))]
    scale = 1.0 / np.linalg.norm(J, axis=0)
    _, r, pivots = scipy.linalg.qr(J * scale[None], mode="economic", pivoting=True)
    inverse = scipy.linalg.solve_triangular(r, np.eye(len(r)))
    covariance = np.zeros_like(inverse)
    covariance[np.ix_(pivots, pivots)] = inverse @ inverse.T
    whole = np.zeros_like(oracle.covariance)
    whole[np.ix_(oracle.free, oracle.free)] = covariance * np.outer(scale, scale)
    return whole


FREE = {  # what is left free, whatever the weights: the block, its unknowns, what is said
    "two points": (lambda s, p: on_control(s, p, CONTROL[:2]), Unknowns(), ["turn about"]),
    "one point": (lambda s, p: on_control(s, p, CONTROL[:1]), Unknowns(), ["turn about", "scale"]),
    "positions without heights": (
        lambda s, p: on_navigation(s, p, sigma_position=[s, s, np.inf], sigma_attitude=np.inf),
        Unknowns(focal=Free()),
        ["shift up"],
    ),
    "attitudes": (
        lambda s, p: on_navigation(s, p, sigma_position=np.inf),
        Unknowns(),
        ["shift east", "shift north", "shift up", "scale"],
    ),
    "strips": (on_navigation, Unknowns(shift=Free()), ["shift", "Fix some of it, or give priors"]),
    "nothing": (
        lambda s, p: on_navigation(s, p, sigma_position=np.inf, sigma_attitude=np.inf),
        Unknowns(),
        ["position, orientation and scale of the whole block"],
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("sigma, pixels", CORNERS)
@pytest.mark.parametrize("kind", list(FREE))
def test_what_is_free_is_named_whatever_the_sigmas(kind: str, sigma: float, pixels: float) -> None:
    block, unknowns, words = FREE[kind]
    with pytest.raises(DeficientBlock) as caught:
        adjust(block(sigma, pixels), unknowns)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("sigma, pixels", CORNERS)
def test_a_point_of_one_ray_needs_something_along_it_whatever_the_sigmas(sigma: float, pixels: float) -> None:
    block = on_control(sigma, pixels)
    keep = np.ones(len(block.observations), bool)
    keep[np.flatnonzero(block.observations.point == "p01")[1:]] = False
    seen, place = block.observations.of(keep), simulated().points.of(["p01"]).place

    def with_known(height: float) -> Block:
        known = np.concatenate([block.control.sigma, [[np.inf, np.inf, height]]])
        places = np.concatenate([block.control.place, place])
        control = GroundPoints([*block.control.name.tolist(), "p01"], places, known)
        return replace(block, observations=seen, control=control, points=simulated().points.of(["p01"]))

    assert np.all(np.isfinite(adjust(with_known(sigma)).points.sigma))
    with pytest.raises(DeficientBlock, match="nothing holds the distance of point p01"):
        adjust(with_known(np.inf))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_a_common_factor_of_all_sigmas_changes_nothing_but_sigmas(factor: float) -> None:
    one, other = on_control(3.0, 0.5), on_control(3.0, 0.5)
    seen = other.observations
    other = replace(
        other,
        observations=ImagePoints(seen.image, seen.point, seen.uv, seen.sigma * factor),
        control=GroundPoints(other.control.name, other.control.place, other.control.sigma * factor),
    )
    first, second = adjust(one), adjust(other)
    np.testing.assert_allclose(second.images.centre, first.images.centre, rtol=0.0, atol=1e-3)  # m
    np.testing.assert_allclose(second.points.sigma, first.points.sigma * factor, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("sigma, pixels", CORNERS[1:3])
def test_a_camera_and_a_mount_on_weak_control(sigma: float, pixels: float) -> None:
    given = on_navigation(sigma, pixels, control=simulated().control(sigma=sigma))
    found = adjust(given, Unknowns(focal=Free(), principal=Free(), boresight=Free(), lever=Prior(10.0 * sigma)))
    right, N = right_by_triangles(found), len(found.columns)
    scale = np.sqrt(np.diagonal(right)[:N])
    np.testing.assert_allclose(
        found.covariance / np.outer(scale, scale), right[:N, :N] / np.outer(scale, scale), rtol=0.0, atol=1e-6
    )


@pytest.mark.slow
def test_a_free_network_that_is_weakly_held_in_part() -> None:
    one = on_control(1.0, 0.01, CONTROL[:2])
    control = GroundPoints(one.control.name, one.control.place, 1000.0)
    found, again = (adjust(block, datum=InnerConstraints()) for block in (replace(one, control=control), one))
    assert found.datum.images.shape[0] == again.datum.images.shape[0] == 1
    np.testing.assert_allclose(found.points.sigma, again.points.sigma * 1000.0, rtol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("pixels", PIXEL_SIGMAS)
def test_points_of_images_that_are_fixed(pixels: float) -> None:
    one = measured(simulated().block(control=None), 0.5)
    seen = one.observations
    other = replace(one, observations=ImagePoints(seen.image, seen.point, seen.uv, pixels))
    found, again = (adjust(block, Unknowns(images=Fixed())) for block in (other, one))
    np.testing.assert_allclose(found.points.sigma, again.points.sigma * pixels / 0.5, rtol=1e-6)


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e3, 1e6])
def test_a_resection_is_the_same_in_any_unit(unit: float) -> None:
    block, count = alone()
    seen, places = block.observations, block.control.place
    centre, R = resect_image(simulated().sensor.camera, seen.uv, places * unit)
    np.testing.assert_allclose(centre, block.images.centre[0] * unit, rtol=0.0, atol=1e-5 * unit)
    np.testing.assert_allclose(R, block.images.R_frame_from_camera[0], rtol=0.0, atol=1e-8)
    line = np.linspace(0.0, 1.0, count)[:, None] * np.array([[400.0, 300.0, 20.0]]) * unit
    with pytest.raises(ValueError, match="lie in one line"):
        resect_image(simulated().sensor.camera, seen.uv, line)


@pytest.mark.slow
def test_a_robust_loss_weighs_weak_control_as_larger_standard_deviations_would() -> None:
    loss, block = Huber(), on_control(100.0, 0.01)
    assert block.control is not None
    place = block.control.place.copy()
    place[1] += [600.0, -400.0, 0.0]
    block = replace(block, control=GroundPoints(block.control.name, place, 100.0))
    robust = adjust(block, loss=loss, screen=None)
    seen = block.observations
    of_points = root(loss, robust.residuals / seen.sigma)
    off = np.array([robust.places[name] for name in block.control.name.tolist()]) - place
    of_control = root(loss, off / 100.0)
    assert of_control.min() < 0.9
    assert of_control.max() == 1.0
    heavier = replace(
        block,
        observations=ImagePoints(seen.image, seen.point, seen.uv, seen.sigma / of_points[:, None]),
        control=GroundPoints(block.control.name, place, 100.0 / of_control[:, None] * np.ones(3)),
    )
    plain = adjust(heavier, screen=None)
    sigma = np.sqrt(np.diagonal(plain.covariance))
    size = np.outer(sigma, sigma)
    np.testing.assert_allclose(robust.covariance / size, plain.covariance / size, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(robust.images.centre, plain.images.centre, rtol=0.0, atol=0.1)


def root(loss: Huber, weighted: np.ndarray) -> np.ndarray:
    """Of the weights that the loss leaves, by weighted residuals (k, ...)."""
    return np.sqrt(np.asarray(loss.weight(jnp.asarray(np.sum(weighted**2, axis=1)))))
