"""What a person sees of fits and models: tables, pictures and files."""

from ._bootstrap import (
    BOOTSTRAP as BOOTSTRAP,
    bootstrap_figure as bootstrap_figure,
    bootstrap_summary as bootstrap_summary,
    bootstrap_table as bootstrap_table,
)
from ._contrast import contrast_json as contrast_json, contrast_tables as contrast_tables
from ._correlation import correlation_figure as correlation_figure
from ._csv import to_csv as to_csv
from ._design import (
    DESIGN_HEADINGS as DESIGN_HEADINGS,
    design_figure as design_figure,
    design_json as design_json,
    design_rows as design_rows,
)
from ._files import write_figures as write_figures, write_result as write_result
from ._filling import (
    CURVE_FILES as CURVE_FILES,
    FILLING_FILES as FILLING_FILES,
    curve_figure as curve_figure,
    filling_figure as filling_figure,
    filling_files as filling_files,
    filling_json as filling_json,
)
from ._folder import check_folder as check_folder
from ._influence import (
    INFLUENCE as INFLUENCE,
    influence_figure as influence_figure,
    influence_summary as influence_summary,
    influence_table as influence_table,
)
from ._joint_angle import angle_figure as angle_figure, angle_table as angle_table
from ._joint_correction import (
    correction_figure as correction_figure,
    correction_table as correction_table,
)
from ._joint_equilibria import (
    equilibria_figure as equilibria_figure,
    equilibria_table as equilibria_table,
)
from ._joint_files import JOINT_FILES as JOINT_FILES, joint_files as joint_files
from ._joint_shape import joint_figure as joint_figure, joint_points as joint_points
from ._mission import (
    MISSION_FILES as MISSION_FILES,
    mission_figure as mission_figure,
    mission_files as mission_files,
    mission_json as mission_json,
)
from ._missions import (
    CASES_FILES as CASES_FILES,
    cases_files as cases_files,
    cases_json as cases_json,
)
from ._pages import (
    PAGE as PAGE,
    check_page as check_page,
    compare_page as compare_page,
    report_page as report_page,
)
from ._posterior import (
    POSTERIOR as POSTERIOR,
    POSTERIOR_FILES as POSTERIOR_FILES,
    POSTERIOR_HEADINGS as POSTERIOR_HEADINGS,
    posterior_files as posterior_files,
    posterior_rows as posterior_rows,
)
from ._posterior_figures import bands_figure as bands_figure, corner_figure as corner_figure
from ._profiles import (
    PROFILE_HEADINGS as PROFILE_HEADINGS,
    profile_figure as profile_figure,
    profile_rows as profile_rows,
)
from ._reached import Reached as Reached, check_figures as check_figures, reached as reached
from ._recorded import recorded_figure as recorded_figure
from ._residuals import residuals_figure as residuals_figure
from ._scene import draw_blocks as draw_blocks, draw_scene as draw_scene
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
    VERMILLION as VERMILLION,
    new_figure as new_figure,
    plain as plain,
    to_png as to_png,
)
from ._suspects import (
    SUSPECT_HEADINGS as SUSPECT_HEADINGS,
    first_suspects as first_suspects,
    ladder_table as ladder_table,
    suspect_rows as suspect_rows,
    suspect_summary as suspect_summary,
    systematic_table as systematic_table,
)
from ._text import parameter_table as parameter_table, summary as summary
from ._wind import wind_figure as wind_figure, wind_json as wind_json
