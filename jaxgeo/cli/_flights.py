"""A flight as a trajectory: from navigation records with a scene, or from the exposures of a file."""

from __future__ import annotations

import dataclasses
import pathlib
import re
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._common import UserError
from jaxgeo.cli._exposures import ExposureOptions
from jaxgeo.cli._inputs import trajectory_of
from jaxgeo.cli._option_names import gap_as_typed
from jaxgeo.cli._screen import print_note
from jaxgeo.earth import Atmosphere
from jaxgeo.sensor import Sensor, Trajectory

if TYPE_CHECKING:
    from jaxgeo.io import Observations


@dataclasses.dataclass(frozen=True)
class Flight:
    """A sensor, its trajectory, and the air; `started` is the time by the file's clock at zero of the trajectory."""

    sensor: Sensor
    trajectory: Trajectory
    atmosphere: Atmosphere | None
    started: float = 0.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class FlightOptions(ExposureOptions):
    """A scene with navigation records, or files of records with times."""

    navigation: Annotated[
        pathlib.Path | None,
        typer.Option("--navigation", metavar="FILE", help="With --scene: CSV with a navigation record per row."),
    ] = None

    def inputs(self, reading: ReadingOptions) -> list[pathlib.Path]:
        return [*super().inputs(reading), *([] if self.navigation is None else [self.navigation])]

    def check(self, reading: ReadingOptions) -> None:
        if self.navigation is not None and not self.is_scene:
            raise UserError(f"--navigation {self.navigation}: use it with --scene, not with {(self.files or [])[0]}.")
        if self.is_scene and self.navigation is None and self.scene_file is not None:
            raise UserError(
                "give --navigation FILE with a scene, or a FILE of exposures with times, such as KLV or SBET."
            )
        height_datum = reading.height_datum if self.is_scene else None
        super().check(reading if height_datum is None else dataclasses.replace(reading, height_datum=None))

    def flight(self, reading: ReadingOptions) -> Flight:
        """The flight; assumptions and unread files are printed on stderr. Raises `UserError`, and as the readers."""
        from jaxgeo.io.scene import read_scene

        if self.is_scene:
            assert self.scene_file is not None
            assert self.navigation is not None
            scene = read_scene(self.scene_file)
            records = trajectory_of(scene, self.scene_file, self.navigation, reading.height_datum)
            return Flight(scene.sensor, records, scene.atmosphere)
        found = flight_of(self.read_files(reading))
        print_note(f"times are s after the first exposure, at {found.started:.3f} s by the clock of the file.")
        return found


def flight_of(observed: Observations) -> Flight:
    """The flight of exposures of one camera, in s after the first of them; of those at one time the first.

    Raises `UserError` for several cameras, for fewer than two times, and as `Trajectory.from_knots`.
    """
    import jax

    if len(observed.batches) != 1:
        raise UserError(f"{observed.source}: its exposures are of several cameras; a flight has one.")
    batch = observed.batches[0]
    sensor: Any = batch.sensor
    if not batch.is_one_camera:
        if any(np.any(np.asarray(leaf) != np.asarray(leaf)[:1]) for leaf in jax.tree.leaves(sensor)):
            focal = float(np.ravel(np.asarray(batch.camera.focal_px))[0])
            raise UserError(
                f"{observed.source}: its camera changes (another focal length); a flight has one. Give it, such as the "
                f"first: --camera focal={focal:.0f}px."
            )
        sensor = jax.tree.map(lambda leaf: np.asarray(leaf)[0], sensor)
    times, rows = np.unique(np.asarray(batch.shots.time), return_index=True)
    if len(times) < 2 and not times.any():
        raise UserError(f"{observed.source}: its exposures have no times; a flight needs two or more.")
    if len(times) < 2:
        raise UserError(f"{observed.source}: fewer than two exposures at different times; a flight needs more.")
    poses, readings = jax.tree.map(lambda leaf: np.asarray(leaf)[rows], (batch.shots.pose, batch.shots.gimbal_readings))
    try:
        trajectory = Trajectory.from_knots(times - times[0], poses, np.unwrap(readings, axis=0))
    except ValueError as error:
        raise UserError(f"{observed.source}: {gap_as_typed(re.sub('knot', 'exposure', str(error)))}") from error
    return Flight(sensor, trajectory, observed.atmosphere, float(times[0]))
