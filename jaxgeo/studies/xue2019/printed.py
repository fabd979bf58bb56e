"""Printed values of Xue et al. (2019) in their units: m, mm and minutes of arc; x is taken as east, y as north."""

from __future__ import annotations

from typing import NamedTuple


class Interior(NamedTuple):
    """Focal length and principal point in mm, y up as in photogrammetry."""

    f: float
    xp: float
    yp: float


CALIBRATED = Interior(55.5019, 0.0260, 0.2246)  # Table 4, by the maker, two years before
INTERIORS = {  # Table 4, by self-calibration
    "Bauer": Interior(55.2784, -0.0329, 0.1692),
    "Ebner": Interior(55.2753, -0.0313, 0.1694),
    "Brown": Interior(55.2723, -0.0237, 0.1570),
}
BORESIGHT = (-4.1910, 0.8226, 19.4448)  # minutes of arc about x, y and z

COLUMNS, ROWS = 10328, 7760
PIXEL_PITCH = 5.2e-3  # mm; number and size of pixels are from the maker of the camera that the paper names
HEIGHT = 500.0  # m above ground, Table 2
ALONG, ACROSS = 0.80, 0.50  # overlap, Table 2
GROUND_SAMPLE = 0.05  # m, Table 2
AREA = 5000.0  # m, the side of the field, Table 2
CONTROL, CHECKS = 9, 12  # points of Fig. 8

# Table 1, 310 SmartBase post-processed: better than 0.05 m in plan and 0.1 m in height
SIGMA_POSITION = (0.05, 0.05, 0.10)  # m, east, north, up
SIGMA_ATTITUDE = (0.035, 0.015, 0.015)  # deg, heading, pitch, roll

RMS = {  # of the residuals at check points in x, y, z, m: section 2 and Table 3
    "direct": (0.4443, 0.9204, 2.7337),
    "free net": (0.3191, 0.8624, 0.8773),
    "control": (0.0304, 0.0736, 0.1383),
    "Bauer": (0.0386, 0.0561, 0.0830),
    "Ebner": (0.0310, 0.0493, 0.0865),
    "Brown": (0.0307, 0.0490, 0.0874),
    "compensated": (0.2924, 0.4635, 1.0253),
}
IMPROVEMENT = (0.4637, 0.6249)  # of direct georeferencing by compensation, in plan and in height
WITH_CONTROL = (0.07, 0.09)  # m, "better than", in plan and in height: well within the limits for maps at 1:500
