"""Live viewer page with its playback clock, live scene of one arm, and recordings as one file."""

import dataclasses
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...models import Scene
from ...runtime.page_policy import VISER, with_policy
from ._beside import about, beside, viser_page
from ._gate import LOOPBACK, Gate
from ._show import Posable, Show, frames, span
from ._stage import LAYERS, Backend, Stage, offsets, stages

SPEEDS = ("1/4", "1/2", "1", "2", "4", "8", "16")
"""Playback speeds, as multiples of real time."""


@dataclasses.dataclass
class Player:
    """Playback clock, which runs at a multiple of real time.

    Attributes:
        first, last: first and last time of the playback, s.
        time: time that is shown, s.
        playing: whether the clock runs.
        speed: playback speed, as a multiple of real time.
        again: whether the playback restarts after its end.
    """

    first: float
    last: float
    time: float = 0.0
    playing: bool = False
    speed: float = 1.0
    again: bool = True

    def __post_init__(self) -> None:
        self.time = self.first

    def tick(self, elapsed: float) -> bool:
        """Advance the clock by an elapsed real time, s; return whether the shown time changed."""
        if not self.playing or self.last <= self.first:
            return False
        before = self.time
        self.time += elapsed * self.speed
        if self.time >= self.last:
            if self.again and before >= self.last:
                self.time = self.first
            else:
                # Show the end for at least one tick.
                self.time = self.last
                self.playing = self.again
        return self.time != before

    def play(self) -> None:
        """Start the clock, from the first time if it is at its end."""
        self.playing = True
        if self.time >= self.last:
            self.time = self.first

    def seek(self, time: float) -> None:
        """Show a time, s."""
        self.time = min(max(time, self.first), self.last)


def factor(speed: str) -> float:
    """Return one of `SPEEDS` as a number."""
    above, _, below = speed.partition("/")
    return float(above) / float(below or 1)


_RATE = 30.0  # largest number of poses per second: smooth, and within the capacity of two cores
_LARGEST = 60.0  # largest angle of a slider, deg: the range of a joint of the paper's arm


class Viewer:
    """Page that plays shows. Anyone who has its address, which contains a token, can view it.

    `address` is the address for a browser. `is_open` says whether other machines can reach it.

    Arguments:
        shown: motions on one clock, or one arm without a motion.
        overlay: show all of them in one place instead of side by side.
        host: host to listen at; "127.0.0.1" accepts only browsers on this machine.
        port: port to listen at; 0 chooses a free one.

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
        # The viser server is public, so that users can add to the page.
        self.server = self._backend.server
        try:
            self._gate = Gate({"": self._backend.socket}, host=host, port=port)
        except BaseException:
            self._backend.close()
            raise
        self.address, self.is_open = self._gate.address, self._gate.is_open
        self._overlay = overlay
        self.stages: list[Stage] = stages(self.server, self.shows, overlay=overlay)
        self._backend.page = lambda: beside(viser_page(), about(self.stages, live=True))
        self._ended = threading.Event()
        self._build()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Close the page."""
        self._ended.set()
        self._thread.join(timeout=5)
        self._gate.close()
        self._backend.close()

    def draw(self) -> None:
        """Draw the shows at the time of the player."""
        with self._lock, self.server.atomic():
            for stage in self.stages:
                stage.draw(stage.show.sample_at(self.player.time))
            self._say()

    def pose(self, angles: Any) -> None:
        """Set the joint angles of an arm without a motion, rad, shape (joint,)."""
        assert self._posable is not None
        with self._lock, self.server.atomic():
            stage = self.stages[0]
            stage.show = self._posable.show(np.asarray(angles))
            stage.draw(0)
            self._say()

    def _run(self) -> None:
        """Run the playback until the page is closed."""
        before = time.monotonic()
        while not self._ended.wait(1 / _RATE):
            now = time.monotonic()
            if self.player.tick(now - before):
                self.draw()
                self._bar.value = self.player.time
                self._label()
            before = now

    def _build(self) -> None:
        gui = self.server.gui
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
            for layer, title in LAYERS.items():
                if layer in there:
                    self._layer(layer, title)
            if len(self.stages) > 1:
                box = gui.add_checkbox("overlay", self._overlay)
                box.on_update(lambda _: self._place(overlay=box.value))
        self.draw()

    def _clock(self) -> None:
        """Add the time bar, the play button, and the choices of speed and repetition."""
        gui, player = self.server.gui, self.player
        with gui.add_folder("Time"):
            step = max((player.last - player.first) / 2000, 1e-3)
            bar = gui.add_slider("time (s)", player.first, player.last, step, player.first)
            play = gui.add_button("play")
            speed = gui.add_dropdown("speed", SPEEDS, initial_value="1")
            again = gui.add_checkbox("repeat", player.again)
        self._bar: Any = bar
        self._play: Any = play

        @bar.on_update
        def _(event: Any) -> None:
            # An update by the player itself has no client.
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

    def _joints(self) -> None:
        """Add a slider for each joint, in degrees."""
        assert self._posable is not None
        gui, count = self.server.gui, self._posable.arm.count
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
        box = self.server.gui.add_checkbox(title, True)

        @box.on_update
        def _(_: Any) -> None:
            for stage in self.stages:
                stage.visible(layer, box.value)

    def _place(self, *, overlay: bool) -> None:
        for stage, place in zip(self.stages, offsets(self.shows, overlay=overlay), strict=True):
            stage.place(place)

    def _say(self) -> None:
        """Update the text that describes the current samples."""
        self._words.content = "\n\n".join(
            stage.words(stage.show.sample_at(self.player.time)) for stage in self.stages
        )


class LiveStage:
    """Viser page of an arm that the caller moves; each scene has one sample.

    Attributes:
        bounds: least and greatest coordinates of all scenes shown so far, m.
    """

    def __init__(self, scene: Scene) -> None:
        self._backend = Backend()
        self.socket = self._backend.socket
        self._server = self._backend.server
        (self._stage,) = stages(self._server, [Show("arm", scene)])
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.gui.main_panel.minimize()
        self.bounds = scene.extent()
        self._backend.page = lambda: beside(viser_page(), about([self._stage], live=True))

    @property
    def watched(self) -> bool:
        """Whether a browser shows the page."""
        return bool(self._server.get_clients())

    def draw(self, scene: Scene) -> None:
        """Draw another scene with the same parts."""
        with self._server.atomic():
            self._stage.show = Show("arm", scene)
            self._stage.draw(0)
        low, high = scene.extent()
        self.bounds = np.stack([np.minimum(self.bounds[0], low), np.maximum(self.bounds[1], high)])

    def close(self) -> None:
        """Close the page."""
        self._backend.close()


RATE = 30.0
"""Largest number of frames per second of the motion."""

MOST_FRAMES = 1500  # largest number of frames in a file: about 2 MB for an arm of twenty links


def recording(shows: Sequence[Show], *, overlay: bool = False, dark: bool = False) -> bytes:
    """Return a page that plays shows in a browser, with a time bar and a choice of speeds.

    The page is self-contained HTML in UTF-8. The shows (at least one) share one clock. They are
    side by side, or all in one place as an overlay. A dark page is light on dark.
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
        page = beside(recorder.as_html(dark).encode(), about(drawn, dark=dark))
        return with_policy(page, VISER)
    finally:
        backend.close()
