"""Images with their poses: of a scene, of their own tags, or of a file beside them."""

from __future__ import annotations

import dataclasses
import pathlib
import re
import shlex
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import jaxgeo
from jaxgeo.cli._acquisitions import ReadingOptions, print_unread, reading_files
from jaxgeo.cli._assumed import print_assumed
from jaxgeo.cli._common import UserError
from jaxgeo.cli._errors import Sigmas
from jaxgeo.cli._inputs import shot_of
from jaxgeo.cli._known_heights import with_known_heights
from jaxgeo.cli._option_names import as_typed, typed
from jaxgeo.cli._options import DemOptions
from jaxgeo.observation import Exposure

if TYPE_CHECKING:
    from jaxgeo.io import Observations

MOST_NAMED = 3  # images named in a message
NO_IMAGES = ("MISB", "subtitle", "video", "flight log", "SBET", "scene")  # kinds of files that name no images


@dataclasses.dataclass(frozen=True)
class OrientedImages:
    """The IMAGEs of a command, its --scene, --images and reading options."""

    files: list[pathlib.Path]
    scene: pathlib.Path | None
    folder: pathlib.Path | None
    reading: ReadingOptions

    @property
    def are_several(self) -> bool:
        """Whether the result is a folder: for more than one image, or files that may hold more."""
        return self.scene is None and (len(self.files) > 1 or self.files[0].is_dir() or self.folder is not None)

    @property
    def inputs(self) -> list[pathlib.Path]:
        """All files named by the options."""
        named = [*self.files, self.scene, self.reading.positions, self.reading.errors, self.reading.interior]
        return [one for one in named if one is not None]

    def check(self) -> None:
        """Raises `UserError` for options that contradict each other, and for wrong values."""
        given = self.reading.arguments
        if self.scene is None:
            if self.folder is not None:
                check_is_folder(self.folder)
            self._check_kinds()
            return
        if len(self.files) > 1 or self.files[0].is_dir():
            shown = self.files[0] if len(self.files) == 1 else f"{self.files[0]} and {len(self.files) - 1} more"
            raise UserError(
                f"--scene {self.scene} has the pose of one image; got {shown}. Leave --scene out for images that "
                f"state their own poses."
            )
        if self.folder is not None:
            raise UserError(f"--images {self.folder} is for a file with the poses of many; leave out --scene.")
        for name in given:
            raise UserError(f"{typed(name)} is for images that state their own poses; leave it out with --scene.")

    def _check_kinds(self) -> None:
        """Raises `UserError` for files that name no images, and for images beside --images."""
        from jaxgeo.io.acquisitions.detect import DRONE_IMAGES

        for file in self.files:
            form = form_of_file(file)
            if form is not None and form.name.startswith(NO_IMAGES):
                raise UserError(
                    f"{file} ({form.name}) does not refer to image files. Give drone images, or a reconstruction or "
                    f"table of orientations with --images FOLDER."
                )
            if self.folder is not None and form is DRONE_IMAGES:
                raise UserError(
                    f"--images {self.folder} is for a file of poses; {file} is of images, which state their own."
                )

    def on(self, dem: list[str], of_dem: DemOptions, sigmas: Sigmas | None = None) -> OrientedImages:
        """The same, with a take-off on the elevation model as a number. Raises as `with_known_heights`."""
        reading = with_known_heights(self.reading, self.files, self.scene, dem, of_dem, sigmas)
        return dataclasses.replace(self, reading=reading)

    def one(self) -> tuple[pathlib.Path, Exposure]:
        """(file, exposure) of the only image. Raises `UserError`, and as the readers."""
        from jaxgeo.io.scene import read_scene

        if self.scene is not None:
            found = read_scene(self.scene)
            return self.files[0], Exposure(
                found.sensor, shot_of(found, self.scene, "rectifying"), None, found.atmosphere
            )
        observed, (file,) = self.read()
        return pathlib.Path(f"{file}"), observed.at(0)[0].exposure

    def read(self) -> tuple[Observations, list[pathlib.Path]]:
        """(their observations, of the image centres; the file of each).

        Assumptions and unread files are printed on stderr. Raises `UserError`, and as the readers.
        """
        from jaxgeo.io import read_observations

        try:
            with reading_files(self.files) as progress:
                observed = read_observations(self.files, progress=progress, **self.reading.known_arguments)
        except UserError as error:  # here a scene is not for a file without a camera
            raise UserError(re.sub(r"--scene SCENE\.toml(, or )?", "", f"{error}")) from error
        assumed = map(as_typed, observed.assumed)
        print_assumed([one for one in assumed if "error" not in one and "sigma" not in one])  # orthoimages have none
        print_unread(observed.unread.values())
        return observed, self._files_of(observed)

    def _files_of(self, observed: jaxgeo.io.Observations) -> list[pathlib.Path]:
        """The image of each row. Raises `UserError` for exposures that are no images."""
        from jaxgeo.io.acquisitions.several import files_of

        names = [str(row.get("name")) for row in observed.columns]
        if self.folder is not None:
            return images_named(self.folder, names, observed.source)
        each = [pathlib.Path(one) for one in files_of(self.files)[0]]
        by_name = {one.name: one for one in each} | {f"{one}": one for one in each}
        unknown = next((name for name in names if name not in by_name), None)
        if unknown is not None:
            raise UserError(
                f"{observed.source}: exposure {unknown} is not among the given images; give the folder of the images "
                f"with --images FOLDER."
            )
        return [by_name[name] for name in names]


def check_is_folder(folder: pathlib.Path) -> None:
    """Raises `UserError` if the folder of --images does not exist or is a file."""
    if folder.is_dir():
        return
    if folder.exists():
        raise UserError(f"--images {folder}: this is a file; give the folder of the images: {_typed(folder.parent)}")
    near = next((one for one in folder.absolute().parents if one.is_dir()), None)
    raise UserError(
        f"--images {folder}: there is no such folder; of its path, {near} exists. Give the folder of the images."
    )


def images_named(folder: pathlib.Path, names: Sequence[str], source: str) -> list[pathlib.Path]:
    """The file in the folder of --images of each name in `source`. Raises `UserError` if none of them is there."""
    by_stem = images_in(folder)
    found = [image_named(folder, name, by_stem) for name in names]
    if any(one.is_file() for one in found):
        return found
    sought = f"{source} names {_some(names)}"
    below = _folder_below(folder, names)
    if below is not None:
        raise UserError(f"--images {folder}: {sought}; give the folder below it that has them: {_typed(below)}")
    if not by_stem:
        from jaxgeo.io.observation_reader import IMAGE_ENDINGS

        kinds = ", ".join(IMAGE_ENDINGS)
        raise UserError(f"--images {folder}: there is no image ({kinds}) in this folder; {sought}. Give their folder.")
    present = _some([one.name for each in by_stem.values() for one in each])
    raise UserError(
        f"--images {folder}: none of the images is there: {sought}, the folder has {present}. Give the folder of the "
        f"images that {source} names, under the names that it has."
    )


def _typed(folder: pathlib.Path) -> str:
    return f"--images {shlex.quote(str(folder))}"


def _folder_below(folder: pathlib.Path, names: Sequence[str]) -> pathlib.Path | None:
    """A folder in the given one that has the first image."""
    for one in sorted(folder.iterdir()):
        if one.is_dir() and image_named(one, names[0], images_in(one)).is_file():
            return one
    return None


def _some(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    shown = ", ".join(names[:MOST_NAMED])
    return shown if len(names) <= MOST_NAMED else f"{shown} and {len(names) - MOST_NAMED} more"


def images_in(folder: pathlib.Path) -> dict[str, list[pathlib.Path]]:
    """The images in a folder, by their names without ending."""
    from jaxgeo.io.observation_reader import IMAGE_ENDINGS

    by_stem: dict[str, list[pathlib.Path]] = {}
    for path in sorted(folder.iterdir()):
        if path.suffix.lower() in IMAGE_ENDINGS:
            by_stem.setdefault(path.stem, []).append(path)
    return by_stem


def image_named(folder: pathlib.Path, name: str, by_stem: dict[str, list[pathlib.Path]]) -> pathlib.Path:
    """The image of a name, which may have another ending or none. Raises `UserError` for several."""
    exact = folder / name
    found = [exact] if exact.is_file() else by_stem.get(exact.name, by_stem.get(exact.stem, []))
    if len(found) > 1:
        shown = ", ".join(one.name for one in found)
        raise UserError(f"--images {folder}: {name} may be {shown}; leave one of them in the folder.")
    return found[0] if found else exact


def form_of_file(file: pathlib.Path) -> Any:
    """The form of a file, None if it is not known."""
    from jaxgeo.io.acquisitions.detect import form_of
    from jaxgeo.io.errors import TableError

    try:
        return form_of(file)
    except (TableError, OSError):
        return None
