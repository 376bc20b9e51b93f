"""The one error that a person's input can cause."""


class InputError(ValueError):
    """The input cannot be used.

    The message is one sentence: what is wrong and, after a colon, what to do. The command
    line prints it without a traceback and ends with exit status 2.
    """
