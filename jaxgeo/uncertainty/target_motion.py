"""Motion of a tracked target: at rest or at constant velocity, on the terrain or free in height."""

from __future__ import annotations

from typing import ClassVar

import equinox as eqx

from jaxgeo._record import Record


class AbstractTarget(Record):
    """Base class of target motions."""

    on_terrain: eqx.AbstractVar[bool]
    is_moving: ClassVar[bool]

    @property
    def axes(self) -> int:
        """Number of coordinates of the position that are unknown: 2 on the terrain, 3 free in height."""
        return 2 if self.on_terrain else 3

    @property
    def unknowns(self) -> int:
        """Number of unknowns: position, and velocity of a moving target."""
        return self.axes * (2 if self.is_moving else 1)

    @property
    def words(self) -> str:
        """Motion and height in words."""
        motion = "at constant velocity" if self.is_moving else "at rest"
        return f"target {motion}, {'on the terrain' if self.on_terrain else 'free in height'}"


class AtRest(AbstractTarget):
    """A target that does not move: on the terrain surface, or with `on_terrain=False` at any height."""

    on_terrain: bool = eqx.field(static=True, default=True)
    is_moving: ClassVar = False


class ConstantVelocity(AbstractTarget):
    """A target with one horizontal velocity that follows the terrain surface, or with `on_terrain=False` one of
    constant velocity in all three axes. The axes are those of the tangent plane at the first position.
    """

    on_terrain: bool = eqx.field(static=True, default=True)
    is_moving: ClassVar = True
