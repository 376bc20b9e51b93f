"""The paper's model and an arm that it may have been compared with, from numbers nobody printed."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._program import program
from .._typing import Array, Float
from ..arm import Arm, takeichi_20m
from ..parameters import replace
from ..simulation import Signal, integrate
from ._concordance import STEP, WINDOW
from ._contenders import LINKS

# When the base joint begins to bend, s; table 3 begins to compare 9.5 s later.
STARTS_AT = 0.5

_TOLERANCE = 1e-6
_MAX_STEPS = 20_000

# Without such a number there is no element in the joints.
_REMEMBERING = {"joints.memory.strength": 0.03, "joints.memory.yield_angle": 0.003}


class Unknown(NamedTuple):
    """A number of the comparison that the paper does not print.

    Attributes:
        label: what tables call it, with its unit.
        lower, upper: ends of the range in which it is looked for, in that unit.
        unit: of the label in SI.
    """

    label: str
    lower: float
    upper: float
    unit: float = 1.0


_DEGREE = float(np.deg2rad(1.0))

UNKNOWNS = {
    "stiffness": Unknown("arm: pitch stiffness, N m/rad", 1.0, 10.0),
    "damping": Unknown("arm: damping, N m s/rad", 0.005, 0.5),
    "drag": Unknown("arm: C_D", 0.5, 2.0),
    "strength": Unknown("arm: memory's strength, N m", 0.003, 0.3),
    "yield": Unknown("arm: its yield angle, rad", 0.001, 0.03),
    "reach": Unknown("arm: its base angle over the model's", 0.5, 1.5),
    "angle": Unknown("base joint: angle, deg", 10.0, 60.0, _DEGREE),
    "lasting": Unknown("base joint: bends within, s", 0.25, 6.0),
    "back": Unknown("base joint: turns back at, s", 8.0, 22.0),
    "model_stiffness": Unknown("model: pitch stiffness, N m/rad", 1.0, 10.0),
    "model_damping": Unknown("model: damping, N m s/rad", 0.005, 0.5),
    "model_drag": Unknown("model: C_D", 0.5, 2.0),
}
"""What is looked for, each within a range of its logarithm."""


class Compared(NamedTuple):
    """What comes out of a comparison.

    Attributes:
        cells: of table 3, %: links 2, 6, 12, 20 with air, then without, shape (8,).
        nearest: how near to 0 the arm's displacement of each link comes where it is compared, m,
            shape (4,).
        crossed: whether it changes its sign there, shape (4,).
    """

    cells: Float[Array, " cell"]
    nearest: Float[Array, " link"]
    crossed: Array


def compared_arms(values: Float[Any, " unknown"]) -> Compared:
    """Table 3 as it would be for one arm and one model.

    The arm is the paper's with joints that remember; the model has none of that, and its C_D
    or none. Where the arm's displacement passes 0 a term of the concordance has a pole, so that
    cells are smooth between such parameters and not across them; at a displacement of exactly 0
    there is no term, and no derivative.

    Arguments:
        values: of `UNKNOWNS`, in their order, SI; may be differentiated in forward mode.

    Returns:
        Its cells; NaN where a simulation fails.
    """
    known = dict(zip(UNKNOWNS, values, strict=True))
    paper = takeichi_20m()
    arm = replace(
        takeichi_20m(parameters=_REMEMBERING),
        {
            **_springs(known, ""),
            "joints.memory.strength": known["strength"],
            "joints.memory.yield_angle": known["yield"],
        },
    )
    model = replace(paper, _springs(known, "model_"))
    vacuum = replace(model, {"air.drag_coefficient": jnp.zeros_like(known["model_drag"])})
    bend = known["lasting"], known["back"]
    recorded = _heights(arm, _there_and_back(known["reach"] * known["angle"], *bend))
    command = _there_and_back(known["angle"], *bend)
    cells = [_concordance(_heights(each, command), recorded) for each in (model, vacuum)]
    size = jnp.abs(recorded)
    return Compared(
        100 * jnp.concatenate(cells),
        jnp.min(size, axis=0),
        jnp.min(recorded, axis=0) * jnp.max(recorded, axis=0) < 0,
    )


@program
def linearised(
    logarithms: Float[Array, " unknown"],
) -> tuple[Compared, Float[Array, "cell unknown"]]:
    """What comes out, and the derivatives of its cells by the logarithms of `UNKNOWNS`."""

    def push(tangent: Array) -> tuple[Array, Array, Compared]:
        def cells(at: Array) -> tuple[Array, Compared]:
            out = compared_arms(jnp.exp(at))
            return out.cells, out

        _, slope, out = jax.jvp(cells, (logarithms,), (tangent,), has_aux=True)
        return slope, out.cells, out

    basis = jnp.eye(len(UNKNOWNS), dtype=logarithms.dtype)
    slopes, _, out = jax.vmap(push, out_axes=(1, None, None))(basis)
    return out, slopes


@program
def evaluated(logarithms: Float[Array, " unknown"]) -> Compared:
    """What comes out at the logarithms of `UNKNOWNS`."""
    return compared_arms(jnp.exp(logarithms))


def _springs(known: Mapping[str, Array], of: str) -> dict[str, Array]:
    paths = {
        "joints.pitch_stiffness": "stiffness",
        "joints.damping": "damping",
        "air.drag_coefficient": "drag",
    }
    return {path: known[of + name] for path, name in paths.items()}


def _there_and_back(angle: Array, lasting: Array, back: Array, joints: int = 20) -> Signal:
    """The base joint to an angle, where it stays, and back; its knots may be differentiated."""
    first = jnp.full_like(back, STARTS_AT)
    times = jnp.stack([first, first + lasting, back, back + lasting])
    base = jnp.zeros((4, joints), angle.dtype)
    values = base.at[1:3, 0].set(angle)
    slopes = base.at[0, 0].set(angle / lasting).at[2, 0].set(-angle / lasting)
    return Signal(times, values, slopes, jnp.full((4,), jnp.inf, angle.dtype))


def _heights(arm: Arm, command: Signal) -> Float[Array, "sample link"]:
    """Heights of the compared links where they are compared, m."""
    first, last = WINDOW
    rows = np.linspace(first, last, round((last - first) / STEP) + 1)
    tolerance = jnp.asarray(_TOLERANCE)
    motion = integrate(
        arm,
        command,
        jnp.asarray(np.concatenate([[0.0], rows])),
        None,
        None,
        jnp.zeros((2, arm.count)),
        (tolerance, tolerance),
        solver="springs5",
        max_steps=_MAX_STEPS,
        derivatives="forward",
        steps_for="derivatives",
    )
    return motion.link_centres[1:, np.asarray(LINKS) - 1, 2]


def _concordance(
    model: Float[Array, "sample link"], experiment: Float[Array, "sample link"]
) -> Float[Array, " link"]:
    """`concordance` of each link, differentiable; as there a sample at exactly 0 has no term."""
    counts = experiment != 0
    size = jnp.abs(jnp.where(counts, experiment, 1))
    terms = jnp.where(counts, 1 - jnp.abs(model - experiment) / size, 0)
    return jnp.sum(terms, axis=0) / jnp.sum(counts, axis=0, dtype=terms.dtype)
