"""Image registration with a reference map: iterated matching and orientation updates."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy  # submodules load lazily
from jax.typing import ArrayLike

from jaxgeo._arguments import check_mapped_terrain, checked_air, checked_exposure
from jaxgeo._checks import as_float64, check_is, require_x64
from jaxgeo._record import Record
from jaxgeo.adjust.losses import AbstractLoss, Huber
from jaxgeo.earth import Atmosphere
from jaxgeo.observation import Exposure, accepts_exposure
from jaxgeo.ortho.orthoimage import Orthoimage
from jaxgeo.ortho.rectification import checked_image
from jaxgeo.register.choice import AbstractChoice
from jaxgeo.register.consensus import PoseConsensus
from jaxgeo.register.images import Images, RegistrationFailed
from jaxgeo.register.orientation_update import update_orientation
from jaxgeo.register.outcome import Outcome
from jaxgeo.register.passes import Pass, one_pass
from jaxgeo.register.plan import SIDES, Search, planned
from jaxgeo.register.posterior import Update
from jaxgeo.register.prior import Prior, checked_prior
from jaxgeo.register.residual_correlation import morans_i_zscore
from jaxgeo.register.tie_errors import TieErrors
from jaxgeo.register.ties import TiePoints
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty.linear import Propagation
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs, of_arrays

LEAST_REGISTRATION = 0.1  # cells: lower bound of the registration error of ties
COARSER = 1  # retries in coarser cells before the first pass is given up
MORE, ROUNDS = 1.02, 6  # residuals over their expected size, above which the registration error is raised; rounds
HUBER, CONSENSUS = Huber(), PoseConsensus()


class Limits(Record):
    """Acceptance criteria of a registration.

    `false_alarms` is the largest expected number of chance agreements. At least `least_blocks`, and the share
    `least_share` of the blocks that have texture and lie on the reference, must agree. If a second set has the share
    `rival` of the agreeing blocks, the registration is ambiguous. A navigation error whose probability under the prior
    is below `beyond_prior` is rejected. Passes continue until ties move by less than `settled` cells, at most
    `most_passes`. `most_residual` in cells limits the standard deviation of the tie residuals. If ties fit worse than
    their errors by more than the factor `misfit`, their residuals must be spatially uncorrelated: a Moran's I of
    `alike` standard deviations or more indicates a systematic error, which would make the covariance too small. Too few
    ties for this test fail it.
    """

    false_alarms: float = 1e-6
    least_blocks: int = 5
    least_share: float = 0.4
    rival: float = 0.6
    beyond_prior: float = 1e-6
    settled: float = 0.1
    most_passes: int = 10
    most_residual: float = 4.0
    misfit: float = 2.0
    alike: float = 2.5


LIMITS = Limits()


class Registration(Record):
    """Result of a registration. Without an update, `outcome` gives the reason and the other fields are not valid.

    `sensor`, `shot` and `terrain` are the updated ones if `accepted`, else the given ones. `update` has their errors,
    `tie_errors` those of the reference, its `registration` estimated from the residuals. `passes` lists the passes; the
    last one made the `ties`: their pixels, and their places on the reference.
    """

    outcome: Outcome = eqx.field(static=True)
    sensor: Sensor
    shot: Shot | Trajectory
    terrain: AbstractTerrain
    update: Update | None
    tie_errors: TieErrors
    ties: TiePoints | None
    passes: tuple[Pass, ...]

    @property
    def accepted(self) -> bool:
        """Whether there is an update."""
        return self.outcome is Outcome.registered

    def fix(self, uv: Any, terrain_sigma: ArrayLike | None = None, **options: Any) -> Propagation:
        """The ground point of a pixel and its covariance, as `Update.fix`.

        Raises `ValueError` if the image is not registered.
        """
        if self.update is None or not self.accepted:
            raise ValueError(f"the image is not registered: {self.outcome.name}: {self.outcome.message}")
        return self.update.fix(uv, terrain_sigma, **options)

    def __str__(self) -> str:
        lines = [f"{self.outcome.name}: {self.outcome.message}"]
        lines += [f"  {number}. {one}" for number, one in enumerate(self.passes, 1)]
        return "\n".join(lines)


@accepts_exposure
def register_image(
    sensor: Sensor,
    shot: Shot | Trajectory,
    image: Any,
    reference: Orthoimage,
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    tie_errors: TieErrors,
    *,
    known: Any = None,
    prior: Prior | None = None,
    block: int = 300,
    probability: float = 0.999,
    choice: AbstractChoice = CONSENSUS,
    loss: AbstractLoss = HUBER,
    flatten: int | None = 31,
    measure: str = "grey",
    limits: Limits = LIMITS,
    time: ArrayLike | None = None,
    atmosphere: Atmosphere | None = None,
) -> Registration:
    """Register an image to a reference map of the same ground; returns the updated pose and its covariance.

    After Gu and Qiao (2017), "A method for high accuracy airborne optical image geolocation": the image is rectified
    with the navigation, its blocks are matched with the reference within the navigation's error bounds, agreeing blocks
    become tie points, and least squares with the navigation as prior updates sensor and shot. This repeats with the new
    pose, with smaller blocks and finer cells as the accuracy improves, until it is stable.

    `sensor`, `shot` (or a trajectory and the image's `time`), `image`, its `known` pixels and `atmosphere` are as for
    `rectify`; `reference` is an `Orthoimage` on any grid, coarser or finer than the image. `errors` is the navigation's
    `ErrorModel` (with an `InteriorOrientation` source the camera is updated as well). `tie_errors` are the errors of
    reference and terrain: `registration` is a lower bound and is raised to fit the residuals. The common map `shift` is
    observable through relief only, as the terrain does not shift with the map; its remaining uncertainty enters all
    covariances. Spatially correlated height errors belong in `terrain_field`: as independent tie errors they would make
    all covariances too small.
    `prior` carries over another image's update (see `propagate_prior`).

    `block` is the largest block side in cells; blocks are smaller where the navigation errors would distort them.
    Shifts are searched within the `probability` region of these errors; `choice` selects consistent candidates, and
    `loss` is that of the update. `flatten` is the width in cells of the local brightness and contrast normalisation;
    None disables it. `measure` is what is compared: "grey" values, or the "orientation" of their gradients
    (`orientation_channels`, without `flatten`), for a reference of another sensor, band or season.

    Agreements that chance, repetitive texture or a wrong area could cause are rejected (see `Limits`): `outcome` is
    then the reason, and sensor and shot are unchanged.
    On level ground no image can determine a common map shift: `shift` is an input that the caller must supply.
    Raises `ValueError` for an image of another size than the camera's, a `probability` of half or less, a `block` under
    32 cells, another `measure`, and as `rectify`, `match_blocks` and `update_orientation`.
    """
    require_x64()
    check_is(reference, Orthoimage, "reference", "Read one with jaxgeo.io.read_orthoimage.")
    check_is(tie_errors, TieErrors, "tie_errors")
    check_is(choice, AbstractChoice, "choice")
    if not 0.5 < probability < 1.0:
        raise ValueError(f"probability must lie between 0.5 and 1, to find what is likely; got {probability!r}.")
    if block < SIDES[0]:
        raise ValueError(f"block must be {SIDES[0]} cells or more: smaller ones tell nothing; got {block!r}.")
    sensor, motion, moment = checked_exposure(sensor, shot, time)
    check_mapped_terrain(terrain)
    values = checked_image(image, sensor)
    grey = np.asarray(values, np.float32).mean(axis=0, keepdims=True)
    inputs = ModelInputs(Exposure(sensor, motion, moment, checked_air(atmosphere)), terrain=of_arrays(terrain))
    model = checked_model(errors, inputs)
    tie_errors = as_float64(tie_errors, "tie_errors")
    prior = Prior.of(model, tie_errors) if prior is None else checked_prior(prior, model)
    images = Images(grey, known, reference, flatten, measure)
    search = Search(choice, probability, block)
    given = _Given(inputs, model, prior, tie_errors, loss, time is not None or isinstance(motion, Trajectory))
    return _registered(given, images, search, limits)


class _Given(Record):
    """Model inputs of the navigation, with its errors and those of the map."""

    inputs: ModelInputs
    model: ErrorModel
    prior: Prior
    tie_errors: TieErrors
    loss: AbstractLoss
    has_time: bool = eqx.field(static=True)

    def updated(self, ties: TiePoints, tie_errors: TieErrors) -> Update:
        """Update of the navigation's model inputs from ties."""
        inputs = self.inputs
        return update_orientation(
            inputs.sensor,
            inputs.motion,
            ties,
            inputs.terrain,
            self.model,
            tie_errors,
            prior=self.prior,
            loss=self.loss,
            time=inputs.time if self.has_time else None,
            atmosphere=inputs.air,
        )


def _registered(given: _Given, images: Images, search: Search, limits: Limits) -> Registration:
    passes: list[Pass] = []
    found: Update | None = None
    ties, tie_errors = None, given.tie_errors
    mean = np.asarray(given.prior.mean)
    inputs, images = _moved(given, mean[:-2]), images.less(mean[-2:])
    covariance = np.asarray(given.prior.covariance)

    def ended(outcome: Outcome) -> Registration:
        source = found if outcome is Outcome.registered and found is not None else given.inputs
        shot: Any = source.shot if isinstance(source, Update) else source.motion
        kept = found if outcome is Outcome.registered else None
        return Registration(outcome, source.sensor, shot, source.terrain, kept, tie_errors, ties, tuple(passes))

    coarser, factor, outcome = 0, None, Outcome.registered
    for _ in range(limits.most_passes):
        try:
            plan = planned(inputs, given.model, covariance, images, search, coarser)
            if coarser and plan.place.factor == factor:
                return ended(outcome)
            done, ties = one_pass(inputs, given.model, covariance, images, search, plan, is_first=found is None)
        except RegistrationFailed as stopped:
            return ended(stopped.outcome)
        passes.append(done)
        outcome = _judged(done, limits, is_first=found is None)
        if outcome is not Outcome.registered:
            if found is None and coarser < COARSER and outcome is not Outcome.ambiguous:
                coarser, factor = coarser + 1, plan.place.factor
                continue
            return ended(outcome)
        coarser = 0
        before = None if found is None else np.asarray(found.unknowns)
        found, tie_errors = _updated(given, ties, done.cell)
        if not bool(found.ok):
            return ended(Outcome.not_settled)
        if plan.is_last and not np.isfinite(float(found.sigma0_ties)):
            return ended(Outcome.few_agree)  # the pose can fit all ties exactly: no redundancy to check it
        if _beyond(found, limits):
            return ended(Outcome.beyond_prior)
        if plan.is_last and not _fits(given, ties, found, tie_errors, done.cell, limits):
            return ended(Outcome.does_not_fit)
        moved = np.inf if before is None else done.moved_by(np.asarray(found.unknowns) - before)
        inputs, covariance = _inputs_of(found, given.inputs), np.asarray(found.covariance)
        images = images.less(np.asarray(found.shift))
        if plan.is_last and moved < limits.settled:
            return ended(Outcome.registered)
    return ended(Outcome.not_settled)


def _updated(given: _Given, ties: TiePoints, cell: float) -> tuple[Update, TieErrors]:
    """Update with the registration error raised until the residuals match their expected size."""
    tie_errors = _least_errors(given, cell)
    found = given.updated(ties, tie_errors)
    for _ in range(ROUNDS):
        sigma0 = float(found.sigma0_ties)
        if not sigma0 > MORE:
            break
        registration = float(tie_errors.registration)
        raised = np.hypot(registration, np.sqrt(sigma0**2 - 1.0) * _tie_sigma(ties, tie_errors))
        tie_errors = eqx.tree_at(lambda e: e.registration, tie_errors, jnp.asarray(raised))
        found = given.updated(ties, tie_errors)
    return found, tie_errors


def _least_errors(given: _Given, cell: float) -> TieErrors:
    """The given errors, with the registration error at its lower bound or above."""
    least = max(float(given.tie_errors.registration), LEAST_REGISTRATION * cell)
    return eqx.tree_at(lambda e: e.registration, given.tie_errors, jnp.asarray(least))


def _fits(given: _Given, ties: TiePoints, found: Update, tie_errors: TieErrors, cell: float, limits: Limits) -> bool:
    """Whether the tie residuals are small, and random if larger than expected; False with too few ties to test that."""
    if not float(tie_errors.registration) <= limits.most_residual * cell:
        return False
    if _tie_sigma(ties, tie_errors) <= limits.misfit * _tie_sigma(ties, _least_errors(given, cell)):
        return True
    return morans_i_zscore(np.asarray(found.normalised), np.asarray(ties.uv)) < limits.alike


def _tie_sigma(ties: TiePoints, errors: TieErrors) -> float:
    """Standard deviation in m per map axis of a typical (median) tie, from its errors."""
    own = np.median(np.trace(np.asarray(ties.covariance), axis1=1, axis2=2)) / 2.0
    return float(np.sqrt(own + float(errors.registration) ** 2))


def _judged(done: Pass, limits: Limits, *, is_first: bool) -> Outcome:
    """Whether the blocks of a pass agree; chance agreement is tested in the first pass, with its large search area."""
    if len(done.matches.outcome) < limits.least_blocks:
        return Outcome.too_small
    if is_first and not done.false_alarms <= limits.false_alarms:
        return Outcome.no_agreement
    if done.agreeing < limits.least_blocks or done.agreeing < limits.least_share * done.offered:
        return Outcome.few_agree
    if done.rival >= max(limits.rival * done.agreeing, 3):
        return Outcome.ambiguous
    return Outcome.registered


def _beyond(found: Update, limits: Limits) -> bool:
    """Whether the navigation error exceeds its prior, or this cannot be tested."""
    freedom = int(np.count_nonzero(np.diagonal(np.asarray(found.prior.covariance)) > 0.0))
    return freedom > 0 and not scipy.stats.chi2.sf(float(found.chi_square_prior), freedom) >= limits.beyond_prior


def _moved(given: _Given, error: np.ndarray) -> ModelInputs:
    return given.model.moved(given.inputs, jnp.asarray(error))


def _inputs_of(found: Update, inputs: ModelInputs) -> ModelInputs:
    time = inputs.time if found.time is None else found.time
    return ModelInputs(Exposure(found.sensor, found.shot, time, found.atmosphere), terrain=found.terrain)
