"""The time that a fit may take."""

import dataclasses
import time


@dataclasses.dataclass(frozen=True)
class Budget:
    """Wall time that a fit may take, all of its starts together.

    Attributes:
        seconds: how long, s.
        began: when it began to run, by `time.monotonic`, s.
    """

    seconds: float
    began: float = dataclasses.field(default_factory=time.monotonic)

    def left(self) -> float:
        """What is left of it, s; negative where it is overdrawn."""
        return self.seconds - (time.monotonic() - self.began)

    @property
    def ended_it(self) -> str:
        """Words for a message."""
        return f"the budget of {in_words(self.seconds)} ended the fit"


def in_words(seconds: float) -> str:
    """A time as a person says it: 45 s, 10 min, 1.5 h.

    Example:
        >>> in_words(600.0), in_words(5400.0)
        ('10 min', '1.5 h')
    """
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= length:
            return f"{seconds / length:.2g} {unit}"
    return f"{seconds:.2g} s"
