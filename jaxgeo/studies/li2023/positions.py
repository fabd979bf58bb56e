"""Accuracy of the targets of Li et al. (2023): Table 3, over level ground and over synthetic terrain."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxgeo._intersection import FIRST_HIT
from jaxgeo._sweep import swept
from jaxgeo.earth import Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io.dem import example_dem
from jaxgeo.sensor import Shot
from jaxgeo.studies.li2023 import printed
from jaxgeo.studies.li2023.targets import metres_per_radian
from jaxgeo.studies.scenes import fractal_posts, tangent_dem
from jaxgeo.terrain import AbstractTerrain, Dem
from jaxgeo.uncertainty import Facet, Footprint, Method, Sampling, accuracy, presets, propagate, sample
from jaxgeo.uncertainty.metrics import circular_error, circular_probability
from jaxgeo.uncertainty.model_inputs import ModelInputs
from jaxgeo.uncertainty.slopes import AbstractSlope

LEVEL_GROUND = "level"
RMS_SLOPES = {"hill": math.radians(8.0), "mountain": math.radians(22.0)}  # synthetic terrains
SPACING = 30.0  # m, post spacing of ASTER GDEM V2
MIDDLE = 2500.0  # m, largest distance of a place from the terrain's centre, so that perturbed rays also hit ground
LEVEL = 5.0  # m, tolerance of the ground height at a place against the printed target
NEAR = 60.0  # m: a place is visible if the fix is within this distance
MOST_TRIED = 300  # places
METHODS = ("linear, facet", "linear, footprint", "sampled")
FIGURES = (
    "lat_deg",
    "lon_deg",
    "north",
    "east",
    "height",
    "rms",
    "rms_over_1_2",
    "ce50",
    "ce90",
    "held",
    "beyond",
    "found",
)
DIMS = dict.fromkeys(FIGURES, ("method",)) | {
    "cov_enu": ("method", "enu", "enu2"),
    "errors_enu": ("sample", "enu"),
}


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of one fix: RMS about the nominal fix in m along each axis and in space, and derived figures.

    `rms_over_1_2` is what the paper prints as "circular error probable", `held` the true probability of that circle;
    `ce50` and `ce90` are the true radii on the level plane, in m, and `beyond` is the probability of an error there
    larger than the one that the paper found against a map. `found` is the share of samples with a fix (1 if not
    sampled); moments are those of the samples with a fix; in radii and shares the others count as infinitely far.
    """

    terrain: str
    ground: str
    method: str
    place: int
    lat_deg: float
    lon_deg: float
    north: float
    east: float
    height: float
    rms: float
    rms_over_1_2: float
    ce50: float
    ce90: float
    held: float
    beyond: float
    found: float
    cov_enu: np.ndarray
    errors_enu: np.ndarray | None = None


@dataclass(frozen=True)
class Judged:
    """Result of `jaxgeo.accuracy` at a place: the selected method as text, its CE90 in m, and the sampled CE90."""

    terrain: str
    ground: str
    place: int
    method: str
    ce90: float
    sampled_ce90: float


def over_level_ground(*, samples: int, key: Array) -> list[Accuracy]:
    """The three rows of Table 3 on level ground at the heights of the printed targets: linear, and sampled."""
    rows = []
    for number, (name, row) in enumerate(printed.TERRAINS.items()):
        ground, shot = printed.level_ground(row.target[2]), printed.shot_of(row)
        rows.append(_linear((name, LEVEL_GROUND), "linear", shot, ground, Facet()))
        rows.append(_drawn((name, LEVEL_GROUND), shot, ground, samples, jax.random.fold_in(key, number)))
    return rows


def over_fractal_ground(
    *,
    samples: int,
    key: Array,
    places: int = 12,
    size: int = 601,
    seed: int = 0,
    names: Sequence[str] = tuple(RMS_SLOPES),
    **how: Any,
) -> tuple[list[Accuracy], list[Judged]]:
    """Hill and mountain over synthetic fractal terrain with the given RMS slope: several places, each on its own
    terrain, drawn from `seed`.

    The ground height there equals that of the printed target, and the aircraft is moved sideways so that its line of
    sight intersects the ground there. The errors are propagated with the slope of the facet under the fix, with that of
    the footprint, and by sampling; `jaxgeo.accuracy` chooses among these by itself. `how` are options of
    `jaxgeo.sweep`: `executor`, `folder`, `progress`.
    """
    view = functools.partial(fractal_view, size=size, seed=seed)
    return _at_places(view, {name: fractal_name(name) for name in names}, places, samples, key, how)


def over_real_ground(
    *, samples: int, key: Array, places: int = 12, seed: int = 0, names: Sequence[str] = tuple(RMS_SLOPES), **how: Any
) -> tuple[list[Accuracy], list[Judged]]:
    """Hill and mountain over the packaged real elevation model, at places drawn from `seed`.

    The aircraft is moved there, with the height above ground that it has above the printed target; angles are those of
    Table 2. `how` as for `over_fractal_ground`.
    """
    view = functools.partial(real_view, places=places, seed=seed)
    ground = f"real, rms slope {math.degrees(_rms_slope(example_dem())):.0f}°"
    return _at_places(view, dict.fromkeys(names, ground), places, samples, key, how)


def fractal_view(name: str, place: int, *, size: int, seed: int) -> tuple[Shot, Dem]:
    """Shot and terrain of a place on synthetic ground."""
    drawn = terrain_seed(seed, place)
    dem = fractal_ground(name, size=size, seed=drawn)
    (shot,) = shots_in_sight(name, dem, places=1, seed=drawn)
    return shot, dem


def real_view(name: str, place: int, *, places: int, seed: int) -> tuple[Shot, Dem]:
    """Shot and terrain of one of some places on real ground."""
    return _real_shots(name, places, seed)[place], example_dem()


@functools.lru_cache(maxsize=4)
def _real_shots(name: str, places: int, seed: int) -> list[Shot]:
    return shots_over(name, example_dem(), places=places, seed=seed)


def _at_places(
    view: Callable[..., tuple[Shot, Dem]],
    grounds: Mapping[str, str],
    places: int,
    samples: int,
    key: Array,
    how: Mapping[str, Any],
) -> tuple[list[Accuracy], list[Judged]]:
    """All methods at all places, as a sweep of a task for each place; `grounds` has the ground of each row's name."""
    function = functools.partial(figures_at, view=view, samples=samples, key=np.asarray(jax.random.key_data(key)))
    axes = {"name": list(grounds), "place": np.arange(places)}
    found = swept(function, axes, dims=DIMS, vectorize=False, block=1, **how).arrays
    rows, judged = [], []
    for i, (name, ground) in enumerate(grounds.items()):
        for place in range(places):
            own = {field: array[i, place] for field, array in found.items()}
            for k, method in enumerate(METHODS):
                figures = {field: float(own[field][k]) for field in FIGURES}
                errors = own["errors_enu"] if method == "sampled" and place == 0 else None
                rows.append(
                    Accuracy(name, ground, method, place, **figures, cov_enu=own["cov_enu"][k], errors_enu=errors)
                )
            words = Method(int(own["method_of_accuracy"])).words
            judged.append(Judged(name, ground, place, words, float(own["ce90_of_accuracy"]), rows[-1].ce90))
    return rows, judged


def figures_at(
    name: str, place: int, *, view: Callable[..., tuple[Shot, Dem]], samples: int, key: np.ndarray
) -> dict[str, np.ndarray | float | int]:
    """Figures of all methods at a place, in the order of `METHODS`; the sampled errors; what `jaxgeo.accuracy` says."""
    (shot, dem), what = view(name, place), (name, "")
    own = jax.random.fold_in(jax.random.wrap_key_data(jnp.asarray(key)), place)
    each = [
        _linear(what, METHODS[0], shot, dem, Facet(), place),
        _linear(what, METHODS[1], shot, dem, Footprint(), place),
        _drawn(what, shot, dem, samples, own, place),
    ]
    model = presets.li_2023(terrain_height=printed.DEM_SIGMA)
    sampling = Sampling(count=samples, key=jax.random.fold_in(own, 1))
    found = accuracy(printed.sensor(), shot, printed.UV, dem, model, sampling=sampling)
    figures: dict[str, Any] = {field: np.array([getattr(one, field) for one in each]) for field in FIGURES}
    figures |= {"cov_enu": np.stack([one.cov_enu for one in each]), "errors_enu": each[-1].errors_enu}
    return figures | {"method_of_accuracy": int(found.method), "ce90_of_accuracy": float(found.circular)}


def terrain_seed(seed: int, place: int) -> int:
    """The seed of the terrain of a place."""
    return int(np.random.SeedSequence([seed, place]).generate_state(1)[0])


def fractal_name(name: str) -> str:
    """Name of the ground of a row."""
    return f"synthetic, rms slope {math.degrees(RMS_SLOPES[name]):.0f}°"


def fractal_ground(name: str, *, size: int, seed: int) -> Dem:
    """Synthetic terrain around the printed target of a row, whose height is the mean of its central part."""
    target = printed.target_of(printed.TERRAINS[name])
    posts = fractal_posts(size, spacing=SPACING, rms_slope=RMS_SLOPES[name], seed=seed)
    centre = Geodetic(lat=target.lat, lon=target.lon, height=0.0)
    inner = slice(size // 2 - int(MIDDLE / SPACING), size // 2 + int(MIDDLE / SPACING) + 1)
    return tangent_dem(posts - posts[inner, inner].mean() + float(target.height), SPACING, centre)


def shots_in_sight(name: str, dem: Dem, *, places: int, seed: int) -> list[Shot]:
    """Shots of a row, moved sideways to see ground at the height of the printed target, near the terrain's centre.

    Raises `ValueError` if too few such places are visible.
    """
    row = printed.TERRAINS[name]
    shot, shots = printed.shot_of(row), []
    level = _fix(shot, printed.level_ground(row.target[2]))
    for lat, lon in _places(dem, row.target[2], seed):
        if len(shots) == places:
            return shots
        position = shot.pose.position
        where = (position.lat + lat - level.position.lat, position.lon + lon - level.position.lon)
        moved = eqx.tree_at(lambda shot: (shot.pose.position.lat, shot.pose.position.lon), shot, where)
        if _sees(moved, dem, lat, lon):
            shots.append(moved)
    if len(shots) < places:
        raise ValueError(
            f"{places} places of the {name} are asked for, but only {len(shots)} are in sight; ask for fewer."
        )
    return shots


def shots_over(name: str, dem: Dem, *, places: int, seed: int) -> list[Shot]:
    """Shots of a row over other ground, at visible places in its central part drawn from `seed`.

    Raises `ValueError` if there are too few.
    """
    row, shots = printed.TERRAINS[name], []
    posts = np.asarray(dem.posts)
    rows, cols = (np.arange(n)[int(0.3 * n) : int(0.7 * n)] for n in posts.shape)
    rng = np.random.default_rng([seed, 13])
    for rowcol in np.stack([rng.choice(rows, MOST_TRIED), rng.choice(cols, MOST_TRIED)], axis=1):
        if len(shots) == places:
            break
        height = float(posts[tuple(rowcol)])
        ((lat, lon),) = _latitudes(dem, rowcol[None])
        shot = printed.shot_of(row)
        where = (jnp.asarray(lat), jnp.asarray(lon), jnp.asarray(printed.ALTITUDE - row.target[2] + height))
        shot = _moved(shot, where)
        for _ in range(3):  # meridian convergence differs there, so the step is iterated
            level = _fix(shot, printed.level_ground(height)).position
            position = shot.pose.position
            shot = _moved(shot, (position.lat + lat - level.lat, position.lon + lon - level.lon, position.height))
        if _sees(shot, dem, lat, lon):
            shots.append(shot)
    if len(shots) < places:
        raise ValueError(f"{places} places are asked for, but only {len(shots)} are in sight; ask for fewer.")
    return shots


def _moved(shot: Shot, where: tuple[Any, Any, Any]) -> Shot:
    position = lambda shot: (shot.pose.position.lat, shot.pose.position.lon, shot.pose.position.height)  # noqa: E731
    return eqx.tree_at(position, shot, tuple(jnp.asarray(x, jnp.float64) for x in where))


def _sees(shot: Shot, dem: Dem, lat: float, lon: float) -> bool:
    """Whether the line of sight meets the ground at a position in rad."""
    fix = _fix(shot, dem)
    along_meridian, along_parallel = metres_per_radian(fix.position)
    north, east = (fix.position.lat - lat) * along_meridian, (fix.position.lon - lon) * along_parallel
    return bool(fix.ok) and math.hypot(float(north), float(east)) <= NEAR


def _places(dem: Dem, height: float, seed: int) -> list[list[float]]:
    """Latitude and longitude in rad of central posts of a terrain with about the required height, shuffled."""
    posts = np.asarray(dem.posts)
    rowcol = np.argwhere(np.abs(posts - height) <= LEVEL)
    rowcol = rowcol[np.all(np.abs(rowcol - (np.array(posts.shape) - 1) / 2.0) <= MIDDLE / SPACING, axis=1)]
    return _latitudes(dem, np.random.default_rng([seed, 11]).permutation(rowcol)[:MOST_TRIED])


def _latitudes(dem: Dem, rowcol: np.ndarray) -> list[list[float]]:
    """Latitude and longitude in rad of posts."""
    x, y, z = np.asarray(jax.vmap(dem.grid.normal)(jnp.asarray(rowcol, jnp.float64))).T
    return np.stack([np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)], axis=1).tolist()


def _rms_slope(dem: Dem) -> float:
    """Arctangent, in rad, of the root of the mean squared gradient between posts."""
    rows, cols = np.gradient(np.asarray(dem.posts), *np.asarray(dem.grid.cell_size()).tolist())
    return float(np.arctan(np.sqrt(np.mean(rows**2 + cols**2))))


def _fix(shot: Shot, terrain: AbstractTerrain) -> Fix:
    return ModelInputs.of(printed.sensor(), shot, printed.UV, terrain).nominal_fix(FIRST_HIT).fix


def _linear(
    what: tuple[str, str], method: str, shot: Shot, terrain: AbstractTerrain, slope: AbstractSlope, place: int = 0
) -> Accuracy:
    model = presets.li_2023(terrain_height=printed.DEM_SIGMA)
    found = propagate(printed.sensor(), shot, printed.UV, terrain, model, slope=slope)
    cov, bias = np.asarray(found.cov_enu), np.asarray(found.bias_enu)
    squares = np.diag(cov) + bias**2
    marks = np.array([np.sqrt(squares.sum()) / 1.2, printed.TERRAINS[what[0]].actual])
    ce50, ce90 = np.asarray(circular_error(cov[:2, :2], np.array([0.5, 0.9]), bias[:2])).tolist()
    held, within = np.asarray(circular_probability(cov[:2, :2], marks, bias[:2])).tolist()
    return _accuracy(what, method, place, found.fix.position, squares, (ce50, ce90, held, 1.0 - within, 1.0), cov)


def _drawn(
    what: tuple[str, str],
    shot: Shot,
    terrain: AbstractTerrain,
    samples: int,
    key: Array,
    place: int = 0,
) -> Accuracy:
    model = presets.li_2023(terrain_height=printed.DEM_SIGMA)
    found = sample(
        printed.sensor(), shot, printed.UV, terrain, model, key=key, count=samples, figures=("CE",), keep=True
    )
    squares = np.diag(found.cov_enu) + found.mean_enu**2
    held = float(np.mean(found.radii["CE"] <= np.sqrt(squares.sum()) / 1.2))
    beyond = float(np.mean(found.radii["CE"] > printed.TERRAINS[what[0]].actual))
    ce50, ce90 = (found.circular_error(p).value for p in (0.5, 0.9))
    figures = (ce50, ce90, held, beyond, found.found / found.count)
    return _accuracy(what, "sampled", place, found.fix.position, squares, figures, found.cov_enu, found.errors_enu)


def _accuracy(
    what: tuple[str, str],
    method: str,
    place: int,
    position: Geodetic,
    squares: np.ndarray,
    figures: tuple[float, ...],
    cov_enu: np.ndarray,
    errors_enu: np.ndarray | None = None,
) -> Accuracy:
    """A record from mean squares in m2 along east, north and up."""
    east, north, height = np.sqrt(squares).tolist()
    along_meridian, along_parallel = metres_per_radian(position)
    rms = float(np.sqrt(squares.sum()))
    return Accuracy(
        *(*what, method, place),
        lat_deg=math.degrees(north / along_meridian),
        lon_deg=math.degrees(east / along_parallel),
        north=north,
        east=east,
        height=height,
        rms=rms,
        rms_over_1_2=rms / 1.2,
        **dict(zip(("ce50", "ce90", "held", "beyond", "found"), figures, strict=True)),
        cov_enu=cov_enu,
        errors_enu=errors_enu,
    )
