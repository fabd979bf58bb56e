"""Self-contained HTML reports: ground points of pixels, their accuracy, and error budgets; corrections of images.

`write_report(path, subject)` writes the report of a `ReportData`: exposures, pixels, terrain, error sources and fixes.
`write_correction_report(path, found)` writes that of a `jaxgeo.ties.Correction`.
"""

try:
    import bokeh  # noqa: F401
    import jinja2  # noqa: F401
    import matplotlib  # noqa: F401
except ImportError as error:
    raise ImportError("reports are drawn with bokeh, jinja2 and matplotlib: pip install 'jaxgeo[report]'") from error

from jaxgeo.report.correction import correction_html, write_correction_report
from jaxgeo.report.data import ReportData
from jaxgeo.report.details import Detail, details_of
from jaxgeo.report.page import ReportHeader, report_html, write_report

__all__ = [
    "Detail",
    "ReportData",
    "ReportHeader",
    "correction_html",
    "details_of",
    "report_html",
    "write_correction_report",
    "write_report",
]
