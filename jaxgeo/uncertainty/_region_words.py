"""Shares, places and areas of a region in words."""

from __future__ import annotations

import math
from typing import Any

COMPASS = ("north", "north-east", "east", "south-east", "south", "south-west", "west", "north-west")
BESIDE = {
    "farther": "farther from the camera",
    "nearer": "nearer to the camera",
    "left": "to its left as the camera sees it",
    "right": "to its right as the camera sees it",
}
SMALL = 0.005  # share of the samples; smaller pieces are counted only
LEVEL = 0.05  # of the distance: smaller height differences are not worth a word


def mode_words(mode: Any) -> str:
    """Share and place of a piece."""
    return f"{percent(mode.share.value)} lie {place_words(mode)}"


def place_words(mode: Any) -> str:
    """Where a piece lies from the fix."""
    if mode.holds_fix:
        return "around the fix"
    words = [f"{length_words(mode.distance)} to the {COMPASS[round(mode.azimuth / (math.pi / 4.0)) % 8]}"]
    if mode.beside:
        words.append(BESIDE[mode.beside])
    if abs(mode.rise) >= max(LEVEL * mode.distance, 1.0):
        words.append(f"{length_words(abs(mode.rise))} {'higher' if mode.rise > 0.0 else 'lower'}")
    return ", ".join(words)


def region_words(region: Any) -> str:
    """The pieces of a region, and what is outside of it."""
    told = [mode for mode in region.modes if mode.share.value >= SMALL] or list(region.modes[:1])
    small = len(region.modes) - len(told)
    share = percent(region.probability)
    if len(region.modes) == 1:
        said = [f"{share} in one area of {area_words(region.area)} {place_words(told[0])}."]
    else:
        pieces = "; ".join(mode_words(mode) for mode in told)
        rest = f"; the rest in {small} small {'area' if small == 1 else 'areas'}" if small else ""
        said = [f"{share} in {len(region.modes)} areas of {area_words(region.area)} in all: {pieces}{rest}."]
    lost = region.without_ground.value
    outside = f"{percent(region.outside.value)} outside"
    said.append(f"{outside}, {percent(lost)} of all without ground." if lost > 0.0 else f"{outside}.")
    return " ".join(said)


def percent(share: float) -> str:
    """A share in percent: whole numbers, or one significant digit below one and within one of 100."""
    value = 100.0 * share
    if 0.0 < value < 0.95:
        return f"{value:.1g} %"
    if 99.05 < value < 100.0:
        return f"{100.0 - float(f'{100.0 - value:.1g}'):g} %"
    return f"{value:.0f} %"


def length_words(metres: float) -> str:
    """A length with two significant digits, in m or km."""
    rounded = float(f"{metres:.2g}")
    return f"{rounded / 1000.0:g} km" if rounded >= 1000.0 else f"{rounded:g} m"


def area_words(square_metres: float) -> str:
    """An area with two significant digits, in m², ha or km²."""
    for unit, size in (("km²", 1e6), ("ha", 1e4)):
        if square_metres >= size:
            return f"{float(f'{square_metres / size:.2g}'):g} {unit}"
    return f"{float(f'{square_metres:.2g}'):g} m²"
