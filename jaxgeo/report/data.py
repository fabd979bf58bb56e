"""Report input: pixels with their exposures, fixes and accuracy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxgeo._checks import given_array
from jaxgeo._locate import locate
from jaxgeo.earth import Atmosphere
from jaxgeo.fix import Fix
from jaxgeo.io.located import axis_of, take_rows, terrain_at
from jaxgeo.io.observations import Observations
from jaxgeo.io.tables import ABOVE_TAKEOFF
from jaxgeo.sensor import Sensor, Shot
from jaxgeo.status import have_fix
from jaxgeo.terrain import AbstractTerrain
from jaxgeo.uncertainty import Accuracy, accuracy

Axes = tuple[int | None, ...]
ONE_SCENE: Axes = (None, None, 0, None, None)


@dataclass(frozen=True)
class ReportData:
    """n pixels `uv` (n, 2), their exposures and their `fixes` (n,).

    `axes`, for (sensor, shots, uv, terrain, errors), is 0 if there is an entry per pixel and None if one is shared.
    `errors` are error sources or an `ErrorModel`, or None; `accuracy` is None without errors or without any fix.
    `labels` hold a `name` or table columns per pixel. `looks` replaces `look` if exposures have no common structure
    (several cameras); `sensor` and `errors` are then those of the first. `is_above_takeoff`: whether heights are above
    a take-off whose own height is unknown.
    """

    sensor: Sensor
    shots: Shot
    uv: Any
    terrain: AbstractTerrain
    errors: Any
    fixes: Fix
    accuracy: Accuracy | None
    axes: Axes = ONE_SCENE
    atmosphere: Atmosphere | None = None
    probability: float = 0.9
    labels: Sequence[Mapping[str, Any]] = field(default_factory=tuple)
    looks: Callable[[int], tuple[Any, ...]] | None = None
    is_above_takeoff: bool = False

    @property
    def height_column(self) -> str:
        """The column of a fix with its height."""
        return ABOVE_TAKEOFF if self.is_above_takeoff else "fix_height_m"

    @property
    def above(self) -> str:
        """What heights are above, in words."""
        return "above the take-off" if self.is_above_takeoff else "above the WGS 84 ellipsoid"

    @property
    def above_in_short(self) -> str:
        """`above` for charts and maps."""
        return "above the take-off" if self.is_above_takeoff else "above WGS 84"

    @classmethod
    def of(
        cls,
        sensor: Sensor,
        shots: Shot,
        uv: Any,
        terrain: AbstractTerrain,
        errors: Any = None,
        *,
        in_axes: Axes = ONE_SCENE,
        probability: float = 0.9,
        atmosphere: Atmosphere | None = None,
        labels: Sequence[Mapping[str, Any]] = (),
    ) -> ReportData:
        """Locate pixels and compute their accuracy: by default pixels (n, 2), or one, of one shot.

        `in_axes` as for `accuracy`. Raises as `locate` and `accuracy`, and `ValueError` if the
        number of labels differs.
        """
        uv = np.atleast_2d(np.asarray(given_array(uv, "uv", "the pixels (column, row)"), np.float64))
        if labels and len(labels) != len(uv):
            raise ValueError(f"labels must be one for each of {len(uv)} pixels; got {len(labels)}.")
        found = None
        if errors is None:
            see = lambda *given: locate(*given, atmosphere=atmosphere)  # noqa: E731
            fixes = jax.vmap(see, in_axes=in_axes[:4])(sensor, shots, jnp.asarray(uv), terrain)
        else:
            options: dict[str, Any] = {"probability": probability, "atmosphere": atmosphere}
            found = accuracy(sensor, shots, uv, terrain, errors, in_axes=in_axes, **options)
            fixes = found.fix
        fixes = jax.tree.map(np.asarray, fixes)
        return cls(sensor, shots, uv, terrain, errors, fixes, found, in_axes, atmosphere, probability, labels)

    @classmethod
    def of_observations(
        cls,
        observed: Observations,
        grounds: Sequence[AbstractTerrain],
        fixes: Fix,
        accuracy: Accuracy | None,
        probability: float = 0.9,
    ) -> ReportData:
        """Observations with their fixes and accuracy, without rows whose file could not be read.

        `grounds` hold the terrain of each batch; without error sources `accuracy` is None.
        """
        first, rows = observed.batches[0], observed.read_rows
        own = None if first.is_one_camera else 0
        axes, shots, uv, looks = (own, 0, 0, axis_of(grounds[0]), own), first.shots, first.observation.uv, None
        if len(observed.batches) > 1:
            looks = [_look(observed, grounds, int(row)) for row in rows]
            pose = jax.tree.map(lambda *leaves: np.stack(leaves), *(shot.pose for _, shot, _, _, _ in looks))
            shots, uv = Shot(pose, np.zeros((len(rows), 0))), np.stack([one[2] for one in looks])
            axes = 0, *axes[1:]
        fixes, accuracy = take_rows(fixes, accuracy, rows)
        return cls(
            first.sensor,
            shots,
            uv,
            grounds[0],
            first.sources or None,
            fixes,
            accuracy,
            axes,
            observed.atmosphere,
            probability,
            [observed.columns[row] for row in rows],
            None if looks is None else looks.__getitem__,
            observed.is_above_takeoff,
        )

    def __len__(self) -> int:
        return len(np.asarray(self.fixes.status))

    def look(self, index: int) -> tuple[Any, Any, Any, Any, Any]:
        """(sensor, shot, pixel, terrain, errors) of one pixel."""
        if self.looks is not None:
            sensor, shot, uv, terrain, errors = self.looks(index)
            return sensor, shot, uv, terrain, errors
        given = (self.sensor, self.shots, self.uv, self.terrain, self.errors)
        own: Any = tuple(
            jax.tree.map(lambda leaf: np.asarray(leaf)[index], one) if axis == 0 else one
            for one, axis in zip(given, self.axes, strict=True)
        )
        return own

    def fix(self, index: int) -> Fix:
        """One of the fixes."""
        return jax.tree.map(lambda leaf: np.asarray(leaf)[index], self.fixes)

    @property
    def is_fix(self) -> np.ndarray:
        """Mask (n,) of pixels whose fix is known to be the first intersection with the terrain."""
        return have_fix(self.fixes.status)

    @property
    def has_place(self) -> np.ndarray:
        """Mask (n,) of pixels with coordinates."""
        return np.isfinite(np.asarray(self.fixes.slant_range))

    def has_ellipse(self, index: int) -> bool:
        """Whether linear propagation is valid at a pixel, so that its error is an ellipse."""
        return self.accuracy is not None and bool(np.isfinite(np.asarray(self.accuracy.cov_enu)[index]).all())

    def name(self, index: int) -> str:
        """Display name of a pixel: its name, if any, with column and row."""
        u, v = np.asarray(self.uv)[index]
        label = self.labels[index].get("name") if self.labels else None
        pixel = f"pixel {u:g}, {v:g}"
        return f"{label}, {pixel}" if label else pixel


def _look(observed: Observations, grounds: Sequence[AbstractTerrain], row: int) -> tuple[Any, ...]:
    """(sensor, shot, pixel, terrain, errors) of one row."""
    number, index = observed.place(row)
    observation, sources = observed.batches[number].at(index)
    exposure = observation.exposure
    return exposure.sensor, exposure.motion, observation.uv, terrain_at(grounds[number], index), sources or None
