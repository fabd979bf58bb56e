"""Frames one after the other, whose navigation errs alike for a while: what an update of one says of the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu, R_ecef_from_ned
from jaxgeo.locate import locate
from jaxgeo.register import Prior, TieErrors, TiePoints, Update, next_prior, update
from jaxgeo.sensor import Pose, Shot
from jaxgeo.studies.gu2017.fixes import fixes_of, lattice
from jaxgeo.studies.gu2017.scene import (
    ABOVE,
    AZIMUTH,
    OFF_NADIR,
    Imaged,
    camera,
    looking_at,
    moved,
    navigation,
    target_on,
)
from jaxgeo.uncertainty import ErrorModel, InTime
from jaxgeo.uncertainty.look import Look
from jaxgeo.uncertainty.sharing import Occasion

FRAMES, STEP, SPEED = 6, 5.0, 60.0  # number, s, m/s to the north
DURATION = 60.0  # s, over which the navigation's errors fade
TIES, MATCHED = 5, 3.0  # in each frame; m
EVERY = 3  # frames, of which one is registered
ALONE, CARRIED, SELDOM = "each by itself", "carried over", "every third, carried over"


class Frame(NamedTuple):
    """A frame by one way: errors over trials (n,) of the position of the aircraft and of the fix in the middle, m, root
    mean squares of what was foretold of them, and whether it was registered."""

    way: str
    number: int
    registered: bool
    position: np.ndarray
    sigma_position: float
    fix: np.ndarray
    sigma_fix: float


class _Flown(NamedTuple):
    """A frame: what the navigation says, what is true, and its ties."""

    given: Shot
    true: Shot
    ties: TiePoints


def frames(im: Imaged, trials: int = 8, seed: int = 0) -> list[Frame]:
    """Every frame by each way; over the ground and elevation model of a made scene, with simulated ties."""
    if im.ground is None:
        return []
    model = navigation(sharing=InTime(DURATION))
    ways = {ALONE: [], CARRIED: [], SELDOM: []}
    for trial in range(trials):
        flown = _flown(im, model, np.random.default_rng([seed, trial, 11]))
        for way, rows in ways.items():
            rows.append(_gone_through(im, model, flown, way))
    result = []
    for way, rows in ways.items():
        table = np.array(rows)  # trials, frames, four numbers
        for k in range(FRAMES):
            away, sigma, fix, sigma_fix = table[:, k].T
            usual = [float(np.sqrt(np.mean(x**2))) for x in (sigma, sigma_fix)]
            result.append(Frame(way, k + 1, _is_registered(way, k), away, usual[0], fix, usual[1]))
    return result


def _is_registered(way: str, frame: int) -> bool:
    return way != SELDOM or frame % EVERY == 0


def _occasion(frame: int) -> Occasion:
    return Occasion(frame, frame, 0, STEP * frame)


def _flown(im: Imaged, model: ErrorModel, rng: np.random.Generator) -> list[_Flown]:
    """Frames with errors drawn from a Gauss-Markov process, and ties that err by `MATCHED` on the map."""
    assert im.ground is not None
    sensor, rho = camera(), float(np.exp(-STEP / DURATION))
    sigma = np.sqrt(np.diagonal(np.asarray(model.covariance())))
    error, made = sigma * rng.normal(size=6), []
    for frame in range(FRAMES):
        target = target_on(im.ground, STEP * SPEED * (frame - 0.5 * (FRAMES - 1)))
        true = looking_at(target, off_nadir=OFF_NADIR, azimuth=AZIMUTH, above=ABOVE)
        given = moved(true, error[:3], error[3:])
        lens: Any = sensor.camera
        margin = np.array([lens.width, lens.height])
        uv = rng.uniform(0.05, 0.95, (TIES, 2)) * margin
        places = _on_map(sensor, true, im.ground, jnp.asarray(uv), jnp.asarray(MATCHED * rng.normal(size=(TIES, 2))))
        lat, lon = (np.asarray(x) for x in places)
        none = np.zeros((TIES, 2, 2))
        made.append(_Flown(given, true, TiePoints(uv, Geodetic(lat=lat, lon=lon, height=np.zeros(TIES)), none)))
        error = rho * error + np.sqrt(1.0 - rho**2) * sigma * rng.normal(size=6)
    return made


@eqx.filter_jit
def _on_map(sensor: Any, shot: Shot, ground: Any, uv: Any, off: Any) -> tuple[Any, Any]:
    """(lat, lon) of what pixels see, moved by m east and north."""

    def one(pixel: Any, away: Any) -> tuple[Any, Any]:
        place = locate(sensor, shot, pixel, ground)
        moved_by = WGS84.to_geodetic(place.ecef + R_ecef_from_enu(place.position)[:, :2] @ away)
        return jnp.asarray(moved_by.lat), jnp.asarray(moved_by.lon)

    return jax.vmap(one)(uv, off)


def _gone_through(im: Imaged, model: ErrorModel, flown: Sequence[_Flown], way: str) -> list[list[float]]:
    """(error of the position, its sigma, error of the middle's fix, its sigma) of each frame."""
    told = TieErrors(registration=MATCHED, terrain=im.tie_errors.terrain)
    last: tuple[int, Update] | None = None
    rows = []
    for k, frame in enumerate(flown):
        prior = None if last is None or way == ALONE else next_prior(last[1], _occasion(last[0]), _occasion(k))
        if _is_registered(way, k):
            found = update(camera(), frame.given, frame.ties, im.terrain, model, told, prior=prior)
            last = k, found
            rows.append(_off(im, frame, model, found.shot, found.cov_error))
        else:
            assert prior is not None
            rows.append(_off(im, frame, model, *_foretold(im, frame, model, prior)))
    return rows


def _foretold(im: Imaged, frame: _Flown, model: ErrorModel, prior: Prior) -> tuple[Any, Any]:
    """(the shot as the frames before have it, the covariance of its errors)."""
    look = Look(camera(), frame.given, jnp.asarray(0.0), jnp.zeros(2), im.terrain)
    return _moved(model, look, jnp.asarray(prior.mean)[:-2]).motion, jnp.asarray(prior.covariance)[:-2, :-2]


@eqx.filter_jit
def _moved(model: ErrorModel, look: Look, error: Any) -> Look:
    return model.moved(look, error)


def _off(im: Imaged, frame: _Flown, model: ErrorModel, shot: Any, cov: Any) -> list[float]:
    of_frame = im._replace(errors=model, sensor=camera())
    away = WGS84.to_ecef(_position(shot.pose)) - WGS84.to_ecef(frame.true.pose.position)
    fixes = fixes_of(of_frame, shot, cov)
    near = int(np.argmin(np.linalg.norm(lattice(of_frame.sensor) - np.mean(lattice(of_frame.sensor), axis=0), axis=1)))
    true = _places(of_frame.sensor, frame.true, im.ground, jnp.asarray(lattice(of_frame.sensor)))
    off = fixes.off(np.asarray(true))[near]
    sigma = float(np.sqrt(np.trace(np.asarray(cov)[:3, :3])))
    R = R_ecef_from_ned(frame.true.pose.position)
    return [
        float(np.linalg.norm(R.T @ away)),
        sigma,
        float(np.linalg.norm(off)),
        float(np.sqrt(np.trace(fixes.cov[near]))),
    ]


def _position(pose: Pose) -> Geodetic:
    return pose.position


@eqx.filter_jit
def _places(sensor: Any, shot: Shot, ground: Any, uv: Any) -> Any:
    return jax.vmap(lambda pixel: jnp.asarray(locate(sensor, shot, pixel, ground).ecef))(uv)
