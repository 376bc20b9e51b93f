"""Numbers of the paper's arm for the C implementations: a chain, springs, dampers and drag."""

from collections.abc import Mapping

import numpy as np

from giajax.mechanics.arm import Arm
from giajax.simulation import Signal

Array = np.ndarray

DRAG, PITCH, YAW, DAMPING = PARAMETERS = (
    "air.drag_coefficient",
    "joints.pitch_stiffness",
    "joints.yaw_stiffness",
    "joints.damping",
)


class PlainArm:
    """Numbers of an `Arm` with links, springs, dampers and drag at the centres of the links.

    Raises:
        ValueError: the arm has other parts.
    """

    def __init__(self, arm: Arm) -> None:
        more = {
            "buoyancy": arm.buoyancy,
            "point masses": arm.point_masses,
            "friction": arm.joints.friction,
            "armature": arm.joints.armature,
            "wind": arm.air.wind,
            "added mass": arm.air.added_mass_coefficient,
            "drag along the links": None if arm.air.drag == "centre" else arm.air.drag,
            "a drag curve": None if arm.air.drag_curve == "constant" else arm.air.drag_curve,
        }
        if extra := [name for name, value in more.items() if value is not None]:
            raise ValueError(f"the peers in C do not have {', '.join(extra)}: leave it out")
        self.count = arm.count
        links, joints = arm.links, arm.joints
        self.length, self.mass, self.centre, self.transverse, self.axial = (
            np.ascontiguousarray(x, dtype=float)
            for x in (
                links.length,
                links.mass,
                links.centre_of_mass,
                links.inertia_transverse,
                links.inertia_axial,
            )
        )
        self.axes = np.asarray(joints.axes, dtype=float)
        self.base_rotation = np.array(arm.base_rotation, dtype=float)
        self.gravity = float(arm.gravity)
        self.yaws = np.abs(self.axes[:, 2]) > np.sqrt(0.5)
        # 1/2 rho L d, the factor of C_D |V| V.
        self.per_coefficient = (
            0.5 * float(arm.air.density) * np.asarray(links.length * links.diameter, dtype=float)
        )
        self.parameters: dict[str, float] = {
            DRAG: float(arm.air.drag_coefficient),
            PITCH: float(joints.pitch_stiffness),
            YAW: float(joints.yaw_stiffness),
            DAMPING: float(joints.damping),
        }

    def drag_factor(self, parameters: Mapping[str, float]) -> Array:
        """Return 1/2 rho C_D L d of each link, N s^2/m^2."""
        return parameters[DRAG] * self.per_coefficient

    def stiffness_and_damping(self, parameters: Mapping[str, float]) -> tuple[Array, Array]:
        """Return the stiffness, N m/rad, and the damping, N m s/rad, of each joint."""
        stiffness = np.where(self.yaws, parameters[YAW], parameters[PITCH])
        return stiffness, np.full(self.count, parameters[DAMPING])


def command_on_steps(command: Signal, times: Array, step: float) -> tuple[Array, Array, Array]:
    """Return the step numbers of samples and corners, and the line segments of a command.

    Returns:
        Step numbers of the samples, counted from 0; step numbers at which line segments begin; the
        line segments, shape (line, 2, joint), each with its value at the corner and its slope.
    """
    knots, values, slopes = (
        np.asarray(x, dtype=float) for x in (command.times, command.values, command.slopes)
    )
    # Before its first knot, a command has its first value.
    first = np.stack([values[0], np.zeros_like(values[0])])[None]
    lines = np.concatenate([first, np.stack([values, slopes], axis=1)])
    later = knots > 0
    begin = int(np.count_nonzero(~later))
    start = lines[begin].copy()
    if begin:
        start[0] += start[1] * -knots[begin - 1]
    lines = np.concatenate([start[None], lines[begin + 1 :]])
    corners = np.concatenate([[0.0], knots[later]])
    inside = corners < times[-1]
    return (
        _whole(times / step, "times"),
        _whole(corners[inside] / step, "corners"),
        np.ascontiguousarray(lines[inside]),
    )


def _whole(steps: Array, what: str) -> Array:
    counts = np.round(steps).astype(np.int64)
    if np.abs(steps - counts).max(initial=0) > 1e-6:
        raise ValueError(f"the {what} do not fall on steps; choose a step that divides them")
    return counts
