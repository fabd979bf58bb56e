"""The equations of Gu and Qiao (2017) as printed, in NumPy, compared with the package at the same inputs.

Eqs 1, 2, 4 and 6 are pictures in the available copy; they are taken in the form described by the text around them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._locate import locate
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_ned
from jaxgeo.observation import Exposure
from jaxgeo.register import TieErrors, TiePoints, update_orientation
from jaxgeo.register.gu2017 import conditions, ground_covariance, parameter_covariance, parameter_step
from jaxgeo.sensor import FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.sensor.exposure import image_of_point
from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.terrain import ConstantHeight
from jaxgeo.uncertainty import ErrorModel, propagate, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs

PAPER = "Gu 2017"
LAT, LON, HEIGHT, OFF_NADIR = 30.0, 104.0, 10_000.0, 75.0  # deg, deg, m, deg
GROUND = 500.0  # m
FOCAL, SIDE = 5700.0, 1000  # px
POSITION, ATTITUDE, TERRAIN, REGISTRATION = 50.0, 0.5, 5.0, 3.0  # m, deg, m, m
COLUMNS, ROWS = 5, 4  # ties
STEP = (1.0, 1e-5, 1.0)  # m, rad, m: finite difference steps
START = (30.0, -20.0, 15.0, 2e-3, -1e-3, 3e-3)  # m north, east, down; rad about the camera's axes

Array = np.ndarray


class Inputs(NamedTuple):
    """A camera 10 km up that looks 75 deg off nadir to the north at level ground, with 20 ties and their ground
    points: `points` (n, 3) in ECEF m of pixels `uv` (n, 2), the aperture `S` in ECEF m, `R_camera_from_ecef`."""

    sensor: Sensor
    shot: Shot
    uv: Array
    points: Array
    S: Array
    R_camera_from_ecef: Array
    R_ecef_from_ned: Array
    errors: ErrorModel


def inputs() -> Inputs:
    """The inputs of all equations."""
    camera = FrameCamera.from_pixels(focal_px=FOCAL, width=SIDE, height=SIDE)
    sensor = Sensor(camera, Gimbal.fixed(), Mount.nadir())
    pose = Pose.from_degrees(lat=LAT, lon=LON, height=HEIGHT, heading=0.0, pitch=OFF_NADIR)
    shot = Shot(pose)
    sides = [(np.arange(count) + 0.5) / count * SIDE - 0.5 for count in (COLUMNS, ROWS)]
    uv = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    points = np.asarray(_seen(sensor, shot, jnp.asarray(uv)))
    S, R = (np.asarray(x) for x in _axes(pose.position))
    # A nadir camera (right, down, forward) has the axes east, south, down; the pitch turns it about the east.
    angle = math.radians(OFF_NADIR)
    right, forward = np.array([0.0, 1.0, 0.0]), np.array([math.sin(angle), 0.0, math.cos(angle)])
    camera_from_ned = np.stack([right, np.cross(forward, right), forward])
    errors = ErrorModel(
        (
            sources.Position.from_ned(north=POSITION, east=POSITION, down=POSITION),
            sources.CameraMounting.from_degrees(forward=ATTITUDE, right=ATTITUDE, down=ATTITUDE),
        )
    )
    return Inputs(sensor, shot, uv, points, S, camera_from_ned @ R.T, R, errors)


# ------------------------------------------------------------------------------- the formulas as printed


def collinearity(S: Array, R: Array, point: Array) -> Array:
    """Eq 1: x = f (a11 (X - XS) + a12 (Y - YS) + a13 (Z - ZS)) / (a31 (X - XS) + a32 (Y - YS) + a33 (Z - ZS)),
    y with a21, a22, a23; from the principal point, axes to the right and down."""
    a = R @ (point - S)
    return FOCAL * a[:2] / a[2]


def height_condition(point: Array, h: float) -> float:
    """Eq 2: (X^2 + Y^2) / (a + h)^2 + Z^2 / (b + h)^2 - 1."""
    a, b = float(WGS84.a), float(WGS84.b)
    return float((point[0] ** 2 + point[1] ** 2) / (a + h) ** 2 + point[2] ** 2 / (b + h) ** 2 - 1.0)


def fix_covariance(A: Array, cov_parameters: Array, B: Array) -> Array:
    """Eq 3: (B' (A Sigma_par A')^-1 B)^-1."""
    return np.linalg.inv(B.T @ np.linalg.inv(A @ cov_parameters @ A.T) @ B)


def step_as_printed(B: Array, F: Array) -> Array:
    """Eq 5: (B' B)^-1 (B' F), B as in Eq 3."""
    return np.linalg.solve(B.T @ B, B.T @ F)


def tie_covariance(lat: float, lon: float, registration: float, terrain: float) -> Array:
    """Eq 6: T diag(registration^2, registration^2, terrain^2) T', T to ECEF from east, north, up."""
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    T = np.array([[-sl, -s * cl, c * cl], [cl, -s * sl, c * sl], [0.0, c, s]])
    return T @ np.diag([registration**2, registration**2, terrain**2]) @ T.T


# ------------------------------------------------------------------------------- derivatives, by differences


def moved_conditions(of: Inputs, errors: Array, point: Array, uv: Array) -> Array:
    """Eqs 1 and 2 (px, px, m) with the camera moved by m north, east, down, turned by rad about its axes, and the
    ground raised by m. Navigation angles refer to the local level, which turns as the camera moves."""
    S = of.S + of.R_ecef_from_ned @ errors[:3]
    R = _small_turn(errors[3:6]) @ of.R_camera_from_ecef @ of.R_ecef_from_ned @ _level(errors[:3]).T
    a = float(WGS84.a)
    third = 0.5 * a * height_condition(point, GROUND + errors[6])
    return np.append(collinearity(S, R, point) + 0.5 * (SIDE - 1) - uv, third)


def derivatives(of: Inputs, point: Array, uv: Array) -> tuple[Array, Array]:
    """(A (3, 7) by the parameters and the height, B (3, 3) by the ground point), central differences."""
    steps = np.repeat(STEP, (3, 3, 1))
    none = np.zeros(7)
    A = [_slope(lambda e: moved_conditions(of, e, point, uv), none, k, steps[k]) for k in range(7)]
    B = [_slope(lambda p: moved_conditions(of, none, p, uv), point, k, 1.0) for k in range(3)]
    return np.stack(A, axis=1), np.stack(B, axis=1)


def _slope(function: Callable[[Array], Array], at: Array, k: int, step: float) -> Array:
    there, back = at.copy(), at.copy()
    there[k], back[k] = at[k] + step, at[k] - step
    return (function(there) - function(back)) / (2.0 * step)


def _level(ned: Array) -> Array:
    """Axes of north, east, down in ECEF at a point `ned` m from the aperture."""
    a, b, lat = float(WGS84.a), float(WGS84.b), math.radians(LAT)
    squared = 1.0 - (b / a) ** 2
    bend = 1.0 - squared * math.sin(lat) ** 2
    across = a / math.sqrt(bend)
    along = across * (1.0 - squared) / bend
    lon = math.radians(LON) + ned[1] / ((across + HEIGHT) * math.cos(lat))
    lat = lat + ned[0] / (along + HEIGHT)
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, 0.0, -s]])


def _small_turn(w: Array) -> Array:
    """Rotation by a vector of rad (Rodrigues)."""
    angle = float(np.linalg.norm(w))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = w / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * K @ K


# ------------------------------------------------------------------------------- the claims


def equations_of() -> list[Claim]:
    """Claims of Eqs 1 to 7, except Eq 4, which is a claim about images."""
    of = inputs()
    return [eq1(of), eq2(of), eq3(of), *eq5(of), eq6(of), *eq7(of)]


def eq1(of: Inputs) -> Claim:
    """Collinearity."""
    chosen = (0, 7, 12, 19)
    printed = [collinearity(of.S, of.R_camera_from_ecef, of.points[k]) + 0.5 * (SIDE - 1) for k in chosen]
    ours = [np.asarray(_imaged(of.sensor, of.shot, jnp.asarray(of.points[k]))) for k in chosen]
    return Claim(
        PAPER,
        "Eq. 1",
        "pixels of four ground points, 75 deg off nadir",
        [float(x) for x in np.ravel(printed)],
        [float(x) for x in np.ravel(ours)],
        1e-6,
        "px",
        "jaxgeo.project",
        reason="The formula in the form that its text describes; the sign of f goes with the camera's axes.",
        digits=".3f",
    )


def eq2(of: Inputs) -> Claim:
    """The surface at a height."""
    heights = (500.0, 3000.0, 8000.0)
    latitudes = np.radians([20.0, 45.0, 70.0])
    found, expected = [], []
    for lat, h in zip(latitudes, heights, strict=True):
        a, b = float(WGS84.a), float(WGS84.b)
        c, s = math.cos(lat), math.sin(lat)
        whole = math.hypot((a + h) * c, (b + h) * s)
        point = np.array([(a + h) ** 2 * c, 0.0, (b + h) ** 2 * s]) / whole  # of Eq 2, with the normal at lat
        found.append(float(_height(jnp.asarray(point))))
        expected.append(whole - math.hypot(a * c, b * s))  # between parallel tangent planes
    cause = "a + h and b + h make an ellipsoid, which a surface of one height is not quite (up to 1.2 cm at 8000 m)"
    return Claim(
        PAPER,
        "Eq. 2",
        "height of points that meet the equation for 500, 3000, 8000 m, at latitudes 20, 45, 70 deg",
        list(heights),
        found,
        1e-4,
        "m",
        "jaxgeo.earth.WGS84.to_geodetic",
        Explanation(cause, expected, found, 1e-6),
        digits=".4f",
    )


def eq3(of: Inputs) -> Claim:
    """Covariance of a fix."""
    k = 7
    A, B = derivatives(of, of.points[k], of.uv[k])
    sigmas = np.repeat([POSITION, math.radians(ATTITUDE), TERRAIN], (3, 3, 1))
    printed = fix_covariance(A, np.diag(sigmas**2), B)
    height = sources.TerrainHeight.from_metres(TERRAIN)
    model = ErrorModel((*of.errors.sources, height))
    found = propagate(of.sensor, of.shot, tuple(of.uv[k]), ConstantHeight(GROUND), model)
    R = np.asarray(found.nominal.R_ecef_from_enu)
    ours = R @ np.asarray(found.cov_enu) @ R.T
    upper = np.triu_indices(3)
    return Claim(
        PAPER,
        "Eq. 3",
        "covariance in ECEF (XX XY XZ YY YZ ZZ), 50 m, 0.5 deg, 5 m",
        [float(x) for x in printed[upper]],
        [float(x) for x in ours[upper]],
        1e-8 * float(np.trace(ours)),
        "m2",
        "jaxgeo.uncertainty.propagate",
        reason="The height of the ground is taken among the parameters: without it A Sigma A' is singular.",
        digits=".6g",
    )


def eq5(of: Inputs) -> list[Claim]:
    """The step of the parameters, and its convergence to the fit of the ties (Fig. 3)."""
    start = np.append(START, 0.0)
    F = np.stack([moved_conditions(of, start, p, uv) for p, uv in zip(of.points, of.uv, strict=True)])
    A, B = zip(*(_derivatives_at(of, start, p, uv) for p, uv in zip(of.points, of.uv, strict=True)), strict=True)
    A2, B2, F2 = np.concatenate([a[:2, :6] for a in A]), np.concatenate([b[:2] for b in B]), F[:, :2].reshape(-1)
    printed = step_as_printed(B2, F2)
    righted = -step_as_printed(A2, F2)
    ours = np.asarray(parameter_step(jnp.asarray(F[:, :2]), *_rows_and_weights(A)))
    return [
        Claim(
            PAPER,
            "Eq. 5",
            "unknowns in a step",
            float(len(printed)),
            float(len(ours)),
            0.0,
            "",
            "jaxgeo.register.gu2017.parameter_step",
            Explanation(
                "A and B have changed places: B, by the ground, gives three unknowns; the derivatives by the six "
                "parameters and the sign -F give the step",
                [float(x) for x in righted],
                [float(x) for x in ours],
                [1e-6 * max(1.0, abs(x)) for x in ours],
            ),
            digits=".5g",
        ),
        _iterated(of),
    ]


def _iterated(of: Inputs) -> Claim:
    """Fig. 3: Par + Delta until Delta is below a threshold."""
    errors, lengths = np.append(START, 0.0), []
    for _ in range(20):
        A = [_derivatives_at(of, errors, p, uv)[0] for p, uv in zip(of.points, of.uv, strict=True)]
        F = np.stack([moved_conditions(of, errors, p, uv)[:2] for p, uv in zip(of.points, of.uv, strict=True)])
        step = np.asarray(parameter_step(jnp.asarray(F), *_rows_and_weights(A)))
        errors[:6] += step
        lengths.append(float(np.linalg.norm(step[:3])))
        if lengths[-1] < 1e-4:
            break
    left = float(np.linalg.norm(errors[:3]))
    steps = ", ".join(f"{x:.2g}" for x in lengths)
    return Claim(
        PAPER,
        "Fig. 3",
        "steps of Eq 5 added to the parameters fall below a threshold, at the true parameters",
        True,
        lengths[-1] < 1e-4 and left < 1e-2,
        0.0,
        "",
        "jaxgeo.register.gu2017.parameter_step",
        reason=f"From 39 m and 0.2 deg off, with 20 exact ties: steps of the position {steps} m; {left:.1e} m off "
        "then.",
    )


def eq6(of: Inputs) -> Claim:
    """Covariance of a tie's ground point."""
    lat, lon = math.radians(LAT), math.radians(LON)
    printed = tie_covariance(lat, lon, REGISTRATION, TERRAIN)
    ours = np.asarray(ground_covariance(Geodetic(lat=lat, lon=lon, height=GROUND), REGISTRATION, TERRAIN))
    upper = np.triu_indices(3)
    return Claim(
        PAPER,
        "Eq. 6",
        "covariance of a tie in ECEF (XX XY XZ YY YZ ZZ), 3 m and 5 m",
        [float(x) for x in printed[upper]],
        [float(x) for x in ours[upper]],
        1e-9,
        "m2",
        "jaxgeo.register.gu2017.ground_covariance",
        digits=".5f",
    )


def eq7(of: Inputs) -> list[Claim]:
    """Covariance of the parameters; by the formula, and by the update."""
    A, B = zip(*(derivatives(of, p, uv) for p, uv in zip(of.points, of.uv, strict=True)), strict=True)
    lat, lon = (np.asarray(x) for x in _placed(jnp.asarray(of.points)))
    grounds = [tie_covariance(*place, REGISTRATION, TERRAIN) for place in zip(lat, lon, strict=True)]
    swapped = np.zeros((3, 3))
    normal = np.zeros((6, 6))
    for a, b, ground in zip(A, B, grounds, strict=True):
        inner = np.linalg.inv(b[:2] @ ground @ b[:2].T)
        normal += a[:2, :6].T @ inner @ a[:2, :6]
        swapped += b[:2].T @ inner @ b[:2]
    sigmas = np.repeat([POSITION, math.radians(ATTITUDE)], 3)
    righted = _sigmas(np.linalg.inv(normal + np.diag(sigmas**-2.0)))
    inputs = ModelInputs(Exposure(of.sensor, of.shot, jnp.asarray(0.0)), terrain=ConstantHeight(GROUND))
    _, J, by_ground = _conditions(inputs, of.errors, jnp.asarray(of.uv), jnp.asarray(of.points), jnp.asarray(GROUND))
    prior = jnp.asarray(of.errors.covariance())
    ours = _sigmas(np.asarray(parameter_covariance(J[:, :2], by_ground[:, :2], jnp.asarray(np.stack(grounds)), prior)))
    updated = _updated_sigmas(of)
    return [
        Claim(
            PAPER,
            "Eq. 7",
            "parameters that have a covariance",
            float(len(swapped)),
            float(len(prior)),
            0.0,
            "",
            "jaxgeo.register.gu2017.parameter_covariance",
            Explanation(
                "A and B have changed places; righted, and with the navigation as prior, standard deviations of the "
                "position north, east, down in m and along the axes of the ellipsoid of the three angles in deg",
                righted,
                ours,
                [1e-6 * x for x in ours],
            ),
            digits=".4g",
        ),
        Claim(
            PAPER,
            "Eq. 7, update",
            "position north, east, down, m, and angles, deg, by the righted equation; and by the update",
            righted,
            updated,
            [1e-6 * x for x in righted],
            "",
            "jaxgeo.register.update_orientation",
            reason="Printed: the equation with A and B in their places, and the navigation as prior.",
            digits=".4g",
        ),
    ]


def _updated_sigmas(of: Inputs) -> list[float]:
    lat, lon = (np.asarray(x) for x in _placed(jnp.asarray(of.points)))
    ties = TiePoints(of.uv, Geodetic(lat=lat, lon=lon, height=np.zeros(len(lat))), np.zeros((len(lat), 2, 2)))
    tie_errors = TieErrors(registration=REGISTRATION, terrain=TERRAIN)
    found = update_orientation(of.sensor, of.shot, ties, ConstantHeight(GROUND), of.errors, tie_errors)
    return _sigmas(np.asarray(found.cov_error))


def _sigmas(cov: Array) -> list[float]:
    """Standard deviations of the position, m, and of the angles along the axes of their ellipsoid, deg, independent
    of the angles' own axes."""
    angles = np.degrees(np.sqrt(np.linalg.eigvalsh(cov[3:, 3:])))
    return [float(x) for x in (*np.sqrt(np.diag(cov)[:3]), *angles)]


def _rows_and_weights(A: Sequence[Array]) -> tuple[jax.Array, jax.Array]:
    J = np.stack([a[:2, :6] for a in A])
    return jnp.asarray(J), jnp.broadcast_to(jnp.eye(2), (len(J), 2, 2))


def _derivatives_at(of: Inputs, errors: Array, point: Array, uv: Array) -> tuple[Array, Array]:
    """`derivatives` at a camera with errors."""
    steps = np.repeat(STEP, (3, 3, 1))
    A = [_slope(lambda e: moved_conditions(of, e, point, uv), errors, k, steps[k]) for k in range(7)]
    B = [_slope(lambda p: moved_conditions(of, errors, p, uv), point, k, 1.0) for k in range(3)]
    return np.stack(A, axis=1), np.stack(B, axis=1)


_conditions = eqx.filter_jit(conditions)


@eqx.filter_jit
def _seen(sensor: Sensor, shot: Shot, uv: jax.Array) -> jax.Array:
    return jax.vmap(lambda pixel: jnp.asarray(locate(sensor, shot, pixel, ConstantHeight(GROUND)).ecef))(uv)


@eqx.filter_jit
def _axes(position: Geodetic) -> tuple[jax.Array, jax.Array]:
    return WGS84.to_ecef(position), R_ecef_from_ned(position)


@eqx.filter_jit
def _imaged(sensor: Sensor, shot: Shot, point: jax.Array) -> jax.Array:
    return image_of_point(sensor, shot, jnp.asarray(0.0), point, None)[0]


@jax.jit
def _height(point: jax.Array) -> jax.Array:
    return jnp.asarray(WGS84.to_geodetic(point).height)


@jax.jit
def _placed(points: jax.Array) -> tuple[jax.Array, jax.Array]:
    def one(p: jax.Array) -> tuple[jax.Array, jax.Array]:
        place = WGS84.to_geodetic(p)
        return jnp.asarray(place.lat), jnp.asarray(place.lon)

    return jax.vmap(one)(points)
