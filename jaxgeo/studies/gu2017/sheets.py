"""Comparison tables of Gu and Qiao (2017): claims and results obtained here."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jaxgeo.register.gu2017 import Row
from jaxgeo.studies.gu2017 import printed
from jaxgeo.studies.gu2017.accuracy import Accuracy, pose_rms, radii, within
from jaxgeo.studies.gu2017.density import LEFT, SUBSETS, Dense
from jaxgeo.studies.gu2017.fixes import Spread
from jaxgeo.studies.gu2017.flow import Flow
from jaxgeo.studies.gu2017.frames import DURATION, MATCHED, SLOPES, STEP, TIES, Frame
from jaxgeo.studies.gu2017.intervals import rms, share
from jaxgeo.studies.gu2017.mutual import BASE, NOISE, SHARED, Mutual
from jaxgeo.studies.gu2017.scene import ABOVE, CELL, FINE_CELL, HEIGHT, OFF_NADIR, SIGMA_TERRAIN, WIDTH
from jaxgeo.studies.gu2017.searching import CHOICES, FAR, SPOILT, Searched
from jaxgeo.studies.sheet import Cell, Sheet


def errors_sheet(found: Accuracy) -> Sheet:
    """Table 1."""
    rows: list[list[Cell]] = []
    for row in found.table:
        direct, updated = (float(x) for x in row.rms)
        gain = math.log10(direct / updated)
        circles = [float(one.circular_error(0.9)) for one in (row.direct, row.updated)]
        answers = f"{'yes' if updated < printed.BETTER_THAN else 'no'}, {'yes' if gain >= printed.ORDERS else 'no'}"
        rows.append([*row.case, direct, updated, gain, *circles, answers])
    columns = {"position": "g", "attitude": "g", "terrain": "g", "registration": "g", "direct": ".1f", "updated": ".1f"}
    columns |= {"orders": ".2f", "direct CE90": ".1f", "updated CE90": ".1f", "as claimed": ""}
    note = (
        f"Root mean square errors in plan of the middle pixel, 10 km up, 75 deg off nadir, {printed.TIES} ties; m, "
        f"deg. The paper: usually better than {printed.BETTER_THAN:.0f} m, about that with bad terrain and "
        "registration, and two orders of magnitude better than direct georeferencing. The last column says whether "
        "each holds. What is left comes from terrain and registration alone, so that the gain is the larger the worse "
        "the navigation."
    )
    return Sheet("errors", "Simulated errors (Table 1)", columns, rows, note)


def sensitivity_sheet(found: Accuracy) -> Sheet:
    """Dependencies of the updated error."""
    rows: list[list[Cell]] = []
    named: list[tuple[str, Row]] = [(f"{count} ties", row) for count, row in found.by_ties.items()]
    named += [(f"field of view {field:g} deg", row) for field, row in found.by_field.items()]
    for name, row in named:
        rows.append([name, float(row.rms[1]), pose_rms(row.updated)])
    note = (
        "The fourth case, m. Most of the error is that of the height of the pixel's own ground, 20 m times tan 75 deg: "
        "no tie takes that away. The part of the pose falls as ties become more."
    )
    return Sheet("sensitivity", "Ties and field of view", {"": "", "updated": ".2f", "by the pose": ".2f"}, rows, note)


def slopes_sheet(found: Accuracy) -> Sheet:
    """Eq 6 against the full derivatives."""
    rows: list[list[Cell]] = [[slope, *one, one[1] / one[0] - 1.0] for slope, one in found.on_slopes.items()]
    columns = {"slope, deg": "g", "full": ".2f", "as level (Eq 6)": ".2f", "off by": ".1%"}
    note = (
        "The fourth case on ground that rises away from the camera: only what the pose adds to a fix, root mean "
        "square, m. Eq 6 moves a tie on the map without moving it up the slope. The paper found no great difference."
    )
    return Sheet("slopes", "Errors of registration on a slope (Eq 6)", columns, rows, note)


def circles_sheet(found: Accuracy) -> Sheet:
    """Values of the circles."""
    ellipse = radii()
    rows: list[list[Cell]] = [
        ["factor of 90 %, round errors", printed.CIRCLE_90, ellipse.round_factor, None],
        ["radius about 278 x 68 m by the printed factor", ellipse.printed, ellipse.exact, ellipse.printed_holds],
        ["radius about 278 x 68 m by sqrt(-2 ln 0.1)", ellipse.rounded, ellipse.exact, ellipse.rounded_holds],
    ]
    for row in found.table:
        cov = np.asarray(row.updated.cov_enu)[:2, :2]
        usual = printed.CIRCLE_90 * math.sqrt(0.5 * float(np.trace(cov)))
        name = f"updated, terrain {row.case.terrain:g} m, registration {row.case.registration:g} m"
        if rows[-1][0] != name:
            rows.append([name, usual, float(row.updated.circular_error(0.9)), None])
    rows.append(["share within 3 sigma, round errors", printed.SEARCHED_HOLDS, within(printed.SEARCHED), None])
    columns = {"": "", "printed": ".4g", "exact": ".5g", "holds": ".1%"}
    note = (
        "Radii in m by root mean square axes. 2.164 is 2.146, and that only of round errors; oblique ones are long. "
        f"Above 99 % within 3 sigma is {within(printed.SEARCHED):.2%}."
    )
    return Sheet("circles", "Circles of 90 % and searches of 3 sigma", columns, rows, note)


def flow_sheet(found: Flow) -> Sheet:
    """End-to-end runs."""
    rows: list[list[Cell]] = []
    for run in found.runs:
        done = run.registration
        rows.append([run.seed, "direct", None, None, None, *_spread(run.before)])
        if run.after is not None and done.ties is not None:
            registration = float(done.tie_errors.registration)
            rows.append([run.seed, "updated", len(done.passes), done.ties.count, registration, *_spread(run.after)])
            continue
        rows.append([run.seed, done.outcome.name, len(done.passes), *(None,) * 8])
    columns = {"draw": "d", "": "", "passes": "d", "ties": "d", "registration": ".2f"} | SPREAD
    note = (
        f"Over a lattice of pixels, m in plan. An image that is made is {OFF_NADIR:g} deg off nadir, {ABOVE:g} m over "
        f"hills, with a DEM height sigma of {SIGMA_TERRAIN:g} m, which is twice as much and more along the "
        "line of sight, and a navigation sigma of 50 m and 0.5 deg. sigma is the root mean square of the "
        "predicted errors, CE90 the median of the radii. squares are those of the errors in standard deviations, 1 on "
        "average for each axis if these are right, and less here, since errors of heights even out over a block. "
        "Pixels that graze a ridge, as predicted, are left out. The first registration took "
        f"{found.runs[0].seconds:.1f} s, with compilation, the last {found.runs[-1].seconds:.1f} s."
    )
    return Sheet("flow", "An image from end to end (Figs. 1 and 4)", columns, rows, note)


POSE = {"pose, px": ".2f", "±": ".2f", "predicted": ".2f", "squares of pose": ".2f"}
SPREAD = {"RMS": ".2f", "sigma": ".2f", "90 %": ".2f", "CE90": ".2f", "squares": ".2f", "grazing": "d"}


def _spread(one: Spread) -> list[Cell]:
    return [one.rms, one.sigma, one.ce90, one.predicted90, one.squares, one.grazing]


def blocks_sheet(found: Sequence[Dense]) -> Sheet:
    """Results by block size."""
    rows: list[list[Cell]] = []
    for one in found:
        case: list[Cell] = [one.noise, one.size, one.trials, one.blocks, one.failed, one.ties, one.registration]
        rows.append([*case, one.pose, one.half, one.sigma_pose, one.squares_pose, *_spread(one.spread)])
    columns = {"noise": "g", "block": "d", "trials": "d", "blocks": ".1f", "failed": ".1%", "ties": ".1f"}
    columns |= {"registration": ".2f"} | POSE | SPREAD
    note = (
        f"An image of {WIDTH} x {HEIGHT} px on cells of {FINE_CELL:g} m; blocks in cells; noise in parts of the "
        "image's own spread. m in plan, over trials with other noise, light, elevation model and pose, which is off by "
        f"{LEFT[0]:g} m and {LEFT[1]:g} deg when the image is rectified; pose: how far off "
        "what is truly there is imaged, whatever the elevation model; ± is half its 95 % interval, predicted its value "
        "from the covariance, with the elevation model's errors averaged over each block; squares of pose: the mean "
        "square of error over prediction, 1 if it is right, of few trials. RMS and CE90 of "
        "fixes are mostly of the height of each pixel's own ground. "
        "failed: without a candidate, or the best one wrong. The paper: the more blocks the better, and about "
        f"{printed.BLOCK} px a side, as smaller ones fail. registration: what the residuals of ties come to beside the "
        "terrain's heights."
    )
    return Sheet("blocks", "Size of blocks (section 2.3)", columns, rows, note)


def ties_sheet(found: Sequence[Dense]) -> Sheet:
    """Results by number of ties."""
    rows: list[list[Cell]] = [
        [
            *(int(one.ties), one.trials, one.registration, one.pose, one.half, one.sigma_pose, one.squares_pose),
            *_spread(one.spread),
        ]
        for one in found
    ]
    columns = {"ties": "d", "trials": "d", "registration": ".2f"} | POSE | SPREAD
    note = f"Ties drawn from those of the smallest blocks, {SUBSETS} times in each trial; m in plan, as above."
    return Sheet("ties", "Number of ties (section 2.3)", columns, rows, note)


def mutual_sheet(found: Sequence[Mutual]) -> Sheet:
    """Several images without a map, before and after their mutual correction."""
    rows: list[list[Cell]] = []
    for one in found:
        case: list[Cell] = [one.position, one.attitude_deg, one.images, one.points, one.refused]
        (low, high), (low_absolute, high_absolute) = one.bounds
        of_neighbours: list[Cell] = [*one.relative, one.squares[0], f"{low:.2f}-{high:.2f}"]
        absolute: list[Cell] = [*one.absolute, one.squares[1], f"{low_absolute:.2f}-{high_absolute:.2f}"]
        rows.append([*case, *of_neighbours, *absolute, *one.common, one.share])
    columns = {"position": "g", "attitude": "g", "images": "d", "ties": "d", "refused": "d"}
    for name in ("neighbours", "absolute"):
        columns |= {f"{name} before": ".2f", f"{name} after": ".2f", f"{name} predicted": ".2f"}
        columns |= {f"{name} squares": ".2f", f"{name} 99.9 %": ""}
    columns |= {"common before": ".2f", "common after": ".2f", "common predicted": ".2f", "common share": ".1%"}
    first = found[0]
    hidden = "; ".join(dict.fromkeys(", ".join(one.hidden) or "none" for one in found))
    note = (
        f"{OFF_NADIR:g} deg off nadir, {ABOVE:g} m above hills, {BASE:g} m from image to image; {first.draws} draws "
        f"each; m and deg of the navigation, {SHARED:.0%} of the variance common to all images; tie points simulated, "
        f"measured to {NOISE:g} px. RMS in m on the ground, its height exact: neighbours, distance between the places "
        "of one point in neighbouring images; absolute, error of the place of the middle of each image; common, of the "
        "mean of these over the images, which tie points do not show, with its share of the squared absolute error. "
        "squares: mean square of error over predicted, with the chi-square bounds of these draws; that of neighbours "
        "is below 1 for two images, as few ties raise their standard deviation by chance. refused: draws in which too "
        "many ties did not fit. Shared errors of "
        f"which more than nine tenths are left (1 of each image, 2 shared): {hidden}."
    )
    return Sheet("mutual", "Several images without a map (section 4)", columns, rows, note)


def searches_sheet(found: Sequence[Searched]) -> Sheet:
    """Constrained against unconstrained search."""
    rows: list[list[Cell]] = []
    for one in found:
        sought = one.sought
        case: list[Cell] = [sought.name, sought.block, one.search, one.draws, one.blocks, one.cells / 1e3, one.seconds]
        low, high = share(one.best_wrong, one.candidates)
        matched: list[Cell] = [one.inside, one.candidates, one.best_wrong, f"{low:.0%}-{high:.0%}"]
        chosen: list[Cell] = [n for name in CHOICES for n in (*one.chosen[name], one.useless[name])]
        rows.append([*case, *matched, *chosen])
    columns = {"scene": "", "block": "d", "search": "", "draws": "d", "blocks": "d", "thousand cells": ".1f"}
    columns |= {"seconds": ".2f", "within": "d", "matched": "d", "best wrong": "d", "95 %": ""}
    for name in CHOICES:
        columns |= {name: "d", f"{name} wrong": "d", f"{name} useless": "d"}
    scenes = dict.fromkeys(one.sought for one in found)
    figures = "; ".join(
        f"{one.name}: navigation {one.position:g} m, {one.attitude_deg:g} deg, noise {one.noise:g} of the image's own "
        f"spread, candidates from {one.above_chance:g} times chance on and of {one.largest_sigma:g} cells of sigma"
        + (f", texture that repeats every {one.period} cells in {one.share:.0%} of its variance" if one.period else "")
        for one in scenes
    )
    note = (
        f"{figures}. Block sizes in cells of {CELL:g} m on the map, as the paper compares them, the image of {WIDTH} x "
        f"{HEIGHT} px rectified once from the navigation; all counts are sums over draws of noise, light, errors of "
        f"the navigation and of the elevation model. unconstrained: {FAR:g} cells around. within: the true shift is "
        "within the constraint. Wrong: farther than 3 cells from the median of the true shifts over the block. best: a "
        "block's best candidate, before any choice; then how many each choice takes, how many of these are wrong, and "
        f"in how many draws it is useless: more than {SPOILT:.0%} of its blocks wrong, or fewer than 3."
    )
    return Sheet("searches", "The constrained search, and three choices (section 2.2)", columns, rows, note)


def frames_sheet(found: Sequence[Frame]) -> Sheet:
    """Frame sequences."""
    rows: list[list[Cell]] = []
    for one in found:
        position, fix = rms(one.position), rms(one.fix)
        registered = "yes" if one.registered else "no"
        rows.append([one.way, one.number, registered, *position, one.sigma_position, *fix, one.sigma_fix])
    columns = {"way": "", "frame": "d", "registered": "", "position": ".1f", "±": ".1f", "sigma": ".1f"}
    columns |= {"fix": ".1f", "± ": ".1f", "sigma ": ".1f"}
    note = (
        f"Root mean squares over {len(found[0].position)} flights, each with an elevation model of other errors, m; "
        "± is half the 95 % interval. Errors of the navigation fade over "
        f"{DURATION:g} s, frames are {STEP:g} s apart, each with {TIES} ties, simulated, with "
        f"sigmas of {MATCHED:g} m on the map and {SIGMA_TERRAIN:g} m in height. The paper names sequences "
        "as an extension."
    )
    return Sheet("frames", "Frames one after the other (section 4)", columns, rows, note)


def grounds_sheet(found: Sequence[Frame]) -> Sheet:
    """The last frame by ground."""
    last = [one for one in found if one.number == max(x.number for x in found)]
    rows: list[list[Cell]] = []
    for ground in dict.fromkeys(last[0].relief):
        here = np.array([name == ground for name in last[0].relief])
        for one in last:
            rows.append([ground, one.way, int(here.sum()), *rms(one.position[here]), *rms(one.fix[here])])
    columns = {"ground": "", "way": "", "flights": "d", "position": ".1f", "±": ".1f", "fix": ".1f", "± ": ".1f"}
    slopes = ", ".join(f"{name} {slope:g}" for name, slope in SLOPES.items())
    note = f"The last frame. Rms slopes of made ground, deg: {slopes}; the hills are the package's elevation model."
    return Sheet("grounds", "The last frame over several grounds (section 4)", columns, rows, note)
