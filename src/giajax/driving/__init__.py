"""An arm that a person drives: pad, sliders, a fixed step in time with a clock, and a record."""

from ._cockpit import Cockpit as Cockpit
from ._compensation import Compensation as Compensation
from ._mapping import PadMapping as PadMapping
from ._operator import Operator as Operator
from ._pose import Pose as Pose
from ._record import Record as Record
from ._replay import check_length as check_length, read_pad as read_pad, replay as replay
from ._session import RATE as RATE, Session as Session
from ._tip_camera import LATENCY as LATENCY, TipCamera as TipCamera
