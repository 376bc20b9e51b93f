"""The one error that a person's input can cause."""

from ._text import abridged


class InputError(ValueError):
    """The input cannot be used.

    The message is one sentence: what is wrong and, after a colon, what to do. The command
    line prints it without a traceback and ends with exit status 2. What it repeats of the input is
    cut where it is endless.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(abridged(sentence))
