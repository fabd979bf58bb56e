"""Options of `jaxgeo locate` and `jaxgeo report`: what is located, the ground, and how they are read."""

from __future__ import annotations

import dataclasses
import pathlib
import re
from typing import Annotated, Any, ClassVar

import typer

from jaxgeo.cli._acquisitions import ReadingOptions
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._inputs import check_goes_with_dem, terrain_files
from jaxgeo.cli._options import SEEN, DemOptions, ExposureFiles, ExposureNames, OptionGroup, SceneOfFiles

Refraction = Annotated[
    bool,
    typer.Option("--refraction", help="Apply refraction (US Standard Atmosphere 1976).", rich_help_panel=SEEN),
]


@dataclasses.dataclass(frozen=True, kw_only=True)
class ObservationOptions(OptionGroup):
    """Files, and pixels of their exposures."""

    panel: ClassVar[str | None] = SEEN

    files: ExposureFiles = None
    scene: SceneOfFiles = None
    shots: Annotated[
        pathlib.Path | None,
        typer.Option("--shots", metavar="FILE", help="With --scene: CSV with a shot and a pixel per row."),
    ] = None
    pixels: Annotated[
        list[str] | None,
        typer.Option("--pixel", metavar="PIXEL", help="COLUMN,ROW of a pixel (repeatable; default: image centre)."),
    ] = None
    detections: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--detections",
            metavar="FILE",
            help="Detections to locate instead of pixels: CSV (image, u, v or u_min ... v_max), GeoJSON in pixels, "
            "COCO, or a folder of YOLO files.",
        ),
    ] = None
    pixel_origin: Annotated[
        str | None,
        typer.Option(
            "--pixel-origin",
            metavar="ORIGIN",
            help="Pixel (0, 0) of --detections in CSV and GeoJSON: the centre (default) or corner of the first.",
        ),
    ] = None
    class_names: Annotated[
        pathlib.Path | None,
        typer.Option(
            "--class-names",
            metavar="FILE",
            help="YOLO: names of the classes of --detections, a data.yaml or a text with a name a line (default: "
            "classes.txt or data.yaml beside them).",
        ),
    ] = None
    anchor: Annotated[
        str | None,
        typer.Option(
            "--anchor",
            metavar="PLACE",
            help="Pixel of a box or polygon of --detections: its centre (default), or the bottom, where an upright "
            "object stands.",
        ),
    ] = None
    exposures: ExposureNames = None
    shard: Annotated[
        str | None,
        typer.Option("--shard", metavar="I/N", help="Part I of N of the files, or of the rows of one: for N jobs."),
    ] = None

    @property
    def part(self) -> tuple[int, int] | None:
        """The number and count of --shard. Raises `UserError`."""
        if self.shard is None:
            return None
        found = re.fullmatch(r"([0-9]+)/([0-9]+)", self.shard)
        if found is None or not 1 <= int(found[1]) <= int(found[2]):
            raise UserError(f"--shard {self.shard}: give I/N, part I (from 1) of N, e.g. --shard 3/16.")
        return int(found[1]), int(found[2])


NO_GROUND = (
    "give the ground: --dem FILE, an elevation model; --dem copernicus, which is fetched from an open archive; or "
    "--ground HEIGHT, level ground at a height in m."
)

NO_GROUND_OF_PIXELS = (
    f"{NO_GROUND.removesuffix('.')}; or --ground reported, the height of the frame centre that telemetry reports."
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class GroundOptions(DemOptions):
    """An elevation model, or level ground."""

    first: ClassVar[tuple[str, ...]] = ("dem",)

    vertical_datum: Annotated[
        str | None,
        typer.Option(
            "--dem-datum",
            metavar="DATUM",
            help='Vertical datum of the ground: "EPSG:5773", "ellipsoid", an undulation in m, a geoid grid.',
            rich_help_panel=SEEN,
        ),
    ] = None
    dem: Annotated[
        list[str] | None,
        typer.Option(
            "--dem",
            metavar="FILE",
            help="Elevation model: a file, an archive (copernicus, copernicus-90, srtm, 3dep: fetched as needed), or "
            "a URL with --allow-remote; repeatable for tiles.",
            rich_help_panel=SEEN,
        ),
    ] = None
    level: Annotated[
        str | None,
        typer.Option(
            "--ground",
            metavar="HEIGHT",
            help="Level ground instead of --dem: height in m above the ellipsoid or --dem-datum; for locate and others "
            "of pixels also 'reported': the frame centre height in the telemetry.",
            rich_help_panel=SEEN,
        ),
    ] = None


@dataclasses.dataclass(frozen=True)
class LocateOptions:
    """Options of one run of `jaxgeo locate` or `jaxgeo report`; checked."""

    of_images: ObservationOptions
    ground: GroundOptions
    reading: ReadingOptions = ReadingOptions()
    sigmas: Sigmas = Sigmas()
    refraction: bool = False

    @property
    def files(self) -> list[pathlib.Path]:
        """The FILEs."""
        return self.of_images.files or []

    @property
    def pixels(self) -> list[str]:
        """The values of --pixel."""
        return self.of_images.pixels or []

    @property
    def is_scene(self) -> bool:
        """Whether the exposures come from a scene file: by --scene, or as the only FILE."""
        return not self.files or (len(self.files) == 1 and _is_scene_file(self.files[0]))

    @property
    def scene_file(self) -> pathlib.Path | None:
        """The scene file, from --scene or as FILE."""
        return self.files[0] if self.files and self.is_scene else self.of_images.scene

    @property
    def has_terrain_field(self) -> bool:
        """Whether ground height errors are spatially correlated, by an option or by the scene's [errors] table."""
        scenes = {path for path in (self.of_images.scene, self.scene_file) if path is not None and _is_scene_file(path)}
        texts = [path.read_text(encoding="utf-8", errors="replace") for path in scenes if path.is_file()]
        return self.sigmas.dem_correlation is not None or any("terrain_correlation_m" in text for text in texts)

    @property
    def inputs(self) -> dict[str, Any]:
        """The options as typed, by name."""
        given, ground = self.of_images, self.ground
        paths = {"file": self.files[0] if len(self.files) == 1 else None, "scene": given.scene, "shots": given.shots}
        paths |= {"detections": given.detections, "anchor": given.anchor, "pixel_origin": given.pixel_origin}
        paths |= {"class_names": given.class_names}
        found: dict[str, Any] = {name: str(path) for name, path in paths.items() if path is not None}
        if len(self.files) > 1:
            found["files"] = [str(path) for path in self.files]
        found |= {} if given.shard is None else {"shard": given.shard}
        found |= {"dem": list(ground.dem)} if ground.dem else {"ground": ground.level}
        found |= {f"dem_{name.removeprefix('dem_')}": value for name, value in ground.of_files.items()}
        if ground.vertical_datum is not None:
            found["vertical_datum"] = ground.vertical_datum
        how = self.reading.arguments
        found |= {name: str(value) if isinstance(value, pathlib.Path) else value for name, value in how.items()}
        sigmas = self.sigmas.given
        return found | ({"sigmas": sigmas} if sigmas else {}) | ({"refraction": True} if self.refraction else {})

    @property
    def input_files(self) -> list[str | pathlib.Path]:
        """All files that are read, those in folders too."""
        given, reading = self.of_images, self.reading
        named = [
            *self.files,
            given.scene,
            given.shots,
            given.detections,
            reading.errors,
            reading.interior,
            reading.positions,
        ]
        files: list[str | pathlib.Path] = [one for one in named if one is not None]
        if reading.camera is not None and reading.camera.lower().endswith((".toml", ".cam", ".json")):
            files.append(reading.camera)
        for folder in [pathlib.Path(one) for one in files if pathlib.Path(one).is_dir()]:
            files += sorted(folder.iterdir())
        return [*files, *(terrain_files(self.ground.dem, self.ground) if self.ground.dem else [])]

    def check(self) -> None:
        """Raises `UserError` for options that contradict each other."""
        given, ground = self.of_images, self.ground
        if given.part is not None and given.exposures and len(self.files) > 1:
            raise UserError("--exposure of several FILEs and --shard do not go together; name the files instead.")
        if not self.files and given.scene is None:
            raise UserError("give a FILE that jaxgeo inspect reads, or --scene SCENE.toml.")
        if len(self.files) > 1:
            for path in filter(_is_scene_file, self.files):
                raise UserError(
                    f"{path} is a scene file: give it alone, or as --scene {path} for files without a camera."
                )
        if given.shots is not None:
            if self.files:
                more = f" and {len(self.files) - 1} more" if len(self.files) > 1 else ""
                raise UserError(f"--shots {given.shots}: use it with --scene, not with {self.files[0]}{more}.")
            if self.pixels:
                raise UserError("give either --pixel COLUMN,ROW (repeatable) or --shots FILE.")
        self._check_detections()
        if ground.dem and ground.level is not None:
            raise UserError("--dem and --ground exclude each other: give one of them.")
        if not ground.dem and ground.level is None:
            raise UserError(NO_GROUND_OF_PIXELS)
        if not ground.dem:
            check_goes_with_dem(ground)
        if given.exposures and self.is_scene:
            raise UserError("--exposure needs a FILE of exposures; a scene has only one.")
        if self.sigmas.dem_correlation is not None and ground.level is not None:
            raise UserError("--dem-correlation: level ground has one common height error; use it with --dem.")

    def _check_detections(self) -> None:
        given = self.of_images
        if given.detections is None:
            options = {"pixel-origin": given.pixel_origin, "class-names": given.class_names, "anchor": given.anchor}
            for name, value in options.items():
                if value is not None:
                    raise UserError(f"--{name} {value} goes with --detections FILE.")
            return
        if self.is_scene:
            raise UserError(f"--detections {given.detections} needs FILEs of images, which it names.")
        if self.pixels:
            raise UserError("give either --pixel COLUMN,ROW (repeatable) or --detections FILE.")
        if given.shard is not None:
            raise UserError("--shard and --detections do not go together; name the images of each job.")
        if given.pixel_origin not in (None, "centre", "corner"):
            raise UserError(f"--pixel-origin {given.pixel_origin}: expected centre or corner.")
        if given.class_names is not None and given.detections.is_file():
            raise UserError(
                f"--class-names {given.class_names} goes with a folder of YOLO files, but --detections "
                f"{given.detections} is a file."
            )
        if given.anchor not in (None, "centre", "bottom"):
            raise UserError(f"--anchor {given.anchor}: expected centre or bottom.")


def _is_scene_file(path: pathlib.Path) -> bool:
    return path.suffix.lower() == ".toml"
