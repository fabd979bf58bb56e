"""Ground points with known coordinates: control and check points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.adjust.records import Names, as_names
from jaxgeo.earth import Geodetic


@dataclass(frozen=True)
class GroundPoints:
    """Points by name, their positions (m, 3) in the block's frame in m, and standard deviations `sigma` (m, 3) in m.

    A sigma of zero fixes a coordinate, an infinite one marks it as unknown: a height point has `[inf, inf, 0.02]`.
    `covariance` (m, 3, 3), if given, replaces `sigma`. Raises `ValueError` for coordinates that are not finite,
    negative sigmas and duplicate names.
    """

    name: Names
    place: np.ndarray
    sigma: Any = 0.0
    covariance: Any = None

    def __post_init__(self) -> None:
        name = as_names(self.name, "names of ground points")
        place = np.asarray(self.place, np.float64)
        if place.shape != (len(name), 3):
            raise ValueError(f"place must have the shape ({len(name)}, 3), in m; got {place.shape}.")
        sigma = np.asarray(self.sigma, np.float64)
        if sigma.shape not in ((), (3,), (len(name), 3)):
            raise ValueError(f"sigma must be a number, (3,) or ({len(name)}, 3), in m; got shape {sigma.shape}.")
        sigma = np.broadcast_to(sigma, place.shape).copy()
        _refuse(name, ~np.all(np.isfinite(place), axis=1), place, "place", "must be finite, in m")
        _refuse(name, ~np.all(sigma >= 0.0, axis=1), sigma, "sigma", "must not be negative or NaN, in m")
        _refuse_doubles(name)
        covariance = None
        if self.covariance is not None:
            covariance = np.asarray(self.covariance, np.float64)
            if covariance.shape != (len(name), 3, 3):
                raise ValueError(f"covariance must have the shape ({len(name)}, 3, 3); got {covariance.shape}.")
            off = np.abs(covariance - np.swapaxes(covariance, 1, 2)).max(axis=(1, 2), initial=0.0)
            symmetric = np.all(np.isfinite(covariance), axis=(1, 2)) & (
                off <= 1e-12 * np.abs(covariance).max(axis=(1, 2), initial=0.0)
            )
            positive = symmetric.copy()
            positive[symmetric] = np.linalg.eigvalsh(covariance[symmetric])[:, 0] > 0.0
            _refuse(name, ~positive, covariance, "covariance", "must be symmetric and positive definite, in m2")
            sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        for field, value in (("name", name), ("place", place), ("sigma", sigma), ("covariance", covariance)):
            object.__setattr__(self, field, value)

    def __len__(self) -> int:
        return len(self.name)

    def of(self, names: Any) -> GroundPoints:
        """A subset of the points, by name. Raises `ValueError` for an unknown name."""
        index = {name: i for i, name in enumerate(self.name.tolist())}
        wanted = as_names(list(names), "names").tolist()
        missing = [name for name in wanted if name not in index]
        if missing:
            raise ValueError(f"there is no ground point {missing[0]!r}; known are {', '.join(index)}.")
        rows = np.array([index[name] for name in wanted], int)
        covariance = None if self.covariance is None else self.covariance[rows]
        return GroundPoints(self.name[rows], self.place[rows], self.sigma[rows], covariance)

    def without(self, names: Any) -> GroundPoints:
        """All points except those named."""
        out = set(as_names(list(names), "names").tolist())
        self.of(sorted(out))  # raises for unknown names
        return self.of([name for name in self.name.tolist() if name not in out])

    @classmethod
    def from_geodetic(cls, frame: LocalFrame, name: Any, position: Geodetic, sigma_enu: Any = 0.0) -> GroundPoints:
        """From a batch of positions (m,) and standard deviations east, north, up in m (a number, (3,) or (m, 3)).

        The standard deviations are applied along the axes at the block's origin, which over 10 km rotate by less than 2
        mrad.
        """
        return cls(name, np.asarray(frame.from_geodetic(position)), sigma_enu)


def _refuse(name: np.ndarray, wrong: np.ndarray, values: np.ndarray, what: str, reason: str) -> None:
    if np.any(wrong):
        row = int(np.argmax(wrong))
        raise ValueError(f"ground point {name[row]}: {what} {reason}; got {values[row].tolist()}.")


def _refuse_doubles(name: np.ndarray) -> None:
    found, counts = np.unique(name, return_counts=True)
    if np.any(counts > 1):
        double = found[int(np.argmax(counts))]
        rows = np.flatnonzero(name == double).tolist()
        raise ValueError(f"ground point {double} is there {len(rows)} times, in rows {rows}; keep one of them.")
