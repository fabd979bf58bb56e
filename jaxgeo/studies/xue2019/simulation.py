"""Simulation of a block like that of the paper: camera, flight, navigation, ground, targets, and all their errors.

Flight, ground, points and visibility are the same for every seed; only the noise changes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.adjust import Block, GroundPoints, ImagePoints, LocalFrame
from jaxgeo.adjust.navigation import sights_of
from jaxgeo.earth import Geodetic
from jaxgeo.rotations import heading_pitch_roll_from_R
from jaxgeo.sensor import (
    AbstractCamera,
    AbstractCorrection,
    BrownConrady,
    FrameCamera,
    Mount,
    Pose,
    Sensor,
    Shot,
    boresight_from_degrees,
)
from jaxgeo.studies.xue2019 import printed
from jaxgeo.studies.xue2019.printed import Interior

GEOMETRY = 2019  # seed of everything except the noise
ORIGIN = (34.5, 113.0)  # deg, near Songshan
GROUND, RELIEF = 250.0, 45.0  # m: mean height, and hills above and below it
SPEED = 25.0  # m/s
SWAY, TILT, CRAB = 3.0, 1.0, 2.0  # m and deg: deviation of flight and attitude from the plan
LEVER = (0.10, 0.05, 0.30)  # m, IMU to camera, body axes; surveyed, free of error
SIGMA_IMAGE = 0.3  # px
SIGMA_GROUND = (0.010, 0.010, 0.015)  # m, of control and check points
TIES = 30  # in an image
# Distortion left by the maker's calibration: 0.8 um halfway out and -7.6 um in the corners, more than
# Bauer's and Ebner's terms can model. It is balanced over the image, <k1 r4 + k2 r6> = 0, so it does not change the
# focal length. There is no decentring: p1 = 1e-4 is, except for third-order terms, a tilt of 0.7' and a shift of the
# principal point by 11 um, and all three models would estimate it as boresight.
LENS = BrownConrady(k1=8.0e-4, k2=-3.822e-3)
RIPPLE, WAVES = 0.05, 3.0  # px, and periods over the image: an uneven chip, in no lens model
REACH = 0.45  # share of the area's side: distance of control from the centre


@dataclass(frozen=True)
class Flown:
    """A flight without noise: the true sensor, image positions (n, 3) in `frame` and angles (n, 3) (heading, pitch,
    roll, rad), all points, and the visible image points: point index `point`, pixel `uv` (px), image index `at`."""

    size: float
    true: Sensor
    frame: LocalFrame
    place: np.ndarray
    angles: np.ndarray
    strip: np.ndarray
    time: np.ndarray
    name: np.ndarray
    points: np.ndarray
    at: np.ndarray
    point: np.ndarray
    uv: np.ndarray


@dataclass(frozen=True)
class Simulated:
    """A simulated block: the true sensor, the sensor as calibrated by the maker, and the measurements.

    `shots` come from the navigation; `ground` holds the surveyed coordinates of the 9 control points (`control`) and 12
    check points (`checks`), in `frame`.
    """

    size: float
    true: Sensor
    given: Sensor
    frame: LocalFrame
    image: np.ndarray
    strip: np.ndarray
    shots: Shot
    observations: ImagePoints
    ground: GroundPoints

    @property
    def control(self) -> GroundPoints:
        """Points used as control in the adjustment."""
        return self.ground.of([name for name in self.ground.name.tolist() if name.startswith("C")])

    @property
    def checks(self) -> GroundPoints:
        """Check points, not used in the adjustment."""
        return self.ground.without(self.control.name)

    def block(
        self,
        lens: type[AbstractCorrection] | None = None,
        *,
        sensor: Sensor | None = None,
        control: bool = True,
        loosened: float = 1.0,
        attitude: bool = True,
        observations: ImagePoints | None = None,
    ) -> Block:
        """The block to adjust; optionally with another sensor, and a lens with additional parameters, all zero."""
        sensor = self.given if sensor is None else sensor
        sensor = sensor if lens is None else with_lens(sensor, lens)
        found = Block.from_shots(
            sensor,
            self.image,
            self.shots,
            self.observations if observations is None else observations,
            sigma_position=printed.SIGMA_POSITION,
            sigma_attitude=np.deg2rad(printed.SIGMA_ATTITUDE) if attitude else np.inf,
            control=self.control if control else None,
            frame=self.frame,
            strip=self.strip,
        )
        if loosened == 1.0 or found.navigation is None:
            return found
        return replace(found, navigation=found.navigation.loosened(loosened))


def simulated(size: float = 1000.0, seed: int = 0) -> Simulated:
    """A block over `size` m squared: 6 strips of 19 images for 1 km, and about 1600 images for the paper's 5 km."""
    return measured(flown(size), seed)


def flown(
    size: float,
    *,
    ties: int = TIES,
    lens: BrownConrady | None = LENS,
    ripple: float = RIPPLE,
    one_heading: bool = False,
) -> Flown:
    """A flight over an area, with `ties` tie points per image.

    The true camera has the focal length and principal point of the paper's Brown model, and its boresight; `lens` and
    `ripple` (px) are the distortion left by the maker's calibration. Strips alternate between north and south; with
    `one_heading` the helicopter flies every second strip backwards, its nose to the north. Raises `ValueError` for an
    area smaller than the strip spacing.
    """
    if not spacing()[1] <= size < math.inf:
        raise ValueError(f"the area's size must be {math.ceil(spacing()[1])} m or more, and finite; got {size:g} m.")
    mount = Mount.nadir(R_body_from_base=true_boresight(), lever_body=np.array(LEVER))
    true = Sensor(_camera(printed.INTERIORS["Brown"], lens), mount=mount)
    frame = LocalFrame(Geodetic.from_degrees(lat=ORIGIN[0], lon=ORIGIN[1], height=0.0))
    rng = np.random.default_rng(GEOMETRY)
    place, heading, strip, time = _planned(size)
    heading = np.zeros_like(heading) if one_heading else heading
    place = place + rng.normal(0.0, SWAY, place.shape)
    angles = np.stack([heading, *np.zeros((2, len(heading)))], axis=1)
    angles = angles + np.deg2rad(rng.normal(0.0, [CRAB, TILT, TILT], angles.shape))
    tied, (names, targets) = _ties(place, ties, rng), _targets(size)
    points = np.concatenate([tied, targets])
    seen = _seen(true, frame, _shots(frame, place, angles, time), points, ripple)
    name = np.concatenate([[f"t{k:05d}" for k in range(len(tied))], names])
    return Flown(size, true, frame, place, angles, strip, time, name, points, *seen)


def measured(
    flight: Flown,
    seed: int = 0,
    *,
    sigma_image: float = SIGMA_IMAGE,
    sigma_ground: tuple[float, float, float] = SIGMA_GROUND,
) -> Simulated:
    """A flight with noise, and the camera as calibrated by its maker, without boresight and distortion.

    Standard deviations are those of image points (px) and of surveyed points (east, north, up, m).
    """
    rng, count = np.random.default_rng(seed), len(flight.place)
    place = flight.place + rng.normal(size=(count, 3)) * printed.SIGMA_POSITION
    angles = flight.angles + rng.normal(size=(count, 3)) * np.deg2rad(printed.SIGMA_ATTITUDE)
    uv = flight.uv + rng.normal(0.0, sigma_image, flight.uv.shape)
    is_target = ~np.char.startswith(flight.name, "t")
    targets = flight.points[is_target]
    surveyed = targets + rng.normal(size=targets.shape) * sigma_ground
    image = np.array([f"s{strip + 1:02d}i{k + 1:03d}" for strip, k in _numbered(flight.strip)])
    return Simulated(
        size=flight.size,
        true=flight.true,
        given=Sensor(_camera(printed.CALIBRATED), mount=Mount.nadir(lever_body=np.array(LEVER))),
        frame=flight.frame,
        image=image,
        strip=np.array([f"strip {strip + 1}" for strip in flight.strip]),
        shots=_shots(flight.frame, place, angles, flight.time),
        observations=ImagePoints(image[flight.at], flight.name[flight.point], uv, sigma_image).seen_often(),
        ground=GroundPoints(flight.name[is_target], surveyed, sigma_ground),
    )


def true_boresight() -> np.ndarray:
    """R_body_from_base with the paper's angles.

    The paper states neither their sense of rotation nor their axes. They are taken as roll, pitch and heading of the
    body against the camera, R_base_from_body = Rz(z) Ry(y) Rx(x) with axes forward, right and down. With this choice
    the errors of direct georeferencing are closest to those printed; with the opposite sense, roll and principal point
    add up from strip to strip, to 4 m in height instead of 2.
    """
    roll, pitch, heading = (angle / 60.0 for angle in printed.BORESIGHT)
    return np.asarray(boresight_from_degrees(heading=heading, pitch=pitch, roll=roll)).T


def boresight_of(mount: Mount) -> np.ndarray:
    """Boresight angles about x, y and z as in `true_boresight`, minutes of arc."""
    angles = heading_pitch_roll_from_R(jnp.asarray(np.asarray(mount.R_body_from_base, np.float64).T))
    return 60.0 * np.rad2deg([float(angle) for angle in angles[::-1]])


def height_at(east: np.ndarray, north: np.ndarray) -> np.ndarray:
    """Height of the hilly ground in the frame, m."""
    long = np.sin(2.0 * np.pi * (east / 900.0 + 0.1)) * np.cos(2.0 * np.pi * north / 1100.0)
    return GROUND + RELIEF * (0.7 * long + 0.3 * np.sin(2.0 * np.pi * (east + 2.0 * north) / 700.0))


def with_lens(sensor: Sensor, lens: type[AbstractCorrection]) -> Sensor:
    """The sensor with a lens whose additional parameters are zero."""
    camera = sensor.camera
    assert isinstance(camera, FrameCamera)
    zero = lens.for_image(focal_px=camera.focal_px, width=camera.width, height=camera.height)
    return eqx.tree_at(lambda s: s.camera.distortion, sensor, zero)


def interior_of(camera: AbstractCamera) -> Interior:
    """Focal length and principal point in mm, y up."""
    assert isinstance(camera, FrameCamera)
    middle = np.array([printed.COLUMNS - 1, printed.ROWS - 1]) / 2.0
    right, down = (np.asarray(camera.principal_px) - middle) * printed.PIXEL_PITCH
    return Interior(float(np.asarray(camera.focal_px)[0]) * printed.PIXEL_PITCH, float(right), float(-down))


def spacing() -> tuple[float, float]:
    """Spacing in m of images along a strip, and of strips."""
    scale = printed.HEIGHT * printed.PIXEL_PITCH / printed.INTERIORS["Brown"].f
    return (1.0 - printed.ALONG) * printed.ROWS * scale, (1.0 - printed.ACROSS) * printed.COLUMNS * scale


def _camera(interior: Interior, lens: BrownConrady | None = None) -> FrameCamera:
    """The camera; printed principal points have y up, cameras here have y down, along the rows."""
    f, xp, yp = (1e-3 * length for length in interior)
    return FrameCamera.from_metric(
        focal_length=f,
        pixel_pitch=1e-3 * printed.PIXEL_PITCH,
        width=printed.COLUMNS,
        height=printed.ROWS,
        principal_point=(xp, -yp),
        distortion=lens,
    )


def _planned(size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(positions, headings, strip numbers, times) as planned, alternating north and south, part of a larger area."""
    along, across = spacing()
    strips, images = math.ceil(size / across) + 1, math.ceil(size / along) + 5
    strip, step = (x.ravel() for x in np.meshgrid(np.arange(strips), np.arange(images), indexing="ij"))
    east, north = (strip - (strips - 1) / 2.0) * across, (step - (images - 1) / 2.0) * along
    back = strip % 2 == 1
    place = np.stack([east, np.where(back, -north, north), np.full(len(east), GROUND + printed.HEIGHT)], axis=1)
    time = (strip * (images + 20) + step) * along / SPEED
    return place, np.where(back, np.pi, 0.0), strip, time


def _shots(frame: LocalFrame, place: np.ndarray, angles: np.ndarray, time: np.ndarray) -> Shot:
    heading, pitch, roll = (jnp.asarray(angle) for angle in angles.T)
    pose = Pose(frame.to_geodetic(place), heading, pitch, roll)
    return Shot(pose, jnp.zeros((len(place), 0)), jnp.asarray(time))


def _ties(place: np.ndarray, ties: int, rng: np.random.Generator) -> np.ndarray:
    """Tie points on a jittered grid, `ties` per image."""
    along, across = spacing()
    step = math.sqrt(along * across / ((1.0 - printed.ALONG) * (1.0 - printed.ACROSS) * ties))
    low, high = place[:, :2].min(axis=0) - across, place[:, :2].max(axis=0) + across
    axes = [np.arange(a, b, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack([x.ravel() for x in np.meshgrid(*axes, indexing="ij")], axis=1)
    grid = grid + rng.uniform(-0.45, 0.45, grid.shape) * step
    return np.column_stack([grid, height_at(*grid.T)])


def _targets(size: float) -> tuple[np.ndarray, np.ndarray]:
    """(names, positions): control on a 3 x 3 grid (C), check points halfway between neighbours (K)."""
    marks = [(i, j) for i in range(-2, 3) for j in range(-2, 3)]
    control = [(i, j) for i, j in marks if i % 2 == 0 and j % 2 == 0]
    checks = [(i, j) for i, j in marks if (i + j) % 2 == 1]
    name = [f"C{k + 1}" for k in range(len(control))] + [f"K{k + 1}" for k in range(len(checks))]
    plan = 0.5 * REACH * size * np.array(control + checks, float)
    return np.array(name), np.column_stack([plan, height_at(*plan.T)])


def _seen(
    true: Sensor, frame: LocalFrame, shots: Shot, points: np.ndarray, ripple: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(image, point, pixel without noise) of all points inside an image."""
    centre, R = sights_of(frame, true, shots)
    at, point, uv = [], [], []
    few = min(len(points), 40 * TIES)  # same count for every image, so that one compiled program is enough
    for i in range(len(centre)):
        near = np.sort(np.argsort(np.sum((points - centre[i])[:, :2] ** 2, axis=1))[:few])
        pixels, _ = (np.asarray(x) for x in _projected(true.camera, jnp.asarray((points[near] - centre[i]) @ R[i])))
        pixels = pixels + ripple * np.sin(2.0 * np.pi * WAVES * pixels / [printed.COLUMNS, printed.ROWS])
        inside = np.flatnonzero(np.all((pixels >= 0.0) & (pixels <= [printed.COLUMNS - 1, printed.ROWS - 1]), axis=1))
        at.append(np.full(len(inside), i))
        point.append(near[inside])
        uv.append(pixels[inside])
    return np.concatenate(at), np.concatenate(point), np.concatenate(uv)


@eqx.filter_jit
def _projected(camera: AbstractCamera, p_camera: jax.Array) -> tuple[jax.Array, jax.Array]:
    return jax.vmap(camera.project)(p_camera)


def _numbered(strip: np.ndarray) -> list[tuple[int, int]]:
    """(strip, number in the strip) of each image."""
    first = {s: int(np.argmax(strip == s)) for s in np.unique(strip).tolist()}
    return [(s, i - first[s]) for i, s in enumerate(strip.tolist())]
