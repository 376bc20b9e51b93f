"""The arm in MuJoCo with its drag in compiled C, which is the fastest way to use MuJoCo.

The MJCF is the same as in `peers.mujoco_chain`. The force callback and the loop over the steps are
in C instead of Python. Only the effects in the model of the paper are available: springs, dampers,
and drag at the centres of the links with a constant C_D, in still air.
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


# Size of the arrays of threads in the C source.
_MOST_THREADS = 64


class MujocoInC:
    """`Arm` in MuJoCo, simulated by a C program.

    Arguments:
        arm: arm whose numbers are used.
        command: commanded angles as a function of time; required only for `ends`.

    Raises:
        CompilerError: a C compiler is missing, or the code does not compile.
        ValueError: the arm has parts other than links, springs, dampers and drag at the centres.
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
        """Change some of the parameters of `PlainArm` in place."""
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
        """Return the ends of the links at the times, from rest, shape (sample, link, 3).

        The integrator is MuJoCo's RK4.

        Arguments:
            times: times of the samples, from 0, s. Samples and corners of the command must be at
                multiples of the step.
            step: time step, s.
        """
        assert self.command is not None
        samples, corners, lines = command_on_steps(self.command, times, step)
        mujoco.mj_resetData(self.model, self._data)
        self._set_constants(self._data)
        self.model.opt.timestep = step
        out = np.empty((len(times), self.count, 3))
        # MuJoCo counts warnings in `data.warning`. By default, it also writes them to a file.
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
        """Return the joint accelerations, rad/s^2."""
        return self.batch(angles[None], rates[None], command[None], threads=1)[0]

    def evaluations(self, angles: Array, rates: Array, command: Array, loop: int) -> None:
        """Evaluate the accelerations `loop` times; each evaluation depends on the previous one."""
        self.batch(angles[None], rates[None], command[None], threads=1, loop=loop)

    def batch(
        self, angles: Array, rates: Array, commands: Array, *, threads: int, loop: int = 1
    ) -> Array:
        """Return the accelerations of many states, (item, joint), each evaluated `loop` times."""
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
    """Ignore a warning, for example about an unstable state."""
