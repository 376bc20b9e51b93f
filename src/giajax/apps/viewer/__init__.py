"""View an arm in 3D in a browser: a live page, and a page that plays without a server."""

from ._beside import outline as outline
from ._gate import (
    LOOPBACK as LOOPBACK,
    Gate as Gate,
    PrivateSocket as PrivateSocket,
    bound as bound,
    open_in_browser as open_in_browser,
)
from ._page import (
    SPEEDS as SPEEDS,
    LiveStage as LiveStage,
    Player as Player,
    Viewer as Viewer,
    factor as factor,
    recording as recording,
)
from ._show import (
    Bands as Bands,
    Posable as Posable,
    Show as Show,
    frames as frames,
    posed as posed,
    shown as shown,
    span as span,
    words as words,
)
from ._stage import (
    ball as ball,
    brick as brick,
    check_viser as check_viser,
    cut as cut,
    edges as edges,
    ends as ends,
    scale_of as scale_of,
    segments as segments,
    thread_colours as thread_colours,
    tube as tube,
    turns_to as turns_to,
)
