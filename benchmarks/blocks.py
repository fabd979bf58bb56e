"""Adjustment of real blocks with all estimates: orientations, points, parameters, residuals, check points.

Run: python -m benchmarks.blocks {dbat_sxb,ign_block,bal} [--json [out.json]]
The blocks are read from the folder JAXGEO_TEST_DATA. Standard deviations are given twice: `unit_weight`, for the stated
sigmas of the observations, and `scaled`, multiplied by sigma0 from the residuals.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import sys
import time
from collections.abc import Callable
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import numpy as np
import scipy
from rich.console import Console
from rich.table import Table
from support.blocks import (
    Aerial,
    aerial,
    in_map,
    large,
    strasbourg,
    without_convergence,
)

import jaxgeo
from jaxgeo.adjust import (
    Adjustment,
    Fixed,
    GroundPoints,
    Huber,
    InnerConstraints,
    Solver,
    Unknowns,
    adjust,
    blunders,
    without_blunders,
)

jaxgeo.enable_x64()
DATA = pathlib.Path(os.environ.get("JAXGEO_TEST_DATA", pathlib.Path(__file__).resolve().parents[2] / "shared" / "data"))
SIGMA_POSITION, SIGMA_ATTITUDE, SEED = 1.0, float(np.deg2rad(0.05)), 1  # m, rad: of the simulated navigation
SHOWN = 12  # rows of points in a table
DISTURBANCES = 40  # of `ign_block`
TIES_PX = 0.2  # sigma of the tie points of `ign_block`
MOST_BLUNDERS = 400
LEAST_SEEN = 4  # points per image of a free network


# Results of any adjustment.


def record(found: Adjustment, classes: dict[str, np.ndarray], checks: GroundPoints | None = None) -> dict[str, Any]:
    """Everything that was estimated, in JSON form."""
    told = {
        "sigma0": found.sigma0,
        "redundancy": found.redundancy,
        "observations": found.observations,
        "unknowns": found.unknown_count,
        "images": len(found.images),
        "points": len(found.places),
        "image_points": len(found.block.observations),
        "converged": found.converged,
        "cost": found.cost,
        "iterations": [vars(iteration) for iteration in found.log],
        "residuals_px": residuals(found, classes),
        "orientations": orientations(found),
        "parameters": parameters(found),
        "points_m": points(found),
    }
    if checks is not None:
        told["checks"] = differences(found, checks)
    return told


def residuals(found: Adjustment, classes: dict[str, np.ndarray]) -> dict[str, Any]:
    """By class: count, root mean square of columns, rows and both, and maximum, px."""
    told = {}
    for name, rows in {"all": np.ones(len(found.residuals), bool), **classes}.items():
        v = found.residuals[rows]
        each = np.sqrt(np.mean(v**2, axis=0)).tolist()
        told[name] = {"count": len(v), "rms_uv": each, "rms": rms(v), "largest": float(np.abs(v).max())}
    return told


def orientations(found: Adjustment) -> list[dict[str, Any]]:
    """Perspective centres in m and angles in deg, Rx(omega) Ry(phi) Rz(kappa) being the block's frame from the image
    (right, up, out of the scene), with standard deviations."""
    centre, angles = found.sigma_of_images[:, :3], np.rad2deg(found.sigma_of_images[:, 3:])
    told = []
    for i, name in enumerate(found.images.name.tolist()):
        told.append({"image": name, "centre_m": found.images.centre[i].tolist()})
        told[-1]["omega_phi_kappa_deg"] = np.rad2deg(found.omega_phi_kappa[i]).tolist()
        for kind, factor in (("unit_weight", 1.0), ("scaled", found.sigma0)):
            told[-1][f"sigma_{kind}"] = {
                "centre_m": (factor * centre[i]).tolist(),
                "omega_phi_kappa_deg": (factor * angles[i]).tolist(),
            }
    return told


def parameters(found: Adjustment) -> list[dict[str, Any]]:
    """Parameters of cameras, mounts and strips; a missing prior is None."""
    return [
        {
            "whose": p.whose,
            "name": p.name,
            "value": p.value,
            "sigma_unit_weight": p.sigma,
            "sigma_scaled": p.sigma * found.sigma0,
            "prior_sigma": p.prior if np.isfinite(p.prior) else None,
        }
        for p in found.parameters
    ]


def points(found: Adjustment) -> list[dict[str, Any]]:
    """Adjusted positions in the block's frame with standard deviations, m."""
    given = zip(found.points.name.tolist(), found.points.place, found.points.sigma, strict=True)
    return [
        {
            "point": name,
            "place": place.tolist(),
            "sigma_unit_weight": sigma.tolist(),
            "sigma_scaled": (found.sigma0 * sigma).tolist(),
        }
        for name, place, sigma in given
    ]


def differences(found: Adjustment, checks: GroundPoints) -> dict[str, Any]:
    """Adjusted minus given check point positions in m, and their sigmas: of the adjustment, and of both combined."""
    off, own = found.differences(checks), found.points.of(checks.name).sigma
    told = []
    for name, d, adjusted, reference in zip(checks.name.tolist(), off, own, checks.sigma, strict=True):
        told.append({"point": name, "difference_m": d.tolist(), "sigma_reference_m": reference.tolist()})
        for kind, factor in (("unit_weight", 1.0), ("scaled", found.sigma0)):
            told[-1][f"sigma_adjusted_{kind}_m"] = (factor * adjusted).tolist()
            told[-1][f"sigma_difference_{kind}_m"] = np.hypot(factor * adjusted, reference).tolist()
    return {"points": told, "rms_m": np.sqrt(np.mean(off**2, axis=0)).tolist(), "mean_m": off.mean(axis=0).tolist()}


def timed(run: Callable[[], Adjustment]) -> tuple[Adjustment, dict[str, float]]:
    """The adjustment with all its covariances, run twice: with compilation, then without."""
    seconds = {}
    for name in ("first, with compiling", "again"):
        begin = time.perf_counter()
        found = run()
        seconds[f"adjustment, {name}"] = time.perf_counter() - begin
        _ = found.covariance, found.points  # computed lazily
        seconds[f"adjustment and covariances, {name}"] = time.perf_counter() - begin
    return found, seconds


def rms(v: np.ndarray) -> float:
    return float(np.sqrt(np.mean(v**2)))


# The blocks.


def dbat_sxb() -> dict[str, Any]:
    """Five frames on weighted control, as in the project file."""
    real = strasbourg(DATA)
    found, seconds = timed(lambda: adjust(real.block, real.unknowns))
    return {"block": "dbat_sxb", "seconds": seconds, **record(found, real.classes, real.checks)}


def bal() -> dict[str, Any]:
    """16 photographs with a lens each, a free network, started from the file's values."""
    real = large(DATA)
    found, seconds = timed(lambda: adjust(real.block, real.unknowns, datum=InnerConstraints(), solver=Solver(1e-12)))
    return {"block": "bal", "seconds": seconds, **record(found, real.classes)}


def ign_block() -> dict[str, Any]:
    """68 frames with disturbed orientations and a navigation of the same accuracy; and further variants."""
    flown = aerial(DATA, sigma_px=TIES_PX)
    block = flown.with_navigation(SIGMA_POSITION, SIGMA_ATTITUDE, SEED)
    found, seconds = timed(lambda: adjust(block))
    undisturbed = adjust(flown.held(SIGMA_POSITION, SIGMA_ATTITUDE))
    told = {"block": "ign_block", "seconds": seconds, **record(found, {}, flown.ground)}
    told["image_points_read"] = len(flown.read)
    told["parts"] = [len(part.given) for part in flown.parts(LEAST_SEEN)]
    told["at_given"] = {"rms_px": rms(flown.off())}
    told["navigation_residuals_rms"] = np.sqrt(
        np.mean(np.square(np.asarray(found.navigation_residuals)), axis=0)
    ).tolist()
    told["against_given"] = against(flown, found, undisturbed)
    told["undisturbed_against_given"] = against(flown, undisturbed, undisturbed)
    told["many_disturbances"] = many_disturbances(flown)
    told["blunders"] = outliers(flown, block, found)
    told["ways_to_read_it"] = readings(flown)
    told["free_networks"] = free_networks(flown)
    return told


def against(flown: Aerial, found: Adjustment, undisturbed: Adjustment) -> dict[str, Any]:
    """Differences of the orientations from those given, m and rad, and their expected values.

    All statistics use covariances scaled by sigma0. `normalised_rms` is by component. `mahalanobis` of the whole vector
    has the mean `unknowns` if the given orientations are independent of these ties and the tie errors are white. In
    `directions_of_navigation`, the eighth of the eigenvectors of the covariance (scaled to correlations) with the
    largest variance, it shows the errors of the simulated navigation. `by_disturbance` is that of the change by the
    disturbance alone, which has the mean trace(W Q), W the weight of the navigation. `after_similarity` is the
    remaining difference, m, after each part not connected by ties is fitted to the given one by a similarity transform.
    """
    cov = found.sigma0**2 * found.covariance
    d, change = from_images(found, flown.given), from_images(found, undisturbed.images)
    sigma = np.sqrt(np.diagonal(cov))
    values, vectors = np.linalg.eigh(cov / np.outer(sigma, sigma))
    parts = (vectors.T @ (d.ravel() / sigma)) ** 2 / values
    weak = np.arange(len(parts)) >= len(parts) - len(parts) // 8
    weight = np.tile(np.repeat([SIGMA_POSITION**-2.0, SIGMA_ATTITUDE**-2.0], 3), len(d))
    spread = weight * found.covariance
    by_disturbance = float(change.ravel() @ np.linalg.solve(found.covariance, change.ravel()))
    return {
        "mean": d.mean(axis=0).tolist(),
        "rms": np.sqrt(np.mean(d**2, axis=0)).tolist(),
        "normalised_rms": np.sqrt(np.mean((d / sigma.reshape(d.shape)) ** 2, axis=0)).tolist(),
        "mahalanobis": float(parts.sum()),
        "unknowns": d.size,
        "directions_of_navigation": {
            "mahalanobis": float(parts[weak].sum()),
            "count": int(weak.sum()),
            "p": float(scipy.stats.chi2.sf(parts[weak].sum(), weak.sum())),
        },
        "by_disturbance": {
            "mahalanobis": by_disturbance,
            "expected": float(np.trace(spread)),
            "sigma": float(np.sqrt(2.0 * np.sum(spread * spread.T))),
        },
        "after_similarity": [_form(found, part) for part in flown.parts(LEAST_SEEN)],
        "points_rms_m": np.sqrt(np.mean(found.differences(flown.ground) ** 2, axis=0)).tolist(),
    }


def many_disturbances(flown: Aerial) -> dict[str, Any]:
    """Differences to the given orientations over their standard deviations, times sigma0, for many simulated
    navigations: each shifts the block as a whole, so its images are not independent samples."""
    found = []
    for seed in range(DISTURBANCES):
        adjusted = adjust(flown.with_navigation(SIGMA_POSITION, SIGMA_ATTITUDE, seed))
        variances = np.diagonal(adjusted.covariance_of_images, axis1=1, axis2=2)
        found.append(from_images(adjusted, flown.given) / (adjusted.sigma0 * np.sqrt(variances)))
    off = np.abs(np.array(found))
    return {
        "disturbances": DISTURBANCES,
        "normalised_rms": np.sqrt(np.mean(off**2, axis=(0, 1))).tolist(),
        "shares_within_1_2_3_sigma": [float(np.mean(off < k)) for k in (1.0, 2.0, 3.0)],
    }


def _form(found: Adjustment, part: Aerial) -> dict[str, Any]:
    """Remaining differences of the centres and points of a part."""
    centres = found.images.centre[np.isin(found.images.name, part.given.name)]
    places = np.array([found.places[name] for name in part.ground.name.tolist()])
    return {
        "centres": after_similarity(centres, part.given.centre),
        "points": after_similarity(places, part.ground.place),
    }


def from_images(found: Adjustment, given: Any) -> np.ndarray:
    """Adjusted minus given orientations (n, 6): centres in m, rotations about camera axes in rad."""
    turn = np.swapaxes(given.R_frame_from_camera, 1, 2) @ found.images.R_frame_from_camera
    turns = scipy.spatial.transform.Rotation.from_matrix(turn).as_rotvec()
    return np.concatenate([found.images.centre - given.centre, turns], axis=1)


def _both(found: Adjustment, ground: GroundPoints) -> tuple[np.ndarray, np.ndarray]:
    given = ground.of(found.points.name)
    return found.points.place, given.place


def after_similarity(places: np.ndarray, targets: np.ndarray) -> dict[str, Any]:
    """RMS in m of positions (n, 3) after a similarity transform onto others; scale in ppm and rotation in deg."""
    a, b = places - places.mean(axis=0), targets - targets.mean(axis=0)
    turn, _ = scipy.spatial.transform.Rotation.align_vectors(b, a)
    turned = turn.apply(a)
    scale = float(np.sum(turned * b) / np.sum(a * a))
    left = np.sqrt(np.mean((scale * turned - b) ** 2, axis=0))
    return {"rms_m": left.tolist(), "scale_ppm": 1e6 * (scale - 1.0), "turn_deg": float(np.rad2deg(turn.magnitude()))}


def outliers(flown: Aerial, block: Any, found: Adjustment) -> dict[str, Any]:
    """Results of a robust loss and data snooping."""
    robust = adjust(block, loss=Huber(), solver=Solver(relative=1e-8))
    snooped, out = without_blunders(block, most=MOST_BLUNDERS)
    told: dict[str, Any] = {"flagged_at_first": len(blunders(found)), "taken_out": len(out)}
    told["worst"] = [str(blunder) for blunder in out[:10]]
    for name, other in (("least_squares", found), ("huber", robust), ("snooped", snooped)):
        told[name] = {"sigma0": other.sigma0, "rms_px": rms(other.residuals)}
        d = from_images(other, flown.given)
        told[name]["against_given_rms"] = np.sqrt(np.mean(d**2, axis=0)).tolist()
    return told


def readings(flown: Aerial) -> dict[str, Any]:
    """Effect of the map projection: residuals of the given orientations and points, with and without correct
    conversion.

    `given_rms_px` with the given points, `intersected_rms_px` with intersected points, `adjusted` with the orientations
    held by a navigation of 1 m and 0.05 deg: remaining residuals in pixels, and those of that navigation over its
    sigmas (east, north, up, and about the body's axes).
    """
    ways = {
        "exact": flown,
        "linear alteration left in": aerial(DATA, ground_altitude=None, sigma_px=TIES_PX),
        "convergence ignored": without_convergence(DATA, flown),
        "map taken as Cartesian": in_map(DATA, flown),
    }
    told = {}
    for name, way in ways.items():
        block = way.held(SIGMA_POSITION, SIGMA_ATTITUDE)
        fixed, adjusted = adjust(block, Unknowns(images=Fixed())), adjust(block)
        told[name] = {
            "given_rms_px": rms(way.off()),
            "intersected_rms_px": rms(fixed.residuals),
            "intersected_points_rms_m": np.sqrt(np.mean(fixed.differences(way.ground) ** 2, axis=0)).tolist(),
            "adjusted_rms_px": rms(adjusted.residuals),
            "adjusted_sigma0": adjusted.sigma0,
            "adjusted_navigation_rms": np.sqrt(
                np.mean(np.square(np.asarray(adjusted.navigation_residuals)), axis=0)
            ).tolist(),
        }
    return told


def free_networks(flown: Aerial) -> dict[str, Any]:
    """Ties alone, per part not connected by ties, without images that see too few of them."""
    told = {}
    for part in flown.parts(LEAST_SEEN):
        found = adjust(part.free_network(SEED), datum=InnerConstraints())
        off = found.differences(part.ground)
        told[f"{part.given.name[0]} and {len(part.given) - 1} more"] = {
            "images": len(found.images),
            "sigma0": found.sigma0,
            "redundancy": found.redundancy,
            "rms_px": rms(found.residuals),
            "points_rms_m": np.sqrt(np.mean(off**2, axis=0)).tolist(),
            "points_sigma_unit_weight_rms_m": np.sqrt(np.mean(found.points.sigma**2, axis=0)).tolist(),
            "centres_after_similarity": after_similarity(found.images.centre, part.given.centre),
            "points_after_similarity": after_similarity(*_both(found, part.ground)),
        }
    return told


BLOCKS = {"dbat_sxb": dbat_sxb, "ign_block": ign_block, "bal": bal}


# Display.


def show(told: dict[str, Any]) -> None:
    """Tables on the terminal."""
    console = Console()
    head = Table("what", "value", title=told["block"])
    for name in "sigma0 redundancy observations unknowns images points image_points converged cost".split():
        head.add_row(name, _text(told[name]))
    for name, value in told["seconds"].items():
        head.add_row(f"{name}, s", _text(value))
    console.print(head)
    _rows(console, "Iterations", told["iterations"])
    _rows(console, "Residuals, px", [{"class": name, **row} for name, row in told["residuals_px"].items()])
    _rows(console, "Orientations, sigmas of unit weight", _flat(told["orientations"], "sigma_unit_weight"))
    _rows(console, "The same, sigmas times sigma0", _flat(told["orientations"], "sigma_scaled"))
    _rows(console, "Parameters", told["parameters"])
    _rows(console, "Points, m", told["points_m"])
    if "checks" in told:
        _rows(console, "Check points, m", told["checks"]["points"])
    for name in set(told) & {
        "against_given",
        "undisturbed_against_given",
        "many_disturbances",
        "blunders",
        "free_networks",
    }:
        _rows(console, name, [{"what": key, "value": value} for key, value in told[name].items()])
    if "ways_to_read_it" in told:
        _rows(console, "Ways to read it", [{"way": name, **row} for name, row in told["ways_to_read_it"].items()])


def _flat(rows: list[dict[str, Any]], kind: str) -> list[dict[str, Any]]:
    return [
        {"image": row["image"], "centre_m": row["centre_m"], "omega_phi_kappa_deg": row["omega_phi_kappa_deg"]}
        | {f"sigma {name}": value for name, value in row[kind].items()}
        for row in rows
    ]


def _rows(console: Console, title: str, rows: list[dict[str, Any]]) -> None:
    if not rows:
        return
    more = f", first {SHOWN} of {len(rows)}" if len(rows) > SHOWN else ""
    table = Table(title=title + more)
    for name in rows[0]:
        table.add_column(name, overflow="fold")
    for row in rows[:SHOWN]:
        table.add_row(*(_text(value) for value in row.values()))
    console.print(table)


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return "\n".join(f"{name}: {_text(entry)}" for name, entry in value.items())
    if isinstance(value, list):
        return "\n".join(_text(entry) for entry in value)
    if isinstance(value, float):
        return f"{value:.4f}" if 1e3 <= abs(value) < 1e7 else f"{value:.6g}"
    return str(value)


def main() -> None:
    """Adjust one block, and show or save the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("block", choices=list(BLOCKS))
    parser.add_argument(
        "--json",
        nargs="?",
        const="-",
        help="as JSON to this file, or to the output if none is named, instead of tables",
    )
    options = parser.parse_args()
    if not DATA.is_dir():
        sys.exit(f"no real data: {DATA} does not exist; name another folder in JAXGEO_TEST_DATA.")
    told = BLOCKS[options.block]()
    if options.json is None:
        show(told)
    elif options.json == "-":
        print(json.dumps(told, indent=1))
    else:
        pathlib.Path(options.json).write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
