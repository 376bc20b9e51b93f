"""Arms from MJCF and URDF move as in MuJoCo, and can be exported with their air."""

import importlib.util

import equinox as eqx
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

import giajax
from giajax.apps.mjcf import export_mjcf, read_mjcf
from giajax.cli import main
from giajax.mechanics.arm import acceleration, pose

CAPSULES = """<mujoco><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>
<body pos="0.3 0.1 1"><joint name="shoulder" axis="0 1 0" damping="0.2" stiffness="3"
 armature="0.01" springref="0.2"/>
<geom type="capsule" fromto="0 0 0 0.5 0 0" size="0.03" mass="0.4"/>
<body pos="0.5 0 0"><joint name="elbow" axis="0 0.3 1" damping="0.1"/>
<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="0.2"/>
<body pos="0.2 0.05 0.03"><geom type="box" size="0.02 0.03 0.01" mass="0.1"/></body>
<body pos="0.4 0 0"><joint name="wrist" axis="0 1 0" damping="0.1" stiffness="3"/>
<geom type="box" size="0.15 0.04 0.01" pos="0.15 0 0" mass="0.15"/></body></body></body>
</worldbody></mujoco>"""

# The arm hangs along x, the direction of gravity. Its straight pose differs from the file's pose.
HANGING = """<mujoco><compiler angle="degree"/><option gravity="9.81 0 0"/><worldbody>
<body euler="0 20 0"><joint name="first" axis="0 1 0" ref="20" damping="0.02"/>
<inertial pos="0.2 0 0" mass="0.3" diaginertia="0.001 0.02 0.02"/><geom size="0.01"/>
<body pos="0.6 0 0"><joint name="second" axis="0 1 0" damping="0.02"/>
<inertial pos="0.2 0 0" mass="0.3" diaginertia="0.001 0.02 0.02"/>
<geom type="cylinder" fromto="0 0 0 0.5 0 0" size="0.02"/></body></body></worldbody></mujoco>"""

ROBOT = """<robot name="robot"><link name="base"/>
<link name="l1"><inertial><origin xyz="0.25 0.01 0" rpy="0 0 0.1"/><mass value="0.5"/>
<inertia ixx="0.001" ixy="0.0001" ixz="0" iyy="0.011" iyz="0" izz="0.0112"/></inertial></link>
<link name="l2"><inertial><origin xyz="0.15 0 0"/><mass value="0.3"/>
<inertia ixx="0.0004" ixy="0" ixz="0" iyy="0.003" iyz="0" izz="0.003"/></inertial>
<collision><origin xyz="0.15 0 0" rpy="0 1.5707963267948966 0"/><geometry>
<cylinder length="0.3" radius="0.02"/></geometry></collision></link>
<joint name="j1" type="revolute"><parent link="base"/><child link="l1"/>
<origin xyz="0 0 1" rpy="0 0.3 0.2"/><axis xyz="0 1 0"/><dynamics damping="0.05"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<joint name="j2" type="continuous"><parent link="l1"/><child link="l2"/><origin xyz="0.5 0 0"/>
<axis xyz="0 0 1"/><dynamics damping="0.02"/></joint></robot>"""

FILES = {"capsules.xml": CAPSULES, "hanging.xml": HANGING, "robot.urdf": ROBOT}
STILL = {"air.drag_coefficient": 0.0}
TIMES = np.linspace(0.0, 5.0, 11)
STEP = 5e-4


def written(folder, name, text):
    path = folder / name
    path.write_text(text)
    return path


def moved(arm, rest, angles):
    """Return the angles of an arm released in still air; its springs rest as in the file."""
    command = giajax.simulation.constant(rest)
    start = (jnp.asarray(angles), jnp.zeros(arm.count))
    motion = giajax.simulate(arm, command, TIMES, initial=start, rtol=1e-9, atol=1e-11)
    return np.asarray(motion.angles)


@eqx.filter_jit
def starts_to_move(arm, angles, rates, rest):
    """Return the accelerations in a state, and the positions of the links."""
    return acceleration(arm, angles, rates, rest), pose(arm, angles).mass_centre


def moved_in_mujoco(path, angles):
    spec = mujoco.MjSpec.from_file(str(path))
    spec.option.integrator, spec.option.timestep = mujoco.mjtIntegrator.mjINT_RK4, STEP
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + angles
    found = []
    for time in TIMES:
        mujoco.mj_step(model, data, round(time / STEP) - round(data.time / STEP))
        found.append(data.qpos - model.qpos0)
    return np.array(found)


@pytest.mark.parametrize("name", FILES)
def test_it_moves_as_in_mujoco_and_comes_out_the_same(name, tmp_path):
    path = written(tmp_path, name, FILES[name])
    read = read_mjcf(path, diameter=0.05, parameters=STILL)
    angles = np.array([0.3, -0.2, 0.4])[: read.arm.count]
    expected = moved_in_mujoco(path, angles)
    assert np.ptp(expected, axis=0).min() > 0.1
    motion = moved(read.arm, read.rest, angles)
    np.testing.assert_allclose(motion, expected, atol=1e-6)

    again = read_mjcf(
        written(tmp_path, "again.xml", export_mjcf(read.arm).files["arm.xml"]), parameters=STILL
    )
    random = np.random.default_rng(0)
    for state in random.normal(size=(20, 2, read.arm.count)):
        for found, known in zip(
            *(starts_to_move(arm, *state, read.rest) for arm in (again.arm, read.arm)), strict=True
        ):
            np.testing.assert_allclose(found, known, rtol=1e-6, atol=1e-6)


@pytest.mark.long
def test_the_arm_of_the_paper_moves_as_in_mujoco_with_its_air(tmp_path):
    arm = giajax.takeichi_20m(20, gravity=9.80665, buoyancy=True, trim=True, drag="strip")
    arm = giajax.schema.parameters.replace(arm, {"joints.damping": 0.3})
    for each in (giajax.takeichi_20m(), arm):
        exported = export_mjcf(each)
        assert exported.lost == ()
        for name, text in exported.files.items():
            (tmp_path / name).write_text(text)
        spec = importlib.util.spec_from_file_location("air", tmp_path / "air.py")
        air = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(air)

        def command(time):
            angles = np.zeros(20)
            angles[:2] = np.interp(time, [0.5, 1.5], [0.0, 0.5])
            return angles

        model = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
        model.opt.timestep = 2e-3
        data = mujoco.MjData(model)
        times, tips = np.linspace(0.0, 5.0, 11), []
        with air.forces(command):
            for time in times:
                mujoco.mj_step(model, data, round(time / 2e-3) - round(data.time / 2e-3))
                mujoco.mj_kinematics(model, data)
                tips.append(data.site("tip").xpos.copy())
        ramp = giajax.joint_ramps(20, {1: 0.5, 2: 0.5}, start=0.5, duration=1.0)
        motion = giajax.simulate(each, ramp, times, solver="springs5", rtol=1e-7, atol=1e-8)
        assert np.ptp(tips, axis=0)[1:].min() > 0.3
        np.testing.assert_allclose(tips, motion.tip, atol=1e-4)


def test_what_a_file_switches_off_is_off(tmp_path):
    flags = '<flag gravity="disable" spring="disable" damper="disable"/>'
    text = CAPSULES.replace('gravity="0 0 -9.81"/>', f'gravity="0 0 -9.81">{flags}</option>')
    arm = read_mjcf(written(tmp_path, "off.xml", text)).arm
    assert float(arm.gravity) == 0
    assert float(arm.joints.pitch_stiffness) == 0
    np.testing.assert_array_equal(arm.joints.damping, 0)
    floating = CAPSULES.replace('<body pos="0.5 0 0">', '<body pos="0.5 0 0" gravcomp="1">')
    assert "gravcomp of bodies is omitted" in read_mjcf(written(tmp_path, "up.xml", floating)).lost


def test_an_arm_that_mujoco_refuses_is_named():
    arm = giajax.takeichi_20m(2, inertia_axial=1.0, inertia_transverse=0.1)
    with pytest.raises(giajax.InputError, match="MuJoCo rejects this arm"):
        export_mjcf(arm)


def test_what_is_lost_is_said(tmp_path):
    arm, _, _, _, lost = read_mjcf(written(tmp_path, "robot.urdf", ROBOT), diameter=0.05)
    assert any("limits" in sentence for sentence in lost)
    np.testing.assert_allclose(arm.joints.laws["end_stops"].upper, [3.0, np.pi])
    assert any("becomes six point masses: 1" in sentence for sentence in lost)
    beyond = ROBOT.replace('lower="-3"', 'lower="1"')
    lost = read_mjcf(written(tmp_path, "beyond.urdf", beyond), diameter=0.05).lost
    assert "a joint range that does not contain 0 is extended to 0" in lost
    several = CAPSULES.replace('stiffness="3"/>', 'stiffness="4"/>')
    read = read_mjcf(written(tmp_path, "several.xml", several))
    assert any("several stiffnesses" in sentence for sentence in read.lost)
    assert float(read.arm.joints.pitch_stiffness) == 0
    assert "omitted: added mass" in export_mjcf(giajax.takeichi_20m_full()).lost


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("<mujoco><worldbody/></mujoco>", "has no joint"),
        ("<muj", "MuJoCo cannot read"),
        (CAPSULES.replace('name="elbow"', 'name="elbow" type="slide"'), "'elbow' is not a hinge"),
        (CAPSULES.replace('body pos="0.4 0 0"', 'body pos="0.4 0 0.1"'), "'wrist' is 0.1 m away"),
        (CAPSULES.replace('body pos="0.5 0 0"', 'body pos="0 0 0"'), "'shoulder' has no length"),
        (ROBOT.replace('parent link="l1"', 'parent link="base"'), "describes a tree"),
        (ROBOT, "no geom gives the diameter"),
        (
            HANGING.replace("<inertial", '<joint name="two" axis="0 0 1"/><inertial', 1),
            "two joints",
        ),
    ],
)
def test_what_is_no_arm_is_refused(text, error, tmp_path):
    path = written(tmp_path, "robot.urdf" if "<robot" in text else "arm.xml", text)
    with pytest.raises(giajax.InputError, match=error):
        read_mjcf(path)


def test_the_command_makes_a_file_of_an_arm_and_back(tmp_path, capsys):
    path, stated = written(tmp_path, "arm.xml", CAPSULES), tmp_path / "arm.toml"
    assert main(["mjcf", str(path), "--to", str(stated)]) == 0
    assert "command these angles: 11.4592, 0, 0 deg" in capsys.readouterr().err
    assert main(["mjcf", str(path), "--to", str(stated)]) == 2  # no file is overwritten
    assert main(["mjcf", str(stated), "--to", str(tmp_path / "back")]) == 0
    assert main(["mjcf", str(stated)]) == 2
    back = read_mjcf(tmp_path / "back" / "arm.xml").arm
    arm = read_mjcf(path).arm
    for name in ("damping", "armature", "pitch_stiffness", "yaw_stiffness"):
        np.testing.assert_allclose(getattr(back.joints, name), getattr(arm.joints, name))
    first, second = (giajax.mechanics.arm.mass_matrix(each, jnp.ones(3)) for each in (arm, back))
    np.testing.assert_allclose(first, second, rtol=1e-7)
