"""Screening before an adjustment: what cannot be right is named, and a poor start condemns nothing.

Held against blunders that were put in, and for resections against the orientations that made the pixels.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from jaxgeo.adjust import Block, ControlElsewhere, GroundPoints, resect_block, screen
from tests.support.simulated_block import CONTROL, camera, disturbed, simulated


def block_of(seed: int = 8) -> Block:
    return simulated().noisy(seed).block()


def with_control(block: Block, place: np.ndarray) -> Block:
    return replace(block, control=GroundPoints(block.control.name, place, block.control.sigma))


def with_pixels(block: Block, rows: Any, error: Any) -> Block:
    uv = block.observations.uv.copy()
    uv[rows] += error
    return replace(block, observations=replace(block.observations, uv=uv))


def named(block: Block, **options: Any) -> set[tuple[str, str, str]]:
    return {(one.kind, one.image, one.point) for one in screen(block, **options).aside}


@pytest.mark.costly
@pytest.mark.parametrize("metres, radians", [(0.0, 0.0), (1.0, 0.003), (3.0, 0.01), (10.0, 0.05)])
@pytest.mark.parametrize("navigation", [True, False])
def test_a_good_block_is_kept_whole_from_any_start(metres: float, radians: float, navigation: bool) -> None:
    for seed in range(2):
        block = disturbed(block_of(seed), metres, radians, seed)
        found = screen(block if navigation else replace(block, navigation=None))
        assert found.aside == ()
        assert np.all(found.kept.rows)
        assert np.all(found.kept.control)
        assert found.poor == (metres > 0.0)


@pytest.mark.costly
@pytest.mark.parametrize("navigation", [True, False])
@pytest.mark.parametrize("off", [[0.0, 60.0, 0.0], [0.0, 0.0, 500.0], [500_000.0, 0.0, 0.0], [4.5e5, 1.7e4, -1.6e4]])
def test_one_control_point_that_is_off_is_named_with_its_shift(off: list[float], navigation: bool) -> None:
    block = block_of()
    place = block.control.place.copy()
    place[2] += off
    block = with_control(block, place)
    found = screen(block if navigation else replace(block, navigation=None))
    assert [(one.kind, one.point, one.row) for one in found.aside] == [("control point", CONTROL[2], 2)]
    assert found.kept.control.tolist() == [i != 2 for i in range(len(CONTROL))]
    assert found.aside[0].sigmas > 50.0
    assert "5 of 6 control points agree" in str(found.aside[0])
    length = float(str(found.aside[0]).split("lies ")[1].split(" m")[0])
    assert length == pytest.approx(np.linalg.norm(off), abs=2.0)


def test_control_points_that_were_exchanged_are_both_named() -> None:
    block = block_of()
    place = block.control.place.copy()
    place[[0, 3]] = place[[3, 0]]
    expected = {("control point", "", CONTROL[0]), ("control point", "", CONTROL[3])}
    assert named(with_control(block, place)) == expected


@pytest.mark.parametrize("off", [[500_000.0, 0.0, 0.0], [-4.5e5, 1.7e4, -1.6e4]])
def test_control_that_lies_elsewhere_as_a_whole_is_refused_with_its_shift(off: list[float]) -> None:
    block = block_of()
    with pytest.raises(ControlElsewhere, match="another UTM zone, with or without a false easting") as caught:
        screen(with_control(block, block.control.place + off))
    np.testing.assert_allclose(caught.value.shift, off, atol=5.0)  # m


@pytest.mark.parametrize("size", [100.0, 1000.0, 10_000.0])
def test_image_points_that_are_far_off_are_named(size: float) -> None:
    block = block_of()
    seen, rng = block.observations, np.random.default_rng(int(size))
    often = np.flatnonzero(np.bincount(np.unique(seen.point, return_inverse=True)[1]) >= 5)
    points = np.unique(seen.point)[rng.choice(often, 3, replace=False)]
    rows = [int(np.flatnonzero(seen.point == point)[0]) for point in points]
    angle = rng.uniform(0.0, 2.0 * np.pi, 3)
    found = named(with_pixels(block, rows, size * np.stack([np.cos(angle), np.sin(angle)], axis=1)))
    assert found == {("image point", str(seen.image[row]), str(seen.point[row])) for row in rows}


def test_of_two_rays_that_miss_each_other_both_are_named() -> None:
    block = block_of()
    seen = block.observations
    names, counts = np.unique(seen.point, return_counts=True)
    pair = next(name for name in names[counts == 2].tolist() if name not in CONTROL)
    rows = np.flatnonzero(seen.point == pair)
    found = screen(with_pixels(block, rows[:1], [[500.0, 700.0]]))  # along and across the epipolar line
    assert {one.row for one in found.aside} == set(rows.tolist())
    assert "miss each other" in found.aside[0].why
    assert not np.any(found.kept.rows[rows])


def test_a_single_ray_that_misses_its_control_is_named() -> None:
    block = block_of()
    seen = block.observations
    rows = np.flatnonzero(seen.point == CONTROL[1])
    keep = np.ones(len(seen), bool)
    keep[rows[1:]] = False
    block = with_pixels(block.of(keep), [rows[0]], [[800.0, 0.0]])
    assert named(block) == {("image point", str(seen.image[rows[0]]), CONTROL[1])}


@pytest.mark.parametrize("sigmas", [0.0, -1.0, float("nan")])
def test_a_screening_level_is_positive(sigmas: float) -> None:
    with pytest.raises(ValueError, match=r"screen must be a number of standard deviations, or None .*; got"):
        screen(block_of(), sigmas=sigmas)


def test_a_resection_leaves_out_control_that_does_not_fit_and_names_it() -> None:
    of = simulated()
    rows = of.observations.image == "i07"
    names = of.observations.point[rows][:7].tolist()
    control, truth = of.points.of(names), of.centre[7]
    good = resect_block({"c": camera()}, {"i07": "c"}, of.observations, control)
    np.testing.assert_allclose(good.centre[0], truth, atol=1e-3)  # m
    place = control.place.copy()
    place[3] += [300.0, -200.0, 0.0]
    with pytest.warns(RuntimeWarning, match=f"image i07: points {names[3]} do not fit the orientation on which the"):
        found = resect_block({"c": camera()}, {"i07": "c"}, of.observations, GroundPoints(names, place))
    np.testing.assert_allclose(found.centre[0], truth, atol=1e-3)  # m
