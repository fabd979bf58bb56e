"""Mutual correction: adjustment of images by their tie points, with the navigation as prior."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jaxgeo._checks import check_is
from jaxgeo.adjust import Adjustment, Blunder, GroundPoints, HeightObservations, ImagePoints, Unknowns
from jaxgeo.adjust.exposures import LEAST_ATTITUDE, LEAST_POSITION
from jaxgeo.adjust.ray_consensus import Rays
from jaxgeo.adjust.ray_effects import READOUT, REFRACTION
from jaxgeo.ties.block import Ties
from jaxgeo.ties.block_of_views import block_of_views
from jaxgeo.ties.connections import of_places
from jaxgeo.ties.control import Control, check_control, check_fit
from jaxgeo.ties.control_choice import Tied, with_control
from jaxgeo.ties.control_residuals import ControlResiduals, mean_position_sigma, residuals_of, words_of
from jaxgeo.ties.joined import mostly_left_out, solved, with_unknown_time_offset
from jaxgeo.ties.map_control import MapControl
from jaxgeo.ties.relative import RelativeOrientation, relative_orientations
from jaxgeo.ties.shared import OF_MODE, OF_SHOT
from jaxgeo.ties.solutions import Final, without_wrong_control
from jaxgeo.ties.views import Views

HIDDEN = 0.9  # standard deviations of a shared error that are left of one, if images do not show it
FAR = 4.0  # standard deviations of the navigation, beyond which a correction is doubted
MUCH = 3.0  # standard deviations of the pixels of control: what their residuals add to these, if it is doubted
NOT_INTERIOR = READOUT, REFRACTION, "time offset"  # parameters beside those of a self-calibration


@dataclass(frozen=True)
class Correction:
    """Images adjusted by their tie points.

    `adjustment` has the adjusted orientations with their covariances; `excess` px were added in quadrature to the
    standard deviations of image points, so that the residuals match them. `rms_before` and `rms_after` are RMS
    residuals of the same measurements in px per axis: with the orientations of the navigation, and the adjusted ones.
    `moved` (n, 3) in m and `turned` (n, 3) in rad are the corrections: centre in the axes of the frame (east, north,
    up), rotation about the camera's axes; `sigmas` (n,) the largest of them in standard deviations of the navigation.
    `left_out` measurements did not fit. `unconnected` names the images that no tie points join to these; among them,
    `contradicted` those that tie points joined before the ones that contradict each other, or that nothing else checks,
    were left out. `mostly_left_out` names the adjusted images that kept less than half of their measurements.

    With `control`, `control_residuals` has the residuals of control points and check points with their predicted
    standard deviations, and `blunders` the control points, and pixels of them, that did not fit; `excess_of_control` px
    were added to the standard deviations of their pixels. `map_control` has the images registered to a map whose
    measurements entered, `refused` the sentences on those that did not.
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
    control: Control | None = None
    control_residuals: ControlResiduals | None = None
    blunders: list[Blunder] = field(default_factory=list)
    excess_of_control: float = 0.0
    map_control: MapControl | None = None
    refused: dict[str, str] = field(default_factory=dict)
    contradicted: list[str] = field(default_factory=list)
    mostly_left_out: list[str] = field(default_factory=list)

    @property
    def names(self) -> list[str]:
        """Names of the adjusted images."""
        return [str(name) for name in self.adjustment.images.name]

    @property
    def doubtful(self) -> list[str]:
        """Names of images whose correction exceeds four standard deviations of their navigation."""
        return [name for name, sigma in zip(self.names, self.sigmas, strict=True) if sigma > FAR]

    @cached_property
    def sigma_of_mean(self) -> np.ndarray:
        """Standard deviations (3,) in m, east, north, up, of the mean position of the adjusted images.

        Tie points do not show it. Without control and map it is that of the navigation: errors of each image alone,
        which average out, and those that images share, which do not. With them it is that of the adjustment.
        """
        if self.has_control or self.map_control is not None:
            return mean_position_sigma(self.adjustment)
        rows = _rows(self.views, self.names)
        alone = np.diagonal(self.views.own, axis1=1, axis2=2)[rows, :3].sum(axis=0) / len(rows) ** 2
        shared = [one[rows, :3].mean(axis=0) ** 2 for one in self.views.common.values()]
        return np.sqrt(alone + np.sum(shared, axis=0) if shared else alone)

    @property
    def hidden(self) -> list[str]:
        """Names of the errors that images share and of which the adjustment left more than nine tenths."""
        return [name for name, (_, left) in self.adjustment.common.items() if left > HIDDEN]

    @cached_property
    def relative_orientations(self) -> list[RelativeOrientation]:
        """Of images with shots: each camera against an earlier one on its mount."""
        return relative_orientations(self.views, self.adjustment)

    @property
    def has_control(self) -> bool:
        """Whether control points are in the adjustment."""
        return self.adjustment.block.control is not None and len(self.adjustment.block.control) > 0

    def words(self) -> str:
        """What control and map hold and show, and what the images alone do not show, as sentences."""
        lines = [self._words_of_shift()]
        if self.control is not None and self.excess_of_control > MUCH * np.median(self.control.marks.sigma):
            lines.append(
                "The control fits much worse than its standard deviations explain: check its positions and pixels, and "
                "the sigma of its survey."
            )
        if self.control_residuals is not None:
            lines += words_of(self.control_residuals, self.blunders, self.excess_of_control)
        if any(self.adjustment.readouts.values()):
            seconds = ", ".join(f"{one:.4g} s" for one in self.adjustment.readouts.values())
            lines.append(
                f"Orientations are those of the middle row, with a readout of {seconds}. Cameras in files expose all "
                f"rows at once."
            )
        if not any(one.name not in NOT_INTERIOR for one in self.adjustment.parameters):
            lines.append(
                "Focal length and principal point are held as given: their errors are not in the standard deviations, "
                "unless self-calibration takes them in."
            )
        lines += [one.words() for one in self.relative_orientations]
        constant = [name for name in self.hidden if OF_MODE not in name and OF_SHOT not in name]
        if constant:
            lines.append(f"Of the errors that images share, these stay as they were: {_some(constant, 12)}.")
        untied = [name for name in self.unconnected if name not in self.contradicted]
        if untied:
            lines.append(f"Not adjusted, for no tie points join them to the others: {_some(untied)}.")
        if self.contradicted:
            lines.append(
                f"Not adjusted, for too few of their measurements agree with those of other images and are checked by "
                f"them: {_some(self.contradicted)}."
            )
        if self.mostly_left_out:
            lines.append(
                f"More than half of their measurements contradict the others and are left out; check these images: "
                f"{_some(self.mostly_left_out)}."
            )
        lines += [f"The map does not count in {name}: {reason}" for name, reason in self.refused.items()]
        if self.doubtful:
            and_control = ", and coordinate system and vertical datum of the control" if self.has_control else ""
            some = _some(self.doubtful)
            lines.append(f"Moved by more than {FAR:g} sigma of the navigation; check its errors{and_control}: {some}.")
        return "\n".join(lines)

    def _words_of_shift(self) -> str:
        east, north, up = self.sigma_of_mean
        shift = f"{east:.3g}, {north:.3g}, {up:.3g} m (E, N, U; one sigma"
        if self.map_control is not None:
            names = _some(self.map_control.names)
            known = f"is known to {shift})" if not self.has_control else f"is known by control and map to {shift})"
            return (
                f"Registered to the map: {names}. The mean position of all images {known}, the errors of the map "
                f"included as stated."
            )
        if self.has_control:
            return f"Navigation and control hold the mean position of the images to {shift})."
        return f"Images alone do not show a shift of all positions: it stays that of the navigation, {shift}" + (
            ")." if self.views.common else ", as its errors are stated to be independent between images)."
        )


def correct(
    views: Views,
    ties: Ties | ImagePoints,
    unknowns: Unknowns | None = None,
    terrain: HeightObservations | None = None,
    *,
    control: Control | None = None,
    map_control: MapControl | None = None,
) -> Correction:
    """Adjust the orientations of images by tie points among them, and by control points and a map if there are any.

    The navigation is the prior of all images, with its covariance, and without control the only datum: position,
    orientation and scale of the whole come from it. Errors that images share, by the `sharing` of their sources, are
    unknowns of the whole. The largest connected part is adjusted; the points of `control` connect images as tie points
    do, and those with three of them are connected to each other. First with a robust loss (Cauchy), and without
    measurements off by more than four standard deviations; then by least squares of the rest. If residuals exceed what
    the standard deviations of the measurements explain, as those of lenses and terrain do, one standard deviation in px
    is added to all in quadrature: by the median residual at first, then so that the sum of squares has its expected
    value, see `excess_of`; for eight pixels of control points or more also by their own median, where it is too large
    to be by chance. Control points, and pixels of them, that fail the test at 1e-4 against all others are left
    out, one after the other (`Correction.blunders`).
    `unknowns` adds a self-calibration (`images` are always free), `terrain` observations of the heights of the points.
    Points whose rays are parallel, as in images from one position, have no place and are left out. A time offset of the
    navigation (one for all, of the strip "strip"), a readout and refraction take what `Views.moving` gives.

    `map_control` adds what images registered to a map say about their orientations, with the errors of map and terrain;
    the map shift is an unknown of the whole. Tie points and control points are chosen without it. Each registration is
    then held against all else by the squared distance of its measurements from their prediction without it
    (chi-square): those less probable than 1e-6 are left out, the least probable first. Where two contradict each other
    and nothing tells which one is wrong, both are. `refused` says which and why.

    Raises `ValueError` without tie points between any two images, for rays that are all parallel, for control that does
    not belong to these images (`check_control`), that contradicts them (more than thirty times the standard deviations
    of its pixels would have to be added to these), or of which more than half is left out, and as
    `jaxgeo.adjust.adjust`.
    """
    check_is(views, Views, "views")
    if map_control is not None:
        check_is(map_control, MapControl, "map_control")
        _check_map_control(views)
    observations = ties.observations if isinstance(ties, Ties) else ties
    unknowns, ground = Unknowns() if unknowns is None else unknowns, None
    late = with_unknown_time_offset(views, unknowns)
    if control is not None:
        check_is(control, Control, "control")
        check_control(late, control)
        observations, ground = _with_control(views, observations, control)
    if observations is None:
        raise ValueError(
            "no two images share a tie point; nothing can be adjusted. Check the navigation and the datum of its "
            "heights, or allow larger errors."
        )
    given = len(observations)
    observations = of_places(views, observations, ground)
    block, final, joined = solved(views, observations, unknowns, terrain, ground, late)
    blunders: list[Blunder] = []
    if ground is not None:
        final, blunders = without_wrong_control(block, unknowns, terrain, final)
        if control is not None and final.kept.control.size:
            check_fit(views, control, final.excess.control, final.excess.ties)
    of_ties = _correction(views, late, final, given, control, blunders)
    of_ties = replace(
        of_ties,
        contradicted=[name for name in joined if name not in of_ties.names],
        mostly_left_out=mostly_left_out(block, final.kept),
    )
    if map_control is None:
        return of_ties
    chosen = with_control(final.found, Tied(block, unknowns, terrain, final.kept, final.excess), map_control)
    if chosen.adjustment is None:
        return replace(of_ties, refused=chosen.refused)
    result = _correction(views, late, final._replace(found=chosen.adjustment), given, control, blunders)
    named = {"contradicted": of_ties.contradicted, "mostly_left_out": of_ties.mostly_left_out}
    return replace(result, map_control=chosen.control, refused=chosen.refused, **named)


def _check_map_control(views: Views) -> None:
    """Raises `ValueError` for views whose rays are not those of the registrations to a map."""
    if any(views.readout.values()) or views.atmosphere is not None:
        what = "readout" if any(views.readout.values()) else "atmosphere"
        raise ValueError(
            f"map_control is of images registered as of frame cameras without refraction, but the views have a {what}; "
            f"leave one of the two out."
        )


def _with_control(
    views: Views, observations: ImagePoints | None, control: Control
) -> tuple[ImagePoints | None, GroundPoints | None]:
    """(the measurements with the pixels of control points, these points in the frame). Raises `ValueError` for a
    control point with the name of a tie point."""
    marks, ground = control.used_marks, control.ground(views.frame)
    ground = ground.of(ground.name[~control.is_check].tolist())
    if observations is not None:
        same = np.intersect1d(observations.point, control.name)
        if same.size:
            raise ValueError(f"point {same[0]} of the control has the name of a tie point; name it otherwise.")
    if not len(ground):
        return observations, None
    return marks if observations is None else ImagePoints.joined([observations, marks]), ground


def _correction(
    views: Views, late: Views, final: Final, given: int, control: Control | None, blunders: list[Blunder]
) -> Correction:
    """The results; `late` are the views with the errors of an unknown time offset."""
    found, excess = final.found, final.excess
    rows = _rows(views, [str(name) for name in found.images.name])
    moved = found.images.centre - views.centre[rows]
    turn = np.swapaxes(views.R_frame_from_camera[rows], 1, 2) @ found.images.R_frame_from_camera
    turned = _vectors(turn)
    sigma = np.sqrt(np.diagonal(late.covariance[rows], axis1=1, axis2=2))
    sigma = np.maximum(sigma, np.repeat([LEAST_POSITION, LEAST_ATTITUDE], 3))
    names = {str(name) for name in found.images.name}
    return Correction(
        views=views,
        adjustment=found,
        excess=excess.ties,
        excess_of_control=excess.control if final.kept.control.size else 0.0,
        rms_before=rms_of_rays(views, found.block.observations.seen_often()),
        rms_after=float(np.sqrt(np.mean(found.residuals**2))),
        moved=moved,
        turned=turned,
        sigmas=np.max(np.abs(np.concatenate([moved, turned], axis=1)) / sigma, axis=1),
        left_out=given - len(found.block.observations),
        unconnected=[str(name) for name in views.name if str(name) not in names],
        control=control,
        control_residuals=None if control is None else residuals_of(control, found, excess.control),
        blunders=blunders,
    )


def rms_of_rays(views: Views, observations: ImagePoints) -> float:
    """RMS distance per axis in px of measurements from the points where their rays come closest."""
    block = block_of_views(views, observations)
    rays = Rays.of(block)
    focal = {name: float(np.mean(np.asarray(camera.focal_px))) for name, camera in block.cameras.items()}
    each = np.array([focal[str(name)] for name in block.images.camera])[rays.image]
    return float(np.sqrt(0.5 * np.mean((rays.residual * rays.sigma * each) ** 2)))


def _some(names: list[str], most: int = 10) -> str:
    """The first names of a list, as text."""
    return ", ".join(names[:most]) + (" ..." if len(names) > most else "")


def _vectors(turn: np.ndarray) -> np.ndarray:
    """Rotation vectors (n, 3) of rotations (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(turn).as_rotvec()


def _rows(views: Views, names: list[str]) -> np.ndarray:
    index = {str(name): row for row, name in enumerate(views.name)}
    return np.array([index[name] for name in names], int)
