"""Conversion of arms from and to MuJoCo: serial chains of hinges as MJCF or URDF, with air forces.

`read_mjcf` creates an arm from a file. `export_mjcf` converts an arm to MJCF, and the effects that
MuJoCo does not have to a Python file. Both report what is lost. MuJoCo's `MjSpec` reads the files.
"""

import json
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from ..mechanics.arm import Arm, bodies, chain, lift, six_points
from ..runtime.files import read_text
from ..runtime.limits import RESULT_BYTES
from ..runtime.text import InputError, install_command, one_of

if TYPE_CHECKING:
    import mujoco

Array = np.ndarray

AIR = "air.py"
"""Name of the Python file beside an exported arm, a copy of `_mujoco_air.py` in this folder."""

_ON_LINE = 1e-9  # Tolerated offset of a joint from the line of the others, over the arm's length.


class ReadArm(NamedTuple):
    """An arm that a file describes.

    Attributes:
        arm: the arm, with the air of `giajax.chain`; its angles are those of the file minus `ref`.
        names: names of the joints in the file, from the base on.
        rest: angles at which the springs of the file have no torque, shape (joint,), rad. With
            these as commands the arm moves as in the file.
        stated: paths of the joint parameters that the file specifies.
        lost: sentences on features of the file that the arm does not have.
    """

    arm: Arm
    names: tuple[str, ...]
    rest: Array
    stated: tuple[str, ...]
    lost: tuple[str, ...]


def read_mjcf(
    path: str | Path,
    *,
    diameter: float | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> ReadArm:
    """Read an arm from MJCF or URDF: a chain of hinges that is straight at angles of zero.

    Masses, inertias, axes, dampers, armatures and springs are taken from the file. A body without a
    joint belongs to the link to which it is fixed. The mass of a link that is not symmetric about
    its axis is represented by six points with the same inertia.

    Arguments:
        path: MJCF or URDF file.
        diameter: diameter of all links for the air forces, m. The default is the thickness of their
            geoms.
        parameters: values by path, SI, as in `giajax.chain`; they override those of the file.

    Raises:
        InputError: MuJoCo is not installed or cannot read the file; the file describes a tree; a
            joint is not a hinge or lies off the line of the others; the size of a link is not
            given.
    """
    mujoco = _mujoco()
    read_text(Path(path), RESULT_BYTES, "XML", "an MJCF or URDF file")
    try:
        model = mujoco.MjSpec.from_file(str(path)).compile()
    except (ValueError, OSError) as error:
        sentence = " ".join(str(error).split())
        raise InputError(f"MuJoCo cannot read {path} ({sentence}): correct the file") from None
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    links = _chain_of(model, path)
    names = tuple(model.joint(joint).name or f"joint {joint + 1}" for joint in range(model.njnt))
    lost = list(_lost(model))

    anchors, ends = data.xanchor, _last_point(model, data, links[-1])
    size = float(np.linalg.norm(ends - anchors[0]))
    line = (
        ends if len(links) == 1 or not np.any(anchors[1] - anchors[0]) else anchors[1]
    ) - anchors[0]
    along = line / (np.linalg.norm(line) or 1.0)
    off = np.linalg.norm(np.cross(anchors - anchors[0], along), axis=1)
    if np.any(off > _ON_LINE * size):
        joint = int(np.argmax(off > _ON_LINE * size))
        raise InputError(
            f"{path}: the joint '{names[joint]}' is {off[joint]:.3g} m away from the line of the "
            "other joints, but all links must be straight at zero angles: move the joint, or set "
            "its ref"
        )
    length = np.diff(([*anchors, ends] - anchors[0]) @ along)
    if not np.all(length > 0):
        joint = int(np.argmin(length > 0))
        raise InputError(
            f"{path}: the link of the joint '{names[joint]}' has no length along the arm: give it "
            "a length (the last link needs a geom or a site at its end)"
        )
    world = _upright(-model.opt.gravity)
    frame = _frame(along, world[2])
    parts = [_body(model, data, link, anchors[k], frame) for k, link in enumerate(links)]
    thick = [_thickness(model, data, link, frame) for link in links]
    if diameter is None and not all(thick):
        joint = thick.index(0.0)
        raise InputError(
            f"{path}: no geom gives the diameter of the link of the joint '{names[joint]}': "
            "give the diameter of the links"
        )
    mass, centre, inertia = (np.array(each) for each in zip(*parts, strict=True))
    try:
        mass, axial, transverse, points = six_points(mass, centre, inertia)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if points is not None:
        which = ", ".join(str(link) for link in dict.fromkeys(points.links))
        lost.append(
            "each link whose inertia is not symmetric about its axis becomes six point masses: "
            f"{which}"
        )
    axes = data.xaxis @ frame
    joints = _joints(model, axes, lost)
    arm = chain(
        len(links),
        length=length,
        diameter=thick if diameter is None else diameter,
        mass=mass,
        centre_of_mass=centre[:, 0],
        inertia_transverse=transverse,
        inertia_axial=axial,
        joint_axes=axes.tolist(),
        joint_laws=("end_stops",) if "joints.laws.end_stops.lower" in joints else (),
        base_rotation=Rotation.from_matrix(world @ frame).as_rotvec(),
        gravity=0.0 if _disabled(model, "GRAVITY") else float(np.linalg.norm(model.opt.gravity)),
        point_masses=points,
        parameters=joints | dict(parameters or {}),
    )
    rest = np.asarray(model.qpos_spring - model.qpos0)
    if np.any(rest[np.asarray(model.jnt_stiffness) > 0]):
        angles = ", ".join(f"{angle:.6g}" for angle in np.rad2deg(rest))
        lost.append(
            f"the springs are unloaded at nonzero angles, so command these angles: {angles} deg"
        )
    return ReadArm(arm, names, rest, tuple(joints), tuple(lost))


def _mujoco() -> Any:
    if find_spec("mujoco") is None:
        raise InputError(f"MuJoCo is not installed: {install_command('mujoco')}")
    import mujoco

    return mujoco


def _chain_of(model: "mujoco.MjModel", path: str | Path) -> list[int]:
    """Return the bodies with the joints of a chain, from the base on."""
    import mujoco

    if not model.njnt:
        raise InputError(f"{path} has no joint: give one hinge for each link")
    for joint in range(model.njnt):
        if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
            name = model.joint(joint).name
            raise InputError(f"{path}: the joint '{name}' is not a hinge: use only hinges")
    links = [int(body) for body in model.jnt_bodyid]
    before = 0
    for body in links:
        name = model.body(body).name
        if body == before:
            raise InputError(
                f"{path}: the body '{name}' has two joints: give each joint its own body"
            )
        held = int(model.body_weldid[model.body_parentid[body]])
        if held != before:
            others = one_of(
                model.body(other).name for other in links if _held(model, other) == held
            )
            raise InputError(
                f"{path} describes a tree, but an arm is a chain: keep only one of the bodies "
                f"{others}"
            )
        before = body
    return links


def _held(model: "mujoco.MjModel", body: int) -> int:
    """Return the moving body, or the world (0), to which the joint of a body holds it."""
    return int(model.body_weldid[model.body_parentid[body]])


def _lost(model: "mujoco.MjModel") -> Iterator[str]:
    """Yield sentences on features of a file that an arm does not have, except those of joints."""
    counts = {"actuators": model.nu, "tendons": model.ntendon, "equalities": model.neq}
    yield from (f"the {name} of the file are omitted" for name, count in counts.items() if count)
    if model.opt.density or model.opt.viscosity:
        yield "the MuJoCo medium is omitted: giajax computes the air forces"
    if np.any(model.body_gravcomp):
        yield "gravcomp of bodies is omitted"
    # MuJoCo has these fields from version 4 on.
    for name in ("jnt_stiffnesspoly", "dof_dampingpoly"):
        if np.any(getattr(model, name, 0.0)):
            yield "only the linear parts of the stiffness and damping polynomials are kept"
    if np.any((model.geom_contype != 0) | (model.geom_conaffinity != 0)):
        yield "contacts of geoms are omitted: define obstacles in [arm]"


def _joints(model: "mujoco.MjModel", axes: Array, lost: list[str]) -> dict[str, Any]:
    """Return the parameters of the joints by path.

    Sentences on features that these cannot represent are appended to `lost`.
    """
    dampers = not (_disabled(model, "DAMPER") or _disabled(model, "PASSIVE"))
    springs = not (_disabled(model, "SPRING") or _disabled(model, "PASSIVE"))
    found: dict[str, Any] = {"joints.damping": np.array(model.dof_damping) * dampers}
    yaw = np.abs(axes[:, 2]) > np.sqrt(0.5)  # Same criterion as `Joints.is_yaw`.
    for name, which in (("pitch", ~yaw), ("yaw", yaw)):
        several = sorted(set((model.jnt_stiffness[which] * springs).tolist())) or [0.0]
        found[f"joints.{name}_stiffness"] = several[0] if len(several) == 1 else 0.0
        if len(several) > 1:
            lost.append(
                f"the springs of the {name} joints are omitted: they have several stiffnesses"
            )
    if np.any(model.dof_armature):
        found["joints.armature"] = np.array(model.dof_armature)
    if np.any(model.jnt_limited) and not _disabled(model, "LIMIT"):
        limits = np.where(
            model.jnt_limited[:, None], model.jnt_range - model.qpos0[:, None], [-np.pi, np.pi]
        )
        found["joints.laws.end_stops.lower"] = np.clip(limits[:, 0], -np.pi, 0)
        found["joints.laws.end_stops.upper"] = np.clip(limits[:, 1], 0, np.pi)
        lost.append(
            "joint limits become end stops with a default stiffness (joints.laws.end_stops)"
        )
        if np.any((limits[:, 0] > 0) | (limits[:, 1] < 0)):
            lost.append("a joint range that does not contain 0 is extended to 0")
        if np.any(np.abs(limits) > np.pi) or not np.all(model.jnt_limited):
            lost.append(
                "joints without limits are given limits of 180 deg, because other joints have "
                "limits"
            )
    if np.any(model.dof_frictionloss) and not _disabled(model, "FRICTIONLOSS"):
        found["joints.friction"] = np.array(model.dof_frictionloss)
        lost.append("frictionloss, which models sticking, becomes a smooth friction law")
    return found


def _disabled(model: "mujoco.MjModel", what: str) -> bool:
    """Return whether a flag of the file disables something; unknown flags do not."""
    import mujoco

    flag = getattr(mujoco.mjtDisableBit, f"mjDSBL_{what}", None)
    return flag is not None and bool(model.opt.disableflags & flag)


class _Part(NamedTuple):
    """A link in its own frame: mass (kg), centre of mass (m), inertia about it (kg m^2)."""

    mass: float
    centre: Array
    inertia: Array


def _body(
    model: "mujoco.MjModel", data: "mujoco.MjData", link: int, anchor: Array, frame: Array
) -> _Part:
    """Return a body together with the bodies that are fixed to it."""
    fixed = np.flatnonzero(model.body_weldid == link)
    mass = model.body_mass[fixed]
    places = (data.xipos[fixed] - anchor) @ frame
    centre = mass @ places / mass.sum()
    inertia = np.zeros((3, 3))
    for body, each, place in zip(fixed, mass, places - centre, strict=True):
        turned = frame.T @ data.ximat[body].reshape(3, 3)
        inertia += turned @ np.diag(model.body_inertia[body]) @ turned.T
        inertia += each * (place @ place * np.eye(3) - np.outer(place, place))
    return _Part(float(mass.sum()), centre, inertia)


def _corners(model: "mujoco.MjModel", data: "mujoco.MjData", link: int) -> Array:
    """Return the corners of the boxes around the geoms of a link, shape (point, 3), m."""
    fixed = np.flatnonzero(model.body_weldid == link)
    signs = np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
    points = [np.zeros((0, 3))]
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, fixed)):
        centre, half = np.split(model.geom_aabb[geom], 2)
        points.append(
            (centre + signs * half) @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        )
    return np.concatenate(points)


def _last_point(model: "mujoco.MjModel", data: "mujoco.MjData", link: int) -> Array:
    """Return the end of the last link.

    It is the farthest site or geom of the link along the line towards its centre.
    """
    anchor = data.xanchor[-1]
    fixed = np.flatnonzero(model.body_weldid == link)
    towards = anchor - data.xanchor[0]
    if not np.any(towards):
        towards = np.average(data.xipos[fixed], axis=0, weights=model.body_mass[fixed]) - anchor
    if not np.any(towards):
        return np.array(anchor)
    towards = towards / np.linalg.norm(towards)
    sites = data.site_xpos[np.isin(model.site_bodyid, fixed)]
    ends = np.concatenate([_corners(model, data, link), sites])
    reach = (ends - anchor) @ towards
    return np.asarray(anchor + max(reach, default=0.0) * towards)


def _thickness(model: "mujoco.MjModel", data: "mujoco.MjData", link: int, frame: Array) -> float:
    """Return the largest width of the geoms of a link across its axis, m; 0 without geoms."""
    corners = _corners(model, data, link) @ frame[:, 1:]
    return float(np.ptp(corners, axis=0).max()) if len(corners) else 0.0


def _upright(up: Array) -> Array:
    """Return the rotation of the world that turns `up` to +z; none without gravity."""
    if not np.any(up) or not np.any(up[:2]):
        return np.eye(3) if up[2] >= 0 else np.diag([1.0, -1.0, -1.0])
    return np.asarray(Rotation.align_vectors([[0, 0, 1]], [up])[0].as_matrix())


def _frame(along: Array, up: Array) -> Array:
    """Return the axes of a straight arm as columns: along it, to its left, and above it."""
    above = up - (up @ along) * along
    if np.linalg.norm(above) < 1e-6:
        above = np.eye(3)[np.argmin(np.abs(along))]
        above = above - (above @ along) * along
    above = above / np.linalg.norm(above)
    return np.stack([along, np.cross(above, along), above], axis=1)


class ExportedArm(NamedTuple):
    """An arm as files for MuJoCo.

    Attributes:
        files: text by name: `arm.xml`, `air.py` and `air.json`.
        lost: sentences on features of the arm that the files do not have.
    """

    files: dict[str, str]
    lost: tuple[str, ...]


def export_mjcf(arm: Arm) -> ExportedArm:
    """Convert an arm to MJCF, and effects that MuJoCo does not have to passive forces in Python.

    The bodies are `link1` and so on, each with its helium, trim weight and point masses. The joints
    are `joint1` and so on, and the end is the site `tip`. Springs pull towards 0. The command of
    `air.forces` moves them. `air.forces` also has drag, lift and friction (the text of `air.py`
    shows its use).

    Raises:
        InputError: MuJoCo is not installed.
    """
    mujoco = _mujoco()
    root = Element("mujoco", model="arm")
    # The XML is written here because MuJoCo would write only 6 digits.
    _add(root, "compiler", angle="radian", autolimits="true")
    _add(root, "option", gravity=[0.0, 0.0, -float(arm.gravity)], integrator="RK4")
    _add(root[-1], "flag", contact="disable")
    rigid, count = bodies(arm), arm.count
    across = np.zeros((2, count)) if rigid.across is None else np.asarray(rigid.across)
    inertia = np.zeros((6, count)) if rigid.uneven is None else np.array(rigid.uneven)
    inertia[:3] += np.stack([rigid.axial, rigid.transverse, rigid.transverse])
    stiffness, rubs = np.asarray(arm.spring_stiffness), _each(arm.joints.friction, count)
    damping, armature = (_each(x, count) for x in (arm.joints.damping, arm.joints.armature))
    length, radius = np.asarray(arm.links.length), np.asarray(arm.links.diameter) / 2
    turn = Rotation.from_rotvec(np.array(arm.base_rotation)).as_quat(scalar_first=True)
    body = _add(root, "worldbody")
    for i in range(count):
        body = _add(body, "body", name=f"link{i + 1}", pos=[length[i - 1] if i else 0.0, 0.0, 0.0])
        if i == 0:
            body.set("quat", _numbers(turn))
        _add(
            body,
            "inertial",
            pos=[rigid.along[i], *across[:, i]],
            mass=[rigid.mass[i]],
            fullinertia=inertia[:, i],
        )
        _add(
            body,
            "joint",
            name=f"joint{i + 1}",
            axis=arm.joints.axes[i],
            stiffness=stiffness[i : i + 1],
            damping=damping[i : i + 1],
            armature=armature[i : i + 1],
        )
        _add(
            body,
            "geom",
            type="cylinder",
            fromto=[0.0, 0.0, 0.0, length[i], 0.0, 0.0],
            size=radius[i : i + 1],
            contype="0",
            conaffinity="0",
        )
    _add(body, "site", name="tip", pos=[length[-1], 0.0, 0.0])
    indent(root)
    text = tostring(root, encoding="unicode") + "\n"
    try:
        mujoco.MjSpec.from_string(text).compile()
    except ValueError as error:
        sentence = " ".join(str(error).split())
        raise InputError(f"MuJoCo rejects this arm ({sentence}): correct the links") from None
    air, factor = arm.air, float(arm.air.density) * radius * length
    axial = 0.0 if air.axial_coefficient is None else float(air.axial_coefficient)
    upwards = lift(arm)
    numbers = {
        "stiffness": stiffness.tolist(),
        "friction": rubs.tolist(),
        "friction_rate": float(arm.joints.friction_rate),
        "half_length": (length / 2).tolist(),
        "points": 0 if air.drag == "centre" else air.strip_points,
        "drag": (float(air.drag_coefficient) * factor).tolist(),
        "axial": (axial * factor).tolist(),
        "lift": (np.zeros(count) if upwards is None else np.asarray(upwards)).tolist(),
        "wind": [0.0] * 3 if air.wind is None else np.asarray(air.wind).tolist(),
    }
    files = {
        "arm.xml": text,
        AIR: Path(__file__).with_name("_mujoco_air.py").read_text(encoding="utf-8"),
        "air.json": json.dumps(numbers, indent=1) + "\n",
    }
    return ExportedArm(files, tuple(_not_exported(arm)))


def _add(parent: Element, tag: str, **attributes: Any) -> Element:
    """Add an element to another one; lists of numbers are written at full precision."""
    texts = {k: v if isinstance(v, str) else _numbers(v) for k, v in attributes.items()}
    return SubElement(parent, tag, texts)


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def _not_exported(arm: Arm) -> Iterator[str]:
    points = arm.point_masses
    absent = {
        "added mass": arm.air.added_mass_coefficient is not None,
        "the dependence of drag on the Reynolds number": arm.air.drag_curve != "constant",
        "the drag law": arm.air.law is not None,
        "the wind field (a function of position and time)": arm.air.wind_field is not None,
        "joint laws other than springs, dampers and friction": bool(arm.joints.further_laws.laws),
        "the gain of the drives": arm.joints.drive_gain is not None,
        "the lag of the drives": arm.joints.drive_lag is not None,
        "the saturation of the drives": arm.joints.drive_saturation is not None,
        "the drift of lift": arm.buoyancy is not None and arm.buoyancy.imbalance_drift is not None,
        "the drift of stiffness": arm.joints.stiffness_drift is not None,
        "the torque of muscles and of bent balloons": arm.pneumatics is not None,
        "obstacles": arm.contact is not None,
        "the drag of point masses": points is not None and points.drag_area is not None,
    }
    yield from (f"omitted: {name}" for name, lost in absent.items() if lost)


def _each(values: Any, count: int) -> Array:
    """Return one value per joint; zeros for properties that the arm does not have."""
    return np.broadcast_to(0.0 if values is None else np.asarray(values), (count,))
