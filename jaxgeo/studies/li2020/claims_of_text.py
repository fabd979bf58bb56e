"""Numbers and statements of the text and the abstract of Li et al. (2020)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from jaxgeo.coverage import geometry
from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.claim_parts import LAST_DIGIT, claim, column_of, in_flight, strips_of
from jaxgeo.studies.li2020.strips import AS_IN_THE_PAPER, MOUNTAINS, PLAIN

if TYPE_CHECKING:
    from jaxgeo.studies.li2020.report import Report


def claims_of_abstract(report: Report) -> list[Claim]:
    """The abstract."""
    return [
        _agreement(report, "Abstract", "geometry and transform of coordinates agree, all of Tables 1 to 3"),
        in_flight(
            report,
            "Abstract",
            "gimbal angles and timing together suppress what the flight's parameters do",
            "coverage.fly",
            lambda: _suppressed(report),
        ),
        in_flight(
            report,
            "Abstract",
            "mean overlap off the required one over flat ground, field of view 0.88°",
            "coverage.plan",
            lambda: (
                printed.FLOWN - printed.OVERLAP,
                float(strips_of(report, PLAIN).near.mean()) - printed.OVERLAP,
                {"tolerance": 0.01, "reason": "In kind, see Fig. 11; the print has whole percents."},
            ),
        ),
    ]


def claims_of_text(report: Report) -> list[Claim]:
    """Sections 2 to 5, in order."""
    example, ten = report.compensations[:2]
    view = {"field_of_view": math.radians(printed.FIELD_OF_VIEW)}
    one_degree = math.radians(1.0)
    at_nadir = geometry.overlap_change_by_heading(heading_change=one_degree, off_nadir=0.0, **view)
    flown = {"step": 385.0, "height_above_ground": 8143.0, **view}
    steeper, flatter = (float(geometry.overlap_at(off_nadir=math.radians(x), **flown)) for x in (60.0, 74.0))
    lower_ground, higher_ground = (
        math.copysign(1.0, geometry.overlap_change_by_height(height_change=-ground, height_above_ground=8143.0))
        for ground in (-100.0, 100.0)
    )
    steady = {"off_nadir": math.radians(74.0), "height_above_ground": 8143.0, **view}
    waits = [
        float(geometry.overlap_of_period(period=2.3 / more, speed=172.0 * more, **steady)) for more in (0.9, 1.0, 1.1)
    ]
    return [
        in_flight(
            report,
            "Section 2.1",
            "the overlap is least at the near end",
            "coverage.overlap",
            lambda: _near_is_least(report),
        ),
        _agreement(report, "Section 3.1", "both methods agree for one angle"),
        *(
            claim(
                "Section 3.1",
                f"change of overlap by {change:.1f}° of {angle}",
                shown,
                abs(column_of(report, angle, "formula")[printed.CHANGES.index(change)]),
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
        claim(
            "Section 3.1",
            "looking straight down a heading changes nothing",
            0.0,
            float(at_nadir),
            "coverage.geometry.overlap_change_by_heading",
            tolerance=1e-12,
        ),
        claim(
            "Section 3.1",
            "with the same step and height the overlap rises with the angle off nadir",
            True,
            flatter > steeper,
            "coverage.geometry.overlap_at",
            reason=f"385 m from 8143 m: {steeper:.1%} at 60°, {flatter:.1%} at 74°.",
        ),
        claim(
            "Section 3.1",
            "compensation of 1° of heading, pitch and roll: outer angle and azimuth drive",
            [printed.DEPRESSION_CHANGE, printed.AZIMUTH_DRIVE_CHANGE],
            [example.outer_change, example.drive_change],
            "coverage.compensation_formulas.exact_compensation",
            tolerance=5e-4,
            unit="°",
            reason="The drive turns half as far as the angle of Eq 25. The text has two azimuths; -1.016 is the outer.",
        ),
        claim(
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
        claim(
            "Section 3.2",
            "the overlap falls where the ground of the next strip is lower: sign of its change",
            -1.0,
            lower_ground,
            "coverage.geometry.overlap_change_by_height",
            explanation=Explanation("Eq 28 says it of higher ground", higher_ground, -1.0, 0.0),
        ),
        claim(
            "Section 3.3",
            "speed times period kept, the overlap is kept, 10 % slower and faster",
            [waits[1]] * 2,
            [waits[0], waits[2]],
            "coverage.geometry.overlap_of_period",
            tolerance=1e-12,
        ),
        claim(
            "Section 4",
            "change of overlap over the mountain, and the overlap there",
            [printed.MOUNTAIN_OVERLAP_CHANGE, printed.MOUNTAIN_OVERLAP],
            [report.mountain.change, report.mountain.by_eq_28],
            "coverage.geometry.overlap_change_by_height",
            tolerance=5e-4,
            reason=f"The step over the nearer ground itself leaves {report.mountain.of_the_step:.1%}.",
        ),
        in_flight(
            report,
            "Section 5",
            "mean overlap off the required one over mountains, the planned height not put right",
            "coverage.VelocityHeight",
            lambda: (
                printed.OVERLAP - printed.MOUNTAIN_FLOWN,
                printed.OVERLAP - float(strips_of(report, MOUNTAINS).near.mean()),
                {"tolerance": 0.01, "reason": "In kind, see Fig. 12."},
            ),
        ),
        in_flight(
            report,
            "Section 4",
            "timing by the height of the ground that is seen makes much less of relief",
            "coverage.VelocityHeight",
            lambda: _timed_by_the_ground(report),
        ),
        in_flight(
            report,
            "Section 5",
            "errors of the gimbal's control change the overlap as well",
            "coverage.fly",
            lambda: _by_control(report),
        ),
        in_flight(
            report,
            "Section 5",
            "relief of the ground changes the overlap as well",
            "coverage.plan",
            lambda: _by_relief(report),
        ),
    ]


def _agreement(report: Report, item: str, statement: str) -> Claim:
    """Formula against the step along the flight on the map; for roll the formula ignores the Earth's curvature."""
    worst = {
        angle: max(abs(one.on_map - one.formula) for one in report.influences if one.angle == angle)
        for angle in printed.TABLES
    }
    return claim(
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
    fixed, timed = (strips_of(report, PLAIN, name).rms for name in ("fixed period", AS_IN_THE_PAPER))
    reason = (
        f"Attitude errors of {loose.attitude:.1f}° scatter the overlap by {loose.spread:.1%}, compensated by "
        f"{held.spread:.2%}; speed and height that swing take it {fixed:.2%} off with a fixed period, and {timed:.2%} "
        "timed."
    )
    return True, held.spread < 0.1 * loose.spread and timed < 0.3 * fixed, {"reason": reason}


def _near_is_least(report: Report) -> tuple[object, object, dict[str, object]]:
    plain = strips_of(report, PLAIN)
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
    reason = (
        f"The rms off the required overlap falls to {min(ratios):.0%} to {max(ratios):.0%} over {len(ratios)} grounds."
    )
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
