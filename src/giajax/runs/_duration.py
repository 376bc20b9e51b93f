"""Times as a person writes them: 90s, 10m, 2h."""

DURATION = r"^[0-9]{1,9}(\.[0-9]{1,9})?[smh]$"
"""What such a time looks like; a number without a unit is none."""

_SECONDS = {"s": 1.0, "m": 60.0, "h": 3600.0}


def seconds_of(duration: str) -> float:
    """A time in seconds.

    Arguments:
        duration: what `DURATION` matches.

    Example:
        >>> seconds_of("1.5h")
        5400.0
    """
    return float(duration[:-1]) * _SECONDS[duration[-1]]
