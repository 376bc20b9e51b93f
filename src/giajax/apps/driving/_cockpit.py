"""The operator's page: a server for its messages, and the arm in the viewer's scene beside it."""

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
from ._session import Pose, Session

if TYPE_CHECKING:
    from websockets.http11 import Request, Response
    from websockets.sync.server import ServerConnection

LATENCY = 0.2
"""Default latency of the picture that the operator sees, s."""


class TipCamera:
    """The view of a camera on the arm, as an operator has it: late (s), and rolling with the arm.

    The arm's camera at the tip is taken, if it has one.
    """

    def __init__(self, model: ArmModel, latency: float = LATENCY) -> None:
        if not 0 <= latency <= 60:
            raise InputError(f"the latency is {latency:g} s: give a latency from 0 to 60 s")
        # Where the arm has none: one that looks ahead from its end, 90 deg wide.
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
        """What is shown at a time, s, in which the arm is at these angles, rad."""
        self._views.append((time, _view(self.camera, self._arm, jnp.asarray(angles))))
        while len(self._views) > 1 and self._views[1][0] <= time - self.latency + 1e-9:
            self._views.popleft()
        return self._views[0][1]

    def facts(self) -> dict[str, Any]:
        """What a page needs to draw its picture: focal length and centre (px), and size."""
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

# The page is told so many poses a second at most, and the scene is drawn so often.
_TOLD, _DRAWN = 60.0, 12.0

# Of intervals that are made up for at once: what an operator sees and does comes between them.
_AT_ONCE = 2

_LONGEST_MESSAGE = 1 << 16  # longer than anything that the page says
TAKEN_OVER = "another page has taken over"
UNMOVED = "the drive has ended: no joint was moved, and nothing is saved"
ENDED = "the drive has ended and is being saved: the terminal shows the location of the files"


class Cockpit:
    """Serves the page of a drive, and drives in step with the clock until it is closed.

    Three threads go their own ways, so that none waits for another: the arm advances, the page is
    told where it is, and the scene is drawn. Each takes the latest pose, and none is queued.

    Arguments:
        camera: of the picture at the tip.
        host, port: where to listen, as of `giajax.apps.viewer.Viewer`, and whoever has the
            `address`, drives.
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
        # What pages said, with the time at which it came; the arm's own thread takes it in.
        self._inbox: deque[tuple[ServerConnection, dict[str, Any], float]] = deque()
        self._answers: deque[tuple[ServerConnection, str]] = deque()
        self._ended = threading.Event()
        self._fresh = threading.Condition()
        # The clock of the drive begins with its thread, and everything is compiled by then.
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
        """Whether the drive is over: closed, `finished` by the operator, or by an `error`."""
        return self._ended.is_set()

    def wait(self, seconds: float) -> bool:
        """Until the drive is over, but no longer; whether it is."""
        return self._ended.wait(seconds)

    def close(self) -> None:
        """End the drive."""
        self._ended.set()
        with self._fresh:
            self._fresh.notify_all()
        if self._telling is not None and self._telling.is_alive():
            self._telling.join(timeout=1)  # the page learns how it ended
        self._gate.close()
        self._server.shutdown()
        self._place.close()
        for thread in self._threads:
            thread.join(timeout=5)
        self._stage.close()

    def _drive(self) -> None:
        """Advance the arm in step with the clock."""
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
            # Whoever waits for the drive must learn that nothing moves any more.
            self.error, self.failure = f"the drive was aborted: {error!r}", error
        finally:
            self._ended.set()

    def _take_in(self) -> None:
        """What came since: of the page that drives."""
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
        """The arm as it is; forces of the air on a still are none."""
        model = self.session.record.model
        return arm_scene(at_rest(model.arm, jnp.asarray(pose.angles)), model.sensors.marker)

    def _page(self, _: "ServerConnection", request: "Request") -> "Response | None":
        """The page itself; what is not asked for it is a WebSocket."""
        from websockets.datastructures import Headers
        from websockets.http11 import Response

        if request.path.rstrip("/") == "/pad":
            return None
        known = request.path.partition("?")[0] == "/"
        # To which host the page may connect, the gate says.
        body = with_policy(_PAGE.read_bytes(), connect="'self' ws:") if known else b"not here\n"
        status = HTTPStatus.OK if known else HTTPStatus.NOT_FOUND
        kind = "text/html; charset=utf-8" if known else "text/plain"
        fields = Headers({"Content-Type": kind, "Content-Length": str(len(body))})
        fields.update({"Cache-Control": "no-store", "Connection": "close"})
        return Response(status.value, status.phrase, fields, body)

    def _talk(self, connection: "ServerConnection") -> None:
        """One page: it is told where the arm is, and says what the operator does."""
        from websockets.exceptions import ConnectionClosed

        before, self._operator = self._operator, connection
        if before is not None:
            # A tab that was loaded again, or a second one: the latest drives. It does not wait for
            # the other, whose machine may be gone.
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
        """A message; what is none is answered."""
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
                ended = UNMOVED if self.session.record.is_still else ENDED
                text = self.error or (ended if self.finished else "")
                connection.send(json.dumps({"type": "ended", "text": text}))

    def _facts(self) -> dict[str, Any]:
        """What does not change."""
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
        """Where the arm is."""
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
    """Tell a page that it drives no longer."""
    from websockets.exceptions import ConnectionClosed

    with suppress(ConnectionClosed, OSError):
        connection.send(json.dumps({"type": "error", "text": TAKEN_OVER}))
        connection.close()


def _whole(digits: str) -> int | float:
    """An integer of a message; those of a thousand digits are neither a joint nor an angle."""
    return int(digits) if len(digits) < 16 else float(digits)
