"""The clock of a page: what time it shows."""

import dataclasses

SPEEDS = ("1/4", "1/2", "1", "2", "4", "8", "16")
"""How much faster than real time a motion is played."""


@dataclasses.dataclass
class Player:
    """A time that runs while it is played.

    Attributes:
        first, last: times between which it runs, s.
        time: that is shown, s.
        playing: whether it runs.
        speed: how much faster than real time.
        again: whether it starts again at its end.
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
        """Let time pass.

        Arguments:
            elapsed: real time since the last tick, s.

        Returns:
            Whether another time is shown than before.
        """
        if not self.playing or self.last <= self.first:
            return False
        before = self.time
        self.time += elapsed * self.speed
        if self.time >= self.last:
            if self.again and before >= self.last:
                self.time = self.first
            else:
                # The end is shown for one tick at least.
                self.time = self.last
                self.playing = self.again
        return self.time != before

    def play(self) -> None:
        """Run; from the beginning where the end is shown."""
        self.playing = True
        if self.time >= self.last:
            self.time = self.first

    def seek(self, time: float) -> None:
        """Show a time, s."""
        self.time = min(max(time, self.first), self.last)


def factor(speed: str) -> float:
    """The number of one of `SPEEDS`."""
    above, _, below = speed.partition("/")
    return float(above) / float(below or 1)
