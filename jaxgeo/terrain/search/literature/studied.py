"""Published searches: DEM heights evaluated one by one, counted, with a reason for the ending."""

from __future__ import annotations

from abc import abstractmethod
from typing import TYPE_CHECKING

import jax.numpy as jnp
from jaxtyping import Array, Int8

from jaxgeo._numerics import tree_where
from jaxgeo._record import Record
from jaxgeo._typing import Flag, Index, Scalar, StatusCode
from jaxgeo.earth.ray import Ray
from jaxgeo.status import Status, first_failure, status_where
from jaxgeo.terrain.interface import AbstractSearch, Bracket
from jaxgeo.terrain.search.literature.descent import DemSample, Descent
from jaxgeo.terrain.search.literature.run import Ending, Run, ending_code
from jaxgeo.terrain.search.reach import is_buried, is_mapped, reach_of

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem

EPS = 0.2  # m: the tolerance of the experiments of Li et al. (2023), section 5.2


class Search(Record):
    """End of a studied search: its last sample, its cost, and the int8 `Ending`."""

    sample: DemSample
    evaluations: Index
    iterations: Index
    ending: Int8[Array, ""]


class Approach(Record):
    """A ray prepared for a search: the ray (or a placeholder), the range in m where it starts to sink towards the
    ground, and the int8 `Status` that prevents a search, `hit` if none does."""

    ray: Ray
    start: Scalar
    obstacle: StatusCode


def approach(ray: Ray, dem: Dem) -> Approach:
    """Common preparation of one `ray` (ECEF) for all studied searches."""
    reach = reach_of(ray, dem)
    obstacle = status_where(reach.sinks, Status.hit, Status.not_converged.code)
    obstacle = status_where(~reach.exists, Status.rises_away, obstacle)
    obstacle = status_where(is_buried(ray, dem), Status.camera_below_terrain, obstacle)
    obstacle = status_where(~is_mapped(ray, dem, reach.start), Status.ray_misses_terrain, obstacle)
    is_free = obstacle == Status.hit
    stand_in = dem.safe_ray()
    return Approach(tree_where(is_free, ray, stand_in), jnp.where(is_free, reach.start, 0.0), obstacle)


class AbstractStudiedSearch(AbstractSearch):
    """A search of the literature over heights Z, as published, including its faults.

    `run` reports its cost and ending; `bracket` gives its own point, within its own tolerance of the surface, so that
    `intersect` and `locate` return the method's result and not a polished one. It may not be the first crossing:
    `FirstHit` finds that. Rays that never sink below the lowest ground are not searched.
    """

    @abstractmethod
    def search(self, descent: Descent) -> Search:
        """The method itself, for a ray that sinks from above the highest to below the lowest ground."""

    def run(self, ray: Ray, dem: Dem) -> Run:
        """Search along one `ray` (ECEF) over `dem`. Under `jax.vmap` a batch takes as long as its slowest ray."""
        return self.run_from(approach(ray, dem), dem)

    def run_from(self, approach: Approach, dem: Dem) -> Run:
        """`run` for a ray with a known `approach` over `dem`, so that several searches can share it."""
        done = self.search(Descent.of(approach.ray, dem, approach.start))
        sample = done.sample
        cell = dem.cell_of(sample.rowcol)
        status = first_failure(approach.obstacle, _status(done, dem))
        has_point = (status == Status.hit) | (status == Status.hits_void)
        is_lost = (approach.obstacle != Status.hit) | ((done.ending == Ending.converged) & ~has_point)
        ending = ending_where(is_lost, Ending.failed, done.ending)
        return Run(
            sample.distance, sample.height, sample.clearance, cell, done.evaluations, done.iterations, ending, status
        )

    def bracket(self, ray: Ray, dem: Dem) -> Bracket:
        run = self.run(ray, dem)
        has_point = (run.status == Status.hit) | (run.status == Status.hits_void)
        distance = jnp.where(has_point, run.distance, 0.0)
        return Bracket(distance, distance, distance, jnp.where(has_point, run.cell, 0), run.status)


def _status(done: Search, dem: Dem) -> StatusCode:
    """Status of a search's point, or the reason for having none."""
    _, is_void = dem.patch(dem.cell_of(done.sample.rowcol))
    status = status_where(is_void, Status.hits_void, Status.hit.code)
    status = status_where(~done.sample.is_inside, Status.leaves_terrain, status)
    has_none = (done.ending != Ending.converged) | (done.sample.distance < 0.0)
    return status_where(has_none, Status.not_converged, status)


def ending_where(condition: Flag, ending: Ending, otherwise: Int8[Array, ""]) -> Int8[Array, ""]:
    """`ending` where `condition` holds, `otherwise` elsewhere."""
    return jnp.where(condition, ending_code(ending), otherwise)
