"""Data snooping (Baarda 1968) from a robust start, with restoration of measurements that pass."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from jaxgeo._renamed import renamed_argument
from jaxgeo.adjust._reliability import Blunder, named
from jaxgeo.adjust.adjustment import Adjustment
from jaxgeo.adjust.block import Block
from jaxgeo.adjust.bundle import BehindCamera, InnerConstraints, adjusted
from jaxgeo.adjust.equations import known_points
from jaxgeo.adjust.hypotheses import Hypotheses, limit, of_control, of_image_points
from jaxgeo.adjust.kept import Kept, block_of, control_of, masked, set_aside
from jaxgeo.adjust.losses import AbstractLoss, Cauchy, LeastSquares
from jaxgeo.adjust.measurements import image_residuals
from jaxgeo.adjust.problem import Prepared, prepared
from jaxgeo.adjust.ray_consensus import Rays
from jaxgeo.adjust.refined import bent_at
from jaxgeo.adjust.screening import CONTROL_POINT, IMAGE_POINT, SIGMAS, Screen, screened_of
from jaxgeo.adjust.solve import Solver, solve
from jaxgeo.adjust.terrain_heights import HeightObservations
from jaxgeo.adjust.tie_start import start_by_ties
from jaxgeo.adjust.unknowns import Unknowns
from jaxgeo.adjust.values import Values

CLEAR = 2.0  # times the limit: residual of the robust solution above which a measurement is set aside
NEARLY = 0.5  # of the worst: similarly bad measurements elsewhere in the block are removed with it


@renamed_argument("told", "callback")
def without_blunders(
    block: Block,
    unknowns: Unknowns | None = None,
    *,
    alpha: float = 0.001,
    most: int = 100,
    callback: Callable[[Blunder], Any] | None = None,
    screen: float | None = SIGMAS,
    loss: AbstractLoss | None = None,
    datum: InnerConstraints | None = None,
    terrain: HeightObservations | None = None,
    solver: Solver | None = None,
) -> tuple[Adjustment, list[Blunder]]:
    """(adjustment, blunders): remove image points and control points that do not fit, and adjust the rest.

    The block is screened as by `adjust`, then adjusted with a redescending loss (Cauchy), and outliers are set aside.
    From there, by least squares, the worst measurement is removed and the block adjusted again until no test at `alpha`
    fails; removed measurements that pass are restored. The adjustment is that of the rest.

    `alpha` applies to each test: of n good measurements about alpha n are rejected; with alpha / n, any at all in a
    good block with probability `alpha` at most. A point that is left with one ray is removed completely. At most `most`
    measurements are removed; a `RuntimeWarning` reports whether more are left. `callback` is called with each blunder;
    the other options are those of `adjust`. Raises as `adjust`.
    """
    snooping = _Snooping.of(block, Unknowns() if unknowns is None else unknowns, terrain, screen, callback)
    snooping.loss = LeastSquares() if loss is None else loss
    snooping.datum, snooping.solver, snooping.limit, snooping.most = datum, solver, limit(alpha), most
    snooping.start_robustly()
    adjustment = snooping.finished()
    if len(snooping.found) >= most and (left := snooping.suspects(adjustment)):
        warnings.warn(
            f"{len(snooping.found)} blunders are taken out, as many as most={most} allows, and more are left: the next "
            f"is {left[0]}. Allow more, or look at the block.",
            RuntimeWarning,
            stacklevel=2,
        )
    return adjustment, snooping.blunders


@dataclass
class _Snooping:
    """State of the snooping. `found` by (kind, row): the blunder, or None if set aside and not tested yet; `back`:
    measurements already restored once, which happens only once."""

    block: Block
    unknowns: Unknowns
    full: Prepared
    screened: Screen
    callback: Callable[[Blunder], Any] | None
    kept: Kept
    found: dict[tuple[str, int], Blunder | None] = field(default_factory=dict)
    back: set[tuple[str, int]] = field(default_factory=set)
    loss: AbstractLoss = field(default_factory=LeastSquares)
    datum: InnerConstraints | None = None
    solver: Solver | None = None
    limit: float = 0.0
    most: int = 0
    values: Values | None = None

    @classmethod
    def of(
        cls, block: Block, unknowns: Unknowns, terrain: HeightObservations | None, screen: float | None, callback: Any
    ) -> _Snooping:
        screened, values = screened_of(block, unknowns, screen), None
        full = prepared(block, unknowns, terrain, set_aside(block, screened.kept))
        if screen is not None and len(control_of(block)):
            screened, values = start_by_ties(block, full, screened, screen, (LeastSquares(), Cauchy()))
            full = prepared(block, unknowns, terrain, set_aside(block, screened.kept))
        snooping = cls(block, unknowns, full, screened, callback, screened.kept, values=values)
        snooping.found = {(one.kind, one.row): None for one in screened.aside}
        return snooping

    @property
    def blunders(self) -> list[Blunder]:
        return [blunder for blunder in self.found.values() if blunder is not None]

    def start_robustly(self) -> None:
        """Least squares, then Cauchy's loss from there; outliers are set aside."""
        problem = masked(self.block, self.full, self.kept).problem
        first = solve(problem, LeastSquares(), self.solver, start=self.values).values
        finite = bool(np.all(np.isfinite(np.asarray(first.centre))) and np.all(np.isfinite(np.asarray(first.points))))
        values = solve(problem, Cauchy(), self.solver, start=first if finite else None).values
        self.values, self.full = values, bent_at(self.full, values)
        points = np.asarray(image_residuals(self.full.problem, values)).T[self.full.order.place]
        sizes = np.where(self.kept.rows, np.linalg.norm(points, axis=1), 0.0)
        off = np.asarray(known_points(self.full.problem, values))
        control = control_of(self.block)
        row_of = dict(zip(self.full.names.point.tolist(), self.full.order.row_of_point.tolist(), strict=True))
        of_control = [np.linalg.norm(off[row_of[name]]) if name in row_of else 0.0 for name in control.name.tolist()]
        of_control = np.where(self.kept.control, np.array(of_control), 0.0)
        both = [(size, IMAGE_POINT, row) for row, size in enumerate(sizes)]
        both += [(size, CONTROL_POINT, row) for row, size in enumerate(of_control)]
        clear = sorted((one for one in both if one[0] > CLEAR * self.limit), reverse=True)
        for _, kind, row in clear[: max(self.most - len(self.found), 0)]:
            less = self.less([(kind, row)])
            if np.sum(self.kept.rows) - np.sum(less.rows) <= (kind == IMAGE_POINT):  # or its point would be lost
                self.kept = less
                self.found[kind, row] = None

    def finished(self) -> Adjustment:
        """The final adjustment, when nothing is left to remove or restore."""
        while True:
            adjustment = self.adjusted()
            if adjustment is None:
                continue
            tests = self.tests(adjustment)
            returned = self.fitting(*tests) or self.fitting_points(adjustment)
            if returned:
                self.take_back(returned)
                continue
            self.describe(*tests)
            worst = _worst(self.suspects(adjustment, tests))[: max(self.most - len(self.found), 0)]
            if not worst:
                return adjustment
            self.take_out(worst)

    def adjusted(self) -> Adjustment | None:
        """Adjustment of the kept measurements; None if points went behind a camera, whose measurements are then set
        aside."""
        ready, block = masked(self.block, self.full, self.kept), block_of(self.block, self.kept)
        solution = solve(ready.problem, self.loss, self.solver, start=self.values)
        aside = tuple(one for one in self.screened.aside if (one.kind, one.row) in self.found)
        screened = replace(self.screened, kept=self.kept, aside=aside)
        try:
            found = adjusted(block, self.unknowns, ready, solution, self.loss, self.datum, screened)
        except BehindCamera as error:
            rows = np.flatnonzero(self.kept.rows)[error.rows]
            less = self.less([(IMAGE_POINT, int(row)) for row in rows])
            if len(self.found) + len(rows) > self.most or not less.leaves_every_image(self.block):
                raise
            self.kept = less
            self.found |= dict.fromkeys((IMAGE_POINT, int(row)) for row in rows)
            self.back |= {(IMAGE_POINT, int(row)) for row in rows}
            return None
        self.values = solution.values
        return found

    def less(self, out: list[tuple[str, int]]) -> Kept:
        """The kept measurements without those in `out`."""
        rows, control = self.kept.rows.copy(), self.kept.control.copy()
        for kind, row in out:
            (rows if kind == IMAGE_POINT else control)[row] = False
        return Kept(rows, control).whole(self.block)

    def tests(self, adjustment: Adjustment) -> tuple[Hypotheses, Hypotheses]:
        """Tests of all measurements of the block, kept or not."""
        points = of_image_points(adjustment, self.full, self.kept.rows)
        control = of_control(adjustment, control_of(self.block), self.full, self.kept)
        there = np.isin(self.block.observations.point, adjustment.prepared.names.point)
        return replace(points, statistic=np.where(there, points.statistic, 0.0)), control

    def suspects(self, adjustment: Adjustment, tests: tuple[Hypotheses, Hypotheses] | None = None) -> list[Blunder]:
        """Kept measurements that fail their test, the worst first."""
        points, control = self.tests(adjustment) if tests is None else tests
        points = replace(points, statistic=np.where(self.kept.rows, points.statistic, 0.0))
        control = replace(control, statistic=np.where(self.kept.control, control.statistic, 0.0))
        found = named(self.block, points, control, self.limit)
        # # Each blunder costs an image at most one measurement, as each point occurs in it once.
        if np.min(self.kept.of_images(self.block)) > 1:
            return found
        return [blunder for blunder in found if self.can_go(blunder)]

    def can_go(self, blunder: Blunder) -> bool:
        """Whether every image has measurements left without it."""
        return self.less([(blunder.kind, blunder.row)]).leaves_every_image(self.block)

    def fitting(self, points: Hypotheses, control: Hypotheses) -> list[tuple[str, int]]:
        """Measurements set aside that pass their test."""
        fits = []
        for key in self.found:
            test = points if key[0] == IMAGE_POINT else control
            if key not in self.back and 0.0 < test.statistic[key[1]] <= self.limit:
                fits.append(key)
        return fits

    def fitting_points(self, adjustment: Adjustment) -> list[tuple[str, int]]:
        """Points removed completely before the adjustment whose rays intersect."""
        observations = self.block.observations
        lost = {key for key, blunder in self.found.items() if key[0] == IMAGE_POINT and blunder is None} - self.back
        names = {str(observations.point[row]) for _, row in lost} - set(adjustment.prepared.names.point.tolist())
        if not names:
            return []
        changed = {"cameras": adjustment.cameras, "images": adjustment.images, "readout": adjustment.readouts}
        rays = Rays.of(replace(self.block, **changed))
        good = [name for name in names if np.max(rays.residual[observations.point == name]) < self.limit]
        return [(IMAGE_POINT, int(row)) for name in good for row in np.flatnonzero(observations.point == name)]

    def take_back(self, keys: list[tuple[str, int]]) -> None:
        rows, control = self.kept.rows.copy(), self.kept.control.copy()
        for kind, row in keys:
            (rows if kind == IMAGE_POINT else control)[row] = True
            self.found.pop((kind, row), None)
        # # Measurements removed with their point are restored with it, unless they are blunders themselves.
        observations = self.block.observations
        again = np.isin(observations.point, observations.point[[row for kind, row in keys if kind == IMAGE_POINT]])
        again[[row for kind, row in self.found if kind == IMAGE_POINT]] = False
        self.back |= set(keys)
        self.kept = Kept(rows | again, control).whole(self.block)

    def describe(self, points: Hypotheses, control: Hypotheses) -> None:
        """Convert measurements set aside before the adjustment to blunders, with current test results."""
        waiting = [key for key, blunder in self.found.items() if blunder is None]
        if not waiting:
            return
        of_points, of_control = ([row for of, row in waiting if of == kind] for kind in (IMAGE_POINT, CONTROL_POINT))
        points, control = points.alone(of_points), control.alone(of_control)
        tested = {(b.kind, b.row): b for b in named(self.block, points, control, 0.0)}
        screened = {(one.kind, one.row): one.sigmas for one in self.screened.aside}
        observations = self.block.observations
        for key in waiting:
            if key not in self.found:  # reported as the other ray of a point
                continue
            kind, row = key
            point = str(observations.point[row] if kind == IMAGE_POINT else control_of(self.block).name[row])
            image = str(observations.image[row]) if kind == IMAGE_POINT else ""
            blunder = tested.get(key)
            if blunder is None:  # its point has no measurements left
                others = [
                    (k, r) for k, r in waiting if k == IMAGE_POINT and r != row and observations.point[r] == point
                ]
                instead = tuple(str(observations.image[r]) for _, r in others)
                size, none = screened.get(key, np.inf), (np.nan,) * (2 if kind == IMAGE_POINT else 3)
                blunder = Blunder(image, point, row, float(size), none, instead, kind)
                for other in others:
                    self.found.pop(other, None)
            self.record(key, blunder)

    def take_out(self, worst: list[Blunder]) -> None:
        self.kept = self.less([(blunder.kind, blunder.row) for blunder in worst])
        for blunder in worst:
            self.record((blunder.kind, blunder.row), blunder)

    def record(self, key: tuple[str, int], blunder: Blunder) -> None:
        self.found.pop(key, None)  # in the order of detection
        self.found[key] = blunder
        if self.callback is not None:
            self.callback(blunder)


def _worst(found: list[Blunder]) -> list[Blunder]:
    """The worst, and similarly bad ones in other images and of other points, which cannot be caused by it."""
    chosen: list[Blunder] = []
    for blunder in found:
        apart = all(blunder.point != other.point and blunder.image != other.image for other in chosen)
        if apart and blunder.standardised > NEARLY * found[0].standardised:
            chosen.append(blunder)
    return chosen
