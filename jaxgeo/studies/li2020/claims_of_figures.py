"""Figs. 1 to 12 of Li et al. (2020): statements of the text and the results obtained here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxgeo.studies.claims import Claim
from jaxgeo.studies.li2020 import printed
from jaxgeo.studies.li2020.attitude import ACTUAL, COMPENSATED, EXPECTED
from jaxgeo.studies.li2020.claim_parts import claim, in_flight, strips_of
from jaxgeo.studies.li2020.strips import MOUNTAINS, PLAIN

if TYPE_CHECKING:
    from jaxgeo.studies.li2020.report import Report

SKETCHES = {
    1: "structure of the camera",
    2: "overlap of two strips",
    3: "flow of the computation",
    4: "heading and overlap; its geometry is Eqs 17 and 18",
    5: "pitch and overlap; its geometry is Eq 19",
    6: "roll and overlap; its geometry is Eqs 20 to 22",
    9: "height and length of a frame; its geometry is Eqs 27 and 28",
}


def claims_of_figures(report: Report) -> list[Claim]:
    """Claims of all twelve figures, in order."""
    found = [
        claim(f"Fig. {number}", what, None, None, "studies.li2020.run", reason="A sketch without numbers.")
        for number, what in SKETCHES.items()
    ]
    found += [
        in_flight(
            report,
            "Fig. 7",
            "1° of heading, pitch and roll: the frame lies far from the expected one, the images gape",
            "coverage.overlap",
            lambda: _apart(report),
        ),
        in_flight(
            report,
            "Fig. 8",
            "with the gimbal turned the frame almost agrees with the expected one",
            "coverage.compensate",
            lambda: _together(report),
        ),
        claim(
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
            in_flight(
                report,
                item,
                statement,
                "coverage.VelocityHeight",
                lambda ground=ground, wanted=wanted: (
                    wanted,
                    float(strips_of(report, ground).near.mean()),
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
    """Distance in m from the centre of a footprint to that of the expected one."""
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
