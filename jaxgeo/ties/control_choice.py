"""Adjustment of tie points with images that are registered to a map, and the choice of the registrations that fit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxgeo.adjust import Adjustment, Block, HeightObservations, LeastSquares, Unknowns
from jaxgeo.adjust.bundle import adjusted
from jaxgeo.adjust.datum import observed_whole
from jaxgeo.adjust.kept import Kept, block_of, masked, set_aside
from jaxgeo.adjust.problem import prepared
from jaxgeo.adjust.screening import Screen
from jaxgeo.adjust.solve import solve
from jaxgeo.adjust.values import Values
from jaxgeo.ties.map_control import MapControl
from jaxgeo.ties.robust import WIDEST, ScaledCauchy
from jaxgeo.ties.solutions import Excess

IMPROBABLE = 1e-6  # registrations whose measurements are less probable are left out
LEAST_LEFT = 1e-9  # variance of a residual of unit weight: lower bound, against rounding
UNTIED = "no tie points join the image to the others."
CONTRADICTS = "its registration contradicts the navigation, the tie points or the other registrations."
UNCLEAR = "its registration and another one contradict each other, and nothing tells which one is wrong."


@dataclass(frozen=True)
class Tied:
    """A block whose measurements are chosen, and the standard deviations in px to add to theirs."""

    block: Block
    unknowns: Unknowns
    terrain: HeightObservations | None
    kept: Kept
    excess: Excess

    def adjusted_to(self, control: MapControl, start: Values) -> Adjustment:
        """Least squares with map control, from a start without it."""
        assert self.block.navigation is not None
        rows = control.rows_of([str(name) for name in self.block.images.name])
        navigation = replace(self.block.navigation, pose_rows=rows)
        block = replace(self.excess.less_sure(self.block), navigation=navigation)
        ready = masked(block, prepared(block, self.unknowns, self.terrain, set_aside(block, self.kept)), self.kept)
        added = len(ready.names.common) - len(start.common)
        start = eqx.tree_at(lambda v: v.common, start, jnp.pad(start.common, (0, added)))
        solution = solve(ready.problem, ScaledCauchy(jnp.asarray(WIDEST)), start=start)
        left = block_of(block, self.kept)
        return adjusted(left, self.unknowns, ready, solution, LeastSquares(), None, Screen(self.kept))


class Chosen(NamedTuple):
    """The adjustment with the registrations that fit, None if none does; these; and sentences on the others."""

    adjustment: Adjustment | None
    control: MapControl
    refused: dict[str, str]


def with_control(free: Adjustment, tied: Tied, control: MapControl) -> Chosen:
    """The adjustment with those registrations that fit it, from that without any.

    Raises `ValueError` if each image has an interior orientation of its own as unknown.
    """
    problem, start = free.prepared.problem, free.solution.values
    if problem.own_lens and problem.active:
        raise ValueError(
            "map_control needs a camera that several images share if its interior orientation is unknown; here each "
            "image has its own. Leave the self-calibration out."
        )
    names = {str(name) for name in free.images.name}
    refused = {name: UNTIED for name in control.names if name not in names}
    control = control.without(refused)
    while len(control):
        found = tied.adjusted_to(control, start)
        suspects = improbable(found, control)
        if not suspects:
            return Chosen(found, control, refused)
        fits = []
        for name in suspects[:2] if len(suspects) > 1 else ():
            others = control.without([name])
            if not len(others) or not improbable(tied.adjusted_to(others, start), others):
                fits.append(name)
        out = fits or suspects[:1]
        refused |= dict.fromkeys(out, UNCLEAR if len(out) > 1 else CONTRADICTS)
        control = control.without(out)
    return Chosen(None, control, refused)


def improbable(found: Adjustment, control: MapControl) -> list[str]:
    """Names of registered images whose map measurements do not fit all else, the least probable first.

    With residuals e of unit weight, their derivatives A and the covariance Q of the adjusted unknowns, the squared
    distance from what all else predicts is e' (1 - A Q A')^-1 e.
    """
    names = [str(name) for name in found.images.name]
    residuals, Q = found.pose_residuals, found.covariance
    assert residuals is not None
    derivatives = _derivatives(found)
    chances = {}
    for name in control.names:
        row = names.index(name)
        own = np.r_[6 * row : 6 * row + 6, 6 * len(names) : Q.shape[0]]
        used = np.any(derivatives[row] != 0.0, axis=1)
        A = derivatives[row, used]
        chances[name] = chance(residuals[row, used], np.eye(len(A)) - A @ Q[np.ix_(own, own)] @ A.T)
    return sorted((name for name in chances if not chances[name] >= np.log(IMPROBABLE)), key=lambda x: chances[x])


def chance(residuals: np.ndarray, covariance: np.ndarray) -> float:
    """Logarithm of the probability that residuals (r,) of a covariance (r, r) are as large as these, or larger."""
    import scipy  # submodules load lazily

    values, vectors = np.linalg.eigh(covariance)
    squared = np.sum((vectors.T @ residuals) ** 2 / np.maximum(values, LEAST_LEFT))
    return float(scipy.stats.chi2.logsf(squared, len(residuals)))


def _derivatives(found: Adjustment) -> Float[np.ndarray, "n r columns"]:
    """Derivatives of the further observations of orientations by the pose and the shared unknowns."""
    solution = found.solution
    observed, _ = observed_whole(found.prepared.problem, solution.values, solution.equations.control_root)
    return np.concatenate([observed.by_pose, observed.by_shared], axis=2)[:, 6:]
