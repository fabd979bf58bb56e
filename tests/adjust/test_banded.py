"""Long blocks in slabs: factors and inverses against dense ones, and the same adjustment either way."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import threadpoolctl

from jaxgeo import FrameCamera
from jaxgeo._blas_threads import one_thread
from jaxgeo.adjust import (
    Adjustment,
    Block,
    Cartesian,
    DeficientBlock,
    Fixed,
    Free,
    GroundPoints,
    ImagePoints,
    Images,
    InnerConstraints,
    Prior,
    Unknowns,
    adjust,
    banded,
    reliability,
)
from jaxgeo.adjust import layout as layouts
from jaxgeo.adjust.banded import Tridiagonal, band_of, factored, one_slab, selected_inverse
from jaxgeo.adjust.measurements import image_residuals
from jaxgeo.adjust.problem import prepared

STRIPS, EACH = 2, 14


@pytest.mark.costly
@pytest.mark.parametrize("slabs, m, s", [(1, 6, 2), (4, 3, 0), (5, 4, 3)])
def test_factors_and_inverses_are_those_of_the_whole_matrix(slabs: int, m: int, s: int) -> None:
    matrix, whole = tridiagonal(slabs, m, s)
    right, inverse = np.random.default_rng(1).normal(size=(slabs * m + s, 2)), np.linalg.inv(whole)

    @jax.jit
    def solved(matrix: Tridiagonal, *right: Any) -> Any:
        factor = factored(matrix)
        return factor.solve(*right), selected_inverse(factor)

    sides = jnp.asarray(right[: slabs * m].reshape(slabs, m, 2)), jnp.asarray(right[slabs * m :])
    (found, shared), selected = solved(matrix, *sides)
    both = np.concatenate([np.asarray(found).reshape(-1, 2), shared])
    np.testing.assert_allclose(both, inverse @ right, rtol=0.0, atol=1e-12 * np.abs(inverse).max())
    chosen, there = dense_of(selected), dense_of(ones(matrix)) > 0.0
    np.testing.assert_allclose(chosen[there], inverse[there], rtol=0.0, atol=1e-12 * np.abs(inverse).max())


@pytest.mark.parametrize("slabs", [1, 4])
def test_what_is_not_definite_has_no_factor(slabs: int) -> None:
    matrix, _ = tridiagonal(slabs, 3, 1)
    broken = Tridiagonal(matrix.diagonal.at[-1, 0, 0].set(0.0), matrix.below, matrix.border, matrix.corner)
    assert not np.all(np.isfinite(jax.jit(lambda matrix: factored(matrix).own)(broken)))


def test_images_that_share_a_point_are_in_neighbouring_slabs() -> None:
    rng = np.random.default_rng(0)
    n, width = 40, 3
    first = rng.integers(0, n - width, 400)
    order = rng.permutation(n)  # a strip whose images are named in any order
    image = order[np.stack([first, first + rng.integers(1, width + 1, 400)], axis=1).ravel()]
    point = np.repeat(np.arange(400), 2)
    band = band_of(image, point, n)
    slab = np.asarray(band.place) // band.size
    assert sorted(np.asarray(band.place)) == list(range(n))
    assert band.slabs == -(-n // band.size)
    assert band.size <= width + 1
    assert np.all(np.abs(slab[image[::2]] - slab[image[1::2]]) <= 1)
    x = jnp.asarray(rng.normal(size=(n, 2, 3)))
    np.testing.assert_array_equal(band.of_images(band.to_slabs(x)), x)


def test_images_all_tied_together_are_one_slab() -> None:
    image, point = (x.ravel() for x in np.meshgrid(np.arange(9), np.arange(20)))
    band = band_of(image, point, 9)
    assert (band.slabs, band.size) == (1, 9)
    np.testing.assert_array_equal(band.place, one_slab(9).place)


@pytest.mark.slow
@pytest.mark.parametrize("held", ["by control", "hardly", "not at all", "each camera"])
def test_an_adjustment_in_slabs_is_that_of_the_whole(held: str, monkeypatch: pytest.MonkeyPatch) -> None:
    block, unknowns, datum = flight(held)
    dense = adjust(block, unknowns, datum=datum)
    with monkeypatch.context() as patch:
        patch.setattr(layouts, "DENSE_COLUMNS", 0)
        patch.setattr(layouts, "POINTS", (5,))
        long = adjust(block, unknowns, datum=datum)
    band = long.prepared.problem.layout.band
    assert dense.prepared.problem.layout.band.slabs == 1
    assert band.slabs >= banded.LEAST_SLABS
    assert long.cost == pytest.approx(dense.cost, rel=1e-9)
    np.testing.assert_allclose(long.images.centre, dense.images.centre, rtol=0.0, atol=1e-5)  # m
    assert_alike(long, dense)
    np.testing.assert_allclose(reliability(long).redundancy, reliability(dense).redundancy, rtol=0.0, atol=1e-7)
    for one, other in zip(long.weak_directions(2), dense.weak_directions(2), strict=True):
        assert one.strength == pytest.approx(other.strength, rel=1e-5, abs=1e-13)
        if one.strength > 1e-9:  # any of those that nothing holds is as good as another
            assert next(iter(one.parts)) == next(iter(other.parts))


def test_where_nothing_is_measured_nothing_is_computed() -> None:
    problem = prepared(*flight("by control")[:2]).problem
    first, layout = np.asarray(problem.layout.image) == 0, problem.layout
    unseen = int(np.setdiff1d(np.asarray(layout.row), np.asarray(layout.row)[first])[0])
    beside = problem.start.centre[0] + 100.0 * problem.start.R_frame_from_camera[0, :, 0]  # in its focal plane
    values = eqx.tree_at(lambda v: v.points, problem.start, problem.start.points.at[unseen].set(beside))
    empty = np.asarray(layout.information)[:, 0] == 0.0
    assert np.any(empty)
    residuals = np.asarray(eqx.filter_jit(image_residuals)(problem, values))
    np.testing.assert_array_equal(residuals[:, empty], 0.0)


@pytest.mark.slow
def test_a_long_block_that_is_not_held_is_refused() -> None:
    held, _, _ = flight("by control", each=350)
    seen, points = held.observations, held.control.place[:, 1] < 200.0
    first = np.char.startswith(seen.image, "i") & (np.array([int(name[1:]) for name in seen.image]) < 350)
    apart = ImagePoints(seen.image, np.where(first, seen.point, np.char.add("x", seen.point)), seen.uv, 0.3)
    names, count = np.unique(apart.point, return_counts=True)
    control = held.control.of(held.control.name[points])
    apart = apart.of(np.isin(apart.point, np.concatenate([names[count > 1], control.name])))
    with pytest.raises(DeficientBlock, match="No point joins the 2 parts of the block"):
        adjust(replace(held, observations=apart, control=control))


def test_threads_are_as_many_as_before_when_the_last_is_out() -> None:
    def threads() -> list[int]:
        return [library["num_threads"] for library in threadpoolctl.threadpool_info() if library["user_api"] == "blas"]

    with one_thread():
        pass
    before, one, other = threads(), one_thread(), one_thread()
    one.__enter__()
    other.__enter__()
    one.__exit__(None, None, None)
    assert threads() == [1] * len(before)
    other.__exit__(None, None, None)
    assert threads() == before


def assert_alike(one: Adjustment, other: Adjustment) -> None:
    """Assert the same covariances of images, points and parameters."""
    scale = np.sqrt(np.maximum(np.diagonal(other.covariance), 1e-300))
    scale = np.outer(scale, scale)
    np.testing.assert_allclose(one.covariance / scale, other.covariance / scale, rtol=0.0, atol=1e-6)
    n, c = one.prepared.problem.n, one.prepared.problem.of_image
    at = np.arange(n)[:, None] * c + np.arange(6)[None, :]
    own = one.covariance[at[:, :, None], at[:, None, :]]
    np.testing.assert_allclose(one.covariance_of_images, own, rtol=1e-6, atol=1e-6 * np.abs(own).max(axis=0).min())
    largest = np.abs(other.points.covariance).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(one.points.covariance / largest, other.points.covariance / largest, rtol=0.0, atol=1e-6)
    for mine, its in zip(one.parameters, other.parameters, strict=True):
        assert (mine.whose, mine.name) == (its.whose, its.name)
        assert mine.sigma == pytest.approx(its.sigma, rel=1e-6)
    np.testing.assert_allclose(one.correlations, other.correlations, rtol=0.0, atol=1e-6)


def flight(held: str, each: int = EACH) -> tuple[Block, Unknowns, InnerConstraints | None]:
    """Long strips of vertical images, 60 % along and 30 % across, with noise, held by control or not."""
    rng = np.random.default_rng(7)
    along, row = np.meshgrid(np.arange(each), np.arange(STRIPS))
    centres = np.stack([along.ravel() * 320.0, row.ravel() * 560.0, 1000.0 + rng.normal(0.0, 5.0, along.size)], axis=1)
    points = rng.uniform([-300.0, -300.0, -30.0], [each * 320.0, STRIPS * 560.0 - 200.0, 30.0], (220 * each // EACH, 3))
    R = np.diag([1.0, -1.0, -1.0])
    d = (points[None] - centres[:, None]) @ R  # R' for each
    uv = 1000.0 * d[..., :2] / d[..., 2:]
    seen = np.all(np.abs(uv) < 400.0, axis=2)
    seen &= seen.sum(axis=0) >= 2
    image, point = np.nonzero(seen)
    names = np.array([f"i{i:03d}" for i in range(len(centres))])
    of_points = np.array([f"p{i:04d}" for i in range(len(points))])
    own = held == "each camera"
    camera = FrameCamera.from_pixels(focal_px=1000.0, width=1000, height=1000, principal_px=(0.0, 0.0))
    cameras = {f"c{i:02d}": camera for i in range(len(centres))} if own else {"camera": camera}
    images = Images(
        names,
        np.array(list(cameras)) if own else np.full(len(names), "camera"),
        centres + rng.normal(0.0, 0.5, centres.shape),
        np.broadcast_to(R, (len(centres), 3, 3)),
    )
    measured = uv[image, point] + rng.normal(0.0, 0.3, (len(image), 2))
    observations = ImagePoints(names[image], of_points[point], measured, 0.3)
    free, everything = InnerConstraints(), {"cameras": cameras, "images": images, "observations": observations}
    if held == "not at all":
        start = GroundPoints(of_points[np.unique(point)], points[np.unique(point)])
        return Block(Cartesian(), **everything, points=start), Unknowns(), free
    chosen = np.unique(point)[::6]
    control = GroundPoints(of_points[chosen], points[chosen], 1000.0 if held == "hardly" else 0.05)
    # Over ground as level as this a focal length follows from control alone.
    unknowns = Unknowns(
        focal=Prior(2.0) if own or held == "hardly" else Free(), principal=Fixed() if own else Prior(1.0)
    )
    return Block(Cartesian(), **everything, control=control), unknowns, None


def tridiagonal(slabs: int, m: int, s: int) -> tuple[Tridiagonal, np.ndarray]:
    """A definite matrix of that form, and the same as one array."""
    rng = np.random.default_rng(0)
    J = np.zeros((slabs, 6 * m, slabs * m + s))  # rows that know two neighbouring slabs and what all share
    for k in range(slabs):
        J[k, :, k * m : (k + 2) * m] = rng.normal(size=J[k, :, k * m : (k + 2) * m].shape)
        J[k, :, slabs * m :] = rng.normal(size=(6 * m, s))
    J = J.reshape(-1, slabs * m + s)
    whole = J.T @ J
    blocks = whole[: slabs * m, : slabs * m].reshape(slabs, m, slabs, m)
    each = np.arange(slabs)
    parts: list[Any] = [blocks[each, :, each], blocks[each[1:], :, each[:-1]]]
    parts += [whole[: slabs * m, slabs * m :].reshape(slabs, m, s), whole[slabs * m :, slabs * m :]]
    return Tridiagonal(*(jnp.asarray(x) for x in parts)), whole


def dense_of(matrix: Tridiagonal) -> np.ndarray:
    """As one array, zero where there are no blocks."""
    slabs, m, s = matrix.border.shape
    whole = np.zeros((slabs * m + s, slabs * m + s))
    for k in range(slabs):
        own = slice(k * m, (k + 1) * m)
        whole[own, own], whole[own, slabs * m :] = matrix.diagonal[k], matrix.border[k]
        whole[slabs * m :, own] = matrix.border[k].T
        if k:
            before = slice((k - 1) * m, k * m)
            whole[own, before], whole[before, own] = matrix.below[k - 1], matrix.below[k - 1].T
    whole[slabs * m :, slabs * m :] = matrix.corner
    return whole


def ones(matrix: Tridiagonal) -> Tridiagonal:
    """Ones where a matrix has blocks."""
    return Tridiagonal(*(jnp.ones_like(x) for x in (matrix.diagonal, matrix.below, matrix.border, matrix.corner)))
