"""Comparison tables of Li et al. (2020): printed values and those obtained here."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.causes import Cause, Products, needed_factors
from jaxgeo.studies.li2020.compensation import Compensation
from jaxgeo.studies.li2020.control import Control
from jaxgeo.studies.li2020.flight import Sighting, StripPair, mean_depression, overlap_of_azimuth_error
from jaxgeo.studies.li2020.influence import Influence
from jaxgeo.studies.li2020.relief import PLACES, Relief
from jaxgeo.studies.li2020.strips import (
    AS_IN_THE_PAPER,
    HEIGHT,
    MOUNTAINS,
    OFF_NADIR,
    PLAIN,
    PLANNED,
    SPEED,
    SWING,
    Strips,
)
from jaxgeo.studies.li2020.timing import Mountain, Period
from jaxgeo.studies.sheet import Cell, Sheet

REMARKS = {"heading": "Eq 18", "pitch": "Eq 19; the print is 2.155 % larger, unexplained", "roll": "Eq 22"}


def influence_sheet(found: Sequence[Influence]) -> Sheet:
    """Tables 1 to 3: changes of the overlap by attitude changes."""
    rows: list[list[Cell]] = [
        [
            one.angle,
            one.change_deg,
            one.printed,
            one.formula,
            one.by_slant_range,
            one.on_map,
            one.by_eq_16,
            REMARKS[one.angle],
        ]
        for one in found
    ]
    columns = {"angle": "", "change, °": ".1f", "printed": ".4f", "formula": ".5f", "slant range": ".5f"}
    columns |= {"on the map": ".5f", "step of Eq 16": ".4f", "remark": ""}
    note = (
        f"The formula is that of level ground; the other three transform coordinates, {printed.OFF_NADIR:.0f}° off "
        f"nadir from {printed.TABLE_4[0].height_above_ground:.0f} m. By the slant range and on the map the step counts "
        "along the flight, and the frame is as long as the slant range says, or as its edges lie apart on the map "
        f"(meridian {printed.CENTRAL_MERIDIAN:.0f}°), which takes the map's scale out. The step of Eq 16 is a "
        "distance: it folds where the second frame falls behind the first, and a roll's shift across counts as a step."
    )
    return Sheet("influence", "Attitude and overlap (Tables 1 to 3)", columns, rows, note)


def causes_sheet(found: Sequence[Cause], combined: Products) -> Sheet:
    """Tested causes of the factor of Table 2."""
    rows: list[list[Cell]] = [
        [one.factor, one.entries, one.elsewhere, one.tried]
        for one in sorted(found, key=lambda one: abs(one.factor - 1.02155))
    ]
    low, high = needed_factors()
    columns = {"factor": ".5f", "entries right": "d", "of Tables 1 and 3": "d", "tried": ""}
    note = (
        f"Table 2 is Eq 19 times {low:.5f} to {high:.5f}, as its five entries are rounded. Each row puts one thing "
        "into the computation: the factor at 1°, how many of the five entries come out, and, of a quantity set to what "
        "would be needed, how many of the ten of Tables 1 and 3 stay right. Nothing that the paper names gives the "
        "factor; what would give it contradicts Tables 1 and 3, or stands nowhere in the paper. Of "
        f"{combined.count} products of powers of two such quantities {combined.hits} meet the window, and by chance "
        f"{combined.by_chance:.1f} would: a hit among them says nothing. The factor stays unexplained."
    )
    return Sheet("causes", "Causes tried for the factor of Table 2", columns, rows, note)


def compensation_sheet(found: Sequence[Compensation]) -> Sheet:
    """Section 3.1: compensation of an attitude change."""
    rows: list[list[Cell]] = []
    for one in found:
        is_example = one.inner == 0.0
        shown = (printed.DEPRESSION_CHANGE, printed.AZIMUTH_DRIVE_CHANGE) if is_example else (None, None)
        remark = "" if is_example else f"Eqs 25 and 26 leave {one.left:.3f}°"
        rows.append([one.inner, "outer angle", shown[0], one.outer_change, one.outer_by_eq_26, remark])
        rows.append([one.inner, "azimuth drive", shown[1], one.drive_change, -0.5 * one.inner_by_eq_25, remark])
    columns = {"inner angle, °": ".0f", "change of": "", "printed, °": ".3f", "exact, °": ".5f"}
    columns |= {"Eqs 25 and 26, °": ".5f", "remark": ""}
    note = (
        "Heading 180° to 179°, pitch and roll 0° to 1°, outer angle -74°. The drive turns a mirror, and the line of "
        "sight twice as far: its change is half of what Eq 25 gives. Eqs 25 and 26 are exact for an inner angle of 0."
    )
    return Sheet("compensation", "Compensation of attitude (section 3.1)", columns, rows, note)


def sightings_sheet(found: Sequence[Sighting]) -> Sheet:
    """Table 4: lines of sight, and the drives that keep them constant."""
    rows: list[list[Cell]] = [
        [
            one.strip,
            one.azimuth,
            one.depression,
            one.azimuth_drive,
            one.predicted_azimuth_drive,
            one.depression_drive,
            one.predicted_depression_drive,
            one.swapped_azimuth,
        ]
        for one in found
    ]
    columns = {"strip": "d", "azimuth, °": ".3f", "depression, °": ".3f", "azimuth drive, printed": ".3f"}
    columns |= {"azimuth drive, predicted": ".3f", "depression drive, printed": ".3f"}
    columns |= {"depression drive, predicted": ".3f", "azimuth, swapped": ".3f"}
    azimuths, swapped = [one.azimuth for one in found], [one.swapped_azimuth for one in found]
    error = overlap_of_azimuth_error(0.02, mean_depression(list(found)))
    note = (
        f"Azimuth and depression of the line of sight by the printed attitude and drives: the mean is "
        f"{np.mean(azimuths):.3f}°, {mean_depression(list(found)):.3f}°, the azimuths' standard deviation "
        f"{np.std(azimuths):.3f}°. Predicted drives put the line of sight on that mean. With roll and pitch as the "
        f"table's Greek letters say (swapped) that would be {np.std(swapped):.3f}°. An error of 0.02° of the line of "
        f"sight's azimuth is {error:.1%} of overlap, of the drive {2.0 * error:.1%}."
    )
    return Sheet("sightings", "Lines of sight in flight (Table 4)", columns, rows, note)


def overlaps_sheet(found: Sequence[StripPair]) -> Sheet:
    """Table 4: overlaps."""
    rows: list[list[Cell]] = [
        [
            one.strips,
            one.printed,
            one.by_eq_16,
            one.along_track,
            one.along_ground,
            one.across_sight,
            one.held,
            one.length,
            f"{100.0 * (one.by_eq_16 - one.printed):+.1f} points, as by {one.off_deg:+.3f}° of azimuth; the line of "
            f"sight's changes by {one.turned:+.3f}°",
        ]
        for one in found
    ]
    numbers = np.array([row[1:-1] for row in rows], dtype=float)
    rows.append(["mean", *numbers.mean(axis=0).tolist(), ""])
    spread = ["standard deviation", *numbers.std(axis=0, ddof=1).tolist(), ""]
    rows.append(spread)
    columns = {"strips": "", "printed": ".1%", "step of Eq 16": ".1%", "along the track": ".1%"}
    columns |= {"along the ground": ".1%", "across the sight": ".1%", "held": ".1%", "frame, m": ".1f", "remark": ""}
    per_degree = overlap_of_azimuth_error(0.02, found[0].depression)
    note = (
        "Printed: measured in the images. The others are of the printed positions, heights, attitudes and drives, over "
        "level ground: by the distance of Eq 16, and by the step along the aircraft's track, along the way of the "
        "located points, and across the mean line of sight; held is along the track with every line of sight on the "
        "mean. The frame is that of the strip before, by its slant range. "
        f"A single pair tells little: 0.02° of the line of sight's azimuth is {100.0 * per_degree:.1f} points, the "
        "printed azimuths change by as much from strip to strip, and the images vary less than either: what the "
        "printed angles add to the overlap was not in the images. The mean is that of the whole flight, from the first "
        "strip to the last, and hangs on their angles alone."
    )
    return Sheet("overlaps", "Overlap in flight (Table 4)", columns, rows, note)


def timing_sheet(found: Sequence[Period], over: Mountain) -> Sheet:
    """Sections 3.2, 3.3 and 4: the mountain, and times between strips."""
    remark = f"Eq 28; {printed.MOUNTAIN_FLOWN:.0%} in the images"
    rows: list[list[Cell]] = [
        ["change of overlap over the mountain", printed.MOUNTAIN_OVERLAP_CHANGE, over.change, "Eq 28"],
        ["overlap over the mountain", printed.MOUNTAIN_OVERLAP, over.by_eq_28, remark],
        ["overlap over the mountain", None, over.of_the_step, "of the step itself: Eqs 2 and 27"],
        ["period for the required overlap, s", None, found[0].by_eq_29, "Eq 29, mean depression of Table 4"],
        *([f"period of strips {one.strips}, s", None, one.implied, "chord over speed"] for one in found),
    ]
    note = (
        "Eq 28 sets the change of the frame's length against its old length; the overlap of one and the same step over "
        "the nearer ground is a little larger. The paper prints no periods: those of the strips are the chords between "
        "the printed places, at the printed heights, over the speed at the strip before."
    )
    columns = {"figure": "", "printed": ".4g", "obtained": ".4g", "remark": ""}
    return Sheet("timing", "Mountain and periods (sections 3.2 to 4)", columns, rows, note)


def strips_sheet(found: Sequence[Strips]) -> Sheet:
    """Counterpart of Figs. 11 and 12."""
    shown = {(PLAIN, AS_IN_THE_PAPER): printed.FLOWN, (MOUNTAINS, AS_IN_THE_PAPER): printed.MOUNTAIN_FLOWN}
    rows: list[list[Cell]] = [
        [
            one.ground,
            one.timing,
            len(one.times),
            shown.get((one.ground, one.timing)),
            float(one.near.mean()),
            float(one.near.min()),
            float(one.near.max()),
            one.rms,
        ]
        for one in found
    ]
    columns = {"ground": "", "timing": "", "strips": "d", "printed": ".0%", "mean": ".1%", "least": ".1%"}
    columns |= {"largest": ".1%", "rms off": ".2%"}
    note = (
        f"In kind, not the paper's flight: its camera {OFF_NADIR:.0f}° off nadir, {HEIGHT:.0f} m above the ellipsoid "
        f"at {SPEED:.0f} m/s, both swinging by {SWING:.0%}, over level ground and over the mountains of the example "
        f"terrain; overlap at the near end, and its rms off {printed.OVERLAP:.0%}. Planned height is the paper's own "
        f"timing: Eq 36 with the speed and height of the moment, over ground planned at {PLANNED:.0f} m. The fixed "
        "period is that of Eq 29 for the same ground and the means without the swings; velocity-height is Eq 36 over "
        "the ground that the near end sees; ground shared times by the overlap itself. Printed: of the paper's images "
        "over a plain and over mountains that nobody planned for."
    )
    return Sheet("strips", "Strips over a plain and over mountains (Figs. 11 and 12 in kind)", columns, rows, note)


def control_sheet(found: Sequence[Control]) -> Sheet:
    """Gimbal control errors: the paper's future work."""
    rows: list[list[Cell]] = [
        [
            one.attitude,
            "yes" if one.is_compensated else "no",
            one.control,
            one.mean,
            one.mean_error,
            one.spread,
            one.spread_error,
            one.formula,
            one.gaps,
            one.needed,
        ]
        for one in found
    ]
    columns = {"attitude, °": ".1f", "compensated": "", "control, °": ".4f", "mean": ".2%", "± 1 sigma": ".2%"}
    columns |= {"spread": ".2%", "± 1 sigma of it": ".2%", "by formula": ".2%", "gaps": ".1%", "needed for 99 %": ".1%"}
    note = (
        f"The paper's camera, near end {printed.OFF_NADIR:.0f}° off nadir, "
        f"{printed.TABLE_4[0].height_above_ground:.0f} m over level ground, in drawn noise: standard deviations of "
        "heading, pitch and roll, and of each drive's reading, anew for every frame. Spread: standard deviation of the "
        "overlap at the near end; by formula: Eqs 18 and 19 and the mirror's gain of two, for small angles. Gaps: "
        f"share of pairs that leave one with {printed.OVERLAP:.0%} required. What is left without an error of control "
        "is the image's turning about the line of sight, since the near end lies beside it. The same draws serve all "
        "rows, so that their means go together."
    )
    return Sheet("control", "Errors of the gimbal's control (the paper's later work)", columns, rows, note)


def relief_sheet(found: Sequence[Relief]) -> Sheet:
    """Relief of the ground: the paper's future work."""
    rows: list[list[Cell]] = [
        [
            one.ground,
            one.relief,
            one.timing,
            one.pairs,
            one.mean,
            one.mean_error,
            one.spread,
            one.spread_error,
            one.off,
            one.off_error,
            one.by_height if one.timing == AS_IN_THE_PAPER else None,
            one.least,
            one.gaps,
        ]
        for one in found
    ]
    columns = {"ground": "", "relief, m": ".0f", "timing": "", "pairs": "d", "mean": ".2%", "±": ".2%"}
    columns |= {"along a flight": ".2%", "± ": ".2%", "off": ".2%", "±  ": ".2%"}
    columns |= {"off by Eq 28": ".2%", "least": ".1%", "gaps": ".1%"}
    note = (
        f"The paper's camera, near end {printed.OFF_NADIR:.0f}° off nadir, "
        f"{printed.TABLE_4[0].height_above_ground:.0f} m above the mean ground, over {PLACES} seeds of fractal ground, "
        "or places of the example terrain with its relief made smaller and larger; relief is the standard deviation of "
        "heights. Mean, spread along a flight, and rms off the required overlap, each with half of its 95 % interval "
        "over the places. By Eq 28: (1 - rho0) times the relief over the height, for a step planned over the mean "
        "ground. Planned height times by Eq 36 over the mean ground, as the paper does; velocity-height over "
        "the ground seen."
    )
    return Sheet("relief", "Relief of the ground (the paper's later work)", columns, rows, note)
