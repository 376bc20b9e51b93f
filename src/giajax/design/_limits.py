"""What an experiment may do: which joints move, how far and how fast, and for how long."""

import dataclasses
import math

from .._errors import InputError
from .._limits import ANGLE_DEG

_MOST_ROWS = 100_000


@dataclasses.dataclass(frozen=True)
class Limits:
    """What the command of an experiment may do.

    Arguments:
        joints: numbers of the joints that move (1 is the base joint); the others hold 0.
        angle: largest size of a commanded angle, rad.
        rate: largest size of its rate, rad/s.
        duration: of the experiment, s.
        sampling: rows that are recorded, per second.

    Raises:
        InputError: a number that is not positive or too large, no joint, or a duration of no whole
            number of rows.
    """

    joints: tuple[int, ...] = (1,)
    angle: float = math.radians(30)
    rate: float = math.radians(30)
    duration: float = 25.0
    sampling: float = 10.0

    def __post_init__(self) -> None:
        for value, what in (
            (self.angle, "the largest angle"),
            (self.rate, "the largest rate"),
            (self.duration, "the duration"),
            (self.sampling, "the number of rows per second"),
        ):
            if not 0 < value < math.inf:
                raise InputError(f"{what} is {value:g}: give a positive number")
        if self.angle > math.radians(ANGLE_DEG):
            raise InputError(
                f"the largest angle is {math.degrees(self.angle):g} deg: give at most "
                f"{ANGLE_DEG:g} deg"
            )
        if not self.joints:
            raise InputError("no joint moves: give the number of at least one")
        if len(set(self.joints)) < len(self.joints):
            raise InputError("a joint is named twice: give each number once")
        rows = self.duration * self.sampling
        if rows > _MOST_ROWS:
            raise InputError(f"the experiment has {rows:g} rows: shorten it or sample less often")
        if self.rows < 2 or abs(rows - self.rows) > 1e-6 * rows:
            raise InputError(
                f"{self.duration:g} s at {self.sampling:g} rows per second is not a whole number "
                "of at least 2 rows: change one of them"
            )

    @property
    def rows(self) -> int:
        """Intervals between the rows of the experiment."""
        return round(self.duration * self.sampling)

    def check_joints(self, count: int) -> None:
        """Refuse joints that an arm of `count` joints does not have.

        Raises:
            InputError: naming the joint.
        """
        for joint in self.joints:
            if not 1 <= joint <= count:
                raise InputError(
                    f"joint {joint} is to move, but the arm has joints 1 to {count}: correct it"
                )
