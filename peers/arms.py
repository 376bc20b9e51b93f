"""Arms, commands and states for comparisons with the independent implementations."""

import jax.numpy as jnp
import numpy as np

from giajax.mechanics.arm import Arm, PointMasses, chain, takeichi_20m
from giajax.simulation import Signal, joint_ramps


def driven_arm(links: int = 20) -> tuple[Arm, Signal]:
    """Return the paper's arm and a command: joints 1, 2 turn to 30, 20 deg from 0.5 s to 1.5 s."""
    target = {1: float(np.deg2rad(30)), 2: float(np.deg2rad(20))}
    return takeichi_20m(links), joint_ramps(links, target, start=0.5, duration=1.0)


def general_arm(links: int, seed: int = 0) -> Arm:
    """Return a random arm without symmetries: all links, axes and inertias differ; with gravity.

    The transverse moment of inertia is more than half of the axial one, as for every real body.
    """
    random = np.random.default_rng(seed)

    def per_link(lower: float, upper: float) -> np.ndarray:
        return random.uniform(lower, upper, links)

    length, mass, axial = per_link(0.5, 1.5), per_link(0.02, 0.1), per_link(5e-4, 2e-3)
    return chain(
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
        parameters={
            "air.drag_coefficient": 0.9,
            "joints.pitch_stiffness": 2.0,
            "joints.yaw_stiffness": 7.0,
            "joints.damping": 0.04,
        },
    )


def full_arm(links: int, seed: int = 0) -> Arm:
    """Return a random arm with all options: air effects, buoyancy, masses off the axis, friction.

    The density of the air is low, because the random links can be large and their lift would
    otherwise carry the arm away.
    """
    random = np.random.default_rng(seed + 1)
    plain = general_arm(links, seed)
    bodies = PointMasses(
        links=(1, links, links),
        mass=jnp.asarray(random.uniform(0.005, 0.02, 3)),
        position=jnp.asarray(random.uniform(0.2, 0.6, 3)),
        left=jnp.asarray(random.uniform(-0.1, 0.1, 3)),
        up=jnp.asarray(random.uniform(-0.2, 0.1, 3)),
        drag_area=jnp.asarray([0.03, 0.01, 0.02]),
    )
    options = {
        "air.drag_coefficient": 0.9,
        "air.axial_coefficient": 0.05,
        "air.added_mass_coefficient": 0.8,
        "air.wind": [0.1, -0.2, 0.05],
        "joints.pitch_stiffness": 2.0,
        "joints.yaw_stiffness": 7.0,
        "joints.damping": 0.04,
        "joints.friction": 0.02,
        "joints.friction_rate": 0.3,
        "joints.armature": 0.003,
        "links.fullness": 0.9,
        "buoyancy.trim_mass": 0.01,
        "buoyancy.trim_depth": 0.15,
        "buoyancy.imbalance": 0.005,
    }
    return chain(
        links,
        length=plain.links.length,
        diameter=plain.links.diameter,
        mass=plain.links.mass,
        centre_of_mass=plain.links.centre_of_mass,
        inertia_transverse=plain.links.inertia_transverse,
        inertia_axial=plain.links.inertia_axial,
        joint_axes=[list(axis) for axis in plain.joints.axes],
        base_rotation=plain.base_rotation,
        gravity=1.7,
        air_density=0.4,
        drag="strip",
        drag_curve="cylinder",
        buoyancy=True,
        point_masses=bodies,
        parameters=options,
    )


def random_states(links: int, count: int, seed: int = 1) -> dict[str, jnp.ndarray]:
    """Return random states of large motions: angles, rates, commands and winds.

    The first axis of each array is the index of the state.
    """
    random = np.random.default_rng(seed)
    return {
        "angles": jnp.asarray(random.uniform(-1.5, 1.5, (count, links))),
        "rates": jnp.asarray(random.normal(size=(count, links))),
        "command": jnp.asarray(random.uniform(-1.0, 1.0, (count, links))),
        "wind": jnp.asarray(random.normal(size=(count, 3))),
    }
