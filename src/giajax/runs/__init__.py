"""Recorded runs: reading, checking, describing and writing them. Imports no JAX."""

from ._channels import Channel as Channel, parse_column as parse_column
from ._complaints import complaint as complaint
from ._definition import (
    Definition as Definition,
    run_keys as run_keys,
    upgraded as upgraded,
)
from ._describe import describe as describe
from ._duration import seconds_of as seconds_of
from ._filmed import (
    Beside as Beside,
    filmed as filmed,
    filmed_beside as filmed_beside,
    read_beside as read_beside,
)
from ._fit_sections import Figure as Figure, Fit as Fit
from ._hold_out import Parted as Parted, hold_out as hold_out, parted as parted
from ._names import unique_names as unique_names
from ._noise import deviation_of as deviation_of
from ._output import (
    check_output_files as check_output_files,
    check_output_folder as check_output_folder,
    check_output_run as check_output_run,
    make_folder as make_folder,
)
from ._read import (
    parse_rename as parse_rename,
    read_run as read_run,
    read_runs as read_runs,
    read_sidecar as read_sidecar,
    sidecar_path as sidecar_path,
)
from ._run import Run as Run
from ._select import observing as observing, rows_of as rows_of, windows as windows
from ._table import read_numbers as read_numbers
from ._template import sidecar_template as sidecar_template
from ._tracked import (
    TrackedPoints as TrackedPoints,
    read_deeplabcut as read_deeplabcut,
    read_kinovea as read_kinovea,
)
from ._write import write_files as write_files, write_run as write_run
