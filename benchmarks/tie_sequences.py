"""Mutual correction of simulated sequences over real terrain: errors against their predicted covariance.

Run: python benchmarks/tie_sequences.py [--seeds 20] [--images 30] [--rendered 1] [--json out.json]
A strip of nadir images 500 m above the highest ground of three elevation models (folder JAXGEO_TEST_DATA: a plain,
hills, mountains), with the camera of Xue et al. (2019), 10328 x 7760 px of 5.2 um, 80 % overlap, and the navigation of
their block: 5, 5, 10 cm, 0.015 deg of roll and pitch, 0.035 deg of heading, independent between images. In a second
case 80 % of the variance of these errors is common to neighbours and fades in 100 s, and a boresight of 0.05 deg and an
offset of all positions of 0.1 m come in addition; the adjustment has the same error model.

For all seeds, tie points are *simulated*: ground points on a lattice of each image, projected by the true poses and
measured to 0.3 px. With --rendered, images of a sixteenth of the resolution are *rendered* over the same terrain with a
synthetic texture, with 3 % noise, and matched, for that many seeds, each with its own texture, noise and navigation.

Reported: NEES (squared error by the predicted covariance) of the pose of each image and of all together, over their
degrees of freedom, with 95 % chi-square bounds of the latter over the seeds; distances in m on the ground between the
places of one point in neighbouring images, by the navigation and after (RMS, and quantiles 0, 10, 50, 90, 100 % of the
gain over the seeds; for simulated ones also quantiles 0.1, 1, 5, 50, 95 % that the covariances predict); absolute
errors against their priors, by axis (east, north, up; right, down, forward of the camera); and the error of the mean
position against `sigma_of_mean`, which images alone do not reduce.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import sys
import time
from dataclasses import dataclass
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from scipy.spatial.transform import Rotation

import jaxgeo
from jaxgeo import Exposure, FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.adjust import ImagePoints
from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.earth import R_ecef_from_ned
from jaxgeo.io import read_dem
from jaxgeo.ortho import Orthoimage, render
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.terrain import AbstractTerrain, ConstantHeight, TangentGrid
from jaxgeo.ties import Correction, Matching, Pictures, Views, correct, find_ties
from jaxgeo.ties.correction import rms_of_rays
from jaxgeo.ties.ground import ground_of
from jaxgeo.uncertainty import ErrorModel, PerFlight, TimeCorrelated, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs

jaxgeo.enable_x64()
DATA = pathlib.Path(os.environ.get("JAXGEO_TEST_DATA", pathlib.Path(__file__).resolve().parents[2] / "shared" / "data"))
# File, latitude and longitude in deg of the middle of the strip.
SITES = {
    "plain": ("Rome-30m-DEM.tif", 41.88, 12.52),
    "hills": ("N44E005.hgt", 44.35, 5.93),
    "mountains": ("bigtujunga.tif", 34.326, -118.149),
}
ABOVE, OVERLAP, SPEED = 500.0, 0.8, 40.0  # m above the highest ground, share, m/s
FOCAL, WIDTH, HEIGHT = 55.5 / 0.0052, 10328, 7760  # px
NOISE = 0.3  # px
DRAWS = 2000  # of the predicted gain of neighbours
LATTICE = (7, 9)  # simulated points of an image in rows and columns
MATCHING = Matching(sigma_height=5.0)
CELL = 0.5  # m, of the texture
GREY_NOISE = 0.03  # of the standard deviation of an image
SHORT = ("nees_joint", "excess", "apart_before_m", "apart_after_m", "tie_error_px", "tie_sigma_px", "measurements")
REDUCED = 16  # times: resolution of rendered images
POSITION = {"north": 0.05, "east": 0.05, "down": 0.10}  # m
ATTITUDE = {"heading": 0.035, "pitch": 0.015, "roll": 0.015}  # deg
FADING = TimeCorrelated(100.0, strength=0.8)
CASES = {
    "independent": (sources.Position.from_ned(**POSITION), sources.Attitude.from_degrees(**ATTITUDE)),
    "shared": (
        sources.Position.from_ned(**POSITION, sharing=FADING),
        sources.Attitude.from_degrees(**ATTITUDE, sharing=FADING),
        sources.Position.from_ned(north=0.1, east=0.1, down=0.1, sharing=PerFlight()),
        sources.Boresight.from_degrees(heading=0.05, pitch=0.05, roll=0.05),
    ),
}


def sensor_of(reduced: int) -> Sensor:
    """The camera, of a resolution that is lower by a factor."""
    camera = FrameCamera.from_pixels(focal_px=FOCAL / reduced, width=WIDTH // reduced, height=HEIGHT // reduced)
    return Sensor(camera, Gimbal.fixed(), Mount.nadir())


@dataclass(frozen=True)
class Site:
    """Terrain, its highest ground under the strip in m, and true views of the images."""

    terrain: AbstractTerrain
    relief: tuple[float, float]
    true: Views


def site_of(name: str, images: int, sensor: Sensor, errors: Any) -> Site:
    """A strip to the north over the middle of a site; its attitude varies a little."""
    file, lat, lon = SITES[name]
    terrain = read_dem(DATA / "dem" / file, vertical_datum=0.0)
    step = (1.0 - OVERLAP) * HEIGHT / FOCAL * ABOVE
    north = step * (np.arange(images) - 0.5 * (images - 1))
    rng = np.random.default_rng(7)
    across = np.linspace(-400.0, 400.0, 9)
    lats = lat + np.rad2deg(np.linspace(north[0] - 300.0, north[-1] + 300.0, 60) / 6.37e6)
    lons = lon + np.rad2deg(across / 6.37e6 / np.cos(np.deg2rad(lat)))
    places = Geodetic(
        lat=jnp.deg2rad(jnp.repeat(lats, 9)), lon=jnp.deg2rad(jnp.tile(lons, 60)), height=jnp.zeros(60 * 9)
    )
    heights = np.asarray(jax.vmap(terrain.height_at)(places))
    exposures = []
    for k in range(images):
        tilt = rng.normal(0.0, 1.0, 3)
        pose = Pose.from_degrees(
            lat=lat + np.rad2deg(north[k] / 6.37e6),
            lon=lon,
            height=float(np.nanmax(heights)) + ABOVE,
            heading=float(tilt[0]),
            pitch=float(tilt[1]),
            roll=float(tilt[2]),
        )
        exposures.append(Exposure(sensor, Shot(pose, np.zeros(0), k * step / SPEED)))
    names = [f"image {k:02d}" for k in range(images)]
    return Site(
        terrain, (float(np.nanmin(heights)), float(np.nanmax(heights))), Views.of(names, exposures, [errors] * images)
    )


def disturbed(site: Site, errors: Any, rng: np.random.Generator) -> Views:
    """Views with errors drawn from the error model: the joint covariance of each source, by its sharing and times."""
    shots = [one.motion for one in site.true.exposure]
    times = np.array([float(shot.time) for shot in shots])  # pyright: ignore
    count = len(shots)
    model = ErrorModel(errors)
    drawn = np.zeros((count, model.size))
    for source, place in model.parts():
        sharing = source.sharing
        if isinstance(sharing, TimeCorrelated):
            R = float(sharing.strength) * np.exp(-np.abs(times[:, None] - times) / float(sharing.duration))
            R[np.diag_indices(count)] = 1.0
        else:
            R = np.ones((count, count)) if isinstance(sharing, PerFlight) else np.eye(count)
        values, vectors = np.linalg.eigh(R)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        drawn[:, place] = root @ rng.normal(size=(count, place.stop - place.start)) * np.asarray(source.sigma)
    given = []
    for true, error in zip(site.true.exposure, drawn, strict=True):
        inputs = model.moved(ModelInputs(true, terrain=ConstantHeight(jnp.zeros(()))), jnp.asarray(error))
        shot = inputs.exposure.motion
        assert isinstance(shot, Shot)
        wanted = inputs.exposure.sensor.sight(shot)
        given.append(Exposure(true.sensor, _shot_of(true.sensor, shot, wanted)))
    return Views.of(site.true.name, given, [errors] * count)


def _shot_of(sensor: Sensor, motion: Any, wanted: Any) -> Shot:
    """The shot whose camera is oriented as wanted: errors of the mount are moved into the pose, so that all images have
    one sensor. Without lever arms."""
    R_body_from_camera = np.asarray(sensor.mount.R_body_from_base) @ np.asarray(sensor.mount.R_head_from_camera)
    position = motion.pose.position
    R = np.asarray(R_ecef_from_ned(position)).T @ np.asarray(wanted.R_ecef_from_camera) @ R_body_from_camera.T
    return Shot(Pose(position, *heading_pitch_roll_from_R(jnp.asarray(R))), np.zeros(0), motion.time)


def pose_errors(true: Views, frame: LocalFrame, centre: Any, R: Any) -> np.ndarray:
    """Errors (n, 6) of orientations: centre in m in the axes of the frame, rotation about the camera's axes in rad."""
    place = np.asarray(frame.from_ecef(np.asarray(true.frame.to_ecef(true.centre))))
    turn = np.asarray(frame.R_ecef_from_local).T @ np.asarray(true.frame.R_ecef_from_local)
    turned = np.swapaxes(turn @ true.R_frame_from_camera, 1, 2) @ R
    return np.concatenate([centre - place, Rotation.from_matrix(turned).as_rotvec()], axis=1)


def lattice(camera: FrameCamera) -> np.ndarray:
    """Pixels (m, 2) of a lattice of an image."""
    rows, cols = LATTICE
    u, v = np.meshgrid((np.arange(cols) + 0.5) / cols * camera.width, (np.arange(rows) + 0.5) / rows * camera.height)
    return np.stack([u.ravel(), v.ravel()], axis=1)


def pixels(views: Views, row: int, ground: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(pixels, whether they are on the image) of ground points in the frame, without a lens."""
    camera = views.camera_of(row)
    there = (ground - views.centre[row]) @ views.R_frame_from_camera[row]
    uv = np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * there[:, :2] / there[:, 2:]
    return uv, np.all((uv > 5.0) & (uv < np.array([camera.width, camera.height]) - 6.0), axis=1)


def ground_points(site: Site) -> list[np.ndarray]:
    """Ground points (m, 3) of the lattice of each image, by the true poses."""
    camera = site.true.camera_of(0)
    found = [ground_of(site.true, row, lattice(camera), site.terrain) for row in range(len(site.true))]
    return [points[hit] for points, hit in found]


def true_ties(site: Site, grounds: list[np.ndarray]) -> ImagePoints:
    """Exact measurements of the ground points in all images that see them (occlusion aside)."""
    rows = []
    for first, ground in enumerate(grounds):
        for row in range(max(first - 5, 0), min(first + 6, len(grounds))):
            uv, inside = pixels(site.true, row, ground)
            rows += [(str(site.true.name[row]), f"tie {first}-{k}", uv[k]) for k in np.flatnonzero(inside)]
    image, point, uv = zip(*rows, strict=True)
    return ImagePoints(list(image), list(point), np.array(uv), NOISE).seen_often()


def apart(true: Views, grounds: list[np.ndarray], frame: LocalFrame, centre: Any, R: Any) -> float:
    """RMS distance in m between the places, at the true height, of ground points in neighbouring images."""
    squares = []
    for row in range(len(true) - 1):
        ground = grounds[row][pixels(true, row + 1, grounds[row])[1]]
        place = np.asarray(frame.from_ecef(np.asarray(true.frame.to_ecef(ground))))
        places = []
        for image in (row, row + 1):
            ray = (ground - true.centre[image]) @ true.R_frame_from_camera[image] @ R[image].T
            scale = (place[:, 2] - centre[image, 2]) / ray[:, 2]
            places.append(centre[image, :2] + scale[:, None] * ray[:, :2])
        squares.append(np.mean(np.sum((places[0] - places[1]) ** 2, axis=1)))
    return float(np.sqrt(np.mean(squares)))


def figures_of(site: Site, given: Views, found: Correction, grounds: list[np.ndarray]) -> dict[str, Any]:
    """NEES, agreement of neighbours and absolute errors of one seed."""
    true, frame, images = site.true, given.frame, found.adjustment.images
    before = pose_errors(true, frame, given.centre, given.R_frame_from_camera)
    after = pose_errors(true, frame, images.centre, images.R_frame_from_camera)
    n = len(true)
    covariance = found.adjustment.covariance[: 6 * n, : 6 * n]
    each = [after[k] @ np.linalg.solve(covariance[6 * k : 6 * k + 6, 6 * k : 6 * k + 6], after[k]) for k in range(n)]
    joint = after.ravel() @ np.linalg.solve(covariance, after.ravel())
    sigma = np.sqrt(np.diagonal(given.covariance, axis1=1, axis2=2))
    predicted = np.sqrt(np.diagonal(covariance)).reshape(n, 6)
    return {
        "excess": found.excess,
        "nees_of_images": float(np.mean(each)) / 6.0,
        "nees_joint": float(joint) / (6 * n),
        "apart_before_m": apart(true, grounds, frame, given.centre, given.R_frame_from_camera),
        "apart_after_m": apart(true, grounds, frame, images.centre, images.R_frame_from_camera),
        "position_before_m": _rms(before[:, :3]),
        "position_after_m": _rms(after[:, :3]),
        "attitude_before_deg": np.rad2deg(_rms(before[:, 3:])),
        "attitude_after_deg": np.rad2deg(_rms(after[:, 3:])),
        "over_prior": [float(x) for x in np.sqrt(np.mean((after / sigma) ** 2, axis=0))],
        "largest_sigma_over_prior": float(np.max(predicted / sigma)),
        "mean_shift_m": [float(x) for x in after[:, :3].mean(axis=0)],
        "sigma_of_mean_m": [float(x) for x in found.sigma_of_mean],
    }


def predicted_gains(site: Site, given: Views, found: Correction, grounds: list[np.ndarray]) -> list[float]:
    """Quantiles 0.1, 1, 5, 50, 95 % of the gain of neighbours, by draws from the covariances before and after.

    Errors before are those after plus independent ones of the difference of both covariances."""
    n, frame = len(site.true), given.frame
    after = found.adjustment.covariance[: 6 * n, : 6 * n]
    shared = [np.outer(one, one) for one in given.common.values()]
    prior = scipy.linalg.block_diag(*given.own) + sum(shared, np.zeros((6 * n, 6 * n)))
    roots = []
    for covariance in (after, prior - after):
        values, vectors = np.linalg.eigh(covariance)
        roots.append(vectors * np.sqrt(np.maximum(values, 0.0)))
    rng, gains = np.random.default_rng(0), []
    centre = np.asarray(frame.from_ecef(np.asarray(site.true.frame.to_ecef(site.true.centre))))
    turn = np.asarray(frame.R_ecef_from_local).T @ np.asarray(site.true.frame.R_ecef_from_local)
    for _ in range(DRAWS):
        late = roots[0] @ rng.normal(size=6 * n)
        off = [one.reshape(n, 6) for one in (late, late + roots[1] @ rng.normal(size=6 * n))]
        both = []
        for one in off:
            R = turn @ site.true.R_frame_from_camera @ Rotation.from_rotvec(one[:, 3:]).as_matrix()
            both.append(apart(site.true, grounds, frame, centre + one[:, :3], R))
        gains.append(both[1] / both[0])
    return [float(x) for x in np.quantile(gains, [0.001, 0.01, 0.05, 0.5, 0.95])]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1))))


def summary(rows: list[dict[str, Any]], images: int) -> dict[str, Any]:
    """Means over the seeds; bounds of the sum of all squared errors of a joint NEES."""
    freedom = 6 * images * len(rows)
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], freedom) / freedom
    rms = {
        key: float(np.sqrt(np.mean([row[key] ** 2 for row in rows])))
        for key in rows[0]
        if key.endswith(("_m", "_deg")) and not isinstance(rows[0][key], list)
    }
    return {
        "seeds": len(rows),
        "nees_joint": float(np.mean([row["nees_joint"] for row in rows])),
        "chi_square_95": [float(low), float(high)],
        "nees_of_images": float(np.mean([row["nees_of_images"] for row in rows])),
        **rms,
        "neighbours_better": rms["apart_before_m"] / rms["apart_after_m"],
        "neighbours_better_quantiles": np.quantile(
            [row["apart_before_m"] / row["apart_after_m"] for row in rows], [0.0, 0.1, 0.5, 0.9, 1.0]
        ).tolist(),
        "over_prior_axes": np.sqrt(np.mean([np.square(row["over_prior"]) for row in rows], axis=0)).tolist(),
        "largest_sigma_over_prior": max(row["largest_sigma_over_prior"] for row in rows),
        "mean_shift_over_sigma": float(
            np.sqrt(np.mean([np.square(np.divide(row["mean_shift_m"], row["sigma_of_mean_m"])) for row in rows]))
        ),
        "excess_px": float(np.mean([row["excess"] for row in rows])),
    }


def simulated(name: str, case: str, seeds: int, images: int) -> dict[str, Any]:
    """Simulated tie points for all seeds."""
    errors = CASES[case]
    site = site_of(name, images, sensor_of(1), errors)
    grounds = ground_points(site)
    exact = true_ties(site, grounds)
    rows, gains, began = [], [], time.process_time()
    for seed in range(seeds):
        rng = np.random.default_rng([seed, 11])
        given = disturbed(site, errors, rng)
        uv = exact.uv + NOISE * rng.normal(size=exact.uv.shape)
        found = correct(given, ImagePoints(exact.image, exact.point, uv, exact.sigma))
        rows.append(figures_of(site, given, found, grounds))
        if seed == 0:
            print(found.words())
            gains = predicted_gains(site, given, found, grounds)
    spent = time.process_time() - began
    return {
        "relief_m": site.relief,
        "points": len(np.unique(exact.point)),
        "measurements": len(exact),
        **summary(rows, images),
        "neighbours_better_predicted_quantiles": gains,
        "processor_s_of_each": spent / seeds,
    }


def textures(site: Site, count: int) -> Orthoimage:
    """A synthetic orthoimage of the strip with detail of several sizes; one band for each seed."""
    middle = jax.tree.map(lambda x: x[0], site.true.frame.to_geodetic(np.zeros((1, 3))))
    place = Geodetic(lat=middle.lat, lon=middle.lon, height=jnp.zeros(()))
    north = np.ptp(site.true.centre[:, 1]) + 900.0
    shape = (int(north / CELL), int(1000.0 / CELL))
    bands = []
    for seed in range(count):
        noise = np.random.default_rng([seed, 3]).standard_normal(shape, dtype=np.float32)
        parts = [scipy.ndimage.gaussian_filter(noise, width) for width in (1.0, 2.5, 6.0)]
        bands.append(100.0 + 30.0 * sum(one / np.std(one) for one in parts))
    return Orthoimage.of(np.stack(bands), TangentGrid.centred(place, spacing=(CELL, CELL), shape=shape))


def rendered(name: str, cases: list[str], seeds: int, images: int, points: int) -> dict[str, Any]:
    """Rendered and matched images, of another texture, noise and navigation for each seed."""
    found: dict[str, Any] = {}
    site = site_of(name, images, sensor_of(REDUCED), CASES[cases[0]])
    ground, grounds = textures(site, seeds), ground_points(site)
    shown = [render(one.sensor, one.motion, ground, site.terrain) for one in site.true.exposure]
    print(f"{name}: rendered {len(shown)} images in {time.process_time():.0f} s of the processor", flush=True)
    for case in cases:
        rows, began = [], time.process_time()
        for seed in range(seeds):
            rng = np.random.default_rng([seed, 11])
            given = disturbed(site, CASES[case], rng)
            grey = [_noisy(one.values[seed], rng) for one in shown]
            pictures = Pictures(lambda row, grey=grey: (grey[row], shown[row].known), most=images)
            ties = find_ties(given, site.terrain, pictures, MATCHING, points=points)
            result = correct(given, ties)
            rows.append(figures_of(site, given, result, grounds))
            seen = result.adjustment.block.observations
            rows[-1]["tie_error_px"] = rms_of_rays(site.true, seen)
            rows[-1]["tie_sigma_px"] = float(np.sqrt(np.mean(seen.sigma**2)))
            rows[-1]["residual_px"] = result.rms_after
            rows[-1]["measurements"] = len(seen)
            print(name, case, seed, json.dumps({key: rows[-1][key] for key in SHORT}), flush=True)
        extra = ("tie_error_px", "tie_sigma_px", "residual_px", "measurements")
        found[f"{name}, {case}, rendered"] = {
            **summary(rows, images),
            **{key: float(np.mean([row[key] for row in rows])) for key in extra},
            "processor_s_of_each": (time.process_time() - began) / seeds,
        }
    return found


def _noisy(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return values + GREY_NOISE * np.std(values) * rng.normal(size=values.shape)


def main() -> None:
    """Simulate, adjust and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--images", type=int, default=30)
    parser.add_argument("--sites", nargs="+", choices=list(SITES), default=list(SITES))
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--rendered", type=int, default=0, help="seeds with rendered images")
    parser.add_argument("--points", type=int, default=60, help="points of each rendered image")
    parser.add_argument("--json", type=pathlib.Path)
    given = parser.parse_args()
    found: dict[str, Any] = {}
    for name in given.sites:
        for case in given.cases if given.seeds else ():
            found[f"{name}, {case}, simulated ties"] = one = simulated(name, case, given.seeds, given.images)
            print(name, case)
            print(json.dumps(one, indent=1), flush=True)
        if given.rendered:
            more = rendered(name, given.cases, given.rendered, given.images, given.points)
            print(json.dumps(more, indent=1), flush=True)
            found |= more
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
