"""A mission: an arm, who drives it, an opening to go through, and what came of it."""

import dataclasses
from typing import Self

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Float
from ..kinds import MissionSection
from ..models import (
    ArmModel,
    Pinhole,
    arm_from_definition,
    parameter_values,
    sensors_from_definition,
)
from ..parameters import replace
from ..runs import Definition
from ._air import air
from ._flight import Task, flight
from ._opening import Opening, opening_of
from ._operator import Operator
from ._outcome import Outcome, outcome_of

# Between two decisions of an operator, s, and the tolerance of the motion.
_INTERVAL, _TOLERANCE = 0.1, 1e-3


@dataclasses.dataclass(frozen=True)
class Mission:
    """An arm that an operator is to bring through an opening.

    Attributes:
        model: of the arm, with its obstacles and its cameras.
        section: what its file says.
        opening: to go through.
        camera: at the arm's tip.
        operator: who drives.
    """

    model: ArmModel
    section: MissionSection
    opening: Opening
    camera: Pinhole
    operator: Operator

    @classmethod
    def from_definition(cls, definition: Definition, source: str = "the file") -> Self:
        """The mission of a file.

        Arguments:
            definition: what is in it.
            source: what errors call it.

        Raises:
            InputError: it has no `[mission]`, no opening, or no camera at the tip of its arm.
        """
        section = definition.mission
        if section is None:
            raise InputError(f"{source} has no [mission]: add one (giajax mission --help shows it)")
        arm, sensors = arm_from_definition(definition), sensors_from_definition(definition)
        opening = opening_of(arm, section.opening)
        lenses = {
            name: lens for name, lens in sensors.camera.pinholes.items() if lens.mount == "tip"
        }
        name = section.camera
        if name is None and len(lenses) != 1:
            many = f"{len(lenses)} cameras" if lenses else "no camera"
            raise InputError(
                f'there is {many} at the tip: give one [camera.NAME] with mount = "tip", or say '
                "which by mission.camera"
            )
        if name is not None and name not in lenses:
            raise InputError(f"mission.camera = '{name}' is no camera at the tip: correct it")
        camera = next(iter(lenses.values())) if name is None else lenses[name]
        model = ArmModel(arm, sensors=sensors)
        return cls(model, section, opening, camera, Operator.from_section(section, arm.count))

    def case(self, seed: int) -> Self:
        """The mission with another arm: parameters of `[mission.spread]`, drawn.

        Raises:
            InputError: a parameter that the arm does not have.
        """
        spread = self.section.spread or {}
        values = parameter_values(self.model)
        unknown = next((path for path in spread if path not in values), None)
        if unknown is not None:
            raise InputError(f"mission.spread has '{unknown}', which is no parameter of this arm")
        random = np.random.default_rng([seed, 1])
        drawn = {
            path: np.asarray(values[path]) * np.exp(deviation * random.normal())
            for path, deviation in spread.items()
        }
        return dataclasses.replace(self, model=replace(self.model, drawn))

    def with_model(self, model: ArmModel) -> Self:
        """The mission with other parameters of its arm and its sensors."""
        return dataclasses.replace(self, model=model)

    def in_wind(self, speed: float) -> Self:
        """The mission in air of another speed, m/s."""
        wind = self.section.wind.model_copy(update={"speed_m_per_s": speed})
        return dataclasses.replace(self, section=self.section.model_copy(update={"wind": wind}))

    def wind(self, seed: int) -> Float[np.ndarray, "row width"]:
        """Velocity of the air at the links over time, m/s."""
        return air(self.section, self.model.arm, self.times, [seed, 2])

    @property
    def times(self) -> Float[np.ndarray, " row"]:
        """Of the decisions, s."""
        return np.arange(round(self.section.limit_s / _INTERVAL) + 1) * _INTERVAL

    def fly(self, seed: int = 0, *, drawn: "Mission | None" = None) -> Outcome:
        """The mission, once.

        Arguments:
            seed: of the air, and of what the operator sees wrong.
            drawn: the mission whose arm the operator takes this one's for; itself by default.

        Raises:
            InputError: a file that is not consistent.
        """
        section, arm = self.section, self.model.arm
        wind = self.wind(seed)
        random = np.random.default_rng([seed, 3])
        error = section.operator.pixel_px * random.normal(size=(len(wind) - 1, 4, 2))
        numbers = (section.beyond_m, section.hold_s, _INTERVAL, _TOLERANCE)
        rows = flight(
            arm,
            (self if drawn is None else drawn).model.arm,
            self.camera,
            self.operator,
            Task(self.opening, *map(jnp.asarray, numbers)),
            jnp.asarray(wind),
            jnp.asarray(error),
            late=round(section.operator.latency_s / _INTERVAL),
        )
        return outcome_of(self, rows, wind)
