"""Page of the operator: a server for its messages, and a view of the arm in 3D."""

import json
import threading
import time
from collections import deque
from contextlib import suppress
from http import HTTPStatus
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from ...mechanics.arm import Arm
from ...models import ArmModel, Pinhole, Scene, View, arm_scene
from ...runtime.arrays import Array, Float
from ...runtime.page_policy import with_policy
from ...runtime.programs import program
from ...runtime.text import InputError
from ...simulation import at_rest
from ..viewer import LOOPBACK, Gate, LiveStage, PrivateSocket
from ._operator import NOT_YET
from ._session import Pose, Record, Session

if TYPE_CHECKING:
    from websockets.http11 import Request, Response
    from websockets.sync.server import ServerConnection

LATENCY = 0.2
"""Default latency of the camera picture, s."""


class TipCamera:
    """View from a camera at the tip, delayed by a latency, s; it rotates with the last link.

    The tip camera of the arm is used if there is one.
    """

    def __init__(self, model: ArmModel, latency: float = LATENCY) -> None:
        if not 0 <= latency <= 60:
            raise InputError(f"the latency is {latency:g} s: give a latency from 0 to 60 s")
        # Default camera: looks along the last link, with a horizontal angle of view of 90 deg.
        usual = Pinhole(
            position=jnp.zeros(3),
            rotation=jnp.zeros(3),
            focal_length=jnp.asarray(320.0),
            centre=jnp.asarray([319.5, 239.5]),
            mount="tip",
            size=(640, 480),
        )
        pinholes = model.sensors.camera.pinholes.values()
        self.camera = next((each for each in pinholes if each.mount == "tip"), usual)
        self.latency = latency
        self._arm = model.arm
        self._views: deque[tuple[float, View]] = deque()

    def see(self, time: float, angles: Float[np.ndarray, " joint"]) -> View:
        """Record the angles at a time, s, and return the delayed view; angles in rad."""
        if self._views and time < self._views[-1][0]:
            self._views.clear()  # a new drive has begun
        self._views.append((time, _view(self.camera, self._arm, jnp.asarray(angles))))
        while len(self._views) > 1 and self._views[1][0] <= time - self.latency + 1e-9:
            self._views.popleft()
        return self._views[0][1]

    def facts(self) -> dict[str, Any]:
        """Return what a page needs to draw the picture: focal lengths, centre and size, px."""
        across = float(self.camera.focal_length)
        aspect = 1.0 if self.camera.aspect is None else float(self.camera.aspect)
        return {
            "focal": [across, across * aspect],
            "centre": np.asarray(self.camera.centre).tolist(),
            "size": list(self.camera.size),
        }


@program
def _view(camera: Pinhole, arm: Arm, angles: Array) -> View:
    return camera.view(arm, angles)


_PAGE = files(__package__).joinpath("page.html")

# Largest number of poses sent to the page per second, and of drawings of the scene per second.
_TOLD, _DRAWN = 60.0, 12.0

# Largest number of late intervals simulated at once. Between them, poses are shown and messages
# from the operator are handled.
_AT_ONCE = 2

_LONGEST_MESSAGE = 1 << 16  # bytes; longer than any message from the page
TAKEN_OVER = "another page has taken over"
UNMOVED = "the drive has ended: no joint was moved, and nothing is saved"
ENDED = "the drive has ended and is being saved: the terminal shows the location of all files"


class Cockpit:
    """Server of the page of a drive, which advances the arm in real time until it is closed.

    Three threads run independently: they advance the arm, send poses to the page, and draw the
    scene. Each uses the latest pose. Poses are not queued.

    Arguments:
        session: drive to advance.
        camera: camera of the picture from the tip.
        host, port: host and port to listen at, as for `giajax.apps.viewer.Viewer`. Anyone who has
            the `address` can drive the arm.
    """

    def __init__(
        self, session: Session, camera: TipCamera, *, host: str = LOOPBACK, port: int = 0
    ) -> None:
        from websockets.sync.server import unix_serve

        self.session = session
        self.camera = camera
        self.error: str | None = None
        self.failure: Exception | None = None
        self.finished = False
        # Drives that the operator ended to begin a new one. The caller removes and saves them.
        self.driven: deque[Record] = deque()
        self._is_first = True
        # Messages from pages with their times of arrival. The thread of the arm handles them.
        self._inbox: deque[tuple[ServerConnection, dict[str, Any], float]] = deque()
        self._answers: deque[tuple[ServerConnection, str]] = deque()
        self._ended = threading.Event()
        self._fresh = threading.Condition()
        # Compile everything before the thread of the drive starts its clock.
        self._pose: Pose = session.pose
        self._view: View = camera.see(session.time, self._pose.angles)
        self._operator: ServerConnection | None = None
        self._telling: threading.Thread | None = None
        self._stage = LiveStage(self._scene(self._pose))
        self._place = PrivateSocket()
        self._server = unix_serve(
            self._talk,
            str(self._place.path),
            process_request=self._page,
            compression=None,
            max_size=_LONGEST_MESSAGE,
        )
        try:
            sockets = {"": self._place.path, "view": self._stage.socket}
            self._gate = Gate(sockets, host=host, port=port)
        except BaseException:
            self._server.shutdown()
            self._place.close()
            self._stage.close()
            raise
        self.address, self.is_open = self._gate.address, self._gate.is_open
        self._threads = [
            threading.Thread(target=target, daemon=True)
            for target in (self._server.serve_forever, self._drive, self._draw)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def ended(self) -> bool:
        """Whether the drive was closed, was `finished` by the operator, or had an `error`."""
        return self._ended.is_set()

    def wait(self, seconds: float) -> bool:
        """Wait at most so many seconds for the end of the drive; return whether it has ended."""
        return self._ended.wait(seconds)

    def close(self) -> None:
        """End the drive."""
        self._ended.set()
        with self._fresh:
            self._fresh.notify_all()
        if self._telling is not None and self._telling.is_alive():
            self._telling.join(timeout=1)  # let the page receive the reason of the end
        self._gate.close()
        self._server.shutdown()
        self._place.close()
        for thread in self._threads:
            thread.join(timeout=5)
        self._stage.close()

    def _drive(self) -> None:
        """Advance the arm in real time until the drive ends."""
        interval = self.session.interval
        try:
            while not self._ended.is_set():
                self._take_in()
                pose = self.session.tick(time.monotonic(), most=_AT_ONCE)
                if pose.time == self._pose.time:
                    self._ended.wait(interval / 4)
                    continue
                view = self.camera.see(pose.time, pose.angles)
                with self._fresh:
                    self._pose, self._view = pose, view
                    self._fresh.notify_all()
        except InputError as error:
            self.error = str(error)
        except Exception as error:
            # Threads that wait for the drive must learn that it has ended.
            self.error, self.failure = f"the drive was aborted: {error!r}", error
        finally:
            self._ended.set()

    def _take_in(self) -> None:
        """Handle the new messages from the page that drives."""
        while self._inbox:
            connection, message, came = self._inbox.popleft()
            if connection is not self._operator:
                continue
            if message.get("type") == "end":
                self.finished = True
                self._ended.set()
                with self._fresh:
                    self._fresh.notify_all()
                return
            if message.get("type") == "restart":
                # A drive in which nothing was moved is the beginning of the next one.
                if not self.session.record.is_still:
                    self.driven.append(self.session.restart())
                    self._is_first = False
                continue
            try:
                self.session.receive(message, came)
            except InputError as error:
                self._answers.append((connection, str(error)))

    def _draw(self) -> None:
        drawn = -1.0
        while not self._ended.wait(1 / _DRAWN):
            pose = self._pose
            if pose.time != drawn and self._stage.watched:
                self._stage.draw(self._scene(pose))
                drawn = pose.time

    def _scene(self, pose: Pose) -> Scene:
        """Return the scene of the arm at a pose, without forces of the air."""
        model = self.session.record.model
        return arm_scene(at_rest(model.arm, jnp.asarray(pose.angles)), model.sensors.marker)

    def _page(self, _: "ServerConnection", request: "Request") -> "Response | None":
        """Answer a request for the page; return None for the path of the WebSocket."""
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        if request.path.rstrip("/") == "/pad":
            return None
        known = request.path.partition("?")[0] == "/"
        # The gate restricts the host that the page may connect to.
        body = with_policy(_PAGE.read_bytes(), connect="'self' ws:") if known else b"not here\n"
        status = HTTPStatus.OK if known else HTTPStatus.NOT_FOUND
        kind = "text/html; charset=utf-8" if known else "text/plain"
        fields = Headers({"Content-Type": kind, "Content-Length": str(len(body))})
        fields.update({"Cache-Control": "no-store", "Connection": "close"})
        return Response(status.value, status.phrase, fields, body)

    def _talk(self, connection: "ServerConnection") -> None:
        """Serve one page: send it poses, and receive the actions of the operator."""
        from websockets.exceptions import ConnectionClosed

        before, self._operator = self._operator, connection
        if before is not None:
            # The latest page drives, after a reload or in a second tab. The previous page is
            # dismissed in a thread, because its machine may no longer answer.
            threading.Thread(target=_dismiss, args=(before,), daemon=True).start()
        told = self._telling = threading.Thread(target=self._tell, args=(connection,), daemon=True)
        with suppress(ConnectionClosed, OSError):
            connection.send(json.dumps(self._facts()))
            told.start()
            for text in connection:
                self._heard(connection, text)
        if self._operator is connection:
            self._operator = None

    def _heard(self, connection: "ServerConnection", text: str | bytes) -> None:
        """Queue a message from a page, or queue an error if it is not a JSON object."""
        try:
            message = json.loads(text, parse_int=_whole)
        except (ValueError, RecursionError) as error:
            self._answers.append(
                (connection, f"a message from the page is not valid JSON: {error}")
            )
            return
        if isinstance(message, dict):
            self._inbox.append((connection, message, time.monotonic()))
        else:
            self._answers.append((connection, "a message from the page is not a JSON object"))

    def _tell(self, connection: "ServerConnection") -> None:
        from websockets.exceptions import ConnectionClosed

        told = -1.0
        with suppress(ConnectionClosed, OSError):
            while self._operator is connection and not self._ended.is_set():
                with self._fresh:
                    while self._pose.time == told and not self._ended.is_set():
                        self._fresh.wait(timeout=1.0)
                    pose, view = self._pose, self._view
                told = pose.time
                connection.send(json.dumps(self._words(pose, view)))
                while self._answers:
                    asked, answer = self._answers.popleft()
                    if asked is connection:
                        connection.send(json.dumps({"type": "error", "text": answer}))
                self._ended.wait(1 / _TOLD)
            if self._ended.is_set():
                still = self._is_first and self.session.record.is_still
                ended = UNMOVED if still else ENDED
                text = self.error or (ended if self.finished else "")
                connection.send(json.dumps({"type": "ended", "text": text}))

    def _facts(self) -> dict[str, Any]:
        """Return the facts that do not change during a drive."""
        mapping, scene = self.session.mapping, self._scene(self._pose)
        return {
            "type": "facts",
            "joints": self.session.operator.joints,
            "limit": round(float(np.rad2deg(mapping.largest_angle)), 6),
            "presets": list(mapping.presets),
            "gusts": self.session.can_gust,
            "compensation": self.session.can_compensate,
            "camera": self.camera.facts(),
            "latency": self.camera.latency,
            "blocks": [
                {
                    "centre": block.centre.tolist(),
                    "size": block.size.tolist(),
                    "axes": block.axes.T.tolist(),
                }
                for block in scene.blocks
            ],
        }

    def _words(self, pose: Pose, view: View) -> dict[str, Any]:
        """Return the message with the current pose of the arm."""
        return {
            "type": "pose",
            "time": round(pose.time, 3),
            "angles": np.rad2deg(pose.angles).round(3).tolist(),
            "command": np.rad2deg(pose.command).round(3).tolist(),
            "wind": pose.wind.round(3).tolist(),
            "gusts": self.session.gusty,
            "compensation": self.session.compensated,
            "stopped": pose.stopped,
            "ready": pose.stopped == NOT_YET,
            "bounds": self._stage.bounds.round(1).tolist(),
            "lost": round(pose.lost, 2),
            "centre": np.asarray(view.centre).tolist(),
            "axes": np.asarray(view.axes).T.tolist(),
        }


def _dismiss(connection: "ServerConnection") -> None:
    """Tell a page that it no longer drives, and close its connection."""
    from websockets.exceptions import ConnectionClosed

    with suppress(ConnectionClosed, OSError):
        connection.send(json.dumps({"type": "error", "text": TAKEN_OVER}))
        connection.close()


def _whole(digits: str) -> int | float:
    """Return an integer of a message, as a float if it is so long that it cannot be valid."""
    return int(digits) if len(digits) < 16 else float(digits)
