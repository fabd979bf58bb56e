"""What Li et al. (2020) print, item by item, with what comes out here: equations, tables, figures and statements."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxgeo.coverage import geometry
from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.attitude import ACTUAL, COMPENSATED, EXPECTED
from jaxgeo.studies.li2020.causes import needed_factors
from jaxgeo.studies.li2020.equations import PAPER, equations
from jaxgeo.studies.li2020.flight import overlap_of_azimuth_error
from jaxgeo.studies.li2020.strips import AS_IN_THE_PAPER, MOUNTAINS, PLAIN

if TYPE_CHECKING:
    from jaxgeo.studies.li2020.report import Report
    from jaxgeo.studies.li2020.strips import Strips

LAST_DIGIT = 1e-4  # of Tables 1 to 3
ERRORS = 2.0  # standard errors within which a random result counts as reproduced
HELD = 0.02  # deg within which a drive follows the attitude: the errors of control seen in Table 4
LEFT_OUT = "The flights were left out of this run."
SKETCHES = {
    1: "structure of the camera",
    2: "overlap of two strips",
    3: "flow of the computation",
    4: "heading and overlap; its geometry is Eqs 17 and 18",
    5: "pitch and overlap; its geometry is Eq 19",
    6: "roll and overlap; its geometry is Eqs 20 to 22",
    9: "height and length of a frame; its geometry is Eqs 27 and 28",
}


def claims_of(report: Report) -> list[Claim]:
    """Every numbered equation, table and figure, and the numbers and statements of the text and the abstract.

    What needs the flights stands as not reproducible, with that reason, where the report was made without them.
    """
    return [*_abstract(report), *equations(), *_tables(report), *_figures(report), *_text(report)]


def _claim(item: str, statement: str, wanted: object, obtained: object, function: str, **more: object) -> Claim:
    return Claim(PAPER, item, statement, wanted, obtained, function=f"jaxgeo.{function}", **more)  # type: ignore[arg-type]


def _in_flight(
    report: Report, item: str, statement: str, function: str, of: Callable[[], tuple[object, object, dict[str, object]]]
) -> Claim:
    """A claim that needs the flights: `of` gives printed, obtained and what else it has."""
    if not report.strips:
        return _claim(item, statement, None, None, function, reason=LEFT_OUT)
    wanted, obtained, more = of()
    return _claim(item, statement, wanted, obtained, function, **more)


def _abstract(report: Report) -> list[Claim]:
    return [
        _agreement(report, "Abstract", "geometry and transform of coordinates agree, all of Tables 1 to 3"),
        _in_flight(
            report,
            "Abstract",
            "gimbal angles and timing together suppress what the flight's parameters do",
            "coverage.fly",
            lambda: _suppressed(report),
        ),
        _in_flight(
            report,
            "Abstract",
            "mean overlap off the wish over flat ground, field of view 0.88°",
            "coverage.plan",
            lambda: (
                printed.FLOWN - printed.OVERLAP,
                float(_strips(report, PLAIN).near.mean()) - printed.OVERLAP,
                {"tolerance": 0.01, "reason": "In kind, see Fig. 11; the print has whole percents."},
            ),
        ),
    ]


def _agreement(report: Report, item: str, statement: str) -> Claim:
    """Formula against the step along the flight on the map: for roll the formula leaves the Earth's roundness out."""
    worst = {
        angle: max(abs(one.on_map - one.formula) for one in report.influences if one.angle == angle)
        for angle in printed.TABLES
    }
    return _claim(
        item,
        statement,
        True,
        max(worst.values()) < 1e-3,
        "coverage.transform.overlap_along",
        reason="Largest differences: " + ", ".join(f"{angle} {value:.5f}" for angle, value in worst.items()) + ".",
    )


def _suppressed(report: Report) -> tuple[object, object, dict[str, object]]:
    loose, held = (
        next(one for one in report.controls if one.is_compensated is which and one.control == 0.0)
        for which in (False, True)
    )
    fixed, timed = (_strips(report, PLAIN, name).rms for name in ("fixed period", AS_IN_THE_PAPER))
    reason = (
        f"Attitude errors of {loose.attitude:.1f}° scatter the overlap by {loose.spread:.1%}, compensated by "
        f"{held.spread:.2%}; speed and height that swing take it {fixed:.2%} off with a fixed period, and {timed:.2%} "
        "timed."
    )
    return True, held.spread < 0.1 * loose.spread and timed < 0.3 * fixed, {"reason": reason}


def _strips(report: Report, ground: str, timing: str = AS_IN_THE_PAPER) -> Strips:
    return next(one for one in report.strips if (one.ground, one.timing) == (ground, timing))


def _column(report: Report, angle: str, field: str) -> list[float]:
    return [getattr(one, field) for one in report.influences if one.angle == angle]


def _tables(report: Report) -> list[Claim]:
    heading, wanted = _column(report, "heading", "formula"), list(printed.TABLES["heading"])
    low, high = needed_factors()
    best = max(report.causes, key=lambda one: (one.entries, one.elsewhere or 0))
    tried = (
        f"The entries are Eq 19 times {low:.5f} to {high:.5f}, and the transform of coordinates says Eq 19. "
        f"{len(report.causes)} causes were put in, see the sheet of causes: none that the paper names gives it. "
        f"What gives all five entries, {best.tried}, stands nowhere in the paper."
    )
    return [
        _claim(
            "Table 1",
            "change of overlap by 0.2, 0.4, 0.6, 0.8° of heading",
            wanted[:4],
            heading[:4],
            "coverage.geometry.overlap_change_by_heading",
            tolerance=LAST_DIGIT,
            reason=f"To one unit of the last digit; the third would be rounded to {heading[2]:.4f}.",
        ),
        _claim(
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
        _claim(
            "Table 2",
            "change of overlap by 0.2 to 1.0° of pitch",
            list(printed.TABLES["pitch"]),
            _column(report, "pitch", "formula"),
            "coverage.geometry.overlap_change_by_pitch",
            tolerance=LAST_DIGIT,
            reason=tried,
        ),
        _claim(
            "Table 3",
            "change of overlap by 0.2 to 1.0° of roll",
            list(printed.TABLES["roll"]),
            _column(report, "roll", "formula"),
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
    of_mean = of_pair / len(pairs)  # what the strips between add to one pair they take from the next
    found = [claim for one in pairs for claim in [_pair(one.strips, one.printed, one.by_eq_16, of_pair, one.off_deg)]]
    held = np.array([one.held for one in pairs])
    return [
        _claim(
            "Table 4, azimuth",
            "azimuth drives of the five strips, if the line of sight is held on its mean",
            [one.azimuth_drive for one in seen],
            [one.predicted_azimuth_drive for one in seen],
            "coverage.compensation_formulas.angles_towards",
            tolerance=HELD,
            unit="°",
            digits=".6g",
        ),
        _claim(
            "Table 4, depression",
            "depression drives of the five strips, if the line of sight is held on its mean",
            [one.depression_drive for one in seen],
            [one.predicted_depression_drive for one in seen],
            "coverage.compensation_formulas.angles_towards",
            tolerance=HELD,
            unit="°",
            digits=".6g",
        ),
        _claim(
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
        _claim(
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
        _claim(
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
    return _claim(
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


def _figures(report: Report) -> list[Claim]:
    found = [
        _claim(f"Fig. {number}", what, None, None, "studies.li2020.run", reason="A sketch without numbers.")
        for number, what in SKETCHES.items()
    ]
    found += [
        _in_flight(
            report,
            "Fig. 7",
            "1° of heading, pitch and roll: the frame lies far from the expected one, the images gape",
            "coverage.overlap.overlap",
            lambda: _apart(report),
        ),
        _in_flight(
            report,
            "Fig. 8",
            "with the gimbal turned the frame almost agrees with the expected one",
            "coverage.compensate",
            lambda: _together(report),
        ),
        _claim(
            "Fig. 10",
            "changes of attitude from strip to strip",
            None,
            None,
            "studies.li2020.figures.draw_attitude",
            reason="A plot without numbers; those of Table 4 are drawn beside the line of sight that they leave.",
        ),
    ]
    flights: Sequence[tuple[str, str, str, float]] = (
        ("Fig. 11", "mean overlap over flat ground", PLAIN, printed.FLOWN),
        ("Fig. 12", "mean overlap over mountains, timed for the planned height", MOUNTAINS, printed.MOUNTAIN_FLOWN),
    )
    for item, statement, ground, wanted in flights:
        found.append(
            _in_flight(
                report,
                item,
                statement,
                "coverage.VelocityHeight",
                lambda ground=ground, wanted=wanted: (
                    wanted,
                    float(_strips(report, ground).near.mean()),
                    {
                        "tolerance": 0.01,
                        "reason": "In kind: the images were not published. The paper's timing in another flight over "
                        "other ground; the print has whole percents.",
                    },
                ),
            )
        )
    return sorted(found, key=lambda one: int(one.item.split()[1]))


def _middle_overlap(report: Report, name: str) -> float:
    assert report.outlines is not None
    along = np.asarray(report.outlines.overlaps[name].along)
    return float(along[len(along) // 2])


def _distance(report: Report, name: str) -> float:
    """From the middle of a footprint to that of the expected one, m."""
    assert report.outlines is not None
    middles = [np.asarray(report.outlines.footprints[one].fix.ecef).mean(axis=0) for one in (EXPECTED, name)]
    return float(np.linalg.norm(middles[1] - middles[0]))


def _apart(report: Report) -> tuple[object, object, dict[str, object]]:
    away, gap = _distance(report, ACTUAL), -_middle_overlap(report, ACTUAL)
    reason = f"It lies {away:.0f} m away and leaves a gap of {gap:.0%} of a frame."
    return True, away > 1000.0 and gap > 0.0, {"reason": reason}


def _together(report: Report) -> tuple[object, object, dict[str, object]]:
    away, share = _distance(report, COMPENSATED), _middle_overlap(report, COMPENSATED)
    reason = f"The middles lie {away:.0f} m apart, and the overlap is {share:.1%}."
    return True, away < 25.0 and abs(share - printed.OVERLAP) < 0.02, {"reason": reason}


def _text(report: Report) -> list[Claim]:
    example, ten = report.compensations[:2]
    look = {"field_of_view": math.radians(printed.FIELD_OF_VIEW)}
    one_degree = math.radians(1.0)
    at_nadir = geometry.overlap_change_by_heading(heading_change=one_degree, off_nadir=0.0, **look)
    flown = {"step": 385.0, "height_above_ground": 8143.0, **look}
    steeper, flatter = (float(geometry.overlap_at(off_nadir=math.radians(x), **flown)) for x in (60.0, 74.0))
    lower_ground, higher_ground = (
        math.copysign(1.0, geometry.overlap_change_by_height(height_change=-ground, height_above_ground=8143.0))
        for ground in (-100.0, 100.0)
    )
    steady = {"off_nadir": math.radians(74.0), "height_above_ground": 8143.0, **look}
    waits = [
        float(geometry.overlap_of_period(period=2.3 / more, speed=172.0 * more, **steady)) for more in (0.9, 1.0, 1.1)
    ]
    return [
        _in_flight(
            report,
            "Section 2.1",
            "the overlap is least at the near end",
            "coverage.overlap.overlap",
            lambda: _near_is_least(report),
        ),
        _agreement(report, "Section 3.1", "both methods agree for one angle"),
        *(
            _claim(
                "Section 3.1",
                f"change of overlap by {change:.1f}° of {angle}",
                shown,
                abs(_column(report, angle, "formula")[printed.CHANGES.index(change)]),
                f"coverage.geometry.overlap_change_by_{angle}",
                tolerance=tolerance,
                reason="As Table 2, unexplained." if angle == "pitch" else "",
            )
            for angle, change, shown, tolerance in (
                ("heading", 0.2, 0.2185, LAST_DIGIT),
                ("pitch", 0.6, 0.192, 1e-3),
                ("roll", 0.6, 0.0311, LAST_DIGIT),
            )
        ),
        _claim(
            "Section 3.1",
            "looking straight down a heading changes nothing",
            0.0,
            float(at_nadir),
            "coverage.geometry.overlap_change_by_heading",
            tolerance=1e-12,
        ),
        _claim(
            "Section 3.1",
            "with the same step and height the overlap rises with the angle off nadir",
            True,
            flatter > steeper,
            "coverage.geometry.overlap_at",
            reason=f"385 m from 8143 m: {steeper:.1%} at 60°, {flatter:.1%} at 74°.",
        ),
        _claim(
            "Section 3.1",
            "compensation of 1° of heading, pitch and roll: outer angle and azimuth drive",
            [printed.DEPRESSION_CHANGE, printed.AZIMUTH_DRIVE_CHANGE],
            [example.outer_change, example.drive_change],
            "coverage.compensation_formulas.exact_compensation",
            tolerance=5e-4,
            unit="°",
            reason="The drive turns half as far as the angle of Eq 25. The text has two azimuths; -1.016 is the outer.",
        ),
        _claim(
            "Section 3.1",
            "Eqs 25 and 26 bring the line of sight back: how far off at an inner angle of 10°",
            0.0,
            ten.left,
            "coverage.compensation_formulas.compensation_of_eqs_25_26",
            tolerance=1e-3,
            unit="°",
            explanation=Explanation(
                "they hold for an inner angle of 0, as in the example; there they leave", example.left, 0.0, 1e-3
            ),
        ),
        _claim(
            "Section 3.2",
            "the overlap falls where the ground of the next strip is lower: sign of its change",
            -1.0,
            lower_ground,
            "coverage.geometry.overlap_change_by_height",
            explanation=Explanation("Eq 28 says it of higher ground", higher_ground, -1.0, 0.0),
        ),
        _claim(
            "Section 3.3",
            "speed times period kept, the overlap is kept, 10 % slower and faster",
            [waits[1]] * 2,
            [waits[0], waits[2]],
            "coverage.geometry.overlap_of_period",
            tolerance=1e-12,
        ),
        _claim(
            "Section 4",
            "change of overlap over the mountain, and the overlap there",
            [printed.MOUNTAIN_OVERLAP_CHANGE, printed.MOUNTAIN_OVERLAP],
            [report.mountain.change, report.mountain.by_eq_28],
            "coverage.geometry.overlap_change_by_height",
            tolerance=5e-4,
            reason=f"The step over the nearer ground itself leaves {report.mountain.of_the_step:.1%}.",
        ),
        _in_flight(
            report,
            "Section 5",
            "mean overlap off the wish over mountains, the planned height not put right",
            "coverage.VelocityHeight",
            lambda: (
                printed.OVERLAP - printed.MOUNTAIN_FLOWN,
                printed.OVERLAP - float(_strips(report, MOUNTAINS).near.mean()),
                {"tolerance": 0.01, "reason": "In kind, see Fig. 12."},
            ),
        ),
        _in_flight(
            report,
            "Section 4",
            "timing by the height of the ground that is seen makes much less of relief",
            "coverage.VelocityHeight",
            lambda: _timed_by_the_ground(report),
        ),
        _in_flight(
            report,
            "Section 5",
            "errors of the gimbal's control change the overlap as well",
            "coverage.fly",
            lambda: _by_control(report),
        ),
        _in_flight(
            report,
            "Section 5",
            "relief of the ground changes the overlap as well",
            "coverage.plan",
            lambda: _by_relief(report),
        ),
    ]


def _near_is_least(report: Report) -> tuple[object, object, dict[str, object]]:
    plain = _strips(report, PLAIN)
    near, far = np.asarray(plain.overlaps.near), np.asarray(plain.overlaps.far)
    reason = f"Over the plain {near.mean():.1%} at the near end, {far.mean():.1%} at the far end."
    return True, bool(np.all(near < far)), {"reason": reason}


def _timed_by_the_ground(report: Report) -> tuple[object, object, dict[str, object]]:
    rows = {(one.ground, one.relief, one.timing): one for one in report.reliefs}
    ratios = [
        rows[ground, relief, "velocity-height"].off / one.off
        for (ground, relief, timing), one in rows.items()
        if timing == AS_IN_THE_PAPER
    ]
    reason = f"The rms off the wish falls to {min(ratios):.0%} to {max(ratios):.0%} over {len(ratios)} grounds."
    return True, max(ratios) < 0.5, {"reason": reason}


def _by_control(report: Report) -> tuple[object, object, dict[str, object]]:
    without = next(one for one in report.controls if one.is_compensated and one.control == 0.0)
    rows = [one for one in report.controls if one.control > 0.0]
    clear = all(one.spread - without.spread > 3.0 * one.spread_error for one in rows)
    reason = "; ".join(f"{one.control:.4g}° of each drive: {one.spread:.1%}" for one in rows) + " of overlap."
    return True, clear, {"reason": reason}


def _by_relief(report: Report) -> tuple[object, object, dict[str, object]]:
    rows = [one for one in report.reliefs if one.timing == AS_IN_THE_PAPER]
    clear = all(one.off - one.off_error > 0.0 for one in rows)
    reason = (
        "; ".join(f"{one.ground}, {one.relief:.0f} m: {one.off:.1%} ± {one.off_error:.1%} off" for one in rows)
        + f", by Eq 28 {rows[0].by_height / rows[0].relief * 100.0:.2%} for each 100 m."
    )
    return True, clear, {"reason": reason}
