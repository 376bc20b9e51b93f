"""One scene of a single sample that is drawn anew all the time."""

from pathlib import Path

from ..models import Scene
from ._arrangement import stages
from ._backend import Backend
from ._show import Show


class LiveStage:
    """A page of viser with an arm that somebody else moves.

    Arguments:
        scene: of one sample.

    Raises:
        InputError: viser is not installed.
    """

    def __init__(self, scene: Scene) -> None:
        self._backend = Backend()
        self._server = self._backend.server
        (self._stage,) = stages(self._server, [Show("arm", scene)])
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.gui.main_panel.minimize()

    @property
    def socket(self) -> Path:
        """Where it listens."""
        return self._backend.socket

    @property
    def watched(self) -> bool:
        """Whether a browser shows it."""
        return bool(self._server.get_clients())

    def draw(self, scene: Scene) -> None:
        """Show another scene of the same parts."""
        with self._server.atomic():
            self._stage.show = Show("arm", scene)
            self._stage.draw(0)

    def close(self) -> None:
        """End the page."""
        self._backend.close()
