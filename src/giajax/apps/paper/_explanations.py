"""What fig. 12 says of its joint: the pair alone, a neck that gives way, or both."""

import itertools
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from ...mechanics.joint import (
    LARGEST_ANGLE,
    JointPair,
    compression,
    joint_spring,
    net_torque,
    pair_command,
    slow_history,
)
from ...mechanics.wrinkling import Neck, neck_moment, stretching
from ...report import BLUE, DEGREE, GREY, VERMILLION, new_figure, plain
from ...runtime.arrays import Array, Float
from ...runtime.programs import program
from ..experiments import paper_history

Floats = npt.NDArray[np.float64]

EXPLANATIONS = {
    "the pair alone": (True, False),
    "a neck that gives way alone": (False, True),
    "both": (True, True),
}
"""Explanations by name: whether the pair may be bistable, and whether the link has a neck."""

SAID = {"largest": (30.0, 2.5), "mean": (11.0, 0.5), "at 13": (30.0, 1.0)}
"""Values in the paper's text, deg: largest and mean error, and the angle at a command of 13 deg,
each with its uncertainty (from "about", from the last digit, and from commands in whole degrees).
"""

PRESSURES = (1000.0, 1200.0, 1500.0)
"""Pressures of the links at which an experiment distinguishes the explanations, Pa."""


class Searched(NamedTuple):
    """What is tried: dry friction of muscles and film, N m, radius and length of the neck, m, and
    pressure of its gas, Pa.
    """

    frictions: Floats = np.linspace(0.0, 0.16, 17)
    radii: Floats = np.linspace(0.030, 0.060, 16)
    lengths: Floats = np.array([0.01, 0.02, 0.03, 0.05, 0.08])
    pressure: float = 1e3

    @property
    def necks(self) -> Iterator[Neck]:
        """All of these necks."""
        for radius, length in itertools.product(self.radii, self.lengths):
            yield _neck(float(radius), float(length), self.pressure)


def _neck(radius: float, length: float, pressure: float) -> Neck:
    values = {"radius": radius, "length": length, "pressure": pressure}
    return Neck(**{name: jnp.asarray(value) for name, value in values.items()})


_STIFFNESS_AT = np.deg2rad(30.0)  # whose stiffness a spring has that is put for a pair

_COMMANDS = np.arange(-60.0, 61.0)
_ANGLES = np.linspace(-LARGEST_ANGLE, LARGEST_ANGLE, 601)


@dataclass(frozen=True)
class Explained:
    """An explanation with the parameters that make most of what it is compared with.

    Friction is in N m, and the shape of the neck in m: None where there is none. The predicted
    angles are those where the paper's history is measured, their offset removed, deg. The least
    force that stretches the neck on the way is in N: below 0 muscles crush it, and its law does not
    hold.
    """

    name: str
    friction: float
    radius: float | None
    length: float | None
    angles: Floats
    stretching: float = np.inf

    @property
    def said(self) -> dict[str, float]:
        """What the text says of such a loop, deg."""
        return _said(self.angles)

    @property
    def misfit(self) -> float:
        """Chi-square of the three numbers of the text."""
        return misfit(self.angles)

    @property
    def needs(self) -> str:
        """Its parameters in words."""
        friction = f"friction {self.friction:.3g} N m"
        if self.radius is None or self.length is None:
            return friction
        radius, length = round(self.radius * 1e3), round(self.length * 1e3)
        return f"{friction}, neck of {radius} mm radius and {length} mm length"


def misfit(angles: Floats) -> float:
    """Chi-square of the three numbers of the text, by angles where the history is measured, deg."""
    found = _said(angles)
    return sum(((found[name] - value) / width) ** 2 for name, (value, width) in SAID.items())


def _said(angles: Floats) -> dict[str, float]:
    plan = paper_history()
    aimed = plan.target[plan.measured]
    error = np.abs(angles - aimed)
    # The larger of both ways: the text has one of them.
    at = float(np.max(angles[aimed == 13.0]))
    return {"largest": float(np.max(error)), "mean": float(np.mean(error)), "at 13": at}


def _centred(angles: Floats) -> Floats:
    """Angles where the history is measured, less the offset that makes the mean error least."""
    plan = paper_history()
    seen = angles[..., plan.measured]
    off: Floats = np.median(seen - plan.target[plan.measured], axis=-1, keepdims=True)
    return seen - off


def likelihood(angles: Floats, loop: Floats) -> float:
    """Logarithm of the likelihood of a loop, with the noise and the offset that make most of it."""
    return -len(loop) * float(np.log(np.std(loop - angles)))


@program
def _loads(pair: JointPair) -> tuple[Array, Array]:
    """Torques and compression of a pair, by command and angle."""
    command = pair_command(pair, jnp.deg2rad(_COMMANDS))
    angle = jnp.asarray(_ANGLES)
    ahead, none = angle >= 0, jnp.zeros(())

    def at(pressures: Float[Array, "2"]) -> tuple[Array, Array]:
        torque = net_torque(pair, pressures, none, angle, ahead)
        return torque, compression(pair, pressures, angle, ahead)

    return jax.vmap(at)(command.pressures)


@program
def _loops(
    torques: Array, pressed: Array, neck: Neck, frictions: Array, steps: Array
) -> tuple[Array, Array]:
    """Angles by friction and step of the history, rad, and the least force on the neck by friction,
    N.
    """
    angle = jnp.asarray(_ANGLES)
    if neck.radius is not None:
        torques = torques - neck_moment(neck, jnp.broadcast_to(angle, pressed.shape), pressed)
    of_steps, start = torques[steps], jnp.zeros(())
    loops = jax.vmap(lambda f: slow_history(of_steps, angle, f, start))(frictions)
    if neck.radius is None:
        return loops, jnp.full_like(frictions, jnp.inf)
    at = jax.vmap(lambda here, row: jnp.interp(here, angle, row), in_axes=(1, 0), out_axes=1)
    return loops, jnp.min(stretching(neck, at(loops, pressed[steps])), axis=1)


def _tried(name: str, necks: Iterable[Neck], frictions: Floats) -> Iterator[Explained]:
    """What an explanation predicts with each of these necks and frictions."""
    bistable, _ = EXPLANATIONS[name]
    pair = JointPair()
    torques, pressed = _loads(pair)
    if not bistable:
        at = pair_command(pair, _STIFFNESS_AT).pressures
        stiffness = joint_spring(pair, at, _STIFFNESS_AT).stiffness
        torques = stiffness * jnp.asarray(np.deg2rad(_COMMANDS)[:, None] - _ANGLES)
    steps = jnp.asarray(np.searchsorted(_COMMANDS, paper_history().target))
    for neck in necks:
        loops, least = _loops(torques, pressed, neck, jnp.asarray(frictions), steps)
        radius = None if neck.radius is None else float(neck.radius)
        length = None if radius is None else float(neck.length)
        rows = zip(frictions, _centred(np.rad2deg(loops)), np.asarray(least), strict=True)
        for friction, angles, force in rows:
            yield Explained(name, float(friction), radius, length, angles, float(force))


def explained(
    loop: Floats, searched: Searched | None = None
) -> dict[str, tuple[Explained, Explained]]:
    """By explanation, what is nearest to the text and what makes most of a loop.

    The loop is measured where the paper's history is, deg. Necks that muscles crush are left out.
    """
    searched, found = searched or Searched(), {}
    for name, (_, with_neck) in EXPLANATIONS.items():
        necks = searched.necks if with_neck else [Neck()]
        tried = _tried(name, necks, searched.frictions)
        every = [one for one in tried if one.stretching > 0]
        nearest = min(every, key=lambda one: one.misfit)
        found[name] = nearest, max(every, key=lambda one: likelihood(one.angles, loop))
    return found


def at_pressure(one: Explained, pressure: float) -> Explained:
    """The same joint with other gas in its links, Pa."""
    neck = Neck()
    if one.radius is not None and one.length is not None:
        neck = _neck(one.radius, one.length, pressure)
    (found,) = _tried(one.name, [neck], np.array([one.friction]))
    return found


def explanations_figure(found: Mapping[str, tuple[Explained, Explained]], loop: Floats) -> Figure:
    """Loops of the explanations that are nearest to the text, and a loop, against the command."""
    plan = paper_history()
    aimed = plan.target[plan.measured]
    figure = new_figure(
        11, 4.2, "One link: explanations fitted to the text of fig. 12; the simulated joint in grey"
    )
    panels = figure.subplots(1, len(found), sharey=True)
    for panel, (name, (nearest, _)) in zip(panels, found.items(), strict=True):
        panel.plot(aimed, loop, color=GREY, linewidth=0.9)
        panel.plot(aimed, nearest.angles, color=VERMILLION, linewidth=1.4)
        panel.plot([13.0], [30.0], "o", color=BLUE, markersize=5)
        parts = "\n".join(textwrap.wrap(nearest.needs, 44))
        plain(panel, f"{name}, chi-square {nearest.misfit:.1f}\n{parts}")
        panel.set_xlabel(f"command ({DEGREE})")
    panels[0].set_ylabel(f"angle ({DEGREE})")
    return figure


def collapse_pressure(radius: float, torque: float, compressed: float) -> float:
    """Pressure below which a tube (m) collapses under a torque (N m) and a compression (N), Pa."""
    return (torque / radius + compressed) / (np.pi * radius**2)


def collapse_radius(pressure: float, torque: float, compressed: float) -> float:
    """Radius below which a tube at a pressure (Pa) does, m."""
    cubic = np.roots([np.pi * pressure, 0.0, -compressed, -torque])
    return float(np.max(cubic[np.isreal(cubic)].real))
