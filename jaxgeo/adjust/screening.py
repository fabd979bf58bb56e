"""Screening of measurements and control for gross errors by ray and control consensus, before an adjustment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from jaxgeo._record import portable
from jaxgeo.adjust.block import Block
from jaxgeo.adjust.control_consensus import Motion, consensus
from jaxgeo.adjust.kept import Kept, control_of
from jaxgeo.adjust.ray_consensus import SETTLED, Rays
from jaxgeo.adjust.unknowns import Free, Unknowns, spread

IMAGE_POINT, CONTROL_POINT = "image point", "control point"
SIGMAS = 50.0  # standard deviations of disagreement required to set a measurement aside
TIMES = 5.0  # also required: times the 90 % quantile of all residuals
POOR_TIMES = 20.0  # the same for poor orientations
POOR = 10.0  # standard deviations: typical miss distance of rays above which orientations are poor
CONTROL_TIMES = 20.0  # times the median disagreement of the control
LEAST_CHECKED = 0.4  # redundancy share of a ray of three: with less, a ray does not check its image
MOST = 0.5  # of an image's measurements, or of the control: if more disagree, these are not the cause
ELSEWHERE = 5.0  # block sizes: displacement above which all control counts as elsewhere


@dataclass(frozen=True)
class Screened:
    """A measurement set aside before the first iteration: its kind (`image point` or `control point`), image (empty
    for control) and point, its row of the observations or of the control, its disagreement in standard deviations,
    and the reason as text.
    """

    kind: str
    image: str
    point: str
    row: int
    sigmas: float
    why: str

    def __str__(self) -> str:
        where = f" in image {self.image}" if self.image else ""
        return f"{self.kind} {self.point}{where} (row {self.row}): {self.why}"


@portable
class ControlElsewhere(ValueError):
    """All control is displaced relative to the images: `shift` (3,) in m of the block's frame."""

    def __init__(self, message: str, shift: np.ndarray) -> None:
        super().__init__(message)
        self.shift = shift


@dataclass(frozen=True)
class Screen:
    """The measurements kept and set aside; `doubtful` are images with mostly disagreeing measurements; `poor` states
    whether the start orientations left typical ray misses of more than a few standard deviations."""

    kept: Kept
    aside: tuple[Screened, ...] = ()
    doubtful: tuple[str, ...] = ()
    poor: bool = False

    @classmethod
    def none(cls, block: Block) -> Screen:
        """Nothing set aside."""
        return cls(Kept.all(block))

    def words(self, most: int = 3) -> str:
        """The measurements set aside, as one line of text."""
        shown = "; ".join(str(one) for one in self.aside[:most])
        more = f"; and {len(self.aside) - most} more" if len(self.aside) > most else ""
        return shown + more


def screen(block: Block, unknowns: Unknowns | None = None, sigmas: float = SIGMAS) -> Screen:
    """Screen the image points and the control of a block before its adjustment.

    The rays of a point must intersect, and at the control point. Start orientations are first improved by robust
    resection if rays generally miss, and a robust similarity aligns the block with the control. Measurements are set
    aside if they disagree by more than `sigmas` standard deviations and by much more than the measurements in general,
    so that poor start values do not cause rejections. Raises `ControlElsewhere` if all control is displaced, such as in
    another zone, and `ValueError` if a camera has no ray for most of an image's pixels, and for `sigmas` that are not
    positive.
    """
    if not sigmas > 0.0:
        raise ValueError(f"screen must be a number of standard deviations, or None for no screening; got {sigmas!r}.")
    rays = Rays.of(block)
    _check_lens(block, rays)
    chosen = Unknowns() if unknowns is None else unknowns
    free = spread(chosen.images, block.images.name.tolist(), 1, "images", Free())[:, 0] > 0.0
    poor = rays.spread > POOR
    rays.improve(free)
    return replace(_Screening(block, rays, sigmas).screen, poor=poor)


def screened_again(block: Block, sigmas: float) -> tuple[Screen, Motion | None]:
    """Screening of a block with adjusted ties, and the motion that aligns it with its control."""
    rays = Rays.of(block)
    screening = _Screening(block, rays, sigmas, adjusted=True)
    return screening.screen, screening._control[1]


def screened_of(block: Block, unknowns: Unknowns, sigmas: float | None) -> Screen:
    """Screening of an adjustment's input; none for `sigmas=None`."""
    return Screen.none(block) if sigmas is None else screen(block, unknowns, sigmas)


@dataclass(frozen=True)
class _Screening:
    block: Block
    rays: Rays
    sigmas: float
    adjusted: bool = False  # by ties, so that navigation does not affect the control test

    @cached_property
    def screen(self) -> Screen:
        rows, doubtful = self._image_points
        control, found = self._control
        kept = Kept(~self._flags(rows), ~self._flags(control, of_control=True))
        single = self._single_rays(kept, found)
        kept = Kept(kept.rows & ~self._flags(single), kept.control)
        aside = tuple(sorted((*rows, *control, *single), key=lambda one: -one.sigmas))
        whole = kept.whole(self.block)
        if not whole.leaves_every_image(self.block):  # keep measurements that the block needs
            return Screen(Kept.all(self.block), (), doubtful)
        return Screen(whole, aside, doubtful)

    def _flags(self, found: list[Screened], of_control: bool = False) -> np.ndarray:
        flags = np.zeros(len(control_of(self.block)) if of_control else len(self.block.observations), bool)
        flags[[one.row for one in found]] = True
        return flags

    @cached_property
    def limit(self) -> float:
        """Standard deviations above which a measurement is set aside."""
        residual = self.rays.residual[self.rays.used]
        times = TIMES if self.rays.spread <= POOR else POOR_TIMES
        return max(self.sigmas, times * float(np.quantile(residual, 0.9)))

    @cached_property
    def _image_points(self) -> tuple[list[Screened], tuple[str, ...]]:
        """Rays that miss the others of their point, and images most of whose rays do."""
        rays, observations, images = self.rays, self.block.observations, self.block.images
        wrong = rays.residual > self.limit
        well = rays.used & (rays.checked > LEAST_CHECKED)
        count = np.bincount(rays.image, weights=well, minlength=len(images))
        doubtful = np.bincount(rays.image, weights=wrong & well, minlength=len(images)) > MOST * np.maximum(count, 1.0)
        if rays.spread > SETTLED:  # with such poor orientations, a single checked ray per image proves nothing
            doubtful |= count < 3.0
        wrong &= ~(doubtful[rays.image] & rays.used)
        found = []
        for row in np.flatnonzero(wrong):
            sigmas = float(rays.residual[row])
            why = f"its ray misses where the other rays of the point meet by {sigmas:.0f} standard deviations"
            if not rays.used[row]:
                why = f"the camera sees nothing at {observations.uv[row].tolist()} px, as its lens folds there"
            elif np.sum(rays.point == rays.point[row]) == 2:
                other = observations.image[(rays.point == rays.point[row]) & (rays.image != rays.image[row])]
                why = f"its ray and that of image {other[0]} miss each other by {sigmas:.0f} standard deviations each"
            found.append(
                Screened(IMAGE_POINT, str(observations.image[row]), str(observations.point[row]), int(row), sigmas, why)
            )
        return found, tuple(images.name[doubtful].tolist())

    @cached_property
    def _control(self) -> tuple[list[Screened], Motion | None]:
        """Control points that disagree with the consensus of the others, and its motion."""
        rays, control = self.rays, control_of(self.block)
        good = rays.used & ~self._flags(self._image_points[0])
        count = np.bincount(rays.point, weights=good, minlength=len(rays.names))
        index = {name: i for i, name in enumerate(rays.names.tolist())}
        rows = np.array([i for i, name in enumerate(control.name.tolist()) if name in index], int)
        at = np.array([index[name] for name in control.name[rows].tolist()], int)
        rows, at = rows[count[at] >= 2], at[count[at] >= 2]
        own = rays.covariance(at, good) if len(at) else np.zeros((0, 3, 3))
        sure = np.all(np.isfinite(own), axis=(1, 2))
        rows, at, own = rows[sure], at[sure], own[sure]
        if not len(rows):
            return [], None
        given = _covariance(control, rows) + own + self._of_start(at)
        motion, off = consensus(rays.place[at], control.place[rows], given)
        times = CONTROL_TIMES * (1.0 if rays.spread <= POOR else POOR_TIMES / TIMES)
        limit = max(self.sigmas, times * float(np.sort(off)[(len(off) - 1) // 2]))  # of the better half
        wrong = off > limit
        if np.sum(wrong) <= MOST * len(rows):
            self._check_place(motion, at, control.name[rows])
        elif self.block.navigation is None or motion.parameters:  # neither is reliable
            return [], None
        found = []
        moved = motion(rays.place[at])
        for i in np.flatnonzero(wrong):
            shift = control.place[rows[i]] - moved[i]
            why = f"it lies {_metres(shift)} from where the images see it, {off[i]:.0f} standard deviations, while " + (
                f"{int(np.sum(~wrong))} of {len(rows)} control points agree"
                if not np.all(wrong)
                else "navigation is given"
            )
            found.append(Screened(CONTROL_POINT, "", str(control.name[rows[i]]), int(rows[i]), float(off[i]), why))
        return found, motion

    def _single_rays(self, kept: Kept, motion: Motion | None) -> list[Screened]:
        """Control points with a single ray that misses them."""
        rays, control = self.rays, control_of(self.block)
        count = np.bincount(rays.point, weights=kept.rows & rays.used, minlength=len(rays.names))
        index = {name: i for i, name in enumerate(control.name[kept.control].tolist())}
        found = []
        for row in np.flatnonzero(kept.rows & (count[rays.point] == 1)):
            name = str(rays.names[rays.point[row]])
            if motion is None or name not in index:
                continue
            place, sigma = control.place[kept.control][index[name]], control.sigma[kept.control][index[name]]
            if not np.all(np.isfinite(sigma)):
                continue
            back = motion.middle + ((place - motion.middle - motion.shift) @ motion.R) / motion.scale
            away = np.linalg.norm(back - rays.centre[rays.image[row]])
            off = float(rays.off(back[None], np.array([row]))[0])
            off /= np.hypot(rays.spread, np.linalg.norm(sigma) / away / rays.sigma[row])
            if off > self.limit:
                image = str(self.block.observations.image[row])
                why = f"its only ray misses the control point by {off:.0f} standard deviations"
                found.append(Screened(IMAGE_POINT, image, name, int(row), off, why))
        return found

    def _of_start(self, at: np.ndarray) -> np.ndarray:
        """Covariance (m, 3, 3) of points from the navigation uncertainty, m2."""
        nav = self.block.navigation
        if nav is None or self.adjusted:
            return np.zeros((len(at), 3, 3))
        position, attitude = (_variance(x) for x in (nav.information_position, nav.information_attitude))
        ranges = np.median(np.linalg.norm(self.rays.place[self.rays.point] - self.rays.centre[self.rays.image], axis=1))
        return np.broadcast_to((position + attitude * ranges**2) * np.eye(3), (len(at), 3, 3))

    def _check_place(self, motion: Motion, at: np.ndarray, names: np.ndarray) -> None:
        """Refuse control that is displaced as a whole."""
        rays = self.rays
        size = np.linalg.norm(np.ptp(rays.centre, axis=0))
        size += np.median(np.linalg.norm(rays.place[rays.point] - rays.centre[rays.image], axis=1))
        shift = motion(rays.place[at].mean(axis=0)) - rays.place[at].mean(axis=0)
        if len(at) < 2 or np.linalg.norm(shift) < ELSEWHERE * size:
            return
        raise ControlElsewhere(
            f"control lies elsewhere than the images see it: {names[0]} and the other control points agree on "
            f"{_metres(shift)} from where the orientations to start from have them. Is it of another UTM zone, with or "
            f"without a false easting, or with its columns exchanged? Give control and orientations in one frame.",
            shift,
        )


def _check_lens(block: Block, rays: Rays) -> None:
    """Refuse images with no camera ray for most of their pixels: wrong lens or wrong camera."""
    lost = np.bincount(rays.image, weights=~rays.used, minlength=len(block.images))
    share = lost / np.bincount(rays.image, minlength=len(block.images))
    if not np.any(share > MOST):
        return
    row = int(np.argmax(~rays.used & (share[rays.image] > MOST)))
    observations = block.observations
    raise ValueError(
        f"point {observations.point[row]} in image {observations.image[row]}: the camera sees nothing "
        f"at {observations.uv[row].tolist()} px, "
        f"as its lens folds there; is the pixel, or the lens, that of another camera?"
    )


def _covariance(control, rows: np.ndarray) -> np.ndarray:
    """Covariances (m, 3, 3) of some control points, m2; infinite on the diagonal for unknown coordinates."""
    if control.covariance is not None:
        return control.covariance[rows]
    sigma = control.sigma[rows]
    return np.where(np.eye(3) > 0.0, sigma[:, :, None] ** 2, 0.0)


def _variance(information: np.ndarray) -> float:
    """Median variance per axis from information (n, 3, 3); zero if there is none."""
    squared = np.einsum("nki,nki->ni", information, information)
    return float(1.0 / np.median(squared)) if np.median(squared) > 0.0 else 0.0


def _metres(shift: np.ndarray) -> str:
    """A shift as text."""
    length = float(np.linalg.norm(shift))
    parts = ", ".join(f"{x:+.{0 if length > 100.0 else 1}f}" for x in shift)
    return f"{length:.{0 if length > 100.0 else 1}f} m ({parts})"
