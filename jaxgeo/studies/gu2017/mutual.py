"""Mutual correction of several images of one scene without a map, the next step that the paper names: errors before and
after, and their prediction."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy  # submodules load on first use

from jaxgeo.adjust import ImagePoints
from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.observation import Exposure
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.studies.gu2017.fixes import alike
from jaxgeo.studies.gu2017.scene import (
    ABOVE,
    AZIMUTH,
    OFF_NADIR,
    Imaged,
    looking_at,
    moved,
    points_seen,
    target_on,
)
from jaxgeo.ties import Correction, Views, correct
from jaxgeo.uncertainty import PerFlight, sources

COUNTS = (2, 4, 8)  # images
BASE = 600.0  # m to the north from image to image; the ground in the middle of an image is 3.3 km wide
NAVIGATION = ((10.0, 0.05), (50.0, 0.5))  # m, deg: of the first two rows of the paper's table
SHARED = 0.5  # of the variance of the navigation errors, common to all images of a flight
NOISE = 0.5  # px, standard deviation of a measured tie point along columns and rows
ACROSS, DOWN = 6, 4  # tie points of each image, which all images measure that see them
MARGIN = 20.0  # px
DRAWS = 8  # of the navigation errors and the measurements, for each row
BOUNDS = (0.0005, 0.9995)  # chi-square quantiles between which squared errors over predicted must lie


class Mutual(NamedTuple):
    """Mutual correction of `images` with one navigation (m, deg) in several `draws`, without a map.

    Root mean squares in m on the ground at its true height: `relative` of the distance between the places of one point
    in neighbouring images, `absolute` of the error of the place of a pixel, `common` of their mean over the images,
    which tie points do not show; each (before, after, predicted after). `squares` are the mean squares of the errors
    after by their predicted covariances: of the relative places, and of the absolute ones, with their 99.9 %
    chi-square `bounds`. `better` is the number of draws in which neighbours agree better than before, `refused` that
    of those without a correction, which are in no mean. `hidden` names the shared errors of which more than nine tenths
    are left in the first draw. `points` is the number of tie points, `seconds` the time of a correction, without the
    first, which compiles.
    """

    position: float
    attitude_deg: float
    images: int
    draws: int
    refused: int
    points: int
    relative: tuple[float, float, float]
    absolute: tuple[float, float, float]
    common: tuple[float, float, float]
    squares: tuple[float, float]
    bounds: tuple[tuple[float, float], tuple[float, float]]
    better: int
    hidden: tuple[str, ...]
    seconds: float

    @property
    def share(self) -> float:
        """Share of the squared absolute error after the correction that is common to all images."""
        return (self.common[1] / self.absolute[1]) ** 2

    @property
    def predicted_right(self) -> bool:
        """Whether both mean squares lie within their bounds."""
        return all(low <= one <= high for one, (low, high) in zip(self.squares, self.bounds, strict=True))


class _Flight(NamedTuple):
    """True shots, and true ground points: of all ties, (m, 3) in ECEF, that in the middle of each image, (n, 3), and
    that in the middle of each pair of neighbours, (n - 1, 3)."""

    sensor: Sensor
    shots: list[Shot]
    ties: np.ndarray
    middles: np.ndarray
    between: np.ndarray


def mutual(
    im: Imaged, seed: int = 0, draws: int = DRAWS, counts: Sequence[int] = COUNTS, cases: Sequence = NAVIGATION
) -> list[Mutual]:
    """Mutual correction with each navigation and number of images; empty for an image that is not simulated."""
    if im.ground is None:
        return []
    rows = []
    for position, attitude in cases:
        for count in counts:
            flight = _flight(im, count)
            seeds = [[seed, count, round(100.0 * attitude), draw, 13] for draw in range(draws)]
            rows.append(_row(flight, (position, attitude), [np.random.default_rng(one) for one in seeds]))
    return rows


def _flight(im: Imaged, count: int) -> _Flight:
    """Images to the north one after the other, with a lattice of tie points in each."""
    assert im.ground is not None
    north = BASE * (np.arange(count) - 0.5 * (count - 1))
    shots = [
        looking_at(target_on(im.ground, x), off_nadir=OFF_NADIR, azimuth=AZIMUTH, above=ABOVE) for x in north.tolist()
    ]
    size = _size(im.sensor)
    t = [(np.arange(n) + 0.5) / n * side - 0.5 for n, side in zip((ACROSS, DOWN), size, strict=True)]
    uv = np.concatenate([np.stack(np.meshgrid(*t), axis=-1).reshape(-1, 2), 0.5 * (size[None] - 1.0)])
    seen = np.stack([points_seen(*alike((im.sensor, shot)), im.ground, uv) for shot in shots])
    if not np.isfinite(seen[:, -1]).all():
        raise ValueError("the middle of an image sees no ground; the flight leaves the elevation model.")
    ties = seen[:, :-1].reshape(-1, 3)
    middles = seen[:, -1]
    between = np.stack([_nearest(ties, 0.5 * (middles[k] + middles[k + 1])) for k in range(count - 1)])
    return _Flight(im.sensor, shots, ties[np.isfinite(ties[:, 0])], middles, between)


def _nearest(points: np.ndarray, place: np.ndarray) -> np.ndarray:
    return points[np.nanargmin(np.linalg.norm(points - place, axis=1))]


def _size(sensor: Sensor) -> np.ndarray:
    return np.array([getattr(sensor.camera, "width"), getattr(sensor.camera, "height")], float)  # noqa: B009


def _row(flight: _Flight, case: tuple[float, float], draws: Sequence[np.random.Generator]) -> Mutual:
    true = _views(flight, flight.shots, case)
    names = true.name
    uv, inside = _images(flight, true)
    points = np.flatnonzero(np.count_nonzero(inside, axis=0) >= 2)
    image, point = np.nonzero(inside[:, points])
    exact = uv[image, points[point]]
    tables, squares, spent, hidden, n = [], [], [], (), len(names)
    refused = 0
    for rng in draws:
        given = _views(flight, _disturbed(flight.shots, case, rng), case)
        measured = exact + NOISE * rng.normal(size=exact.shape)
        observed = ImagePoints(names[image], [f"tie {k}" for k in points[point]], measured, NOISE)
        began = time.perf_counter()
        try:
            found = correct(given, observed)
        except ValueError:  # of too many ties rejected, with errors of the navigation that are too large for so few
            refused += 1
            continue
        spent.append(time.perf_counter() - began)
        if not hidden:
            hidden = tuple(found.hidden)
        of_draw = _errors(flight, true, given, found)
        tables.append(of_draw[0])
        squares.append(of_draw[1])
    if not tables:
        raise ValueError(f"none of {len(draws)} draws of {n} images with errors of {case} m, deg could be corrected.")
    table = np.sqrt(np.mean(np.square(tables), axis=0))
    freedom = [len(tables) * size for size in (2 * (n - 1), 2 * n)]
    bounds = [_bounds(k) for k in freedom]
    each = np.array(tables)
    relative, absolute, common = ((float(a), float(b), float(c)) for a, b, c in table)
    of_squares = np.sum(squares, axis=0) / freedom
    return Mutual(
        *case,
        images=n,
        draws=len(draws),
        refused=refused,
        points=len(points),
        relative=relative,
        absolute=absolute,
        common=common,
        squares=(float(of_squares[0]), float(of_squares[1])),
        bounds=(bounds[0], bounds[1]),
        better=int(np.count_nonzero(each[:, 0, 1] < each[:, 0, 0])),
        hidden=hidden,
        seconds=float(np.mean(spent[1:] or spent)),
    )


def _bounds(freedom: int) -> tuple[float, float]:
    low, high = scipy.stats.chi2.ppf(BOUNDS, freedom) / freedom
    return float(low), float(high)


def _errors_of(case: tuple[float, float]) -> tuple[sources.Position | sources.Attitude, ...]:
    """Sources of the navigation: errors of each image, and errors that all images of the flight share."""
    made = []
    for share, options in ((1.0 - SHARED, {}), (SHARED, {"sharing": PerFlight()})):
        metres, degrees = (float(np.sqrt(share)) * sigma for sigma in case)
        made.append(sources.Position.from_ned(north=metres, east=metres, down=metres, **options))
        made.append(sources.Attitude.from_degrees(heading=degrees, pitch=degrees, roll=degrees, **options))
    return tuple(made)


def _views(flight: _Flight, shots: Sequence[Shot], case: tuple[float, float]) -> Views:
    exposures = [Exposure(*alike((flight.sensor, shot)), jnp.asarray(0.0)) for shot in shots]
    errors = _errors_of(case)
    return Views.of([f"image {k + 1}" for k in range(len(shots))], exposures, [errors] * len(shots))


def _disturbed(shots: Sequence[Shot], case: tuple[float, float], rng: np.random.Generator) -> list[Shot]:
    """Shots with errors of the navigation: a common one, and one of each."""
    sigma = np.repeat([case[0], np.deg2rad(case[1])], 3)
    common = np.sqrt(SHARED) * sigma * rng.normal(size=6)
    own = np.sqrt(1.0 - SHARED) * sigma[None] * rng.normal(size=(len(shots), 6))
    return [moved(shot, error[:3], error[3:]) for shot, error in zip(shots, common[None] + own, strict=True)]


def _images(flight: _Flight, true: Views) -> tuple[np.ndarray, np.ndarray]:
    """(exact pixels (n, m, 2) of the tie points in all images, whether they lie on them), hidden ground aside."""
    camera = true.camera_of(0)
    ground = np.asarray(true.frame.from_ecef(jnp.asarray(flight.ties)))
    there = np.einsum("nmi,nij->nmj", ground[None] - true.centre[:, None], true.R_frame_from_camera)
    uv = np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * there[..., :2] / there[..., 2:]
    return uv, np.all((uv > MARGIN) & (uv < _size(flight.sensor) - 1.0 - MARGIN), axis=2)


class _Placed(NamedTuple):
    """Places (n, 2) to the east and north, m, at the height of ground points, of their pixels in one image each, and
    their derivatives (n, 2, 6) by the centre, m, and the rotation about the camera's axes, rad."""

    place: np.ndarray
    by_pose: np.ndarray


def _placed(
    true: Views, rows: np.ndarray, ground: np.ndarray, frame: LocalFrame, centre: np.ndarray, R: np.ndarray
) -> _Placed:
    """Places of the pixels that truly show ground points (n, 3), ECEF, by orientations in a frame."""
    at = np.asarray(true.frame.from_ecef(jnp.asarray(ground)))
    in_camera = np.einsum("ni,nij->nj", at - true.centre[rows], true.R_frame_from_camera[rows])
    height = np.asarray(frame.from_ecef(jnp.asarray(ground)))[:, 2]
    ray = np.einsum("nij,nj->ni", R[rows], in_camera)
    scale = (height - centre[rows, 2]) / ray[:, 2]
    place = centre[rows] + scale[:, None] * ray
    # A change of the ray's end by d moves the place by d - ray d_up / ray_up.
    fall = np.eye(3)[None] - ray[:, :, None] * np.eye(3)[2] / ray[:, 2, None, None]
    skew = np.cross(np.eye(3)[None], in_camera[:, None, :])  # rows: unit vectors of the rotation, times the ray
    turned = scale[:, None, None] * np.einsum("nij,nkj->nik", R[rows], skew)
    by_pose = np.concatenate([fall, fall @ turned], axis=2)[:, :2]
    return _Placed(place[:, :2], by_pose)


def _errors(flight: _Flight, true: Views, given: Views, found: Correction) -> tuple[np.ndarray, tuple[float, float]]:
    """((relative, absolute, common) by (before, after, predicted after), sums of squares of the relative and of the
    absolute errors by their covariances)."""
    frame, images, n = given.frame, found.adjustment.images, len(given)
    covariance = found.adjustment.covariance[: 6 * n, : 6 * n]
    sets = ((given.centre, given.R_frame_from_camera), (images.centre, images.R_frame_from_camera))
    rows = np.arange(n)
    table = np.zeros((3, 3))
    for k, (centre, R) in enumerate(sets):
        middle = _placed(true, rows, flight.middles, frame, centre, R)
        truth = np.asarray(frame.from_ecef(jnp.asarray(flight.middles)))[:, :2]
        first, second = (_placed(true, part, flight.between, frame, centre, R) for part in (rows[:-1], rows[1:]))
        absolute, relative = middle.place - truth, second.place - first.place
        table[:, k] = [_rms(relative), _rms(absolute), float(np.linalg.norm(absolute.mean(axis=0)))]
    by = np.zeros((n, 2, n, 6))
    by[rows, :, rows] = middle.by_pose
    apart = np.zeros((n - 1, 2, n, 6))
    apart[rows[:-1], :, rows[1:]] = second.by_pose
    apart[rows[:-1], :, rows[:-1]] -= first.by_pose
    common = by.mean(axis=0).reshape(2, 6 * n)
    by, apart = by.reshape(2 * n, 6 * n), apart.reshape(2 * (n - 1), 6 * n)
    covs = [J @ covariance @ J.T for J in (apart, by, common)]
    counts = (n - 1, n, 1)
    table[:, 2] = [float(np.sqrt(np.trace(cov) / count)) for cov, count in zip(covs, counts, strict=True)]
    return table, (_squares(relative, covs[0]), _squares(absolute, covs[1]))


def _squares(errors: np.ndarray, covariance: np.ndarray) -> float:
    return float(errors.ravel() @ np.linalg.solve(covariance, errors.ravel()))


def _rms(offsets: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(offsets**2, axis=1))))
