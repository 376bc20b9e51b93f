"""A page that plays without a server: one file."""

from collections.abc import Sequence

from .._policy import VISER, with_policy
from ._arrangement import stages
from ._backend import Backend
from ._show import Show, frames

RATE = 30.0
"""Most frames in a second of the motion."""

MOST_FRAMES = 1500
"""In a file: twenty links in this many are about 2 MB."""


def recording(shows: Sequence[Show], *, overlay: bool = False, dark: bool = False) -> bytes:
    """A page for a browser in which shows are played, with a time bar and a choice of speeds.

    Arguments:
        shows: at least one, on one clock.
        overlay: all in one place instead of side by side.
        dark: light on dark.

    Returns:
        HTML that needs nothing else, in UTF-8.
    """
    backend = Backend()
    server = backend.server
    try:
        drawn = stages(server, shows, overlay=overlay)
        recorder = server.get_scene_serializer()
        times = frames(shows, RATE, MOST_FRAMES)
        for index, time in enumerate(times):
            for stage in drawn:
                stage.draw(stage.show.sample_at(float(time)))
            if index + 1 < len(times):
                recorder.insert_sleep(float(times[index + 1] - time))
        return with_policy(recorder.as_html(dark).encode(), VISER)
    finally:
        backend.close()
