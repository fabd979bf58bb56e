"""Highest-density regions of the truth on the ground, probability maps, and the probability of an area."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, NamedTuple

import numpy as np
import scipy

from jaxgeo._checks import check_is
from jaxgeo._record import portable
from jaxgeo.earth import WGS84, Geodetic, R_ecef_from_enu
from jaxgeo.fix import Fix
from jaxgeo.sensor import Shot
from jaxgeo.terrain import Dem
from jaxgeo.terrain.grid import AbstractGrid
from jaxgeo.uncertainty._ground_density import Cells, ground_density
from jaxgeo.uncertainty._level_sets import level_set
from jaxgeo.uncertainty._region_frame import Frame, level_grid, on_grid, places_of, rowcol_of
from jaxgeo.uncertainty._region_polygon import checked_polygon
from jaxgeo.uncertainty._region_words import mode_words, region_words
from jaxgeo.uncertainty.intervals import Share, share_of
from jaxgeo.uncertainty.sampled_record import Sampled

FEWEST = 100  # samples with ground that a density needs
BEYOND = 0.70  # cosine of 45 degrees: farther, nearer, left, right


@portable
@dataclasses.dataclass(frozen=True, eq=False)
class Mode:
    """A connected piece of a region.

    `share` of all samples, `polygon` in deg of longitude and latitude, `polygon_enu` in m east and north of the fix
    (both shapely), `area` in m2. `position` is the mean of its samples, `distance` in m and `azimuth` in rad those from
    the fix, `rise` in m its height over the fix; `beside` is "farther", "nearer", "left" or "right" as the camera sees
    it from the fix, "" if the camera is not known. `holds_fix` is true if the fix lies in it.
    """

    share: Share
    polygon: Any
    polygon_enu: Any
    area: float
    position: Geodetic
    distance: float
    azimuth: float
    rise: float
    beside: str
    holds_fix: bool

    @property
    def words(self) -> str:
        """Share and place, as "34 % lie 1.2 km to the north-east, farther from the camera, 85 m higher"."""
        return mode_words(self)


@portable
@dataclasses.dataclass(frozen=True, eq=False)
class Region:
    """Highest-density region: the smallest area on the ground that holds the truth with a probability.

    `polygon` is a shapely multipolygon in deg of longitude (within 180 deg of the fix) and latitude on WGS 84;
    `polygon_enu` the same in m east and north of the fix, `area` in m2 on its level plane. `cells` (m, 2) are the (row,
    col) of the centres of its cells on `grid`, with `cell_probability` (m,), from the densest to the thinnest. `modes`
    are its connected pieces, the largest share first. `inside` and `outside` are the shares of the samples in it and
    out of it, `without_ground` that of the samples without a fix, which are outside. Intervals are at `confidence`.
    """

    probability: float
    fix: Fix
    polygon: Any
    polygon_enu: Any
    area: float
    grid: AbstractGrid
    cells: np.ndarray
    cell_probability: np.ndarray
    modes: tuple[Mode, ...]
    inside: Share
    outside: Share
    without_ground: Share
    confidence: float

    @property
    def words(self) -> str:
        """The pieces with their shares and places, in a sentence each."""
        return region_words(self)

    def __repr__(self) -> str:
        return f"Region({self.words})"


@portable
@dataclasses.dataclass(frozen=True, eq=False)
class ProbabilityMap:
    """Probability of the truth in each cell of a grid, from samples.

    `cells` (m, 2) are the (row, col) of centres on `grid`, from the densest to the thinnest, `size` the (rows, cols) of
    a cell in posts of the grid, `probability` (m,) sums to `found`, the share of the samples with a fix. `post` is the
    size in m of the grid's posts at the fix, along rows and columns.
    """

    fix: Fix
    grid: AbstractGrid
    cells: np.ndarray
    size: np.ndarray
    probability: np.ndarray
    post: np.ndarray
    found: float
    confidence: float
    _density: Cells
    _samples: _Samples

    @property
    def cell_size(self) -> tuple[float, float]:
        """Length in m of a cell along a column and along a row."""
        down, across = (self.size * self.post).tolist()
        return down, across

    @property
    def count(self) -> int:
        """Number of samples, with and without a fix."""
        return self._samples.count

    def lonlat_deg(self, rowcol: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Longitudes (within 180 deg of the fix) and latitudes (m,) in deg of the centres of the cells.

        Or of other places (m, 2) at (row, col) of the grid.
        """
        lon, lat = Frame.of(self.fix, self.grid).places(self.cells if rowcol is None else rowcol)[:, :2].T
        return lon, lat

    def density_at(self, lon_deg: Any, lat_deg: Any) -> np.ndarray:
        """Probability per m2 at longitudes and latitudes in deg, bilinear between the centres of cells.

        Zero where no cell has a probability, and for coordinates that are not finite.
        """
        lon, lat = (np.radians(np.asarray(x, np.float64)) for x in np.broadcast_arrays(lon_deg, lat_deg))
        known = np.isfinite(lon) & np.isfinite(lat)
        lonlat = np.stack([lon[known], lat[known]], axis=-1)
        density = np.zeros(lon.shape)
        if len(lonlat):
            rowcol = rowcol_of(lonlat, self.grid)
            density[known] = scipy.ndimage.map_coordinates(
                self._whole(), self._density.place(rowcol).T, order=1, cval=0.0
            )
        return np.asarray(density / math.prod(self.cell_size))

    def _whole(self) -> np.ndarray:
        """Probabilities (rows, cols) of all cells about the samples."""
        array = np.zeros(math.prod(self._density.shape))
        array[self._density.index] = self.probability
        return array.reshape(self._density.shape)

    def region(self, probability: float = 0.9) -> Region:
        """`Sampled.region` from this map: regions of several probabilities from one density, each within the next."""
        return _region(self, checked_probability(probability))


class _Samples(NamedTuple):
    """Samples with ground of `count`: places (n,) among them, offsets (n, 3), (row, col) (n, 2), positions (n, 3)."""

    places: np.ndarray
    offsets: np.ndarray
    rowcol: np.ndarray
    latlonh: np.ndarray
    count: int
    how: dict[str, Any]
    looking: np.ndarray | None


def probability_map(sampled: Sampled, *, dem: Dem | None = None) -> ProbabilityMap:
    """`Sampled.probability_map`."""
    samples, grid = _on_grid(sampled, dem)
    frame = Frame.of(sampled.fix, grid)
    post = frame.post_size()
    density = ground_density(samples.rowcol, post)
    cells = density.rowcol(np.stack(np.divmod(density.index, density.shape[1]), axis=1).astype(float))
    found = len(samples.places) / samples.count
    return ProbabilityMap(
        fix=sampled.fix,
        grid=grid,
        cells=cells,
        size=density.size,
        probability=density.probability * found,
        post=post,
        found=found,
        confidence=sampled.confidence,
        _density=density,
        _samples=samples,
    )


def probability_within(sampled: Sampled, polygon: Any) -> Share:
    """`Sampled.probability_within`."""
    import shapely  # polygon library, needed by these functions only

    area = checked_polygon(polygon)
    offsets, places = _offsets(sampled)
    lon, lat = np.degrees(places_of(sampled.fix, offsets)[:, [1, 0]]).T
    shapely.prepare(area)
    inside = np.zeros(len(lon), bool)
    for turn in (-360.0, 0.0, 360.0):
        inside |= shapely.contains_xy(area, lon + turn, lat)
    if not inside.any() and len(lon):
        swapped = shapely.transform(area, lambda xy: xy[:, ::-1])
        if swapped.intersects(shapely.box(lon.min(), lat.min(), lon.max(), lat.max())):
            raise ValueError(
                "the polygon holds no sample, but would with its coordinates exchanged: they must be (longitude, "
                "latitude) in degrees, and seem to be (latitude, longitude)."
            )
    return share_of(places[inside], sampled.count, **_how(sampled))


def checked_probability(probability: Any) -> float:
    """A probability as a float. Raises `ValueError` unless it lies between 0 and 1."""
    if (
        isinstance(probability, bool | str)
        or np.ndim(probability)
        or probability is None
        or not 0.0 < probability < 1.0
    ):
        raise ValueError(f"probability must lie between 0 and 1, such as 0.9; got {probability!r}.")
    return float(probability)


# The region of a map.


def _region(found: ProbabilityMap, probability: float) -> Region:
    import shapely

    samples, density = found._samples, found._density
    if probability > found.found:
        raise ValueError(
            f"no region holds the truth with {100.0 * probability:g} %: {100.0 * (1.0 - found.found):.3g} % of the "
            f"samples have no ground (a line of sight that misses the terrain, or meets a void). Ask for less than "
            f"{100.0 * found.found:.4g} %, or sample over a larger terrain."
        )
    held = np.cumsum(density.probability)
    count = min(int(np.searchsorted(held, probability / found.found)) + 1, len(held))
    level = _level(density.density, count)
    row, col = np.divmod(density.index, density.shape[1])
    first = np.maximum(np.array([row[:count].min(), col[:count].min()]) - 2, 0)
    last = np.array([row[:count].max(), col[:count].max()]) + 3
    window = np.zeros(last - first)
    near = (row >= first[0]) & (row < last[0]) & (col >= first[1]) & (col < last[1])
    window[row[near] - first[0], col[near] - first[1]] = density.density[near]
    shape = level_set(window, level)
    posts = shapely.transform(shape, lambda at: density.rowcol(first + at))
    members = density.density_at > level
    places = Frame.of(found.fix, found.grid).places(shapely.get_coordinates(posts))
    in_degrees, in_metres = (shapely.set_coordinates(shapely.MultiPolygon(posts), p) for p in np.hsplit(places, 2))
    _check_no_jump(in_degrees)
    pieces = zip(posts.geoms, in_degrees.geoms, in_metres.geoms, strict=True)
    modes = [_mode(*piece, found, members) for piece in pieces]
    modes.sort(key=lambda mode: (-mode.share.value, -mode.area))
    places = samples.places[members]
    known = np.zeros(samples.count, bool)
    known[places] = True
    without = np.ones(samples.count, bool)
    without[samples.places] = False
    return Region(
        probability=probability,
        fix=found.fix,
        polygon=shapely.MultiPolygon([mode.polygon for mode in modes]),
        polygon_enu=shapely.MultiPolygon([mode.polygon_enu for mode in modes]),
        area=float(sum(mode.area for mode in modes)),
        grid=found.grid,
        cells=found.cells[:count],
        cell_probability=found.probability[:count],
        modes=tuple(modes),
        inside=_chosen_share(places, samples),
        outside=_chosen_share(np.flatnonzero(~known), samples),
        without_ground=share_of(np.flatnonzero(without), samples.count, **samples.how),
        confidence=found.confidence,
    )


def _chosen_share(places: Any, samples: Any) -> Share:
    """Share of the samples in an area that they chose themselves, with the interval of independent draws: that of
    Sobol points by their scrambles, a fifth as wide, leaves out the error of the choice."""
    return share_of(places, samples.count, samples.how["confidence"])


def _check_no_jump(polygon: Any) -> None:
    """Raise `ValueError` if longitude jumps along a ring: about a pole."""
    for part in polygon.geoms:
        for ring in (part.exterior, *part.interiors):
            if np.abs(np.diff(np.asarray(ring.coords)[:, 0])).max() > 180.0:
                raise ValueError(
                    "the region surrounds a pole, or reaches beyond it: no polygon in longitude and latitude holds it. "
                    "Ask for a smaller probability, or use probability_map, whose cells are on the grid of the DEM."
                )


def _level(density: np.ndarray, count: int) -> float:
    """A density between those of the last cell of a region and the next one, or a little below the last of all."""
    last = float(density[count - 1])
    following = density[count:]
    lower = following[following < last]
    return 0.5 * (last + float(lower[0])) if lower.size else last * (1.0 - 1e-9)


def _mode(piece: Any, in_degrees: Any, in_metres: Any, found: ProbabilityMap, members: np.ndarray) -> Mode:
    """A connected piece, given in (row, col), in degrees and in m on the level plane."""
    import shapely

    samples = found._samples
    shapely.prepare(piece)
    inside = shapely.contains_xy(piece, *samples.rowcol.T)
    own = np.flatnonzero(inside & members)
    share = _chosen_share(samples.places[own], samples)
    if not own.size:  # between samples
        own = np.array([np.argmin(np.linalg.norm(samples.rowcol - np.array(piece.centroid.coords[0]), axis=1))])
    lat, lon, height = samples.latlonh[own].mean(axis=0)
    east, north = samples.offsets[own, :2].mean(axis=0)
    distance, azimuth = math.hypot(east, north), math.atan2(east, north) % (2.0 * math.pi)
    polygon, level = shapely.orient_polygons(in_degrees), shapely.orient_polygons(in_metres)
    return Mode(
        share=share,
        polygon=polygon,
        polygon_enu=level,
        area=float(level.area),
        position=Geodetic(lat=lat, lon=lon, height=height),
        distance=distance,
        azimuth=azimuth,
        rise=float(height - np.asarray(found.fix.position.height)),
        beside=_beside(np.array([east, north]), samples.looking),
        holds_fix=bool(level.contains(shapely.Point(0.0, 0.0))),
    )


def _beside(offset: np.ndarray, looking: np.ndarray | None) -> str:
    """Where an offset from the fix lies as the camera sees it, which looks along `looking` (east, north)."""
    if looking is None or not np.any(offset):
        return ""
    along, right = offset @ looking, offset @ np.array([looking[1], -looking[0]])
    length = BEYOND * math.hypot(along, right)
    if abs(along) >= length:
        return "farther" if along > 0.0 else "nearer"
    return "right" if right > 0.0 else "left"


# Samples on a grid.


def _offsets(sampled: Sampled) -> tuple[np.ndarray, np.ndarray]:
    """(offsets (n, 3) from the fix in m, places (n,) among all) of the samples with ground."""
    if sampled.errors_enu is None:
        raise ValueError("the samples themselves are needed, and were not kept: sample(..., keep=True) returns them.")
    offsets = np.asarray(sampled.errors_enu) + np.asarray(sampled.centre_enu)
    places = np.flatnonzero(np.isfinite(offsets).all(axis=1))
    return offsets[places], places


def _how(sampled: Sampled) -> dict[str, Any]:
    """What `share_of` needs to know of the samples."""
    of = {"confidence": sampled.confidence, "scrambles": sampled.scrambles}
    return of | {"scramble_of": sampled.scramble_of}


def _on_grid(sampled: Sampled, dem: Any) -> tuple[_Samples, AbstractGrid]:
    check_is(sampled, Sampled, "sampled", "Make them with jaxgeo.uncertainty.sample.")
    if dem is not None:
        check_is(dem, Dem, "dem", "Read one with jaxgeo.io.read_dem.")
    offsets, places = _offsets(sampled)
    if len(places) < FEWEST:
        raise ValueError(
            f"a density on the ground needs {FEWEST} samples with ground or more; got {len(places)} of "
            f"{sampled.count}. Draw more, or see why lines of sight find none: {_reasons(sampled)}."
        )
    model = _origin(sampled, "errors")
    if model is not None and model.is_exact:
        raise ValueError(
            "all standard deviations of the errors are zero: the truth is at the fix, and a point has no region and no "
            "density."
        )
    terrain = dem if dem is not None else _origin(sampled, "terrain")
    grid = terrain.grid if isinstance(terrain, Dem) else level_grid(sampled.fix)
    found = on_grid(sampled.fix, offsets, grid)
    looking = _looking(sampled)
    return _Samples(places, offsets, found[:, 3:], found[:, :3], sampled.count, _how(sampled), looking), grid


def _reasons(sampled: Sampled) -> str:
    return ", ".join(f"{status.name} {number}" for status, number in sampled.statuses.items())


def _origin(sampled: Sampled, name: str) -> Any:
    return None if sampled.origin is None else sampled.origin.value(name)


def _looking(sampled: Sampled) -> np.ndarray | None:
    """Direction (east, north) from the camera to the fix on the level plane; None if not known, or straight down."""
    shot = _origin(sampled, "shot")
    if not isinstance(shot, Shot):
        return None
    camera = np.asarray(WGS84.to_ecef(shot.pose.position))
    towards = ((np.asarray(sampled.fix.ecef) - camera) @ np.asarray(R_ecef_from_enu(sampled.fix.position)))[:2]
    length = float(np.linalg.norm(towards))
    return towards / length if length > 1.0 else None
