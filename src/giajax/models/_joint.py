"""The joint at rest as a model: from angle, side and torque to contraction and force."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..mechanics.joint import Correction, Joint, balanced, check_geometry, is_possible
from ..recordings import Channel, Definition, Run
from ..runtime.arrays import Array, Bool, Float
from ..runtime.text import InputError
from ..schema import JointSection
from ..schema.parameters import get, inline, replace
from ._arm_definition import check_agreement
from ._protocol import AbstractModel, Prediction, Scene, parameter_values
from ._scenes import joint_scene


class JointInputs(eqx.Module):
    """What the joint needs of a run: bending angles of the muscle (rad), whether it is the inner
    one, and torques on the joint (N m; None where the run does not record it).
    """

    angle: Float[Array, " sample"]
    inner: Bool[Array, " sample"]
    torque: Float[Array, " sample"] | None


class JointModel(AbstractModel):
    """Predicts `contraction` and `force` of one muscle of a joint.

    Arguments:
        joint: its parameters keep their own paths (`alpha.offset`, `geometry.anchor_x`).
    """

    kind: ClassVar[str] = "joint"

    joint: Joint = inline()

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """The joint that the sidecars state, which must agree.

        Raises:
            InputError: the sidecars disagree in [joint], or state an impossible joint.
        """
        joint = joint_from_section(runs[0].definition)
        section = joint_to_section(joint)
        for other in runs[1:]:
            theirs = joint_to_section(joint_from_section(other.definition))
            check_agreement("joint", (runs[0], section), (other, theirs))
        for run in runs:
            check_geometry(joint.geometry, run.values.get("angle"))
        return cls(joint)

    @classmethod
    def from_definition(cls, definition: Mapping[str, Any]) -> Self:
        """The joint that `definition()` described."""
        stored = Definition.parse({"joint": definition["joint"]}, "stored result")
        return cls(joint_from_section(stored))

    def definition(self) -> dict[str, Any]:
        """The `[joint]` section."""
        return {"joint": joint_to_section(self.joint)}

    def prepare(self, run: Run) -> JointInputs:
        """Angles, sides and torques of a joint run."""
        if run.model != self.kind:
            raise InputError(
                f"'{run.name}' is a run of the {run.model} model: give a run of a joint"
            )
        dtype = jnp.result_type(float)
        torque = run.values.get("torque")
        return JointInputs(
            angle=jnp.asarray(run.values["angle"], dtype=dtype),
            inner=jnp.asarray(np.asarray(run.values["side"] == "inner", dtype=bool)),
            torque=None if torque is None else jnp.asarray(torque, dtype=dtype),
        )

    def scene(self, run: Run) -> Scene:
        """Balloons, muscle, wire and lettered points at the angles of the run."""
        inputs = self.prepare(run)
        return joint_scene(self.joint.geometry, inputs.angle, inputs.inner, times=run.times)

    def predict(self, inputs: JointInputs, channels: tuple[str, ...]) -> Prediction:
        """Contraction and force (N) at the samples; fails where the joint cannot be built."""
        torque = self.joint.torque if inputs.torque is None else inputs.torque
        torque = jnp.broadcast_to(torque, inputs.angle.shape)
        state = balanced(self.joint, inputs.angle, torque, inputs.inner)
        known = {"contraction": state.contraction, "force": state.force}
        possible = is_possible(self.joint.geometry, inputs.angle, inputs.inner)
        predicted = {}
        for name in channels:
            if Channel.named(name).kind not in known:
                raise InputError(
                    f"'{name}' is not predicted by the joint model: use one of: {', '.join(known)}"
                )
            # NaN makes a fit reject a step into a joint that cannot be built.
            predicted[name] = jnp.where(possible, known[name], jnp.nan)
        return predicted, jnp.all(possible)

    def failure(self, inputs: JointInputs) -> str:
        """What is impossible about the geometry."""
        try:
            check_geometry(self.joint.geometry, np.asarray(inputs.angle))
        except InputError as error:
            return str(error)
        return "the force of the joint is not finite: choose another geometry or torque"

    def refined(self, factor: float) -> Self:
        """The same: it is in closed form."""
        return self

    def conditions(self, free: Sequence[str], runs: Sequence[Run] = ()) -> list[str]:
        """That alpha and beta are what the geometry and the torque leave over."""
        sentences = []
        if any(path.startswith("geometry.") for path in free):
            try:
                check_geometry(self.joint.geometry)
            except InputError as error:
                sentences.append(f"geometry: {error}")
        corrections = [path for path in free if path.startswith(("alpha.", "beta."))]
        if not corrections:
            return sentences
        names = ("anchor_x", "anchor_y", "contact_x", "contact_y", "wire_length")
        held = [path for name in names if (path := f"geometry.{name}") not in free]
        if held:
            shown = ", ".join(f"{path} = {float(get(self, path)):.4g} m" for path in held)
            sentences.append(
                f"{', '.join(corrections)}: correction of the torque for this geometry, which is "
                f"held at "
                f"{shown}"
            )
        if "torque" not in free and any(
            run.model == self.kind and "torque" not in run.values for run in runs
        ):
            sentences.append(
                f"{', '.join(corrections)}: determined for the assumed torque of "
                f"{float(self.joint.torque):.4g} N m, "
                "which the run does not record"
            )
        return sentences


def joint_from_section(definition: Definition) -> Joint:
    """The joint that the `[joint]` section states; what it does not state is the preset's."""
    section = definition.section(JointSection)
    correction = Correction(
        reading=section.correction or "continuous", blend=np.deg2rad(section.blend_deg or 0.0)
    )
    return replace(Joint(correction=correction), section.values())


def joint_to_section(joint: Joint) -> dict[str, Any]:
    """The `[joint]` section of a joint, whole."""
    return {
        "correction": joint.correction.reading,
        "blend_deg": float(np.rad2deg(joint.correction.blend)),
        **JointSection.keys_of(parameter_values(joint)),
    }
