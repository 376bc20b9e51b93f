"""Synthetic runs: their commands and wind, and how they are recorded."""

from ._drive import (
    Drive as Drive,
    Move as Move,
    joint_moves as joint_moves,
    planned as planned,
    sampled as sampled,
)
from ._gusts import (
    DECAY as DECAY,
    RESOLVED as RESOLVED,
    gust_coherence as gust_coherence,
    gust_spectrum as gust_spectrum,
    gusts as gusts,
    gusts_left_out as gusts_left_out,
    wind_frame as wind_frame,
)
from ._recording import (
    RecordingErrors as RecordingErrors,
    command_columns as command_columns,
    drifting as drifting,
    driven_run as driven_run,
    logged_motion as logged_motion,
    recorded_again as recorded_again,
    synthesise as synthesise,
    with_errors as with_errors,
)
