"""Navigation errors of many images: those of each image alone, and those that images share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._compile import quick_filter_jit
from jaxgeo.ties.rigs import Rigs, second_order
from jaxgeo.uncertainty import PerFlight, PerImage, Systematic
from jaxgeo.uncertainty.sharing import AbstractSharing, Occasion, PerMeasurement
from jaxgeo.uncertainty.sources.base import AbstractSource

NONE = 1e-9  # of the largest eigenvalue of a correlation: smaller ones are none
MOST = 600  # shared numbers of one source, all axes together; what the others explain is taken as each image's own
OF_MODE, OF_SHOT = ", mode ", ", shot "  # in names of numbers of which there are many


class OfImage(NamedTuple):
    """Error sources of an image, derivatives (6, errors) of its pose by their errors, and the errors' covariance."""

    sources: tuple[AbstractSource, ...]
    by_error: np.ndarray
    covariance: np.ndarray


class Split(NamedTuple):
    """Covariances (n, 6, 6) of the errors that images have alone, and the effects (n, 6) of one standard deviation of
    each number that they share, by name. The covariance of images i and j is the sum of the products of these."""

    own: np.ndarray
    common: dict[str, np.ndarray]


def split(images: Sequence[OfImage], time: np.ndarray, flight: np.ndarray, rigs: Rigs | None = None) -> Split:
    """Errors of n images at `time` (n,) in s, of the flights numbered `flight` (n,).

    A source that is common to flights is one number for each axis and flight. Of one that is correlated in time, the
    correlation matrix of its images is reduced by its smallest eigenvalue, which is each image's own, and the rest is
    written by its eigenvectors (Karhunen-Loeve), all of them up to `MOST` numbers.

    With `rigs`, images of one shot share what would be each image's own, as numbers of the shot; mounting errors are of
    each camera, or of the cameras on one gimbal head (`Rigs.of_source`). To what images have alone is then added what
    the sum of both lacks (`second_order`).
    """
    own, common = np.zeros((len(images), 6, 6)), {}
    shot = np.arange(len(images)) if rigs is None else rigs.shot
    turn, mounting = np.zeros((len(images), 3, 3)), np.zeros((len(images), 6, 6))
    for (label, of), members in _alike(images, rigs).items():
        rows = np.array(sorted(members))
        source = members[int(rows[0])][0]
        effects = np.stack([effects_of(images[row], members[row][1]) for row in rows.tolist()])
        if rigs is not None:
            effects = rigs.together(rows, effects)
            squared = effects @ np.swapaxes(effects, 1, 2)
            if rigs.of_source(source) is None:
                turn[rows] += squared[:, 3:, 3:]
            else:
                mounting[rows] += squared
        numbers, first, place, count = np.unique(shot[rows], True, True, True)
        names, modes = _modes(source.sharing, time[rows[first]], flight[rows[first]], len(source.axes))
        rest = np.maximum(1.0 - np.sum(modes**2, axis=1), 0.0)
        is_alone = (count == 1) | isinstance(source.sharing, PerMeasurement)
        own[rows] += (rest * is_alone)[place][:, None, None] * effects @ np.swapaxes(effects, 1, 2)
        of_shots = np.flatnonzero(~is_alone & (rest > NONE))
        names = [*names, *(f"{OF_SHOT}{number}" for number in numbers[of_shots].tolist())]
        modes = np.hstack([modes, np.diag(np.sqrt(rest))[:, of_shots]])
        for name, mode in zip(names, modes[place].T, strict=True):
            for axis, one in enumerate(source.axes):
                column = np.zeros((len(images), 6))
                column[rows] = effects[:, :, axis] * mode[:, None]
                common[f"{label}: {one}{of}{name}"] = column
    if rigs is not None:
        for row in np.flatnonzero(rigs.is_shared).tolist():
            own[row] += second_order(turn[row], mounting[row], rigs.R_frame_from_camera[row])
    return Split(own, common)


def _alike(
    images: Sequence[OfImage], rigs: Rigs | None
) -> dict[tuple[str, str], dict[int, tuple[AbstractSource, slice]]]:
    """Sources that are the same in several images: the source and its place in the errors, by image. By label, and the
    ending of names of those that only some cameras share."""
    found: dict[tuple[Any, ...], dict[int, tuple[AbstractSource, slice]]] = {}
    for row, image in enumerate(images):
        first, seen = 0, {}
        for source in image.sources:
            kind = source.label, source.axes, _words(source.sharing)
            seen[kind] = seen.get(kind, 0) + 1
            place = slice(first, first + len(source.axes))
            found.setdefault((*kind, seen[kind], _ending(rigs, source, row)), {})[row] = source, place
            first = place.stop
    labels: dict[tuple[str, str], dict[int, tuple[AbstractSource, slice]]] = {}
    for key, members in found.items():
        label, of, count = key[0], key[-1], 2
        while (label, of) in labels:
            label, count = f"{key[0]} {count}", count + 1
        labels[label, of] = members
    return labels


def _ending(rigs: Rigs | None, source: AbstractSource, row: int) -> str:
    """Ending of the names of numbers that only some cameras share."""
    of = None if rigs is None else rigs.of_source(source)
    return "" if of is None or len(np.unique(of)) == 1 else f", camera {of[row]}"


def _words(sharing: AbstractSharing) -> tuple[Any, ...]:
    return (type(sharing).__name__, *(float(leaf) for leaf in jax.tree.leaves(sharing)))


def effects_of(image: OfImage, place: slice) -> np.ndarray:
    """Effects (6, axes) on the pose of uncorrelated errors of unit variance: the symmetric root of the covariance."""
    values, vectors = np.linalg.eigh(image.covariance[place, place])
    return image.by_error[:, place] @ (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T


def _modes(sharing: AbstractSharing, time: np.ndarray, flight: np.ndarray, axes: int) -> tuple[list[str], np.ndarray]:
    """(endings of names, modes (n, m)): numbers that images share, without what is each image's own."""
    n = len(time)
    if n == 1 or isinstance(sharing, PerImage | PerMeasurement):
        return [], np.zeros((n, 0))
    if isinstance(sharing, Systematic):
        return [""], np.ones((n, 1))
    if isinstance(sharing, PerFlight):
        flights = np.unique(flight)
        names = [""] if len(flights) == 1 else [f", flight {one}" for one in flights.tolist()]
        return names, (flight[:, None] == flights[None, :]).astype(float)
    values, vectors = np.linalg.eigh(np.asarray(_correlations(sharing, jnp.asarray(time), jnp.asarray(flight))))
    values = values - max(values[0], 0.0)
    kept = np.flatnonzero(values > NONE * values[-1])[::-1][: max(MOST // axes, 1)]
    return [f"{OF_MODE}{k + 1}" for k in range(len(kept))], vectors[:, kept] * np.sqrt(values[kept])


@quick_filter_jit
def _correlations(sharing: AbstractSharing, time: jax.Array, flight: jax.Array) -> jax.Array:
    """Correlations (n, n) of an error at images."""
    shot = jnp.arange(time.shape[0])

    def one(i: Any, j: Any) -> Any:
        here, there = (Occasion(measurement=k, shot=k, flight=flight[k], time=time[k]) for k in (i, j))
        return sharing.correlation(here, there)

    return jax.vmap(lambda i: jax.vmap(lambda j: one(i, j))(shot))(shot)
