"""GDAL's warp by rational polynomials fitted to a frame, over a DEM."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import rasterio
from rasterio.enums import Resampling
from rasterio.rpc import RPC
from rasterio.transform import Affine
from rasterio.warp import reproject

ROUNDS = 5  # of reweighting by the denominator, until the fit converges


@dataclass(frozen=True)
class Fit:
    """Rational polynomials, and their errors in px on the lattice: RMS and maximum."""

    rpc: RPC
    rms: float
    largest: float


def fitted(ground: np.ndarray, uv: np.ndarray) -> Fit:
    """Third-degree rational polynomials fitted to (longitude, latitude in deg, height in m) and (column, row)."""
    centre, scale = _normal_of(ground)
    offset, size = _normal_of(uv)
    terms = _terms(((ground - centre) / scale).T)
    numerators, denominators, modelled = [], [], []
    for k in (0, 1):
        top, bottom, value = _ratio(terms, (uv[:, k] - offset[k]) / size[k])
        numerators.append(top)
        denominators.append(bottom)
        modelled.append(value * size[k] + offset[k])
    off = np.hypot(*(np.stack(modelled) - uv.T))
    numbers: dict[str, Any] = {"height_off": centre[2], "lat_off": centre[1], "long_off": centre[0]}
    numbers |= {"height_scale": scale[2], "lat_scale": scale[1], "long_scale": scale[0]}
    for axis, name in enumerate(("samp", "line")):
        numbers |= {f"{name}_off": offset[axis], f"{name}_scale": size[axis]}
        numbers |= {f"{name}_num_coeff": list(numerators[axis]), f"{name}_den_coeff": list(denominators[axis])}
    return Fit(RPC(**numbers), float(np.sqrt(np.mean(off**2))), float(off.max()))


def _normal_of(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    low, high = values.min(axis=0), values.max(axis=0)
    return 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-9)


def _terms(place: np.ndarray) -> np.ndarray:
    """The twenty terms (n, 20) in the order of RPC00B, of normalised longitude, latitude and height."""
    x, y, z = place
    one = np.ones_like(x)
    return np.stack(
        [
            one, x, y, z, x * y, x * z, y * z, x * x, y * y, z * z, x * y * z, x**3, x * y * y, x * z * z, x * x * y,
            y**3, y * z * z, x * x * z, y * y * z, z**3,
        ],
        axis=1,
    )  # fmt: skip


def _ratio(terms: np.ndarray, value: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(numerator, denominator, fitted values) of a ratio of polynomials, weighted by its own denominator."""
    weight = np.ones(len(value))
    top = bottom = np.zeros(20)
    for _ in range(ROUNDS):
        A = np.concatenate([terms, -value[:, None] * terms[:, 1:]], axis=1) * weight[:, None]
        x = np.linalg.lstsq(A, value * weight, rcond=1e-11)[0]
        top, bottom = x[:20], np.concatenate([[1.0], x[20:]])
        weight = 1.0 / (terms @ bottom)
    return top, bottom, (terms @ top) / (terms @ bottom)


def warped(
    values: np.ndarray, rpc: RPC, terrain: str, crs: str, transform: Affine, shape: tuple[int, int], threads: int
) -> np.ndarray:
    """The rectified image (bands, rows, cols), bilinear, with GDAL's own approximation of an eighth of a pixel."""
    found = np.zeros((len(values), *shape), values.dtype)
    how: dict[str, Any] = {"RPC_DEM": terrain, "RPC_DEMINTERPOLATION": "bilinear"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        reproject(
            values, found, rpcs=rpc, src_crs="EPSG:4326", dst_crs=rasterio.CRS.from_wkt(crs), dst_transform=transform,
            resampling=Resampling.bilinear, num_threads=threads, init_dest_nodata=True, **how,
        )  # fmt: skip
    return found
