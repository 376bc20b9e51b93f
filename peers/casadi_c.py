"""C code that CasADi generates for the arm: equations of motion and their derivatives."""

import ctypes
import tempfile
from pathlib import Path
from typing import Any

import casadi
import numpy as np

from giajax.mechanics.arm import Arm
from giajax.simulation import Signal
from peers.casadi_chain import CasadiChain
from peers.compiling import SOURCES, address, compiled
from peers.plain_arm import PARAMETERS, command_on_steps

Array = np.ndarray

# Butcher tableaux: a, b, c. The steps of a stiff arm are limited by stability and not by accuracy.
# A method of higher order, with more stages, would therefore have no advantage.
TABLEAUX = {
    "RK4": (
        [[0, 0, 0, 0], [0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 1, 0]],
        [1 / 6, 1 / 3, 1 / 3, 1 / 6],
        [0, 0.5, 0.5, 1],
    ),
    "RK3": (
        [[0, 0, 0], [0.5, 0, 0], [-1, 2, 0]],
        [1 / 6, 2 / 3, 1 / 6],
        [0, 0.5, 1],
    ),
}


class CasadiInC:
    """`Arm` as generated C code.

    Arguments:
        arm: arm whose numbers become constants of the code.
        command: commanded angles as a function of time; required only for trajectories.

    Raises:
        CompilerError: a C compiler is missing, or the code does not compile.
        ValueError: the arm has parts other than links, springs, dampers and drag at the centres.
    """

    def __init__(self, arm: Arm, command: Signal | None = None) -> None:
        self.chain = CasadiChain(arm)
        self.count = arm.count
        self.parameters = dict(self.chain.plain.parameters)
        self.command = command
        with tempfile.TemporaryDirectory() as folder:
            source = Path(folder) / "chain.c"
            source.write_text(_generated(self.chain) + (SOURCES / "casadi_run.c").read_text())
            self._library = compiled(source)

    def ends(
        self, times: Array, step: float, method: str = "RK4", *, parameters: Any = None
    ) -> Array:
        """Return the ends of the links at the times, from rest, shape (sample, link, 3).

        Arguments:
            times: times of the samples, from 0, s. Samples and corners of the command must be at
                multiples of the step.
            step: time step, s.
            method: name of a method in `TABLEAUX`.
            parameters: values of the parameters of `PlainArm`, in its order; the values of the arm
                by default.
        """
        return self._trajectory(times, step, method, 0, parameters)[:, 0]

    def ends_and_jacobian(
        self, times: Array, step: float, method: str = "RK4", *, parameters: Any = None
    ) -> tuple[Array, Array]:
        """Return the ends of the links and their derivatives with respect to the parameters.

        The derivatives have the shape (sample, link, 3, parameter).
        """
        found = self._trajectory(times, step, method, len(PARAMETERS), parameters)
        return found[:, 0], np.moveaxis(found[:, 1:], 1, -1)

    def _trajectory(
        self, times: Array, step: float, method: str, directions: int, parameters: Any
    ) -> Array:
        assert self.command is not None
        samples, corners, lines = command_on_steps(self.command, times, step)
        below, weights, nodes = (np.array(x, dtype=float) for x in TABLEAUX[method])
        out = np.empty((len(times), 1 + directions, self.count, 3))
        values = self._values(parameters)
        self._library.trajectory(
            *(ctypes.c_long(number) for number in (self.count, directions, len(weights))),
            *(address(each) for each in (below, weights, nodes)),
            ctypes.c_double(step),
            ctypes.c_long(len(corners)),
            address(corners),
            address(lines),
            ctypes.c_long(len(samples)),
            address(samples),
            address(values),
            address(out),
        )
        if not np.isfinite(out).all():
            raise FloatingPointError(f"{method} is unstable with a step of {step:g} s")
        return out

    def acceleration(self, angles: Array, rates: Array, command: Array) -> Array:
        """Return the joint accelerations, rad/s^2."""
        return self.evaluations(angles, rates, command, loop=1)

    def evaluations(self, angles: Array, rates: Array, command: Array, loop: int) -> Array:
        """Evaluate the accelerations `loop` times; each evaluation depends on the previous one."""
        state = [np.array(x, dtype=float) for x in (angles, rates, command)]
        # Keep a reference until the C function returns, because an address does not.
        values, found = self._values(None), np.empty(self.count)
        self._library.evaluations(
            ctypes.c_long(self.count),
            ctypes.c_long(loop),
            *(address(each) for each in (*state, values, found)),
        )
        return found

    def _values(self, parameters: Any) -> Array:
        values = self.parameters.values() if parameters is None else parameters
        return np.array(list(values), dtype=float)


def _generated(chain: CasadiChain) -> str:
    """Return C code for the motion and the ends of the links, with and without derivatives."""
    n, count = chain.count, len(PARAMETERS)
    angles_by, rates_by = casadi.SX.sym("dq", n, count), casadi.SX.sym("dv", n, count)
    inputs = [chain.angles, chain.rates, chain.command, chain.parameters]
    moved = casadi.vertcat(chain.angles, chain.rates, chain.parameters)
    seeds = casadi.vertcat(angles_by, rates_by, casadi.SX.eye(count))
    # Forward mode with all directions in one sweep computes common expressions only once.
    tangents = casadi.jtimes(chain.accelerations, moved, seeds)
    ends = casadi.vec(chain.ends)
    ends_by = casadi.jtimes(ends, chain.angles, angles_by)
    functions = [
        ("motion", inputs, [chain.accelerations]),
        (
            "motion_and_tangents",
            [*inputs, angles_by, rates_by],
            casadi.cse([chain.accelerations, tangents]),
        ),
        ("ends", [chain.angles], [casadi.densify(ends)]),
        (
            "ends_and_tangents",
            [chain.angles, angles_by],
            [casadi.densify(each) for each in casadi.cse([ends, ends_by])],
        ),
    ]
    generator = casadi.CodeGenerator("chain")
    for name, given, results in functions:
        generator.add(casadi.Function(name, given, results))
    return str(generator.dump())
