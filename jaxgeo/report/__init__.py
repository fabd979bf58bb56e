"""Reports: one page that shows where pixels look, how sure that is and why, and that needs no network.

`write_report(path, subject)` writes one of a `Subject`: what was looked at, through what, and what was found.
"""

try:
    import bokeh  # noqa: F401
    import jinja2  # noqa: F401
    import matplotlib  # noqa: F401
except ImportError as error:
    raise ImportError("reports are drawn with bokeh, jinja2 and matplotlib: pip install 'jaxgeo[report]'") from error

from jaxgeo.report.data import ReportData
from jaxgeo.report.details import Detail, details_of
from jaxgeo.report.page import ReportHeader, report_html, write_report

__all__ = ["Detail", "ReportData", "ReportHeader", "details_of", "report_html", "write_report"]
