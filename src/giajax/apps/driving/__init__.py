"""Drive a simulated arm in real time with a game pad or sliders, and record the drive."""

from ._cockpit import (
    LATENCY as LATENCY,
    TAKEN_OVER as TAKEN_OVER,
    Cockpit as Cockpit,
    TipCamera as TipCamera,
)
from ._operator import (
    LET_GO as LET_GO,
    NO_PAD as NO_PAD,
    NOT_YET as NOT_YET,
    SILENT as SILENT,
    STOPPED as STOPPED,
    Operator as Operator,
    PadMapping as PadMapping,
    shaped as shaped,
)
from ._session import (
    RATE as RATE,
    Compensation as Compensation,
    Pose as Pose,
    Record as Record,
    Session as Session,
    Unfinished as Unfinished,
    check_length as check_length,
    read_pad as read_pad,
    replay as replay,
)
