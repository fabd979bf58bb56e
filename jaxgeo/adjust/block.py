"""Block of images: cameras, image measurements, control and navigation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import jax
import numpy as np

from jaxgeo._checks import check_is, require_x64
from jaxgeo.adjust.frame import Cartesian, LocalFrame
from jaxgeo.adjust.ground_points import GroundPoints
from jaxgeo.adjust.navigation import Navigation, joined, navigation_of, sights_of
from jaxgeo.adjust.readout import checked_readout, has_readout, known_motion
from jaxgeo.adjust.records import ImagePoints, Names, as_names
from jaxgeo.earth import WGS84, Atmosphere, Geodetic
from jaxgeo.earth.geodetic import check_position
from jaxgeo.sensor import FrameCamera, Sensor, Shot, Trajectory


@dataclass(frozen=True)
class Images:
    """n images: names, camera names and approximate exterior orientations in the block's frame.

    `centre` (n, 3) are perspective centres in m, `R_frame_from_camera` (n, 3, 3) orientations of the camera (right,
    down, forward). Raises `ValueError` for duplicate names, positions that are not finite and invalid rotations.
    """

    name: Names
    camera: Names
    centre: np.ndarray
    R_frame_from_camera: np.ndarray

    def __post_init__(self) -> None:
        name, camera = as_names(self.name, "names of images"), as_names(self.camera, "names of cameras")
        centre, R = np.asarray(self.centre, np.float64), np.asarray(self.R_frame_from_camera, np.float64)
        n = len(name)
        if (len(camera), centre.shape, R.shape) != (n, (n, 3), (n, 3, 3)):
            raise ValueError(
                f"of {n} images, camera must have {n} entries, centre the shape ({n}, 3) and R_frame_from_camera "
                f"({n}, 3, 3); got {len(camera)}, {centre.shape} and {R.shape}."
            )
        found, counts = np.unique(name, return_counts=True)
        if np.any(counts > 1):
            raise ValueError(f"image {found[np.argmax(counts)]} is there {counts.max()} times; names must be unique.")
        whole = np.all(np.isfinite(centre), axis=1) & np.all(np.isfinite(R), axis=(1, 2))
        off = np.abs(np.nan_to_num(R) @ np.swapaxes(np.nan_to_num(R), 1, 2) - np.eye(3)).max(axis=(1, 2), initial=0.0)
        turned = whole & (off < 1e-6) & (np.linalg.det(np.nan_to_num(R)) > 0.0)
        if not np.all(turned):
            i = int(np.argmax(~turned))
            what = "R_frame_from_camera must be a rotation" if whole[i] else "centre and rotation must be finite"
            raise ValueError(f"image {name[i]}: {what}; got centre {centre[i].tolist()}, rotation {R[i].tolist()}.")
        for what, value in (("name", name), ("camera", camera), ("centre", centre), ("R_frame_from_camera", R)):
            object.__setattr__(self, what, value)

    def rows_of(self, names: np.ndarray) -> np.ndarray:
        """Index (k,) of each of these names (k,) among the images."""
        by_name = np.argsort(self.name)
        return by_name[np.searchsorted(self.name, names, sorter=by_name)]

    def __len__(self) -> int:
        return len(self.name)


@dataclass(frozen=True)
class Block:
    """Inputs of an adjustment.

    `cameras` by name, all with the same kind of lens; `images`; `observations`, the measured image points; `control`,
    ground points known beforehand; `navigation`, observed positions and attitudes of the images; `points`, start
    positions of some points (others start where their rays intersect). All positions are in `frame`, in m.

    `readout` is the readout time of rolling-shutter cameras in s, a number for all or a mapping from their names, as of
    `RollingShutterCamera.from_readout`: from the first row of an image to that of the next, negative from the bottom
    up. Orientations are then those of the middle row, half a readout after the first, and so is the navigation. With an
    `atmosphere`, rays are refracted.

    Raises `ValueError` with the name of an unknown image or camera or of a point with a single measurement and no
    control, for a block without points, for a readout without velocities and turn rates in the navigation, and for an
    atmosphere in a frame that is not on the Earth.
    """

    frame: LocalFrame | Cartesian
    cameras: Mapping[str, FrameCamera]
    images: Images
    observations: ImagePoints
    control: GroundPoints | None = None
    navigation: Navigation | None = None
    points: GroundPoints | None = None
    readout: Any = field(default_factory=dict)
    atmosphere: Atmosphere | None = None

    def __post_init__(self) -> None:
        require_x64()
        if not isinstance(self.frame, LocalFrame | Cartesian):
            raise TypeError(f"frame must be LocalFrame(origin), or Cartesian() off the Earth; got {self.frame!r}.")
        self._check_cameras()
        self._check_images()
        self._check_points()
        self._check_effects()

    @classmethod
    def from_shots(
        cls,
        sensor: Sensor,
        image: Any,
        shots: Shot,
        observations: ImagePoints,
        *,
        sigma_position: Any,
        sigma_attitude: Any,
        control: GroundPoints | None = None,
        frame: LocalFrame | None = None,
        camera: str = "camera",
        strip: Any = None,
        velocity: Any = None,
        turn_rate: Any = None,
        trajectory: Trajectory | None = None,
        readout: float = 0.0,
        atmosphere: Atmosphere | None = None,
    ) -> Block:
        """A block of n images of one sensor, from their shots (a `Shot` whose fields have a leading axis).

        The shots are both navigation observations with `sigma_position` (east, north, up, m) and `sigma_attitude`
        (heading, pitch, roll, rad; numbers, (3,), (n, 3) or covariances (n, 3, 3), infinite if unknown), and start
        values. `strip` names the strip of each image for shift, drift and time offset. The default `frame` is that at
        the centre of the images.

        `velocity` and `turn_rate` (n, 3) of the images are those of `Navigation`. Those not given are of the
        `trajectory` at the times of the shots, or else by differences between neighbouring images of a strip over their
        times, which takes motion between them as even (`motion_by_differences`). `readout` in s and `atmosphere` are
        those of `Block`. Raises as `Block`, `Images` and `navigation_of`.
        """
        name = as_names(image, "image")
        check_is(sensor.camera, FrameCamera, "sensor.camera", "Blocks are of frame cameras.")
        frame = frame_at(shots.pose.position) if frame is None else frame
        centre, R = sights_of(frame, sensor, shots)
        images = Images(name, np.full(len(name), camera), centre, R)
        strip = np.full(len(name), "strip") if strip is None else strip
        moving = {"velocity": velocity, "turn_rate": turn_rate, "trajectory": trajectory}
        navigation = navigation_of(frame, sensor, shots, sigma_position, sigma_attitude, camera, strip, **moving)
        assert isinstance(sensor.camera, FrameCamera)
        effects = {"readout": {camera: readout} if readout != 0.0 else {}, "atmosphere": atmosphere}
        return cls(frame, {camera: sensor.camera}, images, observations, control, navigation, **effects)

    def with_block(self, other: Block) -> Block:
        """Merge two blocks: more cameras, flights or observations over the same ground, in this block's frame.

        Raises `ValueError` for different frames and atmospheres, for cameras, readouts, mounts and control points of
        one name with different values, and as `Block`.
        """
        if not _same(self.frame, other.frame):
            raise ValueError("blocks are joined in one frame; make the other with frame=block.frame.")
        if not _same(self.atmosphere, other.atmosphere):
            raise ValueError("blocks are joined in one atmosphere; make the other with atmosphere=block.atmosphere.")
        _refuse_others("camera", self.cameras, other.cameras)
        _refuse_others("readout of camera", *(dict.fromkeys(b.cameras, 0.0) | b.readout for b in (self, other)))
        mine, theirs = self.images, other.images
        fields = ("name", "camera", "centre", "R_frame_from_camera")
        images = Images(*(np.concatenate([getattr(mine, f), getattr(theirs, f)]) for f in fields))
        navigation = [part for part in (self.navigation, other.navigation) if part is not None]
        if len(navigation) == 1:
            raise ValueError("one of the blocks has navigation and the other has none; give both, or none.")
        if len(navigation) == 2:
            _refuse_others("mount", *(part.mounts for part in navigation))
        return replace(
            self,
            cameras={**self.cameras, **other.cameras},
            images=images,
            observations=ImagePoints.joined([self.observations, other.observations]),
            control=_with_points(self.control, other.control, "control"),
            points=_with_points(self.points, other.points, "points"),
            navigation=joined(navigation) if navigation else None,
            readout={**self.readout, **other.readout},
        )

    def of(self, rows: np.ndarray) -> Block:
        """The block with a subset of its measurements, by flag or index. Raises as `Block`."""
        return replace(self, observations=self.observations.of(rows))

    def kept(self, rows: np.ndarray) -> np.ndarray:
        """Flags of those among the given measurements whose points still have two rays or are control."""
        observations = self.observations
        _, point = np.unique(observations.point, return_inverse=True)
        often = np.bincount(point, weights=rows, minlength=point.max() + 1)[point] >= 2
        control = np.zeros(len(rows), bool) if self.control is None else np.isin(observations.point, self.control.name)
        return rows & (often | control)

    def parts(self) -> list[np.ndarray]:
        """Image names of each part of the block, where parts share no points, the largest first."""
        import scipy  # submodules load lazily

        images, image = np.unique(self.observations.image, return_inverse=True)
        points, point = np.unique(self.observations.point, return_inverse=True)
        incidence = scipy.sparse.coo_array((np.ones(len(image)), (image, point)), shape=(len(images), len(points)))
        count, part = scipy.sparse.csgraph.connected_components((incidence @ incidence.T).tocsr(), directed=False)
        return sorted((images[part == k] for k in range(count)), key=len, reverse=True)

    def _check_cameras(self) -> None:
        for name, camera in self.cameras.items():
            check_is(camera, FrameCamera, f"camera {name}", "Blocks are of frame cameras.")
        kinds = {type(camera.distortion) for camera in self.cameras.values()}
        if len(kinds) > 1:
            names = ", ".join(sorted(kind.__name__ for kind in kinds))
            raise ValueError(f"all cameras of a block must have the same kind of lens; got {names}.")
        missing = sorted(set(self.images.camera.tolist()) - set(self.cameras))
        if missing:
            image = self.images.name[int(np.argmax(self.images.camera == missing[0]))]
            raise ValueError(
                f"image {image} is of camera {missing[0]}, which there is not; known are {', '.join(self.cameras)}."
            )

    def _check_images(self) -> None:
        known = np.isin(self.observations.image, self.images.name)
        if not np.all(known):
            row = int(np.argmax(~known))
            raise ValueError(
                f"measurement {row}, point {self.observations.point[row]}: there is no image "
                f"{self.observations.image[row]} in the block ({int(np.sum(~known))} such measurements)."
            )
        seeing = np.isin(self.images.name, self.observations.image)
        if not np.all(seeing):
            name = self.images.name[int(np.argmax(~seeing))]
            raise ValueError(f"nothing is measured in image {name} ({int(np.sum(~seeing))} such images); leave it out.")
        if self.navigation is not None and len(self.navigation.position) != len(self.images):
            raise ValueError(
                f"the navigation must have an entry for each of {len(self.images)} images; got "
                f"{len(self.navigation.position)}."
            )

    def _check_effects(self) -> None:
        object.__setattr__(self, "readout", checked_readout(self.readout, self.cameras))
        if has_readout(self):
            moving = np.array([self.readout.get(name, 0.0) != 0.0 for name in self.images.camera.tolist()])
            known_motion(self, moving, "Block.readout")
        if self.atmosphere is not None:
            check_is(self.atmosphere, Atmosphere, "atmosphere")
            if not isinstance(self.frame, LocalFrame):
                raise ValueError(
                    "atmosphere= takes a block in a LocalFrame: a Cartesian frame has no height above the ground."
                )

    def _check_points(self) -> None:
        if not len(self.observations):
            raise ValueError("nothing is measured: observations are empty.")
        name, counts = np.unique(self.observations.point, return_counts=True)
        once = name[counts < 2]
        if self.control is not None:
            once = once[~np.isin(once, self.control.name)]
        if once.size:
            row = int(np.argmax(self.observations.point == once[0]))
            raise ValueError(
                f"point {once[0]} is seen once only, in image {self.observations.image[row]}, and is no control "
                f"({once.size} such points); leave such points out: observations.seen_often()."
            )


def frame_at(position: Geodetic) -> LocalFrame:
    """East-north-up frame at the centre of a batch of positions, on the ellipsoid."""
    check_position(position, "position")
    ecef = np.asarray(
        jax.vmap(WGS84.to_ecef)(jax.tree.map(lambda x: np.atleast_1d(np.asarray(x, np.float64)), position))
    )
    middle = WGS84.to_geodetic(jax.numpy.asarray(ecef.mean(axis=0)))
    return LocalFrame(Geodetic(lat=middle.lat, lon=middle.lon, height=np.float64(0.0)))


def _with_points(a: GroundPoints | None, b: GroundPoints | None, what: str) -> GroundPoints | None:
    """Both sets of points merged. Raises `ValueError` for a point that is in both with different positions."""
    if a is None or b is None:
        return b if a is None else a
    both = [name for name in b.name.tolist() if name in set(a.name.tolist())]
    apart = np.any(a.of(both).place != b.of(both).place, axis=1) if both else np.zeros(0, bool)
    if np.any(apart):
        name = both[int(np.argmax(apart))]
        raise ValueError(
            f"{what}: point {name} is at {a.of([name]).place[0].tolist()} in one block and at "
            f"{b.of([name]).place[0].tolist()} in the other; keep one of them."
        )
    new = b.without(both)
    joined_ = {f: np.concatenate([getattr(a, f), getattr(new, f)]) for f in ("name", "place", "sigma")}
    if a.covariance is None and new.covariance is None:
        return GroundPoints(**joined_)
    if not np.all(np.isfinite(joined_["sigma"]) & (joined_["sigma"] > 0.0)):
        raise ValueError(
            f"{what}: one block gives covariances, the other sigmas that are zero or infinite; give one kind."
        )
    parts = [np.eye(3) * x.sigma[:, None, :] ** 2 if x.covariance is None else x.covariance for x in (a, new)]
    return GroundPoints(**joined_, covariance=np.concatenate(parts))


def _refuse_others(what: str, mine: Mapping[str, Any], theirs: Mapping[str, Any]) -> None:
    for name in mine.keys() & theirs.keys():
        if not _same(mine[name], theirs[name]):
            raise ValueError(
                f"{what} {name} is not the same in both blocks; name one of them otherwise: from_shots(camera=...)."
            )


def _same(a: Any, b: Any) -> bool:
    mine, theirs = jax.tree.leaves(a), jax.tree.leaves(b)
    if type(a) is not type(b) or jax.tree.structure(a) != jax.tree.structure(b):
        return False
    return all(bool(np.array_equal(x, y)) for x, y in zip(mine, theirs, strict=True))
