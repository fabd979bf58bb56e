"""Map coordinates of fixes, ellipses, cameras and samples, in degrees."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxgeo.earth import WGS84
from jaxgeo.plot.relief import Box, metres_per_degree
from jaxgeo.report.data import ReportData
from jaxgeo.report.details import Detail
from jaxgeo.uncertainty.metrics import error_ellipse

MOST_FIXES = 4000  # on a map; more are thinned evenly
MOST_SAMPLES = 1500  # per fix on a map
RING = 64  # vertices of an ellipse
LEAST = 40.0  # m, least extent of a map


class Places(NamedTuple):
    """Coordinates in deg, longitudes unwrapped; `index` (k,) are the pixels of the fixes shown, `camera` is (k, 2)."""

    index: np.ndarray
    fix: np.ndarray
    camera: np.ndarray
    box: Box

    @property
    def is_one_camera(self) -> bool:
        """Whether all pixels have the same camera position."""
        return bool(np.all(np.abs(self.camera - self.camera[:1]) < 1e-9))


class Ellipse(NamedTuple):
    """Error ellipse: ring (n, 2) in deg, semi-axes in m, azimuth of the major axis in deg, description.

    `is_linear` is false for the circle of a fix without a covariance.
    """

    ring: np.ndarray
    major: float
    minor: float
    azimuth_deg: float
    what: str
    is_linear: bool = True


def places_of(subject: ReportData, details: Sequence[Detail]) -> Places:
    """Positions of fixes and cameras, and their bounding box."""
    found = np.flatnonzero(subject.has_place)
    index = found if len(found) <= MOST_FIXES else found[np.linspace(0, len(found) - 1, MOST_FIXES).astype(int)]
    position = subject.fixes.position
    fix = np.stack([np.rad2deg(np.asarray(x)[index]) for x in (position.lon, position.lat)], axis=-1)
    pixels = index if len(index) else np.arange(min(len(subject), MOST_FIXES))
    camera = _cameras(subject, pixels)
    regions = [np.array(one.region.polygon.bounds).reshape(2, 2) for one in details if one.region is not None]
    every = [fix, camera, *(detail.outline for detail in details), *regions]
    whole = np.concatenate([part[np.isfinite(part).all(axis=1)] for part in every])
    if not len(whole):
        return Places(index, fix, camera, Box(-1.0, -1.0, 1.0, 1.0))
    middle = whole[0, 0]
    fix, camera = (np.column_stack([unwrapped(part[:, 0], middle), part[:, 1]]) for part in (fix, camera))
    lon = unwrapped(whole[:, 0], middle)
    box = Box(float(lon.min()), float(whole[:, 1].min()), float(lon.max()), float(whole[:, 1].max()))
    radii = [float(np.nanmax(one.ring[:, 1]) - np.nanmin(one.ring[:, 1])) for one in _rings(subject, details)]
    least = max(LEAST, *(1.2 * radius * metres_per_degree(box.centre[1])[1] for radius in radii)) if radii else LEAST
    return Places(index, fix, camera, box.grown(0.08, least))


def unwrapped(lon_deg: np.ndarray, middle: float) -> np.ndarray:
    """Longitudes wrapped to within 180 deg of `middle`."""
    return middle + np.remainder(lon_deg - middle + 180.0, 360.0) - 180.0


def _cameras(subject: ReportData, index: np.ndarray) -> np.ndarray:
    """Camera positions (k, 2), longitude and latitude in deg, of the indexed pixels."""
    position = subject.shots.pose.position
    lonlat = [np.rad2deg(np.asarray(x)) for x in (position.lon, position.lat)]
    is_each = subject.axes[1] == 0
    return np.stack([x[index] if is_each else np.full(len(index), float(x)) for x in lonlat], axis=-1)


def _rings(subject: ReportData, details: Sequence[Detail]) -> list[Ellipse]:
    return [one for detail in details if (one := ellipse_of(subject, detail.index, detail)) is not None]


def ellipse_of(subject: ReportData, index: int, detail: Detail | None) -> Ellipse | None:
    """Error ellipse of a fix at the report's probability; a circle if there is no covariance."""
    if subject.accuracy is None or not subject.is_fix[index]:
        return None
    cov = np.asarray(subject.accuracy.cov_enu)[index]
    bias = np.asarray(subject.accuracy.bias_enu)[index]
    level = f"{100.0 * subject.probability:.10g} %"
    if np.isfinite(cov).all():
        one = error_ellipse(cov[:2, :2], subject.probability)
        major, minor, azimuth = (float(x) for x in (one.major, one.minor, one.azimuth))
        what = f"{level} ellipse, linear"
        return Ellipse(
            _ring(subject, index, bias[:2], major, minor, azimuth), major, minor, math.degrees(azimuth), what
        )
    radius = float(np.asarray(subject.accuracy.circular)[index])
    if not math.isfinite(radius):
        return None
    what = f"{level} circle, sampled" if detail is None else f"{level} circle, from the samples shown"
    return Ellipse(_ring(subject, index, np.zeros(2), radius, radius, 0.0), radius, radius, 0.0, what, False)


def _ring(
    subject: ReportData, index: int, centre: np.ndarray, major: float, minor: float, azimuth: float
) -> np.ndarray:
    turn = np.linspace(0.0, 2.0 * np.pi, RING)
    ahead, aside = major * np.cos(turn), minor * np.sin(turn)
    east = centre[0] + ahead * math.sin(azimuth) + aside * math.cos(azimuth)
    north = centre[1] + ahead * math.cos(azimuth) - aside * math.sin(azimuth)
    return around(subject, index, east, north)


def around(subject: ReportData, index: int, east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Longitude and latitude (n, 2) in deg of points at offsets `east`, `north` in m from a fix."""
    position = subject.fix(index).position
    lat, lon, height = (float(x) for x in (position.lat, position.lon, position.height))
    M, N = (
        float(WGS84.meridian_radius(jax.numpy.asarray(lat))),
        float(WGS84.prime_vertical_radius(jax.numpy.asarray(lat))),
    )
    turned = lon + east / ((N + height) * max(math.cos(lat), 1e-9)), lat + north / (M + height)
    return np.rad2deg(np.stack(turned, axis=-1))


def rings_of(polygon: Any) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """(x, y) of the outer ring of a polygon, then of its holes, as bokeh draws them."""
    rings = [np.asarray(ring.coords) for ring in (polygon.exterior, *polygon.interiors)]
    return [ring[:, 0] for ring in rings], [ring[:, 1] for ring in rings]


def cloud_of(subject: ReportData, detail: Detail) -> tuple[np.ndarray, np.ndarray]:
    """(longitude and latitude (n, 2) in deg of a subset of the samples of a fix, mask of those on other ground)."""
    points, jumped = samples_of(detail, MOST_SAMPLES)
    if not len(points):
        return np.zeros((0, 2)), jumped
    return around(subject, detail.index, points[:, 0], points[:, 1]), jumped


def samples_of(detail: Detail, most: int) -> tuple[np.ndarray, np.ndarray]:
    """(errors (n, 3) in m, ENU, of up to `most` samples with a fix, mask of those on other ground)."""
    if detail.checked is None:
        return np.zeros((0, 3)), np.zeros(0, bool)
    sampled, beyond = detail.checked.sampled, detail.checked.beyond_gap
    errors = np.asarray(sampled.errors_enu)
    found = np.flatnonzero(np.isfinite(errors[:, 0]))
    found = found[:: max(-(-len(found) // most), 1)]
    return errors[found] + sampled.centre_enu, beyond[found]
