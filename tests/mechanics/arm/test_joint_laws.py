"""Joint laws: those of giajax, a user-defined one, and invalid ones."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

import giajax
from giajax import InputError
from giajax.mechanics.arm import (
    AbstractJointLaw,
    CoulombFriction,
    Damper,
    EndStops,
    Hardening,
    JointLaws,
    JointState,
    Memory,
    Pneumatics,
    Spring,
    Stops,
    damping_power,
    drag_power,
    hysteresis_power,
    joint_torque,
    kinetic_energy,
    potential_energy,
    takeichi_20m,
)
from giajax.runtime.plugins import sources_of
from giajax.schema.parameters import (
    declared,
    default_free,
    parameter,
    replace,
    switched_on,
)
from giajax.simulation import constant
from giajax.testing import check_joint_law

ONE = jnp.asarray(1.1)
LAWS = {
    "spring": Spring(ONE),
    "damper": Damper(ONE),
    "friction": CoulombFriction(ONE, jnp.asarray(0.05)),
    "dahl": Memory(strength=0.2),
    "bouc-wen": Memory(strength=0.2, yield_angle=0.03, nu=2.5, delta=0.3),
    "elastic": Memory(strength=0.2, yield_angle=0.03, nu=6.0, delta=0.5),
    "stops": Stops(strength=[0.1, 0.2], yield_angle=[0.02, 0.3]),
    "hardening": Hardening(cubic=2.0, quintic=1.0),
    "ends": EndStops(lower=-0.3, damping=0.5),
}


lagging = {"drive.lag": 0.3, "drive.passive_stiffness": 0.1}
MUSCLES = replace(switched_on(Pneumatics((1, 3, 4)), list(lagging)), lagging)


@pytest.mark.parametrize(
    "law",
    [*LAWS.values(), pytest.param(MUSCLES, marks=pytest.mark.long)],
    ids=[*LAWS, "muscles"],
)
def test_a_law_of_giajax_makes_no_energy_and_has_its_derivatives(law):
    check_joint_law(law)


@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS)
def test_both_modes_agree_with_differences_at_rest_and_in_motion(law):
    """Derivatives of torque, energy and rate together by every number, away from corners."""
    random = np.random.default_rng(0)
    parts = jnp.asarray(random.uniform(-1.5, 1.5, (3, 5)))
    states = jnp.asarray(random.uniform(-0.5, 0.5, (law.rows, 5)))
    moving = JointState(*parts, states)
    still = JointState(*jnp.zeros((3, 5)), law.unstrained(jnp.zeros(5)))
    at = jax.tree.map(lambda *each: jnp.stack(each), moving, still)
    values, rest = eqx.partition(law, eqx.is_inexact_array)

    def each(values, at):
        own = eqx.combine(values, rest)
        return jnp.concatenate([own.torque(at), own.energy(at), own.rate(at).ravel()])

    function = jax.jit(jax.vmap(each, (None, 0)))
    given = (values, at)
    along = jax.tree.map(lambda x: jnp.asarray(random.normal(size=x.shape)), given)
    # Bouc-Wen has a corner at rest, so a rate of 0 needs differences on both sides.
    corner = isinstance(law, Memory)
    slope = jax.jvp(function, given, along)[1]
    out, back = jax.vjp(function, *given)
    weights = jnp.cos(jnp.arange(out.size, dtype=out.dtype)).reshape(out.shape)
    pairs = zip(jax.tree.leaves(back(weights)), jax.tree.leaves(along), strict=True)
    assert np.all(np.isfinite(slope))
    assert_allclose(sum(jnp.vdot(g, d) for g, d in pairs), jnp.vdot(weights, slope), rtol=1e-12)

    def moved(step):
        return function(*jax.tree.map(lambda x, dx: x + step * dx, given, along))

    differences = (moved(1e-6) - moved(-1e-6)) / 2e-6
    count = 1 if corner else 2
    assert_allclose(slope[:count], differences[:count], rtol=1e-6, atol=1e-6)


def test_a_hardening_joint_and_its_stops_are_those_of_hand():
    angles, command = jnp.asarray([0.3, -0.2, 0.5]), jnp.asarray([0.1, 0.2, 0.5])
    still = jnp.zeros(3)
    bent = JointLaws((Hardening(cubic=2.0, quintic=[1.0, 2.0, 3.0]),))
    found = bent.torque(bent.at(angles, still, command))
    d = np.asarray(angles - command)
    assert_allclose(found, -(2 * d**3 + np.asarray([1.0, 2.0, 3.0]) * d**5), atol=1e-15)
    ends = EndStops(lower=-0.1, upper=0.2, stiffness=10.0, damping=0.5, blend=0.02)
    ends = JointLaws((ends,))
    # Beyond the blend, the line starts at half of its width.
    assert_allclose(ends.torque(ends.at(angles, still, still)), [-0.9, 0.9, -2.9], rtol=1e-12)
    closing = ends.torque(ends.at(angles, jnp.asarray([2.0, 2.0, -9.0]), still))
    assert_allclose(closing, [-1.8, 0.0, 0.0], atol=1e-12)


@giajax.register
class Creep(AbstractJointLaw):
    """A spring and a damper in series (Maxwell); the state is the torque, N m."""

    modulus: jax.Array = parameter(2.0, unit="N m/rad", lower=0, frozen=False, doc="stiffness")
    time: jax.Array = parameter(0.3, unit="s", lower=1e-3, each=True, per="joint", doc="of decay")
    rows = 1

    def torque(self, at):
        return -at.states[0]

    def energy(self, at):
        return at.states[0] ** 2 / (2 * self.modulus)

    def rate(self, at):
        return (self.modulus * at.rates - at.states[0] / self.time)[None]


@giajax.register
class Snapping(AbstractJointLaw):
    """A law with two stable angles; it stores energy between them, and the joint moves away."""

    depth: jax.Array = parameter(4.0, unit="N m", lower=0, doc="of the wells")

    def torque(self, at):
        return self.depth * at.angles * (1 - (at.angles / 0.2) ** 2)

    def energy(self, at):
        return self.depth * (0.2**2 * (1 - (at.angles / 0.2) ** 2) ** 2) / 4


def test_its_parameters_are_declared_as_all_others():
    arm = takeichi_20m(
        2, joint_laws=["Creep", "hardening"], parameters={"joints.laws.Creep.time": [1, 2]}
    )
    paths = {"joints.laws.Creep.time", "joints.laws.Creep.modulus", "joints.laws.hardening.cubic"}
    assert paths <= set(declared(arm))
    assert set(default_free(arm)) >= paths - {"joints.laws.Creep.time"}


def test_forces_of_laws_of_giajax_scale_with_all_others():
    model = giajax.ArmModel(takeichi_20m(2, joint_laws=["Creep", "hardening", "end_stops"]))
    paths = [f"joints.laws.{path}" for path in ("hardening.cubic", "end_stops.lower")]
    (scale,) = model.conditions(paths, [])
    assert scale.startswith("joints.laws.hardening.cubic: determined only per unit of mass")
    assert "joints.laws.end_stops.stiffness = 100 N m/rad" in scale
    _, own = model.conditions([*paths, "joints.laws.Creep.modulus"], [])
    assert own.startswith("joints.laws.Creep.modulus: not checked")


def test_an_arm_with_laws_goes_through_its_definition():
    arm = takeichi_20m(
        2, joint_laws=[Creep(), "end_stops"], parameters={"joints.laws.Creep.time": 0.1}
    )
    model = giajax.ArmModel(arm)
    assert model.definition()["arm"]["joint_laws"] == ["Creep", "end_stops"]
    again = giajax.ArmModel.from_definition(model.definition())
    assert eqx.tree_equal(again.arm.joints, arm.joints)
    assert "joint_laws" not in giajax.ArmModel(takeichi_20m(2)).definition()["arm"]
    # The result names the file with which it was made.
    assert "test_joint_laws.py" in sources_of(model)

    class Local(Creep):
        """A law that is not registered."""

    with pytest.raises(InputError, match="the joint law Local is not registered"):
        giajax.ArmModel(takeichi_20m(2, joint_laws=[Local()])).definition()


def test_the_states_of_ones_own_law_follow_those_of_memory_and_stops():
    values = {"joints.memory.strength": 0.03, "joints.stops.strength": [0.1, 0.2]}
    arm = takeichi_20m(2, joint_laws=["Creep"], parameters=values)
    plain = takeichi_20m(2, parameters=values)
    rest, angles = jnp.zeros(2), jnp.asarray([0.3, -0.2])
    memory = jnp.asarray([[0.5, 0.2], [0.31, -0.2], [0.25, 0.1], [0.7, 0.8]])
    found = joint_torque(arm, angles, rest, rest, memory)
    without = joint_torque(plain, angles, rest, rest, memory[:3])
    assert_allclose(found, without - memory[3], rtol=1e-14)


@pytest.mark.parametrize("names", [["Creep", "end_stops", "hardening"], ["Snapping"]], ids=str)
def test_a_motion_with_laws_loses_what_they_say(names):
    """Explicit and linearly implicit methods give the same motion."""
    ends = {"lower": -0.1, "stiffness": 10.0, "damping": 0.5}
    ends = {f"joints.laws.end_stops.{name}": value for name, value in ends.items()}
    values = {"joints.damping": 0.02} | (ends if "end_stops" in names else {})
    arm = takeichi_20m(2, joint_laws=names, parameters=values)
    held, times = jnp.asarray([0.2, -0.1]), np.linspace(0, 2.0, 2001)
    start = (np.asarray([0.4, -0.3]), np.asarray([1.0, -2.0]))
    options = {"initial": start, "rtol": 1e-9, "atol": 1e-9}
    command = constant(held)
    motion = giajax.simulate(arm, command, times, solver="springs5", **options)
    other = giajax.simulate(arm, command, times, solver="tsit5", **options)
    assert_allclose(motion.angles, other.angles, rtol=0, atol=1e-6)

    @jax.jit
    @jax.vmap
    def balance(angles, rates, memory):
        energy = kinetic_energy(arm, angles, rates)
        energy = energy + potential_energy(arm, angles, held, memory=memory)
        power = drag_power(arm, angles, rates) + damping_power(arm, rates)
        return energy, power + hysteresis_power(arm, angles, rates, memory, held)

    energy, power = map(np.asarray, balance(motion.angles, motion.rates, motion.memory))
    lost = np.sum((power[1:] + power[:-1]) / 2 * np.diff(times))
    assert energy[-1] - energy[0] == pytest.approx(lost, abs=1e-3 * energy[0])
    assert energy[0] - energy[-1] > 0.1 * energy[0]


def test_a_motion_by_parameters_of_a_law_has_their_derivatives():
    arm = takeichi_20m(2, joint_laws=["Creep", "hardening"])
    command = giajax.joint_ramps(2, {1: 0.5, 2: -0.3}, duration=0.2)

    def end(values):
        own = replace(arm, dict(zip(paths, values, strict=True)))
        motion = giajax.simulate(
            own, command, np.linspace(0, 1.0, 5), rtol=1e-9, atol=1e-9, steps_for="derivatives"
        )
        return motion.angles[-1]

    paths = ["joints.laws.Creep.modulus", "joints.laws.Creep.time", "joints.laws.hardening.cubic"]
    at = jnp.asarray([2.0, 0.3, 1.0])
    # One program for the values and the derivative.
    along = jax.jit(lambda values, change: jax.jvp(end, (values,), (change,)))
    directions = jnp.eye(3)
    slopes = jnp.stack([along(at, change)[1] for change in directions], axis=1)
    ahead, back = (
        jnp.stack([along(at + sign * 1e-5 * change, change)[0] for change in directions], axis=1)
        for sign in (1, -1)
    )
    found = (ahead - back) / 2e-5
    assert_allclose(slopes, found, atol=1e-5 * float(jnp.max(jnp.abs(found))))
    assert np.all(np.max(np.abs(found), axis=0) > 1e-4)


def test_steps_for_derivatives_are_those_of_the_stiffness_that_springs_come_to():
    """A joint that rests 0.5 rad from its command acts like a linear spring with that slope."""
    start = (jnp.asarray([0.5, 0.0]), jnp.zeros(2))
    hard = {"joints.pitch_stiffness": 2.0, "joints.laws.hardening.cubic": 8192.0}
    laws = takeichi_20m(2, joint_laws=["hardening"], parameters=hard | {"joints.damping": 0.7})
    linear = {"joints.pitch_stiffness": 2.0 + 3 * 8192 * 0.25, "joints.damping": 0.7}
    straight = jnp.zeros(2)

    def slope(arm, command, torque):
        def moved(rate):
            initial = (start[0], start[1].at[0].add(rate))
            return giajax.simulate(
                arm,
                constant(command),
                np.linspace(0, 2.0, 3),
                initial=initial,
                torque=constant(jnp.asarray([torque, 0.0])),
                steps_for="derivatives",
                rtol=1e-5,
                atol=1e-5,
            ).angles

        return jax.jit(lambda rate: jax.jvp(moved, (rate,), (jnp.ones_like(rate),)))(0.0)[1]

    found = slope(laws, straight, 2 * 0.5 + 8192 * 0.5**3)
    assert_allclose(found, slope(takeichi_20m(2, parameters=linear), start[0], 0.0), atol=1e-5)


class Shapeless(Creep):
    def torque(self, at):
        return self.modulus


class Coupled(Creep):
    def torque(self, at):
        return -at.states[0] - 0.1 * jnp.roll(at.rates, 2)


class Tethered(Creep):
    """A law whose torque depends on the distance of the neighbour from its command."""

    def torque(self, at):
        return -at.states[0] - 0.1 * jnp.roll(at.angles - at.command, 1)


class Shared(Creep):
    def unstrained(self, angles):
        return jnp.zeros((1, angles.size)) + 0.1 * jnp.sum(angles)


class Giving(Creep):
    def torque(self, at):
        return at.states[0]


class Forgetting(Creep):
    """A law that reports no stored energy."""

    def energy(self, at):
        return 0 * at.rates


class Rough(Creep):
    def torque(self, at):
        return -at.states[0] - at.rates * jnp.sqrt(jnp.abs(at.rates))


class Infinite(Creep):
    def energy(self, at):
        return at.states[0] ** 2 / 0.0


class Counted(Creep):
    rows: int = 1


class Backwards(Creep):
    rows = -1


class Called(Creep):
    def rows(self):
        return 1


class Fractional(Creep):
    rows = 1.0


class Whole(Creep):
    def unstrained(self, angles):
        return jnp.zeros((1, angles.size), int)


class Imaginary(Creep):
    def torque(self, at):
        return (-at.states[0]).astype(complex)


class Kinetic(Creep):
    def energy(self, at):
        return super().energy(at) + at.rates**2


class Softest(Creep):
    def stiffest(self, at):
        return jnp.full_like(at.angles, -1.0)


class Sloping(Creep):
    def state_slopes(self, at):
        return 0.0, 0.0, 0.0


class Broken(Creep):
    def rate(self, at):
        return at.speeds


class Stiffer(Creep):
    def slopes(self, at):
        return self.modulus + 0 * at.rates, 0 * at.rates


class Cooler(Creep):
    def dissipation(self, at):
        return 0 * at.rates


@jax.custom_jvp
def _held(torque):
    return torque


_held.defjvp(lambda primals, tangents: (primals[0], 0 * tangents[0]))


class Misled(Creep):
    def torque(self, at):
        return -_held(at.states[0])


class Slipping(Creep):
    """A law with limited torque and a rate, which slips."""

    def return_mapped(self, angles, states):
        return jnp.clip(states, -0.3, 0.3)


@pytest.mark.slow
def test_a_law_with_a_rate_that_slips_does_so_alone_and_beside_others():
    arms = [
        takeichi_20m(2, joint_laws=[Slipping()], parameters=more)
        for more in ({}, {"joints.stops.strength": [1e-9], "joints.stops.yield_angle": [0.01]})
    ]
    command = giajax.joint_ramps(2, {1: 0.6, 2: -0.4}, start=0.1, duration=0.3)
    times = np.linspace(0.0, 3.0, 31)
    alone, beside = (
        giajax.simulate(arm, command, times, solver="springs5", rtol=1e-8, atol=1e-8)
        for arm in arms
    )
    torque = np.abs(alone.memory[:, 0])
    assert 0.29 < np.max(torque) <= 0.3
    assert_allclose(beside.angles, alone.angles, atol=1e-5)


class Astray(Memory):
    """A law whose state moves at twice its rate."""

    strength: jax.Array = parameter(0.2, unit="N m", doc="torque")

    def travelled(self, begin, end, states):
        return super().travelled(begin, 2 * end - begin, states)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (
            Astray(),
            "Astray.travelled does not match the integral of Astray.rate over a short path at",
        ),
        (Shapeless(), r"Shapeless.torque returns the shape \(\) for 4 joints: return \(4,\)"),
        (Coupled(), "Coupled.torque depends on another joint at .*: compute each value from angle"),
        (Tethered(), "Tethered.torque depends on another joint at"),
        (Shared(), "Shared.unstrained depends on another joint at"),
        (Called(), "Called.rows is a method: give the number of states"),
        (Fractional(), "Fractional.rows is 1.0: give the number of states"),
        (Whole(), "Whole.unstrained returns int64, but the angles are float64: return"),
        (Imaginary(), "Imaginary.torque returns complex128, but the angles are float64"),
        (
            Kinetic(),
            "Kinetic.energy depends on the rate at .*: let the stored energy depend only "
            "on angle, command",
        ),
        (Softest(), "Softest.stiffest is less than Softest.slopes, or not finite, at"),
        (Sloping(), r"Sloping.state_slopes returns the shape \(.*: return \(\(1, 4\)"),
        (Giving(), "Giving.torque releases more energy than Giving.energy had stored"),
        (Forgetting(), "Forgetting.torque releases more energy than Forgetting.energy had stored"),
        (
            Rough(),
            "Rough.torque has a derivative with respect to the rates that is not finite at .* 0 "
            "rad/s",
        ),
        (Infinite(), "Infinite.energy has a value that is not finite at"),
        (Counted(), "Counted.rows is a field: make it a constant of the class"),
        (Backwards(), "Backwards.rows is -1: give the number of states"),
        (Broken(), r"Broken.rate fails \(AttributeError: .*no attribute 'speeds'"),
        (
            Stiffer(),
            "Stiffer.slopes does not match the negative derivative of the torque with respect to "
            "the angles at",
        ),
        (Cooler(), "Cooler.dissipation does not match the loss computed from torque and energy at"),
        (
            Misled(),
            "Misled.torque has a derivative with respect to the states that does not match finite "
            "differences",
        ),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, AbstractJointLaw) else "",
)
def test_a_wrong_law_is_refused_before_anything_is_fitted(law, said):
    with pytest.raises(InputError, match=said):
        takeichi_20m(4, joint_laws=[law])


class Counting(Creep):
    calls: ClassVar[list[object]] = []

    def energy(self, at):
        self.calls.append(at)
        return super().energy(at)


def test_a_law_is_tried_once_for_its_numbers_and_joints():
    for joints, modulus, again in ((2, 2.0, True), (2, 2.0, False), (3, 2.0, True), (2, 3.0, True)):
        Counting.calls.clear()
        takeichi_20m(joints, joint_laws=[Counting(modulus=modulus)])
        assert bool(Counting.calls) == again


@giajax.register
class Bellows(AbstractJointLaw):
    """Two opposing bellows, whose pressures follow through a valve."""

    passive = False
    rows = 2
    area: jax.Array = parameter(2e-5, unit="m^3", lower=0, frozen=False, doc="area times lever")
    lag: jax.Array = parameter(0.2, unit="s", lower=1e-3, doc="of the pressures")

    def commanded(self, command):
        return 2e4 + jnp.stack([command, -command]) / (2 * self.area)

    def settled(self, at):
        return at.pressures / 1e5

    def rate(self, at):
        return (at.pressures / 1e5 - at.states) / self.lag

    def torque(self, at):
        return self.area * 1e5 * (at.states[0] - at.states[1]) - at.angles

    def energy(self, at):
        return at.angles**2 / 2


BELLOWS = {"joints.pitch_stiffness": 0.0, "joints.yaw_stiffness": 0.0, "joints.damping": 0.3}


def test_pressures_of_a_run_drive_a_law_of_ones_own(tmp_path):
    arm = takeichi_20m(2, joint_laws=["Bellows"], parameters=BELLOWS)
    assert "joints.laws.Bellows.area" in default_free(arm)
    times = np.linspace(0, 20.0, 5)
    options = {"rtol": 1e-8, "atol": 1e-8}
    by_angle = giajax.simulate(arm, constant(jnp.asarray([0.3, -0.1])), times, **options)
    # The controller holds the command at settled pressures.
    assert_allclose(by_angle.angles[-1], [0.3, -0.1], atol=1e-3)
    file = tmp_path / "run.csv"
    (tmp_path / "run.toml").write_text(
        '[arm]\npreset = "takeichi_20m"\nlinks = 2\njoint_laws = ["Bellows"]\n[arm.parameters]\n'
        + "".join(f'"{path}" = {value}\n' for path, value in BELLOWS.items())
    )
    names = [
        f"joint0{joint}_pressure_{side}_kPa" for joint in (1, 2) for side in ("first", "second")
    ]
    rows = [",".join(["time_s", *names, "joint01_angle_deg", "joint02_angle_deg"])]
    rows += [f"{time},27.5,12.5,17.5,22.5,0,0" for time in times]
    file.write_text("\n".join(rows))
    run = giajax.read_run(file)
    found, _ = (model := giajax.model_for([run])).predict(
        model.prepare(run), ("joint01_angle", "joint02_angle")
    )
    assert_allclose(np.stack(list(found.values()), 1), by_angle.angles, atol=1e-5)


def test_an_arm_has_one_law_that_pressures_drive():
    with pytest.raises(
        InputError, match="Bellows and Pneumatics both take pressures: use only one"
    ):
        takeichi_20m(2, joint_laws=["Bellows"], muscles="pitch")


def test_a_law_that_is_driven_says_so():
    class Driven(Giving):
        passive = False

    check_joint_law(Driven())


def test_a_law_without_its_method_is_refused_by_its_name():
    with pytest.raises(InputError, match="Unfinished lacks energy: implement it"):

        @giajax.register
        class Unfinished(AbstractJointLaw):
            def torque(self, at):
                return -at.rates


def test_names_of_laws_are_those_of_registered_ones_each_once():
    with pytest.raises(InputError, match="there is no registered joint law 'Nobodys': register it"):
        takeichi_20m(2, joint_laws=["Nobodys"])
    with pytest.raises(InputError, match="Creep appears twice in joint_laws"):
        takeichi_20m(2, joint_laws=["Creep", Creep()])
    for wrong in ("hardening", Creep(), Creep, [Creep], ["hardening", None]):
        with pytest.raises(InputError, match="give a list of names or instances of laws"):
            takeichi_20m(2, joint_laws=wrong)
    for given in (Spring(ONE), Memory(strength=0.1)):
        with pytest.raises(InputError, match="is switched on by parameters of the joints"):
            takeichi_20m(2, joint_laws=[given])
    with pytest.raises(InputError, match='\'Nobodys\' must be "hardening", "end_stops" or'):
        giajax.recordings.Definition.parse({"arm": {"joint_laws": ["Nobodys"]}}, "test")
    with pytest.raises(InputError, match="a joint named 'hardening' already exists"):

        @giajax.register
        class Other(AbstractJointLaw):
            kind = "hardening"

            def torque(self, at):
                return -at.rates

            energy = torque
