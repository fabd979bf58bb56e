"""Simulated tie points of strips of drone images, some of them wrong, and the errors of poses corrected by them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgeo import Pose, Shot
from jaxgeo.adjust import ImagePoints
from jaxgeo.studies.gu2017.scene import disturbed
from jaxgeo.ties import Correction, Views
from support.drone_strip import ABOVE, CAMERA, DEGREES, GROUND, METRES, views_of

SIGMA = 0.1  # px, of a right measurement
SEARCHED = 12.0  # px: half width of the search area of a match
RELIEF = 6.0  # m, standard deviation of the heights of points
MOVED = (1.5, 1.0, 0.0)  # m from image to image, of what moves
KINDS = ("none", "area", "anywhere", "moving", "joined")


class Simulated(NamedTuple):
    """Views with the navigation and with the true poses, and measurements of which some are `wrong` (k,)."""

    given: Views
    true: Views
    observations: ImagePoints
    wrong: np.ndarray


def simulated(
    count: int, overlap: float, kind: str, share: float, seed: int, points: int = 40, strips: int = 1
) -> Simulated:
    """Strips of images with about `points` points each, `share` of the measurements (of the points, if they are
    "moving" or "joined") wrong.

    Wrong measurements lie in the "area" that a search covers, or "anywhere" in the image; points that are "moving"
    have one common shift on the ground from image to image; in "joined" tracks later images show another point.
    """
    rng = np.random.default_rng([seed, count, round(100 * overlap), 5])
    true, given = _shots(count, overlap, strips, rng)
    names = [f"image {k:02d}" for k in range(len(true))]
    of_true, of_given = views_of(names, true), views_of(names, given)
    ground = _ground(of_true, points, rng)
    moves = rng.random(len(ground)) < share if kind == "moving" else np.zeros(len(ground), bool)
    joins = rng.random(len(ground)) < share if kind == "joined" else np.zeros(len(ground), bool)
    other = ground[np.roll(np.arange(len(ground)), 1)]
    rows = []
    for row in range(len(true)):
        place = ground + np.where(moves[:, None], row * np.array(MOVED), 0.0)
        late = joins & (rng.random(len(ground)) < 0.5)
        uv, seen = _pixels(of_true, row, np.where(late[:, None], other, place))
        rows += [(names[row], f"tie {k}", uv[k], moves[k] or late[k]) for k in np.flatnonzero(seen)]
    image, point, uv, wrong = zip(*rows, strict=True)
    uv, wrong = np.array(uv) + SIGMA * rng.normal(size=(len(uv), 2)), np.array(wrong)
    if kind in ("area", "anywhere"):
        wrong = rng.random(len(uv)) < share
        random = rng.uniform([0.0, 0.0], [CAMERA.width - 1.0, CAMERA.height - 1.0], uv.shape)
        near = uv + rng.uniform(-SEARCHED, SEARCHED, uv.shape)
        uv = np.where(wrong[:, None], random if kind == "anywhere" else near, uv)
    observed = ImagePoints(list(image), list(point), uv, SIGMA)
    often = np.isin(observed.point, observed.seen_often().point)
    return Simulated(of_given, of_true, observed.of(often), wrong[often])


def _shots(count: int, overlap: float, strips: int, rng: np.random.Generator) -> tuple[list[Shot], list[Shot]]:
    """True and given shots of strips to the north, half an image apart."""
    step = (1.0 - overlap) * CAMERA.height / float(np.mean(np.asarray(CAMERA.focal_px))) * ABOVE
    apart = 0.5 * CAMERA.width / float(np.mean(np.asarray(CAMERA.focal_px))) * ABOVE
    true = []
    for strip in range(strips):
        for k in range(count):
            north, east = step * (k - 0.5 * (count - 1)), apart * strip
            tilt = rng.normal(0.0, 3.0, 3)
            pose = Pose.from_degrees(
                lat=47.0 + np.rad2deg(north / 6.367e6),
                lon=11.0 + np.rad2deg(east / 6.367e6 / np.cos(np.deg2rad(47.0))),
                height=GROUND + ABOVE + float(rng.normal(0.0, 2.0)),
                heading=float(tilt[0]) + 180.0 * (strip % 2),
                pitch=float(tilt[1]),
                roll=float(tilt[2]),
            )
            true.append(Shot(pose, np.zeros(0)))
    return true, [disturbed(one, rng, metres=METRES, degrees=DEGREES) for one in true]


def _ground(true: Views, points: int, rng: np.random.Generator) -> np.ndarray:
    """Ground points (m, 3) in the frame: about `points` on each image."""
    low, high = true.centre[:, :2].min(axis=0) - 90.0, true.centre[:, :2].max(axis=0) + 90.0
    size = np.array([CAMERA.width, CAMERA.height]) / float(np.mean(np.asarray(CAMERA.focal_px))) * ABOVE
    number = int(points * np.prod(high - low) / np.prod(size))
    place = rng.uniform(low, high, (number, 2))
    level = np.mean(true.centre[:, 2]) - ABOVE
    return np.column_stack([place, level + RELIEF * rng.normal(size=number)])


def _pixels(views: Views, row: int, ground: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(pixels (m, 2), whether they are on the image) of ground points."""
    there = (ground - views.centre[row]) @ views.R_frame_from_camera[row]
    uv = np.asarray(CAMERA.principal_px) + np.asarray(CAMERA.focal_px) * there[:, :2] / there[:, 2:]
    return uv, np.all((uv > 1.0) & (uv < np.array([CAMERA.width, CAMERA.height]) - 2.0), axis=1)


def squared_errors(here: Simulated, found: Correction) -> tuple[list[float], float]:
    """Squared errors of the adjusted poses by their covariance: each image's, of 6 degrees of freedom, and jointly."""
    rows = [here.true.name.tolist().index(name) for name in found.names]
    frame, images, count = here.given.frame, found.adjustment.images, len(rows)
    exact = np.asarray(frame.from_ecef(np.asarray(here.true.frame.to_ecef(here.true.centre[rows]))))
    turn = np.asarray(frame.R_ecef_from_local).T @ np.asarray(here.true.frame.R_ecef_from_local)
    turned = np.swapaxes(turn @ here.true.R_frame_from_camera[rows], 1, 2) @ images.R_frame_from_camera
    errors = np.hstack([images.centre - exact, Rotation.from_matrix(turned).as_rotvec()])
    each = zip(errors, found.adjustment.covariance_of_images, strict=True)
    covariance = found.adjustment.covariance[: 6 * count, : 6 * count]
    flat = errors.ravel()
    return [float(e @ np.linalg.solve(c, e)) for e, c in each], float(flat @ np.linalg.solve(covariance, flat))
