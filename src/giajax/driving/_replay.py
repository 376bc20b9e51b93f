"""A drive without an operator: what a pad did, from a file."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError
from .._limits import POSES
from .._typing import Float
from ..runs import read_numbers
from ._session import Session

# Between two rows of a file a page would have said that it is there.
_ALIVE = 0.2


def read_pad(path: str | Path) -> Mapping[str, Float[np.ndarray, " row"]]:
    """A table of what a pad did: `time_s`, `axis0`, `axis1`, ..., `button0`, ...

    It is read as a run is, by the same limits.

    Raises:
        InputError: there is no such file, or it is not such a table.
    """
    path = Path(path)
    columns = read_numbers(path)
    known = {name for name in columns if name.startswith(("axis", "button"))}
    if "time_s" not in columns or not any(name.startswith("axis") for name in known):
        raise InputError(f"{path} is of a pad without axes: give the columns time_s and axis0")
    odd = [name for name in columns if name != "time_s" and _place(name) is None]
    if odd:
        raise InputError(f"{path} has a column '{odd[0]}': name columns axis0 or button0")
    for name, column in columns.items():
        if not np.all(np.isfinite(column)):
            raise InputError(
                f"{path} has a cell in {name} that is empty or infinite: give it a number"
            )
    if np.any(np.diff(columns["time_s"]) <= 0):
        raise InputError(f"the times of {path} do not increase: sort its rows")
    return columns


def check_length(seconds: float, interval: float) -> None:
    """Refuse a drive that would fill the memory.

    Arguments:
        seconds: of the drive.
        interval: between two poses, s.

    Raises:
        InputError: naming the longest.
    """
    if not seconds <= POSES * interval:
        raise InputError(
            f"the drive is {seconds:g} s long, but may be {POSES * interval:g} s long at "
            f"{1 / interval:g} poses a second: shorten it, or take fewer poses"
        )


def replay(
    session: Session,
    pad: Mapping[str, Float[np.ndarray, " row"]],
    *,
    until: float | None = None,
    on_progress: Callable[[float, float], None] | None = None,
) -> None:
    """Drive an arm by what a pad did, as fast as it can be simulated.

    Arguments:
        session: of the arm.
        pad: as of `read_pad`; a row holds until the next one.
        until: end of the drive, s; the last row by default.
        on_progress: is called now and then with the time that was driven, and the whole, s.

    Raises:
        InputError: a drive that is too long.
    """
    times = pad["time_s"] - pad["time_s"][0]
    end = float(times[-1]) if until is None else until
    check_length(end, session.interval)
    rows, heard = 0, -np.inf
    while session.time + 0.5 * session.interval < end:
        now = session.time
        # All rows until now: the latest one holds, but each may press a button.
        while rows < len(times) and times[rows] <= now + 1e-9:
            session.receive(_message(pad, rows), now)
            rows, heard = rows + 1, now
        if now - heard > _ALIVE:
            session.receive({"type": "alive"}, now)
            heard = now
        session.advance(now + session.interval)
        if on_progress is not None:
            on_progress(session.time, end)


def _message(pad: Mapping[str, Float[np.ndarray, " row"]], row: int) -> dict[str, Any]:
    message: dict[str, Any] = {"type": "pad"}
    for kind, name in (("axis", "axes"), ("button", "buttons")):
        places = [place for column in pad if (place := _place(column, kind)) is not None]
        values = [0.0] * (max(places, default=-1) + 1)
        for place in places:
            values[place] = float(pad[f"{kind}{place}"][row])
        message[name] = values
    return message


def _place(column: str, kind: str | None = None) -> int | None:
    """Which axis or button a column is of; None where it is of none."""
    for prefix in ("axis", "button") if kind is None else (kind,):
        number = column.removeprefix(prefix)
        if column.startswith(prefix) and number.isdigit() and int(number) < 256:
            return int(number)
    return None
