"""Images that see no ground: their messages, with the reason if the camera is beside the elevation model."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from jaxgeo.cli._common import UserError
from jaxgeo.cli._screen import print_message
from jaxgeo.sensor import Shot

ALONG = "--along columns or --along rows"


def print_unseen(what: str, terrain: Any, motion: Any) -> None:
    """Print `what` and the reason, if the camera of a shot or of an exposure of a flight is beside the elevation
    model."""
    why = _beside(terrain, motion)
    if why is not None:
        print_message(f"{what}: {why}.")


@contextlib.contextmanager
def translate_unseen(terrain: Any, motion: Any, prefix: str = "") -> Iterator[None]:
    """Raise errors of images that see no ground as `UserError`, with the reason if the camera of `motion`, a shot or an
    exposure of a flight, is beside the elevation model."""
    from jaxgeo.coverage import SeesNoGround

    try:
        yield
    except SeesNoGround as error:
        why = _beside(terrain, motion)
        if why is not None:
            raise UserError(f"{prefix}the image sees no ground: {why}.") from error
        said = f"{error}".replace('say along="columns" or along="rows"', f"give {ALONG}")
        raise UserError(f"{prefix}{said}") from error


def _beside(terrain: Any, motion: Any) -> str | None:
    from jaxgeo.io.extent import camera_beside

    shot = motion if isinstance(motion, Shot) else motion.trajectory.at(motion.time)
    return camera_beside(terrain, shot.pose.position)
