"""The paper's equations (2) to (11) as residuals, for points that are rotated in NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax.mechanics.joint import (
    BRANCHES,
    Correction,
    Joint,
    JointGeometry,
    branch_angles,
    muscle_path,
    muscle_state,
)

DEGREES = np.linspace(-60, 60, 241)
READINGS = ("continuous", "none")


def turned(x, y, angle):
    """Return a point of the right link in the frame of the bisector, 3D, shape (angle, 3)."""
    half = angle / 2
    rotation = np.array([[np.cos(half), -np.sin(half)], [np.sin(half), np.cos(half)]])
    return np.stack([*np.einsum("ijk,j->ik", rotation, [x, y]), 0 * angle], axis=-1)


class Points:
    """The paper's points, right half and mirror image, from the dimensions of the geometry."""

    def __init__(self, geometry, angle):
        def point(name):
            return turned(
                float(getattr(geometry, f"{name}_x")), float(getattr(geometry, f"{name}_y")), angle
            )

        mirror = np.array([-1.0, 1.0, 1.0])
        self.C = self.N = point("anchor")
        self.D = point("wire")
        self.Q = point("contact")
        self.A = self.M = self.C * mirror
        self.B, self.P = self.D * mirror, self.Q * mirror


def norm(vector):
    return np.linalg.norm(vector, axis=-1)


def unit(tail, head):
    return (head - tail) / norm(head - tail)[:, None]


def on_bisector(y):
    return np.stack([0 * y, y, 0 * y], axis=-1)


def torque_residual(at, joint_torque):
    """Return the residual of the torque relative to 0.3 N m."""
    return np.abs(at[:, 2] - joint_torque) / 0.3


def largest(residual):
    return np.max(np.abs(residual), initial=0.0)


@pytest.fixture(params=READINGS)
def joint(request):
    return Joint(correction=Correction(reading=request.param))


def state_on(joint, branch, degrees=DEGREES):
    """Return state and points at the angles of one branch, as NumPy arrays."""
    angle = np.deg2rad(degrees)
    state = muscle_state(joint, angle)
    chosen = np.asarray(state.branch) == branch
    assert chosen.sum() >= 5, f"{BRANCHES[branch]} is not reached"
    state = jax.tree.map(lambda leaf: np.asarray(leaf)[chosen], state)
    return state, Points(joint.geometry, angle[chosen])


def wanted_torque(joint, state):
    """Return 0.3 + alpha or 0.3 + beta by the paper's formulae, in degrees."""
    degrees = np.rad2deg(state.angle)
    if joint.correction.reading == "none":
        return np.full_like(degrees, 0.3)
    size = np.abs(degrees)
    alpha = np.where(size <= 40, 0.03, 0.03 + (size - 40) ** 2 / 1600)
    beta = np.select(
        [size <= 2, size >= 20], [0.01 * (1 - size / 2), -0.3 * (size - 20) ** 2 / 1600], 0.0
    )
    return 0.3 + np.where(state.path.inner, alpha, beta)


def test_inner_taut_satisfies_equations_2_to_5(joint):
    state, at = state_on(joint, 0)
    length, wire = float(joint.geometry.muscle_length), float(joint.geometry.wire_length)
    H = on_bisector(state.path.height)
    muscle = state.force[:, None] * unit(at.C, H)
    tension = state.wire_tension[:, None] * unit(at.D, H)
    # (2), (3), and the condition that the bush lies outside the ends of the wire.
    assert largest(norm(at.A - H) - (1 - state.contraction) * length / 2) < 1e-12 * length
    assert largest(norm(at.B - H) - wire / 2) < 1e-12 * length
    assert np.all(H[:, 1] > at.D[:, 1])
    # (4): the resultant of the two forces lies along AC.
    assert largest((muscle + tension)[:, 1:]) < 1e-12
    # (5)
    moment = np.cross(at.C, muscle) + np.cross(at.D, tension)
    assert largest(torque_residual(moment, wanted_torque(joint, state))) < 1e-12
    assert np.all(at.C[:, 1] > H[:, 1])
    assert np.all(state.wire_tension >= 0)
    assert np.all(state.path.wire_slack == 0)


def test_inner_slack_satisfies_equations_2_and_6(joint):
    state, at = state_on(joint, 1)
    length, wire = float(joint.geometry.muscle_length), float(joint.geometry.wire_length)
    H = on_bisector(at.C[:, 1])
    assert largest(norm(at.A - H) - (1 - state.contraction) * length / 2) < 1e-12 * length
    muscle = state.force[:, None] * unit(at.C, at.A)
    moment = np.cross(at.C, muscle)
    assert largest(torque_residual(moment, wanted_torque(joint, state))) < 1e-12
    # Here, (3) is an inequality.
    assert np.all(norm(at.B - H) < wire / 2)
    np.testing.assert_allclose(state.path.wire_slack, wire - 2 * norm(at.B - H), atol=1e-15)
    assert np.all(state.wire_tension == 0)


def test_outer_straight_satisfies_equations_8_and_11(joint):
    state, at = state_on(joint, 2)
    length = float(joint.geometry.muscle_length)
    O = on_bisector(at.N[:, 1])  # noqa: E741
    assert largest(norm(at.M - O) - (1 - state.contraction) * length / 2) < 1e-12 * length
    moment = np.cross(at.N, state.force[:, None] * unit(at.N, at.M))
    assert largest(torque_residual(moment, wanted_torque(joint, state))) < 1e-12
    assert np.all(at.N[:, 1] > at.Q[:, 1])  # here, the muscle is on the positive y side
    assert np.all(state.push_x == 0)
    assert np.all(state.push_y == 0)


def test_outer_wrapped_satisfies_equations_7_9_and_10(joint):
    state, at = state_on(joint, 3)
    length, wire = float(joint.geometry.muscle_length), float(joint.geometry.wire_length)
    O = on_bisector(at.Q[:, 1])  # noqa: E741
    half = norm(at.M - at.P) + norm(at.P - O)
    assert largest(half - (1 - state.contraction) * length / 2) < 1e-12 * length
    push = state.force[:, None] * (unit(at.Q, at.N) + unit(at.Q, at.P))
    np.testing.assert_allclose(state.push_x, push[:, 0], atol=1e-14)
    np.testing.assert_allclose(state.push_y, push[:, 1], atol=1e-14)
    muscle = state.force[:, None] * unit(at.N, at.Q)
    moment = np.cross(at.N, muscle) + np.cross(at.Q, push)
    assert largest(torque_residual(moment, wanted_torque(joint, state))) < 1e-12
    assert np.all(at.N[:, 1] < at.Q[:, 1])
    # The muscle presses the balloon inwards, and the wire is slack.
    assert np.all(state.push_y <= 1e-12)
    assert np.all(norm(O - at.D) <= wire / 2)
    np.testing.assert_allclose(state.path.wire_slack, wire - 2 * norm(O - at.D), atol=1e-15)


@pytest.mark.slow
@pytest.mark.parametrize("reading", READINGS)
@pytest.mark.parametrize("side", ["inner", "outer"])
def test_virtual_work(reading, side):
    """F d(length)/d(angle) = -torque: autodiff of the path length gives the lever."""
    joint = Joint(correction=Correction(reading=reading))
    sign = 1 if side == "inner" else -1
    angle = jnp.deg2rad(jnp.asarray(np.linspace(0, sign * 60, 241)))
    inner = jnp.full(angle.shape, side == "inner")
    state = muscle_state(joint, angle, side=side)
    assert len(set(np.asarray(state.branch).tolist())) == 2

    def length(a):
        return muscle_path(joint.geometry, a, inner).length

    slope = jax.jvp(length, (angle,), (jnp.ones_like(angle),))[1]
    np.testing.assert_allclose(-state.force * slope, state.torque, rtol=0, atol=1e-9 * 0.3)
    # The check can fail: the taut muscle does not have the lever of the straight one.
    if side == "inner":
        geometry, half = joint.geometry, angle / 2
        straight = geometry.anchor_x * jnp.sin(half) + geometry.anchor_y * jnp.cos(half)
        assert np.max(np.abs(state.force * straight - state.torque)) > 0.1


def test_the_forces_of_the_design():
    degrees = np.array([60.0, 40.0, 0.0, -20.0, -40.0, -60.0])
    plain = muscle_state(Joint(correction=Correction(reading="none")), np.deg2rad(degrees))
    np.testing.assert_allclose(plain.force, [1.54, 1.42, 1.67, 2.17, 2.46, 2.93], atol=0.006)
    corrected = muscle_state(Joint(), np.deg2rad(degrees))
    np.testing.assert_allclose(corrected.force, [2.97, 1.56, 1.83, 2.17, 1.84, 0.0], atol=0.005)
    outer = muscle_state(Joint(), 0.0, side="outer")
    assert float(outer.force) == pytest.approx(1.72, abs=0.005)
    contraction = muscle_state(Joint(), np.deg2rad(DEGREES)).contraction
    assert float(contraction.min()) == pytest.approx(0.012, abs=5e-4)
    assert float(contraction.max()) == pytest.approx(0.194, abs=5e-4)


def test_the_angles_at_which_the_branches_change():
    geometry = JointGeometry()
    taut, wrapped = branch_angles(geometry)
    assert np.rad2deg(taut) == pytest.approx(3.64, abs=0.005)
    assert np.rad2deg(wrapped) == pytest.approx(-4.07, abs=0.005)
    for angle in (taut, wrapped):
        ahead, behind = (muscle_path(geometry, jnp.asarray(angle + e)) for e in (1e-6, -1e-6))
        assert bool(ahead.engaged) != bool(behind.engaged)
    # A muscle below the shoulder is wrapped from the start.
    low = JointGeometry(anchor_y=0.14)
    assert branch_angles(low)[1] == 0
    assert bool(muscle_path(low, jnp.asarray(-1e-3)).engaged)


@pytest.mark.parametrize("branch_angle", [0, 1])
def test_it_is_continuous_across_the_branches(branch_angle):
    joint = Joint()
    at = branch_angles(joint.geometry)[branch_angle]
    near = muscle_state(joint, [at - 1e-9, at, at + 1e-9])
    for name in ("contraction", "force", "wire_tension", "push_x", "push_y"):
        values = np.asarray(getattr(near, name))
        assert np.ptp(values) < 1e-6, name
    assert np.ptp(near.path.height) < 1e-6


def test_the_step_at_0_is_that_of_alpha_and_beta():
    inner, outer = (float(muscle_state(Joint(), 0.0, side=s).force) for s in ("inner", "outer"))
    assert inner / outer == pytest.approx(0.33 / 0.31, rel=1e-12)
    assert inner / outer - 1 == pytest.approx(0.065, abs=5e-4)
    # The contraction does not depend on the torque.
    assert (
        muscle_state(Joint(), 0.0, side="inner").contraction
        == muscle_state(Joint(), 0.0, side="outer").contraction
    )
    blended = Joint(correction=Correction(blend=np.deg2rad(3)))
    forces = [float(muscle_state(blended, 0.0, side=s).force) for s in ("inner", "outer")]
    assert forces[0] == forces[1]


def test_forces_are_proportional_to_the_torque_without_corrections():
    joint = Joint(correction=Correction(reading="none"))
    angle = np.deg2rad(DEGREES)
    single, double = muscle_state(joint, angle, 0.3), muscle_state(joint, angle, 0.6)
    np.testing.assert_allclose(double.force, 2 * single.force, rtol=1e-14)
    np.testing.assert_allclose(double.wire_tension, 2 * single.wire_tension, rtol=1e-14)
    assert np.all(np.asarray(double.contraction) == np.asarray(single.contraction))


def test_a_torque_for_each_angle():
    torque = np.linspace(0.1, 0.5, 3)
    state = muscle_state(Joint(), np.deg2rad([10.0, 20.0, 30.0]), torque)
    alone = muscle_state(Joint(), np.deg2rad(20.0), 0.3)
    assert float(state.force[1]) == pytest.approx(float(alone.force), rel=1e-15)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"wire_length": 0.05}, "D_x is not less than half of L_wire"),
        ({"wire_x": 0.2}, "D_x is not less than half of L_wire"),
        ({"wire_length": 0.2}, "does not reach around the outer muscle"),
        ({"contact_y": 0.4}, "does not reach around the outer muscle"),
        ({"anchor_y": 2.0}, "ends A and C have crossed"),
        ({"anchor_x": 0.04, "anchor_y": 0.01}, "nearer to the joint than"),
        ({"contact_y": 0.001, "anchor_y": 0.001}, "crossed, or lie behind the joint"),
    ],
)
def test_an_impossible_geometry_is_refused_with_a_sentence(changed, sentence):
    joint = Joint(geometry=JointGeometry(**changed))
    with pytest.raises(giajax.InputError, match=sentence):
        muscle_state(joint, np.deg2rad(DEGREES))


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"angle": 20.0}, "at most 90 deg"),
        ({"angle": np.nan}, "not finite"),
        ({"angle": 0.1, "torque": np.inf}, "not finite"),
        ({"angle": 0.1, "side": "left"}, "use 'inner' or 'outer'"),
        ({"angle": 0.1, "side": "outer"}, "not on the outer side"),
        ({"angle": [0.1, 0.2], "torque": [0.3, 0.3, 0.3]}, "one torque, or one for each"),
    ],
)
def test_bad_arguments_are_refused_with_a_sentence(arguments, sentence):
    with pytest.raises(giajax.InputError, match=sentence):
        muscle_state(Joint(), **arguments)
