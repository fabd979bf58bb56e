"""Shots of several cameras on one mount, and flights, of `jaxgeo adjust`: options and groups of images."""

from __future__ import annotations

import dataclasses
import pathlib
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
import typer

from jaxgeo._text_numbers import number_in
from jaxgeo.cli._common import UserError, counted
from jaxgeo.cli._errors import checked_sigma
from jaxgeo.cli._options import OptionGroup

if TYPE_CHECKING:
    from jaxgeo.observation import Exposure
    from jaxgeo.ties import Correction

UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}
USUAL_MOUNTING = 1.0  # deg: of the angles of one camera against another on a mount
LEVER, APART = 0.1, 0.1  # m: of its place there, and of positions of one shot, by the time between its exposures


@dataclasses.dataclass(frozen=True)
class Groups:
    """Numbers of shots and flights and names of cameras of n images, None where nothing is stated."""

    shot: np.ndarray | None = None
    flight: np.ndarray | None = None
    camera: np.ndarray | None = None
    by: str = ""

    @property
    def is_rig(self) -> bool:
        """Whether any shot has several images."""
        return self.shot is not None and len(np.unique(self.shot)) < len(self.shot)

    @property
    def content(self) -> dict[str, Any]:
        """Content of --json."""
        found: dict[str, Any] = {}
        if self.shot is not None and self.camera is not None:
            names, counts = np.unique(self.camera, return_counts=True)
            cameras = dict(zip(names.tolist(), counts.tolist(), strict=True))
            found["shots"] = {"count": len(np.unique(self.shot)), "images_of_cameras": cameras}
        if self.flight is not None:
            found["flights"] = len(np.unique(self.flight))
        return found

    def words(self) -> str:
        """The line on stderr; empty if nothing is grouped."""
        parts = []
        if self.shot is not None and self.camera is not None:
            names, counts = np.unique(self.camera, return_counts=True)
            each = ", ".join(f"{count} of {name}" for name, count in zip(names.tolist(), counts.tolist(), strict=True))
            _, sizes = np.unique(self.shot, return_counts=True)
            alone = int(np.count_nonzero(sizes == 1))
            parts.append(
                f"{counted(len(sizes), 'shot')} of {counted(len(names), 'camera')} ({each})"
                + (f", {alone} of one image" if alone else "")
            )
        if self.flight is not None:
            parts.append(counted(len(np.unique(self.flight)), "flight"))
        return "; ".join(parts)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RigOptions(OptionGroup):
    """Which images are of one exposure, and which of one flight."""

    panel: ClassVar[str | None] = "Several cameras, several flights"

    shots_by: Annotated[
        str | None,
        typer.Option(
            "--shots-by",
            metavar="HOW",
            help="Images of one exposure, of several cameras on one mount: name (alike but for the last part, as "
            "DJI_0042_T and DJI_0042_W), or a time, such as 0.2s, within which they are taken (default: column shot "
            "of a table).",
        ),
    ] = None
    flights_by: Annotated[
        str | None,
        typer.Option(
            "--flights-by",
            metavar="HOW",
            help="Images of one flight: folder (each is one), or a time, such as 20min, without images between two "
            "flights (default: column flight of a table).",
        ),
    ] = None
    mounting_sigma: Annotated[
        float | None,
        typer.Option(
            "--mounting-sigma",
            metavar="DEG",
            help=f"With shots: angle sigma of each further camera on its mount, deg (default {USUAL_MOUNTING:g}; 0: "
            "as stated).",
        ),
    ] = None

    def check_options(self) -> None:
        """Raises `UserError` for wrong values."""
        if self.shots_by not in (None, "name"):
            _seconds("--shots-by", self.shots_by, "name, or a time such as 0.2s")
        if self.flights_by not in (None, "folder"):
            _seconds("--flights-by", self.flights_by, "folder, or a time such as 20min")
        if self.mounting_sigma is not None:
            checked_sigma("--mounting-sigma", self.mounting_sigma)

    def groups(
        self, files: Sequence[pathlib.Path], names: Sequence[str], paths: Sequence[pathlib.Path], given: list[Exposure]
    ) -> Groups:
        """Of n images: their names, files and exposures. Raises `UserError`."""
        stated = self._stated(files, names)
        found = self._shots(paths, given, stated)
        flight = self._flights(names, paths, given, stated)
        if self.mounting_sigma is not None and not found.is_rig:
            raise UserError(
                f"--mounting-sigma {self.mounting_sigma:g} is for shots of several cameras; give --shots-by too."
            )
        return dataclasses.replace(found, flight=flight)

    def _stated(self, files: Sequence[pathlib.Path], names: Sequence[str]) -> dict[str, list[str]]:
        """Cells of the columns shot, flight and camera of tables, for all images; {} if a table or image has none."""
        from jaxgeo.cli._oriented_images import form_of_file
        from jaxgeo.io.shot_groups import COLUMNS, stated_groups

        cells: dict[str, dict[str, str]] = {}
        for file in files:
            form = form_of_file(file)
            if form is not None and form.name == "table of orientations":
                cells |= stated_groups(file)
        each = [cells.get(name, {}) for name in names]
        return {one: [row[one] for row in each] for one in COLUMNS if each and all(one in row for row in each)}

    def _shots(self, paths: Sequence[pathlib.Path], given: list[Exposure], stated: dict[str, list[str]]) -> Groups:
        from jaxgeo.io.shot_groups import shots_by_name, shots_by_time

        if self.shots_by is None and "shot" not in stated:
            return Groups()
        if self.shots_by == "name":
            shot, camera = shots_by_name(paths)
            found = Groups(shot, None, _by_lens(camera, given), "--shots-by name")
            if not found.is_rig:
                raise UserError(
                    f"--shots-by name: no two of {len(paths)} images in one folder have names that are alike but for "
                    f"their last part, such as DJI_0042_T.JPG and DJI_0042_W.JPG; the first is {paths[0].name}. Put "
                    f"the images of all cameras into one folder, or group them by their times: --shots-by 0.2s."
                )
            return found
        named = np.array(stated["camera"]) if "camera" in stated else None
        if self.shots_by is None:
            shot = _numbers(stated["shot"])
            camera = _cameras(given, paths, shot) if named is None else named
            return Groups(shot, None, _by_lens(camera, given), "column shot")
        seconds = _seconds("--shots-by", self.shots_by, "")
        time = _times(given, paths, f"--shots-by {self.shots_by}")
        camera = _cameras(given, paths, _near(time, seconds)) if named is None else named
        camera = _by_lens(camera, given)
        found = Groups(shots_by_time(time, camera, seconds), None, camera, f"--shots-by {self.shots_by}")
        if not found.is_rig:
            raise UserError(
                f"--shots-by {self.shots_by}: no two images of different cameras are taken within this time; there are "
                f"{counted(len(np.unique(camera)), 'camera')}. Give a longer time, or --shots-by name."
            )
        return found

    def _flights(
        self, names: Sequence[str], paths: Sequence[pathlib.Path], given: list[Exposure], stated: dict[str, list[str]]
    ) -> np.ndarray | None:
        from jaxgeo.io.shot_groups import flights_by_time

        if self.flights_by == "folder":
            return _numbers([f"{path.parent}" for path in paths])
        if self.flights_by is not None:
            time = _times(given, paths, f"--flights-by {self.flights_by}")
            return flights_by_time(time, _seconds("--flights-by", self.flights_by, ""))
        return _numbers(stated["flight"]) if "flight" in stated else None

    def with_mounting(self, groups: Groups, given: list[Exposure], errors: list[Any]) -> tuple[list[Any], list[str]]:
        """(error sources of the images with those of the mounting, sentences on these): of all cameras but that of the
        largest images, to which the stated angles are taken to apply."""
        from jaxgeo.uncertainty import PerMeasurement
        from jaxgeo.uncertainty.sources import Boresight, CameraMounting, LeverArm, Position

        sigma = USUAL_MOUNTING if self.mounting_sigma is None else self.mounting_sigma
        if not groups.is_rig or groups.camera is None:
            return errors, []
        stated = any(isinstance(one, Boresight | CameraMounting) for each in errors for one in each)
        if self.mounting_sigma is None and stated:
            return errors, []
        apart = Position.from_ned(north=APART, east=APART, down=APART, sharing=PerMeasurement())
        of_mount = (
            *([CameraMounting.from_degrees(forward=sigma, right=sigma, down=sigma)] if sigma > 0.0 else []),
            LeverArm.from_metres(forward=LEVER, right=LEVER, down=LEVER),
        )
        sizes = [one.sensor.camera.width * one.sensor.camera.height for one in given]  # pyright: ignore
        reference = str(groups.camera[int(np.argmax(sizes))])
        found = [
            (*each, apart, *(of_mount if name != reference else ()))
            for each, name in zip(errors, groups.camera.tolist(), strict=True)
        ]
        how = "default" if self.mounting_sigma is None else "--mounting-sigma"
        return found, [
            f"Mounting sigma of each camera against camera {reference}: {sigma:g} deg ({how}), {LEVER:g} m; positions "
            f"of one shot: {APART:g} m apart by chance."
        ]


def as_options(words: str, groups: Groups) -> str:
    """A message on shots with the names of options."""
    if not groups.by:
        return words
    words = re.sub(r" Number the shots apart; name cameras .*", " Is the grouping right?", words)
    words = words.replace("number the shots of all flights in one series.", "is the grouping into flights right?")
    return f"{groups.by}: {words}" if re.search(r"\bshot \d", words) else words


def rows_of_cameras(found: Correction) -> list[dict[str, Any]]:
    """Rows of --json: relative orientations of cameras."""
    return [
        {
            "camera": one.second,
            "against": one.first,
            "shots": one.shots,
            "turned_deg": np.rad2deg(one.turned).tolist(),
            "sigma_turned_deg": np.rad2deg(one.sigma_turned).tolist(),
            "moved_m": one.moved.tolist(),
            "sigma_moved_m": one.sigma_moved.tolist(),
        }
        for one in found.relative_orientations
    ]


def _seconds(option: str, text: str, expected: str) -> float:
    """A time with its unit, in s. Raises `UserError`."""
    parts = re.fullmatch(r"\s*([-+.\deE]+?)\s*(s|min|h)\s*", text)
    value = None if parts is None else number_in(parts[1])
    if parts is None or value is None or value <= 0.0:
        raise UserError(f"{option} {text}: expected {expected} (s, min or h; above zero).")
    return value * UNITS[parts[2]]


def _numbers(cells: Sequence[str]) -> np.ndarray:
    """A number for each text, that in the text if all have one."""
    whole = [number_in(one) for one in cells]
    if all(one is not None and one == int(one) for one in whole):
        return np.array([int(one or 0.0) for one in whole])
    order = {one: k for k, one in enumerate(dict.fromkeys(cells))}
    return np.array([order[one] for one in cells])


def _times(given: list[Exposure], paths: Sequence[pathlib.Path], option: str) -> np.ndarray:
    """Times in s of the exposures. Raises `UserError` for one that is unknown."""
    time = np.array([float(np.asarray(one.motion.time)) for one in given])  # pyright: ignore[reportAttributeAccessIssue]
    unknown = ~np.isfinite(time) | (time == 0.0)
    if np.any(unknown):
        raise UserError(
            f"{option}: the time of {paths[int(np.argmax(unknown))].name} is unknown ({int(np.sum(unknown))} such "
            f"images); group them otherwise."
        )
    return time


def _near(time: np.ndarray, seconds: float) -> np.ndarray:
    """Numbers of groups of images whose times follow each other within `seconds`."""
    order = np.argsort(time, kind="stable")
    group = np.zeros(len(time), int)
    group[order] = np.cumsum(np.concatenate([[False], np.diff(time[order]) > seconds]))
    return group


def _cameras(given: list[Exposure], paths: Sequence[pathlib.Path], group: np.ndarray) -> np.ndarray:
    """Names of cameras: those with equal sensors are one, unless two folders have images of one in one group."""
    from jaxgeo.ties.cameras import cameras_of

    camera, _ = cameras_of(given, by_sensor=True)
    folder = np.array([path.parent.name for path in paths])
    both = {}
    for number, name, where in zip(group.tolist(), camera.tolist(), folder.tolist(), strict=True):
        both.setdefault((number, name), set()).add(where)
    if all(len(one) == 1 for one in both.values()):
        return camera
    is_one = len(np.unique(camera)) == 1
    return np.array([where if is_one else f"{name} in {where}" for name, where in zip(camera, folder, strict=True)])


def _by_lens(camera: np.ndarray, given: list[Exposure]) -> np.ndarray:
    """Names of cameras, one for each focal length or lens where a camera has several, as a zoom has."""
    from jaxgeo.ties.cameras import cameras_of

    lens, _ = cameras_of(given, by_sensor=False)
    several = {name for name in np.unique(camera).tolist() if len(np.unique(lens[camera == name])) > 1}
    return np.array([f"{name} {k}" if name in several else name for name, k in zip(camera, lens, strict=True)])
