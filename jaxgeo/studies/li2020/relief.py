"""Overlap over relief: the second subject that Li et al. (2020) leave to future work.

The paper's camera and flight (near end 74 deg off nadir, 8143 m above the mean ground, 172 m/s) over fractal ground of
several seeds, and over several places of the example terrain with its relief scaled up and down.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # submodules load on first use

from jaxgeo.coverage import VelocityHeight, plan
from jaxgeo.io import example_dem
from jaxgeo.sensor import Pose, Trajectory
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.control import HALF
from jaxgeo.studies.li2020.strips import DURATION, METRES_EAST, METRES_NORTH
from jaxgeo.studies.scenes import fractal_posts
from jaxgeo.terrain import Dem

FRACTAL, EXAMPLE = "fractal", "example terrain"
RELIEF = (50.0, 100.0, 200.0)  # m, standard deviation of the heights
PLACES = 6  # seeds of the fractal ground, or places in the example terrain
APART = 2500.0  # m between such places, across the flight
KNOTS = 61
CONFIDENCE = 0.95


@dataclass(frozen=True)
class Relief:
    """Overlap at the near end over relief, over several places.

    `relief` in m is the standard deviation of the heights; `mean`, `spread` (standard deviation along a flight) and
    `off` (RMS difference from the required overlap) are taken over the places, each with half of its 95 % interval;
    `least` is the overall minimum; `by_height` is the RMS difference that the ground height alone causes for a step
    planned for the mean height, (1 - rho0) times Eq 28; `gaps` is the share of pairs with a gap at the near end, or
    whose near end does not see ground along all of its length.
    """

    ground: str
    relief: float
    timing: str
    pairs: int
    mean: float
    mean_error: float
    spread: float
    spread_error: float
    off: float
    off_error: float
    least: float
    by_height: float
    gaps: float


def reliefs(relief: Sequence[float] = RELIEF, *, places: int = PLACES, seed: int = 0) -> list[Relief]:
    """Results for each ground and relief, timed over the mean height, as in the paper, and over the visible ground.

    `seed` selects other fractal ground; the places in the example terrain stay the same.
    """
    terrain = example_dem()
    posts = np.asarray(terrain.posts)
    level = float(posts.mean())
    timings: dict[str, Any] = {
        "planned height": VelocityHeight(printed.OVERLAP, height=level),
        "velocity-height": VelocityHeight(printed.OVERLAP),
    }
    found = []
    for ground in (FRACTAL, EXAMPLE):
        shapes = [_shape(ground, posts, seed * places + place) for place in range(places)]
        for size in relief:
            grounds = [terrain.with_posts(level + size * shape) for shape in shapes]
            for name, timing in timings.items():
                near = [
                    _near(dem, timing, level, place if ground == EXAMPLE else 0, places)
                    for place, dem in enumerate(grounds)
                ]
                found.append(_summary(ground, size, name, near))
    return found


def _shape(ground: str, posts: np.ndarray, seed: int) -> np.ndarray:
    """Heights of zero mean and unit standard deviation, on the grid of the example terrain."""
    if ground == FRACTAL:
        rows, cols = posts.shape
        posts = fractal_posts(max(rows, cols), spacing=1.0, rms_slope=0.5, seed=seed)[:rows, :cols]
    return (posts - posts.mean()) / posts.std()


def _near(dem: Dem, timing: VelocityHeight, level: float, place: int, places: int) -> np.ndarray:
    """Overlaps at the near end along one flight; NaN where part of the near end sees no ground."""
    across = APART * (place - 0.5 * (places - 1))
    flown = plan(printed.sensor(mirror=False), _flight(level, across), dem, timing, along="rows")
    return np.asarray(flown.overlaps.near)


@functools.cache
def _flight(level: float, across: float) -> Trajectory:
    """Southward flight whose near end passes the centre of the example terrain, `across` m to its east."""
    lat, lon = 36.3029, -84.2458  # deg, centre
    height, speed = printed.TABLE_4[0].height_above_ground, printed.TABLE_4[0].speed_kmh / 3.6
    times = np.linspace(0.0, DURATION, KNOTS)
    east = height * math.tan(math.radians(printed.OFF_NADIR)) + across
    pose = Pose.from_degrees(
        lat=lat - speed * (times - 0.5 * DURATION) / METRES_NORTH,
        lon=np.full(KNOTS, lon + east / (METRES_EAST * math.cos(math.radians(lat)))),
        height=np.full(KNOTS, level + height),
        heading=np.full(KNOTS, 180.0),
    )
    readings = np.radians([printed.OFF_NADIR + HALF, 0.0])
    return Trajectory.from_knots(times, pose, np.tile(readings, (KNOTS, 1)))


def _summary(ground: str, relief: float, timing: str, near: list[np.ndarray]) -> Relief:
    means = np.array([np.nanmean(one) for one in near])
    spreads = np.array([np.nanstd(one) for one in near])
    squares = np.array([np.nanmean((one - printed.OVERLAP) ** 2) for one in near])
    off = math.sqrt(squares.mean())
    everything = np.concatenate(near)
    return Relief(
        ground,
        relief,
        timing,
        len(everything),
        float(means.mean()),
        _half_interval(means),
        float(spreads.mean()),
        _half_interval(spreads),
        off,
        _half_interval(squares) / (2.0 * off),
        float(np.nanmin(everything)),
        (1.0 - printed.OVERLAP) * relief / printed.TABLE_4[0].height_above_ground,
        float(np.mean(~(everything >= 0.0))),
    )


def _half_interval(values: np.ndarray) -> float:
    """Half of the 95 % interval of the mean, by Student's t."""
    factor: Any = scipy.stats.t.ppf(0.5 + 0.5 * CONFIDENCE, len(values) - 1)
    return float(factor * values.std(ddof=1) / math.sqrt(len(values)))
