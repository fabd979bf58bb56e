"""An adjustment as one dense least squares problem: all residuals as functions of all unknowns, by autodiff."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust import Adjustment, Fixed, HeightObservations
from jaxgeo.adjust.values import INTERIOR
from jaxgeo.earth import WGS84
from jaxgeo.rotations import R_from_rotation_vector, rotation_vector_from_R

AXES = ("x", "y", "z")
ENU = ("east", "north", "up")


class Dense(NamedTuple):
    """Weighted residuals, their Jacobian by the free unknowns, and the covariance of all unknowns (zero where fixed).

    Unknowns are the adjustment's `columns`, then the points' coordinates in the order of its `points`. Image points are
    the first 2 k residuals.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    covariance: np.ndarray
    free: np.ndarray

    @property
    def leverage(self) -> np.ndarray:
        """Covariance (k, k) of the adjusted observations, in units of the observations' own variance."""
        J = self.jacobian
        return J @ self.covariance[np.ix_(self.free, self.free)] @ J.T


def dense(
    adjustment: Adjustment, terrain: HeightObservations | None = None, constraints: np.ndarray | None = None
) -> Dense:
    """The problem at the adjusted values; rows of `constraints` (d, unknowns) define the datum of a free network."""
    function, size = residual_of(adjustment, terrain)
    residual, J = (np.asarray(x) for x in jax.jit(lambda z: (function(z), jax.jacfwd(function)(z)))(jnp.zeros(size)))
    free = free_of(adjustment, size)
    J = J[:, free]
    normal = J.T @ J
    d = 0 if constraints is None else len(constraints)
    if constraints is not None:
        weight = np.sqrt(np.diag(normal).mean())
        rows = constraints[:, free] / np.linalg.norm(constraints[:, free], axis=1)[:, None] * weight
        normal = np.block([[normal, rows.T], [rows, np.zeros((d, d))]])
    scale = 1.0 / np.sqrt(np.concatenate([np.diag(normal)[: len(normal) - d], np.full(d, weight if d else 1.0)]))
    inverse = np.linalg.inv(normal * scale[:, None] * scale[None, :]) * scale[:, None] * scale[None, :]
    covariance = np.zeros((size, size))
    covariance[np.ix_(free, free)] = inverse[: len(inverse) - d, : len(inverse) - d]
    return Dense(residual, J, covariance, free)


def free_of(adjustment: Adjustment, size: int) -> np.ndarray:
    """Indices of the free unknowns, from the adjustment's specification."""
    names = {(p.whose, p.name) for p in adjustment.parameters}
    images = adjustment.unknowns.images
    held = {n for n in adjustment.images.name.tolist() if _choice(images, n)}
    free = [
        c in names or (c[0].startswith("image ") and c[0][6:] not in held and c[1][:4] in ("cent", "turn"))
        for c in _alike(adjustment)
    ]
    sigma = np.ones((len(adjustment.places), 3))
    control = adjustment.block.control
    if control is not None:
        row = {name: i for i, name in enumerate(adjustment.points.name.tolist())}
        for name, own in zip(control.name.tolist(), control.sigma, strict=True):
            if name in row:
                sigma[row[name]] = own
    found = np.concatenate([free, (sigma > 0.0).ravel()])
    assert found.size == size
    return np.flatnonzero(found)


def _choice(images: Any, name: str) -> bool:
    return isinstance(images.get(name) if isinstance(images, Mapping) else images, Fixed)


def _alike(adjustment: Adjustment) -> list[tuple[str, str]]:
    """The columns, with those of an image's own lens named after its camera."""
    camera = dict(zip(adjustment.images.name.tolist(), adjustment.images.camera.tolist(), strict=True))
    own = ("centre", "turn")
    return [
        (f"camera {camera[whose[6:]]}", what)
        if whose.startswith("image ") and what.split()[0] not in own
        else (whose, what)
        for whose, what in adjustment.columns
    ]


def residual_of(adjustment: Adjustment, terrain: HeightObservations | None = None) -> tuple[Any, int]:
    """(weighted residuals as a function of a change of all unknowns, number of unknowns)."""
    block, images, points = adjustment.block, adjustment.images, adjustment.prepared.names.point.tolist()
    columns, seen, nav = _alike(adjustment), block.observations, block.navigation
    N = len(columns)
    index = {column: i for i, column in enumerate(columns)}
    size = N + 3 * len(points)

    def table(whose: str, names: Any, parts: Any) -> np.ndarray:
        return np.array([[index.get((f"{whose} {name}", part), size) for part in parts] for name in names])

    image_at = table("image", images.name, [f"centre {a}" for a in AXES] + [f"turn {a}" for a in AXES])
    cameras, mounts, strips = adjustment.cameras, adjustment.mounts, adjustment.strips
    lens = next(iter(cameras.values())).distortion.names
    camera_at = table("camera", cameras, (*INTERIOR, *lens))
    mount_at = table("mount", mounts, [f"boresight {a}" for a in AXES] + [f"lever arm {a}" for a in AXES])
    strip_at = table("strip", strips, [f"shift {a}" for a in ENU] + [f"drift {a}" for a in ENU])
    number = {name: i for i, name in enumerate(images.name.tolist())}
    image = np.array([number[name] for name in seen.image.tolist()])
    point = np.searchsorted(points, seen.point)
    camera = np.array([list(cameras).index(name) for name in images.camera.tolist()])[image]
    lenses = np.stack([_interior(c) for c in cameras.values()])
    given = np.stack([_interior(block.cameras[name]) for name in cameras])
    places = np.stack([adjustment.places[name] for name in points])
    prior = {(p.whose, p.name): p.prior for p in adjustment.parameters}
    kind = next(iter(cameras.values())).distortion

    def information(whose: str, names: Any, parts: Any) -> np.ndarray:
        sigma = [[prior.get((f"{whose} {name}", part), np.inf) for part in parts] for name in names]
        return 1.0 / np.reshape(sigma, (len(names), len(parts)))

    by_camera = information("camera", cameras, (*INTERIOR, *lens))
    by_mount = information("mount", mounts, [f"boresight {a}" for a in AXES] + [f"lever arm {a}" for a in AXES])
    by_strip = information("strip", strips, [f"shift {a}" for a in ENU] + [f"drift {a}" for a in ENU])

    def function(change: Any) -> Any:
        z = jnp.concatenate([change, jnp.zeros(1)])
        pose = z[image_at]
        centre = images.centre + pose[:, :3]
        R = jax.vmap(lambda a, v: a @ R_from_rotation_vector(v))(jnp.asarray(images.R_frame_from_camera), pose[:, 3:])
        where = places + z[N:size].reshape(-1, 3)
        interior = lenses + z[camera_at]

        def measured(i: Any, p: Any, c: Any, uv: Any) -> Any:
            x, y, w = R[i].T @ (where[p] - centre[i])
            f, aspect, *principal = interior[c][:4]
            bent = kind.with_coefficients(interior[c][4:]).distort(jnp.stack([x / w, y / w]))
            return bent * jnp.stack([f, f * aspect]) + jnp.stack(principal) - uv

        parts = [jax.vmap(measured)(image, point, camera, seen.uv) / seen.sigma]
        parts += [(interior - given) * by_camera]
        if block.control is not None:
            parts += _control(block.control, points, where)
        if nav is not None:
            parts += _navigation(adjustment, centre, R, z[mount_at], z[strip_at], by_mount, by_strip)
        if terrain is not None:
            tied = terrain.names or [n for n in points if block.control is None or n not in block.control.name]
            position = jax.vmap(WGS84.to_geodetic)(block.frame.to_ecef(where[np.searchsorted(points, tied)]))
            parts += [(position.height - jax.vmap(terrain.dem.height_at)(position)) / terrain.sigma]
        return jnp.concatenate([part.ravel() for part in parts])

    return function, size


def _interior(camera: Any) -> np.ndarray:
    focal, principal = np.asarray(camera.focal_px), np.asarray(camera.principal_px)
    return np.concatenate([[focal[0], focal[1] / focal[0]], principal, np.asarray(camera.distortion.coefficients())])


def _control(control: Any, points: list[str], where: Any) -> list[Any]:
    seen = np.array([i for i, name in enumerate(control.name.tolist()) if name in points], int)
    off = where[np.array([points.index(control.name[i]) for i in seen], int)] - control.place[seen]
    if control.covariance is not None:
        weight = np.linalg.inv(np.linalg.cholesky(control.covariance[seen]))
        return [jnp.einsum("pij,pj->pi", weight, off)]
    with np.errstate(divide="ignore"):
        return [off * np.where(control.sigma[seen] > 0.0, 1.0 / control.sigma[seen], 0.0)]


def _navigation(
    adjustment: Any, centre: Any, R: Any, of_mount: Any, of_strip: Any, by_mount: Any, by_strip: Any
) -> Any:
    nav, mounts, strips = adjustment.block.navigation, adjustment.mounts, adjustment.strips
    strip = of_strip + np.stack(list(strips.values()))
    found = [strip * by_strip]
    turned, levels = [], []
    for i, (name, mount) in enumerate(mounts.items()):
        given, level = nav.mounts[name]
        turn = R_from_rotation_vector(of_mount[i, :3])
        before, after, start = np.asarray(mount.R_body_from_base), np.asarray(mount.R_head_from_camera), given
        if level:
            after, start = turn @ after, start.R_head_from_camera
            from_start = after @ np.asarray(start).T
        else:
            before, start = turn @ before, start.R_body_from_base
            from_start = before @ np.asarray(start).T
        lever = np.asarray(mount.lever_body) + of_mount[i, 3:]
        turned.append((before, after, lever, np.asarray(mount.lever_head)))
        levels.append(level)
        off = jnp.concatenate([rotation_vector_from_R(from_start), lever - np.asarray(given.lever_body)])
        found.append(off * by_mount[i])
    of_image = np.array([list(mounts).index(name) for name in nav.mount.tolist()])
    numbers = np.array([list(strips).index(name) for name in nav.strip.tolist()])
    times = np.array([np.mean(nav.time[numbers == k]) for k in range(len(strips))])
    befores, afters, levers, levers_head = (jnp.stack(part)[of_image] for part in zip(*turned, strict=True))

    def image(k: Any, before: Any, after: Any, lever: Any, lever_head: Any, level: Any, own: Any) -> Any:
        R_frame_from_head = R[k] @ after.T
        R_frame_from_base = R_frame_from_head @ jnp.asarray(nav.R_base_from_head)[k].T
        implied = jnp.where(level, R_frame_from_base, R_frame_from_base @ before.T)
        body = jnp.where(level, jnp.asarray(nav.R_frame_from_body)[k], implied)
        imu = centre[k] - body @ lever - R_frame_from_head @ lever_head
        off = imu + own[:3] + own[3:] * jnp.asarray(nav.time - times[numbers])[k] - jnp.asarray(nav.position)[k]
        turn = rotation_vector_from_R(jnp.asarray(nav.R_frame_from_reference)[k].T @ implied)
        by_position, by_attitude = jnp.asarray(nav.information_position)[k], jnp.asarray(nav.information_attitude)[k]
        return jnp.concatenate([by_position @ off, by_attitude @ turn])

    level = np.array(levels)[of_image]
    every = jnp.arange(len(nav.time))
    return [*found, jax.vmap(image)(every, befores, afters, levers, levers_head, level, strip[numbers])]
