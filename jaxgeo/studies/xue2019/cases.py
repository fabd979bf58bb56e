"""The paper's cases on a simulated block, from direct georeferencing to the calibrated result."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust import (
    Adjustment,
    Block,
    Fixed,
    Free,
    GroundPoints,
    ImagePoints,
    Prior,
    TwoStep,
    Unknowns,
    adjust,
    calibration,
    two_step_boresight,
)
from jaxgeo.rotations import rotation_vector_from_R
from jaxgeo.sensor import AbstractCorrection, Bauer, BrownPhysical, Ebner, Mount, Sensor
from jaxgeo.studies.xue2019 import printed
from jaxgeo.studies.xue2019.printed import Interior
from jaxgeo.studies.xue2019.simulation import Flown, Simulated, boresight_of, interior_of, measured, with_lens

MODELS: dict[str, type[AbstractCorrection]] = {"Bauer": Bauer, "Ebner": Ebner, "Brown": BrownPhysical}
PRINTED_AS = {"direct pair": "direct", "compensated pair": "compensated", "free net position": "free net"}
FIELD_IMAGE, FIELD_GROUND = 1.0, (0.03, 0.05, 0.09)  # px and m: measurement noise that fits the print with control
LOOSE = 100.0  # factor on the navigation's sigmas: it starts an adjustment without constraining it
SMALL = 0.05 / (0.5 * printed.COLUMNS * printed.PIXEL_PITCH)  # 0.05 mm at the image's edge, in half sides: a prior
MINUTES = 60.0 * np.rad2deg(1.0)  # of arc
BARRED = 1e6  # px, sigma that excludes a ray; array shapes stay, so the compiled program is reused


@dataclass(frozen=True)
class Case:
    """Errors of one case at check points (`differences` (m, 3), estimated minus surveyed, m), and the printed RMS."""

    name: str
    title: str
    checks: GroundPoints
    differences: np.ndarray
    printed: tuple[float, float, float] | None
    remark: str

    @property
    def rms(self) -> np.ndarray:
        """Root mean square (3,) in x, y and z, m."""
        return np.sqrt(np.mean(self.differences**2, axis=0))

    @property
    def plane(self) -> float:
        """Root of the summed squares of the RMS in x and y, m."""
        return float(np.hypot(*self.rms[:2]))


class Recovered(NamedTuple):
    """Result of a self-calibration, with standard deviations of unit weight: mm, and minutes of arc about x, y, z.

    `off` and `covariance` are the errors of the boresight, a rotation vector in body axes, in minutes of arc.
    """

    model: str
    interior: Interior
    sigma_interior: Interior
    boresight: np.ndarray
    sigma_boresight: np.ndarray
    off: np.ndarray
    covariance: np.ndarray
    sigma0: float


class Cases(NamedTuple):
    """All cases, the calibration results (three models in one step, and in two), the adjustment with the last model,
    and the sensor that it calibrates."""

    cases: list[Case]
    recovered: list[Recovered]
    adjustment: Adjustment
    calibrated: Sensor

    def of(self, name: str) -> Case:
        """A case by name."""
        return next(case for case in self.cases if case.name == name)


def cases_of(
    found: Simulated, callback: Callable[[str], None] = lambda _: None, models: Sequence[str] = tuple(MODELS)
) -> Cases:
    """Every case on one block; `callback` is called with the name of the next case, `models` names the self-calibration
    models.

    With the last model the boresight is estimated in two steps, and direct georeferencing is compensated. Cases without
    additional parameters include those of the last model, fixed at zero, so that all cases share one compiled program.
    Direct georeferencing fixes the navigation's orientations and intersects every point separately.
    """
    last = models[-1]
    everywhere, checks, pair = found.ground, found.checks, adjacent_pairs(found)
    held = Unknowns(images=Fixed())
    cases = []

    def add(name: str, block: Block, unknowns: Unknowns, points: GroundPoints) -> Adjustment:
        callback(name)
        adjustment = adjust(block, unknowns)
        cases.append(_case(name, points, adjustment.differences(points)))
        return adjustment

    add("direct", found.block(MODELS[last], control=False), held, everywhere)
    add("direct pair", found.block(MODELS[last], control=False, observations=pair), held, everywhere)
    add("free net position", found.block(MODELS[last], control=False, attitude=False), Unknowns(), everywhere)
    add("free net", found.block(MODELS[last], control=False), Unknowns(), everywhere)
    add("control", found.block(MODELS[last], loosened=LOOSE), Unknowns(), checks)
    recovered, adjustment = [], None
    for name in models:
        adjustment = add(name, found.block(MODELS[name]), self_calibration(MODELS[name]), checks)
        recovered.append(one_step(name, adjustment, found))
    assert adjustment is not None
    callback("two steps")
    loose = adjust(found.block(MODELS[last], loosened=LOOSE), self_calibration(MODELS[last], boresight=False))
    step = two_step_boresight(loose, navigation=found.block().navigation)
    recovered.append(two_steps(last, loose, step, found))
    updated = calibration(adjustment, with_lens(found.given, MODELS[last])).sensor
    add("compensated", found.block(sensor=updated, control=False), held, everywhere)
    add("compensated pair", found.block(sensor=updated, control=False, observations=pair), held, everywhere)
    return Cases(cases, recovered, adjustment, updated)


def field_cases(
    flight: Flown, seed: int, callback: Callable[[str], None] = lambda _: None, models: Sequence[str] = tuple(MODELS)
) -> list[Case]:
    """The cases with control, with noisier image points and targets (`FIELD_IMAGE`, `FIELD_GROUND`).

    The adjustments use the matching sigmas and reuse the compiled programs of `cases_of`.
    """
    found = measured(flight, seed, sigma_image=FIELD_IMAGE, sigma_ground=FIELD_GROUND)
    cases = []
    for name in ("control", *models):
        callback(f"{name}, more noise")
        if name == "control":
            adjustment = adjust(found.block(MODELS[models[-1]], loosened=LOOSE), Unknowns(), screen=None)
        else:
            adjustment = adjust(found.block(MODELS[name]), self_calibration(MODELS[name]), screen=None)
        cases.append(_case(name, found.checks, adjustment.differences(found.checks)))
    return cases


def pair_draws(
    flight: Flown, calibrated: Sensor, lens: type[AbstractCorrection], seeds: Sequence[int]
) -> dict[str, np.ndarray]:
    """Errors (draws, 3), RMS in m, of direct georeferencing from adjacent pairs with other noise.

    "direct" uses the maker's calibration, "compensated" the `calibrated` sensor.
    """
    held, rows = Unknowns(images=Fixed()), {"direct": [], "compensated": []}
    for seed in seeds:
        found = measured(flight, seed)
        pair = adjacent_pairs(found)
        for name, block in (
            ("direct", found.block(lens, control=False, observations=pair)),
            ("compensated", found.block(sensor=calibrated, control=False, observations=pair)),
        ):
            differences = adjust(block, held, screen=None).differences(found.ground)
            rows[name].append(np.sqrt(np.mean(differences**2, axis=0)))
    return {name: np.array(found) for name, found in rows.items()}


def self_calibration(lens: type[AbstractCorrection], *, boresight: bool = True) -> Unknowns:
    """Unknowns: interior orientation, additional parameters not redundant with it, and the boresight.

    The additional parameters have a small prior (0.05 mm at the image's edge): Brown's are many for one block.
    """
    names = [name for name in lens.names if name not in lens.interior]
    return Unknowns(
        focal=Free(),
        principal=Free(),
        distortion=dict.fromkeys(names, Prior(SMALL)),
        boresight=Free() if boresight else Fixed(),
    )


def strips_apart(found: Simulated) -> ImagePoints:
    """The measurements without tie points across strips.

    A tie point seen from two strips becomes two points; a surveyed point stays in the strip that sees it most often.
    """
    seen = found.observations
    strip_of = dict(zip(found.image.tolist(), found.strip.tolist(), strict=True))
    strip = np.array([strip_of[name] for name in seen.image.tolist()])
    surveyed = np.isin(seen.point, found.ground.name)
    name = np.array([f"{point} of {line}" for point, line in zip(seen.point.tolist(), strip.tolist(), strict=True)])
    name = np.where(surveyed, seen.point, name)
    kept = np.ones(len(name), bool)
    for target in found.ground.name.tolist():
        rows = np.flatnonzero(seen.point == target)
        strips, counts = np.unique(strip[rows], return_counts=True)
        kept[rows[strip[rows] != strips[np.argmax(counts)]]] = False
    return ImagePoints(seen.image[kept], name[kept], seen.uv[kept], seen.sigma[kept]).seen_often()


def adjacent_pairs(found: Simulated) -> ImagePoints:
    """The measurements with two images per surveyed point: the neighbours in a strip around which it is best centred.

    Other rays to these points are excluded by their sigma (`BARRED`).
    """
    seen = found.observations
    index = {name: i for i, name in enumerate(found.image.tolist())}
    image = np.array([index[name] for name in seen.image.tolist()])
    sigma = np.array(seen.sigma)
    middle = np.array([printed.COLUMNS - 1, printed.ROWS - 1]) / 2.0
    for name in found.ground.name.tolist():
        rows = np.flatnonzero(seen.point == name)
        rows = rows[np.argsort(image[rows])]
        first, second = rows[:-1], rows[1:]
        next_to = (image[second] == image[first] + 1) & (found.strip[image[second]] == found.strip[image[first]])
        off = np.linalg.norm(0.5 * (seen.uv[first] + seen.uv[second]) - middle, axis=1)
        best = int(np.argmin(np.where(next_to, off, np.inf)))
        sigma[np.setdiff1d(rows, [first[best], second[best]])] = BARRED
    return ImagePoints(seen.image, seen.point, seen.uv, sigma)


def one_step(model: str, adjustment: Adjustment, found: Simulated) -> Recovered:
    """Interior orientation and boresight as estimated by an adjustment."""
    at = {p.name: i for i, p in enumerate(adjustment.parameters)}
    sigma = np.array([p.sigma for p in adjustment.parameters])
    turns = [at[f"boresight {axis}"] for axis in "xyz"]
    covariance = adjustment.correlations[np.ix_(turns, turns)] * np.outer(sigma[turns], sigma[turns])
    interior, spread = _interior(adjustment)
    return Recovered(
        model, interior, spread, *_boresight(adjustment.mounts["camera"], covariance, found.true), adjustment.sigma0
    )


def two_steps(model: str, adjustment: Adjustment, step: TwoStep, found: Simulated) -> Recovered:
    """The same from an adjustment on control alone; the boresight comes from its orientations and the navigation."""
    interior, spread = _interior(adjustment)
    turn = _boresight(step.mount, step.covariance[:3, :3], found.true)
    return Recovered(f"{model}, two steps", interior, spread, *turn, step.sigma0)


def _interior(adjustment: Adjustment) -> tuple[Interior, Interior]:
    sigma = {p.name: p.sigma * printed.PIXEL_PITCH for p in adjustment.parameters}
    spread = Interior(sigma["focal"], sigma["principal column"], sigma["principal row"])
    return interior_of(adjustment.cameras["camera"]), spread


def _boresight(
    mount: Mount, covariance: np.ndarray, true: Sensor
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(angles about x, y, z; standard deviations; error as a rotation vector; its covariance), minutes of arc."""
    spread = np.sqrt(np.diagonal(covariance))
    return boresight_of(mount), spread * MINUTES, boresight_off(mount, true) * MINUTES, covariance * MINUTES**2


def boresight_off(mount: Mount, true: Sensor) -> np.ndarray:
    """Boresight error against the true one as a rotation vector, body axes, rad."""
    R = np.asarray(mount.R_body_from_base) @ np.asarray(true.mount.R_body_from_base).T
    return np.asarray(rotation_vector_from_R(jnp.asarray(R)))


def _case(name: str, checks: GroundPoints, differences: np.ndarray) -> Case:
    title, remark = TOLD[name]
    return Case(name, title, checks, differences, printed.RMS.get(PRINTED_AS.get(name, name)), remark)


TOLD: dict[str, tuple[str, str]] = {
    "direct": (
        "direct, all rays",
        "boresight and principal point pull the other way in the next strip: all rays together even that out",
    ),
    "direct pair": ("direct, adjacent pair", "within a strip they do not: of these rays the print can be"),
    "free net position": ("free net, POS position", "what is left in height is the focal length's"),
    "free net": ("free net, POS position and attitude", "as above; the sheet on the free net tries other assumptions"),
    "control": (
        "control, no parameters",
        "the cameras rise by 2 m, and what is left of the focal length is 0.4 % of the relief",
    ),
    "Bauer": ("control, Bauer", ""),
    "Ebner": ("control, Ebner", ""),
    "Brown": ("control, Brown", ""),
    "compensated": ("compensated, all rays", "the navigation's noise, over ten rays"),
    "compensated pair": ("compensated, adjacent pair", "the same of two rays"),
}
