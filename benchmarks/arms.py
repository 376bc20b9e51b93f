"""The arms and commands that the comparisons are made on."""

import jax.numpy as jnp
import numpy as np

import giajax.parameters
from giajax.arm import Arm, chain, takeichi_20m
from giajax.simulation import Signal, joint_ramps


def driven_arm(links: int = 20) -> tuple[Arm, Signal]:
    """The paper's arm, joints 1 and 2 driven to 30 and 20 deg in 1 s from 0.5 s on."""
    target = {1: float(np.deg2rad(30)), 2: float(np.deg2rad(20))}
    return takeichi_20m(links), joint_ramps(links, target, start=0.5, duration=1.0)


def general_arm(links: int, seed: int = 0) -> Arm:
    """An arm with nothing special about it: no two links, axes or inertias alike, in gravity.

    The transverse inertia is more than half the axial one, as for every body that exists.
    """
    random = np.random.default_rng(seed)

    def per_link(lower: float, upper: float) -> np.ndarray:
        return random.uniform(lower, upper, links)

    length, mass, axial = per_link(0.5, 1.5), per_link(0.02, 0.1), per_link(5e-4, 2e-3)
    arm = chain(
        links,
        length=length,
        diameter=per_link(0.1, 0.5),
        mass=mass,
        centre_of_mass=length * per_link(0.1, 0.9),
        inertia_transverse=axial * per_link(0.6, 1.0) + mass * length**2 * per_link(0.02, 0.1),
        inertia_axial=axial,
        joint_axes=random.normal(size=(links, 3)).tolist(),
        base_rotation=random.normal(size=3),
        gravity=1.7,
        air_density=1.1,
    )
    return giajax.parameters.replace(
        arm,
        {
            "air.drag_coefficient": 0.9,
            "joints.pitch_stiffness": 2.0,
            "joints.yaw_stiffness": 7.0,
            "joints.damping": 0.04,
        },
    )


def random_states(links: int, count: int, seed: int = 1) -> dict[str, jnp.ndarray]:
    """Angles, rates, commands and winds of large movements; the leading axis counts states."""
    random = np.random.default_rng(seed)
    return {
        "angles": jnp.asarray(random.uniform(-1.5, 1.5, (count, links))),
        "rates": jnp.asarray(random.normal(size=(count, links))),
        "command": jnp.asarray(random.uniform(-1.0, 1.0, (count, links))),
        "wind": jnp.asarray(random.normal(size=(count, 3))),
    }
