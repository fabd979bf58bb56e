"""One registration pass: compare, match, select and make tie points."""

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

# # Cells added in quadrature to the predicted block shifts; larger in the first pass, so that the test against chance
# agreement has enough shifts even where the navigation is accurate.
AT_FIRST, LATER = 3.0, 1.0
MOSTLY = 0.6  # of the blocks


class Pass(Record):
    """Result of a pass. `cell` is the side of a cell in m, `block` that of a block in cells. `offered` is the number
    of blocks that could be matched, `agreeing` that of the chosen ones, `rival` the size of the second-best set,
    `false_alarms` the expected number of chance agreements as large. `shifts` are those of the block centres;
    `searched` is the total number of shifts compared.
    """

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
        """Root mean square shift of the chosen blocks in cells by a change of the errors and the map shift."""
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
    inputs: ModelInputs,
    model: ErrorModel,
    covariance: np.ndarray,
    images: Images,
    search: Search,
    plan: Plan,
    *,
    is_first: bool,
) -> tuple[Pass, TiePoints]:
    """(result of the pass, tie points of the agreeing blocks) for model inputs whose errors and map shift have
    `covariance` (axes + 2, axes + 2). Raises `RegistrationFailed` if no blocks could be matched."""
    pair = plan.comparison(inputs, model, images, plan.place, plan.block)
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
    """Covariances of the block shifts; blocks with hidden centres get the largest of all."""
    covariance = np.asarray(shifts.covariance(cov)) + aside**2 * np.eye(2)
    seen = np.asarray(shifts.seen) & np.isfinite(covariance).all(axis=(1, 2))
    if not seen.any():
        raise RegistrationFailed(Outcome.unknown_ground)
    largest = covariance[seen][np.argmax(np.trace(covariance[seen], axis1=1, axis2=2))]
    covariance = np.where(seen[:, None, None], covariance, largest)
    return 0.5 * (covariance + np.swapaxes(covariance, 1, 2))


def _check_blocks(matches: Matches) -> None:
    """Raise `RegistrationFailed` if most blocks failed for the same reason."""
    counts = count_outcomes(matches.outcome)
    looked_at = len(matches.outcome) - counts.get(BlockOutcome.outside_image, 0)
    reasons = {BlockOutcome.no_texture: Outcome.no_texture, BlockOutcome.off_reference: Outcome.off_reference}
    for block, outcome in reasons.items():
        if counts.get(block, 0) > MOSTLY * max(looked_at, 1):
            raise RegistrationFailed(outcome)
