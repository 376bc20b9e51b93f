"""Pages for a browser: one result, or several side by side. Needs the extra `report`."""

from ._compare import compare_page as compare_page
from ._report import report_page as report_page
