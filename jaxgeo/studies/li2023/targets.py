"""Targets located from the frame angles of Table 2 of Li et al. (2023), compared with the printed ones."""

from __future__ import annotations

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from jaxgeo._intersection import FIRST_HIT
from jaxgeo.earth import WGS84, Geodetic
from jaxgeo.sensor import Shot
from jaxgeo.studies.li2023 import printed
from jaxgeo.uncertainty.model_inputs import ModelInputs


@dataclass(frozen=True)
class Target:
    """The target obtained, and its offset north and east (m) from the printed one."""

    terrain: str
    inner_deg: float
    position: Geodetic
    north: float
    east: float


def table_2() -> list[Target]:
    """The targets of Table 2, located at the printed heights; the mountain also with an inner angle 0.1 deg larger."""
    rows = [(name, row, row.inner) for name, row in printed.TERRAINS.items()]
    rows.append(("mountain, other inner", printed.TERRAINS["mountain"], printed.MOUNTAIN_INNER))
    return [_target(name, row, inner, printed.shot_of(row, inner)) for name, row, inner in rows]


def _target(name: str, row: printed.Terrain, inner: float, shot: Shot) -> Target:
    expected = printed.target_of(row)
    inputs = ModelInputs.of(printed.sensor(), shot, printed.UV, printed.level_ground(row.target[2]))
    found = inputs.nominal_fix(FIRST_HIT).fix.position
    along_meridian, along_parallel = metres_per_radian(expected)
    north = (float(found.lat) - float(expected.lat)) * along_meridian
    east = (float(found.lon) - float(expected.lon)) * along_parallel
    return Target(name, inner, found, north, east)


def metres_per_radian(position: Geodetic) -> tuple[float, float]:
    """Lengths in m of a radian of latitude and of longitude at a position."""
    lat, height = jnp.asarray(position.lat), float(position.height)
    along_meridian = float(WGS84.meridian_radius(lat)) + height
    return along_meridian, (float(WGS84.prime_vertical_radius(lat)) + height) * float(np.cos(lat))
