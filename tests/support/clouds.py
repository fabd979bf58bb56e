"""Samples made up in NumPy, whose highest-density regions are known."""

from __future__ import annotations

from typing import Any

import numpy as np

import jaxgeo
from jaxgeo import Fix, Geodetic
from jaxgeo.earth import WGS84
from jaxgeo.uncertainty import Sampled

PLACE = (47.0, 11.0, 600.0)  # latitude and longitude in deg, height in m


def cloud(
    errors_en: np.ndarray,
    *,
    place: tuple[float, float, float] = PLACE,
    up: Any = 0.0,
    lost: int = 0,
    origin: Any = None,
    keep: bool = True,
    scrambles: int = 0,
) -> Sampled:
    """Samples at offsets (n, 2) east and north of a fix in m, `up` in m above it, and `lost` more without ground."""
    lat, lon, height = place
    position = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    zero = np.float64(0.0)
    fix = Fix(position, np.asarray(WGS84.to_ecef(position)), np.float64(5000.0), zero, zero, zero, np.int8(0))
    found = np.column_stack([errors_en, np.broadcast_to(up, len(errors_en))])
    every = np.concatenate([found, np.full((lost, 3), np.nan)])
    radii = np.hypot(every[:, 0], every[:, 1])
    statuses = {jaxgeo.Status.hit: len(found)} | ({jaxgeo.Status.ray_misses_terrain: lost} if lost else {})
    return Sampled(
        fix=fix,
        count=len(every),
        found=len(found),
        statuses=statuses,
        mean_enu=found.mean(axis=0),
        cov_enu=np.cov(found.T),
        centre_enu=np.zeros(3),
        radii={"CE": np.where(np.isfinite(radii), radii, np.inf)},
        scrambles=scrambles,
        confidence=0.95,
        errors_enu=every if keep else None,
        codes=np.zeros(len(every), np.int8) if keep else None,
        origin=origin,
    )


def normal(count: int, cov: Any, seed: int, mean: Any = (0.0, 0.0)) -> np.ndarray:
    """Draws (count, 2) of a normal distribution."""
    draws = np.random.default_rng(seed).standard_normal((count, 2))
    return draws @ np.linalg.cholesky(np.asarray(cov, float)).T + np.asarray(mean)


NEAR, FAR = ([[100.0, 0.0], [0.0, 400.0]], (0.0, 0.0)), ([[50.0, 20.0], [20.0, 60.0]], (1000.0, 600.0))
SHARE = 0.66  # of the near hill


def two_hills(count: int, seed: int) -> np.ndarray:
    """Draws (count, 2) of two normal distributions far apart, 66 % of the first."""
    first = np.random.default_rng(seed).random(count) < SHARE
    near, far = (normal(count, cov, seed + k, mean) for k, (cov, mean) in enumerate((NEAR, FAR), 1))
    return np.where(first[:, None], near, far)


def density_of_two_hills(points: np.ndarray) -> np.ndarray:
    """Their density (n,) per m2."""
    total = np.zeros(len(points))
    for share, (cov, mean) in ((SHARE, NEAR), (1.0 - SHARE, FAR)):
        apart = points - np.asarray(mean)
        power = np.einsum("ni,ij,nj->n", apart, np.linalg.inv(cov), apart)
        total += share * np.exp(-0.5 * power) / (2.0 * np.pi * np.sqrt(np.linalg.det(np.asarray(cov))))
    return total
