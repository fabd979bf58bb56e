"""Access limits of raster reading: the file and files beside it, more only if the caller allows it."""

from __future__ import annotations

import dataclasses
import os
import re

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_]+:")  # of GDAL names, such as NETCDF: or WMS:; not a Windows drive
# GDAL names of one part of a local file.
_PARTS = (
    re.compile(r'NETCDF:"(?P<file>[^"]+)":'),
    re.compile(r"NETCDF:(?P<file>[^\":]+):"),
    re.compile(r"GTIFF_DIR:(?:off:)?\d+:(?P<file>.+)"),
    re.compile(r"vrt://(?P<file>[^?]+)"),
)


@dataclasses.dataclass(frozen=True)
class Reach:
    """Permissions beyond a file and files beside or below it.

    - `remote`: network locations, archives and other GDAL names (`/vsi...`, `WMS:...`), and
      documents of any of GDAL's formats.
    - `outside`: local files outside the folder of the file that refers to them.
    """

    remote: bool = False
    outside: bool = False


HERE = Reach()
ALLOW_REMOTE = "Pass allow_remote=True if you trust it"
ALLOW_OUTSIDE = "Pass allow_outside=True if you trust it"


def is_local(name: str) -> bool:
    """Whether a name is of a file in the file system, not one that only GDAL can resolve."""
    return not name.startswith("/vsi") and "://" not in name and not _PREFIX.match(name)


def is_remote(name: str) -> bool:
    """Whether a name is a URL or a GDAL virtual file system path; `vrt://`, a view of a file, is neither."""
    return name.startswith("/vsi") or (_SCHEME.match(name) is not None and not name.startswith("vrt://"))


def file_in(name: str) -> str | None:
    """The file in a GDAL name for a part of a local file; None for any other name."""
    found = next((match["file"] for one in _PARTS if (match := one.fullmatch(name) or one.match(name))), None)
    return None if found is None or is_remote(found) or not is_local(found) else found


def is_beside(file: str, folder: str) -> bool:
    """Whether a file is in a folder or below it, with links resolved."""
    inside, around = os.path.realpath(file), os.path.realpath(folder)
    return inside == around or inside.startswith(around.rstrip(os.sep) + os.sep)
