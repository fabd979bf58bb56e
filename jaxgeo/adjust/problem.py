"""Conversion of a block and its unknowns to arrays in layout order."""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust.arrays import Known, Problem
from jaxgeo.adjust.block import Block
from jaxgeo.adjust.collinearity import Observed, ObservedRows
from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.adjust.initial_points import started
from jaxgeo.adjust.layout import Order, layout_of
from jaxgeo.adjust.pose_rows import PoseRows
from jaxgeo.adjust.ray_effects_of import Entry, effects_of, entries_of
from jaxgeo.adjust.readout import known_motion
from jaxgeo.adjust.terrain_heights import HeightObservations, TerrainHeights
from jaxgeo.adjust.unknowns import Free, Prior, Unknowns, spread
from jaxgeo.adjust.values import INTERIOR, STRIP, Values, interior_of, names_of_interior
from jaxgeo.sensor import FrameCamera

OF_MOUNT = ("boresight x", "boresight y", "boresight z", "lever arm x", "lever arm y", "lever arm z")
OF_STRIP = ("shift east", "shift north", "shift up", "drift east", "drift north", "drift up", "time offset")


class Names(NamedTuple):
    """Names in the order of the arrays; `lens` are those of the active columns."""

    image: np.ndarray
    point: np.ndarray
    camera: tuple[str, ...]
    lens: tuple[str, ...]
    mount: tuple[str, ...]
    strip: tuple[str, ...]
    common: tuple[str, ...]

    def columns(self, problem: Problem) -> list[tuple[str, str]]:
        """(owner, parameter) of each shared column, in the order of the reduced system."""
        found = [] if problem.own_lens else [(f"camera {name}", lens) for name in self.camera for lens in self.lens]
        found += [(f"mount {name}", part) for name in self.mount for part in OF_MOUNT] if problem.mounts else []
        of_strip = OF_STRIP[: problem.strip.free.shape[1]]
        found += [(f"strip {name}", part) for name in self.strip for part in of_strip] if problem.strips else []
        found += [("navigation", part) for part in self.common]
        return found


class Prepared(NamedTuple):
    """A problem, the names of its parts, and the indices of points and measurements."""

    problem: Problem
    names: Names
    order: Order


def prepared(
    block: Block,
    unknowns: Unknowns,
    terrain: HeightObservations | None = None,
    aside: tuple[np.ndarray, np.ndarray] | None = None,
) -> Prepared:
    """The arrays of a block. Raises `ValueError` for unknowns that are not in the block.

    Start positions ignore what is set `aside`: measurements by flag (k,), and names of control points.
    """
    cameras = tuple(dict.fromkeys(block.images.camera.tolist()))
    of_effects = entries_of(block, cameras, unknowns)
    lens_sigma, active, lens_names = _lenses(block, cameras, unknowns, of_effects)
    mounts, strips = _names_of_navigation(block)
    common = () if block.navigation is None else block.navigation.names_of_common
    mount_sigma, strip_sigma = _shared(unknowns, mounts, strips)
    own_lens = bool(active) and len(cameras) == len(block.images)
    images = block.images
    camera = _numbers(images.camera, cameras)
    points, point = np.unique(block.observations.point, return_inverse=True)
    image = images.rows_of(block.observations.image)
    columns = len(images) * (6 + (len(active) if own_lens else 0))
    observations = block.observations
    layout, order = layout_of(image, point, observations.uv, observations.sigma, camera, columns)
    pose = spread(unknowns.images, images.name.tolist(), 1, "images", Free())
    if not np.all((pose == 0.0) | np.isinf(pose)):
        raise ValueError(
            "Unknowns.images takes Free() or Fixed(); a prior of an orientation is the block's navigation."
        )
    place, known, free = _known_points(block, points, order)
    row = order.row_of_point[point]
    if aside is None:
        beginning = place = started(block, place, row, image)
    else:
        out = order.row_of_point[np.isin(points, aside[1])]
        beginning = place.copy()
        beginning[out] = np.nan
        beginning = started(block, beginning, row, image, ~aside[0])
        place = np.where(np.isnan(place), beginning, place)
    observed, mount_of, strip_of = _observed(block, mounts, strips, strip_sigma[:, STRIP:], len(of_effects))
    lens = np.stack([interior_of(block.cameras[name]) for name in cameras])
    lens = np.concatenate([lens, *(one.start[:, None] for one in of_effects)], axis=1)
    start = Values(
        centre=jnp.asarray(images.centre),
        R_frame_from_camera=jnp.asarray(images.R_frame_from_camera),
        points=jnp.asarray(beginning),
        lens=jnp.asarray(lens),
        boresight=jnp.asarray(np.broadcast_to(np.eye(3), (len(mounts), 3, 3))),
        lever=jnp.asarray(_levers(block, mounts)),
        strip=jnp.asarray(np.zeros(strip_sigma.shape)),
        common=jnp.zeros(len(common)),
    )
    problem = Problem(
        layout=layout,
        cameras=_stacked([block.cameras[name] for name in cameras]),
        observed=observed,
        mount_of=jnp.asarray(mount_of),
        strip_of=jnp.asarray(strip_of),
        start=start,
        place=jnp.asarray(place),
        known_point=jnp.asarray(known),
        free_point=jnp.asarray(free),
        free_pose=jnp.asarray(np.broadcast_to((pose > 0.0).astype(float), (len(images), 6))),
        lens=_known(lens_sigma[:, list(active)]),
        mount=_known(mount_sigma),
        strip=_known(strip_sigma),
        common=_known(np.ones((1, len(common)))),
        terrain=None if terrain is None else _on_terrain(block, terrain, points, order, start.points),
        active=active,
        own_lens=own_lens,
        mounts=bool(np.any(mount_sigma > 0.0)),
        strips=bool(np.any(strip_sigma > 0.0)),
        effects=effects_of(block, layout, order, of_effects, start) if of_effects else None,
    )
    return Prepared(problem, Names(images.name, points, cameras, lens_names, mounts, strips, common), order)


def _lenses(
    block: Block, cameras: tuple[str, ...], unknowns: Unknowns, of_effects: list[Entry]
) -> tuple[np.ndarray, tuple[int, ...], tuple[str, ...]]:
    """Sigmas (cameras, all) of the lenses and of the entries of effects on rays, the columns that are unknown for any
    of them, and their names."""
    names = names_of_interior(block.cameras[cameras[0]])
    parts = [
        spread(choice, cameras, size, what)
        for choice, size, what in (
            (unknowns.focal, 1, "focal"),
            (unknowns.aspect, 1, "aspect"),
            (unknowns.principal, 2, "principal"),
        )
    ]
    coefficients = names[len(INTERIOR) :]
    row = spread(unknowns.distortion, coefficients, 1, "distortion")[:, 0] if coefficients else np.zeros(0)
    _check_one_way(block.cameras[cameras[0]], row, np.concatenate(parts, axis=1))
    more = [one.sigma[:, None] for one in of_effects]
    sigma = np.concatenate([*parts, np.broadcast_to(row, (len(cameras), len(row))), *more], axis=1)
    names = (*names, *(one.name for one in of_effects))
    active = tuple(int(i) for i in np.flatnonzero(np.any(sigma > 0.0, axis=0)))
    return sigma, active, tuple(names[i] for i in active)


def _check_one_way(camera: FrameCamera, coefficients: np.ndarray, interior: np.ndarray) -> None:
    """Refuse free lens coefficients that are equivalent to a free interior orientation."""
    lens, free = camera.distortion, bool(np.any(np.isinf(interior)))
    for name in lens.interior:
        if np.isinf(coefficients[lens.names.index(name)]) and free:
            others = ", ".join(repr(other) for other in lens.names if other not in lens.interior)
            raise ValueError(
                f"Unknowns.distortion: {name} of {type(lens).__name__} does what the interior orientation does, which "
                f"is free too; the two cannot be told apart. Free the others only: dict.fromkeys([{others}], Free())."
            )


def _shared(unknowns: Unknowns, mounts: tuple[str, ...], strips: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    parts = []
    for names, choices in (
        (mounts, ((unknowns.boresight, "boresight"), (unknowns.lever, "lever"))),
        (strips, ((unknowns.shift, "shift"), (unknowns.drift, "drift"))),
    ):
        parts.append(np.concatenate([spread(choice, names, 3, what) for choice, what in choices], axis=1))
    if not strips and isinstance(unknowns.time_offset, Free | Prior):
        raise ValueError("Unknowns.time_offset is that of the navigation, which the block does not have; give some.")
    offset = spread(unknowns.time_offset, strips, 1, "time_offset")
    return parts[0], np.concatenate([parts[1], offset], axis=1) if np.any(offset > 0.0) else parts[1]


def _names_of_navigation(block: Block) -> tuple[tuple[str, ...], tuple[str, ...]]:
    if block.navigation is None:
        return (), ()
    return tuple(dict.fromkeys(block.navigation.mount.tolist())), tuple(dict.fromkeys(block.navigation.strip.tolist()))


def _levers(block: Block, mounts: tuple[str, ...]) -> np.ndarray:
    if block.navigation is None:
        return np.zeros((0, 3))
    return np.array([np.asarray(block.navigation.mounts[name][0].lever_body, np.float64) for name in mounts])


def observed_of(block: Block, names: Names, offset_sigma: np.ndarray) -> Observed:
    """Navigation of a block as arrays; `offset_sigma` as of `_observed`."""
    observed, _, _ = _observed(block, names.mount, names.strip, offset_sigma, 0)
    assert observed is not None
    return observed


def _observed(
    block: Block, mounts: tuple[str, ...], strips: tuple[str, ...], offset_sigma: np.ndarray, entries: int
) -> tuple[Observed | None, Any, Any]:
    """Navigation as arrays, and the mount and strip numbers of each image.

    `offset_sigma` (strips, 1) are the sigmas of unknown time offsets, (strips, 0) if there are none; `entries` is the
    number of those of effects on rays.
    """
    nav, none = block.navigation, np.zeros(len(block.images), int)
    if nav is None:
        return None, none, none
    mount_of, strip_of = _numbers(nav.mount, mounts), _numbers(nav.strip, strips)
    of_mount = [nav.mounts[name] for name in mounts]
    middle = np.array([nav.time[strip_of == strip].mean() for strip in range(len(strips))])

    def constants(name: str) -> np.ndarray:
        return np.array([np.asarray(getattr(mount, name), np.float64) for mount, _ in of_mount])[mount_of]

    velocity = turn_rate = None
    if offset_sigma.shape[1]:
        velocity, turn_rate = known_motion(block, offset_sigma[strip_of, 0] > 0.0, "Unknowns.time_offset")
    observed = Observed(
        position=nav.position,
        R_frame_from_body=nav.R_frame_from_body,
        R_frame_from_reference=nav.R_frame_from_reference,
        R_base_from_head=nav.R_base_from_head,
        information_position=nav.information_position,
        information_attitude=nav.information_attitude,
        R_body_from_base=constants("R_body_from_base"),
        R_head_from_camera=constants("R_head_from_camera"),
        lever_head=constants("lever_head"),
        level=np.array([level for _, level in of_mount])[mount_of],
        centred_time=nav.time - middle[strip_of],
        common=nav.common_errors,
        rows=None if nav.pose_rows is None else _observed_rows(nav.pose_rows, nav.names_of_common, entries),
        velocity=velocity,
        turn_rate=turn_rate,
    )
    return jax.tree.map(jnp.asarray, observed), mount_of, strip_of


def _observed_rows(given: PoseRows, common: tuple[str, ...], entries: int) -> ObservedRows:
    by_lens = np.pad(given.by_lens, ((0, 0), (0, 0), (0, entries)))
    parts = given.centre, given.R_frame_from_camera, given.offset, given.by_pose, by_lens
    return ObservedRows(*parts, given.columns(common))


def _known_points(block: Block, points: np.ndarray, order: Order) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start positions (NaN if not given), information, and flags of free coordinates, in the rows of the layout."""
    place, known = np.full((order.rows, 3), np.nan), np.zeros((order.rows, 3, 3))
    free = np.zeros((order.rows, 3))
    free[order.row_of_point] = 1.0
    row_of = dict(zip(points.tolist(), order.row_of_point.tolist(), strict=True))
    for given in (block.points, block.control):
        if given is None:
            continue
        in_block = np.array([i for i, name in enumerate(given.name.tolist()) if name in row_of], int)
        rows = np.array([row_of[name] for name in given.name[in_block].tolist()], int)
        sigma = given.sigma[in_block]
        if given is block.points:
            place[rows] = given.place[in_block]
            continue
        start = np.where(np.isnan(place[rows]), np.nan, place[rows])
        place[rows] = np.where(np.isfinite(sigma), given.place[in_block], start)  # unknown coordinates: from their rays
        with np.errstate(divide="ignore"):
            weight = np.where(sigma > 0.0, 1.0 / sigma, 0.0)
        known[rows] = np.eye(3) * weight[:, None, :]
        if given.covariance is not None:
            known[rows] = np.linalg.inv(np.linalg.cholesky(given.covariance[in_block]))
        free[rows] = sigma > 0.0
    return place, known, free


def _on_terrain(
    block: Block, terrain: HeightObservations, points: np.ndarray, order: Order, start: Any
) -> TerrainHeights:
    """Terrain observations by point row. Raises `ValueError` for a frame that is not on the Earth, a sigma that is
    not positive, unknown names, and points over unknown ground."""
    if not isinstance(block.frame, LocalFrame):
        raise ValueError("terrain= takes a block in a LocalFrame: in a Cartesian frame a DEM lies nowhere.")
    if not np.isfinite(terrain.sigma) or terrain.sigma <= 0.0:
        raise ValueError(f"sigma of the terrain's height must be positive, in m; got {terrain.sigma!r}.")
    if terrain.names is None:
        tied = np.ones(len(points), bool) if block.control is None else ~np.isin(points, block.control.name)
    else:
        missing = sorted(set(terrain.names) - set(points.tolist()))
        if missing:
            raise ValueError(f"terrain: there is no point {missing[0]!r} among those measured.")
        tied = np.isin(points, terrain.names)
    information = np.zeros(order.rows)
    information[order.row_of_point[tied]] = 1.0 / terrain.sigma
    found = TerrainHeights(terrain.dem, block.frame, jnp.asarray(information))
    unknown = ~np.isfinite(np.asarray(eqx.filter_jit(found.residuals)(start)))[order.row_of_point]
    if np.any(unknown):
        raise ValueError(
            f"point {points[np.argmax(unknown)]} lies over no known ground of the terrain ({int(np.sum(unknown))} such "
            f"points); name those that do with HeightObservations(names=...)."
        )
    return found


def _known(sigma: np.ndarray) -> Known:
    with np.errstate(divide="ignore"):
        return Known(jnp.asarray(np.where(sigma > 0.0, 1.0 / sigma, 0.0)), jnp.asarray((sigma > 0.0).astype(float)))


def _numbers(names: np.ndarray, known: tuple[str, ...]) -> np.ndarray:
    index = {name: i for i, name in enumerate(known)}
    return np.array([index[name] for name in names.tolist()], int)


def _stacked(cameras: list[FrameCamera]) -> FrameCamera:
    """Cameras as one record with a leading axis; adjustments need no image sizes."""
    alike = [FrameCamera(c.focal_px, c.principal_px, c.distortion, 1, 1) for c in cameras]
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack([np.asarray(leaf, float) for leaf in leaves])), *alike)
