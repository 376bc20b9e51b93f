"""An arm that is driven: commands from an operator, steps in time with a clock, and a record."""

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._limits import STEPS
from .._typing import Float
from ..models import ArmModel
from ..parameters import replace
from ..simulation import Moment, Stepper
from ..synthetic import Drive
from ._compensation import Compensation
from ._mapping import PadMapping
from ._operator import Operator
from ._pose import Pose
from ._record import Record

RATE = 30.0
"""Poses a second."""

# Of simulated time that is made up for at once; what is beyond it is lost, and said.
_BEHIND = 1.0

_WIND = ("wind_x", "wind_y", "wind_z")

# The strengths of what joints remember, by the names of their parameters.
_MEMORY = ("joints.memory.strength", "joints.stops.strength")


class Session:
    """One drive of an arm, from the straight arm at rest.

    Time is that of the caller: `tick` takes the clock, and advances the arm by as many intervals
    as have passed. A message holds from the next interval on.

    Arguments:
        model: of the arm, with the sensors that the record is seen by.
        mapping: what the pad does; `PadMapping.usual` by default.
        rate: poses a second.
        steps: of the integrator in each.
        gusts: wind over time, one for the whole arm; repeated at its end. None: still air.
        compensation: makes commands of wanted angles.
        memory: whether joints remember; the arm without its hysteresis where not.

    Raises:
        InputError: a rate or steps out of bounds, gusts from link to link, or no memory to leave.
    """

    def __init__(
        self,
        model: ArmModel,
        mapping: PadMapping | None = None,
        *,
        rate: float = RATE,
        steps: int = 1,
        gusts: Drive | None = None,
        compensation: Compensation | None = None,
        memory: bool = True,
    ) -> None:
        if not 1 <= rate <= 1000:
            raise InputError(f"the rate is {rate:g} poses a second: give one from 1 to 1000")
        if not 1 <= steps <= STEPS:
            raise InputError(f"there are {steps:,} steps in a pose: give from 1 to {STEPS:,}")
        if gusts is not None and set(gusts.values) != set(_WIND):
            raise InputError("gusts of a drive are one wind for the whole arm: give x, y and z")
        arm = model.arm
        if not memory:
            arm = replace(arm, dict.fromkeys(_remembered(model), 0.0))
        self.model = model
        self.mapping = PadMapping.usual(arm.count) if mapping is None else mapping
        self.operator = Operator(self.mapping, arm.count)
        self.interval = 1.0 / rate
        self.gusty = gusts is not None
        self.compensated = compensation is not None
        self.lost = 0.0
        self.record = Record(ArmModel(arm, sensors=model.sensors))
        self._gusts = gusts
        self._compensation = compensation
        self._stepper = Stepper(arm, jnp.asarray(self.interval), steps)
        self._wind = self._wind_at(0.0)
        self._moment: Moment = self._stepper.start(wind=self._wind)
        # Compiled before the clock runs.
        self._stepper.advance(self._moment, self._moment.command, jnp.asarray(self._wind))
        self._count = 0
        self._began: float | None = None
        self._add()

    @property
    def time(self) -> float:
        """That was driven, s."""
        return self._count * self.interval

    @property
    def moment(self) -> Moment:
        """The state of the arm."""
        return self._moment

    @property
    def can_gust(self) -> bool:
        """Whether there are gusts to switch on."""
        return self._gusts is not None

    @property
    def can_compensate(self) -> bool:
        """Whether there is a compensation to switch on."""
        return self._compensation is not None

    def receive(self, message: Mapping[str, Any], now: float) -> None:
        """One message of a page: of `Operator.receive`, or a switch.

        Arguments:
            message: beside those of the operator `{"type": "gusts", "on": true}` and
                `{"type": "compensation", "on": true}`.
            now: time of the clock, s.

        Raises:
            InputError: a message that says nothing of these kinds; the drive goes on.
        """
        kind = message.get("type")
        if kind == "gusts":
            self.gusty = bool(message.get("on")) and self.can_gust
        elif kind == "compensation":
            self.compensated = bool(message.get("on")) and self.can_compensate
        else:
            self.operator.receive(message, now)

    def tick(self, now: float, most: int | None = None) -> Pose:
        """Advance to the time of the clock, and say where the arm is.

        Arguments:
            now: time of the clock, s.
            most: intervals at once; all that are missing by default.
        """
        if self._began is None:
            self._began = now - self.time
        behind = now - self._began - self.time
        if behind > _BEHIND + self.interval:
            # The clock is moved on: what an operator sees must not race after it.
            late = behind - self.interval
            self.lost += late
            self._began += late
        # A hair less than an interval is one: clocks are added up.
        missing = int((now - self._began - self.time) / self.interval + 1e-6)
        for _ in range(missing if most is None else min(missing, most)):
            # By the clock: an arm that is behind stops no later.
            self.advance(now)
        return self.pose

    def advance(self, now: float) -> None:
        """One interval; `now` is the time of the clock, by which a page is silent, s."""
        wanted = self.operator.advance(now, self.interval)
        command = wanted
        if self._compensation is not None:
            # It goes on to remember while it is switched off.
            compensated = self._compensation(wanted)
            command = compensated if self.compensated else wanted
        self._count += 1
        self._wind = self._wind_at(self.time)
        self._moment = self._stepper.advance(
            self._moment, jnp.asarray(command), jnp.asarray(self._wind)
        )
        self._add()

    @property
    def pose(self) -> Pose:
        """Where the arm is."""
        angles = np.asarray(self._moment.angles)
        command = np.asarray(self._moment.command)
        why = self.operator.stopped
        return Pose(self.time, angles, command, self._wind, why, self.lost)

    def _wind_at(self, time: float) -> Float[np.ndarray, "3"]:
        if self._gusts is None or not self.gusty:
            return np.zeros(3)
        first, last = self._gusts.times[[0, -1]]
        at = self._gusts.at(np.array([first + time % (last - first)]))
        return np.array([float(at[name][0]) for name in _WIND])

    def _add(self) -> None:
        state = np.asarray(self._moment.state[:2])
        if not np.all(np.isfinite(state)):
            raise InputError(
                f"the arm became infinite or NaN at {self.time:.2f} s: check its parameters, or "
                "take more steps"
            )
        self.record.add(self.time, np.asarray(self._moment.command), state, self._wind)


def _remembered(model: ArmModel) -> list[str]:
    """Paths of the strengths of what joints remember."""
    hysteresis = model.arm.joints.hysteresis
    there = [hysteresis.memory.rows > 0, hysteresis.stops.rows > 0]
    paths = [path for path, has in zip(_MEMORY, there, strict=True) if has]
    if not paths:
        raise InputError("the joints of this arm remember nothing: there is nothing to leave out")
    return paths
