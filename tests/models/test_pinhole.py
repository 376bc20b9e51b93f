"""Cameras with a lens: pixels of OpenCV, inversion, derivatives, poses, and a bent arm."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import giajax
from giajax import Definition, InputError, Run
from giajax.apps.synthetic import recorded_again
from giajax.models import NEAR, Pinhole, build_model, model_for
from giajax.schema.parameters import declared, left_out

OPENCV = json.loads(Path(__file__).with_name("opencv_projections.json").read_text())
# Axes of an unrotated camera in the base frame: right is -y, down is -z, forwards is x.
UNTURNED = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
LENS = [-0.2, 0.05, 0.003, -0.002, -0.004]

ARM = {"arm": {"links": 4}}
SIDE = {
    **{"size_px": [1920, 1080], "focal_length_px": 800.0},
    **{"position_m": [2.0, -5.0, 0.5], "rotation_deg": [3.0, -5.0, 85.0]},
}
TIP = {
    **{"mount": "tip", "size_px": [640, 480], "focal_length_px": 500.0},
    **{"position_m": [0.1, 0.02, 0.05], "rotation_deg": [2.0, 4.0, -3.0]},
}
MARK = {"mark01": {"position_m": [7.0, 0.4, 0.6]}}
TIMES = np.linspace(0.0, 2.0, 21)
COMMAND = {
    "joint01_command": np.interp(TIMES, [0.2, 1.0], [0.0, 0.3]),
    "joint02_command": np.interp(TIMES, [0.4, 1.4], [0.0, -0.2]),
}
CHANNELS = ["side.link02_u", "side.link02_v", "side.tip_u", "tip.mark01_u", "tip.mark01_v"]


def of_opencv(case):
    """Return a camera with OpenCV's pose and matrix: R p + t is a point in the camera frame."""
    turn = Rotation.from_rotvec(case["rvec"]).as_matrix()
    matrix = np.array(case["matrix"])
    return Pinhole(
        position=-turn.T @ np.array(case["tvec"]),
        rotation=Rotation.from_matrix(turn.T @ UNTURNED.T).as_rotvec(),
        focal_length=matrix[0, 0],
        aspect=matrix[1, 1] / matrix[0, 0],
        centre=matrix[:2, 2],
        distortion=case["distortion"],
    )


def definition(**cameras):
    cameras = cameras or {"side": SIDE, "tip": TIP}
    return {**ARM, "camera": cameras, "landmark": MARK}


def run_of(channels=CHANNELS, **values):
    blank = {name: values.get(name, np.zeros_like(TIMES)) for name in channels}
    return Run.from_arrays(TIMES, {**COMMAND, **blank}, definition=definition(), name="film")


@pytest.mark.parametrize("case", OPENCV["cases"])
def test_pixels_are_those_of_opencv(case):
    seen = of_opencv(case).project(jnp.array(case["points"]))
    np.testing.assert_allclose(seen.pixels, case["pixels"], rtol=0, atol=1e-6)
    turn = Rotation.from_rotvec(case["rvec"])
    depth = (turn.apply(case["points"]) + case["tvec"])[:, 2]
    np.testing.assert_allclose(seen.depth, depth, rtol=1e-12)


def test_a_ray_goes_through_the_point_whose_pixel_it_is():
    random = np.random.default_rng(0)
    camera = Pinhole([1.0, 2.0, 3.0], [0.4, -1.1, 2.0], 900.0, 1.05, [960, 540], LENS)
    view = camera.view()
    # Up to 40 degrees from the optical axis, where this distortion is monotone.
    before = np.concatenate([random.uniform(-0.6, 0.6, (40, 2)), np.ones((40, 1))], axis=1)
    towards = (before * random.uniform(1, 9, (40, 1))) @ np.asarray(view.axes).T
    rays = camera.rays(camera.project(jnp.array(np.asarray(view.centre) + towards)).pixels)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    np.testing.assert_allclose(rays, towards, atol=1e-12)


def test_pixels_do_not_change_where_camera_and_world_move_together():
    random = np.random.default_rng(1)
    position, rotation = np.array([0.5, -6.0, 1.0]), np.array([0.2, -0.3, 1.3])
    points = random.uniform(-2, 2, (20, 3))
    move, shift = Rotation.from_rotvec([0.7, 0.4, -1.9]), np.array([3.0, -8.0, 2.0])
    turned = (move * Rotation.from_rotvec(rotation)).as_rotvec()
    here = Pinhole(position, rotation, distortion=LENS).project(points)
    there = Pinhole(move.apply(position) + shift, turned, distortion=LENS)
    np.testing.assert_allclose(
        there.project(move.apply(points) + shift).pixels, here.pixels, rtol=0, atol=1e-8
    )


def test_derivatives_are_those_of_differences_also_behind_and_unturned():
    points = jnp.array([[5.0, 1.0, -0.4], [0.3, 2.0, 1.0], [0.0, 0.1, 0.2], [-0.3, 0.1, 0.2]])

    @jax.jit
    def pixels(values):
        camera = Pinhole(values[:3], values[3:6], values[6], values[7], values[8:10], values[10:])
        return camera.project(points).pixels

    # An unrotated camera at the origin. The second half of the points is too near or behind it.
    at = jnp.array([0, 0, 0, 0, 0, 0, 700.0, 1.1, 320, 240, *LENS])
    forward = jax.jit(jax.jacfwd(pixels))(at)
    assert jnp.all(jnp.isfinite(pixels(at)))
    assert jnp.all(jnp.any(forward[..., :6] != 0, axis=(1, 2)))
    np.testing.assert_allclose(forward, jax.jit(jax.jacrev(pixels))(at), rtol=1e-9, atol=1e-9)
    for place in range(len(at)):
        step = 1e-6 * max(1.0, abs(float(at[place])))
        change = jnp.zeros_like(at).at[place].set(step)
        difference = (pixels(at + change) - pixels(at - change)) / (2 * step)
        scale = np.abs(forward[..., place]).max()
        np.testing.assert_allclose(forward[..., place], difference, rtol=1e-5, atol=1e-6 * scale)


def test_what_is_near_behind_or_beside_the_picture_is_not_seen():
    camera = Pinhole(focal_length=100.0, centre=[49.5, 29.5], size=(100, 60))
    points = jnp.array([[1.0, 0, 0], [NEAR / 2, 0, 0], [-1.0, 0, 0], [1, 0.49, 0], [1, 0.51, 0]])
    seen = camera.project(points)
    assert camera.sees(seen).tolist() == [True, False, False, True, False]


def test_a_point_that_passes_the_lens_has_no_jump():
    depths = NEAR + np.array([-1e-7, 0.0, 1e-7])
    points = np.stack([depths, np.full(3, 0.2), np.zeros(3)], axis=1)
    u = np.asarray(Pinhole().project(points).pixels)[:, 0]
    assert abs(u[2] - 2 * u[1] + u[0]) < 1e-6 * abs(u[2] - u[0])


def oriented(angles, axes=("pitch", "yaw", "pitch", "yaw"), length=0.99):
    """Return frames and ends of the links by products of rotations, without quaternions."""
    turn, end, frames, ends = np.eye(3), np.zeros(3), [], []
    for angle, axis in zip(angles, axes, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        # A positive pitch raises the arm, so it turns x towards z.
        pitch = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
        yaw = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        turn = turn @ (pitch if axis == "pitch" else yaw)
        end = end + length * turn[:, 0]
        frames.append(turn)
        ends.append(end)
    return frames, ends


@pytest.mark.parametrize("mount", ["tip", "link03"])
def test_a_camera_on_a_bent_arm_moves_with_its_link(mount):
    angles = np.array([0.5, -0.4, 0.3, 0.8])
    frames, ends = oriented(angles)
    offset, turn = np.array([0.1, -0.05, 0.2]), np.array([0.1, -0.2, 0.3])
    index = 3 if mount == "tip" else 2
    origin = ends[3] if mount == "tip" else ends[2] - 0.495 * frames[2][:, 0]
    centre = origin + frames[index] @ offset
    axes = frames[index] @ Rotation.from_rotvec(turn).as_matrix() @ UNTURNED
    point = centre + axes @ np.array([0.4, -0.3, 2.5])
    camera = Pinhole(offset, turn, 600.0, centre=[320, 240], mount=mount)
    arm = giajax.takeichi_20m(4)
    seen = camera.project(jnp.array(point), arm, jnp.array(angles))
    expected = 600 * np.array([0.4, -0.3]) / 2.5 + [320, 240]
    np.testing.assert_allclose(seen.pixels, expected, atol=1e-9)
    # Drawing the picture requires the pose of the camera.
    view = camera.view(arm, jnp.array(angles))
    np.testing.assert_allclose(view.centre, centre, atol=1e-12)
    np.testing.assert_allclose(view.axes, axes, atol=1e-12)
    np.testing.assert_allclose(camera.mounted_at(view), origin, atol=1e-12)
    with pytest.raises(InputError, match=f"a camera on '{mount}' requires an arm"):
        camera.project(jnp.zeros(3))


@pytest.mark.slow
def test_the_channels_are_what_each_camera_shows_of_the_motion():
    """Each camera has its own clock, whose delay is added to the common delay."""
    late = giajax.replace(
        model_for([run_of()]), {"camera.delay": 0.1, "camera.side.delay": 0.1, "marker.up": 0.15}
    )
    seen = giajax.predict(late, run_of(), tuple(CHANNELS))
    motion = late.trajectory(late.prepare(run_of()))
    arm, sensors = late.arm, late.sensors
    # The sampling interval is 0.1 s, so the cameras show the states of two samples and one sample
    # ago.
    side, tip = sensors.camera.pinholes["side"], sensors.camera.pinholes["tip"]
    link = jnp.stack([sensors.marker.on_links(arm, row)[1] for row in motion.angles])
    np.testing.assert_allclose(
        np.stack([seen["side.link02_u"], seen["side.link02_v"]], axis=1)[2:],
        side.project(link).pixels[:-2],
        atol=1e-3,
    )
    mark = jnp.array(MARK["mark01"]["position_m"])
    shown = jnp.stack([tip.project(mark, arm, row).pixels for row in motion.angles])
    np.testing.assert_allclose(seen["tip.mark01_v"][1:], shown[:-1, 1], atol=1e-3)
    assert np.ptp(seen["tip.mark01_v"]) > 10


def test_parameters_of_a_camera_have_its_name_in_their_paths_and_come_back_from_files():
    model = giajax.replace(
        model_for([run_of()]), {"camera.side.distortion": LENS, "camera.tip.aspect": 1.1}
    )
    assert {"camera.side.position", "camera.tip.delay"} <= {*declared(model), *left_out(model)}
    again = build_model("arm", model.definition(), {})
    for path in ("camera.side.distortion", "camera.tip.aspect", "camera.tip.rotation"):
        np.testing.assert_allclose(giajax.get(again, path), giajax.get(model, path), rtol=1e-14)
    assert again.sensors.camera.pinholes["tip"].mount == "tip"
    assert again.sensors.camera.pinholes["side"].size == (1920, 1080)
    # The default principal point is the centre of the picture.
    np.testing.assert_array_equal(giajax.get(again, "camera.tip.centre"), [319.5, 239.5])


@pytest.mark.slow
def test_what_leaves_the_picture_is_missing_and_what_was_behind_is_named():
    run = run_of()
    again = recorded_again(model_for([run]), run)
    shown = np.isfinite(again.values["tip.mark01_v"])
    assert 0 < shown.sum() < len(TIMES)
    assert np.all(np.isfinite(again.values["side.link02_u"]))
    inside = again.values["tip.mark01_v"][shown]
    assert np.all((inside >= -0.5) & (inside <= 479.5))
    # The given orientation of this camera is reversed.
    turned = {**SIDE, "rotation_deg": [0.0, 0.0, -95.0]}
    other = Run.from_arrays(
        TIMES,
        {**COMMAND, **again.observations},
        definition=definition(side=turned, tip=TIP),
        name="film",
    )
    behind = [each for each in model_for([other]).conditions([], [other]) if "behind" in each]
    assert len(behind) == 1
    assert behind[0].startswith(
        "camera side: in 'film' 63 recorded pixel coordinates of side.link02_u, side.link02_v, "
        "side.tip_u show points that are behind the camera"
    )
    assert not [each for each in model_for([again]).conditions([], [again]) if "behind" in each]


@pytest.mark.parametrize(
    ("channel", "cameras", "says"),
    [
        ("link02_u", {}, "no camera is described: add [camera.NAME]"),
        ("top.link02_u", {"side": SIDE}, "must be side, so correct its name or add [camera.top]"),
        (
            "link02_u",
            {"side": SIDE, "tip": TIP},
            "begin the name of the channel with the name of a camera (side or",
        ),
        ("side.mark02_v", {"side": SIDE}, "position of the landmark in [landmark.mark02]"),
        ("side.tip_u", {"side": {"mount": "room"}}, "[camera.side] has no size_px"),
        ("side.tip_u", {"side": {**TIP, "mount": "room", "rotation_deg": None}}, "rotation_deg"),
    ],
)
def test_what_a_camera_must_say(channel, cameras, says):
    stated = {
        name: {key: value for key, value in about.items() if value is not None}
        for name, about in cameras.items()
    }
    run = Run.from_arrays(
        TIMES,
        {**COMMAND, channel: np.zeros_like(TIMES)},
        definition={**ARM, "camera": stated, "landmark": MARK},
    )
    with pytest.raises(InputError) as caught:
        model_for([run]).prepare(run)
    assert says in str(caught.value)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("sections", "says"),
    [
        ({"camera": {"side": {"focal_px": 9.0}}}, "unknown key camera.side.focal_px"),
        ({"camera": {"side": {"size_px": [3.5, 2]}}}, "list of two whole numbers"),
        ({"camera": {"side": {"focal_length_px": -9.0}}}, "focal_length_px = -9.0"),
        ({"camera": {"side": {"mount": "link6"}}}, 'must be "room", "tip" or a link'),
        ({"camera": {"delay": {"mount": "tip"}}}, "has a camera 'delay'"),
        ({"camera": {"a b": {"mount": "tip"}}}, "may contain only letters, digits and _"),
        ({"camera": {"side": 3}}, "[camera.side] must be a table of keys"),
        ({"landmark": {"door": {"position_m": [0.0, 0.0, 0.0]}}}, "called mark01, mark02"),
        ({"landmark": {"mark01": {}}}, "add mark01.position_m"),
    ],
)
def test_wrong_cameras_and_landmarks_are_one_sentence(sections, says):
    with pytest.raises(InputError) as caught:
        Definition.parse(sections, "film.toml")
    assert says in str(caught.value), str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.quick
def test_a_camera_beyond_the_arm_is_refused_and_a_later_file_changes_one_key():
    with pytest.raises(InputError, match=r"side\.mount is link 5, but the arm has only 4 links"):
        Run.from_arrays(
            TIMES,
            {**COMMAND, "side.tip_u": np.zeros_like(TIMES)},
            definition={**ARM, "camera": {"side": {**SIDE, "mount": "link05"}}},
        )
    first = Definition.parse(definition())
    later = Definition.parse({"camera": {"side": {"focal_length_px": 850.0}}})
    merged = first.merged_with(later).contents()["camera"]
    assert merged["side"] == {**SIDE, "focal_length_px": 850.0}
    assert merged["tip"] == TIP
