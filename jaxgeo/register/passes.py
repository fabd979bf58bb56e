"""One pass of a registration: compare, match, choose, and make tie points."""

from __future__ import annotations

import numpy as np

from jaxgeo._record import Record
from jaxgeo.register.blocks import BlockOutcome, Matches, blocks_of, count_outcomes
from jaxgeo.register.chance import false_alarms, second_best
from jaxgeo.register.choice import Chosen
from jaxgeo.register.images import Images, RegistrationFailed
from jaxgeo.register.matching import match_blocks
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.plan import Plan, Search
from jaxgeo.register.prediction import Shifts
from jaxgeo.register.ties import TiePoints
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.model_inputs import ModelInputs

# Cells by which a block may be shifted beside what the navigation's errors do: at first so many that it can be told
# whether blocks agree by chance, even where the navigation leaves little to be sought.
AT_FIRST, LATER = 3.0, 1.0
MOSTLY = 0.6  # of the blocks


class Pass(Record):
    """What a pass did. `cell` is the side of a cell in m, `block` that of a block in cells. `offered` blocks could be
    matched, `agreeing` were chosen, `rival` is how many agree on something else, `false_alarms` how often chance would
    do as well. `shifts` are those of the blocks' middles; `searched` cells were compared in all."""

    cell: float
    block: int
    matches: Matches
    chosen: Chosen
    shifts: Shifts
    offered: int
    agreeing: int
    rival: int
    false_alarms: float
    searched: int

    def moved_by(self, error: np.ndarray) -> float:
        """By how many cells the chosen blocks are moved by a change of the errors and the map's shift, root mean
        square."""
        by_error = np.asarray(self.shifts.by_error)[np.asarray(self.chosen.is_chosen)][:, :, : len(error)]
        return float(np.sqrt(np.mean(np.sum((by_error @ error) ** 2, axis=1))))

    def __str__(self) -> str:
        text = (
            f"cells of {self.cell:.3g} m, {len(self.matches.outcome)} blocks of {self.block}: {self.agreeing} of "
            f"{self.offered} agree, {self.rival} on another pose, {self.false_alarms:.1e} false alarms"
        )
        dropped = {k: n for k, n in count_outcomes(self.matches.outcome).items() if k is not BlockOutcome.matched}
        return text + "".join(f"; {number} {one.name}" for one, number in dropped.items())


def one_pass(
    look: ModelInputs,
    model: ErrorModel,
    covariance: np.ndarray,
    images: Images,
    search: Search,
    plan: Plan,
    *,
    is_first: bool,
) -> tuple[Pass, TiePoints]:
    """(what a pass did, the tie points of the blocks that agree), of a look whose errors have a covariance (axes and
    the map's shift). Raises `Stopped` where no blocks could be matched."""
    pair = plan.comparison(look, model, images, plan.place, plan.block)
    centres = blocks_of(pair.known, plan.block)
    if not len(centres):
        raise RegistrationFailed(Outcome.too_small)
    reach = plan.block / 2.0
    matches = match_blocks(
        pair.grey,
        pair.known,
        pair.reference,
        pair.known_reference,
        centres,
        _covariances(pair.shifts(centres, reach), covariance, AT_FIRST if is_first else LATER),
        size=plan.block,
        probability=search.probability,
    )
    _check_blocks(matches)
    shifts = pair.shifts(np.asarray(matches.centre), reach)
    jacobian = np.where(np.asarray(shifts.seen)[:, None, None], np.asarray(shifts.by_error), 0.0)
    chosen = search.choice.choose(matches, jacobian, covariance)
    rival = second_best(search.choice, matches, chosen, jacobian, covariance)
    outcomes = count_outcomes(matches.outcome)
    offered = sum(
        outcomes.get(one, 0) for one in (BlockOutcome.matched, BlockOutcome.no_peak, BlockOutcome.not_refined)
    )
    done = Pass(
        cell=pair.cell,
        block=plan.block,
        matches=matches,
        chosen=chosen,
        shifts=shifts,
        offered=offered,
        agreeing=chosen.count,
        rival=rival.count,
        false_alarms=false_alarms(matches, chosen),
        searched=int(np.sum(np.asarray(matches.searched))),
    )
    return done, pair.ties(matches, chosen, shifts).moved(images.shift)


def _covariances(shifts: Shifts, cov: np.ndarray, aside: float) -> np.ndarray:
    """Of the shifts of blocks; the largest of all for those whose middle is not seen."""
    covariance = np.asarray(shifts.covariance(cov)) + aside**2 * np.eye(2)
    seen = np.asarray(shifts.seen) & np.isfinite(covariance).all(axis=(1, 2))
    if not seen.any():
        raise RegistrationFailed(Outcome.unknown_ground)
    largest = covariance[seen][np.argmax(np.trace(covariance[seen], axis1=1, axis2=2))]
    covariance = np.where(seen[:, None, None], covariance, largest)
    return 0.5 * (covariance + np.swapaxes(covariance, 1, 2))


def _check_blocks(matches: Matches) -> None:
    """Raise `Stopped` where most blocks have the same reason not to be matched."""
    counts = count_outcomes(matches.outcome)
    looked_at = len(matches.outcome) - counts.get(BlockOutcome.outside_image, 0)
    reasons = {BlockOutcome.no_texture: Outcome.no_texture, BlockOutcome.off_reference: Outcome.off_reference}
    for block, outcome in reasons.items():
        if counts.get(block, 0) > MOSTLY * max(looked_at, 1):
            raise RegistrationFailed(outcome)
