"""Sensors as objects: closed forms of IMUs and inclinometers, and user-defined sensors."""

import dataclasses
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import giajax
from giajax import InputError
from giajax.models import (
    AbstractSensor,
    Accelerometer,
    Camera,
    CurvatureSensor,
    Gyroscope,
    Inclinometer,
    Landmark,
    Marker,
    Pinhole,
    Sensors,
    TensionSensor,
)
from giajax.recordings import Channel, parse_column
from giajax.runtime.plugins import sources_of
from giajax.schema import KINDS, ChannelKind, add_kind
from giajax.schema.parameters import parameter
from giajax.simulation import at_rest, constant

GRAVITY = 9.80665


def moving(arm, angles, rates=None, **changes):
    """Return an arm at an instant, with a command equal to its angles."""
    motion = at_rest(arm, jnp.asarray(angles, float))
    if rates is not None:
        changes["rates"] = jnp.asarray(rates, float)[None]
    return dataclasses.replace(motion, **changes)


def bent(links=3, **changes):
    """Return a bent arm that moves in every joint and has all kinds of forces."""
    arm = giajax.takeichi_20m(links)
    arm = giajax.replace(arm, {"gravity": GRAVITY, "base_rotation": [0.1, -0.2, 0.3], **changes})
    rng = np.random.default_rng(5)
    return moving(arm, rng.normal(size=links), rng.normal(size=links))


def held():
    """Return a horizontal link at rest, held by its spring."""
    arm = giajax.takeichi_20m(1, parameters={"gravity": GRAVITY})
    load = giajax.mechanics.arm.inverse_dynamics(arm, *[jnp.zeros(1)] * 3)
    command = load / arm.spring_stiffness
    return moving(arm, [0.0], command=constant(command))


def test_at_rest_an_accelerometer_shows_g_upwards_and_a_gyroscope_nothing():
    motion = held()
    assert np.allclose(motion.accelerations, 0, atol=1e-12)
    assert np.allclose(Accelerometer().values(motion), [[[0, 0, GRAVITY]]], atol=1e-12)
    assert np.allclose(Gyroscope().values(motion), 0)
    # In a hanging pendulum, upwards is backwards along the link.
    hanging = moving(giajax.pendulum(1), [0.0])
    assert np.allclose(Accelerometer().values(hanging), [[[-GRAVITY, 0, 0]]], atol=1e-9)
    assert np.allclose(Inclinometer().values(hanging), -np.pi / 2)


def test_a_link_that_turns_shows_its_rate_and_omega_squared_r_towards_the_joint():
    arm = giajax.takeichi_20m(1, joint_axes=["yaw"], length=2.0)
    arm = giajax.replace(arm, {"joints.damping": 0.0, "air.drag_coefficient": 0.0})
    motion, omega = moving(arm, [0.4], [3.0]), 3.0
    assert np.allclose(motion.accelerations, 0, atol=1e-12)
    assert np.allclose(Gyroscope(offset_z=0.5).values(motion), [[[0, 0, omega + 0.5]]])
    shown = Accelerometer(along=0.5, offset_y=0.1).values(motion)
    assert np.allclose(shown, [[[-(omega**2) * 1.5, 0.1, 0]]], atol=1e-12)


def test_an_inclinometer_shows_the_angle_above_the_horizontal():
    motion = moving(giajax.takeichi_20m(2, joint_axes=["pitch", "pitch"]), [-0.3, 0.5])
    along = np.asarray(giajax.mechanics.arm.pose(motion.arm, motion.angles[0]).direction)
    assert np.allclose(Inclinometer(offset=0.1).values(motion), np.arcsin(along[2]) + 0.1)


def test_an_accelerometer_shows_second_differences_of_its_place():
    motion, step = bent(), 1e-4
    marker = Marker(along=0.2, left=-0.1, up=0.15)
    angles, rates, speeds_up = motion.angles[0], motion.rates[0], motion.accelerations[0]

    def place(time):
        return marker.on_links(motion.arm, angles + time * rates + time**2 / 2 * speeds_up)

    second = (place(step) - 2 * place(0.0) + place(-step)) / step**2
    frames = np.stack(
        [
            marker.on_links(motion.arm, angles) - away.on_links(motion.arm, angles)
            for away in (
                Marker(along=-0.8, left=-0.1, up=0.15),
                Marker(along=0.2, left=-1.1, up=0.15),
                Marker(along=0.2, left=-0.1, up=-0.85),
            )
        ],
        axis=1,
    )
    expected = np.einsum("lcx,lx->lc", frames, np.add(second, [0, 0, GRAVITY]))
    sensor = Accelerometer(along=0.2, left=-0.1, up=0.15)
    assert np.allclose(sensor.values(motion)[0], expected, rtol=1e-5, atol=1e-4)


def test_accelerations_and_torques_are_those_of_a_simulated_motion():
    arm = giajax.takeichi_20m(2)
    arm = giajax.replace(arm, {"joints.memory.strength": 0.3, "air.added_mass_coefficient": 0.5})
    step, ramp = 2e-4, functools.partial(giajax.simulation.ramps, [-1.0, 1.0])
    motion = giajax.simulate(
        arm,
        giajax.joint_ramps(2, {1: 0.5}, duration=0.3),
        0.5 + step * np.arange(3),
        wind=ramp([np.zeros(3), np.array([1.0, 2.0, 0.5])]),
        torque=ramp([np.zeros(2), np.array([0.5, 1.0])]),
        initial=([0.1, 0.2], [0.5, -0.3]),
        rtol=1e-10,
        atol=1e-10,
    )
    differences = (motion.rates[2] - motion.rates[0]) / (2 * step)
    assert np.allclose(motion.accelerations[1], differences, rtol=1e-4)
    parts = (motion.angles[1], motion.rates[1], motion.commands[1], motion.memory[1])
    assert np.allclose(motion.torques[1], giajax.mechanics.arm.joint_torque(arm, *parts))
    forgetful = dataclasses.replace(motion, memory=None)
    with pytest.raises(
        InputError, match=r"they depend on the history of the joints, .*: call simulate"
    ):
        _ = forgetful.accelerations


def test_the_tension_of_what_hangs_is_the_weight_below_it():
    motion = moving(giajax.pendulum(3, mass=[1.0, 2.0, 3.0]), [0.0, 0.0, 0.0])
    shown = TensionSensor(offset=0.5).values(motion)
    assert np.allclose(shown, [GRAVITY * np.array([6.0, 5.0, 3.0]) + 0.5], rtol=1e-12)
    # Buoyancy gives tension, and standing weight gives compression.
    standing = giajax.takeichi_20m(
        2, gravity=GRAVITY, buoyancy=True, base_rotation=(0.0, -np.pi / 2, 0.0), mass=[0.02, 0.2]
    )
    excess = GRAVITY * np.asarray(giajax.mechanics.arm.net_lift(standing))
    shown = TensionSensor().values(moving(standing, [0.0, 0.0]))
    assert np.allclose(shown, [[excess.sum(), excess[1]]], rtol=1e-12)
    assert shown[0, 1] < 0


def test_the_tension_of_a_pendulum_that_swings_is_its_closed_form():
    """m (g cos q + l omega^2) with the angle q and the distance l of the centre of mass."""
    arm = giajax.pendulum(1, length=2.0, mass=1.5)
    shown = TensionSensor().values(moving(arm, [0.7], [3.0]))
    assert np.allclose(shown, 1.5 * (GRAVITY * np.cos(0.7) + 1.0 * 3.0**2), rtol=1e-12)


def test_the_force_of_a_joint_is_that_of_newton_on_what_is_beyond_it():
    """From second differences of the centres of mass, drag, lift, and contact forces."""
    ground = giajax.mechanics.obstacles.Plane(centre=[0.0, 0.0, -0.1])
    arm = giajax.takeichi_20m(
        3,
        gravity=GRAVITY,
        buoyancy=True,
        mass=0.3,
        drag="strip",
        contact=giajax.mechanics.arm.Contact(obstacles=(ground,)),
    )
    rng = np.random.default_rng(2)
    wind, step = jnp.asarray([1.0, -2.0, 0.5]), 1e-4
    motion = moving(arm, 0.2 * rng.normal(size=3), rng.normal(size=3), wind=constant(wind))
    angles, rates = motion.angles[0], motion.rates[0]
    known = eqx.filter_jit(
        lambda motion: (motion.accelerations, motion.forces, giajax.simulation.contacts(motion))
    )
    accelerations, forces, touched = known(motion)
    speeds_up = accelerations[0]

    @jax.jit
    def centres(time):
        at = angles + time * rates + time**2 / 2 * speeds_up
        return giajax.mechanics.arm.pose(arm, at).mass_centre.T

    second = np.asarray(centres(step) - 2 * centres(0.0) + centres(-step)) / step**2
    body = giajax.mechanics.arm.bodies(arm)
    second[:, 2] += GRAVITY
    needed = np.asarray(body.mass)[:, None] * second
    needed -= np.asarray(giajax.mechanics.arm.drag_force(arm, angles, rates, wind))
    needed[:, 2] -= giajax.mechanics.arm.lift(arm)
    pressed = np.asarray(touched.force[0, :, 0])
    assert pressed[:, 2].max() > 1
    needed -= pressed
    expected = np.cumsum(needed[::-1], axis=0)[::-1]
    assert np.allclose(forces[0], expected, rtol=1e-5, atol=1e-5)


def test_the_curvature_is_the_angle_over_the_mean_length_of_the_links():
    motion = moving(giajax.takeichi_20m(3, length=[1.0, 2.0, 4.0]), [0.3, -0.3, 0.6])
    shown = CurvatureSensor(offset=[0.0, 0.0, 0.1]).values(motion)
    assert np.allclose(shown, [[0.3, -0.2, 0.3]], rtol=1e-12)


BEHIND = Pinhole(position=[-5.0, 0.5, 0.3], distortion=[-0.1, 0.02, 0, 0, 0], mount="link01")
FILMED = Sensors(
    camera=Camera(pinholes={"side": BEHIND}),
    landmark={"mark01": Landmark(position=[9.0, 1.0, 0.5])},
)
POINTS = [Channel.named(f"{point}_u") for point in ("mark01", "link01", "tip")]
SHIPPED = {
    "picture": FILMED.pictures(POINTS)["side"],
    "gyroscope": Gyroscope(*[0.1] * 3),
    "accelerometer": Accelerometer(*[0.1] * 6),
    "inclinometer": Inclinometer(0.1),
    "tension": TensionSensor(0.1),
    "curvature": CurvatureSensor(0.1),
}


def test_derivatives_are_those_of_differences_at_rest_too():
    """By the sensor's own parameters, by a spring of the arm, and by the motion."""

    def shown(changes, sensors):
        stiffness, angles, rates = changes
        arm = giajax.replace(giajax.takeichi_20m(2), {"joints.pitch_stiffness": stiffness})
        motion = moving(arm, angles, rates, command=constant(jnp.ones(2)))
        return jnp.concatenate([sensor.values(motion).ravel() for sensor in sensors.values()])

    flat, sensors_from = ravel_pytree(SHIPPED)

    def of_vector(vector):
        changes, own = jnp.split(vector, [5])
        return shown((changes[0], changes[1:3], changes[3:]), sensors_from(own))

    forwards = jax.jit(lambda point, change: jax.jvp(of_vector, (point,), (change,)))
    backwards = jax.jit(lambda point, weight: jax.vjp(of_vector, point)[1](weight)[0])
    for size in (0.0, 1.0):
        point = np.concatenate([[5.0], size * np.array([0.3, -0.5, 0.2, 0.7]), flat])
        directions = np.eye(len(point))
        values, columns = zip(*(forwards(point, change) for change in directions), strict=True)
        slopes = np.stack(columns, axis=1)
        step = 1e-6
        ahead, back = (
            np.stack([forwards(point + sign * step * change, change)[0] for change in directions])
            for sign in (1, -1)
        )
        assert np.allclose(slopes, (ahead - back).T / (2 * step), rtol=1e-5, atol=1e-5)
        rows = np.stack([backwards(point, weight) for weight in np.eye(len(values[0]))])
        assert np.allclose(rows, slopes, rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_a_run_of_an_imu_is_read_fitted_and_stored(tmp_path):
    arm = giajax.takeichi_20m(1, joint_axes=["yaw"])
    truth = giajax.ArmModel(
        arm, sensors=Sensors(sensor={"gyroscope": Gyroscope(offset_z=[0.05])}), tolerance=1e-8
    )
    times = np.linspace(0.0, 3.0, 61)
    names = ["imu01_gyro_z", "imu01_accel_y", "link01_inclination"]
    run = giajax.synthesise(
        truth,
        times,
        {"joint01_command": np.sin(2 * times)},
        names,
        noise={"rate": 0.01, "acceleration": 0.02, "angle": 0.01},
        constants=giajax.ArmModel(arm, tolerance=1e-8),
    )
    giajax.write_run(tmp_path / "imu.csv", run.times, run.values, definition=run.definition)
    assert "imu01_accel_y_m_per_s2" in (tmp_path / "imu.csv").read_text()
    run = giajax.read_run(tmp_path / "imu.csv")
    assert run.noise("imu01_accel_y") == pytest.approx(0.02)
    assert run.noise("imu01_gyro_z") == pytest.approx(0.01)
    model = giajax.model_for([run])
    free = ["joints.yaw_stiffness", "sensor.gyroscope.offset_z"]
    start = {"joints.yaw_stiffness": 20.0}
    result = giajax.fit(model, run, free=free, start=start, check=False)
    for path, value in {free[0]: 30.0, free[1]: 0.05}.items():
        estimate = result.parameters[path]
        assert abs(estimate.value - value) < 3 * estimate.standard_error
    (tmp_path / "result.json").write_text(result.to_json())
    stored = giajax.load_result(tmp_path / "result.json")
    assert np.allclose(stored.predict(run)[names[0]], result.predict(run)[names[0]])


def test_tension_and_curvature_are_columns(tmp_path):
    names = ("joint01_command", "joint01_tension", "joint01_curvature")
    values = dict(zip(names, ([0.0, 0.1], [0.5, 0.5], [0.0, 0.1]), strict=True))
    facts = {
        "arm": {"links": 1},
        "sensors": {"own": {"tension": {"offset": 0.25}}},
        "noise": {"joint01_tension_mN": 5.0},
    }
    units = {"joint01_tension": "mN"}
    path = tmp_path / "run.csv"
    giajax.write_run(path, [0.0, 1.0], values, units=units, definition=facts)
    header = "joint01_command_deg,joint01_tension_mN,joint01_curvature_per_m"
    assert header in path.read_text()
    run = giajax.read_run(path)
    assert run.values["joint01_tension"][0] == pytest.approx(0.5)
    assert run.noise("joint01_tension") == pytest.approx(0.005)
    model = giajax.model_for([run])
    motion = model.trajectory(model.prepare(run))
    shown = giajax.predict(model, run)
    pull = TensionSensor(0.25).values(motion)[:, 0]
    assert np.allclose(shown["joint01_tension"], pull, rtol=1e-9)
    assert np.allclose(shown["joint01_curvature"], motion.angles[:, 0] / 0.99)


@pytest.fixture
def own_rows():
    """Remove the rows that a test registers."""
    arm = KINDS["arm"]
    yield
    add_kind(arm)


def gauge(name="Gauge", row=("gauge", "gaugeNN", "ratio", "output"), **body):
    """Return a class of sensors that is not registered yet."""
    body = {"values": lambda self, motion: motion.torques, **body}
    return type(
        name, (AbstractSensor,), {"__module__": "gauges", "channel": ChannelKind(*row), **body}
    )


class Late(AbstractSensor):
    """Joint angles with a delay."""

    channel = ChannelKind("late_angle", "jointNN_late", "angle", "output")
    delay: jax.Array = parameter(0.25, unit="s", doc="how late")

    def values(self, motion):
        return motion.angles


@pytest.mark.usefixtures("own_rows")
def test_a_sensor_with_a_delay_shows_what_was_so_much_earlier():
    giajax.register(Late)
    times = np.linspace(0.0, 2.0, 41)
    values = {
        "joint01_command": np.sin(times),
        "joint01_late": np.zeros(41),
        "joint01_angle": np.zeros(41),
        # A camera may have the name of a row, and has its own clock.
        "late_angle.tip_u": np.zeros(41),
    }
    lens = {"size_px": [640, 480], "focal_length_px": 500.0, "mount": "room"}
    lens |= {"position_m": [0.5, -5.0, 0.0], "rotation_deg": [-90.0, 0.0, 0.0]}
    facts = {"arm": {"links": 1}, "camera": {"late_angle": lens}}
    run = giajax.Run.from_arrays(times, values, definition=facts)
    model = giajax.model_for([run])
    assert "test_sensor_objects.py" in sources_of(model)
    shown = giajax.predict(model, run)
    assert np.allclose(shown["joint01_late"][5:], shown["joint01_angle"][:-5], atol=1e-6)


@pytest.mark.quick
@pytest.mark.usefixtures("own_rows")
@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (gauge(values=AbstractSensor.values), "Gauge lacks values: implement it"),
        (gauge(channel=None), r"Gauge.channel is None: make it a giajax.schema.ChannelKind"),
        (gauge(row=("gauge", "gaugeNN", "ratio", "input")), "ChannelKind with the part .output."),
        (
            gauge(row=("tip_position", "tip_x", "length", "output")),
            "of Gauge already belongs to giajax",
        ),
        (
            gauge(row=("imu_rate", "imuNN_gyro_x", "angle", "output")),
            "already belongs to gyroscope",
        ),
        (gauge(row=("gauge", "tip_x", "ratio", "output")), "a channel tip_x already exists"),
        (
            gauge(row=("gauge", "gauge(", "ratio", "output")),
            r"the channel gauge\( is not a valid name",
        ),
    ],
)
def test_a_sensor_without_a_method_or_with_the_row_of_another_is_refused(wrong, said):
    kinds = dict(KINDS)
    with pytest.raises(InputError, match=said):
        giajax.register(wrong)
    assert kinds == KINDS


@pytest.mark.usefixtures("own_rows")
def test_a_cell_that_is_run_again_is_another_sensor_by_default():
    arm, shown = giajax.takeichi_20m(1), []
    for value in (1.0, 2.0):
        giajax.register(gauge("Cell", values=lambda self, motion, v=value: v + 0 * motion.rates))
        values = {"joint01_command": [0.0, 0.1], "gauge01": [0.0, 0.0]}
        run = giajax.Run.from_arrays([0.0, 0.1], values, definition={"arm": {"links": 1}})
        shown += giajax.predict(giajax.ArmModel(arm), run)["gauge01"].tolist()
    assert shown == [1.0, 1.0, 2.0, 2.0]


@pytest.mark.quick
@pytest.mark.usefixtures("own_rows")
def test_a_cell_that_is_run_again_with_another_row_takes_its_former_one_away():
    before = KINDS["arm"].channels
    for row in ("once", "twice"):
        giajax.register(gauge("Renamed", (row, f"{row}NN", "ratio", "output")))
        assert [each.name for each in KINDS["arm"].channels[len(before) :]] == [row]
    with pytest.raises(InputError, match="'once01' is not in the column table"):
        parse_column("once01")
    # Another sensor may now use the former row.
    giajax.register(gauge("Other", ("once", "onceNN", "ratio", "output")))
    assert Sensors().with_rows(["once"]).sensor.keys() == {"Other"}


@pytest.mark.quick
@pytest.mark.usefixtures("own_rows")
def test_a_sensor_that_no_result_could_name_is_refused():
    with pytest.raises(InputError, match="the sensor 'left' is a Gauge, but must have the name"):
        Sensors(sensor={"left": gauge()()})
    powers = {"power": 1, "__annotations__": {"power": int}}
    power = giajax.register(gauge("Power", ("power", "powerNN", "ratio", "output"), **powers))
    for value in (1, 2):
        sensors = Sensors(sensor={"Power": power(power=value)})
        model = giajax.ArmModel(giajax.takeichi_20m(2), sensors=sensors)
        if value == 1:
            assert model.definition()["sensors"]["own"] == {"Power": {}}
    with pytest.raises(InputError, match="sensor Power has power = 2, which cannot be written"):
        model.definition()
    model = giajax.ArmModel(giajax.takeichi_20m(2), sensors=Sensors(sensor={"Gauge": gauge()()}))
    with pytest.raises(InputError, match="there is no registered sensor Gauge, so a result could"):
        model.definition()


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (
            lambda self, motion: motion.torques[:, 0],
            r"values returns the shape \(1,\) for one sample and an arm of 2 links: return \(1, "
            r"2\), as gauge",
        ),
        (lambda self, motion: None, "values returns the shape None"),
        (lambda self, motion: motion.strains, "values fails .*has no attribute 'strains'"),
        (
            lambda self, motion: motion.rates / motion.rates,
            "values has a value that is not finite",
        ),
        (
            lambda self, motion: jnp.sqrt(motion.rates**2),
            "values has a derivative that is not finite",
        ),
    ],
)
def test_a_wrong_sensor_is_refused_before_a_fit_by_the_name_of_its_method(values, said):
    sensor = type("Gauge", (AbstractSensor,), {"__module__": "gauges", "values": values})
    sensor.channel = ChannelKind("gauge", "gaugeNN", "ratio", "output")
    model = giajax.ArmModel(giajax.takeichi_20m(2), sensors=Sensors(sensor={"Gauge": sensor()}))
    run = giajax.Run.from_arrays([0.0, 1.0], {"joint01_command": [0.0, 1.0]})
    with pytest.raises(InputError, match=rf"Gauge\.{said}"):
        model.prepare(run)
