"""Observations of files: pixels of exposures with their error sources, in batches of one camera."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, cast

import jax
import numpy as np

from jaxgeo.earth import Atmosphere, Geodetic
from jaxgeo.fix import Fix
from jaxgeo.io._fix_columns import figures_of, rows_of
from jaxgeo.io.acquisitions import Unread, for_each
from jaxgeo.observation import Exposure, Observation
from jaxgeo.sensor import FrameCamera, Sensor, Shot
from jaxgeo.uncertainty import Accuracy
from jaxgeo.uncertainty.sources import (
    AbstractSource,
)

Path = str | os.PathLike[str]
Row = dict[str, Any]


@dataclasses.dataclass(frozen=True)
class ObservationBatch:
    """n pixels whose exposures share one structure: camera model, gimbal axes and kinds of error sources.

    - `observation`: its shots and pixels have a leading axis of n, and so has its sensor unless `is_one_camera`.
    - `sources`: error sources, with a leading axis if the sensor has one.
    - `rows` (n,): the row of each pixel in `Observations`.
    - `centre_heights` (n,): ground heights at the image centres as reported by the file, m, ellipsoidal, or None.
    - `above_takeoff` (n,): heights above the take-off as reported by the file, m, or None.
    """

    observation: Observation
    sources: tuple[AbstractSource, ...]
    rows: np.ndarray
    is_one_camera: bool = False
    centre_heights: np.ndarray | None = None
    above_takeoff: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def sensor(self) -> Sensor:
        """The sensor, with a leading axis unless `is_one_camera`."""
        return self.observation.exposure.sensor

    @property
    def camera(self) -> FrameCamera:
        """The camera, with a leading axis unless `is_one_camera`."""
        return frame_camera_of(self.sensor)

    @property
    def shots(self) -> Shot:
        """The shots, a batch of n."""
        motion = self.observation.exposure.motion
        assert isinstance(motion, Shot)
        return motion

    @property
    def in_axes(self) -> Any:
        """Axes of `observation` for `jax.vmap`, a tree of 0 for values per pixel and None for shared ones."""
        return axes_of(self.observation, self.is_one_camera)

    @property
    def is_on_image(self) -> np.ndarray:
        """Mask (n,) of pixels on the image, including the outer edges of its pixels."""
        camera, uv = self.camera, np.asarray(self.observation.uv, np.float64)
        return np.all((uv >= -0.5) & (uv <= np.array([camera.width, camera.height]) - 0.5), axis=1)

    def at(self, index: int | np.ndarray) -> tuple[Observation, tuple[AbstractSource, ...]]:
        """(observation, error sources) of one or several of the pixels; what all share is left as it is."""
        exposure = self.observation.exposure
        own = exposure.sensor, self.sources
        sensor, sources = own if self.is_one_camera else _items(own, index)
        shots, uv = _items((self.shots, self.observation.uv), index)
        return Observation(Exposure(sensor, shots, None, exposure.atmosphere), uv), sources

    def reported_heights(self, index: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(`centre_heights`, `above_takeoff`) of some of the pixels."""
        centre, above = self.centre_heights, self.above_takeoff
        return None if centre is None else centre[index], None if above is None else above[index]


def frame_camera_of(sensor: Sensor | None) -> FrameCamera:
    """The camera of a sensor that was read from a file: always a frame camera."""
    assert sensor is not None
    return cast(FrameCamera, sensor.camera)


def axes_of(observation: Observation, is_one_camera: bool) -> Any:
    """Axes of a batched observation for `jax.vmap`: None for the atmosphere, and for the sensor of one camera."""
    shared = {"sensor", "atmosphere"} if is_one_camera else {"atmosphere"}

    def axis(path: tuple[Any, ...], _: Any) -> int | None:
        return None if any(getattr(key, "name", "") in shared for key in path[1:2]) else 0

    return jax.tree_util.tree_map_with_path(axis, observation)


def _items(tree: Any, index: int | np.ndarray) -> Any:
    return jax.tree.map(lambda leaf: np.asarray(leaf)[index], tree)


@dataclasses.dataclass(frozen=True)
class Observations:
    """Pixels of exposures read from files, one row each, in batches of one structure.

    - `columns`: for each row its input columns: name, time and pixel, or the cells of a table of shots.
    - `unread`: by row, the files that could not be read; such a row is in no batch.
    - `assumed`: a sentence for each assumption.
    - `assumed_errors`: for each kind of default error source, (its class, a sentence with its numbers).
    - `source`: the files as named in messages.
    - `is_above_takeoff`: whether heights, those of fixes on level ground too, are above a take-off whose own height is
      unknown, and so above no datum.
    """

    batches: tuple[ObservationBatch, ...]
    columns: list[Row]
    unread: Mapping[int, Unread] = dataclasses.field(default_factory=dict)
    assumed: tuple[str, ...] = ()
    assumed_errors: tuple[tuple[type[AbstractSource], str], ...] = ()
    source: str = ""
    is_above_takeoff: bool = False

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.columns)

    @property
    def gimbal_names(self) -> tuple[str, ...]:
        """Names of the gimbal axes of the first exposure."""
        return tuple(self.batches[0].sensor.gimbal.names)

    @property
    def atmosphere(self) -> Atmosphere | None:
        """The atmosphere of all exposures."""
        return self.batches[0].observation.exposure.atmosphere

    @property
    def read_rows(self) -> np.ndarray:
        """Rows whose file was read, in order."""
        return np.sort(np.concatenate([batch.rows for batch in self.batches]))

    @property
    def reasons(self) -> list[str | None] | None:
        """For each row why its file could not be read, or None; None if all were read."""
        return self.reasons_by(lambda one: one.reason)

    def reasons_by(self, words: Callable[[Unread], str]) -> list[str | None] | None:
        """`reasons` in the words of a function."""
        told = {row: words(one) for row, one in self.unread.items()}
        return [told.get(row) for row in range(len(self))] if told else None

    @property
    def position(self) -> Geodetic:
        """Positions of the exposures (n,), NaN for rows whose file could not be read."""
        positions = [batch.shots.pose.position for batch in self.batches]
        rows = np.concatenate([batch.rows for batch in self.batches])

        def spread(*parts: Any) -> np.ndarray:
            whole = np.full(len(self), np.nan)
            whole[rows] = np.concatenate([np.asarray(part) for part in parts])
            return whole

        return jax.tree.map(spread, *positions)

    def place(self, row: int) -> tuple[int, int]:
        """(batch, index in it) of a row. Raises `KeyError` if its file could not be read."""
        for number, batch in enumerate(self.batches):
            for index in np.flatnonzero(batch.rows == row):
                return number, int(index)
        raise KeyError(f"row {row}: {self.unread[row].reason if row in self.unread else 'no such row'}")

    def at(self, row: int) -> tuple[Observation, tuple[AbstractSource, ...]]:
        """(observation, error sources) of a row; raises as `place`."""
        number, index = self.place(row)
        return self.batches[number].at(index)

    def part(self, number: int, index: np.ndarray) -> Observations:
        """Some of the pixels of a batch, with rows of their own; without the files that could not be read."""
        batch = self.batches[number]
        observation, sources = batch.at(index)
        heights = batch.reported_heights(index)
        some = ObservationBatch(observation, sources, np.arange(len(index)), batch.is_one_camera, *heights)
        columns = [self.columns[row] for row in batch.rows[index].tolist()]
        return dataclasses.replace(self, batches=(some,), columns=columns, unread={})

    def with_atmosphere(self, atmosphere: Atmosphere | None) -> Observations:
        """The same observations in another atmosphere."""

        def changed(batch: ObservationBatch) -> ObservationBatch:
            exposure = dataclasses.replace(batch.observation.exposure, atmosphere=atmosphere)
            return dataclasses.replace(batch, observation=Observation(exposure, batch.observation.uv))

        return dataclasses.replace(self, batches=tuple(map(changed, self.batches)))

    def with_sources(self, each: Sequence[tuple[AbstractSource, ...]]) -> Observations:
        """The same observations with other error sources, a tuple per batch.

        Sources have a leading axis of n, as by `jaxgeo.io.acquisitions.for_each`, unless `is_one_camera`.
        """
        pairs = zip(self.batches, each, strict=True)
        return dataclasses.replace(
            self, batches=tuple(dataclasses.replace(batch, sources=tuple(own)) for batch, own in pairs)
        )

    def add_sources(self, *sources: AbstractSource) -> Observations:
        """The same observations with more error sources, common to all exposures; they replace those of their class."""
        kinds = {type(one) for one in sources}

        def added(batch: ObservationBatch) -> tuple[AbstractSource, ...]:
            kept = tuple(one for one in batch.sources if type(one) not in kinds)
            return *kept, *(sources if batch.is_one_camera else for_each(sources, len(batch)))

        return self.with_sources([added(batch) for batch in self.batches])

    def table(
        self, fixes: Fix, accuracy: Accuracy | None = None, *, reasons: Sequence[str | None] | None = None
    ) -> list[Row]:
        """For each row its input columns, then the columns of `write_fixes` except `index`."""
        told = self.reasons if reasons is None else reasons
        figures = figures_of("table", fixes, accuracy, None, None, None)
        rows = rows_of(fixes, figures, told, is_above_takeoff=self.is_above_takeoff)
        pairs = zip(rows, self.columns, strict=True)
        return [own | {name: row[name] for name in row if name != "index"} for row, own in pairs]
