"""Explanations of fig. 12: the muscle pair alone, a yielding neck alone, or both."""

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
"""Values in the paper's text, deg: largest error, mean error, and angle at a command of 13 deg.
Each value has an uncertainty. It follows from the word "about" for the first value, from the last
printed digit for the second, and from the commands in whole degrees for the third.
"""

PRESSURES = (1000.0, 1200.0, 1500.0)
"""Pressures of the links at which an experiment distinguishes the explanations, Pa."""


class Searched(NamedTuple):
    """Grid of the search.

    Friction of muscles and film is in N m, radius and length of the neck are in m, and the pressure
    of its gas is in Pa.
    """

    frictions: Floats = np.linspace(0.0, 0.16, 17)
    radii: Floats = np.linspace(0.030, 0.060, 16)
    lengths: Floats = np.array([0.01, 0.02, 0.03, 0.05, 0.08])
    pressure: float = 1e3

    @property
    def necks(self) -> Iterator[Neck]:
        """All necks of the grid."""
        for radius, length in itertools.product(self.radii, self.lengths):
            yield _neck(float(radius), float(length), self.pressure)


def _neck(radius: float, length: float, pressure: float) -> Neck:
    values = {"radius": radius, "length": length, "pressure": pressure}
    return Neck(**{name: jnp.asarray(value) for name, value in values.items()})


# A spring that replaces the muscle pair has the stiffness of the pair at this angle.
_STIFFNESS_AT = np.deg2rad(30.0)

_COMMANDS = np.arange(-60.0, 61.0)
_ANGLES = np.linspace(-LARGEST_ANGLE, LARGEST_ANGLE, 601)


@dataclass(frozen=True)
class Explained:
    """An explanation with its best parameters.

    Friction is in N m, and the dimensions of the neck are in m, or None without a neck. The
    predicted angles are those at the measured steps of the paper's history, without their offset,
    deg. The smallest force that stretches the neck during the history is in N. If it is negative,
    the muscles crush the neck and its law is not valid.
    """

    name: str
    friction: float
    radius: float | None
    length: float | None
    angles: Floats
    stretching: float = np.inf

    @property
    def said(self) -> dict[str, float]:
        """Values of this loop that the text gives, deg."""
        return _said(self.angles)

    @property
    def misfit(self) -> float:
        """Chi-square of the three values of the text."""
        return misfit(self.angles)

    @property
    def needs(self) -> str:
        """Parameters of the explanation in words."""
        friction = f"friction {self.friction:.3g} N m"
        if self.radius is None or self.length is None:
            return friction
        radius, length = round(self.radius * 1e3), round(self.length * 1e3)
        return f"{friction}, neck of {radius} mm radius and {length} mm length"


def misfit(angles: Floats) -> float:
    """Return the chi-square of the text's three values for angles at the measured steps, deg."""
    found = _said(angles)
    return sum(((found[name] - value) / width) ** 2 for name, (value, width) in SAID.items())


def _said(angles: Floats) -> dict[str, float]:
    plan = paper_history()
    aimed = plan.target[plan.measured]
    error = np.abs(angles - aimed)
    # The text gives one value only: take the larger one of the two directions.
    at = float(np.max(angles[aimed == 13.0]))
    return {"largest": float(np.max(error)), "mean": float(np.mean(error)), "at 13": at}


def _centred(angles: Floats) -> Floats:
    """Return the angles at the measured steps, less the offset that minimises the mean error."""
    plan = paper_history()
    seen = angles[..., plan.measured]
    off: Floats = np.median(seen - plan.target[plan.measured], axis=-1, keepdims=True)
    return seen - off


def likelihood(angles: Floats, loop: Floats) -> float:
    """Return the log-likelihood of a loop, maximised over the noise and the offset."""
    return -len(loop) * float(np.log(np.std(loop - angles)))


@program
def _loads(pair: JointPair) -> tuple[Array, Array]:
    """Return torques and compression of a pair, by command and angle."""
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
    """Return the angles by friction and step of the history, rad, and the smallest neck force, N.

    The force has one value for each friction.
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
    """Yield the predictions of an explanation with each of these necks and frictions."""
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
    """Return for each explanation the best fit to the text and the best fit to a loop.

    The loop contains the measured steps of the paper's history, deg. Necks that the muscles crush
    are omitted.
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
    """Return the same joint with gas at another pressure in its links, Pa."""
    neck = Neck()
    if one.radius is not None and one.length is not None:
        neck = _neck(one.radius, one.length, pressure)
    (found,) = _tried(one.name, [neck], np.array([one.friction]))
    return found


_CAPTION = (
    "Each panel shows the angle of the joint versus the command during the history of fig. 12 for "
    "one explanation. The orange-red line is computed with the parameters in the panel's title, "
    "which minimise chi-square. Chi-square compares the largest error, the mean error and the "
    f"angle at a command of 13{DEGREE} with the text of the paper. The blue dot is that angle in "
    f"the text, 30{DEGREE}. The dotted grey line is a simulated joint, generated with another "
    "model. The offset that minimises the mean absolute error is subtracted from each line."
)


def explanations_figure(found: Mapping[str, tuple[Explained, Explained]], loop: Floats) -> Figure:
    """Plot the loops that fit the text best, and a simulated loop, versus the command."""
    plan = paper_history()
    aimed = plan.target[plan.measured]
    title = "One link: explanations fitted to the text of fig. 12 (simulated joint dotted)"
    figure = new_figure(11, 4.2, title, _CAPTION)
    panels = figure.subplots(1, len(found), sharey=True)
    for panel, (name, (nearest, _)) in zip(panels, found.items(), strict=True):
        panel.plot(aimed, loop, ":", color=GREY, linewidth=1.1)
        panel.plot(aimed, nearest.angles, color=VERMILLION, linewidth=1.4)
        panel.plot([13.0], [30.0], "o", color=BLUE, markersize=5)
        parts = "\n".join(textwrap.wrap(nearest.needs, 44))
        plain(panel, f"{name}, chi-square {nearest.misfit:.1f}\n{parts}")
        panel.set_xlabel(f"command ({DEGREE})")
    panels[0].set_ylabel(f"angle ({DEGREE})")
    return figure


def collapse_pressure(radius: float, torque: float, compressed: float) -> float:
    """Return the pressure below which a tube collapses under torque and compression, Pa.

    The radius is in m, the torque in N m and the compression in N.
    """
    return (torque / radius + compressed) / (np.pi * radius**2)


def collapse_radius(pressure: float, torque: float, compressed: float) -> float:
    """Return the radius (m) below which a tube at a pressure (Pa) collapses under such a load."""
    cubic = np.roots([np.pi * pressure, 0.0, -compressed, -torque])
    return float(np.max(cubic[np.isreal(cubic)].real))
