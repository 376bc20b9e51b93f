"""Time to simulate 25 s of arms with more physics, relative to the plain arm at the same error.

Each arm is simulated with the largest tolerance that keeps the error of its tip below 1e-4 m, once
without derivatives and once with the derivatives with respect to four parameters. The arms take
turns, and the least times are compared.

The last rows are of the plain arm with a stiffness factor for each joint: the Jacobian of the tip
with respect to these factors, and the gradient of one number in reverse mode.

    python -m benchmarks.right_model [--quick] [--out FILE]
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.table import Table

from benchmarks.measuring import columns, in_turns, report
from giajax import joint_ramps, replace, simulate, takeichi_20m, takeichi_20m_full
from giajax.mechanics.arm import Arm
from giajax.runtime.programs import program
from giajax.simulation import Signal

ACCURACY = 1e-4  # error of the tip, m
TOLERANCES = (3e-4, 2e-4, 1e-4, 7e-5, 5e-5, 3e-5, 2e-5, 1e-5, 5e-6, 2e-6, 1e-6)
PATHS = (
    "air.drag_coefficient",
    "joints.pitch_stiffness",
    "joints.yaw_stiffness",
    "joints.damping",
)

MEMORY = {"joints.memory.strength": 0.06, "joints.memory.yield_angle": 0.001}
STOPS = {"joints.stops.strength": [0.03, 0.03], "joints.stops.yield_angle": [1e-3, 4e-3]}

# Limits relative to the plain arm: of a run, and of a run with its derivatives.
ALLOWED = {
    "full air": (1.3, 1.7),
    "memory": (2.0, 2.5),
    "stops": (2.0, 2.5),
    "memory and full air": (4.0, 5.0),
    "muscles in the pitch joints": (1.8, 2.0),
}

# The Jacobian with respect to a stiffness of each joint, relative to that of four parameters.
ALLOWED_EACH = 6.0


def arms(links: int) -> dict[str, Arm]:
    """Return the plain arm and the arms with more physics."""
    damped = {"joints.damping": 0.5}
    return {
        "plain": takeichi_20m(links),
        "full air": takeichi_20m_full(links),
        "memory": takeichi_20m(links, parameters=MEMORY),
        "stops": takeichi_20m(links, parameters=STOPS),
        "memory and full air": takeichi_20m_full(links, parameters=MEMORY),
        "muscles in the pitch joints": takeichi_20m(links, muscles="pitch", parameters=damped),
    }


def measure(quick: bool) -> dict[str, Any]:
    links, seconds, repeats = (3, 2.0, 1) if quick else (20, 25.0, 7)
    command = joint_ramps(links, {1: np.deg2rad(30), 2: np.deg2rad(20)}, start=0.5, duration=1.0)
    times = jnp.linspace(0.0, seconds, round(10 * seconds) + 1)

    def moved(arm: Arm, values: Any, tolerance: Any) -> tuple[Any, Any]:
        own = replace(arm, dict(zip(PATHS, values, strict=True)))
        motion = simulate(own, command, times, rtol=tolerance, atol=tolerance)
        return motion.tip, motion.steps

    # Compile the functions as a fit does.
    run, with_slopes = program(moved), program(jax.jacfwd(moved, argnums=1, has_aux=True))
    found: dict[str, Any] = {}
    contenders: dict[str, Any] = {}
    for name, arm in arms(links).items():
        values = jnp.asarray([1.2, 3.0, 30.0, jnp.max(jnp.asarray(arm.joints.damping))])
        exact = np.asarray(run(arm, values, jnp.asarray(1e-9))[0])
        for tolerance in TOLERANCES:
            tip, steps = run(arm, values, jnp.asarray(tolerance))
            error = float(np.max(np.linalg.norm(np.asarray(tip) - exact, axis=1)))
            if error <= ACCURACY:
                break
        found[name] = {"tolerance": tolerance, "error": error, "steps": np.asarray(steps).tolist()}
        given = (arm, values, jnp.asarray(tolerance))
        for of, call in (("run", run), ("slopes", with_slopes)):
            contenders[f"{name}: {of}"] = lambda call=call, given=given: jax.block_until_ready(
                call(*given)
            )
    many: dict[str, Any] = each_stiffness(
        arms(links)["plain"], command, times, found["plain"]["tolerance"]
    )
    times_of = in_turns(contenders | many, repeats)
    plain = {of: times_of[f"plain: {of}"]["min"] for of in ("run", "slopes")}
    for name, each in found.items():
        for of, least in plain.items():
            seconds_of = times_of[f"{name}: {of}"]["min"]
            each[of] = {"seconds": seconds_of, "ratio": seconds_of / least}
    for name in many:
        seconds_of = times_of[name]["min"]
        many[name] = {"seconds": seconds_of, "ratio": seconds_of / plain["slopes"]}
    return {"links": links, "arms": found, "each": many}


def each_stiffness(
    arm: Arm, command: Signal, times: Any, tolerance: float
) -> dict[str, Callable[[], Any]]:
    """Return derivatives by a stiffness of each joint: a Jacobian, and the gradient of a number."""

    def tip(factors: Any, derivatives: str) -> Any:
        own = replace(arm, {"joints.stiffness_factor": factors})
        how: dict[str, Any] = {"rtol": tolerance, "atol": tolerance, "derivatives": derivatives}
        return simulate(own, command, times, **how).tip

    slopes = program(jax.jacfwd(lambda factors: tip(factors, "forward")))
    gradient = program(jax.grad(lambda factors: jnp.sum(tip(factors, "reverse") ** 2)))
    factors = jnp.full(arm.count, 1.01)
    return {
        "Jacobian": lambda: jax.block_until_ready(slopes(factors)),
        "gradient": lambda: jax.block_until_ready(gradient(factors)),
    }


def table(found: dict[str, Any]) -> Table:
    rows = columns(
        f"25 s of {found['links']} links, {ACCURACY:g} m at the tip",
        "",
        "tolerance",
        "steps + rejected",
        "run, ms",
        "over plain (allowed)",
        "with Jacobian, ms",
        "over plain (allowed)",
    )
    for name, each in found["arms"].items():
        allowed = ALLOWED.get(name, (1.0, 1.0))
        # An arm that never reaches the accuracy ran at the least tolerance: show its error.
        wrong = f" ({each['error']:.1g} m)" if each["error"] > ACCURACY else ""
        cells = [f"{each['tolerance']:g}{wrong}", " + ".join(map(str, each["steps"]))]
        for of, most in zip(("run", "slopes"), allowed, strict=True):
            cells += [f"{1e3 * each[of]['seconds']:.3g}", f"{each[of]['ratio']:.2f} ({most:g})"]
        rows.add_row(name, *cells)
    for name, took in found["each"].items():
        limit = f" ({ALLOWED_EACH:g})" if name == "Jacobian" else ""
        last = f"{1e3 * took['seconds']:.3g}", f"{took['ratio']:.2f}{limit}"
        rows.add_row(f"a stiffness of each joint: {name}", "", "", "", "", *last)
    return rows


def main() -> None:
    report(__doc__, "right_model", measure, table)


if __name__ == "__main__":
    main()
