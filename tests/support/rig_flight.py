"""A simulated flight with a wide and an infrared camera on one mount: drawn errors, true orientations, tie points."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxgeo import ConstantHeight, Exposure, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot
from jaxgeo.adjust import ImagePoints, LocalFrame
from jaxgeo.sensor.platform import R_HEAD_FROM_CAMERA_NADIR
from jaxgeo.ties import Correction, Views
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
MARGIN = 25.0  # px: points as near to the edge are not measured


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
            place, R = (np.asarray(x) for x in sight_of(exposure, error))
            names.append(f"image_{k:02d}_{LETTERS[which]}")
            exposures.append(exposure)
            shot.append(k)
            camera.append(LETTERS[which])
            places.append(np.asarray(frame.from_ecef(place)))
            turns.append(np.asarray(frame.R_ecef_from_local).T @ R)
    return Rig(names, exposures, np.array(shot), np.array(camera), frame, np.array(places), np.array(turns))


@jax.jit
def sight_of(exposure: Exposure, error: Any) -> tuple[jax.Array, jax.Array]:
    """True centre and orientation, in ECEF, of an exposure that errs, along the axes of `ERRORS`."""
    moved = ErrorModel(ERRORS).moved(ModelInputs(exposure, terrain=TERRAIN), jnp.asarray(error)).exposure
    assert isinstance(moved.motion, Shot)
    found = moved.sensor.sight(moved.motion)
    return found.centre, found.R_ecef_from_camera


def measured(rig: Rig, views: Views, seed: int, *, many: int = 160, few: int = 70, both: int = 28) -> ImagePoints:
    """Tie points measured with noise, of `many` ground points in the wide camera, `few` in the infrared one and `both`
    in both of them.

    Ground points, and the images that show them, are the same in all draws, so that programs fit all of them.
    """
    centre, R = rig.true(views)
    ground = np.random.default_rng(7)
    low, high = views.centre.min(axis=0)[:2] - 60.0, views.centre.max(axis=0)[:2] + 60.0
    count = many + few + both
    shown = many * ["W"] + few * ["T"] + both * ["WT"]
    height = views.centre[:, 2].mean() - ABOVE + ground.uniform(-10.0, 10.0, count)
    place = np.column_stack([ground.uniform(low, high, (count, 2)), height])
    rows = []
    for image in range(len(centre)):
        camera = views.camera_of(image)
        uv = _pixels(camera, views.centre[image], views.R_frame_from_camera[image], place)
        inside = np.all((uv > MARGIN) & (uv < np.array([camera.width, camera.height]) - MARGIN), axis=1)
        uv = _pixels(camera, centre[image], R[image], place)
        kept = [k for k in np.flatnonzero(inside).tolist() if rig.camera[image] in shown[k]]
        rows += [(rig.names[image], f"tie {k}", uv[k], int(rig.shot[image])) for k in kept]
    shots_of: dict[str, set[int]] = {}
    for _, point, _, shot in rows:
        shots_of.setdefault(point, set()).add(shot)
    image, point, uv, _ = zip(*[row for row in rows if len(shots_of[row[1]]) > 1], strict=True)
    uv = np.array(uv)
    return ImagePoints(
        list(image), list(point), uv + PIXEL * np.random.default_rng([seed, 2]).normal(size=uv.shape), PIXEL
    )


def _pixels(camera: FrameCamera, centre: np.ndarray, R: np.ndarray, place: np.ndarray) -> np.ndarray:
    there = (place - centre) @ R
    return np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * there[:, :2] / there[:, 2:]


def errors_of(rig: Rig, found: Correction) -> np.ndarray:
    """Errors (n, 6) of the adjusted orientations: centre in m (frame axes), rotation about the camera's axes in rad."""
    place, true = rig.true(found.views)
    rows, images = [rig.names.index(name) for name in found.names], found.adjustment.images
    turn = Rotation.from_matrix(np.swapaxes(true[rows], 1, 2) @ images.R_frame_from_camera).as_rotvec()
    return np.concatenate([images.centre - place[rows], turn], axis=1)
