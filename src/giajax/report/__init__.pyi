"""The public names of `giajax.report`, each once."""

from ._files import (
    Reached as Reached,
    check_figures as check_figures,
    check_folder as check_folder,
    reached as reached,
    write_figures as write_figures,
    write_result as write_result,
)
from ._pages import (
    check_page as check_page,
    compare_page as compare_page,
    report_page as report_page,
    study_page as study_page,
)
from ._pictures import (
    correlation_figure as correlation_figure,
    plot as plot,
    prediction_figure as prediction_figure,
    recorded_figure as recorded_figure,
    residuals_figure as residuals_figure,
)
from ._posterior import (
    POSTERIOR as POSTERIOR,
    POSTERIOR_FILES as POSTERIOR_FILES,
    POSTERIOR_HEADINGS as POSTERIOR_HEADINGS,
    bands_figure as bands_figure,
    corner_figure as corner_figure,
    draws_file as draws_file,
    posterior_files as posterior_files,
    posterior_rows as posterior_rows,
    trace_figure as trace_figure,
)
from ._profiles import (
    PROFILE_HEADINGS as PROFILE_HEADINGS,
    profile_figure as profile_figure,
    profile_rows as profile_rows,
)
from ._repetitions import (
    bootstrap_figure as bootstrap_figure,
    bootstrap_summary as bootstrap_summary,
    bootstrap_table as bootstrap_table,
    influence_figure as influence_figure,
    influence_summary as influence_summary,
    influence_table as influence_table,
)
from ._sensitivity import (
    information_shares as information_shares,
    sensitivity_figure as sensitivity_figure,
    sensitivity_files as sensitivity_files,
)
from ._style import (
    BLUE as BLUE,
    DEGREE as DEGREE,
    GREEN as GREEN,
    GREY as GREY,
    INK as INK,
    LIGHT as LIGHT,
    MINUS as MINUS,
    PURPLE as PURPLE,
    VERMILLION as VERMILLION,
    columns_of as columns_of,
    draw_blocks as draw_blocks,
    draw_scene as draw_scene,
    new_figure as new_figure,
    plain as plain,
    to_csv as to_csv,
    to_png as to_png,
)
from ._suspects import (
    SUSPECT_HEADINGS as SUSPECT_HEADINGS,
    contrast_json as contrast_json,
    contrast_tables as contrast_tables,
    first_suspects as first_suspects,
    stepwise_table as stepwise_table,
    suspect_rows as suspect_rows,
    suspect_summary as suspect_summary,
    systematic_table as systematic_table,
)
from ._text import PAGE as PAGE, parameter_table as parameter_table, summary as summary
from ._views import (
    PageSection as PageSection,
    RecordView as RecordView,
    Table as Table,
    sections as sections,
    view_of as view_of,
)
