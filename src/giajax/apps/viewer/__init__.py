"""An arm in three dimensions, in a browser: a live page, and a file that plays without a server."""

from ._gate import LOOPBACK as LOOPBACK, Gate as Gate, PrivateSocket as PrivateSocket
from ._page import (
    LiveStage as LiveStage,
    Player as Player,
    Viewer as Viewer,
    recording as recording,
)
from ._show import Posable as Posable, Show as Show, shown as shown
from ._stage import check_viser as check_viser
