"""Images one after another, some of them registered to a map: errors against their covariance, and against all at once.

Run: python benchmarks/recursive_sequences.py [--seeds 10] [--images 30] [--long 120] [--json out.json]
The strips, cameras, simulated tie points and navigations of `tie_sequences.py` (the case with errors in common: 80 % of
the variance fading in 100 s, a boresight of 0.05 deg, an offset of all positions of 0.1 m), with an offset of 2 m in
place of 0.1 m, so that a map has something to show. Images 5 and 20 are registered by 25 simulated points of a map:
0.3 m each, the terrain 1 m, a shift of the map of 0.2 m.

Reported for each site, over the seeds: NEES (squared error by its covariance, over its degrees of freedom, with 95 %
chi-square bounds) of all at once with the map (`correct(..., map_control=)`), and of the last window of the recursion,
as long as the tracks and half as long; predicted and found errors of positions of all at once k images after the first
registered one, without the second, and of their distances from that; differences of the recursion from all at once in
standard deviations. With --long, processor seconds of each image against its number, for one long strip.
"""

from __future__ import annotations

import argparse
import gc
import json
import pathlib
import sys
import time
from dataclasses import replace
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))

import jax
import jax.numpy as jnp
import numpy as np
import scipy
import tie_sequences as strips

from jaxgeo import Geodetic
from jaxgeo.adjust import ImagePoints
from jaxgeo.register import Outcome, Registration, TieErrors, TiePoints, update_orientation
from jaxgeo.ties import Correction, FrameEstimate, MapControl, RecursiveCorrection, Views, correct
from jaxgeo.ties.ground import ground_of
from jaxgeo.uncertainty import ErrorModel, PerFlight, sources

OFFSET = 2.0  # m
ERRORS = (
    *strips.CASES["shared"][:2],
    sources.Position.from_ned(north=OFFSET, east=OFFSET, down=OFFSET, sharing=PerFlight()),
    strips.CASES["shared"][3],
)
TIE_ERRORS = TieErrors(registration=0.3, terrain=1.0, shift=0.2)
REGISTERED = (5, 20)
ACROSS = 5  # map points along a side of an image
WINDOWS = (7, 3)  # images
AFTER = (0, 1, 2, 5, 10, 20)  # images after the registered one


def registered(site: strips.Site, given: Views, row: int, shift: np.ndarray, rng: np.random.Generator) -> Registration:
    """The registration of an image by simulated points of a map, whose errors are drawn."""
    true = site.true
    camera = true.camera_of(row)
    u, v = (np.linspace(0.05 * size, 0.95 * size, ACROSS) for size in (camera.width, camera.height))
    uv = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    place, hit = ground_of(true, row, uv, site.terrain)
    uv, place = uv[hit], place[hit]
    rays = place - true.centre[row]
    height = float(np.asarray(TIE_ERRORS.terrain)) * rng.normal(size=len(uv))
    for _ in range(8):  # the true ground lies by this much over the terrain
        at = true.frame.to_geodetic(place)
        ground = Geodetic(lat=at.lat, lon=at.lon, height=jnp.zeros(len(uv)))
        above = np.asarray(at.height) - np.asarray(jax.vmap(site.terrain.height_at)(ground))  # pyright: ignore
        place = place + rays * ((height - above) / rays[:, 2])[:, None]
    place[:, :2] += shift + float(np.asarray(TIE_ERRORS.registration)) * rng.normal(size=(len(uv), 2))
    at = true.frame.to_geodetic(place)
    ground = Geodetic(lat=at.lat, lon=at.lon, height=jnp.zeros(len(uv)))
    ties = TiePoints(uv, ground, np.zeros((len(uv), 2, 2)), strips.NOISE)
    one = given.exposure[row]
    shot: Any = one.motion
    update = update_orientation(one.sensor, shot, ties, site.terrain, ErrorModel(ERRORS), TIE_ERRORS)
    return Registration(Outcome.registered, update.sensor, update.shot, update.terrain, update, TIE_ERRORS, ties, ())


def errors_of(site: strips.Site, names: list[str], frame: Any, centre: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Errors (n, 6) of some orientations in a frame."""
    rows = [site.true.name.tolist().index(name) for name in names]
    true = replace(site.true, centre=site.true.centre[rows], R_frame_from_camera=site.true.R_frame_from_camera[rows])
    return strips.pose_errors(true, frame, centre, R)


def of_batch(site: strips.Site, found: Correction) -> tuple[np.ndarray, np.ndarray]:
    """(errors (n, 6), their covariance) of all at once."""
    images = found.adjustment.images
    errors = errors_of(site, found.names, found.views.frame, images.centre, images.R_frame_from_camera)
    return errors, found.adjustment.covariance[: errors.size, : errors.size]


def run(
    given: Views, seen: ImagePoints, window: int, found: dict[int, Registration], terrain: Any, excess: float
) -> tuple[RecursiveCorrection, list[float]]:
    """The recursion after all images, and processor seconds of each."""
    filtered, seconds = RecursiveCorrection(window, excess=excess), []
    for row, name in enumerate(given.name):
        how = {"registration": found[row], "terrain": terrain} if row in found else {}
        points = seen.of(seen.image == name)
        began = time.process_time()
        filtered.add(str(name), given.exposure[row], ERRORS, points, **how)
        seconds.append(time.process_time() - began)
    return filtered, seconds


def off(site: strips.Site, batch: Correction, estimates: list[FrameEstimate]) -> float:
    """Largest difference of estimates from all at once, in standard deviations of these."""
    errors, covariance = of_batch(site, batch)
    sigma = np.sqrt(np.diagonal(covariance)).reshape(-1, 6)
    rows = [batch.names.index(one.name) for one in estimates]
    own = np.stack([_error(site, one) for one in estimates])
    # # Errors of both are in east-north-up frames some km apart, whose axes differ by less than 1e-3.
    return float(np.max(np.abs(own - errors[rows]) / sigma[rows]))


def _error(site: strips.Site, one: FrameEstimate) -> np.ndarray:
    return errors_of(site, [one.name], one.frame, one.centre[None], one.R_frame_from_camera[None])[0]


def bounded(values: list[float], freedom: int) -> dict[str, Any]:
    """Mean of squared errors over their degrees of freedom, with 95 % bounds."""
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], freedom * len(values)) / (freedom * len(values))
    return {"nees": float(np.mean(values)) / freedom, "chi_square_95": [float(low), float(high)]}


def figures(name: str, seeds: int, images: int) -> dict[str, Any]:
    """All figures of a site."""
    site = strips.site_of(name, images, strips.sensor_of(1), ERRORS)
    exact = strips.true_ties(site, strips.ground_points(site))
    order = {one: row for row, one in enumerate(site.true.name.tolist())}
    numbers = np.array([order[one] for one in exact.image.tolist()])
    _, point = exact.point_numbers
    first, last = (np.full(point.max() + 1, start) for start in (images, 0))
    np.minimum.at(first, point, numbers)
    np.maximum.at(last, point, numbers)
    longest = int(np.max(last - first)) + 1
    squares: dict[str, list[float]] = {"all at once": [], **{f"window {one}": [] for one in WINDOWS}}
    differences: dict[int, list[float]] = {one: [] for one in WINDOWS}
    predicted, obtained, before, shifts, apart, apart_found = [], [], [], [], [], []
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 11])
        given = strips.disturbed(site, ERRORS, rng)
        uv = exact.uv + strips.NOISE * rng.normal(size=exact.uv.shape)
        seen = ImagePoints(exact.image, exact.point, uv, exact.sigma)
        shift = float(np.asarray(TIE_ERRORS.shift)) * rng.normal(size=2)
        found = {row: registered(site, given, row, shift, rng) for row in REGISTERED if row < images}
        control = MapControl.of(given, {str(given.name[row]): one for row, one in found.items()}, site.terrain)
        batch = correct(given, seen, map_control=control)
        assert not batch.refused, batch.refused
        errors, covariance = of_batch(site, batch)
        squares["all at once"].append(float(errors.ravel() @ np.linalg.solve(covariance, errors.ravel())))
        for one in WINDOWS:
            filtered, _ = run(given, seen, one, found, site.terrain, batch.excess)
            late = np.concatenate([_error(site, frame) for frame in filtered.estimates])
            squares[f"window {one}"].append(float(late @ np.linalg.solve(filtered.covariance, late)))
            differences[one].append(off(site, batch, filtered.estimates))
        alone = correct(given, seen, map_control=control.without([str(given.name[row]) for row in REGISTERED[1:]]))
        errors, covariance = of_batch(site, alone)
        sigma = np.sqrt(np.diagonal(covariance)).reshape(-1, 6)
        rows = [REGISTERED[0] + k for k in AFTER if REGISTERED[0] + k < images]
        predicted.append(np.linalg.norm(sigma[rows, :3], axis=1))
        obtained.append(np.linalg.norm(errors[rows, :3], axis=1))
        C = covariance.reshape(images, 6, images, 6)[:, :3, :, :3]
        here = REGISTERED[0]
        of_pair = [C[k, :, k] + C[here, :, here] - C[k, :, here] - C[here, :, k] for k in rows]
        apart.append([float(np.sqrt(np.trace(one))) for one in of_pair])
        apart_found.append(np.linalg.norm(errors[rows, :3] - errors[here, :3], axis=1))
        own = strips.pose_errors(site.true, given.frame, given.centre, given.R_frame_from_camera)
        before.append(np.linalg.norm(own[:, :3], axis=1))
        shifts.append(alone.sigma_of_mean)
    freedoms = {"all at once": 6 * images, **{f"window {one}": 6 * one for one in WINDOWS}}
    rms = lambda x: [float(one) for one in np.sqrt(np.mean(np.square(x), axis=0))]  # noqa: E731
    return {
        "longest_track": longest,
        **{key: bounded(values, freedoms[key]) for key, values in squares.items()},
        "off_all_at_once_sigmas": {one: float(np.max(values)) for one, values in differences.items()},
        "images_after": list(AFTER[: len(predicted[0])]),
        "predicted_m": rms(predicted),
        "found_m": rms(obtained),
        "predicted_from_the_registered_m": rms(apart),
        "found_from_the_registered_m": rms(apart_found),
        "navigation_m": float(np.sqrt(np.mean(np.square(before)))),
        "sigma_of_mean_m": rms(shifts),
    }


def long_strip(name: str, images: int) -> dict[str, Any]:
    """Processor seconds of each image against its number, in tenths of a long strip; the first has the compiling."""
    site = strips.site_of(name, images, strips.sensor_of(1), ERRORS)
    exact = strips.true_ties(site, strips.ground_points(site))
    rng = np.random.default_rng(0)
    given = strips.disturbed(site, ERRORS, rng)
    seen = ImagePoints(exact.image, exact.point, exact.uv + strips.NOISE * rng.normal(size=exact.uv.shape), exact.sigma)
    gc.collect()
    gc.freeze()  # what there is before takes no part in later collections
    _, seconds = run(given, seen, WINDOWS[0], {}, site.terrain, 0.0)
    parts = np.array_split(np.array(seconds), 10)
    return {
        "images": images,
        "window": WINDOWS[0],
        "measurements_of_each_image": len(seen) / images,
        "seconds_of_each_median": [float(np.median(part)) for part in parts],
        "seconds_of_each_largest": [float(np.max(part)) for part in parts],
    }


def main() -> None:
    """Simulate, adjust and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--images", type=int, default=30)
    parser.add_argument("--long", type=int, default=0, help="images of a long strip over the first site")
    parser.add_argument("--sites", nargs="+", choices=list(strips.SITES), default=list(strips.SITES))
    parser.add_argument("--json", type=pathlib.Path)
    given = parser.parse_args()
    found: dict[str, Any] = {}
    for name in given.sites if given.seeds else ():
        found[name] = figures(name, given.seeds, given.images)
        print(name, json.dumps(found[name], indent=1), flush=True)
    if given.long:
        found["long"] = long_strip(given.sites[0], given.long)
        print(json.dumps(found["long"], indent=1), flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
