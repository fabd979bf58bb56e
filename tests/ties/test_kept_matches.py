"""Kept matches: read again only if nothing they depend on has changed."""

from __future__ import annotations

import dataclasses
import pathlib

import numpy as np
from support.drone_strip import views_of

from jaxgeo import Pose, Shot
from jaxgeo.ties import KeptMatches, Matching, PairMatches, Views
from jaxgeo.ties.ground import Planes

UV = np.arange(6.0).reshape(3, 2)
PLANES = Planes(np.zeros((3, 3)), np.ones((3, 3)), np.ones((3, 3)), np.ones(3, bool))
FOUND = PairMatches(0, 1, UV, UV + 1.0, 0.0 * UV + 0.1, 0.0 * UV + 0.1, np.ones(3), np.zeros(3, np.int8), 1e-9)


def two_views() -> Views:
    poses = [Pose.from_degrees(lat=lat, lon=11.0, height=250.0, heading=0.0) for lat in (47.0, 47.0004)]
    return views_of(["a", "b"], [Shot(one, np.zeros(0)) for one in poses])


def test_changed_inputs_are_matched_again(tmp_path: pathlib.Path) -> None:
    views, calls, stamps = two_views(), [], {0: "a", 1: "b"}

    def again(uv=UV, how=Matching(), views=views, planes=PLANES) -> int:
        """Number of calls of the matching."""
        before = len(calls)
        kept = KeptMatches(tmp_path, lambda row: stamps[row])
        found = kept.matches(views, (0, 1), uv, planes, how, lambda: calls.append(1) or FOUND)
        assert kept.reused == 1 - (len(calls) - before)
        for one, other in zip(found, FOUND, strict=True):
            assert np.array_equal(one, other)
        return len(calls) - before

    assert again() == 1
    assert again() == 0
    assert again(uv=UV + 0.5) == 1
    assert again(how=Matching(sigma_height=4.0)) == 1
    assert again(planes=PLANES._replace(normal=2.0 * PLANES.normal)) == 1
    assert again(views=dataclasses.replace(views, covariance=2.0 * views.covariance)) == 1
    stamps[1] = "changed"
    assert again() == 1
    assert again() == 0
    for one in tmp_path.glob("pair-*"):
        one.write_bytes(one.read_bytes()[:100])
    assert again() == 1


def test_points_are_kept_by_image_and_count(tmp_path: pathlib.Path) -> None:
    views, kept = two_views(), KeptMatches(tmp_path, lambda row: f"image {row}")
    made = []

    def points(row: int, count: int) -> np.ndarray:
        return kept.points(views, row, count, lambda: (made.append((row, count)) or UV + row, np.arange(3)))[0]

    for row, count in ((0, 50), (1, 50), (0, 50), (0, 60)):
        assert np.array_equal(points(row, count), UV + row)
    assert made == [(0, 50), (1, 50), (0, 60)]
