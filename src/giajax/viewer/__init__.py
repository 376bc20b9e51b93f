"""An arm in three dimensions, in a browser: a live page, and a file that plays without a server."""

from ._backend import check_viser as check_viser
from ._behind import PrivateSocket as PrivateSocket
from ._gate import LOOPBACK as LOOPBACK, Gate as Gate
from ._live import LiveStage as LiveStage
from ._page import Viewer as Viewer
from ._player import Player as Player
from ._recording import recording as recording
from ._show import Show as Show
from ._sources import Posable as Posable, shown as shown
