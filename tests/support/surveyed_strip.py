"""A simulated strip of nadir images with tie points, surveyed points and a navigation with a common offset."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from jaxgeo import Exposure, Geodetic, Pose, Shot
from jaxgeo.adjust import ImagePoints
from jaxgeo.studies.gu2017.scene import moved
from jaxgeo.ties import Control, Views
from jaxgeo.uncertainty import PerFlight, sources
from support.drone_strip import ABOVE, GROUND, SENSOR

COUNT, APART = 5, 40.0  # images, m between them
PIXEL, MARK, SURVEY = 0.2, 0.5, 0.03  # px, px, m
POSITION, OFFSET, ATTITUDE = 0.3, 2.0, np.deg2rad(0.2)
ERRORS = (
    sources.Position(np.full(3, POSITION)),
    sources.Position(np.full(3, OFFSET), sharing=PerFlight()),
    sources.Attitude(np.full(3, ATTITUDE)),
)
NAMES = [f"image {k}" for k in range(COUNT)]


@dataclass(frozen=True)
class Surveyed:
    """True and given views, measured tie points, and surveyed points with their true places in the frame of `true`."""

    true: Views
    given: Views
    ties: ImagePoints
    control: Control
    place: np.ndarray


def shots() -> list[Shot]:
    found = []
    for k in range(COUNT):
        lat = 47.0 + np.rad2deg(APART * k / 6.367e6)
        pose = Pose.from_degrees(lat=lat, lon=11.0, height=GROUND + ABOVE, heading=50.0 * k, pitch=4.0, roll=-3.0)
        found.append(Shot(pose, np.zeros(0), 2.0 * k))
    return found


def views_of(given: list[Shot]) -> Views:
    return Views.of(NAMES, [Exposure(SENSOR, one) for one in given], [ERRORS] * COUNT)


def pixels(views: Views, image: int, place: np.ndarray) -> np.ndarray:
    """By the collinearity equations."""
    there = (place - views.centre[image]) @ views.R_frame_from_camera[image]
    camera = views.camera_of(image)
    return np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * there[:, :2] / there[:, 2:]


def measured(views: Views, place: np.ndarray, names: list[str], least: int, sigma: float) -> ImagePoints:
    """Exact pixels of places in all images that show them, of those that `least` images show."""
    rows = []
    for image in range(COUNT):
        uv = pixels(views, image, place)
        inside = np.all((uv > 0.0) & (uv < [255.0, 191.0]), axis=1)
        rows += [(NAMES[image], names[k], uv[k]) for k in np.flatnonzero(inside)]
    points = [point for _, point, _ in rows]
    image, point, uv = zip(*[row for row in rows if points.count(row[1]) >= least], strict=True)
    return ImagePoints(list(image), list(point), np.array(uv), sigma)


def disturbed(seen: ImagePoints, rng: np.random.Generator) -> ImagePoints:
    return ImagePoints(seen.image, seen.point, seen.uv + seen.sigma * rng.normal(size=seen.uv.shape), seen.sigma)


def surveyed(seed: int, points: int = 8, check: tuple[str, ...] = ()) -> Surveyed:
    """A draw of all errors: of navigation (each image's, and a common offset), tie points, marks and survey."""
    rng = np.random.default_rng(seed)
    true = views_of(shots())
    offset = OFFSET * rng.normal(size=3)
    errors = [
        np.concatenate([offset + POSITION * rng.normal(size=3), ATTITUDE * rng.normal(size=3)]) for _ in range(COUNT)
    ]
    given = views_of([moved(shot, one[:3], one[3:]) for shot, one in zip(shots(), errors, strict=True)])
    middle = true.centre.mean(axis=0)
    flat = np.stack(np.meshgrid(np.linspace(-60, 60, 6), np.linspace(-130, 130, 12)), axis=-1).reshape(-1, 2)
    place = np.random.default_rng(1)
    ground = np.column_stack([middle[:2] + flat, middle[2] - ABOVE + place.uniform(-15.0, 15.0, len(flat))])
    ties = measured(true, ground, [f"tie {k}" for k in range(len(ground))], 2, PIXEL)
    flat = np.column_stack([place.uniform(-40.0, 40.0, points), np.linspace(-90.0, 90.0, points)])
    where = np.column_stack([middle[:2] + flat, middle[2] - ABOVE + place.uniform(-15.0, 15.0, points)])
    names = [f"p{k}" for k in range(points)]
    marks = disturbed(measured(true, where, names, 1, MARK), rng)
    known = where + SURVEY * rng.normal(size=where.shape)
    control = Control(names, positions(true, known), SURVEY, marks, check)
    return Surveyed(true, given, disturbed(ties, rng), control, where)


def positions(views: Views, place: np.ndarray) -> Geodetic:
    return views.frame.to_geodetic(place)


def errors_of(strip: Surveyed, centre: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Errors (n, 6) of orientations in the frame of the given views."""
    true, given = strip.true, strip.given
    place = np.asarray(given.frame.from_ecef(np.asarray(true.frame.to_ecef(true.centre))))
    turn = np.asarray(given.frame.R_ecef_from_local).T @ np.asarray(true.frame.R_ecef_from_local)
    turned = np.swapaxes(turn @ true.R_frame_from_camera, 1, 2) @ R
    return np.concatenate([centre - place, Rotation.from_matrix(turned).as_rotvec()], axis=1)
