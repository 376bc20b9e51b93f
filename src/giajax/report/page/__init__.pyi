from ._compare import compare_page as compare_page
from ._plots import autocorrelation as autocorrelation, thinned as thinned
from ._render import animation as animation, some_of as some_of, study_page as study_page
from ._report import opening as opening, report_page as report_page
from ._tables import correlation_cells as correlation_cells, optima_table as optima_table
