"""Three real blocks ready for adjustment, from the folder of real data, with conventions verified by test."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pyproj
import scipy.sparse.csgraph
from scipy.spatial.transform import Rotation

from jaxgeo.adjust import (
    Block,
    Cartesian,
    Free,
    GroundPoints,
    ImagePoints,
    Images,
    LocalFrame,
    Unknowns,
    resect_block,
)
from jaxgeo.earth import Geodetic
from jaxgeo.io import read_bal, read_orientations
from jaxgeo.io.scene import ellipsoidal_heights
from jaxgeo.sensor import BrownConrady, FrameCamera, Gimbal, Mount, Pose, Sensor, Shot

Folder = str | pathlib.Path
ORIENTATIONS = "23FD1305_alt_2.OPK"
CAMERA_FROM_IMAGE = np.diag([1.0, -1.0, -1.0])  # from right, up, out of the scene


@dataclass(frozen=True)
class RealBlock:
    """A block, the unknowns of its cameras, the classes of its measurements, and its check points."""

    block: Block
    unknowns: Unknowns
    classes: dict[str, np.ndarray]
    checks: GroundPoints | None = None


def strasbourg(folder: Folder) -> RealBlock:
    """Five frames over Strasbourg, on 14 control points; points 351 and 410 are check points.

    Marked points at 0.5 px and matched ones at 1 px, control with its own sigmas, camera known.
    """
    root = pathlib.Path(folder) / "dbat_sxb"
    parts = [_measured(root / f"measurements/{name}.txt", s) for name, s in (("markpts", 0.5), ("smartpts", 1.0))]
    seen = ImagePoints.joined(parts)
    rows = _rows(root / "reference/sxb-control.txt")
    numbers = np.array([[float(x) for x in row[2:8]] for row in rows])
    known = GroundPoints([row[0] for row in rows], numbers[:, :3], numbers[:, 3:])
    checks = ["351", "410"]
    pitch = 0.006  # mm
    principal = (26.577 / pitch, 38.811 / pitch)
    camera = FrameCamera.from_pixels(focal_px=123.9392 / pitch, principal_px=principal, width=8858, height=12996)
    cameras, control = {"camera": camera}, known.without(checks)
    images = resect_block(cameras, {row[0]: "camera" for row in _rows(root / "images/images.txt")}, seen, control)
    is_marked = np.arange(len(seen)) < len(parts[0])
    block = Block(Cartesian(), cameras, images, seen, control)
    return RealBlock(block, Unknowns(), {"marked": is_marked, "automatic": ~is_marked}, known.of(checks))


def large(folder: Folder) -> RealBlock:
    """16 photographs with 22 106 points, each with its own focal length and two coefficients, no known values."""
    problem = read_bal(pathlib.Path(folder) / "bal" / "problem-16-22106-pre.txt.bz2")
    R_camera_from_frame = CAMERA_FROM_IMAGE @ Rotation.from_rotvec(problem.rotation).as_matrix()
    R = np.swapaxes(R_camera_from_frame, 1, 2)
    centre = -np.einsum("nij,nj->ni", R, problem.translation @ CAMERA_FROM_IMAGE)
    count = len(centre)
    image, camera, point = (
        np.char.add(f"{what} ", np.arange(n).astype(str))
        for what, n in (("image", count), ("of image", count), ("point", len(problem.points)))
    )
    lenses = zip(problem.focal_px, problem.k1, problem.k2, strict=True)
    size = 2 * int(np.ceil(np.max(np.abs(problem.uv))))
    cameras = {
        name: FrameCamera.from_pixels(
            focal_px=f, width=size, height=size, principal_px=(0.0, 0.0), distortion=BrownConrady(k1=k1, k2=k2)
        )
        for name, (f, k1, k2) in zip(camera.tolist(), lenses, strict=True)
    }
    seen = ImagePoints(image[problem.image_index], point[problem.point_index], problem.uv * (1.0, -1.0), 1.0)
    starts = GroundPoints(point, problem.points)
    block = Block(Cartesian(), cameras, Images(image, camera, centre, R), seen, points=starts)
    unknowns = Unknowns(focal=Free(), distortion={"k1": Free(), "k2": Free()})
    return RealBlock(block, unknowns, {"all": np.ones(len(seen), bool)})


# The block of IGN.


@dataclass(frozen=True)
class Aerial:
    """68 frames of an UltraCam Eagle with their given orientations, tie points, and the given positions of these.

    `seen` are measurements of points in at least two images, out of `read` in total; `given` the orientations and
    `ground` the points in the `frame`; `poses` the same orientations in the form of a navigation.
    """

    frame: LocalFrame
    sensor: Sensor
    poses: Pose
    given: Images
    seen: ImagePoints
    ground: GroundPoints
    read: ImagePoints

    def with_navigation(self, sigma_position: float, sigma_attitude: float, seed: int | None = 0) -> Block:
        """The block with these orientations as navigation, disturbed by its sigmas (m, rad) unless `seed` is None."""
        poses = self.poses if seed is None else disturbed(self.frame, self.poses, sigma_position, sigma_attitude, seed)
        return Block.from_shots(
            self.sensor,
            self.given.name,
            _shots(poses),
            self.seen,
            sigma_position=sigma_position,
            sigma_attitude=sigma_attitude,
            frame=self.frame,
        )

    def held(self, sigma_position: float, sigma_attitude: float) -> Block:
        """The block held by a navigation equal to `given`, even where that differs from `poses`."""
        block = self.with_navigation(sigma_position, sigma_attitude, seed=None)
        assert block.navigation is not None  # it comes from shots
        turn = np.swapaxes(block.images.R_frame_from_camera, 1, 2) @ block.navigation.R_frame_from_body
        R = self.given.R_frame_from_camera @ turn
        told = replace(block.navigation, position=self.given.centre, R_frame_from_body=R, R_frame_from_reference=R)
        return replace(block, images=self.given, navigation=told)

    def off(self) -> np.ndarray:
        """Pixels (k, 2) of the ground points by the given orientations, minus those measured."""
        row = {name: i for i, name in enumerate(self.given.name.tolist())}
        place = dict(zip(self.ground.name.tolist(), self.ground.place, strict=True))
        image = np.array([row[name] for name in self.seen.image.tolist()])
        ray = np.array([place[name] for name in self.seen.point.tolist()]) - self.given.centre[image]
        x, y, z = np.einsum("kij,ki->jk", self.given.R_frame_from_camera[image], ray)
        camera = eagle()
        return (
            np.asarray(camera.principal_px) + np.asarray(camera.focal_px) * np.stack([x / z, y / z], 1) - self.seen.uv
        )

    def parts(self, least: int = 4) -> list[Aerial]:
        """The parts not connected by ties, each a free network, largest first; images that see fewer than `least`
        points are left out, because their orientation would be undetermined."""
        names, counts = np.unique(self.seen.image, return_counts=True)
        seen = self.seen.of(np.isin(self.seen.image, names[counts >= least])).seen_often()
        names, image = np.unique(seen.image, return_inverse=True)
        _, point = np.unique(seen.point, return_inverse=True)
        sees = scipy.sparse.coo_matrix((np.ones(len(image)), (image, point))).tocsr()
        count, part = scipy.sparse.csgraph.connected_components(sees @ sees.T)
        sizes = np.bincount(part)
        return [self._of(names[part == k], seen) for k in np.argsort(-sizes)[:count]]

    def _of(self, names: np.ndarray, seen: ImagePoints) -> Aerial:
        seen, rows = seen.of(np.isin(seen.image, names)), np.isin(self.given.name, names)
        fields = ("name", "camera", "centre", "R_frame_from_camera")
        given = Images(*(getattr(self.given, field)[rows] for field in fields))
        ground = self.ground.of(np.unique(seen.point))
        return replace(self, poses=jax.tree.map(lambda x: x[rows], self.poses), given=given, seen=seen, ground=ground)

    def free_network(self, seed: int = 0) -> Block:
        """The block with ties only, from orientations that are disturbed by 1 m and 0.05 deg."""
        block = self.with_navigation(1.0, float(np.deg2rad(0.05)), seed)
        return replace(block, navigation=None, points=self.ground)


def aerial(folder: Folder, *, ground_altitude: float | None = 3.0, sigma_px: float = 0.2) -> Aerial:
    """The block of IGN on the Earth: EPSG:2154 with its grid convergence, heights through RAF20.

    `ground_altitude` in m is the reference of the linear alteration of camera heights, which is removed; None keeps it.
    """
    root = pathlib.Path(folder) / "ign_block"
    geoid = pathlib.Path(folder) / "geoid" / "fr_ign_RAF20.tif"
    read = _ties(root, sigma_px)
    orientations = read_orientations(
        root / ORIENTATIONS,
        height_datum=str(geoid),
        crs="EPSG:2154",
        linear_alteration_above=ground_altitude,
    )
    orientations = orientations.of(np.isin(orientations.names, read.image))
    names, x, y, height = _ground(root)
    lon, lat = pyproj.Transformer.from_crs(2154, 4326, always_xy=True).transform(x, y)
    position = Geodetic.from_degrees(lat=lat, lon=lon, height=height)
    middle = jax.tree.map(np.mean, position)
    frame = LocalFrame(Geodetic(lat=middle.lat, lon=middle.lon, height=np.float64(0.0)))
    sensor = Sensor(eagle(), Gimbal.fixed(), Mount.nadir())
    seen = read.seen_often()
    R = np.asarray(frame.R_ecef_from_local).T
    sights = jax.vmap(sensor.sight)(jax.tree.map(jnp.asarray, _shots(orientations.pose)))
    centre, R = np.asarray(frame.from_ecef(sights.centre)), R @ np.asarray(sights.R_ecef_from_camera)
    given = Images(orientations.names, np.full(len(centre), "camera"), centre, R)
    ground = GroundPoints.from_geodetic(frame, names, position)
    return Aerial(frame, sensor, orientations.pose, given, seen, ground, read)


def in_map(folder: Folder, block: Aerial) -> Aerial:
    """The same as if its map were Cartesian: no curvature, no scale; camera heights are converted to ellipsoidal
    ones, like those of the points, by one undulation."""
    names, numbers = _opk(folder)
    rows = np.isin(names, block.given.name)
    R = Rotation.from_euler("XYZ", numbers[rows, 3:], degrees=True).as_matrix() @ CAMERA_FROM_IMAGE
    known, x, y, height = _ground(pathlib.Path(folder) / "ign_block")
    lon, lat = pyproj.Transformer.from_crs(2154, 4326, always_xy=True).transform([x.mean()], [y.mean()])
    geoid = pathlib.Path(folder) / "geoid" / "fr_ign_RAF20.tif"
    undulation = float(ellipsoidal_heights(np.array(lon), np.array(lat), np.zeros(1), str(geoid))[0])
    middle = np.array([x.mean(), y.mean(), 0.0])
    centre = numbers[rows, :3] + [0.0, 0.0, undulation] - middle
    given = Images(names[rows], np.full(len(centre), "camera"), centre, R)
    return replace(block, given=given, ground=GroundPoints(known, np.stack([x, y, height], axis=1) - middle))


def without_convergence(folder: Folder, block: Aerial) -> Aerial:
    """The same as if the north of the map's grid were true north."""
    names, numbers = _opk(folder)
    rows = np.isin(names, block.given.name)
    angles = np.deg2rad(numbers[rows, 3:]).T
    poses = jax.vmap(Pose.from_omega_phi_kappa)(
        jax.tree.map(jnp.asarray, block.poses.position), *map(jnp.asarray, angles)
    )
    other = replace(block, poses=jax.tree.map(np.asarray, poses))
    return replace(other, given=other.with_navigation(1.0, 1.0, seed=None).images)


def eagle() -> FrameCamera:
    """UltraCam Eagle Mark 3 with 120 mm, as in the block's own file; free of distortion."""
    return FrameCamera.from_pixels(focal_px=30975.0, width=26460, height=17004, principal_px=(13210.0, 8502.0))


def disturbed(frame: LocalFrame, poses: Pose, metres: float, angle: float, seed: int) -> Pose:
    """Poses with random errors, with these sigmas in m and rad on every axis and angle."""
    rng = np.random.default_rng(seed)
    place = np.asarray(frame.from_geodetic(poses.position))
    position = frame.to_geodetic(place + rng.normal(0.0, metres, place.shape))
    turns = rng.normal(0.0, angle, (3, len(place)))
    angles = [np.asarray(x) + d for x, d in zip((poses.heading, poses.pitch, poses.roll), turns, strict=True)]
    return Pose(position, *angles)


def _shots(poses: Pose) -> Shot:
    count = np.shape(poses.heading)[0]
    return Shot(poses, np.zeros((count, 0)), np.zeros(count))


def _ties(root: pathlib.Path, sigma_px: float) -> ImagePoints:
    rows = [line.split() for line in (root / "all_liaisons2.mes").read_text().splitlines() if line.strip()]
    uv = np.array([[float(x) for x in row[2:4]] for row in rows])
    return ImagePoints([row[1] for row in rows], [row[0] for row in rows], uv, sigma_px)


def _ground(root: pathlib.Path) -> tuple[list[str], np.ndarray, np.ndarray, np.ndarray]:
    rows = [line.split() for line in (root / "all_liaisons2_world.mes").read_text().splitlines() if line.strip()]
    x, y, height = np.array([[float(value) for value in row[1:4]] for row in rows]).T
    return [row[0] for row in rows], x, y, height


def _opk(folder: Folder) -> tuple[np.ndarray, np.ndarray]:
    """Names and X, Y, Z, omega, phi, kappa of the file's orientations, m and deg."""
    lines = (pathlib.Path(folder) / "ign_block" / ORIENTATIONS).read_text().splitlines()[1:]
    rows = [line.split() for line in lines if line.strip()]
    return np.array([row[0] for row in rows]), np.array([[float(x) for x in row[1:7]] for row in rows])


def _measured(path: pathlib.Path, sigma: float) -> ImagePoints:
    rows = _rows(path)
    uv = np.array([[float(x) for x in row[2:4]] for row in rows])
    return ImagePoints([row[1] for row in rows], [row[0] for row in rows], uv, sigma)


def _rows(path: pathlib.Path) -> list[list[str]]:
    """The comma-separated words of every line except comments."""
    lines = [line for line in path.read_text().splitlines() if line.strip() and not line.startswith("#")]
    return [[word.strip() for word in line.split(",")] for line in lines]
