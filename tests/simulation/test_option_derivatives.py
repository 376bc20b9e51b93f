"""Derivatives of `simulate` from rest by every number of an arm with all options enabled."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from giajax.mechanics.arm import takeichi_20m_full
from giajax.schema.parameters import declared, left_out, replace
from giajax.simulation import joint_ramps, ramps, simulate
from peers.arms import full_arm

LINKS = 2
TIMES = np.linspace(0.0, 1.0, 6)
# The ramp continues to the end. Links that reverse would be at rest in still air for an instant,
# where the drag has a kink that limits the accuracy of any integrator.
COMMAND = joint_ramps(LINKS, {1: 0.8}, start=0.0, duration=1.5)
# Rounding and different steps limit the accuracy of the differences.
TIGHT = 1e-13


def uneven():
    """An arm without symmetry in a changing wind, in which all parts move."""
    wind = ramps([0.0, 1.0], [[0.2, -0.1, 0.3], [0.5, 0.2, 0.1]])
    drives = {"joints.drive_lag": 0.3, "joints.drive_gain": 0.9, "joints.drive_saturation": 0.2}
    drives |= {"joints.stiffness_factor": 1.1, "joints.stiffness_drift": 0.2}
    drives |= {"joints.memory.initial": 0.0, "buoyancy.imbalance_drift": 0.05}
    return replace(full_arm(LINKS), drives), wind


def floating():
    """The paper's arm in its air: straight, at rest and floating when the command starts.

    At rest, |V| V has its kink, and joint friction has its largest slope.
    """
    options = {
        "air.wind": [0.0, 0.0, 0.0],
        "buoyancy.imbalance": 0.0,
        "joints.friction": 0.05,
        "joints.friction_rate": 0.3,
        "joints.armature": 0.01,
        # The motion is smooth around 0, including slightly negative values.
        "joints.drive_lag": 0.0,
        "joints.drive_gain": 1.0,
        "joints.drive_saturation": 0.0,
        "joints.memory.initial": 0.0,
        "buoyancy.imbalance_drift": 0.0,
        "joints.stiffness_factor": 1.0,
        "joints.stiffness_drift": 0.0,
    }
    # With the drag curve, C_D is so large initially that the difference would have to be tiny.
    arm = takeichi_20m_full(LINKS, drag_curve="constant", parameters=options)
    camera = {
        "point_masses.left": jnp.zeros(1),
        "point_masses.up": jnp.zeros(1),
        "point_masses.drag_area": jnp.full(1, 0.002),
    }
    return replace(arm, camera), None


ARMS = {"uneven": uneven, "floating": floating}


@eqx.filter_jit
def motion(arm, wind):
    options = {"solver": "dopri8", "rtol": TIGHT, "atol": TIGHT, "throw": False}
    options["steps_for"] = "derivatives"
    found = simulate(arm, COMMAND, TIMES, wind=wind, **options)
    return jnp.concatenate([found.angles.ravel(), found.rates.ravel()])


@eqx.filter_jit
def shifted(arm, wind, steps):
    """Return motions of arms with slightly changed parameters, one per row; `steps` are flat."""
    flat, unflatten = ravel_pytree(arm)
    return jax.vmap(lambda step: motion(unflatten(flat + step), wind))(steps)


@eqx.filter_jit
def columns(arm, wind):
    flat, unflatten = ravel_pytree(arm)

    def push(direction):
        return jax.jvp(lambda x: motion(unflatten(x), wind), (flat,), (direction,))[1]

    return jax.vmap(push)(jnp.eye(flat.size))


def labels(arm):
    """Return the path of every number of the arm, in the order of the flattened arm."""
    numbered = {}
    for path, parameter in declared(arm).items():
        for index in range(np.size(parameter.value(arm))):
            numbered[(path, index)] = parameter
    return [f"{path}[{index}]" for path, index in numbered]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param("uneven", marks=pytest.mark.slow),
        # The same numbers, with everything initially at rest.
        pytest.param("floating", marks=pytest.mark.long),
    ],
)
def test_every_number_of_the_arm_has_the_derivative_that_differences_show(name):
    arm, wind = ARMS[name]()
    # Joints with hysteresis have corners, and are tested separately.
    assert all(absent.declaration.has_states for absent in left_out(arm).values())
    flat, _ = ravel_pytree(arm)
    names = labels(arm)
    assert len(names) == flat.size
    found = np.asarray(columns(arm, wind))
    assert np.all(np.isfinite(found))
    # Each difference moves the arm by about 1e-5. This is far above the integration errors, and
    # small enough for |V| V of the parts that start to move.
    moved = np.maximum(np.abs(found).max(axis=1), 1e-9)
    sizes = np.minimum(1e-5 / moved, np.where(flat == 0, 2e-6, 1e-3 * np.abs(flat)))
    steps = np.concatenate([np.diag(sizes), -np.diag(sizes)])
    forth, back = np.split(np.asarray(shifted(arm, wind, jnp.asarray(steps))), 2)
    expected = (forth - back) / (2 * sizes[:, None])
    still, wrong = [], {}
    for label, column, difference in zip(names, found, expected, strict=True):
        scale = np.abs(difference).max()
        if scale < 1e-6:
            still.append(label)
        error = np.abs(column - difference).max() / max(scale, 0.1)
        if error > 1e-5:
            wrong[label] = error
    assert wrong == {}
    if name == "uneven":
        # The gas of links has an effect only in contact, which does not occur here.
        acting = ("joints.memory.", "joints.stops.", "links.pressure[")
        assert all(label.startswith(acting) for label in still)
