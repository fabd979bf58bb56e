"""DEM on disk: locates the terrain under rays block by block and loads only that."""

from __future__ import annotations

import contextlib
import functools
import math
import os
import pathlib
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import require_x64
from jaxgeo._record import check_loading
from jaxgeo.earth.ray import Ray
from jaxgeo.io.blocks import Blocks
from jaxgeo.io.dem import build_dem
from jaxgeo.io.errors import DemError, WindowTooLarge
from jaxgeo.io.gridding import make_grid
from jaxgeo.io.heights import POSSIBLE_HEIGHTS, Source, check_nodata_used, open_source
from jaxgeo.io.paths import Paths, with_full_names
from jaxgeo.io.reach import Reach
from jaxgeo.io.sightlines import BESIDE, Sightlines, sightlines
from jaxgeo.io.tiles import OpenFiles
from jaxgeo.io.vertical import VerticalDatum
from jaxgeo.io.voids import Nodata
from jaxgeo.io.windows import Window, padded_shape
from jaxgeo.terrain.dem import Dem
from jaxgeo.terrain.grid import AbstractGrid, GeographicGrid

MAX_POSTS = 16_777_216  # 4096 x 4096: a quarter of a GB of heights and bounds
PADDING = 2.25  # times a window's posts: largest size of its arrays, beyond 1024 posts a side
METRES_PER_DEGREE = 111_000.0
REUSE = 4  # times the posts needed: limit up to which an already compiled size is reused


def open_dem(
    path_or_paths: Paths,
    *,
    vertical_datum: VerticalDatum = None,
    height_range: tuple[float, float] | None = None,
    cache: str | os.PathLike[str] | None = None,
    band: int = 1,
    nodata: Nodata = None,
    height_unit: str | None = None,
    void_ceiling: float | int | None = None,
    dtype: Any = np.float64,
    assume_wgs84: bool = False,
    allow_remote: bool = False,
    allow_outside: bool = False,
) -> DemFiles:
    """Open a DEM of one or many files that is too large for memory; reads only the headers.

    `path_or_paths`, `vertical_datum`, `band`, `nodata`, `height_unit`, `dtype`, `assume_wgs84`, `allow_remote` and
    `allow_outside` are as in `read_dem`.

    - `height_range`: (lowest, highest) in m above the ellipsoid, if you know bounds of all posts; a post outside them
      is refused. It avoids the pass over all files that `DemFiles.highest` may need.
    - `cache`: a file that stores the height bounds of blocks for the next run; it is rebuilt if a file's time or size,
      or a reading option, has changed.
    - `void_ceiling`: height in m up to which the ground may rise over voids and outside all tiles: by default that
      of the highest post of all files (use 0 at a coast).

    GDAL has its own cache in addition, 5 % of the machine's memory unless the environment variable GDAL_CACHEMAX sets
    another size. Raises `FileNotFoundError`, `VerticalDatumError` or another `DemError` with the file
    and the reason; `RuntimeError` with 64-bit floats off.
    """
    asked = dict(locals())
    require_x64()
    source = open_source(
        path_or_paths,
        band=band,
        vertical_datum=vertical_datum,
        nodata=nodata,
        height_unit=height_unit,
        assume_wgs84=assume_wgs84,
        reach=Reach(allow_remote, allow_outside),
    )
    if height_range is not None:
        low, high = (float(height) for height in height_range)
        if not (np.isfinite(low) and np.isfinite(high) and low < high):
            raise DemError(f"{source.name}: height_range must be (lowest, highest) in m; got {height_range!r}.")
        height_range = low, high
    if void_ceiling is not None and not np.isfinite(void_ceiling):
        raise DemError(f"{source.name}: void_ceiling must be a finite height in m; got {void_ceiling!r}.")
    blocks = Blocks(source, height_range, None if cache is None else pathlib.Path(cache))
    files = DemFiles(source, blocks, None if void_ceiling is None else float(void_ceiling), np.dtype(dtype))
    files._opened_by = functools.partial(open_dem, **with_full_names(asked))
    return files


class DemFiles:
    """A mosaic of files on one grid, of any size; made by `open_dem`. Rows and columns count from its first post.

    First hits are computed through `corridor`, or for batches of rays through `intersect_files` and `locate_files`:
    the same as for the whole mosaic in one `Dem`, but only terrain that rays can touch is in memory. It keeps the
    lowest and highest post of every requested block of 256 x 256 cells, and the sizes of the windows it has made.

    It can be pickled, for example as an argument of a worker process. The worker reopens the files by their full names
    and reuses the known bounds; loading raises `FileNotFoundError` if the files are missing there.
    """

    _opened_by: Callable[[], DemFiles]

    def __init__(
        self,
        source: Source,
        blocks: Blocks,
        void_ceiling: float | None,
        dtype: np.dtype,
        identity: str | None = None,
    ) -> None:
        self.source = source
        self.blocks = blocks
        self.dtype = dtype
        self.posts_loaded = 0
        """Posts read for windows so far; `blocks.posts_read` counts those read for bounds."""
        self._void_ceiling = void_ceiling
        self._sizes: list[tuple[int, int]] = []
        self._whole: DemFiles | None = None
        options = void_ceiling, blocks.height_range, f"{dtype}"
        self.identity = f"{blocks.identity()} {options}" if identity is None else identity
        """Key of the files, with their times and sizes, and of the options that change what is read from them."""
        self.grid: AbstractGrid | None = None
        with contextlib.suppress(DemError):  # too large for one fitted map: fit one per window
            self.grid = make_grid(source.name, source.mapping)[0]

    def forgetful(self) -> DemFiles:
        """The same files without what is known of their heights, except those of the whole: the windows of rays, and so
        the rounding of their fixes, do not depend on what was read before."""
        blocks = Blocks(self.source, self.blocks.height_range, None)
        files = DemFiles(self.source, blocks, self._void_ceiling, self.dtype, self.identity)
        files._whole, files._opened_by = self, self._opened_by
        return files

    def __reduce__(self) -> tuple[Any, ...]:
        return _reopened, (self._opened_by, self.blocks.known(), self._sizes)

    def __repr__(self) -> str:
        rows, cols = self.shape
        known = 100.0 * float(self.blocks.is_read.mean())
        return (
            f"DemFiles({self.source.name}: {rows} x {cols} posts, {self.source.mosaic.first.crs.name}, heights from "
            f"{self.source.shift.name}; bounds known of {known:.0f} % of it)"
        )

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the whole mosaic, with the gaps between its tiles."""
        return self.source.window.shape

    @property
    def highest(self) -> float:
        """Upper bound in m of all posts: `height_range` if given, else by one pass over all files, block by block.

        Exact where the vertical datum is a constant offset; else at most some decimetres too high.
        """
        return self._range()[1]

    @property
    def lowest(self) -> float:
        """Lower bound in m of all posts; as `highest`."""
        return self._range()[0]

    @property
    def void_ceiling(self) -> float:
        """Height in m up to which unknown ground may rise: the same for every window."""
        return self.highest if self._void_ceiling is None else self._void_ceiling

    @property
    def ceiling(self) -> float:
        """Height in m above which there is no ground, known or unknown."""
        return max(self.highest, self.void_ceiling)

    @property
    def floor(self) -> float:
        """Height in m below which no intersection can lie."""
        return min(self.lowest, self.void_ceiling)

    def corridor(self, rays: Ray, *, margin: int = 0, max_posts: int = MAX_POSTS) -> Dem:
        """The part of the terrain that rays can touch; `intersect` gives the same result as over the whole mosaic.

        `rays` is one `Ray` or a batch, ECEF. The window holds every cell under each ray from its own ceiling to the
        point where the ray has certainly hit the ground, is above all terrain, or leaves the mosaic; so no ray crosses
        the window's edge before its first hit. This holds only for these rays and the first hit: other rays and
        searches may meet the edge. Where a ray crosses the mosaic's own edge, the window has the whole mosaic's ceiling
        and needs `highest`; so do voids, without a `void_ceiling`.

        `margin` adds posts on every side for rays between the given ones, such as those of an image whose corners and
        edges were given. One case differs: a ray that leaves the mosaic above its ceiling has no window and gets
        `ray_misses_terrain` (`intersect_files` gives `leaves_terrain`). On maps without an exact grid (too large for
        one fit), windows differ from each other by up to 1 mm.

        Raises `DemError` for rays too far apart for one window of `max_posts`; `intersect_files` makes several.
        """
        path = self.follow(rays)
        window, ceiling = self.window_under(path)
        if window is None:
            raise DemError(
                f"{self.source.name}: none of the {len(path.exists)} rays can touch the ground of these files: they "
                f"pass beside it or above it. Are they in ECEF and in m?"
            )
        if self.too_large(window, max_posts):
            whose = "the ray" if len(path.exists) == 1 else f"these {len(path.exists)} rays together"
            raise self.refuse(window, max_posts, whose)
        if margin:  # higher ground in it may ask for a larger window
            window, ceiling = self.window_under(path, margin=margin)
            assert window is not None
        return self.load(window, whole_ceiling=ceiling, max_posts=max_posts)

    def follow(self, rays: Ray) -> Sightlines:
        """Paths of rays over the mosaic and where they may hit the ground, from the block bounds."""
        origin, direction = (np.asarray(part, np.float64) for part in (rays.origin, rays.direction))
        if origin.shape != direction.shape or origin.shape[-1:] != (3,):
            raise ValueError(
                f"rays must hold origins and directions of one shape (..., 3); got {origin.shape}, {direction.shape}."
            )
        flat = Ray(origin.reshape(-1, 3), direction.reshape(-1, 3))
        top = self.ceiling + 1.0 if self._knows_range() else POSSIBLE_HEIGHTS[1]
        return sightlines(flat, self.source.mapping, self.grid, self.blocks, top, lambda: self.void_ceiling)

    def window_under(self, path: Sightlines, area: Window | None = None, margin: int = 0) -> tuple[Window | None, bool]:
        """The smallest window for all rays of `path`, and whether it needs the whole mosaic's ceiling.

        It holds an `area`, too, and `margin` posts more on every side. None where no ray passes over the mosaic. If a
        window's own highest ground is its ceiling, it must hold the rays from that height down; growing it may raise
        the ceiling, so this iterates.
        """

        def enlarged(own: Window) -> Window:
            return self.wider(own if area is None else own.joined(self._near(area, own)), margin)

        if not path.is_simple[path.exists].all():
            window = self._around(path, self.ceiling)
            return None if window is None else enlarged(window), True
        window = self._around(path, -np.inf)
        while window is not None:
            larger = self._around(path, self._ceiling_of(enlarged(window)))
            if larger == window:
                return enlarged(window), False
            window = larger
        return None, False

    def window_of_places(self, lon: np.ndarray, lat: np.ndarray) -> Window | None:
        """The smallest window with the ground at positions (n,) in deg; None if none lies on the mosaic."""
        row, col = self.source.mapping.rowcol(lon, lat)
        if self.blocks.turn is not None:
            col = np.remainder(col, self.blocks.turn)
            if np.ptp(col) > 0.5 * self.blocks.turn:  # across the seam
                col = np.where(col < 0.5 * self.blocks.turn, col + self.blocks.turn, col)
        (rows, cols), turn = self.shape, self.blocks.turn
        inside = np.isfinite(row) & np.isfinite(col) & (row > -1.0) & (row < rows)
        inside &= (col > -1.0) & ((col < cols) if turn is None else True)
        if not inside.any():
            return None
        r0, c0 = (math.floor(x[inside].min()) - 1 for x in (row, col))
        r1, c1 = (math.floor(x[inside].max()) + 3 for x in (row, col))
        return self.wider(Window(r0, c0, r1, c1), 0)

    def _near(self, area: Window, window: Window) -> Window:
        """An area, on a mosaic around the Earth moved by whole turns so that it lies beside a window."""
        if self.blocks.turn is None:
            return area
        off = 0.5 * (window.col + window.stop_col - area.col - area.stop_col)
        return area.moved(0, round(off / self.blocks.turn) * self.blocks.turn)

    @property
    def middle_grid(self) -> AbstractGrid:
        """The grid of the whole mosaic, or where none matches it, that of its middle."""
        if self.grid is not None:
            return self.grid
        row, col = (max(n // 2 - 1, 0) for n in self.shape)
        return self._grid_of(Window(row, col, row + 2, col + 2))

    def posts_of(self, window: Window, metres: float) -> int:
        """Number of posts that a distance in m takes in the middle of a window, along the finer axis."""
        row, col = 0.5 * (window.row + window.stop_row), 0.5 * (window.col + window.stop_col)
        lon, lat = self.source.mapping.lonlat(row + np.array([0.0, 1.0, 0.0]), col + np.array([0.0, 0.0, 1.0]))
        east = np.remainder(lon - lon[0] + 180.0, 360.0) - 180.0
        steps = np.hypot(east * np.cos(np.radians(lat[0])), lat - lat[0])[1:] * METRES_PER_DEGREE
        return min(int(np.ceil(metres / steps.min())), max(self.shape))

    def load(
        self,
        window: Window,
        *,
        whole_ceiling: bool,
        max_posts: int = MAX_POSTS,
        size: tuple[int, int] | None = None,
    ) -> Dem:
        """Load one window as a `Dem`, its arrays padded to `size` (rows, cols), by default to one of a few sizes."""
        with OpenFiles() as files:
            heights, void = self.source.heights(window, self.dtype, files)
        self.posts_loaded += heights.size
        ceiling = self.void_ceiling if void.any() else None
        if void.all():  # no data here: a single post does not define a cell
            void[0, 0], heights[0, 0] = False, np.floor(self.void_ceiling)
        size = self.size_for(window, max_posts) if size is None else size
        dem = build_dem(self.source.name, heights, void, self._grid_of(window), ceiling, size)
        if not whole_ceiling:
            return dem
        limits = tuple(jnp.asarray(end, jnp.float64) for end in (self.floor, self.ceiling))  # as those of a window
        return eqx.tree_at(lambda d: (d.lowest, d.highest), dem, limits)

    def size_for(self, window: Window, max_posts: int = MAX_POSTS) -> tuple[int, int]:
        """(rows, cols) of the arrays for a window: a size used before if not much too large, else a new one."""
        size = padded_shape(window.shape)
        posts = size[0] * size[1]
        most = min(REUSE * posts, max(PADDING * max_posts, posts))
        fits = [s for s in self._sizes if s[0] >= window.shape[0] and s[1] >= window.shape[1] and s[0] * s[1] <= most]
        if fits:
            return min(fits, key=lambda s: s[0] * s[1])
        self._sizes.append(size)
        return size

    def too_large(self, window: Window | None, max_posts: int) -> bool:
        """Whether a window holds more than `max_posts`."""
        return window is not None and window.shape[0] * window.shape[1] > max_posts

    def refuse(self, window: Window, max_posts: int, whose: str) -> WindowTooLarge:
        """Error for a window that is too large."""
        return WindowTooLarge(
            f"{self.source.name}: {whose} can touch {window.shape[0]} x {window.shape[1]} posts, more than "
            f"max_posts={max_posts}. Allow more posts, or give rays that are closer together or steeper."
        )

    def _knows_range(self) -> bool:
        return self.blocks.height_range is not None or bool(self.blocks.is_read.all())

    def _range(self) -> tuple[float, float]:
        if self._whole is not None:
            return self._whole._range()
        if self.blocks.height_range is not None:
            return self.blocks.height_range
        was_read = bool(self.blocks.is_read.any())
        self.blocks.read()
        if not was_read:  # else some posts were read in an earlier run
            check_nodata_used(self.source, None)
        low, high = float(self.blocks.low.min()), float(self.blocks.high.max())
        if not np.isfinite(low):
            raise DemError(f"{self.source.name}: all posts are void: there is no terrain here.")
        return low, high

    def _ceiling_of(self, window: Window) -> float:
        """Upper bound of a window's ceiling."""
        rows = window.row // self.blocks.size, (window.stop_row - 2) // self.blocks.size
        cols = window.col // self.blocks.size, self.blocks.column_of(window.stop_col - 2)
        wanted = np.zeros(self.blocks.shape, bool)
        self.blocks.mark(wanted, rows, cols)
        self.blocks.read(wanted)
        _, high, has_void = self.blocks.bounds(rows, cols)
        return max(high, self.void_ceiling) if has_void else high

    def _around(self, path: Sightlines, ceiling: float) -> Window | None:
        """The window that holds the segments needed for a search from `ceiling`; None if there are none."""
        needed = path.needed(ceiling)
        rows, cols = self.shape
        low, high = path.low[needed] - BESIDE, path.high[needed] + BESIDE
        over = (low[:, 0] <= rows - 1) & (high[:, 0] >= 0.0)
        if self.blocks.turn is None:
            over &= (low[:, 1] <= cols - 1) & (high[:, 1] >= 0.0)
        if not over.any():
            return None
        r0, c0 = (int(edge) for edge in np.floor(low[over].min(axis=0)))
        r1, c1 = (int(edge) + 2 for edge in np.floor(high[over].max(axis=0)))
        r0, r1 = max(r0, 0), min(r1, rows)
        if self.blocks.turn is None:
            c0, c1 = max(c0, 0), min(c1, cols)
        elif c1 - c0 >= self.blocks.turn:
            c0, c1 = 0, self.blocks.turn + 2  # its ends overlap
        else:
            start = c0 % self.blocks.turn
            c0, c1 = start, c1 - c0 + start
        return Window(min(r0, rows - 2), c0 if self.blocks.turn else min(c0, cols - 2), max(r1, 2), max(c1, 2))

    def wider(self, window: Window, margin: int) -> Window:
        """A window enlarged by `margin` posts on every side, within the mosaic."""
        (rows, cols), turn = self.shape, self.blocks.turn
        col, stop_col = window.col - margin, window.stop_col + margin
        if turn is None:
            col, stop_col = max(col, 0), min(stop_col, cols)
        elif stop_col - col >= turn:
            col, stop_col = 0, turn + 2
        else:
            col, stop_col = col % turn, col % turn + stop_col - col
        return Window(max(window.row - margin, 0), col, min(window.stop_row + margin, rows), stop_col)

    def _grid_of(self, window: Window) -> AbstractGrid:
        mapping = self.source.mapping.window(window.row, window.col, window.shape)
        if self.blocks.turn is not None and isinstance(self.grid, GeographicGrid):  # its own seam may be in the window
            return GeographicGrid.from_affine(mapping.affine, window.shape)
        if self.grid is not None:
            return self.grid.window(jnp.asarray(float(window.row)), jnp.asarray(float(window.col)))
        return make_grid(self.source.name, mapping)[0]


def _reopened(opened_by: Callable[[], DemFiles], known: dict[str, Any], sizes: list[tuple[int, int]]) -> DemFiles:
    check_loading(DemFiles)
    files = opened_by()
    files.blocks.take(known)
    files._sizes = list(sizes)
    return files
