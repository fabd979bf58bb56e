"""Error sources of many looks as independent standard normal numbers: fresh in each look, constant, or fading in time.

An error e of a look is C z. Numbers z that are fresh are drawn anew for each look. Constant ones are those of a flight
or of all flights. Fading ones are first-order Gauss-Markov processes: z' = r z + sqrt(1 - r^2) w, r = exp(-dt/T). The
correlation A [alpha + (1 - alpha) exp(-dt/T)] of `TimeCorrelated` is the sum of all three, with the shares 1 - A,
A alpha and A (1 - alpha).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxgeo._checks import as_float64
from jaxgeo._compile import quick_filter_jit
from jaxgeo.uncertainty.model import ErrorModel
from jaxgeo.uncertainty.sharing import PerFlight, PerImage, PerMeasurement, Systematic, TimeCorrelated
from jaxgeo.uncertainty.sources import Geoid, TerrainField, TerrainHeight
from jaxgeo.uncertainty.sources.base import AbstractSource
from jaxgeo.uncertainty.sources.height_raster import OF_TERRAIN
from jaxgeo.uncertainty.target_motion import AbstractTarget


class Part(NamedTuple):
    """A share of the variance of a source, with the time T in s in which it fades: 0 at once, infinity never."""

    share: float
    duration: float
    is_for_all: bool


class SharedErrors(NamedTuple):
    """Numbers z of all looks: `counts` that are fresh, constant and fading, the latter with their `durations` in s.

    `models` and `columns` are the error model of each sensor, and the matrix C (axes, sum of counts) of its looks.
    """

    counts: tuple[int, int, int]
    durations: np.ndarray
    models: tuple[ErrorModel, ...]
    columns: tuple[np.ndarray, ...]


def shared_errors(common: ErrorModel, own: Sequence[ErrorModel | None]) -> SharedErrors:
    """Numbers z of looks of several sensors: with errors of all sensors, and those of each alone.

    Errors that are common to all flights are the same numbers for all sensors; so are those of the ground in `common`
    that are not fresh, since all sensors look at the same place.
    """
    models = tuple(ErrorModel((*common.sources, *(() if one is None else one.sources))) for one in own)
    kinds: list[list[tuple[slice, Part, Any]]] = []
    first_of_all: dict[Any, int] = {}
    counts, durations = [0, 0, 0], []
    for sensor, model in enumerate(models):
        fresh, rows = 0, []
        for number, (source, place) in enumerate(model.parts()):
            axes = place.stop - place.start
            for part in _parts(source):
                if part.duration == 0.0:
                    start, fresh = fresh, fresh + axes
                else:
                    kind = 1 if math.isinf(part.duration) else 2
                    is_for_all = part.is_for_all or (is_of_ground(source) and number < len(common.sources))
                    key = (kind, number, None if is_for_all else sensor)
                    if key not in first_of_all:
                        first_of_all[key] = counts[kind]
                        counts[kind] += axes
                        durations += [part.duration] * axes if kind == 2 else []
                    start = first_of_all[key]
                rows.append((place, part, start))
        counts[0] = max(counts[0], fresh)
        kinds.append(rows)
    columns = tuple(_columns(model, rows, tuple(counts)) for model, rows in zip(models, kinds, strict=True))
    return SharedErrors((counts[0], counts[1], counts[2]), np.array(durations, np.float64), models, columns)


def _columns(model: ErrorModel, rows: list[Any], counts: tuple[int, ...]) -> np.ndarray:
    """Matrix C of one sensor."""
    root = np.asarray(_root(model))
    total = np.zeros((model.size, sum(counts)))
    for place, part, start in rows:
        kind = 0 if part.duration == 0.0 else 1 if math.isinf(part.duration) else 2
        first = sum(counts[:kind]) + start
        axes = place.stop - place.start
        total[place, first : first + axes] += math.sqrt(part.share) * root[place, place]
    return total


@quick_filter_jit
def _root(model: ErrorModel) -> Any:
    return model.factor()


def _parts(source: AbstractSource) -> list[Part]:
    """Shares of the variance of a source by the time in which they fade; raises for a sharing that is no such sum."""
    sharing = source.sharing
    if isinstance(sharing, PerMeasurement | PerImage):
        return [Part(1.0, 0.0, False)]
    if isinstance(sharing, PerFlight | Systematic):
        return [Part(1.0, math.inf, isinstance(sharing, Systematic))]
    if not isinstance(sharing, TimeCorrelated):
        raise TypeError(
            f"{source.label}: track needs errors that are fresh, constant or first-order Gauss-Markov processes "
            f"(PerMeasurement, PerImage, PerFlight, Systematic, TimeCorrelated); got {type(sharing).__name__}."
        )
    given: Any = (sharing.duration, sharing.alpha, sharing.beta, sharing.strength)
    duration, alpha, beta, strength = (float(x) for x in given)
    if beta != 0.0:
        raise ValueError(
            f"{source.label}: a TimeCorrelated error with beta = {beta:g} is no Gauss-Markov process, so that track "
            "cannot carry it from look to look; give beta=0 with a duration that fits the correlation."
        )
    parts = [Part(1.0 - strength, 0.0, False), Part(strength * alpha, math.inf, False)]
    parts.append(Part(strength * (1.0 - alpha), duration, False))
    return [part for part in parts if part.share > 0.0]


def is_of_ground(source: AbstractSource) -> bool:
    """Whether an error is one of the height of the ground, not of a line of sight."""
    return isinstance(source, OF_TERRAIN) or (isinstance(source, Geoid) and not source.platform)


def for_target(model: ErrorModel, target: AbstractTarget) -> ErrorModel:
    """The error model as it acts on looks at one target.

    A field of terrain heights is one number at a target at rest. Heights of the terrain move no line of sight: for a
    target free in height their sources are left out. Raises `ValueError` for a field under a moving target.
    """
    kept = []
    for source in model.sources:
        if is_of_ground(source) and not target.on_terrain:
            continue
        if isinstance(source, TerrainField):
            source = _at_one_place(source, target)
        kept.append(source)
    return as_float64(ErrorModel(tuple(kept)), "errors")


def _at_one_place(field: TerrainField, target: AbstractTarget) -> TerrainHeight:
    sigma = float(np.sqrt(np.sum(np.square(np.asarray(field.sigma)))))
    if target.is_moving:
        raise ValueError(
            "a TerrainField under a moving target is no process in time. Use "
            f"TerrainHeight.from_metres({sigma:.3g}, sharing=TimeCorrelated(T)), with T its correlation length over "
            "the target's speed, in s."
        )
    return TerrainHeight.from_metres(sigma)  # whatever its sharing: it is the same ground in all looks
