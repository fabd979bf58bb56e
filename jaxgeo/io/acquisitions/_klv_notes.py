"""Sentences on telemetry: packets left out, assumptions and facts."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from jaxgeo.io._utc import utc_text
from jaxgeo.io.acquisitions._klv_columns import DERIVED, HELD, LONGEST_HELD, Columns, Numbers, Values, lacking
from jaxgeo.io.acquisitions.klv import Packet
from jaxgeo.io.acquisitions.sentences import heights_are
from jaxgeo.io.acquisitions.st0601 import label
from jaxgeo.io.datum_names import known_datum
from jaxgeo.io.given_camera import FORMS

TEXTS = (3, 4, 10, 11, 12, 59, 65)  # text tags for display


def damage(found: Sequence[Packet], kept: bool) -> list[str]:
    """Number of damaged packets, the reasons, and whether they were used."""
    damaged = [(k, one) for k, one in enumerate(found) if one.damage]
    if not damaged:
        return []
    first, packet = damaged[0]
    readable = sum(bool(one.items) for _, one in damaged)
    done = f"{readable} of them were kept" if kept else "they were left out"
    advice = f" keep_damaged=True reads the {readable} whose items can be told apart." if readable and not kept else ""
    return [
        f"{len(damaged)} of {len(found)} packets are damaged, {done}: "
        f"packet {first} at byte {packet.offset}: {packet.damage}{', ...' if len(damaged) > 1 else '.'}{advice}"
    ]


def left_out(numbers: Numbers, values: Values, count: int, fields_too: bool) -> list[str]:
    """Number of packets left out by missing quantity, and why a present quantity is unknown."""
    notes = []
    for what, (which, tags) in lacking(numbers.columns, fields_too).items():
        if not which.any():
            continue
        rows = np.flatnonzero(which)
        reasons = _sentinel_notes(numbers, tags, which)
        if 5 in tags and any(64 in values[int(row)] for row in rows):
            reasons.append("the magnetic heading (tag 64) is there, but not the declination that makes it a true one")
        if 16 in tags and not np.isfinite(numbers.columns["time"][rows]).all():
            reasons.append("an item of an earlier packet is not held in a packet without a time")
        why = "".join(f"; {reason}" for reason in reasons[:3])
        advice = f" Give the camera: {FORMS}." if 16 in tags else ""
        notes.append(f"{which.sum()} of {count} packets were left out for want of {what}{why}.{advice}")
    return notes


def _sentinel_notes(numbers: Numbers, tags: tuple[int, ...], which: np.ndarray) -> list[str]:
    """Why items with these tags are unknown in some packets, by their sentinels."""
    found = {tag: numbers.sentinels.get(tag, {}) for tag in tags}
    hits = [found[tag][row] for tag in tags for row in found[tag] if row < len(which) and which[row]]
    return list(dict.fromkeys(f"{' and '.join(map(_unitless, hit.fields))}: {hit.reason}" for hit in hits))


def times_unknown(numbers: Numbers, usable: np.ndarray) -> list[str]:
    """Number of used packets without a known time, and why. `numbers` are of all packets."""
    which = usable & ~np.isfinite(numbers.columns["time"])
    if not which.any():
        return []
    reasons = "".join(f"; {one}" for one in _sentinel_notes(numbers, (2,), which))
    return [
        f"The time of {which.sum()} of {usable.sum()} packets is unknown{reasons}. It is set to zero; no line of sight "
        f"depends on it."
    ]


def _unitless(name: str) -> str:
    return re.sub(r" \([^()]*\)$", "", name)


def assumed(
    numbers: Numbers,
    values: Values,
    datum: str | float | None,
    guessed_size: tuple[int, int] | None,
    upright: bool,
    is_given: bool,
) -> list[str]:
    """Sentences on what the packets do not state and the reader assumes."""
    columns = numbers.columns
    notes = []
    from_msl = ~np.isfinite(columns["height"])
    if guessed_size is not None:
        notes.append(
            f"The size of the images is not in the packets: {guessed_size[0]} x {guessed_size[1]} pixels, by the ratio "
            f"of the fields of view; image_size= says it."
        )
    if from_msl.any() and datum is None:
        notes.append(
            "Heights are above mean sea level, and the standard names no geoid: EGM96 (EPSG:5773); height_datum= says "
            "another."
        )
    if from_msl.any() and datum is not None:
        notes.append(heights_are(known_datum(datum)))
    if datum is not None and not from_msl.all():
        notes.append(
            f"{(~from_msl).sum()} packets have heights above the ellipsoid, so height_datum was not used there."
        )
    if not upright and not np.isfinite(columns["turn"]).all():
        notes.append("The roll of the sensor (tag 20) is not given everywhere: zero, the top of the image up.")
    notes += (
        ["The camera is the one given, not that of the packets, and has no error."]
        if is_given
        else _fields_of_view(numbers)
    )
    if np.isfinite(columns["time"]).any() and not any(136 in one for one in values):
        notes.append(
            "Times are taken as UTC; by newer editions of the standard they would count leap seconds, which tag 136 "
            "would tell."
        )
    if not is_given:
        notes.append("Fields of view reach from edge to edge of the image, and the lens has no distortion.")
    has_tag_102 = any(102 in one for one in values)
    notes.append("Accuracies (tag 102) are not read." if has_tag_102 else "The telemetry has no accuracy fields.")
    return notes


def _fields_of_view(numbers: Numbers) -> list[str]:
    held, derived = numbers.origin == HELD, numbers.origin == DERIVED
    across, down = numbers.columns["field_across"], numbers.columns["field_down"]
    notes = []
    if held.any():
        notes.append(
            f"The field of view of {held.sum()} packets is that of an earlier one, up to {numbers.age[held].max():.3g} "
            f"s old: items sent now and then are held until they change, at most {LONGEST_HELD:g} s."
        )
    if derived.any():
        angle = np.degrees(np.median(across[derived]))
        notes.append(
            f"The field of view of {derived.sum()} packets is not given; it is from target width and slant range, "
            f"2 atan(width / (2 range)): {angle:.3g} deg across (median). It moves pixels away from the middle only."
        )
    if not np.isfinite([across, down]).all():
        notes.append("Only one field of view (tag 16 or 17) is known in some packets: pixels are square there.")
    return notes


def facts(values: Values, columns: Columns, count: int) -> dict[str, str]:
    """Facts of the file for display."""
    found = {"packets": f"{count}, of which {len(values)} make exposures"}
    known = columns["time"][np.isfinite(columns["time"])]
    ends = [utc_text(float(time)) for time in ((known.min(), known.max()) if known.size else ())]
    found["times"] = " to ".join(filter(None, ends)) or "unknown"
    for tag in TEXTS:
        texts = dict.fromkeys(str(one[tag]) for one in values if one.get(tag) not in (None, "", b""))
        if texts:
            found[label(tag)] = ", ".join(texts)
    return found
