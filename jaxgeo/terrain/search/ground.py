"""One terrain shared by many rays, with an optional height field per ray."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax

from jaxgeo._record import Record
from jaxgeo.terrain.field import BoundedField

if TYPE_CHECKING:
    from jaxgeo.terrain.dem import Dem


class Ground(Record):
    """A terrain in two parts: `shared` by all rays, and each ray's `own`, with a leading axis of rays.

    Each part is a `Dem` with None for the leaves of the other part. A ray's own leaves may be those of the field, and
    none on which the pyramid's bounds depend.
    """

    own: Dem
    shared: Dem

    @classmethod
    def of(cls, dem: Dem, is_own: Dem) -> Ground:
        """Split a terrain by a flag per leaf."""
        return cls(*eqx.partition(dem, is_own))

    @classmethod
    def common(cls, dem: Dem) -> Ground:
        """A terrain that is the same for all rays."""
        return cls.of(dem, jax.tree.map(lambda _: False, dem))

    def each(self, function: Callable[..., Any], *args: Any) -> Any:
        """`function(*args, dem)` for every ray; the arguments have a leading axis of rays."""
        return jax.vmap(lambda own, *args: function(*args, eqx.combine(own, self.shared)))(self.own, *args)

    def bounded(self) -> Ground:
        """The same ground with the bounds of its field, if any, computed once per ray."""
        field = eqx.combine(self.own, self.shared).field
        if field is None:
            return self
        own = jax.tree.leaves(self.own.field)
        if own:
            bounds = self.each(lambda dem: dem.field.bounds())
            own += bounds
        else:
            bounds = field.bounds()
        own = {id(leaf) for leaf in own}
        fields = eqx.partition(BoundedField(field, *bounds), lambda leaf: id(leaf) in own)
        of = lambda dem, field: eqx.tree_at(lambda dem: dem.field, dem, field, is_leaf=lambda x: x is None)  # noqa: E731
        return Ground(of(self.own, fields[0]), of(self.shared, fields[1]))

    def of_rays(self, pick: Callable[[Any], Any]) -> Ground:
        """The ground of selected rays: `pick` selects from an array with a leading axis of rays."""
        return Ground(jax.tree.map(pick, self.own), self.shared)


def fits_together(dem_batched: Dem) -> bool:
    """Whether items whose terrains differ in the flagged leaves can be walked together: only if just fields differ."""
    rest = eqx.tree_at(lambda dem: dem.field, dem_batched, None, is_leaf=lambda x: x is None)
    return not any(jax.tree.leaves(rest))
