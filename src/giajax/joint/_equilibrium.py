"""Angles at which a pair of muscles rests, as results."""

import dataclasses

import numpy as np


@dataclasses.dataclass(frozen=True)
class Equilibrium:
    """One angle at which a pair rests.

    Attributes:
        angle: rad.
        stiffness: d(torque)/d(angle) against a displacement, N m/rad; negative where the joint
            runs away. Infinite at a step of the torque (see `at_step`).
        muscle_stiffness: the muscles' part of it, without the corrections.
        stable: whether the joint comes back after a small push.
        branches: which path the first and the second muscle take.
        at_step: the torque changes its sign in a step of the corrections, as at a point of
            friction, and is zero on neither side of it: at 0, where alpha(0) and beta(0) differ,
            and with the printed beta at its width and its threshold (2 and 20 deg). The joint
            rests there, stiffness inf, where the torque falls through the step; where it rises
            the stiffness is -inf.
    """

    angle: float
    stiffness: float
    muscle_stiffness: float
    stable: bool
    branches: tuple[str, str]
    at_step: bool = False


@dataclasses.dataclass(frozen=True)
class Equilibria:
    """Every equilibrium within the joint's range, by angle.

    Attributes:
        every: the equilibria, stable or not, from the smallest angle to the largest.
        at_lower_stop, at_upper_stop: whether the torque drives the joint against the end of its
            range, -60 or 60 deg.
        indifferent: whether there is a range of angles in which nothing acts on the joint, as
            with slack muscles: it rests at any of them, and none of them is listed.
    """

    every: tuple[Equilibrium, ...]
    at_lower_stop: bool
    at_upper_stop: bool
    indifferent: bool

    @property
    def stable(self) -> tuple[Equilibrium, ...]:
        """Those to which the joint comes back."""
        return tuple(equilibrium for equilibrium in self.every if equilibrium.stable)

    @property
    def angles(self) -> np.ndarray:
        """Angles of all of them, rad, shape (equilibrium,)."""
        return np.asarray([equilibrium.angle for equilibrium in self.every])
