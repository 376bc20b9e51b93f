"""What disturbs an arm, and the steps that derivatives by a disturbance need.

A step-size controller sees the errors of the motion, not those of its derivatives. An arm at rest
has no error at all, and one that moves in a plane has none across it: the steps then grow until
they are unstable for what a derivative sets swinging there, by a wind across or a first angle.
Derivatives by the other parameters of links, joints and air are safe, because those parameters
move only what moves already.

Which steps are taken is the caller's choice, not a consequence of being differentiated, so that a
simulation has the same value with and without its derivatives.
"""

from operator import attrgetter
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp

from .._errors import InputError
from .._typing import Array, Scalar
from ..arm import Arm
from ..quantities import ALPHA, BETA, BRAIDED, DRIVE, GEOMETRY, LOAD

StepsFor = Literal["motion", "derivatives"]

STEPS_FOR = ("motion", "derivatives")
"""What the steps of a simulation are short enough for."""

# Of an arm, beside the inputs and the initial state of every simulation.
_PARAMETERS = ("base_rotation", "gravity", "air.wind", "buoyancy", "point_masses", "pneumatics")

# Of the muscles, whose parameters have no common name: where pressures hold a joint, each of them
# moves it.
_MUSCLES = tuple(
    sorted(
        {
            q.path.partition(".")[0]
            for group in (GEOMETRY, LOAD, ALPHA, BETA, BRAIDED, DRIVE)
            for q in group
        }
    )
)

_REFUSAL = (
    "a simulation with steps_for='motion' was differentiated by a disturbance (command, wind, "
    f"torque, initial state, {', '.join(_PARAMETERS)}), for which its steps may be too long: "
    "call simulate with steps_for='derivatives', or the model's for_derivatives"
)


def is_disturbance(path: str) -> bool:
    """Whether a parameter of an arm may set moving what is at rest.

    Arguments:
        path: of the parameter or of one element of it, such as `air.wind[0]`.

    Returns:
        True for a disturbance, by which only `steps_for="derivatives"` may be differentiated.
    """
    name = path.partition("[")[0]
    return any(name == known or name.startswith(f"{known}.") for known in (*_PARAMETERS, *_MUSCLES))


def check_steps_for(steps_for: str) -> None:
    """Refuse an unknown choice of steps.

    Arguments:
        steps_for: the choice.

    Raises:
        InputError: neither "motion" nor "derivatives".
    """
    if steps_for not in STEPS_FOR:
        raise InputError(
            f"steps_for={steps_for!r} is unknown: use 'motion', or 'derivatives' to differentiate "
            "by the wind, the initial state and whatever else may move what is at rest"
        )


def refuse_disturbances(steps_for: str, arm: Arm, inputs: Any) -> Scalar:
    """Zero; raises a sentence where steps for the motion would meet a disturbance's tangent.

    The zero must be added to something that the simulation needs, or nothing keeps it.

    Arguments:
        steps_for: what the steps are short enough for.
        arm: the arm.
        inputs: commands, wind, torque and initial state.

    Returns:
        0, shape ().

    Raises:
        TypeError: while the program is traced, in forward or in reverse mode.
    """
    if steps_for != "motion":
        return jnp.zeros(())
    disturbances = (inputs, *(attrgetter(path)(arm) for path in _PARAMETERS))
    return jax.lax.stop_gradient(_undisturbed(disturbances))


@eqx.filter_custom_jvp
def _undisturbed(disturbances: Any) -> Array:
    return jnp.zeros(())


@_undisturbed.def_jvp
def _undisturbed_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    # Tangents that are known to be zero are None here.
    if jax.tree.leaves(tangents):
        raise TypeError(_REFUSAL)
    return jnp.zeros(()), jnp.zeros(())
