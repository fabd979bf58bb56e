"""Registration results as machine-readable JSON, and blocks as rows of a tie-point file."""

from __future__ import annotations

import importlib.metadata
import json
import math
import os
import pathlib
import platform
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._checks import check_is
from jaxgeo._destination import destination
from jaxgeo._typing import Scalar
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.io.tie_points import TieRow
from jaxgeo.observation import Exposure
from jaxgeo.register._equations import on_surface
from jaxgeo.register.blocks import BlockOutcome, count_outcomes
from jaxgeo.register.passes import Pass
from jaxgeo.register.places import BlockPlaces
from jaxgeo.register.posterior import Update
from jaxgeo.register.registration import Registration
from jaxgeo.register.ties import PaddedTies, TiePoints, checked_ties, padded
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty import Propagation
from jaxgeo.uncertainty.model_inputs import ModelInputs

ALONE = "The block has candidates, but none agrees with the pose on which most blocks agree."
PACKAGES = ("jaxgeo", "jax", "numpy", "scipy", "rasterio", "pyproj")


def tie_rows(registration: Registration, places: BlockPlaces) -> list[TieRow]:
    """A row for each block of the last pass, including rejected ones; blocks with unknown ground have none.

    `places` come from `jaxgeo.register.places.places_of_blocks`. A tie is at its position on the reference, with its
    height in the update: that point minus the map's east and north shift is imaged by the updated
    sensor and shot at the tie's pixel minus its residual. Other blocks are at their position by the shot.
    """
    check_is(places, BlockPlaces, "places", "Make them with jaxgeo.register.places.places_of_blocks.")
    if not registration.passes:
        return []
    heights = None if registration.ties is None else tie_heights(registration.ties, registration.update)
    return [_row(registration, places, heights, int(block)) for block in np.flatnonzero(_placed(registration, places))]


def tie_heights(ties: TiePoints, update: Update | None) -> np.ndarray:
    """Ellipsoidal heights in m of ties (n,): their own, or from an update's ground, corrected for the map's shift."""
    if update is None:
        return np.asarray(ties.ground.height)
    time = jnp.zeros(()) if update.time is None else update.time
    inputs = ModelInputs(Exposure(update.sensor, update.shot, time, update.atmosphere), terrain=update.terrain)
    given = update.errors.moved(inputs, -jnp.asarray(update.error)).terrain
    heights = _heights(padded(checked_ties(ties)), jnp.asarray(update.shift), given, update.terrain)
    return np.asarray(heights)[: ties.count]


@eqx.filter_jit
def _heights(
    ties: PaddedTies, shift: Float[Array, "2"], given: AbstractTerrain, updated: AbstractTerrain
) -> Float[Array, " ties"]:
    def one(lat: Scalar, lon: Scalar, height: Scalar, *rise: Float[Array, "2"]) -> Scalar:
        position = Geodetic(lat=lat, lon=lon, height=height)
        p_ecef, R = WGS84.to_ecef(position), R_ecef_from_enu(position)
        start = p_ecef if rise else on_surface(given, p_ecef)
        moved = start - R[:, :2] @ shift
        if not rise:
            return height + jnp.dot(on_surface(updated, moved) - p_ecef, R[:, 2])
        lift = jnp.dot(on_surface(updated, moved) - on_surface(given, moved), R[:, 2])
        return height + lift - jnp.sum(rise[0] * shift)

    planes = () if ties.rise is None else (ties.rise,)
    return jax.vmap(one)(ties.lat, ties.lon, ties.height, *planes)


def _placed(registration: Registration, places: BlockPlaces) -> np.ndarray:
    return places.known | (np.asarray(places.tie) >= 0) if registration.ties is not None else places.known


def _row(registration: Registration, places: BlockPlaces, heights: np.ndarray | None, block: int) -> TieRow:
    last, tie = registration.passes[-1], int(np.asarray(places.tie)[block])
    column, row = (float(x) for x in np.asarray(places.uv)[block])
    score = float(np.asarray(last.matches.score)[block, max(int(np.asarray(last.chosen.peak)[block]), 0)])
    if tie < 0 or registration.ties is None or heights is None:
        lat, lon, height = (float(np.asarray(x)[block]) for x in places.ground.to_degrees())
        code = BlockOutcome(int(np.asarray(last.matches.outcome)[block]))
        reason = ALONE if code is BlockOutcome.matched else code.message
        return TieRow(lat, lon, column, row, height, score, chosen=False, reason=reason)
    ground = registration.ties.ground
    lat, lon = (math.degrees(float(np.asarray(x)[tie])) for x in (ground.lat, ground.lon))
    height = float(heights[tie])
    own = 0.5 * float(np.trace(np.asarray(registration.ties.covariance)[tie]))
    sigma = math.sqrt(own + float(np.asarray(registration.tie_errors.registration)) ** 2)
    if registration.update is None:
        return TieRow(lat, lon, column, row, height, score, sigma, reason=registration.outcome.message)
    across, down = (float(x) for x in np.asarray(registration.update.residuals)[tie])
    weight = float(np.asarray(registration.update.weights)[tie])
    return TieRow(lat, lon, column, row, height, score, sigma, across, down, weight)


def report_of(registration: Registration) -> dict[str, Any]:
    """All results of a registration by name, angles in deg, for a file or display; numbers may be NaN."""
    check_is(registration, Registration, "registration", "Make one with jaxgeo.register.register_image.")
    errors, update = registration.tie_errors, registration.update
    found: dict[str, Any] = {
        "registered": registration.accepted,
        "outcome": registration.outcome.name,
        "message": registration.outcome.message,
        "passes": [_pass(one) for one in registration.passes],
        "tie_errors": {f"{name}_m": float(getattr(errors, name)) for name in ("registration", "terrain", "shift")},
    }
    if update is not None:
        found |= {"ties": _ties(registration, update), "unknowns": _unknowns(update)}
    return found


def _pass(one: Pass) -> dict[str, Any]:
    return {
        "cell_m": one.cell,
        "block_cells": one.block,
        "blocks": len(one.matches.outcome),
        "offered": one.offered,
        "agreeing": one.agreeing,
        "rival": one.rival,
        "false_alarms": one.false_alarms,
        "searched_cells": one.searched,
        "outcomes": {code.name: count for code, count in count_outcomes(one.matches.outcome).items()},
    }


def _ties(registration: Registration, update: Update) -> dict[str, Any]:
    residuals = np.asarray(update.residuals)
    return {
        "count": len(residuals),
        "with_less_weight": int(np.count_nonzero(np.asarray(update.weights) < 1.0)),
        "residuals_rms_px": float(np.sqrt(np.mean(np.sum(residuals**2, axis=1)))),
        "sigma0": float(update.sigma0),
        "sigma0_ties": float(update.sigma0_ties),
        "chi_square_ties": float(update.chi_square_ties),
        "chi_square_prior": float(update.chi_square_prior),
        "redundancy_ties": float(update.redundancy_ties),
        "redundancy_prior": float(update.redundancy_prior),
        "steps": int(update.steps),
        "registration_sigma_m": float(registration.tie_errors.registration),
    }


def _unknowns(update: Update) -> list[dict[str, Any]]:
    """Every parameter with its correction and standard deviations before and after; angles in deg."""
    units = [source.unit for source in update.errors.sources for _ in source.axes] + ["m", "m"]
    found = np.concatenate([np.asarray(update.error), np.asarray(update.shift)])
    before, after = (np.sqrt(np.diagonal(np.asarray(cov))) for cov in (update.prior.covariance, update.covariance))
    rows = []
    for name, unit, value, old, new in zip(update.axes, units, found, before, after, strict=True):
        scale, unit = (math.degrees(1.0), "deg") if unit == "rad" else (1.0, unit)
        numbers = {"change": value, "sigma_before": old, "sigma_after": new}
        rows.append({"name": name, "unit": unit, **{key: float(scale * number) for key, number in numbers.items()}})
    return rows


def fix_report(one: Propagation | None) -> dict[str, Any]:
    """A fix with its accuracy: CE and LE at 50, 90 and 95 %, and the covariance in m2, east, north, up."""
    if one is None:
        return {"status": None}
    status = Status(int(np.asarray(one.fix.status)))
    lat, lon, height = (float(np.asarray(x)) for x in one.fix.position.to_degrees())
    found: dict[str, Any] = {"status": status.name, "lat_deg": lat, "lon_deg": lon, "height_m": height}
    if not np.isfinite(np.asarray(one.cov_enu)).all():
        return found
    for percent in (50, 90, 95):
        found[f"ce{percent}_m"] = float(one.circular_error(percent / 100.0))
        found[f"le{percent}_m"] = float(one.linear_error(percent / 100.0))
    return found | {"cov_enu_m2": np.asarray(one.cov_enu).tolist()}


def versions() -> dict[str, str]:
    """Versions of Python and the numerical packages; packages without installed metadata are left out."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def as_json(content: Mapping[str, Any]) -> str:
    """JSON text; NaN and infinities, which JSON lacks, are null."""
    return json.dumps(_plain(content), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def write_registration_report(path: str | os.PathLike[str], content: Mapping[str, Any]) -> None:
    """Write a report (`report_of` and any further content) to a JSON file, which appears only when complete.

    Raises `ValueError` for a path that cannot be written to, and `TypeError` for content that JSON cannot hold.
    """
    text = as_json(content)
    with destination("report", pathlib.Path(path)) as stream:
        stream.write(text)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(one) for key, one in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
