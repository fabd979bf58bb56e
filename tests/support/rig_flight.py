"""A simulated flight with a wide and an infrared camera on one mount: drawn errors, true orientations, tie points."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxgeo import ConstantHeight, Exposure, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.adjust import ImagePoints, LocalFrame
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_NADIR
from jaxgeo.ties import Views
from jaxgeo.uncertainty import ErrorModel, PerFlight, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs

GROUND, ABOVE, APART, ACROSS, STEP = 100.0, 150.0, 30.0, 70.0, 2.0  # m, m, m, m, s
STRIPS, OF_STRIP = 2, 7
PIXEL = 0.3  # px
TILT = 5.0  # deg, of the infrared camera against the wide one
WIDE = FrameCamera.from_pixels(focal_px=600.0, width=640, height=480)
INFRARED = FrameCamera.from_pixels(focal_px=420.0, width=320, height=256)
POSITION, OFFSET, ATTITUDE = 0.3, 1.0, np.deg2rad(0.3)
MOUNTING, LEVER = np.deg2rad(0.3), 0.03
ERRORS = (
    sources.Position(np.full(3, POSITION)),
    sources.Position(np.full(3, OFFSET), sharing=PerFlight()),
    sources.Attitude(np.full(3, ATTITUDE)),
    sources.CameraMounting(np.full(3, MOUNTING)),
    sources.LeverArm(np.full(3, LEVER)),
)
TERRAIN = ConstantHeight(jnp.asarray(GROUND))


def sensor_of(camera: FrameCamera, tilt: float, lever: tuple[float, float, float]) -> Sensor:
    turn = Rotation.from_euler("y", tilt, degrees=True).as_matrix()
    return Sensor(camera, Gimbal.fixed(), Mount(np.eye(3), turn @ R_HEAD_FROM_CAMERA_NADIR, np.array(lever)))


SENSORS = (sensor_of(WIDE, 0.0, (0.2, -0.1, 0.3)), sensor_of(INFRARED, TILT, (0.2, 0.15, 0.3)))
LETTERS = "WT"


@dataclass(frozen=True)
class Rig:
    """Images (n,) of shots, shot by shot: names, given exposures, true centres and orientations in `frame`."""

    names: list[str]
    exposures: list[Exposure]
    shot: np.ndarray
    camera: np.ndarray
    frame: LocalFrame
    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    errors: Any = field(default=ERRORS)

    def views(self, **how: Any) -> Views:
        """By the given navigation; `shot` by default."""
        how = {"shot": self.shot} | how
        return Views.of(self.names, self.exposures, [self.errors] * len(self.names), **how)

    def true(self, views: Views) -> tuple[np.ndarray, np.ndarray]:
        """True centres and orientations in the frame of views."""
        place = np.asarray(views.frame.from_ecef(np.asarray(self.frame.to_ecef(self.centre))))
        turn = np.asarray(views.frame.R_ecef_from_local).T @ np.asarray(self.frame.R_ecef_from_local)
        return place, turn @ self.R_frame_from_camera


def shots(strips: int = STRIPS, of_strip: int = OF_STRIP) -> list[Shot]:
    found = []
    for k in range(strips * of_strip):
        strip, along = divmod(k, of_strip)
        lat = 47.0 + np.rad2deg(APART * (along if strip % 2 == 0 else of_strip - 1 - along) / 6.367e6)
        lon = 11.0 + np.rad2deg(ACROSS * strip / (6.378e6 * np.cos(np.deg2rad(47.0))))
        pose = Pose.from_degrees(
            lat=lat, lon=lon, height=GROUND + ABOVE + 3.0 * (k % 3), heading=180.0 * (strip % 2) + 5.0 * (k % 3),
            pitch=3.0 * (-1) ** k, roll=-2.0,
        )  # fmt: skip
        found.append(Shot(pose, np.zeros(0), 100.0 + STEP * k))
    return found


@functools.cache
def _moving(model: ErrorModel) -> Any:
    """Compiled: true centre and orientation, in ECEF, of an exposure that errs."""

    @jax.jit
    def sight(exposure: Exposure, error: jax.Array) -> tuple[jax.Array, jax.Array]:
        moved = model.moved(ModelInputs(exposure, terrain=TERRAIN), error).exposure
        assert isinstance(moved.motion, Shot)
        found = moved.sensor.sight(moved.motion)
        return found.centre, found.R_ecef_from_camera

    return sight


def drawn(seed: int, strips: int = STRIPS, of_strip: int = OF_STRIP, mounting: float = 1.0) -> Rig:
    """A draw of all errors: position and attitude of each shot, an offset of the flight, mounting of each camera."""
    rng = np.random.default_rng(seed)
    given = shots(strips, of_strip)
    offset = OFFSET * rng.normal(size=3)
    of_cameras = [np.concatenate([MOUNTING * rng.normal(size=3), LEVER * rng.normal(size=3)]) for _ in SENSORS]
    frame = LocalFrame(given[0].pose.position)
    names, exposures, shot, camera, places, turns = [], [], [], [], [], []
    for k, one in enumerate(given):
        own = np.concatenate([POSITION * rng.normal(size=3), offset, ATTITUDE * rng.normal(size=3)])
        for which, sensor in enumerate(SENSORS):
            error = np.concatenate([own, mounting * of_cameras[which]])
            exposure = Exposure(sensor, one)
            place, R = (np.asarray(x) for x in _sight(exposure, error))
            names.append(f"image_{k:02d}_{LETTERS[which]}")
            exposures.append(exposure)
            shot.append(k)
            camera.append(LETTERS[which])
            places.append(np.asarray(frame.from_ecef(place)))
            turns.append(np.asarray(frame.R_ecef_from_local).T @ R)
    return Rig(names, exposures, np.array(shot), np.array(camera), frame, np.array(places), np.array(turns))


def _sight(exposure: Exposure, error: np.ndarray) -> Any:
    return _sight_of(exposure, jnp.asarray(error))


@jax.jit
def _sight_of(exposure: Exposure, error: jax.Array) -> tuple[jax.Array, jax.Array]:
    moved = ErrorModel(ERRORS).moved(ModelInputs(exposure, terrain=TERRAIN), error).exposure
    assert isinstance(moved.motion, Shot)
    found = moved.sensor.sight(moved.motion)
    return found.centre, found.R_ecef_from_camera


def measured(rig: Rig, views: Views, seed: int, *, many: int = 9, few: int = 5, both: int = 2) -> ImagePoints:
    """Tie points measured with noise: a lattice of `many` x points in the wide camera, `few` per image of the
    infrared one, and `both` per shot in both cameras."""
    rng = np.random.default_rng([seed, 2])
    centre, R = rig.true(views)
    places, shown = [], []
    low, high = centre.min(axis=0)[:2] - 60.0, centre.max(axis=0)[:2] + 60.0
    for count, cameras in ((many * many * 2, "W"), (few * len(centre) // 2, "T"), (both * len(centre) // 2, "WT")):
        flat = rng.uniform(low, high, (count, 2))
        places.append(np.column_stack([flat, centre[:, 2].mean() - ABOVE + rng.uniform(-10.0, 10.0, count)]))
        shown += [cameras] * count
    place = np.concatenate(places)
    rows = []
    for image in range(len(centre)):
        camera = views.camera_of(image)
        there = (place - centre[image]) @ R[image]
        uv = np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * there[:, :2] / there[:, 2:]
        inside = np.all((uv > 2.0) & (uv < np.array([camera.width, camera.height]) - 3.0), axis=1)
        rows += [(rig.names[image], f"tie {k}", uv[k]) for k in np.flatnonzero(inside) if rig.camera[image] in shown[k]]
    image, point, uv = zip(*rows, strict=True)
    seen = ImagePoints(list(image), list(point), np.array(uv), PIXEL).seen_often()
    return ImagePoints(seen.image, seen.point, seen.uv + PIXEL * rng.normal(size=seen.uv.shape), seen.sigma)


def errors_of(rig: Rig, views: Views, centre: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Errors (n, 6) of orientations: centre in m (frame axes), rotation about the camera's axes in rad."""
    place, true = rig.true(views)
    turn = Rotation.from_matrix(np.swapaxes(true, 1, 2) @ R).as_rotvec()
    return np.concatenate([centre - place, turn], axis=1)
