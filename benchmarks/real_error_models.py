"""Stated errors of real images held against surveyed or adjusted points.

- Village: four oblique drone frames with real-time kinematic positions. Poses of the image tags are tested against
  fixes by the poses of the bundle adjustment, over the same surface model.
- Aerial: frames of an UltraCam Eagle, given orientations against given ground points, on level ground at the height
  of each point: errors across only.
- Telemetry: reported frame centres of a flight, on level ground at the reported height.

Run: python benchmarks/real_error_models.py FOLDER [--figures FOLDER]
"""

from __future__ import annotations

import argparse
import pathlib
import sys
from typing import Any

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1]))

import jax
import numpy as np

import jaxgeo
from jaxgeo.batches import in_batches
from jaxgeo.io import read_acquisition
from jaxgeo.uncertainty import CheckPoints, PerMeasurement, calibrate_errors, sources, validate
from tests.support.blocks import aerial
from tests.support.miaoli import FRAMES, UNDULATION, Village

ROWS, COLUMNS = 12, 16  # pixels of a frame of the village, of which those of open ground are used
RADIUS, ROUGH = 4.0, 0.8  # m: half side and range of heights of a square of open ground
RTK = (0.009, 0.009, 0.023)  # m, of the image tags
TELEMETRY_STEP = 40  # packets: 4 s


def village(folder: pathlib.Path):
    """(check points, terrain, errors as the drone states them)."""
    made = Village.of(folder)
    camera: Any = made.sensor.camera
    u, v = np.meshgrid(*(np.linspace(0.08, 0.92, n) for n in (COLUMNS, ROWS)))
    uv = np.stack([u.ravel() * camera.width, v.ravel() * camera.height], axis=1)
    poses = _tag_poses(folder)
    truth, shots, pixels, image = [], [], [], []
    for frame in FRAMES:
        true = in_batches(_located, uv, made.sensor, made.shots[frame], made.terrain)
        kept = (true.status == 0) & _is_open(true.position, made.terrain)
        truth.append(jax.tree.map(lambda x, k=kept: np.asarray(x)[k], true.position))
        shots.append(jax.tree.map(lambda x, k=kept: np.repeat(np.asarray(x)[None], k.sum(), axis=0), poses[frame]))
        pixels.append(uv[kept])
        image += [frame] * int(kept.sum())
    join = lambda parts: jax.tree.map(lambda *x: np.concatenate(x), *parts)  # noqa: E731
    observation = jaxgeo.Observation(jaxgeo.Exposure(made.sensor, join(shots)), np.concatenate(pixels))
    points = CheckPoints(observation, join(truth), sigma_enu=0.1, sigma_px=0.5, images=np.array(image))
    north, east, down = RTK
    errors = jaxgeo.ErrorModel(
        (
            sources.Position.from_ned(north=north, east=east, down=down),
            sources.Attitude.from_degrees(heading=1.0, pitch=0.5, roll=0.5),
            sources.TerrainHeight.from_metres(0.2, sharing=PerMeasurement()),
        )
    )
    return points, made.terrain, errors


def _is_open(position: jaxgeo.Geodetic, terrain: jaxgeo.Dem) -> np.ndarray:
    """Whether the surface about each place is open ground: level to half a metre within 4 m, and not steep."""
    away = np.linspace(-RADIUS, RADIUS, 9) / 6.37e6
    lat, lon = np.asarray(position.lat), np.asarray(position.lon)
    there = np.nan_to_num(lat[:, None, None]) + away[:, None], np.nan_to_num(lon[:, None, None]) + 1.1 * away[None, :]
    places = [np.broadcast_to(x, (len(lat), 9, 9)).reshape(-1) for x in there]
    heights = in_batches(_height, tuple(places), terrain).reshape(len(lat), 81)
    return np.ptp(heights, axis=1) < ROUGH


def _height(place, terrain):
    return terrain.height_at(jaxgeo.Geodetic(lat=place[0], lon=place[1], height=0.0))


def _located(uv, sensor, shot, terrain):
    return jaxgeo.locate(sensor, shot, uv, terrain)


def _tag_poses(folder: pathlib.Path) -> dict[str, jaxgeo.Shot]:
    """Poses of the image tags: real-time kinematic position, gimbal angles to 0.1 deg."""
    rows = [line.split() for line in (folder / "odm_miaoli" / "odm_lla_rpy.csv").read_text().splitlines()[1:]]
    poses = {}
    for name, *numbers in rows:
        lat, lon, height, roll, pitch, yaw = (float(x) for x in numbers[:6])
        pose = jaxgeo.Pose.from_degrees(
            lat=lat, lon=lon, height=height + UNDULATION, heading=yaw, pitch=pitch, roll=roll
        )
        poses[pathlib.PurePath(name).stem] = jaxgeo.Shot(pose)
    return poses


def aerial_block(folder: pathlib.Path, most: int = 200):
    """(check points of the given orientations, level ground at each point, errors of an adjusted block)."""
    block = aerial(folder)
    row = {name: k for k, name in enumerate(block.given.name.tolist())}
    place = {name: k for k, name in enumerate(block.ground.name.tolist())}
    rows = [k for k, name in enumerate(block.seen.point.tolist()) if name in place]
    some = np.random.default_rng(0).choice(rows, min(most, len(rows)), replace=False)
    images = block.seen.image[some]
    number = np.array([row[name] for name in images.tolist()])
    shots = jaxgeo.Shot(
        jax.tree.map(lambda x: np.asarray(x)[number], block.poses), np.zeros((len(some), 0)), number * 1.0
    )
    which = [place[name] for name in block.seen.point[some].tolist()]
    position = block.frame.to_geodetic(np.asarray(block.ground.place)[which])
    position = jax.tree.map(lambda x: np.asarray(x, np.float64), position)
    observation = jaxgeo.Observation(jaxgeo.Exposure(block.sensor, shots), np.asarray(block.seen.uv)[some])
    points = CheckPoints(
        observation, position, sigma_enu=0.01, sigma_px=0.2, images=images, points=block.seen.point[some]
    )
    errors = jaxgeo.ErrorModel(
        (
            sources.Position.from_ned(north=0.05, east=0.05, down=0.05),
            sources.Attitude.from_degrees(heading=0.004, pitch=0.002, roll=0.002),
        )
    )
    return points, jaxgeo.ConstantHeight(np.asarray(position.height)), errors


def telemetry(folder: pathlib.Path):
    """(reported frame centres, level ground at their heights, the usual errors of the reader)."""
    found = read_acquisition(folder / "telemetry_klv" / "Cheyenne.bin")
    assert found.reported is not None
    assert found.sensor is not None
    centre = jax.tree.map(lambda x: np.asarray(x, np.float64), found.reported.centre)
    known = np.isfinite(centre.lat) & np.isfinite(centre.height)
    index = np.flatnonzero(known)[:: TELEMETRY_STEP // 10]
    take = lambda tree: jax.tree.map(lambda x: np.asarray(x)[index], tree)  # noqa: E731
    sensor, shots, position = take(found.sensor), take(found.shots), take(centre)
    camera: Any = found.sensor.camera
    size = np.array([camera.width, camera.height])
    uv = np.tile((size - 1.0) / 2.0, (len(index), 1))
    observation = jaxgeo.Observation(jaxgeo.Exposure(sensor, shots), uv)
    points = CheckPoints(observation, position, sigma_enu=1.0, sigma_px=0.5, images=index)
    ground = jaxgeo.ConstantHeight(np.asarray(position.height))
    readings: dict[str, Any] = dict.fromkeys(found.sensor.gimbal.names, 0.1)
    errors = jaxgeo.ErrorModel(
        (
            sources.Position.from_ned(north=3.0, east=3.0, down=5.0),
            sources.Attitude.from_degrees(heading=0.3, pitch=0.1, roll=0.1),
            sources.GimbalAngles.from_degrees(**readings),
        )
    )
    return points, ground, errors


def main() -> None:
    """Print what `validate` and `calibrate_errors` say of each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--figures", type=pathlib.Path)
    parser.add_argument("--only", choices=["village", "aerial", "telemetry"])
    given = parser.parse_args()
    jaxgeo.enable_x64()
    for name, case in (("village", village), ("aerial", aerial_block), ("telemetry", telemetry)):
        if given.only not in (None, name):
            continue
        points, ground, errors = case(given.folder)
        print(f"\n## {name}\n")
        for title, model in (("as stated", errors), ("calibrated", None)):
            if model is None:
                found = calibrate_errors(points, ground, errors, remove_mean=False)
                print(found, "\n")
                model = found.errors
            told = validate(points, ground, model)
            print(f"{title}: {told}\n")
            if given.figures is not None:
                from jaxgeo.plot import validation_figure

                validation_figure(told).savefig(given.figures / f"{name}_{title.replace(' ', '_')}.png", dpi=130)


if __name__ == "__main__":
    main()
