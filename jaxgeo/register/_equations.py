"""Observation equations of the orientation update: tie residuals, weights and normal equations."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxgeo._record import Record
from jaxgeo._typing import Flag, Matrix3, Scalar, StatusCode, Vector3
from jaxgeo.adjust.losses import AbstractLoss, Huber
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.observation import Exposure
from jaxgeo.register.prior import Prior
from jaxgeo.register.tie_errors import (
    AbstractTiePropagation,
    AbstractWhitener,
    Blocks,
    Pixels,
    Sensitivity,
    TieErrors,
    Weights,
    height_covariances,
    information_of,
    inverse_roots,
    robust_weights,
    tie_covariances,
    whitener,
)
from jaxgeo.register.ties import PaddedTies
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.status import Status, seen_beside
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs

Cells = Int[Array, "ties 2"]
Unknowns = Float[Array, " unknowns"]
Square = Float[Array, "unknowns unknowns"]


class Problem(Record):
    """Forward-model inputs and error model of the navigation, tie points and their errors, and the prior.

    `heights` in m2 are the covariances between the terrain heights of different ties, if they are correlated.
    """

    inputs: ModelInputs
    model: ErrorModel
    ties: PaddedTies
    tie_errors: TieErrors
    prior: Prior
    loss: AbstractLoss
    propagation: AbstractTiePropagation
    heights: Float[Array, "ties ties"] | None = None


class Equations(NamedTuple):
    """Residuals of ties in px, their weights, and the normal equations; each unknown is scaled to unit standard
    deviation.

    `status` is the status of the first tie without an image, else `hit`; `cells` are the terrain cells that contain the
    ties.
    """

    residuals: Pixels
    covariances: Blocks
    weights: Weights
    whiten: AbstractWhitener
    normal: Square
    gradient: Unknowns
    status: StatusCode
    cells: Cells


def on_surface(terrain: AbstractTerrain, p_ecef: Vector3, cell: Int[Array, "2"] | None = None) -> Vector3:
    """The point of the terrain, or of one cell's surface, on the vertical of a point in ECEF, m."""
    cell = _cell(terrain, p_ecef) if cell is None else cell
    normal, _ = WGS84.normal_and_height(p_ecef)
    return p_ecef - terrain.clearance(p_ecef, cell) * normal


def equations_about(
    problem: Problem, factor: Square, exposure: Exposure, place: Unknowns, settled: Flag, cells: Cells | None = None
) -> Equations:
    """Residuals and normal equations at a linearisation point, with ties on `cells` or on the cells that contain
    them."""
    ties, count = problem.ties, problem.model.size
    unknowns = jnp.asarray(problem.prior.mean) + factor @ place
    about = dataclasses.replace(problem.inputs, exposure=exposure)
    places, R = _places(problem, unknowns[-2:])
    cells = cells_of(problem, place, factor) if cells is None else cells
    given = (places, R, cells) if ties.rise is None else (places, R, cells, ties.rise)

    def images(change: Float[Array, " changes"]) -> tuple[Pixels, Any]:
        return _images(problem, about, unknowns, change, given)

    derivatives, (uv, statuses) = jax.jacfwd(images, has_aux=True)(jnp.zeros(count + 5))
    by_error, by_surface, by_enu = jnp.split(derivatives, [count, count + 2], axis=2)
    has_image = seen_beside(statuses, uv) == Status.hit
    has_row = ties.used & has_image
    residuals = jnp.where(ties.used[:, None], jnp.where(has_row[:, None], ties.uv - uv, jnp.inf), 0.0)

    sensitivity = Sensitivity(problem.propagation.along(by_surface, by_enu), by_enu[:, :, 2])
    cov = tie_covariances(ties, problem.tie_errors, sensitivity)
    roots = inverse_roots(cov)
    weights = robust_weights(problem.loss, roots, residuals, ties)
    weights = jnp.where(settled, weights, robust_weights(Huber(), roots, residuals, ties))
    whiten = whitener(cov, roots, weights, ties, problem.heights, sensitivity.by_height)

    jacobian = jnp.concatenate([-by_error, by_surface], axis=2)
    jacobian = jnp.where(has_row[:, None, None], jacobian, 0.0)
    rows = jnp.concatenate([jnp.einsum("tij,jk->tik", jacobian, factor), residuals[:, :, None]], axis=2)
    rows = whiten(rows)
    normal = information_of(rows[:, :-1]) + jnp.eye(count + 2)
    gradient = rows[:, :-1].T @ rows[:, -1] + place
    unseen = ties.used & ~has_image
    worst = jnp.where(jnp.any(unseen), statuses[jnp.argmax(unseen)], Status.hit.code)
    return Equations(residuals, cov, weights, whiten, normal, gradient, worst, cells)


def with_heights(problem: Problem) -> Problem:
    """The problem with the covariances between the heights of its ties, at the places of the prior: steps of an update
    move ties by much less than the field's length."""
    field, ties = problem.tie_errors.terrain_field, problem.ties
    if field is None:
        return problem
    p_ecef, R = _places(problem, jnp.asarray(problem.prior.mean)[-2:])
    sides = None if ties.sides is None else R[:, :, :2] @ ties.sides
    return dataclasses.replace(problem, heights=height_covariances(field, p_ecef, sides))


def cells_of(problem: Problem, place: Unknowns, factor: Square) -> Cells:
    """Terrain cells that contain the ties."""
    shift = jnp.asarray(problem.prior.mean)[-2:] + (factor @ place)[-2:]
    places, _ = _places(problem, shift)
    return jax.vmap(lambda p: _cell(problem.inputs.terrain, p))(places)


def _images(
    problem: Problem, inputs: ModelInputs, unknowns: Unknowns, change: Float[Array, " changes"], ties: Any
) -> tuple[Pixels, Any]:
    """Pixels of the ties, and the tuple (pixels, statuses), after three consecutive changes.

    `change` stacks the error vector, shifts along the surface (east, north) and shifts of the points (east, north, up),
    m. One function, so that it is compiled once.
    """
    error, along, enu = jnp.split(change, [problem.model.size, problem.model.size + 2])
    moved = problem.model.moved(inputs, error).exposure
    terrain = problem.model.moved(problem.inputs, unknowns[:-2] + error).terrain

    def image(
        place: Vector3, R: Matrix3, cell: Int[Array, "2"], rise: Float[Array, "2"] | None = None
    ) -> tuple[Float[Array, "2"], StatusCode]:
        p_ecef = place + R[:, :2] @ along
        if rise is None:
            p_ecef = on_surface(terrain, p_ecef, cell)
        else:
            lift = problem.inputs.terrain.clearance(place, cell) - terrain.clearance(place, cell)
            p_ecef = p_ecef + R[:, 2] * (jnp.sum(rise * along) + lift)
        p_ecef = p_ecef + R @ enu
        uv, status, _ = image_of_point(moved.sensor, moved.motion, jnp.asarray(moved.time), p_ecef, moved.atmosphere)
        return uv, status

    uv, statuses = jax.vmap(image)(*ties)
    return uv, (uv, statuses)


def _places(problem: Problem, shift: Float[Array, "2"]) -> tuple[Float[Array, "ties 3"], Float[Array, "ties 3 3"]]:
    """(true positions of the ties, map position less map shift, in ECEF, m, on the terrain or on their own planes;
    their ENU frames)."""
    ties = problem.ties

    def place(lat: Scalar, lon: Scalar, height: Scalar, *rise: Float[Array, "2"]) -> tuple[Vector3, Matrix3]:
        position = Geodetic(lat=lat, lon=lon, height=height)
        R, p_ecef = R_ecef_from_enu(position), WGS84.to_ecef(position)
        if rise:
            return p_ecef - R[:, :2] @ shift - R[:, 2] * jnp.sum(rise[0] * shift), R
        return on_surface(problem.inputs.terrain, p_ecef) - R[:, :2] @ shift, R

    planes = () if ties.rise is None else (ties.rise,)
    return jax.vmap(place)(ties.lat, ties.lon, ties.height, *planes)


def _cell(terrain: AbstractTerrain, p_ecef: Vector3) -> Int[Array, "2"]:
    if not isinstance(terrain, Dem):
        return jnp.zeros(2, jnp.int32)
    return terrain.cell_of(jax.lax.stop_gradient(terrain.over(p_ecef)[0]))
