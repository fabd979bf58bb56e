"""Tables 1 to 4 of Li et al. (2020), printed and obtained."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.causes import needed_factors
from jaxgeo.studies.li2020.claim_parts import ERRORS, HELD, LAST_DIGIT, claim, column_of
from jaxgeo.studies.li2020.flight import overlap_of_azimuth_error

if TYPE_CHECKING:
    from jaxgeo.studies.li2020.report import Report


def claims_of_tables(report: Report) -> list[Claim]:
    """Claims of all four tables, Table 4 by its parts."""
    heading, wanted = column_of(report, "heading", "formula"), list(printed.TABLES["heading"])
    low, high = needed_factors()
    best = max(report.causes, key=lambda one: (one.entries, one.elsewhere or 0))
    tried = (
        f"The entries are Eq 19 times {low:.5f} to {high:.5f}, and the transform of coordinates says Eq 19. "
        f"{len(report.causes)} causes were put in, see the sheet of causes: none that the paper names gives it. "
        f"What gives all five entries, {best.tried}, stands nowhere in the paper."
    )
    return [
        claim(
            "Table 1",
            "change of overlap by 0.2, 0.4, 0.6, 0.8° of heading",
            wanted[:4],
            heading[:4],
            "coverage.geometry.overlap_change_by_heading",
            tolerance=LAST_DIGIT,
            reason=f"To one unit of the last digit; the third would be rounded to {heading[2]:.4f}.",
        ),
        claim(
            "Table 1",
            "change of overlap by 1.0° of heading",
            wanted[4],
            heading[4],
            "coverage.geometry.overlap_change_by_heading",
            tolerance=LAST_DIGIT,
            explanation=Explanation(
                "four significant digits, as in the other rows, and a zero filled in",
                float(f"{heading[4]:.4g}"),
                wanted[4],
                0.5 * LAST_DIGIT,
            ),
        ),
        claim(
            "Table 2",
            "change of overlap by 0.2 to 1.0° of pitch",
            list(printed.TABLES["pitch"]),
            column_of(report, "pitch", "formula"),
            "coverage.geometry.overlap_change_by_pitch",
            tolerance=LAST_DIGIT,
            reason=tried,
        ),
        claim(
            "Table 3",
            "change of overlap by 0.2 to 1.0° of roll",
            list(printed.TABLES["roll"]),
            column_of(report, "roll", "formula"),
            "coverage.geometry.overlap_change_by_roll",
            tolerance=LAST_DIGIT,
        ),
        *_table_4(report),
    ]


def _table_4(report: Report) -> list[Claim]:
    seen, pairs = report.sightings, report.pairs
    azimuths, swapped = (float(np.std([getattr(one, name) for one in seen])) for name in ("azimuth", "swapped_azimuth"))
    per_degree = overlap_of_azimuth_error(1.0, pairs[0].depression)
    of_pair = math.sqrt(2.0) * azimuths * per_degree
    of_mean = of_pair / len(pairs)  # errors of the intermediate strips cancel between neighbouring pairs
    found = [_pair(one.strips, one.printed, one.by_eq_16, of_pair, one.off_deg) for one in pairs]
    held = np.array([one.held for one in pairs])
    return [
        claim(
            "Table 4, azimuth",
            "azimuth drives of the five strips, if the line of sight is held on its mean",
            [one.azimuth_drive for one in seen],
            [one.predicted_azimuth_drive for one in seen],
            "coverage.compensation_formulas.angles_towards",
            tolerance=HELD,
            unit="°",
            digits=".6g",
        ),
        claim(
            "Table 4, depression",
            "depression drives of the five strips, if the line of sight is held on its mean",
            [one.depression_drive for one in seen],
            [one.predicted_depression_drive for one in seen],
            "coverage.compensation_formulas.angles_towards",
            tolerance=HELD,
            unit="°",
            digits=".6g",
        ),
        claim(
            "Table 4, attitude",
            "roll and pitch are what their Greek letters are in Eq 4: scatter of the line of sight's azimuth",
            0.0,
            swapped,
            "sensor.Sensor.R_ned_from_camera",
            tolerance=HELD,
            unit="°",
            explanation=Explanation("the words hold, the letters of roll and pitch are swapped", azimuths, 0.0, HELD),
        ),
        *found,
        claim(
            "Table 4, mean",
            "mean overlap of the four pairs",
            float(np.mean([one.printed for one in pairs])),
            float(np.mean([one.by_eq_16 for one in pairs])),
            "coverage.transform.overlap_of_eq_16",
            tolerance=ERRORS * of_mean,
            reason=(
                f"{ERRORS:.0f} standard errors: azimuths scatter by {azimuths:.3f}°, and only the first and the last "
                f"strip count in the mean. With every line of sight on the mean: {held.mean():.1%}."
            ),
        ),
        claim(
            "Table 4, scatter",
            "standard deviation of the four pairs",
            100.0 * float(np.std([one.printed for one in pairs], ddof=1)),
            100.0 * float(np.std([one.by_eq_16 for one in pairs], ddof=1)),
            "coverage.transform.overlap_of_eq_16",
            tolerance=1.0,
            unit="points",
            reason="The print has whole percents.",
            explanation=Explanation(
                "The printed angles' own error, which the images do not show: with the line of sight held on its mean",
                100.0 * float(held.std(ddof=1)),
                100.0 * float(np.std([one.printed for one in pairs], ddof=1)),
                1.0,
            ),
        ),
    ]


def _pair(strips: str, wanted: float, obtained: float, error: float, off_deg: float) -> Claim:
    return claim(
        "Table 4, overlap",
        f"overlap of strips {strips}",
        wanted,
        obtained,
        "coverage.transform.overlap_of_eq_16",
        tolerance=ERRORS * error,
        reason=(
            f"{ERRORS:.0f} standard errors, by the scatter of the lines of sight; a single pair tells little: the "
            f"difference is {off_deg:+.3f}° of azimuth, and 0.02° is 2.2 points."
        ),
    )
