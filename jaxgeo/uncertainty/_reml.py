"""Restricted likelihood of variance components: its minimum over their scales, and limits of each.

By NumPy and SciPy, without a program: calibrations of 3 flights of 8 images with 3 and with 9 factors make 130
minimisations in 0.9 s of processor time. `optimistix.BFGS` with the derivatives of JAX ends at the same minima, to 4e-6
of the misfit, but compiles for 1.5 s with 3 factors and 6.4 s with 9, anew for each number of points, and takes ten
times as long after that. The Newton and trust-region methods of optimistix are for roots and least squares.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy  # submodules load lazily, when first used

ZERO = -16.0  # logarithm of a scale that counts as zero
LARGEST = 9.0  # logarithm of the largest scale that is tried
SMALLEST = -5.0  # logarithm of a scale below which zero is tried
FARTHEST = math.log(1e3)  # of a scale's limits from its estimate
CLOSE, MOST_STEPS = 1e-3, 20  # of the search for a limit, in logarithms
ROUNDING = 1e-10  # of the noise, relative: it may be singular


class At(NamedTuple):
    """Misfit (minus the logarithm of the likelihood), its gradient and the expected information at some scales."""

    misfit: float
    gradient: np.ndarray
    information: np.ndarray


class Minimum(NamedTuple):
    """Logarithms `x` of the scales at a minimum, its misfit, its gradient and the expected information there."""

    x: np.ndarray
    misfit: float
    gradient: np.ndarray
    information: np.ndarray


@dataclasses.dataclass(frozen=True)
class Likelihood:
    """Likelihood of errors y of covariance N + sum of e^(2 x_k) B_k B_k', by y and B in terms of the noise N.

    `gram` is B' N^-1 B over all columns, `pull` B' N^-1 y, `rest` y' N^-1 y; `first` are the first columns of the
    parts. Woodbury's formula gives all else, so that no matrix has the size of y.
    """

    gram: np.ndarray
    pull: np.ndarray
    rest: float
    first: np.ndarray

    @classmethod
    def of(cls, y: np.ndarray, noise: np.ndarray, roots: Sequence[np.ndarray]) -> Likelihood:
        """From errors, the covariance of the noise, and a root B_k of each part's covariance."""
        count = len(y)
        noise = noise + ROUNDING * np.trace(noise) / count * np.eye(count)
        root = np.linalg.cholesky(noise)
        solve = lambda right: scipy.linalg.solve_triangular(root, right, lower=True)  # noqa: E731
        white, columns = solve(y), solve(np.concatenate(roots, axis=1))
        first = np.concatenate([[0], np.cumsum([part.shape[1] for part in roots])[:-1]])
        return cls(columns.T @ columns, columns.T @ white, float(white @ white), first)

    def at(self, x: np.ndarray) -> At:
        """Misfit, without constants, and its derivatives by the logarithms of the scales.

        The information is tr(W dV_k W dV_l) / 2 with W the inverse covariance: Patterson and Thompson 1971.
        """
        scale = np.exp(2.0 * x)
        sizes = np.diff([*self.first, len(self.pull)])
        each = np.repeat(np.exp(x), sizes)
        try:
            root = np.linalg.cholesky(np.eye(len(each)) + each[:, None] * self.gram * each[None, :])
        except np.linalg.LinAlgError:  # scales so large that rounding exceeds the noise: a step that is refused
            return At(math.inf, np.zeros(len(x)), np.eye(len(x)))
        right = np.concatenate([each[:, None] * self.gram, (each * self.pull)[:, None]], axis=1)
        solved = scipy.linalg.solve_triangular(root, right, lower=True, check_finite=False)
        inner = self.gram - solved[:, :-1].T @ solved[:, :-1]  # B' W B
        pulled = self.pull - solved[:, :-1].T @ solved[:, -1]  # B' W y
        misfit = float(np.sum(np.log(np.diag(root))) + 0.5 * (self.rest - solved[:, -1] @ solved[:, -1]))
        sums = lambda values: np.add.reduceat(values, self.first)  # noqa: E731
        gradient = scale * (sums(np.diag(inner)) - sums(pulled**2))
        squares = np.add.reduceat(np.add.reduceat(inner**2, self.first, axis=0), self.first, axis=1)
        return At(misfit, gradient, 2.0 * scale[:, None] * squares * scale[None, :])

    def minimum(self, start: np.ndarray, free: np.ndarray) -> Minimum:
        """The least misfit over the `free` scales, the others as at the start: Fisher's scoring in a trust region."""
        x = np.array(start, float)
        if free.any():
            kept: dict[bytes, At] = {}

            def at(some: np.ndarray) -> At:
                key = some.tobytes()
                if key not in kept:
                    kept.clear()
                    x[free] = np.clip(some, ZERO, LARGEST)
                    kept[key] = self.at(x)
                return kept[key]

            found = scipy.optimize.minimize(
                lambda some: at(some).misfit,
                x[free],
                jac=lambda some: at(some).gradient[free],
                hess=lambda some: at(some).information[np.ix_(free, free)] + 1e-6 * np.eye(int(free.sum())),
                method="trust-exact",
                options={"gtol": 1e-4, "initial_trust_radius": 1.0, "max_trust_radius": 4.0, "maxiter": 200},
            )
            x[free] = np.clip(found.x, ZERO, LARGEST)
        last = self.at(x)
        return Minimum(x, last.misfit, last.gradient, last.information)

    def settled(self, start: np.ndarray, free: np.ndarray, zero: np.ndarray) -> Minimum:
        """`minimum`, with those of the scales `zero` above zero that fit better there: the others are not all estimated
        where they were zero beside other values."""
        free, zero = free.copy(), zero.copy()
        found = self.minimum(start, free)
        while np.any(rising := zero & (found.gradient < 0.0)):
            # A step by the expected information over the squares of the scales.
            squared = -2.0 * found.gradient * np.exp(2.0 * found.x) / np.maximum(np.diag(found.information), 1e-300)
            number = int(np.argmax(np.where(rising, squared, 0.0)))
            tried, zero[number], free[number] = found.x.copy(), False, True
            tried[number] = np.clip(0.5 * math.log(max(squared[number], 1e-300)), SMALLEST, LARGEST)
            more = self.minimum(tried, free)
            if more.misfit < found.misfit:
                found = more
            else:
                free[number] = False
        return found

    def best(self, start: float) -> Minimum:
        """The least misfit over all scales, from one for all; those near zero become zero if that fits no worse."""
        x = np.full(len(self.first), start)
        free = np.ones(len(x), bool)
        found = self.minimum(x, free)
        for number in range(len(x)):
            if found.x[number] < SMALLEST:
                tried = found.x.copy()
                tried[number], free[number] = ZERO, False
                found = self.minimum(tried, free)
        return self.settled(found.x, free, ~free)

    def limits(self, best: Minimum, number: int, goal: float) -> tuple[float, float]:
        """Limits of a scale, at which twice the misfit over the other scales is `goal` squared above the least."""
        is_zero = best.x[number] <= ZERO
        free = best.x > ZERO
        free[number] = False
        zero = best.x <= ZERO
        zero[number] = False
        others = best.x.copy()

        def root(value: float) -> float:
            start = others.copy()
            start[number] = value
            found = self.settled(start, free, zero)
            others[:] = np.where(zero, ZERO, found.x)
            return math.sqrt(max(2.0 * (found.misfit - best.misfit), 0.0))

        wide = 0.5 if is_zero else 1.0 / math.sqrt(max(float(best.information[number, number]), 0.1))
        middle = SMALLEST if is_zero else float(best.x[number])
        low = 0.0 if is_zero else _edge(root, middle, -goal * wide, goal)
        others[:] = best.x
        return low, _edge(root, middle, goal * wide, goal)


def _edge(root: Callable[[float], float], middle: float, step: float, goal: float) -> float:
    """Scale beyond the estimate, `middle` in logarithms, where the root is `goal`; 0 or infinity if nowhere.

    The root is that of the likelihood ratio, zero at the estimate and nearly straight: secants between bounds.
    """
    inside, at_inside, far = middle, 0.0, middle + step
    while (at_far := root(far)) < goal:
        if abs(far - middle) > FARTHEST:
            return 0.0 if step < 0.0 else math.inf
        inside, at_inside, step = far, at_far, 1.6 * step
        far = middle + step
    for _ in range(MOST_STEPS):
        share = (goal - at_inside) / (at_far - at_inside)
        guess = inside + (far - inside) * min(max(share, 0.02), 0.98)
        at_guess = root(guess)
        if abs(at_guess - goal) < CLOSE:
            return math.exp(guess)
        if at_guess < goal:
            inside, at_inside = guess, at_guess
        else:
            far, at_far = guess, at_guess
        if abs(far - inside) < CLOSE:
            break
    return math.exp(0.5 * (inside + far))
