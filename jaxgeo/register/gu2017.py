"""Formulas and Table 1 of Gu and Qiao (2017), "A method for high accuracy airborne optical image geolocation".

The conditions F(a, P) = 0 are two collinearity equations (the ground point P, ECEF in m, projects to its pixel with the
parameters a) and a height condition (P lies at the ground height h). The paper swaps A and B in Eqs 5 and 7; here J =
dF/da and B = dF/dP.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxgeo._locate import locate
from jaxgeo._typing import Matrix3, Scalar, Vector3
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.register.orientation_update import update_orientation
from jaxgeo.register.tie_errors import TieErrors
from jaxgeo.register.ties import TiePoints
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.terrain import ConstantHeight
from jaxgeo.uncertainty.linear import Propagation, propagate
from jaxgeo.uncertainty.metrics.ellipse import drms
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sources import CameraMounting, Position, TerrainHeight

Conditions = Float[Array, "ties rows"]
ByParameters = Float[Array, "ties rows axes"]
ByGround = Float[Array, "ties rows 3"]
Square = Float[Array, "axes axes"]


class Case(NamedTuple):
    """Standard deviations of a row of Table 1: position m, rotations deg, terrain height m, registration m."""

    position: float
    attitude_deg: float
    terrain: float
    registration: float


class Row(NamedTuple):
    """A case with its fixes by direct georeferencing and after the update."""

    case: Case
    direct: Propagation
    updated: Propagation

    @property
    def rms(self) -> tuple[Scalar, Scalar]:
        """Root mean square horizontal errors in m, direct and updated."""
        return drms(self.direct.cov_enu[:2, :2]), drms(self.updated.cov_enu[:2, :2])


CASES = (
    Case(10.0, 0.05, 5.0, 3.0),
    Case(50.0, 0.5, 5.0, 3.0),
    Case(100.0, 1.0, 5.0, 3.0),
    Case(100.0, 1.0, 20.0, 10.0),
    Case(100.0, 1.0, 30.0, 30.0),
)


def conditions(
    inputs: ModelInputs, model: ErrorModel, ties: Float[Array, "ties 2"], p_ecef: Float[Array, "ties 3"], height: Scalar
) -> tuple[Conditions, ByParameters, ByGround]:
    """F (ties, 3) in px, px, m of points imaged at `ties`, with J and B: Eqs 1 and 2 and their derivatives.

    The parameters are the axes of an error model without terrain sources; `height` is the ground height in m above the
    ellipsoid.
    """

    def of(error: Float[Array, " axes"], p: Vector3, uv: Float[Array, "2"]) -> Vector3:
        moved = model.moved(inputs, error)
        image, _, _ = image_of_point(moved.sensor, moved.motion, jnp.asarray(moved.time), p, moved.air)
        return jnp.append(image - uv, WGS84.normal_and_height(p)[1] - height)

    def one(p: Vector3, uv: Float[Array, "2"]) -> tuple[Vector3, Any]:
        none = jnp.zeros(model.size)
        return of(none, p, uv), jax.jacfwd(of, (0, 1))(none, p, uv)

    values, (J, B) = jax.vmap(one)(p_ecef, ties)
    return values, J, B


def ground_covariance(position: Geodetic, registration: Any, terrain: Any) -> Matrix3:
    """Eq 6: ECEF covariance, m2, of a tie's ground point from the standard deviations of registration and height."""
    R = R_ecef_from_enu(position)
    sigma = jnp.stack([jnp.asarray(registration), jnp.asarray(registration), jnp.asarray(terrain)])
    return (R * sigma[None, :] ** 2) @ R.T


def parameter_step(F: Conditions, J: ByParameters, W: Float[Array, "ties rows rows"]) -> Float[Array, " axes"]:
    """Eq 5, corrected and with weights W: -(J' W J)^-1 J' W F, to be added to the parameters."""
    scale = 1.0 / jnp.sqrt(jnp.einsum("tia,tij,tja->a", J, W, J))
    J = J * scale[None, None, :]
    return -scale * jnp.linalg.solve(jnp.einsum("tia,tij,tjb->ab", J, W, J), jnp.einsum("tia,tij,tj->a", J, W, F))


def parameter_covariance(J: ByParameters, B: ByGround, ground: Float[Array, "ties 3 3"], prior: Square) -> Square:
    """Eq 7, corrected and with a prior: [sum J' (B Sigma_P B')^-1 J + prior^-1]^-1.

    Uses the two collinearity rows, `J[:, :2]` and `B[:, :2]`: the tie's height error is then part of `ground`. With the
    third row, where h is exact, the terrain error would vanish.
    """
    inner = jnp.einsum("tij,tjk,tlk->til", B, ground, B)
    scale = jnp.sqrt(jnp.diagonal(prior))
    unit = scale[:, None] * scale[None, :]
    J = J * scale[None, None, :]
    information = jnp.einsum("tia,tib->ab", J, jnp.linalg.solve(inner, J))
    return unit * jnp.linalg.inv(information + jnp.linalg.inv(prior / unit))


def error_table(
    cases: Sequence[Case] = CASES,
    *,
    off_nadir_deg: float = 75.0,
    height: float = 10_000.0,
    ground: float = 500.0,
    field_of_view_deg: float = 10.0,
    ties: tuple[int, int] = (5, 4),
) -> tuple[Row, ...]:
    """Table 1: accuracy of the centre of an oblique image, by the navigation and after the update, case by case.

    The aircraft is `height` m above the ellipsoid, the ground `ground` m and level. The position has three independent
    errors, the camera three independent small rotations. (columns, rows) ties are spread over a square image; their
    pixels are exact, their ground positions have `registration` and `terrain` errors each, and the target has its own
    `terrain` error. The paper states neither a field of view nor a focal length.
    """
    sensor, shot = _camera(off_nadir_deg, height, field_of_view_deg)
    terrain = ConstantHeight(ground)
    columns, rows = ((jnp.arange(count) + 0.5) / count * PIXELS - 0.5 for count in ties)
    uv = jnp.stack([x.reshape(-1) for x in jnp.meshgrid(columns, rows)], axis=1)
    size = -(-uv.shape[0] // LOCATED) * LOCATED  # few sizes, so that few programs are compiled
    lat, lon, up = (x[: uv.shape[0]] for x in _places(sensor, shot, jnp.resize(uv, (size, 2)), terrain))
    place = Geodetic(lat=lat, lon=lon, height=up)
    points = TiePoints(uv, place, jnp.zeros((uv.shape[0], 2, 2)))
    return tuple(_row(case, sensor, shot, terrain, points) for case in cases)


@jax.jit
def _places(sensor: Sensor, shot: Shot, uv: Float[Array, "ties 2"], terrain: ConstantHeight) -> tuple[Array, ...]:
    place = jax.vmap(lambda uv: locate(sensor, shot, uv, terrain))(uv).position
    return jnp.asarray(place.lat), jnp.asarray(place.lon), jnp.asarray(place.height)


PIXELS = 2000
LOCATED = 32  # pixels per batch
MIDDLE = (0.5 * (PIXELS - 1), 0.5 * (PIXELS - 1))


def _camera(off_nadir_deg: float, height: float, field_of_view_deg: float) -> tuple[Sensor, Shot]:
    focal_px = 0.5 * PIXELS / jnp.tan(jnp.deg2rad(0.5 * field_of_view_deg))
    camera = FrameCamera.from_pixels(focal_px=focal_px, width=PIXELS, height=PIXELS)
    sensor = Sensor(camera, Gimbal.two_axis(), Mount.nadir())
    pose = Pose.from_degrees(lat=30.0, lon=104.0, height=height, heading=0.0)
    return sensor, Shot(pose, sensor.gimbal.readings_from_degrees(outer=off_nadir_deg, inner=0.0))


def _row(case: Case, sensor: Sensor, shot: Shot, terrain: ConstantHeight, ties: TiePoints) -> Row:
    angle = case.attitude_deg
    navigation = (
        Position.from_ned(north=case.position, east=case.position, down=case.position),
        CameraMounting.from_degrees(forward=angle, right=angle, down=angle),
    )
    with_height = (*navigation, TerrainHeight.from_metres(case.terrain))
    direct = propagate(sensor, shot, MIDDLE, terrain, ErrorModel(with_height))
    tie_errors = TieErrors(registration=case.registration, terrain=case.terrain)
    updated = update_orientation(sensor, shot, ties, terrain, ErrorModel(navigation), tie_errors)
    return Row(case, direct, updated.fix(MIDDLE, case.terrain))
