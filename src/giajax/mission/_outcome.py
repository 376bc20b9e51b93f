"""What came of a mission."""

import dataclasses
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from .._program import program
from .._typing import Array, Float
from ..arm import Arm, tip_position, touched
from ._flight import Rows

if TYPE_CHECKING:
    from ._mission import Mission

# Rows whose contacts are computed at once.
_CHUNK = 64


@dataclasses.dataclass(frozen=True)
class Touched:
    """What an obstacle did to the arm.

    Attributes:
        obstacle: its name.
        links: numbers of the links that touched it.
        duration: of any contact, s.
        flattening: of a link at most, m.
        force: on a link at most, N.
        impulse: of all forces on all links, by their size, N s.
    """

    obstacle: str
    links: tuple[int, ...]
    duration: float
    flattening: float
    force: float
    impulse: float


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What came of a mission.

    Attributes:
        reached: time from which on the tip was inside, s; None: it was not, for as long as needed.
        reason: why not; empty where it was.
        nearest: distance of the tip from the middle of the opening at the least, m.
        touched: what each obstacle did.
        times: of the rows below, s, from 0 until the end of the mission.
        angles: of the joints, rad.
        rates: of the joints, rad/s.
        command: commanded angles, rad.
        wind: velocity of the air at the links, m/s.
        tip: where it was, m.
        believed: where the operator believed the camera to be, m.
        corners: of the opening that were in the picture.
    """

    reached: float | None
    reason: str
    nearest: float
    touched: tuple[Touched, ...]
    times: Float[np.ndarray, " row"]
    angles: Float[np.ndarray, "row joint"]
    rates: Float[np.ndarray, "row joint"]
    command: Float[np.ndarray, "row joint"]
    wind: Float[np.ndarray, "row width"]
    tip: Float[np.ndarray, "row 3"]
    believed: Float[np.ndarray, "row 3"]
    corners: Float[np.ndarray, " row"]

    @property
    def flattening(self) -> float:
        """Of any link at most, m."""
        return max((each.flattening for each in self.touched), default=0.0)


def outcome_of(mission: "Mission", rows: Rows, wind: Float[np.ndarray, "row width"]) -> Outcome:
    """What rows of a mission, and the air in it, come to."""
    table: Rows = jax.tree.map(np.asarray, rows)
    section = mission.section
    held = table.inside >= section.hold_s
    end = int(np.argmax(held)) + 1 if held.any() else len(held)
    table = jax.tree.map(lambda each: each[:end], table)
    arm = mission.model.arm
    begun = np.asarray(tip_position(arm, jnp.zeros(arm.count)))
    reached = float(mission.times[end] - table.inside[-1]) if held.any() else None
    sound = np.all(np.isfinite(table.state), axis=(1, 2))
    local = np.asarray(mission.opening.local(jnp.asarray(table.tip)))
    gap = np.linalg.norm(local, axis=1)[sound]
    nearest = float(gap.min()) if gap.size else np.nan
    return Outcome(
        reached=reached,
        reason="" if reached is not None else _reason(table, bool(sound.all()), nearest),
        nearest=nearest,
        touched=_touched(arm, table),
        times=mission.times[: end + 1],
        angles=_from_rest(table.state[:, 0]),
        rates=_from_rest(table.state[:, 1]),
        command=_from_rest(table.command),
        wind=wind[: end + 1],
        tip=_from_rest(table.tip, begun),
        believed=_from_rest(table.believed, begun),
        corners=_from_rest(table.corners),
    )


def _from_rest(rows: Any, first: np.ndarray | float = 0.0) -> np.ndarray:
    """Rows with what was before them: the straight arm at rest."""
    return np.concatenate([np.broadcast_to(first, rows[:1].shape).astype(rows.dtype), rows])


def _reason(rows: Rows, sound: bool, nearest: float) -> str:
    """Why a mission failed, in a few words that many share."""
    if not sound:
        return "its motion could not be followed"
    if not np.any(rows.corners >= 2):
        return "the opening never came into view"
    if np.any(rows.inside > 0):
        return "the tip came in, and did not stay"
    if nearest > 1.5:
        return "the tip did not come near"
    return "the tip came near, and not in"


def _touched(arm: Arm, rows: Rows) -> tuple[Touched, ...]:
    """What obstacles did, from the rows in which something pressed."""
    if arm.contact is None:
        return ()
    when = np.flatnonzero(np.any(rows.pressing > 0, axis=1))
    names = [each.name for each in arm.contact.obstacles]
    deep = np.zeros((len(when), arm.count, len(names)))
    force = np.zeros_like(deep)
    for first in range(0, len(when), _CHUNK):
        some = when[first : first + _CHUNK]
        # Of one size, so that there is one program.
        padded = np.resize(some, _CHUNK)
        flat, push = _contacts(arm, jnp.asarray(rows.state[padded]))
        deep[first : first + len(some)] = np.asarray(flat)[: len(some)]
        force[first : first + len(some)] = np.linalg.norm(push, axis=-1)[: len(some)]
    interval = float(rows.time[1] - rows.time[0]) if len(rows.time) > 1 else 0.0
    return tuple(
        Touched(
            obstacle=name,
            links=tuple((np.flatnonzero(deep[:, :, k].any(axis=0)) + 1).tolist()),
            duration=interval * int(deep[:, :, k].any(axis=1).sum()),
            flattening=float(deep[:, :, k].max(initial=0.0)),
            force=float(force[:, :, k].max(initial=0.0)),
            impulse=interval * float(force[:, :, k].sum()),
        )
        for k, name in enumerate(names)
    )


@program
def _contacts(arm: Arm, states: Float[Array, "row part joint"]) -> tuple[Array, Array]:
    assert arm.contact is not None
    rows = arm.contact.rows

    def one(state: Array) -> tuple[Array, Array]:
        return touched(arm, state[0], state[1], state[-rows:] if rows else None)

    return jax.vmap(one)(states)
