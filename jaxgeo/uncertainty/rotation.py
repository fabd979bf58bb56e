"""Rotation of standard normal vectors after which the first numbers displace the fix most.

It comes from lines of sight with random errors, by regression: they are formed anyway before samples are drawn, while
derivatives by the errors would have to be compiled for each error model.
"""

from __future__ import annotations

import functools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import quick_filter_jit
from jaxgeo.terrain import ConstantField, Dem
from jaxgeo.uncertainty.batched_rays import TRIALS, PerturbedLines, common_ground
from jaxgeo.uncertainty.draws import Sobol
from jaxgeo.uncertainty.model_inputs import ModelInputs, NominalFix

FEWEST, EACH = 256, 4  # lines of sight for the regression, at least and per axis
STEEPEST = 0.05  # sine of the depression: less steep lines of sight are taken to be that steep
DIRECTIONS = 3  # on which a fix depends to first order: across and along the line of sight, and height
PLUMB = 1e-9  # of a direction that is level: a smaller part is rounding
NEGLIGIBLE = 1e-6  # of the largest standard deviation: a smaller one is rounding
STEPS = 4096.0  # directions are rounded to as many parts, so that rounding of the lines of sight does not matter
ALIKE = 1e-3  # part of a direction that the others leave over; a smaller one is rounding


class Rotation(NamedTuple):
    """A rotation I - left' right, as a product of reflections (Schreiber and Van Loan 1989, "A storage-efficient WY
    representation for products of Householder transformations")."""

    factors: Float[Array, "2 directions axes"]

    @classmethod
    @functools.lru_cache(maxsize=64)
    def none(cls, size: int) -> Rotation:
        """The rotation that changes nothing."""
        return cls(jax.device_put(np.zeros((2, DIRECTIONS, size))))

    def of(self, normal: Float[Array, " axes"]) -> Float[Array, " axes"]:
        """The rotated vector."""
        left, right = self.factors
        return normal - left.T @ (right @ normal)


class Trial(NamedTuple):
    """Standard normal vectors whose lines of sight the rotation comes from, and the matrix of their regression."""

    normal: np.ndarray
    regression: np.ndarray

    @classmethod
    def of(cls, draws: Sobol, size: int, leading: int) -> Trial:
        """The first samples of the key 0, for an error vector of `size` axes."""
        return _trial(draws.scrambles, size, leading)


@functools.lru_cache(maxsize=64)
def _trial(scrambles: int, size: int, leading: int) -> Trial:
    normal = Sobol(scrambles).trial(min(max(FEWEST, EACH * size), TRIALS), size, leading)
    with_mean = np.column_stack([np.ones(len(normal)), normal])
    return Trial(normal, np.linalg.pinv(with_mean)[1:])


def rotation_of(
    trial: Trial, lines: PerturbedLines, inputs: ModelInputs, nominal: NominalFix, places: Any, xp: Any
) -> Rotation:
    """Rotation from the lines of sight of a trial, of which `lines` are the first; `xp` is NumPy or `jax.numpy`.

    Leading numbers move the fix along the line of sight, across it, and in height, in this order, whatever the slope of
    the ground. The result is the same to the last digit if the lines differ by rounding.
    """
    offsets = _offsets(lines, len(trial.normal), inputs, nominal, places, xp)
    slopes = xp.where(xp.isfinite(offsets), offsets, 0.0) @ trial.regression.T
    sizes = xp.sqrt(xp.sum(slopes**2, axis=1))
    counts = sizes > NEGLIGIBLE * xp.max(sizes)
    rounded = xp.round(slopes * (STEPS / xp.where(counts, sizes, 1.0) * counts)[:, None])
    return _of_known_directions(rounded) if xp is np else _of_directions(rounded, xp)


def _of_directions(directions: Any, xp: Any) -> Rotation:
    """A rotation that turns the first axes into `directions` (rows), made orthogonal in order, or their opposites.

    By reflections I - m m' (Householder 1958, "Unitary triangularization of a nonsymmetric matrix").
    """
    axes = np.arange(directions.shape[1])
    left, right = [], []  # of the product of the reflections so far
    for number, direction in enumerate(directions):
        length = xp.sqrt(xp.sum(direction**2))
        for mirror in right:
            direction = direction - mirror * xp.sum(mirror * direction)
        over = xp.where(axes >= number, direction, 0.0)
        size = xp.sqrt(xp.sum(over**2))
        counts = size > ALIKE * length
        side = xp.where(xp.sum(over * (axes == number)) < -ALIKE * size, -1.0, 1.0)  # not decided by rounding
        mirror = over / xp.where(counts, size, 1.0) + side * (axes == number)
        scale = xp.where(counts, xp.sqrt(2.0 / xp.where(counts, xp.sum(mirror**2), 1.0)), 0.0)
        mirror = mirror * scale
        products = [xp.sum(one * mirror) for one in right]
        left.append(mirror - sum((one * product for one, product in zip(left, products, strict=True)), 0.0 * mirror))
        right.append(mirror)
    return Rotation(xp.stack([*left, *right]).reshape(2, -1, len(axes)))


def _of_known_directions(directions: np.ndarray) -> Rotation:
    """`_of_directions` by branches on the values, in a tenth of its time."""
    left, right = np.zeros(directions.shape), np.zeros(directions.shape)
    for number, direction in enumerate(directions):
        length = direction @ direction
        for mirror in right[:number]:
            direction = direction - (mirror @ direction) * mirror
        mirror = right[number]
        mirror[number:] = direction[number:]
        squared = mirror @ mirror
        if not squared > ALIKE**2 * length:
            mirror[:] = 0.0
            continue
        mirror /= math.sqrt(squared)
        mirror[number] += -1.0 if mirror[number] < -ALIKE else 1.0
        mirror *= math.sqrt(2.0 / (mirror @ mirror))
        left[number] = mirror - (right[:number] @ mirror) @ left[:number]
    factors: Any = np.stack([left, right])
    return Rotation(factors)


def _offsets(lines: PerturbedLines, count: int, inputs: ModelInputs, nominal: NominalFix, places: Any, xp: Any) -> Any:
    """Offsets (3, count) in m of lines of sight on level ground, along and across the nominal one, and in height."""
    of = lambda leaf: xp.asarray(leaf)[:count]  # noqa: E731
    direction = xp.asarray(nominal.direction_enu)
    flat = xp.sqrt(direction[0] ** 2 + direction[1] ** 2)
    is_plumb = flat < PLUMB
    east, north = xp.where(is_plumb, 1.0, direction[0]), xp.where(is_plumb, 0.0, direction[1])
    along = xp.stack([east, north]) / xp.where(is_plumb, 1.0, flat)
    ray = lines.sight.ray
    p_ecef = of(ray.origin) + xp.asarray(nominal.distance) * of(ray.direction) - xp.asarray(nominal.p_ecef)[None, :]
    p_enu = p_ecef @ xp.asarray(nominal.R_ecef_from_enu)
    raised = of(_raised(lines, inputs, nominal, places))
    sinking = xp.where(direction[2] < 0.0, 1.0, -1.0) * xp.maximum(xp.abs(direction[2]), STEEPEST)
    ahead = p_enu[:, :2] @ along + flat * (p_enu[:, 2] - raised) / sinking
    return xp.stack([ahead, p_enu[:, 0] * along[1] - p_enu[:, 1] * along[0], raised])


def _raised(lines: PerturbedLines, inputs: ModelInputs, nominal: NominalFix, places: Any) -> Any:
    """Height in m by which the ground of each line of sight is raised at the nominal fix, up to a constant."""
    own = lines.own[0]
    if isinstance(own, Dem) and isinstance(own.field, ConstantField):
        return lines.rise
    if not jax.tree.leaves(own):
        return 0.0 * lines.rise
    return _raised_at(own, common_ground(inputs, places)[0], nominal)


@quick_filter_jit
def _raised_at(own: Any, common: Any, nominal: NominalFix) -> Float[Array, " lines"]:
    ground = lambda own: eqx.combine(own, common).clearance(nominal.p_ecef, nominal.cell)  # noqa: E731
    return -jax.vmap(ground)(own)
