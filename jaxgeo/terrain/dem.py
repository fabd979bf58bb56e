"""Digital elevation model: posts on the file's own grid, with bilinear interpolation."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from jaxgeo._checks import as_float64, concrete, require_x64
from jaxgeo._compile import is_direct, one_program
from jaxgeo._numerics import all_finite, finite_or, safe_angle
from jaxgeo._record import has_numbers, range_text
from jaxgeo._typing import ExtentField, Flag, FlagField, PostsField, Scalar, ScalarField, Vector3, VoidField
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.frames import R_ecef_from_enu
from jaxgeo.earth.geodetic import Geodetic, checked_position
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain._memory import copied, handed_over
from jaxgeo.terrain.field import AbstractField, BoundedField, Bounds, SumField, checked_field
from jaxgeo.terrain.grid import AbstractGrid
from jaxgeo.terrain.interface import AbstractSearch, AbstractTerrain, Bracket, along_path
from jaxgeo.terrain.patch import Patch
from jaxgeo.terrain.pyramid import Pyramid, build_pyramid, check_size, extremes, known_posts

EDGE_TOLERANCE = 1e-9  # cells: rounding tolerance for positions on the last post


class Dem(AbstractTerrain):
    """Posts on a grid with bilinear interpolation; make one with `Dem.from_array` or `jaxgeo.io.read_dem`.

    `posts` are ellipsoidal heights in m, indexed [row, col], in any real dtype and finite everywhere; `void` marks
    unknown posts. `grid` maps positions to (row, col). `extent` is the true (rows, cols) if the arrays are padded.
    `lowest` and `highest` refer to the known posts; the ground in a void cell (one with a void post) is unknown up to
    `void_ceiling`. An optional `field` is added to all heights (see `with_field`).
    """

    posts: PostsField
    void: VoidField
    grid: AbstractGrid
    extent: ExtentField
    lowest: ScalarField
    highest: ScalarField
    void_ceiling: ScalarField
    has_void: FlagField
    pyramid: Pyramid
    field: AbstractField | None = None

    def __repr__(self) -> str:
        """Size, spacing, heights and centre; fields if they are traced or several."""
        of_grid = jax.tree.leaves(self.grid)
        if not has_numbers(self.extent, self.lowest, self.highest, *of_grid) or np.shape(self.extent) != (2,):
            return super().__repr__()
        rows, cols = (int(size) for size in np.asarray(self.extent))
        with jax.ensure_compile_time_eval():
            sizes, (x, y, z) = np.abs(np.asarray(self.grid.cell_size())), np.asarray(self.centre_normal()).tolist()
        down, across = (range_text(size, 3 if size < 10.0 else 1) for size in sizes)
        lat, lon = np.rad2deg(np.arctan2(z, np.hypot(x, y))), np.rad2deg(np.arctan2(y, x))
        low, high = range_text(self.lowest, 1), range_text(self.highest, 1)
        voids = "with voids" if bool(np.asarray(self.has_void)) else "no voids"
        heights = f"heights {low} to {high} m above the ellipsoid, {voids}"
        return f"Dem({rows} x {cols} posts {down} x {across} m apart, {heights}, centre {lat:.6f}, {lon:.6f} deg)"

    @classmethod
    def from_array(
        cls,
        posts: PostsField,
        grid: AbstractGrid,
        *,
        void: ArrayLike | None = None,
        void_ceiling: ArrayLike | None = None,
        extent: ArrayLike | tuple[int, int] | None = None,
    ) -> Dem:
        """Terrain from an array of ellipsoidal heights in m, (rows, cols); NaN posts are voids.

        `void` marks further unknown posts; `void_ceiling` is the highest possible ground in voids in m: by default the
        highest known post, unless a better bound is known (a lake, a plain). Rays below it over a void have no result.
        `extent` is the true (rows, cols) if the array is padded at its end. Posts may be traced by JAX: gradients then
        reach them through the hits, never through the bounds.
        Raises `ValueError` for fewer than 2 x 2 posts, more than about 40,000 x 40,000 (1.6e9), posts all void or
        infinite, or a ceiling that is not finite.
        >>> from jaxgeo.terrain import TangentGrid
        >>> middle = jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=0.0)
        >>> grid = TangentGrid.centred(middle, spacing=(30.0, 30.0), shape=(3, 3))
        >>> heights = np.full((3, 3), 600.0)
        >>> heights[1, 1] = 660.0
        >>> hill = jaxgeo.Dem.from_array(heights, grid)
        >>> print(round(float(hill.height_at(middle)), 3))
        660.0
        """
        require_x64()
        grid = as_float64(grid, "grid")
        posts, void = _unmasked(posts, void)
        is_known_now = all(concrete(given) is not None for given in (posts, void, void_ceiling, extent))
        xp: Any = np if is_known_now else jnp
        posts = xp.asarray(posts)
        void = None if void is None else xp.asarray(void)
        _check_kind(posts, void, extent)
        unknown = xp.isnan(posts) if posts.dtype.kind == "f" else xp.zeros(posts.shape, bool)
        if void is not None:
            unknown = unknown | void
        rows, cols = posts.shape if extent is None else xp.asarray(extent)
        known, has_void = known_posts(unknown, rows, cols, xp)
        if is_known_now and not has_void:
            unknown = np.broadcast_to(False, posts.shape)  # takes no memory
        lowest, highest = extremes(posts, known, xp)
        if is_known_now:
            _check_posts(known, lowest, highest)
        ceiling = highest if void_ceiling is None else xp.asarray(void_ceiling, np.float64)
        ceiling = ceiling if is_known_now else jax.lax.stop_gradient(ceiling)
        if is_known_now and not np.isfinite(ceiling):
            raise ValueError(f"void_ceiling must be a finite height in m above the ellipsoid; got {float(ceiling)!r}.")
        posts = posts if is_known_now and known.all() else xp.where(known, posts, lowest.astype(posts.dtype))
        frozen = posts if is_known_now else jax.lax.stop_gradient(posts)
        top = xp.where(has_void, ceiling, highest)
        pyramid = build_pyramid(frozen, unknown, ceiling=top, lowest=lowest, highest=highest, xp=xp)
        del unknown
        void = handed_over(np.logical_not(known, out=known)) if is_known_now else ~known
        size = xp.stack([xp.asarray(rows, np.int32), xp.asarray(cols, np.int32)])
        limits = tuple(xp.asarray(height, np.float64) for height in (lowest, highest, ceiling))
        of_all = size, *limits, xp.asarray(has_void)
        of_all = jax.device_put(of_all) if is_known_now else jax.lax.stop_gradient(of_all)
        extent, lowest, highest, ceiling, has_void = of_all
        return cls(copied(posts), void, grid, extent, lowest, highest, ceiling, has_void, pyramid)

    def with_posts(self, posts: ArrayLike) -> Dem:
        """The same terrain with other heights (rows, cols) in m; keeps voids, a given void ceiling and the field."""
        if jnp.shape(posts) != jnp.shape(self.posts):
            raise ValueError(f"posts must keep the shape {jnp.shape(self.posts)}; got {jnp.shape(posts)}.")
        highest = jnp.max(jnp.where(jnp.asarray(self.void), -jnp.inf, jnp.asarray(posts)))
        is_default = jnp.asarray(self.void_ceiling) == self.highest
        ceiling = jax.lax.stop_gradient(jnp.where(is_default, highest, self.void_ceiling))
        dem = Dem.from_array(posts, self.grid, void=self.void, void_ceiling=ceiling, extent=self.extent)
        return dem if self.field is None else dem.with_field(self.field)

    def with_field(self, field: AbstractField) -> Dem:
        """The same terrain with a field of heights in m added to its posts, on top of any earlier field.

        Arrays are shared, not copied: under `jax.vmap` every item may have its own field, and all are searched
        together. The void ceiling rises by the field's highest value. Hits are differentiable in the field, except hits
        on a void ceiling. Raises `TypeError` if `field` is not a field, `ValueError` for a batch of fields.
        """
        field = checked_field(field)
        return dataclasses.replace(self, field=field if self.field is None else SumField(self.field, field))

    @property
    def known_heights(self) -> Bounds:
        """Lowest and highest known ground in m; with a field, bounds of them."""
        lowest, highest = jnp.asarray(self.lowest), jnp.asarray(self.highest)
        if self.field is None:
            return lowest, highest
        low, high = self.field.frozen_bounds()
        return lowest + low, highest + high

    @property
    def void_top(self) -> Scalar:
        """Highest possible ground in voids in m, field included."""
        top = jnp.asarray(self.void_ceiling)
        return top if self.field is None else top + self.field.frozen_bounds()[1]

    @property
    def rise(self) -> Scalar | None:
        """Largest rise in m of the ground above the bounds in `pyramid`; None without a field."""
        return None if self.field is None else self.field.frozen_bounds()[1]

    @property
    def ceiling(self) -> Scalar:
        """Height in m above all ground, known or unknown."""
        _, highest = self.known_heights
        return jnp.where(self.has_void, jnp.maximum(highest, self.void_top), highest)

    @property
    def floor(self) -> Scalar:
        """Height in m below all possible hits: the lowest post, or a lower void ceiling."""
        lowest, _ = self.known_heights
        return jnp.where(self.has_void, jnp.minimum(lowest, self.void_top), lowest)

    def bracket(self, ray: Ray, search: AbstractSearch) -> Bracket:
        bounded = self if self.field is None else dataclasses.replace(self, field=BoundedField.of(self.field))
        return search.bracket(*jax.lax.stop_gradient((ray, bounded)))

    def clearance(self, p_ecef: Vector3, cell: Int[Array, "2"]) -> Scalar:
        rowcol, height = self.over(p_ecef)
        return height - self.surface(rowcol, cell)

    def made_safe(self) -> tuple[Dem, Flag]:
        names = ("grid", "lowest", "highest", "void_ceiling", "field")
        small = {name: getattr(self, name) for name in names}
        return dataclasses.replace(self, **finite_or(small, 1.0)), all_finite(small)

    def safe_ray(self) -> Ray:
        normal = jax.lax.stop_gradient(self.centre_normal())
        lat, lon = jnp.arcsin(normal[2]), jnp.arctan2(normal[1], normal[0])
        origin = WGS84.to_ecef(Geodetic(lat=lat, lon=lon, height=self.known_heights[1] + 1000.0))
        return jax.lax.stop_gradient(Ray(origin, -normal))

    def centre_normal(self) -> Vector3:
        """Unit normal of the ellipsoid at the centre of the grid."""
        return self.grid.normal(0.5 * (jnp.asarray(self.extent) - 1).astype(jnp.float64))

    def grid_reach(self) -> tuple[Vector3, Scalar]:
        """Normal at the grid's centre, and the largest arc in rad from it to the corners and edge middles."""
        middle = self.centre_normal()
        last = (jnp.asarray(self.extent) - 1).astype(jnp.float64)
        around = jnp.array([[r, c] for r in (0.0, 0.5, 1.0) for c in (0.0, 0.5, 1.0)]) * last[None, :]
        return middle, jnp.arccos(jnp.clip(jnp.min(jax.vmap(self.grid.normal)(around) @ middle), -1.0, 1.0))

    # The surface of one cell, and its bounds.

    def over(self, p_ecef: Vector3) -> tuple[Float[Array, "2"], Scalar]:
        """(row, col) and ellipsoidal height in m of an ECEF point."""
        normal, height = WGS84.normal_and_height(p_ecef)
        return self.grid.rowcol(normal), height

    def patch(self, cell: Int[Array, "2"]) -> tuple[Patch, Flag]:
        """The surface of a cell, given by its first post, and whether it is void (then flat at its ceiling)."""
        rows, cols = jnp.shape(self.posts)
        row, col = jnp.clip(cell[0], 0, rows - 2), jnp.clip(cell[1], 0, cols - 2)
        first = row * cols + col
        corners = [first, first + 1, first + cols, first + cols + 1]
        posts = jnp.asarray(self.posts).reshape(-1)
        heights = [posts.at[post].get(mode="promise_in_bounds").astype(jnp.float64) for post in corners]

        def touches_void() -> Flag:
            void = jnp.asarray(self.void).reshape(-1)
            a, b, c, d = (void.at[post].get(mode="promise_in_bounds") for post in corners)
            return a | b | c | d

        is_void = self._if_void(touches_void, lambda: jnp.zeros_like(first, dtype=bool))
        is_void = is_void | ~jnp.isfinite(heights[0] + heights[1] + heights[2] + heights[3])
        if self.field is not None:
            more = self.field.at_corners(row, col)
            heights = [height + change for height, change in zip(heights, more, strict=True)]
        return Patch(*(jnp.where(is_void, self.void_top, height) for height in heights)), is_void

    def surface(self, rowcol: Float[Array, "2"], cell: Int[Array, "2"]) -> Scalar:
        """Height in m at (row, col) of the bilinear patch of a fixed cell, extrapolated beyond it."""
        patch, _ = self.patch(cell)
        return patch.at(rowcol[0] - cell[0], rowcol[1] - cell[1])

    def contains(self, rowcol: Float[Array, "2"]) -> Flag:
        """Whether (row, col) is within the posts."""
        last = (jnp.asarray(self.extent) - 1).astype(jnp.float64)
        return jnp.all((rowcol >= -EDGE_TOLERANCE) & (rowcol <= last + EDGE_TOLERANCE))

    def cell_of(self, rowcol: Float[Array, "2"]) -> Int[Array, "2"]:
        """The cell (first post) of (row, col), clipped to the grid."""
        return jnp.clip(jnp.floor(rowcol).astype(jnp.int32), 0, jnp.asarray(self.extent) - 2)

    # The surface at a position.

    def rowcol_at(self, position: Geodetic) -> Float[Array, "2"]:
        """(row, col) of a position; posts are at integers."""
        position = checked_position(position, "position")
        return self.grid.rowcol(R_ecef_from_enu(position)[:, 2])

    def height_at(self, position: Geodetic) -> Scalar:
        """Height of the surface in m at a latitude and longitude (the height of `position` is ignored).

        NaN outside the grid and over voids; differentiable in position and posts.
        """
        return _height_at(self, checked_position(position, "position"))

    def ground_above(self, p_ecef: Vector3) -> tuple[Scalar, Flag]:
        rowcol, height = self.over(p_ecef)
        cell = self.cell_of(rowcol)
        _, is_void = self.patch(cell)
        is_known = self.contains(rowcol) & ~is_void
        return jnp.where(is_known, self.surface(jnp.where(is_known, rowcol, 0.0), cell) - height, 0.0), is_known

    def spacing(self) -> Scalar:
        return jnp.sqrt(jnp.prod(self.grid.cell_size()))

    def spacing_at(self, p_ecef: Vector3) -> Scalar:
        return jnp.sqrt(jnp.prod(self.grid.cell_size_at(self.over(p_ecef)[0])))

    def known_along(self, path: Float[Array, "3 3"], share: Float[Array, " places"]) -> Bool[Array, " places"]:
        rowcol = along_path(jax.vmap(lambda p_ecef: self.over(p_ecef)[0])(path), share)
        beyond = jnp.concatenate([rowcol[1:], rowcol[-1:]])
        here, there = jnp.floor(rowcol), jnp.floor(beyond)
        crosses, step = here != there, beyond - rowcol
        at = jnp.where(crosses, (jnp.maximum(here, there) - rowcol) / jnp.where(crosses, step, 1.0), jnp.inf)
        row_first = at[:, 0] < at[:, 1]
        moves = jnp.stack([row_first, ~row_first], axis=1)
        both = jnp.stack([here, jnp.where(moves, there, here)])
        cells = jnp.clip(both.astype(jnp.int32), 0, (jnp.asarray(self.extent) - 2)[None, None, :])
        inside = jax.vmap(self.contains)(rowcol)
        return inside & jnp.append(inside[1:], inside[-1]) & ~jnp.any(self._touch_void(cells), axis=0)

    def _touch_void(self, cells: Int[Array, "*shape 2"]) -> Bool[Array, "*shape"]:
        """Whether cells within the grid have a void post."""
        cols = jnp.shape(self.void)[1]
        first = cells[..., 0] * cols + cells[..., 1]
        posts = jnp.stack([first, first + 1, first + cols, first + cols + 1])
        void = jnp.asarray(self.void).reshape(-1)
        touch = lambda: jnp.any(void.at[posts].get(mode="promise_in_bounds"), axis=0)  # noqa: E731
        return self._if_void(touch, lambda: jnp.zeros(first.shape, bool))

    def _if_void(self, touches: Callable[[], Array], nothing: Callable[[], Array]) -> Array:
        """What of two is computed, by whether there are voids; called directly, without compiling a condition."""
        if is_direct():
            return touches() if bool(self.has_void) else nothing()
        return jax.lax.cond(self.has_void, touches, nothing)

    def normal_at(self, position: Geodetic) -> Vector3:
        """Unit normal of the surface in east, north, up at a latitude and longitude; NaN as `height_at`."""
        return _normal_at(self, checked_position(position, "position"))

    def slope_at(self, position: Geodetic) -> Scalar:
        """Angle in rad between the surface and the horizontal at a latitude and longitude; NaN as `height_at`."""
        return _slope_at(self, checked_position(position, "position"))

    def _known_cell(self, rowcol: Float[Array, "2"]) -> tuple[Int[Array, "2"], Flag]:
        cell = self.cell_of(jnp.where(jnp.isfinite(rowcol), rowcol, 0.0))
        _, is_void = self.patch(cell)
        return cell, self.contains(rowcol) & ~is_void


def _unmasked(posts: Any, void: Any) -> tuple[Any, Any]:
    """Posts and voids of a NumPy masked array, as rasterio returns with masked=True."""
    if not isinstance(posts, np.ma.MaskedArray):
        return posts, void
    mask = np.ma.getmaskarray(posts)
    return posts.data, mask if void is None else mask | np.asarray(void)


def _check_kind(posts: Any, void: Any, extent: Any) -> None:
    if posts.ndim != 2 or min(posts.shape) < 2:
        raise ValueError(f"posts must be an array of at least 2 x 2 heights; got shape {posts.shape}.")
    if posts.dtype.kind not in "iuf":
        raise TypeError(f"posts must be heights in m, integers or floats; got dtype {posts.dtype}.")
    check_size(posts.shape)
    if void is not None and (jnp.shape(void) != posts.shape or void.dtype != bool):
        raise ValueError(
            f"void must be a boolean array of the posts' shape {posts.shape}; "
            f"got dtype {getattr(void, 'dtype', type(void).__name__)} and shape {jnp.shape(void)}."
        )
    size = concrete(extent)
    if extent is None or size is None:
        return
    is_whole = size.shape == (2,) and size.dtype.kind in "iu"
    if not is_whole or np.any(size < 2) or np.any(size > np.array(posts.shape)):
        raise ValueError(f"extent must be (rows, cols) of 2 x 2 up to the array's {posts.shape}; got {size.tolist()}.")


def _check_posts(known: np.ndarray, lowest: np.floating, highest: np.floating) -> None:
    if not known.any():
        raise ValueError(f"all {known.size} posts are void: there is no terrain here.")
    if not np.isfinite(lowest) or not np.isfinite(highest):
        raise ValueError("posts must be finite or NaN (void); found an infinite height. Mark such posts in `void`.")


@one_program
def _height_at(dem: Dem, position: Geodetic) -> Scalar:
    rowcol = dem.rowcol_at(position)
    cell, is_known = dem._known_cell(rowcol)
    safe = jnp.where(is_known, rowcol, cell.astype(jnp.float64))
    return jnp.where(is_known, dem.surface(safe, cell), jnp.nan)


@one_program
def _normal_at(dem: Dem, position: Geodetic) -> Vector3:
    cell, is_known = dem._known_cell(dem.rowcol_at(position))
    height = jnp.where(is_known, dem.height_at(position), 0.0)
    on_surface = Geodetic(lat=position.lat, lon=position.lon, height=height)
    gradient = jax.grad(dem.clearance)(WGS84.to_ecef(on_surface), cell)
    normal = R_ecef_from_enu(position).T @ (gradient / jnp.linalg.norm(gradient))
    return jnp.where(is_known, normal, jnp.nan)


@one_program
def _slope_at(dem: Dem, position: Geodetic) -> Scalar:
    return safe_angle(dem.normal_at(position), jnp.array([0.0, 0.0, 1.0]))
