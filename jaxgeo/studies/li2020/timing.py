"""Heights over mountains and times between strips: sections 3.2, 3.3 and 4 of Li et al. (2020)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from jaxgeo.coverage import geometry
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.flight import StripPair


@dataclass(frozen=True)
class Mountain:
    """Overlap over an unplanned mountain: by Eq 28, and with the same step over the nearer ground."""

    change: float
    by_eq_28: float
    of_the_step: float


@dataclass(frozen=True)
class Period:
    """Time in s between two strips: by Eq 29 for the required overlap, and from the aircraft positions."""

    strips: str
    by_eq_29: float
    implied: float


def mountain() -> Mountain:
    """Section 4: the mountain is 620 m above the planned ground height, 8080 m below the aircraft."""
    heights = {"height_change": printed.MOUNTAIN_CHANGE, "height_above_ground": printed.MOUNTAIN_HEIGHT}
    change = float(geometry.overlap_change_by_height(**heights))
    same_step = float(geometry.overlap_after_height_change(**heights, overlap=printed.OVERLAP))
    return Mountain(change, printed.OVERLAP + change, same_step)


def periods(flown: Sequence[StripPair], depression_deg: float) -> list[Period]:
    """Eq 29 with height and speed of Table 4's first strip and a mean depression in deg; and chords over speeds."""
    first = printed.TABLE_4[0]
    required = geometry.period_of_overlap(
        overlap=printed.OVERLAP,
        speed=first.speed_kmh / 3.6,
        height_above_ground=first.height_above_ground,
        off_nadir=math.radians(90.0 - depression_deg),
        field_of_view=math.radians(printed.FIELD_OF_VIEW),
    )
    return [Period(pair.strips, float(required), pair.flown / pair.speed) for pair in flown]
