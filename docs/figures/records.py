"""What the gallery shows: records, each made once, when a figure asks for it."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import jax
import numpy as np
import scipy

from jaxgeo import FrameCamera, Geodetic, Gimbal, Mount, Pose, Sensor, Shot, coverage, ortho, register
from jaxgeo import uncertainty as un
from jaxgeo.adjust import Adjustment, Block, ImagePoints, LocalFrame, Reliability, adjust, reliability
from jaxgeo.coverage import Footprint, Overlap, geometry
from jaxgeo.demo.scene import Demo, make_demo, scene_file
from jaxgeo.earth.ray import Ray
from jaxgeo.io import example_dem
from jaxgeo.io.scene import read_scene
from jaxgeo.ortho import Orthoimage
from jaxgeo.plot import Section, section_under
from jaxgeo.register import Registration
from jaxgeo.register.places import BlockPlaces, places_of_blocks
from jaxgeo.sensor.conventions import li_2020_sensor
from jaxgeo.studies.gu2017 import scene as mapped
from jaxgeo.uncertainty import sources

FAR_COLUMN = 2280.0  # px: a line of sight that meets the ground once more behind a ridge
SIDE, STRIP, HIGH = 60.0, 4, 500.0  # m between images, images in each of two strips, height in m
SIGMA_UV = 0.5  # px
SIGMA_TERRAIN = 5.0  # m
CLOUDED = (8, 13, 18)  # of the fixes of the demonstration
STRIPS = {"field": np.deg2rad(0.88), "across": 14000, "off_nadir": np.deg2rad(68.0), "height": 5469.0, "required": 0.15}


@cache
def demo() -> Demo:
    return make_demo()


@cache
def demo_errors() -> tuple[Any, ...]:
    """(sensor, shot, terrain, errors) of the demonstration."""
    scene = read_scene(scene_file())
    return scene.sensor, scene.shot, example_dem(), scene.errors


@cache
def of_fixes() -> un.Accuracy:
    """How sure the fixes of the demonstration are."""
    sensor, shot, dem, errors = demo_errors()
    axes = (None, None, 0, None, None)
    return un.accuracy(sensor, shot, demo().uv, dem, errors, in_axes=axes, sampling=un.Sampling(count=4000))


@cache
def clouds() -> list[un.Comparison]:
    """Samples of three of the fixes, of which some jump."""
    sensor, shot, dem, errors = demo_errors()
    sampling = un.Sampling(count=20_000, chunk=20_000)
    return [un.compare(sensor, shot, demo().uv[k], dem, errors, sampling=sampling) for k in CLOUDED]


@cache
def two_hills() -> un.ProbabilityMap:
    """A line of sight that may come down on two hills."""
    camera = FrameCamera.from_metric(focal_length=0.075, pixel_pitch=5.5e-6, width=2400, height=4800)
    sensor = Sensor(camera, Gimbal.two_axis(), Mount.nadir())
    pose = Pose.from_degrees(lat=36.318, lon=-84.105, height=5469.0, heading=160.0)
    shot = Shot(pose, sensor.gimbal.readings_from_degrees(outer=72.0, inner=0.0))
    errors = un.ErrorModel(
        (
            sources.Attitude.from_degrees(heading=0.05, pitch=0.02, roll=0.02),
            sources.GimbalAngles.from_degrees(outer=0.02, inner=0.02),
            sources.Position.from_ned(north=1.5, east=1.5, down=3.0),
            sources.TerrainHeight.from_metres(5.0),
        )
    )
    options = {"key": jax.random.key(1), "count": 20_000, "keep": True}
    return un.sample(sensor, shot, (1062.0, 2348.0), example_dem(), errors, **options).probability_map()


@cache
def accuracies() -> un.AccuracyMap:
    sensor, shot, dem, errors = demo_errors()
    return un.accuracy_map(sensor, shot, dem, errors, step=5, sampling=un.Sampling(count=512))


@cache
def section() -> Section:
    sensor, shot, dem, _ = demo_errors()
    uv = np.array([FAR_COLUMN, 0.5 * (sensor.camera.height - 1)])
    return section_under(Ray(*sensor.ray_ecef(shot, uv)[:2]), dem)


@cache
def strips() -> tuple[list[Footprint], Overlap]:
    """Two strips of a sweeping camera over mountains, and what they share."""
    field, across, off_nadir, height, required = STRIPS.values()
    terrain = example_dem()
    pitch = 2 * np.tan(field / 2) / 1536
    sensor = li_2020_sensor(
        focal_length=1.0, pixel_pitch=pitch, along_flight=1536, across_flight=int(across), mirror=False
    )
    look = sensor.gimbal.readings_from_degrees(outer=68.0, inner=0.0)
    near = off_nadir - np.arctan(across * np.tan(field / 2) / 1536)
    setting = {"height_above_ground": height - 400.0, "off_nadir": near, "field_of_view": field}
    step = float(geometry.path_of_overlap(overlap=required, **setting))

    def shot_at(step: float) -> Shot:
        north, east = step * np.cos(np.deg2rad(160.0)), step * np.sin(np.deg2rad(160.0))
        lat = 36.318 + np.rad2deg(north / 6.36e6)
        lon = -84.105 + np.rad2deg(east / (6.385e6 * np.cos(np.deg2rad(36.3))))
        return Shot(Pose.from_degrees(lat=lat, lon=lon, height=height, heading=160.0), look)

    pair = shot_at(0.0), shot_at(step)
    outlines = [coverage.footprint(sensor, strip, terrain) for strip in pair]
    return outlines, coverage.overlap(sensor, *pair, terrain, along="rows", stations=65)


class Registered(NamedTuple):
    """A registration, what is drawn of it, and the fixes of one pixel by the navigation and after it."""

    found: Registration
    reference: Orthoimage
    before: Orthoimage
    after: Orthoimage
    places: BlockPlaces
    covariance: Any
    direct: un.Propagation
    updated: un.Propagation | None


@cache
def registered() -> Registered:
    """An image of made-up fields on the example's mountains, registered to their map."""
    ground = example_dem()
    target = mapped.target_on(ground)
    rough = mapped.textured(ground, target, (480, 480), 8.0, 0)
    rng = np.random.default_rng(0)
    _, field = scipy.spatial.cKDTree(rng.uniform(0.0, 480.0, (600, 2))).query(
        np.moveaxis(np.indices(rough.shape), 0, -1)
    )
    values = 100.0 + 0.4 * (np.asarray(rough.values[0]) - 100.0) + 30.0 * rng.normal(size=600)[field]
    reference = Orthoimage.of(values, rough.grid)
    sensor = Sensor(FrameCamera.from_pixels(focal_px=560.0, width=320, height=240), Gimbal.fixed(), Mount.nadir())
    true = mapped.looking_at(target, off_nadir=35.0, azimuth=20.0, above=3000.0)
    image = mapped.spoilt(ortho.render(sensor, true, reference, ground).values, seed=0, noise=0.4)
    noise = scipy.ndimage.gaussian_filter(np.random.default_rng(3).normal(size=ground.posts.shape), 0.7)
    terrain = ground.with_posts(np.asarray(ground.posts) + SIGMA_TERRAIN * noise / np.std(noise))
    given = mapped.moved(true, np.array([30.0, -25.0, 20.0]), np.deg2rad([0.3, -0.3, 0.3]))
    hold = un.TimeCorrelated(600.0)
    position = sources.Position.from_ned(north=30.0, east=30.0, down=30.0, sharing=hold)
    attitude = sources.Attitude.from_degrees(heading=0.3, pitch=0.3, roll=0.3, sharing=hold)
    errors = un.ErrorModel((position, attitude))
    ties = register.TieErrors(registration=0.5, terrain=SIGMA_TERRAIN)
    grid = reference.grid, reference.shape
    before = ortho.rectify(sensor, given, image, terrain, *grid).orthoimage
    found = register.register_image(sensor, given, image, reference, terrain, errors, ties, block=32)
    after = ortho.rectify(found.sensor, found.shot, image, terrain, *grid).orthoimage
    rest = sources.TerrainHeight.from_metres(SIGMA_TERRAIN, sharing=un.PerMeasurement())
    uv = np.array([160.0, 120.0])
    direct = un.propagate(sensor, given, uv, terrain, un.ErrorModel((*errors.sources, rest)))
    prior = register.Prior.of(errors, ties).covariance
    updated = found.fix(uv, SIGMA_TERRAIN)
    return Registered(found, reference, before, after, places_of_blocks(found), prior, direct, updated)


@cache
def adjusted() -> tuple[Adjustment, Reliability]:
    found = adjust(simulated_block())
    return found, reliability(found)


def simulated_block() -> Block:
    """Two strips of images over hilly ground, their points measured with errors of `SIGMA_UV`."""
    rng = np.random.default_rng(5)
    camera = FrameCamera.from_pixels(focal_px=3000.0, width=4000, height=3000)
    frame = LocalFrame(Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0))
    north, east = (x.ravel() for x in np.meshgrid(SIDE * np.arange(STRIP), [0.0, 2.5 * SIDE], indexing="ij"))
    centre = np.stack([east, north, np.full(east.shape, HIGH)], axis=1)
    position = frame.to_geodetic(centre)
    zero = np.zeros(len(centre))
    shots = Shot(Pose(position, zero, zero, zero), np.zeros((len(centre), 0)), np.arange(len(centre)) * 2.0)
    ground = rng.uniform([-150.0, -150.0], [300.0, 330.0], (60, 2))
    points = np.column_stack([ground, 25.0 * np.sin(ground[:, 0] / 60.0)])
    sensor = Sensor(camera, mount=Mount.nadir())
    names = [f"image {k}" for k in range(len(centre))]
    block = Block.from_shots(sensor, names, shots, seen_by(camera, centre, points, names, rng, None), **SIGMAS)
    turned = block.images.R_frame_from_camera
    return Block.from_shots(sensor, names, shots, seen_by(camera, centre, points, names, rng, turned), **SIGMAS)


SIGMAS: dict[str, Any] = {"sigma_position": 0.1, "sigma_attitude": np.deg2rad(0.02)}


def seen_by(camera: Any, centre: Any, points: Any, names: list[str], rng: Any, turned: Any) -> ImagePoints:
    """The points that lie in each image, where it sees them; images level and northwards unless `turned`."""
    level = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])  # right, down, forward in east, north, up
    rows: list[tuple[str, str, np.ndarray]] = []
    for k, name in enumerate(names):
        R = level if turned is None else turned[k]
        d = (points - centre[k]) @ R
        uv = np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * d[:, :2] / d[:, 2:]
        inside = np.all((uv > 0.0) & (uv < [camera.width - 1, camera.height - 1]), axis=1)
        measured = uv + rng.normal(0.0, SIGMA_UV, uv.shape)
        rows += [(name, f"point {j}", measured[j]) for j in np.flatnonzero(inside).tolist()]
    image, point, uv = zip(*rows, strict=True)
    return ImagePoints(list(image), list(point), np.array(uv), SIGMA_UV).seen_often(2)
