"""Model of a muscle: from pressure and contraction to force."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp

from ..mechanics.joint import MUSCLE_LAWS, AbstractMuscle, BraidedMuscle, Friction, Piston
from ..recordings import Channel, Definition, Run
from ..runtime.arrays import Array, Float, Scalar
from ..runtime.text import InputError
from ..schema import AT_REST, MuscleSection, si_factor
from ..schema.parameters import declared, get, parameter, replace
from ._arm_definition import check_agreement
from ._protocol import AbstractModel, Prediction, parameter_values

_DIRECTION = {"fill": -1.0, "exhaust": 1.0}


class MuscleInputs(eqx.Module):
    """Inputs of a muscle in a run.

    Attributes:
        pressure: pressures, Pa.
        contraction: contraction relative to the length at rest; None if it is not recorded.
        position: displacement, m; None if it is not recorded.
        direction: +1 if the muscle is moved against its force (exhausting), -1 if it moves by
            itself (filling); None without friction, or if it follows from the displacement.
    """

    pressure: Float[Array, " sample"]
    contraction: Float[Array, " sample"] | None
    position: Float[Array, " sample"] | None
    direction: Float[Array, " sample"] | None


_PASCAL = si_factor("pressure", "kPa")


class MuscleModel(AbstractModel):
    """Predicts the `force` of a muscle or a cylinder.

    Arguments:
        muscle: force law without friction.
        friction: friction law; None without friction.
        length: length at rest, m.
        mean_pressure: True to replace the pressure by its mean over the run. This is the set
            pressure if friction affects the gauge.
    """

    kind: ClassVar[str] = "muscle"

    muscle: AbstractMuscle = eqx.field(default_factory=BraidedMuscle)
    friction: Friction | None = None
    length: Scalar = parameter(AT_REST.length)
    mean_pressure: bool = eqx.field(default=False, static=True)

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """Return the muscle in the sidecars, which must agree.

        Raises:
            InputError: the sidecars disagree in [muscle], or set a parameter that the law lacks.
        """
        first, *others = runs
        section = first.definition.section(MuscleSection)
        for other in others:
            theirs = other.definition.section(MuscleSection)
            check_agreement("muscle", (first, section.contents()), (other, theirs.contents()))
        return cls.from_section(section)

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """Return the muscle that `definition()` described."""
        stored = Definition.parse({"muscle": definition["muscle"]}, "stored result")
        return cls.from_section(stored.section(MuscleSection))

    @classmethod
    def from_section(cls, section: MuscleSection) -> Self:
        """Return the muscle of a `[muscle]` section.

        Raises:
            InputError: the section sets a parameter that the law lacks, or contradicts itself.
        """
        law = MUSCLE_LAWS[section.law or BraidedMuscle.name]
        rubs = section.friction or ("coulomb" if law is Piston else "none")
        if rubs == "none" and section.friction_pressures_kPa is not None:
            raise InputError(
                "[muscle] sets friction_pressures_kPa, but no friction: remove this key, or set "
                'friction = "coulomb"'
            )
        nodes = tuple(p * _PASCAL for p in section.friction_pressures_kPa or [0.0])
        model = cls(
            muscle=law(),
            friction=None if rubs == "none" else Friction.at_pressures(nodes),
            mean_pressure=section.pressure == "mean",
        )
        values, known = section.values(), declared(model)
        for path in values:
            if path not in known:
                raise InputError(
                    f"[muscle] sets {path.removeprefix('muscle.')}, but the law '{law.name}' does "
                    "not have it: remove this key, or choose another law"
                )
        return replace(model, values)

    def definition(self) -> dict[str, Any]:
        """Return the `[muscle]` section."""
        section: dict[str, Any] = {
            "law": self.muscle.name,
            "pressure": "mean" if self.mean_pressure else "measured",
            "friction": "none" if self.friction is None else "coulomb",
            **MuscleSection.keys_of(parameter_values(self)),
        }
        if self.friction is not None:
            section["friction_pressures_kPa"] = [p / _PASCAL for p in self.friction.pressures]
        return {"muscle": section}

    def prepare(self, run: Run) -> MuscleInputs:
        """Return pressure, displacement and direction of a muscle run."""
        if run.model != self.kind:
            raise InputError(
                f"'{run.name}' is a run of the {run.model} model: give a run of the muscle model"
            )
        dtype = jnp.result_type(float)

        def column(name: str) -> Array | None:
            values = run.values.get(name)
            return None if values is None else jnp.asarray(values, dtype=dtype)

        pressure = column("pressure")
        if pressure is None:
            raise InputError(f"'{run.name}' has no pressure: add a column such as pressure_kPa")
        phase = None if self.friction is None else run.values.get("phase")
        direction = None if phase is None else [_DIRECTION[text] for text in phase]
        return MuscleInputs(
            pressure=jnp.full_like(pressure, jnp.mean(pressure))
            if self.mean_pressure
            else pressure,
            contraction=column("contraction"),
            position=column("position"),
            direction=None if direction is None else jnp.asarray(direction, dtype=dtype),
        )

    def predict(self, inputs: MuscleInputs, channels: tuple[str, ...]) -> Prediction:
        """Return the force, N, at the samples."""
        for name in channels:
            if Channel.named(name).kind != "force":
                raise InputError(f"'{name}' is not predicted by the muscle model: use force")
        # Compute contraction or displacement from the other one if it is not recorded.
        contraction, position = inputs.contraction, inputs.position
        if contraction is None:
            still = jnp.zeros_like(inputs.pressure)
            contraction = still if position is None else position / self.length
        if position is None:
            position = contraction * self.length
        force = self.muscle.force(inputs.pressure, contraction, self.length)
        if self.friction is not None:
            share = inputs.direction
            if share is None:
                # Friction reduces the force of a muscle that moves by itself.
                share = -self.muscle.own_motion * self.friction.engagement(position)
            force = force + self.friction.width(inputs.pressure) * share
        return dict.fromkeys(channels, force), jnp.all(jnp.isfinite(force))

    def failure(self, inputs: MuscleInputs) -> str:
        """Return the message that the force is not finite."""
        return "the force of the muscle is not finite: choose other start values"

    def refined(self, factor: float) -> Self:
        """Return the same model, because it is in closed form."""
        return self

    def conditions(self, free: Sequence[str], runs: Sequence[Run] = ()) -> list[str]:
        """Return sentences on the held parameters to which fitted ones refer."""
        referred = {
            "muscle.effectiveness": ("muscle.diameter", "muscle.braid_angle"),
            "muscle.force_limit": ("muscle.end_length", "muscle.length_scale", "length"),
            "muscle.contraction_limit": ("muscle.pressure_limit",),
        }
        sentences = []
        for path, others in referred.items():
            held = [other for other in others if other not in free]
            if path in free and held:
                shown = ", ".join(f"{other} = {float(get(self, other)):.4g}" for other in held)
                sentences.append(f"{path}: valid for {shown} (SI)")
        return sentences
