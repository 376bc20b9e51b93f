"""One evaluation of the accelerations, for chains of several lengths."""

from typing import Any

import jax
import mujoco
import numpy as np

from benchmarks.measuring import in_turns
from giajax.mechanics.arm import Arm, acceleration
from giajax.runtime.programs import program
from peers.arms import driven_arm, random_states
from peers.compiling import CompilerError
from peers.mujoco_c import MujocoInC
from peers.mujoco_chain import MujocoChain
from peers.scipy_chain import ScipyChain


@program
def again_and_again(arm: Arm, state: dict[str, Any], loop: Any) -> Any:
    """Compute `loop` evaluations, each of which depends on the previous one, so none is omitted."""

    def again(_: Any, angles: Any) -> Any:
        return angles + 1e-9 * acceleration(arm, angles, state["rates"], state["command"])

    return jax.lax.fori_loop(0, loop, again, state["angles"])


def evaluation(links: int, repeats: int, loop: int, generated: Any = None) -> dict[str, Any]:
    """Measure the seconds of one evaluation; `generated` is the chain in C by CasADi, or None."""
    arm, _ = driven_arm(links)
    state = {name: value[0] for name, value in random_states(links, 1).items() if name != "wind"}
    numbers = {name: np.asarray(value) for name, value in state.items()}
    numpy, engine = ScipyChain(arm), MujocoChain(arm)
    engine.data.qpos[:], engine.data.qvel[:] = numbers["angles"], numbers["rates"]
    few = max(loop // 100, 10)

    def forward() -> None:
        with engine.forces():
            for _ in range(few):
                mujoco.mj_forward(engine.model, engine.data)

    calls: dict[str, Any] = {
        "giajax": lambda: jax.block_until_ready(
            again_and_again(arm, state, np.asarray(loop, np.int32))
        ),
        "MuJoCo, drag in Python": forward,
        "numpy": lambda: [numpy.acceleration(**numbers) for _ in range(few)],
    }
    loops = dict.fromkeys(calls, few) | {"giajax": loop}
    if generated is not None:
        loops["CasADi in C"] = loop
        calls["CasADi in C"] = lambda: generated.evaluations(**numbers, loop=loop)
    try:
        compiled = MujocoInC(arm)
        loops["MuJoCo, drag in C"] = loop
        calls["MuJoCo, drag in C"] = lambda: compiled.evaluations(**numbers, loop=loop)
    except CompilerError:
        pass  # the measurement of the run reports this
    return {
        name: {key: value / loops[name] for key, value in each.items()}
        for name, each in in_turns(calls, repeats).items()
    }
