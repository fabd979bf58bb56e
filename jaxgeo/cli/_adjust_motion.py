"""Time offset, rolling shutter and refraction for `jaxgeo adjust`."""

from __future__ import annotations

import dataclasses
import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer

from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import checked_sigma
from jaxgeo.cli._options import OptionGroup
from jaxgeo.sensor import Shot

if TYPE_CHECKING:
    from jaxgeo.adjust import Unknowns
    from jaxgeo.ties import Views

ENOUGH = 50.0  # times the resolution: least interval whose speed is known well enough
TURNS = "The cameras are taken not to turn while they expose: no file says how they do."
BY_TAGS = "Speeds are those of the images' tags (FlightXSpeed, FlightYSpeed, FlightZSpeed: north, east, down)."
BY_TIMES = "Speeds are by the positions and times of neighbouring images, as if the motion between them were even."


@dataclasses.dataclass(frozen=True, kw_only=True)
class MotionOptions(OptionGroup):
    """How cameras move while they expose, and the air in between."""

    time_offset_sigma: Annotated[
        float | None,
        typer.Option(
            "--time-offset-sigma",
            metavar="SECONDS",
            help="Adjust a time offset between positions and exposures, with this sigma, s.",
        ),
    ] = None
    readout: Annotated[
        float | None,
        typer.Option(
            "--readout",
            metavar="SECONDS",
            help="Readout time of a rolling shutter, first row to the next image's first row, s; negative upwards.",
        ),
    ] = None
    readout_sigma: Annotated[
        float | None,
        typer.Option("--readout-sigma", metavar="SECONDS", help="Adjust the readout too, with this sigma, s."),
    ] = None
    refraction: Annotated[
        bool, typer.Option("--refraction", help="Correct for refraction (US Standard Atmosphere 1976).")
    ] = False

    @property
    def needs_speed(self) -> list[str]:
        """The options for which the speeds of the images are needed."""
        names = ("--time-offset-sigma", self.time_offset_sigma), ("--readout", self.readout)
        return [name for name, value in (*names, ("--readout-sigma", self.readout_sigma)) if value]

    def check(self, reference: pathlib.Path | None) -> None:
        """Raises `UserError` for wrong values, and for options that a --reference excludes."""
        for name, value in (("--time-offset-sigma", self.time_offset_sigma), ("--readout-sigma", self.readout_sigma)):
            if value is not None and not checked_sigma(name, value) > 0.0:
                raise UserError(f"{name} {value:g}: give a sigma above zero, or leave the option out.")
        if self.readout is not None:
            _check_readout(self.readout)
        if reference is not None:
            given = [name for name in self.needs_speed if name != "--time-offset-sigma"]
            given += ["--refraction"] if self.refraction else []
            if given:
                raise UserError(
                    f"{given[0]}: images are registered to --reference as of frame cameras, without refraction; leave "
                    f"one of the two out."
                )

    def moving(self, views: Views, paths: Sequence[pathlib.Path], assumed: list[str]) -> Views:
        """The views with their velocities, readout and air; what is assumed is added. Raises `UserError`, before any
        image is matched, where the files state neither speeds nor times that give them."""
        from jaxgeo.earth import Atmosphere

        air = Atmosphere() if self.refraction else None
        if not self.needs_speed:
            return views if air is None else dataclasses.replace(views, atmosphere=air)
        velocity = _by_tags(views, paths)
        assumed += [BY_TIMES if velocity is None else BY_TAGS, TURNS]
        if velocity is None:
            _check_times(views, self.needs_speed[0])
        return views.moving(velocity, np.zeros(3), readout=self.readout or 0.0, atmosphere=air)

    def searched(self, views: Views) -> Views:
        """The views whose search areas have room for the time offset."""
        return views.with_time_offset(self.time_offset_sigma or 0.0)

    def unknowns(self, given: Unknowns | None) -> Unknowns | None:
        """The unknowns with those of the options."""
        from jaxgeo.adjust import Prior, Unknowns

        more = {"time_offset": self.time_offset_sigma, "readout": self.readout_sigma}
        chosen = {name: Prior(sigma) for name, sigma in more.items() if sigma is not None}
        return dataclasses.replace(given or Unknowns(), **chosen) if chosen else given


def _check_readout(seconds: float) -> None:
    from jaxgeo.adjust.readout import LONGEST

    if not abs(seconds) <= LONGEST:
        raise UserError(f"--readout {seconds:g}: give the readout time in s, up to {LONGEST:g}: 0.03 is 30 ms.")


def _by_tags(views: Views, paths: Sequence[pathlib.Path]) -> np.ndarray | None:
    """Velocities (n, 3) of the images in the axes of the frame, m/s; None if any has none in its tags."""
    from jaxgeo.io.acquisitions.velocities import read_velocities

    ned = read_velocities([path for path in paths if path.is_file()])
    if len(ned) < len(paths) or not np.all(np.isfinite(ned)):
        return None
    east_north_up = ned[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    turns = [np.asarray(views.frame.R_local_from_enu(one.pose.position)) for one in _shots(views)]
    return np.einsum("nij,nj->ni", turns, east_north_up)


def _shots(views: Views) -> list[Shot]:
    return [one.motion for one in views.exposure if isinstance(one.motion, Shot)]


def _check_times(views: Views, option: str) -> None:
    """Raises `UserError` for times that give no speeds."""
    time = np.array([float(one.time) for one in _shots(views)])
    instead = "Give images whose tags have speeds (DJI: FlightXSpeed), or a table with times to milliseconds."
    if np.ptp(time) == 0.0:
        raise UserError(f"{option} needs the speeds of the images: the files state neither speeds nor times. {instead}")
    shortest = float(np.median(np.diff(np.unique(time))))
    if np.all(time == np.round(time)) and shortest < ENOUGH:
        raise UserError(
            f"{option} needs the speeds of the images: the files state no speeds, and their times are whole seconds, "
            f"{shortest:g} s apart, from which speeds are known to {100.0 / shortest:.0f} % at best. {instead}"
        )
    known = views.moving(None, np.zeros(3)).velocity
    assert known is not None
    unknown = ~np.all(np.isfinite(known), axis=1)
    if np.any(unknown):
        raise UserError(
            f"{option} needs the speeds of the images: that of {views.name[int(np.argmax(unknown))]} is not known "
            f"({int(np.sum(unknown))} such images), for no other is near in time, or two have one time. {instead}"
        )
