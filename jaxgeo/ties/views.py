"""Views: images with their navigation, its covariance, and the projection of ground points into them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxgeo._checks import as_float64, check_is, require_x64
from jaxgeo._compile import quick_filter_jit
from jaxgeo._typing import Matrix3, Vector3
from jaxgeo.adjust import Images, LocalFrame
from jaxgeo.adjust.block import frame_at
from jaxgeo.adjust.motion import checked_motion
from jaxgeo.adjust.readout import checked_readout
from jaxgeo.adjust.records import Names, as_names
from jaxgeo.earth import Atmosphere, Geodetic
from jaxgeo.observation import Exposure
from jaxgeo.sensor import FrameCamera, Shot
from jaxgeo.status import Status
from jaxgeo.terrain import AbstractTerrain, ConstantHeight
from jaxgeo.ties.cameras import cameras_of, mounts_of, named_cameras
from jaxgeo.ties.motion import motion_of
from jaxgeo.ties.rigs import Rigs, check_cameras, check_together, shots_of
from jaxgeo.ties.shared import OfImage, split
from jaxgeo.uncertainty import ErrorModel, sources
from jaxgeo.uncertainty.model_inputs import ModelInputs

# Sources that move the perspective centre or turn the camera of one image.
OF_POSES = (
    sources.Attitude,
    sources.Boresight,
    sources.CameraMounting,
    sources.Correlated,
    sources.GimbalAngles,
    sources.GimbalMounting,
    sources.LeverArm,
    sources.Position,
)
CHUNK = 256  # points per call: one size, so that other counts need no compilation


@dataclass(frozen=True)
class Views:
    """n images of frame cameras with their navigation and its covariance.

    `name` (n,) are unique names, `exposure` n exposures with a `Shot` each, `camera` (n,) the names of their `cameras`.
    `frame` is an east-north-up frame at the centre of the images; in it, in m, `centre` (n, 3) are the perspective
    centres and `R_frame_from_camera` (n, 3, 3) the orientations (camera right, down, forward). `covariance` (n, 6, 6)
    is that of their navigation errors: centre in m (frame axes), rotation in rad about the camera's axes. It is the sum
    of `own` (n, 6, 6), of errors that are independent between images, and of the products of `common` (n, 6), by name:
    one standard deviation of each error that images share, such as a boresight. `shot` (n,) are numbers of exposures,
    None if each image is one of its own.
    """

    name: Names
    exposure: tuple[Exposure, ...]
    camera: Names
    cameras: dict[str, FrameCamera]
    frame: LocalFrame
    centre: np.ndarray
    R_frame_from_camera: np.ndarray
    covariance: np.ndarray
    own: np.ndarray
    common: dict[str, np.ndarray]
    shot: np.ndarray | None = None
    velocity: np.ndarray | None = None
    """Velocities (n, 3) of the perspective centres at the exposures, m/s in frame axes, NaN where unknown; see
    `moving`."""
    turn_rate: np.ndarray | None = None
    """Turn rates (n, 3) of the cameras, rad/s about their axes."""
    readout: Mapping[str, float] = field(default_factory=dict)
    """Readout times of rolling-shutter cameras in s, by their names."""
    atmosphere: Atmosphere | None = None
    """The air that rays are refracted in, in an adjustment."""

    def __len__(self) -> int:
        return len(self.name)

    @classmethod
    def of(
        cls,
        name: Any,
        exposures: Sequence[Exposure],
        errors: Sequence[Any],
        flight: Any = None,
        *,
        shot: Any = None,
        camera: Any = None,
    ) -> Views:
        """Views from exposures and their error sources: a model, or a tuple of sources, for each image.

        Only errors of position, attitude, gimbal and mounting count, each shared between images as its `sharing` says
        (`PerImage`, `PerFlight`, `TimeCorrelated` by the times of the shots, ...). `flight` (n,) are numbers of their
        flights, by default one. Images with equal cameras share one, named "1", "2" and so on; or `camera` (n,) names
        the camera of each.

        `shot` (n,) are numbers of exposures: images of one shot are of several cameras on one mount at one instant.
        They share all errors but those of the mounting, one number for each axis and shot, so that their relative
        orientation is known up to these; the mount moves as one rigid body, by the errors that its first image states.
        Only `PerMeasurement` errors stay each image's own. With `shot` or `camera`, cameras are equal if their whole
        sensors are, and mounting errors are numbers of their own for each camera (`CameraMounting`, `LeverArm`), or
        for the cameras on one gimbal head (`Boresight`, `GimbalMounting`, `GimbalAngles`): those whose gimbal,
        `Mount.R_body_from_base` and `Mount.lever_body` are the same. A `Correlated` one is of the smallest group among
        its parts.

        Raises `TypeError` for other cameras than frame cameras and for moving sensors, `ValueError` for no images,
        duplicate names, counts that differ, a shot with two images of one camera, or of stated positions or times that
        do not belong together, and an image whose navigation has no error of position or of attitude: without one
        nothing is adjusted, and no search area is known.
        """
        require_x64()
        names, exposures = as_names(name, "name"), tuple(exposures)
        if not exposures:
            raise ValueError("there are no images; give at least two.")
        if not len(names) == len(exposures) == len(errors):
            raise ValueError(
                f"name, exposures and errors must have one entry for each image; got {len(names)}, {len(exposures)} "
                f"and {len(errors)}."
            )
        exposures = tuple(checked_frame(one, exposure) for one, exposure in zip(names, exposures, strict=True))
        frame = frame_at(_stacked([_shot(one).pose.position for one in exposures]))
        flights, is_rig = _flights(flight, len(names)), shot is not None or camera is not None
        numbers = shots_of(np.arange(len(names)) if shot is None else shot, len(names))
        which, cameras = cameras_of(exposures, is_rig) if camera is None else named_cameras(names, exposures, camera)
        models = [pose_errors(given) for given in errors]
        found = [oriented(frame, one, model) for one, model in zip(exposures, models, strict=True)]
        centre, R = (np.stack([np.asarray(one[k]) for one in found]) for k in range(2))
        each = [OfImage(one.sources, *map(np.asarray, part[2:])) for one, part in zip(models, found, strict=True)]
        rigs = None
        if is_rig:
            check_cameras(names, numbers, which, flights)
            rigs = Rigs(numbers, which, mounts_of([one.sensor for one in exposures], which), centre, R)
        own, common = split(each, np.array([float(_shot(one).time) for one in exposures]), flights, rigs)
        covariance = own + sum((one[:, :, None] * one[:, None, :] for one in common.values()), np.zeros(own.shape))
        check_errors(names, covariance)
        Images(names, which, centre, R)  # raises for duplicate names and poses that are not finite
        given = names, exposures, which, cameras, frame, centre, R, covariance, own, common
        views = cls(*given, shot=numbers if is_rig else None)
        if is_rig:
            check_together(names, exposures, numbers, which, views.covariance_of_pair)
        return views

    def moving(
        self,
        velocity: Any = None,
        turn_rate: Any = None,
        *,
        readout: Any = None,
        atmosphere: Atmosphere | None = None,
    ) -> Views:
        """A copy with what time offsets, a rolling shutter and refraction need in an adjustment (`correct`).

        `velocity` (n, 3) of the perspective centres in m/s, frame axes, and `turn_rate` (n, 3) of the cameras in rad/s
        about their axes; NaN where unknown. Those not given are by differences between neighbouring images over the
        times of their shots (`jaxgeo.adjust.motion_by_differences`), which takes the motion between them as
        even; a gap of more than 1.8 median intervals ends a run of images. `readout` in s, a number for all or a
        mapping from the names of `cameras`, is that of `jaxgeo.adjust.Block`; `atmosphere` too: those of exposures do
        not count. What is not given stays as it is. Raises `ValueError` for other shapes and unknown cameras.
        """
        given = [
            checked_motion(one, len(self), what) for one, what in ((velocity, "velocity"), (turn_rate, "turn_rate"))
        ]
        if given[0] is None or given[1] is None:
            time = np.array([float(_shot(one).time) for one in self.exposure])
            found = motion_of(self.centre, self.R_frame_from_camera, time, self.camera)
            stated = self.velocity, self.turn_rate
            given = [next(x for x in each if x is not None) for each in zip(given, stated, found, strict=True)]
        return replace(
            self,
            velocity=given[0],
            turn_rate=given[1],
            readout=self.readout if readout is None else checked_readout(readout, self.cameras),
            atmosphere=self.atmosphere if atmosphere is None else atmosphere,
        )

    def with_time_offset(self, sigma: float) -> Views:
        """A copy whose navigation also errs by a time offset of all images with a standard deviation in s: their
        velocities and turn rates times the offset (zero where unknown), as an error that they share.

        It widens search areas (`find_ties`). `correct` does so for an offset that is unknown with a prior, so that this
        copy is not for it.
        """
        if self.velocity is None or sigma == 0.0:
            return self
        rates = [self.velocity, np.zeros_like(self.velocity) if self.turn_rate is None else self.turn_rate]
        effect = sigma * np.nan_to_num(np.concatenate(rates, axis=1))
        covariance = self.covariance + effect[:, :, None] * effect[:, None, :]
        return replace(self, covariance=covariance, common={**self.common, "time offset": effect})

    def covariance_of_pair(self, first: int, second: int) -> np.ndarray:
        """Covariance (12, 12) of the navigation errors of two images."""
        between = sum((np.outer(one[first], one[second]) for one in self.common.values()), np.zeros((6, 6)))
        return np.block([[self.covariance[first], between], [between.T, self.covariance[second]]])

    def inputs(self, row: int, terrain: AbstractTerrain) -> ModelInputs:
        """Inputs of the forward model of an image."""
        given = self.exposure[row]
        return ModelInputs(Exposure(given.sensor, given.motion, jnp.zeros(()), given.atmosphere), terrain=terrain)

    def camera_of(self, row: int) -> FrameCamera:
        """The camera of an image."""
        return self.cameras[self.camera[row]]


class Projected(NamedTuple):
    """Projections of points near planes: `nodes` (n, 3, 3, 2), pixels of a lattice (row, col) of the plane at -1, 0, 1
    times its half width; derivatives of the pixel at the centre by the plane coordinates (row, col) in m, `by_plane`
    (n, 2, 2), and by the errors of the pose, `by_pose` (n, 2, 6); whether all nodes have a pixel, and the centre is
    on the image."""

    nodes: Float[Any, "n 3 3 2"]
    by_plane: Float[Any, "n 2 2"]
    by_pose: Float[Any, "n 2 6"]
    visible: Bool[Any, " n"]


def project_planes(
    camera: FrameCamera, centre: Any, R_frame_from_camera: Any, origin: Any, axes: Any, half: Any
) -> Projected:
    """Projections of plane patches: `origin` (n, 3) in the frame, `axes` (n, 2, 3) unit vectors of rows and columns,
    `half` (2,) half widths along rows and columns in m."""
    count = len(origin)
    size = max(-(-count // CHUNK), 1) * CHUNK
    padded = [np.resize(np.asarray(one, np.float64), (size, *np.shape(one)[1:])) for one in (origin, axes)]
    centre, R, half = jnp.asarray(centre), jnp.asarray(R_frame_from_camera), jnp.asarray(half, jnp.float64)
    parts = []
    for k in range(0, size, CHUNK):
        points, directions = (jnp.asarray(one[k : k + CHUNK]) for one in padded)
        parts.append(_project_planes(camera, centre, R, points, directions, half))
    nodes, by_plane, by_pose, visible = (
        np.concatenate([np.asarray(one[k]) for one in parts])[:count] for k in range(4)
    )
    return Projected(nodes, by_plane, by_pose, visible)


@quick_filter_jit
def _project_planes(
    camera: FrameCamera,
    centre: Vector3,
    R: Matrix3,
    origin: Float[Array, "n 3"],
    axes: Float[Array, "n 2 3"],
    half: Float[Array, "2"],
) -> Projected:
    steps = jnp.stack(jnp.meshgrid(*2 * [jnp.array([-1.0, 0.0, 1.0])], indexing="ij"), axis=-1) * half[None, None, :]

    def one(origin: Vector3, axes: Float[Array, "2 3"]) -> tuple[Array, ...]:
        def pixel(step: Float[Array, "2"], error: Float[Array, "6"]) -> Array:
            away = R.T @ (origin + step @ axes - centre - error[:3])
            away = away - jnp.cross(error[3:], away)  # transposed small rotation of the camera
            u, v, _ = camera.project_many(*away)
            return jnp.stack([u, v])

        place = ((origin - centre)[None, None, :] + steps @ axes) @ R
        u, v, status = camera.project_many(place[..., 0], place[..., 1], place[..., 2])
        by_plane, by_pose = jax.jacfwd(pixel, argnums=(0, 1))(jnp.zeros(2), jnp.zeros(6))
        known = jnp.all(jnp.isfinite(u) & jnp.isfinite(v)) & jnp.all(jnp.isfinite(by_pose))
        return jnp.stack([u, v], axis=-1), by_plane, by_pose, known & (status[1, 1] == Status.hit.code)

    return Projected(*jax.vmap(one)(origin, axes))


def _shot(exposure: Exposure) -> Shot:
    assert isinstance(exposure.motion, Shot)
    return exposure.motion


def checked_frame(name: str, exposure: Exposure) -> Exposure:
    check_is(exposure, Exposure, f"exposure of image {name}")
    check_is(exposure.sensor.camera, FrameCamera, f"camera of image {name}", "Tie points are of frame cameras.")
    check_is(exposure.motion, Shot, f"motion of image {name}", "Take the shot of a trajectory at the exposure time.")
    return as_float64(exposure, f"exposure of image {name}")


def _flights(flight: Any, count: int) -> np.ndarray:
    numbers = np.zeros(count, int) if flight is None else np.asarray(flight)
    if numbers.shape != (count,) or not np.issubdtype(numbers.dtype, np.integer):
        raise ValueError(f"flight must be one whole number for each of {count} images; got {flight!r}.")
    return numbers


def _stacked(items: Sequence[Geodetic]) -> Geodetic:
    return jax.tree.map(lambda *leaves: np.stack([np.asarray(one) for one in leaves]), *items)


def pose_errors(errors: Any) -> ErrorModel:
    """Those sources of a model that move the pose."""
    given = errors.sources if isinstance(errors, ErrorModel) else errors
    given = given if isinstance(given, tuple | list) else (given,)
    return as_float64(ErrorModel(tuple(one for one in given if isinstance(one, OF_POSES))), "errors")


@quick_filter_jit
def oriented(
    frame: LocalFrame, exposure: Exposure, model: ErrorModel
) -> tuple[Vector3, Matrix3, Float[Array, "6 errors"], Float[Array, "errors errors"]]:
    """(perspective centre and orientation in the frame, their derivatives by the errors, the errors' covariance)."""
    inputs = ModelInputs(exposure, terrain=ConstantHeight(jnp.zeros(())))
    R_local = frame.R_ecef_from_local.T

    def pose(error: Array) -> tuple[Vector3, Matrix3]:
        moved = model.moved(inputs, error)
        assert isinstance(moved.motion, Shot)
        sight = moved.sensor.sight(moved.motion)
        return frame.from_ecef(sight.centre), R_local @ sight.R_ecef_from_camera

    centre, R = pose(jnp.zeros(model.size))

    def offset(error: Array) -> Array:
        there, turned = pose(error)
        turn = R.T @ turned
        skew = 0.5 * (turn - turn.T)
        return jnp.concatenate([there - centre, jnp.stack([skew[2, 1], skew[0, 2], skew[1, 0]])])

    return centre, R, jax.jacfwd(offset)(jnp.zeros(model.size)), model.covariance()


def check_errors(names: np.ndarray, covariance: np.ndarray) -> None:
    for what, part in (("position", np.s_[:3]), ("attitude", np.s_[3:])):
        spread = np.trace(covariance[:, part, part], axis1=1, axis2=2)
        if not np.all(spread > 0.0):
            row = int(np.argmin(spread > 0.0))
            raise ValueError(
                f"image {names[row]}: the navigation has no error of {what}; the search area and the weight of the "
                f"navigation depend on it. Add a source such as "
                f"{'Position.from_ned(...)' if what == 'position' else 'Attitude.from_degrees(...)'}."
            )
