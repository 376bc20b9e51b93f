"""An arm that a person drives: pad, sliders, a fixed step in time with a clock, and a record."""

from ._cockpit import LATENCY as LATENCY, Cockpit as Cockpit, TipCamera as TipCamera
from ._operator import Operator as Operator, PadMapping as PadMapping
from ._session import (
    RATE as RATE,
    Compensation as Compensation,
    Pose as Pose,
    Record as Record,
    Session as Session,
    check_length as check_length,
    read_pad as read_pad,
    replay as replay,
)
