"""What the reading of a raster may touch: the file and files beside it, and more only where the caller allows it."""

from __future__ import annotations

import dataclasses
import os
import re

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_PREFIX = re.compile(r"[A-Za-z][A-Za-z0-9_]+:")  # of GDAL's own names, such as NETCDF: or WMS:; no drive of Windows
# Names of one part of a local file, as GDAL lists them.
_PARTS = (
    re.compile(r'NETCDF:"(?P<file>[^"]+)":'),
    re.compile(r"NETCDF:(?P<file>[^\":]+):"),
    re.compile(r"GTIFF_DIR:(?:off:)?\d+:(?P<file>.+)"),
    re.compile(r"vrt://(?P<file>[^?]+)"),
)


@dataclasses.dataclass(frozen=True)
class Reach:
    """What may be touched beyond a file and what lies beside or below it.

    - `remote`: places on the network, archives and other names that only GDAL resolves (`/vsi...`, `WMS:...`), and
      documents of any of GDAL's formats.
    - `outside`: files of this machine outside the folder of the file that names them.
    """

    remote: bool = False
    outside: bool = False


HERE = Reach()
ALLOW_REMOTE = "Pass allow_remote=True if you trust it"
ALLOW_OUTSIDE = "Pass allow_outside=True if you trust it"


def is_local(name: str) -> bool:
    """Whether a name is that of a file in the file system, not one that only GDAL can reach."""
    return not name.startswith("/vsi") and "://" not in name and not _PREFIX.match(name)


def is_remote(name: str) -> bool:
    """Whether a name is a URL or of one of GDAL's virtual file systems; `vrt://`, a view of a file, is neither."""
    return name.startswith("/vsi") or (_SCHEME.match(name) is not None and not name.startswith("vrt://"))


def file_in(name: str) -> str | None:
    """The file in a name of GDAL's for a part of a local file; None for any other name."""
    found = next((match["file"] for one in _PARTS if (match := one.fullmatch(name) or one.match(name))), None)
    return None if found is None or is_remote(found) or not is_local(found) else found


def is_beside(file: str, folder: str) -> bool:
    """Whether a file lies in a folder or below it, links followed."""
    inside, around = os.path.realpath(file), os.path.realpath(folder)
    return inside == around or inside.startswith(around.rstrip(os.sep) + os.sep)
