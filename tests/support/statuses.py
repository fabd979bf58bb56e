"""Reference outcomes of rays over posts by the definitions of the statuses: an exhaustive march in NumPy alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo import Dem, Fix, Ray, intersect
from jaxgeo.status import Status
from support.fractal import ecef, normal_and_height

DEEPEST = -11_200.0  # m: a ray that gets lower before it is over the area misses it
FARTHEST = 2.0e8  # m
WALL = 1e-6  # m
NEAR = 1e-3  # m
WRONG_DISTANCE = 1e-3  # m
PER_CELL = 3  # samples along the ray per cell
COARSE = 24  # samples per length of the area, on the way to it
MARGIN = 1.0  # m above the ceiling where searches start: both outcomes are allowed for a ray that starts in between

STORED, RAYS = (121, 723), 64  # shape of stored posts and number of rays of the compiled intersection
LonLat = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Outcome:
    """Allowed statuses of a ray, and the range in m of the point returned with them (NaN if none).

    `margin` in m is the distance of the ray from another outcome: clearance before the hit, depth behind.
    """

    allowed: frozenset[Status]
    distance: float
    margin: float


@dataclass(frozen=True)
class Marched:
    """Bilinear ground through `posts` (rows, cols) in m, NaN where unknown, placed by `to_rowcol(lon, lat)` in deg.

    `turn` is the number of columns around the Earth, on a map in longitude and latitude; with `wraps` the first post of
    a row follows its last one. `size` is the length of the area in m, `cell` of a cell.
    """

    posts: np.ndarray
    to_rowcol: LonLat
    cell: float
    turn: float | None = None
    wraps: bool = False
    void_ceiling: float | None = None
    size: float = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "size", self.cell * min(max(self.posts.shape), 200))

    @property
    def void_top(self) -> float:
        return float(np.nanmax(self.posts)) if self.void_ceiling is None else self.void_ceiling

    @property
    def ceiling(self) -> float:
        highest = float(np.nanmax(self.posts))
        return max(highest, self.void_top) if np.isnan(self.posts).any() else highest

    def over(self, p: np.ndarray, near: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Row, column and height along a path (n, 3); columns continue across longitude jumps, or are those near
        `near`."""
        normal, height = normal_and_height(p)
        lon = np.degrees(np.arctan2(normal[:, 1], normal[:, 0]))
        lat = np.degrees(np.arctan2(normal[:, 2], np.hypot(normal[:, 0], normal[:, 1])))
        row, col = self.to_rowcol(lon, lat)
        if self.turn is not None and near is not None:
            col = col + self.turn * np.round((near - col) / self.turn)
        elif self.turn is not None:
            col = np.unwrap(col, period=self.turn)
        return row, col, height

    def clearance(self, p: np.ndarray, i: np.ndarray, j: np.ndarray, col: np.ndarray) -> np.ndarray:
        """Height above the patches of cells, with `col` the columns on the path."""
        row, at, height = self.over(p, col + 0.5)
        z, _ = self.corners(i, j)
        u, v = row - i, at - col
        return height - (z[0] * (1 - u) * (1 - v) + z[1] * (1 - u) * v + z[2] * u * (1 - v) + z[3] * u * v)

    def cells(self, row: np.ndarray, col: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """First row and column of the cells that contain positions, and whether they are inside the area."""
        i, j = np.floor(row), np.floor(col)
        rows, cols = self.posts.shape
        if self.turn is not None:
            j = np.floor(col % self.turn)
        last = cols - 1 if self.wraps else cols - 2
        inside = (i >= 0) & (i <= rows - 2) & (j >= 0) & (j <= last)
        return np.clip(i, 0, rows - 2).astype(int), np.clip(j, 0, last).astype(int), inside

    def corners(self, i: np.ndarray, j: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The four posts of cells (4, n), level at the ceiling of voids where one is unknown; and a mask of those."""
        right = (j + 1) % self.posts.shape[1]
        z = np.stack([self.posts[i, j], self.posts[i, right], self.posts[i + 1, j], self.posts[i + 1, right]])
        is_void = np.asarray(np.isnan(z).any(axis=0))
        return np.where(is_void, self.void_top, z), is_void

    def outcomes(self, origin: np.ndarray, direction: np.ndarray) -> list[Outcome]:
        """Outcomes of rays (n, 3) in ECEF."""
        lowest_at = _lowest(origin, direction)
        lowest = _height(origin, direction, lowest_at)
        exit_ = _crossing(origin, direction, lowest_at, np.full(len(origin), FARTHEST), self.ceiling)
        deep = _crossing(origin, direction, np.zeros(len(origin)), lowest_at, DEEPEST)
        begins = _height(origin, direction, np.zeros(len(origin)))
        is_deep = lowest < DEEPEST
        last = np.where(is_deep, np.where(begins < DEEPEST, 0.0, deep), exit_)
        sinks = _crossing(origin, direction, np.zeros(len(origin)), lowest_at, self.ceiling)
        sinks = np.where(begins < self.ceiling, 0.0, sinks)
        return [self._outcome(origin[k], direction[k], sinks[k], last[k], lowest[k]) for k in range(len(origin))]

    def _outcome(self, o: np.ndarray, d: np.ndarray, sinks: float, last: float, lowest: float) -> Outcome:
        if lowest >= self.ceiling + MARGIN:
            return Outcome(frozenset({Status.rises_away}), np.nan, np.inf)
        row, col, _ = self.over(o[None])
        i, j, inside = self.cells(row, col)
        buried = float(self.clearance(o[None], i, j, np.floor(col))[0])
        if inside[0] and not self.corners(i, j)[1][0] and buried < -WALL:
            return Outcome(frozenset({Status.camera_below_terrain}), np.nan, -buried)
        row, col, _ = self.over((o + sinks * d)[None])
        comes_from_above = bool(self.cells(row, col)[2][0])  # over the area where it descends below the ceiling
        path = self._pieces(o, d, sinks if comes_from_above else 0.0, last) if last > 0.0 else None
        if path is None or not path.inside.any():
            allowed = frozenset(
                {Status.ray_misses_terrain} | ({Status.rises_away} if lowest > self.ceiling - NEAR else set())
            )
            return Outcome(allowed, np.nan, np.inf if path is None else path.beside)
        outcome = self._followed(o, d, path, comes_from_above or bool(inside[0]))
        if lowest > self.ceiling - NEAR:  # between ceiling and margin, where no hit is possible
            return Outcome(outcome.allowed | {Status.rises_away}, np.nan, outcome.margin)
        return outcome

    def _followed(self, o: np.ndarray, d: np.ndarray, path: Pieces, starts_inside: bool) -> Outcome:
        """The first event on a path that reaches the area."""
        first = int(np.argmax(path.inside))
        is_void, clear = self.corners(path.i, path.j)[1], path.clear
        lowest = _parabola(*clear)
        met = path.inside & (np.minimum(np.minimum(clear[0], clear[2]), lowest) <= 0.0)
        met[:first] = False
        left = ~path.inside
        left[:first] = False
        k, out = (int(np.argmax(flags)) if flags.any() else len(flags) for flags in (met, left))
        before = lowest[first : min(k, out)]
        margin = min(float(np.min(before, initial=np.inf)), path.beside)
        entry = path.height[first] - self.ceiling
        from_side = not starts_inside and entry < 0.0
        if not starts_inside:
            margin = min(margin, abs(float(clear[0, first])), abs(float(entry)))
        if k >= len(met) or out < k:
            end = Status.leaves_terrain if out < len(left) else Status.rises_away
            return Outcome(frozenset({end}), np.nan, margin)
        margin = min(margin, abs(float(lowest[k])), abs(float(min(clear[0, k], clear[2, k]))))
        if is_void[k]:
            return Outcome(frozenset({Status.hits_void}), path.crossing(self, o, d, k), margin)
        if clear[0, k] < -WALL:
            end = Status.enters_below_terrain if k == first and not starts_inside else Status.hits_void
            return Outcome(frozenset({end}), np.nan if end == Status.enters_below_terrain else path.begin[k], margin)
        end = {Status.enters_from_side} if from_side else {Status.hit, Status.near_tangent}
        return Outcome(frozenset(end), path.crossing(self, o, d, k), margin)

    def _pieces(self, o: np.ndarray, d: np.ndarray, start: float, last: float) -> Pieces | None:
        """The path of a ray near the area, split where it crosses lines of posts; None if it does not come near."""
        rows, cols = self.posts.shape
        s = np.linspace(start, last, int(np.clip(COARSE * (last - start) / self.size, 48, 40_000)))
        row, col, _ = self.over(o + s[:, None] * d)
        step = np.maximum(np.abs(np.diff(row)), np.abs(np.diff(col)))
        step = 1.5 * np.maximum(np.append(step, 0.0), np.append(0.0, step)) + 2.0
        near = (row > -step) & (row < rows - 1 + step)
        if self.turn is None:
            near &= (col > -step) & (col < cols - 1 + step)
        elif not self.wraps:
            beyond = (col + 0.5 * (self.turn - cols)) % self.turn - 0.5 * (self.turn - cols)
            near &= (beyond > -step) & (beyond < cols - 1 + step)
        if not near.any():
            return None
        pair = near[:-1] | near[1:]
        counts = np.where(pair, np.ceil(PER_CELL * step[:-1]).astype(int), 1)
        fine = np.concatenate(
            [np.linspace(s[n], s[n + 1], counts[n], endpoint=False) for n in range(len(s) - 1)] + [s[-1:]]
        )
        row, col, _ = self.over(o + fine[:, None] * d)
        cuts = np.concatenate([fine, self._cuts(o, d, fine, row, col, 0), self._cuts(o, d, fine, row, col, 1)])
        return Pieces.of(self, o, d, np.unique(cuts))

    def _cuts(
        self, o: np.ndarray, d: np.ndarray, s: np.ndarray, row: np.ndarray, col: np.ndarray, which: int
    ) -> np.ndarray:
        """Ranges between samples `s` where the row (0) or the column (1) crosses an integer, by false position."""
        axis = (row, col)[which]
        whole = np.floor(axis)
        at = np.flatnonzero(whole[1:] != whole[:-1])
        line = np.maximum(whole[1:], whole[:-1])[at]
        low, high, below, above = s[at], s[at + 1], axis[at] - line, axis[at + 1] - line
        cut = low
        for _ in range(4 if at.size else 0):
            cut = low - below * (high - low) / (above - below)
            value = self.over(o + cut[:, None] * d, col[at])[which] - line
            is_low = np.sign(value) == np.sign(below)
            low, below = np.where(is_low, cut, low), np.where(is_low, value, below)
            high, above = np.where(is_low, high, cut), np.where(is_low, above, value)
            above = np.where(above == below, 1.0, above)
        return cut


@dataclass(frozen=True)
class Pieces:
    """Pieces of a ray's path between cuts: begin and end ranges, `height` at their begin; `clear` (3, n) are
    clearances over their cells (`i`, `j`, with `col` the column on the path) at begin, middle and end."""

    begin: np.ndarray
    end: np.ndarray
    height: np.ndarray
    clear: np.ndarray
    i: np.ndarray
    j: np.ndarray
    col: np.ndarray
    inside: np.ndarray
    beside: float

    @classmethod
    def of(cls, ground: Marched, o: np.ndarray, d: np.ndarray, cuts: np.ndarray) -> Pieces:
        begin, end = cuts[:-1], cuts[1:]
        middle = 0.5 * (begin + end)
        row, col, _ = ground.over(o + middle[:, None] * d)
        i, j, inside = ground.cells(row, col)
        first = np.floor(col)
        clear = np.stack([ground.clearance(o + s[:, None] * d, i, j, first) for s in (begin, middle, end)])
        height = normal_and_height(o + begin[:, None] * d)[1]
        return cls(begin, end, height, clear, i, j, first, inside, _beside(ground, row, col))

    def crossing(self, ground: Marched, o: np.ndarray, d: np.ndarray, k: int) -> float:
        """The range where the path first is below the patch of piece k: its begin, or a root refined by the secant
        method."""
        clear, begin, length = self.clear[:, k], self.begin[k], self.end[k] - self.begin[k]
        if clear[0] <= 0.0:
            return float(begin)
        bend, slope = 2.0 * (clear[0] + clear[2] - 2.0 * clear[1]), clear[2] - clear[0]
        roots = np.roots([bend, slope - bend, clear[0]]) if bend != 0.0 else np.array([-clear[0] / slope])
        roots = np.real(roots[np.isreal(roots)])
        at = float(np.min(roots[(roots >= 0.0) & (roots <= 1.0 + 1e-9)], initial=1.0))
        here_only = np.s_[k : k + 1]

        def value(share: float) -> float:
            p = (o + (begin + share * length) * d)[None]
            return float(ground.clearance(p, self.i[here_only], self.j[here_only], self.col[here_only])[0])

        before, previous = at - 1e-3, value(at - 1e-3)
        for _ in range(4):
            here = value(at)
            if here == previous:
                break
            at, before, previous = at - here * (at - before) / (here - previous), at, here
        return float(begin + at * length)


def _beside(ground: Marched, row: np.ndarray, col: np.ndarray) -> float:
    """Approximate distance in m to the outer lines of posts of a path that turns or touches without clearly
    crossing."""
    rows, cols = ground.posts.shape
    off = np.maximum(-row, row - (rows - 1))
    if not ground.wraps:
        if ground.turn is not None:
            half = 0.5 * (ground.turn - cols)
            col = (col + half) % ground.turn - half
        off = np.maximum(off, np.maximum(-col, col - (cols - 1)))
    return float(abs(off.min())) * ground.cell


def _parabola(first: np.ndarray, half: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Minimum of parabolas through three values."""
    bend = 2.0 * (first + last - 2.0 * half)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.where(bend > 0.0, np.clip((first - last + bend) / (2.0 * bend), 0.0, 1.0), 1.0)
    return first + at * (last - first - bend) + at * at * bend


def _height(origin: np.ndarray, direction: np.ndarray, s: np.ndarray) -> np.ndarray:
    return normal_and_height(origin + s[:, None] * direction)[1]


def _lowest(origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The non-negative range at which each ray is lowest: the height of a line is convex."""
    low, high = np.zeros(len(origin)), np.full(len(origin), FARTHEST)
    for _ in range(90):
        a, b = low + (high - low) / 3.0, high - (high - low) / 3.0
        falls = _height(origin, direction, a) > _height(origin, direction, b)
        low, high = np.where(falls, a, low), np.where(falls, high, b)
    return np.where(low < 1e-3, 0.0, 0.5 * (low + high))


def _crossing(
    origin: np.ndarray, direction: np.ndarray, low: np.ndarray, high: np.ndarray, height: float
) -> np.ndarray:
    """The range between two others at which a ray passes a height, if it does."""
    rises = _height(origin, direction, high) > _height(origin, direction, low)
    for _ in range(70):
        middle = 0.5 * (low + high)
        is_before = (_height(origin, direction, middle) < height) == rises
        low, high = np.where(is_before, middle, low), np.where(is_before, high, middle)
    return high


def aimed(
    rng: np.random.Generator,
    lon: np.ndarray,
    lat: np.ndarray,
    height: np.ndarray,
    *,
    elevation: tuple[float, float] = (-40.0, -0.2),
    back: tuple[float, float] = (0.0, 60e3),
    azimuth: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (n, 3) of rays through positions in deg and m, starting a drawn distance in m behind."""
    n = len(lon)
    p = ecef(np.radians(lat), np.radians(lon), height)
    up, _ = normal_and_height(p)
    east = np.stack([-up[:, 1], up[:, 0], np.zeros(n)], axis=-1)
    east /= np.linalg.norm(east, axis=1)[:, None]
    north = np.cross(up, east)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, n) if azimuth is None else azimuth
    climb = np.radians(rng.uniform(*elevation, n))
    level = np.sin(azimuth)[:, None] * east + np.cos(azimuth)[:, None] * north
    direction = np.cos(climb)[:, None] * level + np.sin(climb)[:, None] * up
    return p - rng.uniform(*back, n)[:, None] * direction, direction


def differences(outcomes: list[Outcome], status: np.ndarray, distance: np.ndarray, nearest: float) -> list[str]:
    """Disallowed results, for rays whose distance from another outcome is at least `nearest` m."""
    wrong = []
    for k, expected in enumerate(outcomes):
        told = Status(int(status[k]))
        if expected.margin < nearest:
            continue
        if told not in expected.allowed:
            wrong.append(f"ray {k}: {told.name}, not {' or '.join(s.name for s in expected.allowed)}")
        elif np.isfinite(expected.distance) and abs(distance[k] - expected.distance) > WRONG_DISTANCE:
            wrong.append(f"ray {k}: {told.name} at {distance[k]} m, not {expected.distance}")
    return wrong


def stored(posts: np.ndarray) -> np.ndarray:
    """Posts padded with NaN to the shape `STORED`, for a `Dem` whose `extent` is their shape."""
    more = np.full(STORED, np.nan)
    more[: posts.shape[0], : posts.shape[1]] = posts
    return more


@eqx.filter_jit
def _hits(rays: Ray, dem: Dem) -> Fix:
    return jax.vmap(intersect, in_axes=(0, None))(rays, dem)


def hits(rays: Ray, dem: Dem) -> Fix:
    """Fixes of rays, 64 at a time: one compiled program for all numbers of rays."""
    count = rays.origin.shape[0]
    rows = np.minimum(np.arange(-(-count // RAYS) * RAYS), count - 1).reshape(-1, RAYS)
    parts = [_hits(jax.tree.map(lambda x, row=row: jnp.asarray(x)[row], rays), dem) for row in rows]
    return jax.tree.map(lambda *x: np.concatenate(x)[:count], *parts)
