"""A simulated strip of drone images with exact tie points, and registrations of some of them to a map that errs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxgeo import ConstantHeight, Exposure, Geodetic, Pose, Shot
from jaxgeo.adjust import ImagePoints
from jaxgeo.earth import R_ecef_from_ned
from jaxgeo.register import Outcome, Registration, TieErrors, TiePoints, update_orientation
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.ties import Views
from jaxgeo.uncertainty import ErrorModel, PerFlight, TimeCorrelated, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs
from support.drone_strip import ABOVE, GROUND, SENSOR

APART, STEP = 40.0, 2.0  # m and s between images
PIXEL = 0.2  # px
POSITION, OFFSET, ATTITUDE, BORESIGHT = 0.3, 2.0, np.deg2rad(0.2), np.deg2rad(0.3)
DURATION, STRENGTH = 20.0, 0.9
ERRORS = (
    sources.Position(np.full(3, POSITION)),
    sources.Position(np.full(3, OFFSET), sharing=PerFlight()),
    sources.Attitude(np.full(3, ATTITUDE), sharing=TimeCorrelated(DURATION, strength=STRENGTH)),
    sources.Boresight(np.full(3, BORESIGHT)),
)
TIE_ERRORS = TieErrors(registration=0.4, terrain=0.5, shift=0.6)
TERRAIN = ConstantHeight(jnp.asarray(GROUND))
WIDTH, HEIGHT = 256, 192


@dataclass(frozen=True)
class Drawn:
    """Views of the true and of the given navigation, measurements of tie points, and what the map has wrong.

    `shift` (2,) m is that of the map to the east and north.
    """

    true: Views
    given: Views
    seen: ImagePoints
    shift: np.ndarray
    rng: np.random.Generator


def shots(count: int) -> list[Shot]:
    """A strip to the north, with headings, tilts and heights that vary."""
    found = []
    for k in range(count):
        lat = 47.0 + np.rad2deg(APART * k / 6.367e6)
        height = GROUND + ABOVE + 3.0 * (k % 3)
        pose = Pose.from_degrees(lat=lat, lon=11.0, height=height, heading=7.0 * k, pitch=4.0 * (-1) ** k, roll=-3.0)
        found.append(Shot(pose, np.zeros(0), STEP * k))
    return found


def views_of(given: list[Shot], errors: Any = ERRORS) -> Views:
    names = [f"image {k:02d}" for k in range(len(given))]
    return Views.of(names, [Exposure(SENSOR, one) for one in given], [errors] * len(given))


def moved(shot: Shot, model: ErrorModel, error: np.ndarray) -> Shot:
    """The shot whose camera is where errors of the model put it, the mount's errors in its attitude."""
    inputs = model.moved(ModelInputs(Exposure(SENSOR, shot), terrain=TERRAIN), jnp.asarray(error)).exposure
    assert isinstance(inputs.motion, Shot)
    sight = inputs.sensor.sight(inputs.motion)
    position = inputs.motion.pose.position
    R_body_from_camera = np.asarray(SENSOR.mount.R_body_from_base) @ np.asarray(SENSOR.mount.R_head_from_camera)
    R = np.asarray(R_ecef_from_ned(position)).T @ np.asarray(sight.R_ecef_from_camera) @ R_body_from_camera.T
    return Shot(Pose(position, *heading_pitch_roll_from_R(jnp.asarray(R))), np.zeros(0), shot.time)


def errors_drawn(count: int, rng: np.random.Generator) -> np.ndarray:
    """Errors (n, 12) of the images along the axes of `ERRORS`, of their joint distribution."""
    time = STEP * np.arange(count)
    alike = STRENGTH * np.exp(-np.abs(np.subtract.outer(time, time)) / DURATION)
    np.fill_diagonal(alike, 1.0)
    fading = np.linalg.cholesky(alike) @ rng.normal(size=(count, 3))
    parts = [
        POSITION * rng.normal(size=(count, 3)),
        np.broadcast_to(OFFSET * rng.normal(size=3), (count, 3)),
        ATTITUDE * fading,
        np.broadcast_to(BORESIGHT * rng.normal(size=3), (count, 3)),
    ]
    return np.hstack(parts)


def pixels(centre: np.ndarray, R: np.ndarray, ground: np.ndarray) -> np.ndarray:
    there = (ground - centre) @ R
    camera = SENSOR.camera
    return np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * there[:, :2] / there[:, 2:]  # pyright: ignore


def drawn(seed: int, count: int = 12, longest: int = 5, points: int = 14, disturbed: bool = True) -> Drawn:
    """A strip with drawn errors; each ground point is measured in some of `longest` images, one after the other.

    `points` ground points lie around the nadir of each image, at heights of +- 10 m about the terrain.
    """
    rng, layout = np.random.default_rng([seed, 5]), np.random.default_rng(5)  # one layout, so that shapes are the same
    true = views_of(shots(count))
    model = ErrorModel(ERRORS)
    errors = errors_drawn(count, rng) if disturbed else np.zeros((count, 12))
    given = views_of([moved(shot, model, one) for shot, one in zip(shots(count), errors, strict=True)])
    ground = np.concatenate(
        [
            true.centre[k]
            + np.column_stack([layout.uniform(-70, 70, points), layout.uniform(-50, 50, points), np.zeros(points)])
            for k in range(count)
        ]
    )
    level = np.asarray(true.frame.from_geodetic(shots(1)[0].pose.position))[2] - ABOVE
    ground[:, 2] = level + layout.uniform(-10.0, 10.0, len(ground))
    first = np.full(len(ground), count)
    rows = []
    for k in range(count):
        uv = pixels(true.centre[k], true.R_frame_from_camera[k], ground)
        inside = np.all((uv > 0.0) & (uv < [WIDTH - 1, HEIGHT - 1]), axis=1)
        first[inside] = np.minimum(first[inside], k)
        inside &= k < first + longest
        uv = uv + PIXEL * disturbed * rng.normal(size=uv.shape)
        rows += [(str(true.name[k]), f"tie {number}", uv[number]) for number in np.flatnonzero(inside)]
    image, point, uv = zip(*rows, strict=True)
    observed = ImagePoints(list(image), list(point), np.array(uv), PIXEL).seen_often()
    shift = float(np.asarray(TIE_ERRORS.shift)) * rng.normal(size=2) * disturbed
    return Drawn(true, given, observed, shift, rng)


def registered(of: Drawn, row: int, errors: TieErrors = TIE_ERRORS, blunder: Any = (0.0, 0.0), across: int = 5) -> Any:
    """The registration of an image by a lattice of ties with the map, whose errors are drawn from `errors`.

    `blunder` (2,) m to the east and north is added to all positions on the map.
    """
    true, rng = of.true, of.rng
    u, v = np.meshgrid(np.linspace(20, WIDTH - 20, across), np.linspace(15, HEIGHT - 15, across))
    uv = np.column_stack([u.ravel(), v.ravel()])
    exact = not np.any(of.shift) and not np.any(blunder)
    camera = SENSOR.camera
    rays = np.column_stack([(uv - np.asarray(camera.principal_px)) / np.asarray(camera.focal_px), np.ones(len(uv))])  # pyright: ignore
    rays = rays @ true.R_frame_from_camera[row].T
    heights = GROUND + (0.0 if exact else float(np.asarray(errors.terrain))) * rng.normal(size=len(uv))
    place = true.centre[row] + rays * (-ABOVE / rays[:, 2:])
    for _ in range(6):  # to the height above the ellipsoid
        off = np.asarray(true.frame.to_geodetic(place).height) - heights
        place = place - rays * (off / rays[:, 2])[:, None]
    sigma = 0.0 if exact else float(np.asarray(errors.registration))
    place[:, :2] += of.shift + np.asarray(blunder) + sigma * rng.normal(size=(len(uv), 2))
    found = true.frame.to_geodetic(place)
    ground = Geodetic(lat=found.lat, lon=found.lon, height=jnp.zeros(len(uv)))
    ties = TiePoints(uv, ground, np.zeros((len(uv), 2, 2)), 0.1)
    shot = of.given.exposure[row].motion
    update = update_orientation(SENSOR, shot, ties, TERRAIN, ErrorModel(ERRORS), errors)
    return Registration(Outcome.registered, update.sensor, update.shot, update.terrain, update, errors, ties, ())


def errors_of(of: Drawn, names: list[str], centre: np.ndarray, R: np.ndarray, frame: Any = None) -> np.ndarray:
    """Errors (n, 6) of orientations in a frame: centre in m, rotation about the camera's axes in rad."""
    frame = of.given.frame if frame is None else frame
    rows = [of.true.name.tolist().index(name) for name in names]
    place = np.asarray(frame.from_ecef(np.asarray(of.true.frame.to_ecef(of.true.centre[rows]))))
    turn = np.asarray(frame.R_ecef_from_local).T @ np.asarray(of.true.frame.R_ecef_from_local)
    turned = np.swapaxes(turn @ of.true.R_frame_from_camera[rows], 1, 2) @ R
    return np.concatenate([centre - place, Rotation.from_matrix(turned).as_rotvec()], axis=1)
