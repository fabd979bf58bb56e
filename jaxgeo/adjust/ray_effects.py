"""Effects on the rays of image points beyond a perspective camera: motion during the readout of an image, and
refraction."""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxgeo._compile import sized_filter_jit
from jaxgeo._record import Record
from jaxgeo._typing import Vector3
from jaxgeo.adjust.frame import LocalFrame
from jaxgeo.adjust.layout import Layout, gathered
from jaxgeo.adjust.values import Values
from jaxgeo.earth import Atmosphere
from jaxgeo.earth.refraction import apparent_point
from jaxgeo.rotations import R_from_rotation_vector

READOUT, REFRACTION = "readout", "refraction"


class RayEffects(Record):
    """Effects on the rays of a block, with their entries of `Values.lens`, from index `first` of each camera on.

    Readout: `velocity` (n, 3) m/s of the perspective centres and `turn_rate` (n, 3) rad/s of the cameras, frame axes;
    `share` (obs,) is the time of a measurement after the middle of its image, over the readout of the camera: its row
    less that of the middle, over the number of rows, as of a `RollingShutterCamera`. Refraction: `bending` (3, obs) m,
    frame axes, the apparent less the true position of each point, in an `air`; the entry is a factor on it. Both are
    None where they do not apply, and then have no entry.
    """

    velocity: Float[Array, "n 3"] | None
    turn_rate: Float[Array, "n 3"] | None
    share: Float[Array, " obs"] | None
    bending: Float[Array, "3 obs"] | None
    air: Atmosphere | None
    frame: LocalFrame | None
    first: int = eqx.field(static=True)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the entries, in their order."""
        return (READOUT,) * (self.share is not None) + (REFRACTION,) * (self.bending is not None)

    def entry(self, values: Values, name: str) -> np.ndarray:
        """The entry (cameras,) of that name."""
        return np.asarray(values.lens)[:, self.first + self.names.index(name)]

    def applied(
        self, layout: Layout, lens: Float[Array, "all obs"], R: Float[Array, "3 3 obs"], offset: Float[Array, "3 obs"]
    ) -> tuple[Float[Array, "3 3 obs"], Float[Array, "3 obs"]]:
        """R_frame_from_camera and the apparent point relative to the perspective centre at the time of each
        measurement."""
        if self.bending is not None:
            offset = offset + lens[self.first + len(self.names) - 1][None] * self.bending
        if self.share is None:
            return R, offset
        seconds = (lens[self.first] * self.share)[None]
        velocity, turn_rate = self._of_measurements(layout)
        turn = jax.vmap(R_from_rotation_vector, in_axes=-1, out_axes=-1)(seconds * turn_rate)
        return jnp.einsum("ijo,jko->iko", turn, R), offset - seconds * velocity

    def by_entries(self, layout: Layout, offset: Float[Array, "3 obs"]) -> list[Float[Array, "3 obs"]]:
        """Shifts of the point that change its pixel as the entries do, per unit of each, m; `offset` as applied."""
        found = []
        if self.share is not None:
            velocity, turn_rate = self._of_measurements(layout)
            found.append(-self.share[None] * (velocity + jnp.cross(turn_rate, offset, axis=0)))
        if self.bending is not None:
            found.append(self.bending)
        return found

    def _of_measurements(self, layout: Layout) -> tuple[Float[Array, "3 obs"], Float[Array, "3 obs"]]:
        assert self.velocity is not None
        assert self.turn_rate is not None
        return gathered(self.velocity, layout.image), gathered(self.turn_rate, layout.image)

    def bent(self, layout: Layout, values: Values) -> RayEffects:
        """A copy with the bending at other values. Its error is that of the nadir angle and the height above ground:
        1 % of the flying height changes it by about 2 %."""
        if self.bending is None or self.frame is None or self.air is None:
            return self
        return eqx.tree_at(lambda e: e.bending, self, _bending(self.frame, self.air, layout, values))


@sized_filter_jit
def _bending(frame: LocalFrame, air: Atmosphere, layout: Layout, values: Values) -> Float[Array, "3 obs"]:
    centre = frame.to_ecef(gathered(values.centre, layout.image).T)
    point = frame.to_ecef(layout.to_rays(values.points.T).T)
    found = jax.vmap(lambda c, p: shift_of(c, p, air))(centre, point)
    return (found @ frame.R_ecef_from_local).T


def shift_of(centre: Vector3, p_ecef: Vector3, air: Atmosphere) -> Vector3:
    """Apparent less true position of a point as seen from a perspective centre, ECEF m; zero where there is none."""
    shift = apparent_point(centre, p_ecef, air) - p_ecef
    return jnp.where(jnp.all(jnp.isfinite(shift)), shift, 0.0)
