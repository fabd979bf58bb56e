"""Camera angles from the caller instead of the image tags, and the hints that ask for them."""

from __future__ import annotations

from collections.abc import Sequence

from jaxgeo.io._csv import Limits
from jaxgeo.io.acquisitions._image_tags import ImageTags
from jaxgeo.io.errors import TableError

AIRCRAFT = "aircraft"
HEADING = "drone-dji:FlightYawDegree"
YAW: Limits = (-360.0, 360.0, "deg")
PITCH: Limits = (-180.0, 180.0, "deg")
ROLL: Limits = (-180.0, 180.0, "deg")

GivenAngles = tuple[float | None, float, float]  # yaw, None: each aircraft's heading; pitch, roll; deg


def checked_angles(gimbal_deg: Sequence[float | int | str]) -> GivenAngles:
    """Validate a caller's angles. Raises `TableError` unless there are three within their limits."""
    shown = ", ".join(f'"{one}"' if isinstance(one, str) else f"{one:g}" for one in gimbal_deg)
    if len(gimbal_deg) != 3:
        raise TableError(f"gimbal_deg=({shown}): expected three angles in deg: yaw, pitch, roll.")
    found: list[float | None] = []
    for value, name, (low, high, _) in zip(gimbal_deg, ("yaw", "pitch", "roll"), (YAW, PITCH, ROLL), strict=True):
        if name == "yaw" and value == AIRCRAFT:
            found.append(None)
            continue
        if isinstance(value, str):
            raise TableError(f"gimbal_deg=({shown}): {name} is {value!r}; expected deg, or yaw as {AIRCRAFT!r}.")
        if not low <= value <= high:
            raise TableError(f"gimbal_deg=({shown}): {name} {value:g} is outside [{low:g}, {high:g}] deg.")
        found.append(float(value))
    yaw, pitch, roll = found
    assert pitch is not None
    assert roll is not None
    return yaw, pitch, roll


def angles_given(tags: ImageTags, given: GivenAngles) -> tuple[float, float, float]:
    """Yaw, pitch and roll in deg of one image. Raises `TableError` if the aircraft heading is missing."""
    yaw, pitch, roll = given
    if yaw is None:
        yaw = tags.number(HEADING, YAW)
    if yaw is None:
        raise TableError(
            f"{tags.path}: yaw is asked for as the heading of the aircraft, which is not given ({HEADING}); "
            f"give it in deg: gimbal_deg=(0, {pitch:g}, {roll:g})."
        )
    return yaw, pitch, roll


def given_note(given: GivenAngles) -> str:
    """Sentence: angles are from the caller."""
    yaw = "the heading of the aircraft" if given[0] is None else f"{given[0]:g} deg"
    return f"The camera's angles are as given: yaw {yaw}, pitch {given[1]:g} deg, roll {given[2]:g} deg."


def by_hand(tags: ImageTags) -> str:
    """Hint for an image without angles: straight down, with the aircraft's heading if known."""
    try:
        heading = tags.number(HEADING, YAW)
    except TableError:
        heading = None
    top = "to the north" if heading is None else f"along the heading of the aircraft, {heading:g} deg"
    yaw = "0" if heading is None else f'"{AIRCRAFT}"'
    return (
        f"Give yaw, pitch and roll of the camera in deg; of one that looked straight down, its top {top}: "
        f"gimbal_deg=({yaw}, -90, 0)."
    )
