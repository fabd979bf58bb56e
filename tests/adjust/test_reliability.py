"""Blunders: that they are found and named, what robust losses leave of them, and what nothing checks."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

from jaxgeo.adjust import (
    Adjustment,
    Block,
    Cauchy,
    GroundPoints,
    Huber,
    ImagePoints,
    NotConverged,
    Solver,
    Tukey,
    adjust,
    blunders,
    reliability,
    screen,
    screening,
    without_blunders,
)
from jaxgeo.adjust.problem import prepared
from tests.support.simulated_block import CONTROL, SIGMA_UV, disturbed, simulated

BLUNDER = np.array([8.0, -6.0])  # px: ten of them


@pytest.fixture(scope="module")
def good() -> Adjustment:
    """A good block."""
    return adjust(simulated().noisy(8).block())


def often_seen(block: Block, least: int = 5) -> int:
    """The row of a measurement of a point that many images see, near the middle of the list."""
    seen = block.observations
    counts = {name: int(np.sum(seen.point == name)) for name in np.unique(seen.point).tolist()}
    rows = [i for i, name in enumerate(seen.point.tolist()) if counts[name] >= least]
    return rows[len(rows) // 2]


def with_blunder(block: Block, row: int, error: np.ndarray = BLUNDER) -> Block:
    """The block with an error in one of its measurements."""
    seen = block.observations
    uv = seen.uv.copy()
    uv[row] += error
    return replace(block, observations=ImagePoints(seen.image, seen.point, uv, seen.sigma))


@pytest.mark.slow
def test_a_good_block_has_as_many_suspects_as_chance_lets_be(good: Adjustment) -> None:
    k = len(good.block.observations)
    assert len(blunders(good, alpha=1e-6)) == 0
    assert 0.02 * k < len(blunders(good, alpha=0.1)) < 0.18 * k
    found = reliability(good)
    checked = found.redundancy > 0.1
    assert np.std(found.standardised[checked]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.costly
def test_a_blunder_is_named_first_and_its_size_told(good: Adjustment) -> None:
    row = often_seen(good.block)
    block = with_blunder(good.block, row)
    found = blunders(adjust(block))
    seen = block.observations
    assert (found[0].image, found[0].point, found[0].row) == (seen.image[row], seen.point[row], row)
    assert f"point {seen.point[row]} in image {seen.image[row]} (row {row})" in str(found[0])
    left = reliability(good).redundancy[row]
    noise = np.abs(np.asarray(found[0].error) - BLUNDER)
    assert np.all(noise < 3.0 * SIGMA_UV / np.sqrt(left) + 0.05)
    assert [b.standardised for b in found] == sorted((b.standardised for b in found), reverse=True)


@pytest.mark.slow
def test_without_the_blunder_the_block_is_as_good_as_ever(good: Adjustment) -> None:
    row, told = often_seen(good.block), []
    block = with_blunder(good.block, row)
    cleaned, out = without_blunders(block, alpha=1e-5, callback=told.append)
    assert [(b.image, b.point, b.row) for b in out] == [
        (block.observations.image[row], block.observations.point[row], row)
    ]
    assert told == out
    assert len(cleaned.block.observations) == len(block.observations) - 1
    sigma = np.sqrt(np.diagonal(good.covariance_of_images, axis1=1, axis2=2))[:, :3]
    assert np.abs((cleaned.images.centre - good.images.centre) / sigma).max() < 1.0
    assert cleaned.sigma0 == pytest.approx(good.sigma0, abs=0.02)


@pytest.mark.costly
def test_without_a_measurement_a_block_keeps_its_shape(good: Adjustment) -> None:
    keep = np.ones(len(good.block.observations), bool)
    keep[often_seen(good.block)] = False  # so nothing is compiled anew for what is left
    less = prepared(good.block.of(keep), good.unknowns).problem
    shapes = [jax.tree.map(lambda x: (x.shape, x.dtype), problem) for problem in (good.prepared.problem, less)]
    assert jax.tree.structure(good.prepared.problem) == jax.tree.structure(less)
    assert jax.tree.leaves(shapes[0]) == jax.tree.leaves(shapes[1])


@pytest.mark.slow
def test_rows_of_several_blunders_are_those_of_the_block_given(good: Adjustment) -> None:
    block, seen = good.block, good.block.observations
    names, counts = np.unique(seen.point, return_counts=True)
    often = [name for name in names[np.argsort(-counts, kind="stable")] if name not in CONTROL][:3]
    # Each in an image of its own: along the rows a point of few rays may take an error for its height.
    rows = sorted(int(np.flatnonzero(seen.point == name)[i]) for i, name in enumerate(often))
    for size, row in zip((20.0, 15.0, 10.0), rows, strict=True):
        block = with_blunder(block, row, np.array([0.0, size]))
    _, out = without_blunders(block, alpha=1e-5)
    assert sorted(b.row for b in out) == rows
    with pytest.warns(RuntimeWarning, match="1 blunders are taken out, as many as most=1 allows, and more are left"):
        _, some = without_blunders(block, alpha=1e-5, most=1)
    assert [b.row for b in some] == [out[0].row]
    assert all(b.image == block.observations.image[b.row] for b in out)
    assert all(b.point == block.observations.point[b.row] for b in out)


@pytest.mark.costly
@pytest.mark.parametrize(
    "loss", [Huber(), pytest.param(Cauchy(), marks=pytest.mark.slow), pytest.param(Tukey(), marks=pytest.mark.slow)]
)
def test_robust_losses_hardly_feel_a_blunder(good: Adjustment, loss: Any) -> None:
    block = with_blunder(good.block, often_seen(good.block))
    robust, least_squares = adjust(block, loss=loss), adjust(block)
    sigma = np.sqrt(np.diagonal(good.covariance_of_images, axis1=1, axis2=2))[:, :3]
    assert robust.converged
    assert np.abs((robust.images.centre - good.images.centre) / sigma).max() < 1.0
    moved = np.linalg.norm(robust.points.place - good.points.place, axis=1)
    assert np.max(moved / np.linalg.norm(good.points.sigma, axis=1)) < 1.0
    assert robust.sigma0 < 0.9 * least_squares.sigma0
    found = blunders(robust)[0]
    assert (found.image, found.point) == (
        block.observations.image[often_seen(block)],
        block.observations.point[often_seen(block)],
    )


@pytest.mark.costly
def test_what_an_error_shows_of_itself_is_its_redundancy_number(good: Adjustment) -> None:
    row, size = often_seen(good.block), 0.05
    moved = adjust(with_blunder(good.block, row, np.array([size, 0.0])))
    shown = -(moved.residuals[row] - good.residuals[row]) / size
    assert shown[0] == pytest.approx(reliability(good).redundancy[row, 0], abs=1e-3)


@pytest.mark.costly
def test_least_errors_that_are_found_grow_where_less_is_checked(good: Adjustment) -> None:
    found = reliability(good, alpha=0.001)
    assert found.critical == pytest.approx(3.2905, abs=1e-4)
    checked = found.redundancy > 1e-3
    expected = (3.2905 + 0.8416) * SIGMA_UV / np.sqrt(found.redundancy[checked])
    np.testing.assert_allclose(found.detectable[checked], expected, rtol=1e-4)
    assert np.all(np.isfinite(found.detectable) == (found.redundancy > 1e-6))
    assert np.all(np.isnan(found.standardised) == (found.redundancy <= 1e-6))


@pytest.mark.costly
def test_along_the_epipolar_line_nothing_checks_a_point_of_two_rays(good: Adjustment) -> None:
    seen = good.block.observations
    names, counts = np.unique(seen.point, return_counts=True)
    pair = [n for n in names[counts == 2].tolist() if n not in good.block.control.name]
    rows = np.isin(seen.point, pair)
    assert np.all(reliability(good).redundancy[rows].sum(axis=1) < 1.0)
    for name in pair:  # two rays leave one condition
        assert reliability(good).redundancy[seen.point == name].sum() < 1.0 + 1e-9


def with_control_off(block: Block, row: int, error: Any) -> Block:
    """The block with an error in the coordinates of one control point, m."""
    place = block.control.place.copy()
    place[row] += error
    return replace(block, control=GroundPoints(block.control.name, place, block.control.sigma))


@pytest.mark.costly
def test_control_that_is_far_off_is_set_aside_and_the_rest_adjusted(good: Adjustment) -> None:
    with pytest.warns(RuntimeWarning, match=f"set aside before the first iteration: control point {CONTROL[2]}"):
        found = adjust(with_control_off(good.block, 2, [2000.0, 0.0, 0.0]))
    assert [(one.kind, one.point) for one in found.screened] == [("control point", CONTROL[2])]
    assert CONTROL[2] not in found.block.control.name
    assert f"control point {CONTROL[2]} (row 2): it lies 2000 m" in found.summary()
    expected = adjust(replace(good.block, control=good.block.control.without([CONTROL[2]])))
    assert (found.redundancy, found.observations) == (expected.redundancy, expected.observations)
    np.testing.assert_allclose(found.images.centre, expected.images.centre, atol=1e-6)  # m
    np.testing.assert_allclose(found.points.sigma, expected.points.sigma, atol=1e-6)  # m
    np.testing.assert_allclose(found.residuals, expected.residuals, atol=1e-5)  # px


@pytest.mark.costly
def test_image_points_that_are_far_off_are_set_aside_with_the_points_that_nothing_else_sees(good: Adjustment) -> None:
    seen = good.block.observations
    names, counts = np.unique(seen.point, return_counts=True)
    pair = next(name for name in names[counts == 2].tolist() if name not in CONTROL)
    block = with_blunder(good.block, int(np.flatnonzero(seen.point == pair)[0]), np.array([900.0, 400.0]))
    with pytest.warns(RuntimeWarning, match=f"image point {pair} in image .* miss each other by"):
        found = adjust(block)
    assert pair not in found.places
    expected = adjust(good.block.of(seen.point != pair))
    assert (found.redundancy, found.unknown_count) == (expected.redundancy, expected.unknown_count)
    np.testing.assert_allclose(found.images.centre, expected.images.centre, atol=1e-6)  # m
    assert found.sigma0 == pytest.approx(expected.sigma0, abs=1e-6)


@pytest.mark.costly
def test_an_error_of_control_is_named_as_that_and_not_as_that_of_its_rays(good: Adjustment) -> None:
    off = np.array([0.4, -0.3, 0.2])
    found = blunders(adjust(with_control_off(good.block, 3, off)))
    assert (found[0].kind, found[0].point, found[0].row, found[0].image) == ("control point", CONTROL[3], 3, "")
    np.testing.assert_allclose(found[0].error, off, atol=0.3)
    assert str(found[0]).startswith(f"control point {CONTROL[3]} (row 3): standardised residual")
    assert str(found[0]).endswith(" m")


@pytest.mark.costly
def test_control_is_tested_by_its_own_redundancy(good: Adjustment) -> None:
    rng, fails = np.random.default_rng(0), 0
    for seed in range(4):
        of = simulated().noisy(seed)
        block = of.block()
        place = block.control.place + rng.normal(0.0, 0.02, block.control.place.shape)
        block = replace(block, control=GroundPoints(block.control.name, place, 0.02))
        fails += sum(one.kind == "control point" for one in blunders(adjust(block), alpha=0.2))
    assert 1 <= fails <= 12  # of 24 with 0.2 each


@pytest.mark.slow
def test_a_run_without_end_from_poor_starts_says_so_first() -> None:
    block = replace(disturbed(simulated().block(), 50.0, 0.2), navigation=None)
    with pytest.raises(NotConverged, match=r"the last step predicted .* The orientations that it starts from are poor"):
        adjust(block, solver=Solver(max_iterations=1))


@pytest.mark.slow
def test_a_run_without_end_tells_what_stands_out(good: Adjustment) -> None:
    block = with_control_off(good.block, 2, [900.0, 0.0, 0.0])
    with pytest.raises(NotConverged) as caught:
        adjust(block, solver=Solver(max_iterations=2), screen=None)
    error = caught.value
    assert len(error.log) == 3
    assert error.screened == ()
    assert error.diagnosis.suspects[0].point == CONTROL[2]
    assert CONTROL[2] in {one.point for one in error.diagnosis.largest}
    assert [one.sigmas for one in error.diagnosis.largest] == sorted(
        (one.sigmas for one in error.diagnosis.largest), reverse=True
    )
    assert {one.image for one in error.diagnosis.moved} <= set(block.images.name.tolist())
    assert f"Check control point {CONTROL[2]} first: its coordinates, its name, and the zone" in str(error)
    assert "without_blunders(block) leaves out what disagrees" in str(error)
    cleaned, out = without_blunders(block, alpha=1e-6)  # as the message says
    assert cleaned.converged
    assert [(b.kind, b.point) for b in out] == [("control point", CONTROL[2])]


@pytest.mark.slow
def test_good_measurements_that_a_strict_screening_sets_aside_are_taken_back(
    good: Adjustment, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(screening, "TIMES", 0.0)
    assert len(screen(good.block, sigmas=2.0).aside) > 10
    found, out = without_blunders(good.block, alpha=1e-6, screen=2.0)
    assert out == []
    assert found.screened == ()
    assert len(found.block.observations) == len(good.block.observations)
    np.testing.assert_allclose(found.images.centre, good.images.centre, atol=1e-5)  # m


@pytest.mark.slow
def test_blunders_of_every_kind_together_are_named(good: Adjustment) -> None:
    row = often_seen(good.block)
    block = with_control_off(with_blunder(good.block, row, np.array([5000.0, -3000.0])), 4, [0.0, 0.0, 1500.0])
    found, out = without_blunders(block, alpha=1e-6)
    assert {(b.kind, b.row) for b in out} == {("image point", row), ("control point", 4)}
    by_kind = {b.kind: b for b in out}
    np.testing.assert_allclose(by_kind["image point"].error, [5000.0, -3000.0], atol=4.0)
    np.testing.assert_allclose(by_kind["control point"].error, [0.0, 0.0, 1500.0], atol=0.5)
    assert found.sigma0 == pytest.approx(good.sigma0, abs=0.03)
