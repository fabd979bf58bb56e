"""Terrain whose height is a differentiable function of position, with bounds."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxgeo._checks import as_float64, check_finite, check_is, concrete, require_x64
from jaxgeo._numerics import all_finite, finite_or
from jaxgeo._typing import Flag, Scalar, ScalarField, Vector3
from jaxgeo.earth.ellipsoid import WGS84
from jaxgeo.earth.geodetic import Geodetic, checked_position
from jaxgeo.earth.ray import Ray
from jaxgeo.terrain.field import AbstractField, Bounds, ConstantField, checked_field
from jaxgeo.terrain.interface import AbstractSearch, AbstractTerrain, Bracket
from jaxgeo.terrain.search.first_hit import FirstHit
from jaxgeo.terrain.search.safe_march import safe_march

GROUND = 1  # first number of a hit's cell; 0 means level ground at the highest height


class HeightFunction(AbstractTerrain):
    """Ground with the ellipsoidal height `height_at(position)` in m: a formula, a spline, a neural height field.

    `height_at` takes a `Geodetic` (rad; its height is 0) and returns one float64 number. It is written in JAX for a
    single position, and returns NaN where the ground is unknown (by `jnp.where`, with the other branch finite). If it
    is an `equinox.Module`, derivatives of a hit, to second order, reach its parameters. All heights must be between
    `lowest` and `highest` in m.

    `lipschitz` is the steepest slope of the ground, m of height per m along the ellipsoid. With it the search returns
    the first hit: every step is proven to pass no ground, except ridges in which the ray's path is shorter than 1 mm.
    Without it the ray is sampled at 1024 points between the highest and the lowest height: a crossing is found, but
    ridges between samples are missed. A height outside its bounds, or steeper than `lipschitz`, gives `invalid_input`.

    Functions are compared by identity: define one once, or everything is compiled again for each copy.
    Raises `TypeError` if it is not a function or its heights are not float64, `ValueError` for heights whose shape is
    not () and for invalid bounds.

    >>> import jax.numpy as jnp
    >>> def hills(position):
    ...     return 600.0 + 40.0 * jnp.sin(2e4 * position.lat)  # 2e4 rad a rad: 0.00316 rad a m at most
    >>> ground = jaxgeo.terrain.HeightFunction(hills, 560.0, 640.0, lipschitz=0.13)
    >>> p_ecef = jaxgeo.WGS84.to_ecef(jaxgeo.Geodetic.from_degrees(lat=47.0, lon=11.0, height=1000.0))
    >>> down = -jaxgeo.WGS84.normal_and_height(p_ecef)[0]
    >>> fix = jaxgeo.intersect(jaxgeo.Ray(p_ecef, down), ground)
    >>> print(f"{fix.position.height:.2f} {ground.height_at(fix.position):.2f}")
    625.71 625.71
    """

    parameters: Any
    lowest: ScalarField
    highest: ScalarField
    lipschitz: ScalarField | None
    raised: ScalarField
    rest: Any = eqx.field(static=True)

    def __init__(
        self,
        height_at: Any,
        lowest: ScalarField,
        highest: ScalarField,
        *,
        lipschitz: ScalarField | None = None,
    ) -> None:
        require_x64()
        parameters, self.rest = eqx.partition(height_at, _is_parameter)
        self.parameters = jax.tree.map(jnp.asarray, parameters)
        _check_function(height_at, eqx.combine(self.parameters, self.rest))
        self.lowest, self.highest = as_float64(lowest, "lowest"), as_float64(highest, "highest")
        self.lipschitz = None if lipschitz is None else as_float64(lipschitz, "lipschitz")
        self.raised = jnp.zeros(())
        _check_bounds(self.lowest, self.highest, self.lipschitz)

    def height_at(self, position: Geodetic) -> Scalar:
        """Height of the ground in m at a latitude and longitude (the height of `position` is ignored)."""
        position = checked_position(position, "position")
        foot = Geodetic(lat=position.lat, lon=position.lon, height=jnp.zeros_like(position.lat))
        return eqx.combine(self.parameters, self.rest)(foot) + self.raised

    def bounds(self) -> Bounds:
        """Lowest and highest height in m."""
        return jnp.asarray(self.lowest + self.raised), jnp.asarray(self.highest + self.raised)

    def bracket(self, ray: Ray, search: AbstractSearch) -> Bracket:
        if not isinstance(search, FirstHit):
            raise TypeError(
                f"search must be FirstHit() over a HeightFunction, which has no posts; got {type(search).__name__}. "
                "Leave it out, or make a Dem of its heights."
            )
        return safe_march(*jax.lax.stop_gradient((ray, self)))

    def clearance(self, p_ecef: Vector3, cell: Int[Array, "2"]) -> Scalar:
        position = WGS84.to_geodetic(p_ecef)
        return position.height - jnp.where(cell[0] == GROUND, self.height_at(position), self.bounds()[1])

    def with_field(self, field: AbstractField) -> HeightFunction:
        """The ground raised by a constant field; varying fields need posts.

        Raises `TypeError` for any field but a `ConstantField`.
        """
        hint = "A HeightFunction has no posts for a field that varies: add it to the function, or take a Dem."
        check_is(field, ConstantField, "field", hint)
        raised = self.raised + checked_field(field).bounds()[0]
        return eqx.tree_at(lambda terrain: terrain.raised, self, raised)

    def made_safe(self) -> tuple[HeightFunction, Flag]:
        low, high = self.bounds()
        is_sound = all_finite(self) & (low <= high)
        return finite_or(self, 1.0), is_sound if self.lipschitz is None else is_sound & (self.lipschitz >= 0.0)

    def safe_ray(self) -> Ray:
        above = jnp.stack([WGS84.a + self.bounds()[1] + 1000.0, jnp.zeros(()), jnp.zeros(())])
        return jax.lax.stop_gradient(Ray(above, jnp.array([-1.0, 0.0, 0.0])))


def _is_parameter(leaf: Any) -> bool:
    """Whether a leaf of a function is a JAX input: arrays and plain floats; everything else is compiled in."""
    return eqx.is_array_like(leaf) and not isinstance(leaf, int)  # e.g. a number of layers


def _check_function(given: Any, height_at: Any) -> None:
    if not callable(given):
        raise TypeError(f"height_at must be a function of a Geodetic; got {type(given).__name__}.")
    place = Geodetic(lat=jnp.zeros(()), lon=jnp.zeros(()), height=jnp.zeros(()))
    result = jax.eval_shape(height_at, place)
    shape, dtype = getattr(result, "shape", None), getattr(result, "dtype", None)
    if shape != ():
        raise ValueError(
            f"height_at must return one height in m for one position; got {type(result).__name__} of shape {shape}."
        )
    if dtype != jnp.float64:
        raise TypeError(f"height_at must return float64; got {dtype}, in which a height of 1000 m is good to 0.1 mm.")


def _check_bounds(lowest: Any, highest: Any, lipschitz: Any) -> None:
    for value, name, unit in ((lowest, "lowest", "m"), (highest, "highest", "m"), (lipschitz, "lipschitz", "m per m")):
        if value is not None:
            check_finite(value, name, unit)
    low, high, slope = (None if value is None else concrete(value) for value in (lowest, highest, lipschitz))
    if low is not None and high is not None and (low > high).any():
        raise ValueError(f"lowest must not exceed highest, in m; got {low.tolist()!r} and {high.tolist()!r}.")
    if slope is not None and (slope < 0.0).any():
        raise ValueError(f"lipschitz must be a slope of 0 or more, m per m; got {slope.tolist()!r}.")
