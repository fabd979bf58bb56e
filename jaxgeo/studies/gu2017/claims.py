"""Claims of Gu and Qiao (2017) with the results of the study."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jaxgeo.ortho import Orthoimage
from jaxgeo.register.gu2017 import Case, Row, error_table
from jaxgeo.studies.claims import Claim, Explanation
from jaxgeo.studies.gu2017 import intervals, printed
from jaxgeo.studies.gu2017.accuracy import Accuracy, radii, within
from jaxgeo.studies.gu2017.density import Dense
from jaxgeo.studies.gu2017.equations import PAPER, equations_of
from jaxgeo.studies.gu2017.flow import Flow
from jaxgeo.studies.gu2017.frames import ALONE, CARRIED, SELDOM, Frame
from jaxgeo.studies.gu2017.mutual import Mutual
from jaxgeo.studies.gu2017.report import Report
from jaxgeo.studies.gu2017.searching import CONSTRAINED, WHOLE, Searched

REGISTER, MATCH, CLUSTERS = "jaxgeo.register.register_image", "jaxgeo.register.match_blocks", "jaxgeo.register.Clusters"
MUTUAL = "jaxgeo.ties.correct"
TABLE, UPDATE = "jaxgeo.register.gu2017.error_table", "jaxgeo.register.update_orientation"
ABOUT = 25.0  # m, tolerance of "about 100 m"
ALIKE = 3.0  # cells, shifts closer than this are equal
STEADY = 0.02  # relative, for an error that stays constant
MOSTLY = 0.9  # of a squared error: what is common to all images, if tie points determine the rest
MUCH = 10.0  # times fewer comparisons: "greatly reduced"


def claims_of(report: Report) -> list[Claim]:
    """Claims of every numbered equation, the table, all figures, and the text."""
    found = [*equations_of(), *_table(report.accuracy), *_circles(report), *_end_to_end(report.flow)]
    if report.searches:
        found += [*_searches(report.searches), *_translation(report.searches)]
    if report.by_size:
        found += _blocks(report.by_size, report.by_ties)
    if report.frames:
        found += _frames(report.frames)
    return [*found, *_mutual(report.mutual)] if report.mutual else found


def _holds(item: str, statement: str, holds: bool, function: str, reason: str, why: Explanation | None = None) -> Claim:
    """A claim stated in words."""
    return Claim(PAPER, item, statement, True, bool(holds), 0.0, "", function, why, reason)


# ------------------------------------------------------------------------------- table 1


def _table(found: Accuracy) -> list[Claim]:
    picture = "The table is a picture in the copy at hand; the inputs taken here are those of `error_table`."
    claims = [
        Claim(PAPER, "Table 1", "errors of all rows", None, None, function=TABLE, reason=picture),
    ]
    claims += [_orders(number, row) for number, row in enumerate(found.table, 1)]
    same = [float(row.rms[1]) for row in found.table[:3]]
    claims.append(
        Claim(
            PAPER,
            "Table 1, steady",
            "updated errors under one error of terrain and registration, by the first's",
            [1.0] * 3,
            [x / same[0] for x in same],
            STEADY,
            "",
            TABLE,
            reason=f"{', '.join(f'{x:.2f}' for x in same)} m, while the navigation becomes ten times worse and more.",
        )
    )
    worst = float(found.table[-1].rms[1])
    claims.append(
        Claim(
            PAPER,
            "Table 1, bad terrain and registration",
            "error with very bad terrain and registration, about",
            printed.BETTER_THAN,
            worst,
            ABOUT,
            "m",
            TABLE,
            reason="30 m of terrain and 30 m of registration; the print gives no inputs.",
            digits=".1f",
        )
    )
    usual = [float(row.rms[1]) for row in found.table[:-1]]
    claims.append(
        _holds(
            "Abstract",
            "better than 100 m at large angles off nadir, but with bad terrain and registration",
            max(usual) < printed.BETTER_THAN,
            TABLE,
            f"75 deg off nadir: {', '.join(f'{x:.1f}' for x in usual)} m; with bad ones {worst:.1f} m.",
        )
    )
    slopes = ", ".join(f"{slope:g} deg {one[1] / one[0] - 1.0:+.1%}" for slope, one in found.on_slopes.items())
    off = [abs(one[1] / one[0] - 1.0) for one in found.on_slopes.values()]
    claims.append(
        _holds(
            "Section 2.4",
            "Eq 6 as it stands and the chain of derivatives give errors that differ little (10 %)",
            max(off) < 0.1,
            "jaxgeo.register.LevelGround",
            f"What the pose adds to a fix, on ground that rises away from the camera: {slopes}.",
        )
    )
    return claims


def _orders(number: int, row: Row) -> Claim:
    """Two orders of magnitude."""
    direct, updated = (float(x) for x in row.rms)
    gain, case = math.log10(direct / updated), row.case
    item, statement = f"Table 1, case {number}", "updated errors two orders of magnitude below direct ones"
    figures = f"{direct:.1f} and {updated:.1f} m: {gain:.2f} orders ({case.position:g} m, {case.attitude_deg:g} deg)."
    if gain >= printed.ORDERS:
        return _holds(item, statement, True, TABLE, figures)
    times = 10.0 ** (printed.ORDERS - gain)
    worse = Case(times * case.position, times * case.attitude_deg, case.terrain, case.registration)
    again = error_table((worse,))[0]
    reached = math.log10(float(again.rms[0]) / float(again.rms[1]))
    cause = (
        f"what the update leaves is of terrain and registration alone: two orders need a navigation {times:.2g} times "
        f"worse, {worse.position:.0f} m and {worse.attitude_deg:.2f} deg"
    )
    return _holds(item, statement, False, TABLE, figures, Explanation(cause, reached, printed.ORDERS, 0.05))


# ------------------------------------------------------------------------------- circles, searches of 3 sigma


def _circles(report: Report) -> list[Claim]:
    ellipse = radii()
    found = report.flow
    claims = [
        Claim(
            PAPER,
            "Fig. 5, factor",
            "standard deviations within which 90 % lie, of round errors",
            printed.CIRCLE_90,
            ellipse.round_factor,
            5e-4,
            "",
            "jaxgeo.uncertainty.metrics.circular_error",
            Explanation(
                "two digits have changed places",
                min(_exchanged(printed.CIRCLE_90), key=lambda value: abs(value - ellipse.round_factor)),
                ellipse.round_factor,
                5e-4,
            ),
            digits=".4f",
        ),
        Claim(
            PAPER,
            "Fig. 5, probability",
            "share within the printed factor, of an ellipse of 278 by 68 m",
            0.9,
            ellipse.printed_holds,
            0.005,
            "",
            "jaxgeo.uncertainty.metrics.circular_probability",
            Explanation(
                "the factor holds of round errors only",
                within(printed.CIRCLE_90),
                0.9,
                0.005,
            ),
            reason=f"The circle that holds 90 % has {ellipse.exact:.1f} m, that of the factor {ellipse.printed:.1f} m.",
            digits=".4f",
        ),
    ]
    if found.updated is not None:
        outer, inner = (float(one.circular_error(0.9)) for one in (found.direct, found.updated))
        claims.append(
            _holds(
                "Fig. 5",
                "the circle of 90 % of the method lies inside that of direct georeferencing",
                inner < outer,
                "jaxgeo.uncertainty.Propagation.circular_error",
                f"{inner:.1f} and {outer:.1f} m on the made scene; the picture's own numbers are not legible.",
            )
        )
    return claims


# ------------------------------------------------------------------------------- end to end


def _end_to_end(found: Flow) -> list[Claim]:
    accepted = [run for run in found.runs if run.after is not None]
    known = [run for run in accepted if run.after is not None and run.after.ce90 is not None]
    pairs = [(run.before.ce90, run.after.ce90) for run in known if run.after is not None]
    figures = "; ".join(f"{before:.0f} to {after:.1f} m" for before, after in pairs if before and after)
    improved = [before is not None and after is not None and after < before for before, after in pairs]
    claims = [
        _holds(
            "Fig. 1",
            "rectified, matched, updated and fixed again, each image ends nearer to the truth",
            len(accepted) == len(found.runs) and all(improved),
            REGISTER,
            f"{len(accepted)} of {len(found.runs)} registered; 90 % of fixes within, before and after: {figures}.",
        ),
        Claim(
            PAPER,
            "Section 2.1",
            "a camera model without distortion gives high accuracy",
            None,
            None,
            function=REGISTER,
            reason="The images were freed of distortion before, by a model that is not printed.",
        ),
    ]
    if known:
        claims.append(
            _holds(
                "Abstract, end to end",
                "fixes better than 100 m at a large angle off nadir",
                all(after is not None and after < printed.BETTER_THAN for _, after in pairs),
                REGISTER,
                f"65 deg off nadir, 90 % of fixes: {figures}.",
            )
        )
    if found.registered is not None:
        before, after = (likeness(found.reference, one) for one in (found.by_navigation, found.registered))
        claims.append(
            _holds(
                "Fig. 4",
                "rectified after the update, every detail lies nearer to the map (c) than before (b)",
                after > before,
                "jaxgeo.ortho.rectify",
                f"Correlation with the map cell by cell: {before:.3f} before, {after:.3f} after; the photographs "
                "themselves were not published.",
            )
        )
    return claims


def likeness(reference: Orthoimage, ortho: Orthoimage) -> float:
    """Correlation of two orthoimages on one grid, where both are valid."""
    both = np.asarray(reference.known) & np.asarray(ortho.known)
    pair = [np.asarray(one.values, float).mean(axis=0)[both] for one in (reference, ortho)]
    return float(np.corrcoef(*pair)[0, 1])


# ------------------------------------------------------------------------------- the search


def _pairs(found: Sequence[Searched]) -> list[tuple[Searched, Searched]]:
    near = [one for one in found if one.search == CONSTRAINED]
    return [(one, next(x for x in found if x.sought == one.sought and x.search == WHOLE)) for one in near]


def _searches(found: Sequence[Searched]) -> list[Claim]:
    pairs = _pairs(found)
    claims = [_share_within(found)]
    ratios = {near.sought.name: whole.cells / near.cells for near, whole in pairs}
    figures = ", ".join(f"{name} {ratio:.1f}" for name, ratio in ratios.items())
    far = [ratio for name, ratio in ratios.items() if "far off" not in name]
    claims.append(
        _holds(
            "Section 4, computation",
            f"the constraint saves much of the search: {MUCH:g} times fewer comparisons, in all scenes",
            min(ratios.values()) >= MUCH,
            MATCH,
            f"Shifts compared without over with it: {figures}; this depends on how far one would search without.",
            Explanation("with the smaller navigation errors it does", bool(min(far) >= MUCH), True, 0.0),
        )
    )
    claims += [_stable(near, whole, pairs) for near, whole in pairs]
    plain = pairs[0][0]
    number, wrong = plain.chosen["K-means"]
    claims.append(
        _holds(
            "Fig. 2",
            f"right shifts of {printed.BLOCKS} blocks form a cluster, which K-means finds",
            number >= 0.5 * plain.candidates and wrong == 0,
            CLUSTERS,
            f"{plain.sought.name}: {plain.draws} draws, {plain.blocks / plain.draws:.0f} blocks each, {number} chosen "
            f"of {plain.candidates}, {wrong} wrong.",
        )
    )
    return claims


def _stable(near: Searched, whole: Searched, pairs: Sequence[tuple[Searched, Searched]]) -> Claim:
    """Effect of the constraint on the choice; a failure is attributed to the choice and the block size if smaller
    blocks chosen by the pose succeed with the same navigation and texture."""
    sought, draws = near.sought, near.draws
    parts = []
    for one in (near, whole):
        low, high = intervals.share(one.best_wrong, one.candidates)
        parts.append(
            f"{one.search}: best candidates wrong {one.best_wrong} of {one.candidates} ({low:.0%} to {high:.0%}), "
            + ", ".join(f"{way} {n[1]} of {n[0]}, of no use in {one.useless[way]}" for way, n in one.chosen.items())
        )
    alike = [
        one
        for one, _ in pairs
        if (one.sought.position, one.sought.period) == (sought.position, sought.period)
        and one.sought.block <= sought.block
    ]
    best = min(alike, key=lambda one: one.useless["pose"])
    cause = (
        "the navigation's errors turn and stretch the image, so that its blocks have no shift in common: chosen by the "
        f"pose, blocks of {best.sought.block} are right; draws in which they are not"
    )
    return _holds(
        f"Section 2.2, {sought.name}",
        "the constrained search is stable: K-means takes right matches in every draw",
        near.useless["K-means"] == 0,
        MATCH,
        f"{sought.position:g} m, {sought.attitude_deg:g} deg, blocks of {sought.block}, {draws} draws. "
        + f"{'; '.join(parts)}.",
        Explanation(cause, float(best.useless["pose"]), 0.0, 0.0),
    )


def _share_within(found: Sequence[Searched]) -> Claim:
    near = [one for one in found if one.search == CONSTRAINED]
    inside, of = sum(one.inside for one in near), sum(one.blocks for one in near)
    return _holds(
        "Section 2.2, 3 sigma",
        "above 99 % of the shifts lie within 3 sigma",
        within(printed.SEARCHED) > printed.SEARCHED_HOLDS,
        MATCH,
        f"Of round errors {within(printed.SEARCHED):.2%}; of the blocks of the scenes {inside / of:.1%} of {of}, "
        "within a search as wide as the most uncertain block's.",
        Explanation(
            "99 % is of 3 sigma along one axis (99.73 %), a search has two",
            math.erf(printed.SEARCHED / math.sqrt(2.0)) > printed.SEARCHED_HOLDS,
            True,
            0.0,
        ),
    )


def _translation(found: Sequence[Searched]) -> list[Claim]:
    """Eq 4: x1 = x0 + a, y1 = y0 + b with one a, b for all blocks."""
    claims = []
    for near, _ in _pairs(found)[:2]:
        known = np.isfinite(near.found.true).all(axis=1)
        true, centre = near.found.true[known], np.asarray(near.found.matches.centre)[known]
        off = np.linalg.norm(true - np.median(true, axis=0), axis=1)
        rows = np.column_stack([np.ones(len(true)), centre])
        left = np.linalg.norm(true - rows @ np.linalg.lstsq(rows, true, rcond=None)[0], axis=1)
        sought = near.sought
        claims.append(
            _holds(
                "Eq. 4" if not claims else f"Eq. 4, {sought.name}",
                f"one translation relates image and map: shifts of all blocks within {ALIKE:g} cells of their median",
                float(np.max(off)) <= ALIKE,
                MATCH,
                f"{sought.position:g} m and {sought.attitude_deg:g} deg, {len(off)} blocks: up to {np.max(off):.1f} "
                "cells.",
                Explanation(
                    "the navigation's errors turn and stretch the rectified image as well: one affine map fits twice "
                    "as well and better; root mean squares, cells",
                    bool(np.sqrt(np.mean(left**2)) < 0.5 * np.sqrt(np.mean(off**2))),
                    True,
                    0.0,
                ),
            )
        )
    return claims


# ------------------------------------------------------------------------------- blocks and ties


def _blocks(by_size: Sequence[Dense], by_ties: Sequence[Dense]) -> list[Claim]:
    claims = []
    most = max(one.noise for one in by_size)
    noisy = [one for one in by_size if one.noise == most]
    for number, noise in enumerate(dict.fromkeys(one.noise for one in by_size)):
        rows = [one for one in by_size if one.noise == noise]
        best = min(rows, key=lambda one: one.pose)
        figures = "; ".join(
            f"{one.size}: {one.pose:.2f} ± {one.half:.2f} px, {one.ties:.0f} ties, {one.failed:.0%} failed"
            for one in rows
        )
        near = min(rows, key=lambda one: abs(one.size - printed.BLOCK))
        pairs = [a - b for a, b in zip(near.each, best.each, strict=False)]
        gap, half = intervals.mean(pairs)
        claims.append(
            Claim(
                PAPER,
                "Section 2.3, size" if number == 0 else f"Section 2.3, size, noise {noise:g}",
                "side of the blocks with the least error of the pose",
                float(printed.BLOCK),
                float(best.size),
                60.0,
                "cells",
                MATCH,
                reason=f"Noise {noise:g}: {figures}. {near.size} less {best.size} in the same trials: {gap:+.2f} ± "
                f"{half:.2f} px.",
                digits=".0f",
            )
        )
        smallest, middle = rows[0], near
        claims.append(
            _holds(
                "Section 2.3, small blocks" if number == 0 else f"Section 2.3, small blocks, noise {noise:g}",
                f"blocks of {smallest.size} fail more often than those of {middle.size}",
                smallest.failed > middle.failed,
                MATCH,
                f"Noise {noise:g}: {smallest.failed:.1%} of {smallest.blocks:.0f} blocks against {middle.failed:.1%} "
                f"of {middle.blocks:.0f}.",
                Explanation(
                    "in so little noise small blocks still have texture enough; in the most noise they fail more often",
                    noisy[0].failed > min(noisy, key=lambda one: abs(one.size - printed.BLOCK)).failed,
                    True,
                    0.0,
                ),
            )
        )
    rms = [one.pose for one in by_ties]
    figures = "; ".join(f"{one.ties:.0f}: {one.pose:.2f} ± {one.half:.2f} px" for one in by_ties)
    claims.append(
        _holds(
            "Section 2.3, ties",
            "the more ties, the smaller the error of the pose, from the fewest to the most",
            bool(np.all(np.diff(rms) < 0.0)),
            UPDATE,
            figures + ".",
        )
    )
    return claims


def _exchanged(value: float) -> list[float]:
    """The values of a three-decimal number with two neighbouring digits exchanged, for every position."""
    whole, digits = f"{value:.3f}".split(".")
    return [float(f"{whole}.{digits[:k]}{digits[k + 1]}{digits[k]}{digits[k + 2 :]}") for k in range(len(digits) - 1)]


# ------------------------------------------------------------------------------- sequences


def _frames(found: Sequence[Frame]) -> list[Claim]:
    by_way = {way: [one for one in found if one.way == way] for way in (ALONE, CARRIED, SELDOM)}
    last = {way: intervals.rms(rows[-1].position) for way, rows in by_way.items()}
    pairs = by_way[ALONE][-1].position ** 2 - by_way[CARRIED][-1].position ** 2
    gap, half = intervals.mean(list(pairs))
    figures = "; ".join(f"{way}: {one[0]:.1f} ± {one[1]:.1f} m" for way, one in last.items())
    fixes = "; ".join(f"{way}: {intervals.rms(rows[-1].fix)[0]:.1f} m" for way, rows in by_way.items())
    flights = len(by_way[ALONE][-1].position)
    return [
        _holds(
            "Section 4, sequences",
            "the method extends to sequences of images: carried over, the last position is surer than by itself",
            gap - half > 0.0,
            "jaxgeo.register.propagate_prior",
            f"{flights} flights over {len(set(found[0].relief))} grounds. Position in the last frame {figures}; mean "
            f"difference of squares {gap:.0f} ± {half:.0f} m2. Fix in the middle {fixes}.",
        )
    ]


# ------------------------------------------------------------------------------- several images without a map


def _mutual(found: Sequence[Mutual]) -> list[Claim]:
    """The paper says only that images may correct each other; the bounds are ours."""
    item = "Section 4, without a reference"
    named = [f"{one.images} images, {one.position:g} m, {one.attitude_deg:g} deg" for one in found]
    figures, squares, left = [], [], []
    for name, one in zip(named, found, strict=True):
        within_bounds = [
            f"{x:.2f} ({low:.2f} to {high:.2f})" for x, (low, high) in zip(one.squares, one.bounds, strict=True)
        ]
        figures.append(f"{name}: {one.relative[0]:.1f} to {one.relative[1]:.2f} m")
        squares.append(f"{name}: {' and '.join(within_bounds)}")
        left.append(f"{name}: {one.absolute[0]:.0f} to {one.absolute[1]:.0f} m, {one.share:.1%} of its square common")
    return [
        _holds(
            item,
            "several images of one scene correct each other: neighbours agree better than before, in every draw",
            all(one.better == one.draws for one in found),
            MUTUAL,
            f"{found[0].draws} draws each, {sum(one.refused for one in found)} of all refused, as too many ties did "
            f"not fit; distance between the places of one point: {'; '.join(figures)}.",
        ),
        _holds(
            f"{item}, prediction",
            "the propagated errors are right: squares of errors over predicted within 99.9 % of chance, in all cases",
            all(one.predicted_right for one in found),
            MUTUAL,
            f"Of neighbours and of absolute places, with their bounds: {'; '.join(squares)}.",
        ),
        _holds(
            f"{item}, accuracy",
            f"fixes better than {printed.BETTER_THAN:g} m without a reference, too",
            all(one.absolute[1] < printed.BETTER_THAN for one in found),
            MUTUAL,
            f"Errors of places, their heights exact: {'; '.join(left)}.",
            Explanation(
                f"a common shift is left, which images alone do not show: above {MOSTLY:.0%} of the squared error",
                min(one.share for one in found) > MOSTLY,
                True,
                0.0,
            ),
        ),
    ]
