"""The page of a live viewer: time bar, layers, legend, and the joints of an arm without a motion.

Longer than 200 lines because a page is one concept: every part of it shares the clock and stages.
"""

import threading
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ._arrangement import offsets, stages
from ._backend import Backend
from ._gate import LOOPBACK, Gate
from ._player import SPEEDS, Player, factor
from ._show import Show, span
from ._sources import Posable

if TYPE_CHECKING:
    from ._stage import Stage

# Poses a second at most: smooth, and no more than two cores can draw.
_RATE = 30.0

_TITLES = {
    "balloons": "balloons",
    "muscles": "muscles, by pressure",
    "markers": "markers of the model",
    "recorded": "recorded markers",
    "air": "drag of the air",
    "contact": "contact",
    "surroundings": "surroundings",
}

# Of an arm without a motion: as far as a joint of the paper's goes.
_LARGEST = 60.0


class Viewer:
    """A page on which shows are played, behind an address with a token.

    Arguments:
        shown: motions on one clock, or one arm without a motion.
        overlay: all in one place instead of side by side.
        host: where to listen; "127.0.0.1": for browsers of this machine alone.
        port: where to listen; 0 for a free one.

    Raises:
        InputError: viser is not installed, or the port is in use.
    """

    def __init__(
        self,
        shown: Sequence[Show | Posable],
        *,
        overlay: bool = False,
        host: str = LOOPBACK,
        port: int = 0,
    ) -> None:
        self._lock = threading.RLock()
        self._posable = next((each for each in shown if isinstance(each, Posable)), None)
        self.shows = [
            each.show(np.zeros(each.arm.count)) if isinstance(each, Posable) else each
            for each in shown
        ]
        self.player = Player(*span(self.shows))
        self._backend = Backend()
        self._server = self._backend.server
        try:
            self._gate = Gate({"": self._backend.socket}, host=host, port=port)
        except BaseException:
            self._backend.close()
            raise
        self._overlay = overlay
        self.stages: list[Stage] = stages(self._server, self.shows, overlay=overlay)
        self._ended = threading.Event()
        self._build()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Where a browser finds the page; whoever has it, sees it."""
        return self._gate.address

    @property
    def is_open(self) -> bool:
        """Whether other machines can reach the page."""
        return self._gate.is_open

    @property
    def server(self) -> Any:
        """Of viser, for whoever adds something to the page."""
        return self._server

    def close(self) -> None:
        """End the page."""
        self._ended.set()
        self._thread.join(timeout=5)
        self._gate.close()
        self._backend.close()

    def draw(self) -> None:
        """Show the time of the player."""
        with self._lock, self._server.atomic():
            for stage in self.stages:
                stage.draw(stage.show.sample_at(self.player.time))
            self._say()

    def pose(self, angles: Any) -> None:
        """Set the joints of an arm without a motion, rad, shape (joint,)."""
        assert self._posable is not None
        with self._lock, self._server.atomic():
            stage = self.stages[0]
            stage.show = self._posable.show(np.asarray(angles))
            stage.draw(0)
            self._say()

    def _run(self) -> None:
        """Play, until the page ends."""
        before = time.monotonic()
        while not self._ended.wait(1 / _RATE):
            now = time.monotonic()
            if self.player.tick(now - before):
                self.draw()
                self._place_slider()
            before = now

    def _build(self) -> None:
        gui = self._server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(0, 90, 140))
        gui.main_panel.dock_right()
        gui.set_panel_label("giajax")
        self._words = gui.add_markdown("")
        if self._posable is not None:
            self._joints()
        elif self.player.last > self.player.first:
            self._clock()
        with gui.add_folder("Show"):
            there = {layer for stage in self.stages for layer in stage.layers()}
            for layer, title in _TITLES.items():
                if layer in there:
                    self._layer(layer, title)
            if len(self.stages) > 1:
                box = gui.add_checkbox("one in the other", self._overlay)
                box.on_update(lambda _: self._place(overlay=box.value))
        self.draw()

    def _clock(self) -> None:
        """Time bar, play, speed."""
        gui, player = self._server.gui, self.player
        with gui.add_folder("Time"):
            step = max((player.last - player.first) / 2000, 1e-3)
            bar = gui.add_slider("time (s)", player.first, player.last, step, player.first)
            play = gui.add_button("play")
            speed = gui.add_dropdown("speed", SPEEDS, initial_value="1")
            again = gui.add_checkbox("again and again", player.again)
        self._bar: Any = bar
        self._play: Any = play

        @bar.on_update
        def _(event: Any) -> None:
            # What the player itself moves comes without a client.
            if event.client is not None:
                player.playing = False
                player.seek(bar.value)
                self._label()
                self.draw()

        @play.on_click
        def _(_: Any) -> None:
            if player.playing:
                player.playing = False
            else:
                player.play()
            self._label()

        @speed.on_update
        def _(_: Any) -> None:
            player.speed = factor(speed.value)

        @again.on_update
        def _(_: Any) -> None:
            player.again = again.value

    def _label(self) -> None:
        self._play.label = "pause" if self.player.playing else "play"

    def _place_slider(self) -> None:
        self._bar.value = self.player.time
        self._label()

    def _joints(self) -> None:
        """A slider for each joint, in degrees."""
        assert self._posable is not None
        gui, count = self._server.gui, self._posable.arm.count
        sliders: list[Any] = []

        def moved(_: Any) -> None:
            self.pose(np.deg2rad([slider.value for slider in sliders]))

        with gui.add_folder("Joints (deg)"):
            straight = gui.add_button("straight")
            for joint in range(1, count + 1):
                sliders.append(gui.add_slider(f"{joint}", -_LARGEST, _LARGEST, 0.5, 0.0))
        for slider in sliders:
            slider.on_update(moved)

        @straight.on_click
        def _(_: Any) -> None:
            for slider in sliders:
                slider.value = 0.0

    def _layer(self, layer: str, title: str) -> None:
        box = self._server.gui.add_checkbox(title, True)

        @box.on_update
        def _(_: Any) -> None:
            for stage in self.stages:
                stage.visible(layer, box.value)

    def _place(self, *, overlay: bool) -> None:
        for stage, place in zip(self.stages, offsets(self.shows, overlay=overlay), strict=True):
            stage.place(place)

    def _say(self) -> None:
        """What is seen, in words."""
        self._words.content = "\n\n".join(
            stage.words(stage.show.sample_at(self.player.time)) for stage in self.stages
        )
