"""How long a fit may still take, from the steps so far."""

import dataclasses
import statistics
import time

from .._text import time_in_words

# Who waits for less needs no word about it; a word a minute is enough for the others.
_WORTH_A_WORD_S = 30.0
_BETWEEN_WORDS_S = 60.0

# Steps that must have been timed: the first one compiles.
_LEAST = 2


@dataclasses.dataclass
class TimeLeft:
    """Says now and then how long a fit may still take.

    Nobody knows how many steps are left until an optimum: what is said is how long it takes at
    most, or with several starts, how long at the pace of those before.

    Attributes:
        most: trial steps that a fit may take.
        starts: how many starts there are.
        budget_s: wall time that the fit may take; None for no end.
    """

    most: int
    starts: int = 1
    budget_s: float | None = None

    def __post_init__(self) -> None:
        self._began = self._before = time.monotonic()
        self._said = -float("inf")
        self._steps: list[float] = []
        self._begun: list[float] = []

    def start(self) -> None:
        """One of several starts begins now."""
        self._before = time.monotonic()
        self._begun.append(self._before)

    def after(self, number: int) -> str | None:
        """What to say after a step, if anything.

        Arguments:
            number: of the step, 0 for the evaluation of the start.
        """
        now = time.monotonic()
        taken, self._before = now - self._before, now
        if number > 0:
            self._steps.append(taken)
        if len(self._steps) < _LEAST or now - self._said < _BETWEEN_WORDS_S:
            return None
        seconds, sentence = self._estimate(number, now)
        if self.budget_s is not None and self.budget_s - (now - self._began) < seconds:
            seconds = max(self.budget_s - (now - self._began), 0.0)
            sentence = "at most {left} left: then its budget ends the fit"
        if seconds < _WORTH_A_WORD_S:
            return None
        self._said = now
        return sentence.format(left=time_in_words(seconds))

    def _estimate(self, number: int, now: float) -> tuple[float, str]:
        """Seconds, and a sentence for them."""
        if len(self._begun) > 1:
            each = (self._begun[-1] - self._begun[0]) / (len(self._begun) - 1)
            whole = each * (self.starts - len(self._begun) + 1)
            sentence = f"about {{left}} left for the starts up to {self.starts}, at the pace of "
            sentence += "those before"
            return max(whole - (now - self._begun[-1]), 0.0), sentence
        steps = self.most - number + self.most * (self.starts - 1)
        each = statistics.median(self._steps)
        sentence = f"at most {{left}} left: {steps} steps of {time_in_words(each)}, of which most "
        return steps * each, sentence + "fits need few"
