"""Effect of a change of one attitude angle on the overlap: Tables 1 to 3 of Li et al. (2020), three ways."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._locate import locate
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.coverage import geometry, transform
from jaxgeo.coverage.transform import MapVector
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.sensor import Pose, Shot
from jaxgeo.studies.li2020 import printed

LOOK = {"off_nadir": math.radians(printed.OFF_NADIR), "field_of_view": math.radians(printed.FIELD_OF_VIEW)}
START = printed.TABLE_4[0]
ROWS = 64  # attitudes of one program


@dataclass(frozen=True)
class Influence:
    """Change of the overlap by a change of one angle (deg): printed, by the formula, and by coordinate transforms.

    `by_slant_range` uses the step along the flight and a frame length of twice the slant range times tan(omega/2);
    `on_map` the step and the frame length in metres of the same map; `by_eq_16` the distance of the two points as the
    step, and the frame length by the slant range.
    """

    angle: str
    change_deg: float
    printed: float
    formula: float
    by_slant_range: float
    on_map: float
    by_eq_16: float


class _Frame(NamedTuple):
    """A frame on the ground: its centre on the map, and its length on the map and by its slant range, m."""

    middle: MapVector
    map_length: Scalar
    slant_length: Scalar


def tables_1_to_3() -> list[Influence]:
    """Tables 1 to 3 from the position and height of Table 4's first strip, in level flight to the south.

    The step to the second strip gives the required overlap of the two frames on the map. For heading and pitch the
    frame length stays that of the first strip, as in Eqs 18 and 19; a roll changes that of the second, as in Eq 22.
    """
    attitudes = np.array([_attitude(angle, change) for angle in printed.TABLES for change in printed.CHANGES])
    found = _changes(attitudes).reshape(len(printed.TABLES), -1, 3)
    return [
        Influence(angle, change, shown, formula, *numbers)
        for (angle, row), by_change in zip(printed.TABLES.items(), found.tolist(), strict=True)
        for change, shown, formula, numbers in zip(
            printed.CHANGES, row, FORMULAS[angle](np.radians(printed.CHANGES)).tolist(), by_change, strict=True
        )
    ]


def folding(changes_deg: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Change of the overlap by changes of heading (n,) in deg: by Eq 18, by the step along the flight, and by the
    distance of Eq 16, both with the frame length by the slant range."""
    found = _changes(np.array([_attitude("heading", change) for change in changes_deg]))
    return np.asarray(FORMULAS["heading"](np.radians(changes_deg))), found[:, 0], found[:, 2]


def required_flight() -> tuple[float, float]:
    """Latitudes in rad of the two strips: flown south until the frames have the required overlap on the map."""
    metres = float(WGS84.meridian_radius(jnp.deg2rad(START.lat))) + START.height_above_ground
    flown = 400.0
    lat = math.radians(START.lat)
    step, length = (float(x) for x in _overlaps(lat, lat - flown / metres, np.zeros((1, 3)))[1])
    return lat, lat - flown * (1.0 - printed.OVERLAP) * length / step / metres


def _changes(attitudes: np.ndarray) -> np.ndarray:
    """Changes of the overlap (n, 3), see `_overlaps`, by attitudes (n, 3) of the second strip."""
    return _overlaps(*required_flight(), attitudes)[0]


FORMULAS: dict[str, Callable[[np.ndarray], Array]] = {
    "heading": lambda change: geometry.overlap_change_by_heading(heading_change=change, **LOOK),
    "pitch": lambda change: geometry.overlap_change_by_pitch(pitch_change=change, **LOOK),
    "roll": lambda change: geometry.overlap_change_by_roll(
        off_nadir_change=change, off_nadir=LOOK["off_nadir"], overlap=printed.OVERLAP
    ),
}


def _attitude(angle: str, change_deg: float) -> tuple[float, float, float]:
    """Changes (heading, pitch, roll) in rad; Table 3 rolls the left wing down, which raises a view to the right."""
    change = math.radians(change_deg)
    return {"heading": (change, 0.0, 0.0), "pitch": (0.0, change, 0.0), "roll": (0.0, 0.0, -change)}[angle]


def _overlaps(lat: float, next_lat: float, attitudes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(changes of the overlap (n, 3): by the slant range, on the map, by Eq 16; nominal step and length on the map in
    m), by one program for any number of attitudes."""
    count = len(attitudes)
    padded = np.zeros((-(-count // ROWS) * ROWS, 3))
    padded[:count] = attitudes
    parts = [_overlaps_of_rows(lat, next_lat, rows) for rows in padded.reshape(-1, ROWS, 3)]
    return np.concatenate([np.asarray(changes) for changes, _ in parts])[:count], np.asarray(parts[0][1])


@jax.jit
def _overlaps_of_rows(
    lat: Scalar, next_lat: Scalar, attitudes: Float[Array, "n 3"]
) -> tuple[Float[Array, "n 3"], MapVector]:
    """`_overlaps` of `ROWS` attitudes."""
    level = jnp.zeros((2, 3))
    lats = jnp.concatenate([jnp.stack([lat, next_lat]), jnp.full(attitudes.shape[0], next_lat)])
    frames = jax.vmap(_frame)(lats, jnp.concatenate([level, attitudes]))
    first, nominal = (_Frame(*(leaf[k] for leaf in frames)) for k in (0, 1))
    others = _Frame(*(leaf[2:] for leaf in frames))
    step = nominal.middle - first.middle
    forward = step / jnp.linalg.norm(step)
    rolls = attitudes[:, 2] != 0.0

    def changes(other: _Frame, rolled: Array) -> Float[Array, "3"]:
        length = _Frame(*(jnp.where(rolled, new, old) for new, old in zip(other, first, strict=True)))
        moved = other.middle - first.middle
        distances = jnp.stack([moved @ forward, moved @ forward, jnp.linalg.norm(moved)])
        before, after = (jnp.stack([one.slant_length, one.map_length, one.slant_length]) for one in (first, length))
        return geometry.overlap_of_step(distances, after) - geometry.overlap_of_step(step @ forward, before)

    return jax.vmap(changes)(others, rolls), jnp.stack([step @ forward, first.map_length])


def _frame(lat: Scalar, attitude: Vector3) -> _Frame:
    """The frame seen to the right in southward flight, with changes of attitude (heading, pitch, roll) in rad."""
    sensor, projection = printed.sensor(mirror=False), printed.gauss_krueger()
    position = Geodetic(lat=lat, lon=math.radians(START.lon), height=START.height_above_ground)
    pose = Pose(position, jnp.pi + attitude[0], attitude[1], attitude[2])
    shot = Shot(pose, jnp.array([LOOK["off_nadir"], 0.0]))
    fixes = jax.vmap(lambda uv: locate(sensor, shot, uv, printed.ground()))(jnp.array(printed.EDGES))
    rear, middle, front = (jax.tree.map(lambda leaf, k=k: leaf[k], fixes.position) for k in range(3))
    return _Frame(
        jnp.stack(projection.forward(middle.lat, middle.lon)),
        transform.frame_length_on_map(projection, rear, front),
        2.0 * fixes.slant_range[1] * math.tan(0.5 * LOOK["field_of_view"]),
    )
