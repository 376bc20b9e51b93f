"""Read, check, describe and write recorded runs. Does not import JAX."""

from ._channels import (
    Channel as Channel,
    infer_model as infer_model,
    parse_column as parse_column,
    parse_columns as parse_columns,
)
from ._definition import (
    Definition as Definition,
    complaint as complaint,
    fit_settings as fit_settings,
    run_keys as run_keys,
    sidecar_template as sidecar_template,
    to_toml as to_toml,
    upgraded as upgraded,
)
from ._describe import describe as describe
from ._fit_sections import (
    FIT_DEFAULTS as FIT_DEFAULTS,
    Figure as Figure,
    FitKeywords as FitKeywords,
    FitSettings as FitSettings,
    Loss as Loss,
    NoiseModel as NoiseModel,
    PriorEntry as PriorEntry,
    StartsKeywords as StartsKeywords,
    TaskKeywords as TaskKeywords,
    deviation_of as deviation_of,
    seconds_of as seconds_of,
)
from ._foreign import (
    ForeignColumn as ForeignColumn,
    ForeignTable as ForeignTable,
    ImportSettings as ImportSettings,
    channels_of as channels_of,
    rows_kept as rows_kept,
)
from ._formats import (
    FORMATS as FORMATS,
    AbstractFormat as AbstractFormat,
    Sheet as Sheet,
    read_foreign as read_foreign,
)
from ._hold_out import (
    SplitRun as SplitRun,
    fitted_parts as fitted_parts,
    held_parts as held_parts,
    hold_out as hold_out,
    split_run as split_run,
)
from ._mistakes import Mistake as Mistake, mistakes as mistakes, point_of as point_of
from ._plausible import oddities as oddities
from ._plausible_columns import Oddity as Oddity
from ._read import (
    LineReader as LineReader,
    check_output_files as check_output_files,
    check_output_folder as check_output_folder,
    check_output_run as check_output_run,
    make_folder as make_folder,
    observing as observing,
    parse_rename as parse_rename,
    read_run as read_run,
    read_runs as read_runs,
    read_sidecar as read_sidecar,
    rows_of as rows_of,
    sidecar_path as sidecar_path,
    windows as windows,
    write_files as write_files,
    write_run as write_run,
)
from ._run import Run as Run, unique_names as unique_names
from ._stored import (
    SCHEMA_VERSION as SCHEMA_VERSION,
    StoredConfig as StoredConfig,
    StoredTask as StoredTask,
    stored_result as stored_result,
)
from ._table import (
    column_names as column_names,
    read_numbers as read_numbers,
    read_table as read_table,
)
from ._tracked import (
    Beside as Beside,
    TrackedPoints as TrackedPoints,
    filmed as filmed,
    filmed_beside as filmed_beside,
    read_beside as read_beside,
    read_deeplabcut as read_deeplabcut,
    read_kinovea as read_kinovea,
)
