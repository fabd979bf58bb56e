"""What comes out of the hall: a point on the ground, or a place in an image, and whether it can be trusted."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxgeo._record import Record
from jaxgeo._typing import PixelField, ScalarField, StatusField, Vector3Field
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.status import Status


class Fix(Record):
    """A point on the ground, how it is seen, and whether it can be trusted.

    `position` and `ecef` (m) are the same point; `slant_range` in m from the perspective centre; angles in rad:
    `incidence_ellipsoid` between the reversed ray and the ellipsoid's normal there, `incidence_surface` between it and
    the normal of the terrain's own surface, `slope` between that surface and the horizontal. `status` is an int8
    `Status`. What could not be computed is NaN.
    """

    position: Geodetic
    ecef: Vector3Field
    slant_range: ScalarField
    incidence_ellipsoid: ScalarField
    incidence_surface: ScalarField
    slope: ScalarField
    status: StatusField

    @property
    def ok(self) -> Bool[Array, "..."]:
        """Whether the fix is an unconditional hit."""
        return jnp.asarray(self.status) == Status.hit

    @property
    def found(self) -> Bool[Array, "..."]:
        """Whether there are coordinates: also near a tangent, after coming in from the side, and at a void's edge."""
        return jnp.isfinite(jnp.asarray(self.slant_range))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers and words, in degrees and m, of one fix (or lists of them for a batch)."""
        lat, lon, height = self.position.to_degrees()
        status = np.asarray(self.status)
        words = [Status(int(code)).name for code in status.reshape(-1)]
        return {
            "lat_deg": np.asarray(lat).tolist(),
            "lon_deg": np.asarray(lon).tolist(),
            "height_m": np.asarray(height).tolist(),
            "slant_range_m": np.asarray(self.slant_range).tolist(),
            "incidence_ellipsoid_deg": np.rad2deg(self.incidence_ellipsoid).tolist(),
            "incidence_surface_deg": np.rad2deg(self.incidence_surface).tolist(),
            "slope_deg": np.rad2deg(self.slope).tolist(),
            "status": words[0] if status.ndim == 0 else np.reshape(words, status.shape).tolist(),
        }


class Projection(Record):
    """Where a ground point lies in an image: `uv` = (column, row) in px, and an int8 `Status`.

    `uv` is NaN where there is no image of the point; a point beside the image keeps its `uv`.
    """

    uv: PixelField
    status: StatusField

    @property
    def ok(self) -> Bool[Array, "..."]:
        """Whether the point is seen inside the image."""
        return jnp.asarray(self.status) == Status.hit
