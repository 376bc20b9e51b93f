"""Passive forces of a giajax arm that MuJoCo does not have: drag, lift, commands and friction.

With arm.xml, air.json and this file in a folder:

    import mujoco, air

    model = mujoco.MjModel.from_xml_path("arm.xml")
    data = mujoco.MjData(model)
    with air.forces(lambda time: [0.3] * model.nv):  # commanded angles, rad
        mujoco.mj_step(model, data)

The module requires only MuJoCo and NumPy. The parameters are those of air.json, in SI units.
"""

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

OverTime = Callable[[float], Any]


def passive(
    numbers: Mapping[str, Any], command: OverTime | None = None, wind: OverTime | None = None
) -> Callable[[mujoco.MjModel, mujoco.MjData], None]:
    """Return a function for `mujoco.set_mjcb_passive`.

    `command` returns the commanded angles (rad) and `wind` the velocity of the air (m/s) at a time.
    """
    stiffness, friction, half, drag, axial, lift, steady = (
        np.asarray(numbers[name], dtype=float)
        for name in ("stiffness", "friction", "half_length", "drag", "axial", "lift", "wind")
    )
    places, weights = np.polynomial.legendre.leggauss(max(numbers["points"], 1))

    def act(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        air = steady if wind is None else steady + wind(data.time)
        torque = -friction * np.tanh(data.qvel / numbers["friction_rate"])
        if command is not None:
            torque = torque + stiffness * command(data.time)
        data.qfrc_passive[:] += torque
        motion = np.empty(6)
        for link in range(len(half)):
            body = model.body(f"link{link + 1}").id
            along = data.xmat[body].reshape(3, 3)[:, 0]
            origin = data.xpos[body]
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, motion, 0)

            def meet(place: Any, force: Any, body: int = body) -> None:
                mujoco.mj_applyFT(model, data, force, np.zeros(3), place, body, data.qfrc_passive)

            def stream(place: Any, origin: Any = origin) -> Any:
                return air - motion[3:] - np.cross(motion[:3], place - origin)

            centre = origin + half[link] * along
            meet(centre, np.array([0.0, 0.0, lift[link]]))
            if not numbers["points"]:
                past = stream(centre)
                meet(centre, drag[link] * np.linalg.norm(past) * past)
                continue
            slip = stream(centre) @ along
            meet(centre, axial[link] * abs(slip) * slip * along)
            for place, weight in zip(places, weights / 2, strict=True):
                at = centre + place * half[link] * along
                past = stream(at)
                past = past - (past @ along) * along
                meet(at, weight * drag[link] * np.linalg.norm(past) * past)

    return act


@contextlib.contextmanager
def forces(
    command: OverTime | None = None,
    wind: OverTime | None = None,
    numbers: Mapping[str, Any] | None = None,
) -> Iterator[None]:
    """Apply the forces in this context; the default parameters are in air.json beside this file."""
    if numbers is None:
        numbers = json.loads(Path(__file__).with_name("air.json").read_text())
    mujoco.set_mjcb_passive(passive(numbers, command, wind))
    try:
        yield
    finally:
        mujoco.set_mjcb_passive(None)
