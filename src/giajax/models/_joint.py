"""Model of the joint at rest: from angle, side and torque to contraction and force."""

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
    """Inputs of the joint in a run: bending angles, sides and torques.

    Bending angles of the muscle are in rad, sides are True for the inner muscle, and torques on
    the joint are in N m (None if the run does not record them).
    """

    angle: Float[Array, " sample"]
    inner: Bool[Array, " sample"]
    torque: Float[Array, " sample"] | None


class JointModel(AbstractModel):
    """Predicts `contraction` and `force` of one muscle of a joint.

    Arguments:
        joint: the joint; its parameters keep their own paths (`alpha.offset`, `geometry.anchor_x`).
    """

    kind: ClassVar[str] = "joint"

    joint: Joint = inline()

    @classmethod
    def for_runs(cls, runs: Sequence[Run]) -> Self:
        """Return the joint in the sidecars, which must agree.

        Raises:
            InputError: the sidecars disagree in [joint], or describe an impossible joint.
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
        """Return the joint that `definition()` described."""
        stored = Definition.parse({"joint": definition["joint"]}, "stored result")
        return cls(joint_from_section(stored))

    def definition(self) -> dict[str, Any]:
        """Return the `[joint]` section."""
        return {"joint": joint_to_section(self.joint)}

    def prepare(self, run: Run) -> JointInputs:
        """Return angles, sides and torques of a joint run."""
        if run.model != self.kind:
            raise InputError(
                f"'{run.name}' is a run of the {run.model} model: give a run of the joint model"
            )
        dtype = jnp.result_type(float)
        torque = run.values.get("torque")
        return JointInputs(
            angle=jnp.asarray(run.values["angle"], dtype=dtype),
            inner=jnp.asarray(np.asarray(run.values["side"] == "inner", dtype=bool)),
            torque=None if torque is None else jnp.asarray(torque, dtype=dtype),
        )

    def scene(self, run: Run) -> Scene:
        """Return balloons, muscle, wire and lettered points at the angles of the run."""
        inputs = self.prepare(run)
        return joint_scene(self.joint.geometry, inputs.angle, inputs.inner, times=run.times)

    def predict(self, inputs: JointInputs, channels: tuple[str, ...]) -> Prediction:
        """Return contraction and force (N) at the samples; fails for an impossible joint."""
        torque = self.joint.torque if inputs.torque is None else inputs.torque
        torque = jnp.broadcast_to(torque, inputs.angle.shape)
        state = balanced(self.joint, inputs.angle, torque, inputs.inner)
        known = {"contraction": state.contraction, "force": state.force}
        possible = is_possible(self.joint.geometry, inputs.angle, inputs.inner)
        predicted = {}
        for name in channels:
            if Channel.named(name).kind not in known:
                raise InputError(
                    f"'{name}' is not predicted by the joint model: use one of {', '.join(known)}"
                )
            # NaN makes a fit reject a step to an impossible joint.
            predicted[name] = jnp.where(possible, known[name], jnp.nan)
        return predicted, jnp.all(possible)

    def failure(self, inputs: JointInputs) -> str:
        """Return the reason why the geometry is impossible."""
        try:
            check_geometry(self.joint.geometry, np.asarray(inputs.angle))
        except InputError as error:
            return str(error)
        return "the force of the joint is not finite: choose another geometry or torque"

    def refined(self, factor: float) -> Self:
        """Return the same model, because it is in closed form."""
        return self

    def conditions(self, free: Sequence[str], runs: Sequence[Run] = ()) -> list[str]:
        """Return sentences on the geometry and torque that alpha and beta depend on."""
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
                f"{', '.join(corrections)}: the correction of the torque is valid for the "
                f"fixed values {shown}"
            )
        if "torque" not in free and any(
            run.model == self.kind and "torque" not in run.values for run in runs
        ):
            sentences.append(
                f"{', '.join(corrections)}: determined for the assumed torque of "
                f"{float(self.joint.torque):.4g} N m, because the run does not record the torque"
            )
        return sentences


def joint_from_section(definition: Definition) -> Joint:
    """Return the joint of the `[joint]` section; missing keys have the values of the preset."""
    section = definition.section(JointSection)
    correction = Correction(
        reading=section.correction or "continuous", blend=np.deg2rad(section.blend_deg or 0.0)
    )
    return replace(Joint(correction=correction), section.values())


def joint_to_section(joint: Joint) -> dict[str, Any]:
    """Return the complete `[joint]` section of a joint."""
    return {
        "correction": joint.correction.reading,
        "blend_deg": float(np.rad2deg(joint.correction.blend)),
        **JointSection.keys_of(parameter_values(joint)),
    }
