"""Derivatives of `simulate` in both modes, compared with differences, in motion and from rest."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.mechanics.arm import takeichi_20m
from giajax.schema.parameters import replace
from giajax.simulation import constant, joint_ramps, joint_steps, simulate

LINKS = 3
TIMES = np.linspace(0.0, 3.0, 16)
ARM = takeichi_20m(LINKS)
UNIT = joint_ramps(LINKS, {1: 1.0, 2: 1.0, 3: 1.0}, start=0.5, duration=1.0)

# All inputs that are differentiated, as one flat vector in this order.
MOVING = {
    "air.drag_coefficient": 1.2,
    "joints.pitch_stiffness": 3.0,
    "joints.yaw_stiffness": 30.0,
    "joints.damping": 0.05,
    "links.mass": [0.05, 0.04, 0.06],
    "base_rotation": [0.1, -0.2, 0.3],
    "gravity": 0.5,
    "wind": [0.2, -0.1, 0.3],
    "command": [0.5, 0.3, 0.0],
    "angles": [0.1, -0.2, 0.3],
    "rates": [0.5, 0.2, -0.4],
}
# Straight and at rest in still air without gravity, where |V| V has its kink; then a planar motion.
# The motion alone would allow steps that are unstable for the derivatives.
AT_REST = MOVING | {
    "base_rotation": [0.0, 0.0, 0.0],
    "gravity": 0.0,
    "wind": [0.0, 0.0, 0.0],
    "command": [0.5, 0.0, 0.0],
    "angles": [0.0, 0.0, 0.0],
    "rates": [0.0, 0.0, 0.0],
}
SIZES = {name: np.size(value) for name, value in MOVING.items()}
LABELS = [f"{name}[{i}]" for name, size in SIZES.items() for i in range(size)]


def flat(point):
    return jnp.asarray(np.concatenate([np.atleast_1d(value) for value in point.values()]))


def motion(vector, tolerance, derivatives):
    ends = np.cumsum([0, *SIZES.values()])
    part = {
        name: vector[start] if np.ndim(MOVING[name]) == 0 else vector[start:end]
        for name, start, end in zip(SIZES, ends[:-1], ends[1:], strict=True)
    }
    arm = replace(ARM, {name: value for name, value in part.items() if name in PATHS})
    command = eqx.tree_at(
        lambda signal: (signal.values, signal.slopes),
        UNIT,
        tuple(x * part["command"][None] for x in (UNIT.values, UNIT.slopes)),
    )
    found = simulate(
        arm,
        command,
        TIMES,
        wind=part["wind"],
        initial=(part["angles"], part["rates"]),
        rtol=tolerance,
        atol=tolerance,
        derivatives=derivatives,
        steps_for="derivatives",
        throw=False,
    )
    return jnp.concatenate([found.angles.ravel(), found.rates.ravel()])


PATHS = [name for name in MOVING if "." in name or name in ("base_rotation", "gravity")]


# These have no effect at one of the two points: yaw springs in a planar motion, rotation in calm.
WITHOUT_EFFECT = ("joints.yaw_stiffness", "base_rotation")


@eqx.filter_jit
def forward_jacobian(vector, tolerance):
    def push(direction):
        return jax.jvp(lambda x: motion(x, tolerance, "forward"), (vector,), (direction,))[1]

    return jax.vmap(push, out_axes=1)(jnp.eye(vector.size))


@eqx.filter_jit
def reverse_gradient(vector, cotangent, tolerance):
    return jax.grad(lambda x: cotangent @ motion(x, tolerance, "reverse"))(vector)


@eqx.filter_jit
def value(vector, tolerance):
    return motion(vector, tolerance, "forward")


# Rounding and different steps limit the accuracy of the differences.
TIGHT = jnp.asarray(1e-13)
# Reverse mode integrates again from its checkpoints. With the compiler options of the tests,
# rounding differs there, so steps would differ if their errors were not well above rounding.
REPEATED = jnp.asarray(1e-9)


@pytest.fixture(scope="module", params=["moving", "at rest"])
def point(request):
    """Return a point and the Jacobian there by central differences."""
    vector = flat(MOVING if request.param == "moving" else AT_REST)
    # Small differences for values of 0, because the error due to |V| V is of first order there.
    sizes = np.where(vector == 0, 7e-7, 1e-4 * np.abs(vector))
    columns = [
        (value(vector.at[i].add(h), TIGHT) - value(vector.at[i].add(-h), TIGHT)) / (2 * h)
        for i, h in enumerate(sizes)
    ]
    return vector, np.stack(columns, axis=1)


@pytest.mark.slow
def test_forward_mode_is_the_difference(point):
    vector, expected = point
    found = forward_jacobian(vector, TIGHT)
    assert np.all(np.isfinite(found))
    for label, column, difference in zip(LABELS, found.T, expected.T, strict=True):
        scale = np.abs(difference).max()
        assert scale > 1e-3 or label.startswith(WITHOUT_EFFECT), label
        assert_allclose(column, difference, rtol=0, atol=1e-5 * max(scale, 0.1), err_msg=label)


@pytest.mark.slow
def test_reverse_mode_is_the_difference(point):
    vector, expected = point
    cotangent = jnp.asarray(np.random.default_rng(0).normal(size=expected.shape[0]))
    found = reverse_gradient(vector, cotangent, REPEATED)
    scale = np.abs(expected).T @ np.abs(cotangent)
    assert np.all(np.isfinite(found))
    error = np.abs(found - cotangent @ expected) / np.maximum(scale, 1.0)
    assert error.max() < 1e-5, dict(zip(LABELS, error, strict=True))


@pytest.mark.slow
def test_the_default_tolerance_is_enough_for_a_fit():
    found = forward_jacobian(flat(MOVING), jnp.asarray(1e-6))
    tight = forward_jacobian(flat(MOVING), TIGHT)
    assert np.all(np.abs(found - tight) < 1e-3 * np.abs(tight).max(axis=0))


@pytest.mark.slow
def test_nothing_has_moved_before_the_command():
    """At rest until 0.5 s, no parameter has an effect, and a wind of zero has no derivative."""
    jacobian = np.asarray(forward_jacobian(flat(AT_REST), TIGHT))
    early = np.tile(np.repeat(TIMES <= 0.5, LINKS), 2)
    for label, column in zip(LABELS, jacobian.T, strict=True):
        moves = label.startswith(("angles", "rates", "gravity"))
        assert np.any(column[early] != 0) == moves, label
        assert np.any(column[~early] != 0) or label.startswith(WITHOUT_EFFECT), label


# raising.py tests the reverse case, which is refused while the program runs.
@pytest.mark.parametrize("compiled", [False, True])
def test_forward_through_a_reverse_simulation_is_refused_with_a_sentence(compiled):
    def last_angle(coefficient):
        arm = replace(ARM, {"air.drag_coefficient": coefficient})
        command = joint_steps(LINKS, {1: 0.5})
        return simulate(arm, command, TIMES, derivatives="reverse").angles[-1, 0]

    derivative = jax.jacfwd(last_angle)
    with pytest.raises(TypeError, match=r"call it with derivatives='forward', or use jax\.grad"):
        (jax.jit(derivative) if compiled else derivative)(1.2)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["command", "wind", "initial"])
def test_the_refusal_covers_every_input(part):
    def last(x):
        command = joint_steps(LINKS, {1: 0.5})
        still = (jnp.zeros(LINKS), jnp.zeros(LINKS))
        inputs = {"command": command, "wind": constant(np.zeros(3)), "initial": still}
        inputs[part] = jax.tree.map(lambda leaf: leaf + x, inputs[part])
        options = {"derivatives": "reverse", "steps_for": "derivatives", "throw": False}
        return simulate(ARM, times=TIMES, **inputs, **options).rates[-1, 0]

    with pytest.raises(TypeError, match="derivatives='forward'"):
        jax.jvp(last, (0.0,), (1.0,))
