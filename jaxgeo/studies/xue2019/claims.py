"""Claims of Xue et al. (2019) with the results obtained here: equations, tables, figures and statements.

The paper's field data are not published. The comparison uses a simulated block over similar ground, with the errors
that the paper found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.xue2019 import printed
from jaxgeo.studies.xue2019.cases import FIELD_GROUND, FIELD_IMAGE, MODELS, Case
from jaxgeo.studies.xue2019.equations import PAPER, equations
from jaxgeo.uncertainty import presets

if TYPE_CHECKING:
    from jaxgeo.studies.xue2019.report import Report

ERRORS = 2.0  # standard errors of the difference of two root mean squares, over the points of each
LAST_DIGIT = 5e-5  # m, half of the last printed digit of the residuals
AXES = "root mean square of the residuals in x, y, z"
CASES = "jaxgeo.studies.xue2019.cases.cases_of"
RECOVERED_WITHIN = 3.0  # sigmas
NOT_PUBLISHED = {
    "Fig. 1": "a photograph of the helicopter",
    "Fig. 2": "a map of the field; its coordinates are not published",
    "Fig. 3": "a map of the flight lines; their coordinates are not published",
    "Fig. 4": "a chart of the steps of the work",
    "Fig. 5": "a map of the check points; their coordinates are not published",
    "Fig. 8": "a map of control and check points; their coordinates are not published",
    "Fig. 9": "vectors of residuals without numbers; their root mean squares are in Table 3",
    "Fig. 10": "vectors of residuals without numbers; their root mean squares are in Table 3",
    "Fig. 11": "vectors of residuals without numbers; their root mean squares are in Table 3",
    "Fig. 12": "vectors of residuals without numbers; their root mean squares are in Table 3",
}


def claims_of(report: Report) -> list[Claim]:
    """Claims for every numbered equation, table and figure, and the numbers and statements of text and abstract."""
    return [
        *equations(report),
        *_tables_1_and_2(report),
        *_table_3(report),
        *_table_4(report),
        *_figures(report),
        *_direct(report),
        _free_net(report),
        *_boresight(report),
        *_improvements(report),
        *_statements(report),
    ]


def _tables_1_and_2(report: Report) -> Iterator[Claim]:
    sigmas = np.sqrt(np.diag(np.asarray(presets.pos_av_310("SmartBase post-processed").covariance())))
    yield Claim(
        PAPER,
        "Table 1",
        "post-processed with a base: position north, east, height in m; heading, pitch, roll in °",
        (*printed.SIGMA_POSITION, *printed.SIGMA_ATTITUDE),
        (*sigmas[:3].tolist(), *np.rad2deg(sigmas[6:9]).tolist()),
        1e-12,
        function="jaxgeo.uncertainty.presets.pos_av_310",
    )
    block = report.block
    sample = printed.HEIGHT * printed.PIXEL_PITCH / printed.CALIBRATED.f
    yield Claim(
        PAPER,
        "Table 2",
        "ground sample from 500 m with the calibrated camera",
        printed.GROUND_SAMPLE,
        sample,
        0.005,
        "m",
        "jaxgeo.studies.xue2019.simulation.simulated",
        reason=f"The block simulated is {block.size:.0f} m to a side, of {len(block.image)} images; the paper's "
        f"{printed.AREA:.0f} m.",
    )


def _table_3(report: Report) -> Iterator[Claim]:
    """Each row at 12 check points; the measurement noise in the field is tested as the cause."""
    field = {case.name: case for case in report.field}
    worse = "/".join(f"{sigma:.2f}" for sigma in FIELD_GROUND)
    for name in ("control", *(name for name in MODELS if name in field)):
        shown, tolerance = printed.RMS[name], _tolerance(printed.RMS[name], report.cases.of(name))
        title = "no additional parameters" if name == "control" else f"additional parameters of {name}"
        yield Claim(
            PAPER,
            f"Table 3, {name}",
            f"{AXES}, {title}",
            shown,
            _rms(report.cases.of(name)),
            tolerance,
            "m",
            "jaxgeo.adjust.adjust",
            Explanation(
                f"image points of {FIELD_IMAGE:g} px and targets of {worse} m", _rms(field[name]), shown, tolerance
            ),
            digits=".3f",
        )


def _table_4(report: Report) -> Iterator[Claim]:
    """The simulated truth is the paper's Brown calibration, so each model is compared with its own printed values."""
    values = np.array(list(printed.INTERIORS.values()))
    among = values.max(axis=0) - values.min(axis=0)
    for one in report.cases.recovered:
        if one.model in printed.INTERIORS:
            yield Claim(
                PAPER,
                f"Table 4, {one.model}",
                "f, xp, yp by self-calibration of a block whose truth is the print for Brown",
                tuple(printed.INTERIORS[one.model]),
                tuple(map(float, one.interior)),
                tuple((among + RECOVERED_WITHIN * np.array(one.sigma_interior)).tolist()),
                "mm",
                "jaxgeo.adjust.adjust",
                reason="Within what the three printed models differ by, and three sigmas.",
                digits=".4f",
            )


def _figures(report: Report) -> Iterator[Claim]:
    for item, reason in NOT_PUBLISHED.items():
        yield Claim(PAPER, item, "see the reason", None, None, reason=reason[0].upper() + reason[1:] + ".")
    for item, name, what in (
        ("Fig. 6", "direct pair", "residuals of direct georeferencing are systematic"),
        ("Fig. 7", "free net", "residuals of the free network are systematic"),
    ):
        case = report.cases.of(name)
        means = case.differences.mean(axis=0)
        errors = case.differences.std(axis=0, ddof=1) / math.sqrt(len(case.differences))
        off = np.abs(means) / errors
        yield Claim(
            PAPER,
            item,
            f"{what}: their mean is more than three standard errors off zero in some axis",
            True,
            bool(off.max() > 3.0),
            function=CASES,
            reason="In x, y, z: " + ", ".join(f"{mean:+.2f} m" for mean in means) + ".",
        )


def _direct(report: Report) -> Iterator[Claim]:
    """Direct georeferencing; the paper does not state which rays it uses."""
    for section, name in (("Section 2.2", "direct"), ("Section 2.5", "compensated")):
        shown, draws = printed.RMS[name], np.vstack([report.cases.of(f"{name} pair").rms, report.pairs[name]])
        spread = draws.std(axis=0, ddof=1)
        tolerance = _tolerance(shown, report.cases.of(name))
        yield Claim(
            PAPER,
            section,
            f"{AXES}, {'direct georeferencing' if name == 'direct' else 'the same after compensation'}, of all rays",
            shown,
            _rms(report.cases.of(name)),
            tolerance,
            "m",
            "jaxgeo.adjust.forward_intersection",
            Explanation(
                f"of adjacent pairs, mean of {len(draws)} draws",
                tuple(draws.mean(axis=0).tolist()),
                shown,
                tuple((np.array(tolerance) + ERRORS * spread).tolist()),
            ),
            digits=".3f",
        )


def _free_net(report: Report) -> Claim:
    shown = printed.RMS["free net"]
    tolerance = _tolerance(shown, report.cases.of("free net"))
    best = min(report.free_nets, key=lambda net: float(np.sum((net.rms / np.array(shown) - 1.0) ** 2)))
    tried = ", ".join(net.name for net in report.free_nets)
    return Claim(
        PAPER,
        "Section 2.3",
        f"{AXES}, free network",
        shown,
        _rms(report.cases.of("free net")),
        tolerance,
        "m",
        "jaxgeo.adjust.adjust",
        Explanation(best.assumption, tuple(best.rms.tolist()), shown, tolerance),
        reason=f"Tried: {tried}; the nearest, {best.name}, has "
        + " ".join(f"{value:.3f}" for value in best.rms)
        + " m.",
        digits=".3f",
    )


def _boresight(report: Report) -> Iterator[Claim]:
    one = next(one for one in reversed(report.cases.recovered) if one.model in MODELS)
    yield Claim(
        PAPER,
        "Section 2.5",
        f"boresight about x, y, z, by the adjustment with {one.model}; the simulated truth is the print",
        printed.BORESIGHT,
        tuple(map(float, one.boresight)),
        tuple((RECOVERED_WITHIN * one.sigma_boresight).tolist()),
        "'",
        "jaxgeo.adjust.adjust",
        digits=".3f",
    )


def _improvements(report: Report) -> Iterator[Claim]:
    """Improvement by compensation in plan and height: from the printed residuals, and from pairs in the simulation."""
    before, after = (np.array(printed.RMS[name]) for name in ("direct", "compensated"))
    rounded = np.zeros(2)
    for ends in itertools.product((-LAST_DIGIT, LAST_DIGIT), repeat=6):
        rounded = np.maximum(rounded, np.abs(_better(before + ends[:3], after + ends[3:]) - _better(before, after)))
    yield Claim(
        PAPER,
        "Abstract",
        "improvement in plan and in height, from the printed residuals",
        tuple(100.0 * value for value in printed.IMPROVEMENT),
        tuple((100.0 * _better(before, after)).tolist()),
        tuple((0.005 + 100.0 * rounded).tolist()),
        "%",
        CASES,
        digits=".2f",
        reason="Arithmetic alone, within the rounding of both.",
    )
    draws = np.array([_better(a, b) for a, b in zip(report.pairs["direct"], report.pairs["compensated"], strict=True)])
    yield Claim(
        PAPER,
        "Abstract",
        f"the same of ours, of adjacent pairs, mean of {len(draws)} draws",
        tuple(100.0 * value for value in printed.IMPROVEMENT),
        tuple((100.0 * draws.mean(axis=0)).tolist()),
        tuple((100.0 * ERRORS * draws.std(axis=0, ddof=1)).tolist()),
        "%",
        CASES,
        digits=".1f",
        reason=f"Within {ERRORS:g} standard deviations of the draws.",
    )


def _statements(report: Report) -> Iterator[Claim]:
    cases, limits = report.cases, report.limits
    models = [cases.of(name) for name in MODELS if name in {case.name for case in cases.cases}]

    def summary_of(case: Case) -> str:
        return f"{case.title}: {case.plane:.2f} m in plan, {case.rms[2]:.2f} m in height"

    def holds(case: Case) -> bool:
        return limits.hold(case.plane, float(case.rms[2]))

    limit = f"Limits {limits.plane:.2f} and {limits.height:.2f} m ({limits.source})"
    pair, control = cases.of("direct pair"), cases.of("control")
    yield _statement(
        "Section 2.2",
        "direct georeferencing does not do for maps at 1:500",
        not holds(pair),
        f"{summary_of(pair)}. {limit}.",
    )
    yield _statement(
        "Section 2.4",
        "with a few control points it does, by far: half the limits are kept",
        all(limits.hold(2.0 * case.plane, 2.0 * float(case.rms[2])) for case in models),
        "; ".join(summary_of(case) for case in models) + f". {limit}.",
    )
    plane, height = printed.WITH_CONTROL
    yield _statement(
        "Section 2.4",
        f"with control and parameters better than {plane} m in plan and {height} m in height",
        all(case.plane < plane and case.rms[2] < height for case in models),
        "; ".join(summary_of(case) for case in models) + ".",
    )
    yield _statement(
        "Section 2.4",
        "self-calibration gains most in height",
        all(case.rms[2] / control.rms[2] < case.plane / control.plane for case in models),
        f"{summary_of(control)}; " + "; ".join(summary_of(case) for case in models) + ".",
    )
    sizes = [float(np.linalg.norm(case.rms)) for case in models]
    yield _statement(
        "Section 2.4",
        "the models of additional parameters are about equally good: within a half of each other",
        max(sizes) < 1.5 * min(sizes),
        "In space " + ", ".join(f"{case.name} {size:.3f} m" for case, size in zip(models, sizes, strict=True)) + ".",
    )
    net, after = cases.of("free net"), cases.of("compensated pair")
    yield _statement(
        "Section 2.5",
        "after compensation direct georeferencing is better than the free network before it, in space",
        bool(np.linalg.norm(after.rms) < np.linalg.norm(net.rms)),
        f"{np.linalg.norm(after.rms):.2f} m of pairs, {np.linalg.norm(net.rms):.2f} m of the free network.",
    )


def _statement(item: str, statement: str, holds: bool, reason: str) -> Claim:
    return Claim(PAPER, item, statement, True, bool(holds), function=CASES, reason=reason)


def _tolerance(shown: tuple[float, float, float], case: Case) -> tuple[float, ...]:
    """Largest expected difference of two root mean squares of equal normal errors over the given numbers of points."""
    error = ERRORS * math.sqrt(2.0 / (2.0 * len(case.differences)))
    return tuple(error * value for value in shown)


def _better(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Improvement in plan and in height."""
    planes = np.hypot(*before[:2]), np.hypot(*after[:2])
    return np.array([1.0 - planes[1] / planes[0], 1.0 - after[2] / before[2]])


def _rms(case: Case) -> tuple[float, ...]:
    return tuple(map(float, case.rms))
