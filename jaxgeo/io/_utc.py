"""Times as text: ISO 8601 in UTC."""

from __future__ import annotations

import datetime
import math

LATEST = 253_402_300_799.0  # s since 1970: the end of the year 9999


def utc_text(time: float) -> str | None:
    """A time in s since 1970 as ISO 8601, 2024-05-10T10:20:31.250Z, to a millisecond; None if it is unknown."""
    if not (math.isfinite(time) and 0.0 < time < LATEST):
        return None
    moment = datetime.datetime.fromtimestamp(round(time, 3), datetime.UTC).replace(tzinfo=None)
    return f"{moment.isoformat(timespec='milliseconds')}Z"
