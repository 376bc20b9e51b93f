"""The one error that a person's input can cause."""


class InputError(ValueError):
    """What was given cannot be used.

    The message is one sentence: what was given, what it must be, what to do next. The command
    line prints it without a traceback and ends with exit status 2.
    """
