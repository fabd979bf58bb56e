"""Rate of matching pairs of 12-megapixel images, beside the features and matching of COLMAP (pycolmap) on 2 cores.

Run: python benchmarks/tie_rates.py FOLDER [--images 12] [--pairs 40] [--points 150] [--json out.json]
FOLDER receives the images: 4000 x 3000 px, of flat ground with texture of many sizes, a strip with 75 % overlap along
it, and errors of navigation of 1 m and 0.4 deg. jaxgeo matches the predicted pairs; COLMAP extracts SIFT of at most
3200 px on the longer side (its default) and matches and verifies all pairs, or those of neighbours. Seconds are of
the processor and of the clock, a pair, and include reading and features; compilation is apart.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import resource
import sys
import time
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import jax
import numpy as np
import scipy
from PIL import Image

import jaxgeo
from jaxgeo import ConstantHeight, Exposure, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.io.images import read_image
from jaxgeo.ties import Matching, Pictures, Views, candidate_pairs, find_ties
from jaxgeo.uncertainty import sources

jaxgeo.enable_x64()
CORES = 2
WIDTH, HEIGHT, FOCAL = 4000, 3000, 3600.0  # px
GROUND, ABOVE = 100.0, 100.0  # m
ALONG = 0.25 * HEIGHT / FOCAL * ABOVE  # m between images
CELL = 0.02  # m of the texture
METRES, DEGREES = 1.0, 0.4
SENSOR = Sensor(FrameCamera.from_pixels(focal_px=FOCAL, width=WIDTH, height=HEIGHT), Gimbal.fixed(), Mount.nadir())
ERRORS = (
    sources.Position.from_ned(north=METRES, east=METRES, down=METRES),
    sources.Attitude.from_degrees(heading=DEGREES, pitch=DEGREES, roll=DEGREES),
)
RADIUS = 6.3674e6  # m, of the meridian near 47 deg


def texture(side: int, rng: np.random.Generator) -> np.ndarray:
    """A texture (side, side) of 8 bits that repeats at its edges, with sizes from 1 to 1000 cells."""
    freq = np.hypot(np.fft.fftfreq(side)[:, None], np.fft.rfftfreq(side)[None, :])
    noise = np.fft.rfft2(rng.normal(size=(side, side)).astype(np.float32))
    values = np.fft.irfft2(noise / np.maximum(freq, 1e-3) ** 1.1, (side, side))
    return np.clip(128.0 + 40.0 * values / np.std(values), 0, 255).astype(np.float32)


def write_images(folder: pathlib.Path, count: int, seed: int = 0) -> tuple[list[Shot], list[pathlib.Path]]:
    """(shots of the navigation, files): nadir images of a strip to the north, tilted a little."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    world = texture(8192, rng)
    given, files = [], []
    for k in range(count):
        path = folder / f"{k:04d}.jpg"
        angles = rng.normal(size=3) * [2.0, 1.0, 1.0]
        if not path.exists():
            heading, pitch, roll = np.deg2rad(angles)
            Image.fromarray(_seen(world, k * ALONG, heading, pitch, roll)).save(path, quality=92)
        off = rng.normal(size=6)
        pose = Pose.from_degrees(
            lat=47.0 + np.rad2deg((k * ALONG + METRES * off[0]) / RADIUS),
            lon=11.0 + np.rad2deg(METRES * off[1] / RADIUS / np.cos(np.deg2rad(47.0))),
            height=GROUND + ABOVE + METRES * off[2],
            heading=angles[0] + DEGREES * off[3],
            pitch=angles[1] + DEGREES * off[4],
            roll=angles[2] + DEGREES * off[5],
        )
        given.append(Shot(pose, np.zeros(0)))
        files.append(path)
    return given, files


def _seen(world: np.ndarray, north: float, heading: float, pitch: float, roll: float) -> np.ndarray:
    """The image (HEIGHT, WIDTH) of 8 bits over flat ground."""
    R = np.asarray(jaxgeo.rotations.R_from_heading_pitch_roll(heading, pitch, roll))
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    x, y = (u - 0.5 * (WIDTH - 1)) / FOCAL, (v - 0.5 * (HEIGHT - 1)) / FOCAL
    ray = [R[i, 0] * -y + R[i, 1] * x + R[i, 2] for i in range(3)]  # NED; image up is forward
    row = -(north + ABOVE * ray[0] / ray[2]) / CELL
    col = ABOVE * ray[1] / ray[2] / CELL
    values = scipy.ndimage.map_coordinates(world, [row, col], order=1, mode="grid-wrap")
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def ours(given: list[Shot], files: list[pathlib.Path], pairs: int, points: int) -> dict[str, Any]:
    """Figures of jaxgeo: once for a few pairs, to compile, then for all."""
    views = Views.of([one.stem for one in files], [Exposure(SENSOR, one) for one in given], [ERRORS] * len(given))
    terrain = ConstantHeight(jax.numpy.asarray(GROUND))
    chosen = candidate_pairs(views, terrain)[:pairs]
    pictures = lambda: Pictures(lambda row: read_image(files[row]))  # noqa: E731
    how = Matching(sigma_height=1.0)
    found = {}
    for label, some in (("first", chosen[:2]), ("all", chosen)):
        clock, processor = time.perf_counter(), time.process_time()
        ties = find_ties(views, terrain, pictures(), how, pairs=some, points=points)
        found[label] = time.perf_counter() - clock, time.process_time() - processor, ties
    ties = found["all"][2]
    return {
        "pairs": len(chosen),
        "tied_pairs": sum(pair.tied > 0 for pair in ties.pairs),
        "matches": sum(pair.tied for pair in ties.pairs),
        "clock_s_a_pair": found["all"][0] / len(chosen),
        "processor_s_a_pair": found["all"][1] / len(chosen),
        "first_two_pairs_s": found["first"][0],
        "memory_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }


def colmap(folder: pathlib.Path, database: pathlib.Path, kind: str, count: int) -> dict[str, Any]:
    """Figures of COLMAP: features once, and matching of all pairs or of neighbours."""
    import pycolmap  # pyright: ignore[reportMissingImports]

    database.unlink(missing_ok=True)
    names = sorted(one.name for one in folder.glob("*.jpg"))[:count]
    clock, processor = time.perf_counter(), time.process_time()
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.use_gpu = CORES, False
    pycolmap.extract_features(
        database, folder, names, camera_mode=pycolmap.CameraMode.SINGLE, extraction_options=extraction
    )
    middle, middle_processor = time.perf_counter(), time.process_time()
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads, matching.use_gpu = CORES, False
    options: dict[str, Any] = {"matching_options": matching}
    if kind == "sequential":
        pairing = pycolmap.SequentialPairingOptions()
        pairing.overlap, pairing.quadratic_overlap = 3, False
        options["pairing_options"] = pairing
    getattr(pycolmap, f"match_{kind}")(database, **options)
    clock_end, processor_end = time.perf_counter(), time.process_time()
    pairs = count * (count - 1) // 2 if kind == "exhaustive" else sum(min(3, count - 1 - k) for k in range(count))
    return {
        "pairs": pairs,
        "clock_s_a_pair": (clock_end - clock) / pairs,
        "processor_s_a_pair": (processor_end - processor) / pairs,
        "features_clock_s_an_image": (middle - clock) / count,
        "features_processor_s_an_image": (middle_processor - processor) / count,
        "matching_clock_s_a_pair": (clock_end - middle) / pairs,
        "matching_processor_s_a_pair": (processor_end - middle_processor) / pairs,
    }


def main() -> None:
    """Match and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--images", type=int, default=12)
    parser.add_argument("--pairs", type=int, default=40, help="at most, of jaxgeo")
    parser.add_argument("--points", type=int, default=150, help="points of each image")
    parser.add_argument("--peers", nargs="*", default=["sequential", "exhaustive"])
    parser.add_argument("--json", type=pathlib.Path)
    given = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])
    shots, files = write_images(given.folder, given.images)
    found: dict[str, Any] = {"jaxgeo": ours(shots, files, given.pairs, given.points)}
    print(json.dumps(found["jaxgeo"], indent=1), flush=True)
    for kind in given.peers:
        found[kind] = colmap(given.folder, given.folder / f"{kind}.db", kind, given.images)
        print(kind, json.dumps(found[kind], indent=1), flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
