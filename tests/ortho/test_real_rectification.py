"""Real frames on real ground: against orthophotos of others, and oblique views of a village against each other."""

from __future__ import annotations

import pathlib
from typing import NamedTuple

import numpy as np
import pytest
from support.miaoli import Village
from support.ngi import Flight
from support.phase_correlation import Shifts, shifts_of_tiles

from jaxgeo.earth import WGS84
from jaxgeo.ortho.rectification import Rectified, rectify
from jaxgeo.status import Status
from jaxgeo.terrain import Dem

pytestmark = pytest.mark.slow

CELL = 5.0  # m, of the orthophotos
ALIKE = 0.7  # correlation of tiles below which their shift counts as unknown
FINE = 64  # cells of a tile


class Agreement(NamedTuple):
    """Shifts in m of tiles: away from the nadir, where heights move them, and across, where nothing but the camera
    does; and their mean (east, north)."""

    away: np.ndarray
    across: np.ndarray
    mean: np.ndarray

    def figures(self) -> list[float]:
        """Median and 95 % quantile of the shifts, then of the part across."""
        both = np.hypot(self.away, self.across)
        return [float(np.quantile(np.abs(x), q)) for x in (both, self.across) for q in (0.5, 0.95)]


@pytest.fixture(scope="module")
def flight(jaxgeo_test_data: pathlib.Path) -> Flight:
    return Flight.of(jaxgeo_test_data)


def agreement(flight: Flight, frame: str, number: int, side: int = FINE) -> Agreement:
    reference, shot = flight.reference(number), flight.shots[frame]
    found = rectify(flight.sensor, shot, flight.image(frame), flight.terrain, reference.grid, reference.shape)
    known = found.orthoimage.known & np.asarray(reference.known)
    tiles = _shifts(np.asarray(reference.grey()), np.asarray(found.orthoimage.grey()), known, side)
    up, _ = WGS84.normal_and_height(flight.sensor.perspective_centre(shot))
    way = tiles.middle - np.asarray(reference.grid.rowcol(up))[None, :]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    across = tiles.shift[:, 0] * way[:, 1] - tiles.shift[:, 1] * way[:, 0]
    row, col = CELL * tiles.shift.mean(axis=0)
    return Agreement(CELL * np.sum(tiles.shift * way, axis=1), CELL * across, np.array([col, -row]))


def _shifts(a: np.ndarray, b: np.ndarray, known: np.ndarray, side: int) -> Shifts:
    tiles = shifts_of_tiles(a, b, known, side, side // 2)
    return tiles.of(tiles.likeness > ALIKE)


# Which orthophoto was made of which frame shows in the part across: 0.3 and 0.6 m, against 1.3 to 1.7 m for the others,
# since heights that differ move both alike. Away from the nadir they do: the terrain of the orthophotos is another one
# than the 24 m model, by 5 m in the median, up and down over some hundred metres: large tiles take the mean of that.
# (frame, orthophoto, cells on a side of a tile, least tiles, then the bounds of `figures`, m.)
FRAMES = [
    ("05_0182", 1, 256, 20, (1.5, 4.0, 0.6, 2.0)),
    ("05_0184", 2, 256, 20, (1.5, 4.0, 0.8, 2.0)),
    ("05_0182", 1, FINE, 700, (2.0, 7.5, 0.5, 1.3)),
    ("05_0184", 2, FINE, 700, (2.0, 7.5, 0.8, 1.6)),
    ("06_0253", 1, 128, 30, (3.0, 12.0, 1.6, 8.0)),
    ("06_0251", 2, 128, 20, (3.2, 10.0, 1.6, 8.0)),
    ("06_0253", 1, FINE, 200, (3.0, 15.0, 1.6, 10.0)),
    ("06_0251", 2, FINE, 150, (3.2, 12.0, 1.2, 10.0)),
]


@pytest.mark.parametrize("frame, number, side, count, bounds", FRAMES)
def test_frames_lie_on_the_orthophotos(
    flight: Flight, frame: str, number: int, side: int, count: int, bounds: tuple[float, ...]
) -> None:
    found = agreement(flight, frame, number, side)
    print(frame, number, side, len(found.away), found.figures(), found.mean)
    assert len(found.away) > count
    assert np.all(np.array(found.figures()) < bounds)
    assert np.all(np.abs(found.mean) < (1.0, 2.8))  # m: where tiles lie, on slopes that look one way, sways it


def test_the_ground_s_height_and_not_the_camera_is_what_differs(flight: Flight) -> None:
    """With another 10 m under the frame the shifts go away from the nadir, and none across."""
    found = agreement(flight, *FRAMES[0][:2])
    lower = Flight(flight.folder, flight.sensor, flight.shots, _lowered(flight, 10.0))
    moved = agreement(lower, *FRAMES[0][:2])
    assert np.median(moved.away) - np.median(found.away) > 2.0
    assert moved.figures()[2] < 0.6


def _lowered(flight: Flight, by: float) -> Dem:
    """The terrain so many m lower."""
    heights = np.where(np.asarray(flight.terrain.void), np.nan, np.asarray(flight.terrain.posts) - by)
    return Dem.from_array(heights, flight.terrain.grid, extent=flight.terrain.extent)


# A village from two sides.

PAIR = ("100_0005_0140", "100_0005_0142")
PIXEL = 0.2  # m


@pytest.fixture(scope="module")
def village(jaxgeo_test_data: pathlib.Path) -> dict[str, tuple[Rectified, Rectified]]:
    """Of each frame: with hidden ground left out, and with what hides it."""
    scene = Village.of(jaxgeo_test_data)
    grid, shape = scene.grid().window(448, 96), (480, 896)
    return {
        frame: tuple(  # pyright: ignore[reportReturnType]
            rectify(scene.sensor, shot, scene.image(frame), scene.terrain, grid, shape, mask_hidden=mask)
            for mask in (True, False)
        )
        for frame, shot in ((frame, scene.shots[frame]) for frame in PAIR)
    }


def test_what_two_oblique_views_see_is_the_same_and_what_is_hidden_is_not(village: dict) -> None:
    """Ground that both see agrees to a third of a cell, a twelfth of the surface model's spacing; what one of them does
    not see shows roofs and trees there instead."""
    (a, a_all), (b, b_all) = village[PAIR[0]], village[PAIR[1]]
    grey = [np.asarray(x.orthoimage.values, float).mean(axis=0) for x in (a_all, b_all)]
    seen = a.orthoimage.known & b.orthoimage.known
    shown = a_all.orthoimage.known & b_all.orthoimage.known
    hides = (a.status == Status.hidden_by_terrain) | (b.status == Status.hidden_by_terrain)
    with_mask, without = (shifts_of_tiles(grey[0], grey[1], known, 32, 16) for known in (seen, shown))
    off = [PIXEL * np.linalg.norm(x.shift, axis=1) for x in (with_mask, without)]
    alike = [float(np.corrcoef(*(x[cells] for x in grey))[0, 1]) for cells in (seen, shown & hides)]
    print(len(off[0]), len(off[1]), [np.quantile(x, (0.5, 0.95)) for x in off], alike)
    print([float(np.median(x.likeness)) for x in (with_mask, without)])
    assert len(off[0]) > 50
    assert np.median(off[0]) < 0.1
    assert np.quantile(off[0], 0.95) < 0.4
    assert np.quantile(off[1], 0.95) > 2.0 * np.quantile(off[0], 0.95)
    assert alike[0] > 0.9
    assert alike[1] < 0.8
    for frame in (a, b):
        assert np.all(frame.orthoimage.values[:, ~frame.orthoimage.known] == 0)
        assert not np.any(frame.orthoimage.known & (frame.status != Status.hit))
