"""Results of `locate` and `project`: a ground point or an image point, with a status."""

from __future__ import annotations

from collections import Counter
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from jaxgeo._checks import is_known
from jaxgeo._record import Record
from jaxgeo._typing import PixelField, ScalarField, StatusField, Vector3Field
from jaxgeo.earth.geodetic import Geodetic
from jaxgeo.status import Status


class Fix(Record):
    """A located ground point with its viewing geometry and status.

    `position` and `ecef` (m) are the same point; `slant_range` in m from the perspective centre; angles in rad:
    `incidence_ellipsoid` between the reversed ray and the ellipsoid normal, `incidence_surface` between the reversed
    ray and the terrain normal, `slope` between the terrain surface and the horizontal. `status` is an int8 `Status`.
    Values that could not be computed are NaN.
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
        """Whether the status is `hit`."""
        return jnp.asarray(self.status) == Status.hit

    @property
    def found(self) -> Bool[Array, "..."]:
        """Whether coordinates exist: also for `near_tangent`, `enters_from_side` and `hits_void`."""
        return jnp.isfinite(jnp.asarray(self.slant_range))

    def to_dict(self) -> dict[str, Any]:
        """One fix as plain numbers and words, in degrees and m (lists for a batch)."""
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

    def __str__(self) -> str:
        """Position, range and status of one fix, counts of statuses of many; fields if they are traced."""
        if not is_known(self):
            return repr(self)
        codes = np.asarray(self.status)
        if codes.ndim:
            counts = Counter(Status(int(code)).name for code in codes.reshape(-1))
            each = ", ".join(f"{count} {name}" for name, count in counts.most_common())
            return f"{codes.size} fix{'es' if codes.size != 1 else ''}: {each or 'none'}"
        status = Status(int(codes))
        if not bool(self.found):
            return f"no fix: {status.name}: {status.message}"
        lat, lon, height = (float(number) for number in self.position.to_degrees())
        return (
            f"{lat:.7f}, {lon:.7f} deg, {height:z.2f} m above the ellipsoid, {float(self.slant_range):.1f} m away: "
            f"{status.name}"
        )


class Projection(Record):
    """Image point of a ground point: `uv` = (column, row) in px, and an int8 `Status`.

    `uv` is NaN if the point has no image; a point outside the image keeps its `uv`.
    """

    uv: PixelField
    status: StatusField

    @property
    def ok(self) -> Bool[Array, "..."]:
        """Whether the point is visible inside the image."""
        return jnp.asarray(self.status) == Status.hit
