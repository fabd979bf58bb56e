"""Table of drone cameras: focal length and pixel size by EXIF make and model, from data sheets or calibrations.

The table is `jaxgeo/data/cameras.toml`; each entry names its source. Entries with `zoom_mm` have no fixed focal length:
it comes from the EXIF tag.
"""

from __future__ import annotations

import functools
import pathlib
import tomllib
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, model_validator

FILE = pathlib.Path(__file__).parents[1] / "data" / "cameras.toml"
SAME_FOCAL = 0.04  # relative tolerance between EXIF's rounded focal length and the entry's
SAME_SHAPE = 0.005  # relative tolerance of the aspect ratio of resized images

Positive = Annotated[float, Field(gt=0.0)]
Share = Annotated[float, Field(gt=0.0, lt=0.2)]
Size = tuple[Annotated[int, Field(gt=0)], Annotated[int, Field(gt=0)]]


class CameraModel(BaseModel):
    """One camera of the table.

    - `makes`, `models`: EXIF's Make and Model verbatim, several where firmware or drones differ.
    - `focal_mm`, or `zoom_mm` (shortest, longest); `pitch_um`: pixel size on the detector in the modes of `sizes`,
      (width, height) in pixels, some of them cropped. `binned_sizes`: modes that bin (or split) detector pixels, with
      their own pixel size in um as a third number.
    - `film_mm`: the 35 mm equivalent focal length by the maker's data sheet or EXIF.
    - `focal_sigma`: relative standard deviation of the focal length in pixels.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    makes: tuple[str, ...]
    models: tuple[str, ...]
    focal_mm: Positive | None = None
    zoom_mm: tuple[Positive, Positive] | None = None
    pitch_um: Positive
    sizes: tuple[Size, ...] = Field(min_length=1)
    binned_sizes: tuple[tuple[int, int, Positive], ...] = ()
    film_mm: Positive | None = None
    focal_sigma: Share = 0.015
    thermal: bool = False
    source: Annotated[str, Field(min_length=10)]

    @model_validator(mode="after")
    def _one_focal_length(self) -> CameraModel:
        if (self.focal_mm is None) == (self.zoom_mm is None):
            raise ValueError(f"{self.name}: give either focal_mm or zoom_mm")
        return self

    @property
    def modes(self) -> tuple[tuple[int, int, float], ...]:
        """(width, height, pixel size in um) of all image modes."""
        return (*((width, height, self.pitch_um) for width, height in self.sizes), *self.binned_sizes)

    def focal_for(self, exif_mm: float | None) -> float | None:
        """Focal length in mm, given EXIF's if there is one; None if it is of another lens."""
        if self.focal_mm is None:
            assert self.zoom_mm is not None
            low, high = self.zoom_mm
            inside = exif_mm is not None and low * (1 - SAME_FOCAL) <= exif_mm <= high * (1 + SAME_FOCAL)
            return exif_mm if inside else None
        same = exif_mm is None or abs(exif_mm / self.focal_mm - 1.0) <= SAME_FOCAL
        return self.focal_mm if same else None

    def pitch_for(self, width: int, height: int) -> float | None:
        """Pixel size in um of an image, for a resized copy that of its larger pixels; None for an unknown mode.

        Copies are assumed to cover the whole detector and are matched by its aspect ratio: a cropped mode cannot be
        distinguished from another crop.
        """
        exact = next((pitch for w, h, pitch in self.modes if (w, h) == (width, height)), None)
        if exact is not None:
            return exact
        whole, high = self.sizes[0]
        is_smaller_copy = width < whole and abs(whole * height / (high * width) - 1.0) <= SAME_SHAPE
        return self.pitch_um * whole / width if is_smaller_copy else None


class KnownCamera(NamedTuple):
    """A camera of the table for one image size: focal length and pixel size in mm."""

    model: CameraModel
    focal_mm: float
    pitch_mm: float


@functools.cache
def camera_models() -> tuple[CameraModel, ...]:
    """All entries of the table. Raises `pydantic.ValidationError` for an invalid table."""
    entries: list[Any] = tomllib.loads(FILE.read_text(encoding="utf-8"))["camera"]
    return tuple(CameraModel.model_validate(entry) for entry in entries)


def known_camera(make: str, model: str, width: int, height: int, focal_mm: float | None = None) -> KnownCamera | None:
    """The camera for EXIF tags and a full image size in pixels; None if the table has no match, or two.

    >>> from jaxgeo.io.camera_table import known_camera
    >>> found = known_camera("DJI", "FC6310", 5472, 3648, 8.8)
    >>> print(found.model.name, found.focal_mm)
    Phantom 4 Pro 8.8
    """
    theirs = [
        one
        for one in camera_models()
        if model.strip().lower() in (name.lower() for name in one.models)
        and (not make.strip() or make.strip().lower() in (name.lower() for name in one.makes))
    ]
    return _only([_at(one, width, height, focal_mm) for one in theirs])


def named_camera(name: str, width: int, height: int, focal_mm: float | None = None) -> KnownCamera | None:
    """The camera for a name as people type it: EXIF's model, with or without the make, or the table's own name."""
    asked = name.strip().lower()
    theirs = [one for one in camera_models() if asked in names_of(one)]
    return _only([_at(one, width, height, focal_mm) or _at(one, width, height, None) for one in theirs])


def names_of(model: CameraModel) -> set[str]:
    """Accepted names of a camera, in lower case."""
    pairs = [f"{make} {one}" for make in model.makes for one in model.models]
    return {text.lower() for text in (model.name, *model.models, *pairs)}


def _at(one: CameraModel, width: int, height: int, focal_mm: float | None) -> KnownCamera | None:
    focal, pitch = one.focal_for(focal_mm), one.pitch_for(width, height)
    return None if focal is None or pitch is None else KnownCamera(one, focal, 1e-3 * pitch)


def _only(found: list[KnownCamera | None]) -> KnownCamera | None:
    cameras = [one for one in found if one is not None]
    focal = {round(one.focal_mm / one.pitch_mm) for one in cameras}
    return cameras[0] if len(focal) == 1 else None
