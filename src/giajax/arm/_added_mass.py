"""Added mass: the air that a link must move out of its way (Kirchhoff)."""

from typing import NamedTuple

from .._maths import cross, dot, scaled
from .._typing import Array, Float
from ._air import Flow, across_link
from ._arm import Arm
from ._kinematics import Pose, Rows


class AddedMass(NamedTuple):
    """The fluid that a link moves, a rod that has inertia across the link alone.

    A long cylinder with added-mass coefficient C_a moves C_a times the air that it displaces
    when it moves across itself, and none along itself (Lamb, Hydrodynamics, art. 42; Newman,
    Marine Hydrodynamics, sec. 4.15). Its kinetic energy is that of this rod, and Kirchhoff's
    equations follow from it (Lamb, ch. VI).

    Attributes:
        mass: of the rod, across the link, kg.
        inertia: about the link's centre, across the link, kg m^2.
    """

    mass: Float[Array, " link"]
    inertia: Float[Array, " link"]


def added_mass(arm: Arm) -> AddedMass | None:
    """The rods of all links; None where added mass is left out."""
    if arm.air.added_mass_coefficient is None:
        return None
    mass = arm.air.added_mass_coefficient * arm.air.density * arm.links.volume
    return AddedMass(mass, mass * arm.links.length**2 / 12)


def added_mass_load(
    arm: Arm,
    rod: AddedMass,
    here: Pose,
    relative: Rows,
    turning: Rows,
    omega: Rows,
    alpha: Rows,
    acceleration: Rows,
    wind: Flow,
) -> tuple[Rows, Rows]:
    """Force and couple of the fluid on each link, from the rate of its impulse.

    With the impulse P = m (w - (e.w) e) of the fluid at the link's centre, which moves with w
    through it, and the impulse couple L = J (omega - (e.omega) e), the force is -dP/dt and the
    couple about the centre -(w x P + dL/dt). A wind that changes in time also carries a pressure
    gradient, which pushes the displaced volume: rho V du/dt.

    Arguments:
        arm: the arm.
        rod: its added mass.
        here: its pose.
        relative: velocity of the links' centres relative to the air.
        turning: rate of change of the links' directions.
        omega, alpha: angular velocity and acceleration of the links.
        acceleration: of the links' centres.
        wind: its rate of change counts here.
    """
    e = here.direction
    through = acceleration - wind.rate

    def rate_of_across(vector: Rows, rate: Rows) -> Rows:
        """d/dt of the part of a vector that is normal to the link."""
        along = dot(turning, vector) + dot(e, rate)
        return rate - scaled(along, e) - scaled(dot(e, vector), turning)

    impulse = scaled(rod.mass, across_link(e, relative))
    force = -scaled(rod.mass, rate_of_across(relative, through))
    force = force + scaled(arm.air.density * arm.links.volume, wind.rate)
    couple = scaled(rod.inertia, rate_of_across(omega, alpha)) + cross(relative, impulse)
    return force, -couple
