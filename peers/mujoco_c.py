"""The arm in MuJoCo with its drag in compiled C: MuJoCo at its fastest.

The same MJCF as `peers.mujoco_chain`, whose callback is Python; here it is C, and so is the loop
over the steps. Only what the paper's arm has is offered: drag at the centres of the links with a
constant C_D, in still air, and no more forces than springs and dampers.
"""

import ctypes
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from giajax.mechanics.arm import Arm
from giajax.simulation import Signal
from peers.compiling import SOURCES, CompilerError, address, compiled
from peers.mujoco_chain import mjcf
from peers.plain_arm import PlainArm, command_on_steps

Array = np.ndarray


@cache
def _library() -> ctypes.CDLL:
    folder = Path(mujoco.__file__).parent
    names = ("libmujoco.so*", "libmujoco*.dylib")
    engines = [str(path) for name in names for path in folder.glob(name)]
    if len(engines) != 1:
        raise CompilerError(f"no MuJoCo library to link with is in {folder}: install it again")
    library = compiled(SOURCES / "mujoco_run.c", f"-I{folder / 'include'}", *engines)
    library.trajectory.restype = ctypes.c_long
    return library


# As many as the C source has room for.
_MOST_THREADS = 64


class MujocoInC:
    """An `Arm` in MuJoCo, driven from C.

    Arguments:
        arm: the arm whose numbers are read.
        command: commanded angles over time; only `ends` needs it.

    Raises:
        CompilerError: no C compiler is there.
        ValueError: the arm has more than this offers.
    """

    def __init__(self, arm: Arm, command: Signal | None = None) -> None:
        self.plain = PlainArm(arm)
        self.count = arm.count
        n = arm.count
        text = mjcf(arm).replace("<worldbody>", f'<size nuserdata="{4 * n + 1}"/><worldbody>', 1)
        self.model = mujoco.MjModel.from_xml_string(text)
        self.command = command
        self._library = _library()
        self._parameters = self.plain.parameters
        self._data = self._new_data()

    def set_parameters(self, values: Mapping[str, float]) -> None:
        """Other values of some of the parameters of `PlainArm`, in place."""
        self._parameters = {**self._parameters, **values}
        plain = self.plain.stiffness_and_damping(self._parameters)
        self.model.jnt_stiffness[:], self.model.dof_damping[:] = plain
        self._set_constants(self._data)

    def _set_constants(self, data: Any) -> None:
        n = self.count
        stiffness, _ = self.plain.stiffness_and_damping(self._parameters)
        data.userdata[:n] = self.plain.drag_factor(self._parameters)
        data.userdata[n : 2 * n] = stiffness

    def _new_data(self) -> Any:
        data = mujoco.MjData(self.model)
        self._set_constants(data)
        return data

    def ends(self, times: Array, step: float) -> Array:
        """Ends of the links at the times, from rest, shape (sample, link, 3), by MuJoCo's RK4.

        Arguments:
            times: of the samples, from 0, each a whole number of steps, as are the corners.
            step: time step, s.
        """
        assert self.command is not None
        samples, corners, lines = command_on_steps(self.command, times, step)
        mujoco.mj_resetData(self.model, self._data)
        self._set_constants(self._data)
        self.model.opt.timestep = step
        out = np.empty((len(times), self.count, 3))
        # Warnings are counted in `data.warning`, and would else go to a file.
        mujoco.set_mju_user_warning(_silent)
        done = self._library.trajectory(
            ctypes.c_void_p(self.model._address),
            ctypes.c_void_p(self._data._address),
            ctypes.c_long(len(corners)),
            address(corners),
            address(lines),
            ctypes.c_long(len(samples)),
            address(samples),
            address(self.plain.length),
            address(out),
        )
        mujoco.set_mju_user_warning(None)
        if done < samples[-1]:
            raise FloatingPointError(f"MuJoCo is unstable with a step of {step:g} s")
        return out

    def acceleration(self, angles: Array, rates: Array, command: Array) -> Array:
        """Joint accelerations, rad/s^2."""
        return self.batch(angles[None], rates[None], command[None], threads=1)[0]

    def evaluations(self, angles: Array, rates: Array, command: Array, loop: int) -> None:
        """So many evaluations of the accelerations, each of which needs the one before."""
        self.batch(angles[None], rates[None], command[None], threads=1, loop=loop)

    def batch(
        self, angles: Array, rates: Array, commands: Array, *, threads: int, loop: int = 1
    ) -> Array:
        """Joint accelerations of many states, shape (item, joint), each `loop` times over."""
        if not 1 <= threads <= _MOST_THREADS:
            raise ValueError(f"{threads} threads: give 1 to {_MOST_THREADS}")
        states = [np.ascontiguousarray(x, dtype=float) for x in (angles, rates, commands)]
        found = np.empty_like(states[0])
        data = [self._new_data() for _ in range(threads)]
        pointers = (ctypes.c_void_p * threads)(*(each._address for each in data))
        self._library.batch(
            ctypes.c_void_p(self.model._address),
            ctypes.c_long(threads),
            pointers,
            ctypes.c_long(len(found)),
            ctypes.c_long(loop),
            *(address(each) for each in (*states, found)),
        )
        return found


def _silent(_: str) -> None:
    """Nothing is said of a state that went bad."""
