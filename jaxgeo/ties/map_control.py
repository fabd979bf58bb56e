"""Images registered to a map as observations of their orientations, with the errors of map and terrain."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxgeo._arguments import check_mapped_terrain
from jaxgeo._checks import as_float64, check_is
from jaxgeo._compile import batch_filter_jit
from jaxgeo._typing import Scalar, Vector3
from jaxgeo.adjust import LocalFrame
from jaxgeo.adjust.collinearity import pixel_of
from jaxgeo.adjust.pose_rows import PoseRows
from jaxgeo.adjust.values import interior_of, with_interior
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.observation import Exposure
from jaxgeo.register.posterior import Update
from jaxgeo.register.registration import Registration
from jaxgeo.register.tie_errors import TieErrors, height_covariances, height_variances
from jaxgeo.register.ties import TiePoints, checked_ties, padded
from jaxgeo.rotations import R_from_rotation_vector
from jaxgeo.sensor import FrameCamera, Shot
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.ties.views import Views
from jaxgeo.uncertainty import ErrorModel, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs, of_arrays

SHIFT = ("map: shift east", "map: shift north")
OF_GROUND = (sources.TerrainHeight, sources.Geoid, sources.TerrainHeightRaster)  # they raise the ground of the ties
FAINT = 1e-12  # lower bound of the weights of ties


@dataclass(frozen=True)
class Measured:
    """Linearised measurements of a map in one image: offset + by_pose x + by_lens y + by_common z, as `PoseRows`.

    `offset` (r,), `by_pose` (r, 6), `by_lens` (r, l) and `by_common`, (r,) of each name; x is relative to `centre`
    (3,) in m and `R_frame_from_camera` (3, 3). `count` points of the map were measured.
    """

    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    offset: np.ndarray
    by_pose: np.ndarray
    by_lens: np.ndarray
    by_common: dict[str, np.ndarray]
    count: int


@dataclass(frozen=True)
class MapControl:
    """Images of a block that are registered to one map: what their map points say about their orientations.

    `measured` has the linear observations of each registered image, by name, for a block in the `frame` of its views.
    Common to all images, with standard normal priors, are the map shift to the east and north, in units of
    `TieErrors.shift`, and the errors of the ground among the sources of the registrations (`TerrainHeight`, `Geoid`,
    `TerrainHeightRaster`), whatever their sharing. Errors of single matches, of the map's registration and of the
    terrain are independent between map points; a `terrain_field` correlates those of one image, not of different ones.
    """

    frame: LocalFrame
    measured: dict[str, Measured]

    @classmethod
    def of(cls, views: Views, registered: Mapping[str, Registration], terrain: AbstractTerrain) -> MapControl:
        """From registrations by name of the image, each made with the same `terrain` and map.

        A registration's own navigation does not enter, only its ties, with the registration error that it estimated
        from its residuals and the weights of its loss: the navigation is that of `views`. Observations are linearised
        at the registered orientation; refraction is taken into account where the registration has an atmosphere.
        Raises `ValueError` for no registrations, names that `views` does not have, images that are not registered,
        and different shifts of the map.
        """
        check_is(views, Views, "views")
        if not registered:
            raise ValueError("there is no registered image; leave the control out.")
        shifts = {float(np.asarray(one.tie_errors.shift)) for one in registered.values() if one.accepted}
        if len(shifts) > 1:
            raise ValueError(
                f"the registrations have different standard deviations of the map's shift, in m: {sorted(shifts)}; all "
                "images must be registered to one map with one TieErrors.shift."
            )
        index = {str(name): row for row, name in enumerate(views.name)}
        measured = {}
        for name, one in registered.items():
            check_is(one, Registration, f"registration of {name}")
            if name not in index:
                raise ValueError(f"registered image {name!r} is not among the views; known are {', '.join(index)}.")
            camera = views.camera_of(index[name])
            measured[name] = measured_by(views.frame, camera, one, terrain, name)
        return cls(views.frame, measured)

    @property
    def names(self) -> list[str]:
        """Names of the registered images."""
        return list(self.measured)

    def __len__(self) -> int:
        return len(self.measured)

    def without(self, names: Any) -> MapControl:
        """A copy without some images."""
        return replace(self, measured={name: one for name, one in self.measured.items() if name not in set(names)})

    def rows_of(self, names: list[str]) -> PoseRows:
        """The observations of the images of a block, zero for images that are not registered.

        Images with fewer unknown columns of the lens than others have zeros there.
        """
        n, found = len(names), [self.measured[name] for name in names if name in self.measured]
        r = max((len(one.offset) for one in found), default=1)
        lenses = max((one.by_lens.shape[1] for one in found), default=0)
        common: dict[str, np.ndarray] = {name: np.zeros((n, r)) for one in found for name in one.by_common}
        rows = PoseRows(
            np.zeros((n, 3)),
            np.broadcast_to(np.eye(3), (n, 3, 3)).copy(),
            np.zeros((n, r)),
            np.zeros((n, r, 6)),
            np.zeros((n, r, lenses)),
            common,
        )
        for k, name in enumerate(names):
            one = self.measured.get(name)
            if one is None:
                continue
            own = len(one.offset)
            rows.centre[k], rows.R_frame_from_camera[k] = one.centre, one.R_frame_from_camera
            rows.offset[k, :own], rows.by_pose[k, :own] = one.offset, one.by_pose
            rows.by_lens[k, :own, : one.by_lens.shape[1]] = one.by_lens
            for label, column in one.by_common.items():
                common[label][k, :own] = column
        return rows


def measured_by(
    frame: LocalFrame, camera: FrameCamera, found: Registration, terrain: AbstractTerrain, name: str
) -> Measured:
    """The map points of a registration as observations of the orientation of its image, in a frame.

    `camera` is that of the block, `terrain` the one of the registration, uncorrected. Raises `ValueError` for an image
    that is not registered, `TypeError` for a moving sensor.
    """
    check_is(found, Registration, f"registration of {name}")
    if not found.accepted or found.update is None or found.ties is None:
        raise ValueError(f"image {name} is not registered: {found.outcome.name}: {found.outcome.message}")
    return measured_in(frame, camera, found.update, found.ties, found.tie_errors, terrain, name)


def measured_in(
    frame: LocalFrame,
    camera: FrameCamera,
    update: Update,
    ties: TiePoints,
    tie_errors: TieErrors,
    terrain: AbstractTerrain,
    name: str,
) -> Measured:
    """As `measured_by`, from an update by ties, and their errors."""
    check_is(update.shot, Shot, f"motion of image {name}", "Tie points are of frame cameras at one exposure.")
    check_is(update.sensor.camera, FrameCamera, f"camera of image {name}", "Tie points are of frame cameras.")
    if not bool(np.all(np.asarray(update.ok))):
        raise ValueError(f"image {name} has no orientation update; its status is {int(np.asarray(update.status))}.")
    ties, tie_errors = checked_ties(ties), as_float64(tie_errors, "tie_errors")
    all_ties = padded(ties)
    weights = np.zeros(len(all_ties.used))
    weights[: ties.count] = np.asarray(update.weights)
    ground = ErrorModel(tuple(one for one in update.errors.sources if isinstance(one, OF_GROUND)))
    check_mapped_terrain(terrain)
    exposure = Exposure(update.sensor, update.shot, jnp.zeros(()), update.atmosphere)
    inputs = ModelInputs(exposure, terrain=of_arrays(terrain))
    has_air = update.atmosphere is not None
    given = (all_ties, jnp.asarray(weights), tie_errors)
    lens = jnp.asarray(interior_of(camera))
    centre, R, rows, own, by_up, heights = map(np.asarray, _rows(frame, camera, lens, inputs, ground, given, has_air))
    used = weights > 0.0
    heights = heights[np.ix_(used, used)] if tie_errors.terrain_field is not None else None
    rows = _whitened(rows[used], own[used], by_up[used], heights)
    columns = rows.shape[1] - 1
    size = 6 + len(lens)
    longer = np.concatenate([rows, np.zeros((columns + 1, columns + 1))])
    rows = np.asarray(np.linalg.qr(longer, mode="r"))[:columns]
    labels = (*SHIFT, *(f"map: {axis}" for axis in ground.axes))
    common = {label: rows[:, size + k] for k, label in enumerate(labels) if np.any(rows[:, size + k] != 0.0)}
    return Measured(centre, R, rows[:, -1], rows[:, :6], rows[:, 6:size], common, ties.count)


def _whitened(rows: np.ndarray, own: np.ndarray, by_up: np.ndarray, heights: np.ndarray | None) -> np.ndarray:
    """Rows (2 n, columns) with unit covariance from (n, 2, columns), the covariance (n, 2, 2) of each pixel in px2,
    and the covariance (n, n) of heights in m2 between different ties, if any."""
    if heights is None:
        return np.linalg.solve(np.linalg.cholesky(own), rows).reshape(-1, rows.shape[2])
    count = len(rows)
    apart = heights * (1.0 - np.eye(count))
    joint = np.einsum("ij,ia,jb->iajb", apart, by_up, by_up)
    joint[np.arange(count), :, np.arange(count)] += own
    lower = np.linalg.cholesky(joint.reshape(2 * count, 2 * count))
    return np.linalg.solve(lower, rows.reshape(2 * count, -1))


@batch_filter_jit
def _rows(
    frame: LocalFrame,
    camera: FrameCamera,
    lens: Float[Array, " lens"],
    inputs: ModelInputs,
    ground: ErrorModel,
    given: Any,
    has_air: bool,
) -> tuple[Array, ...]:
    """(centre, orientation, rows (n, 2, 6 + lens + common + 1), covariance (n, 2, 2) of each pixel in px2, its
    derivatives (n, 2) by height, covariance (n, n) of heights in m2 or of none).

    Rows are derivatives of predicted less measured pixels by pose, lens and common numbers, and the offset."""
    ties, weights, errors = given
    exposure = inputs.exposure
    shot: Any = exposure.motion
    sight = exposure.sensor.sight(shot)
    centre, R = frame.from_ecef(sight.centre), frame.R_ecef_from_local.T @ sight.R_ecef_from_camera
    root = ground.factor() if ground.size else jnp.zeros((0, 0))

    def one(uv: Any, lat: Scalar, lon: Scalar, height: Scalar, rise: Any = None) -> tuple[Array, ...]:
        position = Geodetic(lat=lat, lon=lon, height=height)
        R_enu, p_ecef = R_ecef_from_enu(position), WGS84.to_ecef(position)
        if rise is None:
            cell = _cell(inputs.terrain, p_ecef)
            normal, _ = WGS84.normal_and_height(p_ecef)
            p_ecef = p_ecef - inputs.terrain.clearance(p_ecef, cell) * normal
            over = lambda step: _height(inputs.terrain, p_ecef + R_enu[:, :2] @ step, cell)  # noqa: E731
            rise = jax.jacfwd(over)(jnp.zeros(2))
        along = R_enu[:, :2] + R_enu[:, 2:] * rise[None, :]

        def lift(error: Float[Array, " axes"]) -> Scalar:
            moved = ground.moved(inputs, error).terrain
            return _height(moved, p_ecef, _cell(inputs.terrain, p_ecef))

        def pixel(change: Float[Array, " changes"]) -> Float[Array, "2"]:
            pose, own, place = change[:6], change[6:-3], change[-3:]
            there = frame.from_ecef(p_ecef) + frame.R_ecef_from_local.T @ (R_enu @ place) - centre - pose[:3]
            away = R_from_rotation_vector(pose[3:]).T @ (R.T @ there)
            return pixel_of(with_interior(camera, lens + own), away)

        none = jnp.zeros(6 + lens.shape[0] + 3)
        by = jax.jacfwd(pixel)(none)
        to_enu = R_enu.T @ along
        by_map, by_up = by[:, -3:] @ to_enu, by[:, -1]
        by_shift = -by_map * jnp.asarray(errors.shift)
        by_ground = by_up[:, None] * (jax.jacfwd(lift)(jnp.zeros(ground.size)) @ root)[None, :]
        offset = pixel(none) - uv + (_bending(inputs, p_ecef) if has_air else 0.0)
        rows = jnp.concatenate([by[:, :-3], by_shift, by_ground, offset[:, None]], axis=1)
        return rows, by_map, by_up, p_ecef

    planes = () if ties.rise is None else (ties.rise,)
    rows, by_map, by_up, p_ecef = jax.vmap(one)(ties.uv, ties.lat, ties.lon, ties.height, *planes)
    place = ties.covariance + jnp.asarray(errors.registration) ** 2 * jnp.eye(2)[None]
    own = jnp.einsum("tij,tjk,tlk->til", by_map, place, by_map) + ties.pixel_sigma**2 * jnp.eye(2)[None]
    own = own + height_variances(errors, ties)[:, None, None] * by_up[:, :, None] * by_up[:, None, :]
    heights = jnp.zeros((0, 0))
    if errors.terrain_field is not None:
        axes = jax.vmap(lambda p: R_ecef_from_enu(WGS84.to_geodetic(p))[:, :2])(p_ecef)
        heights = height_covariances(errors.terrain_field, p_ecef, None if ties.sides is None else axes @ ties.sides)
    return centre, R, rows, own / jnp.maximum(weights, FAINT)[:, None, None], by_up, heights


def _bending(inputs: ModelInputs, p_ecef: Vector3) -> Float[Array, "2"]:
    """Change of a point's pixel by refraction, px."""
    exposure = inputs.exposure
    sensor, shot = exposure.sensor, exposure.motion
    assert isinstance(shot, Shot)
    both = [sensor.project_ecef(shot, p_ecef, air)[0] for air in (exposure.atmosphere, None)]
    return both[0] - both[1]


def _height(terrain: AbstractTerrain, p_ecef: Vector3, cell: Int[Array, "2"]) -> Scalar:
    """Height of the surface of a cell of the terrain above a point, m."""
    return -terrain.clearance(p_ecef, cell)


def _cell(terrain: AbstractTerrain, p_ecef: Vector3) -> Int[Array, "2"]:
    if not isinstance(terrain, Dem):
        return jnp.zeros(2, jnp.int32)
    return terrain.cell_of(jax.lax.stop_gradient(terrain.over(p_ecef)[0]))
