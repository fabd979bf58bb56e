"""Frame sequences with time-correlated navigation errors: effect of an update of one frame on the next."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu, R_ecef_from_ned
from jaxgeo.observation import Exposure
from jaxgeo.register import Prior, TieErrors, TiePoints, Update, propagate_prior, update_orientation
from jaxgeo.sensor import Pose, Shot
from jaxgeo.studies.gu2017.fixes import alike, fixes_of, height_sigma, lattice
from jaxgeo.studies.gu2017.scene import (
    ABOVE,
    AZIMUTH,
    OFF_NADIR,
    Imaged,
    camera,
    erring,
    looking_at,
    moved,
    navigation,
    points_seen,
    target_on,
)
from jaxgeo.studies.scenes import fractal_posts
from jaxgeo.terrain import Dem
from jaxgeo.uncertainty import ErrorModel, TimeCorrelated
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.sharing import Occasion

FRAMES, STEP, SPEED = 6, 5.0, 60.0  # number, s, m/s to the north
DURATION = 60.0  # s, correlation time of the navigation errors
TIES, MATCHED = 5, 3.0  # in each frame; m
FLIGHTS = 4  # over each ground
SLOPES = {"nearly level": 2.0, "made hills": 8.0, "mountains": 16.0}  # deg, rms
CANDIDATES = 40  # candidate pixels for the ties of a frame: the first that see ground are used
EVERY = 3  # every third frame is registered
ALONE, CARRIED, SELDOM = "each by itself", "carried over", "every third, carried over"


class Frame(NamedTuple):
    """A frame by one method: errors over flights (n,) of the aircraft position and of the centre pixel's fix, m,
    root mean squares of their predicted values, and whether it was registered. `relief` (n,) names the ground of
    each flight."""

    way: str
    number: int
    registered: bool
    position: np.ndarray
    sigma_position: float
    fix: np.ndarray
    sigma_fix: float
    relief: tuple[str, ...]


class _Flown(NamedTuple):
    """A frame: navigation, true shot, and ties."""

    given: Shot
    true: Shot
    ties: TiePoints


def frames(im: Imaged, flights: int = FLIGHTS, seed: int = 0) -> list[Frame]:
    """Every frame by each method, with simulated ties; `flights` over each of several grounds.

    Every flight has its own elevation model with errors. Empty for an image that is not simulated.
    """
    if im.ground is None:
        return []
    model = navigation(sharing=TimeCorrelated(DURATION))
    ways = {ALONE: [], CARRIED: [], SELDOM: []}
    names = []
    for place, (name, ground) in enumerate(grounds(im.ground, seed).items()):
        for flight in range(flights):
            names.append(name)
            number = 100 * place + flight
            over = im._replace(ground=ground, terrain=erring(ground, seed + number))
            flown = _flown(over, model, np.random.default_rng([seed, number, 11]))
            for way, rows in ways.items():
                rows.append(_gone_through(over, model, flown, way))
    result = []
    for way, rows in ways.items():
        table = np.array(rows)  # flights, frames, four numbers
        for k in range(FRAMES):
            away, sigma, fix, sigma_fix = table[:, k].T
            usual = [float(np.sqrt(np.mean(x**2))) for x in (sigma, sigma_fix)]
            result.append(Frame(way, k + 1, _is_registered(way, k), away, usual[0], fix, usual[1], tuple(names)))
    return result


def grounds(hills: Dem, seed: int = 0) -> dict[str, Dem]:
    """The hills of the packaged elevation model, and synthetic ground of other slopes on the same posts."""
    found = {"hills": hills}
    rows, cols = np.asarray(hills.posts).shape
    spacing = float(np.mean(np.asarray(hills.grid.cell_size())))
    for number, (name, slope) in enumerate(SLOPES.items()):
        size = max(rows, cols) + max(rows, cols) % 2
        posts = fractal_posts(size, spacing=spacing, rms_slope=np.deg2rad(slope), seed=100 * seed + number)
        found[name] = Dem.from_array(300.0 + posts[:rows, :cols], hills.grid)
    return found


def _is_registered(way: str, frame: int) -> bool:
    return way != SELDOM or frame % EVERY == 0


def _occasion(frame: int) -> Occasion:
    return Occasion(frame, frame, 0, STEP * frame)


def _flown(im: Imaged, model: ErrorModel, rng: np.random.Generator) -> list[_Flown]:
    """Frames with errors drawn from a Gauss-Markov process, and ties with errors of `MATCHED` on the map."""
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
        uv = rng.uniform(0.05, 0.95, (CANDIDATES, 2)) * margin
        p_ecef = points_seen(*alike((sensor, true)), im.ground, uv)
        sees = np.flatnonzero(np.isfinite(p_ecef[:, 0]))[:TIES]
        uv = uv[sees]
        lat, lon = (
            np.asarray(x) for x in _on_map(jnp.asarray(p_ecef[sees]), jnp.asarray(MATCHED * rng.normal(size=(TIES, 2))))
        )
        none = np.zeros((TIES, 2, 2))
        made.append(_Flown(given, true, TiePoints(uv, Geodetic(lat=lat, lon=lon, height=np.zeros(TIES)), none)))
        error = rho * error + np.sqrt(1.0 - rho**2) * sigma * rng.normal(size=6)
    return made


@jax.jit
def _on_map(points: Any, off: Any) -> tuple[Any, Any]:
    """(lat, lon) of points moved by m east and north."""

    def one(point: Any, away: Any) -> tuple[Any, Any]:
        moved_by = WGS84.to_geodetic(point + R_ecef_from_enu(WGS84.to_geodetic(point))[:, :2] @ away)
        return jnp.asarray(moved_by.lat), jnp.asarray(moved_by.lon)

    return jax.vmap(one)(points, off)


def _gone_through(im: Imaged, model: ErrorModel, flown: Sequence[_Flown], way: str) -> list[list[float]]:
    """(position error, its sigma, error of the centre fix, its sigma) of each frame."""
    tie_errors = TieErrors(registration=MATCHED, terrain=height_sigma(im))
    last: tuple[int, Update] | None = None
    rows = []
    for k, frame in enumerate(flown):
        prior = None if last is None or way == ALONE else propagate_prior(last[1], _occasion(last[0]), _occasion(k))
        if _is_registered(way, k):
            found = update_orientation(
                *alike((camera(), frame.given)), frame.ties, im.terrain, model, tie_errors, prior=prior
            )
            last = k, found
            rows.append(_off(im, frame, found.shot, found.cov_error))
        else:
            assert prior is not None
            rows.append(_off(im, frame, *_predicted(im, frame, model, prior)))
    return rows


def _predicted(im: Imaged, frame: _Flown, model: ErrorModel, prior: Prior) -> tuple[Any, Any]:
    """(predicted shot from the previous frames, covariance of its errors)."""
    inputs = ModelInputs(Exposure(*alike((camera(), frame.given)), jnp.asarray(0.0)), terrain=im.terrain)
    return _moved(model, inputs, jnp.asarray(prior.mean)[:-2]).motion, jnp.asarray(prior.covariance)[:-2, :-2]


@eqx.filter_jit
def _moved(model: ErrorModel, inputs: ModelInputs, error: Any) -> ModelInputs:
    return model.moved(inputs, error)


def _off(im: Imaged, frame: _Flown, shot: Any, cov: Any) -> list[float]:
    of_frame = im._replace(errors=navigation(), sensor=camera())
    away, R = (np.asarray(x) for x in _apart(*alike((shot.pose, frame.true.pose))))
    fixes = fixes_of(of_frame, shot, cov)
    pixels = lattice(of_frame.sensor)
    near = int(np.argmin(np.linalg.norm(pixels - np.mean(pixels, axis=0), axis=1)))
    assert im.ground is not None
    off = fixes.off(points_seen(*alike((of_frame.sensor, frame.true)), im.ground, pixels))[near]
    sigma = float(np.sqrt(np.trace(np.asarray(cov)[:3, :3])))
    return [
        float(np.linalg.norm(R.T @ away)),
        sigma,
        float(np.linalg.norm(off)),
        float(np.sqrt(np.trace(fixes.cov[near]))),
    ]


@eqx.filter_jit
def _apart(pose: Pose, true: Pose) -> tuple[jax.Array, jax.Array]:
    """Offset of one pose from another in ECEF, m, and the axes of north, east, down there."""
    away = WGS84.to_ecef(pose.position) - WGS84.to_ecef(true.position)
    return away, R_ecef_from_ned(true.position)
