"""Tracks of simulated looks: consistency of batch and filter, what looks gain on real terrain, and rate.

An aircraft flies an arc of 90 degrees around the target, with looks every 5 s. Attitude errs by 0.2 degrees in each
look and by 0.05 degrees that fade within a minute, the boresight by 0.08 degrees for the flight, the position by 3 to
5 m, the pixel by 2 px, the DEM by 4 m and the geoid by 0.5 m for all looks. Truth and pixels are drawn by
`simulate_looks`. On hills, targets are places of the packaged terrain that all looks
see. With 2000 runs a true covariance has NEES / 3 from 0.965 to 1.036 in 95 % of studies, with 500 from 0.930 to 1.073;
of five scenes one or more is outside by chance in 23 % of studies, whatever the number of runs.

Run: python benchmarks/tracking.py [--runs 2000] [--looks 40]
"""

from __future__ import annotations

import argparse
import dataclasses
import math
import pathlib
import sys
import time
from typing import Any, NamedTuple

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import jax
import numpy as np
import scipy.stats
from measuring import Column, Table

import jaxgeo
from jaxgeo import ErrorModel, Geodetic, Pose, Shot
from jaxgeo.earth import R_ecef_from_enu
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty import AtRest, ConstantVelocity, Looks, TimeCorrelated, Track, simulate_looks, sources, track

jaxgeo.enable_x64()
CAMERA = jaxgeo.FrameCamera.from_pixels(focal_px=5000.0, width=4000, height=3000)
SENSOR = jaxgeo.Sensor(CAMERA, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.forward())
STEP, ARC = 5.0, 90.0  # s between looks; deg
VELOCITY = (6.0, 4.0, 0.0)  # m/s of a moving target
SIZES = (10, 100, 1000, 10_000)  # looks, for the rate
PUBLISHED = "30.7 to 11.7 m, and 43.4 to 19.8 m (Sensors 2022, 22(3), 1150: one look, filtered)"


class Scene(NamedTuple):
    """Looks at a place from `away` m to its side and `up` m above, from an azimuth in degrees on."""

    terrain: AbstractTerrain
    place: Geodetic
    looks: Looks


class Run(NamedTuple):
    """A track; horizontal error in m and NEES of one look, batch, filter and the filter of independent looks; CE90 in m
    of the batch, that the filter of independent looks claims, and that it has."""

    found: Track
    error: tuple[float, ...]
    nees: tuple[float, ...]
    ce90: tuple[float, ...]


def errors() -> ErrorModel:
    fading = TimeCorrelated(60.0)
    return ErrorModel(
        (
            sources.Attitude.from_degrees(heading=0.2, pitch=0.2, roll=0.2),
            sources.Attitude.from_degrees(heading=0.05, pitch=0.05, roll=0.05, sharing=fading),
            sources.Boresight.from_degrees(heading=0.08, pitch=0.08, roll=0.08),
            sources.Position.from_ned(north=3.0, east=3.0, down=5.0),
            sources.PixelMeasurement.from_pixels(column=2.0, row=2.0),
            sources.Geoid.from_metres(0.5),
            sources.TerrainHeight.from_metres(4.0),
        )
    )


def scene(
    terrain: AbstractTerrain, lat: float, lon: float, azimuth: float, away: float, up: float, count: int
) -> Scene:
    height = float(terrain.height_at(Geodetic.from_degrees(lat=lat, lon=lon, height=0.0)))
    place = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    angles = np.radians(azimuth + np.linspace(0.0, ARC, count))
    north, east = np.cos(angles) / 111_000.0, np.sin(angles) / 111_000.0 / math.cos(math.radians(lat))
    cameras = Geodetic.from_degrees(lat=lat + away * north, lon=lon + away * east, height=np.full(count, height + up))
    poses = jax.vmap(lambda camera: Pose.looking_at(position=camera, point=place))(cameras)
    shots = Shot(poses, np.zeros((count, 0)), STEP * np.arange(count))
    return Scene(terrain, place, Looks(SENSOR, shots, np.zeros((count, 2))))


def level(count: int) -> list[Scene]:
    return [scene(jaxgeo.ConstantHeight(300.0), 36.3, -84.2, 0.0, 4000.0, 3000.0, count)]


def hills(count: int, away: float, up: float, sites: int = 20) -> list[Scene]:
    """Places that all looks see."""
    dem, rng, found = jaxgeo.io.example_dem(), np.random.default_rng(1), []
    sees = jax.jit(jax.vmap(lambda shot, place: jaxgeo.project(SENSOR, shot, place, terrain=dem).ok, in_axes=(0, None)))
    while len(found) < sites:
        lat, lon, azimuth = rng.uniform(36.24, 36.38), rng.uniform(-84.33, -84.12), rng.uniform(0.0, 360.0)
        one = scene(dem, lat, lon, azimuth, away, up, count)
        if np.all(sees(one.looks.shots, one.place)):
            found.append(one)
    return found


def run(one: Scene, target: Any, seed: int) -> Run:
    velocity = VELOCITY if target.is_moving else (0.0, 0.0, 0.0)
    made = simulate_looks(
        one.looks,
        one.terrain,
        errors(),
        jax.random.key(seed),
        position=one.place,
        velocity_enu=velocity,
        target=target,
    )
    found = track(made.looks, one.terrain, errors(), target=target)
    first = int(np.argmax(found.filtered.ok))
    states = (found.filtered[first], found.batch, found.filtered[-1], found.independent[-1])
    truths = (made.p_ecef[first], *[made.p_ecef[-1]] * 3)
    off, nees = [], []
    for state, truth in zip(states, truths, strict=True):
        error = np.asarray(R_ecef_from_enu(state.position)).T @ (np.asarray(state.p_ecef) - np.asarray(truth))
        off.append(math.hypot(*error[:2]))
        nees.append(float(error @ np.linalg.solve(np.asarray(state.cov_enu), error)))
    claimed = found.independent[-1]
    actual = dataclasses.replace(claimed, cov_enu=found.actual_enu[-1])
    return Run(found, tuple(off), tuple(nees), tuple(float(one.ce90) for one in (found.batch, claimed, actual)))


CONSISTENCY = [
    Column("scene"),
    Column("runs"),
    Column("NEES / 3, batch"),
    Column("filter"),
    Column("filter of independent looks"),
    Column("95 % bounds"),
    Column("NIS / degrees of freedom"),
    Column("95 % bounds of NIS"),
]
GAIN = [
    Column("scene"),
    Column("rms of one look", "m", "lower"),
    Column("of batch", "m", "lower"),
    Column("of filter", "m", "lower"),
    Column("CE90 of batch", "m", "lower"),
    Column("CE90 claimed by a filter of independent looks", "m"),
    Column("its actual CE90", "m"),
    Column("overconfidence", "", "lower"),
]


def study(runs: int, count: int) -> list[Table]:
    scenes: dict[str, tuple[list[Scene], Any]] = {
        "level, at rest": (level(count), AtRest()),
        "level, moving": (level(count), ConstantVelocity()),
        "hills, 37 degrees down, at rest": (hills(count, 4000.0, 3000.0), AtRest()),
        "hills, 37 degrees down, moving": (hills(count, 4000.0, 3000.0), ConstantVelocity()),
        "hills, 27 degrees down, at rest": (hills(count, 5000.0, 2500.0), AtRest()),
    }
    consistency = Table("Consistency: squared errors in those that are stated", CONSISTENCY)
    gain = Table(f"Gain of {count} looks", GAIN, notes=[f"Published: {PUBLISHED}."])
    low, high = scipy.stats.chi2.ppf([0.025, 0.975], 3 * runs) / (3 * runs)
    for part, (name, (places, target)) in enumerate(scenes.items()):
        each = [run(places[number % len(places)], target, runs * part + number) for number in range(runs)]
        _, *nees = np.mean([one.nees for one in each], axis=0) / 3.0
        degrees = sum(int(np.sum(one.found.degrees)) for one in each)
        nis = sum(float(np.sum(one.found.nis)) for one in each) / degrees
        least, most = scipy.stats.chi2.ppf([0.025, 0.975], degrees) / degrees
        row = [name, runs, *(f"{x:.3f}" for x in nees), f"{low:.3f} to {high:.3f}", f"{nis:.4f}"]
        consistency.rows.append([*row, f"{least:.4f} to {most:.4f}"])
        print(consistency.rows[-1], file=sys.stderr, flush=True)
        rms = np.sqrt(np.mean(np.square([one.error[:3] for one in each]), axis=0))
        figures = np.mean([one.ce90 for one in each], axis=0)
        over = float(np.mean([one.ce90[2] / one.ce90[1] for one in each]))
        gain.rows.append([name, *map(float, rms), *map(float, figures), over])
    return [consistency, gain]


def rate() -> Table:
    columns = [
        Column("looks"),
        Column("all of track", "s", "lower"),
        Column("processor time", "s", "lower"),
        Column("looks / s", "", "higher"),
    ]
    table = Table("Rate of track, after compiling, at rest on hills", columns)
    for count in SIZES:
        one = hills(count, 4000.0, 3000.0, sites=1)[0]
        made = simulate_looks(one.looks, one.terrain, errors(), jax.random.key(0), position=one.place)
        track(made.looks, one.terrain, errors())
        begin, spent = time.perf_counter(), time.process_time()
        track(made.looks, one.terrain, errors())
        seconds, spent = time.perf_counter() - begin, time.process_time() - spent
        table.rows.append([count, seconds, spent, count / seconds])
    return table


def main() -> None:
    """Run the study and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2000, help="simulated tracks of each scene")
    parser.add_argument("--looks", type=int, default=40, help="looks of each track")
    options = parser.parse_args()
    for table in [*study(options.runs, options.looks), rate()]:
        print(table.markdown())


if __name__ == "__main__":
    main()
