"""The time that a fit may take."""

import dataclasses
import time

from .._text import time_in_words


@dataclasses.dataclass(frozen=True)
class Budget:
    """Wall time that a fit may take, all of its starts together.

    Attributes:
        seconds: how long, s.
        began: when it began to run, by `time.monotonic`, s.
    """

    seconds: float
    began: float = dataclasses.field(default_factory=lambda: time.monotonic())

    def left(self) -> float:
        """What is left of it, s; negative where it is overdrawn."""
        return self.seconds - (time.monotonic() - self.began)

    @property
    def ended_it(self) -> str:
        """Words for a message."""
        return f"the budget of {time_in_words(self.seconds)} ended the fit"
