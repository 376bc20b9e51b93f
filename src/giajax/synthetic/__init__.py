"""Runs that a model makes instead of an experiment: what drives them, and how they are recorded."""

from ._drive import Drive as Drive, Move as Move, joint_moves as joint_moves, sampled as sampled
from ._gusts import gusts as gusts
from ._recording import recorded_again as recorded_again
from ._recording_errors import (
    RecordingErrors as RecordingErrors,
    with_errors as with_errors,
)
from ._synthesise import synthesise as synthesise
from ._turbulence import (
    DECAY as DECAY,
    RESOLVED as RESOLVED,
    gust_coherence as gust_coherence,
    gust_spectrum as gust_spectrum,
    gusts_left_out as gusts_left_out,
    wind_frame as wind_frame,
)
