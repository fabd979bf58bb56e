"""Track of a target from many looks: batch least squares and a filter, with shared errors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from jaxgeo._arguments import check_terrain
from jaxgeo._checks import check_is
from jaxgeo._intersection import FIRST_HIT
from jaxgeo.sensor import Trajectory
from jaxgeo.status import Status, count_statuses
from jaxgeo.terrain import AbstractTerrain, ConstantHeight
from jaxgeo.uncertainty.host_arrays import take
from jaxgeo.uncertainty.look_filter import FAST, UNDETERMINED, AfterLook
from jaxgeo.uncertainty.look_passes import about_one, after_each, batch_of_all, last_of, mode_of
from jaxgeo.uncertainty.look_scene import in_order, lines_of_all, scene_of
from jaxgeo.uncertainty.looks import Looks, checked_looks
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.shared_errors import SharedErrors, for_target, shared_errors
from jaxgeo.uncertainty.sharing import Systematic
from jaxgeo.uncertainty.target_motion import AbstractTarget, AtRest
from jaxgeo.uncertainty.track_record import TargetState, Track

AT_REST = AtRest()
NO_FRESH = 1e-4  # factor of fresh errors for the floor


def track(
    looks: Looks | Sequence[Looks] | Any,
    terrain: AbstractTerrain | None,
    errors: ErrorModel | Any,
    *,
    target: AbstractTarget | Any = AT_REST,
) -> Track:
    """Position and velocity of one target from looks over time, with all that the errors of the looks share.

    `looks` are those of one sensor (`Looks`), or a list with one for each sensor; `target` is `AtRest()` or
    `ConstantVelocity()`, on the terrain unless made with `on_terrain=False`, for which `terrain` may be None.
    `errors` is the error model of all sensors; `Looks.errors` holds more for one. The sharing of each source says
    how its errors in two looks are correlated: independent (`PerMeasurement`, `PerImage`), common to the looks of a
    sensor (`PerFlight`) or of all (`Systematic`), or fading with time (`TimeCorrelated` with beta = 0, for each
    sensor). Those of the ground (`TerrainHeight`, `Geoid`) that are not fresh are common to all sensors, which look
    at the same place. A `TerrainField` is one unknown height at a target at rest.

    A look determines the target's place across the line of sight, to first order in the errors, by the same
    derivatives as in `propagate`. On the terrain the height follows the DEM, whose height error is one of the
    errors. `batch` is the generalised least-squares estimate of all looks with their joint covariance, by
    Gauss-Newton. `filtered` is a recursive estimate after each look, linearised at what was known by then, with the
    errors that are not fresh as states; after 2, 4, 8 and more looks all are linearised anew at their common estimate,
    until that no longer moves it. Nothing is known of the target before the first look. Both are exact, and equal at
    the last look, if the problem is linear; if they end at different places (`is_ambiguous`), the looks fit several.
    Of errors that are not normal the variance is used (see `note`). The time grows in proportion to the number of
    looks. One set of compiled programs serves up to 16 looks, one up to 128, and one all larger numbers.

    A look without a fix, or without a line of sight if the target is free in height, is left out and keeps its
    status; so are looks that graze the terrain. If the looks do not determine the position (free in height, from one
    direction), its status is `weak_intersection`.

    Raises `RuntimeError` with 64-bit floats off; `TypeError` for arguments of the wrong kind and sharings other than
    those; `ValueError` for shapes that do not fit, looks that are not in the order of time, fewer usable looks than
    unknowns, a moving target with all looks at one time, and as `propagate` for errors.

    >>> from jaxgeo.uncertainty import Looks, sources, track
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=5000.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.fixed(), jaxgeo.Mount.forward())
    >>> point = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=600.0)
    >>> places = [jaxgeo.Geodetic.from_degrees(lat=46.97, lon=lon, height=2600.0) for lon in (10.99, 11.0, 11.01)]
    >>> poses = [jaxgeo.Pose.looking_at(position=place, point=point) for place in places]
    >>> shots = [jaxgeo.Shot(pose, time=10.0 * k) for k, pose in enumerate(poses)]
    >>> errors = jaxgeo.ErrorModel((
    ...     sources.Attitude.from_degrees(heading=0.1, pitch=0.1, roll=0.1),
    ...     sources.Boresight.from_degrees(heading=0.1, pitch=0.1, roll=0.1),
    ... ))
    >>> found = track(Looks(sensor, shots, [(1999.5, 1499.5)] * 3), jaxgeo.ConstantHeight(600.0), errors)
    >>> print(f"CE90 {found.filtered.ce90[0]:.1f} m after one look, {found.filtered.ce90[-1]:.1f} m after three")
    CE90 33.4 m after one look, 22.1 m after three
    >>> print(f"claimed by a filter of independent looks: {found.independent.ce90[-1]:.1f} m")
    claimed by a filter of independent looks: 18.2 m
    """
    several = checked_looks(looks)
    check_is(target, AbstractTarget, "target", "AtRest() and ConstantVelocity() are targets.")
    if not isinstance(target.on_terrain, bool):
        raise TypeError(f"target.on_terrain must be True or False; got {target.on_terrain!r}.")
    shared = checked_errors(several, terrain, errors, target)
    lines, starts = lines_of_all(several, terrain, shared, target)
    sensor, look, order = in_order(lines)
    status, times = (np.concatenate([np.asarray(x) for x in part])[order] for part in zip(*starts, strict=True))
    _check_enough(status, times, target)
    scene, at_start = scene_of(lines, order, sensor, terrain, shared, target)

    batch, rounds, has_converged = batch_of_all(scene, at_start)
    recursive = after_each(scene)
    solution = last_of(batch)
    independent = about_one(scene, solution, mode_of(shared=0.0))
    floor = about_one(scene, solution, mode_of(fresh=NO_FRESH))
    last = jax.tree.map(lambda leaf: leaf[-1:], batch)
    return Track(
        times,
        sensor,
        look,
        status,
        _states(last, times[-1:], has_converged)[0],
        _states(recursive, times),
        _states(independent, times),
        independent.actual,
        floor.cov_enu[-1],
        recursive.innovation,
        recursive.nis,
        recursive.degrees,
        target,
        rounds,
        ErrorModel(tuple({s.label: s for model in shared.models for s in model.sources}.values())).left_out,
    )


def checked_errors(
    several: tuple[Looks, ...], terrain: AbstractTerrain | None, errors: Any, target: AbstractTarget
) -> SharedErrors:
    """The errors of all looks; checked against the first look of each sensor."""
    if terrain is not None or target.on_terrain:
        check_terrain(terrain, FIRST_HIT)
    own: list[ErrorModel | None] = []
    common = None
    for number, looks in enumerate(several):
        inputs = _first_inputs(looks, terrain)
        common = for_target(checked_model(errors, inputs), target)
        try:
            model = None if looks.errors is None else for_target(checked_model(looks.errors, inputs), target)
        except (TypeError, ValueError) as error:
            raise type(error)(f"looks[{number}].errors: {error}") from error
        for source in () if model is None or len(several) == 1 else model.sources:
            if isinstance(source.sharing, Systematic):
                raise ValueError(
                    f"looks[{number}].errors: {source.label} is Systematic, common to the looks of all sensors: give "
                    "it with errors=, or make it PerFlight."
                )
        own.append(model)
    assert common is not None
    shared = shared_errors(common, own)
    if not all(model.size for model in shared.models):
        raise ValueError("errors has only heights of the terrain, which no look at a target free in height depends on.")
    if all(model.is_exact for model in shared.models):
        raise ValueError("track: all standard deviations of the errors are zero, and looks cannot be weighed by them.")
    for number, (looks, columns) in enumerate(zip(several, shared.columns, strict=True)):
        fades = np.any(columns[:, sum(shared.counts[:2]) :])
        if fades and len(looks) > 1 and np.ptp(np.asarray(looks.times)) == 0.0:
            raise ValueError(
                f"looks[{number}]: all looks are at {float(np.asarray(looks.times)[0]):g} s, so that errors that fade "
                "with time would be the same in all. Give the time of each shot, or times=."
            )
    return shared


def _first_inputs(looks: Looks, terrain: AbstractTerrain | None) -> ModelInputs:
    motion, time = looks.shots, None
    if isinstance(motion, Trajectory):
        time = np.asarray(looks.times)[0]
    else:
        motion = take(motion, 0)
    ground = ConstantHeight(0.0) if terrain is None else terrain
    uv = np.asarray(looks.uvs)[0]
    air = looks.atmosphere
    return ModelInputs.of(looks.sensor, motion, uv, ground, time=time, atmosphere=air, of_many=True)


def _check_enough(status: np.ndarray, times: np.ndarray, target: AbstractTarget) -> None:
    """Raise `ValueError` for fewer usable looks than the unknowns need."""
    used = status == Status.hit
    needed, count = -(-target.unknowns // 2), np.count_nonzero(used)
    lost = ", ".join(f"{number} {code.name}" for code, number in count_statuses(status[~used]).items())
    of_all = f" of {len(status)} looks; the others: {lost}" if lost else ""
    if count < needed:
        raise ValueError(
            f"a {target.words} has {target.unknowns} unknowns, of which a look determines two: it needs {needed} or "
            f"more looks that can be used; got {count}{of_all}."
        )
    if target.is_moving and np.ptp(times[used]) == 0.0:
        raise ValueError(
            f"a {target.words} needs looks at different times; all are at {times[used][0]:g} s. Give the time of each "
            "shot, or times=."
        )


def _states(after: AfterLook, times: np.ndarray, has_converged: bool = True) -> TargetState:
    """States after each look; NaN where they are not determined."""
    deviation = np.sqrt(np.maximum(np.trace(after.cov_enu, axis1=1, axis2=2), 0.0))
    is_far = ~(deviation <= UNDETERMINED * after.distance)
    status = np.where(after.is_known, Status.hit, Status.leaves_terrain)
    status = np.where(has_converged, status, Status.not_converged)
    status = np.where(is_far, Status.weak_intersection, status).astype(np.int8)
    ok = status == Status.hit
    numbers = (after.position, after.p_ecef, after.cov_enu)
    position, p_ecef, cov_enu = jax.tree.map(lambda x: _known(x, ok), numbers)
    moves = ok & (np.sqrt(np.maximum(np.trace(after.velocity_cov_enu, axis1=1, axis2=2), 0.0)) < 1e-3 * FAST)
    velocity, velocity_cov = (_known(x, moves) for x in (after.velocity_enu, after.velocity_cov_enu))
    return TargetState(times, position, p_ecef, cov_enu, velocity, velocity_cov, status)


def _known(numbers: Any, ok: np.ndarray) -> np.ndarray:
    numbers = np.asarray(numbers)
    return np.where(ok.reshape(-1, *[1] * (numbers.ndim - 1)), numbers, np.nan)
