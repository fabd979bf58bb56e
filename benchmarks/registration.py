"""Success rate and accuracy of registering real frames to an orthophoto from a disturbed pose.

Run: python benchmarks/registration.py [--disturbances 50] [--position 50] [--attitude 0.5] [--json out.json]
Alternates between two frames of a real flight, from the folder JAXGEO_TEST_DATA; position and attitude errors are drawn
with the given sigmas in m and deg along each axis. Reports the number of registered frames; the ground offset from the
given orientation, at the image centre and corners; the share within 3 predicted standard deviations, for the ground and
for the pose; and the compiled time per registration.
"""

from __future__ import annotations

import argparse
import json
import os
import pathlib
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "tests"))
sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import numpy as np
from support.ngi import Flight
from support.registrations import Trial, trial

import jaxgeo

jaxgeo.enable_x64()
DATA = pathlib.Path(os.environ.get("JAXGEO_TEST_DATA", pathlib.Path(__file__).resolve().parents[2] / "shared" / "data"))
FRAMES = ("05_0182", "05_0184")


def figures(trials: list[Trial], seconds: list[float]) -> dict[str, float | int]:
    """Statistics of all trials, and of the registered ones."""
    found = [one for one in trials if one.registration.accepted]
    off = np.array([one.off for one in found])
    ground = np.array([one.off_sigmas.max() for one in found])
    pose = np.array([np.abs(one.pose_sigmas).max() for one in found])
    return {
        "disturbances": len(trials),
        "registered": len(found),
        "passes_median": float(np.median([len(one.registration.passes) for one in found])),
        "middle_median_m": float(np.median(off[:, 0])),
        "middle_largest_m": float(off[:, 0].max()),
        "corners_largest_m": float(off[:, 1:].max()),
        "ground_within_3_sigma": float(np.mean(ground < 3.0)),
        "ground_largest_sigmas": float(ground.max()),
        "pose_within_3_sigma": float(np.mean(pose < 3.0)),
        "pose_largest_sigmas": float(pose.max()),
        "seconds_median": float(np.median(seconds)),
    }


def main() -> None:
    """Run the trials and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--disturbances", type=int, default=50)
    parser.add_argument("--position", type=float, default=50.0, help="m")
    parser.add_argument("--attitude", type=float, default=0.5, help="deg")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--json", type=pathlib.Path, default=None)
    args = parser.parse_args()
    if not (DATA / "ngi_block").is_dir():
        sys.exit(f"{DATA} holds no real frames; name another folder in JAXGEO_TEST_DATA")
    flight, rng = Flight.of(DATA), np.random.default_rng(args.seed)
    trials, seconds = [], []
    for number in range(args.disturbances):
        start = time.perf_counter()
        trials.append(trial(flight, FRAMES[number % 2], rng, args.position, args.attitude))
        seconds.append(time.perf_counter() - start)
        print(f"{number:4d}  {trials[-1].registration.outcome.name}  {trials[-1].off[0]:.2f} m", flush=True)
    found = figures(trials, seconds)
    for name, value in found.items():
        print(f"{name:24s} {value:.4g}")
    if args.json is not None:
        args.json.write_text(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
