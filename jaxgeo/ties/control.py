"""Ground control of a block: surveyed points, their pixels, and whether these agree with the navigation."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo.adjust import GroundPoints, ImagePoints, LocalFrame
from jaxgeo.adjust.initial_points import camera_rays
from jaxgeo.adjust.records import Names, as_names
from jaxgeo.earth import Geodetic
from jaxgeo.ties.views import Views

FAR = 10.0  # standard deviations between ray and point by the navigation: if more, these are of different places
INTERIOR = 0.005  # rad: standard deviation of a ray by errors of the camera
HOPELESS = 30.0  # standard deviations of pixels, added to them: control that fits worse is of another datum
SHOWN = 3


@dataclass(frozen=True)
class Control:
    """m surveyed points and their pixels in images.

    `name` (m,) are unique names, `position` (m,) geodetic positions, `sigma_enu` their standard deviations east, north,
    up in m (a number, (3,) or (m, 3)). `marks` are the measured pixels, of points of these names; a point may be in one
    image only. Points named in `check` are held back: they do not enter the correction, and show its accuracy.

    Raises `ValueError` for duplicate names, sigmas that are not positive and finite, positions that are not finite, a
    point without a pixel, a pixel without a point, and unknown names in `check`.
    """

    name: Names
    position: Geodetic
    sigma_enu: Any
    marks: ImagePoints
    check: Sequence[str] = ()

    def __post_init__(self) -> None:
        name = as_names(self.name, "name")
        if not len(name):
            raise ValueError("control must have at least one point.")
        sigma = np.asarray(self.sigma_enu, np.float64)
        if sigma.shape not in ((), (3,), (len(name), 3)):
            raise ValueError(f"sigma_enu must be a number, (3,) or ({len(name)}, 3), in m; got shape {sigma.shape}.")
        sigma = np.broadcast_to(sigma, (len(name), 3)).copy()
        if not np.all((sigma > 0.0) & np.isfinite(sigma)):
            row = int(np.argmin(np.all((sigma > 0.0) & np.isfinite(sigma), axis=1)))
            raise ValueError(
                f"point {name[row]}: sigma_enu must be positive and finite, in m; got {sigma[row].tolist()}."
            )
        leaves = [np.asarray(x, np.float64) for x in (self.position.lat, self.position.lon, self.position.height)]
        if any(leaf.shape != (len(name),) for leaf in leaves):
            raise ValueError(f"position must have an entry for each of {len(name)} points; got {leaves[0].shape}.")
        if not np.all(np.isfinite(leaves)):
            raise ValueError(f"point {name[int(np.argmin(np.all(np.isfinite(leaves), axis=0)))]} has no finite place.")
        _check_names(name, self.marks, self.check)
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "sigma_enu", sigma)
        object.__setattr__(self, "position", Geodetic(lat=leaves[0], lon=leaves[1], height=leaves[2]))
        object.__setattr__(self, "check", tuple(dict.fromkeys(self.check)))

    def __len__(self) -> int:
        return len(self.name)

    @property
    def is_check(self) -> np.ndarray:
        """Flags (m,) of the points held back."""
        return np.isin(self.name, list(self.check))

    @property
    def used_marks(self) -> ImagePoints:
        """Pixels of the points that enter the correction."""
        return self.marks.of(~np.isin(self.marks.point, list(self.check)))

    def ground(self, frame: LocalFrame) -> GroundPoints:
        """All points in a frame, with their standard deviations along its axes."""
        return GroundPoints.from_geodetic(frame, self.name, self.position, self.sigma_enu)


def check_control(views: Views, control: Control) -> None:
    """Refuse control that does not belong to the images, before anything is matched or adjusted.

    Raises `ValueError` for names of tie points ("tie 0"), for pixels in unknown images, outside of their image or
    without a ray of its lens, and for points that are not where the navigation has them: all rays of whose pixels pass
    them by more than ten standard deviations. If these are most of the points, the message has the shift on which all
    agree.
    """
    taken = [str(name) for name in control.name if re.fullmatch(r"tie \d+", str(name))]
    if taken:
        raise ValueError(f"point {taken[0]} has the name of a tie point; name it otherwise.")
    _check_images(views, control.marks)
    rays = _Rays.of(views, control)
    names, point = control.marks.point_numbers
    nearest = np.full(len(names), np.inf)
    np.minimum.at(nearest, point, rays.sigmas)
    far = nearest > FAR
    if not np.any(far):
        return
    if np.sum(far) > 0.5 * len(names) and len(names) > 1:
        raise ValueError(
            f"{int(np.sum(far))} of {len(names)} points lie far from the rays of their pixels: {_advice(rays)}"
        )
    worst = int(np.argmax(np.where(far, nearest, -1.0)))
    rows = np.flatnonzero(point == worst)
    row = rows[int(np.argmin(rays.sigmas[rows]))]
    others = [str(name) for name in names[far] if name != names[worst]]
    more = f" So does {', '.join(others[:SHOWN])}{' ...' if len(others) > SHOWN else ''}." if others else ""
    which = "the nearest one" if len(rows) > 1 else "the only one"
    raise ValueError(
        f"point {names[worst]} lies far from the rays of its pixels: {which}, of image {control.marks.image[row]}, "
        f"passes it by {rays.miss[row]:.3g} m ({rays.sigmas[row]:.0f} standard deviations of the navigation). Correct "
        f"its position, its name or its pixels, or leave it out.{more}"
    )


def check_fit(views: Views, control: Control, excess: float, of_ties: float) -> None:
    """Refuse control that an adjustment could use only with `excess` px added to the standard deviations of its pixels,
    far more than these and than what is added to those of tie points: most of it is wrong in the same way.

    Raises `ValueError` with the shift on which the points agree.
    """
    if excess > max(HOPELESS * float(np.median(control.marks.sigma)), 2.0 * of_ties):
        raise ValueError(
            f"the control contradicts tie points and navigation: {excess:.0f} px would have to be added to the "
            f"standard deviations of its pixels; {_advice(_Rays.of(views, control))}"
        )


def _advice(rays: _Rays) -> str:
    shift = ", ".join(f"{x:+.{0 if np.linalg.norm(rays.shift) > 100.0 else 2}f}" for x in rays.shift)
    return (
        f"moved by {shift} m (east, north, up) the points would fit best. Are their coordinate system and vertical "
        f"datum right, and those of the images? If so, the navigation is less accurate than stated."
    )


@dataclass(frozen=True)
class _Rays:
    """Rays of k pixels by the navigation and their points: distances `miss` (k,) in m (to the image, for a point
    behind it), the angle from ray to point in standard deviations, `sigmas` (k,), and the `shift` (3,) in m that moves
    all points nearest to their rays."""

    miss: np.ndarray
    sigmas: np.ndarray
    shift: np.ndarray

    @classmethod
    def of(cls, views: Views, control: Control) -> _Rays:
        """Raises `ValueError` for a pixel that has no ray."""
        marks, ground = control.marks, control.ground(views.frame)
        image, point = rows_of(views.name, marks.image), rows_of(ground.name, marks.point)
        direction = np.full((len(marks), 3), np.nan)
        focal = np.ones(len(marks))
        for name in np.unique(views.camera[image]):
            rows, camera = np.flatnonzero(views.camera[image] == name), views.cameras[str(name)]
            direction[rows] = camera_rays(camera, marks.uv[rows])
            focal[rows] = float(np.min(np.asarray(camera.focal_px)))
        lost = ~np.all(np.isfinite(direction), axis=1)
        if np.any(lost):
            row = int(np.argmax(lost))
            raise ValueError(
                f"point {marks.point[row]}: the lens of image {marks.image[row]} has no ray at "
                f"{marks.uv[row].tolist()} px; is the pixel, or the camera, that of another image?"
            )
        direction = np.einsum("kij,kj->ki", views.R_frame_from_camera[image], direction)
        away = ground.place[point] - views.centre[image]
        distance = np.linalg.norm(away, axis=1)
        along = np.einsum("ki,ki->k", direction, away)
        miss = np.linalg.norm(away - along[:, None] * direction, axis=1)
        own = views.covariance[image]
        position, attitude = (np.linalg.eigvalsh(own[:, part, part])[:, -1] for part in (np.s_[:3], np.s_[3:]))
        lengths = position + np.max(ground.sigma[point], axis=1) ** 2
        pixel = np.max(marks.sigma, axis=1) / focal
        variance = attitude + lengths / np.maximum(distance, 1e-3) ** 2 + pixel**2 + INTERIOR**2
        across = np.eye(3) - direction[:, :, None] * direction[:, None, :]
        weight = 1.0 / (variance * np.maximum(distance, 1e-3) ** 2)
        normal = np.einsum("k,kij->ij", weight, across)
        right = -np.einsum("k,kij,kj->i", weight, across, away)
        shift = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
        angle = np.arctan2(miss, along)
        return cls(np.where(along > 0.0, miss, distance), angle / np.sqrt(variance), shift)


def rows_of(names: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Index of each wanted name, all of which are there."""
    index = {str(name): row for row, name in enumerate(names)}
    return np.array([index[str(name)] for name in wanted], int)


def _check_images(views: Views, marks: ImagePoints) -> None:
    unknown = ~np.isin(marks.image, views.name)
    if np.any(unknown):
        row = int(np.argmax(unknown))
        names = [str(name) for name in views.name]
        shown = ", ".join(names[:SHOWN]) + (f" and {len(names) - SHOWN} more" if len(names) > SHOWN else "")
        raise ValueError(f"image {marks.image[row]} of point {marks.point[row]} is not among the images: {shown}.")
    for row, name in enumerate(marks.image):
        camera = views.cameras[str(views.camera[rows_of(views.name, np.array([name]))[0]])]
        u, v = marks.uv[row]
        if not (-0.5 <= u <= camera.width - 0.5 and -0.5 <= v <= camera.height - 0.5):
            raise ValueError(
                f"point {marks.point[row]}: pixel {u:.6g}, {v:.6g} lies outside of image {name}, which has "
                f"{camera.width} x {camera.height} px."
            )


def _check_names(name: np.ndarray, marks: ImagePoints, check: Sequence[str]) -> None:
    found, counts = np.unique(name, return_counts=True)
    if np.any(counts > 1):
        raise ValueError(f"point {found[np.argmax(counts)]} is there {counts.max()} times; names must be unique.")
    unknown = np.setdiff1d(marks.point, name)
    if unknown.size:
        raise ValueError(f"point {unknown[0]} is measured in images, but has no position.")
    unseen = np.setdiff1d(name, marks.point)
    if unseen.size:
        raise ValueError(f"point {unseen[0]} is measured in no image; leave it out.")
    none = [one for one in check if one not in set(name.tolist())]
    if none:
        shown = ", ".join(name[:10].tolist()) + (" ..." if len(name) > 10 else "")
        raise ValueError(f"check point {none[0]} is not among the points: {shown}.")
