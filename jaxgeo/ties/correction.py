"""Mutual correction: adjustment of images by their tie points, with the navigation as prior."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import check_is
from jaxgeo.adjust import (
    Adjustment,
    Block,
    HeightObservations,
    ImagePoints,
    Images,
    LeastSquares,
    Navigation,
    Unknowns,
)
from jaxgeo.adjust.bundle import adjusted
from jaxgeo.adjust.initial_points import of_parallel_rays
from jaxgeo.adjust.kept import Kept, block_of, masked, set_aside
from jaxgeo.adjust.measurements import image_residuals, in_view
from jaxgeo.adjust.problem import Prepared, prepared
from jaxgeo.adjust.ray_consensus import Rays
from jaxgeo.adjust.screening import SIGMAS, Screen, screened_of
from jaxgeo.adjust.solve import solve
from jaxgeo.adjust.values import Values
from jaxgeo.sensor import Mount
from jaxgeo.ties.block import Ties
from jaxgeo.ties.control_choice import Tied, with_control
from jaxgeo.ties.excess import by_median, excess_of
from jaxgeo.ties.map_control import MapControl
from jaxgeo.ties.robust import WIDEST, WIDTH, ScaledCauchy, less_sure
from jaxgeo.ties.tracks import connected
from jaxgeo.ties.views import Views

OUTLIER = 4.0  # standard deviations: larger residuals are left out
LEAST_POSITION, LEAST_ATTITUDE = 1e-4, 1e-6  # m, rad: lower bounds of the navigation's standard deviations
# px: added to the standard deviations of image points in the first robust solution, which starts from the navigation,
# several px off; with less, right measurements are left out there for wrong ones.
FIRST_EXCESS = 1.0
ENOUGH = 0.1  # of it, or 0.01 px: change of the added standard deviation that ends the robust solutions
HIDDEN = 0.9  # standard deviations of a shared error that are left of one, if images do not show it
FAR = 4.0  # standard deviations of the navigation, beyond which a correction is doubted
ROUNDS = 10


@dataclass(frozen=True)
class Correction:
    """Images adjusted by their tie points.

    `adjustment` has the adjusted orientations with their covariances; `excess` px were added in quadrature to the
    standard deviations of image points, so that the residuals match them. `rms_before` and `rms_after` are RMS
    residuals of the same measurements in px per axis: with the orientations of the navigation, and the adjusted ones.
    `moved` (n, 3) in m and `turned` (n, 3) in rad are the corrections: centre in the axes of the frame (east, north,
    up), rotation about the camera's axes; `sigmas` (n,) the largest of them in standard deviations of the navigation.
    `left_out` measurements did not fit. `unconnected` names the images that no tie points join to these. `control` has
    the images registered to a map whose measurements entered, `refused` the sentences on those that did not.
    """

    views: Views
    adjustment: Adjustment
    excess: float
    rms_before: float
    rms_after: float
    moved: np.ndarray
    turned: np.ndarray
    sigmas: np.ndarray
    left_out: int
    unconnected: list[str]
    control: MapControl | None = None
    refused: dict[str, str] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """Names of the adjusted images."""
        return [str(name) for name in self.adjustment.images.name]

    @property
    def doubtful(self) -> list[str]:
        """Names of images whose correction exceeds four standard deviations of their navigation."""
        return [name for name, sigma in zip(self.names, self.sigmas, strict=True) if sigma > FAR]

    @property
    def sigma_of_mean(self) -> np.ndarray:
        """Standard deviations (3,) in m, east, north, up, of the mean position of the adjusted images.

        Tie points do not show it. Without a map it is that of the navigation: errors of each image alone, which average
        out, and those that images share, which do not. With a map it is that of the adjusted positions.
        """
        if self.control is not None:
            n = len(self.adjustment.images)
            positions = self.adjustment.covariance[: 6 * n, : 6 * n].reshape(n, 6, n, 6)[:, :3, :, :3]
            return np.sqrt(np.diagonal(positions.mean(axis=(0, 2))))
        rows = _rows(self.views, self.names)
        alone = np.diagonal(self.views.own, axis1=1, axis2=2)[rows, :3].sum(axis=0) / len(rows) ** 2
        shared = [one[rows, :3].mean(axis=0) ** 2 for one in self.views.common.values()]
        return np.sqrt(alone + np.sum(shared, axis=0) if shared else alone)

    @property
    def hidden(self) -> list[str]:
        """Names of the errors that images share and of which the adjustment left more than nine tenths."""
        return [name for name, (_, left) in self.adjustment.common.items() if left > HIDDEN]

    def words(self) -> str:
        """What the images alone do not show, as sentences."""
        lines = [self._words_of_shift()]
        if not self.adjustment.parameters:
            lines.append(
                "Focal length and principal point are held as given: their errors are not in the standard deviations, "
                "unless self-calibration takes them in."
            )
        constant = [name for name in self.hidden if ", mode" not in name]
        if constant:
            lines.append(f"Of the errors that images share, these stay as they were: {', '.join(constant)}.")
        if self.unconnected:
            some = ", ".join(self.unconnected[:10]) + (" ..." if len(self.unconnected) > 10 else "")
            lines.append(f"Not adjusted, for no tie points join them to the others: {some}.")
        lines += [f"The map does not count in {name}: {reason}" for name, reason in self.refused.items()]
        if self.doubtful:
            some = ", ".join(self.doubtful[:10]) + (" ..." if len(self.doubtful) > 10 else "")
            lines.append(f"Moved by more than {FAR:g} sigma of the navigation; check its errors: {some}.")
        return "\n".join(lines)

    def _words_of_shift(self) -> str:
        east, north, up = self.sigma_of_mean
        if self.control is not None:
            names = ", ".join(self.control.names[:10]) + (" ..." if len(self.control) > 10 else "")
            return (
                f"Registered to the map: {names}. The mean position of all images is known to {east:.3g}, {north:.3g}, "
                f"{up:.3g} m (E, N, U; one sigma), the errors of the map included as stated."
            )
        return (
            f"Images alone do not show a shift of all positions: it stays that of the navigation, {east:.3g}, "
            f"{north:.3g}, {up:.3g} m (E, N, U; one sigma"
            + (")." if self.views.common else ", as its errors are stated to be independent between images).")
        )


def correct(
    views: Views,
    ties: Ties | ImagePoints,
    unknowns: Unknowns | None = None,
    terrain: HeightObservations | None = None,
    *,
    control: MapControl | None = None,
) -> Correction:
    """Adjust the orientations of images by tie points among them.

    The navigation is the prior of all images, with its covariance, and the only datum: position, orientation and scale
    of the whole come from it. Errors that images share, by the `sharing` of their sources, are unknowns of the whole.
    The largest connected part is adjusted. First with a robust loss (Cauchy), and without measurements off by more than
    four standard deviations; then by least squares of the rest. If residuals exceed what the standard deviations of the
    measurements explain, as those of lenses and terrain do, one standard deviation in px is added to all in quadrature:
    by the median residual at first, then so that the sum of squares has its expected value, see `excess_of`.
    `unknowns` adds a self-calibration (`images` are always free), `terrain` observations of the heights of the points.
    Points whose rays are parallel, as in images from one position, have no place and are left out.

    `control` adds what images registered to a map say about their orientations, with the errors of map and terrain; the
    map shift is an unknown of the whole. Tie points are chosen without it. Each registration is then held against the
    navigation, the tie points and the other registrations, by the squared distance of its measurements from their
    prediction without it (chi-square): those less probable than 1e-6 are left out, the least probable first. Where two
    contradict each other and nothing tells which one is wrong, both are. `refused` says which and why.

    Raises `ValueError` without tie points between any two images, for rays that are all parallel, and as
    `jaxgeo.adjust.adjust`.
    """
    check_is(views, Views, "views")
    if control is not None:
        check_is(control, MapControl, "control")
    observations = ties.observations if isinstance(ties, Ties) else ties
    if observations is None:
        raise ValueError(
            "no two images share a tie point; nothing can be adjusted. Check the navigation and the datum of its "
            "heights, or allow larger errors."
        )
    unknowns = Unknowns() if unknowns is None else unknowns
    given = len(observations)
    observations = _of_places(views, observations)
    while True:
        part = connected(views.name, observations)[0]
        if len(part) < 2:
            raise ValueError(
                "no two images share enough tie points to be adjusted; check the navigation and its errors."
            )
        block = _block(views, _of_images(observations, part))
        kept, values, excess = _robust(block, unknowns, terrain)
        left = block.observations.of(kept.rows)
        if set(connected(views.name, left)[0]) >= {str(name) for name in block.images.name}:
            break
        observations = left  # an image has lost its ties
    found, excess = _final(block, unknowns, terrain, kept, values, excess)
    result = _correction(views, found, excess, given)
    if control is None:
        return result
    chosen = with_control(found, Tied(block, unknowns, terrain, kept, excess), control)
    if chosen.adjustment is None:
        return replace(result, refused=chosen.refused)
    result = _correction(views, chosen.adjustment, excess, given)
    return replace(result, control=chosen.control, refused=chosen.refused)


def _of_places(views: Views, observations: ImagePoints) -> ImagePoints:
    """The measurements of points whose rays are not parallel. Raises `ValueError` if all are."""
    parallel = of_parallel_rays(_block(views, observations))
    if np.all(parallel):
        raise ValueError(
            "the rays of all tie points are parallel, so that these have no place; are the images of one position, or "
            "one image under several names?"
        )
    return observations.of(~parallel) if np.any(parallel) else observations


def _robust(block: Block, unknowns: Unknowns, terrain: HeightObservations | None) -> tuple[Kept, Values, float]:
    """(the measurements that fit, the robust solution, the standard deviation in px to add to theirs)."""
    first = kept = screened_of(block, unknowns, SIGMAS).kept
    values, excess = None, FIRST_EXCESS
    for _ in range(ROUNDS):
        weighted = less_sure(block, excess)
        full = prepared(weighted, unknowns, terrain, set_aside(weighted, first))
        solution = solve(masked(weighted, full, kept).problem, ScaledCauchy(jnp.asarray(WIDTH)), start=values)
        values = solution.values
        residuals = np.asarray(image_residuals(full.problem, values)).T[full.order.place] * weighted.observations.sigma
        largest, sigma = _largest(residuals, block.observations.sigma)
        last, excess = excess, by_median(largest[kept.rows], sigma[kept.rows])
        fits = largest <= OUTLIER * np.hypot(sigma, excess)
        before, kept = kept, Kept(fits & _in_view(full, values), kept.control).whole(block)
        is_settled = np.array_equal(before.rows, kept.rows) and abs(excess - last) <= ENOUGH * max(last, ENOUGH)
        if is_settled or not kept.leaves_every_image(block):
            break
    assert values is not None
    return kept, values, excess


def _largest(residuals: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The larger of the two residuals of each measurement, in standard deviations, and its standard deviation, px."""
    axis = np.argmax(np.abs(residuals / sigma), axis=1)
    rows = np.arange(len(axis))
    return np.abs(residuals)[rows, axis], sigma[rows, axis]


def _in_view(full: Prepared, values: Values) -> np.ndarray:
    return np.asarray(in_view(full.problem, values))[full.order.place]


def _final(
    block: Block,
    unknowns: Unknowns,
    terrain: HeightObservations | None,
    kept: Kept,
    values: Values,
    excess: float,
) -> tuple[Adjustment, float]:
    """(least-squares adjustment of the kept measurements, the standard deviation in px added to theirs)."""
    for last in (False, False, True):
        weighted = less_sure(block, excess)
        ready = masked(weighted, prepared(weighted, unknowns, terrain, set_aside(weighted, kept)), kept)
        solution = solve(ready.problem, ScaledCauchy(jnp.asarray(WIDEST)), start=values)
        values = solution.values
        if not last:
            off = np.asarray(image_residuals(ready.problem, values)).T[ready.order.place]
            freedom = max(2 * len(off) - 6 * len(block.images) - 3 * len(ready.names.point), 1)
            excess = excess_of(
                off * weighted.observations.sigma[kept.rows], block.observations.sigma[kept.rows], freedom
            )
    screen = Screen(kept)
    return adjusted(block_of(weighted, kept), unknowns, ready, solution, LeastSquares(), None, screen), excess


def _of_images(observations: ImagePoints, names: list[str]) -> ImagePoints:
    return observations.of(np.isin(observations.image, names)).seen_often()


def _block(views: Views, observations: ImagePoints) -> Block:
    """The block of those images that have observations."""
    rows = np.flatnonzero(np.isin(views.name, observations.image))
    images = Images(views.name[rows], views.camera[rows], views.centre[rows], views.R_frame_from_camera[rows])
    cameras = {name: views.cameras[name] for name in dict.fromkeys(images.camera.tolist())}
    return Block(views.frame, cameras, images, observations, navigation=_navigation(views).of(rows))


def _navigation(views: Views) -> Navigation:
    """Navigation of the cameras themselves: perspective centres, and rotations about the camera's axes."""
    count, eye = len(views), np.eye(3)
    each = np.broadcast_to(eye, (count, 3, 3))
    position, attitude = (views.own[:, part, part] for part in (np.s_[:3], np.s_[3:]))
    zero = np.zeros(3)
    return Navigation(
        position=views.centre,
        R_frame_from_body=views.R_frame_from_camera,
        R_frame_from_reference=views.R_frame_from_camera,
        R_base_from_head=each,
        information_position=information_of(position, LEAST_POSITION),
        information_attitude=information_of(attitude, LEAST_ATTITUDE),
        mount=views.camera,
        strip=np.full(count, "strip"),
        time=np.zeros(count),
        mounts={str(name): (Mount(eye, eye, zero, zero), False) for name in views.cameras},
        common=views.common,
    )


def information_of(covariance: np.ndarray, least: float) -> np.ndarray:
    """W (n, 3, 3) with W' W the inverse of covariances, which a standard deviation is added to."""
    return np.linalg.inv(np.linalg.cholesky(covariance + least**2 * np.eye(3)))


def _correction(views: Views, found: Adjustment, excess: float, given: int) -> Correction:
    rows = _rows(views, [str(name) for name in found.images.name])
    moved = found.images.centre - views.centre[rows]
    turn = np.swapaxes(views.R_frame_from_camera[rows], 1, 2) @ found.images.R_frame_from_camera
    turned = _vectors(turn)
    sigma = np.sqrt(np.diagonal(views.covariance[rows], axis1=1, axis2=2))
    sigma = np.maximum(sigma, np.repeat([LEAST_POSITION, LEAST_ATTITUDE], 3))
    names = {str(name) for name in found.images.name}
    return Correction(
        views=views,
        adjustment=found,
        excess=excess,
        rms_before=rms_of_rays(views, found.block.observations),
        rms_after=float(np.sqrt(np.mean(found.residuals**2))),
        moved=moved,
        turned=turned,
        sigmas=np.max(np.abs(np.concatenate([moved, turned], axis=1)) / sigma, axis=1),
        left_out=given - len(found.block.observations),
        unconnected=[str(name) for name in views.name if str(name) not in names],
    )


def rms_of_rays(views: Views, observations: ImagePoints) -> float:
    """RMS distance per axis in px of measurements from the points where their rays come closest."""
    block = _block(views, observations)
    rays = Rays.of(block)
    focal = {name: float(np.mean(np.asarray(camera.focal_px))) for name, camera in block.cameras.items()}
    each = np.array([focal[str(name)] for name in block.images.camera])[rays.image]
    return float(np.sqrt(0.5 * np.mean((rays.residual * rays.sigma * each) ** 2)))


def _vectors(turn: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) of rotations (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(turn).as_rotvec()


def _rows(views: Views, names: list[str]) -> np.ndarray:
    index = {str(name): row for row, name in enumerate(views.name)}
    return np.array([index[name] for name in names], int)
