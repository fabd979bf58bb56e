"""Lines of sight of all sensors in one frame and in the order of time, and where the target is to be looked for."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.frames import R_ecef_from_enu
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, ConstantHeight
from jaxgeo.uncertainty.host_arrays import take
from jaxgeo.uncertainty.look_equations import World
from jaxgeo.uncertainty.look_lines import Lines, block_size, fixes_of, lines_of, origins_of
from jaxgeo.uncertainty.looks import Looks
from jaxgeo.uncertainty.model_inputs import of_arrays
from jaxgeo.uncertainty.shared_errors import SharedErrors
from jaxgeo.uncertainty.target_motion import AbstractTarget

USUAL_RANGE = 1000.0  # m: where lines of sight are parallel
NEAREST = 1.0  # m from a camera


class Scene(NamedTuple):
    """Blocks of lines of sight in the frame of the track, in the order of time, with flags of those that are used; the
    number of looks, and how to filter them."""

    blocks: list[tuple[Lines, Any]]
    count: int
    world: World
    target: AbstractTarget
    counts: tuple[int, int, int]


def lines_of_all(
    several: tuple[Looks, ...], terrain: AbstractTerrain | None, shared: SharedErrors, target: AbstractTarget
) -> tuple[list[Lines], list[tuple[Any, Any]]]:
    """(lines of sight of each sensor; their statuses and times)."""
    ground = of_arrays(terrain if terrain is not None and target.on_terrain else ConstantHeight(0.0))
    if target.on_terrain:
        fixes = [fixes_of(looks, ground) for looks in several]
        places = [place for place, _ in fixes]
    else:
        places = _nearest_places([origins_of(looks, ground) for looks in several])
    lines = []
    for number, (looks, model, columns) in enumerate(zip(several, shared.models, shared.columns, strict=True)):
        found = lines_of(looks, ground, model, columns, places[number])
        if target.on_terrain:
            status = fixes[number][1]
            found = found._replace(status=np.where(status == Status.hit, found.status, status))
        else:
            found = found._replace(ground=np.zeros_like(found.ground))
        lines.append(found)
    return lines, [(one.status, one.time) for one in lines]


def _nearest_places(origins: list[Any]) -> list[np.ndarray]:
    """The point nearest to all lines of sight in ECEF m, for each look (n, 3) of each sensor.

    Also of a moving target: a velocity as a further unknown would be fitted by a target that moves with the camera.
    """
    counts = [len(one.time) for one in origins]
    whole = jax.tree.map(lambda *x: np.concatenate(x), *origins)
    seen = np.asarray(whole.status) == Status.hit
    if not seen.any():
        return [np.zeros((count, 3)) for count in counts]
    reference = whole.origin[seen][0]
    d = np.where(seen[:, None], whole.direction, [1.0, 0.0, 0.0])
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    away = np.where(seen[:, None], whole.origin - reference, 0.0)
    rows, right = across[seen].reshape(-1, 3), (across @ away[:, :, None])[seen].reshape(-1)
    point = np.linalg.lstsq(rows, right, rcond=1e-9)[0]
    ranges = np.sum(d * (point - away), axis=1)
    behind = ranges < NEAREST
    places = reference + np.where(behind[:, None], away + USUAL_RANGE * d, point)
    return np.split(places, np.cumsum(counts)[:-1])


def in_order(lines: list[Lines]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(sensor, number of the look, order by time) of all looks."""
    counts = [len(one.time) for one in lines]
    sensor, look = np.repeat(np.arange(len(counts)), counts), np.concatenate([np.arange(n) for n in counts])
    order = np.argsort(np.concatenate([one.time for one in lines]), kind="stable")
    return sensor[order], look[order], order


def scene_of(
    lines: list[Lines],
    order: np.ndarray,
    sensor: np.ndarray,
    terrain: AbstractTerrain | None,
    shared: SharedErrors,
    target: AbstractTarget,
) -> tuple[Scene, np.ndarray]:
    """(the lines of sight in the frame of the track, whose origin is at the first one that is used; start)."""
    whole: Lines = jax.tree.map(lambda *x: np.concatenate(x)[order], *lines)
    used = np.asarray(whole.status) == Status.hit
    first = int(np.argmax(used))
    ground = np.where(used[:, None], whole.ground, whole.ground[_stand_ins(used, sensor)])
    origin = whole.point[first]
    R = np.asarray(R_ecef_from_enu(WGS84.to_geodetic(jnp.asarray(origin))))
    local = whole._replace(
        time=whole.time - whole.time[first],
        point=np.where(used[:, None], whole.point - origin, 0.0) @ R,
        heading=np.where(used[:, None], whole.heading @ R, [0.0, 0.0, -1.0]),
        bend=whole.bend @ R,
        distance=np.where(used, whole.distance, np.median(whole.distance[used])),
        shift=np.einsum("ji,njz->niz", R, whole.shift),
        slope=np.einsum("ji,njz->niz", R, whole.slope),
        ground=ground,
    )
    surface = of_arrays(terrain) if terrain is not None and target.on_terrain else None
    world = World(surface, jnp.asarray(origin), jnp.asarray(R), jnp.asarray(shared.durations))
    points, times = local.point[used][:, : target.axes], local.time[used]
    if target.is_moving:
        rows = np.stack([np.ones_like(times), times / max(np.ptp(times), 1.0)], axis=1)
        start, rate = np.linalg.lstsq(rows, points, rcond=None)[0]
        at_start = np.concatenate([start, rate / max(np.ptp(times), 1.0)])
    else:
        at_start = np.median(points, axis=0)
    return Scene(_blocks(local, used), len(used), world, target, shared.counts), at_start


def _stand_ins(used: np.ndarray, sensor: np.ndarray) -> np.ndarray:
    """For each look one that is used, of the same sensor if there is one: the ground errs by the same sources there."""
    of_sensor = {number: int(np.argmax(used & (sensor == number))) for number in np.unique(sensor[used])}
    return np.array([of_sensor.get(number, int(np.argmax(used))) for number in sensor])


def _blocks(lines: Lines, used: np.ndarray) -> list[tuple[Lines, Any]]:
    """Blocks of looks, the last one padded with looks that are not used."""
    count, size = len(used), block_size(len(used))
    found = []
    for begin in range(0, count, size):
        index = np.arange(begin, begin + size)
        within = np.minimum(index, count - 1)
        found.append((take(lines, within), jnp.asarray(used[within] & (index < count))))
    return found
