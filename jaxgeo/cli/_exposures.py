"""Exposures of files, of a scene, or of a scene with a table of shots: for commands about whole images."""

from __future__ import annotations

import dataclasses
import pathlib
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from jaxgeo.cli._acquisitions import ReadingOptions, print_unread, reading_files
from jaxgeo.cli._assumed import print_assumed
from jaxgeo.cli._common import UserError
from jaxgeo.cli._inputs import single
from jaxgeo.cli._known_heights import relative_heights, takeoff_instead
from jaxgeo.cli._level_ground import ground_doubts
from jaxgeo.cli._locate_options import GroundOptions
from jaxgeo.cli._option_names import as_typed, reason_not_read, typed
from jaxgeo.cli._options import ExposureFiles, ExposureNames, OptionGroup, SceneOfFiles
from jaxgeo.earth import Atmosphere
from jaxgeo.sensor import Sensor, Shot

if TYPE_CHECKING:
    from jaxgeo.coverage import MovingExposure
    from jaxgeo.io import Observations
    from jaxgeo.io.archives import View

OF_ERRORS = ("error", "sigma")  # words of assumptions that whole images do not need


@dataclasses.dataclass(frozen=True)
class GivenExposure:
    """An exposure with its name; `cells` are the columns of the table of shots that it came from."""

    name: str
    sensor: Sensor
    shot: Shot | MovingExposure
    atmosphere: Atmosphere | None
    cells: dict[str, Any] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class GivenExposures:
    """Exposures in order, whether they have names of their own; the reasons why files could not be read, by path."""

    exposures: list[GivenExposure]
    are_named: bool = False
    unread: dict[str, str] = dataclasses.field(default_factory=dict)

    def view(self) -> View:
        """Their lines of sight, for which ground is fetched."""
        from jaxgeo.io.archives import view_of_image
        from jaxgeo.io.archives.views import MOST_IMAGES

        some = self.exposures[:: max(1, -(-len(self.exposures) // MOST_IMAGES))]
        first, *others = [view_of_image(one.sensor, *_motion(one.shot)) for one in some]
        return dataclasses.replace(first, rays=tuple(ray for one in (first, *others) for ray in one.rays))


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExposureOptions(OptionGroup):
    """Files of exposures, or a scene."""

    panel: ClassVar[str | None] = "Options"
    shots: ClassVar[pathlib.Path | None] = None

    files: ExposureFiles = None
    scene: SceneOfFiles = None
    names: ExposureNames = None

    @property
    def is_scene(self) -> bool:
        """Whether a scene file has the pose, or the sensor of a table of shots."""
        files = self.files or []
        return not files or (len(files) == 1 and files[0].suffix.lower() == ".toml")

    @property
    def scene_file(self) -> pathlib.Path | None:
        """The scene file, from --scene or as FILE."""
        return self.files[0] if self.files and self.is_scene else self.scene

    def inputs(self, reading: ReadingOptions) -> list[pathlib.Path]:
        """All files that are named."""
        named = [*(self.files or []), self.scene, self.shots, reading.positions, reading.errors, reading.interior]
        return [one for one in named if one is not None]

    def check(self, reading: ReadingOptions) -> None:
        """Raises `UserError` for options that contradict each other, and for wrong values."""
        given = reading.arguments
        if not self.files and self.scene is None:
            raise UserError("give a FILE that jaxgeo inspect reads, or --scene SCENE.toml.")
        if self.files and self.is_scene and self.scene is not None:
            raise UserError(f"{self.files[0]} is itself a scene file; leave out --scene {self.scene}.")
        if self.shots is not None and self.files and not self.is_scene:
            more = f" and {len(self.files) - 1} more" if len(self.files) > 1 else ""
            raise UserError(f"--shots {self.shots}: use it with --scene, not with {self.files[0]}{more}.")
        if not self.is_scene:
            return
        if self.names:
            raise UserError(f"--exposure {self.names[0]} needs a FILE of exposures; a scene has only one.")
        for name, value in given.items():
            if name == "height_datum" and self.shots is not None:
                continue
            if name == "height_datum":
                raise UserError(
                    f"--camera-datum {value} applies to the heights of a FILE of exposures, or of --shots FILE; leave "
                    f"it out."
                )
            raise UserError(f"{typed(name)} is for a FILE of exposures; leave it out with a scene.")

    def read(self, reading: ReadingOptions, needed_by: str, ground: GroundOptions | None = None) -> GivenExposures:
        """The exposures; assumptions and unread files are printed on stderr. Raises `UserError`, and as the readers."""
        if self.is_scene:
            return GivenExposures(self._of_scene(reading.height_datum, needed_by))
        observed = self.read_files(reading, ground)
        return GivenExposures(_in_order(observed), True, _reasons(observed))

    def read_files(self, reading: ReadingOptions, ground: GroundOptions | None = None) -> Observations:
        """What the files hold; assumptions and unread files are printed on stderr. Raises as the readers."""
        from jaxgeo.io import read_observations

        files = self.files or []
        with reading_files(files) as progress:
            observed = read_observations(
                files, scene=self.scene, exposures=self.names or (), progress=progress, **reading.known_arguments
            )
        assumed = [one for one in map(as_typed, observed.assumed) if not any(word in one for word in OF_ERRORS)]
        if ground is not None:
            assumed += [
                *ground_doubts(observed, ground, takeoff_instead(reading, ground)),
                *relative_heights(reading, ground),
            ]
        print_assumed(assumed)
        print_unread(observed.unread.values())
        return observed

    def _of_scene(self, height_datum: str | None, needed_by: str) -> list[GivenExposure]:
        from jaxgeo.cli._inputs import shot_of, shots_of
        from jaxgeo.io.acquisitions._camera_checks import camera_doubts
        from jaxgeo.io.observations import frame_camera_of
        from jaxgeo.io.scene import read_scene

        path = self.scene_file
        assert path is not None
        scene = read_scene(path)
        print_assumed(camera_doubts(frame_camera_of(scene.sensor)))
        if self.shots is None:
            return [GivenExposure(path.name, scene.sensor, shot_of(scene, path, needed_by), scene.atmosphere)]
        batch, rows = shots_of(scene, path, self.shots, height_datum)
        each = zip(_names_of(rows), single(batch), rows, strict=True)
        return [GivenExposure(name, scene.sensor, shot, scene.atmosphere, cells) for name, shot, cells in each]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ExposureOrShotOptions(ExposureOptions):
    """Files of exposures, or a scene, alone or with a table of shots."""

    shots: Annotated[  # pyright: ignore[reportIncompatibleVariableOverride]
        pathlib.Path | None,
        typer.Option("--shots", metavar="FILE", help="With --scene: CSV with a shot per row."),
    ] = None


def _names_of(rows: list[dict[str, Any]]) -> list[str]:
    """Names of shots: those of a column `name` in which each has one of its own, else their numbers from 0."""
    names = [f"{row.get('name') or ''}".strip() for row in rows]
    return names if all(names) and len(set(names)) == len(names) else [str(index) for index in range(len(rows))]


def _in_order(observed: Observations) -> list[GivenExposure]:
    found = []
    for row in observed.read_rows.tolist():
        exposure = observed.at(row)[0].exposure
        name = str(observed.columns[row].get("name", row))
        assert isinstance(exposure.motion, Shot)
        found.append(GivenExposure(name, exposure.sensor, exposure.motion, exposure.atmosphere))
    return found


def _reasons(observed: Observations) -> dict[str, str]:
    return {str(one.path): reason_not_read(one) for one in observed.unread.values()}


def _motion(shot: Shot | MovingExposure) -> tuple[Any, ...]:
    """A shot, or a trajectory and a time."""
    return (shot,) if isinstance(shot, Shot) else (shot.trajectory, shot.time)


def sensors_differ(one: Sensor, other: Sensor) -> bool:
    """Whether two sensors differ in a number or in their kind."""
    import equinox as eqx

    return one is not other and not bool(eqx.tree_equal(one, other))
