"""One mission row by row, in one program: an arm, an operator, and the air."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from .._program import program
from .._typing import Array, Bool, Float, Int, Scalar
from ..arm import Arm, tip_position, touch
from ..models import Pinhole, View
from ..simulation import Moment, Stepper
from ._opening import Opening
from ._operator import Operator
from ._tracking import Sight


class Rows(NamedTuple):
    """What happened, row by row.

    Attributes:
        time: s.
        state: of the joints and of what sticks, as of `Moment`.
        command: commanded angles, rad.
        tip: where it is, m.
        believed: where the operator believes the camera to be, m.
        corners: of the opening that are in the picture.
        pressing: force of obstacles on each link, N.
        inside: for how long the tip has been inside, s.
    """

    time: Float[Array, " row"]
    state: Float[Array, "row part joint"]
    command: Float[Array, "row joint"]
    tip: Float[Array, "row 3"]
    believed: Float[Array, "row 3"]
    corners: Int[Array, " row"]
    pressing: Float[Array, "row link"]
    inside: Float[Array, " row"]


class Task(NamedTuple):
    """What is to be done, and how it is computed.

    Attributes:
        opening: to go through.
        beyond: how far behind its outer face the tip is inside, m.
        hold: for how long it must be there, s.
        interval: between two decisions, s.
        tolerance: of the motion, as of `Stepper`.
    """

    opening: Opening
    beyond: Scalar
    hold: Scalar
    interval: Scalar
    tolerance: Scalar


class _Picture(NamedTuple):
    """What a camera shows, and what was commanded then.

    Attributes:
        pixels: of the opening's corners.
        seen: which of them are in the picture.
        room: whether it shows what is behind the opening.
        commanded: where commands would have the camera.
    """

    pixels: Float[Array, "4 2"]
    seen: Bool[Array, "4"]
    room: Bool[Array, ""]
    commanded: View


class _Now(NamedTuple):
    """Where a mission is: the arm, pictures on their way (the oldest first), and the operator."""

    moment: Moment
    pictures: _Picture
    sight: Sight
    blind: Scalar
    inside: Scalar


@program
def flight(
    arm: Arm,
    drawn: Arm,
    camera: Pinhole,
    operator: Operator,
    task: Task,
    wind: Float[Array, "row width"],
    error: Float[Array, "row 4 2"],
    *,
    late: int,
) -> Rows:
    """A mission until its end; rows after that are as the last one.

    Arguments:
        arm: as it is.
        drawn: as the operator takes it to be.
        camera: at its tip.
        operator: who drives.
        task: what is to be done.
        wind: velocity of the air at the beginning and at the end of each interval, m/s.
        error: of what the operator sees in each, px.
        late: of pictures, in intervals.
    """
    opening, interval = task.opening, task.interval
    stepper = Stepper(arm, interval, tolerance=task.tolerance)

    def is_inside(angles: Array) -> Bool[Array, ""]:
        local = opening.local(tip_position(arm, angles))
        return (local[0] < -task.beyond) & (opening.beside(local) == 0)

    def picture(moment: Moment, error: Array) -> _Picture:
        view = camera.view(arm, moment.angles)
        found = camera.project_from(view, opening.corners)
        # From behind the wall its outer face is hidden.
        seen = camera.sees(found) & (opening.local(view.centre)[0] > 0)
        commanded = camera.view(drawn, moment.command)
        return _Picture(found.pixels + error, seen, is_inside(moment.angles), commanded)

    def advanced(now: _Now, blowing: Array, error: Array) -> _Now:
        newest = picture(now.moment, error)
        pictures = jax.tree.map(
            lambda queue, last: jnp.concatenate([queue[1:], last[None]]), now.pictures, newest
        )
        shown = jax.tree.map(lambda queue: queue[0], pictures)
        sight = operator.tracking.corrected(
            operator.tracking.later(now.sight, interval),
            camera, opening, shown.pixels, shown.seen, shown.commanded, interval,
        )  # fmt: skip
        blind = jnp.where(jnp.sum(shown.seen) >= 2, 0, now.blind + interval)
        before = now.moment.command
        command = operator.commands(drawn, camera, opening, before, sight, blind, interval)
        moment = stepper.advance(now.moment, jnp.where(shown.room, before, command), blowing)
        inside = jnp.where(is_inside(moment.angles), now.inside + interval, 0)
        return _Now(moment, pictures, sight, blind, inside)

    def row(now: _Now, given: tuple[Array, Array]) -> tuple[_Now, Rows]:
        # A motion that is lost would be tried again with ever shorter steps, to no end.
        lost = ~jnp.all(jnp.isfinite(now.moment.state))
        done = (now.inside >= task.hold) | lost
        now = jax.lax.cond(done, lambda: now, lambda: advanced(now, *given))
        moment, state = now.moment, now.moment.state
        pressed = jnp.zeros_like(moment.angles)
        if arm.contact is not None:
            skin = state[-arm.contact.rows :] if arm.contact.rows else None
            pressed = touch(arm, moment.angles, moment.rates, skin).normal
        return now, Rows(
            time=moment.time,
            state=state,
            command=moment.command,
            tip=tip_position(arm, moment.angles),
            believed=now.sight.view.centre,
            corners=jnp.sum(now.pictures.seen[-1]),
            pressing=pressed,
            inside=now.inside,
        )

    moment = stepper.start(wind=wind[0])
    first = picture(moment, jnp.zeros_like(error[0]))
    waiting = jax.tree.map(lambda x: jnp.broadcast_to(x, (late + 1, *x.shape)), first)
    now = _Now(
        moment,
        waiting,
        operator.tracking.start(first.commanded),
        operator.patience + interval,
        jnp.zeros_like(interval),
    )
    return jax.lax.scan(row, now, (wind[1:], error))[1]
