"""Accuracy of a fix (CE, LE, SE) by the cheapest propagation method that is valid there."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import jax
from jax.typing import ArrayLike

from jaxgeo._record import Record
from jaxgeo.earth.atmosphere import Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.locate import FIRST_HIT
from jaxgeo.observation import accepts_observation
from jaxgeo.sensor import Sensor, Shot, Trajectory
from jaxgeo.terrain import AbstractSearch, AbstractTerrain
from jaxgeo.uncertainty.draws import AbstractDraws, Random
from jaxgeo.uncertainty.linear import Propagation
from jaxgeo.uncertainty.method_selection import FEW, GRAZING, SAME_GROUND, Diagnostics, Method, diagnose, method_of
from jaxgeo.uncertainty.model import ErrorModel, checked_model
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sampled import CHUNK, Sampled, Sampling, sampled_at

SAMPLES = 20_000
RANDOM = Random()


class Accuracy(Record):
    """Accuracy of a fix: radii in m that contain the true point with `probability`, and the method used.

    `circular` is horizontal, `linear` vertical, `spherical` in space; infinite if too many samples have no fix.
    `trust` is the method, `because` the reason for it in words, `signs` the diagnostics that selected it.
    """

    fix: Fix
    probability: float
    circular: float
    linear: float
    spherical: float
    trust: Method
    because: str
    signs: Diagnostics
    propagation: Propagation
    sampled: Sampled | None = None

    def __str__(self) -> str:
        percent = f"{100.0 * self.probability:g}"
        return (
            f"CE{percent} {self.circular:.4g} m, LE{percent} {self.linear:.4g} m, SE{percent} {self.spherical:.4g} m, "
            f"by {self.trust.words}. {self.because}"
        )


@accepts_observation
def accuracy(
    sensor: Sensor,
    shot: Shot | Trajectory,
    uv: ArrayLike | Sequence[ArrayLike],
    terrain: AbstractTerrain,
    errors: ErrorModel | Any,
    *,
    probability: float = 0.9,
    time: ArrayLike | None = None,
    search: AbstractSearch = FIRST_HIT,
    atmosphere: Atmosphere | None = None,
    key: Any = None,
    count: int = SAMPLES,
    draws: AbstractDraws = RANDOM,
    chunk: int = CHUNK,
) -> Accuracy:
    """Accuracy of the fix that `locate` returns for the same arguments.

    The terrain around the fix is examined first, without samples: the slopes of facet and footprint, the terrain
    profile along the line of sight with its ridges and unseen gaps, and edges and voids within the errors' range. If
    linear propagation over the facet agrees with footprint and profile, it is used; otherwise that over the footprint,
    if it agrees with the profile. If neither is valid, or the ground cannot be probed, `count` samples are drawn (with
    `key`, default `jax.random.key(0)`; `draws` and `chunk` as for `sample`). Raises as `propagate`, and `ValueError`
    for a probability outside (0, 1) and if there is no fix. For many fixes see `accuracy_map`, `accuracy_of_pixels` and
    `assess`.

    >>> from jaxgeo.uncertainty import sources
    >>> camera = jaxgeo.FrameCamera.from_pixels(focal_px=3700.0, width=4000, height=3000)
    >>> sensor = jaxgeo.Sensor(camera, jaxgeo.Gimbal.three_axis(), jaxgeo.Mount.forward())
    >>> pose = jaxgeo.Pose.from_degrees(lat=47.0, lon=11.0, height=720.0)
    >>> shot = jaxgeo.Shot(pose, sensor.gimbal.readings_from_degrees(yaw=30.0, pitch=-45.0, roll=0.0))
    >>> errors = jaxgeo.ErrorModel((
    ...     sources.Position.from_ned(north=3.0, east=3.0, down=5.0),
    ...     sources.GimbalAngles.from_degrees(yaw=1.0, pitch=0.5, roll=0.5),
    ...     sources.TerrainHeight.from_metres(2.0),
    ... ))
    >>> scene = sensor, shot, (1999.5, 1499.5), jaxgeo.ConstantHeight(600.0), errors
    ...
    >>> found = jaxgeo.accuracy(*scene)
    >>> print(f"CE90 {found.circular:.2f} m, LE90 {found.linear:.2f} m, by {found.trust.words}")
    CE90 11.52 m, LE90 3.29 m, by linear propagation
    """
    if not 0.0 < probability < 1.0:
        raise ValueError(f"probability must lie between 0 and 1; got {probability!r}.")
    look = ModelInputs.of(sensor, shot, uv, terrain, time=time, search=search, atmosphere=atmosphere)
    model = checked_model(errors, look)
    sampling = Sampling(jax.random.key(0) if key is None else key, count, draws, chunk=chunk)
    sampling.check()
    aim = look.nominal_fix(search)
    aim.require_fix()
    signs, facet, footprint, _ = diagnose(look, aim, model)
    trust = Method(int(method_of(signs)))
    because = reason(signs, trust)
    if trust is Method.samples:
        drawn = sampled_at(look, model, search, sampling, aim)
        figures = (drawn.circular_error, drawn.linear_error, drawn.spherical_error)
        circular, linear, spherical = (figure(probability).value for figure in figures)
        return Accuracy(aim.fix, probability, circular, linear, spherical, trust, because, signs, footprint, drawn)
    chosen = facet if trust is Method.facet else footprint
    figures = (chosen.circular_error, chosen.linear_error, chosen.spherical_error)
    circular, linear, spherical = (float(figure(probability)) for figure in figures)
    return Accuracy(aim.fix, probability, circular, linear, spherical, trust, because, signs, chosen)


def reason(signs: Diagnostics, trust: Method) -> str:
    """Why this method was selected and no cheaper one, with the deciding figures."""
    facet, footprint, profile = (float(x) for x in (signs.facet, signs.footprint, signs.profile))
    jumps, fails = 100.0 * float(signs.jumps), 100.0 * float(signs.fails)
    figures = (
        f"CE90 {facet:.3g} m over the facet, {footprint:.3g} m over the footprint, {profile:.3g} m over the profile"
    )
    if trust is Method.facet:
        return f"The ground is nearly planar within the error region: {figures}."
    if trust is Method.footprint:
        return f"The slope at the fix differs from the mean slope of the error region: {figures}."
    obstacle = _obstacle(signs, fails, jumps)
    if obstacle is not None:
        return f"{obstacle}: {figures}."
    return (
        f"The ground is not planar within the error region: {figures}; LE90 {float(signs.facet_up):.3g}, "
        f"{float(signs.footprint_up):.3g} and {float(signs.profile_up):.3g} m."
    )


def _obstacle(signs: Diagnostics, fails: float, jumps: float) -> str | None:
    """Condition that rules out linear propagation even if the figures agree, or None; `fails` and `jumps` in %."""
    off, known, grazing = float(signs.off), float(signs.known), float(signs.grazing)
    if not off <= SAME_GROUND:
        where = f"{off:.3g} m from the fix" if math.isfinite(off) else "nowhere near the fix"
        return f"The terrain surface sampled from above lies {where}, so the ground at the fix is unknown"
    if fails + jumps > 100.0 * FEW and fails >= jumps:
        return f"{fails:.2g} % of the perturbed lines of sight meet no known ground"
    if fails + jumps > 100.0 * FEW:
        clearance = float(signs.clearance)
        other = f"hit a nearer or farther slope (first at {clearance:.2g} sigma)"
        return f"{jumps:.2g} % of the perturbed lines of sight {other}"
    if known != 1.0:
        return f"{100.0 * (1.0 - known):.2g} % of the ground in the footprint is unknown"
    if not grazing > GRAZING:
        return f"The line of sight grazes the surface, at {1e3 * grazing:.2g} mrad"
    return None
